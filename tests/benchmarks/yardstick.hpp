// What this machine reaches on the pair loops of an SPH step when nothing else is in the way: the yardstick
// that whole steps are compared with.
#pragma once

#include <cstddef>
#include <vector>

#include "sph/neighbours.hpp"

namespace dem2sph::yardstick {

/// A cloud of particles on a disturbed lattice, with their lists: support 2.4 dx, 10 % of skin.
template <int Dim>
struct Cloud {
  explicit Cloud(std::size_t particles_along);

  Particles<Dim> q;
  PairList list;
  double h = 0;
  std::vector<double> volume;
  /// Sums of the passes, Shepard's among them.
  std::vector<double> rho, shepard;
  std::array<std::vector<double>, std::size_t{Dim} * Dim> gradient;
  std::array<std::vector<double>, std::size_t{Dim}> acceleration;
  /// sigma/rho^2, six numbers (four in 2D: without zz three are used).
  std::array<std::vector<double>, 6> stress;
};

/// Two fused passes with plain loops: density, Shepard sum and velocity gradient; then the divergence of a
/// full stress with artificial viscosity.
template <int Dim>
void two_passes(Cloud<Dim>& cloud);
/// The same sums in four passes: density; Shepard; gradient; momentum.
template <int Dim>
void four_passes(Cloud<Dim>& cloud);

}  // namespace dem2sph::yardstick
