// HDF5 files: what goes in comes out, and everything that is damaged, foreign or incomplete is an InputError
// with the file's name: never a crash, never a plausible number. Foreign files are made with HDF5's own C
// interface.
#include <gtest/gtest.h>
#include <hdf5.h>

#include <cmath>
#include <functional>
#include <limits>
#include <vector>

#include "sph/base/hdf5_file.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using test::message_of;

class Hdf5 : public test::Scratch {
 protected:
  void header(Hdf5Writer& file, const std::string& format = "test-format", std::int64_t version = 3) const {
    file.attribute("/", "format", format);
    file.attribute("/", "schema_version", version);
  }
  void write_example(const std::filesystem::path& path) const {
    Hdf5Writer file(path);
    header(file);
    file.write("steady/mu", std::vector<double>{0.1, -0.0, 1e-308, 5e-324, 1.7976931348623157e308}, "1");
    file.write("table", std::vector<double>{1, 2, 3, 4, 5, 6}, "m/s", 3);
    file.write("ids", std::vector<std::int64_t>{-1, std::numeric_limits<std::int64_t>::max()}, "1");
    file.write("runs", std::vector<std::string>{"a", "", "d\xc3\xa9j\xc3\xa0 vu", std::string(1000, 'x')});
    file.write("none", std::vector<double>{}, "Pa");
    file.write("no_text", std::vector<std::string>{});
    file.attribute("steady", "kind", std::string("shear cell"));
    file.attribute("steady", "I", 0.3);
    file.attribute("steady/mu", "seed", std::int64_t{42});
    file.commit();
  }
  // Opens a finished file with HDF5 itself and does something to it.
  void tamper(const std::filesystem::path& path, const std::function<void(hid_t)>& action) const {
    const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
    ASSERT_GE(file, 0);
    action(file);
    ASSERT_GE(H5Fclose(file), 0);
    seal_hdf5(path);
  }
  std::string refusal(const std::filesystem::path& path) const {
    const std::string message = message_of<InputError>([&] { Hdf5Reader(path, "test-format", 3); });
    EXPECT_CONTAINS(message, path.string());
    return message;
  }
};

