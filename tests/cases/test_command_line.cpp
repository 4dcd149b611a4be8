// The program as scripts see it: exit codes, messages, files. Examples of cases/ run, shortened by --set.
#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "sph/base/frame.hpp"
#include "sph/base/provenance.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/cases/program.hpp"

namespace dem2sph {
namespace {

namespace fs = std::filesystem;

class CommandLine : public test::Program {
 protected:
  static std::string content(const fs::path& path) { return test::content_of(path); }
  std::string in(const std::string& name) const { return (folder_ / name).string(); }
  void expect(const Outcome& outcome, int code, const std::string& text) const {
    EXPECT_EQ(outcome.code, code) << outcome.text;
    EXPECT_NE(outcome.text.find(text), std::string::npos)
        << "expected: " << text << "\nprinted: " << outcome.text;
  }
  static std::string example(const std::string& name) { return DEM2SPH_CASES "/" + name + "/case.toml"; }
  /// The inclined plane, small and short.
  std::vector<std::string> short_incline(const std::string& output) const {
    return {"flow",  example("inclined_plane"), "-o",    in(output),     "--set", "flow.resolution=8",
            "--set", "flow.end_time=0.05 s",    "--set", "flow.frames=3"};
  }
};

TEST_F(CommandLine, WrongKeyIsCode2WithLineAndSuggestion) {
  std::ofstream(in("case.toml"))
      << "[flow]\nscene = \"column_collapse\"\nresolutoin = 20\n[column]\nlength = \"1 m\"\n";
  expect(run({"plan", in("case.toml")}), 2,
         "case.toml:3: [flow] unknown key \"resolutoin\"; did you mean \"resolution\"?");
}

TEST_F(CommandLine, WrongUnitIsCode2) {
  std::ofstream(in("case.toml")) << "[flow]\nscene = \"column_collapse\"\n[column]\nlength = \"1 kg\"\n";
  expect(run({"plan", in("case.toml")}), 2,
         "case.toml:4: [column] \"length\": \"1 kg\" is kg, but m is expected");
  std::ofstream(in("case.toml")) << "[flow]\nscene = \"column_collapse\"\n[column]\nlength = 1\n";
  expect(run({"plan", in("case.toml")}), 2, "\"length\" needs a unit");
}

TEST_F(CommandLine, UsageErrorsAreCode2) {
  EXPECT_EQ(run({}).code, 2);
  EXPECT_EQ(run({"flwo"}).code, 2);
  EXPECT_EQ(run({"flow", example("inclined_plane")}).code, 2);  // no -o
  expect(run({"sweep"}), 2, "sweep needs a CASE");
  expect(run({"flow", example("column_collapse"), "-o", in("out")}), 2, "no material law");
}

TEST_F(CommandLine, MissingLiggghtsIsCode4) {
  expect(run({"sweep", example("shear_cell"), "-o", in("out")}, {{"DEM2SPH_LIGGGHTS", "no_such_liggghts"}}),
         4, "apt-get install");
}

TEST_F(CommandLine, TruncatedObservablesAreCode3) {
  std::ofstream(in("observables.h5"), std::ios::binary) << "\x89HDF\r\n\x1a\n and then nothing";
  expect(run({"fit", in("observables.h5"), "-o", in("law.json")}), 3, "observables.h5");
  expect(run({"fit", in("absent.h5"), "-o", in("law.json")}), 3, "absent.h5");
  EXPECT_FALSE(fs::exists(in("law.json")));
}

TEST_F(CommandLine, BrokenLawIsCode3) {
  std::ofstream(in("law.json")) << "{\"format\": \"dem2sph-law\"";
  expect(run({"flow", example("column_collapse"), "--law", in("law.json"), "-o", in("out")}), 3, "law.json");
}

TEST_F(CommandLine, HelpAndVersionAreCode0) {
  expect(run({"--help"}), 0, "Examples:");
  expect(run({"--version"}), 0, "dem2sph");
  for (const char* command : {"init", "plan", "sweep", "fit", "flow", "run", "report", "export"})
    expect(run({command, "--help"}), 0, command);
}

TEST_F(CommandLine, InitGivesACaseThatPlans) {
  expect(run({"init", in("mine")}), 0, "case.toml");
  expect(run({"plan", in("mine/case.toml")}), 0, "shear-cell runs");
  expect(run({"init", in("mine")}), 2, "--force");
}

TEST_F(CommandLine, ExamplesPlan) {
  for (const char* name : {"shear_cell", "column_collapse", "inclined_plane"})
    EXPECT_EQ(run({"plan", example(name)}).code, 0) << name;
}

TEST_F(CommandLine, FlowWritesWhatItPromises) {
  expect(run(short_incline("out")), 0, "end time reached");
  const nlohmann::json summary = read_json(in("out/summary.json"));
  for (const char* key :
       {"wall_seconds", "cpu_seconds", "steps", "particles", "threads", "particle_steps_per_second",
        "pairs_per_second", "bytes_per_particle", "dt", "dt_bounds", "budgets", "series", "formulation",
        "composition", "law_sha256", "case_sha256", "provenance", "particles_lost"})
    EXPECT_TRUE(summary.contains(key)) << key;
  for (const char* key : {"front_99", "centre_height", "kinetic_energy", "max_speed"})
    EXPECT_EQ(summary.at("series").at(key).size(), summary.at("series").at("time").size()) << key;
  for (int k = 0; k < 4; ++k) {
    const Frame frame = read_frame(in("out/frames/frame_0000" + std::to_string(k) + ".h5"));
    EXPECT_NEAR(frame.time, 0.05 * k / 3, 1e-9);
    for (const char* field : {"x", "v", "rho", "p", "stress", "gamma_dot", "mu", "id", "kind"})
      EXPECT_TRUE(frame.has(field)) << field;
    EXPECT_FALSE(frame.has("beta")) << "no dilation, no column";
  }
  EXPECT_TRUE(summary.at("dt").at("min").is_number()) << summary.at("dt");
  EXPECT_GT(summary.at("dt_bounds").at("sound").get<long>(), 0);
  EXPECT_EQ(summary.at("law_sha256").get<std::string>().size(), 64u);
  EXPECT_TRUE(summary.at("incline").at("slip").is_number());
  // Results are not overwritten unless told to, and even then only what a flow has written itself.
  std::ofstream(in("out/frames/mine.png")) << "a picture";
  expect(run(short_incline("out")), 2, "--force");
  std::vector<std::string> forced = short_incline("out");
  forced.push_back("--force");
  expect(run(forced), 0, "end time reached");
  EXPECT_TRUE(fs::exists(in("out/frames/mine.png")));
}

TEST_F(CommandLine, ACpuWithoutAvx2GetsTheSameFlow) {
  // The loader is told that the CPU has no AVX2: it then takes the solver for any x86-64.
  const std::map<std::string, std::string> plain{{"GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX2"}};
  std::map<std::string, std::string> watched = plain;
  watched["LD_DEBUG"] = "libs";
  const Outcome loaded = run({"--version"}, watched);
  EXPECT_EQ(loaded.code, 0);
  const std::size_t at = loaded.text.find("libdem2sph_solver.so", loaded.text.find("calling init"));
  ASSERT_NE(at, std::string::npos) << loaded.text;
  const std::size_t line = loaded.text.rfind('\n', at);
  EXPECT_EQ(loaded.text.substr(line, at - line).find("glibc-hwcaps"), std::string::npos);
  expect(run(short_incline("fast")), 0, "end time reached");
  expect(run(short_incline("plain"), plain), 0, "end time reached");
  const nlohmann::json fast = read_json(in("fast/summary.json")), slow = read_json(in("plain/summary.json"));
  EXPECT_EQ(fast.at("steps"), slow.at("steps"));
  // They differ by rounding, which some hundred steps of a slow flow hardly amplify.
  const double energy = slow.at("series").at("kinetic_energy").back().get<double>();
  EXPECT_NEAR(fast.at("series").at("kinetic_energy").back().get<double>(), energy, 1e-9 * energy);
}

TEST_F(CommandLine, EveryFrameOpensInParaView) {
  if (!program_exists("pvpython"))
    GTEST_SKIP() << "pvpython is not installed: packages paraview and python3-paraview";
  expect(run(short_incline("out")), 0, "end time reached");
  SubprocessOptions options;
  options.output = in("paraview.txt");
  options.time_limit = 200;
  ASSERT_TRUE(run_subprocess({"pvpython", DEM2SPH_READ_SERIES, in("out/frames.pvd"), "p"}, options).ok());
  std::istringstream lines(content(in("paraview.txt")));
  int frames = 0;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string kind, time;
    std::size_t points = 0;
    words >> kind >> time >> points;
    if (kind != "seen") continue;
    const Frame frame = read_frame(in("out/frames/frame_0000" + std::to_string(frames) + ".h5"));
    EXPECT_EQ(std::stod(time), frame.time);
    EXPECT_EQ(points, frame.size());
    ++frames;
  }
  EXPECT_EQ(frames, 4) << content(in("paraview.txt"));
}

TEST_F(CommandLine, ExportWritesColumnsWithUnits) {
  expect(run(short_incline("out")), 0, "end time reached");
  expect(run({"export", in("out/frames/frame_00003.h5"), "--fields", "x,p", "-o", in("frame.csv")}), 0, "");
  std::istringstream lines(content(in("frame.csv")));
  std::string line;
  std::getline(lines, line);
  EXPECT_EQ(line.substr(0, 6), "# t = ");
  std::getline(lines, line);
  EXPECT_EQ(line, "x_0 [m],x_1 [m],x_2 [m],p [Pa]");
  std::size_t rows = 0;
  while (std::getline(lines, line)) ++rows;
  EXPECT_EQ(rows, read_frame(in("out/frames/frame_00003.h5")).size());
  expect(run({"export", in("out/frames/frame_00003.h5"), "--fields", "y", "-o", in("other.csv")}), 3,
         "no field \"y\"");
}

TEST_F(CommandLine, AStoppedFlowResumesToTheSameEnd) {
  std::vector<std::string> arguments = short_incline("whole");
  arguments[5] = "flow.resolution=16";
  arguments[7] = "flow.end_time=0.8 s";
  expect(run(arguments), 0, "end time reached");
  arguments[3] = in("stopped");
  // SIGTERM 0.2 s after the program has begun to watch for it (a loaded machine may take long to start it),
  // again and again until it is through: each part ends with code 75.
  const std::string stop_it = R"sh("$@" & pid=$!
    until caught=$(sed -n 's/^SigCgt:[[:space:]]*//p' /proc/$pid/status 2>/dev/null) &&
          [ "$(cat /proc/$pid/comm 2>/dev/null)" = dem2sph ] && (( 0x${caught:-0} & 0x4000 )); do
      kill -0 $pid 2>/dev/null || break
      sleep 0.01
    done
    sleep 0.2
    kill -TERM $pid 2>/dev/null
    wait $pid)sh";
  int interruptions = 0;
  while (true) {
    std::vector<std::string> timed{"bash", "-c", stop_it, "stop_it", DEM2SPH_PROGRAM};
    timed.insert(timed.end(), arguments.begin(), arguments.end());
    SubprocessOptions options;
    options.output = in("output.txt");
    options.environment["OMP_NUM_THREADS"] = "1";
    const SubprocessResult result = run_subprocess(timed, options);
    if (result.exit_code == 0) break;
    ASSERT_EQ(result.exit_code, 75) << content(in("output.txt"));
    ASSERT_TRUE(fs::exists(in("stopped/checkpoint.h5")));
    ASSERT_LT(++interruptions, 100);
    // A checkpoint that was cut short: the one before it is taken, and said.
    if (interruptions == 2) {
      ASSERT_TRUE(fs::exists(in("stopped/checkpoint.previous.h5")));
      fs::resize_file(in("stopped/checkpoint.h5"), fs::file_size(in("stopped/checkpoint.h5")) / 2);
    }
    if (interruptions == 3) {
      EXPECT_NE(content(in("output.txt")).find("going back to"), std::string::npos);
    }
  }
  EXPECT_GT(interruptions, 2) << "the flow was over before the third signal: make it longer";
  const nlohmann::json whole = read_json(in("whole/summary.json"));
  const nlohmann::json stopped = read_json(in("stopped/summary.json"));
  EXPECT_EQ(whole.at("series"), stopped.at("series"));
  EXPECT_EQ(whole.at("steps"), stopped.at("steps"));
  EXPECT_EQ(whole.at("budgets"), stopped.at("budgets"));
  EXPECT_EQ(read_frame(in("whole/frames/frame_00003.h5")).field("v").values,
            read_frame(in("stopped/frames/frame_00003.h5")).field("v").values);
}

