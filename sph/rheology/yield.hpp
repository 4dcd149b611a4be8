// From trial stress back to the yield surface tau = mu(I, beta) p + c, and the viscoplastic stress without a
// return.
//
// Return (Dunatunga and Kamrin 2015, with cohesion and beta). An elastic step has given the trial stress
// tau_tr. If it lies above the surface, the excess becomes plastic shear at the rate g:  tau_tr - tau = G dt
// g,  tau = mu(I(g)) p + c. For the rational laws with frozen beta this is a quadratic with the closed form
// below; for other laws, and with beta evolving, where g decides phi and beta as well, the same equation is
// solved by a safeguarded Newton, so that no feedback lags by a step.
//
// `Real` is double, or a kind of number with several lanes: then what would be a branch is a `choice`, and
// each lane gets its own.
#pragma once

#include <cmath>
#include <type_traits>

#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph {

/// What a grain is, as far as the inertial number needs it.
struct Grains {
  double d = 0;      ///< [m]
  double rho_s = 0;  ///< [kg/m^3]
};

/// Result of a return: equivalent stress [Pa] and plastic shear rate [1/s].
template <class Real = double>
struct Returned {
  Real tau = 0;
  Real gamma_dot = 0;
};

/// `yes` where m holds, else `no`. Numbers with lanes bring a `select` of their own.
template <class Truth, class Real>
Real choice(const Truth& m, const Real& yes, const Real& no) {
  if constexpr (std::is_same_v<Truth, bool>)
    return m ? yes : no;
  else
    return select(m, yes, no);
}
/// The first within the surface, the second beyond it.
template <class Truth, class Real>
Returned<Real> choice(const Truth& m, const Returned<Real>& yes, const Returned<Real>& no) {
  return {choice(m, yes.tau, no.tau), choice(m, yes.gamma_dot, no.gamma_dot)};
}

/// Strength mu(I, g, beta) p + c [Pa] at the plastic rate gamma_dot [1/s] with frozen beta. Where p = 0 only
/// the cohesion is left: mu is not evaluated there, I would be infinite.
template <class Law>
double strength(const Law& law, const Grains& grains, double gamma_dot, double p, double beta,
                double cohesion) {
  if (p <= 0) return cohesion;
  const double I = inertial_number(gamma_dot, p, grains.d, grains.rho_s);
  return (steady_friction(law, I, gamma_dot) + beta) * p + cohesion;
}

/// Closed form for a strength S that no rate changes. Below zero it is none: a stress has no sign. Like those
/// below it is written so that a NaN fails closed: a trial that cannot be compared is not taken for elastic.
template <class Real>
Returned<Real> return_constant(const std::type_identity_t<Real>& S, const Real& tau_trial, double G_dt) {
  const Real tau = choice(S < Real(0), Real(0), S) + 0 * tau_trial;  // a NaN of the trial shows
  return choice(tau_trial <= S, Returned<Real>{tau_trial, Real(0)},
                Returned<Real>{tau, (tau_trial - tau) / G_dt});
}

/// Closed form for a strength S0 + (S2 - S0) G dt g/(G dt g + alpha) [Pa], with S0 that at rest, S2 that at
/// very fast shear, and alpha [Pa] the stress G dt g at which half of the range is reached.
template <class Real>
Returned<Real> return_hyperbolic(const std::type_identity_t<Real>& S0, const std::type_identity_t<Real>& S2,
                                 const std::type_identity_t<Real>& alpha, const Real& tau_trial,
                                 double G_dt) {
  using std::sqrt;
  // In units of the largest stress, so that no product of two stresses underflows as p -> 0.
  Real unit = tau_trial;
  unit = choice(S2 > unit, S2, unit);
  unit = choice(alpha > unit, alpha, unit);
  const Real part = alpha / unit;
  const Real B = (S2 + tau_trial + alpha) / unit;
  const Real H = S2 * (tau_trial / unit) + S0 * part;
  // B^2 - 4 H, and the drop x = tau_trial - tau from x^2 + c x - (tau_trial - S0) alpha = 0, without the
  // differences of nearly equal numbers that would make the root NaN, or the rate noise, where alpha is small
  // or tau_trial near S2.
  const Real c = (alpha + S2 - tau_trial) / unit;
  const Real product = (tau_trial - S0) * part;
  const Real root = sqrt(c * c + 4 * (product / unit));
  const Real tau = 2 * H / (B + root);
  const Real drop = choice(c > Real(0), 2 * product / (c + root), 0.5 * (root - c) * unit);
  // With beta below -mu there is no strength, and a stress has no sign.
  const Returned<Real> flowing =
      choice(tau < Real(0), Returned<Real>{Real(0), tau_trial / G_dt}, Returned<Real>{tau, drop / G_dt});
  return choice(tau_trial <= S0, Returned<Real>{tau_trial, Real(0)}, flowing);
}

