// Validation by hand (label `long`, about half an hour): Bagnold's flow at two resolutions and three angles.
#include <fmt/format.h>

#include <cstdio>

#include "tests/sph/incline_measure.hpp"

namespace dem2sph {
namespace {

TEST(InclineLong, FinerIsCloser) {
  const double floor = std::pow(factor_wendland_c2_15, 1.5);
  const InclineResult coarse = measure_incline(case_of(incline), 1.5, 1.5);
  const InclineResult fine = measure_incline(case_of(incline, {"flow.resolution=40"}), 1.5, 1.5);
  std::printf("25 deg: H/dx = 20 %.4f (slip %.4f), H/dx = 40 %.4f (slip %.4f)\n", coarse.velocity_ratio,
              coarse.slip_ratio, fine.velocity_ratio, fine.slip_ratio);
  const double coarse_error = std::abs(coarse.velocity_ratio * floor - 1);
  const double fine_error = std::abs(fine.velocity_ratio * floor - 1);
  EXPECT_LT(coarse_error, 0.08);
  // Both may already be at what the average over 40 samples leaves open.
  EXPECT_LT(fine_error, coarse_error + 2 * std::hypot(coarse.velocity_error, fine.velocity_error));
  EXPECT_LT(std::abs(fine.slip_ratio), std::abs(coarse.slip_ratio));
}

TEST(InclineLong, AllAngles) {
  for (const char* angle : {"22 deg", "26 deg", "28 deg"}) {
    const InclineResult r =
        measure_incline(case_of(incline, {fmt::format("incline.angle={}", angle)}), 1.5, 1.5);
    std::printf("%s: %.4f (slip %.4f)\n", angle, r.velocity_ratio, r.slip_ratio);
    EXPECT_NEAR(r.velocity_ratio * std::pow(factor_wendland_c2_15, 1.5), 1, 0.08) << angle;
  }
}

}  // namespace
}  // namespace dem2sph
