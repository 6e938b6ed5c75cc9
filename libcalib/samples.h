#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/directions.h"
#include "libbrdf/table.h"
#include "libbrdf/table_accumulator.h"
#include "libcalib/calibration.h"
#include "libcalib/geometry_moves.h"
#include "libcalib/radiance_image.h"
#include "libcalib/sample_kernel.h"

namespace lacquer::calib {

struct SampleOptions {
  /// cos 85 deg: neither light nor camera closer to the horizon than this; nor may a part of the emitter lie below it (penumbra).
  double min_cosine = 0.08715574274765817;
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

/// What lights a view.
struct Illumination {
  std::size_t light = 0;       ///< index into geometry.lights
  double turntable_angle = 0;  ///< radians
  double factor = 1;           ///< on the light's intensity: its drift
};
/// A view's image and its light.
struct LitImage {
  const RadianceImage* image;
  Illumination lighting;
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

  /// Called with consecutive pieces of a view's samples, in pixel order; of a mosaic one colour after the other.
  using Sink = std::function<void(std::span<const Sample>)>;

  /// Samples of one view, one after the other in double. Clipped values are delivered as bounds, invalid ones only counted.
  SampleCounts sample_view(const RadianceImage& image, const Illumination& lighting, const Sink& sink) const;

  /// The same samples straight into a table's cells, many times faster: the cells are those of sample_view, means agree to 1e-6 and do
  /// not depend on the number of threads: whoever computes, each channel's samples are added in the order of the pixels.
  SampleCounts accumulate_view(const RadianceImage& image, const Illumination& lighting, brdf::TableAccumulator& accumulator) const {
    const LitImage lit{&image, lighting};
    return accumulate_views({&lit, 1}, accumulator);
  }
  /// Of several views, `views_at_once` of them while each block of pixels is in the cache. What is added first depends on their order alone.
  SampleCounts accumulate_views(std::span<const LitImage> views, brdf::TableAccumulator& accumulator) const;
  static constexpr std::size_t views_at_once = 2;

  std::size_t n_pixels() const;  ///< on the sphere, neither masked nor too oblique: what each view is computed for

  /// Radiance (linearised DN per second) that `paint`, seen through the footprint of each pixel, would give in each value of the image;
  /// 0 where sample_view would give no
  /// sample for geometric reasons, or `paint` says nothing. `used`: the geometry is usable and the paint defined.
  struct Prediction {
    std::vector<float> radiance;
    std::vector<bool> used;
  };
  Prediction predict_view(const brdf::Brdf& paint, const Illumination& lighting) const;

 private:
  /// One view's light, and what is the same for all of its pixels.
  struct View {
    acquire::PlacedLight light;
    double reference;   ///< irradiance at the sphere's centre per intensity
    double min_cosine;  ///< of the light
  };
  /// A pixel as the light of a view meets it; unless `fate` is used or blurred the rest means nothing.
  struct Lit {
    PixelFate fate = PixelFate::grazing;
    brdf::Directions directions;
    brdf::HalfDiff coordinates;
    brdf::Footprint<double> footprint;
    glm::dvec3 irradiance;
    double weight;  ///< irradiance relative to the light's on axis
  };
  bool central() const { return calibration_.geometry.camera.projection == acquire::CameraModel::Projection::pinhole; }
  View view_of(const Illumination& lighting) const;
  acquire::SurfacePoint point(const SpherePixels& pixels, std::size_t i) const;
  Lit light(const View& view, const SpherePixels& pixels, std::size_t i) const;
  void check(const RadianceImage& image) const;
  SampleCounts accumulate_together(std::span<const LitImage> views, brdf::TableAccumulator& accumulator) const;
  KernelView kernel_view(const View& view) const;
  PixelFate resolve(const View& view, const SpherePixels& pixels, std::size_t i, SampleBlock& to, std::size_t at) const;

  std::size_t n_masked_ = 0;
  Calibration calibration_;
  acquire::PixelLayout layout_;
  SampleOptions options_;
  glm::dvec3 camera_;  ///< rig frame: centre of projection; orthographic: unit direction towards the camera
  /// Pixels that are computed at a time.
  struct Block {
    std::size_t part, first;
  };
  std::vector<Block> blocks_;  ///< of all parts as they follow each other in the image: its lines are still in the cache when the next colour reads them
  std::vector<SpherePixels> parts_;  ///< of a mosaic one for each colour, else a single one
};

/// Radiance images of a session's measurement views -> half-angle table, the next `views_at_once` images read while as many are tabulated. Empty
/// cells whose mirror image phi_d -> pi - phi_d was measured take its value, flagged `symmetric`. Errors{file} from missing radiance images name the file.
struct Tabulation {
  brdf::HalfAngleTable table;  ///< scale_sigma contains what the lights' distance is known to: twice its relative error, in all values alike
  SampleCounts counts;
  GeometrySigma geometry_sigma;  ///< 0: not known, the geometry was not estimated
};
Tabulation tabulate_session(const acquire::Session& session, const Calibration& calibration, const SampleOptions& options,
                            const Progress& progress);

}  // namespace lacquer::calib
