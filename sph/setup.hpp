// Everything a flow needs, resolved: no file, no default and no unit is looked up after this.
#pragma once

#include <string>
#include <vector>

#include "sph/base/geometry.hpp"
#include "sph/base/law_file.hpp"
#include "sph/equation_of_state.hpp"
#include "sph/neighbours.hpp"
#include "sph/particles.hpp"
#include "sph/parts.hpp"

namespace dem2sph {

template <int Dim>
struct FlowSetup {
  std::string formulation;
  Parts parts;
  Grains grains;
  double cohesion = 0;  ///< c [Pa]
  EquationOfState eos;
  double dx = 0;           ///< spacing of the initial lattice [m]
  double h = 0;            ///< smoothing length [m]
  double step_factor = 1;  ///< on all bounds of Eq. 5.28
  double skin = 0.05;      ///< of the Verlet list, as a fraction of the support
  Vec<Dim> gravity;
  Geometry<Dim> geometry;        ///< as the case has it, without particles
  std::vector<Wall<Dim>> walls;  ///< of it, where they are now
  Period<Dim> period;
  double floor_end = 0;  ///< largest x that the floor supports [m]; 0: there is no end
  double initial_phi = 0;
  DataRange law_range;      ///< of I, that the law's data cover; 0, 0: not stated
  std::string extrapolate;  ///< outside of it: "warn" and count, "clamp" I, "error" above extrapolate_limit
  double extrapolate_limit = 0;  ///< share of the flowing mass above law_range
  Particles<Dim> particles;      ///< at t = 0; wall particles carry the mass of their volume at rho0

  // What the run needs to know about its scene.
  std::string scene;
  double end_time = 0;
  long frames = 0;
  bool stop_at_rest = false;
  double length_scale = 0;    ///< H0 [m]
  double initial_length = 0;  ///< L0 [m]; 0 where there is no front
  bool axisymmetric = false;  ///< the front is a radius
  double bulk_density = 0;    ///< rho0 = phi_0 rho_s [kg/m^3]
};

}  // namespace dem2sph
