// Solid fraction and dilation: phi_eq(I), and how phi and beta relax after a change (Eq. 5.22, closed from
// DEM).
//
//   steady:     phi_eq(I) = phi_c - b I (linear; power and rational beside it)
//   transient:  d(phi)/ds = -(phi - phi_eq)/s*      =>      beta = -(1/phi) d(phi)/ds = (1 - phi_eq/phi)/s*
//
// An example: s* = 0.4, phi_eq = 0.585. A sample packed to 0.61 starts with beta = (1 - 0.585/0.61)/0.4 =
// 0.10: it dilates and is stronger by 0.10 in mu; after a strain of 0.4 the excess has fallen to 37 % of
// that. phi is the state, not beta: the updates below are exact, for constant I and for phi_eq linear within
// the increment, stable for every increment, and the integral of beta over strain is ln(phi_1/phi_2) to
// rounding.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <variant>

#include "sph/rheology/power.hpp"

namespace dem2sph {

/// Where every steady law ends: as p -> 0, I diverges, and a law that falls without limit would turn
/// negative. 0.4 is far below any dense flow; where it acts beta is that of a gas, which mu limits anyway.
inline constexpr double least_solid_fraction = 0.4;

/// phi, or the floor; a NaN stays one.
template <class T>
T with_floor(const T& phi, double phi_min) {
  return phi < phi_min ? T(phi_min) : phi;
}

/// Linear solid fraction phi_eq = phi_c - b I, I >= 0 (da Cruz et al. 2005).
template <class T>
struct LinearSolidFraction {
  static constexpr const char* name = "linear";
  static constexpr std::array<const char*, 2> parameters{"phi_c", "b"};
  T phi_c{};
  T b{};
  double phi_min = least_solid_fraction;

  template <class U>
  auto operator()(const U& I) const {
    return with_floor(phi_c - b * I, phi_min);
  }
};

/// Power law phi_eq = phi_c - a I^n, n > 0.
template <class T>
struct PowerSolidFraction {
  static constexpr const char* name = "power";
  static constexpr std::array<const char*, 3> parameters{"phi_c", "a", "n"};
  T phi_c{};
  T a{};
  T n{};
  double phi_min = least_solid_fraction;

  template <class U>
  auto operator()(const U& I) const {
    return with_floor(phi_c - a * power_of_I(I, n), phi_min);
  }
};

/// Rational solid fraction phi_eq = phi_c - b I/(1 + I/I_phi): starts with the slope of the linear law and
/// bends where I nears I_phi, as it does where grains collide.
template <class T>
struct RationalSolidFraction {
  static constexpr const char* name = "rational";
  static constexpr std::array<const char*, 3> parameters{"phi_c", "b", "I_phi"};
  T phi_c{};
  T b{};
  T I_phi{};
  double phi_min = least_solid_fraction;

  template <class U>
  auto operator()(const U& I) const {
    return with_floor(phi_c - b * I_phi * (I / (I + I_phi)), phi_min);
  }
};

/// Any member, called like one: chosen when a flow is set up, looked up once a particle and step.
struct SteadySolidFraction {
  std::variant<LinearSolidFraction<double>, PowerSolidFraction<double>, RationalSolidFraction<double>> law;

  double operator()(double I) const {
    return std::visit([I](const auto& member) { return member(I); }, law);
  }
  double phi_c() const {
    return std::visit([](const auto& member) { return member.phi_c; }, law);
  }
  double phi_min() const {
    return std::visit([](const auto& member) { return member.phi_min; }, law);
  }
};

/// phi after the strain increment ds >= 0 at constant I: exact solution of d(phi)/ds = -(phi - phi_eq)/s*.
template <class T, class U, class S>
auto relax_solid_fraction(const T& phi, const U& phi_eq, const S& ds_over_s_star) {
  using std::exp;
  return phi_eq + (phi - phi_eq) * exp(-ds_over_s_star);
}

/// (1 - e^-x)/x for x >= 0, what an increment keeps of a change that is spread evenly over it; 1 at x = 0.
/// Below 0.1 by its series, the first term left out being 0.1^10/11! = 3e-18: neither 0/0, nor a derivative
/// of nearly equal terms.
template <class X>
X kept_of_a_ramp(const X& x) {
  using std::expm1;
  if (x < 0.1) {
    X sum = X(1.0);
    for (int k = 10; k > 1; --k) sum = 1.0 - sum * x / static_cast<double>(k);
    return sum;
  }
  return -expm1(-x) / x;
}

/// phi after the increment x = ds/s* >= 0 in which phi_eq goes linearly from phi_eq_0 to phi_eq_1: exact
/// solution of d(phi)/dx = -(phi - phi_eq(x)). At x = 0, a sudden change of phi_eq, phi stays.
template <class T, class U, class S>
auto relax_solid_fraction_ramp(const T& phi, const U& phi_eq_0, const U& phi_eq_1, const S& x) {
  using std::exp;
  return phi_eq_1 - (phi_eq_1 - phi_eq_0) * kept_of_a_ramp(x) + (phi - phi_eq_0) * exp(-x);
}

/// Where phi relaxes over another strain from below phi_eq (compacting) than from above (dilating).
template <class T, class U, class S>
S strain_scale(const T& phi, const U& phi_eq, const S& s_star, const S& s_star_compacting) {
  return phi < phi_eq ? s_star_compacting : s_star;
}

/// phi after the strain ds >= 0 in which phi_eq goes linearly from phi_eq_0 to phi_eq_1, with the scale of
/// the side of their mean on which phi lies. Exact for constant phi_eq and for equal scales; continuous in
/// phi, ds and phi_eq also where the side changes: the lag behind the ramp always has the scale s_star.
template <class T, class U, class S>
auto relax_solid_fraction_two_sided(const T& phi, const U& phi_eq_0, const U& phi_eq_1, const S& ds,
                                    double s_star, double s_star_compacting) {
  using std::exp;
  const auto mean = phi_eq_0 + 0.5 * (phi_eq_1 - phi_eq_0);
  return relax_solid_fraction_ramp(mean, phi_eq_0, phi_eq_1, ds / s_star) +
         (phi - mean) * exp(-ds / strain_scale(phi, mean, s_star, s_star_compacting));
}

/// beta = (1 - phi_eq/phi)/s*: the closure of Eq. 5.22 with phi as the state (theory: "carry phi, not beta").
template <class T, class U, class S>
auto dilation_rate(const T& phi, const U& phi_eq, const S& s_star) {
  return (1.0 - phi_eq / phi) / s_star;
}

/// The printed form of Eq. 5.22 (given), d(beta)/ds = -beta/s* + S, over an increment with constant source S.
/// x = ds/s*; expm1 keeps it exact for x -> 0.
template <class T, class U, class S, class V>
auto relax_dilation_rate(const T& beta, const U& source, const S& s_star, const V& ds) {
  using std::exp;
  using std::expm1;
  const auto x = ds / s_star;
  return beta * exp(-x) - source * s_star * expm1(-x);
}

/// The printed form over an increment x = ds/s* in which I is linear. With S s* = A (b/phi_c) dI/ds the
/// source adds, in all, jump = A b (I_1 - I_0)/(phi_c s*), of which the relaxation leaves (1 - e^-x)/x. At x
/// = 0, a sudden change of I, beta jumps by the whole of it.
template <class T, class U, class S>
auto relax_dilation_rate_ramp(const T& beta, const U& jump, const S& x) {
  using std::exp;
  return beta * exp(-x) + jump * kept_of_a_ramp(x);
}

}  // namespace dem2sph
