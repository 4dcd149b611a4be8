// Who is near whom: a Verlet list over a grid of cells, with periodic directions.
//
// The list holds all pairs within support + skin and stays valid until some particle has moved half the skin,
// which is checked every step. Each particle's neighbours are stored interior first, then walls, so that a
// pass over one kind of pair has no branch. Lists are full (a sees b and b sees a): every sum is taken by its
// own particle, in a fixed order, so results do not depend on the number of threads.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "sph/base/tensor.hpp"
#include "sph/particles.hpp"

namespace dem2sph {

/// Periodic lengths; infinite where a direction is not periodic. No scene makes the last direction (up)
/// periodic, but tests of waves and lattices do.
template <int Dim>
struct Period {
  Vec<Dim> length;
  Period() {
    for (int k = 0; k < Dim; ++k) length[k] = std::numeric_limits<double>::infinity();
  }
  /// The shortest image of a difference of positions (|r| below 1.5 periods).
  Vec<Dim> shortest(Vec<Dim> r) const {
    for (int k = 0; k + 1 < Dim; ++k) shorten(r, k);
    // A branch that is always foretold costs less than the arithmetic that would change nothing.
    if (length[Dim - 1] < std::numeric_limits<double>::infinity()) [[unlikely]]
      shorten(r, Dim - 1);
    return r;
  }

 private:
  void shorten(Vec<Dim>& r, int k) const {
    const double half = 0.5 * length[k];
    r[k] -= r[k] > half ? length[k] : 0.0;
    r[k] += r[k] < -half ? length[k] : 0.0;
  }
};

class PairList {
 public:
  /// Which pairs are wanted, by the kind of the particle that sums.
  struct Wanted {
    bool wall_sees_interior = true;
    bool wall_sees_wall = false;
  };

  /// Lists all pairs closer than `reach`. Throws NumericalError if a position is not finite or a periodic
  /// length is below twice the reach.
  template <int Dim>
  void build(const Particles<Dim>& particles, const Period<Dim>& period, double reach, Wanted wanted);

  struct Range {
    const std::int32_t* first;
    const std::int32_t* last;
    const std::int32_t* begin() const { return first; }
    const std::int32_t* end() const { return last; }
  };
  Range interior_of(std::size_t a) const { return {&pairs_[start_[a]], &pairs_[split_[a]]}; }
  Range walls_of(std::size_t a) const { return {&pairs_[split_[a]], &pairs_[start_[a + 1]]}; }
  Range all_of(std::size_t a) const { return {&pairs_[start_[a]], &pairs_[start_[a + 1]]}; }
  std::size_t pairs() const { return start_.empty() ? 0 : start_.back(); }
  std::size_t bytes() const {
    return pairs_.capacity() * sizeof(std::int32_t) +
           (start_.capacity() + split_.capacity()) * sizeof(std::size_t);
  }

 private:
  std::vector<std::size_t> start_;  // one more than particles
  std::vector<std::size_t> split_;
  std::vector<std::int32_t> pairs_;
};

/// Order in which particles lie close in memory when they are close in space: interior and walls each by
/// cell.
template <int Dim>
std::vector<std::int32_t> spatial_order(const Particles<Dim>& particles, double cell);

}  // namespace dem2sph
