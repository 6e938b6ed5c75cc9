#pragma once

#include <span>

#include "libacquire/frame.h"
#include "libcalib/radiance_image.h"
#include "libcalib/response.h"

namespace lacquer::calib {

/// Noise of one raw value: variance in DN^2 = (read_noise_e^2 + max(signal,0) * gain) / gain^2 + 1/12, see merge.cpp.
struct NoiseModel {
  double black_level_dn = 0;
  double gain_e_per_dn = 1;        ///< electrons per DN
  double read_noise_e = 2;         ///< RMS electrons
  double dark_current_e_per_s = 0; ///< its mean is subtracted, its shot noise counted
  double saturation_dn = 0;        ///< values >= this are clipped
};

/// Merges a bracket of one view into radiance with variance, weighting each exposure by the inverse of its predicted variance
/// (predicted from all exposures together, not from the noisy value itself, which would bias dark pixels low). The order of frames
/// does not matter. Clipped values never enter; a value clipped in all frames gets flag `clipped` and the largest lower bound.
/// Radiance unit: linearised DN per second. Throws Error{input} naming the frame whose size, layout or bits differ.
RadianceImage merge_bracket(std::span<const acquire::RawFrame> frames, const Response& response, const NoiseModel& noise);

}  // namespace lacquer::calib
