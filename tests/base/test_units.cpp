// Units: every known name against its definition, products of them as a property, and every way to misspell
// one.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <ostream>
#include <vector>

#include "sph/base/units.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using test::message_of;

constexpr double eps = std::numeric_limits<double>::epsilon();

struct Known {
  const char* name;
  double factor;
  Dimension dimension;
  const char* si;
};
// What rapidcheck prints of a counterexample.
[[maybe_unused]] void showValue(const Known& known, std::ostream& out) { out << known.name; }

// The SI brochure's definitions, written out a second time: the oracle of this file.
const std::vector<Known>& known() {
  static const std::vector<Known> list{
      {"1", 1, {}, "1"},
      {"rad", 1, {}, "1"},
      {"deg", std::numbers::pi / 180, {}, "1"},
      {"m", 1, {1, 0, 0}, "m"},
      {"km", 1e3, {1, 0, 0}, "m"},
      {"cm", 1e-2, {1, 0, 0}, "m"},
      {"mm", 1e-3, {1, 0, 0}, "m"},
      {"um", 1e-6, {1, 0, 0}, "m"},
      {"kg", 1, {0, 1, 0}, "kg"},
      {"g", 1e-3, {0, 1, 0}, "kg"},
      {"t", 1e3, {0, 1, 0}, "kg"},
      {"s", 1, {0, 0, 1}, "s"},
      {"ms", 1e-3, {0, 0, 1}, "s"},
      {"us", 1e-6, {0, 0, 1}, "s"},
      {"min", 60, {0, 0, 1}, "s"},
      {"h", 3600, {0, 0, 1}, "s"},
      {"rpm", 2 * std::numbers::pi / 60, {0, 0, -1}, "rad/s"},
      {"N", 1, {1, 1, -2}, "kg m/s^2"},
      {"J", 1, {2, 1, -2}, "kg m^2/s^2"},
      {"Pa", 1, {-1, 1, -2}, "kg/m/s^2"},
      {"kPa", 1e3, {-1, 1, -2}, "kg/m/s^2"},
      {"MPa", 1e6, {-1, 1, -2}, "kg/m/s^2"},
      {"GPa", 1e9, {-1, 1, -2}, "kg/m/s^2"},
  };
  return list;
}

TEST(Units, EveryNameHasItsFactorAndDimension) {
  for (const Known& k : known()) {
    const Unit unit = Unit::parse(k.name);
    EXPECT_EQ(unit.factor, k.factor) << k.name;
    EXPECT_EQ(unit.dimension, k.dimension) << k.name;
  }
}

RC_GTEST_PROP(Units, AQuantityComesBack, (double raw)) {
  // Any sign and 160 decades: the shortest text that fmt prints reads back to the same double.
  const double value =
      std::ldexp(std::sin(raw) + 1.5, static_cast<int>(std::fmod(std::fabs(raw), 530)) - 265);
  const Known k = *rc::gen::elementOf(known());
  const double si = parse_quantity(fmt::format("{} {}", value, k.name), k.si);
  RC_ASSERT(si == value * k.factor);
  // One product and one quotient, each rounded once: 2 half ulps.
  RC_ASSERT(std::abs(si / k.factor - value) <= eps * std::abs(value));
  // Spaces around do not matter, nor the one between, but for the unit 1, which would be a digit.
  const char* gap = std::string(k.name) == "1" ? "   " : "";
  RC_ASSERT(parse_quantity(fmt::format("  {}{}{}  ", -value, gap, k.name), k.si) == -si);
}

RC_GTEST_PROP(Units, ProductsAddTheirExponents, ()) {
  const auto length = *rc::gen::inRange(1, 6);
  std::string text;
  double factor = 1;
  Dimension dimension;
  for (int i = 0; i < length; ++i) {
    const Known k = *rc::gen::elementOf(known());
    const int exponent = *rc::gen::inRange(-3, 4);
    const char* joint =
        i == 0 ? "" : *rc::gen::elementOf(std::vector<const char*>{"*", "/", " ", " * ", " / "});
    if (std::string(k.name) == "1" && std::string(joint) == " ") continue;  // "m 1" would be a misprint
    const int sign = std::string(joint).find('/') != std::string::npos ? -1 : 1;
    text += fmt::format("{}{}^{}", joint, k.name, exponent);
    factor *= std::pow(k.factor, sign * exponent);
    dimension.metre += sign * exponent * k.dimension.metre;
    dimension.kilogram += sign * exponent * k.dimension.kilogram;
    dimension.second += sign * exponent * k.dimension.second;
  }
  const Unit unit = Unit::parse(text);
  RC_ASSERT(unit.dimension == dimension);
  // At most five powers and five products, an ulp each.
  RC_ASSERT(std::abs(unit.factor - factor) <= 10 * eps * factor);
}

