// Grains for tests of decks: 1 mm, Hertz, friction 0.5.
#pragma once

#include "dem_bridge/deck.hpp"

namespace dem2sph::bridge {

inline GrainMaterial hertz_grains(double youngs_modulus) {
  return {.d = 1e-3,
          .size_spread = 0.2,
          .rho_s = 2500,
          .grain_friction = 0.5,
          .restitution = 0.5,
          .contact = ContactModel::hertz,
          .youngs_modulus = youngs_modulus,
          .poisson_ratio = 0.3,
          .stiffness = 0};
}

}  // namespace dem2sph::bridge
