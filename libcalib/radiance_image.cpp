#include "libcalib/radiance_image.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"
#include "libcalib/mosaic_exr.h"

namespace lacquer::calib {

namespace {

constexpr MosaicExrKind kind{"lacquer.version", 1, "a radiance image of lacquer merge"};

/// Flags as OpenEXR's 32-bit unsigned integers.
std::vector<MosaicPlane> planes_of(RadianceImage& image, std::vector<unsigned>& flags) {
  return {{"", Imf::FLOAT, image.radiance.data()}, {".variance", Imf::FLOAT, image.variance.data()}, {".flag", Imf::UINT, flags.data()}};
}

void check_image(const RadianceImage& image) {
  const std::size_t n = static_cast<std::size_t>(std::max(image.width, 0)) * static_cast<std::size_t>(std::max(image.height, 0)) *
                        static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
  if (n == 0 || image.radiance.size() != n || image.variance.size() != n || image.flags.size() != n)
    throw Error(ErrorCode::input, fmt::format("radiance image: expected {} radiances, variances and flags, got {}, {} and {}", n,
                                              image.radiance.size(), image.variance.size(), image.flags.size()));
}

void check_values(const RadianceImage& image, const std::vector<unsigned>& flags, const MosaicExrReader& in) {
  for (std::size_t i = 0; i < flags.size(); ++i) {
    if (!std::isfinite(image.radiance[i])) in.fail_at(i, "radiance: expected a finite number");
    if (!std::isfinite(image.variance[i]) || image.variance[i] < 0) in.fail_at(i, "variance: expected a finite number >= 0");
    if (flags[i] > static_cast<unsigned>(PixelFlag::invalid)) in.fail_at(i, "flag: expected 0 to 3");
  }
}

}  // namespace

void write_radiance(const std::filesystem::path& file, const RadianceImage& image) {
  check_image(image);
  std::vector<unsigned> flags(image.flags.size());
  std::transform(image.flags.begin(), image.flags.end(), flags.begin(), [](PixelFlag f) { return static_cast<unsigned>(f); });
  write_mosaic_exr(file, kind, image.width, image.height, image.layout, planes_of(const_cast<RadianceImage&>(image), flags));  // only read
}

RadianceImage read_radiance(const std::filesystem::path& file) {
  RadianceImage image;
  reading_mosaic_exr(file, "a radiance image", [&] {
    MosaicExrReader in(file, kind);
    image.width = in.width();
    image.height = in.height();
    image.layout = in.layout();
    image.radiance.resize(in.n_values());
    image.variance.resize(in.n_values());
    std::vector<unsigned> flags(in.n_values());
    in.read(planes_of(image, flags));
    check_values(image, flags, in);
    image.flags.resize(flags.size());
    std::transform(flags.begin(), flags.end(), image.flags.begin(), [](unsigned f) { return static_cast<PixelFlag>(f); });
  });
  return image;
}

}  // namespace lacquer::calib
