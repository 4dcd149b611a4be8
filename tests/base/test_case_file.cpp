// Case files: each mistake a user can make, with the message that it must give; overrides, defaults and the
// effective configuration, which read back must be the same case.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <tuple>
#include <vector>

#include "sph/base/case_file.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using test::message_of;

const ParameterTable bed{
    "bed",
    "A bed of grains.",
    {
        {"height", Kind::quantity, "m", 0, 100, "required", "Height of the bed."},
        {"gravity", Kind::quantity, "m/s^2", 0, unbounded, "9.81 m/s^2", "Gravity."},
        {"slope", Kind::quantity, "rad", -2, 2, "unset", "Slope."},
        {"friction", Kind::number, "", 0, 2, "0.5", "Friction of the grains."},
        {"layers", Kind::integer, "", 1, 1e6, "20", "Layers of particles."},
        {"periodic", Kind::flag, "", 0, 0, "true", "Whether the sides are joined."},
        {"stress",
         Kind::word,
         "",
         0,
         0,
         "return",
         "How stress follows strain.",
         {"direct", "return", "elastic"}},
        {"law", Kind::file, "", 0, 0, "unset", "The calibrated law."},
        {"probes", Kind::quantities, "m", 0, 10, "[\"1 cm\", \"2 cm\"]", "Where to look."},
        {"weights", Kind::numbers, "", -1, 1, "[0.25, 0.75]", "Weights."},
        {"seeds", Kind::integers, "", 0, 1e9, "unset", "Seeds."},
    }};
const ParameterTable solver{
    "solver.step", "Time step.", {{"safety", Kind::number, "", 0, 1, "0.25", "Share."}}};
const std::array<const ParameterTable*, 2> tables{&bed, &solver};

CaseFile parse(const std::string& text, const std::vector<std::string>& overrides = {}) {
  return CaseFile::parse(text, "case.toml", overrides);
}

std::string refusal(const std::string& text, const std::vector<std::string>& overrides = {}) {
  return message_of<UsageError>([&] { parse(text, overrides).validate(tables); });
}

TEST(CaseFile, ReadsEveryKindInSi) {
  const Section s = parse(R"([bed]
height = "50 cm"
slope = "45 deg"
friction = 1
layers = 0x10
periodic = false
stress = "direct"
law = "laws/law.json"
probes = ["1 mm", "0.5 m"]
weights = [1, -0.5]
seeds = [3, 1, 2])")
                        .section(bed);
  EXPECT_EQ(s.quantity("height"), 0.5);
  EXPECT_EQ(s.quantity("gravity"), 9.81);  // the default
  EXPECT_NEAR(s.quantity("slope"), std::atan(1.0), 1e-15);
  EXPECT_EQ(s.number("friction"), 1);
  EXPECT_EQ(s.integer("layers"), 16);
  EXPECT_FALSE(s.flag("periodic"));
  EXPECT_EQ(s.word("stress"), "direct");
  EXPECT_EQ(s.file("law"), std::filesystem::path("laws/law.json"));
  EXPECT_EQ(s.quantities("probes"), (std::vector<double>{0.001, 0.5}));
  EXPECT_EQ(s.numbers("weights"), (std::vector<double>{1, -0.5}));
  EXPECT_EQ(s.integers("seeds"), (std::vector<long>{3, 1, 2}));
  EXPECT_TRUE(s.given("height"));
  EXPECT_FALSE(s.given("gravity"));
  EXPECT_EQ(s.where("slope"), "case.toml:3");
  EXPECT_EQ(s.where("gravity"), "case.toml");
}

TEST(CaseFile, DefaultsAndUnset) {
  const Section s = parse("[bed]\nheight = \"1 m\"").section(bed);
  EXPECT_TRUE(std::isnan(s.quantity("slope")));  // unset is never a plausible number
  EXPECT_EQ(s.number("friction"), 0.5);
  EXPECT_EQ(s.integer("layers"), 20);
  EXPECT_TRUE(s.flag("periodic"));
  EXPECT_EQ(s.word("stress"), "return");
  EXPECT_TRUE(s.file("law").empty());
  EXPECT_EQ(s.quantities("probes"), (std::vector<double>{0.01, 0.02}));
  EXPECT_EQ(s.numbers("weights"), (std::vector<double>{0.25, 0.75}));
  EXPECT_TRUE(s.integers("seeds").empty());
  EXPECT_EQ(parse("").section(solver).number("safety"), 0.25);  // an absent section has its defaults
}

