#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/mat3x3.hpp>
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

/// Columns: axes, rig frame, of the frame whose z axis is that of `camera` from the sphere's centre. Seen from there the camera's direction has no
/// azimuth: the sums that a view takes at each pixel become short.
glm::dmat3 camera_axes(const glm::dvec3& camera);

/// The camera as the sphere's pixels see it.
struct PixelCamera {
  glm::dvec3 position;  ///< from the sphere's centre, rig frame, metres; orthographic: unit direction towards the camera
  bool central;         ///< false: orthographic
  double sphere_radius;
  double blur2;  ///< variance of pixel area and lens blur per axis, pixels^2
};

/// One pixel on the sphere, before it is packed.
struct SpherePixel {
  std::uint32_t index;              ///< y * width + x
  glm::dvec3 normal;                ///< unit, outwards, rig frame
  std::array<glm::dvec3, 2> step;   ///< change of the normal per pixel in x and in y; the part along the normal is dropped
  double transmission;              ///< of the lens there: 1 - vignetting
};

/// What eight neighbouring pixels of one channel on the sphere see, all that no light changes. Few bytes, because every view reads them all.
/// Normals in the frame of camera_axes: (sin_tilt azimuth[0], sin_tilt azimuth[1], cos_tilt), by these very numbers: they differ from the pixel's normal by
/// less than 1e-7 rad, but products with them can be taken in double. A direction across the normal, towards the camera's side, is
/// (-cos_tilt azimuth[0], -cos_tilt azimuth[1], sin_tilt), the third one (azimuth[1], -azimuth[0], 0).
struct alignas(64) PixelGroup {
  static constexpr std::size_t width = 8;
  float azimuth[2][width];  ///< cosine and sine
  float sin_tilt[width], cos_tilt[width];
  float inverse_distance[width];      ///< of the camera; 1 for an orthographic one
  float inverse_transmission[width];  ///< of the lens there: 1 / (1 - vignetting)
  /// Covariance, in the camera frame, of the normal over the pixel's area and the lens blur: its Cholesky factor (xx, yx, yy) in units of spread_unit.
  std::int16_t spread[3][width];
  float spread_unit;
  /// Places in the image, y * width + x: the first `run` pixels lie at every second place from first[0] on, pixel k >= run at first[1] + 2 k, and two times
  /// eight places from each of both lie in the image. run = 0: not so.
  std::uint32_t first[2];
  std::uint8_t run;
};
static_assert(sizeof(PixelGroup) == 256);

/// The pixels of one channel of a mosaic, or all, in the order of the image.
class SpherePixels {
 public:
  static constexpr std::size_t per_cap = 64;  // pixels
  /// All normals of `per_cap` consecutive pixels lie within an angle of `axis`.
  struct Cap {
    glm::dvec3 axis;
    double cos_angle, sin_angle;
  };

  /// `channel`: 0 where a pixel has all channels. `n_places`: width * height of the image.
  SpherePixels(int channel, const PixelCamera& camera, std::size_t n_places)
      : channel_(channel), n_places_(n_places), camera_(camera), axes_(camera_axes(camera.position)) {}
  void push_back(const SpherePixel& pixel);
  void finish();  ///< after the last pixel

  int channel() const { return channel_; }
  std::size_t size() const { return size_; }
  /// The last one is filled up with copies of its first pixel.
  const PixelGroup& group(std::size_t i) const { return groups_[i / PixelGroup::width]; }
  static std::size_t lane(std::size_t i) { return i % PixelGroup::width; }
  std::uint32_t index(std::size_t i) const { return index_[i]; }  ///< y * width + x; also of the copies
  glm::dvec3 normal(std::size_t i) const;                         ///< unit, rig frame
  glm::dvec3 spread(std::size_t i) const;                         ///< see PixelGroup
  double inverse_transmission(std::size_t i) const { return double{group(i).inverse_transmission[lane(i)]}; }
  const Cap& cap(std::size_t i) const { return caps_[i / per_cap]; }

 private:
  void find_runs(const std::uint32_t* index, PixelGroup& group) const;

  int channel_;
  std::size_t n_places_;
  PixelCamera camera_;
  glm::dmat3 axes_;
  std::vector<PixelGroup> groups_;
  std::array<glm::dvec3, PixelGroup::width> spreads_;  ///< of the last group
  std::vector<std::uint32_t> index_;
  std::vector<Cap> caps_;  ///< of `finish`
  std::size_t size_ = 0;
};

}  // namespace lacquer::calib
