#include "calibration/dilation_fit.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <utility>

#include "calibration/estimates.hpp"
#include "calibration/least_squares.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

double root(double variance) { return std::sqrt(std::max(0.0, variance)); }

// Means of consecutive samples; the model is averaged in the same way, so nothing is biased by it.
struct Bins {
  std::vector<std::size_t> first;  // of each bin; one more at the end
  explicit Bins(std::size_t samples, long most) {
    const std::size_t n = std::min(samples, static_cast<std::size_t>(most));
    for (std::size_t k = 0; k <= n; ++k) first.push_back(k * samples / n);
  }
  std::size_t size() const { return first.size() - 1; }
  template <class T>
  std::vector<T> mean(const std::vector<T>& values) const {
    std::vector<T> means;
    for (std::size_t k = 0; k < size(); ++k) {
      T sum(0.0);
      for (std::size_t i = first[k]; i < first[k + 1]; ++i) sum += values[i];
      means.push_back(sum / static_cast<double>(first[k + 1] - first[k]));
    }
    return means;
  }
};

// One start-up as the fit of s* sees it.
struct StartUp {
  const Transient* transient = nullptr;
  std::size_t condition = 0;
  std::vector<std::size_t> columns;  // ln s*, the offset of its condition, its own phi_0
  Bins bins;
  std::vector<double> s, phi;  // binned
};

// The steady law at the samples of a transient, and at the mean I of the step that leads to each.
struct Equilibrium {
  std::vector<double> at, step;
};
Equilibrium equilibrium_of(const Transient& t, const SteadySolidFraction& law) {
  Equilibrium e;
  for (std::size_t i = 0; i < t.s.size(); ++i) {
    e.at.push_back(law(t.I[i]));
    e.step.push_back(law(i == 0 ? t.I[0] : 0.5 * (t.I[i] + t.I[i - 1])));
  }
  return e;
}

// For a given s* the model phi = base(s) + offset u(s) + phi_0 w(s) is linear in the offset of each condition
// and in the phi_0 of each run, so these are solved for exactly and s* alone is searched (variable
// projection, Golub and Pereyra 1973, with Kaufman's Jacobian): a hundred transients cost no more than a line
// fit each.
class DilationProblem {
 public:
  DilationProblem(const std::vector<SelectedTransient>& selected, std::size_t conditions,
                  const FitOptions& options)
      : options_(options), conditions_(conditions) {
    for (const SelectedTransient& t : selected) {
      const Bins bins(t.transient->s.size(), options.bins);
      runs_.push_back({t.transient,
                       t.condition,
                       {0, 1 + t.condition, 1 + conditions + runs_.size()},
                       bins,
                       bins.mean(t.transient->s),
                       bins.mean(t.transient->phi)});
    }
  }

  const std::vector<StartUp>& runs() const { return runs_; }
  /// ln s*, one offset a condition, one phi_0 a run: that is also the order of the values below.
  std::size_t parameters() const { return 1 + conditions_ + runs_.size(); }

  static constexpr std::size_t none = static_cast<std::size_t>(-1);

  /// The problem in ln s* alone, one block a condition. `weights` empty: every bin counts the same.
  LeastSquaresProblem problem(const SteadySolidFraction& law, const std::vector<Eigen::MatrixXd>& weights,
                              double log_s_star, std::size_t left_out = none) const {
    LeastSquaresProblem p;
    p.name = "dilation";
    p.parameters.push_back(
        {"s_star", log_s_star, std::log(options_.s_star_min), std::log(options_.s_star_max)});
    for (std::size_t c = 0; c < conditions_; ++c) {
      auto part = std::make_shared<Part>(part_of(c, law, weights, left_out));
      if (part->runs.empty()) continue;
      ResidualBlock block;
      block.parameters = {0};
      block.size = static_cast<std::size_t>(part->rows);
      block.evaluate = [part](std::span<const double> values, std::span<double> residuals,
                              std::span<double> jacobian) {
        const Projected projected = part->project(values[0], !jacobian.empty());
        std::copy(projected.residuals.begin(), projected.residuals.end(), residuals.begin());
        if (!jacobian.empty())
          std::copy(projected.jacobian.begin(), projected.jacobian.end(), jacobian.begin());
        return projected.residuals.allFinite();
      };
      p.blocks.push_back(std::move(block));
    }
    return p;
  }

