// The shear cell as typed values, and the LIGGGHTS decks made from them.
//
// A slab of grains, periodic along x (flow) and y, stands between two rough walls which are slabs of the
// packing itself. The bottom wall is frozen; the top wall is a rigid body that moves along x at a constant
// speed and is free in z under a constant load. There is no gravity. There are two decks:
//
//   packing   grains are placed at random, loosely, without overlap; the box shrinks in z to a solid fraction
//             of 0.56, with viscous damping, then rests; z opens, the outer slabs become walls, the load
//             comes on, the packing settles (the smaller its grains' friction, the denser). Ends with a
//             restart file.
//   shearing  starts from a restart file, of a packing or of another shearing. Friction takes its value, a
//             linear velocity profile is imposed, the top wall keeps its speed. Dumps frames, or, if it only
//             prepares a sheared sample, writes another restart file.
//
// Only numbers and words of this file's own enums reach a deck, never a string from outside: a deck can run
// shell commands. The last line prints a sentinel with the step, which is the only proof that the engine
// reached the end.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace dem2sph::bridge {

/// Raise it when a change of a deck's text changes results: runs of the old deck are then not reused.
inline constexpr int deck_version = 2;

enum class ContactModel { hertz, hooke };

/// The material card of the grains.
struct GrainMaterial {
  double d = 0;  ///< mean diameter [m]; five sizes with equal numbers, d (1 +- size_spread)
  double size_spread = 0.2;
  double rho_s = 0;           ///< [kg/m^3]
  double grain_friction = 0;  ///< Coulomb coefficient of the contacts in shear
  double restitution = 0;
  ContactModel contact = ContactModel::hertz;
  double youngs_modulus = 0;    ///< hertz [Pa]
  double poisson_ratio = 0;     ///< hertz
  double stiffness = 0;         ///< hooke: k_n/(P d)
  double rolling_friction = 0;  ///< of the elastic-plastic spring-dashpot model epsd2; 0: rolls freely
  double cohesion = 0;          ///< SJKR: attraction per area of contact [J/m^3]; 0: none
};

/// Grains packed between two walls under a load: where every run begins.
struct Sample {
  GrainMaterial material;
  double pressure = 0;          ///< P, the load over the area [Pa]
  std::int64_t grains = 0;      ///< walls included
  double length = 0;            ///< along the flow, in d
  double width = 0;             ///< in d
  double packing_friction = 0;  ///< of the grains while they are packed; 0 packs densely
  /// Time step over the Rayleigh time of the smallest grain (hertz) and over a quarter of a contact's
  /// duration.
  double time_step_fraction = 0.2;
  std::int64_t seed = 0;
  std::int64_t ranks = 1;  ///< MPI processes of the engine; results of different numbers differ by rounding
};

/// How a sample is sheared.
struct Shearing {
  double I_driven = 0;  ///< speed of the wall over the gap at the start, times d sqrt(rho_s/pressure)
  double pressure = 0;  ///< load from now on [Pa]
  int direction = 1;    ///< the wall moves along +x (1) or -x (-1)
  /// The wall and the grains go on as they are (a jump of the pressure); else a linear profile is imposed.
  bool keeps_velocity = false;
  double strain_dropped = 0;  ///< not averaged over
  double strain_used = 0;
  std::int64_t frames = 0;  ///< over strain_used, as densely over strain_dropped; 0: only a restart file
};

/// The wall slabs' thickness in d. Slabs of 1.2 d leak grains, 1.8 d never did.
inline constexpr double wall_thickness_in_d = 1.8;
/// Viscous damping of the top wall over rho_s d^3/t_i, t_i = d sqrt(rho_s/P): it keeps the piston from
/// bouncing.
inline constexpr double piston_damping = 1.0;

/// The time step and what bounds it, for the stiffest and smallest pair of grains.
struct TimeStep {
  double step = 0;               ///< [s]
  double rayleigh = 0;           ///< Rayleigh time of the smallest grain [s]; infinite with linear springs
  double contact_duration = 0;   ///< half a period of the smallest pair on a contact that bears P d^2 [s]
  double fastest_collision = 0;  ///< duration of a collision of the smallest pair at sqrt(P/rho_s) [s]
  std::string bound() const;     ///< "Rayleigh time" or "duration of a contact"
};
TimeStep time_step(const Sample& sample);

/// Stiffness over load: k_n/(P d) of linear springs, (E/P)^(2/3) of Hertz' contacts.
double kappa(const Sample& sample);

/// Everything that follows from the values: what to expect of a run before it has started.
struct DeckPlan {
  TimeStep time_step;
  double inertial_time = 0;  ///< t_i = d sqrt(rho_s/P) [s], P the load of this run
  std::int64_t compress_steps = 0, rest_steps = 0, settle_steps = 0;  ///< of a packing
  std::int64_t frame_interval = 0;  ///< steps, a multiple of 10; of the wall series too
  std::int64_t frames = 0;          ///< dumped; the first one, before any shear, included
  std::int64_t wall_samples = 0;    ///< lines of the wall's series
  std::int64_t last_step = 0;       ///< a shearing starts at step 0
  std::vector<std::int64_t> seeds;  ///< primes above 10000, all different: insertion, distribution, sizes
  double core_seconds = 0;          ///< expected, from measured speeds
  double dump_bytes = 0;            ///< expected
};

/// Both throw UsageError for values that make no cell (too flat, too small a base, a spread that makes grains
/// vanish).
DeckPlan plan_packing(const Sample& sample);
DeckPlan plan_shearing(const Sample& sample, const Shearing& shearing);

std::string packing_deck(const Sample& sample);
/// `restart` is the path of the restart file as seen from the run's folder, of letters, digits, "./_-" only
/// (std::logic_error otherwise).
std::string shearing_deck(const Sample& sample, const Shearing& shearing, const std::string& restart);
/// Reads a restart file back and says so: proof that it is whole.
std::string check_deck(const Sample& sample);

/// Three grains with the material's contact law: proof that the engine has it.
std::string probe_deck(const Sample& sample);

/// What the last line of each deck prints.
std::string sentinel(std::int64_t grains, std::int64_t step);

/// Expected distance of the walls' inner faces in d, with a solid fraction of 0.59.
double expected_gap(const Sample& sample);

/// All values with sorted keys: what the run's hash is made of, and what status and retry read back.
nlohmann::json to_json(const Sample& sample);
nlohmann::json to_json(const Shearing& shearing);
/// Throw InputError if a key is missing or of another type.
Sample sample_from_json(const nlohmann::json& json);
Shearing shearing_from_json(const nlohmann::json& json);

/// Names of the files in a run's folder.
inline constexpr const char* deck_file = "deck.in";
inline constexpr const char* check_deck_file = "check.in";
inline constexpr const char* restart_file = "end.restart";
inline constexpr const char* grain_dump_file = "grains.dump";
inline constexpr const char* contact_dump_file = "contacts.dump";
inline constexpr const char* wall_series_file = "wall.txt";
inline constexpr const char* engine_log_file = "liggghts.log";
inline constexpr const char* engine_output_file = "liggghts.out";

}  // namespace dem2sph::bridge
