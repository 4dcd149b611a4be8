// The geometry of a case: walls as signed distances, bodies as shapes, periodic directions. Grains and SPH
// particles are set up from the same description.
//
// Coordinates: the last axis points up; in 2D x = (x, up), in 3D x = (x, across, up). The room that the
// material may take is where the distance to every wall is positive. An example: a floor is a plane through
// the origin with the normal (0, 1); at x = (3, 0.2) its distance is 0.2 and its normal (0, 1).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "sph/base/case_file.hpp"
#include "sph/base/tensor.hpp"

namespace dem2sph {

/// Rigid rotation: velocity of x that turns with `omega` about `centre`. In 2D omega is anticlockwise in the
/// (x, up) plane, in 3D right-handed about `axis`.
template <int Dim>
Vec<Dim> rotation_velocity(const Vec<Dim>& from_centre, [[maybe_unused]] const Vec<Dim>& axis, double omega) {
  const Vec<Dim>& r = from_centre;
  Vec<Dim> v;
  if constexpr (Dim == 2) {
    v[0] = -omega * r[1];
    v[1] = omega * r[0];
  } else {
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      v[i] = omega * (axis[j] * r[k] - axis[k] * r[j]);
    }
  }
  return v;
}

enum class WallShape {
  plane,    ///< half space; the material is on the side of the normal
  box,      ///< aligned with the axes
  cylinder  ///< infinitely long along its axis; in 2D a circle
};

/// One wall. Distances in m, positive where material may be.
template <int Dim>
struct Wall {
  std::string name;
  WallShape shape = WallShape::plane;
  bool inside = true;  ///< box, cylinder: the material is inside (a container) or outside (an obstacle)
  Vec<Dim> point;      ///< plane: a point of the surface; box: its centre; cylinder: a point of its axis
  Vec<Dim> direction;  ///< plane: unit normal into the material; cylinder in 3D: unit axis
  Vec<Dim> half;       ///< box: half of its extents [m]; infinite along a periodic direction that it fills
  double radius = 0;   ///< cylinder [m]
  Vec<Dim> velocity;   ///< of translation, now [m/s]
  double period = 0;   ///< of an oscillation: velocity = swing cos(2 pi t/period) [s]; 0: it is steady
  Vec<Dim> swing;      ///< largest velocity of an oscillation [m/s]
  double omega = 0;   ///< of rotation about `point` (2D: plane, cylinder) or the cylinder's axis (3D) [rad/s]
  bool rough = true;  ///< a rough wall drags the material along; a smooth one is frictionless
  double basal_friction = std::numeric_limits<double>::quiet_NaN();  ///< mu_b; NaN: that of the material

  /// Signed distance to the surface. Outside a box near an edge it is the distance to the edge.
  double distance(const Vec<Dim>& x) const;
  /// Unit vector along which the distance grows fastest, into the material.
  Vec<Dim> normal(const Vec<Dim>& x) const;
  /// Velocity of the wall's material at x [m/s].
  Vec<Dim> velocity_at(const Vec<Dim>& x) const;
  bool moves() const;
  /// Takes the velocity that an oscillation has at `time`; a steady one stays.
  void swing_at(double time);
  /// Moves the surface by dt along its velocity. Rotation leaves planes' points, and cylinders, where they
  /// are; it turns the normal of a plane in 2D.
  void move(double dt);

 private:
  /// From the cylinder's axis to x, normal to the axis.
  Vec<Dim> from_axis(const Vec<Dim>& x) const;
};

template <int Dim>
Vec<Dim> Wall<Dim>::from_axis(const Vec<Dim>& x) const {
  Vec<Dim> r = x - point;
  if constexpr (Dim == 3) r -= dot(r, direction) * direction;
  return r;
}

template <int Dim>
double Wall<Dim>::distance(const Vec<Dim>& x) const {
  switch (shape) {
    case WallShape::plane:
      return dot(x - point, direction);
    case WallShape::box: {
      double beyond = 0;  // squared distance to the box of a point outside of it
      double deepest = -std::numeric_limits<double>::infinity();
      for (int i = 0; i < Dim; ++i) {
        const double q = std::abs(x[i] - point[i]) - half[i];
        beyond += q > 0 ? q * q : 0;
        deepest = std::max(deepest, q);
      }
      const double outside = deepest > 0 ? std::sqrt(beyond) : deepest;
      return inside ? -outside : outside;
    }
    case WallShape::cylinder: {
      const double r = norm(from_axis(x));
      return inside ? radius - r : r - radius;
    }
  }
  return std::numeric_limits<double>::quiet_NaN();
}

