// The solver: Algorithm 1 (given) over the parts of a composition. Its passes are in passes.hpp and
// constitutive.hpp; which variants of them run is decided when the solver is made.
//
// One step, with the half-step velocity v' = v + a dt/2 (Eq. 5.27):
//   x <- x + v' dt (5.25) | density, pressure, stress at the new x with v' | a (5.20) | v <- v' + a dt/2
//   (5.26)
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <variant>

#include "sph/base/errors.hpp"
#include "sph/base/hdf5_file.hpp"
#include "sph/constitutive.hpp"
#include "sph/flow.hpp"
#include "sph/material.hpp"
#include "sph/passes.hpp"

namespace dem2sph {

template <int Dim>
class Solver final : public Flow {
 public:
  using V = Vec<Dim>;
  using S = Sym<Dim>;

  explicit Solver(FlowSetup<Dim> setup)
      : setup_(std::move(setup)),
        parts_(setup_.parts),
        kernel_(make_kernel<Dim>(parts_.kernel, setup_.h)),
        q_(std::move(setup_.particles)) {
    allocate();
    for (const Wall<Dim>& wall : setup_.walls) {
      wall_forces_.basal = wall_forces_.basal || !std::isnan(wall.basal_friction);
      wall_forces_.smooth = wall_forces_.smooth || !wall.rough;
      wall_forces_.moving = wall_forces_.moving || wall.moves();
    }
    wall_forces_.sliders = wall_forces_.basal && !own_wall_state();
    wrap_positions();
    sort_particles();
    build_list();
    prepare_boundary();
    evaluate(0);
    choose_step();
  }

  StepInfo step(double largest_dt) override {
    const double dt = std::min(next_.dt, largest_dt);
    check_step();
    const StepInfo taken = next_;
    kick_and_drift(dt);
    if (wall_forces_.moving) {
      move_walls(dt);
      for_particles(0, q_.interior, [&](std::size_t i) { keep_off_walls(i); });
    }
    check_particles();
    if (list_is_stale()) {
      wrap_positions();
      sort_particles();
      build_list();
    }
    if (shifting()) shift(dt);
    evaluate(dt);
    kick(dt);
    if (const Xsph* averaging = std::get_if<Xsph>(&parts_.averaging))
      with_kernel([&](const auto& kernel) { averaging_pass(q_, around(), kernel, averaging->epsilon); });
    time_ += dt;
    ++steps_;
    choose_step();
    return taken;
  }

  double time() const override { return time_; }
  long steps() const override { return steps_; }
  std::size_t interior() const override { return q_.interior; }
  std::size_t particles() const override { return q_.size; }
  std::size_t pairs() const override { return list_.pairs(); }
  std::size_t bytes() const override {
    std::size_t total = list_.bytes();
    for (const ArrayInUse& array : arrays_in_use()) total += array.bytes;
    return total;
  }
  std::vector<ArrayInUse> arrays_in_use() const override {
    std::vector<ArrayInUse> result;
    const auto add = [&](const char* name, const char* unit, std::size_t bytes) {
      if (bytes == 0) return;
      if (result.empty() || result.back().name != name) result.push_back({name, unit, 0, 0});
      ++result.back().components;
      result.back().bytes += bytes;
    };
    const_cast<Solver*>(this)->arrays([&](const char* name, const char* unit, Column& values) {
      add(name, unit, values.capacity() * sizeof(double));
    });
    add("volume", "m^3", q_.volume.capacity() * sizeof(double));
    add("id", "1", q_.id.capacity() * sizeof(std::int64_t));
    add("wall", "1", q_.wall.capacity() * sizeof(std::int64_t));
    return result;
  }

  std::vector<std::string> composition() const override {
    std::vector<std::string> words{
        setup_.formulation,
        parts_.kernel,
        name_of(parts_.density),
        name_of(parts_.walls),
        name_of(parts_.stress),
        "friction " + friction_name(),
        "dilation " + name_of(parts_.dilation) + (parts_.swelling ? ", swelling" : ""),
        "damping " + name_of(parts_.damping)};
    if (corrected()) words.push_back("correction " + name_of(parts_.correction));
    if (!std::holds_alternative<NoAveraging>(parts_.averaging))
      words.push_back("averaging " + name_of(parts_.averaging));
    if (shifting()) words.push_back("shifting " + name_of(parts_.shifting));
    return words;
  }

