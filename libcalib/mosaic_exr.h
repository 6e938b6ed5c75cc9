#pragma once

#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfPixelType.h>

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "libacquire/frame.h"

/// EXR files of planes in a mosaic's own geometry: channels R/G/B or Y, each plane with its suffix ("Y", "Y.variance"), uncompressed,
/// 32 bits a value; attributes "lacquer.layout" and a version. Internal to libcalib.
namespace lacquer::calib {

/// One plane in memory: width * height * values_per_pixel values of 32 bits, row-major, rgb interleaved.
struct MosaicPlane {
  std::string suffix;   ///< of the channel's name; empty: the channel itself
  Imf::PixelType type;  ///< FLOAT or UINT
  void* data;           ///< writers only read through it (OpenEXR takes no const pointers)
};

/// What the file says it is.
struct MosaicExrKind {
  const char* version_attribute;
  int version;
  const char* what;  ///< for messages: "a radiance image of lacquer merge"
};

/// Temporary name, then rename. `add_attributes` may be empty. Throws Error{file}.
void write_mosaic_exr(const std::filesystem::path& file, const MosaicExrKind& kind, int width, int height, acquire::PixelLayout layout,
                      const std::vector<MosaicPlane>& planes, const std::function<void(Imf::Header&)>& add_attributes = {});

/// A file whose header and size are checked before anything is allocated from them. Throws Error{file}.
class MosaicExrReader {
 public:
  MosaicExrReader(const std::filesystem::path& file, const MosaicExrKind& kind);

  int width() const { return width_; }
  int height() const { return height_; }
  acquire::PixelLayout layout() const { return layout_; }
  std::size_t n_values() const;
  const Imf::Header& header() const { return in_.header(); }
  /// The first channel has this plane.
  bool has(const std::string& suffix) const;
  /// Throws where a channel lacks one of the planes or has another type, or a line has not the length that the header claims.
  void read(const std::vector<MosaicPlane>& planes);
  /// Throws Error{file} "FILE: pixel (x, y): WHAT" for value number `index`.
  [[noreturn]] void fail_at(std::size_t index, const std::string& what) const;
  [[noreturn]] void fail(const std::string& what) const;

 private:
  void read_size();
  void check_channels();

  std::filesystem::path file_;
  MosaicExrKind kind_;
  Imf::InputFile in_;
  int width_ = 0, height_ = 0;
  acquire::PixelLayout layout_ = acquire::PixelLayout::mono;
};

/// Runs `read` with whatever a damaged file makes OpenEXR throw turned into Error{file} "FILE: expected WHAT (EXR): ...".
void reading_mosaic_exr(const std::filesystem::path& file, const std::string& what, const std::function<void()>& read);

}  // namespace lacquer::calib
