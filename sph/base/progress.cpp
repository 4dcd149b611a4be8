#include "sph/base/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <thread>

namespace dem2sph {
namespace {

volatile std::sig_atomic_t stop_flag = 0;
void on_stop(int) { stop_flag = 1; }

double seconds(std::chrono::steady_clock::duration d) { return std::chrono::duration<double>(d).count(); }

std::string clock_text(double s) {
  if (s < 90) return fmt::format("{:.0f} s", s);
  if (s < 5400) return fmt::format("{:.1f} min", s / 60);
  return fmt::format("{:.1f} h", s / 3600);
}

}  // namespace

void install_stop_handlers() {
  struct sigaction action {};
  action.sa_handler = on_stop;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}
bool stop_requested() noexcept { return stop_flag != 0; }
bool stop_follows() {
  for (int wait = 0; wait < 25 && !stop_requested(); ++wait)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  return stop_requested();
}

Progress::Progress(std::string title, bool quiet)
    : title_(std::move(title)),
      quiet_(quiet),
      terminal_(isatty(STDERR_FILENO) != 0),
      start_(std::chrono::steady_clock::now()),
      last_(start_) {}

Progress::~Progress() {
  if (open_line_) std::fputc('\n', stderr);
}

bool Progress::due() const {
  return !quiet_ && seconds(std::chrono::steady_clock::now() - last_) > (terminal_ ? 0.2 : 5.0);
}

void Progress::update(double fraction, const std::string& text) {
  if (due()) print(fraction, text);
}

void Progress::print(double fraction, const std::string& text) {
  last_ = std::chrono::steady_clock::now();
  const double used = seconds(last_ - start_);
  const double share = std::clamp(fraction, 0.0, 1.0);
  const std::string left = share > 0.01 ? clock_text(used * (1 - share) / share) + " left" : "";
  if (terminal_) {
    const int filled = static_cast<int>(share * 24);
    fmt::print(stderr, "\r{} [{:=<{}}{:<{}}] {:3.0f} % {} {}\033[K", title_, "", filled, "", 24 - filled,
               100 * share, left, text);
    open_line_ = true;
  } else {
    fmt::print(stderr, "{} {:3.0f} % {} {}\n", title_, 100 * share, left, text);
  }
  std::fflush(stderr);
}

void Progress::finish(const std::string& text) {
  if (quiet_) return;
  if (open_line_) fmt::print(stderr, "\r\033[K");
  open_line_ = false;
  fmt::print(stderr, "{}: {} ({})\n", title_, text,
             clock_text(seconds(std::chrono::steady_clock::now() - start_)));
}

}  // namespace dem2sph
