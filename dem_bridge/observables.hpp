// observables.h5: what the shear cells say, run by run, as the bridge writes it and the calibration reads it.
// What each figure means is fixed in dem_bridge/README.md; every dataset has a unit, every mean its standard
// error.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace dem2sph {

/// Means of one steady shear run, start-up dropped, with standard errors by block jackknife.
struct SteadyPoint {
  std::string run;  ///< hash that names the run's folder
  std::int64_t seed = 0;
  double I_driven = 0;         ///< what the wall was set to
  double I = 0, I_se = 0;      ///< from the core's own velocity gradient and p
  double mu = 0, mu_se = 0;    ///< tau/p in the core, p = sigma_zz
  double phi = 0, phi_se = 0;  ///< volume overlap of grains with the core
  double p = 0, p_se = 0;      ///< [Pa]
  double wall_mu = 0;          ///< from the force on the wall, for comparison
  double wall_p = 0;           ///< [Pa]
  double strain = 0;           ///< core strain averaged over
  /// The jackknife's error had stopped growing with the length of its blocks; else it may be too small.
  bool I_flat = true, mu_flat = true, phi_flat = true;
  double phi_drift = 0;          ///< (second half - first half) of phi, in standard errors
  double N1 = 0, N1_se = 0;      ///< (sigma_xx - sigma_zz)/p
  double N2 = 0, N2_se = 0;      ///< (sigma_zz - sigma_yy)/p
  double beta = 0, beta_se = 0;  ///< mean of tr(D)/gamma_dot: 0 in a steady flow
  double temperature = 0;        ///< granular temperature over (gamma_dot d)^2
  double coordination = 0;       ///< contacts of a grain
  double fabric_xz = 0;          ///< mean n_x n_z over the contacts
};

/// One transient on its own strain axis; all lists have the same length.
struct Transient {
  std::string run;
  std::string kind;  ///< "start_up", "jump", "reversal", "pressure_jump"
  std::int64_t seed = 0;
  double I_driven = 0;
  double I_before = 0;            ///< driven, before the change; 0 of a start-up
  double load = 0;                ///< set pressure [Pa]
  double load_before = 0;         ///< [Pa]
  double packing_friction = 0;    ///< friction of the grains while they were packed
  double phi_0 = 0;               ///< before the change
  std::vector<double> s;          ///< strain of the core since the change, the same axis for all runs
  std::vector<double> gamma_dot;  ///< [1/s]
  std::vector<double> p;          ///< [Pa]
  std::vector<double> mu;
  std::vector<double> I;
  std::vector<double> phi;
  std::vector<double> beta;    ///< dilation rate over shear rate, from the coarse-grained fields
  std::vector<double> height;  ///< distance of the walls [m]
};

/// What a run cost, preparations included.
struct RunCost {
  std::string run;
  std::string kind;
  double cpu_seconds = 0;  ///< of LIGGGHTS
};

/// A run that failed or was judged unfit, and why.
struct ExcludedRun {
  std::string run;
  std::string reason;
};

struct Observables {
  double d = 0;      ///< mean grain diameter [m]
  double rho_s = 0;  ///< [kg/m^3]
  double grain_friction = 0;
  double pressure = 0;   ///< set pressure [Pa]
  std::string engine;    ///< "LIGGGHTS 3.8.0"
  std::string material;  ///< the effective material section, as TOML
  std::vector<SteadyPoint> steady;
  std::vector<Transient> transients;
  std::vector<ExcludedRun> excluded;
  std::vector<RunCost> costs;
  /// Of all runs [s].
  double cpu_seconds() const {
    double sum = 0;
    for (const RunCost& cost : costs) sum += cost.cpu_seconds;
    return sum;
  }
};

inline constexpr std::int64_t observables_schema_version = 2;

/// Writes atomically.
void write_observables(const Observables& observables, const std::filesystem::path& path);
/// Throws InputError for a file that is missing, truncated, of another schema, or holds anything but finite
/// numbers.
Observables read_observables(const std::filesystem::path& path);

}  // namespace dem2sph
