// What a verification test has measured, as one JSON line in the file that DEM2SPH_RECORD names (nothing if
// it is unset).
#pragma once

#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

namespace dem2sph {

/// `bar` is the bound that the test asserts on `measured`, in the same unit.
inline void record(const std::string& test, const std::string& formulation, const std::string& quantity,
                   double measured, double bar, const std::string& unit) {
  const char* path = std::getenv("DEM2SPH_RECORD");
  if (path == nullptr || *path == '\0') return;
  const nlohmann::ordered_json line{{"test", test},         {"formulation", formulation},
                                    {"quantity", quantity}, {"measured", measured},
                                    {"bar", bar},           {"unit", unit}};
  std::ofstream(path, std::ios::app) << line.dump() + "\n";
}

}  // namespace dem2sph
