#include "calibration/dilation_fit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <utility>

#include "calibration/beta_in_mu.hpp"
#include "calibration/estimates.hpp"
#include "calibration/least_squares.hpp"
#include "calibration/transient_problem.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

/// Those that a flow can run, then those that are compared only.
const std::vector<std::string> dilation_members{"phi_relaxes", "two_sided", "printed",
                                                "dilatancy",   "constant",  "none"};
constexpr std::size_t members_of_flows = 3;

/// A member takes the place of phi_relaxes only if its AICc is lower by 10: Burnham and Anderson (2002) see
/// essentially no support for the other one then.
constexpr double decisive_AICc = 10;

double root(double variance) { return std::sqrt(std::max(0.0, variance)); }
bool any(const std::vector<bool>& flags) {
  return std::find(flags.begin(), flags.end(), true) != flags.end();
}

struct Settled {
  LeastSquaresResult result;
  NoiseModel noise;
  TransientProblem::Weights weights;
  int reweighted = 0;
};

class DilationFit {
 public:
  DilationFit(const SelectedData& selected, const FitOptions& options, SteadySolidFraction law)
      : options_(options), law_(std::move(law)), problem_(selected, options.bins) {}

  const TransientProblem& problem() const { return problem_; }
  const SteadySolidFraction& law() const { return law_; }
  std::unique_ptr<DilationModel> model(const std::string& member) const {
    return dilation_model(member, options_.s_star_min, options_.s_star_max);
  }

  /// Starts that fill the box of the bounds: multiples of the powers of 1/1.3247 (Roberts' sequence), so any
  /// number of them is spread evenly.
  static std::vector<std::vector<double>> starts(const DilationModel& model, long count) {
    std::vector<std::vector<double>> list;
    for (long i = 1; i < count; ++i) {
      std::vector<double> x;
      double multiplier = 1;
      for (const Coordinate& c : model.coordinates()) {
        multiplier /= 1.3247179572447460;
        const double at = 0.5 + static_cast<double>(i) * multiplier;
        x.push_back(c.lower + (at - std::floor(at)) * (c.upper - c.lower));
      }
      list.push_back(std::move(x));
    }
    return list;
  }

  LeastSquaresResult solve(const DilationModel& model, const TransientProblem::Weights& weights,
                           const std::vector<double>& start, long count = 1) const {
    return solve_least_squares(problem_.problem(model, law_, weights, start), starts(model, count));
  }

  std::vector<CorrelatedResiduals> residuals(const DilationModel& model, const std::vector<double>& x,
                                             const TransientProblem::Weights& weights) const {
    return problem_.residuals(model, law_, x, problem_.constants(model, law_, weights, x, {}));
  }

  /// Noise and coordinates in turn, until these move by less than a tenth of their errors: the noise itself
  /// is known no better than to some 10 %.
  Settled settle(const DilationModel& model) const {
    Settled s;
    s.result = solve(model, {}, model.start());
    for (bool settled = false; !settled; ++s.reweighted) {
      if (s.reweighted == 20)
        throw IdentifiabilityError(
            "dilation: the noise of the transients and the fit do not settle; add transients");
      s.noise = fit_noise(residuals(model, s.result.values, s.weights), problem_.parameters(model));
      s.weights = problem_.whitening(s.noise);
      const std::vector<double> before = s.result.values;
      s.result = solve(model, s.weights, before);
      settled = true;
      for (std::size_t k = 0; k < before.size(); ++k)
        settled =
            settled && std::abs(s.result.values[k] - before[k]) <= 0.1 * root(s.result.covariance[k][k]);
    }
    s.result = solve(model, s.weights, s.result.values, options_.starts);
    return s;
  }

