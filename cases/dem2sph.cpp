// The command line. Commands, options and exit codes are a contract: cases/README.md.
#include <fmt/format.h>
#include <spdlog/sinks/basic_file_sink.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <iostream>

#include "calibration/suggest.hpp"
#include "cases/case_template.hpp"
#include "cases/chain.hpp"
#include "cases/compare.hpp"
#include "cases/grains.hpp"
#include "cases/left_out.hpp"
#include "cases/plan_picture.hpp"
#include "cases/precision.hpp"
#include "cases/stability.hpp"
#include "cases/stability_page.hpp"
#include "dem_bridge/sweep.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/frame.hpp"
#include "sph/base/hdf5_file.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"
#include "sph/base/version.hpp"
#include "sph/run_flow.hpp"
#include "sph/scene.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

struct Options : CommonOptions {
  fs::path case_file;
  fs::path output;
  fs::path law;
  fs::path frame;
  std::vector<fs::path> observables;
  long count = 6;
  double I_max = 1;
  std::string fields = "x,v,p";
  bool as_json = false;
  bool dry_run = false;
  bool measure = false;
};

void print(const Options& options, const json& result, const std::string& text) {
  if (options.as_json)
    fmt::print("{}\n", result.dump(1));
  else
    fmt::print("{}", text);
}

/// From here on, what goes to stderr goes to FOLDER/dem2sph.log as well, with its time.
void log_to(const fs::path& folder) {
  fs::create_directories(folder);
  auto file = std::make_shared<spdlog::sinks::basic_file_sink_mt>((folder / "dem2sph.log").string());
  file->set_pattern("%Y-%m-%dT%H:%M:%S %l %v");
  file->log(spdlog::details::log_msg("dem2sph", spdlog::level::info,
                                     fmt::format("dem2sph {} ({}) starts", version, git_revision)));
  spdlog::default_logger()->sinks().push_back(file);
  spdlog::flush_on(spdlog::level::info);
}

json to_json(const bridge::SweepResult& result) {
  json failed = json::array();
  for (const ExcludedRun& run : result.failed) failed.push_back({{"run", run.run}, {"reason", run.reason}});
  return {{"ran", result.ran},
          {"reused", result.reused},
          {"failed", failed},
          {"core_seconds", result.observables.cpu_seconds()}};
}

ExitCode finish_sweep(const bridge::SweepResult& result, const Options& options) {
  std::string text = fmt::format("{} runs done now, {} reused, {} failed; {}\n", result.ran, result.reused,
                                 result.failed.size(), (options.output / "observables.h5").string());
  for (const ExcludedRun& run : result.failed) text += fmt::format("  failed {}: {}\n", run.run, run.reason);
  print(options, to_json(result), text);
  return result.exit_code();
}

ExitCode init(const Options& options) {
  const fs::path path = options.output / "case.toml";
  if (fs::exists(path) && !options.force)
    throw UsageError(fmt::format("{}: is there already; use --force to overwrite it", path.string()));
  fs::create_directories(options.output);
  write_file_atomically(path, case_template);
  print(options, {{"case", path.string()}}, fmt::format("{}\n", path.string()));
  return ExitCode::ok;
}

/// A file that a command is to write: not there yet (or --force), its folder made.
void prepare_output(const Options& options) {
  if (fs::exists(options.output) && !options.force)
    throw UsageError(
        fmt::format("{}: is there already; use --force to overwrite it", options.output.string()));
  if (options.output.has_parent_path()) fs::create_directories(options.output.parent_path());
}

ExitCode plan(const Options& options) {
  const CaseFile file = load_case(options.case_file, options.overrides);
  std::string text = plan_chain(file, options);
  if (!options.output.empty()) {
    prepare_output(options);
    write_file_atomically(options.output, picture_of_plan(file));
    text += fmt::format("drawn in {}\n", options.output.string());
  }
  json result{{"plan", text}};
  if (options.measure) {
    const LawFile law = options.law.empty() && !file.has("law") ? typical_law() : law_of(file, options.law);
    result["left_out"] = measure_left_out(options.case_file, law, options);
    text += describe_left_out(result["left_out"]);
  } else if (!options.law.empty()) {
    throw UsageError("--law belongs to --measure: a plan takes a typical law");
  }
  print(options, result, text);
  return ExitCode::ok;
}

