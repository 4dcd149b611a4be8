// What one particle does with its velocity gradient: the stress of Eq. 5.3, its floor at g_min, NaN, tension.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "sph/constitutive.hpp"

namespace dem2sph {
namespace {

constexpr double eps = std::numeric_limits<double>::epsilon();

// One particle in simple shear at the rate g.
Particles<2> particle(double p, double g) {
  Particles<2> q;
  q.resize(1, 1);
  for (Column& c : q.l) c.assign(1, 0.0);
  q.l[1][0] = g;
  q.p[0] = p;
  q.m[0] = q.rho[0] = 1;
  return q;
}
double tau_after(Particles<2> q, const DirectStress& stress, double mu, double cohesion) {
  update_stress(q, {0, 1}, stress, ConstantFriction<double>{mu}, NoDilation{},
                {1e-4, {1e-3, 2500}, cohesion, 0});
  return equivalent_stress(q.deviator(0));
}

template <class Law>
double tau_by_viscosity(Particles<2> q, const Law& law) {
  update_stress(q, {0, 1}, DirectStress{1e-6}, law, NoDilation{}, {1e-4, {1e-3, 2500}, 0, 0});
  return equivalent_stress(q.deviator(0));
}

TEST(DirectStress, IsThatOfEq53) {
  EXPECT_NEAR(tau_after(particle(1000, 10), {1e-3}, 0.5, 20), 520, 520 * 8 * eps);
  // Below g_min the viscosity stays, and the stress goes to zero with the rate.
  EXPECT_NEAR(tau_after(particle(1000, 0.05), {0.1}, 0.5, 20), 260, 260 * 8 * eps);
  EXPECT_EQ(tau_after(particle(1000, 0), {0.1}, 0.5, 20), 0);
}

TEST(DirectStress, ANaNIsSeen) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(std::isnan(tau_after(particle(1000, nan), {0.1}, 0.5, 20)))
      << "a NaN rate must not become g_min";
  EXPECT_TRUE(std::isnan(tau_after(particle(nan, 1), {0.1}, 0.5, 20)));
  EXPECT_TRUE(std::isnan(tau_after(particle(1000, 1), {0.1}, nan, 20)));
}

TEST(ElasticStress, WithoutPressureThereIsNone) {
  Particles<2> q = particle(0, 10);
  q.s[3][0] = 5;
  const Dissipation d = update_stress(q, {0, 1}, ElasticReturn{1e5}, ConstantFriction<double>{0.5},
                                      NoDilation{}, {1e-4, {1e-3, 2500}, 0, 0});
  EXPECT_EQ(equivalent_stress(q.deviator(0)), 0);
  EXPECT_NEAR(d.cut_off[0], 2 * 5 * 5 / (4 * 1e5), 1e-18) << "s:s/(4 G)";
}

// Particles in all states, the count of which fills no whole number of clusters.
template <int Dim>
Particles<Dim> mixture(std::size_t count) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal(0, 1);
  Particles<Dim> q;
  q.resize(count, count);
  for (std::size_t i = 0; i < count; ++i) {
    Gradient<Dim> l;
    for (double& c : l.c) c = 100 * normal(random);
    Sym<Dim> s;
    for (double& c : s.c) c = 500 * normal(random);
    q.m[i] = q.rho[i] = 1;
    q.p[i] = 1000 * std::exp(normal(random));
    switch (random() % 8) {
      case 0:
        q.p[i] = 0;
        break;
      case 1:
        q.p[i] = -100 * std::abs(normal(random));
        break;
      case 2:
        l = {}, s = {};
        break;
      case 3:
        l = {}, s *= 0.1;
        break;
      case 4:
        q.p[i] = std::numeric_limits<double>::quiet_NaN();
        break;
      case 5:
        l(0, 1) = std::numeric_limits<double>::quiet_NaN();
        break;
      default:
        break;
    }
    Particles<Dim>::store(q.l, i, l);
    q.set_deviator(i, deviator(s));
  }
  return q;
}

