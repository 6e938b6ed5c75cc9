#pragma once

#include <optional>
#include <string>
#include <vector>

#include "libacquire/session.h"
#include "libcalib/calibration.h"
#include "libcalib/drift.h"

namespace lacquer::calib {

/// Follows the lights of a session through its merged views: by its reference views, or by the patch that the rig file names.
class LightFollower {
 public:
  /// Memory: of references one image's usable values per light, of a patch its own.
  explicit LightFollower(const acquire::RigDescription& rig);

  /// Views in the order in which they were taken; those that say nothing about the lights are skipped.
  void add(const acquire::ViewRecord& view, const RadianceImage& image);
  /// Sets light_drift and drift_source. A light that cannot be followed (nothing of it is bright enough, no times) is left alone, and
  /// drift_source says why: a session that took hours is not thrown away for that.
  void finish(Calibration& calibration) const;

 private:
  struct Light {
    std::optional<IntensityComparison> comparison;
    std::vector<DriftPoint> points;
    std::string failure;
  };
  void follow(Light& light, const acquire::ViewRecord& view, const RadianceImage& image) const;

  bool by_references_ = false;
  std::optional<PixelRectangle> patch_;
  std::vector<Light> lights_;
};

/// Relative standard error that the lights leave in the scale of the whole session, of two parts. Following them: the mean over the
/// measurement views of the standard error of their light's factor, an upper bound, reached where the errors of all views are the same
/// one; they mostly are, since the factors come from few points. Flicker that was seen but not followed: each view has its own, so that
/// the mean over n views has 1 / sqrt(n) of it. Neither shrinks with the number of pixels; they are no part of the pixels' variance.
double drift_scale_sigma(const acquire::Session& session, const Calibration& calibration);

}  // namespace lacquer::calib
