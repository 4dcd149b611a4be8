#include "calibration/statistics.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

// Regularised incomplete beta function by its continued fraction (Lentz), for x < (a + 1)/(a + b + 2).
double beta_fraction(double x, double a, double b) {
  constexpr double tiny = 1e-300;
  double c = 1;
  double d = 1 - (a + b) * x / (a + 1);
  d = 1 / (std::abs(d) < tiny ? tiny : d);
  double f = d;
  for (int m = 1; m < 10000; ++m) {
    const double even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m));
    const double odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1));
    for (const double step : {even, odd}) {
      d = 1 + step * d;
      d = 1 / (std::abs(d) < tiny ? tiny : d);
      c = 1 + step / c;
      if (std::abs(c) < tiny) c = tiny;
      f *= c * d;
    }
    if (std::abs(c * d - 1) < 1e-15) break;
  }
  return f;
}

double incomplete_beta(double x, double a, double b) {
  if (x <= 0) return 0;
  if (x >= 1) return 1;
  const double front =
      std::exp(std::lgamma(a + b) - std::lgamma(a) - std::lgamma(b) + a * std::log(x) + b * std::log1p(-x));
  return x < (a + 1) / (a + b + 2) ? front * beta_fraction(x, a, b) / a
                                   : 1 - front * beta_fraction(1 - x, b, a) / b;
}

// P(T <= t) for t >= 0.
double student_t_probability(double t, double dof) {
  return 1 - 0.5 * incomplete_beta(dof / (dof + t * t), 0.5 * dof, 0.5);
}

