// The only translation unit that sees Ceres: the solver of least_squares.hpp, and the laws of models.hpp with
// their derivatives by Jets.
#include "calibration/least_squares.hpp"

#include <ceres/ceres.h>
#include <ceres/jet.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <glog/logging.h>

#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <future>
#include <memory>
#include <optional>
#include <stdexcept>
#include <thread>
#include <utility>

#include "calibration/models.hpp"
#include "sph/base/errors.hpp"
#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph {
namespace {

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
    options.function_tolerance = problem_.tolerance;
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

struct Searched {
  Run run;
  std::vector<double> values;
};

/// One search from each start, side by side on all cores. Which of them ran where changes nothing.
std::vector<Searched> search_from(const LeastSquaresProblem& problem,
                                  const std::vector<std::vector<double>>& starts,
                                  const std::vector<bool>& held) {
  std::vector<Searched> all(starts.size());
  std::atomic<std::size_t> next{0};
  const auto work = [&](const LeastSquaresProblem& mine) {
    for (std::size_t k = next++; k < starts.size(); k = next++) {
      Solver solver(mine, starts[k], held);
      all[k].run = solver.solve();
      all[k].values = solver.values();
    }
  };
  // A copy for each helper: the blocks may keep what they calculated last.
  std::vector<std::future<void>> helpers;
  const std::size_t threads =
      std::min(starts.size(), static_cast<std::size_t>(std::max(1u, std::thread::hardware_concurrency())));
  for (std::size_t k = 1; k < threads; ++k)
    helpers.push_back(std::async(std::launch::async, [&work, mine = problem] { work(mine); }));
  work(problem);
  for (std::future<void>& helper : helpers) helper.get();
  return all;
}

}  // namespace

Minimum minimise(const LeastSquaresProblem& problem) {
  FLAGS_minloglevel = google::GLOG_FATAL;  // a search that fails is told by `found`
  std::vector<double> start;
  std::vector<bool> held;
  for (const LeastSquaresParameter& parameter : problem.parameters) {
    start.push_back(parameter.start);
    held.push_back(parameter.fixed);
  }
  Solver solver(problem, start, held);
  const Run run = solver.solve();
  return {run.usable, solver.values(), run.chi2};
}

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

  for (const std::vector<double>& start : starts) {
    for (std::size_t k = 0; k < p; ++k) {
      const LeastSquaresParameter& parameter = problem.parameters[k];
      if (start.size() != p || !(start[k] >= parameter.lower && start[k] <= parameter.upper) ||
          !std::isfinite(start[k]))
        throw Error(ExitCode::bug,
                    fmt::format("{}: a start of {} is outside its bounds", problem.name, parameter.name));
    }
  }
  LeastSquaresResult result;
  std::vector<double> chi2;
  double best = std::numeric_limits<double>::infinity();
  std::string why_not;
  for (auto& [run, values] : search_from(problem, starts, held)) {
    ++result.starts;
    if (!run.usable) {
      why_not = run.termination;
      continue;
    }
    ++result.converged;
    chi2.push_back(run.chi2);
    if (run.chi2 < best) {
      best = run.chi2;
      result.values = std::move(values);
      result.termination = run.termination;
      result.iterations = run.iterations;
    }
  }
  if (result.converged == 0)
    throw IdentifiabilityError(fmt::format("{}: none of {} starts converged; the last one ended with {}",
                                           problem.name, result.starts, why_not));
  for (double value : chi2)
    if (value <= best + problem.agreement) ++result.agreed;

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

// ---------------------------------------------------------------------------------------------------------------------
// Members of the families, each with the map from its coordinates to its parameters
// ---------------------------------------------------------------------------------------------------------------------

