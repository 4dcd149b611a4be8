// law.json: bit for bit there and back, and every way in which it can be wrong.
#include <gtest/gtest.h>

#include <bit>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "sph/base/law_file.hpp"
#include "sph/base/provenance.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;
using test::message_of;

LawFile example() {
  LawFile law;
  law.d = 1e-3 / 3;
  law.rho_s = 2500.0000000000005;
  law.friction = {"rational",
                  {{"mu_l", 0.1 + 0.2, 0.01 / 3, "1", false},
                   {"mu_h", 0.64, 1e-17, "1", true},
                   {"D_star", 0.279, 0.03, "1", false}},
                  1.0 / 3};
  law.solid_fraction = {"linear", {{"phi_c", 0.5851, 1e-4, "1", false}, {"b", 0.1, 0.01, "1", false}}, 2};
  law.dilation = {"phi_relaxes", {{"s_star", 0.4, 0.1, "1", false}}, 0.7};
  law.covariance_names = {"mu_l", "D_star"};
  law.covariance = {{1e-4, -1e-5 / 3}, {-1e-5 / 3, 1e-3}};
  law.I = {0.005, 1};
  law.phi = {0.4, 0.6};
  law.s = {0, 12};
  law.p = {1000, 1000};
  law.verdict = "The range of I determines all three.";
  law.warnings = {"D_star and mu_h go together"};
  law.provenance = {{"observables", json::array({"abc"})}};
  return law;
}

void expect_same_bits(double a, double b) {
  EXPECT_EQ(std::bit_cast<std::uint64_t>(a), std::bit_cast<std::uint64_t>(b));
}

void expect_same(const FittedLaw& a, const FittedLaw& b) {
  EXPECT_EQ(a.member, b.member);
  expect_same_bits(a.chi2_per_dof, b.chi2_per_dof);
  ASSERT_EQ(a.parameters.size(), b.parameters.size());
  for (std::size_t i = 0; i < a.parameters.size(); ++i) {
    EXPECT_EQ(a.parameters[i].name, b.parameters[i].name);
    expect_same_bits(a.parameters[i].value, b.parameters[i].value);
    expect_same_bits(a.parameters[i].standard_error, b.parameters[i].standard_error);
    EXPECT_EQ(a.parameters[i].unit, b.parameters[i].unit);
    EXPECT_EQ(a.parameters[i].at_bound, b.parameters[i].at_bound);
  }
}

class LawJson : public test::Scratch {
 protected:
  // Writes `j` and returns the message with which it is refused; it must name the file.
  std::string refusal(const json& j) const {
    test::put(in("law.json"), j.dump());
    const std::string message = message_of<InputError>([&] { read_law_file(in("law.json")); });
    EXPECT_CONTAINS(message, in("law.json").string());
    return message;
  }
  json example_json() const {
    write_law_file(example(), in("good.json"));
    return read_json(in("good.json"));
  }
};

TEST_F(LawJson, RoundTripIsExact) {
  const LawFile a = example();
  write_law_file(a, in("law.json"));
  const LawFile b = read_law_file(in("law.json"));
  expect_same_bits(a.d, b.d);
  expect_same_bits(a.rho_s, b.rho_s);
  expect_same(a.friction, b.friction);
  expect_same(a.solid_fraction, b.solid_fraction);
  expect_same(a.dilation, b.dilation);
  EXPECT_EQ(a.covariance_names, b.covariance_names);
  EXPECT_EQ(a.covariance, b.covariance);
  const auto same_range = [](const DataRange& x, const DataRange& y) {
    expect_same_bits(x.lowest, y.lowest);
    expect_same_bits(x.highest, y.highest);
  };
  same_range(a.I, b.I);
  same_range(a.phi, b.phi);
  same_range(a.s, b.s);
  same_range(a.p, b.p);
  EXPECT_EQ(a.verdict, b.verdict);
  EXPECT_EQ(a.warnings, b.warnings);
  EXPECT_EQ(a.provenance, b.provenance);
  write_law_file(b, in("again.json"));
  EXPECT_EQ(test::content_of(in("law.json")), test::content_of(in("again.json")));
}

