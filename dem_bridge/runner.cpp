#include "dem_bridge/runner.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <fstream>
#include <map>
#include <set>
#include <span>
#include <sstream>
#include <utility>

#include "sph/base/errors.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"
#include "sph/base/subprocess.hpp"

namespace dem2sph::bridge {

namespace fs = std::filesystem;

std::string engine_program() {
  const char* chosen = std::getenv("DEM2SPH_LIGGGHTS");
  return chosen != nullptr && *chosen != '\0' ? chosen : "liggghts";
}

namespace {

std::string missing_engine() {
  return fmt::format(
      "LIGGGHTS not found (looked for \"{}\"): install it with `apt-get install --no-install-recommends "
      "liggghts`, or "
      "set DEM2SPH_LIGGGHTS to the program",
      engine_program());
}

/// stdbuf makes the engine write its output line by line: otherwise the text of an error is lost when stdout
/// is a file.
std::vector<std::string> engine_command(const std::vector<std::string>& arguments) {
  if (!program_exists(engine_program())) throw EngineError(missing_engine());
  std::vector<std::string> command;
  if (program_exists("stdbuf")) command = {"stdbuf", "-oL"};
  command.push_back(engine_program());
  command.insert(command.end(), arguments.begin(), arguments.end());
  return command;
}

SubprocessOptions engine_options(const fs::path& folder) {
  SubprocessOptions options;
  options.folder = folder;
  options.environment = {{"OMP_NUM_THREADS", "1"}, {"LC_ALL", "C"}};
  return options;
}

std::string printable(const std::string& text) {
  std::string clean;
  for (const char c : text)
    if (std::isprint(static_cast<unsigned char>(c)) != 0) clean += c;
  return clean;
}

bool has_line(const fs::path& path, const std::string& wanted) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);)
    if (line == wanted) return true;
  return false;
}

}  // namespace

std::string printable_tail(const fs::path& path, std::size_t lines) {
  std::ifstream file(path, std::ios::binary);
  std::deque<std::string> last;
  for (std::string line; std::getline(file, line);) {
    line = printable(line);
    if (line.find_first_not_of(' ') == std::string::npos) continue;
    last.push_back(line.substr(0, 300));
    if (last.size() > lines) last.pop_front();
  }
  std::string text;
  for (const std::string& line : last) text += (text.empty() ? "" : " | ") + line;
  return text;
}

namespace {

/// What the engine prints when it is started with `argument` and no input.
std::string ask_engine(const std::vector<std::string>& arguments) {
  static std::atomic<long> count{0};
  const fs::path output = fs::temp_directory_path() /
                          fmt::format("dem2sph-engine-{}-{}.txt", static_cast<long>(::getpid()), ++count);
  SubprocessOptions options = engine_options(fs::temp_directory_path());
  options.output = output;
  options.time_limit = 30;
  const SubprocessResult result = run_subprocess(engine_command(arguments), options);
  std::ostringstream text;
  text << std::ifstream(output).rdbuf();
  std::error_code ignored;  // a temporary file that stays behind harms nobody
  fs::remove(output, ignored);
  if (result.stopped) throw Interrupted("stopped while asking LIGGGHTS what it is");
  if (result.signal != 0)
    throw EngineError(fmt::format("\"{}\" was killed by signal {} while it was asked for its {}; try again",
                                  engine_program(), result.signal,
                                  arguments[0] == "-help" ? "styles" : "version"));
  return text.str();
}

}  // namespace

std::string engine_version() {
  // Without an input the engine prints its name and ends.
  const std::string text = ask_engine({"-log", "none"});
  const std::string first = text.substr(0, text.find('\n'));
  // "LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled 2022-...": the words between "Version" and the comma.
  const std::string key = "(Version ";
  const std::size_t at = first.find(key);
  const std::size_t comma = first.find(',');
  if (at == std::string::npos || comma == std::string::npos || comma < at)
    throw EngineError(fmt::format("\"{}\" does not report a LIGGGHTS version; its first line is \"{}\"",
                                  engine_program(), printable(first)));
  return printable(first.substr(at + key.size(), comma - at - key.size()));
}

