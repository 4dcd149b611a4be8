// Four numbers side by side, for one instruction on all of them: what the lanes of a cluster of particles
// hold.
//
// GCC's vector extension does the work, so the same source becomes AVX2 or, in the build for any x86-64,
// pairs of SSE2. `select` and `positive` exist for plain numbers too: a function that is written with them
// takes either.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>

namespace dem2sph {

/// A Pack in registers: one where the CPU has them wide enough, else two.
struct Lanes {
  static constexpr std::size_t width = 4;
#ifdef __AVX__
  static constexpr std::size_t parts = 1;
#else
  static constexpr std::size_t parts = 2;
#endif
  static constexpr std::size_t in_part = width / parts;
  using Numbers = double __attribute__((vector_size(in_part * sizeof(double))));
  using Bits = long long __attribute__((vector_size(in_part * sizeof(long long))));
};

/// True or false in each lane.
struct Mask {
  Lanes::Bits part[Lanes::parts];
  [[gnu::always_inline]] bool operator[](std::size_t lane) const {
    return part[lane / Lanes::in_part][lane % Lanes::in_part] != 0;
  }
  [[gnu::always_inline]] friend Mask operator&(Mask a, const Mask& b) {
    for (std::size_t k = 0; k < Lanes::parts; ++k) a.part[k] &= b.part[k];
    return a;
  }
  [[gnu::always_inline]] friend Mask operator|(Mask a, const Mask& b) {
    for (std::size_t k = 0; k < Lanes::parts; ++k) a.part[k] |= b.part[k];
    return a;
  }
  /// True in some lane.
  [[gnu::always_inline]] friend bool any(const Mask& m) {
    for (std::size_t lane = 0; lane < Lanes::width; ++lane)
      if (m[lane]) return true;
    return false;
  }
};

class Pack {
 public:
  static constexpr std::size_t width = Lanes::width;

  [[gnu::always_inline]] Pack() : Pack(0.0) {}
  /// The same number in every lane.
  [[gnu::always_inline]] Pack(double same) {
#ifdef __AVX__
    part_[0] = Lanes::Numbers{same, same, same, same};
#else
    part_[0] = part_[1] = Lanes::Numbers{same, same};
#endif
  }
  /// Four numbers from memory, wherever they begin.
  [[gnu::always_inline]] static Pack load(const double* from) {
    Pack pack;
    for (std::size_t k = 0; k < Lanes::parts; ++k)
      std::memcpy(&pack.part_[k], from + k * Lanes::in_part, sizeof(Lanes::Numbers));
    return pack;
  }
  [[gnu::always_inline]] void store(double* to) const {
    for (std::size_t k = 0; k < Lanes::parts; ++k)
      std::memcpy(to + k * Lanes::in_part, &part_[k], sizeof(Lanes::Numbers));
  }

  [[gnu::always_inline]] double operator[](std::size_t lane) const {
    return part_[lane / Lanes::in_part][lane % Lanes::in_part];
  }
  [[gnu::always_inline]] void set(std::size_t lane, double value) {
    part_[lane / Lanes::in_part][lane % Lanes::in_part] = value;
  }
  /// Lanes in order.
  [[gnu::always_inline]] double sum() const {
    double total = 0;
    for (std::size_t lane = 0; lane < width; ++lane) total += (*this)[lane];
    return total;
  }

  [[gnu::always_inline]] friend Pack operator+(Pack a, Pack b) {
    return each(a, b, [](Lanes::Numbers l, Lanes::Numbers r) { return l + r; });
  }
  [[gnu::always_inline]] friend Pack operator-(Pack a, Pack b) {
    return each(a, b, [](Lanes::Numbers l, Lanes::Numbers r) { return l - r; });
  }
  [[gnu::always_inline]] friend Pack operator*(Pack a, Pack b) {
    return each(a, b, [](Lanes::Numbers l, Lanes::Numbers r) { return l * r; });
  }
  [[gnu::always_inline]] friend Pack operator/(Pack a, Pack b) {
    return each(a, b, [](Lanes::Numbers l, Lanes::Numbers r) { return l / r; });
  }
  [[gnu::always_inline]] friend Pack operator-(Pack a) {
    return each(a, a, [](Lanes::Numbers l, Lanes::Numbers) { return -l; });
  }
  [[gnu::always_inline]] Pack& operator+=(Pack o) { return *this = *this + o; }
  [[gnu::always_inline]] Pack& operator-=(Pack o) { return *this = *this - o; }
  [[gnu::always_inline]] Pack& operator*=(Pack o) { return *this = *this * o; }

  [[gnu::always_inline]] friend Mask operator<(Pack a, Pack b) {
    Mask mask;
    for (std::size_t k = 0; k < Lanes::parts; ++k) mask.part[k] = (Lanes::Bits)(a.part_[k] < b.part_[k]);
    return mask;
  }
  [[gnu::always_inline]] friend Mask operator>(Pack a, Pack b) { return b < a; }
  [[gnu::always_inline]] friend Mask operator<=(Pack a, Pack b) {
    Mask mask;
    for (std::size_t k = 0; k < Lanes::parts; ++k) mask.part[k] = (Lanes::Bits)(a.part_[k] <= b.part_[k]);
    return mask;
  }
  [[gnu::always_inline]] friend Mask operator==(Pack a, Pack b) {
    Mask mask;
    for (std::size_t k = 0; k < Lanes::parts; ++k) mask.part[k] = (Lanes::Bits)(a.part_[k] == b.part_[k]);
    return mask;
  }

  [[gnu::always_inline]] friend Pack select(Mask m, Pack yes, Pack no) {
    Pack result;
    for (std::size_t k = 0; k < Lanes::parts; ++k) result.part_[k] = m.part[k] ? yes.part_[k] : no.part_[k];
    return result;
  }
  [[gnu::always_inline]] friend Pack sqrt(Pack a) {
    Pack root;
    for (std::size_t k = 0; k < Lanes::parts; ++k)
      for (std::size_t lane = 0; lane < Lanes::in_part; ++lane)
        root.part_[k][lane] = std::sqrt(a.part_[k][lane]);
    return root;
  }

  /// f(lane) in every lane: for what takes one number at a time.
  template <class F>
  [[gnu::always_inline]] static Pack lane_by_lane(F&& f) {
    Pack result;
    for (std::size_t lane = 0; lane < width; ++lane) result.set(lane, f(lane));
    return result;
  }
  friend Pack pow(const Pack& a, double exponent) {
    return lane_by_lane([&](std::size_t lane) { return std::pow(a[lane], exponent); });
  }

 private:
  template <class F>
  [[gnu::always_inline]] static Pack each(const Pack& a, const Pack& b, F f) {
    Pack result;
    for (std::size_t k = 0; k < Lanes::parts; ++k) result.part_[k] = f(a.part_[k], b.part_[k]);
    return result;
  }
  Lanes::Numbers part_[Lanes::parts];
};

[[gnu::always_inline]] inline double select(bool m, double yes, double no) { return m ? yes : no; }

/// x where it is positive, else 0; NaN stays (std::fmax would hide it).
template <class Real>
[[gnu::always_inline]] inline Real positive(Real x) {
  return select(x < Real(0), Real(0), x);
}
/// x where it is negative, else 0; NaN stays.
template <class Real>
[[gnu::always_inline]] inline Real negative(Real x) {
  return select(x > Real(0), Real(0), x);
}

}  // namespace dem2sph
