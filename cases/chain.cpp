#include "cases/chain.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <fstream>
#include <limits>
#include <sstream>
#include <thread>

#include "calibration/report.hpp"
#include "cases/compare.hpp"
#include "cases/grains.hpp"
#include "cases/precision.hpp"
#include "cases/stability.hpp"
#include "dem_bridge/grain_flow_run.hpp"
#include "dem_bridge/sweep.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"
#include "sph/run_flow.hpp"
#include "sph/scene.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

const ParameterTable chain_table{"chain",
                                 "How the links of `dem2sph run` belong together.",
                                 {{"shear_cell", Kind::file, "", 0, 0, "unset",
                                   "Case file with [material] and [shear_cell]; unset: this one."}}};

/// What `run` refuses, said before the first LIGGGHTS run instead of after the last.
void check_chain(const CaseFile& file, const CaseFile& cell) {
  const std::string name = file.path().string();
  if (file.has("law"))
    throw UsageError(
        fmt::format("{}: `run` fits the law itself; remove the section [law], or use `flow`", name));
  if (!file.has("flow")) throw UsageError(fmt::format("{}: `run` needs a section [flow]", name));
  if (!cell.has("shear_cell"))
    throw UsageError(fmt::format("{}: `run` needs a section [shear_cell], or chain.shear_cell", name));
  const Section flow = file.section(*flow_tables().front());
  if (flow.given("dilation"))
    flow.refuse("dilation",
                "`run` runs the flow with and without dilation; remove \"dilation\", or use `flow`");
  if (flow.word("scene") != "column_collapse")
    flow.refuse("scene",
                "the report of `run` shows a collapse; use `sweep`, `fit` and `flow` for other scenes");
}

class Stopwatch {
 public:
  double seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

json step_json(const std::string& what, double seconds, const std::vector<std::string>& files) {
  return {{"what", what}, {"seconds", seconds}, {"files", files}};
}

}  // namespace

CaseFile case_of(const FlowVariant& variant, const LawFile& law, const fs::path& path,
                 std::vector<std::string> overrides) {
  const char* evolves = law.dilation.member == "printed" ? "evolve_printed" : "evolve";
  overrides.push_back(fmt::format("flow.dilation={}", variant.dilation ? evolves : "none"));
  CaseFile file = load_case(path, overrides);
  if (!variant.dilation)
    for (const char* key : {"beta_lowest", "beta_highest", "beta_share"}) file.erase("flow", key);
  return file;
}

LawFile law_of(const CaseFile& file, const fs::path& law_path) {
  if (!law_path.empty() && file.has("law"))
    throw UsageError(fmt::format("{}: has a section [law], and --law was given: use one of the two",
                                 file.path().string()));
  return law_path.empty() ? law_of_case(file) : read_law_file(law_path);
}

FlowOptions reusing_flow(const fs::path& folder, const CommonOptions& options) {
  FlowOptions flow;
  flow.folder = folder;
  flow.force = options.force;
  flow.reuse = true;
  flow.quiet = options.quiet;
  flow.threads = options.threads;
  return flow;
}

LawFile typical_law() {
  const auto parameter = [](const char* name, double value) {
    return FittedParameter{name, value, 0, "1", false};
  };
  LawFile law;
  law.d = 1e-3;
  law.rho_s = 2500;
  law.friction = {
      "rational", {parameter("mu_l", 0.38), parameter("mu_h", 0.64), parameter("D_star", 0.28)}, 0};
  law.solid_fraction = {"linear", {parameter("phi_c", 0.6), parameter("b", 0.2)}, 0};
  law.dilation = {"phi_relaxes", {parameter("s_star", 0.3)}, 0};
  law.I = {1e-3, 1};
  return law;
}

