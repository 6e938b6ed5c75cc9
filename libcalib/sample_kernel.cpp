#include "libcalib/sample_kernel.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <utility>

#include "libbrdf/table_accumulator.h"
#include "libcalib/sample_kernel_math.h"

namespace lacquer::calib {

namespace {

using namespace kernel;
using Grid = brdf::TableGrid;
constexpr std::size_t width = SampleBlock::width;

/// Whether light reaches pixels of a cap of the sphere; see SpherePixels::Cap.
class Terminator {
 public:
  explicit Terminator(const KernelView& v)
      : light_(v.light), distance_(glm::length(v.light)),
        lowest_(v.distant ? v.min_cosine : v.sphere_radius + v.min_cosine * (distance_ - v.sphere_radius) - 1e-5 * distance_) {}
  bool in_shadow(const SpherePixels::Cap& cap) const {
    const double along = glm::dot(cap.axis, light_);
    return along < distance_ * cap.cos_angle &&
           along * cap.cos_angle + std::sqrt(std::max(0.0, distance_ * distance_ - along * along)) * cap.sin_angle < lowest_;  // highest n . light
  }

 private:
  glm::dvec3 light_;
  double distance_, lowest_;
};

}  // namespace

/// What is the same for all pixels of a view, most of it in every lane: the compiler would otherwise spread it again for every group. Vectors are in
/// the frame of camera_axes.
struct SampleKernel::Constants {
  Terminator terminator;
  Double4 light[3], surface;           // the light stands at n . light - surface in front of the tangent plane
  Float8 light_parts[3];               // as `light`
  Float8 distance2, two_radii;         // distance^2 to a point is the first less the second times (n . light - surface)
  Float8 off_axis[2][4], along_axis[4];  // the first three times the normal and the fourth: how far off the light's axis in two directions, and along it
  Float8 camera_distance;  // from the sphere's centre; 1 for an orthographic one
  Float8 light_radius, camera_radius, lowest_cosine, safe_cosine, emitter, narrow2, nine_narrow2, inverse_reference, half_exponent;
  Float8 doubt_h, doubt_d, doubt_p;  // what rounding may do to the angles, in cells; see CellOf
  Float8 series_reach, binomial[8];  // of (1 - x)^half_exponent; the first times x
  bool distant, has_falloff, has_emitter, surely_ahead = true;
  const brdf::ReachableCells* cells = &brdf::reachable_cells();
  std::uint32_t no_slot = cells->size();
  /// A direction's part is a difference of numbers as large as the distance from the sphere's centre, over that from the pixel.
  static float rounding_of(const KernelView& v) {
    const auto nearness = [&](bool point, const glm::dvec3& p) { return point ? glm::length(p) / std::max(glm::length(p) - v.sphere_radius, 1e-9) : 1.0; };
    return static_cast<float>(static_cast<double>(rounding) * std::max(nearness(!v.distant, v.light), nearness(v.central, v.camera)));
  }
  explicit Constants(const KernelView& v)
      : terminator(v), surface(brdf::splat(v.distant ? 0 : v.sphere_radius)),
        distance2(splat(static_cast<float>(glm::dot(v.light, v.light) - v.sphere_radius * v.sphere_radius))),
        two_radii(splat(static_cast<float>(2 * v.sphere_radius))),
        camera_distance(splat(v.central ? static_cast<float>(glm::length(v.camera)) : 1.0f)),
        light_radius(splat(v.distant ? 0.0f : static_cast<float>(v.sphere_radius))),
        camera_radius(splat(v.central ? static_cast<float>(v.sphere_radius) : 0.0f)),
        lowest_cosine(splat(v.min_cosine - rounding_of(v))),
        safe_cosine(splat(v.min_cosine + rounding_of(v))),
        emitter(splat(v.diameter * v.diameter / 64)),
        narrow2(splat(v.narrowest_m * v.narrowest_m)),
        nine_narrow2(splat(9 * v.narrowest_m * v.narrowest_m)),
        inverse_reference(splat(v.distant ? 1.0f : 1 / v.reference)),
        half_exponent(splat(v.falloff_exponent / 2)),
        doubt_h(splat(rounding_of(v) * Grid::n_theta_h / pi)),
        doubt_d(splat(2e-5f + rounding_of(v) * 60)),
        doubt_p(splat(8 * rounding_of(v) / pi * Grid::n_phi_d)),
        distant(v.distant), has_falloff(!v.distant && v.falloff_exponent != 0), has_emitter(!v.distant && v.diameter > 0) {
    const glm::dmat3 to_frame = glm::transpose(camera_axes(v.camera));
    const glm::dvec3 in_frame = to_frame * v.light;
    for (int i = 0; i < 3; ++i) light[i] = brdf::splat(in_frame[i]), light_parts[i] = splat(static_cast<float>(in_frame[i]));
    if (!has_falloff) return;
    const auto plane = [&](const glm::dvec3& a, Float8 (&to)[4]) {
      const glm::dvec3 normal = v.sphere_radius * (to_frame * a);
      for (int i = 0; i < 3; ++i) to[i] = splat(static_cast<float>(normal[i]));
      to[3] = splat(static_cast<float>(-glm::dot(v.light, a)));
    };
    const CameraFrame across = camera_frame(v.axis, std::abs(v.axis.x) < 0.5 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0));
    plane(across.x, off_axis[0]);
    plane(across.y, off_axis[1]);
    plane(v.axis, along_axis);
    surely_ahead = -glm::dot(v.light, v.axis) > v.sphere_radius;
    series_reach = splat(std::max(v.falloff_exponent / 2, 2.0f));
    double term = 1;
    for (int k = 0; k < 8; ++k) {
      binomial[k] = splat(static_cast<float>(term));
      term *= -(static_cast<double>(v.falloff_exponent) / 2 - k) / (k + 1);
    }
  }
};

