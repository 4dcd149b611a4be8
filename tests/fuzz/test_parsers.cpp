// Every prefix of a valid file, and thousands of damaged ones, end in a clear error or are read: never in a
// crash or in an exception that is not ours. The fuzzers of this folder do the same for hours.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <random>

#include "sph/base/errors.hpp"
#include "tests/base/helpers.hpp"
#include "tests/fuzz/parsers.hpp"

namespace dem2sph {
namespace {

enum class Outcome { read, refused };

class Parsers : public test::Scratch {
 protected:
  /// What becomes of these bytes. An error has to name the file.
  Outcome outcome_of(const fuzz::Parser& parser, const std::string& bytes) {
    test::put(in("file"), bytes);
    try {
      parser.read(in("file"));
      return Outcome::read;
    } catch (const Error& error) {
      EXPECT_CONTAINS(error.what(), "file") << parser.name;
      EXPECT_TRUE(error.code() == ExitCode::unreadable || error.code() == ExitCode::usage)
          << parser.name << ": " << error.what();
      return Outcome::refused;
    }  // any other exception ends the test
  }
};

TEST_F(Parsers, ReadWhatOurWritersWrite) {
  for (const fuzz::Parser& parser : fuzz::parsers())
    for (const std::string& seed : parser.seeds(in("seed")))
      EXPECT_EQ(outcome_of(parser, seed), Outcome::read) << parser.name;
}

TEST_F(Parsers, EveryPrefixIsRefusedOrStopsWhereAPartEnds) {
  // Text that is a list of lines or tables is valid where a line ends: dumps report the frame that is cut as
  // `incomplete`, a wall series and a case file are shorter. Binary files and JSON are never valid when cut.
  for (const fuzz::Parser& parser : fuzz::parsers()) {
    const bool in_one_piece = parser.name == "observables" || parser.name == "frame" || parser.name == "law";
    for (const std::string& seed : parser.seeds(in("seed"))) {
      // Long binary files: every length up to 600 and then every 97th byte.
      for (std::size_t length = 0; length < seed.size(); length += length < 600 || !in_one_piece ? 1 : 97) {
        const Outcome outcome = outcome_of(parser, seed.substr(0, length));
        if (in_one_piece && length + 1 < seed.size()) {  // JSON without its last newline is whole
          EXPECT_EQ(outcome, Outcome::refused) << parser.name << " cut at " << length;
        }
      }
    }
  }
}

TEST_F(Parsers, DamageIsRefusedOrHarmless) {
  std::mt19937 random(20260103);
  const char* const replacements[] = {
      "nan",  "inf",  "-1",       "1e999", "18446744073709551615", "9223372036854775808", "1e-320", "",
      "\x00", "\xff", "[[[[[[[[", "0"};
  for (const fuzz::Parser& parser : fuzz::parsers()) {
    const std::string seed = parser.seeds(in("seed")).front();
    int refused = 0;
    const int rounds = 1500;
    for (int i = 0; i < rounds; ++i) {
      std::string bytes = seed;
      for (std::size_t hits = 1 + random() % 3; hits > 0; --hits) {
        const std::size_t at = random() % bytes.size();
        switch (random() % 5) {
          case 0:
            bytes[at] = static_cast<char>(random());
            break;
          case 1:
            bytes.erase(at, 1 + random() % 20);
            break;
          case 2:
            bytes.insert(at, bytes.substr(random() % bytes.size(), random() % 40));
            break;
          case 3:
            bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
            break;
          default: {
            // A number, where there is one nearby, becomes an impossible one.
            const std::size_t from = bytes.find_first_of("0123456789", at);
            if (from == std::string::npos) break;
            const std::size_t to = std::min(bytes.find_first_not_of("0123456789.e-", from), bytes.size());
            bytes.replace(from, to - from, replacements[random() % std::size(replacements)]);
          }
        }
        if (bytes.empty()) bytes.assign(1, ' ');
      }
      refused += outcome_of(parser, bytes) == Outcome::refused;
    }
    // Damage is mostly seen; HDF5 has bytes that nobody reads.
    EXPECT_GT(refused, rounds / 10) << parser.name;
  }
}

TEST_F(Parsers, WhatMustBeRefusedIs) {
  const auto parser = [](const char* name) -> const fuzz::Parser& {
    for (const fuzz::Parser& p : fuzz::parsers())
      if (p.name == name) return p;
    throw std::out_of_range(name);
  };
  const auto message = [&](const char* name, const std::string& from, const std::string& to) {
    std::string bytes = parser(name).seeds(in("seed")).front();
    const std::size_t at = bytes.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    bytes.replace(at, from.size(), to);
    test::put(in("file"), bytes);
    try {
      parser(name).read(in("file"));
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  EXPECT_CONTAINS(message("grain_dump", "vx vy", "vx vw"), "no column \"vy\"");
  EXPECT_CONTAINS(message("grain_dump", "radius", "radius x"), "two columns \"x\"");
  EXPECT_CONTAINS(message("grain_dump", "\n12\n", "\n4000000000\n"),
                  "rows of 9 columns cannot stand in a file of");
  EXPECT_CONTAINS(message("contact_dump", "\n8\n", "\n18446744073709551615\n"), "cannot stand in a file of");
  EXPECT_CONTAINS(message("wall_series", "998.5", "nan"), "file:4: \"nan\" is not finite");
  EXPECT_CONTAINS(message("wall_series", "20 0.0111", "10 0.0111"), "file:4: steps do not increase");
  EXPECT_CONTAINS(message("case", "grains = 900", "grains = 900\ngrains = 901"), "file:");
  EXPECT_CONTAINS(message("case", "0.5", "nan"), "file:4");
}

TEST_F(Parsers, AContactThatStandsTwiceIsRefused) {
  for (const fuzz::Parser& parser : fuzz::parsers()) {
    if (parser.name != "contact_dump") continue;
    std::string bytes = parser.seeds(in("seed")).front();
    // The first row once more, its grains the other way round, in the place of the second.
    const std::size_t first = bytes.find('\n', bytes.find("ITEM: ENTRIES")) + 1;
    const std::size_t second = bytes.find('\n', first) + 1;
    const std::size_t third = bytes.find('\n', second) + 1;
    std::string row = bytes.substr(first, second - first);
    const std::size_t blank = row.find(' '), next = row.find(' ', blank + 1);
    row = fmt::format("{} {}{}", row.substr(blank + 1, next - blank - 1), row.substr(0, blank),
                      row.substr(next));
    bytes.replace(second, third - second, row);
    test::put(in("file"), bytes);
    const std::string message = test::message_of<InputError>([&] { parser.read(in("file")); });
    EXPECT_CONTAINS(message, "stands here twice");
  }
}

}  // namespace
}  // namespace dem2sph
