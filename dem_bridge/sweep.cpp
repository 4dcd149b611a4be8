#include "dem_bridge/sweep.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <csignal>
#include <cstring>
#include <exception>
#include <fstream>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <queue>
#include <thread>

#include "sph/base/errors.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph::bridge {

namespace fs = std::filesystem;

namespace {

const ParameterTable material_table{
    "material",
    "The grains. One material for flow and walls; five sizes in equal numbers.",
    {
        {"d", Kind::quantity, "m", 1e-6, 1, "required", "Mean grain diameter."},
        {"rho_s", Kind::quantity, "kg/m^3", 1, 3e4, "required", "Density of the grains' material."},
        {"grain_friction", Kind::number, "", 0, 2, "required", "Coulomb friction between two grains."},
        {"restitution", Kind::number, "", 0.05, 0.98, "0.5",
         "Rebound speed over impact speed of two grains."},
        {"size_spread", Kind::number, "", 0, 0.4, "0.2", "Sizes from d (1 - spread) to d (1 + spread)."},
        {"contact",
         Kind::word,
         "",
         -unbounded,
         unbounded,
         "hertz",
         "Contact law: Hertz-Mindlin, or linear springs (hooke).",
         {"hertz", "hooke"}},
        {"youngs_modulus", Kind::quantity, "Pa", 5e6, 1e12, "10 MPa",
         "Of the grains (hertz); the softer, the longer the time step. LIGGGHTS takes no less than 5 MPa."},
        {"poisson_ratio", Kind::number, "", 0, 0.49, "0.3", "Of the grains (hertz)."},
        {"stiffness", Kind::number, "", 100, 1e7, "1000", "Spring constant over P d (hooke)."},
    }};

const ParameterTable cell_table{
    "shear_cell",
    "Plane shear at constant pressure between rough walls, periodic along the flow and across, no gravity.",
    {
        {"pressure", Kind::quantity, "Pa", 1e-3, 1e9, "1 kPa", "Load on the top wall over its area."},
        {"grains", Kind::integer, "", 100, 1e6, "900", "Number of grains, walls included."},
        {"length", Kind::number, "", 5, 1000, "8", "Of the cell along the flow, in d."},
        {"width", Kind::number, "", 5, 1000, "6", "Of the cell across, in d."},
        {"core_margin", Kind::number, "", 1, 100, "4", "Distance of the measured core from the walls, in d."},
        {"time_step_fraction", Kind::number, "", 0.01, 0.3, "0.2",
         "Time step over the Rayleigh time of the smallest grain (hertz) or a quarter contact (hooke)."},
        {"time_limit", Kind::quantity, "s", 1, 1e7, "7200 s",
         "A run that takes longer is ended and has failed."},
        {"memory_limit", Kind::number, "", 0.5, 1024, "4", "Address space of a run in GiB."},
        {"keep_dumps", Kind::flag, "", -unbounded, unbounded, "false",
         "Keep the dumps after their reduction."},
    }};

const ParameterTable steady_table{
    "shear_cell.steady",
    "Steady points: mu, phi and I with standard errors, one for each I and seed.",
    {
        {"I", Kind::numbers, "", 1e-5, 2, "required", "Driven inertial numbers (the core's own differs)."},
        {"seeds", Kind::integers, "", 0, 1e9, "[1]", "One run of every I for each seed."},
        {"strain_dropped", Kind::number, "", 0.5, 1e4, "2", "Strain before averaging begins, at least."},
        {"strain_used", Kind::number, "", 0.5, 1e5, "6", "Strain that is averaged over, at least."},
        {"responses_dropped", Kind::number, "", 0.5, 100, "2",
         "Before averaging, at least this many response times of cell and piston, each a strain I H/d."},
        {"responses_used", Kind::number, "", 0.5, 1e4, "4", "The same for averaging."},
        {"frames", Kind::integer, "", 64, 1e5, "400", "Frames in the averaged part."},
    }};

const ParameterTable start_up_table{
    "shear_cell.start_up",
    "Start-ups: a sample is packed, then sheared at constant I; series of phi, beta, mu over strain.",
    {
        {"I", Kind::numbers, "", 1e-5, 2, "[0.03]", "Driven inertial numbers."},
        {"seeds", Kind::integers, "", 0, 1e9, "[1, 2, 3, 4]", "One run of every I for each seed."},
        {"preparation",
         Kind::word,
         "",
         -unbounded,
         unbounded,
         "dense",
         "Packed without friction (dense) or with the grains' own (loose).",
         {"dense", "loose"}},
        {"strain", Kind::number, "", 0.1, 1000, "5", "Strain that is recorded."},
        {"frames", Kind::integer, "", 20, 1e5, "500", "Frames in it."},
        {"window", Kind::number, "", 1e-4, 1, "0.05", "Strain that one entry of the series averages over."},
    }};

constexpr const char* engine_unknown = "unknown";
constexpr int sweep_file_version = 1;

nlohmann::json run_json(const RunPlan& run) {
  return {{"kind", name_of(run.kind)}, {"cell", to_json(run.cell)}, {"window", run.window}};
}

/// 64 bits of SHA-256: two of a million runs share a name with a probability of 3e-8.
std::string hash_of(const RunPlan& run, const std::string& engine) {
  nlohmann::json identity = run_json(run);
  identity["engine"] = engine;
  identity["deck_version"] = deck_version;
  return sha256(identity.dump()).substr(0, 16);
}

void complete_plan(RunPlan& run, const std::string& engine) {
  run.deck = plan_deck(run.cell);
  run.hash = hash_of(run, engine);
}

void longest_first(std::vector<RunPlan>& runs) {
  std::stable_sort(runs.begin(), runs.end(), [](const RunPlan& a, const RunPlan& b) {
    return a.deck.core_seconds > b.deck.core_seconds;
  });
}

std::string title(const RunPlan& run) {
  return fmt::format("{} I = {:g} seed {}", name_of(run.kind), run.cell.I_driven, run.cell.seed);
}

}  // namespace

