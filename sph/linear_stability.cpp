#include "sph/linear_stability.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <variant>

#include "sph/base/errors.hpp"
#include "sph/flow.hpp"
#include "sph/kernel.hpp"

namespace dem2sph {
namespace {

/// Sums over the lattice for one wave vector.
template <int Dim>
struct WaveSums {
  Eigen::Matrix<double, Dim, 1> g = Eigen::Matrix<double, Dim, 1>::Zero();            ///< [1/m]
  Eigen::Matrix<double, Dim, Dim> damping = Eigen::Matrix<double, Dim, Dim>::Zero();  ///< of velocity [1/s]
  double diffusion = 0;                                                               ///< of density [1/s]
  double shepard = 1;  ///< what the filter of Eq. 5.18 leaves of a summed density's wave
};

/// Symmetric tensors as vectors: xx, yy, zz, then the shears; plane strain has one shear.
template <int Dim>
constexpr int shears = Dim == 2 ? 1 : 3;

template <int Dim>
class Lattice {
 public:
  using Vector = Eigen::Matrix<double, Dim, 1>;

  explicit Lattice(const FlowSetup<Dim>& setup, double viscosity)
      : setup_(setup), kernel_(make_kernel<Dim>(setup.parts.kernel, setup.h)), viscosity_(viscosity) {
    c0_ = std::sqrt(setup.eos.K / setup.eos.rho0);
    if (const ElasticReturn* elastic = std::get_if<ElasticReturn>(&setup.parts.stress)) G_ = elastic->G;
    std::visit(
        [&]<class D>(const D& density) {
          if constexpr (is_diffusive<D>) delta_ = density.delta;
        },
        setup.parts.density);
    std::visit(
        [&]<class T>(const T& damping) {
          if constexpr (!std::is_same_v<T, NoDamping>) alpha_ = damping.alpha;
        },
        setup.parts.damping);
    filtered_ = std::holds_alternative<SummationShepard>(setup.parts.density);
    if (!std::holds_alternative<NoCorrection>(setup.parts.correction)) {
      const double small = 1e-4;
      Vector k = Vector::Zero();
      k[0] = small / setup.dx;
      factor_ = sums(k).g[0] / k[0];  // the lattice factor f, which the correction takes off
    }
  }

  double sound_speed() const { return std::sqrt((setup_.eos.K + 4.0 / 3 * G_) / setup_.eos.rho0); }

  WaveSums<Dim> sums(const Vector& k) const {
    WaveSums<Dim> result;
    const double dx = setup_.dx, h = setup_.h, V = std::pow(dx, Dim);
    const int reach = static_cast<int>(2 * h / dx) + 1;
    double all = 0, wave = 0;
    const auto site = [&](const Vector& r) {
      const double distance = r.norm();
      const KernelValue<double> kernel = std::visit([&](const auto& w) { return w(distance); }, kernel_);
      const double phase = k.dot(r);
      all += kernel.w, wave += kernel.w * std::cos(phase);
      if (distance == 0) return;
      result.g -= V * kernel.f * std::sin(phase) / factor_ * r;
      const double ends = 1 - std::cos(phase);
      result.diffusion -= 2 * delta_ * h * c0_ * V * kernel.f * ends;
      // Pairs are damped while they approach: in a wave, half of them.
      result.damping -= 0.5 * alpha_ * c0_ * h * V * kernel.f * ends / (distance * distance + 0.01 * h * h) *
                        r * r.transpose();
    };
    const int across = Dim == 3 ? reach : 0;
    for (int l = -across; l <= across; ++l)
      for (int j = -reach; j <= reach; ++j)
        for (int i = -reach; i <= reach; ++i) {
          Vector r;
          r[0] = i * dx, r[1] = j * dx;
          if constexpr (Dim == 3) r[2] = l * dx;
          site(r);
        }
    if (filtered_) result.shepard = wave / all;
    return result;
  }