  /// All values for a given s*.
  std::vector<double> values(const SteadySolidFraction& law, const std::vector<Eigen::MatrixXd>& weights,
                             double log_s_star) const {
    std::vector<double> all(parameters(), 0.0);
    all[0] = log_s_star;
    for (std::size_t c = 0; c < conditions_; ++c) {
      const Part part = part_of(c, law, weights, none);
      const Projected projected = part.project(log_s_star, false);
      all[1 + c] = projected.linear(0);
      for (std::size_t k = 0; k < part.runs.size(); ++k)
        all[part.runs[k]->columns[2]] = projected.linear(static_cast<Eigen::Index>(k) + 1);
    }
    return all;
  }

  /// Starts over the range of s*.
  std::vector<std::vector<double>> starts() const {
    std::vector<std::vector<double>> list;
    const double low = std::log(options_.s_star_min);
    const double high = std::log(options_.s_star_max);
    for (long i = 1; i < options_.starts; ++i)
      list.push_back(
          {low + (high - low) * (static_cast<double>(i) - 0.5) / static_cast<double>(options_.starts - 1)});
    return list;
  }
  double start() const {
    return std::clamp(std::log(0.4), std::log(options_.s_star_min), std::log(options_.s_star_max));
  }

  /// Residuals of phi itself and their derivatives by all values, for the noise.
  std::vector<CorrelatedResiduals> residuals(const SteadySolidFraction& law,
                                             const std::vector<double>& values) const {
    std::vector<CorrelatedResiduals> list;
    for (const StartUp& run : runs_) {
      const Equilibrium equilibrium = equilibrium_of(*run.transient, law);
      const Binned model(run, equilibrium, values[run.columns[0]], values[run.columns[1]],
                         values[run.columns[2]]);
      CorrelatedResiduals out;
      out.s = run.s;
      out.parameters = run.columns;
      out.residuals = model.misfit;
      out.jacobian = -model.by;
      list.push_back(std::move(out));
    }
    return list;
  }

