#include "dem_bridge/run.hpp"

#include <fmt/format.h>

#include <cmath>
#include <vector>

#include "dem_bridge/reduce.hpp"
#include "dem_bridge/runner.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph::bridge {

namespace fs = std::filesystem;

namespace {

constexpr const char* done_file = "done.json";
constexpr const char* failed_file = "failed.json";
constexpr const char* failed_attempt = "failed";

/// A steady run whose halves differ by this much, and significantly, was not steady.
constexpr double steady_phi_tolerance = 0.01;
constexpr double steady_mu_tolerance = 0.05;
constexpr double steady_standard_errors = 3;

nlohmann::json to_json(const Estimate& e) {
  return {{"value", e.value}, {"standard_error", e.standard_error}, {"block", e.block}, {"flat", e.flat}};
}

void require_finite(const nlohmann::json& value, const std::string& name) {
  if (value.is_structured()) {
    for (const auto& [key, item] : value.items()) require_finite(item, name + "." + key);
  } else if (value.is_number_float() && !std::isfinite(value.get<double>())) {
    throw EngineError(fmt::format("{} is not a finite number", name));
  }
}

nlohmann::json steady_result(const RunPlan& run, const CellRecord& record) {
  const SteadyMeans means = reduce_steady(record.frames, run.shearing.strain_dropped,
                                          measurement_of(run.sample, run.shearing, run.core_margin));
  const auto require_steady = [](const char* what, double change, double drift, double value,
                                 double tolerance) {
    if (std::abs(drift) > steady_standard_errors && std::abs(change) > tolerance * value)
      throw UnfitRun(
          fmt::format("not steady: {} changes by {:.2g} from the first half of the averaged strain to the "
                      "second, {:.2g} standard "
                      "errors; drop more strain",
                      what, change, drift));
  };
  require_steady("phi", means.phi_change, means.phi_drift, means.phi.value, steady_phi_tolerance);
  require_steady("mu", means.mu_change, means.mu_drift, means.mu.value, steady_mu_tolerance);
  return {{"mu", to_json(means.mu)},
          {"phi", to_json(means.phi)},
          {"p", to_json(means.p)},
          {"I", to_json(means.I)},
          {"N1", to_json(means.N1)},
          {"N2", to_json(means.N2)},
          {"beta", to_json(means.beta)},
          {"temperature", means.temperature},
          {"coordination", means.coordination},
          {"fabric_xz", means.fabric_xz},
          {"strain", means.strain},
          {"frames", means.frames},
          {"phi_drift", means.phi_drift},
          {"mu_drift", means.mu_drift}};
}

nlohmann::json transient_result(const RunPlan& run, const CellRecord& record) {
  const Transient t =
      reduce_transient(record.frames, run.window, measurement_of(run.sample, run.shearing, run.core_margin));
  return {{"phi_0", t.phi_0}, {"s", t.s},     {"gamma_dot", t.gamma_dot}, {"p", t.p},          {"mu", t.mu},
          {"I", t.I},         {"phi", t.phi}, {"beta", t.beta},           {"height", t.height}};
}

/// What is left of attempts and claims of processes that were killed. Only the holder of the claim calls it;
/// the lock keeps away those that are just making a claim.
void remove_leftovers(const fs::path& folder, const std::string& ours) {
  const SweepLock lock(folder.parent_path());
  std::vector<fs::path> old;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (name.ends_with(ours)) continue;
    if (name.starts_with("attempt.") || name.starts_with("claim.stale.") || name.starts_with("claim.new."))
      old.push_back(entry.path());
  }
  for (const fs::path& path : old) {
    std::error_code busy;  // an engine that is still dying may write: the next one cleans up
    fs::remove_all(path, busy);
  }
}

void require_claim(const Claim& claim, const fs::path& folder) {
  if (!claim.is_ours())
    throw Interrupted(
        fmt::format("{}: taken over by another sweep while this one stood still", folder.string()));
}

