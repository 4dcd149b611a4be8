// One law, written once, for every member of every family: with double, with Ceres' Jets and after a law.json
// round trip it gives one number, and its slope is its derivative. The particle in simple shear, the fourth
// of the set, is in tests/sph/test_constitutive.cpp.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <limits>
#include <random>

#include "sph/material.hpp"
#include "tests/base/helpers.hpp"
#include "tests/rheology/jets.hpp"

namespace dem2sph {
namespace {

struct Member {
  std::string name;
  std::vector<std::string> parameters;
  std::vector<double> low, high;  // of the values that are drawn
};

// In the order of the variants.
const std::vector<Member> friction_members{
    {"constant", {"mu"}, {0.2}, {0.8}},
    {"rational", {"mu_l", "mu_h", "D_star"}, {0.2, 0.5, 0.01}, {0.4, 0.9, 2}},
    {"rational_rate", {"mu_l", "mu_h", "D_star"}, {0.2, 0.5, 0.1}, {0.4, 0.9, 30}},
    {"exponential", {"mu_l", "mu_h", "D_star"}, {0.2, 0.5, 0.01}, {0.4, 0.9, 2}},
    {"power", {"mu_l", "a", "n"}, {0.2, 0.1, 0.3}, {0.4, 1, 2}},
    {"linear", {"mu_l", "rise"}, {0.2, 0.1}, {0.4, 2}},
    {"barker_gray_2017",
     {"mu_s", "mu_2", "I_0", "mu_inf", "alpha"},
     {0.36, 0.62, 0.2, 0.02, 1.7},
     {0.4, 0.68, 0.35, 0.08, 1.9}}};
const std::vector<Member> solid_fraction_members{
    {"linear", {"phi_c", "b"}, {0.57, 0.05}, {0.62, 0.3}},
    {"power", {"phi_c", "a", "n"}, {0.57, 0.05, 0.4}, {0.62, 0.2, 1.5}},
    {"rational", {"phi_c", "b", "I_phi"}, {0.57, 0.05, 0.3}, {0.62, 0.3, 5}}};

class OneLawEveryMember : public test::Scratch {
 protected:
  std::mt19937_64 random_{20260102};

  std::vector<double> draw(const Member& member) {
    std::vector<double> values;
    for (std::size_t k = 0; k < member.low.size(); ++k)
      values.push_back(std::uniform_real_distribution<double>(member.low[k], member.high[k])(random_));
    return values;
  }
  double draw_I() { return std::pow(10, std::uniform_real_distribution<double>(-6, 1)(random_)); }

