// Geometry: distances against sampled surfaces, normals against differences of distances, lattices against
// the rules that they follow and against layouts written out by hand, and every refused input with its
// message.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <set>

#include "sph/base/geometry.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using test::message_of;
constexpr double pi = std::numbers::pi;

template <int Dim>
Wall<Dim> plane(const Vec<Dim>& point, const Vec<Dim>& normal) {
  Wall<Dim> w;
  w.name = "plane";
  w.point = point;
  w.direction = (1 / norm(normal)) * normal;
  return w;
}
template <int Dim>
Wall<Dim> box(bool inside, const Vec<Dim>& centre, const Vec<Dim>& half) {
  Wall<Dim> w;
  w.name = "box";
  w.shape = WallShape::box;
  w.inside = inside;
  w.point = centre;
  w.half = half;
  return w;
}
template <int Dim>
Wall<Dim> cylinder(bool inside, const Vec<Dim>& centre, double radius, int axis = -1) {
  Wall<Dim> w;
  w.name = "cylinder";
  w.shape = WallShape::cylinder;
  w.inside = inside;
  w.point = centre;
  w.radius = radius;
  if (axis >= 0) w.direction[axis] = 1;
  return w;
}
template <int Dim>
Body<Dim> block(const Vec<Dim>& low, const Vec<Dim>& high) {
  Body<Dim> b;
  b.name = "block";
  b.low = low;
  b.high = high;
  return b;
}

// ---- walls

struct Random {
  std::mt19937 engine{7};  // any seed: the tests hold for all points
  double operator()(double a, double b) { return std::uniform_real_distribution<double>(a, b)(engine); }
  template <int Dim>
  Vec<Dim> point(double reach) {
    Vec<Dim> x;
    for (int i = 0; i < Dim; ++i) x[i] = (*this)(-reach, reach);
    return x;
  }
};

// |distance| against the nearest of many samples of the surface: it may not be above, and below only by the
// distance of samples. `is_room` says independently where the distance is positive.
template <int Dim, class IsRoom>
void expect_distances(const Wall<Dim>& wall, const std::vector<Vec<Dim>>& surface, double spacing,
                      const IsRoom& is_room) {
  Random random;
  for (int n = 0; n < 100; ++n) {
    const Vec<Dim> x = random.point<Dim>(1.5);
    double nearest = 1e9;
    for (const Vec<Dim>& s : surface) nearest = std::min(nearest, norm(x - s));
    const double d = wall.distance(x);
    EXPECT_EQ(d > 0, is_room(x));
    EXPECT_LE(std::abs(d), nearest + 1e-12);  // rounding of a few numbers of order 1
    EXPECT_GE(std::abs(d), nearest - spacing);
  }
}

TEST(Wall, DistanceIsThatToTheNearestPointOfTheSurface) {
  constexpr int n = 4000;
  const double step = 2 * pi / n;
  for (const bool inside : {true, false}) {
    SCOPED_TRACE(inside);
    {
      const Vec<2> c{{0.1, -0.2}};
      std::vector<Vec<2>> surface;
      for (int i = 0; i < n; ++i)
        surface.push_back(c + Vec<2>{{0.7 * std::cos(i * step), 0.7 * std::sin(i * step)}});
      expect_distances(cylinder<2>(inside, c, 0.7), surface, step,
                       [&](const Vec<2>& x) { return (norm(x - c) < 0.7) == inside; });

      const Vec<2> half{{0.8, 0.5}};
      surface.clear();
      for (int i = 0; i <= n; ++i) {
        const double u = -1 + 2.0 * i / n;
        for (const double side : {-1.0, 1.0}) {
          surface.push_back(c + Vec<2>{{u * half[0], side * half[1]}});
          surface.push_back(c + Vec<2>{{side * half[0], u * half[1]}});
        }
      }
      expect_distances(box<2>(inside, c, half), surface, 2.0 / n, [&](const Vec<2>& x) {
        return (std::abs(x[0] - c[0]) < half[0] && std::abs(x[1] - c[1]) < half[1]) == inside;
      });
    }
    {
      constexpr int m = 120;
      const Vec<3> c{{0.1, -0.2, 0.05}};
      const Vec<3> half{{0.8, 0.5, 0.6}};
      std::vector<Vec<3>> surface;
      for (int a = 0; a < 3; ++a)
        for (int i = 0; i <= m; ++i)
          for (int j = 0; j <= m; ++j)
            for (const double side : {-1.0, 1.0}) {
              Vec<3> x = c;
              x[a] += side * half[a];
              x[(a + 1) % 3] += (-1 + 2.0 * i / m) * half[(a + 1) % 3];
              x[(a + 2) % 3] += (-1 + 2.0 * j / m) * half[(a + 2) % 3];
              surface.push_back(x);
            }
      expect_distances(box<3>(inside, c, half), surface, 2.0 / m, [&](const Vec<3>& x) {
        bool within = true;
        for (int i = 0; i < 3; ++i) within = within && std::abs(x[i] - c[i]) < half[i];
        return within == inside;
      });
      for (int axis = 0; axis < 3; ++axis) {
        surface.clear();
        const int b = (axis + 1) % 3, e = (axis + 2) % 3;
        for (int i = 0; i < 2 * m; ++i)
          for (int j = 0; j <= 2 * m; ++j) {
            Vec<3> x = c;
            x[axis] = -1.6 + 3.2 * j / (2 * m);
            x[b] += 0.7 * std::cos(pi * i / m);
            x[e] += 0.7 * std::sin(pi * i / m);
            surface.push_back(x);
          }
        expect_distances(cylinder<3>(inside, c, 0.7, axis), surface, 3.2 / m, [&](const Vec<3>& x) {
          return (std::hypot(x[b] - c[b], x[e] - c[e]) < 0.7) == inside;
        });
      }
    }
  }
}

