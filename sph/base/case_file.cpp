#include "sph/base/case_file.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <optional>
#include <sstream>
#include <utility>

#include "sph/base/errors.hpp"
#include "sph/base/units.hpp"

namespace dem2sph {

struct Section::Value {
  const Parameter* parameter = nullptr;
  bool given = false;
  bool set = false;
  long line = 0;              // 0: from --set or a default
  std::vector<double> reals;  // SI
  bool truth = false;
  bool with_unit = false;  // number_or_quantity: which of the two
  std::string text;        // word or file
  std::string written;     // as it would stand in a case file
  mutable bool used = false;
};

struct Section::State {
  std::string file;
  std::filesystem::path folder;
  ParameterTable table;
  std::map<std::string, Value, std::less<>> values;
  std::string lines;  // all values as TOML
};

namespace detail {
struct CaseDocument {
  std::filesystem::path path;
  std::string name;
  toml::table root;
  std::vector<std::pair<std::string, std::string>> effective;  // section, lines
};
}  // namespace detail

namespace {

std::string place(const std::string& file, long line) {
  return line > 0 ? fmt::format("{}:{}", file, line) : file;
}

long line_of(const toml::node& node) { return static_cast<long>(node.source().begin.line); }

std::string kind_in_words(const Parameter& p) {
  switch (p.kind) {
    case Kind::quantity:
      return fmt::format("a quantity in quotes such as \"1 {}\"", p.unit);
    case Kind::number:
      return "a number";
    case Kind::integer:
      return "a whole number";
    case Kind::flag:
      return "true or false";
    case Kind::word:
      return fmt::format("one of \"{}\"", fmt::join(p.words, "\", \""));
    case Kind::file:
      return "a file name in quotes";
    case Kind::quantities:
      return fmt::format("a list of quantities such as [\"1 {}\"]", p.unit);
    case Kind::numbers:
      return "a list of numbers";
    case Kind::integers:
      return "a list of whole numbers";
    case Kind::number_or_quantity:
      return fmt::format("a number, or a quantity in quotes such as \"1 {}\"", p.unit);
  }
  return "";
}

// One element of a key's value, in SI, checked against the bounds.
double element(const toml::node& node, const Parameter& p) {
  const auto wrong = [&]() -> UsageError {
    return UsageError(fmt::format("\"{}\" must be {}", p.name, kind_in_words(p)));
  };
  double value = 0;
  const bool has_unit = p.kind == Kind::quantity || p.kind == Kind::quantities ||
                        (p.kind == Kind::number_or_quantity && node.is_string());
  const bool whole = p.kind == Kind::integer || p.kind == Kind::integers;
  if (has_unit) {
    if (node.is_number())
      throw UsageError(fmt::format("\"{}\" needs a unit: write {}", p.name, kind_in_words(p)));
    const auto text = node.value_exact<std::string>();
    if (!text) throw wrong();
    try {
      value = parse_quantity(*text, p.unit);
    } catch (const UsageError& error) {
      throw UsageError(fmt::format("\"{}\": {}", p.name, error.what()));
    }
  } else if (whole) {
    const auto integer = node.value_exact<int64_t>();
    if (!integer) throw wrong();
    if (std::llabs(*integer) > (1LL << 53))  // beyond this a double does not hold every whole number
      throw UsageError(fmt::format("\"{}\" = {} is too large", p.name, *integer));
    value = static_cast<double>(*integer);
  } else {
    if (node.is_string())
      throw UsageError(fmt::format("\"{}\" is a pure number: write it without quotes", p.name));
    const auto number = node.value<double>();
    if (!number || node.is_boolean()) throw wrong();
    value = *number;
  }
  if (!std::isfinite(value)) throw UsageError(fmt::format("\"{}\" must be a finite number", p.name));
  if (!(value >= p.minimum && value <= p.maximum)) {
    const bool bare = p.unit.empty() || (p.kind == Kind::number_or_quantity && !has_unit);
    throw UsageError(fmt::format("\"{}\" = {:g}{} is outside [{:g}, {:g}]", p.name, value,
                                 bare ? "" : " " + p.unit, p.minimum, p.maximum));
  }
  return value;
}

std::string written(const toml::node& node) {
  std::ostringstream out;
  node.visit([&](const auto& concrete) {
    if constexpr (toml::is_string<decltype(concrete)>)
      out << toml::toml_formatter(concrete, toml::format_flags::none);  // escapes what has to be
    else if constexpr (toml::is_array<decltype(concrete)>) {
      out << '[';
      for (std::size_t i = 0; i < concrete.size(); ++i) out << (i ? ", " : "") << written(concrete[i]);
      out << ']';
    } else if constexpr (toml::is_floating_point<decltype(concrete)>)
      out << fmt::format("{}", concrete.get());  // the shortest text that reads back the same
    else if constexpr (toml::is_value<decltype(concrete)>)
      out << concrete;
  });
  return out.str();
}

std::string fallback_as_toml(const Parameter& p) {
  // Of a bare number and a quantity, the quantity is what has a space before its unit.
  const bool quoted = p.kind == Kind::quantity || p.kind == Kind::word || p.kind == Kind::file ||
                      (p.kind == Kind::number_or_quantity && p.fallback.find(' ') != std::string::npos);
  return quoted ? fmt::format("\"{}\"", p.fallback) : p.fallback;
}

// The part before the name of a table that stands for all sub-tables: "wall." of "wall.*"; empty for other
// tables.
std::string_view any_prefix(std::string_view section) {
  return section.ends_with(".*") ? section.substr(0, section.size() - 1) : std::string_view{};
}

// A name of a sub-table must be one word of a path, or messages and --set could not say which table they
// mean.
bool is_name(std::string_view name) {
  return !name.empty() && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
  });
}

