// The friction law mu(I, beta) of Eqs. 5.7 and 5.8 (reconstructed), written once for every scalar:
// the solver calls it with double, the fit with Ceres' Jets, the report with double.
//
//   mu = mu_l + (mu_h - mu_l) I/(I + D*) + beta
//
// With mu_l = 0.38, mu_h = 0.64, D* = 0.279: a slow flow (I -> 0) has 0.38, at I = D* half of the range is
// reached, 0.51. In most of the literature the three are called mu_s, mu_2 and I_0 (Jop, Forterre, Pouliquen
// 2006).
#pragma once

#include <cmath>

namespace dem2sph {

/// Inertial number I = |g| d / sqrt(p/rho_s): the time a grain needs to fall into a hole, times the shear
/// rate. gamma_dot [1/s], p > 0 [Pa], d [m], rho_s [kg/m^3].
template <class T>
T inertial_number(const T& gamma_dot, const T& p, double d, double rho_s) {
  using std::sqrt;
  return gamma_dot * d / sqrt(p / rho_s);
}

/// Rational friction, Eq. 5.8 (reconstructed): mu_h >= mu_l, D_star > 0, all dimensionless.
template <class T>
struct RationalFriction {
  T mu_l{};
  T mu_h{};
  T D_star{};

  /// Steady friction coefficient, I >= 0. At I = 0 this is mu_l, derivatives included.
  template <class U>
  auto operator()(const U& I) const {
    return mu_l + (mu_h - mu_l) * (I / (I + D_star));
  }
  /// d(mu)/dI.
  template <class U>
  auto slope(const U& I) const {
    const auto sum = I + D_star;
    return (mu_h - mu_l) * D_star / (sum * sum);
  }
};

/// mu(I, beta), Eq. 5.7 (reconstructed): the steady law plus the rate of dilation beta = tr(D)/|g|.
template <class Law, class U, class B>
auto friction(const Law& law, const U& I, const B& beta) {
  return law(I) + beta;
}

}  // namespace dem2sph