TEST(CaseFile, ReadingAKeyAsAnotherKindIsABug) {
  const Section s = parse("[bed]\nheight = \"1 m\"").section(bed);
  EXPECT_THROW(s.number("height"), std::logic_error);
  EXPECT_THROW(s.number("no_such_key"), std::logic_error);
}

struct Mistake {
  const char* what;
  const char* text;
  std::vector<const char*> fragments;
};

TEST(CaseFile, EveryMistakeIsNamedWithItsPlace) {
  const std::vector<Mistake> mistakes{
      {"unknown key",
       "[bed]\nheight = \"1 m\"\nheigth = \"1 m\"",
       {"case.toml:3: ", "[bed]", "unknown key \"heigth\"", "did you mean \"height\"?"}},
      {"unknown key, nothing near",
       "[bed]\nheight = \"1 m\"\ncolour = 1",
       {"case.toml:3: ", "known: height, gravity"}},
      {"bare number", "[bed]\n\nheight = 0.5", {"case.toml:3: ", "\"height\" needs a unit", "\"1 m\""}},
      {"bare number in a list",
       "[bed]\nheight = \"1 m\"\nprobes = [\"1 m\", 2]",
       {"case.toml:3: ", "\"probes\" needs a unit"}},
      {"wrong dimension",
       "[bed]\nheight = \"1 kg\"",
       {"case.toml:2: ", "\"height\"", "is kg, but m is expected"}},
      {"misspelt unit", "[bed]\nheight = \"1 mn\"", {"case.toml:2: ", "unknown unit \"mn\"", "did you mean"}},
      {"above the bound", "[bed]\nheight = \"1 km\"", {"case.toml:2: ", "\"height\" = 1000 m", "[0, 100]"}},
      {"below the bound", "[bed]\nheight = \"-1 mm\"", {"case.toml:2: ", "outside [0, 100]"}},
      {"one of a list out of bounds",
       "[bed]\nheight = \"1 m\"\nweights = [0, 3]",
       {"case.toml:3: ", "\"weights\" = 3"}},
      {"not a number",
       "[bed]\nheight = \"1 m\"\nfriction = nan",
       {"case.toml:3: ", "\"friction\" must be a finite"}},
      {"infinite",
       "[bed]\nheight = \"1 m\"\nfriction = inf",
       {"case.toml:3: ", "\"friction\" must be a finite"}},
      {"number in quotes",
       "[bed]\nheight = \"1 m\"\nfriction = \"0.5\"",
       {"case.toml:3: ", "without quotes"}},
      {"flag for a number",
       "[bed]\nheight = \"1 m\"\nfriction = true",
       {"case.toml:3: ", "must be a number"}},
      {"fraction for a whole number",
       "[bed]\nheight = \"1 m\"\nlayers = 2.5",
       {"case.toml:3: ", "whole number"}},
      {"huge whole number",
       "[bed]\nheight = \"1 m\"\nlayers = 9223372036854775807",
       {"case.toml:3: ", "too large"}},
      {"number for a flag", "[bed]\nheight = \"1 m\"\nperiodic = 1", {"case.toml:3: ", "true or false"}},
      {"one for a list", "[bed]\nheight = \"1 m\"\nseeds = 1", {"case.toml:3: ", "a list of whole numbers"}},
      {"list for one", "[bed]\nheight = [\"1 m\"]", {"case.toml:2: ", "a quantity in quotes"}},
      {"misspelt word",
       "[bed]\nheight = \"1 m\"\nstress = \"retrun\"",
       {"case.toml:3: ", "unknown stress \"retrun\"", "did you mean \"return\"?"}},
      {"unknown word",
       "[bed]\nheight = \"1 m\"\nstress = \"hypoplastic\"",
       {"case.toml:3: ", "\"direct\", \"return\", \"elastic\""}},
      {"empty file name",
       "[bed]\nheight = \"1 m\"\nlaw = \"\"",
       {"case.toml:3: ", "\"law\" must be a file name"}},
      {"missing key",
       "\n[bed]\nlayers = 3",
       {"case.toml:2: ", "lacks the required key \"height\"", "Height of the bed."}},
      {"repeated key", "[bed]\nheight = \"1 m\"\nheight = \"2 m\"", {"case.toml:3: "}},
      {"repeated section", "[bed]\nheight = \"1 m\"\n[bed]\nlayers = 2", {"case.toml:3: "}},
      {"no TOML", "[bed\nheight = 1", {"case.toml:1: "}},
      {"unknown section",
       "[bed]\nheight = \"1 m\"\n[bad]\nx = 1",
       {"case.toml:3: ", "unknown section [bad]", "did you mean [bed]?"}},
      {"unknown sub-section",
       "[bed]\nheight = \"1 m\"\n[bed.sides]\nx = 1",
       {"case.toml:3: ", "unknown section [bed.sides]"}},
      {"key outside any section",
       "height = \"1 m\"",
       {"case.toml:1: ", "\"height\" stands outside any section"}},
      {"key in a section that has only sub-sections",
       "[solver]\nsafety = 0.1\n[solver.step]\nsafety = 0.2",
       {"case.toml:2: ", "unknown key \"safety\"", "[solver]"}},
      {"value for a section", "[solver]\nstep = 3", {"case.toml:2: "}},
  };
  for (const Mistake& m : mistakes) {
    SCOPED_TRACE(m.what);
    const std::string message = refusal(m.text);
    for (const char* fragment : m.fragments) EXPECT_CONTAINS(message, fragment);
  }
}

