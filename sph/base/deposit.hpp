// What a heap looks like from outside: front, height, profile. The same functions see grains and SPH
// particles. Each body is spread evenly over its own width in x, so that the figures do not jump by a whole
// particle.
#pragma once

#include <span>
#include <vector>

namespace dem2sph {

struct Bodies {
  std::span<const double> x;       ///< centres [m]
  std::span<const double> volume;  ///< bulk area (2D) or bulk volume (3D) that each stands for [m^2 or m^3]
  double width = 0;                ///< extent of one in x [m]
  double depth = 1;                ///< extent of the scene across, in 3D [m]
};

/// The x that holds 99 % of the volume (definition `front_99`) [m].
double front_99(const Bodies& bodies);

/// Bulk height, volume over area, in each bin [low + k bin, low + (k+1) bin) [m].
std::vector<double> height_profile(const Bodies& bodies, double low, double bin, std::size_t bins);

/// Bulk height over low < x < high [m].
double mean_height(const Bodies& bodies, double low, double high);

}  // namespace dem2sph
