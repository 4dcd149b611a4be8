// One libFuzzer target: the parser that DEM2SPH_PARSER names. What it may do with any bytes is return or
// throw dem2sph::Error; everything else (another exception, a leak, a bad access, a hang) stops the fuzzer.
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <fstream>

#include "sph/base/errors.hpp"
#include "tests/fuzz/parsers.hpp"

namespace {

const dem2sph::fuzz::Parser& chosen() {
  for (const dem2sph::fuzz::Parser& parser : dem2sph::fuzz::parsers())
    if (parser.name == DEM2SPH_PARSER) return parser;
  std::abort();
}

const std::filesystem::path& scratch() {
  static const std::filesystem::path path =
      std::filesystem::path("/dev/shm") / ("dem2sph-fuzz-" + std::to_string(::getpid()));
  return path;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const dem2sph::fuzz::Parser& parser = chosen();
  {
    std::ofstream file(scratch(), std::ios::binary);
    file.write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  }
  try {
    parser.read(scratch());
  } catch (const dem2sph::Error&) {
  }
  return 0;
}
