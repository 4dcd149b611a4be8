// Plane shear in 3D, and over resolution.
#include "tests/verification/plane_shear.hpp"

namespace dem2sph {
namespace {

TEST(PlaneShearLong, Robust3D) {
  const ShearResult r = measure_shear<3>(
      case_of(plane_shear + glass_beads, {"flow.dimension=3", "flow.resolution=10"}), 0.1, 0.2);
  r.write("rational, 3D, H/dx = 10", "robust", {1e-10, 0.01, 0.02, 0.01});
  EXPECT_LT(r.largest_mu_error, 1e-10);
  EXPECT_LT(r.profile_error, 0.01);
  EXPECT_NEAR(r.power_ratio, 1, 0.02);  // slip and its power are those of half the resolution
  EXPECT_NEAR(r.power_ratio * (1 - 2 * r.slip), 1, 0.01);
}

TEST(PlaneShearLong, Source3D) {
  const ShearResult r =
      measure_shear<3>(case_of(plane_shear + glass_beads,
                               {"flow.formulation=source", "flow.dimension=3", "flow.resolution=10"}),
                       0.1, 0.2);
  r.write("rational, 3D, H/dx = 10", "source", {1e-10, 0.12, 0.25, 0.06});
  EXPECT_LT(r.largest_mu_error, 1e-10);
  // Ten rows are few for walls that act over five of them: measured 0.095 of the line, 0.10 of slip on each
  // side.
  EXPECT_LT(r.profile_error, 0.12);
  EXPECT_NEAR(r.power_ratio * (1 - 2 * r.slip), 1, 0.06);
}

TEST(PlaneShearLong, OverResolution) {
  double coarse = 1;
  for (const char* resolution : {"20", "40"}) {
    const ShearResult robust = measure_shear<2>(
        case_of(plane_shear + glass_beads, {std::string("flow.resolution=") + resolution}), 1, 4);
    robust.write(std::string("rational, 2D, long, H/dx = ") + resolution, "robust",
                 {1e-10, 0.01, 0.01, 0.005});
    EXPECT_LT(robust.profile_error, 0.01);
    EXPECT_NEAR(robust.power_ratio, 1, 0.01);
    const ShearResult source =
        measure_shear<2>(case_of(plane_shear + glass_beads,
                                 {"flow.formulation=source", std::string("flow.resolution=") + resolution}),
                         1, 4);
    source.write(std::string("rational, 2D, long, H/dx = ") + resolution, "source", {1e-10, 0.05, 0.1, 0.01});
    EXPECT_LT(source.profile_error, 0.7 * coarse);  // falls with dx
    EXPECT_NEAR(source.power_ratio * (1 - 2 * source.slip), 1, 0.01);
    coarse = source.profile_error;
  }
}

}  // namespace
}  // namespace dem2sph
