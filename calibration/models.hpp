// The laws as a fit sees them: each member of a family by coordinates in which order and sign hold by
// construction, with derivatives. The laws themselves are the templates of sph/rheology, evaluated with Jets.
//
// An example: the rational friction law has the coordinates ln mu_l, ln(mu_h - mu_l), ln D*, so no step of a
// fit can make mu_h smaller than mu_l or D* negative. natural() leads back to mu_l, mu_h, D*.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sph/rheology/dilation.hpp"

namespace dem2sph {

using Matrix = std::vector<std::vector<double>>;

/// J C J^T for the change of parameters whose derivatives are the rows of `to`.
Matrix propagate(const Matrix& to, const Matrix& covariance);

struct Coordinate {
  std::string name;  ///< "ln(mu_h - mu_l)"
  double lower = 0, upper = 0;
  bool is_logarithm_of(const std::string& parameter) const { return name == "ln " + parameter; }
};

/// The parameters of the law file, and their derivatives by the coordinates (one row a parameter).
struct NaturalParameters {
  std::vector<double> values;
  Matrix by_coordinate;
};

/// mu(I) or phi_eq(I), with derivatives by the coordinates and by I.
struct ModelValue {
  double value = 0;
  std::vector<double> by_coordinate;
  double slope = 0;
};

/// What bounds the coordinates, from the options of the fit.
struct ModelBounds {
  double mu_max = 5;  ///< of mu_l, of mu_h - mu_l, and of a in a + b I
  double D_star_min = 1e-3, D_star_max = 10;
  double b_max = 3;
};

/// A member of a family of steady laws.
class SteadyModel {
 public:
  virtual ~SteadyModel() = default;
  virtual std::string name() const = 0;                     ///< of the member, as in a law file
  virtual std::vector<std::string> parameters() const = 0;  ///< as in a law file
  virtual const std::vector<Coordinate>& coordinates() const = 0;
  virtual NaturalParameters natural(std::span<const double> coordinates) const = 0;
  /// False where the law has no value.
  virtual bool evaluate(std::span<const double> coordinates, double I, ModelValue& value) const = 0;
  /// Coordinates to start from, for a law that goes from `first` at the smallest I to `last` at the largest,
  /// `I_last`. Within the bounds.
  virtual std::vector<double> start(double first, double last, double I_last) const = 0;
};

/// "rational", "exponential", "power", "linear", "barker_gray_2017". Throws std::logic_error for another
/// name.
std::unique_ptr<SteadyModel> friction_model(const std::string& member, const ModelBounds& bounds);
/// "linear", "power", "rational".
std::unique_ptr<SteadyModel> solid_fraction_model(const std::string& member, const ModelBounds& bounds);

/// The law itself.
SteadySolidFraction solid_fraction_at(const SteadyModel& model, std::span<const double> coordinates);

/// A transient as a law of dilation sees it: at each sample the strain, and the steady law phi_eq at its I;
/// `phi_eq_step` is that at the mean I of the step that leads to the sample.
struct TransientInput {
  std::span<const double> s, phi_eq, phi_eq_step;
  bool from_steady_flow = false;  ///< a jump; a start-up begins with a packing that never flowed
};

/// phi and beta at the samples, and their derivatives, one row a sample: by the coordinates, by an offset of
/// phi_eq, by phi_0.
struct TransientSolution {
  using Derivatives = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  std::vector<double> phi, beta;
  Derivatives phi_by, beta_by;
};

/// A law of dilation: how phi goes from phi_0 at s = 0 towards phi_eq + offset.
class DilationModel {
 public:
  virtual ~DilationModel() = default;
  virtual std::string name() const = 0;
  virtual const std::vector<std::string>& parameters() const = 0;
  virtual const std::vector<Coordinate>& coordinates() const = 0;
  virtual NaturalParameters natural(std::span<const double> coordinates) const = 0;
  virtual std::vector<double> start() const = 0;
  virtual TransientSolution evaluate(const TransientInput& transient, std::span<const double> coordinates,
                                     double offset, double phi_0, bool with_beta = true) const = 0;
};

/// The members, with s* between the bounds:
///   phi_relaxes {s_star}                     d(phi)/ds = -(phi - phi_eq)/s*: Eq. 5.22 closed from DEM
///   two_sided   {s_star, s_star_compacting}  the same, with another scale where phi < phi_eq
///   printed     {s_star, gain}               Eq. 5.22 with beta as the state and a source that is A times
///                                            that of phi_relaxes
///   dilatancy   {K}                          beta = K (phi - phi_eq), of phi alone (Roux and Radjai 1998)
///   constant    {beta}                       the same beta always
///   none        {}                           phi stays
/// Throws std::logic_error for another name.
std::unique_ptr<DilationModel> dilation_model(const std::string& member, double s_star_min,
                                              double s_star_max);

}  // namespace dem2sph
