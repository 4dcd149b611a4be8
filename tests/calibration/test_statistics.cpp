// Quantiles against printed tables; the noise model against data made from it.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calibration/statistics.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

TEST(MeanAndSd, WrittenDown) {
  const MeanAndSd m = mean_and_sd(std::vector{1.0, 2.0, 6.0});
  EXPECT_DOUBLE_EQ(m.mean, 3);
  EXPECT_DOUBLE_EQ(m.sd, std::sqrt((4.0 + 1 + 9) / 2));
  EXPECT_EQ(mean_and_sd(std::vector{5.0}).sd, 0);
}

TEST(Statistics, QuantilesAgreeWithTables) {
  // Printed to six decimals in any table: half a unit of the last is 5e-7.
  EXPECT_NEAR(normal_quantile(0.975), 1.959964, 5e-7);
  EXPECT_NEAR(normal_quantile(0.025), -1.959964, 5e-7);
  EXPECT_NEAR(student_t_quantile(0.975, 1), 12.706205, 5e-7);
  EXPECT_NEAR(student_t_quantile(0.975, 3), 3.182446, 5e-7);
  EXPECT_NEAR(student_t_quantile(0.975, 10), 2.228139, 5e-7);
  EXPECT_NEAR(student_t_quantile(0.95, 30), 1.697261, 5e-7);
  EXPECT_NEAR(student_t_quantile(0.025, 10), -2.228139, 5e-7);
  // One and two degrees of freedom have closed forms: tan(pi (P - 1/2)) and (2P - 1)/sqrt(2 P (1 - P)).
  EXPECT_NEAR(student_t_quantile(0.9, 1), std::tan(M_PI * 0.4), 1e-12);
  EXPECT_NEAR(student_t_quantile(0.9, 2), 0.8 / std::sqrt(0.18), 1e-12);
  EXPECT_THROW(student_t_quantile(0.975, 0), Error);
  EXPECT_THROW(normal_quantile(1), Error);
}

CorrelatedResiduals wandering(const NoiseModel& noise, std::size_t n, double ds, std::mt19937& generator) {
  std::normal_distribution<double> normal;
  CorrelatedResiduals run;
  run.residuals.resize(static_cast<Eigen::Index>(n));
  const double keep = std::exp(-ds / noise.strain_scale);
  double wander = noise.wander_sd * normal(generator);
  for (std::size_t i = 0; i < n; ++i) {
    run.s.push_back(ds * static_cast<double>(i + 1));
    run.residuals(static_cast<Eigen::Index>(i)) = wander + noise.white_sd * normal(generator);
    wander = keep * wander + noise.wander_sd * std::sqrt(1 - keep * keep) * normal(generator);
  }
  run.jacobian = Eigen::MatrixXd::Ones(static_cast<Eigen::Index>(n), 1);
  run.parameters = {0};
  return run;
}

TEST(Statistics, WhitenedNoiseIsWhite) {
  const NoiseModel noise{0.002, 0.15, 0.0005};
  const std::vector<double> s{0.1, 0.15, 0.3, 0.31, 0.9, 1.4};
  const Eigen::MatrixXd w = noise.whitening(s);
  const Eigen::MatrixXd identity = w * noise.covariance(s) * w.transpose();
  // Rounding of six sums of six terms, times the condition of the covariance (below 1e3 here).
  EXPECT_LT((identity - Eigen::MatrixXd::Identity(6, 6)).cwiseAbs().maxCoeff(), 36 * 2.3e-16 * 1e3);
  EXPECT_NEAR(noise.covariance(s)(2, 2), 0.002 * 0.002 + 0.0005 * 0.0005, 1e-20);
  EXPECT_NEAR(noise.covariance(s)(0, 4), 0.002 * 0.002 * std::exp(-0.8 / 0.15), 1e-20);
}

TEST(Statistics, IndependentSamplesHasItsLimits) {
  const std::vector<double> s{1, 2, 3, 4, 5};
  EXPECT_NEAR((NoiseModel{0, 1, 0.1}.independent_samples(s)), 5, 1e-12);
  // Fully correlated samples are one, up to the 1e-6 of white noise.
  EXPECT_NEAR((NoiseModel{0.1, 1e6, 1e-4}.independent_samples(s)), 1, 1e-4);
}

TEST(Statistics, NoiseIsFoundAgain) {
  const NoiseModel truth{0.002, 0.15, 0.0005};
  std::mt19937 generator(4);
  // Median over 40 sets of 6 runs: each set has about 6 x 20 independent samples, so a strain scale scatters
  // by about 1/sqrt(60) and its median over 40 sets by a sixth of that, 3 %; 10 % is three of them.
  std::vector<double> scale, wander, white;
  for (int set = 0; set < 40; ++set) {
    std::vector<CorrelatedResiduals> runs;
    for (int r = 0; r < 6; ++r) runs.push_back(wandering(truth, 60, 0.05, generator));
    const NoiseModel found = fit_noise(runs, 1);
    scale.push_back(found.strain_scale);
    wander.push_back(found.wander_sd);
    white.push_back(found.white_sd);
  }
  const auto median = [](std::vector<double>& v) {
    std::nth_element(v.begin(), v.begin() + 20, v.end());
    return v[20];
  };
  EXPECT_NEAR(median(scale) / truth.strain_scale, 1, 0.1);
  EXPECT_NEAR(median(wander) / truth.wander_sd, 1, 0.1);
  EXPECT_NEAR(median(white) / truth.white_sd, 1, 0.3);  // 6 % of the variance: hard to see
}

TEST(Statistics, ResidualsWithoutNoiseAreRefused) {
  CorrelatedResiduals run;
  for (int i = 0; i < 20; ++i) run.s.push_back(0.1 * (i + 1));
  run.residuals = Eigen::VectorXd::Zero(20);
  run.jacobian = Eigen::MatrixXd::Ones(20, 1);
  run.parameters = {0};
  EXPECT_THROW(fit_noise(std::vector{run}, 1), IdentifiabilityError);
  EXPECT_THROW(fit_noise(std::vector{run}, 20), IdentifiabilityError);
}

}  // namespace
}  // namespace dem2sph