namespace {

// 1e-3 of friction and 1e-4 of its range are far below what any grains show and merely keep the logarithms
// finite, as do the bounds of exponents and of the solid fraction's scale of I.
constexpr double least_friction_of_a_fit = 1e-3;
constexpr double least_range_of_a_fit = 1e-4;
constexpr double least_exponent = 0.1, largest_exponent = 4;
constexpr double least_I_phi = 0.02, largest_I_phi = 200;
// From the floor of the law itself to the densest packing of spheres, pi/sqrt(18) = 0.7405.
constexpr double least_phi_c = least_solid_fraction, largest_phi_c = 0.74;

Coordinate logarithm(const char* of, double lower, double upper) {
  return {fmt::format("ln {}", of), std::log(lower), std::log(upper)};
}

// Exponentials of all coordinates, of members that are fitted in logarithms.
template <class J, std::size_t N>
std::array<J, N> exponentials(std::array<J, N> x) {
  using std::exp;
  for (J& one : x) one = exp(one);
  return x;
}

// What the models of both kinds do with the coordinates of a member. `Jet` may have more derivatives than N.
template <class Jet, std::size_t N>
std::array<Jet, N> seeded(std::span<const double> x) {
  std::array<Jet, N> jets;
  for (std::size_t k = 0; k < N; ++k) jets[k] = Jet(x[k], static_cast<int>(k));
  return jets;
}
template <class Jet, std::size_t N>
NaturalParameters natural_parameters(const std::array<Jet, N>& jets) {
  NaturalParameters result;
  for (const Jet& p : jets) {
    result.values.push_back(p.a);
    result.by_coordinate.emplace_back(p.v.data(), p.v.data() + N);
  }
  return result;
}
template <std::size_t N>
std::vector<double> within(const std::vector<Coordinate>& bounds, const std::array<double, N>& x) {
  std::vector<double> inside;
  for (std::size_t k = 0; k < N; ++k)
    inside.push_back(
        std::clamp(std::isfinite(x[k]) ? x[k] : bounds[k].lower, bounds[k].lower, bounds[k].upper));
  return inside;
}

// A rising friction law from mu_l > 0 by a range > 0 on a scale of I.
template <template <class> class Law>
struct RangeAndScale {
  template <class T>
  using law = Law<T>;
  static constexpr std::size_t count = 3;
  template <class T>
  static std::array<T, 3> natural(const std::array<T, 3>& x) {
    using std::exp;
    const T low = exp(x[0]);
    return {low, low + exp(x[1]), exp(x[2])};
  }
  static std::vector<Coordinate> coordinates(const ModelBounds& b) {
    return {logarithm("mu_l", least_friction_of_a_fit, b.mu_max),
            logarithm("(mu_h - mu_l)", least_range_of_a_fit, b.mu_max),
            logarithm("D_star", b.D_star_min, b.D_star_max)};
  }
  static std::array<double, 3> start(double first, double last, double) {
    return {std::log(first), std::log(1.5 * (last - first)), std::log(0.3)};
  }
};

struct PowerOfFriction {
  template <class T>
  using law = PowerFriction<T>;
  static constexpr std::size_t count = 3;
  template <class T>
  static std::array<T, 3> natural(const std::array<T, 3>& x) {
    return exponentials(x);
  }
  static std::vector<Coordinate> coordinates(const ModelBounds& b) {
    return {logarithm("mu_l", least_friction_of_a_fit, b.mu_max),
            logarithm("a", least_range_of_a_fit, b.mu_max), logarithm("n", least_exponent, largest_exponent)};
  }
  static std::array<double, 3> start(double first, double last, double I_last) {
    return {std::log(first), std::log((last - first) / std::pow(I_last, 0.7)), std::log(0.7)};
  }
};

struct LineOfFriction {
  template <class T>
  using law = LinearFriction<T>;
  static constexpr std::size_t count = 2;
  template <class T>
  static std::array<T, 2> natural(const std::array<T, 2>& x) {
    return exponentials(x);
  }
  static std::vector<Coordinate> coordinates(const ModelBounds& b) {
    return {logarithm("mu_l", least_friction_of_a_fit, b.mu_max),
            logarithm("rise", least_range_of_a_fit, 100)};
  }
  static std::array<double, 2> start(double first, double last, double I_last) {
    return {std::log(first), std::log((last - first) / I_last)};
  }
};

struct BarkerAndGray {
  template <class T>
  using law = BarkerGray2017<T>;
  static constexpr std::size_t count = 5;
  template <class T>
  static std::array<T, 5> natural(const std::array<T, 5>& x) {
    using std::exp;
    const T low = exp(x[0]);
    return {low, low + exp(x[1]), exp(x[2]), exp(x[3]), exp(x[4])};
  }
  static std::vector<Coordinate> coordinates(const ModelBounds& b) {
    return {logarithm("mu_s", least_friction_of_a_fit, b.mu_max),
            logarithm("(mu_2 - mu_s)", least_range_of_a_fit, b.mu_max),
            logarithm("I_0", b.D_star_min, b.D_star_max), logarithm("mu_inf", 1e-6, b.mu_max),
            logarithm("alpha", 1e-2, 1.99)};
  }
  static std::array<double, 5> start(double first, double last, double) {
    return {std::log(first), std::log(1.2 * (last - first)), std::log(0.3), std::log(0.02), std::log(1.9)};
  }
};

struct LineOfPhi {
  template <class T>
  using law = LinearSolidFraction<T>;
  static constexpr std::size_t count = 2;
  template <class T>
  static std::array<T, 2> natural(const std::array<T, 2>& x) {
    return x;
  }
  static std::vector<Coordinate> coordinates(const ModelBounds& b) {
    return {{"phi_c", least_phi_c, largest_phi_c}, {"b", 0, b.b_max}};
  }
  static std::array<double, 2> start(double first, double, double) { return {first, 0.2}; }
};

struct PowerOfPhi {
  template <class T>
  using law = PowerSolidFraction<T>;
  static constexpr std::size_t count = 3;
  template <class T>
  static std::array<T, 3> natural(const std::array<T, 3>& x) {
    using std::exp;
    return {x[0], exp(x[1]), exp(x[2])};
  }
  static std::vector<Coordinate> coordinates(const ModelBounds& b) {
    return {{"phi_c", least_phi_c, largest_phi_c},
            logarithm("a", least_range_of_a_fit, b.b_max),
            logarithm("n", least_exponent, largest_exponent)};
  }
  static std::array<double, 3> start(double first, double last, double I_last) {
    return {first, std::log((first - last) / I_last), 0};
  }
};

struct RationalPhi {
  template <class T>
  using law = RationalSolidFraction<T>;
  static constexpr std::size_t count = 3;
  template <class T>
  static std::array<T, 3> natural(const std::array<T, 3>& x) {
    using std::exp;
    return {x[0], x[1], exp(x[2])};
  }
  static std::vector<Coordinate> coordinates(const ModelBounds& b) {
    return {{"phi_c", least_phi_c, largest_phi_c},
            {"b", 0, b.b_max},
            logarithm("I_phi", least_I_phi, largest_I_phi)};
  }
  static std::array<double, 3> start(double first, double last, double I_last) {
    return {first, 1.2 * (first - last) / I_last, std::log(4.0)};
  }
};

template <class Member>
class ModelOf final : public SteadyModel {
  static constexpr std::size_t N = Member::count;
  using Jet = ceres::Jet<double, static_cast<int>(N)>;
  using DoubleLaw = typename Member::template law<double>;
  using JetLaw = typename Member::template law<Jet>;