  /// Of all values, from the whitened Jacobian.
  Matrix covariance(const SteadySolidFraction& law, const std::vector<Eigen::MatrixXd>& weights,
                    const std::vector<double>& values, bool s_star_held) const {
    const auto p = static_cast<Eigen::Index>(parameters());
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(p, p);
    const std::vector<CorrelatedResiduals> all = residuals(law, values);
    for (std::size_t r = 0; r < all.size(); ++r) {
      const Eigen::MatrixXd j = weights[r] * all[r].jacobian;
      const Eigen::MatrixXd jj = j.transpose() * j;
      for (Eigen::Index a = 0; a < 3; ++a)
        for (Eigen::Index b = 0; b < 3; ++b)
          normal(static_cast<Eigen::Index>(runs_[r].columns[static_cast<std::size_t>(a)]),
                 static_cast<Eigen::Index>(runs_[r].columns[static_cast<std::size_t>(b)])) += jj(a, b);
    }
    if (s_star_held) {
      normal.row(0).setZero(), normal.col(0).setZero();
      normal(0, 0) = 1;
    }
    const Eigen::LDLT<Eigen::MatrixXd> factor(normal);
    if (factor.info() != Eigen::Success || !(factor.vectorD().minCoeff() > 0))
      throw IdentifiabilityError(
          "dilation: the transients leave a combination of s*, offsets and phi_0 open");
    const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(p, p));
    Matrix out(parameters(), std::vector<double>(parameters()));
    for (Eigen::Index a = 0; a < p; ++a)
      for (Eigen::Index b = 0; b < p; ++b)
        out[static_cast<std::size_t>(a)][static_cast<std::size_t>(b)] =
            s_star_held && (a == 0 || b == 0) ? 0 : 0.5 * (inverse(a, b) + inverse(b, a));
    return out;
  }

  std::vector<Eigen::MatrixXd> whitening(const NoiseModel& noise) const {
    std::vector<Eigen::MatrixXd> list;
    for (const StartUp& run : runs_) {
      if (!list.empty() && run.s == runs_[list.size() - 1].s)
        list.push_back(list.back());
      else
        list.push_back(noise.whitening(run.s));
    }
    return list;
  }

 private:
  /// phi of the model and its derivatives by ln s*, offset and phi_0, averaged over the bins of one run.
  struct Binned {
    Eigen::VectorXd misfit;  ///< data less model
    Eigen::MatrixXd by;      ///< of the model
    Binned(const StartUp& run, const Equilibrium& equilibrium, double log_s_star, double offset,
           double phi_0) {
      const TransientSolution solution =
          relax_phi(run.transient->s, equilibrium.at, equilibrium.step, log_s_star, offset, phi_0);
      const auto n = static_cast<Eigen::Index>(run.s.size());
      misfit.resize(n);
      by = Eigen::MatrixXd::Zero(n, 3);
      for (Eigen::Index k = 0; k < n; ++k) {
        const std::size_t from = run.bins.first[static_cast<std::size_t>(k)];
        const std::size_t to = run.bins.first[static_cast<std::size_t>(k) + 1];
        double phi = 0;
        for (std::size_t i = from; i < to; ++i) {
          phi += solution.phi[i];
          for (Eigen::Index c = 0; c < 3; ++c)
            by(k, c) += solution.phi_by_coordinate[i][static_cast<std::size_t>(c)];
        }
        const auto count = static_cast<double>(to - from);
        by.row(k) /= count;
        misfit(k) = run.phi[static_cast<std::size_t>(k)] - phi / count;
      }
    }
  };

  struct Projected {
    Eigen::VectorXd residuals, jacobian, linear;
  };

  /// The runs of one condition, for a given steady law and weights.
  struct Part {
    std::vector<const StartUp*> runs;
    std::vector<Equilibrium> equilibrium;
    std::vector<Eigen::MatrixXd> whiten;  ///< empty: none
    Eigen::Index rows = 0;

    Projected project(double log_s_star, bool with_jacobian) const {
      const auto columns = static_cast<Eigen::Index>(runs.size()) + 1;
      Eigen::VectorXd y(rows);
      Eigen::MatrixXd x = Eigen::MatrixXd::Zero(rows, columns);
      const auto each = [&](auto&& visit) {
        Eigen::Index at = 0;
        for (std::size_t k = 0; k < runs.size(); ++k) {
          const auto n = static_cast<Eigen::Index>(runs[k]->s.size());
          visit(k, at, n);
          at += n;
        }
      };
      const auto whitened = [&](std::size_t k, const Eigen::MatrixXd& m) -> Eigen::MatrixXd {
        return whiten.empty() ? m : Eigen::MatrixXd(whiten[k] * m);
      };
      each([&](std::size_t k, Eigen::Index at, Eigen::Index n) {
        const Binned base(*runs[k], equilibrium[k], log_s_star, 0, 0);
        y.segment(at, n) = whitened(k, base.misfit);
        const Eigen::MatrixXd by = whitened(k, base.by.rightCols(2));
        x.col(0).segment(at, n) = by.col(0);
        x.col(static_cast<Eigen::Index>(k) + 1).segment(at, n) = by.col(1);
      });
      const Eigen::HouseholderQR<Eigen::MatrixXd> factor(x);
      Projected out;
      out.linear = factor.solve(y);
      out.residuals = y - x * out.linear;
      if (!with_jacobian) return out;
      Eigen::VectorXd z(rows);
      each([&](std::size_t k, Eigen::Index at, Eigen::Index n) {
        const Binned full(*runs[k], equilibrium[k], log_s_star, out.linear(0),
                          out.linear(static_cast<Eigen::Index>(k) + 1));
        z.segment(at, n) = whitened(k, full.by.col(0));
      });
      out.jacobian = x * factor.solve(z) - z;
      return out;
    }
  };

  Part part_of(std::size_t condition, const SteadySolidFraction& law,
               const std::vector<Eigen::MatrixXd>& weights, std::size_t left_out) const {
    Part part;
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      if (runs_[r].condition != condition || r == left_out) continue;
      part.runs.push_back(&runs_[r]);
      part.equilibrium.push_back(equilibrium_of(*runs_[r].transient, law));
      if (!weights.empty()) part.whiten.push_back(weights[r]);
      part.rows += static_cast<Eigen::Index>(runs_[r].s.size());
    }
    return part;
  }

  FitOptions options_;
  std::size_t conditions_;
  std::vector<StartUp> runs_;
};

// Sum over runs of how many independent samples each has, less the parameters: for Student's t.
double effective_dof(const NoiseModel& noise, const std::vector<StartUp>& runs, std::size_t parameters) {
  double count = 0;
  for (const StartUp& run : runs) count += noise.independent_samples(run.s);
  return std::max(1.0, count - static_cast<double>(parameters));
}

