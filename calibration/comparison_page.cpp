// The page of a comparison: histories, deposits, tables.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "calibration/comparison.hpp"
#include "calibration/report.hpp"
#include "calibration/report_figures.hpp"

namespace dem2sph {
namespace {

/// The same of every seed and every variant: `curve` takes a FlowRecord.
template <class Take>
std::string figure(const char* name, const ComparisonPage& in, const std::string& axes, int width,
                   const Take& curve) {
  std::vector<FlowCurve> seeds, variants;
  for (const FlowRecord& f : in.seeds) seeds.push_back(curve(f));
  for (const Comparison& c : in.variants) variants.push_back(curve(c.sph));
  return figure_of_flows(name, seeds, variants, axes, width, 340);
}

std::string histories(const char* name, const ComparisonPage& in, std::vector<double> FlowRecord::*what,
                      const char* label, const char* key) {
  return figure(name, in,
                fmt::format("set key {}\nset xlabel 'time / sqrt(H_0/g)'\nset ylabel '{}'\n", key, label),
                480, [&](const FlowRecord& f) {
                  return FlowCurve{f.label, f.time, f.*what};
                });
}

std::string deposits(const ComparisonPage& in) {
  double end = 0;
  for (const FlowRecord& f : in.seeds) end = std::max(end, f.front.back());
  for (const Comparison& c : in.variants) end = std::max(end, c.sph.front.back());
  return figure(
      "deposit", in,
      fmt::format("set xrange [0:{:.6g}]\nset yrange [0:]\nset key top right\nset xlabel 'x / L_0'\n"
                  "set ylabel 'height / L_0'\n",
                  1.25 * end),
      720, [](const FlowRecord& f) {
        return FlowCurve{f.label, f.profiles.back().x, f.profiles.back().height};
      });
}

}  // namespace

std::string measures_table(const Comparison& c, std::size_t seeds) {
  std::string text = fmt::format(
      "<h3>SPH {}</h3>\n<div class=\"scroll\"><table>\n<tr><th>Figure</th><th class=\"n\">Grains, {} "
      "seeds</th><th class=\"n\">SPH</th>"
      "<th class=\"n\">Difference</th><th class=\"n\">Seeds</th><th class=\"n\">Bar</th></tr>\n",
      escape_html(c.sph.label), seeds);
  for (const Measure& m : c.measures)
    text += fmt::format(
        "<tr><td>{} [{}]</td><td class=\"n\">{:.4g} &plusmn; {:.2g}</td><td class=\"n\">{:.4g}</td><td "
        "class=\"n\">{:+.1f} %</td>"
        "<td class=\"n\">{:.1f} %</td><td class=\"n\">{}</td></tr>\n",
        escape_html(m.name), escape_html(m.unit), m.dem, m.dem_sd, m.sph, 100 * m.difference(),
        100 * m.spread(),
        std::isfinite(m.bar) ? fmt::format("{:.0f} %: {}", 100 * m.bar, m.within() ? "met" : "missed") : "");
  text +=
      "</table></div>\n<div class=\"scroll\"><table>\n<tr><th>Distance</th><th class=\"n\">L1</th><th "
      "class=\"n\">L2</th><th class=\"n\">Linf</th>"
      "<th class=\"n\">L2 of a seed from the others</th><th class=\"n\">Bar of L2</th></tr>\n";
  for (const Distance& d : c.distances)
    text += fmt::format(
        "<tr><td>{}</td><td class=\"n\">{:.2f} %</td><td class=\"n\">{:.2f} %</td><td class=\"n\">{:.2f} "
        "%</td><td class=\"n\">{}</td>"
        "<td class=\"n\">{}</td></tr>\n",
        escape_html(d.name), 100 * d.L1, 100 * d.L2, 100 * d.Linf,
        d.seeds_L2 > 0 ? fmt::format("{:.2f} %", 100 * d.seeds_L2) : "",
        d.bar > 0
            ? fmt::format("{:.0f} %: {}", 100 * d.bar, d.L2 <= std::max(d.bar, d.seeds_L2) ? "met" : "missed")
            : "");
  return text + "</table></div>\n";
}

std::string figure_of_flows(const std::string& name, const std::vector<FlowCurve>& seeds,
                            const std::vector<FlowCurve>& variants, const std::string& axes, int width,
                            int height) {
  std::string script = plot_style(), plot = "plot ";
  for (std::size_t k = 0; k < seeds.size(); ++k) {
    script += plot_block(fmt::format("s{}", k), plot_rows(seeds[k].x, seeds[k].y));
    plot += fmt::format("$s{} with lines lw 1.3 lc rgb '#5b6876' {}, ", k,
                        k == 0 ? "title 'grains, each seed'" : "notitle");
  }
  for (std::size_t k = 0; k < variants.size(); ++k) {
    script += plot_block(fmt::format("v{}", k), plot_rows(variants[k].x, variants[k].y));
    plot += fmt::format("{}$v{} with lines lw 2.4 lc rgb '{}' title {}", k ? ", " : "", k, plot_colour(k),
                        plot_quoted(variants[k].label));
  }
  return render_svg(name, script + axes + plot + "\n", width, height);
}

void write_comparison_page(const ComparisonPage& in, const std::filesystem::path& page) {
  std::string verdict;
  for (const Comparison& c : in.variants) {
    const std::vector<std::string> misses = c.misses();
    verdict += fmt::format("{}SPH {}: {}.", verdict.empty() ? "" : " ", c.sph.label,
                           misses.empty() ? "every figure within its bar or the spread of the seeds"
                                          : fmt::format("missed: {}", fmt::join(misses, "; ")));
  }
  const bool front = in.variants.front().sph.has_front;
  std::string body;
  if (front) {
    body += "<h2>How it went</h2>\n<div class=\"pair\">\n";
    body += figure_html(histories("front", in, &FlowRecord::front, "front_{99} / L_0", "bottom right"),
                        "The x that holds 99 % of the mass.");
    body += figure_html(histories("height", in, &FlowRecord::height, "centre height / L_0", "top right"),
                        "Height of the mass at its first mean solid fraction over 0 &lt; x &lt; 3 d.");
    body += "</div>\n";
    if (!in.variants.front().sph.profiles.empty())
      body += figure_html(deposits(in), "What is left, in bins of 2 d.");
  }
  body +=
      figure_html(histories("kinetic", in, &FlowRecord::kinetic, "kinetic energy / m g H_0", "outside below"),
                  "Kinetic energy over time.");
  body += in.figures;
  body +=
      "<h2>The figures</h2>\n<p class=\"note\">Grains: mean and standard deviation over seeds. No difference "
      "is credited below that spread.</p>\n";
  for (const Comparison& c : in.variants) body += measures_table(c, in.seeds.size());
  write_page(in.title, verdict, body, in.provenance, page);
}

}  // namespace dem2sph