ExitCode sweep(const Options& options) {
  const CaseFile file = shear_cell_case(load_case(options.case_file, options.overrides));
  if (options.dry_run) {
    const std::string text =
        bridge::describe(bridge::plan_sweep(file, bridge::engine_unknown), jobs_or_cores(options.jobs));
    print(options, {{"plan", text}}, text);
    return ExitCode::ok;
  }
  log_to(options.output);
  const bridge::SweepPlan sweep_plan = bridge::plan_sweep(file, bridge::engine_version());
  return finish_sweep(
      bridge::run_sweep(sweep_plan, {options.output, jobs_or_cores(options.jobs), options.quiet}), options);
}

ExitCode sweep_status(const Options& options) {
  const bridge::SweepStatus status = bridge::sweep_status(options.output);
  json rows = json::array();
  for (const bridge::RunStatus& run : status.runs)
    rows.push_back({{"run", run.hash},
                    {"what", run.what},
                    {"state", bridge::name_of(run.state)},
                    {"core_seconds", run.core_seconds},
                    {"detail", run.detail}});
  print(options,
        {{"runs", rows},
         {"core_seconds_left", status.core_seconds_left},
         {"working", status.working},
         {"measured_over_expected", status.slowness}},
        bridge::describe(status));
  return ExitCode::ok;
}

ExitCode sweep_prune(const Options& options) {
  const std::uintmax_t bytes = bridge::prune_sweep(options.output);
  print(options, {{"bytes", bytes}}, fmt::format("{:.1f} MB removed\n", static_cast<double>(bytes) * 1e-6));
  return ExitCode::ok;
}

ExitCode sweep_retry(const Options& options) {
  return finish_sweep(bridge::retry_sweep({options.output, jobs_or_cores(options.jobs), options.quiet}),
                      options);
}

ExitCode seal(const Options& options) {
  seal_hdf5(options.output);
  return ExitCode::ok;
}

/// The case file of a command that only fits, or none.
CaseFile fit_case(const Options& options) {
  if (!options.case_file.empty()) return load_case(options.case_file, options.overrides);
  CaseFile file = CaseFile::parse("", "command line", options.overrides);
  const ParameterTable* const only_fit[] = {&fit_table};
  file.validate(only_fit);
  return file;
}

ExitCode fit(const Options& options) {
  const CaseFile file = fit_case(options);
  std::vector<Observables> observables;
  for (const fs::path& path : options.observables) observables.push_back(read_observables(path));
  prepare_output(options);
  const Fit result = fit_law(observables, FitOptions::from(file.section(fit_table)));
  write_fit(result, options.observables, options.output);
  print(options, dem2sph::to_json(result, options.observables), describe(result));
  return ExitCode::ok;
}

ExitCode suggest(const Options& options) {
  std::vector<Observables> observables;
  for (const fs::path& path : options.observables) observables.push_back(read_observables(path));
  const Fit result = fit_law(observables, FitOptions::from(fit_case(options).section(fit_table)));
  const std::vector<SuggestedRun> runs = suggest_runs(observables, result, options.count, options.I_max);
  json rows = json::array();
  for (const SuggestedRun& run : runs)
    rows.push_back({{"kind", run.kind},
                    {"I_driven", run.I_driven},
                    {"I_before", run.I_before},
                    {"load", run.load},
                    {"packing_friction", run.packing_friction},
                    {"seed", run.seeds_there + 1},
                    {"core_seconds", run.core_seconds},
                    {"mu_se", run.mu_se},
                    {"phi_se", run.phi_se},
                    {"worst", run.worst},
                    {"relative_error_before", run.error_before},
                    {"relative_error_after", run.error_after},
                    {"log_det", run.log_det}});
  print(options, {{"runs", rows}}, describe(runs));
  return ExitCode::ok;
}

