#include "dem_bridge/coarse_graining.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "sph/base/errors.hpp"

namespace dem2sph::bridge {

namespace {

constexpr double pi = std::numbers::pi;
constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// Surface of the unit ball: 2, 2 pi, 4 pi.
double unit_surface(int dimension) { return dimension == 1 ? 2 : 2 * (dimension - 1) * pi; }

/// int_0^c R^n exp(-R^2/(2 w^2)) dR, by parts from n - 2.
double gauss_moment(int n, double w, double c) {
  const double at_cut = std::exp(-0.5 * c * c / (w * w));
  if (n == 0) return w * std::sqrt(pi / 2) * std::erf(c / (std::numbers::sqrt2 * w));
  if (n == 1) return -w * w * std::expm1(-0.5 * c * c / (w * w));
  return (n - 1) * w * w * gauss_moment(n - 2, w, c) - w * w * std::pow(c, n - 1) * at_cut;
}

/// int_0^1 q^n (1 + 3 q)(1 - q)^3 dq = B(n + 1, 4) + 3 B(n + 2, 4).
double lucy_moment(int n) { return 24.0 / ((n + 1) * (n + 3) * (n + 4) * (n + 5)); }

}  // namespace

Kernel::Kernel(KernelShape shape, int dimension, double width, double cut)
    : shape_(shape), dimension_(dimension), width_(width) {
  if (dimension < 1 || dimension > 3)
    throw UsageError(fmt::format("a kernel of {} dimensions; there are 1, 2 and 3", dimension));
  if (!(width > 0) || !std::isfinite(width))
    throw UsageError(fmt::format("a kernel's width must be positive, not {}", width));
  if (!(cut > 0) || !std::isfinite(cut))
    throw UsageError(fmt::format("the cut of a Gauss kernel must be positive, not {}", cut));
  radius_ = shape == KernelShape::gauss ? cut * width : width;
  // With f(q) the shape: 1/norm = S c^D int q^(D-1) f dq, and <x^2> = <R^2>/D by isotropy.
  const int n = dimension;
  const double c = radius_, surface = unit_surface(n);
  double volume = 0, second = 0;
  switch (shape) {
    case KernelShape::gauss:
      lowered_ = std::exp(-0.5 * cut * cut);
      volume = surface * (gauss_moment(n - 1, width, c) - lowered_ * std::pow(c, n) / n);
      second = surface * (gauss_moment(n + 1, width, c) - lowered_ * std::pow(c, n + 2) / (n + 2));
      break;
    case KernelShape::lucy:  // 4 c/5, pi c^2/5, 16 pi c^3/105
      volume = surface * std::pow(c, n) * lucy_moment(n - 1);
      second = surface * std::pow(c, n + 2) * lucy_moment(n + 1);
      break;
    case KernelShape::heaviside:  // 2 c, pi c^2, 4 pi c^3/3
      volume = surface * std::pow(c, n) / n;
      second = surface * std::pow(c, n + 2) / (n + 2);
      break;
  }
  norm_ = 1 / volume;
  variance_ = second * norm_ / n;
}

double Kernel::operator()(double distance_squared) const {
  if (!(distance_squared < radius_ * radius_)) return 0;
  switch (shape_) {
    case KernelShape::gauss:
      return norm_ * (std::exp(-0.5 * distance_squared / (width_ * width_)) - lowered_);
    case KernelShape::lucy: {
      const double q = std::sqrt(distance_squared) / radius_;
      return norm_ * (1 + 3 * q) * (1 - q) * (1 - q) * (1 - q);
    }
    case KernelShape::heaviside:
      break;
  }
  return norm_;
}

double Kernel::slope(double distance_squared) const {
  if (!(distance_squared < radius_ * radius_)) return 0;
  switch (shape_) {
    case KernelShape::gauss:
      return -norm_ / (width_ * width_) * std::exp(-0.5 * distance_squared / (width_ * width_));
    case KernelShape::lucy: {  // d/dq of the bracket is -12 q (1 - q)^2
      const double q = std::sqrt(distance_squared) / radius_;
      return -12 * norm_ / (radius_ * radius_) * (1 - q) * (1 - q);
    }
    case KernelShape::heaviside:
      break;
  }
  return 0;
}

/// int of phi over norm along a straight line within the support, from t = a to b. t is the arc length from
/// the foot of the perpendicular h from the kernel's centre: R^2 = h^2 + t^2. `part` is b - a, which is known
/// better than the two: a branch that lies across the resolved axis is short, and everything is written as a
/// multiple of `part` so that it loses no digits.
double Kernel::along(double a, double b, double part, double h_squared) const {
  switch (shape_) {
    case KernelShape::gauss: {
      const double v = width_ * width_;
      if (part > 0.05 * width_)
        return std::exp(-0.5 * h_squared / v) * width_ * std::sqrt(pi / 2) *
                   (std::erf(b / (std::numbers::sqrt2 * width_)) -
                    std::erf(a / (std::numbers::sqrt2 * width_))) -
               lowered_ * part;
      // The difference of erf loses digits. Five Gauss points are exact here: 0.05^10/10^9.
      constexpr std::array<double, 3> node{0, 0.538469310105683091, 0.906179845938663993};
      constexpr std::array<double, 3> weight{0.284444444444444444, 0.239314335249683234,
                                             0.118463442528094544};
      double sum = 0;
      for (std::size_t k = 0; k < node.size(); ++k)
        for (const double side : {-1.0, 1.0}) {
          const double t = 0.5 * (a + b) + side * 0.5 * part * node[k];
          sum += (k == 0 ? 0.5 : 1.0) * weight[k] * std::exp(-0.5 * (h_squared + t * t) / v);
        }
      return part * (sum - lowered_);
    }
    case KernelShape::lucy: {
      // 1 - 6 R^2 + 8 R^3 - 3 R^4 in units of c. The even powers are polynomials; by parts, with g(R) = R (2
      // R^2 + 3 h^2)/8,
      //   int R^3 dt = [t g(R)] + 3 h^4/8 [asinh(t/h)],
      // [t g] = (b - a)(g_a + g_b)/2 + (a + b)(g_b - g_a)/2,  R_b - R_a = (b - a)(a + b)/(R_a + R_b),
      // and a difference of two asinh is one asinh.
      const double x = a / radius_, y = b / radius_, q = part / radius_, h2 = h_squared / (radius_ * radius_);
      const double ra = std::sqrt(h2 + x * x), rb = std::sqrt(h2 + y * y);
      const double second = (x * x + x * y + y * y) / 3;
      const double fourth = (x * x * x * x + x * y * (x * x + x * y + y * y) + y * y * y * y) / 5;
      const double square = q * (h2 + second);
      const double quartic = q * (h2 * h2 + 2 * h2 * second + fourth);
      const double g_mean = (ra * (2 * ra * ra + 3 * h2) + rb * (2 * rb * rb + 3 * h2)) / 16;
      const double g_slope = (x + y) / (ra + rb) * (2 * (ra * ra + ra * rb + rb * rb) + 3 * h2) / 8;
      double cubic = q * (g_mean + 0.5 * (x + y) * g_slope);
      if (h2 > 0) {
        const double h = std::sqrt(h2);
        const double angle =
            x * y > 0 ? std::asinh(q * (x + y) / (y * ra + x * rb)) : std::asinh(y / h) - std::asinh(x / h);
        cubic += 3 * h2 * h2 / 8 * angle;
      }
      return radius_ * (q - 6 * square + 8 * cubic - 3 * quartic);
    }
    case KernelShape::heaviside:
      break;
  }
  return part;
}

double Kernel::line_integral(const Vec<3>& u, const Vec<3>& b) const {
  const double c2 = radius_ * radius_;
  const double length = norm(b);
  if (!(length > 1e-14 * radius_)) return (*this)(dot(u, u));  // a point, to rounding
  const double start = dot(u, b) / length;
  // The perpendicular as a vector: a difference of squares would lose half of the digits.
  const Vec<3> foot = u - (start / length) * b;
  const double h2 = dimension_ == 1 ? 0 : dot(foot, foot);
  if (!(h2 < c2)) return 0;
  const double half_chord = std::sqrt(c2 - h2);
  const double low = std::max(start, -half_chord), high = std::min(start + length, half_chord);
  if (!(high > low)) return 0;
  const double from = low > start ? (low - start) / length : 0;
  const double to = high < start + length ? (high - start) / length : 1;
  return norm_ / length * along(low, high, (to - from) * length, h2);
}

std::size_t Grid::size() const {
  std::size_t count = axes.empty() ? 0 : 1;
  for (const Axis& axis : axes) count *= axis.points;
  return count;
}

Vec<3> Grid::point(std::size_t index) const {
  Vec<3> x;
  for (const Axis& axis : axes) {
    x[axis.direction] = axis.low + static_cast<double>(index % axis.points) * axis.spacing;
    index /= axis.points;
  }
  return x;
}

Sym<3> FieldPoint::stress() const {
  Sym<3> sum = kinetic_stress;
  sum += particle_stress;
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) sum(i, j) += 0.5 * (contact_stress(i, j) + contact_stress(j, i));
  return sum;
}

