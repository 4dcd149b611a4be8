// A part of the matrix of extremes through the program.
#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>

#include "sph/base/provenance.hpp"
#include "tests/cases/program.hpp"

namespace dem2sph {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

class Stability : public test::Program {
 protected:
  const std::string case_file = DEM2SPH_CASES "/stability/case.toml";
};

TEST_F(Stability, SomeAxesOfTheSolver) {
  const auto with = [&](const std::string& axis) {
    return run(
        {"stability", case_file, "-o", in("out"), "-q", "--jobs", "1", "--set", "stability.axis=" + axis,
         "--set", "stability.grains=false", "--set", "stability.step_limits=false"},
        {}, 300);
  };
  for (const auto& [axis, least] :
       std::map<std::string, std::size_t>{{"no_pressure", 7}, {"thin_bed", 8}, {"drop", 6}}) {
    SCOPED_TRACE(axis);
    const Outcome outcome = with(axis);
    ASSERT_EQ(outcome.code, 0) << outcome.text;
    const json result = read_json(in("out/stability.json"));
    EXPECT_EQ(result.at("unexplained"), 0);
    EXPECT_GE(result.at("solver").size(), least);
    for (const json& cell : result.at("solver")) {
      SCOPED_TRACE(cell.at("value").get<std::string>());
      const std::string status = cell.at("status").get<std::string>();
      EXPECT_TRUE(status == "stable" || !cell.at("text").get<std::string>().empty()) << "no cause is named";
      const std::string value = cell.at("value").get<std::string>();
      if (value.starts_with("free ")) {
        EXPECT_EQ(status, "stable") << cell.at("text");
      }
      if (value == "1 rows at rest") {
        EXPECT_EQ(status, "warned");
      }
    }
  }
  for (const char* file : {"stability.svg", "report.html"})
    EXPECT_TRUE(fs::exists(in("out") / fs::path(file)));
  // What is done is taken from the folder.
  const json before = read_json(in("out/stability.json"));
  EXPECT_EQ(with("thin_bed").code, 0);  // the last of them
  EXPECT_EQ(read_json(in("out/stability.json")).at("solver"), before.at("solver"));
  const Outcome outcome = with("particles");
  EXPECT_EQ(outcome.code, 2);
  EXPECT_NE(outcome.text.find("thin_bed"), std::string::npos) << "it names the axes that there are";
}

}  // namespace
}  // namespace dem2sph
