// The shear cell as typed values, and the LIGGGHTS deck made from them.
//
// A slab of grains, periodic along x (flow) and y, stands between two rough walls which are slabs of the
// packing itself. The bottom wall is frozen; the top wall is a rigid body that moves along x at a constant
// speed and is free in z under a constant load. There is no gravity. The deck has these stages:
//
//   1. pour      grains are placed at random, loosely, without overlap; their friction is
//   `preparation_friction`
//   2. compress  the box shrinks in z to a solid fraction of 0.56, with viscous damping, then rests
//   3. walls     z opens, the outer slabs become walls, the load comes on, the packing settles (dense if
//   frictionless)
//   4. shear     friction takes its value, a linear velocity profile is imposed, the top wall keeps its
//   speed; frames are dumped
//
// Only numbers and words of this file's own enums reach the deck, never a string from outside: a deck can run
// shell commands. The last line prints a sentinel with the step, which is the only proof that the engine
// reached the end.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace dem2sph::bridge {

/// Raise it when a change of the deck's text changes results: runs of the old deck are then not reused.
inline constexpr int deck_version = 1;

enum class ContactModel { hertz, hooke };

struct GrainMaterial {
  double d = 0;  ///< mean diameter [m]; five sizes with equal numbers, d (1 +- size_spread)
  double size_spread = 0.2;
  double rho_s = 0;           ///< [kg/m^3]
  double grain_friction = 0;  ///< Coulomb coefficient of the contacts in shear
  double restitution = 0;
  ContactModel contact = ContactModel::hertz;
  double youngs_modulus = 0;  ///< hertz [Pa]
  double poisson_ratio = 0;   ///< hertz
  double stiffness = 0;       ///< hooke: k_n/(P d)
};

struct ShearCell {
  GrainMaterial material;
  double pressure = 0;              ///< P, the load over the area [Pa]
  std::int64_t grains = 0;          ///< walls included
  double length = 0;                ///< along the flow, in d
  double width = 0;                 ///< in d
  double core_margin = 4;           ///< distance of the core from the walls' faces, in d
  double I_driven = 0;              ///< speed of the wall over the gap at the start, times d sqrt(rho_s/P)
  double preparation_friction = 0;  ///< 0 packs densely
  double strain_dropped = 0;        ///< steady runs: not averaged over
  double strain_used = 0;
  std::int64_t frames = 0;  ///< over strain_used; as densely over strain_dropped
  double time_step_fraction =
      0.2;  ///< hertz: of the Rayleigh time; hooke: a quarter of it, of the contact's duration
  std::int64_t seed = 0;
};

/// The wall slabs' thickness in d. Slabs of 1.2 d leak grains, 1.8 d never did.
inline constexpr double wall_thickness_in_d = 1.8;
/// Viscous damping of the top wall over rho_s d^3/t_i, t_i = d sqrt(rho_s/P): it keeps the piston from
/// bouncing.
inline constexpr double piston_damping = 1.0;

/// Everything that follows from the cell's values: what to expect of a run before it has started.
struct DeckPlan {
  double time_step = 0;      ///< [s]
  double inertial_time = 0;  ///< t_i = d sqrt(rho_s/P) [s]
  std::int64_t compress_steps = 0;
  std::int64_t rest_steps = 0;
  std::int64_t settle_steps = 0;
  std::int64_t shear_start = 0;     ///< step of the first frame, a multiple of frame_interval
  std::int64_t frame_interval = 0;  ///< steps, a multiple of 10
  std::int64_t frames = 0;          ///< the first one, before any shear, included
  std::int64_t last_step = 0;
  std::vector<std::int64_t>
      seeds;                ///< primes above 10000, all different: insertion, five sizes, distribution
  double core_seconds = 0;  ///< expected, from measured speeds
  double dump_bytes = 0;    ///< expected
};

/// Throws UsageError for values that make no cell (a core that is too thin, a spread that makes grains
/// vanish).
DeckPlan plan_deck(const ShearCell& cell);
std::string write_deck(const ShearCell& cell);

/// What the last line of the deck prints.
std::string sentinel(const ShearCell& cell);

/// Expected distance of the walls' inner faces in d, with a solid fraction of 0.59.
double expected_gap(const ShearCell& cell);

/// All values with sorted keys: what the run's hash is made of, and what status and retry read back.
nlohmann::json to_json(const ShearCell& cell);
/// Throws InputError if a key is missing or of another type.
ShearCell cell_from_json(const nlohmann::json& json);

/// Names of the files in a run's folder.
inline constexpr const char* deck_file = "deck.in";
inline constexpr const char* grain_dump_file = "grains.dump";
inline constexpr const char* contact_dump_file = "contacts.dump";
inline constexpr const char* wall_series_file = "wall.txt";
inline constexpr const char* engine_log_file = "liggghts.log";
inline constexpr const char* engine_output_file = "liggghts.out";

}  // namespace dem2sph::bridge
