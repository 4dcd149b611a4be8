#include "dem_bridge/reduce.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "dem_bridge/contact_force.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {

double sphere_slab_volume(double z, double radius, double low, double high) {
  // Volume below height h over the centre: integral of pi (r^2 - t^2) dt from -r to h.
  const auto below = [radius](double h) {
    h = std::clamp(h, -radius, radius);
    return std::numbers::pi * (radius * radius * h - h * h * h / 3 + 2 * radius * radius * radius / 3);
  };
  return std::max(0.0, below(high - z) - below(low - z));
}

namespace {

/// Slopes of v_x(z) and v_z(z) over weighted grains.
struct VelocityFit {
  double sum = 0, mean_z = 0, gamma_dot = 0, dilation_rate = 0;
  Vec<3> mean_v;
};

struct Moving {
  double weight = 0, z = 0, radius = 0;
  Vec<3> v;
};

VelocityFit fit_velocity(std::span<const Moving> grains) {
  VelocityFit fit;
  for (const Moving& g : grains) {
    fit.sum += g.weight;
    fit.mean_v += g.weight * g.v;
    fit.mean_z += g.weight * g.z;
  }
  fit.mean_v *= 1 / fit.sum;
  fit.mean_z /= fit.sum;
  double zz = 0, zx = 0, zv = 0;
  for (const Moving& g : grains) {
    const double z = g.z - fit.mean_z;
    zz += g.weight * z * z;
    zx += g.weight * z * (g.v[0] - fit.mean_v[0]);
    zv += g.weight * z * (g.v[2] - fit.mean_v[2]);
  }
  fit.gamma_dot = zx / zz;
  fit.dilation_rate = zv / zz;
  return fit;
}

/// d v_x/d z and d v_z/d z averaged over low <= z <= high.
struct MeanGradient {
  double gamma_dot = 0, dilation_rate = 0;
};

/// The mean of a gradient is what its ends say: velocities of two slabs about `low` and `high`, half a slab
/// thick on either side, weighted with the grains' volumes in them, over the distance of the mean heights of
/// those volumes. The slope of a fit would be the same where the profile is straight, but not where shear
/// localises in a part of the core; and only the mean of d v_z/d z is what the change of the core's volume
/// adds up from.
MeanGradient mean_gradient(std::span<const Moving> grains, double low, double high, double half) {
  struct End {
    double volume = 0, z = 0, v_x = 0, v_z = 0;
  };
  const auto end_at = [&](double edge) {
    End end;
    for (const Moving& g : grains) {
      const double volume = sphere_slab_volume(g.z, g.radius, edge - half, edge + half);
      if (volume <= 0) continue;
      end.volume += volume;
      end.z += volume * g.z;
      end.v_x += volume * g.v[0];
      end.v_z += volume * g.v[2];
    }
    end.z /= end.volume, end.v_x /= end.volume, end.v_z /= end.volume;
    return end;
  };
  const End a = end_at(low), b = end_at(high);
  return {(b.v_x - a.v_x) / (b.z - a.z), (b.v_z - a.v_z) / (b.z - a.z)};
}

struct Walls {
  double bottom = 0, top = 0;  ///< mean heights of their grains
};

Walls walls_of(const GrainFrame& frame) {
  Walls walls;
  std::size_t bottom_count = 0, top_count = 0;
  for (const Grain& grain : frame.grains) {
    if (grain.type == GrainType::bottom_wall) walls.bottom += grain.x[2], ++bottom_count;
    if (grain.type == GrainType::top_wall) walls.top += grain.x[2], ++top_count;
  }
  if (bottom_count == 0 || top_count == 0)
    throw InputError(fmt::format("step {}: a wall has no grains", frame.step));
  walls.bottom /= static_cast<double>(bottom_count);
  walls.top /= static_cast<double>(top_count);
  return walls;
}

/// Mean velocity of each grain between two frames, at the middle of its way. Instantaneous velocities contain
/// the grains' rattling; the displacement is their exact integral. The periodic image is the one nearest to
/// where the mean of the two velocities leads.
std::vector<Moving> mean_motion(const GrainFrame& before, const GrainFrame& now, double time) {
  const GrainIndex index(before);
  std::vector<Moving> moving;
  moving.reserve(now.grains.size());
  for (const Grain& grain : now.grains) {
    const Grain* old = index.find(grain.id);
    if (old == nullptr)
      throw InputError(
          fmt::format("step {}: grain {} was not there at step {}", now.step, grain.id, before.step));
    Moving m;
    m.z = 0.5 * (grain.x[2] + old->x[2]);
    m.radius = grain.radius;
    const Vec<3> way = nearest_image(grain.x - old->x, now.box, time * (0.5 * (grain.v + old->v)));
    for (int k = 0; k < 3; ++k) m.v[k] = way[k] / time;
    moving.push_back(m);
  }
  return moving;
}

}  // namespace

