#include "dem_bridge/observables.hpp"

#include <fmt/format.h>

#include <span>

#include "sph/base/errors.hpp"
#include "sph/base/hdf5_file.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph {
namespace {

constexpr const char* format_name = "dem2sph observables";

/// A column of /steady that holds reals: its name, unit and place in the struct, for writer and reader alike.
struct SteadyColumn {
  const char* name;
  const char* unit;
  double SteadyPoint::*member;
};
constexpr SteadyColumn steady_columns[] = {{"I_driven", "1", &SteadyPoint::I_driven},
                                           {"I", "1", &SteadyPoint::I},
                                           {"I_se", "1", &SteadyPoint::I_se},
                                           {"mu", "1", &SteadyPoint::mu},
                                           {"mu_se", "1", &SteadyPoint::mu_se},
                                           {"phi", "1", &SteadyPoint::phi},
                                           {"phi_se", "1", &SteadyPoint::phi_se},
                                           {"p", "Pa", &SteadyPoint::p},
                                           {"p_se", "Pa", &SteadyPoint::p_se},
                                           {"wall_mu", "1", &SteadyPoint::wall_mu},
                                           {"wall_p", "Pa", &SteadyPoint::wall_p},
                                           {"strain", "1", &SteadyPoint::strain},
                                           {"phi_drift", "1", &SteadyPoint::phi_drift},
                                           {"N1", "1", &SteadyPoint::N1},
                                           {"N1_se", "1", &SteadyPoint::N1_se},
                                           {"N2", "1", &SteadyPoint::N2},
                                           {"N2_se", "1", &SteadyPoint::N2_se},
                                           {"beta", "1", &SteadyPoint::beta},
                                           {"beta_se", "1", &SteadyPoint::beta_se},
                                           {"temperature", "1", &SteadyPoint::temperature},
                                           {"coordination", "1", &SteadyPoint::coordination},
                                           {"fabric_xz", "1", &SteadyPoint::fabric_xz}};

struct SteadyFlag {
  const char* name;
  bool SteadyPoint::*member;
};
constexpr SteadyFlag steady_flags[] = {{"I_flat", &SteadyPoint::I_flat},
                                       {"mu_flat", &SteadyPoint::mu_flat},
                                       {"phi_flat", &SteadyPoint::phi_flat}};

struct TransientColumn {
  const char* name;
  const char* unit;
  std::vector<double> Transient::*member;
};
constexpr TransientColumn transient_columns[] = {
    {"s", "1", &Transient::s},       {"gamma_dot", "1/s", &Transient::gamma_dot},
    {"p", "Pa", &Transient::p},      {"mu", "1", &Transient::mu},
    {"I", "1", &Transient::I},       {"phi", "1", &Transient::phi},
    {"beta", "1", &Transient::beta}, {"height", "m", &Transient::height}};

struct TransientNumber {
  const char* name;
  const char* unit;
  double Transient::*member;
};
constexpr TransientNumber transient_numbers[] = {{"I_driven", "1", &Transient::I_driven},
                                                 {"I_before", "1", &Transient::I_before},
                                                 {"load", "Pa", &Transient::load},
                                                 {"load_before", "Pa", &Transient::load_before},
                                                 {"packing_friction", "1", &Transient::packing_friction},
                                                 {"phi_0", "1", &Transient::phi_0}};

struct MaterialNumber {
  const char* name;
  const char* unit;
  double Observables::*member;
};
constexpr MaterialNumber material_numbers[] = {{"d", "m", &Observables::d},
                                               {"rho_s", "kg/m^3", &Observables::rho_s},
                                               {"grain_friction", "1", &Observables::grain_friction},
                                               {"pressure", "Pa", &Observables::pressure}};

[[noreturn]] void ragged(const std::filesystem::path& path, const std::string& name) {
  throw InputError(
      fmt::format("{}: dataset \"{}\" has another length than its neighbours", path.string(), name));
}

}  // namespace

