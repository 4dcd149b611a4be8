// A case's geometry filled with grains: `dem2sph dem`.
//
//   DIR/seed_1/summary.json, frames/ ...   each seed's flow, in the words of an SPH flow
//   DIR/summary.json                       means over the seeds with their spread
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cases/chain.hpp"
#include "dem_bridge/grain_flow_run.hpp"

namespace dem2sph {

/// One run a seed, with grains of `scale` times their diameter. `engine` as the engine reports itself. Throws
/// UsageError for a case that grains cannot have.
std::vector<bridge::GrainFlowJob> grain_jobs(const CaseFile& file, const std::string& engine,
                                             double scale = 1);

std::string plan_grains(const CaseFile& file);

/// Runs what is missing, `options.jobs` at once. Returns DIR/summary.json.
nlohmann::json run_grains(const CaseFile& file, const std::filesystem::path& folder,
                          const CommonOptions& options, double scale = 1);

}  // namespace dem2sph
