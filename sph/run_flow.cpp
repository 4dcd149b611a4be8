#include "sph/run_flow.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#ifdef _OPENMP
#include <omp.h>
#endif
#include <spdlog/spdlog.h>
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "sph/base/deposit.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/progress.hpp"
#include "sph/base/provenance.hpp"
#include "sph/base/version.hpp"
#include "sph/flow.hpp"
#include "sph/scene.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr int samples = 400;             // of the time series over the whole run
constexpr double checkpoint_every = 60;  // wall seconds, at most; the first after one, then at twice the time

// What a run says of itself at its end, so that nobody takes a doubtful figure for a good one (README.md).
constexpr double doubtful_mach = 0.3;     // |v|/c above which flow is no longer slow against sound
constexpr double doubtful_energy = 0.05;  // of all energy that was turned over, not accounted for
constexpr double doubtful_share = 0.03;   // "more than a few per cent" of the flowing mass, in a number
constexpr double doubtful_creep = 0.01;   // of H, that something at rest moved
constexpr double least_rows = 4;          // of particles over the height: fewer are all surface

double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto s = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return s(usage.ru_utime) + s(usage.ru_stime);
}

json to_json(const Budgets& b, int dim) {
  std::vector<double> momentum(b.momentum.begin(), b.momentum.begin() + dim);
  return {{"mass", b.mass},
          {"momentum", momentum},
          {"kinetic", b.kinetic},
          {"potential", b.potential},
          {"elastic", b.elastic},
          {"dissipated", b.dissipated},
          {"sheared", b.sheared},
          {"damped", b.damped},
          {"cut_off", b.cut_off},
          {"slid", b.slid},
          {"swollen", b.swollen},
          {"diffused", b.diffused},
          {"from_walls", b.from_walls}};
}

// What is measured while a flow runs; the part of a run that a checkpoint must carry beside the particles.
struct Record {
  json series{{"time", json::array()},
              {"front_99", json::array()},
              {"centre_height", json::array()},
              {"kinetic_energy", json::array()},
              {"potential_energy", json::array()},
              {"max_speed", json::array()},
              {"wall_force_normal", json::array()}};
  json profiles = json::array();
  std::vector<PvdEntry> pvd;
  long sampled = 0;
  long framed = 0;
  std::array<long, bound_names.size()> bounds{};
  double dt_min =
      std::numeric_limits<double>::infinity();  // finite after the first step, before any checkpoint
  double dt_max = 0;
  double wall_seconds = 0;
  double cpu_seconds = 0;
  json initial_budgets;
  double initial_energy = 0;  // kinetic, potential and elastic
  // Mass beyond the law's data over the mass that flows: sums over the samples in which anything flowed, and
  // maxima; and the time for which there was any.
  struct Share {
    double sum = 0;
    double largest = 0;
    double time = 0;  // [s]
    void add(double share, double since_last) {
      sum += share;
      largest = std::max(largest, share);
      if (share > 0) time += since_last;
    }
    json to_json() const { return {sum, largest, time}; }
    static Share from(const json& j) {
      return {j.at(0).get<double>(), j.at(1).get<double>(), j.at(2).get<double>()};
    }
  };
  Share below_data, above_data, ill_posed, beta_limited, phi_at_floor;
  long flowing_samples = 0;
  // Extremes over the samples.
  double mach = 0;           // |v|/c
  double compression = 0;    // rho/rho0
  double unaccounted = 0;    // |energy| that the budget does not explain [J]
  double energy_turned = 0;  // energy that was turned over: moved, lifted, stored, dissipated [J]
  double particle_steps = 0;
  double pair_steps = 0;