void require_engine_features(const Sample& sample) {
  // The help lists every style after a title "* Fix styles:"; names stand between spaces and line ends.
  const std::string help = ask_engine({"-help"});
  std::map<std::string, std::set<std::string>> styles;
  std::string kind;
  std::istringstream lines(help);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t star = line.find("* ");
    if (star != std::string::npos) {
      kind = line.substr(star + 2, line.rfind(':') - star - 2);
      continue;
    }
    std::istringstream words(line);
    for (std::string word; words >> word;) styles[kind].insert(word);
  }
  if (styles["Pair styles"].empty())
    throw EngineError(
        fmt::format("\"{}\" does not list its styles with -help: no LIGGGHTS?", engine_program()));
  const GrainMaterial& m = sample.material;
  std::vector<std::pair<std::string, std::string>> needed{
      {"Atom styles", "granular"},
      {"Pair styles", "gran"},
      {"Normal models for pair gran", m.contact == ContactModel::hertz ? "hertz" : "hooke/stiffness"},
      {"Tangential models for pair gran", "history"},
      {"Compute styles", "pair/gran/local"},
      {"Dump styles", "custom"},
      {"Dump styles", "local"}};
  for (const char* fix : {"addforce", "ave/time", "deform", "freeze", "insert/pack", "nve/sphere",
                          "particletemplate/sphere", "property/global", "rigid", "viscous"})
    needed.emplace_back("Fix styles", fix);
  if (m.rolling_friction > 0) needed.emplace_back("Rolling models for pair gran", "epsd2");
  if (m.cohesion > 0) needed.emplace_back("Cohesion models for pair gran", "sjkr");
  std::string missing;
  for (const auto& [group, style] : needed)
    if (!styles[group].contains(style))
      missing += fmt::format("{}\"{}\" ({})", missing.empty() ? "" : ", ", style, group);
  if (!missing.empty())
    throw EngineError(fmt::format("\"{}\" was compiled without {}: Debian's package liggghts has all of them",
                                  engine_program(), missing));

  // Each model may be there and their combination not: that only an input tells.
  static std::atomic<long> count{0};
  const fs::path folder =
      fs::temp_directory_path() / fmt::format("dem2sph-probe-{}-{}", static_cast<long>(::getpid()), ++count);
  fs::create_directory(folder);
  const auto remove = [&] {
    std::error_code ignored;  // a temporary folder that stays behind harms nobody
    fs::remove_all(folder, ignored);
  };
  try {
    run_engine({.deck = probe_deck(sample), .sentinel = sentinel(3, 0)}, folder,
               {.seconds = 30, .memory = 0});
  } catch (const EngineError& error) {
    remove();
    throw EngineError(
        fmt::format("\"{}\" refuses the contact law of this material: {}", engine_program(), error.what()));
  } catch (...) {
    remove();
    throw;
  }
  remove();
}