  /// A member at given weights, for the comparison.
  LawFit compare(const std::string& member, const TransientProblem::Weights& weights,
                 double independent) const {
    const std::unique_ptr<DilationModel> m = model(member);
    LawFit out;
    out.member = member;
    std::vector<double> x;
    if (!m->coordinates().empty()) {
      // Three starts: only chi2 is wanted, and no less than 10 of it decides.
      const LeastSquaresResult result = solve(*m, weights, m->start(), std::min(3L, options_.starts));
      x = result.values;
      const NaturalParameters natural = m->natural(x);
      out.covariance = propagate(natural.by_coordinate, result.covariance);
      for (std::size_t k = 0; k < x.size(); ++k)
        out.parameters.push_back(symmetric_estimate(m->parameters()[k], natural.values[k],
                                                    out.covariance[k][k], normal_quantile(0.975),
                                                    result.at_bound[k]));
    }
    out.coordinates = x;
    out.interval_factor = normal_quantile(0.975);
    std::size_t samples = 0;
    bool offsets_count = false;
    const std::vector<CorrelatedResiduals> left = residuals(*m, x, weights);
    for (std::size_t r = 0; r < left.size(); ++r) {
      out.chi2 += (weights[r] * left[r].residuals).squaredNorm();
      samples += left[r].s.size();
      offsets_count = offsets_count || left[r].jacobian.col(static_cast<Eigen::Index>(x.size())).any();
    }
    const auto k = static_cast<double>(problem_.parameters(*m) - (offsets_count ? 0 : problem_.conditions()));
    out.degrees_of_freedom = static_cast<double>(samples) - k;
    out.chi2_per_dof = out.degrees_of_freedom > 0 ? out.chi2 / out.degrees_of_freedom : 0;
    // The noise is the same for all members, so its determinant drops out.
    const double corrected = corrected_AIC(out.chi2, independent, k);
    out.AICc = std::isfinite(corrected) ? corrected : out.chi2 + 2 * k;  // nothing to correct with
    out.BIC = out.chi2 + k * std::log(std::max(2.0, independent));
    return out;
  }

 private:
  const FitOptions& options_;
  SteadySolidFraction law_;
  TransientProblem problem_;
};

/// Sum over runs of how many independent samples each has.
double independent_samples(const NoiseModel& noise, const TransientProblem& problem) {
  double count = 0;
  for (const BinnedTransient& run : problem.runs()) count += noise.independent_samples(run.s);
  return count;
}

/// How well a law describes the groups of twins, beyond what their noise would hide.
class Checks {
 public:
  Checks(const DilationFit& dilation, const DilationModel& model, const NoiseModel& noise)
      : problem_(dilation.problem()),
        law_(dilation.law()),
        model_(model),
        noise_(noise),
        weights_(problem_.whitening(noise)) {}

  /// By the law at `x`; `fitted`: how many of `constants` were fitted to this group.
  TransientCheck describe(const std::vector<std::size_t>& group, const std::vector<double>& x,
                          const TransientConstants& constants, double fitted) const {
    const Transient& first = *problem_.runs()[group.front()].transient;
    TransientCheck check;
    check.kind = first.kind;
    check.I_before = first.I_before, check.I_driven = first.I_driven;
    check.load_before = first.load_before, check.load = first.load;
    check.packing_friction = first.packing_friction;
    check.seeds = std::ssize(group);
    const auto runs = static_cast<double>(group.size());
    // They share their axis of strain; some end a little earlier.
    std::size_t n = std::numeric_limits<std::size_t>::max();
    for (const std::size_t r : group) n = std::min(n, problem_.runs()[r].transient->s.size());
    check.s.assign(n, 0.0), check.phi.assign(n, 0.0), check.phi_fit.assign(n, 0.0);
    double chi2 = 0, samples = 0;
    for (const std::size_t r : group) {
      const CorrelatedResiduals left = problem_.residuals_of(r, model_, law_, x, constants);
      chi2 += (weights_[r] * left.residuals).squaredNorm();
      samples += static_cast<double>(left.s.size());
      const TransientSolution solution = problem_.solution(model_, law_, x, constants, r);
      const Transient& t = *problem_.runs()[r].transient;
      for (std::size_t k = 0; k < n; ++k) {
        check.s[k] += t.s[k] / runs;
        check.phi[k] += t.phi[k] / runs;
        check.phi_fit[k] += solution.phi[k] / runs;
      }
    }
    const auto count = static_cast<double>(n);
    double mean = 0, signal = 0, missed = 0;
    for (double v : check.phi) mean += v / count;
    for (std::size_t k = 0; k < n; ++k) {
      signal += (check.phi[k] - mean) * (check.phi[k] - mean) / count;
      missed += (check.phi[k] - check.phi_fit[k]) * (check.phi[k] - check.phi_fit[k]) / count;
    }
    const double noise = noise_.variance() / runs;
    check.chi2_per_dof = chi2 / std::max(1.0, samples - fitted);
    check.signal_to_noise = std::sqrt(std::max(0.0, signal - noise) / noise);
    check.explained = signal > noise ? 1 - std::max(0.0, missed - noise) / (signal - noise) : 0;
    return check;
  }

