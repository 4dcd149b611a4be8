// What to run next: against what a fit makes of the runs that were suggested.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "calibration/suggest.hpp"
#include "sph/base/errors.hpp"
#include "tests/calibration/synthetic.hpp"

namespace dem2sph {
namespace {

/// Points up to I_high whose cost is `seconds` at I = 0.1 and goes as I to the power `exponent`.
Observables points(double I_high, double seconds, double exponent, int count = 10) {
  Observables o = synthetic::observables({}, 4, count, 1e-3, I_high, 0);
  for (const SteadyPoint& p : o.steady)
    o.costs.push_back({p.run, "steady", seconds * std::pow(p.I_driven / 0.1, exponent)});
  return o;
}

FitOptions quick() {
  FitOptions options;
  options.compare = options.profiles = false;
  options.solid_fraction = "linear";
  return options;
}

TEST(Suggest, GoesWhereTheUnknownIs) {
  // Up to I = 0.1, D* is known worst, and only larger I tell it: the largest that is allowed, as it costs
  // least.
  const Observables o = points(0.1, 100, -1);
  const Fit fit = fit_law({o}, quick());
  const std::vector<SuggestedRun> runs = suggest_runs({o}, fit, 3, 1.0);
  ASSERT_EQ(runs.size(), 3u);
  EXPECT_EQ(runs[0].worst, "D_star");
  EXPECT_GT(runs[0].I_driven, 0.7);
  EXPECT_LT(runs[0].error_after, runs[0].error_before);
  EXPECT_GT(runs[0].log_det, 0);
  const std::string text = describe(runs);
  EXPECT_NE(text.find("[shear_cell.steady]"), std::string::npos) << text;
}

TEST(Suggest, WhatItPromisesIsWhatTheFitFinds) {
  Observables o = points(0.5, 100, -1);
  const Fit before = fit_law({o}, quick());
  const std::vector<SuggestedRun> runs = suggest_runs({o}, before, 6, 1.0);
  ASSERT_EQ(runs.size(), 6u);
  // The points of these runs, exactly on the law so that chi2 does not scale the errors otherwise.
  const RationalFriction<double> law{before.friction["mu_l"].value, before.friction["mu_h"].value,
                                     before.friction["D_star"].value};
  synthetic::Noise noise(1);
  for (std::size_t k = 0; k < runs.size(); ++k) {
    SteadyPoint p = synthetic::steady_point({}, runs[k].I_driven, noise, fmt::format("new{}", k));
    p.I = runs[k].I_driven;
    p.mu = p.wall_mu = law(p.I);
    o.steady.push_back(p);
  }
  const Fit after = fit_law({o}, quick());
  const Estimate& D = after.friction["D_star"];
  // Linear about the first fit: D* moves little, its error by a factor of 2.
  EXPECT_NEAR(D.standard_error / D.value / after.friction.error_scale * before.friction.error_scale,
              runs.back().error_after, 0.1 * runs.back().error_after);
}

TEST(Suggest, TransientsAreAskedForWhereDilationIsKnownWorst) {
  // Four dense start-ups and four loose ones that cost ten times as much: s* is the worst known, and more of
  // the dense ones tell it as well for less.
  synthetic::Truth truth;
  truth.s_star = 0.25;
  truth.transient_offset = 0;
  Observables o = points(1.0, 100, -1, 160);
  synthetic::Noise noise(7);
  const auto add = [&](bool dense, int k) {
    o.transients.push_back(synthetic::start_up(truth, 0.03, dense ? 0.625 : 0.55, noise,
                                               fmt::format("{}{}", dense ? "dense" : "loose", k), 2, 60));
    o.transients.back().packing_friction = dense ? 0 : 5;
    o.costs.push_back({o.transients.back().run, "start_up", dense ? 20.0 : 200.0});
  };
  for (int k = 0; k < 4; ++k) add(true, k), add(false, k);
  FitOptions options = quick();
  options.dilation = "phi_relaxes";
  const Fit before = fit_law({o}, options);
  const std::vector<SuggestedRun> runs = suggest_runs({o}, before, 4, 1.0);
  ASSERT_EQ(runs.size(), 4u);
  for (const SuggestedRun& run : runs) {
    EXPECT_EQ(run.kind, "start_up");
    EXPECT_EQ(run.worst, "s_star");
    EXPECT_EQ(run.packing_friction, 0);
    EXPECT_EQ(run.core_seconds, 20);
  }
  EXPECT_EQ(runs.back().seeds_there, 7);
  const std::string text = describe(runs);
  EXPECT_NE(text.find("[shear_cell.start_up]\nI = [0.03]\npacking_friction = [0]\nseeds = [5, 6, 7, 8]\n"),
            std::string::npos)
      << text;
  // What was promised, made. The noise is estimated anew, known to some 10 %, and the jackknife of 8 runs to
  // a quarter.
  for (int k = 4; k < 8; ++k) add(true, k);
  const Fit after = fit_law({o}, options);
  const Estimate& s_star = after.dilation["s_star"];
  EXPECT_LT(runs.back().error_after, 0.95 * runs.front().error_before);
  EXPECT_NEAR(s_star.standard_error / s_star.value, runs.back().error_after, 0.3 * runs.back().error_after);
}

TEST(Suggest, CostDecides) {
  // To know mu_l, low I is best; if it costs a million times more, a higher one is.
  Observables cheap = points(1.0, 100, 0);
  FitOptions options = quick();
  options.friction = "linear";
  const Fit fit = fit_law({cheap}, options);
  const RunModel flat({cheap}, fit), steep({points(1.0, 100, -2)}, fit);
  EXPECT_NEAR(flat.core_seconds(1e-3), 100, 1e-6);
  EXPECT_NEAR(steep.core_seconds(1e-3), 100 * 1e4, 1);
  EXPECT_NEAR(steep.core_seconds(1e-4), 100 * 1e5, 10);  // below the data, as 1/I
  EXPECT_NEAR(steep.core_seconds(5), steep.core_seconds(1), 1e-9);
  double cost_flat = 0, cost_steep = 0;
  for (const SuggestedRun& run : suggest_runs({cheap}, fit, 4, 1.0)) cost_flat += std::log(run.I_driven);
  for (const SuggestedRun& run : suggest_runs({points(1.0, 100, -2)}, fit, 4, 1.0))
    cost_steep += std::log(run.I_driven);
  EXPECT_GT(cost_steep, cost_flat) << "where low I is dear, the runs go to higher I";
}

TEST(Suggest, WithoutCostsThereIsNothingToWeigh) {
  const Observables o = synthetic::observables({}, 4, 10, 1e-3, 1, 0);
  const Fit fit = fit_law({o}, quick());
  EXPECT_THROW(suggest_runs({o}, fit, 1, 1.0), InputError);
}

}  // namespace
}  // namespace dem2sph