template <int Dim, class Law>
void lanes_agree_with_one_particle(const Law& law) {
  const ElasticReturn stress{4e5};
  for (const double cohesion : {0.0, 50.0}) {
    const StateInput in{1e-5, {1e-3, 2500}, cohesion, 0};
    const double G_dt = stress.G * in.dt;
    const Particles<Dim> before = mixture<Dim>(1003);
    Particles<Dim> q = before;
    for_clusters(0, q.size, [&](const Cluster& a) { update_stress(q, a, stress, law, NoDilation{}, in); });
    std::size_t flowing = 0;
    for (std::size_t i = 0; i < q.size; ++i) {
      const double p = before.p[i];
      const Gradient<Dim> l = Particles<Dim>::load(before.l, i);
      const Sym<Dim> rate = deviator(strain_rate(l));
      Sym<Dim> s = rotate(before.deviator(i), l, in.dt);
      for (int k = 0; k < Sym<Dim>::size; ++k) s[k] += 2 * G_dt * rate[k];
      const double trial = equivalent_stress(s);
      Returned<> expected{0, shear_rate(rate)};
      if (p < 0 && cohesion > 0)
        expected = return_by_newton(trial, G_dt, [&](double) {
          return std::max(0.0, steady_friction(law, 0.0, 0.0) * p + cohesion);
        });
      else if (!(p <= 0))
        expected = return_to_yield(law, in.grains, trial, p, G_dt, 0, cohesion);
      const double tau = equivalent_stress(q.deviator(i));
      if (std::isnan(p) || std::isnan(trial)) {
        // What has no pressure bears no stress, whatever its rate, which shows.
        ASSERT_TRUE(std::isnan(tau) || p <= 0) << "a NaN must show";
        ASSERT_TRUE(std::isnan(q.gamma_dot[i]));
        continue;
      }
      // Rounding of a few operations on the trial; of the Newton's residual, 1e-14 of it, in some members.
      const double rounding = (64 * eps + (has_closed_return<Law> ? 0 : 4e-14)) * trial;
      ASSERT_NEAR(tau, expected.tau, rounding);
      ASSERT_NEAR(G_dt * q.gamma_dot[i], G_dt * expected.gamma_dot, rounding + 64 * eps * G_dt * 1e3);
      flowing += expected.gamma_dot > 0 && p > 0;
    }
    EXPECT_GT(flowing, 100u);
  }
}

TEST(ElasticStress, EachLaneIsWhatOneParticleWouldBe) {
  lanes_agree_with_one_particle<2>(RationalFriction<double>{0.38, 0.64, 0.279});
  lanes_agree_with_one_particle<3>(RationalFriction<double>{0.38, 0.64, 0.279});
  lanes_agree_with_one_particle<2>(RationalRateFriction<double>{0.38, 0.64, 12});
  lanes_agree_with_one_particle<2>(ConstantFriction<double>{0.4});
  lanes_agree_with_one_particle<2>(PowerFriction<double>{0.37, 0.3, 0.8});
}

TEST(Extrapolation, ClampedLawsTakeTheNearestIWithData) {
  // Data from I = 0.01 to 0.1; sheared at I = 0.0016, 0.05 and 0.5 under 1 kPa.
  const DataRange data{0.01, 0.1};
  const RationalFriction<double> law{0.38, 0.64, 0.279};
  const double to_I = 1e-3 / std::sqrt(1000.0 / 2500);
  const auto mu_of = [&](double I, bool clamp, bool elastic) {
    Particles<2> q = particle(1000, I / to_I);
    const double dt = 0.06 / (I / to_I) / 200;
    const StateInput in{elastic ? dt : 1e-4, {1e-3, 2500}, 0, 0, clamp, data};
    for (int step = 0; step < 200; ++step) {
      if (elastic)
        update_stress(q, {0, 1}, ElasticReturn{4e5}, law, NoDilation{}, in);
      else
        update_stress(q, {0, 1}, DirectStress{1e-9}, law, NoDilation{}, in);
    }
    return equivalent_stress(q.deviator(0)) / 1000;
  };
  for (const bool elastic : {false, true}) {
    // 20 relaxation strains leave e^-20 of the way, and a stress that turns with the shear lags by tau/G =
    // 1e-3.
    const double close = elastic ? 1e-5 : 1e-12;
    EXPECT_NEAR(mu_of(1e-3, true, elastic), law(0.01), close);
    EXPECT_NEAR(mu_of(0.05, true, elastic), law(0.05), close);
    EXPECT_NEAR(mu_of(0.5, true, elastic), law(0.1), close);
    EXPECT_NEAR(mu_of(0.5, false, elastic), law(0.5), close);
  }
}

