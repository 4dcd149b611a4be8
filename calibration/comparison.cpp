#include "calibration/comparison.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/statistics.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph {

using nlohmann::json;

namespace {

// What is asked for of a calibrated law without tuning.
constexpr double bar_of_lengths = 0.05, bar_of_tall_columns = 0.10, bar_of_rest = 0.15;
/// Above this aspect ratio a column is tall: grains fall freely before they spread.
constexpr double tall = 3;
/// Kinetic energy over m g H below which a bed stands.
constexpr double still = 1e-4;

std::vector<double> mean_of(const std::vector<std::vector<double>>& lists, std::size_t without) {
  std::vector<double> mean(lists.front().size(), 0.0);
  double n = 0;
  for (std::size_t k = 0; k < lists.size(); ++k) {
    if (k == without) continue;
    for (std::size_t i = 0; i < mean.size(); ++i) mean[i] += lists[k][i];
    ++n;
  }
  for (double& v : mean) v /= n;
  return mean;
}

}  // namespace

std::vector<double> deposit_of(const FlowRecord& flow, double reach) {
  const FlowRecord::Profile& p = flow.profiles.back();
  std::vector<double> heights;
  constexpr int points = 200;
  for (int k = 0; k < points; ++k) {
    const double x = reach * (k + 0.5) / points;
    heights.push_back(x < p.x.back() ? at_time(p.x, p.height, x) : 0);
  }
  return heights;
}

Measure measure_of(std::string name, std::string unit, const std::vector<double>& seeds, double sph,
                   double bar) {
  const MeanAndSd m = mean_and_sd(seeds);
  return {std::move(name), std::move(unit), m.mean, m.sd, std::ssize(seeds), sph, bar};
}

double at_time(const std::vector<double>& time, const std::vector<double>& values, double t) {
  if (t <= time.front()) return values.front();
  if (t >= time.back()) return values.back();
  const auto above = static_cast<std::size_t>(std::upper_bound(time.begin(), time.end(), t) - time.begin());
  const double w = (t - time[above - 1]) / (time[above] - time[above - 1]);
  return (1 - w) * values[above - 1] + w * values[above];
}

FlowRecord read_flow_record(const std::string& label, const std::filesystem::path& path) {
  const json j = read_json(path);
  FlowRecord r;
  r.label = label;
  try {
    const json& series = j.at("series");
    series.at("time").get_to(r.time);
    series.at("front_99").get_to(r.front);
    series.at("centre_height").get_to(r.height);
    series.at("kinetic_energy").get_to(r.kinetic);
    if (r.time.empty() || r.front.size() != r.time.size() || r.height.size() != r.time.size() ||
        r.kinetic.size() != r.time.size())
      throw InputError(
          fmt::format("{}: the lists in \"series\" have different lengths or are empty", path.string()));
    const double L0 = j.at("initial").at("L0").get<double>(), H0 = j.at("initial").at("H0").get<double>();
    const double tau = j.at("time_scale").get<double>();
    r.has_front = L0 > 0;
    const double length = r.has_front ? L0 : H0;
    r.H0_over_L0 = H0 / length;
    // Energies and mass of a plane flow are per depth, those of grains of the whole slab.
    const json& mass =
        j.contains("budgets") ? j.at("budgets").at("initial").at("mass") : j.at("initial").at("mass");
    const double energy = mass.get<double>() * H0 * H0 / (tau * tau);
    for (double& v : r.time) v /= tau;
    for (double& v : r.front) v /= length;
    for (double& v : r.height) v /= length;
    for (double& v : r.kinetic) v /= energy;
    for (const json& p : j.at("profiles")) {
      FlowRecord::Profile profile{p.at("time").get<double>() / tau, {}, {}};
      p.at("x").get_to(profile.x), p.at("height").get_to(profile.height);
      if (profile.x.size() < 2 || profile.x.size() != profile.height.size())
        throw InputError(fmt::format("{}: a profile has another number of x than of heights", path.string()));
      for (double& v : profile.x) v /= length;
      for (double& v : profile.height) v /= length;
      r.profiles.push_back(std::move(profile));
    }
    r.at_rest = j.at("ended").get<std::string>() == "at rest";
    r.rest_time = r.time.back();
    j.at("cpu_seconds").get_to(r.cpu_seconds);
    j.at("particles").get_to(r.particles);
    j.at("steps").get_to(r.steps);
  } catch (const json::exception& error) {
    throw InputError(fmt::format("{}: {}; was it written by `dem2sph flow` or `dem2sph dem`?", path.string(),
                                 error.what()));
  }
  return r;
}

bool Measure::within() const {
  // No difference is credited below the spread of the seeds.
  return std::abs(difference()) <= std::max(bar, spread());
}

Distance distance_of(const std::string& name, const std::vector<double>& a, const std::vector<double>& b,
                     double scale) {
  Distance d;
  d.name = name;
  const auto n = static_cast<double>(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double off = std::abs(a[i] - b[i]) / scale;
    d.L1 += off / n;
    d.L2 += off * off / n;
    d.Linf = std::max(d.Linf, off);
  }
  d.L2 = std::sqrt(d.L2);
  return d;
}

Distance compare_lists(const std::string& name, const std::vector<double>& sph,
                       const std::vector<std::vector<double>>& seeds, double scale, double bar) {
  Distance d = distance_of(name, sph, mean_of(seeds, seeds.size()), scale);
  d.bar = bar;
  if (seeds.size() > 1)
    for (std::size_t k = 0; k < seeds.size(); ++k)
      d.seeds_L2 +=
          distance_of(name, seeds[k], mean_of(seeds, k), scale).L2 / static_cast<double>(seeds.size());
  return d;
}

