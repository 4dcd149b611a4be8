// The laws with Ceres' Jets, kept behind plain numbers: value and derivatives as the fit sees them.
#pragma once

#include <array>
#include <vector>

#include "sph/rheology/dilation.hpp"
#include "sph/rheology/friction.hpp"

namespace dem2sph::test {

/// Derivatives in the order of the arguments.
template <int N>
struct Differentiated {
  double value = 0;
  std::array<double, static_cast<std::size_t>(N)> derivative{};
};

/// mu(I, beta): derivatives by I, mu_l, mu_h, D*, beta.
Differentiated<5> friction_by_jet(double I, double mu_l, double mu_h, double D_star, double beta);
/// d(mu)/dI as the law states it, evaluated with Jets; value only.
double slope_by_jet(double I, double mu_l, double mu_h, double D_star);
/// I(gamma_dot, p): derivatives by both.
Differentiated<2> inertial_number_by_jet(double gamma_dot, double p, double d, double rho_s);
/// phi_eq(I): derivatives by I, phi_c, b.
Differentiated<3> solid_fraction_by_jet(double I, double phi_c, double b);
/// phi after the increment x = ds/s*: derivatives by phi, phi_eq, x.
Differentiated<3> relax_solid_fraction_by_jet(double phi, double phi_eq, double x);
/// beta after ds: derivatives by beta, source, s*, ds.
Differentiated<4> relax_dilation_rate_by_jet(double beta, double source, double s_star, double ds);

/// phi after an increment with phi_eq linear: derivatives by phi, phi_eq_0, phi_eq_1, x.
Differentiated<4> relax_solid_fraction_ramp_by_jet(double phi, double phi_eq_0, double phi_eq_1, double x);
/// A member of a family, made and evaluated with Jets: its value, the derivative by I (of a law of the rate:
/// by gamma_dot), and those by its parameters in order.
struct MemberByJet {
  double value = 0, by_rate = 0;
  std::vector<double> by_parameter;
};
MemberByJet member_by_jet(const FrictionLaw& law, const std::vector<double>& parameters, double rate);
MemberByJet member_by_jet(const SteadySolidFraction& law, const std::vector<double>& parameters, double I);

/// The members of the family of friction laws, by steady_friction: derivatives by I or gamma_dot, then by the
/// parameters in their order (of Barker and Gray's law at fixed I_N).
Differentiated<2> constant_friction_by_jet(double I, double mu);
Differentiated<4> rational_rate_friction_by_jet(double gamma_dot, double mu_l, double mu_h, double D_star);
Differentiated<6> barker_gray_by_jet(double I, const std::array<double, 5>& parameters, double I_N);

}  // namespace dem2sph::test
