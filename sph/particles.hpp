// The particles as structure of arrays: first the interior ones, [0, interior), then those of walls,
// [interior, size).
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "sph/base/tensor.hpp"

namespace dem2sph {

/// A plane wall, the half space below it filled with wall particles. n is the unit normal into the material.
template <int Dim>
struct Plane {
  Vec<Dim> point;
  Vec<Dim> normal;
  Vec<Dim> velocity;
  bool rough = true;  ///< a rough wall drags the material along; a smooth one is frictionless
  double distance(const Vec<Dim>& x) const { return dot(x - point, normal); }
};

template <int Dim>
struct Particles {
  std::size_t interior = 0;
  std::size_t size = 0;
  std::array<std::vector<double>, Dim> x;             ///< position [m]
  std::array<std::vector<double>, Dim> v;             ///< velocity [m/s]; of a wall: see the walls in use
  std::array<std::vector<double>, Dim> a;             ///< acceleration [m/s^2], interior only
  std::vector<double> m;                              ///< mass [kg, per metre of width in 2D]
  std::vector<double> rho;                            ///< bulk density [kg/m^3]
  std::vector<double> p;                              ///< pressure, compression positive [Pa]
  std::array<std::vector<double>, Sym<Dim>::size> s;  ///< deviatoric stress [Pa]
  std::vector<double> gamma_dot;                      ///< shear rate that flows [1/s], interior only
  std::vector<std::int64_t> id;                       ///< stays with a particle through all sorting
  std::vector<std::int64_t> plane;                    ///< which plane a wall particle belongs to; -1 inside

  void resize(std::size_t interior_count, std::size_t total) {
    interior = interior_count;
    size = total;
    arrays([&](const char*, const char*, std::vector<double>& values) { values.resize(total, 0.0); });
    id.resize(total, 0);
    plane.resize(total, -1);
  }

  /// Calls f(name, unit, array) for every array of numbers: sorting, checkpoints and memory counts use it.
  template <class F>
  void arrays(F&& f) {
    for (auto& c : x) f("x", "m", c);
    for (auto& c : v) f("v", "m/s", c);
    for (auto& c : a) f("a", "m/s^2", c);
    f("m", "kg", m);
    f("rho", "kg/m^3", rho);
    f("p", "Pa", p);
    for (auto& c : s) f("s", "Pa", c);
    f("gamma_dot", "1/s", gamma_dot);
  }

  static Vec<Dim> load(const std::array<std::vector<double>, Dim>& field, std::size_t i) {
    Vec<Dim> value;
    for (std::size_t k = 0; k < Dim; ++k) value.c[k] = field[k][i];
    return value;
  }
  static void store(std::array<std::vector<double>, Dim>& field, std::size_t i, const Vec<Dim>& value) {
    for (std::size_t k = 0; k < Dim; ++k) field[k][i] = value.c[k];
  }
  Vec<Dim> position(std::size_t i) const { return load(x, i); }
  Vec<Dim> velocity(std::size_t i) const { return load(v, i); }
  Vec<Dim> acceleration(std::size_t i) const { return load(a, i); }
  Sym<Dim> deviator(std::size_t i) const {
    Sym<Dim> value;
    for (std::size_t k = 0; k < Sym<Dim>::size; ++k) value.c[k] = s[k][i];
    return value;
  }
  void set_deviator(std::size_t i, const Sym<Dim>& value) {
    for (std::size_t k = 0; k < Sym<Dim>::size; ++k) s[k][i] = value.c[k];
  }
};

}  // namespace dem2sph