/// Closed form for the rational law with frozen beta. p >= 0 [Pa], G_dt = G dt [Pa s], cohesion [Pa].
template <class Real>
Returned<Real> return_rational(const RationalFriction<double>& law, const Grains& grains,
                               const Real& tau_trial, const std::type_identity_t<Real>& p, double G_dt,
                               const std::type_identity_t<Real>& beta, double cohesion) {
  using std::sqrt;
  return return_hyperbolic((law.mu_l + beta) * p + cohesion, (law.mu_h + beta) * p + cohesion,
                           G_dt * law.D_star / grains.d * sqrt(p / grains.rho_s), tau_trial, G_dt);
}

/// Slower than this [1/s] is no motion: a law without a yield stress carries less than its strength at this
/// rate as if at rest. The largest trial that Barker and Gray's creep branch carries so is some 0.05 p.
inline constexpr double gamma_dot_of_rest = 1e-290;

/// Safeguarded Newton for tau_tr - tau = G dt g with any `strength_at(g)` [Pa] that does not fall as g rises.
/// Stops when the bracket or the residual is at rounding level; every third turn halves the bracket if need
/// be, so 200 turns always suffice. A bracket over decades is halved in its logarithm: the rate of a creep
/// law may be 1e-200 of what the trial allows.
template <class Strength>
Returned<> return_by_newton(double tau_trial, double G_dt, const Strength& strength_at) {
  double low = gamma_dot_of_rest;
  if (tau_trial <= strength_at(low)) return {tau_trial, 0};
  double high = tau_trial / G_dt;
  const auto residual = [&](double g) { return tau_trial - G_dt * g - strength_at(g); };
  double g = 0.5 * high;
  double previous_g = high;
  double previous_r = residual(high);
  const auto wide = [&] { return high > 64 * low; };
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
      if (high - low > 0.25 * width || (i > 8 && wide())) next = low;
      width = high - low;
    }
    previous_g = g;
    previous_r = r;
    g = next > low && next < high ? next
        : i > 8 && wide()         ? std::sqrt(low) * std::sqrt(high)
                                  : 0.5 * (low + high);
  }
  // Not tau_trial - G_dt g, which has lost all its digits where the trial is far outside. A strength below
  // zero is none.
  const double tau = strength_at(g);
  return {tau < 0 ? 0 : tau > tau_trial ? tau_trial : tau, g};
}

/// Laws with a closed return. They are plain arithmetic too, so that `Real` may have lanes.
template <class Law>
inline constexpr bool has_closed_return =
    std::is_same_v<Law, ConstantFriction<double>> || std::is_same_v<Law, RationalFriction<double>> ||
    std::is_same_v<Law, RationalRateFriction<double>>;

