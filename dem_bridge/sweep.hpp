// A sweep: the list of shear-cell runs that a case file asks for, each a folder that its own contents name.
//
// The file system is the queue. `runs/<hash>/` belongs to exactly one set of parameters, deck version, engine
// version and seed, so it can be reused by any study; `claim/` in it (an atomic mkdir and a heartbeat) says
// who works on it; `done.json` holds the reduced results of a run that passed every check, `failed.json` the
// reason of one that did not. Nothing else counts.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "dem_bridge/deck.hpp"
#include "dem_bridge/observables.hpp"
#include "dem_bridge/runner.hpp"
#include "sph/base/case_file.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {

/// Sections of a case file that a sweep reads; the driver adds them to its own for validate().
std::vector<const ParameterTable*> sweep_tables();

enum class RunKind { steady, start_up };
std::string name_of(RunKind kind);

/// One run of a sweep.
struct RunPlan {
  RunKind kind = RunKind::steady;
  ShearCell cell;
  double window = 0;  ///< start-ups: strain that one entry of the series averages over
  std::string hash;   ///< names its folder
  DeckPlan deck;      ///< steps, frames, expected core-seconds and bytes
};

struct SweepPlan {
  std::vector<RunPlan> runs;  ///< the most expensive first
  std::string engine;         ///< as the engine reports itself, or "unknown"
  std::string material;       ///< effective sections, as TOML
  EngineLimits limits;
  bool keep_dumps = false;
  double core_seconds() const;
  /// Wall time with `jobs` at once, each run given to the worker that is free first.
  double wall_seconds(int jobs) const;
};

/// Reads and checks the sections of the case. `engine` is engine_version(), or "unknown" to look without
/// LIGGGHTS. Throws UsageError with file and line.
SweepPlan plan_sweep(const CaseFile& case_file, const std::string& engine);
/// The plan as text: one line a run.
std::string describe(const SweepPlan& plan, int jobs);

struct SweepOptions {
  std::filesystem::path folder;
  int jobs = 1;
  bool quiet = false;
};

struct SweepResult {
  std::size_t ran = 0;     ///< done by this call
  std::size_t reused = 0;  ///< done before
  std::vector<ExcludedRun> failed;
  std::size_t elsewhere = 0;  ///< claimed by another sweep that is still alive
  double cpu_seconds = 0;     ///< of all runs in the observables
  Observables observables;
  /// ok, engine (something failed) or interrupted (others still work: the same command collects them)
  ExitCode exit_code() const;
};

/// Runs what is missing, then writes `observables.h5` from all that is done. A failed run is recorded and the
/// others go on; what failed, or is held by another sweep, is named in a warning. Throws EngineError if
/// LIGGGHTS is missing and needed, Interrupted on SIGINT or SIGTERM (what is done is kept).
SweepResult run_sweep(const SweepPlan& plan, const SweepOptions& options);

enum class RunState { waiting, running, done, failed, abandoned };
std::string name_of(RunState state);

struct RunStatus {
  std::string hash;
  std::string what;  ///< "steady I = 0.1 seed 1"
  RunState state = RunState::waiting;
  std::string detail;       ///< reason of a failure, or who works on it
  double core_seconds = 0;  ///< expected, or used when done
};

/// State of every run of the sweep that last wrote into `folder`. Throws InputError if there was none.
std::vector<RunStatus> sweep_status(const std::filesystem::path& folder);
std::string describe(const std::vector<RunStatus>& status);

/// Forgets the failures of the sweep in `folder` and runs it again; what is done is kept.
SweepResult retry_sweep(const SweepOptions& options);

}  // namespace dem2sph::bridge
