#include "dem_bridge/sweep.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <thread>

#include "dem_bridge/claim.hpp"
#include "dem_bridge/run.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph::bridge {

namespace fs = std::filesystem;

namespace {

constexpr const char* sweep_file = "sweep.json";

SweepPlan read_sweep_file(const fs::path& folder) {
  const fs::path path = folder / sweep_file;
  const nlohmann::json json = read_json(path);
  try {
    return sweep_from_json(json);
  } catch (const InputError& error) {
    throw InputError(fmt::format("{}: {}", path.string(), error.what()));
  }
}

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// What has to be run: every run that others do not begin with and that has no verdict, and what these begin
/// with.
std::vector<const RunPlan*> missing_runs(const SweepPlan& plan, const fs::path& folder, std::size_t& reused) {
  std::set<std::string> wanted;
  for (const RunPlan& run : plan.runs) {
    if (prepares(run.kind)) continue;
    const fs::path path = folder_of(folder, run);
    if (is_done(run, path))
      ++reused;
    else if (!is_failed(path))
      wanted.insert(run.hash);
  }
  // Chains are two preparations long at most; a preparation stands behind what it begins with nowhere, so go
  // round until nothing is added.
  for (std::size_t before = 0; before != wanted.size();) {
    before = wanted.size();
    for (const RunPlan& run : plan.runs)
      if (wanted.contains(run.hash) && !run.begins_with.empty()) wanted.insert(run.begins_with);
  }
  std::vector<const RunPlan*> missing;
  for (const RunPlan& run : plan.runs) {
    const fs::path path = folder_of(folder, run);
    if (!wanted.contains(run.hash) || is_failed(path)) continue;
    if (!is_done(run, path))
      missing.push_back(&run);
    else if (prepares(run.kind))
      ++reused;
  }
  return missing;
}

std::map<std::string, const RunPlan*> by_hash(const SweepPlan& plan) {
  std::map<std::string, const RunPlan*> runs;
  for (const RunPlan& run : plan.runs) runs[run.hash] = &run;
  return runs;
}

/// The runs that a sweep works through, shared by its workers.
class Queue {
 public:
  Queue(std::vector<const RunPlan*> missing, const SweepPlan& plan, const SweepOptions& options)
      : plan_(plan),
        options_(options),
        by_hash_(by_hash(plan)),
        waiting_(std::move(missing)),
        total_(waiting_.size()) {
    for (const RunPlan* run : waiting_) to_spend_ += run->deck.core_seconds;
  }