Comparison compare_flows(const FlowRecord& sph, const std::vector<FlowRecord>& seeds) {
  Comparison c;
  c.sph = sph;
  const auto add = [&](const char* name, const char* unit, double bar, const auto& what) {
    std::vector<double> of_seeds;
    for (const FlowRecord& s : seeds) of_seeds.push_back(what(s));
    c.measures.push_back(measure_of(name, unit, of_seeds, what(sph), bar));
  };
  const double lengths = sph.H0_over_L0 > tall ? bar_of_tall_columns : bar_of_lengths;
  // Histories on 200 times, to where the last of them has ended: whoever rested before stays where it is.
  double end = sph.rest_time;
  for (const FlowRecord& s : seeds) end = std::max(end, s.rest_time);
  std::vector<double> times;
  for (int k = 0; k <= 200; ++k) times.push_back(end * k / 200.0);
  const auto history = [&](const char* name, std::vector<double> FlowRecord::*what, double scale) {
    const auto on_times = [&](const FlowRecord& flow) {
      std::vector<double> values;
      for (const double t : times) values.push_back(at_time(flow.time, flow.*what, t));
      return values;
    };
    std::vector<std::vector<double>> of_seeds;
    for (const FlowRecord& s : seeds) of_seeds.push_back(on_times(s));
    c.distances.push_back(compare_lists(name, on_times(sph), of_seeds, scale, 0));
  };
  if (sph.has_front) {
    add("front_99", "L0", lengths, [](const FlowRecord& f) { return f.front.back(); });
    add("run-out", "L0", no_bar, [](const FlowRecord& f) { return f.front.back() - 1; });
    add("centre height", "L0", lengths, [](const FlowRecord& f) { return f.height.back(); });
    if (sph.at_rest && std::all_of(seeds.begin(), seeds.end(), [](const FlowRecord& f) { return f.at_rest; }))
      add("time to rest", "sqrt(H0/g)", bar_of_rest, [](const FlowRecord& f) { return f.rest_time; });
    if (!sph.profiles.empty()) {
      double reach = sph.front.back();
      for (const FlowRecord& s : seeds) reach = std::max(reach, s.front.back());
      std::vector<std::vector<double>> of_seeds;
      for (const FlowRecord& s : seeds) of_seeds.push_back(deposit_of(s, reach));
      c.distances.push_back(compare_lists("deposit, over H0", deposit_of(sph, reach), of_seeds,
                                          sph.H0_over_L0, bar_of_lengths));
    }
    history("front over time, over L0", &FlowRecord::front, 1);
    history("centre height over time, over H0", &FlowRecord::height, sph.H0_over_L0);
  }
  double most = 0;
  for (const FlowRecord& s : seeds)
    most = std::max(most, *std::max_element(s.kinetic.begin(), s.kinetic.end()));
  // Grains that stand, by the definition of rest, have no kinetic energy to be measured by: SPH has to stand
  // too.
  if (most > still) {
    history("kinetic energy over time, over its largest", &FlowRecord::kinetic, most);
  } else {
    history("kinetic energy over time, over m g H", &FlowRecord::kinetic, 1);
    c.distances.back().bar = still;
  }
  add("core-seconds", "s", no_bar, [](const FlowRecord& f) { return f.cpu_seconds; });
  return c;
}

std::vector<std::string> Comparison::misses() const {
  std::vector<std::string> list;
  for (const Measure& m : measures)
    if (!m.within())
      list.push_back(fmt::format("{} {:+.1f} % (bar {:.0f} %, seeds {:.1f} %)", m.name, 100 * m.difference(),
                                 100 * m.bar, 100 * m.spread()));
  for (const Distance& d : distances)
    if (d.bar > 0 && d.L2 > std::max(d.bar, d.seeds_L2))
      list.push_back(fmt::format("{}: L2 {:.1f} % (bar {:.0f} %, seeds {:.1f} %)", d.name, 100 * d.L2,
                                 100 * d.bar, 100 * d.seeds_L2));
  return list;
}

json to_json(const Comparison& c) {
  json measures = json::array(), distances = json::array();
  for (const Measure& m : c.measures) {
    json entry{{"name", m.name},
               {"unit", m.unit},
               {"dem", m.dem},
               {"dem_sd", m.dem_sd},
               {"seeds", m.seeds},
               {"sph", m.sph},
               {"relative_difference", m.difference()},
               {"relative_spread", m.spread()}};
    if (std::isfinite(m.bar)) entry["bar"] = m.bar, entry["within"] = m.within();
    measures.push_back(std::move(entry));
  }
  for (const Distance& d : c.distances) {
    json entry{{"name", d.name}, {"L1", d.L1}, {"L2", d.L2}, {"Linf", d.Linf}, {"seeds_L2", d.seeds_L2}};
    if (d.bar > 0) entry["bar"] = d.bar, entry["within"] = d.L2 <= std::max(d.bar, d.seeds_L2);
    distances.push_back(std::move(entry));
  }
  return {{"label", c.sph.label},
          {"measures", measures},
          {"distances", distances},
          {"misses", c.misses()},
          {"particles", c.sph.particles},
          {"steps", c.sph.steps},
          {"cpu_seconds", c.sph.cpu_seconds}};
}

}  // namespace dem2sph