ExitCode flow(const Options& options) {
  const CaseFile file = load_case(options.case_file, options.overrides);
  const LawFile law = law_of(file, options.law);
  if (options.dry_run) {
    const std::string text = plan_flow(file, law);
    print(options, {{"plan", text}}, text);
    return ExitCode::ok;
  }
  log_to(options.output);
  FlowOptions flow_options;
  flow_options.folder = options.output;
  flow_options.force = options.force;
  flow_options.quiet = options.quiet;
  flow_options.threads = options.threads;
  const json summary = run_flow(file, law, flow_options);
  std::string text =
      fmt::format("{} at t = {:.4g} s; {}\n", summary.at("ended").get<std::string>(),
                  summary.at("time").get<double>(), (options.output / "summary.json").string());
  if (summary.contains("deposit")) {
    const json& deposit = summary.at("deposit");
    text += fmt::format("run-out {:.3f} L0, centre height {:.3f} L0\n", deposit.at("runout").get<double>(),
                        deposit.at("centre_height_over_L0").get<double>());
  }
  print(options, summary, text);
  return ExitCode::ok;
}

ExitCode dem(const Options& options) {
  const CaseFile file = load_case(options.case_file, options.overrides);
  if (options.dry_run) {
    const std::string text = plan_grains(file);
    print(options, {{"plan", text}}, text);
    return ExitCode::ok;
  }
  log_to(options.output);
  const json summary = run_grains(file, options.output, options);
  const auto figure = [&](const char* where) {
    const json& m = summary.at(json::json_pointer(where));
    return fmt::format("{:.4g} +- {:.2g}", m.at("mean").get<double>(), m.at("sd").get<double>());
  };
  std::string text =
      fmt::format("{} seeds (mean and standard deviation): {} grains, solid fraction {}\n",
                  summary.at("seeds").size(), figure("/particles"), figure("/initial/solid_fraction"));
  if (summary.contains("deposit"))
    text += fmt::format("run-out {} L0, centre height {} L0, at rest after {} sqrt(H/g)\n",
                        figure("/deposit/runout"), figure("/deposit/centre_height_over_L0"),
                        figure("/deposit/time_over_tau"));
  text += fmt::format("{}\n", (options.output / "summary.json").string());
  print(options, summary, text);
  return ExitCode::ok;
}

ExitCode compare(const Options& options) {
  if (options.dry_run) {
    const std::string text = plan_comparison(options.case_file, options.law, options);
    print(options, {{"plan", text}}, text);
    return ExitCode::ok;
  }
  log_to(options.output);
  const json result = run_comparison(options.case_file, options.law, options.output, options);
  std::string text;
  for (const json& variant : result.at("variants")) {
    text += fmt::format("SPH {}\n", variant.at("label").get<std::string>());
    for (const json& m : variant.at("measures"))
      text += fmt::format(
          "  {:<46} grains {:>9.4g} +- {:<8.2g} SPH {:>9.4g}  {:+6.1f} %{}\n",
          fmt::format("{} [{}]", m.at("name").get<std::string>(), m.at("unit").get<std::string>()),
          m.at("dem").get<double>(), m.at("dem_sd").get<double>(), m.at("sph").get<double>(),
          100 * m.at("relative_difference").get<double>(),
          !m.contains("bar")           ? ""
          : m.at("within").get<bool>() ? ""
                                       : "  missed");
    for (const json& d : variant.at("distances"))
      text += fmt::format("  {:<46} L2 {:6.2f} %, of a seed from the others {:6.2f} %{}\n",
                          d.at("name").get<std::string>(), 100 * d.at("L2").get<double>(),
                          100 * d.at("seeds_L2").get<double>(),
                          !d.contains("bar")           ? ""
                          : d.at("within").get<bool>() ? ""
                                                       : "  missed");
  }
  text += fmt::format("{}\n", (options.output / "report.html").string());
  print(options, result, text);
  return ExitCode::ok;
}