// Every member of the document, as JSON pointers, but what `provenance` holds, which is free.
void collect(const json& j, const json::json_pointer& at, std::vector<json::json_pointer>& into) {
  if (!at.empty()) into.push_back(at);
  if (at == json::json_pointer("/provenance") || at == json::json_pointer("/covariance/matrix")) return;
  if (j.is_object())
    for (const auto& [key, item] : j.items()) collect(item, at / key, into);
  if (j.is_array())
    for (std::size_t i = 0; i < j.size(); ++i) collect(j[i], at / i, into);
}

TEST_F(LawJson, EveryMemberIsNeededAndHasItsType) {
  const json good = example_json();
  std::vector<json::json_pointer> members;
  collect(good, json::json_pointer(), members);
  ASSERT_GT(members.size(), 60u);
  for (const json::json_pointer& member : members) {
    SCOPED_TRACE(member.to_string());
    json::json_pointer parent = member;
    parent.pop_back();
    if (good.at(parent).is_object()) {
      json missing = good;
      missing.at(parent).erase(member.back());
      EXPECT_CONTAINS(refusal(missing), member.back());
    }
    if (member == json::json_pointer("/provenance")) continue;  // any JSON may stand there
    json other = good;
    other[member] = good[member].is_boolean() ? json("yes") : json(true);
    refusal(other);
    other[member] = nullptr;
    refusal(other);
  }
}

TEST_F(LawJson, ImpossibleValuesAreNamed) {
  struct Wrong {
    const char* pointer;
    json value;
    const char* fragment;
  };
  const std::vector<Wrong> list{
      {"/format", "other", "is not a dem2sph law file"},
      {"/schema_version", 2, "has schema version 2, this program reads 1"},
      {"/grains/d/value", 0, "d = 0 must be positive"},
      {"/grains/d/unit", "mm", "d has the unit \"mm\", expected \"m\""},
      {"/grains/rho_s/value", -1, "rho_s = -1 must be positive"},
      {"/friction/member", "mu_i", "unknown friction law \"mu_i\""},
      {"/friction/parameters/0/value", 0.7, "mu_h is below mu_l"},
      {"/friction/parameters/0/value", -0.1, "mu_l = -0.1 must be positive"},
      {"/friction/parameters/0/name", "mu_s", "has no parameter \"mu_l\""},
      {"/friction/parameters/2/value", 0, "D_star = 0 must be positive"},
      {"/friction/parameters/2/unit", "1/s", "D_star has the unit \"1/s\""},
      {"/solid_fraction/member", "cubic", "unknown solid fraction law \"cubic\""},
      {"/solid_fraction/parameters/0/value", 0, "phi_c = 0 must be positive"},
      {"/solid_fraction/parameters/1/name", "B", "has no parameter \"b\""},
      {"/dilation/member", "phi", "unknown dilation law \"phi\""},
      {"/dilation/parameters/0/value", -0.4, "s_star = -0.4 must be positive"},
      {"/covariance/matrix/0/1", 1e-5, "the covariance is not symmetric"},
      {"/covariance/matrix/0", json::array({1e-4}), "the covariance is not square"},
      {"/covariance/names", json::array({"mu_l"}), "another size than its names"},
      {"/range/I/lowest", 2, "the range of I is upside down"},
      {"/range/p/unit", "kPa", "p has the unit \"kPa\""},
  };
  const json good = example_json();
  for (const Wrong& w : list) {
    SCOPED_TRACE(w.pointer);
    json wrong = good;
    wrong[json::json_pointer(w.pointer)] = w.value;
    EXPECT_CONTAINS(refusal(wrong), w.fragment);
  }
}

// Every other member, with its units.
std::vector<FittedLaw> other_frictions() {
  return {{"constant", {{"mu", 0.4}}, 0},
          {"rational_rate", {{"mu_l", 0.38}, {"mu_h", 0.64}, {"D_star", 12, 0, "1/s"}}, 0},
          {"barker_gray_2017",
           {{"mu_s", 0.383}, {"mu_2", 0.644}, {"I_0", 0.279}, {"mu_inf", 0.05}, {"alpha", 1.9}},
           0}};
}

TEST_F(LawJson, EveryMemberIsReadBack) {
  for (const FittedLaw& friction : other_frictions()) {
    LawFile law = example();
    law.friction = friction;
    law.dilation = {"printed", {{"s_star", 0.4}, {"gain", 1.3}}, 0};
    write_law_file(law, in("law.json"));
    const LawFile back = read_law_file(in("law.json"));
    expect_same(back.friction, law.friction);
    expect_same(back.dilation, law.dilation);
  }
}