// Whether a table is for `section`: by its own name, or as one of all sub-tables.
bool is_for(std::string_view table, std::string_view section) {
  const std::string_view prefix = any_prefix(table);
  if (prefix.empty()) return table == section;
  return section.starts_with(prefix) && is_name(section.substr(prefix.size()));
}

}  // namespace

const Section::Value& Section::read(std::string_view name, Kind kind) const {
  const auto found = state_->values.find(name);
  if (found == state_->values.end() || found->second.parameter->kind != kind)
    throw std::logic_error(
        fmt::format("parameter {}.{} is not declared with this kind", state_->table.section, name));
  found->second.used = true;
  return found->second;
}

double Section::quantity(std::string_view name) const {
  const Value& v = read(name, Kind::quantity);
  return v.set ? v.reals[0] : std::numeric_limits<double>::quiet_NaN();
}
double Section::number(std::string_view name) const {
  const Value& v = read(name, Kind::number);
  return v.set ? v.reals[0] : std::numeric_limits<double>::quiet_NaN();
}
long Section::integer(std::string_view name) const {
  const Value& v = read(name, Kind::integer);
  if (!v.set) throw std::logic_error(fmt::format("integer parameter {} may not be unset", name));
  return std::lround(v.reals[0]);
}
bool Section::flag(std::string_view name) const { return read(name, Kind::flag).truth; }
std::string Section::word(std::string_view name) const { return read(name, Kind::word).text; }
std::filesystem::path Section::file(std::string_view name) const {
  const Value& v = read(name, Kind::file);
  if (!v.set) return {};
  const std::filesystem::path path = v.text;
  return path.is_absolute() ? path : state_->folder / path;
}
std::vector<double> Section::quantities(std::string_view name) const {
  return read(name, Kind::quantities).reals;
}
std::vector<double> Section::numbers(std::string_view name) const { return read(name, Kind::numbers).reals; }
std::vector<long> Section::integers(std::string_view name) const {
  std::vector<long> result;
  for (double v : read(name, Kind::integers).reals) result.push_back(std::lround(v));
  return result;
}
double Section::number_or_quantity(std::string_view name) const {
  const Value& v = read(name, Kind::number_or_quantity);
  return v.set ? v.reals[0] : std::numeric_limits<double>::quiet_NaN();
}
bool Section::has_unit(std::string_view name) const { return read(name, Kind::number_or_quantity).with_unit; }
bool Section::given(std::string_view name) const {
  const auto found = state_->values.find(name);
  return found != state_->values.end() && found->second.given;
}
std::string Section::where(std::string_view name) const {
  const auto found = state_->values.find(name);
  return place(state_->file, found == state_->values.end() ? 0 : found->second.line);
}
void Section::refuse(std::string_view name, const std::string& message) const {
  throw UsageError(fmt::format("{}: [{}] {}", where(name), state_->table.section, message));
}
void Section::finish(const std::string& because) const {
  for (const auto& [name, value] : state_->values)
    if (value.given && !value.used)
      refuse(name, fmt::format("\"{}\" changes nothing {}; remove it", name, because));
}