  static FittedLaw fitted(const Member& member, const std::vector<double>& values) {
    FittedLaw law;
    law.member = member.name;
    // In the opposite order: parameters go by name.
    for (std::size_t k = values.size(); k-- > 0;) {
      FittedParameter p{member.parameters[k], values[k]};
      if (member.name == "rational_rate" && p.name == "D_star") p.unit = "1/s";
      law.parameters.push_back(p);
    }
    return law;
  }
  LawFile back(const FittedLaw& friction, const FittedLaw& solid_fraction) {
    LawFile file;
    file.d = 1e-3;
    file.rho_s = 2500;
    file.friction = friction;
    file.solid_fraction = solid_fraction;
    file.dilation.member = "none";
    write_law_file(file, in("law.json"));
    return read_law_file(in("law.json"));
  }
};

// Four units in the last place of the value.
double four_ulp(double value) { return 4 * std::numeric_limits<double>::epsilon() * std::abs(value); }

TEST_F(OneLawEveryMember, OfFriction) {
  ASSERT_EQ(friction_members.size(), std::variant_size_v<FrictionLaw>) << "a member is not tested";
  for (const Member& member : friction_members)
    for (int i = 0; i < 200; ++i) {
      const std::vector<double> values = draw(member);
      const LawFile file = back(fitted(member, values), fitted(solid_fraction_members[0], {0.6, 0.1}));
      const FrictionLaw law = friction_law(file);
      const double rate = draw_I();
      std::visit(
          [&](const auto& read) {
            ASSERT_EQ(member.name, read.name);
            ASSERT_EQ(member.parameters.size(), read.parameters.size());
            const double mu = steady_friction(read, rate, rate);
            const test::MemberByJet jet = test::member_by_jet(law, values, rate);
            ASSERT_NEAR(mu, jet.value, four_ulp(mu)) << member.name << " at " << rate;
            // Two ways of the same few operations: 64 roundings of the terms, which are below the value here.
            ASSERT_NEAR(read.slope(rate) * rate, jet.by_rate * rate, 16 * four_ulp(mu)) << member.name;
            ASSERT_GE(read.slope(rate), 0) << "friction does not fall with the rate";
            // The derivative by each parameter against central differences, h = cbrt(eps): error h^2.
            for (std::size_t k = 0; k < values.size(); ++k) {
              if (member.name == "barker_gray_2017") break;  // taken at a fixed I_N: test_friction.cpp
              const double h = 6e-6 * values[k];
              std::vector<double> up = values, down = values;
              up[k] += h, down[k] -= h;
              const double slope =
                  (test::member_by_jet(law, up, rate).value - test::member_by_jet(law, down, rate).value) /
                  (2 * h);
              ASSERT_NEAR(jet.by_parameter[k], slope, 1e-8 * (1 + std::abs(slope)))
                  << member.parameters[k] << " of " << member.name << " at I = " << rate;
            }
          },
          law);
    }
}

TEST_F(OneLawEveryMember, OfTheSolidFraction) {
  ASSERT_EQ(solid_fraction_members.size(), std::variant_size_v<decltype(SteadySolidFraction::law)>);
  for (const Member& member : solid_fraction_members)
    for (int i = 0; i < 200; ++i) {
      const std::vector<double> values = draw(member);
      const SteadySolidFraction law =
          solid_fraction_law(back(fitted(friction_members[0], {0.4}), fitted(member, values)));
      ASSERT_EQ(member.name, std::visit([](const auto& m) { return std::string(m.name); }, law.law));
      const double I = draw_I();
      const test::MemberByJet jet = test::member_by_jet(law, values, I);
      ASSERT_NEAR(law(I), jet.value, four_ulp(jet.value)) << member.name;
      ASSERT_LE(jet.by_rate, 0) << "faster is looser";
      ASSERT_EQ(law.phi_c(), values[0]);
      ASSERT_EQ(law(0), values[0]);
      ASSERT_GE(law(1e12), law.phi_min());
    }
}

TEST_F(OneLawEveryMember, AtRestNothingIsNaN) {
  for (const Member& member : friction_members) {
    if (member.name == "barker_gray_2017") continue;  // infinite slope at rest: test_friction.cpp
    const std::vector<double> values = draw(member);
    const FrictionLaw law =
        friction_law(back(fitted(member, values), fitted(solid_fraction_members[0], {0.6, 0.1})));
    const test::MemberByJet jet = test::member_by_jet(law, values, 0);
    EXPECT_EQ(jet.value, values[0]) << member.name;
    for (const double derivative : jet.by_parameter) EXPECT_TRUE(std::isfinite(derivative)) << member.name;
  }
  for (const Member& member : solid_fraction_members) {
    const std::vector<double> values = draw(member);
    const SteadySolidFraction law =
        solid_fraction_law(back(fitted(friction_members[0], {0.4}), fitted(member, values)));
    for (const double derivative : test::member_by_jet(law, values, 0).by_parameter)
      EXPECT_TRUE(std::isfinite(derivative)) << member.name;
  }
}

TEST_F(OneLawEveryMember, ImpossibleValuesAreRefusedByTheFile) {
  const auto refusal = [&](std::size_t friction, std::vector<double> f, std::size_t solid,
                           std::vector<double> s) {
    return test::message_of<InputError>(
        [&] { back(fitted(friction_members[friction], f), fitted(solid_fraction_members[solid], s)); });
  };
  EXPECT_CONTAINS(refusal(3, {0.5, 0.4, 0.2}, 0, {0.6, 0.1}), "mu_h is below mu_l");
  EXPECT_CONTAINS(refusal(4, {0.4, -0.1, 0.5}, 0, {0.6, 0.1}), "a = -0.1 must not be negative");
  EXPECT_CONTAINS(refusal(4, {0.4, 0.1, 0}, 0, {0.6, 0.1}), "n = 0 must be positive");
  EXPECT_CONTAINS(refusal(5, {0.4, -1}, 0, {0.6, 0.1}), "rise = -1 must not be negative");
  EXPECT_CONTAINS(refusal(0, {0.4}, 1, {0.6, -0.1, 1}), "a = -0.1 must not be negative");
  EXPECT_CONTAINS(refusal(0, {0.4}, 2, {0.6, 0.1, 0}), "I_phi = 0 must be positive");
}

}  // namespace
}  // namespace dem2sph
