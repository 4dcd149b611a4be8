// The solver: Algorithm 1 (given) over one composition of parts. Passes over pairs call the terms of
// terms.hpp.
//
// One step, with the half-step velocity v' = v + a dt/2 (Eq. 5.27):
//   x <- x + v' dt (5.25) | density, pressure, stress at the new x with v' | a (5.20) | v <- v' + a dt/2
//   (5.26)
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>

#include "sph/base/errors.hpp"
#include "sph/base/hdf5_file.hpp"
#include "sph/flow.hpp"
#include "sph/kernel.hpp"
#include "sph/parts.hpp"
#include "sph/terms.hpp"

namespace dem2sph {

template <class C>
class Solver final : public Flow {
 public:
  static constexpr int dim = C::dim;
  using V = Vec<dim>;
  using S = Sym<dim>;

  explicit Solver(FlowSetup<dim> setup)
      : setup_(std::move(setup)), kernel_(setup_.numerics.h), particles_(std::move(setup_.particles)) {
    dilation_.resize(particles_.size, setup_.initial_phi);
    dissipated_.assign(particles_.size, 0.0);
    if constexpr (C::Density::summed)
      shepard_.resize(particles_.size);
    else
      next_rho_.resize(particles_.size);
    if constexpr (C::Damping::limited) limiter_.assign(particles_.size, 1.0);
    boundary_rho0_.assign(particles_.size - particles_.interior, setup_.eos.rho0);
    sort_particles();
    build_list();
    if constexpr (C::Density::summed) {
      sum_density();
      for (std::size_t w = particles_.interior; w < particles_.size; ++w)
        boundary_rho0_[w - particles_.interior] = setup_.numerics.boundary_density_factor * particles_.rho[w];
      update_pressure();
    }
    if constexpr (C::Walls::extrapolated) {
      update_wall_velocity();
      update_wall_stress();
    } else {
      set_wall_velocity();
    }
    if constexpr (!C::Stress::elastic) update_direct_stress(0);
    update_acceleration();
    choose_step();
  }

  StepInfo step(double largest_dt) override {
    const double dt = std::min(next_.dt, largest_dt);
    // Written so that a NaN fails closed.
    if (!(dt > 1e-12 * setup_.numerics.h / sound_speed_))
      throw NumericalError(
          fmt::format("step {}: the time step has collapsed to {:g} s (bound: {}); use a smaller "
                      "flow.mach or a finer resolution",
                      steps_, dt, bound_names[static_cast<std::size_t>(next_.bound)]));
    const StepInfo taken = next_;
    dt_ = dt;
    kick_and_drift(dt);
    if (list_is_stale()) {
      check_particles();
      wrap_positions();
      sort_particles();
      build_list();
    }
    if constexpr (C::Density::summed) {
      sum_density();
      update_pressure();
      update_direct_stress(dt);
    } else {
      update_wall_velocity();
      update_state(dt);
      update_wall_stress();
    }
    update_acceleration();
    kick(dt);
    time_ += dt;
    ++steps_;
    choose_step();
    return taken;
  }

  double time() const override { return time_; }
  long steps() const override { return steps_; }
  std::size_t interior() const override { return particles_.interior; }
  std::size_t particles() const override { return particles_.size; }
  std::size_t pairs() const override { return list_.pairs(); }
  std::size_t bytes() const override {
    std::size_t total = list_.bytes();
    const_cast<Solver*>(this)->arrays([&](const char*, const char*, std::vector<double>& values) {
      total += values.capacity() * sizeof(double);
    });
    total += (particles_.id.capacity() + particles_.plane.capacity()) * sizeof(std::int64_t);
    return total;
  }
  std::vector<std::string> composition() const override {
    return {setup_.formulation,
            C::Kernel::name,
            C::Density::name,
            C::Walls::name,
            C::Stress::name,
            std::string("dilation ") + C::Dilation::name,
            std::string("damping ") + C::Damping::name};
  }

