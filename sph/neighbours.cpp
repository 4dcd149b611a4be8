#include "sph/neighbours.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

/// A grid of cells over the particles' bounding box; periodic directions hold a whole number of cells.
template <int Dim>
struct Grid {
  Vec<Dim> low;
  Vec<Dim> cell, inverse_cell;  ///< extent of a cell and its inverse; 0 where there is no extent
  std::array<long, 3> cells{1, 1, 1};
  std::array<bool, 3> periodic{false, false, false};

  /// Far fliers must not make the grid larger than memory: with more than `most` cells in all, or along one
  /// axis, they are wider than asked.
  Grid(const Particles<Dim>& particles, const Period<Dim>& period, double wanted, double most) {
    std::array<double, 3> length{}, count{1, 1, 1};
    for (int k = 0; k < Dim; ++k) {
      const std::vector<double>& x = particles.x[static_cast<std::size_t>(k)];
      double lowest = std::numeric_limits<double>::infinity();
      double highest = -lowest;
      for (std::size_t i = 0; i < x.size(); ++i) {
        if (!std::isfinite(x[i]))
          throw NumericalError(
              fmt::format("the position of particle {} is not a finite number", particles.id[i]));
        lowest = std::min(lowest, x[i]);
        highest = std::max(highest, x[i]);
      }
      const std::size_t axis = static_cast<std::size_t>(k);
      periodic[axis] = std::isfinite(period.length[k]);
      low[k] = periodic[axis] ? 0 : lowest;
      length[axis] = periodic[axis] ? period.length[k] : highest - lowest;
      count[axis] = std::max(1.0, std::floor(length[axis] / wanted));
    }
    while (count[0] * count[1] * count[2] > most) {
      double& longest = *std::max_element(count.begin(), count.end());
      longest = std::max(1.0, std::floor(longest / 2));
    }
    for (std::size_t k = 0; k < Dim; ++k) {
      cells[k] = static_cast<long>(count[k]);
      cell.c[k] = length[k] / count[k];
      inverse_cell.c[k] = length[k] > 0 ? count[k] / length[k] : 0;
    }
  }
  std::size_t count() const { return static_cast<std::size_t>(cells[0] * cells[1] * cells[2]); }
  /// Which cell along one axis; beyond the grid if x is.
  long along(std::size_t k, double x) const {
    const double at = std::floor((x - low.c[k]) * inverse_cell.c[k]);
    return static_cast<long>(std::clamp(at, -1e15, 1e15));
  }
  std::array<long, 3> place(const Particles<Dim>& particles, std::size_t i) const {
    std::array<long, 3> c{0, 0, 0};
    for (std::size_t k = 0; k < Dim; ++k) c[k] = std::clamp(along(k, particles.x[k][i]), 0L, cells[k] - 1);
    return c;
  }
  std::size_t index(const std::array<long, 3>& c) const {
    return static_cast<std::size_t>((c[2] * cells[1] + c[1]) * cells[0] + c[0]);
  }
};

/// Particles by cell, and their positions in that order, so that a search reads memory in a row.
template <int Dim>
struct Binned {
  std::vector<std::size_t> first;  ///< of each cell; one more than cells
  std::vector<std::int32_t> member;
  std::array<std::vector<double>, static_cast<std::size_t>(Dim)> x;

  /// Particles [begin, end).
  Binned(const Grid<Dim>& grid, const Particles<Dim>& particles, std::size_t begin, std::size_t end)
      : first(grid.count() + 1, 0), member(end - begin) {
    std::vector<std::size_t> cell(end - begin);
    for (std::size_t i = begin; i < end; ++i) {
      cell[i - begin] = grid.index(grid.place(particles, i));
      ++first[cell[i - begin] + 1];
    }
    std::partial_sum(first.begin(), first.end(), first.begin());
    std::vector<std::size_t> fill(first.begin(), first.end() - 1);
    // A Pack may be read at the last one.
    for (auto& values : x) values.resize(end - begin + Pack::width);
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t k = fill[cell[i - begin]]++;
      member[k] = static_cast<std::int32_t>(i);
      for (std::size_t d = 0; d < Dim; ++d) x[d][k] = particles.x[d][i];
    }
  }
};

/// The cells within reach of a cluster along one axis: with their image, -1, 0 or 1.
struct Span {
  long low = 0, high = 0;  ///< unwrapped, both included
};

}  // namespace

