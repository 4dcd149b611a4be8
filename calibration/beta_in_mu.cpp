#include "calibration/beta_in_mu.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "calibration/estimates.hpp"
#include "calibration/statistics.hpp"

namespace dem2sph {
namespace {

Eigen::Index index(std::size_t k) { return static_cast<Eigen::Index>(k); }

/// One run from the strain on from which mu is compared.
struct Part {
  std::string kind;
  std::size_t condition = 0;
  std::vector<double> s;
  Eigen::VectorXd excess, beta;
  Eigen::MatrixXd beta_by;              ///< derivatives of beta by `parameters`
  std::vector<std::size_t> parameters;  ///< of the dilation fit
};

struct Share {
  double value = 0, variance = 0, degrees_of_freedom = 0;
};

/// The share over some of the runs, whitened by `noise`.
class Regression {
 public:
  Regression(const std::vector<const Part*>& parts, const NoiseModel& noise) {
    for (const Part* part : parts) columns_.try_emplace(part->condition, columns_.size() + 1);
    for (const Part* part : parts) {
      const Eigen::MatrixXd whiten = noise.whitening(part->s);
      Run run;
      run.part = part;
      run.y = whiten * part->excess;
      run.x.resize(run.y.size(), 2);
      run.x << whiten * part->beta, whiten * Eigen::VectorXd::Ones(run.y.size());
      run.by = whiten * part->beta_by;
      run.column = index(columns_.at(part->condition));
      runs_.push_back(std::move(run));
      independent_ += noise.independent_samples(part->s);
    }
  }

  Share solve(const Matrix& covariance) const {
    const Solution all = solve_without(none);
    double variance = all.inverse(0, 0);
    if (runs_.size() >= 3) {
      std::vector<double> without;
      for (std::size_t r = 0; r < runs_.size(); ++r) without.push_back(solve_without(r).values(0));
      variance = std::max(variance, jackknife_variance(without));
    }
    // The fitted beta has errors of its own: d(share) = n . (dX^T r - X^T dX c), with n the first row of the
    // inverse.
    Matrix to(1, std::vector<double>(covariance.size(), 0.0));
    for (const Run& run : runs_) {
      const Eigen::Vector2d c(all.values(0), all.values(run.column));
      const Eigen::Vector2d n(all.inverse(0, 0), all.inverse(0, run.column));
      const Eigen::VectorXd residual = run.y - run.x * c;
      const Eigen::VectorXd lever = n(0) * residual - c(0) * (run.x * n);
      for (std::size_t k = 0; k < run.part->parameters.size(); ++k)
        to[0][run.part->parameters[k]] += lever.dot(run.by.col(index(k)));
    }
    variance += propagate(to, covariance)[0][0];
    return {all.values(0), variance, std::max(1.0, independent_ - static_cast<double>(columns_.size() + 1))};
  }

 private:
  static constexpr std::size_t none = static_cast<std::size_t>(-1);
  struct Run {
    const Part* part = nullptr;
    Eigen::VectorXd y;
    Eigen::MatrixXd x, by;  ///< x: beta, one
    Eigen::Index column = 0;
  };
  struct Solution {
    Eigen::VectorXd values;
    Eigen::MatrixXd inverse;
  };
  Solution solve_without(std::size_t left_out) const {
    const Eigen::Index p = index(columns_.size()) + 1;
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(p, p);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(p);
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      if (r == left_out) continue;
      const Run& run = runs_[r];
      const Eigen::Matrix2d square = run.x.transpose() * run.x;
      const Eigen::Vector2d xy = run.x.transpose() * run.y;
      const Eigen::Index at[] = {0, run.column};
      for (int a = 0; a < 2; ++a) {
        right(at[a]) += xy(a);
        for (int b = 0; b < 2; ++b) normal(at[a], at[b]) += square(a, b);
      }
    }
    for (Eigen::Index c = 1; c < p; ++c)
      if (normal(c, c) == 0) normal(c, c) = 1;  // the constant of a condition whose only run is left out
    const Eigen::LDLT<Eigen::MatrixXd> factor(normal);
    return {factor.solve(right), factor.solve(Eigen::MatrixXd::Identity(p, p))};
  }

