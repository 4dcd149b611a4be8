// The page: self-contained, well formed, with the numbers of the fit, and safe against what texts may hold.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>

#include "calibration/report.hpp"
#include "calibration/report_figures.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"
#include "tests/calibration/synthetic.hpp"

namespace dem2sph {
namespace {

nlohmann::json summary(double friction_of_run) {
  nlohmann::json j;
  const double H0 = 0.1, L0 = 0.1;
  for (int k = 0; k <= 100; ++k) {
    const double t = 0.006 * k;
    const double u = 1 - std::exp(-std::pow(t / 0.12, 2));
    j["series"]["time"].push_back(t);
    j["series"]["front_99"].push_back(L0 * (1 + 1.2 * friction_of_run * u));
    j["series"]["centre_height"].push_back(H0 * (1 - 0.3 * u));
    j["series"]["kinetic_energy"].push_back(t * std::exp(-t / 0.1));
    j["series"]["max_speed"].push_back(std::exp(-t));
    if (k % 10 == 0) {
      nlohmann::json profile{{"time", t}};
      const double front = L0 * (1 + 1.2 * friction_of_run * u);
      for (int i = 0; i <= 60; ++i) {
        const double x = 0.3 * i / 60;
        const double flat = x < L0 ? H0 : 0.0;
        const double heap = std::max(0.0, (1 - x / front)) * 2 * H0 * L0 / front;
        profile["x"].push_back(x);
        profile["height"].push_back((1 - u) * flat + u * std::min(heap, 0.7 * H0));
      }
      j["profiles"].push_back(profile);
    }
  }
  j["wall_seconds"] = 42.0;
  j["cpu_seconds"] = 80.0;
  j["particles"] = 800;
  j["steps"] = 30000;
  j["particle_steps_per_second"] = 5.7e5;
  j["formulation"] = "robust";
  j["composition"] = {"robust", "cubic spline", "phi relaxes"};
  j["initial"] = {{"L0", L0}, {"H0", H0}};
  return j;
}

class Report : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (std::filesystem::temp_directory_path() / "dem2sph_report_XXXXXX").string();
    ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
    folder = pattern;
    write("observables.h5", "stands for the observables");
    write("with.json", summary(1.0).dump());
    write("without.json", summary(1.05).dump());
    synthetic::Truth truth;
    in.title = "Column collapse";
    in.observables = {synthetic::observables(truth, 4, 12, 1e-3, 0.9, 2)};
    in.observables[0].excluded.push_back({"0123456789abcdef", "the cell lost 2 grains"});
    in.fit = fit_law(in.observables);
    in.law = make_law_file(in.fit, std::vector{folder / "observables.h5"});
    in.flows = {{"with dilation", folder / "with.json"}, {"without dilation", folder / "without.json"}};
    in.steps = {{"shear cells (LIGGGHTS)", 95, {folder / "observables.h5"}}, {"fit (Ceres)", 0.4, {}}};
    in.provenance = provenance();
  }
  void TearDown() override { std::filesystem::remove_all(folder); }

  void write(const std::string& name, const std::string& text) const { std::ofstream(folder / name) << text; }
  std::string page() {
    write_report(in, folder / "report.html");
    std::ifstream file(folder / "report.html");
    std::ostringstream text;
    text << file.rdbuf();
    // For people who want to look at it.
    if (const char* keep = std::getenv("DEM2SPH_KEEP_REPORT")) write_file_atomically(keep, text.str());
    return text.str();
  }
  std::string refusal() {
    try {
      write_report(in, folder / "report.html");
    } catch (const InputError& error) {
      EXPECT_FALSE(std::filesystem::exists(folder / "report.html"));
      return error.what();
    }
    return "accepted";
  }

  std::filesystem::path folder;
  ReportInputs in;
};