  Budgets budgets() const override {
    const Particles<dim>& q = particles_;
    Budgets b;
    b.potential = wrapped_potential_;
    const double G = shear_modulus();
    for (std::size_t i = 0; i < q.interior; ++i) {
      const V v = q.velocity(i);
      const V a = q.acceleration(i);
      const double speed2 = dot(v, v);
      b.mass += q.m[i];
      b.kinetic += 0.5 * q.m[i] * speed2;
      b.potential -= q.m[i] * dot(setup_.gravity, q.position(i));
      b.elastic += q.m[i] * setup_.eos.energy(q.rho[i]);
      if (C::Stress::elastic) b.elastic += q.m[i] / q.rho[i] * q.deviator(i).square() / (4 * G);
      b.dissipated += dissipated_[i];
      b.largest_speed = std::max(b.largest_speed, std::sqrt(speed2));
      for (std::size_t k = 0; k < dim; ++k) {
        b.momentum[k] += q.m[i] * v.c[k];
        b.wall_force[k] += q.m[i] * (a.c[k] - setup_.gravity.c[k]);
      }
      if (!(q.p[i] > 0 && q.gamma_dot[i] > 0)) continue;
      const Material& material = setup_.material;
      const double I = inertial_number(q.gamma_dot[i], q.p[i], material.grains.d, material.grains.rho_s);
      b.flowing += q.m[i];
      const bool known = setup_.law_range.highest > 0;  // a law given by hand states no range
      if (known && !(I >= setup_.law_range.lowest && I <= setup_.law_range.highest)) b.outside_data += q.m[i];
      if constexpr (C::Dilation::on) {
        const double beta = dilation_.beta[i];
        const DilationLaw& law = material.dilation;
        if (beta <= law.limits.lowest || beta >= law.limits.highest) b.beta_limited += q.m[i];
        if (law.phi_eq(I) <= law.phi_eq.phi_min) b.phi_at_floor += q.m[i];
      }
    }
    return b;
  }

  Frame frame() const override {
    const Particles<dim>& q = particles_;
    Frame f;
    f.time = time_;
    f.step = steps_;
    f.dimension = dim;
    const auto field = [&](const char* name, const char* unit, std::size_t components, auto&& value) {
      FrameField column{name, unit, components, {}};
      column.values.reserve(q.size * components);
      for (std::size_t i = 0; i < q.size; ++i) value(i, column.values);
      f.fields.push_back(std::move(column));
    };
    const auto vector = [](const std::array<std::vector<double>, dim>& source) {
      return [&source](std::size_t i, std::vector<double>& out) {
        for (std::size_t k = 0; k < 3; ++k)
          out.push_back(k < dim ? source[std::min<std::size_t>(k, dim - 1)][i] : 0.0);
      };
    };
    field("x", "m", 3, vector(q.x));
    field("v", "m/s", 3, vector(q.v));
    field("rho", "kg/m^3", 1, [&](std::size_t i, auto& out) { out.push_back(q.rho[i]); });
    field("p", "Pa", 1, [&](std::size_t i, auto& out) { out.push_back(q.p[i]); });
    field("stress", "Pa", 6, [&](std::size_t i, auto& out) {  // xx yy zz xy xz yz, tension positive
      const S s = q.deviator(i);
      for (int k = 0; k < 6; ++k) out.push_back(k < 3 ? s[k] - q.p[i] : k < S::size ? s[k] : 0.0);
    });
    field("gamma_dot", "1/s", 1, [&](std::size_t i, auto& out) { out.push_back(q.gamma_dot[i]); });
    field("mu", "1", 1, [&](std::size_t i, auto& out) {
      out.push_back(q.p[i] > 0 ? equivalent_stress(q.deviator(i)) / q.p[i] : 0.0);
    });
    if constexpr (C::Dilation::on) {
      field("phi", "1", 1, [&](std::size_t i, auto& out) { out.push_back(dilation_.phi[i]); });
      field("beta", "1", 1, [&](std::size_t i, auto& out) { out.push_back(dilation_.beta[i]); });
    }
    field("id", "1", 1, [&](std::size_t i, auto& out) { out.push_back(static_cast<double>(q.id[i])); });
    field("kind", "1", 1, [&](std::size_t i, auto& out) { out.push_back(i < q.interior ? 0.0 : 1.0); });
    return f;
  }

