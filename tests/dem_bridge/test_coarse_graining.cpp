// Coarse-graining against what is known exactly: kernels and line integrals against quadrature, a single
// contact, a lattice, a grain on a floor, and the balances of mass and momentum on random packings.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "dem_bridge/coarse_graining.hpp"
#include "dem_bridge/coarse_graining_frames.hpp"
#include "dem_bridge/contact_force.hpp"
#include "tests/base/helpers.hpp"
#include "tests/dem_bridge/packing.hpp"

namespace dem2sph::bridge {
namespace {

using dem2sph::test::message_of;
using test::Lattice;

constexpr double pi = std::numbers::pi;
constexpr std::array<KernelShape, 3> shapes{KernelShape::gauss, KernelShape::lucy, KernelShape::heaviside};
/// A Gauss kernel cut here ends at exp(-32) = 1e-14 of its height: smooth to rounding, so that sums over a
/// grid are its integrals.
constexpr double smooth_cut = 8;

const char* name(KernelShape shape) {
  return shape == KernelShape::gauss ? "Gauss" : shape == KernelShape::lucy ? "Lucy" : "Heaviside";
}

/// Integral from a to b by ten Gauss points in each of eight parts of each of 50 panels that halve towards a:
/// for functions that are smooth but at a.
double quadrature(const std::function<double(double)>& f, double a, double b) {
  constexpr std::array<double, 5> node{0.148874338981631211, 0.433395394129247191, 0.679409568299024406,
                                       0.865063366688984511, 0.973906528517171720};
  constexpr std::array<double, 5> weight{0.295524224714752870, 0.269266719309996355, 0.219086362515982044,
                                         0.149451349150580593, 0.066671344308688138};
  double sum = 0, end = 1;
  for (int panel = 0; panel < 50; ++panel) {
    const double start = panel == 49 ? 0 : 0.5 * end, half = (end - start) / 16;
    for (int part = 0; part < 8; ++part)
      for (std::size_t k = 0; k < 5; ++k)
        for (const double side : {-1.0, 1.0})
          sum += half * weight[k] * f(a + (b - a) * (start + half * (2 * part + 1 + side * node[k])));
    end = start;
  }
  return (b - a) * sum;
}

double unit_surface(int dimension) { return dimension == 1 ? 2 : dimension == 2 ? 2 * pi : 4 * pi; }

TEST(Kernel, IntegralIsOneAndVarianceIsKnown) {
  for (const KernelShape shape : shapes)
    for (int dimension = 1; dimension <= 3; ++dimension)
      for (const double cut : {1.0, 3.0, 8.0}) {
        const Kernel kernel(shape, dimension, 0.7, cut);
        const auto moment = [&](int power) {
          return quadrature(
              [&](double r) {
                return unit_surface(dimension) * std::pow(r, dimension - 1 + power) * kernel(r * r);
              },
              0, kernel.radius() * (1 - 1e-16));
        };
        // Ten points a panel leave rounding.
        EXPECT_NEAR(moment(0), 1, 1e-13) << name(shape) << dimension;
        EXPECT_NEAR(moment(2) / dimension, kernel.variance(), 1e-13) << name(shape) << dimension;
        EXPECT_EQ(kernel(kernel.radius() * kernel.radius()), 0);
      }
}

TEST(Kernel, KnownHeights) {
  const double c = 0.3;
  EXPECT_DOUBLE_EQ(Kernel(KernelShape::lucy, 1, c)(0), 5 / (4 * c));
  EXPECT_DOUBLE_EQ(Kernel(KernelShape::lucy, 2, c)(0), 5 / (pi * c * c));
  EXPECT_DOUBLE_EQ(Kernel(KernelShape::lucy, 3, c)(0), 105 / (16 * pi * c * c * c));
  EXPECT_DOUBLE_EQ(Kernel(KernelShape::heaviside, 3, c)(0), 3 / (4 * pi * c * c * c));
  // exp(-32) of difference to the whole Gauss function.
  EXPECT_NEAR(Kernel(KernelShape::gauss, 3, c, 8)(0) * std::pow(2 * pi, 1.5) * c * c * c, 1, 1e-11);
  EXPECT_NEAR(Kernel(KernelShape::gauss, 2, c, 8).variance(), c * c, 1e-12);
  // What the header says about the default cut.
  EXPECT_NEAR(std::sqrt(Kernel(KernelShape::gauss, 1, 1).variance()), 0.96, 0.005);
  EXPECT_NEAR(std::sqrt(Kernel(KernelShape::gauss, 3, 1).variance()), 0.92, 0.005);
}

TEST(Kernel, SlopeIsTheDerivative) {
  for (const KernelShape shape : {KernelShape::gauss, KernelShape::lucy})
    for (int dimension = 1; dimension <= 3; ++dimension) {
      const Kernel kernel(shape, dimension, 0.5);
      for (const double r : {0.05, 0.2, 0.4, 0.48}) {
        const double h = 1e-4;
        const auto at = [&](double x) { return kernel(x * x); };
        const double derivative = (8 * (at(r + h) - at(r - h)) - at(r + 2 * h) + at(r - 2 * h)) / (12 * h);
        // Fourth order: (h/c)^4 of the height over c, times some ten.
        EXPECT_NEAR(kernel.slope(r * r) * r, derivative, 1e-9 * kernel(0)) << name(shape) << dimension;
      }
    }
}

TEST(Kernel, RefusesNonsense) {
  EXPECT_CONTAINS(message_of<UsageError>([] { Kernel(KernelShape::lucy, 4, 1); }), "4 dimensions");
  EXPECT_CONTAINS(message_of<UsageError>([] { Kernel(KernelShape::lucy, 3, 0); }), "must be positive");
  EXPECT_CONTAINS(message_of<UsageError>([] { Kernel(KernelShape::gauss, 3, 1, std::nan("")); }), "cut");
}

/// int_0^1 phi(u + s b) ds from the kernel's values only, split where it is not smooth.
double line_by_quadrature(const Kernel& kernel, const Vec<3>& u, const Vec<3>& b) {
  const double bb = dot(b, b);
  const double foot = -dot(u, b) / bb;
  const Vec<3> h = u + foot * b;
  const double c = kernel.radius();
  if (dot(h, h) >= c * c) return 0;
  const double half = std::sqrt((c * c - dot(h, h)) / bb);
  const auto at = [&](double s) {
    const Vec<3> x = u + s * b;
    return kernel(dot(x, x));
  };
  double sum = 0;
  const double low = std::max(0.0, foot - half), high = std::min(1.0, foot + half);
  if (high <= low) return 0;
  const double middle = std::clamp(foot, low, high);
  if (high > middle) sum += quadrature(at, middle, high);
  if (middle > low) sum -= quadrature(at, middle, low);
  return sum;
}

/// Numbers from a fixed seed: the same packing every time.
class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double operator()(double low, double high) {
    return low + (high - low) * static_cast<double>(engine_()) / 4294967296.0;
  }
  Vec<3> vector(double low, double high) {
    Vec<3> v;
    for (int k = 0; k < 3; ++k) v[k] = (*this)(low, high);
    return v;
  }

