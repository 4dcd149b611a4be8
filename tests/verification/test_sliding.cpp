// A bed that slides on its floor as one block, since the floor's friction is less than the slope and the
// material's own is more: it accelerates with g (sin - mu_b cos), whatever goes on inside. The block is
// periodic along the slope.
#include "tests/verification/boxes.hpp"
#include "tests/verification/record.hpp"

namespace dem2sph {
namespace {

const std::string slope = R"(
[flow]
scene = "inclined_plane"
resolution = 10
end_time = "1 s"
[incline]
height = "0.1 m"
angle = "20 deg"
)" + glass_beads;  // tan = 0.364, below mu_l = 0.38

struct Slide {
  double acceleration = 0;  ///< mean, along the slope [m/s^2]
  double sheared = 0;       ///< speed of the top row less that of the middle, over the mean: a block has 0
};

template <int Dim>
Slide slide(const std::vector<std::string>& set, double mu_b, bool smooth, double settle, double end) {
  std::vector<std::string> all = set;
  if (all[0] == "flow.formulation=source") all.push_back("flow.g_min=1 1/s");
  all.push_back("flow.dimension=" + std::to_string(Dim));
  if (!smooth) all.push_back("flow.basal_friction=" + std::to_string(mu_b));
  const CaseFile file = case_of(slope, all);
  FlowSetup<Dim> setup = make_setup<Dim>(file, law_of_case(file));
  if (smooth) setup.walls[0].rough = false;
  const double dx = setup.dx;
  auto flow = make_flow<Dim>(std::move(setup));
  run_until(*flow, settle);
  std::vector<double> t, v;
  const int samples = 100;
  for (int i = 0; i <= samples; ++i) {
    const Budgets b = flow->budgets();
    t.push_back(flow->time()), v.push_back(b.momentum[0] / b.mass);
    if (i < samples) run_until(*flow, settle + (end - settle) * (i + 1) / samples);
  }
  Slide result;
  // The bed rings: with a smooth wall no force is along the slope, and the ends say all; else a line through
  // all samples.
  result.acceleration = smooth ? (v.back() - v.front()) / (t.back() - t.front()) : Line(t, v).slope;
  const Interior q(flow->frame());
  std::vector<double> top, middle;
  for (std::size_t i = 0; i < q.size(); ++i) {
    if (q.up[i] > 0.1 - 2 * dx) top.push_back(q.vx[i]);
    if (std::abs(q.up[i] - 0.05) < dx) middle.push_back(q.vx[i]);
  }
  result.sheared = (mean(top) - mean(middle)) / v.back();
  return result;
}

const double theta = 20 * std::numbers::pi / 180;

TEST(Sliding, SmoothFloor) {
  for (const std::string formulation : {"robust", "source"}) {
    const double exact = 9.81 * std::sin(theta);
    const double two = slide<2>({"flow.formulation=" + formulation}, 0, true, 0, 0.1).acceleration;
    const double three = slide<3>({"flow.formulation=" + formulation}, 0, true, 0, 0.01).acceleration;
    std::printf("smooth %s: %.3e %.3e\n", formulation.c_str(), two / exact - 1, three / exact - 1);
    // No shear traction acts on a smooth wall; what is left is that its surface is a row of particles, over
    // whose spacing the block's rows go up and down. Along the way that averages out, but for the part of a
    // spacing at its end: 2e-3 is twice what the spacing of 10 rows leaves after 1.7 cm.
    const double bar = 2e-3;
    record("sliding", formulation, "2D, smooth floor: acceleration over g sin(theta) - 1", two / exact - 1,
           bar, "1");
    record("sliding", formulation, "3D, smooth floor: acceleration over g sin(theta) - 1", three / exact - 1,
           bar, "1");
    EXPECT_NEAR(two / exact, 1, bar);
    EXPECT_NEAR(three / exact, 1, bar);
  }
}

// A rigid block would have a = g (sin - mu_b cos) exactly. `robust` has walls that slide as Coulomb's law
// says: the friction comes out 1 % low, since the normal force also holds the deviatoric part of the normal
// stress, which mu_b p does not see; of the acceleration that is up to 5 % where slope and friction nearly
// cancel. In `source`, where no-slip velocities stand beside a limited force, it is 2 to 5 % low, and the
// block shears inside, since g_min lets it.
TEST(Sliding, BasalFriction) {
  for (const std::string formulation : {"robust", "source"})
    for (const double mu_b : {0.1, 0.2, 0.3}) {
      const double exact = 9.81 * (std::sin(theta) - mu_b * std::cos(theta));
      const Slide s = slide<2>({"flow.formulation=" + formulation}, mu_b, false, 0.1, 0.5);
      // What the floor's friction comes out as: of a bed that keeps its weight, from its acceleration.
      const double measured = (std::sin(theta) - s.acceleration / 9.81) / std::cos(theta);
      std::printf("basal %g %s: a/exact %.4f, mu_b %.4f, top over middle %.4f\n", mu_b, formulation.c_str(),
                  s.acceleration / exact, measured, s.sheared);
      const std::string what = "2D, mu_b = " + std::to_string(mu_b).substr(0, 3) + ", 20 deg: ";
      const bool robust = formulation == "robust";
      const double bar = robust ? 0.02 : 0.06;
      record("sliding", formulation, what + "friction of the floor over mu_b - 1", measured / mu_b - 1, bar,
             "1");
      record("sliding", formulation, what + "acceleration over the exact one - 1", s.acceleration / exact - 1,
             robust ? 0.06 : 0.15, "1");
      EXPECT_NEAR(measured / mu_b, 1, bar);
      EXPECT_NEAR(s.acceleration / exact, 1, robust ? 0.06 : 0.15);
    }
}

}  // namespace
}  // namespace dem2sph
