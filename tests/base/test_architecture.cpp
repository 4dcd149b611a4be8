// Who may include whom: every arrow of the architecture points one way, and this test reads all #include
// lines.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace {

namespace fs = std::filesystem;

bool starts_with_any(std::string_view text, const std::vector<std::string_view>& list) {
  return std::any_of(list.begin(), list.end(),
                     [&](std::string_view start) { return text.starts_with(start); });
}

// Standard headers have neither a folder nor an ending: <vector>, <cmath>.
bool is_standard(const std::string& header) { return header.find_first_of("/.") == std::string::npos; }

const std::vector<std::string_view> posix{"sys/",      "unistd.h", "fcntl.h",  "signal.h",
                                          "pthread.h", "poll.h",   "dirent.h", "time.h",
                                          "spawn.h",   "stdlib.h", "stdio.h",  "string.h"};
// What base is made with, and what it hands on to everyone above it: text, JSON, the log.
const std::vector<std::string_view> text_libraries{"fmt/", "nlohmann/", "spdlog/"};

/// Why `file` (relative to the root) may not include `header`, or an empty text.
std::string objection(const std::string& file, const std::string& header) {
  if (file.starts_with("tests/") || file.starts_with("cases/"))
    return file.starts_with("tests/") && !file.starts_with("tests/cases/") && header.starts_with("cases/")
               ? "nothing includes cases/"
               : "";
  if (header.starts_with("cases/") || header.starts_with("tests/"))
    return "nothing includes cases/ or tests/";
  if (is_standard(header)) return "";

  if (file.starts_with("sph/rheology/"))
    return header.starts_with("sph/rheology/") ? "" : "rheology includes the standard library only";
  // Every dataset has a unit and every key is declared: nobody goes behind base's back.
  if (header == "hdf5.h" && file != "sph/base/hdf5_file.cpp")
    return "HDF5 is spoken in sph/base/hdf5_file.cpp only";
  if (header.starts_with("toml++/") && file != "sph/base/case_file.cpp")
    return "TOML is read in sph/base/case_file.cpp only";
  if (starts_with_any(header, {"gtest/", "rapidcheck", "benchmark/"})) return "test tools belong to tests/";
  if (header.starts_with("CLI/")) return "the command line belongs to cases/";
  if (header.starts_with("ceres/") && file != "calibration/least_squares.cpp")
    return "Ceres is seen in calibration/least_squares.cpp only";
  if (starts_with_any(header, posix)) return "";
  if (starts_with_any(header, text_libraries)) return "";

  if (file.starts_with("sph/base/"))
    return header.starts_with("sph/base/") || header == "hdf5.h" || header == "xxhash.h" ||
                   header.starts_with("toml++/")
               ? ""
               : "base includes std, POSIX, fmt, toml++, HDF5, xxHash, JSON and the log only";
  if (file.starts_with("sph/"))
    return header.starts_with("sph/") || header.starts_with("Eigen/") ||
                   starts_with_any(header, {"omp.h", "mpi.h", "zoltan"})
               ? ""
               : "the solver includes base, rheology and Eigen only";
  if (file.starts_with("dem_bridge/"))
    return starts_with_any(header, {"dem_bridge/", "sph/base/", "Eigen/"})
               ? ""
               : "dem_bridge includes base and Eigen only, never the solver";
  if (file.starts_with("calibration/")) {
    if (file == "calibration/least_squares.cpp" && starts_with_any(header, {"ceres/", "glog/"})) return "";
    return starts_with_any(header, {"calibration/", "sph/base/", "sph/rheology/", "Eigen/"}) ||
                   header == "dem_bridge/observables.hpp"
               ? ""
               : "calibration includes base, rheology, Eigen and dem_bridge/observables.hpp only";
  }
  return "a source outside the folders of the project";
}

const fs::path root = DEM2SPH_SOURCE_FOLDER;

// Files of the project, as paths relative to its root; hidden folders and whatever a build or a run made are
// left out.
std::vector<std::string> files_of_the_project() {
  std::vector<std::string> files;
  for (const char* folder : {"sph", "dem_bridge", "calibration", "cases", "tests"})
    if (fs::exists(root / folder))
      for (const auto& entry : fs::recursive_directory_iterator(root / folder))
        if (entry.is_regular_file()) files.push_back(fs::relative(entry.path(), root).string());
  for (const auto& entry : fs::directory_iterator(root))
    if (entry.is_regular_file()) files.push_back(entry.path().filename().string());
  std::sort(files.begin(), files.end());
  return files;
}

