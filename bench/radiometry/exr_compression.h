#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "bench/radiometry/timing.h"
#include "libcalib/radiance_image.h"

namespace lacquer::bench {

struct CompressionResult {
  std::string name;
  bool lossy;
  Timing write, read;
  double megabytes;
  double largest_change;  ///< of radiance, relative to its sigma
};

/// Writes and reads `image` as lacquer does (radiance, variance and flag per channel) with each of OpenEXR's compressions, on all cores,
/// through the page cache of the disk that `folder` is on.
std::vector<CompressionResult> measure_compressions(const calib::RadianceImage& image, const std::filesystem::path& folder, int repeats);

}  // namespace lacquer::bench
