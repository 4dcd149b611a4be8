// The longest stable step of a composition, from its equations linearised about an even lattice at rest.
//
// A plane wave of wave vector k on the lattice turns the sums over pairs into numbers: Eq. 5.21 into
// L = v (x) i g with g = -sum V F r sin(k.r), Eq. 5.20 into the divergence along the same g, artificial
// viscosity and density diffusion into a matrix and a rate. One step of Algorithm 1 is then a small matrix;
// it is stable while no eigenvalue of any k leaves the unit circle. Without damping that is dt < 2/omega_max
// with omega_max = sqrt((K + 4G/3)/rho) max |g|. README.md derives it.
#pragma once

#include "sph/setup.hpp"

namespace dem2sph {

struct StepLimit {
  double omega_max = 0;    ///< of the fastest wave without damping [1/s]
  double step = 0;         ///< longest stable step, damping and diffusion included [s]
  double sound_bound = 0;  ///< the first bound of Eq. 5.28, 0.25 h/c with the elastic wave's c [s]
};

/// Limit of the set-up's kernel, density, stress, damping and correction on its lattice, at zero pressure and
/// with nothing flowing. `viscosity` is eta of direct stress [Pa s] (0: none). Walls, shifting and velocity
/// averaging are not in it.
template <int Dim>
StepLimit linear_step_limit(const FlowSetup<Dim>& setup, double viscosity = 0);

/// The same found by trying: the longest step, to 2 %, over which noise on a periodic lattice of the set-up's
/// particles under the pressure `p0` [Pa] does not grow in `steps` steps. p0/K should be some per cent, so
/// that the lattice neither comes apart nor yields.
template <int Dim>
double measured_step_limit(const FlowSetup<Dim>& setup, double p0, long steps = 300);

}  // namespace dem2sph
