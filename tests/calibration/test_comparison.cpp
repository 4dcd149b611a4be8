// Differences of flows that are known.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "calibration/comparison.hpp"
#include "sph/base/errors.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;

/// A wedge of height h at x = 0 that ends at `front`, which it reaches like 1 - exp(-t).
FlowRecord wedge(const std::string& label, double front, double height, double rest) {
  FlowRecord r;
  r.label = label, r.has_front = true, r.H0_over_L0 = 2, r.at_rest = true, r.rest_time = rest;
  for (int k = 0; k <= 100; ++k) {
    const double t = rest * k / 100;
    r.time.push_back(t);
    r.front.push_back(front - (front - 1) * std::exp(-8 * t / rest));
    r.height.push_back(height + (2 - height) * std::exp(-8 * t / rest));
    r.kinetic.push_back(0.1 * t * std::exp(-t));
  }
  FlowRecord::Profile p;
  for (int k = 0; k < 80; ++k) {
    p.x.push_back(0.05 * (k + 0.5));
    p.height.push_back(std::max(0.0, height * (1 - p.x.back() / front)));
  }
  r.profiles = {p};
  r.cpu_seconds = 10;
  return r;
}

const Measure& measure(const Comparison& c, const std::string& name) {
  for (const Measure& m : c.measures)
    if (m.name == name) return m;
  throw std::logic_error("no measure " + name);
}
const Distance& distance(const Comparison& c, const std::string& name) {
  for (const Distance& d : c.distances)
    if (d.name.starts_with(name)) return d;
  throw std::logic_error("no distance " + name);
}

TEST(Comparison, NormsOfListsWrittenDown) {
  const Distance d = distance_of("lists", {1, 2, 3, 4}, {1, 2, 5, 3}, 2);
  EXPECT_DOUBLE_EQ(d.L1, 3.0 / 4 / 2);
  EXPECT_DOUBLE_EQ(d.L2, std::sqrt(5.0 / 4) / 2);
  EXPECT_DOUBLE_EQ(d.Linf, 1);
  EXPECT_DOUBLE_EQ(at_time({0, 1, 3}, {0, 2, 4}, 2), 3);
  EXPECT_DOUBLE_EQ(at_time({0, 1, 3}, {0, 2, 4}, 9), 4);
}

TEST(Comparison, DepositsAreReadBetweenBinsAndEndWithThem) {
  FlowRecord r;
  r.profiles = {{0, {0.5, 1.5, 2.5}, {3, 2, 0}}};
  const std::vector<double> heights = deposit_of(r, 4);  // at 0.01, 0.03, ... 3.99
  ASSERT_EQ(heights.size(), 200u);
  EXPECT_DOUBLE_EQ(heights[0], 3);                    // before the first middle
  EXPECT_NEAR(heights[49], 3 - (0.99 - 0.5), 1e-12);  // at 0.99
  EXPECT_NEAR(heights[99], 2 - 2 * (1.99 - 1.5), 1e-12);
  EXPECT_EQ(heights[150], 0);
}

TEST(Comparison, TheSameFlowDiffersByNothing) {
  const FlowRecord a = wedge("a", 2.5, 0.7, 5);
  const Comparison c = compare_flows(a, {a, a});
  for (const Measure& m : c.measures) EXPECT_NEAR(m.difference(), 0, 1e-15) << m.name;
  for (const Distance& d : c.distances) EXPECT_NEAR(d.Linf, 0, 1e-15) << d.name;
  EXPECT_TRUE(c.misses().empty());
}

TEST(Comparison, BesideGrainsThatStandSphHasToStand) {
  FlowRecord grains = wedge("grains", 2.5, 0.7, 5);
  grains.has_front = false;
  std::fill(grains.kinetic.begin(), grains.kinetic.end(), 1e-9);
  FlowRecord flows = grains, creeps = grains;
  std::fill(flows.kinetic.begin(), flows.kinetic.end(), 0.3);
  std::fill(creeps.kinetic.begin(), creeps.kinetic.end(), 1e-6);
  EXPECT_NEAR(distance(compare_flows(flows, {grains}), "kinetic").L2, 0.3, 1e-6);
  EXPECT_EQ(compare_flows(flows, {grains}).misses().size(), 1u);
  EXPECT_TRUE(compare_flows(creeps, {grains}).misses().empty());
}

