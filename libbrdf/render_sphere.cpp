#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

#include "libbrdf/error.h"
#include "libbrdf/metrics.h"
#include "libbrdf/shading_frame.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;

/// Radiance towards the viewer; nullopt where the BRDF says nothing for one of the lights.
std::optional<glm::dvec3> reflected(const Brdf& brdf, const glm::dvec3& normal,
                                    const std::vector<glm::dvec3>& lights) {
  const ShadingFrame frame(normal);
  const glm::dvec3 wo = frame.to_local({0, 0, 1});
  glm::dvec3 radiance(0.0);
  for (const auto& light : lights) {
    const glm::dvec3 wi = frame.to_local(light);
    if (!(wi.z > 0)) continue;
    const auto f = brdf.value({wi, wo});
    if (!f) return std::nullopt;
    radiance += *f * (wi.z * pi);
  }
  return radiance;
}

void check(int size, const std::vector<glm::dvec3>& lights) {
  if (size < 1 || size > 16384)
    throw Error(ErrorCode::usage,
                fmt::format("size of the lit sphere: expected 1 to 16384 pixels, got {}", size));
  for (const auto& light : lights) {
    if (!(std::abs(glm::length(light) - 1) < 1e-6))
      throw Error(ErrorCode::usage,
                  fmt::format("light of the lit sphere: expected a unit vector, got ({}, {}, {})", light.x,
                              light.y, light.z));
  }
}

}  // namespace

std::optional<glm::dvec3> sphere_normal(int size, int column, int row) {
  const double x = (2 * column + 1 - size) / static_cast<double>(size);
  const double y = (size - 2 * row - 1) / static_cast<double>(size);
  const double z2 = 1 - x * x - y * y;
  if (!(z2 > 0)) return std::nullopt;
  return glm::dvec3(x, y, std::sqrt(z2));
}

SphereImage render_lit_sphere(const Brdf& brdf, int size, const std::vector<glm::dvec3>& light_directions) {
  check(size, light_directions);
  std::vector<glm::dvec3> lights = light_directions;
  if (lights.empty()) {
    const double angle = pi / 6;  // 30 deg to the right, then 30 deg up
    lights.push_back({std::cos(angle) * std::sin(angle), std::sin(angle), std::cos(angle) * std::cos(angle)});
  }

  const std::size_t width = static_cast<std::size_t>(size);
  SphereImage image{size, std::vector<glm::vec3>(width * width, glm::vec3(0.0f)), {}};
  std::vector<unsigned char> covered(width * width,
                                     0);  // vector<bool> cannot be written from several threads
  tbb::parallel_for(tbb::blocked_range<int>(0, size), [&](const tbb::blocked_range<int>& rows) {
    for (int row = rows.begin(); row != rows.end(); ++row) {
      for (int column = 0; column < size; ++column) {
        const auto normal = sphere_normal(size, column, row);
        if (!normal) continue;
        const auto radiance = reflected(brdf, *normal, lights);
        if (!radiance) continue;
        const glm::vec3 stored(*radiance);
        if (!std::isfinite(stored.x + stored.y + stored.z))
          throw Error(
              ErrorCode::input,
              fmt::format("{}: the value at normal ({:.6f}, {:.6f}, {:.6f}) of the lit sphere is not finite",
                          brdf.description(), normal->x, normal->y, normal->z));
        const std::size_t i = static_cast<std::size_t>(row) * width + static_cast<std::size_t>(column);
        image.radiance[i] = stored;
        covered[i] = 1;
      }
    }
  });
  image.covered.assign(covered.begin(), covered.end());
  return image;
}

}  // namespace lacquer::brdf
