// A column's collapse, as measured.
#pragma once

#include <ctime>

#include "sph/base/deposit.hpp"
#include "sph/base/errors.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {

/// Sand: one friction, 0.6, as in Lube et al. (2005), whose run-out for a = 1 is 1.2 L0.
inline const std::string sand_column = R"(
[flow]
scene = "column_collapse"
resolution = 40
[column]
length = "0.2 m"
[law]
friction = "constant"
mu = 0.6
d = "5 mm"
rho_s = "2500 kg/m^3"
phi_c = 0.6
b = 0.2
s_star = 0.3
)";

struct CollapseResult {
  double front = 0;      ///< front_99 over L0
  double height = 0;     ///< centre height over L0, over 0 < x < 3 d
  double rest_time = 0;  ///< over sqrt(H0/g): kinetic energy below 1e-4 of the initial potential energy
  bool at_rest = false;
  double unaccounted = 0;  ///< energy that no term explains, over what the fall set free
  double seconds = 0;      ///< processor seconds
  long steps = 0;
  std::string stopped;  ///< the error that ended it, if one did
};

/// Runs until rest, or 10 sqrt(H0/g).
template <int Dim = 2>
CollapseResult measure_collapse(const std::string& text, const std::vector<std::string>& overrides) {
  const CaseFile file = case_of(text, overrides);
  FlowSetup<Dim> setup = make_setup<Dim>(file, law_of_case(file));
  const double L0 = setup.initial_length;
  const double dx = setup.dx;
  const double end = setup.end_time;
  const double tau = std::sqrt(setup.length_scale / norm(setup.gravity));
  const double strip = centre_strip(setup.grains.d, dx), H = setup.length_scale, g = norm(setup.gravity);
  const bool radial = setup.axisymmetric;
  auto flow = make_flow<Dim>(std::move(setup));
  const Budgets first = flow->budgets();
  CollapseResult result;
  const std::clock_t start = std::clock();
  try {
    while (flow->time() < end * (1 - 1e-12) && !result.at_rest) {
      run_until(*flow, std::min(end, flow->time() + 0.01 * end));
      result.at_rest = at_rest(flow->time(), flow->budgets().kinetic, first.potential, H, g);
    }
  } catch (const NumericalError& error) {
    result.stopped = error.what();
  }
  result.seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  const Budgets last = flow->budgets();
  result.unaccounted = last.unaccounted_since(first) / (first.potential - last.potential);
  result.rest_time = flow->time() / tau;
  result.steps = flow->steps();
  std::vector<std::array<double, 3>> positions;
  std::vector<double> volumes, x;
  flow->deposit(positions, volumes);
  for (const auto& p : positions) x.push_back(radial ? std::hypot(p[0], p[1]) : p[0]);
  const Bodies bodies{x, volumes, dx, 1};
  result.front = front_99(bodies) / L0;
  result.height = centre_height(bodies, strip, radial) / L0;
  return result;
}

}  // namespace dem2sph
