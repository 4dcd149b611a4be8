// Which LIGGGHTS runs to make next. README, "What to run next".
#pragma once

#include <string>
#include <vector>

#include "calibration/fit.hpp"

namespace dem2sph {

/// A run that would tell the most about the worst known parameter for its cost: a steady one, or one more
/// transient like those that were made.
struct SuggestedRun {
  std::string kind = "steady";  ///< or a kind of transient
  double I_driven = 0;
  double I_before = 0, load = 0, packing_friction = 0;  ///< of a transient; load in Pa
  long seeds_there = 0;                      ///< runs like it so far, those suggested before it included
  double core_seconds = 0;                   ///< expected
  double mu_se = 0, phi_se = 0;              ///< expected standard errors of a steady run
  std::string worst;                         ///< parameter that it is made for
  double error_before = 0, error_after = 0;  ///< of that, relative
  double log_det = 0;                        ///< by how much ln det of the covariance falls (D-optimality)
};

/// What a steady run costs and how exact it is, learned from the runs that were made: means over the runs of
/// each driven I, interpolated in logarithms. Below the lowest I the cost grows as 1/I, the time that a
/// strain takes; errors, and the cost above the highest I, stay as they are there.
class RunModel {
 public:
  /// Throws InputError if no steady run has a cost.
  RunModel(const std::vector<Observables>& observables, const Fit& fit);
  double core_seconds(double I) const;
  double mu_se(double I) const;
  double phi_se(double I) const;

 private:
  struct Node {
    double log_I = 0, log_cost = 0, log_mu_se = 0, log_phi_se = 0;
  };
  double at(double I, double Node::*what) const;
  std::vector<Node> nodes_;
};

/// The next `count` runs, one after the other: each time the parameter with the largest relative error is
/// looked for. Of friction or solid fraction: of all I from the lowest that was run to `I_max` the one that
/// lowers its variance most per core-second. Of dilation: of the groups of transients that were made, that of
/// which one more seed does. The covariance is that of the fit, linear about it.
std::vector<SuggestedRun> suggest_runs(const std::vector<Observables>& observables, const Fit& fit,
                                       long count, double I_max);

/// For people: a table, and the section of a case file that makes these runs.
std::string describe(const std::vector<SuggestedRun>& runs);

}  // namespace dem2sph
