#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "libacquire/frame.h"
#include "libcalib/noise_model.h"
#include "libcalib/response.h"

/// Exposure times against the pixels: neighbouring frames whose ratio contradicts the listed times.
namespace lacquer::calib {

/// Of the frames of one bracket, in their order.
///
/// The pixels see ratios only. Gauge: the median frame's time is as listed. With an estimated curve a common exponent of all times is not
/// seen either (it is one of the curve, and the listed times are trusted for it). Times that are all wrong by a power law are therefore
/// never refused: with a curve nothing shows, with a known response fitted_s shows it, but no frame stands out.
struct ExposureTimes {
  std::vector<double> listed_s;
  std::vector<double> fitted_s;
  std::vector<double> sigma;              ///< relative, 1 sigma, of fitted_s; infinite for a frame that is clipped or dark (nearly) throughout
  /// Frames (from 0) whose times are more than 3 % off, significantly (5 sigma) and far beyond the scatter of the frames (6 times
  /// its robust standard deviation: where all are 5 % off, 5 % is no lie). Of two frames that contradict each other both.
  std::vector<std::size_t> false_frames;
};

/// From the estimate of a response, which fits the times along. `bracket`: which of those it was made from, `frames`: that bracket.
ExposureTimes exposure_times(std::span<const std::vector<acquire::RawFrame>> brackets, std::size_t bracket, const ResponseEstimate& estimate);

/// With a response that is known. Black level and saturation are taken from `known`. A bracket with nothing to compare (one frame, no
/// ratio between black and saturation) has no false frames.
ExposureTimes check_exposure_times(std::span<const acquire::RawFrame> frames, const Response& response, const NoiseModel& known);

/// Throws Error{input} when there are false frames: "list.csv: frame 5 (img_05.png): listed 1/15 s, the pixels say 0.128 s +- 0.001
/// (1.92 x); correct the list or use --fit-times". `source`: file or folder that lists the times; `names`: of the frames, or empty.
void refuse_false_times(const ExposureTimes& times, const std::string& source, std::span<const std::string> names);

/// Frames with fitted instead of listed times.
void use_fitted_times(const ExposureTimes& times, std::span<acquire::RawFrame> frames);

}  // namespace lacquer::calib
