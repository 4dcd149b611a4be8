#include "dem_bridge/grain_flow.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "dem_bridge/deck_text.hpp"
#include "dem_bridge/dump.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {
namespace {

/// Of the glued walls: with sizes of 0.8 to 1.2 d a single layer has holes that a small grain could slip
/// through.
constexpr int wall_layers = 2;
/// Glued grains lie up to this deeper than in a flat layer, so that the wall has no rows to slide along [d].
constexpr double wall_roughness = 0.3;
/// Grains beyond what the body holds, so that the surface can be cut where the case has it. Friction sets how
/// densely they pack; these are upper ends of what the shear cells' packings show (0.645, 0.615, 0.59).
double densest(double packing_friction) {
  return packing_friction < 0.05 ? 0.655 : packing_friction < 0.3 ? 0.635 : 0.615;
}
constexpr double more_than_needed = 1.03;

// Measured with LIGGGHTS 3.8.0 on one core, as in shear cells.
constexpr double grain_steps_a_second = 3.0e6;

std::vector<std::size_t> rough_walls(const Geometry<3>& geometry) {
  std::vector<std::size_t> list;
  for (std::size_t k = 0; k < geometry.walls.size(); ++k)
    if (geometry.walls[k].rough) list.push_back(k);
  return list;
}

/// Atom types: material, each rough wall, and last the smooth surfaces.
ContactTypes types_of(const GrainFlow& flow, double friction) {
  const int count = 2 + static_cast<int>(rough_walls(flow.geometry).size());
  return {.count = count, .friction = friction, .smooth = count};
}

/// Axis that a unit vector is along, or -1.
int axis_of(const Vec<3>& unit) {
  for (int i = 0; i < 3; ++i)
    if (std::abs(unit[i]) > 1 - 1e-9) return i;
  return -1;
}
constexpr const char* axis_names = "xyz";

/// "xplane 0.1", "ycylinder 0.05 0 0"
std::string primitive_plane(int axis, double at) {
  return fmt::format("{}plane {:.10g}", axis_names[axis], at);
}
std::string primitive_cylinder(int axis, double radius, const Vec<3>& point) {
  const int a = axis == 0 ? 1 : 0, b = axis == 2 ? 1 : 2;
  return fmt::format("{}cylinder {:.10g} {:.10g} {:.10g}", axis_names[axis], radius, point[a], point[b]);
}

/// The engine's shape of a smooth wall.
std::string primitive_of(const Wall<3>& wall) {
  const auto refuse = [&](const char* why) {
    throw UsageError(fmt::format("wall \"{}\": {}", wall.name, why));
  };
  if (wall.moves()) refuse("a smooth wall of grains cannot move; make it rough");
  const int axis = axis_of(wall.direction);
  if (wall.shape == WallShape::plane && axis >= 0) return primitive_plane(axis, wall.point[axis]);
  if (wall.shape == WallShape::cylinder && wall.inside && axis >= 0)
    return primitive_cylinder(axis, wall.radius, wall.point);
  refuse("smooth walls of grains are planes normal to an axis or the inside of cylinders; make it rough");
  return "";
}

bool is_periodic(const Geometry<3>& geometry, int axis) {
  return geometry.periodic[static_cast<std::size_t>(axis)];
}

/// True if a wall of the case holds the face of a box: its surface is within 0.1 d of it everywhere.
bool held_by_a_wall(const GrainFlow& flow, const Body<3>& body, int axis, double at) {
  const int a = (axis + 1) % 3, b = (axis + 2) % 3;
  constexpr int points = 9;
  for (int i = 0; i < points; ++i)
    for (int k = 0; k < points; ++k) {
      Vec<3> x;
      x[axis] = at;
      x[a] = body.low[a] + (i + 0.5) / points * (body.high[a] - body.low[a]);
      x[b] = body.low[b] + (k + 0.5) / points * (body.high[b] - body.low[b]);
      if (std::none_of(flow.geometry.walls.begin(), flow.geometry.walls.end(), [&](const Wall<3>& wall) {
            return std::abs(wall.distance(x)) < 0.1 * flow.material.d;
          }))
        return false;
    }
  return true;
}

/// Faces that hold the bodies until the flow begins.
std::vector<std::string> mould_of(const GrainFlow& flow) {
  std::vector<std::string> mould;
  for (const Body<3>& body : flow.geometry.bodies) {
    if (body.shape == Body<3>::Shape::cylinder) {
      mould.push_back(primitive_cylinder(2, body.radius, body.low));
      continue;
    }
    if (body.shape != Body<3>::Shape::box)
      throw UsageError(
          fmt::format("body \"{}\": grains can be packed into a box or a cylinder; a heap of grains is what "
                      "a flow leaves",
                      body.name));
    for (int axis = 0; axis < 3; ++axis) {
      if (is_periodic(flow.geometry, axis)) continue;
      if (!held_by_a_wall(flow, body, axis, body.low[axis]))
        mould.push_back(primitive_plane(axis, body.low[axis]));
      if (axis < 2 && !held_by_a_wall(flow, body, axis, body.high[axis]))
        mould.push_back(primitive_plane(axis, body.high[axis]));
    }
  }
  return mould;
}

/// Uniform in [0, 1), the same on every machine.
class Random {
 public:
  explicit Random(std::int64_t seed) : generator_(static_cast<std::uint64_t>(seed) + 977) {}
  double operator()() { return static_cast<double>(generator_() >> 11U) * 0x1.0p-53; }

