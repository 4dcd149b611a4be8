// Child processes: how they ended is told apart, and what they are given arrives unchanged.
#include <gtest/gtest.h>
#include <unistd.h>

#include <csignal>
#include <vector>

#include "sph/base/progress.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using Subprocess = test::Scratch;

TEST_F(Subprocess, ExitCodes) {
  EXPECT_TRUE(run_subprocess({"true"}).ok());
  const SubprocessResult failed = run_subprocess({"sh", "-c", "exit 42"});
  EXPECT_TRUE(failed.found);
  EXPECT_EQ(failed.exit_code, 42);
  EXPECT_EQ(failed.signal, 0);
  EXPECT_FALSE(failed.ok());
}

TEST_F(Subprocess, SignalsAreNotExitCodes) {
  const SubprocessResult killed = run_subprocess({"sh", "-c", "kill -SEGV $$"});
  EXPECT_EQ(killed.signal, SIGSEGV);
  EXPECT_EQ(killed.exit_code, -1);
  EXPECT_FALSE(killed.timed_out);
  EXPECT_FALSE(killed.ok());
}

TEST_F(Subprocess, AMissingProgramIsNotFound) {
  for (const char* program : {"no_such_program_of_dem2sph", "./none", "/no/such/program"}) {
    const SubprocessResult result = run_subprocess({program, "--version"});
    EXPECT_FALSE(result.found) << program;
    EXPECT_FALSE(result.ok());
    EXPECT_FALSE(program_exists(program));
  }
  EXPECT_TRUE(program_exists("sh"));
  EXPECT_TRUE(program_exists("/bin/sh"));
  EXPECT_FALSE(program_exists(folder_.string())) << "a folder may be searched, but is no program";
  test::put(in("plain"), "text");
  EXPECT_FALSE(program_exists(in("plain").string())) << "a file without the right to execute";
}

TEST_F(Subprocess, ARelativeProgramIsMeantFromOurFolder) {
  test::put(in("hello"), "#!/bin/sh\npwd\n");
  std::filesystem::permissions(in("hello"), std::filesystem::perms::owner_all);
  std::filesystem::create_directory(in("elsewhere"));
  SubprocessOptions options;
  options.folder = in("elsewhere");
  options.output = in("out");
  const auto relative = std::filesystem::relative(in("hello"));
  ASSERT_TRUE(run_subprocess({(std::filesystem::path(".") / relative).string()}, options).ok());
  EXPECT_EQ(test::content_of(in("out")), std::filesystem::canonical(in("elsewhere")).string() + "\n");
}

TEST_F(Subprocess, AMissingFolderIsAnError) {
  SubprocessOptions options;
  options.folder = in("none");
  EXPECT_CONTAINS(test::message_of<Error>([&] { run_subprocess({"true"}, options); }), in("none").string());
}

TEST_F(Subprocess, ArgumentsPassUnchanged) {
  const std::vector<std::string> arguments{
      "two words", "\"double\" 'single'", "$HOME `id` $(id)", "a\\b", "*",
      "",          "line\nbreak",         "; rm x | y > z",   "-n",   "d\xc3\xa9j\xc3\xa0"};
  std::vector<std::string> all{"printf", "[%s]"};
  all.insert(all.end(), arguments.begin(), arguments.end());
  SubprocessOptions options;
  options.output = in("out file");
  ASSERT_TRUE(run_subprocess(all, options).ok());
  std::string expected;
  for (const std::string& a : arguments) expected += "[" + a + "]";
  EXPECT_EQ(test::content_of(in("out file")), expected);
}

TEST_F(Subprocess, OutputHoldsBothStreams) {
  SubprocessOptions options;
  options.output = in("log");
  test::put(in("log"), "what an earlier run had written, which is longer");
  ASSERT_TRUE(run_subprocess({"sh", "-c", "echo out; echo err >&2"}, options).ok());
  EXPECT_EQ(test::content_of(in("log")), "out\nerr\n");
}

TEST_F(Subprocess, TextGoesToStdin) {
  SubprocessOptions options;
  options.output = in("out");
  options.input = std::string(300000, 'x') + "end";  // more than the 64 KiB that a pipe holds
  ASSERT_TRUE(run_subprocess({"cat"}, options).ok());
  EXPECT_EQ(test::content_of(in("out")), options.input);
  // A child that does not read it is no reason to fail or to hang.
  EXPECT_TRUE(run_subprocess({"true"}, options).ok());
  // Without text, stdin is empty.
  options.input.clear();
  ASSERT_TRUE(run_subprocess({"cat"}, options).ok());
  EXPECT_EQ(test::content_of(in("out")), "");
}

