#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "libacquire/rig_description.h"
#include "libbrdf/brdf.h"
#include "libcalib/geometry_difference.h"
#include "libcalib/geometry_session.h"

/// Simulated rigs whose builder had a ruler: photographed, merged, calibrated, and compared with the truth.
namespace lacquer::bench {

/// What the rig file is wrong about.
struct BuilderErrors {
  glm::dvec3 sphere{0.0};      ///< metres, of the sphere's centre, rig frame of the rig file
  double tilt_x = 0, tilt_z = 0;  ///< radians, of the axis about x, then z
  glm::dvec3 axis{0.0};        ///< metres
  double zero_angle = 0;       ///< radians: where the turntable stands when it reads 0
  double step_scale = 1;       ///< true turn over the one read back
  double arm_scale = 1;        ///< true over stated distance of the lights
  std::vector<glm::dvec3> lights;  ///< metres, by light
};
/// Drawn from the priors.
BuilderErrors draw_errors(const acquire::RigGeometry& nominal, const calib::GeometryPriors& priors, std::uint64_t seed);
/// The rig that a simulator is to photograph: its turntable reads angles of the rig file's over step_scale.
acquire::RigDescription built_with(const acquire::RigDescription& nominal, const BuilderErrors& errors);

/// One unknown of the solution against the truth.
struct Pull {
  std::string name;
  double error = 0, sigma = 0;  ///< in the unknown's unit
};

struct RigResult {
  calib::GeometryDifference before, after;  ///< the rig file's geometry, the estimated one
  calib::GeometryEstimate estimate;
  std::vector<Pull> pulls;
  double mahalanobis = 0;  ///< of all unknowns with a known truth together; expected: their number
  std::size_t n_views = 0;
  double simulation_s = 0, calibration_s = 0;
};

/// The whole way for one rig. Frames are exposed by the sensor model and merged as those of a session; only nothing goes through files.
RigResult run_rig(const acquire::RigDescription& nominal, const BuilderErrors& errors, std::uint64_t seed, const std::shared_ptr<const brdf::Brdf>& paint,
                  const calib::GeometryPriors& priors, bool use_paint);

/// Statistics over the rigs, as text.
std::string summary(const std::vector<RigResult>& results);

}  // namespace lacquer::bench
