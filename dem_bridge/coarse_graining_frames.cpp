#include "dem_bridge/coarse_graining_frames.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "dem_bridge/contact_force.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {

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
    const double volume = 4.0 / 3 * std::numbers::pi * grain.radius * grain.radius * grain.radius;
    snapshot.particles.push_back({grain.x, grain.v, properties.rho_s * volume, volume, {}});
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
  const auto values = [&](const char* name, std::size_t components) -> const std::vector<double>& {
    const FrameField& field = frame.field(name);
    if (field.components != components || field.values.size() != components * frame.size())
      throw InputError(fmt::format("frame of step {}: \"{}\" has not {} components a particle", frame.step,
                                   name, components));
    return field.values;
  };
  const std::vector<double>&x = values("x", 3), &v = values("v", 3), &rho = values("rho", 1),
        &kind = values("kind", 1), &stress = values("stress", 6);
  const bool turns = frame.dimension == 2 && properties.plane == PlaneStrain::in_x_and_z;
  Snapshot snapshot;
  for (std::size_t i = 0; i < frame.size(); ++i) {
    if (kind[i] != 0) continue;
    if (!(rho[i] > 0))
      throw InputError(
          fmt::format("frame of step {}: particle {} has the density {}", frame.step, i, rho[i]));
    Particle p;
    for (int k = 0; k < 3; ++k) {
      p.x[k] = x[3 * i + static_cast<std::size_t>(k)];
      p.v[k] = v[3 * i + static_cast<std::size_t>(k)];
    }
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