TEST(Wall, ThePlaneOfTheHeader) {
  const Wall<2> floor = plane<2>({{0, 0}}, {{0, 1}});
  EXPECT_EQ(floor.distance({{3, 0.2}}), 0.2);
  EXPECT_EQ(floor.normal({{3, 0.2}})[1], 1);
  // The line x + up = 1: (0, 0) is 1/sqrt(2) behind it.
  EXPECT_NEAR(plane<2>({{1, 0}}, {{5, 5}}).distance({{0, 0}}), -std::sqrt(0.5), 1e-15);
}

template <int Dim>
void expect_gradient(const Wall<Dim>& wall) {
  const double h = 1e-5;
  Random random;
  int seen = 0;
  for (int n = 0; n < 400; ++n) {
    const Vec<Dim> x = random.point<Dim>(1.5);
    const Vec<Dim> normal = wall.normal(x);
    EXPECT_NEAR(norm(normal), 1, 1e-14);
    Vec<Dim> gradient;
    bool smooth = true;  // not at a ridge, where the nearest face changes
    for (int i = 0; i < Dim; ++i) {
      Vec<Dim> ahead = x, behind = x;
      ahead[i] += h;
      behind[i] -= h;
      gradient[i] = (wall.distance(ahead) - wall.distance(behind)) / (2 * h);
      smooth = smooth && norm(wall.normal(ahead) - wall.normal(behind)) < 1e-3;
    }
    if (!smooth) continue;
    ++seen;
    // The radius of curvature is above 2h/1e-3 = 0.02: the difference errs by h^2/(6 r^2) < 1e-7, rounding by
    // 1e-11.
    EXPECT_LT(norm(gradient - normal), 1e-7);
  }
  EXPECT_GT(seen, 390);  // ridges and axes are thin
}

TEST(Wall, TheNormalIsTheGradientOfTheDistance) {
  expect_gradient(plane<2>({{0.3, 0}}, {{1, 2}}));
  expect_gradient(plane<3>({{0.3, 0, 1}}, {{1, -2, 0.5}}));
  for (const bool inside : {true, false}) {
    expect_gradient(box<2>(inside, {{0.1, -0.2}}, {{0.8, 0.5}}));
    expect_gradient(box<3>(inside, {{0.1, -0.2, 0}}, {{0.8, 0.5, 0.6}}));
    expect_gradient(cylinder<2>(inside, {{0.1, -0.2}}, 0.7));
    for (int axis = 0; axis < 3; ++axis) expect_gradient(cylinder<3>(inside, {{0.1, -0.2, 0}}, 0.7, axis));
  }
}

TEST(Wall, NormalsAreUnitVectorsOnAxesEdgesAndFacesToo) {
  for (const bool inside : {true, false}) {
    for (int axis = 0; axis < 3; ++axis) {
      const Vec<3> n = cylinder<3>(inside, {{0, 0, 0}}, 1, axis).normal({{0, 0, 0}});
      EXPECT_NEAR(norm(n), 1, 1e-15);
      EXPECT_EQ(n[axis], 0);
    }
    EXPECT_EQ(norm(cylinder<2>(inside, {{1, 1}}, 1).normal({{1, 1}})), 1);
    const Wall<2> b = box<2>(inside, {{0, 0}}, {{1, 1}});
    for (const Vec<2>& x :
         {Vec<2>{{0, 0}}, Vec<2>{{1, 0}}, Vec<2>{{1, 1}}, Vec<2>{{-1, 0.5}}, Vec<2>{{2, 2}}})
      EXPECT_NEAR(norm(b.normal(x)), 1, 1e-15);
    EXPECT_EQ(b.normal({{-1, 0.5}})[0], inside ? 1 : -1);
    EXPECT_EQ(b.distance({{-1, 0.5}}), 0);
  }
}

// A point of the material that goes with the wall keeps its distance: move() and velocity_at() are one
// motion.
template <int Dim>
void expect_one_motion(Wall<Dim> wall) {
  EXPECT_TRUE(wall.moves());
  Random random;
  const double dt = 1e-6;
  for (int n = 0; n < 50; ++n) {
    const Vec<Dim> x = random.point<Dim>(1.5);
    Wall<Dim> later = wall;
    later.move(dt);
    const Vec<Dim> y = x + dt * wall.velocity_at(x);
    // Speeds, rates and curvatures are below 10: what is of second order is below 1e3 dt^2 = 1e-9.
    EXPECT_NEAR(later.distance(y), wall.distance(x), 1e-9);
    EXPECT_LT(norm(later.normal(y) - wall.normal(x)), 1e-4);  // a turn of 3 dt, over the distance to an axis
  }
}

TEST(Wall, MoveAgreesWithVelocityAt) {
  Wall<2> turning = plane<2>({{0.3, 0.1}}, {{1, 2}});
  EXPECT_FALSE(turning.moves());
  turning.velocity = {{0.5, -1}};
  turning.omega = 3;
  expect_one_motion(turning);
  Wall<2> drum = cylinder<2>(true, {{0.1, 0}}, 0.7);
  drum.omega = -2;
  expect_one_motion(drum);
  drum.velocity = {{0.5, -1}};
  expect_one_motion(drum);
  Wall<3> lid = plane<3>({{0, 0, 1}}, {{0, 0.6, -0.8}});
  lid.velocity = {{1, 0, 0.5}};
  expect_one_motion(lid);
  Wall<3> piston = box<3>(true, {{0, 0.2, 0}}, {{1, 0.5, 0.7}});
  piston.velocity = {{1, 0, 0.5}};
  expect_one_motion(piston);
  for (int axis = 0; axis < 3; ++axis) {
    Wall<3> mill = cylinder<3>(false, {{0, 0.2, 0}}, 0.4, axis);
    mill.omega = 3;
    mill.velocity = {{1, 0, 0.5}};
    expect_one_motion(mill);
  }
}

