#include "calibration/profile.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

/// A residual that holds the quantity at `target`. With a weight of 1e4 standard errors it stays within some
/// 1e-4 of one: the quantity that was reached, and chi2 without this residual, are what the profile is made
/// of.
constexpr double tightness = 1e4;

class Walk {
 public:
  Walk(const LeastSquaresProblem& problem, double best_chi2, const ProfileRequest& request)
      : problem_(problem), request_(request), best_chi2_(best_chi2) {
    for (const LeastSquaresParameter& p : problem.parameters) best_.push_back(p.start);
    std::vector<double> gradient(best_.size());
    best_value_ = request.quantity(best_, gradient);
    ResidualBlock hold;
    for (std::size_t k = 0; k < best_.size(); ++k) hold.parameters.push_back(k);
    hold.size = 1;
    hold.evaluate = [this](std::span<const double> x, std::span<double> residuals,
                           std::span<double> jacobian) {
      std::vector<double> by(x.size());
      const double weight = tightness / request_.standard_error;
      residuals[0] = weight * (request_.quantity(x, by) - target_);
      for (std::size_t k = 0; k < jacobian.size(); ++k) jacobian[k] = weight * by[k];
      return std::isfinite(residuals[0]);
    };
    problem_.blocks.push_back(std::move(hold));
  }
  Walk(const Walk&) = delete;
  Walk& operator=(const Walk&) = delete;

  double best_value() const { return best_value_; }

  struct Point {
    double value = 0, delta = 0;
    bool found = false;
  };
  /// The best fit with the quantity at `target`, from where the last one ended.
  Point at(double target) {
    target_ = target;
    const Minimum minimum = minimise(problem_);
    if (!minimum.found) return {target, 0, false};
    std::vector<double> gradient(best_.size());
    const double value = request_.quantity(minimum.values, gradient);
    const double held = tightness / request_.standard_error * (value - target);
    for (std::size_t k = 0; k < best_.size(); ++k) problem_.parameters[k].start = minimum.values[k];
    return {value, minimum.chi2 - held * held - best_chi2_, true};
  }
  void back_to_best() {
    for (std::size_t k = 0; k < best_.size(); ++k) problem_.parameters[k].start = best_[k];
  }

 private:
  LeastSquaresProblem problem_;
  const ProfileRequest& request_;
  double best_chi2_;
  std::vector<double> best_;
  double best_value_ = 0;
  double target_ = 0;
};

}  // namespace

Profile profile_likelihood(const LeastSquaresProblem& problem, double best_chi2,
                           const ProfileRequest& request) {
  if (!(request.standard_error > 0 && std::isfinite(request.standard_error) && request.threshold > 0))
    throw Error(ExitCode::bug,
                "profile of " + request.name + ": its standard error or threshold is not positive");
  Walk walk(problem, best_chi2, request);
  Profile profile;
  profile.name = request.name;
  profile.value = walk.best_value();
  std::vector<std::pair<double, double>> seen{{profile.value, 0.0}};

  const auto side = [&](double sign, double limit, double& end, bool& open) {
    walk.back_to_best();
    // A parabola reaches the threshold at q = sqrt(threshold) standard errors. Four steps lead there; then
    // the steps grow, up to 30 q away: beyond, the side is open.
    const double q = std::sqrt(request.threshold) * request.standard_error;
    double inside = profile.value, inside_delta = 0;
    double step = 0.25 * q;
    open = true;
    end = profile.value;
    for (int i = 0; i < 40; ++i) {
      double target = inside + sign * step;
      const bool last = sign * (target - limit) >= 0 || std::abs(target - profile.value) > 30 * q;
      if (sign * (target - limit) >= 0) target = limit;
      const Walk::Point point = walk.at(target);
      if (!point.found) {
        step *= 0.5;
        if (step < 1e-3 * q) return;
        walk.back_to_best();
        continue;
      }
      seen.emplace_back(point.value, point.delta);
      if (point.delta >= request.threshold) {
        // The square root of the rise is nearly linear in the value: regula falsi on it, kept inside the
        // bracket.
        double a = inside, b = point.value, fa = std::sqrt(std::max(0.0, inside_delta)),
               fb = std::sqrt(point.delta);
        const double goal = std::sqrt(request.threshold);
        for (int k = 0; k < 30; ++k) {
          const double t = std::clamp((goal - fa) / (fb - fa), 0.05, 0.95);
          const Walk::Point middle = walk.at(a + t * (b - a));
          if (!middle.found) break;
          seen.emplace_back(middle.value, middle.delta);
          const double f = std::sqrt(std::max(0.0, middle.delta));
          if (f < goal) {
            a = middle.value, fa = f;
          } else {
            b = middle.value, fb = f;
          }
          // A thousandth of a standard error of where the interval ends.
          if (std::abs(f - goal) < 1e-3 || std::abs(b - a) < 1e-3 * request.standard_error) break;
        }
        end = a + (goal - fa) / (fb - fa) * (b - a);
        open = false;
        return;
      }
      inside = point.value, inside_delta = point.delta;
      end = inside;
      if (last) return;
      if (i >= 4) step *= 1.5;
    }
  };
  side(-1, request.lowest, profile.low, profile.open_low);
  side(1, request.highest, profile.high, profile.open_high);
  std::sort(seen.begin(), seen.end());
  for (const auto& [value, delta] : seen) {
    profile.values.push_back(value);
    profile.delta_chi2.push_back(delta);
  }
  return profile;
}

}  // namespace dem2sph
