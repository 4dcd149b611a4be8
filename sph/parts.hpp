// The parts that a scene is composed of. A part that is off is an empty type: no array, no pass, no column.
#pragma once

#include <vector>

#include "sph/rheology/yield.hpp"

namespace dem2sph {

// ---- density
// ----------------------------------------------------------------------------------------------------
/// Eqs. 5.17, 5.18 (given): sum over all neighbours, then the Shepard filter.
struct SummationShepard {
  static constexpr const char* name = "summation_shepard";
  static constexpr bool summed = true;
};
/// Continuity equation with the density diffusion of Fourtakas et al. (2019).
struct ContinuityFourtakas2019 {
  static constexpr const char* name = "continuity_fourtakas_2019";
  static constexpr bool summed = false;
};

// ---- walls
// ------------------------------------------------------------------------------------------------------
/// The source's boundary particles (5.23, 5.24): own density and stress, artificial velocity, rho0 3 % below.
struct BoundaryParticles {
  static constexpr const char* name = "boundary_particles";
  static constexpr bool extrapolated = false;
};
/// Pressure, deviatoric stress and velocity extrapolated from the material (Adami, Hu, Adams 2012).
struct WallAdami2012 {
  static constexpr const char* name = "adami_2012";
  static constexpr bool extrapolated = true;
};

// ---- stress
// -----------------------------------------------------------------------------------------------------
/// Eq. 5.3 (reconstructed) with the viscosity (mu p + c)/max(|g|, g_min).
struct DirectStress {
  static constexpr const char* name = "direct";
  static constexpr bool elastic = false;
};
/// Elastic predictor with an objective rate, return to the yield surface (Dunatunga and Kamrin 2015).
struct ElasticReturn {
  static constexpr const char* name = "elastic_return";
  static constexpr bool elastic = true;
};

// ---- dilation
// ---------------------------------------------------------------------------------------------------
struct NoDilation {
  static constexpr const char* name = "none";
  static constexpr bool on = false;
  template <class F>
  void arrays(F&&) {}
  void resize(std::size_t, double) {}
};
/// Eq. 5.22 (given, closed as in sph/rheology/dilation.hpp): phi is the state, beta follows.
struct EvolvedDilation {
  static constexpr const char* name = "evolve";
  static constexpr bool on = true;
  std::vector<double> phi;   ///< solid fraction
  std::vector<double> beta;  ///< the beta that entered mu last, after its limits
  template <class F>
  void arrays(F&& f) {
    f("phi", "1", phi);
    f("beta", "1", beta);
  }
  void resize(std::size_t total, double initial_phi) {
    phi.assign(total, initial_phi);
    beta.assign(total, 0.0);
  }
};

// ---- damping
// ----------------------------------------------------------------------------------------------------
struct NoDamping {
  static constexpr const char* name = "none";
  static constexpr bool on = false;
  static constexpr bool limited = false;
};
/// Artificial viscosity between approaching interior particles (Monaghan and Gingold 1983).
struct MonaghanDamping {
  static constexpr const char* name = "monaghan";
  static constexpr bool on = true;
  static constexpr bool limited = false;
};
/// The same times the limiter of Balsara (1995), |div v|/(|div v| + |g| + 1e-4 c/h): sound is damped, shear
/// flow is not.
struct BalsaraDamping {
  static constexpr const char* name = "balsara";
  static constexpr bool on = true;
  static constexpr bool limited = true;
};

/// A composition: one type a choice, resolved at compile time.
template <int Dimension, template <int> class KernelOf, class DensityPart, class WallPart, class StressPart,
          class DilationPart, class DampingPart>
struct Composition {
  static constexpr int dim = Dimension;
  using Kernel = KernelOf<Dimension>;
  using Density = DensityPart;
  using Walls = WallPart;
  using Stress = StressPart;
  using Dilation = DilationPart;
  using Damping = DampingPart;
};

}  // namespace dem2sph
