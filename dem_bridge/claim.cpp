#include "dem_bridge/claim.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <fstream>
#include <mutex>

#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph::bridge {

namespace fs = std::filesystem;

namespace {

std::string host_name() {
  char name[256] = {};
  if (::gethostname(name, sizeof name - 1) != 0) return "unknown";
  return name;
}

/// When a process started, in clock ticks since boot: a process id alone may have been given to another
/// process since. Empty if it does not live.
std::string start_of_process(long pid) {
  std::ifstream file(fmt::format("/proc/{}/stat", pid));
  std::string line;
  std::getline(file, line);
  const std::size_t after_name = line.rfind(')');  // the name may hold anything, spaces too
  if (after_name == std::string::npos) return "";
  std::string word;
  std::size_t at = after_name + 2;
  for (int field = 3; field <= 22 && at < line.size(); ++field) {
    const std::size_t space = std::min(line.find(' ', at), line.size());
    word = line.substr(at, space - at);
    if (field == 3 && (word == "Z" || word == "X")) return "";  // dead, only not yet waited for
    at = space + 1;
  }
  return word;
}

/// Process ids of another name space, that is of another container, mean nothing here.
std::string pid_namespace() {
  std::error_code unknown;
  return fs::read_symlink("/proc/self/ns/pid", unknown).string();
}

// An owner that cannot be asked has to show that it lives: it touches owner.json, and has fifteen chances to
// do so before it counts as dead.
constexpr std::chrono::seconds heartbeat_interval{20};
constexpr std::chrono::seconds heartbeat_limit{300};

}  // namespace

std::optional<Owner> owner_of(const fs::path& run_folder) {
  const fs::path claim = run_folder / "claim";
  const fs::path file = claim / "owner.json";
  std::error_code status;
  if (!fs::is_directory(claim, status)) return std::nullopt;
  const auto age = [&](const fs::path& path) {
    const auto time = fs::last_write_time(path, status);
    return status ? std::chrono::seconds::max()
                  : std::chrono::duration_cast<std::chrono::seconds>(fs::file_time_type::clock::now() - time);
  };
  if (!fs::exists(file, status)) return std::nullopt;  // being released
  nlohmann::json owner;
  try {
    owner = read_json(file);
  } catch (const InputError&) {
    std::error_code gone;
    if (!fs::exists(claim, gone)) return std::nullopt;  // released while we looked
    throw;
  }
  const std::string host = owner.value("host", "");
  const long pid = owner.value("pid", 0L);
  const std::string text = fmt::format("process {} on {}", pid, host);
  if (host == host_name() && owner.value("pid_namespace", pid_namespace()) == pid_namespace()) {
    const std::string started = start_of_process(pid);
    return Owner{!started.empty() && started == owner.value("started", ""), text};
  }
  // A process of another machine or container cannot be asked: its heartbeat has to tell.
  const std::chrono::seconds silent = age(file);
  if (silent == std::chrono::seconds::max()) return std::nullopt;
  return Owner{silent < heartbeat_limit, fmt::format("{} (heard of {} s ago)", text, silent.count())};
}

SweepLock::SweepLock(const fs::path& runs)
    : file_(::open((runs / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666)) {
  if (file_ < 0)
    throw InputError(
        fmt::format("{}: cannot open it for writing: {}", (runs / "lock").string(), std::strerror(errno)));
  // A file system without locks refuses: the claims themselves, atomic as they are, must do there.
  while (::flock(file_, LOCK_EX) != 0 && errno == EINTR) continue;
}

SweepLock::~SweepLock() { ::close(file_); }

std::unique_ptr<Claim> Claim::take(const fs::path& run_folder, std::string* holder) {
  const fs::path path = run_folder / "claim";
  // Judging the owner dead and taking its place are one act: two that do it at once would move each other's
  // fresh claims away.
  const SweepLock lock(run_folder.parent_path());
  // Made whole beside its place and renamed, which fails if a claim is there: none is ever seen without its
  // owner, whenever its maker is killed.
  const long pid = ::getpid();
  static std::atomic<long> count{0};
  const nlohmann::json owner_json{{"pid", pid},
                                  {"host", host_name()},
                                  {"pid_namespace", pid_namespace()},
                                  {"started", start_of_process(pid)},
                                  {"claim", ++count}};
  const std::string text = owner_json.dump() + "\n";
  const std::string name = sha256(text).substr(0, 12);
  const fs::path made = run_folder / ("claim.new." + name);
  fs::create_directory(made);
  try {
    write_file_atomically(made / "owner.json", text);
  } catch (...) {  // a full disk: nothing of the attempt stays
    std::error_code ignored;
    fs::remove_all(made, ignored);
    throw;
  }
  for (int attempt = 0; attempt < 3; ++attempt) {
    std::error_code taken;
    fs::rename(made, path, taken);
    if (!taken) return std::unique_ptr<Claim>(new Claim(path, text, name));
    const std::optional<Owner> owner = owner_of(run_folder);
    if (owner && owner->alive) {
      if (holder != nullptr) *holder = owner->text;
      break;
    }
    if (!owner) continue;  // released while we looked
    // Left by a process that is dead: moved first, so that no half-removed claim is ever seen.
    const fs::path stale = run_folder / ("claim.stale." + name);
    std::error_code status;
    fs::rename(path, stale, status);
    if (!status) fs::remove_all(stale);
  }
  if (holder != nullptr && holder->empty()) *holder = "an unknown process";
  fs::remove_all(made);
  return nullptr;
}

bool Claim::is_ours() const {
  std::ifstream file(path_ / "owner.json");
  std::string line;
  std::getline(file, line);
  return line + "\n" == text_;
}

Claim::~Claim() {
  beating_ = {};  // joins
  try {
    const SweepLock lock(path_.parent_path().parent_path());
    if (!is_ours()) return;
    std::error_code ignored;  // a claim that stays behind is taken over, since this process will be dead
    fs::remove_all(path_, ignored);
  } catch (const std::exception&) {  // the same holds without a lock
  }
}

Claim::Claim(fs::path path, std::string text, std::string name)
    : path_(std::move(path)), text_(std::move(text)), name_(std::move(name)) {
  beating_ = std::jthread([this](const std::stop_token& end) {
    std::mutex mutex;
    std::condition_variable_any wake;
    std::unique_lock lock(mutex);
    while (!wake.wait_for(lock, end, heartbeat_interval, [&] { return end.stop_requested(); })) {
      if (!is_ours()) return;
      std::error_code missed;  // the next beat comes soon
      fs::last_write_time(path_ / "owner.json", fs::file_time_type::clock::now(), missed);
    }
  });
}

}  // namespace dem2sph::bridge
