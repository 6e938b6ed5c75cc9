#pragma once

#include <array>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "libacquire/frame.h"

namespace lacquer::calib {

/// Response of one channel: linear exposure of each raw value, i.e. exposure[v] is proportional to radiance * time that gives count v.
/// Strictly increasing. Gauge: exposure at mid-range (value 2^(bits-1)) equals that value minus the black level, so that a linear sensor
/// has exposure[v] = v - black. The ratio of the channels (white balance) is therefore NOT found; it is part of the radiometric scale.
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
  int max_iterations = 40;
  double tolerance = 5e-4;       ///< relative change of the curve (root mean square over the data) that ends the iteration
  int max_pixels = 25000;        ///< per channel, spread over image and brightness; more do not sharpen the curve noticeably
  double black_level_dn = 0;     ///< exposure is 0 there
  double saturation_dn = 0;      ///< raw values >= this are clipped; 0: 2^bits - 1
  int ignore_border_px = 0;
  /// Prior that settles what exposures cannot: typical change of the curve's log-log slope per factor e of signal. A bracket whose
  /// exposures all have one ratio q fixes the curve only up to a factor that repeats with every q; the smoothest curve is taken.
  double slope_change = 0.3;
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

/// JSON {"version": 1, "provenance": ..., "gauge": text, "response": {as in calibration.json}}.
void write_response(const std::filesystem::path& file, const Response& response, const std::string& provenance_json = "{}");
Response read_response(const std::filesystem::path& file);

}  // namespace lacquer::calib