TEST(Wall, DirectionsOfRotation) {
  Wall<2> drum = cylinder<2>(true, {{1, 1}}, 1);
  drum.omega = 2;
  const Vec<2> right = drum.velocity_at({{1.5, 1}});  // anticlockwise: the right side rises
  EXPECT_EQ(right[0], 0);
  EXPECT_EQ(right[1], 1);
  Wall<3> mill = cylinder<3>(true, {{0, 0, 0}}, 1, 2);
  mill.omega = 2;
  const Vec<3> east = mill.velocity_at({{0.5, 0, 7}});  // right-handed about up: x turns to across
  EXPECT_EQ(east[0], 0);
  EXPECT_EQ(east[1], 1);
  EXPECT_EQ(east[2], 0);

  // A quarter turn of a plane in a hundred steps; each adds rounding of 1e-16.
  Wall<2> gate = plane<2>({{0, 0}}, {{1, 0}});
  gate.omega = pi / 2;
  for (int i = 0; i < 100; ++i) gate.move(0.01);
  EXPECT_NEAR(gate.direction[0], 0, 1e-13);
  EXPECT_NEAR(gate.direction[1], 1, 1e-13);
}

// ---- bodies

TEST(Body, ShapesByTheirFormulas) {
  const Body<2> b = block<2>({{1, 2}}, {{3, 5}});
  EXPECT_TRUE(b.contains({{1.5, 2.5}}));
  for (const Vec<2>& x : {Vec<2>{{0.9, 3}}, Vec<2>{{3.1, 3}}, Vec<2>{{2, 1.9}}, Vec<2>{{2, 5.1}}})
    EXPECT_FALSE(b.contains(x));
  EXPECT_EQ(b.depth({{2, 4.5}}), 0.5);

  Body<2> heap = block<2>({{1, 0}}, {{1, 1}});
  heap.shape = Body<2>::Shape::heap;
  heap.angle = pi / 4;
  EXPECT_TRUE(heap.contains({{1.25, 0.5}}));
  EXPECT_FALSE(heap.contains({{1.75, 0.5}}));
  EXPECT_FALSE(heap.contains({{0.75, 0.5}}));
  EXPECT_NEAR(heap.depth({{1.25, 0.5}}), 0.25, 1e-15);
  heap.both_sides = true;
  EXPECT_TRUE(heap.contains({{0.75, 0.5}}));

  Body<3> cone;
  cone.shape = Body<3>::Shape::heap;
  cone.high = {{0, 0, 1}};
  cone.angle = std::atan(0.5);
  EXPECT_TRUE(cone.contains({{-0.6, 0.8, 0.45}}));
  EXPECT_FALSE(cone.contains({{-0.6, 0.8, 0.55}}));
  EXPECT_NEAR(cone.depth({{-0.6, 0.8, 0.45}}), 0.05, 1e-15);

  Body<3> upright = cone;
  upright.shape = Body<3>::Shape::cylinder;
  upright.radius = 0.5;
  EXPECT_TRUE(upright.contains({{0.29, 0.39, 0.99}}));
  EXPECT_FALSE(upright.contains({{0.31, 0.41, 0.5}}));
  EXPECT_FALSE(upright.contains({{0, 0, 1.01}}));
  EXPECT_FALSE(upright.contains({{0, 0, -0.01}}));
  EXPECT_EQ(upright.depth({{0.2, 0, 0.75}}), 0.25);
}

// The depth is zero where contains() ends, upwards.
TEST(Body, DepthIsTheDistanceToTheTop) {
  Body<3> body;
  body.low = {{-1, -1, 0}};
  body.high = {{1, 1, 0.8}};
  body.radius = 1;
  body.angle = 0.5;
  Random random;
  for (const auto shape : {Body<3>::Shape::box, Body<3>::Shape::cylinder, Body<3>::Shape::heap}) {
    body.shape = shape;
    int seen = 0;
    for (int n = 0; n < 500; ++n) {
      Vec<3> x = random.point<3>(1);
      if (!body.contains(x)) continue;
      ++seen;
      double low = 0, high = 2;
      for (int i = 0; i < 50; ++i) {
        const double middle = (low + high) / 2;
        Vec<3> above = x;
        above[2] += middle;
        (body.contains(above) ? low : high) = middle;
      }
      EXPECT_NEAR(body.depth(x), low, 1e-14);
    }
    EXPECT_GT(seen, 20);
  }
}

// ---- lattices

template <int Dim>
double periodic_distance(const Geometry<Dim>& g, const Vec<Dim>& a, const Vec<Dim>& b) {
  Vec<Dim> r = a - b;
  for (int i = 0; i < Dim; ++i)
    if (g.periodic[static_cast<std::size_t>(i)]) {
      const double period = g.high[i] - g.low[i];
      r[i] -= period * std::round(r[i] / period);
    }
  return norm(r);
}

// The rules of fill(), each by brute force.
template <int Dim>
GeometryPoints<Dim> expect_rules(const Geometry<Dim>& g, double dx, int layers) {
  const GeometryPoints<Dim> points = fill(g, dx, layers);
  const double rounding = 1e-9 * dx;
  EXPECT_EQ(points.interior.size(), points.body.size());
  EXPECT_EQ(points.walls.size(), points.wall.size());
  EXPECT_FALSE(points.walls.empty());
  for (std::size_t i = 0; i < points.interior.size(); ++i) {
    const Vec<Dim>& x = points.interior[i];
    EXPECT_TRUE(g.bodies[points.body[i]].contains(x));
    for (const Wall<Dim>& w : g.walls) EXPECT_GE(w.distance(x), 0.45 * dx);
    for (int a = 0; a < Dim; ++a) {
      const double cell = (x[a] - g.low[a]) / dx - 0.5;
      EXPECT_NEAR(cell, std::round(cell), 1e-9);
    }
  }
  for (std::size_t i = 0; i < points.walls.size(); ++i) {
    const Vec<Dim>& x = points.walls[i];
    const double depth = -g.walls[points.wall[i]].distance(x);
    EXPECT_GT(depth, 0.25 * dx);  // half a spacing of fitted rows, which shrink to 3/4 at most
    EXPECT_LE(depth, layers * dx);
    for (int a = 0; a < Dim; ++a) {
      const double around = g.periodic[static_cast<std::size_t>(a)] ? 0 : layers * dx;
      EXPECT_GE(x[a], g.low[a] - around - rounding);
      EXPECT_LE(x[a], g.high[a] + around + rounding);
    }
    double nearest = 1e9;
    for (std::size_t j = 0; j < points.walls.size(); ++j)
      if (j != i) nearest = std::min(nearest, periodic_distance(g, x, points.walls[j]));
    EXPECT_GE(nearest, 0.7 * dx * (1 - 1e-5));  // the slack of fill()
    EXPECT_LE(nearest, 1.5 * dx);               // nor alone
    for (const Vec<Dim>& y : points.interior) EXPECT_GE(periodic_distance(g, x, y), 0.7 * dx);
  }
  return points;
}

