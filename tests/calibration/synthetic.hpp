// Observables with a known truth, as shear cells would give them.
#pragma once

#include <fmt/format.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "dem_bridge/observables.hpp"
#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph::synthetic {

struct Truth {
  RationalFriction<double> friction{0.38, 0.64, 0.279};
  LinearSolidFraction<double> solid_fraction{0.59, 0.2};
  double s_star = 0.4;
  double beta_in_mu = 0.8;
  double transient_offset = 0.003;  // phi of the transients lies off the steady law by this

  double mu_sd = 0.003;
  double phi_sd = 0.002;
  double I_relative_sd = 0.005;
  double wander_sd = 0.0015;  // of phi in a transient
  double wander_scale = 0.15;
  double white_sd = 0.0005;
};

class Noise {
 public:
  explicit Noise(unsigned seed) : generator_(seed) {}
  double normal() { return normal_(generator_); }

 private:
  std::mt19937 generator_;
  std::normal_distribution<double> normal_;
};

inline SteadyPoint steady_point(const Truth& truth, double I, Noise& noise, const std::string& run) {
  SteadyPoint point;
  point.run = run;
  point.seed = 15485863;
  point.I_driven = I;
  point.I = I * (1 + truth.I_relative_sd * noise.normal());
  point.I_se = truth.I_relative_sd * I;
  point.mu = truth.friction(I) + truth.mu_sd * noise.normal();
  point.mu_se = truth.mu_sd;
  point.phi = truth.solid_fraction(I) + truth.phi_sd * noise.normal();
  point.phi_se = truth.phi_sd;
  point.p = 1000;
  point.p_se = 1;
  point.wall_mu = point.mu;
  point.wall_p = 1000;
  point.strain = 9;
  return point;
}

inline Transient start_up(const Truth& truth, double I, double phi_0, Noise& noise, const std::string& run,
                          double strain = 3, std::size_t samples = 120) {
  Transient t;
  t.run = run;
  t.kind = "start_up";
  t.I_driven = I;
  t.phi_0 = phi_0;
  const double ds = strain / static_cast<double>(samples);
  const double keep = std::exp(-ds / truth.wander_scale);
  double wander = truth.wander_sd * noise.normal();
  double mu_wander = 0.01 * noise.normal();
  LinearSolidFraction<double> law = truth.solid_fraction;
  law.phi_c += truth.transient_offset;
  for (std::size_t i = 0; i < samples; ++i) {
    const double s = ds * (static_cast<double>(i) + 1);
    const double phi = relax_solid_fraction(phi_0, law(I), s / truth.s_star);
    const double beta = dilation_rate(phi, law(I), truth.s_star);
    t.s.push_back(s);
    t.gamma_dot.push_back(10);
    t.p.push_back(1000);
    t.I.push_back(I);
    t.phi.push_back(phi + wander + truth.white_sd * noise.normal());
    t.beta.push_back(beta + 0.02 * noise.normal());
    t.mu.push_back(truth.friction(I) + truth.beta_in_mu * beta + mu_wander + 0.005 * noise.normal());
    t.height.push_back(0.02 * phi_0 / phi);
    wander = keep * wander + truth.wander_sd * std::sqrt(1 - keep * keep) * noise.normal();
    mu_wander = keep * mu_wander + 0.01 * std::sqrt(1 - keep * keep) * noise.normal();
  }
  return t;
}

inline Observables material() {
  Observables o;
  o.d = 1e-3;
  o.rho_s = 2500;
  o.grain_friction = 0.5;
  o.pressure = 1000;
  o.engine = "LIGGGHTS 3.8.0";
  o.material = "d = \"1 mm\"\n";
  return o;
}

/// `points` steady points, log-spaced in I, and `runs` dense start-ups at I = 0.03.
inline Observables observables(const Truth& truth, unsigned seed, std::size_t points = 12,
                               double I_low = 1e-3, double I_high = 1.0, std::size_t runs = 2) {
  Noise noise(seed);
  Observables o = material();
  for (std::size_t k = 0; k < points; ++k) {
    const double I =
        I_low * std::pow(I_high / I_low, static_cast<double>(k) / static_cast<double>(points - 1));
    o.steady.push_back(steady_point(truth, I, noise, fmt::format("steady{:02}", k)));
  }
  for (std::size_t r = 0; r < runs; ++r)
    o.transients.push_back(
        start_up(truth, 0.03, 0.615 + 0.002 * static_cast<double>(r), noise, fmt::format("start{:02}", r)));
  return o;
}

}  // namespace dem2sph::synthetic
