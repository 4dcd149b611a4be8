// The strain scale of dilation from transients, and the share of beta that shows in friction. README,
// "Transients".
#pragma once

#include <vector>

#include "calibration/data_selection.hpp"
#include "calibration/fit.hpp"
#include "calibration/models.hpp"

namespace dem2sph {

/// Fits s* to the transients with the solid fraction law of `fit` held, and fills what `fit` says of them.
/// Returns d(ln s*) by each coordinate of that law, for the covariance.
std::vector<double> fit_dilation(Fit& fit, const SelectedData& selected, const SteadyModel& model,
                                 const std::vector<double>& coordinates, const Matrix& coordinate_covariance);

}  // namespace dem2sph
