// Dispersion relations of a square or cubic lattice of particles: derived in README.md, summed here without
// any of the solver's code (the kernels are written out once more too).
#pragma once

#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

namespace dem2sph {

/// W, W' and W'' at r, as printed by their authors; not normalised in closed form but by what they integrate
/// to.
struct Radial {
  double w = 0, first = 0, second = 0;
};
inline Radial radial_kernel(const std::string& name, int dim, double h, double r) {
  const double pi = std::numbers::pi;
  const double q = r / h;
  Radial k;
  double norm = 0;
  if (q >= 2) return k;
  if (name == "cubic_spline") {
    norm = dim == 2 ? 10 / (7 * pi) : 1 / pi;
    k = q < 1 ? Radial{1 - 1.5 * q * q + 0.75 * q * q * q, -3 * q + 2.25 * q * q, -3 + 4.5 * q}
              : Radial{0.25 * (2 - q) * (2 - q) * (2 - q), -0.75 * (2 - q) * (2 - q), 1.5 * (2 - q)};
  } else if (name == "wendland_c2") {
    norm = dim == 2 ? 7 / (4 * pi) : 21 / (16 * pi);
    const double t = 1 - 0.5 * q;
    k = {t * t * t * t * (1 + 2 * q), -5 * q * t * t * t, -5 * t * t * t + 7.5 * q * t * t};
  } else if (name == "wendland_c4") {
    norm = dim == 2 ? 9 / (4 * pi) : 495 / (256 * pi);
    const double t = 1 - 0.5 * q;
    const double t4 = t * t * t * t;
    k = {t4 * t * t * (1 + 3 * q + 35.0 / 12 * q * q), -14.0 / 3 * q * t4 * t * (1 + 2.5 * q),
         -14.0 / 3 * (t4 * t * (1 + 5 * q) - 2.5 * q * t4 * (1 + 2.5 * q))};
  } else {
    throw std::invalid_argument(name);
  }
  const double scale = norm / std::pow(h, dim);
  return {k.w * scale, k.first * scale / h, k.second * scale / (h * h)};
}

/// The lattice sums over all sites R but the own one, for V = m/rho = 1 and dx = 1 (README.md names them).
struct LatticeSums {
  double s = 0;       ///< sum of W, own site included
  double w_hat = 0;   ///< sum of W cos(k x)/s, own site included
  double theta = 0;   ///< -sum of F x sin(k x)
  double lambda = 0;  ///< sum of W_xx (1 - cos(k x))
  double f = 0;       ///< -sum of F x^2: the lattice factor
  double phi = 0;     ///< -sum of F x^2 cos(k x)
  double xi = 0;      ///< sum of (2 x F + x^3 F'/R) sin(k x)
  LatticeSums(const std::string& kernel, int dim, double h, double k) {
    const int reach = static_cast<int>(2 * h) + 1;
    for (int c = dim == 3 ? -reach : 0; c <= (dim == 3 ? reach : 0); ++c)
      for (int b = -reach; b <= reach; ++b)
        for (int a = -reach; a <= reach; ++a) {
          const double x = a;
          const double r = std::sqrt(static_cast<double>(a * a + b * b + c * c));
          const Radial w = radial_kernel(kernel, dim, h, r);
          s += w.w;
          w_hat += w.w * std::cos(k * x);
          if (r == 0) continue;
          const double F = w.first / r;
          const double xx = x * x / (r * r);
          theta -= F * x * std::sin(k * x);
          lambda += (w.second * xx + F * (1 - xx)) * (1 - std::cos(k * x));
          f -= F * x * x;
          phi -= F * x * x * std::cos(k * x);
          xi += (2 * x * F + x * xx * (w.second - F)) * std::sin(k * x);
        }
    w_hat /= s;
  }
};

}  // namespace dem2sph
