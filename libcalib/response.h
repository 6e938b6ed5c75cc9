#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "libacquire/frame.h"

namespace lacquer::calib {

/// Response of one channel: linear exposure of each raw value, i.e. exposure[v] is proportional to radiance * time that gives count v.
/// Strictly increasing. Gauge: exposure at mid-range (value 2^(bits-1)) equals that value minus the black level, so that a linear sensor
/// has exposure[v] = v - black.
struct ResponseCurve {
  std::vector<double> exposure;  ///< 2^bits entries
};

struct Response {
  int bits = 0;
  bool linear = true;                 ///< curves are v - black, exactly
  std::vector<ResponseCurve> curves;  ///< one per channel (1 or 3)
};

/// v - black_level for each value.
Response linear_response(int bits, int n_channels, double black_level_dn);

struct ResponseOptions {
  int max_iterations = 100;
  double tolerance = 1e-4;       ///< relative change of the curve that ends the iteration
  int max_pixels = 200000;       ///< spread over the image; more do not sharpen the curve noticeably
  double black_level_dn = 0;
  int ignore_border_px = 0;
};

struct ResponseEstimate {
  Response response;
  int iterations = 0;
  bool converged = false;
  double residual_rms = 0;  ///< of log exposure, weighted
};

/// Maximum-likelihood response of Robertson, Borman, Stevenson 2003 from one or more brackets (same bits and layout in all).
/// `brackets[b]` are frames of one static scene at different exposures. Throws Error{input} when no two exposures differ.
ResponseEstimate estimate_response(std::span<const std::vector<acquire::RawFrame>> brackets, const ResponseOptions& options = {});

}  // namespace lacquer::calib
