#include "cases/compare_shear.hpp"

#include <fmt/format.h>

#include <cmath>
#include <map>

#include "calibration/comparison.hpp"
#include "calibration/report.hpp"
#include "calibration/statistics.hpp"
#include "cases/compare.hpp"
#include "dem_bridge/observables.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/frame.hpp"
#include "sph/base/provenance.hpp"
#include "sph/material.hpp"
#include "sph/run_flow.hpp"
#include "sph/scene.hpp"

namespace dem2sph {

using nlohmann::json;
namespace fs = std::filesystem;

namespace {

/// What is asked of a prediction of mu and phi for a condition that was left out of the fit.
constexpr double bar_of_mu = 0.015, bar_of_phi = 0.005;

struct Condition {
  std::vector<double> I, mu, phi, p;  ///< of each seed
};

struct Core {
  double I = 0, mu = 0, phi = 0;
};
/// Ratios of means, as those of the shear cells are, over the particles at least a fifth of the height from
/// both walls, in the second half of the frames: at constant volume the pressure never comes quite to rest,
/// and at high I some particles have none.
Core core_of(const fs::path& folder, double height, const LawFile& law, bool has_phi) {
  const std::vector<fs::path> frames = frames_of(folder);
  double n = 0, sheared = 0, pressed = 0, borne = 0, filled = 0;
  for (std::size_t k = frames.size() / 2; k < frames.size(); ++k) {
    const Frame frame = read_frame(frames[k]);
    const std::vector<double>&x = frame.field("x").values, &kind = frame.field("kind").values,
          &mu = frame.field("mu").values, &rate = frame.field("gamma_dot").values,
          &p = frame.field("p").values;
    const std::size_t up = frame.dimension == 3 ? 2 : 1;
    for (std::size_t i = 0; i < kind.size(); ++i) {
      const double z = x[3 * i + up];
      if (kind[i] != 0 || z < 0.2 * height || z > 0.8 * height) continue;
      n += 1, sheared += rate[i], pressed += p[i], borne += mu[i] * p[i];
      if (has_phi) filled += frame.field("phi").values[i];
    }
  }
  if (n == 0) throw UsageError(fmt::format("{}: no particle is far enough from both walls", folder.string()));
  if (!(pressed > 0))
    throw NumericalError(fmt::format("{}: the material has lost its pressure", folder.string()));
  return {sheared / n * law.d / std::sqrt(pressed / n / law.rho_s), borne / pressed, filled / n};
}

/// The steady points of grains that are gone back to, by driven I.
struct ShearData {
  fs::path observables;
  double strain = 0;
  std::map<double, Condition> conditions;
};
ShearData shear_data(const CaseFile& file, const LawFile& law) {
  const Section wanted = file.section(compare_table), flow = file.section(*flow_tables().front());
  const fs::path path = wanted.file("observables");
  if (path.empty()) wanted.refuse("observables", "plane shear is compared with compare.observables: a file");
  for (const char* key : {"dilation", "end_time", "initial_solid_fraction"})
    if (flow.given(key)) flow.refuse(key, fmt::format("compare sets flow.{} of plane shear itself", key));
  ShearData data{path, wanted.number("strain"), {}};
  const double lowest = wanted.number("lowest_I");
  wanted.finish("with scene = \"plane_shear\"");
  const Observables observed = read_observables(path);
  if (std::abs(observed.d - law.d) > 1e-6 * law.d || std::abs(observed.rho_s - law.rho_s) > 1e-6 * law.rho_s)
    throw UsageError(fmt::format("{}: its grains are not those of the law", path.string()));
  for (const SteadyPoint& point : observed.steady) {
    if (point.I_driven < lowest) continue;
    Condition& c = data.conditions[point.I_driven];
    c.I.push_back(point.I), c.mu.push_back(point.mu), c.phi.push_back(point.phi), c.p.push_back(point.p);
  }
  if (data.conditions.empty())
    throw UsageError(fmt::format("{}: no steady point at I >= {:g}", path.string(), lowest));
  return data;
}

/// The case at the mean rate and pressure of a condition.
CaseFile case_at(const Condition& condition, double strain, const FlowVariant& variant, const LawFile& law,
                 const CaseFile& file, const CommonOptions& options) {
  const double p = mean_and_sd(condition.p).mean;
  const double rate = mean_and_sd(condition.I).mean * std::sqrt(p / law.rho_s) / law.d;
  std::vector<std::string> overrides = options.overrides;
  overrides.push_back(fmt::format("shear.shear_rate={:.9g} 1/s", rate));
  overrides.push_back(fmt::format("shear.pressure={:.9g} Pa", p));
  overrides.push_back(fmt::format("flow.end_time={:.9g} s", strain / rate));
  return case_of(variant, law, file.path(), overrides);
}

}  // namespace

std::string plan_shear_comparison(const CaseFile& file, const LawFile& law, const CommonOptions& options) {
  const ShearData data = shear_data(file, law);
  std::string text;
  for (const FlowVariant& variant : flow_variants)
    if (!variant.dilation || law.dilation.member != "none")
      for (const auto& [driven, condition] : data.conditions)
        text += fmt::format("SPH {}, driven I = {:g}\n{}", variant.label, driven,
                            plan_flow(case_at(condition, data.strain, variant, law, file, options), law));
  return text;
}

json run_shear_comparison(const CaseFile& file, const LawFile& law, const fs::path& folder,
                          const CommonOptions& options) {
  const auto [path, strain, conditions] = shear_data(file, law);
  json variants = json::array();
  std::vector<FlowCurve> data(1), curves;
  std::vector<std::string> misses;
  const bool dilates = law.dilation.member != "none";
  std::string tables;
  for (const FlowVariant& variant : flow_variants) {
    if (variant.dilation && !dilates) continue;
    Comparison c;
    c.sph.label = variant.label;
    FlowCurve curve{std::string("SPH ") + variant.label, {}, {}};
    double square = 0;
    data.front() = {"grains", {}, {}};
    for (const auto& [driven, condition] : conditions) {
      const MeanAndSd I = mean_and_sd(condition.I), mu = mean_and_sd(condition.mu);
      const CaseFile run = case_at(condition, strain, variant, law, file, options);
      const fs::path where = folder / variant.name / fmt::format("I_{:g}", driven);
      const json summary = run_flow(run, law, reusing_flow(where, options));
      const Core core = core_of(where, summary.at("initial").at("H0").get<double>(), law, variant.dilation);
      c.sph.particles = summary.at("particles").get<double>();
      c.sph.steps += summary.at("steps").get<double>();
      c.sph.cpu_seconds += summary.at("cpu_seconds").get<double>();
      // At constant volume the pressure, and I with it, ends a little off: mu is taken back to the grains' I.
      const FrictionLaw friction = friction_law(law);
      const auto mu_at = [&](double at) {
        return std::visit([&](const auto& member) { return steady_friction(member, at, at); }, friction);
      };
      const double mu_sph = core.mu + mu_at(I.mean) - mu_at(core.I);
      c.measures.push_back(
          measure_of(fmt::format("mu at I = {:.3g}", I.mean), "1", condition.mu, mu_sph, bar_of_mu));
      square += std::pow(c.measures.back().difference(), 2);
      if (variant.dilation)
        c.measures.push_back(
            measure_of(fmt::format("phi at I = {:.3g}", I.mean), "1", condition.phi, core.phi, bar_of_phi));
      data.front().x.push_back(I.mean), data.front().y.push_back(mu.mean);
      curve.x.push_back(core.I), curve.y.push_back(core.mu);
    }
    json entry = to_json(c);
    entry["mu_rms_relative_difference"] = std::sqrt(square / static_cast<double>(conditions.size()));
    variants.push_back(std::move(entry));
    for (const std::string& miss : c.misses()) misses.push_back(fmt::format("SPH {}: {}", c.sph.label, miss));
    tables += measures_table(c, conditions.begin()->second.mu.size());
    curves.push_back(std::move(curve));
  }
  json result{{"format", "dem2sph-comparison"}, {"schema_version", 1},    {"case", file.path().string()},
              {"overrides", options.overrides}, {"scene", "plane_shear"}, {"law_sha256", law_hash(law)},
              {"observables", path.string()},   {"variants", variants},   {"provenance", provenance()}};
  write_file_atomically(folder / "comparison.json", result.dump(1) + "\n");
  std::string verdict = misses.empty() ? "Every figure is within its bar or the spread of the seeds." : "";
  for (const std::string& miss : misses) verdict += miss + ". ";
  write_page("Plane shear back to its own data", verdict,
             figure_html(figure_of_flows("mu", data, curves,
                                         "set logscale x\nset key top left\nset xlabel 'I'\nset ylabel "
                                         "'{/Symbol m}'\n",
                                         720, 340),
                         "Friction of the shear cells (mean over seeds) and of the solver at their rates and "
                         "pressures.") +
                 tables,
             result.at("provenance"), folder / "report.html");
  return result;
}

}  // namespace dem2sph
