// The map of `dem2sph stability` for people: stability.svg and report.html.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

namespace dem2sph {

/// Writes both into `folder` from stability.json.
void write_stability_page(const nlohmann::json& result, const std::filesystem::path& folder);

/// As text for the terminal: counts, what is unexplained, the longest steps.
std::string describe_stability(const nlohmann::json& result);

}  // namespace dem2sph
