#include "sph/base/deposit.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <numeric>

namespace dem2sph {

double front_99(const Bodies& bodies) {
  const double total = std::accumulate(bodies.volume.begin(), bodies.volume.end(), 0.0);
  const auto below = [&](double x) {
    double sum = 0;
    for (std::size_t i = 0; i < bodies.x.size(); ++i)
      sum += bodies.volume[i] * std::clamp((x - bodies.x[i]) / bodies.width + 0.5, 0.0, 1.0);
    return sum;
  };
  const auto [lowest, highest] = std::minmax_element(bodies.x.begin(), bodies.x.end());
  if (lowest == bodies.x.end()) return 0;
  double low = *lowest - bodies.width;
  double high = *highest + bodies.width;
  for (int i = 0; i < 60; ++i) {  // halvings: far below the width of a particle
    const double middle = 0.5 * (low + high);
    (below(middle) < 0.99 * total ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

std::vector<double> height_profile(const Bodies& bodies, double low, double bin, std::size_t bins) {
  std::vector<double> height(bins, 0.0);
  for (std::size_t i = 0; i < bodies.x.size(); ++i) {
    const double left = (bodies.x[i] - 0.5 * bodies.width - low) / bin;
    const double right = (bodies.x[i] + 0.5 * bodies.width - low) / bin;
    const long first = std::max(0L, static_cast<long>(std::floor(left)));
    const long last = std::min(static_cast<long>(bins) - 1, static_cast<long>(std::floor(right)));
    for (long k = first; k <= last; ++k) {
      const double overlap =
          std::min(right, static_cast<double>(k + 1)) - std::max(left, static_cast<double>(k));
      if (overlap > 0)
        height[static_cast<std::size_t>(k)] +=
            bodies.volume[i] * overlap * bin / bodies.width / (bin * bodies.depth);
    }
  }
  return height;
}

double mean_height(const Bodies& bodies, double low, double high) {
  return height_profile(bodies, low, high - low, 1)[0];
}

double centre_strip(double d, double width) { return std::max(3 * d, 2 * width); }

double centre_height(const Bodies& bodies, double strip, bool radial) {
  const double height = mean_height(bodies, 0, strip);
  return radial ? height * bodies.depth / (0.25 * std::numbers::pi * strip) : height;
}

HeightProfile deposit_profile(const Bodies& bodies, double d, double end, bool radial) {
  const double bin = std::max(2 * d, bodies.width);
  const auto bins = static_cast<std::size_t>(std::ceil(end / bin));
  HeightProfile profile{{}, height_profile(bodies, 0, bin, bins)};
  for (std::size_t k = 0; k < bins; ++k) {
    profile.x.push_back((static_cast<double>(k) + 0.5) * bin);
    // The bin's length times the depth is the area that height_profile knows; a ring's is its arc times that.
    if (radial) profile.height[k] *= bodies.depth / (0.5 * std::numbers::pi * profile.x[k]);
  }
  return profile;
}

double surface_angle(const Bodies& bodies, std::span<const double> up, double low, double high, double d) {
  const double bin = 2 * d;
  const auto columns = static_cast<std::size_t>(std::floor((high - low) / bin + 1e-9));
  const auto [lowest, highest] = std::minmax_element(up.begin(), up.end());
  if (lowest == up.end()) return std::nan("");
  const auto layers = static_cast<std::size_t>(std::ceil((*highest - *lowest) / d)) + 1;
  std::vector<double> filled(columns * layers, 0.0);
  for (std::size_t i = 0; i < up.size(); ++i) {
    if (!(bodies.x[i] >= low && bodies.x[i] < low + bin * static_cast<double>(columns))) continue;
    const auto column = static_cast<std::size_t>((bodies.x[i] - low) / bin);
    const auto layer = static_cast<std::size_t>((up[i] - *lowest) / d);
    filled[std::min(column, columns - 1) * layers + layer] += bodies.volume[i] / (bin * d * bodies.depth);
  }
  double n = 0, x = 0, y = 0, xx = 0, xy = 0;
  for (std::size_t c = 0; c < columns; ++c) {
    std::size_t top = layers;
    while (top > 0 && filled[c * layers + top - 1] < 0.5) --top;
    if (top == 0) continue;
    // The volume in the layers above the last half-filled one belongs to the surface too.
    double height = static_cast<double>(top - 1);
    for (std::size_t l = top - 1; l < layers; ++l) height += std::min(1.0, filled[c * layers + l]);
    const double at = low + (static_cast<double>(c) + 0.5) * bin;
    height *= d;
    n += 1, x += at, y += height, xx += at * at, xy += at * height;
  }
  return n < 3 ? std::nan("") : std::atan((n * xy - x * y) / (n * xx - x * x));
}

nlohmann::json to_json(const Deposit& d, double L0, double time_over_tau) {
  return {{"front_99", d.front_99},
          {"runout", (d.front_99 - L0) / L0},
          {"centre_height", d.centre_height},
          {"centre_height_over_L0", d.centre_height / L0},
          {"time_over_tau", time_over_tau}};
}

bool at_rest(double time, double kinetic, double initial_potential, double H, double gravity) {
  return time > std::sqrt(2 * H / gravity) && kinetic < 1e-4 * std::abs(initial_potential);
}

}  // namespace dem2sph
