// The terms of the equations, one by one, on pairs and small lattices.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "sph/terms.hpp"

namespace dem2sph {
namespace {

template <int Dim>
Gradient<Dim> random_gradient(std::mt19937& random) {
  std::normal_distribution<double> normal;
  Gradient<Dim> l;
  for (double& c : l.c) c = normal(random);
  return l;
}

template <int Dim>
void rotation_keeps_invariants() {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 200; ++trial) {
    Sym<Dim> s;
    for (double& c : s.c) c = normal(random);
    const Gradient<Dim> l = random_gradient<Dim>(random);
    Sym<Dim> turned = s;
    for (int i = 0; i < 1000; ++i) turned = rotate(turned, l, 0.37);
    // 1000 orthogonal products: rounding adds up to about 1000 eps.
    EXPECT_NEAR(turned.square(), s.square(), 1e-11 * s.square());
    EXPECT_NEAR(turned.trace(), s.trace(), 1e-11 * std::sqrt(s.square()));
  }
}
TEST(Terms, RotationKeepsNormAndTrace) {
  rotation_keeps_invariants<2>();
  rotation_keeps_invariants<3>();
}

TEST(Terms, RotationTurnsTheRightWay) {
  // Solid rotation by the angle a, anticlockwise: L = omega [[0, -1], [1, 0]]. A stress along x turns towards
  // y: s' = Q s Q^T has s_xy = sin(a) cos(a) s_xx.
  Gradient<2> l;
  const double omega = 2;
  l(0, 1) = -omega;
  l(1, 0) = omega;
  Sym<2> s;
  s(0, 0) = 1;
  const int steps = 2000;
  const double angle = 0.5;
  for (int i = 0; i < steps; ++i) s = rotate(s, l, angle / omega / steps);
  // tan(a/2) = omega dt/2 per step: the angle is short by (omega dt)^2/12, 5e-9 here.
  EXPECT_NEAR(s(0, 0), std::cos(angle) * std::cos(angle), 1e-8);
  EXPECT_NEAR(s(0, 1), std::cos(angle) * std::sin(angle), 1e-8);
  EXPECT_NEAR(s(1, 1), std::sin(angle) * std::sin(angle), 1e-8);
}

TEST(Terms, PureStrainDoesNotRotate) {
  Gradient<2> l;
  l(0, 0) = 3;
  l(0, 1) = l(1, 0) = 0.4;
  Sym<2> s;
  s.c = {1, 2, 3, 4};
  const Sym<2> same = rotate(s, l, 0.1);
  for (int k = 0; k < 4; ++k) EXPECT_EQ(same[k], s[k]);
}

TEST(Terms, StressDivergenceIsAntisymmetric) {
  // m_a a_a = -m_b a_b: momentum is exchanged, not made.
  Pair<2> ab;
  ab.r.c = {0.3, -0.2};
  ab.f = -2;
  ab.grad_w = ab.f * ab.r;
  Pair<2> ba = ab;
  ba.r *= -1;
  ba.grad_w *= -1;
  Sym<2> sum;
  sum.c = {1, -2, 0.5, 0.7};
  Vec<2> on_a;
  Vec<2> on_b;
  const double m_a = 2;
  const double m_b = 3;
  add_stress_divergence(on_a, m_b, sum, ab.grad_w);
  add_stress_divergence(on_b, m_a, sum, ba.grad_w);
  for (int k = 0; k < 2; ++k) EXPECT_EQ(m_a * on_a[k], -m_b * on_b[k]);
}

TEST(Terms, PressurePushesApart) {
  Pair<2> ab;
  ab.r.c = {0.1, 0};
  ab.f = -1;
  ab.grad_w = ab.f * ab.r;
  const Sym<2> own = stress_over_density_squared(Sym<2>{}, 100.0, 1000.0);
  Vec<2> acceleration;
  add_stress_divergence(acceleration, 1.0, own, ab.grad_w);
  EXPECT_GT(acceleration[0], 0);  // a lies at larger x than b
}

TEST(Terms, DiffusionVanishesUnderHydrostaticPressure) {
  Pair<2> ab;
  ab.r.c = {0.02, 0.05};  // a lies 0.05 above b
  ab.f = -7;
  const double slope = -12;  // d(rho)/d(up)
  const double hydrostatic = hydrostatic_difference<2>(slope, ab);
  EXPECT_NEAR(hydrostatic, -slope * 0.05, 1e-15);
  EXPECT_EQ(density_diffusion<2>(hydrostatic - hydrostatic, 1.0, ab), 0);
  EXPECT_GT(density_diffusion<2>(1.0, 1.0, ab), 0);  // a denser neighbour raises rho_a
}

TEST(Terms, DampingActsOnApproachOnlyAndTakesEnergy) {
  Pair<2> ab;
  ab.r.c = {0.01, 0};
  ab.distance = 0.01;
  ab.f = -1;
  ab.grad_w = ab.f * ab.r;
  Vec<2> apart;
  apart.c = {1, 0};
  EXPECT_EQ(artificial_viscosity(0.1, 10, 0.01, 1000, apart, ab), 0);
  const Vec<2> together = -1.0 * apart;
  const double pi = artificial_viscosity(0.1, 10, 0.01, 1000, together, ab);
  EXPECT_GT(pi, 0);
  EXPECT_GT(pi * dot(together, ab.grad_w), 0);  // what `dissipated` adds up
}

TEST(Terms, BoundaryVelocityIsLinearThroughTheSurface) {
  const Vec<2> v{{2, 0}};
  const Vec<2> wall{{0.5, 0}};
  // d_b = d_a/2: v_b - v_wall = -(v_a - v_wall)/2.
  EXPECT_NEAR(boundary_velocity(v, wall, 0.02, 0.01, 1.5)[0], 0.5 - 0.75, 1e-15);
  // Limited by B_max = 1.5 when the interior particle is close to the wall, and finite at its surface.
  EXPECT_NEAR(boundary_velocity(v, wall, 0.001, 0.01, 1.5)[0], 0.5 - 0.75, 1e-15);
  EXPECT_NEAR(boundary_velocity(v, wall, 0.0, 0.01, 1.5)[0], 0.5 - 0.75, 1e-15);
}

}  // namespace
}  // namespace dem2sph