// Every tag that is opened is closed, in order. Returns what is wrong, or nothing.
std::string unbalanced(const std::string& html) {
  const std::set<std::string> empty{"meta", "!DOCTYPE", "br", "hr"};
  std::vector<std::string> open;
  const std::regex tag("<(/?)([A-Za-z!][A-Za-z0-9]*)((?:\"[^\"]*\"|'[^']*'|[^'\">])*?)(/?)>");
  std::string body = html;
  const std::size_t style = body.find("<style>");
  body.erase(style, body.find("</style>") + 8 - style);
  std::size_t found = 0;
  for (std::sregex_iterator it(body.begin(), body.end(), tag), end; it != end; ++it, ++found) {
    const std::string name = (*it)[2];
    if (empty.contains(name) || (*it)[4] == "/") continue;
    if ((*it)[1] != "/") {
      open.push_back(name);
    } else {
      if (open.empty() || open.back() != name)
        return fmt::format("</{}> closes <{}>", name, open.empty() ? "nothing" : open.back());
      open.pop_back();
    }
  }
  if (!open.empty()) return fmt::format("<{}> is never closed", open.back());
  if (found != static_cast<std::size_t>(std::count(body.begin(), body.end(), '<')))
    return "a < that opens no tag";
  return "";
}

TEST_F(Report, IsSelfContainedAndWellFormed) {
  const std::string html = page();
  EXPECT_EQ(unbalanced(html), "");
  // Nothing is loaded: no address, no link, script, image, import or url().
  for (const char* forbidden :
       {"http:", "https:", "<link", "<script", "<img", "<iframe", "@import", "url(", "src="})
    EXPECT_EQ(html.find(forbidden), std::string::npos) << forbidden;
  EXPECT_EQ(html.find("{{"), std::string::npos);
  // References inside the page resolve, and ids are unique.
  std::set<std::string> ids;
  const std::regex id("\\sid=[\"']([^\"']+)[\"']");
  for (std::sregex_iterator it(html.begin(), html.end(), id), end; it != end; ++it)
    EXPECT_TRUE(ids.insert((*it)[1]).second) << "twice: " << (*it)[1];
  const std::regex reference("href=[\"']#([^\"']+)[\"']");
  std::size_t references = 0;
  for (std::sregex_iterator it(html.begin(), html.end(), reference), end; it != end; ++it, ++references)
    EXPECT_TRUE(ids.contains((*it)[1])) << "nowhere: " << (*it)[1];
  EXPECT_GT(references, 10u);
}

TEST_F(Report, ShowsTheFittedNumbersAndTheirSources) {
  const std::string html = page();
  EXPECT_NE(html.find(escape_html(in.fit.verdict)), std::string::npos);
  for (const Estimate& e : in.fit.friction.parameters) {
    const int decimals = 1 - static_cast<int>(std::floor(std::log10(e.standard_error)));
    EXPECT_NE(html.find(fmt::format("<td class=\"n\">{:.{}f}</td>", e.value, decimals)), std::string::npos)
        << e.name;
  }
  EXPECT_NE(html.find(sha256_of_file(folder / "observables.h5")), std::string::npos);
  EXPECT_NE(html.find("the cell lost 2 grains"), std::string::npos);
  EXPECT_NE(html.find("Jop, Forterre and Pouliquen"), std::string::npos);
  EXPECT_NE(html.find("Run-out"), std::string::npos);
  EXPECT_NE(html.find("<td class=\"n\">1.260</td>"), std::string::npos);  // 1.2 * 1.05, without dilation
  // Two steady laws, their residuals, the profiles, three views of the transients, deposit, two flows over
  // time, front, height.
  std::size_t figures = 0;
  for (std::size_t at = html.find("<svg"); at != std::string::npos; at = html.find("<svg", at + 1)) ++figures;
  EXPECT_EQ(figures, 12u);
}

