// N steps equal k + (N - k) steps bit for bit, and a checkpoint of another configuration is refused.
#include <filesystem>

#include "sph/base/errors.hpp"
#include "tests/base/helpers.hpp"
#include "tests/sph/compositions.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {
namespace {

const std::string flow_and_column = R"(
[flow]
scene = "column_collapse"
resolution = 10
[column]
length = "0.1 m"
)";
const std::string column = flow_and_column + glass_beads;

using Restart = test::Scratch;

TEST_F(Restart, ContinuesBitForBitWhateverTheComposition) {
  const std::filesystem::path path = in("checkpoint.h5");
  for (const NamedComposition& composition : all_compositions()) {
    std::vector<std::string> overrides = composition.overrides;
    overrides.push_back("column.floor_length=0.18 m");
    const CaseFile file = case_of(flow_and_column + law_for(composition.overrides), overrides);
    auto whole = flow_of<2>(file);
    // The list is rebuilt before and after the checkpoint in the falling column: 0.15 dx are 57 steps.
    for (int i = 0; i < 110; ++i) whole->step(1);
    whole->save(path, "key", "note");
    for (int i = 0; i < 70; ++i) whole->step(1);
    auto resumed = flow_of<2>(file);
    EXPECT_EQ(resumed->load(path, "key"), "note");
    EXPECT_EQ(resumed->steps(), 110);
    for (int i = 0; i < 70; ++i) resumed->step(1);
    EXPECT_EQ(resumed->time(), whole->time());
    const Frame a = whole->frame();
    const Frame b = resumed->frame();
    for (const FrameField& field : a.fields)
      EXPECT_EQ(field.values, b.field(field.name).values) << composition.name << ": " << field.name;
    EXPECT_EQ(whole->budgets().dissipated, resumed->budgets().dissipated) << composition.name;
    EXPECT_EQ(whole->budgets().diffused, resumed->budgets().diffused) << composition.name;
  }
}

TEST_F(Restart, MovingWallsContinueBitForBit) {
  const std::filesystem::path path = in("checkpoint.h5");
  const CaseFile file = case_of(R"(
[flow]
scene = "plane_shear"
resolution = 10
end_time = "1 s"
[shear]
height = "0.05 m"
shear_rate = "20 1/s"
pressure = "500 Pa"
)" + glass_beads);
  auto whole = flow_of<2>(file);
  for (int i = 0; i < 300; ++i) whole->step(1);
  whole->save(path, "key", "");
  for (int i = 0; i < 300; ++i) whole->step(1);
  auto resumed = flow_of<2>(file);
  resumed->load(path, "key");
  for (int i = 0; i < 300; ++i) resumed->step(1);
  for (const FrameField& field : whole->frame().fields)
    EXPECT_EQ(field.values, resumed->frame().field(field.name).values) << field.name;
  EXPECT_EQ(whole->budgets().from_walls, resumed->budgets().from_walls);
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
