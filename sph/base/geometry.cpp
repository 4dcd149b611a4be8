#include "sph/base/geometry.hpp"

#include <fmt/format.h>

#include <cstdint>
#include <numbers>
#include <unordered_map>
#include <utility>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

const ParameterTable domain_table{
    "domain",
    "Extents of the case: walls are built within them, and material is only there.",
    {
        {"low", Kind::quantities, "m", -1e6, 1e6, "required", "Lowest corner: x, (across,) up."},
        {"high", Kind::quantities, "m", -1e6, 1e6, "required", "Highest corner."},
        {"periodic",
         Kind::word,
         "",
         0,
         0,
         "none",
         "Directions whose ends are joined.",
         {"none", "x", "across", "x_and_across"}},
    }};

const ParameterTable wall_table{
    "wall.*",
    "A wall; the material is where the distance to every wall is positive.",
    {
        {"shape", Kind::word, "", 0, 0, "required", "Its surface.", {"plane", "box", "cylinder"}},
        {"side",
         Kind::word,
         "",
         0,
         0,
         "unset",
         "Where the material is (box, cylinder): in a container, or around an obstacle.",
         {"inside", "outside"}},
        {"point", Kind::quantities, "m", -1e6, 1e6, "required",
         "A point of the plane, the centre of the box, or a point of the cylinder's axis."},
        {"normal", Kind::numbers, "", -unbounded, unbounded, "unset",
         "Into the material, of any length (plane)."},
        {"half", Kind::quantities, "m", 1e-6, 1e6, "unset", "Half of the extents (box)."},
        {"radius", Kind::quantity, "m", 1e-6, 1e6, "unset", "Of the cylinder, which in 2D is a circle."},
        {"axis",
         Kind::word,
         "",
         0,
         0,
         "across",
         "Direction of a cylinder's axis, in 3D.",
         {"x", "across", "up"}},
        {"velocity", Kind::quantities, "m/s", -1e4, 1e4, "unset", "Of translation; unset: none."},
        {"period", Kind::quantity, "s", 1e-9, 1e9, "unset",
         "Of an oscillation: the velocity times cos(2 pi t/period); unset: it is steady."},
        {"angular_velocity", Kind::quantity, "rad/s", -1e5, 1e5, "0 rad/s",
         "Of a cylinder about its axis, right-handed, or in 2D of a plane or circle about its point, "
         "anticlockwise."},
        {"surface",
         Kind::word,
         "",
         0,
         0,
         "rough",
         "A rough wall drags the material along, a smooth one is without friction.",
         {"rough", "smooth"}},
        {"basal_friction", Kind::number, "", 0, 3, "unset",
         "Friction between wall and material (rough); unset: that of the material."},
    }};

const ParameterTable body_table{
    "body.*",
    "A body of material at t = 0.",
    {
        {"shape", Kind::word, "", 0, 0, "required", "Its form.", {"box", "cylinder", "heap"}},
        {"low", Kind::quantities, "m", -1e6, 1e6, "required",
         "Lowest corner (box), or the middle of the base (cylinder, heap)."},
        {"high", Kind::quantities, "m", -1e6, 1e6, "required",
         "Highest corner (box), or the middle of the top or the tip, right above low (cylinder, heap)."},
        {"velocity", Kind::quantities, "m/s", -1e4, 1e4, "unset", "At t = 0; unset: at rest."},
        {"radius", Kind::quantity, "m", 1e-6, 1e6, "unset", "Of the cylinder."},
        {"angle", Kind::quantity, "rad", 1e-3, 1.5, "unset",
         "Slope of the heap's surface, for example \"25 deg\"."},
        {"both_sides", Kind::flag, "", 0, 0, "false",
         "In 2D: a heap to both sides of its tip, not only to x > low."},
    }};

constexpr double slack = 1e-6;  // in dx: what rounding may move a lattice point by, with a wide margin

template <int Dim>
constexpr std::size_t index_of(int axis) {
  static_assert(Dim == 2 || Dim == 3);
  return static_cast<std::size_t>(axis);
}

template <int Dim>
std::string axis_name(int axis) {
  return axis == 0 ? "x" : axis == Dim - 1 ? "up" : "across";
}

/// The axis that a unit vector is along, or -1.
template <int Dim>
int axis_along(const Vec<Dim>& unit) {
  for (int i = 0; i < Dim; ++i)
    if (std::abs(unit[i]) > 1 - 1e-12) return i;
  return -1;
}

