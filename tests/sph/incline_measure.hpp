// Bagnold's flow as measured: surface velocity minus slip over the exact one for the measured density and
// height.
#pragma once

#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {

struct InclineResult {
  double velocity_ratio = 0;    ///< (surface velocity - slip) / exact
  double velocity_error = 0;    ///< standard error of that ratio from the scatter of the samples
  double slip_ratio = 0;        ///< slip / exact surface velocity
  double floor_pressure = 0;    ///< extrapolated, over the weight
  double largest_mu_error = 0;  ///< of a particle's tau/p against the law at its own rate and pressure
};

/// Runs the case to `settle` and averages over `average` seconds in 40 samples.
template <int Dim = 2>
InclineResult measure_incline(const CaseFile& file, double settle, double average) {
  FlowSetup<Dim> setup = make_setup<Dim>(file, law_of_case(file));
  const Grains grains = setup.grains;
  const auto friction = std::get<RationalFriction<double>>(setup.parts.friction);
  const double dx = setup.dx;
  double area = setup.period.length[0];
  if (Dim == 3) area *= setup.period.length[1];
  const double g_normal = -setup.gravity[Dim - 1];
  const double theta = std::atan2(setup.gravity[0], g_normal);
  const double g = std::hypot(setup.gravity[0], g_normal);
  auto flow = make_flow<Dim>(std::move(setup));
  run_until(*flow, settle);
  InclineResult result;
  double surface = 0, slip = 0, exact = 0, squares = 0;
  const int samples = 40;
  for (int k = 0; k < samples; ++k) {
    run_until(*flow, flow->time() + average / samples);
    const Interior q(flow->frame());
    const double rho = mean(q.rho);
    const double H = flow->budgets().mass / (rho * area);
    const Bagnold bagnold(friction, grains, rho / grains.rho_s, g, theta);
    std::vector<double> bottom_z, bottom_v, top_v, top_exact, deep_z, deep_p;
    for (std::size_t i = 0; i < q.size(); ++i) {
      if (q.up[i] < 3 * dx) bottom_z.push_back(q.up[i]), bottom_v.push_back(q.vx[i]);
      if (q.up[i] > H - 2 * dx) top_v.push_back(q.vx[i]), top_exact.push_back(bagnold.velocity(q.up[i], H));
      if (q.up[i] < 0.5 * H) deep_z.push_back(q.up[i]), deep_p.push_back(q.p[i]);
      if (q.p[i] > 0 && q.gamma_dot[i] > 0) {
        const double law = friction(inertial_number(q.gamma_dot[i], q.p[i], grains.d, grains.rho_s));
        result.largest_mu_error = std::max(result.largest_mu_error, std::abs(q.tau[i] / q.p[i] - law));
      }
    }
    const double slip_now = Line(bottom_z, bottom_v).at_zero;
    const double ratio_now = (mean(top_v) - slip_now) / mean(top_exact);
    slip += slip_now / samples;
    surface += mean(top_v) / samples;
    exact += mean(top_exact) / samples;
    squares += ratio_now * ratio_now;
    result.floor_pressure +=
        Line(deep_z, deep_p).at_zero * area / (flow->budgets().mass * g_normal) / samples;
  }
  result.velocity_ratio = (surface - slip) / exact;
  // Neighbouring samples resemble each other; a quarter of them is taken as independent.
  result.velocity_error = std::sqrt(
      std::max(squares / samples - result.velocity_ratio * result.velocity_ratio, 0.0) / (samples / 4));
  result.slip_ratio = slip / exact;
  return result;
}

/// Lattice factor f of Eq. 5.21 in 2D (derived; tests/sph/test_kernel.cpp checks it): velocities come out
/// f^-1.5 high.
inline constexpr double factor_wendland_c2_12 = 0.96385;
inline constexpr double factor_wendland_c2_15 = 0.99740;

inline const std::string incline = R"(
[flow]
scene = "inclined_plane"
resolution = 20
end_time = "3 s"
[incline]
height = "0.1 m"
angle = "25 deg"
start = "bagnold"
)" + glass_beads;

}  // namespace dem2sph
