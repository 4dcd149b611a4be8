#include "dem_bridge/plan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <queue>
#include <unordered_set>
#include <utility>

#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph::bridge {
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
         "Contact law: Hertz-Mindlin, or linear springs (hooke); both with tangential history.",
         {"hertz", "hooke"}},
        {"youngs_modulus", Kind::quantity, "Pa", 5e6, 1e12, "10 MPa",
         "Of the grains (hertz); the softer, the longer the time step. LIGGGHTS takes no less than 5 MPa."},
        {"poisson_ratio", Kind::number, "", 0, 0.49, "0.3", "Of the grains (hertz)."},
        {"kappa", Kind::number, "", 100, 1e7, "unset",
         "Stiffness over load: k_n/(P d) (hooke), (E/P)^(2/3) (hertz, instead of youngs_modulus)."},
        {"rolling_friction", Kind::number, "", 0, 2, "0",
         "Coefficient of rolling friction, model epsd2; 0: grains roll freely."},
        {"cohesion", Kind::quantity, "J/m^3", 0, 1e9, "0 J/m^3",
         "Energy density of the SJKR attraction: force over area of contact; 0: none."},
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
        {"time_step_fraction", Kind::number, "", 0.01, 0.4, "0.2",
         "Time step over the Rayleigh time of the smallest grain (hertz) and a quarter of a contact."},
        {"ranks", Kind::integer, "", 1, 1024, "1",
         "MPI processes of one run; small cells are faster with one, and many runs at once."},
        {"time_limit", Kind::quantity, "s", 1, 1e7, "7200 s",
         "A run that takes longer is ended and has failed."},
        {"memory_limit", Kind::number, "", 0.5, 1024, "4", "Address space of a run in GiB."},
        {"on_failure",
         Kind::word,
         "",
         -unbounded,
         unbounded,
         "retry",
         "A failed run is left out (skip), ends the sweep (abort), or is tried again (retry) unless it would "
         "fail "
         "the same way.",
         {"skip", "abort", "retry"}},
        {"retries", Kind::integer, "", 1, 1000, "2",
         "How often a run is tried again (on_failure = \"retry\")."},
        {"keep_dumps", Kind::flag, "", -unbounded, unbounded, "false",
         "Keep the dumps after their reduction."},
    }};

const ParameterTable steady_table{
    "shear_cell.steady",
    "Steady points: mu, phi and I with standard errors, one for each I and seed.",
    {
        {"I", Kind::numbers, "", 1e-5, 3, "required", "Driven inertial numbers (the core's own differs)."},
        {"seeds", Kind::integers, "", 0, 1e9, "[1]", "One run of every I for each seed."},
        {"strain_dropped", Kind::number, "", 0.5, 1e4, "2", "Strain before averaging begins, at least."},
        {"strain_used", Kind::number, "", 0.5, 1e5, "6", "Strain that is averaged over, at least."},
        {"responses_dropped", Kind::number, "", 0.5, 100, "2",
         "Before averaging, at least this many response times of cell and piston, each a strain I H/d."},
        {"responses_used", Kind::number, "", 0.5, 1e4, "4", "The same for averaging."},
        {"frames", Kind::integer, "", 64, 1e5, "400", "Frames in the averaged part."},
    }};

const Parameter seeds_key{
    "seeds", Kind::integers, "", 0, 1e9, "[1, 2, 3, 4]", "One run of every I for each seed."};
const Parameter strain_key{"strain", Kind::number, "", 0.1, 1000, "5", "Strain that is recorded."};
const Parameter frames_key{"frames", Kind::integer, "", 20, 1e5, "500", "Frames in it."};
const Parameter window_key{
    "window", Kind::number, "", 1e-4, 1, "0.05", "Strain that one entry of the series averages over."};
const Parameter strain_before_key{
    "strain_before", Kind::number, "", 0.5, 1000, "4", "Strain at the first rate, before the change."};

const ParameterTable start_up_table{
    "shear_cell.start_up",
    "Start-ups: a sample is packed, then sheared at constant I; series of phi, beta, mu over strain.",
    {
        {"I", Kind::numbers, "", 1e-5, 2, "[0.03]", "Driven inertial numbers."},
        seeds_key,
        {"packing_friction", Kind::numbers, "", 0, 100, "[0]",
         "Friction of the grains while they are packed: 0 packs densely, the grains' own loosely."},
        strain_key,
        frames_key,
        window_key,
    }};

