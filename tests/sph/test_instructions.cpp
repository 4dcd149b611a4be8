// What a step costs, in instructions and in allocations: counts do not depend on the load of a machine, so
// that they can be asserted where times cannot. Valgrind's callgrind counts; step_program.cpp is what it
// counts in.
//
// A run of 6 and one of 16 steps have the same start: their difference, over 10 steps and all particles, is
// the cost of a particle-step. The table that the test prints is the one in sph/README.md.
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <set>
#include <sstream>

#include "sph/base/provenance.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using Overrides = std::vector<std::string>;

struct Cost {
  double instructions = 0;          ///< a particle and step
  std::set<std::string> functions;  ///< that were called at all, without those of std::variant
  bool calls(const std::string& part) const {
    for (const std::string& name : functions)
      if (name.find(part) != std::string::npos) return true;
    return false;
  }
};

struct Steps {
  double particles = 0;
  std::vector<long> allocations;
  std::vector<long> bytes;
};

class Instructions : public test::Scratch {
 protected:
  /// Runs the program, under callgrind if `profile` names a file.
  Steps run(long steps, const Overrides& overrides, const std::filesystem::path& profile = {}) const {
    std::vector<std::string> command;
    if (!profile.empty())
      command = {"valgrind", "--tool=callgrind", "--callgrind-out-file=" + profile.string()};
    command.insert(command.end(), {DEM2SPH_STEP_PROGRAM, std::to_string(steps)});
    command.insert(command.end(), overrides.begin(), overrides.end());
    SubprocessOptions options;
    options.output = in("output.txt");
    options.time_limit = 100;
    options.environment = {{"OMP_NUM_THREADS", "1"}};
    const SubprocessResult result = run_subprocess(command, options);
    const std::string text = test::content_of(in("output.txt"));
    EXPECT_TRUE(result.ok()) << text;
    Steps found;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
      std::istringstream words(line);
      std::string key;
      words >> key;
      long count = 0, bytes = 0;
      if (key == "particles") words >> found.particles;
      if (key != "step") continue;
      words >> count >> bytes;
      found.allocations.push_back(count);
      found.bytes.push_back(bytes);
    }
    EXPECT_EQ(found.allocations.size(), static_cast<std::size_t>(steps)) << text;
    return found;
  }

  Cost cost(const Overrides& overrides) const {
    Cost result;
    std::map<long, double> total;
    double particles = 0;
    for (const long steps : {few, many}) {
      const std::filesystem::path profile = in("callgrind.out");
      particles = run(steps, overrides, profile).particles;
      std::ifstream file(profile);
      EXPECT_TRUE(file) << profile;
      for (std::string line; std::getline(file, line);) {
        if (line.starts_with("totals: ")) total[steps] = std::stod(line.substr(8));
        // fn=(5768) name, or cfn= where it is called first; later only the number.
        const bool function = line.starts_with("fn=(") || line.starts_with("cfn=(");
        const std::size_t end = line.find(") ");
        if (!function || end == std::string::npos) continue;
        const std::string name = line.substr(end + 2);
        // The tables of std::visit list all alternatives in their names, whichever is called.
        if (name.find("__variant") == std::string::npos && name.find("std::variant") == std::string::npos)
          result.functions.insert(name);
      }
    }
    EXPECT_EQ(total.size(), 2u) << "callgrind wrote no totals";
    result.instructions = (total[many] - total[few]) / (static_cast<double>(many - few) * particles);
    return result;
  }

  static constexpr long few = 6;
  static constexpr long many = 16;
};

/// A part of a composition: what the same composition is without it and with it, and names that only its code
/// has.
struct Part {
  std::string name;
  Overrides without;
  Overrides with;
  std::vector<std::string> marks;
};

const Overrides plain{"flow.damping=none"};
Overrides plain_and(Overrides more) {
  more.insert(more.begin(), plain.begin(), plain.end());
  return more;
}

