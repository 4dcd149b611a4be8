#include "dem_bridge/deck.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <numbers>

#include "sph/base/errors.hpp"

namespace dem2sph::bridge {
namespace {

constexpr std::size_t sizes = 5;

/// Diameters over d: equal steps from 1 - spread to 1 + spread.
std::array<double, sizes> size_classes(double spread) {
  return {1 - spread, 1 - spread / 2, 1.0, 1 + spread / 2, 1 + spread};
}

/// Volume of all grains over d^3.
double solid_volume(const ShearCell& cell) {
  double cubes = 0;
  for (const double s : size_classes(cell.material.size_spread)) cubes += s * s * s / sizes;
  return static_cast<double>(cell.grains) * std::numbers::pi / 6 * cubes;
}

bool is_prime(std::int64_t n) {
  if (n % 2 == 0) return n == 2;
  for (std::int64_t k = 3; k * k <= n; k += 2)
    if (n % k == 0) return false;
  return n > 1;
}

/// LIGGGHTS takes only primes above 10000, and its generators must not start alike. They are drawn from the
/// run's seed by SplitMix64 (Steele, Lea, Flood 2014) between 10^6 and 10^8, each moved on to the next prime.
std::vector<std::int64_t> prime_seeds(std::int64_t seed, std::size_t count) {
  std::vector<std::int64_t> primes;
  auto state = static_cast<std::uint64_t>(seed);
  while (primes.size() < count) {
    state += 0x9e3779b97f4a7c15ULL;
    std::uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    z ^= z >> 31;
    auto candidate = static_cast<std::int64_t>(1'000'000 + z % 99'000'000);
    while (!is_prime(candidate)) ++candidate;
    if (std::find(primes.begin(), primes.end(), candidate) == primes.end()) primes.push_back(candidate);
  }
  return primes;
}

double inertial_time(const ShearCell& cell) {
  return cell.material.d * std::sqrt(cell.material.rho_s / cell.pressure);
}

struct HookeContact {
  double k_n, k_t, damping, duration;
};

/// Linear spring and dashpot with the restitution wanted, for two grains of diameter d.
HookeContact hooke_contact(const ShearCell& cell) {
  const GrainMaterial& m = cell.material;
  const double k_n = m.stiffness * cell.pressure * m.d;
  const double effective_mass = 0.5 * m.rho_s * std::numbers::pi / 6 * m.d * m.d * m.d;
  const double log_e = std::log(m.restitution);
  const double ratio = -log_e / std::hypot(std::numbers::pi, log_e);  // of the damping to the critical one
  const double frequency = std::sqrt(k_n / effective_mass);
  // k_t/k_n = 0.8: Mindlin's 2 (1 - nu)/(2 - nu) at nu = 0.3. The engine multiplies the damping by the
  // effective mass.
  return {k_n, 0.8 * k_n, 2 * ratio * frequency,
          std::numbers::pi / (frequency * std::sqrt(1 - ratio * ratio))};
}

double time_step(const ShearCell& cell) {
  const GrainMaterial& m = cell.material;
  if (m.contact == ContactModel::hooke) return 0.25 * cell.time_step_fraction * hooke_contact(cell).duration;
  const double shear_modulus = m.youngs_modulus / (2 * (1 + m.poisson_ratio));
  const double smallest_radius = 0.5 * (1 - m.size_spread) * m.d;
  const double rayleigh = std::numbers::pi * smallest_radius * std::sqrt(m.rho_s / shear_modulus) /
                          (0.1631 * m.poisson_ratio + 0.8766);
  return cell.time_step_fraction * rayleigh;
}

std::string repeated(double value, int times) {
  std::string text;
  for (int i = 0; i < times; ++i) text += fmt::format(" {:.10g}", value);
  return text;
}

}  // namespace

double expected_gap(const ShearCell& cell) {
  return solid_volume(cell) / (0.59 * cell.length * cell.width) - 2 * wall_thickness_in_d;
}

DeckPlan plan_deck(const ShearCell& cell) {
  const double core = expected_gap(cell) - 2 * cell.core_margin;
  if (!(core >= 2))
    throw UsageError(fmt::format(
        "{} grains on {:g} d x {:g} d leave a core of {:.2g} d between margins of {:g} d; at least 2 d are "
        "needed: raise \"grains\" or lower \"length\" and \"width\"",
        cell.grains, cell.length, cell.width, core, cell.core_margin));
  // A grain that sees its own periodic image has a neighbour list that is wrong: 4 of the largest grains.
  if (!(std::min(cell.length, cell.width) >= 4 * (1 + cell.material.size_spread)))
    throw UsageError(fmt::format("the base area {:g} d x {:g} d is too small: at least 5 d each way",
                                 cell.length, cell.width));
  if (cell.frames < 1 || !(cell.strain_used > 0) || !(cell.I_driven > 0))
    throw UsageError("a run needs frames, a strain and an inertial number above 0");

  DeckPlan plan;
  plan.time_step = time_step(cell);
  plan.inertial_time = inertial_time(cell);
  // Strain over one frame, in steps: a unit of strain lasts t_i/I. Multiples of 10, since the wall's force is
  // averaged over ten samples between frames.
  const double strain_step = cell.strain_used / static_cast<double>(cell.frames);
  const double interval = strain_step * plan.inertial_time / (cell.I_driven * plan.time_step);
  plan.frame_interval = std::max<std::int64_t>(10, 10 * std::llround(interval / 10));
  const double strain_per_frame =
      static_cast<double>(plan.frame_interval) * plan.time_step * cell.I_driven / plan.inertial_time;
  const auto shear_frames =
      static_cast<std::int64_t>(std::ceil((cell.strain_dropped + cell.strain_used) / strain_per_frame));

  // 24 inertial times to compress and as many to settle: the wall's pressure is then steady to 1 %.
  const double stage = 24 * plan.inertial_time / plan.time_step;
  plan.compress_steps = static_cast<std::int64_t>(std::ceil(stage));
  plan.rest_steps = static_cast<std::int64_t>(std::ceil(0.2 * stage));
  plan.settle_steps = static_cast<std::int64_t>(std::ceil(stage));
  // Dumps fall on multiples of the interval, and the first frame shall be the packing before any shear.
  const std::int64_t prepared = 1 + plan.compress_steps + plan.rest_steps + plan.settle_steps;
  const std::int64_t over = prepared % plan.frame_interval;
  if (over > 0) plan.settle_steps += plan.frame_interval - over;
  plan.shear_start = 1 + plan.compress_steps + plan.rest_steps + plan.settle_steps;
  plan.frames = shear_frames + 1;
  plan.last_step = plan.shear_start + shear_frames * plan.frame_interval;
  plan.seeds = prime_seeds(cell.seed, 2 + sizes);

  // Measured with LIGGGHTS 3.8.0 on one core: about 3 million grain-steps a second at rest and in shear, and
  // 4 us a grain for dumping and reading back a frame.
  const auto grains = static_cast<double>(cell.grains);
  plan.core_seconds =
      grains * (static_cast<double>(plan.last_step) / 3.0e6 + static_cast<double>(plan.frames) * 4e-6);
  // 82 bytes a grain and 2.3 contacts of 46 bytes each, at most.
  plan.dump_bytes = grains * static_cast<double>(plan.frames) * (82 + 2.3 * 46);
  return plan;
}

std::string sentinel(const ShearCell& cell) {
  return fmt::format("DEM2SPH reached step {} with {} grains", plan_deck(cell).last_step, cell.grains);
}

std::string write_deck(const ShearCell& cell) {
  const DeckPlan plan = plan_deck(cell);
  const GrainMaterial& m = cell.material;
  const double d = m.d;
  const double area = cell.length * cell.width * d * d;
  const double volume = solid_volume(cell) * d * d * d;
  const double damping = m.rho_s * d * d * d / plan.inertial_time;  // [kg/s]
  const double slab = wall_thickness_in_d * d;
  const std::array<double, sizes> classes = size_classes(m.size_spread);

  std::string deck;
  const auto add = [&deck]<class... Args>(fmt::format_string<Args...> format, Args&&... args) {
    fmt::format_to(std::back_inserter(deck), format, std::forward<Args>(args)...);
    deck += '\n';
  };

  add("# dem2sph shear cell, deck version {}: made from typed values, not meant to be edited.", deck_version);
  add("# Constant-pressure plane shear between rough walls, no gravity, SI units. Stages: pour, compress, "
      "walls, shear.");
  add("units si");
  add("atom_style granular");
  add("atom_modify map array");
  add("boundary p p p");
  add("newton off");
  add("communicate single vel yes");
  add("");
  add("# 1. pour: three times as high as the packing will be, so that grains find free places");
  add("region box block 0 {:.10g} 0 {:.10g} 0 {:.10g} units box", cell.length * d, cell.width * d,
      volume / 0.26 / area);
  add("create_box 3 box   # types: 1 flow, 2 bottom wall, 3 top wall; all of one material");
  add("neighbor {:.10g} bin", 0.25 * d);
  add("neigh_modify delay 0");
  if (m.contact == ContactModel::hertz) {
    add("fix young all property/global youngsModulus peratomtype{}", repeated(m.youngs_modulus, 3));
    add("fix poisson all property/global poissonsRatio peratomtype{}", repeated(m.poisson_ratio, 3));
    add("fix bounce all property/global coefficientRestitution peratomtypepair 3{}",
        repeated(m.restitution, 9));
  } else {
    const HookeContact contact = hooke_contact(cell);
    add("fix normal all property/global kn peratomtypepair 3{}", repeated(contact.k_n, 9));
    add("fix tangential all property/global kt peratomtypepair 3{}", repeated(contact.k_t, 9));
    add("fix normaldamping all property/global gamman peratomtypepair 3{}", repeated(contact.damping, 9));
    add("fix tangentialdamping all property/global gammat peratomtypepair 3{}", repeated(0, 9));
  }
  add("fix friction all property/global coefficientFriction peratomtypepair 3{}",
      repeated(cell.preparation_friction, 9));
  add("{}", m.contact == ContactModel::hertz
                ? "pair_style gran model hertz tangential history"
                : "pair_style gran model hooke/stiffness tangential history tangential_damping off");
  add("pair_coeff * *");
  add("timestep {:.10g}", plan.time_step);
  for (std::size_t k = 0; k < sizes; ++k)
    add("fix size{} all particletemplate/sphere {} atom_type 1 density constant {:.10g} radius constant "
        "{:.10g}",
        k + 1, plan.seeds[2 + k], m.rho_s, 0.5 * classes[k] * d);
  add("fix sizes all particledistribution/discrete/numberbased {} 5 size1 0.2 size2 0.2 size3 0.2 size4 0.2 "
      "size5 0.2",
      plan.seeds[1]);
  add("fix insert all insert/pack seed {} distributiontemplate sizes vel constant 0. 0. 0. insert_every once "
      "overlapcheck yes all_in no maxattempt 500 particles_in_region {} region box",
      plan.seeds[0], cell.grains);
  add("fix move all nve/sphere");
  add("compute contacts all pair/gran/local id force   # before the first run, or the engine refuses it");
  add("thermo_style custom step atoms ke cpu");
  add("thermo {}", 20 * plan.frame_interval);
  add("thermo_modify lost error norm no");
  add("run 1");
  add("unfix insert");
  add("");
  add("# 2. compress to a solid fraction of 0.56, damped, then rest");
  add("fix still all viscous {:.10g}", 0.5 * damping);
  add("fix squeeze all deform 1 z final 0 {:.10g} remap x units box", volume / 0.56 / area);
  add("run {}", plan.compress_steps);
  add("unfix squeeze");
  add("run {}", plan.rest_steps);
  add("unfix still");
  add("");
  add("# 3. walls from the packing itself; groups after change_box, which wraps stray grains back into the "
      "box");
  add("region lowslab block INF INF INF INF INF $(zlo+{:.10g}) units box", slab);
  add("region highslab block INF INF INF INF $(zhi-{:.10g}) INF units box", slab);
  add("change_box all boundary p p f");
  add("change_box all z delta {:.10g} {:.10g} units box", -d, 12 * d);
  add("group bottom region lowslab");
  add("group top region highslab");
  add("set group bottom type 2");
  add("set group top type 3");
  add("group walls union bottom top");
  add("group flow subtract all walls");
  add("neigh_modify exclude group bottom bottom");
  add("neigh_modify exclude group top top");
  add("variable wallgrains equal count(top)");
  add("# spins too: a frozen grain would keep its spin for ever and drag the flow along");
  add("velocity all set 0 0 0");
  add("set group all omegax 0.0 omegay 0.0 omegaz 0.0");
  add("unfix move");
  add("fix hold bottom freeze");
  add("fix load top addforce 0.0 0.0 $({:.10g}/v_wallgrains)", -cell.pressure * area);
  add("fix piston top rigid single force * off off on torque * off off off");
  add("fix move flow nve/sphere");
  add("fix pistondamping top viscous {:.10g}", piston_damping * damping);
  add("fix still flow viscous {:.10g}", 0.1 * damping);
  add("run {}", plan.settle_steps);
  add("unfix still");
  add("");
  add("# 4. shear: friction of the material, linear velocity profile at the start, constant speed of the top "
      "wall");
  add("unfix friction");
  add("fix friction all property/global coefficientFriction peratomtypepair 3{}",
      repeated(m.grain_friction, 9));
  add("variable zbottom equal xcm(bottom,z)");
  add("variable ztop equal xcm(top,z)");
  add("variable speed equal {:.10g}*(v_ztop-v_zbottom-{:.10g})", cell.I_driven / plan.inertial_time, slab);
  add("variable constantspeed equal $(v_speed)");
  add("unfix piston   # a rigid body takes the velocity that its grains have when it is made");
  add("velocity all set 0 0 0");
  add("set group all omegax 0.0 omegay 0.0 omegaz 0.0");
  add("velocity flow ramp vx 0 ${{constantspeed}} z $(v_zbottom+{0:.10g}) $(v_ztop-{0:.10g}) units box",
      0.5 * slab);
  add("velocity top set ${{constantspeed}} 0 0");
  add("fix piston top rigid single force * off off on torque * off off off");
  add("# the body's total force contains load and damping: taken off, the contacts' force on the wall "
      "remains");
  add("variable normalstress equal (f_piston[1][9]+{:.10g}+{:.10g}*v_wallgrains*f_piston[1][6])/{:.10g}",
      cell.pressure * area, piston_damping * damping, area);
  add("variable shearstress equal -(f_piston[1][7]+{:.10g}*v_wallgrains*f_piston[1][4])/{:.10g}",
      piston_damping * damping, area);
  add("variable distance equal v_ztop-v_zbottom");
  add("fix wall all ave/time {} 10 {} v_distance v_normalstress v_shearstress file {}",
      plan.frame_interval / 10, plan.frame_interval, wall_series_file);
  add("dump grains all custom {} {} id type x y z vx vy vz radius", plan.frame_interval, grain_dump_file);
  add("dump_modify grains format \"%d %d %.9g %.9g %.9g %.7g %.7g %.7g %.7g\"");
  add("dump contacts all local {} {} c_contacts[1] c_contacts[2] c_contacts[3] c_contacts[4] c_contacts[5] "
      "c_contacts[6]",
      plan.frame_interval, contact_dump_file);
  add("run {}", plan.last_step - plan.shear_start);
  add("print \"DEM2SPH reached step $(step) with $(atoms) grains\"");
  return deck;
}

nlohmann::json to_json(const ShearCell& cell) {
  const GrainMaterial& m = cell.material;
  nlohmann::json material{{"d", m.d},
                          {"size_spread", m.size_spread},
                          {"rho_s", m.rho_s},
                          {"grain_friction", m.grain_friction},
                          {"restitution", m.restitution},
                          {"contact", m.contact == ContactModel::hertz ? "hertz" : "hooke"}};
  if (m.contact == ContactModel::hertz) {
    material["youngs_modulus"] = m.youngs_modulus;
    material["poisson_ratio"] = m.poisson_ratio;
  } else {
    material["stiffness"] = m.stiffness;
  }
  return {{"material", material},
          {"pressure", cell.pressure},
          {"grains", cell.grains},
          {"length", cell.length},
          {"width", cell.width},
          {"core_margin", cell.core_margin},
          {"I_driven", cell.I_driven},
          {"preparation_friction", cell.preparation_friction},
          {"strain_dropped", cell.strain_dropped},
          {"strain_used", cell.strain_used},
          {"frames", cell.frames},
          {"time_step_fraction", cell.time_step_fraction},
          {"seed", cell.seed}};
}

ShearCell cell_from_json(const nlohmann::json& json) {
  try {
    ShearCell cell;
    const nlohmann::json& m = json.at("material");
    cell.material.d = m.at("d").get<double>();
    cell.material.size_spread = m.at("size_spread").get<double>();
    cell.material.rho_s = m.at("rho_s").get<double>();
    cell.material.grain_friction = m.at("grain_friction").get<double>();
    cell.material.restitution = m.at("restitution").get<double>();
    cell.material.contact =
        m.at("contact").get<std::string>() == "hertz" ? ContactModel::hertz : ContactModel::hooke;
    if (cell.material.contact == ContactModel::hertz) {
      cell.material.youngs_modulus = m.at("youngs_modulus").get<double>();
      cell.material.poisson_ratio = m.at("poisson_ratio").get<double>();
    } else {
      cell.material.stiffness = m.at("stiffness").get<double>();
    }
    cell.pressure = json.at("pressure").get<double>();
    cell.grains = json.at("grains").get<std::int64_t>();
    cell.length = json.at("length").get<double>();
    cell.width = json.at("width").get<double>();
    cell.core_margin = json.at("core_margin").get<double>();
    cell.I_driven = json.at("I_driven").get<double>();
    cell.preparation_friction = json.at("preparation_friction").get<double>();
    cell.strain_dropped = json.at("strain_dropped").get<double>();
    cell.strain_used = json.at("strain_used").get<double>();
    cell.frames = json.at("frames").get<std::int64_t>();
    cell.time_step_fraction = json.at("time_step_fraction").get<double>();
    cell.seed = json.at("seed").get<std::int64_t>();
    return cell;
  } catch (const nlohmann::json::exception& error) {
    throw InputError(fmt::format("the description of a shear cell is damaged: {}", error.what()));
  }
}

}  // namespace dem2sph::bridge