/// Points sorted into cubes, to find the neighbours of another point, across periodic borders too.
template <int Dim>
class PointGrid {
 public:
  PointGrid(const Geometry<Dim>& geometry, double reach) : geometry_(geometry), reach_(reach) {}

  void add(const Vec<Dim>& x, std::size_t owner) { cells_[key(cell(x))].push_back({x, owner}); }

  /// Calls visit(squared distance, owner) for every point nearer than `reach`.
  template <class Visit>
  void near(const Vec<Dim>& x, const Visit& visit) const {
    image(x, 0, visit);
  }

 private:
  using Cell = std::array<std::int64_t, static_cast<std::size_t>(Dim)>;
  struct Entry {
    Vec<Dim> x;
    std::size_t owner;
  };

  // x itself and, near the border of a periodic direction, its copy beyond the other border.
  template <class Visit>
  void image(const Vec<Dim>& x, int axis, const Visit& visit) const {
    if (axis == Dim) return look(x, visit);
    image(x, axis + 1, visit);
    if (!geometry_.periodic[index_of<Dim>(axis)]) return;
    const double period = geometry_.high[axis] - geometry_.low[axis];
    for (const double sign : {-1.0, 1.0}) {
      Vec<Dim> copy = x;
      copy[axis] += sign * period;
      if (copy[axis] > geometry_.low[axis] - reach_ && copy[axis] < geometry_.high[axis] + reach_)
        image(copy, axis + 1, visit);
    }
  }
  template <class Visit>
  void look(const Vec<Dim>& x, const Visit& visit) const {
    const Cell middle = cell(x);
    constexpr int cells = Dim == 2 ? 9 : 27;
    for (int n = 0; n < cells; ++n) {
      Cell c = middle;
      int digits = n;
      for (std::int64_t& component : c) {
        component += digits % 3 - 1;
        digits /= 3;
      }
      const auto found = cells_.find(key(c));
      if (found == cells_.end()) continue;
      for (const Entry& entry : found->second) {
        const Vec<Dim> r = entry.x - x;
        if (dot(r, r) < reach_ * reach_) visit(dot(r, r), entry.owner);
      }
    }
  }
  Cell cell(const Vec<Dim>& x) const {
    Cell c;
    for (int i = 0; i < Dim; ++i)
      c[index_of<Dim>(i)] = static_cast<std::int64_t>(std::floor((x[i] - geometry_.low[i]) / reach_));
    return c;
  }
  // Two far cells may share a key; the distance tells their points apart.
  static std::uint64_t key(const Cell& c) {
    std::uint64_t key = 0;
    for (const std::int64_t component : c)
      key = (key << 21U) ^ (static_cast<std::uint64_t>(component) & 0x1fffffU);
    return key;
  }

  const Geometry<Dim>& geometry_;
  double reach_;
  std::unordered_map<std::uint64_t, std::vector<Entry>> cells_;
};

template <int Dim>
using Rows = std::array<std::vector<double>, static_cast<std::size_t>(Dim)>;  // coordinates along each axis

/// Calls visit(point, indices) for all points of a lattice in the order of across, up, x.
template <int Dim, class Visit>
void for_lattice(const Rows<Dim>& rows, const Visit& visit) {
  std::array<std::size_t, static_cast<std::size_t>(Dim)> at{};
  Vec<Dim> x;
  const auto plane = [&] {
    for (at[Dim - 1] = 0; at[Dim - 1] < rows[Dim - 1].size(); ++at[Dim - 1]) {
      x[Dim - 1] = rows[Dim - 1][at[Dim - 1]];
      for (at[0] = 0; at[0] < rows[0].size(); ++at[0]) {
        x[0] = rows[0][at[0]];
        visit(std::as_const(x), std::as_const(at));
      }
    }
  };
  if constexpr (Dim == 2) {
    plane();
  } else {
    for (at[1] = 0; at[1] < rows[1].size(); ++at[1]) {
      x[1] = rows[1][at[1]];
      plane();
    }
  }
}

