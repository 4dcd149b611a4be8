// report.html: one self-contained page about a calibration and the flows that were run with it. Figures are
// made with gnuplot and stand in the page as SVG; nothing is loaded from elsewhere, and every text that came
// from outside is escaped.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "calibration/fit.hpp"
#include "dem_bridge/observables.hpp"
#include "sph/base/law_file.hpp"

namespace dem2sph {

/// A flow that was run with the law: its label and its summary.json.
struct ReportFlow {
  std::string label;  ///< "with dilation"
  std::filesystem::path summary;
};

/// A step of the chain: how long it took, and which files it wrote.
struct ReportStep {
  std::string what;  ///< "shear cells (LIGGGHTS)"
  double seconds = 0;
  std::vector<std::filesystem::path> files;  ///< named in the page with their SHA-256
};

struct ReportInputs {
  std::string title;
  std::vector<Observables> observables;
  LawFile law;
  Fit fit;
  std::vector<ReportFlow> flows;
  std::vector<ReportStep> steps;
  nlohmann::json provenance;  ///< versions of what wrote the page, as provenance() gives them
};

/// Text for HTML: & < > " ' are escaped, control characters dropped.
std::string escape_html(const std::string& text);

std::string figure_html(const std::string& svg, const std::string& caption);

/// A page with title, stamp of versions, a sentence that says what came out, and `body`, which is HTML.
void write_page(const std::string& title, const std::string& verdict, const std::string& body,
                const nlohmann::json& provenance, const std::filesystem::path& page);

/// Writes the page. Throws InputError if a summary.json lacks a part or a file of a step is missing, and
/// an Error if gnuplot is missing (exit code 2) or refuses a figure (1).
void write_report(const ReportInputs& inputs, const std::filesystem::path& page);

}  // namespace dem2sph
