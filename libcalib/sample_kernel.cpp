#include "libcalib/sample_kernel.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

#include "libbrdf/table_accumulator.h"
#include "libbrdf/vector_math.h"

namespace lacquer::calib {

namespace {

using brdf::Double4;
using brdf::Float4;
using brdf::Float8;
using brdf::Int32x8;
using brdf::load;
using brdf::maximum;
using brdf::minimum;
using brdf::select;
using brdf::splat;
using brdf::store;
using brdf::UInt32x8;

constexpr float pi = std::numbers::pi_v<float>;
constexpr std::size_t width = SampleBlock::width;

/// What rounding in float may do: to components of unit vectors and to cosines, some units in the last place of 1.
constexpr float rounding = 4e-7f;

LACQUER_ALWAYS_INLINE bool any(Int32x8 m) {
  return brdf::any((brdf::Int64x4)m);
}
LACQUER_ALWAYS_INLINE Float8 absolute(Float8 x) { return (Float8)((UInt32x8)x & 0x7fffffffu); }

LACQUER_ALWAYS_INLINE Float8 root(Float8 x) {
  return Float8{__builtin_sqrtf(x[0]), __builtin_sqrtf(x[1]), __builtin_sqrtf(x[2]), __builtin_sqrtf(x[3]),
                __builtin_sqrtf(x[4]), __builtin_sqrtf(x[5]), __builtin_sqrtf(x[6]), __builtin_sqrtf(x[7])};
}

/// Eight doubles, for what would cancel in float.
struct Wide {
  Double4 low, high;
};
LACQUER_ALWAYS_INLINE Wide wide(Double4 x) { return {x, x}; }
LACQUER_ALWAYS_INLINE Wide operator+(const Wide& a, const Wide& b) { return {a.low + b.low, a.high + b.high}; }
LACQUER_ALWAYS_INLINE Wide operator-(const Wide& a, const Wide& b) { return {a.low - b.low, a.high - b.high}; }
LACQUER_ALWAYS_INLINE Wide operator*(const Wide& a, const Wide& b) { return {a.low * b.low, a.high * b.high}; }
LACQUER_ALWAYS_INLINE Float8 narrow(const Wide& x) {
  return __builtin_shufflevector(__builtin_convertvector(x.low, Float4), __builtin_convertvector(x.high, Float4), 0, 1, 2, 3, 4, 5, 6, 7);
}
struct Normal {
  Wide x, y, z;
};
LACQUER_ALWAYS_INLINE Wide load_wide(const double* from) { return {load<Double4>(from), load<Double4>(from + 4)}; }
LACQUER_ALWAYS_INLINE Normal load_normal(const PixelGroup& p) { return {load_wide(p.normal[0]), load_wide(p.normal[1]), load_wide(p.normal[2])}; }
struct DoubleVector {
  Double4 x, y, z;
  explicit DoubleVector(const glm::dvec3& v) : x(brdf::splat(v.x)), y(brdf::splat(v.y)), z(brdf::splat(v.z)) {}
};
LACQUER_ALWAYS_INLINE Wide dot(const Normal& n, const DoubleVector& v) { return n.x * wide(v.x) + n.y * wide(v.y) + n.z * wide(v.z); }

/// atan(y / x) for x, y >= 0, in [0, pi/2]; 0 for 0 / 0. Above tan(pi/8): pi/4 + atan((a - 1) / (a + 1)); the polynomial is the
/// Chebyshev interpolant of atan(z) / z in z^2 (error 2e-8).
LACQUER_ALWAYS_INLINE Float8 arctangent(Float8 y, Float8 x) {
  const Int32x8 steep = y > x;
  const Float8 small = minimum(x, y), large = maximum(maximum(x, y), splat(1e-30f));
  const Int32x8 wide = small > large * splat(0.41421356f);
  const Float8 z = select(wide, small - large, small) / select(wide, small + large, large), u = z * z;
  Float8 p = splat(0.0797629181f);
  p = p * u - splat(0.138484902f);
  p = p * u + splat(0.199740824f);
  p = p * u - splat(0.333327858f);
  p = p * u + splat(0.999999981f);
  const Float8 a = p * z + select(wide, splat(pi / 4), splat(0.0f));
  return select(steep, splat(pi / 2) - a, a);
}

/// (1 - x)^g for x in [0, 0.2]: ln(1 - x) = 2 artanh(-x / (2 - x)), e^y by powers of two and Taylor's series.
LACQUER_ALWAYS_INLINE Float8 power_of_one_minus(Float8 below_one, Float8 g) {
  const Float8 z = (splat(0.0f) - below_one) / (splat(2.0f) - below_one), u = z * z;
  const Float8 log = z * (splat(2.0f) + u * (splat(2.0f / 3) + u * (splat(0.4f) + u * splat(2.0f / 7))));
  const Float8 x = maximum(g * log, splat(-80.0f));
  constexpr float magic = 12582912.0f;  // 1.5 * 2^23
  const Float8 shifted = x * splat(1.44269504f) + splat(magic), n = shifted - splat(magic);
  const Float8 r = (x - n * splat(0.693359375f)) + n * splat(2.12194440e-4f);  // ln 2 in two parts
  Float8 p = splat(1.0f / 720);
  p = p * r + splat(1.0f / 120);
  p = p * r + splat(1.0f / 24);
  p = p * r + splat(1.0f / 6);
  p = p * r + splat(0.5f);
  p = p * r + splat(1.0f);
  p = p * r + splat(1.0f);
  return (Float8)((UInt32x8)p + ((UInt32x8)shifted << 23));
}

/// Cell of a coordinate in units of cells, and whether an error of rounding_doubt + doubt / size might move it to another one.
struct CellOf {
  Float8 cell;
  Int32x8 doubtful;
};
LACQUER_ALWAYS_INLINE CellOf cell_of(Float8 x, int n, float rounding_doubt, float doubt, Float8 size) {
  const Float8 cell = __builtin_convertvector(__builtin_convertvector(minimum(x, splat(static_cast<float>(n) - 0.5f)), Int32x8), Float8);
  const Float8 fraction = x - cell;
  return {cell, (minimum(fraction, splat(1.0f) - fraction) - splat(rounding_doubt)) * size < splat(doubt)};
}

/// What is the same for all pixels of a view, in every lane: the compiler would otherwise spread it again for every group.
struct Constants {
  DoubleVector light, camera, axis, camera_x_light;
  Double4 surface;          // the light stands at n . light - surface in front of the tangent plane
  Double4 light_distance2, two_radii;  // distance^2 to a point is the first less the second times (n . light)
  Double4 light_dot_camera, light_dot_axis, radius_in_double;
  Float8 radius, lowest_cosine, safe_cosine, blur2, emitter, narrow2, nine_narrow2, inverse_reference, half_exponent;
  bool distant, has_falloff, has_emitter;
  const brdf::ReachableCells* cells = &brdf::reachable_cells();
  explicit Constants(const KernelView& v)
      : light(v.light), camera(v.camera), axis(v.axis), camera_x_light(glm::cross(v.camera, v.light)),
        surface(brdf::splat(v.distant ? 0 : v.sphere_radius)),
        light_distance2(brdf::splat(glm::dot(v.light, v.light) + v.sphere_radius * v.sphere_radius)),
        two_radii(brdf::splat(2 * v.sphere_radius)),
        light_dot_camera(brdf::splat(glm::dot(v.light, v.camera))),
        light_dot_axis(brdf::splat(glm::dot(v.light, v.axis))),
        radius_in_double(brdf::splat(v.sphere_radius)),
        radius(splat(static_cast<float>(v.sphere_radius))),
        lowest_cosine(splat(v.min_cosine - rounding)),
        safe_cosine(splat(v.min_cosine + rounding)),
        blur2(splat(v.blur2)),
        emitter(splat(v.diameter * v.diameter / 64)),
        narrow2(splat(v.narrowest_m * v.narrowest_m)),
        nine_narrow2(splat(9 * v.narrowest_m * v.narrowest_m)),
        inverse_reference(splat(1 / v.reference)),
        half_exponent(splat(v.falloff_exponent / 2)),
        distant(v.distant), has_falloff(!v.distant && v.falloff_exponent != 0), has_emitter(!v.distant && v.diameter > 0) {}
};

struct Spread {
  Float8 along, across, mixed;
};

/// The pixels of a few groups between the stages below, which are short so that the processor can work on several groups at a time.
/// Directions are in the camera frame of each pixel: light (light_x, light_y, cos_i), camera (sin_o, 0, cos_o).
struct Columns {
  static constexpr std::size_t size = 64;
  typedef float Column[size];
  alignas(32) Column cos_i, light_x, light_y, inverse_light_distance, falloff_sin2;
  Column sin_h, length;  // the first times the second, which is that of the sum of both directions
  Column theta_h, theta_d, phi_d, offset_h, offset_d, offset_p, along, across, mixed;
  alignas(32) std::int32_t lit[size], doubtful[size], blurred[size], cell[size];
};
LACQUER_ALWAYS_INLINE Int32x8 load_mask(const std::int32_t* from) { return load<Int32x8>(from); }

/// In the camera frame; `e` the unit vector along the half vector's tangential part.
struct Local {
  Float8 x, y, sin_o, sin_h, length, inverse_length, e_x, e_y;
  Float8 per_light, per_camera;  // sphere's radius over the distance
};

/// Of the half vector's slope over pixel and lens blur; see half_vector_footprint, whose equations these are.
LACQUER_ALWAYS_INLINE Spread pixel_spread(const PixelGroup& p, const Constants& view, const Local& t) {
  Spread v{splat(0.0f), splat(0.0f), splat(0.0f)};
  const Float8 light_along = t.x * t.e_x + t.y * t.e_y, camera_along = t.sin_o * t.e_x, camera_across = splat(0.0f) - t.sin_o * t.e_y;
  const Float8 cos_d = t.length * splat(0.5f);
  for (int axis = 0; axis < 2; ++axis) {
    const Float8 x = load<Float8>(p.step[axis][0]), y = load<Float8>(p.step[axis][1]);
    const Float8 along = x * t.e_x + y * t.e_y, across = y * t.e_x - x * t.e_y;
    const Float8 of_light = t.x * x + t.y * y, of_camera = t.sin_o * x, of_half = (of_light + of_camera) * t.inverse_length;
    const Float8 turn = t.per_light * (of_light * light_along - along) + t.per_camera * (of_camera * camera_along - along);
    const Float8 turn_across = t.per_camera * (of_camera * camera_across - across) - t.per_light * (of_light * camera_across + across);
    const Float8 turn_half = t.per_light * (of_light * cos_d - of_half) + t.per_camera * (of_camera * cos_d - of_half);
    const Float8 a = (turn - t.sin_h * turn_half) * t.inverse_length - along, b = turn_across * t.inverse_length - across;
    v.along += a * a;
    v.across += b * b;
    v.mixed += a * b;
  }
  return {v.along * view.blur2, v.across * view.blur2, v.mixed * view.blur2};
}

LACQUER_ALWAYS_INLINE Float8 low_pairs(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13); }
LACQUER_ALWAYS_INLINE Float8 high_pairs(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15); }
LACQUER_ALWAYS_INLINE Float8 low_fours(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13); }
LACQUER_ALWAYS_INLINE Float8 high_fours(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15); }

