// Smoothing kernels with support 2h in one, two and three dimensions: W(r, h) and F with grad W = r F (F <=
// 0).
//
// q = r/h. A kernel integrates to one over space; on a lattice of spacing dx its sum is one only nearly
// (Wendland C2 in 2D at h = 1.2 dx: 1.018), which is the floor of every error: tests/sph checks those sums.
#pragma once

#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>
#include <variant>

#include "sph/base/pack.hpp"

namespace dem2sph {

/// Value [1/m^Dim] and gradient factor F [1/m^(Dim+2)] at one distance, or at one in each lane of a Pack.
template <class Real = double>
struct KernelValue {
  Real w = 0;
  Real f = 0;
};

/// What kernels share: h and the factor that makes them integrate to one, given for 1D, 2D and 3D at h = 1.
template <int Dim>
class KernelScale {
 public:
  double h() const { return h_; }
  double support() const { return 2 * h_; }

 protected:
  KernelScale(double h, double in_1d, double in_2d, double in_3d)
      : h_(h),
        inverse_h_(1 / h),
        value_(Dim == 1   ? in_1d * inverse_h_
               : Dim == 2 ? in_2d * inverse_h_ * inverse_h_
                          : in_3d * inverse_h_ * inverse_h_ * inverse_h_),
        slope_(value_ * inverse_h_ * inverse_h_) {}
  template <class Real>
  Real q(Real r) const {
    return r * inverse_h_;
  }
  /// 1 - q/2 within the support, else 0.
  template <class Real>
  Real inside(Real r) const {
    return positive(1 - r * (0.5 * inverse_h_));
  }
  /// W from its shape, and F from `factor` times the shape (dW/dq)/q: what is constant is multiplied once.
  template <class Real>
  KernelValue<Real> scaled(Real w, double factor, Real f) const {
    return {value_ * w, (factor * slope_) * f};
  }

 private:
  double h_;
  double inverse_h_;
  double value_;
  double slope_;
};

/// Cubic spline (Monaghan and Lattanzio 1985): the source's kernel, at h = 1.2 dx.
template <int Dim>
class CubicSpline : public KernelScale<Dim> {
 public:
  static constexpr const char* name = "cubic_spline";
  explicit CubicSpline(double h)
      : KernelScale<Dim>(h, 2.0 / 3, 10 / (7 * std::numbers::pi), 1 / std::numbers::pi) {}
  template <class Real>
  [[gnu::always_inline]] KernelValue<Real> operator()(Real r) const {
    const Real q = this->q(r);
    const Real outer = positive(2 - q);
    const Real inner = positive(1 - q);
    // (outer^2 - 4 inner^2)/q is 4 - 3q inside, so its limit at q = 0 is finite; the tiny term guards 0/0
    // there.
    return this->scaled(0.25 * outer * outer * outer - inner * inner * inner, -0.75,
                        (outer * outer - 4 * inner * inner) / (q + 1e-300));
  }
};

/// Wendland C2 (Wendland 1995): no pairing of particles (Dehnen and Aly 2012).
template <int Dim>
class WendlandC2 : public KernelScale<Dim> {
 public:
  static constexpr const char* name = "wendland_c2";
  explicit WendlandC2(double h)
      : KernelScale<Dim>(h, 5.0 / 8, 7 / (4 * std::numbers::pi), 21 / (16 * std::numbers::pi)) {}
  template <class Real>
  [[gnu::always_inline]] KernelValue<Real> operator()(Real r) const {
    const Real q = this->q(r);
    const Real t = this->inside(r);
    const Real t2 = t * t;
    if constexpr (Dim == 1) return this->scaled(t2 * t * (1 + 1.5 * q), -3, t2);
    return this->scaled(t2 * t2 * (1 + 2 * q), -5, t2 * t);
  }
};

/// Wendland C4 (Wendland 1995), smoother and wider in effect than C2 at the same h.
template <int Dim>
class WendlandC4 : public KernelScale<Dim> {
 public:
  static constexpr const char* name = "wendland_c4";
  explicit WendlandC4(double h)
      : KernelScale<Dim>(h, 3.0 / 4, 9 / (4 * std::numbers::pi), 495 / (256 * std::numbers::pi)) {}
  template <class Real>
  [[gnu::always_inline]] KernelValue<Real> operator()(Real r) const {
    const Real q = this->q(r);
    const Real t = this->inside(r);
    const Real t4 = t * t * t * t;
    if constexpr (Dim == 1) return this->scaled(t4 * t * (1 + 2.5 * q + 2 * q * q), -3.5, t4 * (1 + 2 * q));
    return this->scaled(t4 * t * t * (1 + 3 * q + 35.0 / 12 * q * q), -14.0 / 3, t4 * t * (1 + 2.5 * q));
  }
};

/// The kernel in use: visited once a pass, never once a pair.
template <int Dim>
using AnyKernel = std::variant<CubicSpline<Dim>, WendlandC2<Dim>, WendlandC4<Dim>>;

template <int Dim>
AnyKernel<Dim> make_kernel(const std::string& name, double h) {
  if (name == CubicSpline<Dim>::name) return CubicSpline<Dim>(h);
  if (name == WendlandC2<Dim>::name) return WendlandC2<Dim>(h);
  if (name == WendlandC4<Dim>::name) return WendlandC4<Dim>(h);
  throw std::logic_error("unknown kernel " + name);
}

}  // namespace dem2sph
