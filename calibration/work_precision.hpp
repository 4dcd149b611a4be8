// Error against cost: which runs are worth their time, at what order they converge, and how sure their limit
// is.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace dem2sph {

/// One run with its cost and its errors.
struct WorkPoint {
  std::string name;    ///< "robust 40"
  std::string family;  ///< runs that differ in resolution alone: "robust", "source", "grains"
  double spacing = 0;  ///< dx or d over the scene's height
  double core_seconds = 0;
  double particle_steps = 0;
  double error = 0;        ///< against the reference, relative
  std::string failure;     ///< why there is no error; all else is then empty
  nlohmann::json figures;  ///< what was measured, for the file
  bool on_front = false;   ///< no other run is both cheaper and more exact
};

/// Marks the runs that no other one beats in both.
void mark_pareto_front(std::vector<WorkPoint>& points);

/// Convergence of a figure over three spacings with a constant ratio, the finest last (Roache 1994).
struct GridConvergence {
  double order = 0;  ///< NaN if the three do not approach a limit from one side
  double limit = 0;  ///< extrapolated
  double index = 0;  ///< GCI of the finest, relative: 1.25 times the extrapolated error
};
GridConvergence grid_convergence(double coarse, double middle, double fine, double ratio);

/// Least-squares slope of ln(error) over ln(spacing); NaN with fewer than two runs.
double observed_order(const std::vector<WorkPoint>& points, const std::string& family);

/// Core-seconds of the cheapest run of `families` whose error is `error` at most, from the runs and straight
/// lines in logarithms between neighbours in cost; NaN if none reaches it.
double cost_at_error(const std::vector<WorkPoint>& points, const std::vector<std::string>& families,
                     double error);

nlohmann::json to_json(const std::vector<WorkPoint>& points);
std::string table_of_work(const std::vector<WorkPoint>& points);  ///< HTML
std::string csv_of(const std::vector<WorkPoint>& points);
/// Error over core-seconds, with a line at `floor` (0: none).
std::string figure_of_work(const std::vector<WorkPoint>& points, double floor,
                           const std::string& floor_label);

}  // namespace dem2sph
