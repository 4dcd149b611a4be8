// From particles to continuum fields: density, momentum, stress, temperature, fabric on a grid, which obey
// the balances of mass and momentum exactly. It knows positions, masses and forces only, so grains and SPH
// particles go through the same sums.
//
// The idea, after Goldhirsch, Granular Matter 12 (2010) 239. A particle's mass is smeared out by a kernel
// phi(r) with integral 1, so rho(r) = sum of m_i phi(r - r_i), and momentum likewise. Differentiate rho in
// time, and what comes out is minus the divergence of that momentum: no approximation is made, whatever the
// kernel. Differentiate the momentum, and a force f on particle i from particle j gives f [phi(r - r_i) -
// phi(r - r_j)]: what j loses i gains. Such a difference of a function at two ends of a line is the integral
// of its slope along it, so it is minus the divergence of
//
//   sigma^c(r) = f b  int_0^1 phi(r - r_i + s b) ds,    b = r_i - r_j,
//
// the contact stress, compression-positive. A small number: two grains 1 mm apart press with 1 N. Wherever
// it is smeared to, the integral of sigma^c over all space is 1 N x 1 mm = 1e-3 J along the branch, and a
// plane between them carries 1 N.
//
// At a wall (Weinhart, Thornton, Luding and Bokhove, Granular Matter 14 (2012) 289) there is no partner that
// loses what the grain gains. The line then ends at the contact point c, and what is left over is a density
// of force t(r) = sum of f phi(r - c) by which the wall acts on the grains. (They define t with the opposite
// sign.) The balance that closes to rounding, also within a kernel's width of the wall, is
//
//   d(rho V)/dt = - div(sigma^c + sigma^k + rho V V) + t + rho g.
//
// Fields may be resolved along one, two or three axes. Along the others they are means over the whole cell,
// and all derivatives vanish.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "sph/base/tensor.hpp"

namespace dem2sph::bridge {

/// Any 3 x 3 tensor, not symmetric in general.
using Tensor = Gradient<3>;

enum class KernelShape {
  gauss,  ///< exp(-R^2/(2 w^2)) minus its value at the cut, so that it ends without a jump
  lucy,   ///< (1 + 3 q)(1 - q)^3, q = R/c: twice differentiable, ends at c (Lucy, Astron. J. 82 (1977) 1013)
  heaviside  ///< constant within c: an interval, a disc, a ball
};

/// What a Gauss kernel is cut at, over its width.
inline constexpr double gauss_cut = 3;

/// An isotropic kernel in one, two or three dimensions with the integral 1, exactly, cut included. Points are
/// given in the first `dimension` components; the others must be 0.
///
/// A Gauss kernel that is just cut at 3 w drops there by 1 % of its height. The slope at the jump is lost
/// from grad(phi), and with it 2.7 % of a velocity gradient in 1D and 8 % in 3D. It is lowered by its value
/// at the cut instead. Its standard deviation is then 4 % (1D) to 8 % (3D) below w: see variance().
class Kernel {
 public:
  /// `width`: the Gauss kernel's w; the radius c of the others. Unit: that of the axis. `cut`: radius of the
  /// Gauss kernel over w. Throws UsageError unless both are positive and dimension is 1, 2 or 3.
  Kernel(KernelShape shape, int dimension, double width, double cut = gauss_cut);

  KernelShape shape() const { return shape_; }
  int dimension() const { return dimension_; }
  /// Beyond it the kernel is 0.
  double radius() const { return radius_; }
  /// Mean of x^2 along any one axis, exact.
  double variance() const { return variance_; }
  bool has_gradient() const { return shape_ != KernelShape::heaviside; }

  /// phi at the squared distance.
  double operator()(double distance_squared) const;
  /// grad phi = slope(R^2) times the vector r. 0 for the Heaviside kernel, whose gradient is none.
  double slope(double distance_squared) const;
  /// int_0^1 phi(u + s b) ds, in closed form.
  double line_integral(const Vec<3>& u, const Vec<3>& b) const;

 private:
  double along(double a, double b, double part, double h_squared) const;

