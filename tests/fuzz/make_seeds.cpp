// Writes the seeds of every parser: make_seeds FOLDER makes FOLDER/NAME/seed0, ...
#include <filesystem>
#include <fstream>

#include "tests/fuzz/parsers.hpp"

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  for (const dem2sph::fuzz::Parser& parser : dem2sph::fuzz::parsers()) {
    const std::filesystem::path folder = std::filesystem::path(argv[1]) / parser.name;
    std::filesystem::create_directories(folder);
    int number = 0;
    for (const std::string& text : parser.seeds(folder / "scratch"))
      std::ofstream(folder / ("seed" + std::to_string(number++)), std::ios::binary) << text;
    std::filesystem::remove(folder / "scratch");
  }
}