 public:
  explicit ModelOf(const ModelBounds& bounds) : coordinates_(Member::coordinates(bounds)) {}
  std::string name() const override { return DoubleLaw::name; }
  std::vector<std::string> parameters() const override {
    return {DoubleLaw::parameters.begin(), DoubleLaw::parameters.end()};
  }
  const std::vector<Coordinate>& coordinates() const override { return coordinates_; }

  NaturalParameters natural(std::span<const double> x) const override {
    return natural_parameters(Member::natural(jets(x)));
  }

  bool evaluate(std::span<const double> x, double I, ModelValue& out) const override {
    const std::array<Jet, N> p = Member::natural(jets(x));
    std::array<double, N> values;
    for (std::size_t k = 0; k < N; ++k) values[k] = p[k].a;
    if constexpr (std::is_same_v<Member, BarkerAndGray>) {
      // I_N, where the branches meet, is found for the values and held while derivatives are taken. The
      // search for it is long, and every datum asks with the same values.
      thread_local std::array<double, N> last_values{};
      thread_local std::optional<DoubleLaw> last_law;
      if (values != last_values) {
        last_values = values;
        last_law.reset();
        try {
          last_law.emplace(values[0], values[1], values[2], values[3], values[4]);
        } catch (
            const std::invalid_argument&) {  // no well-posed law has these values: the fit looks elsewhere
        }
      }
      if (!last_law) return false;
      set(JetLaw(p[0], p[1], p[2], p[3], p[4], last_law->I_N)(I), last_law->slope(I), out);
    } else if constexpr (requires(DoubleLaw law) { law.slope(I); }) {
      set(make_law<JetLaw>(p)(I), make_law<DoubleLaw>(values).slope(I), out);
    } else {
      const auto at = make_law<typename Member::template law<ceres::Jet<double, 1>>>(constants(values));
      set(make_law<JetLaw>(p)(I), at(ceres::Jet<double, 1>(I, 0)).v[0], out);
    }
    return std::isfinite(out.value);
  }