/// Lane k of column j becomes member j of sample k.
LACQUER_ALWAYS_INLINE void store_transposed(const Float8 (&c)[8], PixelSample* to) {
  const Float8 p0 = low_pairs(c[0], c[1]), p1 = high_pairs(c[0], c[1]), p2 = low_pairs(c[2], c[3]), p3 = high_pairs(c[2], c[3]);
  const Float8 p4 = low_pairs(c[4], c[5]), p5 = high_pairs(c[4], c[5]), p6 = low_pairs(c[6], c[7]), p7 = high_pairs(c[6], c[7]);
  const Float8 left[4] = {low_fours(p0, p2), high_fours(p0, p2), low_fours(p1, p3), high_fours(p1, p3)};
  const Float8 right[4] = {low_fours(p4, p6), high_fours(p4, p6), low_fours(p5, p7), high_fours(p5, p7)};
  for (int k = 0; k < 4; ++k) {
    store(to + k, __builtin_shufflevector(left[k], right[k], 0, 1, 2, 3, 8, 9, 10, 11));
    store(to + k + 4, __builtin_shufflevector(left[k], right[k], 4, 5, 6, 7, 12, 13, 14, 15));
  }
}

/// First stage, of eight pixels: their light; false where none reaches any of them.
LACQUER_ALWAYS_INLINE bool light_pixels(const PixelGroup& p, const Constants& view, Columns& c, std::size_t to) {
  const Normal n = load_normal(p);
  const Wide n_dot_light = dot(n, view.light);
  Float8 cos_i = narrow(n_dot_light - wide(view.surface)), inverse_light_distance = splat(1.0f);
  Wide distance2{};
  if (!view.distant) {
    distance2 = wide(view.light_distance2) - wide(view.two_radii) * n_dot_light;
    inverse_light_distance = splat(1.0f) / root(narrow(distance2));
    cos_i = cos_i * inverse_light_distance;
  }
  const Int32x8 lit = cos_i > view.lowest_cosine;
  if (!any(lit)) return false;
  Int32x8 doubtful = (cos_i < view.safe_cosine) | (load<Float8>(p.sin_o) < splat(1e-3f));

  // The light's parts across the normal are small differences near the middle of the sphere.
  const Float8 scale = load<Float8>(p.inverse_rim) * inverse_light_distance;
  store(c.light_x + to, narrow(wide(view.light_dot_camera) - n_dot_light * dot(n, view.camera)) * scale);
  store(c.light_y + to, narrow(dot(n, view.camera_x_light)) * scale);
  if (view.has_falloff) {
    const Wide along_axis = wide(view.light_dot_axis) - wide(view.radius_in_double) * dot(n, view.axis);  // minus distance times cosine
    const Float8 sin2 = narrow(distance2 - along_axis * along_axis) * inverse_light_distance * inverse_light_distance;
    doubtful |= (sin2 > splat(0.2f)) | (narrow(along_axis) > splat(0.0f));
    store(c.falloff_sin2 + to, minimum(maximum(sin2, splat(0.0f)), splat(0.2f)));
  }
  store(c.cos_i + to, cos_i);
  store(c.inverse_light_distance + to, inverse_light_distance);
  store(c.lit + to, lit);
  store(c.doubtful + to, doubtful & lit);
  return true;
}

