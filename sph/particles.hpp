// The particles as structure of arrays: first the interior ones, [0, interior), then those of walls,
// [interior, size). The arrays of a part that is off are empty.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "sph/base/tensor.hpp"
#include "sph/loops.hpp"

namespace dem2sph {

using Column = std::vector<double>;

/// Up to Pack::width particles that follow each other in memory, and so lie close in space: the lanes of the
/// passes over pairs. All are interior, or all of walls.
struct Cluster {
  std::size_t first = 0;
  std::size_t count = 0;  ///< only the last of its kind has less than Pack::width
  std::size_t list = 0;   ///< its number in the pair list

  /// Lanes beyond `count` repeat the last particle, so that nothing they compute is out of range.
  [[gnu::always_inline]] Pack load(const Column& column) const {
    if (count == Pack::width) [[likely]]
      return Pack::load(&column[first]);
    Pack some;
    for (std::size_t lane = 0; lane < Pack::width; ++lane)
      some.set(lane, column[first + (lane < count ? lane : count - 1)]);
    return some;
  }
  [[gnu::always_inline]] void store(Column& column, const Pack& value) const {
    if (count == Pack::width) [[likely]] {
      value.store(&column[first]);
      return;
    }
    for (std::size_t lane = 0; lane < count; ++lane) column[first + lane] = value[lane];
  }
  /// The same over the components of a value; a field may have room for more.
  template <class Value, std::size_t N>
  [[gnu::always_inline]] Value load(const std::array<Column, N>& columns) const {
    Value value;
    for (std::size_t k = 0; k < value.c.size(); ++k) value.c[k] = load(columns[k]);
    return value;
  }
  template <class Value, std::size_t N>
  [[gnu::always_inline]] void store(std::array<Column, N>& columns, const Value& value) const {
    for (std::size_t k = 0; k < value.c.size(); ++k) store(columns[k], value.c[k]);
  }
  /// 1 for a particle, 0 for a lane without one.
  [[gnu::always_inline]] Pack present() const {
    Pack one = 1;
    for (std::size_t lane = count; lane < Pack::width; ++lane) one.set(lane, 0);
    return one;
  }
};

/// Particles [begin, end), Pack::width at a time, for what needs no pairs.
class Clusters {
 public:
  Clusters(std::size_t begin, std::size_t end) : begin_(begin), end_(end) {}
  std::size_t count() const { return (end_ - begin_ + Pack::width - 1) / Pack::width; }
  Cluster operator[](std::size_t k) const {
    const std::size_t first = begin_ + k * Pack::width;
    return {first, std::min(Pack::width, end_ - first)};
  }

 private:
  std::size_t begin_, end_;
};
/// Calls f(cluster) for the particles [begin, end), in parallel.
template <class F>
void for_clusters(std::size_t begin, std::size_t end, F&& f) {
  const Clusters clusters(begin, end);
  for_particles(0, clusters.count(), [&](std::size_t k) { f(clusters[k]); });
}

template <int Dim>
struct Particles {
  template <std::size_t N>
  using Columns = std::array<Column, N>;
  static constexpr std::size_t square = std::size_t{Dim} * Dim;

  std::size_t interior = 0;
  std::size_t size = 0;
  Columns<Dim> x;             ///< position [m]
  Columns<Dim> v;             ///< velocity [m/s]; of a wall: see the walls in use
  Columns<Dim> a;             ///< acceleration [m/s^2], interior only
  Column m;                   ///< mass [kg, per metre of width in 2D]
  Column rho;                 ///< bulk density [kg/m^3]
  Column p;                   ///< pressure, compression positive [Pa]
  Columns<Sym<Dim>::size> s;  ///< deviatoric stress [Pa]
  Column gamma_dot;           ///< shear rate that flows [1/s]
  /// Velocity gradient L_ij [1/s], of all that have a stress of their own, from Eq. 5.21 until that stress is
  /// known. Then `bracket` stands in its place, so that a particle needs room for one of them.
  Columns<square> l;

  // What the passes over pairs read, so that no pair divides. Made anew before they run: no part of the
  // state.
  Column volume;  ///< m/rho [m^3]

  // What only some parts need.
  Column rho_tilde;            ///< density before the Shepard filter, Eq. 5.17 [kg/m^3]
  Column rho_rate;             ///< d(rho)/dt of a continuity equation [kg/m^3/s]
  Column rho0;                 ///< density without pressure where it differs between particles [kg/m^3]
  Column dilation_state;       ///< phi, or beta of the printed form [1]
  Column dilation_I;           ///< the inertial number at the end of the last strain increment [1]
  Column beta;                 ///< the beta that entered mu last, after its limits [1]
  Column limiter;              ///< of the damping, in [0, 1]
  Columns<Dim> averaged;       ///< what velocity averaging adds to the velocity of transport [m/s]
  Columns<square> correction;  ///< inverse of the kernel gradient's first moment [1]
  Column lambda;               ///< least eigenvalue of that moment: 1 inside, less at a surface

