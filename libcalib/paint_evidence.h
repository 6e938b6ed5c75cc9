#pragma once

#include <cstddef>
#include <vector>

#include "libcalib/geometry_unknowns.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/paint_samples.h"
#include "libcalib/paint_track.h"

/// What the light on the paint says of the geometry: the same half and difference angles occur at many places of the sphere and in many
/// views, and wherever they do the paint is the same. docs/geometry.md has the equations.
namespace lacquer::calib {

/// How a view of the samples was lit.
struct PaintView {
  std::size_t light = 0;
  double turntable_angle = 0;   ///< radians, read back
  double factor = 1;            ///< on the light's intensity: its drift
};

struct PaintOptions {
  double lowest_theta_h = 0.12;  ///< radians: nearer to the peak nothing is used, it is the highlights' matter
  double min_cosine = 0.42;      ///< of light and camera: beyond it shadowing and masking change too fast for the splines
  double aim_rad = 0.0087;       ///< prior of a light's aim, where its intensity falls off the axis
  double falloff = 0.05;         ///< prior of the exponent of that, relative
  double vignetting = 0.005;     ///< prior of what the vignetting in the image's corner is wrong by
  double blur = 0;               ///< variance of lens blur, pixel's area and LED over that of a block's pixels
  double blur_sigma = 0; ///< prior of what `blur` is wrong by
  double glare = 0;            ///< stray light over the image's mean: taken out
  double glare_sigma = 2e-5;   ///< and what that is wrong by: a corner of the images is not known to better
  double angle_rad = 0;          ///< scatter of the turntable's angles, which all samples of a view share
  double light_scale = 0.1;      ///< prior of each further light's intensity against the first's
  void validate() const;
};

struct PaintEvidence {
  GeometryEvidence geometry;   ///< linear about `x`; empty: too few samples
  std::size_t n_samples = 0;
  double scatter = 0;   ///< of ln f about the paint of the fit, without the noise
  double view_sigma = 0;  ///< of the views' own factors, relative: a light that flickers
};

/// The paint is a PaintSpline that is fitted and eliminated, with the aim and fall-off of the lights and a rest of vignetting. Samples far
/// from the fit count less (Cauchy). The information is what the scatter between tiles of the views supports (sandwich), not what the
/// noise of single pixels would. A view's paint and its highlight share the error of the turntable's angle: with `tracks` both are in what is found.
PaintEvidence paint_evidence(const std::vector<PaintSample>& samples, const std::vector<PaintView>& views, const GeometryUnknowns& unknowns,
                             const std::vector<double>& x, const PaintOptions& options, const std::vector<PaintTrack>& tracks = {});

}  // namespace lacquer::calib
