// Errors with the exit code that the program ends with. Every message says what, where and what to do.
#pragma once

#include <stdexcept>
#include <string>

namespace dem2sph {

/// Exit codes of the `dem2sph` program: a contract that scripts depend on.
enum class ExitCode : int {
  ok = 0,
  bug = 1,               ///< our own mistake
  usage = 2,             ///< command line or case file
  unreadable = 3,        ///< an input file that is missing, truncated or of another kind
  engine = 4,            ///< LIGGGHTS is missing or failed
  numerical = 5,         ///< the solver had to stop
  not_identifiable = 6,  ///< the data do not determine the law, or the fit did not converge
  bar_missed = 7,        ///< a validation bar was missed
  interrupted = 75       ///< stopped on request; the same command resumes
};

/// Base of every error that dem2sph raises on purpose.
class Error : public std::runtime_error {
 public:
  Error(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
  ExitCode code() const noexcept { return code_; }

 private:
  ExitCode code_;
};

/// Wrong command line or case file. The message starts with `file:line:` where there is one.
struct UsageError : Error {
  explicit UsageError(const std::string& message) : Error(ExitCode::usage, message) {}
};
/// An input file cannot be read.
struct InputError : Error {
  explicit InputError(const std::string& message) : Error(ExitCode::unreadable, message) {}
};
/// LIGGGHTS is missing or a run of it failed.
struct EngineError : Error {
  explicit EngineError(const std::string& message) : Error(ExitCode::engine, message) {}
};
/// The numerics broke down; the message names particle, step and term where it can.
struct NumericalError : Error {
  explicit NumericalError(const std::string& message) : Error(ExitCode::numerical, message) {}
};
/// A fit that did not converge, or data that leave a parameter open.
struct IdentifiabilityError : Error {
  explicit IdentifiabilityError(const std::string& message) : Error(ExitCode::not_identifiable, message) {}
};
/// A stop was asked for (SIGINT, SIGTERM); what was done is kept.
struct Interrupted : Error {
  explicit Interrupted(const std::string& message) : Error(ExitCode::interrupted, message) {}
};

}  // namespace dem2sph