/// A transient that begins with a sheared sample: keys of its own, then those that all of them have.
ParameterTable change_table(const char* section, const char* text, std::vector<Parameter> keys) {
  keys.insert(keys.end(), {seeds_key, strain_before_key, strain_key, frames_key, window_key});
  return {section, text, std::move(keys)};
}

const ParameterTable jump_table = change_table(
    "shear_cell.jump", "Jumps of the rate: sheared at one I, then at another, from the same sample.",
    {
        {"I_before", Kind::numbers, "", 1e-5, 2, "required", "Driven inertial numbers before the jump."},
        {"I", Kind::numbers, "", 1e-5, 2, "required",
         "Driven inertial numbers after it, one for each before."},
    });

const ParameterTable reversal_table =
    change_table("shear_cell.reversal", "Reversals: sheared one way, then the other at the same I.",
                 {{"I", Kind::numbers, "", 1e-5, 2, "required", "Driven inertial numbers."}});

const ParameterTable pressure_jump_table = change_table(
    "shear_cell.pressure_jump", "Jumps of the pressure at a constant speed of the wall.",
    {
        {"I_before", Kind::numbers, "", 1e-5, 2, "required", "Driven inertial numbers before the jump."},
        {"pressure", Kind::quantities, "Pa", 1e-3, 1e9, "required",
         "Loads after the jump; each with every I_before."},
    });

constexpr int sweep_version = 2;

struct KindName {
  RunKind kind;
  const char* name;
};
constexpr KindName kind_names[] = {{RunKind::packing, "packing"},
                                   {RunKind::pre_shear, "pre_shear"},
                                   {RunKind::steady, "steady"},
                                   {RunKind::start_up, "start_up"},
                                   {RunKind::jump, "jump"},
                                   {RunKind::reversal, "reversal"},
                                   {RunKind::pressure_jump, "pressure_jump"}};

struct PolicyName {
  FailurePolicy policy;
  const char* name;
};
constexpr PolicyName policy_names[] = {
    {FailurePolicy::skip, "skip"}, {FailurePolicy::abort, "abort"}, {FailurePolicy::retry, "retry"}};

FailurePolicy policy_of(const std::string& name) {
  for (const PolicyName& p : policy_names)
    if (name == p.name) return p.policy;
  throw InputError(fmt::format("\"{}\" is no policy for failed runs", name));
}
const char* name_of(FailurePolicy policy) {
  for (const PolicyName& p : policy_names)
    if (policy == p.policy) return p.name;
  return "";
}

/// 64 bits of SHA-256: two of a million runs share a name with a probability of 3e-8.
void complete(RunPlan& run, const std::string& engine) {
  run.deck =
      run.kind == RunKind::packing ? plan_packing(run.sample) : plan_shearing(run.sample, run.shearing);
  nlohmann::json identity = to_json(run);
  identity["engine"] = engine;
  identity["deck_version"] = deck_version;
  run.hash = sha256(identity.dump()).substr(0, 16);
}

/// Chains first whose end is farthest away.
void order(std::vector<RunPlan>& runs) {
  std::map<std::string, double> longest_child;
  for (const RunKind kind : {RunKind::steady, RunKind::pre_shear, RunKind::packing}) {
    // Leaves first, then what they begin with.
    for (RunPlan& run : runs) {
      const bool leaf = !prepares(run.kind);
      if (leaf != (kind == RunKind::steady) || (!leaf && run.kind != kind)) continue;
      run.chain_seconds = run.deck.core_seconds + longest_child[run.hash];
      double& of_parent = longest_child[run.begins_with];
      of_parent = std::max(of_parent, run.chain_seconds);
    }
  }
  std::stable_sort(runs.begin(), runs.end(),
                   [](const RunPlan& a, const RunPlan& b) { return a.chain_seconds > b.chain_seconds; });
}

/// Collects runs with what they begin with, each once.
class Planner {
 public:
  explicit Planner(const CaseFile& case_file, std::string engine)
      : case_file_(case_file), engine_(std::move(engine)) {}

  void read_material_and_cell(SweepPlan& plan);
  void read_steady(SweepPlan& plan);
  void read_start_ups(SweepPlan& plan);
  void read_jumps(SweepPlan& plan);
  void read_reversals(SweepPlan& plan);
  void read_pressure_jumps(SweepPlan& plan);

