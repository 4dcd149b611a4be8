// law.json and fit.json: the law that is written is the law that was fitted, to the bit.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "calibration/fit.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"
#include "tests/calibration/synthetic.hpp"

namespace dem2sph {
namespace {

class FitFile : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (std::filesystem::temp_directory_path() / "dem2sph_fit_XXXXXX").string();
    ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
    folder = pattern;
    observables = folder / "observables.h5";
    std::ofstream(observables) << "stands for the observables";
  }
  void TearDown() override { std::filesystem::remove_all(folder); }
  std::filesystem::path folder, observables;
};

std::int64_t ulps_apart(double a, double b) {
  std::int64_t x = 0, y = 0;
  std::memcpy(&x, &a, sizeof a);
  std::memcpy(&y, &b, sizeof b);
  return std::abs(x - y);
}

TEST_F(FitFile, OneLawByTemplateByJetAndByFile) {
  const Fit fit = fit_law({synthetic::observables({}, 1)});
  write_fit(fit, std::vector{observables}, folder / "law.json");
  const LawFile law = read_law_file(folder / "law.json");
  const RationalFriction<double> by_file{law.friction["mu_l"], law.friction["mu_h"], law.friction["D_star"]};
  const auto fitted = std::get<RationalFriction<double>>(fit.friction_law());
  for (const double I : {0.0, 1e-9, 1e-3, 0.05, 0.279, 1.0, 30.0}) {
    // The fit sees the law through logarithms, which costs a few roundings.
    EXPECT_LE(ulps_apart(fitted(I), predict_friction(fit, I).value), 8) << I;
    EXPECT_EQ(fitted(I), by_file(I)) << I;  // 17 digits read back bit for bit
  }
  const auto phi = fit.solid_fraction_law();
  for (const double I : {0.0, 0.1, 0.5})
    EXPECT_LE(ulps_apart(phi(I), predict_solid_fraction(fit, I).value), 8);
  EXPECT_EQ(law.solid_fraction.member, fit.solid_fraction.member);
  for (const Estimate& e : fit.solid_fraction.parameters) EXPECT_EQ(law.solid_fraction[e.name], e.value);
  EXPECT_EQ(law.dilation["s_star"], fit.dilation["s_star"].value);
}

TEST_F(FitFile, LawFileSaysWhereItComesFrom) {
  const Fit fit = fit_law({synthetic::observables({}, 1)});
  write_fit(fit, std::vector{observables}, folder / "law.json");
  const LawFile law = read_law_file(folder / "law.json");
  EXPECT_EQ(law.verdict, fit.verdict);
  EXPECT_EQ(law.warnings, fit.warnings);
  EXPECT_EQ(law.covariance, fit.covariance);
  EXPECT_EQ(law.covariance_names, fit.covariance_names);
  EXPECT_EQ(law.provenance.at("observables").at(0).at("sha256"), sha256_of_file(observables));
  EXPECT_EQ(law.provenance.at("runs").size(), 14u);
  EXPECT_EQ(law.provenance.at("engine"), "LIGGGHTS 3.8.0");
  EXPECT_NEAR(law.I.lowest, 1e-3, 1e-4);
  EXPECT_NEAR(law.I.highest, 1, 0.05);
  EXPECT_EQ(law.p.highest, 1000);
  EXPECT_NEAR(law.s.highest, 3, 1e-12);

  const nlohmann::json full = read_json(folder / "fit.json");
  EXPECT_EQ(full.at("format"), "dem2sph-fit");
  EXPECT_EQ(full.at("data").at("friction").size(), fit.friction_data.size());
  EXPECT_EQ(full.at("friction").at("parameters").at(0).at("value").get<double>(), fit.friction["mu_l"].value);
  EXPECT_EQ(full.at("friction").at("search").at("singular_values").size(), 3u);
  EXPECT_EQ(full.at("dilation").at("search").at("starts"), 16);
  EXPECT_EQ(full.at("data").at("transients").at(0).at("phi_fit").size(), 120u);
  EXPECT_TRUE(full.contains("beta_in_mu"));
}

TEST_F(FitFile, EachLawHasItsOwnAccount) {
  const Fit fit = fit_law({synthetic::observables({}, 1, 12, 1e-3, 1, 0)});
  for (const char* name : {"law.json", "soft.json", "stiff.v2"})
    write_fit(fit, std::vector{observables}, folder / name);
  for (const char* name : {"fit.json", "soft.fit.json", "stiff.v2.fit.json"})
    EXPECT_EQ(read_json(folder / name).at("format"), "dem2sph-fit") << name;
  EXPECT_EQ(fit_path_of("law.json"), "fit.json");
}

TEST_F(FitFile, WithoutStartUpsThereIsNoLawOfDilation) {
  const Fit fit = fit_law({synthetic::observables({}, 1, 12, 1e-3, 1, 0)});
  write_fit(fit, std::vector{observables}, folder / "law.json");
  const LawFile law = read_law_file(folder / "law.json");
  EXPECT_EQ(law.dilation.member, "none");
  EXPECT_EQ(law.covariance_names.size(), 5u);
  EXPECT_NE(law.verdict.find("no law of dilation"), std::string::npos);
  EXPECT_FALSE(read_json(folder / "fit.json").contains("beta_in_mu"));
}

TEST_F(FitFile, MissingObservablesAreAnInputError) {
  const Fit fit = fit_law({synthetic::observables({}, 1, 12, 1e-3, 1, 0)});
  EXPECT_THROW(write_fit(fit, std::vector{folder / "not_there.h5"}, folder / "law.json"), InputError);
  EXPECT_FALSE(std::filesystem::exists(folder / "law.json"));
}

}  // namespace
}  // namespace dem2sph