ExitCode precision(const Options& options) {
  if (options.dry_run) {
    const std::string text = plan_precision(options.case_file, options.law, options);
    print(options, {{"plan", text}}, text);
    return ExitCode::ok;
  }
  log_to(options.output);
  const json result = run_precision(options.case_file, options.law, options.output, options);
  std::string text =
      fmt::format("{:<34} {:>13} {:>14} {:>9}\n", "run", "core-seconds", "particle-steps", "error");
  for (const json& p : result.at("points"))
    text +=
        p.contains("failure")
            ? fmt::format("{:<34} {}\n", p.at("name").get<std::string>(), p.at("failure").get<std::string>())
            : fmt::format("{:<34} {:>13.3g} {:>14.2g} {:>8.2f} %{}\n",
                          (p.at("family") == "grains" ? "grains of " : "") + p.at("name").get<std::string>(),
                          p.at("core_seconds").get<double>(), p.at("particle_steps").get<double>(),
                          100 * p.at("error").get<double>(),
                          p.at("on_pareto_front").get<bool>() ? "  on the Pareto front" : "");
  text += fmt::format("{}\n{}\n", result.at("verdict").get<std::string>(),
                      (options.output / "report.html").string());
  print(options, result, text);
  return ExitCode::ok;
}

ExitCode stability(const Options& options) {
  if (options.dry_run) {
    const std::string text = plan_stability(options.case_file, options);
    print(options, {{"plan", text}}, text);
    return ExitCode::ok;
  }
  log_to(options.output);
  const json result = run_stability(options.case_file, options.output, options);
  print(options, result,
        describe_stability(result) + fmt::format("{}\n", (options.output / "report.html").string()));
  return result.at("unexplained").get<int>() > 0 ? ExitCode::bar_missed : ExitCode::ok;
}

ExitCode run(const Options& options) {
  if (options.dry_run) return plan(options);
  log_to(options.output);
  const json result = run_chain(options.case_file, options.output, options);
  print(options, result,
        fmt::format("\n{}\nreport: {}\n", result.at("text").get<std::string>(),
                    result.at("report").get<std::string>()));
  return result.at("failed_runs").get<long>() > 0 ? ExitCode::engine : ExitCode::ok;
}

ExitCode report(const Options& options) {
  const fs::path page = make_report(options.output);
  print(options, {{"report", page.string()}}, fmt::format("{}\n", page.string()));
  return ExitCode::ok;
}

ExitCode export_frame(const Options& options) {
  const Frame frame = read_frame(options.frame);
  std::vector<const FrameField*> columns;
  std::stringstream names(options.fields);
  for (std::string name; std::getline(names, name, ',');) columns.push_back(&frame.field(name));
  std::string text = fmt::format("# t = {:.17g} s\n", frame.time);
  for (std::size_t k = 0; k < columns.size(); ++k)
    for (std::size_t c = 0; c < columns[k]->components; ++c)
      text += fmt::format("{}{}{} [{}]", k + c > 0 ? "," : "", columns[k]->name,
                          columns[k]->components > 1 ? fmt::format("_{}", c) : "", columns[k]->unit);
  text += '\n';
  for (std::size_t i = 0; i < frame.size(); ++i) {
    for (std::size_t k = 0; k < columns.size(); ++k)
      for (std::size_t c = 0; c < columns[k]->components; ++c)
        text += fmt::format("{}{:.17g}", k + c > 0 ? "," : "",
                            columns[k]->values[i * columns[k]->components + c]);
    text += '\n';
  }
  prepare_output(options);
  write_file_atomically(options.output, text);
  return ExitCode::ok;
}

