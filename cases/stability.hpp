// Where the numerics hold: `dem2sph stability`.
//
//   DIR/cells/NAME/     one small flow an extreme: its case file, what it said, its summary
//   DIR/grains/NAME/    one small shear cell an extreme of the DEM side
//   DIR/stability.json, stability.svg, report.html
//
// Each cell is a run of this program by itself, by the command that stability.json names, so that one that
// dies takes nothing with it.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "cases/chain.hpp"

namespace dem2sph {

extern const ParameterTable stability_table;

/// Runs what is missing of the matrix with the material and the formulation of the case. Returns
/// stability.json; "unexplained" counts the cells that ended in no way that a user could act on.
nlohmann::json run_stability(const std::filesystem::path& case_path, const std::filesystem::path& folder,
                             const CommonOptions& options);

std::string plan_stability(const std::filesystem::path& case_path, const CommonOptions& options);

}  // namespace dem2sph
