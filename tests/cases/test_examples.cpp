// Every example of cases/ that has a flow: its keys are right, and it takes five steps at a coarse
// resolution.
#include <cmath>
#include <filesystem>

#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {
namespace {

namespace fs = std::filesystem;

template <int Dim>
void take_steps(const CaseFile& file, const LawFile& law) {
  const auto flow = make_flow<Dim>(make_setup<Dim>(file, law));
  for (int k = 0; k < 5; ++k) flow->step(1);
  const Budgets b = flow->budgets();
  EXPECT_GT(flow->time(), 0);
  EXPECT_GT(b.mass, 0);
  EXPECT_TRUE(std::isfinite(b.kinetic + b.elastic + b.dissipated));
}

TEST(Examples, EveryFlowTakesFiveSteps) {
  int flows = 0;
  for (const fs::directory_entry& folder : fs::directory_iterator(DEM2SPH_CASES)) {
    const fs::path path = folder.path() / "case.toml";
    if (!fs::exists(path)) continue;
    SCOPED_TRACE(path.string());
    // Coarse, but no coarser than the narrowest part: the silo's slot still holds three particles.
    const std::vector<std::string> coarse{"flow.resolution=10"};
    if (!CaseFile::load(path).has("flow")) continue;
    const CaseFile file = CaseFile::load(path, coarse);
    const bool chain =
        file.has("chain");  // its law comes from the grains, and so do keys that are not the flow's
    // The matrix of extremes has a section of its own, which only the program knows.
    if (!chain && !file.has("stability")) file.validate(flow_tables());
    const LawFile law = law_of_case(file.has("law") ? file : CaseFile::parse(glass_beads, "law.toml"));
    if (flow_dimension(file) == 3)
      take_steps<3>(file, law);
    else
      take_steps<2>(file, law);
    EXPECT_TRUE(fs::exists(folder.path() / "README.md"));
    ++flows;
  }
  EXPECT_GE(flows, 7) << "examples were not found";
}

}  // namespace
}  // namespace dem2sph
