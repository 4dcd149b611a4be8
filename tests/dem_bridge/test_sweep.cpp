// Sweeps with an engine of our own: a shell script that works, fails, hangs or lies. What counts as done,
// what is recorded as failed, what is reused, what a claim protects and how a stop ends.
#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <map>
#include <stdexcept>
#include <thread>

#include "dem_bridge/sweep.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"
#include "tests/base/helpers.hpp"
#include "tests/dem_bridge/packing.hpp"

namespace dem2sph::bridge {
namespace {

namespace fs = std::filesystem;
using dem2sph::test::content_of;
using dem2sph::test::message_of;
using dem2sph::test::put;
using test::Lattice;
using test::text_of;

constexpr const char* case_text = R"([material]
d = "1 mm"
rho_s = "2500 kg/m^3"
grain_friction = 2

[shear_cell]
on_failure = "skip"
grains = 300
length = 5
width = 5
core_margin = 1
time_limit = "30 s"

[shear_cell.steady]
I = [0.1]
strain_dropped = 0.5
strain_used = 0.5
responses_dropped = 0.5
responses_used = 0.5
frames = 80
)";

SweepPlan plan_of(const std::string& text, const std::vector<std::string>& overrides = {}) {
  return plan_sweep(CaseFile::parse(text, "case.toml", overrides), "LIGGGHTS-PUBLIC 3.8.0");
}

/// The first run that does not only prepare others.
const RunPlan& leaf_of(const SweepPlan& plan, std::size_t number = 0) {
  for (const RunPlan& run : plan.runs)
    if (!prepares(run.kind) && number-- == 0) return run;
  throw std::out_of_range("the plan has not so many runs");
}
const RunPlan& packing_of(const SweepPlan& plan) {
  for (const RunPlan& run : plan.runs)
    if (run.kind == RunKind::packing) return run;
  throw std::out_of_range("the plan has no packing");
}

class Sweep : public dem2sph::test::Scratch {
 protected:
  Sweep() {
    ::setenv("DEM2SPH_LIGGGHTS", in("engine").c_str(), 1);
    const DeckPlan packing = packing_of(plan_of(case_text)).deck;
    fs::create_directories(in("packed"));
    put(in("packed") / restart_file, "grains");
    std::string wall;
    for (std::int64_t n = packing.wall_samples - 1; n >= 0; --n)
      wall += fmt::format("{} 0.011 1000 0\n", packing.last_step - n * packing.frame_interval);
    put(in("packed") / wall_series_file, wall);
    packed_ =
        fmt::format("cp {}/packed/* . && echo '{}'", folder_.string(), sentinel(300, packing.last_step));
  }
  ~Sweep() override { ::unsetenv("DEM2SPH_LIGGGHTS"); }

