// Where the equations of incompressible mu(I) flow are well posed (Barker, Schaeffer, Bohorquez, Gray, JFM
// 779, 2015): short waves must not grow without bound as they get shorter, or a finer resolution gives no
// better answer.
//
//   n = (I/mu) d(mu)/dI,    C = 4 n^2 - 4 n + mu^2 (1 - n/2)^2 <= 0: well posed
//
// With 0.383, 0.644, 0.279 the rational law is well posed for I = 0.0196 to 0.85 only; slower and faster
// flows are not. A constant mu has n = 0 and C = mu^2: well posed nowhere. The condition is that of
// two-dimensional incompressible flow; a compressible scheme is not bound by it, but has nothing better to
// converge to.
#pragma once

#include <limits>

namespace dem2sph {

/// C from mu and n, the exponent with which mu grows with the shear rate at fixed pressure.
inline double well_posedness_of(double mu, double n) {
  const double m = mu * (1 - 0.5 * n);
  return 4 * n * n - 4 * n + m * m;
}

/// The steady friction coefficient of any member of the family of laws (friction.hpp): of I, or of gamma_dot
/// [1/s] where the member says so.
template <class Law, class U>
auto steady_friction(const Law& law, const U& I, const U& gamma_dot) {
  if constexpr (Law::of_rate)
    return law(I, gamma_dot);
  else
    return law(I);
}

/// C of a law at I and the shear rate gamma_dot [1/s]. At rest n is 0, also for a law that starts at mu = 0
/// with an infinite slope (its n falls like 1/ln(1/I)).
template <class Law>
double well_posedness(const Law& law, double I, double gamma_dot) {
  const double rate = Law::of_rate ? gamma_dot : I;
  const double mu = steady_friction(law, I, gamma_dot);
  return well_posedness_of(mu, rate == 0 ? 0 : rate / mu * law.slope(rate));
}

/// C of a law that depends on I alone.
template <class Law>
double well_posedness(const Law& law, double I) {
  static_assert(!Law::of_rate, "this law needs the shear rate as well");
  return well_posedness(law, I, 0);
}

/// Inertial numbers from `low` to `high` with C <= 0; both 0 if there are none.
struct WellPosedRange {
  double low = 0;
  double high = 0;
  bool empty() const { return !(high > low); }
};

/// The widest range (as a ratio) that a search from 1e-12 to 1e9 in steps of 2 % finds, its ends to the last
/// digit and on the well-posed side. A range that begins below 1e-12 begins at 0, one that does not end is
/// infinite.
template <class Law>
WellPosedRange well_posed_range(const Law& law) {
  constexpr double lowest = 1e-12;
  constexpr double highest = 1e9;
  const auto good = [&](double I) { return well_posedness(law, I) <= 0; };  // a NaN is not well posed
  const auto edge = [&](double inside, double outside) {
    for (;;) {
      const double middle = 0.5 * (inside + outside);
      if (middle == inside || middle == outside) return inside;
      (good(middle) ? inside : outside) = middle;
    }
  };
  WellPosedRange best;
  double best_ratio = 1;
  double start = 0;  // the first good point of the run that goes on; 0: none does
  double before = lowest;
  for (double I = lowest;; I *= 1.02) {
    const bool last = I > highest;
    const bool here = good(I);
    if (here && start == 0) start = I;
    if (start > 0 && (!here || last)) {
      const double ratio = (here ? I : before) / start;
      if (ratio >= best_ratio) {
        best_ratio = ratio;
        best.low = start == lowest ? 0 : edge(start, start / 1.02);
        best.high = here ? std::numeric_limits<double>::infinity() : edge(before, I);
      }
      start = 0;
    }
    if (last) return best;
    before = I;
  }
}

}  // namespace dem2sph