  void deposit(std::vector<std::array<double, 3>>& positions, std::vector<double>& volumes) const override {
    positions.assign(particles_.interior, {0, 0, 0});
    volumes.resize(particles_.interior);
    for (std::size_t i = 0; i < particles_.interior; ++i) {
      for (std::size_t k = 0; k < dim; ++k) positions[i][k] = particles_.x[k][i];
      volumes[i] = particles_.m[i] / setup_.eos.rho0;
    }
  }

  void save(const std::filesystem::path& path, const std::string& key,
            const std::string& note) const override {
    Hdf5Writer file(path);
    file.attribute("/", "format", std::string("dem2sph-checkpoint"));
    file.attribute("/", "schema_version", std::int64_t{1});
    file.attribute("/", "key", key);
    file.attribute("/", "note", note);
    file.attribute("/", "time", time_);
    file.attribute("/", "steps", std::int64_t{steps_});
    file.attribute("/", "wrapped_potential", wrapped_potential_);
    const_cast<Solver*>(this)->arrays(
        [&, k = 0](const char* name, const char* unit, std::vector<double>& values) mutable {
          file.write(fmt::format("state/{:03}_{}", k++, name), values, unit);
        });
    file.write("id", particles_.id, "1");
    file.write("plane", particles_.plane, "1");
    file.commit();
  }

  std::string load(const std::filesystem::path& path, const std::string& key) override {
    const Hdf5Reader file(path, "dem2sph-checkpoint", 1);
    if (file.text_attribute("/", "key") != key)
      throw InputError(fmt::format(
          "{}: is a checkpoint of another case, law or version; use --force to start anew", path.string()));
    time_ = file.number_attribute("/", "time");
    steps_ = file.integer_attribute("/", "steps");
    wrapped_potential_ = file.number_attribute("/", "wrapped_potential");
    arrays([&, k = 0](const char* name, const char* unit, std::vector<double>& values) mutable {
      const std::string dataset = fmt::format("state/{:03}_{}", k++, name);
      std::vector<double> read = file.doubles(dataset, unit);
      if (read.size() != values.size())
        throw InputError(
            fmt::format("{}: \"{}\" has another length than this case needs", path.string(), dataset));
      values = std::move(read);
    });
    particles_.id = file.integers("id", "1");
    particles_.plane = file.integers("plane", "1");
    // The list is that of the positions at its last build, so the next step sees the same pairs in the same
    // order.
    std::swap(particles_.x, listed_x_);
    list_.build(particles_, setup_.period, reach(), wanted());
    std::swap(particles_.x, listed_x_);
    choose_step();
    return file.text_attribute("/", "note");
  }

 private:
  // ---- pairs
  // ------------------------------------------------------------------------------------------------------
  Pair<dim> pair(const V& x_a, std::size_t b) const {
    Pair<dim> q;
    q.r = setup_.period.shortest(x_a - particles_.position(b));
    q.distance = norm(q.r);
    const KernelValue k = kernel_(q.distance);
    q.w = k.w;
    q.f = k.f;
    q.grad_w = k.f * q.r;
    return q;
  }
  /// Only the kernel's value: density and extrapolation need no gradient.
  double weight(const V& x_a, std::size_t b) const {
    return kernel_(norm(setup_.period.shortest(x_a - particles_.position(b)))).w;
  }
  const Plane<dim>& plane_of(std::size_t w) const {
    return setup_.planes[static_cast<std::size_t>(particles_.plane[w])];
  }
  static std::size_t index(std::int32_t b) { return static_cast<std::size_t>(b); }
  double shear_modulus() const { return setup_.numerics.G_over_K * setup_.eos.K; }

