// The runs that a case file asks for: what each is, what it begins with, what it costs, and the name of its
// folder.
//
// A run begins with the restart file of another one, so the runs form short chains:
//
//   packing ── steady
//           ├─ start_up
//           └─ pre_shear ── jump, reversal, pressure_jump
//
// Its name is a hash of everything that its result depends on: its own parameters, the name of the run it
// begins with, the deck's and the engine's version. So a packing is made once, whatever is done with it.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "dem_bridge/deck.hpp"
#include "dem_bridge/runner.hpp"
#include "sph/base/case_file.hpp"

namespace dem2sph::bridge {

enum class RunKind { packing, pre_shear, steady, start_up, jump, reversal, pressure_jump };
std::string name_of(RunKind kind);
/// Throws InputError for a word that is no kind.
RunKind kind_of(const std::string& name);
/// It only makes a restart file for others.
bool prepares(RunKind kind);

/// One run of a sweep.
struct RunPlan {
  RunKind kind = RunKind::steady;
  Sample sample;
  Shearing shearing;         ///< not of a packing
  std::string begins_with;   ///< hash of the run whose restart file it reads; empty: a packing
  double I_before = 0;       ///< driven, of a run that begins with a pre_shear
  double core_margin = 4;    ///< distance of the core from the walls' faces, in d
  double window = 0;         ///< transients: strain that one entry of the series averages over
  std::string hash;          ///< names its folder
  DeckPlan deck;             ///< steps, frames, expected core-seconds and bytes
  double chain_seconds = 0;  ///< expected core-seconds of the longest chain that starts with it
};
/// "steady I = 0.1 seed 1"
std::string title(const RunPlan& run);
/// What names it, without what follows from that.
nlohmann::json to_json(const RunPlan& run);
/// With hash and deck plan. Throws InputError for a damaged one, UsageError for values that make no cell.
RunPlan run_from_json(const nlohmann::json& json, const std::string& engine);

/// What happens to a run that has failed.
enum class FailurePolicy {
  skip,   ///< it is recorded, the others go on
  abort,  ///< it is recorded, nothing new is started
  retry   ///< it is tried again, unless it would fail again the same way; then skip
};

struct SweepPlan {
  std::vector<RunPlan> runs;  ///< the longest chain first
  std::string engine;         ///< as the engine reports itself, or engine_unknown
  std::string material;       ///< effective sections, as TOML
  double pressure = 0;        ///< [Pa]
  GrainMaterial grains;
  EngineLimits limits;
  FailurePolicy on_failure = FailurePolicy::retry;
  long retries = 2;
  bool keep_dumps = false;
  double core_seconds() const;
  /// Wall time with `jobs` at once, each run given to the worker that is free first.
  double wall_seconds(int jobs) const;
};

/// Stands for the engine's version when one only looks.
inline constexpr const char* engine_unknown = "unknown";

/// Sections of a case file that a sweep reads; the driver adds them to its own for validate().
std::vector<const ParameterTable*> sweep_tables();
/// Reads and checks the sections of the case. `engine` is engine_version(), or engine_unknown to look without
/// LIGGGHTS. Throws UsageError with file and line.
SweepPlan plan_sweep(const CaseFile& case_file, const std::string& engine);
/// The plan as text: one line a run, and the time step with its margins.
std::string describe(const SweepPlan& plan, int jobs);

nlohmann::json to_json(const SweepPlan& plan);
/// Throws InputError.
SweepPlan sweep_from_json(const nlohmann::json& json);

}  // namespace dem2sph::bridge
