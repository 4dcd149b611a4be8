// The passes over pairs: each is compiled once for every choice of the parts that it depends on. What a pair
// contributes is in terms.hpp; what a particle does with the sums is in constitutive.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>

#include "sph/base/geometry.hpp"
#include "sph/equation_of_state.hpp"
#include "sph/kernel.hpp"
#include "sph/loops.hpp"
#include "sph/neighbours.hpp"
#include "sph/parts.hpp"
#include "sph/terms.hpp"

namespace dem2sph {

/// What every pass reads beside the particles.
template <int Dim>
struct Surroundings {
  const PairList& list;
  const std::vector<Wall<Dim>>& walls;
};

inline std::size_t index(std::int32_t b) { return static_cast<std::size_t>(b); }

template <int Dim, class Real, class Kernel>
[[gnu::always_inline]] inline Pair<Dim, Real> pair_of(const Kernel& kernel, const Vec<Dim, Real>& x_a,
                                                      const Vec<Dim, Real>& x_b) {
  Pair<Dim, Real> ab;
  ab.r = x_a - x_b;
  ab.distance = norm(ab.r);
  const KernelValue<Real> k = kernel(ab.distance);
  ab.w = k.w;
  ab.f = k.f;
  ab.grad_w = k.f * ab.r;
  return ab;
}
template <int Dim, class Kernel>
[[gnu::always_inline]] inline Pair<Dim, Pack> pair_with(const Particles<Dim>& q, const Kernel& kernel,
                                                        const Vec<Dim, Pack>& x_a, std::size_t b) {
  return pair_of(kernel, x_a, broadcast(q.position(b)));
}
/// Only the kernel's value: density and extrapolation need no gradient.
template <int Dim, class Kernel>
[[gnu::always_inline]] inline Pack weight_of(const Particles<Dim>& q, const Kernel& kernel,
                                             const Vec<Dim, Pack>& x_a, std::size_t b) {
  return kernel(norm(x_a - broadcast(q.position(b)))).w;
}
template <int Dim>
const Wall<Dim>& wall_of(const Particles<Dim>& q, const Surroundings<Dim>& around, std::size_t w) {
  return around.walls[static_cast<std::size_t>(q.wall[w])];
}

// ---- density
/// Eq. 5.17 (given), over all neighbours and the particle itself: into `sum`; of the material alone, or of
/// walls too.
template <int Dim, class Kernel>
void density_pass(const Particles<Dim>& q, bool walls_too, const Surroundings<Dim>& around,
                  const Kernel& kernel, Column& sum) {
  const auto pass = [&](const Cluster& a) {
    Pack rho;
    around.list.for_each(
        around.list.all_of(a),
        q.position(a), [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          rho += q.m[b] * weight_of(q, kernel, x, b);
        });
    a.store(sum, rho);
  };
  walls_too ? around.list.for_all(pass) : around.list.for_interior(pass);
}
/// Eq. 5.18 (given): the Shepard filter over rho_tilde, into rho.
template <int Dim, class Kernel>
void shepard_pass(Particles<Dim>& q, bool walls_too, const Surroundings<Dim>& around, const Kernel& kernel) {
  const auto pass = [&](const Cluster& a) {
    Pack sum;
    around.list.for_each(
        around.list.all_of(a),
        q.position(a), [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          sum += q.m[b] / q.rho_tilde[b] * weight_of(q, kernel, x, b);
        });
    a.store(q.rho, a.load(q.rho_tilde) / sum);
  };
  walls_too ? around.list.for_all(pass) : around.list.for_interior(pass);
}

// ---- first moment of the gradient
/// Inverse of a symmetric matrix, and its least eigenvalue. A particle that lacks neighbours on one side has
/// a small eigenvalue (about 0.5 at a flat surface). Below 0.75 the inverse is the identity: there it would
/// make up for what is not there, and the toe of a collapse is then pushed through the floor (seen with 0.3
/// and 0.5).
template <int Dim>
struct Moment {
  Gradient<Dim> inverse;
  double lambda = 0;
};
template <int Dim>
Moment<Dim> invert_moment(const Gradient<Dim>& m);

template <int Dim, class Kernel>
void moment_pass(Particles<Dim>& q, const Surroundings<Dim>& around, const Kernel& kernel) {
  const bool inverse = !q.correction[0].empty();
  const bool eigenvalue = !q.lambda.empty();
  around.list.for_interior([&](const Cluster& a) {
    Gradient<Dim, Pack> m;
    around.list.for_each(
        around.list.all_of(a),
        q.position(a), [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          add_first_moment(m, q.volume[b], pair_with(q, kernel, x, b));
        });
    for (std::size_t lane = 0; lane < a.count; ++lane) {
      Gradient<Dim> of_one;
      for (std::size_t k = 0; k < of_one.c.size(); ++k) of_one.c[k] = m.c[k][lane];
      const Moment<Dim> moment = invert_moment(of_one);
      if (inverse) Particles<Dim>::store(q.correction, a.first + lane, moment.inverse);
      if (eigenvalue) q.lambda[a.first + lane] = moment.lambda;
    }
  });
}

template <int Dim, class Real>
[[gnu::always_inline]] inline Vec<Dim, Real> product(const Gradient<Dim, Real>& m, const Vec<Dim, Real>& v) {
  Vec<Dim, Real> result;
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) result[i] += m(i, j) * v[j];
  return result;
}
template <int Dim>
[[gnu::always_inline]] inline Vec<Dim, Pack> product(const Gradient<Dim>& m, const Vec<Dim, Pack>& v) {
  Vec<Dim, Pack> result;
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) result[i] += m(i, j) * v[j];
  return result;
}

