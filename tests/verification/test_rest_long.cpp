// Bodies at rest, at length: beds at three speeds of sound, a slope over 15 s, a heap near its angle of
// repose.
#include <fmt/format.h>

#include "tests/verification/bodies_at_rest.hpp"
#include "tests/verification/record.hpp"

namespace dem2sph {
namespace {

// Lattice factors f of Eq. 5.21 (tests/sph/test_kernel.cpp checks them): pressures at rest come out 1/f high.
constexpr double f_wendland_c2_15 = 0.99740;
constexpr double f_cubic_12 = 0.99079;
// Source: with 0.1/s the viscous bound would make the beds below take hours; 1/s is a tenth of sqrt(g/H).
const std::string coarse_g_min = "flow.g_min=1 1/s";

TEST(RestLong, RobustBed) {
  for (const double c : {10.0, 40.0, 160.0}) {
    const std::string test = fmt::format("bed at rest, c = {:g} sqrt(gH)", c);
    const RestResult r = measure_rest<2>({fmt::format("flow.mach={:g}", 1 / c)});
    record(test, "robust", "force on the floor over weight, minus 1", r.force - 1, 0.001, "1");
    record(test, "robust", "pressure extrapolated to the floor, times f, over weight, minus 1",
           r.floor_pressure * f_wendland_c2_15 - 1, 0.01, "1");
    record(test, "robust", "mean speed over sqrt(gH)", r.mean_speed, 1e-3, "1");
    EXPECT_NEAR(r.force, 1, 0.001) << test;
    EXPECT_NEAR(r.floor_pressure * f_wendland_c2_15, 1, 0.01) << test;
    EXPECT_LT(r.mean_speed, 1e-3) << test;
    const RestResult corrected =
        measure_rest<2>({fmt::format("flow.mach={:g}", 1 / c), "flow.gradient_correction=bonet_lok_1999"});
    record(test, "robust, gradient correction", "pressure extrapolated to the floor over weight, minus 1",
           corrected.floor_pressure - 1, 0.01, "1");
    EXPECT_NEAR(corrected.floor_pressure, 1, 0.01) << test << ", gradient correction";
  }
}

TEST(RestLong, SourceBed) {
  for (const double c : {10.0, 40.0, 160.0}) {
    const std::string test = fmt::format("bed at rest, c = {:g} sqrt(gH)", c);
    const RestResult r =
        measure_rest<2>({"flow.formulation=source", coarse_g_min, fmt::format("flow.mach={:g}", 1 / c)});
    record(test, "source", "force on the floor over weight, minus 1", r.force - 1, NAN, "1");
    record(test, "source", "pressure extrapolated to the floor, times f, over weight, minus 1",
           r.floor_pressure * f_cubic_12 - 1, c == 10 ? 0.1 : NAN, "1");
    record(test, "source", "mean speed over sqrt(gH)", r.mean_speed, NAN, "1");
    if (c == 10) {
      EXPECT_NEAR(r.floor_pressure * f_cubic_12, 1, 0.1) << test;
    }
  }
}

TEST(RestLong, Bed3D) {
  const RestResult r = measure_rest<3>({"flow.dimension=3", "flow.resolution=10"});
  const double f = 1.00062;  // Wendland C2, h = 1.5 dx, 3D
  record("bed at rest, 3D, H/dx = 10", "robust", "force on the floor over weight, minus 1", r.force - 1,
         0.001, "1");
  record("bed at rest, 3D, H/dx = 10", "robust",
         "pressure extrapolated to the floor, times f, over weight, minus 1", r.floor_pressure * f - 1, 0.01,
         "1");
  record("bed at rest, 3D, H/dx = 10", "robust", "mean speed over sqrt(gH)", r.mean_speed, 1e-3, "1");
  EXPECT_NEAR(r.force, 1, 0.001);
  EXPECT_NEAR(r.floor_pressure * f, 1, 0.01);
  EXPECT_LT(r.mean_speed, 1e-3);
}

TEST(RestLong, RobustSlope) {
  const SlopeResult r = measure_slope({});
  const double d = 0.005;
  record("slope of 15 deg, mu_l = 0.38, 5 to 15 s", "robust", "drift of the mean displacement over d",
         std::abs(r.late - r.early) / d, 0.02, "1");
  record("slope of 15 deg, mu_l = 0.38, 5 to 15 s", "robust", "ringing at 13-15 s over that at 5-7 s",
         r.late_ring / r.early_ring, 1, "1");
  EXPECT_LT(std::abs(r.late - r.early), 0.02 * d);
  EXPECT_LT(r.late_ring, r.early_ring);
}

TEST(RestLong, SourceSlopeCreepsAsGMinSays) {
  // Where tau = p tan(t) everywhere and eta = mu p/g_min, the rate is g_min tan(t)/mu at every depth (the
  // cut-off of the solver is a maximum; a root of the sum of squares would give g_min tan(t)/sqrt(mu^2
  // - tan(t)^2)).
  const double g_min = 1;
  const CaseFile file = case_of(bed_at_rest, {"incline.angle=15 deg", "incline.height=0.5 m",
                                              "flow.end_time=15 s", "flow.formulation=source", coarse_g_min});
  auto flow = flow_of<2>(file);
  run_until(*flow, 2);
  double rate = 0;
  const int samples = 50;
  for (int i = 0; i < samples; ++i) {
    run_until(*flow, flow->time() + 0.02);
    const Interior q(flow->frame());
    std::vector<double> z, v;
    for (std::size_t k = 0; k < q.size();
         ++k)  // away from the slip at the floor and the rows without pressure
      if (q.up[k] > 0.1 && q.up[k] < 0.4) z.push_back(q.up[k]), v.push_back(q.vx[k]);
    rate += Line(z, v).slope / samples;
  }
  const double expected = g_min * std::tan(15 * M_PI / 180) / 0.38;
  record("slope of 15 deg, mu_l = 0.38, g_min = 1/s", "source",
         "rate of creep over what g_min predicts, minus 1", rate / expected - 1, 0.2, "1");
  EXPECT_NEAR(rate, expected, 0.2 * expected);
}

TEST(RestLong, Heap) {
  const HeapResult r = measure_heap({});
  record("heap at 0.9 of its angle of repose, H/dx = 30", "robust", "largest change of the profile over H",
         r.largest_change, 0.01, "1");
  record("heap at 0.9 of its angle of repose, H/dx = 30", "robust", "mean change of the profile over H",
         r.mean_change, NAN, "1");
  EXPECT_LT(r.largest_change, 0.01);
  const HeapResult s = measure_heap({"flow.formulation=source", "flow.resolution=20", coarse_g_min});
  record("heap at 0.9 of its angle of repose, H/dx = 20", "source", "largest change of the profile over H",
         s.largest_change, NAN, "1");
}

}  // namespace
}  // namespace dem2sph