// The fourth of the one-law set (tests/rheology/test_members.cpp has the other three): a particle in simple
// shear, after 20 relaxation strains tau/G, carries the law's friction at its own rate and pressure.
TEST(OneLaw, AParticleInSimpleShearCarriesIt) {
  const Grains grains{1e-3, 2500};
  const FrictionLaw members[] = {ConstantFriction<double>{0.4},
                                 RationalFriction<double>{0.38, 0.64, 0.279},
                                 RationalRateFriction<double>{0.38, 0.64, 12},
                                 ExponentialFriction<double>{0.38, 0.64, 0.279},
                                 PowerFriction<double>{0.37, 0.3, 0.8},
                                 LinearFriction<double>{0.38, 0.5},
                                 BarkerGray2017<double>(0.383, 0.644, 0.279, 0.05, 1.9)};
  static_assert(std::size(members) == std::variant_size_v<FrictionLaw>);
  std::size_t index = 0;
  for (const FrictionLaw& member : members) {
    ASSERT_EQ(member.index(), index++) << "every member once, in order";
    std::visit(
        [&](const auto& law) {
          for (const double rate : {0.3, 10.0, 200.0}) {
            Particles<2> elastic = particle(1000, rate);
            const ElasticReturn stress{4e5};
            // tau is below 1.2 p here: 20 relaxation strains are 0.06.
            const double dt = 0.06 / rate / 200;
            for (int i = 0; i < 200; ++i)
              update_stress(elastic, {0, 1}, stress, law, NoDilation{}, {dt, grains, 0, 0});
            const auto mu = [&](double g) {
              return steady_friction(law, inertial_number(g, 1000.0, grains.d, grains.rho_s), g);
            };
            EXPECT_NEAR(equivalent_stress(elastic.deviator(0)) / 1000, mu(elastic.gamma_dot[0]), 1e-10)
                << law.name << " at " << rate << "/s";
            EXPECT_NEAR(elastic.gamma_dot[0], rate, 1e-3 * rate) << "all of the shear is plastic by then";
            EXPECT_NEAR(tau_by_viscosity(particle(1000, rate), law) / 1000, mu(rate), 1e-10) << law.name;
          }
        },
        member);
  }
}

TEST(State, SwellingAtConstantDensityRaisesThePressure) {
  // A dense sample that is sheared without room: phi falls towards phi_eq, rho0 with it, and the pressure
  // rises by K times the fall. What that stores in compression is accounted for.
  Particles<2> q = particle(1000, 10);
  const EquationOfState eos{1e6, 1, 0.62 * 2500, 0};
  q.rho[0] = eos.density(1000);
  q.m[0] = q.rho[0];
  q.rho0.assign(1, eos.rho0);
  q.beta.assign(1, 0.0);
  q.dilation_state.assign(1, 0.62);
  q.dilation_I.assign(1, 0.0);
  DilationEvolves dilation;
  dilation.law = {LinearSolidFraction<double>{0.6, 0.2}, 0.3, {}};
  const double before = eos.energy(q.rho[0], q.rho0[0]);
  double swollen = 0;
  for (int i = 0; i < 100; ++i)
    swollen += state_pass(q, 0, 1, eos, ElasticReturn{4e5}, ConstantFriction<double>{0.4}, dilation,
                          {1e-4, {1e-3, 2500}, 0, 2500})
                   .swollen;
  EXPECT_LT(q.dilation_state[0], 0.62);
  EXPECT_NEAR(q.p[0], eos.pressure(q.rho[0], q.rho0[0]), 1e-9);
  EXPECT_GT(q.p[0], 2000);
  EXPECT_NEAR(swollen, q.m[0] * (eos.energy(q.rho[0], q.rho0[0]) - before), 1e-9 * swollen);
}

}  // namespace
}  // namespace dem2sph
