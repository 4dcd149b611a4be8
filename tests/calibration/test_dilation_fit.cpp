// The laws of dilation as a fit sees them, and what a fit makes of data with a known truth.
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "calibration/fit.hpp"
#include "calibration/models.hpp"
#include "tests/calibration/synthetic.hpp"

namespace dem2sph {
namespace {

const std::vector<std::string> members{"phi_relaxes", "two_sided", "printed",
                                       "dilatancy",   "constant",  "none"};

// A transient in which I falls and rises, so that phi crosses its equilibrium.
struct Case {
  std::vector<double> s, at, step;
  Case() {
    double before = 0.585;
    for (int i = 1; i <= 60; ++i) {
      s.push_back(0.03 * i);
      at.push_back(0.585 + 0.01 * std::sin(4 * s.back()));
      step.push_back(0.5 * (before + at.back()));
      before = at.back();
    }
  }
  TransientInput input(bool from_steady_flow) const { return {s, at, step, from_steady_flow}; }
};

TEST(DilationModels, DerivativesAreThoseOfTheValue) {
  const Case c;
  for (const std::string& member : members)
    for (const bool from_steady_flow : {false, true}) {
      const auto model = dilation_model(member, 0.01, 20);
      std::vector<double> all = model->start();
      const std::size_t n = all.size();
      all.push_back(0.002);
      all.push_back(0.59);
      const auto at = [&](const std::vector<double>& v) {
        return model->evaluate(c.input(from_steady_flow), std::span(v).first(n), v[n], v[n + 1]);
      };
      const TransientSolution solution = at(all);
      for (std::size_t k = 0; k < all.size(); ++k) {
        const double step = 1e-6;
        std::vector<double> up = all, down = all;
        up[k] += step, down[k] -= step;
        const TransientSolution above = at(up), below = at(down);
        // Cubic terms of the difference are 1e-12 of the scale, rounding is 1e-16/1e-6.
        for (std::size_t i = 0; i < c.s.size(); ++i) {
          EXPECT_NEAR(solution.phi_by(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k)),
                      (above.phi[i] - below.phi[i]) / (2 * step), 1e-8)
              << member << " phi, parameter " << k << ", sample " << i;
          EXPECT_NEAR(solution.beta_by(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k)),
                      (above.beta[i] - below.beta[i]) / (2 * step), 1e-6)
              << member << " beta, parameter " << k << ", sample " << i;
        }
      }
    }
}

TEST(DilationModels, BetaIsTheRateAtWhichPhiFalls) {
  // -d ln(phi)/ds = beta for every member, by differences over a fine strain at constant I from above and
  // below.
  std::vector<double> s, eq(400, 0.585);
  for (int i = 1; i <= 400; ++i) s.push_back(0.002 * i);
  for (const std::string& member : members)
    for (const double phi_0 : {0.62, 0.56}) {
      const auto model = dilation_model(member, 0.01, 20);
      std::vector<double> x = model->start();
      if (member == "constant") x = {0.07};
      const TransientSolution solution = model->evaluate({s, eq, eq, false}, x, 0, phi_0);
      for (std::size_t i = 1; i + 1 < s.size(); ++i) {
        const double fall = -(std::log(solution.phi[i + 1]) - std::log(solution.phi[i - 1])) / 0.004;
        // The difference's own error is ds^2/6 of the third derivative, beta/s*^2: 1.7e-5 of beta for s* =
        // 0.2.
        EXPECT_NEAR(solution.beta[i], fall, 1e-4 * std::abs(fall) + 1e-10) << member << " at " << s[i];
      }
    }
}

