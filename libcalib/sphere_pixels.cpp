#include "libcalib/sphere_pixels.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace lacquer::calib {

CameraFrame camera_frame(const glm::dvec3& n, const glm::dvec3& camera) {
  const glm::dvec3 tangential = camera - n * glm::dot(n, camera);
  const double length = glm::length(tangential);
  const glm::dvec3 any = glm::cross(n, std::abs(n.x) < 0.5 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0));
  const glm::dvec3 x = length > 1e-9 * glm::length(camera) ? tangential / length : glm::normalize(any);
  return {x, glm::cross(n, x), length};
}

namespace {
std::int32_t fixed_point(double x) { return static_cast<std::int32_t>(std::clamp(std::round(x / PixelGroup::normal_step), -2147483647.0, 2147483647.0)); }
}  // namespace

glm::dvec3 SpherePixels::normal(std::size_t i) const {
  const auto& component = group(i).normal;
  return glm::normalize(glm::dvec3(component[0][lane(i)], component[1][lane(i)], component[2][lane(i)]));  // of any length
}

void SpherePixels::push_back(const SpherePixel& pixel, const glm::dvec3& camera, bool central, double radius, double blur2) {
  const bool begins = lane(size) == 0;
  if (begins) groups.emplace_back();
  PixelGroup& g = groups.back();
  const CameraFrame frame = camera_frame(pixel.normal, camera);
  const double distance = central ? glm::length(camera - radius * pixel.normal) : 1;
  double xx = 0, xy = 0, yy = 0;
  for (const glm::dvec3& step : pixel.step) {
    const double x = glm::dot(step, frame.x), y = glm::dot(step, frame.y);
    xx += blur2 * x * x, xy += blur2 * x * y, yy += blur2 * y * y;
  }
  const double l_xx = std::sqrt(xx), l_yx = xx > 0 ? xy / l_xx : 0, l_yy = std::sqrt(std::max(0.0, yy - l_yx * l_yx));
  for (std::size_t k = lane(size); k < (begins ? PixelGroup::width : lane(size) + 1); ++k) {
    for (int i = 0; i < 3; ++i) g.normal[i][k] = fixed_point(pixel.normal[i]);
    g.sin_o[k] = static_cast<float>(frame.tangential / distance);
    g.inverse_rim[k] = static_cast<float>(1 / std::max(frame.tangential, 1e-9));
    g.inverse_distance[k] = static_cast<float>(1 / distance);
    g.spread[0][k] = static_cast<float>(l_xx);
    g.spread[1][k] = static_cast<float>(l_yx);
    g.spread[2][k] = static_cast<float>(l_yy);
    g.inverse_transmission[k] = static_cast<float>(1 / pixel.transmission);
    g.index[k] = pixel.index;
  }
  ++size;
}

void SpherePixels::finish() {
  groups.shrink_to_fit();
  caps.clear();
  for (std::size_t first = 0; first < size; first += per_cap) {
    const std::size_t end = std::min(size, first + per_cap);
    glm::dvec3 sum(0);
    for (std::size_t i = first; i < end; ++i) sum += normal(i);
    Cap cap{glm::length(sum) > 0 ? glm::normalize(sum) : normal(first), 1, 0};
    for (std::size_t i = first; i < end; ++i) cap.cos_angle = std::min(cap.cos_angle, glm::dot(cap.axis, normal(i)));
    cap.sin_angle = std::sqrt(std::max(0.0, 1 - cap.cos_angle * cap.cos_angle));
    caps.push_back(cap);
  }
}

}  // namespace lacquer::calib