  /// The engine prints its version without an input and its styles when asked for help, knows every contact
  /// law, reads every restart file back, packs perfectly unless `packing` says otherwise, and runs `body` for
  /// every shearing.
  void engine(const std::string& body, const std::string& packing = "") {
    put(in("engine"),
        R"(#!/bin/sh
case "$*" in
*-help*) echo '* Atom styles:'; echo granular
  echo '* Pair styles:'; echo gran; echo '* Normal models for pair gran:'; echo hertz hooke/stiffness
  echo '* Tangential models for pair gran:'; echo history; echo '* Compute styles:'; echo pair/gran/local
  echo '* Dump styles:'; echo custom local; echo '* Fix styles:'
  echo addforce ave/time deform freeze insert/pack nve/sphere particletemplate/sphere property/global rigid viscous
  exit 0;;
*check.in*) echo 'DEM2SPH reached step 0 with 300 grains'; exit 0;;
*-in*) ;;
*) echo 'LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled today)'; exit 0;;
esac
if grep -q 'three grains' deck.in; then echo 'DEM2SPH reached step 0 with 3 grains'; exit 0; fi
if grep -q 'insert/pack' deck.in; then
)" + (packing.empty() ? packed_ : packing) +
            "\nexit; fi\n" + body + "\n");
    fs::permissions(in("engine"), fs::perms::owner_all);
  }

  /// Files that a perfect shearing would leave: a lattice under 1 kPa, sheared affinely. Returns what the
  /// engine has to do.
  std::string perfect_run(const RunPlan& run, double pressure = 1000, std::int64_t frames = -1,
                          int lost = 0) {
    fs::create_directories(in("made"));
    Lattice lattice;
    lattice.gamma_dot = run.shearing.I_driven / run.deck.inertial_time;
    lattice.normal = 1000 * 1e-6;
    lattice.tangential = 2e-4;  // a tilted bond stays below Coulomb's limit
    std::string grains, contacts, wall = "# Time-averaged data\n";
    if (frames < 0) frames = run.deck.frames;
    for (std::int64_t n = 0; n < frames; ++n) {
      const std::int64_t step = n * run.deck.frame_interval;
      lattice.strain = lattice.gamma_dot * static_cast<double>(step) * run.deck.time_step.step;
      GrainFrame frame = lattice.frame(step);
      if (n + 1 == frames) frame.grains.resize(frame.grains.size() - static_cast<std::size_t>(lost));
      grains += text_of(frame);
      contacts += text_of(lattice.contacts(step));
      if (n > 0) wall += fmt::format("{} 0.011 {} 100\n", step, pressure);
    }
    put(in("made") / grain_dump_file, grains);
    put(in("made") / contact_dump_file, contacts);
    put(in("made") / wall_series_file, wall);
    return fmt::format("echo run >> {0}/calls; cp {0}/made/* . && echo '{1}'", folder_.string(),
                       sentinel(run.sample.grains, run.deck.last_step));
  }

  SweepOptions options(int jobs = 1) const { return {in("out"), jobs, true}; }
  fs::path run_folder(const RunPlan& run) const { return in("out") / "runs" / run.hash; }

  RunState state_of(const RunPlan& run) const {
    for (const RunStatus& status : sweep_status(in("out")).runs)
      if (status.hash == run.hash) return status.state;
    throw std::out_of_range("the sweep has no such run");
  }

  std::size_t calls() const {
    if (!fs::exists(in("calls"))) return 0;
    const std::string text = content_of(in("calls"));
    return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
  }

  std::string packed_;

  /// Runs one run with this engine; it must fail, and the reason is returned.
  std::string reason_of_failure(const SweepPlan& plan) {
    const SweepResult result = run_sweep(plan, options());
    EXPECT_EQ(result.failed.size(), 1U);
    EXPECT_EQ(result.exit_code(), ExitCode::engine);
    EXPECT_TRUE(result.observables.steady.empty());
    EXPECT_FALSE(fs::exists(run_folder(leaf_of(plan)) / "done.json"));
    EXPECT_FALSE(fs::exists(run_folder(leaf_of(plan)) / "claim"));
    return result.failed.empty() ? "" : result.failed[0].reason;
  }
};

TEST_F(Sweep, APerfectRunIsReducedAndReused) {
  const SweepPlan plan = plan_of(case_text);
  ASSERT_EQ(plan.runs.size(), 2U) << "a packing and a shearing";
  engine(perfect_run(leaf_of(plan)));
  const SweepResult first = run_sweep(plan, options());
  EXPECT_EQ(first.exit_code(), ExitCode::ok);
  EXPECT_EQ(first.ran, 2U);
  const Observables o = read_observables(in("out") / "observables.h5");
  ASSERT_EQ(o.steady.size(), 1U);
  EXPECT_NEAR(o.steady[0].mu, 0.1, 1e-9);  // half of 0.2: the lattice's force is symmetrised
  EXPECT_NEAR(o.steady[0].p, 1000, 1e-6);
  EXPECT_NEAR(o.steady[0].I, 0.1, 1e-9);
  EXPECT_NEAR(o.steady[0].wall_mu, 0.1, 1e-12);
  EXPECT_EQ(o.steady[0].run, leaf_of(plan).hash);
  EXPECT_EQ(o.engine, "LIGGGHTS-PUBLIC 3.8.0");
  EXPECT_CONTAINS(o.material, "grain_friction = 2");
  ASSERT_EQ(o.costs.size(), 2U);
  EXPECT_EQ(o.costs[0].kind, "packing");
  const nlohmann::json evidence = read_json(run_folder(leaf_of(plan)) / "done.json").at("result");
  EXPECT_EQ(o.steady[0].mu_flat, evidence.at("mu").at("flat").get<bool>());
  EXPECT_EQ(o.steady[0].I_flat, evidence.at("I").at("flat").get<bool>());
  EXPECT_EQ(o.steady[0].phi_flat, evidence.at("phi").at("flat").get<bool>());
  EXPECT_EQ(o.steady[0].phi_drift, evidence.at("phi_drift").get<double>());
  EXPECT_FALSE(fs::exists(run_folder(leaf_of(plan)) / grain_dump_file))
      << "dumps are pruned after the reduction";
  EXPECT_FALSE(fs::exists(run_folder(leaf_of(plan)) / "claim"));

  const SweepResult second = run_sweep(plan, options());
  EXPECT_EQ(second.ran, 0U);
  EXPECT_EQ(second.reused, 1U);
  EXPECT_EQ(calls(), 1U);
  EXPECT_EQ(second.observables.steady[0].mu, first.observables.steady[0].mu);
  EXPECT_EQ(state_of(leaf_of(plan)), RunState::done);
}