const std::vector<Part> parts{
    {"damping", plain, {"flow.damping=monaghan"}, {"MonaghanDamping"}},
    {"limiter of the damping", {"flow.damping=monaghan"}, {}, {"BalsaraDamping", "limit_damping"}},
    {"velocity averaging", plain, plain_and({"flow.velocity_averaging=xsph"}), {"averaging_pass"}},
    {"shifting", plain, plain_and({"flow.shifting=sun_2017"}), {"shifting_pass", "moment_pass"}},
    {"gradient correction",
     plain,
     plain_and({"flow.gradient_correction=bonet_lok_1999"}),
     {"BonetLok1999", "moment_pass"}},
    {"dilation from the field", plain, plain_and({"flow.dilation=direct"}), {"DilationFromField"}},
    {"dilation that evolves", plain, plain_and({"flow.dilation=evolve"}), {"DilationEvolves"}},
    {"swelling",
     plain_and({"flow.dilation=evolve"}),
     plain_and({"flow.dilation=evolve", "flow.swelling=true"}),
     {}},
    {"hydrostatic part of the density diffusion",
     plain_and({"flow.density=continuity_molteni_colagrossi_2009"}),
     plain,
     {"ContinuityFourtakas2019"}},
    {"density sum and Shepard filter",
     plain_and({"flow.density=summation"}),
     plain_and({"flow.density=summation_shepard"}),
     {"shepard_pass"}},
    {"basal friction", plain, plain_and({"flow.basal_friction=0.3"}), {}},
    {"moving walls", plain, plain_and({"moving"}), {"move_walls"}},
    {"boundary particles with stress of the material",
     plain_and({"flow.walls=boundary_particles", "flow.stress=direct", "flow.g_min=1 1/s"}),
     plain_and({"flow.walls=partial_slip", "flow.stress=direct", "flow.g_min=1 1/s"}),
     {"wall_stress_pass"}},
};

TEST_F(Instructions, APartThatIsOffCostsNothing) {
  if (!program_exists("valgrind")) GTEST_SKIP() << "valgrind is not installed: package valgrind";
  std::map<Overrides, Cost> known;
  const auto cost_of = [&](const Overrides& overrides) -> const Cost& {
    const auto found = known.find(overrides);
    return found != known.end() ? found->second : known.emplace(overrides, cost(overrides)).first->second;
  };
  std::printf("| part | instructions a particle-step without | with | of it |\n|---|---|---|---|\n");
  for (const Part& part : parts) {
    const Cost& without = cost_of(part.without);
    const Cost& with = cost_of(part.with);
    std::printf("| %s | %.0f | %.0f | %.1f %% |\n", part.name.c_str(), without.instructions,
                with.instructions, 100 * (with.instructions / without.instructions - 1));
    EXPECT_LT(without.instructions, with.instructions) << part.name;
    for (const std::string& mark : part.marks) {
      EXPECT_FALSE(without.calls(mark)) << part.name << ": " << mark << " runs although it is off";
      EXPECT_TRUE(with.calls(mark)) << part.name << ": " << mark << " does not run: is this still its name?";
    }
  }
  std::printf("default: %.0f; ", cost_of({}).instructions);
  std::printf("source: %.0f\n", cost_of({"flow.formulation=source", "flow.g_min=1 1/s"}).instructions);
}

TEST_F(Instructions, AllocationsDoNotGrowWithSteps) {
  // Steps of full length: some build a new list, which allocates; between them a step asks for three small
  // arrays (the partial sums of three loops), with shifting for two more in 2D. Their number depends on
  // nothing but the composition.
  for (const Overrides& overrides : {Overrides{}, Overrides{"flow.shifting=sun_2017"}}) {
    Overrides full = overrides;
    full.push_back("flow.step_factor=1");
    const Steps steps = run(120, full);
    const auto [least, most] = std::minmax_element(steps.allocations.begin(), steps.allocations.end());
    long builds = 0;
    long early = 0, late = 0;  // bytes of the largest step of each half
    for (std::size_t k = 0; k < steps.allocations.size(); ++k) {
      if (steps.allocations[k] == *least) continue;
      ++builds;
      long& half = k < steps.allocations.size() / 2 ? early : late;
      half = std::max(half, steps.bytes[k]);
    }
    std::printf(
        "allocations a step: %ld, with a new list at most %ld (%ld lists in 120 steps, %ld bytes at most)\n",
        *least, *most, builds, std::max(early, late));
    EXPECT_LE(*least, overrides.empty() ? 3 : 5);
    EXPECT_GT(builds, 2) << "no list was built: the test would not see what a build leaves behind";
    EXPECT_LT(builds, 60) << "most steps build a list";
    // Pairs come and go as layers slide over one another, by a few per cent: 1.2 is well above that, and well
    // below what anything that accumulates over 60 steps would reach.
    EXPECT_LT(static_cast<double>(late), 1.2 * static_cast<double>(early));
    Overrides longer = full;
    longer.push_back("incline.length=0.24 m");
    const Steps twice = run(20, longer);
    EXPECT_GT(twice.particles, 1.9 * steps.particles);
    EXPECT_EQ(*std::min_element(twice.allocations.begin(), twice.allocations.end()), *least)
        << "the number of allocations depends on that of the particles";
  }
}

}  // namespace
}  // namespace dem2sph
