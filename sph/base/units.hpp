// Physical quantities written as text, such as "1 mm" or "2500 kg/m^3", read into SI with their dimension
// checked.
#pragma once

#include <string>
#include <string_view>

namespace dem2sph {

/// Exponents of metre, kilogram and second. Angles and strains are dimensionless.
struct Dimension {
  int metre = 0;
  int kilogram = 0;
  int second = 0;
  bool operator==(const Dimension&) const = default;
};

/// Reads a unit such as "kg/m^3" and gives its factor to SI and its dimension.
/// Grammar: names joined by `*`, `/` or a space, each with an optional `^` and a whole exponent; "1" is
/// dimensionless. Throws UsageError for a name that is not known, with the nearest known one.
struct Unit {
  double factor = 1;
  Dimension dimension;
  static Unit parse(std::string_view text);
};

/// Reads "number unit" and returns the value in SI. Throws UsageError if the number or unit is missing or
/// malformed, or if its dimension is not that of `expected_unit` (for example "m").
double parse_quantity(std::string_view text, std::string_view expected_unit);

/// The entry of `known` nearest to `word` by edit distance, or an empty string if none is near.
template <class Range>
std::string nearest(std::string_view word, const Range& known);

std::size_t edit_distance(std::string_view a, std::string_view b);

template <class Range>
std::string nearest(std::string_view word, const Range& known) {
  std::string best;
  std::size_t best_distance = word.size() / 3 + 2;  // farther than this is no misprint of it
  for (const auto& candidate : known) {
    const std::size_t distance = edit_distance(word, candidate);
    if (distance < best_distance) {
      best_distance = distance;
      best = std::string(candidate);
    }
  }
  return best;
}

}  // namespace dem2sph
