// Who is near whom: Verlet lists of clusters over a grid of cells, with periodic directions.
//
// Particles that follow each other in memory are close in space (spatial_order), and Pack::width of them are
// a cluster: the lanes of a pass. A cluster has one list, of all particles within support + skin of any of
// its members. So a pass loads a neighbour once for all lanes, gathers nothing, and a lane that is farther
// from it than the kernel reaches adds zero. A particle is its own neighbour, at distance zero.
//
// A list stays valid until two particles near each other have moved towards each other by the skin, which is
// checked every step (Patches). Neighbours stand interior first, then walls, so that a pass over one kind of
// pair has no branch. Every sum is taken by its own particle, in a fixed order, so results do not depend on
// the number of threads.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "sph/base/tensor.hpp"
#include "sph/loops.hpp"
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
};

/// A particle b of a list, and in which periodic image it is near: its index, and one of 27 images.
class Neighbour {
 public:
  static constexpr std::size_t images = 27;
  static constexpr std::size_t most_particles = std::size_t{1} << 27U;
  Neighbour() = default;
  Neighbour(std::size_t b, std::size_t image) : packed_(static_cast<std::uint32_t>(image << 27U | b)) {}
  std::size_t index() const { return packed_ & 0x7FFFFFFU; }
  std::size_t image() const { return packed_ >> 27U; }

 private:
  std::uint32_t packed_ = 0;
};

/// Tells when a list has worn out. A flow that carries its particles along does not wear it out: what counts
/// is by how much the displacements of neighbours differ.
///
/// When a list is built, space is divided into patches. A pair that the list lacks was farther apart than
/// support + skin. In one patch, or in two that touch, it cannot have come within the support while the
/// displacements of all their particles lie in a box with a diagonal below the skin. A pair in patches that
/// do not touch was a patch's width apart, and may approach by that less the support.
class Patches {
 public:
  template <int Dim>
  void build(const Particles<Dim>& particles, const Period<Dim>& period, double reach);
  /// True once some pair may be missing that was farther apart than `reach` at `listed` and is now as near as
  /// reach - skin; also if a displacement is not a number. Walls that stay where they were need not be looked
  /// at.
  template <int Dim>
  bool worn_out(const Particles<Dim>& particles, const std::array<Column, std::size_t{Dim}>& listed,
                double skin, bool walls_move);
  std::size_t bytes() const;

 private:
  struct Members {
    std::vector<std::size_t> first;  // of each patch; one more than patches
    std::vector<std::int32_t> particle;
  };
  // What holds all displacements of a patch.
  struct Box {
    std::array<double, 3> low, high;
    bool empty;
    double unknown;  // NaN if one of them is
  };
  std::size_t neighbour(std::size_t patch, std::size_t direction) const;

  Members interior_, walls_;
  std::array<long, 3> count_{1, 1, 1};
  std::array<bool, 3> periodic_{false, false, false};
  double reach_ = 0;
  double width_ = 0;  // the least one
  std::vector<Box> boxes_;
};

class PairList {
 public:
  /// Which pairs are wanted, by the kind of the particle that sums.
  struct Wanted {
    bool wall_sees_interior = true;
    bool wall_sees_wall = false;
  };

  /// Lists all pairs closer than `reach`. Positions are within [0, length) of periodic directions. Throws
  /// NumericalError if a position is not finite or a periodic length is below three times the reach.
  template <int Dim>
  void build(const Particles<Dim>& particles, const Period<Dim>& period, double reach, Wanted wanted);

