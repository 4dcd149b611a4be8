#include "cases/stability_cells.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace dem2sph {

double StabilityScale::speed() const { return std::sqrt(g * height()); }
double StabilityScale::time() const { return std::sqrt(height() / g); }

namespace {

/// Writes the cells of one axis after another.
class Matrix {
 public:
  Matrix(const StabilityScale& scale, std::string wanted) : s(scale), wanted_(std::move(wanted)) {}

  const StabilityScale& s;
  std::vector<StabilityCell> cells;

  /// Cells that follow belong to this axis; false if it is not asked for.
  bool axis(const char* name) {
    axis_ = name;
    return wanted_ == every_axis || wanted_ == name;
  }
  StabilityCell& add(std::string value, std::string text, std::vector<std::string> set = {},
                     Oracle oracle = Oracle::budgets, double work = 3) {
    cells.push_back({axis_, std::move(value), std::move(text), std::move(set), oracle, work});
    return cells.back();
  }

  std::string flow(const char* scene, long rows, double taus) const {
    return fmt::format("[flow]\nscene = \"{}\"\nresolution = {}\nend_time = \"{:.9g} s\"\nframes = 4\n",
                       scene, rows, taus * s.time());
  }
  std::string collapse(double aspect = 1, double taus = 5, long rows = 0) const {
    return flow("column_collapse", rows > 0 ? rows : s.rows, taus) +
           fmt::format(
               "stop_at_rest = false\n[column]\nlength = \"{0:.9g} m\"\naspect_ratio = {1:g}\nfloor_length = "
               "\"{2:.9g} m\"\n",
               s.height() / aspect, aspect, s.height() / aspect * (4 + 4 * std::max(aspect, 1.0)));
  }
  std::string slope(double degrees, double taus, long rows = 0) const {
    return flow("inclined_plane", rows > 0 ? rows : s.rows, taus) +
           fmt::format("[incline]\nheight = \"{:.9g} m\"\nangle = \"{:g} deg\"\n", s.height(), degrees);
  }
  /// Plane shear at the inertial number I over a total shear of `strain`.
  std::string shear(double I, double strain) const {
    const double pressure = s.rho0 * s.g * s.height();
    const double rate = I * std::sqrt(pressure / s.rho_s) / s.d;
    return fmt::format(
        "[flow]\nscene = \"plane_shear\"\nresolution = {}\nend_time = \"{:.9g} s\"\nframes = "
        "4\n[shear]\nheight = "
        "\"{:.9g} m\"\nshear_rate = \"{:.9g} 1/s\"\npressure = \"{:.9g} Pa\"\n",
        s.rows, strain / rate, s.height(), rate, pressure);
  }
  /// A square body of side H over a floor, in a room of 6 H by 6 H, thrown with a velocity in units of
  /// sqrt(gH).
  std::string thrown(double taus, double above, double vx, double vup, const char* more = "") const {
    const double H = s.height();
    return flow("geometry", s.rows, taus) +
           fmt::format(
               "{}[domain]\nlow = [\"{:.9g} m\", \"{:.9g} m\"]\nhigh = [\"{:.9g} m\", \"{:.9g} m\"]\n"
               "[wall.floor]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]\nnormal = [0, 1]\n"
               "[body.material]\nshape = \"box\"\nlow = [\"{:.9g} m\", \"{:.9g} m\"]\nhigh = [\"{:.9g} m\", "
               "\"{:.9g} m\"]\nvelocity = [\"{:.9g} m/s\", \"{:.9g} m/s\"]\n",
               more, -30 * H, -H, 30 * H, 6 * H, -0.5 * H, above * H, 0.5 * H, (above + 1) * H,
               vx * s.speed(), vup * s.speed());
  }
  /// A bed in a periodic room whose floor moves.
  std::string moving_floor(double taus, double v, double period_taus) const {
    const double H = s.height();
    const double length = 16 * H / static_cast<double>(s.rows);
    return flow("geometry", s.rows, taus) +
           fmt::format(
               "[domain]\nlow = [\"0 m\", \"{:.9g} m\"]\nhigh = [\"{:.9g} m\", \"{:.9g} m\"]\nperiodic = "
               "\"x\"\n"
               "[wall.floor]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]\nnormal = [0, 1]\nvelocity = "
               "[\"{:.9g} m/s\", \"0 m/s\"]\n{}[body.material]\nshape = \"box\"\nlow = [\"0 m\", \"0 m\"]\n"
               "high = [\"{:.9g} m\", \"{:.9g} m\"]\n",
               -H, length, 3 * H, v * s.speed(),
               period_taus > 0 ? fmt::format("period = \"{:.9g} s\"\n", period_taus * s.time()) : "", length,
               H);
  }
  /// A wall that is driven into a bed.
  std::string plough(double taus, double v) const {
    const double H = s.height();
    return flow("geometry", s.rows, taus) +
           fmt::format(
               "[domain]\nlow = [\"{:.9g} m\", \"{:.9g} m\"]\nhigh = [\"{:.9g} m\", \"{:.9g} m\"]\n"
               "[wall.floor]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]\nnormal = [0, 1]\n"
               "[wall.plough]\nshape = \"plane\"\npoint = [\"0 m\", \"0 m\"]\nnormal = [1, 0]\nvelocity = "
               "[\"{:.9g} m/s\", \"0 m/s\"]\nsurface = \"smooth\"\n[body.material]\nshape = \"box\"\nlow = "
               "[\"0 m\", \"0 m\"]\nhigh = [\"{:.9g} m\", \"{:.9g} m\"]\n",
               -H, -H, 20 * H, 8 * H, v * s.speed(), 2 * H, H);
  }
  /// Two square bodies that fly at each other; the same material, no gravity.
  std::string collision(double c_over_v) const {
    const double H = s.height();
    const auto body = [&](const char* name, double left, double velocity) {
      return fmt::format(
          "[body.{}]\nshape = \"box\"\nlow = [\"{:.9g} m\", \"{:.9g} m\"]\nhigh = [\"{:.9g} m\", "
          "\"{:.9g} m\"]\nvelocity = [\"{:.9g} m/s\", \"0 m/s\"]\n",
          name, left * H, 2 * H, (left + 1) * H, 3 * H, velocity * s.speed());
    };
    return flow("geometry", s.rows, 3) +
           fmt::format(
               "gravity = \"0 m/s^2\"\nsound_speed = \"{:.9g} m/s\"\n[domain]\nlow = [\"{:.9g} m\", \"{:.9g} "
               "m\"]\nhigh = [\"{:.9g} m\", \"{:.9g} m\"]\n",
               c_over_v * s.speed(), -20 * H, -20 * H, 20 * H, 20 * H) +
           body("left", -1.25, 1) + body("right", 0.25, -1);
  }