 private:
  std::mt19937_64 generator_;
};

struct Room {
  Vec<3> low, high;
};
/// What the engine's box has to hold: all grains, the whole domain, and a margin for grains that jump.
Room box_of(const GrainFlow& flow, const std::vector<PlacedGrain>& grains) {
  Room box{flow.geometry.low, flow.geometry.high};
  for (const PlacedGrain& g : grains)
    for (int i = 0; i < 3; ++i) {
      box.low[i] = std::min(box.low[i], g.x[i]);
      box.high[i] = std::max(box.high[i], g.x[i]);
    }
  const double margin = 2 * flow.material.d + 0.5 * flow.height;
  for (int i = 0; i < 3; ++i) {
    if (is_periodic(flow.geometry, i)) {
      box.low[i] = flow.geometry.low[i], box.high[i] = flow.geometry.high[i];
    } else {
      box.low[i] -= margin, box.high[i] += margin;
    }
  }
  return box;
}

Room room_around(const Body<3>& body) {
  Room room{body.low, body.high};
  if (body.shape == Body<3>::Shape::cylinder)
    for (int axis = 0; axis < 2; ++axis)
      room.low[axis] = body.low[axis] - body.radius, room.high[axis] = body.low[axis] + body.radius;
  return room;
}

bool clear_of_walls(const Geometry<3>& geometry, const Vec<3>& x, double distance) {
  return std::all_of(geometry.walls.begin(), geometry.walls.end(),
                     [&](const Wall<3>& w) { return w.distance(x) > distance; });
}

void add_header(Deck& deck, const GrainFlow& flow, const char* what) {
  const auto boundary = [&](int axis) { return is_periodic(flow.geometry, axis) ? "p" : "f"; };
  deck.add("# dem2sph flow of grains, deck version {}: {}. Made from typed values, not meant to be edited.",
           flow_deck_version, what);
  add_settings(deck, fmt::format("{} {} {}", boundary(0), boundary(1), boundary(2)));
  // Shares of a slab's depth hold as many grains each, wherever the grains flow to; shares of its length
  // don't.
  if (flow.ranks > 1 && is_periodic(flow.geometry, 1)) deck.add("processors 1 {} 1", flow.ranks);
}

/// Glued grains do not touch each other.
void add_walls(Deck& deck, const GrainFlow& flow) {
  const ContactTypes types = types_of(flow, 0);
  for (int a = 2; a < types.smooth; ++a)
    for (int b = a; b < types.smooth; ++b) deck.add("neigh_modify exclude type {} {}", a, b);
  int k = 0;
  for (const Wall<3>& wall : flow.geometry.walls)
    if (!wall.rough)
      deck.add("fix smooth{} flow wall/gran {} primitive type {} {}", k++, contact_model(flow.material),
               types.smooth, primitive_of(wall));
}

/// Viscous rate of a mean grain over the time `seconds` [kg/s].
double drag(const GrainFlow& flow, double seconds) {
  return grain_mass(flow.material, std::cbrt(mean_cube(flow.material.size_spread))) / seconds;
}

double magnitude(const GrainFlow& flow) { return norm(flow.gravity); }
double fall_time(const GrainFlow& flow) { return std::sqrt(flow.height / magnitude(flow)); }

/// The largest pressure: the weight of the bed.
double pressure_of(const GrainFlow& flow) {
  return 0.6 * flow.material.rho_s * magnitude(flow) * flow.height;
}

struct Steps {
  TimeStep time_step;
  std::int64_t interval = 0;
};
/// The step that the grains allow, shortened so that the samples are at the very times of the case. Intervals
/// are multiples of 10, since the force on the walls is averaged over ten looks.
Steps steps_of(const GrainFlow& flow) {
  Sample sample;
  sample.material = flow.material;
  sample.pressure = pressure_of(flow);
  sample.time_step_fraction = flow.time_step_fraction;
  Steps s;
  s.time_step = time_step(sample);
  const double between = flow.end_time / static_cast<double>(flow.samples);
  s.interval =
      10 * std::max<std::int64_t>(1, static_cast<std::int64_t>(std::ceil(between / (10 * s.time_step.step))));
  s.time_step.step = between / static_cast<double>(s.interval);
  return s;
}

}  // namespace

