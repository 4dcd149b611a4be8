#include "calibration/suggest.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

#include "calibration/models.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

Eigen::MatrixXd to_eigen(const Matrix& m) {
  const auto n = static_cast<Eigen::Index>(m.size());
  Eigen::MatrixXd out(n, n);
  for (Eigen::Index a = 0; a < n; ++a)
    for (Eigen::Index b = 0; b < n; ++b)
      out(a, b) = m[static_cast<std::size_t>(a)][static_cast<std::size_t>(b)];
  return out;
}

/// One of the two steady laws with the covariance of its coordinates, which shrinks as runs are added.
struct Known {
  std::unique_ptr<SteadyModel> model;
  const LawFit* law = nullptr;
  Eigen::MatrixXd covariance;

  Eigen::VectorXd gradient(double I) const {
    ModelValue value;
    if (!model->evaluate(law->coordinates, I, value))
      throw NumericalError(fmt::format("the fitted {} law has no value at I = {:g}", law->member, I));
    return Eigen::Map<const Eigen::VectorXd>(value.by_coordinate.data(),
                                             static_cast<Eigen::Index>(value.by_coordinate.size()));
  }
  /// After one more datum at I with the error `se`.
  Eigen::MatrixXd with(double I, double se) const {
    const Eigen::VectorXd g = gradient(I), cg = covariance * g;
    return covariance - cg * cg.transpose() / (se * se + g.dot(cg));
  }
  double log_det_gain(double I, double se) const {
    const Eigen::VectorXd g = gradient(I);
    return std::log1p(g.dot(covariance * g) / (se * se));
  }
  /// Relative errors of the parameters; 0 for those at a bound.
  std::vector<double> relative_errors(const Eigen::MatrixXd& c) const {
    const NaturalParameters natural = model->natural(law->coordinates);
    std::vector<double> errors;
    for (std::size_t k = 0; k < natural.values.size(); ++k) {
      const Eigen::VectorXd j = Eigen::Map<const Eigen::VectorXd>(natural.by_coordinate[k].data(), c.rows());
      errors.push_back(std::sqrt(std::max(0.0, j.dot(c * j))) / std::abs(natural.values[k]));
    }
    return errors;
  }
};

}  // namespace

RunModel::RunModel(const std::vector<Observables>& observables, const Fit& fit) {
  std::map<std::string, double> seconds;
  for (const Observables& o : observables)
    for (const RunCost& cost : o.costs) seconds[cost.run] += cost.cpu_seconds;
  struct Sums {
    double cost = 0, mu = 0, phi = 0, costs = 0, mus = 0, phis = 0;
  };
  std::map<double, Sums> sums;
  for (const SteadyDatum& d : fit.friction_data) {
    Sums& s = sums[d.I_driven];
    s.mu += d.plain_se, ++s.mus;
    if (const auto found = seconds.find(d.run); found != seconds.end()) s.cost += found->second, ++s.costs;
  }
  for (const SteadyDatum& d : fit.solid_fraction_data) {
    Sums& s = sums[d.I_driven];
    s.phi += d.plain_se, ++s.phis;
  }
  for (const auto& [I, s] : sums)
    if (s.costs > 0 && s.cost > 0 && s.phis > 0)
      nodes_.push_back(
          {std::log(I), std::log(s.cost / s.costs), std::log(s.mu / s.mus), std::log(s.phi / s.phis)});
  if (nodes_.empty())
    throw InputError("the observables say of no steady run what it cost; make them with dem2sph sweep");
}

double RunModel::at(double I, double Node::*what) const {
  const double x = std::log(I);
  if (x <= nodes_.front().log_I) return nodes_.front().*what;
  for (std::size_t k = 1; k < nodes_.size(); ++k)
    if (x <= nodes_[k].log_I) {
      const double w = (x - nodes_[k - 1].log_I) / (nodes_[k].log_I - nodes_[k - 1].log_I);
      return (1 - w) * (nodes_[k - 1].*what) + w * (nodes_[k].*what);
    }
  return nodes_.back().*what;
}

double RunModel::core_seconds(double I) const {
  const double below = std::min(0.0, std::log(I) - nodes_.front().log_I);
  return std::exp(at(I, &Node::log_cost) - below);
}
double RunModel::mu_se(double I) const { return std::exp(at(I, &Node::log_mu_se)); }
double RunModel::phi_se(double I) const { return std::exp(at(I, &Node::log_phi_se)); }