// ---- velocity gradient and rate of density
/// Eqs. 5.23 and 5.24 (given) for the pair of a wall particle and an interior one. At a smooth wall only the
/// normal component is artificial.
template <int Dim>
Vec<Dim> seen_wall_velocity(const Particles<Dim>& q, const Surroundings<Dim>& around, double B_max,
                            std::size_t w, std::size_t a) {
  const Wall<Dim>& wall = wall_of(q, around, w);
  const Vec<Dim> x_a = q.position(a);
  const Vec<Dim> x_w = q.position(w);
  const Vec<Dim> v = q.velocity(a);
  const Vec<Dim> seen =
      boundary_velocity(v, wall.velocity_at(x_w), wall.distance(x_a), -wall.distance(x_w), B_max);
  if (wall.rough) return seen;
  const Vec<Dim> n = wall.normal(x_a);
  return v + dot(seen - v, n) * n;
}

/// Volumes m/rho of all particles, for the passes that follow.
template <int Dim>
void volume_pass(Particles<Dim>& q) {
  for_clusters(0, q.size, [&](const Cluster& a) { a.store(q.volume, a.load(q.m) / a.load(q.rho)); });
}
/// sigma/rho^2 of all particles, for the momentum pass.
template <int Dim>
void bracket_pass(Particles<Dim>& q) {
  for_clusters(0, q.size, [&](const Cluster& a) {
    a.store(q.l, stress_over_density_squared(q.deviator(a), a.load(q.p), a.load(q.rho)));
  });
}

