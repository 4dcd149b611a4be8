// Everything that reads a file from outside, under one name each: for the fuzzers, and for the quick test of
// prefixes and mutations.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace dem2sph::fuzz {

struct Parser {
  std::string name;
  /// Reads the whole file. Throws dem2sph::Error with the file's name, or returns.
  void (*read)(const std::filesystem::path& path);
  /// Small valid files, by name, as our own writers make them.
  std::vector<std::string> (*seeds)(const std::filesystem::path& scratch);
};

const std::vector<Parser>& parsers();

}  // namespace dem2sph::fuzz
