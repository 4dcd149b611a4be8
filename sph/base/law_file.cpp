#include "sph/base/law_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;

json to_json(const FittedLaw& law) {
  json parameters = json::array();
  for (const FittedParameter& p : law.parameters)
    parameters.push_back({{"name", p.name},
                          {"value", p.value},
                          {"standard_error", p.standard_error},
                          {"unit", p.unit},
                          {"at_bound", p.at_bound}});
  return {{"member", law.member}, {"parameters", parameters}, {"chi2_per_dof", law.chi2_per_dof}};
}

FittedLaw law_from_json(const json& j) {
  FittedLaw law;
  law.member = j.at("member").get<std::string>();
  law.chi2_per_dof = j.at("chi2_per_dof").get<double>();
  for (const json& p : j.at("parameters"))
    law.parameters.push_back({p.at("name").get<std::string>(), p.at("value").get<double>(),
                              p.at("standard_error").get<double>(), p.at("unit").get<std::string>(),
                              p.at("at_bound").get<bool>()});
  return law;
}

json to_json(const DataRange& range, const char* unit) {
  return {{"lowest", range.lowest}, {"highest", range.highest}, {"unit", unit}};
}

// A unit that the file states and nobody reads would be the worst of misprints.
void require_unit(const json& j, const char* what, const char* unit) {
  if (j.at("unit") != unit)
    throw InputError(fmt::format("{} has the unit {}, expected \"{}\"", what, j.at("unit").dump(), unit));
}

double value_from_json(const json& j, const char* name, const char* unit) {
  require_unit(j.at(name), name, unit);
  return j.at(name).at("value").get<double>();
}

DataRange range_from_json(const json& j, const char* name, const char* unit) {
  require_unit(j.at(name), name, unit);
  const DataRange range{j.at(name).at("lowest").get<double>(), j.at(name).at("highest").get<double>()};
  if (!(range.lowest <= range.highest)) throw InputError(fmt::format("the range of {} is upside down", name));
  return range;
}

// JSON has no NaN: it would be written as null, and the file could never be read again.
void require_finite(const json& j, const std::string& where) {
  if (j.is_number_float() && !std::isfinite(j.get<double>()))
    throw Error(ExitCode::bug, fmt::format("law file: {} is not a finite number", where));
  if (!j.is_structured()) return;
  for (const auto& [key, item] : j.items()) require_finite(item, where + "/" + key);
}

}  // namespace

double FittedLaw::operator[](std::string_view name) const {
  for (const FittedParameter& p : parameters)
    if (p.name == name) return p.value;
  throw InputError(fmt::format("the {} law has no parameter \"{}\"", member, name));
}

bool FittedLaw::has(std::string_view name) const {
  return std::any_of(parameters.begin(), parameters.end(),
                     [&](const FittedParameter& p) { return p.name == name; });
}

namespace {

// The law without its verdict and provenance.
json physics_of(const LawFile& law) {
  return {{"format", "dem2sph-law"},
          {"schema_version", law_schema_version},
          {"grains",
           {{"d", {{"value", law.d}, {"unit", "m"}}}, {"rho_s", {{"value", law.rho_s}, {"unit", "kg/m^3"}}}}},
          {"friction", to_json(law.friction)},
          {"solid_fraction", to_json(law.solid_fraction)},
          {"dilation", to_json(law.dilation)},
          {"covariance", {{"names", law.covariance_names}, {"matrix", law.covariance}}},
          {"range",
           {{"I", to_json(law.I, "1")},
            {"phi", to_json(law.phi, "1")},
            {"s", to_json(law.s, "1")},
            {"p", to_json(law.p, "Pa")}}}};
}

}  // namespace

std::string law_hash(const LawFile& law) { return sha256(physics_of(law).dump()); }

void write_law_file(const LawFile& law, const std::filesystem::path& path) {
  json j = physics_of(law);
  j["verdict"] = law.verdict;
  j["warnings"] = law.warnings;
  j["provenance"] = law.provenance;
  require_finite(j, "");
  write_file_atomically(path, j.dump(2) + "\n");
}

