// Grains and SPH on one geometry: by how much do they differ, measured by the spread of the grains' seeds and
// by what was asked for. Everything is read off summaries (and fields, which the caller coarse-grains); the
// figures mean what the table in README.md says.
#pragma once

#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace dem2sph {

/// A flow as its summary.json tells it, without units: lengths over L0 (H0 without a front), times over
/// sqrt(H0/g), energies over the mass times g H0.
struct FlowRecord {
  std::string label;
  std::vector<double> time, front, height, kinetic;
  struct Profile {
    double time = 0;
    std::vector<double> x, height;
  };
  std::vector<Profile> profiles;  ///< none without a front
  bool has_front = false;
  double H0_over_L0 = 0;
  double rest_time = 0;  ///< of the last sample
  bool at_rest = false;
  double cpu_seconds = 0, particles = 0, steps = 0;
};

/// Throws InputError naming what is missing.
FlowRecord read_flow_record(const std::string& label, const std::filesystem::path& summary);

/// Value of a series at a time, linear between samples; the last one beyond them.
double at_time(const std::vector<double>& time, const std::vector<double>& values, double t);

/// Heights of what is left at 200 places between 0 and `reach`, linear between the middles of bins [L0].
std::vector<double> deposit_of(const FlowRecord& flow, double reach);

/// One figure, of the grains (mean and standard deviation over seeds) and of SPH.
struct Measure {
  std::string name, unit;
  double dem = 0, dem_sd = 0;
  long seeds = 0;
  double sph = 0;
  double bar = 0;  ///< largest relative difference wanted; no_bar: it is told only
  double difference() const { return (sph - dem) / dem; }
  /// Of the relative difference, that the seeds leave: their standard deviation.
  double spread() const { return dem_sd / std::abs(dem); }
  bool within() const;
};
inline constexpr double no_bar = std::numeric_limits<double>::infinity();
Measure measure_of(std::string name, std::string unit, const std::vector<double>& seeds, double sph,
                   double bar);

/// A distance between two histories or profiles, relative, beside that of a seed from the mean of the others.
struct Distance {
  std::string name;
  double L1 = 0, L2 = 0, Linf = 0;
  double seeds_L2 = 0;  ///< the same of the seeds; 0: only one
  double bar = 0;       ///< of L2; 0: none
};

/// Norms of a - b over the common grid, relative to `scale`: mean of |.|, root of the mean square, largest.
Distance distance_of(const std::string& name, const std::vector<double>& a, const std::vector<double>& b,
                     double scale);

/// SPH against the mean of the seeds, and each seed against the mean of the others (mean of their L2). Lists
/// of one length: a profile, a history, a field at all points and times.
Distance compare_lists(const std::string& name, const std::vector<double>& sph,
                       const std::vector<std::vector<double>>& seeds, double scale, double bar);

/// A variant of the SPH flow against all seeds.
struct Comparison {
  FlowRecord sph;
  std::vector<Measure> measures;
  std::vector<Distance> distances;
  /// A figure that misses its bar, in words.
  std::vector<std::string> misses() const;
};

/// Front, height, time to rest, deposit, and their histories, of collapses; height and energy of others.
/// Bars are those of the project: 5 % (10 % for columns of H0/L0 above 3), 15 % for the time to rest.
Comparison compare_flows(const FlowRecord& sph, const std::vector<FlowRecord>& seeds);

nlohmann::json to_json(const Comparison& comparison);

/// One flow in a figure of grains and SPH.
struct FlowCurve {
  std::string label;
  std::vector<double> x, y;
};
/// Seeds as thin grey lines under one label, variants of SPH in colour; `axes` are gnuplot's settings.
std::string figure_of_flows(const std::string& name, const std::vector<FlowCurve>& seeds,
                            const std::vector<FlowCurve>& variants, const std::string& axes, int width,
                            int height);

/// Figures and distances of a variant as HTML tables.
std::string measures_table(const Comparison& comparison, std::size_t seeds);

/// Pictures and text beside the figures.
struct ComparisonPage {
  std::string title;
  std::vector<FlowRecord> seeds;
  std::vector<Comparison> variants;
  std::string figures;  ///< further HTML, of what only the caller knows
  nlohmann::json provenance;
};
void write_comparison_page(const ComparisonPage& content, const std::filesystem::path& page);

}  // namespace dem2sph
