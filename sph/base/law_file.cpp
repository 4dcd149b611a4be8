#include "sph/base/law_file.hpp"

#include <fmt/format.h>

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
DataRange range_from_json(const json& j) { return {j.at("lowest").get<double>(), j.at("highest").get<double>()}; }

}  // namespace

double FittedLaw::operator[](std::string_view name) const {
  for (const FittedParameter& p : parameters)
    if (p.name == name) return p.value;
  throw InputError(fmt::format("the {} law has no parameter \"{}\"", member, name));
}

void write_law_file(const LawFile& law, const std::filesystem::path& path) {
  const json j = {{"format", "dem2sph-law"},
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
                    {"p", to_json(law.p, "Pa")}}},
                  {"verdict", law.verdict},
                  {"warnings", law.warnings},
                  {"provenance", law.provenance}};
  write_file_atomically(path, j.dump(2) + "\n");
}

LawFile read_law_file(const std::filesystem::path& path) {
  const json j = read_json(path);
  const auto refuse = [&](const std::string& what) -> InputError {
    return InputError(fmt::format("{}: {}", path.string(), what));
  };
  LawFile law;
  try {
    if (j.at("format") != "dem2sph-law") throw refuse("is not a dem2sph law file");
    if (j.at("schema_version") != law_schema_version)
      throw refuse(fmt::format("has schema version {}, this program reads {}", j.at("schema_version").dump(),
                               law_schema_version));
    law.d = j.at("grains").at("d").at("value").get<double>();
    law.rho_s = j.at("grains").at("rho_s").at("value").get<double>();
    law.friction = law_from_json(j.at("friction"));
    law.solid_fraction = law_from_json(j.at("solid_fraction"));
    law.dilation = law_from_json(j.at("dilation"));
    law.covariance_names = j.at("covariance").at("names").get<std::vector<std::string>>();
    law.covariance = j.at("covariance").at("matrix").get<std::vector<std::vector<double>>>();
    const json& range = j.at("range");
    law.I = range_from_json(range.at("I"));
    law.phi = range_from_json(range.at("phi"));
    law.s = range_from_json(range.at("s"));
    law.p = range_from_json(range.at("p"));
    law.verdict = j.at("verdict").get<std::string>();
    law.warnings = j.at("warnings").get<std::vector<std::string>>();
    law.provenance = j.at("provenance");
  } catch (const json::exception& error) {
    throw refuse(error.what());
  }

  const auto positive = [&](double value, const char* name) {
    if (!(value > 0 && std::isfinite(value))) throw refuse(fmt::format("{} = {} must be positive", name, value));
  };
  positive(law.d, "d");
  positive(law.rho_s, "rho_s");
  if (law.friction.member == "rational") {
    positive(law.friction["D_star"], "D_star");
    positive(law.friction["mu_l"], "mu_l");
    if (!(law.friction["mu_h"] >= law.friction["mu_l"])) throw refuse("mu_h is below mu_l");
  } else {
    throw refuse(fmt::format("unknown friction law \"{}\"", law.friction.member));
  }
  if (law.solid_fraction.member == "linear") {
    positive(law.solid_fraction["phi_c"], "phi_c");
    if (!std::isfinite(law.solid_fraction["b"])) throw refuse("b is not finite");
  } else {
    throw refuse(fmt::format("unknown solid fraction law \"{}\"", law.solid_fraction.member));
  }
  if (law.dilation.member == "phi_relaxes")
    positive(law.dilation["s_star"], "s_star");
  else if (law.dilation.member != "none")
    throw refuse(fmt::format("unknown dilation law \"{}\"", law.dilation.member));
  const std::size_t n = law.covariance_names.size();
  if (law.covariance.size() != n) throw refuse("the covariance has another size than its names");
  for (std::size_t i = 0; i < n; ++i) {
    if (law.covariance[i].size() != n) throw refuse("the covariance is not square");
    for (std::size_t k = 0; k < i; ++k)
      if (law.covariance[i][k] != law.covariance[k][i]) throw refuse("the covariance is not symmetric");
  }
  return law;
}

}  // namespace dem2sph