double volume_of(const GrainFlow& flow, const Body<3>& body) {
  const Room room = room_around(body);
  std::array<std::int64_t, 3> n{};
  Vec<3> spacing;
  for (int c = 0; c < 3; ++c) {
    const double extent = room.high[c] - room.low[c];
    std::int64_t& count = n[static_cast<std::size_t>(c)];
    count = std::max<std::int64_t>(1, std::llround(extent / (0.25 * flow.material.d)));
    spacing[c] = extent / static_cast<double>(count);
  }
  std::int64_t inside = 0;
  for (std::int64_t k = 0; k < n[2]; ++k)
    for (std::int64_t j = 0; j < n[1]; ++j)
      for (std::int64_t i = 0; i < n[0]; ++i) {
        Vec<3> x;
        const std::array<std::int64_t, 3> at{i, j, k};
        for (int c = 0; c < 3; ++c)
          x[c] = room.low[c] + (static_cast<double>(at[static_cast<std::size_t>(c)]) + 0.5) * spacing[c];
        if (body.contains(x) && clear_of_walls(flow.geometry, x, 0)) ++inside;
      }
  return static_cast<double>(inside) * spacing[0] * spacing[1] * spacing[2];
}

std::vector<PlacedGrain> place_grains(const GrainFlow& flow) {
  const Geometry<3>& geometry = flow.geometry;
  const double d = flow.material.d;
  const std::array<double, size_count> classes = size_classes(flow.material.size_spread);
  for (const Wall<3>& wall : geometry.walls) {
    if (!wall.rough) primitive_of(wall);
    if (!std::isnan(wall.basal_friction))
      throw UsageError(
          fmt::format("wall \"{}\": basal_friction belongs to the continuum; glued grains have the friction "
                      "of all grains",
                      wall.name));
    if (wall.shape == WallShape::plane && wall.omega != 0)
      throw UsageError(fmt::format("wall \"{}\": a plane of grains cannot turn", wall.name));
  }
  for (int axis = 0; axis < 2; ++axis)
    if (is_periodic(geometry, axis) && geometry.high[axis] - geometry.low[axis] < 5 * d)
      throw UsageError(fmt::format("a periodic length of {:.3g} d is too short for grains: at least 5 d",
                                   (geometry.high[axis] - geometry.low[axis]) / d));
  Random random(flow.seed);
  const auto size = [&] { return classes[static_cast<std::size_t>(random() * size_count)] * d; };

  std::vector<PlacedGrain> grains;
  const std::vector<std::size_t> rough = rough_walls(geometry);
  const GeometryPoints<3> points = fill(geometry, d, wall_layers);
  for (std::size_t i = 0; i < points.walls.size(); ++i) {
    const auto found = std::find(rough.begin(), rough.end(), points.wall[i]);
    if (found == rough.end()) continue;
    PlacedGrain g;
    g.type = 2 + static_cast<int>(found - rough.begin());
    g.diameter = size();
    // Its surface stays behind the wall's.
    const Wall<3>& wall = geometry.walls[points.wall[i]];
    const double deeper = std::max(0.0, 0.5 * (g.diameter - d)) + wall_roughness * d * random();
    g.x = points.walls[i] - deeper * wall.normal(points.walls[i]);
    grains.push_back(g);
  }

  // A body's grains on a cubic lattice of cells that hold the largest, each at a random place in its cell,
  // from the bottom up, wherever there is room.
  mould_of(flow);  // refuses what cannot be packed
  for (const Body<3>& body : geometry.bodies)
    if (norm(body.velocity - geometry.bodies.front().velocity) > 0)
      throw UsageError(fmt::format(
          "body \"{}\": grains of several bodies settle together and start with one velocity", body.name));
  const double cell = 1.02 * classes.back() * d;
  for (const Body<3>& body : geometry.bodies) {
    const Room room = room_around(body);
    const double volume = volume_of(flow, body);
    const double grain = std::numbers::pi / 6 * mean_cube(flow.material.size_spread) * d * d * d;
    const auto wanted = static_cast<std::int64_t>(
        std::ceil(more_than_needed * densest(flow.packing_friction) * volume / grain));

    std::array<std::int64_t, 2> cells{};
    std::array<double, 2> width{};
    for (int axis = 0; axis < 2; ++axis) {
      const auto s = static_cast<std::size_t>(axis);
      cells[s] = static_cast<std::int64_t>(std::floor((room.high[axis] - room.low[axis]) / cell + 1e-9));
      if (cells[s] < 1) throw UsageError(fmt::format("body \"{}\" is narrower than a grain", body.name));
      width[s] = (room.high[axis] - room.low[axis]) / static_cast<double>(cells[s]);
    }
    std::int64_t placed = 0;
    // Far above what a loose lattice needs there is nothing but a wall in the way.
    const auto highest = static_cast<std::int64_t>(std::ceil(8 * (room.high[2] - room.low[2]) / cell)) + 8;
    for (std::int64_t k = 0; placed < wanted; ++k) {
      if (k > highest)
        throw UsageError(
            fmt::format("body \"{}\": only {} of {} grains find a place in it or above it to fall from",
                        body.name, placed, wanted));
      for (std::int64_t j = 0; j < cells[1] && placed < wanted; ++j)
        for (std::int64_t i = 0; i < cells[0] && placed < wanted; ++i) {
          PlacedGrain g;
          g.diameter = size();
          const std::array<double, 3> corner{room.low[0] + static_cast<double>(i) * width[0],
                                             room.low[1] + static_cast<double>(j) * width[1],
                                             room.low[2] + static_cast<double>(k) * cell};
          const std::array<double, 3> extent{width[0], width[1], cell};
          for (int c = 0; c < 3; ++c) {
            const auto s = static_cast<std::size_t>(c);
            g.x[c] = corner[s] + 0.5 * g.diameter + random() * (extent[s] - g.diameter);
          }
          const bool in_mould =
              body.shape != Body<3>::Shape::cylinder ||
              std::hypot(g.x[0] - body.low[0], g.x[1] - body.low[1]) < body.radius - 0.5 * g.diameter;
          if (!in_mould || !clear_of_walls(geometry, g.x, 0.5 * g.diameter)) continue;
          grains.push_back(g);
          ++placed;
        }
    }
  }
  return grains;
}

