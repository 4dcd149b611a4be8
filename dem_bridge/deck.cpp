#include "dem_bridge/deck.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <iterator>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "dem_bridge/deck_text.hpp"
#include "sph/base/errors.hpp"

namespace dem2sph::bridge {
namespace {

/// Volume of all grains over d^3.
double solid_volume(const Sample& sample) {
  return static_cast<double>(sample.grains) * std::numbers::pi / 6 * mean_cube(sample.material.size_spread);
}

double inertial_time(const GrainMaterial& m, double pressure) { return m.d * std::sqrt(m.rho_s / pressure); }

void add_header(Deck& deck, std::string_view what, std::string_view z_boundary) {
  deck.add(
      "# dem2sph shear cell, deck version {}: {}. Made from typed values, not meant to be edited. SI units.",
      deck_version, what);
  add_settings(deck, fmt::format("p p {}", z_boundary));
}

/// All three types, flow and walls, are of one material.
void add_material(Deck& deck, const Sample& sample, double friction, double step) {
  add_contact_law(deck, sample.material, sample.pressure, {.count = 3, .friction = friction}, step);
}

/// Everything that holds and loads the two walls and moves the grains between them.
void add_walls(Deck& deck, double pressure, double area, double damping) {
  deck.add("variable wallgrains equal count(top)");
  deck.add("variable zbottom equal xcm(bottom,z)");
  deck.add("variable ztop equal xcm(top,z)");
  deck.add("variable distance equal v_ztop-v_zbottom");
  deck.add("fix hold bottom freeze");
  deck.add("fix load top addforce 0.0 0.0 $({:.10g}/v_wallgrains)", -pressure * area);
  deck.add("fix piston top rigid single force * off off on torque * off off off");
  deck.add("fix move flow nve/sphere");
  deck.add("fix pistondamping top viscous {:.10g}", piston_damping * damping);
  deck.add(
      "# the body's total force contains load and damping: taken off, the contacts' force on the wall "
      "remains");
  deck.add("variable normalstress equal (f_piston[1][9]+{:.10g}+{:.10g}*v_wallgrains*f_piston[1][6])/{:.10g}",
           pressure * area, piston_damping * damping, area);
  deck.add("variable shearstress equal -(f_piston[1][7]+{:.10g}*v_wallgrains*f_piston[1][4])/{:.10g}",
           piston_damping * damping, area);
}

void add_wall_series(Deck& deck, std::int64_t interval) {
  deck.add("fix wall all ave/time {} 10 {} v_distance v_normalstress v_shearstress file {}", interval / 10,
           interval, wall_series_file);
}

/// A restart file starts the next run at step 0: the engine allows a reset before it is written, not after it
/// was read.
void add_end(Deck& deck, bool writes_restart) {
  deck.add("variable reached equal $(step)");
  if (writes_restart) {
    deck.add("unfix wall");
    deck.add("reset_timestep 0");
    deck.add("write_restart {}", restart_file);
  }
  deck.add("print \"DEM2SPH reached step ${{reached}} with $(atoms) grains\"");
}

double base_area(const Sample& sample) {
  return sample.length * sample.width * sample.material.d * sample.material.d;
}

/// Viscous damping of one grain, rho_s d^3/t_i [kg/s].
double viscous_damping(const Sample& sample) {
  const GrainMaterial& m = sample.material;
  return m.rho_s * m.d * m.d * m.d / inertial_time(m, sample.pressure);
}

void check_sample(const Sample& sample) {
  // A grain that sees its own periodic image has a neighbour list that is wrong: 4 of the largest grains.
  if (!(std::min(sample.length, sample.width) >= 4 * (1 + sample.material.size_spread)))
    throw UsageError(fmt::format("the base area {:g} d x {:g} d is too small: at least 5 d each way",
                                 sample.length, sample.width));
  if (!(expected_gap(sample) >= 4))
    throw UsageError(
        fmt::format("{} grains on {:g} d x {:g} d leave {:.2g} d between the walls; at least 4 d are needed: "
                    "raise \"grains\" or lower \"length\" and \"width\"",
                    sample.grains, sample.length, sample.width, expected_gap(sample)));
}

// Measured with LIGGGHTS 3.8.0 on one core: million grain-steps a second in shear, and the time for dumping
// and reading back one grain of a frame.
constexpr double grain_steps_a_second = 3.0e6;
constexpr double seconds_a_dumped_grain = 4e-6;

}  // namespace

double kappa(const Sample& sample) {
  const GrainMaterial& m = sample.material;
  return m.contact == ContactModel::hooke ? m.stiffness
                                          : std::pow(m.youngs_modulus / sample.pressure, 2.0 / 3);
}

std::string TimeStep::bound() const {
  return rayleigh < 0.25 * contact_duration ? "Rayleigh time" : "duration of a contact";
}

TimeStep time_step(const Sample& sample) {
  const GrainMaterial& m = sample.material;
  const double pi = std::numbers::pi;
  const double smallest = 1 - m.size_spread;
  const double mass = 0.5 * grain_mass(m, smallest);  // effective, of two of the smallest grains
  const double speed = std::sqrt(sample.pressure / m.rho_s);
  TimeStep t;
  if (m.contact == ContactModel::hooke) {
    const double damped = std::sqrt(1 - std::pow(damping_ratio(m), 2));
    t.rayleigh = std::numeric_limits<double>::infinity();
    t.contact_duration = pi * std::sqrt(mass / hooke_contact(m, sample.pressure).k_n) / damped;
    t.fastest_collision = t.contact_duration;
  } else {
    const double radius = 0.25 * smallest * m.d;  // effective
    const double modulus = m.youngs_modulus / (2 * (1 - m.poisson_ratio * m.poisson_ratio));
    const double shear_modulus = m.youngs_modulus / (2 * (1 + m.poisson_ratio));
    t.rayleigh =
        pi * 0.5 * smallest * m.d * std::sqrt(m.rho_s / shear_modulus) / (0.1631 * m.poisson_ratio + 0.8766);
    // Hertz: F = 4/3 E* sqrt(R) delta^1.5, so the tangent stiffness at F is (6 E*^2 R F)^(1/3).
    const double force = sample.pressure * m.d * m.d;
    t.contact_duration = pi * std::sqrt(mass / std::cbrt(6 * modulus * modulus * radius * force));
    // Johnson, Contact Mechanics (1985), Eq. 11.24: 2.87 (m^2/(R E*^2 v))^(1/5).
    t.fastest_collision = 2.87 * std::pow(mass * mass / (radius * modulus * modulus * speed), 0.2);
  }
  t.step = sample.time_step_fraction * std::min(t.rayleigh, 0.25 * t.contact_duration);
  return t;
}

double expected_gap(const Sample& sample) {
  return solid_volume(sample) / (0.59 * sample.length * sample.width) - 2 * wall_thickness_in_d;
}

DeckPlan plan_packing(const Sample& sample) {
  check_sample(sample);
  DeckPlan plan;
  plan.time_step = time_step(sample);
  plan.inertial_time = inertial_time(sample.material, sample.pressure);
  // 24 inertial times to compress and as many to settle: the wall's pressure is then steady to 1 %.
  const double stage = 24 * plan.inertial_time / plan.time_step.step;
  plan.compress_steps = static_cast<std::int64_t>(std::ceil(stage));
  plan.rest_steps = static_cast<std::int64_t>(std::ceil(0.2 * stage));
  // The force on the wall is watched while the packing settles, twice in an inertial time.
  plan.wall_samples = 48;
  plan.frame_interval = std::max<std::int64_t>(10, 10 * std::llround(stage / 480));
  // The series is written at multiples of its interval only.
  const std::int64_t before = 1 + plan.compress_steps + plan.rest_steps;
  plan.rest_steps += (plan.frame_interval - before % plan.frame_interval) % plan.frame_interval;
  plan.settle_steps = plan.wall_samples * plan.frame_interval;
  plan.last_step = 1 + plan.compress_steps + plan.rest_steps + plan.settle_steps;
  plan.seeds = prime_seeds(sample.seed, 2 + size_count);
  plan.core_seconds =
      static_cast<double>(sample.grains) * static_cast<double>(plan.last_step) / grain_steps_a_second;
  return plan;
}

DeckPlan plan_shearing(const Sample& sample, const Shearing& shearing) {
  check_sample(sample);
  if (!(shearing.strain_used > 0) || !(shearing.I_driven > 0) || !(shearing.pressure > 0))
    throw UsageError("a run needs a strain, a pressure and an inertial number above 0");
  DeckPlan plan;
  plan.time_step = time_step(sample);
  plan.inertial_time = inertial_time(sample.material, shearing.pressure);
  // Strain over one frame, in steps: a unit of strain lasts t_i/I. Multiples of 10, since the wall's force is
  // averaged over ten samples between frames. Without frames the wall is looked at 100 times.
  const double steps_a_strain = plan.inertial_time / (shearing.I_driven * plan.time_step.step);
  const auto samples = static_cast<double>(shearing.frames > 0 ? shearing.frames : 100);
  const double interval = shearing.strain_used / samples * steps_a_strain;
  plan.frame_interval = std::max<std::int64_t>(10, 10 * std::llround(interval / 10));
  const double strain_per_frame = static_cast<double>(plan.frame_interval) / steps_a_strain;
  plan.wall_samples = static_cast<std::int64_t>(
      std::ceil((shearing.strain_dropped + shearing.strain_used) / strain_per_frame));
  plan.frames = shearing.frames > 0 ? plan.wall_samples + 1 : 0;
  plan.last_step = plan.wall_samples * plan.frame_interval;
  const auto grains = static_cast<double>(sample.grains);
  plan.core_seconds = grains * (static_cast<double>(plan.last_step) / grain_steps_a_second +
                                static_cast<double>(plan.frames) * seconds_a_dumped_grain);
  // 82 bytes a grain and 2.3 contacts of 46 bytes each, at most.
  plan.dump_bytes = grains * static_cast<double>(plan.frames) * (82 + 2.3 * 46);
  return plan;
}

std::string sentinel(std::int64_t grains, std::int64_t step) {
  return fmt::format("DEM2SPH reached step {} with {} grains", step, grains);
}

std::string packing_deck(const Sample& sample) {
  const DeckPlan plan = plan_packing(sample);
  const GrainMaterial& m = sample.material;
  const double d = m.d;
  const double area = base_area(sample);
  const double volume = solid_volume(sample) * d * d * d;
  const double damping = viscous_damping(sample);
  const double slab = wall_thickness_in_d * d;
  const std::array<double, size_count> classes = size_classes(m.size_spread);

  Deck deck;
  add_header(deck, "a packing between rough walls under a constant load, no gravity", "p");
  deck.add("");
  deck.add("# 1. pour: three times as high as the packing will be, so that grains find free places");
  deck.add("region box block 0 {:.10g} 0 {:.10g} 0 {:.10g} units box", sample.length * d, sample.width * d,
           volume / 0.26 / area);
  deck.add("create_box 3 box   # types: 1 flow, 2 bottom wall, 3 top wall; all of one material");
  add_material(deck, sample, sample.packing_friction, plan.time_step.step);
  for (std::size_t k = 0; k < size_count; ++k)
    deck.add(
        "fix size{} all particletemplate/sphere {} atom_type 1 density constant {:.10g} radius constant "
        "{:.10g}",
        k + 1, plan.seeds[2 + k], m.rho_s, 0.5 * classes[k] * d);
  deck.add(
      "fix sizes all particledistribution/discrete/numberbased {} 5 size1 0.2 size2 0.2 size3 0.2 size4 "
      "0.2 size5 0.2",
      plan.seeds[1]);
  deck.add(
      "fix insert all insert/pack seed {} distributiontemplate sizes vel constant 0. 0. 0. insert_every "
      "once overlapcheck yes all_in no maxattempt 500 particles_in_region {} region box",
      plan.seeds[0], sample.grains);
  deck.add("fix move all nve/sphere");
  add_thermo(deck, 20 * plan.frame_interval);
  deck.add("run 1");
  deck.add("unfix insert");
  deck.add("");
  deck.add("# 2. compress to a solid fraction of 0.56, damped, then rest");
  deck.add("fix still all viscous {:.10g}", 0.5 * damping);
  deck.add("fix squeeze all deform 1 z final 0 {:.10g} remap x units box", volume / 0.56 / area);
  deck.add("run {}", plan.compress_steps);
  deck.add("unfix squeeze");
  deck.add("run {}", plan.rest_steps);
  deck.add("unfix still");
  deck.add("");
  deck.add(
      "# 3. walls from the packing itself; groups after change_box, which wraps stray grains back into "
      "the box");
  deck.add("region lowslab block INF INF INF INF INF $(zlo+{:.10g}) units box", slab);
  deck.add("region highslab block INF INF INF INF $(zhi-{:.10g}) INF units box", slab);
  deck.add("change_box all boundary p p f");
  deck.add("change_box all z delta {:.10g} {:.10g} units box", -d, 12 * d);
  deck.add("group bottom region lowslab");
  deck.add("group top region highslab");
  deck.add("set group bottom type 2");
  deck.add("set group top type 3");
  deck.add("group walls union bottom top");
  deck.add("group flow subtract all walls");
  deck.add("neigh_modify exclude group bottom bottom");
  deck.add("neigh_modify exclude group top top");
  deck.add("# spins too: a frozen grain would keep its spin for ever and drag the flow along");
  deck.add("velocity all set 0 0 0");
  deck.add("set group all omegax 0.0 omegay 0.0 omegaz 0.0");
  deck.add("unfix move");
  add_walls(deck, sample.pressure, area, damping);
  deck.add("fix still flow viscous {:.10g}", 0.1 * damping);
  add_wall_series(deck, plan.frame_interval);
  deck.add("run {}", plan.settle_steps);
  add_end(deck, true);
  return std::move(deck).text();
}

std::string shearing_deck(const Sample& sample, const Shearing& shearing, const std::string& restart) {
  const bool plain = std::all_of(restart.begin(), restart.end(), [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' || c == '/' || c == '_' || c == '-';
  });
  if (!plain || restart.empty()) throw std::logic_error("a path that may not stand in a deck: " + restart);
  const DeckPlan plan = plan_shearing(sample, shearing);
  const double slab = wall_thickness_in_d * sample.material.d;

  Deck deck;
  add_header(deck, "plane shear between rough walls under a constant load, no gravity", "f");
  deck.add("read_restart {}", restart);
  add_material(deck, sample, sample.material.grain_friction, plan.time_step.step);
  deck.add(
      "neigh_modify exclude group bottom bottom   # groups come with the restart file, exclusions do not");
  deck.add("neigh_modify exclude group top top");
  if (!shearing.keeps_velocity) {
    deck.add(
        "# linear velocity profile at the start; a rigid body takes the velocity that its grains have when "
        "it is made");
    deck.add("variable low equal xcm(bottom,z)");
    deck.add("variable high equal xcm(top,z)");
    deck.add("variable speed equal {:.10g}*(v_high-v_low-{:.10g})",
             shearing.direction * shearing.I_driven / plan.inertial_time, slab);
    deck.add("velocity all set 0 0 0");
    deck.add("set group all omegax 0.0 omegay 0.0 omegaz 0.0");
    deck.add("velocity flow ramp vx 0 $(v_speed) z $(v_low+{0:.10g}) $(v_high-{0:.10g}) units box",
             0.5 * slab);
    deck.add("velocity top set $(v_speed) 0 0");
  }
  add_walls(deck, shearing.pressure, base_area(sample), viscous_damping(sample));
  deck.add(
      "compute contacts all pair/gran/local id force   # before the first run, or the engine refuses it");
  add_thermo(deck, 20 * plan.frame_interval);
  add_wall_series(deck, plan.frame_interval);
  if (shearing.frames > 0) {
    deck.add("dump grains all custom {} {} id type x y z vx vy vz radius", plan.frame_interval,
             grain_dump_file);
    deck.add("dump_modify grains format \"%d %d %.9g %.9g %.9g %.7g %.7g %.7g %.7g\"");
    deck.add(
        "dump contacts all local {} {} c_contacts[1] c_contacts[2] c_contacts[3] c_contacts[4] "
        "c_contacts[5] c_contacts[6]",
        plan.frame_interval, contact_dump_file);
  }
  deck.add("run {}", plan.last_step);
  add_end(deck, shearing.frames == 0);
  return std::move(deck).text();
}

std::string probe_deck(const Sample& sample) {
  const double d = sample.material.d;
  Deck deck;
  add_header(deck, "three grains: does the engine know the contact law", "p");
  deck.add("region box block 0 {0:.10g} 0 {0:.10g} 0 {0:.10g} units box", 10 * d);
  deck.add("create_box 3 box");
  for (int type = 1; type <= 3; ++type)  // the engine wants a grain of every type
    deck.add("create_atoms {} single {:.10g} {:.10g} {:.10g} units box", type, 2.5 * type * d, 5 * d, 5 * d);
  deck.add("set group all diameter {:.10g} density {:.10g}", d, sample.material.rho_s);
  add_material(deck, sample, sample.material.grain_friction, time_step(sample).step);
  deck.add("fix move all nve/sphere");
  deck.add("run 0");
  add_end(deck, false);
  return std::move(deck).text();
}

std::string check_deck(const Sample& sample) {
  Deck deck;
  add_header(deck, "reads a restart file back", "f");
  deck.add("read_restart {}", restart_file);
  add_material(deck, sample, sample.material.grain_friction, time_step(sample).step);
  deck.add("fix move all nve/sphere");
  deck.add("run 0");
  add_end(deck, false);
  return std::move(deck).text();
}

nlohmann::json to_json(const Sample& sample) {
  const GrainMaterial& m = sample.material;
  nlohmann::json material{{"d", m.d},
                          {"size_spread", m.size_spread},
                          {"rho_s", m.rho_s},
                          {"grain_friction", m.grain_friction},
                          {"restitution", m.restitution},
                          {"rolling_friction", m.rolling_friction},
                          {"cohesion", m.cohesion},
                          {"contact", m.contact == ContactModel::hertz ? "hertz" : "hooke"}};
  if (m.contact == ContactModel::hertz) {
    material["youngs_modulus"] = m.youngs_modulus;
    material["poisson_ratio"] = m.poisson_ratio;
  } else {
    material["stiffness"] = m.stiffness;
  }
  return {{"material", material},
          {"pressure", sample.pressure},
          {"grains", sample.grains},
          {"length", sample.length},
          {"width", sample.width},
          {"packing_friction", sample.packing_friction},
          {"time_step_fraction", sample.time_step_fraction},
          {"seed", sample.seed},
          {"ranks", sample.ranks}};
}

nlohmann::json to_json(const Shearing& shearing) {
  return {{"I_driven", shearing.I_driven},
          {"pressure", shearing.pressure},
          {"direction", shearing.direction},
          {"keeps_velocity", shearing.keeps_velocity},
          {"strain_dropped", shearing.strain_dropped},
          {"strain_used", shearing.strain_used},
          {"frames", shearing.frames}};
}

Sample sample_from_json(const nlohmann::json& json) {
  try {
    Sample sample;
    const nlohmann::json& m = json.at("material");
    GrainMaterial& material = sample.material;
    m.at("d").get_to(material.d);
    m.at("size_spread").get_to(material.size_spread);
    m.at("rho_s").get_to(material.rho_s);
    m.at("grain_friction").get_to(material.grain_friction);
    m.at("restitution").get_to(material.restitution);
    m.at("rolling_friction").get_to(material.rolling_friction);
    m.at("cohesion").get_to(material.cohesion);
    material.contact =
        m.at("contact").get<std::string>() == "hertz" ? ContactModel::hertz : ContactModel::hooke;
    if (material.contact == ContactModel::hertz) {
      m.at("youngs_modulus").get_to(material.youngs_modulus);
      m.at("poisson_ratio").get_to(material.poisson_ratio);
    } else {
      m.at("stiffness").get_to(material.stiffness);
    }
    json.at("pressure").get_to(sample.pressure);
    json.at("grains").get_to(sample.grains);
    json.at("length").get_to(sample.length);
    json.at("width").get_to(sample.width);
    json.at("packing_friction").get_to(sample.packing_friction);
    json.at("time_step_fraction").get_to(sample.time_step_fraction);
    json.at("seed").get_to(sample.seed);
    json.at("ranks").get_to(sample.ranks);
    return sample;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("the description of a sample is damaged: {}", error.what()));
  }
}

Shearing shearing_from_json(const nlohmann::json& json) {
  try {
    Shearing shearing;
    json.at("I_driven").get_to(shearing.I_driven);
    json.at("pressure").get_to(shearing.pressure);
    json.at("direction").get_to(shearing.direction);
    json.at("keeps_velocity").get_to(shearing.keeps_velocity);
    json.at("strain_dropped").get_to(shearing.strain_dropped);
    json.at("strain_used").get_to(shearing.strain_used);
    json.at("frames").get_to(shearing.frames);
    return shearing;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("the description of a shearing is damaged: {}", error.what()));
  }
}

}  // namespace dem2sph::bridge