CoreState measure_core(const GrainFrame& frame, const ContactFrame& contacts, const Measurement& cell,
                       const GrainFrame* before) {
  require_same_step(frame, contacts);
  const GrainIndex index(frame);
  const Walls walls = walls_of(frame);
  CoreState core;
  core.step = frame.step;
  core.height = walls.top - walls.bottom;
  const double edge = 0.5 * cell.wall_thickness + cell.core_margin;
  const double low = walls.bottom + edge;
  const double high = walls.top - edge;
  core.thickness = high - low;
  if (!(core.thickness > cell.d))
    throw InputError(
        fmt::format("step {}: the core is only {:.2g} d thick; use more grains or a smaller base area",
                    frame.step, core.thickness / cell.d));
  const double volume =
      (frame.box.high[0] - frame.box.low[0]) * (frame.box.high[1] - frame.box.low[1]) * core.thickness;

  // Weights are the volumes inside the core, so that a grain enters gradually.
  std::vector<Moving> moving(frame.grains.size());
  for (std::size_t i = 0; i < frame.grains.size(); ++i) {
    const Grain& grain = frame.grains[i];
    moving[i] = {sphere_slab_volume(grain.x[2], grain.radius, low, high), grain.x[2], grain.radius, grain.v};
  }
  const VelocityFit fit = fit_velocity(moving);
  if (!(fit.sum > 0)) throw InputError(fmt::format("step {}: no grain is in the core", frame.step));
  core.phi = fit.sum / volume;

  // Velocity fluctuations: sum of m v' v' over the volume, v' against the fitted profile.
  for (const Moving& g : moving) {
    if (g.weight <= 0) continue;
    Vec<3> v = g.v - fit.mean_v;
    v[0] -= fit.gamma_dot * (g.z - fit.mean_z);
    v[2] -= fit.dilation_rate * (g.z - fit.mean_z);
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b) core.stress(a, b) += g.weight * cell.rho_s * v[a] * v[b] / volume;
  }
  core.kinetic_zz = core.stress(2, 2);
  core.temperature =
      (core.stress(0, 0) + core.stress(1, 1) + core.stress(2, 2)) / (3 * cell.rho_s * core.phi);

  // Slabs of 3 d at the edges of the core hold some 140 grains of a cell of 8 d x 6 d, and stay clear of the
  // walls.
  const double half = std::min(1.5 * cell.d, cell.core_margin);
  MeanGradient gradient;
  if (before == nullptr) {
    gradient = mean_gradient(moving, low, high, half);
  } else {
    if (before->step >= frame.step)
      throw InputError(fmt::format("step {} is not before step {}", before->step, frame.step));
    const double time = static_cast<double>(frame.step - before->step) * cell.time_step;
    const Walls walls_before = walls_of(*before);
    const double low_then = 0.5 * (low + walls_before.bottom + edge);
    const double high_then = 0.5 * (high + walls_before.top - edge);
    gradient = mean_gradient(mean_motion(*before, frame, time), low_then, high_then, half);
  }
  if (!std::isfinite(gradient.gamma_dot + gradient.dilation_rate))
    throw InputError(fmt::format("step {}: no grain is at an edge of the core", frame.step));
  core.gamma_dot = cell.direction * gradient.gamma_dot;
  core.dilation_rate = gradient.dilation_rate;

  // Contacts: sum of branch times force over the volume, with the fraction of the branch that lies in the
  // core.
  std::size_t cut = 0;
  double touching = 0, fabric = 0;
  for (const Contact& contact : contacts.contacts) {
    const JoinedContact joined = join(contact, frame, index, cell.grain_friction, cell.cohesion);
    const Grain &first = *joined.first, &second = *joined.second;
    const Vec<3>&r = joined.branch, &unit = joined.unit, &force = joined.force;
    core.largest_overlap = std::max(core.largest_overlap, first.radius + second.radius - joined.distance);
    if (joined.was_cut) ++cut;

    const double from = std::min(first.x[2], second.x[2]), to = std::max(first.x[2], second.x[2]);
    const double inside = std::min(to, high) - std::max(from, low);
    double fraction = 0;
    if (to > from)
      fraction = std::max(0.0, inside) / (to - from);
    else
      fraction = from >= low && from <= high ? 1 : 0;  // a branch in a horizontal plane
    if (fraction <= 0) continue;
    touching += fraction;
    fabric += fraction * unit[0] * unit[2];
    for (int i = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j)
        core.stress(i, j) += fraction * 0.5 * (force[i] * r[j] + force[j] * r[i]) / volume;
  }
  if (!contacts.contacts.empty())
    core.cut_contacts = static_cast<double>(cut) / static_cast<double>(contacts.contacts.size());
  double in_core = 0;  // grains, each with the part of its volume
  for (std::size_t i = 0; i < moving.size(); ++i) in_core += moving[i].weight / frame.grains[i].volume();
  core.coordination = 2 * touching / in_core;
  core.fabric_xz = touching > 0 ? cell.direction * fabric / touching : 0;
  core.stress(0, 1) *= cell.direction;
  core.stress(0, 2) *= cell.direction;
  return core;
}

