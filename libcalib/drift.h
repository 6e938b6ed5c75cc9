#pragma once

#include <optional>
#include <string>
#include <vector>

#include "libcalib/radiance_image.h"

/// Intensity of a light over the time of a capture, followed by photographs of a scene that does not change: reference views (the first
/// view taken again and again) or a white patch that every view sees in the same light.
namespace lacquer::calib {

using acquire::PixelRectangle;

/// Light of one image relative to the first.
struct DriftPoint {
  double time_s = 0;     ///< since the start of the capture
  double intensity = 1;  ///< relative to the first image, whose intensity is 1
  double sigma = 0;      ///< of this image's own noise; the first one's is in the first point. Points are independent.
};

/// Compares images with the first one; keeps the values of that one which can be compared.
class IntensityComparison {
 public:
  /// `patch`: pixels to use; empty: all. Throws Error{input} where the patch leaves the image or no value is bright enough to compare.
  IntensityComparison(const RadianceImage& first, double time_s, std::optional<PixelRectangle> patch = {});

  DriftPoint first() const { return first_point_; }
  /// Ratio of sums over the values that are valid in both images and at least twenty sigmas bright in the first: unbiased, and for
  /// shot noise the most precise. Values that changed otherwise (a shadow, a moved highlight) count less from three sigmas of their
  /// difference on; where the differences scatter more than the variances say, sigma grows by as much. Throws Error{input} where the
  /// image has another size or layout, or shares no usable value with the first.
  DriftPoint compare(const RadianceImage& image, double time_s) const;

 private:
  /// Of the first image.
  struct Value {
    std::size_t index;
    float radiance, variance;
  };
  int width_, height_;
  acquire::PixelLayout layout_;
  std::vector<Value> values_;
  DriftPoint first_point_;
};

/// Intensity at one moment relative to that at the start, with its standard error.
struct DriftValue {
  double factor = 1, sigma = 0;
};

/// Intensity as a function of time.
struct LightDrift {
  /// none: no drift found, factor 1. linear: a + b t. warm_up: a + b exp(-t / T). smooth: local lines, Gaussian kernel of width T.
  /// per_view: each point is the factor of the view of its time.
  enum class Model { none, linear, warm_up, smooth, per_view };
  Model model = Model::none;
  double time_constant_s = 0;        ///< T of warm_up and smooth
  double light_noise = 0;            ///< RMS by which points scatter about the model beyond their sigma: flicker of the light, relative
  double start = 1, start_sigma = 0; ///< per_view: intensity at the start without the flicker of the first image, relative to that image
  std::vector<DriftPoint> points;    ///< ascending in time

  /// Intensity at a time relative to that at the first point, flicker aside: rig file and calibration state the intensity of the start.
  double factor(double time_s) const;
  /// Standard error of factor(); the flicker of a single view is not in it.
  double factor_sigma(double time_s) const;
};

std::string name_of(LightDrift::Model model);               ///< "none", "linear", "warm_up", "smooth", "per_view"
LightDrift::Model drift_model_from_name(const std::string& name);  ///< throws Error{input}

/// The simplest model that is not significantly worse than the next (F tests at 1 %; none, linear, warm_up, smooth in this order). The
/// scatter beyond the points' sigmas is found with each model (Paule and Mandel 1982), so that flicker is not taken for drift. With
/// fewer than five points nothing can be told from flicker: model none. Any order; times must differ.
LightDrift fit_drift(std::vector<DriftPoint> points);

/// Points of every view, from a patch: used as they are where they scatter more (1 %) than their sigmas allow, else model none. What they
/// are relative to, the start, comes from fit_drift of the first two hundred: a single image would bring its flicker into all of them.
LightDrift follow_each_view(std::vector<DriftPoint> points);

}  // namespace lacquer::calib