  /// What a law at `x` that was fitted to others makes of a group: no offset, phi_0 of each run free.
  TransientCheck predict(std::size_t index, const std::vector<std::size_t>& group,
                         const std::vector<double>& x) const {
    TransientProblem::Choice only;
    only.only_group = index;
    only.offsets = false;
    return describe(group, x, problem_.constants(model_, law_, weights_, x, only),
                    static_cast<double>(group.size()));
  }

 private:
  const TransientProblem& problem_;
  const SteadySolidFraction& law_;
  const DilationModel& model_;
  NoiseModel noise_;
  TransientProblem::Weights weights_;
};

/// Every group by the fitted law, and by a law that was fitted without it.
std::vector<TransientCheck> check_groups(const DilationFit& dilation, const DilationModel& model,
                                         const Settled& settled, const TransientConstants& constants,
                                         const NoiseModel& seeds) {
  const TransientProblem& problem = dilation.problem();
  const std::vector<double>& x = settled.result.values;
  const Checks checks(dilation, model, seeds);
  const std::vector<std::vector<std::size_t>> groups = problem.twins();
  std::vector<double> in_condition(problem.conditions(), 0.0);
  for (const BinnedTransient& run : problem.runs()) ++in_condition[run.condition];
  std::vector<TransientCheck> list;
  for (std::size_t g = 0; g < groups.size(); ++g) {
    // Each run has its phi_0, and a share in the offset of its condition.
    const auto runs = static_cast<double>(groups[g].size());
    const double share = runs / in_condition[problem.runs()[groups[g].front()].condition];
    list.push_back(checks.describe(groups[g], x, constants, runs + share));
    if (groups.size() == 1) continue;
    TransientProblem::Choice without;
    without.without_group = g;
    try {
      const LeastSquaresResult rest =
          solve_least_squares(problem.problem(model, dilation.law(), settled.weights, x, without));
      const TransientCheck predicted = checks.predict(g, groups[g], rest.values);
      list.back().predicted = true;
      list.back().predicted_chi2_per_dof = predicted.chi2_per_dof;
      list.back().predicted_explained = predicted.explained;
    } catch (const IdentifiabilityError&) {  // the others do not tell the law: `predicted` stays false
    }
  }
  return list;
}

/// Autocorrelation of the whitened residuals at lag one.
double lag_one(const std::vector<CorrelatedResiduals>& left, const TransientProblem::Weights& weights) {
  double products = 0, squares = 0;
  for (std::size_t r = 0; r < left.size(); ++r) {
    const Eigen::VectorXd white = weights[r] * left[r].residuals;
    squares += white.squaredNorm();
    products += white.head(white.size() - 1).dot(white.tail(white.size() - 1));
  }
  return products / squares;
}

