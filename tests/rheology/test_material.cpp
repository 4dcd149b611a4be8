// From the names and numbers of a law file to the laws.
#include <gtest/gtest.h>

#include <string>

#include "sph/material.hpp"

namespace dem2sph {
namespace {

LawFile with(const std::string& member, std::vector<FittedParameter> parameters) {
  LawFile file;
  file.friction = {member, std::move(parameters), 0};
  return file;
}

FittedParameter named(const char* name, double value) { return {name, value}; }

TEST(FrictionLawOfAFile, EveryMemberArrivesWithItsParameters) {
  const FrictionLaw constant = friction_law(with("constant", {named("mu", 0.4)}));
  EXPECT_EQ(std::get<ConstantFriction<double>>(constant).mu, 0.4);
  EXPECT_EQ(least_friction(constant), 0.4);

  // In another order than the law's own: parameters go by name.
  const std::vector<FittedParameter> three{named("D_star", 0.279), named("mu_h", 0.64), named("mu_l", 0.38)};
  const FrictionLaw rational = friction_law(with("rational", three));
  EXPECT_EQ(std::get<RationalFriction<double>>(rational).mu_l, 0.38);
  EXPECT_EQ(std::get<RationalFriction<double>>(rational).mu_h, 0.64);
  EXPECT_EQ(std::get<RationalFriction<double>>(rational).D_star, 0.279);
  EXPECT_EQ(least_friction(rational), 0.38);

  const FrictionLaw of_rate = friction_law(with("rational_rate", three));
  EXPECT_EQ(std::get<RationalRateFriction<double>>(of_rate).D_star, 0.279);
  EXPECT_EQ(least_friction(of_rate), 0.38);

  const FrictionLaw creeping =
      friction_law(with("barker_gray_2017", {named("mu_s", 0.383), named("mu_2", 0.644), named("I_0", 0.279),
                                             named("mu_inf", 0.05), named("alpha", 1.9)}));
  const auto& law = std::get<BarkerGray2017<double>>(creeping);
  EXPECT_EQ(law.flowing.mu_s, 0.383);
  EXPECT_EQ(law.flowing.mu_2, 0.644);
  EXPECT_EQ(law.flowing.I_0, 0.279);
  EXPECT_EQ(law.flowing.mu_inf, 0.05);
  EXPECT_EQ(law.alpha, 1.9);
  EXPECT_EQ(least_friction(creeping), 0);
}

std::string refusal(const LawFile& file) {
  try {
    friction_law(file);
  } catch (const InputError& error) {
    return error.what();
  }
  ADD_FAILURE() << "was not refused";
  return "";
}

TEST(FrictionLawOfAFile, WhatCannotBeMadeIsNamed) {
  const std::string unknown = refusal(with("mu_i", {}));
  EXPECT_NE(unknown.find("unknown friction law \"mu_i\""), std::string::npos) << unknown;
  const std::string missing = refusal(with("constant", {}));
  EXPECT_NE(missing.find("has no parameter \"mu\""), std::string::npos) << missing;
  const std::string flat =
      refusal(with("barker_gray_2017", {named("mu_s", 0.383), named("mu_2", 0.39), named("I_0", 0.279),
                                        named("mu_inf", 0), named("alpha", 1.9)}));
  EXPECT_NE(flat.find("mu_s = 0.383, mu_2 = 0.39, I_0 = 0.279, mu_inf = 0, alpha = 1.9"), std::string::npos)
      << flat;
  EXPECT_NE(flat.find("well posed nowhere"), std::string::npos) << flat;
}

}  // namespace
}  // namespace dem2sph
