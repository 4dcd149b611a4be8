// Solid fraction and dilation against the exact solutions of their equations, evaluated another way and in
// long double.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

#include "sph/rheology/dilation.hpp"
#include "sph/rheology/yield.hpp"
#include "tests/rheology/jets.hpp"

namespace dem2sph {
namespace {

constexpr double eps = std::numeric_limits<double>::epsilon();
constexpr double nan_value = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

TEST(SolidFraction, RelaxesExactlyOverAnyIncrement) {
  for (const double phi : {0.61, 0.585, 0.52, 0.4})
    for (const double phi_eq : {0.585, 0.6, 0.4})
      for (double x = 1e-6; x <= 1e3; x *= 1.3) {
        // phi_eq (1 - e^-x) + phi e^-x, in long double
        const long double exact =
            -static_cast<long double>(phi_eq) * std::expm1(-static_cast<long double>(x)) +
            static_cast<long double>(phi) * std::exp(-static_cast<long double>(x));
        const double computed = relax_solid_fraction(phi, phi_eq, x);
        // 1e-12 is what the coupling may rely on; rounding of three operations is below 1e-15.
        ASSERT_NEAR(computed, static_cast<double>(exact), 1e-12 * phi);
        ASSERT_NEAR(computed, static_cast<double>(exact), 4 * eps);
      }
  EXPECT_EQ(relax_solid_fraction(0.61, 0.585, 0.0), 0.61);
  EXPECT_EQ(relax_solid_fraction(0.61, 0.585, infinity), 0.585);
}

TEST(SolidFraction, SolvesItsDifferentialEquation) {
  for (const double phi : {0.61, 0.52})
    for (double x = 1e-6; x <= 50; x *= 2) {
      const auto jet = test::relax_solid_fraction_by_jet(phi, 0.585, x);
      // d(phi)/dx = -(phi - phi_eq): the Jet's derivative against the value it came with. The difference
      // phi - phi_eq of numbers near 0.6 has an absolute rounding of eps.
      ASSERT_NEAR(jet.derivative[2], -(jet.value - 0.585), 4 * eps);
      ASSERT_NEAR(jet.derivative[0] + jet.derivative[1], 1, 4 * eps);  // a shift of both shifts the solution
      ASSERT_EQ(jet.value, relax_solid_fraction(phi, 0.585, x));
    }
}

TEST(SolidFraction, ManySmallStepsAreOneLargeStep) {
  for (const int n : {2, 10, 1000, 100000})
    for (const double total : {1e-3, 0.5, 3.0, 40.0}) {
      double phi = 0.61;
      for (int i = 0; i < n; ++i) phi = relax_solid_fraction(phi, 0.585, total / n);
      // Each step rounds phi (an ulp of 0.6 is eps/2) and the next ones damp that; exp(-total/n)^n deviates
      // from exp(-total) by n ulps at most, times phi - phi_eq = 0.025.
      ASSERT_NEAR(phi, relax_solid_fraction(0.61, 0.585, total), (n + 4) * eps) << n << " " << total;
    }
}

// Five-point Gauss-Legendre quadrature on each of `panels` panels: exact to rounding for panels of 1/20 of a
// decay.
template <class F>
double integral(const F& f, double from, double to, int panels) {
  static constexpr std::array<double, 3> node{0, 0.5384693101056830910, 0.9061798459386639928};
  static constexpr std::array<double, 3> weight{0.5688888888888888889, 0.4786286704993664680,
                                                0.2369268850561890875};
  double sum = 0;
  const double half = 0.5 * (to - from) / panels;
  for (int k = 0; k < panels; ++k) {
    const double middle = from + (2 * k + 1) * half;
    sum += half * weight[0] * f(middle);
    for (std::size_t j = 1; j < 3; ++j)
      sum += half * weight[j] * (f(middle - half * node[j]) + f(middle + half * node[j]));
  }
  return sum;
}

TEST(DilationRate, ItsIntegralIsTheLogarithmOfTheSolidFraction) {
  const double phi_eq = 0.585;
  const double s_star = 0.4;
  for (const double phi_1 : {0.61, 0.52, 0.45})
    for (const double strain : {0.01, 0.4, 4.0}) {
      const auto beta = [&](double s) {
        return dilation_rate(relax_solid_fraction(phi_1, phi_eq, s / s_star), phi_eq, s_star);
      };
      const double phi_2 = relax_solid_fraction(phi_1, phi_eq, strain / s_star);
      // 1 - phi_eq/phi cancels: eps/s* a point, times the strain; the quadrature's own error is far below.
      ASSERT_NEAR(integral(beta, 0, strain, 200), std::log(phi_1 / phi_2), 4 * eps * (1 + strain / s_star));
    }
}

TEST(DilationRate, TheExampleOfTheHeader) {
  EXPECT_NEAR(dilation_rate(0.61, 0.585, 0.4), 0.10, 0.005);  // two digits, as printed there
  EXPECT_LT(dilation_rate(0.55, 0.585, 0.4), 0);              // loose: contracting, weaker
  EXPECT_EQ(dilation_rate(0.585, 0.585, 0.4), 0);
  // After s = s*, the excess phi - phi_eq is 1/e of what it was, 37 %.
  EXPECT_NEAR((relax_solid_fraction(0.61, 0.585, 1.0) - 0.585) / 0.025, 0.367879441171442, 64 * eps);
}

TEST(DilationRate, ThePrintedFormIsExactForAConstantSource) {
  for (const double beta : {0.1, 0.0, -0.3})
    for (const double source : {0.0, 0.7, -2.0})
      for (const double s_star : {0.1, 0.4, 3.0})
        for (double ds = 1e-12; ds <= 1e3; ds *= 3) {
          const long double x = static_cast<long double>(ds) / s_star;
          const long double decay = std::exp(-x);
          const long double fresh = -std::expm1(-x) * source * s_star;
          const double exact = static_cast<double>(beta * decay + fresh);
          // Each of the two terms is rounded a few times; x carries half an ulp, which exp turns into x e^-x
          // < 0.37.
          const double scale = std::abs(beta) * static_cast<double>(decay) * (1 + static_cast<double>(x)) +
                               std::abs(static_cast<double>(fresh));
          ASSERT_NEAR(relax_dilation_rate(beta, source, s_star, ds), exact, 4 * eps * scale);
        }
}

TEST(DilationRate, ThePrintedFormKeepsItsDigitsForTinyIncrements) {
  // For ds -> 0 the source adds S ds. 1 - exp(-x) would give 0 here.
  for (const double ds : {1e-9, 1e-18, 1e-300}) {
    const double added = relax_dilation_rate(0.0, 0.7, 0.4, ds);
    // S s* (x - x^2/2): the second term is ds/(2 s*) of the first.
    EXPECT_NEAR(added / (0.7 * ds), 1, 4 * eps + ds / 0.8);
  }
  EXPECT_EQ(relax_dilation_rate(0.1, 0.7, 0.4, 0.0), 0.1);
  EXPECT_NEAR(relax_dilation_rate(0.1, 0.7, 0.4, 1e6), 0.28, 2 * eps);  // the end: S s*
  // Splitting: n roundings at most.
  double beta = 0.1;
  for (int i = 0; i < 1000; ++i) beta = relax_dilation_rate(beta, 0.7, 0.4, 1e-3);
  EXPECT_NEAR(beta, relax_dilation_rate(0.1, 0.7, 0.4, 1.0), 1000 * eps);
}

TEST(DilationRate, ThePrintedFormSolvesItsDifferentialEquation) {
  for (double ds = 1e-9; ds < 10; ds *= 3) {
    const auto jet = test::relax_dilation_rate_by_jet(0.1, 0.7, 0.4, ds);
    // d(beta)/ds = -beta/s* + S, terms of up to 0.7.
    ASSERT_NEAR(jet.derivative[3], -jet.value / 0.4 + 0.7, 8 * eps);
  }
}

TEST(EquilibriumSolidFraction, IsLinearAboveItsFloor) {
  const LinearSolidFraction<double> law{0.585, 0.1};
  EXPECT_EQ(law(0.0), 0.585);
  EXPECT_NEAR(law(0.5), 0.535, eps);
  EXPECT_EQ(law(1e6), 0.4);
  EXPECT_EQ(law(infinity), 0.4);
  EXPECT_EQ((LinearSolidFraction<double>{0.585, 0.1, 0.5}(1.0)), 0.5);
  EXPECT_TRUE(std::isnan(law(nan_value))) << "a NaN must not become the floor";
  const auto above = test::solid_fraction_by_jet(0.5, 0.585, 0.1);
  EXPECT_EQ(above.value, law(0.5));
  EXPECT_EQ(above.derivative, (std::array<double, 3>{-0.1, 1, -0.5}));
  const auto floor = test::solid_fraction_by_jet(10, 0.585, 0.1);
  EXPECT_EQ(floor.value, 0.4);
  EXPECT_EQ(floor.derivative, (std::array<double, 3>{0, 0, 0}));
}

constexpr DilationLimits no_limits{-1e300, 1e300};

// One particle that is sheared: I goes linearly from I_0 to I_1 over the increment x = ds/s*. The state y
// obeys dy/dx = -(y - q(x)) with q linear; the oracle is Duhamel's integral in long double,
//   y(x) = y_0 e^-x + int_0^x e^-(x - t) q(t) dt,
// by Gauss's five points on panels of 1/20 of a decay (error (1/40)^11 of the integrand's eleventh
// derivative, below 1e-20), from 60 decays before the end on (e^-60 = 1e-26).
template <class Q>
long double duhamel(long double y_0, const Q& q, long double x) {
  const std::array<long double, 3> node{0.0L, std::sqrt(5 - 2 * std::sqrt(10.0L / 7)) / 3,
                                        std::sqrt(5 + 2 * std::sqrt(10.0L / 7)) / 3};
  const long double root_70 = std::sqrt(70.0L);
  const std::array<long double, 3> weight{128.0L / 225, (322 + 13 * root_70) / 900,
                                          (322 - 13 * root_70) / 900};
  const long double from = x > 60 ? x - 60 : 0;
  const int panels = 1 + static_cast<int>(20 * (x - from));
  const long double half = (x - from) / panels / 2;
  long double sum = 0;
  for (int k = 0; k < panels; ++k)
    for (std::size_t j = 0; j < 3; ++j)
      for (const int side : {-1, 1}) {
        if (j == 0 && side == 1) continue;
        const long double t = from + (2 * k + 1) * half + side * half * node[j];
        sum += half * weight[j] * std::exp(t - x) * q(t);
      }
  return y_0 * std::exp(-x) + sum;
}

struct Change {
  double I_0, I_1;
};
const std::array<Change, 5> changes{{{0, 0.5}, {0.5, 0}, {0.1, 0.1}, {1e-3, 0.02}, {0.3, 1.2}}};

TEST(RelaxingSolidFraction, StepsAndRampsOfTheRateAreExact) {
  const LinearSolidFraction<double> phi_eq{0.585, 0.1};
  for (const double s_star : {0.1, 0.4})
    for (const double phi_0 : {0.61, 0.585, 0.5})
      for (const Change& change : changes)
        for (double x = 1e-6; x <= 1.01e3; x *= std::pow(10, 0.25)) {
          const RelaxingSolidFraction law{phi_eq, s_star, no_limits};
          const long double b = 0.1;
          const long double phi_c = 0.585;
          const auto beta_of = [&](long double phi) {
            return static_cast<double>((1 - (phi_c - b * change.I_1) / phi) / s_star);
          };
          // A ramp: I linear in the strain.
          const auto ramp = [&](long double t) {
            return phi_c - b * (change.I_0 + (change.I_1 - change.I_0) * t / static_cast<long double>(x));
          };
          const auto by_ramp = law.after({phi_0, change.I_0}, change.I_1, x * s_star);
          const long double exact_ramp = duhamel(phi_0, ramp, x);
          // 1e-12 is what the coupling may rely on; beta is phi's error over phi s*, at most twenty times it,
          // and phi's is a few eps.
          ASSERT_NEAR(by_ramp.state.value, static_cast<double>(exact_ramp), 1e-12) << x;
          ASSERT_NEAR(by_ramp.state.value, static_cast<double>(exact_ramp), 8 * eps) << x;
          ASSERT_NEAR(by_ramp.beta, beta_of(exact_ramp), 1e-12) << x;
          ASSERT_EQ(by_ramp.state.I, change.I_1);
          // A step: at once, then nothing changes but the strain.
          const auto jump = law.after({phi_0, change.I_0}, change.I_1, 0);
          ASSERT_EQ(jump.state.value, phi_0);
          ASSERT_NEAR(jump.beta, beta_of(phi_0), 1e-12);
          const auto by_step = law.after(jump.state, change.I_1, x * s_star);
          const long double exact_step = duhamel(
              phi_0, [&](long double) { return phi_c - b * change.I_1; }, x);
          ASSERT_NEAR(by_step.state.value, static_cast<double>(exact_step), 8 * eps) << x;
          ASSERT_NEAR(by_step.beta, beta_of(exact_step), 1e-12) << x;
        }
}

TEST(PrintedDilation, StepsAndRampsOfTheRateAreExact) {
  const LinearSolidFraction<double> phi_eq{0.585, 0.1};
  for (const double s_star : {0.1, 0.4})
    for (const double gain : {0.0, 1.0, 1.7})
      for (const double beta_0 : {0.2, 0.0, -0.3})
        for (const Change& change : changes)
          for (double x = 1e-6; x <= 1.01e3; x *= std::pow(10, 0.25)) {
            const PrintedDilation law{phi_eq, s_star, gain, no_limits};
            // d(beta)/dx = -beta + s* S, S s* = A (b/phi_c) dI/ds, and dI/ds = (I_1 - I_0)/(x s*).
            const long double rise = gain * (0.1L / 0.585L) * (change.I_1 - change.I_0) / s_star;
            const auto by_ramp = law.after({beta_0, change.I_0}, change.I_1, x * s_star);
            const long double exact_ramp = duhamel(
                beta_0, [&](long double) { return rise / x; }, x);
            ASSERT_NEAR(by_ramp.beta, static_cast<double>(exact_ramp), 1e-12) << x;
            ASSERT_EQ(by_ramp.state.value, by_ramp.beta);
            ASSERT_EQ(by_ramp.state.I, change.I_1);
            // A step is a source that is all spent at once: beta jumps by its integral, and then decays.
            const auto jump = law.after({beta_0, change.I_0}, change.I_1, 0);
            ASSERT_NEAR(jump.beta, static_cast<double>(beta_0 + rise), 1e-12);
            const auto by_step = law.after(jump.state, change.I_1, x * s_star);
            const long double exact_step = duhamel(
                beta_0 + rise, [](long double) { return 0.0L; }, x);
            ASSERT_NEAR(by_step.beta, static_cast<double>(exact_step), 1e-12) << x;
          }
}

TEST(TwoSidedRelaxation, EachSideHasItsScaleAndTheSidesJoin) {
  const RelaxingSolidFraction law{LinearSolidFraction<double>{0.585, 0.1}, 0.4, no_limits, 0.1};
  const double equilibrium = 0.575;  // at I = 0.1
  for (const double ds : {1e-4, 0.1, 3.0}) {
    const DilationStep above = law.after({0.6, 0.1}, 0.1, ds);
    EXPECT_NEAR(above.state.value, equilibrium + 0.025 * std::exp(-ds / 0.4), 4 * eps);
    EXPECT_NEAR(above.beta, (1 - equilibrium / above.state.value) / 0.4, 8 * eps / 0.4);
    const DilationStep below = law.after({0.55, 0.1}, 0.1, ds);
    EXPECT_NEAR(below.state.value, equilibrium - 0.025 * std::exp(-ds / 0.1), 4 * eps);
    EXPECT_NEAR(below.beta, (1 - equilibrium / below.state.value) / 0.1, 8 * eps / 0.1);
    // A ramp of I through the side's end: a jump of phi by 1e-9 may move nothing by more than it (beta by it
    // over s*), so no root of the return falls into a gap.
    for (const double I : {0.0, 0.3}) {
      const double side = 0.585 - 0.05 * (0.1 + I);  // the mean of phi_eq over the increment
      const DilationStep a = law.after({side - 5e-10, 0.1}, I, ds);
      const DilationStep b = law.after({side + 5e-10, 0.1}, I, ds);
      EXPECT_LT(std::abs(b.state.value - a.state.value), 1.0001e-9);
      EXPECT_LT(std::abs(b.beta - a.beta), 2e-8);
    }
  }
}

TEST(PrintedDilation, AgreesWithTheRelaxationOfPhiToFirstOrder) {
  // Differentiating beta = (1 - phi_eq/phi)/s* gives the printed form, but for beta^2 and phi in the place of
  // phi_c: for a small change of I, both are second order in it.
  const LinearSolidFraction<double> phi_eq{0.585, 0.1};
  for (const double x : {1e-3, 0.3, 1.0, 5.0})
    for (const double I : {1e-3, 1e-4}) {
      const RelaxingSolidFraction relaxing{phi_eq, 0.4, no_limits};
      const PrintedDilation printed{phi_eq, 0.4, 1, no_limits};
      const double a = relaxing.after(relaxing.start(0.585), I, 0.4 * x).beta;
      const double b = printed.after(printed.start(0.585), I, 0.4 * x).beta;
      EXPECT_NEAR(a, b, I * I) << x;  // b/phi_c/s* = 0.43: 0.43^2 I^2 at most, with room
      EXPECT_GT(a, 0.05 * I);
    }
}

TEST(Dilation, ManySmallIncrementsOfARampAreOneLargeOne) {
  const LinearSolidFraction<double> phi_eq{0.585, 0.1};
  const RelaxingSolidFraction relaxing{phi_eq, 0.4, no_limits};
  const PrintedDilation printed{phi_eq, 0.4, 1.3, no_limits};
  for (const int n : {2, 10, 1000})
    for (const double strain : {1e-3, 0.4, 12.0}) {
      DilationState phi{0.61, 0};
      DilationState beta{0.1, 0};
      for (int i = 1; i <= n; ++i) {
        phi = relaxing.after(phi, 0.5 * i / n, strain / n).state;
        beta = printed.after(beta, 0.5 * i / n, strain / n).state;
      }
      // n roundings of phi (an ulp), and of beta (phi_eq's ulps over phi_c s* = 0.23).
      EXPECT_NEAR(phi.value, relaxing.after({0.61, 0}, 0.5, strain).state.value, (n + 8) * eps);
      EXPECT_NEAR(beta.value, printed.after({0.1, 0}, 0.5, strain).state.value, 8 * (n + 8) * eps);
    }
}

TEST(RelaxingSolidFraction, TheIntegralOfBetaIsTheLogarithmOfPhiAlsoInARamp) {
  const RelaxingSolidFraction law{LinearSolidFraction<double>{0.585, 0.1}, 0.4, no_limits};
  for (const double phi_0 : {0.61, 0.52})
    for (const double strain : {0.01, 0.4, 4.0}) {
      const auto I = [&](double s) { return 0.1 + 0.4 * s / strain; };
      const DilationState begin{phi_0, I(0)};
      const auto beta = [&](double s) { return law.after(begin, I(s), s).beta; };
      const double phi_1 = law.after(begin, I(strain), strain).state.value;
      // As at constant I: eps/s* a point, times the strain; the quadrature's own error is far below.
      EXPECT_NEAR(integral(beta, 0, strain, 200), std::log(phi_0 / phi_1), 8 * eps * (1 + strain / 0.4));
    }
}

TEST(Dilation, TheRampIsDifferentiableEverywhere) {
  // At x = 0: phi stays, and d(phi)/dx = -(phi - phi_eq_0) + 0 + half of the ramp: -(0.61 - 0.585) - 0.035/2
  // from phi_eq_1 - (phi_eq_1 - phi_eq_0)(1 - x/2) + (phi - phi_eq_0)(1 - x).
  const auto rest = test::relax_solid_fraction_ramp_by_jet(0.61, 0.585, 0.55, 0);
  EXPECT_EQ(rest.value, 0.61);
  EXPECT_NEAR(rest.derivative[3], -0.025 - 0.035 / 2, 2 * eps);
  for (double x = 1e-12; x < 1e3; x *= 1.7) {
    const auto jet = test::relax_solid_fraction_ramp_by_jet(0.61, 0.585, 0.55, x);
    ASSERT_NEAR(jet.value, relax_solid_fraction_ramp(0.61, 0.585, 0.55, x), 4 * eps);
    ASSERT_NEAR(jet.derivative[0] + jet.derivative[1] + jet.derivative[2], 1, 8 * eps);  // a common shift
    ASSERT_NEAR(jet.derivative[0], std::exp(-x), 4 * eps);
    // x y' = -x (y - phi_eq_1) + (phi_eq_1 - phi_eq_0) (k - 1) with k what is kept of the ramp, got from
    // y itself; each side has terms of up to x, and the quotient's derivative loses 1/x of eps at 0.1.
    const double kept = jet.derivative[2] - 1;  // dy/d(phi_eq_1) = 1 - k
    const double slope = -(jet.value - 0.55) - (0.55 - 0.585) * (kept + 1) / x;
    if (x > 1e-3) {
      ASSERT_NEAR(jet.derivative[3], slope, 64 * eps * (1 + 1 / x)) << x;
    }
  }
  EXPECT_EQ(kept_of_a_ramp(0.0), 1);
  EXPECT_EQ(kept_of_a_ramp(infinity), 0);
  EXPECT_TRUE(std::isnan(kept_of_a_ramp(nan_value)));
  for (double x = 1e-300; x < 1e3; x *= 1.7) {
    const long double exact = -std::expm1(-static_cast<long double>(x)) / x;
    ASSERT_NEAR(kept_of_a_ramp(x), static_cast<double>(exact), 4 * eps * static_cast<double>(exact)) << x;
  }
}

TEST(Dilation, LimitsActOnBetaAndNeverOnTheState) {
  const RelaxingSolidFraction relaxing{LinearSolidFraction<double>{0.585, 0.1}, 0.1, {}};
  const auto dense = relaxing.after({0.7, 0}, 0.0, 0.0);  // beta = (1 - 0.585/0.7)/0.1 = 1.64
  EXPECT_EQ(dense.state.value, 0.7);
  EXPECT_EQ(dense.beta, 0.5);
  const auto loose = relaxing.after({0.45, 0}, 0.0, 0.0);  // -3
  EXPECT_EQ(loose.state.value, 0.45);
  EXPECT_EQ(loose.beta, -0.5);
  const auto between = relaxing.after({0.59, 0}, 0.0, 0.05);
  EXPECT_EQ(between.beta, dilation_rate(between.state.value, 0.585, 0.1));
  const PrintedDilation printed{LinearSolidFraction<double>{0.585, 0.1}, 0.1, 1, {}};
  const DilationState start = printed.start(0.7);
  EXPECT_NEAR(start.value, 1.642857142857143, 16 * eps);  // 1.15/0.7
  EXPECT_EQ(printed.after(start, 0.0, 0.0).state.value, start.value);
  EXPECT_EQ(printed.after(start, 0.0, 0.0).beta, 0.5);
  EXPECT_EQ(DilationLimits{}(0.25), 0.25);
  EXPECT_TRUE(std::isnan(DilationLimits{}(nan_value))) << "a NaN must not become a limit";
}

TEST(Dilation, StartsAtRest) {
  const RelaxingSolidFraction relaxing{LinearSolidFraction<double>{0.585, 0.1}, 0.4, {}};
  EXPECT_EQ(relaxing.start(0.61).value, 0.61);
  EXPECT_EQ(relaxing.start(0.61).I, 0);
  const PrintedDilation printed{LinearSolidFraction<double>{0.585, 0.1}, 0.4, 1, {}};
  EXPECT_EQ(printed.start(0.61).value, dilation_rate(0.61, 0.585, 0.4));
  EXPECT_EQ(printed.start(0.61).I, 0);
}

TEST(Dilation, ANaNStaysOne) {
  const RelaxingSolidFraction relaxing{LinearSolidFraction<double>{0.585, 0.1}, 0.4, {}};
  const PrintedDilation printed{LinearSolidFraction<double>{0.585, 0.1}, 0.4, 1, {}};
  const auto check = [](const auto& law) {
    EXPECT_TRUE(std::isnan(law.after({nan_value, 0.1}, 0.1, 0.05).beta));
    EXPECT_TRUE(std::isnan(law.after({0.59, nan_value}, 0.1, 0.05).beta));
    EXPECT_TRUE(std::isnan(law.after({0.59, 0.1}, nan_value, 0.05).beta));
    EXPECT_TRUE(std::isnan(law.after({0.59, 0.1}, 0.1, nan_value).beta));
  };
  check(relaxing);
  check(printed);
}

TEST(Dilation, WithoutPressureBetaStaysFinite) {
  // I diverges as p -> 0; phi_eq has a floor, so neither state does.
  const RelaxingSolidFraction relaxing{LinearSolidFraction<double>{0.585, 0.1}, 0.4, no_limits};
  const PrintedDilation printed{LinearSolidFraction<double>{0.585, 0.1}, 0.4, 1, no_limits};
  for (const double I : {1e10, 1e200, infinity}) {
    EXPECT_NEAR(relaxing.after({0.6, 0}, I, 0).beta, (1 - 0.4 / 0.6) / 0.4, 8 * eps);
    EXPECT_NEAR(printed.after({0, 0}, I, 0).beta, (0.585 - 0.4) / (0.585 * 0.4), 8 * eps);
    // And back: the printed state returns to what it was, and does not drift.
    EXPECT_NEAR(printed.after(printed.after({0, 0}, I, 0).state, 0, 0).beta, 0, 8 * eps);
  }
}

TEST(DirectDilation, IsTheRateOfVolumeOverTheRateOfShearWithinItsLimits) {
  EXPECT_EQ(direct_dilation(0.3, 2), 0.15);
  EXPECT_EQ(direct_dilation(3.0, 2), 0.5);
  EXPECT_EQ(direct_dilation(-0.3, 2), 0);
  EXPECT_EQ(direct_dilation(-0.3, 2, {-0.5, 0.5}), -0.15);
  EXPECT_EQ(direct_dilation(0.3, 0), 0);
  EXPECT_EQ(direct_dilation(0.0, 0), 0);
  EXPECT_EQ(direct_dilation(1e300, 1e-300), 0.5);
  EXPECT_TRUE(std::isnan(direct_dilation(nan_value, 2)));
  EXPECT_TRUE(std::isnan(direct_dilation(2.0, nan_value)));
}

}  // namespace
}  // namespace dem2sph
