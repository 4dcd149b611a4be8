#include "calibration/dilation_fit.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
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

// phi_eq of a transient that lies farther off the steady law than this belongs to another material.
constexpr double largest_offset = 0.1;

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

class DilationProblem {
 public:
  DilationProblem(const std::vector<SelectedTransient>& selected, std::size_t conditions,
                  const SteadySolidFraction& law, const FitOptions& options)
      : law_(law), options_(options), conditions_(conditions) {
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
  std::size_t parameters() const { return 1 + conditions_ + runs_.size(); }

  // `weights` empty: every bin counts the same. `left_out` is a run that is not used; its phi_0 is then
  // fixed, as is the offset of a condition that nobody else has.
  LeastSquaresProblem problem(const SteadySolidFraction& law, const std::vector<Eigen::MatrixXd>& weights,
                              const std::vector<double>& start, std::size_t left_out = none) const {
    LeastSquaresProblem p;
    p.name = "dilation";
    p.parameters.push_back({"s_star", 0, std::log(options_.s_star_min), std::log(options_.s_star_max)});
    for (std::size_t c = 0; c < conditions_; ++c) {
      const bool unused = std::none_of(runs_.begin(), runs_.end(), [&](const StartUp& run) {
        return run.condition == c && &run != (left_out == none ? nullptr : &runs_[left_out]);
      });
      p.parameters.push_back(
          {fmt::format("offset of condition {}", c), 0, -largest_offset, largest_offset, unused});
    }
    for (std::size_t r = 0; r < runs_.size(); ++r)
      p.parameters.push_back(
          {fmt::format("phi_0 of {}", runs_[r].transient->run), 0, 0.2, 0.9, r == left_out});
    for (std::size_t k = 0; k < p.parameters.size(); ++k) p.parameters[k].start = start[k];
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      if (r == left_out) continue;
      const StartUp& run = runs_[r];
      ResidualBlock block;
      block.parameters = run.columns;
      block.size = run.s.size();
      const Eigen::MatrixXd* whiten = weights.empty() ? nullptr : &weights[r];
      block.evaluate = [&run, equilibrium = equilibrium_of(*run.transient, law), whiten](
                           std::span<const double> values, std::span<double> residuals,
                           std::span<double> jacobian) {
        const TransientSolution model =
            relax_phi(run.transient->s, equilibrium.at, equilibrium.step, values[0], values[1], values[2]);
        const auto n = static_cast<Eigen::Index>(run.s.size());
        Eigen::VectorXd misfit(n);
        Eigen::MatrixXd j(n, 3);
        const std::vector<double> phi = run.bins.mean(model.phi);
        for (Eigen::Index c = 0; c < 3; ++c) {
          std::vector<double> column;
          for (const std::vector<double>& row : model.phi_by_coordinate)
            column.push_back(row[static_cast<std::size_t>(c)]);
          const std::vector<double> binned = run.bins.mean(column);
          for (Eigen::Index i = 0; i < n; ++i) j(i, c) = -binned[static_cast<std::size_t>(i)];
        }
        for (Eigen::Index i = 0; i < n; ++i)
          misfit(i) = run.phi[static_cast<std::size_t>(i)] - phi[static_cast<std::size_t>(i)];
        if (whiten != nullptr) misfit = *whiten * misfit;
        if (whiten != nullptr && !jacobian.empty()) j = *whiten * j;
        for (Eigen::Index i = 0; i < n; ++i) {
          residuals[static_cast<std::size_t>(i)] = misfit(i);
          for (Eigen::Index c = 0; c < 3 && !jacobian.empty(); ++c)
            jacobian[static_cast<std::size_t>(3 * i + c)] = j(i, c);
        }
        return misfit.allFinite();
      };
      p.blocks.push_back(std::move(block));
    }
    return p;
  }

