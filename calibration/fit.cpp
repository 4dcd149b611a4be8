// From observables to a fitted law: which data, which members, which verdict.
#include "calibration/fit.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <utility>

#include "calibration/data_selection.hpp"
#include "calibration/dilation_fit.hpp"
#include "calibration/estimates.hpp"
#include "calibration/models.hpp"
#include "calibration/steady_fit.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

const std::vector<std::string> friction_members{"rational", "exponential", "power", "linear",
                                                "barker_gray_2017"};
const std::vector<std::string> solid_fraction_members{"linear", "power", "rational"};

/// The member with the lowest AICc, of those that were fitted with no parameter at a bound; null if there is
/// none.
const LawFit* preferred(const std::vector<LawFit>& members) {
  const LawFit* best = nullptr;
  for (const LawFit& law : members) {
    const bool usable = law.failure.empty() && std::isfinite(law.AICc) &&
                        std::none_of(law.parameters.begin(), law.parameters.end(),
                                     [](const Estimate& e) { return e.at_bound; });
    if (usable && (best == nullptr || law.AICc < best->AICc)) best = &law;
  }
  return best;
}

struct Family {
  const char* name;
  std::string wanted;  ///< a member, or "best"
  const std::vector<std::string>& members;
  std::unique_ptr<SteadyModel> (*model)(const std::string&, const ModelBounds&);
};

/// Fits the member that is wanted and, for the comparison, all others. Returns its model.
std::unique_ptr<SteadyModel> fit_family(const Family& family, const std::vector<SteadyDatum>& data,
                                        const ModelBounds& bounds, const FitOptions& options, LawFit& law,
                                        std::vector<LawFit>& members, std::vector<SteadyDatum>& used) {
  std::string chosen = family.wanted;
  const auto fit_member = [&](const std::string& member) {
    std::unique_ptr<SteadyModel> model = family.model(member, bounds);
    SteadyFit candidate = fit_steady(*model, data, family.name, options);
    return std::pair(std::move(model), std::move(candidate));
  };
  std::map<std::string, std::pair<std::unique_ptr<SteadyModel>, SteadyFit>> fits;
  if (options.compare || chosen == "best") {
    std::string reasons;
    for (const std::string& member : family.members) {
      try {
        auto [model, candidate] = fit_member(member);
        candidate.law.cross_validation = cross_validate(candidate, *model, family.name, options);
        members.push_back(candidate.law);
        fits.try_emplace(member, std::move(model), std::move(candidate));
      } catch (const IdentifiabilityError& error) {  // of one member: the comparison says so
        members.push_back(not_fitted(member, error.what()));
        reasons = error.what();
      }
    }
    if (chosen == "best") {
      const LawFit* best = preferred(members);
      // With too few data for a comparison, the member with the fewest parameters is all that can be asked
      // for.
      if (best == nullptr)
        for (const LawFit& candidate : members)
          if (candidate.failure.empty() &&
              (best == nullptr || candidate.parameters.size() < best->parameters.size()))
            best = &candidate;
      if (best == nullptr) throw IdentifiabilityError(reasons);
      chosen = best->member;
    }
  }
  // One that could not be fitted fails here again, with its own message.
  if (!fits.contains(chosen)) fits.emplace(chosen, fit_member(chosen));
  auto& [model, fit] = fits.at(chosen);
  if (options.profiles) add_profiles(fit, *model, family.name);
  add_bootstrap(fit, *model, family.name, options);
  law = std::move(fit.law);
  used = std::move(fit.data);
  return std::move(model);
}

void set_slope(Fit& fit) {
  const double D_star = fit.friction["D_star"].value;
  const double value = (fit.friction["mu_h"].value - fit.friction["mu_l"].value) / D_star;
  const Matrix to{{-1 / D_star, 1 / D_star, -value / D_star}};
  fit.slope = positive_estimate("slope", value, propagate(to, fit.friction.covariance)[0][0],
                                fit.friction.interval_factor);
}

// ---------------------------------------------------------------------------------------------------------------------
// What the data say and do not say
// ---------------------------------------------------------------------------------------------------------------------

std::string interval(const Estimate& e) {
  if (e.at_bound) return fmt::format("{:.4g} (held at a bound)", e.value);
  const auto digits = [&](double value) { return round_to_error(value, e.standard_error); };
  return fmt::format("{} (95 % interval {} to {})", digits(e.value), digits(e.low), digits(e.high));
}