/// Angles as in half_diff, without a shading frame: n x h / sin(theta_h) stands for its azimuth, and since the difference of the
/// directions is normal to h, its part along theta is -(cos_i - cos_o) / sin(theta_h).
LACQUER_ALWAYS_INLINE void angles(const PixelGroup& p, Columns& c, std::size_t k) {
  const Float8 zero = splat(0.0f), cos_i = load<Float8>(c.cos_i + k), light_x = load<Float8>(c.light_x + k), light_y = load<Float8>(c.light_y + k);
  const Float8 cos_o = load<Float8>(p.cos_o), sin_o = load<Float8>(p.sin_o);
  const Float8 along_normal = maximum(cos_i + cos_o, zero), along_x = light_x + sin_o, across_x = light_x - sin_o, descent = cos_i - cos_o;
  const Float8 y2 = light_y * light_y, tangential2 = along_x * along_x + y2;
  const Float8 sin_h = root(tangential2), length = root(tangential2 + along_normal * along_normal);
  const Float8 sin_d = root(across_x * across_x + y2 + descent * descent);
  const Float8 theta_h = arctangent(sin_h, along_normal), theta_d = arctangent(sin_d, length);
  const Float8 y = splat(2.0f) * sin_o * light_y, x = zero - descent * length;
  const Float8 steep_phi = arctangent(absolute(y), absolute(x));
  store(c.sin_h + k, sin_h);
  store(c.length + k, length);
  store(c.theta_h + k, theta_h);
  store(c.theta_d + k, theta_d);
  store(c.phi_d + k, select((x < zero) ^ (y < zero), splat(pi) - steep_phi, steep_phi));
}