  std::string text() const {
    json entries = json::array();
    for (const PvdEntry& e : pvd) entries.push_back({e.time, e.file});
    return json{{"series", series},
                {"profiles", profiles},
                {"pvd", entries},
                {"sampled", sampled},
                {"framed", framed},
                {"bounds", bounds},
                {"dt", {dt_min, dt_max}},
                {"seconds", {wall_seconds, cpu_seconds}},
                {"initial_budgets", initial_budgets},
                {"initial_energy", initial_energy},
                {"work", {particle_steps, pair_steps}},
                {"flowing_samples", flowing_samples},
                {"extremes", {mach, compression, unaccounted, energy_turned}},
                {"below_data", below_data.to_json()},
                {"above_data", above_data.to_json()},
                {"ill_posed", ill_posed.to_json()},
                {"beta_limited", beta_limited.to_json()},
                {"phi_at_floor", phi_at_floor.to_json()}}
        .dump();
  }
  static Record from(const std::string& text) {
    const json j = json::parse(text);
    Record r;
    r.series = j.at("series");
    r.profiles = j.at("profiles");
    for (const json& e : j.at("pvd")) r.pvd.push_back({e.at(0).get<double>(), e.at(1).get<std::string>()});
    r.sampled = j.at("sampled").get<long>();
    r.framed = j.at("framed").get<long>();
    r.bounds = j.at("bounds").get<std::array<long, bound_names.size()>>();
    r.dt_min = j.at("dt").at(0).get<double>();
    r.dt_max = j.at("dt").at(1).get<double>();
    r.wall_seconds = j.at("seconds").at(0).get<double>();
    r.cpu_seconds = j.at("seconds").at(1).get<double>();
    r.initial_budgets = j.at("initial_budgets");
    r.particle_steps = j.at("work").at(0).get<double>();
    r.pair_steps = j.at("work").at(1).get<double>();
    r.flowing_samples = j.at("flowing_samples").get<long>();
    const json& extremes = j.at("extremes");
    r.mach = extremes.at(0).get<double>(), r.compression = extremes.at(1).get<double>();
    r.unaccounted = extremes.at(2).get<double>(), r.energy_turned = extremes.at(3).get<double>();
    r.below_data = Share::from(j.at("below_data"));
    r.above_data = Share::from(j.at("above_data"));
    r.ill_posed = Share::from(j.at("ill_posed"));
    r.beta_limited = Share::from(j.at("beta_limited"));
    r.phi_at_floor = Share::from(j.at("phi_at_floor"));
    r.initial_energy = j.at("initial_energy").get<double>();
    return r;
  }
};

/// Least-squares line; its value at 0 extrapolates to the floor.
struct Line {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0;
  void add(double at, double value) { n += 1, x += at, y += value, xx += at * at, xy += at * value; }
  double at_zero() const {
    const double determinant = n * xx - x * x;
    return determinant > 0 ? (xx * y - x * xy) / determinant : (n > 0 ? y / n : 0);
  }
};

template <int Dim>
class Run {
 public:
  Run(const CaseFile& file, const LawFile& law, const FlowOptions& options)
      : options_(options), setup_(make_setup<Dim>(file, law)), effective_(file.effective()) {
    law_hash_ = law_hash(law);
    key_ = sha256(effective_ + law_hash_ + version + git_revision);
    const std::vector<double>& p = setup_.particles.p;
    for (std::size_t i = 0; i < setup_.particles.interior; ++i)
      initial_pressure_ += p[i] / static_cast<double>(setup_.particles.interior);
    flow_ = make_flow<Dim>(setup_);
    setup_.particles = {};  // the flow has its own
    choose_threads();
  }

