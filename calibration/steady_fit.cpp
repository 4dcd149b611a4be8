#include "calibration/steady_fit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <random>

#include "calibration/estimates.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

/// Residuals beyond this many effective standard errors pull with a constant force (Huber 1964): 2.3 % of
/// normal data a side are touched, and the loss of precision is below 1 %.
constexpr double huber_limit = 2.0;

ResidualBlock block_of(const SteadyModel& model, const SteadyDatum& datum) {
  ResidualBlock block;
  for (std::size_t k = 0; k < model.coordinates().size(); ++k) block.parameters.push_back(k);
  block.size = 1;
  block.evaluate = [&model, &datum, value = ModelValue{}](std::span<const double> x,
                                                          std::span<double> residuals,
                                                          std::span<double> jacobian) mutable {
    if (!model.evaluate(x, datum.I, value)) return false;
    residuals[0] = (datum.value - value.value) / datum.effective_se;
    for (std::size_t k = 0; k < jacobian.size(); ++k)
      jacobian[k] = -value.by_coordinate[k] / datum.effective_se;
    return std::isfinite(residuals[0]);
  };
  return block;
}

/// The problem of all data, starting at `start`. The data must outlive it.
LeastSquaresProblem problem_of(const SteadyModel& model, const std::vector<SteadyDatum>& data,
                               const std::string& family, const std::vector<double>& start,
                               const std::vector<bool>& held = {}) {
  LeastSquaresProblem problem;
  problem.name = family;
  for (std::size_t k = 0; k < start.size(); ++k) {
    const Coordinate& c = model.coordinates()[k];
    problem.parameters.push_back({c.name, start[k], c.lower, c.upper, !held.empty() && held[k]});
  }
  for (const SteadyDatum& datum : data) problem.blocks.push_back(block_of(model, datum));
  return problem;
}

/// Starts that fill the box of the bounds evenly in the coordinates. The generator is fixed by the standard:
/// the same starts on every machine.
std::vector<std::vector<double>> spread_starts(const SteadyModel& model, long count) {
  std::mt19937 generator(20061);
  std::vector<std::vector<double>> starts;
  for (long i = 1; i < count; ++i) {
    std::vector<double> start;
    for (const Coordinate& c : model.coordinates())
      start.push_back(c.lower + static_cast<double>(generator()) / 4294967296.0 * (c.upper - c.lower));
    starts.push_back(std::move(start));
  }
  return starts;
}

/// Effective errors from the slope of the law at `x`, and Huber's weights from its residuals.
void weigh(const SteadyModel& model, std::span<const double> x, std::vector<SteadyDatum>& data, bool robust) {
  ModelValue value;
  std::vector<double> sizes;
  for (SteadyDatum& datum : data) {
    if (!model.evaluate(x, datum.I, value))
      throw IdentifiabilityError(
          fmt::format("run {}: the {} law has no value at its I", datum.run, model.name()));
    const double slope = std::isfinite(value.slope) ? value.slope : 0;  // a power law at I = 0
    datum.plain_se = std::hypot(datum.value_se, slope * datum.I_se);
    datum.fitted = value.value;
    datum.residual = (datum.value - value.value) / datum.plain_se;
    sizes.push_back(std::abs(datum.residual));
  }
  // If all data scatter more than they admit, it is not the single one that is out of line: the limit grows
  // with the median of the residuals, which is 0.6745 of normal ones.
  std::nth_element(sizes.begin(), sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2), sizes.end());
  const double limit = huber_limit * std::max(1.0, sizes[sizes.size() / 2] / 0.6745);
  for (SteadyDatum& datum : data) {
    const double size = std::abs(datum.residual);
    datum.weight = robust && size > limit ? limit / size : 1;
    datum.effective_se = datum.plain_se / std::sqrt(datum.weight);
  }
}

std::size_t free_of(const std::vector<bool>& at_bound) {
  return static_cast<std::size_t>(std::count(at_bound.begin(), at_bound.end(), false));
}

/// -2 ln L of the data about the law, with Huber's loss, up to n ln(2 pi).
double minus_two_log_likelihood(const std::vector<SteadyDatum>& data, bool robust) {
  double sum = 0;
  for (const SteadyDatum& d : data) {
    const double r = std::abs(d.residual);
    sum += 2 * std::log(d.plain_se) +
           (robust && r > huber_limit ? 2 * huber_limit * r - huber_limit * huber_limit : r * r);
  }
  return sum;
}

