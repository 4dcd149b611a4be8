// observables.h5: comes back as it was written, and a file that is cut, foreign or not finite is refused.
#include <gtest/gtest.h>

#include <cmath>

#include "dem_bridge/observables.hpp"
#include "sph/base/hdf5_file.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using test::content_of;
using test::message_of;
using test::put;
using ObservablesFile = test::Scratch;

Observables example() {
  Observables o;
  o.d = 1e-3, o.rho_s = 2500, o.grain_friction = 0.5, o.pressure = 1000;
  o.engine = "LIGGGHTS-PUBLIC 3.8.0";
  o.material = "[material]\nd = \"1 mm\"\n";
  for (int i = 0; i < 3; ++i) {
    const double x = 0.1 * (i + 1);
    o.steady.push_back({.run = "run" + std::to_string(i),
                        .seed = i,
                        .I_driven = x,
                        .I = 0.9 * x,
                        .I_se = 0.01 * x,
                        .mu = 0.4 + x,
                        .mu_se = 0.003,
                        .phi = 0.59 - 0.1 * x,
                        .phi_se = 0.001,
                        .p = 990,
                        .p_se = 9,
                        .wall_mu = 0.41 + x,
                        .wall_p = 1001,
                        .strain = 6,
                        .I_flat = i != 0,
                        .mu_flat = i != 1,
                        .phi_flat = i != 2,
                        .phi_drift = -0.5 * i,
                        .N1 = -0.02 * x,
                        .N1_se = 0.004,
                        .N2 = 0.06 + x,
                        .N2_se = 0.005,
                        .beta = 1e-4 * x,
                        .beta_se = 2e-4,
                        .temperature = 0.3 + x,
                        .coordination = 4 - x,
                        .fabric_xz = -0.05 - x});
  }
  Transient t;
  t.run = "abc", t.kind = "start_up", t.seed = 7, t.I_driven = 0.03, t.phi_0 = 0.64;
  t.I_before = 0.01, t.load = 4000, t.load_before = 1000, t.packing_friction = 0.1;
  for (int i = 0; i < 5; ++i) {
    const double s = 0.05 * i;
    t.s.push_back(s), t.gamma_dot.push_back(20), t.p.push_back(1000 + s), t.mu.push_back(0.5 - s);
    t.I.push_back(0.03 + s), t.phi.push_back(0.64 - s), t.beta.push_back(0.3 - s),
        t.height.push_back(0.015 + s);
  }
  o.transients = {t, t};
  o.transients[1].seed = 8;
  o.excluded = {{"dead", "LIGGGHTS ended with code 1"}};
  o.costs = {{"run0", "steady", 12}, {"abc", "start_up", 17}};
  return o;
}

TEST_F(ObservablesFile, RoundTrip) {
  const Observables o = example();
  write_observables(o, in("o.h5"));
  const Observables r = read_observables(in("o.h5"));
  EXPECT_EQ(r.d, o.d);
  EXPECT_EQ(r.rho_s, o.rho_s);
  EXPECT_EQ(r.grain_friction, o.grain_friction);
  EXPECT_EQ(r.pressure, o.pressure);
  EXPECT_EQ(r.engine, o.engine);
  EXPECT_EQ(r.material, o.material);
  ASSERT_EQ(r.steady.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(r.steady[i].run, o.steady[i].run);
    EXPECT_EQ(r.steady[i].seed, o.steady[i].seed);
    for (auto member : {&SteadyPoint::I_driven,  &SteadyPoint::I,           &SteadyPoint::I_se,
                        &SteadyPoint::mu,        &SteadyPoint::mu_se,       &SteadyPoint::phi,
                        &SteadyPoint::phi_se,    &SteadyPoint::p,           &SteadyPoint::p_se,
                        &SteadyPoint::wall_mu,   &SteadyPoint::wall_p,      &SteadyPoint::strain,
                        &SteadyPoint::phi_drift, &SteadyPoint::N1,          &SteadyPoint::N1_se,
                        &SteadyPoint::N2,        &SteadyPoint::N2_se,       &SteadyPoint::beta,
                        &SteadyPoint::beta_se,   &SteadyPoint::temperature, &SteadyPoint::coordination,
                        &SteadyPoint::fabric_xz})
      EXPECT_EQ(r.steady[i].*member, o.steady[i].*member);
    for (auto member : {&SteadyPoint::I_flat, &SteadyPoint::mu_flat, &SteadyPoint::phi_flat})
      EXPECT_EQ(r.steady[i].*member, o.steady[i].*member);
  }
  ASSERT_EQ(r.transients.size(), 2U);
  EXPECT_EQ(r.transients[1].seed, 8);
  EXPECT_EQ(r.transients[0].kind, "start_up");
  for (auto member : {&Transient::phi_0, &Transient::I_driven, &Transient::I_before, &Transient::load,
                      &Transient::load_before, &Transient::packing_friction})
    EXPECT_EQ(r.transients[0].*member, o.transients[0].*member);
  for (auto member : {&Transient::s, &Transient::gamma_dot, &Transient::p, &Transient::mu, &Transient::I,
                      &Transient::phi, &Transient::beta, &Transient::height})
    EXPECT_EQ(r.transients[0].*member, o.transients[0].*member);
  ASSERT_EQ(r.excluded.size(), 1U);
  EXPECT_EQ(r.excluded[0].reason, o.excluded[0].reason);
  ASSERT_EQ(r.costs.size(), 2U);
  EXPECT_EQ(r.costs[1].run, "abc");
  EXPECT_EQ(r.costs[1].kind, "start_up");
  EXPECT_EQ(r.cpu_seconds(), 29);
}

TEST_F(ObservablesFile, AnEmptySweepIsAFileToo) {
  Observables o = example();
  o.steady.clear(), o.transients.clear(), o.excluded.clear();
  write_observables(o, in("o.h5"));
  EXPECT_TRUE(read_observables(in("o.h5")).steady.empty());
}

TEST_F(ObservablesFile, AnythingLessThanTheWholeIsUnreadable) {
  write_observables(example(), in("o.h5"));
  const std::string whole = content_of(in("o.h5"));
  for (int part = 0; part < 97; ++part) {
    put(in("cut.h5"), whole.substr(0, whole.size() * static_cast<std::size_t>(part) / 97));
    EXPECT_CONTAINS(message_of<InputError>([&] { read_observables(in("cut.h5")); }), "cut.h5");
  }
  EXPECT_CONTAINS(message_of<InputError>([&] { read_observables(in("none.h5")); }), "no such file");
  EXPECT_EQ(InputError("").code(), ExitCode::unreadable);
}

TEST_F(ObservablesFile, ForeignOrNotFiniteIsRefused) {
  {
    Hdf5Writer file(in("other.h5"));
    file.attribute("/", "format", std::string("something else"));
    file.attribute("/", "schema_version", std::int64_t{1});
    file.commit();
  }
  EXPECT_CONTAINS(message_of<InputError>([&] { read_observables(in("other.h5")); }), "something else");
  Observables o = example();
  o.steady[1].mu_se = std::nan("");
  write_observables(o, in("nan.h5"));
  EXPECT_CONTAINS(message_of<InputError>([&] { read_observables(in("nan.h5")); }), "steady/mu_se");
  o = example();
  o.transients[0].beta.pop_back();
  write_observables(o, in("ragged.h5"));
  EXPECT_CONTAINS(message_of<InputError>([&] { read_observables(in("ragged.h5")); }), "beta");
}

}  // namespace
}  // namespace dem2sph
