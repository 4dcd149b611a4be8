#include "cases/precision.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "calibration/comparison.hpp"
#include "calibration/report.hpp"
#include "calibration/work_precision.hpp"
#include "cases/grains.hpp"
#include "cases/scene_measures.hpp"
#include "dem_bridge/plan.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/frame.hpp"
#include "sph/base/provenance.hpp"
#include "sph/rheology/bagnold.hpp"
#include "sph/run_flow.hpp"
#include "sph/scene.hpp"

namespace dem2sph {

using nlohmann::json;
namespace fs = std::filesystem;

const ParameterTable precision_table{
    "precision",
    "Error against run time (`dem2sph precision`).",
    {{"resolutions", Kind::integers, "", 4, 100000, "[10, 20, 40]", "flow.resolution of the SPH runs."},
     {"step_factors", Kind::numbers, "", 1e-3, 4, "[1]",
      "flow.step_factor at the finest resolution but one."},
     {"formulations",
      Kind::word,
      "",
      0,
      0,
      "robust",
      "Which of them; source takes some hundred times as long.",
      {"robust", "source", "both"}},
     {"ingredients", Kind::flag, "", 0, 0, "false",
      "Also robust with one ingredient changed at a time, at the finest resolution but one."},
     {"grain_scales", Kind::numbers, "", 1, 100, "[]",
      "Grains of so many d on the same geometry, 1 among them: the seeds of d are then the reference."}}};

namespace {

constexpr const char* grain_family = "grains";

struct SphRun {
  std::string name, family;
  long resolution = 0;
  std::vector<std::string> overrides;
};

std::vector<SphRun> sph_runs(const Section& section) {
  std::vector<long> resolutions = section.integers("resolutions");
  std::sort(resolutions.begin(), resolutions.end());
  if (resolutions.size() < 2) section.refuse("resolutions", "\"resolutions\" needs two values or more");
  const std::string which = section.word("formulations");
  std::vector<std::string> formulations;
  for (const char* f : {"robust", "source"})
    if (which == "both" || which == f) formulations.emplace_back(f);
  std::vector<SphRun> runs;
  for (const std::string& formulation : formulations)
    for (const long n : resolutions)
      runs.push_back(
          {fmt::format("{} {}", formulation, n), formulation, n, {"flow.formulation=" + formulation}});
  const long middle = resolutions[resolutions.size() - 2];
  for (const double factor : section.numbers("step_factors"))
    if (factor != 1)
      for (const std::string& formulation : formulations)
        runs.push_back({fmt::format("{} {}, step x {:g}", formulation, middle, factor),
                        formulation + ", other steps",
                        middle,
                        {"flow.formulation=" + formulation, fmt::format("flow.step_factor={:g}", factor)}});
  if (section.flag("ingredients")) {
    if (which == "source") section.refuse("ingredients", "\"ingredients\" vary the robust formulation");
    for (const auto& [key, value] : {std::pair{"kernel", "cubic_spline"},
                                     {"density", "summation_shepard"},
                                     {"stress", "direct"},
                                     {"damping", "none"},
                                     {"h_over_dx", "1.2"},
                                     {"gradient_correction", "bonet_lok_1999"}})
      runs.push_back({fmt::format("{} = {}, {}", key, value, middle),
                      "robust, one ingredient changed",
                      middle,
                      {"flow.formulation=robust", fmt::format("flow.{}={}", key, value)}});
  }
  return runs;
}

/// One run: its point, and what it left.
struct WorkRun {
  WorkPoint point;
  FlowRecord record;             ///< empty if it failed
  std::vector<double> velocity;  ///< of an incline with grains: its profile, as `compare` sees it [m/s]
};

/// Relative L2 of the particles' velocity in the last frame against Bagnold's profile of the law.
double error_against_bagnold(const fs::path& folder, const LawFile& law, const CaseFile& file, double phi,
                             double H) {
  const double gravity = file.section(*flow_tables().front()).quantity("gravity");
  const double angle = file.section(*flow_tables().at(2)).quantity("angle");
  const Bagnold exact({law.friction["mu_l"], law.friction["mu_h"], law.friction["D_star"]},
                      {law.d, law.rho_s}, phi, gravity, angle);
  const Frame frame = read_frame(frames_of(folder).back());
  const std::vector<double>&x = frame.field("x").values, &v = frame.field("v").values,
        &kind = frame.field("kind").values;
  const std::size_t up = frame.dimension == 3 ? 2 : 1;
  double off = 0, all = 0;
  for (std::size_t i = 0; i < kind.size(); ++i) {
    if (kind[i] != 0) continue;
    const double u = exact.velocity(x[3 * i + up], H);
    off += (v[3 * i] - u) * (v[3 * i] - u), all += u * u;
  }
  return std::sqrt(off / all);
}

/// A case that precision knows how to measure.
void require_measurable(const CaseFile& file, const LawFile& law, const Section& section) {
  const Section flow = file.section(*flow_tables().front());
  const std::string scene = flow.word("scene");
  const std::vector<double> scales = section.numbers("grain_scales");
  if (scene != "column_collapse" && scene != "inclined_plane")
    flow.refuse("scene", "precision knows what to measure in a column_collapse and on an inclined_plane");
  if (scene == "inclined_plane") {
    if (scales.empty() && law.friction.member != "rational")
      throw UsageError(
          fmt::format("{}: the exact profile of an incline is that of a rational law, not of \"{}\"",
                      file.path().string(), law.friction.member));
  }
  if (!scales.empty() && std::find(scales.begin(), scales.end(), 1) == scales.end())
    section.refuse("grain_scales",
                   "\"grain_scales\" needs 1 among them: grains of d are what the others are measured by");
}

/// The runs with grains of one scale, without their errors; with a profile to look at, with that.
std::vector<WorkRun> grain_runs(const CaseFile& file, double scale, const fs::path& folder,
                                const json& summary, const Wanted* wanted) {
  const bridge::GrainFlowJob job = grain_jobs(file, bridge::engine_unknown, scale).front();
  std::vector<WorkRun> list;
  for (const json& seed : summary.at("seeds")) {
    WorkRun run;
    const fs::path where = folder / fmt::format("seed_{}", seed.get<long>());
    run.record = read_flow_record(fmt::format("grains of {:g} d, seed {}", scale, seed.get<long>()),
                                  where / "summary.json");
    if (wanted != nullptr) {
      const Geometry<3>& geometry = job.flow.geometry;
      run.velocity = look_at(grains_on_disk(run.record.label, where, job.flow.material,
                                            geometry.high[1] - geometry.low[1]),
                             *wanted)
                         .velocity.x;
    }
    run.point.name = fmt::format("{:g} d", scale), run.point.family = grain_family;
    run.point.spacing = job.flow.material.d / job.flow.height;
    list.push_back(std::move(run));
  }
  return list;
}

/// Runs one SPH flow, or takes it from its folder. One that breaks down is a result too.
WorkRun run_sph(const SphRun& wanted, const fs::path& case_path, std::vector<std::string> overrides,
                const LawFile& law, const fs::path& folder, const CommonOptions& options,
                const Wanted* profile) {
  overrides.push_back(fmt::format("flow.resolution={}", wanted.resolution));
  overrides.insert(overrides.end(), wanted.overrides.begin(), wanted.overrides.end());
  const CaseFile file = load_case(case_path, overrides);
  std::string name = wanted.name;
  std::replace_if(
      name.begin(), name.end(), [](char c) { return c == ' ' || c == ',' || c == '='; }, '_');
  FlowOptions flow = reusing_flow(folder / name, options);
  if (options.threads == 0) flow.threads = 1;  // one core, so that core-seconds are those of the work alone
  WorkRun run;
  run.point.name = wanted.name, run.point.family = wanted.family;
  run.point.spacing = 1.0 / static_cast<double>(wanted.resolution);
  try {
    const json summary = run_flow(file, law, flow);
    run.record = read_flow_record(wanted.name, flow.folder / "summary.json");
    if (profile != nullptr)
      run.velocity =
          look_at(sph_on_disk(wanted.name, flow.folder, summary, law, flow_dimension(file), 1), *profile)
              .velocity.x;
    else if (!run.record.has_front)
      run.point.error = error_against_bagnold(flow.folder, law, file,
                                              summary.at("initial").at("solid_fraction").get<double>(),
                                              summary.at("initial").at("H0").get<double>());
  } catch (const NumericalError& error) {
    run.point.failure = error.what();
    spdlog::warn("{}: {}", wanted.name, error.what());
  }
  return run;
}

/// Errors of collapses, L2 of the deposit over H0, and of inclines with grains, L2 of the velocity profile
/// over the surface velocity: against the mean of the grains' seeds (a seed against the mean of the others),
/// or without grains against the finest run of the formulation. Returns the mean of the seeds'.
double set_errors(std::vector<WorkRun>& runs, double scale_of_seeds) {
  double reach = 0;
  for (const WorkRun& r : runs)
    if (r.point.failure.empty()) reach = std::max(reach, r.record.front.back());
  const auto list_of = [&](const WorkRun& r) {
    return r.record.has_front ? deposit_of(r.record, reach) : r.velocity;
  };
  std::vector<std::size_t> seeds;
  for (std::size_t k = 0; k < runs.size(); ++k)
    if (runs[k].point.family == grain_family && runs[k].point.spacing == scale_of_seeds) seeds.push_back(k);
  const auto is_seed = [&](std::size_t k) { return std::find(seeds.begin(), seeds.end(), k) != seeds.end(); };
  const auto reference_of = [&](std::size_t k) {
    std::vector<std::vector<double>> list;
    for (const std::size_t s : seeds)
      if (s != k) list.push_back(list_of(runs[s]));
    if (!seeds.empty()) return list;
    const std::string& family = runs[k].point.family;
    const WorkRun* finest = nullptr;
    for (const WorkRun& r : runs)
      if (r.point.failure.empty() && r.point.family == family.substr(0, family.find(',')) &&
          (finest == nullptr || r.point.spacing < finest->point.spacing))
        finest = &r;
    if (finest != nullptr) list.push_back(list_of(*finest));
    return list;
  };
  double surface = 0;
  for (const std::size_t s : seeds)
    if (!runs[s].record.has_front) surface += runs[s].velocity.back() / static_cast<double>(seeds.size());
  double floor = 0;
  for (std::size_t k = 0; k < runs.size(); ++k) {
    if (!runs[k].point.failure.empty()) continue;
    const FlowRecord& r = runs[k].record;
    const std::vector<std::vector<double>> reference = reference_of(k);
    runs[k].point.error =
        reference.empty()
            ? std::nan("")
            : compare_lists("", list_of(runs[k]), reference, r.has_front ? r.H0_over_L0 : surface, 0).L2;
    if (is_seed(k)) floor += runs[k].point.error / static_cast<double>(seeds.size());
  }
  return floor;
}

/// Observed orders, and for the front of a collapse the grid convergence of the three finest.
json convergence_of(const std::vector<WorkRun>& runs, const std::vector<WorkPoint>& points) {
  const auto number = [](double v) { return std::isfinite(v) ? json(v) : json("none"); };
  json result = json::object();
  for (const char* family : {"robust", "source"}) {
    std::vector<const WorkRun*> line;  // the coarsest first
    for (const WorkRun& r : runs)
      if (r.point.family == family && r.point.failure.empty()) line.push_back(&r);
    if (line.empty()) continue;
    result[family]["observed_order_of_error"] = number(observed_order(points, family));
    const std::size_t n = line.size();
    if (n < 3 || !line.back()->record.has_front) continue;
    const auto ratio = [&](std::size_t k) { return line[k - 1]->point.spacing / line[k]->point.spacing; };
    if (std::abs(ratio(n - 1) - ratio(n - 2)) > 1e-9 * ratio(n - 1)) continue;  // no constant ratio, no order
    const auto front = [&](std::size_t k) { return line[k]->record.front.back(); };
    const GridConvergence g = grid_convergence(front(n - 3), front(n - 2), front(n - 1), ratio(n - 1));
    result[family]["front_99"] = {
        {"order", number(g.order)}, {"limit", number(g.limit)}, {"GCI", number(g.index)}};
  }
  return result;
}

/// What a scene costs at the error of a seed, with SPH and with grains, and when the calibration is paid
/// back. Fills `result` and returns the sentence.
std::string say_what_it_costs(const std::vector<WorkPoint>& points, double floor, double grains,
                              const LawFile& law, json& result) {
  result["seeds_error"] = floor;
  result["grains_core_seconds"] = grains;
  const double sph = cost_at_error(points, {"robust", "source"}, floor);
  if (!std::isfinite(sph)) {
    double best = std::numeric_limits<double>::infinity();
    for (const WorkPoint& p : points)
      if (p.family != grain_family && p.failure.empty()) best = std::min(best, p.error);
    return fmt::format(" No SPH run comes within the error of a seed, {:.2f} %: the best is {:.2f} % off.",
                       100 * floor, 100 * best);
  }
  result["sph_core_seconds_at_seeds_error"] = sph;
  result["times_cheaper"] = grains / sph;
  std::string text = fmt::format(
      " At the error of a seed, {:.2f} %, SPH is {:.1f} times cheaper than grains ({:.3g} against {:.3g} "
      "core-seconds).",
      100 * floor, grains / sph, sph, grains);
  const double calibration = law.provenance.is_object() ? law.provenance.value("core_seconds", 0.0) : 0.0;
  if (calibration > 0 && grains > sph) {
    result["calibration_core_seconds"] = calibration;
    result["scenes_until_paid_back"] = calibration / (grains - sph);
    text += fmt::format(" The calibration's {:.3g} core-seconds are paid back after {:.1f} such scenes.",
                        calibration, calibration / (grains - sph));
  }
  return text;
}

}  // namespace

std::string plan_precision(const fs::path& case_path, const fs::path& law_path,
                           const CommonOptions& options) {
  const CaseFile file = load_case(case_path, options.overrides);
  const Section section = file.section(precision_table);
  require_measurable(file, law_of(file, law_path), section);
  std::string text;
  for (const SphRun& run : sph_runs(section)) text += fmt::format("SPH {}\n", run.name);
  for (const double scale : section.numbers("grain_scales"))
    text += fmt::format("grains of {:g} d, {} seeds\n", scale,
                        grain_jobs(file, bridge::engine_unknown, scale).size());
  return text;
}

json run_precision(const fs::path& case_path, const fs::path& law_path, const fs::path& folder,
                   const CommonOptions& options) {
  const CaseFile file = load_case(case_path, options.overrides);
  const LawFile law = law_of(file, law_path);
  const Section section = file.section(precision_table);
  require_measurable(file, law, section);
  const std::vector<SphRun> wanted = sph_runs(section);

  // Grains first: their solid fraction is that of the start of SPH.
  std::vector<WorkRun> runs, of_grains;
  std::vector<std::string> overrides = options.overrides;
  double scale_of_seeds = 0, cost_of_a_seed = 0;
  std::optional<Wanted> profile;  // of an incline with grains
  if (!section.numbers("grain_scales").empty()) {
    const bridge::GrainFlowJob job = grain_jobs(file, bridge::engine_unknown).front();
    if (job.scene.name == "inclined_plane") {
      profile.emplace();
      profile->d = job.flow.material.d, profile->profile_height = job.flow.height;
    }
  }
  for (const double scale : section.numbers("grain_scales")) {
    const fs::path where = folder / "grains" / fmt::format("scale_{:g}", scale);
    const json summary = run_grains(file, where, options, scale);
    std::vector<WorkRun> list = grain_runs(file, scale, where, summary, profile ? &*profile : nullptr);
    if (scale == 1) {
      if (list.size() < 2)
        file.section(bridge::grain_flow_table)
            .refuse("seeds", "\"seeds\" needs two or more to be a reference");
      scale_of_seeds = list.front().point.spacing;
      for (const WorkRun& r : list) cost_of_a_seed += r.record.cpu_seconds / static_cast<double>(list.size());
      if (!file.section(*flow_tables().front()).given("initial_solid_fraction"))
        overrides.push_back(fmt::format("flow.initial_solid_fraction={:.6f}",
                                        summary.at("initial").at("solid_fraction").at("mean").get<double>()));
    }
    for (WorkRun& r : list) of_grains.push_back(std::move(r));
  }
  for (const SphRun& run : wanted)
    runs.push_back(
        run_sph(run, case_path, overrides, law, folder / "sph", options, profile ? &*profile : nullptr));
  for (WorkRun& r : of_grains) runs.push_back(std::move(r));

  const bool collapse =
      std::any_of(runs.begin(), runs.end(), [](const WorkRun& r) { return r.record.has_front; });
  const double floor = collapse || profile ? set_errors(runs, scale_of_seeds) : 0;
  std::vector<WorkPoint> points;
  for (WorkRun& r : runs) {
    if (r.point.failure.empty()) {
      r.point.core_seconds = r.record.cpu_seconds;
      r.point.particle_steps = r.record.particles * r.record.steps;
      if (r.record.has_front)
        r.point.figures = {{"front_99_over_L0", r.record.front.back()},
                           {"centre_height_over_L0", r.record.height.back()},
                           {"time_over_tau", r.record.rest_time},
                           {"at_rest", r.record.at_rest}};
    }
    points.push_back(r.point);
  }
  mark_pareto_front(points);

  const char* reference = scale_of_seeds > 0 ? "the mean of the grains' seeds"
                          : collapse         ? "the finest run of its formulation"
                                             : "the exact profile";
  json result{{"format", "dem2sph-precision"},
              {"schema_version", 1},
              {"case", case_path.string()},
              {"overrides", options.overrides},
              {"law_sha256", law_hash(law)},
              {"error", collapse  ? "L2 of the deposit over H0"
                        : profile ? "L2 of the velocity profile over the surface velocity"
                                  : "L2 of the velocity, relative"},
              {"reference", reference},
              {"points", to_json(points)},
              {"convergence", convergence_of(runs, points)},
              {"provenance", provenance()}};
  std::string verdict = fmt::format("Error against {}.", reference);
  if (floor > 0) verdict += say_what_it_costs(points, floor, cost_of_a_seed, law, result);
  result["verdict"] = verdict;
  write_file_atomically(folder / "precision.json", result.dump(1) + "\n");
  write_file_atomically(folder / "precision.csv", csv_of(points));
  write_page(
      fmt::format("{}: error against run time", fs::absolute(case_path).stem().string()), verdict,
      figure_html(figure_of_work(points, floor, "a seed from the mean of the others"),
                  "Each point is a run; the number beside it is flow.resolution, or the grains' size.") +
          table_of_work(points),
      result.at("provenance"), folder / "report.html");
  return result;
}

}  // namespace dem2sph
