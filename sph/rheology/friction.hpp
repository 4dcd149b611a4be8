// The friction law mu(I, beta) of Eqs. 5.7 and 5.8 (reconstructed), written once for every scalar:
// the solver calls it with double, the fit with Ceres' Jets, the report with double.
//
//   mu = mu_l + (mu_h - mu_l) I/(I + D*) + beta
//
// With mu_l = 0.38, mu_h = 0.64, D* = 0.279: a slow flow (I -> 0) has 0.38, at I = D* half of the range is
// reached, 0.51. In most of the literature the three are called mu_s, mu_2 and I_0 (Jop, Forterre, Pouliquen
// 2006).
//
// The law is one of a family. Every member has
//   name, parameters    as in a law file; the parameters in the order in which they make the law
//   law(I)              the steady friction coefficient; law(I, gamma_dot) of a member of the rate
//   slope(x)            its derivative by I, or by gamma_dot [s] for a member of the rate
//   of_rate             whether gamma_dot decides instead of I
//   has_yield_stress    whether mu > 0 at rest: without, nothing ever stands still, it creeps
#pragma once

#include <array>
#include <cmath>
#include <concepts>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>

#include "sph/rheology/power.hpp"
#include "sph/rheology/well_posedness.hpp"

namespace dem2sph {

/// Inertial number I = |g| d / sqrt(p/rho_s): the time a grain needs to fall into a hole, times the shear
/// rate. gamma_dot [1/s], p > 0 [Pa], d [m], rho_s [kg/m^3]. Formed as x/sqrt(p), x = g d sqrt(rho_s): it is
/// finite for every representable p > 0, so I/(I + D*) never becomes infinity over infinity as p -> 0.
template <class T>
T inertial_number(const T& gamma_dot, const T& p, double d, double rho_s) {
  using std::sqrt;
  return gamma_dot * (d * std::sqrt(rho_s)) / sqrt(p);
}

/// Coulomb friction: mu whatever the rate. The limit that rate-dependent laws are compared with.
template <class T>
struct ConstantFriction {
  static constexpr const char* name = "constant";
  static constexpr std::array<const char*, 1> parameters{"mu"};
  static constexpr bool of_rate = false;
  static constexpr bool has_yield_stress = true;
  T mu{};

  template <class U>
  auto operator()(const U& I) const {
    return decltype(mu + I)(mu);
  }
  /// d(mu)/dI = 0.
  template <class U>
  auto slope(const U& I) const {
    return decltype(mu + I)(0.0);
  }
};

/// Rational friction, Eq. 5.8 (reconstructed): mu_h >= mu_l, D_star > 0, all dimensionless.
template <class T>
struct RationalFriction {
  static constexpr const char* name = "rational";
  static constexpr std::array<const char*, 3> parameters{"mu_l", "mu_h", "D_star"};
  static constexpr bool of_rate = false;
  static constexpr bool has_yield_stress = true;
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

/// Exponential approach to mu_h: mu = mu_l + (mu_h - mu_l)(1 - exp(-I/D*)), mu_h >= mu_l, D_star > 0. It
/// starts with the slope of the rational law and saturates much sooner.
template <class T>
struct ExponentialFriction {
  static constexpr const char* name = "exponential";
  static constexpr std::array<const char*, 3> parameters{"mu_l", "mu_h", "D_star"};
  static constexpr bool of_rate = false;
  static constexpr bool has_yield_stress = true;
  T mu_l{};
  T mu_h{};
  T D_star{};

  template <class U>
  auto operator()(const U& I) const {
    using std::expm1;
    return mu_l - (mu_h - mu_l) * expm1(-(I / D_star));
  }
  template <class U>
  auto slope(const U& I) const {
    using std::exp;
    return (mu_h - mu_l) / D_star * exp(-(I / D_star));
  }
};

/// Power law mu = mu_l + a I^n, a >= 0, n > 0 (n = 0.5: Hatano 2007; 1: linear). It has no upper limit.
template <class T>
struct PowerFriction {
  static constexpr const char* name = "power";
  static constexpr std::array<const char*, 3> parameters{"mu_l", "a", "n"};
  static constexpr bool of_rate = false;
  static constexpr bool has_yield_stress = true;
  T mu_l{};
  T a{};
  T n{};