void write_observables(const Observables& observables, const std::filesystem::path& path) {
  Hdf5Writer file(path);
  file.attribute("/", "format", std::string(format_name));
  file.attribute("/", "schema_version", observables_schema_version);
  file.attribute("/", "provenance", provenance().dump());
  for (const MaterialNumber& n : material_numbers)
    file.write(std::string("material/") + n.name, std::span(&(observables.*n.member), 1), n.unit);
  file.attribute("material", "engine", observables.engine);
  file.attribute("material", "toml", observables.material);

  std::vector<std::string> runs;
  std::vector<std::int64_t> seeds;
  for (const SteadyPoint& point : observables.steady) {
    runs.push_back(point.run);
    seeds.push_back(point.seed);
  }
  file.write("steady/run", runs);
  file.write("steady/seed", seeds, "1");
  for (const SteadyColumn& column : steady_columns) {
    std::vector<double> values;
    for (const SteadyPoint& point : observables.steady) values.push_back(point.*column.member);
    file.write(std::string("steady/") + column.name, values, column.unit);
  }

  for (const SteadyFlag& flag : steady_flags) {
    std::vector<std::int64_t> values;
    for (const SteadyPoint& point : observables.steady) values.push_back(point.*flag.member ? 1 : 0);
    file.write(std::string("steady/") + flag.name, values, "1");
  }

  for (std::size_t i = 0; i < observables.transients.size(); ++i) {
    const Transient& transient = observables.transients[i];
    const std::string group = fmt::format("transients/{:04}", i);
    for (const TransientColumn& column : transient_columns)
      file.write(group + "/" + column.name, transient.*column.member, column.unit);
    for (const TransientNumber& n : transient_numbers)
      file.write(group + "/" + n.name, std::span(&(transient.*n.member), 1), n.unit);
    file.attribute(group, "run", transient.run);
    file.attribute(group, "kind", transient.kind);
    file.attribute(group, "seed", transient.seed);
  }

  std::vector<std::string> excluded, reasons;
  for (const ExcludedRun& run : observables.excluded) {
    excluded.push_back(run.run);
    reasons.push_back(run.reason);
  }
  file.write("excluded/run", excluded);
  file.write("excluded/reason", reasons);

  // Apart from the rest, which is the same whenever it is made again.
  std::vector<std::string> cost_runs, cost_kinds;
  std::vector<double> seconds;
  for (const RunCost& cost : observables.costs) {
    cost_runs.push_back(cost.run);
    cost_kinds.push_back(cost.kind);
    seconds.push_back(cost.cpu_seconds);
  }
  file.write("cost/run", cost_runs);
  file.write("cost/kind", cost_kinds);
  file.write("cost/cpu_seconds", seconds, "s");
  file.commit();
}

Observables read_observables(const std::filesystem::path& path) {
  const Hdf5Reader file(path, format_name, observables_schema_version);
  Observables observables;
  const auto one = [&](const std::string& name, const char* unit) {
    const std::vector<double> values = file.doubles(name, unit);
    if (values.size() != 1) ragged(path, name);
    return values[0];
  };
  for (const MaterialNumber& n : material_numbers)
    observables.*n.member = one(std::string("material/") + n.name, n.unit);
  observables.engine = file.text_attribute("material", "engine");
  observables.material = file.text_attribute("material", "toml");

  const std::vector<std::string> runs = file.strings("steady/run");
  const std::vector<std::int64_t> seeds = file.integers("steady/seed", "1");
  if (seeds.size() != runs.size()) ragged(path, "steady/seed");
  observables.steady.resize(runs.size());
  for (std::size_t i = 0; i < runs.size(); ++i) {
    observables.steady[i].run = runs[i];
    observables.steady[i].seed = seeds[i];
  }
  for (const SteadyColumn& column : steady_columns) {
    const std::string name = std::string("steady/") + column.name;
    const std::vector<double> values = file.doubles(name, column.unit);
    if (values.size() != runs.size()) ragged(path, name);
    for (std::size_t i = 0; i < runs.size(); ++i) observables.steady[i].*column.member = values[i];
  }

  for (const SteadyFlag& flag : steady_flags) {
    const std::string name = std::string("steady/") + flag.name;
    const std::vector<std::int64_t> values = file.integers(name, "1");
    if (values.size() != runs.size()) ragged(path, name);
    for (std::size_t i = 0; i < runs.size(); ++i) observables.steady[i].*flag.member = values[i] != 0;
  }

  for (const std::string& key : file.names("transients")) {
    const std::string group = "transients/" + key;
    Transient transient;
    for (const TransientColumn& column : transient_columns) {
      const std::string name = group + "/" + column.name;
      transient.*column.member = file.doubles(name, column.unit);
      if ((transient.*column.member).size() != transient.s.size()) ragged(path, name);
    }
    for (const TransientNumber& n : transient_numbers)
      transient.*n.member = one(group + "/" + n.name, n.unit);
    transient.run = file.text_attribute(group, "run");
    transient.kind = file.text_attribute(group, "kind");
    transient.seed = file.integer_attribute(group, "seed");
    observables.transients.push_back(std::move(transient));
  }

  const std::vector<std::string> excluded = file.strings("excluded/run");
  const std::vector<std::string> reasons = file.strings("excluded/reason");
  if (reasons.size() != excluded.size()) ragged(path, "excluded/reason");
  for (std::size_t i = 0; i < excluded.size(); ++i) observables.excluded.push_back({excluded[i], reasons[i]});

  const std::vector<std::string> cost_runs = file.strings("cost/run"), cost_kinds = file.strings("cost/kind");
  const std::vector<double> seconds = file.doubles("cost/cpu_seconds", "s");
  if (cost_kinds.size() != cost_runs.size()) ragged(path, "cost/kind");
  if (seconds.size() != cost_runs.size()) ragged(path, "cost/cpu_seconds");
  for (std::size_t i = 0; i < cost_runs.size(); ++i)
    observables.costs.push_back({cost_runs[i], cost_kinds[i], seconds[i]});
  return observables;
}

}  // namespace dem2sph