Accumulator::Accumulator(Grid grid, const Kernel& kernel, Gradients gradients)
    : grid_(std::move(grid)), kernel_(kernel), gradients_(gradients == Gradients::of_kernel) {
  if (grid_.dimension() != kernel_.dimension())
    throw UsageError(
        fmt::format("a grid of {} axes and a kernel of {}", grid_.dimension(), kernel_.dimension()));
  if (gradients_ && !kernel_.has_gradient())
    throw UsageError(
        "a Heaviside kernel has no gradient: take Gauss or Lucy, or Gradients::none and the fitted gradient");
  if (!(grid_.unresolved > 0)) throw UsageError("the grid's unresolved measure must be positive");
  std::array<bool, 3> taken{};
  for (const Axis& axis : grid_.axes) {
    if (axis.direction < 0 || axis.direction > 2 || taken[static_cast<std::size_t>(axis.direction)])
      throw UsageError("the axes of a grid are different ones of 0, 1, 2");
    taken[static_cast<std::size_t>(axis.direction)] = true;
    if (axis.points == 0 || !(axis.spacing > 0) || !(axis.period >= 0) || !std::isfinite(axis.low))
      throw UsageError("an axis of a grid needs points, a positive spacing and a period of 0 or more");
  }
  sums_.resize(grid_.size());
}

