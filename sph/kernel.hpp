// Smoothing kernels with support 2h in one, two and three dimensions: W(r, h) and F with grad W = r F (F <=
// 0).
//
// q = r/h. A kernel integrates to one over space; on a lattice of spacing dx its sum is one only nearly
// (Wendland C2 in 2D at h = 1.2 dx: 1.018), which is the floor of every error: tests/sph checks those sums.
#pragma once

#include <cmath>
#include <numbers>

namespace dem2sph {

/// Value [1/m^Dim] and gradient factor F [1/m^(Dim+2)] at one distance.
struct KernelValue {
  double w = 0;
  double f = 0;
};

/// Cubic spline (Monaghan and Lattanzio 1985): the source's kernel, at h = 1.2 dx.
template <int Dim>
class CubicSpline {
 public:
  static constexpr const char* name = "cubic_spline";
  explicit CubicSpline(double h) : h_(h), inverse_h_(1 / h) {
    constexpr double pi = std::numbers::pi;
    scale_ = Dim == 1 ? 2 / (3 * h) : Dim == 2 ? 10 / (7 * pi * h * h) : 1 / (pi * h * h * h);
  }
  double h() const { return h_; }
  double support() const { return 2 * h_; }
  KernelValue operator()(double r) const {
    const double q = r * inverse_h_;
    const double outer = std::fmax(2 - q, 0.0);
    const double inner = std::fmax(1 - q, 0.0);
    const double w = 0.25 * outer * outer * outer - inner * inner * inner;
    // (outer^2 - 4 inner^2)/q is 4 - 3q inside, so its limit at q = 0 is finite; the tiny term guards 0/0
    // there.
    const double f = -0.75 * (outer * outer - 4 * inner * inner) / (q + 1e-300);
    return {scale_ * w, scale_ * f * inverse_h_ * inverse_h_};
  }

 private:
  double h_;
  double inverse_h_;
  double scale_;
};

/// Wendland C2 (Wendland 1995): no pairing of particles (Dehnen and Aly 2012).
template <int Dim>
class WendlandC2 {
 public:
  static constexpr const char* name = "wendland_c2";
  explicit WendlandC2(double h) : h_(h), inverse_h_(1 / h) {
    constexpr double pi = std::numbers::pi;
    scale_ = Dim == 1 ? 5 / (8 * h) : Dim == 2 ? 7 / (4 * pi * h * h) : 21 / (16 * pi * h * h * h);
  }
  double h() const { return h_; }
  double support() const { return 2 * h_; }
  KernelValue operator()(double r) const {
    const double q = r * inverse_h_;
    const double t = std::fmax(1 - 0.5 * q, 0.0);
    const double t2 = t * t;
    const double s = scale_ * inverse_h_ * inverse_h_;
    if constexpr (Dim == 1) return {scale_ * t2 * t * (1 + 1.5 * q), -3 * s * t2};
    return {scale_ * t2 * t2 * (1 + 2 * q), -5 * s * t2 * t};
  }

 private:
  double h_;
  double inverse_h_;
  double scale_;
};

/// Wendland C4 (Wendland 1995), smoother and wider in effect than C2 at the same h.
template <int Dim>
class WendlandC4 {
 public:
  static constexpr const char* name = "wendland_c4";
  explicit WendlandC4(double h) : h_(h), inverse_h_(1 / h) {
    constexpr double pi = std::numbers::pi;
    scale_ = Dim == 1 ? 3 / (4 * h) : Dim == 2 ? 9 / (4 * pi * h * h) : 495 / (256 * pi * h * h * h);
  }
  double h() const { return h_; }
  double support() const { return 2 * h_; }
  KernelValue operator()(double r) const {
    const double q = r * inverse_h_;
    const double t = std::fmax(1 - 0.5 * q, 0.0);
    const double t2 = t * t;
    const double s = scale_ * inverse_h_ * inverse_h_;
    if constexpr (Dim == 1)
      return {scale_ * t2 * t2 * t * (1 + 2.5 * q + 2 * q * q), -3.5 * s * t2 * t2 * (1 + 2 * q)};
    return {scale_ * t2 * t2 * t2 * (1 + 3 * q + 35.0 / 12 * q * q),
            -14.0 / 3 * s * t2 * t2 * t * (1 + 2.5 * q)};
  }

 private:
  double h_;
  double inverse_h_;
  double scale_;
};

}  // namespace dem2sph
