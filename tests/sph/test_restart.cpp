// N steps equal k + (N - k) steps bit for bit, and a checkpoint of another configuration is refused.
#include <filesystem>

#include "sph/base/errors.hpp"
#include "sph/composition.hpp"
#include "tests/base/helpers.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {
namespace {

const std::string column = R"(
[flow]
scene = "column_collapse"
resolution = 10
[column]
length = "0.1 m"
)" + glass_beads;

using Restart = test::Scratch;

TEST_F(Restart, ContinuesBitForBit) {
  const std::filesystem::path path = in("checkpoint.h5");
  for (const std::string formulation : {"robust", "source"})
    for (const std::string dilation : {"none", "evolve"}) {
      const CaseFile file = case_of(column, {"flow.formulation=" + formulation, "flow.dilation=" + dilation});
      auto whole = flow_of<2>(file);
      // 700 steps in robust: the list is rebuilt many times, before and after the checkpoint.
      for (int i = 0; i < 437; ++i) whole->step(1);
      whole->save(path, "key", "note");
      for (int i = 0; i < 263; ++i) whole->step(1);
      auto resumed = flow_of<2>(file);
      EXPECT_EQ(resumed->load(path, "key"), "note");
      EXPECT_EQ(resumed->steps(), 437);
      for (int i = 0; i < 263; ++i) resumed->step(1);
      EXPECT_EQ(resumed->time(), whole->time());
      const Frame a = whole->frame();
      const Frame b = resumed->frame();
      for (const FrameField& field : a.fields)
        EXPECT_EQ(field.values, b.field(field.name).values)
            << formulation << ", " << dilation << ": " << field.name;
      EXPECT_EQ(whole->budgets().dissipated, resumed->budgets().dissipated);
    }
}

TEST_F(Restart, AnotherConfigurationIsRefused) {
  const std::filesystem::path path = in("checkpoint.h5");
  auto flow = flow_of<2>(case_of(column));
  flow->save(path, "one", "");
  EXPECT_THROW(flow->load(path, "two"), InputError);
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  EXPECT_THROW(flow->load(path, "one"), InputError);
}

}  // namespace
}  // namespace dem2sph