  PassList passes() const override {
    PassList list;
    const auto pass = [&](const std::string& what) { list.passes.push_back(what); };
    const auto out = [&](const std::string& what) { list.left_out.push_back(what); };
    const bool summed = std::visit([]<class D>(const D&) { return is_summed<D>; }, parts_.density);
    const bool own = own_wall_state();
    if (!own) pass("wall velocity: wall particles over the material, W");
    if (corrected() || shifting())
      pass("first moment of grad W: material over all, 4 terms a pair in 2D, 9 in 3D");
    else
      out("first moment of grad W: a pass over pairs (gradient correction, shifting)");
    if (summed) {
      pass("density sum, Eq. 5.17: all over all, W");
      if (std::holds_alternative<SummationShepard>(parts_.density))
        pass("Shepard filter, Eq. 5.18: all over all, W");
      else
        out("Shepard filter, Eq. 5.18: a pass over pairs, rho_tilde");
      out("rate of density: rho_rate, two terms a pair");
    } else {
      out("density sums, Eqs. 5.17 and 5.18: two passes over pairs" +
          std::string(own ? "" : ", wall-wall pairs"));
    }
    pass(fmt::format("velocity gradient, Eq. 5.21{}: {} over all", summed ? "" : ", and d(rho)/dt",
                     own ? "all" : "material"));
    pass(fmt::format("pressure and stress ({}{}): particle by particle", name_of(parts_.stress),
                     std::visit([]<class D>(const D&) { return has_dilation_state<D>; }, parts_.dilation)
                         ? ", Newton with dilation"
                         : ""));
    const bool extrapolates =
        std::visit([]<class W>(const W&) { return W::extrapolates_stress; }, parts_.walls);
    if (extrapolates) pass("wall stress: wall particles over the material, W");
    pass("momentum, Eq. 5.20: material over all" +
         (std::holds_alternative<NoDamping>(parts_.damping) ? std::string() : ", with damping"));
    if (std::holds_alternative<NoDilation>(parts_.dilation))
      out("dilation: beta, its state and I, the Newton of the return");
    if (std::holds_alternative<NoDamping>(parts_.damping)) out("damping: about 12 flops a pair");
    if (!std::holds_alternative<BalsaraDamping>(parts_.damping))
      out("limiter of the damping: 8 bytes a particle");
    if (std::holds_alternative<NoAveraging>(parts_.averaging))
      out("velocity averaging: a pass over pairs");
    else
      pass("velocity averaging (XSPH): material over material, W");
    if (shifting())
      pass("shifting (Sun et al. 2017): material over all");
    else
      out("shifting: two passes over pairs, lambda");
    if (std::holds_alternative<DirectStress>(parts_.stress))
      out("elastic predictor, its rotation and the return");
    else
      out("g_min and the viscous bound of 5.28: the return is implicit");
    if (!parts_.swelling) out("swelling: rho0 of each particle");
    if (!wall_forces_.basal) out("basal friction: mu_b in wall pairs");
    if (!wall_forces_.moving) out("moving walls: their motion and their work");
    return list;
  }

  Budgets budgets() const override {
    Budgets b;
    b.potential = wrapped_potential_;
    b.sheared = sheared_;
    b.damped = damped_;
    b.cut_off = cut_off_;
    b.slid = slid_;
    b.dissipated = sheared_ + damped_ + cut_off_ + slid_;
    b.diffused = diffused_;
    b.from_walls = from_walls_;
    b.swollen = swollen_;
    b.sound_speed = reference_sound_speed();
    const ElasticReturn* elastic = std::get_if<ElasticReturn>(&parts_.stress);
    for (std::size_t i = 0; i < q_.interior; ++i) {
      const V v = q_.velocity(i);
      const V a = q_.acceleration(i);
      const double speed2 = dot(v, v);
      b.mass += q_.m[i];
      b.kinetic += 0.5 * q_.m[i] * speed2;
      b.potential -= q_.m[i] * dot(setup_.gravity, q_.position(i));
      b.elastic += q_.m[i] * setup_.eos.energy(q_.rho[i], q_.rho0.empty() ? setup_.eos.rho0 : q_.rho0[i]);
      if (elastic) b.elastic += q_.m[i] / q_.rho[i] * q_.deviator(i).square() / (4 * elastic->G);
      b.largest_speed = std::max(b.largest_speed, std::sqrt(speed2));
      b.largest_compression =
          std::max(b.largest_compression, q_.rho[i] / (q_.rho0.empty() ? setup_.eos.rho0 : q_.rho0[i]));
      b.mean_speed += q_.m[i] * std::sqrt(speed2);
      for (std::size_t k = 0; k < Dim; ++k) {
        b.momentum[k] += q_.m[i] * v.c[k];
        b.wall_force[k] += q_.m[i] * (a.c[k] - setup_.gravity.c[k]);
      }
      if (!(q_.p[i] > 0 && q_.gamma_dot[i] > 0)) continue;
      const double I = inertial_number(q_.gamma_dot[i], q_.p[i], setup_.grains.d, setup_.grains.rho_s);
      b.flowing += q_.m[i];
      const bool known = setup_.law_range.highest > 0;  // a law given by hand states no range
      if (known && I < setup_.law_range.lowest) b.below_data += q_.m[i];
      if (known && !(I <= setup_.law_range.highest)) b.above_data += q_.m[i];
      if (std::visit([&](const auto& law) { return !(well_posedness(law, I, q_.gamma_dot[i]) <= 0); },
                     parts_.friction))
        b.ill_posed += q_.m[i];
      std::visit(
          [&]<class D>(const D& dilation) {
            if constexpr (std::is_same_v<D, DilationFromField>) {
              if (q_.beta[i] <= dilation.limits.lowest || q_.beta[i] >= dilation.limits.highest)
                b.beta_limited += q_.m[i];
            } else if constexpr (has_dilation_state<D>) {
              if (q_.beta[i] <= dilation.law.limits.lowest || q_.beta[i] >= dilation.law.limits.highest)
                b.beta_limited += q_.m[i];
              if (dilation.law.phi_eq(I) <= dilation.law.phi_eq.phi_min()) b.phi_at_floor += q_.m[i];
            }
          },
          parts_.dilation);
    }
    b.mean_speed /= b.mass;
    return b;
  }

