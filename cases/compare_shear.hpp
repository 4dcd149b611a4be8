// Plane shear back to its own data: what the solver shows with the law, beside the steady points of the shear
// cells that the law was fitted to.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "cases/chain.hpp"

namespace dem2sph {

/// What it would run. Throws UsageError for what it would refuse.
std::string plan_shear_comparison(const CaseFile& file, const LawFile& law, const CommonOptions& options);

/// Runs the SPH of a case of plane shear at the rate and pressure of each steady condition of
/// `compare.observables`, over a strain of `compare.strain`, and returns what `run_comparison` does; writes
/// comparison.json and report.html into `folder`.
nlohmann::json run_shear_comparison(const CaseFile& file, const LawFile& law,
                                    const std::filesystem::path& folder, const CommonOptions& options);

}  // namespace dem2sph
