#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "libacquire/rig_geometry.h"

namespace lacquer::test {

/// The quick rig: 480 x 360 pixels, sphere of 153 px, one LED 0.6 m away, 12 degrees up; `pixels`: that many times as fine.
inline acquire::RigGeometry quick_rig(int n_lights = 1, double pixels = 1) {
  acquire::RigGeometry g;
  g.camera.width = static_cast<int>(480 * pixels);
  g.camera.height = static_cast<int>(360 * pixels);
  g.camera.focal = glm::dvec2(3055 * pixels);
  g.camera.centre = glm::dvec2(240, 180) * pixels - 0.5;
  g.camera.distortion = {-0.2, 0.5, 2e-4, -1e-4, 0, 0, 0, 0};
  g.cam_from_rig = acquire::look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  const glm::dvec3 places[] = {{0, 0.124747, 0.586889}, {0, -0.2, 0.55}, {0, 0.35, 0.48}};
  for (int i = 0; i < n_lights; ++i) {
    acquire::Light light;
    light.position = places[i];
    g.lights.push_back(light);
  }
  return g;
}

}  // namespace lacquer::test
