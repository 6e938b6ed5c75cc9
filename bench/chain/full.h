#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace lacquer::bench {

/// Bytes per second of a file of `bytes` that is written, dropped from the system's cache and read again.
struct DiskRate {
  double write = 0, read = 0;
};
DiskRate measure_disk(const std::filesystem::path& folder, std::size_t bytes);

/// The paper's plan at 16 bit from raw frames on disk to parameters, each stage a command of its own, as a user runs it.
struct FullRun {
  double raw_bytes = 0;
  double read_once_s = 0;  ///< all raw frames read once, not in the cache
  struct Stage {
    std::string name;
    double seconds = 0, peak_mb = 0;
  };
  std::vector<Stage> stages;
  double total_s = 0, mean_abs_log = 0;
};
/// Needs some 12 GB in `folder`. The frames are simulated first, which takes longer than all the rest; they stay in FOLDER/full for the
/// next run, which also goes on where one was interrupted.
FullRun run_full(const std::filesystem::path& folder, const std::filesystem::path& rig, const std::filesystem::path& paint);

}  // namespace lacquer::bench