 private:
  std::mt19937 engine_;
};

RC_GTEST_PROP(LineIntegral, AgreesWithQuadrature, ()) {
  Random random(*rc::gen::arbitrary<unsigned>());
  const KernelShape shape = shapes[*rc::gen::inRange<std::size_t>(0, 3)];
  const int dimension = *rc::gen::inRange(1, 4);
  const Kernel kernel(shape, dimension, shape == KernelShape::gauss ? 0.4 : 1.2);
  Vec<3> u, b;
  // Branches from a millionth of the kernel to ten times its size.
  const double length = std::pow(10.0, random(-6, 1));
  for (int k = 0; k < dimension; ++k) u[k] = random(-1.3, 1.3), b[k] = length * random(-1, 1);
  if (*rc::gen::inRange(0, 4) == 0) u = random(-1, 0) * b;  // passes through the centre
  // A hundred roundings, of terms up to eight times the height. Where the support's surface cuts a branch is
  // known to the rounding of coordinates, over the branch: a Heaviside kernel jumps there.
  double tolerance = 2e-14;
  if (shape == KernelShape::heaviside) tolerance += 2e-15 / norm(b);
  RC_ASSERT(std::abs(kernel.line_integral(u, b) - line_by_quadrature(kernel, u, b)) < tolerance * kernel(0));
}

RC_GTEST_PROP(LineIntegral, IsThatOfItsParts, ()) {
  Random random(*rc::gen::arbitrary<unsigned>());
  const KernelShape shape = shapes[*rc::gen::inRange<std::size_t>(0, 3)];
  const Kernel kernel(shape, 3, 0.8);
  const Vec<3> u = random.vector(-1, 1), b = random.vector(-2, 2);
  const double part = random(0.1, 0.9);
  const double sum = part * kernel.line_integral(u, part * b) +
                     (1 - part) * kernel.line_integral(u + part * b, (1 - part) * b);
  RC_ASSERT(std::abs(kernel.line_integral(u, b) - sum) < 1e-14 * kernel(0));
  // Along the other way.
  RC_ASSERT(std::abs(kernel.line_integral(u, b) - kernel.line_integral(u + b, -1 * b)) < 1e-14 * kernel(0));
}

/// Points at equal distances that cover a period, or a range with ends included.
Axis spread(int direction, double low, double length, std::size_t points, bool periodic = false) {
  return {direction, low, length / static_cast<double>(points), points, periodic ? length : 0};
}

Grid one_point(std::vector<int> directions, const Vec<3>& x, double unresolved = 1) {
  Grid grid;
  for (const int k : directions) grid.axes.push_back({k, x[k], 1, 1, 0});
  grid.unresolved = unresolved;
  return grid;
}

Fields fields_of(const Snapshot& snapshot, const Grid& grid, const Kernel& kernel) {
  Accumulator sums(grid, kernel,
                   kernel.has_gradient() ? Accumulator::Gradients::of_kernel : Accumulator::Gradients::none);
  sums.add(snapshot);
  return sums.fields();
}

TEST(OneContact, IntegralOfItsStressIsForceTimesBranch) {
  Snapshot snapshot;
  snapshot.interactions.push_back({{{0.1, -0.2, 0.15}}, {{0.7, 0.2, -0.5}}, {{2, -1, 0.5}}, false});
  const auto& contact = snapshot.interactions.front();
  for (int dimension = 1; dimension <= 3; ++dimension) {
    Grid grid;
    // Spacing 0.6 w: sums over a grid are integrals of a Gauss function to exp(-2 pi^2/0.36) = 1e-24.
    for (int k = 0; k < dimension; ++k) grid.axes.push_back(spread(k, -4.2, 8.4, 35));
    const Fields fields = fields_of(snapshot, grid, Kernel(KernelShape::gauss, dimension, 0.4, smooth_cut));
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        EXPECT_NEAR(integral(fields, [&](const FieldPoint& p) { return p.contact_stress(i, j); }),
                    contact.force[i] * contact.branch[j], 1e-13);
    EXPECT_NEAR(integral(fields, [](const FieldPoint& p) { return p.contact_density; }), 1, 1e-13);
    for (const FieldPoint& p : fields.points)
      if (p.contact_density > 0) {
        EXPECT_NEAR(p.fabric.trace(), 1, 1e-14);
      }
  }
  // Kernels that end at a finite distance leave an error of the grid: of second order in 3D for a ball of ten
  // spacings radius, measured 2e-4; Lucy's, being smooth, 2e-6.
  for (const auto& [shape, error] : {std::pair{KernelShape::lucy, 1e-5}, {KernelShape::heaviside, 2e-3}}) {
    Grid grid;
    for (int k = 0; k < 3; ++k) grid.axes.push_back(spread(k, -2.0, 4.0, 64));
    const Fields fields = fields_of(snapshot, grid, Kernel(shape, 3, 0.625));
    EXPECT_NEAR(integral(fields, [&](const FieldPoint& p) { return p.contact_stress(0, 0); }), 1.4,
                1.4 * error)
        << name(shape);
  }
}

constexpr double a = 1e-3;
GrainProperties properties(WallGrains walls = WallGrains::part_of_the_packing) {
  return {.rho_s = 2500, .grain_friction = 10, .cohesion = 0, .wall_grains = walls};
}

TEST(Lattice, StressIsForceOverAreaAtEveryPoint) {
  Lattice lattice;
  lattice.normal = 2e-3;
  lattice.tangential = 7e-4;
  lattice.strain = 0.3;
  const Snapshot snapshot = snapshot_of(lattice.frame(0), lattice.contacts(0), properties());
  // One bond crosses every height in every column, and kernels along a straight line add up to a constant:
  // wherever all lines reach beyond the support the stress is exact, not only on average.
  for (const KernelShape shape : shapes) {
    const Grid grid = grid_in(lattice.box(), {axis_between(2, 4 * a, 8 * a, 37)});
    const Fields fields =
        fields_of(snapshot, grid, Kernel(shape, 1, shape == KernelShape::gauss ? a : 3 * a));
    EXPECT_DOUBLE_EQ(grid.unresolved, 25 * a * a);
    for (const FieldPoint& p : fields.points) {
      EXPECT_NEAR(p.contact_stress(2, 2), 2e-3 / (a * a), 1e-9) << name(shape);
      EXPECT_NEAR(p.contact_stress(0, 2), -(7e-4 + 0.3 * 2e-3) / (a * a), 1e-9);
      EXPECT_NEAR(p.contact_stress(1, 1), 0, 1e-12);
      EXPECT_NEAR(p.contact_density * a * a * a, 1, 1e-12);
      EXPECT_NEAR(p.fabric(2, 2), 1 / (1 + 0.3 * 0.3), 1e-12);
      EXPECT_NEAR(norm(p.contact_divergence), 0, 1e-6);  // of terms of 2e-3 N/(a^2 a) = 2e6 Pa/m
    }
  }
}

TEST(Lattice, ThreeDimensionsSeeTheSameMean) {
  // In 3D the stress varies from bond to bond; its mean over one period of the lattice is f/a^2. The grid is
  // periodic in x and y, where images are needed: the box is 5 a wide, the support 12.8 a.
  Lattice lattice;
  lattice.layers = 30;
  lattice.normal = 2e-3;
  const Snapshot snapshot = snapshot_of(lattice.frame(0), lattice.contacts(0), properties());
  const Grid grid = grid_in(lattice.box(), {spread(0, 0, a, 2), spread(1, 0, a, 2), spread(2, 15 * a, a, 2)});
  const Fields fields = fields_of(snapshot, grid, Kernel(KernelShape::gauss, 3, 1.2 * a, smooth_cut));
  for (const FieldPoint& p : fields.points) {
    // What is left of the lattice at w = 1.2 a: exp(-2 pi^2 1.44) = 5e-13 of the mean.
    EXPECT_NEAR(p.contact_stress(2, 2) * a * a / 2e-3, 1, 1e-11);
    EXPECT_NEAR(p.phi, pi / 6, 1e-11);
    EXPECT_NEAR(p.rho, 2500 * pi / 6, 2500e-11);
    EXPECT_NEAR(p.coordination, 2, 1e-10);
  }
}

TEST(Lattice, ShearAppearsInTheKineticStressUnlessTakenOut) {
  Lattice lattice;
  lattice.gamma_dot = 30;
  lattice.opening = -4;
  const Snapshot snapshot = snapshot_of(lattice.frame(0), lattice.contacts(0), properties());
  // Five layers within a box of 5 a around the middle of the sixth: z of -2 to 2 a, mean square 2 a^2.
  const Fields box = fields_of(snapshot, one_point({2}, {{0, 0, 5.5 * a}}, 25 * a * a),
                               Kernel(KernelShape::heaviside, 1, 2.5 * a));
  const FieldPoint& p = box.points[0];
  EXPECT_NEAR(p.phi, pi / 6, 1e-14);
  EXPECT_NEAR(p.velocity[0], 30 * 5.5 * a, 1e-14);
  EXPECT_NEAR(p.fitted_gradient(0, 2), 30, 1e-11);
  EXPECT_NEAR(p.fitted_gradient(2, 2), -4, 1e-11);
  EXPECT_TRUE(std::isnan(p.velocity_gradient(0, 2))) << "a Heaviside kernel has none";
  EXPECT_NEAR(p.kinetic_stress(0, 0), p.rho * 900 * 2 * a * a, 1e-12);
  EXPECT_NEAR(p.kinetic_stress(0, 2), -p.rho * 120 * 2 * a * a, 1e-12);
  EXPECT_NEAR(p.kinetic_stress_beyond_shear(0, 0), 0, 1e-13);
  EXPECT_NEAR(p.temperature, (900 + 16) * 2 * a * a / 3, 1e-15);
  EXPECT_NEAR(p.temperature_beyond_shear, 0, 1e-17);
  // A wide smooth kernel sees a continuum: rho gamma_dot^2 times its variance, and the shear rate itself.
  lattice.layers = 24;
  const Snapshot thick = snapshot_of(lattice.frame(0), lattice.contacts(0), properties());
  const Kernel kernel(KernelShape::gauss, 1, 1.4 * a, smooth_cut);
  const Fields smooth = fields_of(thick, one_point({2}, {{0, 0, 11.7 * a}}, 25 * a * a), kernel);
  const FieldPoint& q = smooth.points[0];
  // exp(-2 pi^2 1.96) = 2e-17 is left of the lattice; exp(-32) of the cut, times (8 w)^2/w^2.
  EXPECT_NEAR(q.kinetic_stress(0, 0) / (q.rho * 900 * kernel.variance()), 1, 1e-11);
  EXPECT_NEAR(q.velocity_gradient(0, 2), 30, 1e-9);
  EXPECT_NEAR(q.velocity[0], 30 * 11.7 * a, 1e-12);
  EXPECT_NEAR(q.kinetic_stress_beyond_shear(0, 0) / q.kinetic_stress(0, 0), 0, 1e-13);
}

TEST(WallContact, AGrainOnAFloorIsInBalanceEverywhere) {
  // 1 mg under gravity on a floor 0.5 mm below its centre.
  const double mass = 1e-6, g = 9.81, r = 0.5e-3;
  Snapshot snapshot;
  snapshot.particles.push_back({{{0, 0, r}}, {}, mass, 1e-9, {}});
  snapshot.interactions.push_back({{{0, 0, r}}, {{0, 0, r}}, {{0, 0, mass * g}}, true});
  for (const KernelShape shape : shapes) {
    const Kernel kernel(shape, 1, 0.4e-3, smooth_cut);
    Grid grid;
    grid.axes = {spread(2, -4.1e-3, 8.4e-3, 350)};
    grid.unresolved = 4e-6;
    const Fields fields = fields_of(snapshot, grid, kernel);
    for (const FieldPoint& p : fields.points) {
      const double terms = mass * g * kernel(0) / grid.unresolved;
      EXPECT_NEAR(-p.contact_divergence[2] + p.wall_force[2] - p.rho * g, 0, 4e-15 * terms) << name(shape);
    }
    if (shape != KernelShape::gauss) continue;
    // The wall's pressure on 4 mm^2, and the virial f r.
    EXPECT_NEAR(integral(fields, [](const FieldPoint& p) { return p.wall_force[2]; }), mass * g, 1e-18);
    EXPECT_NEAR(integral(fields, [](const FieldPoint& p) { return p.contact_stress(2, 2); }), mass * g * r,
                1e-21);
    // Half a contact belongs to the wall, all of it to the grain.
    EXPECT_NEAR(integral(fields, [](const FieldPoint& p) { return p.contact_density; }), 0.5, 1e-13);
  }
}

/// Particles in a unit cell with forces between them and from walls.
struct Packing {
  Snapshot snapshot;
  std::vector<std::size_t> first, second;  ///< of each interaction; second = none for a wall
  static constexpr std::size_t none = static_cast<std::size_t>(-1);
  Vec<3> gravity{{1.5, -0.5, -9.81}};

