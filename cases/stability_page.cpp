#include "cases/stability_page.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "calibration/report.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph {

using nlohmann::json;

namespace {

struct Look {
  const char* status;
  const char* colour;
  const char* meaning;
};
// Colours of Okabe and Ito (2008), which people with any kind of sight tell apart.
constexpr Look looks[] = {{"stable", "#009E73", "stable"},
                          {"warned", "#E69F00", "ends with a warning that names the cause"},
                          {"stopped", "#0072B2", "stopped with a clear error"},
                          {"refused", "#56B4E9", "refused"},
                          {"silent", "#D55E00", "a wrong answer without a word"},
                          {"unexplained", "#000000", "unexplained"}};

const char* colour_of(const json& cell) {
  for (const Look& look : looks)
    if (cell.at("status") == look.status) return look.colour;
  return "#999999";
}

std::string map_svg(const json& result) {
  struct Row {
    std::string axis;
    std::vector<const json*> cells;
  };
  std::vector<Row> rows;
  std::size_t longest = 0;
  for (const char* side : {"solver", "grains"})
    for (const json& cell : result.at(side)) {
      const std::string axis =
          (cell.at("side") == "grains" ? "grains: " : "") + cell.at("axis").get<std::string>();
      if (rows.empty() || rows.back().axis != axis) rows.push_back({axis, {}});
      rows.back().cells.push_back(&cell);
      longest = std::max(longest, rows.back().cells.size());
    }
  constexpr int left = 230, side = 22, gap = 4, top = 12;
  const int width = left + static_cast<int>(longest) * (side + gap) + 20;
  const int height =
      top + static_cast<int>(rows.size()) * (side + gap) + 30 + 20 * static_cast<int>(std::size(looks));
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {0} {1}\" width=\"{0}\" height=\"{1}\" "
      "font-family=\"sans-serif\" font-size=\"13\">\n",
      width, height);
  int y = top;
  for (const Row& row : rows) {
    svg += fmt::format("<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\n", left - 10, y + 16,
                       escape_html(row.axis));
    int x = left;
    for (const json* cell : row.cells) {
      svg += fmt::format(
          "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"3\" fill=\"{}\"><title>{}: "
          "{}{}</title></rect>\n",
          x, y, side, side, colour_of(*cell), escape_html(cell->at("value").get<std::string>()),
          escape_html(cell->at("status").get<std::string>()),
          cell->at("text").get<std::string>().empty()
              ? ""
              : " - " + escape_html(cell->at("text").get<std::string>()));
      x += side + gap;
    }
    y += side + gap;
  }
  y += 14;
  for (const Look& look : looks) {
    svg += fmt::format(
        "<rect x=\"{}\" y=\"{}\" width=\"14\" height=\"14\" rx=\"2\" fill=\"{}\"/>"
        "<text x=\"{}\" y=\"{}\">{}</text>\n",
        left, y, look.colour, left + 22, y + 12, look.meaning);
    y += 20;
  }
  return svg + "</svg>\n";
}

std::string limits_table(const json& limits) {
  std::string text =
      "<div class=\"scroll\"><table>\n<tr><th>Composition</th><th class=\"n\">2/omega_max</th><th "
      "class=\"n\">with damping and diffusion</th><th class=\"n\">found on the lattice</th><th "
      "class=\"n\">found in a "
      "collapse</th></tr>\n";
  const auto number = [](const json& entry, const char* key) {
    return entry.contains(key) ? fmt::format("{:.2f}", entry.at(key).get<double>()) : std::string();
  };
  for (const json& e : limits)
    text += fmt::format(
        "<tr><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td "
        "class=\"n\">{}</td></tr>\n",
        escape_html(e.at("composition").get<std::string>()), number(e, "two_over_omega_max"),
        number(e, "linear"), number(e, "lattice"), number(e, "flowing"));
  return text + "</table></div>\n";
}