/// Extents of a body along an axis.
template <int Dim>
std::pair<double, double> extents(const Body<Dim>& body, int axis) {
  if (axis == Dim - 1 || body.shape == Body<Dim>::Shape::box) return {body.low[axis], body.high[axis]};
  const double reach = body.shape == Body<Dim>::Shape::cylinder
                           ? body.radius
                           : (body.high[Dim - 1] - body.low[Dim - 1]) / std::tan(body.angle);
  return {body.low[axis] - reach, body.low[axis] + reach};
}

template <int Dim>
class Filling {
 public:
  Filling(const Geometry<Dim>& geometry, double dx, int layers)
      : geometry_(geometry), dx_(dx), layers_(layers), grid_(geometry, nearest_in_layers * dx) {}

  GeometryPoints<Dim> points() {
    bodies();
    for (std::size_t i = 0; i < geometry_.walls.size(); ++i) wall(i);
    return std::move(points_);
  }

 private:
  // Least distance to a point of an earlier wall, in dx: in general, and where that wall has its layers.
  // There its own points are at most sqrt(3)/2 dx away, so that the two walls never mix, however their
  // lattices lie.
  static constexpr double nearest_allowed = 0.7;
  static constexpr double nearest_in_layers = 0.9;

  bool periodic(int axis) const { return geometry_.periodic[index_of<Dim>(axis)]; }

  // Rows of the domain's lattice along an axis with centres from `from` to `to`; in a periodic direction all
  // of the period, whose spacing is dx to rounding.
  std::vector<double> lattice(int axis, double from, double to) const {
    const double low = geometry_.low[axis];
    const double extent = geometry_.high[axis] - low;
    double spacing = dx_;
    if (periodic(axis)) {
      const double count = std::max(1.0, std::round(extent / dx_));
      // Where the period is dx times the count but for rounding, dx itself gives the very numbers of other
      // cases.
      if (std::abs(count * dx_ - extent) > 1e-12 * extent) spacing = extent / count;
      from = std::max(from, low);
      to = std::min(to, geometry_.high[axis]);
    }
    std::vector<double> rows;
    const auto first = static_cast<long>(std::ceil((from - low) / spacing - 0.5 - slack));
    const auto last = static_cast<long>(std::floor((to - low) / spacing - 0.5 + slack));
    for (long i = first; i <= last; ++i) rows.push_back(low + (static_cast<double>(i) + 0.5) * spacing);
    return rows;
  }
  // The same over the whole domain and the layers around it.
  std::vector<double> lattice(int axis) const {
    const double around = layers_ * dx_;
    return lattice(axis, geometry_.low[axis] - around, geometry_.high[axis] + around);
  }

  bool within_domain(const Vec<Dim>& x) const {
    for (int i = 0; i < Dim; ++i) {
      if (periodic(i)) {
        if (!(x[i] >= geometry_.low[i] && x[i] < geometry_.high[i])) return false;
      } else {
        const double around = (layers_ + slack) * dx_;
        if (!(x[i] >= geometry_.low[i] - around && x[i] <= geometry_.high[i] + around)) return false;
      }
    }
    return true;
  }

  void bodies() {
    if (geometry_.bodies.empty()) return;
    Rows<Dim> rows;
    for (int i = 0; i < Dim; ++i) {
      double from = geometry_.high[i];
      double to = geometry_.low[i];
      for (const Body<Dim>& body : geometry_.bodies) {
        from = std::min(from, extents(body, i).first);
        to = std::max(to, extents(body, i).second);
      }
      rows[index_of<Dim>(i)] = lattice(i, std::max(from, geometry_.low[i]), std::min(to, geometry_.high[i]));
    }
    std::vector<std::size_t> count(geometry_.bodies.size());
    for_lattice<Dim>(rows, [&](const Vec<Dim>& x, const auto&) {
      std::size_t body = 0;
      while (body < geometry_.bodies.size() && !geometry_.bodies[body].contains(x)) ++body;
      if (body == geometry_.bodies.size()) return;
      for (const Wall<Dim>& w : geometry_.walls)
        if (!(w.distance(x) >= 0.45 * dx_)) return;
      points_.interior.push_back(x);
      points_.body.push_back(body);
      ++count[body];
    });
    for (std::size_t i = 0; i < count.size(); ++i)
      if (count[i] == 0)
        throw UsageError(fmt::format(
            "[body.{}] holds no particle: it is smaller than the spacing of {:g} m, behind a wall, "
            "or within a body that comes before it",
            geometry_.bodies[i].name, dx_));
  }