template <int Dim>
void Patches::build(const Particles<Dim>& particles, const Period<Dim>& period, double reach) {
  // Narrow ones see the flow's shear in less of a difference, and let fast particles go less far.
  const Grid<Dim> grid(particles, period, 1.5 * reach, 1e6 + static_cast<double>(particles.size));
  const auto members_of = [&](std::size_t begin, std::size_t end) {
    Binned<Dim> binned(grid, particles, begin, end);
    return Members{std::move(binned.first), std::move(binned.member)};
  };
  interior_ = members_of(0, particles.interior);
  walls_ = members_of(particles.interior, particles.size);
  count_ = grid.cells;
  periodic_ = grid.periodic;
  reach_ = reach;
  width_ = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < Dim; ++k)
    if (count_[k] > 1) width_ = std::min(width_, grid.cell.c[k]);
  boxes_.resize(grid.count());
}

/// One of the 27 patches around a patch, itself being direction 13; the patch itself where there is none.
std::size_t Patches::neighbour(std::size_t patch, std::size_t direction) const {
  std::size_t result = 0, stride = 1, rest = patch;
  for (std::size_t k = 0; k < 3; ++k, direction /= 3) {
    const long along = static_cast<long>(rest) % count_[k];
    rest /= static_cast<std::size_t>(count_[k]);
    long there = along + static_cast<long>(direction % 3) - 1;
    if (periodic_[k]) there = (there + count_[k]) % count_[k];
    if (there < 0 || there >= count_[k]) return patch;
    result += static_cast<std::size_t>(there) * stride;
    stride *= static_cast<std::size_t>(count_[k]);
  }
  return result;
}

template <int Dim>
bool Patches::worn_out(const Particles<Dim>& particles, const std::array<Column, std::size_t{Dim}>& listed,
                       double skin, bool walls_move) {
  constexpr double infinity = std::numeric_limits<double>::infinity();
  const auto unite = [](Box a, const Box& b) {
    for (std::size_t k = 0; k < Dim; ++k)
      a.low[k] = std::min(a.low[k], b.low[k]), a.high[k] = std::max(a.high[k], b.high[k]);
    a.empty = a.empty && b.empty;
    a.unknown += b.unknown;
    return a;
  };
  const auto diagonal = [](const Box& box) {
    double square = box.unknown;
    for (std::size_t k = 0; k < Dim && !box.empty; ++k)
      square += (box.high[k] - box.low[k]) * (box.high[k] - box.low[k]);
    return std::sqrt(square);
  };
  constexpr Box nothing{{infinity, infinity, infinity}, {-infinity, -infinity, -infinity}, true, 0};
  constexpr Box still{{0, 0, 0}, {0, 0, 0}, false, 0};
  for_particles(0, boxes_.size(), [&](std::size_t p) {
    Box box = nothing;
    const auto hold = [&](const Members& members) {
      for (std::size_t n = members.first[p]; n < members.first[p + 1]; ++n) {
        const auto i = static_cast<std::size_t>(members.particle[n]);
        for (std::size_t k = 0; k < Dim; ++k) {
          const double moved = particles.x[k][i] - listed[k][i];
          box.low[k] = std::min(box.low[k], moved), box.high[k] = std::max(box.high[k], moved);
          box.unknown += 0 * moved;
        }
        box.empty = false;
      }
    };
    hold(interior_);
    if (walls_move)
      hold(walls_);
    else if (walls_.first[p] < walls_.first[p + 1])
      box = unite(box, still);
    boxes_[p] = box;
  });
  Box all = nothing;
  for (const Box& box : boxes_) all = unite(all, box);
  // Written so that a NaN fails closed.
  if (!(diagonal(all) < width_ - (reach_ - skin))) return true;
  bool worn = false;
#pragma omp parallel for schedule(static) reduction(|| : worn)
  for (std::size_t p = 0; p < boxes_.size(); ++p) {
    if (boxes_[p].empty) continue;
    // Half of the directions: the other half is that of the neighbours.
    for (std::size_t direction = Dim == 2 ? 9 : 0; direction <= 13; ++direction)
      worn = worn || !(diagonal(unite(boxes_[p], boxes_[neighbour(p, direction)])) < skin);
  }
  return worn;
}