  /// Total force on each particle, summed independently of the library.
  std::vector<Vec<3>> forces() const {
    std::vector<Vec<3>> f(snapshot.particles.size());
    for (std::size_t i = 0; i < f.size(); ++i) f[i] = snapshot.particles[i].mass * gravity;
    for (std::size_t k = 0; k < first.size(); ++k) {
      f[first[k]] += snapshot.interactions[k].force;
      if (second[k] != none) f[second[k]] -= snapshot.interactions[k].force;
    }
    return f;
  }

  /// After the time t under these forces, to second order: positions and velocities.
  Snapshot moved(double t) const {
    Snapshot s = snapshot;
    const std::vector<Vec<3>> f = forces();
    for (std::size_t i = 0; i < f.size(); ++i) {
      Particle& p = s.particles[i];
      p.x += t * p.v + 0.5 * t * t / p.mass * f[i];
      p.v += t / p.mass * f[i];
    }
    return s;
  }
};

Packing random_packing(unsigned seed, std::size_t n = 20) {
  Random random(seed);
  Packing packing;
  for (std::size_t i = 0; i < n; ++i)
    packing.snapshot.particles.push_back(
        {random.vector(0, 1), random.vector(-1, 1), random(0.5, 2), random(0.1, 0.3), {}});
  for (std::size_t k = 0; k < 3 * n; ++k) {
    const auto i = static_cast<std::size_t>(random(0, static_cast<double>(n)));
    const auto j = (i + 1 + static_cast<std::size_t>(random(0, static_cast<double>(n - 1)))) % n;
    const bool wall = k % 5 == 0;
    const Vec<3> x = packing.snapshot.particles[i].x;
    const Vec<3> branch = wall ? random.vector(-0.3, 0.3) : x - packing.snapshot.particles[j].x;
    packing.snapshot.interactions.push_back({x, branch, random.vector(-3, 3), wall});
    packing.first.push_back(i);
    packing.second.push_back(wall ? Packing::none : j);
  }
  return packing;
}

Grid some_grid(int dimension) {
  Grid grid;
  const std::array<std::vector<int>, 3> directions{{{2}, {0, 2}, {0, 1, 2}}};
  for (const int k : directions[static_cast<std::size_t>(dimension - 1)])
    grid.axes.push_back(spread(k, -0.31, 1.7, 7));
  grid.unresolved = dimension == 3 ? 1 : 0.7;
  return grid;
}

Kernel some_kernel(KernelShape shape, int dimension) {
  return Kernel(shape, dimension, shape == KernelShape::gauss ? 0.2 : 0.55);
}

TEST(Balance, MomentumClosesToRounding) {
  const Packing packing = random_packing(1);
  const std::vector<Vec<3>> force = packing.forces();
  for (const KernelShape shape : shapes)
    for (int dimension = 1; dimension <= 3; ++dimension) {
      const Grid grid = some_grid(dimension);
      const Kernel kernel = some_kernel(shape, dimension);
      const Fields fields = fields_of(packing.snapshot, grid, kernel);
      for (const FieldPoint& p : fields.points) {
        // d(rho V)/dt at fixed r, particle by particle.
        Vec<3> rate, balance = p.wall_force - p.contact_divergence + p.rho * packing.gravity;
        for (std::size_t i = 0; i < force.size(); ++i) {
          const Particle& q = packing.snapshot.particles[i];
          Vec<3> r;
          for (const Axis& axis : grid.axes) r[axis.direction] = p.x[axis.direction] - q.x[axis.direction];
          rate += kernel(dot(r, r)) / grid.unresolved * force[i];
          rate -= q.mass / grid.unresolved * kernel.slope(dot(r, r)) * dot(q.v, r) * q.v;
        }
        if (kernel.has_gradient()) balance -= p.flux_divergence;  // else both sides lack the flux
        // Some 60 terms of up to 10 times the kernel's height, each with a few roundings of 1e-16.
        const double terms = 10 * kernel(0) / grid.unresolved;
        for (int k = 0; k < 3; ++k)
          EXPECT_NEAR(balance[k], rate[k], 5e-14 * terms) << name(shape) << dimension;
      }
    }
}

TEST(Balance, DivergencesAreThoseOfTheFields) {
  // The divergences above come from the ends of the lines. Here the fields themselves are differentiated, to
  // eighth order: with steps of w/50, (1/50)^8 = 3e-14 times a ninth derivative of some 1e3.
  const Packing packing = random_packing(2);
  const double w = 0.2, h = w / 50;
  for (int dimension = 1; dimension <= 3; ++dimension) {
    const Kernel kernel(KernelShape::gauss, dimension, w, smooth_cut);
    std::vector<int> directions = dimension == 1   ? std::vector{2}
                                  : dimension == 2 ? std::vector{0, 2}
                                                   : std::vector{0, 1, 2};
    for (const Vec<3> x : {Vec<3>{{0.4, 0.6, 0.3}}, Vec<3>{{0.9, 0.1, -0.1}}}) {
      const auto at = [&](const Vec<3>& point) {
        return fields_of(packing.snapshot, one_point(directions, point), kernel).points[0];
      };
      const FieldPoint here = at(x);
      Vec<3> contact, flux;
      double mass = 0;
      Tensor gradient;
      for (const int j : directions)
        for (int step = -4; step <= 4; ++step) {
          constexpr std::array<double, 5> weight{0, 4.0 / 5, -1.0 / 5, 4.0 / 105, -1.0 / 280};
          if (step == 0) continue;
          const double c = (step > 0 ? 1 : -1) * weight[static_cast<std::size_t>(std::abs(step))] / h;
          Vec<3> point = x;
          point[j] += step * h;
          const FieldPoint p = at(point);
          mass += c * p.momentum[j];
          for (int i = 0; i < 3; ++i) {
            contact[i] += c * p.contact_stress(i, j);
            flux[i] += c * (p.kinetic_stress(i, j) + p.rho * p.velocity[i] * p.velocity[j]);
            gradient(i, j) += c * p.velocity[i];
          }
        }
      for (int i = 0; i < 3; ++i) {
        const double scale = 10 * kernel(0) / w;  // of a stress divergence: forces times branch, over w
        EXPECT_NEAR(contact[i], here.contact_divergence[i], 1e-11 * scale) << dimension;
        EXPECT_NEAR(flux[i], here.flux_divergence[i], 1e-11 * scale) << dimension;
        for (int j = 0; j < 3; ++j) EXPECT_NEAR(gradient(i, j), here.velocity_gradient(i, j), 1e-9);
      }
      EXPECT_NEAR(mass, here.momentum_gradient.trace(), 1e-11 * 10 * kernel(0) / w);
    }
  }
}

TEST(Balance, FieldsOfMovingParticlesFollowTheirBalances) {
  // Central differences in time between two frames: half the step, a quarter of the error.
  const Packing packing = random_packing(3);
  for (int dimension = 1; dimension <= 3; ++dimension) {
    const Kernel kernel(KernelShape::gauss, dimension, 0.2, smooth_cut);
    const Grid grid = some_grid(dimension);
    const Fields now = fields_of(packing.snapshot, grid, kernel);
    const auto error = [&](double dt) {
      const Fields before = fields_of(packing.moved(-dt), grid, kernel);
      const Fields after = fields_of(packing.moved(dt), grid, kernel);
      std::array<double, 2> largest{};
      for (std::size_t k = 0; k < now.points.size(); ++k) {
        const FieldPoint& p = now.points[k];
        const double mass = (after.points[k].rho - before.points[k].rho) / (2 * dt);
        largest[0] = std::max(largest[0], std::abs(mass + p.momentum_gradient.trace()));
        const Vec<3> rate = 1 / (2 * dt) * (after.points[k].momentum - before.points[k].momentum);
        const Vec<3> balance =
            p.wall_force - p.contact_divergence - p.flux_divergence + p.rho * packing.gravity;
        largest[1] = std::max(largest[1], norm(rate - balance));
      }
      return largest;
    };
    const auto coarse = error(2e-3), fine = error(1e-3);
    // The next order is (dt v/w)^2 = 1e-4 of the ratio, some hundred times that with forces of up to 30.
    EXPECT_NEAR(coarse[0] / fine[0], 4, 0.04) << dimension;
    EXPECT_NEAR(coarse[1] / fine[1], 4, 0.04) << dimension;
  }
}

TEST(Balance, TotalsAreThoseOfTheParticles) {
  // A cell that repeats in all directions, branches that cross its faces.
  Packing packing = random_packing(4, 30);
  Random random(5);
  for (Interaction& i : packing.snapshot.interactions) i.branch = random.vector(-0.4, 0.4);
  double mass = 0, volume = 0;
  Vec<3> momentum, wall;
  Tensor virial;
  Sym<3> flux;
  for (const Particle& p : packing.snapshot.particles) {
    mass += p.mass, volume += p.solid_volume;
    momentum += p.mass * p.v;
    for (int i = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j) flux(i, j) += p.mass * p.v[i] * p.v[j];
  }
  for (const Interaction& c : packing.snapshot.interactions) {
    if (c.wall) wall += c.force;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) virial(i, j) += c.force[i] * c.branch[j];
  }
  const std::array<std::vector<int>, 3> directions{{{2}, {0, 2}, {0, 1, 2}}};
  for (const std::vector<int>& resolved : directions) {
    Grid grid;
    for (const int k : resolved) grid.axes.push_back(spread(k, 0.123, 1, 16, true));
    // Spacing w/1.6: exp(-2 pi^2 2.56) = 1e-22.
    const Fields fields =
        fields_of(packing.snapshot, grid, Kernel(KernelShape::gauss, grid.dimension(), 0.1, smooth_cut));
    const auto total = [&](auto value) { return integral(fields, value); };
    EXPECT_NEAR(total([](const FieldPoint& p) { return p.rho; }) / mass, 1, 1e-13);
    EXPECT_NEAR(total([](const FieldPoint& p) { return p.phi; }) / volume, 1, 1e-13);
    EXPECT_NEAR(total([](const FieldPoint& p) { return p.number_density; }) / 30, 1, 1e-13);
    for (int i = 0; i < 3; ++i) {
      EXPECT_NEAR(total([&](const FieldPoint& p) { return p.momentum[i]; }), momentum[i], 1e-13 * mass);
      EXPECT_NEAR(total([&](const FieldPoint& p) { return p.wall_force[i]; }), wall[i], 1e-12);
      // Nothing leaves: divergences add up to the wall's force.
      EXPECT_NEAR(total([&](const FieldPoint& p) { return p.contact_divergence[i]; }), 0, 1e-11);
      for (int j = 0; j < 3; ++j) {
        EXPECT_NEAR(total([&](const FieldPoint& p) { return p.contact_stress(i, j); }), virial(i, j),
                    1e-13 * 100);
        EXPECT_NEAR(total([&](const FieldPoint& p) {
                      return p.kinetic_stress(i, j) + p.rho * p.velocity[i] * p.velocity[j];
                    }),
                    flux(i, j), 1e-13 * mass);
      }
    }
  }
}