/// Eq. 5.21 (given) for all that have a stress of their own: into l; and d(rho)/dt, where a continuity
/// equation wants it, into rho_rate. `hydrostatic_slope` is d(rho)/d(up) under gravity, `c0` the speed of
/// sound at rho0.
template <int Dim, class Kernel, class Density, class Walls, class Correction>
void gradient_pass(Particles<Dim>& q, const Surroundings<Dim>& around, const Kernel& kernel,
                   const Density& density, const Walls& walls, const Correction&, double hydrostatic_slope,
                   double c0) {
  constexpr bool corrected = std::is_same_v<Correction, BonetLok1999>;
  constexpr bool hydrostatic = std::is_same_v<Density, ContinuityFourtakas2019>;
  const double diffusion = [&] {
    if constexpr (is_diffusive<Density>) return density.delta * kernel.h() * c0;
    return 0.0;
  }();
  [[maybe_unused]] const bool own_rho0 = !q.rho0.empty();
  const auto pass = [&](const Cluster& a, auto of_wall) {
    constexpr bool wall = of_wall;
    const Vec<Dim, Pack> x_a = q.position(a);
    const Vec<Dim, Pack> v = q.velocity(a);
    Gradient<Dim, Pack> l;
    Pack rate;
    Pack rho_a, excess_a, slope_a;
    if constexpr (!is_summed<Density>) rho_a = a.load(q.rho);
    if constexpr (is_diffusive<Density>) {
      excess_a = rho_a;
      if (own_rho0) excess_a -= a.load(q.rho0);  // at equal pressure nothing diffuses
      // Nothing is hydrostatic in material that bears no pressure: without this a falling column would gain
      // some.
      if constexpr (hydrostatic) slope_a = select(a.load(q.p) > Pack(0), Pack(hydrostatic_slope), Pack(0));
    }
    const auto add = [&](std::size_t b, const Vec<Dim, Pack>& x, const Vec<Dim, Pack>& difference,
                         auto diffuses) __attribute__((always_inline)) {
      const Pair<Dim, Pack> ab = pair_with(q, kernel, x, b);
      const double volume = q.volume[b];
      add_velocity_gradient(l, volume, difference, ab);
      if constexpr (std::is_same_v<Density, ContinuityMonaghan1994>)
        rate -= q.m[b] * dot(difference, ab.grad_w);
      if constexpr (is_diffusive<Density> && diffuses) {
        Pack excess = (own_rho0 ? q.rho[b] - q.rho0[b] : q.rho[b]) - excess_a;
        if constexpr (hydrostatic) excess -= (q.p[b] > 0 ? 1.0 : 0.0) * hydrostatic_difference(slope_a, ab);
        rate += density_diffusion(excess, diffusion * volume, ab);
      }
    };
    /// What the lanes see of wall particles, or wall particles in the lanes of b.
    [[maybe_unused]] const auto seen = [&](std::size_t b) {
      Vec<Dim, Pack> velocity;
      if constexpr (has_own_state<Walls>)
        for (std::size_t lane = 0; lane < a.count; ++lane)
          set_lane(velocity, lane,
                   wall ? seen_wall_velocity(q, around, walls.B_max, a.first + lane, b)
                        : seen_wall_velocity(q, around, walls.B_max, b, a.first + lane));
      return velocity;
    };
    around.list.for_each(
        around.list.interior_of(a),
        x_a, [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          const Vec<Dim, Pack> v_b = broadcast(q.velocity(b));
          if constexpr (wall)
            add(b, x, v_b - seen(b), std::false_type{});
          else
            add(b, x, v_b - v, std::true_type{});
        });
    around.list.for_each(
        around.list.walls_of(a),
        x_a, [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          if constexpr (has_own_state<Walls> && !wall)
            add(b, x, seen(b) - v, std::false_type{});
          else
            add(b, x, broadcast(q.velocity(b)) - v, std::false_type{});
        });
    if constexpr (corrected && !wall) {
      // L_a B_a: sum of dv (x) (B grad W), B being symmetric.
      const auto B = a.load<Gradient<Dim, Pack>>(q.correction);
      Gradient<Dim, Pack> exact;
      for (int i = 0; i < Dim; ++i)
        for (int j = 0; j < Dim; ++j)
          for (int k = 0; k < Dim; ++k) exact(i, j) += l(i, k) * B(k, j);
      l = exact;
    }
    if constexpr (!is_summed<Density>) {
      if constexpr (!std::is_same_v<Density, ContinuityMonaghan1994>) rate -= rho_a * l.trace();
      a.store(q.rho_rate, rate);
    }
    a.store(q.l, l);
  };
  around.list.for_interior([&](const Cluster& a) { pass(a, std::false_type{}); });
  if constexpr (has_own_state<Walls>)
    around.list.for_walls([&](const Cluster& a) { pass(a, std::true_type{}); });
}

