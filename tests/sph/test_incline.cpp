// Bagnold's flow: robust against the exact profile, and the one law as one SPH particle feels it.
#include "tests/sph/incline_measure.hpp"

namespace dem2sph {
namespace {

TEST(Incline, RobustFollowsBagnold) {
  // From the exact profile the flow relaxes to its own over about H^2/(5 eta/rho) = 0.4 s. Bar: 8 % after
  // f^-1.5.
  const InclineResult r = measure_incline(case_of(incline), 1.0, 1.0);
  EXPECT_NEAR(r.velocity_ratio * std::pow(factor_wendland_c2_15, 1.5), 1, 0.08);
  // The walls are there to stop slip: a twentieth is what one lattice spacing at the base amounts to.
  EXPECT_LT(std::abs(r.slip_ratio), 0.05);
  EXPECT_NEAR(r.floor_pressure, 1, 0.06);
  // One law: tau and the rate come from the same return, so the two agree to rounding of the return.
  EXPECT_LT(r.largest_mu_error, 1e-10);
}

TEST(Incline, LatticeFactorIsSeenAtSmallH) {
  const InclineResult r = measure_incline(case_of(incline, {"flow.h_over_dx=1.2"}), 1.0, 1.0);
  EXPECT_NEAR(r.velocity_ratio * std::pow(factor_wendland_c2_12, 1.5), 1, 0.08);
  EXPECT_GT(r.velocity_ratio, 1.02) << "f^-1.5 is 1.057";
}

TEST(Incline, LawOfOneParticleInSource) {
  // g_min far below any rate of the flow, and few steps: the law holds at every one of them.
  const CaseFile file =
      case_of(incline, {"flow.formulation=source", "flow.g_min=1 1/s", "flow.resolution=10"});
  const InclineResult r = measure_incline(file, 0.01, 0.01);
  EXPECT_LT(r.largest_mu_error, 1e-10);
}

TEST(Incline, EvolvedBetaVanishesInSteadyFlow) {
  // phi starts at phi_c, the steady flow wants phi_c - b I: after strains of many s* = 0.3 both phi and beta
  // are steady.
  FlowSetup<2> setup =
      make_setup<2>(case_of(incline, {"flow.dilation=evolve"}), law_of_case(case_of(incline)));
  auto flow = make_flow<2>(std::move(setup));
  run_until(*flow, 1.0);
  const Frame frame = flow->frame();
  const Interior q(frame);
  const double I = Bagnold(std::get<RationalFriction<double>>(friction_law(law_of_case(case_of(incline)))),
                           {0.005, 2500}, 0.6, 9.81, 25 * M_PI / 180)
                       .inertial_number;
  double beta = 0;
  double phi = 0;
  for (std::size_t i = 0; i < q.size(); ++i) {
    beta += frame.field("beta").values[i] / static_cast<double>(q.size());
    phi += frame.field("phi").values[i] / static_cast<double>(q.size());
  }
  EXPECT_LT(std::abs(beta), 0.005);
  EXPECT_NEAR(phi, 0.6 - 0.2 * I, 0.004) << "phi_eq at Bagnold's I";
}

TEST(Incline, ABedThatDilatesSwells) {
  // With rho0 = phi rho_s the bed takes the room that its grains need: from phi_c to phi_c - b I at Bagnold's
  // I its height grows by their ratio, 1.048, and the pressure stays what the weight makes it.
  const CaseFile file = case_of(incline, {"flow.dilation=evolve", "flow.swelling=true"});
  const double area = make_setup<2>(file, law_of_case(file)).period.length[0];
  auto flow = flow_of<2>(file);
  const double theta = 25 * M_PI / 180;
  double height = 0;
  double pressure = 0;  // mean over half of the weight on the area, which it is at the middle of the mass
  run_until(*flow, 1.0);
  for (int k = 0; k < 20; ++k) {
    run_until(*flow, flow->time() + 0.01);
    const Interior q(flow->frame());
    height += 2 * mean(q.up) / 20;  // of a bed of even density
    pressure += mean(q.p) / (0.5 * flow->budgets().mass * 9.81 * std::cos(theta) / area) / 20;
  }
  const double I = Bagnold({0.38, 0.64, 0.279}, {0.005, 2500}, 0.6, 9.81, theta).inertial_number;
  const double swollen = 0.6 / (0.6 - 0.2 * I);
  // 5 % of the growth, 0.25 % of the height: rows near floor and surface shear at another I.
  EXPECT_NEAR(height, 0.1 * swollen, 0.05 * 0.1 * (swollen - 1));
  EXPECT_NEAR(pressure, 1, 0.02) << "what the bed still bounces, over 20 samples";
}

}  // namespace
}  // namespace dem2sph
