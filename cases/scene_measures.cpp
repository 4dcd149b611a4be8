#include "cases/scene_measures.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "dem_bridge/coarse_graining_frames.hpp"
#include "sph/base/deposit.hpp"

namespace dem2sph {
namespace {

FieldsAtTime fields_of(const bridge::Snapshot& snapshot, const Frame& frame, const Wanted& wanted,
                       double depth) {
  bridge::Grid grid = *wanted.grid;
  grid.unresolved = depth;
  // A grain and its neighbours; the same for both.
  const double reach = 3 * wanted.d;
  bridge::Accumulator sums(grid, bridge::Kernel(bridge::KernelShape::lucy, grid.dimension(), reach));
  sums.add(snapshot);
  const auto beside_wall = [&](const Vec<3>& x) {
    return std::any_of(wanted.geometry.walls.begin(), wanted.geometry.walls.end(),
                       [&](const Wall<3>& wall) { return wall.distance(x) < reach; });
  };
  const bool stressed = frame.has("stress");
  FieldsAtTime f;
  f.time = frame.time;
  for (const bridge::FieldPoint& point : sums.fields().points) {
    f.phi.push_back(point.phi);
    f.momentum.push_back(point.momentum[0]), f.momentum.push_back(point.momentum[2]);
    if (!stressed) continue;
    const Sym<3>& stress = point.particle_stress;
    const bool unknown = beside_wall(point.x);
    f.pressure.push_back(unknown ? std::nan("") : (stress(0, 0) + stress(1, 1) + stress(2, 2)) / 3);
    f.shear.push_back(unknown ? std::nan("") : stress(0, 2));
  }
  return f;
}

double share_below(const bridge::Snapshot& snapshot, double height) {
  double all = 0, below = 0;
  for (const bridge::Particle& p : snapshot.particles) {
    all += p.mass;
    if (p.x[2] < height) below += p.mass;
  }
  return below / all;
}

/// [deg]
double slope_of(const bridge::Snapshot& snapshot, const FlowOnDisk& flow, const Wanted& wanted) {
  std::vector<double> x, up, volume;
  for (const bridge::Particle& p : snapshot.particles) {
    x.push_back(p.x[0]), up.push_back(p.x[2]);
    volume.push_back(p.solid_volume / wanted.phi_0);  // as bulk, at the solid fraction of the start
  }
  return surface_angle({x, volume, flow.width, flow.depth}, up, -wanted.surface_within, wanted.surface_within,
                       wanted.d) *
         180 / std::numbers::pi;
}

const FieldsAtTime* nearest(const std::vector<FieldsAtTime>& fields, double time, double tolerance) {
  const FieldsAtTime* best = nullptr;
  for (const FieldsAtTime& p : fields)
    if (std::abs(p.time - time) <= tolerance &&
        (best == nullptr || std::abs(p.time - time) < std::abs(best->time - time)))
      best = &p;
  return best;
}

}  // namespace

FlowOnDisk grains_on_disk(const std::string& label, const std::filesystem::path& folder,
                          const bridge::GrainMaterial& material, double depth) {
  const double rho_s = material.rho_s;
  return {label, folder, [rho_s](const Frame& f) { return bridge::snapshot_of_grains(f, rho_s); }, material.d,
          depth};
}

FlowOnDisk sph_on_disk(const std::string& label, const std::filesystem::path& folder,
                       const nlohmann::json& summary, const LawFile& law, int dimension, double depth) {
  const double dx = summary.at("dx").get<double>();
  const double mass =
      summary.at("initial").at("solid_fraction").get<double>() * law.rho_s * std::pow(dx, dimension);
  const bridge::SphProperties properties{mass, law.rho_s, bridge::PlaneStrain::in_x_and_z};
  return {label, folder, [properties](const Frame& f) { return bridge::snapshot_of(f, properties); }, dx,
          dimension == 2 ? 1 : depth};
}

Seen look_at(const FlowOnDisk& flow, const Wanted& wanted) {
  Seen seen;
  seen.velocity.label = seen.discharge.label = seen.slope.label = flow.label;
  const auto add = [](FlowCurve& curve, double x, double y) { curve.x.push_back(x), curve.y.push_back(y); };
  const std::vector<std::filesystem::path> paths = frames_of(flow.folder);
  std::optional<bridge::Accumulator> profile;
  if (!std::isnan(wanted.profile_height)) {
    const double points = std::max(8.0, std::round(wanted.profile_height / wanted.d));
    bridge::Grid grid;
    grid.axes = {bridge::axis_between(2, 0, wanted.profile_height, static_cast<std::size_t>(points))};
    profile.emplace(grid, bridge::Kernel(bridge::KernelShape::lucy, 1, 1.5 * wanted.d));
  }
  const double end = profile ? read_frame(paths.back()).time : 0;
  for (const std::filesystem::path& path : paths) {
    const Frame frame = read_frame(path);
    const bridge::Snapshot snapshot = flow.snapshot(frame);
    if (wanted.grid) seen.fields.push_back(fields_of(snapshot, frame, wanted, flow.depth));
    if (profile && frame.time >= 0.5 * end) profile->add(snapshot);
    if (!std::isnan(wanted.discharge_below))
      add(seen.discharge, frame.time, share_below(snapshot, wanted.discharge_below));
    if (!std::isnan(wanted.surface_within)) add(seen.slope, frame.time, slope_of(snapshot, flow, wanted));
  }
  if (profile)
    for (const bridge::FieldPoint& p : profile->fields().points)
      add(seen.velocity, std::isfinite(p.velocity[0]) ? p.velocity[0] : 0, p.x[2]);
  return seen;
}

double discharge_rate(const FlowCurve& discharge) {
  double n = 0, t = 0, y = 0, tt = 0, ty = 0;
  for (std::size_t k = 0; k < discharge.x.size(); ++k) {
    const double time = discharge.x[k], share = discharge.y[k];
    if (share < 0.05 || share > 0.4) continue;
    n += 1, t += time, y += share, tt += time * time, ty += time * share;
  }
  return n < 3 ? std::nan("") : (n * ty - t * y) / (n * tt - t * t);
}

double mean_of_second_half(const FlowCurve& history) {
  double sum = 0, n = 0;
  for (std::size_t k = 0; k < history.x.size(); ++k)
    if (history.x[k] >= 0.5 * history.x.back()) sum += history.y[k], n += 1;
  return sum / n;
}

namespace {

/// A field of SPH and of each seed, at all points and times.
struct FieldLists {
  std::vector<double> sph;
  std::vector<std::vector<double>> seeds;
  double largest = 0;  ///< over time, of the root mean square of the grains' mean

