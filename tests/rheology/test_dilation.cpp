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

TEST(DilationLaw, LimitsActOnBetaAndNeverOnTheState) {
  const DilationLaw law{{0.585, 0.1}, 0.1, {}};
  const auto dense = law.after(0.7, 0.0, 0.0);  // beta = (1 - 0.585/0.7)/0.1 = 1.64
  EXPECT_EQ(dense.phi, 0.7);
  EXPECT_EQ(dense.beta, 0.5);
  const auto loose = law.after(0.45, 0.0, 0.0);  // -3
  EXPECT_EQ(loose.phi, 0.45);
  EXPECT_EQ(loose.beta, -0.5);
  const auto between = law.after(0.59, 0.0, 0.05);
  EXPECT_EQ(between.beta, dilation_rate(between.phi, 0.585, 0.1));
  EXPECT_EQ(DilationLimits{}(0.25), 0.25);
  EXPECT_TRUE(std::isnan(DilationLimits{}(nan_value))) << "a NaN must not become a limit";
  EXPECT_TRUE(std::isnan(law.after(0.59, nan_value, 0.05).beta));
  EXPECT_TRUE(std::isnan(law.after(nan_value, 0.1, 0.05).beta));
}

}  // namespace
}  // namespace dem2sph