std::size_t Patches::bytes() const {
  std::size_t total = boxes_.capacity() * sizeof(Box);
  for (const Members* members : {&interior_, &walls_})
    total +=
        members->first.capacity() * sizeof(std::size_t) + members->particle.capacity() * sizeof(std::int32_t);
  return total;
}

template <int Dim>
void PairList::build(const Particles<Dim>& particles, const Period<Dim>& period, double reach,
                     Wanted wanted) {
  for (int k = 0; k < Dim; ++k)
    if (std::isfinite(period.length[k]) && period.length[k] < 3 * reach)
      throw NumericalError(
          fmt::format("the periodic length {:g} m is below three times the reach of a particle, {:g} m",
                      period.length[k], reach));
  if (particles.size > Neighbour::most_particles)
    throw UsageError(fmt::format("{} particles are more than a list can number, {}", particles.size,
                                 Neighbour::most_particles));
  // Cells of half the reach: a search looks at fewer particles that are too far.
  const Grid<Dim> grid(particles, period, 0.5 * reach, 1e6 + 8 * static_cast<double>(particles.size));
  interior_ = particles.interior;
  size_ = particles.size;
  const auto clusters_of = [](std::size_t n) { return (n + Pack::width - 1) / Pack::width; };
  interior_clusters_ = clusters_of(interior_);
  for (std::size_t image = 0; image < Neighbour::images; ++image) {
    std::size_t code = image;
    for (std::size_t k = 0; k < 3; ++k, code /= 3)
      shifts_[image][k] = k < Dim && code % 3 != 1
                              ? (static_cast<double>(code % 3) - 1) * period.length[static_cast<int>(k)]
                              : 0.0;
  }
  const Binned<Dim> interior(grid, particles, 0, interior_), walls(grid, particles, interior_, size_);
  patches_.build(particles, period, reach);
  const double reach2 = reach * reach;

  // Appends every particle of `of` that is near a member of the cluster to the first `count` of `found`. A
  // row of cells along the first axis is one stretch of memory, which is looked through Pack::width particles
  // at a time.
  const auto search = [&](const Cluster& cluster, const Binned<Dim>& of, std::vector<Neighbour>& found,
                          std::size_t& count) {
    if (of.member.empty()) return;
    const Vec<Dim, Pack> x = particles.position(cluster);
    Vec<Dim> low, high;
    std::array<Span, 3> span;
    for (std::size_t k = 0; k < Dim; ++k) {
      low.c[k] = high.c[k] = x.c[k][0];
      for (std::size_t lane = 1; lane < Pack::width; ++lane)
        low.c[k] = std::min(low.c[k], x.c[k][lane]), high.c[k] = std::max(high.c[k], x.c[k][lane]);
      span[k] = {grid.along(k, low.c[k] - reach), grid.along(k, high.c[k] + reach)};
      if (!grid.periodic[k])
        span[k] = {std::clamp(span[k].low, 0L, grid.cells[k] - 1),
                   std::clamp(span[k].high, 0L, grid.cells[k] - 1)};
    }
    const auto row = [&](std::size_t first, std::size_t last, std::size_t image) {
      if (found.size() < count + (last - first) + 1) found.resize(2 * (count + (last - first) + 1));
      for (std::size_t n = first; n < last; n += Pack::width) {
        Vec<Dim, Pack> there;
        for (std::size_t k = 0; k < Dim; ++k) there.c[k] = Pack::load(&of.x[k][n]) + shifts_[image][k];
        Pack nearest = std::numeric_limits<double>::infinity();
        for (std::size_t lane = 0; lane < cluster.count; ++lane) {
          const Vec<Dim, Pack> r = there - broadcast(lane_of(x, lane));
          const Pack square = dot(r, r);
          nearest = select(square < nearest, square, nearest);
        }
        const Mask near = nearest < Pack(reach2);
        // Written in any case and kept if near: a branch here would be foretold wrongly half of the time.
        for (std::size_t k = 0; k < std::min(Pack::width, last - n); ++k) {
          found[count] = Neighbour(static_cast<std::size_t>(of.member[n + k]), image);
          count += near[k] ? 1 : 0;
        }
      }
    };
    std::array<long, 3> c{};
    for (c[2] = span[2].low; c[2] <= span[2].high; ++c[2])
      for (c[1] = span[1].low; c[1] <= span[1].high; ++c[1]) {
        // How far the row is from the box around the cluster, across its own axis: the farther, the less of
        // it.
        double across = 0;
        for (std::size_t k = 1; k < Dim; ++k) {
          const double begin = grid.low.c[k] + static_cast<double>(c[k]) * grid.cell.c[k];
          // The outermost cells of an axis that is not periodic hold what rounding puts beyond them, too.
          const double beyond = positive(begin - high.c[k]) + positive(low.c[k] - begin - grid.cell.c[k]);
          across += beyond * beyond;
        }
        if (!(across < reach2)) continue;
        const double along = std::sqrt(reach2 - across) + 1e-9 * reach;
        std::array<long, 3> wrapped = c;
        std::array<std::size_t, 3> code{1, 1, 1};
        for (std::size_t k = 1; k < 3; ++k) {
          if (grid.periodic[k] && c[k] < 0) wrapped[k] += grid.cells[k], code[k] = 0;
          if (grid.periodic[k] && c[k] >= grid.cells[k]) wrapped[k] -= grid.cells[k], code[k] = 2;
        }
        const Span row_span{std::max(span[0].low, grid.along(0, low[0] - along)),
                            std::min(span[0].high, grid.along(0, high[0] + along))};
        for (code[0] = grid.periodic[0] ? 0 : 1; code[0] < (grid.periodic[0] ? 3U : 2U); ++code[0]) {
          // The part of the row that lies in this image.
          const long shift = (static_cast<long>(code[0]) - 1) * grid.cells[0];
          const long first = std::max(row_span.low, shift),
                     last = std::min(row_span.high, shift + grid.cells[0] - 1);
          if (first > last) continue;
          wrapped[0] = first - shift;
          const std::size_t cell = grid.index(wrapped);
          row(of.first[cell], of.first[cell + static_cast<std::size_t>(last - first) + 1],
              code[0] + 3 * code[1] + 9 * code[2]);
        }
      }
  };

  // Each thread lists a block of clusters; the blocks are joined in order.
  constexpr std::size_t block = 64;
  const std::size_t all = interior_clusters_ + clusters_of(size_ - interior_);
  const std::size_t blocks = (all + block - 1) / block;
  start_.assign(all + 1, 0);
  split_.assign(all, 0);
  std::vector<std::vector<Neighbour>> parts(blocks);
#pragma omp parallel
  {
    std::vector<Neighbour> found;
#pragma omp for schedule(dynamic)
    for (std::size_t b = 0; b < blocks; ++b) {
      std::size_t count = 0;
      for (std::size_t k = b * block; k < std::min(all, (b + 1) * block); ++k) {
        const Cluster a = cluster(k);
        const bool wall = a.first >= interior_;
        const std::size_t before = count;
        const auto group_images = [&](std::size_t from) {
          const auto image = [](Neighbour l, Neighbour r) { return l.image() < r.image(); };
          const auto first = found.begin() + static_cast<std::ptrdiff_t>(from),
                     last = found.begin() + static_cast<std::ptrdiff_t>(count);
          if (!std::is_sorted(first, last, image)) std::stable_sort(first, last, image);
        };
        if (!wall || wanted.wall_sees_interior) search(a, interior, found, count);
        group_images(before);
        split_[k] = count - before;
        if (!wall || wanted.wall_sees_wall) search(a, walls, found, count);
        group_images(before + split_[k]);
        start_[k + 1] = count - before;
      }
      parts[b].assign(found.begin(), found.begin() + static_cast<std::ptrdiff_t>(count));
    }
  }
  std::partial_sum(start_.begin(), start_.end(), start_.begin());
  for (std::size_t k = 0; k < all; ++k) split_[k] += start_[k];
  neighbours_.resize(start_.back());
#pragma omp parallel for schedule(static)
  for (std::size_t b = 0; b < blocks; ++b)
    std::copy(parts[b].begin(), parts[b].end(),
              neighbours_.begin() + static_cast<std::ptrdiff_t>(start_[b * block]));
}