  KernelShape shape_;
  int dimension_;
  double width_ = 0, radius_ = 0, norm_ = 0, variance_ = 0;
  double lowered_ = 0;  ///< value of exp(-R^2/(2 w^2)) at the cut
};

/// A point that carries mass: a grain or an SPH particle. SI.
struct Particle {
  Vec<3> x, v;
  double mass = 0;          ///< [kg]
  double solid_volume = 0;  ///< of solid only; their sum over a volume is the solid fraction [m^3]
  /// Volume of an SPH particle times its stress, compression-positive [J]. Grains have none: theirs comes
  /// from contacts.
  Sym<3> stress_volume;
};

/// A force between two grains, or on a grain by a wall.
struct Interaction {
  Vec<3> from;    ///< centre of the grain that `force` acts on
  Vec<3> branch;  ///< from the other end to `from`; that end is the partner's centre, or the point of contact
  Vec<3> force;   ///< [N]
  bool wall = false;  ///< the other end is a wall
};

/// All particles and forces at one time.
struct Snapshot {
  std::vector<Particle> particles;
  std::vector<Interaction> interactions;  ///< each once
};

/// One resolved axis of a grid.
struct Axis {
  int direction = 0;  ///< component of x: 0, 1 or 2
  double low = 0;     ///< first point
  double spacing = 0;
  std::size_t points = 0;
  double period = 0;  ///< > 0: the packing repeats; 0: it does not
};

struct Grid {
  std::vector<Axis> axes;  ///< one to three
  /// Product of the cell's lengths along the other axes: m^2 for one axis, m for two, 1 for three. A 2D SPH
  /// frame, whose masses are per metre, has 1.
  double unresolved = 1;

  int dimension() const { return static_cast<int>(axes.size()); }
  std::size_t size() const;
  /// Coordinates of a point; the first axis runs fastest. Those along the other axes are 0.
  Vec<3> point(std::size_t index) const;
};

/// The fields at one point, means over time included. Where there is no mass, what is divided by it is NaN.
struct FieldPoint {
  Vec<3> x;                   ///< [m]
  double rho = 0;             ///< [kg/m^3]
  double phi = 0;             ///< solid fraction
  double number_density = 0;  ///< particles [1/m^3]
  Vec<3> momentum;            ///< rho V [kg/(m^2 s)]
  Vec<3> velocity;            ///< V = momentum/rho [m/s]
  Vec<3> density_gradient;    ///< [kg/m^4]
  Tensor momentum_gradient;   ///< d(rho V_i)/dx_j
  /// L_ij = dV_i/dx_j, the exact derivative of the field V, from the kernel's gradient. NaN without
  /// gradients.
  Tensor velocity_gradient;
  /// The slope of the least-squares affine fit to the particles' velocities, weighted with m phi(r - r_i).
  /// Exact for affine motion however few the particles, with every kernel.
  Tensor fitted_gradient;
  Tensor contact_stress;  ///< sum of f_i b_j int phi, compression-positive as all stresses [Pa]
  Sym<3> kinetic_stress;  ///< rho <v' v'>, v' = v - V(r). Contains the shear within the kernel: see below
  /// With v' against the affine fit V + L (r_i - r), so that a smooth shear contributes nothing. In simple
  /// shear the one above is larger by rho gamma_dot^2 times the kernel's variance.
  Sym<3> kinetic_stress_beyond_shear;
  Sym<3> particle_stress;               ///< sum of V_i sigma_i phi: SPH [Pa]
  double temperature = 0;               ///< tr(kinetic_stress)/(3 rho) [m^2/s^2]
  double temperature_beyond_shear = 0;  ///< tr(kinetic_stress_beyond_shear)/(3 rho)
  double contact_density = 0;           ///< contacts in a volume; one at a wall counts half [1/m^3]
  double coordination = 0;              ///< 2 contact_density/number_density: contacts of a grain
  Sym<3> fabric;                        ///< mean of n n over the contacts, n the unit branch: trace 1
  Vec<3> wall_force;                    ///< t, by the wall on the grains [N/m^3]
  Vec<3> contact_divergence;            ///< d sigma^c_ij/dx_j, exact with every kernel [N/m^3]
  Vec<3> flux_divergence;               ///< d(sigma^k + rho V V)_ij/dx_j [N/m^3]. NaN without gradients

