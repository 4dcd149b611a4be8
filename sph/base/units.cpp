#include "sph/base/units.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <vector>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

const std::map<std::string, Unit, std::less<>>& known_units() {
  static const std::map<std::string, Unit, std::less<>> units{
      {"1", {1, {}}},
      {"rad", {1, {}}},
      {"deg", {std::numbers::pi / 180, {}}},
      {"m", {1, {1, 0, 0}}},
      {"km", {1e3, {1, 0, 0}}},
      {"cm", {1e-2, {1, 0, 0}}},
      {"mm", {1e-3, {1, 0, 0}}},
      {"um", {1e-6, {1, 0, 0}}},
      {"kg", {1, {0, 1, 0}}},
      {"g", {1e-3, {0, 1, 0}}},
      {"t", {1e3, {0, 1, 0}}},
      {"s", {1, {0, 0, 1}}},
      {"ms", {1e-3, {0, 0, 1}}},
      {"us", {1e-6, {0, 0, 1}}},
      {"min", {60, {0, 0, 1}}},
      {"h", {3600, {0, 0, 1}}},
      {"rpm", {std::numbers::pi / 30, {0, 0, -1}}},  // 2 pi rad a minute
      {"N", {1, {1, 1, -2}}},
      {"J", {1, {2, 1, -2}}},
      {"Pa", {1, {-1, 1, -2}}},
      {"kPa", {1e3, {-1, 1, -2}}},
      {"MPa", {1e6, {-1, 1, -2}}},
      {"GPa", {1e9, {-1, 1, -2}}},
  };
  return units;
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.front()))) text.remove_prefix(1);
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.remove_suffix(1);
  return text;
}

std::string name_of(const Dimension& d) {
  std::string text;
  const auto add = [&](const char* name, int exponent) {
    if (exponent == 0) return;
    if (!text.empty()) text += " ";
    text += exponent == 1 ? std::string(name) : fmt::format("{}^{}", name, exponent);
  };
  add("kg", d.kilogram);
  add("m", d.metre);
  add("s", d.second);
  return text.empty() ? "a pure number" : text;
}

}  // namespace

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({above + 1, row[j - 1] + 1, diagonal + (a[i - 1] == b[j - 1] ? 0u : 1u)});
      diagonal = above;
    }
  }
  return row[b.size()];
}

Unit Unit::parse(std::string_view text) {
  const std::string_view whole = trimmed(text);
  if (whole.empty()) throw UsageError("empty unit");
  Unit result;
  std::size_t at = 0;
  int sign = 1;
  while (true) {
    while (at < whole.size() && whole[at] == ' ') ++at;
    const std::size_t begin = at;
    while (at < whole.size() && std::isalnum(static_cast<unsigned char>(whole[at]))) ++at;
    const std::string_view name = whole.substr(begin, at - begin);
    if (name.empty())
      throw UsageError(at < whole.size() ? fmt::format("unexpected \"{}\" in unit \"{}\"", whole[at], whole)
                                         : fmt::format("unit \"{}\" ends where a name belongs", whole));
    const auto found = known_units().find(name);
    if (found == known_units().end()) {
      std::vector<std::string> names;
      for (const auto& [known, unit] : known_units()) names.push_back(known);
      const std::string near = nearest(name, names);
      throw UsageError(fmt::format("unknown unit \"{}\" in \"{}\"{}", name, whole,
                                   near.empty() ? "" : fmt::format("; did you mean \"{}\"?", near)));
    }
    int exponent = 1;
    if (at < whole.size() && whole[at] == '^') {
      ++at;
      const char* first = whole.data() + at;
      const auto [end, error] = std::from_chars(first, whole.data() + whole.size(), exponent);
      if (error != std::errc{} || exponent < -9 || exponent > 9)
        throw UsageError(fmt::format("^ needs a whole exponent from -9 to 9 in unit \"{}\"", whole));
      at += static_cast<std::size_t>(end - first);
    }
    exponent *= sign;
    result.factor *= std::pow(found->second.factor, exponent);
    result.dimension.metre += exponent * found->second.dimension.metre;
    result.dimension.kilogram += exponent * found->second.dimension.kilogram;
    result.dimension.second += exponent * found->second.dimension.second;

    const std::size_t end_of_factor = at;
    while (at < whole.size() && whole[at] == ' ') ++at;
    if (at == whole.size()) return result;
    sign = 1;
    if (whole[at] == '*' || whole[at] == '/') {
      sign = whole[at] == '/' ? -1 : 1;
      ++at;
    } else if (at == end_of_factor || !std::isalpha(static_cast<unsigned char>(whole[at]))) {
      throw UsageError(fmt::format("unexpected \"{}\" in unit \"{}\"", whole[at], whole));
    }
  }
}

double parse_quantity(std::string_view text, std::string_view expected_unit) {
  const std::string_view whole = trimmed(text);
  double number = 0;
  const auto [end, error] = std::from_chars(whole.data(), whole.data() + whole.size(), number);
  if (error != std::errc{} || !std::isfinite(number))
    throw UsageError(fmt::format("\"{}\" does not start with a finite number; write for example \"1.5 {}\"",
                                 whole, expected_unit));
  const Unit expected = Unit::parse(expected_unit);
  const std::string_view rest = trimmed(whole.substr(static_cast<std::size_t>(end - whole.data())));
  if (rest.empty())
    throw UsageError(
        fmt::format("\"{}\" has no unit; write for example \"{} {}\"", whole, whole, expected_unit));
  const Unit unit = Unit::parse(rest);
  if (unit.dimension != expected.dimension)
    throw UsageError(fmt::format("\"{}\" is {}, but {} is expected, for example \"{} {}\"", whole,
                                 name_of(unit.dimension), name_of(expected.dimension), number,
                                 expected_unit));
  const double value = number * unit.factor;
  if (!std::isfinite(value)) throw UsageError(fmt::format("\"{}\" is too large for a number in SI", whole));
  return value;
}

}  // namespace dem2sph