std::vector<SuggestedRun> suggest_runs(const std::vector<Observables>& observables, const Fit& fit,
                                       long count, double I_max) {
  const RunModel runs(observables, fit);
  const ModelBounds bounds{fit.options.mu_max, fit.options.D_star_min, fit.options.D_star_max,
                           fit.options.b_max};
  Known friction{friction_model(fit.friction.member, bounds), &fit.friction,
                 to_eigen(fit.friction.coordinate_covariance)};
  Known solid{solid_fraction_model(fit.solid_fraction.member, bounds), &fit.solid_fraction,
              to_eigen(fit.solid_fraction.coordinate_covariance)};
  std::map<double, long> there;
  for (const SteadyDatum& d : fit.friction_data) ++there[d.I_driven];
  // The conditions that exist, and between and above them twelve a decade.
  std::vector<double> candidates;
  for (const auto& [I, n] : there) candidates.push_back(I);
  const double lowest = candidates.front();
  for (int k = 0;; ++k) {
    const double I = lowest * std::pow(10, k / 12.0);
    if (I > I_max * (1 + 1e-12)) break;
    const bool close = std::any_of(candidates.begin(), candidates.end(), [&](double other) {
      return std::abs(std::log(I / other)) < 0.5 * std::log(10) / 12;
    });
    if (!close) candidates.push_back(std::stod(fmt::format("{:.2g}", I)));
  }
  std::erase_if(candidates, [&](double I) { return I > I_max; });
  if (candidates.empty())
    throw UsageError(fmt::format("I_max = {:g} is below every I that was run, {:g} and more", I_max, lowest));

  std::vector<SuggestedRun> out;
  for (long n = 0; n < count; ++n) {
    Known* worst_law = &friction;
    std::size_t worst = 0;
    double error = 0;
    for (Known* known : {&friction, &solid}) {
      const std::vector<double> errors = known->relative_errors(known->covariance);
      for (std::size_t k = 0; k < errors.size(); ++k)
        if (errors[k] > error) error = errors[k], worst = k, worst_law = known;
    }
    SuggestedRun best;
    double best_rate = 0;
    for (const double I : candidates) {
      const double se = worst_law == &friction ? runs.mu_se(I) : runs.phi_se(I);
      const double after = worst_law->relative_errors(worst_law->with(I, se))[worst];
      const double cost = runs.core_seconds(I);
      const double rate = (error * error - after * after) / cost;
      if (!(rate > best_rate)) continue;
      best_rate = rate;
      best = {I,
              there.contains(I) ? there[I] : 0,
              cost,
              runs.mu_se(I),
              runs.phi_se(I),
              worst_law->model->parameters()[worst],
              error,
              after,
              friction.log_det_gain(I, runs.mu_se(I)) + solid.log_det_gain(I, runs.phi_se(I))};
    }
    if (best_rate == 0) break;  // no run at these I tells anything of it
    friction.covariance = friction.with(best.I_driven, best.mu_se);
    solid.covariance = solid.with(best.I_driven, best.phi_se);
    ++there[best.I_driven];
    out.push_back(best);
  }
  return out;
}

std::string describe(const std::vector<SuggestedRun>& runs, const Fit& fit) {
  std::string text = fmt::format("{:>9} {:>6} {:>13} {:>9} {:>9}  {}\n", "driven I", "seed", "core-seconds",
                                 "se(mu)", "se(phi)", "made for: relative error before, after");
  double cost = 0;
  std::map<double, std::vector<long>> seeds;
  for (const SuggestedRun& run : runs) {
    text += fmt::format("{:9.4g} {:6} {:13.3g} {:9.2g} {:9.2g}  {} {:.2f} %, {:.2f} %\n", run.I_driven,
                        run.seeds_there + 1, run.core_seconds, run.mu_se, run.phi_se, run.worst,
                        100 * run.error_before, 100 * run.error_after);
    cost += run.core_seconds;
    seeds[run.I_driven].push_back(run.seeds_there + 1);
  }
  text += fmt::format("together {:.3g} core-seconds, without packing new samples\n", cost);
  for (const Estimate& e : fit.dilation.parameters)
    if (e.value != 0 && !runs.empty() && e.standard_error / std::abs(e.value) > runs.front().error_before)
      text += fmt::format(
          "{} is known worse than any of these ({:.1f} %): more seeds of start-ups and jumps would tell it\n",
          e.name, 100 * e.standard_error / std::abs(e.value));
  // A case file has one list of I and one of seeds: conditions with the same seeds share a file.
  std::map<std::vector<long>, std::vector<double>> sections;
  for (const auto& [I, list] : seeds) sections[list].push_back(I);
  if (sections.size() > 1) text += "\nEach section in a case file of its own:\n";
  for (const auto& [list, I] : sections)
    text += fmt::format("\n[shear_cell.steady]\nI = [{:g}]\nseeds = [{}]\n", fmt::join(I, ", "),
                        fmt::join(list, ", "));
  return text;
}

}  // namespace dem2sph