/// The part of v that is tangential to a surface with unit normal n.
template <int Dim>
[[gnu::always_inline]] inline Vec<Dim> tangential(const Vec<Dim>& v, const Vec<Dim>& n) {
  return v - dot(v, n) * n;
}
/// s . n
template <int Dim>
[[gnu::always_inline]] inline Vec<Dim> traction(const Sym<Dim>& s, const Vec<Dim>& n) {
  Vec<Dim> result;
  for (int i = 0; i < Dim; ++i)
    for (int j = 0; j < Dim; ++j) result[i] += s(i, j) * n[j];
  return result;
}
/// Adds t n^T + n t^T, whose traction on n is t for a tangential t.
template <int Dim>
[[gnu::always_inline]] inline void add_shear_traction(Sym<Dim>& s, const Vec<Dim>& t, const Vec<Dim>& n) {
  for (int i = 0; i < Dim; ++i)
    for (int j = i; j < Dim; ++j) s(i, j) += t[i] * n[j] + n[i] * t[j];
}

/// Which features of walls the passes have to know: each costs only where it is used.
struct WallForces {
  bool basal = false;    ///< some wall has a basal friction
  bool sliders = false;  ///< and it is one of Adami's, whose shear traction is the wall's
  bool smooth = false;   ///< some wall is frictionless
  bool moving = false;   ///< some wall moves, and does work
};

// ---- smooth walls
/// The normals of all smooth walls that a wall particle is behind, made orthonormal: in the corner of two it
/// stands for both. A smooth wall mirrors what is before it and bears no shear.
template <int Dim>
struct Normals {
  std::array<Vec<Dim>, static_cast<std::size_t>(Dim)> n;
  std::size_t count = 0;
  /// v reflected in all of their planes.
  Vec<Dim> reflect(const Vec<Dim>& v) const { return v - 2.0 * project(v); }
  /// The same of a stress.
  Sym<Dim> reflect(const Sym<Dim>& s) const {
    double q[Dim][Dim];
    for (int j = 0; j < Dim; ++j) {
      Vec<Dim> axis;
      axis[j] = 1;
      const Vec<Dim> image = reflect(axis);
      for (int i = 0; i < Dim; ++i) q[i][j] = image[i];
    }
    return transform(s, q);
  }
  /// The part of v along them.
  Vec<Dim> project(const Vec<Dim>& v) const {
    Vec<Dim> result;
    for (std::size_t k = 0; k < count; ++k) result += dot(v, n[k]) * n[k];
    return result;
  }
  /// s without its shear tractions on them. Pressure and normal stresses stay: along the wall they change,
  /// and what is behind it takes its part in their gradients.
  Sym<Dim> without_shear(Sym<Dim> s) const {
    for (std::size_t k = 0; k < count; ++k)
      add_shear_traction(s, -1.0 * tangential(traction(s, n[k]), n[k]), n[k]);
    return s;
  }
};
/// `x` is the wall particle, `x_material` where the material is: from outside, the face of an obstacle is the
/// one that the material sees; in a container each face has its own normal.
template <int Dim>
Normals<Dim> smooth_normals(const std::vector<Wall<Dim>>& walls, const Vec<Dim>& x,
                            const Vec<Dim>& x_material) {
  Normals<Dim> normals;
  for (const Wall<Dim>& wall : walls) {
    if (wall.rough || !(wall.distance(x) < 0) || normals.count == Dim) continue;
    Vec<Dim> n = wall.normal(wall.inside ? x : x_material);
    n -= normals.project(n);
    const double length = norm(n);
    if (length > 0.1) normals.n[normals.count++] = (1 / length) * n;  // else it is (nearly) one that is there
  }
  return normals;
}