bool open(const Estimate& e) {
  return e.at_bound || e.open_low || e.open_high || !(e.standard_error < 0.5 * std::abs(e.value));
}

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
  const auto known = [&](const LawFit& law) {  // its parameters with their intervals
    std::vector<std::string> list;
    for (const Estimate& e : law.parameters) {
      list.push_back(fmt::format("{} = {}", e.name, interval(e)));
      if (open(e)) unknown.push_back(e.name);
    }
    return fmt::format("{}", fmt::join(list, ", "));
  };
  std::string text;
  const std::string& member = fit.friction.member;
  if (member == "rational" || member == "exponential") {
    const Estimate& mu_l = fit.friction["mu_l"];
    const Estimate& mu_h = fit.friction["mu_h"];
    const Estimate& D_star = fit.friction["D_star"];
    const double reach = fit.I.highest / D_star.value;
    fit.mu_h_and_D_star_known = reach >= 1 && !open(D_star) && !open(mu_h);
    if (fit.mu_h_and_D_star_known) {
      text = fmt::format(
          "The data reach I = {:.3g}, {:.2g} times D*, so all three of the friction law are known: mu_l = "
          "{}, "
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
  } else {
    text = fmt::format("Friction is the {} law: {}", member, known(fit.friction));
  }
  text += fmt::format("; solid fraction ({}) {}", fit.solid_fraction.member, known(fit.solid_fraction));
  if (fit.dilation.member != "none") {
    const auto transients = [](std::size_t n) { return fmt::format("{} transient{}", n, n == 1 ? "" : "s"); };
    text += fmt::format("; dilation ({}) {}", fit.dilation.member, known(fit.dilation));
    text += fmt::format(" from {}", transients(fit.transients.size()));
    const Estimate& s_star = fit.dilation["s_star"];
    if (fit.s.highest < 4 * s_star.value)
      warn(
          fmt::format("the transients end at a strain of {:.3g}, which is {:.2g} s*: shear at least 4 s* to "
                      "tell s* from the final phi",
                      fit.s.highest, fit.s.highest / s_star.value));
    if (fit.transients.size() < 3)
      warn(
          fmt::format("s_star rests on {}: its error cannot be checked against the spread over "
                      "seeds (3 are needed)",
                      transients(fit.transients.size())));
    // Residuals that are left with neighbours alike were not made by the noise model: 0.1 is far beyond the
    // scatter of this number, one over the root of some hundreds of samples.
    if (std::abs(fit.whitened_autocorrelation) > 0.1)
      warn(
          fmt::format("the {} law does not describe all of these transients: whitened residuals have an "
                      "autocorrelation of "
                      "{:.2f}; its strain scales stand for the first decay, no more",
                      fit.dilation.member, fit.whitened_autocorrelation));
    // chi2/dof of a group with hundreds of samples scatters by less than 0.1, so 1.5 is no chance; 90 % of a
    // signal that stands clear of its noise is what a law of dilation is asked for.
    std::vector<std::string> poor;
    for (const TransientCheck& c : fit.transient_checks)
      if (c.chi2_per_dof > 1.5 || (c.signal_to_noise > 3 && c.explained < 0.9))
        poor.push_back(fmt::format(
            "{} to I = {:g}{} (chi2/dof {:.2f}, {:.0f} % explained)", c.kind, c.I_driven,
            c.kind == "start_up" ? fmt::format(", packed with friction {:g}", c.packing_friction) : "",
            c.chi2_per_dof, 100 * c.explained));
    if (!poor.empty())
      warn(fmt::format("dilation: not described to the noise of the seeds: {}", fmt::join(poor, "; ")));
    for (const TransientFit& t : fit.transients)
      if (std::abs(t.phi_offset) >
          0.005) {  // a fifth of the 0.025 by which dense and critical packings differ
        warn(fmt::format("transient {} ends at a phi that differs by {:+.4f} from the steady law at its I",
                         t.run, t.phi_offset));
      }
  } else {
    text += "; no transients, so no law of dilation";
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
  scatter(fit.friction, "friction", "This law or the standard errors are not right for these data.");
  scatter(fit.solid_fraction, "solid fraction",
          "This law or the standard errors are not right for these data.");
  const auto others = [&](const LawFit& chosen, const std::vector<LawFit>& members, const char* name) {
    const LawFit* best = preferred(members);
    // Burnham and Anderson (2002): a member whose AICc is 10 higher has essentially no support beside the
    // other.
    if (best != nullptr && best->AICc < chosen.AICc - 10)
      warn(fmt::format(
          "{}: the {} law describes these data much better than the {} one (AICc lower by {:.1f}, "
          "left-out conditions predicted to {:.2f} % instead of {:.2f} %)",
          name, best->member, chosen.member, chosen.AICc - best->AICc, 100 * best->cross_validation.rms,
          100 * chosen.cross_validation.rms));
  };
  others(fit.friction, fit.friction_members, "friction");
  others(fit.solid_fraction, fit.solid_fraction_members, "solid fraction");
  const auto outliers = [&](const LawFit& law, const char* name) {
    if (!law.downweighted.empty())
      warn(fmt::format("{}: {} of its runs lie so far off the law that they count less: {}", name,
                       law.downweighted.size(), fmt::join(law.downweighted, ", ")));
  };
  outliers(fit.friction, "friction");
  outliers(fit.solid_fraction, "solid fraction");
  for (const LawFit* law : {&fit.friction, &fit.solid_fraction, &fit.dilation})
    for (const Profile& p : law->profiles)
      if (p.open_low || p.open_high)
        warn(fmt::format("the profile of {} is open {}: no {} value is refused by these data", p.name,
                         p.open_low && p.open_high ? "on both sides"
                         : p.open_low              ? "below"
                                                   : "above",
                         p.open_low && p.open_high ? ""
                         : p.open_low              ? "smaller"
                                                   : "larger"));
  warn_of_evidence(fit);
  std::vector<std::string> shares;
  bool apart = false;
  for (const Estimate& a : fit.beta_in_mu_by_kind) {
    shares.push_back(fmt::format("{:.2f} +- {:.2f} in {}s", a.value, a.standard_error, a.name));
    for (const Estimate& b : fit.beta_in_mu_by_kind) apart = apart || a.high < b.low;
  }
  if (apart)
    warn(fmt::format(
        "the share of beta that shows in mu is not the same in all kinds of transients ({}); the law "
        "carries {:.2f} +- {:.2f} for all",
        fmt::join(shares, ", "), fit.beta_in_mu.value, fit.beta_in_mu.standard_error));
  if (!fit.beta_in_mu.name.empty() && fit.beta_in_mu.high < 0)
    warn(fmt::format("beta shows in mu with the wrong sign ({:.2f} +- {:.2f}); the law carries a share of 0",
                     fit.beta_in_mu.value, fit.beta_in_mu.standard_error));

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
  for (const Observables& o : observables) fit.core_seconds += o.cpu_seconds();
  fit.options = options;
  fit.excluded = selected.excluded;
  const ModelBounds bounds{options.mu_max, options.D_star_min, options.D_star_max, options.b_max};
  const std::unique_ptr<SteadyModel> friction =
      fit_family({"friction", options.friction, friction_members, friction_model}, selected.friction, bounds,
                 options, fit.friction, fit.friction_members, fit.friction_data);
  const std::unique_ptr<SteadyModel> solid_fraction =
      fit_family({"solid fraction", options.solid_fraction, solid_fraction_members, solid_fraction_model},
                 selected.solid_fraction, bounds, options, fit.solid_fraction, fit.solid_fraction_members,
                 fit.solid_fraction_data);
  if (fit.friction.member == "rational" || fit.friction.member == "exponential") set_slope(fit);

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

  const LawFit* steady[] = {&fit.friction, &fit.solid_fraction};
  for (const LawFit* law : steady)
    for (const Estimate& e : law->parameters) fit.covariance_names.push_back(e.name);
  const std::size_t of_friction = fit.friction.parameters.size();
  const std::size_t count = fit.covariance_names.size();
  fit.covariance.assign(count, std::vector<double>(count, 0.0));
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t k = 0; k < count; ++k)
      if ((i < of_friction) == (k < of_friction))
        fit.covariance[i][k] = i < of_friction
                                   ? fit.friction.covariance[i][k]
                                   : fit.solid_fraction.covariance[i - of_friction][k - of_friction];

  fit.dilation.member = "none";
  if (!selected.transients.empty()) {
    const Matrix by_coordinate = fit_dilation(fit, selected, *solid_fraction, fit.solid_fraction.coordinates,
                                              fit.solid_fraction.coordinate_covariance);
    // They see the steady law of phi: cov(parameter of dilation, parameter of phi) = g C J^T, with g the
    // derivatives by the coordinates of the law of phi.
    const NaturalParameters natural = solid_fraction->natural(fit.solid_fraction.coordinates);
    const Matrix& c = fit.solid_fraction.coordinate_covariance;
    const std::size_t of_dilation = fit.dilation.parameters.size();
    for (const Estimate& e : fit.dilation.parameters) fit.covariance_names.push_back(e.name);
    for (std::vector<double>& row : fit.covariance) row.resize(count + of_dilation, 0.0);
    fit.covariance.resize(count + of_dilation, std::vector<double>(count + of_dilation, 0.0));
    for (std::size_t k = 0; k < of_dilation; ++k) {
      for (std::size_t m = 0; m < of_dilation; ++m)
        fit.covariance[count + k][count + m] = fit.dilation.covariance[k][m];
      for (std::size_t i = of_friction; i < count; ++i) {
        double sum = 0;
        for (std::size_t a = 0; a < c.size(); ++a)
          for (std::size_t b = 0; b < c.size(); ++b)
            sum += by_coordinate[k][a] * c[a][b] * natural.by_coordinate[i - of_friction][b];
        fit.covariance[count + k][i] = fit.covariance[i][count + k] = sum;
      }
    }
  }
  judge(fit);
  return fit;
}

namespace {

Prediction predict(const LawFit& law, const SteadyModel& model, double I) {
  ModelValue value;
  if (!model.evaluate(law.coordinates, I, value))
    throw NumericalError(fmt::format("the fitted {} law has no value at I = {:g}", law.member, I));
  const double error =
      std::sqrt(std::max(0.0, propagate({value.by_coordinate}, law.coordinate_covariance)[0][0]));
  const double half = law.interval_factor * error;
  return {value.value, error, value.value - half, value.value + half};
}

}  // namespace

Prediction predict_friction(const Fit& fit, double I) {
  return predict(fit.friction, *friction_model(fit.friction.member, {}), I);
}
Prediction predict_solid_fraction(const Fit& fit, double I) {
  return predict(fit.solid_fraction, *solid_fraction_model(fit.solid_fraction.member, {}), I);
}

}  // namespace dem2sph
