// Grains on a case's geometry: where they are put, the decks, and what a slab keeps of its plane.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "dem_bridge/deck_text.hpp"
#include "dem_bridge/grain_flow.hpp"
#include "sph/base/errors.hpp"
#include "tests/base/helpers.hpp"
#include "tests/dem_bridge/material.hpp"

namespace dem2sph::bridge {
namespace {

using dem2sph::test::message_of;

template <int Dim>
Vec<Dim> at(double x, double up) {
  Vec<Dim> v;
  v[0] = x, v[Dim - 1] = up;
  return v;
}

/// A column of 10 d by 8 d on a rough floor against a smooth wall.
Geometry<2> column() {
  Geometry<2> g;
  g.high = at<2>(0.03, 0.012);
  Wall<2> floor, back;
  floor.name = "floor", floor.direction = at<2>(0, 1);
  back.name = "back", back.direction = at<2>(1, 0), back.rough = false;
  g.walls = {floor, back};
  Body<2> body;
  body.name = "material", body.high = at<2>(0.010, 0.008);
  g.bodies = {body};
  return g;
}

GrainFlow flow_on(const Geometry<2>& geometry) {
  GrainFlow flow;
  flow.material = hertz_grains(3e7);
  flow.geometry = slab_of(geometry, 0.008);
  flow.gravity[2] = -9.81;
  flow.height = 0.008;
  flow.packing_friction = 0.5;
  flow.end_time = 0.2;
  flow.stop_at_rest = true;
  return flow;
}

TEST(Slab, KeepsDistancesNormalsAndVelocities) {
  Geometry<2> plane = column();
  Wall<2> drum, box;
  drum.shape = WallShape::cylinder, drum.radius = 0.02, drum.point = at<2>(0.004, 0.003), drum.omega = 3;
  box.shape = WallShape::box, box.inside = false, box.point = at<2>(0.02, 0.001),
  box.half = at<2>(0.002, 0.003);
  plane.walls.push_back(drum), plane.walls.push_back(box);
  const Geometry<3> slab = slab_of(plane, 0.008);
  EXPECT_TRUE(slab.periodic[1]);
  EXPECT_EQ(slab.high[1], 0.008);
  for (std::size_t w = 0; w < plane.walls.size(); ++w)
    for (int i = 0; i < 20; ++i) {
      const double x = 0.0013 * i - 0.002, up = 0.0007 * i + 0.0001;
      Vec<3> there = at<3>(x, up);
      there[1] = 0.003;
      const Vec<2> here = at<2>(x, up);
      EXPECT_DOUBLE_EQ(slab.walls[w].distance(there), plane.walls[w].distance(here));
      const Vec<3> n = slab.walls[w].normal(there), v = slab.walls[w].velocity_at(there);
      const Vec<2> n2 = plane.walls[w].normal(here), v2 = plane.walls[w].velocity_at(here);
      EXPECT_NEAR(n[0], n2[0], 1e-12);
      EXPECT_NEAR(n[2], n2[1], 1e-12);
      EXPECT_NEAR(n[1], 0, 1e-12);
      // Anticlockwise stays anticlockwise.
      EXPECT_NEAR(v[0], v2[0], 1e-15);
      EXPECT_NEAR(v[2], v2[1], 1e-15);
      EXPECT_NEAR(v[1], 0, 1e-15);
    }
}

TEST(GrainFlow, GrainsHaveRoomAndTheSameSeedTheSamePlaces) {
  const GrainFlow flow = flow_on(column());
  const std::vector<PlacedGrain> grains = place_grains(flow);
  double solid = 0;
  std::size_t glued = 0;
  for (std::size_t i = 0; i < grains.size(); ++i) {
    const PlacedGrain& g = grains[i];
    if (g.type != 1) {
      ++glued;
      EXPECT_LE(g.x[2] + 0.5 * g.diameter, 1e-12) << "the surface of a wall stays behind it";
      continue;
    }
    solid += std::numbers::pi / 6 * std::pow(g.diameter, 3);
    EXPECT_GE(g.x[0] - 0.5 * g.diameter, 0);
    EXPECT_LE(g.x[0] + 0.5 * g.diameter, 0.010 + 1e-12);
    for (std::size_t k = i + 1; k < grains.size(); ++k) {
      Vec<3> r = g.x - grains[k].x;
      r[1] -= 0.008 * std::round(r[1] / 0.008);
      ASSERT_GE(norm(r), 0.5 * (g.diameter + grains[k].diameter) - 1e-12) << i << " and " << k;
    }
  }
  // The densest packing of friction 0.5 and 3 % more, in whole grains of five sizes drawn at random: the
  // volume of 600 of them scatters by 1 %.
  EXPECT_NEAR(solid / (0.010 * 0.008 * 0.008), 1.03 * 0.615, 0.05);
  EXPECT_GT(glued, 2u * 30 * 8 - 40) << "two layers under the floor";
  const std::vector<PlacedGrain> again = place_grains(flow);
  ASSERT_EQ(again.size(), grains.size());
  for (std::size_t i = 0; i < grains.size(); ++i)
    EXPECT_TRUE(again[i].x.c == grains[i].x.c && again[i].diameter == grains[i].diameter);
  GrainFlow other = flow;
  other.seed = 2;
  EXPECT_NE(place_grains(other).back().x.c, grains.back().x.c);
}

TEST(GrainFlow, VolumeOfABodyIsThatOfItsRoom) {
  const GrainFlow flow = flow_on(column());
  EXPECT_NEAR(volume_of(flow, flow.geometry.bodies[0]), 0.010 * 0.008 * 0.008, 1e-15);
  Geometry<2> drum = column();
  drum.walls.resize(1);
  drum.walls[0].shape = WallShape::cylinder, drum.walls[0].radius = 0.01, drum.walls[0].point = at<2>(0, 0);
  drum.walls[0].direction = {};
  drum.low = at<2>(-0.01, -0.01), drum.high = at<2>(0.01, 0.01);
  drum.bodies[0].low = at<2>(-0.01, -0.01), drum.bodies[0].high = at<2>(0.01, 0);
  const GrainFlow turning = flow_on(drum);
  // Cells of d/4 along the rim of 31 d: their miscount averages out to well below 1 %.
  EXPECT_NEAR(volume_of(turning, turning.geometry.bodies[0]) / (0.5 * std::numbers::pi * 1e-4 * 0.008), 1,
              0.01);
}

TEST(GrainFlow, DecksSayWhatTheCaseSays) {
  GrainFlow flow = flow_on(column());
  flow.gravity[0] = 3, flow.gravity[2] = -4;
  flow.geometry.walls[0].velocity[0] = 0.1;
  const std::vector<PlacedGrain> grains = place_grains(flow);
  const std::string settling = settling_deck(flow, grains);
  EXPECT_NE(settling.find("boundary f p f"), std::string::npos);
  EXPECT_NE(settling.find("gravity 5 vector 0 0 -1"), std::string::npos) << "they settle along -up";
  EXPECT_NE(settling.find("primitive type 3 xplane 0.01"), std::string::npos)
      << "the mould, where no wall is";
  EXPECT_EQ(settling.find("zplane"), std::string::npos) << "the floor holds the base";
  EXPECT_NE(settling.find("xplane 0\n"), std::string::npos) << "the smooth wall";
  // Walls of type 3 are without friction, all else has that of packing.
  EXPECT_NE(settling.find("coefficientFriction peratomtypepair 3 0.5 0.5 0 0.5 0.5 0 0 0 0"),
            std::string::npos);
  EXPECT_LT(settling.find("unfix mould0"), settling.find("write_restart"));
  std::vector<std::int64_t> cut;
  for (std::int64_t i = 1; i <= 450; ++i) cut.push_back(i);
  const std::string deck = flow_deck(flow, "end.restart", cut, 1e-6);
  EXPECT_NE(deck.find("gravity 5 vector 0.6 0 -0.8"), std::string::npos);
  EXPECT_EQ(deck.find("mould"), std::string::npos);
  EXPECT_NE(deck.find("group cut id 1 2 3"), std::string::npos);
  EXPECT_NE(deck.find("group cut id 401 402"), std::string::npos) << "lines of 200";
  EXPECT_NE(deck.find("delete_atoms group cut"), std::string::npos);
  EXPECT_NE(deck.find("fix slide0 wall0 move linear 0.1 0 0"), std::string::npos);
  EXPECT_NE(deck.find("jump SELF ended"), std::string::npos);
  flow.stop_at_rest = false;
  EXPECT_EQ(flow_deck(flow, "end.restart", {}, 0).find("jump"), std::string::npos);
}

TEST(GrainFlow, SamplesAreAtTheTimesOfTheCase) {
  GrainFlow flow = flow_on(column());
  for (const double end : {0.01, 0.2, 3.7}) {
    flow.end_time = end;
    const GrainFlowPlan plan = plan_grain_flow(flow, {});
    EXPECT_NEAR(plan.time_step.step * static_cast<double>(plan.interval * plan.samples), end, 1e-12 * end);
    EXPECT_EQ(plan.interval % 10, 0);
    EXPECT_LE(plan.time_step.step,
              0.25 * flow.time_step_fraction * plan.time_step.contact_duration * (1 + 1e-12));
  }
}

TEST(GrainFlow, WhatGrainsCannotHaveIsRefused) {
  const auto refused = [](const Geometry<2>& geometry) {
    return message_of<UsageError>([&] { place_grains(flow_on(geometry)); });
  };
  Geometry<2> g = column();
  g.walls[1].velocity[1] = 1;
  EXPECT_NE(refused(g).find("smooth wall of grains cannot move"), std::string::npos);
  g = column();
  g.walls[1].direction = at<2>(0.6, 0.8);
  EXPECT_NE(refused(g).find("normal to an axis"), std::string::npos);
  g = column();
  g.walls[0].basal_friction = 0.3;
  EXPECT_NE(refused(g).find("basal_friction"), std::string::npos);
  g = column();
  Wall<2> lid;
  lid.name = "lid", lid.direction = at<2>(0, -1), lid.point = at<2>(0, 0.009), lid.rough = false;
  g.walls.push_back(lid);
  EXPECT_NE(refused(g).find("find a place"), std::string::npos);
  g = column();
  g.bodies[0].shape = Body<2>::Shape::heap;
  EXPECT_THROW(slab_of(g, 0.008), UsageError);
  GrainFlow thin = flow_on(column());
  thin.geometry.high[1] = 0.004;
  EXPECT_THROW(place_grains(thin), UsageError);
}

TEST(ContactLaw, SmoothTypeHasNoFriction) {
  Deck deck;
  add_friction(deck, {.count = 2, .friction = 0.5, .smooth = 2});
  EXPECT_EQ(std::move(deck).text(),
            "fix friction all property/global coefficientFriction peratomtypepair 2 0.5 0 0 0\n");
}

}  // namespace
}  // namespace dem2sph::bridge