TEST(CaseFile, AValidFilePasses) {
  EXPECT_NO_THROW(parse("[bed]\nheight = \"1 m\"\n[solver.step]\nsafety = 0.1").validate(tables));
}

TEST(CaseFile, AKeyThatNobodyReadIsRefused) {
  const Section s = parse("[bed]\nheight = \"1 m\"\nfriction = 0.3").section(bed);
  s.quantity("height");
  const std::string message = message_of<UsageError>([&] { s.finish("with stress = \"direct\""); });
  EXPECT_CONTAINS(message, "case.toml:3: [bed] \"friction\" changes nothing with stress = \"direct\"");
  s.number("friction");
  EXPECT_NO_THROW(s.finish());  // defaults that nobody read are no mistake
}

TEST(CaseFile, RefuseNamesThePlaceOfTheKey) {
  const Section s = parse("[bed]\nheight = \"1 m\"").section(bed);
  EXPECT_EQ(message_of<UsageError>([&] { s.refuse("height", "too low for 20 layers"); }),
            "case.toml:2: [bed] too low for 20 layers");
}

TEST(CaseFile, OverridesReplaceAndAdd) {
  const std::vector<std::string> overrides{
      "bed.height=20 cm",   "bed.friction=0.1",      "bed.stress=direct",      "bed.seeds=[4, 5]",
      "bed.periodic=false", "bed.probes=[\"3 cm\"]", "solver.step.safety=0.5", "bed.gravity=\"1 m/s^2\""};
  const CaseFile file = parse("[bed]\nheight = \"1 m\"\nfriction = 0.7", overrides);
  EXPECT_NO_THROW(file.validate(tables));
  const Section s = file.section(bed);
  EXPECT_EQ(s.quantity("height"), 0.2);
  EXPECT_EQ(s.number("friction"), 0.1);
  EXPECT_EQ(s.word("stress"), "direct");
  EXPECT_EQ(s.integers("seeds"), (std::vector<long>{4, 5}));
  EXPECT_FALSE(s.flag("periodic"));
  EXPECT_EQ(s.quantities("probes"), (std::vector<double>{0.03}));
  EXPECT_EQ(s.quantity("gravity"), 1);
  EXPECT_EQ(file.section(solver).number("safety"), 0.5);  // a section that the file does not have
  EXPECT_TRUE(s.given("seeds"));
  EXPECT_EQ(s.where("height"), "case.toml");  // no line of the file is to blame
}