 private:
  /// Names the run and adds it. A preparation that is there already is used; any other run is refused.
  std::string add(SweepPlan& plan, RunPlan run, const Section& section) {
    try {
      complete(run, engine_);
    } catch (const UsageError& error) {
      throw UsageError(fmt::format("{}: [shear_cell] {}", cell_where_, error.what()));
    }
    if (hashes_.insert(run.hash).second)
      plan.runs.push_back(run);
    else if (!prepares(run.kind))
      section.refuse("seeds", fmt::format("the run {} is asked for twice", title(run)));
    return run.hash;
  }

  std::string add_packing(SweepPlan& plan, const Sample& sample, const Section& section) {
    RunPlan run;
    run.kind = RunKind::packing;
    run.sample = sample;
    return add(plan, run, section);
  }

  std::string add_pre_shear(SweepPlan& plan, const Sample& sample, double inertial_number, double strain,
                            const Section& section) {
    RunPlan run;
    run.kind = RunKind::pre_shear;
    run.sample = sample;
    run.begins_with = add_packing(plan, sample, section);
    run.shearing = {.I_driven = inertial_number, .pressure = sample.pressure, .strain_used = strain};
    return add(plan, run, section);
  }

  Sample sample_of(long seed, double packing_friction) const {
    Sample sample = sample_;
    sample.seed = seed;
    sample.packing_friction = packing_friction;
    return sample;
  }

  RunPlan transient(const Section& section, RunKind kind, const Sample& sample) const {
    RunPlan run;
    run.kind = kind;
    run.sample = sample;
    run.core_margin = core_margin_;
    run.shearing.pressure = sample.pressure;
    run.shearing.strain_used = section.number("strain");
    run.shearing.frames = section.integer("frames");
    run.window = section.number("window");
    if (!(run.window <= run.shearing.strain_used / 4))
      section.refuse("window",
                     fmt::format("\"window\" = {:g} leaves fewer than 4 entries in a strain of {:g}",
                                 run.window, run.shearing.strain_used));
    return run;
  }

  /// A transient whose sample is sheared at `I_before` first.
  RunPlan after_pre_shear(SweepPlan& plan, const Section& section, RunKind kind, long seed, double I_before) {
    RunPlan run = transient(section, kind, sample_of(seed, sample_.material.grain_friction));
    run.begins_with = add_pre_shear(plan, run.sample, I_before, section.number("strain_before"), section);
    run.I_before = I_before;
    return run;
  }

  static std::vector<double> list(const Section& section, const char* key) {
    const std::vector<double> values = section.numbers(key);
    if (values.empty()) section.refuse(key, fmt::format("\"{}\" is an empty list", key));
    return values;
  }
  static std::vector<long> seeds(const Section& section) {
    const std::vector<long> values = section.integers("seeds");
    if (values.empty()) section.refuse("seeds", "\"seeds\" is an empty list");
    return values;
  }

  const CaseFile& case_file_;
  std::string engine_;
  std::string cell_where_;
  Sample sample_;
  double core_margin_ = 0;
  std::unordered_set<std::string> hashes_;  // of the runs that are in the plan
};

