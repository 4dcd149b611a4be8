// What a scene saves by what its composition leaves out, measured by switching each part on.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "cases/chain.hpp"

namespace dem2sph {

/// Steps of the flow of a case, with each part that it leaves out and without, in turns and on one thread.
/// Returns {"base": composition, "parts": [{part, setting, cost_ratio, low, high, steps_ratio,
/// bytes_ratio}]}; ratios are those of core-seconds for one second of the flow, of steps for the same, and of
/// bytes a particle; of `cost_ratio` the median of five turns with their least and largest. A part that
/// cannot be switched on in this scene has "refused" and why.
nlohmann::json measure_left_out(const std::filesystem::path& case_path, const LawFile& law,
                                const CommonOptions& options);

/// As a table for people.
std::string describe_left_out(const nlohmann::json& measured);

}  // namespace dem2sph
