// Who works in a run's folder: a claim, a folder that is made atomically, with a heartbeat and an owner that
// can be asked whether it lives.
//
// The claim of a dead process is taken over. Whether it is dead is known at once if it ran on this machine
// (its process is gone, or another one has got its number), and after five minutes without a heartbeat
// otherwise.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>

namespace dem2sph::bridge {

struct Owner {
  bool alive = false;
  std::string text;  ///< "process 12 on host"
};

/// Who holds the claim in a run's folder; nothing if there is none.
std::optional<Owner> owner_of(const std::filesystem::path& run_folder);

/// While it lives, no other process or thread looks at the claims in `runs`, or writes what sweeps share.
class SweepLock {
 public:
  /// Waits for it. Throws InputError if the folder cannot be written to.
  explicit SweepLock(const std::filesystem::path& runs);
  ~SweepLock();
  SweepLock(const SweepLock&) = delete;
  SweepLock& operator=(const SweepLock&) = delete;

 private:
  int file_;
};

/// The right to work in a run's folder, given back at the end of its life. A thread keeps its heart beating.
class Claim {
 public:
  /// Nothing if somebody who is alive holds it; `holder` then says who.
  static std::unique_ptr<Claim> take(const std::filesystem::path& run_folder, std::string* holder = nullptr);
  /// False once another process has judged us dead (after a long suspension, say) and taken over.
  bool is_ours() const;
  /// A name that no other claim has, of any process: for a folder to work in.
  const std::string& name() const { return name_; }
  ~Claim();
  Claim(const Claim&) = delete;
  Claim& operator=(const Claim&) = delete;

 private:
  Claim(std::filesystem::path path, std::string text, std::string name);
  std::filesystem::path path_;
  std::string text_;
  std::string name_;
  std::jthread beating_;
};

}  // namespace dem2sph::bridge