  std::vector<double> start() const {
    std::vector<double> values(parameters(), 0.0);
    values[0] = std::clamp(std::log(0.4), std::log(options_.s_star_min), std::log(options_.s_star_max));
    std::vector<double> count(conditions_, 0.0);
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      const StartUp& run = runs_[r];
      values[1 + conditions_ + r] = std::clamp(run.transient->phi_0, 0.2, 0.9);
      // The last quarter of a start-up is nearly steady.
      const std::size_t n = run.transient->s.size();
      double offset = 0;
      for (std::size_t i = 3 * n / 4; i < n; ++i)
        offset += (run.transient->phi[i] - law_(run.transient->I[i])) / static_cast<double>(n - 3 * n / 4);
      values[1 + run.condition] += offset;
      count[run.condition] += 1;
    }
    for (std::size_t c = 0; c < conditions_; ++c)
      values[1 + c] = std::clamp(values[1 + c] / count[c], -largest_offset, largest_offset);
    return values;
  }

  // Starts that differ in s* alone: for a given s* the model is linear in all the others.
  std::vector<std::vector<double>> starts() const {
    std::vector<std::vector<double>> list;
    const double low = std::log(options_.s_star_min);
    const double high = std::log(options_.s_star_max);
    for (long i = 1; i < options_.starts; ++i) {
      list.push_back(start());
      list.back()[0] =
          low + (high - low) * (static_cast<double>(i) - 0.5) / static_cast<double>(options_.starts - 1);
    }
    return list;
  }

  // Residuals of phi itself and their derivatives, for the noise.
  std::vector<CorrelatedResiduals> residuals(const std::vector<double>& values) const {
    const LeastSquaresProblem plain = problem(law_, {}, values);
    std::vector<CorrelatedResiduals> list;
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      const std::size_t n = runs_[r].s.size();
      std::vector<double> at, residual(n), jacobian(3 * n);
      for (std::size_t c : runs_[r].columns) at.push_back(values[c]);
      if (!plain.blocks[r].evaluate(at, residual, jacobian))
        throw NumericalError(
            fmt::format("transient {}: the model has no value at its fit", runs_[r].transient->run));
      CorrelatedResiduals run;
      run.s = runs_[r].s;
      run.parameters = runs_[r].columns;
      run.residuals = Eigen::Map<Eigen::VectorXd>(residual.data(), static_cast<Eigen::Index>(n));
      run.jacobian = Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>(
          jacobian.data(), static_cast<Eigen::Index>(n), 3);
      list.push_back(std::move(run));
    }
    return list;
  }

  std::vector<Eigen::MatrixXd> whitening(const NoiseModel& noise) const {
    std::vector<Eigen::MatrixXd> list;
    for (const StartUp& run : runs_) list.push_back(noise.whitening(run.s));
    return list;
  }

  static constexpr std::size_t none = static_cast<std::size_t>(-1);

 private:
  SteadySolidFraction law_;
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
  const DilationProblem dilation(selected.transients, selected.conditions, law, options);
  const std::vector<std::vector<double>> starts = dilation.starts();
  LeastSquaresResult result = solve_least_squares(dilation.problem(law, {}, dilation.start()), starts);
  std::vector<Eigen::MatrixXd> weights;
  int reweighted = 0;
  for (bool settled = false; !settled; ++reweighted) {
    if (reweighted == 20)
      throw IdentifiabilityError(
          "dilation: the noise of the transients and the fit do not settle; add start-ups");
    fit.phi_noise = fit_noise(dilation.residuals(result.values), dilation.parameters());
    weights = dilation.whitening(fit.phi_noise);
    const double before = result.values[0];
    result = solve_least_squares(dilation.problem(law, weights, result.values));
    // A tenth of the error: the noise itself is known no better than to some 10 %.
    settled = std::abs(result.values[0] - before) <= 0.1 * root(result.covariance[0][0]);
  }
  result = solve_least_squares(dilation.problem(law, weights, result.values), starts);
  const std::vector<double> best = result.values;
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
          solve_least_squares(dilation.problem(other, weights, best)).values[0];
    }
    by_coordinate[k] = (moved[1] - moved[0]) / (2 * step);
  }

  double variance = result.covariance[0][0];
  fit.s_star_error_least_squares = s_star * root(variance);
  const std::size_t runs = dilation.runs().size();
  if (runs >= 3 && !result.at_bound[0]) {
    std::vector<double> without;
    for (std::size_t r = 0; r < runs; ++r)
      without.push_back(solve_least_squares(dilation.problem(law, weights, best, r)).values[0]);
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
  std::size_t row = 0;
  for (std::size_t r = 0; r < runs; ++r) {
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
    seen.phi_0 =
        symmetric_estimate("phi_0", best[run.columns[2]], result.covariance[run.columns[2]][run.columns[2]],
                           out.interval_factor, result.at_bound[run.columns[2]]);
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
  regress_mu_on_beta(fit, dilation, best, result.covariance);
  return by_coordinate;
}

}  // namespace dem2sph
