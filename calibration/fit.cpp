// The fit: the only translation unit that sees Ceres. First the generic solver behind least_squares.hpp, then
// the laws, evaluated with Jets, then what is concluded from them.
#include "calibration/fit.hpp"

#include <ceres/ceres.h>
#include <ceres/jet.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <glog/logging.h>

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <random>
#include <utility>

#include "calibration/data_selection.hpp"
#include "calibration/least_squares.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

// ---------------------------------------------------------------------------------------------------------------------
// Generic solver
// ---------------------------------------------------------------------------------------------------------------------

class BlockCost final : public ceres::CostFunction {
 public:
  explicit BlockCost(const ResidualBlock& block) : block_(block), values_(block.parameters.size()) {
    set_num_residuals(static_cast<int>(block.size));
    mutable_parameter_block_sizes()->assign(block.parameters.size(), 1);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const std::size_t columns = values_.size();
    for (std::size_t k = 0; k < columns; ++k) values_[k] = parameters[k][0];
    if (jacobians != nullptr) jacobian_.resize(block_.size * columns);
    const std::span<double> residual_span(residuals, block_.size);
    if (!block_.evaluate(values_, residual_span,
                         jacobians != nullptr ? std::span<double>(jacobian_) : std::span<double>()))
      return false;
    for (std::size_t k = 0; jacobians != nullptr && k < columns; ++k) {
      if (jacobians[k] == nullptr) continue;
      for (std::size_t i = 0; i < block_.size; ++i) jacobians[k][i] = jacobian_[i * columns + k];
    }
    return true;
  }

 private:
  const ResidualBlock& block_;
  mutable std::vector<double> values_;
  mutable std::vector<double> jacobian_;
};

// One run of Ceres from `values`, which it changes.
struct Run {
  bool usable = false;
  double chi2 = 0;
  int iterations = 0;
  std::string termination;
};

class Solver {
 public:
  Solver(const LeastSquaresProblem& problem, std::vector<double> values, std::vector<bool> held)
      : problem_(problem), values_(std::move(values)), held_(std::move(held)) {
    ceres::Problem::Options ownership;
    ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ceres_ = std::make_unique<ceres::Problem>(ownership);
    for (const ResidualBlock& block : problem.blocks) {
      costs_.push_back(std::make_unique<BlockCost>(block));
      std::vector<double*> addresses;
      for (std::size_t k : block.parameters) addresses.push_back(&values_[k]);
      ceres_->AddResidualBlock(costs_.back().get(), nullptr, addresses);
    }
    for (std::size_t k = 0; k < values_.size(); ++k) {
      if (!ceres_->HasParameterBlock(&values_[k])) ceres_->AddParameterBlock(&values_[k], 1);
      const LeastSquaresParameter& p = problem.parameters[k];
      if (held_[k]) {
        ceres_->SetParameterBlockConstant(&values_[k]);
        continue;
      }
      if (std::isfinite(p.lower)) ceres_->SetParameterLowerBound(&values_[k], 0, p.lower);
      if (std::isfinite(p.upper)) ceres_->SetParameterUpperBound(&values_[k], 0, p.upper);
    }
  }

  Run solve() {
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.max_num_iterations = problem_.iterations;
    // As tight as rounding allows: what a solve costs is nothing beside what the data cost.
    options.function_tolerance = 1e-15;
    options.gradient_tolerance = 1e-14;
    options.parameter_tolerance = 1e-13;
    options.logging_type = ceres::SILENT;
    options.num_threads = 1;
    ceres::Solver::Summary summary;
    ceres::Solve(options, ceres_.get(), &summary);
    Run run;
    run.usable = summary.termination_type == ceres::CONVERGENCE && summary.IsSolutionUsable() &&
                 std::isfinite(summary.final_cost);
    run.chi2 = 2 * summary.final_cost;
    run.iterations = static_cast<int>(summary.iterations.size());
    run.termination =
        fmt::format("{}: {}", ceres::TerminationTypeToString(summary.termination_type), summary.message);
    return run;
  }

  const std::vector<double>& values() const { return values_; }

