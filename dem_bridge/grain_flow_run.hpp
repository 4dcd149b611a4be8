// Runs a flow of grains and says what it did, in the same words and by the same functions as a flow of SPH.
//
//   DIR/engine/       decks, what LIGGGHTS said, the settled sample's restart file
//   DIR/frames/       grains at even times: .h5 and .vtp, DIR/frames.pvd names them for ParaView
//   DIR/summary.json  front, height, energies over time, profiles, what it cost
//
// A killed run begins its deck again; a sample that has settled is kept.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "dem_bridge/grain_flow.hpp"
#include "dem_bridge/runner.hpp"
#include "sph/base/case_file.hpp"

namespace dem2sph::bridge {

/// How grains fill a case's geometry.
extern const ParameterTable grain_flow_table;

/// What is read off the grains.
struct FlowScene {
  std::string name;      ///< "column_collapse"
  double L0 = 0;         ///< [m]; 0: nothing has a front
  double H0 = 0;         ///< [m]
  bool radial = false;   ///< x is the distance from the vertical axis
  double floor_end = 0;  ///< [m]
  long frames = 20;
};

struct GrainFlowJob {
  GrainFlow flow;
  FlowScene scene;
  EngineLimits limits;
  std::string engine;       ///< engine_version()
  std::string description;  ///< for messages: "seed 1"
};

struct GrainFlowOptions {
  std::filesystem::path folder;
  bool force = false;
  bool quiet = false;
};

/// Text for `plan`.
std::string describe(const GrainFlowJob& job);

/// Runs what is missing. Returns summary.json. Throws EngineError where the evidence is missing that a run
/// ended as it should, UsageError if the folder holds another run, Interrupted.
nlohmann::json run_grain_flow(const GrainFlowJob& job, const GrainFlowOptions& options);

}  // namespace dem2sph::bridge