  Frame frame() const override {
    Frame f;
    f.time = time_;
    f.step = steps_;
    f.dimension = Dim;
    const auto field = [&](const char* name, const char* unit, std::size_t components, auto&& value) {
      FrameField column{name, unit, components, {}};
      column.values.reserve(q_.size * components);
      for (std::size_t i = 0; i < q_.size; ++i) value(i, column.values);
      f.fields.push_back(std::move(column));
    };
    const auto vector = [](const auto& source) {
      return [&source](std::size_t i, std::vector<double>& out) {
        for (std::size_t k = 0; k < 3; ++k)
          out.push_back(k < Dim ? source[std::min<std::size_t>(k, Dim - 1)][i] : 0.0);
      };
    };
    const auto scalar = [](const Column& source) {
      // Walls have no value where only the material carries the array.
      return [&source](std::size_t i, std::vector<double>& out) {
        out.push_back(i < source.size() ? source[i] : 0.0);
      };
    };
    field("x", "m", 3, vector(q_.x));
    field("v", "m/s", 3, vector(q_.v));
    field("rho", "kg/m^3", 1, scalar(q_.rho));
    field("p", "Pa", 1, scalar(q_.p));
    field("stress", "Pa", 6, [&](std::size_t i, auto& out) {  // xx yy zz xy xz yz, tension positive
      const S s = q_.deviator(i);
      for (int k = 0; k < 6; ++k) out.push_back(k < 3 ? s[k] - q_.p[i] : k < S::size ? s[k] : 0.0);
    });
    field("gamma_dot", "1/s", 1, scalar(q_.gamma_dot));
    field("mu", "1", 1, [&](std::size_t i, auto& out) {
      out.push_back(q_.p[i] > 0 ? equivalent_stress(q_.deviator(i)) / q_.p[i] : 0.0);
    });
    if (std::holds_alternative<DilationEvolves>(parts_.dilation))
      field("phi", "1", 1, scalar(q_.dilation_state));
    if (!q_.beta.empty()) field("beta", "1", 1, scalar(q_.beta));
    field("id", "1", 1, [&](std::size_t i, auto& out) { out.push_back(static_cast<double>(q_.id[i])); });
    field("kind", "1", 1, [&](std::size_t i, auto& out) { out.push_back(i < q_.interior ? 0.0 : 1.0); });
    return f;
  }

  void deposit(std::vector<std::array<double, 3>>& positions, std::vector<double>& volumes) const override {
    positions.assign(q_.interior, {0, 0, 0});
    volumes.resize(q_.interior);
    for (std::size_t i = 0; i < q_.interior; ++i) {
      for (std::size_t k = 0; k < Dim; ++k) positions[i][k] = q_.x[k][i];
      volumes[i] = q_.m[i] / (q_.rho0.empty() ? setup_.eos.rho0 : q_.rho0[i]);
    }
  }

  void save(const std::filesystem::path& path, const std::string& key,
            const std::string& note) const override {
    Hdf5Writer file(path);
    file.attribute("/", "format", std::string("dem2sph-checkpoint"));
    file.attribute("/", "schema_version", std::int64_t{3});
    file.attribute("/", "key", key);
    file.attribute("/", "note", note);
    file.attribute("/", "steps", std::int64_t{steps_});
    const_cast<Solver*>(this)->scalars(
        [&](const char* name, double& value) { file.attribute("/", name, value); });
    const_cast<Solver*>(this)->arrays([&, k = 0](const char* name, const char* unit, Column& values) mutable {
      if (!values.empty()) file.write(fmt::format("state/{:03}_{}", k, name), values, unit);
      ++k;
    });
    file.write("id", q_.id, "1");
    file.write("wall", q_.wall, "1");
    file.commit();
  }

  std::string load(const std::filesystem::path& path, const std::string& key) override {
    const Hdf5Reader file(path, "dem2sph-checkpoint", 3);
    if (file.text_attribute("/", "key") != key)
      throw InputError(fmt::format(
          "{}: is a checkpoint of another case, law or version; use --force to start anew", path.string()));
    steps_ = file.integer_attribute("/", "steps");
    scalars([&](const char* name, double& value) { value = file.number_attribute("/", name); });
    arrays([&, k = 0](const char* name, const char* unit, Column& values) mutable {
      const std::string dataset = fmt::format("state/{:03}_{}", k++, name);
      if (values.empty()) return;
      Column read = file.doubles(dataset, unit);
      if (read.size() != values.size())
        throw InputError(
            fmt::format("{}: \"{}\" has another length than this case needs", path.string(), dataset));
      values = std::move(read);
    });
    q_.id = file.integers("id", "1");
    q_.wall = file.integers("wall", "1");
    if (q_.id.size() != q_.size || q_.wall.size() != q_.size)
      throw InputError(
          fmt::format("{}: \"id\" or \"wall\" has another length than this case needs", path.string()));
    // The list is that of the positions at its last build, so the next step sees the same pairs in the same
    // order.
    std::swap(q_.x, listed_x_);
    list_.build(q_, setup_.period, reach(), wanted());
    std::swap(q_.x, listed_x_);
    choose_step();
    return file.text_attribute("/", "note");
  }