// phi and beta of one start-up for given parameters of the dilation fit, on the samples of the observables.
struct Evolution {
  std::vector<double> phi, beta;
};
Evolution evolution(const StartUp& run, const SteadySolidFraction& law, const std::vector<double>& values) {
  const Equilibrium equilibrium = equilibrium_of(*run.transient, law);
  TransientSolution solution =
      relax_phi(run.transient->s, equilibrium.at, equilibrium.step, values[run.columns[0]],
                values[run.columns[1]], values[run.columns[2]]);
  return {std::move(solution.phi), std::move(solution.beta)};
}

double jackknife_variance(const std::vector<double>& without) {
  const auto n = static_cast<double>(without.size());
  double mean = 0;
  for (double v : without) mean += v / n;
  double squares = 0;
  for (double v : without) squares += (v - mean) * (v - mean);
  return (n - 1) / n * squares;
}

// Linear regression of mu - mu_steady(I) on the fitted beta with correlated noise, one constant a condition.
class MuOnBeta {
 public:
  MuOnBeta(const Fit& fit, const DilationProblem& dilation)
      : law_(fit.solid_fraction_law()), bins_(fit.options.bins) {
    std::map<std::size_t, std::size_t> columns;  // of the conditions that have a run which is long enough
    for (std::size_t r = 0; r < fit.transients.size(); ++r) {
      const TransientFit& t = fit.transients[r];
      const auto skipped = static_cast<std::size_t>(
          std::lower_bound(t.s.begin(), t.s.end(), fit.options.mu_from_strain) - t.s.begin());
      if (t.s.size() - skipped < 10) continue;
      const StartUp& start_up = dilation.runs()[r];
      Part part{&start_up, skipped, {}, {}};
      part.data.s = binned(part, t.s);
      const std::vector<double> y = binned(part, t.mu_excess);
      part.data.residuals = Eigen::Map<const Eigen::VectorXd>(y.data(), static_cast<Eigen::Index>(y.size()));
      part.data.jacobian = Eigen::MatrixXd::Ones(static_cast<Eigen::Index>(y.size()), 2);
      part.data.parameters = {0, columns.try_emplace(start_up.condition, columns.size() + 1).first->second};
      parts_.push_back(std::move(part));
    }
    count_ = columns.size() + 1;
  }

  std::size_t runs() const { return parts_.size(); }

  // The noise of mu about the regression, for the fitted parameters `values` of the dilation.
  NoiseModel find_noise(const std::vector<double>& values) {
    std::vector<CorrelatedResiduals> data;
    for (Part& part : parts_) {
      set_beta(part, values);
      data.push_back(part.data);
    }
    const NoiseModel noise = fit_noise(data, count_);
    for (Part& part : parts_) {
      part.whiten = noise.whitening(part.data.s);
      independent_ += noise.independent_samples(part.data.s);
    }
    return noise;
  }

  double degrees_of_freedom() const { return std::max(1.0, independent_ - static_cast<double>(count_)); }

  struct Share {
    double value = 0, variance = 0;
  };
  Share solve(const std::vector<double>& values, std::size_t left_out = DilationProblem::none) {
    const auto p = static_cast<Eigen::Index>(count_);
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(p, p);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(p);
    for (std::size_t r = 0; r < parts_.size(); ++r) {
      if (r == left_out) continue;
      Part& part = parts_[r];
      set_beta(part, values);
      const Eigen::MatrixXd j = part.whiten * part.data.jacobian;
      const Eigen::VectorXd y = part.whiten * part.data.residuals;
      for (Eigen::Index a = 0; a < 2; ++a) {
        const auto row = static_cast<Eigen::Index>(part.data.parameters[static_cast<std::size_t>(a)]);
        right(row) += j.col(a).dot(y);
        for (Eigen::Index b = 0; b < 2; ++b)
          normal(row, static_cast<Eigen::Index>(part.data.parameters[static_cast<std::size_t>(b)])) +=
              j.col(a).dot(j.col(b));
      }
    }
    for (Eigen::Index c = 1; c < p; ++c)
      if (normal(c, c) == 0) normal(c, c) = 1;  // the constant of a condition whose only run is left out
    const Eigen::LDLT<Eigen::MatrixXd> factor(normal);
    return {factor.solve(right)(0), factor.solve(Eigen::VectorXd::Unit(p, 0))(0)};
  }

