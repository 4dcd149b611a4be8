// Who made a file, from what, and when: written into every output. And SHA-256, which names runs and inputs.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace dem2sph {

/// SHA-256 of a text (FIPS 180-4), as 64 hexadecimal digits.
std::string sha256(std::string_view text);
/// SHA-256 of a file's bytes. Throws InputError if it cannot be read.
std::string sha256_of_file(const std::filesystem::path& path);

/// Version, git revision, compiler, host, processor and time of this program's run.
nlohmann::json provenance();

/// Writes `text` to `path` through a temporary file that is flushed to disk and renamed, so that a reader or
/// a killed run never sees half a file. Throws Error(bug) with the system's reason if the disk refuses.
void write_file_atomically(const std::filesystem::path& path, std::string_view text);

/// Reads a JSON file. Throws InputError with path and position if it is missing or malformed.
nlohmann::json read_json(const std::filesystem::path& path);

}  // namespace dem2sph
