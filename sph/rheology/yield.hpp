// From trial stress back to the yield surface tau = mu(I, beta) p + c, and the viscoplastic stress without a
// return.
//
// Return (Dunatunga and Kamrin 2015, with cohesion and beta). An elastic step has given the trial stress
// tau_tr. If it lies above the surface, the excess becomes plastic shear at the rate g:  tau_tr - tau = G dt
// g,  tau = mu(I(g)) p + c. For the rational law with frozen beta this is a quadratic with the closed form
// below; with beta evolving, g decides phi and beta as well, and the same equation is solved by a safeguarded
// Newton, so that no feedback lags by a step.
#pragma once

#include <cmath>

#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph {

/// What a grain is, as far as the inertial number needs it.
struct Grains {
  double d = 0;      ///< [m]
  double rho_s = 0;  ///< [kg/m^3]
};

/// Result of a return: equivalent stress [Pa] and plastic shear rate [1/s].
struct Returned {
  double tau = 0;
  double gamma_dot = 0;
};

/// Closed form for the rational law with frozen beta. p > 0 [Pa], G_dt = G dt [Pa s], cohesion [Pa].
/// Written so that a NaN fails closed: a trial that cannot be compared is not taken for elastic.
inline Returned return_rational(const RationalFriction<double>& law, const Grains& grains, double tau_trial,
                                double p, double G_dt, double beta, double cohesion) {
  const double S0 = (law.mu_l + beta) * p + cohesion;
  if (tau_trial <= S0) return {tau_trial, 0};
  const double S2 = (law.mu_h + beta) * p + cohesion;
  const double alpha = G_dt * law.D_star * std::sqrt(p / grains.rho_s) / grains.d;
  const double B = S2 + tau_trial + alpha;
  const double H = S2 * tau_trial + S0 * alpha;
  // B^2 - 4 H, and the drop x = tau_trial - tau from x^2 + c x - (tau_trial - S0) alpha = 0, without the
  // differences of nearly equal numbers that would make the root NaN, or the rate noise, where alpha is small
  // or tau_trial near S2.
  const double c = alpha + S2 - tau_trial;
  const double product = (tau_trial - S0) * alpha;
  const double root = std::sqrt(c * c + 4 * product);
  const double tau = 2 * H / (B + root);
  if (tau < 0)
    return {0, tau_trial / G_dt};  // beta below -mu: there is no strength, and a stress has no sign
  const double drop = c > 0 ? 2 * product / (c + root) : 0.5 * (root - c);
  return {tau, drop / G_dt};
}

/// Safeguarded Newton for tau_tr - tau = G dt g with any `strength(g)` [Pa] that does not fall as g rises.
/// Stops when the bracket or the residual is at rounding level; every third turn halves the bracket if need
/// be, so 200 turns always suffice.
template <class Strength>
Returned return_by_newton(double tau_trial, double G_dt, const Strength& strength) {
  if (tau_trial <= strength(0.0)) return {tau_trial, 0};
  double low = 0;
  double high = tau_trial / G_dt;
  const auto residual = [&](double g) { return tau_trial - G_dt * g - strength(g); };
  double g = 0.5 * high;
  double previous_g = high;
  double previous_r = residual(high);
  double width = high;  // of the bracket three turns ago
  for (int i = 0; i < 200; ++i) {
    const double r = residual(g);
    if (std::isnan(r)) return {r, r};
    // Below this the residual is rounding: of tau_trial, and of the strength, whose beta is known to eps/s*.
    if (std::abs(r) <= 1e-14 * tau_trial) break;
    (r > 0 ? low : high) = g;
    if (high - low <= 4e-16 * high) break;
    // Secant as the Newton step; bisection where it would leave the bracket or creeps along one side of it.
    double next = g - r * (g - previous_g) / (r - previous_r);
    if (i % 3 == 2) {
      if (high - low > 0.25 * width) next = low;
      width = high - low;
    }
    previous_g = g;
    previous_r = r;
    g = next > low && next < high ? next : 0.5 * (low + high);
  }
  // Not tau_trial - G_dt g, which has lost all its digits where the trial is far outside. A strength below
  // zero is none.
  const double tau = strength(g);
  return {tau < 0 ? 0 : tau, g};
}

/// Limits on the beta that enters mu; the state phi itself is never clipped.
struct DilationLimits {
  double lowest = -0.5;
  double highest = 0.5;
  double operator()(double beta) const {
    return beta < lowest ? lowest : beta > highest ? highest : beta;
  }  // NaN stays
};

/// The dilation law with phi as the state: parameters of phi_eq(I) and of the relaxation.
struct DilationLaw {
  LinearSolidFraction<double> phi_eq;
  double s_star = 0;
  DilationLimits limits;

  /// phi and the beta that enters mu after shearing at rate g for the time dt, from phi_0. I is that of the
  /// end.
  struct State {
    double phi = 0;
    double beta = 0;
  };
  State after(double phi_0, double I, double strain_increment) const {
    const double equilibrium = phi_eq(I);
    const double phi = relax_solid_fraction(phi_0, equilibrium, strain_increment / s_star);
    return {phi, limits(dilation_rate(phi, equilibrium, s_star))};
  }
};

/// Direct viscoplastic stress, Eq. 5.3 (reconstructed): the viscosity eta = (mu p + c)/max(|g|, g_min) [Pa
/// s], such that the deviatoric stress is 2 eta D'. g_min [1/s] keeps the bound 0.125 h^2 rho/eta of Eq. 5.28
/// away from zero.
inline double direct_viscosity(double mu, double p, double cohesion, double gamma_dot, double gamma_dot_min) {
  return (mu * p + cohesion) /
         (gamma_dot < gamma_dot_min ? gamma_dot_min : gamma_dot);  // a NaN rate stays one
}

}  // namespace dem2sph
