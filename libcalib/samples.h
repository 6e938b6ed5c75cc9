#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/directions.h"
#include "libbrdf/table.h"
#include "libcalib/calibration.h"
#include "libcalib/radiance_image.h"

namespace lacquer::calib {

struct SampleOptions {
  double min_cosine = 0.08715574274765817;  ///< cos 85 deg: neither light nor camera closer to the horizon than this
  double edge_px = 2.0;                      ///< pixels whose centre is closer than this to the silhouette are left out (blur, mixed pixels)
  /// Narrowest lobe that must come out right, RMS slope. Towards the silhouette the footprint of a pixel grows without bound and changes
  /// within itself; near the peak (theta_h < 3 sqrt(narrowest_m^2 + 2 v), v its larger variance) samples with v > narrowest_m^2 are left out.
  double narrowest_m = 0.013;
  void validate() const;
};

/// One pixel as a measurement of f_r.
struct Sample {
  brdf::HalfDiff coordinates;
  double value;     ///< f_r, 1/sr
  double variance;  ///< of value
  double weight;    ///< irradiance relative to the light's irradiance on axis, cosine included
  brdf::Footprint<double> footprint;  ///< of pixel, lens blur and emitter
  int channel;      ///< 0 R or Y, 1 G, 2 B
  bool clipped = false;  ///< in every exposure: `value` is a lower bound
};

/// Into its cell, as a value or as a bound.
void add_sample(brdf::TableAccumulator& accumulator, const Sample& sample);

struct SampleCounts {
  std::size_t used = 0;     ///< values
  std::size_t clipped = 0;  ///< bounds
  std::size_t invalid = 0, masked = 0, grazing = 0, blurred = 0;
  SampleCounts& operator+=(const SampleCounts& other);
};

/// How the surface point that a pixel sees changes from pixel to pixel, in x and in y: the images of two half-pixel steps.
struct PixelStep {
  glm::vec3 normal[2];  ///< change of the normal per pixel
  glm::vec3 wo[2];      ///< change of the direction to the camera per pixel
};

/// What lights a view.
struct Illumination {
  std::size_t light = 0;       ///< index into geometry.lights
  double turntable_angle = 0;  ///< radians
  double factor = 1;           ///< on the light's intensity: its drift
};
/// Of a view of a session, as `calibration` has followed its light.
Illumination illumination_of(const acquire::ViewRecord& view, const Calibration& calibration);

/// Of the lens towards its corners: 1 - vignetting * (rho / rho_corner)^2.
double lens_transmission(const Calibration& calibration, const glm::dvec2& pixel);

/// Precomputed per-pixel geometry of a session's fixed camera and sphere; one view at a time is turned into samples.
class Sampler {
 public:
  /// Throws Error{file} when the mask does not have the camera's size.
  Sampler(const Calibration& calibration, const acquire::MaskDescription& mask, acquire::PixelLayout layout, const SampleOptions& options);

  /// Called with consecutive pieces of a view's samples, in pixel order whatever the number of threads.
  using Sink = std::function<void(std::span<const Sample>)>;

  /// Samples of one view, computed in parallel, delivered in order. Clipped values are delivered as
  /// bounds, invalid ones only counted.
  SampleCounts sample_view(const RadianceImage& image, const Illumination& lighting, const Sink& sink) const;

  /// Radiance (linearised DN per second) that `paint`, seen through the footprint of each pixel, would give in each value of the image;
  /// 0 where sample_view would give no
  /// sample for geometric reasons, or `paint` says nothing. `used`: the geometry is usable and the paint defined.
  struct Prediction {
    std::vector<float> radiance;
    std::vector<bool> used;
  };
  Prediction predict_view(const brdf::Brdf& paint, const Illumination& lighting) const;

 private:
  struct Pixel {
    std::size_t index;  ///< y * width + x
    acquire::SurfacePoint point;
    double transmission;  ///< of the lens there: 1 - vignetting
    PixelStep step;
  };
  std::size_t n_masked_ = 0;
  Calibration calibration_;
  acquire::PixelLayout layout_;
  SampleOptions options_;
  std::vector<Pixel> pixels_;
};

/// Radiance images of a session's measurement views -> half-angle table, one image in memory at a time. Empty cells whose mirror image phi_d -> pi - phi_d
/// was measured take its value, flagged `symmetric`. Errors{file} from missing radiance images name the file.
struct Tabulation {
  brdf::HalfAngleTable table;
  SampleCounts counts;
};
Tabulation tabulate_session(const acquire::Session& session, const Calibration& calibration, const SampleOptions& options,
                            const Progress& progress);

}  // namespace lacquer::calib
