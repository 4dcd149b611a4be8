// One short run of the real LIGGGHTS: the deck works, and the stress of the core agrees with the force on the
// wall.
#include <gtest/gtest.h>

#include "dem_bridge/runner.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph::bridge {
namespace {

using Engine = dem2sph::test::Scratch;

ShearCell small_cell() {
  ShearCell cell;
  cell.material = {.d = 1e-3,
                   .size_spread = 0.2,
                   .rho_s = 2500,
                   .grain_friction = 0.5,
                   .restitution = 0.5,
                   .contact = ContactModel::hertz,
                   .youngs_modulus = 1e7,
                   .poisson_ratio = 0.3,
                   .stiffness = 0};
  cell.pressure = 1000;
  cell.grains = 500;
  cell.length = 6, cell.width = 6;
  cell.core_margin = 3;
  cell.I_driven = 0.1;
  cell.preparation_friction = 0.5;
  cell.strain_dropped = 2, cell.strain_used = 6;
  cell.frames = 300;
  cell.seed = 11;
  return cell;
}

TEST_F(Engine, CoreStressIsTheWallsForceOverItsArea) {
  if (!program_exists(engine_program())) GTEST_SKIP() << "LIGGGHTS is not installed (package liggghts)";
  const ShearCell cell = small_cell();
  run_engine(cell, folder_, {.seconds = 60, .memory = 0});
  const CellRecord record = read_run(cell, folder_);
  EXPECT_EQ(static_cast<std::int64_t>(record.frames.size()), plan_deck(cell).frames);
  const SteadyMeans means = reduce_steady(record.frames, cell.strain_dropped, measurement_of(cell));

  // The core's means come from frames, the wall's from samples between them: they differ by both their
  // errors. Three standard errors of the core's mean, which at this size is the larger of the two, and 1 %
  // for the force that accelerates the sample while it dilates (measured: 0.3 to 1.5 % with 900 grains).
  const double wall_mu = record.wall_tau / record.wall_p;
  EXPECT_NEAR(means.mu.value, wall_mu, 3 * means.mu.standard_error + 0.01 * wall_mu);
  EXPECT_NEAR(means.p.value, record.wall_p, 3 * means.p.standard_error + 0.01 * record.wall_p);
  EXPECT_LT(means.mu.standard_error, 0.03 * wall_mu);

  // Grain friction 0.5 at I = 0.1, from 900 grains: mu 0.43, phi 0.575. A cell of 6 d x 6 d is allowed 10 %
  // and 2 %.
  EXPECT_NEAR(means.mu.value, 0.43, 0.043);
  EXPECT_NEAR(means.phi.value, 0.575, 0.0115);
  // The linear profile at the start is there: the first frames shear at the driven rate, within the noise of
  // one frame.
  EXPECT_NEAR(record.frames.front().gamma_dot * plan_deck(cell).inertial_time / cell.I_driven, 1, 0.05);
  // Cutting forces back to Coulomb's limit is not a rare repair (see reduce.cpp): if it were gone, a deck
  // changed.
  EXPECT_GT(record.cut_contacts, 0.05);
}

TEST_F(Engine, LinearContactsRunToo) {
  if (!program_exists(engine_program())) GTEST_SKIP() << "LIGGGHTS is not installed (package liggghts)";
  ShearCell cell = small_cell();
  cell.material.contact = ContactModel::hooke;
  cell.material.stiffness = 500;
  cell.preparation_friction = 0;  // dense
  cell.I_driven = 0.05;
  cell.strain_dropped = 0, cell.strain_used = 2;
  cell.frames = 100;
  run_engine(cell, folder_, {.seconds = 60, .memory = 0});
  const CellRecord record = read_run(cell, folder_);
  // Frictionless grains of five sizes pack to 0.64; with friction nothing comes above 0.61.
  EXPECT_GT(record.frames.front().phi, 0.62);
  EXPECT_LT(record.frames.back().phi, record.frames.front().phi - 0.02) << "a dense sample dilates";
}

}  // namespace
}  // namespace dem2sph::bridge
