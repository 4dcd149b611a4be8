// Plane shear between rough walls without gravity: what every particle and the whole flow must agree with.
#pragma once

#include "tests/sph/flow_fixture.hpp"
#include "tests/verification/record.hpp"

namespace dem2sph {

struct ShearResult {
  double largest_mu_error = 0;  ///< of tau/p against the law at the particle's own rate and pressure
  double flowing = 0;           ///< share of particles that it was checked on
  double profile_error =
      0;  ///< largest departure of a row from a line, over the speed between the extrapolated walls
  double profile_error_all = 0;  ///< the same with the rows next to the walls
  double slip = 0;               ///< at one wall, over the speed between the walls
  double power_ratio = 0;        ///< work of the walls over what is dissipated
  double balance = 0;            ///< what the budget leaves unexplained, over the work of the walls
  double mean_pressure = 0;      ///< [Pa]
  double mean_I = 0;

  struct Bars {
    double mu = 0, profile = 0, power = 0, power_less_slip = 0;
  };
  void write(const std::string& what, const std::string& formulation, const Bars& bars) const {
    const auto add = [&](const char* quantity, double value, double bar) {
      record("plane shear", formulation, what + ": " + quantity, value, bar, "1");
    };
    const double none = std::nan("");
    add("largest error of mu against the law at the particle's rate and pressure", largest_mu_error, bars.mu);
    add("largest departure of a row from a line (two rows off the walls)", profile_error, bars.profile);
    add("the same with all rows (no bar)", profile_error_all, none);
    add("slip at a wall over the walls' speed (no bar)", slip, none);
    add("power of the walls over dissipation - 1", power_ratio - 1, bars.power);
    add("the same less the slip's power", power_ratio * (1 - 2 * slip) - 1, bars.power_less_slip);
    add("energy unaccounted over the walls' work (no bar)", balance, none);
    std::printf(
        "%s %s: mu %.2e, profile %.4f, all rows %.4f, slip %.4f, power %.4f, less slip %.4f, p %.0f Pa, I "
        "%.4f\n",
        formulation.c_str(), what.c_str(), largest_mu_error, profile_error, profile_error_all, slip,
        power_ratio, power_ratio * (1 - 2 * slip), mean_pressure, mean_I);
  }
};

template <int Dim>
ShearResult measure_shear(const CaseFile& file, double settle, double average) {
  FlowSetup<Dim> setup = make_setup<Dim>(file, law_of_case(file));
  const Grains grains = setup.grains;
  const FrictionLaw friction = setup.parts.friction;
  const double cohesion = setup.cohesion;
  const double dx = setup.dx;
  const double H = setup.length_scale;
  const double wall_speed = setup.walls[1].velocity[0] - setup.walls[0].velocity[0];
  auto flow = make_flow<Dim>(std::move(setup));
  run_until(*flow, settle);
  ShearResult result;
  const auto rows = static_cast<std::size_t>(std::lround(H / dx));
  std::vector<double> z(rows), v(rows), count(rows);
  const int samples = 40;
  double particles = 0;
  const Budgets before = flow->budgets();
  for (int k = 0; k < samples; ++k) {
    run_until(*flow, flow->time() + average / samples);
    const Interior q(flow->frame());
    for (std::size_t i = 0; i < q.size(); ++i) {
      const std::size_t row = std::min(rows - 1, static_cast<std::size_t>(q.up[i] / dx));
      z[row] += q.up[i], v[row] += q.vx[i], count[row] += 1;
      particles += 1;
      if (!(q.p[i] > 0 && q.gamma_dot[i] > 0)) continue;
      result.flowing += 1;
      const double I = inertial_number(q.gamma_dot[i], q.p[i], grains.d, grains.rho_s);
      const double law =
          std::visit([&](const auto& member) { return steady_friction(member, I, q.gamma_dot[i]); },
                     friction) +
          cohesion / q.p[i];
      result.largest_mu_error = std::max(result.largest_mu_error, std::abs(q.tau[i] / q.p[i] - law));
      result.mean_pressure += q.p[i];
      result.mean_I += I;
    }
  }
  const Budgets after = flow->budgets();
  result.mean_pressure /= result.flowing;
  result.mean_I /= result.flowing;
  result.flowing /= particles;
  const double work = after.from_walls - before.from_walls;
  result.power_ratio = work / (after.dissipated - before.dissipated);
  result.balance = after.unaccounted_since(before) / work;
  for (std::size_t r = 0; r < rows; ++r) z[r] /= count[r], v[r] /= count[r];
  const auto departure = [&](std::size_t skip) {
    const Line line(
        std::vector<double>(z.begin() + static_cast<long>(skip), z.end() - static_cast<long>(skip)),
        std::vector<double>(v.begin() + static_cast<long>(skip), v.end() - static_cast<long>(skip)));
    double largest = 0;
    for (std::size_t r = skip; r < rows - skip; ++r)
      largest = std::max(largest, std::abs(v[r] - line.at_zero - line.slope * z[r]) / (line.slope * H));
    result.slip = 0.5 * (wall_speed - line.slope * H) / wall_speed;
    return largest;
  };
  result.profile_error_all = departure(0);
  result.profile_error = departure(2);
  return result;
}

inline const std::string plane_shear = R"(
[flow]
scene = "plane_shear"
resolution = 20
end_time = "10 s"
[shear]
height = "0.1 m"
shear_rate = "12 1/s"
pressure = "1000 Pa"
)";

}  // namespace dem2sph
