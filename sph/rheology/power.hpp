// A power of the inertial number that stays finite at rest, for friction and solid fraction alike.
#pragma once

#include <cmath>

namespace dem2sph {

/// I^n for I >= 0; 0 at I = 0, and so are its derivatives there, where those of the logarithm would be 0
/// times infinity.
template <class U, class T>
auto power_of_I(const U& I, const T& n) {
  using std::exp;
  using std::log;
  using Result = decltype(n * I);
  return I == 0.0 ? Result(0.0) : Result(exp(n * log(I)));
}

}  // namespace dem2sph