 private:
  // ---- composition
  bool own_wall_state() const {
    return std::visit([]<class W>(const W&) { return has_own_state<W>; }, parts_.walls);
  }
  bool corrected() const { return !std::holds_alternative<NoCorrection>(parts_.correction); }
  bool shifting() const { return !std::holds_alternative<NoShifting>(parts_.shifting); }
  std::string friction_name() const {
    return std::visit([](const auto& law) { return std::string(law.name); }, parts_.friction);
  }
  Surroundings<Dim> around() const { return {list_, setup_.walls}; }
  double reference_sound_speed() const { return std::sqrt(setup_.eos.K / setup_.eos.rho0); }
  template <class F>
  decltype(auto) with_kernel(F&& f) const {
    return std::visit(std::forward<F>(f), kernel_);
  }

  /// The arrays of the parts that are on.
  void allocate() {
    const bool own = own_wall_state();
    const std::size_t stressed = own ? q_.size : q_.interior;
    std::visit(
        [&]<class D>(const D&) {
          if constexpr (std::is_same_v<D, SummationShepard>) q_.rho_tilde.assign(q_.size, 0.0);
          if constexpr (!is_summed<D>) q_.rho_rate.assign(stressed, 0.0);
        },
        parts_.density);
    if (own || parts_.swelling) q_.rho0.assign(q_.size, setup_.eos.rho0);
    std::visit(
        [&]<class D>(const D& dilation) {
          if constexpr (!std::is_same_v<D, NoDilation>) q_.beta.assign(q_.interior, 0.0);
          if constexpr (has_dilation_state<D>) {
            const DilationState start = dilation.law.start(setup_.initial_phi);
            q_.dilation_state.assign(q_.interior, start.value);
            q_.dilation_I.assign(q_.interior, start.I);
          }
        },
        parts_.dilation);
    if (std::holds_alternative<BalsaraDamping>(parts_.damping)) q_.limiter.assign(q_.interior, 1.0);
    if (!std::holds_alternative<NoAveraging>(parts_.averaging))
      for (Column& c : q_.averaged) c.assign(q_.interior, 0.0);
    if (corrected())
      for (Column& c : q_.correction) c.assign(q_.interior, 0.0);
    if (shifting()) q_.lambda.assign(q_.interior, 1.0);
  }

  /// Boundary particles keep the density that the rule of the source gives them: rho0 3 % below their initial
  /// one.
  void prepare_boundary() {
    const auto prepare = [&]<class W>(const W& walls) {
      if constexpr (has_own_state<W>) {
        sum_density();
        for (std::size_t w = q_.interior; w < q_.size; ++w) q_.rho0[w] = walls.density_factor * q_.rho[w];
      }
    };
    std::visit(prepare, parts_.walls);
    if (own_wall_state()) set_wall_velocity();
  }

  // ---- one evaluation of the equations
  void evaluate(double dt) {
    const double c0 = reference_sound_speed();
    const double hydrostatic_slope = setup_.eos.rho0 * setup_.gravity[Dim - 1] / (c0 * c0);
    sum_density();
    if (!own_wall_state())
      with_kernel([&](const auto& kernel) { wall_velocity_pass(q_, around(), kernel, wall_forces_); });
    else if (wall_forces_.moving)
      set_wall_velocity();
    volume_pass(q_);
    if (corrected()) with_kernel([&](const auto& kernel) { moment_pass(q_, around(), kernel); });
    std::visit(
        [&]<class K, class D, class W, class C>(const K& kernel, const D& density, const W& walls,
                                                const C& correction) {
          // Sums need no rate, whichever they are; boundary particles show the same velocity, whatever their
          // stress.
          const auto rate = [&] {
            if constexpr (is_summed<D>)
              return Summation{};
            else
              return density;
          }();
          const auto seen = [&] {
            if constexpr (has_own_state<W>)
              return BoundaryParticles{walls.B_max, walls.density_factor};
            else
              return walls;
          }();
          gradient_pass(q_, around(), kernel, rate, seen, correction, hydrostatic_slope, c0);
        },
        kernel_, parts_.density, parts_.walls, parts_.correction);
    if (!q_.limiter.empty()) limit_damping(c0);
    update_state(dt);
    std::visit(
        [&]<class K, class W, class T>(const K& kernel, const W& walls, const T& stress) {
          if constexpr (W::extrapolates_stress)
            wall_stress_pass(q_, around(), kernel, walls, stress, setup_.eos, setup_.gravity, setup_.cohesion,
                             least_friction(parts_.friction), dt, wall_forces_);
        },
        kernel_, parts_.walls, parts_.stress);
    bracket_pass(q_);
    const MomentumSums power = std::visit(
        [&](const auto& kernel, const auto& damping, const auto& correction, const auto& stress) {
          return momentum_pass(q_, around(), kernel, damping, correction, stress, setup_.gravity, c0,
                               setup_.cohesion, wall_forces_);
        },
        kernel_, parts_.damping, parts_.correction, parts_.stress);
    damped_ += dt * power.damping;
    from_walls_ += dt * power.walls;
    slid_ += dt * power.sliding;
  }