void Planner::read_material_and_cell(SweepPlan& plan) {
  const Section material = case_file_.section(material_table);
  const Section cell = case_file_.section(cell_table);
  sample_.pressure = cell.quantity("pressure");
  sample_.grains = cell.integer("grains");
  sample_.length = cell.number("length");
  sample_.width = cell.number("width");
  sample_.time_step_fraction = cell.number("time_step_fraction");
  sample_.ranks = cell.integer("ranks");
  core_margin_ = cell.number("core_margin");
  cell_where_ = cell.where("grains");
  plan.limits.seconds = cell.quantity("time_limit");
  plan.limits.memory = static_cast<std::size_t>(cell.number("memory_limit") * 1024 * 1024 * 1024);
  plan.on_failure = policy_of(cell.word("on_failure"));
  if (plan.on_failure == FailurePolicy::retry) plan.retries = cell.integer("retries");
  plan.keep_dumps = cell.flag("keep_dumps");
  cell.finish("with on_failure = \"" + cell.word("on_failure") + "\"");

  GrainMaterial& m = sample_.material;
  m.d = material.quantity("d");
  m.rho_s = material.quantity("rho_s");
  m.grain_friction = material.number("grain_friction");
  m.restitution = material.number("restitution");
  m.size_spread = material.number("size_spread");
  m.rolling_friction = material.number("rolling_friction");
  m.cohesion = material.quantity("cohesion");
  m.contact = material.word("contact") == "hertz" ? ContactModel::hertz : ContactModel::hooke;
  if (m.contact == ContactModel::hertz) {
    m.poisson_ratio = material.number("poisson_ratio");
    if (material.given("kappa")) {
      if (material.given("youngs_modulus"))
        material.refuse("kappa", "give \"kappa\" or \"youngs_modulus\", not both");
      m.youngs_modulus = sample_.pressure * std::pow(material.number("kappa"), 1.5);
      if (!(m.youngs_modulus >= 5e6))
        material.refuse("kappa",
                        fmt::format("\"kappa\" gives a Young's modulus of {:.3g} Pa, and LIGGGHTS takes no "
                                    "less than 5 MPa: raise \"kappa\" or the pressure",
                                    m.youngs_modulus));
    } else {
      m.youngs_modulus = material.quantity("youngs_modulus");
    }
  } else {
    if (!material.given("kappa")) material.refuse("contact", "contact = \"hooke\" needs \"kappa\"");
    m.stiffness = material.number("kappa");
  }
  material.finish(fmt::format("with contact = \"{}\"", material.word("contact")));
  plan.grains = m;
  plan.pressure = sample_.pressure;

  const double core = expected_gap(sample_) - 2 * core_margin_;
  if (!(core >= 2))
    throw UsageError(fmt::format(
        "{}: [shear_cell] {} grains on {:g} d x {:g} d leave a core of {:.2g} d between margins of "
        "{:g} d; at least 2 d are needed: raise \"grains\" or lower \"length\" and \"width\"",
        cell_where_, sample_.grains, sample_.length, sample_.width, core, core_margin_));
}

void Planner::read_steady(SweepPlan& plan) {
  const Section section = case_file_.section(steady_table);
  for (const double inertial_number : list(section, "I"))
    for (const long seed : seeds(section)) {
      RunPlan run;
      run.kind = RunKind::steady;
      run.sample = sample_of(seed, sample_.material.grain_friction);
      run.begins_with = add_packing(plan, run.sample, section);
      run.core_margin = core_margin_;
      // Cell and piston respond within H sqrt(rho/P), which is a strain of I H/d.
      const double response = inertial_number * (expected_gap(sample_) + 2 * wall_thickness_in_d);
      run.shearing = {
          .I_driven = inertial_number,
          .pressure = sample_.pressure,
          .strain_dropped =
              std::max(section.number("strain_dropped"), section.number("responses_dropped") * response),
          .strain_used = std::max(section.number("strain_used"), section.number("responses_used") * response),
          .frames = section.integer("frames")};
      add(plan, run, section);
    }
  section.finish();
}

void Planner::read_start_ups(SweepPlan& plan) {
  const Section section = case_file_.section(start_up_table);
  for (const double inertial_number : list(section, "I"))
    for (const double friction : list(section, "packing_friction"))
      for (const long seed : seeds(section)) {
        RunPlan run = transient(section, RunKind::start_up, sample_of(seed, friction));
        run.begins_with = add_packing(plan, run.sample, section);
        run.shearing.I_driven = inertial_number;
        add(plan, run, section);
      }
  section.finish();
}

void Planner::read_jumps(SweepPlan& plan) {
  const Section section = case_file_.section(jump_table);
  const std::vector<double> before = list(section, "I_before"), after = list(section, "I");
  if (before.size() != after.size())
    section.refuse("I", fmt::format("\"I\" has {} entries and \"I_before\" {}", after.size(), before.size()));
  for (std::size_t i = 0; i < before.size(); ++i) {
    if (before[i] == after[i])
      section.refuse("I", fmt::format("from I = {:g} to {:g} is no jump", before[i], after[i]));
    for (const long seed : seeds(section)) {
      RunPlan run = after_pre_shear(plan, section, RunKind::jump, seed, before[i]);
      run.shearing.I_driven = after[i];
      add(plan, run, section);
    }
  }
  section.finish();
}

