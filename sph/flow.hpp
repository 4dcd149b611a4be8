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
  double mass = 0;                     ///< [kg]
  std::array<double, 3> momentum{};    ///< [kg m/s]
  double kinetic = 0;                  ///< [J]
  double potential = 0;                ///< [J], of gravity, zero at the origin
  double elastic = 0;                  ///< [J], compression and shear
  double dissipated = 0;               ///< [J], by plastic or viscous shear and by damping, since t = 0
  double flowing = 0;                  ///< mass that shears under pressure [kg]
  double outside_data = 0;             ///< of it, at an I outside the range of the law's data [kg]
  double beta_limited = 0;             ///< of it, with beta at one of its limits [kg]
  double phi_at_floor = 0;             ///< of it, with phi_eq at the floor where the linear law ends [kg]
  double largest_speed = 0;            ///< [m/s]
  std::array<double, 3> wall_force{};  ///< [N] of the walls on the material, from the momentum balance
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
  /// The words of the composition, formulation first.
  virtual std::vector<std::string> composition() const = 0;
  /// Everything that the next step depends on, to the bit. `key` names the configuration, `note` is kept for
  /// the caller.
  virtual void save(const std::filesystem::path& path, const std::string& key,
                    const std::string& note) const = 0;
  /// Gives the note back. Throws InputError if the checkpoint belongs to another configuration.
  virtual std::string load(const std::filesystem::path& path, const std::string& key) = 0;
};

/// Makes the solver of the set-up's composition. Throws UsageError, listing those that exist, if there is
/// none.
template <int Dim>
std::unique_ptr<Flow> make_flow(FlowSetup<Dim> setup);

}  // namespace dem2sph
