// Turns what is read from files into what coarse_graining.hpp sums up: grains and contacts of LIGGGHTS, and
// frames of SPH particles. The conventions of each side end here: periodic images, contacts beyond Coulomb's
// limit, the sign of stress.
#pragma once

#include "dem_bridge/coarse_graining.hpp"
#include "dem_bridge/dump.hpp"
#include "sph/base/frame.hpp"

namespace dem2sph::bridge {

/// How the grains of the rough walls are seen.
enum class WallGrains {
  part_of_the_packing,  ///< as any grain. They are driven, so the momentum balance does not close at them
  walls  ///< as walls: they carry nothing, and act on the flow's grains at the points of contact
};

/// What a dump does not say about the grains.
struct GrainProperties {
  double rho_s = 0;           ///< [kg/m^3]
  double grain_friction = 0;  ///< Coulomb's limit, to which the forces are cut back (contact_force.hpp)
  double cohesion = 0;        ///< SJKR energy density [J/m^3]
  WallGrains wall_grains = WallGrains::part_of_the_packing;
};

/// Throws InputError if the frames do not belong together.
Snapshot snapshot_of(const GrainFrame& grains, const ContactFrame& contacts,
                     const GrainProperties& properties);

/// Where a 2D frame (plane strain in x[0] and x[1], up) goes in space. Grains have their up in x[2].
enum class PlaneStrain {
  in_x_and_y,  ///< as in the frame: resolve the axes 0 and 1
  in_x_and_z   ///< turned about x, so that up is x[2]: the grid of a slab of grains, axes 0 and 2, fits
};

/// What a frame does not say about SPH particles.
struct SphProperties {
  double mass = 0;   ///< of a particle: rho_0 spacing^dimension; in 2D per metre of depth [kg or kg/m]
  double rho_s = 0;  ///< of the grains that the material consists of: solid volume = mass/rho_s [kg/m^3]
  PlaneStrain plane = PlaneStrain::in_x_and_y;  ///< of no effect in 3D
};

/// Interior particles only (kind 0). Their volume is mass/rho. Frames hold stress with tension positive; the
/// snapshot, as all of coarse-graining, has compression positive. With a 2D frame a grid's `unresolved` is 1,
/// in metres of depth, whatever the depth of a slab of grains beside it.
Snapshot snapshot_of(const Frame& frame, const SphProperties& properties);

/// The grains of a flow (`dem2sph dem`), which a frame holds with their radius. No contacts, but what their
/// stress times volume adds up to (Particle::stress_volume), if the frame has it.
Snapshot snapshot_of_grains(const Frame& frame, double rho_s);

/// `points` points in the middles of as many equal intervals between `low` and `high`.
Axis axis_between(int direction, double low, double high, std::size_t points);

/// Takes the periods and the unresolved measure from the box.
Grid grid_in(const Box& box, std::vector<Axis> axes);

}  // namespace dem2sph::bridge