TEST(CaseFile, OverridesAreCheckedAsTheFileIs) {
  const std::string text = "[bed]\nheight = \"1 m\"";
  EXPECT_CONTAINS(refusal(text, {"bed.heigth=1 m"}), "did you mean \"height\"?");
  EXPECT_CONTAINS(refusal(text, {"bed.height=1"}), "needs a unit");
  EXPECT_CONTAINS(refusal(text, {"bed.height=1 kg"}), "m is expected");
  EXPECT_CONTAINS(refusal(text, {"bad.height=1 m"}), "unknown section [bad]");
  for (const char* malformed : {"height", "bed.height", "height=1 m", ".height=1 m", "bed.height=", ""})
    EXPECT_CONTAINS(refusal(text, {malformed}), "write section.key=value");
  EXPECT_CONTAINS(refusal(text, {"bed.height.x=1"}), "write section.key=value");
}

TEST(CaseFile, TheEffectiveConfigurationIsTheSameCase) {
  const CaseFile first = parse(R"([bed]
height = "50 cm"
friction = 0.1
law = "odd \"names\" and \\ signs.json"
weights = [0.3333333333333333, -1e-17]
seeds = [7]
[solver.step]
safety = 1)",
                               {"bed.stress=elastic"});
  first.validate(tables);
  const std::string text = first.effective();
  SCOPED_TRACE(text);
  const CaseFile second = CaseFile::parse(text, "effective.toml");
  EXPECT_NO_THROW(second.validate(tables));
  const Section a = first.section(bed);
  const Section b = second.section(bed);
  EXPECT_EQ(a.quantity("height"), b.quantity("height"));
  EXPECT_EQ(a.quantity("gravity"), b.quantity("gravity"));
  EXPECT_TRUE(std::isnan(b.quantity("slope")));
  EXPECT_EQ(a.number("friction"), b.number("friction"));
  EXPECT_EQ(a.integer("layers"), b.integer("layers"));
  EXPECT_EQ(a.flag("periodic"), b.flag("periodic"));
  EXPECT_EQ(b.word("stress"), "elastic");
  EXPECT_EQ(a.file("law"), b.file("law"));
  EXPECT_EQ(a.quantities("probes"), b.quantities("probes"));
  EXPECT_EQ(a.numbers("weights"), b.numbers("weights"));
  EXPECT_EQ(a.integers("seeds"), b.integers("seeds"));
  EXPECT_EQ(second.section(solver).number("safety"), 1);
  EXPECT_TRUE(
      b.given("gravity"));  // defaults are written out, so that a later default cannot change the case
  EXPECT_CONTAINS(text, "friction = 0.1\n");  // as one would write it
  EXPECT_CONTAINS(text, "# default");
}

TEST(CaseFile, DescribeListsEveryParameter) {
  const std::string text = describe(bed);
  EXPECT_CONTAINS(text, "[bed]  A bed of grains.");
  for (const Parameter& p : bed.parameters) {
    EXPECT_CONTAINS(text, p.name);
    EXPECT_CONTAINS(text, p.sentence);
  }
  EXPECT_CONTAINS(text, "in [0, 100] m; required");
  EXPECT_CONTAINS(text, "default 9.81 m/s^2");
  EXPECT_CONTAINS(text, "one of \"direct\", \"return\", \"elastic\"");
  EXPECT_CONTAINS(text, "unset");
}

// ---- tables that stand for every sub-table of a section

const ParameterTable walls{"wall.*",
                           "A wall.",
                           {{"height", Kind::quantity, "m", 0, 100, "required", "Its height."},
                            {"rough", Kind::flag, "", 0, 0, "true", "Whether it holds grains."}}};
const std::array<const ParameterTable*, 2> wall_tables{&bed, &walls};