// Every point of a rough neighbourhood behind the surface, seen from the material, has a wall point near:
// half a cell in each of two directions, a cell between two walls whose lattices do not meet.
template <int Dim>
void expect_no_holes(const Geometry<Dim>& g, const GeometryPoints<Dim>& points, double dx) {
  for (const Vec<Dim>& x : points.interior)
    for (const Wall<Dim>& w : g.walls) {
      const double d = w.distance(x);
      if (d > dx) continue;
      Vec<Dim> behind = x - (d + 0.5 * dx) * w.normal(x);
      double nearest = 1e9;
      for (const Vec<Dim>& y : points.walls) nearest = std::min(nearest, periodic_distance(g, behind, y));
      EXPECT_LE(nearest, dx);
    }
}

template <int Dim>
void expect_filled(const Geometry<Dim>& g, double dx, int layers) {
  expect_no_holes(g, expect_rules(g, dx, layers), dx);
}

TEST(Fill, TheColumnIsThatOfTheScene) {
  // The blocks of the scene "column collapse": 7 columns of 5 rows, a floor of 20 columns to the right of x =
  // 0.
  const double dx = 0.3 / 7;
  const int layers = 3, columns = 7, rows = 5, floor_columns = 20;
  Geometry<2> g;
  g.high = {{dx * (floor_columns - layers), dx * (rows + layers)}};
  g.walls = {plane<2>({{0, 0}}, {{0, 1}}), plane<2>({{0, 0}}, {{1, 0}})};
  g.bodies = {block<2>({{0, 0}}, {{dx * columns, dx * rows}})};
  const GeometryPoints<2> points = expect_rules(g, dx, layers);
  expect_no_holes(g, points, dx);

  std::vector<Vec<2>> expected;
  const auto add = [&](int i0, int i1, int k0, int k1) {
    for (int k = k0; k < k1; ++k)
      for (int i = i0; i < i1; ++i) expected.push_back({{(i + 0.5) * dx, (k + 0.5) * dx}});
  };
  const auto same = [&](const std::vector<Vec<2>>& found) {
    ASSERT_EQ(found.size(), expected.size());
    for (std::size_t i = 0; i < found.size(); ++i) EXPECT_EQ(found[i].c, expected[i].c) << i;
  };
  add(0, columns, 0, rows);
  same(points.interior);
  expected.clear();
  add(-layers, floor_columns, -layers, 0);
  const std::size_t floor = expected.size();
  add(-layers, 0, 0, rows + 2 * layers);
  same(points.walls);
  for (std::size_t i = 0; i < points.wall.size(); ++i) EXPECT_EQ(points.wall[i], i < floor ? 0u : 1u);
}

TEST(Fill, TheColumnIn3dToo) {
  const double dx = 0.125;  // a power of 2, so that multiples are exact
  const int layers = 2;
  Geometry<3> g;
  g.high = {{12 * dx, 5 * dx, 6 * dx}};
  g.periodic[1] = true;
  g.walls = {plane<3>({{0, 0, 0}}, {{0, 0, 1}}), plane<3>({{0, 0, 0}}, {{1, 0, 0}})};
  g.bodies = {block<3>({{0, 0, 0}}, {{4 * dx, 5 * dx, 4 * dx}})};
  const GeometryPoints<3> points = expect_rules(g, dx, layers);
  expect_no_holes(g, points, dx);
  EXPECT_EQ(points.interior.size(), 4u * 5 * 4);
  std::set<std::array<double, 3>> expected;
  for (int j = 0; j < 5; ++j) {
    for (int i = -layers; i < 12 + layers; ++i)
      for (int k = -layers; k < 0; ++k) expected.insert({(i + 0.5) * dx, (j + 0.5) * dx, (k + 0.5) * dx});
    for (int i = -layers; i < 0; ++i)
      for (int k = 0; k < 6 + layers; ++k) expected.insert({(i + 0.5) * dx, (j + 0.5) * dx, (k + 0.5) * dx});
  }
  std::set<std::array<double, 3>> found;
  for (const Vec<3>& x : points.walls) found.insert(x.c);
  EXPECT_EQ(found, expected);
}

TEST(Fill, Planes2d) {
  Geometry<2> g;  // a V, closed by a lid that lies off the lattice
  g.low = {{-1, 0}};
  g.high = {{1, 1.5}};
  g.walls = {plane<2>({{0, 0}}, {{1, 1.7}}), plane<2>({{0, 0}}, {{-1, 1}}), plane<2>({{0, 1.23}}, {{0, -1}})};
  g.bodies = {block<2>(g.low, g.high)};
  expect_filled(g, 0.1, 3);

  Geometry<2> incline;
  incline.high = {{1, 1}};
  incline.periodic[0] = true;
  incline.walls = {plane<2>({{0, 0}}, {{0, 1}})};
  incline.bodies = {block<2>({{0, 0}}, {{1, 0.5}})};
  const GeometryPoints<2> points = expect_rules(incline, 0.1, 3);
  EXPECT_EQ(points.interior.size(), 50u);
  EXPECT_EQ(points.walls.size(), 30u);
}

