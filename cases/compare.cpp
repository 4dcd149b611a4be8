#include "cases/compare.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calibration/comparison.hpp"
#include "calibration/report.hpp"
#include "cases/compare_shear.hpp"
#include "cases/grains.hpp"
#include "cases/scene_measures.hpp"
#include "dem_bridge/coarse_graining_frames.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"
#include "sph/run_flow.hpp"
#include "sph/scene.hpp"

namespace dem2sph {

using nlohmann::json;
namespace fs = std::filesystem;

const ParameterTable compare_table{
    "compare",
    "What `dem2sph compare` measures in a scene of its own geometry.",
    {{"discharge_below", Kind::quantity, "m", -1e6, 1e6, "unset",
      "Height that material falls below as it leaves: its rate is compared."},
     {"surface_angle_within", Kind::quantity, "m", 1e-6, 1e6, "unset",
      "Half of the length about x = 0 over which the slope of the surface is "
      "taken, in the second half of the time."},
     {"observables", Kind::file, "", 0, 0, "unset",
      "Plane shear: observables.h5 of the shear cells it is held against."},
     {"strain", Kind::number, "", 0.1, 1000, "10", "Plane shear: how far each run is sheared."},
     {"lowest_I", Kind::number, "", 0, 1000, "0",
      "Plane shear: conditions below this driven I are left out: they take longest."}}};

namespace {

/// A variant of the SPH flow, as a case.
struct SphFlow {
  std::string name, label;  ///< of the folder; for people
  CaseFile file;
};

/// Its grains have been sheared already: they are the law's data.
bool is_plane_shear(const CaseFile& file) {
  return file.section(*flow_tables().front()).word("scene") == "plane_shear";
}

/// With and without dilation, unless the case says which.
std::vector<SphFlow> sph_flows(const LawFile& law, const fs::path& path,
                               const std::vector<std::string>& overrides) {
  const CaseFile file = load_case(path, overrides);
  const Section flow = file.section(*flow_tables().front());
  if (flow.given("dilation"))
    return {{"flow", fmt::format("with dilation = {}", flow.word("dilation")), file}};
  std::vector<SphFlow> list;
  for (const FlowVariant& variant : flow_variants)
    if (!variant.dilation || law.dilation.member != "none")
      list.push_back({variant.name, variant.label, case_of(variant, law, path, overrides)});
  return list;
}

/// Grains and law are of one material, or nothing is compared.
void require_same_material(const LawFile& law, const bridge::GrainMaterial& m) {
  const auto differ = [](double a, double b) { return std::abs(a - b) > 1e-6 * std::abs(b); };
  if (differ(law.d, m.d) || differ(law.rho_s, m.rho_s))
    throw UsageError(
        fmt::format("the law is that of grains of d = {:g} m and rho_s = {:g} kg/m^3, the case's grains have "
                    "{:g} m and {:g} kg/m^3",
                    law.d, law.rho_s, m.d, m.rho_s));
}

/// Relative error of I on a slope, tan = mu(I), that the law's covariance leaves: dI = -(grad mu .
/// dp)/(dmu/dI). NaN if the law has no covariance of a rational friction.
double band_of_incline(const LawFile& law, double slope) {
  const std::vector<std::string>& names = law.covariance_names;
  std::vector<std::size_t> at;
  for (const char* name : {"mu_l", "mu_h", "D_star"}) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (law.friction.member != "rational" || found == names.end()) return std::nan("");
    at.push_back(static_cast<std::size_t>(found - names.begin()));
  }
  const double l = law.friction["mu_l"], h = law.friction["mu_h"], D = law.friction["D_star"];
  if (!(slope > l && slope < h)) return std::nan("");
  // ln I = ln D + ln(slope - l) - ln(h - slope)
  const std::array<double, 3> by{-1 / (slope - l), -1 / (h - slope), 1 / D};
  double variance = 0;
  for (std::size_t a = 0; a < 3; ++a)
    for (std::size_t b = 0; b < 3; ++b) variance += by[a] * law.covariance[at[a]][at[b]] * by[b];
  return std::sqrt(std::max(0.0, variance));
}

/// Every 2 d over the plane of a slab, to beyond the farthest front.
bridge::Grid grid_of(const bridge::GrainFlowJob& job, const std::vector<FlowRecord>& seeds) {
  const Geometry<3>& g = job.flow.geometry;
  const double spacing = 2 * job.flow.material.d;
  double reach = job.scene.L0 > 0 ? 0 : g.high[0];
  if (job.scene.L0 > 0)
    for (const FlowRecord& s : seeds) reach = std::max(reach, 1.3 * job.scene.L0 * s.front.back());
  const double top = std::max(g.high[2], job.flow.height);
  const auto axis = [&](int direction, double low, double high) {
    return bridge::axis_between(direction, low, high,
                                static_cast<std::size_t>(std::ceil((high - low) / spacing)));
  };
  bridge::Grid grid;
  grid.axes = {axis(0, g.low[0], reach), axis(2, g.low[2], top)};
  return grid;
}

/// The velocity profile of an incline: within 10 %, or the band that the law's covariance propagates together
/// with the seeds' spread. Of grains that stand only the speed of both surfaces is told.
void add_velocity_profile(Comparison& c, const Seen& sph, const std::vector<Seen>& seeds, double band_of_I,
                          double fall_speed) {
  std::vector<double> surfaces;
  for (const Seen& s : seeds) surfaces.push_back(s.velocity.x.back() / fall_speed);
  c.measures.push_back(
      measure_of("surface velocity", "sqrt(g H)", surfaces, sph.velocity.x.back() / fall_speed, no_bar));
  std::vector<std::vector<double>> v;
  double surface = 0;
  for (const Seen& s : seeds) {
    v.push_back(s.velocity.x);
    surface += s.velocity.x.back() / static_cast<double>(seeds.size());
  }
  if (!(surface > 1e-3 * fall_speed)) return;
  Distance d = compare_lists("velocity profile, over the surface velocity", sph.velocity.x, v, surface, 0);
  const double band = 1.96 * band_of_I;
  d.bar = std::max(0.10, std::isfinite(band) ? std::hypot(band, d.seeds_L2) : 0.0);
  c.distances.push_back(d);
}

}  // namespace

