#pragma once

#include <filesystem>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "libbrdf/brdf.h"
#include "tools/rgb_image.h"

namespace lacquer::tools {

/// A light probe: radiance from every direction as a latitude-longitude picture, top row up, middle column the -z direction, i.e. behind
/// the sphere as the viewer sees it.
class Environment {
 public:
  /// OpenEXR, RGB, at most 4096 x 2048. Throws Error{file}.
  explicit Environment(const std::filesystem::path& file);

  /// Bilinear; frame x right, y up, z towards the viewer.
  glm::dvec3 radiance(const glm::dvec3& direction) const;
  /// Direction with density `pdf` (1/sr) proportional to the brightness of the picture; `u` in [0, 1)^2.
  glm::dvec3 sample(double u, double v) const;
  double pdf(const glm::dvec3& direction) const;

 private:
  std::size_t texel(int x, int y) const { return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(x); }
  int width_ = 0, height_ = 0;
  std::vector<glm::vec3> radiance_;
  std::vector<double> rows_, columns_;  ///< cumulated brightness: of the rows, and within each row
};

/// The probe that comes with Lacquer, beside the executable (../share/lacquer) or in the source tree; nullopt: neither is there.
std::optional<std::filesystem::path> default_probe();

/// Sphere in the light of a probe, orthographic, linear, the probe's unit. Where `brdf` says nothing, `fallback` (if given) stands in;
/// `fallback_share`: of all light it added. A pixel that lacks light otherwise is not covered.
/// Importance sampling over brightness of the probe and half vectors of three widths together (balance heuristic, Veach and Guibas 1995),
/// the same directions for every BRDF, so that differences are those of the BRDFs.
struct ProbeSphere {
  RgbImage image;
  double fallback_share = 0;
};
ProbeSphere render_probe_sphere(const brdf::Brdf& brdf, const Environment& environment, int size, const brdf::Brdf* fallback = nullptr,
                                int samples_per_pixel = 256);

}  // namespace lacquer::tools
