// The figures of the report, each as an SVG that can stand in a page.
#pragma once

#include <string>
#include <vector>

#include "calibration/report.hpp"

namespace dem2sph {

/// What the page needs of a flow's summary.json, checked.
struct FlowSummary {
  std::string label;
  std::vector<double> time, front, centre_height, kinetic_energy, max_speed;
  struct Profile {
    double time = 0;
    std::vector<double> x, height;
  };
  std::vector<Profile> profiles;
  double wall_seconds = 0, cpu_seconds = 0, particles = 0, steps = 0, particle_steps_per_second = 0;
  double L0 = 0, H0 = 0;
  std::string formulation;
  std::vector<std::string> composition;
};
/// Throws InputError naming the file and the part that is missing or of another kind.
FlowSummary read_flow_summary(const ReportFlow& flow);

/// A published law, drawn as a thin line beside ours.
struct ReferenceLaw {
  std::string label;    ///< in the legend
  std::string caption;  ///< the source, for the caption
  RationalFriction<double> friction;
  LinearSolidFraction<double> solid_fraction;
};
/// Glass beads on an incline: friction from Jop, Forterre and Pouliquen, Nature 441, 727-730 (2006), read
/// there; solid fraction phi = 0.6 - 0.2 I from Pouliquen et al., J. Stat. Mech. P07020 (2006), as widely
/// quoted.
ReferenceLaw glass_beads_2006();

std::string figure_friction(const Fit& fit);
std::string figure_solid_fraction(const Fit& fit);
/// Residuals of both steady fits against I, p, phi and the order in which the runs are listed.
std::string figure_residuals(const Fit& fit);
/// The rise of chi2 along the profile of each parameter, in its standard errors.
std::string figure_likelihoods(const Fit& fit);
/// Each run, or, with checks, the mean of each group of twins.
std::string figure_transient_phi(const Fit& fit);
std::string figure_transient_beta(const Fit& fit);
std::string figure_transient_mu(const Fit& fit);
/// `index` makes the ids in the page unique; the axes end at `x_max`, `y_max` in units of L0.
std::string figure_profiles(const FlowSummary& flow, std::size_t index, double x_max, double y_max);
std::string figure_deposits(const std::vector<FlowSummary>& flows);
std::string figure_front(const std::vector<FlowSummary>& flows);
std::string figure_height(const std::vector<FlowSummary>& flows);

/// Parts of gnuplot scripts in the report's style: the style itself, the k-th colour, a text in quotes, a
/// named block of data, rows of two columns.
std::string plot_style();
const char* plot_colour(std::size_t k);
std::string plot_quoted(const std::string& text);
std::string plot_block(const std::string& name, const std::string& rows);
std::string plot_rows(const std::vector<double>& x, const std::vector<double>& y);

/// Runs a gnuplot script that plots to the terminal it is given, and returns the SVG without prologue, with
/// ids that start with `name`. Throws an Error if gnuplot is missing (exit
/// code 2), and one with gnuplot's own words if it refuses (1).
std::string render_svg(const std::string& name, const std::string& script, int width, int height);

}  // namespace dem2sph
