#pragma once

#include "libbrdf/cook_torrance.h"
#include "libbrdf/renderer_materials.h"

namespace lacquer::fit {

/// Parameters with which a renderer's material comes nearest to a model: least squares of ln(material / model), weighted by
/// cos(theta_i) cos(theta_o), over half-angle coordinates dense at the peak, both directions within 80 degrees of the normal; bounded
/// Levenberg-Marquardt from several starts, no random numbers. The model's lobes are ordered by falling m; where it has more than three the
/// narrowest are starts.
brdf::LuxCoreCarPaint refit_luxcore(const brdf::CookTorrance& model);
brdf::GltfClearcoat refit_gltf(const brdf::CookTorrance& model);
brdf::OpenPbr refit_open_pbr(const brdf::CookTorrance& model);

}  // namespace lacquer::fit
