#pragma once

#include <vector>

#include "libacquire/rig_geometry.h"
#include "libacquire/sim/sensor_model.h"

namespace lacquer::acquire::sim {

/// Weights of the discrete Gaussian kernel (Lindeberg 1990), index 0 = centre, one side: exp(-t) I_n(t) with t = sigma^2. Unlike a
/// sampled Gaussian its variance is exactly sigma^2 also for a sigma below one pixel. Cut where the rest is below 1e-7, then normalised.
std::vector<float> discrete_gaussian(double sigma);

/// Lens blur of `sigma` pixels (besides the pixel's own area). The scene beyond the border is taken to go on as it ends there.
void blur(RadianceImage& image, double sigma);

/// Veiling glare: each channel gains `fraction` of its mean everywhere.
void add_stray_light(RadianceImage& image, double fraction);

/// Falloff towards the corners: factor 1 - vignetting * (rho / rho_corner)^2, rho = distance from the principal point,
/// rho_corner = that of the farthest corner of the image (the outer corner of the pixel).
void vignette(RadianceImage& image, const CameraModel& camera, double vignetting);

}  // namespace lacquer::acquire::sim