 private:
  struct Part {
    const StartUp* start_up;
    std::size_t skipped;
    CorrelatedResiduals data;
    Eigen::MatrixXd whiten;
  };
  std::vector<double> binned(const Part& part, const std::vector<double>& samples) const {
    const std::vector<double> rest(samples.begin() + static_cast<std::ptrdiff_t>(part.skipped),
                                   samples.end());
    return Bins(rest.size(), bins_).mean(rest);
  }
  void set_beta(Part& part, const std::vector<double>& values) const {
    const std::vector<double> beta = binned(part, evolution(*part.start_up, law_, values).beta);
    part.data.jacobian.col(0) =
        Eigen::Map<const Eigen::VectorXd>(beta.data(), static_cast<Eigen::Index>(beta.size()));
  }

  SteadySolidFraction law_;
  long bins_;
  std::vector<Part> parts_;
  std::size_t count_ = 0;
  double independent_ = 0;
};

// `values` and `covariance` are those of the dilation fit.
void regress_mu_on_beta(Fit& fit, const DilationProblem& dilation, const std::vector<double>& values,
                        const Matrix& covariance) {
  MuOnBeta regression(fit, dilation);
  if (regression.runs() == 0) return;
  fit.mu_noise = regression.find_noise(values);
  auto [share, variance] = regression.solve(values);
  if (regression.runs() >= 3) {
    std::vector<double> without;
    for (std::size_t r = 0; r < regression.runs(); ++r) without.push_back(regression.solve(values, r).value);
    variance = std::max(variance, jackknife_variance(without));
  }
  // The fitted beta has errors of its own: by the delta method, central differences over one standard error.
  Matrix to(1, std::vector<double>(values.size(), 0.0));
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double step = root(covariance[k][k]);
    if (!(step > 0)) continue;
    std::vector<double> up = values;
    std::vector<double> down = values;
    up[k] += step;
    down[k] -= step;
    to[0][k] = (regression.solve(up).value - regression.solve(down).value) / (2 * step);
  }
  variance += propagate(to, covariance)[0][0];
  if (!std::isfinite(share) || !(variance > 0)) return;
  fit.beta_in_mu = symmetric_estimate("beta_in_mu", share, variance,
                                      student_t_quantile(0.975, regression.degrees_of_freedom()));
}

}  // namespace