  std::vector<std::int64_t> id;    ///< stays with a particle through all sorting
  std::vector<std::int64_t> wall;  ///< which wall a wall particle belongs to; -1 inside

  /// Sizes the arrays that every composition has.
  void resize(std::size_t interior_count, std::size_t total) {
    interior = interior_count;
    size = total;
    for (Column& c : x) c.resize(total, 0.0);
    for (Column& c : v) c.resize(total, 0.0);
    for (Column& c : a) c.resize(interior, 0.0);
    for (Column* c : {&m, &rho, &p, &gamma_dot, &volume}) c->resize(total, 0.0);
    for (Column& c : s) c.resize(total, 0.0);
    for (Column& c : l) c.resize(total, 0.0);
    id.resize(total, 0);
    wall.resize(total, -1);
  }

  /// Calls f(name, unit, array) for every array of the state: sorting, checkpoints and memory counts use it.
  template <class F>
  void arrays(F&& f) {
    const auto each = [&](const char* name, const char* unit, auto& columns) {
      for (Column& c : columns) f(name, unit, c);
    };
    each("x", "m", x);
    each("v", "m/s", v);
    each("a", "m/s^2", a);
    f("m", "kg", m);
    f("rho", "kg/m^3", rho);
    f("p", "Pa", p);
    each("s", "Pa", s);
    f("gamma_dot", "1/s", gamma_dot);
    each("l", "1/s", l);
    f("rho_tilde", "kg/m^3", rho_tilde);
    f("rho_rate", "kg/m^3/s", rho_rate);
    f("rho0", "kg/m^3", rho0);
    f("dilation_state", "1", dilation_state);
    f("dilation_I", "1", dilation_I);
    f("beta", "1", beta);
    f("limiter", "1", limiter);
    each("averaged", "m/s", averaged);
    each("correction", "1", correction);
    f("lambda", "1", lambda);
  }

  static Vec<Dim> load(const Columns<Dim>& field, std::size_t i) { return value_of<Vec<Dim>>(field, i); }
  static void store(Columns<Dim>& field, std::size_t i, const Vec<Dim>& value) { set_value(field, i, value); }
  static Gradient<Dim> load(const Columns<square>& field, std::size_t i) {
    return value_of<Gradient<Dim>>(field, i);
  }
  static void store(Columns<square>& field, std::size_t i, const Gradient<Dim>& value) {
    set_value(field, i, value);
  }
  Vec<Dim, Pack> position(const Cluster& of) const { return of.load<Vec<Dim, Pack>>(x); }
  Vec<Dim, Pack> velocity(const Cluster& of) const { return of.load<Vec<Dim, Pack>>(v); }
  Vec<Dim> position(std::size_t i) const { return load(x, i); }
  Vec<Dim> velocity(std::size_t i) const { return load(v, i); }
  Vec<Dim> acceleration(std::size_t i) const { return load(a, i); }
  Sym<Dim, Pack> deviator(const Cluster& of) const { return of.load<Sym<Dim, Pack>>(s); }
  Sym<Dim> deviator(std::size_t i) const { return value_of<Sym<Dim>>(s, i); }
  void set_deviator(std::size_t i, const Sym<Dim>& value) { set_value(s, i, value); }
  /// sigma/rho^2 of Eq. 5.20, tension positive [m^5/(kg s^2)].
  Sym<Dim> bracket(std::size_t i) const { return value_of<Sym<Dim>>(l, i); }
  Sym<Dim, Pack> bracket(const Cluster& of) const { return of.load<Sym<Dim, Pack>>(l); }

 private:
  /// The components of a particle's value stand in the first arrays of a field, which may have more.
  template <class Value, std::size_t N>
  [[gnu::always_inline]] static Value value_of(const Columns<N>& field, std::size_t i) {
    Value value;
    for (std::size_t k = 0; k < value.c.size(); ++k) value.c[k] = field[k][i];
    return value;
  }
  template <class Value, std::size_t N>
  [[gnu::always_inline]] static void set_value(Columns<N>& field, std::size_t i, const Value& value) {
    for (std::size_t k = 0; k < value.c.size(); ++k) field[k][i] = value.c[k];
  }
};

}  // namespace dem2sph
