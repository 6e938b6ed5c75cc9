#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "bench/radiometry/errors.h"
#include "bench/radiometry/peers.h"
#include "bench/radiometry/stack.h"
#include "bench/radiometry/timing.h"

namespace lacquer::bench {

struct CaseOptions {
  int merge_repeats = 7;
  int response_repeats = 7;
  std::size_t min_level_count = 5000;    ///< values in a decade: its standard deviation is then known to 1 %
  std::size_t min_response_count = 50;   ///< values at a level of the response
};

/// Lacquer on one stack, beside the reference.
struct CaseResult {
  std::string curve;
  int bits = 0;
  double reference_spread = 0;            ///< standard deviation of the reference's own standardised errors: 1 if stack and reference agree
  RadianceError reference, known, estimated;
  Timing response, noise, merge_known, merge;
  bool converged = false;
  ResponseError response_error;
  std::vector<LevelStatistics> levels_known, levels_estimated;
};

CaseResult run_case(const Stack& stack, const ReferenceImage& reference, const std::vector<std::uint8_t>& valid, const CaseOptions& options);

/// Another program's, or the plain loop's, result on a stack.
struct PeerCase {
  PeerResult result;  ///< without the pixels
  RadianceError error;
  ResponseError response_error;
};

/// The plain loop first, then OpenCV, then the programs, whose files go to `folder`. 8 bits.
std::vector<PeerCase> run_peers(const Stack& stack, const std::vector<std::uint8_t>& valid, const std::filesystem::path& folder,
                               const CaseOptions& options);

}  // namespace lacquer::bench