  // ---- lists and order
  // --------------------------------------------------------------------------------------------
  template <class F>
  void arrays(F&& f) {
    particles_.arrays(f);
    dilation_.arrays(f);
    f("dissipated", "J", dissipated_);
    for (auto& c : listed_x_) f("listed_x", "m", c);
    f("boundary_rho0", "kg/m^3", boundary_rho0_);
    if constexpr (C::Damping::limited) f("limiter", "1", limiter_);
    if constexpr (C::Density::summed)
      f("shepard", "1", shepard_);
    else
      f("next_rho", "kg/m^3", next_rho_);
  }
  double reach() const { return kernel_.support() * (1 + setup_.numerics.skin); }
  static PairList::Wanted wanted() {
    return {.wall_sees_interior = true, .wall_sees_wall = C::Density::summed};
  }
  void build_list() {
    list_.build(particles_, setup_.period, reach(), wanted());
    listed_x_ = particles_.x;
  }
  /// True once two particles together may have moved by the skin.
  bool list_is_stale() const {
    const double limit = 0.5 * setup_.numerics.skin * kernel_.support();
    const double limit2 = limit * limit;
    double largest = 0;
    bool broken = false;
#pragma omp parallel for schedule(static) reduction(max : largest) reduction(|| : broken)
    for (std::size_t i = 0; i < particles_.size; ++i) {
      double moved = 0;
      for (std::size_t k = 0; k < dim; ++k) {
        const double step = particles_.x[k][i] - listed_x_[k][i];
        moved += step * step;
      }
      largest = std::max(largest, moved);
      broken = broken || !(moved <= 1e300);
    }
    if (broken) name_broken_particle();
    return largest > limit2;
  }
  void sort_particles() {
    const std::vector<std::int32_t> order = spatial_order(particles_, 2 * setup_.numerics.dx);
    const auto permute = [&](auto& values) {
      if (values.size() != order.size()) return;
      auto sorted = values;
      for (std::size_t i = 0; i < order.size(); ++i) sorted[i] = values[index(order[i])];
      values = std::move(sorted);
    };
    std::vector<double> walls(particles_.size, 0.0);  // boundary_rho0_ has one entry a wall particle only
    std::copy(boundary_rho0_.begin(), boundary_rho0_.end(),
              walls.begin() + static_cast<std::ptrdiff_t>(particles_.interior));
    arrays([&](const char*, const char*, std::vector<double>& values) {
      if (&values != &boundary_rho0_) permute(values);
    });
    permute(walls);
    std::copy(walls.begin() + static_cast<std::ptrdiff_t>(particles_.interior), walls.end(),
              boundary_rho0_.begin());
    permute(particles_.id);
    permute(particles_.plane);
  }
  void wrap_positions() {
    for (int k = 0; k + 1 < dim; ++k) {
      const double length = setup_.period.length[k];
      if (!std::isfinite(length)) continue;
      std::vector<double>& x = particles_.x[static_cast<std::size_t>(k)];
      for (std::size_t i = 0; i < particles_.size; ++i) {
        const double shift = length * std::floor(x[i] / length);
        x[i] -= shift;
        // What gravity has done along a periodic direction does not come back with the position.
        if (i < particles_.interior) wrapped_potential_ -= particles_.m[i] * setup_.gravity[k] * shift;
      }
    }
  }

  // ---- guards
  // -----------------------------------------------------------------------------------------------------
  [[noreturn]] void name_broken_particle() const {
    for (std::size_t i = 0; i < particles_.size; ++i)
      for (std::size_t k = 0; k < dim; ++k)
        if (!std::isfinite(particles_.x[k][i]))
          throw NumericalError(
              fmt::format("step {}: the position of particle {} is no longer a finite number (its "
                          "velocity was integrated from an acceleration that was not); use a smaller "
                          "flow.step_factor",
                          steps_, particles_.id[i]));
    throw NumericalError(fmt::format("step {}: a particle has left the range of numbers", steps_));
  }
  /// No particle passes a wall, ever: one whose centre lies behind a wall's surface ends the run.
  void check_particles() const {
    for (std::size_t i = 0; i < particles_.interior; ++i) {
      const V x = particles_.position(i);
      for (const Plane<dim>& plane : setup_.planes)
        if (!(plane.distance(x) >= 0))
          throw NumericalError(
              fmt::format("step {}: particle {} has passed a wall (its centre is {:g} dx behind it); use a "
                          "larger sound speed "
                          "(a smaller flow.mach) or a smaller flow.step_factor",
                          steps_, particles_.id[i], -plane.distance(x) / setup_.numerics.dx));
      if (setup_.floor_end > 0 && x[0] > setup_.floor_end)
        throw NumericalError(
            fmt::format("step {}: particle {} has run over the end of the floor at x = {:g} m; use a "
                        "larger column.floor_length",
                        steps_, particles_.id[i], setup_.floor_end));
    }
  }

