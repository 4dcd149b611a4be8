// A frame: all particles at one time. The same for grains and for SPH particles, so that the same tools see
// both. Written as .vtp (for ParaView) and .h5 (for everything else), SI throughout.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace dem2sph {

/// One field: `components` numbers a particle, particle by particle.
struct FrameField {
  std::string name;  ///< x, v, rho, p, stress, gamma_dot, mu, phi, beta, id, kind
  std::string unit;
  std::size_t components = 1;
  std::vector<double> values;
};

struct Frame {
  double time = 0;  ///< [s]
  long step = 0;
  int dimension = 2;  ///< 2: plane strain in x[0], x[1] (up); the third coordinate is 0
  std::vector<FrameField> fields;

  /// Number of particles, from the field x (three components).
  std::size_t size() const;
  /// Throws InputError if the field is not there.
  const FrameField& field(const std::string& name) const;
  bool has(const std::string& name) const;
};

/// Raw appended VTK PolyData with UInt64 headers: what ParaView 5.11 reads without fail (truncated files
/// included).
void write_vtp(const Frame& frame, const std::filesystem::path& path);
/// One dataset a field with its unit; attributes time, step, dimension.
void write_frame(const Frame& frame, const std::filesystem::path& path);
/// Throws InputError for a file that is missing, truncated or no frame.
Frame read_frame(const std::filesystem::path& path);

/// The .h5 frames that a flow left in FOLDER/frames, in order of time. Throws InputError if there are none.
std::vector<std::filesystem::path> frames_of(const std::filesystem::path& folder);

/// Names a series of .vtp files with their times for ParaView; paths are relative to the .pvd file.
struct PvdEntry {
  double time;
  std::string file;
};
void write_pvd(const std::vector<PvdEntry>& entries, const std::filesystem::path& path);

}  // namespace dem2sph
