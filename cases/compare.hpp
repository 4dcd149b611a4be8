// Grains and SPH on one geometry: `dem2sph compare`.
//
//   DIR/grains/seed_N/, DIR/without_dilation/, DIR/with_dilation/   the flows
//   DIR/comparison.json, DIR/report.html                            by how much they differ, and what they
//   cost
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "cases/chain.hpp"

namespace dem2sph {

/// What is measured in a scene of its own geometry.
extern const ParameterTable compare_table;

/// Runs what is missing of both and compares. `law_path` may be empty if the case has a section [law].
/// Returns comparison.json.
nlohmann::json run_comparison(const std::filesystem::path& case_path, const std::filesystem::path& law_path,
                              const std::filesystem::path& folder, const CommonOptions& options);

std::string plan_comparison(const std::filesystem::path& case_path, const std::filesystem::path& law_path,
                            const CommonOptions& options);

}  // namespace dem2sph
