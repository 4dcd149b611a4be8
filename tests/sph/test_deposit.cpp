// Front, height and profile of shapes whose answers are known.
#include <gtest/gtest.h>

#include <cmath>
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

TEST(Deposit, QuarterOfACylinderHasOneHeight) {
  // Bodies of 0.01 fill the radius 0 to 1 under the height 0.5; each stands for its ring's quarter.
  std::vector<double> radius, volume;
  for (int i = 0; i < 100; ++i) {
    radius.push_back((i + 0.5) * 0.01);
    volume.push_back(0.5 * 0.5 * M_PI * radius.back() * 0.01);
  }
  const HeightProfile profile = deposit_profile({radius, volume, 0.01, 1}, 0.05, 1.5, true);
  ASSERT_EQ(profile.x.size(), 15u);
  for (std::size_t k = 0; k < 10; ++k) EXPECT_NEAR(profile.height[k], 0.5, 1e-12) << k;
  EXPECT_NEAR(profile.height[10], 0, 1e-12);
}

TEST(Deposit, SlopeOfAWedge) {
  // A wedge of 20 deg in squares of 0.01: layers of d = 0.02 hold two of them.
  const double slope = std::tan(20 * M_PI / 180);
  std::vector<double> x, up, volume;
  for (int i = -100; i < 100; ++i)
    for (int k = 0; k < 200; ++k) {
      const double at = (i + 0.5) * 0.01, height = (k + 0.5) * 0.01;
      if (height > 0.8 + slope * at) continue;
      x.push_back(at), up.push_back(height), volume.push_back(1e-4);
    }
  const Bodies bodies{x, volume, 0.01, 1};
  // The staircase is known to half a square in each of 40 columns over a length of 1.6: 0.1 deg.
  EXPECT_NEAR(surface_angle(bodies, up, -0.8, 0.8, 0.02) * 180 / M_PI, 20, 0.1);
  // A grain above it in flight changes nothing.
  x.push_back(0.7), up.push_back(5), volume.push_back(1e-4);
  EXPECT_NEAR(surface_angle({x, volume, 0.01, 1}, up, -0.8, 0.8, 0.02) * 180 / M_PI, 20, 0.2);
  EXPECT_TRUE(std::isnan(surface_angle({x, volume, 0.01, 1}, up, 3, 3.8, 0.02)));
}

TEST(Deposit, RestNeedsAFreeFallFirst) {
  EXPECT_FALSE(at_rest(0, 0, 1, 0.1, 9.81));
  EXPECT_FALSE(at_rest(0.14, 0, 1, 0.1, 9.81));  // sqrt(2 H/g) = 0.143
  EXPECT_TRUE(at_rest(0.15, 0.9e-4, 1, 0.1, 9.81));
  EXPECT_FALSE(at_rest(0.15, 1.1e-4, -1, 0.1, 9.81));
}

TEST(Deposit, DepthDividesVolume) {
  const Rectangle r;
  Bodies deep = r.bodies();
  deep.depth = 4;
  EXPECT_NEAR(mean_height(deep, 0, 1), 0.125, 1e-12);
}

}  // namespace
}  // namespace dem2sph
