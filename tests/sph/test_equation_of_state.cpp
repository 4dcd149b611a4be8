// Eq. 5.5: density and pressure are inverse, K_a is rho dp/drho, and the energy's derivative is p/rho^2.
#include <gtest/gtest.h>

#include "sph/equation_of_state.hpp"

namespace dem2sph {
namespace {

TEST(EquationOfState, DensityInvertsPressure) {
  for (const double gamma : {1.0, 2.0, 7.0}) {
    const EquationOfState eos{1e6, gamma, 1500};
    // p is a difference of numbers near one times K/gamma: relative error of the density about eps.
    for (const double p : {0.0, 1.0, 1e3, 1e5})
      EXPECT_NEAR(eos.pressure(eos.density(p)), p, 1e-15 * 1e6 * 10 + 1e-12 * p);
  }
}

TEST(EquationOfState, NeverTensile) {
  const EquationOfState eos{1e6, 7, 1500};
  EXPECT_EQ(eos.pressure(1400), 0);
  EXPECT_EQ(eos.pressure(1500), 0);
  EXPECT_GT(eos.pressure(1501), 0);
}

TEST(EquationOfState, DerivativesAgree) {
  for (const double gamma : {1.0, 2.0, 7.0}) {
    const EquationOfState eos{1e6, gamma, 1500};
    const double rho = 1530;
    const double e = 1e-3;  // central differences: relative error (e/rho)^2 and eps rho/e, both below 1e-8
    EXPECT_NEAR(eos.bulk_modulus(rho), rho * (eos.pressure(rho + e) - eos.pressure(rho - e)) / (2 * e),
                1e-7 * 1e6);
    EXPECT_NEAR((eos.energy(rho + e) - eos.energy(rho - e)) / (2 * e), eos.pressure(rho) / (rho * rho),
                1e-6 * eos.pressure(rho) / (rho * rho));
  }
}

}  // namespace
}  // namespace dem2sph
