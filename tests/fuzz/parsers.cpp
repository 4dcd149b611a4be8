#include "tests/fuzz/parsers.hpp"

#include <fmt/format.h>

#include <fstream>
#include <sstream>

#include "dem_bridge/observables.hpp"
#include "dem_bridge/plan.hpp"
#include "dem_bridge/reduce.hpp"
#include "sph/base/case_file.hpp"
#include "sph/base/frame.hpp"
#include "sph/base/law_file.hpp"
#include "sph/base/provenance.hpp"
#include "tests/calibration/synthetic.hpp"
#include "tests/dem_bridge/packing.hpp"

namespace dem2sph::fuzz {
namespace {

namespace fs = std::filesystem;

std::string content_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

bridge::test::Lattice lattice() {
  bridge::test::Lattice small;
  small.columns_x = small.columns_y = 2, small.layers = 3;
  small.normal = 1e-3, small.tangential = 2e-4;
  return small;
}

void read_grains(const fs::path& path) {
  bridge::GrainDump dump(path);
  bridge::GrainFrame frame;
  while (dump.next(frame) == bridge::ReadResult::frame) {
  }
}
std::vector<std::string> grain_seeds(const fs::path&) {
  return {bridge::test::text_of(lattice().frame(0)) + bridge::test::text_of(lattice().frame(100))};
}

void read_contacts(const fs::path& path) {
  bridge::ContactDump dump(path, {});
  bridge::ContactFrame frame;
  while (dump.next(frame) == bridge::ReadResult::frame) {
  }
}
std::vector<std::string> contact_seeds(const fs::path&) {
  return {bridge::test::text_of(lattice().contacts(0)) + bridge::test::text_of(lattice().contacts(100))};
}

void read_wall(const fs::path& path) { bridge::read_wall_series(path); }
std::vector<std::string> wall_seeds(const fs::path&) {
  return {
      "# Time-averaged data for fix wall\n# TimeStep h p tau\n10 0.011 1000 380\n20 0.0111 998.5 -3.9e2\n"};
}

void read_observables_file(const fs::path& path) { read_observables(path); }
std::vector<std::string> observables_seeds(const fs::path& scratch) {
  Observables o = synthetic::observables({}, 1, 3, 1e-3, 1, 1);
  Transient& t = o.transients[0];
  for (auto* list : {&t.s, &t.gamma_dot, &t.p, &t.mu, &t.I, &t.phi, &t.beta, &t.height}) list->resize(4);
  o.excluded.push_back({"lost", "two grains left the cell"});
  write_observables(o, scratch);
  return {content_of(scratch)};
}

void read_frame_file(const fs::path& path) { read_frame(path); }
std::vector<std::string> frame_seeds(const fs::path& scratch) {
  Frame frame;
  frame.fields = {{"x", "m", 3, {0, 0, 0, 1, 1, 0}}, {"rho", "kg/m^3", 1, {1500, 1501}}};
  write_frame(frame, scratch);
  return {content_of(scratch)};
}

void read_law(const fs::path& path) { read_law_file(path); }
std::vector<std::string> law_seeds(const fs::path& scratch) {
  LawFile law;
  law.d = 1e-3, law.rho_s = 2500;
  law.friction = {"rational", {{"mu_l", 0.38}, {"mu_h", 0.64}, {"D_star", 0.279}}, 0};
  law.solid_fraction = {"linear", {{"phi_c", 0.59}, {"b", 0.2}}, 0};
  law.dilation = {"phi_relaxes", {{"s_star", 0.4}}, 0};
  law.covariance_names = {"mu_l", "mu_h"};
  law.covariance = {{1, 0.5}, {0.5, 1}};
  write_law_file(law, scratch);
  return {content_of(scratch)};
}

void read_case(const fs::path& path) {
  const CaseFile file = CaseFile::load(path);
  file.validate(bridge::sweep_tables());
  bridge::plan_sweep(file, bridge::engine_unknown);
}
std::vector<std::string> case_seeds(const fs::path&) {
  return {R"([material]
d = "1 mm"
rho_s = "2500 kg/m^3"
grain_friction = 0.5
contact = "hooke"
kappa = 1e3
[shear_cell]
pressure = "1 kPa"
grains = 900
keep_dumps = true
[shear_cell.steady]
I = [0.1, 0.2]
seeds = [1]
[shear_cell.start_up]
packing_friction = [0]
[shear_cell.jump]
I_before = [0.1]
I = [0.2]
[shear_cell.pressure_jump]
I_before = [0.1]
pressure = ["2 kPa"]
)"};
}

}  // namespace

const std::vector<Parser>& parsers() {
  static const std::vector<Parser> all{
      {"grain_dump", read_grains, grain_seeds}, {"contact_dump", read_contacts, contact_seeds},
      {"wall_series", read_wall, wall_seeds},   {"observables", read_observables_file, observables_seeds},
      {"frame", read_frame_file, frame_seeds},  {"law", read_law, law_seeds},
      {"case", read_case, case_seeds}};
  return all;
}

}  // namespace dem2sph::fuzz
