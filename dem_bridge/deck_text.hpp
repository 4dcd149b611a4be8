// What every LIGGGHTS deck of this project is made of: lines, sizes of grains, the contact law. SI units.
//
// Only numbers and words of this project's own enums reach a deck, never a string from outside: a deck can
// run shell commands.
#pragma once

#include <fmt/format.h>

#include <array>
#include <cstdint>
#include <iterator>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dem_bridge/deck.hpp"

namespace dem2sph::bridge {

/// Sizes of grains, equal in number.
inline constexpr std::size_t size_count = 5;
/// Diameters over d: equal steps from 1 - spread to 1 + spread.
std::array<double, size_count> size_classes(double spread);
/// Mean volume of a grain over that of a sphere of diameter d.
double mean_cube(double spread);

/// [kg]
double grain_mass(const GrainMaterial& material, double diameter_over_d);

/// LIGGGHTS takes only primes above 10000, and its generators must not start alike. They are drawn from the
/// run's seed by SplitMix64 (Steele, Lea, Flood 2014) between 10^6 and 10^8, each moved on to the next prime.
std::vector<std::int64_t> prime_seeds(std::int64_t seed, std::size_t count);

/// Of the damping to the critical one, for the restitution wanted.
double damping_ratio(const GrainMaterial& material);

struct HookeContact {
  double k_n, k_t, damping;
};
/// Linear spring and dashpot with the restitution wanted, for two grains of diameter d under `pressure`.
HookeContact hooke_contact(const GrainMaterial& material, double pressure);

/// A deck is a text of lines.
class Deck {
 public:
  template <class... Args>
  void add(fmt::format_string<Args...> format, Args&&... args) {
    fmt::format_to(std::back_inserter(text_), format, std::forward<Args>(args)...);
    text_ += '\n';
  }
  std::string text() && { return std::move(text_); }

 private:
  std::string text_;
};

/// The atom types of a deck and what their contacts rub with.
struct ContactTypes {
  int count = 3;
  double friction = 0;
  int smooth = 0;  ///< type whose contacts are without friction; 0: none
};

/// Units, boundaries ("p p f") and how the engine communicates.
void add_settings(Deck& deck, std::string_view boundaries);
void add_friction(Deck& deck, const ContactTypes& types);
/// Neighbours, properties, contact law, time step: a restart file keeps none of them.
void add_contact_law(Deck& deck, const GrainMaterial& material, double pressure, const ContactTypes& types,
                     double step);
/// "model hertz tangential history ...", of pairs and of walls.
std::string contact_model(const GrainMaterial& material);
void add_thermo(Deck& deck, std::int64_t interval);

}  // namespace dem2sph::bridge
