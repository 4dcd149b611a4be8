// C <= 0 against the growth of plane waves in every direction, and the ends of the well-posed ranges.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "sph/rheology/friction.hpp"

namespace dem2sph {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

// The largest growth of a short plane wave in plane flow, in units of (mu p/g) k^2/2. With the wave at an
// angle to the axes of D, x = cos of twice that angle, the perturbed stress is
//   (mu p/g) [d - (1 - n) A (A:d)/2] + A mu (1 - n/2) dp,   A = D/|D|,
// and the pressure that keeps the flow incompressible leaves the rate
//   (1 - n)(1 - x^2)/(1 - mu (1 - n/2) x) - 1
// (derived for this test from the momentum balance; the condition C is its discriminant).
double largest_growth(double mu, double n) {
  double largest = -infinity;
  for (int k = 0; k <= 100000; ++k) {
    const double x = -1 + k * 2e-5;
    largest = std::max(largest, (1 - n) * (1 - x * x) / (1 - mu * (1 - n / 2) * x) - 1);
  }
  return largest;
}

TEST(WellPosedness, IsTheSignOfTheGrowthOfPlaneWaves) {
  std::mt19937_64 random(20260201);
  std::uniform_real_distribution<double> uniform(0, 1);
  int well = 0;
  int ill = 0;
  for (int i = 0; i < 300; ++i) {
    const double mu = 0.1 + 0.7 * uniform(random);
    const double n = 0.6 * uniform(random) * uniform(random);
    const double C = well_posedness_of(mu, n);
    if (std::abs(C) < 1e-6) continue;  // a grid of 2e-5 in x misses 1e-10 of a maximum of curvature near 1
    EXPECT_EQ(C > 0, largest_growth(mu, n) > 0) << mu << " " << n;
    ++(C > 0 ? ill : well);
  }
  EXPECT_GT(well, 50);
  EXPECT_GT(ill, 50);
}

TEST(WellPosedness, OfTheRationalLawByHand) {
  // At I = I_0: mu = (0.4 + 0.8)/2 = 0.6, I dmu/dI = 0.4/4 = 0.1, n = 1/6, and
  // C = 4/36 - 4/6 + 0.36 (11/12)^2 = -0.253055...
  const RationalFriction<double> law{0.4, 0.8, 0.3};
  EXPECT_NEAR(well_posedness(law, 0.3), 1.0 / 9 - 2.0 / 3 + 0.36 * 121 / 144, 1e-15);  // ten roundings
  EXPECT_EQ(well_posedness(law, 0.3), well_posedness(law, 0.3, 1234.0));
  EXPECT_NEAR(well_posedness(law, 0.0), 0.16, 1e-16);  // at rest C = mu^2: ill posed
}

TEST(WellPosedness, OfTheRateMemberUsesTheRate) {
  const RationalRateFriction<double> law{0.4, 0.8, 12};
  const RationalFriction<double> of_I{0.4, 0.8, 12};
  for (const double g : {0.0, 0.1, 12.0, 500.0})
    EXPECT_EQ(well_posedness(law, 0.01, g), well_posedness(of_I, g)) << g;
}

TEST(WellPosedRange, OfConstantFrictionIsEmpty) {
  for (const double mu : {1e-3, 0.4, 1.0}) {
    EXPECT_TRUE(well_posed_range(ConstantFriction<double>{mu}).empty());
    EXPECT_EQ(well_posedness(ConstantFriction<double>{mu}, 0.1), mu * mu);
  }
  EXPECT_TRUE(well_posed_range(RationalFriction<double>{0.38, 0.39, 0.279}).empty());
}

TEST(WellPosedRange, OfTheRationalLawEndsWhereCIsZero) {
  const RationalFriction<double> law{0.383, 0.644, 0.279};
  const WellPosedRange range = well_posed_range(law);
  // By scan and bisection in another language.
  EXPECT_NEAR(range.low, 0.01962472686535961, 1e-12);
  EXPECT_GT(range.high, 0.79);
  EXPECT_LT(range.high, 1.0);
  for (const double end : {range.low, range.high}) EXPECT_NEAR(well_posedness(law, end), 0, 1e-15);
  EXPECT_GT(well_posedness(law, 0.999 * range.low), 0);
  EXPECT_LT(well_posedness(law, 1.001 * range.low), 0);
  EXPECT_LT(well_posedness(law, 0.999 * range.high), 0);
  EXPECT_GT(well_posedness(law, 1.001 * range.high), 0);
}

TEST(WellPosedRange, OfBarkerAndGraysLawBeginsAtRest) {
  const BarkerGray2017<double> law(0.383, 0.644, 0.279, 0.05, 1.9);
  const WellPosedRange range = well_posed_range(law);
  EXPECT_EQ(range.low, 0);
  EXPECT_GT(range.high, 10);  // without mu_inf it would end below 1
  EXPECT_EQ(well_posedness(law, 0.0), 0);
  for (double I = 1e-300; I < range.high; I *= 1.1)
    ASSERT_LE(well_posedness(law, I), 1e-15) << I;  // 0 at I_N itself, within rounding
  EXPECT_NEAR(well_posedness(law.flowing, law.I_N), 0, 1e-15);
  EXPECT_GT(well_posedness(law.flowing, 0.999 * law.I_N), 0);
}

}  // namespace
}  // namespace dem2sph