TEST(Fill, Planes3d) {
  Geometry<3> chute;  // leans in (x, up), periodic across with a spacing that binary numbers do not hold
  chute.high = {{1, 0.7, 1}};
  chute.periodic[1] = true;
  chute.walls = {plane<3>({{0, 0, 0.5}}, {{0.4, 0, 1}}), plane<3>({{0, 0, 0}}, {{1, 0, 0}})};
  chute.bodies = {block<3>(chute.low, chute.high)};
  expect_filled(chute, 0.1, 2);

  Geometry<3> corner;  // no axis lies in the first plane
  corner.high = {{0.8, 0.8, 0.8}};
  corner.walls = {plane<3>({{0.2, 0.2, 0.2}}, {{0.3, 0.5, 1}}), plane<3>({{0, 0, 0}}, {{0, 1, 0}})};
  corner.bodies = {block<3>(corner.low, corner.high)};
  expect_filled(corner, 0.1, 2);
}

template <int Dim>
std::size_t count_of(const GeometryPoints<Dim>& points, std::size_t wall) {
  return static_cast<std::size_t>(std::count(points.wall.begin(), points.wall.end(), wall));
}

std::size_t ring(double turns) { return static_cast<std::size_t>(std::max(6L, std::lround(2 * pi * turns))); }

TEST(Fill, CircularContainer) {
  Geometry<2> g;
  g.low = {{-2, -2}};
  g.high = {{2, 2}};
  const Vec<2> c{{0.03, -0.02}};
  const double dx = 0.1, radius = 1;
  g.walls = {cylinder<2>(true, c, radius)};
  g.bodies = {block<2>(g.low, {{2, 0}})};
  const GeometryPoints<2> points = expect_rules(g, dx, 3);
  expect_no_holes(g, points, dx);
  EXPECT_EQ(points.walls.size(), ring(10.5) + ring(11.5) + ring(12.5));

  // No gap in a ring is wider than 1.5 dx...
  for (int k = 0; k < 3; ++k) {
    std::vector<double> angles;
    const double r = radius + (k + 0.5) * dx;
    for (const Vec<2>& x : points.walls)
      if (std::abs(norm(x - c) - r) < 1e-9) angles.push_back(std::atan2(x[1] - c[1], x[0] - c[0]));
    std::sort(angles.begin(), angles.end());
    angles.push_back(angles.front() + 2 * pi);
    for (std::size_t i = 1; i < angles.size(); ++i) EXPECT_LE((angles[i] - angles[i - 1]) * r, 1.5 * dx);
  }
  // ...so that whoever looks from the material through the wall sees a particle within half of that of every
  // ray.
  for (const Vec<2>& x : points.interior) {
    if (g.walls[0].distance(x) > 2 * dx) continue;
    for (int n = 0; n < 90; ++n) {
      const Vec<2> ray{{std::cos(n * pi / 45), std::sin(n * pi / 45)}};
      const double r = radius + 0.5 * dx;  // |x + s ray - c| = r
      const double b = dot(x - c, ray);
      const double s = -b + std::sqrt(b * b + r * r - dot(x - c, x - c));
      double nearest = 1e9;
      for (const Vec<2>& y : points.walls) nearest = std::min(nearest, norm(x + s * ray - y));
      EXPECT_LE(nearest, 0.75 * dx);
    }
  }
}

TEST(Fill, CircularObstacle) {
  Geometry<2> g;
  g.high = {{2, 2}};
  g.periodic[0] = true;
  g.walls = {plane<2>({{0, 0}}, {{0, 1}}), cylinder<2>(false, {{1, 0.9}}, 0.25)};
  g.bodies = {block<2>(g.low, {{2, 1.5}})};
  const GeometryPoints<2> points = expect_rules(g, 0.1, 4);
  expect_no_holes(g, points, 0.1);
  // Rings of radius 2 dx and 1 dx; the third would be the centre itself.
  EXPECT_EQ(count_of(points, 1), ring(2) + ring(1));
  // Small rings have fewer points than a hexagon, so that no two are nearer than 0.7 dx.
  for (const double radius : {0.06, 0.08, 0.1, 0.12, 0.14, 0.17, 0.23, 0.3}) {
    g.walls[1].radius = radius;
    SCOPED_TRACE(radius);
    const GeometryPoints<2> small = fill(g, 0.1, 4);
    std::vector<Vec<2>> own;
    for (std::size_t i = 0; i < small.walls.size(); ++i)
      if (small.wall[i] == 1) own.push_back(small.walls[i]);
    for (std::size_t i = 0; i < own.size(); ++i)
      for (std::size_t j = 0; j < i; ++j) EXPECT_GE(norm(own[i] - own[j]), 0.07 * (1 - 1e-9));
  }
}

TEST(Fill, Cylinders3d) {
  for (int axis = 0; axis < 3; ++axis) {
    SCOPED_TRACE(axis);
    Geometry<3> g;
    g.low = {{-1, -1, -1}};
    g.high = {{1, 1, 1}};
    if (axis < 2) {
      g.low[axis] = 0;
      g.high[axis] = 0.7;
      g.periodic[static_cast<std::size_t>(axis)] = true;
    }
    g.walls = {cylinder<3>(true, {{0, 0, 0}}, 0.5, axis)};
    g.bodies = {block<3>(g.low, g.high)};
    const GeometryPoints<3> points = expect_rules(g, 0.1, 2);
    expect_no_holes(g, points, 0.1);
    const std::size_t rows = axis < 2 ? 7 : 20 + 2 * 2;
    EXPECT_EQ(points.walls.size(), rows * (ring(5.5) + ring(6.5)));
  }
  Geometry<3> silo;
  silo.low = {{-0.6, -0.6, 0}};
  silo.high = {{0.6, 0.6, 0.8}};
  silo.walls = {plane<3>({{0, 0, 0}}, {{0, 0, 1}}), cylinder<3>(true, {{0, 0, 0}}, 0.43, 2)};
  silo.bodies = {block<3>(silo.low, silo.high)};
  expect_filled(silo, 0.1, 2);

  Wall<3> oblique = cylinder<3>(true, {{0, 0, 0}}, 0.43, 2);
  oblique.direction = {{0.6, 0, 0.8}};
  silo.walls = {oblique};
  EXPECT_CONTAINS(message_of<UsageError>([&] { fill(silo, 0.1, 2); }), "must be x, across or up");
}

