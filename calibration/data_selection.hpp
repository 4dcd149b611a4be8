// Which data enter a fit, and with which standard errors.
#pragma once

#include <vector>

#include "calibration/fit.hpp"

namespace dem2sph {

/// A transient that is fitted, and the condition that it shares an offset of phi with.
struct SelectedTransient {
  const Transient* transient = nullptr;
  std::size_t condition = 0;
};

struct SelectedData {
  std::vector<SteadyDatum> friction, solid_fraction;
  std::vector<SelectedTransient> transients;
  std::size_t conditions = 0;
  std::vector<ExcludedRun> excluded;
};

/// Checks everything and applies floors, the spread over seeds and the options' ranges. The transients point
/// into `observables`. Throws InputError naming the run for what is no datum.
SelectedData select_data(const std::vector<Observables>& observables, const FitOptions& options);

}  // namespace dem2sph