/// Means over a group of what its runs are shown with.
void add_means(TransientCheck& check, const std::vector<TransientFit>& transients,
               const std::vector<std::size_t>& group) {
  const auto mean = [&](std::vector<double> TransientFit::*what) {
    std::vector<double> values(check.s.size(), 0.0);
    for (const std::size_t r : group)
      for (std::size_t k = 0; k < values.size(); ++k)
        values[k] += (transients[r].*what)[k] / static_cast<double>(group.size());
    return values;
  };
  check.beta = mean(&TransientFit::beta);
  check.beta_fit = mean(&TransientFit::beta_fit);
  check.mu_excess = mean(&TransientFit::mu_excess);
  for (const std::size_t r : group) check.runs.push_back(transients[r].run);
}

TransientFit seen(const Transient& t, const Fit& fit, const TransientSolution& solution) {
  TransientFit out;
  out.run = t.run, out.kind = t.kind, out.seed = t.seed, out.I_driven = t.I_driven;
  out.s = t.s, out.phi = t.phi, out.beta = t.beta;
  out.phi_fit = solution.phi, out.beta_fit = solution.beta;
  double mean = 0, about_mean = 0, about_fit = 0;
  for (double phi : t.phi) mean += phi / static_cast<double>(t.phi.size());
  for (std::size_t i = 0; i < t.s.size(); ++i) {
    out.mu_excess.push_back(t.mu[i] - fit.steady_friction_at(t.I[i]));
    about_mean += (t.phi[i] - mean) * (t.phi[i] - mean);
    about_fit += (t.phi[i] - solution.phi[i]) * (t.phi[i] - solution.phi[i]);
  }
  out.explained = about_mean > 0 ? 1 - about_fit / about_mean : 0;
  return out;
}

/// Of the coordinates: from the whitened fit, or the spread over runs (jackknife) where that is larger.
Matrix covariance_of_coordinates(Fit& fit, const RunInformation& runs, const Settled& settled,
                                 const Matrix& whitened) {
  const std::vector<double>& best = settled.result.values;
  const std::size_t n = best.size();
  Matrix out;
  for (std::size_t k = 0; k < n; ++k)
    out.emplace_back(whitened[k].begin(), whitened[k].begin() + static_cast<std::ptrdiff_t>(n));
  const double s_star = std::exp(best[0]);  // ln s* is the first of every member
  fit.s_star_error_least_squares = s_star * root(out[0][0]);
  if (runs.runs.size() < 3 || any(settled.result.at_bound)) return out;
  std::vector<std::vector<double>> without(n);
  std::vector<double> times(runs.runs.size(), 1.0);
  for (double& one : times) {
    one = 0;
    const Eigen::VectorXd step = runs.step(times);
    for (std::size_t k = 0; k < n; ++k) without[k].push_back(best[k] + step(static_cast<Eigen::Index>(k)));
    one = 1;
  }
  for (std::size_t k = 0; k < n; ++k) {
    const double jackknife = jackknife_variance(without[k]);
    if (k == 0) fit.s_star_error_jackknife = s_star * root(jackknife);
    if (!(jackknife > whitened[k][k])) continue;
    const double larger = std::sqrt(jackknife / whitened[k][k]);
    for (std::size_t b = 0; b < n; ++b) out[k][b] *= larger, out[b][k] *= larger;
  }
  return out;
}