  json go() {
    const fs::path earlier = options_.folder / "summary.json";
    if (options_.reuse && !options_.force && fs::exists(earlier)) {
      json known = read_json(earlier);
      if (known.value("configuration", "") == key_) return known;
    }
    prepare_folder();
    const auto start = std::chrono::steady_clock::now();
    const double cpu_start = cpu_seconds();
    const double wall_before = record_.wall_seconds;
    const double cpu_before = record_.cpu_seconds;
    const auto elapsed = [&] {
      return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    };
    const auto clock = [&] {
      record_.wall_seconds = wall_before + elapsed();
      record_.cpu_seconds = cpu_before + cpu_seconds() - cpu_start;
    };
    Progress progress(fmt::format("flow {}", options_.folder.filename().string()), options_.quiet);
    double last_checkpoint = 0;
    const double end = setup_.end_time;
    std::string ended = "end time reached";
    if (record_.sampled == 0) sample();
    if (record_.framed == 0) write_frames();
    while (flow_->time() < end * (1 - 1e-12)) {
      // Frames are met to the moment; the series takes the first step at or after each sample's time.
      const double next_frame =
          end * static_cast<double>(record_.framed) / static_cast<double>(setup_.frames);
      const StepInfo step = advance(std::max(next_frame - flow_->time(), 1e-12 * end));
      ++record_.bounds[static_cast<std::size_t>(step.bound)];
      record_.dt_min = std::min(record_.dt_min, step.dt);
      record_.dt_max = std::max(record_.dt_max, step.dt);
      record_.particle_steps += static_cast<double>(flow_->interior());
      record_.pair_steps += static_cast<double>(flow_->pairs());
      const double reached = flow_->time() + 1e-9 * end / samples;
      bool rest = false;
      if (reached >= end * static_cast<double>(record_.sampled) / samples) rest = sample();
      if (reached >= next_frame) write_frames();
      if (progress.due()) {
        const Budgets b = flow_->budgets();
        progress.update(flow_->time() / end,
                        fmt::format("step {}, t = {:.4g} s, dt = {:.3g} s ({}), max |v| = {:.3g} m/s",
                                    flow_->steps(), flow_->time(), step.dt,
                                    bound_names[static_cast<std::size_t>(step.bound)], b.largest_speed));
      }
      if (stop_requested() ||
          elapsed() - last_checkpoint > std::clamp(last_checkpoint, 1.0, checkpoint_every)) {
        last_checkpoint = elapsed();
        clock();
        save_checkpoint();
        if (stop_requested())
          throw Interrupted(fmt::format("{}: stopped at t = {:.4g} s; the same command goes on from there",
                                        options_.folder.string(), flow_->time()));
      }
      if (rest && setup_.stop_at_rest) {
        ended = "at rest";
        break;
      }
    }
    if (record_.pvd.back().time < flow_->time() * (1 - 1e-9)) write_frames();
    clock();
    const json result = summary(ended);
    write_file_atomically(options_.folder / "summary.json", result.dump(1) + "\n");
    for (const json& warning : result.at("warnings"))
      spdlog::warn("{}: {}", options_.folder.string(), warning.at("text").get<std::string>());
    fs::remove(checkpoint());  // no error if there is none
    fs::remove(older_checkpoint());
    progress.finish(fmt::format("{} at t = {:.4g} s, {} steps, {:.3g} million particle-steps a second", ended,
                                flow_->time(), flow_->steps(),
                                1e-6 * record_.particle_steps / record_.wall_seconds));
    return result;
  }

 private:
  fs::path checkpoint() const { return options_.folder / "checkpoint.h5"; }
  fs::path older_checkpoint() const { return options_.folder / "checkpoint.previous.h5"; }
  /// A step; if it breaks down, the error says where the last good state is.
  StepInfo advance(double largest_dt) {
    try {
      return flow_->step(largest_dt);
    } catch (const NumericalError& error) {
      if (!fs::exists(checkpoint())) throw;
      throw NumericalError(fmt::format("{}; the state at t = {:.4g} s is kept in {}", error.what(),
                                       checkpoint_time_, checkpoint().string()));
    }
  }
  /// Two generations are kept: a disk that fails while one is written leaves the other.
  void save_checkpoint() {
    if (fs::exists(checkpoint())) fs::rename(checkpoint(), older_checkpoint());
    flow_->save(checkpoint(), key_, record_.text());
    checkpoint_time_ = flow_->time();
  }
  /// The note of the newest checkpoint that can be read. Throws InputError if none can, or if it belongs to
  /// another configuration.
  std::string load_checkpoint() {
    if (!fs::exists(checkpoint())) return flow_->load(older_checkpoint(), key_);
    try {
      return flow_->load(checkpoint(), key_);
    } catch (const InputError& error) {
      if (!fs::exists(older_checkpoint())) throw;
      spdlog::warn("{}; going back to {}", error.what(), older_checkpoint().string());
      return flow_->load(older_checkpoint(), key_);
    }
  }
  void prepare_folder() {
    fs::create_directories(options_.folder);
    if (options_.force) {
      fs::remove(options_.folder / "summary.json");
      fs::remove(checkpoint());
      fs::remove(older_checkpoint());
    }
    if (fs::exists(options_.folder / "summary.json"))
      throw UsageError(
          fmt::format("{}: holds the results of an earlier run; use --force to overwrite them, or another -o",
                      options_.folder.string()));
    if (fs::exists(checkpoint()) || fs::exists(older_checkpoint())) {
      record_ = Record::from(load_checkpoint());
      checkpoint_time_ = flow_->time();
    } else {
      fs::create_directories(options_.folder / "frames");
      remove_old_frames();
      const Budgets b = flow_->budgets();
      record_.initial_budgets = to_json(b, Dim);
      record_.initial_energy = b.kinetic + b.potential + b.elastic;
    }
    write_file_atomically(options_.folder / "effective.toml", effective_);
  }

