// Decks: numbers that must agree with what was measured, and one check for each trap of the engine.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <set>
#include <sstream>

#include "dem_bridge/deck.hpp"
#include "sph/base/errors.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph::bridge {
namespace {

using dem2sph::test::message_of;

ShearCell typical() {
  ShearCell cell;
  cell.material = {.d = 1e-3,
                   .size_spread = 0.2,
                   .rho_s = 2500,
                   .grain_friction = 0.5,
                   .restitution = 0.5,
                   .contact = ContactModel::hertz,
                   .youngs_modulus = 1e8,
                   .poisson_ratio = 0.3,
                   .stiffness = 0};
  cell.pressure = 1000;
  cell.grains = 900;
  cell.length = 8, cell.width = 6;
  cell.I_driven = 0.1;
  cell.preparation_friction = 0.5;
  cell.strain_dropped = 2, cell.strain_used = 6;
  cell.frames = 400;
  cell.seed = 1;
  return cell;
}

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

TEST(DeckPlan, TimeStepOfHertzContacts) {
  // A unit of strain at inertial number I lasts t_i/I: 722 steps of 0.2 Rayleigh times at E = 1e8 Pa and P =
  // 1 kPa.
  const DeckPlan plan = plan_deck(typical());
  EXPECT_NEAR(plan.inertial_time / plan.time_step, 722, 1);
  EXPECT_NEAR(plan.inertial_time, 1e-3 * std::sqrt(2.5), 1e-12);
}

TEST(DeckPlan, TimeStepOfLinearContacts) {
  // Twenty steps in a contact of two mean grains: t_c = pi/sqrt(k/m (1 - z^2)), m = pi/12 rho d^3, z = 0.2155
  // for e = 0.5.
  ShearCell cell = typical();
  cell.material.contact = ContactModel::hooke;
  cell.material.stiffness = 1000;
  const double z = 0.69314718 / std::hypot(3.14159265, 0.69314718);
  const double duration = 3.14159265 / std::sqrt(1000 * 12 / 3.14159265 * (1 - z * z));  // in t_i
  const DeckPlan plan = plan_deck(cell);
  EXPECT_NEAR(plan.time_step / plan.inertial_time, duration / 20, 1e-6 * duration);
}

RC_GTEST_PROP(DeckPlan, FramesFallWhereTheyAreExpected, ()) {
  ShearCell cell = typical();
  cell.I_driven = std::pow(10.0, *rc::gen::inRange(-300, 20) / 100.0);
  cell.frames = *rc::gen::inRange(20, 2000);
  cell.strain_used = *rc::gen::inRange(1, 100);
  cell.strain_dropped = *rc::gen::inRange(0, 50);
  const DeckPlan plan = plan_deck(cell);
  RC_ASSERT(plan.frame_interval % 10 == 0);
  RC_ASSERT(plan.shear_start % plan.frame_interval == 0);
  RC_ASSERT(plan.shear_start == 1 + plan.compress_steps + plan.rest_steps + plan.settle_steps);
  RC_ASSERT(plan.last_step == plan.shear_start + (plan.frames - 1) * plan.frame_interval);
  // The driven strain is at least the one asked for: the last frame covers a rest.
  const double strain = static_cast<double>(plan.last_step - plan.shear_start) * plan.time_step *
                        cell.I_driven / plan.inertial_time;
  RC_ASSERT(strain >= (cell.strain_dropped + cell.strain_used) * (1 - 1e-9));
}

RC_GTEST_PROP(DeckPlan, SeedsArePrimesThatDiffer, (int seed)) {
  ShearCell cell = typical();
  cell.seed = std::abs(static_cast<std::int64_t>(seed));
  const std::vector<std::int64_t> seeds = plan_deck(cell).seeds;
  RC_ASSERT(seeds.size() == 7U);
  RC_ASSERT(std::set<std::int64_t>(seeds.begin(), seeds.end()).size() == seeds.size());
  for (const std::int64_t s : seeds) RC_ASSERT(s > 10000 && s < 2147483647 && prime(s));
  ShearCell other = cell;
  other.seed = cell.seed + 1;
  RC_ASSERT(plan_deck(other).seeds != seeds);
}

TEST(DeckPlan, RefusesWhatIsNoCell) {
  ShearCell cell = typical();
  cell.grains = 400;
  EXPECT_CONTAINS(message_of<UsageError>([&] { plan_deck(cell); }), "raise \"grains\"");
  cell = typical();
  cell.width = 4;
  EXPECT_CONTAINS(message_of<UsageError>([&] { plan_deck(cell); }), "too small");
  cell = typical();
  cell.I_driven = std::nan("");
  EXPECT_CONTAINS(message_of<UsageError>([&] { plan_deck(cell); }), "inertial number above 0");
}

TEST(Deck, AvoidsEveryTrap) {
  const std::vector<std::string> lines = lines_of(write_deck(typical()));
  // Lost grains must be an error; a thermo_style after thermo_modify would undo it.
  const std::size_t lost = line_with(lines, "thermo_modify lost error");
  for (std::size_t i = lost + 1; i < lines.size(); ++i) EXPECT_FALSE(lines[i].starts_with("thermo_style"));
  EXPECT_LT(lost, line_with(lines, "run "));
  // The local compute must exist before the first run.
  EXPECT_LT(line_with(lines, "compute contacts"), line_with(lines, "run "));
  // Groups after change_box, which wraps grains.
  EXPECT_LT(line_with(lines, "change_box all z"), line_with(lines, "group bottom"));
  // Spins are zeroed wherever velocities are: a frozen grain keeps its spin.
  std::size_t zeroed = 0;
  for (std::size_t i = 0; i < lines.size(); ++i)
    if (lines[i] == "velocity all set 0 0 0") {
      EXPECT_EQ(lines[i + 1], "set group all omegax 0.0 omegay 0.0 omegaz 0.0");
      ++zeroed;
    }
  EXPECT_EQ(zeroed, 2U);
  // Velocities before the rigid body is made.
  EXPECT_LT(line_with(lines, "velocity top set"),
            line_with(lines, "fix piston", line_with(lines, "unfix piston")));
  EXPECT_LT(line_with(lines, "newton off"), line_with(lines, "create_box"));
  EXPECT_LT(line_with(lines, "communicate single vel yes"), line_with(lines, "create_box"));
  EXPECT_EQ(lines.back(), "print \"DEM2SPH reached step $(step) with $(atoms) grains\"");
  for (const std::string& line : lines) {
    EXPECT_FALSE(line.starts_with("shell") || line.starts_with("include") || line.starts_with("log "))
        << line;
    EXPECT_EQ(line.find("nan"), std::string::npos) << line;
    EXPECT_EQ(line.find("inf "), std::string::npos) << line;
  }
}

TEST(Deck, IsAFunctionOfItsValues) {
  EXPECT_EQ(write_deck(typical()), write_deck(typical()));
  ShearCell cell = typical();
  cell.preparation_friction = 0;
  EXPECT_NE(write_deck(cell), write_deck(typical()));
  cell = typical();
  cell.seed = 2;
  EXPECT_NE(write_deck(cell), write_deck(typical()));
}

TEST(Deck, ValuesSurviveJson) {
  ShearCell cell = typical();
  cell.I_driven = 0.1 + 0.2;  // not a short decimal
  cell.material.d = 1e-3 / 3;
  EXPECT_EQ(write_deck(cell_from_json(nlohmann::json::parse(to_json(cell).dump()))), write_deck(cell));
  cell.material.contact = ContactModel::hooke;
  cell.material.stiffness = 1234.5;
  EXPECT_EQ(write_deck(cell_from_json(nlohmann::json::parse(to_json(cell).dump()))), write_deck(cell));
  nlohmann::json damaged = to_json(cell);
  damaged.erase("grains");
  EXPECT_CONTAINS(message_of<InputError>([&] { cell_from_json(damaged); }), "grains");
}

}  // namespace
}  // namespace dem2sph::bridge