  template <class U>
  auto operator()(const U& I) const {
    return mu_l + a * power_of_I(I, n);
  }
  /// Infinite at I = 0 for n < 1.
  template <class U>
  auto slope(const U& I) const {
    using Result = decltype(mu_l + a * I);
    if (I == 0.0) {
      if (n < 1.0) return Result(std::numeric_limits<double>::infinity());
      return Result(n > 1.0 ? 0.0 * a : 1.0 * a);
    }
    return Result(a * n * power_of_I(I, n - 1.0));
  }
};

/// Straight line mu = mu_l + rise I, rise >= 0 (da Cruz et al. 2005 for slow flows). It has no upper limit.
template <class T>
struct LinearFriction {
  static constexpr const char* name = "linear";
  static constexpr std::array<const char*, 2> parameters{"mu_l", "rise"};
  static constexpr bool of_rate = false;
  static constexpr bool has_yield_stress = true;
  T mu_l{};
  T rise{};

  template <class U>
  auto operator()(const U& I) const {
    return mu_l + rise * I;
  }
  template <class U>
  auto slope(const U& I) const {
    return decltype(rise * I)(rise);
  }
};

/// The other reading of D* in Eq. 5.8 (reconstructed): a rate [1/s], mu = mu_l + (mu_h - mu_l) g/(g + D*). It
/// makes the shear rate the same at every depth of a flow down an incline, so the velocity profile is linear
/// there, where Bagnold's has the power 1.5. There is no call with I alone, on purpose.
template <class T>
struct RationalRateFriction {
  static constexpr const char* name = "rational_rate";
  static constexpr std::array<const char*, 3> parameters{"mu_l", "mu_h", "D_star"};
  static constexpr bool of_rate = true;
  static constexpr bool has_yield_stress = true;
  T mu_l{};
  T mu_h{};
  T D_star{};  ///< [1/s]

  template <class U>
  auto operator()(const U& /*I*/, const U& gamma_dot) const {
    return mu_l + (mu_h - mu_l) * (gamma_dot / (gamma_dot + D_star));
  }
  /// d(mu)/d(gamma_dot) [s].
  template <class U>
  auto slope(const U& gamma_dot) const {
    const auto sum = gamma_dot + D_star;
    return (mu_h - mu_l) * D_star / (sum * sum);
  }
};

/// The rational law with an additional rise mu_inf I at large I, (mu_s I_0 + mu_2 I + mu_inf I^2)/(I_0 + I):
/// the flowing branch of Barker and Gray 2017, which keeps fast flows well posed. Written without I^2, which
/// overflows as p -> 0.
template <class T>
struct BarkerGrayFlowing {
  static constexpr bool of_rate = false;
  T mu_s{};
  T mu_2{};
  T I_0{};
  T mu_inf{};

  template <class U>
  auto operator()(const U& I) const {
    return mu_s + (mu_2 - mu_s + mu_inf * I) * (I / (I_0 + I));
  }
  template <class U>
  auto slope(const U& I) const {
    const auto sum = I_0 + I;
    return (mu_2 - mu_s + mu_inf * I) * (I_0 / sum / sum) + mu_inf * (I / sum);
  }
};

/// The partially regularised law of Barker and Gray, JFM 828 (2017), section 6:
///   I <= I_N:  mu = sqrt(alpha/ln(A/I))                                  creep, no yield stress: mu(0) = 0
///   I >  I_N:  mu = (mu_s I_0 + mu_2 I + mu_inf I^2)/(I_0 + I)           flowing
/// A makes mu continuous at I_N; its slope jumps there. I_N is the lower neutral point of the flowing branch,
/// where C = 0, so that the whole is well posed from rest up. (Barker and Gray take I_N of the law without
/// mu_inf, 1 % larger for their values, and inside the well-posed range of the one with it.) With 0.383,
/// 0.644, 0.279, 0.05, 1.9: I_N = 0.0194, A = 2781. A slope below mu_s flows, but how slowly: at tan = 0.2,
/// I = A exp(-alpha/0.04) = 7e-18.
template <class T>
struct BarkerGray2017 {
  static constexpr const char* name = "barker_gray_2017";
  static constexpr std::array<const char*, 5> parameters{"mu_s", "mu_2", "I_0", "mu_inf", "alpha"};
  static constexpr bool of_rate = false;
  static constexpr bool has_yield_stress = false;
  BarkerGrayFlowing<T> flowing;
  T alpha;
  double I_N;
  T log_A;  ///< ln(A): A/I itself overflows for a tiny I