  /// Largest modulus of an eigenvalue of one step, for one wave. The step maps half-step velocity, density
  /// and deviatoric stress; with rho and s a quarter of a wave behind v all of it is real.
  double growth(const WaveSums<Dim>& w, double dt) const {
    constexpr int tensor = 3 + shears<Dim>;
    constexpr int n = Dim + 1 + tensor;
    using Matrix = Eigen::Matrix<double, n, n>;
    const double rho0 = setup_.eos.rho0;
    // Units: v in c0, rho in rho0, s in rho0 c0^2, so that the matrix is even in size.
    const double step = dt * c0_;
    Matrix state = Matrix::Identity();  // v, rho, s -> v, new rho, new s
    state(Dim, Dim) = 1 - dt * w.diffusion;
    for (int i = 0; i < Dim; ++i) state(Dim, i) = -step * w.g[i];
    // dev(sym(v (x) g)) as a matrix on v.
    Eigen::Matrix<double, tensor, Dim> rate = Eigen::Matrix<double, tensor, Dim>::Zero();
    for (int i = 0; i < Dim; ++i) {
      for (int d = 0; d < 3; ++d) rate(d, i) -= w.g[i] / 3;
      rate(i, i) += w.g[i];
    }
    int shear = 3;
    for (int i = 0; i < Dim; ++i)
      for (int j = i + 1; j < Dim; ++j, ++shear) {
        rate(shear, i) += 0.5 * w.g[j];
        rate(shear, j) += 0.5 * w.g[i];
      }
    const double modulus = G_ / (rho0 * c0_ * c0_);
    state.template block<tensor, Dim>(Dim + 1, 0) = 2 * modulus * step * rate;
    // v' = v + dt (-g . s + c^2 rho g - damping v), a viscous stress from the same v.
    Matrix kick = Matrix::Identity();
    for (int i = 0; i < Dim; ++i) kick(i, Dim) = step * w.shepard * w.g[i];
    shear = 3;
    for (int i = 0; i < Dim; ++i) kick(i, Dim + 1 + i) -= step * w.g[i];
    for (int i = 0; i < Dim; ++i)
      for (int j = i + 1; j < Dim; ++j, ++shear) {
        kick(i, Dim + 1 + shear) -= step * w.g[j];
        kick(j, Dim + 1 + shear) -= step * w.g[i];
      }
    Eigen::Matrix<double, Dim, Dim> drag = w.damping;
    if (viscosity_ > 0) drag += 2 * viscosity_ / rho0 * divergence(w, rate);
    kick.template block<Dim, Dim>(0, 0) -= dt * drag;
    return (kick * state).eigenvalues().cwiseAbs().maxCoeff();
  }

  template <class Visit>
  void for_waves(const Visit& visit) const {
    constexpr int points = 12;  // to the border of the zone; g is smooth between
    Vector k;
    for (int l = 0; l <= (Dim == 3 ? points : 0); ++l)
      for (int j = l; j <= points; ++j)
        for (int i = std::max(j, 1); i <= points; ++i) {
          k[0] = i, k[1] = j;
          if constexpr (Dim == 3) k[2] = l;
          visit(Vector(k * std::numbers::pi / (points * setup_.dx)));
        }
  }

 private:
  /// g . dev(sym(v (x) g)) as a matrix on v.
  static Eigen::Matrix<double, Dim, Dim> divergence(const WaveSums<Dim>& w,
                                                    const Eigen::Matrix<double, 3 + shears<Dim>, Dim>& rate) {
    Eigen::Matrix<double, Dim, Dim> result = Eigen::Matrix<double, Dim, Dim>::Zero();
    for (int i = 0; i < Dim; ++i) result.row(i) += w.g[i] * rate.row(i);
    int shear = 3;
    for (int i = 0; i < Dim; ++i)
      for (int j = i + 1; j < Dim; ++j, ++shear) {
        result.row(i) += w.g[j] * rate.row(shear);
        result.row(j) += w.g[i] * rate.row(shear);
      }
    return result;
  }