TEST(Periodicity, ImagesAreThoseOfARepeatedPacking) {
  const Packing packing = random_packing(13);
  const double length = 1.1;
  Snapshot repeated;
  for (int n0 = -3; n0 <= 3; ++n0)
    for (int n2 = -3; n2 <= 3; ++n2) {
      const Vec<3> shift{{n0 * length, 0, n2 * length}};
      for (Particle p : packing.snapshot.particles) {
        p.x += shift;
        repeated.particles.push_back(p);
      }
      for (Interaction i : packing.snapshot.interactions) {
        i.from += shift;
        repeated.interactions.push_back(i);
      }
    }
  // A kernel as wide as the cell, points beyond both of its ends.
  for (const KernelShape shape : shapes) {
    const Kernel kernel(shape, 2, shape == KernelShape::gauss ? 0.36 : 1.1);
    Grid grid;
    grid.axes = {{0, -0.6, 0.37, 5, 0}, {2, -0.5, 0.41, 5, 0}};
    const Fields all = fields_of(repeated, grid, kernel);
    for (Axis& axis : grid.axes) axis.period = length;
    const Fields images = fields_of(packing.snapshot, grid, kernel);
    for (std::size_t k = 0; k < all.points.size(); ++k) {
      const FieldPoint &p = all.points[k], &q = images.points[k];
      EXPECT_NEAR(p.rho / q.rho, 1, 1e-13) << name(shape);
      EXPECT_NEAR(norm(p.velocity - q.velocity), 0, 1e-13);
      EXPECT_NEAR(norm(p.wall_force - q.wall_force), 0, 1e-11);
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          EXPECT_NEAR(p.contact_stress(i, j), q.contact_stress(i, j), 1e-11);
          EXPECT_NEAR(p.kinetic_stress(i, j), q.kinetic_stress(i, j), 1e-11);
        }
    }
  }
}

