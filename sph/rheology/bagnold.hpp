// The exact steady flow of mu(I) down a rough incline (Bagnold's profile), the oracle of inclined flows.
//
// Everywhere tau/p = tan(theta), so I is the same at every depth: I = D*(tan(theta) - mu_l)/(mu_h -
// tan(theta)), and
//   u(z) = (2/3) (I/d) sqrt(phi g cos(theta)) [H^1.5 - (H - z)^1.5],   phi = rho/rho_s.
// At 25 deg with 0.38, 0.64, 0.279: I = 0.138. The depth average is 0.6 of the surface velocity.
#pragma once

#include <cmath>

#include "sph/rheology/yield.hpp"

namespace dem2sph {

struct Bagnold {
  double inertial_number = 0;
  double prefactor = 0;  ///< (2/3) (I/d) sqrt(phi g cos(theta)) [m^-0.5 s^-1]

  Bagnold(const RationalFriction<double>& law, const Grains& grains, double phi, double g, double theta)
      : inertial_number(law.D_star * (std::tan(theta) - law.mu_l) / (law.mu_h - std::tan(theta))),
        prefactor(2.0 / 3 * inertial_number / grains.d * std::sqrt(phi * g * std::cos(theta))) {}

  /// Velocity at the height z over the base of a flow of depth H, no slip [m/s].
  double velocity(double z, double H) const {
    return prefactor * (std::pow(H, 1.5) - std::pow(std::fmax(H - z, 0.0), 1.5));
  }
};

}  // namespace dem2sph