/// The return for any friction law with frozen beta: in closed form where there is one. tau_trial and
/// cohesion [Pa], p >= 0 [Pa] (in tension there is no strength to return to: the caller cuts it off), G_dt =
/// G dt [Pa s].
template <class Law, class Real>
Returned<Real> return_to_yield(const Law& law, const Grains& grains, const Real& tau_trial,
                               const std::type_identity_t<Real>& p, double G_dt,
                               const std::type_identity_t<Real>& beta, double cohesion) {
  if constexpr (std::is_same_v<Law, ConstantFriction<double>>)
    return return_constant((law.mu + beta) * p + cohesion, tau_trial, G_dt);
  else if constexpr (std::is_same_v<Law, RationalFriction<double>>)
    return return_rational(law, grains, tau_trial, p, G_dt, beta, cohesion);
  else if constexpr (std::is_same_v<Law, RationalRateFriction<double>>)
    return return_hyperbolic((law.mu_l + beta) * p + cohesion, (law.mu_h + beta) * p + cohesion,
                             Real(G_dt * law.D_star), tau_trial, G_dt);
  else
    return return_by_newton(tau_trial, G_dt,
                            [&](double g) { return strength(law, grains, g, p, beta, cohesion); });
}

/// What of beta enters mu: a share of it, within limits. A state that evolves is never clipped.
struct DilationLimits {
  double lowest = -0.5;
  double highest = 0.5;
  double share = 1;  ///< as measured in DEM; 1 is Eq. 5.7
  template <class Real>
  Real operator()(const Real& beta) const {
    const Real part = share * beta;  // a NaN stays one
    return choice(part < Real(lowest), Real(lowest), choice(part > Real(highest), Real(highest), part));
  }
};

/// What a particle carries: the state of its dilation law (which one, the law says), and the I at which it
/// was.
struct DilationState {
  double value = 0;
  double I = 0;
};

/// End of an increment: the new state, and the beta that enters mu there, within its limits.
struct DilationStep {
  DilationState state;
  double beta = 0;
};

/// phi is the state: d(phi)/ds = -(phi - phi_eq(I))/s*, beta = (1 - phi_eq/phi)/s*, with a scale s* for each
/// side of phi_eq.
struct RelaxingSolidFraction {
  using Step = DilationStep;
  SteadySolidFraction phi_eq;
  double s_star = 0;  ///< where phi > phi_eq: dilating
  DilationLimits limits;
  double s_star_compacting = s_star;  ///< where phi < phi_eq

  DilationState start(double phi_0) const { return {phi_0, 0}; }
  /// After the shear strain ds, in which phi_eq goes linearly from that of the state to that of I. ds = 0:
  /// the beta of the state itself at I.
  Step after(const DilationState& state, double I, double ds) const {
    const double equilibrium = phi_eq(I);
    const double phi = relax_solid_fraction_two_sided(state.value, phi_eq(state.I), equilibrium, ds, s_star,
                                                      s_star_compacting);
    return {
        {phi, I},
        limits(dilation_rate(phi, equilibrium, strain_scale(phi, equilibrium, s_star, s_star_compacting)))};
  }
};

/// beta is the state, as printed in Eq. 5.22 (given), with the source that phi would give it, times `gain`:
/// S s* = A (b/phi_c) dI/ds. b dI is taken as the fall of phi_eq, which is the same down to the floor of
/// phi_eq and stays bounded there as p -> 0 and I diverges.
struct PrintedDilation {
  using Step = DilationStep;
  SteadySolidFraction phi_eq;
  double s_star = 0;
  double gain = 1;  ///< A; 1 ties the source to the relaxation of phi
  DilationLimits limits;

  DilationState start(double phi_0) const { return {dilation_rate(phi_0, phi_eq(0.0), s_star), 0}; }
  Step after(const DilationState& state, double I, double ds) const {
    const double jump = gain * (phi_eq(state.I) - phi_eq(I)) / (phi_eq.phi_c() * s_star);
    const double beta = relax_dilation_rate_ramp(state.value, jump, ds / s_star);
    return {{beta, I}, limits(beta)};
  }
};

/// beta straight from the velocity field, Eq. 5.13 (reconstructed), its limits given in words: tr(D)/|g|, no
/// less than 0 and no more than 0.5; 0 where nothing shears. trace and gamma_dot in 1/s.
template <class Real>
Real direct_dilation(const Real& trace, const std::type_identity_t<Real>& gamma_dot,
                     const DilationLimits& limits = {0, 0.5}) {
  return choice(gamma_dot <= Real(0), Real(0), limits(trace / gamma_dot));
}

}  // namespace dem2sph
