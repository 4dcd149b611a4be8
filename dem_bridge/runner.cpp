#include "dem_bridge/runner.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <fstream>

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

std::string engine_version() {
  // Without an input the engine prints its name and ends.
  const fs::path output =
      fs::temp_directory_path() / fmt::format("dem2sph-engine-{}.txt", static_cast<long>(::getpid()));
  SubprocessOptions options = engine_options(fs::temp_directory_path());
  options.output = output;
  options.time_limit = 30;
  const SubprocessResult result = run_subprocess(engine_command({"-log", "none"}), options);
  std::string first;
  {
    std::ifstream file(output);
    std::getline(file, first);
  }
  std::error_code ignored;  // a temporary file that stays behind harms nobody
  fs::remove(output, ignored);
  if (result.stopped) throw Interrupted("stopped while asking LIGGGHTS for its version");
  // "LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled 2022-...": the words between "Version" and the comma.
  const std::string key = "(Version ";
  const std::size_t at = first.find(key);
  const std::size_t comma = first.find(',');
  if (at == std::string::npos || comma == std::string::npos || comma < at)
    throw EngineError(fmt::format("\"{}\" does not report a LIGGGHTS version; its first line is \"{}\"",
                                  engine_program(), printable(first)));
  return printable(first.substr(at + key.size(), comma - at - key.size()));
}

EngineRun run_engine(const ShearCell& cell, const fs::path& folder, const EngineLimits& limits) {
  const DeckPlan plan = plan_deck(cell);
  // The engine does not notice a full disk (exit code 0, cut dumps): look before.
  const auto space = fs::space(folder);
  if (static_cast<double>(space.available) < 1.5 * plan.dump_bytes)
    throw EngineError(fmt::format("{}: {:.0f} MB are free, but the dumps of this run need about {:.0f} MB",
                                  folder.string(), static_cast<double>(space.available) / 1e6,
                                  plan.dump_bytes / 1e6));
  // What an earlier attempt left must not pass for this one's.
  for (const char* name : {grain_dump_file, contact_dump_file, wall_series_file, engine_output_file})
    fs::remove(folder / name);
  write_file_atomically(folder / deck_file, write_deck(cell));
  // LIGGGHTS names none of the columns of a local dump: their meaning is kept beside it.
  write_file_atomically(folder / "columns.json",
                        R"({"contacts.dump": ["id_1", "id_2", "periodic", "force_x", "force_y", "force_z"]})"
                        "\n");

  SubprocessOptions options = engine_options(folder);
  options.output = folder / engine_output_file;
  options.time_limit = limits.seconds;
  options.memory_limit = limits.memory;
  const SubprocessResult result =
      run_subprocess(engine_command({"-in", deck_file, "-log", engine_log_file}), options);
  if (result.stopped) throw Interrupted("stopped on request; the same command resumes");
  const auto refuse = [&](const std::string& what) {
    throw EngineError(
        fmt::format("{}; the engine's last words: {}", what, printable_tail(folder / engine_output_file)));
  };
  if (!result.found) throw EngineError(missing_engine());
  if (result.timed_out)
    refuse(fmt::format("LIGGGHTS was ended at its time limit of {:.0f} s", limits.seconds));
  if (result.signal != 0) refuse(fmt::format("LIGGGHTS was killed by signal {}", result.signal));
  if (result.exit_code != 0) refuse(fmt::format("LIGGGHTS ended with code {}", result.exit_code));
  if (!has_line(folder / engine_output_file, sentinel(cell)))
    refuse(fmt::format("LIGGGHTS never printed \"{}\"", sentinel(cell)));
  return {result.wall_seconds, result.cpu_seconds};
}

Measurement measurement_of(const ShearCell& cell) {
  const double d = cell.material.d;
  return {.d = d,
          .rho_s = cell.material.rho_s,
          .grain_friction = cell.material.grain_friction,
          .wall_thickness = wall_thickness_in_d * d,
          .core_margin = cell.core_margin * d,
          .time_step = plan_deck(cell).time_step};
}

CellRecord read_run(const ShearCell& cell, const fs::path& folder) {
  const DeckPlan plan = plan_deck(cell);
  const Measurement measurement = measurement_of(cell);
  GrainDump grains(folder / grain_dump_file);
  ContactDump contacts(folder / contact_dump_file, ContactColumns{});
  CellRecord record;
  record.frames.reserve(static_cast<std::size_t>(plan.frames));
  GrainFrame grain_frame;
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
    const std::int64_t step = plan.shear_start + static_cast<std::int64_t>(here) * plan.frame_interval;
    if (grain_frame.step != step)
      throw EngineError(fmt::format("frame {} is of step {}, expected {}", here, grain_frame.step, step));
    if (static_cast<std::int64_t>(grain_frame.grains.size()) != cell.grains)
      throw EngineError(
          fmt::format("{} grains at step {}, expected {}", grain_frame.grains.size(), step, cell.grains));
    record.frames.push_back(measure_core(grain_frame, contact_frame, measurement));
  }
  if (static_cast<std::int64_t>(record.frames.size()) != plan.frames)
    throw EngineError(fmt::format("{} frames in the dumps, expected {}", record.frames.size(), plan.frames));
  integrate_strain(record.frames, plan.time_step);

  // While a start-up dilates it pushes the piston up, and the wall's pressure is above its set value by what
  // accelerates it: there the second half of the strain is judged.
  const double wall_from = cell.strain_dropped > 0 ? cell.strain_dropped : 0.5 * record.frames.back().strain;
  std::int64_t wall_from_step = plan.last_step;
  std::size_t used = 0, wall_used = 0;
  for (const CoreState& f : record.frames) {
    record.largest_overlap = std::max(record.largest_overlap, f.largest_overlap / cell.material.d);
    if (f.strain >= wall_from) {
      wall_from_step = std::min(wall_from_step, f.step);
      ++wall_used;
    }
    if (f.strain < cell.strain_dropped) continue;
    ++used;
    record.overlap += f.largest_overlap / cell.material.d;
    record.cut_contacts += f.cut_contacts;
  }
  if (used == 0)
    throw EngineError(fmt::format("the core was sheared by {:.3g} only, less than the {:.3g} that is dropped",
                                  record.frames.back().strain, cell.strain_dropped));
  record.overlap /= static_cast<double>(used);
  record.cut_contacts /= static_cast<double>(used);
  if (!(record.overlap < overlap_limit))
    throw EngineError(
        fmt::format("grains overlap by {:.2g} d (the largest of a frame, averaged; limit {:g} d): they are "
                    "too soft for this pressure and speed",
                    record.overlap, overlap_limit));

  for (const WallSample& sample : read_wall_series(folder / wall_series_file))
    if (sample.step > wall_from_step) record.wall.push_back(sample);
  if (record.wall.empty() || record.wall.size() + 1 < wall_used)
    throw EngineError(
        fmt::format("{} has {} lines for {} frames", wall_series_file, record.wall.size(), wall_used));
  for (const WallSample& sample : record.wall) {
    record.wall_p += sample.p / static_cast<double>(record.wall.size());
    record.wall_tau += sample.tau / static_cast<double>(record.wall.size());
  }
  if (!(std::abs(record.wall_p / cell.pressure - 1) < pressure_tolerance))
    throw EngineError(
        fmt::format("the mean pressure on the wall is {:.4g} Pa instead of {:.4g} Pa (tolerance {:g} %)",
                    record.wall_p, cell.pressure, 100 * pressure_tolerance));
  return record;
}

}  // namespace dem2sph::bridge