TEST(Fill, Boxes2d) {
  Geometry<2> g;
  g.low = {{-1, -1}};
  g.high = {{1, 1}};
  g.walls = {box<2>(true, {{0.013, 0.02}}, {{0.5, 0.3}})};
  g.bodies = {block<2>(g.low, {{1, 0.2}})};
  GeometryPoints<2> points = expect_rules(g, 0.1, 2);
  expect_no_holes(g, points, 0.1);
  // At each corner one point, 1.5 sqrt(2) dx away, is farther than 2 dx.
  EXPECT_EQ(points.walls.size(), 14u * 10 - 10 * 6 - 4);
  for (const Vec<2>& x : points.walls)
    EXPECT_LE(g.walls[0].distance(x), -0.05 + 1e-12);  // dx/2 from the faces

  g.walls[0] = box<2>(false, {{0.013, 0.02}}, {{0.5, 0.3}});
  points = expect_rules(g, 0.1, 2);
  EXPECT_EQ(points.walls.size(), 10u * 6 - 6 * 2);

  // Thinner than the layers, on a floor, and not a multiple of dx: 0.23 m are two rows.
  g.low = {{-1, 0}};
  g.walls = {plane<2>({{0, 0}}, {{0, 1}}), box<2>(false, {{0, 0.2}}, {{0.115, 0.2}})};
  g.bodies = {block<2>(g.low, g.high)};
  points = expect_rules(g, 0.1, 3);
  EXPECT_EQ(count_of(points, 1), 2u * 4);
}

TEST(Fill, Boxes3d) {
  Geometry<3> g;
  g.low = {{-1, -1, -1}};
  g.high = {{1, 1, 1}};
  g.walls = {box<3>(true, {{0, 0, 0}}, {{0.5, 0.3, 0.4}})};
  g.bodies = {block<3>(g.low, {{1, 1, 0}})};
  GeometryPoints<3> points = expect_rules(g, 0.1, 2);
  expect_no_holes(g, points, 0.1);
  // The same along the edges, and at a corner the four of eight points that are 1.5 dx away in two
  // directions.
  EXPECT_EQ(points.walls.size(), 14u * 10 * 12 - 10 * 6 * 8 - 4 * (10 + 6 + 8) - 8 * 4);
  g.walls[0].inside = false;
  points = expect_rules(g, 0.1, 2);
  EXPECT_EQ(points.walls.size(), 10u * 6 * 8 - 6 * 2 * 4);

  Geometry<3> weir;  // a ridge all across a periodic domain has no ends
  weir.high = {{1, 0.5, 1}};
  weir.periodic[1] = true;
  weir.walls = {box<3>(false, {{0.5, 0.25, 0.2}}, {{0.3, std::numeric_limits<double>::infinity(), 0.2}})};
  weir.bodies = {block<3>(weir.low, weir.high)};
  points = expect_rules(weir, 0.1, 1);
  expect_no_holes(weir, points, 0.1);
  EXPECT_EQ(points.walls.size(), 5u * (6 * 4 - 4 * 2));
}

TEST(Fill, SeveralBodies) {
  Geometry<2> g;
  g.high = {{1, 1}};
  g.walls = {plane<2>({{0, 0}}, {{0, 1}})};
  g.bodies = {block<2>({{0, 0}}, {{0.5, 0.5}}), block<2>({{0.3, 0}}, {{0.8, 0.5}})};
  const GeometryPoints<2> points = expect_rules(g, 0.1, 1);
  EXPECT_EQ(std::count(points.body.begin(), points.body.end(), 0u), 25);
  EXPECT_EQ(std::count(points.body.begin(), points.body.end(), 1u), 15);  // the overlap belongs to the first
  g.bodies[1] = block<2>({{0.1, 0}}, {{0.3, 0.5}});
  g.bodies[1].name = "hidden";
  EXPECT_CONTAINS(message_of<UsageError>([&] { fill(g, 0.1, 1); }), "[body.hidden] holds no particle");
  g.bodies.pop_back();
  g.walls.push_back(plane<2>({{0, -3}}, {{0, 1}}));
  g.walls.back().name = "far";
  EXPECT_CONTAINS(message_of<UsageError>([&] { fill(g, 0.1, 1); }), "[wall.far] has no particle");
  g.walls.back() = g.walls.front();
  g.walls.back().name = "twice";
  EXPECT_CONTAINS(message_of<UsageError>([&] { fill(g, 0.1, 1); }), "[wall.twice] has no particle");
}

// ---- the case file

constexpr const char* domain2 = "[domain]\nlow = [\"0 m\", \"0 m\"]\nhigh = [\"2 m\", \"1 m\"]\n";
constexpr const char* domain3 =
    "[domain]\nlow = [\"0 m\", \"0 m\", \"0 m\"]\nhigh = [\"2 m\", \"1 m\", \"1 m\"]\n";
constexpr const char* body2 =
    "[body.sand]\nshape = \"box\"\nlow = [\"0 m\", \"0 m\"]\nhigh = [\"1 m\", \"0.5 m\"]\n";
constexpr const char* body3 =
    "[body.sand]\nshape = \"box\"\nlow = [\"0 m\", \"0 m\", \"0 m\"]\nhigh = [\"1 m\", \"1 m\", \"0.5 m\"]\n";

template <int Dim>
Geometry<Dim> read(const std::string& text) {
  const CaseFile file = CaseFile::parse(text, "case.toml");
  file.validate(geometry_tables());
  return read_geometry<Dim>(file);
}

