// Compositions that tests go through: both formulations, and each with every single ingredient changed.
#pragma once

#include <string>
#include <vector>

#include "sph/parts.hpp"

namespace dem2sph {

struct NamedComposition {
  std::string name;
  std::vector<std::string> overrides;
};

/// What --set would say for each alternative of every part; with what it needs beside it.
inline std::vector<std::vector<std::string>> single_changes() {
  std::vector<std::vector<std::string>> changes{{}};
  const auto add = [&](const std::string& key, const std::vector<std::string>& words) {
    for (const std::string& word : words) {
      changes.push_back({"flow." + key + "=" + word});
      if (word == PartialSlip::name)
        changes.back().push_back("flow.stress=direct");  // refused with an elastic one
    }
  };
  add("kernel", {"cubic_spline", "wendland_c2", "wendland_c4"});
  add("density", names_of<DensityPart>());
  add("walls", names_of<WallPart>());
  add("stress", names_of<StressPart>());
  add("damping", names_of<DampingPart>());
  add("dilation", names_of<DilationPart>());
  add("gradient_correction", names_of<CorrectionPart>());
  add("velocity_averaging", names_of<AveragingPart>());
  add("shifting", names_of<ShiftingPart>());
  changes.push_back({"flow.dilation=evolve", "flow.swelling=true"});
  changes.push_back({"flow.basal_friction=0.2"});
  changes.push_back({"flow.cohesion=20 Pa", "flow.tensile_strength=10 Pa"});
  changes.push_back({"law.friction=constant", "law.mu=0.4"});
  changes.push_back({"law.D_star=12 1/s"});
  changes.push_back({"law.friction=barker_gray_2017", "law.mu_s=0.383", "law.mu_2=0.644", "law.I_0=0.279"});
  return changes;
}

/// All of them in both formulations.
inline std::vector<NamedComposition> all_compositions() {
  std::vector<NamedComposition> result;
  for (const std::string formulation : {"robust", "source"})
    for (std::vector<std::string> change : single_changes()) {
      NamedComposition composition{formulation, {"flow.formulation=" + formulation}};
      for (const std::string& override_text : change) {
        composition.name += ", " + override_text;
        composition.overrides.push_back(override_text);
      }
      result.push_back(composition);
    }
  return result;
}

/// Keys of the law that other friction members do not have must go: a case with the law of that member.
inline std::string law_for(const std::vector<std::string>& overrides) {
  std::string keys = "mu_l = 0.38\nmu_h = 0.64\nD_star = 0.279\n";
  for (const std::string& override_text : overrides) {
    if (override_text.starts_with("law.friction=")) keys.clear();
    if (override_text.starts_with("law.D_star=")) keys = "mu_l = 0.38\nmu_h = 0.64\n";
  }
  return "[law]\nd = \"5 mm\"\nrho_s = \"2500 kg/m^3\"\n" + keys + "phi_c = 0.6\nb = 0.2\ns_star = 0.3\n";
}

}  // namespace dem2sph
