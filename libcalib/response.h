#pragma once

#include <filesystem>
#include <optional>
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
  /// 1 sigma of ln exposure in the gauge (0 at mid-range) at some ascending values, linear in between; both empty: not known, or exact.
  std::vector<double> band_value{}, band_log_sigma{};
};

struct Response {
  int bits = 0;
  bool linear = true;                 ///< curves are v - black, exactly
  std::vector<ResponseCurve> curves;  ///< one per channel (1 or 3)
};

/// v - black_level for each value.
Response linear_response(int bits, int n_channels, double black_level_dn);

struct ResponseOptions {
  int max_iterations = 40;       ///< with the times free, and again with the times as listed
  double tolerance = 5e-4;       ///< relative change of the curve (root mean square over the data) that ends the iteration
  int max_pixels = 40000;        ///< per channel, spread over image and brightness; the error falls with the root of it
  double black_level_dn = 0;     ///< exposure is 0 there
  double saturation_dn = 0;      ///< raw values >= this are clipped; 0: 2^bits - 1
  int ignore_border_px = 0;
  /// Prior that settles what exposures cannot: typical change of the curve's log-log slope per factor e of signal, where the curve does
  /// not bend more as a whole. A bracket whose exposures all have one ratio q fixes the curve only up to a factor that repeats with every
  /// q; the smoothest curve is taken. One exposure off the series would settle it.
  double slope_change = 0.1;
  /// Model only what is needed: a sensor whose curve the data cannot tell from a line gets a line (see LinearityTest). False: always a curve.
  bool recognise_linear = true;
  /// The curve for fitted times, to be merged with those; false: for the times as listed. ResponseEstimate has the fitted ones either way.
  bool fit_times = false;
};

/// Is exposure = v - black? Wald test of eight smooth deviations per channel, beside the black level and errors of the listed times.
struct LinearityTest {
  struct Channel {
    bool linear = false;
    double chi_square = 0;       ///< of the deviations, 8 degrees of freedom
    double p_value = 0;          ///< of a larger chi_square if the sensor is linear; curved below 1 % over all channels ...
    double deviation_rms = 0;    ///< ... and from 0.05 % on: RMS of ln(curve / line) over the levels that hold data, part of noise taken off
    double deviation_sigma = 0;  ///< that part: RMS deviation that noise alone gives
  };
  bool linear = false;           ///< all channels are
  std::vector<Channel> channels;
  double fitted_black_level_dn = 0, black_level_sigma_dn = 0;  ///< of the line that fits best, with 1 sigma; no meaning unless linear
  double black_level_dn = 0;     ///< of the response: as given, or fitted where the given one is contradicted
  bool black_level_contradicted = false;  ///< the given one is more than 4 sigma and 0.05 DN off: the line starts elsewhere
};

struct ResponseEstimate {
  Response response;
  std::optional<LinearityTest> linearity;  ///< set where ResponseOptions::recognise_linear
  int iterations = 0;
  bool converged = false;
  double residual_rms = 0;  ///< of log exposure, weighted
  /// ln(time as the pixels see it / listed time) of each frame, brackets one after another, median of each bracket 0; with 1 sigma (infinite, and
  /// correction 0, for a frame that is clipped or dark throughout). A common exponent of all times is not among them: with an unknown curve nothing can tell it from one of
  /// the curve, and the listed times are trusted for it.
  std::vector<double> log_time_correction, log_time_sigma;
};

/// Maximum-likelihood response of Robertson, Borman, Stevenson 2003 from one or more brackets (same bits and layout in all).
/// `brackets[b]` are frames of one static scene at different exposures; their order does not matter. A linear response has no band (it is
/// exact), a curve has one in ResponseCurve::band_log_sigma. Throws Error{input}: no two exposures differ; no pixel has two values between
/// black and saturation; values left-aligned (see left_aligned_bits).
ResponseEstimate estimate_response(std::span<const std::vector<acquire::RawFrame>> brackets, const ResponseOptions& options = {});

/// 1 sigma of ln exposure at a raw value, from the band; nullopt where the curve has none.
std::optional<double> log_sigma_at(const ResponseCurve& curve, double value);

/// JSON {"version": 1, "provenance": ..., "gauge": text, "response": {as in calibration.json}}.
/// A curve comes with its band: "band": {"value": [...], "log_sigma": [...]}, see ResponseCurve.
void write_response(const std::filesystem::path& file, const Response& response, const std::string& provenance_json = "{}");
Response read_response(const std::filesystem::path& file);

}  // namespace lacquer::calib
