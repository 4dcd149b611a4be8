// Kernels: they integrate to one, F is their derivative, and on a lattice they sum to the known floor.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sph/kernel.hpp"

namespace dem2sph {
namespace {

template <template <int> class Kernel, int Dim>
void integrates_to_one() {
  const double h = 0.7;
  const Kernel<Dim> kernel(h);
  // Midpoint rule in r with 20000 cells: its error is of order (2h/20000)^2, far below 1e-7.
  const int n = 20000;
  const double dr = kernel.support() / n;
  double sum = 0;
  for (int i = 0; i < n; ++i) {
    const double r = (i + 0.5) * dr;
    const double shell = Dim == 1 ? 2.0 : Dim == 2 ? 2 * std::numbers::pi * r : 4 * std::numbers::pi * r * r;
    sum += shell * kernel(r).w * dr;
  }
  EXPECT_NEAR(sum, 1, 1e-7);
  EXPECT_EQ(kernel(kernel.support()).w, 0);
  EXPECT_EQ(kernel(1.5 * kernel.support()).w, 0);
  EXPECT_EQ(kernel(1.5 * kernel.support()).f, 0);
}

template <template <int> class Kernel, int Dim>
void factor_is_derivative() {
  const Kernel<Dim> kernel(0.7);
  for (double r = 0.03; r < kernel.support(); r += 0.0517) {
    const double e = 1e-5;  // central difference: error about e^2 W''' and rounding 1e-16/e
    const double derivative = (kernel(r + e).w - kernel(r - e).w) / (2 * e);
    EXPECT_NEAR(kernel(r).f * r, derivative, 1e-7 * std::abs(kernel(0.0).w) / 0.7) << "r = " << r;
    EXPECT_LE(kernel(r).f, 0);
  }
}

TEST(Kernel, IntegratesToOne) {
  integrates_to_one<CubicSpline, 1>();
  integrates_to_one<CubicSpline, 2>();
  integrates_to_one<CubicSpline, 3>();
  integrates_to_one<WendlandC2, 1>();
  integrates_to_one<WendlandC2, 2>();
  integrates_to_one<WendlandC2, 3>();
  integrates_to_one<WendlandC4, 1>();
  integrates_to_one<WendlandC4, 2>();
  integrates_to_one<WendlandC4, 3>();
}

TEST(Kernel, FactorIsDerivative) {
  factor_is_derivative<CubicSpline, 1>();
  factor_is_derivative<CubicSpline, 2>();
  factor_is_derivative<CubicSpline, 3>();
  factor_is_derivative<WendlandC2, 1>();
  factor_is_derivative<WendlandC2, 2>();
  factor_is_derivative<WendlandC2, 3>();
  factor_is_derivative<WendlandC4, 1>();
  factor_is_derivative<WendlandC4, 2>();
  factor_is_derivative<WendlandC4, 3>();
}

// Sum of W over a square or cubic lattice of spacing 1, and the factor f of Eq. 5.21 on a linear field: the
// floor of every comparison at a fixed h/dx. Values to five digits, derived independently of this code.
template <template <int> class Kernel, int Dim>
void lattice_floor(double h, double expected_sum, double expected_factor) {
  const Kernel<Dim> kernel(h);
  const int reach = static_cast<int>(2 * h) + 1;
  double sum = 0;
  double factor = 0;
  for (int k = Dim == 3 ? -reach : 0; k <= (Dim == 3 ? reach : 0); ++k)
    for (int j = -reach; j <= reach; ++j)
      for (int i = -reach; i <= reach; ++i) {
        const double r = std::sqrt(i * i + j * j + k * k);
        sum += kernel(r).w;
        factor -= static_cast<double>(i * i) * kernel(r).f;  // sum over b of x (x_b - x_a) . F (x_a - x_b)
      }
  EXPECT_NEAR(sum, expected_sum, 1e-5);
  EXPECT_NEAR(factor, expected_factor, 1e-5);
}

TEST(Kernel, LatticeFloor) {
  lattice_floor<CubicSpline, 2>(1.2, 0.99976, 0.99079);
  lattice_floor<CubicSpline, 3>(1.2, 1.00081, 0.98169);
  lattice_floor<CubicSpline, 2>(1.5, 1.00344, 1.00672);
  lattice_floor<WendlandC2, 2>(1.2, 1.01795, 0.96385);
  lattice_floor<WendlandC2, 3>(1.2, 1.01746, 0.98523);
  lattice_floor<WendlandC2, 2>(1.5, 1.00514, 0.99740);
  lattice_floor<WendlandC2, 3>(1.5, 1.00314, 1.00062);
  lattice_floor<WendlandC4, 2>(1.2, 1.01311, 0.97764);
  lattice_floor<WendlandC4, 3>(1.5, 1.00290, 0.99324);
}

}  // namespace
}  // namespace dem2sph
