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

std::map<std::string, double> seconds_of_runs(const std::vector<Observables>& observables) {
  std::map<std::string, double> seconds;
  for (const Observables& o : observables)
    for (const RunCost& cost : o.costs) seconds[cost.run] += cost.cpu_seconds;
  return seconds;
}

/// The law of dilation: each parameter by its information, 1/variance, to which every further run adds.
class KnownDilation {
 public:
  KnownDilation(const std::vector<Observables>& observables, const Fit& fit) : fit_(fit) {
    const std::map<std::string, double> seconds = seconds_of_runs(observables);
    for (const TransientCheck& c : fit.transient_checks) {
      if (c.one_more_run.empty()) continue;
      Group group{&c, 0, c.seeds};
      for (const std::string& run : c.runs)
        if (const auto found = seconds.find(run); found != seconds.end())
          group.cost += found->second / static_cast<double>(c.seeds);
      if (group.cost > 0) groups_.push_back(group);
    }
    for (const Estimate& e : fit.dilation.parameters) {
      const double relative = e.value != 0 ? e.standard_error / std::abs(e.value) : 0;
      variance_.push_back(relative * relative);
    }
    start_ = variance_;
  }

  /// Relative errors of the parameters that more runs could tell; the others are 0.
  std::vector<double> relative_errors() const {
    std::vector<double> errors;
    for (double v : variance_) errors.push_back(groups_.empty() ? 0 : std::sqrt(v));
    return errors;
  }

  /// The best group for parameter k. A rate of 0 means that none tells anything of it.
  SuggestedRun best(std::size_t k) const {
    SuggestedRun out;
    double best_rate = 0;
    for (const Group& g : groups_) {
      const double after = with(g, k);
      const double rate = (variance_[k] - after) / g.cost;
      if (!(rate > best_rate)) continue;
      best_rate = rate;
      const TransientCheck& c = *g.check;
      out.kind = c.kind;
      out.I_driven = c.I_driven, out.I_before = c.I_before, out.load = c.load;
      out.packing_friction = c.packing_friction;
      out.seeds_there = g.seeds, out.core_seconds = g.cost;
      out.worst = fit_.dilation.parameters[k].name;
      out.error_before = std::sqrt(variance_[k]), out.error_after = std::sqrt(after);
      out.log_det = 0;
      for (std::size_t j = 0; j < variance_.size(); ++j) out.log_det += std::log(variance_[j] / with(g, j));
    }
    return out;
  }

  void add(const SuggestedRun& run) {
    for (Group& g : groups_) {
      const TransientCheck& c = *g.check;
      if (c.kind != run.kind || c.I_driven != run.I_driven || c.I_before != run.I_before ||
          c.load != run.load || c.packing_friction != run.packing_friction)
        continue;
      for (std::size_t k = 0; k < variance_.size(); ++k) variance_[k] = with(g, k);
      ++g.seeds;
      return;
    }
  }

 private:
  struct Group {
    const TransientCheck* check;
    double cost;
    long seeds;
  };
  /// What one more run adds to the information of the start, of which it is a known share.
  double with(const Group& g, std::size_t k) const {
    if (!(variance_[k] > 0)) return variance_[k];
    const double added = (1 / g.check->one_more_run[k] - 1) / start_[k];
    return 1 / (1 / variance_[k] + added);
  }
  const Fit& fit_;
  std::vector<Group> groups_;
  std::vector<double> variance_, start_;
};

}  // namespace

RunModel::RunModel(const std::vector<Observables>& observables, const Fit& fit) {
  const std::map<std::string, double> seconds = seconds_of_runs(observables);
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
  KnownDilation dilation(observables, fit);
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
    const std::vector<double> of_dilation = dilation.relative_errors();
    const auto worst_of_dilation = std::max_element(of_dilation.begin(), of_dilation.end());
    if (worst_of_dilation != of_dilation.end() && *worst_of_dilation > error) {
      const SuggestedRun run =
          dilation.best(static_cast<std::size_t>(worst_of_dilation - of_dilation.begin()));
      if (run.core_seconds == 0) break;  // no transient that was made tells anything of it
      dilation.add(run);
      out.push_back(run);
      continue;
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
      best = {"steady",
              I,
              0,
              0,
              0,
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

std::string describe(const std::vector<SuggestedRun>& runs) {
  std::string text = fmt::format("{:>13} {:>9} {:>6} {:>6} {:>13}  {}\n", "kind", "driven I", "packed",
                                 "seed", "core-seconds", "made for: relative error before, after");
  double cost = 0;
  /// A case file has one list of seeds a section: runs that are alike but for the seed make one.
  std::map<std::string, std::vector<long>> sections;
  for (const SuggestedRun& run : runs) {
    text += fmt::format("{:>13} {:9.4g} {:>6} {:6} {:13.3g}  {} {:.2f} %, {:.2f} %\n", run.kind, run.I_driven,
                        run.kind == "start_up" ? fmt::format("{:g}", run.packing_friction) : "",
                        run.seeds_there + 1, run.core_seconds, run.worst, 100 * run.error_before,
                        100 * run.error_after);
    cost += run.core_seconds;
    std::string section = fmt::format("[shear_cell.{}]\n", run.kind);
    // The pressure of a pressure jump changes I: what was driven before is what the section asks for.
    if (run.kind != "pressure_jump") section += fmt::format("I = [{:g}]\n", run.I_driven);
    if (run.kind == "start_up") section += fmt::format("packing_friction = [{:g}]\n", run.packing_friction);
    if (run.kind == "jump" || run.kind == "pressure_jump")
      section += fmt::format("I_before = [{:g}]\n", run.I_before);
    if (run.kind == "pressure_jump") section += fmt::format("pressure = [\"{:g} Pa\"]\n", run.load);
    sections[section].push_back(run.seeds_there + 1);
  }
  text += fmt::format("together {:.3g} core-seconds, without packing new samples\n", cost);
  if (sections.size() > 1)
    text += "\nEach section in a case file of its own, with the strains and frames of the first sweep:\n";
  for (const auto& [section, seeds] : sections)
    text += fmt::format("\n{}seeds = [{}]\n", section, fmt::join(seeds, ", "));
  return text;
}

}  // namespace dem2sph