  void sum_density() {
    const bool walls_too = own_wall_state();
    std::visit(
        [&]<class K, class D>(const K& kernel, const D&) {
          if constexpr (std::is_same_v<D, Summation>) density_pass(q_, walls_too, around(), kernel, q_.rho);
          if constexpr (std::is_same_v<D, SummationShepard>) {
            density_pass(q_, true, around(), kernel, q_.rho_tilde);
            shepard_pass(q_, walls_too, around(), kernel);
          }
        },
        kernel_, parts_.density);
  }

  /// Balsara's limiter where material flows; none where the last return left it elastic, since there is no
  /// flow to slow down and its ringing should die away.
  void limit_damping(double c0) {
    const bool elastic = std::holds_alternative<ElasticReturn>(parts_.stress);
    for_clusters(0, q_.interior, [&](const Cluster& a) {
      const auto l = a.load<Gradient<Dim, Pack>>(q_.l);
      const Pack compression = positive(l.trace()) - negative(l.trace());
      const Pack shear = shear_rate(deviator(strain_rate(l)));
      const Pack limiter = compression / (compression + shear + 1e-4 * c0 / setup_.h);
      a.store(q_.limiter, elastic ? select(a.load(q_.gamma_dot) == Pack(0), Pack(1), limiter) : limiter);
    });
  }

  void update_state(double dt) {
    const bool clamp = setup_.extrapolate == "clamp";
    const StateInput in{dt,    setup_.grains,   setup_.cohesion, parts_.swelling ? setup_.grains.rho_s : 0.0,
                        clamp, setup_.law_range};
    const StateSums sums = std::visit(
        [&](const auto& stress, const auto& law, const auto& dilation) {
          return state_pass(q_, 0, q_.interior, setup_.eos, stress, law, dilation, in);
        },
        parts_.stress, parts_.friction, parts_.dilation);
    sheared_ += sums.sheared;
    diffused_ += sums.diffused;
    cut_off_ += sums.cut_off;
    swollen_ += sums.swollen;
    if (!own_wall_state()) return;
    // Boundary particles have the material's law, or their basal friction in its place (Eq. 5.7), and no
    // dilation.
    StateInput of_walls = in;
    of_walls.rho_s = 0;
    std::visit(
        [&](const auto& stress, const auto& law) {
          if (!wall_forces_.basal) {
            state_pass(q_, q_.interior, q_.size, setup_.eos, stress, law, NoDilation{}, of_walls);
            return;
          }
          for (std::size_t w = q_.interior; w < q_.size;) {
            std::size_t end = w;  // a run of particles of one wall
            while (end < q_.size && q_.wall[end] == q_.wall[w]) ++end;
            const double mu_b = setup_.walls[static_cast<std::size_t>(q_.wall[w])].basal_friction;
            if (std::isnan(mu_b))
              state_pass(q_, w, end, setup_.eos, stress, law, NoDilation{}, of_walls);
            else
              state_pass(q_, w, end, setup_.eos, stress, ConstantFriction<double>{mu_b}, NoDilation{},
                         of_walls);
            w = end;
          }
        },
        parts_.stress, parts_.friction);
  }

  /// Wall particle w shows the velocity of its wall.
  void show_own_velocity(std::size_t w) {
    Particles<Dim>::store(q_.v, w, wall_of(q_, around(), w).velocity_at(q_.position(w)));
  }
  void set_wall_velocity() {
    for_particles(q_.interior, q_.size, [&](std::size_t w) { show_own_velocity(w); });
  }