/// Cells, and offsets from their centres.
LACQUER_ALWAYS_INLINE void cells(Columns& c, std::size_t k) {
  using Grid = brdf::TableGrid;
  constexpr float n_h = Grid::n_theta_h, n_d = Grid::n_theta_d, n_p = Grid::n_phi_d;
  const Float8 theta_h = load<Float8>(c.theta_h + k), theta_d = load<Float8>(c.theta_d + k), phi_d = load<Float8>(c.phi_d + k);
  const Float8 root_h = root(theta_h * splat(2 / pi)), sin_d = theta_d * splat(4 / pi);  // of which the length is at least that
  const CellOf h = cell_of(root_h * splat(n_h), Grid::n_theta_h, 2e-5f, rounding * n_h / pi, root_h + splat(1e-6f));
  const CellOf d = cell_of(theta_d * splat(2 / pi * n_d), Grid::n_theta_d, 0, 2e-5f + rounding * 60, splat(1.0f));
  const CellOf q = cell_of(phi_d * splat(1 / pi * n_p), Grid::n_phi_d, 4e-5f, 8 * rounding / pi * n_p, load<Float8>(c.sin_h + k) * sin_d + splat(1e-12f));
  const Float8 root_centre = (h.cell + splat(0.5f)) * splat(1 / n_h);
  store(c.offset_h + k, theta_h - root_centre * root_centre * splat(pi / 2));
  store(c.offset_d + k, theta_d - (d.cell + splat(0.5f)) * splat(pi / 2 / n_d));
  store(c.offset_p + k, phi_d - (q.cell + splat(0.5f)) * splat(pi / n_p));
  store(c.cell + k, __builtin_convertvector(h.cell, Int32x8) << 16 | __builtin_convertvector(d.cell, Int32x8) << 8 | __builtin_convertvector(q.cell, Int32x8));
  store(c.doubtful + k, load_mask(c.doubtful + k) | ((h.doubtful | d.doubtful | q.doubtful) & load_mask(c.lit + k)));
}

