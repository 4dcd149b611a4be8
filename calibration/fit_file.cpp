// law.json and fit.json, and the small parts of a Fit that need no solver.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calibration/fit.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;

json estimate_to_json(const Estimate& e) {
  return {{"name", e.name},
          {"value", e.value},
          {"standard_error", e.standard_error},
          {"interval_95", {e.low, e.high}},
          {"open_low", e.open_low},
          {"open_high", e.open_high},
          {"unit", "1"},
          {"at_bound", e.at_bound}};
}

json noise_to_json(const NoiseModel& noise) {
  return {{"wander_sd", noise.wander_sd}, {"strain_scale", noise.strain_scale}, {"white_sd", noise.white_sd}};
}

json law_to_json(const LawFit& law) {
  if (!law.failure.empty()) return {{"member", law.member}, {"failure", law.failure}};
  json profiles = json::array();
  for (const Profile& p : law.profiles)
    profiles.push_back({{"name", p.name},
                        {"value", p.value},
                        {"interval_95", {p.low, p.high}},
                        {"open_low", p.open_low},
                        {"open_high", p.open_high},
                        {"values", p.values},
                        {"delta_chi2", p.delta_chi2}});
  json conditions = json::array();
  for (const CrossValidation::Condition& c : law.cross_validation.conditions)
    conditions.push_back(
        {{"I_driven", c.I_driven}, {"mean", c.mean}, {"predicted", c.predicted}, {"error", c.error}});
  json parameters = json::array();
  for (const Estimate& e : law.parameters) parameters.push_back(estimate_to_json(e));
  const Search& search = law.search;
  return {{"member", law.member},
          {"parameters", parameters},
          {"covariance", law.covariance},
          {"chi2", law.chi2},
          {"degrees_of_freedom", law.degrees_of_freedom},
          {"chi2_per_dof", law.chi2_per_dof},
          {"error_scale", law.error_scale},
          {"interval_factor", law.interval_factor},
          {"AICc", std::isfinite(law.AICc) ? json(law.AICc) : json(nullptr)},
          {"BIC", law.BIC},
          {"cross_validation",
           {{"rms", law.cross_validation.rms},
            {"largest", law.cross_validation.largest},
            {"conditions", conditions}}},
          {"profiles", profiles},
          {"bootstrap",
           {{"draws", law.bootstrap.draws},
            {"low", law.bootstrap.low},
            {"high", law.bootstrap.high},
            {"I", law.bootstrap.I},
            {"band_low", law.bootstrap.band_low},
            {"band_high", law.bootstrap.band_high}}},
          {"downweighted", law.downweighted},
          {"search",
           {{"starts", search.starts},
            {"converged", search.converged},
            {"agreed", search.agreed},
            {"iterations", search.iterations},
            {"reweighted", search.reweighted},
            {"termination", search.termination},
            {"singular_values", search.singular_values}}}};
}

json members_to_json(const std::vector<LawFit>& members) {
  json list = json::array();
  for (const LawFit& law : members) list.push_back(law_to_json(law));
  return list;
}

json checks_to_json(const std::vector<TransientCheck>& checks) {
  json list = json::array();
  for (const TransientCheck& c : checks) {
    list.push_back({{"kind", c.kind},
                    {"I_before", c.I_before},
                    {"I_driven", c.I_driven},
                    {"load_before", c.load_before},
                    {"load", c.load},
                    {"packing_friction", c.packing_friction},
                    {"seeds", c.seeds},
                    {"signal_to_noise", c.signal_to_noise},
                    {"chi2_per_dof", c.chi2_per_dof},
                    {"explained", c.explained},
                    {"s", c.s},
                    {"phi", c.phi},
                    {"phi_fit", c.phi_fit}});
    if (c.predicted)
      list.back()["left_out"] = {{"chi2_per_dof", c.predicted_chi2_per_dof},
                                 {"explained", c.predicted_explained}};
  }
  return list;
}

json data_to_json(const std::vector<SteadyDatum>& data) {
  json list = json::array();
  for (const SteadyDatum& d : data)
    list.push_back({{"run", d.run},
                    {"seed", d.seed},
                    {"I_driven", d.I_driven},
                    {"I", d.I},
                    {"I_se", d.I_se},
                    {"value", d.value},
                    {"value_se", d.value_se},
                    {"plain_se", d.plain_se},
                    {"weight", d.weight},
                    {"p", d.p},
                    {"flat", d.flat},
                    {"phi_drift", d.phi_drift},
                    {"fitted", d.fitted},
                    {"residual", d.residual}});
  return list;
}

FittedLaw fitted_law(const LawFit& law) {
  FittedLaw out;
  out.member = law.member;
  out.chi2_per_dof = law.chi2_per_dof;
  for (const Estimate& e : law.parameters)
    out.parameters.push_back({e.name, e.value, e.standard_error, "1", e.at_bound});
  return out;
}

