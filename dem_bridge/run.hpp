// The life of one run: its folder, its engine, its reduction, its verdict.
//
// All work is done in a folder of its own, `attempt.<claim>/`, so that an engine that outlives its sweep can
// disturb nobody. What it made moves into the run's folder once everything has been checked, and `done.json`
// is written last. A run that failed leaves its attempt as `failed/` and the reason in `failed.json`.
#pragma once

#include <filesystem>
#include <string>

#include "dem_bridge/claim.hpp"
#include "dem_bridge/observables.hpp"
#include "dem_bridge/plan.hpp"

namespace dem2sph::bridge {

/// Raise it when a change of the reduction changes results: runs whose dumps were kept are then reduced
/// again, the others are run again.
inline constexpr int reduction_version = 4;

std::filesystem::path folder_of(const std::filesystem::path& sweep_folder, const RunPlan& run);
/// Has a verdict of this version, and, if it prepares others, its restart file.
bool is_done(const RunPlan& run, const std::filesystem::path& folder);
bool is_failed(const std::filesystem::path& folder);

/// Core-seconds that a run with a verdict took.
double measured_core_seconds(const std::filesystem::path& folder);
std::string reason_of_failure(const std::filesystem::path& folder);
/// Forgets a failure.
void clear_failure(const std::filesystem::path& folder);

/// Runs the engine, checks, reduces and writes done.json. If it is there from an older reduction and the
/// dumps are too, only the reduction is repeated. Throws EngineError or InputError with the reason if the run
/// has failed, UnfitRun if it would fail again, Interrupted if a stop was requested or the claim was lost.
void carry_out(const RunPlan& run, const SweepPlan& plan, const std::filesystem::path& sweep_folder,
               const Claim& claim);

/// Writes failed.json and keeps the attempt.
void record_failure(const RunPlan& run, const std::filesystem::path& folder, const std::string& reason,
                    long attempts);

/// Adds the result of a run that is done. Throws InputError if done.json is damaged.
void collect(const RunPlan& run, const std::filesystem::path& folder, Observables& observables);

/// Removes what only a repetition would need: dumps, restart file, failed attempts. Returns the bytes.
std::uintmax_t prune(const std::filesystem::path& folder);

}  // namespace dem2sph::bridge
