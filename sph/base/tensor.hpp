// Small vectors and symmetric tensors for inner loops: plain numbers, no allocation, no expression templates.
// `Real` is double, or Pack for several particles at once.
//
// A symmetric stress or strain rate has four independent numbers in plane strain (xx, yy, xy and the
// out-of-plane zz, which is not zero: a bed under its weight presses on the glass panes too) and six in 3D.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <type_traits>

#include "sph/base/pack.hpp"

namespace dem2sph {

template <int Dim, class Real = double>
struct Vec {
  static_assert(Dim >= 1 && Dim <= 3);
  std::array<Real, static_cast<std::size_t>(Dim)> c{};
  Real& operator[](int i) { return c[static_cast<std::size_t>(i)]; }
  const Real& operator[](int i) const { return c[static_cast<std::size_t>(i)]; }
  Vec& operator+=(const Vec& o) {
    for (int i = 0; i < Dim; ++i) (*this)[i] += o[i];
    return *this;
  }
  Vec& operator-=(const Vec& o) {
    for (int i = 0; i < Dim; ++i) (*this)[i] -= o[i];
    return *this;
  }
  Vec& operator*=(const Real& s) {
    for (int i = 0; i < Dim; ++i) (*this)[i] *= s;
    return *this;
  }
};
template <int Dim, class Real>
[[gnu::always_inline]] inline Vec<Dim, Real> operator+(Vec<Dim, Real> a, const Vec<Dim, Real>& b) {
  return a += b;
}
template <int Dim, class Real>
[[gnu::always_inline]] inline Vec<Dim, Real> operator-(Vec<Dim, Real> a, const Vec<Dim, Real>& b) {
  return a -= b;
}
template <int Dim, class Real>
[[gnu::always_inline]] inline Vec<Dim, Real> operator*(const std::type_identity_t<Real>& s,
                                                       Vec<Dim, Real> a) {
  return a *= s;
}
template <int Dim, class Real>
[[gnu::always_inline]] inline Real dot(const Vec<Dim, Real>& a, const Vec<Dim, Real>& b) {
  Real sum = 0;
  for (int i = 0; i < Dim; ++i) sum += a[i] * b[i];
  return sum;
}
template <int Dim, class Real>
[[gnu::always_inline]] inline Real norm(const Vec<Dim, Real>& a) {
  using std::sqrt;
  return sqrt(dot(a, a));
}

/// Velocity gradient L_ij = d v_i / d x_j [1/s].
template <int Dim, class Real = double>
struct Gradient {
  std::array<Real, std::size_t{Dim} * Dim> c{};
  Real& operator()(int i, int j) { return c[static_cast<std::size_t>(i * Dim + j)]; }
  const Real& operator()(int i, int j) const { return c[static_cast<std::size_t>(i * Dim + j)]; }
  Real trace() const {
    Real sum = 0;
    for (int i = 0; i < Dim; ++i) sum += (*this)(i, i);
    return sum;
  }
};

/// Symmetric tensor, diagonal first (always xx, yy, zz), then xy and, in 3D, xz, yz.
template <int Dim, class Real = double>
struct Sym {
  static_assert(Dim == 2 || Dim == 3);
  static constexpr int size = Dim == 2 ? 4 : 6;
  std::array<Real, static_cast<std::size_t>(size)> c{};
  Real& operator[](int k) { return c[static_cast<std::size_t>(k)]; }
  const Real& operator[](int k) const { return c[static_cast<std::size_t>(k)]; }

  static constexpr int index(int i, int j) {
    if (i == j) return i;
    return i + j + 2;  // (0,1) -> 3, (0,2) -> 4, (1,2) -> 5
  }
  Real& operator()(int i, int j) { return (*this)[index(i, j)]; }
  const Real& operator()(int i, int j) const { return (*this)[index(i, j)]; }

  Real trace() const { return c[0] + c[1] + c[2]; }
  /// Full contraction a:a; off-diagonal components count twice.
  Real square() const {
    Real sum = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
    for (int k = 3; k < size; ++k) sum += 2 * (*this)[k] * (*this)[k];
    return sum;
  }
  Sym& operator*=(const Real& s) {
    for (Real& v : c) v *= s;
    return *this;
  }
  Sym& operator+=(const Sym& o) {
    for (int k = 0; k < size; ++k) (*this)[k] += o[k];
    return *this;
  }
};

/// The same in every lane.
template <int Dim>
[[gnu::always_inline]] inline Vec<Dim, Pack> broadcast(const Vec<Dim>& v) {
  Vec<Dim, Pack> all;
  for (int i = 0; i < Dim; ++i) all[i] = v[i];
  return all;
}
template <int Dim>
[[gnu::always_inline]] inline Sym<Dim, Pack> broadcast(const Sym<Dim>& s) {
  Sym<Dim, Pack> all;
  for (int k = 0; k < Sym<Dim>::size; ++k) all[k] = s[k];
  return all;
}
/// What one lane holds.
template <int Dim>
[[gnu::always_inline]] inline Vec<Dim> lane_of(const Vec<Dim, Pack>& v, std::size_t lane) {
  Vec<Dim> one;
  for (int i = 0; i < Dim; ++i) one[i] = v[i][lane];
  return one;
}
template <int Dim>
[[gnu::always_inline]] inline Sym<Dim> lane_of(const Sym<Dim, Pack>& s, std::size_t lane) {
  Sym<Dim> one;
  for (int k = 0; k < Sym<Dim>::size; ++k) one[k] = s[k][lane];
  return one;
}
template <int Dim>
[[gnu::always_inline]] inline void set_lane(Vec<Dim, Pack>& v, std::size_t lane, const Vec<Dim>& one) {
  for (int i = 0; i < Dim; ++i) v[i].set(lane, one[i]);
}

/// D = sym(L), Eq. 5.2 (reconstructed, standard).
template <int Dim, class Real>
[[gnu::always_inline]] inline Sym<Dim, Real> strain_rate(const Gradient<Dim, Real>& l) {
  Sym<Dim, Real> d;
  for (int i = 0; i < Dim; ++i)
    for (int j = i; j < Dim; ++j) d(i, j) = 0.5 * (l(i, j) + l(j, i));
  return d;
}

/// D' = D - tr(D)/3, with the 3 of three dimensions in plane strain too.
template <int Dim, class Real>
[[gnu::always_inline]] inline Sym<Dim, Real> deviator(Sym<Dim, Real> d) {
  const Real mean = d.trace() / 3;
  for (int i = 0; i < 3; ++i) d[i] -= mean;
  return d;
}

/// Shear rate |g| = sqrt(2 D':D') [1/s]: in simple shear, the velocity gradient.
template <int Dim, class Real>
[[gnu::always_inline]] inline Real shear_rate(const Sym<Dim, Real>& deviatoric_rate) {
  using std::sqrt;
  return sqrt(2 * deviatoric_rate.square());
}

/// Equivalent shear stress tau = sqrt(s:s/2) [Pa].
template <int Dim, class Real>
[[gnu::always_inline]] inline Real equivalent_stress(const Sym<Dim, Real>& s) {
  using std::sqrt;
  return sqrt(0.5 * s.square());
}

}  // namespace dem2sph
