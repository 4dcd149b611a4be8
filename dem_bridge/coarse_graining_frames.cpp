#include "dem_bridge/coarse_graining_frames.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "dem_bridge/contact_force.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {
namespace {

Particle particle_of(const Grain& grain, double rho_s) {
  const double volume = grain.volume();
  return {grain.x, grain.v, rho_s * volume, volume, {}};
}

/// A field of a frame with as many components a particle as it has to have.
const std::vector<double>& values_of(const Frame& frame, const char* name, std::size_t components) {
  const FrameField& field = frame.field(name);
  if (field.components != components || field.values.size() != components * frame.size())
    throw InputError(fmt::format("frame of step {}: \"{}\" has not {} components a particle", frame.step,
                                 name, components));
  return field.values;
}

Vec<3> vector_at(const std::vector<double>& values, std::size_t i) {
  return {{values[3 * i], values[3 * i + 1], values[3 * i + 2]}};
}

}  // namespace

Snapshot snapshot_of(const GrainFrame& grains, const ContactFrame& contacts,
                     const GrainProperties& properties) {
  require_same_step(grains, contacts);
  const auto is_wall = [&](const Grain& grain) {
    return properties.wall_grains == WallGrains::walls && grain.type != GrainType::flow;
  };
  Snapshot snapshot;
  snapshot.particles.reserve(grains.grains.size());
  snapshot.interactions.reserve(contacts.contacts.size());
  const GrainIndex index(grains);
  for (const Grain& grain : grains.grains) {
    if (is_wall(grain)) continue;
    snapshot.particles.push_back(particle_of(grain, properties.rho_s));
  }
  for (const Contact& contact : contacts.contacts) {
    JoinedContact joined = join(contact, grains, index, properties.grain_friction, properties.cohesion);
    const Grain *first = joined.first, *second = joined.second;
    Vec<3>&branch = joined.branch, &force = joined.force;
    if (is_wall(*first)) {
      if (is_wall(*second)) continue;
      std::swap(first, second);
      branch *= -1;
      force *= -1;
    }
    const bool wall = is_wall(*second);
    if (wall) {
      // The point of contact is in the middle of the overlap (Weinhart et al. 2012).
      const double overlap = first->radius + second->radius - joined.distance;
      branch *= (first->radius - 0.5 * overlap) / joined.distance;
    }
    snapshot.interactions.push_back({first->x, branch, force, wall});
  }
  return snapshot;
}

Snapshot snapshot_of(const Frame& frame, const SphProperties& properties) {
  if (!(properties.mass > 0) || !(properties.rho_s > 0))
    throw UsageError("coarse-graining of SPH particles needs their mass and the density of the solid");
  const std::vector<double>&x = values_of(frame, "x", 3), &v = values_of(frame, "v", 3),
        &rho = values_of(frame, "rho", 1), &kind = values_of(frame, "kind", 1),
        &stress = values_of(frame, "stress", 6);
  const bool turns = frame.dimension == 2 && properties.plane == PlaneStrain::in_x_and_z;
  Snapshot snapshot;
  for (std::size_t i = 0; i < frame.size(); ++i) {
    if (kind[i] != 0) continue;
    if (!(rho[i] > 0))
      throw InputError(
          fmt::format("frame of step {}: particle {} has the density {}", frame.step, i, rho[i]));
    Particle p;
    p.x = vector_at(x, i);
    p.v = vector_at(v, i);
    p.mass = properties.mass;
    p.solid_volume = properties.mass / properties.rho_s;
    // Both orders are xx yy zz xy xz yz.
    for (int k = 0; k < 6; ++k)
      p.stress_volume[k] = -properties.mass / rho[i] * stress[6 * i + static_cast<std::size_t>(k)];
    if (turns) {
      // A quarter turn about x: y becomes z and z becomes -y. xx yy zz xy xz yz in the new axes:
      const Sym<3> t = p.stress_volume;
      p.x = {{p.x[0], -p.x[2], p.x[1]}};
      p.v = {{p.v[0], -p.v[2], p.v[1]}};
      p.stress_volume = {{t(0, 0), t(2, 2), t(1, 1), -t(0, 2), t(0, 1), -t(1, 2)}};
    }
    snapshot.particles.push_back(p);
  }
  return snapshot;
}

Snapshot snapshot_of_grains(const Frame& frame, double rho_s) {
  const std::vector<double>&x = values_of(frame, "x", 3), &v = values_of(frame, "v", 3),
        &radius = values_of(frame, "radius", 1);
  const std::vector<double>* stress = frame.has("stress") ? &values_of(frame, "stress", 6) : nullptr;
  Snapshot snapshot;
  snapshot.particles.reserve(frame.size());
  for (std::size_t i = 0; i < frame.size(); ++i) {
    Grain grain;
    grain.x = vector_at(x, i), grain.v = vector_at(v, i);
    grain.radius = radius[i];
    Particle p = particle_of(grain, rho_s);
    for (int k = 0; stress != nullptr && k < 6; ++k)
      p.stress_volume[k] = -grain.volume() * (*stress)[6 * i + static_cast<std::size_t>(k)];
    snapshot.particles.push_back(p);
  }
  return snapshot;
}

Axis axis_between(int direction, double low, double high, std::size_t points) {
  Axis axis;
  axis.direction = direction;
  axis.points = points;
  axis.spacing = (high - low) / static_cast<double>(std::max<std::size_t>(points, 1));
  axis.low = low + 0.5 * axis.spacing;
  return axis;
}

Grid grid_in(const Box& box, std::vector<Axis> axes) {
  Grid grid;
  grid.axes = std::move(axes);
  std::array<bool, 3> is_resolved{};
  for (Axis& axis : grid.axes) {
    if (axis.direction < 0 || axis.direction > 2)
      throw UsageError("the axes of a grid are different ones of 0, 1, 2");
    const auto k = static_cast<std::size_t>(axis.direction);
    is_resolved[k] = true;
    axis.period = box.periodic[k] ? box.high[axis.direction] - box.low[axis.direction] : 0;
  }
  for (int k = 0; k < 3; ++k)
    if (!is_resolved[static_cast<std::size_t>(k)]) grid.unresolved *= box.high[k] - box.low[k];
  return grid;
}

}  // namespace dem2sph::bridge