int jobs_or_cores(int jobs) {
  return jobs > 0 ? jobs : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

CaseFile load_case(const fs::path& path, const std::vector<std::string>& overrides) {
  CaseFile file = CaseFile::load(path, overrides);
  std::vector<const ParameterTable*> tables = bridge::sweep_tables();
  for (const ParameterTable* table : flow_tables()) tables.push_back(table);
  tables.push_back(&fit_table);
  tables.push_back(&chain_table);
  tables.push_back(&bridge::grain_flow_table);
  tables.push_back(&compare_table);
  tables.push_back(&precision_table);
  tables.push_back(&stability_table);
  file.validate(tables);
  return file;
}

CaseFile shear_cell_case(const CaseFile& file) {
  const Section chain = file.section(chain_table);
  const fs::path other = chain.file("shear_cell");
  if (other.empty()) return file;
  for (const char* section : {"material", "shear_cell"})
    if (file.has(section))
      chain.refuse("shear_cell",
                   fmt::format("\"shear_cell\" names another case, so [{}] changes nothing here; "
                               "remove one of the two",
                               section));
  return load_case(other, {});
}

std::string plan_chain(const CaseFile& file, const CommonOptions& options) {
  std::string text;
  const CaseFile cell = shear_cell_case(file);
  if (cell.has("shear_cell"))
    text += bridge::describe(bridge::plan_sweep(cell, bridge::engine_unknown), jobs_or_cores(options.jobs));
  if (file.has("flow")) {
    if (file.has(bridge::grain_flow_table.section)) text += plan_grains(file);
    if (file.has("law")) {
      text += plan_flow(file, law_of_case(file));
    } else if (file.section(*flow_tables().front()).given("dilation")) {
      text += "with a typical law in place of a fitted one:\n" + plan_flow(file, typical_law());
    } else {
      text += "with a typical law in place of the fitted one:\n";
      for (const FlowVariant& variant : flow_variants)
        text += plan_flow(case_of(variant, typical_law(), file.path(), options.overrides), typical_law());
    }
  }
  if (text.empty())
    throw UsageError(
        fmt::format("{}: nothing to run: there is neither [shear_cell] nor [flow]", file.path().string()));
  return text;
}

json run_chain(const fs::path& case_path, const fs::path& folder, const CommonOptions& options) {
  const CaseFile file = load_case(case_path, options.overrides);
  const CaseFile cell = shear_cell_case(file);
  check_chain(file, cell);
  for (const FlowVariant& variant : flow_variants)
    plan_flow(case_of(variant, typical_law(), case_path, options.overrides), typical_law());
  const Section fit_section = file.section(fit_table);
  const FitOptions fit_options = FitOptions::from(fit_section);
  fs::create_directories(folder);
  json steps = json::array();

  // Grains.
  Stopwatch sweep_time;
  const bridge::SweepPlan plan = bridge::plan_sweep(cell, bridge::engine_version());
  const bridge::SweepResult sweep =
      bridge::run_sweep(plan, {folder / "shear_cell", jobs_or_cores(options.jobs), options.quiet});
  for (const ExcludedRun& failed : sweep.failed) spdlog::warn("run {} failed: {}", failed.run, failed.reason);
  if (sweep.exit_code() == ExitCode::interrupted)
    throw Interrupted(
        "another sweep still works on some of the runs; the same command goes on when it is done");
  const fs::path observables_path = folder / "shear_cell" / "observables.h5";
  steps.push_back(
      step_json(fmt::format("{} shear cells in LIGGGHTS ({} run now, {} reused, {:.0f} core-seconds)",
                            plan.runs.size(), sweep.ran, sweep.reused, sweep.observables.cpu_seconds()),
                sweep_time.seconds(), {"shear_cell/observables.h5"}));

  // Law.
  Stopwatch fit_time;
  const std::vector<fs::path> observables_paths{observables_path};
  const Fit fit = fit_law({read_observables(observables_path)}, fit_options);
  const std::string hash = law_hash(make_law_file(fit, observables_paths));
  if (!options.force && fs::exists(folder / "law.json") &&
      law_hash(read_law_file(folder / "law.json")) != hash)
    throw UsageError(
        fmt::format("{}: holds another law, and flows that belong to it; use --force to replace both, or "
                    "another -o",
                    (folder / "law.json").string()));
  write_fit(fit, observables_paths, folder / "law.json");
  steps.push_back(step_json("fit of the law (Ceres)", fit_time.seconds(), {"law.json", "fit.json"}));

  // Flows.
  const LawFile law = read_law_file(folder / "law.json");
  json flows = json::array();
  for (const FlowVariant& variant : flow_variants) {
    Stopwatch flow_time;
    if (variant.dilation && law.dilation.member == "none") {
      spdlog::warn("no transients, so no law of dilation: the flow with dilation is left out");
      continue;
    }
    const std::string name = fmt::format("flow_{}", variant.name);
    const json summary = run_flow(case_of(variant, law, case_path, options.overrides), law,
                                  reusing_flow(folder / name, options));
    const std::string file_name = name + "/summary.json";
    flows.push_back({{"label", variant.label}, {"summary", file_name}});
    steps.push_back(
        step_json(fmt::format("flow {} ({} particles, {} steps)", variant.label,
                              summary.at("particles").get<long>(), summary.at("steps").get<long>()),
                  flow_time.seconds(), {file_name}));
  }

  const json run = {{"format", "dem2sph-run"},
                    {"schema_version", 1},
                    {"title", fs::absolute(case_path).parent_path().filename().string()},
                    {"case", fs::absolute(case_path).string()},
                    {"effective", file.effective()},
                    {"observables", {"shear_cell/observables.h5"}},
                    {"law", "law.json"},
                    {"fit_section", fit_section.text()},
                    {"flows", flows},
                    {"steps", steps},
                    {"provenance", provenance()}};
  write_file_atomically(folder / "run.json", run.dump(1) + "\n");
  const fs::path page = make_report(folder);

  json parameters = json::object();
  for (const LawFit* part : {&fit.friction, &fit.solid_fraction, &fit.dilation})
    for (const Estimate& e : part->parameters)
      parameters[e.name] = {
          {"value", e.value}, {"standard_error", e.standard_error}, {"low", e.low}, {"high", e.high}};
  return {{"report", fs::absolute(page).string()},
          {"law", fs::absolute(folder / "law.json").string()},
          {"parameters", parameters},
          {"verdict", fit.verdict},
          {"failed_runs", sweep.failed.size()},
          {"text", describe(fit)}};
}

fs::path make_report(const fs::path& folder) {
  const fs::path path = folder / "run.json";
  const json run = read_json(path);
  ReportInputs inputs;
  try {
    if (run.at("format") != "dem2sph-run")
      throw InputError(fmt::format("{}: is not a run of dem2sph", path.string()));
    inputs.title = run.at("title").get<std::string>();
    for (const json& file : run.at("observables"))
      inputs.observables.push_back(read_observables(folder / file.get<std::string>()));
    inputs.law = read_law_file(folder / run.at("law").get<std::string>());
    const CaseFile fit_case = CaseFile::parse(run.at("fit_section").get<std::string>(), path.string());
    inputs.fit = fit_law(inputs.observables, FitOptions::from(fit_case.section(fit_table)));
    for (const json& flow : run.at("flows")) {
      const fs::path summary = folder / flow.at("summary").get<std::string>();
      if (read_json(summary).at("law_sha256") != law_hash(inputs.law))
        throw InputError(fmt::format("{}: was run with another law than {}", summary.string(),
                                     (folder / run.at("law").get<std::string>()).string()));
      inputs.flows.push_back({flow.at("label").get<std::string>(), summary});
    }
    for (const json& step : run.at("steps")) {
      ReportStep entry{step.at("what").get<std::string>(), step.at("seconds").get<double>(), {}};
      for (const json& file : step.at("files")) entry.files.push_back(folder / file.get<std::string>());
      inputs.steps.push_back(entry);
    }
    inputs.provenance = run.at("provenance");
  } catch (const json::exception& error) {
    throw InputError(fmt::format("{}: {}", path.string(), error.what()));
  }
  const fs::path page = folder / "report.html";
  write_report(inputs, page);
  return page;
}

std::string describe(const Fit& fit) {
  std::string text =
      fmt::format("{:<10} {:>10} {:>10}   95 % interval\n", "parameter", "value", "std. error");
  for (const LawFit* part : {&fit.friction, &fit.solid_fraction, &fit.dilation})
    for (const Estimate& e : part->parameters)
      text += e.at_bound ? fmt::format("{:<10} {:>10.4g}   held at a bound: not known from these data\n",
                                       e.name, e.value)
                         : fmt::format("{:<10} {:>10.4g} {:>10.2g}   {:.4g} to {:.4g}\n", e.name, e.value,
                                       e.standard_error, e.low, e.high);
  const auto members = [&](const char* family, const std::vector<LawFit>& laws, const LawFit& chosen) {
    if (laws.empty()) return;
    double best = std::numeric_limits<double>::infinity();
    for (const LawFit& law : laws)
      if (law.failure.empty()) best = std::min(best, law.AICc);
    text += fmt::format("{}: members by AICc above the best\n", family);
    for (const LawFit& law : laws) {
      const CrossValidation& cv = law.cross_validation;
      text +=
          law.failure.empty()
              ? fmt::format(
                    "  {}{:<17} {:>8.1f}   chi2/dof {:.2f}{}\n", law.member == chosen.member ? '*' : ' ',
                    law.member, law.AICc - best, law.chi2_per_dof,
                    cv.conditions.empty()
                        ? ""
                        : fmt::format("   conditions left out predicted to {:.2f} % rms, {:.2f} % at most",
                                      100 * cv.rms, 100 * cv.largest))
              : fmt::format("   {:<17} not fitted: {}\n", law.member, law.failure);
    }
  };
  members("friction", fit.friction_members, fit.friction);
  members("solid fraction", fit.solid_fraction_members, fit.solid_fraction);
  members("dilation", fit.dilation_members, fit.dilation);
  for (const TransientCheck& c : fit.transient_checks)
    text += fmt::format(
        "  {:<14} to I = {:<6g} packed with {:<4g} {} seeds: signal/noise {:4.1f}, chi2/dof {:.2f}{}\n",
        c.kind, c.I_driven, c.packing_friction, c.seeds, c.signal_to_noise, c.chi2_per_dof,
        c.predicted ? fmt::format(" ({:.2f} left out)", c.predicted_chi2_per_dof) : "");
  text += fit.verdict + "\n";
  for (const std::string& warning : fit.warnings) text += "note: " + warning + "\n";
  return text;
}

}  // namespace dem2sph
