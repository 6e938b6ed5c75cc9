#pragma once

#include <span>
#include <vector>

#include "libacquire/frame.h"
#include "libcalib/response.h"

namespace lacquer::calib {

struct BracketSamples;

/// Noise of one raw value. In DN^2 of the LINEARISED value z (exposure of the response curve, black and mean dark current subtracted):
///   variance = (read_noise_e^2 + dark_current_e_per_s * t + max(z, 0) * gain) / gain^2 + (relative_noise * z)^2 + slope^2 / 12
/// Read, dark and shot noise arise before the response curve, quantisation after it (slope = d exposure / d value, 1 if linear).
struct NoiseModel {
  double black_level_dn = 0;       ///< contained in the response curve (exposure = 0 there), not subtracted a second time
  double gain_e_per_dn = 1;        ///< electrons per linearised DN
  double read_noise_e = 2;         ///< RMS electrons
  double dark_current_e_per_s = 0; ///< its mean is subtracted, its shot noise counted
  double saturation_dn = 0;        ///< raw values >= this are clipped; 0: 2^bits - 1. Must lie below the noise of a full well.
  double relative_noise = 0;       ///< RMS fraction of the signal, independent in each frame (film grain, flicker); 0 for a good sensor

  /// Throws Error{input} naming the field that is not finite or out of range.
  void validate() const;
};

/// Lowest clipped raw value: noise.saturation_dn rounded up, or 2^bits - 1 where it is 0 or beyond the range.
int saturation_value(const NoiseModel& noise, int bits);

/// Noise of a camera that nobody measured, from the bracket itself: read, shot and relative noise that explain by how much pairs of
/// neighbouring exposures contradict each other at each signal level. The largest quarter of the differences at each level is left out,
/// so that moved edges, dust and scratches do not count. Black level and saturation are taken over from `known`; dark current is 0 (it
/// cannot be told from light here). From frames, saturation_dn is lowered below highest values that contradict the other exposures of
/// their pixels by more than twice the noise: the uppermost end of an estimated curve of film or of a processed photograph.
NoiseModel estimate_noise(std::span<const std::vector<acquire::RawFrame>> brackets, const Response& response, const NoiseModel& known);
NoiseModel estimate_noise(const BracketSamples& samples, const Response& response, const NoiseModel& known);

}  // namespace lacquer::calib
