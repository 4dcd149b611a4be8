// Short runs of the real LIGGGHTS: the decks work, the stress of the core agrees with the force on the wall,
// and every part of the material card and every kind of change does what it should.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <optional>

#include "dem_bridge/coarse_graining_frames.hpp"
#include "dem_bridge/runner.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph::bridge {
namespace {

class Engine : public dem2sph::test::Scratch {
 protected:
  void SetUp() override {
    if (!program_exists(engine_program())) GTEST_SKIP() << "LIGGGHTS is not installed (package liggghts)";
  }

  EngineLimits limits_{.seconds = 60, .memory = 0};

  void pack(const Sample& sample) {
    const DeckPlan plan = plan_packing(sample);
    run_engine({.deck = packing_deck(sample),
                .sentinel = sentinel(sample.grains, plan.last_step),
                .ranks = sample.ranks},
               folder_, limits_);
    check_restart(sample, folder_, limits_);
    // The packing bears its load: 1 % after 24 inertial times of settling.
    const WallMeans wall =
        read_wall(plan, sample.pressure, 0, plan.last_step - 12 * plan.frame_interval, folder_);
    EXPECT_NEAR(wall.p, sample.pressure, 0.01 * sample.pressure);
  }

  void shear(const Sample& sample, const Shearing& shearing) {
    run_engine({.deck = shearing_deck(sample, shearing, restart_file),
                .sentinel = sentinel(sample.grains, plan_shearing(sample, shearing).last_step),
                .ranks = sample.ranks},
               folder_, limits_);
  }
};

Sample small_sample() {
  Sample sample;
  sample.material = {.d = 1e-3,
                     .size_spread = 0.2,
                     .rho_s = 2500,
                     .grain_friction = 0.5,
                     .restitution = 0.5,
                     .contact = ContactModel::hertz,
                     .youngs_modulus = 1e7,
                     .poisson_ratio = 0.3};
  sample.pressure = 1000;
  sample.grains = 500;
  sample.length = 6, sample.width = 6;
  sample.packing_friction = 0.5;
  sample.seed = 11;
  return sample;
}
constexpr double margin = 3;  // of the core, in d

TEST_F(Engine, CoreStressIsTheWallsForceOverItsArea) {
  const Sample sample = small_sample();
  const Shearing shearing{
      .I_driven = 0.1, .pressure = 1000, .strain_dropped = 2, .strain_used = 6, .frames = 300};
  pack(sample);
  shear(sample, shearing);
  const CellRecord record = read_run(sample, shearing, margin, folder_);
  EXPECT_EQ(static_cast<std::int64_t>(record.frames.size()), plan_shearing(sample, shearing).frames);
  const SteadyMeans means =
      reduce_steady(record.frames, shearing.strain_dropped, measurement_of(sample, shearing, margin));

  // The core's means come from frames, the wall's from samples between them: they differ by both their
  // errors. Three standard errors of the core's mean, which at this size is the larger of the two, and 1 %
  // for the force that accelerates the sample while it dilates (measured: 0.3 to 1.5 % with 900 grains).
  const double wall_mu = record.wall.tau / record.wall.p;
  EXPECT_NEAR(means.mu.value, wall_mu, 3 * means.mu.standard_error + 0.01 * wall_mu);
  EXPECT_NEAR(means.p.value, record.wall.p, 3 * means.p.standard_error + 0.01 * record.wall.p);
  EXPECT_LT(means.mu.standard_error, 0.03 * wall_mu);

  // Grain friction 0.5 at I = 0.1, from 900 grains: mu 0.43, phi 0.575. A cell of 6 d x 6 d is allowed 10 %
  // and 2 %.
  EXPECT_NEAR(means.mu.value, 0.43, 0.043);
  EXPECT_NEAR(means.phi.value, 0.575, 0.0115);
  // A steady flow keeps its volume, and the volume's rate is that of its density: 3 standard errors.
  EXPECT_NEAR(means.beta.value, 0, 3 * means.beta.standard_error);
  // The linear profile at the start is there: the first frames shear at the driven rate, within the noise of
  // one frame.
  EXPECT_NEAR(record.frames.front().gamma_dot * plan_shearing(sample, shearing).inertial_time / 0.1, 1, 0.05);
  // Cutting forces back to Coulomb's limit is not a rare repair (see contact_force.hpp): if it were gone, a
  // deck changed.
  EXPECT_GT(record.cut_contacts, 0.05);
}

TEST_F(Engine, CoarseGrainedStressIsTheWallsForceOverItsArea) {
  const Sample sample = small_sample();
  const Shearing shearing{
      .I_driven = 0.1, .pressure = 1000, .strain_dropped = 2, .strain_used = 20, .frames = 400};
  pack(sample);
  shear(sample, shearing);
  const CellRecord record = read_run(sample, shearing, margin, folder_);

  // Profiles in z, once with the walls' grains as part of the packing, once as walls.
  GrainDump grain_dump(in(grain_dump_file));
  ContactDump contact_dump(in(contact_dump_file), {});
  GrainFrame grains;
  ContactFrame contacts;
  std::optional<Accumulator> packing, flow;
  const double d = sample.material.d;
  double bottom = 0, top = 0, used = 0;
  for (const CoreState& core : record.frames) {
    ASSERT_EQ(grain_dump.next(grains), ReadResult::frame);
    ASSERT_EQ(contact_dump.next(contacts), ReadResult::frame);
    if (core.strain < shearing.strain_dropped) continue;
    if (!packing) {
      const Grid grid = grid_in(grains.box, {axis_between(2, -4 * d, grains.box.high[2] + 4 * d, 200)});
      packing.emplace(grid, Kernel(KernelShape::gauss, 1, d));
      flow.emplace(grid, Kernel(KernelShape::gauss, 1, d));
    }
    GrainProperties properties{.rho_s = sample.material.rho_s,
                               .grain_friction = sample.material.grain_friction,
                               .cohesion = 0,
                               .wall_grains = WallGrains::part_of_the_packing};
    packing->add(snapshot_of(grains, contacts, properties));
    properties.wall_grains = WallGrains::walls;
    flow->add(snapshot_of(grains, contacts, properties));
    std::array<double, 4> count{}, height{};
    for (const Grain& grain : grains.grains) {
      const auto type = static_cast<std::size_t>(grain.type);
      count.at(type) += 1, height.at(type) += grain.x[2];
    }
    bottom += height[2] / count[2], top += height[3] / count[3], used += 1;
  }
  bottom /= used, top /= used;

  // The core, away from both walls by the kernel's radius and half a wall.
  double p = 0, tau = 0, rate = 0, phi = 0, points = 0;
  for (const FieldPoint& f : packing->fields().points)
    if (f.x[2] > bottom + 4 * d && f.x[2] < top - 4 * d) {
      const Sym<3> stress = f.stress();
      p += stress(2, 2), tau -= stress(0, 2), rate += f.velocity_gradient(0, 2), phi += f.phi, points += 1;
    }
  ASSERT_GT(points, 10);
  p /= points, tau /= points, rate /= points, phi /= points;
  // The wall's means are taken at every step, the core's from 400 frames: four seeds differed by up to 0.7 %,
  // and 2 % is what may be.
  EXPECT_NEAR(p / record.wall.p, 1, 0.02);
  EXPECT_NEAR(tau / record.wall.tau, 1, 0.02);
  // And what the flow does to the grains of the top wall, through nothing but t.
  const Fields fields = flow->fields();
  Vec<3> traction;
  for (const FieldPoint& f : fields.points)
    if (f.x[2] > 0.5 * (bottom + top)) traction -= fields.grid.axes[0].spacing * f.wall_force;
  EXPECT_NEAR(traction[2] / record.wall.p, 1, 0.02);
  EXPECT_NEAR(-traction[0] / record.wall.tau, 1, 0.02);
  // The reduction of the core, which fits lines to grains and cuts their volumes, knows the same flow. Its
  // core is another, and its rates are those of displacements: up to 2.2 % apart in I, 4e-4 in phi, with four
  // seeds.
  const SteadyMeans means =
      reduce_steady(record.frames, shearing.strain_dropped, measurement_of(sample, shearing, margin));
  EXPECT_NEAR(phi, means.phi.value, 0.002);
  EXPECT_NEAR(inertial_number(rate, p, d, sample.material.rho_s) / means.I.value, 1, 0.05);
}

TEST_F(Engine, DenseSamplesDilateWithLinearContactsToo) {
  Sample sample = small_sample();
  sample.material.contact = ContactModel::hooke;
  sample.material.stiffness = 500;
  sample.packing_friction = 0;  // dense
  const Shearing shearing{.I_driven = 0.05, .pressure = 1000, .strain_used = 2, .frames = 100};
  pack(sample);
  shear(sample, shearing);
  const CellRecord record = read_run(sample, shearing, margin, folder_);
  // Frictionless grains of five sizes pack to 0.64; with friction nothing comes above 0.61.
  EXPECT_GT(record.frames.front().phi, 0.62);
  EXPECT_LT(record.frames.back().phi, record.frames.front().phi - 0.02) << "a dense sample dilates";
  // beta from the velocities between frames tells the same change of volume as the grains in the core: grains
  // that enter and leave it make a difference of a few grains of about 130.
  const Transient t = reduce_transient(record.frames, 0.1, measurement_of(sample, shearing, margin));
  double opening = 0;
  for (const double beta : t.beta) opening += 0.1 * beta;
  EXPECT_NEAR(opening, std::log(t.phi_0 / t.phi.back()), 0.02);
}

TEST_F(Engine, AReversalStartsWithTheStressOfTheOtherDirection) {
  const Sample sample = small_sample();
  const Shearing before{.I_driven = 0.05, .pressure = 1000, .strain_used = 2};
  const Shearing after{.I_driven = 0.05, .pressure = 1000, .direction = -1, .strain_used = 1, .frames = 100};
  pack(sample);
  shear(sample, before);
  shear(sample, after);
  const CellRecord record = read_run(sample, after, margin, folder_);
  // In the new direction the sample at first pushes along: friction comes from below zero and ends at that of
  // I = 0.05, which is 0.40 for 900 grains; the last tenth of a strain is allowed 25 %.
  EXPECT_LT(record.frames.front().tau(), 0);
  const Transient t = reduce_transient(record.frames, 0.1, measurement_of(sample, after, margin));
  EXPECT_LT(t.mu.front(), 0.3);
  EXPECT_NEAR(t.mu.back(), 0.4, 0.1);
  EXPECT_GT(t.gamma_dot.back(), 0);
}

TEST_F(Engine, RollingFrictionAndCohesionRun) {
  Sample sample = small_sample();
  sample.material.rolling_friction = 0.3;
  sample.material.cohesion = 2e4;
  require_engine_features(sample);
  const Shearing shearing{
      .I_driven = 0.1, .pressure = 1000, .strain_dropped = 1, .strain_used = 3, .frames = 150};
  pack(sample);
  shear(sample, shearing);
  const CellRecord record = read_run(sample, shearing, margin, folder_);
  const SteadyMeans means = reduce_steady(record.frames, 1, measurement_of(sample, shearing, margin));
  // Core and wall agree as above, so that the cut at Coulomb's limit counts the attraction rightly.
  const double wall_mu = record.wall.tau / record.wall.p;
  EXPECT_NEAR(means.mu.value, wall_mu, 3 * means.mu.standard_error + 0.02 * wall_mu);
  EXPECT_GT(means.mu.value, 0.5) << "rolling friction and attraction raise the friction of 0.43";
}

TEST_F(Engine, TwoRanksMakeTheSameKindOfSample) {
  if (!program_exists("mpirun")) GTEST_SKIP() << "mpirun is not installed (package openmpi-bin)";
  Sample sample = small_sample();
  sample.ranks = 2;
  const Shearing shearing{.I_driven = 0.1, .pressure = 1000, .strain_used = 1, .frames = 50};
  pack(sample);
  shear(sample, shearing);
  const CellRecord record = read_run(sample, shearing, margin, folder_);
  EXPECT_NEAR(record.frames.back().phi, 0.58, 0.02);
}

TEST_F(Engine, WhatIsNotCompiledInIsNamed) {
  Sample sample = small_sample();
  EXPECT_NO_THROW(require_engine_features(sample));
  dem2sph::test::put(in("engine"), "#!/bin/sh\nliggghts -help | sed -e s/epsd2// -e s/freeze//\n");
  std::filesystem::permissions(in("engine"), std::filesystem::perms::owner_all);
  ::setenv("DEM2SPH_LIGGGHTS", in("engine").c_str(), 1);
  sample.material.rolling_friction = 0.1;
  const std::string message =
      dem2sph::test::message_of<EngineError>([&] { require_engine_features(sample); });
  ::unsetenv("DEM2SPH_LIGGGHTS");
  EXPECT_CONTAINS(message, "\"freeze\" (Fix styles), \"epsd2\" (Rolling models for pair gran)");
}

}  // namespace
}  // namespace dem2sph::bridge