  void wall(std::size_t index) {
    const Wall<Dim>& w = geometry_.walls[index];
    const std::size_t before = points_.walls.size();
    const auto candidate = [&](const Vec<Dim>& x) {
      if (within_domain(x) && !taken(x)) {
        points_.walls.push_back(x);
        points_.wall.push_back(index);
      }
    };
    switch (w.shape) {
      case WallShape::plane:
        plane(w, candidate);
        break;
      case WallShape::box:
        box(w, candidate);
        break;
      case WallShape::cylinder:
        cylinder(w, candidate);
        break;
    }
    if (points_.walls.size() == before)
      throw UsageError(fmt::format(
          "[wall.{}] has no particle: it is outside of the domain or behind the walls that come before it",
          w.name));
    // Only now, for a wall is not in its own way.
    for (std::size_t i = before; i < points_.walls.size(); ++i) grid_.add(points_.walls[i], index);
  }

  bool taken(const Vec<Dim>& x) const {
    bool result = false;
    grid_.near(x, [&](double squared, std::size_t owner) {
      const double depth = -geometry_.walls[owner].distance(x);
      const bool in_layers = depth > 0 && depth < layers_ * dx_;
      const double least = (in_layers ? nearest_in_layers : nearest_allowed) * dx_;
      result = result || squared < (1 - slack) * least * least;
    });
    return result;
  }

  template <class Candidate>
  void plane(const Wall<Dim>& w, const Candidate& candidate) const {
    const int along = axis_along(w.direction);
    if (along >= 0) {
      Rows<Dim> rows;
      for (int i = 0; i < Dim; ++i) {
        if (i != along) {
          rows[index_of<Dim>(i)] = lattice(i);
          continue;
        }
        const double sign = w.direction[i] > 0 ? -1 : 1;
        for (int k = 0; k < layers_; ++k)
          rows[index_of<Dim>(i)].push_back(w.point[i] + sign * (k + 0.5) * dx_);
        std::sort(rows[index_of<Dim>(i)].begin(), rows[index_of<Dim>(i)].end());
      }
      for_lattice<Dim>(rows, [&](const Vec<Dim>& x, const auto&) { candidate(x); });
      return;
    }

    // Two unit vectors in the surface; the second, in 3D, along a coordinate axis where there is one, so that
    // rows fit a period in it.
    const Vec<Dim>& n = w.direction;
    Vec<Dim> first, second;
    int free_axis = -1;
    if constexpr (Dim == 2) {
      first[0] = n[1];
      first[1] = -n[0];
    } else {
      for (int i = 0; i < Dim; ++i)
        if (std::abs(n[i]) < 1e-12) free_axis = i;
      if (free_axis >= 0) {
        second[free_axis] = 1;
      } else {
        Vec<Dim> up;
        up[2] = 1;
        second = rotation_velocity(n, up, 1);  // horizontal
        second *= 1 / norm(second);
      }
      first = rotation_velocity(n, second, 1);
    }
    const Vec<Dim> origin = geometry_.low - w.distance(geometry_.low) * n;

    // How far the domain reaches along a vector of the surface, counted from `origin`.
    const auto reach = [&](const Vec<Dim>& t) {
      double from = 0, to = 0;
      for (int i = 0; i < Dim; ++i) {
        const double around = layers_ * dx_;
        const double a = t[i] * (geometry_.low[i] - around - origin[i]);
        const double b = t[i] * (geometry_.high[i] + around - origin[i]);
        from += std::min(a, b);
        to += std::max(a, b);
      }
      return std::pair(from, to);
    };
    const auto row = [&](const Vec<Dim>& t) {
      const auto [from, to] = reach(t);
      std::vector<double> at;
      for (auto i = static_cast<long>(std::floor(from / dx_)); i <= static_cast<long>(std::ceil(to / dx_));
           ++i)
        at.push_back((static_cast<double>(i) + 0.5) * dx_);
      return at;
    };
    std::vector<double> across{0};
    if constexpr (Dim == 3) {
      across = free_axis >= 0 ? lattice(free_axis) : row(second);
      if (free_axis >= 0)
        for (double& a : across) a -= origin[free_axis];
    }
    for (const double b : across)
      for (int k = layers_ - 1; k >= 0; --k)
        for (const double a : row(first)) candidate(origin + a * first + b * second - (k + 0.5) * dx_ * n);
  }

