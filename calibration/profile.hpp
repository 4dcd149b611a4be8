// Profile likelihood: how much worse the best fit becomes if one quantity is held at another value,
// everything else being fitted again. Where chi2 rises by q^2, q standard normal quantiles, ends the
// interval.
//
// Why not the standard error: for mu(I) with data below D*, chi2 is a long curved valley in (mu_h, D*), which
// an ellipse does not describe. An interval may then be open on one side: no value, however large, is refused
// by the data.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "calibration/least_squares.hpp"

namespace dem2sph {

struct Profile {
  std::string name;
  double value = 0;  ///< of the best fit
  double low = 0, high = 0;
  /// chi2 does not reach the threshold on that side: `low` or `high` is where the search ended.
  bool open_low = false, open_high = false;
  std::vector<double> values, delta_chi2;  ///< along the way, sorted by value
};

/// A quantity as a function of the parameters of the problem. Writes its gradient (one number a parameter).
using ParameterFunction =
    std::function<double(std::span<const double> parameters, std::span<double> gradient)>;

struct ProfileRequest {
  std::string name;
  ParameterFunction quantity;
  double standard_error = 0;  ///< of the quantity: the scale of the first steps, positive
  double threshold = 0;       ///< rise of chi2 at the ends of the interval
  /// Values beyond are not looked at.
  double lowest = -std::numeric_limits<double>::infinity();
  double highest = std::numeric_limits<double>::infinity();
};

/// `problem` starts at its best fit, whose chi2 is `best_chi2`. Throws Error(bug) if the request is not
/// positive.
Profile profile_likelihood(const LeastSquaresProblem& problem, double best_chi2,
                           const ProfileRequest& request);

}  // namespace dem2sph
