#include "dem_bridge/deck_text.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace dem2sph::bridge {
namespace {

bool is_prime(std::int64_t n) {
  if (n % 2 == 0) return n == 2;
  for (std::int64_t k = 3; k * k <= n; k += 2)
    if (n % k == 0) return false;
  return n > 1;
}

std::string repeated(double value, int times) {
  std::string text;
  for (int i = 0; i < times; ++i) text += fmt::format(" {:.10g}", value);
  return text;
}

/// A table of pairs of types.
std::string for_pairs(const ContactTypes& types, double value) {
  return repeated(value, types.count * types.count);
}

}  // namespace

std::array<double, size_count> size_classes(double spread) {
  return {1 - spread, 1 - spread / 2, 1.0, 1 + spread / 2, 1 + spread};
}

double mean_cube(double spread) {
  double cubes = 0;
  for (const double s : size_classes(spread)) cubes += s * s * s / size_count;
  return cubes;
}

std::vector<std::int64_t> prime_seeds(std::int64_t seed, std::size_t count) {
  std::vector<std::int64_t> primes;
  auto state = static_cast<std::uint64_t>(seed);
  while (primes.size() < count) {
    state += 0x9e3779b97f4a7c15ULL;
    std::uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    z ^= z >> 31;
    auto candidate = static_cast<std::int64_t>(1'000'000 + z % 99'000'000);
    while (!is_prime(candidate)) ++candidate;
    if (std::find(primes.begin(), primes.end(), candidate) == primes.end()) primes.push_back(candidate);
  }
  return primes;
}

double grain_mass(const GrainMaterial& m, double diameter_over_d) {
  return m.rho_s * std::numbers::pi / 6 * std::pow(diameter_over_d * m.d, 3);
}

double damping_ratio(const GrainMaterial& m) {
  const double log_e = std::log(m.restitution);
  return -log_e / std::hypot(std::numbers::pi, log_e);
}

HookeContact hooke_contact(const GrainMaterial& m, double pressure) {
  const double k_n = m.stiffness * pressure * m.d;
  const double frequency = std::sqrt(k_n / (0.5 * grain_mass(m, 1)));
  // k_t/k_n = 0.8: Mindlin's 2 (1 - nu)/(2 - nu) at nu = 0.3. The engine multiplies the damping by the
  // effective mass.
  return {k_n, 0.8 * k_n, 2 * damping_ratio(m) * frequency};
}

void add_settings(Deck& deck, std::string_view boundaries) {
  deck.add("units si");
  deck.add("atom_style granular");
  deck.add("atom_modify map array");
  deck.add("boundary {}", boundaries);
  deck.add("newton off");
  deck.add("communicate single vel yes");
}

void add_friction(Deck& deck, const ContactTypes& types) {
  std::string table;
  for (int a = 1; a <= types.count; ++a)
    for (int b = 1; b <= types.count; ++b)
      table += repeated(a == types.smooth || b == types.smooth ? 0 : types.friction, 1);
  deck.add("fix friction all property/global coefficientFriction peratomtypepair {}{}", types.count, table);
}

void add_contact_law(Deck& deck, const GrainMaterial& m, double pressure, const ContactTypes& types,
                     double step) {
  deck.add("neighbor {:.10g} bin", 0.25 * m.d);
  deck.add("neigh_modify delay 0");
  const auto of_pairs = [&](const char* fix, const char* property, double value) {
    deck.add("fix {} all property/global {} peratomtypepair {}{}", fix, property, types.count,
             for_pairs(types, value));
  };
  if (m.contact == ContactModel::hertz) {
    deck.add("fix young all property/global youngsModulus peratomtype{}",
             repeated(m.youngs_modulus, types.count));
    deck.add("fix poisson all property/global poissonsRatio peratomtype{}",
             repeated(m.poisson_ratio, types.count));
    of_pairs("bounce", "coefficientRestitution", m.restitution);
  } else {
    const HookeContact contact = hooke_contact(m, pressure);
    of_pairs("normal", "kn", contact.k_n);
    of_pairs("tangential", "kt", contact.k_t);
    of_pairs("normaldamping", "gamman", contact.damping);
    of_pairs("tangentialdamping", "gammat", 0);
  }
  add_friction(deck, types);
  if (m.cohesion > 0) of_pairs("cohesion", "cohesionEnergyDensity", m.cohesion);
  if (m.rolling_friction > 0) of_pairs("rolling", "coefficientRollingFriction", m.rolling_friction);
  deck.add("pair_style gran {}", contact_model(m));
  deck.add("pair_coeff * *");
  deck.add("timestep {:.10g}", step);
}

std::string contact_model(const GrainMaterial& m) {
  const bool hertz = m.contact == ContactModel::hertz;
  // The engine wants its keywords in this order.
  return fmt::format("model {} tangential history{}{}{}", hertz ? "hertz" : "hooke/stiffness",
                     m.cohesion > 0 ? " cohesion sjkr" : "",
                     m.rolling_friction > 0 ? " rolling_friction epsd2" : "",
                     hertz ? "" : " tangential_damping off");
}

void add_thermo(Deck& deck, std::int64_t interval) {
  deck.add("thermo_style custom step atoms ke cpu");
  deck.add("thermo {}", interval);
  deck.add("thermo_modify lost error norm no");
}

}  // namespace dem2sph::bridge