/// Result and evidence from the files in `where`.
nlohmann::json reduce(const RunPlan& run, const fs::path& where, const EngineLimits& limits) {
  nlohmann::json verdict;
  if (prepares(run.kind)) {
    check_restart(run.sample, where, limits);
    // The piston must have come to rest under its load: the last quarter of a packing, half of a shearing.
    const bool packing = run.kind == RunKind::packing;
    const std::int64_t judged = run.deck.wall_samples / (packing ? 4 : 2);
    const WallMeans wall = read_wall(run.deck, packing ? run.sample.pressure : run.shearing.pressure,
                                     packing ? 0 : expected_gap(run.sample) + 2 * wall_thickness_in_d,
                                     run.deck.last_step - judged * run.deck.frame_interval, where);
    verdict["result"] = {{"height", wall.height}};
    verdict["evidence"] = {{"last_step", run.deck.last_step},
                           {"wall_p", wall.p},
                           {"wall_tau", wall.tau},
                           {"restart_bytes", fs::file_size(where / restart_file)}};
    return verdict;
  }
  const CellRecord record = read_run(run.sample, run.shearing, run.core_margin, where);
  verdict["result"] =
      run.kind == RunKind::steady ? steady_result(run, record) : transient_result(run, record);
  verdict["evidence"] = {{"last_step", run.deck.last_step},
                         {"frames", record.frames.size()},
                         {"wall_p", record.wall.p},
                         {"wall_mu", record.wall.tau / record.wall.p * run.shearing.direction},
                         {"overlap_over_d", record.overlap},
                         {"largest_overlap_over_d", record.largest_overlap},
                         {"contacts_cut_to_coulomb", record.cut_contacts}};
  return verdict;
}

void write_verdict(const RunPlan& run, const SweepPlan& plan, const fs::path& folder, nlohmann::json verdict,
                   const nlohmann::json& cost) {
  require_finite(verdict, "verdict");  // JSON has no NaN: it would come back as null
  nlohmann::json done = to_json(run);
  done.update(verdict);
  done["hash"] = run.hash;
  done["engine"] = plan.engine;
  done["deck_version"] = deck_version;
  done["reduction_version"] = reduction_version;
  done["cost"] = cost;
  done["provenance"] = provenance();
  write_file_atomically(folder / done_file, done.dump(1) + "\n");
}

bool has_dumps(const fs::path& folder) {
  return fs::exists(folder / grain_dump_file) && fs::exists(folder / contact_dump_file) &&
         fs::exists(folder / wall_series_file);
}

}  // namespace

fs::path folder_of(const fs::path& sweep_folder, const RunPlan& run) {
  return sweep_folder / "runs" / run.hash;
}

bool is_done(const RunPlan& run, const fs::path& folder) {
  if (!fs::exists(folder / done_file)) return false;
  if (prepares(run.kind)) return fs::exists(folder / restart_file);
  return read_json(folder / done_file).value("reduction_version", 0) == reduction_version;
}

bool is_failed(const fs::path& folder) { return fs::exists(folder / failed_file); }

double measured_core_seconds(const fs::path& folder) {
  const fs::path path = folder / done_file;
  try {
    return read_json(path).at("cost").at("cpu_seconds").get<double>();
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("{}: damaged ({})", path.string(), error.what()));
  }
}

std::string reason_of_failure(const fs::path& folder) {
  return read_json(folder / failed_file).value("reason", "no reason given");
}

void clear_failure(const fs::path& folder) {
  fs::remove_all(folder / failed_attempt);
  fs::remove(folder / failed_file);
}

void carry_out(const RunPlan& run, const SweepPlan& plan, const fs::path& sweep_folder, const Claim& claim) {
  const fs::path folder = folder_of(sweep_folder, run);
  remove_leftovers(folder, claim.name());
  if (fs::exists(folder / done_file) && has_dumps(folder)) {
    const nlohmann::json cost = read_json(folder / done_file).value("cost", nlohmann::json::object());
    const nlohmann::json verdict = reduce(run, folder, plan.limits);
    require_claim(claim, folder);
    write_verdict(run, plan, folder, verdict, cost);
    return;
  }

  const fs::path attempt = folder / ("attempt." + claim.name());
  fs::remove_all(attempt);  // of an earlier try of ours
  fs::create_directory(attempt);
  write_file_atomically(attempt / "run.json", to_json(run).dump(1) + "\n");
  EngineJob job;
  job.sentinel = sentinel(run.sample.grains, run.deck.last_step);
  job.ranks = run.sample.ranks;
  job.dump_bytes = run.deck.dump_bytes;
  if (run.kind == RunKind::packing) {
    job.deck = packing_deck(run.sample);
  } else {
    job.deck =
        shearing_deck(run.sample, run.shearing, fmt::format("../../{}/{}", run.begins_with, restart_file));
    // LIGGGHTS names none of the columns of a local dump: their meaning is kept beside it.
    if (run.shearing.frames > 0)
      write_file_atomically(
          attempt / "columns.json",
          R"({"contacts.dump": ["id_1", "id_2", "periodic", "force_x", "force_y", "force_z"]})"
          "\n");
  }
  const EngineRun engine = run_engine(job, attempt, plan.limits);
  const nlohmann::json verdict = reduce(run, attempt, plan.limits);
  require_claim(claim, folder);
  std::vector<fs::path> made;
  for (const fs::directory_entry& entry : fs::directory_iterator(attempt)) made.push_back(entry.path());
  for (const fs::path& path : made) {
    const bool dump = path.filename() == grain_dump_file || path.filename() == contact_dump_file;
    if (dump && !plan.keep_dumps)
      fs::remove(path);
    else
      fs::rename(path, folder / path.filename());
  }
  fs::remove(attempt);
  write_verdict(run, plan, folder, verdict,
                {{"wall_seconds", engine.wall_seconds}, {"cpu_seconds", engine.cpu_seconds}});
}