std::vector<double> fit_dilation(Fit& fit, const SelectedData& selected, const SteadyModel& model,
                                 const std::vector<double>& coordinates,
                                 const Matrix& coordinate_covariance) {
  const FitOptions& options = fit.options;
  const SteadySolidFraction law = fit.solid_fraction_law();
  const DilationProblem dilation(selected.transients, selected.conditions, options);
  const std::vector<std::vector<double>> starts = dilation.starts();
  LeastSquaresResult result = solve_least_squares(dilation.problem(law, {}, dilation.start()), starts);
  std::vector<Eigen::MatrixXd> weights;
  int reweighted = 0;
  for (bool settled = false; !settled; ++reweighted) {
    if (reweighted == 20)
      throw IdentifiabilityError(
          "dilation: the noise of the transients and the fit do not settle; add start-ups");
    const std::vector<double> values = dilation.values(law, weights, result.values[0]);
    fit.phi_noise = fit_noise(dilation.residuals(law, values), dilation.parameters());
    weights = dilation.whitening(fit.phi_noise);
    const double before = result.values[0];
    result = solve_least_squares(dilation.problem(law, weights, before));
    // A tenth of the error: the noise itself is known no better than to some 10 %.
    settled = std::abs(result.values[0] - before) <= 0.1 * root(result.covariance[0][0]);
  }
  result = solve_least_squares(dilation.problem(law, weights, result.values[0]), starts);
  result.degrees_of_freedom -= static_cast<long>(dilation.parameters()) - 1;
  if (result.degrees_of_freedom <= 0)
    throw IdentifiabilityError("dilation: as many offsets and initial solid fractions as data; add samples");
  const std::vector<double> best = dilation.values(law, weights, result.values[0]);
  const Matrix covariance = dilation.covariance(law, weights, best, result.at_bound[0]);
  const double s_star = std::exp(best[0]);

  // How far the steady law, which is held, moves s*: central differences over one standard error of each of
  // its coordinates.
  std::vector<double> by_coordinate(coordinates.size(), 0.0);
  for (std::size_t k = 0; k < coordinates.size() && !result.at_bound[0]; ++k) {
    const double step = root(coordinate_covariance[k][k]);
    if (!(step > 0)) continue;
    std::array<double, 2> moved{};
    for (int side = 0; side < 2; ++side) {
      std::vector<double> x = coordinates;
      x[k] += side == 0 ? -step : step;
      const SteadySolidFraction other = solid_fraction_at(model, x);
      moved[static_cast<std::size_t>(side)] =
          solve_least_squares(dilation.problem(other, weights, best[0])).values[0];
    }
    by_coordinate[k] = (moved[1] - moved[0]) / (2 * step);
  }

  double variance = covariance[0][0];
  fit.s_star_error_least_squares = s_star * root(variance);
  const std::size_t runs = dilation.runs().size();
  if (runs >= 3 && !result.at_bound[0]) {
    std::vector<double> without;
    for (std::size_t r = 0; r < runs; ++r)
      without.push_back(solve_least_squares(dilation.problem(law, weights, best[0], r)).values[0]);
    const double jackknife = jackknife_variance(without);
    fit.s_star_error_jackknife = s_star * root(jackknife);
    variance = std::max(variance, jackknife);
  }
  variance += propagate({by_coordinate}, coordinate_covariance)[0][0];

  LawFit& out = fit.dilation;
  out.member = "phi_relaxes";
  out.search = {result.starts,      result.converged,       result.agreed, result.iterations,
                result.termination, result.singular_values, reweighted};
  out.chi2 = result.chi2;
  out.degrees_of_freedom = static_cast<double>(result.degrees_of_freedom);
  out.chi2_per_dof = result.degrees_of_freedom > 0 ? result.chi2 / out.degrees_of_freedom : 0;
  out.interval_factor =
      student_t_quantile(0.975, effective_dof(fit.phi_noise, dilation.runs(), dilation.parameters()));
  out.covariance = {{s_star * s_star * variance}};
  if (result.at_bound[0]) out.covariance = {{0.0}};
  out.parameters = {
      positive_estimate("s_star", s_star, out.covariance[0][0], out.interval_factor, result.at_bound[0])};

  double products = 0;
  double squares = 0;
  // The residuals stand condition by condition.
  std::vector<std::size_t> row_of(runs);
  for (std::size_t condition = 0, next = 0; condition < selected.conditions; ++condition)
    for (std::size_t r = 0; r < runs; ++r)
      if (dilation.runs()[r].condition == condition) {
        row_of[r] = next;
        next += dilation.runs()[r].s.size();
      }
  for (std::size_t r = 0; r < runs; ++r) {
    std::size_t row = row_of[r];
    const StartUp& run = dilation.runs()[r];
    const Transient& t = *run.transient;
    for (std::size_t i = 0; i < run.s.size(); ++i, ++row) {
      squares += result.residuals[row] * result.residuals[row];
      if (i > 0) products += result.residuals[row] * result.residuals[row - 1];
    }
    TransientFit seen;
    seen.run = t.run;
    seen.kind = t.kind;
    seen.seed = t.seed;
    seen.I_driven = t.I_driven;
    seen.phi_offset = best[run.columns[1]];
    seen.phi_0 = symmetric_estimate("phi_0", best[run.columns[2]], covariance[run.columns[2]][run.columns[2]],
                                    out.interval_factor);
    seen.s = t.s;
    seen.phi = t.phi;
    seen.beta = t.beta;
    Evolution fitted = evolution(run, law, best);
    seen.phi_fit = std::move(fitted.phi);
    seen.beta_fit = std::move(fitted.beta);
    double mean = 0;
    for (double phi : t.phi) mean += phi / static_cast<double>(t.phi.size());
    double about_mean = 0;
    double about_fit = 0;
    for (std::size_t i = 0; i < t.s.size(); ++i) {
      seen.mu_excess.push_back(t.mu[i] - fit.steady_friction_at(t.I[i]));
      about_mean += (t.phi[i] - mean) * (t.phi[i] - mean);
      about_fit += (t.phi[i] - seen.phi_fit[i]) * (t.phi[i] - seen.phi_fit[i]);
    }
    seen.explained = about_mean > 0 ? 1 - about_fit / about_mean : 0;
    fit.transients.push_back(std::move(seen));
  }
  fit.whitened_autocorrelation = products / squares;
  regress_mu_on_beta(fit, dilation, best, covariance);
  return by_coordinate;
}

}  // namespace dem2sph
