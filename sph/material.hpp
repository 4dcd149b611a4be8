// From the law file to the laws: the one place where names of members become types.
#pragma once

#include <fmt/format.h>

#include <stdexcept>
#include <string>
#include <variant>

#include "sph/base/errors.hpp"
#include "sph/base/law_file.hpp"
#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph {

/// The member of a family (a variant) that has the name `law.member`, made from its parameters by their
/// names. Throws InputError if there is no such member, if a parameter is missing, or if no law has these
/// values.
template <class Family>
Family law_of(const FittedLaw& law, const char* what) {
  try {
    if (const auto found = law_by_name<Family>(law.member, [&](const char* name) { return law[name]; }))
      return *found;
  } catch (const std::invalid_argument& error) {
    std::string list;
    for (const FittedParameter& p : law.parameters)
      list += fmt::format("{}{} = {}", list.empty() ? "" : ", ", p.name, p.value);
    throw InputError(fmt::format("no {} law with {}: {}", law.member, list, error.what()));
  }
  throw InputError(fmt::format("unknown {} law \"{}\"", what, law.member));
}

inline FrictionLaw friction_law(const LawFile& file) {
  return law_of<FrictionLaw>(file.friction, "friction");
}

inline SteadySolidFraction solid_fraction_law(const LawFile& file) {
  return {law_of<decltype(SteadySolidFraction::law)>(file.solid_fraction, "solid fraction")};
}

/// mu at rest: the tangent of the steepest slope that stands. 0 for a law without a yield stress.
inline double least_friction(const FrictionLaw& law) {
  return std::visit([](const auto& member) { return steady_friction(member, 0.0, 0.0); }, law);
}

}  // namespace dem2sph
