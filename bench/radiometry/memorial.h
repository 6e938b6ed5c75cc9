#pragma once

#include <filesystem>
#include <optional>

#include "bench/radiometry/timing.h"

namespace lacquer::bench {

/// Agreement with memorial.hdr (Debevec and Malik 1997) in log2, each channel's mean difference removed.
struct Agreement {
  double correlation = 0;
  double percentile5 = 0, percentile95 = 0;  ///< of the difference, stops
};

struct MemorialResult {
  Agreement ours, opencv;
  Timing ours_s, opencv_s;  ///< response, noise and merge; Robertson's response and merge
  std::size_t n = 0;        ///< values compared: inside the frames' blue borders, positive in all three images
};

/// nullopt where `folder` (memorial00*.png, shutter_times.txt, memorial.hdr) is not there.
std::optional<MemorialResult> compare_memorial(const std::filesystem::path& folder);

}  // namespace lacquer::bench
