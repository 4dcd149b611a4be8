// From observables to a law with errors: steady friction, solid fraction, and the strain scale of dilation.
// The equations, the weighting and what each figure means are in calibration/README.md.
#pragma once

#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "calibration/profile.hpp"
#include "calibration/statistics.hpp"
#include "dem_bridge/observables.hpp"
#include "sph/base/case_file.hpp"
#include "sph/base/law_file.hpp"
#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph {

inline const ParameterTable fit_table{
    "fit",
    "How the law is fitted to the shear cells.",
    {{"friction",
      Kind::word,
      "",
      -unbounded,
      unbounded,
      "rational",
      "Friction law of the result; best: the member that the data prefer (AICc). All members are fitted and "
      "compared.",
      {"rational", "exponential", "power", "linear", "barker_gray_2017", "best"}},
     {"solid_fraction",
      Kind::word,
      "",
      -unbounded,
      unbounded,
      "best",
      "Solid fraction law of the result, likewise.",
      {"linear", "power", "rational", "best"}},
     {"friction_I_max", Kind::number, "", 0, 10, "1.1",
      "Steady points with a larger I are left out of the friction fit: small cells stop flowing densely "
      "there."},
     {"phi_I_max", Kind::number, "", 0, 10, "1.1",
      "Steady points with a larger I are left out of the solid fraction fit."},
     {"robust", Kind::flag, "", -unbounded, unbounded, "true",
      "Points beyond 2 standard errors pull with a constant force (Huber), so that outliers do not lead."},
     {"compare", Kind::flag, "", -unbounded, unbounded, "true",
      "Fit every member of the families and predict conditions that were left out, for a comparison."},
     {"profiles", Kind::flag, "", -unbounded, unbounded, "true",
      "Intervals from the profile likelihood instead of the standard error."},
     {"bootstrap", Kind::integer, "", 0, 10000, "200",
      "Draws of a bootstrap over the seeds of each condition, for a second band; 0: none. Needs two seeds at "
      "half of the conditions or more."},
     {"wall_disagreement", Kind::number, "", 0, 1, "0.1",
      "Steady points whose friction at the wall differs from the core's by more than this share are left "
      "out."},
     {"mu_floor", Kind::number, "", 0, 0.1, "0.001",
      "Smallest standard error of mu: a quarter of a per cent of 0.4; the wall of a cell holds its pressure "
      "to 0.5 %."},
     {"phi_floor", Kind::number, "", 0, 0.1, "0.0005",
      "Smallest standard error of phi: a twentieth of the 1 % by which two ways to define phi differ."},
     {"I_floor", Kind::number, "", 0, 0.1, "0.0025",
      "Smallest relative standard error of I: the 0.5 % of the pressure, halved by the root in I."},
     {"D_star_min", Kind::number, "", 1e-6, 1, "1e-3", "Lower bound of D*."},
     {"D_star_max", Kind::number, "", 1e-3, 1e3, "10",
      "Upper bound of D*: above, the law is a straight line."},
     {"mu_max", Kind::number, "", 0.1, 100, "5", "Upper bound of mu_l and of mu_h - mu_l."},
     {"b_max", Kind::number, "", 0.01, 100, "3",
      "Upper bound of b in phi_eq = phi_c - b I; the lower one is 0."},
     {"dilation",
      Kind::word,
      "",
      -unbounded,
      unbounded,
      "best",
      "Law of dilation to fit to the transients; best: phi_relaxes, unless two_sided or printed have an AICc "
      "that is lower by 10.",
      {"phi_relaxes", "two_sided", "printed", "none", "best"}},
     {"s_star_min", Kind::number, "", 1e-4, 1, "0.01", "Lower bound of the strain scale s*."},
     {"s_star_max", Kind::number, "", 0.1, 1e3, "20", "Upper bound of the strain scale s*."},
     {"bins", Kind::integer, "", 10, 400, "60",
      "A transient is averaged into at most so many bins before it is weighed."},
     {"mu_from_strain", Kind::number, "", 0, 10, "0.1",
      "mu is compared with beta from this strain on: before, contacts are still being loaded."},
     {"starts", Kind::integer, "", 1, 1000, "16", "Starts of every fit; how many agree is reported."},
     {"strict", Kind::flag, "", -unbounded, unbounded, "false",
      "End with exit code 6 if a parameter of the law is not known from the data."}}};

