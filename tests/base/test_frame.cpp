// Frames: .h5 there and back, .vtp read back by a reader written here from the format's description, and by
// ParaView.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>
#include <map>
#include <regex>
#include <sstream>
#include <vector>

#include "sph/base/frame.hpp"
#include "sph/base/hdf5_file.hpp"
#include "sph/base/subprocess.hpp"
#include "tests/base/helpers.hpp"

namespace dem2sph {
namespace {

using test::message_of;

// Values without short decimal forms, so that any detour over text or float would show.
Frame example(std::size_t n, double time = 0.1 + 0.2) {
  Frame frame;
  frame.time = time;
  frame.step = 123456789012;
  frame.dimension = 2;
  FrameField x{"x", "m", 3, {}};
  FrameField p{"p", "Pa", 1, {}};
  FrameField stress{"stress", "Pa", 4, {}};
  for (std::size_t i = 0; i < n; ++i) {
    const double a = static_cast<double>(i) / 3;
    x.values.insert(x.values.end(), {a, -a * a, 0});
    p.values.push_back(1e5 * (a + time));
    stress.values.insert(stress.values.end(), {-a, -2 * a, -1.5 * a, 1e-300 * a});
  }
  frame.fields = {x, p, stress};
  return frame;
}

void expect_same(const std::vector<double>& a, const std::vector<double>& b) {
  ASSERT_EQ(a.size(), b.size());
  if (a.empty()) return;  // memcmp wants pointers even for nothing
  EXPECT_EQ(std::memcmp(a.data(), b.data(), a.size() * sizeof(double)), 0);
}

using FrameFiles = test::Scratch;

TEST_F(FrameFiles, Hdf5RoundTripIsExact) {
  for (const std::size_t n : {0u, 1u, 1000u}) {
    const Frame a = example(n);
    write_frame(a, in("frame.h5"));
    const Frame b = read_frame(in("frame.h5"));
    EXPECT_EQ(a.time, b.time);
    EXPECT_EQ(a.step, b.step);
    EXPECT_EQ(a.dimension, b.dimension);
    EXPECT_EQ(b.size(), n);
    ASSERT_EQ(a.fields.size(), b.fields.size());
    for (const FrameField& f : a.fields) {
      ASSERT_TRUE(b.has(f.name));
      EXPECT_EQ(f.unit, b.field(f.name).unit);
      EXPECT_EQ(f.components, b.field(f.name).components);
      expect_same(f.values, b.field(f.name).values);
    }
  }
  EXPECT_EQ(files(), 1u);
}

TEST_F(FrameFiles, AMissingFieldNamesThoseThatAreThere) {
  const Frame frame = example(2);
  EXPECT_FALSE(frame.has("phi"));
  EXPECT_CONTAINS(message_of<InputError>([&] { frame.field("phi"); }),
                  "no field \"phi\"; it has: x, p, stress");
}

TEST_F(FrameFiles, ARaggedFrameIsABug) {
  Frame frame = example(4);
  frame.fields[1].values.pop_back();
  EXPECT_THROW(write_vtp(frame, in("a.vtp")), std::logic_error);
  EXPECT_THROW(write_frame(frame, in("a.h5")), std::logic_error);
  frame = example(4);
  frame.fields[0].components = 2;
  EXPECT_THROW(write_vtp(frame, in("a.vtp")), std::logic_error);
  EXPECT_EQ(files(), 0u);
}

TEST_F(FrameFiles, WhatIsNoFrameIsRefused) {
  const auto refusal = [&] {
    const std::string message = message_of<InputError>([&] { read_frame(in("a.h5")); });
    EXPECT_CONTAINS(message, in("a.h5").string());
    return message;
  };
  EXPECT_CONTAINS(refusal(), "no such file");
  const auto write = [&](std::int64_t dimension, const std::vector<double>& x, const std::vector<double>& p) {
    Hdf5Writer file(in("a.h5"));
    file.attribute("/", "format", std::string("dem2sph-frame"));
    file.attribute("/", "schema_version", std::int64_t{1});
    file.attribute("/", "time", 1.0);
    file.attribute("/", "step", std::int64_t{1});
    file.attribute("/", "dimension", dimension);
    if (!x.empty()) file.write("x", x, "m", 3);
    file.write("p", p, "Pa");
    file.commit();
  };
  write(2, {1, 2, 3}, {1});
  EXPECT_EQ(read_frame(in("a.h5")).size(), 1u);
  write(2, {}, {1});
  EXPECT_CONTAINS(refusal(), "has no positions");
  write(2, {1, 2, 3}, {1, 2});
  EXPECT_CONTAINS(refusal(), "\"p\" has another length than x");
  write(7, {1, 2, 3}, {1});
  EXPECT_CONTAINS(refusal(), "dimension 7");
  write_frame(example(100), in("whole.h5"));
  const std::string whole = test::content_of(in("whole.h5"));
  test::put(in("a.h5"), whole.substr(0, whole.size() / 2));
  EXPECT_CONTAINS(refusal(), "not a complete HDF5 file");
}

// A reader of raw appended VTK XML, as far as these files go: array name -> bytes.
struct Vtp {
  std::string header;
  std::map<std::string, std::string> arrays;
  std::map<std::string, int> components;
};

Vtp read_vtp(const std::filesystem::path& path) {
  Vtp vtp;
  const std::string text = test::content_of(path);
  const std::string opening = "<AppendedData encoding=\"raw\">\n_";
  const std::size_t at = text.find(opening);
  EXPECT_NE(at, std::string::npos);
  if (at == std::string::npos) return vtp;
  vtp.header = text.substr(0, at);
  const std::string closing = "\n  </AppendedData>\n</VTKFile>\n";
  const std::size_t data = at + opening.size();
  EXPECT_TRUE(text.ends_with(closing));
  const std::size_t end = text.size() - closing.size();
  const std::regex array(
      R"re(<DataArray type="(\w+)" Name="(\w+)"(?: NumberOfComponents="(\d+)")? format="appended" offset="(\d+)"/>)re");
  std::size_t total = 0;
  for (std::sregex_iterator i(vtp.header.begin(), vtp.header.end(), array), none; i != none; ++i) {
    const std::string name = (*i)[2];
    EXPECT_EQ((*i)[1], name == "connectivity" || name == "offsets" ? "Int64" : "Float64");
    const std::size_t offset = data + std::stoul((*i)[4]);
    std::uint64_t bytes = 0;
    EXPECT_LE(offset + sizeof bytes, end);
    std::memcpy(&bytes, text.data() + offset, sizeof bytes);
    EXPECT_LE(offset + sizeof bytes + bytes, end);
    vtp.arrays[name] = text.substr(offset + sizeof bytes, bytes);
    vtp.components[name] = (*i)[3].matched ? std::stoi((*i)[3]) : 1;
    total += sizeof bytes + bytes;
  }
  EXPECT_EQ(total, end - data) << "the blocks do not fill the appended data";
  return vtp;
}

TEST_F(FrameFiles, VtpHoldsTheSameBits) {
  for (const std::size_t n : {0u, 1u, 257u}) {
    const Frame frame = example(n);
    write_vtp(frame, in("a.vtp"));
    const Vtp vtp = read_vtp(in("a.vtp"));
    EXPECT_CONTAINS(
        vtp.header,
        "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">");
    EXPECT_CONTAINS(vtp.header, fmt::format("<Piece NumberOfPoints=\"{}\" NumberOfVerts=\"{}\" ", n, n));
    EXPECT_CONTAINS(
        vtp.header,
        "Name=\"TimeValue\" NumberOfTuples=\"1\" format=\"ascii\">0.30000000000000004</DataArray>");
    const auto doubles = [&](const std::string& name) {
      const std::string& bytes = vtp.arrays.at(name);
      std::vector<double> values(bytes.size() / sizeof(double));
      if (!values.empty()) std::memcpy(values.data(), bytes.data(), bytes.size());
      return values;
    };
    expect_same(doubles("Points"), frame.field("x").values);
    expect_same(doubles("p"), frame.field("p").values);
    expect_same(doubles("stress"), frame.field("stress").values);
    EXPECT_EQ(vtp.components.at("stress"), 4);
    EXPECT_EQ(vtp.components.at("Points"), 3);
    EXPECT_FALSE(vtp.arrays.contains("x")) << "positions are the points, not an array as well";
    for (const auto& [name, first] :
         std::map<std::string, std::int64_t>{{"connectivity", 0}, {"offsets", 1}}) {
      const std::string& bytes = vtp.arrays.at(name);
      ASSERT_EQ(bytes.size(), n * sizeof(std::int64_t));
      for (std::size_t i = 0; i < n; ++i) {
        std::int64_t value = -1;
        std::memcpy(&value, bytes.data() + i * sizeof value, sizeof value);
        ASSERT_EQ(value, static_cast<std::int64_t>(i) + first);
      }
    }
  }
}

TEST_F(FrameFiles, PvdNamesFilesAndTimes) {
  write_pvd({{0, "frames/a.vtp"}, {0.1 + 0.2, "R&D \"<b>\".vtp"}}, in("series.pvd"));
  EXPECT_EQ(test::content_of(in("series.pvd")),
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n  <Collection>\n"
            "    <DataSet timestep=\"0\" file=\"frames/a.vtp\"/>\n"
            "    <DataSet timestep=\"0.30000000000000004\" file=\"R&amp;D &quot;&lt;b>&quot;.vtp\"/>\n"
            "  </Collection>\n</VTKFile>\n");
}

TEST_F(FrameFiles, ParaViewOpensTheSeries) {
  if (!program_exists("pvpython"))
    GTEST_SKIP() << "pvpython is not installed: packages paraview and python3-paraview";
  const std::vector<double> times{0, 0.1 + 0.2, 1e3 / 7};
  std::vector<PvdEntry> entries;
  std::filesystem::create_directory(in("frames"));
  for (std::size_t i = 0; i < times.size(); ++i) {
    const std::string file = fmt::format("frames/frame_{:06d}.vtp", i);
    write_vtp(example(5 + i, times[i]), in(file));
    entries.push_back({times[i], file});
  }
  write_pvd(entries, in("series.pvd"));
  SubprocessOptions options;
  options.output = in("log");
  options.time_limit = 100;
  const SubprocessResult result = run_subprocess(
      {"pvpython", DEM2SPH_SOURCE_FOLDER "/tests/base/read_series.py", in("series.pvd").string(), "p"},
      options);
  const std::string log = test::content_of(in("log"));
  SCOPED_TRACE(log);
  ASSERT_TRUE(result.ok());

  std::stringstream lines(log);
  std::size_t frame = 0;
  const auto rest = [](std::istream& in) {
    std::vector<double> values;
    for (double v = 0; in >> v;) values.push_back(v);
    return values;
  };
  for (std::string line; std::getline(lines, line);) {
    std::stringstream words(line);
    std::string kind;
    words >> kind;
    if (kind != "seen" && kind != "values" && kind != "points") continue;  // ParaView's own chatter
    if (kind == "seen") ++frame;
    ASSERT_TRUE(frame >= 1 && frame <= times.size());
    const Frame expected = example(4 + frame, times[frame - 1]);
    const double n = static_cast<double>(expected.size());
    // Python prints the shortest text that reads back the same: exact, time included.
    if (kind == "seen") expect_same(rest(words), {times[frame - 1], n, n, n, 3 * n});
    if (kind == "values") expect_same(rest(words), expected.field("p").values);
    if (kind == "points") {
      const std::vector<double> points = rest(words);
      ASSERT_EQ(points.size(), 3 * expected.size());
      for (std::size_t i = 0; i < points.size(); ++i)
        EXPECT_EQ(points[i], expected.field("x").values[i]);  // -0.0 == 0
    }
  }
  EXPECT_EQ(frame, times.size());
}

}  // namespace
}  // namespace dem2sph