std::string name_of(RunKind kind) { return kind == RunKind::steady ? "steady" : "start_up"; }

std::vector<const ParameterTable*> sweep_tables() {
  return {&material_table, &cell_table, &steady_table, &start_up_table};
}

double SweepPlan::core_seconds() const {
  double sum = 0;
  for (const RunPlan& run : runs) sum += run.deck.core_seconds;
  return sum;
}

double SweepPlan::wall_seconds(int jobs) const {
  std::priority_queue<double, std::vector<double>, std::greater<>> free_at;
  for (int j = 0; j < std::max(1, jobs); ++j) free_at.push(0);
  double last = 0;
  for (const RunPlan& run : runs) {
    const double end = free_at.top() + run.deck.core_seconds;
    free_at.pop();
    free_at.push(end);
    last = std::max(last, end);
  }
  return last;
}

SweepPlan plan_sweep(const CaseFile& case_file, const std::string& engine) {
  for (const char* section : {"material", "shear_cell"})
    if (!case_file.has(section))
      throw UsageError(fmt::format("{}: a sweep needs a section [{}]", case_file.path().string(), section));

  ShearCell base;
  const Section material = case_file.section(material_table);
  GrainMaterial& m = base.material;
  m.d = material.quantity("d");
  m.rho_s = material.quantity("rho_s");
  m.grain_friction = material.number("grain_friction");
  m.restitution = material.number("restitution");
  m.size_spread = material.number("size_spread");
  m.contact = material.word("contact") == "hertz" ? ContactModel::hertz : ContactModel::hooke;
  if (m.contact == ContactModel::hertz) {
    m.youngs_modulus = material.quantity("youngs_modulus");
    m.poisson_ratio = material.number("poisson_ratio");
  } else {
    m.stiffness = material.number("stiffness");
  }
  material.finish(fmt::format("with contact = \"{}\"", material.word("contact")));

  SweepPlan plan;
  plan.engine = engine;
  const Section cell = case_file.section(cell_table);
  base.pressure = cell.quantity("pressure");
  base.grains = cell.integer("grains");
  base.length = cell.number("length");
  base.width = cell.number("width");
  base.core_margin = cell.number("core_margin");
  base.time_step_fraction = cell.number("time_step_fraction");
  plan.limits.seconds = cell.quantity("time_limit");
  plan.limits.memory = static_cast<std::size_t>(cell.number("memory_limit") * 1024 * 1024 * 1024);
  plan.keep_dumps = cell.flag("keep_dumps");
  cell.finish();

  const auto add = [&](const Section& section, RunKind kind, const ShearCell& common, double window) {
    const std::vector<double> inertial_numbers = section.numbers("I");
    const std::vector<long> seeds = section.integers("seeds");
    if (inertial_numbers.empty()) section.refuse("I", "\"I\" is an empty list");
    if (seeds.empty()) section.refuse("seeds", "\"seeds\" is an empty list");
    for (const double inertial_number : inertial_numbers)
      for (const long seed : seeds) {
        RunPlan run;
        run.kind = kind;
        run.cell = common;
        run.window = window;
        run.cell.I_driven = inertial_number;
        run.cell.seed = seed;
        if (kind == RunKind::steady) {
          // Cell and piston respond within H sqrt(rho/P), which is a strain of I H/d.
          const double response = inertial_number * (expected_gap(common) + 2 * wall_thickness_in_d);
          run.cell.strain_dropped =
              std::max(section.number("strain_dropped"), section.number("responses_dropped") * response);
          run.cell.strain_used =
              std::max(section.number("strain_used"), section.number("responses_used") * response);
        }
        try {
          complete_plan(run, engine);
        } catch (const UsageError& error) {
          throw UsageError(fmt::format("{}: [shear_cell] {}", cell.where("grains"), error.what()));
        }
        for (const RunPlan& other : plan.runs)
          if (other.hash == run.hash)
            section.refuse("I", fmt::format("the run {} is asked for twice", title(run)));
        plan.runs.push_back(run);
      }
  };
  if (case_file.has(steady_table.section)) {
    const Section steady = case_file.section(steady_table);
    ShearCell common = base;
    common.preparation_friction = m.grain_friction;
    common.frames = steady.integer("frames");
    add(steady, RunKind::steady, common, 0);
    steady.finish();
  }
  if (case_file.has(start_up_table.section)) {
    const Section start_up = case_file.section(start_up_table);
    ShearCell common = base;
    common.preparation_friction = start_up.word("preparation") == "dense" ? 0 : m.grain_friction;
    common.strain_used = start_up.number("strain");
    common.frames = start_up.integer("frames");
    const double window = start_up.number("window");
    if (!(window <= common.strain_used / 4))
      start_up.refuse("window",
                      fmt::format("\"window\" = {:g} leaves fewer than 4 entries in a strain of {:g}", window,
                                  common.strain_used));
    add(start_up, RunKind::start_up, common, window);
    start_up.finish();
  }
  if (plan.runs.empty())
    throw UsageError(fmt::format("{}: nothing to run: give [shear_cell.steady] or [shear_cell.start_up]",
                                 case_file.path().string()));
  longest_first(plan.runs);

  // Only the sections that describe the grains and the cell: the material that the figures belong to.
  const std::string effective = case_file.effective();
  for (const char* section : {"[material]\n", "[shear_cell]\n"}) {
    const std::size_t from = effective.find(section);
    const std::size_t to = effective.find("\n\n", from);
    plan.material += effective.substr(from, to == std::string::npos ? to : to + 2 - from);
  }
  return plan;
}