  template <class Candidate>
  void box(const Wall<Dim>& w, const Candidate& candidate) const {
    Rows<Dim> rows;
    std::array<std::size_t, static_cast<std::size_t>(Dim)> begin{}, end{};  // the rows between the faces
    for (int i = 0; i < Dim; ++i) {
      const std::size_t a = index_of<Dim>(i);
      if (!std::isfinite(w.half[i])) {
        rows[a] = lattice(i);
        // No faces: all rows are between them, for an obstacle deep between them.
        end[a] = rows[a].size();
        continue;
      }
      const double low = w.point[i] - w.half[i];
      const double extent = 2 * w.half[i];
      const auto count = static_cast<std::size_t>(std::max(1.0, std::round(extent / dx_)));
      if (w.inside)
        for (int k = layers_ - 1; k >= 0; --k) rows[a].push_back(low - (k + 0.5) * dx_);
      begin[a] = rows[a].size();
      for (std::size_t k = 0; k < count; ++k)
        rows[a].push_back(low + (static_cast<double>(k) + 0.5) * extent / static_cast<double>(count));
      end[a] = rows[a].size();
      if (w.inside)
        for (int k = 0; k < layers_; ++k) rows[a].push_back(low + extent + (k + 0.5) * dx_);
    }
    const auto layers = static_cast<std::size_t>(layers_);
    for_lattice<Dim>(rows, [&](const Vec<Dim>& x, const auto& at) {
      bool near_face = false;
      for (int i = 0; i < Dim; ++i) {
        const std::size_t a = index_of<Dim>(i);
        if (w.inside)
          near_face = near_face || at[a] < begin[a] || at[a] >= end[a];
        else if (std::isfinite(w.half[i]))
          near_face = near_face || at[a] < layers || at[a] + layers >= end[a];
      }
      // Beyond an edge of a container the corner of the lattice is farther away than the layers reach.
      if (near_face && w.distance(x) > -(layers_ + slack) * dx_) candidate(x);
    });
  }

  template <class Candidate>
  void cylinder(const Wall<Dim>& w, const Candidate& candidate) const {
    int b = 0, c = 1;  // the axes across the cylinder
    std::vector<double> along{0};
    int axis = -1;
    if constexpr (Dim == 3) {
      axis = axis_along(w.direction);
      if (axis < 0)
        throw UsageError(fmt::format("[wall.{}] the axis of a cylinder must be x, across or up", w.name));
      b = axis == 0 ? 1 : 0;
      c = axis == 2 ? 1 : 2;
      along = lattice(axis);
    }
    for (const double a : along)
      for (int k = 0; k < layers_; ++k) {
        const double r = w.inside ? w.radius + (k + 0.5) * dx_ : w.radius - (k + 0.5) * dx_;
        if (!(r > slack * dx_)) break;
        const long count = ring(r);
        for (long i = 0; i < count; ++i) {
          const double angle =
              2 * std::numbers::pi * (static_cast<double>(i) + 0.5) / static_cast<double>(count);
          Vec<Dim> x = w.point;
          x[b] += r * std::cos(angle);
          x[c] += r * std::sin(angle);
          if (axis >= 0) x[axis] = a;
          candidate(x);
        }
      }
  }
  // Number of points of a ring: about dx apart, at least a hexagon; fewer where those would crowd, in the
  // middle of an obstacle.
  long ring(double r) const {
    long count = std::max(6L, std::lround(2 * std::numbers::pi * r / dx_));
    while (count > 1 &&
           2 * r * std::sin(std::numbers::pi / static_cast<double>(count)) < nearest_allowed * dx_)
      --count;
    return count;
  }

  const Geometry<Dim>& geometry_;
  double dx_;
  int layers_;
  PointGrid<Dim> grid_;
  GeometryPoints<Dim> points_;
};

template <int Dim>
Vec<Dim> vector_of(const Section& section, const char* name, const std::vector<double>& values) {
  if (values.size() != static_cast<std::size_t>(Dim))
    section.refuse(name, fmt::format("\"{}\" must have {} entries, {}, but has {}", name, Dim,
                                     Dim == 2 ? "x and up" : "x, across and up", values.size()));
  Vec<Dim> v;
  for (int i = 0; i < Dim; ++i) v[i] = values[index_of<Dim>(i)];
  return v;
}