struct FitOptions {
  std::string friction = "rational";
  std::string solid_fraction = "best";
  double friction_I_max = 1.1;
  double phi_I_max = 1.1;
  bool robust = true;
  bool compare = true;
  bool profiles = true;
  long bootstrap = 200;
  double wall_disagreement = 0.1;
  double mu_floor = 1e-3;
  double phi_floor = 5e-4;
  double I_floor = 2.5e-3;
  double D_star_min = 1e-3;
  double D_star_max = 10;
  double mu_max = 5;
  double b_max = 3;
  std::string dilation = "best";
  double s_star_min = 0.01;
  double s_star_max = 20;
  long bins = 60;
  double mu_from_strain = 0.1;
  long starts = 16;
  bool strict = false;

  static FitOptions from(const Section& section);  ///< of fit_table
};

/// A figure with its standard error and its 95 % interval.
struct Estimate {
  std::string name;
  double value = 0;
  double standard_error = 0;
  double low = 0;
  double high = 0;
  bool at_bound = false;  ///< held at a bound: its error and interval mean nothing
  /// The interval does not end on that side: no value is refused by the data as far as was looked.
  bool open_low = false, open_high = false;
};

/// How the search for the minimum went.
struct Search {
  int starts = 0, converged = 0, agreed = 0, iterations = 0;
  std::string termination;
  std::vector<double> singular_values;
  int reweighted = 0;  ///< how often the weights were made anew from the fit
};

/// How well a law predicts conditions that it was not fitted to.
struct CrossValidation {
  struct Condition {
    double I_driven = 0, mean = 0, predicted = 0;
    double error = 0;  ///< predicted over mean, less 1
  };
  std::vector<Condition> conditions;  ///< empty if there are too few to leave one out
  double rms = 0, largest = 0;        ///< of |error|
};

/// The law fitted to runs drawn anew among the seeds of each condition (Efron 1979): what the spread over
/// seeds alone makes of it, without any standard error of a run.
struct Bootstrap {
  long draws = 0;                              ///< 0: not made
  std::vector<double> low, high;               ///< 95 % intervals of the parameters
  std::vector<double> I, band_low, band_high;  ///< 95 % band of the law
};

/// One fitted law. `covariance` belongs to `parameters`, is scaled like their standard errors, and has rows
/// of 0 for parameters at a bound.
struct LawFit {
  std::string member;
  std::vector<Estimate> parameters;
  std::vector<std::vector<double>> covariance;
  double chi2 = 0;
  double degrees_of_freedom = 0;
  double chi2_per_dof = 0;     ///< 0 without degrees of freedom
  double error_scale = 1;      ///< sqrt(chi2/dof) where that is above 1: what the errors were multiplied by
  double interval_factor = 0;  ///< half width of a 95 % interval in standard errors
  Search search;
  std::string failure;              ///< why this member could not be fitted; all else is then empty
  std::vector<double> coordinates;  ///< as models.hpp has them
  std::vector<std::vector<double>> coordinate_covariance;  ///< scaled like `covariance`
  double AICc = 0, BIC = 0;          ///< up to a constant that is the same for all members of a family
  CrossValidation cross_validation;  ///< leave one driven I out
  std::vector<Profile> profiles;
  Bootstrap bootstrap;
  std::vector<std::string> downweighted;  ///< runs that are far off the law and count less

  /// Throws Error(bug) if there is none of that name.
  const Estimate& operator[](std::string_view name) const;
};

/// One point of a steady fit, as it was weighed.
struct SteadyDatum {
  std::string run;
  std::int64_t seed = 0;
  double I_driven = 0;
  double I = 0, I_se = 0;          ///< I_se with floor and seed spread
  double value = 0, value_se = 0;  ///< mu or phi; value_se with floor and seed spread
  bool flat = true;                ///< the errors of value and I had stopped growing with the block length
  double phi_drift = 0;            ///< of the run: change of phi between its halves, in standard errors
  double plain_se = 0;             ///< with the error of I carried over by the slope of the law
  double weight = 1;               ///< below 1: so far off that it counts less
  double effective_se = 0;         ///< plain_se over the root of the weight
  double fitted = 0;
  double residual = 0;  ///< (value - fitted)/plain_se
  double p = 0;         ///< [Pa], for the residuals' page
  long order = 0;       ///< place of the run in its observables, from 1
};