  const FlowSetup<Dim>& setup_;
  AnyKernel<Dim> kernel_;
  double viscosity_ = 0;
  double c0_ = 0, G_ = 0, delta_ = 0, alpha_ = 0, factor_ = 1;
  bool filtered_ = false;
};

/// Largest x in (low, high) for which `holds`, to a relative `width`, given that it holds at low and not at
/// high.
template <class Holds>
double bisect(double low, double high, double width, const Holds& holds) {
  while (high > (1 + width) * low) {
    const double middle = std::sqrt(low * high);
    (holds(middle) ? low : high) = middle;
  }
  return low;
}

}  // namespace

template <int Dim>
StepLimit linear_step_limit(const FlowSetup<Dim>& setup, double viscosity) {
  const Lattice<Dim> lattice(setup, viscosity);
  std::vector<WaveSums<Dim>> waves;
  double largest = 0;
  lattice.for_waves([&](const auto& k) {
    waves.push_back(lattice.sums(k));
    largest = std::max(largest, waves.back().g.norm());
  });
  StepLimit limit;
  limit.omega_max = lattice.sound_speed() * largest;
  limit.sound_bound = 0.25 * setup.h / lattice.sound_speed();
  // The eigenvalue 1 of a stress that moves nothing is a multiple one, which rounding spreads by its root.
  const auto stable = [&](double dt) {
    return std::all_of(waves.begin(), waves.end(),
                       [&](const WaveSums<Dim>& w) { return lattice.growth(w, dt) <= 1 + 1e-6; });
  };
  double low = 2 / limit.omega_max;  // damping shortens, sums of its own may lengthen
  while (!stable(low)) low *= 0.5;
  double high = 2 * low;
  while (stable(high)) high *= 2;
  limit.step = bisect(low, high, 1e-4, stable);
  return limit;
}

template <int Dim>
double measured_step_limit(const FlowSetup<Dim>& given, double p0, long steps) {
  FlowSetup<Dim> setup = given;
  setup.walls.clear();
  setup.gravity = Vec<Dim>{};
  // Even, so that the shortest waves fit, and three times the reach of the list, as it wants.
  const double reach = 2 * setup.h * (1 + setup.skin) / setup.dx;
  const long cells = std::max(12L, 2 * std::lround(std::ceil(1.5 * reach)));
  std::size_t count = 1;
  for (int k = 0; k < Dim; ++k) {
    count *= static_cast<std::size_t>(cells);
    setup.period.length[k] = static_cast<double>(cells) * setup.dx;
  }
  Particles<Dim>& q = setup.particles;
  q = Particles<Dim>{};
  q.resize(count, count);
  const double c0 = std::sqrt(setup.eos.K / setup.eos.rho0);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> noise(-1e-9 * c0, 1e-9 * c0);
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t rest = i;
    for (std::size_t k = 0; k < static_cast<std::size_t>(Dim); ++k) {
      q.x[k][i] = (static_cast<double>(rest % static_cast<std::size_t>(cells)) + 0.5) * setup.dx;
      q.v[k][i] = noise(random);
      rest /= static_cast<std::size_t>(cells);
    }
    q.id[i] = static_cast<std::int64_t>(i);
    q.wall[i] = -1;
    q.p[i] = p0;
    q.rho[i] = setup.eos.density(p0);
    q.m[i] = q.rho[i] * std::pow(setup.dx, Dim);
  }
  setup.step_factor = 1e6;  // the step is this function's
  const auto stable = [&](double dt) {
    const std::unique_ptr<Flow> flow = make_flow<Dim>(setup);
    const double before = flow->budgets().kinetic;
    try {
      for (long i = 0; i < steps; ++i) flow->step(dt);
    } catch (const NumericalError&) {
      return false;  // that is the question
    }
    // Noise keeps its energy, or loses it; what grows by 1 % a step has grown 400 times.
    return flow->budgets().kinetic < 10 * before;
  };
  double low = 0.25 * setup.h / c0;
  while (!stable(low)) low *= 0.5;
  double high = 2 * low;
  while (stable(high)) low = high, high *= 2;
  return bisect(low, high, 0.01, stable);
}

template StepLimit linear_step_limit<2>(const FlowSetup<2>&, double);
template StepLimit linear_step_limit<3>(const FlowSetup<3>&, double);
template double measured_step_limit<2>(const FlowSetup<2>&, double, long);
template double measured_step_limit<3>(const FlowSetup<3>&, double, long);

}  // namespace dem2sph
