// One function per term of the equations: what one pair (a, b), or one particle, contributes. No loops, no
// arrays. `Real` is double for one particle a, Pack for the particles of a cluster, each with the same b.
#pragma once

#include <cmath>

#include "sph/base/tensor.hpp"

namespace dem2sph {

/// A pair as particle a sees it: r = x_a - x_b, grad_a W = r F.
template <int Dim, class Real = double>
struct Pair {
  Vec<Dim, Real> r;
  Real distance = 0;
  Real w = 0;             ///< W
  Vec<Dim, Real> grad_w;  ///< gradient of W with respect to x_a
  Real f = 0;             ///< F <= 0
};

/// Eq. 5.21 (given): L_a += (m_b/rho_b) (v_b - v_a) (x) grad_a W.
template <int Dim, class Real>
[[gnu::always_inline]] inline void add_velocity_gradient(Gradient<Dim, Real>& l, double volume_b,
                                                         const Vec<Dim, Real>& v_b_minus_v_a,
                                                         const Pair<Dim, Real>& pair) {
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) l(i, j) += volume_b * v_b_minus_v_a[i] * pair.grad_w[j];
}

/// Eq. 5.20 (given; the print lost m_b): a_a += m_b (sigma_a/rho_a^2 + sigma_b/rho_b^2) . grad_a W.
/// `sum` is the bracket, tension positive.
template <int Dim, class Real>
[[gnu::always_inline]] inline void add_stress_divergence(Vec<Dim, Real>& acceleration, double m_b,
                                                         const Sym<Dim, Real>& sum,
                                                         const Vec<Dim, Real>& grad_w) {
  for (int i = 0; i < Dim; ++i) {
    Real traction = 0;
    for (int j = 0; j < Dim; ++j) traction += sum(i, j) * grad_w[j];
    acceleration[i] += m_b * traction;
  }
}

/// sigma/rho^2 of one particle, with sigma = s - p 1 (Eq. 5.3, reconstructed).
template <int Dim, class Real>
[[gnu::always_inline]] inline Sym<Dim, Real> stress_over_density_squared(
    const Sym<Dim, Real>& s, const std::type_identity_t<Real>& p, const std::type_identity_t<Real>& rho) {
  Sym<Dim, Real> sigma = s;
  for (int i = 0; i < 3; ++i) sigma[i] -= p;
  return sigma *= 1 / (rho * rho);
}

/// Density diffusion of Molteni and Colagrossi (2009): the pair's part of d(rho_a)/dt over (delta h c),
/// 2 (rho_b - rho_a) (-F) m_b/rho_b. Fourtakas et al. (2019) take off what rho_b - rho_a is under hydrostatic
/// pressure, slope (up_b - up_a), so that a bed at rest does not diffuse: pass that difference instead.
template <int Dim, class Real>
[[gnu::always_inline]] inline Real density_diffusion(const std::type_identity_t<Real>& rho_b_minus_rho_a,
                                                     double volume_b, const Pair<Dim, Real>& pair) {
  return (-2 * volume_b) * rho_b_minus_rho_a * pair.f;
}
/// Hydrostatic rho_b - rho_a for a slope d(rho)/d(up); r points from b to a, so b lies -r higher.
template <int Dim, class Real>
[[gnu::always_inline]] inline Real hydrostatic_difference(const std::type_identity_t<Real>& slope,
                                                          const Pair<Dim, Real>& pair) {
  return -slope * pair.r[Dim - 1];
}

/// Artificial viscosity of Monaghan and Gingold (1983): Pi_ab [m^5/(kg s^2)], nonzero where two particles
/// approach.
template <int Dim, class Real>
[[gnu::always_inline]] inline Real artificial_viscosity(const std::type_identity_t<Real>& alpha, double c,
                                                        double h, const std::type_identity_t<Real>& mean_rho,
                                                        const Vec<Dim, Real>& v_a_minus_v_b,
                                                        const Pair<Dim, Real>& pair) {
  const Real approach = negative(dot(v_a_minus_v_b, pair.r));
  return (-c * h) * (alpha * approach) / ((pair.distance * pair.distance + 0.01 * h * h) * mean_rho);
}

/// Eqs. 5.23 and 5.24 (given): the velocity that a boundary particle shows to an interior one, so that the
/// velocity falls linearly through the wall's surface. The factor B is called beta in the source; it has
/// nothing to do with dilation.
template <int Dim>
Vec<Dim> boundary_velocity(const Vec<Dim>& v_interior, const Vec<Dim>& v_wall, double distance_interior,
                           double distance_boundary, double largest_factor) {
  const double ratio = distance_boundary / std::fmax(distance_interior, 1e-300);
  const double factor = 1 + ratio > largest_factor ? largest_factor : 1 + ratio;
  return (1 - factor) * v_interior + factor * v_wall;
}

