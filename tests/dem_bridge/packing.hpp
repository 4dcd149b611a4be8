// A packing whose stress, solid fraction and shear rate are known exactly: spheres on a simple cubic lattice
// of spacing a, each pressed on the one above with a normal force, sheared affinely, between a bottom and a
// top layer of wall grains.
//
// Per column of the lattice (area a^2) one bond crosses every height, so sigma = f (x) e_z / a^2 whatever the
// slab; a slab as thick as a whole number of spacings holds the solid fraction pi/6 (2 r/a)^3.
#pragma once

#include <fmt/format.h>

#include <cmath>
#include <string>

#include "dem_bridge/dump.hpp"

namespace dem2sph::bridge::test {

struct Lattice {
  int columns_x = 5, columns_y = 5;
  int layers = 12;        ///< walls included, one layer each
  double a = 1e-3;        ///< spacing, and diameter of the grains [m]
  double gamma_dot = 0;   ///< [1/s]
  double opening = 0;     ///< d v_z / d z [1/s]
  double normal = 0;      ///< force of each bond along z [N]
  double tangential = 0;  ///< along x; a positive one drags the upper grain back [N]
  double strain = 0;      ///< layers have moved along x by strain times their height

  int grains() const { return columns_x * columns_y * layers; }
  std::int64_t id(int i, int j, int k) const { return 1 + i + columns_x * (j + columns_y * k); }

  Box box() const {
    Box b;
    b.high[0] = columns_x * a;
    b.high[1] = columns_y * a;
    b.low[2] = -2 * a;
    b.high[2] = (layers + 2) * a;
    b.periodic = {true, true, false};
    return b;
  }

  GrainFrame frame(std::int64_t step) const {
    GrainFrame f;
    f.step = step;
    f.box = box();
    for (int k = layers - 1; k >= 0; --k)  // not in the order of their ids, as in a real dump
      for (int j = 0; j < columns_y; ++j)
        for (int i = 0; i < columns_x; ++i) {
          Grain g;
          g.id = id(i, j, k);
          g.type = k == 0 ? GrainType::bottom_wall : k == layers - 1 ? GrainType::top_wall : GrainType::flow;
          g.x = {{(i + 0.5) * a, (j + 0.5) * a, (k + 0.5) * a}};
          const double length = columns_x * a;
          g.x[0] += strain * g.x[2];
          g.x[0] -= length * std::floor(g.x[0] / length);
          g.v = {{gamma_dot * g.x[2], 0, opening * g.x[2]}};
          g.radius = 0.5 * a;
          f.grains.push_back(g);
        }
    return f;
  }

  ContactFrame contacts(std::int64_t step) const {
    ContactFrame f;
    f.step = step;
    f.box = box();
    // A sheared lattice: the bond goes to the grain below that is nearest, a tilt of it turns part of the
    // normal force into f_z b_x, which the tangential force makes up for. The stress is that of the upright
    // lattice.
    const double passed = std::round(strain);
    const int shift = static_cast<int>(passed) % columns_x;
    const double tilt = strain - passed;
    for (int k = 0; k + 1 < layers; ++k)
      for (int j = 0; j < columns_y; ++j)
        for (int i = 0; i < columns_x; ++i)  // the force on the upper grain: pushed up, dragged back
          f.contacts.push_back({id(i, j, k + 1),
                                id((i + shift) % columns_x, j, k),
                                {{-tangential - normal * tilt, 0, normal}}});
    return f;
  }
};

inline std::string header_text(std::int64_t step, std::size_t count, const Box& box, const std::string& what,
                               const std::string& rows) {
  std::string text = fmt::format("ITEM: TIMESTEP\n{}\nITEM: NUMBER OF {}\n{}\nITEM: BOX BOUNDS pp pp ff\n",
                                 step, what, count);
  for (int k = 0; k < 3; ++k) text += fmt::format("{} {}\n", box.low[k], box.high[k]);
  return text + "ITEM: " + rows + "\n";
}

/// As LIGGGHTS writes it, with the space at the end of a row.
inline std::string text_of(const GrainFrame& f) {
  std::string text =
      header_text(f.step, f.grains.size(), f.box, "ATOMS", "ATOMS id type x y z vx vy vz radius ");
  for (const Grain& g : f.grains)
    text += fmt::format("{} {} {} {} {} {} {} {} {} \n", g.id, static_cast<int>(g.type), g.x[0], g.x[1],
                        g.x[2], g.v[0], g.v[1], g.v[2], g.radius);
  return text;
}

inline std::string text_of(const ContactFrame& f) {
  std::string text =
      header_text(f.step, f.contacts.size(), f.box, "ENTRIES", "ENTRIES c[1] c[2] c[3] c[4] c[5] c[6] ");
  for (const Contact& c : f.contacts)
    text += fmt::format("{} {} 0 {} {} {} \n", c.first, c.second, c.force[0], c.force[1], c.force[2]);
  return text;
}

}  // namespace dem2sph::bridge::test
