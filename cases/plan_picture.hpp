// One geometry, two engines, as a picture: what `dem2sph plan CASE --svg FILE` draws.
#pragma once

#include <string>

#include "sph/base/case_file.hpp"

namespace dem2sph {

/// SPH particles and walls at t = 0, and, if the case has grains, the grains glued to walls, the bodies that
/// will be filled and the grains on the loose lattice that they fall from; both over x and up, on one scale,
/// in 3D the first 2 d across. Throws UsageError for a case that has no flow.
std::string picture_of_plan(const CaseFile& file);

}  // namespace dem2sph