TEST(ReadGeometry, EveryKeyInSi) {
  const Geometry<2> g = read<2>(std::string(domain2) + R"(periodic = "x"
[wall.lid]
shape = "plane"
point = ["0 cm", "90 cm"]
normal = [0, -3]
velocity = ["2 m/s", "-1 cm/s"]
surface = "smooth"
[wall.floor]
shape = "plane"
point = ["0 m", "0 m"]
normal = [0, 1]
basal_friction = 0.3
[wall.mill]
shape = "cylinder"
side = "outside"
point = ["1 m", "50 cm"]
radius = "5 cm"
angular_velocity = "30 rpm"
[body.left]
shape = "heap"
low = ["0.5 m", "0 m"]
high = ["0.5 m", "0.4 m"]
angle = "30 deg"
both_sides = true
)" + body2);
  EXPECT_EQ(g.high.c, (std::array<double, 2>{2, 1}));
  EXPECT_EQ(g.periodic, (std::array<bool, 2>{true, false}));
  ASSERT_EQ(g.walls.size(), 3u);  // in the order of the file: earlier walls come first in corners
  EXPECT_EQ(g.walls[0].name, "lid");
  EXPECT_EQ(g.walls[0].point[1], 0.9);
  EXPECT_EQ(g.walls[0].direction[1], -1);
  EXPECT_EQ(g.walls[0].velocity.c, (std::array<double, 2>{2, -0.01}));
  EXPECT_FALSE(g.walls[0].rough);
  EXPECT_EQ(g.walls[1].name, "floor");
  EXPECT_TRUE(g.walls[1].rough);
  EXPECT_EQ(g.walls[1].basal_friction, 0.3);
  EXPECT_EQ(g.walls[2].shape, WallShape::cylinder);
  EXPECT_FALSE(g.walls[2].inside);
  EXPECT_EQ(g.walls[2].radius, 0.05);
  EXPECT_NEAR(g.walls[2].omega, pi, 1e-15);
  EXPECT_TRUE(std::isnan(g.walls[2].basal_friction));
  ASSERT_EQ(g.bodies.size(), 2u);
  EXPECT_EQ(g.bodies[0].name, "left");
  EXPECT_NEAR(g.bodies[0].angle, pi / 6, 1e-15);
  EXPECT_TRUE(g.bodies[0].both_sides);
  EXPECT_EQ(g.bodies[1].shape, Body<2>::Shape::box);
}

TEST(ReadGeometry, In3d) {
  const Geometry<3> g = read<3>(std::string(domain3) + R"(periodic = "across"
[wall.drum]
shape = "cylinder"
side = "inside"
point = ["1 m", "0 m", "0.5 m"]
radius = "0.4 m"
[wall.ridge]
shape = "box"
side = "outside"
point = ["1 m", "0.5 m", "0.1 m"]
half = ["0.1 m", "0.5 m", "0.1 m"]
velocity = ["0 m/s", "1 m/s", "0 m/s"]
[body.pile]
shape = "cylinder"
low = ["1 m", "0.5 m", "0.2 m"]
high = ["1 m", "0.5 m", "0.4 m"]
radius = "10 cm"
)");
  EXPECT_EQ(g.periodic, (std::array<bool, 3>{false, true, false}));
  EXPECT_EQ(g.walls[0].direction.c, (std::array<double, 3>{0, 1, 0}));
  EXPECT_TRUE(g.walls[0].inside);
  EXPECT_TRUE(std::isinf(g.walls[1].half[1]));  // it fills the period and may slide along it
  EXPECT_EQ(g.walls[1].half[0], 0.1);
  EXPECT_EQ(g.bodies[0].radius, 0.1);
  EXPECT_EQ(g.bodies[0].shape, Body<3>::Shape::cylinder);
}

struct Refused {
  const char* what;
  int dimension;
  std::string text;
  std::vector<const char*> fragments;
};

