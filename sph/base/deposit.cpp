#include "sph/base/deposit.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
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

}  // namespace dem2sph
