#include "dem_bridge/reduce.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>
#include <sstream>
#include <unordered_map>

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

/// The vector from grain b to grain a, through the nearest periodic image.
Vec<3> branch(const Grain& a, const Grain& b, const Box& box) {
  Vec<3> r = a.x - b.x;
  for (int k = 0; k < 3; ++k) {
    if (!box.periodic[static_cast<std::size_t>(k)]) continue;
    const double length = box.high[k] - box.low[k];
    r[k] -= length * std::round(r[k] / length);
  }
  return r;
}

/// The contact law evaluated for a dump, outside the time step, leaves sliding contacts with a tangential
/// force above Coulomb's limit, although the limit held in the step itself. Measured: a quarter of the
/// contacts at I = 0.1; in trial runs it raised mu by 0.3 % (I = 0.005) to 4.5 % (driven I = 0.6). Cut back,
/// core and wall agree to 1 %.
bool cut_to_coulomb(Vec<3>& force, const Vec<3>& unit, double friction) {
  const double normal = dot(force, unit);
  const Vec<3> tangential = force - normal * unit;
  const double size = norm(tangential);
  const double limit = friction * std::abs(normal);
  if (!(size > limit)) return false;
  force = normal * unit + (limit / size) * tangential;
  return size > limit * (1 + 1e-4);  // a contact at its limit differs from it by the dump's six digits
}

}  // namespace

