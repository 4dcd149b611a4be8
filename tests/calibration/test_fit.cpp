// The fit against data with a known truth: values, coverage of the intervals, and what it says when data do
// not suffice.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <limits>

#include "calibration/fit.hpp"
#include "sph/base/errors.hpp"
#include "tests/calibration/synthetic.hpp"

namespace dem2sph {
namespace {

using synthetic::Truth;

bool contains(const Estimate& e, double truth) { return e.low <= truth && truth <= e.high; }

// How often the interval of a *linear* fit covers: with z normal and q = chi2/dof independent of it, the half
// width is max(1.96, t sqrt(q)) standard errors, so the coverage is the mean over q of P(|z| < half width).
double expected_coverage(double dof) {
  const double normal = normal_quantile(0.975);
  const double t = student_t_quantile(0.975, dof);
  double sum = 0;
  double weight = 0;
  const double step = 0.0005;
  for (double q = 0.5 * step; q < 12;
       q += step) {  // beyond, the density of q is below 1e-6 for every dof used here
    const double density = std::exp((0.5 * dof - 1) * std::log(q) - 0.5 * dof * q);
    sum += density * std::erf(std::max(normal, t * std::sqrt(q)) / std::sqrt(2.0));
    weight += density;
  }
  return sum / weight;
}

// Four binomial standard deviations: with ten such checks one in about 1600 runs of new random numbers would
// fail.
void expect_coverage(int covered, int draws, double lowest, double highest, const char* name) {
  const double share = static_cast<double>(covered) / draws;
  std::printf("  %-8s covered %.1f %% (expected %.1f to %.1f %%)\n", name, 100 * share, 100 * lowest,
              100 * highest);
  EXPECT_GE(share, lowest - 4 * std::sqrt(lowest * (1 - lowest) / draws)) << name;
  EXPECT_LE(share, highest + 4 * std::sqrt(highest * (1 - highest) / draws)) << name;
}

TEST(Fit, RecoversTheTruthWithinItsErrors) {
  const Truth truth;
  FitOptions options;
  options.solid_fraction = "linear";
  const Fit fit = fit_law({synthetic::observables(truth, 1)}, options);
  const auto pull = [](const Estimate& e, double t) { return (e.value - t) / e.standard_error; };
  EXPECT_LT(std::abs(pull(fit.friction["mu_l"], 0.38)), 3.5);
  EXPECT_LT(std::abs(pull(fit.friction["mu_h"], 0.64)), 3.5);
  EXPECT_LT(std::abs(pull(fit.friction["D_star"], 0.279)), 3.5);
  EXPECT_LT(std::abs(pull(fit.solid_fraction["phi_c"], 0.59)), 3.5);
  EXPECT_LT(std::abs(pull(fit.solid_fraction["b"], 0.2)), 3.5);
  EXPECT_LT(std::abs(pull(fit.dilation["s_star"], 0.4)), 3.5);
  EXPECT_LT(std::abs(pull(fit.beta_in_mu, 0.8)), 3.5);
  EXPECT_EQ(fit.friction.search.starts, 16);
  EXPECT_GE(fit.friction.search.agreed, 8);
  EXPECT_TRUE(fit.mu_h_and_D_star_known);
  EXPECT_EQ(fit.covariance_names,
            (std::vector<std::string>{"mu_l", "mu_h", "D_star", "phi_c", "b", "s_star"}));
  // Steady friction and solid fraction are fitted apart; s* shares b with the solid fraction.
  EXPECT_EQ(fit.covariance[0][3], 0);
  EXPECT_EQ(fit.covariance[5][0], 0);
  EXPECT_EQ(fit.covariance[5][3], fit.covariance[3][5]);
  // facts: corr(mu_h, D*) = 0.904 for these points.
  const double correlation = fit.covariance[1][2] / std::sqrt(fit.covariance[1][1] * fit.covariance[2][2]);
  EXPECT_NEAR(correlation, 0.904, 0.05);
}

std::size_t warnings_with(const Fit& fit, const std::string& text) {
  return static_cast<std::size_t>(
      std::count_if(fit.warnings.begin(), fit.warnings.end(),
                    [&](const std::string& w) { return w.find(text) != std::string::npos; }));
}

TEST(Fit, TheLawCarriesTheShareOfBetaThatShowsInFriction) {
  Truth truth;
  truth.beta_in_mu = 0.3;
  const Fit less = fit_law({synthetic::observables(truth, 1, 12, 1e-3, 1, 6)});
  ASSERT_LT(less.beta_in_mu.high, 1);
  EXPECT_TRUE(contains(less.beta_in_mu, 0.3));
  EXPECT_EQ(make_law_file(less, {}).dilation["beta_share"], less.beta_in_mu.value);
  truth.beta_in_mu = 1;
  const Fit all = fit_law({synthetic::observables(truth, 1, 12, 1e-3, 1, 6)});
  ASSERT_TRUE(contains(all.beta_in_mu, 1));
  // One kind of transient: the share of that kind is the share of all.
  ASSERT_EQ(all.beta_in_mu_by_kind.size(), 1u);
  EXPECT_EQ(all.beta_in_mu_by_kind[0].name, "start_up");
  EXPECT_EQ(all.beta_in_mu_by_kind[0].value, all.beta_in_mu.value);
}

TEST(Fit, WarnsWhenKindsOfTransientsShowAnotherShareOfBeta) {
  Truth truth;
  truth.beta_in_mu = 0.9;
  Observables o = synthetic::observables(truth, 1, 12, 1e-3, 1, 6);
  EXPECT_EQ(warnings_with(fit_law({o}), "not the same in all kinds"), 0u);
  truth.beta_in_mu = 0.1;
  synthetic::Noise noise(17);
  for (int seed = 0; seed < 6; ++seed) {
    o.transients.push_back(synthetic::start_up(truth, 0.03, 0.62, noise, fmt::format("jump{}", seed)));
    o.transients.back().kind = "jump";
  }
  const Fit fit = fit_law({o});
  EXPECT_EQ(warnings_with(fit, "not the same in all kinds"), 1u);
  ASSERT_EQ(fit.beta_in_mu_by_kind.size(), 2u);
  EXPECT_TRUE(contains(fit.beta_in_mu_by_kind[0], 0.1)) << fit.beta_in_mu_by_kind[0].name;
  EXPECT_TRUE(contains(fit.beta_in_mu_by_kind[1], 0.9)) << fit.beta_in_mu_by_kind[1].name;
}

TEST(Fit, WarnsOfRunsWhoseErrorsOrSteadinessAreInDoubt) {
  Observables o = synthetic::observables({}, 1, 12, 1e-3, 1, 0);
  const Fit quiet = fit_law({o});
  EXPECT_EQ(warnings_with(quiet, "blocks"), 0u);
  EXPECT_EQ(warnings_with(quiet, "drifted"), 0u);
  o.steady[2].phi_flat = false;
  o.steady[3].phi_drift = -3.5;
  o.steady[4].mu_flat = false;
  o.steady[11].phi_drift = 9;  // at I = 1: above phi_I_max, so only friction uses it
  FitOptions options;
  options.phi_I_max = 0.5;
  const Fit fit = fit_law({o}, options);
  EXPECT_EQ(warnings_with(fit, "friction: the standard errors of 1 of 12 points"), 1u);
  EXPECT_EQ(warnings_with(fit, "solid fraction: the standard errors of 1 of 10 points"), 1u);
  EXPECT_EQ(warnings_with(fit, "steady04"), 1u);
  EXPECT_EQ(warnings_with(fit, "steady02"), 1u);
  EXPECT_EQ(warnings_with(fit, "friction: in 2 of 12 points phi still drifted"), 1u);
  EXPECT_EQ(warnings_with(fit, "solid fraction: in 1 of 10 points phi still drifted"), 1u);
  EXPECT_EQ(fit.friction["mu_l"].value, quiet.friction["mu_l"].value);
}

TEST(Fit, DataWithoutNoiseGiveTheTruthBack) {
  Truth truth;
  Observables o = synthetic::observables(truth, 1);
  for (SteadyPoint& p : o.steady) {
    p.I = p.I_driven;
    p.mu = p.wall_mu = truth.friction(p.I);
    p.phi = truth.solid_fraction(p.I);
  }
  FitOptions options;
  options.solid_fraction = "linear";
  const Fit fit = fit_law({o}, options);
  // chi2 is flat to eps about its minimum, so a parameter is found to sqrt(eps) = 1.5e-8 of its error or
  // better.
  EXPECT_NEAR(fit.friction["mu_l"].value, 0.38, 1e-6 * fit.friction["mu_l"].standard_error);
  EXPECT_NEAR(fit.friction["mu_h"].value, 0.64, 1e-6 * fit.friction["mu_h"].standard_error);
  EXPECT_NEAR(fit.friction["D_star"].value, 0.279, 1e-6 * fit.friction["D_star"].standard_error);
  EXPECT_NEAR(fit.solid_fraction["phi_c"].value, 0.59, 1e-6 * fit.solid_fraction["phi_c"].standard_error);
}

TEST(Fit, SteadyIntervalsCoverAndPullsAreNormal) {
  const Truth truth;
  const int draws = 300;
  FitOptions options;
  options.starts = 2;
  options.compare = options.profiles = false;
  options.solid_fraction = "linear";
  int mu_l = 0, mu_h = 0, D_star = 0, phi_c = 0, b = 0, slope = 0, band = 0;
  std::vector<double> pulls;
  for (int draw = 0; draw < draws; ++draw) {
    const Fit fit = fit_law(
        {synthetic::observables(truth, 1000u + static_cast<unsigned>(draw), 12, 1e-3, 1, 0)}, options);
    mu_l += contains(fit.friction["mu_l"], 0.38);
    mu_h += contains(fit.friction["mu_h"], 0.64);
    D_star += contains(fit.friction["D_star"], 0.279);
    phi_c += contains(fit.solid_fraction["phi_c"], 0.59);
    b += contains(fit.solid_fraction["b"], 0.2);
    slope += contains(fit.slope, (0.64 - 0.38) / 0.279);
    const Prediction mu = predict_friction(fit, 0.1);
    band += mu.low <= truth.friction(0.1) && truth.friction(0.1) <= mu.high;
    pulls.push_back((fit.friction["mu_l"].value - 0.38) / fit.friction["mu_l"].standard_error *
                    fit.friction.error_scale);
  }
  const double friction = expected_coverage(9);
  const double solid = expected_coverage(10);
  expect_coverage(mu_l, draws, friction, friction, "mu_l");
  expect_coverage(mu_h, draws, friction, friction, "mu_h");
  expect_coverage(D_star, draws, friction, friction, "D_star");
  expect_coverage(slope, draws, friction, friction, "slope");
  expect_coverage(band, draws, friction, friction, "mu(0.1)");
  expect_coverage(phi_c, draws, solid, solid, "phi_c");
  expect_coverage(b, draws, solid, solid, "b");
  // Pulls with the errors that were put in: mean 0 +- 1/sqrt(n), standard deviation 1 +- 1/sqrt(2n), four of
  // each.
  double mean = 0, squares = 0;
  for (double p : pulls) mean += p / draws;
  for (double p : pulls) squares += (p - mean) * (p - mean) / (draws - 1);
  std::printf("  pull of mu_l: mean %.3f, standard deviation %.3f\n", mean, std::sqrt(squares));
  EXPECT_NEAR(mean, 0, 4 / std::sqrt(draws));
  EXPECT_NEAR(std::sqrt(squares), 1, 4 / std::sqrt(2.0 * draws));
}

void strain_scale_coverage(double s_star, double beta_in_mu, int draws) {
  Truth truth;
  truth.s_star = s_star;
  truth.beta_in_mu = beta_in_mu;
  FitOptions options;
  options.starts = 2;
  options.compare = options.profiles = false;
  options.bootstrap = 0;
  options.solid_fraction = "linear";
  options.bins = 40;
  int two = 0, share = 0;
  std::vector<double> pulls;
  double autocorrelation = 0;
  for (int draw = 0; draw < draws; ++draw) {
    Observables o = synthetic::observables(truth, 5000u + static_cast<unsigned>(draw), 4, 1e-3, 0.5, 2);
    const Fit fit = fit_law({o}, options);
    two += contains(fit.dilation["s_star"], truth.s_star);
    share += contains(fit.beta_in_mu, truth.beta_in_mu);
    pulls.push_back(std::log(fit.dilation["s_star"].value / truth.s_star) /
                    (fit.dilation["s_star"].standard_error / fit.dilation["s_star"].value));
    autocorrelation += fit.whitened_autocorrelation / draws;
  }
  std::printf("  s* = %g, share = %g, %d draws\n", s_star, beta_in_mu, draws);
  // Student's t with the number of independent samples makes the interval wider than the normal one, by up to
  // the 2.1/1.96 of 17 degrees of freedom: at most 96.5 %.
  expect_coverage(two, draws, 0.95, 0.965, "s_star");
  expect_coverage(share, draws, 0.95, 0.975, "share");
  double squares = 0;
  for (double p : pulls) squares += p * p / draws;
  std::printf("  pull of ln s*: rms %.3f; lag-one autocorrelation of whitened residuals %.3f\n",
              std::sqrt(squares), autocorrelation);
  EXPECT_NEAR(std::sqrt(squares), 1, 4 / std::sqrt(2.0 * draws) + 0.05);
  // Means over three samples are not quite an Ornstein-Uhlenbeck process plus white noise: 0.038 to 0.053
  // over 1000 draws of the three truths. A law that does not describe the data leaves 0.2 and more.
  EXPECT_LT(std::abs(autocorrelation), 0.08);
}

TEST(Fit, StrainScaleIntervalsCoverUnderCorrelatedNoise) {
  const char* given = std::getenv("DEM2SPH_DRAWS");
  const int draws = given != nullptr ? std::atoi(given) : 300;
  strain_scale_coverage(0.4, 0.8, draws);
  // Two more truths: in full by hand, a few draws always.
  const int few = given != nullptr ? draws : 60;
  strain_scale_coverage(0.15, 0.5, few);
  strain_scale_coverage(0.7, 1.0, few);
}

TEST(Fit, OffsetOfTransientsDoesNotBiasTheStrainScale) {
  // A phi of the transients that lies 0.01 off the steady law (half of what they dilate by) must be absorbed.
  Truth truth;
  truth.transient_offset = 0;
  const Fit level = fit_law({synthetic::observables(truth, 9)});
  truth.transient_offset = 0.01;
  Observables moved = synthetic::observables(truth, 9);
  const Fit off = fit_law({moved});
  EXPECT_LT(std::abs(off.dilation["s_star"].value - 0.4), 3 * off.dilation["s_star"].standard_error);
  EXPECT_NEAR(off.transients[0].phi_offset - level.transients[0].phi_offset, 0.01, 0.002);
  EXPECT_TRUE(std::any_of(off.warnings.begin(), off.warnings.end(),
                          [](const std::string& w) { return w.find("differs by") != std::string::npos; }));
}

TEST(Fit, SpreadOverRunsIsNotIgnored) {
  // Three runs whose strain scales truly differ: least squares alone would not see it, the jackknife does.
  Truth truth;
  Observables o = synthetic::observables(truth, 3, 8, 1e-3, 1, 0);
  synthetic::Noise noise(3);
  for (const double s_star : {0.2, 0.4, 0.8}) {
    truth.s_star = s_star;
    o.transients.push_back(synthetic::start_up(truth, 0.03, 0.62, noise, fmt::format("s{}", s_star)));
  }
  const Fit fit = fit_law({o});
  EXPECT_GT(fit.s_star_error_jackknife, 1.5 * fit.s_star_error_least_squares);
  EXPECT_GE(fit.dilation["s_star"].standard_error, fit.s_star_error_jackknife);
}

TEST(Fit, SeedsOfOneConditionWidenTheErrors) {
  const Truth truth;
  Observables o = synthetic::observables(truth, 2, 6, 1e-3, 1, 0);
  synthetic::Noise noise(2);
  for (const double shift : {-0.02, 0.02}) {
    o.steady.push_back(
        synthetic::steady_point(truth, o.steady[2].I_driven, noise, fmt::format("seed{}", shift)));
    o.steady.back().mu = o.steady.back().wall_mu = truth.friction(o.steady[2].I_driven) + shift;
  }
  const Fit fit = fit_law({o});
  for (const SteadyDatum& d : fit.friction_data) {
    if (d.I_driven == o.steady[2].I_driven)
      EXPECT_GT(d.value_se, 0.015) << d.run;  // the three lie about 0.02 apart
    else
      EXPECT_EQ(d.value_se, truth.mu_sd) << d.run;
  }
}

TEST(Fit, ShortRangeOfInertialNumberLeavesOnlyTheSlopeKnown) {
  const Truth truth;
  const Observables o = synthetic::observables(truth, 6, 12, 1e-3, 0.1);
  const Fit fit = fit_law({o});
  EXPECT_FALSE(fit.mu_h_and_D_star_known);
  EXPECT_NE(fit.verdict.find("not known apart"), std::string::npos) << fit.verdict;
  EXPECT_NE(fit.verdict.find("slope"), std::string::npos);
  EXPECT_TRUE(std::any_of(fit.warnings.begin(), fit.warnings.end(), [](const std::string& w) {
    return w.find("only be used together") != std::string::npos;
  }));
  EXPECT_TRUE(contains(fit.slope, (0.64 - 0.38) / 0.279)) << fit.slope.low << " " << fit.slope.high;
  FitOptions strict;
  strict.strict = true;
  try {
    fit_law({o}, strict);
    FAIL() << "strict must refuse";
  } catch (const IdentifiabilityError& error) {
    EXPECT_EQ(error.code(), ExitCode::not_identifiable);
    EXPECT_NE(std::string(error.what()).find("mu_h and D_star"), std::string::npos) << error.what();
  }
  EXPECT_NO_THROW(fit_law({synthetic::observables(truth, 6)}, strict));
}

TEST(Fit, ParameterAtItsBoundIsSaid) {
  // A straight line mu = 0.38 + 0.9 I: D* runs to its upper bound.
  const Truth truth;
  Observables o = synthetic::observables(truth, 8, 12, 1e-3, 0.3, 0);
  for (SteadyPoint& p : o.steady) p.mu = p.wall_mu = 0.38 + 0.9 * p.I_driven + 1.5 * p.I_driven * p.I_driven;
  FitOptions options;
  options.mu_max = 50;
  const Fit fit = fit_law({o}, options);
  EXPECT_TRUE(fit.friction["D_star"].at_bound);
  EXPECT_EQ(fit.friction.covariance[2][2], 0);
  EXPECT_DOUBLE_EQ(fit.friction["D_star"].value, options.D_star_max);
  EXPECT_FALSE(fit.mu_h_and_D_star_known);
  EXPECT_TRUE(std::any_of(fit.warnings.begin(), fit.warnings.end(), [](const std::string& w) {
    return w.find("D_star went to a bound") != std::string::npos;
  }));
}

TEST(Fit, TooFewDataAreAClearError) {
  const Truth truth;
  Observables o = synthetic::observables(truth, 1);
  const auto message = [&](const Observables& data) {
    try {
      fit_law({data});
    } catch (const IdentifiabilityError& error) {
      return std::string(error.what());
    }
    return std::string("no error");
  };
  Observables one = o;
  one.steady.resize(1);
  EXPECT_NE(message(one).find("friction: 1 datum at 1 inertial number cannot tell 3 parameters"),
            std::string::npos)
      << message(one);
  Observables same = o;
  for (SteadyPoint& p : same.steady) p.I = p.I_driven = 0.1;
  EXPECT_NE(message(same).find("at 1 inertial number cannot"), std::string::npos) << message(same);
  // Three driven I that came out as one: the Jacobian tells.
  Observables collapsed = o;
  for (SteadyPoint& p : collapsed.steady) p.I = 0.1;
  EXPECT_NE(message(collapsed).find("leave a combination"), std::string::npos) << message(collapsed);
  Observables none = o;
  none.steady.clear();
  EXPECT_NE(message(none).find("0 data"), std::string::npos) << message(none);
  EXPECT_THROW(fit_law({}), InputError);
}

TEST(Fit, WhatIsNoDatumIsRefusedByName) {
  const Truth truth;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto refused = [&](const std::function<void(Observables&)>& spoil, const char* words) {
    Observables o = synthetic::observables(truth, 1);
    spoil(o);
    try {
      fit_law({o});
      ADD_FAILURE() << "accepted: " << words;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    }
  };
  refused([&](Observables& o) { o.steady[3].mu_se = 0; }, "run steady03: the standard error of mu is 0");
  refused([&](Observables& o) { o.steady[3].mu_se = nan; }, "run steady03: the standard error of mu is nan");
  refused([&](Observables& o) { o.steady[4].I_se = -1; }, "run steady04: the standard error of I is -1");
  refused([&](Observables& o) { o.steady[4].phi = nan; }, "run steady04: phi is nan");
  refused([&](Observables& o) { o.steady[4].I = -0.1; }, "negative");
  refused([&](Observables& o) { o.transients[1].phi[7] = nan; },
          "transient start01: phi is not a number at sample 7");
  refused([&](Observables& o) { o.transients[1].I.pop_back(); },
          "transient start01: I has 119 samples and s has 120");
  refused([&](Observables& o) { o.transients[0].s[5] = o.transients[0].s[4]; },
          "strain does not grow at sample 5");
  refused([&](Observables& o) { o.d = 0; }, "must be positive");

  Observables other = synthetic::observables(truth, 1);
  other.grain_friction = 0.3;
  EXPECT_THROW(fit_law({synthetic::observables(truth, 1), other}), InputError);
}

TEST(Fit, PointsThatDoNotBelongAreLeftOutWithAReason) {
  const Truth truth;
  Observables o = synthetic::observables(truth, 1);
  o.steady[5].wall_mu = 1.3 * o.steady[5].mu;
  o.excluded.push_back({"lost", "two grains left the cell"});
  o.transients[1].kind = "reversal";
  FitOptions options;
  options.friction_I_max = 0.9;
  options.phi_I_max = 0.5;
  const Fit fit = fit_law({o}, options);
  const auto reason = [&](const std::string& run) {
    std::string all;
    for (const ExcludedRun& e : fit.excluded)
      if (e.run == run) all += e.reason + "|";
    return all;
  };
  EXPECT_NE(reason("steady05").find("at the wall"), std::string::npos);
  EXPECT_NE(reason("lost").find("two grains"), std::string::npos);
  EXPECT_NE(reason("steady11").find("above friction_I_max"), std::string::npos);
  EXPECT_NE(reason("steady11").find("above phi_I_max"), std::string::npos);
  EXPECT_NE(reason("start01").find("reversal"), std::string::npos);
  EXPECT_EQ(fit.friction_data.size(), 10u);
  EXPECT_EQ(fit.transients.size(), 1u);
}

TEST(Fit, CurvedSolidFractionIsSaid) {
  const Truth truth;
  Observables o = synthetic::observables(truth, 1, 12, 1e-3, 1, 0);
  for (SteadyPoint& p : o.steady) p.phi -= 0.2 * p.I * p.I;
  FitOptions line;
  line.solid_fraction = "linear";
  const Fit fit = fit_law({o}, line);
  EXPECT_GT(fit.solid_fraction.chi2_per_dof, 5);
  EXPECT_GT(fit.solid_fraction.error_scale, 2);
  EXPECT_TRUE(std::any_of(fit.warnings.begin(), fit.warnings.end(), [](const std::string& w) {
    return w.find("describes these data much better than the linear one") != std::string::npos;
  }));
  EXPECT_NE(fit_law({o}).solid_fraction.member, "linear") << "the data choose";
}

TEST(Fit, ErrorsOfInertialNumberEnterTheWeights) {
  const Truth truth;
  Observables o = synthetic::observables(truth, 1);
  for (SteadyPoint& p : o.steady) p.I_se = 0.1 * p.I;
  const Fit fit = fit_law({o});
  for (const SteadyDatum& d : fit.friction_data) {
    const double slope = std::get<RationalFriction<double>>(fit.friction_law()).slope(d.I);
    // The weights are those of the last but one solution: a thousandth of an error away, and the slope moves
    // by less than 1 %.
    EXPECT_NEAR(d.plain_se, std::hypot(d.value_se, slope * d.I_se), 0.01 * d.plain_se);
  }
  EXPECT_GT(fit.friction_data.back().effective_se, 1.5 * truth.mu_sd);
}

TEST(Fit, SameDataGiveTheSameBits) {
  const Truth truth;
  const Fit a = fit_law({synthetic::observables(truth, 1)});
  const Fit b = fit_law({synthetic::observables(truth, 1)});
  EXPECT_EQ(a.covariance, b.covariance);
  EXPECT_EQ(a.verdict, b.verdict);
}

TEST(Fit, OptionsComeFromTheCaseFile) {
  const CaseFile defaults = CaseFile::parse("[fit]\n", "case.toml");
  const FitOptions from_table = FitOptions::from(defaults.section(fit_table));
  const FitOptions built_in;
  EXPECT_EQ(from_table.friction, built_in.friction);
  EXPECT_EQ(from_table.solid_fraction, built_in.solid_fraction);
  EXPECT_EQ(from_table.robust, built_in.robust);
  EXPECT_EQ(from_table.compare, built_in.compare);
  EXPECT_EQ(from_table.profiles, built_in.profiles);
  EXPECT_EQ(from_table.friction_I_max, built_in.friction_I_max);
  EXPECT_EQ(from_table.phi_I_max, built_in.phi_I_max);
  EXPECT_EQ(from_table.wall_disagreement, built_in.wall_disagreement);
  EXPECT_EQ(from_table.mu_floor, built_in.mu_floor);
  EXPECT_EQ(from_table.phi_floor, built_in.phi_floor);
  EXPECT_EQ(from_table.I_floor, built_in.I_floor);
  EXPECT_EQ(from_table.D_star_min, built_in.D_star_min);
  EXPECT_EQ(from_table.D_star_max, built_in.D_star_max);
  EXPECT_EQ(from_table.mu_max, built_in.mu_max);
  EXPECT_EQ(from_table.b_max, built_in.b_max);
  EXPECT_EQ(from_table.dilation, built_in.dilation);
  EXPECT_EQ(from_table.s_star_min, built_in.s_star_min);
  EXPECT_EQ(from_table.s_star_max, built_in.s_star_max);
  EXPECT_EQ(from_table.bins, built_in.bins);
  EXPECT_EQ(from_table.mu_from_strain, built_in.mu_from_strain);
  EXPECT_EQ(from_table.starts, built_in.starts);
  EXPECT_EQ(from_table.strict, built_in.strict);
  const CaseFile given = CaseFile::parse("[fit]\nstrict = true\ndilation = \"none\"\n", "case.toml");
  EXPECT_TRUE(FitOptions::from(given.section(fit_table)).strict);
  EXPECT_EQ(FitOptions::from(given.section(fit_table)).dilation, "none");
}

}  // namespace
}  // namespace dem2sph
