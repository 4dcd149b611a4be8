// Boxes of particles without a scene: lattices and disordered blocks, free or periodic in all directions.
#pragma once

#include <array>
#include <random>

#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {

/// rho0 = 1500 kg/m^3, dx = 1 cm, K/rho0 = (10 m/s)^2: K = 150 kPa, and G = 60 kPa of `robust`.
inline const std::string box_case = R"(
[flow]
scene = "plane_shear"
resolution = 10
sound_speed = "10 m/s"
end_time = "1 s"
[shear]
height = "0.1 m"
shear_rate = "1 1/s"
pressure = "1000 Pa"
)" + glass_beads;

/// A box of cells[0] x cells[1] (x cells[2]) particles from 0 on, at rest, under p0; no walls, no gravity.
template <int Dim>
FlowSetup<Dim> box_of(const std::vector<std::string>& overrides, const std::array<long, 3>& cells, double p0,
                      bool periodic) {
  std::vector<std::string> all = overrides;
  all.push_back("flow.dimension=" + std::to_string(Dim));
  const CaseFile file = case_of(box_case, all);
  FlowSetup<Dim> setup = make_setup<Dim>(file, law_of_case(file));
  setup.walls.clear();
  setup.gravity = Vec<Dim>{};
  setup.skin = 0.02;  // next to nothing moves
  std::size_t count = 1;
  for (int k = 0; k < Dim; ++k) {
    const long n = cells[static_cast<std::size_t>(k)];
    count *= static_cast<std::size_t>(n);
    setup.period.length[k] =
        periodic ? static_cast<double>(n) * setup.dx : std::numeric_limits<double>::infinity();
  }
  Particles<Dim>& q = setup.particles;
  q = Particles<Dim>{};
  q.resize(count, count);
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t rest = i;
    for (std::size_t k = 0; k < Dim; ++k) {
      const auto n = static_cast<std::size_t>(cells[k]);
      q.x[k][i] = (static_cast<double>(rest % n) + 0.5) * setup.dx;
      rest /= n;
    }
    q.id[i] = static_cast<std::int64_t>(i);
    q.p[i] = p0;
    q.rho[i] = setup.eos.density(p0);
    q.m[i] = q.rho[i] * std::pow(setup.dx, Dim);
  }
  return setup;
}

/// Moves interior particles by up to `amplitude` dx in each direction.
template <int Dim>
void jitter(FlowSetup<Dim>& setup, double amplitude, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-amplitude * setup.dx, amplitude * setup.dx);
  for (std::size_t i = 0; i < setup.particles.interior; ++i)
    for (auto& x : setup.particles.x) x[i] += uniform(random);
}

/// Random velocities of that size.
template <int Dim>
void stir(FlowSetup<Dim>& setup, double speed, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, speed);
  for (std::size_t i = 0; i < setup.particles.interior; ++i)
    for (auto& v : setup.particles.v) v[i] += normal(random);
}

/// A step that stays below all sound bounds: `factor` 0.25 h over the longitudinal speed at rho0.
template <int Dim>
double sound_step(const FlowSetup<Dim>& setup, double factor) {
  const ElasticReturn* elastic = std::get_if<ElasticReturn>(&setup.parts.stress);
  const double M = setup.eos.K + 4.0 / 3 * (elastic != nullptr ? elastic->G : 0);
  return factor * 0.25 * setup.h / std::sqrt(M / setup.eos.rho0);
}

/// Interior particles of a frame by their id.
template <int Dim>
struct ById {
  std::vector<Vec<Dim>> x, v;
  std::vector<double> p, tau;
  explicit ById(const Frame& frame) {
    const auto& kind = frame.field("kind").values;
    const auto& id = frame.field("id").values;
    std::size_t interior = 0;
    for (const double k : kind) interior += k == 0 ? 1 : 0;
    x.resize(interior), v.resize(interior), p.resize(interior), tau.resize(interior);
    for (std::size_t i = 0; i < kind.size(); ++i) {
      if (kind[i] != 0) continue;
      const auto at = static_cast<std::size_t>(id[i]);
      for (std::size_t k = 0; k < Dim; ++k) {
        x[at].c[k] = frame.field("x").values[3 * i + k];
        v[at].c[k] = frame.field("v").values[3 * i + k];
      }
      p[at] = frame.field("p").values[i];
      tau[at] = frame.field("mu").values[i] * p[at];
    }
  }
};

}  // namespace dem2sph