/// Runs drawn anew among the seeds of each group, one linear step each; as for the steady laws, deviations
/// are widened by sqrt(n/(n - 1)).
Bootstrap bootstrap_over_seeds(const DilationModel& law, const std::vector<double>& best,
                               const RunInformation& runs,
                               const std::vector<std::vector<std::size_t>>& groups, long draws) {
  Bootstrap out;
  const auto with_twins =
      std::count_if(groups.begin(), groups.end(), [](const auto& group) { return group.size() > 1; });
  if (draws < 2 || 2 * with_twins < std::ssize(groups)) return out;
  std::vector<std::vector<double>> parameters(best.size());
  std::mt19937 generator(20063);  // the same draws on every machine
  for (long draw = 0; draw < draws; ++draw) {
    std::vector<double> times(runs.runs.size(), 1.0);
    for (const std::vector<std::size_t>& group : groups) {
      if (group.size() < 2) continue;
      const auto n = static_cast<double>(group.size());
      const double wider = std::sqrt(n / (n - 1));
      for (const std::size_t r : group) times[r] -= wider;
      for (std::size_t k = 0; k < group.size(); ++k) times[group[generator() % group.size()]] += wider;
    }
    const Eigen::VectorXd step = runs.step(times);
    std::vector<double> x = best;
    for (std::size_t k = 0; k < x.size(); ++k) x[k] += step(static_cast<Eigen::Index>(k));
    const NaturalParameters natural = law.natural(x);
    for (std::size_t k = 0; k < x.size(); ++k) parameters[k].push_back(natural.values[k]);
  }
  out.draws = draws;
  for (const std::vector<double>& values : parameters) {
    out.low.push_back(quantile(values, 0.025));
    out.high.push_back(quantile(values, 0.975));
  }
  return out;
}

/// Intervals from the profile likelihood of the whitened chi2. Where a standard error was widened by the
/// spread over runs or by the law of phi, chi2 is divided by the square of that, so that its curvature at
/// the best fit is that of the standard error.
void add_dilation_profiles(LawFit& out, const DilationFit& dilation, const DilationModel& law,
                           const Settled& settled, const Matrix& whitened) {
  const std::vector<double>& best = settled.result.values;
  LeastSquaresProblem problem = dilation.problem().problem(law, dilation.law(), settled.weights, best);
  for (std::size_t k = 0; k < best.size(); ++k) problem.parameters[k].fixed = settled.result.at_bound[k];
  const NaturalParameters natural = law.natural(best);
  for (std::size_t k = 0; k < best.size(); ++k) {
    Estimate& e = out.parameters[k];
    if (e.at_bound || !(e.standard_error > 0)) continue;
    ProfileRequest request;
    request.name = e.name;
    request.quantity = [&law, k](std::span<const double> x, std::span<double> gradient) {
      const NaturalParameters at = law.natural(x);
      std::copy(at.by_coordinate[k].begin(), at.by_coordinate[k].end(), gradient.begin());
      return at.values[k];
    };
    request.standard_error = std::abs(natural.by_coordinate[k][k]) * root(whitened[k][k]);
    const double wider = e.standard_error / request.standard_error;
    request.threshold = out.interval_factor * out.interval_factor * wider * wider;
    const Coordinate& c = law.coordinates()[k];
    const bool logarithm = c.is_logarithm_of(e.name);
    request.lowest = logarithm ? std::exp(c.lower) : c.lower;
    request.highest = logarithm ? std::exp(c.upper) : c.upper;
    Profile profile = profile_likelihood(problem, settled.result.chi2, request);
    for (double& rise : profile.delta_chi2) rise /= wider * wider;
    e.low = profile.low, e.high = profile.high;
    e.open_low = profile.open_low, e.open_high = profile.open_high;
    out.profiles.push_back(std::move(profile));
  }
}

/// By what factor one more run like the mean of a group would lower the variance of each coordinate.
std::vector<double> one_more_run(const RunInformation& runs, const std::vector<std::size_t>& group) {
  std::vector<double> times(runs.runs.size(), 1.0);
  const Eigen::MatrixXd now = runs.normal(times).square.inverse();
  for (const std::size_t r : group) times[r] += 1 / static_cast<double>(group.size());
  const Eigen::MatrixXd then = runs.normal(times).square.inverse();
  std::vector<double> factor;
  for (Eigen::Index k = 0; k < now.rows(); ++k) factor.push_back(then(k, k) / now(k, k));
  return factor;
}

