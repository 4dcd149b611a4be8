// Loops over particles: in parallel, with sums whose order does not depend on the number of threads.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

namespace dem2sph {

/// Calls f(i) for i in [begin, end), in parallel.
template <class F>
void for_particles(std::size_t begin, std::size_t end, F&& f) {
#pragma omp parallel for schedule(static)
  for (std::size_t i = begin; i < end; ++i) f(i);
}

/// Sums over particles, of numbers or of packs: f(i, sums) adds to `sums`. Blocks of fixed size are summed by
/// themselves and then in order.
template <std::size_t N, class Real = double, class F>
std::array<Real, N> sum_over(std::size_t begin, std::size_t end, F&& f) {
  constexpr std::size_t block = 256;
  const std::size_t blocks = (end - begin + block - 1) / block;
  std::vector<std::array<Real, N>> parts(blocks);
#pragma omp parallel for schedule(static)
  for (std::size_t k = 0; k < blocks; ++k) {
    std::array<Real, N> sums{};
    const std::size_t last = std::min(end, begin + (k + 1) * block);
    for (std::size_t i = begin + k * block; i < last; ++i) f(i, sums);
    parts[k] = sums;
  }
  std::array<Real, N> total{};
  for (const auto& part : parts)
    for (std::size_t n = 0; n < N; ++n) total[n] += part[n];
  return total;
}

}  // namespace dem2sph