/// Footprint, and whether it exceeds a narrow peak.
LACQUER_ALWAYS_INLINE void footprint(const PixelGroup& p, const Constants& view, Columns& c, std::size_t k) {
  const Float8 zero = splat(0.0f), one = splat(1.0f), tiny = splat(1e-30f);
  const Float8 cos_o = load<Float8>(p.cos_o), sin_o = load<Float8>(p.sin_o);
  const Float8 light_x = load<Float8>(c.light_x + k), light_y = load<Float8>(c.light_y + k), sin_h = load<Float8>(c.sin_h + k);
  const Float8 length = load<Float8>(c.length + k), inverse_length = one / (length + tiny), inverse_sin = one / (sin_h + tiny);
  const Float8 inverse_light_distance = load<Float8>(c.inverse_light_distance + k);
  Spread v = pixel_spread(p, view,
                          {light_x, light_y, sin_o, sin_h * inverse_length, length, inverse_length, (light_x + sin_o) * inverse_sin, light_y * inverse_sin,
                           view.distant ? zero : view.radius * inverse_light_distance, view.radius * load<Float8>(p.inverse_distance)});
  if (view.has_emitter) {
    const Float8 in_plane = view.emitter * inverse_light_distance * inverse_light_distance;
    const Float8 off_plane = in_plane * splat(4.0f) * inverse_length * inverse_length;  // 1 / cos^2(theta_d)
    const Float8 y = splat(2.0f) * sin_o * light_y, x = (cos_o - load<Float8>(c.cos_i + k)) * length;  // of phi_d
    const Float8 xx = x * x, yy = y * y, inverse = one / (xx + yy + tiny), c2 = xx * inverse, s2 = yy * inverse;
    v.along += in_plane * c2 + off_plane * s2;
    v.across += in_plane * s2 + off_plane * c2;
    v.mixed += (in_plane - off_plane) * (x * y * inverse);
  }
  const Float8 theta_h = load<Float8>(c.theta_h + k), half_difference = (v.along - v.across) * splat(0.5f);
  const Float8 larger = (v.along + v.across) * splat(0.5f) + root(half_difference * half_difference + v.mixed * v.mixed);
  const Float8 beyond_m = larger - view.narrow2, peak = view.nine_narrow2 + larger * splat(18.0f), beyond_peak = theta_h * theta_h - peak;
  const Int32x8 doubtful = (absolute(beyond_m) < splat(1e-4f) * larger) | ((beyond_m > zero) & (absolute(beyond_peak) < splat(1e-4f) * peak));
  store(c.along + k, v.along);
  store(c.across + k, v.across);
  store(c.mixed + k, v.mixed);
  store(c.blurred + k, (beyond_m > zero) & (beyond_peak < zero));
  store(c.doubtful + k, load_mask(c.doubtful + k) | (doubtful & load_mask(c.lit + k)));
}

