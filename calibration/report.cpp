#include "calibration/report.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "calibration/report_figures.hpp"
#include "calibration/report_template.hpp"
#include "sph/base/errors.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph {
namespace {

std::string figure(const std::string& svg, const std::string& caption) {
  return fmt::format("<figure>\n{}\n<figcaption>{}</figcaption>\n</figure>\n", svg, caption);
}

std::string duration(double seconds) {
  if (seconds < 10) return fmt::format("{:.1f} s", seconds);
  if (seconds < 120) return fmt::format("{:.0f} s", seconds);
  if (seconds < 7200) return fmt::format("{:.1f} min", seconds / 60);
  return fmt::format("{:.1f} h", seconds / 3600);
}

std::string plus_minus(const Estimate& e) {
  return e.at_bound ? fmt::format("{:.4g} (at a bound)", e.value)
                    : fmt::format("{} &plusmn; {}", round_to_error(e.value, e.standard_error),
                                  round_to_error(e.standard_error, e.standard_error));
}

const char* symbol(const std::string& name) {
  static const std::map<std::string, const char*> symbols{
      {"mu_l", "&mu;<sub>l</sub>"},
      {"mu_h", "&mu;<sub>h</sub>"},
      {"D_star", "D*"},
      {"slope", "(&mu;<sub>h</sub> - &mu;<sub>l</sub>)/D*"},
      {"rise", "rise"},
      {"a", "a"},
      {"n", "n"},
      {"mu_s", "&mu;<sub>s</sub>"},
      {"mu_2", "&mu;<sub>2</sub>"},
      {"I_0", "I<sub>0</sub>"},
      {"mu_inf", "&mu;<sub>&infin;</sub>"},
      {"alpha", "&alpha;"},
      {"phi_c", "&phi;<sub>c</sub>"},
      {"b", "b"},
      {"I_phi", "I<sub>&phi;</sub>"},
      {"s_star", "s*"},
      {"beta_in_mu", "share"}};
  const auto found = symbols.find(name);
  return found == symbols.end() ? "" : found->second;
}

const char* meaning(const std::string& name) {
  static const std::map<std::string, const char*> meanings{
      {"mu_l", "friction of slow flow, I &rarr; 0"},
      {"mu_h", "friction that fast flow tends to"},
      {"D_star", "inertial number at which half of the range is reached"},
      {"slope", "rise of friction with I at I = 0"},
      {"phi_c", "solid fraction of slow flow"},
      {"b", "loss of solid fraction with I, at I = 0"},
      {"I_phi", "inertial number at which that loss has slowed to a quarter"},
      {"rise", "rise of friction with I"},
      {"a", "factor of the power law"},
      {"n", "exponent of I"},
      {"mu_s", "friction of slow flow (flowing branch)"},
      {"mu_2", "friction that fast flow would tend to"},
      {"I_0", "scale of I"},
      {"mu_inf", "rise of friction at large I"},
      {"alpha", "of the creep branch"},
      {"s_star", "strain over which &phi; relaxes"},
      {"beta_in_mu", "share of &beta; that shows in &mu; - &mu;<sub>steady</sub>(I)"}};
  const auto found = meanings.find(name);
  return found == meanings.end() ? "" : found->second;
}

std::string warnings_html(const Fit& fit) {
  if (fit.warnings.empty()) return "";
  std::string text = "<div class=\"warnings\"><strong>To keep in mind</strong>\n<ul>\n";
  for (const std::string& w : fit.warnings) text += fmt::format("<li>{}</li>\n", escape_html(w));
  return text + "</ul>\n</div>\n";
}

std::string fit_quality(const LawFit& law, std::size_t data) {
  std::string text = fmt::format("{} points, ", data);
  text += law.degrees_of_freedom > 0
              ? fmt::format("&chi;&sup2; per degree of freedom {:.2f} ({:.0f} degrees)", law.chi2_per_dof,
                            law.degrees_of_freedom)
              : std::string("no degrees of freedom left");
  if (law.error_scale > 1) text += fmt::format(", errors scaled by {:.2f} for it", law.error_scale);
  return text;
}

std::string equation(const std::string& member) {
  static const std::map<std::string, const char*> equations{
      {"friction rational", "&mu;<sub>l</sub> + (&mu;<sub>h</sub> - &mu;<sub>l</sub>) I/(I + D*)"},
      {"friction exponential", "&mu;<sub>l</sub> + (&mu;<sub>h</sub> - &mu;<sub>l</sub>) (1 - exp(-I/D*))"},
      {"friction power", "&mu;<sub>l</sub> + a I<sup>n</sup>"},
      {"friction linear", "&mu;<sub>l</sub> + rise I"},
      {"friction barker_gray_2017", "Barker and Gray (2017)"},
      {"phi linear", "&phi;<sub>c</sub> - b I"},
      {"phi power", "&phi;<sub>c</sub> - a I<sup>n</sup>"},
      {"phi rational", "&phi;<sub>c</sub> - b I/(1 + I/I<sub>&phi;</sub>)"},
      {"dilation phi_relaxes", "d&phi;/ds = -(&phi; - &phi;<sub>eq</sub>)/s*"},
      {"dilation two_sided", "the same, another s* where &phi; &lt; &phi;<sub>eq</sub>"},
      {"dilation printed", "d&beta;/ds = -&beta;/s* + A S"},
      {"dilation dilatancy", "&beta; = K (&phi; - &phi;<sub>eq</sub>)"},
      {"dilation constant", "&beta; constant"},
      {"dilation none", "&phi; stays"}};
  return equations.at(member);
}

std::string members_html(const std::vector<LawFit>& members, const std::string& family,
                         const LawFit& chosen) {
  if (members.empty()) return "";
  double best = std::numeric_limits<double>::infinity();
  for (const LawFit& law : members)
    if (law.failure.empty()) best = std::min(best, law.AICc);
  std::string text =
      "<div class=\"scroll\"><table>\n<tr><th>Member</th><th>Law</th><th class=\"n\">&chi;&sup2;/dof</th><th "
      "class=\"n\">AICc above the best</th><th class=\"n\">BIC</th><th class=\"n\">left-out conditions: rms "
      "(largest)</th><th>Parameters</th></tr>\n";
  for (const LawFit& law : members) {
    const std::string name = law.member == chosen.member ? "<strong>" + law.member + "</strong>" : law.member;
    if (!law.failure.empty()) {
      text += fmt::format("<tr><td>{}</td><td colspan=\"6\">not fitted: {}</td></tr>\n", name,
                          escape_html(law.failure));
      continue;
    }
    text += fmt::format(
        "<tr><td>{}</td><td>{}</td><td class=\"n\">{:.2f}</td><td class=\"n\">{}</td><td "
        "class=\"n\">{:.1f}</td><td class=\"n\">{}</td><td>{}</td></tr>\n",
        name, equation(family + " " + law.member), law.chi2_per_dof,
        std::isfinite(law.AICc) ? fmt::format("{:.1f}", law.AICc - best) : "too few data", law.BIC,
        law.cross_validation.conditions.empty()
            ? (family == "dilation" ? "" : "too few")
            : fmt::format("{:.2f} % ({:.2f} %)", 100 * law.cross_validation.rms,
                          100 * law.cross_validation.largest),
        escape_html(list_of(law)));
  }
  return text + "</table></div>\n";
}

std::string steady_html(const ReportInputs& in) {
  const Fit& fit = in.fit;
  const std::string literature = escape_html(glass_beads_2006().caption);
  return figure(figure_friction(fit),
                fmt::format("Friction &mu;(I) = {}: {}. Shaded in grey: the "
                            "range of I that has data, outside of which the law extrapolates. Thin dashed "
                            "line, for comparison and not "
                            "fitted: {}.",
                            equation("friction " + fit.friction.member),
                            fit_quality(fit.friction, fit.friction_data.size()), literature)) +
         members_html(fit.friction_members, "friction", fit.friction) +
         figure(figure_solid_fraction(fit),
                fmt::format("Solid fraction &phi;<sub>eq</sub>(I) = {}: {}. Grey range "
                            "and thin dashed line as above.",
                            equation("phi " + fit.solid_fraction.member),
                            fit_quality(fit.solid_fraction, fit.solid_fraction_data.size()))) +
         members_html(fit.solid_fraction_members, "phi", fit.solid_fraction) +
         figure(figure_residuals(fit),
                "What the laws leave, in standard errors: a law that fits shows no trend on any axis.");
}

std::string checks_html(const std::vector<TransientCheck>& checks) {
  if (checks.empty())
    return "<p class=\"note\">Too few twins (runs that differ by the seed alone) to measure the noise of "
           "&phi; "
           "without the law: nothing checks the law against it.</p>\n";
  std::string text =
      "<p>Each kind of change against the noise that its seeds show, by the law fitted to all and by the law "
      "fitted to all <em>others</em>:</p>\n<div class=\"scroll\"><table>\n<tr><th>Change</th><th "
      "class=\"n\">I</th><th class=\"n\">packed with friction</th><th class=\"n\">seeds</th><th "
      "class=\"n\">signal/noise</th><th class=\"n\">&chi;&sup2;/dof</th><th class=\"n\">explained</th><th "
      "class=\"n\">left out: &chi;&sup2;/dof</th><th class=\"n\">explained</th></tr>\n";
  for (const TransientCheck& c : checks) {
    const auto share = [&](double explained) {
      // Of a signal below its noise nothing can be explained.
      return c.signal_to_noise < 1 ? std::string("no signal") : fmt::format("{:.0f} %", 100 * explained);
    };
    text += fmt::format(
        "<tr><td>{}</td><td class=\"n\">{}{:g}</td><td class=\"n\">{:g}</td><td class=\"n\">{}</td><td "
        "class=\"n\">{:.1f}</td><td class=\"n\">{:.2f}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td "
        "class=\"n\">{}</td></tr>\n",
        escape_html(c.kind), c.I_before > 0 ? fmt::format("{:g} to ", c.I_before) : "", c.I_driven,
        c.packing_friction, c.seeds, c.signal_to_noise, c.chi2_per_dof, share(c.explained),
        c.predicted ? fmt::format("{:.2f}", c.predicted_chi2_per_dof) : "not told by the others",
        c.predicted ? share(c.predicted_explained) : "");
  }
  return text + "</table></div>\n";
}

std::string transients_html(const ReportInputs& in) {
  const Fit& fit = in.fit;
  if (fit.transients.empty())
    return "<p>No transients were fitted, so the law has no dilation and &beta; is not predicted.</p>\n";
  std::string explained;  // of each run, where there are few and no groups to look at
  if (fit.transient_checks.empty()) {
    std::vector<std::string> shares;
    for (const TransientFit& t : fit.transients) shares.push_back(fmt::format("{:.1f} %", 100 * t.explained));
    explained = fmt::format(" Share of the variance explained: {}.", fmt::join(shares, ", "));
  }
  std::string text = members_html(fit.dilation_members, "dilation", fit.dilation);
  text += checks_html(fit.transient_checks);
  text += figure(
      figure_transient_phi(fit),
      fmt::format(
          "Solid fraction of {} transient{}. The line is &phi; integrated with the measured I by the {} law, "
          "one "
          "for all: {}; the first &phi; of each run and an offset of each condition are free.{}",
          fit.transients.size(), fit.transients.size() == 1 ? "" : "s", fit.dilation.member,
          list_of(fit.dilation), explained));
  text += figure(figure_transient_beta(fit),
                 "Dilation rate &beta; = tr D/|&gamma;&#775;|: measured from the velocity field, and "
                 "predicted from the fitted &phi;(s) as "
                 "the law says. The measured &beta; did not enter the fit.");
  if (!fit.beta_in_mu.name.empty())
    text += figure(figure_transient_mu(fit),
                   fmt::format("Excess of friction over the steady law in the same transients. A share of {} "
                               "of &beta; shows in &mu; (95 % "
                               "interval {:.2f} to {:.2f}, from s = {:g} on, where contacts are loaded), and "
                               "that is what the law lets enter. A constant of "
                               "each condition, which the regression allows, is not drawn.",
                               plus_minus(fit.beta_in_mu), fit.beta_in_mu.low, fit.beta_in_mu.high,
                               fit.options.mu_from_strain));
  return text;
}

std::string parameter_row(const Estimate& e) {
  return fmt::format(
      "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td "
      "class=\"n\">{}</td></tr>\n",
      symbol(e.name), meaning(e.name), round_to_error(e.value, e.standard_error),
      e.at_bound ? "at a bound" : round_to_error(e.standard_error, e.standard_error),
      e.at_bound ? "not known"
                 : fmt::format("{} to {}", round_to_error(e.low, e.standard_error),
                               round_to_error(e.high, e.standard_error)));
}

std::string parameters_html(const ReportInputs& in) {
  const Fit& fit = in.fit;
  std::string text =
      "<div class=\"scroll\"><table>\n<tr><th>Parameter</th><th>What it is</th><th class=\"n\">Value</th><th "
      "class=\"n\">Standard "
      "error</th><th class=\"n\">95 % interval</th></tr>\n";
  for (const LawFit* law : {&fit.friction, &fit.solid_fraction, &fit.dilation})
    for (const Estimate& e : law->parameters) text += parameter_row(e);
  if (!fit.slope.name.empty()) text += parameter_row(fit.slope);
  if (!fit.beta_in_mu.name.empty()) text += parameter_row(fit.beta_in_mu);
  text += "</table></div>\n";
  text += fmt::format(
      "<p class=\"note\">Grains: d = {:g} m, &rho;<sub>s</sub> = {:g} kg/m&sup3;, friction {:g}. All "
      "parameters are pure numbers. Data: I "
      "from {:.3g} to {:.3g}, &phi; from {:.3f} to {:.3f}, strain to {:.3g}, p from {:.4g} to {:.4g} Pa. "
      "Intervals are the wider of the "
      "normal one with the errors of the data and Student's with the scatter about the fit.</p>\n",
      fit.d, fit.rho_s, fit.grain_friction, fit.I.lowest, fit.I.highest, fit.phi.lowest, fit.phi.highest,
      fit.s.highest, fit.p.lowest, fit.p.highest);
  if (!fit.friction.profiles.empty())
    text += figure(
        figure_likelihoods(fit),
        "How much worse the fit becomes when one parameter is held elsewhere and all others are fitted "
        "again. Where the curve leaves the parabola, the interval is not symmetric; where it stays low, "
        "the parameter is open.");
  const std::size_t n = fit.covariance_names.size();
  text += "<p>Correlation of the errors:</p>\n<div class=\"scroll\"><table class=\"matrix\">\n<tr><th></th>";
  for (const std::string& name : fit.covariance_names) text += fmt::format("<th>{}</th>", symbol(name));
  text += "</tr>\n";
  for (std::size_t i = 0; i < n; ++i) {
    text += fmt::format("<tr><th>{}</th>", symbol(fit.covariance_names[i]));
    for (std::size_t k = 0; k < n; ++k) {
      const double scale = std::sqrt(fit.covariance[i][i] * fit.covariance[k][k]);
      if (!(scale > 0)) {
        text += "<td>at a bound</td>";
        continue;
      }
      const double r = fit.covariance[i][k] / scale;
      text += fmt::format("<td style=\"background: rgba({}, {:.2f})\">{:.2f}</td>",
                          r < 0 ? "213, 94, 0" : "0, 114, 178", 0.35 * std::abs(r), r == 0 ? 0.0 : r);
    }
    text += "</tr>\n";
  }
  text += "</table></div>\n";
  text +=
      "<div class=\"scroll\"><table>\n<tr><th>Fit</th><th class=\"n\">Starts that converged</th><th "
      "class=\"n\">that agreed</th>"
      "<th class=\"n\">Weights renewed</th><th class=\"n\">Smallest / largest singular value</th></tr>\n";
  for (const auto& [name, law] : {std::pair{"friction", &fit.friction},
                                  {"solid fraction", &fit.solid_fraction},
                                  {"dilation", &fit.dilation}}) {
    if (law->parameters.empty()) continue;
    const Search& s = law->search;
    text += fmt::format(
        "<tr><td>{}</td><td class=\"n\">{} of {}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td "
        "class=\"n\">{}</td></tr>\n",
        name, s.converged, s.starts, s.agreed, s.reweighted,
        s.singular_values.empty()
            ? "none free"
            : fmt::format("{:.2g}", s.singular_values.back() / s.singular_values.front()));
  }
  return text + "</table></div>\n";
}

std::string flows_html(const std::vector<FlowSummary>& flows) {
  if (flows.empty()) return "<p>No flow was run with this law.</p>\n";
  double x_max = 0, y_max = 0;
  for (const FlowSummary& f : flows)
    for (const FlowSummary::Profile& p : f.profiles)
      for (std::size_t i = 0; i < p.x.size(); ++i) {
        if (p.height[i] > 0) x_max = std::max(x_max, p.x[i] / f.L0);
        y_max = std::max(y_max, p.height[i] / f.L0);
      }
  std::string text = figure(
      figure_deposits(flows),
      "The free surface where the flow ended, in widths L<sub>0</sub> of the column; dashed: at the start.");
  text += "<div class=\"pair\">\n";
  for (std::size_t k = 0; k < flows.size(); ++k)
    text += figure(figure_profiles(flows[k], k, 1.08 * x_max, 1.12 * y_max),
                   fmt::format("The free surface over time, {}.", escape_html(flows[k].label)));
  text += "</div>\n<div class=\"pair\">\n";
  text += figure(figure_front(flows), "Front: the x that holds 99 % of the mass.");
  text += figure(figure_height(flows), "Height at the centre of the column.");
  text +=
      "</div>\n<div class=\"scroll\"><table>\n<tr><th>Flow</th><th class=\"n\">Run-out (front - "
      "L<sub>0</sub>)/L<sub>0</sub></th><th class=\"n\">Centre height / "
      "H<sub>0</sub></th><th class=\"n\">Particles</th><th class=\"n\">Steps</th><th class=\"n\">Wall "
      "time</th><th class=\"n\">Million particle-steps/s</th><th>Parts</th></tr>\n";
  for (const FlowSummary& f : flows) {
    std::string parts = escape_html(f.formulation);
    for (const std::string& word : f.composition)
      if (word != f.formulation) parts += ", " + escape_html(word);
    text += fmt::format(
        "<tr><td>{}</td><td class=\"n\">{:.3f}</td><td class=\"n\">{:.3f}</td><td class=\"n\">{:.0f}</td><td "
        "class=\"n\">{:.0f}</td><td "
        "class=\"n\">{}</td><td class=\"n\">{:.3g}</td><td>{}</td></tr>\n",
        escape_html(f.label), f.front.back() / f.L0 - 1, f.centre_height.back() / f.H0, f.particles, f.steps,
        duration(f.wall_seconds), f.particle_steps_per_second / 1e6, parts);
  }
  return text + "</table></div>\n";
}

std::string excluded_html(const Fit& fit) {
  if (fit.excluded.empty()) return "<p>Nothing: every run entered the fit.</p>\n";
  std::string text = "<div class=\"scroll\"><table>\n<tr><th>Run</th><th>Why</th></tr>\n";
  for (const ExcludedRun& run : fit.excluded)
    text += fmt::format("<tr><td><code>{}</code></td><td>{}</td></tr>\n", escape_html(run.run.substr(0, 16)),
                        escape_html(run.reason));
  return text + "</table></div>\n";
}

std::string steps_html(const ReportInputs& in) {
  double engine_seconds = 0;
  std::size_t runs = 0;
  for (const Observables& o : in.observables) {
    engine_seconds += o.cpu_seconds();
    runs += o.costs.size();
  }
  std::string text =
      "<div class=\"scroll\"><table>\n<tr><th>What</th><th class=\"n\">Time</th><th>Files, with "
      "SHA-256</th></tr>\n";
  double total = 0;
  for (const ReportStep& step : in.steps) {
    std::string files;
    for (const std::filesystem::path& file : step.files)
      files += fmt::format("<div>{} <span class=\"hash\">{}</span></div>",
                           escape_html(file.filename().string()), sha256_of_file(file));
    text += fmt::format("<tr><td>{}</td><td class=\"n\">{}</td><td>{}</td></tr>\n", escape_html(step.what),
                        duration(step.seconds), files);
    total += step.seconds;
  }
  text += fmt::format(
      "<tr><td><strong>together</strong></td><td class=\"n\">{}</td><td></td></tr>\n</table></div>\n",
      duration(total));
  return text +
         fmt::format("<p class=\"note\">The {} runs of the grains took {} of processor time in {}.</p>\n",
                     runs, duration(engine_seconds), escape_html(in.fit.engine));
}

std::string versions_html(const nlohmann::json& provenance) {
  std::string text = "<div class=\"scroll\"><table>\n";
  for (const auto& [key, value] : provenance.items())
    text += fmt::format("<tr><th>{}</th><td>{}</td></tr>\n", escape_html(key),
                        escape_html(value.is_string() ? value.get<std::string>() : value.dump()));
  return text + "</table></div>\n";
}

}  // namespace

