// What particles do with their velocity gradients: density, pressure, dilation, stress. No pairs here.
//
// A cluster of particles goes through at once, in the lanes of packs. Only what iterates (the return of laws
// without a closed form, a dilation that evolves) takes its particles one by one.
#pragma once

#include <cmath>

#include "sph/base/law_file.hpp"
#include "sph/equation_of_state.hpp"
#include "sph/loops.hpp"
#include "sph/particles.hpp"
#include "sph/parts.hpp"
#include "sph/terms.hpp"

namespace dem2sph {

/// Energy that leaves the budget in one step [J].
struct StateSums {
  double sheared = 0;   ///< dissipated by plastic or viscous shear
  double diffused = 0;  ///< that density diffusion (and what a density's own sum has beyond -rho tr(L)) put
                        ///< into compression (negative: took)
  double cut_off = 0;   ///< elastic energy that was lost where material came apart
  double swollen = 0;   ///< that a change of rho0 put into compression: what dilation against pressure stores
};

/// What the constitutive pass needs beside the particle.
struct StateInput {
  double dt = 0;
  Grains grains;
  double cohesion = 0;
  double rho_s = 0;    ///< density of the grains' material if rho0 follows phi, else 0 [kg/m^3]
  bool clamp = false;  ///< whether the laws take the nearest I of `range` where I is outside
  DataRange range{};   ///< of I that the law's data cover

  template <class Real>
  Real in_law(const Real& I) const {
    if (!clamp) return I;
    const Real lowest = range.lowest, highest = range.highest;
    return select(I < lowest, lowest, select(I > highest, highest, I));  // NaN stays
  }
};

/// What a particle can bear under its pressure p, as a function of the rate g at which it shears: the law,
/// the dilation and cohesion together.
template <class Law, class Dilation, class Real = double>
struct Strength {
  const Law& law;
  const Dilation& dilation;
  const StateInput& in;
  Real p;
  Real frozen_beta;     ///< of a dilation without a state
  DilationState state;  ///< of one that has a state: only a single particle is asked then
  Real to_I = inertial_number(Real(1), p, in.grains.d, in.grains.rho_s);

