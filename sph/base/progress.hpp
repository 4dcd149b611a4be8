// Progress of long work on stderr: a bar on a terminal, a line every few seconds elsewhere.
#pragma once

#include <chrono>
#include <string>

namespace dem2sph {

/// Reports a fraction of the work and a short text. Quiet progress prints nothing.
class Progress {
 public:
  explicit Progress(std::string title, bool quiet = false);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  /// `fraction` in [0, 1] gives the time left; `text` follows it. Prints only when it is due, so call it
  /// freely.
  void update(double fraction, const std::string& text);
  /// True if an update now would be printed: spares the cost of making its text.
  bool due() const;
  /// Prints a last line with the time taken.
  void finish(const std::string& text);

 private:
  void print(double fraction, const std::string& text);
  std::string title_;
  bool quiet_;
  bool terminal_;
  bool open_line_ = false;
  std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point last_;
};

/// SIGINT and SIGTERM set a flag that long work asks for; work then saves its state and throws Interrupted.
void install_stop_handlers();
bool stop_requested() noexcept;
/// The same, after up to half a second in which a stop that was sent to every process may still come.
bool stop_follows();

}  // namespace dem2sph
