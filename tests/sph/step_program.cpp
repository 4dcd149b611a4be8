// Takes a number of steps of a small incline and counts allocations: what test_instructions.cpp runs, under
// callgrind and by itself.
//   step_program STEPS [section.key=value ...]
#include <cstdio>
#include <cstdlib>
#include <new>

#include "tests/sph/compositions.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace {
long allocations = 0;
long allocated_bytes = 0;
void* counted(std::size_t bytes) {
  ++allocations;
  allocated_bytes += static_cast<long>(bytes);
  if (void* place = std::malloc(bytes == 0 ? 1 : bytes)) return place;
  throw std::bad_alloc();
}
}  // namespace

void* operator new(std::size_t bytes) { return counted(bytes); }
void* operator new[](std::size_t bytes) { return counted(bytes); }
void operator delete(void* place) noexcept { std::free(place); }
void operator delete[](void* place) noexcept { std::free(place); }
void operator delete(void* place, std::size_t) noexcept { std::free(place); }
void operator delete[](void* place, std::size_t) noexcept { std::free(place); }

namespace dem2sph {
namespace {

// H = 20 d at 25 deg with the exact profile: everything flows, so that no branch of the law is left out. The
// step is short, so that a few steps need no new list.
const std::string incline = R"(
[flow]
scene = "inclined_plane"
resolution = 20
end_time = "1 s"
step_factor = 0.2
[incline]
height = "0.1 m"
angle = "25 deg"
length = "0.12 m"
start = "bagnold"
)";

int run(long steps, std::vector<std::string> overrides) {
  const bool moving = std::erase(overrides, "moving") > 0;
  const CaseFile file = case_of(incline + law_for(overrides), overrides);
  FlowSetup<2> setup = make_setup<2>(file, law_of_case(file));
  if (moving) setup.walls[0].velocity[0] = 0.1;
  const auto flow = make_flow<2>(std::move(setup));
  std::printf("particles %zu\nwall_particles %zu\npairs %zu\n", flow->interior(),
              flow->particles() - flow->interior(), flow->pairs());
  // What a step asks of the heap, one line a step: a step that builds a new list asks for more.
  for (long k = 0; k < steps; ++k) {
    const long before = allocations;
    const long bytes_before = allocated_bytes;
    flow->step(1);
    const long count = allocations - before;
    const long bytes = allocated_bytes - bytes_before;
    std::printf("step %ld %ld\n", count, bytes);
  }
  return 0;
}

}  // namespace
}  // namespace dem2sph

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fputs("usage: step_program STEPS [section.key=value ...]\n", stderr);
    return 2;
  }
  try {
    return dem2sph::run(std::atol(argv[1]), std::vector<std::string>(argv + 2, argv + argc));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "step_program: %s\n", error.what());
    return 1;
  }
}