 private:
  std::string axis_;
  std::string wanted_;
};

std::string set_speed(const StabilityScale& s, double over_sqrt_gH) {
  return fmt::format("flow.sound_speed={:.9g} m/s", over_sqrt_gH * s.speed());
}

void numerics(Matrix& m) {
  const StabilityScale& s = m.s;
  if (m.axis("sound_speed")) {
    for (const double c : {10, 20, 40, 80, 160})
      m.add(fmt::format("{:g} sqrt(gH), 40 rows", c), m.collapse(1, 6, 40), {set_speed(s, c)},
            Oracle::same_front, 3.2 * c);
    for (const double c : {5, 320, 1000})
      m.add(fmt::format("{:g} sqrt(gH)", c), m.collapse(1, 5), {set_speed(s, c)}, Oracle::budgets, 0.08 * c);
  }
  if (m.axis("step_factor")) {
    for (const double f : {0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0})
      m.add(fmt::format("{:g}, robust", f), m.collapse(1, 5), {fmt::format("flow.step_factor={:g}", f)});
    for (const double f : {0.25, 0.5, 1.0, 2.0, 4.0})
      m.add(fmt::format("{:g}, source", f), m.collapse(1, 2),
            {"flow.formulation=source", fmt::format("flow.g_min={:.6g} 1/s", 0.2 / s.time()),
             fmt::format("flow.step_factor={:g}", f)},
            Oracle::budgets, 60 / f);
  }
  if (m.axis("ingredient")) {
    const auto with = [&](const char* setting, std::vector<std::string> more = {}, double work = 3) {
      more.insert(more.begin(), fmt::format("flow.{}", setting));
      m.add(setting, m.collapse(1, 5), std::move(more), Oracle::budgets, work);
    };
    for (const char* setting : {"kernel=cubic_spline",
                                "kernel=wendland_c4",
                                "h_over_dx=1",
                                "h_over_dx=1.2",
                                "h_over_dx=2",
                                "h_over_dx=3",
                                "density=summation",
                                "density=summation_shepard",
                                "density=continuity_monaghan_1994",
                                "density=continuity_molteni_colagrossi_2009",
                                "density_diffusion=0",
                                "density_diffusion=1",
                                "walls=boundary_particles",
                                "damping=none",
                                "damping=monaghan",
                                "artificial_viscosity=0.01",
                                "artificial_viscosity=1",
                                "artificial_viscosity=2",
                                "gradient_correction=bonet_lok_1999",
                                "velocity_averaging=xsph",
                                "shifting=sun_2017",
                                "shear_modulus=0.01",
                                "shear_modulus=1.5",
                                "eos_exponent=7"})
      with(setting);
    with("stress=direct", {fmt::format("flow.g_min={:.6g} 1/s", 0.2 / s.time())}, 60);
    with("walls=partial_slip", {"flow.stress=direct", fmt::format("flow.g_min={:.6g} 1/s", 0.2 / s.time())},
         60);
    m.add("dimension=3", m.slope(30, 2), {"flow.dimension=3", "flow.resolution=8"}, Oracle::budgets, 10);
    m.add("g_min=1e-9 1/s, direct", m.collapse(1, 1), {"flow.stress=direct", "flow.g_min=1e-9 1/s"});
  }
}

void material(Matrix& m) {
  const StabilityScale& s = m.s;
  if (m.axis("inertial_number"))
    for (const double I : {1e-6, 1e-4, 1e-2, 0.1, 1.0, 10.0, 100.0})
      m.add(fmt::format("{:g}", I),
            m.shear(I, I < 1e-5   ? 0.02
                       : I < 1e-3 ? 0.2
                                  : 3),
            {}, Oracle::mu_of_I,
            I < 1e-5   ? 50
            : I < 1e-3 ? 8
                       : 3);
  if (m.axis("friction")) {
    for (const double mu : {0.0, 0.01, 0.1, 0.8, 1.5})
      m.add(fmt::format("mu_l = {:g}", mu), m.collapse(1, 5),
            {fmt::format("law.mu_l={:g}", mu), fmt::format("law.mu_h={:g}", mu + 0.3)});
    for (const double mu : {0.0, 0.4, 1.5})
      m.add(fmt::format("mu_h = mu_l = {:g}", mu), m.collapse(1, 5),
            {fmt::format("law.mu_l={:g}", mu), fmt::format("law.mu_h={:g}", mu)});
    for (const double D : {1e-4, 1e-2, 1.0, 10.0})
      m.add(fmt::format("D* = {:g}", D), m.collapse(1, 5), {fmt::format("law.D_star={:g}", D)});
  }
  if (m.axis("dilation")) {
    const std::string evolve = "flow.dilation=evolve";
    for (const double scale : {1e-4, 1e-2, 1.0, 100.0, 1e3})
      m.add(fmt::format("s* = {:g}", scale), m.collapse(1, 5),
            {evolve, fmt::format("law.s_star={:g}", scale)});
    for (const double b : {1e-4, 1.0, 10.0})
      m.add(fmt::format("b = {:g}", b), m.collapse(1, 5), {evolve, fmt::format("law.b={:g}", b)});
    for (const double limit : {1e-4, 0.5, 10.0, 1e3})
      m.add(fmt::format("beta up to {:g}, dense", limit), m.collapse(1, 5),
            {evolve, "flow.initial_solid_fraction=0.63", fmt::format("flow.beta_highest={:g}", limit),
             "law.s_star=0.01"});
    m.add("loose, 0.5", m.collapse(1, 5), {evolve, "flow.initial_solid_fraction=0.5"});
    m.add("loose, swelling", m.collapse(1, 5),
          {evolve, "flow.initial_solid_fraction=0.5", "flow.swelling=true"});
    m.add("dense, swelling", m.collapse(1, 5),
          {evolve, "flow.initial_solid_fraction=0.63", "flow.swelling=true"});
    m.add("s* = 1e-4, swelling", m.collapse(1, 5), {evolve, "law.s_star=1e-4", "flow.swelling=true"});
    m.add("printed form", m.collapse(1, 5), {"flow.dilation=evolve_printed"});
    m.add("printed form, gain 10", m.collapse(1, 5), {"flow.dilation=evolve_printed", "law.gain=10"});
    m.add("from the field", m.collapse(1, 5), {"flow.dilation=direct"});
  }
  if (m.axis("cohesion")) {
    const double weight = s.rho0 * s.g * s.height();
    for (const double c : {0.01, 0.1, 1.0, 10.0})
      m.add(fmt::format("c = {:g} rho g H", c), m.collapse(1, 5),
            {fmt::format("flow.cohesion={:.6g} Pa", c * weight)});
    for (const double c : {0.1, 1.0})
      m.add(fmt::format("c = {:g} rho g H, tension", c), m.collapse(1, 5),
            {fmt::format("flow.cohesion={:.6g} Pa", c * weight),
             fmt::format("flow.tensile_strength={:.6g} Pa", c * weight)});
  }
  if (m.axis("ill_posed_law")) {
    // Fast flow on a steep slope, where mu(I) is ill-posed at large I, and near rest at small I.
    for (const long rows : {10, 20, 40})
      m.add(fmt::format("rational, {} rows", rows), m.slope(31, 3, rows), {}, Oracle::evenness,
            0.2 * static_cast<double>(rows * rows) / 100);
    for (const long rows : {10, 20, 40})
      m.add(fmt::format("well posed, {} rows", rows), m.slope(31, 3, rows), {"law.friction=barker_gray_2017"},
            Oracle::evenness, 0.2 * static_cast<double>(rows * rows) / 100);
  }
}

void scenes(Matrix& m) {
  const StabilityScale& s = m.s;
  if (m.axis("no_pressure")) {
    m.add("free flight", m.thrown(2, 3, 0.5, 0.2, "gravity = \"0 m/s^2\"\nsound_speed = \"1 m/s\"\n"), {},
          Oracle::flight);
    m.add("free fall", m.thrown(2, 3, 0.3, 0), {}, Oracle::flight);
    m.add("fall and landing", m.thrown(6, 3, 0, 0));
    m.add("throw and landing", m.thrown(8, 0.1, 1, 1));
    for (const double c : {3.0, 10.0, 100.0})
      m.add(fmt::format("two bodies collide, c = {:g} v", c), m.collision(c));
  }
  if (m.axis("drop")) {
    for (const double v : {1.0, 3.0, 10.0})
      m.add(fmt::format("{:g} sqrt(gH), c = 10 v", v), m.thrown(4, 0.5, 0, -v));
    for (const double c : {10.0, 30.0})
      m.add(fmt::format("10 sqrt(gH), c = {:g} sqrt(gH)", c), m.thrown(4, 0.5, 0, -10), {set_speed(s, c)});
    m.add("10 sqrt(gH), along the floor", m.thrown(4, 0.5, 10, -3));
  }
  if (m.axis("aspect_ratio"))
    for (const double a : {0.05, 0.2, 5.0, 20.0})
      m.add(fmt::format("a = {:g}", a),
            m.collapse(a, a > 10 ? 3 : 5, a > 1 ? std::lround(6 * std::min(a, 10.0)) : s.rows), {},
            Oracle::budgets, 8);
  if (m.axis("thin_bed"))
    for (const long rows : {1, 2, 3, 4}) {
      m.add(fmt::format("{} rows at rest", rows), m.slope(0, 20, rows), {}, Oracle::rest);
      m.add(fmt::format("{} rows on 25 deg", rows), m.slope(25, 10, rows));
    }
  if (m.axis("spacing"))
    for (const double ratio : {1.0, 0.5, 0.25})
      m.add(fmt::format("dx = {:g} d", ratio), m.collapse(1, 2, std::lround(20 / ratio)), {}, Oracle::budgets,
            3 / (ratio * ratio * ratio));
  if (m.axis("slope"))
    for (const double degrees : {0, 5, 10, 15, 25, 45, 89})
      m.add(fmt::format("{:g} deg", degrees), m.slope(degrees, degrees > 80 ? 5 : 60), {},
            degrees <= 15 ? Oracle::rest : Oracle::budgets);
  if (m.axis("long_rest")) {
    m.add("bed", m.slope(0, 1000, 10), {}, Oracle::rest, 60);
    m.add("slope of 15 deg", m.slope(15, 1000, 10), {}, Oracle::rest, 60);
    m.add("pile of 15 deg",
          m.flow("heap", 10, 1000) +
              fmt::format("[heap]\nheight = \"{:.9g} m\"\nangle = \"15 deg\"\n", s.height()),
          {}, Oracle::rest, 80);
  }
  if (m.axis("moving_wall")) {
    for (const double v : {0.1, 1.0, 10.0})
      m.add(fmt::format("floor starts at {:g} sqrt(gH)", v), m.moving_floor(4, v, 0));
    for (const double v : {0.1, 1.0, 3.0})
      m.add(fmt::format("plough at {:g} sqrt(gH)", v), m.plough(std::min(4.0, 6 / v), v));
  }
  if (m.axis("cyclic_shear")) {
    for (const double period : {0.1, 1.0, 10.0})
      m.add(fmt::format("period {:g} sqrt(H/g)", period),
            m.moving_floor(std::max(4.0, 2 * period), 0.5, period));
    m.add("reversal",
          m.moving_floor(6, 1, 0) + fmt::format("velocity = [\"{:.9g} m/s\", \"0 m/s\"]\n", -s.speed()));
  }
}

}  // namespace