void record_failure(const RunPlan& run, const fs::path& folder, const std::string& reason, long attempts) {
  fs::remove_all(folder / failed_attempt);
  for (const fs::directory_entry& entry : fs::directory_iterator(folder))
    if (entry.path().filename().string().starts_with("attempt.")) {
      fs::rename(entry.path(), folder / failed_attempt);
      break;
    }
  const nlohmann::json failure{
      {"hash", run.hash}, {"run", title(run)}, {"reason", reason}, {"attempts", attempts}};
  write_file_atomically(folder / failed_file, failure.dump(1) + "\n");
}

void collect(const RunPlan& run, const fs::path& folder, Observables& observables) {
  const fs::path path = folder / done_file;
  const nlohmann::json done = read_json(path);
  try {
    const nlohmann::json& result = done.at("result");
    const nlohmann::json& evidence = done.at("evidence");
    observables.costs.push_back(
        {run.hash, name_of(run.kind), done.at("cost").at("cpu_seconds").get<double>()});
    if (prepares(run.kind)) return;
    if (run.kind == RunKind::steady) {
      const auto value = [&](const char* key) { return result.at(key).at("value").get<double>(); };
      const auto error = [&](const char* key) { return result.at(key).at("standard_error").get<double>(); };
      const auto flat = [&](const char* key) { return result.at(key).at("flat").get<bool>(); };
      SteadyPoint point;
      point.run = run.hash;
      point.seed = run.sample.seed;
      point.I_driven = run.shearing.I_driven;
      point.I = value("I"), point.I_se = error("I");
      point.mu = value("mu"), point.mu_se = error("mu");
      point.phi = value("phi"), point.phi_se = error("phi");
      point.p = value("p"), point.p_se = error("p");
      point.N1 = value("N1"), point.N1_se = error("N1");
      point.N2 = value("N2"), point.N2_se = error("N2");
      point.beta = value("beta"), point.beta_se = error("beta");
      result.at("temperature").get_to(point.temperature);
      result.at("coordination").get_to(point.coordination);
      result.at("fabric_xz").get_to(point.fabric_xz);
      evidence.at("wall_mu").get_to(point.wall_mu);
      evidence.at("wall_p").get_to(point.wall_p);
      result.at("strain").get_to(point.strain);
      point.I_flat = flat("I"), point.mu_flat = flat("mu"), point.phi_flat = flat("phi");
      result.at("phi_drift").get_to(point.phi_drift);
      observables.steady.push_back(point);
      return;
    }
    Transient t;
    t.run = run.hash;
    t.kind = name_of(run.kind);
    t.seed = run.sample.seed;
    t.I_driven = run.shearing.I_driven;
    t.I_before = run.I_before;
    t.load = run.shearing.pressure;
    t.load_before = run.sample.pressure;
    t.packing_friction = run.sample.packing_friction;
    result.at("phi_0").get_to(t.phi_0);
    result.at("s").get_to(t.s);
    result.at("gamma_dot").get_to(t.gamma_dot);
    result.at("p").get_to(t.p);
    result.at("mu").get_to(t.mu);
    result.at("I").get_to(t.I);
    result.at("phi").get_to(t.phi);
    result.at("beta").get_to(t.beta);
    result.at("height").get_to(t.height);
    observables.transients.push_back(std::move(t));
  } catch (const nlohmann::json::exception& error) {
    throw InputError(
        fmt::format("{}: damaged ({}); remove the folder to run it again", path.string(), error.what()));
  }
}

std::uintmax_t prune(const fs::path& folder) {
  std::uintmax_t bytes = 0;
  for (const char* name : {grain_dump_file, contact_dump_file, restart_file}) {
    const fs::path path = folder / name;
    if (!fs::exists(path)) continue;
    bytes += fs::file_size(path);
    fs::remove(path);
  }
  if (fs::exists(folder / failed_attempt)) {
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder / failed_attempt))
      if (entry.is_regular_file()) bytes += entry.file_size();
    fs::remove_all(folder / failed_attempt);
  }
  return bytes;
}

}  // namespace dem2sph::bridge
