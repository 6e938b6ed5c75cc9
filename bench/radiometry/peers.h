#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "bench/radiometry/stack.h"
#include "bench/radiometry/timing.h"

/// Other programs on the same 8-bit stack.
namespace lacquer::bench {

struct PeerResult {
  std::string name;
  std::string unavailable;                       ///< why there is no result; empty: there is one
  std::vector<float> radiance;                   ///< width * height * 3, R G B; any scale per channel
  std::array<std::vector<double>, 3> curve;      ///< exposure of each raw value, any scale; empty where the peer does not tell
  Timing response, merge;                        ///< in memory; unset for programs
  Timing whole;                                  ///< process with reading and writing of files; unset for libraries
};

/// CalibrateRobertson + MergeRobertson, CalibrateDebevec + MergeDebevec, as OpenCV documents them, all defaults. Frames must have 8 bits.
PeerResult run_opencv_robertson(const std::vector<acquire::RawFrame>& frames, int merge_repeats);
PeerResult run_opencv_debevec(const std::vector<acquire::RawFrame>& frames, int merge_repeats);

/// pfshdrcalibrate (pfstools) and luminance-hdr-cli as processes on files in `folder`.
std::vector<PeerResult> run_programs(const std::vector<acquire::RawFrame>& frames, const std::filesystem::path& folder);

/// "OpenCV 4.6.0", "pfstools 2.2.0-5", ...: what is installed.
std::vector<std::string> peer_versions();

}  // namespace lacquer::bench
