#include "cases/plan_picture.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "calibration/report.hpp"
#include "cases/grains.hpp"
#include "dem_bridge/plan.hpp"
#include "sph/base/errors.hpp"
#include "sph/scene.hpp"

namespace dem2sph {
namespace {

struct Dot {
  double x = 0, up = 0, radius = 0;  ///< [m]
  const char* colour = "";
};

/// One half of the picture.
struct Panel {
  std::string title;
  std::vector<Dot> dots;
  std::vector<std::array<double, 4>> outlines;  ///< bodies: x, up, width, height [m]
  std::vector<std::array<double, 4>> lines;     ///< smooth planes: from x, up to x, up [m]
};

constexpr const char *material_colour = "#0072B2", *wall_colour = "#9aa5b1", *falling_colour = "#a9cfe6";

template <int Dim>
Panel panel_of_sph(const CaseFile& file, const LawFile& law) {
  const FlowSetup<Dim> setup = make_setup<Dim>(file, law);
  const Particles<Dim>& q = setup.particles;
  Panel panel;
  panel.title =
      fmt::format("SPH: {} particles, {} in walls, dx = {:.3g} m", q.interior, q.size - q.interior, setup.dx);
  double across = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < q.size && Dim == 3; ++i) across = std::min(across, q.x[1][i]);
  for (std::size_t i = 0; i < q.size; ++i) {
    if (Dim == 3 && q.x[1][i] > across + 2 * law.d) continue;
    panel.dots.push_back(
        {q.x[0][i], q.x[Dim - 1][i], 0.5 * setup.dx, i < q.interior ? material_colour : wall_colour});
  }
  return panel;
}

Panel panel_of_grains(const bridge::GrainFlow& flow) {
  const std::vector<bridge::PlacedGrain> grains = bridge::place_grains(flow);
  Panel panel;
  std::size_t glued = 0;
  for (const bridge::PlacedGrain& g : grains) {
    glued += g.type != 1;
    if (g.x[1] > flow.geometry.low[1] + 2 * flow.material.d) continue;
    panel.dots.push_back({g.x[0], g.x[2], 0.5 * g.diameter, g.type == 1 ? falling_colour : wall_colour});
  }
  for (const Body<3>& b : flow.geometry.bodies) {
    const double r = b.shape == Body<3>::Shape::cylinder ? b.radius : 0;
    panel.outlines.push_back({b.low[0] - r, b.low[2], b.high[0] - b.low[0] + 2 * r, b.high[2] - b.low[2]});
  }
  const Vec<3>&low = flow.geometry.low, &high = flow.geometry.high;
  for (const Wall<3>& w : flow.geometry.walls) {
    if (w.rough || w.shape != WallShape::plane) continue;
    if (std::abs(w.direction[0]) > 0.5) panel.lines.push_back({w.point[0], low[2], w.point[0], high[2]});
    if (std::abs(w.direction[2]) > 0.5) panel.lines.push_back({low[0], w.point[2], high[0], w.point[2]});
  }
  panel.title = fmt::format("Grains: {} fall into the outlined body, {} glued to walls, d = {:.3g} m",
                            grains.size() - glued, glued, flow.material.d);
  return panel;
}

}  // namespace

std::string picture_of_plan(const CaseFile& file) {
  LawFile law = typical_law();
  std::vector<Panel> panels;
  std::optional<bridge::GrainFlowJob> grains;
  const CaseFile cell = shear_cell_case(file);
  if (cell.has("material")) {
    grains = grain_jobs(file, bridge::engine_unknown).front();
    law.d = grains->flow.material.d, law.rho_s = grains->flow.material.rho_s;
  } else if (file.has("law")) {
    law = law_of_case(file);
  }
  panels.push_back(flow_dimension(file) == 3 ? panel_of_sph<3>(file, law) : panel_of_sph<2>(file, law));
  if (grains) panels.push_back(panel_of_grains(grains->flow));

  double left = std::numeric_limits<double>::infinity(), low = left, right = -left, high = -left;
  for (const Panel& panel : panels)
    for (const Dot& dot : panel.dots) {
      left = std::min(left, dot.x - dot.radius), right = std::max(right, dot.x + dot.radius);
      low = std::min(low, dot.up - dot.radius), high = std::max(high, dot.up + dot.radius);
    }
  // Below each other, or, where they are tall, beside each other.
  const bool beside = high - low > right - left;
  constexpr double margin = 12, title = 24;
  const double width = beside ? 500 : 1000;
  const double scale = (width - 2 * margin) / (right - left);
  const double height = scale * (high - low) + title + 2 * margin;
  const auto count = static_cast<double>(panels.size());
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0f} {:.0f}\" font-family=\"sans-serif\" "
      "font-size=\"{}\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
      beside ? width * count : width, beside ? height : height * count, beside ? 9 : 14);
  for (std::size_t k = 0; k < panels.size(); ++k) {
    const double at = static_cast<double>(k), top = beside ? 0 : height * at, start = beside ? width * at : 0;
    const auto x_of = [&](double x) { return start + margin + scale * (x - left); };
    const auto y_of = [&](double up) { return top + title + margin + scale * (high - up); };
    svg += fmt::format("<text x=\"{:.0f}\" y=\"{:.0f}\">{}</text>\n", start + margin, top + title,
                       escape_html(panels[k].title));
    for (const Dot& dot : panels[k].dots)
      svg += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"{:.2f}\" fill=\"{}\"/>\n", x_of(dot.x),
                         y_of(dot.up), scale * dot.radius, dot.colour);
    for (const std::array<double, 4>& l : panels[k].lines)
      svg += fmt::format(
          "<line x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\" stroke=\"{}\" "
          "stroke-width=\"3\"/>\n",
          x_of(l[0]), y_of(l[1]), x_of(l[2]), y_of(l[3]), wall_colour);
    for (const std::array<double, 4>& o : panels[k].outlines)
      svg += fmt::format(
          "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" fill=\"none\" stroke=\"{}\" "
          "stroke-width=\"2\"/>\n",
          x_of(o[0]), y_of(o[1] + o[3]), scale * o[2], scale * o[3], material_colour);
  }
  return svg + "</svg>\n";
}

}  // namespace dem2sph
