// Eq. 5.5 (reconstructed): p = max(0, (K/gamma) ((rho/rho0)^gamma - 1)). gamma = 1 is the linear law.
#pragma once

#include <cmath>

namespace dem2sph {

struct EquationOfState {
  double K = 0;      ///< bulk modulus at rho0 [Pa]
  double gamma = 1;  ///< exponent
  double rho0 = 0;   ///< density at which the pressure vanishes [kg/m^3]

  /// Pressure [Pa], never tensile.
  double pressure(double rho) const {
    const double ratio = rho / rho0;
    const double p = gamma == 1 ? K * (ratio - 1) : K / gamma * (std::pow(ratio, gamma) - 1);
    return p < 0 ? 0 : p;  // a NaN stays one
  }
  /// Density at which a pressure p >= 0 is reached.
  double density(double p) const {
    return gamma == 1 ? rho0 * (1 + p / K) : rho0 * std::pow(1 + gamma * p / K, 1 / gamma);
  }
  /// K_a = rho dp/drho; the speed of sound is sqrt(K_a/rho).
  double bulk_modulus(double rho) const {
    const double ratio = rho / rho0;
    return gamma == 1 ? K * ratio : K * std::pow(ratio, gamma);
  }
  /// Energy of compression per mass from rho0 to rho [J/kg]: the integral of p/rho^2.
  double energy(double rho) const {
    if (rho <= rho0) return 0;
    const double r = rho / rho0;
    const double scale = K / (gamma * rho0);
    if (gamma == 1) return scale * (std::log(r) + 1 / r - 1);
    return scale * ((std::pow(r, gamma - 1) - 1) / (gamma - 1) + 1 / r - 1);
  }
};

}  // namespace dem2sph