GrainFlowPlan plan_grain_flow(const GrainFlow& flow, const std::vector<PlacedGrain>& grains) {
  GrainFlowPlan plan;
  const Steps stepping = steps_of(flow);
  plan.time_step = stepping.time_step;
  const double step = plan.time_step.step, tau = fall_time(flow);
  const auto steps = [&](double seconds) { return static_cast<std::int64_t>(std::ceil(seconds / step)); };
  // Free fall over the loose lattice's extra height takes 1.5 tau, its waves as long again; then drag calms
  // down what is left, and a while without it shows whether that is rest.
  plan.fall_steps = steps(3.5 * tau);
  plan.calm_steps = steps(1.0 * tau);
  plan.rest_steps = steps(0.5 * tau);
  plan.samples = flow.samples;
  plan.interval = stepping.interval;
  for (const PlacedGrain& g : grains) ++(g.type == 1 ? plan.grains : plan.glued);
  const auto n = static_cast<double>(plan.grains);
  const auto flow_steps = static_cast<double>(plan.interval * plan.samples);
  plan.core_seconds =
      n * (static_cast<double>(plan.fall_steps + plan.calm_steps + plan.rest_steps) + flow_steps) /
      grain_steps_a_second;
  plan.dump_bytes = 150 * n * static_cast<double>(plan.samples + 1);
  return plan;
}