TEST_F(Sweep, StartUpsBecomeSeries) {
  const std::string text =
      std::string(case_text).substr(0, std::string(case_text).find("[shear_cell.steady]")) +
      "[shear_cell.start_up]\nI = [0.05]\nseeds = [3]\nstrain = 2\nframes = 100\nwindow = 0.1\n";
  const SweepPlan plan = plan_of(text);
  ASSERT_EQ(plan.runs.size(), 2U);
  EXPECT_EQ(leaf_of(plan).sample.packing_friction, 0);
  engine(perfect_run(leaf_of(plan)));
  const SweepResult result = run_sweep(plan, options());
  ASSERT_EQ(result.observables.transients.size(), 1U);
  const Transient& t = result.observables.transients[0];
  EXPECT_EQ(t.kind, "start_up");
  EXPECT_EQ(t.seed, 3);
  EXPECT_NEAR(t.s.back(), 1.95, 0.1);
  EXPECT_NEAR(t.mu[5], 0.1, 1e-9);
  EXPECT_NEAR(t.beta[5], 0, 1e-9);
}

TEST_F(Sweep, AFailureIsRecordedWithTheEnginesWords) {
  engine("printf 'Setting up run\\nERROR: Atom lost\\001\\002 (file.cpp:12)\\n'; exit 1");
  const SweepPlan plan = plan_of(case_text);
  const std::string reason = reason_of_failure(plan);
  EXPECT_CONTAINS(reason, "LIGGGHTS ended with code 1");
  EXPECT_CONTAINS(reason, "ERROR: Atom lost (file.cpp:12)");
  EXPECT_CONTAINS(describe(sweep_status(in("out"))), "Atom lost");
  EXPECT_CONTAINS(describe(sweep_status(in("out"))), "dem2sph sweep retry DIR");
  EXPECT_EQ(read_observables(in("out") / "observables.h5").excluded.size(), 1U);
}

TEST_F(Sweep, NoLieCountsAsDone) {
  const SweepPlan plan = plan_of(case_text);
  const RunPlan& run = leaf_of(plan);
  const std::string end = sentinel(run.sample.grains, run.deck.last_step);
  struct Lie {
    std::string body, reason;
  };
  std::vector<Lie> lies{
      {"exit 0", "never printed"},
      {"echo 'DEM2SPH reached step 1 with 300 grains'", "never printed"},
      {"echo '" + end + "'; exit 3", "ended with code 3"},
      {"echo '" + end + "'", "cannot open this dump"},
      {"kill -SEGV $$", "killed by signal 11"},
  };
  for (const Lie& lie : lies) {
    fs::remove_all(in("out"));
    engine(lie.body);
    EXPECT_CONTAINS(reason_of_failure(plan), lie.reason);
  }
  fs::remove_all(in("out"));
  engine(perfect_run(run, 1000, run.deck.frames - 1));
  EXPECT_CONTAINS(reason_of_failure(plan),
                  fmt::format("{} frames in the dumps, expected", run.deck.frames - 1));
  fs::remove_all(in("out"));
  engine(perfect_run(run, 1000, -1, 1));
  EXPECT_CONTAINS(reason_of_failure(plan), "299 grains at step");
  fs::remove_all(in("out"));
  engine(perfect_run(run, 1600));
  EXPECT_CONTAINS(reason_of_failure(plan), "mean pressure on the wall is 1600 +- ");
  fs::remove_all(in("out"));
  const std::string copy = perfect_run(run);
  fs::resize_file(in("made") / contact_dump_file, fs::file_size(in("made") / contact_dump_file) - 5);
  engine(copy);
  EXPECT_CONTAINS(reason_of_failure(plan),
                  fmt::format("contacts.dump breaks off after {} of", run.deck.frames - 1));
}

TEST_F(Sweep, OverlappingGrainsAreRefused) {
  const SweepPlan plan = plan_of(case_text);
  const std::string copy = perfect_run(leaf_of(plan));
  std::string text = content_of(in("made") / grain_dump_file);
  for (std::size_t at = 0; (at = text.find(" 0.0005 \n", at)) != std::string::npos;)
    text.replace(at, 9, " 0.0006 \n");
  put(in("made") / grain_dump_file, text);
  engine(copy);
  EXPECT_CONTAINS(reason_of_failure(plan), "grains overlap by 0.18 d");
}