TEST(CaseFile, ATableForEverySubTable) {
  const CaseFile file = parse(R"([wall.left]
height = "1 m"
[wall.floor]
height = "2 m"
rough = false
[bed]
height = "1 m"
[wall.a]
height = "3 m")",
                              {"wall.added.height=4 m", "wall.floor.rough=true"});
  EXPECT_NO_THROW(file.validate(wall_tables));
  EXPECT_EQ(file.subsections("wall"), (std::vector<std::string>{"left", "floor", "a", "added"}));
  EXPECT_TRUE(file.subsections("bed").empty());
  EXPECT_TRUE(file.subsections("none").empty());
  EXPECT_TRUE(file.has("wall.floor"));
  EXPECT_EQ(file.section(walls, "floor").quantity("height"), 2);
  EXPECT_TRUE(file.section(walls, "floor").flag("rough"));
  EXPECT_EQ(file.section(walls, "added").quantity("height"), 4);
  const Section left = file.section(walls, "left");
  EXPECT_EQ(message_of<UsageError>([&] { left.refuse("height", "too low"); }),
            "case.toml:2: [wall.left] too low");
  EXPECT_CONTAINS(left.text(), "[wall.left]\nheight = \"1 m\"\nrough = true  # default\n");

  // What is written out is the same case, with the sub-tables in the same order.
  const CaseFile again = CaseFile::parse(file.effective(), "effective.toml");
  EXPECT_NO_THROW(again.validate(wall_tables));
  EXPECT_EQ(again.subsections("wall"), file.subsections("wall"));
  for (const std::string& name : file.subsections("wall")) {
    EXPECT_EQ(again.section(walls, name).quantity("height"), file.section(walls, name).quantity("height"));
    EXPECT_TRUE(again.section(walls, name).given("rough"));
  }
}

TEST(CaseFile, SubTablesAreCheckedToo) {
  const std::vector<Mistake> mistakes{
      {"unknown key",
       "[wall.a]\nheight = \"1 m\"\nheigth = 1",
       {"case.toml:3: [wall.a] unknown key", "\"height\"?"}},
      {"missing key",
       "\n[wall.a]\nrough = true",
       {"case.toml:2: [wall.a] lacks the required key \"height\""}},
      {"bare number", "[wall.a]\nheight = 1", {"case.toml:2: [wall.a] \"height\" needs a unit"}},
      {"key without a name",
       "[wall]\nheight = \"1 m\"",
       {"case.toml:2: ", "the section [wall] has only sub-sections"}},
      {"sub-table of a sub-table",
       "[wall.a]\nheight = \"1 m\"\n[wall.a.b]\nheight = \"1 m\"",
       {"case.toml:3: unknown section [wall.a.b]"}},
      {"misspelt section", "[wal.a]\nheight = \"1 m\"", {"unknown section [wal]", "did you mean [wall]?"}},
      {"a name that is a path",
       "[wall.\"a.b\"]\nheight = \"1 m\"",
       {"case.toml:1: unknown section [wall.a.b]"}},
      {"the star itself", "[wall.\"*\"]\nheight = \"1 m\"", {"case.toml:1: unknown section [wall.*]"}},
  };
  for (const Mistake& m : mistakes) {
    SCOPED_TRACE(m.what);
    const std::string message = message_of<UsageError>([&] { parse(m.text).validate(wall_tables); });
    for (const char* fragment : m.fragments) EXPECT_CONTAINS(message, fragment);
  }
  EXPECT_THROW(parse("").section(walls), std::logic_error);
  EXPECT_THROW(parse("").section(bed, "a"), std::logic_error);
  EXPECT_CONTAINS(message_of<UsageError>([&] { parse("").section(walls, "a b"); }), "[wall.a b]: the name");
}

// ---- numbers that may have a unit

const ParameterTable scales{
    "scales",
    "Numbers with or without unit.",
    {{"rate", Kind::number_or_quantity, "1/s", 0.1, 100, "required", "A rate, or one over a reference."},
     {"bare", Kind::number_or_quantity, "1/s", 0, 100, "0.25", "Default without unit."},
     {"with_unit", Kind::number_or_quantity, "1/s", 0, 100, "2 1/min", "Default with unit."},
     {"open", Kind::number_or_quantity, "1/s", 0, 100, "unset", "No default."}}};

