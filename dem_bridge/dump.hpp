// Reads the two text dumps of a LIGGGHTS run: grains (`dump custom`) and contacts (`dump local`), frame by
// frame.
//
// The columns of the grain dump are found by their names in its header; LIGGGHTS does not name those of a
// local dump, so the map from column to meaning is passed in (the sweep keeps it beside the run as
// columns.json). A frame that the file cuts short is no error but a result of its own, since a killed run
// leaves one; anything else that is wrong is refused with file and line.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sph/base/tensor.hpp"

namespace dem2sph::bridge {

/// The simulation box of one frame [m]; a periodic direction is one that distances wrap around.
struct Box {
  Vec<3> low, high;
  std::array<bool, 3> periodic{};
};

/// What the grains' `type` means in every deck that deck.cpp writes.
enum class GrainType : int { flow = 1, bottom_wall = 2, top_wall = 3 };

struct Grain {
  std::int64_t id = 0;
  GrainType type = GrainType::flow;
  Vec<3> x;           ///< centre [m]
  Vec<3> v;           ///< velocity [m/s]
  double radius = 0;  ///< [m]
  /// Stress times volume from its contacts with other grains, each of which counts half (`compute stress/atom
  /// pair`), tension positive: xx yy zz xy xz yz [J]. In a dump that has it, every grain has it.
  std::optional<std::array<double, 6>> stress_volume = {};
  double volume() const { return 4.0 / 3 * std::numbers::pi * radius * radius * radius; }  ///< [m^3]
};

struct GrainFrame {
  std::int64_t step = 0;
  Box box;
  std::vector<Grain> grains;
};

/// One contact: `force` [N] acts on the grain `first`, its opposite on `second`.
struct Contact {
  std::int64_t first = 0, second = 0;
  Vec<3> force;
};

struct ContactFrame {
  std::int64_t step = 0;
  Box box;
  std::vector<Contact> contacts;
};

/// Where the numbers of a contact stand in a row of the local dump, counted from 0.
struct ContactColumns {
  int count = 6;
  int first = 0, second = 1;
  std::array<int, 3> force{3, 4, 5};
};

enum class ReadResult {
  frame,      ///< a whole frame was read
  end,        ///< the file ends where a frame ends
  incomplete  ///< the file ends inside a frame; nothing was returned
};

/// Shared by both readers: numbered lines, a bound on counts, errors with file and line.
class DumpLines {
 public:
  explicit DumpLines(const std::filesystem::path& path);
  /// The next line with its newline removed; false at the end of the file or at a line without a newline.
  bool next(std::string_view& line);
  bool at_end();
  [[noreturn]] void fail(const std::string& what) const;
  std::uintmax_t bytes() const { return bytes_; }
  /// What stands between blanks.
  static std::vector<std::string_view> words(std::string_view line);
  /// A finite number that is the whole word; fails otherwise.
  template <class Number>
  Number number(std::string_view word) const;

 private:
  std::filesystem::path path_;
  std::ifstream stream_;
  std::string line_;
  std::uintmax_t bytes_ = 0;
  std::size_t number_ = 0;
};

/// Columns id type x y z vx vy vz radius, in any order, and all or none of stress_columns; more are ignored.
inline constexpr std::array<std::string_view, 6> stress_columns{"c_flow_stress[1]", "c_flow_stress[2]",
                                                                "c_flow_stress[3]", "c_flow_stress[4]",
                                                                "c_flow_stress[5]", "c_flow_stress[6]"};

class GrainDump {
 public:
  explicit GrainDump(const std::filesystem::path& path) : lines_(path) {}
  ReadResult next(GrainFrame& frame);

 private:
  DumpLines lines_;
  std::int64_t last_step_ = -1;
};

class ContactDump {
 public:
  ContactDump(const std::filesystem::path& path, const ContactColumns& columns);
  ReadResult next(ContactFrame& frame);

 private:
  DumpLines lines_;
  ContactColumns columns_;
  std::int64_t last_step_ = -1;
};

}  // namespace dem2sph::bridge