  std::vector<double> start(double first, double last, double I_last) const override {
    return within(coordinates_, Member::start(first, last, I_last));
  }

 private:
  static std::array<Jet, N> jets(std::span<const double> x) { return seeded<Jet, N>(x); }
  static std::array<ceres::Jet<double, 1>, N> constants(const std::array<double, N>& values) {
    std::array<ceres::Jet<double, 1>, N> p;
    for (std::size_t k = 0; k < N; ++k) p[k] = ceres::Jet<double, 1>(values[k]);
    return p;
  }
  static void set(const Jet& value, double slope, ModelValue& out) {
    out.value = value.a;
    out.by_coordinate.assign(value.v.data(), value.v.data() + N);
    out.slope = slope;
  }
  std::vector<Coordinate> coordinates_;
};

}  // namespace

std::unique_ptr<SteadyModel> friction_model(const std::string& member, const ModelBounds& bounds) {
  if (member == "rational") return std::make_unique<ModelOf<RangeAndScale<RationalFriction>>>(bounds);
  if (member == "exponential") return std::make_unique<ModelOf<RangeAndScale<ExponentialFriction>>>(bounds);
  if (member == "power") return std::make_unique<ModelOf<PowerOfFriction>>(bounds);
  if (member == "linear") return std::make_unique<ModelOf<LineOfFriction>>(bounds);
  if (member == "barker_gray_2017") return std::make_unique<ModelOf<BarkerAndGray>>(bounds);
  throw std::logic_error("no friction law \"" + member + "\" can be fitted");
}

std::unique_ptr<SteadyModel> solid_fraction_model(const std::string& member, const ModelBounds& bounds) {
  if (member == "linear") return std::make_unique<ModelOf<LineOfPhi>>(bounds);
  if (member == "power") return std::make_unique<ModelOf<PowerOfPhi>>(bounds);
  if (member == "rational") return std::make_unique<ModelOf<RationalPhi>>(bounds);
  throw std::logic_error("no solid fraction law \"" + member + "\" can be fitted");
}

SteadySolidFraction solid_fraction_at(const SteadyModel& model, std::span<const double> coordinates) {
  const std::vector<double> values = model.natural(coordinates).values;
  const std::vector<std::string> names = model.parameters();
  using Family = decltype(SteadySolidFraction::law);
  const auto found = law_by_name<Family>(model.name(), [&](const char* name) {
    return values[static_cast<std::size_t>(std::find(names.begin(), names.end(), name) - names.begin())];
  });
  if (!found) throw std::logic_error(model.name() + " is no solid fraction law");
  return {*found};
}

// ---------------------------------------------------------------------------------------------------------------------
// Transients
// ---------------------------------------------------------------------------------------------------------------------

namespace {

// What a member carries beside phi: only the printed form has a state of its own, beta.
template <class J>
struct Flowing {
  J phi, beta;
};

// Of members whose beta follows from phi.
struct WithoutOwnBeta {
  template <class P, class J>
  static J first_beta(const P&, const J&, const J&, bool) {
    return J(0.0);
  }
};

// phi relaxes, over one scale or over one for each side.
template <std::size_t scales>
struct Relaxation : WithoutOwnBeta {
  static constexpr std::size_t count = scales;
  static constexpr const char* name = scales == 1 ? "phi_relaxes" : "two_sided";
  static std::vector<std::string> parameters() {
    return scales == 1 ? std::vector<std::string>{"s_star"}
                       : std::vector<std::string>{"s_star", "s_star_compacting"};
  }
  static std::vector<Coordinate> coordinates(double low, double high) {
    std::vector<Coordinate> list;
    for (const std::string& parameter : parameters()) list.push_back(logarithm(parameter.c_str(), low, high));
    return list;
  }
  static std::array<double, scales> start() {
    std::array<double, scales> x{std::log(0.4)};
    if constexpr (scales == 2) x[1] = std::log(0.2);
    return x;
  }
  template <class J>
  static std::array<J, scales> natural(const std::array<J, scales>& x) {
    return exponentials(x);
  }
  template <class J>
  static void advance(const std::array<J, scales>& p, Flowing<J>& state, const J& eq, const J&, const J&,
                      double ds) {
    state.phi = relax_solid_fraction(state.phi, eq, ds / scale(p, state.phi, eq));
  }
  template <class J>
  static J beta(const std::array<J, scales>& p, const Flowing<J>& state, const J& eq) {
    return dilation_rate(state.phi, eq, scale(p, state.phi, eq));
  }