TEST_F(Sweep, AHangingEngineIsEnded) {
  engine("echo waiting; sleep 60");
  const SweepPlan plan = plan_of(case_text, {"shear_cell.time_limit=1 s"});
  const auto start = std::chrono::steady_clock::now();
  EXPECT_CONTAINS(reason_of_failure(plan), "time limit of 1 s");
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(10));
}

TEST_F(Sweep, OneFailureDoesNotStopTheOthersAndRetryFinishes) {
  const SweepPlan plan = plan_of(case_text, {"shear_cell.steady.seeds=[1, 2, 3]"});
  ASSERT_EQ(plan.runs.size(), 6U);
  const std::string good = perfect_run(leaf_of(plan));
  // Seed 2 is found by its folder's name.
  std::string bad_hash;
  for (const RunPlan& run : plan.runs)
    if (run.sample.seed == 2 && !prepares(run.kind)) bad_hash = run.hash;
  engine("case \"$PWD\" in *" + bad_hash + "*) echo broken; exit 1;; esac\n" + good);
  testing::internal::CaptureStdout();
  const SweepResult first = run_sweep(plan, options(2));
  EXPECT_CONTAINS(testing::internal::GetCapturedStdout(),
                  "1 of 6 runs have failed and are left out until they are run again: dem2sph sweep retry " +
                      in("out").string());
  EXPECT_EQ(first.ran, 5U);
  ASSERT_EQ(first.failed.size(), 1U);
  EXPECT_EQ(first.failed[0].run, bad_hash);
  EXPECT_CONTAINS(first.failed[0].reason, "steady I = 0.1 seed 2: LIGGGHTS ended with code 1");
  EXPECT_EQ(first.observables.steady.size(), 2U);

  engine(good);
  EXPECT_EQ(run_sweep(plan, options()).failed.size(), 1U) << "a failure stays one until it is retried";
  EXPECT_EQ(calls(), 2U);
  const SweepResult retried = retry_sweep(options());
  EXPECT_EQ(retried.exit_code(), ExitCode::ok);
  EXPECT_EQ(retried.ran, 1U);
  EXPECT_EQ(retried.observables.steady.size(), 3U);
  EXPECT_EQ(calls(), 3U);
}

TEST_F(Sweep, AFailureIsTriedAgainWhereThatMayHelp) {
  const SweepPlan plan = plan_of(case_text, {"shear_cell.on_failure=retry", "shear_cell.retries=2"});
  const std::string good = perfect_run(leaf_of(plan));
  // Killed twice, then left alone.
  engine("echo try >> " + in("tries").string() + "; if [ $(wc -l < " + in("tries").string() +
         ") -lt 3 ]; then kill -KILL $$; fi\n" + good);
  testing::internal::CaptureStdout();
  const SweepResult result = run_sweep(plan, options());
  EXPECT_CONTAINS(testing::internal::GetCapturedStdout(), "tried again (2 of 2), since it failed");
  EXPECT_EQ(result.exit_code(), ExitCode::ok);
  EXPECT_EQ(content_of(in("tries")), "try\ntry\ntry\n");

  // A run that would fail the same way is not: its pressure is wrong.
  fs::remove_all(in("out"));
  fs::remove(in("calls"));
  engine(perfect_run(leaf_of(plan), 1600));
  EXPECT_CONTAINS(reason_of_failure(plan), "instead of 1000 Pa");
  EXPECT_EQ(calls(), 1U);

  fs::remove_all(in("out"));
  fs::remove(in("tries"));
  engine("echo try >> " + in("tries").string() + "; kill -KILL $$");
  EXPECT_CONTAINS(reason_of_failure(plan), "killed by signal 9");
  EXPECT_EQ(content_of(in("tries")), "try\ntry\ntry\n") << "once and two retries";
  EXPECT_EQ(read_json(run_folder(leaf_of(plan)) / "failed.json").at("attempts"), 3);
  EXPECT_TRUE(fs::exists(run_folder(leaf_of(plan)) / "failed" / deck_file)) << "what it did is kept";
}

TEST_F(Sweep, AbortStartsNothingNew) {
  const SweepPlan plan =
      plan_of(case_text, {"shear_cell.on_failure=abort", "shear_cell.steady.seeds=[1, 2, 3]"});
  engine("echo run >> " + in("calls").string() + "; exit 1");
  EXPECT_CONTAINS(message_of<EngineError>([&] { run_sweep(plan, options()); }), "on_failure = \"abort\"");
  EXPECT_EQ(calls(), 1U);
  EXPECT_EQ(describe(sweep_status(in("out"))).find("running"), std::string::npos);
}