std::string Section::text() const { return fmt::format("[{}]\n{}", state_->table.section, state_->lines); }

CaseFile CaseFile::load(const std::filesystem::path& path, std::span<const std::string> overrides) {
  std::ifstream in(path);
  if (!in || std::filesystem::is_directory(path))
    throw InputError(fmt::format("{}: cannot open the case file", path.string()));
  std::ostringstream text;
  text << in.rdbuf();
  CaseFile file = parse(text.str(), path.string(), overrides);
  file.document_->path = path;
  return file;
}

CaseFile CaseFile::parse(std::string_view text, const std::string& name,
                         std::span<const std::string> overrides) {
  CaseFile file;
  file.document_ = std::make_shared<detail::CaseDocument>();
  file.document_->name = name;
  file.document_->path = name;
  try {
    file.document_->root = toml::parse(text, name);
  } catch (const toml::parse_error& error) {
    throw UsageError(fmt::format("{}:{}: {}", name, error.source().begin.line, error.description()));
  }
  for (const std::string& override_text : overrides) {
    const auto refuse = [&] {
      return UsageError(fmt::format("--set {}: write section.key=value, for example --set flow.resolution=40",
                                    override_text));
    };
    const std::size_t equals = override_text.find('=');
    if (equals == std::string::npos) throw refuse();
    const std::string path = override_text.substr(0, equals);
    const std::string value = override_text.substr(equals + 1);
    const std::size_t dot = path.rfind('.');
    if (dot == std::string::npos || dot == 0 || value.empty()) throw refuse();

    // A value that is no TOML by itself (a word, a quantity) is meant as a string.
    toml::table parsed;
    try {
      parsed = toml::parse("v = " + value);
    } catch (const toml::parse_error&) {
      parsed.insert_or_assign("v", value);
    }
    toml::table* at = &file.document_->root;
    std::stringstream sections(path.substr(0, dot));
    for (std::string part; std::getline(sections, part, '.');) {
      if (!at->contains(part)) at->insert(part, toml::table{});
      at = at->get(part)->as_table();
      if (at == nullptr) throw refuse();
    }
    // Copied through a fresh node, so that messages do not name a line of the file.
    parsed.get("v")->visit([&](const auto& node) { at->insert_or_assign(path.substr(dot + 1), node); });
  }
  return file;
}

const std::filesystem::path& CaseFile::path() const { return document_->path; }

bool CaseFile::has(std::string_view section) const {
  return static_cast<bool>(document_->root.at_path(section).as_table());
}

void CaseFile::erase(std::string_view section, std::string_view key) {
  if (toml::table* table = document_->root.at_path(section).as_table()) table->erase(key);
  std::erase_if(document_->effective, [&](const auto& entry) { return entry.first == section; });
}

std::vector<std::string> CaseFile::subsections(std::string_view section) const {
  const toml::table* table = std::as_const(document_->root).at_path(section).as_table();
  if (table == nullptr) return {};
  struct Found {
    std::string name;
    toml::source_position begin;
  };
  std::vector<Found> found;
  for (const auto& [key, node] : *table)
    if (node.is_table()) found.push_back({std::string(key.str()), node.source().begin});
  // The parser sorts by name; positions bring the order of the file back. What --set made has line 0.
  std::stable_sort(found.begin(), found.end(), [](const Found& a, const Found& b) {
    if ((a.begin.line == 0) != (b.begin.line == 0)) return b.begin.line == 0;
    return std::pair(a.begin.line, a.begin.column) < std::pair(b.begin.line, b.begin.column);
  });
  std::vector<std::string> names;
  for (const Found& f : found) names.push_back(f.name);
  return names;
}

