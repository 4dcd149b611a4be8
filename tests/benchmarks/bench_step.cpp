// Whole steps of flows beside the yardstick, in particle-steps a second. Run by run.sh, which prints ratios.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <cmath>
#include <memory>

#include "tests/benchmarks/yardstick.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {
namespace {

/// A bed of `rows` particles on a rough slope that flows with its exact profile, about `particles` in all,
/// with as many neighbours as the yardstick: support 2.4 dx.
template <int Dim>
std::unique_ptr<Flow> slope(std::size_t particles, const std::string& formulation, const std::string& more) {
  const double rows = Dim == 2 ? 64 : 24, dx = 0.005;
  const double along =
      Dim == 2 ? static_cast<double>(particles) / rows : std::sqrt(static_cast<double>(particles) / rows);
  const std::string text = fmt::format(
      "[flow]\nscene = \"inclined_plane\"\nresolution = {}\nend_time = \"1 s\"\ndimension = {}\n"
      "formulation = \"{}\"\nh_over_dx = 1.2\n{}\n[incline]\nheight = \"{} m\"\nangle = \"25 deg\"\n"
      "length = \"{} m\"\n{}start = \"bagnold\"\n{}",
      rows, Dim, formulation, more, rows * dx, std::round(along) * dx,
      Dim == 3 ? fmt::format("width = \"{} m\"\n", std::round(along) * dx) : "", glass_beads);
  return flow_of<Dim>(case_of(text));
}

template <int Dim>
void step(benchmark::State& state, const std::string& formulation, const std::string& more) {
  const auto flow = slope<Dim>(static_cast<std::size_t>(state.range(0)), formulation, more);
  for (int k = 0; k < 5; ++k) flow->step(1);
  const double before = flow->time();
  for (auto _ : state) flow->step(1);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(flow->interior()));
  state.counters["particles"] = static_cast<double>(flow->interior());
  state.counters["walls"] = static_cast<double>(flow->particles() - flow->interior());
  state.counters["bytes"] = static_cast<double>(flow->bytes()) / static_cast<double>(flow->interior());
  state.counters["pairs"] = static_cast<double>(flow->pairs()) / static_cast<double>(flow->interior());
  state.counters["dt"] = (flow->time() - before) / static_cast<double>(state.iterations());
}

template <int Dim, bool fused>
void passes(benchmark::State& state) {
  static yardstick::Cloud<Dim> cloud(Dim == 2 ? 224 : 47);
  for (auto _ : state) fused ? yardstick::two_passes(cloud) : yardstick::four_passes(cloud);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(cloud.q.size));
  state.counters["pairs"] = static_cast<double>(cloud.list.pairs()) / static_cast<double>(cloud.q.size);
}

template <int Dim>
void list(benchmark::State& state) {
  yardstick::Cloud<Dim> cloud(Dim == 2 ? 224 : 47);
  for (auto _ : state) cloud.list.build(cloud.q, Period<Dim>{}, 2 * cloud.h * 1.1, {});
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(cloud.q.size));
}
template <int Dim>
void sort(benchmark::State& state) {
  yardstick::Cloud<Dim> cloud(Dim == 2 ? 224 : 47);
  for (auto _ : state) benchmark::DoNotOptimize(spatial_order(cloud.q, 1.0));
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(cloud.q.size));
}

void register_all() {
  const auto named = [](const std::string& name, auto f) {
    return benchmark::RegisterBenchmark(name.c_str(), f)
        ->Unit(benchmark::kMillisecond)
        ->MeasureProcessCPUTime()
        ->UseRealTime();
  };
  named("yardstick/2_passes/3D", passes<3, true>);
  named("yardstick/4_passes/3D", passes<3, false>);
  named("yardstick/2_passes/2D", passes<2, true>);
  named("yardstick/4_passes/2D", passes<2, false>);
  named("list/3D", list<3>);
  named("list/2D", list<2>);
  named("sort/3D", sort<3>);
  named("sort/2D", sort<2>);
  for (const std::string formulation : {"robust", "source"}) {
    named("step/" + formulation + "/3D", [=](benchmark::State& s) {
      step<3>(s, formulation, "");
    })->Arg(100000);
    named("step/" + formulation + "/2D", [=](benchmark::State& s) {
      step<2>(s, formulation, "");
    })->Arg(50000);
  }
  for (const int particles : {10000, 30000, 300000, 1000000, 2000000})
    named("size/robust/3D", [](benchmark::State& s) { step<3>(s, "robust", ""); })->Arg(particles);
}

}  // namespace
}  // namespace dem2sph

int main(int argc, char** argv) {
  dem2sph::register_all();
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