std::vector<StabilityCell> stability_cells(const StabilityScale& scale, const std::string& axis) {
  Matrix m(scale, axis);
  numerics(m);
  material(m);
  scenes(m);
  return std::move(m.cells);
}

std::string grain_cell_case(const LawFile& law) {
  return fmt::format(R"([material]
d = "{:.9g} m"
rho_s = "{:.9g} kg/m^3"
grain_friction = 0.5
restitution = 0.5
contact = "hertz"
youngs_modulus = "10 MPa"
[shear_cell]
pressure = "1 kPa"
grains = 700
length = 6
width = 6
time_limit = "10 min"
on_failure = "skip"
[shear_cell.steady]
I = [0.1]
strain_dropped = 2
strain_used = 8
responses_dropped = 1
responses_used = 2
frames = 250
)",
                     law.d, law.rho_s);
}

std::vector<GrainCell> grain_cells() {
  std::vector<GrainCell> cells;
  const auto axis = [&](const char* name, const char* key, std::initializer_list<double> values) {
    for (const double v : values)
      cells.push_back({name, fmt::format("{:g}", v), {fmt::format("{}={:g}", key, v)}});
  };
  for (const double kappa : {1e2, 1e3, 1e4, 1e5, 1e6, 1e7})
    cells.push_back({"stiffness kappa",
                     fmt::format("{:g}", kappa),
                     {"material.contact=hooke", fmt::format("material.kappa={:g}", kappa)}});
  axis("time step over Rayleigh's", "shear_cell.time_step_fraction", {0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0});
  for (const double I : {1e-4, 1e-3, 1e-2, 0.1, 1.0, 3.0, 10.0})
    cells.push_back(
        {"inertial number", fmt::format("{:g}", I), {fmt::format("shear_cell.steady.I=[{:g}]", I)}});
  axis("grain friction", "material.grain_friction", {0, 0.1, 0.5, 1, 2});
  axis("restitution", "material.restitution", {0.1, 0.3, 0.5, 0.7, 0.9, 0.99});
  axis("spread of sizes", "material.size_spread", {0, 0.4});
  return cells;
}

}  // namespace dem2sph
