#include "calibration/report_figures.hpp"

#include <fmt/format.h>
#include <stdlib.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>

#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"
#include "sph/base/subprocess.hpp"

namespace dem2sph {
namespace {

using nlohmann::json;

// Eight colours that people with any colour vision tell apart (Okabe and Ito 2008), without the yellow.
constexpr std::array<const char*, 7> palette{"#0072B2", "#D55E00", "#009E73", "#CC79A7",
                                             "#56B4E9", "#E69F00", "#444444"};
const char* colour(std::size_t k) { return palette[k % palette.size()]; }

// A string for gnuplot in single quotes: nothing in it is expanded, a quote is doubled.
std::string quoted(const std::string& text) {
  std::string out = "'";
  for (char c : text) {
    if (c == '\'') out += '\'';
    out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
  }
  return out + "'";
}

std::string style() {
  return "set encoding utf8\n"
         "set border 3 lc rgb '#8a95a1' lw 1\n"
         "set tics nomirror out scale 0.6 textcolor rgb '#3a4653'\n"
         "set grid lc rgb '#e6eaef' lw 1 lt 1\n"
         "set key reverse Left samplen 2.2 spacing 1.15 noenhanced\n"
         "set style fill transparent solid 0.18 noborder\n";
}

std::string block(const std::string& name, const std::string& rows) {
  return "$" + name + " << EOD\n" + rows + "EOD\n";
}

std::string rows(const std::vector<double>& x, const std::vector<double>& y, std::size_t every = 1) {
  std::string text;
  for (std::size_t i = 0; i < x.size(); i += every) text += fmt::format("{:.9g} {:.9g}\n", x[i], y[i]);
  return text;
}

std::size_t thin(std::size_t samples, std::size_t most) {
  return std::max<std::size_t>(1, (samples + most - 1) / most);
}

struct Steady {
  const char* symbol;
  const std::vector<SteadyDatum>& data;
  std::string reference_label;
  const char* key;
  const Bootstrap& bootstrap;
};

// Shared by friction and solid fraction: band, law, reference, points with errors, data range shaded.
template <class Predict, class Reference>
std::string steady_figure(const char* name, const Steady& what, const Predict& predict,
                          const Reference& reference) {
  double low = 1e300, high = 0, bottom = 1e300, top = -1e300;
  std::string points;
  for (const SteadyDatum& d : what.data) {
    points += fmt::format("{:.9g} {:.9g} {:.9g} {:.9g}\n", d.I, d.value, d.I_se, d.value_se);
    if (d.I > 0) low = std::min(low, d.I);
    high = std::max(high, d.I);
    bottom = std::min(bottom, d.value - d.value_se);
    top = std::max(top, d.value + d.value_se);
  }
  const double left = low / 1.6;
  const double right = high * 1.6;
  std::string band, ours, theirs;
  for (int k = 0; k <= 160; ++k) {
    const double I = left * std::pow(right / left, k / 160.0);
    const Prediction p = predict(I);
    band += fmt::format("{:.9g} {:.9g} {:.9g}\n", I, p.low, p.high);
    ours += fmt::format("{:.9g} {:.9g}\n", I, p.value);
    theirs += fmt::format("{:.9g} {:.9g}\n", I, reference(I));
    if (I < high)
      bottom = std::min({bottom, p.value, reference(I)}), top = std::max({top, p.value, reference(I)});
  }
  const double margin = 0.15 * (top - bottom);
  std::string seeds;
  if (what.bootstrap.draws > 0)
    seeds = fmt::format(
        "$seeds using 1:2 with lines lc rgb '{0}' lw 1 dt (3,3) title '95 % band by bootstrap over seeds', "
        "$seeds using 1:3 with lines lc rgb '{0}' lw 1 dt (3,3) notitle, ",
        colour(1));
  std::string draws;
  for (std::size_t k = 0; k < what.bootstrap.I.size(); ++k)
    draws += fmt::format("{:.9g} {:.9g} {:.9g}\n", what.bootstrap.I[k], what.bootstrap.band_low[k],
                         what.bootstrap.band_high[k]);
  return render_svg(
      name,
      style() + block("band", band) + block("law", ours) + block("reference", theirs) +
          block("points", points) + block("seeds", draws) +
          fmt::format("set logscale x\nset format x '10^{{%L}}'\nset xrange [{:.6g}:{:.6g}]\nset yrange "
                      "[{:.6g}:{:.6g}]\n",
                      left, right, bottom - margin, top + margin) +
          fmt::format("set object 1 rectangle from {:.6g},graph 0 to {:.6g},graph 1 behind fc rgb '#f1f5f9' "
                      "fs solid noborder\n",
                      low, high) +
          fmt::format("set key {}\nset xlabel 'inertial number I'\nset ylabel '{}'\n", what.key,
                      what.symbol) +
          fmt::format(
              "plot $band using 1:2:3 with filledcurves lc rgb '{0}' title '95 % band, delta method', "
              "{2}$reference with lines lc rgb '#7c8794' lw 1.2 dt (6,5) title {1}, "
              "$law with lines lc rgb '{0}' lw 2.2 title 'fitted law', "
              "$points using 1:2:3:4 with xyerrorbars lc rgb '#1d2733' pt 7 ps 0.55 lw 1.2 title "
              "'LIGGGHTS, one standard error'\n",
              colour(0), quoted(what.reference_label), seeds),
      720, 420);
}

// A line and its points.
struct Curve {
  std::vector<double> x, y, fit;
  std::string label;
};

std::string transient_figure(const char* name, const std::vector<Curve>& curves, const char* symbol,
                             const char* fitted) {
  std::string script = style();
  std::vector<double> all;
  double bottom = 1e300, top = -1e300;
  std::string plot = "plot ";
  for (std::size_t k = 0; k < curves.size(); ++k) {
    const Curve& c = curves[k];
    script += block(fmt::format("points{}", k), rows(c.x, c.y, thin(c.x.size(), 150)));
    script += block(fmt::format("fit{}", k), rows(c.x, c.fit, thin(c.x.size(), 400)));
    all.insert(all.end(), c.y.begin(), c.y.end());
    for (double v : c.fit) bottom = std::min(bottom, v), top = std::max(top, v);
    plot +=
        fmt::format("{}$points{} with points pt 7 ps 0.3 lc rgb '{}' notitle", k ? ", " : "", k, colour(k));
  }
  // A legend of more than eight lines would hide what it explains, of more than a dozen explain nothing.
  const bool legend = curves.size() <= 12, below = legend && curves.size() > 8;
  for (std::size_t k = 0; k < curves.size(); ++k) {
    const std::string title = legend ? "title " + quoted(curves[k].label) : "notitle";
    plot += fmt::format(", $fit{} with lines lw 2.2 lc rgb '{}' {}", k, colour(k), title);
  }
  // The inner 96 % of the points decide the range together with the fit: single spikes do not.
  std::sort(all.begin(), all.end());
  const std::size_t tail = all.size() / 50;
  bottom = std::min(bottom, all[tail]);
  top = std::max(top, all[all.size() - 1 - tail]);
  const double margin = 0.08 * std::max(top - bottom, 1e-6);
  script +=
      fmt::format("set yrange [{:.6g}:{:.6g}]\nset key {}\nset xlabel 'shear strain s'\nset ylabel '{}'\n",
                  bottom - margin, top + margin, below ? "outside below maxcols 3" : "top right", symbol);
  script +=
      fmt::format("set label 1 {} at graph 1,1 right offset 0,0.6 textcolor rgb '#5b6876'\n", quoted(fitted));
  return render_svg(name, script + plot + "\n", 720, below ? 520 : 400);
}

std::string group_label(const TransientCheck& c) {
  if (c.kind == "start_up")
    return fmt::format("start-up to {:g}, packed with friction {:g}", c.I_driven, c.packing_friction);
  return fmt::format("{} {:g} to {:g}", c.kind == "pressure_jump" ? "pressure jump" : c.kind, c.I_before,
                     c.I_driven);
}

std::string run_label(const TransientFit& t) {
  return fmt::format("{} (I = {:g}, seed {})", t.run.substr(0, 10), t.I_driven, t.seed);
}

std::string series_figure(const char* name, const std::vector<FlowSummary>& flows, const char* label,
                          bool front) {
  std::string script = style();
  std::string plot = "plot ";
  for (std::size_t k = 0; k < flows.size(); ++k) {
    const FlowSummary& f = flows[k];
    std::vector<double> y = front ? f.front : f.centre_height;
    for (double& v : y) v /= front ? f.L0 : f.H0;
    script += block(fmt::format("d{}", k), rows(f.time, y, thin(y.size(), 800)));
    plot += fmt::format("{}$d{} with lines lw 2.2 lc rgb '{}' title {}", k ? ", " : "", k, colour(k),
                        quoted(f.label));
  }
  script += fmt::format("set xlabel 'time [s]'\nset ylabel '{}'\nset key {} right\n", label,
                        front ? "bottom" : "top");
  return render_svg(name, script + plot + "\n", 480, 340);
}

}  // namespace

ReferenceLaw glass_beads_2006() {
  return {"glass beads, 2006",
          "glass beads of 0.53 mm: friction from Jop, Forterre and Pouliquen, Nature 441, 727 (2006), with "
          "0.38, 0.64 and 0.279; solid "
          "fraction 0.6 - 0.2 I from Pouliquen, Cassar, Jop, Forterre and Nicolas, J. Stat. Mech. P07020 "
          "(2006), as widely quoted",
          {0.38, 0.64, 0.279},
          {0.6, 0.2}};
}

FlowSummary read_flow_summary(const ReportFlow& flow) {
  const json j = read_json(flow.summary);
  const auto missing = [&](const std::string& what) {
    return InputError(fmt::format("{}: {}", flow.summary.string(), what));
  };
  const auto at = [&](const json& from, const char* key) -> const json& {
    if (!from.is_object() || !from.contains(key))
      throw missing(fmt::format("lacks \"{}\"; was it written by `dem2sph flow`?", key));
    return from.at(key);
  };
  const auto number = [&](const json& from, const char* key) {
    const json& v = at(from, key);
    if (!v.is_number() || !std::isfinite(v.get<double>()))
      throw missing(fmt::format("\"{}\" is not a number", key));
    return v.get<double>();
  };
  const auto list = [&](const json& from, const char* key) {
    std::vector<double> values;
    const json& v = at(from, key);
    if (!v.is_array() || v.empty()) throw missing(fmt::format("\"{}\" is not a list of numbers", key));
    for (const json& item : v) {
      if (!item.is_number() || !std::isfinite(item.get<double>()))
        throw missing(fmt::format("\"{}\" holds something else than numbers", key));
      values.push_back(item.get<double>());
    }
    return values;
  };
  FlowSummary s;
  s.label = flow.label;
  const json& series = at(j, "series");
  s.time = list(series, "time");
  s.front = list(series, "front_99");
  s.centre_height = list(series, "centre_height");
  s.kinetic_energy = list(series, "kinetic_energy");
  s.max_speed = list(series, "max_speed");
  for (const auto* v : {&s.front, &s.centre_height, &s.kinetic_energy, &s.max_speed})
    if (v->size() != s.time.size()) throw missing("the lists in \"series\" have different lengths");
  const json& profiles = at(j, "profiles");
  if (!profiles.is_array() || profiles.empty()) throw missing("\"profiles\" holds no profile");
  for (const json& p : profiles) {
    s.profiles.push_back({number(p, "time"), list(p, "x"), list(p, "height")});
    if (s.profiles.back().x.size() != s.profiles.back().height.size())
      throw missing("a profile has another number of x than of heights");
  }
  s.wall_seconds = number(j, "wall_seconds");
  s.cpu_seconds = number(j, "cpu_seconds");
  s.particles = number(j, "particles");
  s.steps = number(j, "steps");
  s.particle_steps_per_second = number(j, "particle_steps_per_second");
  s.L0 = number(at(j, "initial"), "L0");
  s.H0 = number(at(j, "initial"), "H0");
  if (!(s.L0 > 0 && s.H0 > 0)) throw missing("\"initial\" has a length that is not positive");
  const json& formulation = at(j, "formulation");
  if (!formulation.is_string()) throw missing("\"formulation\" is not a word");
  s.formulation = formulation.get<std::string>();
  const json& composition = at(j, "composition");
  if (!composition.is_array()) throw missing("\"composition\" is not a list of words");
  for (const json& word : composition) {
    if (!word.is_string()) throw missing("\"composition\" is not a list of words");
    s.composition.push_back(word.get<std::string>());
  }
  return s;
}

std::string figure_friction(const Fit& fit) {
  const ReferenceLaw reference = glass_beads_2006();
  return steady_figure(
      "friction", {"friction μ", fit.friction_data, reference.label, "top left", fit.friction.bootstrap},
      [&](double I) { return predict_friction(fit, I); }, reference.friction);
}

std::string figure_solid_fraction(const Fit& fit) {
  const ReferenceLaw reference = glass_beads_2006();
  return steady_figure(
      "solid",
      {"solid fraction φ", fit.solid_fraction_data, reference.label, "bottom left",
       fit.solid_fraction.bootstrap},
      [&](double I) { return predict_solid_fraction(fit, I); }, reference.solid_fraction);
}

std::string figure_residuals(const Fit& fit) {
  std::string script = style();
  std::map<std::string, double> phi;
  for (const SteadyDatum& d : fit.solid_fraction_data) phi[d.run] = d.value;
  for (const auto& [name, data] : {std::pair{"mu", &fit.friction_data}, {"phi", &fit.solid_fraction_data}}) {
    std::string text;
    for (const SteadyDatum& d : *data) {
      const auto at = phi.find(d.run);  // a point may have been left out of the fit of phi
      text += fmt::format("{:.9g} {:.9g} {} {} {:.9g}\n", d.I, d.p,
                          at == phi.end() ? "NaN" : fmt::format("{:.9g}", at->second), d.order, d.residual);
    }
    script += block(name, text);
  }
  script +=
      "set multiplot layout 2,2 margins 0.09,0.96,0.14,0.97 spacing 0.1,0.18\n"
      "set ylabel 'residual, standard errors' offset 1.5\nset yrange [-4:4]\nset xzeroaxis lw 1 lc rgb "
      "'#8a95a1'\n";
  const std::array<std::pair<const char*, const char*>, 4> axes{{{"1", "inertial number I"},
                                                                 {"2", "pressure p [Pa]"},
                                                                 {"3", "solid fraction φ"},
                                                                 {"4", "order of the runs"}}};
  for (const auto& [column, label] : axes) {
    script += std::string_view(column) == "1" ? "set logscale x\nset format x '10^{%L}'\n"
                                              : "unset logscale x\nset format x '%g'\n";
    script += fmt::format(
        "set xtics {4}\nset xlabel '{0}'\nplot $mu using {1}:5 with points pt 7 ps 0.5 lc rgb '{2}' title "
        "'μ', $phi using "
        "{1}:5 "
        "with points pt 6 ps 0.6 lc rgb '{3}' title 'φ'\nunset key\n",
        label, column, colour(0), colour(1), std::string_view(column) == "3" ? "0.04" : "autofreq");
  }
  return render_svg("residuals", script + "unset multiplot\n", 720, 560);
}

std::string figure_likelihoods(const Fit& fit) {
  std::string script = style();
  std::string plot = "plot x*x with lines lc rgb '#8a95a1' dt (6,5) title 'if it were a parabola'";
  std::size_t k = 0;
  for (const LawFit* law : {&fit.friction, &fit.solid_fraction, &fit.dilation})
    for (const Profile& p : law->profiles) {
      const double scale = (*law)[p.name].standard_error / law->error_scale;
      std::vector<double> x;
      for (double value : p.values) x.push_back((value - p.value) / scale);
      script += block(fmt::format("p{}", k), rows(x, p.delta_chi2));
      plot += fmt::format(", $p{} with linespoints pt 7 ps 0.35 lw 1.6 lc rgb '{}' title {}", k, colour(k),
                          quoted(p.name));
      ++k;
    }
  script +=
      "set xrange [-4:4]\nset yrange [0:12]\nset xlabel 'parameter less its estimate, in standard errors'\n"
      "set ylabel 'rise of χ²'\nset key top center\n";
  return render_svg("likelihoods", script + plot + "\n", 720, 380);
}

namespace {

/// One curve a group of twins where there are groups, else one a run. `choose` takes a TransientCheck or a
/// TransientFit and gives its points and its line.
template <class Choose>
std::string grouped_figure(const Fit& fit, const char* name, const char* label, const std::string& title,
                           Choose choose) {
  std::vector<Curve> curves;
  const bool grouped = !fit.transient_checks.empty();
  const auto add = [&](const auto& one, std::string what) {
    auto [points, line] = choose(one);
    curves.push_back({one.s, std::move(points), std::move(line), std::move(what)});
  };
  if (grouped)
    for (const TransientCheck& c : fit.transient_checks) add(c, group_label(c));
  else
    for (const TransientFit& t : fit.transients) add(t, run_label(t));
  return transient_figure(
      name, curves, label,
      fmt::format("points: LIGGGHTS{}; lines: {}", grouped ? ", mean over seeds" : "", title).c_str());
}

}  // namespace

std::string figure_transient_phi(const Fit& fit) {
  return grouped_figure(fit, "phi", "solid fraction φ", "fit",
                        [](const auto& t) { return std::pair(t.phi, t.phi_fit); });
}

std::string figure_transient_beta(const Fit& fit) {
  return grouped_figure(fit, "beta", "dilation rate β", "from the fitted φ(s)",
                        [](const auto& t) { return std::pair(t.beta, t.beta_fit); });
}

std::string figure_transient_mu(const Fit& fit) {
  return grouped_figure(fit, "excess", "μ - μ_{steady}(I)",
                        fmt::format("{:.2f} times the fitted β", fit.beta_in_mu.value), [&](const auto& t) {
                          std::vector<double> share = t.beta_fit;
                          for (double& v : share) v *= fit.beta_in_mu.value;
                          return std::pair(t.mu_excess, share);
                        });
}

std::string figure_profiles(const FlowSummary& flow, std::size_t index, double x_max, double y_max) {
  // At most seven, evenly over the run, the first and the last among them.
  std::vector<const FlowSummary::Profile*> chosen;
  const std::size_t n = flow.profiles.size();
  const std::size_t most = std::min<std::size_t>(7, n);
  for (std::size_t k = 0; k < most; ++k)
    chosen.push_back(&flow.profiles[most == 1 ? 0 : (k * (n - 1) + (most - 1) / 2) / (most - 1)]);
  std::string script = style();
  std::string plot = "plot ";
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    std::vector<double> x = chosen[k]->x;
    std::vector<double> y = chosen[k]->height;
    for (double& v : x) v /= flow.L0;
    for (double& v : y) v /= flow.L0;
    script += block(fmt::format("d{}", k), rows(x, y));
    // From pale to dark with time.
    const double u = chosen.size() == 1 ? 1 : static_cast<double>(k) / static_cast<double>(chosen.size() - 1);
    const auto mix = [&](int pale, int dark) {
      return static_cast<int>(std::lround(pale + u * (dark - pale)));
    };
    plot += fmt::format("{}$d{} with lines lw {:.1f} lc rgb '#{:02x}{:02x}{:02x}' title '{:.3g} s'",
                        k ? ", " : "", k, k + 1 == chosen.size() ? 2.6 : 1.6, mix(0xa9, 0x06),
                        mix(0xcf, 0x3a), mix(0xe6, 0x5e), chosen[k]->time);
  }
  script += fmt::format(
      "set xrange [0:{:.6g}]\nset yrange [0:{:.6g}]\nset xlabel 'x / L_0'\nset ylabel 'height / L_0'\nset "
      "key top right\n",
      x_max, y_max);
  return render_svg(fmt::format("profile{}", index), script + plot + "\n", 480, 340);
}