/// Calls at(sums, r) for each point of the grid within the box that `low` to `high` spans, widened by the
/// kernel's radius, and for all its periodic images; r is the point minus the image's shift, in the
/// components of the resolved axes, first axis first.
template <class Visit>
void Accumulator::visit(const Vec<3>& low, const Vec<3>& high, const Visit& at) {
  const double c = kernel_.radius();
  std::array<std::size_t, 3> stride{};
  // Of each axis the points that each image can reach. An axis that the grid lacks has one, so that three
  // loops do for all.
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<Range>& ranges = ranges_[k];
    ranges.clear();
    if (k >= grid_.axes.size()) {
      ranges.push_back({0, 0, 0, 0});
      continue;
    }
    const Axis& axis = grid_.axes[k];
    stride[k] = k == 0 ? 1 : stride[k - 1] * grid_.axes[k - 1].points;
    const double from = low.c[k] - c, to = high.c[k] + c;
    const double last = static_cast<double>(axis.points) - 1;
    double first_image = 0, last_image = 0;
    if (axis.period > 0) {
      first_image = std::ceil((axis.low - to) / axis.period);
      last_image = std::floor((axis.low + last * axis.spacing - from) / axis.period);
    }
    for (double image = first_image; image <= last_image; ++image) {
      const double start = axis.low - image * axis.period;
      const double first = std::max(0.0, std::ceil((from - start) / axis.spacing));
      const double end = std::min(last, std::floor((to - start) / axis.spacing));
      if (first <= end)
        ranges.push_back(
            {static_cast<std::size_t>(first), static_cast<std::size_t>(end), start, axis.spacing});
    }
  }
  const auto coordinate = [](const Range& range, std::size_t n) {
    return range.start + static_cast<double>(n) * range.spacing;
  };
  Vec<3> r;
  for (const Range& z : ranges_[2])
    for (const Range& y : ranges_[1])
      for (const Range& x : ranges_[0])
        for (std::size_t k = z.first; k <= z.last; ++k) {
          r[2] = coordinate(z, k);
          for (std::size_t j = y.first; j <= y.last; ++j) {
            r[1] = coordinate(y, j);
            for (std::size_t i = x.first; i <= x.last; ++i) {
              r[0] = coordinate(x, i);
              at(sums_[i * stride[0] + j * stride[1] + k * stride[2]], r);
            }
          }
        }
}

namespace {

/// The components along the grid's axes, first axis first.
Vec<3> resolved(const Grid& grid, const Vec<3>& x) {
  Vec<3> r;
  for (int k = 0; k < grid.dimension(); ++k) r[k] = x[grid.axes[static_cast<std::size_t>(k)].direction];
  return r;
}

/// The other way round, zeros elsewhere.
Vec<3> in_space(const Grid& grid, const Vec<3>& r) {
  Vec<3> x;
  for (int k = 0; k < grid.dimension(); ++k) x[grid.axes[static_cast<std::size_t>(k)].direction] = r[k];
  return x;
}

void add_product(Tensor& sum, double weight, const Vec<3>& a, const Vec<3>& b) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum(i, j) += weight * a[i] * b[j];
}

