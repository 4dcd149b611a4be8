// The standard error of series whose true error is known: independent samples, AR(1) chains, exact ratios.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "dem_bridge/jackknife.hpp"

namespace dem2sph::bridge {
namespace {

using One = std::array<double, 1>;
using Two = std::array<double, 2>;

double mean_of_first(const One& m) { return m[0]; }

std::vector<One> chain(double correlation, std::size_t n, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<One> rows(n);
  double x = normal(random);
  for (One& row : rows) {
    row[0] = 3 + x;
    x = correlation * x + std::sqrt(1 - correlation * correlation) * normal(random);
  }
  return rows;
}

TEST(BlockJackknife, EqualsTheTextbookForBlocksOfOne) {
  // Eight samples leave one level, blocks of 1, where the jackknife of a mean is sd/sqrt(n) identically.
  const std::vector<One> rows{{1}, {2}, {4}, {8}, {16}, {32}, {64}, {128}};
  const Estimate e = block_jackknife(std::span<const One>(rows), mean_of_first);
  double mean = 0, square = 0;
  for (const One& r : rows) mean += r[0] / 8;
  for (const One& r : rows) square += (r[0] - mean) * (r[0] - mean);
  EXPECT_DOUBLE_EQ(e.value, mean);
  EXPECT_NEAR(e.standard_error, std::sqrt(square / 7 / 8), 1e-12);
  EXPECT_FALSE(e.flat);
}

TEST(BlockJackknife, FindsTheErrorOfACorrelatedChain) {
  // AR(1) with unit variance: the error of the mean is sqrt((1 + rho)/(1 - rho)/n).
  for (const double correlation : {0.0, 0.5, 0.9}) {
    const std::size_t n = 1U << 16;
    double mean = 0;
    const int series = 20;
    for (unsigned seed = 1; seed <= series; ++seed) {
      const std::vector<One> rows = chain(correlation, n, seed);
      const Estimate e = block_jackknife(std::span<const One>(rows), mean_of_first);
      EXPECT_TRUE(e.flat);
      mean += e.standard_error / series;
    }
    const double truth = std::sqrt((1 + correlation) / (1 - correlation) / static_cast<double>(n));
    // At least 64 blocks: 9 % scatter each, 2 % in the mean of twenty, three times that; the blocks chosen
    // are 1 % short of the plateau.
    EXPECT_NEAR(mean / truth, 1, 0.07) << "correlation " << correlation;
  }
}

TEST(BlockJackknife, CoversTheTruth) {
  // A 2-sigma interval must hold the true mean 95 % of the time: 380 of 400, with sqrt(400 * 0.95 * 0.05)
  // = 4.4; blocks are few in short series, so the bar is 90 %.
  int held = 0;
  for (unsigned seed = 1; seed <= 400; ++seed) {
    const std::vector<One> rows = chain(0.8, 2048, 1000 + seed);
    const Estimate e = block_jackknife(std::span<const One>(rows), mean_of_first);
    held += std::abs(e.value - 3) < 2 * e.standard_error ? 1 : 0;
  }
  EXPECT_GE(held, 360);
}

TEST(BlockJackknife, ARatioOfProportionalSumsIsExact) {
  std::vector<Two> rows;
  for (const One& p : chain(0.9, 1000, 7)) rows.push_back({p[0], 0.4 * p[0]});
  const Estimate e = block_jackknife(std::span<const Two>(rows), [](const Two& m) { return m[1] / m[0]; });
  EXPECT_NEAR(e.value, 0.4, 1e-14);
  // Rounding only, since the fluctuations of p cancel: sums of 1000 terms, and the jackknife multiplies by
  // sqrt(1000).
  EXPECT_LT(e.standard_error, 1000 * 31 * 2.3e-16);
}

TEST(BlockJackknife, SaysSoWhenASeriesIsTooShort) {
  const std::vector<One> few(7, One{1});
  EXPECT_TRUE(std::isnan(block_jackknife(std::span<const One>(few), mean_of_first).standard_error));
  // 64 samples of a chain that remembers 100 of them.
  const std::vector<One> slow = chain(0.99, 64, 3);
  EXPECT_FALSE(block_jackknife(std::span<const One>(slow), mean_of_first).flat);
}

}  // namespace
}  // namespace dem2sph::bridge