std::string describe(const SweepPlan& plan, int jobs) {
  // A run's name contains the engine's version: without it there is no name to show.
  const bool named = plan.engine != engine_unknown;
  std::string text =
      fmt::format("{} shear-cell runs{}\n", plan.runs.size(), named ? " with " + plan.engine : "");
  for (const RunPlan& run : plan.runs)
    text += fmt::format(
        "  {}{:<32} strain {:.3g} + {:.3g}, {} frames, {:.2g} million steps, about {:.0f} core-seconds\n",
        named ? run.hash + "  " : "", title(run), run.cell.strain_dropped, run.cell.strain_used,
        run.deck.frames, static_cast<double>(run.deck.last_step) * 1e-6, run.deck.core_seconds);
  text += fmt::format("  together about {:.0f} core-seconds, {:.0f} s with {} at once\n", plan.core_seconds(),
                      plan.wall_seconds(jobs), jobs);
  return text;
}

// --------------------------------------------------------------------------------------------------------------
// Claims

namespace {

std::string host_name() {
  char name[256] = {};
  if (::gethostname(name, sizeof name - 1) != 0) return "unknown";
  return name;
}

/// When a process started, in clock ticks since boot: a process id alone may have been given to another
/// process since.
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

struct Owner {
  bool alive = false;
  std::string text;
};

/// Who holds the claim in a run's folder; nothing if there is none.
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
  if (!fs::exists(file, status)) {
    // Between the mkdir and the file lie milliseconds: a minute later nobody is coming.
    return Owner{age(claim) < std::chrono::minutes(1), "an unknown process"};
  }
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
  if (host == host_name() && owner.value("pid_namespace", pid_namespace()) == pid_namespace())
    return Owner{start_of_process(pid) == owner.value("started", ""), text};
  // A process of another machine or container cannot be asked: its heartbeat has to tell.
  const std::chrono::seconds silent = age(file);
  if (silent == std::chrono::seconds::max()) return std::nullopt;
  return Owner{silent < heartbeat_limit, fmt::format("{} (heard of {} s ago)", text, silent.count())};
}