std::string escape_html(const std::string& text) {
  std::string out;
  for (char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        if (static_cast<unsigned char>(c) >= 0x20 || c == '\n' || c == '\t') out += c;
    }
  }
  return out;
}

namespace {

/// One pass over the template: what is put in is never searched for marks again.
std::string fill_in(const std::string& form, const std::map<std::string, std::string>& parts) {
  std::string html;
  for (std::size_t at = 0; at < form.size();) {
    const std::size_t open = form.find("{{", at);
    html += form.substr(at, open == std::string::npos ? open : open - at);
    if (open == std::string::npos) break;
    const std::size_t close = form.find("}}", open);
    const auto part = parts.find(form.substr(open + 2, close - open - 2));
    if (close == std::string::npos || part == parts.end())
      throw Error(ExitCode::bug, "the template of the report has a mark that nobody fills");
    html += part->second;
    at = close + 2;
  }
  return html;
}

}  // namespace

std::string figure_html(const std::string& svg, const std::string& caption) { return figure(svg, caption); }

void write_page(const std::string& title, const std::string& verdict, const std::string& body,
                const nlohmann::json& provenance, const std::filesystem::path& page) {
  const auto text = [&](const char* key) { return provenance.value(key, std::string("unknown")); };
  write_file_atomically(
      page,
      fill_in(page_template, {{"title", escape_html(title)},
                              {"stamp", escape_html(fmt::format("dem2sph {} ({}), {}", text("version"),
                                                                text("git_revision"), text("time_utc")))},
                              {"verdict", escape_html(verdict)},
                              {"body", body}}));
}

void write_report(const ReportInputs& in, const std::filesystem::path& page) {
  std::vector<FlowSummary> flows;
  for (const ReportFlow& flow : in.flows) flows.push_back(read_flow_summary(flow));
  const std::string body = fill_in(report_template, {{"warnings", warnings_html(in.fit)},
                                                     {"steady", steady_html(in)},
                                                     {"transients", transients_html(in)},
                                                     {"parameters", parameters_html(in)},
                                                     {"flows", flows_html(flows)},
                                                     {"excluded", excluded_html(in.fit)},
                                                     {"steps", steps_html(in)},
                                                     {"versions", versions_html(in.provenance)}});
  write_page(in.title, in.law.verdict, body, in.provenance, page);
}

}  // namespace dem2sph