json sources(const Fit& fit, std::span<const std::filesystem::path> observables) {
  json out = provenance();
  out["observables"] = json::array();
  for (const std::filesystem::path& path : observables)
    out["observables"].push_back({{"path", path.string()}, {"sha256", sha256_of_file(path)}});
  json runs = json::array();
  for (const SteadyDatum& d : fit.friction_data) runs.push_back(d.run);
  for (const SteadyDatum& d : fit.solid_fraction_data)
    if (std::find(runs.begin(), runs.end(), json(d.run)) == runs.end()) runs.push_back(d.run);
  for (const TransientFit& t : fit.transients) runs.push_back(t.run);
  out["runs"] = runs;
  out["engine"] = fit.engine;
  out["core_seconds"] = fit.core_seconds;
  out["grain_friction"] = fit.grain_friction;
  out["material"] = fit.material;
  return out;
}

}  // namespace

FitOptions FitOptions::from(const Section& section) {
  FitOptions o;
  o.friction = section.word("friction");
  o.solid_fraction = section.word("solid_fraction");
  o.robust = section.flag("robust");
  o.compare = section.flag("compare");
  o.profiles = section.flag("profiles");
  o.bootstrap = section.integer("bootstrap");
  o.friction_I_max = section.number("friction_I_max");
  o.phi_I_max = section.number("phi_I_max");
  o.wall_disagreement = section.number("wall_disagreement");
  o.mu_floor = section.number("mu_floor");
  o.phi_floor = section.number("phi_floor");
  o.I_floor = section.number("I_floor");
  o.D_star_min = section.number("D_star_min");
  o.D_star_max = section.number("D_star_max");
  o.mu_max = section.number("mu_max");
  o.b_max = section.number("b_max");
  o.dilation = section.word("dilation");
  o.s_star_min = section.number("s_star_min");
  o.s_star_max = section.number("s_star_max");
  o.bins = section.integer("bins");
  o.mu_from_strain = section.number("mu_from_strain");
  o.starts = section.integer("starts");
  o.strict = section.flag("strict");
  if (!(o.D_star_min < o.D_star_max)) section.refuse("D_star_max", "D_star_max must be above D_star_min");
  if (!(o.s_star_min < o.s_star_max)) section.refuse("s_star_max", "s_star_max must be above s_star_min");
  return o;
}

const Estimate& LawFit::operator[](std::string_view name) const {
  for (const Estimate& e : parameters)
    if (e.name == name) return e;
  throw Error(ExitCode::bug, fmt::format("the fitted {} law has no parameter \"{}\"", member, name));
}

FrictionLaw Fit::friction_law() const {
  const auto law =
      law_by_name<FrictionLaw>(friction.member, [&](const char* name) { return friction[name].value; });
  if (!law) throw Error(ExitCode::bug, fmt::format("unknown friction law \"{}\"", friction.member));
  return *law;
}

SteadySolidFraction Fit::solid_fraction_law() const {
  const auto law = law_by_name<decltype(SteadySolidFraction::law)>(
      solid_fraction.member, [&](const char* name) { return solid_fraction[name].value; });
  if (!law)
    throw Error(ExitCode::bug, fmt::format("unknown solid fraction law \"{}\"", solid_fraction.member));
  return {*law};
}

double Fit::steady_friction_at(double at) const {
  return std::visit([at](const auto& law) { return steady_friction(law, at, 0.0); }, friction_law());
}

std::string list_of(const LawFit& law) {
  std::string text;
  for (const Estimate& e : law.parameters)
    text += fmt::format("{}{} = {}", text.empty() ? "" : ", ", e.name,
                        e.at_bound ? fmt::format("{:.4g} (at a bound)", e.value)
                                   : fmt::format("{} +- {}", round_to_error(e.value, e.standard_error),
                                                 round_to_error(e.standard_error, e.standard_error)));
  return text;
}

std::string round_to_error(double value, double error) {
  if (!(error > 0 && std::isfinite(error))) return fmt::format("{:.4g}", value);
  const int decimals = std::clamp(1 - static_cast<int>(std::floor(std::log10(error))), 0, 8);
  return fmt::format("{:.{}f}", value, decimals);
}

LawFile make_law_file(const Fit& fit, std::span<const std::filesystem::path> observables) {
  LawFile law;
  law.d = fit.d;
  law.rho_s = fit.rho_s;
  law.friction = fitted_law(fit.friction);
  law.solid_fraction = fitted_law(fit.solid_fraction);
  law.dilation = fitted_law(fit.dilation);
  const Estimate& share = fit.beta_in_mu;
  if (!share.name.empty())  // a share below 0 is 0 within its error, or a warning says that it is not
    law.dilation.parameters.push_back(
        {"beta_share", std::max(0.0, share.value), share.standard_error, "1", false});
  law.covariance_names = fit.covariance_names;
  law.covariance = fit.covariance;
  law.I = fit.I;
  law.phi = fit.phi;
  law.s = fit.s;
  law.p = fit.p;
  law.verdict = fit.verdict;
  law.warnings = fit.warnings;
  law.provenance = sources(fit, observables);
  return law;
}