/// While it lives, no other process or thread looks at the claims in `runs`, or writes what sweeps share.
class SweepLock {
 public:
  explicit SweepLock(const fs::path& runs)
      : file_(::open((runs / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666)) {
    if (file_ < 0)
      throw InputError(
          fmt::format("{}: cannot open it for writing: {}", (runs / "lock").string(), std::strerror(errno)));
    // A file system without locks refuses: the claims themselves, atomic as they are, must do there.
    while (::flock(file_, LOCK_EX) != 0 && errno == EINTR) continue;
  }
  ~SweepLock() { ::close(file_); }
  SweepLock(const SweepLock&) = delete;
  SweepLock& operator=(const SweepLock&) = delete;

 private:
  int file_;
};

/// The right to work in a run's folder, given back at the end of its life. A thread keeps its heart beating.
class Claim {
 public:
  /// Nothing if somebody who is alive holds it; `holder` then says who.
  static std::unique_ptr<Claim> take(const fs::path& run_folder, std::string* holder = nullptr) {
    const fs::path path = run_folder / "claim";
    // Judging the owner dead and taking its place are one act: two that do it at once would move each other's
    // fresh claims away.
    const SweepLock lock(run_folder.parent_path());
    for (int attempt = 0; attempt < 3; ++attempt) {
      if (fs::create_directory(path)) {  // atomic: only one process makes it
        const long pid = ::getpid();
        static std::atomic<long> count{0};
        const nlohmann::json owner{{"pid", pid},
                                   {"host", host_name()},
                                   {"pid_namespace", pid_namespace()},
                                   {"started", start_of_process(pid)},
                                   {"claim", ++count}};
        const std::string text = owner.dump() + "\n";
        write_file_atomically(path / "owner.json", text);
        return std::unique_ptr<Claim>(new Claim(path, text));
      }
      const std::optional<Owner> owner = owner_of(run_folder);
      if (owner && owner->alive) {
        if (holder != nullptr) *holder = owner->text;
        return nullptr;
      }
      if (!owner) continue;  // released while we looked
      // Left by a process that is dead: moved first, so that no half-removed claim is ever seen.
      const fs::path stale = run_folder / fmt::format("claim.stale.{}", ::getpid());
      std::error_code status;
      fs::rename(path, stale, status);
      if (!status) fs::remove_all(stale);
    }
    if (holder != nullptr) *holder = "an unknown process";
    return nullptr;
  }

