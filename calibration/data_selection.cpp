#include "calibration/data_selection.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <utility>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

void check_same_material(const std::vector<Observables>& observables) {
  if (observables.empty()) throw InputError("no observables were given to fit");
  const Observables& first = observables.front();
  for (const Observables& o : observables) {
    const auto compare = [&](double a, double b, const char* what) {
      if (!(a == b))
        throw InputError(fmt::format(
            "the observables are of two materials: {} is {:g} in one and {:g} in another; fit them apart",
            what, a, b));
    };
    compare(first.d, o.d, "d [m]");
    compare(first.rho_s, o.rho_s, "rho_s [kg/m^3]");
    compare(first.grain_friction, o.grain_friction, "the friction of the grains");
    if (!(o.d > 0 && std::isfinite(o.d) && o.rho_s > 0 && std::isfinite(o.rho_s)))
      throw InputError(fmt::format("d = {} m and rho_s = {} kg/m^3 must be positive", o.d, o.rho_s));
  }
}

void check_point(const SteadyPoint& point) {
  const auto value = [&](double v, const char* name) {
    if (!std::isfinite(v))
      throw InputError(fmt::format("run {}: {} is {}, not a number", point.run, name, v));
  };
  const auto error = [&](double v, const char* name) {
    if (!(v > 0 && std::isfinite(v)))
      throw InputError(fmt::format(
          "run {}: the standard error of {} is {}; a datum without a positive error has no weight", point.run,
          name, v));
  };
  value(point.I, "I"), value(point.mu, "mu"), value(point.phi, "phi"), value(point.p, "p");
  value(point.wall_mu, "wall_mu"), value(point.I_driven, "I_driven"), value(point.phi_drift, "phi_drift");
  if (!(point.I >= 0)) throw InputError(fmt::format("run {}: I = {:g} is negative", point.run, point.I));
  error(point.I_se, "I"), error(point.mu_se, "mu"), error(point.phi_se, "phi");
}

void check_transient(const Transient& t) {
  const std::size_t n = t.s.size();
  if (n < 10) throw InputError(fmt::format("transient {}: {} samples are too few, 10 are needed", t.run, n));
  const std::pair<const char*, const std::vector<double>*> lists[] = {
      {"s", &t.s},     {"gamma_dot", &t.gamma_dot}, {"p", &t.p},          {"mu", &t.mu}, {"I", &t.I},
      {"phi", &t.phi}, {"beta", &t.beta},           {"height", &t.height}};
  for (const auto& [name, list] : lists) {
    if (list->size() != n)
      throw InputError(
          fmt::format("transient {}: {} has {} samples and s has {}", t.run, name, list->size(), n));
    for (std::size_t i = 0; i < n; ++i)
      if (!std::isfinite((*list)[i]))
        throw InputError(fmt::format("transient {}: {} is not a number at sample {}", t.run, name, i));
  }
  for (std::size_t i = 0; i < n; ++i) {
    if (!(t.s[i] > (i == 0 ? -1e-300 : t.s[i - 1])))
      throw InputError(fmt::format("transient {}: the strain does not grow at sample {}", t.run, i));
    if (!(t.I[i] >= 0)) throw InputError(fmt::format("transient {}: I is negative at sample {}", t.run, i));
    if (!(t.phi[i] > 0 && t.phi[i] < 1))
      throw InputError(
          fmt::format("transient {}: phi = {:g} at sample {} is no solid fraction", t.run, t.phi[i], i));
  }
  if (!(t.phi_0 > 0 && t.phi_0 < 1))
    throw InputError(fmt::format("transient {}: phi_0 = {:g} is no solid fraction", t.run, t.phi_0));
}

double standard_deviation(const std::vector<double>& values) {
  double mean = 0;
  for (double v : values) mean += v / static_cast<double>(values.size());
  double squares = 0;
  for (double v : values) squares += (v - mean) * (v - mean);
  return std::sqrt(squares / static_cast<double>(values.size() - 1));
}

}  // namespace

