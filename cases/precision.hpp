// Error against run time: `dem2sph precision`.
//
//   DIR/sph/NAME/          one SPH flow a resolution, step factor and formulation
//   DIR/grains/scale_K/    grains of K d, if asked for: what one would do instead of a continuum
//   DIR/precision.json, precision.csv, report.html
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "cases/chain.hpp"

namespace dem2sph {

extern const ParameterTable precision_table;

/// Runs what is missing. Returns precision.json.
nlohmann::json run_precision(const std::filesystem::path& case_path, const std::filesystem::path& law_path,
                             const std::filesystem::path& folder, const CommonOptions& options);

std::string plan_precision(const std::filesystem::path& case_path, const std::filesystem::path& law_path,
                           const CommonOptions& options);

}  // namespace dem2sph