int program(int argc, char** argv) {
  CLI::App app{
      "dem2sph: from grains to flows.\nCalibrates a granular material from LIGGGHTS shear cells and runs SPH "
      "flows with it."};
  app.set_version_flag("--version", fmt::format("dem2sph {} ({})", version, git_revision));
  app.require_subcommand(1);
  app.footer(
      "Examples:\n"
      "  dem2sph dem cases/column_collapse/case.toml -o grains  the same flow with grains\n"
      "  dem2sph compare cases/comparison/collapse.toml --law law.json -o out   both, and how far they "
      "differ\n"
      "  dem2sph stability cases/stability/case.toml -o out     where the numerics hold, and where not\n"
      "  dem2sph init my_case                                  a commented case to start from\n"
      "  dem2sph run my_case/case.toml -o out                  grains, law, flow, report\n"
      "  dem2sph sweep cases/shear_cell/case.toml -o grains    only the grains\n"
      "  dem2sph fit grains/observables.h5 -o law.json         only the law\n"
      "  dem2sph suggest grains/observables.h5                 which runs to make next\n"
      "  dem2sph flow cases/column_collapse/case.toml --law law.json -o flow --set flow.resolution=80\n"
      "Exit codes: 0 ok, 1 bug, 2 usage or case file, 3 unreadable input, 4 LIGGGHTS, 5 numerical failure,\n"
      "6 not identifiable, 7 validation bar missed, 75 interrupted and resumable.");
  Options options;
  ExitCode (*chosen)(const Options&) = nullptr;
  // Each command takes the options that change something for it; others are refused.
  const auto add = [&](CLI::App& parent, const char* name, const char* sentence,
                       ExitCode (*function)(const Options&)) {
    CLI::App* command = parent.add_subcommand(name, sentence);
    command->add_flag("--json", options.as_json, "Print the result as JSON");
    command->final_callback([&chosen, function] { chosen = function; });
    return command;
  };
  const auto overrides = [&](CLI::App* command) {
    command
        ->add_option("--set", options.overrides, "Override a key of the case: section.key=value (repeatable)")
        ->allow_extra_args(false);
    return command;
  };
  const auto forces = [&](CLI::App* command) {
    command->add_flag("--force", options.force, "Overwrite earlier results");
    return command;
  };
  const auto shows_progress = [&](CLI::App* command) {
    command->add_flag("-q,--quiet", options.quiet, "No progress");
    return command;
  };
  const auto threads = [&](CLI::App* command) {
    command->add_option("--threads", options.threads, "Threads of one flow (0: as many as its size is worth)")
        ->check(CLI::NonNegativeNumber);
    return command;
  };
  const auto takes_case = [&](CLI::App* command) {
    command->add_option("CASE", options.case_file, "Case file (TOML)")->required();
    return command;
  };
  const auto writes = [&](CLI::App* command, const char* sentence) {
    command->add_option("-o,--output", options.output, sentence)->required();
    return command;
  };
  const auto dry = [&](CLI::App* command) {
    command->add_flag("--dry-run", options.dry_run, "Say what would run, and stop");
    return command;
  };
  const auto parallel = [&](CLI::App* command) {
    command->add_option("--jobs", options.jobs, "LIGGGHTS runs at once (0: one a core)")
        ->check(CLI::NonNegativeNumber);
    return command;
  };

  forces(add(app, "init", "Write a commented case to start from", init))
      ->add_option("DIR", options.output, "Folder to make")
      ->required();
  CLI::App* planning = forces(parallel(overrides(
      takes_case(add(app, "plan", "Check a case; print what will run, what is left out, the cost", plan)))));
  planning->add_option("--svg", options.output,
                       "Draw the geometry as SPH and as grains have it, into this file");
  planning->add_flag("--measure", options.measure,
                     "Measure what each part that is left out would cost, by switching it on");
  planning->add_option("--law", options.law, "Law file of a fit, for --measure");
  // `sweep CASE -o DIR`, or `sweep status DIR`, `sweep retry DIR`, `sweep prune DIR`.
  CLI::App* sweeping = overrides(
      dry(parallel(shows_progress(add(app, "sweep", "Run what is missing of the LIGGGHTS runs", sweep)))));
  sweeping->require_subcommand(0, 1);
  sweeping->add_option("CASE", options.case_file, "Case file (TOML)");
  sweeping->add_option("-o,--output", options.output, "Folder for runs/ and observables.h5");
  sweeping->final_callback([&] {
    if (chosen == nullptr) chosen = sweep;
  });
  add(*sweeping, "status", "State of every run of a sweep", sweep_status)
      ->add_option("DIR", options.output, "Folder of the sweep")
      ->required();
  parallel(shows_progress(add(*sweeping, "retry", "Run what failed once more", sweep_retry)))
      ->add_option("DIR", options.output, "Folder of the sweep")
      ->required();
  add(*sweeping, "prune", "Remove dumps and restart files of the runs that are done", sweep_prune)
      ->add_option("DIR", options.output, "Folder of the sweep")
      ->required();
  CLI::App* fitting = forces(
      overrides(writes(add(app, "fit", "Fit the law to observables (Ceres)", fit), "Law file to write")));
  fitting->add_option("OBSERVABLES", options.observables, "observables.h5, one or more")->required();
  fitting->add_option("--case", options.case_file, "Case file with a section [fit]");
  CLI::App* suggesting =
      overrides(add(app, "suggest", "Which runs would tell the most for their cost", suggest));
  suggesting->add_option("OBSERVABLES", options.observables, "observables.h5, one or more")->required();
  suggesting->add_option("--case", options.case_file, "Case file with a section [fit]");
  suggesting->add_option("--count", options.count, "How many runs")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  suggesting->add_option("--I-max", options.I_max, "Largest driven inertial number to think of")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  CLI::App* flowing = add(app, "flow", "Run the SPH flow of a case", flow);
  forces(
      shows_progress(threads(dry(overrides(writes(takes_case(flowing), "Folder for summary and frames"))))))
      ->add_option("--law", options.law, "Law file of a fit; without it the case needs a section [law]");
  forces(shows_progress(parallel(dry(
      overrides(writes(takes_case(add(app, "dem", "Run the flow of a case with grains, in LIGGGHTS", dem)),
                       "Folder for summary and frames"))))));
  forces(shows_progress(threads(parallel(dry(overrides(writes(
             takes_case(add(app, "compare", "Grains and SPH on one geometry: how far they differ", compare)),
             "Folder for everything")))))))
      ->add_option("--law", options.law, "Law file of a fit; without it the case needs a section [law]");
  forces(shows_progress(threads(parallel(
             dry(overrides(writes(takes_case(add(app, "precision", "Error against run time", precision)),
                                  "Folder for everything")))))))
      ->add_option("--law", options.law, "Law file of a fit; without it the case needs a section [law]");
  forces(shows_progress(parallel(dry(overrides(
      writes(takes_case(add(app, "stability", "Where the numerics hold: a map of extremes", stability)),
             "Folder for everything"))))));
  CLI::App* running = add(app, "run", "The whole chain: grains, law, flow, report", run);
  forces(shows_progress(
      threads(parallel(dry(overrides(writes(takes_case(running), "Folder for everything")))))));
  add(app, "report", "Make report.html again from a folder of `run`", report)
      ->add_option("DIR", options.output, "Folder of `run`")
      ->required();
  CLI::App* exporting =
      forces(writes(add(app, "export", "Write a frame as text (CSV)", export_frame), "File to write"));
  exporting->add_option("FRAME", options.frame, "Frame (.h5)")->required();
  exporting->add_option("--fields", options.fields, "Fields, separated by commas")->capture_default_str();
  add(app, "seal", "Trust an HDF5 file that another program has made or changed: renew its checksum", seal)
      ->add_option("FILE", options.output, "HDF5 file")
      ->required();

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(ExitCode::usage);
  }
  if (chosen == sweep && (options.case_file.empty() || options.output.empty())) {
    fmt::print(stderr,
               "sweep needs a CASE and -o DIR (or: sweep status DIR, sweep retry DIR, sweep prune DIR)\n");
    return static_cast<int>(ExitCode::usage);
  }
  return static_cast<int>(chosen(options));
}

}  // namespace
}  // namespace dem2sph

int main(int argc, char** argv) {
  // Results go to stdout, everything else to stderr.
  spdlog::set_default_logger(spdlog::stderr_logger_mt("dem2sph"));
  spdlog::set_pattern("dem2sph: %v");
  dem2sph::install_stop_handlers();
  // A file that may not grow any more is to be an error of that write, as on a full disk, and no sudden
  // death.
  std::signal(SIGXFSZ, SIG_IGN);
  try {
    return dem2sph::program(argc, argv);
  } catch (const dem2sph::Error& error) {
    spdlog::error("{}", error.what());
    return static_cast<int>(error.code());
  } catch (const std::filesystem::filesystem_error& error) {
    spdlog::error("{}", error.what());
    return static_cast<int>(dem2sph::ExitCode::unreadable);
  } catch (const std::exception& error) {
    spdlog::error("this is a bug, please report it: {}", error.what());
    return static_cast<int>(dem2sph::ExitCode::bug);
  }
}