TEST_F(Report, TextsFromOutsideAreEscaped) {
  in.title = "<script>alert('a & b')</script>";
  in.flows[0].label = "it's \"50 %\" <b>`rm`</b> & more";
  in.fit.excluded[0].reason = "a < b && c";
  in.steps[0].what = "{{title}} <i>";
  const std::string html = page();
  EXPECT_EQ(unbalanced(html), "");
  EXPECT_EQ(html.find("<script"), std::string::npos);
  EXPECT_EQ(html.find("<b>"), std::string::npos);
  EXPECT_NE(html.find("&lt;script&gt;alert(&#39;a &amp; b&#39;)&lt;/script&gt;"), std::string::npos);
  EXPECT_NE(html.find("a &lt; b &amp;&amp; c"), std::string::npos);
  EXPECT_NE(html.find("{{title}} &lt;i&gt;"), std::string::npos);  // not filled in again
  EXPECT_EQ(escape_html(std::string("a\x01"
                                    "b\n")),
            "ab\n");
}

TEST_F(Report, MissingPartsAreInputErrors) {
  const nlohmann::json whole = summary(1);
  for (const char* key : {"series", "profiles", "wall_seconds", "cpu_seconds", "particles", "steps",
                          "particle_steps_per_second", "formulation", "composition", "initial"}) {
    nlohmann::json j = whole;
    j.erase(key);
    write("with.json", j.dump());
    EXPECT_NE(refusal().find(fmt::format("with.json: lacks \"{}\"", key)), std::string::npos) << refusal();
  }
  for (const char* key : {"time", "front_99", "centre_height", "kinetic_energy", "max_speed"}) {
    nlohmann::json j = whole;
    j["series"].erase(key);
    write("with.json", j.dump());
    EXPECT_NE(refusal().find(key), std::string::npos) << refusal();
    j = whole;
    j["series"][key].erase(0);
    write("with.json", j.dump());
    EXPECT_NE(refusal().find("different lengths"), std::string::npos) << refusal();
  }
  nlohmann::json j = whole;
  j["profiles"][2]["height"][3] = nullptr;
  write("with.json", j.dump());
  EXPECT_NE(refusal().find("something else than numbers"), std::string::npos) << refusal();
  write("with.json", "{\"series\": ");
  EXPECT_NE(refusal().find("not valid JSON"), std::string::npos) << refusal();
  std::filesystem::remove(folder / "with.json");
  EXPECT_NE(refusal().find("cannot open"), std::string::npos) << refusal();
  write("with.json", whole.dump());
  in.steps[0].files = {folder / "gone.h5"};
  EXPECT_NE(refusal().find("gone.h5"), std::string::npos) << refusal();
}

TEST_F(Report, WorksWithoutStartUpsAndFlows) {
  in.observables = {synthetic::observables({}, 4, 12, 1e-3, 0.9, 0)};
  in.fit = fit_law(in.observables);
  in.flows.clear();
  const std::string html = page();
  EXPECT_EQ(unbalanced(html), "");
  EXPECT_NE(html.find("No transients were fitted"), std::string::npos);
  EXPECT_NE(html.find("No flow was run"), std::string::npos);
}

TEST_F(Report, GnuplotsComplaintIsHandedOn) {
  try {
    render_svg("bad", "plot nonsense(x)\n", 100, 100);
    FAIL() << "a wrong script was accepted";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("nonsense"), std::string::npos) << error.what();
  }
}

TEST_F(Report, WithoutGnuplotTheErrorSaysSo) {
  const std::string path = std::getenv("PATH");
  ASSERT_EQ(::setenv("PATH", folder.c_str(), 1), 0);
  std::string message;
  try {
    write_report(in, folder / "report.html");
  } catch (const Error& error) {
    message = error.what();
  }
  ASSERT_EQ(::setenv("PATH", path.c_str(), 1), 0);
  EXPECT_NE(message.find("gnuplot is not installed"), std::string::npos) << message;
}

}  // namespace
}  // namespace dem2sph