// ---- walls that are extrapolated (Adami, Hu, Adams 2012)
/// Walls that no material is near are left as they are.
///
/// Velocity that makes the profile vanish, relative to the wall, at its surface; only its normal component at
/// a smooth wall, and at one with a friction of its own.
template <int Dim, class Kernel>
void wall_velocity_pass(Particles<Dim>& q, const Surroundings<Dim>& around, const Kernel& kernel,
                        const WallForces& forces) {
  const auto seen_by = [&](std::size_t w, Vec<Dim> mean, double sum) {
    const Wall<Dim>& wall = wall_of(q, around, w);
    const Vec<Dim> x = q.position(w);
    const Vec<Dim> own = wall.velocity_at(x);
    Vec<Dim> seen = own;
    if (sum > 0) {
      mean *= 1 / sum;
      Vec<Dim> relative = mean - own;
      // Behind a smooth wall there is the mirror image of the material, behind a rough one its opposite;
      // where material may slide along a rough wall, only the normal component is opposed.
      if (forces.smooth) relative = smooth_normals(around.walls, x, x).reflect(relative);
      if (wall.rough && std::isnan(wall.basal_friction)) {
        seen = own - relative;
      } else if (wall.rough) {
        const Vec<Dim> n = wall.normal(x);
        seen = own + relative - 2 * dot(relative, n) * n;
      } else {
        seen = own + relative;
      }
    }
    return seen;
  };
  around.list.for_walls([&](const Cluster& a) {
    if (!around.list.sees_interior(a)) return;
    Vec<Dim, Pack> mean;
    Pack sum;
    around.list.for_each(
        around.list.interior_of(a),
        q.position(a), [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          const Pack weight = weight_of(q, kernel, x, b);
          mean += weight * broadcast(q.velocity(b));
          sum += weight;
        });
    for (std::size_t lane = 0; lane < a.count; ++lane)
      Particles<Dim>::store(q.v, a.first + lane, seen_by(a.first + lane, lane_of(mean, lane), sum[lane]));
  });
}

/// Shear traction between a wall with its own friction and the material that slides along it with v: a
/// Coulomb slider. An elastic material sticks by a spring of stiffness G/h until mu_b p + c is reached;
/// without elasticity the traction is mu_b p + c in the direction of sliding, mobilised over a rate of g_min.
/// `before` is the traction a step ago [Pa].
template <int Dim>
Vec<Dim> slider(const ElasticReturn& stress, const Vec<Dim>& before, const Vec<Dim>& v, double strength,
                double h, double dt) {
  const Vec<Dim> t = before + (stress.G / h * dt) * v;
  const double size = norm(t);
  return size <= strength ? t : (strength / size) * t;  // a NaN stays one
}
template <int Dim>
Vec<Dim> slider(const DirectStress& stress, const Vec<Dim>&, const Vec<Dim>& v, double strength, double h,
                double) {
  return (strength / std::max(norm(v), stress.gamma_dot_min * h)) * v;
}

