// The parts that a scene is composed of, with their parameters. A part that is off has no array, no pass and
// no instruction: each pass (passes.hpp) is compiled once for every choice that it depends on, and the solver
// picks its variants when it is made. So every combination exists, without a product of all choices having to
// be compiled.
#pragma once

#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "sph/rheology/yield.hpp"

namespace dem2sph {

// ---- density
/// Eq. 5.17 (given): the sum over all neighbours.
struct Summation {
  static constexpr const char* name = "summation";
};
/// Eqs. 5.17, 5.18 (given): the sum, then the Shepard filter.
struct SummationShepard {
  static constexpr const char* name = "summation_shepard";
};
/// The free-surface form that the source calls more common (its reference 124, Monaghan 1994): the continuity
/// equation d(rho_a)/dt = sum_b m_b (v_a - v_b) . grad W, so that a free surface keeps its density.
struct ContinuityMonaghan1994 {
  static constexpr const char* name = "continuity_monaghan_1994";
};
/// Continuity with the density diffusion of Molteni and Colagrossi (2009).
struct ContinuityMolteniColagrossi2009 {
  static constexpr const char* name = "continuity_molteni_colagrossi_2009";
  double delta = 0;
};
/// Continuity with the density diffusion of Fourtakas et al. (2019), which leaves hydrostatic pressure alone.
struct ContinuityFourtakas2019 {
  static constexpr const char* name = "continuity_fourtakas_2019";
  double delta = 0;
};
using DensityPart = std::variant<Summation, SummationShepard, ContinuityMonaghan1994,
                                 ContinuityMolteniColagrossi2009, ContinuityFourtakas2019>;
template <class D>
inline constexpr bool is_summed = std::is_same_v<D, Summation> || std::is_same_v<D, SummationShepard>;
template <class D>
inline constexpr bool is_diffusive =
    std::is_same_v<D, ContinuityMolteniColagrossi2009> || std::is_same_v<D, ContinuityFourtakas2019>;

// ---- walls
/// The source's boundary particles (5.23, 5.24): density and stress of their own, artificial velocity, rho0 3
/// % low.
struct BoundaryParticles {
  static constexpr const char* name = "boundary_particles";
  static constexpr bool extrapolates_stress = false;
  double B_max = 1.5;
  double density_factor = 0.97;
};
/// What the source suggests between that and no slip: the stress of a boundary particle is (1 - share) times
/// its own plus share times the average of the material in its reach.
struct PartialSlip {
  static constexpr const char* name = "partial_slip";
  static constexpr bool extrapolates_stress = true;
  double B_max = 1.5;
  double density_factor = 0.97;
  double share = 0;
};
/// Pressure, deviatoric stress and velocity extrapolated from the material (Adami, Hu, Adams 2012).
struct WallAdami2012 {
  static constexpr const char* name = "adami_2012";
  static constexpr bool extrapolates_stress = true;
};
using WallPart = std::variant<BoundaryParticles, PartialSlip, WallAdami2012>;
template <class W>
inline constexpr bool has_own_state = !std::is_same_v<W, WallAdami2012>;

// ---- stress
/// Eq. 5.3 (reconstructed) with the viscosity (mu p + c)/max(|g|, g_min).
struct DirectStress {
  static constexpr const char* name = "direct";
  double gamma_dot_min = 0;  ///< [1/s]
};
/// Elastic predictor with an objective rate, return to the yield surface (Dunatunga and Kamrin 2015).
struct ElasticReturn {
  static constexpr const char* name = "elastic_return";
  double G = 0;  ///< [Pa]
};
using StressPart = std::variant<DirectStress, ElasticReturn>;

// ---- dilation
struct NoDilation {
  static constexpr const char* name = "none";
};
/// Eq. 5.13 (reconstructed): beta = tr(D)/|g| of the SPH field, within limits.
struct DilationFromField {
  static constexpr const char* name = "direct";
  DilationLimits limits{0, 0.5};
};
/// Eq. 5.22 (given, closed as in sph/rheology/dilation.hpp): phi is the state, beta follows.
struct DilationEvolves {
  static constexpr const char* name = "evolve";
  RelaxingSolidFraction law;
};
/// Eq. 5.22 as it is printed: beta is the state.
struct DilationEvolvesPrinted {
  static constexpr const char* name = "evolve_printed";
  PrintedDilation law;
};
using DilationPart = std::variant<NoDilation, DilationFromField, DilationEvolves, DilationEvolvesPrinted>;
template <class D>
inline constexpr bool has_dilation_state =
    std::is_same_v<D, DilationEvolves> || std::is_same_v<D, DilationEvolvesPrinted>;

// ---- damping
struct NoDamping {
  static constexpr const char* name = "none";
};
/// Artificial viscosity between approaching interior particles (Monaghan and Gingold 1983).
struct MonaghanDamping {
  static constexpr const char* name = "monaghan";
  double alpha = 0;
};
/// The same times the limiter of Balsara (1995), |div v|/(|div v| + |g| + 1e-4 c/h), where material flows:
/// sound is damped, shear flow is not. Where it stands (elastically) the limiter is 1.
struct BalsaraDamping {
  static constexpr const char* name = "balsara";
  double alpha = 0;
};
using DampingPart = std::variant<NoDamping, MonaghanDamping, BalsaraDamping>;

// ---- gradient correction
struct NoCorrection {
  static constexpr const char* name = "none";
};
/// Gradients that are exact for linear fields (Randles and Libersky 1996, Bonet and Lok 1999), in 5.21 and,
/// with each particle's own matrix, in 5.20.
struct BonetLok1999 {
  static constexpr const char* name = "bonet_lok_1999";
};
using CorrectionPart = std::variant<NoCorrection, BonetLok1999>;

// ---- velocity averaging
struct NoAveraging {
  static constexpr const char* name = "none";
};
/// Particles move with a velocity that is averaged with their neighbours' (XSPH, Monaghan 1989).
struct Xsph {
  static constexpr const char* name = "xsph";
  double epsilon = 0;
};
using AveragingPart = std::variant<NoAveraging, Xsph>;

// ---- shifting
struct NoShifting {
  static constexpr const char* name = "none";
};
/// Particle shifting in the form of Sun et al. (2017); along a free surface only in its tangent.
struct ShiftingSun2017 {
  static constexpr const char* name = "sun_2017";
};
using ShiftingPart = std::variant<NoShifting, ShiftingSun2017>;

/// The alternatives of a variant by name, in order: what a case file may say.
template <class Variant>
std::vector<std::string> names_of() {
  return []<class... P>(std::variant<P...>*) {
    return std::vector<std::string>{P::name...};
  }(static_cast<Variant*>(nullptr));
}
template <class Variant>
std::string name_of(const Variant& part) {
  return std::visit([](const auto& p) { return std::string(p.name); }, part);
}

/// The composition of a flow.
struct Parts {
  std::string kernel;  ///< cubic_spline, wendland_c2, wendland_c4
  DensityPart density;
  WallPart walls;
  StressPart stress;
  FrictionLaw friction;
  DilationPart dilation;
  DampingPart damping;
  CorrectionPart correction;
  AveragingPart averaging;
  ShiftingPart shifting;
  bool swelling = false;  ///< rho0 follows phi
};

}  // namespace dem2sph