void Planner::read_reversals(SweepPlan& plan) {
  const Section section = case_file_.section(reversal_table);
  for (const double inertial_number : list(section, "I"))
    for (const long seed : seeds(section)) {
      RunPlan run = after_pre_shear(plan, section, RunKind::reversal, seed, inertial_number);
      run.shearing.I_driven = inertial_number;
      run.shearing.direction = -1;
      add(plan, run, section);
    }
  section.finish();
}

void Planner::read_pressure_jumps(SweepPlan& plan) {
  const Section section = case_file_.section(pressure_jump_table);
  const std::vector<double> pressures = section.quantities("pressure");
  if (pressures.empty()) section.refuse("pressure", "\"pressure\" is an empty list");
  for (const double inertial_number : list(section, "I_before"))
    for (const double pressure : pressures) {
      if (pressure == sample_.pressure)
        section.refuse("pressure", fmt::format("{:g} Pa is the pressure before: no jump", pressure));
      for (const long seed : seeds(section)) {
        RunPlan run = after_pre_shear(plan, section, RunKind::pressure_jump, seed, inertial_number);
        // The wall keeps its speed: I falls with the root of the pressure.
        run.shearing.I_driven = inertial_number * std::sqrt(sample_.pressure / pressure);
        run.shearing.pressure = pressure;
        run.shearing.keeps_velocity = true;
        add(plan, run, section);
      }
    }
  section.finish();
}

}  // namespace

std::string name_of(RunKind kind) {
  for (const KindName& k : kind_names)
    if (k.kind == kind) return k.name;
  return "";
}

RunKind kind_of(const std::string& name) {
  for (const KindName& k : kind_names)
    if (name == k.name) return k.kind;
  throw InputError(fmt::format("\"{}\" is no kind of run", name));
}

bool prepares(RunKind kind) { return kind == RunKind::packing || kind == RunKind::pre_shear; }

std::string title(const RunPlan& run) {
  const auto seed = fmt::format("seed {}", run.sample.seed);
  switch (run.kind) {
    case RunKind::packing:
      return fmt::format("packing friction {:g} {}", run.sample.packing_friction, seed);
    case RunKind::start_up:
      return fmt::format("start_up I = {:g} packing friction {:g} {}", run.shearing.I_driven,
                         run.sample.packing_friction, seed);
    case RunKind::jump:
      return fmt::format("jump I = {:g} to {:g} {}", run.I_before, run.shearing.I_driven, seed);
    case RunKind::pressure_jump:
      return fmt::format("pressure_jump I = {:g} P = {:g} to {:g} Pa {}", run.I_before, run.sample.pressure,
                         run.shearing.pressure, seed);
    default:
      return fmt::format("{} I = {:g} {}", name_of(run.kind), run.shearing.I_driven, seed);
  }
}

nlohmann::json to_json(const RunPlan& run) {
  nlohmann::json json{{"kind", name_of(run.kind)}, {"sample", to_json(run.sample)}};
  if (run.kind == RunKind::packing) {
    // Grains are packed with packing_friction: one packing serves flows of every friction.
    json["sample"]["material"].erase("grain_friction");
    return json;
  }
  json["shearing"] = to_json(run.shearing);
  json["begins_with"] = run.begins_with;
  if (prepares(run.kind)) return json;
  json["I_before"] = run.I_before;
  json["core_margin"] = run.core_margin;
  json["window"] = run.window;
  return json;
}

RunPlan run_from_json(const nlohmann::json& json, const std::string& engine) {
  try {
    RunPlan run;
    run.kind = kind_of(json.at("kind").get<std::string>());
    nlohmann::json sample = json.at("sample");
    if (run.kind == RunKind::packing) sample["material"]["grain_friction"] = 0.0;
    run.sample = sample_from_json(sample);
    if (run.kind != RunKind::packing) {
      run.shearing = shearing_from_json(json.at("shearing"));
      json.at("begins_with").get_to(run.begins_with);
    }
    if (!prepares(run.kind)) {
      json.at("I_before").get_to(run.I_before);
      json.at("core_margin").get_to(run.core_margin);
      json.at("window").get_to(run.window);
    }
    complete(run, engine);
    return run;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("the description of a run is damaged: {}", error.what()));
  }
}