namespace {

LawFile law_file_from_json(const json& j) {
  const auto refuse = [](const std::string& what) { return InputError(what); };
  LawFile law;
  if (j.at("format") != "dem2sph-law") throw refuse("is not a dem2sph law file");
  if (j.at("schema_version") != law_schema_version)
    throw refuse(fmt::format("has schema version {}, this program reads {}", j.at("schema_version").dump(),
                             law_schema_version));
  law.d = value_from_json(j.at("grains"), "d", "m");
  law.rho_s = value_from_json(j.at("grains"), "rho_s", "kg/m^3");
  law.friction = law_from_json(j.at("friction"));
  law.solid_fraction = law_from_json(j.at("solid_fraction"));
  law.dilation = law_from_json(j.at("dilation"));
  law.covariance_names = j.at("covariance").at("names").get<std::vector<std::string>>();
  law.covariance = j.at("covariance").at("matrix").get<std::vector<std::vector<double>>>();
  const json& range = j.at("range");
  law.I = range_from_json(range, "I", "1");
  law.phi = range_from_json(range, "phi", "1");
  law.s = range_from_json(range, "s", "1");
  law.p = range_from_json(range, "p", "Pa");
  law.verdict = j.at("verdict").get<std::string>();
  law.warnings = j.at("warnings").get<std::vector<std::string>>();
  law.provenance = j.at("provenance");

  // Every parameter is a pure number, but D* where it is a rate: that is another member, never another unit.
  for (const FittedLaw* part : {&law.friction, &law.solid_fraction, &law.dilation})
    for (const FittedParameter& p : part->parameters) {
      const char* unit = part->member == "rational_rate" && p.name == "D_star" ? "1/s" : "1";
      if (p.unit != unit)
        throw refuse(fmt::format("{} has the unit \"{}\", expected \"{}\"", p.name, p.unit, unit));
    }
  const auto positive = [&](double value, const char* name) {
    if (!(value > 0 && std::isfinite(value)))
      throw refuse(fmt::format("{} = {} must be positive", name, value));
  };
  const auto not_negative = [&](double value, const char* name) {
    if (!(value >= 0 && std::isfinite(value)))
      throw refuse(fmt::format("{} = {} must not be negative", name, value));
  };
  // Of two parameters of the friction law, the second may not be the smaller.
  const auto ordered = [&](const char* low, const char* high) {
    positive(law.friction[low], low);
    positive(law.friction[high], high);
    if (!(law.friction[high] >= law.friction[low])) throw refuse(fmt::format("{} is below {}", high, low));
  };
  positive(law.d, "d");
  positive(law.rho_s, "rho_s");
  const std::string& friction = law.friction.member;
  if (friction == "constant") {
    positive(law.friction["mu"], "mu");
  } else if (friction == "rational" || friction == "rational_rate" || friction == "exponential") {
    positive(law.friction["D_star"], "D_star");
    ordered("mu_l", "mu_h");
  } else if (friction == "power") {
    positive(law.friction["mu_l"], "mu_l");
    not_negative(law.friction["a"], "a");
    positive(law.friction["n"], "n");
  } else if (friction == "linear") {
    positive(law.friction["mu_l"], "mu_l");
    not_negative(law.friction["rise"], "rise");
  } else if (friction == "barker_gray_2017") {
    ordered("mu_s", "mu_2");
    positive(law.friction["I_0"], "I_0");
    not_negative(law.friction["mu_inf"], "mu_inf");
    positive(law.friction["alpha"], "alpha");
  } else {
    throw refuse(fmt::format("unknown friction law \"{}\"", friction));
  }
  const std::string& solid_fraction = law.solid_fraction.member;
  if (solid_fraction != "linear" && solid_fraction != "power" && solid_fraction != "rational")
    throw refuse(fmt::format("unknown solid fraction law \"{}\"", solid_fraction));
  positive(law.solid_fraction["phi_c"], "phi_c");
  if (solid_fraction != "power" && !std::isfinite(law.solid_fraction["b"])) throw refuse("b is not finite");
  if (solid_fraction == "power") {
    not_negative(law.solid_fraction["a"], "a");
    positive(law.solid_fraction["n"], "n");
  }
  if (solid_fraction == "rational") positive(law.solid_fraction["I_phi"], "I_phi");
  const std::string& dilation = law.dilation.member;
  if (dilation != "phi_relaxes" && dilation != "two_sided" && dilation != "printed" && dilation != "none")
    throw refuse(fmt::format("unknown dilation law \"{}\"", dilation));
  if (dilation != "none") positive(law.dilation["s_star"], "s_star");
  if (dilation == "two_sided") positive(law.dilation["s_star_compacting"], "s_star_compacting");
  if (dilation == "printed") not_negative(law.dilation["gain"], "gain");
  if (law.dilation.has("beta_share")) not_negative(law.dilation["beta_share"], "beta_share");
  const std::size_t n = law.covariance_names.size();
  if (law.covariance.size() != n) throw refuse("the covariance has another size than its names");
  for (std::size_t i = 0; i < n; ++i) {
    if (law.covariance[i].size() != n) throw refuse("the covariance is not square");
    for (std::size_t k = 0; k < i; ++k)
      if (law.covariance[i][k] != law.covariance[k][i]) throw refuse("the covariance is not symmetric");
  }
  return law;
}

}  // namespace

LawFile read_law_file(const std::filesystem::path& path) {
  const json j = read_json(path);
  try {
    return law_file_from_json(j);
  } catch (const InputError& error) {
    throw InputError(fmt::format("{}: {}", path.string(), error.what()));
  } catch (const json::exception& error) {
    throw InputError(fmt::format("{}: {}", path.string(), error.what()));
  }
}

}  // namespace dem2sph