EngineRun run_engine(const EngineJob& job, const fs::path& folder, const EngineLimits& limits) {
  // The engine does not notice a full disk (exit code 0, cut dumps): look before.
  const auto space = fs::space(folder);
  if (static_cast<double>(space.available) < 1.5 * job.dump_bytes)
    throw EngineError(fmt::format("{}: {:.0f} MB are free, but the dumps of this run need about {:.0f} MB",
                                  folder.string(), static_cast<double>(space.available) / 1e6,
                                  job.dump_bytes / 1e6));
  write_file_atomically(folder / job.deck_name, job.deck);
  const std::string output = fs::path(job.deck_name).stem() == fs::path(deck_file).stem()
                                 ? engine_output_file
                                 : fs::path(job.deck_name).stem().string() + ".out";

  SubprocessOptions options = engine_options(folder);
  options.output = folder / output;
  options.time_limit = limits.seconds;
  options.memory_limit = limits.memory;
  std::vector<std::string> command =
      engine_command({"-in", job.deck_name, "-log", fs::path(output).replace_extension(".log").string()});
  if (job.ranks > 1) {
    if (!program_exists("mpirun"))
      throw EngineError("ranks above 1 need mpirun: install it with `apt-get install openmpi-bin`");
    // Containers are root, and have fewer slots than ranks.
    const std::vector<std::string> launcher{"mpirun", "--allow-run-as-root", "--oversubscribe", "-np",
                                            std::to_string(job.ranks)};
    command.insert(command.begin(), launcher.begin(), launcher.end());
  }
  const SubprocessResult result = run_subprocess(command, options);
  if (result.stopped) throw Interrupted("stopped on request; the same command resumes");
  const auto refuse = [&](const std::string& what) {
    // Whoever stops every process makes the engine fail in any manner of ways, and our turn comes a moment
    // later.
    if (stop_follows()) throw Interrupted("stopped on request; the same command resumes");
    throw EngineError(fmt::format("{}; the engine's last words: {}", what, printable_tail(folder / output)));
  };
  if (!result.found) throw EngineError(missing_engine());
  if (result.timed_out)
    refuse(fmt::format("LIGGGHTS was ended at its time limit of {:.0f} s", limits.seconds));
  if (result.signal != 0) refuse(fmt::format("LIGGGHTS was killed by signal {}", result.signal));
  if (result.exit_code != 0) refuse(fmt::format("LIGGGHTS ended with code {}", result.exit_code));
  if (!has_line(folder / output, job.sentinel))
    refuse(fmt::format("LIGGGHTS never printed \"{}\"", job.sentinel));
  return {result.wall_seconds, result.cpu_seconds};
}

void check_restart(const Sample& sample, const fs::path& folder, const EngineLimits& limits) {
  run_engine(
      {.deck = check_deck(sample), .deck_name = check_deck_file, .sentinel = sentinel(sample.grains, 0)},
      folder, limits);
}

Measurement measurement_of(const Sample& sample, const Shearing& shearing, double core_margin) {
  const double d = sample.material.d;
  return {.d = d,
          .rho_s = sample.material.rho_s,
          .grain_friction = sample.material.grain_friction,
          .wall_thickness = wall_thickness_in_d * d,
          .core_margin = core_margin * d,
          .time_step = time_step(sample).step,
          .cohesion = sample.material.cohesion,
          .direction = shearing.direction};
}

WallMeans read_wall(const DeckPlan& plan, double load, double height, std::int64_t from_step,
                    const fs::path& folder) {
  const std::vector<WallSample> series = read_wall_series(folder / wall_series_file);
  if (static_cast<std::int64_t>(series.size()) != plan.wall_samples)
    throw EngineError(
        fmt::format("{} has {} lines, expected {}", wall_series_file, series.size(), plan.wall_samples));
  std::vector<std::array<double, 3>> rows;
  for (std::size_t i = 0; i < series.size(); ++i) {
    const WallSample& sample = series[i];
    const std::int64_t step =
        plan.last_step - (plan.wall_samples - 1 - static_cast<std::int64_t>(i)) * plan.frame_interval;
    if (sample.step != step)
      throw EngineError(
          fmt::format("{}: line {} is of step {}, expected {}", wall_series_file, i + 1, sample.step, step));
    if (step > from_step) rows.push_back({sample.p, sample.tau, sample.height});
  }
  if (rows.empty())
    throw EngineError(fmt::format("{} has no line beyond step {}", wall_series_file, from_step));
  const std::span<const std::array<double, 3>> all(rows);
  const auto mean = [&](std::size_t k) {
    return block_jackknife(all, [k](const std::array<double, 3>& m) { return m[k]; });
  };
  const Estimate p = mean(0);
  // Of a handful of lines there is no standard error: then the tolerance alone counts.
  const double error = std::isfinite(p.standard_error) ? p.standard_error : 0;
  const double judged = static_cast<double>(plan.last_step - from_step) * plan.time_step.step;
  const double tolerance =
      pressure_tolerance * std::max(1.0, pressure_responses * height * plan.inertial_time / judged);
  if (!(std::abs(p.value - load) < tolerance * load + 3 * error))
    throw UnfitRun(fmt::format(
        "the mean pressure on the wall is {:.4g} +- {:.2g} Pa instead of {:.4g} Pa (tolerance {:.2g} % and 3 "
        "standard errors)",
        p.value, error, load, 100 * tolerance));
  return {p.value, mean(1).value, mean(2).value};
}

