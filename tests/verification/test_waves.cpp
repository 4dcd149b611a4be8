// A small longitudinal wave on a pre-compressed periodic lattice: its frequency against the lattice's own
// dispersion relation (README.md), that of the solver's equations linearised and summed over the sites.
#include <fmt/format.h>

#include "tests/verification/boxes.hpp"
#include "tests/verification/lattice_waves.hpp"
#include "tests/verification/record.hpp"

namespace dem2sph {
namespace {

constexpr double compression = 0.02;  // p0/K

struct Wave {
  std::string formulation = "robust";
  std::string kernel = "wendland_c2";
  double h = 1.5;
  bool corrected = false;
  bool as_default = false;  ///< with diffusion and damping
  double amplitude = 1e-4;  ///< of the velocity over c
};

struct Measured {
  double omega = 0;  ///< with what the leapfrog of the time step makes of it taken off [1/s]
  double omega_raw = 0;
  double decay = 0;  ///< [1/s]
  double expected = 0;
  double expected_decay = 0;
  double continuum = 0;  ///< k c
};

template <int Dim>
Measured run(const Wave& wave, long per_wavelength) {
  std::vector<std::string> set{"flow.formulation=" + wave.formulation, "flow.kernel=" + wave.kernel,
                               "flow.h_over_dx=" + std::to_string(wave.h)};
  const bool robust = wave.formulation == "robust";
  if (!wave.as_default && robust) {
    set.push_back("flow.density_diffusion=0");
    set.push_back("flow.damping=none");
  }
  if (wave.corrected) set.push_back("flow.gradient_correction=bonet_lok_1999");
  const long across = std::lround(std::ceil(6 * wave.h * 1.03));  // three times the reach
  FlowSetup<Dim> setup = box_of<Dim>(set, {per_wavelength, across, across}, compression * 150e3, true);
  if (!robust) setup.parts.friction = ConstantFriction<double>{0};  // no stress but pressure
  const double dx = setup.dx;
  const double k = 2 * std::numbers::pi / static_cast<double>(per_wavelength);  // times dx
  const LatticeSums sum(wave.kernel, Dim, wave.h, k);

  // The state that the wave travels on: a summed density is s times that of the lattice.
  const double rho = setup.particles.rho[0] * (robust ? 1 : sum.s);
  const double p0 = setup.eos.pressure(rho);
  const double K_a = setup.eos.bulk_modulus(rho);
  const double G = robust ? std::get<ElasticReturn>(setup.parts.stress).G : 0;
  const double M = K_a + 4.0 / 3 * G;
  // V = m/rho is 1 for a continuity density and 1/s for a summed one.
  const double V = robust ? 1 : 1 / sum.s;
  const double theta = V * sum.theta;
  const double lambda = V * sum.lambda;
  double square = 0;  // (omega dx)^2 rho
  if (wave.corrected) {
    const double theta_c = theta / sum.f;
    square = theta_c * theta_c * (M - 2 * p0) + p0 * theta * (theta_c * sum.phi - sum.xi) / (sum.f * sum.f) +
             2 * p0 * lambda / sum.f;
  } else {
    square = theta * theta * (robust ? 1 : sum.w_hat) * (M - 2 * p0) + 2 * p0 * lambda;
  }
  Measured result;
  result.expected = std::sqrt(square / rho) / dx;
  result.continuum = k / dx * std::sqrt(M / rho);
  const double dt = sound_step(setup, 0.5);
  // The moment is taken with the densities of the step before, so its part of the restoring force comes dt
  // late: what is late drives.
  if (wave.corrected)
    result.expected_decay =
        -0.5 * dt * p0 * theta * theta * sum.phi / (sum.f * sum.f * sum.f) / (rho * dx * dx);

  const double speed = wave.amplitude * std::sqrt(M / rho);
  for (std::size_t i = 0; i < setup.particles.interior; ++i)
    setup.particles.v[0][i] = speed * std::sin(k / dx * setup.particles.x[0][i]);
  auto flow = make_flow<Dim>(std::move(setup));
  std::vector<double> mode;
  const long steps = std::lround(1.25 * 2 * std::numbers::pi / result.expected / dt);
  for (long i = 0; i <= steps; ++i) {
    const Frame frame = flow->frame();
    const auto& x = frame.field("x").values;
    const auto& v = frame.field("v").values;
    double sine = 0;
    for (std::size_t j = 0; j < flow->interior(); ++j) sine += v[3 * j] * std::sin(k / dx * x[3 * j]);
    mode.push_back(sine);
    if (i < steps) flow->step(dt);
  }
  // The mode obeys m(t + dt) = a m(t) - b m(t - dt) with a = 2 exp(-decay dt) cos(omega dt), b = exp(-2 decay
  // dt).
  double xx = 0, xy = 0, yy = 0, xz = 0, yz = 0;
  for (std::size_t i = 1; i + 1 < mode.size(); ++i) {
    xx += mode[i] * mode[i], xy -= mode[i] * mode[i - 1], yy += mode[i - 1] * mode[i - 1];
    xz += mode[i] * mode[i + 1], yz -= mode[i - 1] * mode[i + 1];
  }
  const double determinant = xx * yy - xy * xy;
  const double a = (yy * xz - xy * yz) / determinant;
  const double b = (xx * yz - xy * xz) / determinant;
  result.decay = -0.5 * std::log(b) / dt;
  result.omega_raw = std::acos(0.5 * a / std::sqrt(b)) / dt;
  result.omega = 2 / dt * std::sin(0.5 * result.omega_raw * dt);
  return result;
}

template <int Dim>
void agrees(const Wave& wave, std::initializer_list<long> wavelengths) {
  for (const long n : wavelengths) {
    const Measured m = run<Dim>(wave, n);
    const std::string what = fmt::format("{}D, {}{}, h = {} dx, {} a wavelength", Dim, wave.kernel,
                                         wave.corrected ? " corrected" : "", wave.h, n);
    SCOPED_TRACE(wave.formulation + ", " + what);
    record("wave", wave.formulation, what + ": frequency over the lattice's - 1",
           m.omega_raw / m.expected - 1, 0.01, "1");
    record("wave", wave.formulation, what + ": the same, the time step's error taken off",
           m.omega / m.expected - 1, wave.corrected ? 1e-4 : 1e-5, "1");
    record("wave", wave.formulation, what + ": lattice's frequency over k c - 1 (no bar)",
           m.expected / m.continuum - 1, std::nan(""), "1");
    // As taken: the time step adds (omega dt)^2/24, 0.06 % at 10 a wavelength.
    EXPECT_NEAR(m.omega_raw / m.expected, 1, 0.01);
    // With the leapfrog's sin(omega dt/2) = omega_0 dt/2 taken off nothing is left but the square of the
    // wave's amplitude; with the correction, the square of what its delay does (4e-4 at most).
    EXPECT_NEAR(m.omega / m.expected, 1, wave.corrected ? 1e-4 : 1e-5);
    if (wave.corrected) {
      record("wave", wave.formulation, what + ": decay in a period, negative since it grows (no bar)",
             2 * std::numbers::pi * m.decay / m.omega, NAN, "1");
      record("wave", wave.formulation, what + ": decay over the predicted one - 1",
             m.decay / m.expected_decay - 1, 0.02, "1");
      EXPECT_NEAR(m.decay, m.expected_decay, 0.02 * std::abs(m.expected_decay));
    } else {
      EXPECT_LT(std::abs(m.decay), 1e-5 * m.expected);
    }
  }
}

TEST(Wave, Robust2D) { agrees<2>({}, {10, 20, 40}); }
TEST(Wave, Robust3D) { agrees<3>({}, {10, 20, 40}); }
TEST(Wave, Source2D) { agrees<2>({"source", "cubic_spline", 1.2}, {10, 20, 40}); }
TEST(Wave, Source3D) { agrees<3>({"source", "cubic_spline", 1.2}, {10, 20, 40}); }
TEST(Wave, EveryKernel) {
  for (const char* kernel : {"cubic_spline", "wendland_c2", "wendland_c4"})
    for (const double h : {1.2, 1.5}) {
      agrees<2>({"robust", kernel, h}, {20});
      agrees<2>({"source", kernel, h}, {20});
    }
}
TEST(Wave, GradientCorrection) {
  agrees<2>({"robust", "wendland_c2", 1.5, true}, {10, 20, 40});
  agrees<2>({"robust", "wendland_c2", 1.2, true}, {20});
  agrees<3>({"robust", "wendland_c2", 1.5, true}, {20});
}

TEST(Wave, DefaultCompositionDecays) {
  // Artificial viscosity acts where particles approach, half of the time, and density diffusion always: what
  // a wave loses in a period grows as its wave number.
  double last = 1;
  for (const long n : {10L, 20L, 40L}) {
    Wave wave;
    wave.as_default = true;
    wave.amplitude = 1e-3;
    const Measured m = run<2>(wave, n);
    const double per_period = 1 - std::exp(-2 * std::numbers::pi * m.decay / m.omega);
    const std::string what = "2D, default parts, " + std::to_string(n) + " a wavelength";
    record("wave", "robust", what + ": frequency over the undamped lattice's - 1", m.omega / m.expected - 1,
           0.01, "1");
    record("wave", "robust", what + ": amplitude lost in a period (no bar)", per_period, NAN, "1");
    std::printf("%s: frequency %+.3e, lost in a period %.4f\n", what.c_str(), m.omega / m.expected - 1,
                per_period);
    EXPECT_NEAR(m.omega / m.expected, 1, 0.01);
    EXPECT_GT(per_period, 0);
    EXPECT_LT(per_period, last);
    last = per_period;
  }
}

}  // namespace
}  // namespace dem2sph