TEST_F(CommandLine, PlanMeasuresWhatIsLeftOut) {
  const Outcome outcome = run({"plan", example("column_collapse"), "--measure", "--json", "--set",
                               "flow.resolution=20", "--set", "flow.dilation=none"});
  ASSERT_EQ(outcome.code, 0) << outcome.text;
  const nlohmann::json result = nlohmann::json::parse(outcome.text.substr(outcome.text.find('{')));
  std::map<std::string, nlohmann::json> parts;
  for (const nlohmann::json& part : result.at("left_out").at("parts"))
    parts[part.at("part").get<std::string>()] = part;
  EXPECT_EQ(parts.count("damping with its limiter"), 0u) << "the default has it";
  // Counted in instructions it is 72 % more (sph/README.md); a clock on a busy machine sees less clearly.
  EXPECT_GT(parts.at("shifting").at("cost_ratio").get<double>(), 1.1);
  EXPECT_NEAR(parts.at("shifting").at("steps_ratio").get<double>(), 1, 0.02) << "steps are as long";
  EXPECT_GT(parts.at("dilation").at("bytes_ratio").get<double>(), 1);
  // At g_min = 0.1/s the viscous bound is a hundred times below that of sound.
  EXPECT_GT(parts.at("direct stress and its viscous bound").at("steps_ratio").get<double>(), 20);
  EXPECT_GT(parts.at("the third dimension").at("cost_ratio").get<double>(), 12) << "as many layers";
}