TEST_F(LawJson, ImpossibleValuesOfEveryMemberAreNamed) {
  // A friction law of the list above (0: constant, 1: rational_rate, 2: Barker and Gray's), a wrong
  // parameter.
  struct Wrong {
    std::size_t law;
    std::size_t parameter;
    double value;
    const char* unit;
    const char* fragment;
  };
  const std::vector<Wrong> list{
      {0, 0, 0, "1", "mu = 0 must be positive"},
      {0, 0, 0.4, "1/s", "mu has the unit \"1/s\", expected \"1\""},
      {1, 0, -0.1, "1", "mu_l = -0.1 must be positive"},
      {1, 1, 0.3, "1", "mu_h is below mu_l"},
      {1, 2, 0, "1/s", "D_star = 0 must be positive"},
      {1, 2, 12, "1", "D_star has the unit \"1\", expected \"1/s\""},
      {2, 0, 0, "1", "mu_s = 0 must be positive"},
      {2, 1, 0.3, "1", "mu_2 is below mu_s"},
      {2, 2, -0.3, "1", "I_0 = -0.3 must be positive"},
      {2, 3, -0.05, "1", "mu_inf = -0.05 must not be negative"},
      {2, 4, 0, "1", "alpha = 0 must be positive"},
  };
  for (const Wrong& w : list) {
    SCOPED_TRACE(w.fragment);
    LawFile law = example();
    law.friction = other_frictions().at(w.law);
    law.friction.parameters.at(w.parameter).value = w.value;
    law.friction.parameters.at(w.parameter).unit = w.unit;
    write_law_file(law, in("good.json"));
    EXPECT_CONTAINS(refusal(read_json(in("good.json"))), w.fragment);
  }
  for (const FittedLaw& friction : other_frictions())
    for (std::size_t i = 0; i < friction.parameters.size(); ++i) {
      LawFile law = example();
      law.friction = friction;
      law.friction.parameters.erase(law.friction.parameters.begin() + static_cast<std::ptrdiff_t>(i));
      write_law_file(law, in("good.json"));
      EXPECT_CONTAINS(refusal(read_json(in("good.json"))),
                      "has no parameter \"" + friction.parameters[i].name + "\"");
    }
}

TEST_F(LawJson, ThePrintedDilationNeedsItsGain) {
  const auto refused = [&](std::vector<FittedParameter> parameters) {
    LawFile law = example();
    law.dilation = {"printed", std::move(parameters), 0};
    write_law_file(law, in("good.json"));
    return refusal(read_json(in("good.json")));
  };
  EXPECT_CONTAINS(refused({{"s_star", 0.4}}), "the printed law has no parameter \"gain\"");
  EXPECT_CONTAINS(refused({{"s_star", 0.0}, {"gain", 1.0}}), "s_star = 0 must be positive");
  EXPECT_CONTAINS(refused({{"s_star", 0.4}, {"gain", -1.0}}), "gain = -1 must not be negative");
}

TEST_F(LawJson, ALawWithoutDilationIsALaw) {
  LawFile law = example();
  law.dilation = {"none", {}, 0};
  law.covariance_names.clear();
  law.covariance.clear();
  law.warnings.clear();
  write_law_file(law, in("law.json"));
  EXPECT_EQ(read_law_file(in("law.json")).dilation.member, "none");
}

TEST_F(LawJson, TruncatedOrMissingFilesAreInputErrors) {
  write_law_file(example(), in("good.json"));
  const std::string whole = test::content_of(in("good.json"));
  for (std::size_t length = 0; length + 2 < whole.size(); length += 13) {  // the last byte is a line end
    test::put(in("law.json"), whole.substr(0, length));
    EXPECT_CONTAINS(message_of<InputError>([&] { read_law_file(in("law.json")); }), in("law.json").string());
  }
  EXPECT_CONTAINS(message_of<InputError>([&] { read_law_file(in("none.json")); }), in("none.json").string());
}

TEST_F(LawJson, WhatCouldNotBeReadBackIsNotWritten) {
  LawFile law = example();
  law.friction.parameters[1].standard_error = std::numeric_limits<double>::quiet_NaN();
  const std::string message = message_of<Error>([&] { write_law_file(law, in("law.json")); });
  EXPECT_CONTAINS(message, "/friction/parameters/1/standard_error is not a finite number");
  EXPECT_EQ(files(), 0u);
}

}  // namespace
}  // namespace dem2sph