TEST_F(Sweep, WhatBeginsWithAFailureIsLeftOutWithItsCause) {
  const SweepPlan plan = plan_of(case_text, {"shear_cell.steady.I=[0.1, 0.2]"});
  const std::string good = perfect_run(leaf_of(plan));
  engine(good, "echo 'ERROR: no room'; exit 1");
  const SweepResult result = run_sweep(plan, options());
  ASSERT_EQ(result.failed.size(), 3U) << "the packing and two shearings";
  EXPECT_CONTAINS(result.failed[0].reason, "packing friction 2 seed 1: LIGGGHTS ended with code 1");
  EXPECT_CONTAINS(result.failed[1].reason,
                  "it begins with packing friction 2 seed 1, which failed: LIGGGHTS");
  EXPECT_EQ(calls(), 0U);
  // A packing that does not bear its load, or cannot be read back, is none.
  fs::remove_all(in("out"));
  engine(good, "echo '10 0.011 1000 0' > wall.txt; echo x > end.restart; echo '" +
                   sentinel(300, packing_of(plan).deck.last_step) + "'");
  EXPECT_CONTAINS(run_sweep(plan, options()).failed.at(0).reason, "wall.txt has 1 lines, expected 48");
}

TEST_F(Sweep, KeptDumpsAreReducedAgainWithoutTheEngine) {
  const SweepPlan plan = plan_of(case_text, {"shear_cell.keep_dumps=true"});
  engine(perfect_run(leaf_of(plan)));
  const SweepResult first = run_sweep(plan, options());
  const fs::path done = run_folder(leaf_of(plan)) / "done.json";
  nlohmann::json old = read_json(done);
  old["reduction_version"] = 1;
  old["result"]["mu"]["value"] = 99;
  put(done, old.dump());
  const SweepResult second = run_sweep(plan, options());
  EXPECT_EQ(second.ran, 1U);
  EXPECT_EQ(calls(), 1U);
  ASSERT_EQ(second.observables.steady.size(), 1U);
  EXPECT_EQ(second.observables.steady[0].mu, first.observables.steady[0].mu);
  EXPECT_EQ(second.observables.cpu_seconds(), first.observables.cpu_seconds());
}

TEST_F(Sweep, PruneKeepsResultsAndWhatIsStillNeeded) {
  const SweepPlan plan = plan_of(case_text, {"shear_cell.keep_dumps=true"});
  const std::string good = perfect_run(leaf_of(plan));
  engine("exit 1");
  run_sweep(plan, options());
  EXPECT_EQ(prune_sweep(in("out")), 0U) << "a run that begins with the packing is not done";
  engine(good);
  const SweepResult first = retry_sweep(options());
  EXPECT_GT(prune_sweep(in("out")), 100000U);
  EXPECT_FALSE(fs::exists(run_folder(packing_of(plan)) / restart_file));
  EXPECT_FALSE(fs::exists(run_folder(leaf_of(plan)) / grain_dump_file));
  const SweepResult again = run_sweep(plan, options());
  EXPECT_EQ(again.ran, 0U) << "the packing is not made again for nobody";
  EXPECT_EQ(again.observables.steady[0].mu, first.observables.steady[0].mu);
  // A new run needs it again (and fails here: what the engine leaves belongs to another one).
  const SweepPlan more = plan_of(case_text, {"shear_cell.steady.I=[0.1, 0.2]"});
  EXPECT_EQ(run_sweep(more, options()).ran, 1U);
  EXPECT_TRUE(fs::exists(run_folder(packing_of(plan)) / restart_file));
}

TEST_F(Sweep, StatusLearnsFromWhatIsDone) {
  const SweepPlan plan = plan_of(case_text, {"shear_cell.steady.seeds=[1, 2]"});
  engine(perfect_run(leaf_of(plan)));
  run_sweep(plan, options());
  // As if this machine were three times as slow as the estimate, and one run were still to do.
  for (const RunPlan& run : plan.runs) {
    const fs::path path = run_folder(run) / "done.json";
    nlohmann::json done = read_json(path);
    done["cost"]["cpu_seconds"] = 3 * run.deck.core_seconds;
    put(path, done.dump());
  }
  EXPECT_NEAR(sweep_status(in("out")).slowness, 3, 1e-12);
  EXPECT_EQ(sweep_status(in("out")).core_seconds_left, 0);
  fs::remove(run_folder(leaf_of(plan, 1)) / "done.json");
  const SweepStatus status = sweep_status(in("out"));
  EXPECT_NEAR(status.core_seconds_left, 3 * leaf_of(plan, 1).deck.core_seconds, 1e-9);
  EXPECT_CONTAINS(describe(status), "(3.00 of the estimate)");
}