void add_square(Sym<3>& sum, double weight, const Vec<3>& a) {
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j) sum(i, j) += weight * a[i] * a[j];
}

bool finite(const Vec<3>& a) { return std::isfinite(a[0] + a[1] + a[2]); }

}  // namespace

void Accumulator::add_particle(const Particle& p, double weight) {
  if (!finite(p.x) || !finite(p.v) || !std::isfinite(p.mass))
    throw InputError("coarse-graining: position, velocity or mass of a particle is not a number");
  const Vec<3> centre = resolved(grid_, p.x);
  const Vec<3> v = p.v - *reference_;
  const double c2 = kernel_.radius() * kernel_.radius();
  visit(centre, centre, [&](Sums& sums, const Vec<3>& point) {
    const Vec<3> r = point - centre;  // in the grid's axes
    const double distance_squared = dot(r, r);
    if (!(distance_squared < c2)) return;
    const double w = weight * kernel_(distance_squared);
    const double m = w * p.mass;
    const Vec<3> offset = in_space(grid_, centre - point);
    sums.rho += m;
    sums.phi += w * p.solid_volume;
    sums.number += w;
    sums.momentum += m * v;
    add_square(sums.square, m, v);
    sums.offset += m * offset;
    add_square(sums.offset_square, m, offset);
    add_product(sums.v_offset, m, v, offset);
    for (int k = 0; k < 6; ++k) sums.particle_stress[k] += w * p.stress_volume[k];
    if (!gradients_) return;
    const Vec<3> gradient = (-weight * p.mass * kernel_.slope(distance_squared)) * offset;
    sums.density_gradient += gradient;
    add_product(sums.momentum_gradient, 1, v, gradient);
    sums.flux_divergence += dot(p.v, gradient) * p.v;
  });
}

void Accumulator::add_interaction(const Interaction& a, double weight) {
  if (!finite(a.from) || !finite(a.branch) || !finite(a.force))
    throw InputError("coarse-graining: end, branch or force of an interaction is not a number");
  const Vec<3> from = resolved(grid_, a.from), branch = resolved(grid_, a.branch);
  const Vec<3> end = from - branch;
  Vec<3> low, high;
  for (int k = 0; k < 3; ++k) low[k] = std::min(from[k], end[k]), high[k] = std::max(from[k], end[k]);
  const double size = norm(a.branch);
  if (!(size > 0)) throw InputError("coarse-graining: both ends of an interaction are at one place");
  const Vec<3> unit = (1 / size) * a.branch;
  visit(low, high, [&](Sums& sums, const Vec<3>& point) {
    const Vec<3> to_from = point - from, to_end = point - end;
    const double line = weight * kernel_.line_integral(to_from, branch);
    if (line > 0) {
      add_product(sums.contact_stress, line, a.force, a.branch);
      // Half of a contact with a wall belongs to the wall.
      const double count = a.wall ? 0.5 * line : line;
      sums.contacts += count;
      add_square(sums.fabric, count, unit);
    }
    // The difference of the ends is the divergence of the line between, kernel by kernel.
    const double at_from = weight * kernel_(dot(to_from, to_from));
    const double at_end = weight * kernel_(dot(to_end, to_end));
    sums.contact_divergence += (at_end - at_from) * a.force;
    if (a.wall) sums.wall_force += at_end * a.force;
  });
}

void Accumulator::add(const Snapshot& snapshot, double weight) {
  if (!(weight >= 0) || !std::isfinite(weight))
    throw UsageError(fmt::format("coarse-graining: the weight of a frame is {}", weight));
  if (weight == 0) return;
  if (!reference_) {
    Vec<3> momentum;
    double mass = 0;
    for (const Particle& p : snapshot.particles) momentum += p.mass * p.v, mass += p.mass;
    if (mass > 0) reference_ = (1 / mass) * momentum;
  }
  if (!reference_) reference_ = Vec<3>{};
  for (const Particle& p : snapshot.particles) add_particle(p, weight);
  for (const Interaction& a : snapshot.interactions) add_interaction(a, weight);
  weight_ += weight;
  ++frames_;
}