  // ---- lists and order
  template <class F>
  void arrays(F&& f) {
    q_.arrays(f);
    for (Column& c : listed_x_) f("listed_x", "m", c);
  }
  /// Numbers beside the arrays that a checkpoint carries.
  template <class F>
  void scalars(F&& f) {
    f("time", time_);
    f("wrapped_potential", wrapped_potential_);
    f("sheared", sheared_);
    f("damped", damped_);
    f("cut_off", cut_off_);
    f("diffused", diffused_);
    f("from_walls", from_walls_);
    f("slid", slid_);
    f("swollen", swollen_);
    for (std::size_t k = 0; k < setup_.walls.size(); ++k)
      for (int i = 0; i < Dim; ++i) {
        f(fmt::format("wall_{}_point_{}", k, i).c_str(), setup_.walls[k].point[i]);
        f(fmt::format("wall_{}_direction_{}", k, i).c_str(), setup_.walls[k].direction[i]);
        f(fmt::format("wall_{}_velocity_{}", k, i).c_str(), setup_.walls[k].velocity[i]);
      }
  }
  double reach() const {
    return with_kernel([](const auto& kernel) { return kernel.support(); }) * (1 + setup_.skin);
  }
  PairList::Wanted wanted() const {
    return {.wall_sees_interior = true,
            .wall_sees_wall = own_wall_state() || std::holds_alternative<SummationShepard>(parts_.density)};
  }
  void build_list() {
    list_.build(q_, setup_.period, reach(), wanted());
    listed_x_ = q_.x;
    if (own_wall_state()) return;
    // Walls that no material is near show themselves, without stress, until the next list.
    list_.for_walls([&](const Cluster& a) {
      if (list_.sees_interior(a)) return;
      for (std::size_t w = a.first; w < a.first + a.count; ++w) {
        show_own_velocity(w);
        q_.p[w] = 0;
        q_.rho[w] = setup_.eos.density(0);
        q_.set_deviator(w, S{});
      }
    });
  }
  double largest_shift() const { return 0.02 * setup_.dx; }
  bool list_is_stale() {
    const double skin = reach() * setup_.skin / (1 + setup_.skin) - (shifting() ? 2 * largest_shift() : 0);
    if (!list_.worn_out(q_, listed_x_, skin, wall_forces_.moving)) return false;
    for (std::size_t i = 0; i < q_.size; ++i)
      if (!(dot(q_.position(i), q_.position(i)) <= 1e300)) name_broken_particle();
    return true;
  }
  void sort_particles() {
    const std::vector<std::int32_t> order = spatial_order(q_, setup_.dx);
    // Interior particles come first in the order as in the arrays, so an array of interior ones takes its
    // first part.
    const auto permute = [&](auto& values) {
      if (values.empty()) return;
      auto sorted = values;
      for (std::size_t i = 0; i < values.size(); ++i) sorted[i] = values[index(order[i])];
      values = std::move(sorted);
    };
    arrays([&](const char*, const char*, Column& values) { permute(values); });
    permute(q_.id);
    permute(q_.wall);
  }
  void wrap_positions() {
    for (int k = 0; k < Dim; ++k) {
      const double length = setup_.period.length[k];
      if (!std::isfinite(length)) continue;
      Column& x = q_.x[static_cast<std::size_t>(k)];
      for (std::size_t i = 0; i < q_.size; ++i) {
        const double shift = length * std::floor(x[i] / length);
        x[i] -= shift;
        // What gravity has done along a periodic direction does not come back with the position.
        if (i < q_.interior) wrapped_potential_ -= q_.m[i] * setup_.gravity[k] * shift;
      }
    }
  }

  // ---- guards
  /// rho/rho0 beyond which a run ends: the pressure is then half of K (gamma = 1) and flow is no longer slow
  /// against sound, which the equation of state takes for granted.
  static constexpr double largest_compression = 1.5;

  /// Names the first term, in the order in which a step works them out, that has broken down.
  [[noreturn]] void name_broken_state(std::size_t broken) const {
    const auto stop = [&](std::size_t i, const char* term, double value, const char* advice) {
      const V x = q_.position(i);
      throw NumericalError(
          fmt::format("step {}, t = {:.4g} s: the {} of particle {} at x = {:.4g} m, {:.4g} m up, is {:g} "
                      "({} particles in "
                      "all); {}",
                      steps_, time_, term, q_.id[i], x[0], x[Dim - 1], value, broken, advice));
    };
    const char* smaller = "use a smaller flow.step_factor or a larger sound speed (a smaller flow.mach)";
    for (std::size_t i = 0; i < q_.interior; ++i)
      if (!(q_.rho[i] > 0)) stop(i, "density", q_.rho[i], smaller);
    for (std::size_t i = 0; i < q_.interior; ++i) {
      const double ratio = q_.rho[i] / (q_.rho0.empty() ? setup_.eos.rho0 : q_.rho0[i]);
      if (!(ratio < largest_compression))
        stop(i, "density over rho0", ratio,
             "it is squeezed beyond what an almost incompressible flow can be: use a larger sound speed (a "
             "smaller flow.mach)");
    }
    for (std::size_t i = 0; i < q_.interior; ++i) {
      if (!std::isfinite(q_.p[i])) stop(i, "pressure", q_.p[i], smaller);
      if (!q_.beta.empty() && !std::isfinite(q_.beta[i])) stop(i, "dilation beta", q_.beta[i], smaller);
      if (!std::isfinite(q_.gamma_dot[i])) stop(i, "shear rate", q_.gamma_dot[i], smaller);
      const double tau = equivalent_stress(q_.deviator(i));
      if (!std::isfinite(tau)) stop(i, "stress", tau, smaller);
    }
    for (std::size_t i = 0; i < q_.interior; ++i) {
      const V a = q_.acceleration(i);
      if (!(dot(a, a) <= 1e300)) stop(i, "acceleration", norm(a), smaller);
    }
    throw NumericalError(fmt::format("step {}: {} particles have broken down", steps_, broken));
  }
  [[noreturn]] void name_broken_particle() const {
    for (std::size_t i = 0; i < q_.size; ++i)
      for (std::size_t k = 0; k < Dim; ++k)
        if (!std::isfinite(q_.x[k][i]))
          throw NumericalError(
              fmt::format("step {}: the position of particle {} is no longer a finite number (its "
                          "velocity was integrated from an acceleration that was not); use a smaller "
                          "flow.step_factor",
                          steps_, q_.id[i]));
    throw NumericalError(fmt::format("step {}: a particle has left the range of numbers", steps_));
  }
  bool over_the_end(const V& x) const {
    return setup_.floor_end > 0 &&
           (x[0] > setup_.floor_end || (setup_.axisymmetric && x[1] > setup_.floor_end));
  }
  /// No particle passes a wall, ever: one whose centre lies behind a wall's surface ends the run.
  void check_particles() const {
    std::size_t passed = 0;
    std::size_t fallen = 0;
#pragma omp parallel for schedule(static) reduction(+ : passed, fallen)
    for (std::size_t i = 0; i < q_.interior; ++i) {
      const V x = q_.position(i);
      for (const Wall<Dim>& wall : setup_.walls)
        if (!(wall.distance(x) >= 0)) ++passed;
      if (over_the_end(x)) ++fallen;
    }
    if (passed == 0 && fallen == 0) return;
    for (std::size_t i = 0; i < q_.interior; ++i) {
      const V x = q_.position(i);
      if (!std::isfinite(dot(x, x))) name_broken_particle();
      for (const Wall<Dim>& wall : setup_.walls)
        if (!(wall.distance(x) >= 0))
          throw NumericalError(fmt::format(
              "step {}: particle {} has passed the wall \"{}\" (its centre is {:g} dx behind it; {} in "
              "all); use a larger sound speed (a smaller flow.mach) or a smaller flow.step_factor",
              steps_, q_.id[i], wall.name, -wall.distance(x) / setup_.dx, passed));
      if (over_the_end(x))
        throw NumericalError(fmt::format(
            "step {}: particle {} has run over the end of the floor at x = {:g} m ({} in all); use a "
            "larger column.floor_length",
            steps_, q_.id[i], setup_.floor_end, fallen));
    }
  }