  void describe(LeastSquaresResult& result) {
    std::vector<double*> all;
    for (double& v : values_) all.push_back(&v);
    ceres::Problem::EvaluateOptions evaluate;
    evaluate.parameter_blocks = all;
    ceres::CRSMatrix sparse;
    double cost = 0;
    if (!ceres_->Evaluate(evaluate, &cost, &result.residuals, nullptr, &sparse))
      throw Error(ExitCode::bug,
                  fmt::format("{}: the model has no value at its own solution", problem_.name));
    const std::size_t n = result.residuals.size();
    const std::size_t p = values_.size();
    result.jacobian.assign(n, std::vector<double>(p, 0.0));
    for (std::size_t row = 0; row < n; ++row)
      for (int at = sparse.rows[row]; at < sparse.rows[row + 1]; ++at)
        result.jacobian[row][static_cast<std::size_t>(sparse.cols[static_cast<std::size_t>(at)])] =
            sparse.values[static_cast<std::size_t>(at)];

    std::vector<std::size_t> free;
    for (std::size_t k = 0; k < p; ++k)
      if (!held_[k]) free.push_back(k);
    result.covariance.assign(p, std::vector<double>(p, 0.0));
    result.degrees_of_freedom = static_cast<long>(n) - static_cast<long>(free.size());
    if (free.empty()) return;

    // The rank is judged here, on columns of length one, so that units do not matter. 1e-7 is the square root
    // of the 1e-14 below which the covariance (J^T J)^-1 has no digit left in double precision.
    Eigen::MatrixXd j(static_cast<Eigen::Index>(n), static_cast<Eigen::Index>(free.size()));
    for (std::size_t c = 0; c < free.size(); ++c) {
      for (std::size_t row = 0; row < n; ++row)
        j(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(c)) = result.jacobian[row][free[c]];
      const double length = j.col(static_cast<Eigen::Index>(c)).norm();
      if (!(length > 0))
        throw IdentifiabilityError(fmt::format("{}: the data do not depend on {}", problem_.name,
                                               problem_.parameters[free[c]].name));
      j.col(static_cast<Eigen::Index>(c)) /= length;
    }
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(j);
    const Eigen::VectorXd& singular = svd.singularValues();
    result.singular_values.assign(singular.data(), singular.data() + singular.size());
    if (!(result.singular_values.back() > 1e-7 * result.singular_values.front())) {
      std::vector<std::string> names;
      for (std::size_t k : free) names.push_back(problem_.parameters[k].name);
      throw IdentifiabilityError(
          fmt::format("{}: the data leave a combination of {} open (singular values of the Jacobian from "
                      "{:.3g} down to {:.3g}); "
                      "add runs at other conditions",
                      problem_.name, fmt::join(names, ", "), result.singular_values.front(),
                      result.singular_values.back()));
    }

    ceres::Covariance::Options options;
    options.algorithm_type = ceres::DENSE_SVD;
    options.null_space_rank = 0;
    options.min_reciprocal_condition_number = 1e-30;  // units differ; the rank was judged above
    ceres::Covariance covariance(options);
    std::vector<const double*> blocks;
    for (std::size_t k : free) blocks.push_back(&values_[k]);
    // GetCovarianceBlock may only be called if this is true: it would end the process otherwise.
    if (!covariance.Compute(blocks, ceres_.get()))
      throw IdentifiabilityError(fmt::format("{}: the data do not determine all parameters", problem_.name));
    for (std::size_t a : free)
      for (std::size_t b : free)
        if (!covariance.GetCovarianceBlock(&values_[a], &values_[b], &result.covariance[a][b]))
          throw Error(ExitCode::bug, fmt::format("{}: a block of the covariance is missing", problem_.name));
  }

 private:
  const LeastSquaresProblem& problem_;
  std::vector<double> values_;
  std::vector<bool> held_;
  std::vector<std::unique_ptr<BlockCost>> costs_;
  std::unique_ptr<ceres::Problem> ceres_;
};

}  // namespace

LeastSquaresResult solve_least_squares(const LeastSquaresProblem& problem,
                                       std::span<const std::vector<double>> more_starts) {
  FLAGS_minloglevel = google::GLOG_FATAL;  // what matters is in the error that is thrown
  const std::size_t p = problem.parameters.size();
  std::vector<bool> held(p);
  std::size_t free = 0;
  std::size_t residuals = 0;
  for (std::size_t k = 0; k < p; ++k) {
    held[k] = problem.parameters[k].fixed;
    if (!held[k]) ++free;
  }
  for (const ResidualBlock& block : problem.blocks) residuals += block.size;
  if (residuals < free || residuals == 0)
    throw IdentifiabilityError(fmt::format("{}: {} {} cannot tell {} parameters", problem.name, residuals,
                                           residuals == 1 ? "datum" : "data", free));

  std::vector<std::vector<double>> starts(1);
  for (const LeastSquaresParameter& parameter : problem.parameters) starts[0].push_back(parameter.start);
  starts.insert(starts.end(), more_starts.begin(), more_starts.end());

  LeastSquaresResult result;
  std::vector<double> chi2;
  double best = std::numeric_limits<double>::infinity();
  std::string why_not;
  for (const std::vector<double>& start : starts) {
    for (std::size_t k = 0; k < p; ++k) {
      const LeastSquaresParameter& parameter = problem.parameters[k];
      if (start.size() != p || !(start[k] >= parameter.lower && start[k] <= parameter.upper) ||
          !std::isfinite(start[k]))
        throw Error(ExitCode::bug,
                    fmt::format("{}: a start of {} is outside its bounds", problem.name, parameter.name));
    }
    Solver solver(problem, start, held);
    const Run run = solver.solve();
    ++result.starts;
    if (!run.usable) {
      why_not = run.termination;
      continue;
    }
    ++result.converged;
    chi2.push_back(run.chi2);
    if (run.chi2 < best) {
      best = run.chi2;
      result.values = solver.values();
      result.termination = run.termination;
      result.iterations = run.iterations;
    }
  }
  if (result.converged == 0)
    throw IdentifiabilityError(fmt::format("{}: none of {} starts converged; the last one ended with {}",
                                           problem.name, result.starts, why_not));
  // A change of chi2 by 1 is one standard error, one by 0.001 is 0.03 of it: the same minimum for all that it
  // matters.
  for (double value : chi2)
    if (value <= best + 1e-3) ++result.agreed;

  // A parameter at its bound has no error: fix it and solve the rest again, until no other one arrives at a
  // bound. Ceres projects onto the bounds, so such a value equals its bound but for rounding.
  result.at_bound.assign(p, false);
  for (bool again = true; again;) {
    again = false;
    for (std::size_t k = 0; k < p; ++k) {
      const LeastSquaresParameter& parameter = problem.parameters[k];
      if (held[k]) continue;
      for (const double bound : {parameter.lower, parameter.upper}) {
        if (!std::isfinite(bound) ||
            !(std::abs(result.values[k] - bound) <= 1e-12 * std::max(1.0, std::abs(bound))))
          continue;
        result.values[k] = bound;
        result.at_bound[k] = held[k] = again = true;
      }
    }
    if (std::all_of(held.begin(), held.end(), [](bool h) { return h; })) break;
    Solver solver(problem, result.values, held);
    const Run run = solver.solve();
    if (!run.usable)
      throw IdentifiabilityError(
          fmt::format("{}: with a parameter fixed at its bound the rest does not converge: {}", problem.name,
                      run.termination));
    result.values = solver.values();
  }
  Solver solver(problem, result.values, held);
  solver.describe(result);
  result.chi2 = 0;
  for (double r : result.residuals) result.chi2 += r * r;
  if (!std::isfinite(result.chi2))
    throw Error(ExitCode::bug, fmt::format("{}: chi2 is not finite", problem.name));
  return result;
}