namespace {

/// The bits of a number with Dim - 1 zeros after each: doubled gaps, halved runs.
template <int Dim>
std::uint64_t spread(std::uint64_t bits) {
  if constexpr (Dim == 2) {
    bits = (bits | bits << 16U) & 0x0000FFFF0000FFFFU;
    bits = (bits | bits << 8U) & 0x00FF00FF00FF00FFU;
    bits = (bits | bits << 4U) & 0x0F0F0F0F0F0F0F0FU;
    bits = (bits | bits << 2U) & 0x3333333333333333U;
    return (bits | bits << 1U) & 0x5555555555555555U;
  } else {
    bits = (bits | bits << 32U) & 0x001F00000000FFFFU;
    bits = (bits | bits << 16U) & 0x001F0000FF0000FFU;
    bits = (bits | bits << 8U) & 0x100F00F00F00F00FU;
    bits = (bits | bits << 4U) & 0x10C30C30C30C30C3U;
    return (bits | bits << 2U) & 0x1249249249249249U;
  }
}

/// Place of a cell along Hilbert's curve through 2^bits cells a side (Skilling, AIP Conf. Proc. 707, 381,
/// 2004): cells that follow each other share a face, at any scale.
template <int Dim>
std::uint64_t along_curve(std::array<std::uint64_t, std::size_t{Dim}> x, int bits) {
  const std::uint64_t top = std::uint64_t{1} << static_cast<unsigned>(bits - 1);
  for (std::uint64_t bit = top; bit > 1; bit /= 2)
    for (std::uint64_t& axis : x) {
      const std::uint64_t swapped =
          axis & bit ? bit - 1 : 0;  // inverts the first axis, or swaps it with this
      const std::uint64_t exchanged = (x[0] ^ axis) & (bit - 1) & ~swapped;
      x[0] ^= swapped | exchanged;
      axis ^= exchanged;
    }
  for (std::size_t k = 1; k < Dim; ++k) x[k] ^= x[k - 1];
  std::uint64_t gray = 0;
  for (std::uint64_t bit = top; bit > 1; bit /= 2)
    if (x[Dim - 1] & bit) gray ^= bit - 1;
  std::uint64_t place = 0;
  for (std::size_t k = 0; k < Dim; ++k) place |= spread<Dim>(x[k] ^ gray) << (Dim - 1 - k);
  return place;
}

}  // namespace