 private:
  template <class J>
  static J scale(const std::array<J, scales>& p, const J& phi, const J& eq) {
    return strain_scale(phi, eq, p.front(), p.back());
  }
};

struct Printed {
  static constexpr std::size_t count = 2;
  static constexpr const char* name = "printed";
  static constexpr double largest_gain = 10;
  static std::vector<std::string> parameters() { return {"s_star", "gain"}; }
  static std::vector<Coordinate> coordinates(double low, double high) {
    return {logarithm("s_star", low, high), {"gain", 0, largest_gain}};
  }
  static std::array<double, 2> start() { return {std::log(0.4), 1}; }
  template <class J>
  static std::array<J, 2> natural(const std::array<J, 2>& x) {
    return {exp(x[0]), x[1]};
  }
  // The source of a sudden change of I is a jump of beta by the gain times (phi - phi_eq)/(phi s*), with phi
  // that of the steady flow before it. A packing that never flowed starts with the whole.
  template <class J>
  static J first_beta(const std::array<J, 2>& p, const J& phi_0, const J& eq, bool from_steady_flow) {
    const J whole = dilation_rate(phi_0, eq, p[0]);
    return from_steady_flow ? J(p[1] * whole) : whole;
  }
  template <class J>
  static void advance(const std::array<J, 2>& p, Flowing<J>& state, const J&, const J& before, const J& now,
                      double ds) {
    const J jump = p[1] * (before - now) / (before * p[0]);
    const J beta = relax_dilation_rate_ramp(state.beta, jump, ds / p[0]);
    // d(beta) = -beta ds/s* + S ds, summed up: the integral of beta.
    state.phi *= exp(-(p[0] * (state.beta - beta + jump)));
    state.beta = beta;
  }
  template <class J>
  static J beta(const std::array<J, 2>&, const Flowing<J>& state, const J&) {
    return state.beta;
  }
};

struct Dilatancy : WithoutOwnBeta {
  static constexpr std::size_t count = 1;
  static constexpr const char* name = "dilatancy";
  static std::vector<std::string> parameters() { return {"K"}; }
  static std::vector<Coordinate> coordinates(double low, double high) {
    // Near phi_eq, K is 1/(phi_eq s*), and phi_eq lies between 0.4 and 0.74.
    return {logarithm("K", 1 / high, 3 / low)};
  }
  static std::array<double, 1> start() { return {std::log(4.0)}; }
  template <class J>
  static std::array<J, 1> natural(const std::array<J, 1>& x) {
    return exponentials(x);
  }
  // d(phi)/ds = -K phi (phi - eq), logistic: 1 - eq/phi decays like exp(-K eq s).
  template <class J>
  static void advance(const std::array<J, 1>& p, Flowing<J>& state, const J& eq, const J&, const J&,
                      double ds) {
    state.phi = eq / (1.0 - (1.0 - eq / state.phi) * exp(-(p[0] * eq * ds)));
  }
  template <class J>
  static J beta(const std::array<J, 1>& p, const Flowing<J>& state, const J& eq) {
    return p[0] * (state.phi - eq);
  }
};

struct ConstantDilation : WithoutOwnBeta {
  static constexpr std::size_t count = 1;
  static constexpr const char* name = "constant";
  static std::vector<std::string> parameters() { return {"beta"}; }
  static std::vector<Coordinate> coordinates(double, double) { return {{"beta", -10, 10}}; }
  static std::array<double, 1> start() { return {0}; }
  template <class J>
  static std::array<J, 1> natural(const std::array<J, 1>& x) {
    return x;
  }
  template <class J>
  static void advance(const std::array<J, 1>& p, Flowing<J>& state, const J&, const J&, const J&, double ds) {
    state.phi *= exp(-(p[0] * ds));
  }
  template <class J>
  static J beta(const std::array<J, 1>& p, const Flowing<J>&, const J&) {
    return p[0];
  }
};

struct NoChange : WithoutOwnBeta {
  static constexpr std::size_t count = 0;
  static constexpr const char* name = "none";
  static std::vector<std::string> parameters() { return {}; }
  static std::vector<Coordinate> coordinates(double, double) { return {}; }
  static std::array<double, 0> start() { return {}; }
  template <class J>
  static std::array<J, 0> natural(const std::array<J, 0>& x) {
    return x;
  }
  template <class J>
  static void advance(const std::array<J, 0>&, Flowing<J>&, const J&, const J&, const J&, double) {}
  template <class J>
  static J beta(const std::array<J, 0>&, const Flowing<J>&, const J&) {
    return J(0.0);
  }
};

template <class Member>
class DilationModelOf final : public DilationModel {
  static constexpr std::size_t N = Member::count;
  static constexpr int all = static_cast<int>(N) + 2;  // with the offset and phi_0
  using Jet = ceres::Jet<double, all>;