namespace {

using Constants = SampleKernel::Constants;

/// The pixels of a few groups between the stages below, which are short so that the processor can work on several groups at a time.
/// Directions are in the camera frame of each pixel: light (light_x, light_y, cos_i), camera (sin_o, 0, cos_o).
struct Columns {
  static constexpr std::size_t size = SpherePixels::per_cap;
  typedef float Column[size];
  alignas(32) Column cos_i, cos_o, sin_o, light_x, light_y, inverse_light_distance, weight;
  Column sin_theta_h, sin_h, cos_h, sin_d, length, inverse_length, inverse_sin_h, cos_phi, sin_phi, product;  // the length is that of the sum of both directions
  Column theta_h, theta_d, phi_d, offset_h, offset_d, offset_p, centre_h, along, across, mixed;
  alignas(32) std::int32_t lit[size], doubtful[size], blurred[size], row[size], phi_cell[size], slot[size];
};
LACQUER_ALWAYS_INLINE Int32x8 load_mask(const std::int32_t* from) { return load<Int32x8>(from); }

/// (1 - sin^2 of the angle off the light's axis)^(exponent / 2).
LACQUER_ALWAYS_INLINE Float8 falloff(const PixelGroup& p, const Constants& view, Float8 inverse_light_distance2, Int32x8& doubtful) {
  const Float8 sin_tilt = load<Float8>(p.sin_tilt), x = sin_tilt * load<Float8>(p.azimuth[0]), y = sin_tilt * load<Float8>(p.azimuth[1]), z = load<Float8>(p.cos_tilt);
  Float8 sin2 = splat(0.0f);
  for (const auto& a : view.off_axis) {
    const Float8 off = (a[0] * x + a[1] * y) + (a[2] * z + a[3]);
    sin2 += off * off;
  }
  sin2 *= inverse_light_distance2;
  if (!view.surely_ahead) {
    const auto& a = view.along_axis;
    doubtful |= a[0] * x + a[1] * y + a[2] * z + a[3] < splat(0.0f);
  }
  if (!any(sin2 * view.series_reach > splat(0.2f))) {  // the series' first term left out is below 3e-9
    return polynomial(sin2, view.binomial);
  }
  doubtful |= sin2 > splat(0.2f);
  return power_of_one_minus(minimum(sin2, splat(0.2f)), view.half_exponent);
}

/// How far the light stands in front of the pixels' tangent planes: a small difference where light grazes, so it is taken in double.
LACQUER_ALWAYS_INLINE Float8 in_front(const PixelGroup& p, const Constants& view) {
  const auto half = [&](std::size_t k) {
    const Double4 radial = load_as_double(p.azimuth[0] + k) * view.light[0] + load_as_double(p.azimuth[1] + k) * view.light[1];
    const Double4 front = load_as_double(p.sin_tilt + k) * radial + (load_as_double(p.cos_tilt + k) * view.light[2] - view.surface);
    return __builtin_convertvector(front, Float4);
  };
  return __builtin_shufflevector(half(0), half(4), 0, 1, 2, 3, 4, 5, 6, 7);
}

/// First stage, of eight pixels: how light reaches them; false where none reaches any of the first `n`.
LACQUER_ALWAYS_INLINE bool light_pixels(const PixelGroup& p, std::size_t n_pixels, const Constants& view, Columns& c, std::size_t to) {
  const Float8 front = in_front(p, view);
  Float8 cos_i = front, inverse_light_distance = splat(1.0f);
  if (!view.distant) {
    inverse_light_distance = root(splat(1.0f) / (view.distance2 - view.two_radii * front));
    cos_i = front * inverse_light_distance;
  }
  Int32x8 lit = cos_i > view.lowest_cosine;
  if (n_pixels < width) lit &= Int32x8{0, 1, 2, 3, 4, 5, 6, 7} < static_cast<std::int32_t>(n_pixels);
  if (!any(lit)) return false;
  store(c.cos_i + to, cos_i);
  store(c.inverse_light_distance + to, inverse_light_distance);
  store(c.lit + to, lit);
  return true;
}

/// The light's direction, and the irradiance relative to the light's on axis.
LACQUER_ALWAYS_INLINE void irradiance(const PixelGroup& p, const Constants& view, Columns& c, std::size_t k) {
  const Float8 cos_i = load<Float8>(c.cos_i + k), inverse_light_distance = load<Float8>(c.inverse_light_distance + k);
  const Float8 azimuth_x = load<Float8>(p.azimuth[0]), azimuth_y = load<Float8>(p.azimuth[1]);
  const Float8 sin_tilt = load<Float8>(p.sin_tilt), cos_tilt = load<Float8>(p.cos_tilt);
  const Float8 radial = azimuth_x * view.light_parts[0] + azimuth_y * view.light_parts[1];
  const Float8 camera_ratio = view.camera_distance * load<Float8>(p.inverse_distance), sin_o = sin_tilt * camera_ratio;
  store(c.sin_o + k, sin_o);
  store(c.cos_o + k, cos_tilt * camera_ratio - view.camera_radius * load<Float8>(p.inverse_distance));
  store(c.light_x + k, (sin_tilt * view.light_parts[2] - cos_tilt * radial) * inverse_light_distance);
  store(c.light_y + k, (azimuth_y * view.light_parts[0] - azimuth_x * view.light_parts[1]) * inverse_light_distance);
  Int32x8 doubtful = (cos_i < view.safe_cosine) | (sin_o < splat(1e-3f));
  const Float8 inverse_light_distance2 = inverse_light_distance * inverse_light_distance;
  Float8 weight = cos_i * (inverse_light_distance2 * view.inverse_reference);
  if (view.has_falloff) weight = weight * falloff(p, view, inverse_light_distance2, doubtful);
  store(c.weight + k, weight);
  store(c.doubtful + k, doubtful);
}

/// Angles as in half_diff, without a shading frame: n x h / sin(theta_h) stands for its azimuth, and since the difference of the
/// directions is normal to h, its part along theta is -(cos_i - cos_o) / sin(theta_h). Here their sines and cosines.
LACQUER_ALWAYS_INLINE void sines(Columns& c, std::size_t k) {
  const Float8 cos_i = load<Float8>(c.cos_i + k), light_x = load<Float8>(c.light_x + k), light_y = load<Float8>(c.light_y + k);
  const Float8 cos_o = load<Float8>(c.cos_o + k), sin_o = load<Float8>(c.sin_o + k);
  const Float8 along_normal = maximum(cos_i + cos_o, splat(0.0f)), along_x = light_x + sin_o, across_x = light_x - sin_o, descent = cos_o - cos_i;
  const Float8 y2 = light_y * light_y, tangential2 = along_x * along_x + y2;
  const Float8 sin_h = root(tangential2), length = root(tangential2 + along_normal * along_normal);  // the first times the second
  const Float8 sin_d = root(across_x * across_x + y2 + descent * descent);                            // of twice the length
  const Float8 product = sin_h * sin_d, inverse = splat(1.0f) / (product * length + splat(1e-30f));
  const Float8 inverse_length = inverse * product, inverse_product = inverse * length;
  store(c.sin_h + k, sin_h);
  store(c.cos_h + k, along_normal * inverse_length);
  store(c.sin_theta_h + k, sin_h * inverse_length);
  store(c.sin_d + k, sin_d);
  store(c.length + k, length);
  store(c.inverse_length + k, inverse_length);
  store(c.inverse_sin_h + k, inverse_product * sin_d);
  store(c.cos_phi + k, descent * length * inverse_product);
  store(c.sin_phi + k, splat(2.0f) * sin_o * light_y * inverse_product);
  store(c.product + k, product);
}

LACQUER_ALWAYS_INLINE void angles(Columns& c, std::size_t k) {
  const Float8 zero = splat(0.0f), cos_phi = load<Float8>(c.cos_phi + k), sin_phi = load<Float8>(c.sin_phi + k);
  const Float8 steep_phi = angle_of(absolute(sin_phi), absolute(cos_phi));
  store(c.theta_h + k, angle_of(load<Float8>(c.sin_theta_h + k), load<Float8>(c.cos_h + k)));
  store(c.theta_d + k, angle_of(load<Float8>(c.sin_d + k) * splat(0.5f), load<Float8>(c.length + k) * splat(0.5f)));
  store(c.phi_d + k, select((cos_phi < zero) ^ (sin_phi < zero), splat(pi) - steep_phi, steep_phi));
}

/// Cells, and offsets from their centres.
LACQUER_ALWAYS_INLINE void cells(const Constants& view, Columns& c, std::size_t k) {
  constexpr float n_h = Grid::n_theta_h, n_d = Grid::n_theta_d, n_p = Grid::n_phi_d;
  const Float8 theta_h = load<Float8>(c.theta_h + k), theta_d = load<Float8>(c.theta_d + k), phi_d = load<Float8>(c.phi_d + k);
  const Float8 root_h = root(theta_h * splat(2 / pi));
  const CellOf h = cell_of(root_h * splat(n_h), Grid::n_theta_h, 2e-5f, view.doubt_h, root_h + splat(1e-6f));
  const CellOf d = cell_of(theta_d * splat(2 / pi * n_d), Grid::n_theta_d, 0, view.doubt_d, splat(1.0f));
  const CellOf q = cell_of(phi_d * splat(1 / pi * n_p), Grid::n_phi_d, 4e-5f, view.doubt_p, load<Float8>(c.product + k) + splat(1e-12f));
  const Float8 root_centre = (h.cell + splat(0.5f)) * splat(1 / n_h), centre_h = root_centre * root_centre * splat(pi / 2);
  store(c.centre_h + k, centre_h);
  store(c.offset_h + k, theta_h - centre_h);
  store(c.offset_d + k, theta_d - (d.cell + splat(0.5f)) * splat(pi / 2 / n_d));
  store(c.offset_p + k, phi_d - (q.cell + splat(0.5f)) * splat(pi / n_p));
  store(c.row + k, __builtin_convertvector(h.cell * splat(n_d) + d.cell, Int32x8));
  store(c.phi_cell + k, __builtin_convertvector(q.cell, Int32x8));
  store(c.doubtful + k, load_mask(c.doubtful + k) | h.doubtful | d.doubtful | q.doubtful);
}

/// Footprint, and whether it exceeds a narrow peak. half_vector_footprint written in the half vector's own axes, e along its tangential part:
/// moved by t on the unit sphere, its slope changes by G (kappa . t) - (1 + cos^2(theta_h) P) (e . t) along and by
/// B (kappa . t) - (1 + P) (e' . t) across, with kappa the difference of both directions' parts across the normal, each times the sphere's radius
/// over its distance, P the sum of these two over the length of the directions' sum, G and B parts of the directions' difference over it.
LACQUER_ALWAYS_INLINE void footprint(const PixelGroup& p, const Constants& view, Columns& c, std::size_t k) {
  for (std::size_t i = k; i < k + width; ++i) c.slot[i] = static_cast<std::int32_t>(view.cells->slot(c.row[i], c.phi_cell[i]));
  const Float8 one = splat(1.0f), half = splat(0.5f);
  const Float8 sin_o = load<Float8>(c.sin_o + k), light_x = load<Float8>(c.light_x + k), light_y = load<Float8>(c.light_y + k);
  const Float8 sin_h = load<Float8>(c.sin_h + k), inverse_length = load<Float8>(c.inverse_length + k), inverse_sin_h = load<Float8>(c.inverse_sin_h + k);
  const Float8 inverse_light_distance = load<Float8>(c.inverse_light_distance + k);
  const Float8 per_light = view.light_radius * inverse_light_distance, per_camera = view.camera_radius * load<Float8>(p.inverse_distance);
  const Float8 e_x = (light_x + sin_o) * inverse_sin_h, e_y = light_y * inverse_sin_h;
  const Float8 kappa_x = per_light * light_x - per_camera * sin_o, kappa_y = per_light * light_y;
  const Float8 turn = (per_light + per_camera) * inverse_length, cos_h = load<Float8>(c.cos_h + k);
  const Float8 g = (half * sin_h - sin_o * e_x) * inverse_length, b = sin_o * e_y * inverse_length;
  const Float8 stay_along = one + turn * cos_h * cos_h, stay_across = one + turn;
  const Float8 along_x = g * kappa_x - stay_along * e_x, along_y = g * kappa_y - stay_along * e_y;
  const Float8 across_x = b * kappa_x + stay_across * e_y, across_y = b * kappa_y - stay_across * e_x;
  const Float8 xx = load_as_float(p.spread[0]), yx = load_as_float(p.spread[1]), yy = load_as_float(p.spread[2]), unit2 = splat(p.spread_unit * p.spread_unit);
  const Float8 along_1 = along_x * xx + along_y * yx, along_2 = along_y * yy, across_1 = across_x * xx + across_y * yx, across_2 = across_y * yy;
  Float8 along = splat(0.0f), across = splat(0.0f), mixed = splat(0.0f);
  if (view.has_emitter) {
    const Float8 in_plane = view.emitter * inverse_light_distance * inverse_light_distance;
    const Float8 off_plane = in_plane * splat(4.0f) * inverse_length * inverse_length;  // 1 / cos^2(theta_d)
    const Float8 cos_phi = load<Float8>(c.cos_phi + k), difference = (in_plane - off_plane) * cos_phi;
    along = off_plane + difference * cos_phi;
    across = in_plane - difference * cos_phi;
    mixed = difference * load<Float8>(c.sin_phi + k);
  }
  along += unit2 * (along_1 * along_1 + along_2 * along_2);
  across += unit2 * (across_1 * across_1 + across_2 * across_2);
  mixed += unit2 * (along_1 * across_1 + along_2 * across_2);
  store(c.along + k, along);
  store(c.across + k, across);
  store(c.mixed + k, mixed);
  const Float8 theta_h = load<Float8>(c.theta_h + k), sum = along + across;
  Int32x8 blurred = {};
  if (any(theta_h * theta_h < view.nine_narrow2 * splat(1.001f) + sum * splat(18.02f))) {  // the larger variance is at most the sum
    const Float8 half_difference = (along - across) * half, larger = sum * half + root(half_difference * half_difference + mixed * mixed);
    const Float8 beyond_m = larger - view.narrow2, peak = view.nine_narrow2 + larger * splat(18.0f), beyond_peak = theta_h * theta_h - peak;
    blurred = (beyond_m > splat(0.0f)) & (beyond_peak < splat(0.0f));
    store(c.doubtful + k, load_mask(c.doubtful + k) | (absolute(beyond_m) < splat(1e-4f) * larger) |
                              ((beyond_m > splat(0.0f)) & (absolute(beyond_peak) < splat(1e-4f) * peak)));
  }
  store(c.blurred + k, blurred);
}

/// Last stage: what CellSums adds up, and where.
LACQUER_ALWAYS_INLINE void weigh(const Constants& view, Columns& c, std::size_t k, SampleBlock& block, std::size_t at) {
  const Float8 weight = load<Float8>(c.weight + k), offset_h = load<Float8>(c.offset_h + k), weighted_h = weight * offset_h;
  Float8 along = weight * load<Float8>(c.along + k);
  if (any(load<Float8>(c.theta_h + k) < splat(pi / 9))) {
    // cos^-4 at the cell's centre, as ReachableCells::squared_slope: Taylor's series, what is left out is below 1e-8.
    const Float8 centre = load<Float8>(c.centre_h + k), u = centre * centre;
    const Float8 squared_slope = polynomial(u, {splat(1.0f), splat(2.0f), splat(7.0f / 3), splat(94.0f / 45), splat(502.0f / 315), splat(1.092337f),
                                                splat(0.693536f), splat(0.44f)});
    along += select(centre < splat(pi / 9), squared_slope, splat(0.0f)) * (weighted_h * offset_h);
  }
  store(block.weight + at, weight);
  store(block.theta_h + at, weighted_h);
  store(block.theta_d + at, weight * load<Float8>(c.offset_d + k));
  store(block.phi_d + at, weight * load<Float8>(c.offset_p + k));
  store(block.along + at, along);
  store(block.across + at, weight * load<Float8>(c.across + k));
  store(block.mixed + at, weight * load<Float8>(c.mixed + k));
  const Int32x8 lit = load_mask(c.lit + k), used = lit & ~load_mask(c.doubtful + k) & ~load_mask(c.blurred + k);
  store(block.slot + at, used ? load_mask(c.slot + k) : Int32x8{} + static_cast<std::int32_t>(view.no_slot));
}

LACQUER_ALWAYS_INLINE void prefetch(const PixelGroup& group) {
  const auto* bytes = reinterpret_cast<const char*>(&group);
  for (std::size_t line = 0; line < sizeof(PixelGroup); line += 64) __builtin_prefetch(bytes + line);
}

LACQUER_ALWAYS_INLINE void block_body(const SpherePixels& all, std::size_t begin, std::size_t n, const Constants& constants, bool fetch, SampleBlock& block) {
  const PixelGroup* pixels = &all.group(begin);
  const Terminator& terminator = constants.terminator;
  Columns c;
  block.n_groups = block.n_doubtful = block.n_blurred = 0;
  const std::size_t n_caps = (n + Columns::size - 1) / Columns::size;
  bool dark = terminator.in_shadow(all.cap(begin));
  for (std::size_t cap = 0; cap < n_caps; ++cap) {
    const std::size_t from = cap * Columns::size, first = block.n_groups, end = std::min(n, from + Columns::size);
    const bool skip = std::exchange(dark, cap + 1 == n_caps || terminator.in_shadow(all.cap(begin + end)));
    // The next pixels, which the processor does not fetch by itself, a few at a time while these are computed.
    const PixelGroup* const ahead = dark || !fetch ? nullptr : &pixels[end / width];
    if (skip) {
      for (std::size_t g = 0; ahead != nullptr && g < Columns::size / width; ++g) prefetch(ahead[g]);
      continue;
    }
    std::uint16_t* const group = block.group + first;
    std::size_t m = 0;  // pixels in the columns
    for (std::size_t next = from; next < end; next += width)
      if (light_pixels(pixels[next / width], end - next, constants, c, m)) group[m / width] = static_cast<std::uint16_t>(next), m += width;
    for (std::size_t k = 0, g = 0; k < m; k += width) {
      for (; ahead != nullptr && g * m < (k + width) * Columns::size / width; ++g) prefetch(ahead[g]);
      irradiance(pixels[group[k / width] / width], constants, c, k);
    }
    for (std::size_t k = 0; k < m; k += width) sines(c, k);
    for (std::size_t k = 0; k < m; k += width) angles(c, k);
    for (std::size_t k = 0; k < m; k += width) cells(constants, c, k);
    for (std::size_t k = 0; k < m; k += width) footprint(pixels[group[k / width] / width], constants, c, k);
    for (std::size_t k = 0; k < m; k += width) weigh(constants, c, k, block, first * width + k);
    for (std::size_t k = 0; k < m; k += width) {
      const Int32x8 lit = load_mask(c.lit + k), doubtful = load_mask(c.doubtful + k) & lit;
      if (!any(doubtful | (load_mask(c.blurred + k) & lit))) continue;
      for (std::size_t i = k; i < k + width; ++i) {
        if (c.lit[i] == 0) continue;
        if (c.doubtful[i] != 0) block.doubtful[block.n_doubtful++] = static_cast<std::uint16_t>(first * width + i);
        else block.n_blurred += c.blurred[i] != 0;
      }
    }
    block.n_groups += m / width;
  }
}

using BlockLoop = void(const SpherePixels&, std::size_t, std::size_t, const Constants&, bool, SampleBlock&);
void block_baseline(const SpherePixels& pixels, std::size_t begin, std::size_t n, const Constants& view, bool fetch, SampleBlock& block) {
  block_body(pixels, begin, n, view, fetch, block);
}
#ifdef LACQUER_TARGET_AVX2_FMA
LACQUER_TARGET_AVX2_FMA void block_avx2_fma(const SpherePixels& pixels, std::size_t begin, std::size_t n, const Constants& view, bool fetch, SampleBlock& block) {
  block_body(pixels, begin, n, view, fetch, block);
}
#endif

BlockLoop* choose_loop([[maybe_unused]] bool vectors) {
#ifdef LACQUER_TARGET_AVX2_FMA
  if (vectors && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return block_avx2_fma;
#endif
  return block_baseline;
}
BlockLoop* block_loop = choose_loop(true);

}  // namespace

SampleKernel::SampleKernel(const KernelView& view) : constants_(std::make_unique<const Constants>(view)) {}
SampleKernel::SampleKernel(SampleKernel&&) noexcept = default;
SampleKernel::~SampleKernel() = default;

void SampleKernel::sample(const SpherePixels& pixels, std::size_t begin, std::size_t n, bool fetch, SampleBlock& block) const {
  block_loop(pixels, begin, n, *constants_, fetch, block);
}

void use_sample_vectors(bool yes) { block_loop = choose_loop(yes); }

}  // namespace lacquer::calib
