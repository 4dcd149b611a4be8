// One law, written once: the template with double, with Ceres' Jets and after a law.json round trip give one
// number, and its derivatives are those of the formula. The particle in simple shear, the fourth of the set,
// is tested in tests/sph.
#include <gtest/gtest.h>
#include <unistd.h>

#include <bit>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <random>

#include "sph/base/law_file.hpp"
#include "sph/rheology/friction.hpp"
#include "tests/rheology/jets.hpp"

namespace dem2sph {
namespace {

constexpr double eps = std::numeric_limits<double>::epsilon();

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
