// From the law file to the laws: the one place where names of members become types.
#pragma once

#include <fmt/format.h>

#include <stdexcept>
#include <variant>

#include "sph/base/errors.hpp"
#include "sph/base/law_file.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph {

/// The friction law that a law file states. Throws InputError if there is no such law, or none with these
/// parameters.
inline FrictionLaw friction_law(const LawFile& file) {
  const FittedLaw& law = file.friction;
  if (law.member == "constant") return ConstantFriction<double>{law["mu"]};
  if (law.member == "rational") return RationalFriction<double>{law["mu_l"], law["mu_h"], law["D_star"]};
  if (law.member == "rational_rate")
    return RationalRateFriction<double>{law["mu_l"], law["mu_h"], law["D_star"]};
  if (law.member == "barker_gray_2017") {
    const double mu_s = law["mu_s"];
    const double mu_2 = law["mu_2"];
    const double I_0 = law["I_0"];
    const double mu_inf = law["mu_inf"];
    const double alpha = law["alpha"];
    try {
      return BarkerGray2017<double>(mu_s, mu_2, I_0, mu_inf, alpha);
    } catch (const std::invalid_argument& error) {
      throw InputError(fmt::format(
          "no barker_gray_2017 law with mu_s = {}, mu_2 = {}, I_0 = {}, mu_inf = {}, alpha = {}: {}", mu_s,
          mu_2, I_0, mu_inf, alpha, error.what()));
    }
  }
  throw InputError(fmt::format("unknown friction law \"{}\"", law.member));
}

/// mu at rest: the tangent of the steepest slope that stands. 0 for a law without a yield stress.
inline double least_friction(const FrictionLaw& law) {
  return std::visit([](const auto& member) { return steady_friction(member, 0.0, 0.0); }, law);
}

}  // namespace dem2sph