TEST(DilationModels, MembersThatAreTiedAgree) {
  const Case c;
  const auto one = dilation_model("phi_relaxes", 0.01, 20);
  const auto two = dilation_model("two_sided", 0.01, 20);
  const double x = std::log(0.3);
  const TransientSolution a = one->evaluate(c.input(false), std::vector{x}, 0, 0.6);
  const TransientSolution b = two->evaluate(c.input(false), std::vector{x, x}, 0, 0.6);
  EXPECT_EQ(a.phi, b.phi);
  EXPECT_EQ(a.beta, b.beta);
  // The printed form with A = 1 is the same but for beta^2 and the place of phi: 2 % of an excess of 0.015.
  const auto printed = dilation_model("printed", 0.01, 20);
  const TransientSolution p = printed->evaluate(c.input(false), std::vector{x, 1.0}, 0, 0.6);
  for (std::size_t i = 0; i < c.s.size(); ++i) EXPECT_NEAR(p.phi[i], a.phi[i], 0.02 * 0.015);
  // Without any source, a jump from a steady flow changes nothing.
  const TransientSolution still = printed->evaluate(c.input(true), std::vector{x, 0.0}, 0, 0.6);
  EXPECT_EQ(still.phi.back(), 0.6);
}

synthetic::Truth two_sided_truth() {
  synthetic::Truth truth;
  truth.s_star = 0.25;
  truth.transient_offset = 0;
  return truth;
}

/// Eight dense and eight loose start-ups, with one scale for each side.
Observables dense_and_loose(unsigned seed, double s_star, double compacting) {
  synthetic::Truth truth = two_sided_truth();
  Observables o = synthetic::observables(truth, seed, 8, 1e-3, 1, 0);
  synthetic::Noise noise(seed + 1000);
  for (const bool dense : {true, false})
    for (int k = 0; k < 8; ++k) {
      truth.s_star = dense ? s_star : compacting;
      o.transients.push_back(synthetic::start_up(truth, 0.03, dense ? 0.625 : 0.55, noise,
                                                 fmt::format("{}{}", dense ? "dense" : "loose", k), 2, 60));
      o.transients.back().packing_friction = dense ? 0 : 5;
    }
  return o;
}

bool contains(const Estimate& e, double truth) { return e.low <= truth && truth <= e.high; }

FitOptions quick() {
  FitOptions options;
  options.starts = 4;
  options.solid_fraction = "linear";
  options.profiles = false;
  return options;
}

TEST(DilationFit, TheDataChooseTheMemberTheyWereMadeWith) {
  const Fit tied = fit_law({dense_and_loose(1, 0.25, 0.25)}, quick());
  EXPECT_EQ(tied.dilation.member, "phi_relaxes");
  const Fit two = fit_law({dense_and_loose(1, 0.25, 0.06)}, quick());
  ASSERT_EQ(two.dilation.member, "two_sided");
  EXPECT_TRUE(contains(two.dilation["s_star"], 0.25)) << list_of(two.dilation);
  EXPECT_TRUE(contains(two.dilation["s_star_compacting"], 0.06)) << list_of(two.dilation);
  EXPECT_EQ(two.covariance_names.back(), "s_star_compacting");
  ASSERT_EQ(two.dilation_members.size(), 6u);
  for (const LawFit& member : two.dilation_members)
    EXPECT_TRUE(!member.failure.empty() || member.member == "two_sided" ||
                member.AICc > two.dilation.AICc + 10)
        << member.member << " " << member.AICc << " against " << two.dilation.AICc;
  const LawFile law = make_law_file(two, {});
  EXPECT_EQ(law.dilation.member, "two_sided");
  EXPECT_EQ(law.dilation["s_star_compacting"], two.dilation["s_star_compacting"].value);
}

TEST(DilationFit, IntervalsOfBothScalesCover) {
  const int draws = 60;
  int dilating = 0, compacting = 0;
  FitOptions options = quick();
  options.dilation = "two_sided";
  options.compare = false;
  options.profiles = true;
  for (int draw = 0; draw < draws; ++draw) {
    const Fit fit = fit_law({dense_and_loose(300u + static_cast<unsigned>(draw), 0.25, 0.08)}, options);
    dilating += contains(fit.dilation["s_star"], 0.25);
    compacting += contains(fit.dilation["s_star_compacting"], 0.08);
  }
  std::printf("  s_star covered %d of %d, s_star_compacting %d\n", dilating, draws, compacting);
  // 95 % less four standard deviations of the binomial distribution.
  const double least = 0.95 - 4 * std::sqrt(0.95 * 0.05 / draws);
  EXPECT_GE(dilating, least * draws);
  EXPECT_GE(compacting, least * draws);
}