// Bisection of a rising function; 200 halvings exhaust a double.
template <class Function>
double solve_rising(const Function& probability_below, double target) {
  double low = 0;
  double high = 1;
  while (probability_below(high) < target && high < 1e12) high *= 2;
  for (int i = 0; i < 200; ++i) {
    const double middle = 0.5 * (low + high);
    (probability_below(middle) < target ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

Eigen::MatrixXd correlation(std::span<const double> s, double strain_scale, double white_share) {
  const auto n = static_cast<Eigen::Index>(s.size());
  Eigen::MatrixXd r(n, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      r(i, j) = (1 - white_share) *
                    std::exp(-std::abs(s[static_cast<std::size_t>(i)] - s[static_cast<std::size_t>(j)]) /
                             strain_scale) +
                (i == j ? white_share : 0.0);
  return r;
}

struct Restricted {
  double objective = std::numeric_limits<double>::infinity();  // -2 log likelihood, up to a constant
  double variance = 0;
};

Restricted restricted_likelihood(std::span<const CorrelatedResiduals> runs, std::size_t count,
                                 double strain_scale, double white_share) {
  const auto p = static_cast<Eigen::Index>(count);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(p, p);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(p);
  double squares = 0;
  double log_determinant = 0;
  Eigen::Index n = 0;
  Eigen::LLT<Eigen::MatrixXd> factor;
  const std::vector<double>* factored = nullptr;  // transients usually share their strain axis
  for (const CorrelatedResiduals& run : runs) {
    if (factored == nullptr || *factored != run.s) {
      factor.compute(correlation(run.s, strain_scale, white_share));
      factored = &run.s;
    }
    if (factor.info() != Eigen::Success) return {};
    const Eigen::VectorXd r = factor.matrixL().solve(run.residuals);
    const Eigen::MatrixXd j = factor.matrixL().solve(run.jacobian);
    const Eigen::MatrixXd jj = j.transpose() * j;
    const Eigen::VectorXd jr = j.transpose() * r;
    for (Eigen::Index a = 0; a < jj.rows(); ++a) {
      const auto row = static_cast<Eigen::Index>(run.parameters[static_cast<std::size_t>(a)]);
      right(row) += jr(a);
      for (Eigen::Index b = 0; b < jj.cols(); ++b)
        normal(row, static_cast<Eigen::Index>(run.parameters[static_cast<std::size_t>(b)])) += jj(a, b);
    }
    squares += r.squaredNorm();
    log_determinant += 2 * factor.matrixLLT().diagonal().array().log().sum();
    n += r.size();
  }
  if (p > 0) {
    const Eigen::LDLT<Eigen::MatrixXd> of_parameters(normal);
    if (of_parameters.info() != Eigen::Success || !(of_parameters.vectorD().minCoeff() > 0)) return {};
    squares -= right.dot(of_parameters.solve(right));
    log_determinant += of_parameters.vectorD().array().log().sum();
  }
  if (!(squares > 0)) return {};
  const double free = static_cast<double>(n - p);
  return {log_determinant + free * std::log(squares / free), squares / free};
}

}  // namespace

double normal_quantile(double probability) {
  if (!(probability > 0 && probability < 1)) throw Error(ExitCode::bug, "a probability lies between 0 and 1");
  const double x = solve_rising([](double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); },
                                std::max(probability, 1 - probability));
  return probability < 0.5 ? -x : x;
}

double student_t_quantile(double probability, double degrees_of_freedom) {
  if (!(probability > 0 && probability < 1) || !(degrees_of_freedom > 0))
    throw Error(ExitCode::bug, "Student's t needs a probability between 0 and 1 and degrees of freedom");
  const double x = solve_rising([&](double t) { return student_t_probability(t, degrees_of_freedom); },
                                std::max(probability, 1 - probability));
  return probability < 0.5 ? -x : x;
}

double jackknife_variance(std::span<const double> without) {
  const auto n = static_cast<double>(without.size());
  double mean = 0;
  for (double v : without) mean += v / n;
  double squares = 0;
  for (double v : without) squares += (v - mean) * (v - mean);
  return (n - 1) / n * squares;
}

MeanAndSd mean_and_sd(std::span<const double> values) {
  MeanAndSd m;
  const auto n = static_cast<double>(values.size());
  for (double v : values) m.mean += v / n;
  for (double v : values) m.sd += (v - m.mean) * (v - m.mean);
  m.sd = values.size() > 1 ? std::sqrt(m.sd / (n - 1)) : 0;
  return m;
}

double quantile(std::vector<double> values, double probability) {
  std::sort(values.begin(), values.end());
  const double at = probability * static_cast<double>(values.size() - 1);
  const auto k = std::min(static_cast<std::size_t>(at), values.size() - 2);
  return values[k] + (at - static_cast<double>(k)) * (values[k + 1] - values[k]);
}

Eigen::MatrixXd NoiseModel::covariance(std::span<const double> s) const {
  return variance() * correlation(s, strain_scale, white_sd * white_sd / variance());
}

Eigen::MatrixXd NoiseModel::whitening(std::span<const double> s) const {
  const Eigen::LLT<Eigen::MatrixXd> factor(covariance(s));
  if (factor.info() != Eigen::Success)
    throw Error(ExitCode::bug, "the covariance of a transient cannot be factored");
  const auto n = static_cast<Eigen::Index>(s.size());
  return factor.matrixL().solve(Eigen::MatrixXd::Identity(n, n));
}

double NoiseModel::independent_samples(std::span<const double> s) const {
  const Eigen::VectorXd ones = whitening(s) * Eigen::VectorXd::Ones(static_cast<Eigen::Index>(s.size()));
  return variance() * ones.squaredNorm();
}

NoiseModel fit_noise(std::span<const CorrelatedResiduals> runs, std::size_t count) {
  std::size_t samples = 0;
  double shortest = std::numeric_limits<double>::infinity();
  double longest = 0;
  for (const CorrelatedResiduals& run : runs) {
    samples += run.s.size();
    longest = std::max(longest, run.s.back() - run.s.front());
    for (std::size_t i = 1; i < run.s.size(); ++i) shortest = std::min(shortest, run.s[i] - run.s[i - 1]);
  }
  if (samples <= count)
    throw IdentifiabilityError(
        fmt::format("{} samples of transients cannot tell {} parameters and their noise", samples, count));

  // A scale below a quarter of the spacing is white (exp(-4) = 2 %), one above the length of a run is an
  // offset.
  const std::array<double, 2> low{std::log(0.25 * shortest), 0.0};
  const std::array<double, 2> high{std::log(longest), 1.0};
  const auto objective = [&](const std::array<double, 2>& at) {
    // White noise of 1e-6 of the variance stays in, so that samples that lie close together can still be
    // factored.
    return restricted_likelihood(runs, count, std::exp(at[0]), std::clamp(at[1], 1e-6, 1.0));
  };
  std::array<double, 2> best{};
  Restricted best_value;
  constexpr int grid = 8;
  for (int i = 0; i <= grid; ++i)
    for (int k = 0; k <= grid; ++k) {
      const std::array<double, 2> at{low[0] + (high[0] - low[0]) * i / grid,
                                     low[1] + (high[1] - low[1]) * k / grid};
      const Restricted value = objective(at);
      if (value.objective < best_value.objective) best_value = value, best = at;
    }
  if (!std::isfinite(best_value.objective))
    throw IdentifiabilityError(
        "the residuals of the transients are zero or cannot tell their parameters: no noise to weigh by");
  // Compass search from the best of the grid; the steps end at 1/64 of a cell, far below the scatter of the
  // estimate.
  std::array<double, 2> step{(high[0] - low[0]) / grid, (high[1] - low[1]) / grid};
  for (int halving = 0; halving < 7;) {
    bool better = false;
    for (std::size_t axis = 0; axis < 2 && !better; ++axis)
      for (const double sign : {-1.0, 1.0}) {
        std::array<double, 2> at = best;
        at[axis] = std::clamp(at[axis] + sign * step[axis], low[axis], high[axis]);
        const Restricted value = objective(at);
        if (value.objective < best_value.objective) {
          best_value = value, best = at, better = true;
          break;
        }
      }
    if (better) continue;
    step[0] /= 2, step[1] /= 2;
    ++halving;
  }
  const double white_share = std::clamp(best[1], 1e-6, 1.0);
  return {std::sqrt(best_value.variance * (1 - white_share)), std::exp(best[0]),
          std::sqrt(best_value.variance * white_share)};
}

}  // namespace dem2sph
