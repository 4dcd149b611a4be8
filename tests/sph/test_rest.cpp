// Bodies at rest: a bed carries its weight, a slope below its angle of repose stays where it is.
#include "tests/verification/bodies_at_rest.hpp"

namespace dem2sph {
namespace {

const std::string& bed = bed_at_rest;

TEST(Rest, BedCarriesItsWeight) {
  // 20 sqrt(H/g) = 2 s. The start is in equilibrium but for the lattice's floor; what rings is damped by
  // then.
  auto flow = flow_of<2>(case_of(bed));
  run_until(*flow, 1.5);
  double force = 0;
  double floor_pressure = 0;
  const int samples = 50;
  for (int i = 0; i < samples; ++i) {
    run_until(*flow, flow->time() + 0.01);
    const Budgets b = flow->budgets();
    force += b.wall_force[1] / samples;
    const Interior q(flow->frame());
    floor_pressure += Line(q.up, q.p).at_zero / samples;
  }
  const double weight = flow->budgets().mass * 9.81;
  const double length = 16 * 0.1 / 20;
  EXPECT_NEAR(force / weight, 1, 0.002) << "force of the floor over weight";
  // Bar: 2 %. At h/dx = 1.5 the lattice factor is f = 0.9974, so 0.3 % of it is the lattice's own.
  EXPECT_NEAR(floor_pressure * length / weight, 1, 0.02) << "pressure extrapolated to the floor over weight";
  EXPECT_LT(flow->budgets().largest_speed, 1e-3 * std::sqrt(9.81 * 0.1));
}

TEST(Rest, SlopeBelowReposeDoesNotDrift) {
  // 15 deg with mu_l = 0.38 (20.8 deg). The bed sags elastically along the slope and rings about a fixed
  // place, so displacements are means over a period and more.
  const CaseFile file = case_of(bed, {"incline.angle=15 deg", "incline.height=0.5 m", "flow.end_time=10 s"});
  auto flow = flow_of<2>(file);
  const double length = 16 * 0.5 / 20;
  double total = 0;  // displacement along the slope, unwrapped
  std::vector<double> last = Interior(flow->frame()).x;
  std::vector<double> id_order;
  const auto advance = [&](double seconds) {
    // Momentum over mass is the mean velocity: its integral is the mean displacement, whatever wraps or
    // sorts.
    double average = 0;
    const int pieces = static_cast<int>(seconds / 0.005);
    for (int i = 0; i < pieces; ++i) {
      const double before = flow->time();
      const double v0 = flow->budgets().momentum[0];
      run_until(*flow, before + 0.005);
      total += 0.005 * 0.5 * (v0 + flow->budgets().momentum[0]) / flow->budgets().mass;
      average += total / pieces;
    }
    return average;
  };
  advance(2.0);
  const double early = advance(2.0);
  const double late = advance(2.0);
  const double d = 0.005;
  EXPECT_LT(std::abs(late - early), 0.02 * d) << "drift between the means over 2-4 s and 4-6 s";
  EXPECT_LT(std::abs(total), 0.02 * length) << "the sag itself: tau/G over H";
}

TEST(Rest, SourceCarriesItsWeightToo) {
  // A small bed with a large g_min, so that the viscous bound of Eq. 5.28 (obeyed) leaves a usable step. The
  // force comes from the momentum balance, averaged while the scheme's own shaking lasts: 2 % is its size at
  // this resolution.
  const CaseFile file = case_of(bed, {"flow.formulation=source", "flow.resolution=10", "flow.g_min=5 1/s"});
  auto flow = flow_of<2>(file);
  run_until(*flow, 0.3);
  double force = 0;
  for (int i = 0; i < 100; ++i) {
    run_until(*flow, flow->time() + 0.002);
    force += flow->budgets().wall_force[1] / 100;
  }
  EXPECT_NEAR(force / (flow->budgets().mass * 9.81), 1, 0.02);
}

}  // namespace
}  // namespace dem2sph