  // ---- time
  // -------------------------------------------------------------------------------------------------------
  void kick_and_drift(double dt) {
#pragma omp parallel for schedule(static)
    for (std::size_t i = 0; i < particles_.interior; ++i)
      for (std::size_t k = 0; k < dim; ++k) {
        particles_.v[k][i] += 0.5 * dt * particles_.a[k][i];
        particles_.x[k][i] += dt * particles_.v[k][i];
      }
  }
  void kick(double dt) {
#pragma omp parallel for schedule(static)
    for (std::size_t i = 0; i < particles_.interior; ++i)
      for (std::size_t k = 0; k < dim; ++k) particles_.v[k][i] += 0.5 * dt * particles_.a[k][i];
  }

  /// Eq. 5.28 (given) from the state at the end of a step.
  void choose_step() {
    const Particles<dim>& q = particles_;
    const double h = kernel_.h();
    const double G = C::Stress::elastic ? shear_modulus() : 0;
    double largest_c2 = 0;
    double largest_a2 = 0;
    double largest_viscosity = 0;  // eta/rho [m^2/s]
#pragma omp parallel for schedule(static) reduction(max : largest_c2, largest_a2, largest_viscosity)
    for (std::size_t i = 0; i < q.interior; ++i) {
      // The elastic part stiffens the longitudinal wave.
      const double c2 = (setup_.eos.bulk_modulus(q.rho[i]) + 4.0 / 3 * G) / q.rho[i];
      const V a = q.acceleration(i);
      largest_c2 = std::max(largest_c2, c2);
      largest_a2 = std::max(largest_a2, dot(a, a));
      if constexpr (!C::Stress::elastic) {
        const double tau = equivalent_stress(q.deviator(i));
        const double strength =
            std::max(tau, setup_.material.friction.mu_l * q.p[i] + setup_.material.cohesion);
        largest_viscosity = std::max(
            largest_viscosity, strength / std::max(q.gamma_dot[i], setup_.numerics.gamma_dot_min) / q.rho[i]);
      }
    }
    sound_speed_ = std::sqrt(largest_c2);
    const std::array<double, 3> bounds{
        0.25 * h / sound_speed_, 0.25 * std::sqrt(h / std::sqrt(std::max(largest_a2, 1e-300))),
        largest_viscosity > 0 ? 0.125 * h * h / largest_viscosity : std::numeric_limits<double>::infinity()};
    const auto least = std::min_element(bounds.begin(), bounds.end());
    next_ = {setup_.numerics.step_factor * *least, static_cast<Bound>(least - bounds.begin())};
    // min and max pass over a NaN: it is looked for where it would come from.
    for (std::size_t i = 0; i < q.interior; ++i)
      if (!(q.rho[i] > 0))
        throw NumericalError(
            fmt::format("step {}: the density of particle {} is {}", steps_, q.id[i], q.rho[i]));
  }

  // ---- density and pressure
  // ---------------------------------------------------------------------------------------
  /// Eqs. 5.17 and 5.18 (given) over all particles, walls included.
  void sum_density() {
    Particles<dim>& q = particles_;
    const double self = kernel_(0).w;
#pragma omp parallel for schedule(static)
    for (std::size_t a = 0; a < q.size; ++a) {
      const V x = q.position(a);
      double sum = q.m[a] * self;
      for (const std::int32_t b : list_.all_of(a)) sum += q.m[index(b)] * weight(x, index(b));
      shepard_[a] = sum;
    }
#pragma omp parallel for schedule(static)
    for (std::size_t a = 0; a < q.size; ++a) {
      const V x = q.position(a);
      double sum = q.m[a] / shepard_[a] * self;
      for (const std::int32_t b : list_.all_of(a))
        sum += q.m[index(b)] / shepard_[index(b)] * weight(x, index(b));
      q.rho[a] = shepard_[a] / sum;
    }
  }
  void update_pressure() {
    Particles<dim>& q = particles_;
#pragma omp parallel for schedule(static)
    for (std::size_t a = 0; a < q.size; ++a) {
      EquationOfState eos = setup_.eos;
      if (a >= q.interior) eos.rho0 = boundary_rho0_[a - q.interior];
      q.p[a] = eos.pressure(q.rho[a]);
    }
  }

