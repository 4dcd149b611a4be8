#include "cases/left_out.hpp"

#include <fmt/format.h>
#ifdef _OPENMP
#include <omp.h>
#endif
#include <spdlog/spdlog.h>
#include <time.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <variant>

#include "sph/base/errors.hpp"
#include "sph/flow.hpp"
#include "sph/scene.hpp"

namespace dem2sph {

using nlohmann::json;

namespace {

constexpr int turns = 5;
constexpr double seconds_of_a_turn =
    0.15;  // far above the clock's grain, and some ten steps of 10^4 particles

double cpu_seconds() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

struct Switch {
  std::string part;
  std::vector<std::string> overrides;
};

/// What the composition of `setup` lacks, and the keys that bring it in.
template <int Dim>
std::vector<Switch> switches_of(const FlowSetup<Dim>& setup, const LawFile& law) {
  const Parts& parts = setup.parts;
  std::vector<Switch> list;
  const auto add = [&](bool lacking, const char* part, std::vector<std::string> overrides) {
    if (lacking) list.push_back({part, std::move(overrides)});
  };
  const auto is = [](const auto& part, auto type) { return std::holds_alternative<decltype(type)>(part); };
  add(is(parts.correction, NoCorrection{}), "gradient correction",
      {"flow.gradient_correction=bonet_lok_1999"});
  add(!is(parts.density, SummationShepard{}), "density sum and Shepard filter",
      {"flow.density=summation_shepard"});
  add(is(parts.averaging, NoAveraging{}), "velocity averaging", {"flow.velocity_averaging=xsph"});
  add(is(parts.shifting, NoShifting{}), "shifting", {"flow.shifting=sun_2017"});
  const bool printed = law.dilation.member == "printed";
  const std::string evolve = law.dilation.member == "none" ? "flow.dilation=direct"
                             : printed                     ? "flow.dilation=evolve_printed"
                                                           : "flow.dilation=evolve";
  const bool still = is(parts.dilation, NoDilation{});
  add(still, "dilation", {evolve});
  add(!parts.swelling && !printed && law.dilation.member != "none",
      still ? "dilation with swelling" : "swelling", {evolve, "flow.swelling=true"});
  add(is(parts.damping, NoDamping{}), "damping", {"flow.damping=monaghan"});
  add(!is(parts.damping, BalsaraDamping{}), "damping with its limiter", {"flow.damping=balsara"});
  add(is(parts.stress, ElasticReturn{}), "direct stress and its viscous bound", {"flow.stress=direct"});
  add(is(parts.stress, DirectStress{}), "elastic predictor and return", {"flow.stress=elastic_return"});
  add(is(parts.walls, WallAdami2012{}), "density and stress of boundary particles",
      {"flow.walls=boundary_particles"});
  const bool basal = std::any_of(setup.geometry.walls.begin(), setup.geometry.walls.end(),
                                 [](const Wall<Dim>& w) { return !std::isnan(w.basal_friction); });
  add(!basal, "basal friction", {"flow.basal_friction=0.4"});
  const bool moving = std::any_of(setup.geometry.walls.begin(), setup.geometry.walls.end(),
                                  [](const Wall<Dim>& w) { return w.moves(); });
  if (!moving && setup.scene == "geometry" && !setup.geometry.walls.empty()) {
    std::string velocity = "[";
    for (int c = 0; c < Dim; ++c) velocity += c == 0 ? "\"1e-12 m/s\"" : ", \"0 m/s\"";
    list.push_back(
        {"moving walls", {fmt::format("wall.{}.velocity={}]", setup.geometry.walls.front().name, velocity)}});
  }
  add(Dim == 2, "the third dimension", {"flow.dimension=3"});
  return list;
}

std::unique_ptr<Flow> flow_of(const CaseFile& file, const LawFile& law) {
  return flow_dimension(file) == 3 ? make_flow<3>(make_setup<3>(file, law))
                                   : make_flow<2>(make_setup<2>(file, law));
}

/// What a stretch of a flow took.
struct Stretch {
  double core_seconds = 0, time = 0, steps = 0;
};
Stretch advance(Flow& flow) {
  const double start = cpu_seconds(), from = flow.time();
  Stretch s;
  do {
    flow.step(std::numeric_limits<double>::infinity());
    ++s.steps;
    s.core_seconds = cpu_seconds() - start;
  } while (s.core_seconds < seconds_of_a_turn);
  s.time = flow.time() - from;
  return s;
}

double bytes_of(const Flow& flow) {
  return static_cast<double>(flow.bytes()) / static_cast<double>(flow.particles());
}

json measure(const CaseFile& base, const CaseFile& with, const LawFile& law) {
  const std::unique_ptr<Flow> a = flow_of(base, law), b = flow_of(with, law);
  advance(*a), advance(*b);  // the first lists and pages
  std::array<double, turns> cost{}, steps{};
  for (std::size_t k = 0; k < turns; ++k) {
    const Stretch without = advance(*a), more = advance(*b);
    cost[k] = more.core_seconds / more.time / (without.core_seconds / without.time);
    steps[k] = more.steps / more.time / (without.steps / without.time);
  }
  std::sort(cost.begin(), cost.end()), std::sort(steps.begin(), steps.end());
  return {{"cost_ratio", cost[turns / 2]},
          {"low", cost.front()},
          {"high", cost.back()},
          {"steps_ratio", steps[turns / 2]},
          {"bytes_ratio", bytes_of(*b) / bytes_of(*a)},
          {"particles", b->interior()}};
}

}  // namespace

json measure_left_out(const std::filesystem::path& case_path, const LawFile& law,
                      const CommonOptions& options) {
#ifdef _OPENMP
  omp_set_num_threads(1);
#endif
  const CaseFile base = load_case(case_path, options.overrides);
  const std::vector<Switch> switches = flow_dimension(base) == 3 ? switches_of(make_setup<3>(base, law), law)
                                                                 : switches_of(make_setup<2>(base, law), law);
  json result{{"composition", flow_of(base, law)->composition()}, {"parts", json::array()}};
  for (const Switch& s : switches) {
    std::vector<std::string> overrides = options.overrides;
    overrides.insert(overrides.end(), s.overrides.begin(), s.overrides.end());
    json entry{{"part", s.part}, {"setting", s.overrides}};
    try {
      entry.update(measure(base, load_case(case_path, overrides), law));
    } catch (const UsageError& error) {
      entry["refused"] = error.what();
    } catch (const NumericalError& error) {
      entry["refused"] = fmt::format("the flow with it ended: {}", error.what());
    }
    if (!options.quiet) spdlog::info("{}: measured", s.part);
    result["parts"].push_back(std::move(entry));
  }
  return result;
}

std::string describe_left_out(const json& measured) {
  std::string text = fmt::format("{:<42} {:>22} {:>7} {:>7}\n", "left out; what it would cost",
                                 "core-seconds, times", "steps", "memory");
  for (const json& p : measured.at("parts")) {
    const std::string part = p.at("part").get<std::string>();
    text += p.contains("refused")
                ? fmt::format("{:<42} {}\n", part, p.at("refused").get<std::string>())
                : fmt::format("{:<42} {:>7.2f} ({:.2f} to {:.2f}) {:>7.2f} {:>7.2f}\n", part,
                              p.at("cost_ratio").get<double>(), p.at("low").get<double>(),
                              p.at("high").get<double>(), p.at("steps_ratio").get<double>(),
                              p.at("bytes_ratio").get<double>());
  }
  return text;
}

}  // namespace dem2sph