  /// False once another process has judged us dead (after a long suspension, say) and taken over.
  bool is_ours() const {
    std::ifstream file(path_ / "owner.json");
    std::string line;
    std::getline(file, line);
    return line + "\n" == text_;
  }

  ~Claim() {
    beating_ = {};  // joins
    try {
      const SweepLock lock(path_.parent_path().parent_path());
      if (!is_ours()) return;
      std::error_code ignored;  // a claim that stays behind is taken over, since this process will be dead
      fs::remove_all(path_, ignored);
    } catch (const std::exception&) {  // the same holds without a lock
    }
  }
  Claim(const Claim&) = delete;
  Claim& operator=(const Claim&) = delete;

 private:
  Claim(fs::path path, std::string text) : path_(std::move(path)), text_(std::move(text)) {
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
  fs::path path_;
  std::string text_;
  std::jthread beating_;
};

// --------------------------------------------------------------------------------------------------------------
// One run

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
  const SteadyMeans means = reduce_steady(record.frames, run.cell.strain_dropped, measurement_of(run.cell));
  return {{"mu", to_json(means.mu)},
          {"phi", to_json(means.phi)},
          {"p", to_json(means.p)},
          {"I", to_json(means.I)},
          {"sigma_xx_over_p", to_json(means.sigma_xx_over_p)},
          {"sigma_yy_over_p", to_json(means.sigma_yy_over_p)},
          {"mean_stress_over_p", means.mean_stress_over_p},
          {"strain", means.strain},
          {"frames", means.frames},
          {"drift_of_phi", means.drift}};
}

nlohmann::json start_up_result(const RunPlan& run, const CellRecord& record) {
  const Transient t = reduce_transient(record.frames, run.window, measurement_of(run.cell));
  return {{"phi_0", t.phi_0}, {"s", t.s},     {"gamma_dot", t.gamma_dot}, {"p", t.p},          {"mu", t.mu},
          {"I", t.I},         {"phi", t.phi}, {"beta", t.beta},           {"height", t.height}};
}

void remove_dumps(const fs::path& folder) {
  fs::remove(folder / grain_dump_file);
  fs::remove(folder / contact_dump_file);
}

/// Runs, checks, reduces, and writes done.json last of all. Throws what run_engine and read_run throw.
void carry_out(const RunPlan& run, const SweepPlan& plan, const fs::path& folder, const Claim& claim) {
  write_file_atomically(folder / "run.json", run_json(run).dump(1) + "\n");
  const EngineRun engine = run_engine(run.cell, folder, plan.limits);
  const CellRecord record = read_run(run.cell, folder);
  const nlohmann::json result =
      run.kind == RunKind::steady ? steady_result(run, record) : start_up_result(run, record);
  nlohmann::json done = run_json(run);
  done["hash"] = run.hash;
  done["engine"] = plan.engine;
  done["deck_version"] = deck_version;
  done["result"] = result;
  done["evidence"] = {{"last_step", run.deck.last_step},
                      {"frames", record.frames.size()},
                      {"wall_p", record.wall_p},
                      {"wall_mu", record.wall_tau / record.wall_p},
                      {"overlap_over_d", record.overlap},
                      {"largest_overlap_over_d", record.largest_overlap},
                      {"contacts_cut_to_coulomb", record.cut_contacts}};
  done["cost"] = {{"wall_seconds", engine.wall_seconds}, {"cpu_seconds", engine.cpu_seconds}};
  require_finite(done, "result");  // JSON has no NaN: it would come back as null
  done["provenance"] = provenance();
  if (!claim.is_ours())
    throw Interrupted(
        fmt::format("{}: taken over by another sweep while this one stood still", folder.string()));
  if (!plan.keep_dumps) remove_dumps(folder);
  write_file_atomically(folder / "done.json", done.dump(1) + "\n");
}

/// Writes failed.json if the run itself is to blame; any other exception goes on.
void record_failure(const std::exception_ptr& cause, const RunPlan& run, const fs::path& folder) {
  try {
    std::rethrow_exception(cause);
  } catch (const Error& error) {
    if (error.code() != ExitCode::engine && error.code() != ExitCode::unreadable) throw;
    // A stop that reached the engine too makes it fail in any manner of ways.
    if (stop_requested()) throw Interrupted("stopped on request; the same command resumes");
    const nlohmann::json failure{{"hash", run.hash}, {"run", title(run)}, {"reason", error.what()}};
    write_file_atomically(folder / "failed.json", failure.dump(1) + "\n");
  }
}

fs::path folder_of(const fs::path& sweep_folder, const RunPlan& run) {
  return sweep_folder / "runs" / run.hash;
}

bool is_done(const fs::path& folder) { return fs::exists(folder / "done.json"); }
bool is_failed(const fs::path& folder) { return fs::exists(folder / "failed.json"); }

void collect(const RunPlan& run, const fs::path& folder, Observables& observables, double& cpu_seconds) {
  const fs::path path = folder / "done.json";
  const nlohmann::json done = read_json(path);
  try {
    const nlohmann::json& result = done.at("result");
    const nlohmann::json& evidence = done.at("evidence");
    const double cpu = done.at("cost").at("cpu_seconds").get<double>();
    cpu_seconds += cpu;
    if (run.kind == RunKind::steady) {
      const auto value = [&](const char* key) { return result.at(key).at("value").get<double>(); };
      const auto error = [&](const char* key) { return result.at(key).at("standard_error").get<double>(); };
      SteadyPoint point;
      point.run = run.hash;
      point.seed = run.cell.seed;
      point.I_driven = run.cell.I_driven;
      point.I = value("I"), point.I_se = error("I");
      point.mu = value("mu"), point.mu_se = error("mu");
      point.phi = value("phi"), point.phi_se = error("phi");
      point.p = value("p"), point.p_se = error("p");
      point.wall_mu = evidence.at("wall_mu").get<double>();
      point.wall_p = evidence.at("wall_p").get<double>();
      point.strain = result.at("strain").get<double>();
      const auto flat = [&](const char* key) { return result.at(key).at("flat").get<bool>(); };
      point.I_flat = flat("I"), point.mu_flat = flat("mu"), point.phi_flat = flat("phi");
      point.phi_drift = result.at("drift_of_phi").get<double>();
      point.cpu_seconds = cpu;
      observables.steady.push_back(point);
    } else {
      Transient t;
      t.run = run.hash;
      t.kind = name_of(run.kind);
      t.seed = run.cell.seed;
      t.I_driven = run.cell.I_driven;
      t.phi_0 = result.at("phi_0").get<double>();
      t.cpu_seconds = cpu;
      const auto list = [&](const char* key) { return result.at(key).get<std::vector<double>>(); };
      t.s = list("s"), t.gamma_dot = list("gamma_dot"), t.p = list("p"), t.mu = list("mu");
      t.I = list("I"), t.phi = list("phi"), t.beta = list("beta"), t.height = list("height");
      observables.transients.push_back(std::move(t));
    }
  } catch (const nlohmann::json::exception& error) {
    throw InputError(
        fmt::format("{}: damaged ({}); remove the folder to run it again", path.string(), error.what()));
  }
}

void write_sweep_file(const SweepPlan& plan, const fs::path& folder) {
  nlohmann::json runs = nlohmann::json::array();
  for (const RunPlan& run : plan.runs) runs.push_back(run_json(run));
  const nlohmann::json sweep{{"version", sweep_file_version},
                             {"engine", plan.engine},
                             {"material", plan.material},
                             {"time_limit", plan.limits.seconds},
                             {"memory_limit", plan.limits.memory},
                             {"keep_dumps", plan.keep_dumps},
                             {"runs", runs}};
  write_file_atomically(folder / "sweep.json", sweep.dump(1) + "\n");
}

SweepPlan read_sweep_file(const fs::path& folder) {
  const fs::path path = folder / "sweep.json";
  const nlohmann::json sweep = read_json(path);
  try {
    if (sweep.at("version").get<int>() != sweep_file_version)
      throw InputError(fmt::format("{}: written by another version", path.string()));
    SweepPlan plan;
    plan.engine = sweep.at("engine").get<std::string>();
    plan.material = sweep.at("material").get<std::string>();
    plan.limits.seconds = sweep.at("time_limit").get<double>();
    plan.limits.memory = sweep.at("memory_limit").get<std::size_t>();
    plan.keep_dumps = sweep.at("keep_dumps").get<bool>();
    for (const nlohmann::json& entry : sweep.at("runs")) {
      RunPlan run;
      run.kind = entry.at("kind").get<std::string>() == "steady" ? RunKind::steady : RunKind::start_up;
      run.cell = cell_from_json(entry.at("cell"));
      run.window = entry.at("window").get<double>();
      complete_plan(run, plan.engine);
      plan.runs.push_back(run);
    }
    return plan;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("{}: damaged ({})", path.string(), error.what()));
  }
}

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
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
    write_sweep_file(plan, options.folder);
  }

  SweepResult result;
  std::vector<const RunPlan*> todo;
  double to_spend = 0;
  for (const RunPlan& run : plan.runs) {
    const fs::path folder = folder_of(options.folder, run);
    if (is_done(folder)) {
      ++result.reused;
    } else if (!is_failed(folder)) {
      todo.push_back(&run);
      to_spend += run.deck.core_seconds;
    }
  }

  struct Progressing {
    std::mutex mutex;
    std::map<const RunPlan*, Clock::time_point> running;
    double spent = 0;  // expected core-seconds of what is finished
    std::size_t finished = 0;
    std::vector<std::string> held;  // by other sweeps
    std::exception_ptr mistake;
    bool interrupted = false;
  } shared;
  std::atomic<std::size_t> next{0}, ran{0}, elsewhere{0};
  std::atomic<bool> give_up{false};
  std::atomic<std::size_t> workers_left{0};

  const auto work = [&] {
    while (!give_up && !stop_requested()) {
      const std::size_t mine = next++;
      if (mine >= todo.size()) break;
      const RunPlan& run = *todo[mine];
      const fs::path folder = folder_of(options.folder, run);
      std::unique_ptr<Claim> claim;  // outlives the verdict
      try {
        fs::create_directories(folder);
        std::string holder;
        claim = Claim::take(folder, &holder);
        if (!claim) {
          ++elsewhere;
          const std::lock_guard lock(shared.mutex);
          shared.held.push_back(fmt::format("{}: {} works on it; if that is not so, remove {}", title(run),
                                            holder, (folder / "claim").string()));
        } else if (is_done(folder)) {
          ++ran;  // somebody finished it between our look and our claim
        } else if (!is_failed(folder)) {
          {
            const std::lock_guard lock(shared.mutex);
            shared.running[&run] = Clock::now();
          }
          carry_out(run, plan, folder, *claim);
          ++ran;
        }
      } catch (...) {
        // Judged here, in a second try: recording a failure can itself fail, for example on a full disk.
        try {
          record_failure(std::current_exception(), run, folder);
        } catch (const Interrupted&) {
          const std::lock_guard lock(shared.mutex);
          shared.interrupted = true;
        } catch (...) {  // no verdict on this run: handed to the caller below
          const std::lock_guard lock(shared.mutex);
          shared.mistake = std::current_exception();
          give_up = true;
        }
      }
      const std::lock_guard lock(shared.mutex);
      shared.running.erase(&run);
      shared.spent += run.deck.core_seconds;
      ++shared.finished;
    }
    --workers_left;
  };

  {
    Progress progress("shear cells", options.quiet);
    std::vector<std::jthread> workers;
    const std::size_t count = std::min(static_cast<std::size_t>(options.jobs), todo.size());
    workers_left = count;
    for (std::size_t j = 0; j < count; ++j) workers.emplace_back(work);
    while (workers_left > 0) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      if (!progress.due()) continue;
      const std::lock_guard lock(shared.mutex);
      double spent = shared.spent;
      std::string text = fmt::format("{} of {} done", shared.finished, todo.size());
      for (const auto& [run, start] : shared.running) {
        spent += std::min(0.95 * run->deck.core_seconds, seconds_since(start));
        text += fmt::format(", {} {:.0f} s", title(*run), seconds_since(start));
      }
      progress.update(to_spend > 0 ? spent / to_spend : 1, text);
    }
    workers.clear();  // joins
    progress.finish(fmt::format("{} run, {} reused of {}", ran.load(), result.reused, plan.runs.size()));
  }
  if (shared.mistake) std::rethrow_exception(shared.mistake);
  if (shared.interrupted || stop_requested())
    throw Interrupted(fmt::format("stopped on request with {} of {} runs done; the same command resumes",
                                  ran + result.reused, plan.runs.size()));
  result.ran = ran;
  result.elsewhere = elsewhere;
  for (const std::string& text : shared.held) spdlog::warn(text);

  Observables& observables = result.observables;
  const ShearCell& cell = plan.runs.front().cell;
  observables.d = cell.material.d;
  observables.rho_s = cell.material.rho_s;
  observables.grain_friction = cell.material.grain_friction;
  observables.pressure = cell.pressure;
  observables.engine = plan.engine;
  observables.material = plan.material;
  std::vector<const RunPlan*> in_order;  // by I and seed, whatever the order of running was
  for (const RunPlan& run : plan.runs) in_order.push_back(&run);
  std::stable_sort(in_order.begin(), in_order.end(), [](const RunPlan* a, const RunPlan* b) {
    return std::pair(a->cell.I_driven, a->cell.seed) < std::pair(b->cell.I_driven, b->cell.seed);
  });
  for (const RunPlan* run : in_order) {
    const fs::path folder = folder_of(options.folder, *run);
    if (is_done(folder)) {
      collect(*run, folder, observables, result.cpu_seconds);
    } else if (is_failed(folder)) {
      const nlohmann::json failure = read_json(folder / "failed.json");
      result.failed.push_back({run->hash, title(*run) + ": " + failure.value("reason", "no reason given")});
    }
  }
  if (!result.failed.empty())
    spdlog::warn(
        "{} of {} runs have failed and are left out until they are run again: dem2sph sweep retry {}",
        result.failed.size(), plan.runs.size(), options.folder.string());
  observables.excluded = result.failed;
  const SweepLock lock(runs);
  write_observables(observables, options.folder / "observables.h5");
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

