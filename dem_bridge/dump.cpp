#include "dem_bridge/dump.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>
#include <unordered_set>
#include <utility>

#include "sph/base/errors.hpp"

namespace dem2sph::bridge {

DumpLines::DumpLines(const std::filesystem::path& path) : path_(path), stream_(path, std::ios::binary) {
  std::error_code status;
  bytes_ = std::filesystem::file_size(path, status);
  if (!stream_ || status) throw InputError(fmt::format("{}: cannot open this dump", path.string()));
}

bool DumpLines::next(std::string_view& line) {
  // Memory follows the file's own bytes: no line is longer than the file.
  std::getline(stream_, line_);
  // getline reaches the end of the file only if the last line has no newline: a line cut short.
  if (stream_.eof() || stream_.fail()) return false;
  ++number_;
  line = line_;
  return true;
}

bool DumpLines::at_end() { return stream_.peek() == std::ifstream::traits_type::eof(); }

void DumpLines::fail(const std::string& what) const {
  throw InputError(fmt::format("{}:{}: {}", path_.string(), number_, what));
}

std::vector<std::string_view> DumpLines::words(std::string_view line) {
  std::vector<std::string_view> found;
  std::size_t at = 0;
  while (at < line.size()) {
    const std::size_t from = line.find_first_not_of(" \t\r", at);
    if (from == std::string_view::npos) break;
    const std::size_t to = std::min(line.find_first_of(" \t\r", from), line.size());
    found.push_back(line.substr(from, to - from));
    at = to;
  }
  return found;
}

template <class Number>
Number DumpLines::number(std::string_view word) const {
  Number value{};
  const auto [end, status] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (status != std::errc{} || end != word.data() + word.size())
    fail(fmt::format("\"{}\" is not a number of the kind expected here", word.substr(0, 40)));
  if constexpr (std::is_floating_point_v<Number>)
    if (!std::isfinite(value)) fail(fmt::format("\"{}\" is not finite", word.substr(0, 40)));
  return value;
}
template double DumpLines::number<double>(std::string_view) const;
template std::int64_t DumpLines::number<std::int64_t>(std::string_view) const;
template std::uint64_t DumpLines::number<std::uint64_t>(std::string_view) const;
template int DumpLines::number<int>(std::string_view) const;

namespace {

struct Header {
  std::int64_t step = 0;
  std::uint64_t count = 0;
  Box box;
  std::vector<std::string> columns;
};

/// An id in a local dump is printed as a floating-point number ("12" or "1.2e+06").
std::int64_t whole_number(const DumpLines& lines, std::string_view word) {
  const double value = lines.number<double>(word);
  // 2^53: beyond it a double cannot tell neighbouring ids apart.
  if (value != std::floor(value) || std::abs(value) > 9007199254740992.0)
    lines.fail(fmt::format("\"{}\" is not a whole number", word));
  return static_cast<std::int64_t>(value);
}

bool expect_item(DumpLines& lines, std::string_view prefix, std::string& rest) {
  std::string_view line;
  if (!lines.next(line)) return false;
  if (!line.starts_with(prefix))
    lines.fail(fmt::format("expected \"{}\", found \"{}\"", prefix, line.substr(0, 60)));
  rest = std::string(line.substr(prefix.size()));
  return true;
}

/// Reads the nine header lines. False if the file ends among them.
bool read_header(DumpLines& lines, std::string_view what, std::int64_t last_step, Header& header) {
  std::string rest;
  std::string_view line;
  if (!expect_item(lines, "ITEM: TIMESTEP", rest)) return false;
  if (!lines.next(line)) return false;
  const auto step = DumpLines::words(line);
  if (step.size() != 1) lines.fail("expected one step number");
  header.step = lines.number<std::int64_t>(step[0]);
  if (header.step <= last_step)
    lines.fail(fmt::format("step {} does not follow step {}", header.step, last_step));

  if (!expect_item(lines, fmt::format("ITEM: NUMBER OF {}", what), rest)) return false;
  if (!lines.next(line)) return false;
  const auto count = DumpLines::words(line);
  if (count.size() != 1) lines.fail("expected one count");
  header.count = lines.number<std::uint64_t>(count[0]);

  if (!expect_item(lines, "ITEM: BOX BOUNDS", rest)) return false;
  const auto flags = DumpLines::words(rest);
  if (flags.size() != 3) lines.fail("only boxes with axes along x, y and z are understood (\"pp pp ff\")");
  for (int k = 0; k < 3; ++k) {
    header.box.periodic[static_cast<std::size_t>(k)] = flags[static_cast<std::size_t>(k)] == "pp";
    if (!lines.next(line)) return false;
    const auto bounds = DumpLines::words(line);
    if (bounds.size() != 2) lines.fail("expected the lower and the upper bound of the box");
    header.box.low[k] = lines.number<double>(bounds[0]);
    header.box.high[k] = lines.number<double>(bounds[1]);
    if (!(header.box.low[k] < header.box.high[k])) lines.fail("the box has no extent");
  }

  const std::string rows = what == "ATOMS" ? "ITEM: ATOMS" : "ITEM: ENTRIES";
  if (!expect_item(lines, rows, rest)) return false;
  header.columns.clear();
  for (const auto word : DumpLines::words(rest)) header.columns.emplace_back(word);
  // Each number of a row takes two characters at least, itself and what ends it: a larger count is a damaged
  // number and must not become an allocation.
  const std::uint64_t row_bytes = 2 * std::max<std::uint64_t>(1, header.columns.size());
  if (header.count > lines.bytes() / row_bytes)
    lines.fail(fmt::format("{} rows of {} columns cannot stand in a file of {} bytes", header.count,
                           header.columns.size(), lines.bytes()));
  return true;
}

}  // namespace

ReadResult GrainDump::next(GrainFrame& frame) {
  if (lines_.at_end()) return ReadResult::end;
  Header header;
  if (!read_header(lines_, "ATOMS", last_step_, header)) return ReadResult::incomplete;

  const std::array<std::string_view, 9> names{"id", "type", "x", "y", "z", "vx", "vy", "vz", "radius"};
  const auto column = [&](std::string_view name) {
    const auto found = std::find(header.columns.begin(), header.columns.end(), name);
    if (found == header.columns.end()) lines_.fail(fmt::format("the dump has no column \"{}\"", name));
    if (std::find(found + 1, header.columns.end(), name) != header.columns.end())
      lines_.fail(fmt::format("the dump has two columns \"{}\"", name));
    return static_cast<std::size_t>(found - header.columns.begin());
  };
  std::array<std::size_t, names.size()> at{};
  std::transform(names.begin(), names.end(), at.begin(), column);
  std::array<std::size_t, stress_columns.size()> stress_at{};
  const bool stressed =
      std::any_of(header.columns.begin(), header.columns.end(), [](const std::string& name) {
        return std::find(stress_columns.begin(), stress_columns.end(), name) != stress_columns.end();
      });
  if (stressed) std::transform(stress_columns.begin(), stress_columns.end(), stress_at.begin(), column);

  GrainFrame read;
  read.step = header.step;
  read.box = header.box;
  read.grains.reserve(header.count);
  std::unordered_set<std::int64_t> seen;
  seen.reserve(header.count);
  std::string_view line;
  for (std::uint64_t row = 0; row < header.count; ++row) {
    if (!lines_.next(line)) return ReadResult::incomplete;
    const auto cells = DumpLines::words(line);
    if (cells.size() != header.columns.size())
      lines_.fail(fmt::format("{} numbers in a row of {} columns", cells.size(), header.columns.size()));
    Grain grain;
    grain.id = lines_.number<std::int64_t>(cells[at[0]]);
    if (!seen.insert(grain.id).second) lines_.fail(fmt::format("grain {} stands here twice", grain.id));
    const int type = lines_.number<int>(cells[at[1]]);
    if (type < 1 || type > 3) lines_.fail(fmt::format("grain type {} is none of 1, 2, 3", type));
    grain.type = static_cast<GrainType>(type);
    for (int k = 0; k < 3; ++k) {
      grain.x[k] = lines_.number<double>(cells[at[static_cast<std::size_t>(2 + k)]]);
      grain.v[k] = lines_.number<double>(cells[at[static_cast<std::size_t>(5 + k)]]);
    }
    grain.radius = lines_.number<double>(cells[at[8]]);
    if (!(grain.radius > 0)) lines_.fail(fmt::format("grain {} has no radius", grain.id));
    if (stressed) {
      grain.stress_volume.emplace();
      for (std::size_t k = 0; k < stress_at.size(); ++k)
        (*grain.stress_volume)[k] = lines_.number<double>(cells[stress_at[k]]);
    }
    read.grains.push_back(grain);
  }
  last_step_ = read.step;
  frame = std::move(read);
  return ReadResult::frame;
}

ContactDump::ContactDump(const std::filesystem::path& path, const ContactColumns& columns)
    : lines_(path), columns_(columns) {
  for (const int column :
       {columns.first, columns.second, columns.force[0], columns.force[1], columns.force[2]})
    if (column < 0 || column >= columns.count)
      throw InputError(fmt::format("{}: column {} of the map does not exist", path.string(), column));
}

ReadResult ContactDump::next(ContactFrame& frame) {
  if (lines_.at_end()) return ReadResult::end;
  Header header;
  if (!read_header(lines_, "ENTRIES", last_step_, header)) return ReadResult::incomplete;
  if (header.columns.size() != static_cast<std::size_t>(columns_.count))
    lines_.fail(fmt::format("{} columns, but the run's map names {}", header.columns.size(), columns_.count));

  ContactFrame read;
  read.step = header.step;
  read.box = header.box;
  read.contacts.reserve(header.count);
  std::set<std::pair<std::int64_t, std::int64_t>> seen;
  std::string_view line;
  for (std::uint64_t row = 0; row < header.count; ++row) {
    if (!lines_.next(line)) return ReadResult::incomplete;
    const auto cells = DumpLines::words(line);
    if (cells.size() != header.columns.size())
      lines_.fail(fmt::format("{} numbers in a row of {} columns", cells.size(), header.columns.size()));
    const auto cell = [&](int column) { return cells[static_cast<std::size_t>(column)]; };
    Contact contact;
    contact.first = whole_number(lines_, cell(columns_.first));
    contact.second = whole_number(lines_, cell(columns_.second));
    if (contact.first == contact.second) lines_.fail(fmt::format("grain {} touches itself", contact.first));
    // A cell is at least 5 d wide, so no two grains touch twice, through two periodic images.
    if (!seen.emplace(std::minmax(contact.first, contact.second)).second)
      lines_.fail(fmt::format("the contact of {} and {} stands here twice", contact.first, contact.second));
    for (int k = 0; k < 3; ++k)
      contact.force[k] = lines_.number<double>(cell(columns_.force[static_cast<std::size_t>(k)]));
    read.contacts.push_back(contact);
  }
  last_step_ = read.step;
  frame = std::move(read);
  return ReadResult::frame;
}

}  // namespace dem2sph::bridge