void integrate_strain(std::span<CoreState> frames, double time_step) {
  for (std::size_t i = 1; i < frames.size(); ++i) {
    const double time = static_cast<double>(frames[i].step - frames[i - 1].step) * time_step;
    frames[i].time = frames[i - 1].time + time;
    frames[i].strain = frames[i - 1].strain + frames[i].gamma_dot * time;
  }
}

namespace {

/// I = |g| d / sqrt(p/rho_s); NaN where p is not positive.
double inertial_number(double gamma_dot, double p, const Measurement& cell) {
  if (!(p > 0)) return std::nan("");
  return std::abs(gamma_dot) * cell.d / std::sqrt(p / cell.rho_s);
}

}  // namespace

SteadyMeans reduce_steady(std::span<const CoreState> frames, double strain_dropped, const Measurement& cell) {
  enum Column : std::size_t { p_, tau_, phi_, rate_, xx_, yy_, opening_, columns_ };
  using Row = std::array<double, columns_>;
  std::vector<Row> rows;
  SteadyMeans means;
  double from = 0, to = 0;
  for (const CoreState& f : frames) {
    if (f.strain < strain_dropped) continue;
    if (rows.empty()) from = f.strain;
    to = f.strain;
    rows.push_back({f.p(), f.tau(), f.phi, f.gamma_dot, f.stress(0, 0), f.stress(1, 1), f.dilation_rate});
    means.temperature += f.temperature;
    means.coordination += f.coordination;
    means.fabric_xz += f.fabric_xz;
  }
  // 8 blocks of at least 8 frames: below that the doubling of blocks has nothing to work with.
  if (rows.size() < 64)
    throw EngineError(fmt::format("only {} frames lie beyond the strain of {:.3g} that is dropped",
                                  rows.size(), strain_dropped));

  means.strain = to - from;
  means.frames = rows.size();
  const std::span<const Row> all(rows);
  means.mu = block_jackknife(all, [](const Row& m) { return m[tau_] / m[p_]; });
  means.phi = block_jackknife(all, [](const Row& m) { return m[phi_]; });
  means.p = block_jackknife(all, [](const Row& m) { return m[p_]; });
  means.I = block_jackknife(all, [&](const Row& m) { return inertial_number(m[rate_], m[p_], cell); });
  means.N1 = block_jackknife(all, [](const Row& m) { return m[xx_] / m[p_] - 1; });
  means.N2 = block_jackknife(all, [](const Row& m) { return 1 - m[yy_] / m[p_]; });
  means.beta = block_jackknife(all, [](const Row& m) { return m[opening_] / m[rate_]; });
  const auto n = static_cast<double>(rows.size());
  means.coordination /= n;
  means.fabric_xz /= n;
  double rate = 0;
  for (const Row& row : rows) rate += row[rate_] / n;
  means.temperature /= n * rate * rate * cell.d * cell.d;

  const std::size_t half = rows.size() / 2;
  Row first{}, second{};
  for (std::size_t i = 0; i < half; ++i)
    for (std::size_t k = 0; k < columns_; ++k) {
      first[k] += rows[i][k] / static_cast<double>(half);
      second[k] += rows[rows.size() - 1 - i][k] / static_cast<double>(half);
    }
  means.phi_change = second[phi_] - first[phi_];
  means.mu_change = second[tau_] / second[p_] - first[tau_] / first[p_];
  // The difference of two halves has sqrt(2) * sqrt(2) = 2 times the standard error of the whole.
  if (means.phi.standard_error > 0) means.phi_drift = means.phi_change / (2 * means.phi.standard_error);
  if (means.mu.standard_error > 0) means.mu_drift = means.mu_change / (2 * means.mu.standard_error);
  return means;
}

