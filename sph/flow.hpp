// A flow as the run loop sees it: one virtual call a step, never one a pair. Made by make_flow() from a
// set-up.
#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "sph/base/frame.hpp"
#include "sph/setup.hpp"

namespace dem2sph {

/// Which bound of Eq. 5.28 is the least.
enum class Bound { sound, force, viscosity };
inline constexpr std::array<const char*, 3> bound_names{"sound", "force", "viscosity"};

struct StepInfo {
  double dt = 0;  ///< that the bounds allow; the step taken may be shorter, to meet the time of a frame
  Bound bound = Bound::sound;
};

/// Sums over all interior particles, per metre of width in 2D.
struct Budgets {
  double mass = 0;                   ///< [kg]
  std::array<double, 3> momentum{};  ///< [kg m/s]
  double kinetic = 0;                ///< [J]
  double potential = 0;              ///< [J], of gravity, zero at the origin
  double elastic = 0;                ///< [J], compression and shear
  double dissipated = 0;             ///< [J], since t = 0: the sum of the next four
  double sheared = 0;                ///< [J], by plastic or viscous shear
  double damped = 0;                 ///< [J], by artificial viscosity
  double cut_off = 0;        ///< [J], lost where material came apart or met a wall as single particles
  double slid = 0;           ///< [J], on walls that slide (basal friction, adami_2012), the spring included
  double diffused = 0;       ///< [J], put into compression by density diffusion since t = 0
  double swollen = 0;        ///< [J], put into compression by rho0 following phi since t = 0
  double from_walls = 0;     ///< [J], put in by moving walls since t = 0
  double flowing = 0;        ///< mass that shears under pressure [kg]
  double below_data = 0;     ///< of it, at an I below the range of the law's data [kg]
  double above_data = 0;     ///< of it, above [kg]
  double ill_posed = 0;      ///< of it, where mu(I) is ill-posed (Barker et al. 2015) [kg]
  double beta_limited = 0;   ///< of it, with beta at one of its limits [kg]
  double phi_at_floor = 0;   ///< of it, with phi_eq at the floor where the linear law ends [kg]
  double largest_speed = 0;  ///< [m/s]
  double largest_compression = 0;      ///< of rho/rho0
  double sound_speed = 0;              ///< sqrt(K/rho0) [m/s]
  double mean_speed = 0;               ///< mass-weighted mean of |v| [m/s]
  std::array<double, 3> wall_force{};  ///< [N] of the walls on the material, from the momentum balance

  /// What the budget does not explain, against an earlier state: zero if every term were exact [J].
  double unaccounted_since(const Budgets& earlier) const {
    const double before = earlier.kinetic + earlier.potential + earlier.elastic;
    const double now = kinetic + potential + elastic;
    return before - now - (dissipated - earlier.dissipated) + (diffused - earlier.diffused) +
           (swollen - earlier.swollen) + (from_walls - earlier.from_walls);
  }
};

/// An array that a composition carries.
struct ArrayInUse {
  std::string name;
  std::string unit;
  std::size_t components = 0;
  std::size_t bytes = 0;
};
/// What a composition does each step, and what it leaves out.
struct PassList {
  std::vector<std::string> passes;
  std::vector<std::string> left_out;
};

class Flow {
 public:
  virtual ~Flow() = default;
  /// Advances by one step of Algorithm 1 (given). Throws NumericalError if a number is no longer finite, if a
  /// particle has passed a wall or left the floor, or if the step has collapsed.
  virtual StepInfo step(double largest_dt) = 0;
  virtual double time() const = 0;
  virtual long steps() const = 0;
  virtual Budgets budgets() const = 0;
  virtual Frame frame() const = 0;
  /// Interior particles as positions and the area (2D) or volume (3D) that each stands for.
  virtual void deposit(std::vector<std::array<double, 3>>& positions, std::vector<double>& volumes) const = 0;
  virtual std::size_t interior() const = 0;
  virtual std::size_t particles() const = 0;
  virtual std::size_t pairs() const = 0;
  virtual std::size_t bytes() const = 0;
  virtual std::vector<ArrayInUse> arrays_in_use() const = 0;
  virtual PassList passes() const = 0;
  /// The words of the composition, formulation first.
  virtual std::vector<std::string> composition() const = 0;
  /// Everything that the next step depends on, to the bit. `key` names the configuration, `note` is kept for
  /// the caller.
  virtual void save(const std::filesystem::path& path, const std::string& key,
                    const std::string& note) const = 0;
  /// Gives the note back. Throws InputError if the checkpoint belongs to another configuration.
  virtual std::string load(const std::filesystem::path& path, const std::string& key) = 0;
};

/// Makes the solver of the set-up's composition.
template <int Dim>
std::unique_ptr<Flow> make_flow(FlowSetup<Dim> setup);

}  // namespace dem2sph
