// What one particle does with its velocity gradient: density, pressure, dilation, stress. No pairs here.
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

  double in_law(double I) const {
    if (!clamp) return I;
    return I < range.lowest ? range.lowest : I > range.highest ? range.highest : I;  // NaN stays
  }
};

/// mu p + c with a mu that is never below zero; NaN stays.
inline double strength_of(double mu, double p, double cohesion) {
  const double strength = (mu < 0 ? 0 : mu) * p + cohesion;
  return strength < 0 ? 0 : strength;
}

/// Strength in tension, down to the tensile strength: mu(I) has no meaning there, and mu at rest stands for
/// it.
template <class Law>
double strength_in_tension(const Law& law, double p, double cohesion) {
  const double strength = steady_friction(law, 0.0, 0.0) * p + cohesion;
  return strength < 0 ? 0 : strength;
}

/// Energy that leaves with one particle's stress [J/m^3]: by shear, and by a cut-off.
struct Dissipation {
  double sheared = 0;
  double cut_off = 0;
};

/// Stress of one particle at pressure p from its velocity gradient. Writes stress, gamma_dot and what
/// dilation keeps.
template <int Dim, class Stress, class Law, class Dilation>
Dissipation update_stress(Particles<Dim>& q, std::size_t a, const Stress& stress, const Law& law,
                          const Dilation& dilation, const StateInput& in) {
  constexpr bool elastic = std::is_same_v<Stress, ElasticReturn>;
  const double p = q.p[a];
  const Gradient<Dim> l = Particles<Dim>::load(q.l, a);
  Sym<Dim> rate = deviator(strain_rate(l));
  const double total_rate = shear_rate(rate);
  const auto keep_beta = [&](double beta) {
    if constexpr (!std::is_same_v<Dilation, NoDilation>) q.beta[a] = beta;
    return beta;
  };
  // Without pressure separated grains carry no stress, unless something holds them together (p < 0 is only
  // reached within the tensile strength). A NaN of p goes on and shows.
  if (p <= 0 && !(p < 0 && in.cohesion > 0)) {
    double lost = 0;
    if constexpr (elastic) lost = q.deviator(a).square() / (4 * stress.G);
    q.set_deviator(a, Sym<Dim>{});
    q.gamma_dot[a] = total_rate;
    keep_beta(0);
    return {0, lost};
  }

  const double to_I = in.grains.d / std::sqrt(p / in.grains.rho_s);
  // How strong the particle is at the shear rate g, and what its state of dilation then is.
  const auto evolved = [&](double g) {
    if constexpr (has_dilation_state<Dilation>)
      return dilation.law.after({q.dilation_state[a], q.dilation_I[a]}, in.in_law(g * to_I), g * in.dt);
    else
      return 0;
  };
  double frozen_beta = 0;
  if constexpr (std::is_same_v<Dilation, DilationFromField>)
    frozen_beta = direct_dilation(l.trace(), total_rate, dilation.limits);
  const auto beta_at = [&](double g) {
    if constexpr (has_dilation_state<Dilation>)
      return evolved(g).beta;
    else
      return frozen_beta;
  };
  const auto strength = [&](double g) {
    if (p < 0) return strength_in_tension(law, p, in.cohesion);
    return strength_of(steady_friction(law, in.in_law(g * to_I), g) + beta_at(g), p, in.cohesion);
  };
  const auto finish = [&](double g) {  // the state at the end of the increment
    if (p < 0) {
      keep_beta(0);
    } else if constexpr (has_dilation_state<Dilation>) {
      const auto end = evolved(g);
      q.dilation_state[a] = end.state.value;
      q.dilation_I[a] = end.state.I;
      q.beta[a] = end.beta;
    } else {
      keep_beta(frozen_beta);
    }
  };

  if constexpr (elastic) {
    Sym<Dim> s = rotate(q.deviator(a), l, in.dt);
    for (int k = 0; k < Sym<Dim>::size; ++k) s[k] += 2 * stress.G * in.dt * rate[k];
    const double trial = equivalent_stress(s);
    const double G_dt = stress.G * in.dt;
    const Returned returned = has_dilation_state<Dilation> || p < 0 || in.clamp
                                  ? return_by_newton(trial, G_dt, strength)
                                  : return_to_yield(law, in.grains, trial, p, G_dt, frozen_beta, in.cohesion);
    double dissipated = 0;
    if (!(returned.gamma_dot == 0)) {
      if (trial > 0) s *= returned.tau / trial;
      // The momentum balance works with the stress after the return, so this is what plastic shear takes of
      // its work.
      dissipated = returned.tau * returned.gamma_dot * in.dt;
    }
    q.set_deviator(a, s);
    q.gamma_dot[a] = returned.gamma_dot;
    finish(returned.gamma_dot);
    return {dissipated, 0};
  } else {
    const double least = stress.gamma_dot_min;
    const double eta =
        strength(total_rate) / (total_rate < least ? least : total_rate);  // a NaN rate stays one
    rate *= 2 * eta;
    q.set_deviator(a, rate);
    q.gamma_dot[a] = total_rate;
    finish(total_rate);
    return {eta * total_rate * total_rate * in.dt, 0};
  }
}

/// Density where it follows a continuity equation, pressure and stress of the particles [begin, end).
template <int Dim, class Stress, class Law, class Dilation>
StateSums state_pass(Particles<Dim>& q, std::size_t begin, std::size_t end, const EquationOfState& eos,
                     const Stress& stress, const Law& law, const Dilation& dilation, const StateInput& in) {
  constexpr bool elastic = std::is_same_v<Stress, ElasticReturn>;
  const bool own_rho0 = !q.rho0.empty();
  const bool continuity = !q.rho_rate.empty();
  const auto sums = sum_over<4>(begin, end, [&](std::size_t a, std::array<double, 4>& sum) {
    if (continuity) {
      const double from_flow = -q.rho[a] * Particles<Dim>::load(q.l, a).trace();
      sum[1] += q.m[a] * q.p[a] / (q.rho[a] * q.rho[a]) * (q.rho_rate[a] - from_flow) * in.dt;
      q.rho[a] += in.dt * q.rho_rate[a];
    }
    if (in.rho_s > 0) {  // swelling
      const double before = eos.energy(q.rho[a], q.rho0[a]);
      q.rho0[a] = q.dilation_state[a] * in.rho_s;
      sum[3] += q.m[a] * (eos.energy(q.rho[a], q.rho0[a]) - before);
    }
    const double rho0 = own_rho0 ? q.rho0[a] : eos.rho0;
    const bool pulled = q.p[a] < 0;
    q.p[a] = eos.pressure(q.rho[a], rho0);
    if (pulled && q.p[a] == 0 && q.rho[a] < rho0) sum[2] += q.m[a] * eos.energy_in_tension(rho0);
    // Before the first step there is no increment of strain: an elastic stress is what it was.
    if (elastic && in.dt == 0) return;
    const Dissipation d = update_stress(q, a, stress, law, dilation, in);
    const double volume = q.m[a] / q.rho[a];
    sum[0] += volume * d.sheared;
    sum[2] += volume * d.cut_off;
  });
  return {sums[0], sums[1], sums[2], sums[3]};
}

}  // namespace dem2sph