namespace {

/// The affine fit to velocities about the centroid of mass: with M = <m d d> and C = <m v d>, d and v
/// relative to their means, the slope is C M^-1 and what it explains of <m v v> is C M^-1 C^T. Directions
/// along which the particles have no extent (one particle, a single layer) are left out.
struct AffineFit {
  Eigen::Matrix3d slope, explained;
};

AffineFit affine_fit(const Eigen::Matrix3d& moment, const Eigen::Matrix3d& covariance, double scale) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(moment);
  Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();
  // `scale` is rho c^2: no extent is one below 1e-5 c, whose square is what rounding leaves five digits of.
  for (int k = 0; k < 3; ++k)
    if (eigen.eigenvalues()[k] > 1e-10 * scale)
      inverse +=
          eigen.eigenvectors().col(k) * eigen.eigenvectors().col(k).transpose() / eigen.eigenvalues()[k];
  AffineFit fit;
  fit.slope = covariance * inverse;
  fit.explained = fit.slope * covariance.transpose();
  return fit;
}

}  // namespace

FieldPoint Accumulator::derive(const Sums& sums, const Vec<3>& x) const {
  const double scale = 1 / (weight_ * grid_.unresolved);
  FieldPoint f;
  f.x = x;
  f.rho = scale * sums.rho;
  f.phi = scale * sums.phi;
  f.number_density = scale * sums.number;
  f.momentum = scale * sums.momentum + f.rho * *reference_;
  f.density_gradient = scale * sums.density_gradient;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      f.momentum_gradient(i, j) =
          scale * sums.momentum_gradient(i, j) + (*reference_)[i] * f.density_gradient[j];
      f.contact_stress(i, j) = scale * sums.contact_stress(i, j);
    }
  f.particle_stress = sums.particle_stress;
  f.particle_stress *= scale;
  f.contact_density = scale * sums.contacts;
  f.wall_force = scale * sums.wall_force;
  f.contact_divergence = scale * sums.contact_divergence;
  f.flux_divergence = scale * sums.flux_divergence;
  if (!gradients_) {
    f.density_gradient = f.flux_divergence = {{nan, nan, nan}};
    f.momentum_gradient.c.fill(nan);
  }
  f.fabric.c.fill(nan);
  if (sums.contacts > 0) {
    f.fabric = sums.fabric;
    f.fabric *= 1 / sums.contacts;
  }
  f.velocity_gradient.c.fill(nan);
  f.fitted_gradient.c.fill(nan);
  if (!(sums.rho > 0)) {
    f.velocity = {{nan, nan, nan}};
    f.temperature = f.temperature_beyond_shear = f.coordination = nan;
    return f;
  }
  const Vec<3> u = (1 / sums.rho) * sums.momentum;  // relative to the reference
  f.velocity = u + *reference_;
  f.coordination = 2 * sums.contacts / sums.number;

  Eigen::Matrix3d moment, covariance;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      moment(i, j) = sums.offset_square(i, j) - sums.offset[i] * sums.offset[j] / sums.rho;
      covariance(i, j) = sums.v_offset(i, j) - u[i] * sums.offset[j];
      if (gradients_)
        f.velocity_gradient(i, j) =
            (sums.momentum_gradient(i, j) - u[i] * sums.density_gradient[j]) / sums.rho;
    }
  const AffineFit fit = affine_fit(moment, covariance, sums.rho * kernel_.radius() * kernel_.radius());
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      f.fitted_gradient(i, j) = fit.slope(i, j);
      if (j < i) continue;
      const double square = sums.square(i, j) - u[i] * sums.momentum[j];
      f.kinetic_stress(i, j) = scale * square;
      f.kinetic_stress_beyond_shear(i, j) = scale * (square - fit.explained(i, j));
    }
  f.temperature = f.kinetic_stress.trace() / (3 * f.rho);
  f.temperature_beyond_shear = f.kinetic_stress_beyond_shear.trace() / (3 * f.rho);
  return f;
}

Fields Accumulator::fields() const {
  if (frames_ == 0) throw UsageError("coarse-graining: no frame was added");
  Fields fields{grid_, {}, weight_, frames_};
  fields.points.reserve(sums_.size());
  for (std::size_t k = 0; k < sums_.size(); ++k) fields.points.push_back(derive(sums_[k], grid_.point(k)));
  return fields;
}

double inertial_number(double shear_rate, double p, double d, double rho_s) {
  if (!(p > 0)) return nan;
  return std::abs(shear_rate) * d / std::sqrt(p / rho_s);
}

double inertial_number(const FieldPoint& point, int k, double d, double rho_s) {
  return inertial_number(shear_rate(deviator(strain_rate(point.velocity_gradient))), point.stress()(k, k), d,
                         rho_s);
}

}  // namespace dem2sph::bridge