/// Pressure and stress of wall particles from the material in their reach. Adami's walls take both, the
/// pressure with the weight of what lies between, unless they have a friction of their own; a partly slipping
/// wall keeps its own pressure and mixes the stress.
template <int Dim, class Kernel, class Walls, class Stress>
void wall_stress_pass(Particles<Dim>& q, const Surroundings<Dim>& around, const Kernel& kernel,
                      const Walls& part, const Stress& stress, const EquationOfState& eos,
                      const Vec<Dim>& gravity, double cohesion, double mu_at_rest, double dt,
                      const WallForces& forces) {
  // `moment` is the sum of rho (x_w - x_b) W.
  const auto set = [&](std::size_t w, double sum, [[maybe_unused]] double p_sum,
                       [[maybe_unused]] const Vec<Dim>& moment, Sym<Dim> s_sum) {
    const Wall<Dim>& wall = wall_of(q, around, w);
    [[maybe_unused]] const Vec<Dim> x = q.position(w);
    if constexpr (has_own_state<Walls>) {
      if (!(sum > 0)) return;
      Sym<Dim> s = q.deviator(w);
      s *= 1 - part.share;
      s_sum *= part.share / sum;
      s += s_sum;
      if (!std::isnan(wall.basal_friction))
        s *= basal_limit(wall.basal_friction, 0, q.p[w], cohesion, equivalent_stress(s));
      q.set_deviator(w, s);
    } else {
      double p = 0;
      Sym<Dim> s;
      if (sum > 0) {
        // Only gravity normal to the wall is carried by it; an accelerated wall is not allowed for.
        const Vec<Dim> n = wall.normal(x);
        p = std::max((p_sum + dot(gravity, n) * dot(moment, n)) / sum, 0.0);
        if (!std::isnan(wall.basal_friction)) {
          const Vec<Dim> sliding = tangential(q.velocity(w) - wall.velocity_at(x), n);
          const Vec<Dim> before = tangential(traction(q.deviator(w), n), n);
          const double strength = p > 0 ? wall.basal_friction * p + cohesion : 0;
          add_shear_traction(s, slider(stress, before, sliding, strength, kernel.h(), dt), n);
        } else if (p_sum > 0) {
          // In the ratio of the strengths at rest: without cohesion that of the pressures.
          s = s_sum;
          s *= cohesion > 0 ? (mu_at_rest * p + cohesion) / (mu_at_rest * p_sum + cohesion * sum) : p / p_sum;
          if (forces.smooth && wall.rough) s = smooth_normals(around.walls, x, x).reflect(s);
        }
      }
      q.p[w] = p;
      q.rho[w] = eos.density(p);  // of its own volume, whatever room swollen material takes
      q.set_deviator(w, s);
    }
  };
  around.list.for_walls([&](const Cluster& a) {
    if (!around.list.sees_interior(a)) return;
    Pack sum, p_sum;
    Vec<Dim, Pack> moment;
    Sym<Dim, Pack> s_sum;
    around.list.for_each(
        around.list.interior_of(a),
        q.position(a), [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          const Vec<Dim, Pack> r = x - broadcast(q.position(b));
          const Pack weight = kernel(norm(r)).w;
          sum += weight;
          const Sym<Dim> s = q.deviator(b);
          for (int k = 0; k < Sym<Dim>::size; ++k) s_sum[k] += weight * s[k];
          if constexpr (!has_own_state<Walls>) {
            p_sum += weight * q.p[b];
            moment += (weight * q.rho[b]) * r;
          }
        });
    for (std::size_t lane = 0; lane < a.count; ++lane)
      set(a.first + lane, sum[lane], p_sum[lane], lane_of(moment, lane), lane_of(s_sum, lane));
  });
}

// ---- momentum
/// What the pass adds up [W]: what damping dissipates, what moving walls put in, what sliding on walls with a
/// friction of their own dissipates.
struct MomentumSums {
  double damping = 0;
  double walls = 0;
  double sliding = 0;
};

/// The bracket of Eq. 5.20 for particle a beside a particle of a wall that is smooth, or has a friction of
/// its own. `own` is sigma_a/rho_a^2, `other` that of the wall's particle.
template <int Dim, class Stress>
Sym<Dim> stress_beside_wall(const Particles<Dim>& q, const Surroundings<Dim>& around, const Stress& stress,
                            double cohesion, const WallForces& wall_forces, std::size_t a, std::size_t b,
                            const Sym<Dim>& own, Sym<Dim> sum) {
  const Wall<Dim>& wall = wall_of(q, around, b);
  if (std::isnan(wall.basal_friction)) {
    sum += own;
    return smooth_normals(around.walls, q.position(b), q.position(a)).without_shear(sum);
  }
  Sym<Dim> s = q.deviator(a);
  if (wall_forces.sliders) {
    // The particle's own shear traction on the wall gives way to the slider's, in the same ratio to its
    // pressure, so that the pair's forces have the ratio too.
    const Vec<Dim> n = wall.normal(q.position(a));
    const double of_wall = wall.basal_friction * q.p[b] + cohesion;
    const double of_particle = q.p[a] > 0 ? wall.basal_friction * q.p[a] + cohesion : 0;
    const double ratio = q.p[b] > 0 && of_wall > 0 ? of_particle / of_wall : 0;
    add_shear_traction(s, ratio * traction(q.deviator(b), n) - tangential(traction(s, n), n), n);
  } else {
    const double beta = q.beta.empty() ? 0 : q.beta[a];
    const double tau = equivalent_stress(s);
    if constexpr (std::is_same_v<Stress, DirectStress>) {
      // eta |g| = tau, and the strength is eta max(|g|, g_min).
      const double g = q.gamma_dot[a];
      const double strength = g > 0 ? tau / g * std::max(g, stress.gamma_dot_min) : 0;
      s *= basal_factor(wall.basal_friction, beta, q.p[a], cohesion, strength);
    } else {
      s *= basal_limit(wall.basal_friction, beta, q.p[a], cohesion, tau);
    }
  }
  return sum += stress_over_density_squared(s, q.p[a], q.rho[a]);
}

