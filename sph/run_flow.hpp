// Runs one flow from start to end: frames, checkpoints, the summary; resumes what was interrupted.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "sph/base/case_file.hpp"
#include "sph/base/law_file.hpp"

namespace dem2sph {

struct FlowOptions {
  std::filesystem::path folder;  ///< where everything is written
  bool force = false;            ///< overwrite the results of an earlier run
  bool reuse = false;            ///< take the summary of an earlier run of the same configuration
  bool quiet = false;
  int threads = 0;  ///< 0: as many as the size of the flow is worth
};

/// Runs the flow of `file` with `law`; writes summary.json, frames/*.h5, frames/*.vtp, frames.pvd and
/// checkpoint.h5 into the folder and returns the summary (fields: sph/README.md). A folder with a finished
/// run is refused unless forced; one with a checkpoint of the same configuration is resumed. Throws
/// NumericalError (the last checkpoint is kept), Interrupted after a stop was requested.
nlohmann::json run_flow(const CaseFile& file, const LawFile& law, const FlowOptions& options);

/// What run_flow would do: composition, what is left out and what that saves, particles, memory, steps and
/// time.
std::string plan_flow(const CaseFile& file, const LawFile& law);

}  // namespace dem2sph