  /// Frames of an earlier run that was interrupted or is overwritten; nothing else is touched.
  void remove_old_frames() const {
    for (const fs::directory_entry& entry : fs::directory_iterator(options_.folder / "frames")) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with("frame_") && (name.ends_with(".h5") || name.ends_with(".vtp")))
        fs::remove(entry.path());
    }
  }

  /// The material along x, or along the radius where it is axisymmetric.
  Bodies bodies() {
    flow_->deposit(positions_, volumes_);
    x_.resize(positions_.size());
    for (std::size_t i = 0; i < x_.size(); ++i)
      x_[i] = setup_.axisymmetric ? std::hypot(positions_[i][0], positions_[i][1]) : positions_[i][0];
    return {x_, volumes_, setup_.dx, Dim == 3 && !setup_.axisymmetric ? setup_.period.length[Dim - 2] : 1.0};
  }
  /// Bulk height around the centre, or of the whole of a scene that has no front.
  double height_of(const Bodies& heap) const {
    return setup_.initial_length > 0
               ? centre_height(heap, centre_strip(setup_.grains.d, setup_.dx), setup_.axisymmetric)
               : mean_height(heap, 0, setup_.period.length[0]);
  }

  /// Takes one sample of the series; true if the flow has come to rest.
  bool sample() {
    const Budgets b = flow_->budgets();
    json& s = record_.series;
    const double since_last = s["time"].empty() ? 0.0 : flow_->time() - s["time"].back().get<double>();
    s["time"].push_back(flow_->time());
    s["kinetic_energy"].push_back(b.kinetic);
    s["potential_energy"].push_back(b.potential);
    s["max_speed"].push_back(b.largest_speed);
    s["wall_force_normal"].push_back(b.wall_force[Dim - 1]);
    const Bodies heap = bodies();
    const bool collapse = setup_.initial_length > 0;  // something has a front
    s["front_99"].push_back(collapse ? front_99(heap) : 0.0);
    s["centre_height"].push_back(collapse || std::isfinite(setup_.period.length[0]) ? height_of(heap) : 0.0);
    watch(b);
    record_.sampled = static_cast<long>((flow_->time() / setup_.end_time) * samples * (1 + 1e-12)) + 1;
    if (b.flowing > 0) {
      ++record_.flowing_samples;
      record_.below_data.add(b.below_data / b.flowing, since_last);
      record_.above_data.add(b.above_data / b.flowing, since_last);
      record_.ill_posed.add(b.ill_posed / b.flowing, since_last);
      record_.beta_limited.add(b.beta_limited / b.flowing, since_last);
      record_.phi_at_floor.add(b.phi_at_floor / b.flowing, since_last);
      if (setup_.extrapolate == "error" && b.above_data > setup_.extrapolate_limit * b.flowing)
        throw NumericalError(fmt::format(
            "t = {:.4g} s: {:.1f} % of the flowing mass is at I above {:g}, where the law has no data "
            "(flow.extrapolate_limit = {:g}); calibrate at larger I, raise the limit, or use "
            "flow.extrapolate = "
            "\"warn\" or \"clamp\"",
            flow_->time(), 100 * b.above_data / b.flowing, setup_.law_range.highest,
            setup_.extrapolate_limit));
    }
    const double initial = record_.initial_budgets.at("potential").get<double>();
    return setup_.stop_at_rest &&
           at_rest(flow_->time(), b.kinetic, initial, setup_.length_scale, norm(setup_.gravity));
  }

  void write_frames() {
    const Budgets b = flow_->budgets();
    if (!std::isfinite(b.kinetic + b.elastic + b.wall_force[0] + b.wall_force[Dim - 1]))
      throw NumericalError(
          fmt::format("step {}: energy or acceleration is no longer a finite number; use a smaller "
                      "flow.step_factor; the last good frame is frame_{:05}",
                      flow_->steps(), record_.framed - 1));
    const std::string name = fmt::format("frame_{:05}", record_.framed);
    const Frame frame = flow_->frame();
    write_frame(frame, options_.folder / "frames" / (name + ".h5"));
    write_vtp(frame, options_.folder / "frames" / (name + ".vtp"));
    record_.pvd.push_back({flow_->time(), "frames/" + name + ".vtp"});
    write_pvd(record_.pvd, options_.folder / "frames.pvd");
    ++record_.framed;
    if (setup_.initial_length > 0) {
      const HeightProfile profile =
          deposit_profile(bodies(), setup_.grains.d, setup_.floor_end, setup_.axisymmetric);
      record_.profiles.push_back({{"time", flow_->time()}, {"x", profile.x}, {"height", profile.height}});
    }
  }

  /// How far the flow went beyond what the law's data cover: shares of the mass that flows.
  json beyond_the_law() const {
    const double n = std::max(1.0, static_cast<double>(record_.flowing_samples));
    const auto share = [&](const Record::Share& s) {
      return json{{"mean", s.sum / n}, {"largest", s.largest}, {"time", s.time}};
    };
    json result = json::object();
    if (setup_.law_range.highest > 0) {
      result["I_below_data"] = share(record_.below_data);
      result["I_above_data"] = share(record_.above_data);
    }
    result["ill_posed"] = share(record_.ill_posed);
    const DilationPart& dilation = setup_.parts.dilation;
    if (!std::holds_alternative<NoDilation>(dilation))
      result["beta_at_its_limit"] = share(record_.beta_limited);
    if (std::visit([]<class D>(const D&) { return has_dilation_state<D>; }, dilation))
      result["phi_eq_at_its_floor"] = share(record_.phi_at_floor);
    return result;
  }

  void watch(const Budgets& b) {
    const json& before = record_.initial_budgets;
    const auto initially = [&](const char* what) { return before.at(what).get<double>(); };
    Budgets start;
    start.kinetic = record_.initial_energy;  // all three kinds together
    record_.mach = std::max(record_.mach, b.largest_speed / b.sound_speed);
    record_.compression = std::max(record_.compression, b.largest_compression);
    record_.unaccounted = std::max(record_.unaccounted, std::abs(b.unaccounted_since(start)));
    record_.energy_turned =
        std::max(record_.energy_turned, b.kinetic + std::abs(b.potential - initially("potential")) +
                                            std::abs(b.elastic - initially("elastic")) + b.dissipated);
  }

  /// How far front and centre height went in the second half of the run, over H; 0 if that half did not begin
  /// at rest.
  double moved_at_rest() const {
    const auto values = [&](const char* name) { return record_.series.at(name).get<std::vector<double>>(); };
    const std::vector<double> time = values("time"), front = values("front_99"),
                              height = values("centre_height");
    const auto half = static_cast<std::size_t>(std::lower_bound(time.begin(), time.end(), 0.5 * time.back()) -
                                               time.begin());
    const double initial = record_.initial_budgets.at("potential").get<double>();
    if (!at_rest(time[half], values("kinetic_energy")[half], initial, setup_.length_scale,
                 norm(setup_.gravity)))
      return 0;
    return std::max(std::abs(front.back() - front[half]), std::abs(height.back() - height[half])) /
           setup_.length_scale;
  }
  double mean_pressure() const {
    const Frame frame = flow_->frame();
    const std::vector<double>& p = frame.field("p").values;
    double sum = 0;
    for (std::size_t i = 0; i < flow_->interior(); ++i) sum += p[i];
    return sum / static_cast<double>(flow_->interior());
  }

  /// What makes this run's figures doubtful: a cause to look for, and a sentence for people.
  json warnings() const {
    json list = json::array();
    const auto warn = [&](const char* cause, std::string text) {
      list.push_back({{"cause", cause}, {"text", std::move(text)}});
    };
    if (record_.mach > doubtful_mach)
      warn("speed of sound",
           fmt::format("speeds of up to {:.2g} of that of sound (rho up to {:.2f} rho0): the material is "
                       "compressed as no grains are; use a larger sound speed (a smaller flow.mach)",
                       record_.mach, record_.compression));
    // What rests turns over next to nothing: there the measure is a thousandth of what lifting it by H takes.
    const double least =
        1e-3 * flow_->budgets().mass *
        std::max(norm(setup_.gravity) * setup_.length_scale, 1e-9 * setup_.eos.K / setup_.eos.rho0);
    if (record_.unaccounted > doubtful_energy * record_.energy_turned + least)
      warn("energy",
           fmt::format("{:.2g} J, {:.0f} % of all energy that was turned over, is not accounted for: use a "
                       "smaller flow.step_factor, a finer resolution, or formulation = \"robust\"",
                       record_.unaccounted, 100 * record_.unaccounted / record_.energy_turned));
    const double n = std::max(1.0, static_cast<double>(record_.flowing_samples));
    if (const double mean = record_.ill_posed.sum / n; mean > doubtful_share)
      warn("ill-posed law",
           fmt::format(
               "on average {:.0f} % of the flowing mass ({:.0f} % at most) is at an inertial number at "
               "which this friction law is ill-posed (Barker et al. 2015): the shortest waves grow "
               "fastest, and details may depend on the resolution; law.friction = \"barker_gray_2017\" "
               "is well posed at low I",
               100 * mean, 100 * record_.ill_posed.largest));
    if (const double mean = (record_.below_data.sum + record_.above_data.sum) / n;
        setup_.law_range.highest > 0 && mean > doubtful_share)
      warn("outside of the law's data",
           fmt::format(
               "on average {:.0f} % of the flowing mass is at I below {:g}, {:.0f} % above {:g}, where "
               "the law has no data",
               100 * record_.below_data.sum / n, setup_.law_range.lowest, 100 * record_.above_data.sum / n,
               setup_.law_range.highest));
    if (setup_.scene == "plane_shear")
      if (const double p = mean_pressure(); !(p > 0.8 * initial_pressure_ && p < 1.25 * initial_pressure_))
        warn("pressure",
             fmt::format("the mean pressure is {:.2g} times the one set: at constant volume, density and "
                         "pressure of a fast shear follow the disorder of the particles; use a smaller "
                         "sound speed, or a lower shear rate",
                         p / initial_pressure_));
    if (setup_.length_scale < (least_rows - 0.5) * setup_.dx)
      warn("resolution",
           fmt::format("only {:.0f} particles over the height: every sum is cut off by the surface; "
                       "use a larger flow.resolution",
                       setup_.length_scale / setup_.dx));
    if (setup_.dx < 0.99 * setup_.grains.d)
      warn(
          "smaller than grains",
          fmt::format("the spacing of the particles is {:.2g} grain diameters: what is seen below one has no "
                      "counterpart in grains",
                      setup_.dx / setup_.grains.d));
    if (const DirectStress* direct = std::get_if<DirectStress>(&setup_.parts.stress))
      warn("creep",
           fmt::format("stress = \"direct\" has no rest: what should stand creeps at shear rates of the "
                       "order of g_min = {:g} 1/s; elastic_return has none of it",
                       direct->gamma_dot_min));
    if (!std::visit([](const auto& law) { return law.has_yield_stress; }, setup_.parts.friction))
      warn("creep", "this friction law has no yield stress at rest: what should stand creeps");
    if (const double moved = moved_at_rest(); moved > doubtful_creep)
      warn("creep",
           fmt::format("in the second half of the run front or height moved by {:.1f} % of H, though the "
                       "kinetic energy was that of rest: density diffusion moves what stands, at a rate in "
                       "proportion to h/c; use a finer resolution or a smaller flow.mach",
                       100 * moved));
    if (setup_.step_factor > 1)
      warn("time step", fmt::format("steps of {:g} times the bounds of Eq. 5.28", setup_.step_factor));
    return list;
  }

  /// What an incline shows at the end: slip, surface velocity, pressure on the floor, from lines through
  /// layers.
  json incline_measures() const {
    const Frame frame = flow_->frame();
    const std::vector<double>& x = frame.field("x").values;
    const std::vector<double>& v = frame.field("v").values;
    const double dx = setup_.dx;
    const double top = setup_.length_scale - 2 * dx;
    Line near_floor, pressure;
    double surface = 0;
    double surface_count = 0;
    for (std::size_t i = 0; i < flow_->interior(); ++i) {
      const double z = x[3 * i + Dim - 1];
      if (z < 3 * dx) near_floor.add(z, v[3 * i]);
      if (z < 0.5 * setup_.length_scale) pressure.add(z, frame.field("p").values[i]);
      if (z > top) {
        surface += v[3 * i];
        surface_count += 1;
      }
    }
    return {{"slip", near_floor.at_zero()},
            {"surface_velocity", surface_count > 0 ? surface / surface_count : 0.0},
            {"floor_pressure_extrapolated", pressure.at_zero()}};
  }

  json summary(const std::string& ended) {
    const Budgets b = flow_->budgets();
    const json& before = record_.initial_budgets;
    const double steps = static_cast<double>(flow_->steps());
    Budgets start;
    start.kinetic = record_.initial_energy;  // all three kinds together
    const double unaccounted = b.unaccounted_since(start);
    json bounds;
    for (std::size_t k = 0; k < bound_names.size(); ++k) bounds[bound_names[k]] = record_.bounds[k];
    const double tau = std::sqrt(setup_.length_scale / norm(setup_.gravity));
    json result = {
        {"format", "dem2sph-summary"},
        {"schema_version", 1},
        {"scene", setup_.scene},
        {"formulation", setup_.formulation},
        {"composition", flow_->composition()},
        {"ended", ended},
        {"time", flow_->time()},
        {"steps", flow_->steps()},
        {"particles", flow_->interior()},
        {"wall_particles", flow_->particles() - flow_->interior()},
        {"particles_lost", 0},  // the first one ends the run with an error
        {"threads", threads()},
        {"wall_seconds", record_.wall_seconds},
        {"cpu_seconds", record_.cpu_seconds},
        {"particle_steps_per_second", record_.particle_steps / record_.wall_seconds},
        {"pairs_per_second", record_.pair_steps / record_.wall_seconds},
        {"bytes_per_particle", static_cast<double>(flow_->bytes()) / static_cast<double>(flow_->particles())},
        {"dt", {{"min", record_.dt_min}, {"mean", flow_->time() / steps}, {"max", record_.dt_max}}},
        {"dt_bounds", bounds},
        {"budgets", {{"initial", before}, {"final", to_json(b, Dim)}, {"energy_unaccounted", unaccounted}}},
        {"initial",
         {{"L0", setup_.initial_length},
          {"H0", setup_.length_scale},
          {"solid_fraction", setup_.initial_phi}}},
        {"outside_law", beyond_the_law()},
        {"warnings", warnings()},
        {"extremes",
         {{"mach", record_.mach},
          {"rho_over_rho0", record_.compression},
          {"energy_unaccounted", record_.unaccounted},
          {"energy_turned_over", record_.energy_turned}}},
        {"sound_speed", std::sqrt(setup_.eos.K / setup_.eos.rho0)},
        {"dx", setup_.dx},
        {"h", setup_.h},
        {"series", record_.series},
        {"profiles", record_.profiles},
        {"law_sha256", law_hash_},
        {"case_sha256", sha256(effective_)},
        {"configuration", key_},
        {"provenance", provenance()}};
    if (std::isfinite(tau)) result["time_scale"] = tau;  // without gravity there is none
    if (setup_.scene == "inclined_plane") result["incline"] = incline_measures();
    if (setup_.initial_length > 0)
      result["deposit"] = to_json(Deposit{record_.series.at("front_99").back().get<double>(),
                                          record_.series.at("centre_height").back().get<double>()},
                                  setup_.initial_length, flow_->time() / tau);
    return result;
  }

  /// Threads asked for, or as many as have something to do: below some 2000 particles each, waiting for one
  /// another costs more than it saves (about ten parallel loops a step, each of a few microseconds' start).
  void choose_threads() const {
#ifdef _OPENMP
    const int useful = static_cast<int>(flow_->particles() / 2000) + 1;
    omp_set_num_threads(options_.threads > 0 ? options_.threads : std::min(omp_get_num_procs(), useful));
#endif
  }
  static int threads() {
#ifdef _OPENMP
    return omp_get_max_threads();
#else
    return 1;
#endif
  }

  FlowOptions options_;
  FlowSetup<Dim> setup_;
  std::string effective_;
  std::string law_hash_;
  std::string key_;
  std::unique_ptr<Flow> flow_;
  Record record_;
  double checkpoint_time_ = 0;   // of the state on disk [s]
  double initial_pressure_ = 0;  // mean of the material [Pa]
  std::vector<std::array<double, 3>> positions_;
  std::vector<double> volumes_;
  std::vector<double> x_;
};

