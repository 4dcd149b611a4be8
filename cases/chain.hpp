// The chain of `dem2sph run`: shear cells, fit, flows with and without dilation, report. Each link is a file.
//
//   DIR/shear_cell/observables.h5 -> DIR/law.json, fit.json -> DIR/flow_.../summary.json -> DIR/report.html
//
// DIR/run.json names them all, so that `dem2sph report DIR` makes the page again without running anything.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "calibration/fit.hpp"
#include "sph/base/case_file.hpp"
#include "sph/run_flow.hpp"

namespace dem2sph {

/// Options that every command has.
struct CommonOptions {
  std::vector<std::string> overrides;  ///< --set section.key=value
  int threads = 0;                     ///< of one flow; 0: as many as its size is worth
  int jobs = 0;                        ///< LIGGGHTS runs at once; 0: one a core
  bool force = false;
  bool quiet = false;
};

/// The flow of a case as it is run for a comparison: with and without the law of dilation.
struct FlowVariant {
  const char* name;   ///< "with_dilation", of folders
  const char* label;  ///< for people
  bool dilation;
};
inline constexpr FlowVariant flow_variants[] = {{"without_dilation", "without dilation", false},
                                                {"with_dilation", "with dilation (Eq. 5.22)", true}};
/// The case as a variant needs it: the member of dilation that `law` has, or none, and then no limits of
/// beta.
CaseFile case_of(const FlowVariant& variant, const LawFile& law, const std::filesystem::path& path,
                 std::vector<std::string> overrides);

/// The law of a case: its section [law], or the file that was given. Throws UsageError for both or none.
LawFile law_of(const CaseFile& file, const std::filesystem::path& law_path);

/// Options of a flow that a larger command runs into `folder` and takes from there when it is given again.
FlowOptions reusing_flow(const std::filesystem::path& folder, const CommonOptions& options);

/// A law like that of glass beads: stands in for the fitted one where only its being there matters.
LawFile typical_law();

/// Reads a case and checks all of it against every table there is.
CaseFile load_case(const std::filesystem::path& path, const std::vector<std::string>& overrides);

/// The case that the shear cells of `file` stand in: another file that [chain] names, or `file` itself.
CaseFile shear_cell_case(const CaseFile& file);

/// What run_chain would do, as text.
std::string plan_chain(const CaseFile& file, const CommonOptions& options);

/// Runs what is missing of the whole chain into `folder` and writes the report. Returns what `--json` prints.
nlohmann::json run_chain(const std::filesystem::path& case_path, const std::filesystem::path& folder,
                         const CommonOptions& options);

/// Makes DIR/report.html from the files that DIR/run.json names. Throws InputError if one is missing.
std::filesystem::path make_report(const std::filesystem::path& folder);

/// The fitted law as a table for people: value, standard error, 95 % interval, and the verdict.
std::string describe(const Fit& fit);

/// Number of LIGGGHTS runs at once that `jobs = 0` means.
int jobs_or_cores(int jobs);

}  // namespace dem2sph
