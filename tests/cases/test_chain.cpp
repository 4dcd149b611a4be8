// The chain from end to end through the program: shear cells, law, two flows, report. LIGGGHTS is a script,
// and the runs that it would do are done already, with figures of a law that is known.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <map>

#include "dem_bridge/run.hpp"
#include "dem_bridge/sweep.hpp"
#include "sph/base/provenance.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/calibration/synthetic.hpp"
#include "tests/cases/program.hpp"

namespace dem2sph {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::content_of;
using test::put;

constexpr const char* case_text = R"([material]
d = "1 mm"
rho_s = "2500 kg/m^3"
grain_friction = 0.5

[shear_cell]

[shear_cell.steady]
I = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0]

[shear_cell.start_up]
I = [0.03]
seeds = [1, 2, 3, 4]

[flow]
scene = "column_collapse"
resolution = 8
initial_solid_fraction = 0.6
end_time = "0.05 s"
frames = 2

[column]
length = "40 mm"
aspect_ratio = 1
)";

class Chain : public test::Program {
 protected:
  void SetUp() override {
    if (!program_exists("gnuplot")) GTEST_SKIP() << "gnuplot is not installed: package gnuplot-nox";
    put(in("case.toml"), case_text);
    // Tells its version and its styles and knows the contact law; a run it is asked to do breaks down.
    put(in("engine"),
        "#!/bin/sh\ncase \"$*\" in\n"
        "*-help*) echo '* Atom styles:'; echo granular; echo '* Pair styles:'; echo gran\n"
        "  echo '* Normal models for pair gran:'; echo hertz; echo '* Tangential models for pair gran:'\n"
        "  echo history; echo '* Compute styles:'; echo pair/gran/local; echo '* Dump styles:'; echo custom "
        "local\n"
        "  echo '* Fix styles:'; echo addforce ave/time deform freeze insert/pack nve/sphere\n"
        "  echo particletemplate/sphere property/global rigid viscous; exit 0;;\n"
        "*-in*) if grep -q 'three grains' deck.in; then echo 'DEM2SPH reached step 0 with 3 grains'; exit 0; "
        "fi\n"
        "  echo 'ERROR: no grains today'; exit 1;; esac\n"
        "echo 'LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled today)'\n");
    fs::permissions(in("engine"), fs::perms::owner_all);
    const bridge::SweepPlan plan =
        bridge::plan_sweep(CaseFile::parse(case_text, "case.toml"), "LIGGGHTS-PUBLIC 3.8.0");
    synthetic::Noise noise(7);
    for (const bridge::RunPlan& run : plan.runs) {
      if (bridge::prepares(run.kind)) continue;  // nobody needs it once the others are done
      done_[run.hash] = run.kind == bridge::RunKind::steady ? steady(run, noise) : start_up(run, noise);
      done_[run.hash]["reduction_version"] = bridge::reduction_version;
      finish(run.hash);
    }
  }

  json steady(const bridge::RunPlan& run, synthetic::Noise& noise) const {
    const SteadyPoint p = synthetic::steady_point(truth_, run.shearing.I_driven, noise, run.hash);
    const auto mean = [](double value, double error) {
      return json{{"value", value}, {"standard_error", error}, {"block", 4}, {"flat", true}};
    };
    return {{"result",
             {{"I", mean(p.I, p.I_se)},
              {"mu", mean(p.mu, p.mu_se)},
              {"phi", mean(p.phi, p.phi_se)},
              {"p", mean(p.p, p.p_se)},
              {"strain", p.strain},
              {"N1", mean(-0.02, 0.005)},
              {"N2", mean(0.06, 0.005)},
              {"beta", mean(0, 0.001)},
              {"temperature", 0.5},
              {"coordination", 4.0},
              {"fabric_xz", -0.1},
              {"phi_drift", 0.5}}},
            {"evidence", {{"wall_mu", p.wall_mu}, {"wall_p", p.wall_p}}},
            {"cost", {{"cpu_seconds", 10.0}}}};
  }

  json start_up(const bridge::RunPlan& run, synthetic::Noise& noise) const {
    const Transient t = synthetic::start_up(truth_, run.shearing.I_driven, 0.615, noise, run.hash);
    return {{"result",
             {{"phi_0", t.phi_0},
              {"s", t.s},
              {"gamma_dot", t.gamma_dot},
              {"p", t.p},
              {"mu", t.mu},
              {"I", t.I},
              {"phi", t.phi},
              {"beta", t.beta},
              {"height", t.height}}},
            {"evidence", {{"wall_mu", 0.4}, {"wall_p", 1000.0}}},
            {"cost", {{"cpu_seconds", 10.0}}}};
  }

  fs::path run_folder(const std::string& hash) const { return in("out") / "shear_cell" / "runs" / hash; }
  void finish(const std::string& hash) const {
    fs::create_directories(run_folder(hash));
    put(run_folder(hash) / "done.json", done_.at(hash).dump());
  }