  struct Range {
    const Neighbour* first;
    const Neighbour* last;
    const Neighbour* begin() const { return first; }
    const Neighbour* end() const { return last; }
  };
  Range interior_of(const Cluster& a) const { return {at(start_[a.list]), at(split_[a.list])}; }
  Range walls_of(const Cluster& a) const { return {at(split_[a.list]), at(start_[a.list + 1])}; }
  bool sees_interior(const Cluster& a) const { return split_[a.list] > start_[a.list]; }
  Range all_of(const Cluster& a) const { return {at(start_[a.list]), at(start_[a.list + 1])}; }
  /// What to add to the position of a neighbour to get the image that is near.
  template <int Dim>
  [[gnu::always_inline]] Vec<Dim> shift(Neighbour b) const {
    Vec<Dim> value;
    for (int k = 0; k < Dim; ++k) value[k] = shifts_[b.image()][static_cast<std::size_t>(k)];
    return value;
  }
  /// Calls f(b, x) for the neighbours of a range: b is the index of one, x the cluster's position `x_a` as
  /// its image sees it. Neighbours of one image stand together, so that the shift is made once.
  template <int Dim, class F>
  [[gnu::always_inline]] void for_each(Range range, const Vec<Dim, Pack>& x_a, F&& f) const {
    for (const Neighbour* n = range.first; n != range.last;) {
      const std::size_t image = n->image();
      const Vec<Dim, Pack> x = x_a - broadcast(shift<Dim>(*n));
      do f(n->index(), x);
      while (++n != range.last && n->image() == image);
    }
  }

  /// True if the list may lack a pair within reach - skin of the particles where they are now, `listed` being
  /// where they were when it was built.
  template <int Dim>
  bool worn_out(const Particles<Dim>& particles, const std::array<Column, std::size_t{Dim}>& listed,
                double skin, bool walls_move) {
    return patches_.worn_out(particles, listed, skin, walls_move);
  }

  std::size_t clusters() const { return split_.size(); }
  /// Clusters of interior particles come first.
  Cluster cluster(std::size_t list) const {
    const bool wall = list >= interior_clusters_;
    const std::size_t first =
        wall ? interior_ + (list - interior_clusters_) * Pack::width : list * Pack::width;
    return {first, std::min(Pack::width, (wall ? size_ : interior_) - first), list};
  }
  /// Calls f(cluster) for all clusters of interior particles, of walls, or of both, in parallel.
  template <class F>
  void for_interior(F&& f) const {
    for_particles(0, interior_clusters_, [&](std::size_t k) { f(cluster(k)); });
  }
  template <class F>
  void for_walls(F&& f) const {
    for_particles(interior_clusters_, clusters(), [&](std::size_t k) { f(cluster(k)); });
  }
  template <class F>
  void for_all(F&& f) const {
    for_particles(0, clusters(), [&](std::size_t k) { f(cluster(k)); });
  }
  /// Sums over the interior clusters: f(cluster, sums) adds to `sums`.
  template <std::size_t N, class F>
  std::array<double, N> sum_over_interior(F&& f) const {
    return sum_over<N>(0, interior_clusters_,
                       [&](std::size_t k, std::array<double, N>& sums) { f(cluster(k), sums); });
  }

  /// Pairs of lanes and neighbours: what a pass over all of them evaluates.
  std::size_t pairs() const { return start_.empty() ? 0 : Pack::width * start_.back(); }
  std::size_t bytes() const {
    return neighbours_.capacity() * sizeof(Neighbour) +
           (start_.capacity() + split_.capacity()) * sizeof(std::size_t) + patches_.bytes();
  }

 private:
  const Neighbour* at(std::size_t k) const { return neighbours_.data() + k; }

  std::size_t interior_ = 0, size_ = 0, interior_clusters_ = 0;
  std::vector<std::size_t> start_;  // one more than clusters
  std::vector<std::size_t> split_;
  std::vector<Neighbour> neighbours_;
  Patches patches_;
  std::array<std::array<double, 3>, Neighbour::images> shifts_{};
};

/// Order in which particles lie close in memory when they are close in space: interior and walls each along a
/// Hilbert curve over cells (of about one spacing: then clusters are compact).
template <int Dim>
std::vector<std::int32_t> spatial_order(const Particles<Dim>& particles, double cell);

}  // namespace dem2sph