Transient reduce_transient(std::span<const CoreState> frames, double window, const Measurement& cell) {
  Transient transient;
  if (frames.size() < 2) throw EngineError("the run has no frames");
  transient.phi_0 = frames.front().phi;

  // Integrals over time up to where the strain first reaches s. Rates are means between frames; states are
  // linear between them.
  enum Column : std::size_t { time_, opening_, p_, tau_, phi_, height_, columns_ };
  using Integrals = std::array<double, columns_>;
  const auto step = [](const CoreState& a, const CoreState& b, double part) {
    const double time = part * (b.time - a.time);
    const auto linear = [&](double from, double to) { return time * (from + 0.5 * part * (to - from)); };
    return Integrals{time,
                     time * b.dilation_rate,
                     linear(a.p(), b.p()),
                     linear(a.tau(), b.tau()),
                     linear(a.phi, b.phi),
                     linear(a.height, b.height)};
  };
  const auto sum = [](Integrals a, const Integrals& b, double sign = 1) {
    for (std::size_t k = 0; k < columns_; ++k) a[k] += sign * b[k];
    return a;
  };
  Integrals whole{};
  std::size_t next = 1;
  const auto reach = [&](double s) {
    for (; next + 1 < frames.size() && frames[next].strain < s; ++next)
      whole = sum(whole, step(frames[next - 1], frames[next], 1));
    const CoreState &a = frames[next - 1], &b = frames[next];
    const double part =
        b.strain > a.strain ? std::clamp((s - a.strain) / (b.strain - a.strain), 0.0, 1.0) : 1;
    return sum(whole, step(a, b, part));
  };
  const double reached = std::max_element(frames.begin(), frames.end(), [](const auto& a, const auto& b) {
                           return a.strain < b.strain;
                         })->strain;

  Integrals from{};
  for (int k = 0; (k + 1) * window <= reached * (1 + 1e-12); ++k) {  // rounding must not cost the last window
    const std::size_t before = next;
    const Integrals to = reach((k + 1) * window);
    if (k > 0 && next == before)
      throw EngineError(
          fmt::format("no frame lies between the strains {:.3g} and {:.3g}: raise \"frames\" or \"window\"",
                      k * window, (k + 1) * window));
    const Integrals mean = sum(to, from, -1);
    const double time = mean[time_];
    if (!(mean[p_] > 0))
      throw EngineError(fmt::format("between strain {:.3g} and {:.3g} the core has no pressure", k * window,
                                    (k + 1) * window));
    transient.s.push_back((k + 0.5) * window);
    transient.gamma_dot.push_back(window / time);
    transient.p.push_back(mean[p_] / time);
    transient.mu.push_back(mean[tau_] / mean[p_]);
    transient.I.push_back(inertial_number(window / time, mean[p_] / time, cell));
    transient.phi.push_back(mean[phi_] / time);
    transient.beta.push_back(mean[opening_] / window);
    transient.height.push_back(mean[height_] / time);
    from = to;
  }
  if (transient.s.empty())
    throw EngineError(
        fmt::format("the core was sheared by {:.3g} only, less than a window of {:g}", reached, window));
  return transient;
}

std::vector<WallSample> read_wall_series(const std::filesystem::path& path) {
  DumpLines lines(path);
  std::vector<WallSample> samples;
  std::string_view line;
  while (!lines.at_end() && lines.next(line)) {
    if (line.starts_with('#')) continue;
    WallSample sample;
    const std::vector<std::string_view> cells = DumpLines::words(line);
    if (cells.size() != 4) lines.fail("expected step, height, normal and shear stress of the wall");
    sample.step = lines.number<std::int64_t>(cells[0]);
    sample.height = lines.number<double>(cells[1]);
    sample.p = lines.number<double>(cells[2]);
    sample.tau = lines.number<double>(cells[3]);
    if (!samples.empty() && sample.step <= samples.back().step) lines.fail("steps do not increase");
    samples.push_back(sample);
  }
  return samples;
}

}  // namespace dem2sph::bridge