/// Last stage: irradiance relative to that on the light's axis at the sphere's centre, and what that weighs.
LACQUER_ALWAYS_INLINE void weigh(const Constants& view, const Columns& c, std::size_t k, PixelSample* to) {
  Float8 weight = load<Float8>(c.cos_i + k);
  if (!view.distant) {
    const Float8 inverse_light_distance = load<Float8>(c.inverse_light_distance + k);
    weight = weight * (inverse_light_distance * inverse_light_distance) * view.inverse_reference;
    if (view.has_falloff) weight = weight * power_of_one_minus(load<Float8>(c.falloff_sin2 + k), view.half_exponent);
  }
  const Int32x8 lit = load_mask(c.lit + k), doubtful = load_mask(c.doubtful + k), cell = load_mask(c.cell + k);
  const Int32x8 fate = (load_mask(c.blurred + k) & lit & ~doubtful & std::int32_t{PixelSample::blurred}) |
                       (doubtful & std::int32_t{PixelSample::doubtful}) | (~lit & std::int32_t{PixelSample::grazing});
  Float8 squared_slope;
  for (std::size_t i = 0; i < width; ++i) squared_slope[i] = view.cells->squared_slope(c.cell[k + i] >> 16);
  const Float8 offset_h = load<Float8>(c.offset_h + k), weighted_h = weight * offset_h;
  const Float8 columns[8] = {weight, weighted_h, weight * load<Float8>(c.offset_d + k), weight * load<Float8>(c.offset_p + k),
                             weight * load<Float8>(c.along + k) + squared_slope * (weighted_h * offset_h), weight * load<Float8>(c.across + k),
                             weight * load<Float8>(c.mixed + k), (Float8)(fate << 24 | cell)};
  store_transposed(columns, to);
}

LACQUER_ALWAYS_INLINE void block_body(const PixelGroup* pixels, std::size_t n, const KernelView& view, SampleBlock& block) {
  const Constants constants(view);
  Columns c;
  std::size_t doubts = 0;
  block.n_groups = 0;
  for (std::size_t next = 0; next < n;) {
    const std::size_t first = block.n_groups, end = std::min(n, next + Columns::size);
    std::uint16_t* const group = block.group + first;
    std::size_t m = 0;  // pixels in the columns
    for (; next < end; next += width) {
      const auto* ahead = reinterpret_cast<const char*>(&pixels[next / width] + 4);  // that far the processor does not look itself
      for (std::size_t line = 0; line < sizeof(PixelGroup); line += 64) __builtin_prefetch(ahead + line);
      if (light_pixels(pixels[next / width], constants, c, m)) group[m / width] = static_cast<std::uint16_t>(next), m += width;
    }
    for (std::size_t k = 0; k < m; k += width) angles(pixels[group[k / width] / width], c, k);
    for (std::size_t k = 0; k < m; k += width) cells(c, k);
    for (std::size_t k = 0; k < m; k += width) footprint(pixels[group[k / width] / width], constants, c, k);
    for (std::size_t k = 0; k < m; k += width) weigh(constants, c, k, block.sample + first * width + k);
    for (std::size_t k = 0; k < m; k += width)
      for (std::size_t i = k; any(load_mask(c.doubtful + k)) && i < k + width; ++i) {
        block.doubtful[doubts] = static_cast<std::uint16_t>(first * width + i);
        doubts += c.doubtful[i] != 0 && group[k / width] + i - k < n;
      }
    block.n_groups += m / width;
  }
  block.n_doubtful = doubts;
}