/// Eq. 5.20 (given; the print lost m_b) plus what damping adds: into a.
template <int Dim, class Kernel, class Damping, class Correction, class Stress>
MomentumSums momentum_pass(Particles<Dim>& q, const Surroundings<Dim>& around, const Kernel& kernel,
                           const Damping& damping, const Correction&, const Stress& stress,
                           const Vec<Dim>& gravity, double c0, double cohesion, WallForces wall_forces) {
  constexpr bool corrected = std::is_same_v<Correction, BonetLok1999>;
  constexpr bool damped = !std::is_same_v<Damping, NoDamping>;
  constexpr bool limited = std::is_same_v<Damping, BalsaraDamping>;
  const auto sums =
      around.list.template sum_over_interior<3>([&](const Cluster& a, std::array<double, 3>& power) {
        const Vec<Dim, Pack> x_a = q.position(a);
        const Vec<Dim, Pack> v = q.velocity(a);
        const Pack rho = a.load(q.rho);
        const Sym<Dim, Pack> own = q.bracket(a);
        Pack limiter;
        if constexpr (limited) limiter = a.load(q.limiter);
        Gradient<Dim, Pack> B_a;
        if constexpr (corrected) B_a = a.load<Gradient<Dim, Pack>>(q.correction);
        Vec<Dim, Pack> acceleration = broadcast(gravity);
        Pack damping_power, wall_power;  // over m_a/2 and m_a
        around.list.for_each(
            around.list.interior_of(a),
            x_a, [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
              const Pair<Dim, Pack> ab = pair_with(q, kernel, x, b);
              const Sym<Dim> other = q.bracket(b);
              if constexpr (corrected) {
                add_stress_divergence(acceleration, q.m[b], own, product(B_a, ab.grad_w));
                add_stress_divergence(acceleration, q.m[b], broadcast(other),
                                      product(Particles<Dim>::load(q.correction, b), ab.grad_w));
              } else {
                Sym<Dim, Pack> sum = broadcast(other);
                sum += own;
                add_stress_divergence(acceleration, q.m[b], sum, ab.grad_w);
              }
              if constexpr (damped) {
                const Vec<Dim, Pack> difference = v - broadcast(q.velocity(b));
                Pack alpha = damping.alpha;
                if constexpr (limited) alpha *= 0.5 * (limiter + q.limiter[b]);
                const Pack viscous = q.m[b] * artificial_viscosity(alpha, c0, kernel.h(),
                                                                   0.5 * (rho + q.rho[b]), difference, ab);
                acceleration -= viscous * ab.grad_w;
                damping_power += viscous * (ab.f * dot(difference, ab.r));
              }
            });
        around.list.for_each(
            around.list.walls_of(a),
            x_a, [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
              const Pair<Dim, Pack> ab = pair_with(q, kernel, x, b);
              const Sym<Dim> other = q.bracket(b);
              const Wall<Dim>& wall = wall_of(q, around, b);
              const bool basal = wall_forces.basal && !std::isnan(wall.basal_friction);
              Sym<Dim, Pack> sum = broadcast(other);
              if (basal || (wall_forces.smooth && !wall.rough)) {
                for (std::size_t lane = 0; lane < a.count; ++lane) {
                  if (!(ab.f[lane] < 0)) continue;
                  const Sym<Dim> one = stress_beside_wall(q, around, stress, cohesion, wall_forces,
                                                          a.first + lane, b, lane_of(own, lane), other);
                  for (int k = 0; k < Sym<Dim>::size; ++k) sum[k].set(lane, one[k]);
                }
              } else {
                sum += own;
              }
              Vec<Dim, Pack> push;
              add_stress_divergence(push, q.m[b], sum, corrected ? product(B_a, ab.grad_w) : ab.grad_w);
              acceleration += push;
              if (basal && wall_forces.sliders)
                for (std::size_t lane = 0; lane < a.count; ++lane)
                  power[2] -= q.m[a.first + lane] *
                              dot(tangential(lane_of(push, lane), wall.normal(q.position(a.first + lane))),
                                  q.velocity(a.first + lane) - wall.velocity_at(q.position(b)));
              if (wall_forces.moving) wall_power += dot(push, broadcast(wall.velocity_at(q.position(b))));
            });
        a.store(q.a, acceleration);
        const Pack m = a.present() * a.load(q.m);
        power[0] += 0.5 * (m * damping_power).sum();
        power[1] += (m * wall_power).sum();
      });
  return {sums[0], sums[1], sums[2]};
}