std::vector<std::string> lines_of(const std::string& file) {
  std::ifstream in(root / file);
  std::vector<std::string> lines;
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

bool ends_with_any(const std::string& file, const std::vector<std::string_view>& endings) {
  return std::any_of(endings.begin(), endings.end(), [&](std::string_view e) { return file.ends_with(e); });
}

TEST(Architecture, TheRuleItselfCanFail) {
  const std::vector<std::pair<const char*, const char*>> forbidden{
      {"sph/rheology/friction.hpp", "fmt/format.h"},
      {"sph/rheology/friction.hpp", "sph/base/errors.hpp"},
      {"sph/base/units.cpp", "sph/rheology/yield.hpp"},
      {"sph/base/units.cpp", "sph/kernel.hpp"},
      {"sph/base/units.cpp", "Eigen/Dense"},
      {"sph/base/frame.cpp", "hdf5.h"},
      {"sph/flow.cpp", "dem_bridge/deck.hpp"},
      {"sph/flow.cpp", "calibration/fit.hpp"},
      {"sph/flow.cpp", "ceres/jet.h"},
      {"sph/flow.cpp", "cases/driver.hpp"},
      {"dem_bridge/deck.cpp", "sph/kernel.hpp"},
      {"dem_bridge/deck.cpp", "sph/rheology/friction.hpp"},
      {"dem_bridge/deck.cpp", "hdf5.h"},
      {"calibration/report.cpp", "dem_bridge/deck.hpp"},
      {"calibration/report.cpp", "sph/kernel.hpp"},
      {"calibration/report.cpp", "ceres/ceres.h"},
      {"calibration/report.cpp", "glog/logging.h"},
      {"sph/kernel.hpp", "gtest/gtest.h"},
      {"tests/sph/test_kernel.cpp", "cases/driver.hpp"},
      {"sph/base/errors.hpp", "tests/base/helpers.hpp"}};
  for (const auto& [file, header] : forbidden)
    EXPECT_NE(objection(file, header), "") << file << " " << header;
  const std::vector<std::pair<const char*, const char*>> allowed{
      {"sph/rheology/yield.hpp", "cmath"},
      {"sph/rheology/yield.hpp", "sph/rheology/friction.hpp"},
      {"sph/base/hdf5_file.cpp", "hdf5.h"},
      {"sph/base/subprocess.cpp", "sys/wait.h"},
      {"sph/flow.cpp", "sph/base/frame.hpp"},
      {"sph/flow.cpp", "sph/rheology/yield.hpp"},
      {"sph/flow.cpp", "Eigen/Dense"},
      {"dem_bridge/deck.cpp", "sph/base/units.hpp"},
      {"calibration/least_squares.cpp", "ceres/ceres.h"},
      {"calibration/least_squares.cpp", "dem_bridge/observables.hpp"},
      {"cases/main.cpp", "calibration/fit.hpp"},
      {"cases/main.cpp", "CLI/CLI.hpp"},
      {"tests/cases/test_driver.cpp", "cases/driver.hpp"}};
  for (const auto& [file, header] : allowed) EXPECT_EQ(objection(file, header), "") << file << " " << header;
}

TEST(Architecture, EveryIncludePointsTheAllowedWay) {
  const std::regex include(R"(^\s*#\s*include\s*[<"]([^>"]+)[>"])");
  std::size_t seen = 0;
  for (const std::string& file : files_of_the_project()) {
    if (!ends_with_any(file, {".hpp", ".cpp", ".h", ".c", ".hpp.in"})) continue;
    const std::vector<std::string> lines = lines_of(file);
    for (std::size_t i = 0; i < lines.size(); ++i) {
      std::smatch match;
      if (!std::regex_search(lines[i], match, include)) continue;
      ++seen;
      const std::string why = objection(file, match[1]);
      EXPECT_EQ(why, "") << file << ":" << i + 1 << ": " << lines[i];
    }
  }
  EXPECT_GT(seen, 100u) << "the sources were not found in " << root;
}

// The part of a line that the tool obeys.
std::string without_comment(const std::string& line) { return line.substr(0, line.find('#')); }

TEST(Architecture, NobodyGivesUpOnNaN) {
  std::size_t seen = 0;
  for (const std::string& file : files_of_the_project()) {
    const bool build_file = ends_with_any(
        file, {"CMakeLists.txt", ".cmake", "CMakePresets.json", "CMakeUserPresets.json", ".sh"});
    const bool source = ends_with_any(file, {".hpp", ".cpp", ".h", ".c"}) && !file.starts_with("tests/");
    if (!build_file && !source) continue;
    seen += build_file ? 1 : 0;
    const std::vector<std::string> lines = lines_of(file);
    for (std::size_t i = 0; i < lines.size(); ++i) {
      const std::string text = build_file && !file.ends_with(".json") ? without_comment(lines[i]) : lines[i];
      for (const char* flag : {"fast-math", "-Ofast", "finite-math-only", "unsafe-math", "associative-math"})
        EXPECT_EQ(text.find(flag), std::string::npos) << file << ":" << i + 1 << ": " << lines[i];
    }
  }
  EXPECT_GT(seen, 3u);
}

}  // namespace