  // ---- stress without elasticity (source)
  // ---------------------------------------------------------------------------
  void update_direct_stress(double dt) {
    Particles<dim>& q = particles_;
    const Material& material = setup_.material;
#pragma omp parallel for schedule(static)
    for (std::size_t a = 0; a < q.size; ++a) {
      const V x = q.position(a);
      const V v = q.velocity(a);
      const bool wall = a >= q.interior;
      Gradient<dim> l;
      for (const std::int32_t i : list_.interior_of(a)) {
        const std::size_t b = index(i);
        const V difference = wall ? q.velocity(b) - seen_wall_velocity(a, b) : q.velocity(b) - v;
        add_velocity_gradient(l, q.m[b] / q.rho[b], difference, pair(x, b));
      }
      for (const std::int32_t i : list_.walls_of(a)) {
        const std::size_t b = index(i);
        const V difference = wall ? q.velocity(b) - v : seen_wall_velocity(b, a) - v;
        add_velocity_gradient(l, q.m[b] / q.rho[b], difference, pair(x, b));
      }
      S rate = deviator(strain_rate(l));
      const double gamma_dot = shear_rate(rate);
      q.gamma_dot[a] = gamma_dot;
      if (q.p[a] > 0) {
        double beta = 0;
        const double I = inertial_number(gamma_dot, q.p[a], material.grains.d, material.grains.rho_s);
        if constexpr (C::Dilation::on) {
          if (!wall) {
            const DilationLaw::State state = material.dilation.after(dilation_.phi[a], I, gamma_dot * dt);
            dilation_.phi[a] = state.phi;
            dilation_.beta[a] = beta = state.beta;
          }
        }
        const double eta = direct_viscosity(std::max(friction(material.friction, I, beta), 0.0), q.p[a],
                                            material.cohesion, gamma_dot, setup_.numerics.gamma_dot_min);
        rate *= 2 * eta;
        q.set_deviator(a, rate);
        if (!wall) dissipated_[a] += dt * q.m[a] / q.rho[a] * eta * gamma_dot * gamma_dot;
      } else {
        q.set_deviator(a, S{});
        if constexpr (C::Dilation::on) dilation_.beta[a] = 0;
      }
    }
  }
  V seen_wall_velocity(std::size_t wall, std::size_t interior_particle) const {
    const Plane<dim>& plane = plane_of(wall);
    const V own = boundary_velocity(particles_.velocity(interior_particle), plane.velocity,
                                    plane.distance(particles_.position(interior_particle)),
                                    -plane.distance(particles_.position(wall)), setup_.numerics.B_max);
    if (plane.rough) return own;
    // Frictionless: only the normal component is artificial.
    const V v = particles_.velocity(interior_particle);
    return v + dot(own - v, plane.normal) * plane.normal;
  }
  void set_wall_velocity() {
    for (std::size_t w = particles_.interior; w < particles_.size; ++w)
      Particles<dim>::store(particles_.v, w, plane_of(w).velocity);
  }

