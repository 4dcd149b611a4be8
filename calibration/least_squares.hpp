// Weighted nonlinear least squares with bounds, several starts, and an honest covariance. The interface knows
// nothing of Ceres (fit.cpp alone does), so that any model, also one of a test, can be fitted with it.
//
// A residual is (datum - model) divided by the datum's standard error. With residual blocks r and J =
// dr/d(parameters) at the solution the covariance is (J^T J)^-1. An example: two readings 1.0 and 1.2 of one
// constant, each with standard error 0.1, give J = (-10, -10), the constant 1.1 and the error 1/sqrt(200) =
// 0.071.
#pragma once

#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

namespace dem2sph {

struct LeastSquaresParameter {
  std::string name;
  double start = std::numeric_limits<double>::quiet_NaN();
  double lower = -std::numeric_limits<double>::infinity();
  double upper = std::numeric_limits<double>::infinity();
  bool fixed = false;
};

/// Residuals that depend on the same few parameters. Data with correlated errors belong into one block.
struct ResidualBlock {
  std::vector<std::size_t> parameters;  ///< indices into LeastSquaresProblem::parameters
  std::size_t size = 0;                 ///< number of residuals
  /// From the values of `parameters` the residuals and, unless it is empty, the Jacobian, row by row
  /// (size x parameters.size()). Returns false where the model has no value. Several starts are searched at
  /// once, each with a copy of it, so whatever a copy shares with the others may not change.
  std::function<bool(std::span<const double> values, std::span<double> residuals, std::span<double> jacobian)>
      evaluate;
};

struct LeastSquaresProblem {
  std::string name;  ///< for messages: "friction"
  std::vector<LeastSquaresParameter> parameters;
  std::vector<ResidualBlock> blocks;
  int iterations = 500;  ///< limit of a single start
  /// A search ends when chi2 falls by less than this share of it. As tight as rounding allows, unless the
  /// model has kinks, on which a search would go on forever for nothing.
  double tolerance = 1e-15;
  /// Starts that end at chi2 within this of the best have agreed: 1 is one standard error, 0.001 is 0.03 of
  /// it.
  double agreement = 1e-3;
};

struct LeastSquaresResult {
  std::vector<double> values;
  std::vector<bool> at_bound;  ///< was found at a bound, was fixed there, and the rest was solved again
  /// Zero rows and columns for parameters that are fixed or at a bound.
  std::vector<std::vector<double>> covariance;
  std::vector<double> residuals;
  std::vector<std::vector<double>> jacobian;  ///< one row a residual, one column a parameter
  /// Of the Jacobian with columns of length one, free parameters only, largest first.
  std::vector<double> singular_values;
  double chi2 = 0;
  long degrees_of_freedom = 0;
  int starts = 0;     ///< how many were tried
  int converged = 0;  ///< how many of them converged to a usable solution
  int agreed = 0;     ///< how many of those came to the best chi2 within 0.001 (0.03 standard errors)
  int iterations = 0;
  std::string termination;
};

/// What a single search from the parameters' own `start` comes to, without covariance.
struct Minimum {
  bool found = false;
  std::vector<double> values;
  double chi2 = 0;
};
Minimum minimise(const LeastSquaresProblem& problem);

/// Minimises the sum of squares from the parameters' own `start` and from each of `more_starts`; the best
/// solution wins. Throws IdentifiabilityError: fewer residuals than free parameters, no start converged, a
/// Jacobian without full rank. Throws Error(bug) for a start outside its bounds or one that is not finite.
LeastSquaresResult solve_least_squares(const LeastSquaresProblem& problem,
                                       std::span<const std::vector<double>> more_starts = {});

}  // namespace dem2sph
