// Instantiates the solver's 2D compositions.
#include "sph/composition.hpp"

namespace dem2sph {
template std::unique_ptr<Flow> make_flow(FlowSetup<2>);
}  // namespace dem2sph
