#pragma once

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

namespace lacquer::brdf {

/// Frame at a point of a sphere that is seen along z: x lies in the plane of normal and viewer (any tangent does for an isotropic BRDF), z is the normal.
struct ShadingFrame {
  glm::dvec3 tangent, bitangent, normal;

  explicit ShadingFrame(const glm::dvec3& n) : tangent(1, 0, 0), bitangent(0, 1, 0), normal(n) {
    const double sine = std::hypot(n.x, n.y);
    if (sine == 0) return;
    tangent = {-n.x * n.z / sine, -n.y * n.z / sine, sine};
    bitangent = glm::cross(n, tangent);
  }
  glm::dvec3 to_local(const glm::dvec3& w) const { return {glm::dot(w, tangent), glm::dot(w, bitangent), glm::dot(w, normal)}; }
  glm::dvec3 to_world(const glm::dvec3& w) const { return w.x * tangent + w.y * bitangent + w.z * normal; }
};

}  // namespace lacquer::brdf
