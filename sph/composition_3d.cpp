// Instantiates the solver's 3D compositions.
#include "sph/composition.hpp"

namespace dem2sph {
template std::unique_ptr<Flow> make_flow(FlowSetup<3>);
}  // namespace dem2sph
