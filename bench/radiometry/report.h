#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "bench/markdown.h"
#include "bench/radiometry/cases.h"
#include "bench/radiometry/exr_compression.h"
#include "bench/radiometry/machine.h"
#include "bench/radiometry/memorial.h"
#include "bench/radiometry/weights.h"

namespace lacquer::bench {

struct Results {
  std::string command, date, revision;
  Machine machine;
  std::vector<std::string> versions;
  int width = 0, height = 0;
  std::vector<double> times;  ///< seconds
  MemoryLimits memory;
  std::vector<CaseResult> cases;  ///< the first is the one that the peers took part in
  std::vector<PeerCase> peers;
  std::optional<MemorialResult> memorial;
  std::vector<WeightLoss> weights;
  std::vector<CompressionResult> compressions;
};

std::vector<Table> tables_of(const Results& results);

/// What was asked for beside what was found. Timings are in `tables_of` only; `met` of a timing does not fail a smoke run.
struct Target {
  std::string what, asked, found;
  bool met, timing;
};

std::vector<Target> targets_of(const Results& results);

std::string as_json(const Results& results);

/// Error against time, all methods on the 8-bit stack.
std::string plot_script(const Results& results);

}  // namespace lacquer::bench
