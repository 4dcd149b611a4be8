#include "sph/scene.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <stdexcept>
#include <variant>

#include "sph/base/errors.hpp"
#include "sph/material.hpp"
#include "sph/rheology/bagnold.hpp"

namespace dem2sph {
namespace {

Parameter word(const char* name, const char* fallback, const char* sentence, std::vector<std::string> words) {
  return {name, Kind::word, "", 0, 0, fallback, sentence, std::move(words)};
}

const ParameterTable flow_table{
    "flow",
    "The continuum flow.",
    {
        word("scene", "required", "Which scene: its section holds its sizes.",
             {"column_collapse", "inclined_plane", "plane_shear", "heap", "geometry"}),
        word("formulation", "robust",
             "Set of ingredients (sph/README.md); each can be chosen by itself below.", {"robust", "source"}),
        {"dimension", Kind::integer, "", 2, 3, "2", "2 is plane strain."},
        {"resolution", Kind::integer, "", 1, 100000, "40", "Particles over the height H of the scene."},

        word("kernel", "unset", "Smoothing kernel; unset: that of the formulation.",
             {"cubic_spline", "wendland_c2", "wendland_c4"}),
        {"h_over_dx", Kind::number, "", 1.0, 3.0, "unset",
         "Smoothing length over spacing; unset: 1.2 in source, 1.5 in robust."},
        word("density", "unset", "How density is found; unset: as in the formulation.",
             names_of<DensityPart>()),
        {"density_diffusion", Kind::number, "", 0, 1, "0.1", "delta of the density diffusion."},
        word("walls", "unset", "How walls act; unset: as in the formulation.", names_of<WallPart>()),
        {"B_max", Kind::number, "", 1, 10, "1.5", "Largest factor of Eq. 5.24 (boundary particles)."},
        {"boundary_density_factor", Kind::number, "", 0.8, 1, "0.97",
         "rho0 of boundary particles over their initial density."},
        {"wall_stress_share", Kind::number, "", 0, 1, "0.5",
         "Partial slip: share of the material's average in the stress of a boundary particle; 0 is the "
         "source."},
        {"basal_friction", Kind::number, "", 0, 3, "unset",
         "mu_b of the scene's rough walls, in place of mu(I) in the pairs of material and wall."},
        word("stress", "unset", "How stress follows from the rate; unset: as in the formulation.",
             names_of<StressPart>()),
        {"shear_modulus", Kind::number, "", 0.01, 1.5, "0.4", "G over K of the elastic predictor."},
        {"g_min", Kind::quantity, "1/s", 1e-9, 1e6, "0.1 1/s",
         "Least shear rate in the viscosity of direct stress."},
        word("damping", "unset", "Acoustic damping; unset: that of the formulation.",
             names_of<DampingPart>()),
        {"artificial_viscosity", Kind::number, "", 0, 2, "0.1", "alpha of the damping."},
        word("gradient_correction", "none", "Gradients that are exact for linear fields.",
             names_of<CorrectionPart>()),
        word("velocity_averaging", "none", "Whether particles move with an averaged velocity.",
             names_of<AveragingPart>()),
        {"averaging_epsilon", Kind::number, "", 0, 1, "0.5", "Strength of the velocity averaging."},
        word("shifting", "none", "Whether particles are shifted towards even spacing.",
             names_of<ShiftingPart>()),

        word("dilation", "none", "Whether and how beta enters mu (Eqs. 5.13 and 5.22).",
             names_of<DilationPart>()),
        {"beta_lowest", Kind::number, "", -10, 0, "unset",
         "Least beta that enters mu; unset: 0 with direct, -0.5 if it evolves."},
        {"beta_highest", Kind::number, "", 0, 10, "0.5", "Largest beta that enters mu."},
        {"beta_share", Kind::number, "", 0, 5, "unset",
         "Share of beta that enters mu; unset: that of the law, 1 (Eq. 5.7) if it has none."},
        {"swelling", Kind::flag, "", 0, 0, "false",
         "Whether rho0 follows phi, so that material that dilates takes more room."},
        {"initial_solid_fraction", Kind::number, "", 0.3, 0.74, "unset",
         "Solid fraction at t = 0; unset: phi_c of the law."},
        word("extrapolate", "warn",
             "Where I is outside the data of the law file. warn: go on, count it in summary.json; clamp: the "
             "laws "
             "take the nearest I with data, count too; error: stop once more than extrapolate_limit of the "
             "flowing mass is above the data.",
             {"warn", "clamp", "error"}),
        {"extrapolate_limit", Kind::number, "", 0, 1, "0.05", "Share of the flowing mass, with error."},
        {"cohesion", Kind::quantity, "Pa", 0, 1e9, "0 Pa", "Cohesion c of Eq. 5.3."},
        {"tensile_strength", Kind::quantity, "Pa", 0, 1e9, "0 Pa",
         "Tension that the material bears before it comes apart; at most cohesion over the friction at "
         "rest."},

        {"gravity", Kind::quantity, "m/s^2", 0, 1000, "9.81 m/s^2", "Acceleration of gravity."},
        {"mach", Kind::number, "", 1e-4, 0.3, "unset",
         "The scene's velocity scale over the speed of sound; 0.1 if neither this nor sound_speed is given."},
        {"sound_speed", Kind::quantity, "m/s", 1e-6, 1e5, "unset",
         "Speed of sound sqrt(K/rho0), instead of mach."},
        {"eos_exponent", Kind::number, "", 1, 7, "1", "gamma of Eq. 5.5; 1 is linear."},
        {"step_factor", Kind::number, "", 1e-4, 4, "1", "On all bounds of Eq. 5.28."},
        {"end_time", Kind::quantity, "s", 0, 1e9, "unset", "Unset: 10 sqrt(H/g) after a collapse."},
        {"stop_at_rest", Kind::flag, "", 0, 0, "true",
         "End when the kinetic energy falls below 1e-4 of the initial potential energy (collapse)."},
        {"frames", Kind::integer, "", 1, 100000, "20",
         "Frames written after the first, evenly spaced in time."},
    }};

const ParameterTable column_table{
    "column",
    "A column on a rough floor against a frictionless back wall at x = 0, let go at t = 0.",
    {
        {"length", Kind::quantity, "m", 1e-6, 1e5, "required",
         "L0: extent in x, or the radius of a cylinder."},
        {"aspect_ratio", Kind::number, "", 0.05, 50, "1", "a = H0/L0."},
        word("shape", "slab", "A slab, or a cylinder (3D): a quarter of it between two frictionless walls.",
             {"slab", "cylinder"}),
        {"floor_length", Kind::quantity, "m", 1e-6, 1e6, "unset", "Unset: L0 (2 + 3 max(a, a^(2/3)))."},
        {"width", Kind::quantity, "m", 1e-6, 1e5, "unset",
         "Periodic extent across, of a slab in 3D; unset: 12 particles."},
    }};

const ParameterTable incline_table{
    "incline",
    "A bed on a rough incline, periodic along it; 0 deg is a bed at rest.",
    {
        {"height", Kind::quantity, "m", 1e-6, 1e5, "required", "H: depth of the bed, normal to the incline."},
        {"angle", Kind::quantity, "rad", 0, 1.57, "required", "Slope, for example \"25 deg\"."},
        {"length", Kind::quantity, "m", 1e-6, 1e5, "unset", "Periodic extent; unset: 16 particles."},
        {"width", Kind::quantity, "m", 1e-6, 1e5, "unset",
         "Periodic extent across, in 3D; unset: 12 particles."},
        word("start", "rest", "Velocity at t = 0: none, or the exact steady profile.", {"rest", "bagnold"}),
    }};

const ParameterTable shear_table{
    "shear",
    "Plane shear without gravity between two rough walls that move against each other, at constant volume.",
    {
        {"height", Kind::quantity, "m", 1e-6, 1e5, "required", "H: distance of the walls."},
        {"shear_rate", Kind::quantity, "1/s", 1e-9, 1e6, "required",
         "Speed of the walls against each other over H."},
        {"pressure", Kind::quantity, "Pa", 1e-6, 1e9, "required", "Pressure at t = 0."},
        {"length", Kind::quantity, "m", 1e-6, 1e5, "unset", "Periodic extent; unset: 16 particles."},
        {"width", Kind::quantity, "m", 1e-6, 1e5, "unset",
         "Periodic extent across, in 3D; unset: 12 particles."},
    }};

const ParameterTable heap_table{
    "heap",
    "Half of a heap on a rough floor against a frictionless wall at x = 0.",
    {
        {"height", Kind::quantity, "m", 1e-6, 1e5, "required", "H: height at x = 0."},
        {"angle", Kind::quantity, "rad", 0.01, 1.5, "required", "Slope of its surface."},
        {"floor_length", Kind::quantity, "m", 1e-6, 1e6, "unset", "Unset: 1.5 H/tan(angle)."},
    }};

const ParameterTable law_table{
    "law",
    "A material law given by hand, instead of a law file.",
    {
        {"d", Kind::quantity, "m", 1e-9, 10, "required", "Mean grain diameter."},
        {"rho_s", Kind::quantity, "kg/m^3", 1, 1e5, "required", "Density of the grains' material."},
        word("friction", "rational", "The friction law.",
             {"rational", "exponential", "power", "linear", "constant", "barker_gray_2017"}),
        {"mu", Kind::number, "", 0, 3, "unset", "constant: its friction."},
        {"mu_l", Kind::number, "", 0, 3, "unset",
         "rational, exponential, power, linear: friction at I -> 0."},
        {"mu_h", Kind::number, "", 0, 3, "unset", "rational, exponential: friction at I -> infinity."},
        {"D_star", Kind::number_or_quantity, "1/s", 1e-9, 1e6, "unset",
         "rational: I at which half of the range is reached; with the unit 1/s it is a shear rate instead. "
         "exponential: I at which 63 % are."},
        {"a", Kind::number, "", 0, 100, "unset", "power: mu = mu_l + a I^n."},
        {"n", Kind::number, "", 0.01, 4, "unset", "power: exponent of I."},
        {"rise", Kind::number, "", 0, 100, "unset", "linear: mu = mu_l + rise I."},
        {"mu_s", Kind::number, "", 1e-6, 3, "unset",
         "barker_gray_2017: friction at I -> 0 of the upper branch."},
        {"mu_2", Kind::number, "", 1e-6, 3, "unset", "barker_gray_2017: friction that mu(I) would tend to."},
        {"I_0", Kind::number, "", 1e-9, 1e3, "unset", "barker_gray_2017: scale of I."},
        {"mu_inf", Kind::number, "", 0, 3, "0.05", "barker_gray_2017: slope of mu at large I."},
        {"alpha", Kind::number, "", 1e-3, 1e3, "1.9", "barker_gray_2017: of the creep branch."},
        {"phi_c", Kind::number, "", 0.1, 0.9, "required", "Solid fraction at I -> 0."},
        {"b", Kind::number, "", 0, 10, "unset", "Slope of the solid fraction, phi_eq = phi_c - b I."},
        {"s_star", Kind::number, "", 1e-6, 1e6, "unset", "Strain over which phi relaxes."},
        {"s_star_compacting", Kind::number, "", 1e-6, 1e6, "unset",
         "Another one where phi is below phi_eq; unset: the same (dilation = \"evolve\")."},
        {"gain", Kind::number, "", -10, 10, "unset",
         "A: gain of the source of Eq. 5.22 as it is printed; unset: 1 (dilation = \"evolve_printed\")."},
    }};

FittedParameter given(const char* name, double value, const char* unit = "1") {
  return {name, value, 0, unit, false};
}

// Numbers of particles on a lattice of spacing dx that fills a length, at least one.
std::size_t count(double length, double dx) {
  return static_cast<std::size_t>(std::max(1L, std::lround(length / dx)));
}

template <int Dim>
Vec<Dim> at(double x, double across, double up) {
  Vec<Dim> v;
  v[0] = x;
  if constexpr (Dim == 3) v[1] = across;
  v[Dim - 1] = up;
  return v;
}

template <int Dim>
Wall<Dim> plane(const char* name, const Vec<Dim>& normal, bool rough) {
  Wall<Dim> wall;
  wall.name = name;
  wall.direction = normal;
  wall.rough = rough;
  return wall;
}

template <int Dim>
Body<Dim> body(typename Body<Dim>::Shape shape, const Vec<Dim>& low, const Vec<Dim>& high) {
  Body<Dim> result;
  result.name = "material";
  result.shape = shape;
  result.low = low;
  result.high = high;
  return result;
}

/// What a scene contributes; the rest of the set-up is the same for all.
template <int Dim>
struct Scene {
  Geometry<Dim> geometry;
  double height = 0;          ///< H, which `resolution` divides [m]
  double angle = 0;           ///< of gravity against -up, towards +x [rad]
  double velocity_scale = 0;  ///< beside sqrt(g H) [m/s]
  double base_pressure = 0;   ///< in addition to the weight of what lies above [Pa]
  bool shear_start = false;   ///< starts with the linear profile of plane shear
  double shear_rate = 0;
  bool bagnold_start = false;
};

/// Lengths in whole numbers of particles, and what limits them.
struct Lattice {
  double dx = 0;
  long rows = 0;    ///< over the height
  long layers = 0;  ///< of walls
  double length(long n) const { return dx * static_cast<double>(n); }
  /// A periodic extent: as many particles as asked, or `usual`; never so few that a particle meets itself.
  double periodic(const Section& sizes, const char* key, long usual) const {
    const double wanted = sizes.quantity(key);
    const long least = 3 * layers + 3;
    const long n = std::isnan(wanted) ? std::max(usual, least) : static_cast<long>(count(wanted, dx));
    if (n < least)
      sizes.refuse(key, fmt::format("\"{}\" must hold at least {} particles at this resolution", key, least));
    return length(n);
  }
};

/// Sets the extent across in 3D: periodic.
template <int Dim>
void make_periodic_across(Geometry<Dim>& g, const Section& sizes, const Lattice& lattice) {
  if constexpr (Dim == 3) {
    g.high[1] = lattice.periodic(sizes, "width", 12);
    g.periodic[1] = true;
    for (Body<Dim>& b : g.bodies) b.high[1] = g.high[1];
  }
}

template <int Dim>
Scene<Dim> column_scene(const Section& sizes, const Lattice& lattice, FlowSetup<Dim>& setup) {
  Scene<Dim> scene;
  Geometry<Dim>& g = scene.geometry;
  const double a = sizes.number("aspect_ratio");
  const double length = sizes.quantity("length");
  const bool cylinder = sizes.word("shape") == "cylinder";
  if (cylinder && Dim == 2) sizes.refuse("shape", "a cylinder needs flow.dimension = 3");
  setup.axisymmetric = cylinder;
  const double L0 = lattice.length(static_cast<long>(count(length, lattice.dx)));
  setup.initial_length = cylinder ? length : L0;
  const double floor = sizes.given("floor_length") ? sizes.quantity("floor_length")
                                                   : length * (2 + 3 * std::max(a, std::pow(a, 2.0 / 3)));
  if (floor < length) sizes.refuse("floor_length", "\"floor_length\" must reach beyond the column");
  const double top = lattice.length(lattice.rows);
  // Walls reach `layers` beyond the domain.
  const double end = lattice.length(static_cast<long>(count(floor, lattice.dx)) - lattice.layers);
  if (end < setup.initial_length)
    sizes.refuse("floor_length",
                 "\"floor_length\" must reach beyond the column by more than the walls' layers");
  setup.floor_end = end;
  g.high = at<Dim>(end, cylinder ? end : 0, top + lattice.length(lattice.layers));
  g.walls = {plane<Dim>("floor", at<Dim>(0, 0, 1), true), plane<Dim>("back wall", at<Dim>(1, 0, 0), false)};
  if (cylinder) {
    if constexpr (Dim == 3) {
      g.walls.push_back(plane<Dim>("side wall", at<Dim>(0, 1, 0), false));
      g.bodies = {body<Dim>(Body<Dim>::Shape::cylinder, Vec<Dim>{}, at<Dim>(0, 0, top))};
      g.bodies[0].radius = length;
    }
  } else {
    g.bodies = {body<Dim>(Body<Dim>::Shape::box, Vec<Dim>{}, at<Dim>(L0, 0, top))};
    make_periodic_across(g, sizes, lattice);
  }
  return scene;
}

template <int Dim>
Scene<Dim> incline_scene(const Section& sizes, const Lattice& lattice) {
  Scene<Dim> scene;
  Geometry<Dim>& g = scene.geometry;
  scene.angle = sizes.quantity("angle");
  scene.bagnold_start = sizes.word("start") == "bagnold";
  g.high = at<Dim>(lattice.periodic(sizes, "length", 16), 0, lattice.length(lattice.rows));
  g.periodic[0] = true;
  g.walls = {plane<Dim>("floor", at<Dim>(0, 0, 1), true)};
  g.bodies = {body<Dim>(Body<Dim>::Shape::box, g.low, g.high)};
  make_periodic_across(g, sizes, lattice);
  return scene;
}

template <int Dim>
Scene<Dim> shear_scene(const Section& sizes, const Lattice& lattice, double bulk_density) {
  Scene<Dim> scene;
  Geometry<Dim>& g = scene.geometry;
  const double H = lattice.length(lattice.rows);
  scene.shear_start = true;
  scene.shear_rate = sizes.quantity("shear_rate");
  scene.base_pressure = sizes.quantity("pressure");
  scene.velocity_scale = std::max(scene.shear_rate * H, std::sqrt(scene.base_pressure / bulk_density));
  g.high = at<Dim>(lattice.periodic(sizes, "length", 16), 0, H);
  g.periodic[0] = true;
  g.walls = {plane<Dim>("bottom", at<Dim>(0, 0, 1), true), plane<Dim>("top", at<Dim>(0, 0, -1), true)};
  g.walls[1].point = at<Dim>(0, 0, H);
  g.walls[0].velocity[0] = -0.5 * scene.shear_rate * H;
  g.walls[1].velocity[0] = 0.5 * scene.shear_rate * H;
  g.bodies = {body<Dim>(Body<Dim>::Shape::box, g.low, g.high)};
  make_periodic_across(g, sizes, lattice);
  return scene;
}

template <int Dim>
Scene<Dim> heap_scene(const Section& sizes, const Lattice& lattice, FlowSetup<Dim>& setup) {
  Scene<Dim> scene;
  Geometry<Dim>& g = scene.geometry;
  const double top = lattice.length(lattice.rows);
  const double angle = sizes.quantity("angle");
  const double foot = top / std::tan(angle);
  const double floor = sizes.given("floor_length") ? sizes.quantity("floor_length") : 1.5 * foot;
  if (floor < foot) sizes.refuse("floor_length", "\"floor_length\" must reach beyond the heap");
  const double end = lattice.length(static_cast<long>(count(floor, lattice.dx)));
  setup.floor_end = end;
  setup.initial_length = foot;
  g.high = at<Dim>(end, 0, top + lattice.length(lattice.layers));
  g.walls = {plane<Dim>("floor", at<Dim>(0, 0, 1), true), plane<Dim>("back wall", at<Dim>(1, 0, 0), false)};
  g.bodies = {body<Dim>(Body<Dim>::Shape::heap, Vec<Dim>{}, at<Dim>(foot, 0, top))};
  g.bodies[0].angle = angle;
  return scene;
}

template <int Dim>
Scene<Dim> geometry_scene(const CaseFile& file) {
  Scene<Dim> scene;
  scene.geometry = read_geometry<Dim>(file);
  for (const Body<Dim>& b : scene.geometry.bodies)
    scene.height = std::max(scene.height, b.high[Dim - 1] - b.low[Dim - 1]);
  for (const Wall<Dim>& wall : scene.geometry.walls)
    scene.velocity_scale =
        std::max(scene.velocity_scale,
                 norm(wall.velocity) +
                     std::abs(wall.omega) *
                         (wall.radius > 0 ? wall.radius : norm(scene.geometry.high - scene.geometry.low)));
  for (const Body<Dim>& b : scene.geometry.bodies)
    scene.velocity_scale = std::max(scene.velocity_scale, norm(b.velocity));
  return scene;
}

/// The ingredients: those of the formulation, or the one that the case names.
std::string chosen(const Section& flow, const char* key, const char* of_robust, const char* of_source,
                   bool robust) {
  const std::string word = flow.word(key);
  return word.empty() ? (robust ? of_robust : of_source) : word;
}

Parts read_parts(const Section& flow, const LawFile& law, double K) {
  const bool robust = flow.word("formulation") == "robust";
  const auto named = [](auto variant, const std::string& name) {
    using Variant = decltype(variant);
    Variant result;
    bool found = false;
    [&]<class... P>(std::variant<P...>*) {
      ((P::name == name ? (result = P{}, found = true) : false), ...);
    }(static_cast<Variant*>(nullptr));
    if (!found) throw std::logic_error("no part is called " + name);
    return result;
  };
  Parts parts;
  parts.kernel = chosen(flow, "kernel", "wendland_c2", "cubic_spline", robust);
  parts.friction = friction_law(law);

  parts.density =
      named(DensityPart{}, chosen(flow, "density", "continuity_fourtakas_2019", "summation_shepard", robust));
  std::visit(
      [&]<class D>(D& density) {
        if constexpr (is_diffusive<D>) density.delta = flow.number("density_diffusion");
      },
      parts.density);

  parts.walls = named(WallPart{}, chosen(flow, "walls", "adami_2012", "boundary_particles", robust));
  std::visit(
      [&]<class W>(W& walls) {
        if constexpr (has_own_state<W>) {
          walls.B_max = flow.number("B_max");
          walls.density_factor = flow.number("boundary_density_factor");
        }
        if constexpr (std::is_same_v<W, PartialSlip>) walls.share = flow.number("wall_stress_share");
      },
      parts.walls);

  parts.stress = named(StressPart{}, chosen(flow, "stress", "elastic_return", "direct", robust));
  std::visit(
      [&]<class T>(T& stress) {
        if constexpr (std::is_same_v<T, ElasticReturn>)
          stress.G = flow.number("shear_modulus") * K;
        else
          stress.gamma_dot_min = flow.quantity("g_min");
      },
      parts.stress);

  if (std::holds_alternative<PartialSlip>(parts.walls) && std::holds_alternative<ElasticReturn>(parts.stress))
    flow.refuse("walls",
                "walls = \"partial_slip\" needs stress = \"direct\": a mixed stress would overwrite what an "
                "elastic boundary particle remembers");

  parts.damping = named(DampingPart{}, chosen(flow, "damping", "balsara", "none", robust));
  std::visit(
      [&]<class T>(T& damping) {
        if constexpr (!std::is_same_v<T, NoDamping>) damping.alpha = flow.number("artificial_viscosity");
      },
      parts.damping);

  parts.correction = named(CorrectionPart{}, flow.word("gradient_correction"));
  parts.averaging = named(AveragingPart{}, flow.word("velocity_averaging"));
  if (Xsph* averaging = std::get_if<Xsph>(&parts.averaging))
    averaging->epsilon = flow.number("averaging_epsilon");
  parts.shifting = named(ShiftingPart{}, flow.word("shifting"));

  parts.dilation = named(DilationPart{}, flow.word("dilation"));
  std::visit(
      [&]<class T>(T& dilation) {
        if constexpr (std::is_same_v<T, NoDilation>) {
          return;
        } else {
          const double lowest = flow.number("beta_lowest");
          const double usual = std::is_same_v<T, DilationFromField> ? 0.0 : -0.5;
          const double given_share = flow.number("beta_share");
          const double of_law = law.dilation.has("beta_share") ? law.dilation["beta_share"] : 1;
          const DilationLimits limits{std::isnan(lowest) ? usual : lowest, flow.number("beta_highest"),
                                      std::isnan(given_share) ? of_law : given_share};
          if constexpr (std::is_same_v<T, DilationFromField>) {
            dilation.limits = limits;
          } else {
            if (law.dilation.member == "none")
              flow.refuse(
                  "dilation",
                  fmt::format("dilation = \"{}\" needs a law with s_star (a fit of start-ups, or law.s_star)",
                              T::name));
            dilation.law.phi_eq = solid_fraction_law(law);
            dilation.law.s_star = law.dilation["s_star"];
            dilation.law.limits = limits;
            const bool two_sided = law.dilation.member == "two_sided";
            if constexpr (std::is_same_v<T, DilationEvolves>) {
              if (law.dilation.member == "printed")
                flow.refuse("dilation",
                            "the law gives a gain, which only dilation = \"evolve_printed\" uses");
              dilation.law.s_star_compacting =
                  two_sided ? law.dilation["s_star_compacting"] : dilation.law.s_star;
            } else if (two_sided) {
              flow.refuse("dilation",
                          "the law has a scale for each side of phi_eq, which only dilation = "
                          "\"evolve\" uses");
            }
            if constexpr (std::is_same_v<T, DilationEvolvesPrinted>)
              dilation.law.gain = law.dilation.member == "printed" ? law.dilation["gain"] : 1.0;
          }
        }
      },
      parts.dilation);
  if (std::holds_alternative<DilationEvolves>(parts.dilation)) parts.swelling = flow.flag("swelling");
  return parts;
}

}  // namespace

std::vector<const ParameterTable*> flow_tables() {
  std::vector<const ParameterTable*> tables{&flow_table,  &column_table, &incline_table,
                                            &shear_table, &heap_table,   &law_table};
  for (const ParameterTable* table : geometry_tables()) tables.push_back(table);
  return tables;
}

LawFile law_of_case(const CaseFile& file) {
  if (!file.has("law"))
    throw UsageError(fmt::format("{}: no material law: give one with --law law.json, or in a section [law]",
                                 file.path().string()));
  const Section section = file.section(law_table);
  LawFile law;
  law.d = section.quantity("d");
  law.rho_s = section.quantity("rho_s");
  const std::string member = section.word("friction");
  const auto required = [&](const char* key) {
    const double value = section.number(key);
    if (std::isnan(value))
      section.refuse(key, fmt::format("lacks the key \"{}\", which friction = \"{}\" needs", key, member));
    return value;
  };
  if (member == "constant") {
    law.friction = {member, {given("mu", required("mu"))}, 0};
  } else if (member == "power") {
    law.friction = {
        member, {given("mu_l", required("mu_l")), given("a", required("a")), given("n", required("n"))}, 0};
  } else if (member == "linear") {
    law.friction = {member, {given("mu_l", required("mu_l")), given("rise", required("rise"))}, 0};
  } else if (member == "rational" || member == "exponential") {
    const double mu_l = required("mu_l");
    const double mu_h = required("mu_h");
    const double D_star = section.number_or_quantity("D_star");
    if (std::isnan(D_star))
      section.refuse("D_star",
                     fmt::format("lacks the key \"D_star\", which friction = \"{}\" needs", member));
    const bool rate = section.has_unit("D_star");
    if (rate && member != "rational")
      section.refuse("D_star", "only the rational law takes a rate; give \"D_star\" without a unit");
    law.friction = {rate ? "rational_rate" : member,
                    {given("mu_l", mu_l), given("mu_h", mu_h), given("D_star", D_star, rate ? "1/s" : "1")},
                    0};
    if (mu_h < mu_l) section.refuse("mu_h", "\"mu_h\" may not be below \"mu_l\"");
  } else {
    law.friction = {
        member,
        {given("mu_s", required("mu_s")), given("mu_2", required("mu_2")), given("I_0", required("I_0")),
         given("mu_inf", section.number("mu_inf")), given("alpha", section.number("alpha"))},
        0};
  }
  const double b = section.number("b");
  const double s_star = section.number("s_star");
  const double compacting = section.number("s_star_compacting");
  const double gain = section.number("gain");
  law.solid_fraction = {
      "linear", {given("phi_c", section.number("phi_c")), given("b", std::isnan(b) ? 0 : b)}, 0};
  law.dilation.member = "none";
  if (!std::isnan(s_star)) {
    if (std::isnan(b)) section.refuse("s_star", "\"s_star\" needs \"b\" as well");
    law.dilation = {"phi_relaxes", {given("s_star", s_star)}, 0};
    if (!std::isnan(gain)) law.dilation = {"printed", {given("s_star", s_star), given("gain", gain)}, 0};
    if (!std::isnan(compacting)) {
      if (!std::isnan(gain)) section.refuse("gain", "\"gain\" and \"s_star_compacting\" exclude each other");
      law.dilation = {"two_sided", {given("s_star", s_star), given("s_star_compacting", compacting)}, 0};
    }
  } else if (!std::isnan(gain) || !std::isnan(compacting)) {
    const char* key = std::isnan(gain) ? "s_star_compacting" : "gain";
    section.refuse(key, fmt::format("\"{}\" needs \"s_star\" as well", key));
  }
  section.finish(fmt::format("with friction = \"{}\"", member));
  law.verdict = "given by hand in " + file.path().string();
  return law;
}

int flow_dimension(const CaseFile& file) {
  return static_cast<int>(file.section(flow_table).integer("dimension"));
}

template <int Dim>
FlowSetup<Dim> make_setup(const CaseFile& file, const LawFile& law) {
  const Section flow = file.section(flow_table);
  FlowSetup<Dim> setup;
  setup.scene = flow.word("scene");
  if (setup.scene == "heap" && Dim == 3)
    flow.refuse("dimension",
                "this scene is plane; for a cone use scene = \"geometry\" with a body of shape \"heap\"");
  setup.formulation = flow.word("formulation");
  flow.integer("dimension");
  const bool robust = setup.formulation == "robust";

  // ---- material
  setup.grains = {law.d, law.rho_s};
  setup.law_range = law.I;
  setup.extrapolate = flow.word("extrapolate");
  if (setup.extrapolate == "error") setup.extrapolate_limit = flow.number("extrapolate_limit");
  if (setup.extrapolate != "warn" && !(law.I.highest > 0))
    flow.refuse("extrapolate",
                fmt::format("extrapolate = \"{}\" needs a law that states where its data are: one "
                            "fitted, given with --law",
                            setup.extrapolate));
  if (setup.extrapolate == "clamp" && law.friction.member == "rational_rate")
    flow.refuse("extrapolate", "a law of the shear rate has no I to clamp");
  setup.cohesion = flow.quantity("cohesion");
  const double given_phi = flow.number("initial_solid_fraction");
  setup.initial_phi = std::isnan(given_phi) ? law.solid_fraction["phi_c"] : given_phi;
  setup.bulk_density = setup.initial_phi * law.rho_s;

  // ---- the scene and its lattice
  const std::map<std::string, const ParameterTable*> sections{{"column_collapse", &column_table},
                                                              {"inclined_plane", &incline_table},
                                                              {"plane_shear", &shear_table},
                                                              {"heap", &heap_table}};
  for (const auto& [scene, table] : sections)
    if (scene != setup.scene && file.has(table->section))
      throw UsageError(fmt::format("{}: the section [{}] changes nothing with scene = \"{}\"; remove it",
                                   file.path().string(), table->section, setup.scene));
  if (setup.scene != "geometry")
    for (const char* section : {"domain", "wall", "body"})
      if (file.has(section))
        throw UsageError(fmt::format("{}: the section [{}] changes nothing with scene = \"{}\"; remove it",
                                     file.path().string(), section, setup.scene));
  const bool collapse = setup.scene == "column_collapse";
  const bool own_geometry = setup.scene == "geometry";
  const std::optional<Section> sizes =
      own_geometry ? std::nullopt : std::optional<Section>(file.section(*sections.at(setup.scene)));
  const double h_over_dx =
      std::isnan(flow.number("h_over_dx")) ? (robust ? 1.5 : 1.2) : flow.number("h_over_dx");
  Scene<Dim> scene;
  if (own_geometry) scene = geometry_scene<Dim>(file);
  const double height = own_geometry ? scene.height
                        : collapse   ? sizes->quantity("length") * sizes->number("aspect_ratio")
                                     : sizes->quantity("height");
  const long resolution = flow.integer("resolution");
  const double dx = height / static_cast<double>(resolution);
  setup.dx = dx;
  setup.h = dx * h_over_dx;
  const Lattice lattice{dx, resolution, std::lround(std::ceil(2 * h_over_dx - 1e-9))};
  if (collapse)
    scene = column_scene<Dim>(*sizes, lattice, setup);
  else if (setup.scene == "inclined_plane")
    scene = incline_scene<Dim>(*sizes, lattice);
  else if (setup.scene == "plane_shear")
    scene = shear_scene<Dim>(*sizes, lattice, setup.bulk_density);
  else if (setup.scene == "heap")
    scene = heap_scene<Dim>(*sizes, lattice, setup);
  else
    // Periodic lengths hold a whole number of particles.
    for (int k = 0; k + 1 < Dim; ++k)
      if (scene.geometry.periodic[static_cast<std::size_t>(k)]) {
        const double length = scene.geometry.high[k] - scene.geometry.low[k];
        const auto n = static_cast<double>(count(length, dx));
        if (std::abs(length - n * dx) > 1e-6 * dx)
          flow.refuse(
              "resolution",
              fmt::format("the periodic length {:g} m does not hold a whole number of particles of {:g} m; "
                          "change domain.low, domain.high or flow.resolution",
                          length, dx));
      }
  setup.length_scale = height;
  if (!own_geometry) {
    const double mu_b = flow.number("basal_friction");
    for (Wall<Dim>& wall : scene.geometry.walls)
      if (wall.rough) wall.basal_friction = mu_b;
  }

  // ---- gravity and stiffness
  const double gravity = setup.scene == "plane_shear" ? 0 : flow.quantity("gravity");
  setup.gravity[0] = gravity * std::sin(scene.angle);
  setup.gravity[Dim - 1] = -gravity * std::cos(scene.angle);
  scene.velocity_scale = std::max(scene.velocity_scale, std::sqrt(gravity * height));
  std::optional<Bagnold> bagnold;
  if (scene.bagnold_start) {
    const double slope = std::tan(scene.angle);
    if (law.friction.member != "rational" || !(slope > law.friction["mu_l"] && slope < law.friction["mu_h"]))
      sizes->refuse("start",
                    fmt::format("start = \"bagnold\" needs a rational law in I and a slope between mu_l and "
                                "mu_h, but tan(angle) = {:.3f}",
                                slope));
    bagnold.emplace(
        RationalFriction<double>{law.friction["mu_l"], law.friction["mu_h"], law.friction["D_star"]},
        setup.grains, setup.initial_phi, gravity, scene.angle);
    scene.velocity_scale = std::max(scene.velocity_scale, bagnold->velocity(height, height));
  }
  if (flow.given("mach") && flow.given("sound_speed"))
    flow.refuse("sound_speed", "give either \"mach\" or \"sound_speed\", not both");
  const double mach = flow.given("mach") ? flow.number("mach") : 0.1;
  const double c = flow.given("sound_speed") ? flow.quantity("sound_speed") : scene.velocity_scale / mach;
  if (!(c > 0)) flow.refuse("mach", "without gravity there is no velocity scale: give sound_speed");
  setup.eos = {setup.bulk_density * c * c, flow.number("eos_exponent"), setup.bulk_density, 0};
  setup.parts = read_parts(flow, law, setup.eos.K);
  if (setup.cohesion > 0) {
    setup.eos.tension = flow.quantity("tensile_strength");
    const double apex = setup.cohesion / std::max(least_friction(setup.parts.friction), 1e-300);
    if (setup.eos.tension > apex)
      flow.refuse(
          "tensile_strength",
          fmt::format("\"tensile_strength\" may not exceed cohesion over the friction at rest, {:g} Pa",
                      apex));
  }
  setup.step_factor = flow.number("step_factor");

  // ---- particles
  for (int k = 0; k + 1 < Dim; ++k)
    if (scene.geometry.periodic[static_cast<std::size_t>(k)]) {
      if (scene.geometry.low[k] != 0)
        flow.refuse("scene", "a periodic direction of [domain] must start at 0");
      setup.period.length[k] = scene.geometry.high[k];
    }
  setup.geometry = scene.geometry;
  setup.walls = scene.geometry.walls;
  const GeometryPoints<Dim> points = fill(scene.geometry, dx, static_cast<int>(lattice.layers));
  Particles<Dim>& q = setup.particles;
  q.resize(points.interior.size(), points.interior.size() + points.walls.size());
  const double volume = std::pow(dx, Dim);
  for (std::size_t i = 0; i < q.size; ++i) {
    const bool inside = i < q.interior;
    const Vec<Dim>& x = inside ? points.interior[i] : points.walls[i - q.interior];
    Particles<Dim>::store(q.x, i, x);
    q.id[i] = static_cast<std::int64_t>(i);
    q.wall[i] = inside ? -1 : static_cast<std::int64_t>(points.wall[i - q.interior]);
    // Interior particles start under the weight of what lies above them in their body, so that nothing
    // bounces at t = 0.
    q.p[i] = inside ? scene.base_pressure - setup.bulk_density * setup.gravity[Dim - 1] *
                                                scene.geometry.bodies[points.body[i]].depth(x)
                    : 0;
    q.rho[i] = setup.eos.density(q.p[i]);
    q.m[i] = q.rho[i] * volume;
    if (inside) Particles<Dim>::store(q.v, i, scene.geometry.bodies[points.body[i]].velocity);
    if (inside && bagnold) q.v[0][i] = bagnold->velocity(x[Dim - 1], height);
    if (inside && scene.shear_start) q.v[0][i] = scene.shear_rate * (x[Dim - 1] - 0.5 * height);
  }

  // ---- how long
  const double end_time = flow.quantity("end_time");
  setup.end_time = std::isnan(end_time) && collapse ? 10 * std::sqrt(height / gravity) : end_time;
  if (!std::isfinite(setup.end_time))
    flow.refuse("end_time", "lacks the required key \"end_time\" with this scene");
  if (collapse) setup.stop_at_rest = flow.flag("stop_at_rest");
  setup.frames = flow.integer("frames");
  const std::string because = fmt::format(
      "with scene = \"{}\", formulation = \"{}\", density = \"{}\", walls = \"{}\", "
      "stress = \"{}\", dilation = \"{}\", damping = \"{}\"",
      setup.scene, setup.formulation, name_of(setup.parts.density), name_of(setup.parts.walls),
      name_of(setup.parts.stress), name_of(setup.parts.dilation), name_of(setup.parts.damping));
  flow.finish(because);
  if (sizes) sizes->finish(because);
  return setup;
}

template FlowSetup<2> make_setup<2>(const CaseFile&, const LawFile&);
template FlowSetup<3> make_setup<3>(const CaseFile&, const LawFile&);

}  // namespace dem2sph
