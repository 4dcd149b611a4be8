// What the flow tests share: a case as text, a flow made from it, and layer averages of its frame.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "sph/flow.hpp"
#include "sph/material.hpp"
#include "sph/rheology/bagnold.hpp"
#include "sph/scene.hpp"

namespace dem2sph {

/// Glass beads of Jop, Forterre and Pouliquen (2006): 0.38, 0.64, 0.279.
inline const std::string glass_beads = R"(
[law]
d = "5 mm"
rho_s = "2500 kg/m^3"
mu_l = 0.38
mu_h = 0.64
D_star = 0.279
phi_c = 0.6
b = 0.2
s_star = 0.3
)";

inline CaseFile case_of(const std::string& text, const std::vector<std::string>& overrides = {}) {
  CaseFile file = CaseFile::parse(text, "test.toml", overrides);
  file.validate(flow_tables());
  return file;
}

template <int Dim>
std::unique_ptr<Flow> flow_of(const CaseFile& file) {
  return make_flow<Dim>(make_setup<Dim>(file, law_of_case(file)));
}

inline void run_until(Flow& flow, double time) {
  while (flow.time() < time * (1 - 1e-12)) flow.step(time - flow.time());
}

/// Interior particles of a frame as plain columns.
struct Interior {
  std::vector<double> x, up, vx, vup, rho, p, tau, gamma_dot, sigma_up;
  explicit Interior(const Frame& frame) {
    const auto& position = frame.field("x").values;
    const auto& velocity = frame.field("v").values;
    const auto& stress = frame.field("stress").values;
    const auto& kind = frame.field("kind").values;
    const std::size_t vertical = frame.dimension == 2 ? 1 : 2;
    for (std::size_t i = 0; i < kind.size(); ++i) {
      if (kind[i] != 0) continue;
      x.push_back(position[3 * i]);
      up.push_back(position[3 * i + vertical]);
      vx.push_back(velocity[3 * i]);
      vup.push_back(velocity[3 * i + vertical]);
      rho.push_back(frame.field("rho").values[i]);
      p.push_back(frame.field("p").values[i]);
      gamma_dot.push_back(frame.field("gamma_dot").values[i]);
      sigma_up.push_back(-stress[6 * i + vertical]);
      tau.push_back(frame.field("mu").values[i] * p.back());
    }
  }
  std::size_t size() const { return x.size(); }
};

/// Least-squares line through (x, y): value at 0 and slope.
struct Line {
  double at_zero = 0;
  double slope = 0;
  Line(const std::vector<double>& x, const std::vector<double>& y) {
    double sx = 0, sy = 0, sxx = 0, sxy = 0;
    const double n = static_cast<double>(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) sx += x[i], sy += y[i], sxx += x[i] * x[i], sxy += x[i] * y[i];
    slope = (n * sxy - sx * sy) / (n * sxx - sx * sx);
    at_zero = (sy - slope * sx) / n;
  }
};

inline double mean(const std::vector<double>& values) {
  double sum = 0;
  for (double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

}  // namespace dem2sph