SelectedData select_data(const std::vector<Observables>& observables, const FitOptions& options) {
  check_same_material(observables);
  SelectedData selected;

  // Runs of one condition differ by their seed alone: the spread over them is a lower bound of the error of
  // each.
  struct Spread {
    std::vector<double> I, mu, phi;
  };
  using Condition = std::pair<double, double>;  // driven I, set pressure
  std::map<Condition, Spread> spreads;
  for (const Observables& o : observables)
    for (const SteadyPoint& point : o.steady) {
      check_point(point);
      Spread& spread = spreads[{point.I_driven, o.pressure}];
      spread.I.push_back(point.I);
      spread.mu.push_back(point.mu);
      spread.phi.push_back(point.phi);
    }

  for (const Observables& o : observables) {
    selected.excluded.insert(selected.excluded.end(), o.excluded.begin(), o.excluded.end());
    for (const SteadyPoint& point : o.steady) {
      const Spread& spread = spreads.at({point.I_driven, o.pressure});
      const auto seeds = [](const std::vector<double>& values) {
        return values.size() > 1 ? standard_deviation(values) : 0.0;
      };
      if (point.wall_mu != 0 && std::abs(point.wall_mu / point.mu - 1) > options.wall_disagreement) {
        selected.excluded.push_back(
            {point.run,
             fmt::format("friction at the wall is {:.3f}, in the core {:.3f}: no homogeneous steady flow",
                         point.wall_mu, point.mu)});
        continue;
      }
      SteadyDatum datum;
      datum.run = point.run;
      datum.seed = point.seed;
      datum.I_driven = point.I_driven;
      datum.phi_drift = point.phi_drift;
      datum.p = point.p;
      datum.order = 1 + static_cast<long>(&point - o.steady.data());
      datum.I = point.I;
      datum.I_se = std::max({point.I_se, seeds(spread.I), options.I_floor * point.I});
      if (point.I <= options.friction_I_max) {
        datum.value = point.mu;
        datum.flat = point.mu_flat && point.I_flat;
        datum.value_se = std::max({point.mu_se, seeds(spread.mu), options.mu_floor});
        selected.friction.push_back(datum);
      } else {
        selected.excluded.push_back(
            {point.run, fmt::format("friction: I = {:.3g} is above friction_I_max = {:g}", point.I,
                                    options.friction_I_max)});
      }
      if (point.I <= options.phi_I_max) {
        datum.value = point.phi;
        datum.flat = point.phi_flat && point.I_flat;
        datum.value_se = std::max({point.phi_se, seeds(spread.phi), options.phi_floor});
        selected.solid_fraction.push_back(datum);
      } else {
        selected.excluded.push_back(
            {point.run, fmt::format("solid fraction: I = {:.3g} is above phi_I_max = {:g}", point.I,
                                    options.phi_I_max)});
      }
    }
  }

  // Runs that end in the same steady state after the same kind of change share the offset of phi_eq.
  using Change = std::tuple<std::string, double, double, double, double>;
  std::map<Change, std::size_t> conditions;
  for (const Observables& o : observables)
    for (const Transient& t : o.transients) {
      check_transient(t);
      if (options.dilation == "none") {
        selected.excluded.push_back({t.run, "transient: dilation = \"none\" was asked for"});
        continue;
      }
      if (t.kind == "reversal") {
        selected.excluded.push_back({t.run,
                                     "transient: a reversal turns the contacts' directions around, which phi "
                                     "alone does not describe"});
        continue;
      }
      const Change change{t.kind, t.I_driven, t.I_before, t.load, t.load_before};
      const std::size_t condition = conditions.try_emplace(change, conditions.size()).first->second;
      selected.transients.push_back({&t, condition});
    }
  selected.conditions = conditions.size();
  return selected;
}

}  // namespace dem2sph
