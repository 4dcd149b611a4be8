// From the law file to the laws: the one place where names of members become types.
#pragma once

#include <fmt/format.h>

#include <array>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
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
  std::optional<Family> found;
  const auto try_member = [&]<class Member>(std::type_identity<Member>) {
    if (found || law.member != Member::name) return;
    std::array<double, Member::parameters.size()> values{};
    std::string list;
    for (std::size_t k = 0; k < values.size(); ++k) {
      values[k] = law[Member::parameters[k]];
      list += fmt::format("{}{} = {}", k > 0 ? ", " : "", Member::parameters[k], values[k]);
    }
    try {
      found = make_law<Member>(values);
    } catch (const std::invalid_argument& error) {
      throw InputError(fmt::format("no {} law with {}: {}", Member::name, list, error.what()));
    }
  };
  [&]<class... Members>(std::type_identity<std::variant<Members...>>) {
    (try_member(std::type_identity<Members>{}), ...);
  }(std::type_identity<Family>{});
  if (!found) throw InputError(fmt::format("unknown {} law \"{}\"", what, law.member));
  return *found;
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
