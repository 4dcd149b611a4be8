// Tension up to the tensile strength and no further: one particle through the equation of state and the
// stress update.
#include <gtest/gtest.h>

#include "sph/constitutive.hpp"
#include "tests/verification/record.hpp"

namespace dem2sph {
namespace {

const EquationOfState eos{150e3, 1, 1500, 200};  // bears 200 Pa of tension
const RationalFriction<double> law{0.38, 0.64, 0.279};
constexpr double cohesion = 100;  // apex of the cone at 100/0.38 = 263 Pa
constexpr double G = 60e3;

struct One {
  Particles<2> q;
  double lost = 0, sheared = 0;
  One() {
    q.resize(1, 1);
    for (Column& c : q.l) c.assign(1, 0.0);
    q.rho_rate.assign(1, 0.0);
    q.m[0] = 0.15;
    q.rho[0] = eos.rho0;
  }
  /// One step of dt with the velocity gradient l.
  template <class Stress>
  void step(const Stress& stress, const Gradient<2>& l, double dt) {
    Particles<2>::store(q.l, 0, l);
    q.rho_rate[0] = -q.rho[0] * l.trace();
    const StateSums sums =
        state_pass(q, 0, 1, eos, stress, law, NoDilation{}, {dt, {0.005, 2500}, cohesion, 0});
    lost += sums.cut_off;
    sheared += sums.sheared;
  }
};

Gradient<2> expansion(double rate) {
  Gradient<2> l;
  l(0, 0) = l(1, 1) = 0.5 * rate;
  return l;
}
Gradient<2> shear(double rate) {
  Gradient<2> l;
  l(0, 1) = rate;
  return l;
}

template <class Stress>
void bears_its_tensile_strength(const Stress& stress, const char* formulation) {
  for (const double asked : {0.5, 0.99, 1.01, 1.5}) {  // tension over the strength
    One one;
    const int steps = 1000;
    const double strain = asked * eos.tension / eos.K;
    double largest_tension = 0;
    for (int i = 0; i < steps; ++i) {
      one.step(stress, expansion(strain), 1.0 / steps);
      largest_tension = std::max(largest_tension, -one.q.p[0]);
    }
    SCOPED_TRACE(asked);
    if (asked < 1) {
      // rho = rho0 (1 - strain) up to strain^2/2 = 2e-6, of which the tension is K/T = 750 times as
      // sensitive.
      EXPECT_NEAR(-one.q.p[0], asked * eos.tension, 1e-3 * eos.tension);
      // The law leaves c - mu T of shear there: after a long shear the stress stands on it.
      const double left = cohesion - 0.38 * -one.q.p[0];
      for (int i = 0; i < 2000; ++i) one.step(stress, shear(10), 1e-4);
      EXPECT_NEAR(equivalent_stress(one.q.deviator(0)), left, 1e-9 * cohesion);
    } else {
      EXPECT_EQ(one.q.p[0], 0) << "it has come apart";
      EXPECT_LE(largest_tension, eos.tension);
      EXPECT_GT(largest_tension, 0.99 * eos.tension * (1 - 1.5 / steps));
      for (int i = 0; i < 100; ++i) one.step(stress, shear(10), 1e-4);
      EXPECT_EQ(equivalent_stress(one.q.deviator(0)), 0) << "and carries nothing";
      record("cohesion", formulation,
             "largest tension over the tensile strength, pulled to " + std::to_string(asked),
             largest_tension / eos.tension, 1, "1");
    }
  }
}
TEST(Cohesion, BearsItsTensileStrengthRobust) { bears_its_tensile_strength(ElasticReturn{G}, "robust"); }
TEST(Cohesion, BearsItsTensileStrengthSource) { bears_its_tensile_strength(DirectStress{0.1}, "source"); }

TEST(Cohesion, WhatIsCutOffIsTheElasticEnergyOfShear) {
  One one;
  one.q.rho[0] =
      eos.density(1);  // exactly p = 0 is taken for material that has come apart: it carries no shear
  const double strain = 20 / G;  // elastic: 20 Pa of shear
  for (int i = 0; i < 100; ++i) one.step(ElasticReturn{G}, shear(strain), 0.01);
  const double tau = equivalent_stress(one.q.deviator(0));
  EXPECT_NEAR(tau, 20, 1e-6 * 20);
  EXPECT_EQ(one.sheared, 0);
  // Pulled apart in plane strain, which adds a deviator of its own. What is lost is the shear energy that was
  // there a step before, and what tension stores up to the strength.
  Sym<2> last;
  for (int i = 0; i < 1000 && one.lost == 0; ++i) {
    last = one.q.deviator(0);
    one.step(ElasticReturn{G}, expansion(1.5 * eos.tension / eos.K), 0.002);
  }
  EXPECT_EQ(one.q.p[0], 0);
  const double energy =
      one.q.m[0] / one.q.rho[0] * last.square() / (4 * G) + one.q.m[0] * eos.energy_in_tension(eos.rho0);
  record("cohesion", "robust", "energy cut off over that of shear and tension - 1", one.lost / energy - 1,
         1e-12, "1");
  EXPECT_NEAR(one.lost / energy, 1, 1e-12);
  EXPECT_EQ(equivalent_stress(one.q.deviator(0)), 0);
}

TEST(Cohesion, NoneBearsNoTension) {
  EquationOfState loose = eos;
  loose.tension = 0;
  EXPECT_EQ(loose.pressure(eos.rho0 * (1 - 1e-9)), 0);
  EXPECT_GT(loose.pressure(eos.rho0 * (1 + 1e-9)), 0);
}

}  // namespace
}  // namespace dem2sph