TEST(ReadGeometry, EveryMistakeIsNamedWithItsPlace) {
  const std::string two = domain2, three = domain3;
  const std::string plane2 = "[wall.a]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]\nnormal = [0, 1]\n";
  const std::string plane3 =
      "[wall.a]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\", \"0 m\"]\nnormal = [0, 0, 1]\n";
  const std::string circle =
      "[wall.a]\nshape = \"cylinder\"\npoint = [\"1 m\", \"0.5 m\"]\nradius = \"0.2 m\"\n";
  const std::string box2 =
      "[wall.a]\nshape = \"box\"\npoint = [\"1 m\", \"0.5 m\"]\nhalf = [\"0.2 m\", \"0.3 m\"]\n";
  const std::string x = "periodic = \"x\"\n";
  const std::string sand2 = "[body.a]\nlow = [\"0.5 m\", \"0 m\"]\nhigh = [\"0.5 m\", \"0.4 m\"]\n";
  const std::vector<Refused> list{
      {"no domain", 2, body2, {"[domain] lacks the required key \"low\""}},
      {"length of a list", 3, two + body3, {"case.toml:2: [domain] \"low\" must have 3 entries", "has 2"}},
      {"length of a list", 2, three + body2, {"case.toml:2: [domain] \"low\" must have 2 entries"}},
      {"empty domain",
       2,
       "[domain]\nlow = [\"0 m\", \"1 m\"]\nhigh = [\"2 m\", \"1 m\"]",
       {"case.toml:3: [domain] \"high\" must be above \"low\" along up"}},
      {"across in 2D", 2, two + "periodic = \"across\"", {"case.toml:4: [domain]", "needs three dimensions"}},
      {"no material", 2, two + plane2, {"there is no material"}},
      {"unknown key",
       2,
       two + plane2 + "norml = [0, 1]\n",
       {"case.toml:8: [wall.a]", "did you mean \"normal\"?"}},
      {"no normal",
       2,
       two + "[wall.a]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]",
       {"case.toml:5: [wall.a] lacks the key \"normal\"", "shape = \"plane\""}},
      {"zero normal",
       2,
       two + "[wall.a]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]\nnormal = [0, 0]",
       {"case.toml:7: [wall.a] \"normal\" must not be zero"}},
      {"short normal",
       3,
       three + "[wall.a]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\", \"0 m\"]\nnormal = [0, 1]",
       {"case.toml:7: [wall.a] \"normal\" must have 3 entries"}},
      {"leaning",
       2,
       two + x + "[wall.a]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]\nnormal = [0.1, 1]",
       {"case.toml:8: [wall.a]", "must not lean towards x"}},
      {"side of a plane",
       2,
       two + plane2 + "side = \"inside\"",
       {"case.toml:8: [wall.a] \"side\" changes nothing with shape = \"plane\""}},
      {"radius of a plane",
       2,
       two + plane2 + "radius = \"1 m\"",
       {"case.toml:8: [wall.a] \"radius\" changes nothing"}},
      {"friction of a smooth wall",
       2,
       two + plane2 + "surface = \"smooth\"\nbasal_friction = 0.2",
       {"case.toml:9: [wall.a] \"basal_friction\" changes nothing", "surface = \"smooth\""}},
      {"no side", 2, two + circle, {"case.toml:5: [wall.a] lacks the key \"side\""}},
      {"axis in 2D",
       2,
       two + circle + "side = \"inside\"\naxis = \"up\"",
       {"[wall.a] \"axis\" changes nothing", "in 2D"}},
      {"oblique axis", 3, three + circle + "axis = \"xy\"", {"[wall.a] unknown axis \"xy\""}},
      {"normal of a circle",
       2,
       two + circle + "side = \"inside\"\nnormal = [1, 0]",
       {"\"normal\" changes nothing"}},
      {"no half",
       2,
       two + "[wall.a]\nshape = \"box\"\nside = \"inside\"\npoint = [\"1 m\", \"0 m\"]",
       {"case.toml:5: [wall.a] lacks the key \"half\""}},
      {"flat box",
       2,
       two + "[wall.a]\nshape = \"box\"\nside = \"inside\"\npoint = [\"1 m\", \"0 m\"]\nhalf = [\"1 m\", \"0 "
             "m\"]",
       {"case.toml:8: [wall.a] \"half\" = 0 m"}},
      {"rotating box",
       2,
       two + box2 + "side = \"outside\"\nangular_velocity = \"1 rad/s\"",
       {"case.toml:9: [wall.a]", "cannot rotate"}},
      {"rotating plane",
       3,
       three + plane3 + "angular_velocity = \"1 rad/s\"",
       {"case.toml:8: [wall.a]", "a plane cannot rotate in 3D"}},
      {"rotating plane, periodic",
       2,
       two + x + plane2 + "angular_velocity = \"1 rad/s\"",
       {"case.toml:9: [wall.a]", "cannot rotate in a periodic domain"}},
      {"angular velocity without time",
       2,
       two + circle + "side = \"inside\"\nangular_velocity = \"1 rad\"",
       {"case.toml:9: [wall.a] \"angular_velocity\"", "\"1 rad/s\""}},
      {"container in a periodic direction",
       2,
       two + x + circle + "side = \"inside\"",
       {"case.toml:9: [wall.a]", "cannot close the domain along x"}},
      {"obstacle over the border",
       2,
       two + x +
           "[wall.a]\nshape = \"cylinder\"\npoint = [\"0.1 m\", \"0.5 m\"]\nradius = \"0.2 m\"\nside = "
           "\"outside\"",
       {"case.toml:7: [wall.a]", "within the domain along x"}},
      {"obstacle that leaves",
       2,
       two + x + circle + "side = \"outside\"\nvelocity = [\"1 m/s\", \"0 m/s\"]",
       {"case.toml:10: [wall.a]", "would leave the domain along x"}},
      {"velocity too long",
       2,
       two + plane2 + "velocity = [\"1 m/s\", \"0 m/s\", \"0 m/s\"]",
       {"case.toml:8: [wall.a] \"velocity\" must have 2 entries"}},
      {"box upside down",
       2,
       two + "[body.a]\nshape = \"box\"\nlow = [\"0 m\", \"0.5 m\"]\nhigh = [\"1 m\", \"0.5 m\"]",
       {"case.toml:7: [body.a] \"high\" must be above \"low\" along up"}},
      {"out of the domain",
       2,
       two + "[body.a]\nshape = \"box\"\nlow = [\"0 m\", \"0 m\"]\nhigh = [\"3 m\", \"0.5 m\"]",
       {"case.toml:7: [body.a] the body reaches out of the domain along x"}},
      {"cylinder in 2D",
       2,
       two + sand2 + "shape = \"cylinder\"",
       {"case.toml:7: [body.a]", "three dimensions"}},
      {"no angle", 2, two + sand2 + "shape = \"heap\"", {"case.toml:7: [body.a] lacks the key \"angle\""}},
      {"flat heap", 2, two + sand2 + "shape = \"heap\"\nangle = \"0 deg\"", {"\"angle\" = 0 rad is outside"}},
      {"oblique heap",
       2,
       two + "[body.a]\nshape = \"heap\"\nangle = \"20 deg\"\nlow = [\"0 m\", \"0 m\"]\nhigh = [\"1 m\", "
             "\"0.5 m\"]",
       {"case.toml:8: [body.a]", "right above \"low\": the same x"}},
      {"angle of a box",
       2,
       two + body2 + "angle = \"20 deg\"",
       {"case.toml:8: [body.sand] \"angle\" changes nothing"}},
      {"both sides of a cone",
       3,
       three + "[body.a]\nshape = \"heap\"\nangle = \"20 deg\"\nlow = [\"1 m\", \"0.5 m\", \"0 m\"]\n"
               "high = [\"1 m\", \"0.5 m\", \"0.2 m\"]\nboth_sides = true",
       {"case.toml:9: [body.a] \"both_sides\" changes nothing with shape = \"heap\" in 3D"}},
      {"misspelt section",
       2,
       two + "[wal.a]\nx = 1",
       {"case.toml:4: unknown section [wal]", "did you mean [wall]?"}},
      {"section in a wall",
       2,
       two + plane2 + "[wall.a.b]\nx = 1",
       {"case.toml:8: unknown section [wall.a.b]"}},
  };
  for (const Refused& refused : list) {
    SCOPED_TRACE(refused.what);
    const std::string message = message_of<UsageError>([&] {
      if (refused.dimension == 2)
        read<2>(refused.text);
      else
        read<3>(refused.text);
    });
    for (const char* fragment : refused.fragments) EXPECT_CONTAINS(message, fragment);
  }
}

}  // namespace
}  // namespace dem2sph