  std::map<std::size_t, std::size_t> columns_;  // of the constants of the conditions
  std::vector<Run> runs_;
  double independent_ = 0;
};

NoiseModel noise_of(const std::vector<Part>& parts) {
  std::map<std::size_t, std::size_t> columns;
  std::vector<CorrelatedResiduals> data;
  for (const Part& part : parts) {
    CorrelatedResiduals one;
    one.s = part.s;
    one.residuals = part.excess;
    one.jacobian.resize(part.excess.size(), 2);
    one.jacobian << part.beta, Eigen::VectorXd::Ones(part.excess.size());
    one.parameters = {0, columns.try_emplace(part.condition, columns.size() + 1).first->second};
    data.push_back(std::move(one));
  }
  return fit_noise(data, columns.size() + 1);
}

}  // namespace

BetaInMu regress_mu_on_beta(const Fit& fit, const TransientProblem& problem,
                            const std::vector<TransientSolution>& solutions, std::size_t coordinates,
                            const Matrix& covariance) {
  std::vector<Part> parts;
  for (std::size_t r = 0; r < fit.transients.size(); ++r) {
    const TransientFit& t = fit.transients[r];
    const auto skipped = static_cast<std::size_t>(
        std::lower_bound(t.s.begin(), t.s.end(), fit.options.mu_from_strain) - t.s.begin());
    if (t.s.size() - skipped < 10) continue;
    const Bins bins(t.s.size() - skipped, fit.options.bins);
    const auto binned = [&](const std::vector<double>& samples) {
      const std::vector<double> means = bins.mean(std::span(samples).subspan(skipped));
      return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(means.data(), index(means.size())));
    };
    Part part;
    part.kind = t.kind;
    part.condition = problem.runs()[r].condition;
    part.s = bins.mean(std::span(t.s).subspan(skipped));
    part.excess = binned(t.mu_excess);
    part.beta = binned(solutions[r].beta);
    part.beta_by.resize(part.beta.size(), index(coordinates) + 2);
    for (std::size_t k = 0; k < coordinates + 2; ++k) {
      const Eigen::VectorXd column = solutions[r].beta_by.col(index(k));
      part.beta_by.col(index(k)) = binned({column.begin(), column.end()});
    }
    for (std::size_t k = 0; k < coordinates; ++k) part.parameters.push_back(k);
    part.parameters.push_back(coordinates + part.condition);
    part.parameters.push_back(coordinates + problem.conditions() + r);
    parts.push_back(std::move(part));
  }
  BetaInMu out;
  if (parts.empty()) return out;
  out.noise = noise_of(parts);
  const auto estimate = [&](const std::string& name, auto&& takes_part) -> std::optional<Estimate> {
    std::vector<const Part*> chosen;
    for (const Part& part : parts)
      if (takes_part(part)) chosen.push_back(&part);
    const Share share = Regression(chosen, out.noise).solve(covariance);
    if (!std::isfinite(share.value) || !(share.variance > 0)) return {};  // beta is 0 throughout
    return symmetric_estimate(name, share.value, share.variance,
                              student_t_quantile(0.975, share.degrees_of_freedom));
  };
  if (const auto all = estimate("beta_in_mu", [](const Part&) { return true; })) out.share = *all;
  std::set<std::string> kinds;
  for (const Part& part : parts) kinds.insert(part.kind);
  for (const std::string& kind : kinds)
    if (const auto share = estimate(kind, [&](const Part& part) { return part.kind == kind; }))
      out.by_kind.push_back(*share);
  return out;
}

}  // namespace dem2sph