std::vector<const ParameterTable*> sweep_tables() {
  return {&material_table, &cell_table,     &steady_table,       &start_up_table,
          &jump_table,     &reversal_table, &pressure_jump_table};
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
  SweepPlan plan;
  plan.engine = engine;
  Planner planner(case_file, engine);
  planner.read_material_and_cell(plan);
  if (case_file.has(steady_table.section)) planner.read_steady(plan);
  if (case_file.has(start_up_table.section)) planner.read_start_ups(plan);
  if (case_file.has(jump_table.section)) planner.read_jumps(plan);
  if (case_file.has(reversal_table.section)) planner.read_reversals(plan);
  if (case_file.has(pressure_jump_table.section)) planner.read_pressure_jumps(plan);
  if (plan.runs.empty())
    throw UsageError(
        fmt::format("{}: nothing to run: give [shear_cell.steady], [shear_cell.start_up], [shear_cell.jump], "
                    "[shear_cell.reversal] or [shear_cell.pressure_jump]",
                    case_file.path().string()));
  order(plan.runs);

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
  for (const RunPlan& run : plan.runs) {
    const std::string strain =
        run.kind == RunKind::packing
            ? ""
            : fmt::format("strain {:.3g} + {:.3g}, ", run.shearing.strain_dropped, run.shearing.strain_used);
    text += fmt::format("  {}{:<44} {}{} frames, {:.2g} million steps, about {:.0f} core-seconds\n",
                        named ? run.hash + "  " : "", title(run), strain, run.deck.frames,
                        static_cast<double>(run.deck.last_step) * 1e-6, run.deck.core_seconds);
  }
  const Sample& sample = plan.runs.front().sample;
  const TimeStep t = time_step(sample);
  text += fmt::format("  time step {:.3g} s, set by the {}: ", t.step, t.bound());
  if (std::isfinite(t.rayleigh))
    text += fmt::format("1/{:.3g} of the Rayleigh time of the smallest grain, ", t.rayleigh / t.step);
  text += fmt::format(
      "1/{:.3g} of a contact under the load, 1/{:.3g} of a collision at sqrt(P/rho_s); stiffness over load "
      "kappa = "
      "{:.3g}\n",
      t.contact_duration / t.step, t.fastest_collision / t.step, kappa(sample));
  text += fmt::format("  together about {:.0f} core-seconds, {:.0f} s with {} at once\n", plan.core_seconds(),
                      plan.wall_seconds(jobs), jobs);
  return text;
}

nlohmann::json to_json(const SweepPlan& plan) {
  nlohmann::json runs = nlohmann::json::array();
  for (const RunPlan& run : plan.runs) runs.push_back(to_json(run));
  Sample grains;  // of the plan: a packing does not tell the friction of the flow
  grains.material = plan.grains;
  return {{"version", sweep_version},
          {"engine", plan.engine},
          {"deck_version", deck_version},
          {"material", plan.material},
          {"grains", to_json(grains).at("material")},
          {"pressure", plan.pressure},
          {"time_limit", plan.limits.seconds},
          {"memory_limit", plan.limits.memory},
          {"on_failure", name_of(plan.on_failure)},
          {"retries", plan.retries},
          {"keep_dumps", plan.keep_dumps},
          {"runs", runs}};
}

SweepPlan sweep_from_json(const nlohmann::json& json) {
  try {
    if (json.at("version").get<int>() != sweep_version || json.at("deck_version").get<int>() != deck_version)
      throw InputError("written by another version of dem2sph: give the case file again");
    SweepPlan plan;
    json.at("engine").get_to(plan.engine);
    json.at("material").get_to(plan.material);
    nlohmann::json sample = to_json(Sample{});
    sample["material"] = json.at("grains");
    plan.grains = sample_from_json(sample).material;
    json.at("pressure").get_to(plan.pressure);
    json.at("time_limit").get_to(plan.limits.seconds);
    json.at("memory_limit").get_to(plan.limits.memory);
    plan.on_failure = policy_of(json.at("on_failure").get<std::string>());
    json.at("retries").get_to(plan.retries);
    json.at("keep_dumps").get_to(plan.keep_dumps);
    for (const nlohmann::json& entry : json.at("runs"))
      plan.runs.push_back(run_from_json(entry, plan.engine));
    order(plan.runs);
    return plan;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("damaged ({})", error.what()));
  }
}

}  // namespace dem2sph::bridge