CellRecord read_run(const Sample& sample, const Shearing& shearing, double core_margin,
                    const fs::path& folder) {
  const DeckPlan plan = plan_shearing(sample, shearing);
  const Measurement measurement = measurement_of(sample, shearing, core_margin);
  GrainDump grains(folder / grain_dump_file);
  ContactDump contacts(folder / contact_dump_file, ContactColumns{});
  CellRecord record;
  record.frames.reserve(static_cast<std::size_t>(plan.frames));
  GrainFrame grain_frame, before;
  ContactFrame contact_frame;
  while (true) {
    if (stop_requested()) throw Interrupted("stopped while reducing a run");
    const ReadResult first = grains.next(grain_frame);
    const ReadResult second = contacts.next(contact_frame);
    const auto here = record.frames.size();
    if (first == ReadResult::end && second == ReadResult::end) break;
    if (first != ReadResult::frame || second != ReadResult::frame)
      throw EngineError(fmt::format("{} breaks off after {} of {} frames",
                                    first != ReadResult::frame ? grain_dump_file : contact_dump_file, here,
                                    plan.frames));
    const std::int64_t step = static_cast<std::int64_t>(here) * plan.frame_interval;
    if (grain_frame.step != step)
      throw EngineError(fmt::format("frame {} is of step {}, expected {}", here, grain_frame.step, step));
    if (static_cast<std::int64_t>(grain_frame.grains.size()) != sample.grains)
      throw EngineError(
          fmt::format("{} grains at step {}, expected {}", grain_frame.grains.size(), step, sample.grains));
    record.frames.push_back(
        measure_core(grain_frame, contact_frame, measurement, record.frames.empty() ? nullptr : &before));
    std::swap(before, grain_frame);
  }
  if (static_cast<std::int64_t>(record.frames.size()) != plan.frames)
    throw EngineError(fmt::format("{} frames in the dumps, expected {}", record.frames.size(), plan.frames));
  integrate_strain(record.frames, plan.time_step.step);

  // While a start-up dilates it pushes the piston up, and the wall's pressure is above its set value by what
  // accelerates it: there the second half of the strain is judged.
  const double reached = record.frames.back().strain;
  const double wall_from = shearing.strain_dropped > 0 ? shearing.strain_dropped : 0.5 * reached;
  std::int64_t wall_from_step = plan.last_step;
  std::size_t used = 0;
  for (const CoreState& f : record.frames) {
    record.largest_overlap = std::max(record.largest_overlap, f.largest_overlap / sample.material.d);
    if (f.strain >= wall_from) wall_from_step = std::min(wall_from_step, f.step);
    if (f.strain < shearing.strain_dropped) continue;
    ++used;
    record.overlap += f.largest_overlap / sample.material.d;
    record.cut_contacts += f.cut_contacts;
  }
  if (used < 2)
    throw UnfitRun(
        fmt::format("the core was sheared by {:.3g} only, not more than the {:.3g} that is dropped", reached,
                    shearing.strain_dropped));
  record.overlap /= static_cast<double>(used);
  record.cut_contacts /= static_cast<double>(used);
  if (!(record.overlap < overlap_limit))
    throw UnfitRun(
        fmt::format("grains overlap by {:.2g} d (the largest of a frame, averaged; limit {:g} d): they "
                    "are too soft for this pressure and speed",
                    record.overlap, overlap_limit));
  record.wall = read_wall(plan, shearing.pressure, expected_gap(sample) + 2 * wall_thickness_in_d,
                          wall_from_step, folder);
  return record;
}

}  // namespace dem2sph::bridge
