// What has broken down ends a run with a message that names it; what is doubtful is said in the summary.
#include <limits>

#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"
#include "sph/run_flow.hpp"
#include "tests/base/helpers.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;

const std::string bed = R"(
[flow]
scene = "inclined_plane"
resolution = 8
end_time = "0.2 s"
frames = 2
[incline]
height = "0.1 m"
angle = "0 deg"
)" + glass_beads;

FlowSetup<2> setup_of_bed(const std::vector<std::string>& set = {}) {
  const CaseFile file = case_of(bed, set);
  return make_setup<2>(file, law_of_case(file));
}

/// The message of the NumericalError that the flow ends with.
std::string ends_with(FlowSetup<2> setup) {
  try {
    const std::unique_ptr<Flow> flow = make_flow<2>(std::move(setup));
    for (int i = 0; i < 2000; ++i) flow->step(1);
  } catch (const NumericalError& error) {
    return error.what();
  }
  return "no error";
}

TEST(Guards, NaNIsNamedWhereItBegins) {
  FlowSetup<2> setup = setup_of_bed();
  setup.particles.v[0][5] = std::numeric_limits<double>::quiet_NaN();
  const std::string text = ends_with(std::move(setup));
  EXPECT_NE(text.find("step "), std::string::npos) << text;
  EXPECT_NE(text.find("of particle "), std::string::npos) << text;
  EXPECT_NE(text.find("step_factor"), std::string::npos) << text;
}

TEST(Guards, SqueezedMaterial) {
  FlowSetup<2> setup = setup_of_bed();
  // Thrown at the floor with three times the speed of sound.
  const double c = std::sqrt(setup.eos.K / setup.eos.rho0);
  for (std::size_t i = 0; i < setup.particles.interior; ++i) setup.particles.v[1][i] = -3 * c;
  const std::string text = ends_with(std::move(setup));
  EXPECT_NE(text.find("sound speed"), std::string::npos) << text;
}

TEST(Guards, AStepThatCollapses) {
  const std::string text = ends_with(setup_of_bed({"flow.stress=direct", "flow.g_min=1e-9 1/s"}));
  EXPECT_NE(text.find("time step has collapsed"), std::string::npos) << text;
  EXPECT_NE(text.find("g_min"), std::string::npos) << text;
}

class Warnings : public test::Scratch {
 protected:
  /// Causes of the warnings of a run.
  std::vector<std::string> of(const std::string& text, const std::vector<std::string>& set) {
    const CaseFile file = case_of(text, set);
    FlowOptions options;
    options.folder = in("out");
    options.quiet = options.force = true;
    options.threads = 1;
    std::vector<std::string> causes;
    const json summary = run_flow(file, law_of_case(file), options);
    for (const json& w : summary.at("warnings")) causes.push_back(w.at("cause").get<std::string>());
    return causes;
  }
};
using Causes = std::vector<std::string>;

TEST_F(Warnings, NoneOfABedAtRest) { EXPECT_EQ(of(bed, {}), Causes{}); }
TEST_F(Warnings, TooFewParticles) { EXPECT_EQ(of(bed, {"flow.resolution=3"}), Causes{"resolution"}); }
TEST_F(Warnings, LongSteps) { EXPECT_EQ(of(bed, {"flow.step_factor=1.5"}), Causes{"time step"}); }
TEST_F(Warnings, Creep) {  // what creeps flows, at an I where mu(I) is ill-posed
  EXPECT_EQ(of(bed, {"flow.stress=direct", "flow.g_min=1 1/s"}), (Causes{"ill-posed law", "creep"}));
}
TEST_F(Warnings, SmallerThanGrains) { EXPECT_EQ(of(bed, {"law.d=0.03 m"}), Causes{"smaller than grains"}); }
TEST_F(Warnings, FasterThanSound) {
  const std::string drop = R"(
[flow]
scene = "geometry"
resolution = 8
end_time = "0.05 s"
frames = 2
sound_speed = "5 m/s"
[domain]
low = ["-1 m", "-0.1 m"]
high = ["1 m", "1 m"]
[wall.floor]
shape = "plane"
point = ["0 m", "0 m"]
normal = [0, 1]
[body.material]
shape = "box"
low = ["0 m", "0.05 m"]
high = ["0.1 m", "0.15 m"]
velocity = ["2 m/s", "0.5 m/s"]
)" + glass_beads;
  const Causes causes = of(drop, {});
  EXPECT_NE(std::find(causes.begin(), causes.end(), "speed of sound"), causes.end());
}

// A body that is thrown flies as one.
TEST(Body, Velocity) {
  const std::string thrown = R"(
[flow]
scene = "geometry"
resolution = 4
end_time = "0.05 s"
[domain]
low = ["-1 m", "-1 m"]
high = ["1 m", "1 m"]
[body.material]
shape = "box"
low = ["0 m", "0 m"]
high = ["0.1 m", "0.1 m"]
velocity = ["0.5 m/s", "1 m/s"]
)" + glass_beads;
  const std::unique_ptr<Flow> flow = flow_of<2>(case_of(thrown));
  run_until(*flow, 0.05);
  const Budgets b = flow->budgets();
  EXPECT_NEAR(b.momentum[0] / b.mass, 0.5, 1e-12);
  EXPECT_NEAR(b.momentum[1] / b.mass, 1 - 9.81 * 0.05, 1e-12);
}

// A floor that swings comes back after a period, and has the velocity of its cosine between.
TEST(Wall, Swings) {
  Wall<2> wall;
  wall.period = 0.5;
  wall.swing[0] = wall.velocity[0] = 2;
  EXPECT_TRUE(wall.moves());
  const int steps = 1000;
  double farthest = 0;
  for (int i = 0; i < steps; ++i) {
    const double dt = wall.period / steps;
    wall.swing_at((i + 0.5) * dt);
    wall.move(dt);
    farthest = std::max(farthest, wall.point[0]);
  }
  EXPECT_NEAR(wall.point[0], 0, 1e-12);
  EXPECT_NEAR(farthest, 2 * 0.5 / (2 * std::numbers::pi), 1e-6);  // swing period/(2 pi)
}

}  // namespace
}  // namespace dem2sph
