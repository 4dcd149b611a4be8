// The matrix of `dem2sph stability`: which extremes, each as a small case file and what must hold at its end.
#pragma once

#include <string>
#include <vector>

#include "sph/base/law_file.hpp"

namespace dem2sph {

/// What a cell that ends without a warning must show. Anything else is a silent wrong answer.
enum class Oracle {
  budgets,    ///< numbers stay finite, energy and mass are accounted for: what every cell is asked
  rest,       ///< nothing moves faster than 1 % of sqrt(gH) at the end
  mu_of_I,    ///< mu of the particles is that of the law at their I, within 5 %, and the core has the shear
              ///< rate set
  evenness,   ///< budgets; measures vertical over downhill motion, which an uneven flow has
  flight,     ///< the mean velocity is that of free flight, to 1e-6
  same_front  ///< front_99 is within 3 % of that of the other cells of its axis that ask for it
};

struct StabilityCell {
  std::string axis;              ///< "sound_speed"
  std::string value;             ///< "10 sqrt(gH)"
  std::string text;              ///< of the case file, without [law]
  std::vector<std::string> set;  ///< as given to --set, after the case's own
  Oracle oracle = Oracle::budgets;
  double work = 1;  ///< expected core-seconds: the longest are run first
};

/// Sizes that the scenes of the matrix share, from the grains of the case.
struct StabilityScale {
  double d = 0;      ///< [m]
  double rho_s = 0;  ///< [kg/m^3]
  double rho0 = 0;   ///< [kg/m^3]
  double g = 9.81;   ///< [m/s^2]
  long rows = 12;    ///< particles over the height H
  double height() const { return 20 * d; }
  double speed() const;  ///< sqrt(g H)
  double time() const;   ///< sqrt(H/g)
};

/// Axes of the solver's matrix; `every_axis` stands for all of them.
inline constexpr const char* every_axis = "all";
inline const std::vector<std::string> stability_axes{
    "sound_speed",   "step_factor", "ingredient",  "inertial_number", "friction", "dilation", "cohesion",
    "ill_posed_law", "no_pressure", "drop",        "aspect_ratio",    "thin_bed", "spacing",  "slope",
    "long_rest",     "moving_wall", "cyclic_shear"};

/// Cells of the solver, of one axis or of every one.
std::vector<StabilityCell> stability_cells(const StabilityScale& scale, const std::string& axis);

/// One shear cell of the DEM side.
struct GrainCell {
  std::string axis;
  std::string value;
  std::vector<std::string> set;
};
std::vector<GrainCell> grain_cells();
/// The case file that they change.
std::string grain_cell_case(const LawFile& law);

}  // namespace dem2sph
