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

}  // namespace
}  // namespace dem2sph