TEST_F(CommandLine, RunRefusesBeforeTheFirstGrain) {
  const auto refused = [&](const std::string& override_text, const std::string& expected) {
    expect(run({"run", example("column_collapse"), "-o", in("out"), "--set", override_text}), 2, expected);
    EXPECT_FALSE(fs::exists(in("out/shear_cell"))) << "it had begun";
  };
  refused("flow.wall_stress_share=0.3", "changes nothing");
  refused("flow.dilation=none", "with and without dilation");
  expect(run({"plan", example("column_collapse"), "--set", "flow.beta_lowest=-0.2"}), 0, "dilation evolve");
  // Before the law is fitted: what only one of the two flows, or only a fitted law, can use.
  expect(run({"plan", example("column_collapse"), "--set", "flow.beta_share=0.65", "--set",
              "flow.extrapolate=clamp"}),
         0, "dilation evolve");
}

TEST_F(CommandLine, ErrorsAreInTheLogToo) {
  std::vector<std::string> arguments = short_incline("out");
  arguments.insert(arguments.end(), {"--set", "flow.g_min=1 1/s"});
  expect(run(arguments), 2, "dem2sph: ");
  EXPECT_CONTAINS(content(in("out/dem2sph.log")), "\"g_min\" changes nothing");
}

TEST_F(CommandLine, MisspeltFitOptionIsCode2) {
  expect(run({"fit", in("absent.h5"), "-o", in("law.json"), "--set", "fti.phi_I_max=0.3"}), 2,
         "did you mean [fit]?");
}

TEST_F(CommandLine, DryRunRunsNothing) {
  std::vector<std::string> arguments = short_incline("out");
  arguments.push_back("--dry-run");
  expect(run(arguments), 0, "particle-steps");
  EXPECT_FALSE(fs::exists(in("out")));
  expect(run({"sweep", example("shear_cell"), "-o", in("out"), "--dry-run"}), 0, "core-seconds");
  EXPECT_FALSE(fs::exists(in("out")));
}

}  // namespace
}  // namespace dem2sph