/// Basal friction (Eq. 5.7, given in words): where an interior particle meets a wall with the friction mu_b,
/// mu_b takes the place of the first two terms of mu. Returns the factor on the particle's deviatoric stress
/// in that pair. A stress without elasticity is replaced, whatever its size: `strength` = (mu p + c), of
/// which tau is the part that the rate of shear has mobilised. An elastic one is cut down to the wall's
/// strength, since below it nothing slides.
inline double basal_factor(double mu_b, double beta, double p, double cohesion, double strength) {
  const double basal = (mu_b + beta) * p + cohesion;
  return strength > 0 ? (basal < 0 ? 0 : basal) / strength : 1;
}
inline double basal_limit(double mu_b, double beta, double p, double cohesion, double tau) {
  const double factor = basal_factor(mu_b, beta, p, cohesion, tau);
  return factor > 1 ? 1 : factor;  // a NaN stays one
}

/// Velocity averaging (XSPH, Monaghan 1989): the pair's part of what is added to the velocity of transport,
/// over epsilon.
template <int Dim, class Real>
[[gnu::always_inline]] inline void add_averaged_velocity(Vec<Dim, Real>& sum, double m_b,
                                                         const std::type_identity_t<Real>& mean_rho,
                                                         const Vec<Dim, Real>& v_b_minus_v_a,
                                                         const std::type_identity_t<Real>& w) {
  for (int i = 0; i < Dim; ++i) sum[i] += m_b / mean_rho * w * v_b_minus_v_a[i];
}

/// Particle shifting (Sun, Colagrossi, Marrone, Antuono, Zhang 2017, delta-plus-SPH): the pair's part of the
/// gradient of concentration, with the term (R = 0.2, n = 4) that keeps particles from pairing.
template <int Dim, class Real>
[[gnu::always_inline]] inline void add_concentration_gradient(Vec<Dim, Real>& sum, double volume_b,
                                                              double w_of_dx, const Pair<Dim, Real>& pair) {
  const Real ratio = pair.w / w_of_dx;
  const Real square = ratio * ratio;
  for (int i = 0; i < Dim; ++i) sum[i] += (1 + 0.2 * square * square) * volume_b * pair.grad_w[i];
}

/// First moment of the kernel's gradient, M_a += (m_b/rho_b) (x_b - x_a) (x) grad_a W: the identity if the
/// sums were exact. Its inverse corrects gradients (Randles and Libersky 1996, Bonet and Lok 1999); its least
/// eigenvalue tells the surface from the inside (Marrone et al. 2010). It is symmetric, since grad W = r F.
template <int Dim, class Real>
[[gnu::always_inline]] inline void add_first_moment(Gradient<Dim, Real>& m, double volume_b,
                                                    const Pair<Dim, Real>& pair) {
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) m(i, j) -= volume_b * pair.r[i] * pair.grad_w[j];
}

/// Q s Q^T for an orthogonal Q of the plane or of space; the zz of plane strain stays.
template <int Dim, class Real>
[[gnu::always_inline]] inline Sym<Dim, Real> transform(const Sym<Dim, Real>& s, const Real (&q)[Dim][Dim]) {
  Sym<Dim, Real> result = s;
  for (int i = 0; i < Dim; ++i)
    for (int j = i; j < Dim; ++j) {
      Real sum = 0;
      for (int k = 0; k < Dim; ++k)
        for (int m = 0; m < Dim; ++m) sum += q[i][k] * s(k, m) * q[j][m];
      result(i, j) = sum;
    }
  return result;
}

/// Rotates a stress by the spin W over dt: Hughes and Winget (1980), an exact rotation for every dt, so that
/// its norm is kept to rounding. w(i, j) = (L_ij - L_ji)/2.
template <int Dim, class Real>
[[gnu::always_inline]] inline Sym<Dim, Real> rotate(const Sym<Dim, Real>& s, const Gradient<Dim, Real>& l,
                                                    double dt) {
  // Q = 1 + 2 (A + A^2)/(1 + |a|^2) with A = W dt/2 (Cayley).
  Real a[Dim][Dim];
  Real square = 0;
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) {
      a[i][j] = 0.25 * dt * (l(i, j) - l(j, i));
      square += 0.5 * a[i][j] * a[i][j];
    }
  const Real scale = 2 / (1 + square);
  Real q[Dim][Dim];
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) {
      Real a2 = 0;
      for (int k = 0; k < Dim; ++k) a2 += a[i][k] * a[k][j];
      q[i][j] = (i == j ? 1.0 : 0.0) + scale * (a[i][j] + a2);
    }
  return transform(s, q);
}

}  // namespace dem2sph
