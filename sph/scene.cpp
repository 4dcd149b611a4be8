#include "sph/scene.hpp"

#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "sph/base/errors.hpp"
#include "sph/rheology/bagnold.hpp"

namespace dem2sph {
namespace {

const ParameterTable flow_table{
    "flow",
    "The continuum flow.",
    {
        {"scene",
         Kind::word,
         "",
         0,
         0,
         "required",
         "Which scene: its section holds its sizes.",
         {"column_collapse", "inclined_plane"}},
        {"formulation",
         Kind::word,
         "",
         0,
         0,
         "robust",
         "Set of ingredients (sph/README.md).",
         {"robust", "source"}},
        {"dimension", Kind::integer, "", 2, 3, "2", "2 is plane strain."},
        {"resolution", Kind::integer, "", 1, 100000, "40", "Particles over the height H of the scene."},
        {"dilation",
         Kind::word,
         "",
         0,
         0,
         "none",
         "Evolution of phi and beta (Eq. 5.22).",
         {"none", "evolve"}},
        {"initial_solid_fraction", Kind::number, "", 0.3, 0.74, "unset",
         "Solid fraction at t = 0; unset: phi_c of the law."},
        {"beta_lowest", Kind::number, "", -10, 0, "-0.5", "Least beta that enters mu."},
        {"beta_highest", Kind::number, "", 0, 10, "0.5", "Largest beta that enters mu."},
        {"cohesion", Kind::quantity, "Pa", 0, 1e9, "0 Pa", "Cohesion c of Eq. 5.3."},
        {"gravity", Kind::quantity, "m/s^2", 0, 1000, "9.81 m/s^2", "Acceleration of gravity."},
        {"mach", Kind::number, "", 1e-4, 0.3, "unset",
         "The scene's velocity scale over the speed of sound; 0.1 if neither this nor sound_speed is given."},
        {"sound_speed", Kind::quantity, "m/s", 1e-6, 1e5, "unset",
         "Speed of sound sqrt(K/rho0), instead of mach."},
        {"eos_exponent", Kind::number, "", 1, 7, "1", "gamma of Eq. 5.5; 1 is linear."},
        {"kernel",
         Kind::word,
         "",
         0,
         0,
         "unset",
         "Smoothing kernel; unset: that of the formulation.",
         {"cubic_spline", "wendland_c2", "wendland_c4"}},
        {"h_over_dx", Kind::number, "", 1.0, 3.0, "unset",
         "Smoothing length over spacing; unset: 1.2 in source, 1.5 in robust."},
        {"damping",
         Kind::word,
         "",
         0,
         0,
         "unset",
         "Acoustic damping; unset: that of the formulation.",
         {"none", "monaghan", "balsara"}},
        {"artificial_viscosity", Kind::number, "", 0, 2, "0.1", "alpha of the damping."},
        {"density_diffusion", Kind::number, "", 0, 1, "0.1", "delta of the density diffusion."},
        {"shear_modulus", Kind::number, "", 0.01, 1.5, "0.4", "G over K of the elastic predictor."},
        {"g_min", Kind::quantity, "1/s", 1e-9, 1e6, "0.1 1/s",
         "Least shear rate in the viscosity of direct stress."},
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
        {"length", Kind::quantity, "m", 1e-6, 1e5, "required", "L0: extent in x."},
        {"aspect_ratio", Kind::number, "", 0.05, 50, "1", "a = H0/L0."},
        {"floor_length", Kind::quantity, "m", 1e-6, 1e6, "unset", "Unset: L0 (2 + 3 max(a, a^(2/3)))."},
        {"width", Kind::quantity, "m", 1e-6, 1e5, "unset", "Periodic extent across, in 3D."},
    }};

const ParameterTable incline_table{
    "incline",
    "A bed on a rough incline, periodic along it; 0 deg is a bed at rest.",
    {
        {"height", Kind::quantity, "m", 1e-6, 1e5, "required", "H: depth of the bed, normal to the incline."},
        {"angle", Kind::quantity, "rad", 0, 1.5, "required", "Slope, for example \"25 deg\"."},
        {"length", Kind::quantity, "m", 1e-6, 1e5, "unset", "Periodic extent; unset: 16 particles."},
        {"width", Kind::quantity, "m", 1e-6, 1e5, "unset",
         "Periodic extent across, in 3D; unset: 12 particles."},
        {"start",
         Kind::word,
         "",
         0,
         0,
         "rest",
         "Velocity at t = 0: none, or the exact steady profile.",
         {"rest", "bagnold"}},
    }};

const ParameterTable law_table{
    "law",
    "A material law given by hand, instead of a law file.",
    {
        {"d", Kind::quantity, "m", 1e-9, 10, "required", "Mean grain diameter."},
        {"rho_s", Kind::quantity, "kg/m^3", 1, 1e5, "required", "Density of the grains' material."},
        {"mu_l", Kind::number, "", 0, 3, "required", "Friction at I -> 0."},
        {"mu_h", Kind::number, "", 0, 3, "required", "Friction at I -> infinity."},
        {"D_star", Kind::number, "", 1e-9, 1e3, "required", "I at which half of the range is reached."},
        {"phi_c", Kind::number, "", 0.1, 0.9, "required", "Solid fraction at I -> 0."},
        {"b", Kind::number, "", 0, 10, "unset", "Slope of the solid fraction, phi_eq = phi_c - b I."},
        {"s_star", Kind::number, "", 1e-6, 1e6, "unset", "Strain over which phi relaxes."},
    }};

FittedParameter given(const char* name, double value) { return {name, value, 0, "1", false}; }

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

// Collects lattice points, interior ones first.
template <int Dim>
struct Lattice {
  double dx;
  std::size_t across = 1;  // rows in the third direction
  std::vector<Vec<Dim>> points;
  std::vector<long> plane;