CoreState measure_core(const GrainFrame& frame, const ContactFrame& contacts, const Measurement& cell) {
  if (frame.step != contacts.step)
    throw InputError(
        fmt::format("grains of step {} do not belong to contacts of step {}", frame.step, contacts.step));

  std::unordered_map<std::int64_t, std::size_t> index;
  index.reserve(frame.grains.size());
  double bottom = 0, top = 0;
  std::size_t bottom_count = 0, top_count = 0;
  for (std::size_t i = 0; i < frame.grains.size(); ++i) {
    const Grain& grain = frame.grains[i];
    index.emplace(grain.id, i);
    if (grain.type == GrainType::bottom_wall) bottom += grain.x[2], ++bottom_count;
    if (grain.type == GrainType::top_wall) top += grain.x[2], ++top_count;
  }
  if (bottom_count == 0 || top_count == 0)
    throw InputError(fmt::format("step {}: a wall has no grains", frame.step));
  bottom /= static_cast<double>(bottom_count);
  top /= static_cast<double>(top_count);

  CoreState core;
  core.step = frame.step;
  core.height = top - bottom;
  const double low = bottom + 0.5 * cell.wall_thickness + cell.core_margin;
  const double high = top - 0.5 * cell.wall_thickness - cell.core_margin;
  core.thickness = high - low;
  if (!(core.thickness > cell.d))
    throw InputError(
        fmt::format("step {}: the core is only {:.2g} d thick; use more grains or a smaller base area",
                    frame.step, core.thickness / cell.d));
  const double volume =
      (frame.box.high[0] - frame.box.low[0]) * (frame.box.high[1] - frame.box.low[1]) * core.thickness;

  // Weights are the volumes inside the core, so that a grain enters gradually. Mean velocity and slopes by
  // least squares.
  std::vector<double> weight(frame.grains.size());
  double sum = 0;
  Vec<3> mean_v;
  double mean_z = 0;
  for (std::size_t i = 0; i < frame.grains.size(); ++i) {
    const Grain& grain = frame.grains[i];
    weight[i] = sphere_slab_volume(grain.x[2], grain.radius, low, high);
    sum += weight[i];
    mean_v += weight[i] * grain.v;
    mean_z += weight[i] * grain.x[2];
  }
  if (!(sum > 0)) throw InputError(fmt::format("step {}: no grain is in the core", frame.step));
  mean_v *= 1 / sum;
  mean_z /= sum;
  core.phi = sum / volume;
  double zz = 0, zx = 0, zv = 0;
  for (std::size_t i = 0; i < frame.grains.size(); ++i) {
    const Grain& grain = frame.grains[i];
    const double z = grain.x[2] - mean_z;
    zz += weight[i] * z * z;
    zx += weight[i] * z * (grain.v[0] - mean_v[0]);
    zv += weight[i] * z * (grain.v[2] - mean_v[2]);
  }
  core.gamma_dot = zx / zz;
  core.dilation_rate = zv / zz;

  // Velocity fluctuations: sum of m v' v' over the volume, v' against the fitted profile.
  for (std::size_t i = 0; i < frame.grains.size(); ++i) {
    if (weight[i] <= 0) continue;
    const Grain& grain = frame.grains[i];
    Vec<3> v = grain.v - mean_v;
    v[0] -= core.gamma_dot * (grain.x[2] - mean_z);
    v[2] -= core.dilation_rate * (grain.x[2] - mean_z);
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b) core.stress(a, b) += weight[i] * cell.rho_s * v[a] * v[b] / volume;
  }
  core.kinetic_zz = core.stress(2, 2);

  // Contacts: sum of branch times force over the volume, with the fraction of the branch that lies in the
  // core.
  std::size_t cut = 0;
  for (const Contact& contact : contacts.contacts) {
    const auto a = index.find(contact.first), b = index.find(contact.second);
    if (a == index.end() || b == index.end())
      throw InputError(fmt::format("step {}: contact of {} and {}, of which one is not among the grains",
                                   frame.step, contact.first, contact.second));
    const Grain& first = frame.grains[a->second];
    const Grain& second = frame.grains[b->second];
    const Vec<3> r = branch(first, second, frame.box);
    const double distance = norm(r);
    if (!(distance > 0)) throw InputError(fmt::format("step {}: two grains at one place", frame.step));
    core.largest_overlap = std::max(core.largest_overlap, first.radius + second.radius - distance);
    Vec<3> force = contact.force;
    if (cut_to_coulomb(force, (1 / distance) * r, cell.grain_friction)) ++cut;

    const double from = std::min(first.x[2], second.x[2]), to = std::max(first.x[2], second.x[2]);
    const double inside = std::min(to, high) - std::max(from, low);
    double fraction = 0;
    if (to > from)
      fraction = std::max(0.0, inside) / (to - from);
    else
      fraction = from >= low && from <= high ? 1 : 0;  // a branch in a horizontal plane
    if (fraction <= 0) continue;
    for (int i = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j)
        core.stress(i, j) += fraction * 0.5 * (force[i] * r[j] + force[j] * r[i]) / volume;
  }
  if (!contacts.contacts.empty())
    core.cut_contacts = static_cast<double>(cut) / static_cast<double>(contacts.contacts.size());
  return core;
}

