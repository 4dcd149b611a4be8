// What is seen of a flow beyond its summary: fields on a grid, the profile of its velocity, how fast it runs
// out, the slope of its surface. Grains and SPH particles go through the same functions, as snapshots.
#pragma once

#include <filesystem>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "calibration/comparison.hpp"
#include "dem_bridge/coarse_graining.hpp"
#include "dem_bridge/deck.hpp"
#include "sph/base/frame.hpp"
#include "sph/base/geometry.hpp"
#include "sph/base/law_file.hpp"

namespace dem2sph {

/// One flow on disk, and how its frames are read.
struct FlowOnDisk {
  std::string label;
  std::filesystem::path folder;
  std::function<bridge::Snapshot(const Frame&)> snapshot;
  double width = 0;  ///< extent of a grain or particle [m]
  double depth =
      0;  ///< that the masses of the frames stand for, across: of a slab of grains, 1 of plane SPH [m]
};

/// Flows as `dem2sph dem` and `dem2sph flow` leave them. `depth`: of the slab of grains [m].
FlowOnDisk grains_on_disk(const std::string& label, const std::filesystem::path& folder,
                          const bridge::GrainMaterial& material, double depth);
FlowOnDisk sph_on_disk(const std::string& label, const std::filesystem::path& folder,
                       const nlohmann::json& summary, const LawFile& law, int dimension, double depth);

/// What to look at. A number that is NaN, or a grid that is not there, is not looked at.
struct Wanted {
  double d = 0, phi_0 = 0;           ///< grain size [m], solid fraction of the start
  std::optional<bridge::Grid> grid;  ///< of the fields, over x and up
  /// Points nearer than 3 d to a wall of it are left out of the stress: what walls do to grains is not known.
  Geometry<3> geometry;
  double profile_height = std::numeric_limits<double>::quiet_NaN();   ///< H of an incline [m]
  double discharge_below = std::numeric_limits<double>::quiet_NaN();  ///< [m]
  double surface_within = std::numeric_limits<double>::quiet_NaN();   ///< half of a length about x = 0 [m]
};

/// Solid fraction, momentum (x and up of each point, [kg/(m^2 s)]), pressure and shear stress between x and
/// up [Pa] at one time. Stress is that of contacts (grains) or of the law (SPH), without the flux of
/// momentum; NaN beside walls. Empty if the frames have none.
struct FieldsAtTime {
  double time = 0;  ///< [s]
  std::vector<double> phi, momentum, pressure, shear;
};

struct Seen {
  std::vector<FieldsAtTime> fields;
  /// Velocity down the slope [m/s] against z [m]: mean over the second half of the time, coarse-grained along
  /// z with a Lucy kernel of 1.5 d.
  FlowCurve velocity;
  FlowCurve discharge;  ///< share of the material below the height, against time [s]
  FlowCurve slope;      ///< of the surface [deg], against time [s]
};
/// Every frame is read once.
Seen look_at(const FlowOnDisk& flow, const Wanted& wanted);

/// Slope of the share that has left over time, from a twentieth of the material to 0.4 of it or to the end
/// [1/s]; NaN with fewer than three frames in between.
double discharge_rate(const FlowCurve& discharge);
/// Of a history, over the second half of its time.
double mean_of_second_half(const FlowCurve& history);

/// Distances of the fields over all times at which every flow has a frame to within `tolerance` [s], at
/// points where any has material.
std::vector<Distance> compare_fields(const Seen& sph, const std::vector<Seen>& seeds, double phi_0,
                                     double tolerance);

}  // namespace dem2sph