template <int Dim>
json run(const CaseFile& file, const LawFile& law, const FlowOptions& options) {
  return Run<Dim>(file, law, options).go();
}

template <int Dim>
std::string plan(const CaseFile& file, const LawFile& law) {
  FlowSetup<Dim> setup = make_setup<Dim>(file, law);
  const double end = setup.end_time;
  const double dx = setup.dx;
  const FrictionLaw friction = setup.parts.friction;
  const ElasticReturn* elastic = std::get_if<ElasticReturn>(&setup.parts.stress);
  const double step_estimate =
      0.25 * setup.h * setup.step_factor /
      std::sqrt((setup.eos.K + (elastic ? 4.0 / 3 * elastic->G : 0.0)) / setup.eos.rho0);
  const std::unique_ptr<Flow> flow = make_flow<Dim>(std::move(setup));
  std::string text = fmt::format("flow: {}\n", fmt::join(flow->composition(), ", "));
  text += fmt::format("  particles      {} inside, {} in walls, spacing {:.4g} m\n", flow->interior(),
                      flow->particles() - flow->interior(), dx);
  const double steps = end / step_estimate;
  text += fmt::format("  steps          about {:.0f} to t = {:.4g} s (sound bound {:.3g} s)\n", steps, end,
                      step_estimate);
  text += fmt::format("  particle-steps about {:.2g}\n", steps * static_cast<double>(flow->interior()));
  text += fmt::format("  memory         {} bytes a particle, of which\n", flow->bytes() / flow->particles());
  std::size_t listed = flow->bytes();
  for (const ArrayInUse& array : flow->arrays_in_use()) {
    text += fmt::format("                 {:>6.1f}  {} [{}]{}\n",
                        static_cast<double>(array.bytes) / static_cast<double>(flow->particles()), array.name,
                        array.unit, array.components > 1 ? fmt::format(" x {}", array.components) : "");
    listed -= array.bytes;
  }
  text += fmt::format("                 {:>6.1f}  list of neighbours\n",
                      static_cast<double>(listed) / static_cast<double>(flow->particles()));
  if (!std::visit([](const auto& member) { return member.has_yield_stress; }, friction))
    text += "  note           this friction law has no yield stress at rest: what should stand creeps\n";
  const PassList list = flow->passes();
  for (const std::string& pass : list.passes) text += fmt::format("  each step      {}\n", pass);
  for (const std::string& part : list.left_out) text += fmt::format("  left out       {}\n", part);
  return text;
}

}  // namespace

json run_flow(const CaseFile& file, const LawFile& law, const FlowOptions& options) {
  return flow_dimension(file) == 3 ? run<3>(file, law, options) : run<2>(file, law, options);
}

std::string plan_flow(const CaseFile& file, const LawFile& law) {
  return flow_dimension(file) == 3 ? plan<3>(file, law) : plan<2>(file, law);
}

}  // namespace dem2sph
