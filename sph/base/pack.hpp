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

/// True or false in each lane.
struct Mask {
  using Register = long long __attribute__((vector_size(4 * sizeof(long long))));
  Register lanes;
  [[gnu::always_inline]] bool operator[](std::size_t lane) const { return lanes[lane] != 0; }
  [[gnu::always_inline]] friend Mask operator&(Mask a, Mask b) { return {a.lanes & b.lanes}; }
  [[gnu::always_inline]] bool any() const {
#ifdef __AVX__
    return __builtin_ia32_ptestz256(lanes, lanes) == 0;
#else
    return (lanes[0] | lanes[1] | lanes[2] | lanes[3]) != 0;
#endif
  }
};

class Pack {
 public:
  static constexpr std::size_t width = 4;
  using Register = double __attribute__((vector_size(width * sizeof(double))));

  [[gnu::always_inline]] Pack() : lanes_{} {}
  /// The same number in every lane.
  [[gnu::always_inline]] Pack(double same) : lanes_{same, same, same, same} {}
  [[gnu::always_inline]] explicit Pack(Register lanes) : lanes_(lanes) {}
  /// Four numbers from memory, wherever they begin.
  [[gnu::always_inline]] static Pack load(const double* from) {
    Register lanes;
    std::memcpy(&lanes, from, sizeof lanes);
    return Pack(lanes);
  }
  [[gnu::always_inline]] void store(double* to) const { std::memcpy(to, &lanes_, sizeof lanes_); }

  [[gnu::always_inline]] double operator[](std::size_t lane) const { return lanes_[lane]; }
  [[gnu::always_inline]] void set(std::size_t lane, double value) { lanes_[lane] = value; }
  /// Lanes in order.
  [[gnu::always_inline]] double sum() const { return lanes_[0] + lanes_[1] + lanes_[2] + lanes_[3]; }

  [[gnu::always_inline]] Pack& operator+=(Pack o) { return lanes_ += o.lanes_, *this; }
  [[gnu::always_inline]] Pack& operator-=(Pack o) { return lanes_ -= o.lanes_, *this; }
  [[gnu::always_inline]] Pack& operator*=(Pack o) { return lanes_ *= o.lanes_, *this; }
  [[gnu::always_inline]] friend Pack operator+(Pack a, Pack b) { return Pack(a.lanes_ + b.lanes_); }
  [[gnu::always_inline]] friend Pack operator-(Pack a, Pack b) { return Pack(a.lanes_ - b.lanes_); }
  [[gnu::always_inline]] friend Pack operator*(Pack a, Pack b) { return Pack(a.lanes_ * b.lanes_); }
  [[gnu::always_inline]] friend Pack operator/(Pack a, Pack b) { return Pack(a.lanes_ / b.lanes_); }
  [[gnu::always_inline]] friend Pack operator-(Pack a) { return Pack(-a.lanes_); }
  [[gnu::always_inline]] friend Mask operator<(Pack a, Pack b) { return mask(a.lanes_ < b.lanes_); }
  [[gnu::always_inline]] friend Mask operator>(Pack a, Pack b) { return mask(a.lanes_ > b.lanes_); }

  [[gnu::always_inline]] friend Pack select(Mask m, Pack yes, Pack no) {
    return Pack(m.lanes ? yes.lanes_ : no.lanes_);
  }
  [[gnu::always_inline]] friend Pack sqrt(Pack a) {
    Register root;
    for (std::size_t k = 0; k < width; ++k) root[k] = std::sqrt(a.lanes_[k]);
    return Pack(root);
  }

 private:
  template <class Bits>
  [[gnu::always_inline]] static Mask mask(Bits bits) {
    return {(Mask::Register)bits};
  }
  Register lanes_;
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
