// The case file: TOML whose keys are declared once, in tables with name, unit, bounds, default and a
// sentence. Reading, checking, help and the written-out effective configuration all come from these tables.
//
//   inline const ParameterTable bed_table{"bed", "A bed of grains.", {
//       {"height", Kind::quantity, "m", 0, 1e4, "required", "Height of the bed."},
//       {"layers", Kind::integer, "", 1, 1e6, "20", "Layers of particles."}}};
//   Section bed = case_file.section(bed_table);
//   const double height = bed.quantity("height");   // "50 cm" -> 0.5
//   bed.finish();                                    // every key that was given must have been read
#pragma once

#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace dem2sph {

enum class Kind {
  quantity,           ///< text with a unit: "1 mm"
  number,             ///< dimensionless: 0.5
  integer,            ///< whole: 20
  flag,               ///< true or false
  word,               ///< one of Parameter::words
  file,               ///< a path, relative to the case file
  quantities,         ///< list of texts with units
  numbers,            ///< list of numbers
  integers,           ///< list of whole numbers
  number_or_quantity  ///< 0.3, or text with a unit: "12 1/s"; Section::has_unit tells which. Bounds hold for
                      ///< both
};

inline constexpr double unbounded = std::numeric_limits<double>::infinity();

/// One key of a case file. `fallback` is the default as one would write it in the file, or "required",
/// or "unset" (the reader then gives NaN, an empty list or an empty text). Bounds are inclusive and in SI.
struct Parameter {
  std::string name;
  Kind kind = Kind::number;
  std::string unit;
  double minimum = -unbounded;
  double maximum = unbounded;
  std::string fallback = "required";
  std::string sentence;
  std::vector<std::string> words = {};
};

/// One `[section]` of a case file; a dot in the name makes a sub-table. A name that ends in ".*" stands for
/// every sub-table: "wall.*" for [wall.floor] and [wall.lid].
struct ParameterTable {
  std::string section;
  std::string sentence;
  std::vector<Parameter> parameters;
};

namespace detail {
struct CaseDocument;
}

/// A checked section of a case file. Values are in SI. Copies share the record of what has been read.
class Section {
 public:
  double quantity(std::string_view name) const;
  double number(std::string_view name) const;
  long integer(std::string_view name) const;
  bool flag(std::string_view name) const;
  std::string word(std::string_view name) const;
  std::filesystem::path file(std::string_view name) const;
  std::vector<double> quantities(std::string_view name) const;
  std::vector<double> numbers(std::string_view name) const;
  std::vector<long> integers(std::string_view name) const;
  double number_or_quantity(std::string_view name) const;
  /// Of a key of Kind::number_or_quantity: true if its value is text with a unit.
  bool has_unit(std::string_view name) const;

  /// True if the file (or --set) gives the key, rather than its default.
  bool given(std::string_view name) const;
  /// "case.toml:14" for a key that is given, "case.toml" otherwise.
  std::string where(std::string_view name) const;
  /// Throws UsageError at the place of the key.
  [[noreturn]] void refuse(std::string_view name, const std::string& message) const;
  /// Throws UsageError if a key is given that nobody read: an option that would change nothing is refused.
  /// `because` ends the message, for example "with stress = \"direct\"".
  void finish(const std::string& because = "in this combination") const;
  /// The section with all its values, as TOML.
  std::string text() const;

 private:
  friend class CaseFile;
  struct Value;
  struct State;
  const Value& read(std::string_view name, Kind kind) const;
  std::shared_ptr<State> state_;
};

/// A case file as a whole.
class CaseFile {
 public:
  /// Reads `path`; `overrides` are "section.key=value" as given to --set.
  /// Throws InputError if the file cannot be read, UsageError if it is not valid TOML.
  static CaseFile load(const std::filesystem::path& path, std::span<const std::string> overrides = {});
  /// The same from text; `name` stands for the file in messages.
  static CaseFile parse(std::string_view text, const std::string& name,
                        std::span<const std::string> overrides = {});

  const std::filesystem::path& path() const;
  bool has(std::string_view section) const;
  /// Takes a key out, as if it had not been given: for a case that is run in several variants.
  void erase(std::string_view section, std::string_view key);
  /// Checks the section against its table and returns its values. An absent section has all its defaults.
  /// Throws UsageError: unknown key (with "did you mean"), wrong type, unit or bound, required key missing.
  Section section(const ParameterTable& table) const;
  /// The same for one sub-table of a table whose name ends in ".*": "floor" for [wall.floor].
  Section section(const ParameterTable& table, std::string_view name) const;
  /// Names of the sub-tables of a section in the order of the file, those that only --set gives at the end.
  std::vector<std::string> subsections(std::string_view section) const;
  /// Checks the whole file: every section and key must be in one of `tables`.
  void validate(std::span<const ParameterTable* const> tables) const;
  /// All sections read so far with all their values, as TOML: the effective configuration.
  std::string effective() const;

 private:
  std::shared_ptr<detail::CaseDocument> document_;
};

/// Text of `dem2sph help`-like listings: one line a parameter with unit, bounds, default and sentence.
std::string describe(const ParameterTable& table);

}  // namespace dem2sph
