// Instantiates the solver in 2D.
#include "sph/solver.hpp"

namespace dem2sph {

template <>
std::unique_ptr<Flow> make_flow(FlowSetup<2> setup) {
  return std::make_unique<Solver<2>>(std::move(setup));
}

}  // namespace dem2sph
