#include "dem_bridge/grain_flow_run.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <vector>

#include "dem_bridge/contact_force.hpp"
#include "dem_bridge/dump.hpp"
#include "sph/base/deposit.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/frame.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph::bridge {

namespace fs = std::filesystem;
using nlohmann::json;

const ParameterTable grain_flow_table{
    "dem",
    "The same geometry filled with grains (`dem2sph dem`, `compare`).",
    {{"seeds", Kind::integers, "", 1, 1e9, "[1, 2, 3]",
      "One run a seed: their spread is what a difference is measured by."},
     {"packing_friction", Kind::number, "", 0, 100, "unset",
      "Friction of the grains while they settle: 0 packs densely, 0.5 loosely; unset: that of the material."},
     {"depth", Kind::number, "", 6, 1000, "8",
      "Extent of the slab across that stands for a plane flow, in d, periodic."},
     {"samples", Kind::integer, "", 20, 100000, "200", "Looks at the grains over end_time."},
     {"time_limit", Kind::quantity, "s", 0, 1e9, "0 s", "Wall time of one LIGGGHTS run; 0: none."},
     {"ranks", Kind::integer, "", 1, 1024, "1", "MPI processes of one LIGGGHTS run."}}};

namespace {

constexpr const char* settled_file = "settled.json";

/// x of the image that lies in the domain of a periodic direction.
Vec<3> within(const Geometry<3>& geometry, Vec<3> x) {
  for (int c = 0; c < 3; ++c) {
    if (!geometry.periodic[static_cast<std::size_t>(c)]) continue;
    const double length = geometry.high[c] - geometry.low[c];
    x[c] -= length * std::floor((x[c] - geometry.low[c]) / length);
  }
  return x;
}

/// The largest overlap of two grains over d, found in cells of the largest diameter.
double largest_overlap(const GrainFrame& frame, double d) {
  double widest = 0;
  for (const Grain& g : frame.grains) widest = std::max(widest, 2 * g.radius);
  std::array<std::int64_t, 3> cells{};
  Vec<3> size;
  for (int c = 0; c < 3; ++c) {
    const double extent = frame.box.high[c] - frame.box.low[c];
    std::int64_t& n = cells[static_cast<std::size_t>(c)];
    n = std::max<std::int64_t>(1, static_cast<std::int64_t>(extent / widest));
    size[c] = extent / static_cast<double>(n);
  }
  const auto cell_of = [&](const Vec<3>& x, int c) {
    const std::int64_t n = cells[static_cast<std::size_t>(c)];
    return std::clamp<std::int64_t>(static_cast<std::int64_t>((x[c] - frame.box.low[c]) / size[c]), 0, n - 1);
  };
  std::unordered_map<std::int64_t, std::vector<const Grain*>> grid;
  const auto key = [&](std::int64_t i, std::int64_t j, std::int64_t k) {
    return (k * cells[1] + j) * cells[0] + i;
  };
  for (const Grain& g : frame.grains)
    grid[key(cell_of(g.x, 0), cell_of(g.x, 1), cell_of(g.x, 2))].push_back(&g);
  double largest = 0;
  for (const Grain& g : frame.grains)
    for (std::int64_t dk = -1; dk <= 1; ++dk)
      for (std::int64_t dj = -1; dj <= 1; ++dj)
        for (std::int64_t di = -1; di <= 1; ++di) {
          std::array<std::int64_t, 3> at{cell_of(g.x, 0) + di, cell_of(g.x, 1) + dj, cell_of(g.x, 2) + dk};
          bool outside = false;
          for (std::size_t c = 0; c < 3; ++c) {
            if (frame.box.periodic[c])
              at[c] = (at[c] + cells[c]) % cells[c];
            else
              outside = outside || at[c] < 0 || at[c] >= cells[c];
          }
          if (outside) continue;
          const auto found = grid.find(key(at[0], at[1], at[2]));
          if (found == grid.end()) continue;
          for (const Grain* other : found->second) {
            if (other->id <= g.id) continue;
            const Vec<3> r = nearest_image(g.x - other->x, frame.box);
            largest = std::max(largest, (g.radius + other->radius - norm(r)) / d);
          }
        }
  return largest;
}

/// What the sample is before it flows.
struct Settled {
  std::vector<std::int64_t> cut;  ///< ids of grains outside of the bodies
  std::int64_t grains = 0;        ///< that remain
  double mass = 0;                ///< [kg]
  double solid_fraction = 0;      ///< their volume over that of the bodies
  double core_fraction = 0;  ///< at least 4 d from the bodies' faces, by the grains' centres; 0: no such room
  double centre_of_mass = 0;  ///< its height [m]
  double potential = 0;       ///< [J], from the height 0 along gravity's own direction
  double overlap = 0;         ///< largest, over d
};

Settled read_settled(const GrainFlow& flow, const fs::path& path, std::int64_t grains) {
  GrainDump dump(path);
  GrainFrame frame;
  if (dump.next(frame) != ReadResult::frame)
    throw EngineError(fmt::format("{}: no whole frame", path.string()));
  if (static_cast<std::int64_t>(frame.grains.size()) != grains)
    throw EngineError(fmt::format("{}: {} grains, expected {}", path.string(), frame.grains.size(), grains));
  const GrainMaterial& m = flow.material;
  double volume = 0;
  for (const Body<3>& body : flow.geometry.bodies) volume += volume_of(flow, body);
  Settled out;
  double kinetic = 0, solid = 0, core_solid = 0, core_volume = 0;
  // The core of the first body, if it is a box: walls and surface order the grains beside them.
  const Body<3>& first = flow.geometry.bodies.front();
  Vec<3> low = first.low, high = first.high;
  for (int c = 0; c < 3; ++c)
    if (!flow.geometry.periodic[static_cast<std::size_t>(c)]) low[c] += 4 * m.d, high[c] -= 4 * m.d;
  const bool has_core =
      first.shape == Body<3>::Shape::box && low[0] < high[0] && low[2] < high[2] && low[1] < high[1];
  if (has_core) core_volume = (high[0] - low[0]) * (high[1] - low[1]) * (high[2] - low[2]);
  const double g = norm(flow.gravity);
  for (const Grain& grain : frame.grains) {
    const double v = grain.volume();
    kinetic += 0.5 * m.rho_s * v * dot(grain.v, grain.v);
    const bool inside =
        std::any_of(flow.geometry.bodies.begin(), flow.geometry.bodies.end(), [&](const Body<3>& b) {
          // Grains sink into the hollows of a rough floor: it is the top that is cut.
          Vec<3> x = within(flow.geometry, grain.x);
          x[2] = std::max(x[2], b.low[2]);
          return b.contains(x);
        });
    if (!inside) {
      out.cut.push_back(grain.id);
      continue;
    }
    ++out.grains;
    solid += v;
    out.mass += m.rho_s * v;
    out.centre_of_mass += m.rho_s * v * grain.x[2];
    out.potential -= m.rho_s * v * dot(flow.gravity, grain.x);
    bool in_core = has_core;
    for (int c = 0; c < 3 && in_core; ++c)
      in_core = flow.geometry.periodic[static_cast<std::size_t>(c)] ||
                (grain.x[c] > low[c] && grain.x[c] < high[c]);
    if (in_core) core_solid += v;
  }
  if (out.grains == 0) throw EngineError(fmt::format("{}: no grain lies in a body", path.string()));
  out.centre_of_mass /= out.mass;
  out.solid_fraction = solid / volume;
  out.core_fraction = has_core ? core_solid / core_volume : 0;
  out.overlap = largest_overlap(frame, m.d);
  // A grain that falls through a thousandth of d has this energy; a heap of grains at rest rattles less.
  const double still = 1e-3 * m.rho_s * solid * g * m.d;
  if (!(kinetic < still))
    throw UnfitRun(fmt::format(
        "the sample did not come to rest while it settled: kinetic energy {:.3g} J, limit {:.3g} J", kinetic,
        still));
  if (!(out.overlap < overlap_limit))
    throw UnfitRun(
        fmt::format("grains of the settled sample overlap by {:.2g} d (limit {:g} d): they are too soft",
                    out.overlap, overlap_limit));
  if (out.cut.empty())
    throw UnfitRun(
        "the settled sample does not reach the top of its body: it packs more densely than expected");
  return out;
}

json to_json(const Settled& s, const EngineRun& cost) {
  return {{"cut", s.cut},
          {"grains", s.grains},
          {"mass", s.mass},
          {"solid_fraction", s.solid_fraction},
          {"core_fraction", s.core_fraction},
          {"centre_of_mass", s.centre_of_mass},
          {"potential", s.potential},
          {"overlap_over_d", s.overlap},
          {"cpu_seconds", cost.cpu_seconds},
          {"wall_seconds", cost.wall_seconds}};
}

/// A grain that runs off the floor leaves the engine's box; LIGGGHTS then says no more than "Lost atoms".
EngineRun run_keeping_all(const EngineJob& run, const fs::path& engine, const EngineLimits& limits) {
  try {
    return run_engine(run, engine, limits);
  } catch (const EngineError& error) {
    const std::string text = error.what();
    if (text.find("Lost atoms") == std::string::npos) throw;
    throw EngineError(text +
                      "; a grain ran off the floor or through a gap between walls: give the scene more floor "
                      "(column.floor_length) or a larger [domain]");
  }
}

struct Reduced {
  json series{{"time", json::array()},
              {"front_99", json::array()},
              {"centre_height", json::array()},
              {"kinetic_energy", json::array()},
              {"potential_energy", json::array()},
              {"max_speed", json::array()}};
  json profiles = json::array();
  double time = 0;
  std::int64_t steps = 0;
  double overlap = 0;  ///< largest in the frames that are kept
  bool rest = false;
};

Frame frame_of(const GrainFrame& grains, double time) {
  Frame frame;
  frame.time = time;
  frame.step = static_cast<long>(grains.step);
  frame.dimension = 3;
  FrameField x{"x", "m", 3, {}}, v{"v", "m/s", 3, {}}, radius{"radius", "m", 1, {}}, id{"id", "1", 1, {}},
      kind{"kind", "1", 1, {}}, stress{"stress", "Pa", 6, {}};
  for (const Grain& g : grains.grains) {
    for (int c = 0; c < 3; ++c) x.values.push_back(g.x[c]), v.values.push_back(g.v[c]);
    radius.values.push_back(g.radius);
    id.values.push_back(static_cast<double>(g.id));
    kind.values.push_back(0);
    if (g.stress_volume)
      for (const double s : *g.stress_volume) stress.values.push_back(s / g.volume());
  }
  frame.fields = {std::move(x), std::move(v), std::move(radius), std::move(id), std::move(kind)};
  if (!stress.values.empty()) frame.fields.push_back(std::move(stress));
  return frame;
}

Reduced read_flow(const GrainFlowJob& job, const GrainFlowPlan& plan, const Settled& settled,
                  const fs::path& folder) {
  const GrainFlow& flow = job.flow;
  const FlowScene& scene = job.scene;
  const GrainMaterial& m = flow.material;
  const double g = norm(flow.gravity);
  const double depth = scene.radial ? 1 : flow.geometry.high[1] - flow.geometry.low[1];
  fs::create_directories(folder / "frames");
  GrainDump dump(folder / "engine" / grain_dump_file);
  GrainFrame frame;
  Reduced out;
  std::vector<PvdEntry> pvd;
  std::vector<double> x, volume;
  std::int64_t sample = 0;
  long framed = 0;
  ReadResult result = dump.next(frame);
  while (result == ReadResult::frame) {
    if (stop_requested()) throw Interrupted("stopped while reading a flow of grains");
    if (frame.step != sample * plan.interval)
      throw EngineError(
          fmt::format("frame {} is of step {}, expected {}", sample, frame.step, sample * plan.interval));
    if (static_cast<std::int64_t>(frame.grains.size()) != settled.grains)
      throw EngineError(fmt::format("{} grains at step {}, expected {}: some left the domain",
                                    frame.grains.size(), frame.step, settled.grains));
    out.steps = frame.step;
    out.time = static_cast<double>(frame.step) * plan.time_step.step;
    double kinetic = 0, potential = 0, fastest = 0;
    x.clear(), volume.clear();
    for (const Grain& grain : frame.grains) {
      const double v = grain.volume();
      kinetic += 0.5 * m.rho_s * v * dot(grain.v, grain.v);
      potential -= m.rho_s * v * dot(flow.gravity, grain.x);
      fastest = std::max(fastest, norm(grain.v));
      x.push_back(scene.radial ? std::hypot(grain.x[0], grain.x[1]) : within(flow.geometry, grain.x)[0]);
      volume.push_back(v / settled.solid_fraction);  // as bulk, at the mean solid fraction of the start
    }
    const Bodies bodies{x, volume, m.d, depth};
    const bool front = scene.L0 > 0;
    out.series["time"].push_back(out.time);
    out.series["front_99"].push_back(front ? front_99(bodies) : 0.0);
    out.series["centre_height"].push_back(
        front                       ? centre_height(bodies, centre_strip(m.d, m.d), scene.radial)
        : flow.geometry.periodic[0] ? mean_height(bodies, flow.geometry.low[0], flow.geometry.high[0])
                                    : 0.0);
    out.series["kinetic_energy"].push_back(kinetic);
    out.series["potential_energy"].push_back(potential);
    out.series["max_speed"].push_back(fastest);
    out.rest = flow.stop_at_rest && at_rest(out.time, kinetic, settled.potential, scene.H0, g);
    const bool due = sample * scene.frames >= framed * plan.samples;
    const GrainFrame now = std::move(frame);
    result = dump.next(frame);
    if (due || result != ReadResult::frame) {
      const std::string name = fmt::format("frame_{:05}", framed++);
      const Frame picture = frame_of(now, out.time);
      write_frame(picture, folder / "frames" / (name + ".h5"));
      write_vtp(picture, folder / "frames" / (name + ".vtp"));
      pvd.push_back({out.time, "frames/" + name + ".vtp"});
      out.overlap = std::max(out.overlap, largest_overlap(now, m.d));
      if (front) {
        const HeightProfile profile = deposit_profile(bodies, m.d, scene.floor_end, scene.radial);
        out.profiles.push_back({{"time", out.time}, {"x", profile.x}, {"height", profile.height}});
      }
    }
    ++sample;
  }
  if (result == ReadResult::incomplete) throw EngineError("the last frame of the grains is cut short");
  if (sample < plan.samples + 1 && !out.rest)
    throw EngineError(fmt::format("{} samples of the grains, expected {}", sample, plan.samples + 1));
  write_pvd(pvd, folder / "frames.pvd");
  return out;
}

}  // namespace

