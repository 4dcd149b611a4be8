#include "calibration/estimates.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "calibration/statistics.hpp"

namespace dem2sph {

void scale_errors(LawFit& law, double chi2, double degrees_of_freedom) {
  law.chi2 = chi2;
  law.degrees_of_freedom = degrees_of_freedom;
  const double normal = normal_quantile(0.975);
  law.interval_factor = normal;
  if (!(degrees_of_freedom > 0)) return;
  law.chi2_per_dof = chi2 / degrees_of_freedom;
  const double scatter = std::sqrt(law.chi2_per_dof);
  law.error_scale = std::max(1.0, scatter);
  law.interval_factor =
      std::max(normal, student_t_quantile(0.975, degrees_of_freedom) * scatter) / law.error_scale;
  for (std::vector<double>& row : law.covariance)
    for (double& value : row) value *= law.error_scale * law.error_scale;
}

Estimate symmetric_estimate(std::string name, double value, double variance, double factor, bool at_bound) {
  const double error = std::sqrt(std::max(0.0, variance));
  return {std::move(name), value, error, value - factor * error, value + factor * error, at_bound};
}

Estimate positive_estimate(std::string name, double value, double variance, double factor, bool at_bound) {
  const double error = std::sqrt(std::max(0.0, variance));
  const double stretch = std::exp(factor * error / value);
  return {std::move(name), value, error, value / stretch, value * stretch, at_bound};
}

Estimate estimate_of(const std::string& name, const Coordinate& coordinate, double value, double variance,
                     double factor, bool at_bound) {
  return coordinate.is_logarithm_of(name) ? positive_estimate(name, value, variance, factor, at_bound)
                                          : symmetric_estimate(name, value, variance, factor, at_bound);
}

double corrected_AIC(double minus_two_log_likelihood, double n, double k) {
  return n - k - 1 > 0 ? minus_two_log_likelihood + 2 * k + 2 * k * (k + 1) / (n - k - 1)
                       : std::numeric_limits<double>::infinity();
}

LawFit not_fitted(const std::string& member, const std::string& why) {
  LawFit law;
  law.member = member;
  law.failure = why;
  return law;
}

}  // namespace dem2sph
