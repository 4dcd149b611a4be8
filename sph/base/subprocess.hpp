// Runs another program by argument vector, never through a shell, in a process group of its own.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace dem2sph {

struct SubprocessOptions {
  std::filesystem::path folder = ".";                   ///< working folder of the child
  std::filesystem::path output;                         ///< where its stdout and stderr go; empty: discarded
  std::string input;                                    ///< its stdin; empty: /dev/null
  double time_limit = 0;                                ///< wall seconds; 0: none
  std::size_t memory_limit = 0;                         ///< bytes of address space; 0: none
  std::map<std::string, std::string> environment = {};  ///< set on top of our own
};

struct SubprocessResult {
  bool found = false;      ///< the program exists and was started
  int exit_code = -1;      ///< if it exited
  int signal = 0;          ///< if a signal ended it
  bool timed_out = false;  ///< we ended it at its time limit
  bool stopped = false;    ///< we ended it because a stop was requested
  double wall_seconds = 0;
  double cpu_seconds = 0;  ///< user and system, of the child and its waited-for children
  bool ok() const { return found && exit_code == 0 && signal == 0 && !timed_out && !stopped; }
};

/// Runs `arguments` (the first is the program, looked up on the PATH) and waits. At the time limit, or when
/// stop_requested(), the group gets SIGTERM and, 2 s later, SIGKILL. Throws Error(bug) if the system refuses
/// to fork.
SubprocessResult run_subprocess(const std::vector<std::string>& arguments,
                                const SubprocessOptions& options = {});

/// True if `program` is an executable, by path or on the PATH.
bool program_exists(const std::string& program);

}  // namespace dem2sph