std::string grain_data(const GrainFlow& flow, const std::vector<PlacedGrain>& grains) {
  const Room box = box_of(flow, grains);
  std::string text = fmt::format("LIGGGHTS data of dem2sph\n\n{} atoms\n{} atom types\n\n", grains.size(),
                                 types_of(flow, 0).count);
  for (int i = 0; i < 3; ++i)
    text += fmt::format("{:.10g} {:.10g} {}lo {}hi\n", box.low[i], box.high[i], axis_names[i], axis_names[i]);
  text += "\nAtoms\n\n";
  for (std::size_t k = 0; k < grains.size(); ++k)
    text +=
        fmt::format("{} {} {:.10g} {:.10g} {:.12g} {:.12g} {:.12g}\n", k + 1, grains[k].type,
                    grains[k].diameter, flow.material.rho_s, grains[k].x[0], grains[k].x[1], grains[k].x[2]);
  return text;
}

std::string settling_deck(const GrainFlow& flow, const std::vector<PlacedGrain>& grains) {
  const GrainFlowPlan plan = plan_grain_flow(flow, grains);
  const ContactTypes types = types_of(flow, flow.packing_friction);
  Deck deck;
  add_header(deck, flow, "grains settle in a mould");
  deck.add("read_data {}", grain_data_file);
  add_contact_law(deck, flow.material, pressure_of(flow), types, plan.time_step.step);
  deck.add("group flow type 1");
  add_walls(deck, flow);
  int k = 0;
  for (const std::string& face : mould_of(flow))
    deck.add("fix mould{} flow wall/gran {} primitive type {} {}", k++, contact_model(flow.material),
             types.smooth, face);
  deck.add("velocity all set 0 0 0");
  deck.add("fix weight flow gravity {:.10g} vector 0 0 -1", magnitude(flow));
  deck.add("fix move flow nve/sphere");
  add_thermo(deck, std::max<std::int64_t>(1, plan.fall_steps / 20));
  deck.add("fix still flow viscous {:.10g}", drag(flow, 2 * fall_time(flow)));
  deck.add("run {}", plan.fall_steps);
  deck.add("unfix still");
  deck.add("fix still flow viscous {:.10g}", drag(flow, 0.1 * fall_time(flow)));
  deck.add("run {}", plan.calm_steps);
  deck.add("unfix still");
  deck.add("run {}", plan.rest_steps);
  deck.add("dump settled flow custom 1 {} id type x y z vx vy vz radius", settled_dump_file);
  deck.add("dump_modify settled format \"%d %d %.9g %.9g %.9g %.7g %.7g %.7g %.7g\"");
  deck.add("run 0");
  deck.add("undump settled");
  deck.add("# the mould stays behind: the restart file may not know its fixes");
  for (int m = 0; m < k; ++m) deck.add("unfix mould{}", m);
  deck.add("reset_timestep 0");
  deck.add("write_restart {}", restart_file);
  deck.add("print \"DEM2SPH settled $(atoms) grains\"");
  return std::move(deck).text();
}

