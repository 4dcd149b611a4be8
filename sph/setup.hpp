// Everything a flow needs, resolved: no file, no default and no unit is looked up after this.
#pragma once

#include <string>
#include <vector>

#include "sph/base/law_file.hpp"
#include "sph/equation_of_state.hpp"
#include "sph/neighbours.hpp"
#include "sph/particles.hpp"
#include "sph/rheology/yield.hpp"

namespace dem2sph {

/// The material as the solver uses it.
struct Material {
  Grains grains;
  RationalFriction<double> friction;
  double cohesion = 0;  ///< c [Pa]
  DilationLaw dilation;
};

/// The ingredients by name; the compositions that exist are listed in composition.cpp.
struct Ingredients {
  std::string kernel;    ///< cubic_spline, wendland_c2, wendland_c4
  std::string density;   ///< summation_shepard, continuity_fourtakas_2019
  std::string walls;     ///< boundary_particles, adami_2012
  std::string stress;    ///< direct, elastic_return
  std::string dilation;  ///< none, evolve
  std::string damping;   ///< none, monaghan, balsara
};

struct NumericalParameters {
  double dx = 0;                          ///< spacing of the initial lattice [m]
  double h = 0;                           ///< smoothing length [m]
  double G_over_K = 0;                    ///< elastic_return
  double alpha = 0;                       ///< of the damping
  double delta = 0;                       ///< continuity_fourtakas_2019
  double gamma_dot_min = 0;               ///< direct [1/s]
  double B_max = 1.5;                     ///< boundary_particles, Eq. 5.24
  double boundary_density_factor = 0.97;  ///< boundary_particles: their rho0 over their initial density
  double step_factor = 1;                 ///< on all bounds of Eq. 5.28
  double skin = 0.1;                      ///< of the Verlet list, as a fraction of the support
};

template <int Dim>
struct FlowSetup {
  std::string formulation;
  Ingredients ingredients;
  NumericalParameters numerics;
  Material material;
  EquationOfState eos;
  Vec<Dim> gravity;
  std::vector<Plane<Dim>> planes;
  Period<Dim> period;
  double floor_end = 0;  ///< largest x that the floor supports [m]; 0: periodic
  double initial_phi = 0;
  DataRange law_range;  ///< of I, that the law's data cover; 0, 0: not stated
  Particles<Dim> particles;  ///< at t = 0; wall particles carry the mass of their volume at rho0

  // What the run needs to know about its scene.
  std::string scene;
  double end_time = 0;
  long frames = 0;
  bool stop_at_rest = false;
  double length_scale = 0;    ///< H0 [m]
  double initial_length = 0;  ///< L0 [m]; 0 where there is no front
  double bulk_density = 0;    ///< rho0 = phi_0 rho_s [kg/m^3]
};

}  // namespace dem2sph
