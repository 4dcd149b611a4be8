// Runs one shear cell in LIGGGHTS and decides, on evidence, whether it may be believed.
//
// The engine's exit code proves little: it is 0 after atoms were lost, after a full disk, and sometimes after
// a SIGTERM. A run counts only if the deck's sentinel was printed with the expected step, every frame of both
// dumps is there, whole and at the expected step, no grain went missing, grains hardly overlap and the wall's
// mean pressure is the set one. Everything else throws EngineError with the reason.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "dem_bridge/deck.hpp"
#include "dem_bridge/reduce.hpp"

namespace dem2sph::bridge {

/// The largest overlap of a frame, averaged over the frames that are used, over d. Beyond this the grains are
/// so soft that their stiffness takes part in the flow.
inline constexpr double overlap_limit = 0.05;
/// Mean pressure on the wall against the set one. The load holds it to 0.5 %; at I = 1 the mean over 60
/// strains has a statistical error of 1.5 % (measured), three times which is within 5 %.
inline constexpr double pressure_tolerance = 0.05;

struct EngineLimits {
  double seconds = 0;      ///< wall time of one run; 0: none
  std::size_t memory = 0;  ///< bytes of address space; 0: none
};

/// Program to start: the environment's DEM2SPH_LIGGGHTS, or "liggghts" on the PATH.
std::string engine_program();

/// "LIGGGHTS-PUBLIC 3.8.0", as the engine reports itself. Throws EngineError with the package to install if
/// it is missing.
std::string engine_version();

struct EngineRun {
  double wall_seconds = 0;
  double cpu_seconds = 0;
};

/// Writes the deck into `folder` (which exists), runs it there and checks sentinel and exit.
/// Throws EngineError with the reason, Interrupted if a stop was requested.
EngineRun run_engine(const ShearCell& cell, const std::filesystem::path& folder, const EngineLimits& limits);

/// What a finished run's files say, checked.
struct CellRecord {
  std::vector<CoreState> frames;  ///< strain integrated
  std::vector<WallSample> wall;   ///< beyond strain_dropped; of a start-up (nothing dropped), the second half
  double wall_p = 0, wall_tau = 0;  ///< means over these [Pa]
  double overlap = 0;               ///< mean over the used frames of a frame's largest overlap, in d
  double largest_overlap = 0;       ///< of all frames, in d
  double cut_contacts = 0;          ///< mean fraction of contacts cut back to Coulomb's limit
};

/// Reads and reduces the dumps frame by frame. "Used" are frames beyond `cell.strain_dropped` of core strain.
/// Throws EngineError where the evidence is missing, InputError with file and line where a file is damaged.
CellRecord read_run(const ShearCell& cell, const std::filesystem::path& folder);

Measurement measurement_of(const ShearCell& cell);

/// The last lines of a file with unprintable characters removed, for messages.
std::string printable_tail(const std::filesystem::path& path, std::size_t lines = 4);

}  // namespace dem2sph::bridge
