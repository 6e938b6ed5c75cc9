#pragma once

#include <cstddef>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "libbrdf/directions.h"
#include "libcalib/paint_evidence.h"

/// What a sample of the paint sees at some geometry. Internal to paint_evidence.cpp.
namespace lacquer::calib {

/// A view at some geometry.
struct PaintScene {
  glm::dvec3 light, axis;  ///< rig frame; axis: unit, from the light towards where it is aimed
  double falloff = 0;
  double log_factor = 0;
};

/// Camera and sphere at some geometry.
struct PaintSphere {
  glm::dmat3 rig_from_cam;
  glm::dvec3 translation;  ///< of the sphere's centre, camera frame
  double radius;
};

struct SeenPaint {
  double log_irradiance;  ///< per intensity
  brdf::HalfDiff coordinates;
  glm::dvec3 wi;
  double cos_i, cos_o;
};

/// What a line of sight (camera frame, unit) meets; nullopt: it misses, or the light does not reach there.
std::optional<SeenPaint> see(const PaintSphere& sphere, const PaintScene& scene, const glm::dvec3& sight);

/// How scene and sphere move with an unknown, by unit of it.
struct PaintMotion {
  glm::dvec3 light, axis;
};

std::vector<PaintScene> scenes_of(const acquire::RigGeometry& geometry, double turntable_scale, const std::vector<PaintView>& views);

/// Columns beyond the geometry's: what else shapes the pattern of the light.
struct PaintNuisances {
  struct Column {
    enum class Kind { vignetting, glare, blur, falloff, aim_a, aim_b, scale } kind;
    std::size_t light;
    double sigma;
  };
  std::vector<Column> columns;

  PaintNuisances(const acquire::RigGeometry& geometry, const std::vector<PaintView>& views, const PaintOptions& options);
  /// Derivative of the logarithm of what a sample sees; not for glare and blur.
  double derivative(const Column& c, const PaintSample& sample, const PaintView& view, const PaintScene& scene, const SeenPaint& seen) const;
};

}  // namespace lacquer::calib