  /// One worker: takes runs until none is left for it.
  void work() {
    while (!over()) {
      if (const RunPlan* run = take())
        attend(*run);
      else
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  }

  bool over() {
    const std::lock_guard lock(mutex_);
    return give_up_ || stop_requested() || (waiting_.empty() && running_.empty());
  }

  double progress(std::string& text) {
    const std::lock_guard lock(mutex_);
    double spent = spent_;
    text = fmt::format("{} of {} done", total_ - waiting_.size() - running_.size(), total_);
    for (const auto& [run, start] : running_) {
      spent += std::min(0.95 * run->deck.core_seconds, seconds_since(start));
      text += fmt::format(", {} {:.0f} s", title(*run), seconds_since(start));
    }
    return to_spend_ > 0 ? spent / to_spend_ : 1;
  }

  /// Throws what stopped the work, if anything did.
  void finish(SweepResult& result) {
    if (mistake_) std::rethrow_exception(mistake_);
    if (interrupted_ || stop_requested())
      throw Interrupted(fmt::format("stopped on request with {} of {} runs done; the same command resumes",
                                    ran_ + result.reused, total_ + result.reused));
    result.ran = ran_;
    result.elsewhere = held_.size();
    for (const auto& [run, holder] : held_)
      spdlog::warn("{}: {} works on it; if that is not so, remove {}", title(*run), holder,
                   (folder_of(options_.folder, *run) / "claim").string());
  }

 private:
  fs::path folder(const RunPlan& run) const { return folder_of(options_.folder, run); }

  /// The first run whose beginning is there; null if none is at the moment. Runs that begin with a failure
  /// are dropped.
  const RunPlan* take() {
    const std::lock_guard lock(mutex_);
    for (auto it = waiting_.begin(); it != waiting_.end();) {
      const RunPlan* run = *it;
      const auto postponed = not_before_.find(run);
      if (postponed != not_before_.end() && Clock::now() < postponed->second) {
        ++it;
        continue;
      }
      if (!run->begins_with.empty()) {
        const RunPlan* parent = by_hash_.at(run->begins_with);
        if (is_failed(folder(*parent)) || dropped_.contains(run->begins_with)) {
          dropped_.insert(run->hash);
          to_spend_ -= run->deck.core_seconds;
          it = waiting_.erase(it);
          continue;
        }
        if (!is_done(*parent, folder(*parent))) {
          ++it;
          continue;
        }
      }
      waiting_.erase(it);
      running_[run] = Clock::now();
      return run;
    }
    return nullptr;
  }

  void attend(const RunPlan& run) {
    std::unique_ptr<Claim> claim;  // outlives the verdict
    bool postponed = false;
    try {
      fs::create_directories(folder(run));
      std::string holder;
      claim = Claim::take(folder(run), &holder);
      if (!claim) {
        // What others begin with is waited for: they could not be run otherwise.
        postponed = prepares(run.kind);
        if (!postponed) {
          const std::lock_guard lock(mutex_);
          held_.emplace_back(&run, holder);
        }
      } else if (is_done(run, folder(run))) {
        ++ran_;  // somebody finished it between our look and our claim
      } else if (!is_failed(folder(run))) {
        try_until_done(run, *claim);
      }
    } catch (const Interrupted&) {
      const std::lock_guard lock(mutex_);
      interrupted_ = true;
      give_up_ = true;
    } catch (...) {  // no verdict on this run: handed to the caller by finish()
      const std::lock_guard lock(mutex_);
      mistake_ = std::current_exception();
      give_up_ = true;
    }
    const std::lock_guard lock(mutex_);
    running_.erase(&run);
    if (postponed) {
      waiting_.push_back(&run);
      not_before_[&run] = Clock::now() + std::chrono::milliseconds(500);
    } else {
      spent_ += run.deck.core_seconds;
    }
  }

  void try_until_done(const RunPlan& run, const Claim& claim) {
    const long tries = plan_.on_failure == FailurePolicy::retry ? 1 + plan_.retries : 1;
    for (long attempt = 1;; ++attempt) {
      try {
        carry_out(run, plan_, options_.folder, claim);
        ++ran_;
        return;
      } catch (const Error& error) {
        if (error.code() != ExitCode::engine && error.code() != ExitCode::unreadable) throw;
        // A stop that reached the engine too makes it fail in any manner of ways.
        if (stop_requested()) throw Interrupted("stopped on request; the same command resumes");
        const bool hopeless = dynamic_cast<const UnfitRun*>(&error) != nullptr;
        if (!hopeless && attempt < tries) {
          spdlog::warn("{}: tried again ({} of {}), since it failed: {}", title(run), attempt, plan_.retries,
                       error.what());
          continue;
        }
        record_failure(run, folder(run), error.what(), attempt);
        if (plan_.on_failure == FailurePolicy::abort)
          throw EngineError(
              fmt::format("{} failed, and on_failure = \"abort\": {}", title(run), error.what()));
        return;
      }
    }
  }

  const SweepPlan& plan_;
  const SweepOptions& options_;
  const std::map<std::string, const RunPlan*> by_hash_;
  std::mutex mutex_;
  std::vector<const RunPlan*> waiting_;
  std::size_t total_;
  std::map<const RunPlan*, Clock::time_point> running_, not_before_;
  std::set<std::string> dropped_;
  std::vector<std::pair<const RunPlan*, std::string>> held_;  // by other sweeps
  double spent_ = 0, to_spend_ = 0;                           // expected core-seconds
  std::atomic<std::size_t> ran_{0};
  std::exception_ptr mistake_;
  bool interrupted_ = false, give_up_ = false;
};

/// All that is done and all that failed, in an order that does not depend on the order of running.
void collect_all(const SweepPlan& plan, const fs::path& folder, SweepResult& result) {
  Observables& observables = result.observables;
  observables.d = plan.grains.d;
  observables.rho_s = plan.grains.rho_s;
  observables.grain_friction = plan.grains.grain_friction;
  observables.pressure = plan.pressure;
  observables.engine = plan.engine;
  observables.material = plan.material;
  std::vector<const RunPlan*> in_order;
  for (const RunPlan& run : plan.runs) in_order.push_back(&run);
  const std::map<std::string, const RunPlan*> runs = by_hash(plan);
  std::sort(in_order.begin(), in_order.end(), [](const RunPlan* a, const RunPlan* b) {
    const auto key = [](const RunPlan* r) {
      return std::tuple(r->kind, r->shearing.I_driven, r->I_before, r->shearing.pressure,
                        r->sample.packing_friction, r->sample.seed, r->hash);
    };
    return key(a) < key(b);
  });
  for (const RunPlan* run : in_order) {
    const fs::path path = folder_of(folder, *run);
    if (is_done(*run, path)) {
      collect(*run, path, observables);
      continue;
    }
    // The failure may be its own or that of what it begins with.
    for (const RunPlan* at = run; at != nullptr;
         at = at->begins_with.empty() ? nullptr : runs.at(at->begins_with)) {
      if (!is_failed(folder_of(folder, *at))) continue;
      const std::string cause = at == run ? "" : fmt::format("it begins with {}, which failed: ", title(*at));
      result.failed.push_back({run->hash, fmt::format("{}: {}{}", title(*run), cause,
                                                      reason_of_failure(folder_of(folder, *at)))});
      break;
    }
  }
  observables.excluded = result.failed;
}

}  // namespace

ExitCode SweepResult::exit_code() const {
  if (!failed.empty()) return ExitCode::engine;
  return elsewhere > 0 ? ExitCode::interrupted : ExitCode::ok;
}

SweepResult run_sweep(const SweepPlan& plan, const SweepOptions& options) {
  if (options.jobs < 1) throw UsageError("--jobs must be at least 1");
  if (plan.engine == engine_unknown) throw std::logic_error("a sweep planned without an engine cannot run");
  const fs::path runs = options.folder / "runs";
  fs::create_directories(runs);
  {
    const SweepLock lock(runs);
    write_file_atomically(options.folder / sweep_file, to_json(plan).dump(1) + "\n");
  }

  SweepResult result;
  const std::vector<const RunPlan*> missing = missing_runs(plan, options.folder, result.reused);
  if (!missing.empty()) require_engine_features(missing.front()->sample);
  const std::size_t count = std::min(static_cast<std::size_t>(options.jobs), missing.size());
  Queue queue(missing, plan, options);
  {
    Progress progress("shear cells", options.quiet);
    std::vector<std::jthread> workers;
    for (std::size_t j = 0; j < count; ++j) workers.emplace_back([&queue] { queue.work(); });
    while (!queue.over()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      if (!progress.due()) continue;
      std::string text;
      const double fraction = queue.progress(text);
      progress.update(fraction, text);
    }
    workers.clear();  // joins
    queue.finish(result);
    progress.finish(fmt::format("{} run, {} reused of {}", result.ran, result.reused, plan.runs.size()));
  }

  collect_all(plan, options.folder, result);
  if (!result.failed.empty())
    spdlog::warn(
        "{} of {} runs have failed and are left out until they are run again: dem2sph sweep retry {}",
        result.failed.size(), plan.runs.size(), options.folder.string());
  const SweepLock lock(runs);
  write_observables(result.observables, options.folder / "observables.h5");
  return result;
}

std::string name_of(RunState state) {
  switch (state) {
    case RunState::waiting:
      return "waiting";
    case RunState::running:
      return "running";
    case RunState::done:
      return "done";
    case RunState::failed:
      return "failed";
    case RunState::abandoned:
      return "abandoned";
  }
  return "";
}

SweepStatus sweep_status(const fs::path& sweep_folder) {
  SweepStatus status;
  const SweepPlan plan = read_sweep_file(sweep_folder);
  double measured = 0, expected = 0;
  for (const RunPlan& run : plan.runs) {
    const fs::path folder = folder_of(sweep_folder, run);
    RunStatus one{run.hash, title(run), RunState::waiting, "", run.deck.core_seconds};
    const std::optional<Owner> owner = owner_of(folder);
    if (is_done(run, folder)) {
      one.state = RunState::done;
      one.core_seconds = measured_core_seconds(folder);
      measured += one.core_seconds;
      expected += run.deck.core_seconds;
    } else if (is_failed(folder)) {
      one.state = RunState::failed;
      one.detail = reason_of_failure(folder);
    } else if (owner) {
      one.state = owner->alive ? RunState::running : RunState::abandoned;
      one.detail = owner->text;
    }
    status.runs.push_back(std::move(one));
  }
  if (expected > 0) status.slowness = measured / expected;
  for (RunStatus& run : status.runs) {
    if (run.state == RunState::done) continue;
    run.core_seconds *= status.slowness;
    if (run.state == RunState::running) ++status.working;
    if (run.state != RunState::failed) status.core_seconds_left += run.core_seconds;
  }
  return status;
}

std::string describe(const SweepStatus& status) {
  std::string text;
  std::map<RunState, std::size_t> count;
  for (const RunStatus& run : status.runs) {
    ++count[run.state];
    text += fmt::format("{}  {:<9} {:<44} {:7.1f} core-seconds  {}\n", run.hash, name_of(run.state), run.what,
                        run.core_seconds, run.detail);
  }
  for (const auto& [state, n] : count) text += fmt::format("{} {}  ", n, name_of(state));
  text += '\n';
  if (status.core_seconds_left > 0) {
    text += fmt::format(
        "about {:.0f} core-seconds are left, by what the finished runs took ({:.2f} of the estimate)",
        status.core_seconds_left, status.slowness);
    if (status.working > 0)
      text += fmt::format(": at most {:.0f} s with the {} at work now",
                          status.core_seconds_left / status.working, status.working);
    text += '\n';
  }
  if (count.contains(RunState::failed))
    text +=
        "failed runs are not run again until you ask for it: dem2sph sweep retry DIR, with the folder of "
        "this sweep\n";
  return text;
}

SweepResult retry_sweep(const SweepOptions& options) {
  const SweepPlan plan = read_sweep_file(options.folder);
  const std::string engine = engine_version();
  if (engine != plan.engine)
    throw EngineError(
        fmt::format("the sweep was made with \"{}\", but \"{}\" is installed: run the case again "
                    "instead of retrying",
                    plan.engine, engine));
  for (const RunPlan& run : plan.runs) {
    const fs::path folder = folder_of(options.folder, run);
    if (!is_failed(folder) || is_done(run, folder)) continue;
    const std::unique_ptr<Claim> claim = Claim::take(folder);
    if (!claim) continue;  // somebody is at it already
    clear_failure(folder);
  }
  return run_sweep(plan, options);
}

std::uintmax_t prune_sweep(const fs::path& sweep_folder) {
  const SweepPlan plan = read_sweep_file(sweep_folder);
  // A restart file is needed as long as a run that begins with it is not done.
  std::set<std::string> needed;
  for (const RunPlan& run : plan.runs)
    if (!is_done(run, folder_of(sweep_folder, run))) needed.insert(run.begins_with);
  std::uintmax_t bytes = 0;
  for (const RunPlan& run : plan.runs) {
    const fs::path folder = folder_of(sweep_folder, run);
    if (needed.contains(run.hash) || !is_done(run, folder)) continue;
    const std::unique_ptr<Claim> claim = Claim::take(folder);
    if (!claim) continue;
    bytes += prune(folder);
  }
  return bytes;
}

}  // namespace dem2sph::bridge
