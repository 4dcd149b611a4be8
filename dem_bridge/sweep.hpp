// A sweep: runs what is missing of a plan's runs, many at once, and collects the observables of those that
// are done.
//
// The file system is the queue. `runs/<hash>/` belongs to exactly one run, so it can be reused by any study;
// a claim in it says who works on it; `done.json` holds the reduced results of a run that passed every check,
// `failed.json` the reason of one that did not. Nothing else counts.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "dem_bridge/observables.hpp"
#include "dem_bridge/plan.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {

struct SweepOptions {
  std::filesystem::path folder;
  int jobs = 1;
  bool quiet = false;
};

struct SweepResult {
  std::size_t ran = 0;              ///< done by this call
  std::size_t reused = 0;           ///< done before
  std::vector<ExcludedRun> failed;  ///< and those that begin with one that failed
  std::size_t elsewhere = 0;        ///< claimed by another sweep that is still alive
  Observables observables;
  /// ok, engine (something failed) or interrupted (others still work: the same command collects them)
  ExitCode exit_code() const;
};

/// Runs what is missing, then writes `observables.h5` from all that is done. What failed, or is held by
/// another sweep, is named in a warning. Throws EngineError if LIGGGHTS is missing and needed, or a run
/// failed and the policy is abort; Interrupted on SIGINT or SIGTERM (what is done is kept).
SweepResult run_sweep(const SweepPlan& plan, const SweepOptions& options);

enum class RunState { waiting, running, done, failed, abandoned };
std::string name_of(RunState state);

struct RunStatus {
  std::string hash;
  std::string what;  ///< "steady I = 0.1 seed 1"
  RunState state = RunState::waiting;
  std::string detail;       ///< reason of a failure, or who works on it
  double core_seconds = 0;  ///< used when done, else expected from the runs that are done
};

struct SweepStatus {
  std::vector<RunStatus> runs;
  double core_seconds_left = 0;
  int working = 0;  ///< runs that are under way
  /// Measured over expected core-seconds of what is done: the machine's speed against ours. 1 if nothing is.
  double slowness = 1;
};

/// State of every run of the sweep that last wrote into `folder`. Throws InputError if there was none.
SweepStatus sweep_status(const std::filesystem::path& folder);
std::string describe(const SweepStatus& status);

/// Forgets the failures of the sweep in `folder` and runs it again; what is done is kept.
SweepResult retry_sweep(const SweepOptions& options);

/// Removes what only a repetition of the runs that are done would need: dumps, restart files, failed
/// attempts. Runs that are being worked on are left alone. Returns the bytes.
std::uintmax_t prune_sweep(const std::filesystem::path& folder);

}  // namespace dem2sph::bridge
