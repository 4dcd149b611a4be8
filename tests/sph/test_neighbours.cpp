// The pair list against all pairs by brute force, with and without periodic directions.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

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
  const Particles<Dim> q = cloud<Dim>(200, 300, seed);
  Period<Dim> period;
  for (int k = 0; k < periodic; ++k) period.length[k] = 1;
  PairList list;
  list.build(q, period, reach, wanted);
  for (std::size_t a = 0; a < q.size; ++a) {
    std::set<std::int32_t> inside;
    std::set<std::int32_t> walls;
    for (std::size_t b = 0; b < q.size; ++b) {
      if (a == b) continue;
      Vec<Dim> r = q.position(a) - q.position(b);
      for (int k = 0; k < periodic; ++k) r[k] -= std::round(r[k]);
      if (norm(r) < reach) (b < q.interior ? inside : walls).insert(static_cast<std::int32_t>(b));
    }
    if (a >= q.interior && !wanted.wall_sees_interior) inside.clear();
    if (a >= q.interior && !wanted.wall_sees_wall) walls.clear();
    const auto found_inside = list.interior_of(a);
    const auto found_walls = list.walls_of(a);
    ASSERT_TRUE(std::equal(found_inside.begin(), found_inside.end(), inside.begin(), inside.end()))
        << "particle " << a;
    ASSERT_TRUE(std::equal(found_walls.begin(), found_walls.end(), walls.begin(), walls.end()))
        << "particle " << a;
  }
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
  EXPECT_EQ(list.all_of(3).begin(), list.all_of(3).end());
}

TEST(Neighbours, SpatialOrderIsAPermutationThatKeepsKindsApart) {
  const Particles<2> q = cloud<2>(200, 300, 3);
  const std::vector<std::int32_t> order = spatial_order(q, 0.1);
  EXPECT_EQ(std::set<std::int32_t>(order.begin(), order.end()).size(), 300u);
  for (std::size_t i = 0; i < 300; ++i) EXPECT_EQ(i < 200, order[i] < 200);
}

}  // namespace
}  // namespace dem2sph
