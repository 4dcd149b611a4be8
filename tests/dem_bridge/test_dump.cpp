// Dumps: what is whole is read exactly, what is cut is reported as incomplete, what is damaged is refused
// with its place.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "dem_bridge/dump.hpp"
#include "tests/base/helpers.hpp"
#include "tests/dem_bridge/packing.hpp"

namespace dem2sph::bridge {
namespace {

using dem2sph::test::message_of;
using dem2sph::test::put;
using Dump = dem2sph::test::Scratch;
using test::Lattice;
using test::text_of;

Lattice small() {
  Lattice lattice;
  lattice.columns_x = 2, lattice.columns_y = 1, lattice.layers = 3;
  lattice.gamma_dot = 12.5, lattice.normal = 1e-3, lattice.tangential = 2e-4;
  return lattice;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

TEST_F(Dump, ReadsBackWhatWasWritten) {
  const Lattice lattice = small();
  put(in("g"), text_of(lattice.frame(10)) + text_of(lattice.frame(20)));
  put(in("c"), text_of(lattice.contacts(10)) + text_of(lattice.contacts(20)));
  GrainDump grains(in("g"));
  ContactDump contacts(in("c"), ContactColumns{});
  for (const std::int64_t step : {10, 20}) {
    GrainFrame g;
    ASSERT_EQ(grains.next(g), ReadResult::frame);
    const GrainFrame expected = lattice.frame(step);
    EXPECT_EQ(g.step, step);
    EXPECT_EQ(g.box.periodic, expected.box.periodic);
    EXPECT_EQ(g.box.high.c, expected.box.high.c);
    ASSERT_EQ(g.grains.size(), expected.grains.size());
    for (std::size_t i = 0; i < g.grains.size(); ++i) {
      EXPECT_EQ(g.grains[i].id, expected.grains[i].id);
      EXPECT_EQ(g.grains[i].type, expected.grains[i].type);
      EXPECT_EQ(g.grains[i].x.c, expected.grains[i].x.c);
      EXPECT_EQ(g.grains[i].v.c, expected.grains[i].v.c);
      EXPECT_EQ(g.grains[i].radius, expected.grains[i].radius);
    }
    ContactFrame c;
    ASSERT_EQ(contacts.next(c), ReadResult::frame);
    const ContactFrame expected_contacts = lattice.contacts(step);
    ASSERT_EQ(c.contacts.size(), expected_contacts.contacts.size());
    EXPECT_EQ(c.contacts[0].first, expected_contacts.contacts[0].first);
    EXPECT_EQ(c.contacts[0].force.c, expected_contacts.contacts[0].force.c);
  }
  GrainFrame g;
  ContactFrame c;
  EXPECT_EQ(grains.next(g), ReadResult::end);
  EXPECT_EQ(contacts.next(c), ReadResult::end);
}

TEST_F(Dump, StressComesWithAllItsColumns) {
  const std::string head =
      "ITEM: TIMESTEP\n7\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS pp pp ff\n0 1\n0 1\n0 1\n"
      "ITEM: ATOMS id type x y z vx vy vz radius c_flow_stress[1] c_flow_stress[2] c_flow_stress[3] "
      "c_flow_stress[5] ";
  put(in("g"), head + "c_flow_stress[4] c_flow_stress[6]\n1 1 0 0 0 0 0 0 0.5 -1 -2 -3 -5 -4 -6\n");
  GrainFrame frame;
  ASSERT_EQ(GrainDump(in("g")).next(frame), ReadResult::frame);
  ASSERT_TRUE(frame.grains[0].stress_volume.has_value());
  EXPECT_EQ(*frame.grains[0].stress_volume, (std::array<double, 6>{-1, -2, -3, -4, -5, -6}));
  put(in("g"), head + "c_flow_stress[4]\n1 1 0 0 0 0 0 0 0.5 -1 -2 -3 -5 -4\n");
  EXPECT_CONTAINS(message_of<InputError>([&] { GrainDump(in("g")).next(frame); }),
                  "no column \"c_flow_stress[6]\"");
}

TEST_F(Dump, FindsColumnsByName) {
  put(in("g"),
      "ITEM: TIMESTEP\n7\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS pp pp ff\n0 1\n0 1\n0 1\n"
      "ITEM: ATOMS radius vz vy vx z y x type extra id \n0.5 6 5 4 3 2 1 3 99 42\n");
  GrainDump dump(in("g"));
  GrainFrame frame;
  ASSERT_EQ(dump.next(frame), ReadResult::frame);
  EXPECT_EQ(frame.grains[0].id, 42);
  EXPECT_EQ(frame.grains[0].type, GrainType::top_wall);
  EXPECT_EQ(frame.grains[0].x[2], 3);
  EXPECT_EQ(frame.grains[0].v[0], 4);
  EXPECT_EQ(frame.grains[0].radius, 0.5);
}

TEST_F(Dump, EveryPrefixIsWholeFramesAndThenIncomplete) {
  const Lattice lattice = small();
  const std::string first = text_of(lattice.frame(10)), grains = first + text_of(lattice.frame(20));
  const std::string first_contacts = text_of(lattice.contacts(10)),
                    contacts = first_contacts + text_of(lattice.contacts(20));
  const auto check = [&](const std::string& whole, std::size_t frame_size, auto&& open, auto frame) {
    for (std::size_t n = 0; n <= whole.size(); ++n) {
      put(in("d"), whole.substr(0, n));
      auto dump = open();
      std::size_t frames = 0;
      ReadResult result;
      while ((result = dump.next(frame)) == ReadResult::frame) ++frames;
      EXPECT_EQ(frames, n == whole.size() ? 2U : n >= frame_size ? 1U : 0U) << n;
      const bool between = n == 0 || n == frame_size || n == whole.size();
      EXPECT_EQ(result, between ? ReadResult::end : ReadResult::incomplete) << n;
    }
  };
  check(
      grains, first.size(), [&] { return GrainDump(in("d")); }, GrainFrame{});
  check(
      contacts, first_contacts.size(), [&] { return ContactDump(in("d"), ContactColumns{}); },
      ContactFrame{});
}

TEST_F(Dump, RefusesDamageWithItsPlace) {
  const std::string good = text_of(small().frame(10));
  const std::vector<std::array<std::string, 3>> cases{
      {"ATOMS id type", "ATOMS ident type", "d:9: the dump has no column \"id\""},
      {"ITEM: NUMBER OF ATOMS\n6", "ITEM: NUMBER OF ATOMS\n99999999999",
       "d:9: 99999999999 rows of 9 columns cannot stand in a file"},
      {"ITEM: NUMBER OF ATOMS\n6", "ITEM: NUMBER OF ATOMS\n-1", "d:4: \"-1\" is not a number of the kind"},
      {"0.0005 \n", "nan \n", "d:10: \"nan\" is not finite"},
      {"0.0005 \n", "0 \n", "has no radius"},
      {"0.0005 \n", "\n", "d:10: 8 numbers in a row of 9 columns"},
      {"0.0005 \n", "0.0005x \n", "d:10: \"0.0005x\" is not a number"},
      {"5 3 ", "6 3 ", "grain 6 stands here twice"},
      {"5 3 ", "5 4 ", "grain type 4"},
      {"pp pp ff", "xy xz yz pp pp ff", "only boxes with axes"},
      {"ITEM: TIMESTEP", "ITEM: TIME", "d:1: expected \"ITEM: TIMESTEP\""},
      {"0 0.002\n", "0.002 0\n", "the box has no extent"}};
  for (const auto& [from, to, message] : cases) {
    put(in("d"), replaced(good, from, to));
    EXPECT_CONTAINS(message_of<InputError>([&] {
                      GrainDump dump(in("d"));
                      GrainFrame frame;
                      dump.next(frame);
                    }),
                    message);
  }
  const std::string contacts = text_of(small().contacts(10));
  for (const auto& [from, to, message] :
       std::vector<std::array<std::string, 3>>{{"c[5] c[6]", "c[5]", "5 columns, but the run's map names 6"},
                                               {"3 1 0 ", "3 3 0 ", "grain 3 touches itself"},
                                               {"3 1 0 ", "3.5 1 0 ", "\"3.5\" is not a whole number"},
                                               {"3 1 0 ", "1e300 1 0 ", "not a whole number"},
                                               {"3 1 0 ", "3 1 ", "5 numbers in a row of 6 columns"}}) {
    put(in("d"), replaced(contacts, from, to));
    EXPECT_CONTAINS(message_of<InputError>([&] {
                      ContactDump dump(in("d"), ContactColumns{});
                      ContactFrame frame;
                      dump.next(frame);
                    }),
                    message);
  }
  put(in("d"), good + good);  // steps must grow
  EXPECT_CONTAINS(message_of<InputError>([&] {
                    GrainDump dump(in("d"));
                    GrainFrame frame;
                    dump.next(frame);
                    dump.next(frame);
                  }),
                  "step 10 does not follow step 10");
  EXPECT_CONTAINS(message_of<InputError>([&] { GrainDump dump(in("none")); }), "cannot open");
}

RC_GTEST_FIXTURE_PROP(Dump, AnyChangedByteIsReadOrRefused, ()) {
  // Whatever a byte becomes, the reader returns or throws InputError: any other exception fails the property.
  std::string text = text_of(small().frame(10)) + text_of(small().frame(20));
  const int changes = *rc::gen::inRange(1, 4);
  for (int i = 0; i < changes; ++i)
    text[*rc::gen::inRange<std::size_t>(0, text.size())] = static_cast<char>(*rc::gen::inRange(0, 256));
  put(in("fuzz"), text);
  try {
    GrainDump dump(in("fuzz"));
    GrainFrame frame;
    for (int n = 0; n < 3 && dump.next(frame) == ReadResult::frame; ++n) {
      for (const Grain& g : frame.grains) RC_ASSERT(std::isfinite(g.x[0] + g.v[0] + g.radius));
    }
  } catch (const InputError& error) {
    RC_ASSERT(std::string(error.what()).find("fuzz:") != std::string::npos);
  }
}

}  // namespace
}  // namespace dem2sph::bridge
