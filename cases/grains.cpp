#include "cases/grains.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <cmath>
#include <future>
#include <mutex>

#include "calibration/statistics.hpp"
#include "dem_bridge/plan.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"
#include "sph/scene.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

Geometry<3> in_space(const Geometry<3>& geometry, double) { return geometry; }
Geometry<3> in_space(const Geometry<2>& geometry, double depth) { return slab_of(geometry, depth); }

/// What the solver would see of the case, as grains see it.
template <int Dim>
void take_geometry(const CaseFile& file, const bridge::GrainMaterial& material, double depth,
                   bridge::GrainFlowJob& job) {
  LawFile law = typical_law();
  law.d = material.d, law.rho_s = material.rho_s;
  const FlowSetup<Dim> setup = make_setup<Dim>(file, law);
  if (setup.scene == "plane_shear")
    throw UsageError(fmt::format("{}: grains in plane shear are the shear cell itself: dem2sph sweep",
                                 file.path().string()));
  if (setup.scene == "heap")
    throw UsageError(
        fmt::format("{}: a heap of grains is what a flow leaves; it cannot be packed", file.path().string()));
  bridge::GrainFlow& flow = job.flow;
  flow.geometry = in_space(setup.geometry, depth);
  flow.gravity[0] = setup.gravity[0];
  flow.gravity[2] = setup.gravity[Dim - 1];
  flow.height = setup.length_scale;
  flow.end_time = setup.end_time;
  flow.stop_at_rest = setup.stop_at_rest;
  job.scene = {setup.scene,        setup.initial_length, setup.length_scale,
               setup.axisymmetric, setup.floor_end,      setup.frames};
}

/// Mean and standard deviation over seeds of the numbers that each run ends with.
json summary_of(const std::vector<json>& runs) {
  json result{{"format", "dem2sph-grains"}, {"schema_version", 1}, {"seeds", json::array()}};
  for (const json& run : runs) result["seeds"].push_back(run.at("seed"));
  const auto over_seeds = [&](const json::json_pointer& where) {
    std::vector<double> values;
    for (const json& run : runs)
      if (run.contains(where)) values.push_back(run.at(where).get<double>());
    if (values.size() != runs.size()) return;
    const MeanAndSd m = mean_and_sd(values);
    result[where] = {{"mean", m.mean}, {"sd", m.sd}};
  };
  for (const char* where :
       {"/initial/solid_fraction", "/initial/core_solid_fraction", "/initial/twice_centre_of_mass",
        "/deposit/front_99", "/deposit/runout", "/deposit/centre_height", "/deposit/centre_height_over_L0",
        "/deposit/time_over_tau", "/time", "/particles", "/steps", "/cpu_seconds", "/settling_cpu_seconds",
        "/particle_steps_per_second", "/largest_overlap_over_d"})
    over_seeds(json::json_pointer(where));
  result["engine"] = runs.front().at("engine");
  result["scene"] = runs.front().at("scene");
  result["provenance"] = provenance();
  return result;
}

}  // namespace

std::vector<bridge::GrainFlowJob> grain_jobs(const CaseFile& file, const std::string& engine, double scale) {
  if (!file.has("flow"))
    throw UsageError(fmt::format("{}: a flow of grains needs a section [flow]", file.path().string()));
  const CaseFile cell = shear_cell_case(file);
  if (!cell.has("material"))
    throw UsageError(
        fmt::format("{}: a flow of grains needs their material: sections [material] and [shear_cell], or "
                    "chain.shear_cell",
                    file.path().string()));
  const bridge::SweepPlan sweep = bridge::plan_sweep(cell, bridge::engine_unknown);
  const Section dem = file.section(bridge::grain_flow_table);
  bridge::GrainFlowJob job;
  job.engine = engine;
  job.flow.material = sweep.grains;
  job.flow.material.d *= scale;
  job.flow.time_step_fraction = sweep.runs.front().sample.time_step_fraction;
  const double friction = dem.number("packing_friction");
  job.flow.packing_friction = std::isnan(friction) ? sweep.grains.grain_friction : friction;
  job.flow.samples = dem.integer("samples");
  job.flow.ranks = dem.integer("ranks");
  job.limits.seconds = dem.quantity("time_limit");
  if (flow_dimension(file) == 3)
    take_geometry<3>(file, job.flow.material, 0, job);
  else
    take_geometry<2>(file, job.flow.material, dem.number("depth") * job.flow.material.d, job);
  const std::vector<long> seeds = dem.integers("seeds");
  dem.finish("in three dimensions");
  if (seeds.empty()) dem.refuse("seeds", "\"seeds\" is an empty list");
  std::vector<bridge::GrainFlowJob> jobs;
  for (const long seed : seeds) {
    job.flow.seed = seed;
    job.description = fmt::format("seed {}", seed);
    jobs.push_back(job);
  }
  return jobs;
}

std::string plan_grains(const CaseFile& file) {
  const std::vector<bridge::GrainFlowJob> jobs = grain_jobs(file, bridge::engine_unknown);
  return fmt::format("{} runs of\n  {}", jobs.size(), bridge::describe(jobs.front()));
}

json run_grains(const CaseFile& file, const fs::path& folder, const CommonOptions& options, double scale) {
  const std::vector<bridge::GrainFlowJob> jobs = grain_jobs(file, bridge::engine_version(), scale);
  std::vector<json> results(jobs.size());
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t k = next++; k < jobs.size(); k = next++) {
      const fs::path where = folder / fmt::format("seed_{}", jobs[k].flow.seed);
      results[k] = bridge::run_grain_flow(jobs[k], {where, options.force, options.quiet});
    }
  };
  const std::size_t workers = std::min(jobs.size(), static_cast<std::size_t>(jobs_or_cores(options.jobs)));
  std::vector<std::future<void>> others;
  for (std::size_t k = 1; k < workers; ++k) others.push_back(std::async(std::launch::async, work));
  // One that fails lets the others finish: what they did is kept.
  std::exception_ptr failure;
  const auto keep_first = [&](auto&& what) {
    try {
      what();
    } catch (...) {
      if (!failure) failure = std::current_exception();
    }
  };
  keep_first(work);
  for (std::future<void>& other : others) keep_first([&] { other.get(); });
  if (failure) std::rethrow_exception(failure);
  const json summary = summary_of(results);
  write_file_atomically(folder / "summary.json", summary.dump(1) + "\n");
  return summary;
}

}  // namespace dem2sph