std::string describe(const GrainFlowJob& job) {
  const std::vector<PlacedGrain> grains = place_grains(job.flow);
  const GrainFlowPlan plan = plan_grain_flow(job.flow, grains);
  return fmt::format(
      "grains: {} packed with friction {:g} ({} glued to walls), time step {:.3g} s ({}), {} steps to "
      "settle, {} at "
      "most to flow, about {:.0f} core-seconds, dumps of {:.0f} MB\n",
      plan.grains, job.flow.packing_friction, plan.glued, plan.time_step.step, plan.time_step.bound(),
      plan.fall_steps + plan.calm_steps + plan.rest_steps, plan.interval * plan.samples, plan.core_seconds,
      1e-6 * plan.dump_bytes);
}

json run_grain_flow(const GrainFlowJob& job, const GrainFlowOptions& options) {
  const GrainFlow& flow = job.flow;
  const fs::path& folder = options.folder;
  const fs::path engine = folder / "engine";
  const json what{{"flow", to_json(flow)},
                  {"scene", {job.scene.name, job.scene.L0, job.scene.H0, job.scene.radial, job.scene.frames}},
                  {"engine", job.engine}};
  const std::string key = sha256(what.dump());
  if (fs::exists(engine / "job.json")) {
    const bool same = read_json(engine / "job.json").value("key", "") == key;
    if (options.force) {
      fs::remove_all(engine), fs::remove_all(folder / "frames"), fs::remove(folder / "summary.json");
    } else if (!same) {
      throw UsageError(fmt::format(
          "{}: holds another flow of grains; use --force to overwrite it, or another -o", folder.string()));
    } else if (fs::exists(folder / "summary.json")) {
      return read_json(folder / "summary.json");
    }
  }
  fs::create_directories(engine);
  write_file_atomically(engine / "job.json", json{{"key", key}, {"what", what}}.dump(1) + "\n");
  const std::vector<PlacedGrain> grains = place_grains(flow);
  const GrainFlowPlan plan = plan_grain_flow(flow, grains);

  if (!fs::exists(engine / settled_file)) {
    if (!options.quiet)
      spdlog::info("{}: {} grains settle, {} glued to walls", job.description, plan.grains, plan.glued);
    write_file_atomically(engine / grain_data_file, grain_data(flow, grains));
    EngineJob run;
    run.deck = settling_deck(flow, grains);
    run.deck_name = "settling.in";
    run.sentinel = settling_sentinel(grains.size());
    run.ranks = flow.ranks;
    const EngineRun cost = run_engine(run, engine, job.limits);
    const Settled settled = read_settled(flow, engine / settled_dump_file, plan.grains);
    write_file_atomically(engine / settled_file, to_json(settled, cost).dump() + "\n");
  }
  const json before = read_json(engine / settled_file);
  Settled settled;
  before.at("cut").get_to(settled.cut);
  before.at("grains").get_to(settled.grains);
  before.at("mass").get_to(settled.mass);
  before.at("solid_fraction").get_to(settled.solid_fraction);
  before.at("core_fraction").get_to(settled.core_fraction);
  before.at("centre_of_mass").get_to(settled.centre_of_mass);
  before.at("potential").get_to(settled.potential);

  if (!options.quiet)
    spdlog::info("{}: {} grains of solid fraction {:.4f} ({:.4f} in the core) flow", job.description,
                 settled.grains, settled.solid_fraction, settled.core_fraction);
  EngineJob run;
  run.deck = flow_deck(flow, restart_file, settled.cut, 1e-4 * std::abs(settled.potential));
  run.deck_name = "flow.in";
  run.sentinel = flow_sentinel(grains.size() - settled.cut.size());
  run.ranks = flow.ranks;
  run.dump_bytes = plan.dump_bytes;
  const EngineRun cost = run_keeping_all(run, engine, job.limits);
  const Reduced result = read_flow(job, plan, settled, folder);

  const GrainMaterial& m = flow.material;
  const double tau = std::sqrt(job.scene.H0 / norm(flow.gravity));
  const double grain_steps = static_cast<double>(settled.grains) * static_cast<double>(result.steps);
  json summary = {
      {"format", "dem2sph-summary"},
      {"schema_version", 1},
      {"engine", job.engine},
      {"scene", job.scene.name},
      {"formulation", "grains"},
      {"composition", json::array({fmt::format("seed {}", flow.seed)})},
      {"ended", result.rest ? "at rest" : "end time reached"},
      {"time", result.time},
      {"steps", result.steps},
      {"particles", settled.grains},
      {"wall_particles", plan.glued},
      {"particles_lost", 0},  // the first one ends the run with an error
      {"threads", flow.ranks},
      {"wall_seconds", cost.wall_seconds},
      {"cpu_seconds", cost.cpu_seconds},
      {"settling_cpu_seconds", before.at("cpu_seconds")},
      {"particle_steps_per_second", grain_steps / cost.wall_seconds},
      {"dt", {{"min", plan.time_step.step}, {"mean", plan.time_step.step}, {"max", plan.time_step.step}}},
      {"initial",
       {{"L0", job.scene.L0},
        {"H0", job.scene.H0},
        {"solid_fraction", settled.solid_fraction},
        {"core_solid_fraction", settled.core_fraction},
        {"twice_centre_of_mass", 2 * settled.centre_of_mass},
        {"mass", settled.mass},
        {"potential", settled.potential}}},
      {"largest_overlap_over_d", result.overlap},
      {"material", {{"d", m.d}, {"rho_s", m.rho_s}, {"grain_friction", m.grain_friction}}},
      {"depth", flow.geometry.high[1] - flow.geometry.low[1]},
      {"seed", flow.seed},
      {"time_scale", tau},
      {"series", result.series},
      {"profiles", result.profiles},
      {"configuration", key},
      {"provenance", provenance()}};
  if (job.scene.L0 > 0)
    summary["deposit"] = to_json(Deposit{result.series.at("front_99").back().get<double>(),
                                         result.series.at("centre_height").back().get<double>()},
                                 job.scene.L0, result.time / tau);
  write_file_atomically(folder / "summary.json", summary.dump(1) + "\n");
  for (const char* name : {grain_dump_file, settled_dump_file}) fs::remove(engine / name);
  return summary;
}

}  // namespace dem2sph::bridge