std::string plan_comparison(const fs::path& case_path, const fs::path& law_path,
                            const CommonOptions& options) {
  const CaseFile file = load_case(case_path, options.overrides);
  const LawFile law = law_of(file, law_path);
  if (is_plane_shear(file)) return plan_shear_comparison(file, law, options);
  std::string text = plan_grains(file);
  for (const SphFlow& flow : sph_flows(law, case_path, options.overrides))
    text += fmt::format("SPH {}\n{}", flow.label, plan_flow(flow.file, law));
  return text;
}

json run_comparison(const fs::path& case_path, const fs::path& law_path, const fs::path& folder,
                    const CommonOptions& options) {
  const CaseFile file = load_case(case_path, options.overrides);
  const LawFile law = law_of(file, law_path);
  if (is_plane_shear(file)) return run_shear_comparison(file, law, folder, options);
  const std::vector<bridge::GrainFlowJob> jobs = grain_jobs(file, bridge::engine_version());
  const bridge::GrainFlowJob& job = jobs.front();
  const bridge::GrainMaterial& material = job.flow.material;
  require_same_material(law, material);
  Wanted wanted;
  wanted.d = material.d;
  const Section measures = file.section(compare_table);
  if (job.scene.name == "geometry") {
    wanted.discharge_below = measures.quantity("discharge_below");
    wanted.surface_within = measures.quantity("surface_angle_within");
  }
  measures.finish(fmt::format("with scene = \"{}\"", job.scene.name));
  // What SPH refuses is said before LIGGGHTS runs.
  for (const SphFlow& flow : sph_flows(law, case_path, options.overrides)) plan_flow(flow.file, law);

  const json grains = run_grains(file, folder / "grains", options);
  wanted.phi_0 = grains.at("initial").at("solid_fraction").at("mean").get<double>();
  ComparisonPage page;
  page.title = fmt::format("{}: grains and SPH", fs::absolute(case_path).stem().string());
  std::vector<FlowOnDisk> on_disk;
  const double depth = job.flow.geometry.high[1] - job.flow.geometry.low[1];
  for (const bridge::GrainFlowJob& seed : jobs) {
    const fs::path where = folder / "grains" / fmt::format("seed_{}", seed.flow.seed);
    page.seeds.push_back(read_flow_record(seed.description, where / "summary.json"));
    on_disk.push_back(grains_on_disk(seed.description, where, material, depth));
  }
  const bool incline = job.scene.name == "inclined_plane";
  if (incline)
    wanted.profile_height = job.flow.height;
  else if (!job.scene.radial)
    wanted.grid = grid_of(job, page.seeds), wanted.geometry = job.flow.geometry;
  std::vector<Seen> seeds;
  for (const FlowOnDisk& seed : on_disk) seeds.push_back(look_at(seed, wanted));

  // SPH at the grains' own solid fraction: the same mass in the same room.
  std::vector<std::string> overrides = options.overrides;
  if (!file.section(*flow_tables().front()).given("initial_solid_fraction"))
    overrides.push_back(fmt::format("flow.initial_solid_fraction={:.6f}", wanted.phi_0));
  const double tau = std::sqrt(job.flow.height / norm(job.flow.gravity));
  const double slope = job.flow.gravity[0] / -job.flow.gravity[2], band = band_of_incline(law, slope);
  const int dimension = flow_dimension(file);
  std::vector<Seen> sph;
  json variants = json::array();
  for (const SphFlow& flow : sph_flows(law, case_path, overrides)) {
    const fs::path where = folder / flow.name;
    const json summary = run_flow(flow.file, law, reusing_flow(where, options));
    Comparison c = compare_flows(read_flow_record(flow.label, where / "summary.json"), page.seeds);
    sph.push_back(look_at(sph_on_disk(flow.label, where, summary, law, dimension, depth), wanted));
    // A tenth of the time in which a grain falls over H: two frames that are farther apart are two states.
    if (wanted.grid)
      for (Distance& d : compare_fields(sph.back(), seeds, wanted.phi_0, 0.1 * tau))
        c.distances.push_back(std::move(d));
    if (incline) add_velocity_profile(c, sph.back(), seeds, band, job.flow.height / tau);
    const auto add = [&](const char* name, const char* unit, const auto& what, const auto& bar) {
      std::vector<double> values;
      for (const Seen& s : seeds) values.push_back(what(s));
      Measure m = measure_of(name, unit, values, what(sph.back()), 0);
      m.bar = bar(m.dem);
      c.measures.push_back(std::move(m));
    };
    if (!std::isnan(wanted.discharge_below))
      add(
          "discharge, share of the material", "1/s",
          [](const Seen& s) { return discharge_rate(s.discharge); }, [](double) { return 0.10; });
    if (!std::isnan(wanted.surface_within))  // within 2 degrees
      add(
          "slope of the surface", "deg", [](const Seen& s) { return mean_of_second_half(s.slope); },
          [](double dem) { return 2 / std::abs(dem); });
    json entry = to_json(c);
    entry["summary"] = fmt::format("{}/summary.json", flow.name);
    variants.push_back(std::move(entry));
    page.variants.push_back(std::move(c));
  }
  const auto add_figure = [&](const char* name, FlowCurve Seen::*what, const char* axes,
                              const char* caption) {
    std::vector<FlowCurve> of_seeds, of_sph;
    for (const Seen& s : seeds) of_seeds.push_back(s.*what);
    for (const Seen& s : sph) of_sph.push_back(s.*what);
    page.figures += figure_html(
        figure_of_flows(name, of_seeds, of_sph, std::string("set key bottom right\n") + axes, 720, 340),
        caption);
  };
  if (incline)
    add_figure("velocity", &Seen::velocity, "set xlabel 'velocity [m/s]'\nset ylabel 'z [m]'\n",
               "Velocity down the slope, mean over the second half of the time, coarse-grained over 1.5 d.");
  if (!std::isnan(wanted.discharge_below))
    add_figure("discharge", &Seen::discharge,
               "set xlabel 'time [s]'\nset ylabel 'share of the material outside'\n",
               "Share of the material below the opening.");
  if (!std::isnan(wanted.surface_within))
    add_figure("slope", &Seen::slope, "set xlabel 'time [s]'\nset ylabel 'slope of the surface [deg]'\n",
               "Slope of the surface about x = 0.");

  json result{{"format", "dem2sph-comparison"},
              {"schema_version", 1},
              {"case", case_path.string()},
              {"overrides", options.overrides},
              {"scene", job.scene.name},
              {"law_sha256", law_hash(law)},
              {"grains", grains},
              {"variants", variants},
              {"provenance", provenance()}};
  if (incline) result["slope"] = slope, result["relative_error_of_I_by_the_law"] = band;
  write_file_atomically(folder / "comparison.json", result.dump(1) + "\n");
  page.provenance = result.at("provenance");
  write_comparison_page(page, folder / "report.html");
  return result;
}

}  // namespace dem2sph
