#include "tests/benchmarks/yardstick.hpp"

#include <random>

namespace dem2sph::yardstick {

template <int Dim>
Cloud<Dim>::Cloud(std::size_t along) {
  std::size_t n = 1;
  for (int k = 0; k < Dim; ++k) n *= along;
  q.resize(n, n);
  h = 1.2;
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-0.2, 0.2);
  for (std::size_t i = 0; i < n; ++i) {
    std::size_t place = i;
    for (auto& x : q.x) x[i] = static_cast<double>(place % along) + uniform(random), place /= along;
    for (auto& v : q.v) v[i] = uniform(random);
    q.m[i] = 1, q.id[i] = static_cast<std::int64_t>(i);
  }
  const std::vector<std::int32_t> order = spatial_order(q, 1.0);
  q.arrays([&](const char*, const char*, Column& values) {
    if (values.empty()) return;
    const Column before = values;
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = before[static_cast<std::size_t>(order[i])];
  });
  list.build(q, Period<Dim>{}, 2 * h * 1.1, {});
  volume.assign(n, 1.0), rho.assign(n, 0.0), shepard.assign(n, 0.0);
  for (auto& g : gradient) g.assign(n, 0.0);
  for (auto& a : acceleration) a.assign(n, 0.0);
  for (auto& s : stress) {
    s.resize(n);
    for (double& value : s) value = uniform(random);
  }
}

namespace {

/// Wendland C2 without its normalisation.
template <class Real>
struct Shape {
  Real t, w, f;
  [[gnu::always_inline]] Shape(Real r, double h) : t(positive(1 - (0.5 / h) * r)) {
    const Real t2 = t * t;
    w = t2 * t2 * (1 + (2 / h) * r);
    f = -5 / (h * h) * (t2 * t);
  }
};

template <int Dim>
[[gnu::always_inline]] inline Vec<Dim, Pack> difference(const Cloud<Dim>& c, const Vec<Dim, Pack>& x,
                                                        std::size_t b) {
  Vec<Dim, Pack> r;
  for (std::size_t k = 0; k < Dim; ++k) r.c[k] = x.c[k] - Pack(c.q.x[k][b]);
  return r;
}

template <int Dim, bool density, bool filter, bool gradients>
void sums(Cloud<Dim>& c) {
  c.list.for_interior([&](const Cluster& a) {
    const Vec<Dim, Pack> x = c.q.position(a), v = c.q.velocity(a);
    Pack rho, shepard;
    Gradient<Dim, Pack> l;
    for (const Neighbour n : c.list.interior_of(a)) {
      const std::size_t b = n.index();
      const Vec<Dim, Pack> r = difference(c, x, b);
      const Shape<Pack> shape(norm(r), c.h);
      if constexpr (density) rho += c.q.m[b] * shape.w;
      if constexpr (filter) shepard += c.volume[b] * shape.w;
      if constexpr (gradients) {
        const Pack f = c.volume[b] * shape.f;
        for (std::size_t i = 0; i < Dim; ++i) {
          const Pack d = (c.q.v[i][b] - v.c[i]) * f;
          for (std::size_t j = 0; j < Dim; ++j) l.c[i * Dim + j] += d * r.c[j];
        }
      }
    }
    if constexpr (density) a.store(c.rho, rho);
    if constexpr (filter) a.store(c.shepard, shepard);
    if constexpr (gradients) a.store(c.gradient, l);
  });
}

template <int Dim>
void momentum(Cloud<Dim>& c) {
  const double viscosity = 0.1 * 10 * c.h, least = 0.01 * c.h * c.h;
  c.list.for_interior([&](const Cluster& a) {
    const Vec<Dim, Pack> x = c.q.position(a), v = c.q.velocity(a);
    std::array<Pack, 6> own;
    for (std::size_t k = 0; k < 6; ++k) own[k] = a.load(c.stress[k]);
    Vec<Dim, Pack> acceleration;
    for (const Neighbour n : c.list.interior_of(a)) {
      const std::size_t b = n.index();
      const Vec<Dim, Pack> r = difference(c, x, b);
      const Pack square = dot(r, r);
      using std::sqrt;
      const Pack f = c.q.m[b] * Shape<Pack>(sqrt(square), c.h).f;
      Vec<Dim, Pack> d;
      for (std::size_t k = 0; k < Dim; ++k) d.c[k] = v.c[k] - Pack(c.q.v[k][b]);
      const Pack pi = viscosity * negative(dot(d, r)) / (square + least);
      const auto s = [&](std::size_t k) { return own[k] + c.stress[k][b]; };
      const Vec<Dim, Pack> g = f * r;
      if constexpr (Dim == 3) {
        const Pack xx = s(0) + pi, yy = s(1) + pi, zz = s(2) + pi, xy = s(3), xz = s(4), yz = s(5);
        acceleration[0] += xx * g[0] + xy * g[1] + xz * g[2];
        acceleration[1] += xy * g[0] + yy * g[1] + yz * g[2];
        acceleration[2] += xz * g[0] + yz * g[1] + zz * g[2];
      } else {
        const Pack xx = s(0) + pi, yy = s(1) + pi, xy = s(2);
        acceleration[0] += xx * g[0] + xy * g[1];
        acceleration[1] += xy * g[0] + yy * g[1];
      }
    }
    a.store(c.acceleration, acceleration);
  });
}

}  // namespace

template <int Dim>
void two_passes(Cloud<Dim>& cloud) {
  sums<Dim, true, true, true>(cloud);
  momentum(cloud);
}
template <int Dim>
void four_passes(Cloud<Dim>& cloud) {
  sums<Dim, true, false, false>(cloud);
  sums<Dim, false, true, false>(cloud);
  sums<Dim, false, false, true>(cloud);
  momentum(cloud);
}

template struct Cloud<2>;
template struct Cloud<3>;
template void two_passes(Cloud<2>&);
template void two_passes(Cloud<3>&);
template void four_passes(Cloud<2>&);
template void four_passes(Cloud<3>&);

}  // namespace dem2sph::yardstick
