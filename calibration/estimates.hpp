// Values with their errors: intervals, and errors that are scaled by the scatter about a fit.
#pragma once

#include <string>

#include "calibration/fit.hpp"
#include "calibration/models.hpp"

namespace dem2sph {

/// The 95 % interval is the wider of two: errors taken as known (normal), and errors known up to a common
/// factor that the scatter about the fit tells (Student's t). README, "Intervals". Scales law.covariance.
void scale_errors(LawFit& law, double chi2, double degrees_of_freedom);

Estimate symmetric_estimate(std::string name, double value, double variance, double factor,
                            bool at_bound = false);
/// For what is positive by nature and was fitted as its logarithm.
Estimate positive_estimate(std::string name, double value, double variance, double factor,
                           bool at_bound = false);

/// Whichever of the two belongs to the coordinate in which the parameter was fitted.
Estimate estimate_of(const std::string& name, const Coordinate& coordinate, double value, double variance,
                     double factor, bool at_bound);

/// -2 ln L with the corrected penalty of Akaike (Hurvich and Tsai 1989) of n data and k parameters; infinite
/// without a spare datum, where there is no correction, and no comparison.
double corrected_AIC(double minus_two_log_likelihood, double n, double k);

/// In the place of a member that could not be fitted.
LawFit not_fitted(const std::string& member, const std::string& why);

}  // namespace dem2sph