// ---- velocity averaging and shifting
template <int Dim, class Kernel>
void averaging_pass(Particles<Dim>& q, const Surroundings<Dim>& around, const Kernel& kernel,
                    double epsilon) {
  around.list.for_interior([&](const Cluster& a) {
    const Vec<Dim, Pack> x_a = q.position(a);
    const Vec<Dim, Pack> v = q.velocity(a);
    const Pack rho = a.load(q.rho);
    Vec<Dim, Pack> sum;
    around.list.for_each(
        around.list.interior_of(a),
        x_a, [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          add_averaged_velocity(sum, q.m[b], 0.5 * (rho + q.rho[b]), broadcast(q.velocity(b)) - v,
                                weight_of(q, kernel, x, b));
        });
    a.store(q.averaged, epsilon * sum);
  });
}

/// Shifts of Sun et al. (2017) over one step: -4 h U dt grad C, U the largest speed (their CFL Ma (2h)^2
/// written with the step), not more than `largest`. Where lambda < 0.75 a particle belongs to the surface's
/// region and is shifted only along it, the normal being the gradient of lambda; below 0.4 it is spray and
/// not shifted.
template <int Dim, class Kernel>
void shifting_pass(const Particles<Dim>& q, const Surroundings<Dim>& around, const Kernel& kernel, double dx,
                   double U_dt, double largest, std::array<Column, static_cast<std::size_t>(Dim)>& shift) {
  const double w_of_dx = kernel(dx).w;
  const auto shift_of = [&](std::size_t a, const Vec<Dim>& concentration, const Vec<Dim>& lambda_gradient) {
    Vec<Dim> d = (-4 * kernel.h() * U_dt) * concentration;
    if (q.lambda[a] < 0.75) {
      const double size = norm(lambda_gradient);
      if (q.lambda[a] < 0.4 || !(size > 0)) {
        d *= 0;
      } else {
        const Vec<Dim> n = (1 / size) * lambda_gradient;
        d -= dot(d, n) * n;
      }
    }
    const double length = norm(d);
    if (length > largest) d *= largest / length;
    return d;
  };
  around.list.for_interior([&](const Cluster& a) {
    const Vec<Dim, Pack> x_a = q.position(a);
    const Pack lambda = a.load(q.lambda);
    Vec<Dim, Pack> concentration;
    Vec<Dim, Pack> lambda_gradient;
    around.list.for_each(
        around.list.all_of(a),
        x_a, [&](std::size_t b, const Vec<Dim, Pack>& x) __attribute__((always_inline)) {
          const Pair<Dim, Pack> ab = pair_with(q, kernel, x, b);
          const double volume = q.volume[b];
          add_concentration_gradient(concentration, volume, w_of_dx, ab);
          const double lambda_b = b < q.interior ? q.lambda[b] : 1.0;  // walls are no surface
          lambda_gradient += (volume * (lambda_b - lambda)) * ab.grad_w;
        });
    for (std::size_t lane = 0; lane < a.count; ++lane)
      Particles<Dim>::store(
          shift, a.first + lane,
          shift_of(a.first + lane, lane_of(concentration, lane), lane_of(lambda_gradient, lane)));
  });
}

}  // namespace dem2sph
