// The standard error of a mean, or of a ratio of means, from a series whose samples are not independent.
//
// Neighbouring frames of a sheared packing resemble each other, so sd/sqrt(n) is too small. Cut the series
// into blocks and leave out one block at a time: blocks much longer than the memory of the series are nearly
// independent. Small number: for a series with correlation 0.9 from one sample to the next, the error of the
// mean is sqrt((1 + 0.9)/(1 - 0.9)) = 4.4 times sd/sqrt(n); blocks of 1 see a factor of 1, blocks of 8 one
// of 2.5, blocks of 64 one of 4.0, and there it levels off. So blocks are doubled until the error is flat.
//
// When is it flat? R. M. Lee et al., Phys. Rev. E 83, 066706 (2011): a block length B is long enough once
// B^3 > 2 n (se_B/se_1)^4. Then one more doubling must not raise the error by more than its own uncertainty,
// 1/sqrt(2 (blocks - 1)).
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

namespace dem2sph::bridge {

struct Estimate {
  double value = 0;
  double standard_error = 0;
  std::size_t block = 1;  ///< samples in a block
  bool flat = false;      ///< false: the series is too short to tell; the error is the largest seen
};

/// Fewer blocks than this say little about their own scatter (its error would exceed 1/sqrt(2 * 7) = 27 %).
inline constexpr std::size_t fewest_blocks = 8;

/// `statistic` maps the means of the columns to the number wanted, for example mu = mean(tau)/mean(p): a
/// ratio of sums, whose error then contains the correlation of numerator and denominator.
template <std::size_t Columns, class Statistic>
Estimate block_jackknife(std::span<const std::array<double, Columns>> rows, Statistic&& statistic) {
  using Row = std::array<double, Columns>;
  const auto mean_of = [](const Row& sums, double count) {
    Row means = sums;
    for (double& m : means) m /= count;
    return means;
  };
  Row total{};
  for (const Row& row : rows)
    for (std::size_t k = 0; k < Columns; ++k) total[k] += row[k];

  Estimate estimate;
  const auto n = static_cast<double>(rows.size());
  estimate.value = statistic(mean_of(total, n));

  std::vector<double> errors;  // at block lengths 1, 2, 4, ...
  for (std::size_t block = 1; rows.size() / block >= fewest_blocks; block *= 2) {
    const std::size_t blocks = rows.size() / block;
    Row kept{};
    std::vector<Row> sums(blocks, Row{});
    for (std::size_t i = 0; i < blocks * block; ++i)
      for (std::size_t k = 0; k < Columns; ++k) {
        sums[i / block][k] += rows[i][k];
        kept[k] += rows[i][k];
      }
    std::vector<double> without(blocks);
    double mean = 0;
    for (std::size_t b = 0; b < blocks; ++b) {
      Row rest = kept;
      for (std::size_t k = 0; k < Columns; ++k) rest[k] -= sums[b][k];
      without[b] = statistic(mean_of(rest, static_cast<double>((blocks - 1) * block)));
      mean += without[b] / static_cast<double>(blocks);
    }
    double square = 0;
    for (const double w : without) square += (w - mean) * (w - mean);
    errors.push_back(std::sqrt(square * static_cast<double>(blocks - 1) / static_cast<double>(blocks)));
  }
  if (errors.empty()) {  // too few samples for any error: unset is NaN, never a plausible number
    estimate.standard_error = std::nan("");
    return estimate;
  }

  std::size_t largest = 0;
  for (std::size_t level = 0; level < errors.size(); ++level) {
    if (errors[level] > errors[largest]) largest = level;
    const auto length = static_cast<double>(std::size_t{1} << level);
    const double growth = errors[0] > 0 ? errors[level] / errors[0] : 1;
    const bool long_enough = length * length * length > 2 * n * std::pow(growth, 4);
    if (!long_enough) continue;
    // Compared with the next doubling; the last level, which has none, with the one before it.
    const bool last = level + 1 == errors.size();
    if (last && level == 0) break;
    const double before = last ? errors[level - 1] : errors[level];
    const double after = last ? errors[level] : errors[level + 1];
    const double blocks = std::floor(n / (last ? length : 2 * length));
    if (after <= before * (1 + 1 / std::sqrt(2 * (blocks - 1)))) {
      estimate.standard_error = errors[level];
      estimate.block = std::size_t{1} << level;
      estimate.flat = true;
      return estimate;
    }
  }
  estimate.standard_error = errors[largest];
  estimate.block = std::size_t{1} << largest;
  return estimate;
}

}  // namespace dem2sph::bridge
