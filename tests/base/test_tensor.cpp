// Tensors on cases that one can do by hand; plane strain has the 3 of three dimensions in its deviator.
#include <gtest/gtest.h>

#include "sph/base/tensor.hpp"

namespace dem2sph {
namespace {

TEST(Tensor, SimpleShearHasItsGradientAsShearRate) {
  Gradient<2> l2;
  l2(0, 1) = 3;
  EXPECT_EQ(strain_rate(l2)(0, 1), 1.5);
  EXPECT_EQ(shear_rate(deviator(strain_rate(l2))), 3);
  // The same shear in each of the six planes and directions of 3D, and with a rotation, which changes
  // nothing.
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      if (i == j) continue;
      Gradient<3> l3;
      l3(i, j) = 3;
      l3(0, 1) += 7;
      l3(1, 0) -= 7;
      EXPECT_EQ(shear_rate(deviator(strain_rate(l3))), 3) << i << j;
    }
}

TEST(Tensor, TheDeviatorOfPlaneStrainHasAnOutOfPlanePart) {
  Gradient<2> l;
  l(0, 0) = 3;
  const Sym<2> d = deviator(strain_rate(l));
  EXPECT_EQ(d[0], 2);
  EXPECT_EQ(d[1], -1);
  EXPECT_EQ(d[2], -1);
  EXPECT_EQ(d.trace(), 0);
  EXPECT_EQ(l.trace(), 3);
  // 2 D':D' = 2 (4 + 1 + 1)
  EXPECT_EQ(shear_rate(d), std::sqrt(12.0));
  EXPECT_EQ(deviator(strain_rate(Gradient<3>{{3, 0, 0, 0, 0, 0, 0, 0, 0}}))[2], -1);
}

TEST(Tensor, EveryComponentHasItsOwnPlace) {
  Sym<3> s;
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) s(i, j) = 10 * i + j;
  EXPECT_EQ(s.c, (std::array<double, 6>{0, 11, 22, 1, 2, 12}));
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) EXPECT_EQ(s(i, j), s(j, i));
  // Off-diagonal components count twice: 0 + 121 + 484 + 2 (1 + 4 + 144)
  EXPECT_EQ(s.square(), 903);
  Sym<2> shear;
  shear(0, 1) = -5;
  EXPECT_EQ(equivalent_stress(shear), 5);
  shear *= 2;
  shear += shear;
  EXPECT_EQ(shear[3], -20);
}

TEST(Tensor, Vectors) {
  const Vec<2> a{{3, 4}};
  EXPECT_EQ(norm(a), 5);
  EXPECT_EQ(dot(a, 2.0 * a - a), 25);
  EXPECT_EQ((a + a)[1], 8);
}

}  // namespace
}  // namespace dem2sph
