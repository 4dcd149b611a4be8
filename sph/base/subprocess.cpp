#include "sph/base/subprocess.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <sstream>
#include <thread>

#include "sph/base/errors.hpp"
#include "sph/base/progress.hpp"

namespace dem2sph {
namespace {

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

double seconds(const timeval& t) {
  return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
}

/// The child was ended by SIGINT or SIGTERM, or says so in the way of a shell.
bool ended_by_stop(int status) {
  if (WIFSIGNALED(status)) return WTERMSIG(status) == SIGTERM || WTERMSIG(status) == SIGINT;
  return WIFEXITED(status) && (WEXITSTATUS(status) == 128 + SIGTERM || WEXITSTATUS(status) == 128 + SIGINT);
}

}  // namespace

bool program_exists(const std::string& program) {
  const auto executable = [](const std::string& path) {
    std::error_code ignored;  // what cannot be looked at cannot be run
    return std::filesystem::is_regular_file(path, ignored) && ::access(path.c_str(), X_OK) == 0;
  };
  if (program.find('/') != std::string::npos) return executable(program);
  const char* path = std::getenv("PATH");
  std::stringstream folders(path != nullptr ? path : "/usr/bin:/bin");
  for (std::string folder; std::getline(folders, folder, ':');)
    if (executable(folder + "/" + program)) return true;
  return false;
}

SubprocessResult run_subprocess(const std::vector<std::string>& arguments, const SubprocessOptions& options) {
  SubprocessResult result;
  if (!program_exists(arguments.at(0))) return result;

  // Everything that allocates is made ready before the fork: the child may only call what is safe after it.
  std::vector<char*> argv;
  for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
  argv.push_back(nullptr);
  // A relative program is meant from our folder, not from the child's.
  const std::string program = arguments[0].find('/') == std::string::npos
                                  ? arguments[0]
                                  : std::filesystem::absolute(arguments[0]).string();
  std::vector<std::string> environment;
  for (char** e = environ; *e != nullptr; ++e) {
    const std::string_view entry(*e);
    if (!options.environment.contains(std::string(entry.substr(0, entry.find('=')))))
      environment.emplace_back(entry);
  }
  for (const auto& [key, value] : options.environment) environment.push_back(key + "=" + value);
  std::vector<char*> envp;
  for (std::string& e : environment) envp.push_back(e.data());
  envp.push_back(nullptr);
  const std::string output =
      options.output.empty() ? "/dev/null" : std::filesystem::absolute(options.output).string();
  const std::string folder = options.folder.string();
  if (!std::filesystem::is_directory(options.folder))
    throw Error(ExitCode::bug, fmt::format("{}: no such folder to run {} in", folder, arguments[0]));

  int input[2] = {-1, -1};
  if (!options.input.empty() && ::pipe2(input, O_CLOEXEC) != 0)
    throw Error(ExitCode::bug, fmt::format("cannot make a pipe: {}", std::strerror(errno)));

  const auto start = std::chrono::steady_clock::now();
  // Our own handlers would swallow a stop that reaches the child before it has become another program.
  sigset_t stops;
  sigset_t before;
  sigemptyset(&stops);
  sigaddset(&stops, SIGINT);
  sigaddset(&stops, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &stops, &before);
  const pid_t child = ::fork();
  const int fork_error = errno;
  if (child == 0) {
    ::signal(SIGINT, SIG_DFL);
    ::signal(SIGTERM, SIG_DFL);
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  if (child < 0) throw Error(ExitCode::bug, fmt::format("cannot fork: {}", std::strerror(fork_error)));
  if (child == 0) {
    ::setpgid(0, 0);
    // If we are killed outright, the child must not write on into a folder that another process takes over.
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    const int in = options.input.empty() ? ::open("/dev/null", O_RDONLY) : input[0];
    const int out = ::open(output.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    if (in < 0 || out < 0 || ::dup2(in, 0) < 0 || ::dup2(out, 1) < 0 || ::dup2(out, 2) < 0 ||
        ::chdir(folder.c_str()) != 0)
      ::_exit(126);
    if (options.memory_limit > 0) {
      const rlimit limit{options.memory_limit, options.memory_limit};
      ::setrlimit(RLIMIT_AS, &limit);
    }
    ::execvpe(program.c_str(), argv.data(), envp.data());
    ::_exit(127);
  }
  ::setpgid(child, child);
  result.found = true;
  std::thread feeder;
  if (!options.input.empty()) {
    ::close(input[0]);
    feeder = std::thread([&] {
      // The child may end before it has read everything: then the pipe breaks, which is its own affair.
      sigset_t pipe_signal;
      sigemptyset(&pipe_signal);
      sigaddset(&pipe_signal, SIGPIPE);
      pthread_sigmask(SIG_BLOCK, &pipe_signal, nullptr);
      std::string_view rest = options.input;
      while (!rest.empty()) {
        const ssize_t done = ::write(input[1], rest.data(), rest.size());
        if (done < 0 && errno != EINTR) break;
        if (done > 0) rest.remove_prefix(static_cast<std::size_t>(done));
      }
      ::close(input[1]);
    });
  }

  int status = 0;
  rusage usage{};
  double asked_to_end = -1;
  auto pause = std::chrono::milliseconds(1);
  while (true) {
    const pid_t done = ::wait4(child, &status, WNOHANG, &usage);
    if (done == child) break;
    if (done < 0 && errno != EINTR)
      throw Error(ExitCode::bug, fmt::format("cannot wait for {}: {}", arguments[0], std::strerror(errno)));
    const double now = seconds_since(start);
    if (asked_to_end < 0) {
      result.timed_out = options.time_limit > 0 && now > options.time_limit;
      result.stopped = !result.timed_out && stop_requested();
      if (result.timed_out || result.stopped) {
        ::kill(-child, SIGTERM);
        asked_to_end = now;
      }
    } else if (now > asked_to_end + 2) {
      ::kill(-child, SIGKILL);
    }
    std::this_thread::sleep_for(pause);
    pause = std::min(2 * pause, std::chrono::milliseconds(50));
  }
  if (asked_to_end >= 0) ::kill(-child, SIGKILL);  // what the child itself had started and left behind
  // Whoever stopped the child may be stopping every process there is, and our turn comes a moment later.
  if (asked_to_end < 0 && ended_by_stop(status)) stop_follows();
  // A child that broke down while we are asked to stop says nothing about its work.
  const bool clean = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  if (!result.timed_out && !clean && stop_requested()) result.stopped = true;
  if (feeder.joinable()) feeder.join();
  result.wall_seconds = seconds_since(start);
  result.cpu_seconds = seconds(usage.ru_utime) + seconds(usage.ru_stime);
  if (WIFEXITED(status)) result.exit_code = WEXITSTATUS(status);
  if (WIFSIGNALED(status)) result.signal = WTERMSIG(status);
  return result;
}

}  // namespace dem2sph