template <int Dim>
Vec<Dim> Wall<Dim>::normal(const Vec<Dim>& x) const {
  if (shape == WallShape::plane) return direction;
  Vec<Dim> out;  // away from the box or the axis
  if (shape == WallShape::box) {
    int face = 0;
    double deepest = -std::numeric_limits<double>::infinity();
    for (int i = 0; i < Dim; ++i) {
      const double q = std::abs(x[i] - point[i]) - half[i];
      if (q > deepest) {
        deepest = q;
        face = i;
      }
      if (q > 0) out[i] = x[i] > point[i] ? q : -q;
    }
    if (!(deepest > 0)) {
      out = Vec<Dim>{};
      out[face] = x[face] < point[face] ? -1 : 1;
    }
  } else {
    out = from_axis(x);
  }
  double length = norm(out);
  if (!(length > 0)) {
    // On the axis every direction across it is as good as another.
    int across = 0;
    if constexpr (Dim == 3) across = std::abs(direction[0]) > 0.5 ? 2 : 0;
    out = Vec<Dim>{};
    out[across] = 1;
    if constexpr (Dim == 3) out -= dot(out, direction) * direction;
    length = norm(out);
  }
  return ((inside ? -1 : 1) / length) * out;
}

template <int Dim>
Vec<Dim> Wall<Dim>::velocity_at(const Vec<Dim>& x) const {
  return omega == 0 ? velocity : velocity + rotation_velocity(x - point, direction, omega);
}

/// A body of material at t = 0.
template <int Dim>
struct Body {
  enum class Shape {
    box,       ///< from low to high
    cylinder,  ///< 3D, upright: its axis goes from `low` to `high`, which lies above it
    heap  ///< from `low` to the tip `high` above it, falling at `angle`: a cone in 3D, in 2D a triangle, of
          ///< which there is only the side x > low[0] unless `both_sides`
  };
  std::string name;
  Shape shape = Shape::box;
  Vec<Dim> low;
  Vec<Dim> high;
  Vec<Dim> velocity;        ///< at t = 0 [m/s]
  double radius = 0;        ///< cylinder [m]
  double angle = 0;         ///< heap [rad]
  bool both_sides = false;  ///< heap in 2D
  bool contains(const Vec<Dim>& x) const;
  /// Height of the body's top surface above x, along the vertical [m]; 0 at the surface.
  double depth(const Vec<Dim>& x) const;
};

template <int Dim>
struct Geometry {
  Vec<Dim> low;  ///< of the domain: walls are built only within it [m]
  Vec<Dim> high;
  std::array<bool, static_cast<std::size_t>(Dim)> periodic{};  ///< the last direction never is
  std::vector<Wall<Dim>> walls;
  std::vector<Body<Dim>> bodies;
};

/// Points of a geometry on a lattice of spacing dx.
template <int Dim>
struct GeometryPoints {
  std::vector<Vec<Dim>> interior;
  std::vector<std::size_t> body;  ///< of each interior point
  std::vector<Vec<Dim>> walls;
  std::vector<std::size_t> wall;  ///< index of the wall that each wall point belongs to
};

/// Fills bodies with a cubic lattice (cell centres at low + (i + 1/2) dx of the domain, kept where the point
/// is in a body, the first of the list if in several, and at least 0.45 dx from every wall), and walls with
/// `layers` layers behind their surfaces at depths (k + 1/2) dx: planes in rows parallel to them (on the same
/// lattice as the material where the plane is normal to an axis), boxes in rows from their corner, fitted to
/// the faces, cylinders in rings. Walls are built within the domain and `layers` dx around it, in periodic
/// directions within the period. No wall point lies where another wall that comes earlier in the list has its
/// own, nor nearer than 0.7 dx to one, nor in the room of the material. Periodic directions hold a whole
/// number of dx (the caller sees to it); rows are fitted to them. Points come in the order of across, up, x,
/// the last fastest. Throws UsageError if a body has no point, or if a wall has none within the domain.
template <int Dim>
GeometryPoints<Dim> fill(const Geometry<Dim>& geometry, double dx, int layers);

/// Reads [domain], [wall.NAME], [body.NAME]. Throws UsageError at file and line for what is wrong.
template <int Dim>
Geometry<Dim> read_geometry(const CaseFile& file);

/// A plane geometry as a slab of grains has it: x stays, up becomes the third axis, and the second, across,
/// is periodic over `depth` [m].
Geometry<3> slab_of(const Geometry<2>& plane, double depth);

/// Tables of those sections; "wall.*" stands for any name.
std::vector<const ParameterTable*> geometry_tables();

}  // namespace dem2sph