  Outcome run(std::vector<std::string> arguments) const {
    return Program::run(std::move(arguments), {{"DEM2SPH_LIGGGHTS", in("engine").string()}}, 100);
  }
  Outcome run_chain() const { return run({"run", in("case.toml").string(), "-o", in("out").string(), "-q"}); }

  synthetic::Truth truth_;
  std::map<std::string, json> done_;
};

TEST_F(Chain, FromFinishedCellsToTheReport) {
  const fs::path out = in("out");
  const Outcome first = run_chain();
  ASSERT_EQ(first.code, 0) << first.text;
  EXPECT_CONTAINS(first.text, "report: " + (out / "report.html").string());
  for (const char* name : {"mu_l", "mu_h", "D_star", "phi_c", "s_star", "std. error"})
    EXPECT_CONTAINS(first.text, name);
  for (const char* name : {"report.html", "law.json", "fit.json", "run.json", "shear_cell/observables.h5"})
    EXPECT_TRUE(fs::exists(out / name)) << name;

  // The law is the one that the cells were given.
  const std::map<std::string, double> truth{
      {"mu_l", truth_.friction.mu_l},     {"mu_h", truth_.friction.mu_h},
      {"D_star", truth_.friction.D_star}, {"phi_c", truth_.solid_fraction.phi_c},
      {"b", truth_.solid_fraction.b},     {"s_star", truth_.s_star}};
  const json fit = read_json(out / "fit.json");
  std::size_t compared = 0;
  for (const char* part : {"friction", "solid_fraction", "dilation"})
    for (const json& parameter : fit.at(part).at("parameters")) {
      const std::string name = parameter.at("name").get<std::string>();
      const double error = parameter.at("standard_error").get<double>();
      EXPECT_GT(error, 0) << name;
      EXPECT_LT(std::abs(parameter.at("value").get<double>() - truth.at(name)), 4 * error) << name;
      ++compared;
    }
  EXPECT_EQ(compared, truth.size());

  // Both flows used this law.
  const char* flows[] = {"flow_without_dilation/summary.json", "flow_with_dilation/summary.json"};
  std::map<std::string, std::string> summaries;
  for (const char* flow : flows) summaries[flow] = content_of(out / flow);
  const json without = json::parse(summaries[flows[0]]);
  const json with = json::parse(summaries[flows[1]]);
  EXPECT_NE(without.at("law_sha256"), "");
  EXPECT_EQ(without.at("law_sha256"), with.at("law_sha256"));
  EXPECT_NE(without.at("series"), with.at("series")) << "dilation changes the flow";

  // The same command again makes nothing anew.
  const json law = read_json(out / "law.json");
  std::map<std::string, fs::file_time_type> written;
  for (const char* flow : flows) written[flow] = fs::last_write_time(out / flow);
  const Outcome second = run_chain();
  ASSERT_EQ(second.code, 0) << second.text;
  const json law_again = read_json(out / "law.json");
  for (const char* part : {"friction", "solid_fraction", "dilation", "covariance", "range"})
    EXPECT_EQ(law_again.at(part).dump(), law.at(part).dump()) << part;
  for (const char* flow : flows) {
    EXPECT_EQ(fs::last_write_time(out / flow), written[flow]) << flow;
    EXPECT_EQ(content_of(out / flow), summaries[flow]) << flow;
  }

  fs::remove(out / "report.html");
  const Outcome report = run({"report", out.string()});
  EXPECT_EQ(report.code, 0) << report.text;
  EXPECT_CONTAINS(content_of(out / "report.html"), "<svg");

  const Outcome status = run({"sweep", "status", (out / "shear_cell").string()});
  EXPECT_EQ(status.code, 0) << status.text;
  EXPECT_CONTAINS(status.text, "16 done");
}

TEST_F(Chain, AFailedCellIsLeftOutAndTheWayBackIsNamed) {
  const std::string lost = done_.begin()->first;
  fs::remove(run_folder(lost) / "done.json");
  const Outcome failed = run_chain();
  EXPECT_EQ(failed.code, 4) << failed.text;
  EXPECT_CONTAINS(failed.text, "no grains today");
  EXPECT_CONTAINS(failed.text, "dem2sph sweep retry " + (in("out") / "shear_cell").string());
  EXPECT_TRUE(fs::exists(in("out") / "report.html")) << "what the other cells say is reported all the same";
  // Its preparation fails, so it never begins: both are named, the preparation first.
  const json excluded = read_json(in("out") / "fit.json").at("excluded");
  ASSERT_GE(excluded.size(), 2U) << excluded.dump();
  EXPECT_CONTAINS(excluded.at(0).at("reason").get<std::string>(), "no grains today");
  EXPECT_EQ(excluded.at(1).at("run"), lost);
  EXPECT_CONTAINS(excluded.at(1).at("reason").get<std::string>(), "which failed");
  const Outcome status = run({"sweep", "status", (in("out") / "shear_cell").string()});
  EXPECT_CONTAINS(status.text, "15 done");
  EXPECT_CONTAINS(status.text, "1 failed");
  EXPECT_EQ(run({"sweep", "retry", (in("out") / "shear_cell").string()}).code, 4) << "it fails again";
}

}  // namespace
}  // namespace dem2sph