/// Different I are needed, not merely different runs.
void require_conditions(const std::vector<SteadyDatum>& data, std::size_t needed, const std::string& law) {
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

/// Weights and coordinates in turn until no coordinate moves by more than a thousandth of its error. `result`
/// starts from its values and ends at the fixed point.
int settle(const SteadyModel& model, std::vector<SteadyDatum>& data, const std::string& family, bool robust,
           LeastSquaresResult& result) {
  for (int turn = 1;; ++turn) {
    if (turn == 100)
      throw IdentifiabilityError(fmt::format(
          "{}: the weights from the errors of I do not settle; the errors of I are too large", family));
    weigh(model, result.values, data, robust);
    const std::vector<double> before = result.values;
    result = solve_least_squares(problem_of(model, data, family, before));
    bool settled = true;
    for (std::size_t k = 0; k < before.size(); ++k)
      settled = settled && std::abs(result.values[k] - before[k]) <=
                               1e-3 * std::sqrt(std::max(0.0, result.covariance[k][k]));
    if (settled) return turn;
  }
}

}  // namespace

SteadyFit fit_steady(const SteadyModel& model, std::vector<SteadyDatum> data, const std::string& family,
                     const FitOptions& options) {
  require_conditions(data, model.coordinates().size(), family);
  std::sort(data.begin(), data.end(), [](const SteadyDatum& a, const SteadyDatum& b) { return a.I < b.I; });
  const double first = std::max(data.front().value, 1e-3);
  const double away = data.back().value - data.front().value;
  // Ends that are nearly equal say nothing about the scale: 0.01 is a first guess of the right order.
  const double last =
      std::abs(away) > 0.01 ? data.back().value : first + (family == "friction" ? 0.01 : -0.01);
  for (SteadyDatum& datum : data) datum.effective_se = datum.plain_se = datum.value_se;

  const std::vector<std::vector<double>> starts = spread_starts(model, options.starts);
  LeastSquaresResult result =
      solve_least_squares(problem_of(model, data, family, model.start(first, last, data.back().I)), starts);
  int reweighted = settle(model, data, family, options.robust, result);
  // The other starts once more, with the weights of the fit; a better minimum begins anew.
  const double found = result.chi2;
  result = solve_least_squares(problem_of(model, data, family, result.values), starts);
  if (result.chi2 < found - 1e-3) {
    const LeastSquaresResult all = result;
    reweighted += settle(model, data, family, options.robust, result);
    result.starts = all.starts, result.converged = all.converged, result.agreed = all.agreed;
  }

  SteadyFit fit;
  fit.law.coordinates = result.values;
  for (std::size_t i = 0; i < data.size(); ++i) {
    data[i].residual = result.residuals[i] / std::sqrt(data[i].weight);
    data[i].fitted = data[i].value - data[i].residual * data[i].plain_se;
  }
  LawFit& law = fit.law;
  law.member = model.name();
  law.search = {result.starts,      result.converged,       result.agreed, result.iterations,
                result.termination, result.singular_values, reweighted};
  const NaturalParameters natural = model.natural(result.values);
  law.covariance = propagate(natural.by_coordinate, result.covariance);
  scale_errors(law, result.chi2, static_cast<double>(result.degrees_of_freedom));
  law.coordinate_covariance = result.covariance;
  for (std::vector<double>& row : law.coordinate_covariance)
    for (double& value : row) value *= law.error_scale * law.error_scale;
  const std::vector<std::string> names = model.parameters();
  for (std::size_t k = 0; k < names.size(); ++k) {
    // A parameter is at a bound if the coordinate that it depends on most directly, that of its own place,
    // is.
    const bool at_bound = result.at_bound[k];
    law.parameters.push_back(estimate_of(names[k], model.coordinates()[k], natural.values[k],
                                         law.covariance[k][k], law.interval_factor, at_bound));
  }
  for (const SteadyDatum& datum : data)
    if (datum.weight < 1) law.downweighted.push_back(datum.run);

  const auto n = static_cast<double>(data.size());
  const auto k = static_cast<double>(free_of(result.at_bound));
  const double deviance = minus_two_log_likelihood(data, options.robust);
  law.BIC = deviance + k * std::log(n);
  law.AICc = corrected_AIC(deviance, n, k);
  fit.data = std::move(data);
  return fit;
}

void add_profiles(SteadyFit& fit, const SteadyModel& model, const std::string& family) {
  LawFit& law = fit.law;
  const LeastSquaresProblem problem = problem_of(model, fit.data, family, fit.law.coordinates);
  const double scaled = law.interval_factor * law.error_scale;
  const auto quantity = [&](std::size_t parameter) {
    return [&model, parameter](std::span<const double> x, std::span<double> gradient) {
      const NaturalParameters natural = model.natural(x);
      std::copy(natural.by_coordinate[parameter].begin(), natural.by_coordinate[parameter].end(),
                gradient.begin());
      return natural.values[parameter];
    };
  };
  for (std::size_t k = 0; k < law.parameters.size(); ++k) {
    Estimate& e = law.parameters[k];
    if (e.at_bound || !(e.standard_error > 0)) continue;
    ProfileRequest request;
    request.name = e.name;
    request.quantity = quantity(k);
    request.standard_error = e.standard_error / law.error_scale;
    request.threshold = scaled * scaled;
    const Coordinate& c = model.coordinates()[k];
    if (c.is_logarithm_of(e.name)) {
      request.lowest = std::exp(c.lower);
      request.highest = std::exp(c.upper);
    } else if (c.name == e.name) {
      request.lowest = c.lower;
      request.highest = c.upper;
    }
    const Profile profile = profile_likelihood(problem, law.chi2, request);
    e.low = profile.low;
    e.high = profile.high;
    e.open_low = profile.open_low;
    e.open_high = profile.open_high;
    law.profiles.push_back(profile);
  }
}

