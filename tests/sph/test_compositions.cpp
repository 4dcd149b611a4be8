// Every composition that is listed runs; one that is not is refused with the list; options that change
// nothing too.
#include "sph/base/errors.hpp"
#include "sph/composition.hpp"
#include "tests/sph/flow_fixture.hpp"

namespace dem2sph {
namespace {

const std::string scene = R"(
[flow]
scene = "inclined_plane"
resolution = 8
end_time = "1 s"
[incline]
height = "0.1 m"
angle = "20 deg"
)" + glass_beads;

template <int Dim>
void every_composition_steps() {
  const CaseFile file = case_of(scene, {fmt::format("flow.dimension={}", Dim)});
  for_each_composition(static_cast<CompositionList<Dim>*>(nullptr), [&]<class C>() {
    const bool robust = C::Stress::elastic;
    const CaseFile chosen = case_of(scene, {fmt::format("flow.dimension={}", Dim),
                                            fmt::format("flow.formulation={}", robust ? "robust" : "source"),
                                            fmt::format("flow.kernel={}", C::Kernel::name),
                                            fmt::format("flow.dilation={}", C::Dilation::name),
                                            fmt::format("flow.damping={}", C::Damping::name)});
    FlowSetup<Dim> setup = make_setup<Dim>(chosen, law_of_case(chosen));
    const double width = Dim == 3 ? setup.period.length[1] : 1.0;
    const double area = setup.period.length[0] * width;
    auto flow = make_flow<Dim>(std::move(setup));
    for (int i = 0; i < 20; ++i) flow->step(1);
    const Budgets b = flow->budgets();
    EXPECT_NEAR(b.mass, 1500 * 0.1 * area, 0.01 * b.mass) << name_of_composition<C>();
    EXPECT_TRUE(std::isfinite(b.kinetic)) << name_of_composition<C>();
    EXPECT_GT(b.momentum[0], 0) << "it accelerates down the slope: " << name_of_composition<C>();
    EXPECT_EQ(flow->frame().has("beta"), C::Dilation::on);
    if (Dim == 3) {
      EXPECT_LT(std::abs(b.momentum[1]), 1e-10 * b.momentum[0]) << "no drift across";
    }
  });
}
TEST(Compositions, EachSteps2D) { every_composition_steps<2>(); }
TEST(Compositions, EachSteps3D) { every_composition_steps<3>(); }

TEST(Compositions, UnlistedIsRefusedWithTheList) {
  try {
    flow_of<2>(case_of(scene, {"flow.kernel=wendland_c4", "flow.dilation=evolve"}));
    FAIL() << "accepted";
  } catch (const UsageError& error) {
    const std::string text = error.what();
    EXPECT_NE(text.find("wendland_c4"), std::string::npos) << text;
    EXPECT_NE(text.find("cubic_spline + summation_shepard"), std::string::npos) << text;
  }
}

TEST(Compositions, APartThatIsOffHasNoArrays) {
  auto without = flow_of<2>(case_of(scene));
  auto with = flow_of<2>(case_of(scene, {"flow.dilation=evolve"}));
  EXPECT_EQ(with->bytes() - without->bytes(), 2 * sizeof(double) * without->particles()) << "phi and beta";
}

void refused(const std::vector<std::string>& overrides, const std::string& expected) {
  try {
    const CaseFile file = case_of(scene, overrides);
    make_setup<2>(file, law_of_case(file));
    FAIL() << "accepted: " << overrides[0];
  } catch (const UsageError& error) {
    EXPECT_NE(std::string(error.what()).find(expected), std::string::npos) << error.what();
  }
}

TEST(Compositions, OptionsThatChangeNothingAreRefused) {
  refused({"flow.g_min=1 1/s"}, "\"g_min\" changes nothing");
  refused({"flow.formulation=source", "flow.shear_modulus=0.5"}, "\"shear_modulus\" changes nothing");
  refused({"flow.damping=none", "flow.artificial_viscosity=0.2"}, "\"artificial_viscosity\" changes nothing");
  refused({"flow.beta_highest=0.3"}, "\"beta_highest\" changes nothing");
  refused({"flow.stop_at_rest=true"}, "\"stop_at_rest\" changes nothing");
  refused({"incline.width=1 m"}, "\"width\" changes nothing");
  refused({"flow.mach=0.1", "flow.sound_speed=10 m/s"}, "not both");
  refused({"incline.start=bagnold"}, "slope between mu_l and mu_h");
  refused({"column.length=1 m"}, "[column] changes nothing");
  refused({"law.mu_h=0.2"}, "mu_h");
}

TEST(Compositions, SameInputSameBits) {
  auto one = flow_of<2>(case_of(scene));
  auto two = flow_of<2>(case_of(scene));
  for (int i = 0; i < 200; ++i) one->step(1), two->step(1);
  EXPECT_EQ(one->frame().field("x").values, two->frame().field("x").values);
  EXPECT_EQ(one->frame().field("stress").values, two->frame().field("stress").values);
}

}  // namespace
}  // namespace dem2sph
