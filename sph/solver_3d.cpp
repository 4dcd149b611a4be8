// Instantiates the solver in 3D.
#include "sph/solver.hpp"

namespace dem2sph {

template <>
std::unique_ptr<Flow> make_flow(FlowSetup<3> setup) {
  return std::make_unique<Solver<3>>(std::move(setup));
}

}  // namespace dem2sph