  // ---- time
  void kick_and_drift(double dt) {
    const bool averaged = !q_.averaged[0].empty();
    const auto sums = sum_over<2>(0, q_.interior, [&](std::size_t i, std::array<double, 2>& sum) {
      for (std::size_t k = 0; k < Dim; ++k) q_.v[k][i] += 0.5 * dt * q_.a[k][i];
      V transport = averaged ? Particles<Dim>::load(q_.averaged, i) : V{};
      const bool near = stop_at_walls(i, transport, sum);
      for (std::size_t k = 0; k < Dim; ++k) q_.x[k][i] += dt * (q_.v[k][i] + transport.c[k]);
      if (near && !wall_forces_.moving) keep_off_walls(i);
    });
    cut_off_ += sums[0];
    from_walls_ += sums[1];
  }
  /// What comes nearer to a wall than a quarter of a spacing touches it with grains, not with the pressure of
  /// a continuum (material at rest keeps half a spacing): its speed into the wall is limited to half the
  /// speed of sound at that distance, and falls in proportion to zero at the surface. So nothing that moves
  /// slower than sound gets through, whatever the step. Adds the energy that is lost, and what a moving wall
  /// puts in, to `sum` [J]. True if some wall is near.
  bool stop_at_walls(std::size_t i, V& transport, std::array<double, 2>& sum) {
    const double reach = 0.25 * setup_.dx;
    const V x = q_.position(i);
    bool near = false;
    for (const Wall<Dim>& wall : setup_.walls) {
      const double d = wall.distance(x);
      if (!(d < reach)) continue;
      near = true;
      const V n = wall.normal(x);
      const V of_wall = wall.velocity_at(x);
      const V v = q_.velocity(i);
      const double into = dot(v - of_wall, n);
      const double allowed = -0.5 * reference_sound_speed() * std::max(d, 0.0) / reach;
      const double both = into + dot(transport, n);
      if (both < allowed) transport -= std::min(dot(transport, n), 0.0) * n;
      if (!(into < allowed)) continue;
      const V kept = v + (allowed - into) * n;
      const double gained = 0.5 * q_.m[i] * (dot(kept, kept) - dot(v, v));
      const double by_wall = q_.m[i] * dot(kept - v, of_wall);
      sum[0] += by_wall - gained;
      sum[1] += by_wall;
      Particles<Dim>::store(q_.v, i, kept);
    }
    return near;
  }
  /// What slides along a curved wall drifts outwards by the square of its step: within a fiftieth of a
  /// spacing of the surface it is put back to that distance. What is deeper came with speed, and has passed
  /// the wall.
  void keep_off_walls(std::size_t i) {
    const double least = 0.02 * setup_.dx;
    for (const Wall<Dim>& wall : setup_.walls) {
      const V x = q_.position(i);
      const double d = wall.distance(x);
      if (d < least && d > -least) Particles<Dim>::store(q_.x, i, x + (least - d) * wall.normal(x));
    }
  }
  void kick(double dt) {
    for_particles(0, q_.interior, [&](std::size_t i) {
      for (std::size_t k = 0; k < Dim; ++k) q_.v[k][i] += 0.5 * dt * q_.a[k][i];
    });
  }
  /// A step a million times shorter than sound needs at rest does not get anywhere: what asks for it is the
  /// error. Written so that a NaN fails closed.
  void check_step() const {
    const double usual = 0.25 * setup_.h / reference_sound_speed() * setup_.step_factor;
    if (next_.dt > 1e-6 * usual) return;
    constexpr std::array<const char*, bound_names.size()> advice{
        "use a larger flow.mach (a smaller sound speed)",
        "something pushes particles apart violently: use a smaller flow.step_factor or a larger sound speed",
        "raise flow.g_min, or use flow.stress = \"elastic_return\", which has no viscous bound"};
    const auto bound = static_cast<std::size_t>(next_.bound);
    throw NumericalError(fmt::format(
        "step {}: the time step has collapsed to {:g} s, {:.1g} of what sound needs (bound: {}); {}", steps_,
        next_.dt, next_.dt / usual, bound_names[bound], advice[bound]));
  }
  /// Wall particles move rigidly with their wall.
  static V carried(const Wall<Dim>& wall, const V& x, double dt) {
    const double angle = wall.omega * dt;
    V r = x - wall.point;
    if (angle != 0) {  // Rodrigues' formula; what lies along the axis stays
      V along;
      if constexpr (Dim == 3) along = dot(r, wall.direction) * wall.direction;
      const V across = r - along;
      r = along + std::cos(angle) * across + rotation_velocity(across, wall.direction, std::sin(angle));
    }
    return wall.point + dt * wall.velocity + r;
  }
  void move_walls(double dt) {
    for (Wall<Dim>& wall : setup_.walls) wall.swing_at(time_ + 0.5 * dt);
    for_particles(q_.interior, q_.size, [&](std::size_t w) {
      const Wall<Dim>& wall = wall_of(q_, around(), w);
      if (wall.moves()) Particles<Dim>::store(q_.x, w, carried(wall, q_.position(w), dt));
    });
    for (Wall<Dim>& wall : setup_.walls) wall.move(dt);
  }
  void shift(double dt) {
    std::array<Column, static_cast<std::size_t>(Dim)> shifts;
    for (Column& c : shifts) c.resize(q_.interior);
    volume_pass(q_);
    with_kernel([&](const auto& kernel) {
      moment_pass(q_, around(), kernel);
      shifting_pass(q_, around(), kernel, setup_.dx, largest_speed_ * dt, largest_shift(), shifts);
    });
    for_particles(0, q_.interior, [&](std::size_t i) {
      for (std::size_t k = 0; k < Dim; ++k) q_.x[k][i] += shifts[k][i];
    });
  }