TEST_F(Hdf5, RoundTrip) {
  write_example(in("a.h5"));
  EXPECT_EQ(files(), 1u);  // no .tmp beside it
  const Hdf5Reader file(in("a.h5"), "test-format", 3);
  EXPECT_EQ(file.doubles("steady/mu", "1"),
            (std::vector<double>{0.1, -0.0, 1e-308, 5e-324, 1.7976931348623157e308}));
  EXPECT_EQ(file.doubles("table", "m/s"), (std::vector<double>{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(file.shape("table"), (std::vector<std::size_t>{2, 3}));
  EXPECT_EQ(file.integers("ids", "1"),
            (std::vector<std::int64_t>{-1, std::numeric_limits<std::int64_t>::max()}));
  EXPECT_EQ(file.strings("runs"),
            (std::vector<std::string>{"a", "", "d\xc3\xa9j\xc3\xa0 vu", std::string(1000, 'x')}));
  EXPECT_TRUE(file.doubles("none", "Pa").empty());
  EXPECT_TRUE(file.strings("no_text").empty());
  EXPECT_EQ(file.unit("table"), "m/s");
  EXPECT_EQ(file.text_attribute("steady", "kind"), "shear cell");
  EXPECT_EQ(file.number_attribute("steady", "I"), 0.3);
  EXPECT_EQ(file.integer_attribute("steady/mu", "seed"), 42);
  EXPECT_EQ(file.names("/"), (std::vector<std::string>{"ids", "no_text", "none", "runs", "steady", "table"}));
  EXPECT_EQ(file.names("steady"), (std::vector<std::string>{"mu"}));
  EXPECT_TRUE(file.names("transients").empty());
  EXPECT_TRUE(file.has("steady/mu"));
  EXPECT_FALSE(file.has("steady/phi"));
  EXPECT_FALSE(file.has("no/such/group"));
}

TEST_F(Hdf5, AWriterWithoutUnitOrWithARaggedTableIsABug) {
  Hdf5Writer file(in("a.h5"));
  EXPECT_THROW(file.write("p", std::vector<double>{1}, ""), std::logic_error);
  EXPECT_THROW(file.write("n", std::vector<std::int64_t>{1}, ""), std::logic_error);
  EXPECT_THROW(file.write("x", std::vector<double>{1, 2, 3, 4}, "m", 3), std::logic_error);
  file.write("twice", std::vector<double>{1}, "m");
  EXPECT_CONTAINS(message_of<Error>([&] { file.write("twice", std::vector<double>{1}, "m"); }), "twice");
}

TEST_F(Hdf5, AnAbandonedWriterLeavesNothing) {
  test::put(in("a.h5"), "old");
  {
    Hdf5Writer file(in("a.h5"));
    file.write("p", std::vector<double>(1000, 1.0), "Pa");
  }
  EXPECT_EQ(files(), 1u);
  EXPECT_EQ(test::content_of(in("a.h5")), "old");
}

TEST_F(Hdf5, APlaceThatCannotBeWrittenIsAnErrorAndLeavesNothing) {
  EXPECT_CONTAINS(message_of<Error>([&] { Hdf5Writer(in("no/folder/a.h5")); }), "cannot create");
  std::filesystem::create_directories(in("a.h5/inside"));  // a folder of that name refuses the rename
  Hdf5Writer file(in("a.h5"));
  EXPECT_CONTAINS(message_of<Error>([&] { file.commit(); }), "cannot rename");
  EXPECT_EQ(files(), 1u);
}

TEST_F(Hdf5, EveryTruncationIsRefused) {
  write_example(in("a.h5"));
  const std::string whole = test::content_of(in("a.h5"));
  std::size_t tried = 0;
  for (std::size_t length = 0; length < whole.size();
       length += (length < 128 || length + 64 > whole.size()) ? 1 : 61) {
    test::put(in("cut.h5"), whole.substr(0, length));
    SCOPED_TRACE(length);
    EXPECT_CONTAINS(refusal(in("cut.h5")), "not a complete HDF5 file");
    ++tried;
  }
  EXPECT_GT(tried, 250u);
}

TEST_F(Hdf5, EveryFlippedBitIsSeen) {
  write_example(in("a.h5"));
  const std::string whole = test::content_of(in("a.h5"));
  for (std::size_t at = 0; at < whole.size(); at += at < 200 || at + 100 > whole.size() ? 1 : 37) {
    std::string bytes = whole;
    bytes[at] = static_cast<char>(bytes[at] ^ (1 << at % 8));
    test::put(in("bit.h5"), bytes);
    const std::string message = refusal(in("bit.h5"));
    EXPECT_TRUE(test::contains(message, "is damaged") || test::contains(message, "not a complete HDF5 file"))
        << at << ": " << message;
  }
}

TEST_F(Hdf5, AFileChangedByAnotherProgramIsTrustedOnceItIsSealed) {
  write_example(in("a.h5"));
  const hid_t file = H5Fopen(in("a.h5").c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  ASSERT_GE(file, 0) << "HDF5 itself does not mind the seal";
  ASSERT_GE(H5Adelete(file, "complete"), 0);
  ASSERT_GE(H5Fclose(file), 0);
  EXPECT_CONTAINS(refusal(in("a.h5")), "dem2sph seal");
  seal_hdf5(in("a.h5"));
  EXPECT_CONTAINS(refusal(in("a.h5")), "was not written to its end");
  const std::string once = test::content_of(in("a.h5"));
  seal_hdf5(in("a.h5"));
  EXPECT_EQ(test::content_of(in("a.h5")), once) << "a second seal changes nothing";
}

TEST_F(Hdf5, ForeignFilesAreRefused) {
  EXPECT_CONTAINS(refusal(in("none.h5")), "no such file");
  test::put(in("text.h5"), "this is not HDF5");
  EXPECT_CONTAINS(refusal(in("text.h5")), "not a complete HDF5 file");
  EXPECT_CONTAINS(refusal(folder_), "not a complete HDF5 file");
  {
    Hdf5Writer file(in("other.h5"));
    header(file, "other-format");
    file.commit();
  }
  EXPECT_CONTAINS(refusal(in("other.h5")), "holds \"other-format\", but \"test-format\" is needed");
  {
    Hdf5Writer file(in("newer.h5"));
    header(file, "test-format", 4);
    file.commit();
  }
  EXPECT_CONTAINS(refusal(in("newer.h5")), "has schema version 4, this program reads version 3");
  {
    Hdf5Writer file(in("bare.h5"));
    file.commit();
  }
  EXPECT_CONTAINS(refusal(in("bare.h5")), "lacks the attribute \"format\"");
}

TEST_F(Hdf5, AFileThatWasNotCompletedIsRefused) {
  write_example(in("a.h5"));
  tamper(in("a.h5"), [](hid_t file) { ASSERT_GE(H5Adelete(file, "complete"), 0); });
  EXPECT_CONTAINS(refusal(in("a.h5")), "was not written to its end");
  tamper(in("a.h5"), [](hid_t file) {
    const hid_t space = H5Screate(H5S_SCALAR);
    const hid_t attribute = H5Acreate2(file, "complete", H5T_NATIVE_INT, space, H5P_DEFAULT, H5P_DEFAULT);
    const int no = 0;
    ASSERT_GE(H5Awrite(attribute, H5T_NATIVE_INT, &no), 0);
    H5Aclose(attribute);
    H5Sclose(space);
  });
  EXPECT_CONTAINS(refusal(in("a.h5")), "was not written to its end");
}

TEST_F(Hdf5, WhatIsMissingOrOfAnotherKindIsNamed) {
  write_example(in("a.h5"));
  tamper(in("a.h5"), [](hid_t file) {
    // A dataset without unit, one of three dimensions, and an attribute that is a list.
    const hsize_t sizes[3] = {2, 2, 2};
    const hid_t list = H5Screate_simple(1, sizes, nullptr);
    const hid_t cube = H5Screate_simple(3, sizes, nullptr);
    const double values[8] = {1, 2, 3, 4, 5, 6, 7, 8};
    const hid_t a =
        H5Dcreate2(file, "unitless", H5T_NATIVE_DOUBLE, list, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    H5Dwrite(a, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values);
    const hid_t b = H5Dcreate2(file, "cube", H5T_NATIVE_DOUBLE, cube, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    H5Dwrite(b, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values);
    const hid_t unwritten =
        H5Dcreate2(file, "unwritten", H5T_NATIVE_DOUBLE, list, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    const hid_t many = H5Acreate2(file, "many", H5T_NATIVE_DOUBLE, cube, H5P_DEFAULT, H5P_DEFAULT);
    ASSERT_GE(H5Awrite(many, H5T_NATIVE_DOUBLE, values), 0);
    H5Aclose(many);
    H5Dclose(a);
    H5Dclose(b);
    H5Dclose(unwritten);
    H5Sclose(list);
    H5Sclose(cube);
  });
  const Hdf5Reader file(in("a.h5"), "test-format", 3);
  const auto says = [&](const char* fragment, const std::function<void()>& action) {
    SCOPED_TRACE(fragment);
    const std::string message = message_of<InputError>(action);
    EXPECT_CONTAINS(message, in("a.h5").string());
    EXPECT_CONTAINS(message, fragment);
  };
  says("lacks the dataset \"steady/phi\"", [&] { file.doubles("steady/phi", "1"); });
  says("has the unit \"m/s\", expected \"mm/s\"", [&] { file.doubles("table", "mm/s"); });
  says("has the unit \"1\", expected \"s\"", [&] { file.integers("ids", "s"); });
  says("\"unitless\" lacks the attribute \"unit\"", [&] { file.doubles("unitless", "1"); });
  says("one or two dimensions", [&] { file.doubles("cube", "1"); });
  says("is damaged", [&] { file.shape("unwritten"); });
  says("does not hold real numbers", [&] { file.doubles("ids", "1"); });
  says("does not hold whole numbers", [&] { file.integers("steady/mu", "1"); });
  says("does not hold text", [&] { file.strings("ids"); });
  says("must be a list", [&] { file.strings("table"); });
  says("lacks the dataset \"steady\"", [&] { file.doubles("steady", "1"); });
  says("\"table\" is not a group", [&] { file.names("table"); });
  says("lacks \"nothing\"", [&] { file.number_attribute("nothing", "I"); });
  says("lacks the attribute \"colour\"", [&] { file.text_attribute("steady", "colour"); });
  says("lacks the number attribute \"colour\"", [&] { file.number_attribute("steady", "colour"); });
  says("lacks the number attribute \"many\"", [&] { file.number_attribute("/", "many"); });
  says("lacks the integer attribute \"many\"", [&] { file.integer_attribute("/", "many"); });
  says("is not text", [&] { file.text_attribute("steady", "I"); });
  says("lacks the number attribute \"kind\"", [&] { file.number_attribute("steady", "kind"); });
}

TEST_F(Hdf5, WhatIsNotAFiniteNumberIsRefused) {
  {
    Hdf5Writer file(in("a.h5"));
    header(file);
    file.write("nan", std::vector<double>{1, std::nan("")}, "Pa");
    file.write("inf", std::vector<double>{std::numeric_limits<double>::infinity()}, "Pa");
    file.attribute("/", "time", std::nan(""));
    file.commit();
  }
  const Hdf5Reader file(in("a.h5"), "test-format", 3);
  EXPECT_CONTAINS(message_of<InputError>([&] { file.doubles("nan", "Pa"); }),
                  "\"nan\" holds a value that is not a finite");
  EXPECT_CONTAINS(message_of<InputError>([&] { file.doubles("inf", "Pa"); }),
                  "\"inf\" holds a value that is not a finite");
  EXPECT_CONTAINS(message_of<InputError>([&] { file.number_attribute("/", "time"); }), "not a finite number");
}

}  // namespace
}  // namespace dem2sph