TEST(CaseFile, ANumberOrAQuantity) {
  for (const auto& [text, value, unit] :
       std::vector<std::tuple<std::string, double, bool>>{{"0.279", 0.279, false},
                                                          {"12", 12, false},
                                                          {"\"12 1/s\"", 12, true},
                                                          {"\"0.05 1/ms\"", 50, true}}) {
    SCOPED_TRACE(text);
    const CaseFile file = parse("[scales]\nrate = " + text);
    const Section s = file.section(scales);
    // Milliseconds to SI is one division, of an ulp.
    EXPECT_NEAR(s.number_or_quantity("rate"), value, 1e-15 * value);
    EXPECT_EQ(s.has_unit("rate"), unit);
    EXPECT_EQ(s.number_or_quantity("bare"), 0.25);
    EXPECT_FALSE(s.has_unit("bare"));
    EXPECT_NEAR(s.number_or_quantity("with_unit"), 2.0 / 60, 1e-17);
    EXPECT_TRUE(s.has_unit("with_unit"));
    EXPECT_TRUE(std::isnan(s.number_or_quantity("open")));
    EXPECT_FALSE(s.has_unit("open"));
    EXPECT_THROW(s.number("rate"), std::logic_error);
    const Section again = CaseFile::parse(file.effective(), "effective.toml").section(scales);
    EXPECT_EQ(again.number_or_quantity("rate"), s.number_or_quantity("rate"));
    EXPECT_EQ(again.has_unit("rate"), unit);
    EXPECT_TRUE(again.has_unit("with_unit"));
  }
  EXPECT_TRUE(parse("[scales]\nrate = 1", {"scales.rate=3 1/s"}).section(scales).has_unit("rate"));
  EXPECT_CONTAINS(describe(scales), "a number, or a quantity in quotes such as \"1 1/s\" in [0.1, 100] 1/s");
}

TEST(CaseFile, ANumberOrAQuantityIsChecked) {
  const std::vector<Mistake> mistakes{
      {"number below", "0.01", {"case.toml:2: [scales] \"rate\" = 0.01 is outside [0.1, 100]"}},
      {"quantity above", "\"1 1/ms\"", {"case.toml:2: [scales] \"rate\" = 1000 1/s is outside [0.1, 100]"}},
      {"wrong dimension", "\"1 m\"", {"\"rate\": ", "is m"}},
      {"text without unit", "\"12\"", {"\"rate\": ", "has no unit"}},
      {"flag", "true", {"\"rate\" must be a number, or a quantity in quotes"}},
      {"list", "[1]", {"\"rate\" must be a number, or a quantity in quotes"}},
      {"nan", "nan", {"must be a finite number"}},
  };
  for (const Mistake& m : mistakes) {
    SCOPED_TRACE(m.what);
    const std::string message =
        message_of<UsageError>([&] { parse(std::string("[scales]\nrate = ") + m.text).section(scales); });
    for (const char* fragment : m.fragments) EXPECT_CONTAINS(message, fragment);
  }
}

using CaseFileOnDisk = test::Scratch;

TEST_F(CaseFileOnDisk, FilesAreRelativeToTheCase) {
  test::put(in("case.toml"), "[bed]\nheight = \"1 m\"\nlaw = \"law.json\"");
  const CaseFile file = CaseFile::load(in("case.toml"));
  EXPECT_EQ(file.section(bed).file("law"), in("law.json"));
  EXPECT_EQ(file.path(), in("case.toml"));
  EXPECT_TRUE(file.has("bed"));
  EXPECT_FALSE(file.has("solver.step"));
}

TEST_F(CaseFileOnDisk, WhatCannotBeReadIsAnInputError) {
  EXPECT_CONTAINS(message_of<InputError>([&] { CaseFile::load(in("none.toml")); }), in("none.toml").string());
  EXPECT_CONTAINS(message_of<InputError>([&] { CaseFile::load(folder_); }), folder_.string());
}

}  // namespace
}  // namespace dem2sph
