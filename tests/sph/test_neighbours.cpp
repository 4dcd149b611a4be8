// The pair list against all pairs by brute force, with and without periodic directions.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <set>
#include <utility>
#include <vector>

#include "sph/base/errors.hpp"
#include "sph/neighbours.hpp"

namespace dem2sph {
namespace {

template <int Dim>
Particles<Dim> cloud(std::size_t interior, std::size_t total, unsigned seed) {
  Particles<Dim> q;
  q.resize(interior, total);
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (auto& x : q.x)
    for (double& value : x) value = uniform(random);
  for (std::size_t i = 0; i < total; ++i) q.id[i] = static_cast<std::int64_t>(i);
  return q;
}

template <int Dim>
void agrees_with_brute_force(int periodic, PairList::Wanted wanted,
                             unsigned seed) {  // periodic: the first so many
  const double reach = 0.13;
  const Particles<Dim> q = cloud<Dim>(201, 302, seed);
  Period<Dim> period;
  for (int k = 0; k < periodic; ++k) period.length[k] = 1;
  PairList list;
  list.build(q, period, reach, wanted);
  std::size_t seen = 0;
  for (std::size_t k = 0; k < list.clusters(); ++k) {
    const Cluster a = list.cluster(k);
    EXPECT_EQ(a.first, seen) << "clusters hold all particles, one after the other";
    seen += a.count;
    const bool wall = a.first >= q.interior;
    EXPECT_LE(a.first + a.count, wall ? q.size : q.interior) << "a cluster is of one kind";
    // What is near a member in the image that is nearest; a period is over three reaches, so only that one
    // is.
    std::set<std::size_t> inside, walls;
    for (std::size_t b = 0; b < q.size; ++b)
      for (std::size_t lane = 0; lane < a.count; ++lane) {
        Vec<Dim> r = q.position(a.first + lane) - q.position(b);
        for (int i = 0; i < periodic; ++i) r[i] -= std::round(r[i]);
        if (norm(r) < reach) (b < q.interior ? inside : walls).insert(b);
      }
    if (wall && !wanted.wall_sees_interior) inside.clear();
    if (wall && !wanted.wall_sees_wall) walls.clear();
    const auto check = [&](PairList::Range range, std::set<std::size_t> expected) {
      std::set<std::pair<std::size_t, std::size_t>> listed;
      for (const Neighbour n : range) {
        EXPECT_TRUE(listed.emplace(n.index(), n.image()).second) << "an image stands here twice";
        EXPECT_TRUE(expected.contains(n.index())) << "neither lane is near " << n.index();
        bool near = false;
        for (std::size_t lane = 0; lane < a.count; ++lane)
          near =
              near || norm(q.position(a.first + lane) - q.position(n.index()) - list.shift<Dim>(n)) < reach;
        EXPECT_TRUE(near) << "the image of " << n.index() << " is that of another period";
      }
      // Every near pair is there in the image in which it is near.
      for (const std::size_t b : expected)
        for (std::size_t lane = 0; lane < a.count; ++lane) {
          Vec<Dim> r = q.position(a.first + lane) - q.position(b);
          for (int i = 0; i < periodic; ++i) r[i] -= std::round(r[i]);
          if (!(norm(r) < reach)) continue;
          int found = 0;
          for (const Neighbour n : range)
            if (n.index() == b &&
                norm(q.position(a.first + lane) - q.position(b) - list.shift<Dim>(n)) < reach)
              ++found;
          EXPECT_EQ(found, 1) << "pair " << a.first + lane << ", " << b;
        }
    };
    check(list.interior_of(a), inside);
    check(list.walls_of(a), walls);
    if (testing::Test::HasFailure()) return;
  }
  EXPECT_EQ(seen, q.size);
}

TEST(Neighbours, AgreeWithBruteForce) {
  for (unsigned seed = 1; seed < 6; ++seed)
    for (const int periodic : {0, 1, 2, 3}) {  // up to all directions, the last included
      if (periodic < 3) agrees_with_brute_force<2>(periodic, {true, false}, seed);
      if (periodic < 3) agrees_with_brute_force<2>(periodic, {true, true}, seed);
      agrees_with_brute_force<3>(periodic, {true, true}, seed);
      agrees_with_brute_force<3>(periodic, {false, false}, seed);
    }
}

TEST(Neighbours, BrokenPositionIsNamed) {
  Particles<2> q = cloud<2>(10, 10, 1);
  q.x[0][4] = std::nan("");
  PairList list;
  try {
    list.build(q, Period<2>{}, 0.1, {});
    FAIL() << "a NaN was accepted";
  } catch (const NumericalError& error) {
    EXPECT_NE(std::string(error.what()).find("particle 4"), std::string::npos) << error.what();
  }
}

TEST(Neighbours, TooShortPeriodIsRefused) {
  const Particles<2> q = cloud<2>(10, 10, 1);
  Period<2> period;
  period.length[0] = 1;
  PairList list;
  EXPECT_THROW(list.build(q, period, 0.4, {}), NumericalError);
}

TEST(Neighbours, AFarFlierDoesNotExhaustMemory) {
  Particles<2> q = cloud<2>(100, 100, 1);
  q.x[1][3] = 1e6;
  PairList list;
  list.build(q, Period<2>{}, 0.05, {});
  // Its cluster of four sees it, the others do not.
  for (std::size_t k = 0; k < list.clusters(); ++k) {
    bool sees = false;
    for (const Neighbour n : list.all_of(list.cluster(k))) sees = sees || n.index() == 3;
    EXPECT_EQ(sees, k == 0);
  }
}

// Particles are moved further and further from where they were listed: before some pair is missing that has
// come near, the list is worn out. Returns how far the fastest has moved by then.
template <int Dim, class Displacement>
double moved_until_worn_out(int periodic, bool walls_move, const Displacement& displacement) {
  const double reach = 0.09, skin = 0.02;
  const Particles<Dim> listed = cloud<Dim>(300, 360, 4);
  Period<Dim> period;
  for (int k = 0; k < periodic; ++k) period.length[k] = 1;
  PairList list;
  list.build(listed, period, reach, {});
  Particles<Dim> q = listed;
  double farthest = 0;
  for (double t = 0; t < 0.3; t += 0.003) {
    farthest = 0;
    for (std::size_t i = 0; i < (walls_move ? q.size : q.interior); ++i) {
      const Vec<Dim> u = t * displacement(i, listed.position(i));
      farthest = std::max(farthest, norm(u));
      Particles<Dim>::store(q.x, i, listed.position(i) + u);
    }
    if (list.worn_out(q, listed.x, skin, walls_move)) return farthest;
    for (std::size_t a = 0; a < q.interior; ++a)
      for (std::size_t b = 0; b < q.size; ++b) {
        Vec<Dim> before = listed.position(a) - listed.position(b), now = q.position(a) - q.position(b);
        for (int i = 0; i < periodic; ++i) {
          const double image = std::round(before[i]);
          before[i] -= image, now[i] -= image;
        }
        if (!(dot(now, now) < (reach - skin) * (reach - skin))) continue;
        EXPECT_LT(norm(before), reach) << "a pair is missing at " << t;
        if (testing::Test::HasFailure()) return farthest;
      }
  }
  return farthest;
}

template <int Dim>
void wears_out_in_time() {
  std::mt19937 random(2);
  std::normal_distribution<double> normal(0, 1);
  std::vector<Vec<Dim>> direction(360);
  for (Vec<Dim>& d : direction)
    for (double& c : d.c) c = normal(random);
  const auto shear = [](std::size_t, const Vec<Dim>& x) {
    Vec<Dim> u;
    u[0] = 0.3 * x[Dim - 1];
    return u;
  };
  for (const bool walls_move : {false, true})
    for (int periodic = 0; periodic < Dim; ++periodic) {
      moved_until_worn_out<Dim>(periodic, walls_move, [&](std::size_t i, auto&&) { return direction[i]; });
      moved_until_worn_out<Dim>(periodic, walls_move, shear);
      moved_until_worn_out<Dim>(periodic, walls_move, [&](std::size_t i, const Vec<Dim>& x) {
        return i == 7 ? direction[7] : shear(i, x);
      });
    }
}

TEST(Patches, WearOutBeforeAPairIsMissing) {
  wears_out_in_time<2>();
  wears_out_in_time<3>();
}

TEST(Patches, AFlowThatCarriesItsParticlesDoesNotWearThemOut) {
  const auto along = [](std::size_t, auto&&) { return Vec<2>{{1, 0.5}}; };
  EXPECT_GT(moved_until_worn_out<2>(2, true, along), 0.3) << "all move together";
  EXPECT_LT(moved_until_worn_out<2>(2, false, along), 0.03) << "past walls that stand";
  // Two patches of 1.5 reaches see 0.27 of the height, so the fastest moves 3.7 skins: with half of the skin
  // for all it would be half a skin.
  const auto shear = [](std::size_t, const Vec<2>& x) { return Vec<2>{{0.3 * x[1], 0}}; };
  EXPECT_GT(moved_until_worn_out<2>(1, true, shear), 0.065);
}

TEST(Patches, ANaNWearsThemOut) {
  const Particles<2> listed = cloud<2>(100, 120, 1);
  PairList list;
  list.build(listed, Period<2>{}, 0.1, {});
  Particles<2> q = listed;
  EXPECT_FALSE(list.worn_out(q, listed.x, 0.01, false));
  q.x[1][57] = std::nan("");
  EXPECT_TRUE(list.worn_out(q, listed.x, 0.01, false));
}

TEST(Neighbours, ClustersOfALatticeAreCompact) {
  // 16 x 16 points, shuffled: along the curve every cluster is a square of 2 x 2.
  Particles<2> q;
  q.resize(256, 256);
  std::vector<std::size_t> place(256);
  std::iota(place.begin(), place.end(), 0);
  std::shuffle(place.begin(), place.end(), std::mt19937(1));
  for (std::size_t i = 0; i < 256; ++i) {
    q.x[0][i] = 0.1 * static_cast<double>(place[i] % 16);
    q.x[1][i] = 0.1 * static_cast<double>(place[i] / 16);
  }
  const std::vector<std::int32_t> order = spatial_order(q, 0.1);
  for (std::size_t k = 0; k < 256; k += Pack::width)
    for (std::size_t lane = 1; lane < Pack::width; ++lane)
      EXPECT_LT(norm(q.position(static_cast<std::size_t>(order[k])) -
                     q.position(static_cast<std::size_t>(order[k + lane]))),
                0.1415);
}

TEST(Neighbours, SpatialOrderIsAPermutationThatKeepsKindsApart) {
  const Particles<2> q = cloud<2>(200, 300, 3);
  const std::vector<std::int32_t> order = spatial_order(q, 0.1);
  EXPECT_EQ(std::set<std::int32_t>(order.begin(), order.end()).size(), 300u);
  for (std::size_t i = 0; i < 300; ++i) EXPECT_EQ(i < 200, order[i] < 200);
}

}  // namespace
}  // namespace dem2sph