std::string figure_deposits(const std::vector<FlowSummary>& flows) {
  std::string script = style();
  std::string plot = "plot ";
  double x_max = 0, y_max = 0;
  for (std::size_t k = 0; k < flows.size(); ++k) {
    const FlowSummary& f = flows[k];
    const auto add = [&](const FlowSummary::Profile& profile, const std::string& name) {
      std::vector<double> x = profile.x;
      std::vector<double> y = profile.height;
      for (double& v : x) v /= f.L0;
      for (double& v : y) v /= f.L0;
      for (std::size_t i = 0; i < x.size(); ++i) {
        if (y[i] > 0) x_max = std::max(x_max, x[i]);
        y_max = std::max(y_max, y[i]);
      }
      script += block(name, rows(x, y));
    };
    add(f.profiles.back(), fmt::format("last{}", k));
    if (k == 0) {
      add(f.profiles.front(), "first");
      plot += fmt::format("$first with lines lw 1.4 dt (5,4) lc rgb '#7c8794' title 'at {:.3g} s', ",
                          f.profiles.front().time);
    }
    plot += fmt::format("{}$last{} with lines lw 2.4 lc rgb '{}' title {}", k ? ", " : "", k, colour(k),
                        quoted(fmt::format("{}, {:.3g} s", f.label, f.profiles.back().time)));
  }
  script += fmt::format(
      "set xrange [0:{:.6g}]\nset yrange [0:{:.6g}]\nset xlabel 'x / L_0'\nset ylabel 'height / L_0'\nset "
      "key top right\n",
      1.08 * x_max, 1.15 * y_max);
  return render_svg("deposits", script + plot + "\n", 720, 380);
}