TEST(Comparison, DifferencesAreStatedAgainstMeanAndSpread) {
  const std::vector<FlowRecord> seeds{wedge("1", 2.4, 0.7, 5), wedge("2", 2.5, 0.7, 5),
                                      wedge("3", 2.6, 0.7, 5)};
  const Comparison c = compare_flows(wedge("sph", 2.75, 0.77, 6), seeds);
  const Measure& front = measure(c, "front_99");
  // The series ends e^-8 short of its front.
  EXPECT_NEAR(front.dem, 2.5, 1e-3);
  EXPECT_NEAR(front.dem_sd, 0.1, 1e-3);
  EXPECT_NEAR(front.difference(), 0.1, 1e-3);
  EXPECT_FALSE(front.within());
  EXPECT_NEAR(measure(c, "centre height").difference(), 0.1, 2e-3);
  EXPECT_NEAR(measure(c, "time to rest").difference(), 0.2, 1e-12);
  // A wedge against the mean of three is some per cent off all over it: over H0 = 2 L0, below the bar.
  EXPECT_NEAR(distance(c, "deposit").L2, 0.03, 0.01);
  EXPECT_GT(distance(c, "deposit").seeds_L2, 0.003);
  // Front, height, rest: the run-out, which is the front less 1, and the cost are told without a bar.
  const std::vector<std::string> misses = c.misses();
  ASSERT_EQ(misses.size(), 3u) << json(misses).dump();
  EXPECT_TRUE(misses[0].starts_with("front_99 +10.0 %") && misses[1].starts_with("centre height +10.0 %") &&
              misses[2].starts_with("time to rest +20.0 %"))
      << json(misses).dump();
  EXPECT_EQ(measure(c, "run-out").bar, no_bar);
  const json j = to_json(c);
  EXPECT_FALSE(j.at("measures").at(0).at("within").get<bool>());
  // The same difference below the spread of the seeds is no miss.
  const std::vector<FlowRecord> wide{wedge("1", 2.1, 0.7, 5), wedge("2", 2.5, 0.7, 5),
                                     wedge("3", 2.9, 0.7, 5)};
  EXPECT_TRUE(measure(compare_flows(wedge("sph", 2.75, 0.7, 5), wide), "front_99").within());
}

class Records : public test::Scratch {};

TEST_F(Records, SummariesAreReadWithoutUnits) {
  json summary{{"series",
                {{"time", {0, 0.2}},
                 {"front_99", {0.1, 0.3}},
                 {"centre_height", {0.2, 0.1}},
                 {"kinetic_energy", {0, 4}}}},
               {"initial", {{"L0", 0.1}, {"H0", 0.2}, {"mass", 5.0}}},
               {"time_scale", 0.1},
               {"profiles", {{{"time", 0.2}, {"x", {0.05, 0.15}}, {"height", {0.1, 0.05}}}}},
               {"ended", "at rest"},
               {"cpu_seconds", 3},
               {"particles", 7},
               {"steps", 9}};
  test::put(in("summary.json"), summary.dump());
  const FlowRecord r = read_flow_record("a", in("summary.json"));
  EXPECT_DOUBLE_EQ(r.time.back(), 2);
  EXPECT_DOUBLE_EQ(r.front.back(), 3);
  EXPECT_DOUBLE_EQ(r.height.back(), 1);
  EXPECT_DOUBLE_EQ(r.H0_over_L0, 2);
  EXPECT_DOUBLE_EQ(r.kinetic.back(), 4 / (5 * 0.2 * 0.2 / 0.01));  // m g H0, g = H0/tau^2
  EXPECT_DOUBLE_EQ(r.profiles[0].x[1], 1.5);
  EXPECT_TRUE(r.at_rest);
  summary["series"]["front_99"] = {0.1};
  test::put(in("summary.json"), summary.dump());
  EXPECT_THROW(read_flow_record("a", in("summary.json")), InputError);
  summary.erase("time_scale");
  test::put(in("summary.json"), summary.dump());
  EXPECT_THROW(read_flow_record("a", in("summary.json")), InputError);
}

}  // namespace
}  // namespace dem2sph