  void block(long i0, long i1, long k0, long k1, long plane_index) {
    for (std::size_t j = 0; j < across; ++j)
      for (long k = k0; k < k1; ++k)
        for (long i = i0; i < i1; ++i) {
          points.push_back(at<Dim>((static_cast<double>(i) + 0.5) * dx, (static_cast<double>(j) + 0.5) * dx,
                                   (static_cast<double>(k) + 0.5) * dx));
          plane.push_back(plane_index);
        }
  }
};

}  // namespace

std::vector<const ParameterTable*> flow_tables() {
  return {&flow_table, &column_table, &incline_table, &law_table};
}

LawFile law_of_case(const CaseFile& file) {
  if (!file.has("law"))
    throw UsageError(fmt::format("{}: no material law: give one with --law law.json, or in a section [law]",
                                 file.path().string()));
  const Section section = file.section(law_table);
  LawFile law;
  law.d = section.quantity("d");
  law.rho_s = section.quantity("rho_s");
  law.friction = {"rational",
                  {given("mu_l", section.number("mu_l")), given("mu_h", section.number("mu_h")),
                   given("D_star", section.number("D_star"))},
                  0};
  if (law.friction["mu_h"] < law.friction["mu_l"])
    section.refuse("mu_h", "\"mu_h\" may not be below \"mu_l\"");
  const double b = section.number("b");
  const double s_star = section.number("s_star");
  law.solid_fraction = {
      "linear", {given("phi_c", section.number("phi_c")), given("b", std::isnan(b) ? 0 : b)}, 0};
  law.dilation.member = "none";
  if (!std::isnan(s_star)) {
    if (std::isnan(b)) section.refuse("s_star", "\"s_star\" needs \"b\" as well");
    law.dilation = {"phi_relaxes", {given("s_star", s_star)}, 0};
  }
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
  setup.formulation = flow.word("formulation");
  flow.integer("dimension");
  const bool robust = setup.formulation == "robust";
  const bool collapse = setup.scene == "column_collapse";

  // ---- material
  Material& material = setup.material;
  material.grains = {law.d, law.rho_s};
  material.friction = {law.friction["mu_l"], law.friction["mu_h"], law.friction["D_star"]};
  setup.law_range = law.I;
  material.cohesion = flow.quantity("cohesion");
  const double given_phi = flow.number("initial_solid_fraction");
  setup.initial_phi = std::isnan(given_phi) ? law.solid_fraction["phi_c"] : given_phi;
  Ingredients& use = setup.ingredients;
  use.dilation = flow.word("dilation");
  if (use.dilation == "evolve") {
    if (law.dilation.member == "none")
      flow.refuse("dilation",
                  "dilation = \"evolve\" needs a law with s_star (a fit of start-ups, or law.s_star)");
    material.dilation = {{law.solid_fraction["phi_c"], law.solid_fraction["b"]},
                         law.dilation["s_star"],
                         {flow.number("beta_lowest"), flow.number("beta_highest")}};
  }

  // ---- ingredients
  use.kernel = flow.word("kernel");
  if (use.kernel.empty()) use.kernel = robust ? "wendland_c2" : "cubic_spline";
  use.density = robust ? "continuity_fourtakas_2019" : "summation_shepard";
  use.walls = robust ? "adami_2012" : "boundary_particles";
  use.stress = robust ? "elastic_return" : "direct";
  use.damping = flow.word("damping");
  if (use.damping.empty()) use.damping = robust ? "balsara" : "none";

  // ---- sizes of the scene
  const Section sizes = file.section(collapse ? column_table : incline_table);
  if (file.has(collapse ? "incline" : "column"))
    throw UsageError(fmt::format("{}: the section [{}] changes nothing with scene = \"{}\"; remove it",
                                 file.path().string(), collapse ? "incline" : "column", setup.scene));
  const double gravity = flow.quantity("gravity");
  const long resolution = flow.integer("resolution");
  const double height =
      collapse ? sizes.quantity("length") * sizes.number("aspect_ratio") : sizes.quantity("height");
  NumericalParameters& numerics = setup.numerics;
  const double dx = height / static_cast<double>(resolution);
  numerics.dx = dx;
  const double h_over_dx = flow.number("h_over_dx");
  numerics.h = dx * (std::isnan(h_over_dx) ? (robust ? 1.5 : 1.2) : h_over_dx);
  numerics.step_factor = flow.number("step_factor");
  if (robust) {
    numerics.G_over_K = flow.number("shear_modulus");
    numerics.delta = flow.number("density_diffusion");
  } else {
    numerics.gamma_dot_min = flow.quantity("g_min");
  }
  if (use.damping != "none") numerics.alpha = flow.number("artificial_viscosity");
  setup.length_scale = height;
  setup.bulk_density = setup.initial_phi * law.rho_s;

  const double angle = collapse ? 0 : sizes.quantity("angle");
  setup.gravity[0] = gravity * std::sin(angle);
  setup.gravity[Dim - 1] = -gravity * std::cos(angle);
  const bool steady_start = !collapse && sizes.word("start") == "bagnold";
  const double slope = std::tan(angle);
  if (steady_start && !(slope > material.friction.mu_l && slope < material.friction.mu_h))
    sizes.refuse(
        "start",
        fmt::format("start = \"bagnold\" needs a slope between mu_l and mu_h, but tan(angle) = {:.3f}",
                    slope));
  const Bagnold bagnold(material.friction, material.grains, setup.initial_phi, gravity, angle);

  // ---- stiffness
  double velocity_scale = std::sqrt(gravity * height);
  if (steady_start) velocity_scale = std::max(velocity_scale, bagnold.velocity(height, height));
  if (flow.given("mach") && flow.given("sound_speed"))
    flow.refuse("sound_speed", "give either \"mach\" or \"sound_speed\", not both");
  const double mach = flow.given("mach") ? flow.number("mach") : 0.1;
  const double c = flow.given("sound_speed") ? flow.quantity("sound_speed") : velocity_scale / mach;
  if (!(c > 0)) flow.refuse("mach", "without gravity there is no velocity scale: give sound_speed");
  setup.eos = {setup.bulk_density * c * c, flow.number("eos_exponent"), setup.bulk_density};

  // ---- particles
  const auto rows = static_cast<long>(resolution);
  const long layers = std::lround(std::ceil(2 * numerics.h / dx - 1e-9));
  Lattice<Dim> lattice{dx, 1, {}, {}};
  if constexpr (Dim == 3) {
    const double width = sizes.quantity("width");
    const std::size_t least = static_cast<std::size_t>(3 * layers + 3);
    lattice.across = std::isnan(width) ? std::max<std::size_t>(12, least) : count(width, dx);
    if (lattice.across < least)
      sizes.refuse("width",
                   fmt::format("\"width\" must hold at least {} particles at this resolution", least));
    setup.period.length[1] = dx * static_cast<double>(lattice.across);
  }
  Vec<Dim> up;
  up[Dim - 1] = 1;
  setup.planes.push_back({Vec<Dim>{}, up, Vec<Dim>{}, true});
  std::size_t interior = 0;
  if (collapse) {
    const double a = sizes.number("aspect_ratio");
    const double length = sizes.quantity("length");
    const auto columns = static_cast<long>(count(length, dx));
    setup.initial_length = dx * static_cast<double>(columns);
    const double floor = sizes.given("floor_length") ? sizes.quantity("floor_length")
                                                     : length * (2 + 3 * std::max(a, std::pow(a, 2.0 / 3)));
    if (floor < length) sizes.refuse("floor_length", "\"floor_length\" must reach beyond the column");
    const auto floor_columns = static_cast<long>(count(floor, dx));
    setup.floor_end = dx * static_cast<double>(floor_columns - layers);
    Vec<Dim> right;
    right[0] = 1;
    setup.planes.push_back({Vec<Dim>{}, right, Vec<Dim>{}, false});
    lattice.block(0, columns, 0, rows, -1);
    interior = lattice.points.size();
    lattice.block(-layers, floor_columns, -layers, 0, 0);
    lattice.block(-layers, 0, 0, rows + 2 * layers, 1);
    const double end_time = flow.quantity("end_time");
    setup.end_time = std::isnan(end_time) ? 10 * std::sqrt(height / gravity) : end_time;
    setup.stop_at_rest = flow.flag("stop_at_rest");
  } else {
    const double length = sizes.quantity("length");
    const long least = 3 * layers + 3;
    const long columns = std::isnan(length) ? std::max(16L, least) : static_cast<long>(count(length, dx));
    if (columns < least)
      sizes.refuse("length",
                   fmt::format("\"length\" must hold at least {} particles at this resolution", least));
    setup.period.length[0] = dx * static_cast<double>(columns);
    lattice.block(0, columns, 0, rows, -1);
    interior = lattice.points.size();
    lattice.block(0, columns, -layers, 0, 0);
    setup.end_time = flow.quantity("end_time");
    if (std::isnan(setup.end_time))
      flow.refuse("end_time", "lacks the required key \"end_time\" with this scene");
  }
  setup.frames = flow.integer("frames");

  Particles<Dim>& q = setup.particles;
  q.resize(interior, lattice.points.size());
  const double volume = std::pow(dx, Dim);
  for (std::size_t i = 0; i < q.size; ++i) {
    const Vec<Dim>& x = lattice.points[i];
    Particles<Dim>::store(q.x, i, x);
    q.id[i] = static_cast<std::int64_t>(i);
    q.plane[i] = lattice.plane[i];
    // Interior particles start under the weight of what lies above them, so that nothing bounces at t = 0.
    const double p =
        i < interior ? setup.bulk_density * gravity * std::cos(angle) * (height - x[Dim - 1]) : 0;
    q.p[i] = p;
    q.rho[i] = setup.eos.density(p);
    q.m[i] = q.rho[i] * volume;
    if (i < interior && steady_start) q.v[0][i] = bagnold.velocity(x[Dim - 1], height);
  }
  const std::string because =
      fmt::format("with formulation = \"{}\", scene = \"{}\", dilation = \"{}\", damping = \"{}\"",
                  setup.formulation, setup.scene, use.dilation, use.damping);
  flow.finish(because);
  sizes.finish(because);
  return setup;
}

template FlowSetup<2> make_setup<2>(const CaseFile&, const LawFile&);
template FlowSetup<3> make_setup<3>(const CaseFile&, const LawFile&);

}  // namespace dem2sph