TEST_F(Sweep, ChainsShareWhatTheyBeginWith) {
  const std::string text =
      std::string(case_text).substr(0, std::string(case_text).find("[shear_cell.steady]")) +
      "[shear_cell.jump]\nI_before = [0.05]\nI = [0.1]\nseeds = [1, 2]\n"
      "[shear_cell.reversal]\nI = [0.05]\nseeds = [1, 2]\n"
      "[shear_cell.pressure_jump]\nI_before = [0.05]\npressure = [\"4 kPa\"]\nseeds = [1, 2]\n";
  const SweepPlan plan = plan_of(text);
  std::map<RunKind, int> count;
  for (const RunPlan& run : plan.runs) ++count[run.kind];
  EXPECT_EQ(count[RunKind::packing], 2);
  EXPECT_EQ(count[RunKind::pre_shear], 2);
  EXPECT_EQ(count[RunKind::jump] + count[RunKind::reversal] + count[RunKind::pressure_jump], 6);
  for (const RunPlan& run : plan.runs) {
    if (run.kind == RunKind::pressure_jump) {
      EXPECT_NEAR(run.shearing.I_driven, 0.025, 1e-15);
    }
    if (run.kind == RunKind::reversal) {
      EXPECT_EQ(run.shearing.direction, -1);
    }
  }
  // It is written beside the runs and comes back as it was.
  const SweepPlan again = sweep_from_json(nlohmann::json::parse(to_json(plan).dump()));
  ASSERT_EQ(again.runs.size(), plan.runs.size());
  for (std::size_t i = 0; i < plan.runs.size(); ++i) EXPECT_EQ(again.runs[i].hash, plan.runs[i].hash);
}

TEST_F(Sweep, ClaimsOfTheLivingAreRespectedThoseOfTheDeadTakenOver) {
  const SweepPlan plan = plan_of(case_text);
  engine(perfect_run(leaf_of(plan)));
  char host[256] = {};
  ASSERT_EQ(::gethostname(host, sizeof host - 1), 0);
  const fs::path claim = run_folder(leaf_of(plan)) / "claim";
  fs::create_directories(claim);
  // A process on another machine cannot be asked: it lives while its heart beats.
  put(claim / "owner.json", R"({"pid": 1, "host": "elsewhere", "started": "1"})");
  testing::internal::CaptureStdout();
  const SweepResult blocked = run_sweep(plan, options());
  const std::string said = testing::internal::GetCapturedStdout();
  EXPECT_CONTAINS(said, "process 1 on elsewhere (heard of ");
  EXPECT_CONTAINS(said, claim.string());
  EXPECT_EQ(blocked.elsewhere, 1U);
  EXPECT_EQ(blocked.exit_code(), ExitCode::interrupted);
  EXPECT_EQ(calls(), 0U);
  EXPECT_EQ(state_of(leaf_of(plan)), RunState::running);
  // Our own process id, but of a process that started at another time: dead.
  put(claim / "owner.json", fmt::format(R"({{"pid": {}, "host": "{}", "started": "1"}})", ::getpid(), host));
  EXPECT_EQ(state_of(leaf_of(plan)), RunState::abandoned);
  const SweepResult taken = run_sweep(plan, options());
  EXPECT_EQ(taken.ran, 1U);
  EXPECT_EQ(taken.exit_code(), ExitCode::ok);
  EXPECT_FALSE(fs::exists(claim));
}

TEST_F(Sweep, AClaimWhoseHeartStoppedIsTakenOver) {
  const SweepPlan plan = plan_of(case_text);
  engine(perfect_run(leaf_of(plan)));
  char host[256] = {};
  ASSERT_EQ(::gethostname(host, sizeof host - 1), 0);
  const fs::path claim = run_folder(leaf_of(plan)) / "claim";
  // Of another machine, and of another container of this one.
  for (const std::string& owner :
       {std::string(R"({"pid": 1, "host": "elsewhere", "started": "1"})"),
        fmt::format(R"({{"pid": 1, "host": "{}", "pid_namespace": "pid:[1]"}})", host)}) {
    fs::remove_all(in("out"));
    fs::create_directories(claim);
    put(claim / "owner.json", owner);
    const auto beat = [&](std::chrono::seconds ago) {
      fs::last_write_time(claim / "owner.json", fs::file_time_type::clock::now() - ago);
    };
    beat(std::chrono::seconds(200));
    EXPECT_EQ(run_sweep(plan, options()).elsewhere, 1U) << owner;
    beat(std::chrono::seconds(310));
    EXPECT_EQ(state_of(leaf_of(plan)), RunState::abandoned) << owner;
    EXPECT_EQ(run_sweep(plan, options()).ran, 1U) << owner;
  }
}

