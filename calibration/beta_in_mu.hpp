// What share of beta shows in friction: mu - mu_steady(I) against the fitted beta. README, "Does beta show in
// mu?".
#pragma once

#include <string>
#include <vector>

#include "calibration/fit.hpp"
#include "calibration/models.hpp"
#include "calibration/transient_problem.hpp"

namespace dem2sph {

struct BetaInMu {
  Estimate share;                 ///< of all transients; no name if there are too few samples
  std::vector<Estimate> by_kind;  ///< named by the kind
  NoiseModel noise;               ///< of mu about the regression
};

/// Linear regression with correlated noise and one constant a condition. `fit.transients` hold the excess of
/// mu; `solutions` are those of the fitted law of dilation, whose parameters have `covariance` (coordinates,
/// offsets, phi_0).
BetaInMu regress_mu_on_beta(const Fit& fit, const TransientProblem& problem,
                            const std::vector<TransientSolution>& solutions, std::size_t coordinates,
                            const Matrix& covariance);

}  // namespace dem2sph
