#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

namespace lacquer::calib {

/// What the pixels on the sphere see, as a structure of arrays padded to a multiple of 8: 57 bytes a pixel.
struct SpherePixels {
  std::vector<std::uint32_t> index;      ///< y * width + x
  std::vector<double> normal[3];         ///< unit, outwards, rig frame; the point is radius * normal
  std::vector<float> normal_step[2][3];  ///< change of the normal per pixel in x and in y
  std::vector<float> inverse_transmission;  ///< of the lens there: 1 / (1 - vignetting)
  std::vector<std::uint8_t> channel;     ///< of a mosaic; 0 where a pixel has all channels
  std::size_t size = 0;                  ///< without the padding

  void push_back(std::uint32_t pixel, const glm::dvec3& n, const glm::vec3& step_x, const glm::vec3& step_y, float inverse_lens, std::uint8_t colour);
  void append(const SpherePixels& other);
  void pad();  ///< with copies of the last pixel
};

/// One view's light and camera, rig frame, metres.
struct KernelView {
  float sphere_radius;
  bool central;      ///< false: orthographic
  glm::dvec3 camera; ///< centre of projection; orthographic: unit direction towards the camera
  bool distant;
  glm::dvec3 light;  ///< position; distant: unit direction
  /// Of the surface along n: the light stands at n . light - surface in front of the tangent plane. The sphere's radius; distant: 0.
  double surface;
  float light_distance2;  ///< |light|^2 - radius^2: distance^2 to a point is this - 2 radius (n . light - radius)
  glm::dvec3 axis;   ///< unit, from the light towards where it is aimed
  float falloff_exponent, diameter;
  float blur2;       ///< variance of pixel area and lens blur per axis, pixels^2
  float min_cosine;  ///< of the light
  float narrowest_m; ///< see SampleOptions
  float reference;   ///< irradiance at the sphere's centre per intensity
};

/// Samples of one block of pixels but for their values: all that does not depend on the channel.
struct SampleBlock {
  static constexpr std::size_t size = 512;
  enum Fate : std::int32_t {
    used = 0,
    grazing = 1,   ///< light below min_cosine or beneath the horizon
    blurred = 2,   ///< see SampleOptions::narrowest_m
    doubtful = 3,  ///< so near a cell's edge or another limit that float cannot decide: left to the scalar code in double
  };
  alignas(32) float weight[size];  ///< irradiance relative to the light's on axis
  alignas(32) float theta_h[size], theta_d[size], phi_d[size];  ///< weight * (coordinate - cell's centre)
  alignas(32) float along[size], across[size], mixed[size];     ///< weight * footprint
  alignas(32) std::int32_t row[size];  ///< theta_h * n_theta_d + theta_d of the cell
  alignas(32) std::int32_t cell_phi_d[size];
  alignas(32) std::int32_t fate[size];
};

/// Fills `block` for the pixels [begin, begin + n), n <= SampleBlock::size, begin a multiple of 8: the equations of Sampler's scalar code in
/// float, eight pixels at a time. Cells and decisions are those of the scalar code, because what float cannot decide is marked doubtful
/// (some 0.1 %); angles are within 1e-6. The same bytes with and without AVX2.
void sample_block(const SpherePixels& pixels, std::size_t begin, std::size_t n, const KernelView& view, SampleBlock& block);

/// false: the portable loop even where this processor has AVX2. For tests.
void use_sample_vectors(bool yes);

}  // namespace lacquer::calib