  // ---- continuity, elastic stress and return (robust)
  // ---------------------------------------------------------------
  void update_state(double dt) {
    Particles<dim>& q = particles_;
    const NumericalParameters& n = setup_.numerics;
    const double c0 = std::sqrt(setup_.eos.K / setup_.eos.rho0);
    const double hydrostatic_slope = setup_.eos.rho0 * setup_.gravity[dim - 1] / (c0 * c0);
    const double diffusion = n.delta * n.h * c0;
    const double G = shear_modulus();
#pragma omp parallel for schedule(static)
    for (std::size_t a = 0; a < q.interior; ++a) {
      const V x = q.position(a);
      const V v = q.velocity(a);
      Gradient<dim> l;
      double diffused = 0;
      for (const std::int32_t i : list_.interior_of(a)) {
        const std::size_t b = index(i);
        const Pair<dim> ab = pair(x, b);
        const double volume = q.m[b] / q.rho[b];
        add_velocity_gradient(l, volume, q.velocity(b) - v, ab);
        diffused += density_diffusion<dim>(q.rho[b] - q.rho[a], hydrostatic_slope, volume, ab);
      }
      for (const std::int32_t i : list_.walls_of(a)) {
        const std::size_t b = index(i);
        add_velocity_gradient(l, q.m[b] / q.rho[b], q.velocity(b) - v, pair(x, b));
      }
      if constexpr (C::Damping::limited) {
        const double compression = std::abs(l.trace());
        limiter_[a] = compression / (compression + shear_rate(deviator(strain_rate(l))) + 1e-4 * c0 / n.h);
      }
      next_rho_[a] = q.rho[a] + dt * (-q.rho[a] * l.trace() + diffusion * diffused);
      q.p[a] = setup_.eos.pressure(next_rho_[a]);
      return_to_yield(a, l, G, dt);
    }
    // Walls keep the density that their pressure gives them: update_wall_stress.
    std::copy(next_rho_.begin(), next_rho_.begin() + static_cast<std::ptrdiff_t>(q.interior), q.rho.begin());
  }

  void return_to_yield(std::size_t a, const Gradient<dim>& l, double G, double dt) {
    Particles<dim>& q = particles_;
    const Material& material = setup_.material;
    const double p = q.p[a];
    const S rate = deviator(strain_rate(l));
    if (!(p > 0)) {  // tension cut-off: separated grains carry no stress
      q.set_deviator(a, S{});
      q.gamma_dot[a] = shear_rate(rate);
      if constexpr (C::Dilation::on) dilation_.beta[a] = 0;
      return;
    }
    S s = rotate(q.deviator(a), l, dt);
    for (int k = 0; k < S::size; ++k) s[k] += 2 * G * dt * rate[k];
    const double trial = equivalent_stress(s);
    Returned returned;
    if constexpr (C::Dilation::on) {
      const double to_I = material.grains.d / std::sqrt(p / material.grains.rho_s);
      const double phi = dilation_.phi[a];
      const auto strength = [&](double g) {
        const double beta = material.dilation.after(phi, g * to_I, g * dt).beta;
        return std::max(friction(material.friction, g * to_I, beta), 0.0) * p + material.cohesion;
      };
      returned = return_by_newton(trial, G * dt, strength);
      const DilationLaw::State state =
          material.dilation.after(phi, returned.gamma_dot * to_I, returned.gamma_dot * dt);
      dilation_.phi[a] = state.phi;
      dilation_.beta[a] = state.beta;
    } else {
      returned = return_rational(material.friction, material.grains, trial, p, G * dt, 0, material.cohesion);
    }
    if (returned.gamma_dot > 0) {
      s *= returned.tau / trial;
      dissipated_[a] += dt * q.m[a] / next_rho_[a] * returned.tau * returned.gamma_dot;
    }
    q.set_deviator(a, s);
    q.gamma_dot[a] = returned.gamma_dot;
  }