TEST(DilationFit, ThreeWaysToAnIntervalAgree) {
  // Student's about the estimate, the profile of chi2, and draws among the seeds: of 16 runs, all near the
  // parabola. The bootstrap's ends are those of 200 draws, each known to some 10 % of the half width.
  FitOptions options = quick();
  options.dilation = "two_sided";
  const Fit plain = fit_law({dense_and_loose(9, 0.25, 0.08)}, options);
  options.profiles = true;
  const Fit fit = fit_law({dense_and_loose(9, 0.25, 0.08)}, options);
  ASSERT_EQ(fit.dilation.profiles.size(), 2u);
  ASSERT_EQ(fit.dilation.bootstrap.draws, 200);
  for (std::size_t k = 0; k < 2; ++k) {
    const Estimate& student = plain.dilation.parameters[k];
    const Estimate& profile = fit.dilation.parameters[k];
    const double half = 0.5 * (student.high - student.low);
    EXPECT_EQ(student.value, profile.value);
    EXPECT_NEAR(profile.low, student.low, 0.3 * half) << student.name;
    EXPECT_NEAR(profile.high, student.high, 0.3 * half) << student.name;
    EXPECT_NE(profile.low, student.low);
    EXPECT_NEAR(fit.dilation.bootstrap.low[k], student.low, 0.5 * half) << student.name;
    EXPECT_NEAR(fit.dilation.bootstrap.high[k], student.high, 0.5 * half) << student.name;
    const Profile& p = fit.dilation.profiles[k];
    EXPECT_FALSE(p.open_low || p.open_high);
    EXPECT_EQ(p.name, student.name);
  }
}

TEST(DilationFit, ChecksAgainstTheNoiseOfTheSeeds) {
  FitOptions options = quick();
  options.dilation = "two_sided";
  const Fit good = fit_law({dense_and_loose(5, 0.25, 0.08)}, options);
  // The noise that was put in: 0.0015 that wanders over 0.15, 0.0005 white. 16 runs of strain 2 have some 200
  // independent samples: 5 % of a standard deviation, 10 % of a scale; four of each, and what is left of
  // phi_0.
  EXPECT_NEAR(good.seed_noise.wander_sd, 0.0015, 0.0003);
  EXPECT_NEAR(good.seed_noise.strain_scale, 0.15, 0.08);
  ASSERT_EQ(good.transient_checks.size(), 2u);
  for (const TransientCheck& c : good.transient_checks) {
    EXPECT_EQ(c.seeds, 8);
    // Some 460 samples: sqrt(2/460) = 0.07, and the noise itself is known to 10 %.
    EXPECT_NEAR(c.chi2_per_dof, 1, 0.35);
    EXPECT_GT(c.explained, 0.97);
    EXPECT_GT(c.signal_to_noise, 5);
    EXPECT_FALSE(c.predicted) << "the other group says nothing of this side's scale";
  }
  // One scale for both cannot do it, and says so.
  options.dilation = "phi_relaxes";
  const Fit bad = fit_law({dense_and_loose(5, 0.25, 0.05)}, options);
  bool said = false;
  for (const TransientCheck& c : bad.transient_checks) {
    said = said || c.chi2_per_dof > 1.5;
    EXPECT_TRUE(c.predicted);
  }
  EXPECT_TRUE(said);
  EXPECT_TRUE(std::any_of(bad.warnings.begin(), bad.warnings.end(), [](const std::string& w) {
    return w.find("not described to the noise of the seeds") != std::string::npos;
  }));
}

}  // namespace
}  // namespace dem2sph
