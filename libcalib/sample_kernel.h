#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>

#include "libcalib/sphere_pixels.h"

namespace lacquer::calib {

/// One view's light and camera, rig frame, metres.
struct KernelView {
  double sphere_radius;
  bool central;      ///< false: orthographic
  glm::dvec3 camera; ///< as PixelCamera::position
  bool distant;
  glm::dvec3 light;  ///< position; distant: unit direction
  glm::dvec3 axis;   ///< unit, from the light towards where it is aimed
  float falloff_exponent, diameter;
  float min_cosine;  ///< of the light
  float narrowest_m; ///< see SampleOptions
  float reference;   ///< irradiance at the sphere's centre per intensity
};

/// What becomes of a pixel.
enum class PixelFate : std::uint32_t {
  used,
  grazing,  ///< light below min_cosine or beneath the horizon
  blurred,  ///< see SampleOptions::narrowest_m
};

/// Samples of one block of pixels, in groups of eight; groups that no light reaches are left out. All of a sample but its value, as CellSums adds it up.
struct SampleBlock {
  static constexpr std::size_t width = PixelGroup::width, size = 512;  // pixels
  typedef float Column[size];
  alignas(32) Column weight;         ///< irradiance relative to the light's on axis
  Column theta_h, theta_d, phi_d;    ///< weight * (coordinate - cell's centre)
  Column along, across, mixed;       ///< weight * footprint, along with the spread within the cell
  std::uint32_t slot[size];          ///< of the sample's cell in brdf::reachable_cells(); their number where there is no sample
  std::uint16_t group[size / width];  ///< first pixel of each group, from the block's first
  std::uint16_t doubtful[size];       ///< places where float cannot decide; they have no sample yet
  std::size_t n_groups, n_doubtful, n_blurred;
};

/// The equations of Sampler's scalar code in float, eight pixels at a time, for one view. Cells and decisions are those of the scalar code, because
/// what lies so near a cell's edge or another limit that float cannot decide (some 0.1 %) is left to it; angles are within 1e-6. A processor with
/// AVX2 and FMA gives other last digits than one without, each the same ones for any number of threads.
class SampleKernel {
 public:
  explicit SampleKernel(const KernelView& view);
  SampleKernel(SampleKernel&&) noexcept;
  ~SampleKernel();
  /// Fills `block` for the pixels [begin, begin + n), n <= SampleBlock::size, begin a multiple of it. `fetch`: they are not in the cache yet.
  void sample(const SpherePixels& pixels, std::size_t begin, std::size_t n, bool fetch, SampleBlock& block) const;
  struct Constants;

 private:
  std::unique_ptr<const Constants> constants_;
};

/// false: the portable loop even where this processor has AVX2 and FMA. For tests.
void use_sample_vectors(bool yes);

}  // namespace lacquer::calib
