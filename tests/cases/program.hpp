// A test that runs the program in a folder of its own.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "sph/base/subprocess.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph::test {

class Program : public Scratch {
 protected:
  struct Outcome {
    int code = -1;
    std::string text;  ///< stdout and stderr
  };
  /// `arguments` without the program's name; one thread, unless the environment says otherwise.
  Outcome run(std::vector<std::string> arguments, std::map<std::string, std::string> environment = {},
              double time_limit = 120) const {
    arguments.insert(arguments.begin(), DEM2SPH_PROGRAM);
    SubprocessOptions options;
    options.output = in("output.txt");
    options.time_limit = time_limit;
    options.environment = std::move(environment);
    options.environment.try_emplace("OMP_NUM_THREADS", "1");
    const SubprocessResult result = run_subprocess(arguments, options);
    return {result.exit_code, content_of(in("output.txt"))};
  }
};

}  // namespace dem2sph::test