/// How far the steady law of phi, which is held, moves the coordinates: central differences over one standard
/// error of each of its own.
Matrix by_law_of_phi(const DilationFit& dilation, const DilationModel& law, const Settled& settled,
                     const SteadyModel& phi, const std::vector<double>& coordinates,
                     const Matrix& coordinate_covariance) {
  const std::vector<double>& best = settled.result.values;
  Matrix out(best.size(), std::vector<double>(coordinates.size(), 0.0));
  const auto at = [&](std::size_t c, double step) {
    std::vector<double> x = coordinates;
    x[c] += step;
    return solve_least_squares(
               dilation.problem().problem(law, solid_fraction_at(phi, x), settled.weights, best))
        .values;
  };
  for (std::size_t c = 0; c < coordinates.size(); ++c) {
    const double step = root(coordinate_covariance[c][c]);
    if (!(step > 0)) continue;
    const std::vector<double> below = at(c, -step), above = at(c, step);
    for (std::size_t k = 0; k < best.size(); ++k)
      if (!settled.result.at_bound[k]) out[k][c] = (above[k] - below[k]) / (2 * step);
  }
  return out;
}

/// All members with one noise: that which the seeds show, without any law, or what the first fit leaves.
std::vector<LawFit> compare_members(const DilationFit& dilation, const NoiseModel& noise) {
  const TransientProblem::Weights weights = dilation.problem().whitening(noise);
  const double independent = independent_samples(noise, dilation.problem());
  std::vector<LawFit> members;
  for (const std::string& member : dilation_members) {
    try {
      members.push_back(dilation.compare(member, weights, independent));
    } catch (const IdentifiabilityError& error) {  // of one member: the comparison says so
      members.push_back(not_fitted(member, error.what()));
    }
  }
  return members;
}

/// phi_relaxes, the first, unless another one that a flow can run is decisively better.
std::string preferred(const std::vector<LawFit>& members) {
  std::string chosen = members.front().member;
  double least = members.front().AICc - decisive_AICc;
  for (std::size_t k = 1; k < members_of_flows; ++k) {
    const LawFit& other = members[k];
    const bool usable =
        other.failure.empty() && std::none_of(other.parameters.begin(), other.parameters.end(),
                                              [](const Estimate& e) { return e.at_bound; });
    if (usable && other.AICc < least) least = other.AICc, chosen = other.member;
  }
  return chosen;
}

}  // namespace