TEST_F(Subprocess, EnvironmentIsSetOnTopOfOurs) {
  ASSERT_EQ(::setenv("DEM2SPH_TEST_KEPT", "kept", 1), 0);
  ASSERT_EQ(::setenv("DEM2SPH_TEST_CHANGED", "before", 1), 0);
  SubprocessOptions options;
  options.output = in("out");
  options.environment = {{"DEM2SPH_TEST_CHANGED", "after = a"}, {"DEM2SPH_TEST_NEW", "new"}};
  const char* script =
      "echo $DEM2SPH_TEST_KEPT/$DEM2SPH_TEST_CHANGED/$DEM2SPH_TEST_NEW; env | grep -c DEM2SPH_TEST_CHANGED";
  ASSERT_TRUE(run_subprocess({"sh", "-c", script}, options).ok());
  EXPECT_EQ(test::content_of(in("out")), "kept/after = a/new\n1\n");
  EXPECT_STREQ(std::getenv("DEM2SPH_TEST_CHANGED"), "before");
}

TEST_F(Subprocess, TheTimeLimitEndsTheWholeGroup) {
  SubprocessOptions options;
  options.time_limit = 0.3;
  options.output = in("out");
  // The child ends on SIGTERM; the grandchild ignores it and must go all the same.
  const char* script = "(trap '' TERM; echo $(sh -c 'echo $PPID'); sleep 30; echo late) & sleep 0.1; wait";
  const SubprocessResult result = run_subprocess({"sh", "-c", script}, options);
  EXPECT_TRUE(result.timed_out);
  EXPECT_FALSE(result.ok());
  EXPECT_EQ(result.signal, SIGTERM);
  // Limit, polling of 50 ms, and slack for a busy machine; the 2 s of grace are not used.
  EXPECT_GE(result.wall_seconds, 0.3);
  EXPECT_LT(result.wall_seconds, 2.0);
  const pid_t grandchild = static_cast<pid_t>(std::stol(test::content_of(in("out"))));
  ASSERT_GT(grandchild, 1);
  // Dead, or a zombie that nobody has buried yet: not sleeping.
  std::string state = "gone";
  for (int i = 0; i < 100; ++i) {
    std::ifstream stat("/proc/" + std::to_string(grandchild) + "/stat");
    std::string pid, name;
    state = "gone";
    if (!(stat >> pid >> name >> state)) state = "gone";
    if (state == "gone" || state == "Z" || state == "X") break;
    ::usleep(20000);
  }
  EXPECT_TRUE(state == "gone" || state == "Z" || state == "X") << state;
}

TEST_F(Subprocess, AChildThatIgnoresSigtermIsKilledAfterTwoSeconds) {
  SubprocessOptions options;
  options.time_limit = 0.2;
  const SubprocessResult result =
      run_subprocess({"sh", "-c", "trap '' TERM; while :; do sleep 0.05; done"}, options);
  EXPECT_TRUE(result.timed_out);
  EXPECT_EQ(result.signal, SIGKILL);
  EXPECT_GE(result.wall_seconds, 2.2);
  EXPECT_LT(result.wall_seconds, 5.0);  // slack for a busy machine
}

TEST_F(Subprocess, TheMemoryLimitHolds) {
  // tail has to keep the last line, which has no end here: without a limit it would take all memory.
  SubprocessOptions options;
  options.memory_limit = 64u << 20;
  options.output = in("out");
  options.time_limit = 60;
  const SubprocessResult result = run_subprocess({"tail", "/dev/zero"}, options);
  EXPECT_TRUE(result.found);
  EXPECT_FALSE(result.timed_out);
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_CONTAINS(test::content_of(in("out")), "memory");
}

TEST_F(Subprocess, CpuTimeIsTheChilds) {
  const SubprocessResult idle = run_subprocess({"sleep", "0.2"});
  EXPECT_GE(idle.wall_seconds, 0.2);
  EXPECT_LT(idle.cpu_seconds, 0.1);
  const SubprocessResult busy =
      run_subprocess({"sh", "-c", "i=0; while [ $i -lt 100000 ]; do i=$((i+1)); done"});
  EXPECT_GT(busy.cpu_seconds, 0.01);                      // 100 000 turns of a shell loop at 100 ns or more
  EXPECT_LE(busy.cpu_seconds, busy.wall_seconds + 0.05);  // one process; ticks of the clock
}

TEST(SubprocessStop, AStopRequestEndsTheChild) {
  // In a process of its own: the request cannot be taken back. It ends on SIGTERM at once, before the 2 s of
  // grace.
  EXPECT_EXIT(
      {
        install_stop_handlers();
        ::raise(SIGINT);
        const SubprocessResult result = run_subprocess({"sleep", "30"});
        std::_Exit(result.stopped && !result.timed_out && !result.ok() && result.wall_seconds < 1.5 ? 0 : 1);
      },
      testing::ExitedWithCode(0), "");
}

}  // namespace
}  // namespace dem2sph
