// HDF5 with three rules built in: every dataset has a unit, a file is either complete or not there, and a
// file that is read is the one that was written. A file is written beside its name as `.tmp`, closed, sealed,
// flushed and renamed; its last attribute is `complete = 1`. The seal is a line behind HDF5's own end, which
// HDF5 and every program with it ignore: a checksum of all before it. Without it a single flipped bit can
// crash the HDF5 library (1.10.8 follows pointers of a damaged heap).
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace dem2sph {

/// Writes one HDF5 file. Nothing appears at `path` unless commit() was reached.
/// Paths of datasets and groups are like "steady/mu"; groups are made as needed.
/// Every member throws Error(bug) with HDF5's own reason if the library refuses.
class Hdf5Writer {
 public:
  explicit Hdf5Writer(std::filesystem::path path);
  ~Hdf5Writer();
  Hdf5Writer(const Hdf5Writer&) = delete;
  Hdf5Writer& operator=(const Hdf5Writer&) = delete;

  /// `unit` may not be empty: a pure number has the unit "1". `columns` > 0 makes a table of that many
  /// columns.
  void write(const std::string& name, std::span<const double> values, const std::string& unit,
             std::size_t columns = 0);
  void write(const std::string& name, std::span<const std::int64_t> values, const std::string& unit);
  void write(const std::string& name, std::span<const std::string> values);
  /// Attributes of the dataset or group `name`; "/" is the file.
  void attribute(const std::string& name, const std::string& key, const std::string& value);
  void attribute(const std::string& name, const std::string& key, double value);
  void attribute(const std::string& name, const std::string& key, std::int64_t value);
  /// Closes, flushes to disk and renames.
  void commit();

 private:
  std::filesystem::path path_;
  std::filesystem::path temporary_;
  std::int64_t file_ = -1;
};

/// Ends the file with the checksum of its content, in the place of an older one: for a file that another
/// program has changed, or made. Throws InputError if it cannot be read or written.
void seal_hdf5(const std::filesystem::path& path);

/// Reads one HDF5 file. Throws InputError with the path for anything that is missing, truncated, of another
/// type or unit, or not a number where a finite number belongs.
class Hdf5Reader {
 public:
  /// `format` and `version` must equal the file's attributes `format` and `schema_version`.
  Hdf5Reader(std::filesystem::path path, const std::string& format, std::int64_t version);
  ~Hdf5Reader();
  Hdf5Reader(const Hdf5Reader&) = delete;
  Hdf5Reader& operator=(const Hdf5Reader&) = delete;

  bool has(const std::string& name) const;
  /// Names directly below a group, sorted. Empty if the group does not exist.
  std::vector<std::string> names(const std::string& group) const;
  std::vector<double> doubles(const std::string& name, const std::string& unit) const;
  std::vector<std::int64_t> integers(const std::string& name, const std::string& unit) const;
  std::vector<std::string> strings(const std::string& name) const;
  std::string unit(const std::string& name) const;
  /// Shape of a dataset.
  std::vector<std::size_t> shape(const std::string& name) const;
  std::string text_attribute(const std::string& name, const std::string& key) const;
  double number_attribute(const std::string& name, const std::string& key) const;
  std::int64_t integer_attribute(const std::string& name, const std::string& key) const;

 private:
  [[noreturn]] void fail(const std::string& what) const;
  std::filesystem::path path_;
  std::int64_t file_ = -1;
};

}  // namespace dem2sph