 public:
  DilationModelOf(double s_star_min, double s_star_max)
      : parameters_(Member::parameters()), coordinates_(Member::coordinates(s_star_min, s_star_max)) {}
  std::string name() const override { return Member::name; }
  const std::vector<std::string>& parameters() const override { return parameters_; }
  const std::vector<Coordinate>& coordinates() const override { return coordinates_; }
  NaturalParameters natural(std::span<const double> x) const override {
    return natural_parameters(natural_jets(x));
  }
  std::vector<double> start() const override { return within(coordinates_, Member::start()); }
  TransientSolution evaluate(const TransientInput& t, std::span<const double> x, double offset, double phi_0,
                             bool with_beta) const override {
    const std::array<Jet, N> p = natural_jets(x);
    const Jet moved(offset, static_cast<int>(N));
    Flowing<Jet> state{Jet(phi_0, static_cast<int>(N) + 1), Jet(0.0)};
    Jet before = moved + t.phi_eq[0];  // the change has happened when the strain begins
    state.beta = Member::first_beta(p, state.phi, before, t.from_steady_flow);
    TransientSolution solution;
    const std::size_t n = t.s.size();
    solution.phi.resize(n);
    solution.phi_by.resize(static_cast<Eigen::Index>(n), all);
    if (with_beta) {
      solution.beta.resize(n);
      solution.beta_by.resize(static_cast<Eigen::Index>(n), all);
    }
    for (std::size_t i = 0; i < n; ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      const Jet now = moved + t.phi_eq[i];
      Member::advance(p, state, moved + t.phi_eq_step[i], before, now, i == 0 ? t.s[0] : t.s[i] - t.s[i - 1]);
      solution.phi[i] = state.phi.a;
      solution.phi_by.row(row) = state.phi.v.transpose();
      if (with_beta) {
        const Jet beta = Member::beta(p, state, now);
        solution.beta[i] = beta.a;
        solution.beta_by.row(row) = beta.v.transpose();
      }
      before = now;
    }
    return solution;
  }

 private:
  static std::array<Jet, N> natural_jets(std::span<const double> x) {
    return Member::natural(seeded<Jet, N>(x));
  }
  std::vector<std::string> parameters_;
  std::vector<Coordinate> coordinates_;
};

}  // namespace

std::unique_ptr<DilationModel> dilation_model(const std::string& member, double s_star_min,
                                              double s_star_max) {
  std::unique_ptr<DilationModel> model;
  const auto consider = [&]<class Member>(Member) {
    if (member == Member::name) model = std::make_unique<DilationModelOf<Member>>(s_star_min, s_star_max);
  };
  consider(Relaxation<1>{}), consider(Relaxation<2>{}), consider(Printed{});
  consider(Dilatancy{}), consider(ConstantDilation{}), consider(NoChange{});
  if (model == nullptr) throw std::logic_error("no law of dilation \"" + member + "\" can be fitted");
  return model;
}

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

}  // namespace dem2sph
