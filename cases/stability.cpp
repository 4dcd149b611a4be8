#include "cases/stability.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <mutex>
#include <regex>
#include <thread>
#ifdef _OPENMP
#include <omp.h>
#endif

#include "cases/stability_cells.hpp"
#include "cases/stability_page.hpp"
#include "dem_bridge/observables.hpp"
#include "dem_bridge/plan.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/frame.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"
#include "sph/base/subprocess.hpp"
#include "sph/base/version.hpp"
#include "sph/flow.hpp"
#include "sph/linear_stability.hpp"
#include "sph/material.hpp"
#include "sph/scene.hpp"

namespace dem2sph {

using nlohmann::json;
namespace fs = std::filesystem;

namespace {
std::vector<std::string> axis_words() {
  std::vector<std::string> words{every_axis};
  words.insert(words.end(), stability_axes.begin(), stability_axes.end());
  return words;
}
}  // namespace

const ParameterTable stability_table{
    "stability",
    "Where the numerics hold (`dem2sph stability`).",
    {{"axis", Kind::word, "", 0, 0, every_axis, "Only this axis of the solver's matrix.", axis_words()},
     {"rows", Kind::integer, "", 6, 100, "12",
      "Particles over the height of the scenes, where the axis is not that."},
     {"solver", Kind::flag, "", 0, 0, "true", "Whether the solver's matrix is run."},
     {"step_limits", Kind::flag, "", 0, 0, "true", "Whether the longest stable steps are looked for."},
     {"grains", Kind::flag, "", 0, 0, "true", "Whether the shear cells of the DEM side are run."},
     {"cell_time_limit", Kind::quantity, "s", 1, 1e6, "600 s",
      "A cell that takes longer is ended, and unexplained."},
     {"grain_cost_limit", Kind::quantity, "s", 1, 1e7, "240 s",
      "A shear cell that is expected to take more core-seconds is refused, with its cost."}}};

namespace {

struct Base {
  LawFile law;
  StabilityScale scale;
  std::string axis;
  std::vector<std::string> ingredients;  ///< of the case's [flow], as given to --set
  bool solver = true, step_limits = true, grains = true;
  double cell_limit = 0, grain_limit = 0;  ///< [s]
};

/// What a case says about how a flow is computed, whatever its scene.
constexpr const char* ingredient_words[] = {"formulation",
                                            "kernel",
                                            "density",
                                            "walls",
                                            "stress",
                                            "damping",
                                            "dilation",
                                            "shifting",
                                            "gradient_correction",
                                            "velocity_averaging"};
constexpr const char* ingredient_numbers[] = {"h_over_dx",   "density_diffusion", "shear_modulus",
                                              "step_factor", "eos_exponent",      "artificial_viscosity"};

Base base_of(const CaseFile& file) {
  Base base;
  base.law = law_of_case(file);
  if (base.law.friction.member != "rational")
    throw UsageError(fmt::format("{}: stability varies the parameters of a rational law: give one in [law]",
                                 file.path().string()));
  const Section section = file.section(stability_table);
  base.axis = section.word("axis");
  base.solver = section.flag("solver"), base.grains = section.flag("grains");
  base.step_limits = section.flag("step_limits");
  base.cell_limit = section.quantity("cell_time_limit");
  base.grain_limit = section.quantity("grain_cost_limit");
  base.scale.d = base.law.d, base.scale.rho_s = base.law.rho_s;
  base.scale.rho0 = base.law.solid_fraction["phi_c"] * base.law.rho_s;
  base.scale.rows = section.integer("rows");
  const Section flow = file.section(*flow_tables().front());
  for (const char* key : ingredient_words)
    if (flow.given(key)) base.ingredients.push_back(fmt::format("flow.{}={}", key, flow.word(key)));
  for (const char* key : ingredient_numbers)
    if (flow.given(key)) base.ingredients.push_back(fmt::format("flow.{}={:.17g}", key, flow.number(key)));
  if (flow.given("g_min"))
    base.ingredients.push_back(fmt::format("flow.g_min={:.17g} 1/s", flow.quantity("g_min")));
  return base;
}

/// The law as a section of a case, so that a cell can change one of its keys.
std::string law_text(const LawFile& law) {
  std::string text = fmt::format(
      "[law]\nd = \"{:.17g} m\"\nrho_s = \"{:.17g} kg/m^3\"\nphi_c = {:.17g}\nb = {:.17g}\ns_star = "
      "{:.17g}\n",
      law.d, law.rho_s, law.solid_fraction["phi_c"], std::max(law.solid_fraction["b"], 1e-3),
      law.dilation.member == "none" ? 0.3 : law.dilation["s_star"]);
  for (const FittedParameter& p : law.friction.parameters)
    text += fmt::format("{} = {:.17g}\n", p.name, p.value);
  return text;
}

/// Barker and Gray's law with the same parameters, instead of a rational one.
std::string well_posed_law_text(const LawFile& law) {
  return fmt::format(
      "[law]\nd = \"{:.17g} m\"\nrho_s = \"{:.17g} kg/m^3\"\nphi_c = {:.17g}\nfriction = "
      "\"barker_gray_2017\"\n"
      "mu_s = {:.17g}\nmu_2 = {:.17g}\nI_0 = {:.17g}\n",
      law.d, law.rho_s, law.solid_fraction["phi_c"], law.friction["mu_l"], law.friction["mu_h"],
      law.friction["D_star"]);
}

std::string name_of_cell(const std::string& axis, const std::string& value) {
  std::string name = axis + "__" + value;
  for (char& c : name)
    if (std::isalnum(static_cast<unsigned char>(c)) == 0 && c != '.' && c != '-') c = '_';
  return name;
}

std::string read_all(const fs::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// The program's own last words: the line of the error.
std::string last_words(const fs::path& log) {
  std::string text = read_all(log), found;
  static const std::regex line("(?:^|\n)dem2sph: ([^\n]*)");
  for (auto it = std::sregex_iterator(text.begin(), text.end(), line); it != std::sregex_iterator(); ++it)
    found = (*it)[1];
  return found.empty() ? text.substr(0, 400) : found;
}

/// How a cell ended. The first four are what a user can act on.
json verdict(const char* status, const std::string& text) { return {{"status", status}, {"text", text}}; }

std::mutex reading;  // Debian's HDF5 serves one thread at a time

/// Everything in the frames of a run is a number.
bool frames_are_finite(const fs::path& folder) {
  for (const fs::directory_entry& entry : fs::directory_iterator(folder / "frames")) {
    if (entry.path().extension() != ".h5") continue;
    const Frame frame = read_frame(entry.path());
    for (const FrameField& field : frame.fields)
      for (const double value : field.values)
        if (!std::isfinite(value)) return false;
  }
  return true;
}

Frame last_frame(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder / "frames"))
    if (entry.path().extension() == ".h5") files.push_back(entry.path());
  return read_frame(*std::max_element(files.begin(), files.end()));
}

/// What the oracle of a cell says about a run that ended without an error; empty: it holds.
std::string judge(const StabilityCell& cell, const Base& base, const fs::path& folder, const json& summary,
                  json& figures) {
  const auto series = [&](const char* what) -> const json& { return summary.at("series").at(what); };
  for (const auto& [name, values] : summary.at("series").items())
    for (const json& v : values)
      if (!v.is_number()) return fmt::format("the series \"{}\" holds what is no number", name);
  if (!frames_are_finite(folder)) return "a frame holds what is no number";
  const double U = base.scale.speed();
  figures["mach"] = summary.at("extremes").at("mach");
  figures["rho_over_rho0"] = summary.at("extremes").at("rho_over_rho0");
  const double turned = summary.at("extremes").at("energy_turned_over").get<double>();
  figures["energy_unaccounted"] =
      turned > 0 ? summary.at("extremes").at("energy_unaccounted").get<double>() / turned : 0.0;
  if (summary.contains("deposit")) figures["runout"] = summary.at("deposit").at("runout");
  switch (cell.oracle) {
    case Oracle::rest: {
      const double speed = series("max_speed").back().get<double>() / U;
      figures["speed_at_the_end"] = speed;
      // How far it went after it had settled.
      const json &time = series("time"), &height = series("centre_height"), &front = series("front_99");
      std::size_t settled = 0;
      while (settled + 1 < time.size() && time[settled].get<double>() < 20 * base.scale.time()) ++settled;
      for (const auto& [name, values] :
           {std::pair{"height_moved", &height}, std::pair{"front_moved", &front}})
        figures[name] =
            (values->back().get<double>() - (*values)[settled].get<double>()) / base.scale.height();
      return speed < 0.01 ? "" : fmt::format("it moves at {:.2g} sqrt(gH) where it should rest", speed);
    }
    case Oracle::mu_of_I: {
      const CaseFile file = CaseFile::load(folder.parent_path() / "case.toml");
      const double rate = file.section(*flow_tables()[3]).quantity("shear_rate");
      const Frame frame = last_frame(folder);
      const std::vector<double>&p = frame.field("p").values, &s = frame.field("stress").values,
            &g = frame.field("gamma_dot").values, &kind = frame.field("kind").values;
      double pressure = 0, shear = 0, gamma = 0, n = 0;
      for (std::size_t i = 0; i < kind.size(); ++i)
        if (kind[i] == 0) pressure += p[i], shear += s[6 * i + 3], gamma += g[i], n += 1;
      const double I = rate * base.law.d / std::sqrt(pressure / n / base.law.rho_s);
      const double mu_l = base.law.friction["mu_l"], mu_h = base.law.friction["mu_h"],
                   D = base.law.friction["D_star"];
      const double expected = mu_l + (mu_h - mu_l) * I / (I + D);
      figures["mu"] = std::abs(shear) / pressure, figures["I"] = I, figures["mu_of_law"] = expected;
      figures["shear_rate_over_set"] = gamma / n / rate;
      const double off = std::abs(shear) / pressure / expected - 1;
      return std::abs(off) < 0.05 ? ""
                                  : fmt::format("mu is {:.3f}, and that of the law at I = {:.3g} is {:.3f}",
                                                std::abs(shear) / pressure, I, expected);
    }
    case Oracle::flight: {
      const CaseFile file = CaseFile::load(folder.parent_path() / "case.toml");
      const json& end = summary.at("budgets").at("final");
      Vec<2> off = read_geometry<2>(file).bodies.front().velocity;  // what is left of it
      off[1] -= file.section(*flow_tables().front()).quantity("gravity") * summary.at("time").get<double>();
      for (int k = 0; k < 2; ++k)
        off[k] -=
            end.at("momentum").at(static_cast<std::size_t>(k)).get<double>() / end.at("mass").get<double>();
      figures["velocity_off"] = norm(off) / U;
      return norm(off) / U < 1e-6
                 ? ""
                 : fmt::format("the mean velocity is {:.2g} sqrt(gH) off that of free flight", norm(off) / U);
    }
    case Oracle::evenness: {
      const Frame frame = last_frame(folder);
      const std::vector<double>&v = frame.field("v").values, &kind = frame.field("kind").values;
      double up = 0, along = 0;
      for (std::size_t i = 0; i < kind.size(); ++i)
        if (kind[i] == 0) up += v[3 * i + 1] * v[3 * i + 1], along += v[3 * i] * v[3 * i];
      figures["vertical_over_along"] = std::sqrt(up / along);
      break;
    }
    case Oracle::budgets:
    case Oracle::same_front:
      break;
  }
  return "";
}

/// Runs one cell of the solver, or takes its result from the folder.
json run_cell(const StabilityCell& cell, const Base& base, const fs::path& folder,
              const CommonOptions& options) {
  const fs::path where = folder / "cells" / name_of_cell(cell.axis, cell.value);
  std::vector<std::string> set = base.ingredients;
  set.insert(set.end(), cell.set.begin(), cell.set.end());
  const bool well_posed = std::find(set.begin(), set.end(), "law.friction=barker_gray_2017") != set.end();
  std::erase(set, "law.friction=barker_gray_2017");
  const std::string text = cell.text + (well_posed ? well_posed_law_text(base.law) : law_text(base.law));
  std::vector<std::string> arguments{fs::read_symlink("/proc/self/exe").string(),
                                     "flow",
                                     "case.toml",
                                     "-o",
                                     "out",
                                     "-q",
                                     "--threads",
                                     "1",
                                     "--force"};
  for (const std::string& s : set) arguments.push_back("--set"), arguments.push_back(s);
  const std::string key =
      sha256(json{text, set, git_revision, version, static_cast<int>(cell.oracle)}.dump());
  json result;
  if (!options.force && fs::exists(where / "result.json")) {
    result = read_json(where / "result.json");
    if (result.value("key", "") == key) return result;
  }
  fs::create_directories(where);
  write_file_atomically(where / "case.toml", text);
  SubprocessOptions how;
  how.folder = where, how.output = where / "log.txt", how.time_limit = base.cell_limit;
  how.environment = {{"OMP_NUM_THREADS", "1"}};
  const SubprocessResult run = run_subprocess(arguments, how);
  if (run.stopped) throw Interrupted("stability: stopped on request; the same command goes on");
  std::string command = "dem2sph flow case.toml -o out";
  for (const std::string& s : set) command += fmt::format(" --set '{}'", s);
  result = {{"key", key},       {"axis", cell.axis},  {"value", cell.value},
            {"side", "solver"}, {"command", command}, {"cpu_seconds", run.cpu_seconds}};
  json figures = json::object();
  const std::string words = last_words(where / "log.txt");
  if (run.timed_out) {
    result.update(verdict("unexplained", fmt::format("not ended after {:.0f} s", base.cell_limit)));
  } else if (run.ok()) {
    const json summary = read_json(where / "out" / "summary.json");
    const std::lock_guard lock(reading);
    const std::string wrong = judge(cell, base, where / "out", summary, figures);
    std::vector<std::string> causes, texts;
    for (const json& w : summary.at("warnings"))
      causes.push_back(w.at("cause").get<std::string>()), texts.push_back(w.at("text").get<std::string>());
    // That a law is ill-posed is said by nearly every flow with mu(I); it makes a cell no less stable.
    const bool of_numerics = std::any_of(causes.begin(), causes.end(),
                                         [](const std::string& cause) { return cause != "ill-posed law"; });
    if (of_numerics || (!causes.empty() && (cell.axis == "ill_posed_law" || !wrong.empty())))
      result.update(verdict("warned", fmt::format("{}", fmt::join(texts, "; "))));
    else
      result.update(verdict(wrong.empty() ? "stable" : "silent", wrong));
    if (!causes.empty() && !wrong.empty()) result["oracle"] = wrong;
    result["causes"] = causes;
    result["steps"] = summary.at("steps");
    if (cell.oracle == Oracle::same_front) figures["front_99"] = summary.at("series").at("front_99").back();
  } else if (run.exit_code == static_cast<int>(ExitCode::usage)) {
    result.update(verdict("refused", words));
  } else if (run.exit_code == static_cast<int>(ExitCode::numerical)) {
    result.update(verdict("stopped", words));
  } else {
    result.update(
        verdict("unexplained", run.signal != 0 ? fmt::format("killed by signal {}", run.signal) : words));
  }
  result["figures"] = figures;
  write_file_atomically(where / "result.json", result.dump(1) + "\n");
  fs::remove_all(where / "out" / "frames");
  return result;
}

/// A collapse in which one particle starts almost on top of another: no case file can say that.
json run_overlap(double distance, const Base& base) {
  const CaseFile file =
      CaseFile::parse(stability_cells(base.scale, "step_factor").front().text + law_text(base.law), "overlap",
                      base.ingredients);
  FlowSetup<2> setup = make_setup<2>(file, law_of_case(file));
  setup.step_factor = 1;
  Particles<2>& q = setup.particles;
  const std::size_t middle = q.interior / 2;
  q.x[0][middle] = q.x[0][middle + 1] + distance * setup.dx;
  q.x[1][middle] = q.x[1][middle + 1];
  const double end = setup.end_time;
  json result{{"axis", "particles on top of each other"},
              {"value", fmt::format("{:g} dx apart", distance)},
              {"side", "solver"},
              {"command", "in the program: a column with one particle moved"},
              {"figures", json::object()}};
  try {
    const std::unique_ptr<Flow> flow = make_flow<2>(std::move(setup));
    const Budgets start = flow->budgets();
    while (flow->time() < end * (1 - 1e-12)) flow->step(end - flow->time());
    const Budgets b = flow->budgets();
    const double turned = b.kinetic + std::abs(b.potential - start.potential) + b.dissipated;
    const double off = std::abs(b.unaccounted_since(start)) / turned;
    result["figures"]["energy_unaccounted"] = off;
    result.update(off < 0.05 ? verdict("stable", "")
                             : verdict("silent", fmt::format("{:.0f} % of the energy is lost", 100 * off)));
  } catch (const NumericalError& error) {
    result.update(verdict("stopped", error.what()));
  }
  return result;
}
constexpr double overlaps[] = {0, 1e-9, 1e-3, 0.1};

/// Runs one shear cell, or refuses it for its cost.
json run_grain_cell(const GrainCell& cell, const Base& base, const fs::path& folder,
                    const CommonOptions& options) {
  const fs::path where = folder / "grains" / name_of_cell(cell.axis, cell.value);
  const std::string text = grain_cell_case(base.law);
  const std::string key = sha256(json{text, cell.set, base.grain_limit, git_revision, version}.dump());
  json result;
  if (!options.force && fs::exists(where / "result.json")) {
    result = read_json(where / "result.json");
    if (result.value("key", "") == key) return result;
  }
  fs::create_directories(where);
  std::vector<std::string> set = cell.set;
  // Linear springs have no Young's modulus.
  std::string own = text;
  if (std::find(set.begin(), set.end(), "material.contact=hooke") != set.end()) {
    own.erase(own.find("youngs_modulus"), own.find("[shear_cell]") - own.find("youngs_modulus"));
  }
  write_file_atomically(where / "case.toml", own);
  std::string command = "dem2sph sweep case.toml -o out --jobs 1";
  for (const std::string& s : set) command += fmt::format(" --set '{}'", s);
  result = {
      {"key", key}, {"axis", cell.axis}, {"value", cell.value}, {"side", "grains"}, {"command", command}};
  const auto finish = [&](json how) {
    result.update(std::move(how));
    write_file_atomically(where / "result.json", result.dump(1) + "\n");
    return result;
  };
  try {
    const double cost =
        bridge::plan_sweep(CaseFile::load(where / "case.toml", set), bridge::engine_unknown).core_seconds();
    result["expected_core_seconds"] = cost;
    if (cost > base.grain_limit)
      return finish(verdict("refused", fmt::format("it would take {:.2g} core-hours, more than the {:.2g} of "
                                                   "stability.grain_cost_limit",
                                                   cost / 3600, base.grain_limit / 3600)));
  } catch (const UsageError& error) {
    return finish(verdict("refused", error.what()));
  }
  std::vector<std::string> arguments{
      fs::read_symlink("/proc/self/exe").string(), "sweep", "case.toml", "-o", "out", "--jobs", "1", "-q"};
  for (const std::string& s : set) arguments.push_back("--set"), arguments.push_back(s);
  SubprocessOptions how;
  how.folder = where, how.output = where / "log.txt", how.time_limit = base.cell_limit;
  const SubprocessResult run = run_subprocess(arguments, how);
  if (run.stopped) throw Interrupted("stability: stopped on request; the same command goes on");
  result["cpu_seconds"] = run.cpu_seconds;
  const std::string words = last_words(where / "log.txt");
  if (run.timed_out)
    return finish(verdict("unexplained", fmt::format("not ended after {:.0f} s", base.cell_limit)));
  if (run.exit_code == static_cast<int>(ExitCode::usage)) return finish(verdict("refused", words));
  const std::lock_guard lock(reading);
  const fs::path observed = where / "out" / "observables.h5";
  const Observables seen = fs::exists(observed) ? read_observables(observed) : Observables{};
  if (seen.steady.empty())
    return finish(verdict(run.exit_code == static_cast<int>(ExitCode::engine) ? "stopped" : "unexplained",
                          seen.excluded.empty() ? words : seen.excluded.front().reason));
  const SteadyPoint& point = seen.steady.front();
  result["figures"] = {{"I", point.I},     {"mu", point.mu},         {"mu_se", point.mu_se},
                       {"phi", point.phi}, {"phi_se", point.phi_se}, {"phi_drift", point.phi_drift}};
  std::vector<std::string> doubts;
  if (std::abs(point.phi_drift) > 3)
    doubts.push_back(
        fmt::format("the solid fraction still drifts, by {:.1f} standard errors", point.phi_drift));
  if (!point.mu_flat) doubts.push_back("the standard error of mu had not stopped growing with the blocks");
  if (read_all(where / "log.txt").find("dem2sph: ") != std::string::npos) doubts.push_back(words);
  return finish(doubts.empty() ? verdict("stable", "")
                               : verdict("warned", fmt::format("{}", fmt::join(doubts, "; "))));
}

/// Fronts of the cells that have to agree.
void judge_fronts(json& cells) {
  std::map<std::string, std::pair<double, double>> range;
  for (const json& c : cells)
    if (c.at("figures").contains("front_99")) {
      const double front = c.at("figures").at("front_99").get<double>();
      auto [at, fresh] = range.try_emplace(c.at("axis").get<std::string>(), front, front);
      at->second = {std::min(at->second.first, front), std::max(at->second.second, front)};
    }
  for (json& c : cells) {
    if (!c.at("figures").contains("front_99")) continue;
    const auto [low, high] = range.at(c.at("axis").get<std::string>());
    c["figures"]["fronts_apart"] = high / low - 1;
    if (!(high / low - 1 < 0.03) && c.at("status") == "stable")
      c.update(
          verdict("silent", fmt::format("front_99 of this axis is {:.1f} % apart", 100 * (high / low - 1))));
  }
}

/// How far each cell of an axis is from the cell that is nearest to the limit which the axis goes to: the
/// stiffest grains, the shortest step.
void compare_with_limit(json& cells, const char* axis, bool largest) {
  const json* limit = nullptr;
  double best = 0;
  for (const json& c : cells) {
    if (c.at("axis") != axis || !c.contains("figures")) continue;
    const double value = std::stod(c.at("value").get<std::string>());
    if (limit == nullptr || (largest ? value > best : value < best)) limit = &c, best = value;
  }
  if (limit == nullptr) return;
  const json reference = limit->at("figures");
  for (json& c : cells) {
    if (c.at("axis") != axis || !c.contains("figures")) continue;
    for (const char* what : {"mu", "phi"}) {
      const std::string se = fmt::format("{}_se", what);
      json& own = c["figures"];
      own[fmt::format("{}_off", what)] = own.at(what).get<double>() - reference.at(what).get<double>();
      own[fmt::format("{}_off_se", what)] =
          std::hypot(own.at(se).get<double>(), reference.at(se).get<double>());
    }
  }
}

// ---- longest stable steps

/// Longest step factor at which a collapse keeps its energy as well as with short steps (or to 5 %): tried
/// with the solver itself.
double flowing_limit(const CaseFile& file) {
  const auto energy_off = [&](double factor) {
    FlowSetup<2> setup = make_setup<2>(file, law_of_case(file));
    const double end = setup.end_time;
    setup.step_factor = factor;
    const std::unique_ptr<Flow> flow = make_flow<2>(std::move(setup));
    const Budgets start = flow->budgets();
    try {
      while (flow->time() < end * (1 - 1e-12)) flow->step(end - flow->time());
    } catch (const NumericalError&) {
      return std::numeric_limits<double>::infinity();  // that is the question
    }
    const Budgets b = flow->budgets();
    const double turned = b.kinetic + std::abs(b.potential - start.potential) + b.dissipated;
    return std::abs(b.unaccounted_since(start)) / turned;
  };
  double low = 0.25;
  const double allowed = std::max(0.05, 1.5 * energy_off(low));
  if (!std::isfinite(allowed)) return 0;  // no step helps
  const auto holds = [&](double factor) { return energy_off(factor) < allowed; };
  double high = 2 * low;
  while (high < 32 && holds(high)) low = high, high *= 2;
  while (high > 1.05 * low) {
    const double middle = std::sqrt(low * high);
    (holds(middle) ? low : high) = middle;
  }
  return low;
}

json step_limits_of(const std::string& name, const std::vector<std::string>& set, const Base& base,
                    const std::string& collapse) {
  std::vector<std::string> all = base.ingredients;
  all.insert(all.end(), set.begin(), set.end());
  const CaseFile file = CaseFile::parse(collapse + law_text(base.law), "collapse", all);
  const FlowSetup<2> setup = make_setup<2>(file, law_of_case(file));
  json entry{{"composition", name}, {"set", set}};
  // On the lattice the noise shears more slowly than g_min, so that the viscosity of direct stress is known.
  // Without it the pressure is low, since a compressed lattice may pair (Dehnen and Aly 2012), whatever the
  // step.
  const DirectStress* direct = std::get_if<DirectStress>(&setup.parts.stress);
  const double p0 = (direct != nullptr ? 0.02 : 1e-4) * setup.eos.K;
  const double viscosity =
      direct != nullptr ? least_friction(setup.parts.friction) * p0 / direct->gamma_dot_min : 0;
  const StepLimit linear = linear_step_limit(setup, viscosity);
  const double viscous =
      viscosity > 0 ? 0.125 * setup.h * setup.h * setup.eos.rho0 / viscosity : linear.sound_bound;
  const double bound = std::min(linear.sound_bound, viscous);
  entry["bound"] = bound;
  entry["which"] =
      bound_names[static_cast<std::size_t>(viscous < linear.sound_bound ? Bound::viscosity : Bound::sound)];
  entry["two_over_omega_max"] = 2 / linear.omega_max / bound;
  entry["linear"] = linear.step / bound;
  entry["lattice"] = measured_step_limit(setup, p0) / bound;
  entry["lattice_over_linear"] = entry.at("lattice").get<double>() / entry.at("linear").get<double>();
  if (const double flowing = flowing_limit(file); flowing > 0) {
    entry["flowing"] = flowing;
    entry["margin_of_5_28"] = std::min(entry.at("linear").get<double>(), flowing);
  }
  return entry;
}

std::vector<std::pair<std::string, std::vector<std::string>>> compositions_to_try(const Base& base) {
  const std::string g_min = fmt::format("flow.g_min={:.6g} 1/s", 0.5 / base.scale.time());
  std::vector<std::pair<std::string, std::vector<std::string>>> list{{"as the case has it", {}}};
  for (const char* setting :
       {"kernel=cubic_spline", "kernel=wendland_c4", "h_over_dx=1.2", "h_over_dx=2", "density=summation",
        "density=summation_shepard", "density=continuity_monaghan_1994", "density_diffusion=1",
        "damping=none", "damping=monaghan", "artificial_viscosity=1", "artificial_viscosity=2",
        "gradient_correction=bonet_lok_1999", "velocity_averaging=xsph", "shear_modulus=0.01",
        "shear_modulus=1.5", "eos_exponent=7"})
    list.push_back({setting, {fmt::format("flow.{}", setting)}});
  list.push_back({"stress=direct", {"flow.stress=direct", g_min}});
  // What a material or a scene does to it.
  for (const double c : {20.0, 80.0})
    list.push_back({fmt::format("c = {:g} sqrt(gH)", c),
                    {fmt::format("flow.sound_speed={:.9g} m/s", c * base.scale.speed())}});
  list.push_back({"mu_l = 0.1, mu_h = 0.4", {"law.mu_l=0.1", "law.mu_h=0.4"}});
  list.push_back({"mu_h = mu_l = 1.5", {"law.mu_l=1.5", "law.mu_h=1.5"}});
  list.push_back({"D* = 1e-4", {"law.D_star=1e-4"}});
  for (const double scale : {1e-4, 1.0})
    list.push_back({fmt::format("dilation, s* = {:g}", scale),
                    {"flow.dilation=evolve", "flow.initial_solid_fraction=0.61",
                     fmt::format("law.s_star={:g}", scale)}});
  list.push_back(
      {"cohesion of rho g H/10",
       {fmt::format("flow.cohesion={:.6g} Pa", 0.1 * base.scale.rho0 * base.scale.g * base.scale.height())}});
  list.push_back({"source", {"flow.formulation=source", g_min}});
  return list;
}

}  // namespace