TEST_F(Sweep, OfManyThatFindADeadClaimOneTakesIt) {
  const SweepPlan plan = plan_of(case_text);
  engine(perfect_run(leaf_of(plan)) + "; sleep 0.2");
  char host[256] = {};
  ASSERT_EQ(::gethostname(host, sizeof host - 1), 0);
  const fs::path claim = run_folder(leaf_of(plan)) / "claim";
  for (std::size_t round = 1; round <= 5; ++round) {
    fs::remove_all(in("out"));
    fs::create_directories(claim);
    put(claim / "owner.json",
        fmt::format(R"({{"pid": {}, "host": "{}", "started": "1"}})", ::getpid(), host));
    std::vector<std::jthread> sweeps;
    for (int i = 0; i < 6; ++i) sweeps.emplace_back([&] { run_sweep(plan, options()); });
    sweeps.clear();  // joins
    EXPECT_EQ(calls(), round);
    EXPECT_FALSE(fs::exists(claim));
    EXPECT_EQ(state_of(leaf_of(plan)), RunState::done);
  }
}

TEST_F(Sweep, AStopThatReachesTheEngineTooIsNoFailure) {
  testing::GTEST_FLAG(death_test_style) = "threadsafe";
  // A batch system signals every process, in any order; an engine may also end with a code of its own.
  for (const char* end :
       {"(sleep 0.1; kill -TERM $PPID) & kill -TERM $$", "kill -TERM $PPID; kill -TERM $$",
        "kill -TERM $PPID; exit 1", "kill -TERM $PPID; exit 0", "(sleep 0.1; kill -TERM $PPID) & exit 143"}) {
    const auto stopped = [&] {
      engine(end);
      const SweepPlan plan = plan_of(case_text);
      install_stop_handlers();
      int code = 0;
      try {
        run_sweep(plan, options());
      } catch (const Error& error) {
        code = static_cast<int>(error.code());
      }
      const bool clean = !fs::exists(run_folder(leaf_of(plan)) / "failed.json") &&
                         !fs::exists(run_folder(leaf_of(plan)) / "claim");
      fs::remove_all(folder_);
      ::_exit(clean ? code : 99);
    };
    EXPECT_EXIT(stopped(), testing::ExitedWithCode(75), "") << end;
  }
}

TEST_F(Sweep, AStopEndsTheEngineAndCanBeResumed) {
  testing::GTEST_FLAG(death_test_style) = "threadsafe";
  engine("echo $$ > " + in("pid").string() + "; exec sleep 60");
  const SweepPlan plan = plan_of(case_text);
  const auto stopped = [&] {
    install_stop_handlers();
    std::jthread asker([&] {
      while (!fs::exists(in("pid"))) std::this_thread::sleep_for(std::chrono::milliseconds(10));
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
      ::kill(::getpid(), SIGTERM);
    });
    try {
      run_sweep(plan, options());
    } catch (const Error& error) {
      pid_t engine_process = 0;
      std::ifstream(in("pid")) >> engine_process;
      const bool ended = engine_process > 0 && ::kill(engine_process, 0) != 0;
      const bool free = !fs::exists(run_folder(leaf_of(plan)) / "claim");
      fs::remove_all(folder_);
      ::_exit(ended && free ? static_cast<int>(error.code()) : 99);
    }
  };
  EXPECT_EXIT(stopped(), testing::ExitedWithCode(75), "");
}

TEST_F(Sweep, AMissingEngineIsNamedWithItsPackage) {
  ::setenv("DEM2SPH_LIGGGHTS", "/nonexistent/liggghts", 1);
  const std::string message = message_of<EngineError>([] { engine_version(); });
  EXPECT_CONTAINS(message, "LIGGGHTS not found");
  EXPECT_CONTAINS(message, "apt-get install --no-install-recommends liggghts");
  EXPECT_EQ(EngineError("").code(), ExitCode::engine);
  engine("exit 0");
  ::setenv("DEM2SPH_LIGGGHTS", in("engine").c_str(), 1);
  EXPECT_EQ(engine_version(), "LIGGGHTS-PUBLIC 3.8.0");
  put(in("engine"), "#!/bin/sh\necho hello\n");
  EXPECT_CONTAINS(message_of<EngineError>([] { engine_version(); }), "does not report a LIGGGHTS version");
}