namespace {

// ---------------------------------------------------------------------------------------------------------------------
// What the laws share
// ---------------------------------------------------------------------------------------------------------------------

using Matrix = std::vector<std::vector<double>>;

template <std::size_t N>
std::array<ceres::Jet<double, static_cast<int>(N)>, N> seeded(std::span<const double> values) {
  std::array<ceres::Jet<double, static_cast<int>(N)>, N> jets;
  for (std::size_t k = 0; k < N; ++k)
    jets[k] = ceres::Jet<double, static_cast<int>(N)>(values[k], static_cast<int>(k));
  return jets;
}

// One residual (value - law(I))/se from a law evaluated with Jets over its N parameters.
template <std::size_t N, class Model>
ResidualBlock steady_block(const Model& model, const SteadyDatum& datum) {
  ResidualBlock block;
  for (std::size_t k = 0; k < N; ++k) block.parameters.push_back(k);
  block.size = 1;
  block.evaluate = [&model, &datum](std::span<const double> values, std::span<double> residuals,
                                    std::span<double> jacobian) {
    const auto predicted = model(seeded<N>(values), datum.I);
    residuals[0] = (datum.value - predicted.a) / datum.effective_se;
    for (std::size_t k = 0; k < jacobian.size(); ++k)
      jacobian[k] = -predicted.v[static_cast<Eigen::Index>(k)] / datum.effective_se;
    return std::isfinite(residuals[0]);
  };
  return block;
}

// Starts that fill the box of the bounds evenly in the parameters as they are fitted. The generator is fixed
// by the standard: the same starts on every machine.
std::vector<std::vector<double>> spread_starts(const LeastSquaresProblem& problem, long count) {
  std::mt19937 generator(20061);
  std::vector<std::vector<double>> starts;
  for (long i = 1; i < count; ++i) {
    std::vector<double> start;
    for (const LeastSquaresParameter& p : problem.parameters) {
      const double u = static_cast<double>(generator()) / 4294967296.0;
      start.push_back(std::isfinite(p.lower) && std::isfinite(p.upper) ? p.lower + u * (p.upper - p.lower)
                                                                       : p.start);
    }
    starts.push_back(std::move(start));
  }
  return starts;
}

Search describe_search(const LeastSquaresResult& result, int reweighted) {
  return {result.starts,      result.converged,       result.agreed, result.iterations,
          result.termination, result.singular_values, reweighted};
}

double root(double variance) { return std::sqrt(std::max(0.0, variance)); }

// J C J^T for the change of parameters whose derivatives are the rows of `to`.
Matrix propagate(const Matrix& to, const Matrix& covariance) {
  Matrix out(to.size(), std::vector<double>(to.size(), 0.0));
  for (std::size_t a = 0; a < to.size(); ++a)
    for (std::size_t b = 0; b <= a; ++b) {
      double sum = 0;
      for (std::size_t i = 0; i < covariance.size(); ++i)
        for (std::size_t k = 0; k < covariance.size(); ++k) sum += to[a][i] * covariance[i][k] * to[b][k];
      out[a][b] = out[b][a] = sum;
    }
  return out;
}

// The 95 % interval is the wider of two: errors taken as known (normal), and errors known up to a common
// factor that the scatter about the fit tells (Student's t). README, "Intervals".
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

Estimate symmetric_estimate(std::string name, double value, double variance, double factor,
                            bool at_bound = false) {
  const double error = root(variance);
  return {std::move(name), value, error, value - factor * error, value + factor * error, at_bound};
}

// For what is positive by nature and was fitted as its logarithm.
Estimate positive_estimate(std::string name, double value, double variance, double factor,
                           bool at_bound = false) {
  const double error = root(variance);
  const double stretch = std::exp(factor * error / value);
  return {std::move(name), value, error, value / stretch, value * stretch, at_bound};
}

// Fits N parameters of a steady law with errors in I and in the value. The effective standard error depends
// on the slope of the fitted law: fit, make it anew, fit, until no parameter moves by more than a thousandth
// of its error.
template <std::size_t N, class Model, class Slope>
LeastSquaresResult fit_steady(LeastSquaresProblem problem, std::vector<SteadyDatum>& data, const Model& model,
                              const Slope& slope, const FitOptions& options, int& reweighted) {
  for (SteadyDatum& datum : data) {
    datum.effective_se = datum.value_se;
    problem.blocks.push_back(steady_block<N>(model, datum));
  }
  const std::vector<std::vector<double>> starts = spread_starts(problem, options.starts);
  LeastSquaresResult result = solve_least_squares(problem, starts);
  bool settled = false;
  for (reweighted = 0; !settled; ++reweighted) {
    if (reweighted == 50)
      throw IdentifiabilityError(fmt::format(
          "{}: the weights from the errors of I do not settle; the errors of I are too large", problem.name));
    for (SteadyDatum& datum : data)
      datum.effective_se = std::hypot(datum.value_se, slope(result.values, datum.I) * datum.I_se);
    for (std::size_t k = 0; k < N; ++k) problem.parameters[k].start = result.values[k];
    const std::vector<double> before = result.values;
    result = solve_least_squares(problem);
    settled = true;
    for (std::size_t k = 0; k < N; ++k)
      settled = settled && std::abs(result.values[k] - before[k]) <= 1e-3 * root(result.covariance[k][k]);
  }
  for (std::size_t k = 0; k < N; ++k) problem.parameters[k].start = result.values[k];
  result = solve_least_squares(problem, starts);
  for (std::size_t i = 0; i < data.size(); ++i) {
    data[i].residual = result.residuals[i];
    data[i].fitted = data[i].value - result.residuals[i] * data[i].effective_se;
  }
  return result;
}

// Different I are needed, not merely different runs.
void require_conditions(const std::vector<SteadyDatum>& data, std::size_t needed, const char* law) {
  std::vector<double> driven;
  for (const SteadyDatum& datum : data) driven.push_back(datum.I_driven);
  std::sort(driven.begin(), driven.end());
  const auto conditions =
      static_cast<std::size_t>(std::unique(driven.begin(), driven.end()) - driven.begin());
  if (conditions < needed)
    throw IdentifiabilityError(
        fmt::format("{}: {} {} at {} inertial {} cannot tell {} parameters; run at least {} driven I", law,
                    data.size(), data.size() == 1 ? "datum" : "data", conditions,
                    conditions == 1 ? "number" : "numbers", needed, needed));
}

// ---------------------------------------------------------------------------------------------------------------------
// Friction: parameters ln mu_l, ln(mu_h - mu_l), ln D*, so that mu_h > mu_l > 0 and D* > 0 hold
// ---------------------------------------------------------------------------------------------------------------------

template <class T>
RationalFriction<T> friction_of(const T& log_low, const T& log_range, const T& log_rate) {
  using std::exp;
  const T low = exp(log_low);
  return {low, low + exp(log_range), exp(log_rate)};
}

void fit_friction(Fit& fit, const FitOptions& options) {
  std::vector<SteadyDatum>& data = fit.friction_data;
  require_conditions(data, 3, "friction");
  const auto by_I = [](const SteadyDatum& a, const SteadyDatum& b) { return a.I < b.I; };
  std::sort(data.begin(), data.end(), by_I);
  const double smallest = std::max(data.front().value, 1e-3);
  const double largest = std::max(data.back().value, smallest + 0.01);

  LeastSquaresProblem problem;
  problem.name = "friction";
  const double log_max = std::log(options.mu_max);
  const auto inside = [](double x, double low, double high) { return std::clamp(x, low, high); };
  // 1e-3 and 1e-4 are far below what any grains show and merely keep the logarithms finite.
  problem.parameters = {
      {"mu_l", inside(std::log(smallest), std::log(1e-3), log_max), std::log(1e-3), log_max},
      {"mu_h - mu_l", inside(std::log(1.5 * (largest - smallest)), std::log(1e-4), log_max), std::log(1e-4),
       log_max},
      {"D_star", inside(std::log(0.3), std::log(options.D_star_min), std::log(options.D_star_max)),
       std::log(options.D_star_min), std::log(options.D_star_max)}};
  const auto model = [](const auto& p, double I) { return friction_of(p[0], p[1], p[2])(I); };
  const auto slope = [](const std::vector<double>& p, double I) {
    return friction_of(p[0], p[1], p[2]).slope(I);
  };
  int reweighted = 0;
  const LeastSquaresResult result = fit_steady<3>(problem, data, model, slope, options, reweighted);

  const RationalFriction<double> law = friction_of(result.values[0], result.values[1], result.values[2]);
  const double range = law.mu_h - law.mu_l;
  LawFit& out = fit.friction;
  out.member = "rational";
  out.search = describe_search(result, reweighted);
  out.covariance = propagate({{law.mu_l, 0, 0}, {law.mu_l, range, 0}, {0, 0, law.D_star}}, result.covariance);
  scale_errors(out, result.chi2, static_cast<double>(result.degrees_of_freedom));
  const double k = out.interval_factor;
  out.parameters = {positive_estimate("mu_l", law.mu_l, out.covariance[0][0], k, result.at_bound[0]),
                    symmetric_estimate("mu_h", law.mu_h, out.covariance[1][1], k, result.at_bound[1]),
                    positive_estimate("D_star", law.D_star, out.covariance[2][2], k, result.at_bound[2])};

  const double value = range / law.D_star;
  const Matrix to{{-1 / law.D_star, 1 / law.D_star, -value / law.D_star}};
  fit.slope = positive_estimate("slope", value, propagate(to, out.covariance)[0][0], k);
}

// ---------------------------------------------------------------------------------------------------------------------
// Solid fraction
// ---------------------------------------------------------------------------------------------------------------------

void fit_solid_fraction(Fit& fit, const FitOptions& options) {
  std::vector<SteadyDatum>& data = fit.solid_fraction_data;
  require_conditions(data, 2, "solid fraction");
  std::sort(data.begin(), data.end(), [](const SteadyDatum& a, const SteadyDatum& b) { return a.I < b.I; });
  LeastSquaresProblem problem;
  problem.name = "solid fraction";
  // From the floor of the law itself to the densest packing of spheres, pi/sqrt(18) = 0.7405.
  problem.parameters = {{"phi_c", std::clamp(data.front().value, 0.4, 0.74), 0.4, 0.74},
                        {"b", std::min(0.2, 0.5 * options.b_max), 0, options.b_max}};
  const auto model = [](const auto& p, double I) {
    return LinearSolidFraction<std::decay_t<decltype(p[0])>>{p[0], p[1]}(I);
  };
  const auto slope = [](const std::vector<double>& p, double) { return -p[1]; };
  int reweighted = 0;
  const LeastSquaresResult result = fit_steady<2>(problem, data, model, slope, options, reweighted);
  LawFit& out = fit.solid_fraction;
  out.member = "linear";
  out.search = describe_search(result, reweighted);
  out.covariance = result.covariance;
  scale_errors(out, result.chi2, static_cast<double>(result.degrees_of_freedom));
  out.parameters = {symmetric_estimate("phi_c", result.values[0], out.covariance[0][0], out.interval_factor,
                                       result.at_bound[0]),
                    symmetric_estimate("b", result.values[1], out.covariance[1][1], out.interval_factor,
                                       result.at_bound[1])};
}

// ---------------------------------------------------------------------------------------------------------------------
// Dilation: phi(s) of each start-up, integrated with the measured I(s)
// ---------------------------------------------------------------------------------------------------------------------

// phi at every sample, exact where I is constant between samples.
template <class T>
std::vector<T> integrate_phi(const Transient& t, const LinearSolidFraction<T>& law, const T& phi_0,
                             const T& s_star) {
  std::vector<T> phi;
  phi.reserve(t.s.size());
  T state = phi_0;
  for (std::size_t i = 0; i < t.s.size(); ++i) {
    const double ds = i == 0 ? t.s[0] : t.s[i] - t.s[i - 1];
    const double I = i == 0 ? t.I[0] : 0.5 * (t.I[i] + t.I[i - 1]);
    state = relax_solid_fraction(state, law(I), ds / s_star);
    phi.push_back(state);
  }
  return phi;
}

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

// phi_eq of a transient that lies farther off the steady law than this belongs to another material; with it
// phi_eq also stays above the floor of the linear law.
constexpr double largest_offset = 0.1;

class DilationProblem {
 public:
  DilationProblem(const std::vector<SelectedTransient>& selected, std::size_t conditions,
                  const LinearSolidFraction<double>& law, const FitOptions& options)
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
  LeastSquaresProblem problem(const LinearSolidFraction<double>& law,
                              const std::vector<Eigen::MatrixXd>& weights, const std::vector<double>& start,
                              std::size_t left_out = none) const {
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
      block.evaluate = [&run, law, whiten](std::span<const double> values, std::span<double> residuals,
                                           std::span<double> jacobian) {
        using Jet = ceres::Jet<double, 3>;
        const auto jets = seeded<3>(values);
        const LinearSolidFraction<Jet> moved{law.phi_c + jets[1], Jet(law.b), law.phi_min};
        const std::vector<Jet> phi =
            run.bins.mean(integrate_phi(*run.transient, moved, jets[2], Jet(exp(jets[0]))));
        const auto n = static_cast<Eigen::Index>(run.s.size());
        Eigen::VectorXd misfit(n);
        Eigen::MatrixXd j(n, 3);
        for (Eigen::Index i = 0; i < n; ++i) {
          const Jet& model = phi[static_cast<std::size_t>(i)];
          misfit(i) = run.phi[static_cast<std::size_t>(i)] - model.a;
          j.row(i) = -model.v.transpose();
        }
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
  LinearSolidFraction<double> law_;
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
Evolution evolution(const StartUp& run, LinearSolidFraction<double> law, const std::vector<double>& values) {
  const double s_star = std::exp(values[run.columns[0]]);
  law.phi_c += values[run.columns[1]];
  Evolution e;
  e.phi = integrate_phi(*run.transient, law, values[run.columns[2]], s_star);
  for (std::size_t i = 0; i < e.phi.size(); ++i)
    e.beta.push_back(dilation_rate(e.phi[i], law(run.transient->I[i]), s_star));
  return e;
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

  LinearSolidFraction<double> law_;
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

// Returns d(ln s*)/db, for the covariance with the steady law.
double fit_dilation(Fit& fit, const SelectedData& selected, const FitOptions& options) {
  const LinearSolidFraction<double> law = fit.solid_fraction_law();
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

  // How far the fixed b moves s*: central difference over one standard error of b.
  const Estimate& b = fit.solid_fraction["b"];
  double by_b = 0;
  if (b.standard_error > 0 && !result.at_bound[0]) {
    std::array<double, 2> moved{};
    for (int side = 0; side < 2; ++side) {
      LinearSolidFraction<double> other = law;
      other.b += side == 0 ? -b.standard_error : b.standard_error;
      moved[static_cast<std::size_t>(side)] =
          solve_least_squares(dilation.problem(other, weights, best)).values[0];
    }
    by_b = (moved[1] - moved[0]) / (2 * b.standard_error);
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
  variance += by_b * by_b * b.standard_error * b.standard_error;

  LawFit& out = fit.dilation;
  out.member = "phi_relaxes";
  out.search = describe_search(result, reweighted);
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
      seen.mu_excess.push_back(t.mu[i] - fit.friction_law()(t.I[i]));
      about_mean += (t.phi[i] - mean) * (t.phi[i] - mean);
      about_fit += (t.phi[i] - seen.phi_fit[i]) * (t.phi[i] - seen.phi_fit[i]);
    }
    seen.explained = about_mean > 0 ? 1 - about_fit / about_mean : 0;
    fit.transients.push_back(std::move(seen));
  }
  fit.whitened_autocorrelation = products / squares;
  regress_mu_on_beta(fit, dilation, best, result.covariance);
  return by_b;
}

// ---------------------------------------------------------------------------------------------------------------------
// What the data say and do not say
// ---------------------------------------------------------------------------------------------------------------------

std::string interval(const Estimate& e) {
  if (e.at_bound) return fmt::format("{:.4g} (held at a bound)", e.value);
  const auto digits = [&](double value) { return round_to_error(value, e.standard_error); };
  return fmt::format("{} (95 % interval {} to {})", digits(e.value), digits(e.low), digits(e.high));
}

bool open(const Estimate& e) { return e.at_bound || !(e.standard_error < 0.5 * std::abs(e.value)); }

// Runs whose own evidence says that a mean or its error is not what it seems.
void warn_of_evidence(Fit& fit) {
  const auto names = [](const std::vector<SteadyDatum>& data, auto&& doubtful) {
    std::vector<std::string> list;
    for (const SteadyDatum& d : data)
      if (doubtful(d)) list.push_back(fmt::format("{} (driven I = {:g})", d.run, d.I_driven));
    return list;
  };
  const auto rising = [](const SteadyDatum& d) { return !d.flat; };
  // Beyond three standard errors chance brings one steady run in 370.
  const auto drifting = [](const SteadyDatum& d) { return std::abs(d.phi_drift) > 3; };
  const auto about = [&](const std::vector<SteadyDatum>& data, const char* law) {
    if (const std::vector<std::string> runs = names(data, rising); !runs.empty())
      fit.warnings.push_back(
          fmt::format("{}: the standard errors of {} of {} points were still growing with the length of the "
                      "blocks and may be too small; shear these runs for longer (strain_used): {}",
                      law, runs.size(), data.size(), fmt::join(runs, ", ")));
    if (const std::vector<std::string> runs = names(data, drifting); !runs.empty())
      fit.warnings.push_back(fmt::format(
          "{}: in {} of {} points phi still drifted by more than 3 standard errors, so the flow was "
          "not steady; drop more of the start (strain_dropped): {}",
          law, runs.size(), data.size(), fmt::join(runs, ", ")));
  };
  about(fit.friction_data, "friction");
  about(fit.solid_fraction_data, "solid fraction");
}

void judge(Fit& fit) {
  const auto warn = [&](std::string text) { fit.warnings.push_back(std::move(text)); };
  std::vector<std::string> unknown;
  const Estimate& mu_l = fit.friction["mu_l"];
  const Estimate& mu_h = fit.friction["mu_h"];
  const Estimate& D_star = fit.friction["D_star"];
  const double reach = fit.I.highest / D_star.value;
  fit.mu_h_and_D_star_known = reach >= 1 && !open(D_star) && !open(mu_h);

  std::string text;
  if (fit.mu_h_and_D_star_known) {
    text = fmt::format(
        "The data reach I = {:.3g}, {:.2g} times D*, so all three of the friction law are known: mu_l = {}, "
        "mu_h = {}, D* = {}",
        fit.I.highest, reach, interval(mu_l), interval(mu_h), interval(D_star));
  } else {
    text = fmt::format(
        "The data reach only I = {:.3g}, {:.2g} times the fitted D*, so of the friction law mu_l = {} and "
        "the slope (mu_h - mu_l)/D* = {} "
        "are known, while mu_h and D* are not known apart",
        fit.I.highest, reach, interval(mu_l), interval(fit.slope));
    warn(
        fmt::format("mu_h = {:.4g} and D_star = {:.4g} may only be used together: the data determine their "
                    "slope (mu_h - mu_l)/D_star = {:.4g} +- {:.2g}; add runs at I above {:.3g}",
                    mu_h.value, D_star.value, fit.slope.value, fit.slope.standard_error,
                    std::max(D_star.value, fit.I.highest)));
    unknown.push_back("mu_h and D_star");
  }
  if (open(mu_l)) unknown.push_back("mu_l");
  text += fmt::format("; solid fraction phi_c = {}, b = {}", interval(fit.solid_fraction["phi_c"]),
                      interval(fit.solid_fraction["b"]));
  if (open(fit.solid_fraction["b"])) unknown.push_back("b");
  if (fit.dilation.member == "phi_relaxes") {
    const Estimate& s_star = fit.dilation["s_star"];
    text += fmt::format("; dilation decays over the strain s* = {} from {} start-up{}", interval(s_star),
                        fit.transients.size(), fit.transients.size() == 1 ? "" : "s");
    if (open(s_star)) unknown.push_back("s_star");
    if (fit.s.highest < 4 * s_star.value)
      warn(
          fmt::format("the start-ups end at a strain of {:.3g}, which is {:.2g} s*: shear at least 4 s* to "
                      "tell s* from the final phi",
                      fit.s.highest, fit.s.highest / s_star.value));
    if (fit.transients.size() < 3)
      warn(
          fmt::format("s_star rests on {} start-up{}: its error cannot be checked against the spread over "
                      "seeds (3 are needed)",
                      fit.transients.size(), fit.transients.size() == 1 ? "" : "s"));
    for (const TransientFit& t : fit.transients)
      if (std::abs(t.phi_offset) >
          0.005) {  // a fifth of the 0.025 by which dense and critical packings differ
        warn(fmt::format("start-up {} ends at a phi that differs by {:+.4f} from the steady law at its I",
                         t.run, t.phi_offset));
      }
  } else {
    text += "; no start-ups, so no law of dilation";
  }
  fit.verdict = text + ".";

  for (const LawFit* law : {&fit.friction, &fit.solid_fraction, &fit.dilation}) {
    for (const Estimate& e : law->parameters) {
      if (e.at_bound)
        warn(
            fmt::format("{} went to a bound (value {:.4g}); it was fixed there and the rest was fitted "
                        "again: its error is not known",
                        e.name, e.value));
      else if (open(e) && e.name != "mu_h" && e.name != "D_star")
        warn(fmt::format("{} = {:.3g} has a standard error of {:.2g}: it is not known", e.name, e.value,
                         e.standard_error));
    }
    if (law->member != "none" && 2 * law->search.agreed < law->search.starts)
      warn(fmt::format("{}: only {} of {} starts found the best solution", law->member, law->search.agreed,
                       law->search.starts));
  }
  const auto scatter = [&](const LawFit& law, const char* name, const char* advice) {
    if (law.degrees_of_freedom == 0) {
      warn(fmt::format("{}: as many parameters as data, so nothing checks the law", name));
    } else if (law.chi2_per_dof > 1) {
      // chi2/dof has the standard deviation sqrt(2/dof) if law and errors are right.
      const double sigmas = (law.chi2_per_dof - 1) / std::sqrt(2 / law.degrees_of_freedom);
      if (sigmas > 3)
        warn(
            fmt::format("{}: chi2/dof = {:.3g} ({:.2g} standard deviations too much); all its errors are "
                        "scaled by {:.2g}. {}",
                        name, law.chi2_per_dof, sigmas, law.error_scale, advice));
    }
  };
  scatter(fit.friction, "friction", "The rational law or the standard errors are not right for these data.");
  scatter(fit.solid_fraction, "solid fraction", "phi(I) is not a straight line here: lower phi_I_max.");
  warn_of_evidence(fit);
  const Estimate& share = fit.beta_in_mu;
  if (!share.name.empty() && (share.low > 1 || share.high < 1))
    warn(fmt::format(
        "the solver adds all of beta to mu (Eq. 5.7), while in the start-ups {:.2f} +- {:.2f} of it "
        "shows in mu (95 % interval {:.2f} to {:.2f}): while it dilates, a flow with this law is "
        "too {}",
        share.value, share.standard_error, share.low, share.high, share.high < 1 ? "strong" : "weak"));

  if (fit.options.strict && !unknown.empty())
    throw IdentifiabilityError(
        fmt::format("not known from these data: {}. {}", fmt::join(unknown, ", "), fit.verdict));
}

}  // namespace

Fit fit_law(const std::vector<Observables>& observables, const FitOptions& options) {
  const SelectedData selected = select_data(observables, options);
  Fit fit;
  fit.d = observables.front().d;
  fit.rho_s = observables.front().rho_s;
  fit.grain_friction = observables.front().grain_friction;
  fit.engine = observables.front().engine;
  fit.material = observables.front().material;
  fit.options = options;
  fit.excluded = selected.excluded;
  fit.friction_data = selected.friction;
  fit.solid_fraction_data = selected.solid_fraction;
  fit_friction(fit, options);
  fit_solid_fraction(fit, options);

  const auto widen = [](DataRange& range, bool& started, double value) {
    range.lowest = started ? std::min(range.lowest, value) : value;
    range.highest = started ? std::max(range.highest, value) : value;
    started = true;
  };
  bool any_I = false, any_phi = false, any_p = false;
  for (const SteadyDatum& datum : fit.friction_data) widen(fit.I, any_I, datum.I);
  for (const SteadyDatum& datum : fit.solid_fraction_data) widen(fit.phi, any_phi, datum.value);
  for (const Observables& o : observables)
    for (const SteadyPoint& point : o.steady) widen(fit.p, any_p, point.p);
  for (const SelectedTransient& t : selected.transients) {
    fit.s.highest = std::max(fit.s.highest, t.transient->s.back());
    for (double phi : t.transient->phi) widen(fit.phi, any_phi, phi);
  }

  const std::size_t steady = 5;
  fit.covariance_names = {"mu_l", "mu_h", "D_star", "phi_c", "b"};
  fit.covariance.assign(steady, std::vector<double>(steady, 0.0));
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t k = 0; k < 3; ++k) fit.covariance[i][k] = fit.friction.covariance[i][k];
  for (std::size_t i = 0; i < 2; ++i)
    for (std::size_t k = 0; k < 2; ++k) fit.covariance[3 + i][3 + k] = fit.solid_fraction.covariance[i][k];

  fit.dilation.member = "none";
  if (!selected.transients.empty()) {
    const double by_b = fit_dilation(fit, selected, options);
    const double s_star = fit.dilation["s_star"].value;
    fit.covariance_names.emplace_back("s_star");
    for (std::vector<double>& row : fit.covariance) row.push_back(0.0);
    fit.covariance.emplace_back(steady + 1, 0.0);
    fit.covariance[5][5] = fit.dilation.covariance[0][0];
    // s* sees the steady law through b alone: phi_c is absorbed by the offset of each condition.
    for (std::size_t i = 3; i < 5; ++i)
      fit.covariance[5][i] = fit.covariance[i][5] = s_star * by_b * fit.solid_fraction.covariance[1][i - 3];
  }
  judge(fit);
  return fit;
}

FrictionWithGradient friction_with_gradient(const RationalFriction<double>& law, double I) {
  const std::array<double, 3> values{law.mu_l, law.mu_h, law.D_star};
  const auto jets = seeded<3>(values);
  const auto mu = RationalFriction<ceres::Jet<double, 3>>{jets[0], jets[1], jets[2]}(I);
  return {mu.a, {mu.v[0], mu.v[1], mu.v[2]}};
}

namespace {

Prediction band(double value, double variance, double factor) {
  const double error = root(variance);
  return {value, error, value - factor * error, value + factor * error};
}

}  // namespace

Prediction predict_friction(const Fit& fit, double I) {
  const FrictionWithGradient mu = friction_with_gradient(fit.friction_law(), I);
  const Matrix to{{mu.gradient[0], mu.gradient[1], mu.gradient[2]}};
  return band(mu.value, propagate(to, fit.friction.covariance)[0][0], fit.friction.interval_factor);
}

Prediction predict_solid_fraction(const Fit& fit, double I) {
  const std::array<double, 2> values{fit.solid_fraction["phi_c"].value, fit.solid_fraction["b"].value};
  const auto jets = seeded<2>(values);
  const auto phi = LinearSolidFraction<ceres::Jet<double, 2>>{jets[0], jets[1]}(I);
  return band(phi.a, propagate({{phi.v[0], phi.v[1]}}, fit.solid_fraction.covariance)[0][0],
              fit.solid_fraction.interval_factor);
}

}  // namespace dem2sph
