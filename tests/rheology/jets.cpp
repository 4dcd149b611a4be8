// The only file of these tests that sees Ceres.
#include "tests/rheology/jets.hpp"

#include <ceres/jet.h>

#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph::test {
namespace {

template <int N>
Differentiated<N> plain(const ceres::Jet<double, N>& jet) {
  Differentiated<N> result{jet.a, {}};
  for (int i = 0; i < N; ++i) result.derivative[static_cast<std::size_t>(i)] = jet.v[i];
  return result;
}

}  // namespace

Differentiated<5> friction_by_jet(double I, double mu_l, double mu_h, double D_star, double beta) {
  using Jet = ceres::Jet<double, 5>;
  const RationalFriction<Jet> law{Jet(mu_l, 1), Jet(mu_h, 2), Jet(D_star, 3)};
  return plain<5>(friction(law, Jet(I, 0), Jet(beta, 4)));
}

double slope_by_jet(double I, double mu_l, double mu_h, double D_star) {
  using Jet = ceres::Jet<double, 1>;
  const RationalFriction<Jet> law{Jet(mu_l), Jet(mu_h), Jet(D_star)};
  return law.slope(I).a;  // a rate that is data, not a parameter: a plain double among Jets
}

Differentiated<2> inertial_number_by_jet(double gamma_dot, double p, double d, double rho_s) {
  using Jet = ceres::Jet<double, 2>;
  return plain<2>(inertial_number(Jet(gamma_dot, 0), Jet(p, 1), d, rho_s));
}

Differentiated<3> solid_fraction_by_jet(double I, double phi_c, double b) {
  using Jet = ceres::Jet<double, 3>;
  const LinearSolidFraction<Jet> law{Jet(phi_c, 1), Jet(b, 2)};
  return plain<3>(law(Jet(I, 0)));
}

Differentiated<3> relax_solid_fraction_by_jet(double phi, double phi_eq, double x) {
  using Jet = ceres::Jet<double, 3>;
  return plain<3>(relax_solid_fraction(Jet(phi, 0), Jet(phi_eq, 1), Jet(x, 2)));
}

Differentiated<4> relax_dilation_rate_by_jet(double beta, double source, double s_star, double ds) {
  using Jet = ceres::Jet<double, 4>;
  return plain<4>(relax_dilation_rate(Jet(beta, 0), Jet(source, 1), Jet(s_star, 2), Jet(ds, 3)));
}

Differentiated<4> relax_solid_fraction_ramp_by_jet(double phi, double phi_eq_0, double phi_eq_1, double x) {
  using Jet = ceres::Jet<double, 4>;
  return plain<4>(relax_solid_fraction_ramp(Jet(phi, 0), Jet(phi_eq_0, 1), Jet(phi_eq_1, 2), Jet(x, 3)));
}

Differentiated<2> constant_friction_by_jet(double I, double mu) {
  using Jet = ceres::Jet<double, 2>;
  return plain<2>(steady_friction(ConstantFriction<Jet>{Jet(mu, 1)}, Jet(I, 0), Jet(0.0)));
}

Differentiated<4> rational_rate_friction_by_jet(double gamma_dot, double mu_l, double mu_h, double D_star) {
  using Jet = ceres::Jet<double, 4>;
  const RationalRateFriction<Jet> law{Jet(mu_l, 1), Jet(mu_h, 2), Jet(D_star, 3)};
  return plain<4>(steady_friction(law, Jet(0.0), Jet(gamma_dot, 0)));
}

Differentiated<6> barker_gray_by_jet(double I, const std::array<double, 5>& p, double I_N) {
  using Jet = ceres::Jet<double, 6>;
  const BarkerGray2017<Jet> law(Jet(p[0], 1), Jet(p[1], 2), Jet(p[2], 3), Jet(p[3], 4), Jet(p[4], 5), I_N);
  return plain<6>(steady_friction(law, Jet(I, 0), Jet(0.0)));
}

namespace {

template <template <class> class Law, int N>
std::array<ceres::Jet<double, N>, N - 1> jets_of(const std::vector<double>& parameters) {
  std::array<ceres::Jet<double, N>, N - 1> jets;
  for (int k = 1; k < N; ++k)
    jets[static_cast<std::size_t>(k - 1)] =
        ceres::Jet<double, N>(parameters[static_cast<std::size_t>(k - 1)], k);
  return jets;
}

template <int N>
MemberByJet taken_apart(const ceres::Jet<double, N>& jet) {
  MemberByJet result{jet.a, jet.v[0], {}};
  for (int k = 1; k < N; ++k) result.by_parameter.push_back(jet.v[k]);
  return result;
}

template <template <class> class Law>
MemberByJet friction_member(const Law<double>& law, const std::vector<double>& parameters, double rate) {
  constexpr int N = static_cast<int>(Law<double>::parameters.size()) + 1;
  using Jet = ceres::Jet<double, N>;
  const auto p = jets_of<Law, N>(parameters);
  const Jet x(rate, 0);
  if constexpr (std::is_same_v<Law<double>, BarkerGray2017<double>>)
    return taken_apart<N>(BarkerGray2017<Jet>(p[0], p[1], p[2], p[3], p[4], law.I_N)(x));
  else if constexpr (Law<double>::of_rate)
    return taken_apart<N>(make_law<Law<Jet>>(p)(Jet(0.0), x));
  else
    return taken_apart<N>(make_law<Law<Jet>>(p)(x));
}

template <template <class> class Law>
MemberByJet solid_fraction_member(const Law<double>&, const std::vector<double>& parameters, double I) {
  constexpr int N = static_cast<int>(Law<double>::parameters.size()) + 1;
  using Jet = ceres::Jet<double, N>;
  return taken_apart<N>(make_law<Law<Jet>>(jets_of<Law, N>(parameters))(Jet(I, 0)));
}

}  // namespace

MemberByJet member_by_jet(const FrictionLaw& law, const std::vector<double>& parameters, double rate) {
  return std::visit([&](const auto& member) { return friction_member(member, parameters, rate); }, law);
}
MemberByJet member_by_jet(const SteadySolidFraction& law, const std::vector<double>& parameters, double I) {
  return std::visit([&](const auto& member) { return solid_fraction_member(member, parameters, I); },
                    law.law);
}

}  // namespace dem2sph::test
