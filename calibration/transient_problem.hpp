// Transients as a least-squares problem: all runs, one law of dilation, correlated noise. README,
// "Transients".
//
// The model is linear, or linear piece by piece, in the offset of each condition and in the phi_0 of each
// run. These are solved for within, and only the few coordinates of the law are searched (variable
// projection, Golub and Pereyra 1973, with Kaufman's Jacobian): a hundred transients cost no more than a line
// fit each.
#pragma once

#include <Eigen/Dense>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "calibration/data_selection.hpp"
#include "calibration/fit.hpp"
#include "calibration/least_squares.hpp"
#include "calibration/models.hpp"
#include "calibration/statistics.hpp"

namespace dem2sph {

/// Means of consecutive samples; the model is averaged in the same way, so nothing is biased by it.
struct Bins {
  std::vector<std::size_t> first;  ///< of each bin; one more at the end
  Bins(std::size_t samples, long most);
  std::size_t size() const { return first.size() - 1; }
  std::vector<double> mean(std::span<const double> values) const;
};

/// One transient, averaged into bins.
struct BinnedTransient {
  const Transient* transient = nullptr;
  std::size_t condition = 0;  ///< shares an offset of phi_eq
  std::size_t group = 0;      ///< the same but for the seed
  Bins bins;
  std::vector<double> s, phi;
};

/// What a law is fitted with beside its coordinates.
struct TransientConstants {
  std::vector<double> offset;  ///< of each condition
  std::vector<double> phi_0;   ///< of each run
};

/// What runs say of the coordinates of a law, linear about a place: for jackknife, bootstrap, and what one
/// more run would tell.
class RunInformation {
 public:
  struct Run {
    std::size_t condition = 0;
    /// Inner products of the columns [d/d(coordinates), d/d(offset), residual], whitened, phi_0 projected
    /// out.
    Eigen::MatrixXd products;
  };
  std::vector<Run> runs;

  /// J^T J and J^T r of the coordinates if run r counted `times[r]` times; the offset of each condition is
  /// free.
  struct Normal {
    Eigen::MatrixXd square;
    Eigen::VectorXd right;
  };
  Normal normal(std::span<const double> times) const;
  /// The least-squares step of the coordinates then.
  Eigen::VectorXd step(std::span<const double> times) const;
};

class TransientProblem {
 public:
  static constexpr std::size_t none = std::numeric_limits<std::size_t>::max();
  using Weights = std::vector<Eigen::MatrixXd>;  ///< L^-1 of each run; empty: all samples count alike

  TransientProblem(const SelectedData& selected, long bins);

  const std::vector<BinnedTransient>& runs() const { return runs_; }
  std::size_t conditions() const { return conditions_; }
  /// The runs of each group.
  std::vector<std::vector<std::size_t>> twins() const;
  /// Coordinates, offsets, phi_0: that is also the order of the columns of `residuals` and `covariance`.
  std::size_t parameters(const DilationModel& model) const {
    return model.coordinates().size() + conditions_ + runs_.size();
  }

  /// Which runs take part, and whether they may have an offset.
  struct Choice {
    std::size_t without_group = none, only_group = none;
    bool offsets = true;
  };

  /// The problem in the coordinates alone, one block a condition.
  LeastSquaresProblem problem(const DilationModel& model, const SteadySolidFraction& law,
                              const Weights& weights, const std::vector<double>& start,
                              const Choice& choice) const;
  LeastSquaresProblem problem(const DilationModel& model, const SteadySolidFraction& law,
                              const Weights& weights, const std::vector<double>& start) const {
    return problem(model, law, weights, start, Choice());
  }

  /// The best offsets and phi_0 for given coordinates; those of runs that take no part stay 0.
  TransientConstants constants(const DilationModel& model, const SteadySolidFraction& law,
                               const Weights& weights, std::span<const double> x, const Choice& choice) const;

  /// What each run says, linear about `x` and the best constants there, its phi_0 being free.
  RunInformation information(const DilationModel& model, const SteadySolidFraction& law,
                             const Weights& weights, std::span<const double> x) const;

  /// Residuals of phi, data less model, and their derivatives by the parameters that the run has.
  CorrelatedResiduals residuals_of(std::size_t run, const DilationModel& model,
                                   const SteadySolidFraction& law, std::span<const double> x,
                                   const TransientConstants& constants) const;
  /// Of each run.
  std::vector<CorrelatedResiduals> residuals(const DilationModel& model, const SteadySolidFraction& law,
                                             std::span<const double> x,
                                             const TransientConstants& constants) const;

  /// Of all parameters, from the whitened residuals. `held`: coordinates at a bound, with rows of 0. Throws
  /// IdentifiabilityError if a combination is open.
  Matrix covariance(const DilationModel& model, const std::vector<CorrelatedResiduals>& residuals,
                    const Weights& weights, const std::vector<bool>& held) const;

  Weights whitening(const NoiseModel& noise) const;

  /// phi and beta of one run on the samples of its observables.
  TransientSolution solution(const DilationModel& model, const SteadySolidFraction& law,
                             std::span<const double> x, const TransientConstants& constants,
                             std::size_t run) const;

  /// The noise as the seeds show it, without any law: each run about the mean of its twins. `residuals` give
  /// the derivative by phi_0, which is not noise. No strain scale (0) if fewer than 8 runs have two twins or
  /// more.
  NoiseModel noise_of_seeds(const std::vector<CorrelatedResiduals>& residuals, std::size_t coordinates) const;

 private:
  struct Part;
  Part part_of(std::size_t condition, const DilationModel& model, const SteadySolidFraction& law,
               const Weights& weights, const Choice& choice) const;

  std::vector<BinnedTransient> runs_;
  std::size_t conditions_ = 0, groups_ = 0;
};

}  // namespace dem2sph