json run_stability(const fs::path& case_path, const fs::path& folder, const CommonOptions& options) {
  const CaseFile file = load_case(case_path, options.overrides);
  const Base base = base_of(file);
  fs::create_directories(folder);
  struct Task {
    double work = 0;
    std::function<json()> run;
    json* into = nullptr;
  };
  std::vector<Task> tasks;
  const std::vector<StabilityCell> cells =
      base.solver ? stability_cells(base.scale, base.axis) : std::vector<StabilityCell>{};
  const std::vector<GrainCell> grains = base.grains ? grain_cells() : std::vector<GrainCell>{};
  std::vector<json> solver_results(cells.size()), grain_results(grains.size()), limits;
  const std::size_t from_files = cells.size();
  if (base.solver && base.axis == every_axis) solver_results.resize(from_files + std::size(overlaps));
  for (std::size_t i = 0; i < cells.size(); ++i)
    tasks.push_back(
        {cells[i].work, [&, i] { return run_cell(cells[i], base, folder, options); }, &solver_results[i]});
  for (std::size_t i = from_files; i < solver_results.size(); ++i)
    tasks.push_back({3, [&, i] { return run_overlap(overlaps[i - from_files], base); }, &solver_results[i]});
  for (std::size_t i = 0; i < grains.size(); ++i)
    tasks.push_back(
        {40, [&, i] { return run_grain_cell(grains[i], base, folder, options); }, &grain_results[i]});
  const auto compositions = compositions_to_try(base);
  const std::string collapse = stability_cells(base.scale, "step_factor").front().text;
  if (base.step_limits) {
    limits.resize(compositions.size());
    for (std::size_t i = 0; i < compositions.size(); ++i) {
      tasks.push_back(
          {30,
           [&, i] { return step_limits_of(compositions[i].first, compositions[i].second, base, collapse); },
           &limits[i]});
    }
  }
  // The longest first, so that none is left to run alone.
  std::stable_sort(tasks.begin(), tasks.end(), [](const Task& a, const Task& b) { return a.work > b.work; });
  Progress progress(fmt::format("stability {}", folder.filename().string()), options.quiet);
  std::atomic<std::size_t> next{0};
  std::size_t done = 0;
  std::mutex mutex;
  std::exception_ptr failure;
  const auto worker = [&] {
#ifdef _OPENMP
    omp_set_num_threads(1);  // of this worker
#endif
    for (std::size_t i = next++; i < tasks.size() && !stop_requested(); i = next++) {
      try {
        json result = tasks[i].run();
        const std::lock_guard lock(mutex);
        *tasks[i].into = std::move(result);
        progress.update(static_cast<double>(++done) / static_cast<double>(tasks.size()),
                        fmt::format("{} of {}", done, tasks.size()));
      } catch (...) {
        const std::lock_guard lock(mutex);
        if (!failure) failure = std::current_exception();
        next = tasks.size();
      }
    }
  };
  std::vector<std::thread> workers;
  for (int j = 0; j < jobs_or_cores(options.jobs); ++j) workers.emplace_back(worker);
  for (std::thread& w : workers) w.join();
  if (failure) std::rethrow_exception(failure);
  if (stop_requested()) throw Interrupted("stability: stopped on request; the same command goes on");

  json solver = solver_results;
  judge_fronts(solver);
  json shear_cells = grain_results;
  compare_with_limit(shear_cells, "stiffness kappa", true);
  compare_with_limit(shear_cells, "time step over Rayleigh's", false);
  json result{{"format", "dem2sph-stability"}, {"schema_version", 1},   {"solver", solver},
              {"grains", shear_cells},         {"step_limits", limits}, {"provenance", provenance()}};
  std::map<std::string, int> count;
  double core_seconds = 0;
  for (const char* side : {"solver", "grains"})
    for (const json& c : result.at(side)) {
      ++count[c.at("status").get<std::string>()];
      core_seconds += c.value("cpu_seconds", 0.0);
    }
  result["count"] = count;
  result["core_seconds"] = core_seconds;
  result["unexplained"] = count["silent"] + count["unexplained"];
  for (const char* side : {"solver", "grains"})
    for (json& c : result.at(side)) c.erase("key");
  write_file_atomically(folder / "stability.json", result.dump(1) + "\n");
  write_stability_page(result, folder);
  progress.finish(fmt::format("{} cells", solver.size() + grain_results.size()));
  return result;
}

std::string plan_stability(const fs::path& case_path, const CommonOptions& options) {
  const Base base = base_of(load_case(case_path, options.overrides));
  std::map<std::string, int> axes;
  std::string text;
  double work = 0;
  if (base.solver)
    for (const StabilityCell& c : stability_cells(base.scale, base.axis)) ++axes[c.axis], work += c.work;
  for (const auto& [name, n] : axes) text += fmt::format("solver  {:<28} {:>3} cells\n", name, n);
  axes.clear();
  if (base.grains)
    for (const GrainCell& c : grain_cells()) ++axes[c.axis], work += 15;
  for (const auto& [name, n] : axes) text += fmt::format("grains  {:<28} {:>3} cells\n", name, n);
  if (base.step_limits)
    text += fmt::format("longest stable steps of {} compositions\n", compositions_to_try(base).size()),
        work += 200;
  return text + fmt::format("about {:.0f} core-minutes\n", work / 60);
}

}  // namespace dem2sph