Section CaseFile::section(const ParameterTable& table, std::string_view name) const {
  const std::string_view prefix = any_prefix(table.section);
  if (prefix.empty())
    throw std::logic_error(fmt::format("the table [{}] does not stand for sub-tables", table.section));
  if (!is_name(name))
    throw UsageError(fmt::format("{}: [{}{}]: the name may hold letters, digits, - and _ only",
                                 document_->name, prefix, name));
  ParameterTable one = table;
  one.section = fmt::format("{}{}", prefix, name);
  return section(one);
}

Section CaseFile::section(const ParameterTable& table) const {
  if (!any_prefix(table.section).empty())
    throw std::logic_error(fmt::format("[{}] stands for many sections: say which", table.section));
  Section section;
  section.state_ = std::make_shared<Section::State>();
  Section::State& state = *section.state_;
  state.file = document_->name;
  state.folder = document_->path.parent_path();
  state.table = table;

  const toml::node_view<const toml::node> view = std::as_const(document_->root).at_path(table.section);
  const toml::table* given = view.as_table();
  if (view && given == nullptr)
    throw UsageError(fmt::format("{}: \"{}\" must be a section: write [{}]",
                                 place(state.file, line_of(*view.node())), table.section, table.section));
  if (given != nullptr) {
    std::vector<std::string> names;
    for (const Parameter& p : table.parameters) names.push_back(p.name);
    for (const auto& [key, node] : *given) {
      if (node.is_table()) continue;  // a sub-section with a table of its own, checked by validate()
      bool known = false;
      for (const std::string& name : names) known = known || name == key.str();
      if (known) continue;
      const std::string near = nearest(key.str(), names);
      throw UsageError(fmt::format("{}: [{}] unknown key \"{}\"{}", place(state.file, line_of(node)),
                                   table.section, key.str(),
                                   near.empty() ? fmt::format("; known: {}", fmt::join(names, ", "))
                                                : fmt::format("; did you mean \"{}\"?", near)));
    }
  }

  std::string& lines = state.lines;
  for (const Parameter& p : state.table.parameters) {
    Section::Value value;
    value.parameter = &p;
    const toml::node* node = given != nullptr ? given->get(p.name) : nullptr;
    toml::table fallback;
    if (node != nullptr) {
      value.given = true;
      value.line = line_of(*node);
    } else if (p.fallback == "required") {
      const long line = given != nullptr ? line_of(*given) : 0;
      throw UsageError(fmt::format("{}: [{}] lacks the required key \"{}\": {}", place(state.file, line),
                                   table.section, p.name, p.sentence));
    } else if (p.fallback != "unset") {
      fallback = toml::parse("v = " + fallback_as_toml(p));
      node = fallback.get("v");
    }
    if (node != nullptr) {
      try {
        value.set = true;
        value.written = written(*node);
        switch (p.kind) {
          case Kind::flag: {
            const auto truth = node->value_exact<bool>();
            if (!truth) throw UsageError(fmt::format("\"{}\" must be true or false", p.name));
            value.truth = *truth;
            break;
          }
          case Kind::word:
          case Kind::file: {
            const auto text = node->value_exact<std::string>();
            if (!text || text->empty())
              throw UsageError(fmt::format("\"{}\" must be {}", p.name, kind_in_words(p)));
            value.text = *text;
            if (p.kind == Kind::word && std::find(p.words.begin(), p.words.end(), *text) == p.words.end()) {
              const std::string near = nearest(*text, p.words);
              throw UsageError(fmt::format("unknown {} \"{}\"{}", p.name, *text,
                                           near.empty() ? fmt::format("; it must be {}", kind_in_words(p))
                                                        : fmt::format("; did you mean \"{}\"?", near)));
            }
            break;
          }
          case Kind::quantities:
          case Kind::numbers:
          case Kind::integers: {
            const toml::array* list = node->as_array();
            if (list == nullptr) throw UsageError(fmt::format("\"{}\" must be {}", p.name, kind_in_words(p)));
            for (const toml::node& item : *list) value.reals.push_back(element(item, p));
            break;
          }
          default:
            value.with_unit = node->is_string();
            value.reals.push_back(element(*node, p));
        }
      } catch (const UsageError& error) {
        throw UsageError(
            fmt::format("{}: [{}] {}", place(state.file, value.line), table.section, error.what()));
      }
      lines += fmt::format("{} = {}{}\n", p.name, value.written, value.given ? "" : "  # default");
    }
    state.values.emplace(p.name, std::move(value));
  }
  for (auto& [name, text] : document_->effective)
    if (name == table.section) return section;  // already written once
  document_->effective.emplace_back(table.section, lines);
  return section;
}

