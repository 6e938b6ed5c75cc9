#include "libcalib/sphere_pixels.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

namespace lacquer::calib {

CameraFrame camera_frame(const glm::dvec3& n, const glm::dvec3& camera) {
  const glm::dvec3 tangential = camera - n * glm::dot(n, camera);
  const double length = glm::length(tangential);
  const glm::dvec3 any = glm::cross(n, std::abs(n.x) < 0.5 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0));
  const glm::dvec3 x = length > 1e-9 * glm::length(camera) ? tangential / length : glm::normalize(any);
  return {x, glm::cross(n, x), length};
}

glm::dmat3 camera_axes(const glm::dvec3& camera) {
  const glm::dvec3 z = glm::normalize(camera), x = glm::normalize(glm::cross(std::abs(z.x) < 0.5 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0), z));
  return {x, glm::cross(z, x), z};
}

glm::dvec3 SpherePixels::normal(std::size_t i) const {
  const PixelGroup& g = group(i);
  const std::size_t k = lane(i);
  const double sin_tilt{g.sin_tilt[k]};
  return glm::normalize(axes_ * glm::dvec3(sin_tilt * double{g.azimuth[0][k]}, sin_tilt * double{g.azimuth[1][k]}, g.cos_tilt[k]));
}

glm::dvec3 SpherePixels::spread(std::size_t i) const {
  const PixelGroup& g = group(i);
  const std::size_t k = lane(i);
  return double{g.spread_unit} * glm::dvec3(g.spread[0][k], g.spread[1][k], g.spread[2][k]);
}

void SpherePixels::find_runs(const std::uint32_t* index, PixelGroup& g) const {
  const auto run_from = [&](std::size_t begin) {
    std::size_t end = begin + 1;
    while (end < PixelGroup::width && index[end] == index[end - 1] + 2) ++end;
    return end;
  };
  const auto in_image = [&](std::uint32_t first) { return first + 2 * PixelGroup::width <= n_places_; };
  const std::size_t run = run_from(0);
  g.first[0] = index[0];
  g.first[1] = run < PixelGroup::width ? index[run] - 2 * static_cast<std::uint32_t>(run) : index[0];
  const bool two_at_most = run == PixelGroup::width || (index[run] >= 2 * run && run_from(run) == PixelGroup::width);
  g.run = static_cast<std::uint8_t>(two_at_most && in_image(g.first[0]) && in_image(g.first[1]) ? run : 0);
}

void SpherePixels::push_back(const SpherePixel& pixel) {
  const bool begins = lane(size_) == 0;
  if (begins) {
    groups_.emplace_back();
    index_.resize(index_.size() + PixelGroup::width);
  }
  PixelGroup& g = groups_.back();
  const CameraFrame frame = camera_frame(pixel.normal, camera_.position);
  const glm::dvec3 normal = glm::transpose(axes_) * pixel.normal;
  const double sin_tilt = std::hypot(normal.x, normal.y);
  const double distance = camera_.central ? glm::length(camera_.position - camera_.sphere_radius * pixel.normal) : 1;
  double xx = 0, xy = 0, yy = 0;
  for (const glm::dvec3& step : pixel.step) {
    const double x = glm::dot(step, frame.x), y = glm::dot(step, frame.y);
    xx += camera_.blur2 * x * x, xy += camera_.blur2 * x * y, yy += camera_.blur2 * y * y;
  }
  const double l_xx = std::sqrt(xx), l_yx = xx > 0 ? xy / l_xx : 0, l_yy = std::sqrt(std::max(0.0, yy - l_yx * l_yx));
  for (std::size_t k = lane(size_); k < (begins ? PixelGroup::width : lane(size_) + 1); ++k) {
    g.azimuth[0][k] = static_cast<float>(sin_tilt > 0 ? normal.x / sin_tilt : 1);
    g.azimuth[1][k] = static_cast<float>(sin_tilt > 0 ? normal.y / sin_tilt : 0);
    g.sin_tilt[k] = static_cast<float>(sin_tilt);
    g.cos_tilt[k] = static_cast<float>(normal.z);
    g.inverse_distance[k] = static_cast<float>(1 / distance);
    g.inverse_transmission[k] = static_cast<float>(1 / pixel.transmission);
    spreads_[k] = {l_xx, l_yx, l_yy};
    index_[index_.size() - PixelGroup::width + k] = pixel.index;
  }
  ++size_;

  double largest = 0;
  for (const glm::dvec3& s : spreads_) largest = std::max({largest, s.x, std::abs(s.y), s.z});
  g.spread_unit = static_cast<float>(largest / 32767);
  for (std::size_t k = 0; k < PixelGroup::width; ++k)
    for (int i = 0; i < 3; ++i)
      g.spread[i][k] = static_cast<std::int16_t>(largest > 0 ? std::clamp(std::round(spreads_[k][i] / double{g.spread_unit}), -32767.0, 32767.0) : 0);
  find_runs(&index_[index_.size() - PixelGroup::width], g);
}

void SpherePixels::finish() {
  groups_.shrink_to_fit();
  index_.shrink_to_fit();
  caps_.clear();
  for (std::size_t first = 0; first < size_; first += per_cap) {
    const std::size_t end = std::min(size_, first + per_cap);
    glm::dvec3 sum(0);
    for (std::size_t i = first; i < end; ++i) sum += normal(i);
    Cap cap{glm::length(sum) > 0 ? glm::normalize(sum) : normal(first), 1, 0};
    for (std::size_t i = first; i < end; ++i) cap.cos_angle = std::min(cap.cos_angle, glm::dot(cap.axis, normal(i)));
    cap.sin_angle = std::sqrt(std::max(0.0, 1 - cap.cos_angle * cap.cos_angle));
    caps_.push_back(cap);
  }
}

}  // namespace lacquer::calib
