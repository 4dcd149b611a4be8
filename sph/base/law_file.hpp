// law.json: the calibrated material, as the fit writes it and the solver reads it. Described in
// calibration/README.md.
#pragma once

#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace dem2sph {

struct FittedParameter {
  std::string name;  ///< "mu_l", "D_star", ...
  double value = 0;
  double standard_error = 0;
  std::string unit = "1";
  bool at_bound = false;  ///< the fit held it at a bound: its standard error means nothing
};

/// One law of the material: which member of its family, and that member's parameters. All are pure numbers
/// but the D_star of "rational_rate", which is in 1/s. The equations are in sph/rheology/README.md.
///   friction        constant {mu}, rational {mu_l, mu_h, D_star}, rational_rate {mu_l, mu_h, D_star},
///                   exponential {mu_l, mu_h, D_star}, power {mu_l, a, n}, linear {mu_l, rise},
///                   barker_gray_2017 {mu_s, mu_2, I_0, mu_inf, alpha}
///   solid fraction  linear {phi_c, b}, power {phi_c, a, n}, rational {phi_c, b, I_phi}
///   dilation        phi_relaxes {s_star}, two_sided {s_star, s_star_compacting}, printed {s_star, gain},
///   none;
///                   each but none may have beta_share, what of beta enters mu (1 if it is not there)
struct FittedLaw {
  std::string member;
  std::vector<FittedParameter> parameters;
  double chi2_per_dof = 0;  ///< of the fit that made it; 0 if there are no degrees of freedom
  /// Value of a parameter. Throws InputError if the law does not have it.
  double operator[](std::string_view name) const;
  bool has(std::string_view name) const;
};

/// Where data were: outside, the law extrapolates.
struct DataRange {
  double lowest = 0;
  double highest = 0;
};

struct LawFile {
  double d = 0;      ///< mean grain diameter [m]
  double rho_s = 0;  ///< density of the grains' material [kg/m^3]
  FittedLaw friction;
  FittedLaw solid_fraction;
  FittedLaw dilation;
  /// Order of the rows of `covariance`: names over all three laws.
  std::vector<std::string> covariance_names;
  std::vector<std::vector<double>> covariance;
  DataRange I, phi, s, p;             ///< p in Pa
  std::string verdict;                ///< one sentence: what the data say and do not say
  std::vector<std::string> warnings;  ///< parameters that may not be quoted alone, and why
  nlohmann::json provenance;          ///< observables with their SHA-256, run ids, program, engine
};

inline constexpr int law_schema_version = 1;

/// SHA-256 of everything that a flow can depend on: the law without its verdict, warnings and provenance
/// (which has times and hosts).
std::string law_hash(const LawFile& law);
/// Writes atomically, numbers with 17 digits so that they read back bit for bit.
void write_law_file(const LawFile& law, const std::filesystem::path& path);
/// Throws InputError naming the file and the member that is missing, of another type or impossible
/// (mu_h < mu_l, D_star <= 0 or in another unit than its member's, s_star <= 0, a covariance that is not
/// square or not symmetric).
LawFile read_law_file(const std::filesystem::path& path);

}  // namespace dem2sph
