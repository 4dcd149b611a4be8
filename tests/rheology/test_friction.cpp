// One law, written once: the template with double, with Ceres' Jets and after a law.json round trip give one
// number, and its derivatives are those of the formula. The particle in simple shear, the fourth of the set,
// is tested in tests/sph.
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <random>
#include <stdexcept>

#include "sph/base/law_file.hpp"
#include "sph/rheology/friction.hpp"
#include "tests/rheology/jets.hpp"

namespace dem2sph {
namespace {

constexpr double eps = std::numeric_limits<double>::epsilon();
constexpr double nan_value = std::numeric_limits<double>::quiet_NaN();

// Representable numbers between two doubles of the same sign.
std::int64_t ulps(double a, double b) {
  return std::abs(std::bit_cast<std::int64_t>(a) - std::bit_cast<std::int64_t>(b));
}

struct Draw {
  double I, beta;
  RationalFriction<double> law;
};

// I over twelve decades, parameters around those of the literature, beta in its limits.
template <class Action>
void for_many_laws(const Action& action) {
  std::mt19937_64 random(20260101);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int i = 0; i < 10000 && !testing::Test::HasFatalFailure(); ++i) {
    const double mu_l = 0.1 + 0.6 * uniform(random);
    action(Draw{std::pow(10, -10 + 12 * uniform(random)),
                -0.05 + 0.55 * uniform(random),
                {mu_l, mu_l + 0.5 * uniform(random), std::pow(10, -3 + 4 * uniform(random))}});
  }
}

TEST(OneLaw, DoubleAndJetAgree) {
  for_many_laws([](const Draw& x) {
    const double plain = friction(x.law, x.I, x.beta);
    const auto jet = test::friction_by_jet(x.I, x.law.mu_l, x.law.mu_h, x.law.D_star, x.beta);
    // Same operations in the same order; Jets divide by multiplying with the inverse, half an ulp more on one
    // term.
    ASSERT_LE(ulps(plain, jet.value), 4);
  });
}

TEST(OneLaw, TheLawFileGivesTheSameNumbers) {
  const auto path =
      std::filesystem::path(testing::TempDir()) / ("dem2sph_one_law_" + std::to_string(::getpid()) + ".json");
  const RationalFriction<double> law{0.38 + 1.0 / 3e5, 0.64 - 1.0 / 7e5, 0.279 / 3 * 3.0001};
  LawFile file;
  file.d = 1e-3;
  file.rho_s = 2500;
  file.friction = {"rational", {{"mu_l", law.mu_l}, {"mu_h", law.mu_h}, {"D_star", law.D_star}}, 0};
  file.solid_fraction = {"linear", {{"phi_c", 0.585}, {"b", 0.1}}, 0};
  file.dilation = {"none", {}, 0};
  write_law_file(file, path);
  const LawFile back = read_law_file(path);
  std::filesystem::remove(path);
  const RationalFriction<double> read{back.friction["mu_l"], back.friction["mu_h"], back.friction["D_star"]};
  for (double I = 1e-10; I < 100; I *= 1.7) {
    EXPECT_LE(ulps(friction(law, I, 0.01), friction(read, I, 0.01)), 4);
    EXPECT_LE(ulps(friction(read, I, 0.01),
                   test::friction_by_jet(I, read.mu_l, read.mu_h, read.D_star, 0.01).value),
              4);
  }
}

TEST(Friction, SlopeIsTheDerivative) {
  for_many_laws([](const Draw& x) {
    const auto jet = test::friction_by_jet(x.I, x.law.mu_l, x.law.mu_h, x.law.D_star, x.beta);
    const double slope = x.law.slope(x.I);
    // The Jet forms 1/(I+D) - I/(I+D)^2, which loses (I+D)/D of its digits for I >> D; 8 roundings.
    ASSERT_NEAR(jet.derivative[0], slope, 8 * eps * slope * (1 + x.I / x.law.D_star));
    ASSERT_EQ(test::slope_by_jet(x.I, x.law.mu_l, x.law.mu_h, x.law.D_star) > 0, slope > 0);
    ASSERT_NEAR(test::slope_by_jet(x.I, x.law.mu_l, x.law.mu_h, x.law.D_star), slope, 8 * eps * slope);
    // By hand: with u = I/(I+D), the derivatives by mu_l, mu_h, D*, beta are 1-u, u, -(mu_h-mu_l)
    // I/(I+D)^2, 1.
    const double sum = x.I + x.law.D_star;
    const double u = x.I / sum;
    ASSERT_NEAR(jet.derivative[1], 1 - u, 8 * eps);
    ASSERT_NEAR(jet.derivative[2], u, 8 * eps * u);
    const double by_D = -(x.law.mu_h - x.law.mu_l) * x.I / (sum * sum);
    ASSERT_NEAR(jet.derivative[3], by_D, 8 * eps * std::abs(by_D));
    ASSERT_EQ(jet.derivative[4], 1);
  });
}

TEST(Friction, AtRestEverythingIsFinite) {
  const auto jet = test::friction_by_jet(0, 0.38, 0.64, 0.279, 0.05);
  EXPECT_EQ(jet.value, 0.38 + 0.05);
  // One quotient and two products.
  EXPECT_NEAR(jet.derivative[0], (0.64 - 0.38) / 0.279, 4 * eps);
  EXPECT_EQ(jet.derivative[1], 1);
  EXPECT_EQ(jet.derivative[2], 0);
  EXPECT_EQ(jet.derivative[3], 0);
  EXPECT_EQ((RationalFriction<double>{0.38, 0.64, 0.279}.slope(0.0)),
            (0.64 - 0.38) * 0.279 / (0.279 * 0.279));
}

TEST(Friction, LimitsOfTheLaw) {
  const RationalFriction<double> law{0.38, 0.64, 0.279};
  EXPECT_EQ(law(0.0), 0.38);
  EXPECT_NEAR(law(0.279), 0.51, 2 * eps);  // half of the range at I = D*
  EXPECT_NEAR(law(1e17), 0.64, 2 * eps);   // D*/I is below rounding
  double before = law(0.0);
  for (double I = 1e-6; I < 1e3; I *= 1.5) {
    EXPECT_GT(law(I), before);  // it never falls
    before = law(I);
  }
  EXPECT_TRUE(std::isnan(law(std::nan(""))));
}

TEST(ConstantFriction, IsConstantForEveryScalar) {
  const ConstantFriction<double> law{0.4};
  for (const double I : {0.0, 1e-300, 0.3, 1e300}) {
    EXPECT_EQ(law(I), 0.4);
    EXPECT_EQ(steady_friction(law, I, 7.0), 0.4);
    EXPECT_EQ(law.slope(I), 0);
  }
  const auto jet = test::constant_friction_by_jet(0.3, 0.4);
  EXPECT_EQ(jet.value, 0.4);
  EXPECT_EQ(jet.derivative, (std::array<double, 2>{0, 1}));
}

TEST(RationalRateFriction, IsTheRationalLawOfTheRate) {
  const RationalRateFriction<double> law{0.38, 0.64, 12};
  const RationalFriction<double> same{0.38, 0.64, 12};
  for (double g = 1e-10; g < 1e10; g *= 3) {
    EXPECT_EQ(steady_friction(law, 0.1, g), same(g));
    EXPECT_EQ(law(0.7, g), same(g)) << "I does not matter";
    const auto jet = test::rational_rate_friction_by_jet(g, 0.38, 0.64, 12);
    EXPECT_LE(ulps(jet.value, law(0.1, g)), 4);
    // As for the rational law above: 1/(g+D) - g/(g+D)^2 loses (g+D)/D of its digits.
    EXPECT_NEAR(jet.derivative[0], law.slope(g), 8 * eps * law.slope(g) * (1 + g / 12));
  }
  EXPECT_EQ(law(0.1, 0.0), 0.38);
  EXPECT_NEAR(law(0.1, 12.0), 0.51, 2 * eps);  // half of the range at 12/s
}

// The formulas as printed, in long double.
struct PrintedBarkerGray {
  long double mu_s, mu_2, I_0, mu_inf, alpha, I_N;
  long double operator()(long double I) const {
    const auto flowing = [&](long double x) { return (mu_s * I_0 + mu_2 * x + mu_inf * x * x) / (I_0 + x); };
    if (I > I_N) return flowing(I);
    const long double sum = I_0 + I_N;
    const long double weight = mu_s * I_0 + mu_2 * I_N + mu_inf * I_N * I_N;
    const long double A = I_N * std::exp(alpha * sum * sum / (weight * weight));
    return std::sqrt(alpha / std::log(A / I));
  }
};

TEST(BarkerGray2017, IsThePrintedFormulaAndContinuous) {
  for (const double mu_s : {0.2, 0.342, 0.383, 0.45})
    for (const double I_0 : {0.069, 0.279})
      for (const double mu_inf : {0.0, 0.05, 0.3})
        for (const double alpha : {1.0, 1.9}) {
          const double mu_2 = mu_s + 0.25;
          const BarkerGray2017<double> law(mu_s, mu_2, I_0, mu_inf, alpha);
          const PrintedBarkerGray printed{mu_s, mu_2, I_0, mu_inf, alpha, law.I_N};
          for (double I = 1e-300; I < 1e6; I *= 7) {
            const double exact = static_cast<double>(printed(I));
            // A dozen operations without cancellation; ln(A/I) is a difference of two logarithms of up to 700
            // that is never below ln(A/I_N) = alpha/mu_N^2 > 1, next to which they are below 10.
            ASSERT_NEAR(law(I), exact, 32 * eps * exact) << I;
          }
          const double above = std::nextafter(law.I_N, 1.0);
          ASSERT_NEAR(law(law.I_N), law(above), 32 * eps) << "a jump at I_N";
          ASSERT_GT(law.slope(above), 0);
        }
}

TEST(BarkerGray2017, TheValuesOfTheHeader) {
  const BarkerGray2017<double> law(0.383, 0.644, 0.279, 0.05, 1.9);
  EXPECT_NEAR(law.I_N, 0.019437033873527826, 1e-12);  // by a bisection of C in another language
  EXPECT_NEAR(std::exp(law.log_A), 2781.484, 1e-3);   // the same
  // Other grains of the same authors: their smaller I_0 has a neutral point smaller nearly in proportion.
  const BarkerGray2017<double> small(0.342, 0.557, 0.069, 0.05, 1.9);
  EXPECT_NEAR(small.I_N, 0.004, 0.0005);  // quoted to one digit
}

TEST(BarkerGray2017, AtRestItIsZeroWithoutANaN) {
  const BarkerGray2017<double> law(0.383, 0.644, 0.279, 0.05, 1.9);
  EXPECT_EQ(law(0.0), 0);
  EXPECT_EQ(steady_friction(law, 0.0, 0.0), 0);
  EXPECT_EQ(law.slope(0.0), std::numeric_limits<double>::infinity());
  double before = 0;
  for (double I = std::numeric_limits<double>::denorm_min(); I < 1e300; I *= 2) {
    ASSERT_GT(law(I), before) << I;  // from the smallest number on, it never falls
    ASSERT_GT(law.slope(I), 0) << I;
    before = law(I);
  }
  EXPECT_TRUE(std::isnan(law(nan_value)));
  EXPECT_TRUE(std::isnan(law.slope(nan_value)));
  const auto jet = test::barker_gray_by_jet(0, {0.383, 0.644, 0.279, 0.05, 1.9}, law.I_N);
  EXPECT_EQ(jet.value, 0);
  for (const double d : jet.derivative) EXPECT_EQ(d, 0);
}

TEST(BarkerGray2017, SlopeAndJetAgree) {
  const std::array<double, 5> p{0.383, 0.644, 0.279, 0.05, 1.9};
  const BarkerGray2017<double> law(p[0], p[1], p[2], p[3], p[4]);
  for (double I = 1e-200; I < 1e3; I *= 5) {
    const auto jet = test::barker_gray_by_jet(I, p, law.I_N);
    ASSERT_LE(ulps(jet.value, law(I)), 16);  // Jets multiply with inverses
    // The Jet of I/(I_0 + I) is a difference of terms of up to (0.3 + 0.05 I)/I; slopes are at least 0.05.
    ASSERT_NEAR(jet.derivative[0], law.slope(I), 32 * eps * (law.slope(I) + 1));
    // By the parameters: against central differences of the printed formula in long double with a step of
    // 1e-6, whose error is 1e-12/6 of a third derivative; the largest, by I_0 next to I_N, is some 1e2.
    for (std::size_t k = 0; k < 5; ++k) {
      const auto at = [&](long double h) {
        std::array<long double, 5> q{};
        for (std::size_t i = 0; i < 5; ++i) q[i] = p[i] + (i == k ? h : 0.0L);
        return PrintedBarkerGray{q[0], q[1], q[2], q[3], q[4], law.I_N}(I);
      };
      const double numeric = static_cast<double>((at(1e-6L) - at(-1e-6L)) / 2e-6L);
      ASSERT_NEAR(jet.derivative[k + 1], numeric, 1e-9 * (1 + std::abs(numeric))) << I << " " << k;
    }
  }
}

TEST(BarkerGray2017, RefusesWhatHasNoNeutralPoint) {
  using Law = BarkerGray2017<double>;
  EXPECT_THROW(Law(0.383, 0.383, 0.279, 0, 1.9), std::invalid_argument);   // a constant mu
  EXPECT_THROW(Law(0.383, 0.39, 0.279, 0, 1.9), std::invalid_argument);    // nearly one
  EXPECT_THROW(Law(0.383, 0.644, 0.279, 0.05, 2), std::invalid_argument);  // creep ill posed as I -> 0
  EXPECT_THROW(Law(0.383, 0.644, 0.279, 0.05, 0), std::invalid_argument);
  EXPECT_THROW(Law(0, 0.644, 0.279, 0.05, 1.9), std::invalid_argument);
  EXPECT_THROW(Law(0.644, 0.383, 0.279, 0.05, 1.9), std::invalid_argument);
  EXPECT_THROW(Law(0.383, 0.644, -1, 0.05, 1.9), std::invalid_argument);
  EXPECT_THROW(Law(0.383, 0.644, 0.279, -0.05, 1.9), std::invalid_argument);
  for (std::size_t k = 0; k < 5; ++k) {
    std::array<double, 5> p{0.383, 0.644, 0.279, 0.05, 1.9};
    p[k] = nan_value;
    EXPECT_THROW(Law(p[0], p[1], p[2], p[3], p[4]), std::invalid_argument) << k;
  }
}

TEST(InertialNumber, IsFiniteForEveryPressure) {
  const RationalFriction<double> law{0.38, 0.64, 0.279};
  for (double p = 1; p > 0; p *= 0.1) {  // down to the smallest number there is
    const double I = inertial_number(10.0, p, 1e-3, 2500);
    ASSERT_TRUE(std::isfinite(I));
    // x/(x + D* sqrt(p)) with x = g d sqrt(rho_s) = 0.5: the form that has no infinity in it.
    const double expected = 0.38 + (0.64 - 0.38) * (0.5 / (0.5 + 0.279 * std::sqrt(p)));
    ASSERT_NEAR(law(I), expected, 8 * eps);
  }
}

TEST(InertialNumber, ByHandAndByJet) {
  // 10/s, 1 mm, 2500 kg/m^3, 1 kPa: sqrt(1000/2500) = 0.632 m/s, so I = 0.01/0.632 = 0.0158.
  const double I = inertial_number(10.0, 1000.0, 1e-3, 2500);
  EXPECT_NEAR(I, 0.01 / std::sqrt(0.4), 4 * eps * I);
  const auto jet = test::inertial_number_by_jet(10, 1000, 1e-3, 2500);
  EXPECT_LE(ulps(I, jet.value), 4);
  EXPECT_NEAR(jet.derivative[0], I / 10, 8 * eps * I / 10);             // linear in the rate
  EXPECT_NEAR(jet.derivative[1], -0.5 * I / 1000, 8 * eps * I / 1000);  // p^-1/2
  const auto rest = test::inertial_number_by_jet(0, 1000, 1e-3, 2500);
  EXPECT_EQ(rest.value, 0);
  EXPECT_NEAR(rest.derivative[0], I / 10, 8 * eps * I / 10);
  EXPECT_EQ(rest.derivative[1], 0);
}

}  // namespace
}  // namespace dem2sph