CrossValidation cross_validate(const SteadyFit& fit, const SteadyModel& model, const std::string& family,
                               const FitOptions& options) {
  std::map<double, std::vector<const SteadyDatum*>> conditions;
  for (const SteadyDatum& d : fit.data) conditions[d.I_driven].push_back(&d);
  CrossValidation result;
  if (conditions.size() <= model.coordinates().size()) return result;
  double squares = 0;
  for (const auto& [driven, held_out] : conditions) {
    std::vector<SteadyDatum> rest;
    for (const SteadyDatum& d : fit.data)
      if (d.I_driven != driven) rest.push_back(d);
    LeastSquaresResult without;
    without.values = fit.law.coordinates;
    settle(model, rest, family, options.robust, without);
    ModelValue value;
    double mean = 0, predicted = 0;
    for (const SteadyDatum* d : held_out) {
      if (!model.evaluate(without.values, d->I, value))
        throw IdentifiabilityError(fmt::format("{}: no prediction at I = {:g}", family, d->I));
      mean += d->value / static_cast<double>(held_out.size());
      predicted += value.value / static_cast<double>(held_out.size());
    }
    const double error = predicted / mean - 1;
    result.conditions.push_back({driven, mean, predicted, error});
    squares += error * error;
    result.largest = std::max(result.largest, std::abs(error));
  }
  result.rms = std::sqrt(squares / static_cast<double>(conditions.size()));
  return result;
}

void add_bootstrap(SteadyFit& fit, const SteadyModel& model, const std::string& family,
                   const FitOptions& options) {
  std::map<double, std::vector<const SteadyDatum*>> conditions;
  for (const SteadyDatum& d : fit.data) conditions[d.I_driven].push_back(&d);
  const auto with_twins = std::count_if(conditions.begin(), conditions.end(),
                                        [](const auto& condition) { return condition.second.size() > 1; });
  if (options.bootstrap < 2 || 2 * with_twins < std::ssize(conditions)) return;

  Bootstrap& out = fit.law.bootstrap;
  const double first = fit.data.front().I, last = fit.data.back().I;  // sorted by I
  for (int k = 0; k <= 40; ++k) out.I.push_back(first * std::pow(last / first, k / 40.0));
  std::vector<std::vector<double>> parameters(model.parameters().size()), band(out.I.size());
  std::mt19937 generator(20062);  // the same draws on every machine
  for (long draw = 0; draw < options.bootstrap; ++draw) {
    std::vector<SteadyDatum> data;
    for (const auto& [driven, runs] : conditions) {
      const auto n = static_cast<double>(runs.size());
      double I = 0, value = 0;
      for (const SteadyDatum* run : runs) I += run->I / n, value += run->value / n;
      const double wider = runs.size() > 1 ? std::sqrt(n / (n - 1)) : 0;
      for (std::size_t k = 0; k < runs.size(); ++k) {
        SteadyDatum d = *runs[generator() % runs.size()];
        d.I = I + (runs.size() > 1 ? wider * (d.I - I) : d.I - I);
        d.value = value + (runs.size() > 1 ? wider * (d.value - value) : d.value - value);
        data.push_back(std::move(d));
      }
    }
    LeastSquaresResult result;
    result.values = fit.law.coordinates;
    settle(model, data, family, options.robust, result);
    const NaturalParameters natural = model.natural(result.values);
    for (std::size_t k = 0; k < parameters.size(); ++k) parameters[k].push_back(natural.values[k]);
    ModelValue value;
    for (std::size_t k = 0; k < band.size(); ++k) {
      if (!model.evaluate(result.values, out.I[k], value))
        throw NumericalError(
            fmt::format("{}: a draw of the bootstrap has no value at I = {:g}", family, out.I[k]));
      band[k].push_back(value.value);
    }
  }
  out.draws = options.bootstrap;
  for (const std::vector<double>& values : parameters) {
    out.low.push_back(quantile(values, 0.025));
    out.high.push_back(quantile(values, 0.975));
  }
  for (const std::vector<double>& values : band) {
    out.band_low.push_back(quantile(values, 0.025));
    out.band_high.push_back(quantile(values, 0.975));
  }
}

}  // namespace dem2sph