void need(const Section& section, const char* name, const std::string& shape) {
  if (!section.given(name))
    section.refuse("shape", fmt::format("lacks the key \"{}\", which shape = \"{}\" needs", name, shape));
}

template <int Dim>
void read_domain(const Section& section, Geometry<Dim>& geometry) {
  geometry.low = vector_of<Dim>(section, "low", section.quantities("low"));
  geometry.high = vector_of<Dim>(section, "high", section.quantities("high"));
  for (int i = 0; i < Dim; ++i)
    if (!(geometry.low[i] < geometry.high[i]))
      section.refuse("high", fmt::format("\"high\" must be above \"low\" along {}", axis_name<Dim>(i)));
  const std::string periodic = section.word("periodic");
  geometry.periodic[0] = periodic == "x" || periodic == "x_and_across";
  if (periodic == "across" || periodic == "x_and_across") {
    if constexpr (Dim == 2)
      section.refuse("periodic", fmt::format("periodic = \"{}\" needs three dimensions", periodic));
    else
      geometry.periodic[1] = true;
  }
  section.finish();
}

template <int Dim>
Wall<Dim> read_wall(const Section& section, const std::string& name, const Geometry<Dim>& geometry) {
  Wall<Dim> w;
  w.name = name;
  const std::string shape = section.word("shape");
  w.shape = shape == "plane" ? WallShape::plane : shape == "box" ? WallShape::box : WallShape::cylinder;
  w.point = vector_of<Dim>(section, "point", section.quantities("point"));
  const auto periodic = [&](int axis) { return geometry.periodic[index_of<Dim>(axis)]; };
  std::array<bool, static_cast<std::size_t>(Dim)> endless{};  // directions in which the surface has no end

  if (w.shape == WallShape::plane) {
    need(section, "normal", shape);
    w.direction = vector_of<Dim>(section, "normal", section.numbers("normal"));
    double largest = 0;
    for (int i = 0; i < Dim; ++i) largest = std::max(largest, std::abs(w.direction[i]));
    if (!(largest > 0)) section.refuse("normal", "\"normal\" must not be zero");
    w.direction *= 1 / largest;  // first, so that the square of no entry overflows
    w.direction *= 1 / norm(w.direction);
    for (int i = 0; i < Dim; ++i)
      if (periodic(i) && std::abs(w.direction[i]) > 1e-12)
        section.refuse("normal",
                       fmt::format("a plane in a domain periodic along {0} must not lean towards {0}",
                                   axis_name<Dim>(i)));
    endless.fill(true);
  } else {
    need(section, "side", shape);
    w.inside = section.word("side") == "inside";
  }
  if (w.shape == WallShape::box) {
    need(section, "half", shape);
    w.half = vector_of<Dim>(section, "half", section.quantities("half"));
  }
  if (w.shape == WallShape::cylinder) {
    need(section, "radius", shape);
    w.radius = section.quantity("radius");
    if constexpr (Dim == 3) {
      const std::string axis = section.word("axis");
      const int along = axis == "x" ? 0 : axis == "across" ? 1 : 2;
      w.direction[along] = 1;
      endless[index_of<Dim>(along)] = true;
    }
  }

  // A wall that is not endless along a periodic direction must be whole within the period, for distances do
  // not look for its copies.
  for (int i = 0; i < Dim; ++i) {
    if (!periodic(i) || endless[index_of<Dim>(i)]) continue;
    const double reach = w.shape == WallShape::box ? w.half[i] : w.radius;
    const double tolerance = 1e-9 * (geometry.high[i] - geometry.low[i]);
    const bool fits_low = w.point[i] - reach >= geometry.low[i] - tolerance;
    const bool fits_high = w.point[i] + reach <= geometry.high[i] + tolerance;
    const bool fills = w.point[i] - reach <= geometry.low[i] + tolerance &&
                       w.point[i] + reach >= geometry.high[i] - tolerance;
    if (w.shape == WallShape::box && fills) {
      w.half[i] = std::numeric_limits<double>::infinity();
      endless[index_of<Dim>(i)] = true;
    } else if (w.inside) {
      section.refuse("side", fmt::format("a container cannot close the domain along {}, which is periodic",
                                         axis_name<Dim>(i)));
    } else if (!fits_low || !fits_high) {
      section.refuse("point",
                     fmt::format("the obstacle must be within the domain along {}, which is periodic",
                                 axis_name<Dim>(i)));
    }
  }

  if (section.given("velocity"))
    w.velocity = vector_of<Dim>(section, "velocity", section.quantities("velocity"));
  for (int i = 0; i < Dim; ++i)
    if (periodic(i) && w.velocity[i] != 0 && !endless[index_of<Dim>(i)])
      section.refuse("velocity", fmt::format("the wall would leave the domain along {}, which is periodic",
                                             axis_name<Dim>(i)));
  if (section.given("period")) {
    if (!(dot(w.velocity, w.velocity) > 0))
      section.refuse("period", "\"period\" needs a \"velocity\" that it changes");
    w.period = section.quantity("period");
    w.swing = w.velocity;
  }
  w.omega = section.quantity("angular_velocity");
  if (w.omega != 0) {
    if (w.shape == WallShape::box)
      section.refuse("angular_velocity", "a box stays aligned with the axes and cannot rotate");
    if (w.shape == WallShape::plane && Dim == 3)
      section.refuse("angular_velocity", "a plane cannot rotate in 3D; a cylinder can");
    if (w.shape == WallShape::plane && periodic(0))
      section.refuse("angular_velocity", "a plane cannot rotate in a periodic domain");
  }
  const std::string surface = section.word("surface");
  w.rough = surface == "rough";
  if (w.rough) w.basal_friction = section.number("basal_friction");
  section.finish(fmt::format("with shape = \"{}\", surface = \"{}\" in {}D", shape, surface, Dim));
  return w;
}