/// All numbers of a point, each beside the size that its error is measured by.
void expect_same(const FieldPoint& p, const FieldPoint& q, const Kernel& kernel, const Grid& grid) {
  // Sums of 20 to 60 terms of order 1 to 10 times the kernel's height.
  const double unit = 1e-13 * 10 * kernel(0) / grid.unresolved;
  EXPECT_NEAR(p.rho, q.rho, unit);
  EXPECT_NEAR(p.phi, q.phi, unit);
  for (int i = 0; i < 3; ++i) {
    EXPECT_NEAR(p.wall_force[i], q.wall_force[i], unit);
    for (int j = 0; j < 3; ++j) {
      EXPECT_NEAR(p.contact_stress(i, j), q.contact_stress(i, j), unit);
      EXPECT_NEAR(p.kinetic_stress(i, j), q.kinetic_stress(i, j), unit);
      // The fit divides by the particles' extent, which may be as small as 1e-5 of the kernel: 2 sqrt(1e10)
      // times the rounding of 1e-16.
      EXPECT_NEAR(p.kinetic_stress_beyond_shear(i, j), q.kinetic_stress_beyond_shear(i, j), 200 * unit);
      if (!(p.rho > 0.1)) continue;  // at the rim of a kernel one divides by next to nothing
      EXPECT_NEAR(p.velocity_gradient(i, j), q.velocity_gradient(i, j), 1e-10);
    }
  }
}

TEST(Symmetry, TheOrderOfParticlesDoesNotMatter) {
  const Packing packing = random_packing(6);
  Snapshot shuffled = packing.snapshot;
  std::reverse(shuffled.particles.begin(), shuffled.particles.end());
  std::mt19937 engine(7);
  std::shuffle(shuffled.interactions.begin(), shuffled.interactions.end(), engine);
  // A contact seen from its other end is the same contact.
  for (Interaction& i : shuffled.interactions) {
    if (i.wall) continue;
    i.from -= i.branch;
    i.branch *= -1;
    i.force *= -1;
  }
  for (int dimension = 1; dimension <= 3; ++dimension) {
    const Kernel kernel = some_kernel(KernelShape::lucy, dimension);
    const Grid grid = some_grid(dimension);
    const Fields one = fields_of(packing.snapshot, grid, kernel), two = fields_of(shuffled, grid, kernel);
    for (std::size_t k = 0; k < one.points.size(); ++k)
      expect_same(one.points[k], two.points[k], kernel, grid);
  }
}

