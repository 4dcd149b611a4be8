#include "sph/base/hdf5_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <hdf5.h>
#include <unistd.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "sph/base/errors.hpp"

namespace dem2sph {
namespace {

static_assert(sizeof(hid_t) == sizeof(std::int64_t));

// Closes an HDF5 object of any kind.
class Handle {
 public:
  explicit Handle(hid_t id) : id_(id) {}
  ~Handle() {
    if (id_ >= 0) H5Idec_ref(id_);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  hid_t get() const { return id_; }
  bool ok() const { return id_ >= 0; }

 private:
  hid_t id_;
};

// HDF5 prints its error stack by default; we put the deepest reason into the message instead.
void silence() { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

std::string reason() {
  std::string text = "unknown reason";
  H5Ewalk2(
      H5E_DEFAULT, H5E_WALK_UPWARD,
      [](unsigned depth, const H5E_error2_t* error, void* data) -> herr_t {
        if (depth == 0 && error->desc != nullptr) *static_cast<std::string*>(data) = error->desc;
        return 0;
      },
      &text);
  return text;
}

void check(bool ok, const std::filesystem::path& path, const std::string& what) {
  if (!ok) throw Error(ExitCode::bug, fmt::format("{}: {}: {}", path.string(), what, reason()));
}

hid_t string_type() {
  const hid_t type = H5Tcopy(H5T_C_S1);
  H5Tset_size(type, H5T_VARIABLE);
  H5Tset_cset(type, H5T_CSET_UTF8);
  return type;
}

void put_text(hid_t object, const std::string& key, const std::string& value,
              const std::filesystem::path& path) {
  const Handle type(string_type());
  const Handle space(H5Screate(H5S_SCALAR));
  const Handle attribute(H5Acreate2(object, key.c_str(), type.get(), space.get(), H5P_DEFAULT, H5P_DEFAULT));
  const char* text = value.c_str();
  check(attribute.ok() && H5Awrite(attribute.get(), type.get(), &text) >= 0, path, "attribute " + key);
}

void put_number(hid_t object, const std::string& key, hid_t type, const void* value,
                const std::filesystem::path& path) {
  const Handle space(H5Screate(H5S_SCALAR));
  const Handle attribute(H5Acreate2(object, key.c_str(), type, space.get(), H5P_DEFAULT, H5P_DEFAULT));
  check(attribute.ok() && H5Awrite(attribute.get(), type, value) >= 0, path, "attribute " + key);
}

hid_t create_dataset(hid_t file, const std::string& name, hid_t type, std::size_t count,
                     std::size_t columns) {
  const Handle links(H5Pcreate(H5P_LINK_CREATE));
  H5Pset_create_intermediate_group(links.get(), 1);
  const hsize_t rows = columns > 0 ? count / columns : count;
  const hsize_t sizes[2] = {rows, columns};
  const Handle space(H5Screate_simple(columns > 0 ? 2 : 1, sizes, nullptr));
  return H5Dcreate2(file, name.c_str(), type, space.get(), links.get(), H5P_DEFAULT, H5P_DEFAULT);
}

// An attribute of another file may hold a list, which would not fit where one value is read to.
bool is_scalar(hid_t attribute) {
  const Handle space(H5Aget_space(attribute));
  return space.ok() && H5Sget_simple_extent_npoints(space.get()) == 1;
}

// The object `name`, made as a group if it is not there yet.
hid_t open_or_make(hid_t file, const std::string& name) {
  if (name == "/") return H5Gopen2(file, "/", H5P_DEFAULT);
  const hid_t object = H5Oopen(file, name.c_str(), H5P_DEFAULT);
  if (object >= 0) return object;
  const Handle links(H5Pcreate(H5P_LINK_CREATE));
  H5Pset_create_intermediate_group(links.get(), 1);
  return H5Gcreate2(file, name.c_str(), links.get(), H5P_DEFAULT, H5P_DEFAULT);
}

// "dem2sph seal " + 32 hexadecimal digits of XXH3 + newline.
constexpr std::string_view seal_word = "dem2sph seal ";
constexpr std::size_t seal_size = seal_word.size() + 32 + 1;

struct Sealed {
  std::uintmax_t content = 0;       // bytes before the seal
  std::string expected;             // seal that the content should have
  std::optional<std::string> seal;  // that is there
};

// Reads the whole file once. Nothing if it cannot be read.
std::optional<Sealed> inspect(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::error_code unreadable;
  const std::uintmax_t size = std::filesystem::file_size(path, unreadable);
  if (!in || unreadable) return std::nullopt;
  Sealed result;
  result.content = size;
  if (size >= seal_size) {
    std::string end(seal_size, '\0');
    in.seekg(static_cast<std::streamoff>(size - seal_size));
    if (!in.read(end.data(), static_cast<std::streamsize>(seal_size))) return std::nullopt;
    if (end.starts_with(seal_word) && end.back() == '\n') {
      result.seal = end;
      result.content = size - seal_size;
    }
    in.seekg(0);
  }
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(), XXH3_freeState);
  if (!state || XXH3_128bits_reset(state.get()) != XXH_OK) return std::nullopt;
  std::vector<char> part(1 << 20);
  for (std::uintmax_t left = result.content; left > 0;) {
    const auto bytes = static_cast<std::size_t>(std::min<std::uintmax_t>(left, part.size()));
    if (!in.read(part.data(), static_cast<std::streamsize>(bytes))) return std::nullopt;
    XXH3_128bits_update(state.get(), part.data(), bytes);
    left -= bytes;
  }
  const XXH128_hash_t hash = XXH3_128bits_digest(state.get());
  result.expected = fmt::format("{}{:016x}{:016x}\n", seal_word, hash.high64, hash.low64);
  return result;
}

// Equal without telling where they differ: nobody shall find the right one by trying.
bool same(std::string_view a, std::string_view b) {
  unsigned difference = a.size() == b.size() ? 0 : 1;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i)
    difference |= static_cast<unsigned char>(a[i]) ^ static_cast<unsigned char>(b[i]);
  return difference == 0;
}

}  // namespace

void seal_hdf5(const std::filesystem::path& path) {
  const std::optional<Sealed> file = inspect(path);
  const auto fail = [&] { throw InputError(fmt::format("{}: cannot read it to seal it", path.string())); };
  if (!file) fail();
  std::error_code error;
  if (file->seal) std::filesystem::resize_file(path, file->content, error);
  std::ofstream out(path, std::ios::binary | std::ios::app);
  out << file->expected;
  out.close();
  if (error || !out) throw InputError(fmt::format("{}: cannot write its seal", path.string()));
}

Hdf5Writer::Hdf5Writer(std::filesystem::path path)
    : path_(std::move(path)), temporary_(path_.string() + ".tmp") {
  silence();
  file_ = H5Fcreate(temporary_.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  check(file_ >= 0, temporary_, "cannot create");
}

Hdf5Writer::~Hdf5Writer() {
  if (file_ < 0) return;
  H5Fclose(file_);
  std::error_code ignored;  // the destructor of an abandoned file: there is nobody to tell
  std::filesystem::remove(temporary_, ignored);
}

void Hdf5Writer::write(const std::string& name, std::span<const double> values, const std::string& unit,
                       std::size_t columns) {
  if (unit.empty()) throw std::logic_error("dataset " + name + " has no unit");
  if (columns > 0 && values.size() % columns != 0) throw std::logic_error("dataset " + name + " is ragged");
  const Handle set(create_dataset(file_, name, H5T_IEEE_F64LE, values.size(), columns));
  check(set.ok(), path_, "dataset " + name);
  if (!values.empty())
    check(H5Dwrite(set.get(), H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) >= 0, path_,
          "dataset " + name);
  put_text(set.get(), "unit", unit, path_);
}

void Hdf5Writer::write(const std::string& name, std::span<const std::int64_t> values,
                       const std::string& unit) {
  if (unit.empty()) throw std::logic_error("dataset " + name + " has no unit");
  const Handle set(create_dataset(file_, name, H5T_STD_I64LE, values.size(), 0));
  check(set.ok(), path_, "dataset " + name);
  if (!values.empty())
    check(H5Dwrite(set.get(), H5T_NATIVE_INT64, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) >= 0, path_,
          "dataset " + name);
  put_text(set.get(), "unit", unit, path_);
}

void Hdf5Writer::write(const std::string& name, std::span<const std::string> values) {
  const Handle type(string_type());
  const Handle set(create_dataset(file_, name, type.get(), values.size(), 0));
  check(set.ok(), path_, "dataset " + name);
  std::vector<const char*> pointers;
  for (const std::string& value : values) pointers.push_back(value.c_str());
  if (!values.empty())
    check(H5Dwrite(set.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, pointers.data()) >= 0, path_,
          "dataset " + name);
}

void Hdf5Writer::attribute(const std::string& name, const std::string& key, const std::string& value) {
  const Handle object(open_or_make(file_, name));
  check(object.ok(), path_, "group " + name);
  put_text(object.get(), key, value, path_);
}
void Hdf5Writer::attribute(const std::string& name, const std::string& key, double value) {
  const Handle object(open_or_make(file_, name));
  check(object.ok(), path_, "group " + name);
  put_number(object.get(), key, H5T_NATIVE_DOUBLE, &value, path_);
}
void Hdf5Writer::attribute(const std::string& name, const std::string& key, std::int64_t value) {
  const Handle object(open_or_make(file_, name));
  check(object.ok(), path_, "group " + name);
  put_number(object.get(), key, H5T_NATIVE_INT64, &value, path_);
}

void Hdf5Writer::commit() {
  attribute("/", "complete", std::int64_t{1});
  check(H5Fflush(file_, H5F_SCOPE_GLOBAL) >= 0, temporary_, "cannot flush");
  check(H5Fclose(std::exchange(file_, -1)) >= 0, temporary_, "cannot close");
  try {
    seal_hdf5(temporary_);
  } catch (const InputError& error) {  // a disk that refuses is no fault of an input
    std::error_code ignored;
    std::filesystem::remove(temporary_, ignored);
    throw Error(ExitCode::bug, error.what());
  }
  const int descriptor = ::open(temporary_.c_str(), O_RDONLY | O_CLOEXEC);
  const bool flushed = descriptor >= 0 && ::fsync(descriptor) == 0;
  if (descriptor >= 0) ::close(descriptor);
  std::error_code error;
  if (flushed) std::filesystem::rename(temporary_, path_, error);
  if (flushed && !error) return;
  std::error_code ignored;  // the first failure is the one to tell
  std::filesystem::remove(temporary_, ignored);
  throw Error(ExitCode::bug,
              fmt::format("{}: {}", path_.string(),
                          flushed ? "cannot rename into place: " + error.message() : "cannot flush to disk"));
}

Hdf5Reader::Hdf5Reader(std::filesystem::path path, const std::string& format, std::int64_t version)
    : path_(std::move(path)) {
  silence();
  std::error_code ignored;  // what cannot be looked at is not there for us
  if (!std::filesystem::exists(path_, ignored)) fail("no such file");
  const std::optional<Sealed> sealed = inspect(path_);
  if (!sealed || !sealed->seal)
    fail(
        "not a complete HDF5 file of this program: its last line, a checksum, is not there. If another "
        "program made "
        "or changed it, and it is to be trusted: dem2sph seal " +
        path_.string());
  if (!same(*sealed->seal, sealed->expected))
    fail(
        "is damaged: its content is not that of the checksum in its last line. If another program changed "
        "it, and it "
        "is to be trusted: dem2sph seal " +
        path_.string());
  file_ = H5Fopen(path_.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  if (file_ < 0) fail("not a complete HDF5 file (" + reason() + ")");
  try {
    const std::string found = text_attribute("/", "format");
    if (found != format) fail(fmt::format("holds \"{}\", but \"{}\" is needed", found, format));
    const std::int64_t found_version = integer_attribute("/", "schema_version");
    if (found_version != version)
      fail(fmt::format("has schema version {}, this program reads version {}", found_version, version));
    if (H5Aexists(file_, "complete") <= 0 || integer_attribute("/", "complete") != 1)
      fail("was not written to its end");
  } catch (...) {
    H5Fclose(file_);
    throw;
  }
}

Hdf5Reader::~Hdf5Reader() { H5Fclose(file_); }

void Hdf5Reader::fail(const std::string& what) const {
  throw InputError(fmt::format("{}: {}", path_.string(), what));
}

bool Hdf5Reader::has(const std::string& name) const {
  // H5Lexists wants every parent to exist.
  for (std::size_t slash = name.find('/'); slash != std::string::npos; slash = name.find('/', slash + 1))
    if (slash > 0 && H5Lexists(file_, name.substr(0, slash).c_str(), H5P_DEFAULT) <= 0) return false;
  return H5Lexists(file_, name.c_str(), H5P_DEFAULT) > 0;
}

std::vector<std::string> Hdf5Reader::names(const std::string& group) const {
  std::vector<std::string> result;
  if (group != "/" && !has(group)) return result;
  const Handle object(H5Gopen2(file_, group.c_str(), H5P_DEFAULT));
  if (!object.ok()) fail("\"" + group + "\" is not a group");
  H5Literate(
      object.get(), H5_INDEX_NAME, H5_ITER_INC, nullptr,
      [](hid_t, const char* name, const H5L_info_t*, void* data) -> herr_t {
        static_cast<std::vector<std::string>*>(data)->emplace_back(name);
        return 0;
      },
      &result);
  std::sort(result.begin(), result.end());
  return result;
}

std::string Hdf5Reader::unit(const std::string& name) const { return text_attribute(name, "unit"); }

std::vector<std::size_t> Hdf5Reader::shape(const std::string& name) const {
  const Handle set(H5Dopen2(file_, name.c_str(), H5P_DEFAULT));
  if (!set.ok()) fail("lacks the dataset \"" + name + "\"");
  const Handle space(H5Dget_space(set.get()));
  const int rank = H5Sget_simple_extent_ndims(space.get());
  if (rank < 1 || rank > 2) fail("dataset \"" + name + "\" must have one or two dimensions");
  hsize_t sizes[2] = {0, 0};
  H5Sget_simple_extent_dims(space.get(), sizes, nullptr);
  // A damaged header may claim any size: it cannot exceed what the file holds.
  const hsize_t bytes = H5Dget_storage_size(set.get());
  const hsize_t rows = sizes[0];
  const hsize_t columns = rank == 2 ? sizes[1] : 1;
  if (rows > 0 && columns > 0 && (bytes > std::filesystem::file_size(path_) || rows > bytes / columns))
    fail("dataset \"" + name + "\" is damaged");
  std::vector<std::size_t> result(sizes, sizes + rank);
  return result;
}

std::vector<double> Hdf5Reader::doubles(const std::string& name, const std::string& expected_unit) const {
  std::size_t count = 1;
  for (const std::size_t size : shape(name)) count *= size;
  if (unit(name) != expected_unit)
    fail(fmt::format("dataset \"{}\" has the unit \"{}\", expected \"{}\"", name, unit(name), expected_unit));
  const Handle set(H5Dopen2(file_, name.c_str(), H5P_DEFAULT));
  const Handle type(H5Dget_type(set.get()));
  if (H5Tget_class(type.get()) != H5T_FLOAT) fail("dataset \"" + name + "\" does not hold real numbers");
  std::vector<double> values(count);
  if (count > 0 && H5Dread(set.get(), H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0)
    fail("dataset \"" + name + "\" cannot be read (" + reason() + ")");
  for (const double v : values)
    if (!std::isfinite(v)) fail("dataset \"" + name + "\" holds a value that is not a finite number");
  return values;
}

std::vector<std::int64_t> Hdf5Reader::integers(const std::string& name,
                                               const std::string& expected_unit) const {
  std::size_t count = 1;
  for (const std::size_t size : shape(name)) count *= size;
  if (unit(name) != expected_unit)
    fail(fmt::format("dataset \"{}\" has the unit \"{}\", expected \"{}\"", name, unit(name), expected_unit));
  const Handle set(H5Dopen2(file_, name.c_str(), H5P_DEFAULT));
  const Handle type(H5Dget_type(set.get()));
  if (H5Tget_class(type.get()) != H5T_INTEGER) fail("dataset \"" + name + "\" does not hold whole numbers");
  std::vector<std::int64_t> values(count);
  if (count > 0 && H5Dread(set.get(), H5T_NATIVE_INT64, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0)
    fail("dataset \"" + name + "\" cannot be read (" + reason() + ")");
  return values;
}

std::vector<std::string> Hdf5Reader::strings(const std::string& name) const {
  const std::vector<std::size_t> sizes = shape(name);
  if (sizes.size() != 1) fail("dataset \"" + name + "\" must be a list");
  const Handle set(H5Dopen2(file_, name.c_str(), H5P_DEFAULT));
  const Handle stored(H5Dget_type(set.get()));
  if (H5Tis_variable_str(stored.get()) <= 0) fail("dataset \"" + name + "\" does not hold text");
  const Handle type(string_type());
  std::vector<char*> pointers(sizes[0], nullptr);
  if (pointers.empty()) return {};
  if (H5Dread(set.get(), type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, pointers.data()) < 0)
    fail("dataset \"" + name + "\" cannot be read (" + reason() + ")");
  std::vector<std::string> values;
  for (const char* p : pointers) values.emplace_back(p != nullptr ? p : "");
  const Handle space(H5Dget_space(set.get()));
  H5Dvlen_reclaim(type.get(), space.get(), H5P_DEFAULT, pointers.data());
  return values;
}

std::string Hdf5Reader::text_attribute(const std::string& name, const std::string& key) const {
  const Handle object(H5Oopen(file_, name.c_str(), H5P_DEFAULT));
  if (!object.ok()) fail("lacks \"" + name + "\"");
  const Handle attribute(H5Aopen(object.get(), key.c_str(), H5P_DEFAULT));
  if (!attribute.ok()) fail(fmt::format("\"{}\" lacks the attribute \"{}\"", name, key));
  const Handle stored(H5Aget_type(attribute.get()));
  if (H5Tis_variable_str(stored.get()) <= 0)
    fail(fmt::format("attribute \"{}\" of \"{}\" is not text", key, name));
  const Handle type(string_type());
  char* text = nullptr;
  if (!is_scalar(attribute.get()) || H5Aread(attribute.get(), type.get(), &text) < 0 || text == nullptr)
    fail(fmt::format("attribute \"{}\" of \"{}\" cannot be read", key, name));
  std::string value = text;
  H5free_memory(text);
  return value;
}

double Hdf5Reader::number_attribute(const std::string& name, const std::string& key) const {
  const Handle object(H5Oopen(file_, name.c_str(), H5P_DEFAULT));
  if (!object.ok()) fail("lacks \"" + name + "\"");
  const Handle attribute(H5Aopen(object.get(), key.c_str(), H5P_DEFAULT));
  double value = 0;
  if (!attribute.ok() || !is_scalar(attribute.get()) ||
      H5Aread(attribute.get(), H5T_NATIVE_DOUBLE, &value) < 0)
    fail(fmt::format("\"{}\" lacks the number attribute \"{}\"", name, key));
  if (!std::isfinite(value))
    fail(fmt::format("attribute \"{}\" of \"{}\" is not a finite number", key, name));
  return value;
}

std::int64_t Hdf5Reader::integer_attribute(const std::string& name, const std::string& key) const {
  const Handle object(H5Oopen(file_, name.c_str(), H5P_DEFAULT));
  if (!object.ok()) fail("lacks \"" + name + "\"");
  const Handle attribute(H5Aopen(object.get(), key.c_str(), H5P_DEFAULT));
  std::int64_t value = 0;
  if (!attribute.ok() || !is_scalar(attribute.get()) ||
      H5Aread(attribute.get(), H5T_NATIVE_INT64, &value) < 0)
    fail(fmt::format("\"{}\" lacks the integer attribute \"{}\"", name, key));
  return value;
}

}  // namespace dem2sph