template <int Dim>
Body<Dim> read_body(const Section& section, const std::string& name, const Geometry<Dim>& geometry) {
  using Shape = typename Body<Dim>::Shape;
  Body<Dim> body;
  body.name = name;
  const std::string shape = section.word("shape");
  body.shape = shape == "box" ? Shape::box : shape == "cylinder" ? Shape::cylinder : Shape::heap;
  if (body.shape == Shape::cylinder && Dim == 2)
    section.refuse("shape", "shape = \"cylinder\" needs three dimensions; a box is its like in 2D");
  body.low = vector_of<Dim>(section, "low", section.quantities("low"));
  body.high = vector_of<Dim>(section, "high", section.quantities("high"));
  for (int i = 0; i < Dim; ++i) {
    if (i == Dim - 1 || body.shape == Shape::box) {
      if (!(body.low[i] < body.high[i]))
        section.refuse("high", fmt::format("\"high\" must be above \"low\" along {}", axis_name<Dim>(i)));
      const double tolerance = 1e-9 * (geometry.high[i] - geometry.low[i]);
      const auto inside = [&](double at) {
        return at >= geometry.low[i] - tolerance && at <= geometry.high[i] + tolerance;
      };
      if (!inside(body.low[i]) || !inside(body.high[i]))
        section.refuse(inside(body.low[i]) ? "high" : "low",
                       fmt::format("the body reaches out of the domain along {}", axis_name<Dim>(i)));
    } else if (body.low[i] != body.high[i]) {
      section.refuse(
          "high", fmt::format("with shape = \"{}\", \"high\" must be right above \"low\": the same {}", shape,
                              axis_name<Dim>(i)));
    }
  }
  if (body.shape == Shape::cylinder) {
    need(section, "radius", shape);
    body.radius = section.quantity("radius");
  }
  if (body.shape == Shape::heap) {
    need(section, "angle", shape);
    body.angle = section.quantity("angle");
    if constexpr (Dim == 2) body.both_sides = section.flag("both_sides");
  }
  if (section.given("velocity"))
    body.velocity = vector_of<Dim>(section, "velocity", section.quantities("velocity"));
  section.finish(fmt::format("with shape = \"{}\" in {}D", shape, Dim));
  return body;
}

}  // namespace

template <int Dim>
bool Wall<Dim>::moves() const {
  return omega != 0 || period > 0 || dot(velocity, velocity) > 0;
}

template <int Dim>
void Wall<Dim>::swing_at(double time) {
  if (period > 0) velocity = std::cos(2 * std::numbers::pi * time / period) * swing;
}

template <int Dim>
void Wall<Dim>::move(double dt) {
  point += dt * velocity;
  if constexpr (Dim == 2) {
    if (shape != WallShape::plane || omega == 0) return;
    const double c = std::cos(omega * dt);
    const double s = std::sin(omega * dt);
    const Vec<Dim> n = direction;
    direction[0] = c * n[0] - s * n[1];
    direction[1] = s * n[0] + c * n[1];
    direction *= 1 / norm(direction);  // over a million steps rounding would add up
  }
}