TEST(Symmetry, AMovingObserverSeesTheSame) {
  const Packing packing = random_packing(8);
  const Vec<3> wind{{1000, -500, 200}};
  Snapshot carried = packing.snapshot;
  for (Particle& p : carried.particles) p.v += wind;
  for (int dimension = 1; dimension <= 3; ++dimension) {
    const Kernel kernel = some_kernel(KernelShape::gauss, dimension);
    const Grid grid = some_grid(dimension);
    const Fields one = fields_of(packing.snapshot, grid, kernel), two = fields_of(carried, grid, kernel);
    for (std::size_t k = 0; k < one.points.size(); ++k) {
      FieldPoint q = two.points[k];
      if (q.rho > 0) {
        EXPECT_NEAR(norm(q.velocity - one.points[k].velocity - wind), 0, 1e-11);
      }
      // The velocities themselves have lost three digits by the addition of 1000; the sums lose no more.
      const double unit = 1e-12 * 10 * kernel(0) / grid.unresolved;
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
          EXPECT_NEAR(q.kinetic_stress(i, j), one.points[k].kinetic_stress(i, j), unit);
      q.kinetic_stress = one.points[k].kinetic_stress;
      q.kinetic_stress_beyond_shear = one.points[k].kinetic_stress_beyond_shear;
      if (q.rho > 0.1) expect_same(q, one.points[k], kernel, grid);
    }
  }
}

TEST(Symmetry, TensorsTurnWithThePacking) {
  const Packing packing = random_packing(9);
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -0.5).normalized()).matrix();
  const auto turned = [&](const Vec<3>& v) {
    const Eigen::Vector3d w = turn * Eigen::Vector3d(v[0], v[1], v[2]);
    return Vec<3>{{w[0], w[1], w[2]}};
  };
  Snapshot other = packing.snapshot;
  for (Particle& p : other.particles) p.x = turned(p.x), p.v = turned(p.v);
  for (Interaction& i : other.interactions)
    i.from = turned(i.from), i.branch = turned(i.branch), i.force = turned(i.force);
  const Vec<3> x{{0.4, 0.5, 0.6}};
  for (const KernelShape shape : shapes) {
    const Kernel kernel(shape, 3, shape == KernelShape::gauss ? 0.3 : 0.8);
    const FieldPoint p = fields_of(packing.snapshot, one_point({0, 1, 2}, x), kernel).points[0];
    const FieldPoint q = fields_of(other, one_point({0, 1, 2}, turned(x)), kernel).points[0];
    EXPECT_NEAR(p.rho, q.rho, 1e-13 * p.rho);
    const auto expect_turned = [&](const auto& of_p, const auto& of_q) {
      Eigen::Matrix3d m, n;
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) m(i, j) = of_p(i, j), n(i, j) = of_q(i, j);
      EXPECT_LT((turn * m * turn.transpose() - n).norm(), 1e-12 * (1 + m.norm())) << name(shape);
    };
    expect_turned(p.contact_stress, q.contact_stress);
    expect_turned(p.kinetic_stress, q.kinetic_stress);
    expect_turned(p.kinetic_stress_beyond_shear, q.kinetic_stress_beyond_shear);
    expect_turned(p.fabric, q.fabric);
    expect_turned(p.fitted_gradient, q.fitted_gradient);
    if (kernel.has_gradient()) expect_turned(p.velocity_gradient, q.velocity_gradient);
  }
}

TEST(Velocity, AffineMotionIsFittedByFewParticlesAndHasNoTemperature) {
  Packing packing = random_packing(10);
  Tensor l;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) l(i, j) = 3 * i - 2 * j + 0.5;
  for (Particle& p : packing.snapshot.particles)
    for (int i = 0; i < 3; ++i) {
      p.v[i] = 0.3 * i;
      for (int j = 0; j < 3; ++j) p.v[i] += l(i, j) * p.x[j];
    }
  for (const KernelShape shape : shapes) {
    const Kernel kernel(shape, 3, shape == KernelShape::gauss ? 0.3 : 0.8);
    const FieldPoint p =
        fields_of(packing.snapshot, one_point({0, 1, 2}, {{0.4, 0.5, 0.6}}), kernel).points[0];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) EXPECT_NEAR(p.fitted_gradient(i, j), l(i, j), 1e-11) << name(shape);
    EXPECT_GT(p.temperature, 1);
    EXPECT_NEAR(p.temperature_beyond_shear, 0, 1e-12);
  }
  // One particle has no gradient: nothing is fitted, nothing divided by zero.
  Snapshot single;
  single.particles.push_back(packing.snapshot.particles[0]);
  const Vec<3> x = single.particles[0].x;
  const FieldPoint p = fields_of(single, one_point({0, 1, 2}, x), Kernel(KernelShape::lucy, 3, 1)).points[0];
  EXPECT_EQ(p.fitted_gradient(0, 0), 0);
  EXPECT_EQ(p.temperature, 0);
}

TEST(Time, AveragesComeBeforeVelocitiesAndFluctuations) {
  Snapshot slow, fast;
  slow.particles.push_back({{{0, 0, 0}}, {{1, 0, 0}}, 1, 1, {}});
  fast.particles.push_back({{{0, 0, 0}}, {{4, 0, 0}}, 2, 1, {}});
  for (const KernelShape shape : shapes) {
    const Kernel window(shape, 1, 0.5);
    const Kernel kernel(KernelShape::lucy, 1, 1);
    Accumulator sums(one_point({2}, {}), kernel);
    const double a_weight = window(0.01), b_weight = window(0.04);
    sums.add(slow, a_weight);
    sums.add(fast, b_weight);
    sums.add(fast, window(9));  // beyond the window
    const Fields fields = sums.fields();
    EXPECT_EQ(fields.frames, 2U);
    const FieldPoint& p = fields.points[0];
    const double weight = a_weight + b_weight;
    const double rho = (a_weight * 1 + b_weight * 2) / weight * kernel(0);
    const double v = (a_weight * 1 + b_weight * 8) / (a_weight * 1 + b_weight * 2);
    EXPECT_NEAR(p.rho, rho, 1e-14);
    EXPECT_NEAR(p.velocity[0], v, 1e-14);
    const double fluctuation =
        (a_weight * (1 - v) * (1 - v) + b_weight * 2 * (4 - v) * (4 - v)) / weight * kernel(0);
    EXPECT_NEAR(p.kinetic_stress(0, 0), fluctuation, 1e-13);
  }
}

