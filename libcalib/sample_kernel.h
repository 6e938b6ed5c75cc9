#pragma once

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

/// What eight neighbouring pixels of one channel on the sphere see, all that no light changes. One block of memory, so that the processor
/// fetches ahead; only the normals are read where the light does not reach. `rim`: the camera's distance from the normal's line.
struct alignas(64) PixelGroup {
  static constexpr std::size_t width = 8;
  double normal[3][width];         ///< unit, outwards, rig frame; the point is radius * normal
  float cos_o[width], sin_o[width];  ///< of the direction to the camera
  float inverse_rim[width], inverse_distance[width];  ///< of the camera; the distance infinite for an orthographic one
  float step[2][2][width];         ///< change of the normal per pixel in x and in y, in the camera frame
  float inverse_transmission[width];  ///< of the lens there: 1 / (1 - vignetting)
  std::uint32_t index[width];      ///< y * width + x
};
static_assert(sizeof(PixelGroup) == 512);

/// The pixels of one channel of a mosaic, or all, in the order of the image.
struct SpherePixels {
  int channel = 0;  ///< 0 where a pixel has all channels
  std::vector<PixelGroup> groups;  ///< the last one filled up with copies of its first pixel
  std::size_t size = 0;

  /// `step_x`, `step_y`: change of the normal per pixel, its part along the normal is dropped.
  void push_back(std::uint32_t pixel, const glm::dvec3& normal, const glm::dvec3& camera, bool central, double radius, const glm::dvec3& step_x,
                 const glm::dvec3& step_y, float inverse_lens);
  const PixelGroup& group(std::size_t i) const { return groups[i / PixelGroup::width]; }
  static std::size_t lane(std::size_t i) { return i % PixelGroup::width; }
};

/// One view's light and camera, rig frame, metres.
struct KernelView {
  double sphere_radius;
  bool central;      ///< false: orthographic
  glm::dvec3 camera; ///< centre of projection; orthographic: unit direction towards the camera
  bool distant;
  glm::dvec3 light;  ///< position; distant: unit direction
  glm::dvec3 axis;   ///< unit, from the light towards where it is aimed
  float falloff_exponent, diameter;
  float blur2;       ///< variance of pixel area and lens blur per axis, pixels^2
  float min_cosine;  ///< of the light
  float narrowest_m; ///< see SampleOptions
  float reference;   ///< irradiance at the sphere's centre per intensity
};

/// All of a sample but its value.
struct alignas(32) PixelSample {
  enum Fate : std::uint32_t {
    used = 0,
    grazing = 1,   ///< light below min_cosine or beneath the horizon
    blurred = 2,   ///< see SampleOptions::narrowest_m
    doubtful = 3,  ///< so near a cell's edge or another limit that float cannot decide: left to the scalar code in double
  };
  float weight;                  ///< irradiance relative to the light's on axis
  float theta_h, theta_d, phi_d; ///< weight * (coordinate - cell's centre)
  float spread[3];               ///< weight * footprint (along, across, mixed), along with the spread within the cell: as CellSums adds it up
  std::uint32_t place;           ///< fate and cell

  static std::uint32_t packed(Fate fate, int theta_h, int theta_d, int phi_d) {
    return std::uint32_t{fate} << 24 | static_cast<std::uint32_t>(theta_h << 16 | theta_d << 8 | phi_d);
  }
  Fate fate() const { return static_cast<Fate>(place >> 24); }
  int cell_theta_h() const { return static_cast<int>(place >> 16 & 0xff); }
  int cell_theta_d() const { return static_cast<int>(place >> 8 & 0xff); }
  int cell_phi_d() const { return static_cast<int>(place & 0xff); }
};
static_assert(sizeof(PixelSample) == 32);

/// Samples of one block of pixels, in groups of eight; groups that no light reaches are left out.
struct SampleBlock {
  static constexpr std::size_t width = PixelGroup::width, size = 512;  // pixels
  PixelSample sample[size];
  std::uint16_t group[size / width];  ///< first pixel of each group, from the block's first
  std::uint16_t doubtful[size];       ///< places in `sample`
  std::size_t n_groups, n_doubtful;
};

/// Fills `block` for the pixels [begin, begin + n), n <= SampleBlock::size, begin a multiple of 8: the equations of Sampler's scalar code in
/// float, eight pixels at a time. Cells and decisions are those of the scalar code, because what float cannot decide is marked doubtful
/// (some 0.1 %); angles are within 1e-6. The same bytes with and without AVX2.
void sample_block(const SpherePixels& pixels, std::size_t begin, std::size_t n, const KernelView& view, SampleBlock& block);

/// false: the portable loop even where this processor has AVX2. For tests.
void use_sample_vectors(bool yes);

}  // namespace lacquer::calib
