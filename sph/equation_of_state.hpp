// Eq. 5.5 (reconstructed): p = (K/gamma) ((rho/rho0)^gamma - 1), cut off in tension. gamma = 1 is the linear
// law.
#pragma once

#include <cmath>

#include "sph/base/pack.hpp"

namespace dem2sph {

struct EquationOfState {
  double K = 0;      ///< bulk modulus at rho0 [Pa]
  double gamma = 1;  ///< exponent
  double rho0 = 0;   ///< density at which the pressure vanishes [kg/m^3]
  double tension =
      0;  ///< tensile strength [Pa]: below p = -tension the material has come apart and p = 0.
          ///< With 0, p is never negative. No memory: brought together again, it bears tension again.

  double pressure(double rho) const { return pressure(rho, rho0); }
  /// Pressure [Pa] of a particle, or of several, with a rho0 of its own.
  template <class Real>
  Real pressure(const Real& rho, const Real& own_rho0) const {
    using std::pow;
    const Real ratio = rho / own_rho0;
    const Real p = gamma == 1 ? K * (ratio - 1) : K / gamma * (pow(ratio, gamma) - 1);
    return select(p < Real(-tension), Real(0), p);  // a NaN stays one
  }
  /// Density at which a pressure p >= -tension is reached.
  double density(double p) const {
    return gamma == 1 ? rho0 * (1 + p / K) : rho0 * std::pow(1 + gamma * p / K, 1 / gamma);
  }
  /// K_a = rho dp/drho; the speed of sound is sqrt(K_a/rho).
  double bulk_modulus(double rho) const { return bulk_modulus(rho, rho0); }
  double bulk_modulus(double rho, double own_rho0) const {
    const double ratio = rho / own_rho0;
    return gamma == 1 ? K * ratio : K * std::pow(ratio, gamma);
  }
  /// Energy of compression per mass from rho0 to rho [J/kg]: the integral of p/rho^2.
  double energy(double rho, double own_rho0) const {
    if (pressure(rho, own_rho0) == 0) return 0;
    const double r = rho / own_rho0;
    const double scale = K / (gamma * own_rho0);
    if (gamma == 1) return scale * (std::log(r) + 1 / r - 1);
    return scale * ((std::pow(r, gamma - 1) - 1) / (gamma - 1) + 1 / r - 1);
  }
  double energy(double rho) const { return energy(rho, rho0); }
  /// Energy per mass at p = -tension, where material comes apart [J/kg].
  double energy_in_tension(double own_rho0) const {
    return energy(density(-tension * (1 - 1e-12)) * own_rho0 / rho0, own_rho0);
  }
};

}  // namespace dem2sph
