// Bodies at rest, as measured: a bed's force and pressure on its floor, drift on a slope, the profile of a
// heap.
#pragma once

#include "sph/base/deposit.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {

inline const std::string bed_at_rest = R"(
[flow]
scene = "inclined_plane"
resolution = 20
end_time = "2 s"
[incline]
height = "0.1 m"
angle = "0 deg"
)" + glass_beads;

struct RestResult {
  double force = 0;           ///< of the floor over the weight
  double floor_pressure = 0;  ///< the particles' pressure extrapolated to the floor, over the weight
  double mean_speed = 0;      ///< mass-weighted mean of |v| over sqrt(g H), largest of the samples
};

/// Runs a bed of 0.1 m for 20 sqrt(H/g) and averages over the last quarter in 50 samples.
template <int Dim>
RestResult measure_rest(const std::vector<std::string>& overrides) {
  const CaseFile file = case_of(bed_at_rest, overrides);
  FlowSetup<Dim> setup = make_setup<Dim>(file, law_of_case(file));
  double area = setup.period.length[0];
  if (Dim == 3) area *= setup.period.length[1];
  const double g = norm(setup.gravity);
  const double H = setup.length_scale;
  auto flow = make_flow<Dim>(std::move(setup));
  const double end = 20 * std::sqrt(H / g);
  run_until(*flow, 0.75 * end);
  RestResult result;
  const int samples = 50;
  for (int i = 0; i < samples; ++i) {
    run_until(*flow, flow->time() + 0.25 * end / samples);
    const Budgets b = flow->budgets();
    const double weight = b.mass * g;
    result.force += b.wall_force[Dim - 1] / weight / samples;
    const Interior q(flow->frame());
    std::vector<double> z, p;
    for (std::size_t k = 0; k < q.size(); ++k)
      if (q.up[k] < 0.5 * H) z.push_back(q.up[k]), p.push_back(q.p[k]);
    result.floor_pressure += Line(z, p).at_zero * area / weight / samples;
    result.mean_speed = std::max(result.mean_speed, b.mean_speed / std::sqrt(g * H));
  }
  return result;
}

struct SlopeResult {
  double early = 0;       ///< mean displacement along the slope over [5, 7] s [m]
  double late = 0;        ///< the same over [13, 15] s
  double early_ring = 0;  ///< root mean square of the mean velocity over [5, 7] s [m/s]
  double late_ring = 0;
};
/// A bed on a slope below its angle of repose. The mean displacement is the integral of momentum over mass,
/// whatever wraps or is sorted.
inline SlopeResult measure_slope(const std::vector<std::string>& overrides) {
  std::vector<std::string> all{"incline.angle=15 deg", "incline.height=0.5 m", "flow.end_time=15 s"};
  all.insert(all.end(), overrides.begin(), overrides.end());
  auto flow = flow_of<2>(case_of(bed_at_rest, all));
  double total = 0;
  const auto advance = [&](double seconds, double& mean_displacement, double& ring) {
    const int pieces = static_cast<int>(std::lround(seconds / 0.005));
    double square = 0;
    mean_displacement = 0;
    for (int i = 0; i < pieces; ++i) {
      const double v0 = flow->budgets().momentum[0] / flow->budgets().mass;
      run_until(*flow, flow->time() + 0.005);
      const double v1 = flow->budgets().momentum[0] / flow->budgets().mass;
      total += 0.005 * 0.5 * (v0 + v1);
      mean_displacement += total / pieces;
      square += v1 * v1 / pieces;
    }
    ring = std::sqrt(square);
  };
  SlopeResult r;
  double ignored = 0;
  advance(5, ignored, ignored);
  advance(2, r.early, r.early_ring);
  advance(6, ignored, ignored);
  advance(2, r.late, r.late_ring);
  return r;
}

/// Largest change of a heap's profile over 10 sqrt(H/g), over its height: bins of two particles. The speed of
/// sound is 20 sqrt(gH): at 10 the heap sags elastically by 1.1 % at its tip (it starts without shear
/// stress), at 20 by a quarter.
struct HeapResult {
  double largest_change = 0;
  double mean_change = 0;
};
inline HeapResult measure_heap(const std::vector<std::string>& overrides) {
  const std::string text = R"(
[flow]
scene = "heap"
resolution = 30
mach = 0.05
end_time = "10 s"
[heap]
height = "0.2 m"
angle = "18.7 deg"
)" + glass_beads;
  const CaseFile file = case_of(text, overrides);
  FlowSetup<2> setup = make_setup<2>(file, law_of_case(file));
  const double H = setup.length_scale;
  const double bin = 2 * setup.dx;
  const double dx = setup.dx;
  const double end = 10 * std::sqrt(H / 9.81);
  const auto bins = static_cast<std::size_t>(setup.floor_end / bin);
  auto flow = make_flow<2>(std::move(setup));
  const auto profile = [&] {
    std::vector<std::array<double, 3>> positions;
    std::vector<double> volumes, x;
    flow->deposit(positions, volumes);
    for (const auto& p : positions) x.push_back(p[0]);
    return height_profile({x, volumes, dx, 1}, 0, bin, bins);
  };
  const std::vector<double> before = profile();
  run_until(*flow, end);
  const std::vector<double> after = profile();
  HeapResult result;
  std::size_t covered = 0;
  for (std::size_t k = 0; k < bins; ++k) {
    const double change = std::abs(after[k] - before[k]) / H;
    result.largest_change = std::max(result.largest_change, change);
    if (before[k] > 0) result.mean_change += change, ++covered;
  }
  result.mean_change /= static_cast<double>(covered);
  return result;
}

}  // namespace dem2sph