  /// Values number `at` of one time; NaN is left out.
  void add(const std::vector<FieldsAtTime>& flows, std::vector<double> FieldsAtTime::*field,
           const std::vector<std::size_t>& at) {
    double square = 0, points = 0;
    seeds.resize(flows.size() - 1);
    for (const std::size_t i : at) {
      if (std::isnan((flows[0].*field)[i])) continue;
      sph.push_back((flows[0].*field)[i]);
      double mean = 0;
      for (std::size_t s = 0; s < seeds.size(); ++s) {
        seeds[s].push_back((flows[s + 1].*field)[i]);
        mean += seeds[s].back() / static_cast<double>(seeds.size());
      }
      square += mean * mean, points += 1;
    }
    if (points > 0) largest = std::max(largest, std::sqrt(square / points));
  }
};

}  // namespace

std::vector<Distance> compare_fields(const Seen& sph, const std::vector<Seen>& seeds, double phi_0,
                                     double tolerance) {
  FieldLists phi, momentum, pressure, shear;
  for (const FieldsAtTime& p : sph.fields) {
    std::vector<FieldsAtTime> flows{p};
    for (const Seen& seed : seeds)
      if (const FieldsAtTime* grains = nearest(seed.fields, p.time, tolerance)) flows.push_back(*grains);
    if (flows.size() <= seeds.size()) continue;
    std::vector<std::size_t> points, components;
    for (std::size_t i = 0; i < p.phi.size(); ++i)
      if (std::any_of(flows.begin(), flows.end(),
                      [&](const FieldsAtTime& f) { return f.phi[i] >= 0.01 * phi_0; }))
        points.push_back(i), components.push_back(2 * i), components.push_back(2 * i + 1);
    phi.add(flows, &FieldsAtTime::phi, points);
    momentum.add(flows, &FieldsAtTime::momentum, components);
    if (std::any_of(flows.begin(), flows.end(), [](const FieldsAtTime& f) { return f.pressure.empty(); }))
      continue;
    pressure.add(flows, &FieldsAtTime::pressure, points);
    shear.add(flows, &FieldsAtTime::shear, points);
  }
  if (phi.sph.empty() || !(momentum.largest > 0)) return {};
  std::vector<Distance> distances{
      compare_lists("solid fraction, over that of the start", phi.sph, phi.seeds, phi_0, 0),
      compare_lists("momentum, over its largest root mean square", momentum.sph, momentum.seeds,
                    momentum.largest, 0)};
  if (pressure.largest > 0) {
    distances.push_back(compare_lists("pressure, over its largest root mean square", pressure.sph,
                                      pressure.seeds, pressure.largest, 0));
    distances.push_back(compare_lists("shear stress, over the pressure's largest root mean square", shear.sph,
                                      shear.seeds, pressure.largest, 0));
  }
  return distances;
}

}  // namespace dem2sph