std::string flow_deck(const GrainFlow& flow, const std::string& restart, const std::vector<std::int64_t>& cut,
                      double rest_energy) {
  const GrainFlowPlan plan = plan_grain_flow(flow, {});
  Deck deck;
  add_header(deck, flow, "the flow");
  deck.add("read_restart {}", restart);
  add_contact_law(deck, flow.material, pressure_of(flow), types_of(flow, flow.material.grain_friction),
                  plan.time_step.step);
  add_walls(deck, flow);
  deck.add("run 0   # the engine deletes nothing before a first run");
  constexpr std::size_t a_line = 200;
  for (std::size_t k = 0; k < cut.size(); k += a_line) {
    std::string ids;
    for (std::size_t i = k; i < std::min(cut.size(), k + a_line); ++i) ids += fmt::format(" {}", cut[i]);
    deck.add("group cut id{}", ids);
  }
  if (!cut.empty()) deck.add("delete_atoms group cut compress no");
  const double g = magnitude(flow);
  deck.add("fix weight flow gravity {:.10g} vector {:.10g} {:.10g} {:.10g}", g, flow.gravity[0] / g,
           flow.gravity[1] / g, flow.gravity[2] / g);
  const Vec<3>& thrown = flow.geometry.bodies.front().velocity;
  if (dot(thrown, thrown) > 0)
    deck.add("velocity flow set {:.10g} {:.10g} {:.10g} sum yes units box", thrown[0], thrown[1], thrown[2]);
  deck.add("fix move flow nve/sphere");
  const std::vector<std::size_t> rough = rough_walls(flow.geometry);
  for (std::size_t k = 0; k < rough.size(); ++k) {
    const Wall<3>& w = flow.geometry.walls[rough[k]];
    deck.add("group wall{} type {}", k, k + 2);
    if (w.omega != 0)
      deck.add(
          "fix turn{0} wall{0} move rotate {1:.10g} {2:.10g} {3:.10g} {4:.10g} {5:.10g} {6:.10g} {7:.10g}", k,
          w.point[0], w.point[1], w.point[2], std::copysign(1.0, w.omega) * w.direction[0],
          std::copysign(1.0, w.omega) * w.direction[1], std::copysign(1.0, w.omega) * w.direction[2],
          2 * std::numbers::pi / std::abs(w.omega));
    else if (w.period > 0)  // A sin(2 pi t/period) moves with A 2 pi/period cos(2 pi t/period)
      deck.add("fix swing{0} wall{0} move wiggle {1:.10g} {2:.10g} {3:.10g} {4:.10g}", k,
               w.swing[0] * w.period / (2 * std::numbers::pi), w.swing[1] * w.period / (2 * std::numbers::pi),
               w.swing[2] * w.period / (2 * std::numbers::pi), w.period);
    else if (w.moves())
      deck.add("fix slide{0} wall{0} move linear {1:.10g} {2:.10g} {3:.10g}", k, w.velocity[0], w.velocity[1],
               w.velocity[2]);
  }
  if (!rough.empty()) {
    deck.add("group walls subtract all flow");
    deck.add("compute force walls reduce sum fx fy fz");
    deck.add("fix wallforce all ave/time 10 {} {} c_force[1] c_force[2] c_force[3] file {}",
             plan.interval / 10, plan.interval, wall_force_file);
  }
  add_thermo(deck, plan.interval);
  // Of the pairs alone: what the engine's walls and gravity do to a grain is not in it.
  deck.add("compute flow_stress flow stress/atom pair");
  deck.add("dump grains flow custom {} {} id type x y z vx vy vz radius {}", plan.interval, grain_dump_file,
           fmt::join(stress_columns, " "));
  deck.add(
      "dump_modify grains format \"%d %d %.9g %.9g %.9g %.7g %.7g %.7g %.7g %.5g %.5g %.5g %.5g %.5g "
      "%.5g\"");
  if (flow.stop_at_rest) {
    const double fall = std::sqrt(2.0) * fall_time(flow) / plan.time_step.step;
    deck.add("variable energy equal ke");
    deck.add("variable now equal step");
    deck.add("variable turn loop {}", plan.samples);
    deck.add("label again");
    deck.add("run {}", plan.interval);
    deck.add("if \"${{energy}} < {:.10g} && ${{now}} > {:.0f}\" then \"jump SELF ended\"", rest_energy, fall);
    deck.add("next turn");
    deck.add("jump SELF again");
    deck.add("label ended");
  } else {
    deck.add("run {}", plan.interval * plan.samples);
  }
  deck.add("print \"DEM2SPH flow ended with $(atoms) grains\"");
  return std::move(deck).text();
}