  /// All of it: contact (its symmetric part), kinetic, particle. What a wall would feel.
  Sym<3> stress() const;
};

struct Fields {
  Grid grid;
  std::vector<FieldPoint> points;  ///< in the order of Grid::point
  double weight = 0;               ///< sum of the frames' weights
  std::size_t frames = 0;
};

/// Sums up snapshots on a grid and derives the fields. Densities, fluxes and stresses are averaged first,
/// with the frames' weights; velocities are derived after, V = <rho V>/<rho>, and fluctuations are those
/// about that V. Only so do the averaged fields obey the balances.
///
/// A mean over a window of time takes the weights from a Kernel of one dimension:
///   const Kernel window(KernelShape::lucy, 1, 0.1);
///   sums.add(snapshot, window((t - t_0) * (t - t_0)));
///
/// Every particle visits the grid points within its kernel's support and no others.
class Accumulator {
 public:
  enum class Gradients {
    of_kernel,  ///< velocity_gradient and flux_divergence are there
    none        ///< they are NaN: the choice with a Heaviside kernel
  };
  /// Throws UsageError for a grid of another dimension than the kernel's, for axes that repeat or lack
  /// points, for gradients of a Heaviside kernel.
  Accumulator(Grid grid, const Kernel& kernel, Gradients gradients = Gradients::of_kernel);

  /// Throws UsageError for a weight that is negative or not a number. A weight of 0 is not counted.
  void add(const Snapshot& snapshot, double weight = 1);

  /// Throws UsageError if nothing was added.
  Fields fields() const;

 private:
  /// Sums over particles and contacts at one point; velocities relative to reference_.
  struct Sums {
    double rho = 0, phi = 0, number = 0, contacts = 0;
    Vec<3> momentum, density_gradient, wall_force, contact_divergence, flux_divergence;
    Sym<3> square, particle_stress, fabric;
    Tensor momentum_gradient, contact_stress;
    Vec<3> offset;         ///< m phi (r_i - r)
    Sym<3> offset_square;  ///< m phi (r_i - r)(r_i - r)
    Tensor v_offset;       ///< m phi v (r_i - r)
  };
  /// Points of one axis that one periodic image reaches: start + n spacing.
  struct Range {
    std::size_t first = 0, last = 0;
    double start = 0, spacing = 0;
  };
  template <class Visit>
  void visit(const Vec<3>& low, const Vec<3>& high, const Visit& at);
  void add_particle(const Particle& particle, double weight);
  void add_interaction(const Interaction& interaction, double weight);
  FieldPoint derive(const Sums& sums, const Vec<3>& x) const;

  Grid grid_;
  Kernel kernel_;
  bool gradients_;
  std::vector<Sums> sums_;
  std::array<std::vector<Range>, 3> ranges_;  ///< of visit(): kept to save allocations
  /// Mean velocity of the first snapshot. A packing that is carried along at 100 m/s would otherwise lose the
  /// digits of its fluctuations in <v v> - V V.
  std::optional<Vec<3>> reference_;
  double weight_ = 0;
  std::size_t frames_ = 0;
};

/// I = shear_rate d/sqrt(p/rho_s); NaN where p is not positive.
double inertial_number(double shear_rate, double p, double d, double rho_s);
/// Of a point, with the shear rate sqrt(2 D':D') of V's gradient and with p = stress()(k, k), k the direction
/// in which the velocity varies. NaN without gradients.
double inertial_number(const FieldPoint& point, int k, double d, double rho_s);

/// Integral over the grid's points with equal weights (spacing^D times the unresolved measure): exact to
/// rounding for smooth fields that vanish at the grid's ends or are periodic on it.
template <class Value>
double integral(const Fields& fields, const Value& value) {
  double cell = fields.grid.unresolved;
  for (const Axis& axis : fields.grid.axes) cell *= axis.spacing;
  double sum = 0;
  for (const FieldPoint& point : fields.points) sum += value(point);
  return cell * sum;
}

}  // namespace dem2sph::bridge