  /// Finds I_N. Throws std::invalid_argument if the flowing branch has no such point, or if the creep branch
  /// would not be well posed up to it (alpha must be below 2, and a little less for a mu near 1).
  BarkerGray2017(double mu_s, double mu_2, double I_0, double mu_inf,
                 double alpha_) requires std::same_as<T, double>
      : BarkerGray2017(mu_s, mu_2, I_0, mu_inf, alpha_, neutral_point({mu_s, mu_2, I_0, mu_inf})) {
    if (!(alpha > 0)) throw std::invalid_argument("alpha is not positive");
    if (!(well_posedness(*this, I_N) <= 0))
      throw std::invalid_argument("alpha is too large for a well-posed creep branch");
  }
  /// With an I_N found before, held fixed: for scalars that carry derivatives.
  BarkerGray2017(const T& mu_s, const T& mu_2, const T& I_0, const T& mu_inf, const T& alpha_, double I_N_)
      : flowing{mu_s, mu_2, I_0, mu_inf}, alpha(alpha_), I_N(I_N_) {
    const T mu = flowing(I_N);
    log_A = std::log(I_N) + alpha / (mu * mu);
  }

  template <class U>
  auto operator()(const U& I) const {
    using std::log;
    using std::sqrt;
    using Result = decltype(alpha * I);
    if (I > I_N) return Result(flowing(I));
    if (I == 0.0) return Result(0.0);  // so that no derivative is 0 times infinity
    return Result(sqrt(alpha / (log_A - log(I))));
  }
  /// d(mu)/dI, infinite at I = 0: mu/(2 I ln(A/I)) in creep.
  template <class U>
  auto slope(const U& I) const {
    using std::log;
    using Result = decltype(alpha * I);
    if (I > I_N) return Result(flowing.slope(I));
    if (I == 0.0) return Result(std::numeric_limits<double>::infinity());
    return Result((*this)(I) / (log_A - log(I)) / I / 2.0);
  }

 private:
  static double neutral_point(const BarkerGrayFlowing<double>& law) {
    if (!(law.mu_s > 0 && law.mu_2 >= law.mu_s && law.I_0 > 0 && law.mu_inf >= 0))
      throw std::invalid_argument("needs mu_s > 0, mu_2 >= mu_s, I_0 > 0 and mu_inf >= 0");
    const WellPosedRange range = well_posed_range(law);
    if (range.empty()) throw std::invalid_argument("the flowing branch is well posed nowhere");
    return range.low;
  }
};

using FrictionLaw = std::variant<ConstantFriction<double>, RationalFriction<double>,
                                 RationalRateFriction<double>, ExponentialFriction<double>,
                                 PowerFriction<double>, LinearFriction<double>, BarkerGray2017<double>>;

/// A member from its parameters in order: an aggregate, or, for barker_gray_2017 with double, its
/// constructor.
template <class Law, class T, std::size_t N>
Law make_law(const std::array<T, N>& values) {
  static_assert(N == Law::parameters.size());
  return [&]<std::size_t... i>(std::index_sequence<i...>) { return Law{values[i]...}; }
  (std::make_index_sequence<N>{});
}

/// The member of `Family`, a variant of laws, that has this name; its parameters are asked for by theirs.
/// Nothing if there is no such member.
template <class Family, class ValueOf>
std::optional<Family> law_by_name(std::string_view name, const ValueOf& value_of) {
  std::optional<Family> found;
  const auto try_member = [&]<class Member>(std::type_identity<Member>) {
    if (name != Member::name) return;
    std::array<double, Member::parameters.size()> values{};
    for (std::size_t k = 0; k < values.size(); ++k) values[k] = value_of(Member::parameters[k]);
    found = make_law<Member>(values);
  };
  [&]<class... Members>(std::type_identity<std::variant<Members...>>) {
    (try_member(std::type_identity<Members>{}), ...);
  }(std::type_identity<Family>{});
  return found;
}

/// mu(I, beta), Eq. 5.7 (reconstructed): the steady law plus the rate of dilation beta = tr(D)/|g|. For a
/// member that depends on I alone.
template <class Law, class U, class B>
auto friction(const Law& law, const U& I, const B& beta) {
  return law(I) + beta;
}

}  // namespace dem2sph
