// Decks: numbers that must agree with what was measured, and one check for each trap of the engine.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <set>
#include <sstream>
#include <stdexcept>

#include "dem_bridge/deck.hpp"
#include "sph/base/errors.hpp"
#include "tests/base/helpers.hpp"
#include "tests/dem_bridge/material.hpp"

namespace dem2sph::bridge {
namespace {

using dem2sph::test::message_of;

Sample typical() {
  Sample sample;
  sample.material = hertz_grains(1e8);
  sample.pressure = 1000;
  sample.grains = 900;
  sample.length = 8, sample.width = 6;
  sample.packing_friction = 0.5;
  sample.seed = 1;
  return sample;
}

Shearing steady() {
  return {.I_driven = 0.1, .pressure = 1000, .strain_dropped = 2, .strain_used = 6, .frames = 400};
}

constexpr const char* packed = "../packing/end.restart";

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

std::size_t line_with(const std::vector<std::string>& lines, const std::string& start, std::size_t from = 0) {
  for (std::size_t i = from; i < lines.size(); ++i)
    if (lines[i].starts_with(start)) return i;
  ADD_FAILURE() << "no line starts with " << start;
  return 0;
}

bool prime(std::int64_t n) {
  for (std::int64_t k = 2; k * k <= n; ++k)
    if (n % k == 0) return false;
  return n > 1;
}

TEST(TimeStepOfAPacking, HertzContacts) {
  // A unit of strain at inertial number I lasts t_i/I. At E = 1e8 Pa and P = 1 kPa the Rayleigh time of the
  // smallest grain is 1/144.4 of t_i: 722 steps of 0.2 of it.
  const Sample sample = typical();
  const TimeStep t = time_step(sample);
  const double t_i = plan_packing(sample).inertial_time;
  EXPECT_NEAR(t_i, 1e-3 * std::sqrt(2.5), 1e-12);
  EXPECT_NEAR(t_i / (0.2 * t.rayleigh), 722, 1);
  EXPECT_EQ(t.step, 0.2 * std::min(t.rayleigh, 0.25 * t.contact_duration));
  // By hand, for two grains of 0.8 d under P d^2 = 1 mN: m* = 3.351e-7 kg, R* = 0.2 mm, E* = 54.945 MPa,
  // tangent stiffness (6 E*^2 R* F)^(1/3) = 1535.9 N/m, half a period pi sqrt(m*/k) = 46.4 us.
  EXPECT_NEAR(t.contact_duration, 46.4e-6, 0.1e-6);
  // A collision at sqrt(P/rho_s) = 0.632 m/s lasts 2.87 (m*^2/(R* E*^2 v))^(1/5) = 35.6 us.
  EXPECT_NEAR(t.fastest_collision, 35.6e-6, 0.1e-6);
  EXPECT_EQ(t.bound(), "Rayleigh time");
  EXPECT_NEAR(kappa(sample), std::pow(1e5, 2.0 / 3), 1e-9);
  // Soft grains: a contact under the load lasts as E^(-1/3), the Rayleigh time goes with E^(-1/2).
  Sample soft = sample;
  soft.material.youngs_modulus = 1e7;
  EXPECT_NEAR(time_step(soft).rayleigh / t.rayleigh, std::sqrt(10.0), 1e-9);
  EXPECT_NEAR(time_step(soft).contact_duration / t.contact_duration, std::pow(100.0, 1.0 / 6), 1e-9);
  EXPECT_EQ(time_step(soft).bound(), "duration of a contact");
}

TEST(TimeStepOfAPacking, LinearContacts) {
  // Twenty steps in a contact of the two smallest grains: t_c = pi/sqrt(k/m (1 - z^2)), m = pi/12 rho (0.8
  // d)^3, z = 0.2155 for e = 0.5.
  Sample sample = typical();
  sample.material.contact = ContactModel::hooke;
  sample.material.stiffness = 1000;
  const double z = 0.69314718 / std::hypot(3.14159265, 0.69314718);
  const double mass = 3.14159265 / 12 * 0.512;
  const double duration = 3.14159265 / std::sqrt(1000 / mass * (1 - z * z));  // in t_i
  const DeckPlan plan = plan_packing(sample);
  EXPECT_NEAR(plan.time_step.step / plan.inertial_time, duration / 20, 1e-6 * duration);
  EXPECT_EQ(kappa(sample), 1000);
}

RC_GTEST_PROP(DeckPlan, FramesFallWhereTheyAreExpected, ()) {
  Shearing shearing = steady();
  shearing.I_driven = std::pow(10.0, *rc::gen::inRange(-300, 20) / 100.0);
  shearing.frames = *rc::gen::inRange(0, 2000);
  shearing.strain_used = *rc::gen::inRange(1, 100);
  shearing.strain_dropped = *rc::gen::inRange(0, 50);
  const DeckPlan plan = plan_shearing(typical(), shearing);
  RC_ASSERT(plan.frame_interval % 10 == 0);
  RC_ASSERT(plan.last_step == plan.wall_samples * plan.frame_interval);
  RC_ASSERT(plan.frames == (shearing.frames > 0 ? plan.wall_samples + 1 : 0));
  // The driven strain is at least the one asked for: the last frame covers a rest.
  const double strain =
      static_cast<double>(plan.last_step) * plan.time_step.step * shearing.I_driven / plan.inertial_time;
  RC_ASSERT(strain >= (shearing.strain_dropped + shearing.strain_used) * (1 - 1e-9));
}

RC_GTEST_PROP(DeckPlan, ThePackingsWallIsWatchedToTheEnd, ()) {
  Sample sample = typical();
  sample.material.youngs_modulus = std::pow(10.0, *rc::gen::inRange(670, 1000) / 100.0);
  sample.time_step_fraction = *rc::gen::inRange(1, 30) / 100.0;
  const DeckPlan plan = plan_packing(sample);
  // A series is written at multiples of its interval: the settling starts and ends at one.
  RC_ASSERT((plan.last_step - plan.settle_steps) % plan.frame_interval == 0);
  RC_ASSERT(plan.settle_steps == plan.wall_samples * plan.frame_interval);
  RC_ASSERT(plan.last_step == 1 + plan.compress_steps + plan.rest_steps + plan.settle_steps);
}

RC_GTEST_PROP(DeckPlan, SeedsArePrimesThatDiffer, (int seed)) {
  Sample sample = typical();
  sample.seed = std::abs(static_cast<std::int64_t>(seed));
  const std::vector<std::int64_t> seeds = plan_packing(sample).seeds;
  RC_ASSERT(seeds.size() == 7U);
  RC_ASSERT(std::set<std::int64_t>(seeds.begin(), seeds.end()).size() == seeds.size());
  for (const std::int64_t s : seeds) RC_ASSERT(s > 10000 && s < 2147483647 && prime(s));
  Sample other = sample;
  other.seed = sample.seed + 1;
  RC_ASSERT(plan_packing(other).seeds != seeds);
}

TEST(DeckPlan, RefusesWhatIsNoCell) {
  Sample sample = typical();
  sample.grains = 300;
  EXPECT_CONTAINS(message_of<UsageError>([&] { plan_packing(sample); }), "raise \"grains\"");
  sample = typical();
  sample.width = 4;
  EXPECT_CONTAINS(message_of<UsageError>([&] { plan_packing(sample); }), "too small");
  Shearing shearing = steady();
  shearing.I_driven = std::nan("");
  EXPECT_CONTAINS(message_of<UsageError>([&] { plan_shearing(typical(), shearing); }),
                  "inertial number above 0");
}

void expect_harmless(const std::vector<std::string>& lines) {
  // Lost grains must be an error; a thermo_style after thermo_modify would undo it.
  const std::size_t lost = line_with(lines, "thermo_modify lost error");
  for (std::size_t i = lost + 1; i < lines.size(); ++i) EXPECT_FALSE(lines[i].starts_with("thermo_style"));
  EXPECT_LT(lost, line_with(lines, "run "));
  // Spins are zeroed wherever velocities are: a frozen grain keeps its spin.
  std::size_t zeroed = 0;
  for (std::size_t i = 0; i < lines.size(); ++i)
    if (lines[i] == "velocity all set 0 0 0") {
      EXPECT_EQ(lines[i + 1], "set group all omegax 0.0 omegay 0.0 omegaz 0.0");
      ++zeroed;
    }
  EXPECT_EQ(zeroed, 1U);
  EXPECT_EQ(lines.back(), "print \"DEM2SPH reached step ${reached} with $(atoms) grains\"");
  for (const std::string& line : lines) {
    EXPECT_FALSE(line.starts_with("shell") || line.starts_with("include") || line.starts_with("log "))
        << line;
    EXPECT_EQ(line.find("nan"), std::string::npos) << line;
    EXPECT_EQ(line.find("inf "), std::string::npos) << line;
  }
}

TEST(Deck, OfAPackingAvoidsEveryTrap) {
  const std::vector<std::string> lines = lines_of(packing_deck(typical()));
  expect_harmless(lines);
  // Groups after change_box, which wraps grains.
  EXPECT_LT(line_with(lines, "change_box all z"), line_with(lines, "group bottom"));
  EXPECT_LT(line_with(lines, "newton off"), line_with(lines, "create_box"));
  EXPECT_LT(line_with(lines, "communicate single vel yes"), line_with(lines, "create_box"));
  // The step is reset before the restart file is written: after it was read the engine refuses.
  EXPECT_LT(line_with(lines, "variable reached"), line_with(lines, "reset_timestep 0"));
  EXPECT_LT(line_with(lines, "reset_timestep 0"), line_with(lines, "write_restart"));
}

TEST(Deck, OfAShearingAvoidsEveryTrap) {
  const std::vector<std::string> lines = lines_of(shearing_deck(typical(), steady(), packed));
  expect_harmless(lines);
  // What a restart file does not keep comes after it: properties, contact law, exclusions.
  const std::size_t restart = line_with(lines, "read_restart ../packing/end.restart");
  for (const char* again : {"fix young", "pair_style", "pair_coeff", "timestep",
                            "neigh_modify exclude group top top", "fix hold", "fix load"})
    EXPECT_LT(restart, line_with(lines, again));
  // Velocities before the rigid body is made; the local compute before the first run.
  EXPECT_LT(line_with(lines, "velocity top set"), line_with(lines, "fix piston"));
  EXPECT_LT(line_with(lines, "compute contacts"), line_with(lines, "run "));
}

TEST(Deck, ReversalsJumpsAndPreparationsDiffer) {
  Shearing back = steady();
  back.direction = -1;
  const auto speed = [](const std::string& deck) {
    const auto lines = lines_of(deck);
    return lines[line_with(lines, "variable speed equal ")];
  };
  const std::string forth = speed(shearing_deck(typical(), steady(), packed));
  EXPECT_EQ(speed(shearing_deck(typical(), back, packed)),
            "variable speed equal -" + forth.substr(std::string("variable speed equal ").size()));
  Shearing pressed = steady();
  pressed.keeps_velocity = true;
  pressed.pressure = 4000;
  const std::string deck = shearing_deck(typical(), pressed, packed);
  EXPECT_EQ(deck.find("velocity "), std::string::npos);
  EXPECT_CONTAINS(deck, fmt::format("fix load top addforce 0.0 0.0 $({:.10g}/v_wallgrains)", -4000 * 48e-6));
  Shearing preparation = steady();
  preparation.frames = 0;
  const std::string prepared = shearing_deck(typical(), preparation, packed);
  EXPECT_EQ(prepared.find("dump "), std::string::npos);
  EXPECT_CONTAINS(prepared, "write_restart end.restart");
  EXPECT_EQ(shearing_deck(typical(), steady(), packed).find("write_restart"), std::string::npos);
}

TEST(Deck, TheMaterialCardReachesTheEngine) {
  Sample sample = typical();
  EXPECT_CONTAINS(packing_deck(sample), "pair_style gran model hertz tangential history\n");
  sample.material.rolling_friction = 0.3;
  sample.material.cohesion = 5e4;
  const std::string deck = shearing_deck(sample, steady(), packed);
  EXPECT_CONTAINS(deck,
                  "pair_style gran model hertz tangential history cohesion sjkr rolling_friction epsd2\n");
  EXPECT_CONTAINS(deck, "coefficientRollingFriction peratomtypepair 3 0.3");
  EXPECT_CONTAINS(deck, "cohesionEnergyDensity peratomtypepair 3 50000");
  sample.material.contact = ContactModel::hooke;
  sample.material.stiffness = 1000;
  EXPECT_CONTAINS(
      packing_deck(sample),
      "pair_style gran model hooke/stiffness tangential history cohesion sjkr rolling_friction epsd2 "
      "tangential_damping off\n");
}

TEST(Deck, NoTextFromOutsideReachesIt) {
  for (const char* path : {"a b", "x\nshell rm -rf /", "", "a;b", "$(x)"})
    EXPECT_THROW(shearing_deck(typical(), steady(), path), std::logic_error) << path;
}

TEST(Deck, IsAFunctionOfItsValues) {
  EXPECT_EQ(packing_deck(typical()), packing_deck(typical()));
  Sample sample = typical();
  sample.packing_friction = 0;
  EXPECT_NE(packing_deck(sample), packing_deck(typical()));
  sample = typical();
  sample.seed = 2;
  EXPECT_NE(packing_deck(sample), packing_deck(typical()));
}

TEST(Deck, ValuesSurviveJson) {
  Sample sample = typical();
  sample.material.d = 1e-3 / 3;
  sample.material.rolling_friction = 0.1 + 0.2;  // not a short decimal
  sample.material.cohesion = 7;
  Shearing shearing = steady();
  shearing.I_driven = 0.1 + 0.2;
  shearing.direction = -1;
  const auto again = [](const auto& value) { return nlohmann::json::parse(to_json(value).dump()); };
  for (const ContactModel contact : {ContactModel::hertz, ContactModel::hooke}) {
    sample.material.contact = contact;
    sample.material.stiffness = 1234.5;
    EXPECT_EQ(packing_deck(sample_from_json(again(sample))), packing_deck(sample));
    EXPECT_EQ(shearing_deck(sample_from_json(again(sample)), shearing_from_json(again(shearing)), packed),
              shearing_deck(sample, shearing, packed));
  }
  nlohmann::json damaged = to_json(sample);
  damaged.erase("grains");
  EXPECT_CONTAINS(message_of<InputError>([&] { sample_from_json(damaged); }), "grains");
  damaged = to_json(shearing);
  damaged["frames"] = "many";
  EXPECT_CONTAINS(message_of<InputError>([&] { shearing_from_json(damaged); }), "type");
}

}  // namespace
}  // namespace dem2sph::bridge
