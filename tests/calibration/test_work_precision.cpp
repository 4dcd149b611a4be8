// Errors and costs that are made up, so that orders, fronts and crossings are known.
#include <gtest/gtest.h>

#include <cmath>

#include "calibration/work_precision.hpp"

namespace dem2sph {
namespace {

WorkPoint point(const std::string& family, double spacing, double cost, double error) {
  WorkPoint p;
  p.name = family, p.family = family, p.spacing = spacing, p.core_seconds = cost, p.error = error;
  return p;
}

TEST(WorkPrecision, ParetoFrontHoldsWhatNobodyBeats) {
  std::vector<WorkPoint> points{point("a", 0.1, 1, 0.10), point("a", 0.05, 10, 0.02),
                                point("b", 0.1, 5, 0.12), point("b", 0.05, 20, 0.01),
                                point("b", 0.02, 30, 0.01)};
  points.push_back(point("c", 0.1, 0.1, 0.001));
  points.back().failure = "broke down";
  mark_pareto_front(points);
  const std::vector<bool> expected{true, true, false, true, false, false};
  for (std::size_t k = 0; k < points.size(); ++k) EXPECT_EQ(points[k].on_front, expected[k]) << k;
}

TEST(WorkPrecision, OrderIsThatOfThePower) {
  std::vector<WorkPoint> points;
  for (const double h : {0.1, 0.05, 0.025}) points.push_back(point("a", h, 1 / h, 0.7 * std::pow(h, 1.5)));
  EXPECT_NEAR(observed_order(points, "a"), 1.5, 1e-12);
  EXPECT_TRUE(std::isnan(observed_order(points, "b")));
}

TEST(WorkPrecision, GridConvergenceFindsTheLimit) {
  // 3 + 0.2 h^2 at h = 1, 1/2, 1/4.
  const auto f = [](double h) { return 3 + 0.2 * h * h; };
  const GridConvergence g = grid_convergence(f(1), f(0.5), f(0.25), 2);
  EXPECT_NEAR(g.order, 2, 1e-12);
  EXPECT_NEAR(g.limit, 3, 1e-12);
  EXPECT_NEAR(g.index, 1.25 * 0.2 / 16 / f(0.25), 1e-12);
  EXPECT_TRUE(std::isnan(grid_convergence(1, 2, 1.5, 2).order)) << "it swings";
  EXPECT_TRUE(std::isnan(grid_convergence(1, 2, 4, 2).order)) << "it runs away";
}

TEST(WorkPrecision, CostAtAnErrorLiesBetweenTheRuns) {
  // error = 1/cost: a straight line in logarithms, so exact between the runs.
  const std::vector<WorkPoint> points{point("a", 0.1, 10, 0.1), point("a", 0.05, 100, 0.01),
                                      point("b", 0.1, 40, 0.02)};
  EXPECT_NEAR(cost_at_error(points, {"a"}, 0.05), 20, 1e-9);
  EXPECT_NEAR(cost_at_error(points, {"a", "b"}, 0.02), 40, 1e-9);
  EXPECT_NEAR(cost_at_error(points, {"a"}, 0.5), 10, 1e-9) << "the cheapest is exact enough";
  EXPECT_TRUE(std::isnan(cost_at_error(points, {"a", "b"}, 0.001)));
  EXPECT_TRUE(std::isnan(cost_at_error(points, {"c"}, 1)));
}

TEST(WorkPrecision, TablesNameWhatFailed) {
  std::vector<WorkPoint> points{point("a", 0.1, 10, 0.1), point("b", 0.1, 0, 0)};
  points[1].failure = "particle <3> left";
  EXPECT_EQ(csv_of(points).find("b,"), std::string::npos);
  EXPECT_NE(csv_of(points).find("a,a,0.1,10,0,0.1,0\n"), std::string::npos) << csv_of(points);
  EXPECT_NE(table_of_work(points).find("particle &lt;3&gt; left"), std::string::npos);
  EXPECT_EQ(to_json(points).at(1).at("failure"), "particle <3> left");
}

}  // namespace
}  // namespace dem2sph