Matrix fit_dilation(Fit& fit, const SelectedData& selected, const SteadyModel& model,
                    const std::vector<double>& coordinates, const Matrix& coordinate_covariance) {
  const FitOptions& options = fit.options;
  const DilationFit dilation(selected, options, fit.solid_fraction_law());
  const TransientProblem& problem = dilation.problem();

  std::string chosen = options.dilation == "best" ? "phi_relaxes" : options.dilation;
  std::unique_ptr<DilationModel> law = dilation.model(chosen);
  Settled settled = dilation.settle(*law);
  fit.seed_noise = problem.noise_of_seeds(dilation.residuals(*law, settled.result.values, settled.weights),
                                          law->coordinates().size());
  const bool seeds_known = fit.seed_noise.strain_scale > 0;
  if (options.compare) {
    fit.dilation_members = compare_members(dilation, seeds_known ? fit.seed_noise : settled.noise);
    if (options.dilation == "best") chosen = preferred(fit.dilation_members);
    if (chosen != law->name()) {
      law = dilation.model(chosen);
      settled = dilation.settle(*law);
    }
  }
  const std::vector<double>& best = settled.result.values;
  const std::size_t n = best.size();
  const std::vector<bool>& at_bound = settled.result.at_bound;
  const TransientConstants constants = problem.constants(*law, dilation.law(), settled.weights, best, {});
  const std::vector<CorrelatedResiduals> left = problem.residuals(*law, dilation.law(), best, constants);
  const Matrix covariance = problem.covariance(*law, left, settled.weights, at_bound);
  fit.phi_noise = settled.noise;
  fit.whitened_autocorrelation = lag_one(left, settled.weights);

  LawFit& out = fit.dilation;
  out.member = law->name();
  out.coordinates = best;
  out.search = {settled.result.starts,     settled.result.converged,   settled.result.agreed,
                settled.result.iterations, settled.result.termination, settled.result.singular_values,
                settled.reweighted};
  out.chi2 = settled.result.chi2;
  std::size_t samples = 0;
  for (const CorrelatedResiduals& run : left) samples += run.s.size();
  const auto parameters = static_cast<double>(problem.parameters(*law));
  out.degrees_of_freedom = static_cast<double>(samples) - parameters;
  if (!(out.degrees_of_freedom > 0))
    throw IdentifiabilityError("dilation: as many offsets and initial solid fractions as data; add samples");
  out.chi2_per_dof = out.chi2 / out.degrees_of_freedom;
  out.interval_factor =
      student_t_quantile(0.975, std::max(1.0, independent_samples(settled.noise, problem) - parameters));
  for (const LawFit& member : fit.dilation_members)
    if (member.member == out.member) out.AICc = member.AICc, out.BIC = member.BIC;

  const NaturalParameters natural = law->natural(best);
  const Matrix by_phi = by_law_of_phi(dilation, *law, settled, model, coordinates, coordinate_covariance);
  const RunInformation runs = problem.information(*law, dilation.law(), settled.weights, best);
  out.coordinate_covariance = covariance_of_coordinates(fit, runs, settled, covariance);
  const Matrix of_law = propagate(by_phi, coordinate_covariance);
  for (std::size_t a = 0; a < n; ++a)
    for (std::size_t b = 0; b < n; ++b) out.coordinate_covariance[a][b] += of_law[a][b];
  out.covariance = propagate(natural.by_coordinate, out.coordinate_covariance);
  Matrix by_law;  // of the parameters themselves
  for (std::size_t k = 0; k < n; ++k) {
    const std::string& name = law->parameters()[k];
    out.parameters.push_back(estimate_of(name, law->coordinates()[k], natural.values[k], out.covariance[k][k],
                                         out.interval_factor, at_bound[k]));
    by_law.push_back(by_phi[k]);
    for (double& v : by_law.back()) v *= natural.by_coordinate[k][k];
  }
  if (options.profiles) add_dilation_profiles(out, dilation, *law, settled, covariance);
  const std::vector<std::vector<std::size_t>> groups = problem.twins();
  if (!any(at_bound)) out.bootstrap = bootstrap_over_seeds(*law, best, runs, groups, options.bootstrap);

  std::vector<TransientSolution> solutions;
  for (std::size_t r = 0; r < problem.runs().size(); ++r) {
    solutions.push_back(problem.solution(*law, dilation.law(), best, constants, r));
    TransientFit one = seen(*problem.runs()[r].transient, fit, solutions.back());
    one.phi_offset = constants.offset[problem.runs()[r].condition];
    const std::size_t of_phi_0 = n + problem.conditions() + r;
    one.phi_0 =
        symmetric_estimate("phi_0", constants.phi_0[r], covariance[of_phi_0][of_phi_0], out.interval_factor);
    fit.transients.push_back(std::move(one));
  }
  if (seeds_known) {
    fit.transient_checks = check_groups(dilation, *law, settled, constants, fit.seed_noise);
    for (std::size_t g = 0; g < groups.size(); ++g) {
      TransientCheck& check = fit.transient_checks[g];
      add_means(check, fit.transients, groups[g]);
      if (!any(at_bound)) check.one_more_run = one_more_run(runs, groups[g]);
    }
  }
  const BetaInMu shares = regress_mu_on_beta(fit, problem, solutions, n, covariance);
  fit.beta_in_mu = shares.share;
  fit.beta_in_mu_by_kind = shares.by_kind;
  fit.mu_noise = shares.noise;
  return by_law;
}

}  // namespace dem2sph
