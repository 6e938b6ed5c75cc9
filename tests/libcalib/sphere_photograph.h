#pragma once

#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <random>

#include "libacquire/rig_geometry.h"
#include "libcalib/radiance_image.h"

/// Photographs of a sphere made pixel by pixel from rays, for tests of silhouette and highlights.
namespace lacquer::test {

/// 480 x 360 pixels, sphere of 153 px, one LED 0.6 m away, 12 degrees up.
inline acquire::RigGeometry photographed_rig() {
  acquire::RigGeometry g;
  g.camera.width = 480;
  g.camera.height = 360;
  g.camera.focal = {3055, 3055};
  g.camera.centre = {239.5, 179.5};
  g.camera.distortion = {-0.2, 0.5, 2e-4, -1e-4, 0, 0, 0, 0};
  g.cam_from_rig = acquire::look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  acquire::Light light;
  light.position = {0, 0.124747, 0.586889};
  g.lights.push_back(light);
  return g;
}

/// Beckmann lobe of RMS slope m over a diffuse body; radiance per irradiance.
struct Gloss {
  double diffuse = 0.02, height = 2, m = 0.013;
};

/// Does one ray stand for the pixel: no silhouette and no lobe near?
inline bool plain(const acquire::RigGeometry& g, const acquire::PlacedLight& light, const glm::dvec2& pixel) {
  const auto centre = acquire::trace(g, pixel);
  if (!centre) return !acquire::trace(g, pixel + glm::dvec2(2, 0)) && !acquire::trace(g, pixel - glm::dvec2(2, 0)) &&
                      !acquire::trace(g, pixel + glm::dvec2(0, 2)) && !acquire::trace(g, pixel - glm::dvec2(0, 2));
  const auto lit = acquire::illuminate(light, *centre);
  const double to_camera = glm::dot(centre->normal, centre->wo);
  return to_camera > 0.3 && (!lit || glm::dot(glm::normalize(lit->wi + centre->wo), centre->normal) < 0.97);
}

/// Mean over n x n rays per pixel where it matters, relative noise; all channels alike but for a factor by channel.
inline calib::RadianceImage photograph(const acquire::RigGeometry& g, double angle, const Gloss& gloss, double noise, int n, unsigned seed,
                                       acquire::PixelLayout layout = acquire::PixelLayout::mono) {
  const int n_fine = n;
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0, 1);
  const acquire::PlacedLight light = g.place_light(0, angle);
  calib::RadianceImage image{g.camera.width, g.camera.height, layout, {}, {}, {}};
  const double factor[] = {0.7, 1.0, 0.8};
  for (int y = 0; y < g.camera.height; ++y)
    for (int x = 0; x < g.camera.width; ++x) {
      n = plain(g, light, {x, y}) ? 1 : n_fine;
      double sum = 0;
      for (int k = 0; k < n * n; ++k) {
        const auto p = acquire::trace(g, {x + (k % n + 0.5) / n - 0.5, y + (k / n + 0.5) / n - 0.5});
        if (!p) continue;
        const auto lit = acquire::illuminate(light, *p);
        if (!lit) continue;
        const glm::dvec3 h = glm::normalize(lit->wi + p->wo);
        const double cosine = glm::dot(h, p->normal), tan2 = 1 / (cosine * cosine) - 1, to_light = glm::dot(p->normal, lit->wi);
        const double mirror = gloss.height * std::exp(-tan2 / (gloss.m * gloss.m)) / (to_light * std::max(0.01, glm::dot(p->normal, p->wo)));
        sum += lit->irradiance.x * (gloss.diffuse + mirror);
      }
      const double radiance = factor[layout == acquire::PixelLayout::mono ? 1 : acquire::channel_of(layout, x, y, 0)] * sum / (n * n);
      const double sigma = noise * (radiance + 0.002);
      image.radiance.push_back(static_cast<float>(radiance + sigma * normal(random)));
      image.variance.push_back(static_cast<float>(sigma * sigma));
      image.flags.push_back(calib::PixelFlag::valid);
    }
  return image;
}

}  // namespace lacquer::test