using BlockLoop = void(const PixelGroup*, std::size_t, const KernelView&, SampleBlock&);
void block_baseline(const PixelGroup* pixels, std::size_t n, const KernelView& view, SampleBlock& block) {
  block_body(pixels, n, view, block);
}
#ifdef LACQUER_TARGET_AVX2
LACQUER_TARGET_AVX2 void block_avx2(const PixelGroup* pixels, std::size_t n, const KernelView& view, SampleBlock& block) {
  block_body(pixels, n, view, block);
}
#endif

BlockLoop* choose_loop([[maybe_unused]] bool vectors) {
#ifdef LACQUER_TARGET_AVX2
  if (vectors && __builtin_cpu_supports("avx2")) return block_avx2;
#endif
  return block_baseline;
}
BlockLoop* block_loop = choose_loop(true);

}  // namespace

CameraFrame camera_frame(const glm::dvec3& n, const glm::dvec3& camera) {
  const glm::dvec3 tangential = camera - n * glm::dot(n, camera);
  const double length = glm::length(tangential);
  const glm::dvec3 any = glm::cross(n, std::abs(n.x) < 0.5 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0));
  const glm::dvec3 x = length > 1e-9 * glm::length(camera) ? tangential / length : glm::normalize(any);
  return {x, glm::cross(n, x), length};
}

void SpherePixels::push_back(std::uint32_t pixel, const glm::dvec3& normal, const glm::dvec3& camera, bool central, double radius,
                             const glm::dvec3& step_x, const glm::dvec3& step_y, float inverse_lens) {
  const CameraFrame frame = camera_frame(normal, camera);
  const double distance = central ? glm::length(camera - radius * normal) : 1;
  const bool begins = lane(size) == 0;
  if (begins) groups.emplace_back();
  PixelGroup& g = groups.back();
  for (std::size_t k = lane(size); k < (begins ? width : lane(size) + 1); ++k) {
    for (int i = 0; i < 3; ++i) g.normal[i][k] = normal[i];
    g.cos_o[k] = static_cast<float>((glm::dot(normal, camera) - (central ? radius : 0)) / distance);
    g.sin_o[k] = static_cast<float>(frame.tangential / distance);
    g.inverse_rim[k] = static_cast<float>(1 / std::max(frame.tangential, 1e-9));
    g.inverse_distance[k] = static_cast<float>(central ? 1 / distance : 0);
    for (int axis = 0; axis < 2; ++axis) {
      const glm::dvec3& change = axis == 0 ? step_x : step_y;
      g.step[axis][0][k] = static_cast<float>(glm::dot(change, frame.x));
      g.step[axis][1][k] = static_cast<float>(glm::dot(change, frame.y));
    }
    g.inverse_transmission[k] = inverse_lens;
    g.index[k] = pixel;
  }
  ++size;
}

void sample_block(const SpherePixels& pixels, std::size_t begin, std::size_t n, const KernelView& view, SampleBlock& block) {
  block_loop(&pixels.group(begin), n, view, block);
}

void use_sample_vectors(bool yes) { block_loop = choose_loop(yes); }

}  // namespace lacquer::calib