std::string cells_table(const json& cells) {
  std::string text =
      "<div class=\"scroll\"><table>\n<tr><th>Axis</th><th>Value</th><th>Ends</th><th>What it "
      "says</th></tr>\n";
  for (const json& c : cells) {
    std::vector<std::string> figures;
    const json measured = c.value("figures", json::object());
    for (const auto& [name, value] : measured.items())
      if (value.is_number()) figures.push_back(fmt::format("{} {:.3g}", name, value.get<double>()));
    text += fmt::format(
        "<tr><td>{}</td><td>{}</td><td style=\"color:{}\">{}</td><td>{}{}<br><small>{}</small></td></tr>\n",
        escape_html(c.at("axis").get<std::string>()), escape_html(c.at("value").get<std::string>()),
        colour_of(c), escape_html(c.at("status").get<std::string>()),
        escape_html(c.at("text").get<std::string>()),
        c.contains("oracle") ? escape_html(" (" + c.at("oracle").get<std::string>() + ")") : "",
        escape_html(fmt::format("{}", fmt::join(figures, ", "))));
  }
  return text + "</table></div>\n";
}

std::string counts(const json& result) {
  std::vector<std::string> parts;
  for (const Look& look : looks)
    if (const int n = result.at("count").value(look.status, 0); n > 0)
      parts.push_back(fmt::format("{} {}", n, look.status));
  return fmt::format("{}", fmt::join(parts, ", "));
}

}  // namespace

void write_stability_page(const json& result, const std::filesystem::path& folder) {
  const std::string svg = map_svg(result);
  write_file_atomically(folder / "stability.svg", svg);
  std::string body = "<h2>The map</h2>\n" +
                     figure_html(svg, "Each square is a run; hold the pointer over it to read how it ended.");
  if (!result.at("step_limits").empty())
    body +=
        "<h2>Longest stable steps</h2>\n<p>As multiples of the least bound of Eq. 5.28: 0.25 h/c with the "
        "elastic "
        "wave's c, and 0.125 h<sup>2</sup> rho/eta with direct stress. A collapse counts as stable while "
        "its energy is accounted for as well as with short steps, or to 5 %.</p>\n" +
        limits_table(result.at("step_limits"));
  if (!result.at("solver").empty()) body += "<h2>The solver</h2>\n" + cells_table(result.at("solver"));
  if (!result.at("grains").empty()) body += "<h2>The grains</h2>\n" + cells_table(result.at("grains"));
  write_page("Where the numerics hold", counts(result) + ".", body, result.at("provenance"),
             folder / "report.html");
}

std::string describe_stability(const json& result) {
  std::string text =
      fmt::format("{} ({:.0f} core-seconds)\n", counts(result), result.at("core_seconds").get<double>());
  for (const char* side : {"solver", "grains"})
    for (const json& c : result.at(side))
      if (c.at("status") == "silent" || c.at("status") == "unexplained")
        text += fmt::format("  {}: {}, {}: {}\n", c.at("status").get<std::string>(),
                            c.at("axis").get<std::string>(), c.at("value").get<std::string>(),
                            c.at("text").get<std::string>());
  if (!result.at("step_limits").empty())
    text += fmt::format("{:<42} {:>12} {:>8} {:>8} {:>8}\n", "longest step over 5.28's 0.25 h/c",
                        "2/omega_max", "linear", "lattice", "collapse");
  const auto number = [](const json& e, const char* key) {
    return e.contains(key) ? fmt::format("{:.2f}", e.at(key).get<double>()) : std::string("-");
  };
  for (const json& e : result.at("step_limits"))
    text += fmt::format("{:<42} {:>12} {:>8} {:>8} {:>8}\n", e.at("composition").get<std::string>(),
                        number(e, "two_over_omega_max"), number(e, "linear"), number(e, "lattice"),
                        number(e, "flowing"));
  return text;
}

}  // namespace dem2sph
