#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "libacquire/rig_description.h"
#include "libbrdf/directions.h"
#include "libbrdf/table.h"
#include "libcalib/calibration.h"
#include "libcalib/radiance_image.h"

namespace lacquer::calib {

struct SampleOptions {
  double min_cosine = 0.08715574274765817;  ///< cos 85 deg: neither light nor camera closer to the horizon than this
  double edge_px = 2.0;                      ///< pixels whose centre is closer than this to the silhouette are left out (blur, mixed pixels)
  void validate() const;
};

/// One pixel as a measurement of f_r.
struct Sample {
  brdf::HalfDiff coordinates;
  double value;     ///< f_r, 1/sr
  double variance;  ///< of value
  double weight;    ///< irradiance relative to the light's irradiance on axis, cosine included
  int channel;      ///< 0 R or Y, 1 G, 2 B
};

struct SampleCounts {
  std::size_t used = 0, clipped = 0, invalid = 0, masked = 0, grazing = 0;
  SampleCounts& operator+=(const SampleCounts& other);
};

/// Precomputed per-pixel geometry of a session's fixed camera and sphere; one view at a time is turned into samples.
class Sampler {
 public:
  /// `mask`: width*height, 0 = not paint; empty: all.
  Sampler(const Calibration& calibration, const acquire::MaskDescription& mask, acquire::PixelLayout layout, const SampleOptions& options);
  ~Sampler();

  /// Samples of one view in pixel order (deterministic), appended to `samples` (cleared first).
  SampleCounts sample_view(const RadianceImage& image, int light, double turntable_angle, std::vector<Sample>& samples) const;

  /// Radiance (linearised DN/s) that `paint` would give in each value of the image, NaN-free; 0 where there is no usable sample.
  std::vector<float> predict_view(const brdf::Brdf& paint, int light, double turntable_angle) const;

 private:
  struct Pixel;
  const Calibration& calibration_;
  acquire::PixelLayout layout_;
  SampleOptions options_;
  std::vector<Pixel> pixels_;
};

}  // namespace lacquer::calib
