// Packings whose stress, solid fraction and rates are known in closed form.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numbers>

#include "dem_bridge/contact_force.hpp"
#include "dem_bridge/reduce.hpp"
#include "tests/base/helpers.hpp"
#include "tests/dem_bridge/packing.hpp"

namespace dem2sph::bridge {
namespace {

using dem2sph::test::message_of;
using test::Lattice;

constexpr double a = 1e-3;

/// Faces of the core at half-way heights of layers: a whole number of spacings from each other.
Measurement measurement(double friction = 10) {
  return {.d = a,
          .rho_s = 2500,
          .grain_friction = friction,
          .wall_thickness = a,
          .core_margin = 2 * a,
          .time_step = 1e-6};
}

TEST(SphereSlabVolume, KnownParts) {
  const double pi = std::numbers::pi;
  EXPECT_DOUBLE_EQ(sphere_slab_volume(0, 2, -5, 5), 4.0 / 3 * pi * 8);
  EXPECT_DOUBLE_EQ(sphere_slab_volume(1, 2, 1, 9), 2.0 / 3 * pi * 8);
  // A cap of height h has the volume pi h^2 (3 r - h)/3.
  // The difference of two volumes of about 33 carries some ulp of them.
  EXPECT_NEAR(sphere_slab_volume(0, 2, 1.5, 7), pi * 0.25 * (6 - 0.5) / 3, 1e-13);
  EXPECT_EQ(sphere_slab_volume(0, 2, 2, 7), 0);
  EXPECT_EQ(sphere_slab_volume(0, 2, -9, -3), 0);
}

RC_GTEST_PROP(SphereSlabVolume, IsAdditiveAndNeverNegative, ()) {
  const auto tenth = [](int n) { return n / 10.0; };
  const double z = tenth(*rc::gen::inRange(-100, 100));
  const double r = tenth(*rc::gen::inRange(1, 60));
  const double low = tenth(*rc::gen::inRange(-100, 100));
  const double middle = low + tenth(*rc::gen::inRange(0, 60));
  const double high = middle + tenth(*rc::gen::inRange(0, 60));
  const double lower = sphere_slab_volume(z, r, low, middle), upper = sphere_slab_volume(z, r, middle, high);
  RC_ASSERT(lower >= 0 && upper >= 0);
  // Differences of terms of size r^3: a few ulp of it.
  RC_ASSERT(std::abs(lower + upper - sphere_slab_volume(z, r, low, high)) < 1e-13 * (1 + r * r * r));
}

TEST(MeasureCore, LatticeIsExact) {
  Lattice lattice;
  lattice.gamma_dot = 30;
  lattice.opening = -4;
  lattice.normal = 2e-3;
  lattice.tangential = 7e-4;
  const CoreState core = measure_core(lattice.frame(5), lattice.contacts(5), measurement());
  EXPECT_EQ(core.step, 5);
  EXPECT_NEAR(core.height, 11 * a, 1e-15);
  EXPECT_NEAR(core.thickness, (11 - 1 - 4) * a, 1e-15);
  EXPECT_NEAR(core.phi, std::numbers::pi / 6, 1e-13);
  EXPECT_NEAR(core.p(), 2e-3 / (a * a), 1e-9);
  // The force has no part along z x x beyond this: sigma_xz is symmetrised, (f_x b_z + f_z b_x)/2 with b_x =
  // 0.
  EXPECT_NEAR(core.tau(), 0.5 * 7e-4 / (a * a), 1e-9);
  EXPECT_NEAR(core.stress(0, 0), 0, 1e-9);
  EXPECT_NEAR(core.gamma_dot, 30, 1e-10);
  EXPECT_NEAR(core.dilation_rate, -4, 1e-10);
  EXPECT_NEAR(core.kinetic_zz, 0, 1e-12);
  EXPECT_NEAR(core.largest_overlap, 0, 1e-15);
  EXPECT_EQ(core.cut_contacts, 0);
}

/// The lattice after the time t: every grain where its velocity has led it, wrapped into the box.
GrainFrame moved(const Lattice& lattice, std::int64_t step, double t) {
  GrainFrame frame = lattice.frame(step);
  for (Grain& g : frame.grains) {
    g.x += t * g.v;
    const double length = frame.box.high[0] - frame.box.low[0];
    g.x[0] -= length * std::floor(g.x[0] / length);
  }
  return frame;
}

TEST(MeasureCore, RatesAreThoseOfTheDisplacement) {
  Lattice lattice;
  lattice.gamma_dot = 30;
  lattice.opening = 2;
  const Measurement cell = measurement();
  const double t = 0.1;  // a strain of 3: the highest grains cross the box seven times
  const GrainFrame before = lattice.frame(0);
  GrainFrame now = moved(lattice, 100000, t);
  const CoreState core = measure_core(now, {100000, now.box, {}}, cell, &before);
  // Grains part from each other as exp(2 t) by their own motion; x grows linearly in time, so the slopes are
  // those over the mean height: v_z = 2 z_0, z_mean = z_0 (1 + t).
  EXPECT_NEAR(core.gamma_dot, 30 / (1 + t), 1e-9);
  EXPECT_NEAR(core.dilation_rate, 2 / (1 + t), 1e-9);

  // Rattling that cancels between the frames is not seen; the kinetic stress sees it.
  for (Grain& g : now.grains) g.v[2] += static_cast<double>(g.id % 3 - 1) * 0.1;
  const CoreState rattling = measure_core(now, {100000, now.box, {}}, cell, &before);
  EXPECT_EQ(rattling.dilation_rate, core.dilation_rate);
  EXPECT_GT(rattling.kinetic_zz, core.kinetic_zz);
  EXPECT_CONTAINS(message_of<InputError>([&] {
                    measure_core(before, {0, before.box, {}}, cell, &now);
                  }),
                  "step 100000 is not before step 0");
  GrainFrame fewer = before;
  fewer.grains.pop_back();
  EXPECT_CONTAINS(message_of<InputError>([&] {
                    measure_core(now, {100000, now.box, {}}, cell, &fewer);
                  }),
                  "was not there at step 0");
}

TEST(MeasureCore, AReversedFlowIsMirrored) {
  Lattice lattice;
  lattice.gamma_dot = 30;
  lattice.normal = 2e-3, lattice.tangential = 7e-4;
  const CoreState forth = measure_core(lattice.frame(0), lattice.contacts(0), measurement());
  lattice.gamma_dot = -30;
  lattice.tangential = -7e-4;
  Measurement mirrored = measurement();
  mirrored.direction = -1;
  const CoreState back = measure_core(lattice.frame(0), lattice.contacts(0), mirrored);
  EXPECT_NEAR(back.gamma_dot, forth.gamma_dot, 1e-12);
  EXPECT_NEAR(back.tau(), forth.tau(), 1e-9);
  EXPECT_NEAR(back.p(), forth.p(), 1e-9);
}

TEST(MeasureCore, CountsContactsAndTheirDirections) {
  // One bond up and one down for each grain: two contacts a grain, all along z. Then one more, at 45 degrees.
  Lattice lattice;
  lattice.normal = 1e-3;
  const GrainFrame frame = lattice.frame(0);
  ContactFrame contacts = lattice.contacts(0);
  const CoreState core = measure_core(frame, contacts, measurement());
  EXPECT_NEAR(core.coordination, 2, 1e-12);
  EXPECT_NEAR(core.fabric_xz, 0, 1e-15);
  contacts.contacts.push_back({lattice.id(2, 2, 6), lattice.id(1, 2, 5), {{1e-3, 0, 1e-3}}});
  const CoreState tilted = measure_core(frame, contacts, measurement());
  // The core holds 6 layers of 25 grains and as many bonds.
  EXPECT_NEAR(tilted.coordination, 2 + 2.0 / 150, 1e-12);
  EXPECT_NEAR(tilted.fabric_xz, 0.5 / 151, 1e-12);
}

TEST(MeasureCore, CohesionRaisesCoulombsLimit) {
  // Two equal spheres cut each other in a circle of radius r_c, r_c^2 = r^2 - (distance/2)^2.
  const double r = 0.5e-3, distance = 0.99e-3, cohesion = 1e5;
  const double area = std::numbers::pi * (r * r - 0.25 * distance * distance);
  EXPECT_NEAR(sjkr_attraction(r, r, distance, cohesion), cohesion * area, 1e-12 * cohesion * area);
  EXPECT_EQ(sjkr_attraction(r, r, 1.01e-3, cohesion), 0);
  Vec<3> force{{0.9, 0, 1}};
  EXPECT_TRUE(cut_to_coulomb(force, {{0, 0, 1}}, 0.5));
  EXPECT_NEAR(force[0], 0.5, 1e-15);
  force = {{0.9, 0, 1}};
  EXPECT_FALSE(cut_to_coulomb(force, {{0, 0, 1}}, 0.5, 0.8));  // repulsion 1.8, limit 0.9
  EXPECT_EQ(force[0], 0.9);
}

TEST(MeasureCore, OneContactCountsWithItsPartOfTheBranch) {
  // Two grains across the lower face of the core: three quarters of the branch lie inside.
  Lattice lattice;
  GrainFrame frame = lattice.frame(0);
  const CoreState empty = measure_core(frame, {0, frame.box, {}}, measurement());
  EXPECT_EQ(empty.p(), 0);
  const double low = 1 * a + 2 * a;  // wall's face, margin
  for (Grain& g : frame.grains) {
    if (g.id == lattice.id(0, 0, 2)) g.x = {{0.2 * a, 1 * a, low - 0.2 * a}};
    if (g.id == lattice.id(1, 0, 2))
      g.x = {{-0.4 * a + 5 * a, 1 * a, low + 0.6 * a}};  // touches through the boundary
  }
  ContactFrame contacts{0, frame.box, {{lattice.id(1, 0, 2), lattice.id(0, 0, 2), {{-3, 0.5, 4}}}}};
  const CoreState core = measure_core(frame, contacts, measurement());
  const double volume = 25 * a * a * core.thickness;
  const double bx = -0.6 * a, bz = 0.8 * a;
  EXPECT_NEAR(core.stress(0, 0) * volume, 0.75 * -3 * bx, 1e-15);
  EXPECT_NEAR(core.stress(2, 2) * volume, 0.75 * 4 * bz, 1e-15);
  EXPECT_NEAR(core.stress(0, 2) * volume, 0.75 * 0.5 * (-3 * bz + 4 * bx), 1e-15);
  EXPECT_NEAR(core.stress(1, 2) * volume, 0.75 * 0.5 * 0.5 * bz, 1e-15);

  // The same contact named the other way round, with the opposite force, is the same contact.
  contacts.contacts = {{lattice.id(0, 0, 2), lattice.id(1, 0, 2), {{3, -0.5, -4}}}};
  const CoreState turned = measure_core(frame, contacts, measurement());
  for (int k = 0; k < 6; ++k) EXPECT_NEAR(turned.stress[k], core.stress[k], 1e-9 * std::abs(core.stress[k]));
}

TEST(MeasureCore, FluctuationsCarryStress) {
  // Neighbouring columns move up and down with speed u: sigma_zz = phi rho_s u^2 on an even lattice.
  Lattice lattice;
  lattice.columns_x = 4, lattice.columns_y = 4;
  lattice.gamma_dot = 10;
  GrainFrame frame = lattice.frame(0);
  const double u = 0.05;
  for (Grain& g : frame.grains) {
    const auto i = static_cast<int>(g.x[0] / a), j = static_cast<int>(g.x[1] / a);
    g.v[2] += (i + j) % 2 == 0 ? u : -u;
  }
  const CoreState core = measure_core(frame, {0, frame.box, {}}, measurement());
  EXPECT_NEAR(core.p(), std::numbers::pi / 6 * 2500 * u * u, 1e-12);
  EXPECT_NEAR(core.kinetic_zz, core.p(), 1e-15);
  EXPECT_NEAR(core.gamma_dot, 10, 1e-10);
  EXPECT_NEAR(core.tau(), 0, 1e-12);
}

TEST(MeasureCore, TangentialForcesEndAtCoulombsLimit) {
  Lattice lattice;
  lattice.normal = 1e-3;
  lattice.tangential = 8e-4;
  const CoreState core = measure_core(lattice.frame(0), lattice.contacts(0), measurement(0.5));
  EXPECT_NEAR(core.p(), 1e-3 / (a * a), 1e-9);
  EXPECT_NEAR(core.tau(), 0.5 * 5e-4 / (a * a), 1e-9);
  EXPECT_EQ(core.cut_contacts, 1);
}

TEST(MeasureCore, RefusesWhatDoesNotBelongTogether) {
  const Lattice lattice;
  const GrainFrame frame = lattice.frame(3);
  EXPECT_CONTAINS(message_of<InputError>([&] { measure_core(frame, lattice.contacts(4), measurement()); }),
                  "grains of step 3 do not belong to contacts of step 4");
  ContactFrame stranger = lattice.contacts(3);
  stranger.contacts[0].second = 99999;
  EXPECT_CONTAINS(message_of<InputError>([&] { measure_core(frame, stranger, measurement()); }), "99999");
  GrainFrame lidless = frame;
  for (Grain& g : lidless.grains) g.type = GrainType::flow;
  EXPECT_CONTAINS(message_of<InputError>([&] { measure_core(lidless, lattice.contacts(3), measurement()); }),
                  "a wall has no grains");
  Measurement thick = measurement();
  thick.core_margin = 5 * a;
  EXPECT_CONTAINS(message_of<InputError>([&] { measure_core(frame, lattice.contacts(3), thick); }),
                  "core is only");
}

/// A series with phi relaxing to phi_eq over the strain s_star, at a constant rate.
std::vector<CoreState> relaxing(double phi_0, double phi_eq, double s_star, std::size_t n) {
  std::vector<CoreState> frames(n);
  for (std::size_t i = 0; i < n; ++i) {
    CoreState& f = frames[i];
    f.step = static_cast<std::int64_t>(10000 * i);
    f.gamma_dot = 2;  // 0.02 of strain a frame at the time step of measurement()
    const double s = 0.02 * static_cast<double>(i);
    f.phi = phi_eq + (phi_0 - phi_eq) * std::exp(-s / s_star);
    // The mean over the time since the frame before, 0.01 s at 10^4 steps: volume grows as 1/phi.
    if (i > 0) f.dilation_rate = std::log(frames[i - 1].phi / f.phi) / 0.01;
    f.stress(2, 2) = 1000;
    f.stress(0, 2) = -400;
    f.height = 0.015;
  }
  return frames;
}

TEST(ReduceTransient, FollowsARelaxation) {
  std::vector<CoreState> frames = relaxing(0.64, 0.58, 0.3, 200);
  const Measurement cell = measurement();
  integrate_strain(frames, cell.time_step);
  EXPECT_NEAR(frames.back().strain, 0.02 * 199, 1e-12);
  const Transient t = reduce_transient(frames, 0.1, cell);
  EXPECT_EQ(t.phi_0, 0.64);
  ASSERT_EQ(t.s.size(), 39U);
  double opening = 0;
  for (std::size_t i = 0; i < t.s.size(); ++i) {
    EXPECT_NEAR(t.mu[i], 0.4, 1e-14);
    EXPECT_NEAR(t.I[i], 2 * a / std::sqrt(1000 / 2500.0), 1e-15);
    // Averaging exp(-s/s*) over a window w raises it by (w/s*)^2/24 of itself: 0.5 % here, 3e-4 of 0.06.
    const double phi = 0.58 + 0.06 * std::exp(-t.s[i] / 0.3);
    EXPECT_NEAR(t.phi[i], phi, 4e-4);
    EXPECT_NEAR(t.beta[i], (1 - 0.58 / phi) / 0.3, 2e-3);
    EXPECT_DOUBLE_EQ(t.s[i], 0.1 * (static_cast<double>(i) + 0.5)) << "the axis is the same for all runs";
    EXPECT_NEAR(t.gamma_dot[i], 2, 1e-12);
    opening += 0.1 * t.beta[i];
  }
  // beta is the exact mean of each window, so its integral is that of the volume.
  const double last = 0.58 + 0.06 * std::exp(-3.9 / 0.3);
  EXPECT_NEAR(opening, std::log(0.64 / last), 1e-12);
  EXPECT_CONTAINS(message_of<EngineError>([&] { reduce_transient(frames, 0.01, cell); }), "raise \"frames\"");
  EXPECT_CONTAINS(message_of<EngineError>([&] { reduce_transient(frames, 5, cell); }), "less than a window");
}

TEST(ReduceTransient, StrainThatTurnsBackIsCountedOnce) {
  // The core shears forward by 0.3, back by 0.1 and forward by 0.8 again while it dilates steadily in time: a
  // window ends where its strain is first reached.
  std::vector<CoreState> frames(13);
  const Measurement cell = measurement();
  for (std::size_t i = 0; i < frames.size(); ++i) {
    frames[i].step = static_cast<std::int64_t>(10000 * i);
    frames[i].gamma_dot = i == 4 ? -10 : 10;
    frames[i].dilation_rate = 1;
    frames[i].phi = 0.6, frames[i].stress(2, 2) = 1000;
  }
  integrate_strain(frames, cell.time_step);
  EXPECT_NEAR(frames.back().strain, 1.0, 1e-12);
  const Transient t = reduce_transient(frames, 0.2, cell);
  ASSERT_EQ(t.s.size(), 5U);
  // 0.02 s of dilation in the windows without a turn, 0.04 s in the one from 0.2 to 0.4.
  EXPECT_NEAR(t.beta[0], 0.1, 1e-12);
  EXPECT_NEAR(t.beta[1], 0.2, 1e-12);
  EXPECT_NEAR(t.beta[2], 0.1, 1e-12);
  EXPECT_NEAR(t.gamma_dot[1], 5, 1e-12);
}

TEST(ReduceSteady, DropsTheStartUpByStrain) {
  std::vector<CoreState> frames = relaxing(0.64, 0.58, 0.1, 1000);
  const Measurement cell = measurement();
  integrate_strain(frames, cell.time_step);
  const SteadyMeans means = reduce_steady(frames, 5, cell);
  EXPECT_NEAR(means.phi.value, 0.58, 1e-12);  // exp(-50) of the start is left
  EXPECT_NEAR(means.mu.value, 0.4, 1e-12);
  EXPECT_NEAR(means.p.value, 1000, 1e-9);
  EXPECT_NEAR(means.strain, 0.02 * 999 - 5, 0.021);
  EXPECT_CONTAINS(message_of<EngineError>([&] { reduce_steady(frames, 19, cell); }),
                  "frames lie beyond the strain of 19");
}

using WallSeries = dem2sph::test::Scratch;
TEST_F(WallSeries, IsReadAndChecked) {
  dem2sph::test::put(in("wall.txt"),
                     "# Time-averaged data\n# TimeStep v_a\n100 0.015 1001 400\n200 0.016 999 410\n");
  const auto samples = read_wall_series(in("wall.txt"));
  ASSERT_EQ(samples.size(), 2U);
  EXPECT_EQ(samples[1].step, 200);
  EXPECT_EQ(samples[1].tau, 410);
  for (const char* bad :
       {"100 0.015 nan 400\n", "100 0.015 1\n", "100 1 1 1 1\n", "200 1 1 1\n100 1 1 1\n"}) {
    dem2sph::test::put(in("wall.txt"), bad);
    EXPECT_CONTAINS(message_of<InputError>([&] { read_wall_series(in("wall.txt")); }), "wall.txt:");
  }
}

}  // namespace
}  // namespace dem2sph::bridge
