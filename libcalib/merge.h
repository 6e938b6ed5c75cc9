#pragma once

#include <span>

#include "libacquire/frame.h"
#include "libcalib/noise_model.h"
#include "libcalib/radiance_image.h"
#include "libcalib/response.h"

namespace lacquer::calib {

/// Merges a bracket of one view into radiance with variance, weighting each exposure by the inverse of its predicted variance
/// (predicted from all exposures together, not from the noisy value itself, which would bias dark pixels low).
/// - The order of frames does not matter (same bytes), nor does the number of threads.
/// - Clipped values never enter as values; one near the threshold enters as the lower bound that it is (censored likelihood, which
///   removes the bias of leaving out just the frames whose noise was positive).
/// - Clipped in all frames: flag `clipped`, radiance = largest lower bound, variance = that of a value at the threshold of that frame.
/// - Signal to noise of the merged value < 1: flag `dark`, value (possibly negative) and variance kept.
/// Radiance unit: linearised DN per second. Throws Error{input} naming the frame whose size, layout, bits, gain or exposure is wrong.
RadianceImage merge_bracket(std::span<const acquire::RawFrame> frames, const Response& response, const NoiseModel& noise);

}  // namespace lacquer::calib