void integrate_strain(std::span<CoreState> frames, double time_step) {
  double strain = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (i > 0) {
      const double time = static_cast<double>(frames[i].step - frames[i - 1].step) * time_step;
      strain += 0.5 * (frames[i].gamma_dot + frames[i - 1].gamma_dot) * time;
    }
    frames[i].strain = strain;
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
  enum Column : std::size_t { p_, tau_, phi_, rate_, xx_, yy_, columns_ };
  using Row = std::array<double, columns_>;
  std::vector<Row> rows;
  double from = 0, to = 0;
  for (const CoreState& f : frames) {
    if (f.strain < strain_dropped) continue;
    if (rows.empty()) from = f.strain;
    to = f.strain;
    rows.push_back({f.p(), f.tau(), f.phi, f.gamma_dot, f.stress(0, 0), f.stress(1, 1)});
  }
  // 8 blocks of at least 8 frames: below that the doubling of blocks has nothing to work with.
  if (rows.size() < 64)
    throw EngineError(fmt::format("only {} frames lie beyond the strain of {:.3g} that is dropped",
                                  rows.size(), strain_dropped));

  SteadyMeans means;
  means.strain = to - from;
  means.frames = rows.size();
  const std::span<const Row> all(rows);
  means.mu = block_jackknife(all, [](const Row& m) { return m[tau_] / m[p_]; });
  means.phi = block_jackknife(all, [](const Row& m) { return m[phi_]; });
  means.p = block_jackknife(all, [](const Row& m) { return m[p_]; });
  means.I = block_jackknife(all, [&](const Row& m) { return inertial_number(m[rate_], m[p_], cell); });
  means.sigma_xx_over_p = block_jackknife(all, [](const Row& m) { return m[xx_] / m[p_]; });
  means.sigma_yy_over_p = block_jackknife(all, [](const Row& m) { return m[yy_] / m[p_]; });
  means.mean_stress_over_p = (means.sigma_xx_over_p.value + means.sigma_yy_over_p.value + 1) / 3;

  const std::size_t half = rows.size() / 2;
  double first = 0, second = 0;
  for (std::size_t i = 0; i < half; ++i) {
    first += rows[i][phi_];
    second += rows[rows.size() - 1 - i][phi_];
  }
  // The difference of two halves has sqrt(2) * sqrt(2) = 2 times the standard error of the whole.
  if (means.phi.standard_error > 0)
    means.drift = (second - first) / static_cast<double>(half) / (2 * means.phi.standard_error);
  return means;
}

Transient reduce_transient(std::span<const CoreState> frames, double window, const Measurement& cell) {
  Transient transient;
  if (frames.empty()) throw EngineError("the run has no frames");
  transient.phi_0 = frames.front().phi;
  std::size_t begin = 0;
  while (begin < frames.size()) {
    std::size_t end = begin + 1;
    while (end < frames.size() && frames[end].strain - frames[begin].strain < window) ++end;
    // A last group that is shorter than a window would be noisier than the others: leave it out.
    if (end == frames.size() && begin > 0 && frames[end - 1].strain - frames[begin].strain < 0.5 * window)
      break;
    double s = 0, rate = 0, p = 0, tau = 0, phi = 0, opening = 0, height = 0;
    for (std::size_t i = begin; i < end; ++i) {
      const CoreState& f = frames[i];
      s += f.strain;
      rate += f.gamma_dot;
      p += f.p();
      tau += f.tau();
      phi += f.phi;
      opening += f.dilation_rate;
      height += f.height;
    }
    const auto n = static_cast<double>(end - begin);
    if (!(p > 0) || !(rate > 0))
      throw EngineError(
          fmt::format("between strain {:.3g} and {:.3g} the core has no pressure or is not sheared forward",
                      frames[begin].strain, frames[end - 1].strain));
    transient.s.push_back(s / n);
    transient.gamma_dot.push_back(rate / n);
    transient.p.push_back(p / n);
    transient.mu.push_back(tau / p);
    transient.I.push_back(inertial_number(rate / n, p / n, cell));
    transient.phi.push_back(phi / n);
    transient.beta.push_back(opening / rate);
    transient.height.push_back(height / n);
    begin = end;
  }
  return transient;
}

std::vector<WallSample> read_wall_series(const std::filesystem::path& path) {
  DumpLines lines(path);
  std::vector<WallSample> samples;
  std::string_view line;
  while (!lines.at_end() && lines.next(line)) {
    if (line.starts_with('#')) continue;
    std::istringstream words{std::string(line)};
    WallSample sample;
    std::string rest;
    if (!(words >> sample.step >> sample.height >> sample.p >> sample.tau) || (words >> rest))
      lines.fail("expected step, height, normal and shear stress of the wall");
    if (!std::isfinite(sample.height + sample.p + sample.tau)) lines.fail("a number is not finite");
    if (!samples.empty() && sample.step <= samples.back().step) lines.fail("steps do not increase");
    samples.push_back(sample);
  }
  return samples;
}

}  // namespace dem2sph::bridge
