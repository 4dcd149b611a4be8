// Values with their errors: intervals, and errors that are scaled by the scatter about a fit.
#pragma once

#include <string>

#include "calibration/fit.hpp"

namespace dem2sph {

/// The 95 % interval is the wider of two: errors taken as known (normal), and errors known up to a common
/// factor that the scatter about the fit tells (Student's t). README, "Intervals". Scales law.covariance.
void scale_errors(LawFit& law, double chi2, double degrees_of_freedom);

Estimate symmetric_estimate(std::string name, double value, double variance, double factor,
                            bool at_bound = false);
/// For what is positive by nature and was fitted as its logarithm.
Estimate positive_estimate(std::string name, double value, double variance, double factor,
                           bool at_bound = false);

}  // namespace dem2sph
