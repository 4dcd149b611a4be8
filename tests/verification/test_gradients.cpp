// Sums over particles: exact for linear fields where they are corrected, the lattice's own factors where they
// are not.
#include "sph/passes.hpp"
#include "tests/verification/boxes.hpp"
#include "tests/verification/record.hpp"

namespace dem2sph {
namespace {

// Below this least eigenvalue of the moment gradients are not corrected (invert_moment).
constexpr double corrected_above = 0.75;

template <int Dim>
void correction_is_exact() {
  FlowSetup<Dim> setup = box_of<Dim>({}, {12, 12, 12}, 0, false);
  jitter(setup, 0.3, 11);
  Particles<Dim> q = setup.particles;
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  Gradient<Dim> exact;
  for (double& c : exact.c) c = normal(random);
  double size = 0;
  for (const double c : exact.c) size = std::max(size, std::abs(c));
  for (std::size_t i = 0; i < q.size; ++i) {
    q.rho[i] *= 1 + 0.05 * normal(random);  // any volumes will do
    Particles<Dim>::store(q.v, i, product(exact, q.position(i)));
  }
  for (Column& c : q.l) c.assign(q.size, 0.0);
  for (Column& c : q.correction) c.assign(q.size, 0.0);
  q.lambda.assign(q.size, 0.0);
  q.rho_rate.assign(q.size, 0.0);
  PairList list;
  const std::vector<Wall<Dim>> walls;
  list.build(q, setup.period, 2 * setup.h, {});
  const Surroundings<Dim> around{list, walls};
  double largest = 0, largest_rate = 0;
  std::size_t corrected = 0;
  std::visit(
      [&](const auto& kernel) {
        volume_pass(q);
        moment_pass(q, around, kernel);
        gradient_pass(q, around, kernel, ContinuityFourtakas2019{0}, WallAdami2012{}, BonetLok1999{}, 0.0,
                      10.0);
      },
      make_kernel<Dim>("wendland_c2", setup.h));
  double least = 1;
  for (std::size_t i = 0; i < q.size; ++i) {
    least = std::min(least, q.lambda[i]);
    if (q.lambda[i] < corrected_above) continue;
    ++corrected;
    const Gradient<Dim> l = Particles<Dim>::load(q.l, i);
    for (std::size_t k = 0; k < l.c.size(); ++k)
      largest = std::max(largest, std::abs(l.c[k] - exact.c[k]) / size);
    largest_rate = std::max(largest_rate, std::abs(q.rho_rate[i] / q.rho[i] + exact.trace()) / size);
  }
  const double share = static_cast<double>(corrected) / static_cast<double>(q.size);
  std::printf("%dD: %.2e, rate %.2e, corrected %.3f, least lambda %.3f\n", Dim, largest, largest_rate, share,
              least);
  record("gradient", "bonet_lok_1999",
         std::to_string(Dim) + "D: error on a linear field, disordered, with free surface", largest, 1e-12,
         "1");
  record("gradient", "bonet_lok_1999",
         std::to_string(Dim) + "D: share of particles that are corrected (no bar)", share, std::nan(""), "1");
  EXPECT_LT(largest, 1e-12);  // rounding of about 30 (2D) or 110 (3D) terms over lambda
  EXPECT_LT(largest_rate, 1e-11);
  EXPECT_GT(share, 0.3);  // of a block of 12 particles a side, most of which lie near its surface in 3D
}
TEST(Gradient, CorrectionIsExactForLinearFields2D) { correction_is_exact<2>(); }
TEST(Gradient, CorrectionIsExactForLinearFields3D) { correction_is_exact<3>(); }

// reference/lattice.csv of the project, "derived" there from the kernels' formulas alone: the sum of m W/rho0
// and the factor of Eq. 5.21 on a linear field, in the interior of a square or cubic lattice.
struct LatticeRow {
  const char* kernel;
  double h;
  int dim;
  double sum, factor;
};
constexpr LatticeRow lattice_rows[] = {
    {"cubic_spline", 1.2, 2, 0.99976, 0.99079}, {"cubic_spline", 1.2, 3, 1.00081, 0.98169},
    {"cubic_spline", 1.3, 2, 0.99995, 1.01054}, {"cubic_spline", 1.3, 3, 0.99726, 0.99348},
    {"cubic_spline", 1.5, 2, 1.00344, 1.00672}, {"cubic_spline", 1.5, 3, 1.00179, 1.01012},
    {"wendland_c2", 1.2, 2, 1.01795, 0.96385},  {"wendland_c2", 1.2, 3, 1.01746, 0.98523},
    {"wendland_c2", 1.3, 2, 1.01047, 0.97392},  {"wendland_c2", 1.3, 3, 1.0095, 0.9789},
    {"wendland_c2", 1.5, 2, 1.00514, 0.9974},   {"wendland_c2", 1.5, 3, 1.00314, 1.00062},
    {"wendland_c2", 2.0, 2, 1.00121, 0.9992},   {"wendland_c2", 2.0, 3, 1.00055, 0.99941},
    {"wendland_c4", 1.2, 2, 1.01311, 0.97764},  {"wendland_c4", 1.2, 3, 1.01344, 0.98441},
    {"wendland_c4", 1.5, 2, 1.00298, 0.99058},  {"wendland_c4", 1.5, 3, 1.0029, 0.99324},
};

template <int Dim>
double lattice_error(const LatticeRow& row) {
  FlowSetup<Dim> setup =
      box_of<Dim>({}, Dim == 2 ? std::array<long, 3>{13, 13, 1} : std::array<long, 3>{13, 13, 13}, 0, true);
  Particles<Dim>& q = setup.particles;
  // Periodic for the sums; the one particle in the middle sees a linear field without a jump.
  std::size_t middle = 0;
  for (std::size_t k = 0, stride = 1; k < Dim; ++k, stride *= 13) middle += 6 * stride;
  Gradient<Dim> exact;
  for (std::size_t k = 0; k < exact.c.size(); ++k) exact.c[k] = 1 + static_cast<double>(k);
  for (std::size_t i = 0; i < q.size; ++i) Particles<Dim>::store(q.v, i, product(exact, q.position(i)));
  for (Column& c : q.l) c.assign(q.size, 0.0);
  PairList list;
  const std::vector<Wall<Dim>> walls;
  const double h = row.h * setup.dx;
  list.build(q, setup.period, 2 * h, {});
  const Surroundings<Dim> around{list, walls};
  Column sum(q.size);
  std::visit(
      [&](const auto& kernel) {
        density_pass(q, true, around, kernel, sum);
        volume_pass(q);
        gradient_pass(q, around, kernel, Summation{}, WallAdami2012{}, NoCorrection{}, 0.0, 10.0);
      },
      make_kernel<Dim>(row.kernel, h));
  double error = std::abs(sum[middle] / setup.eos.rho0 - row.sum);
  const Gradient<Dim> l = Particles<Dim>::load(q.l, middle);
  for (std::size_t k = 0; k < l.c.size(); ++k)
    error = std::max(error, std::abs(l.c[k] / exact.c[k] - row.factor));
  return error;
}
TEST(Gradient, UncorrectedHasTheLatticesFactors) {
  double largest = 0;
  for (const LatticeRow& row : lattice_rows) {
    const double error = row.dim == 2 ? lattice_error<2>(row) : lattice_error<3>(row);
    // Half a unit of the last of five digits.
    EXPECT_LT(error, 5.1e-6) << row.kernel << " h = " << row.h << " dx in " << row.dim << "D";
    largest = std::max(largest, error);
  }
  record("gradient", "none", "lattice sums and factors against their derived values, all kernels", largest,
         5.1e-6, "1");
}

}  // namespace
}  // namespace dem2sph