std::string figure_front(const std::vector<FlowSummary>& flows) {
  return series_figure("front", flows, "front / L_0", true);
}
std::string figure_height(const std::vector<FlowSummary>& flows) {
  return series_figure("height", flows, "centre height / H_0", false);
}

std::string plot_style() { return style(); }
const char* plot_colour(std::size_t k) { return colour(k); }
std::string plot_quoted(const std::string& text) { return quoted(text); }
std::string plot_block(const std::string& name, const std::string& data) { return block(name, data); }
std::string plot_rows(const std::vector<double>& x, const std::vector<double>& y) { return rows(x, y); }

std::string render_svg(const std::string& name, const std::string& script, int width, int height) {
  if (!program_exists("gnuplot"))
    throw Error(ExitCode::usage,
                "gnuplot is not installed, so the report has no figures; install it with: apt-get install "
                "gnuplot-nox");
  std::string pattern = (std::filesystem::temp_directory_path() / "dem2sph_plot_XXXXXX").string();
  if (::mkdtemp(pattern.data()) == nullptr)
    throw Error(ExitCode::bug, fmt::format("{}: cannot make a folder for figures", pattern));
  const std::filesystem::path folder = pattern;
  SubprocessOptions options;
  options.folder = folder;
  options.output = folder / "log";
  options.input =
      fmt::format("set terminal svg size {},{} enhanced font 'Arial,14' name '{}'\nset output 'figure.svg'\n",
                  width, height, name) +
      script + "unset output\n";
  options.time_limit = 60;
  const SubprocessResult result = run_subprocess({"gnuplot"}, options);
  const auto read = [](const std::filesystem::path& path) {
    std::ifstream in(path);
    std::ostringstream text;
    text << in.rdbuf();
    return text.str();
  };
  std::string svg = read(folder / "figure.svg");
  const std::string log = read(folder / "log");
  std::filesystem::remove_all(folder);
  if (result.stopped) throw Interrupted("stopped while drawing the report; the same command makes it again");
  const std::size_t start = svg.find("<svg");
  const std::size_t end = svg.rfind("</svg>");
  if (!result.ok() || start == std::string::npos || end == std::string::npos)
    throw Error(ExitCode::bug, fmt::format("gnuplot did not make the figure \"{}\": {}", name, log));
  svg = svg.substr(start, end + 6 - start);
  // Ids are made unique in the page; the name spaces belong to files, not to SVG inside HTML.
  const auto replace = [&](const std::string& from, const std::string& to) {
    for (std::size_t at = svg.find(from); at != std::string::npos; at = svg.find(from, at + to.size()))
      svg.replace(at, from.size(), to);
  };
  replace("gpPt", name + "_gpPt");
  replace("gpDot", name + "_gpDot");
  for (const char* id : {"gnuplot_canvas", "textbox", "greybox"})
    replace(fmt::format("'{}'", id), fmt::format("'{}_{}'", name, id));
  replace("\"gnuplot_canvas\"", fmt::format("\"{}_canvas\"", name));
  replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
  replace("xmlns:xlink=\"http://www.w3.org/1999/xlink\"", "");
  replace("xlink:href", "href");
  return svg;
}

}  // namespace dem2sph
