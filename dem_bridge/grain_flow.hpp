// A flow of grains on the geometry of a case: as typed values, as grains, as LIGGGHTS decks.
//
// Where SPH fills a body with a lattice of particles, grains have to be packed. Two decks do it:
//
//   settling  Grains on a loose lattice, as many as the body will hold and some more, fall into a mould: its
//             faces, frictionless, wherever no wall of the case is. They settle with the friction
//             `packing_friction`, which sets how densely. Ends with a restart file.
//   flow      What lies outside of the body is taken away, so that the surface is where the case says; the
//             mould goes, gravity takes the direction of the case, moving walls begin to move.
//
// Rough walls are two layers of grains glued to where the wall is, their surface touching it at most; smooth
// ones are frictionless planes and cylinders of the engine. A plane case is a slab, periodic across.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "dem_bridge/deck.hpp"
#include "sph/base/geometry.hpp"

namespace dem2sph::bridge {

/// Raise it when a change of the decks' text or of the grains' places changes results.
inline constexpr int flow_deck_version = 2;

struct GrainFlow {
  GrainMaterial material;
  Geometry<3> geometry;  ///< the third axis is up
  Vec<3> gravity;        ///< of the flow; grains settle along -up [m/s^2]
  double height = 0;     ///< H: sets the pressure that bounds the time step [m]
  double packing_friction = 0;
  double time_step_fraction = 0.2;
  std::int64_t seed = 1;
  std::int64_t ranks = 1;
  double end_time = 0;         ///< [s]
  std::int64_t samples = 200;  ///< of the grains' places over the whole time
  bool stop_at_rest = false;
};

/// One grain as it is put into the settling deck.
struct PlacedGrain {
  int type = 1;         ///< 1: material; 2, 3, ...: glued to the first, second, ... rough wall
  double diameter = 0;  ///< [m]
  Vec<3> x;             ///< [m]
};

/// Grains of the walls, then those of the bodies. The same for the same seed. Throws UsageError for what
/// LIGGGHTS cannot have: smooth walls that are not planes or cylinders along an axis, or that move; planes
/// that turn; bodies that are neither box nor cylinder; a body with no room above it to let grains fall
/// from.
std::vector<PlacedGrain> place_grains(const GrainFlow& flow);

/// Volume of a body without what walls take of it, counted on a lattice of d/4 [m^3]. Exact for boxes whose
/// extents are multiples of that.
double volume_of(const GrainFlow& flow, const Body<3>& body);

/// What to expect of the two decks.
struct GrainFlowPlan {
  TimeStep time_step;
  std::int64_t fall_steps = 0, calm_steps = 0, rest_steps = 0;  ///< of the settling
  std::int64_t interval = 0;                                    ///< steps between two samples
  std::int64_t samples = 0;
  std::int64_t grains = 0;  ///< of the material, before the surface is cut
  std::int64_t glued = 0;
  double core_seconds = 0;
  double dump_bytes = 0;
};
GrainFlowPlan plan_grain_flow(const GrainFlow& flow, const std::vector<PlacedGrain>& grains);

/// read_data file of LIGGGHTS.
std::string grain_data(const GrainFlow& flow, const std::vector<PlacedGrain>& grains);
std::string settling_deck(const GrainFlow& flow, const std::vector<PlacedGrain>& grains);
/// `restart` is a path beside the deck's folder; `cut` are ids of grains to take away; the flow ends when the
/// kinetic energy is below `rest_energy` [J] after a free fall over H, if it may stop at rest.
std::string flow_deck(const GrainFlow& flow, const std::string& restart, const std::vector<std::int64_t>& cut,
                      double rest_energy);

/// Last line that the decks print.
std::string settling_sentinel(std::size_t grains);
std::string flow_sentinel(std::size_t grains);

inline constexpr const char* grain_data_file = "grains.data";
inline constexpr const char* settled_dump_file = "settled.dump";
inline constexpr const char* wall_force_file = "wall_force.txt";

/// Everything that the result depends on, for the name of its folder.
nlohmann::json to_json(const GrainFlow& flow);

}  // namespace dem2sph::bridge