TEST_F(Sweep, TheCaseIsChecked) {
  const auto refusal = [](const std::string& text, const std::vector<std::string>& overrides = {}) {
    return message_of<UsageError>([&] { plan_of(text, overrides); });
  };
  EXPECT_CONTAINS(refusal("[material]\nd = \"1 mm\"\n"), "needs a section [shear_cell]");
  EXPECT_CONTAINS(refusal(case_text, {"material.kappa=1000", "material.youngs_modulus=10 MPa"}),
                  "\"kappa\" or \"youngs_modulus\", not both");
  EXPECT_CONTAINS(refusal(case_text, {"material.contact=hooke"}), "contact = \"hooke\" needs \"kappa\"");
  EXPECT_CONTAINS(
      refusal(case_text, {"material.contact=hooke", "material.kappa=1e3", "material.poisson_ratio=0.2"}),
      "\"poisson_ratio\" changes nothing with contact = \"hooke\"");
  EXPECT_CONTAINS(refusal(case_text, {"material.kappa=200"}), "LIGGGHTS takes no less than 5 MPa");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.retries=3"}),
                  "\"retries\" changes nothing with on_failure = \"skip\"");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.jump.I_before=[0.1]", "shear_cell.jump.I=[0.1]"}),
                  "no jump");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.jump.I_before=[0.1]", "shear_cell.jump.I=[0.1, 0.2]"}),
                  "\"I\" has 2 entries and \"I_before\" 1");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.pressure_jump.I_before=[0.1]",
                                      "shear_cell.pressure_jump.pressure=[\"1 kPa\"]"}),
                  "no jump");
  EXPECT_CONTAINS(refusal(case_text, {"material.contact=herz"}), "did you mean \"hertz\"?");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.grains=150"}), "raise \"grains\"");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.steady.I=[0.1, 0.1]"}), "asked for twice");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.steady.I=[]"}), "empty list");
  EXPECT_CONTAINS(refusal(case_text, {"shear_cell.start_up.window=1", "shear_cell.start_up.strain=2"}),
                  "fewer than 4");
  const std::string text = case_text;
  EXPECT_CONTAINS(refusal(text.substr(0, text.find("[shear_cell.steady]"))), "nothing to run");
  EXPECT_CONTAINS(refusal(text + "frame = 3\n"), "case.toml:21: [shear_cell.steady] unknown key \"frame\"");
}

TEST_F(Sweep, RunsAreNamedByWhatTheyAre) {
  const auto hash_with = [](const std::vector<std::string>& overrides) {
    return leaf_of(plan_of(case_text, overrides)).hash;
  };
  const std::string hash = hash_with({});
  EXPECT_EQ(hash, hash_with({}));
  for (const char* other : {"material.d=2 mm", "shear_cell.steady.seeds=[2]", "shear_cell.steady.frames=81",
                            "shear_cell.pressure=2 kPa", "material.grain_friction=0.4"})
    EXPECT_NE(hash, hash_with({other})) << other;
  // What does not change a run's results does not change its name.
  EXPECT_EQ(hash, hash_with({"shear_cell.time_limit=99 s"}));
  EXPECT_NE(hash, leaf_of(plan_sweep(CaseFile::parse(case_text, "case.toml"), "LIGGGHTS-PUBLIC 4.0")).hash);
  // One packing serves flows of every friction.
  EXPECT_EQ(packing_of(plan_of(case_text)).hash,
            packing_of(plan_of(case_text, {"shear_cell.steady.I=[0.2]"})).hash);
}

TEST_F(Sweep, TheLongestComesFirst) {
  const SweepPlan plan = plan_of(case_text, {"shear_cell.steady.I=[0.3, 0.01, 0.1]"});
  EXPECT_EQ(leaf_of(plan).shearing.I_driven, 0.01);
  EXPECT_EQ(plan.runs[0].kind, RunKind::packing) << "what the longest begins with";
  double sum = 0, longest = 0;
  for (const RunPlan& run : plan.runs)
    sum += run.deck.core_seconds, longest = std::max(longest, run.deck.core_seconds);
  EXPECT_DOUBLE_EQ(plan.wall_seconds(1), sum);
  EXPECT_DOUBLE_EQ(plan.wall_seconds(3), longest);
}

}  // namespace
}  // namespace dem2sph::bridge