void CaseFile::validate(std::span<const ParameterTable* const> tables) const {
  std::vector<std::string> names;
  std::vector<std::string> meant;  // what a misspelt section may have been
  for (const ParameterTable* table : tables) {
    names.push_back(table->section);
    const std::string_view prefix = any_prefix(table->section);
    meant.emplace_back(prefix.empty() ? table->section : prefix.substr(0, prefix.size() - 1));
  }
  const auto known = [&](const std::string& section) {
    for (const std::string& name : names)
      if (is_for(name, section) || name.starts_with(section + ".")) return true;
    return false;
  };
  const auto walk = [&](const auto& self, const toml::table& at, const std::string& prefix) -> void {
    for (const auto& [key, node] : at) {
      const std::string section = prefix + std::string(key.str());
      if (const toml::table* table = node.as_table()) {
        if (!known(section)) {
          const std::string near = nearest(section, meant);
          throw UsageError(fmt::format("{}: unknown section [{}]{}", place(document_->name, line_of(node)),
                                       section,
                                       near.empty() ? fmt::format("; known: {}", fmt::join(names, ", "))
                                                    : fmt::format("; did you mean [{}]?", near)));
        }
        self(self, *table, section + ".");
      } else if (prefix.empty()) {
        throw UsageError(fmt::format("{}: the key \"{}\" stands outside any section",
                                     place(document_->name, line_of(node)), section));
      } else if (const std::string parent = prefix.substr(0, prefix.size() - 1);
                 std::none_of(names.begin(), names.end(),
                              [&](const std::string& name) { return is_for(name, parent); })) {
        throw UsageError(fmt::format("{}: unknown key \"{}\": the section [{}] has only sub-sections",
                                     place(document_->name, line_of(node)), key.str(), parent));
      }
    }
  };
  walk(walk, document_->root, "");
  for (const ParameterTable* table : tables) {
    const std::string_view prefix = any_prefix(table->section);
    if (prefix.empty()) {
      if (has(table->section)) section(*table);
    } else {
      for (const std::string& name : subsections(prefix.substr(0, prefix.size() - 1))) section(*table, name);
    }
  }
}

std::string CaseFile::effective() const {
  std::string text;
  for (const auto& [section, lines] : document_->effective) text += fmt::format("[{}]\n{}\n", section, lines);
  return text;
}

std::string describe(const ParameterTable& table) {
  std::string text = fmt::format("[{}]  {}\n", table.section, table.sentence);
  for (const Parameter& p : table.parameters) {
    std::string bounds;
    if (std::isfinite(p.minimum) || std::isfinite(p.maximum))
      bounds = fmt::format(" in [{:g}, {:g}]{}", p.minimum, p.maximum, p.unit.empty() ? "" : " " + p.unit);
    text +=
        fmt::format("  {:<22} {}{}; {}\n  {:<22} {}\n", p.name, kind_in_words(p), bounds,
                    p.fallback == "required" || p.fallback == "unset" ? p.fallback : "default " + p.fallback,
                    "", p.sentence);
  }
  return text;
}

}  // namespace dem2sph