  /// State and beta of dilation after an increment at the rate g.
  DilationStep after(double g) const { return dilation.law.after(state, in.in_law(g * to_I), g * in.dt); }
  Real beta(const Real& g) const {
    if constexpr (has_dilation_state<Dilation>)
      return after(g).beta;
    else
      return frozen_beta;
  }
  /// mu p + c with a mu that is never below zero; NaN stays.
  Real operator()(const Real& g) const {
    const Real mu = steady_friction(law, in.in_law(g * to_I), g) + beta(g);
    return positive(positive(mu) * p + in.cohesion);
  }
  /// In tension, down to the tensile strength: mu(I) has no meaning there, and mu at rest stands for it.
  Real in_tension() const { return positive(steady_friction(law, 0.0, 0.0) * p + in.cohesion); }
};

/// Energy that leaves with a particle's stress [J/m^3]: by shear, and by a cut-off.
struct Dissipation {
  Pack sheared;
  Pack cut_off;
};

/// Stress of a cluster at its pressures from its velocity gradients. Writes stress, gamma_dot and what
/// dilation keeps.
template <int Dim, class Stress, class Law, class Dilation>
Dissipation update_stress(Particles<Dim>& q, const Cluster& a, const Stress& stress, const Law& law,
                          const Dilation& dilation, const StateInput& in) {
  constexpr bool elastic = std::is_same_v<Stress, ElasticReturn>;
  constexpr bool together = has_closed_return<Law> && !has_dilation_state<Dilation>;
  const Pack p = a.load(q.p);
  const auto l = a.load<Gradient<Dim, Pack>>(q.l);
  const Sym<Dim, Pack> rate = deviator(strain_rate(l));
  const Pack total_rate = shear_rate(rate);
  // Without pressure separated grains carry no stress, unless something holds them together (p < 0 is only
  // reached within the tensile strength). A NaN of p goes on and shows.
  const Mask pulled = p < Pack(0);
  const Mask apart = in.cohesion > 0 ? p == Pack(0) : p <= Pack(0);

  Pack beta;
  if constexpr (std::is_same_v<Dilation, DilationFromField>)
    beta = direct_dilation(l.trace(), total_rate, dilation.limits);
  const Strength<Law, Dilation, Pack> strength{law, dilation, in, p, beta, {}};
  const auto strength_of = [&](std::size_t lane) {
    DilationState state;
    if constexpr (has_dilation_state<Dilation>)
      state = {q.dilation_state[a.first + lane], q.dilation_I[a.first + lane]};
    return Strength<Law, Dilation>{law, dilation, in, p[lane], beta[lane], state};
  };
  /// f(lane) of all particles that bear pressure, NaN among them.
  const auto one_by_one = [&](auto&& f) {
    for (std::size_t lane = 0; lane < a.count; ++lane)
      if (!apart[lane] && !pulled[lane]) f(lane);
  };

  Sym<Dim, Pack> s;
  Returned<Pack> end{0, total_rate};
  Dissipation lost;
  if constexpr (elastic) {
    const Sym<Dim, Pack> before = q.deviator(a);
    const double G_dt = stress.G * in.dt;
    s = rotate(before, l, in.dt);
    for (int k = 0; k < Sym<Dim>::size; ++k) s[k] += 2 * G_dt * rate[k];
    const Pack trial = equivalent_stress(s);
    const auto returned = [&] {
      if constexpr (together)
        if (!in.clamp) return return_to_yield(law, in.grains, trial, p, G_dt, beta, in.cohesion);
      Returned<Pack> each;
      one_by_one([&](std::size_t lane) {
        const Returned<> one = return_by_newton(trial[lane], G_dt, strength_of(lane));
        each.tau.set(lane, one.tau), each.gamma_dot.set(lane, one.gamma_dot);
      });
      return each;
    };
    end = returned();
    if (in.cohesion > 0) end = choice(pulled, return_constant(strength.in_tension(), trial, G_dt), end);
    const Mask stands = end.gamma_dot == Pack(0);
    for (Pack& component : s.c) component *= select(stands, Pack(1), end.tau / trial);
    // The momentum balance works with the stress after the return, so this is what plastic shear takes of its
    // work.
    lost.sheared = end.tau * end.gamma_dot * in.dt;
    lost.cut_off = select(apart, before.square() / (4 * stress.G), Pack(0));
    end.gamma_dot = select(apart, total_rate, end.gamma_dot);
  } else {
    const Pack least = stress.gamma_dot_min;
    if constexpr (together)
      end.tau = strength(total_rate);
    else
      one_by_one([&](std::size_t lane) { end.tau.set(lane, strength_of(lane)(total_rate[lane])); });
    if (in.cohesion > 0) end.tau = select(pulled, strength.in_tension(), end.tau);
    const Pack eta = end.tau / select(total_rate < least, least, total_rate);  // a NaN rate stays one
    s = rate;
    s *= 2 * eta;
    lost.sheared = eta * total_rate * total_rate * in.dt;
  }
  for (Pack& component : s.c) component = select(apart, Pack(0), component);
  lost.sheared = select(apart, Pack(0), lost.sheared);
  a.store(q.s, s);
  a.store(q.gamma_dot, end.gamma_dot);
  if constexpr (has_dilation_state<Dilation>) {
    one_by_one([&](std::size_t lane) {  // the state at the end of the increment
      const DilationStep after = strength_of(lane).after(end.gamma_dot[lane]);
      q.dilation_state[a.first + lane] = after.state.value;
      q.dilation_I[a.first + lane] = after.state.I;
      beta.set(lane, after.beta);
    });
  }
  if constexpr (!std::is_same_v<Dilation, NoDilation>) a.store(q.beta, select(apart | pulled, Pack(0), beta));
  return lost;
}

/// Density where it follows a continuity equation, pressure and stress of the particles [begin, end).
template <int Dim, class Stress, class Law, class Dilation>
StateSums state_pass(Particles<Dim>& q, std::size_t begin, std::size_t end, const EquationOfState& eos,
                     const Stress& stress, const Law& law, const Dilation& dilation, const StateInput& in) {
  constexpr bool elastic = std::is_same_v<Stress, ElasticReturn>;
  const bool own_rho0 = !q.rho0.empty();
  const bool continuity = !q.rho_rate.empty();
  const Clusters clusters(begin, end);
  const auto sums = sum_over<4, Pack>(0, clusters.count(), [&](std::size_t k, std::array<Pack, 4>& sum) {
    const Cluster a = clusters[k];
    const Pack m = a.present() * a.load(q.m);
    const Pack p_before = a.load(q.p);
    Pack rho = a.load(q.rho);
    Pack rho0 = own_rho0 ? a.load(q.rho0) : Pack(eos.rho0);
    if (continuity) {
      const Pack rate = a.load(q.rho_rate);
      const Pack from_flow = -rho * a.load<Gradient<Dim, Pack>>(q.l).trace();
      sum[1] += m * p_before / (rho * rho) * (rate - from_flow) * in.dt;
      rho += in.dt * rate;
      a.store(q.rho, rho);
    }
    const auto energy = [&](std::size_t lane) { return eos.energy(rho[lane], rho0[lane]); };
    if (in.rho_s > 0) {  // swelling
      const Pack before = Pack::lane_by_lane(energy);
      rho0 = a.load(q.dilation_state) * in.rho_s;
      a.store(q.rho0, rho0);
      sum[3] += m * (Pack::lane_by_lane(energy) - before);
    }
    const Pack p = eos.pressure(rho, rho0);
    a.store(q.p, p);
    const Mask torn = (p_before < Pack(0)) & (p == Pack(0)) & (rho < rho0);
    if (any(torn))
      sum[2] += m * Pack::lane_by_lane(
                        [&](std::size_t lane) { return torn[lane] ? eos.energy_in_tension(rho0[lane]) : 0; });
    // Before the first step there is no increment of strain: an elastic stress is what it was.
    if (elastic && in.dt == 0) return;
    const Dissipation lost = update_stress(q, a, stress, law, dilation, in);
    const Pack volume = m / rho;
    sum[0] += volume * lost.sheared;
    sum[2] += volume * lost.cut_off;
  });
  return {sums[0].sum(), sums[1].sum(), sums[2].sum(), sums[3].sum()};
}

}  // namespace dem2sph