TEST(Units, DerivedUnitsByHand) {
  EXPECT_EQ(parse_quantity("2500 kg/m^3", "kg/m^3"), 2500);
  // 2.5 g/cm^3 = 2500 kg/m^3: a power, a product and a quotient, an ulp each.
  EXPECT_NEAR(parse_quantity("2.5 g/cm^3", "kg/m^3"), 2500, 4 * eps * 2500);
  EXPECT_EQ(parse_quantity("9.81 N/kg", "m/s^2"), 9.81);
  EXPECT_EQ(parse_quantity("3 Pa*s", "kg m^-1 s^-1"), 3);
  EXPECT_NEAR(parse_quantity("180 deg", "rad"), std::numbers::pi, 2 * eps * std::numbers::pi);
  EXPECT_EQ(parse_quantity("12 1/s", "1/s"), 12);
  EXPECT_EQ(parse_quantity("1e-3m", "m"), 1e-3);
}

struct Malformed {
  const char* text;
  const char* expected_unit;
  const char* fragment;  // what makes the message a help
};

TEST(Units, EveryMalformedTextIsRefusedWithHelp) {
  const std::vector<Malformed> list{
      {"", "m", "write for example \"1.5 m\""},
      {"   ", "m", "write for example"},
      {"mm", "m", "does not start with a finite number"},
      {"one mm", "m", "does not start with a finite number"},
      {"nan m", "m", "does not start with a finite number"},
      {"inf m", "m", "does not start with a finite number"},
      {"-inf m", "m", "does not start with a finite number"},
      {"1e999 m", "m", "does not start with a finite number"},
      {"--1 m", "m", "does not start with a finite number"},
      {"1", "m", "has no unit; write for example \"1 m\""},
      {"1.5 ", "kg/m^3", "has no unit; write for example \"1.5 kg/m^3\""},
      {"1,5 m", "m", "unexpected \",\""},
      {"1 metre", "m", "unknown unit \"metre\""},
      {"1 kpa", "Pa", "did you mean \"kPa\"?"},
      {"1 mmm", "m", "did you mean \"mm\"?"},
      {"0x10 m", "m", "unknown unit \"x10\""},
      {"1 kg/", "kg", "ends where a name belongs"},
      {"1 kg//m", "kg/m", "unexpected \"/\""},
      {"1 *m", "m", "unexpected \"*\""},
      {"1 m^", "m", "^ needs a whole exponent"},
      {"1 m^x", "m", "^ needs a whole exponent"},
      {"1 m^10", "m", "^ needs a whole exponent"},
      {"1 m^-2147483648", "m", "^ needs a whole exponent"},
      {"1 m^99999999999", "m", "^ needs a whole exponent"},
      {"1 m^2.5", "m", "unexpected \".\""},
      {"1 m^2s", "m^2 s", "unexpected \"s\""},
      {"1 m/s)", "m/s", "unexpected \")\""},
      {"1 mm 2", "m", "unexpected \"2\""},
      {"1 kg", "m", "is kg, but m is expected, for example \"1 m\""},
      {"1 rad", "m", "is a pure number, but m is expected"},
      {"5 m/s", "1/s", "is m s^-1, but s^-1 is expected"},
      {"2 Pa", "m/s^2", "is kg m^-1 s^-2"},
      {"1e308 km", "m", "too large"},
  };
  for (const Malformed& m : list) {
    SCOPED_TRACE(m.text);
    const std::string message = message_of<UsageError>([&] { parse_quantity(m.text, m.expected_unit); });
    EXPECT_CONTAINS(message, m.fragment);
  }
  EXPECT_CONTAINS(message_of<UsageError>([] { Unit::parse(" "); }), "empty unit");
}

RC_GTEST_PROP(Units, AnyTextIsReadOrRefusedButNeverNaN, (const std::string& text)) {
  try {
    RC_ASSERT(std::isfinite(parse_quantity("1 " + text, "m")));
  } catch (const UsageError&) {
    RC_SUCCEED("refused");
  }
}

TEST(Units, EditDistance) {
  EXPECT_EQ(edit_distance("kitten", "sitting"), 3u);
  EXPECT_EQ(edit_distance("", "abc"), 3u);
  EXPECT_EQ(edit_distance("same", "same"), 0u);
  const std::vector<std::string> words{"height", "width"};
  EXPECT_EQ(nearest("heigth", words), "height");
  EXPECT_EQ(nearest("colour", words), "");
}

}  // namespace
}  // namespace dem2sph
