#include "sph/neighbours.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

// A grid of cells over the particles' bounding box; periodic directions hold a whole number of cells.
template <int Dim>
struct Grid {
  Vec<Dim> low;
  Vec<Dim> inverse_cell;
  std::array<long, 3> cells{1, 1, 1};
  std::array<bool, 3> periodic{false, false, false};

  Grid(const Particles<Dim>& particles, const Period<Dim>& period, double cell) {
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
      const double length = periodic[axis] ? period.length[k] : highest - lowest;
      if (periodic[axis] && length < 3 * cell)
        throw NumericalError(fmt::format(
            "the periodic length {:g} m is below three times the reach of a particle, {:g} m", length, cell));
      // Far fliers must not make the grid larger than memory: cells may be wider than asked.
      cells[axis] = std::clamp(static_cast<long>(length / cell), 1L, 4096L);
      inverse_cell[k] = length > 0 ? static_cast<double>(cells[axis]) / length : 0;
    }
  }
  std::size_t count() const { return static_cast<std::size_t>(cells[0] * cells[1] * cells[2]); }
  std::array<long, 3> place(const Particles<Dim>& particles, std::size_t i) const {
    std::array<long, 3> c{0, 0, 0};
    for (std::size_t k = 0; k < Dim; ++k) {
      const double at = (particles.x[k][i] - low.c[k]) * inverse_cell.c[k];
      c[k] = std::clamp(static_cast<long>(std::floor(at)), 0L, cells[k] - 1);
    }
    return c;
  }
  std::size_t index(const std::array<long, 3>& c) const {
    return static_cast<std::size_t>((c[2] * cells[1] + c[1]) * cells[0] + c[0]);
  }
};

}  // namespace

template <int Dim>
void PairList::build(const Particles<Dim>& particles, const Period<Dim>& period, double reach,
                     Wanted wanted) {
  const Grid<Dim> grid(particles, period, reach);
  const std::size_t n = particles.size;

  // Particles by cell (counting sort), so that a cell's members are contiguous.
  std::vector<std::size_t> first(grid.count() + 1, 0);
  std::vector<std::size_t> cell_of(n);
  for (std::size_t i = 0; i < n; ++i) {
    cell_of[i] = grid.index(grid.place(particles, i));
    ++first[cell_of[i] + 1];
  }
  std::partial_sum(first.begin(), first.end(), first.begin());
  std::vector<std::int32_t> members(n);
  {
    std::vector<std::size_t> fill(first.begin(), first.end() - 1);
    for (std::size_t i = 0; i < n; ++i) members[fill[cell_of[i]]++] = static_cast<std::int32_t>(i);
  }

  // Members of a cell are in ascending order, so interior ones come before walls.
  const auto visit = [&](std::size_t a, auto&& take) {
    const bool wall = a >= particles.interior;
    if (wall && !wanted.wall_sees_interior && !wanted.wall_sees_wall) return;
    const Vec<Dim> xa = particles.position(a);
    const std::array<long, 3> at = grid.place(particles, a);
    const double reach2 = reach * reach;
    for (long dz = Dim == 3 ? -1 : 0; dz <= (Dim == 3 ? 1 : 0); ++dz)
      for (long dy = -1; dy <= 1; ++dy)
        for (long dx = -1; dx <= 1; ++dx) {
          std::array<long, 3> c{at[0] + dx, at[1] + dy, at[2] + dz};
          bool inside = true;
          for (std::size_t k = 0; k < 3; ++k) {
            if (grid.periodic[k]) c[k] = (c[k] + grid.cells[k]) % grid.cells[k];
            inside = inside && c[k] >= 0 && c[k] < grid.cells[k];
          }
          if (!inside) continue;
          const std::size_t cell = grid.index(c);
          for (std::size_t k = first[cell]; k < first[cell + 1]; ++k) {
            const auto b = static_cast<std::size_t>(members[k]);
            if (b == a) continue;
            const bool b_wall = b >= particles.interior;
            if (wall && (b_wall ? !wanted.wall_sees_wall : !wanted.wall_sees_interior)) continue;
            const Vec<Dim> r = period.shortest(xa - particles.position(b));
            if (dot(r, r) < reach2) take(b, b_wall);
          }
        }
  };

  start_.assign(n + 1, 0);
  split_.assign(n, 0);
#pragma omp parallel for schedule(static)
  for (std::size_t a = 0; a < n; ++a) {
    std::size_t inside = 0;
    std::size_t walls = 0;
    visit(a, [&](std::size_t, bool b_wall) { ++(b_wall ? walls : inside); });
    start_[a + 1] = inside + walls;
    split_[a] = inside;
  }
  std::partial_sum(start_.begin(), start_.end(), start_.begin());
  pairs_.resize(start_.back() + 1);  // one more, so that the address of the end exists
#pragma omp parallel for schedule(static)
  for (std::size_t a = 0; a < n; ++a) {
    split_[a] += start_[a];
    std::size_t inside = start_[a];
    std::size_t walls = split_[a];
    visit(a, [&](std::size_t b, bool b_wall) {
      pairs_[b_wall ? walls++ : inside++] = static_cast<std::int32_t>(b);
    });
    // Ascending order: sums in memory order, the same whatever the grid.
    std::sort(pairs_.begin() + static_cast<std::ptrdiff_t>(start_[a]),
              pairs_.begin() + static_cast<std::ptrdiff_t>(split_[a]));
    std::sort(pairs_.begin() + static_cast<std::ptrdiff_t>(split_[a]),
              pairs_.begin() + static_cast<std::ptrdiff_t>(start_[a + 1]));
  }
}

template <int Dim>
std::vector<std::int32_t> spatial_order(const Particles<Dim>& particles, double cell) {
  const Grid<Dim> grid(particles, Period<Dim>{}, cell);
  std::vector<std::size_t> key(particles.size);
  for (std::size_t i = 0; i < particles.size; ++i) key[i] = grid.index(grid.place(particles, i));
  std::vector<std::int32_t> order(particles.size);
  std::iota(order.begin(), order.end(), 0);
  const auto by_cell = [&](std::int32_t a, std::int32_t b) {
    return key[static_cast<std::size_t>(a)] < key[static_cast<std::size_t>(b)];
  };
  const auto middle = order.begin() + static_cast<std::ptrdiff_t>(particles.interior);
  std::stable_sort(order.begin(), middle, by_cell);
  std::stable_sort(middle, order.end(), by_cell);
  return order;
}

template void PairList::build(const Particles<2>&, const Period<2>&, double, Wanted);
template void PairList::build(const Particles<3>&, const Period<3>&, double, Wanted);
template std::vector<std::int32_t> spatial_order(const Particles<2>&, double);
template std::vector<std::int32_t> spatial_order(const Particles<3>&, double);

}  // namespace dem2sph
