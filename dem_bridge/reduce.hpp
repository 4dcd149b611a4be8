// From frames of grains and contacts to the figures of a shear cell: stress, solid fraction, shear rate,
// dilation. Pure functions: a test can feed them one contact or a lattice. Equations and definitions:
// dem_bridge/README.md.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "dem_bridge/dump.hpp"
#include "dem_bridge/jackknife.hpp"
#include "dem_bridge/observables.hpp"
#include "sph/base/tensor.hpp"

namespace dem2sph::bridge {

/// What the reduction has to know about the cell that the frames come from.
struct Measurement {
  double d = 0;               ///< mean grain diameter [m]
  double rho_s = 0;           ///< density of the grains' material [kg/m^3]
  double grain_friction = 0;  ///< Coulomb's limit of the contacts
  double wall_thickness = 0;  ///< thickness of each rough wall's slab of grains [m]
  double core_margin = 0;     ///< distance of the core from the walls' inner faces [m]
  double time_step = 0;       ///< [s]
  double cohesion = 0;        ///< SJKR energy density [J/m^3]
  /// -1: the wall moves along -x. Everything is then mirrored in x, so that the flow looks as if it went
  /// along +x.
  int direction = 1;
};

/// Volume of the part of a sphere with centre height z that lies in low <= z <= high [m^3]. Exact.
double sphere_slab_volume(double z, double radius, double low, double high);

/// What one frame says about the core. Stresses are compression-positive.
struct CoreState {
  std::int64_t step = 0;
  double time = 0;          ///< since the first frame [s]
  double strain = 0;        ///< of the core since the first frame
  double height = 0;        ///< distance of the mean heights of the two walls' grains [m]
  double thickness = 0;     ///< of the core [m]
  double phi = 0;           ///< volume overlap of grains with the core
  Sym<3> stress;            ///< contacts + velocity fluctuations [Pa]
  double kinetic_zz = 0;    ///< share of the fluctuations in stress(2, 2) [Pa]
  double temperature = 0;   ///< granular: a third of the mean square of the velocity fluctuations [m^2/s^2]
  double coordination = 0;  ///< contacts of a grain
  double fabric_xz = 0;     ///< mean of n_x n_z over the contacts, n the unit vector between two centres
  /// d v_x / d z and d v_z / d z averaged over the core, the latter being tr(D) of a cell that is periodic in
  /// x and y, of the displacement since the frame before over the time between [1/s]. Of the first frame: of
  /// the grains' velocities.
  double gamma_dot = 0, dilation_rate = 0;
  double largest_overlap = 0;  ///< of any contact in the whole cell [m]
  double cut_contacts =
      0;  ///< fraction of the contacts whose tangential force was cut back to Coulomb's limit

  double p() const { return stress(2, 2); }
  double tau() const { return -stress(0, 2); }  ///< > 0 where v_x grows with z
};

/// `before` is the frame before, or null. Throws InputError if the frames do not belong together or the core
/// holds no grains.
CoreState measure_core(const GrainFrame& grains, const ContactFrame& contacts, const Measurement& cell,
                       const GrainFrame* before = nullptr);

/// Sets `time` and `strain` of each frame: sums of the core's own shear rate since the first.
void integrate_strain(std::span<CoreState> frames, double time_step);

/// Means of a steady run. The first `strain_dropped` of core strain is not used.
struct SteadyMeans {
  Estimate mu, phi, p, I;
  Estimate N1, N2;         ///< (sigma_xx - sigma_zz)/p and (sigma_zz - sigma_yy)/p
  Estimate beta;           ///< 0 in a steady flow
  double temperature = 0;  ///< T/(gamma_dot d)^2
  double coordination = 0;
  double fabric_xz = 0;
  double strain = 0;  ///< averaged over
  std::size_t frames = 0;
  /// Second half minus first half, and over the standard error of that difference: beyond about 3, the run
  /// was not steady.
  double phi_change = 0, phi_drift = 0, mu_change = 0, mu_drift = 0;
};
SteadyMeans reduce_steady(std::span<const CoreState> frames, double strain_dropped, const Measurement& cell);

/// A transient on the strain axis s = window (k + 1/2), the same for every run. Everything is a mean over the
/// time that each window takes, from integrals which are exact for beta and gamma_dot and take stress, phi
/// and height as linear between frames. Fills the lists of a Transient and phi_0; who ran it is for the
/// caller to add. Throws EngineError if a window has no frame.
Transient reduce_transient(std::span<const CoreState> frames, double window, const Measurement& cell);

/// Series of the force on the top wall, as `fix ave/time` writes it: each line a mean over one frame
/// interval.
struct WallSample {
  std::int64_t step = 0;
  double height = 0;  ///< [m]
  double p = 0;       ///< normal stress [Pa]
  double tau = 0;     ///< shear stress, > 0 against the motion [Pa]
};
std::vector<WallSample> read_wall_series(const std::filesystem::path& path);

}  // namespace dem2sph::bridge