template <int Dim>
std::vector<std::int32_t> spatial_order(const Particles<Dim>& particles, double cell) {
  constexpr int most_bits = Dim == 2 ? 31 : 20;
  std::array<double, std::size_t{Dim}> low{};
  double largest = 1;
  for (std::size_t k = 0; k < Dim && particles.size > 0; ++k) {
    const auto [first, last] = std::minmax_element(particles.x[k].begin(), particles.x[k].end());
    // Half a cell before the first: particles of a lattice lie in the middle of their cells.
    low[k] = *first - 0.5 * cell;
    largest = std::max(largest, (*last - low[k]) / cell);
  }
  const int bits = std::min(most_bits, 1 + std::ilogb(std::min(largest, std::ldexp(1.0, most_bits))));
  std::vector<std::pair<std::uint64_t, std::int32_t>> keys(particles.size);
  for_particles(0, particles.size, [&](std::size_t i) {
    std::array<std::uint64_t, std::size_t{Dim}> at;
    for (std::size_t k = 0; k < Dim; ++k)
      at[k] = static_cast<std::uint64_t>(
          std::clamp((particles.x[k][i] - low[k]) / cell, 0.0, std::ldexp(1.0, bits) - 1));
    keys[i] = {along_curve<Dim>(at, bits), static_cast<std::int32_t>(i)};
  });
  const auto middle = keys.begin() + static_cast<std::ptrdiff_t>(particles.interior);
  std::sort(keys.begin(), middle);
  std::sort(middle, keys.end());
  std::vector<std::int32_t> order(particles.size);
  std::transform(keys.begin(), keys.end(), order.begin(), [](const auto& key) { return key.second; });
  return order;
}

template bool Patches::worn_out(const Particles<2>&, const std::array<Column, 2>&, double, bool);
template bool Patches::worn_out(const Particles<3>&, const std::array<Column, 3>&, double, bool);
template void PairList::build(const Particles<2>&, const Period<2>&, double, Wanted);
template void PairList::build(const Particles<3>&, const Period<3>&, double, Wanted);
template std::vector<std::int32_t> spatial_order(const Particles<2>&, double);
template std::vector<std::int32_t> spatial_order(const Particles<3>&, double);

}  // namespace dem2sph
