// Front, height and profile of shapes whose answers are known.
#include <gtest/gtest.h>

#include <numeric>

#include "sph/base/deposit.hpp"

namespace dem2sph {
namespace {

// A rectangle of length 2 and height 0.5 in squares of 0.01.
struct Rectangle {
  std::vector<double> x, volume;
  Rectangle() {
    for (int i = 0; i < 200; ++i)
      for (int k = 0; k < 50; ++k) {
        x.push_back((i + 0.5) * 0.01);
        volume.push_back(1e-4);
      }
  }
  Bodies bodies() const { return {x, volume, 0.01, 1}; }
};

TEST(Deposit, RectangleIsMeasuredExactly) {
  const Rectangle r;
  EXPECT_NEAR(front_99(r.bodies()), 1.98,
              1e-9);  // the bodies fill it without gaps: no discretisation is left
  EXPECT_NEAR(mean_height(r.bodies(), 0, 0.153), 0.5, 1e-12);
  const std::vector<double> height = height_profile(r.bodies(), 0, 0.07, 40);
  for (std::size_t k = 0; k < 28; ++k) EXPECT_NEAR(height[k], 0.5, 1e-12) << k;        // 28 bins end at 1.96
  EXPECT_NEAR(std::accumulate(height.begin(), height.end(), 0.0) * 0.07, 1.0, 1e-12);  // all the area
  EXPECT_EQ(height.back(), 0);
}

TEST(Deposit, OneGrainInFlightDoesNotMoveTheFront) {
  Rectangle r;
  const double before = front_99(r.bodies());
  r.x.push_back(100);
  r.volume.push_back(1e-4);
  EXPECT_LT(std::abs(front_99(r.bodies()) - before), 0.01);
}

TEST(Deposit, DepthDividesVolume) {
  const Rectangle r;
  Bodies deep = r.bodies();
  deep.depth = 4;
  EXPECT_NEAR(mean_height(deep, 0, 1), 0.125, 1e-12);
}

}  // namespace
}  // namespace dem2sph