std::string settling_sentinel(std::size_t grains) { return fmt::format("DEM2SPH settled {} grains", grains); }
std::string flow_sentinel(std::size_t grains) {
  return fmt::format("DEM2SPH flow ended with {} grains", grains);
}

nlohmann::json to_json(const GrainFlow& flow) {
  const auto list = [](const Vec<3>& v) { return nlohmann::json{v[0], v[1], v[2]}; };
  Sample sample;
  sample.material = flow.material;
  nlohmann::json walls = nlohmann::json::array(), bodies = nlohmann::json::array();
  // What few cases have is named only where it is there, so that it does not rename the flows of the others.
  for (const Wall<3>& w : flow.geometry.walls) {
    walls.push_back({{"name", w.name},
                     {"shape", static_cast<int>(w.shape)},
                     {"inside", w.inside},
                     {"point", list(w.point)},
                     {"direction", list(w.direction)},
                     {"half", fmt::format("{:.17g} {:.17g} {:.17g}", w.half[0], w.half[1], w.half[2])},
                     {"radius", w.radius},
                     {"velocity", list(w.velocity)},
                     {"omega", w.omega},
                     {"rough", w.rough}});
    if (w.period > 0) walls.back()["period"] = w.period;
  }
  for (const Body<3>& b : flow.geometry.bodies) {
    bodies.push_back({{"name", b.name},
                      {"shape", static_cast<int>(b.shape)},
                      {"low", list(b.low)},
                      {"high", list(b.high)},
                      {"radius", b.radius}});
    if (dot(b.velocity, b.velocity) > 0) bodies.back()["velocity"] = list(b.velocity);
  }
  return {{"deck_version", flow_deck_version},
          {"material", to_json(sample).at("material")},
          {"low", list(flow.geometry.low)},
          {"high", list(flow.geometry.high)},
          {"periodic", flow.geometry.periodic},
          {"walls", walls},
          {"bodies", bodies},
          {"gravity", list(flow.gravity)},
          {"height", flow.height},
          {"packing_friction", flow.packing_friction},
          {"time_step_fraction", flow.time_step_fraction},
          {"seed", flow.seed},
          {"ranks", flow.ranks},
          {"end_time", flow.end_time},
          {"samples", flow.samples},
          {"stop_at_rest", flow.stop_at_rest}};
}

}  // namespace dem2sph::bridge