/// How well the law of dilation describes the transients that differ by the seed alone, measured with the
/// noise that the seeds show.
struct TransientCheck {
  std::string kind;
  double I_before = 0, I_driven = 0, load_before = 0, load = 0, packing_friction = 0;
  long seeds = 0;
  double signal_to_noise = 0;  ///< of the mean trace: rms of phi about its mean over that of its noise
  double chi2_per_dof = 0;
  double explained = 0;  ///< share of the mean trace's variance above the noise
  /// The same by the law fitted to all others, with no offset; phi_0 of each run is free.
  bool predicted = false;
  double predicted_chi2_per_dof = 0, predicted_explained = 0;
  /// Means over the seeds, to the end of the shortest run.
  std::vector<double> s, phi, phi_fit, beta, beta_fit, mu_excess;
  std::vector<std::string> runs;
  /// By what factor one more run like these would lower the variance of each parameter of dilation, as far
  /// as the transients make it; empty if one is at a bound.
  std::vector<double> one_more_run;
};

/// One transient with the fitted evolution beside it, on the samples of the observables.
struct TransientFit {
  std::string run;
  std::string kind;
  std::int64_t seed = 0;
  double I_driven = 0;
  Estimate phi_0;
  double phi_offset = 0;  ///< of its condition: phi_eq of this transient minus the steady law's
  double explained = 0;   ///< share of the variance of phi that the fit explains
  std::vector<double> s, phi, phi_fit, beta, beta_fit;
  std::vector<double> mu_excess;  ///< mu - mu_steady(I)
};

struct Fit {
  double d = 0, rho_s = 0, grain_friction = 0;
  std::string engine, material;
  double core_seconds = 0;  ///< of all runs that the observables know the cost of
  FitOptions options;

  LawFit friction;
  LawFit solid_fraction;
  /// Every member that could be fitted, the chosen one among them; without profiles.
  std::vector<LawFit> friction_members, solid_fraction_members, dilation_members;
  LawFit dilation;  ///< "none" without transients
  std::vector<SteadyDatum> friction_data, solid_fraction_data;
  std::vector<TransientFit> transients;
  std::vector<ExcludedRun> excluded;

  Estimate slope;  ///< (mu_h - mu_l)/D* of the rational and the exponential law; no name for the others
  bool mu_h_and_D_star_known = false;  ///< the data reach far enough to quote the two apart
  NoiseModel phi_noise;                ///< of the transients' phi
  double whitened_autocorrelation =
      0;  ///< of the whitened residuals at lag one: near 0 if the noise model fits
  double s_star_error_least_squares = 0;
  double s_star_error_jackknife = 0;  ///< over runs; 0 with fewer than 3
  Estimate beta_in_mu;  ///< share of beta that shows in mu - mu_steady(I); no name if not measured
  std::vector<Estimate> beta_in_mu_by_kind;  ///< named by the kind of transient
  NoiseModel seed_noise;  ///< of phi, about the mean of a run's twins; strain_scale 0: too few twins
  std::vector<TransientCheck> transient_checks;  ///< empty without seed_noise
  NoiseModel mu_noise;                           ///< of mu in that regression

  /// Of the parameters of friction, of solid fraction and of dilation.
  std::vector<std::string> covariance_names;
  std::vector<std::vector<double>> covariance;

  DataRange I, phi, s, p;
  std::string verdict;
  std::vector<std::string> warnings;

  FrictionLaw friction_law() const;
  SteadySolidFraction solid_fraction_law() const;
  double steady_friction_at(double I) const;
};

/// Fits all laws. Throws InputError for data that are no data (NaN, standard error 0, two materials),
/// IdentifiabilityError if the data cannot tell the parameters, or, with `strict`, leave one of them open.
Fit fit_law(const std::vector<Observables>& observables, const FitOptions& options = {});

/// `value` with as many decimals as two digits of its error have.
std::string round_to_error(double value, double error);

/// A prediction of a fitted law with its error and 95 % band, by the delta method.
struct Prediction {
  double value = 0, standard_error = 0, low = 0, high = 0;
};
Prediction predict_friction(const Fit& fit, double I);
Prediction predict_solid_fraction(const Fit& fit, double I);

/// The fit as the solver reads it. `observables` are named with their SHA-256 in the provenance.
LawFile make_law_file(const Fit& fit, std::span<const std::filesystem::path> observables);
/// The parameters' names and values, "mu_l = 0.3645(12), ...".
std::string list_of(const LawFit& law);
/// Everything about the fit, as fit.json holds it.
nlohmann::json to_json(const Fit& fit, std::span<const std::filesystem::path> observables);
/// Where the account of a fit lies: fit.json beside law.json, NAME.fit.json beside NAME.json.
std::filesystem::path fit_path_of(const std::filesystem::path& law_path);
/// Writes `law_path` and, beside it, fit_path_of(law_path).
void write_fit(const Fit& fit, std::span<const std::filesystem::path> observables,
               const std::filesystem::path& law_path);

}  // namespace dem2sph
