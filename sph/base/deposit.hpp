// What a heap looks like from outside: front, height, profile. The same functions see grains and SPH
// particles. Each body is spread evenly over its own width in x, so that the figures do not jump by a whole
// particle.
#pragma once

#include <nlohmann/json.hpp>
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

/// Width of the strip "at the centre": 3 d, but at least two bodies [m].
double centre_strip(double d, double width);
/// Bulk height of the strip 0 < x < strip, or, if x is a radius of a quarter of a heap of depth 1, of the
/// quarter disc [m].
double centre_height(const Bodies& bodies, double strip, bool radial);

/// Heights in bins of 2 d, at least one body wide, from 0 to `end`, with the middles of the bins. Where x is
/// a radius of a quarter of a heap of depth 1, bins are quarters of rings.
struct HeightProfile {
  std::vector<double> x, height;  ///< [m]
};
HeightProfile deposit_profile(const Bodies& bodies, double d, double end, bool radial);

/// What is left, as every summary.json of a flow with a front says it.
struct Deposit {
  double front_99 = 0, centre_height = 0;  ///< [m]
};
nlohmann::json to_json(const Deposit& deposit, double L0, double time_over_tau);

/// Slope of a surface [rad], positive where it rises with x: line through the tops of columns of 2 d over
/// low < x < high, a top being where the bulk volume in layers of 1 d falls below half of the layer. NaN with
/// fewer than three columns that have a top.
double surface_angle(const Bodies& bodies, std::span<const double> up, double low, double high, double d);

/// A collapse is at rest (definition `rest`): kinetic energy below 1e-4 of the initial potential energy. At
/// t = 0 nothing moves either, so it counts once a free fall over H would have taken place.
bool at_rest(double time, double kinetic, double initial_potential, double H, double gravity);

}  // namespace dem2sph