  // ---- extrapolated walls (Adami, Hu, Adams 2012)
  // -------------------------------------------------------------------
  /// Velocity that makes the profile vanish, relative to the wall, at its surface; normal component only if
  /// smooth.
  void update_wall_velocity() {
    Particles<dim>& q = particles_;
#pragma omp parallel for schedule(static)
    for (std::size_t w = q.interior; w < q.size; ++w) {
      const Plane<dim>& plane = plane_of(w);
      const V x = q.position(w);
      V mean;
      double sum = 0;
      for (const std::int32_t i : list_.interior_of(w)) {
        const double weight_i = weight(x, index(i));
        mean += weight_i * q.velocity(index(i));
        sum += weight_i;
      }
      V seen = plane.velocity;
      if (sum > 0) {
        mean *= 1 / sum;
        const V relative = mean - plane.velocity;
        seen =
            plane.rough ? plane.velocity - relative : mean - 2 * dot(relative, plane.normal) * plane.normal;
      }
      Particles<dim>::store(q.v, w, seen);
    }
  }
  /// Pressure with the weight between a wall particle and the material; the deviatoric stress keeps its ratio
  /// to it.
  void update_wall_stress() {
    Particles<dim>& q = particles_;
#pragma omp parallel for schedule(static)
    for (std::size_t w = q.interior; w < q.size; ++w) {
      const Plane<dim>& plane = plane_of(w);
      const V x = q.position(w);
      double sum = 0;
      double p_sum = 0;
      V moment;  // sum of rho (x_w - x_b) W
      S s_sum;
      for (const std::int32_t i : list_.interior_of(w)) {
        const std::size_t b = index(i);
        const V r = setup_.period.shortest(x - q.position(b));
        const double weight_b = kernel_(norm(r)).w;
        sum += weight_b;
        p_sum += weight_b * q.p[b];
        moment += (weight_b * q.rho[b]) * r;
        S s = q.deviator(b);
        s_sum += (s *= weight_b);
      }
      double p = 0;
      S s;
      if (sum > 0) {
        // Only gravity normal to the wall is carried by it.
        const double normal_weight = dot(setup_.gravity, plane.normal) * dot(moment, plane.normal);
        p = std::max((p_sum + normal_weight) / sum, 0.0);
        if (p_sum > 0) {
          s = s_sum;
          s *= p / p_sum;
          if (!plane.rough) s = mirror(s, plane.normal);
        }
      }
      q.p[w] = p;
      q.rho[w] = setup_.eos.density(p);
      q.set_deviator(w, s);
    }
  }

  // ---- momentum
  // -----------------------------------------------------------------------------------------------------
  void update_acceleration() {
    Particles<dim>& q = particles_;
    const NumericalParameters& n = setup_.numerics;
    const double c0 = std::sqrt(setup_.eos.K / setup_.eos.rho0);
#pragma omp parallel for schedule(static)
    for (std::size_t a = 0; a < q.interior; ++a) {
      const V x = q.position(a);
      const V v = q.velocity(a);
      const S own = stress_over_density_squared(q.deviator(a), q.p[a], q.rho[a]);
      V acceleration = setup_.gravity;
      double damped = 0;
      for (const std::int32_t i : list_.interior_of(a)) {
        const std::size_t b = index(i);
        const Pair<dim> ab = pair(x, b);
        S sum = stress_over_density_squared(q.deviator(b), q.p[b], q.rho[b]);
        sum += own;
        if constexpr (C::Damping::on) {
          const V difference = v - q.velocity(b);
          const double alpha = C::Damping::limited ? 0.5 * n.alpha * (limiter_[a] + limiter_[b]) : n.alpha;
          const double viscous =
              artificial_viscosity<dim>(alpha, c0, n.h, 0.5 * (q.rho[a] + q.rho[b]), difference, ab);
          for (int k = 0; k < dim; ++k) sum[k] -= viscous;
          damped += 0.5 * q.m[a] * q.m[b] * viscous * dot(difference, ab.grad_w);
        }
        add_stress_divergence(acceleration, q.m[b], sum, ab);
      }
      for (const std::int32_t i : list_.walls_of(a)) {
        const std::size_t b = index(i);
        S sum = stress_over_density_squared(q.deviator(b), q.p[b], q.rho[b]);
        sum += own;
        add_stress_divergence(acceleration, q.m[b], sum, pair(x, b));
      }
      Particles<dim>::store(q.a, a, acceleration);
      if constexpr (C::Damping::on) dissipated_[a] += dt_ * damped;
    }
  }

  FlowSetup<dim> setup_;
  typename C::Kernel kernel_;
  Particles<dim> particles_;
  typename C::Dilation dilation_;
  std::vector<double> dissipated_;  // J since t = 0
  std::vector<double> shepard_;     // rho~ of Eq. 5.17
  std::vector<double> next_rho_;    // density at the end of the step, while neighbours still read the old one
  std::vector<double> limiter_;     // of the damping, in [0, 1]
  std::vector<double> boundary_rho0_;  // of each wall particle
  std::array<std::vector<double>, dim> listed_x_;
  PairList list_;
  double wrapped_potential_ = 0;  // [J], of particles that came round a periodic direction
  double time_ = 0;
  long steps_ = 0;
  double sound_speed_ = 0;
  double dt_ = 0;  // of the step under way
  StepInfo next_;
};

}  // namespace dem2sph