TEST(Time, AveragedFieldsObeyTheBalances) {
  // The mean of the rates of two frames is the rate of the mean: from the averaged fields alone.
  const Packing one = random_packing(11), two = random_packing(12);
  const Kernel kernel = some_kernel(KernelShape::gauss, 2);
  const Grid grid = some_grid(2);
  Accumulator sums(grid, kernel);
  sums.add(one.snapshot, 1);
  sums.add(two.snapshot, 3);
  const Fields mean = sums.fields(), first = fields_of(one.snapshot, grid, kernel),
               second = fields_of(two.snapshot, grid, kernel);
  for (std::size_t k = 0; k < mean.points.size(); ++k) {
    const FieldPoint &m = mean.points[k], &p = first.points[k], &q = second.points[k];
    for (int i = 0; i < 3; ++i) {
      EXPECT_NEAR(m.flux_divergence[i], 0.25 * p.flux_divergence[i] + 0.75 * q.flux_divergence[i], 1e-11);
      EXPECT_NEAR(m.contact_divergence[i], 0.25 * p.contact_divergence[i] + 0.75 * q.contact_divergence[i],
                  1e-11);
      if (!(p.rho > 0) || !(q.rho > 0)) continue;
      // The total flux of momentum is what is averaged, whatever V it is split by.
      const auto flux = [&](const FieldPoint& f) {
        return f.kinetic_stress(i, 2) + f.rho * f.velocity[i] * f.velocity[2];
      };
      EXPECT_NEAR(flux(m), 0.25 * flux(p) + 0.75 * flux(q), 1e-12);
    }
  }
}

TEST(Accumulator, RefusesWhatCannotBe) {
  const Kernel kernel(KernelShape::lucy, 1, 1);
  const Grid grid = one_point({2}, {});
  EXPECT_CONTAINS(message_of<UsageError>([&] { Accumulator(grid, Kernel(KernelShape::heaviside, 1, 1)); }),
                  "a Heaviside kernel has no gradient");
  EXPECT_CONTAINS(message_of<UsageError>([&] {
                    Accumulator(one_point({0, 2}, {}), kernel);
                  }),
                  "a grid of 2 axes and a kernel of 1");
  EXPECT_CONTAINS(message_of<UsageError>([&] {
                    Accumulator(one_point({2, 2}, {}), Kernel(KernelShape::lucy, 2, 1));
                  }),
                  "different ones of 0, 1, 2");
  Accumulator sums(grid, kernel);
  EXPECT_CONTAINS(message_of<UsageError>([&] { sums.fields(); }), "no frame was added");
  EXPECT_CONTAINS(message_of<UsageError>([&] { sums.add({}, std::nan("")); }), "weight of a frame is nan");
  Snapshot bad;
  bad.particles.push_back({{{0, 0, std::nan("")}}, {}, 1, 1, {}});
  EXPECT_CONTAINS(message_of<InputError>([&] { sums.add(bad); }), "not a number");
}

TEST(Accumulator, EmptySpaceHasNoVelocity) {
  const FieldPoint p = fields_of({}, one_point({2}, {}), Kernel(KernelShape::lucy, 1, 1)).points[0];
  EXPECT_EQ(p.rho, 0);
  EXPECT_EQ(p.stress()(2, 2), 0);
  EXPECT_TRUE(std::isnan(p.velocity[0]));
  EXPECT_TRUE(std::isnan(p.temperature));
}

TEST(InertialNumber, IsThatOfItsDefinition) {
  EXPECT_DOUBLE_EQ(inertial_number(-20, 1000, 1e-3, 2500), 20 * 1e-3 * std::sqrt(2.5));
  EXPECT_TRUE(std::isnan(inertial_number(1, 0, 1, 1)));
  EXPECT_TRUE(std::isnan(inertial_number(1, std::nan(""), 1, 1)));
  FieldPoint point;
  point.velocity_gradient(0, 2) = -20;
  point.contact_stress(2, 2) = 700, point.kinetic_stress(2, 2) = 200, point.particle_stress(2, 2) = 100;
  point.contact_stress(0, 0) = 500;
  EXPECT_DOUBLE_EQ(inertial_number(point, 2, 1e-3, 2500), 20 * 1e-3 * std::sqrt(2.5));
  point.velocity_gradient(0, 2) = std::nan("");
  EXPECT_TRUE(std::isnan(inertial_number(point, 2, 1e-3, 2500)));
}

TEST(Frames, ForcesEndAtCoulombsLimitAndWallsAtTheContact) {
  Lattice lattice;
  lattice.normal = 1e-3;
  lattice.tangential = 8e-4;
  GrainProperties p = properties(WallGrains::walls);
  p.grain_friction = 0.5;
  const Snapshot snapshot = snapshot_of(lattice.frame(0), lattice.contacts(0), p);
  EXPECT_EQ(snapshot.particles.size(), 250U);
  EXPECT_EQ(snapshot.interactions.size(), 275U);
  const Grid grid = grid_in(lattice.box(), {spread(2, -4 * a, 20 * a, 200)});
  const Fields fields = fields_of(snapshot, grid, Kernel(KernelShape::gauss, 1, 0.5 * a, smooth_cut));
  const FieldPoint& middle = fields.points[100];
  EXPECT_NEAR(middle.contact_stress(2, 2), 1e-3 / (a * a), 1e-9);
  EXPECT_NEAR(middle.contact_stress(0, 2), -5e-4 / (a * a), 1e-9);
  // Both walls press with f/a^2, against each other. The flow is 10 a thick, from contact to contact.
  const auto total = [&](auto value) { return integral(fields, value) / grid.unresolved; };
  EXPECT_NEAR(total([](const FieldPoint& f) { return f.wall_force[2]; }), 0, 1e-9);
  EXPECT_NEAR(total([&](const FieldPoint& f) { return f.x[2] < 6 * a ? f.wall_force[2] : 0; }),
              1e-3 / (a * a), 1e-9);
  EXPECT_NEAR(total([](const FieldPoint& f) { return f.contact_stress(2, 2); }), 1e-3 / (a * a) * 10 * a,
              1e-12);
  // Seen the other way round by the engine, they are the same.
  ContactFrame swapped = lattice.contacts(0);
  for (Contact& c : swapped.contacts) std::swap(c.first, c.second), c.force *= -1;
  const Fields other =
      fields_of(snapshot_of(lattice.frame(0), swapped, p), grid, Kernel(KernelShape::gauss, 1, 0.5 * a, 8));
  for (std::size_t k = 0; k < other.points.size(); ++k)
    EXPECT_NEAR(other.points[k].wall_force[2], fields.points[k].wall_force[2], 1e-6);
}