std::vector<RunStatus> sweep_status(const fs::path& sweep_folder) {
  std::vector<RunStatus> all;
  const SweepPlan plan = read_sweep_file(sweep_folder);
  for (const RunPlan& run : plan.runs) {
    const fs::path folder = folder_of(sweep_folder, run);
    RunStatus status{run.hash, title(run), RunState::waiting, "", run.deck.core_seconds};
    const std::optional<Owner> owner = owner_of(folder);
    if (is_done(folder)) {
      status.state = RunState::done;
      const nlohmann::json done = read_json(folder / "done.json");
      status.core_seconds = done.at("cost").at("cpu_seconds").get<double>();
    } else if (is_failed(folder)) {
      status.state = RunState::failed;
      status.detail = read_json(folder / "failed.json").value("reason", "no reason given");
    } else if (owner) {
      status.state = owner->alive ? RunState::running : RunState::abandoned;
      status.detail = owner->text;
    }
    all.push_back(std::move(status));
  }
  return all;
}

std::string describe(const std::vector<RunStatus>& status) {
  std::string text;
  std::map<RunState, std::size_t> count;
  for (const RunStatus& run : status) {
    ++count[run.state];
    text += fmt::format("{}  {:<9} {:<32} {:7.1f} core-seconds  {}\n", run.hash, name_of(run.state), run.what,
                        run.core_seconds, run.detail);
  }
  for (const auto& [state, n] : count) text += fmt::format("{} {}  ", n, name_of(state));
  text += '\n';
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
    if (!is_failed(folder) || is_done(folder)) continue;
    const std::unique_ptr<Claim> claim = Claim::take(folder);
    if (!claim) continue;  // somebody is at it already
    remove_dumps(folder);
    fs::remove(folder / "failed.json");
  }
  return run_sweep(plan, options);
}

}  // namespace dem2sph::bridge
