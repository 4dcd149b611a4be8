// A steady law fitted to points with errors in I and in the value, robustly; how well it predicts a condition
// that it has not seen; and which member of a family the data prefer.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "calibration/fit.hpp"
#include "calibration/least_squares.hpp"
#include "calibration/models.hpp"

namespace dem2sph {

/// A fitted member with what a further use of the fit needs.
struct SteadyFit {
  LawFit law;
  std::vector<SteadyDatum> data;  ///< sorted by I, with weights and residuals
};

/// Throws IdentifiabilityError if the data cannot tell the parameters. `family`: "friction" or "solid
/// fraction", for messages.
SteadyFit fit_steady(const SteadyModel& model, std::vector<SteadyDatum> data, const std::string& family,
                     const FitOptions& options);

/// Fills law.profiles, and the intervals of the parameters from them, of `fit`; and that of the slope at
/// rest.
void add_profiles(SteadyFit& fit, const SteadyModel& model, const std::string& family);

/// Fits again without each driven I and predicts it.
CrossValidation cross_validate(const SteadyFit& fit, const SteadyModel& model, const std::string& family,
                               const FitOptions& options);

/// Fills fit.law.bootstrap with `options.bootstrap` draws, unless fewer than half of the conditions have two
/// seeds. A draw takes as many runs of each condition as it has, with replacement, and widens their
/// deviations from the condition's mean by sqrt(n/(n - 1)), without which a few seeds would pretend too
/// little spread.
void add_bootstrap(SteadyFit& fit, const SteadyModel& model, const std::string& family,
                   const FitOptions& options);

}  // namespace dem2sph
