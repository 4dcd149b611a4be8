#include "calibration/work_precision.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/report.hpp"
#include "calibration/report_figures.hpp"

namespace dem2sph {
namespace {

bool usable(const WorkPoint& p) { return p.failure.empty() && p.core_seconds > 0 && std::isfinite(p.error); }

}  // namespace

void mark_pareto_front(std::vector<WorkPoint>& points) {
  for (WorkPoint& p : points)
    p.on_front = usable(p) && std::none_of(points.begin(), points.end(), [&](const WorkPoint& other) {
                   return usable(other) && other.core_seconds <= p.core_seconds && other.error <= p.error &&
                          (other.core_seconds < p.core_seconds || other.error < p.error);
                 });
}

GridConvergence grid_convergence(double coarse, double middle, double fine, double ratio) {
  GridConvergence g;
  const double first = middle - coarse, second = fine - middle;
  // Both steps in one direction and the second smaller: else there is no order to speak of.
  if (!(first * second > 0) || !(std::abs(second) < std::abs(first))) {
    g.order = g.limit = g.index = std::numeric_limits<double>::quiet_NaN();
    return g;
  }
  g.order = std::log(first / second) / std::log(ratio);
  const double left = second / (std::pow(ratio, g.order) - 1);
  g.limit = fine + left;
  g.index = 1.25 * std::abs(left / fine);
  return g;
}

double observed_order(const std::vector<WorkPoint>& points, const std::string& family) {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0;
  for (const WorkPoint& p : points) {
    if (p.family != family || !usable(p) || !(p.error > 0)) continue;
    const double a = std::log(p.spacing), b = std::log(p.error);
    n += 1, x += a, y += b, xx += a * a, xy += a * b;
  }
  const double determinant = n * xx - x * x;
  return n < 2 || !(determinant > 1e-12) ? std::numeric_limits<double>::quiet_NaN()
                                         : (n * xy - x * y) / determinant;
}

double cost_at_error(const std::vector<WorkPoint>& points, const std::vector<std::string>& families,
                     double error) {
  double least = std::numeric_limits<double>::quiet_NaN();
  const auto consider = [&](double cost) {
    if (!(cost >= least)) least = std::isnan(least) ? cost : std::min(least, cost);
  };
  for (const std::string& family : families) {
    std::vector<const WorkPoint*> line;
    for (const WorkPoint& p : points)
      if (p.family == family && usable(p)) line.push_back(&p);
    std::sort(line.begin(), line.end(),
              [](const WorkPoint* a, const WorkPoint* b) { return a->core_seconds < b->core_seconds; });
    for (std::size_t k = 0; k < line.size(); ++k) {
      if (line[k]->error <= error) consider(line[k]->core_seconds);
      if (k == 0 || !(line[k - 1]->error > error && line[k]->error < error) || !(line[k]->error > 0))
        continue;
      const double w = std::log(line[k - 1]->error / error) / std::log(line[k - 1]->error / line[k]->error);
      consider(line[k - 1]->core_seconds * std::pow(line[k]->core_seconds / line[k - 1]->core_seconds, w));
    }
  }
  return least;
}

nlohmann::json to_json(const std::vector<WorkPoint>& points) {
  nlohmann::json list = nlohmann::json::array();
  for (const WorkPoint& p : points) {
    nlohmann::json entry{{"name", p.name}, {"family", p.family}, {"spacing_over_H", p.spacing}};
    if (p.failure.empty()) {
      entry["core_seconds"] = p.core_seconds, entry["particle_steps"] = p.particle_steps;
      entry["error"] = p.error, entry["on_pareto_front"] = p.on_front, entry["figures"] = p.figures;
    } else {
      entry["failure"] = p.failure;
    }
    list.push_back(std::move(entry));
  }
  return list;
}

std::string table_of_work(const std::vector<WorkPoint>& points) {
  std::string text =
      "<div class=\"scroll\"><table>\n<tr><th>Run</th><th>Family</th><th class=\"n\">Core-seconds</th><th "
      "class=\"n\">Particle-steps</th><th class=\"n\">Error</th><th>Pareto front</th></tr>\n";
  for (const WorkPoint& p : points) {
    text += fmt::format("<tr><td>{}</td><td>{}</td>", escape_html(p.name), escape_html(p.family));
    text += p.failure.empty()
                ? fmt::format(
                      "<td class=\"n\">{:.3g}</td><td class=\"n\">{:.2g}</td><td class=\"n\">{:.2f} "
                      "%</td><td>{}</td></tr>\n",
                      p.core_seconds, p.particle_steps, 100 * p.error, p.on_front ? "yes" : "")
                : fmt::format("<td colspan=\"4\">{}</td></tr>\n", escape_html(p.failure));
  }
  return text + "</table></div>\n";
}

std::string csv_of(const std::vector<WorkPoint>& points) {
  std::string text = "name,family,spacing_over_H,core_seconds,particle_steps,error,on_pareto_front\n";
  for (const WorkPoint& p : points)
    if (p.failure.empty())
      text += fmt::format("{},{},{:.6g},{:.6g},{:.6g},{:.6g},{}\n", p.name, p.family, p.spacing,
                          p.core_seconds, p.particle_steps, p.error, p.on_front ? 1 : 0);
  return text;
}

std::string figure_of_work(const std::vector<WorkPoint>& points, double floor,
                           const std::string& floor_label) {
  std::vector<std::string> families;
  for (const WorkPoint& p : points)
    if (usable(p) && std::find(families.begin(), families.end(), p.family) == families.end())
      families.push_back(p.family);
  std::string script = plot_style(), plot = "plot ";
  for (std::size_t k = 0; k < families.size(); ++k) {
    std::vector<const WorkPoint*> line;
    for (const WorkPoint& p : points)
      if (usable(p) && p.family == families[k] && p.error > 0) line.push_back(&p);
    std::sort(line.begin(), line.end(),
              [](const WorkPoint* a, const WorkPoint* b) { return a->core_seconds < b->core_seconds; });
    std::string data;
    for (const WorkPoint* p : line)
      data += fmt::format("{:.9g} {:.9g} \"{}\"\n", p->core_seconds, 100 * p->error, p->name);
    if (data.empty()) continue;
    script += plot_block(fmt::format("f{}", k), data);
    plot += fmt::format(
        "$f{0} using 1:2 with linespoints pt 7 ps 0.7 lw 2 lc rgb '{1}' title {2}, $f{0} using 1:2:3 with "
        "labels "
        "offset 0,0.8 font ',10' textcolor rgb '#5b6876' notitle, ",
        k, plot_colour(k), plot_quoted(families[k]));
  }
  if (floor > 0)
    plot += fmt::format("{:.9g} with lines lw 1.4 dt (6,5) lc rgb '#5b6876' title {}", 100 * floor,
                        plot_quoted(floor_label));
  else
    plot.resize(plot.size() - 2);
  return render_svg(
      "work",
      script + "set logscale xy\nset key top right\nset xlabel 'core-seconds'\nset ylabel 'error [%]'\n" +
          plot + "\n",
      720, 440);
}

}  // namespace dem2sph
