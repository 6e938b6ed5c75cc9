#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

namespace lacquer::calib {

/// Tangent plane of the sphere at a pixel: `x` in the plane of normal and camera, towards the camera's side, y = normal x x.
struct CameraFrame {
  glm::dvec3 x, y;
  double tangential;  ///< length of the camera vector's part along x
};
/// `camera`: from the sphere's centre, a point or a direction. Where it stands along the normal any frame will do.
CameraFrame camera_frame(const glm::dvec3& normal, const glm::dvec3& camera);

/// One pixel on the sphere, before it is packed.
struct SpherePixel {
  std::uint32_t index;              ///< y * width + x
  glm::dvec3 normal;                ///< unit, outwards, rig frame
  std::array<glm::dvec3, 2> step;   ///< change of the normal per pixel in x and in y; the part along the normal is dropped
  double transmission;              ///< of the lens there: 1 - vignetting
};

/// What eight neighbouring pixels of one channel on the sphere see, all that no light changes. Few bytes, because every view reads them all.
struct alignas(32) PixelGroup {
  static constexpr std::size_t width = 8;
  static constexpr double normal_step = 0x1p-31;
  std::int32_t normal[3][width];   ///< unit, outwards, rig frame, in steps of 2^-31 (2e-10 rad); the point is radius * normal
  float sin_o[width];              ///< of the direction to the camera
  float inverse_rim[width];        ///< 1 / the camera's distance from the normal's line
  float inverse_distance[width];   ///< of the camera; 1 for an orthographic one
  /// Covariance, in the camera frame, of the normal over the pixel's area and the lens blur: its Cholesky factor (xx, yx, yy).
  float spread[3][width];
  float inverse_transmission[width];  ///< of the lens there: 1 / (1 - vignetting)
  std::uint32_t index[width];         ///< y * width + x
};
static_assert(sizeof(PixelGroup) == 352);

/// The pixels of one channel of a mosaic, or all, in the order of the image.
struct SpherePixels {
  static constexpr std::size_t per_cap = 64;  // pixels
  /// All normals of `per_cap` consecutive pixels lie within an angle of `axis`.
  struct Cap {
    glm::dvec3 axis;
    double cos_angle, sin_angle;
  };

  int channel = 0;                 ///< 0 where a pixel has all channels
  std::vector<PixelGroup> groups;  ///< the last one filled up with copies of its first pixel
  std::vector<Cap> caps;           ///< of `finish`
  std::size_t size = 0;

  /// `camera`: centre of projection if `central`, else the direction to the camera. `blur2`: variance of pixel area and lens blur per axis, pixels^2.
  void push_back(const SpherePixel& pixel, const glm::dvec3& camera, bool central, double radius, double blur2);
  void finish();  ///< after the last pixel

  const PixelGroup& group(std::size_t i) const { return groups[i / PixelGroup::width]; }
  static std::size_t lane(std::size_t i) { return i % PixelGroup::width; }
  glm::dvec3 normal(std::size_t i) const;  ///< unit
};

}  // namespace lacquer::calib
