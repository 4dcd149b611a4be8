#include "sph/base/frame.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstring>
#include <stdexcept>

#include "sph/base/errors.hpp"
#include "sph/base/hdf5_file.hpp"
#include "sph/base/provenance.hpp"

namespace dem2sph {

static_assert(std::endian::native == std::endian::little, "the .vtp header says LittleEndian");

namespace {
constexpr const char* format_name = "dem2sph-frame";
constexpr int schema_version = 1;

// A ragged frame would make a file that opens and shows the wrong particles.
void check_lengths(const Frame& frame) {
  if (frame.field("x").components != 3) throw std::logic_error("the field x must have three components");
  for (const FrameField& f : frame.fields)
    if (f.values.size() != frame.size() * f.components)
      throw std::logic_error("the field " + f.name + " has another length than x");
}

std::string escaped(const std::string& text) {
  std::string result;
  for (const char c : text)
    result += c == '&' ? "&amp;" : c == '<' ? "&lt;" : c == '"' ? "&quot;" : std::string(1, c);
  return result;
}
}  // namespace

bool Frame::has(const std::string& name) const {
  for (const FrameField& f : fields)
    if (f.name == name) return true;
  return false;
}

const FrameField& Frame::field(const std::string& name) const {
  for (const FrameField& f : fields)
    if (f.name == name) return f;
  std::string known;
  for (const FrameField& f : fields) known += (known.empty() ? "" : ", ") + f.name;
  throw InputError(fmt::format("the frame has no field \"{}\"; it has: {}", name, known));
}

std::size_t Frame::size() const { return field("x").values.size() / 3; }

void write_vtp(const Frame& frame, const std::filesystem::path& path) {
  check_lengths(frame);
  const std::size_t n = frame.size();
  std::string blocks;
  const auto append = [&](const void* data, std::size_t bytes) {
    const std::size_t offset = blocks.size();
    const std::uint64_t header = bytes;
    blocks.append(reinterpret_cast<const char*>(&header), sizeof header);
    blocks.append(static_cast<const char*>(data), bytes);
    return offset;
  };
  std::string arrays;
  for (const FrameField& f : frame.fields) {
    if (f.name == "x") continue;
    arrays += fmt::format(
        R"(        <DataArray type="Float64" Name="{}" NumberOfComponents="{}" format="appended" offset="{}"/>)"
        "\n",
        f.name, f.components, append(f.values.data(), f.values.size() * sizeof(double)));
  }
  const FrameField& x = frame.field("x");
  const std::size_t points = append(x.values.data(), x.values.size() * sizeof(double));
  std::vector<std::int64_t> connectivity(n);
  std::vector<std::int64_t> offsets(n);
  for (std::size_t i = 0; i < n; ++i) {
    connectivity[i] = static_cast<std::int64_t>(i);
    offsets[i] = static_cast<std::int64_t>(i + 1);
  }
  const std::size_t connectivity_at = append(connectivity.data(), n * sizeof(std::int64_t));
  const std::size_t offsets_at = append(offsets.data(), n * sizeof(std::int64_t));

  std::string text = fmt::format(
      R"(<?xml version="1.0"?>
<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <PolyData>
    <FieldData>
      <DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">{:.17g}</DataArray>
    </FieldData>
    <Piece NumberOfPoints="{}" NumberOfVerts="{}" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="0">
      <PointData>
{}      </PointData>
      <Points>
        <DataArray type="Float64" Name="Points" NumberOfComponents="3" format="appended" offset="{}"/>
      </Points>
      <Verts>
        <DataArray type="Int64" Name="connectivity" format="appended" offset="{}"/>
        <DataArray type="Int64" Name="offsets" format="appended" offset="{}"/>
      </Verts>
    </Piece>
  </PolyData>
  <AppendedData encoding="raw">
_)",
      frame.time, n, n, arrays, points, connectivity_at, offsets_at);
  text += blocks;
  text += "\n  </AppendedData>\n</VTKFile>\n";
  write_file_atomically(path, text);
}

std::vector<std::filesystem::path> frames_of(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> list;
  if (std::filesystem::exists(folder / "frames"))
    for (const auto& entry : std::filesystem::directory_iterator(folder / "frames"))
      if (entry.path().extension() == ".h5") list.push_back(entry.path());
  if (list.empty()) throw InputError(fmt::format("{}: holds no frames of a flow", folder.string()));
  std::sort(list.begin(), list.end());  // they are numbered
  return list;
}

void write_pvd(const std::vector<PvdEntry>& entries, const std::filesystem::path& path) {
  std::string text =
      "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n  <Collection>\n";
  for (const PvdEntry& e : entries)
    text += fmt::format("    <DataSet timestep=\"{:.17g}\" file=\"{}\"/>\n", e.time, escaped(e.file));
  text += "  </Collection>\n</VTKFile>\n";
  write_file_atomically(path, text);
}

void write_frame(const Frame& frame, const std::filesystem::path& path) {
  check_lengths(frame);
  Hdf5Writer file(path);
  file.attribute("/", "format", std::string(format_name));
  file.attribute("/", "schema_version", std::int64_t{schema_version});
  file.attribute("/", "time", frame.time);
  file.attribute("/", "step", std::int64_t{frame.step});
  file.attribute("/", "dimension", std::int64_t{frame.dimension});
  file.attribute("/", "provenance", provenance().dump());
  for (const FrameField& f : frame.fields)
    file.write(f.name, f.values, f.unit, f.components > 1 ? f.components : 0);
  file.commit();
}

Frame read_frame(const std::filesystem::path& path) {
  const Hdf5Reader file(path, format_name, schema_version);
  Frame frame;
  frame.time = file.number_attribute("/", "time");
  frame.step = file.integer_attribute("/", "step");
  frame.dimension = static_cast<int>(file.integer_attribute("/", "dimension"));
  for (const std::string& name : file.names("/")) {
    const std::vector<std::size_t> shape = file.shape(name);
    const std::string unit = file.unit(name);
    frame.fields.push_back({name, unit, shape.size() == 2 ? shape[1] : 1, file.doubles(name, unit)});
  }
  const auto refuse = [&](const std::string& what) {
    return InputError(fmt::format("{}: {}", path.string(), what));
  };
  if (frame.dimension != 2 && frame.dimension != 3)
    throw refuse(fmt::format("has the dimension {}, which must be 2 or 3", frame.dimension));
  if (!frame.has("x")) throw refuse("has no positions: the field \"x\" is missing");
  const std::size_t n = frame.size();
  for (const FrameField& f : frame.fields)
    if (f.values.size() != n * f.components)
      throw refuse(fmt::format("the field \"{}\" has another length than x", f.name));
  return frame;
}

}  // namespace dem2sph
