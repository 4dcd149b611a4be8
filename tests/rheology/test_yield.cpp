// The return to the yield surface: closed form, Newton and plain bisection in long double agree; the stress
// lies on the surface of its own rate; a NaN is never taken for an elastic state.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "sph/base/pack.hpp"
#include "sph/base/tensor.hpp"
#include "sph/rheology/yield.hpp"

namespace dem2sph {
namespace {

constexpr double eps = std::numeric_limits<double>::epsilon();
constexpr double nan_value = std::numeric_limits<double>::quiet_NaN();

struct State {
  RationalFriction<double> law;
  Grains grains;
  double tau_trial, p, G_dt, beta, cohesion;
  double S0() const { return (law.mu_l + beta) * p + cohesion; }
  double S2() const { return (law.mu_h + beta) * p + cohesion; }
  double strength(double g) const {
    return friction(law, inertial_number(g, p, grains.d, grains.rho_s), beta) * p + cohesion;
  }
  Returned<> closed() const { return return_rational(law, grains, tau_trial, p, G_dt, beta, cohesion); }
  Returned<> newton() const {
    return return_by_newton(tau_trial, G_dt, [this](double g) { return strength(g); });
  }
};

// Flowing states: p from 1e-12 Pa to 1e12 Pa, G dt over 18 decades, the trial from just outside to a million
// times the strength, with and without cohesion.
template <class Action>
void for_many_states(int count, const Action& action) {
  std::mt19937_64 random(20260102);
  std::uniform_real_distribution<double> uniform(0, 1);
  const auto decades = [&](double low, double high) {
    return std::pow(10, low + (high - low) * uniform(random));
  };
  for (int i = 0; i < count && !testing::Test::HasFatalFailure(); ++i) {
    State x;
    const double mu_l = 0.35 + 0.3 * uniform(random);
    x.law = {mu_l, mu_l + 0.4 * uniform(random), decades(-2, 1)};
    x.grains = {decades(-4, -1), 1000 + 2000 * uniform(random)};
    x.p = decades(-12, 12);
    x.G_dt = decades(-12, 6);
    x.beta = -0.3 + 0.8 * uniform(random);
    x.cohesion = uniform(random) < 0.5 ? 0 : decades(-12, 6);
    x.tau_trial = x.S0() * (1 + decades(-9, 6));
    action(x);
  }
}

TEST(ReturnRational, AgreesWithNewtonAndLiesOnTheSurface) {
  for_many_states(20000, [](const State& x) {
    const Returned<> closed = x.closed();
    const Returned<> newton = x.newton();
    ASSERT_TRUE(std::isfinite(closed.tau) && std::isfinite(closed.gamma_dot));
    ASSERT_GT(closed.gamma_dot, 0);
    ASSERT_GE(closed.tau, x.S0() * (1 - 4 * eps));
    ASSERT_LE(closed.tau, x.tau_trial * (1 + 4 * eps));  // a sum, a root and a quotient
    // 1e-12 is what the coupling may rely on: a thousand times the rounding of either side.
    ASSERT_NEAR(newton.tau, closed.tau, 1e-12 * closed.tau);
    ASSERT_NEAR(x.strength(closed.gamma_dot), closed.tau, 1e-12 * closed.tau);
    // The rate is as well conditioned as the excess over the strength, known to eps tau_trial: with the drop
    // y = G dt g and r(y) the excess left, dr/dy = -root/(y + alpha), root^2 the discriminant of the
    // quadratic.
    const double alpha = x.G_dt * x.law.D_star * std::sqrt(x.p / x.grains.rho_s) / x.grains.d;
    const double y = x.G_dt * closed.gamma_dot;
    const double root = 2 * y + alpha + x.S2() - x.tau_trial;
    const double condition = x.tau_trial * (y + alpha) / (y * root);
    ASSERT_NEAR(newton.gamma_dot, closed.gamma_dot, 64 * eps * (1 + condition) * closed.gamma_dot);
    // What the trial has lost went into plastic shear.
    ASSERT_NEAR(x.tau_trial - closed.tau, y, 8 * eps * x.tau_trial);
  });
}

TEST(ReturnRational, ByHand) {
  // mu 0.4 to 0.8, D* = 1, p = 1, d/sqrt(p/rho) = 1 s, G dt = 1, no cohesion: S0 = 0.4, S2 = 0.8, alpha = 1.
  // From a trial of 1.6: tau = 0.4 + 0.4 g/(g + 1) and tau = 1.6 - g, so g^2 + 0.2... : g = 1 gives 0.6 =
  // 0.6.
  const Returned<> r = return_rational({0.4, 0.8, 1}, {1, 1}, 1.6, 1, 1, 0, 0);
  EXPECT_NEAR(r.tau, 0.6, 4 * eps);
  EXPECT_NEAR(r.gamma_dot, 1, 8 * eps);
  // beta and cohesion shift the strength: p = 1, beta = 0.1 and c = 0.1 need a trial higher by 0.2.
  const Returned<> shifted = return_rational({0.4, 0.8, 1}, {1, 1}, 1.8, 1, 1, 0.1, 0.1);
  EXPECT_NEAR(shifted.tau, 0.8, 4 * eps);
  EXPECT_NEAR(shifted.gamma_dot, 1, 8 * eps);
}

TEST(ReturnRational, InsideTheSurfaceNothingChanges) {
  for_many_states(1000, [](State x) {
    x.tau_trial = 0.999 * x.S0();
    for (const Returned<>& r : {x.closed(), x.newton()}) {
      ASSERT_EQ(r.tau, x.tau_trial);
      ASSERT_EQ(r.gamma_dot, 0);
    }
  });
}

TEST(ReturnRational, TheRootSurvivesATrialAtTheUpperStrength) {
  // B^2 - 4 H = (S2 - tau)^2 + small: formed as it stands it may round below zero, and the stress would be
  // NaN.
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int i = 0; i < 20000; ++i) {
    State x{
        {0.38, 0.64, 0.279}, {1e-3, 2500}, 0, 1e3 * (1 + uniform(random)), 1e-16, 0.3 * uniform(random), 0};
    x.tau_trial = x.S2() * (1 + (uniform(random) - 0.5) * 1e-14);
    const Returned<> r = x.closed();
    ASSERT_TRUE(std::isfinite(r.tau));
    ASSERT_GE(r.gamma_dot, 0);
    // At a trial of S2 exactly, tau = S2 - sqrt(alpha (S2 - S0)) to leading order; the trial is 0.5e-14
    // beside it.
    const double alpha = x.G_dt * x.law.D_star * std::sqrt(x.p / x.grains.rho_s) / x.grains.d;
    ASSERT_NEAR(r.tau, x.S2() - std::sqrt(alpha * (x.S2() - x.S0())), 2e-14 * x.S2());
  }
}

TEST(ReturnRational, WithoutPressureOnlyCohesionIsLeft) {
  const Returned<> r = return_rational({0.38, 0.64, 0.279}, {1e-3, 2500}, 50.0, 0, 1, 0, 20);
  EXPECT_NEAR(r.tau, 20, 20 * 4 * eps);
  EXPECT_NEAR(r.gamma_dot, 30, 30 * 4 * eps);
}

TEST(ReturnRational, AStrengthBelowZeroIsNone) {
  // mu_l + beta = 0.38 - 0.5: a stress of the other sign would push the particle the way it came from.
  State x{{0.38, 0.40, 0.279}, {1e-3, 2500}, 100, 1000, 10, -0.5, 0};
  for (const Returned<>& r : {x.closed(), x.newton()}) {
    EXPECT_EQ(r.tau, 0);
    EXPECT_NEAR(r.gamma_dot, 10, 10 * 4 * eps);  // all of the trial went into shear
  }
}

TEST(Return, ANaNIsNeverTakenForAnElasticState) {
  const State good{{0.38, 0.64, 0.279}, {1e-3, 2500}, 600, 1000, 10, 0.05, 5};
  ASSERT_TRUE(std::isfinite(good.closed().tau));
  ASSERT_GT(good.closed().gamma_dot, 0);
  // Of a flowing state, every number matters; of an elastic one, all that the strength is made of and the
  // trial.
  for (const double trial : {600.0, 100.0}) {
    const bool flows = trial > good.S0();
    const auto check = [&](const char* what, auto change, bool matters) {
      State x = good;
      x.tau_trial = trial;
      change(x);
      if (!matters) return;
      EXPECT_TRUE(std::isnan(x.closed().tau)) << what << " " << trial;
      EXPECT_TRUE(std::isnan(x.newton().tau)) << what << " " << trial;
    };
    check(
        "tau", [](State& x) { x.tau_trial = nan_value; }, true);
    check(
        "p", [](State& x) { x.p = nan_value; }, true);
    check(
        "beta", [](State& x) { x.beta = nan_value; }, true);
    check(
        "cohesion", [](State& x) { x.cohesion = nan_value; }, true);
    check(
        "mu_l", [](State& x) { x.law.mu_l = nan_value; }, true);
    check(
        "mu_h", [](State& x) { x.law.mu_h = nan_value; }, flows);
    check(
        "D*", [](State& x) { x.law.D_star = nan_value; }, flows);
    check(
        "G dt", [](State& x) { x.G_dt = nan_value; }, flows);
    check(
        "d", [](State& x) { x.grains.d = nan_value; }, flows);
    check(
        "rho_s", [](State& x) { x.grains.rho_s = nan_value; }, flows);
  }
  const Returned<> r = return_by_newton(2.0, 1.0, [](double g) { return g > 0 ? nan_value : 1.0; });
  EXPECT_TRUE(std::isnan(r.tau) && std::isnan(r.gamma_dot));
}

// Plain bisection in long double: slow, but nothing can go wrong with it.
template <class Strength>
long double rate_by_bisection(double tau_trial, double G_dt, const Strength& strength) {
  long double low = 0;
  long double high = static_cast<long double>(tau_trial) / G_dt;
  for (int i = 0; i < 200; ++i) {
    const long double g = 0.5L * (low + high);
    (tau_trial - G_dt * g > strength(static_cast<double>(g)) ? low : high) = g;
  }
  return low;
}

TEST(ReturnByNewton, WithEvolvingDilationTheStateIsConsistent) {
  std::mt19937_64 random(20260103);
  std::uniform_real_distribution<double> uniform(0, 1);
  const RationalFriction<double> law{0.38, 0.64, 0.279};
  const Grains grains{1e-3, 2500};
  int evaluations_at_most = 0;
  long evaluations_in_all = 0;
  long states = 0;
  for (int i = 0; i < 5000; ++i) {
    // G = 1e4 to 1e7 Pa and far above p beta/s*, so that the equation has one solution; steps of 1e-7 to 1e-2
    // s.
    const RelaxingSolidFraction dilation{
        LinearSolidFraction<double>{0.585, 0.1 + 0.3 * uniform(random)}, 0.1 + uniform(random), {}};
    const double p = std::pow(10, -2 + 5 * uniform(random));
    const double dt = std::pow(10, -7 + 5 * uniform(random));
    const double G_dt = dt * p * std::pow(10, 1.5 + 3 * uniform(random));
    const double phi_0 = 0.5 + 0.13 * uniform(random);
    const double cohesion = uniform(random) < 0.5 ? 0 : p * uniform(random);
    const double I_0 = 0.3 * uniform(random);
    int evaluations = 0;
    const auto state = [&](double g) {
      return dilation.after({phi_0, I_0}, inertial_number(g, p, grains.d, grains.rho_s), g * dt);
    };
    const auto strength = [&](double g) {
      ++evaluations;
      return friction(law, inertial_number(g, p, grains.d, grains.rho_s), state(g).beta) * p + cohesion;
    };
    const double tau_trial = (0.1 + strength(0.0) / p) * p * (1 + std::pow(10, -6 + 8 * uniform(random)));
    if (!(tau_trial > 0)) continue;
    evaluations = 0;
    const Returned<> r = return_by_newton(tau_trial, G_dt, strength);
    evaluations_at_most = std::max(evaluations_at_most, evaluations);
    evaluations_in_all += evaluations;
    ++states;
    if (r.tau == 0) continue;  // a loose sample that has no strength
    ASSERT_GT(r.gamma_dot, 0);
    // On the surface of its own phi, beta and I, and the drop is G dt g: to the 1e-14 tau_trial of the
    // residual.
    ASSERT_NEAR(r.tau, strength(r.gamma_dot), 1e-12 * r.tau);
    ASSERT_NEAR(tau_trial - r.tau, G_dt * r.gamma_dot, 2e-14 * (tau_trial + p + cohesion));
    const double g = static_cast<double>(rate_by_bisection(tau_trial, G_dt, strength));
    ASSERT_NEAR(r.tau, std::max(0.0, strength(g)), 1e-12 * (tau_trial + p + cohesion));
  }
  // The solver pays for each of them in its inner loop; without the safeguard and its end at rounding it was
  // 103.
  EXPECT_LE(evaluations_at_most, 64);
  EXPECT_LE(evaluations_in_all / states, 12);
}

TEST(ReturnByNewton, DenseIsStrongerAndLooseIsWeaker) {
  const RationalFriction<double> law{0.38, 0.64, 0.279};
  const Grains grains{1e-3, 2500};
  const RelaxingSolidFraction dilation{LinearSolidFraction<double>{0.585, 0.1}, 0.4, {}};
  const auto tau_from = [&](double phi_0) {
    return return_by_newton(2000, 100,
                            [&](double g) {
                              const double I = inertial_number(g, 1000.0, grains.d, grains.rho_s);
                              return friction(law, I, dilation.after({phi_0, 0}, I, g * 1e-4).beta) * 1000;
                            })
        .tau;
  };
  // beta_0 = (1 - 0.585/0.61)/0.4 = 0.10 and p = 1 kPa: about 100 Pa, more since phi_eq falls with I.
  EXPECT_GT(tau_from(0.61), tau_from(0.585) + 80);
  EXPECT_LT(tau_from(0.56), tau_from(0.585) - 80);
}

TEST(ReturnToYield, EachLaneOfAPackGetsItsOwn) {
  // Four states a pack: elastic, flowing, without pressure, without stress, with a strength below zero, NaN,
  // in any mixture.
  std::mt19937 random(11);
  std::vector<State> states;
  for_many_states(20000, [&](State x) {
    switch (random() % 8) {
      case 0:
        x.tau_trial = 0.5 * x.S0();
        break;
      case 1:
        x.p = 0;
        break;
      case 2:
        x.tau_trial = 0;
        break;
      case 3:
        x.beta = -2;
        break;
      case 4:
        (random() % 2 ? x.p : x.tau_trial) = nan_value;
        break;
      default:
        break;
    }
    states.push_back(x);
  });
  const auto pack_of = [&](std::size_t first, auto number) {
    return Pack::lane_by_lane([&](std::size_t lane) { return number(states[first + lane]); });
  };
  const auto check = [&](const auto& law) {
    for (std::size_t first = 0; first < states.size(); first += Pack::width) {
      const State& x = states[first];  // its grains, G dt and cohesion for all four
      const Pack p = pack_of(first, [](const State& y) { return y.p; });
      const Pack tau = pack_of(first, [](const State& y) { return y.tau_trial; });
      const Pack beta = pack_of(first, [](const State& y) { return y.beta; });
      const Returned<Pack> all = return_to_yield(law, x.grains, tau, p, x.G_dt, beta, x.cohesion);
      for (std::size_t lane = 0; lane < Pack::width; ++lane) {
        const Returned<> one =
            return_to_yield(law, x.grains, tau[lane], p[lane], x.G_dt, beta[lane], x.cohesion);
        ASSERT_EQ(std::isnan(all.tau[lane]), std::isnan(one.tau));
        ASSERT_EQ(std::isnan(all.gamma_dot[lane]), std::isnan(one.gamma_dot));
        if (std::isnan(p[lane]) || std::isnan(tau[lane])) {
          ASSERT_TRUE(std::isnan(one.tau) && std::isnan(one.gamma_dot));
          continue;
        }
        // The same operations, of which some are fused in one and not in the other; the rate is G dt times
        // less well known than the difference of trial and strength.
        ASSERT_NEAR(all.tau[lane], one.tau, 16 * eps * one.tau);
        ASSERT_NEAR(x.G_dt * all.gamma_dot[lane], x.G_dt * one.gamma_dot,
                    16 * eps * (tau[lane] + p[lane] + x.cohesion));
        ASSERT_EQ(all.gamma_dot[lane] == 0, one.gamma_dot == 0);
      }
    }
  };
  check(RationalFriction<double>{0.38, 0.64, 0.279});
  check(RationalRateFriction<double>{0.38, 0.64, 12});
  check(ConstantFriction<double>{0.4});
}

// ---- every member of the family

// Plain bisection in long double and in the logarithm of the rate, on the formulas written out again.
template <class Mu>
long double stress_by_bisection(const State& x, const Mu& mu) {
  const auto strength = [&](long double log_g) { return (mu(std::exp(log_g)) + x.beta) * x.p + x.cohesion; };
  long double low = -2000;  // e^-2000: long double has the range
  long double high = std::log(static_cast<long double>(x.tau_trial) / x.G_dt);
  for (int i = 0; i < 200; ++i) {
    const long double middle = 0.5L * (low + high);
    (x.tau_trial - x.G_dt * std::exp(middle) > strength(middle) ? low : high) = middle;
  }
  return std::max(0.0L, strength(low));
}

template <class Law>
Returned<> newton_of(const Law& law, const State& x) {
  return return_by_newton(x.tau_trial, x.G_dt,
                          [&](double g) { return strength(law, x.grains, g, x.p, x.beta, x.cohesion); });
}
template <class Law>
Returned<> returned_of(const Law& law, const State& x) {
  return return_to_yield(law, x.grains, x.tau_trial, x.p, x.G_dt, x.beta, x.cohesion);
}

TEST(ReturnToYield, ClosedFormsAgreeWithNewton) {
  for_many_states(20000, [](const State& x) {
    const auto check = [&](const auto& law) {
      const Returned<> closed = returned_of(law, x);
      const Returned<> newton = newton_of(law, x);
      ASSERT_TRUE(std::isfinite(closed.tau) && std::isfinite(closed.gamma_dot));
      // 1e-12 is what the coupling may rely on, a thousand times the rounding of either side.
      ASSERT_NEAR(newton.tau, closed.tau, 1e-12 * closed.tau);
      ASSERT_NEAR(x.tau_trial - closed.tau, x.G_dt * closed.gamma_dot, 8 * eps * x.tau_trial);
    };
    check(x.law);
    check(ConstantFriction<double>{x.law.mu_l});
    // A rate whose stress G dt D* lies 12 decades about the pressure.
    check(RationalRateFriction<double>{x.law.mu_l, x.law.mu_h, x.law.D_star * x.p / x.G_dt});
    check(RationalRateFriction<double>{x.law.mu_l, x.law.mu_h, x.law.D_star});
  });
}

TEST(ReturnToYield, ByHand) {
  // The example of return_rational above, with d/sqrt(p/rho) = 1 s: there I is the rate, so D* is 1/s as
  // well.
  const Returned<> rate = return_to_yield(RationalRateFriction<double>{0.4, 0.8, 1}, {7, 3}, 1.6, 1, 1, 0, 0);
  EXPECT_NEAR(rate.tau, 0.6, 4 * eps);
  EXPECT_NEAR(rate.gamma_dot, 1, 8 * eps);
  const Returned<> constant = return_to_yield(ConstantFriction<double>{0.4}, {7, 3}, 1.6, 2, 0.5, 0.1, 0.25);
  EXPECT_NEAR(constant.tau, 1.25, 4 * eps);  // (0.4 + 0.1) 2 + 0.25
  EXPECT_NEAR(constant.gamma_dot, 0.7, 8 * eps);
  const Returned<> inside = return_to_yield(ConstantFriction<double>{0.4}, {7, 3}, 1.2, 2, 0.5, 0.1, 0.25);
  EXPECT_EQ(inside.tau, 1.2);
  EXPECT_EQ(inside.gamma_dot, 0);
  const Returned<> none = return_to_yield(ConstantFriction<double>{0.4}, {7, 3}, 1.2, 2, 0.5, -0.5, 0);
  EXPECT_EQ(none.tau, 0);
  EXPECT_EQ(none.gamma_dot, 2.4);
}

template <class Action>
void for_every_law(const Action& action) {
  action(ConstantFriction<double>{0.4});
  action(RationalFriction<double>{0.38, 0.64, 0.279});
  action(RationalRateFriction<double>{0.38, 0.64, 12});
  action(BarkerGray2017<double>(0.383, 0.644, 0.279, 0.05, 1.9));
}

TEST(ReturnToYield, AsThePressureVanishes) {
  for_every_law([](const auto& law) {
    for (double p = 1e-12; p > 1e-301; p *= 1e-4)
      for (const double cohesion : {0.0, 1e-200, 1e-3, 20.0})
        for (const double beta : {0.0, 0.2, -0.5})
          for (const double over : {1e-6, 0.5, 10.0, 1e6}) {
            const double largest = 0.7 * p + cohesion;
            for (const double G_dt : {1e-6, 1.0, 1e4}) {
              const State x{{}, {1e-3, 2500}, largest * (1 + over), p, G_dt, beta, cohesion};
              const Returned<> r = returned_of(law, x);
              const Returned<> newton = newton_of(law, x);
              ASSERT_TRUE(std::isfinite(r.tau) && std::isfinite(r.gamma_dot)) << p;
              ASSERT_GE(r.tau, 0);
              ASSERT_LE(r.tau, x.tau_trial);
              ASSERT_GE(r.gamma_dot, 0);
              ASSERT_NEAR(newton.tau, r.tau, 1e-12 * x.tau_trial) << p << " " << cohesion << " " << over;
              // The strength is the cohesion, but for what mu_inf g d sqrt(rho_s p) = 2.5e-9 Pa s g adds.
              if (cohesion > 1e-4 && over < 100 && G_dt >= 1) {
                ASSERT_NEAR(r.tau, cohesion, 1e-7 * cohesion);
              }
            }
          }
    // p = 0 exactly: the cohesion, and nothing else.
    for (const double cohesion : {0.0, 1e-200, 20.0}) {
      const State x{{}, {1e-3, 2500}, 2 * cohesion + 1, 0, 10, 0.1, cohesion};
      for (const Returned<>& r : {returned_of(law, x), newton_of(law, x)}) {
        ASSERT_NEAR(r.tau, cohesion, 4 * eps * x.tau_trial);
        ASSERT_NEAR(r.gamma_dot, (x.tau_trial - cohesion) / 10, 8 * eps * x.tau_trial);
      }
    }
  });
}

TEST(ReturnToYield, WithStrongCohesion) {
  for_every_law([](const auto& law) {
    for (const double cohesion : {1e3, 1e6, 1e9}) {
      State x{{}, {1e-3, 2500}, 0.99 * cohesion, 1, 10, 0.1, cohesion};
      EXPECT_EQ(returned_of(law, x).tau, x.tau_trial);
      EXPECT_EQ(returned_of(law, x).gamma_dot, 0);
      x.tau_trial = 2 * cohesion;
      const Returned<> r = returned_of(law, x);
      const double expected = strength(law, x.grains, r.gamma_dot, x.p, x.beta, x.cohesion);
      EXPECT_NEAR(r.tau, expected, 1e-12 * expected);
      EXPECT_NEAR(newton_of(law, x).tau, r.tau, 1e-12 * r.tau);
      EXPECT_GT(r.gamma_dot, 0);
    }
  });
}

TEST(ReturnToYield, ANaNIsNeverTakenForAnElasticState) {
  for_every_law([](const auto& law) {
    const State good{{}, {1e-3, 2500}, 1000, 1000, 10, 0.05, 5};
    ASSERT_TRUE(std::isfinite(returned_of(law, good).tau));
    const auto check = [&](const char* what, auto change) {
      State x = good;
      change(x);
      EXPECT_TRUE(std::isnan(returned_of(law, x).tau)) << what;
      EXPECT_TRUE(std::isnan(newton_of(law, x).tau)) << what;
    };
    check("tau", [](State& x) { x.tau_trial = nan_value; });
    check("p", [](State& x) { x.p = nan_value; });
    check("beta", [](State& x) { x.beta = nan_value; });
    check("cohesion", [](State& x) { x.cohesion = nan_value; });
    State x = good;
    x.G_dt = nan_value;
    EXPECT_TRUE(std::isnan(returned_of(law, x).gamma_dot));
  });
}

TEST(ReturnByNewton, WithoutAYieldStressItFindsTheCreep) {
  const BarkerGray2017<double> law(0.383, 0.644, 0.279, 0.05, 1.9);
  const Grains grains{1e-3, 2500};
  int evaluations_at_most = 0;
  long evaluations_in_all = 0;
  long states = 0;
  for (double p = 1e-6; p < 1e7; p *= 100)
    for (double ratio = 1e-12; ratio < 1.1e3; ratio *= 1.3)
      for (double G_dt = p * 1e-8; G_dt < p * 1e3; G_dt *= 30) {
        const State x{{}, grains, ratio * p, p, G_dt, 0, 0};
        int evaluations = 0;
        const Returned<> r = return_by_newton(x.tau_trial, G_dt, [&](double g) {
          ++evaluations;
          return strength(law, grains, g, p, 0, 0);
        });
        evaluations_at_most = std::max(evaluations_at_most, evaluations);
        evaluations_in_all += evaluations;
        ++states;
        // The law again, in long double, with its own ln so that I may be e^-2000.
        const auto mu = [&](long double g) -> long double {
          const long double I = g * 1e-3L * std::sqrt(2500.0L / p);
          if (I <= law.I_N) return std::sqrt(1.9L / (law.log_A - std::log(I)));
          return (0.383L * 0.279L + 0.644L * I + 0.05L * I * I) / (0.279L + I);
        };
        ASSERT_TRUE(std::isfinite(r.tau) && r.gamma_dot >= 0);
        ASSERT_LE(r.tau, x.tau_trial);
        // A trial below sqrt(1.9/670) p = 0.053 p is carried at a rate below 1e-290: as if at rest, to all
        // digits.
        if (ratio < 0.05) {
          ASSERT_EQ(r.tau, x.tau_trial);
        }
        const long double exact = ratio < 0.05 ? x.tau_trial : stress_by_bisection(x, mu);
        ASSERT_NEAR(r.tau, static_cast<double>(exact), 1e-12 * x.tau_trial)
            << p << " " << ratio << " " << G_dt;
        ASSERT_NEAR(r.tau, static_cast<double>(exact), 1e-11 * r.tau) << p << " " << ratio << " " << G_dt;
        ASSERT_NEAR(x.tau_trial - r.tau, G_dt * r.gamma_dot, 4e-14 * x.tau_trial);
      }
  EXPECT_LE(evaluations_at_most, 80);
  EXPECT_LE(evaluations_in_all / states, 16);
}

}  // namespace
}  // namespace dem2sph