template <int Dim>
bool Body<Dim>::contains(const Vec<Dim>& x) const {
  const double up = x[Dim - 1];
  if (!(up >= low[Dim - 1] && depth(x) > 0)) return false;
  double squared = 0;  // of the distance to the upright axis
  for (int i = 0; i < Dim - 1; ++i) {
    if (shape == Shape::box && !(x[i] >= low[i] && x[i] < high[i])) return false;
    squared += (x[i] - low[i]) * (x[i] - low[i]);
  }
  if (shape == Shape::cylinder) return squared < radius * radius;
  if (shape == Shape::heap && Dim == 2) return both_sides || x[0] > low[0];
  return true;
}

template <int Dim>
double Body<Dim>::depth(const Vec<Dim>& x) const {
  const double below_top = high[Dim - 1] - x[Dim - 1];
  if (shape != Shape::heap) return below_top;
  double squared = 0;
  for (int i = 0; i < Dim - 1; ++i) squared += (x[i] - low[i]) * (x[i] - low[i]);
  return below_top - std::sqrt(squared) * std::tan(angle);
}

template <int Dim>
GeometryPoints<Dim> fill(const Geometry<Dim>& geometry, double dx, int layers) {
  return Filling<Dim>(geometry, dx, layers).points();
}

template <int Dim>
Geometry<Dim> read_geometry(const CaseFile& file) {
  Geometry<Dim> geometry;
  read_domain(file.section(domain_table), geometry);
  for (const std::string& name : file.subsections("wall"))
    geometry.walls.push_back(read_wall(file.section(wall_table, name), name, geometry));
  for (const std::string& name : file.subsections("body"))
    geometry.bodies.push_back(read_body(file.section(body_table, name), name, geometry));
  if (geometry.bodies.empty())
    throw UsageError(
        fmt::format("{}: there is no material: add a section [body.NAME]", file.path().string()));
  return geometry;
}

Geometry<3> slab_of(const Geometry<2>& plane, double depth) {
  const auto lifted = [](const Vec<2>& v, double across) {
    Vec<3> out;
    out[0] = v[0], out[1] = across, out[2] = v[1];
    return out;
  };
  Geometry<3> slab;
  slab.low = lifted(plane.low, 0);
  slab.high = lifted(plane.high, depth);
  slab.periodic = {plane.periodic[0], true, false};
  for (const Wall<2>& w : plane.walls) {
    Wall<3> wall;
    wall.name = w.name, wall.shape = w.shape, wall.inside = w.inside;
    wall.point = lifted(w.point, 0);
    wall.direction = lifted(w.direction, 0);
    wall.half = lifted(w.half, unbounded);
    // Anticlockwise in the plane of x and up is right-handed about minus the axis across.
    if (w.shape == WallShape::cylinder) wall.direction[1] = -1;
    wall.radius = w.radius;
    wall.velocity = lifted(w.velocity, 0);
    wall.period = w.period, wall.swing = lifted(w.swing, 0);
    wall.omega = w.omega, wall.rough = w.rough, wall.basal_friction = w.basal_friction;
    slab.walls.push_back(std::move(wall));
  }
  for (const Body<2>& b : plane.bodies) {
    if (b.shape == Body<2>::Shape::heap)
      throw UsageError(fmt::format("body \"{}\": a plane heap has no counterpart as a slab", b.name));
    Body<3> body;
    body.name = b.name;
    body.low = lifted(b.low, 0);
    body.high = lifted(b.high, depth);
    body.velocity = lifted(b.velocity, 0);
    slab.bodies.push_back(std::move(body));
  }
  return slab;
}

std::vector<const ParameterTable*> geometry_tables() { return {&domain_table, &wall_table, &body_table}; }

template struct Wall<2>;
template struct Wall<3>;
template struct Body<2>;
template struct Body<3>;
template GeometryPoints<2> fill<2>(const Geometry<2>&, double, int);
template GeometryPoints<3> fill<3>(const Geometry<3>&, double, int);
template Geometry<2> read_geometry<2>(const CaseFile&);
template Geometry<3> read_geometry<3>(const CaseFile&);

}  // namespace dem2sph
