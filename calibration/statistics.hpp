// Quantiles, and the noise of a transient: an Ornstein-Uhlenbeck process plus white noise, pooled over runs.
//
// Why: solid fraction and friction of a few thousand grains wander slowly. Neighbouring samples of one
// transient repeat each other, and a fit that takes them as independent believes in intervals that cover the
// truth half of the time. With the covariance C of the samples and its Cholesky factor C = L L^T, the
// residuals L^-1 r are independent.
#pragma once

#include <Eigen/Dense>
#include <span>
#include <vector>

namespace dem2sph {

/// x with P(X <= x) = probability for the standard normal.
double normal_quantile(double probability);
/// The same for Student's t with `degrees_of_freedom` > 0, which need not be whole.
double student_t_quantile(double probability, double degrees_of_freedom);

/// Variance of an estimate from those without each of its n data: (n - 1)/n times the sum of squares.
double jackknife_variance(std::span<const double> without);

struct MeanAndSd {
  double mean = 0, sd = 0;
};
/// Mean and standard deviation (n - 1); the latter is 0 of a single value.
MeanAndSd mean_and_sd(std::span<const double> values);

/// Of two values or more, linear between them.
double quantile(std::vector<double> values, double probability);

/// cov(s_i, s_j) = wander_sd^2 exp(-|s_i - s_j|/strain_scale) + white_sd^2 [i = j].
struct NoiseModel {
  double wander_sd = 0;
  double strain_scale = 1;
  double white_sd = 0;

  double variance() const { return wander_sd * wander_sd + white_sd * white_sd; }  ///< of one sample
  Eigen::MatrixXd covariance(std::span<const double> s) const;
  /// L^-1 of covariance = L L^T.
  Eigen::MatrixXd whitening(std::span<const double> s) const;
  /// How many independent samples would tell the mean of these as well: variance times (1^T C^-1 1).
  double independent_samples(std::span<const double> s) const;
};

/// Residuals of one run about a fit, with the columns of the Jacobian that the run has.
struct CorrelatedResiduals {
  std::vector<double> s;
  Eigen::VectorXd residuals;
  Eigen::MatrixXd jacobian;             ///< residuals.size() x parameters.size()
  std::vector<std::size_t> parameters;  ///< which of all the fitted parameters the columns belong to
};

/// Restricted maximum likelihood (Patterson and Thompson 1971): the noise that explains what is left of the
/// residuals once the directions that `count` fitted parameters can absorb are projected out. Plain maximum
/// likelihood would come out too small. Throws IdentifiabilityError if there are no more residuals than
/// parameters or the residuals are all zero.
NoiseModel fit_noise(std::span<const CorrelatedResiduals> runs, std::size_t count);

}  // namespace dem2sph
