// Runs one deck in LIGGGHTS and decides, on evidence, whether it may be believed.
//
// The engine's exit code proves little: it is 0 after atoms were lost, after a full disk, and sometimes after
// a SIGTERM. A run counts only if the deck's sentinel was printed with the expected step, every frame of both
// dumps is there, whole and at the expected step, no grain went missing, grains hardly overlap, the wall's
// mean pressure is the set one, a restart file can be read back. Everything else throws EngineError with the
// reason.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "dem_bridge/deck.hpp"
#include "dem_bridge/reduce.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {

/// The largest overlap of a frame, averaged over the frames that are used, over d. Beyond this the grains are
/// so soft that their stiffness takes part in the flow.
inline constexpr double overlap_limit = 0.05;
/// Mean pressure on the wall against the set one, beyond three standard errors of the mean. What is left over
/// is the momentum that the piston gains, which is bounded, so it falls with the time averaged over: the
/// tolerance holds for `pressure_responses` response times H sqrt(rho_s/P) of cell and piston, and grows in
/// inverse proportion if fewer are averaged.
inline constexpr double pressure_tolerance = 0.05;
inline constexpr double pressure_responses = 4;

/// A run that ended as it should, but is not what was asked for. The same run would end the same way.
struct UnfitRun : EngineError {
  using EngineError::EngineError;
};

struct EngineLimits {
  double seconds = 0;      ///< wall time of one run; 0: none
  std::size_t memory = 0;  ///< bytes of address space; 0: none
};

/// Program to start: the environment's DEM2SPH_LIGGGHTS, or "liggghts" on the PATH.
std::string engine_program();

/// "LIGGGHTS-PUBLIC 3.8.0", as the engine reports itself. Throws EngineError with the package to install if
/// it is missing.
std::string engine_version();

/// Asks the engine which styles are compiled in. Throws EngineError that names what the material's decks need
/// and the engine lacks.
void require_engine_features(const Sample& sample);

struct EngineRun {
  double wall_seconds = 0;
  double cpu_seconds = 0;
};

/// What is run: the text of a deck and how its end is known.
struct EngineJob {
  std::string deck;
  std::string deck_name = deck_file;
  std::string sentinel;
  std::int64_t ranks = 1;  ///< above 1: under mpirun
  double dump_bytes = 0;   ///< free space that it needs
};

/// Writes the deck into `folder` (which exists), runs it there and checks sentinel and exit.
/// Throws EngineError with the reason, Interrupted if a stop was requested.
EngineRun run_engine(const EngineJob& job, const std::filesystem::path& folder, const EngineLimits& limits);

/// Reads the restart file in `folder` back with the engine: it is whole and holds all grains.
void check_restart(const Sample& sample, const std::filesystem::path& folder, const EngineLimits& limits);

/// Means of the force on the top wall, its mean pressure checked against the load.
struct WallMeans {
  double p = 0, tau = 0;  ///< [Pa]
  double height = 0;      ///< [m]
};
/// The wall's series of `plan`, which must be complete; averaged beyond `from_step`. `height` is that of cell
/// and walls in d, which sets the response time; 0 for a sample at rest.
WallMeans read_wall(const DeckPlan& plan, double load, double height, std::int64_t from_step,
                    const std::filesystem::path& folder);

/// What a finished run's files say, checked.
struct CellRecord {
  std::vector<CoreState> frames;  ///< strain integrated
  /// Beyond strain_dropped; of a transient (nothing dropped), the second half of its strain.
  WallMeans wall;
  double overlap = 0;          ///< mean over the used frames of a frame's largest overlap, in d
  double largest_overlap = 0;  ///< of all frames, in d
  double cut_contacts = 0;     ///< mean fraction of contacts cut back to Coulomb's limit
};

/// Reads and reduces the dumps frame by frame. "Used" are frames beyond `strain_dropped` of core strain.
/// Throws EngineError where the evidence is missing, InputError with file and line where a file is damaged.
CellRecord read_run(const Sample& sample, const Shearing& shearing, double core_margin,
                    const std::filesystem::path& folder);

/// `core_margin` in d.
Measurement measurement_of(const Sample& sample, const Shearing& shearing, double core_margin);

/// The last lines of a file with unprintable characters removed, for messages.
std::string printable_tail(const std::filesystem::path& path, std::size_t lines = 4);

}  // namespace dem2sph::bridge
