#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "libacquire/rig_geometry.h"
#include "libacquire/sim/quadrature.h"
#include "libacquire/sim/sensor_model.h"
#include "libbrdf/brdf.h"

namespace lacquer::acquire::sim {

/// Value of the BRDF; where it says nothing (a hole of a measured table) the nearest value on the way of both directions to the normal
/// (same azimuths, both polar angles shrunk by the same factor), 0 if there is none.
glm::dvec3 defined_value(const brdf::Brdf& paint, const brdf::Directions& d);

/// Photograph of a painted sphere without lens losses and sensor: mean radiance over each pixel's area and the emitter's disc.
///
/// Most pixels are smooth: one ray through the centre. Where the second differences of those values, the mirror direction, the silhouette
/// or the terminator say that this is not enough:
///  - highlights are smooth but curved: Gauss-Legendre over the pixel times a rule over the emitter, order raised until two successive
///    orders agree (far fewer rays than random or low-discrepancy points, see the test against brute force);
///  - silhouette: lines across it, each integrated over exactly the part that lies on the sphere;
///  - terminator: a fixed rule, fine enough for the kink.
/// The result depends on nothing but the arguments: same bytes for any number of threads.
class SphereRenderer {
 public:
  /// `n_channels`: 3, or 1: a camera without colour sees the paint's luminance (Rec. 709 weights) in the light's first channel.
  /// Throws Error{input} if no pixel sees the sphere.
  SphereRenderer(const RigGeometry& rig, std::shared_ptr<const brdf::Brdf> paint, int n_channels);

  /// Throws Error{input} if the paint gives a value that is not finite.
  RadianceImage render(const PlacedLight& light) const;

  /// One ray, one point of the emitter (`on_emitter`: metres in its plane); 0 beside the sphere and in the shadow. n_channels = 1: all
  /// three components are the luminance.
  glm::dvec3 radiance(const PlacedLight& light, const glm::dvec2& pixel, const glm::dvec2& on_emitter) const;

 private:
  enum class Coverage : std::uint8_t { outside, inside, edge };
  struct FirstPass;
  struct Order {
    std::vector<PlaneNode> pixel, emitter;
  };
  struct PixelMean {
    glm::dvec3 mean;
    double least, most;  ///< of the sums over the channels at the pixel's nodes
  };

  void classify_pixels();
  [[noreturn]] void refuse_paint() const;
  glm::dvec3 reflected(const PlacedLight& light, const SurfacePoint& point, const glm::dvec2& on_emitter) const;
  FirstPass first_pass(const PlacedLight& light) const;
  void first_pass_pixel(const PlacedLight& light, int x, int y, FirstPass& pass) const;
  glm::dvec3 pixel_mean(const PlacedLight& light, int x, int y, const FirstPass& pass) const;
  PixelMean mean_by_quadrature(const PlacedLight& light, int x, int y, const Order& order) const;
  glm::dvec3 mean_of_smooth_pixel(const PlacedLight& light, int x, int y, const glm::dvec3& centre, double floor) const;
  glm::dvec3 mean_of_silhouette_pixel(const PlacedLight& light, int x, int y) const;

  RigGeometry rig_;
  std::shared_ptr<const brdf::Brdf> paint_;
  int n_channels_;
  std::vector<Coverage> coverage_;  ///< per pixel
  double normal_per_pixel_ = 0;     ///< radians that the normal turns from pixel to pixel in the middle of the sphere
  std::vector<Order> orders_;       ///< for highlights, rising
  Order terminator_order_;
  std::vector<LineNode> silhouette_nodes_;
};

}  // namespace lacquer::acquire::sim
