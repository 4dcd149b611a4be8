// The compositions that exist: one explicit instantiation each, two-dimensional ones in composition_2d.cpp
// and three-dimensional ones in composition_3d.cpp. To add one, add a line to `CompositionList`.
#pragma once

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <tuple>

#include "sph/solver.hpp"

namespace dem2sph {

template <int Dim, class Dilation>
using Source =
    Composition<Dim, CubicSpline, SummationShepard, BoundaryParticles, DirectStress, Dilation, NoDamping>;
template <int Dim, template <int> class Kernel, class Dilation, class Damping>
using Robust =
    Composition<Dim, Kernel, ContinuityFourtakas2019, WallAdami2012, ElasticReturn, Dilation, Damping>;

template <int Dim>
using CompositionList = std::tuple<Source<Dim, NoDilation>, Source<Dim, EvolvedDilation>,
                                   Robust<Dim, WendlandC2, NoDilation, BalsaraDamping>,
                                   Robust<Dim, WendlandC2, EvolvedDilation, BalsaraDamping>,
                                   Robust<Dim, WendlandC2, NoDilation, MonaghanDamping>,
                                   Robust<Dim, WendlandC2, NoDilation, NoDamping>,
                                   Robust<Dim, CubicSpline, NoDilation, BalsaraDamping>,
                                   Robust<Dim, WendlandC4, NoDilation, BalsaraDamping>>;

/// The composition in words, as messages and the command line show it.
inline std::string name_of(const Ingredients& i) {
  return fmt::format("{} + {} + {} + {} + dilation {} + damping {}", i.kernel, i.density, i.walls, i.stress,
                     i.dilation, i.damping);
}
template <class C>
std::string name_of_composition() {
  return name_of({C::Kernel::name, C::Density::name, C::Walls::name, C::Stress::name, C::Dilation::name,
                  C::Damping::name});
}

template <class F, class... C>
void for_each_composition(std::tuple<C...>*, F&& f) {
  (f.template operator()<C>(), ...);
}

template <int Dim>
std::unique_ptr<Flow> make_flow(FlowSetup<Dim> setup) {
  std::unique_ptr<Flow> flow;
  std::vector<std::string> known;
  const std::string wanted = name_of(setup.ingredients);
  for_each_composition(static_cast<CompositionList<Dim>*>(nullptr), [&]<class C>() {
    known.push_back(name_of_composition<C>());
    if (known.back() == wanted) flow = std::make_unique<Solver<C>>(std::move(setup));
  });
  if (!flow)
    throw UsageError(
        fmt::format("the composition {} does not exist; these do:\n  {}", wanted, fmt::join(known, "\n  ")));
  return flow;
}

}  // namespace dem2sph