  /// Eq. 5.28 (given) from the state at the end of a step.
  void choose_step() {
    const double h = setup_.h;
    const ElasticReturn* elastic = std::get_if<ElasticReturn>(&parts_.stress);
    const DirectStress* direct = std::get_if<DirectStress>(&parts_.stress);
    const double G = elastic ? elastic->G : 0;
    const double mu_at_rest = least_friction(parts_.friction);
    double largest_c2 = 0;
    double largest_a2 = 0;
    double largest_v2 = 0;
    double largest_viscosity = 0;  // eta/rho [m^2/s]
    std::size_t broken = 0;
#pragma omp parallel for schedule(static) reduction(max : largest_c2, largest_a2, largest_v2, largest_viscosity) \
    reduction(+ : broken)
    for (std::size_t i = 0; i < q_.interior; ++i) {
      // The elastic part stiffens the longitudinal wave.
      const double rho0 = q_.rho0.empty() ? setup_.eos.rho0 : q_.rho0[i];
      const double c2 = (setup_.eos.bulk_modulus(q_.rho[i], rho0) + 4.0 / 3 * G) / q_.rho[i];
      const V a = q_.acceleration(i);
      const V v = q_.velocity(i);
      largest_c2 = std::max(largest_c2, c2);
      largest_a2 = std::max(largest_a2, dot(a, a));
      largest_v2 = std::max(largest_v2, dot(v, v));
      if (direct) {
        const double g = q_.gamma_dot[i];
        const double eta = g > 0 ? equivalent_stress(q_.deviator(i)) / g
                                 : (mu_at_rest * q_.p[i] + setup_.cohesion) / direct->gamma_dot_min;
        largest_viscosity = std::max(largest_viscosity, eta / q_.rho[i]);
      }
      // max passes over a NaN: it is looked for where it would come from.
      if (!(q_.rho[i] > 0 && q_.rho[i] < largest_compression * rho0 && dot(a, a) <= 1e300)) ++broken;
    }
    if (broken > 0) name_broken_state(broken);
    sound_speed_ = std::sqrt(largest_c2);
    largest_speed_ = std::sqrt(largest_v2);
    const std::array<double, 3> bounds{
        0.25 * h / sound_speed_, 0.25 * std::sqrt(h / std::sqrt(std::max(largest_a2, 1e-300))),
        largest_viscosity > 0 ? 0.125 * h * h / largest_viscosity : std::numeric_limits<double>::infinity()};
    const auto least = std::min_element(bounds.begin(), bounds.end());
    next_ = {setup_.step_factor * *least, static_cast<Bound>(least - bounds.begin())};
  }

  FlowSetup<Dim> setup_;
  const Parts& parts_;  // of setup_
  AnyKernel<Dim> kernel_;
  Particles<Dim> q_;
  WallForces wall_forces_;
  std::array<Column, static_cast<std::size_t>(Dim)> listed_x_;
  PairList list_;
  double wrapped_potential_ = 0;  // [J], of particles that came round a periodic direction
  double sheared_ = 0;            // [J] since t = 0, like those that follow
  double damped_ = 0;
  double cut_off_ = 0;
  double diffused_ = 0;
  double from_walls_ = 0;
  double slid_ = 0;
  double swollen_ = 0;
  double time_ = 0;
  long steps_ = 0;
  double sound_speed_ = 0;
  double largest_speed_ = 0;
  StepInfo next_;
};

}  // namespace dem2sph