json to_json(const Fit& fit, std::span<const std::filesystem::path> observables) {
  json transients = json::array();
  for (const TransientFit& t : fit.transients)
    transients.push_back({{"run", t.run},
                          {"kind", t.kind},
                          {"seed", t.seed},
                          {"I_driven", t.I_driven},
                          {"phi_0", estimate_to_json(t.phi_0)},
                          {"phi_offset", t.phi_offset},
                          {"explained", t.explained},
                          {"s", t.s},
                          {"phi", t.phi},
                          {"phi_fit", t.phi_fit},
                          {"beta", t.beta},
                          {"beta_fit", t.beta_fit},
                          {"mu_excess", t.mu_excess}});
  json excluded = json::array();
  for (const ExcludedRun& run : fit.excluded) excluded.push_back({{"run", run.run}, {"reason", run.reason}});
  const auto range = [](const DataRange& r, const char* unit) {
    return json{{"lowest", r.lowest}, {"highest", r.highest}, {"unit", unit}};
  };
  const FitOptions& o = fit.options;
  json out = {{"format", "dem2sph-fit"},
              {"schema_version", 1},
              {"verdict", fit.verdict},
              {"warnings", fit.warnings},
              {"friction", law_to_json(fit.friction)},
              {"solid_fraction", law_to_json(fit.solid_fraction)},
              {"dilation", law_to_json(fit.dilation)},
              {"friction_members", members_to_json(fit.friction_members)},
              {"solid_fraction_members", members_to_json(fit.solid_fraction_members)},
              {"dilation_members", members_to_json(fit.dilation_members)},
              {"slope", fit.slope.name.empty() ? json(nullptr) : estimate_to_json(fit.slope)},
              {"mu_h_and_D_star_known", fit.mu_h_and_D_star_known},
              {"covariance", {{"names", fit.covariance_names}, {"matrix", fit.covariance}}},
              {"range",
               {{"I", range(fit.I, "1")},
                {"phi", range(fit.phi, "1")},
                {"s", range(fit.s, "1")},
                {"p", range(fit.p, "Pa")}}},
              {"data",
               {{"friction", data_to_json(fit.friction_data)},
                {"solid_fraction", data_to_json(fit.solid_fraction_data)},
                {"transients", transients}}},
              {"excluded", excluded},
              {"options",
               {{"friction", o.friction},
                {"solid_fraction", o.solid_fraction},
                {"robust", o.robust},
                {"compare", o.compare},
                {"profiles", o.profiles},
                {"bootstrap", o.bootstrap},
                {"friction_I_max", o.friction_I_max},
                {"phi_I_max", o.phi_I_max},
                {"wall_disagreement", o.wall_disagreement},
                {"mu_floor", o.mu_floor},
                {"phi_floor", o.phi_floor},
                {"I_floor", o.I_floor},
                {"D_star_min", o.D_star_min},
                {"D_star_max", o.D_star_max},
                {"mu_max", o.mu_max},
                {"b_max", o.b_max},
                {"dilation", o.dilation},
                {"s_star_min", o.s_star_min},
                {"s_star_max", o.s_star_max},
                {"bins", o.bins},
                {"mu_from_strain", o.mu_from_strain},
                {"starts", o.starts},
                {"strict", o.strict}}},
              {"provenance", sources(fit, observables)}};
  if (fit.dilation.member != "none")
    out["transient_errors"] = {{"phi_noise", noise_to_json(fit.phi_noise)},
                               {"whitened_autocorrelation", fit.whitened_autocorrelation},
                               {"s_star_error_least_squares", fit.s_star_error_least_squares},
                               {"s_star_error_jackknife", fit.s_star_error_jackknife}};
  if (fit.seed_noise.strain_scale > 0) out["transient_errors"]["seed_noise"] = noise_to_json(fit.seed_noise);
  if (!fit.transient_checks.empty()) out["transient_checks"] = checks_to_json(fit.transient_checks);
  if (!fit.beta_in_mu.name.empty()) {
    json by_kind = json::array();
    for (const Estimate& e : fit.beta_in_mu_by_kind) by_kind.push_back(estimate_to_json(e));
    out["beta_in_mu"] = {{"share", estimate_to_json(fit.beta_in_mu)},
                         {"by_kind", by_kind},
                         {"mu_noise", noise_to_json(fit.mu_noise)}};
  }
  return out;
}

std::filesystem::path fit_path_of(const std::filesystem::path& law_path) {
  if (law_path.filename() == "law.json") return law_path.parent_path() / "fit.json";
  const std::filesystem::path name = law_path.extension() == ".json" ? law_path.stem() : law_path.filename();
  return law_path.parent_path() / (name.string() + ".fit.json");
}

void write_fit(const Fit& fit, std::span<const std::filesystem::path> observables,
               const std::filesystem::path& law_path) {
  write_law_file(make_law_file(fit, observables), law_path);
  write_file_atomically(fit_path_of(law_path), to_json(fit, observables).dump(1) + "\n");
}

}  // namespace dem2sph