TEST(Frames, AContactIsInTheMiddleOfTheOverlap) {
  // Across the periodic face in x: a grain of radius 0.6 mm at 0.2 mm, a wall's grain of 0.4 mm at 4.3 mm
  // of 5.
  Lattice lattice;
  GrainFrame grains;
  grains.box = lattice.box();
  grains.grains = {{7, GrainType::flow, {{0.2e-3, 1e-3, 1e-3}}, {{1, 2, 3}}, 0.6e-3},
                   {9, GrainType::top_wall, {{4.3e-3, 1e-3, 1e-3}}, {}, 0.4e-3}};
  ContactFrame contacts;
  contacts.box = grains.box;
  contacts.contacts = {{9, 7, {{-2, -5, 0}}}};
  GrainProperties p = properties(WallGrains::walls);
  p.grain_friction = 0.5;
  const auto interaction = [&] { return snapshot_of(grains, contacts, p).interactions.at(0); };
  // 0.9 mm apart, overlapping by 0.1 mm: the grain's surface is 0.6 mm away, the contact 0.55 mm.
  EXPECT_NEAR(norm(interaction().branch - Vec<3>{{0.55e-3, 0, 0}}), 0, 1e-18);
  EXPECT_TRUE(interaction().wall);
  EXPECT_EQ(interaction().from[0], 0.2e-3);
  EXPECT_NEAR(norm(interaction().force - Vec<3>{{2, 1, 0}}), 0, 1e-14) << "cut back to 0.5 x 2 N";
  p.cohesion = 1e7;
  const double attraction = sjkr_attraction(0.4e-3, 0.6e-3, 0.9e-3, 1e7);
  EXPECT_NEAR(norm(interaction().force - Vec<3>{{2, 0.5 * (2 + attraction), 0}}), 0, 1e-14);
  EXPECT_GT(attraction, 0.1);
  p.wall_grains = WallGrains::part_of_the_packing;
  EXPECT_NEAR(norm(interaction().branch - Vec<3>{{-0.9e-3, 0, 0}}), 0, 1e-18);
  EXPECT_EQ(snapshot_of(grains, contacts, p).particles.size(), 2U);
  EXPECT_NEAR(snapshot_of(grains, contacts, p).particles[0].mass, 2500 * 4.0 / 3 * pi * 0.216e-9, 1e-20);
}

TEST(Frames, RefuseWhatDoesNotBelongTogether) {
  const Lattice lattice;
  EXPECT_CONTAINS(
      message_of<InputError>([&] { snapshot_of(lattice.frame(3), lattice.contacts(4), properties()); }),
      "grains of step 3 do not belong to contacts of step 4");
  ContactFrame stranger = lattice.contacts(3);
  stranger.contacts[0].second = 99999;
  EXPECT_CONTAINS(message_of<InputError>([&] { snapshot_of(lattice.frame(3), stranger, properties()); }),
                  "99999");
  EXPECT_CONTAINS(message_of<UsageError>([] { snapshot_of(Frame{}, {}); }), "their mass");
}

TEST(Frames, SphParticlesGoThroughTheSameSums) {
  // Plane strain, 60 x 60 particles of spacing 1 mm, rho 1500, sheared along x; the pressure falls with
  // height y. A row of walls must not count.
  Frame frame;
  const double dx = 1e-3, rho = 1500;
  std::vector<double> x, v, density, stress, kind;
  for (int j = -1; j < 60; ++j)
    for (int i = 0; i < 60; ++i) {
      const double px = (i + 0.5) * dx, y = (j + 0.5) * dx, p = 1000 - 9000 * y;
      x.insert(x.end(), {px, y, 0});
      v.insert(v.end(), {7 * y, 0, 0});
      density.push_back(rho);
      stress.insert(stress.end(), {-p, -p, -0.9 * p, 0.4 * p, 0, 0});
      kind.push_back(j < 0 ? 1 : 0);
    }
  frame.fields = {{"x", "m", 3, x},
                  {"v", "m/s", 3, v},
                  {"rho", "kg/m^3", 1, density},
                  {"stress", "Pa", 6, stress},
                  {"kind", "1", 1, kind}};
  const Snapshot snapshot = snapshot_of(frame, {.mass = rho * dx * dx, .rho_s = 2500});
  EXPECT_EQ(snapshot.particles.size(), 3600U);
  const double y = 0.0304;
  const FieldPoint p = fields_of(snapshot, one_point({0, 1}, {{0.0296, y, 0}}),
                                 Kernel(KernelShape::gauss, 2, 1.5 * dx, smooth_cut))
                           .points[0];
  // exp(-2 pi^2 2.25) = 5e-20 is left of the lattice; the cut leaves 64 exp(-32) = 1e-12.
  EXPECT_NEAR(p.rho / rho, 1, 1e-11);
  EXPECT_NEAR(p.phi, 0.6, 1e-11);
  EXPECT_NEAR(p.velocity[0], 7 * y, 1e-11);
  EXPECT_NEAR(p.velocity_gradient(0, 1), 7, 1e-9);
  const double pressure = 1000 - 9000 * y;
  EXPECT_NEAR(p.particle_stress(1, 1) / pressure, 1, 1e-11);
  EXPECT_NEAR(p.particle_stress(2, 2) / (0.9 * pressure), 1, 1e-11);
  EXPECT_NEAR(p.stress()(0, 1) / (-0.4 * pressure), 1, 1e-11) << "tau is -sigma_xy, as with grains";
  // Turned so that up is z: the same fields on the grid of a slab of grains.
  const Snapshot turned =
      snapshot_of(frame, {.mass = rho * dx * dx, .rho_s = 2500, .plane = PlaneStrain::in_x_and_z});
  const FieldPoint q = fields_of(turned, one_point({0, 2}, {{0.0296, 0, y}}),
                                 Kernel(KernelShape::gauss, 2, 1.5 * dx, smooth_cut))
                           .points[0];
  EXPECT_DOUBLE_EQ(q.rho, p.rho);
  EXPECT_DOUBLE_EQ(q.velocity_gradient(0, 2), p.velocity_gradient(0, 1));
  EXPECT_DOUBLE_EQ(q.stress()(2, 2), p.stress()(1, 1));
  EXPECT_DOUBLE_EQ(q.stress()(1, 1), p.stress()(2, 2));
  EXPECT_DOUBLE_EQ(q.stress()(0, 2), p.stress()(0, 1));
}

TEST(Frames, GrainsOfAFlowCarryTheirVolume) {
  Frame frame;
  frame.dimension = 3;
  frame.fields = {{"x", "m", 3, {1, 2, 3, 4, 5, 6}},
                  {"v", "m/s", 3, {0.1, 0.2, 0.3, 0.4, 0.5, 0.6}},
                  {"radius", "m", 1, {0.5, 0.25}}};
  const Snapshot snapshot = snapshot_of_grains(frame, 2500);
  ASSERT_EQ(snapshot.particles.size(), 2U);
  const Particle& p = snapshot.particles[1];
  EXPECT_EQ(p.x[2], 6);
  EXPECT_EQ(p.v[0], 0.4);
  EXPECT_DOUBLE_EQ(p.solid_volume, std::numbers::pi / 6 * 0.125);
  EXPECT_DOUBLE_EQ(p.mass, 2500 * std::numbers::pi / 6 * 0.125);
  EXPECT_EQ(p.stress_volume(0, 2), 0);
  // Tension positive in a frame, compression positive in a snapshot; xx yy zz xy xz yz.
  frame.fields.push_back({"stress", "Pa", 6, {1, 2, 3, 4, 5, 6, -70, -80, -90, 10, 11, 12}});
  const Snapshot stressed = snapshot_of_grains(frame, 2500);
  EXPECT_DOUBLE_EQ(stressed.particles[1].stress_volume(1, 1), 80 * p.solid_volume);
  EXPECT_DOUBLE_EQ(stressed.particles[1].stress_volume(0, 2), -11 * p.solid_volume);
  frame.fields.resize(2);
  EXPECT_THROW(snapshot_of_grains(frame, 2500), InputError) << "without radius there are no grains";
}

}  // namespace
}  // namespace dem2sph::bridge
