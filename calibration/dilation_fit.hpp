// The law of dilation from transients: which member, with which parameters, how well it describes each kind
// of change, and the share of beta that shows in friction. README, "Transients".
#pragma once

#include <vector>

#include "calibration/data_selection.hpp"
#include "calibration/fit.hpp"
#include "calibration/models.hpp"

namespace dem2sph {

/// Fits the transients with the solid fraction law of `fit` held, and fills what `fit` says of them. Returns
/// the derivatives of the parameters of dilation (rows) by the coordinates of that law, for the covariance.
Matrix fit_dilation(Fit& fit, const SelectedData& selected, const SteadyModel& model,
                    const std::vector<double>& coordinates, const Matrix& coordinate_covariance);

}  // namespace dem2sph
