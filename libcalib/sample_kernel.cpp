#include "libcalib/sample_kernel.h"

#include <cmath>
#include <numbers>

#include "libbrdf/table.h"
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
constexpr std::size_t width = 8;

/// What rounding in float may do: to components of unit vectors and to cosines, some units in the last place of 1.
constexpr float rounding = 4e-7f;

LACQUER_ALWAYS_INLINE bool any(Int32x8 m) {
  return ((m[0] | m[1]) | (m[2] | m[3]) | (m[4] | m[5]) | (m[6] | m[7])) != 0;
}
LACQUER_ALWAYS_INLINE Float8 absolute(Float8 x) { return (Float8)((UInt32x8)x & 0x7fffffffu); }
LACQUER_ALWAYS_INLINE Float8 root(Float8 x) {
  return Float8{__builtin_sqrtf(x[0]), __builtin_sqrtf(x[1]), __builtin_sqrtf(x[2]), __builtin_sqrtf(x[3]),
                __builtin_sqrtf(x[4]), __builtin_sqrtf(x[5]), __builtin_sqrtf(x[6]), __builtin_sqrtf(x[7])};
}

struct Vector {
  Float8 x, y, z;
};
LACQUER_ALWAYS_INLINE Vector splat3(const glm::dvec3& v) {
  return {splat(static_cast<float>(v.x)), splat(static_cast<float>(v.y)), splat(static_cast<float>(v.z))};
}
LACQUER_ALWAYS_INLINE Vector load3(const std::vector<float> (&v)[3], std::size_t at) {
  return {load<Float8>(v[0].data() + at), load<Float8>(v[1].data() + at), load<Float8>(v[2].data() + at)};
}
LACQUER_ALWAYS_INLINE Float8 load_as_float(const double* from) {
  const Float4 a = __builtin_convertvector(load<Double4>(from), Float4), b = __builtin_convertvector(load<Double4>(from + 4), Float4);
  return Float8{a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]};
}
/// n . v + addend, rounded to float at the end.
LACQUER_ALWAYS_INLINE Float8 dot_in_double(const SpherePixels& pixels, std::size_t at, const glm::dvec3& v, double addend) {
  Float4 half[2];
  for (std::size_t k = 0; k < 2; ++k) {
    const std::size_t i = at + 4 * k;
    half[k] = __builtin_convertvector(brdf::splat(v.x) * load<Double4>(pixels.normal[0].data() + i) + brdf::splat(v.y) * load<Double4>(pixels.normal[1].data() + i) +
                                          (brdf::splat(v.z) * load<Double4>(pixels.normal[2].data() + i) + brdf::splat(addend)),
                                      Float4);
  }
  return Float8{half[0][0], half[0][1], half[0][2], half[0][3], half[1][0], half[1][1], half[1][2], half[1][3]};
}
LACQUER_ALWAYS_INLINE Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
LACQUER_ALWAYS_INLINE Vector operator-(const Vector& a, const Vector& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
LACQUER_ALWAYS_INLINE Vector operator*(const Vector& a, Float8 s) { return {a.x * s, a.y * s, a.z * s}; }
LACQUER_ALWAYS_INLINE Float8 dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
LACQUER_ALWAYS_INLINE Vector cross(const Vector& a, const Vector& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

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
LACQUER_ALWAYS_INLINE Float8 power_of_one_minus(Float8 below_one, float g) {
  const Float8 z = (splat(0.0f) - below_one) / (splat(2.0f) - below_one), u = z * z;
  const Float8 log = z * (splat(2.0f) + u * (splat(2.0f / 3) + u * (splat(0.4f) + u * splat(2.0f / 7))));
  const Float8 x = maximum(splat(g) * log, splat(-80.0f));
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

/// Cell of a coordinate in units of cells and whether rounding by `doubt` might move it to another one.
struct CellOf {
  Float8 cell;
  Int32x8 doubtful;
};
LACQUER_ALWAYS_INLINE CellOf cell_of(Float8 x, int n, Float8 doubt) {
  const Float8 cell = __builtin_convertvector(__builtin_convertvector(minimum(x, splat(static_cast<float>(n) - 0.5f)), Int32x8), Float8);
  const Float8 fraction = x - cell;
  return {cell, (fraction < doubt) | (fraction > splat(1.0f) - doubt)};
}

struct Spread {
  Float8 along, across, mixed;
};
struct SpreadTerms {
  Vector wi, wo, h, along, across;
  Float8 inverse_length, inverse_light_distance, inverse_camera_distance;
};

/// Of the half vector's slope over pixel and lens blur; see half_vector_footprint, whose equations these are.
LACQUER_ALWAYS_INLINE Spread pixel_spread(const SpherePixels& pixels, std::size_t at, const KernelView& view, const SpreadTerms& t) {
  Spread v{splat(0.0f), splat(0.0f), splat(0.0f)};
  const Float8 h_along = dot(t.h, t.along);
  for (int axis = 0; axis < 2; ++axis) {
    const Vector dn = load3(pixels.normal_step[axis], at), dp = dn * splat(view.sphere_radius);
    Vector dsum{splat(0.0f), splat(0.0f), splat(0.0f)};
    if (!view.distant) dsum = (t.wi * dot(t.wi, dp) - dp) * t.inverse_light_distance;
    if (view.central) dsum = dsum + (t.wo * dot(t.wo, dp) - dp) * t.inverse_camera_distance;
    const Float8 a = (dot(dsum, t.along) - dot(t.h, dsum) * h_along) * t.inverse_length - dot(dn, t.along);
    const Float8 b = dot(dsum, t.across) * t.inverse_length - dot(dn, t.across);
    v.along += a * a;
    v.across += b * b;
    v.mixed += a * b;
  }
  const Float8 blur2 = splat(view.blur2);
  return {v.along * blur2, v.across * blur2, v.mixed * blur2};
}

LACQUER_ALWAYS_INLINE void eight_pixels(const SpherePixels& pixels, std::size_t at, std::size_t to, const KernelView& view, SampleBlock& block) {
  const Float8 one = splat(1.0f), zero = splat(0.0f), tiny = splat(1e-30f);
  // What the irradiance follows from is computed in double: the weight must be good to a few 1e-7.
  Float8 cos_i = dot_in_double(pixels, at, view.light, -view.surface), distance2 = one, inverse_light_distance = one;
  if (!view.distant) {
    distance2 = splat(view.light_distance2) - splat(2 * view.sphere_radius) * cos_i;  // here cos_i is still times the distance
    inverse_light_distance = one / root(distance2);
    cos_i = cos_i * inverse_light_distance;
  }
  const Int32x8 lit = cos_i > splat(view.min_cosine - rounding);
  if (!any(lit)) {
    store(block.fate + to, Int32x8{} + std::int32_t{SampleBlock::grazing});
    return;
  }
  const Vector n{load_as_float(pixels.normal[0].data() + at), load_as_float(pixels.normal[1].data() + at),
                 load_as_float(pixels.normal[2].data() + at)};
  const Vector p = n * splat(view.sphere_radius);
  Vector wi = splat3(view.light);
  if (!view.distant) wi = (wi - p) * inverse_light_distance;
  Int32x8 doubtful = cos_i < splat(view.min_cosine + rounding);
  Vector wo = splat3(view.camera);
  Float8 inverse_camera_distance = zero;
  if (view.central) {
    const Vector to_camera = wo - p;
    inverse_camera_distance = one / root(dot(to_camera, to_camera));
    wo = to_camera * inverse_camera_distance;
  }
  const Float8 cos_o = dot(n, wo);

  // Angles as in half_diff, without a shading frame: n x h / sin(theta_h) stands for its azimuth, and since the difference of the
  // directions is normal to h, its part along theta is -(cos_i - cos_o) / sin(theta_h).
  const Vector sum = wi + wo, difference = wi - wo;
  const Float8 along_normal = cos_i + cos_o;
  const Vector tangential = sum - n * along_normal, side = cross(n, sum);
  const Float8 sin_h = root(dot(tangential, tangential)), length = root(dot(sum, sum)), sin_d = root(dot(difference, difference));
  const Float8 theta_h = arctangent(sin_h, along_normal), theta_d = arctangent(sin_d, length);
  const Float8 y = dot(difference, side), x = (cos_o - cos_i) * length;
  const Float8 steep_phi = arctangent(absolute(y), absolute(x));
  const Float8 phi_d = select((x < zero) ^ (y < zero), splat(pi) - steep_phi, steep_phi);

  // Cells, and offsets from their centres.
  using Grid = brdf::TableGrid;
  constexpr float n_h = Grid::n_theta_h, n_d = Grid::n_theta_d, n_p = Grid::n_phi_d;
  const Float8 root_h = root(theta_h * splat(2 / pi));
  const CellOf h = cell_of(root_h * splat(n_h), Grid::n_theta_h, splat(2e-5f) + splat(rounding * n_h / pi) / (root_h + splat(1e-6f)));
  const CellOf d = cell_of(theta_d * splat(2 / pi * n_d), Grid::n_theta_d, splat(2e-5f + rounding * 60) / (sin_d + tiny) * minimum(sin_d, one));
  const CellOf q = cell_of(phi_d * splat(1 / pi * n_p), Grid::n_phi_d,
                           splat(4e-5f) + splat(8 * rounding / pi * n_p) / (sin_h * sin_d + splat(1e-12f)));
  doubtful |= h.doubtful | d.doubtful | q.doubtful;
  const Float8 root_centre = (h.cell + splat(0.5f)) * splat(1 / n_h);
  const Float8 offset_h = theta_h - root_centre * root_centre * splat(pi / 2);
  const Float8 offset_d = theta_d - (d.cell + splat(0.5f)) * splat(pi / 2 / n_d);
  const Float8 offset_p = phi_d - (q.cell + splat(0.5f)) * splat(pi / n_p);

  // Footprint.
  const Float8 inverse_length = one / (length + tiny), inverse_sin = one / (sin_h + tiny);
  Spread v = pixel_spread(pixels, at, view,
                          {wi, wo, sum * inverse_length, tangential * inverse_sin, side * inverse_sin, inverse_length, inverse_light_distance,
                           inverse_camera_distance});
  if (!view.distant && view.diameter > 0) {
    const Float8 in_plane = splat(view.diameter * view.diameter / 64) * inverse_light_distance * inverse_light_distance;
    const Float8 off_plane = in_plane * splat(4.0f) * inverse_length * inverse_length;  // 1 / cos^2(theta_d)
    const Float8 xx = x * x, yy = y * y, inverse = one / (xx + yy + tiny), c2 = xx * inverse, s2 = yy * inverse;
    v.along += in_plane * c2 + off_plane * s2;
    v.across += in_plane * s2 + off_plane * c2;
    v.mixed += (in_plane - off_plane) * (x * y * inverse);
  }
  const Float8 half_difference = (v.along - v.across) * splat(0.5f);
  const Float8 larger = (v.along + v.across) * splat(0.5f) + root(half_difference * half_difference + v.mixed * v.mixed);
  const float narrow2 = view.narrowest_m * view.narrowest_m;
  const Float8 beyond_m = larger - splat(narrow2), peak = splat(9 * narrow2) + larger * splat(18.0f), beyond_peak = theta_h * theta_h - peak;
  const Int32x8 blurred = (beyond_m > zero) & (beyond_peak < zero);
  doubtful |= (absolute(beyond_m) < splat(1e-4f) * larger) | ((beyond_m > zero) & (absolute(beyond_peak) < splat(1e-4f) * peak));

  // Irradiance relative to that on the light's axis at the sphere's centre.
  Float8 weight = cos_i;
  if (!view.distant) {
    weight = cos_i * inverse_light_distance * inverse_light_distance * splat(1 / view.reference);
    if (view.falloff_exponent != 0) {
      const Vector off_axis = wi + splat3(view.axis);
      const Float8 below_one = dot(off_axis, off_axis) * splat(0.5f);  // 1 - cos, which float would not resolve as a difference
      doubtful |= below_one > splat(0.2f);
      weight = weight * power_of_one_minus(minimum(below_one, splat(0.2f)), view.falloff_exponent);
    }
  }

  store(block.weight + to, weight);
  store(block.theta_h + to, weight * offset_h);
  store(block.theta_d + to, weight * offset_d);
  store(block.phi_d + to, weight * offset_p);
  store(block.along + to, weight * v.along);
  store(block.across + to, weight * v.across);
  store(block.mixed + to, weight * v.mixed);
  store(block.row + to, __builtin_convertvector(h.cell * splat(n_d) + d.cell, Int32x8));
  store(block.cell_phi_d + to, __builtin_convertvector(q.cell, Int32x8));
  Int32x8 fate = blurred & std::int32_t{SampleBlock::blurred};
  fate = (doubtful & std::int32_t{SampleBlock::doubtful}) | (fate & ~doubtful);
  store(block.fate + to, (fate & lit) | (~lit & std::int32_t{SampleBlock::grazing}));
}

LACQUER_ALWAYS_INLINE void block_body(const SpherePixels& pixels, std::size_t begin, std::size_t n, const KernelView& view, SampleBlock& block) {
  for (std::size_t k = 0; k < n; k += width) eight_pixels(pixels, begin + k, k, view, block);
}

using BlockLoop = void(const SpherePixels&, std::size_t, std::size_t, const KernelView&, SampleBlock&);
void block_baseline(const SpherePixels& pixels, std::size_t begin, std::size_t n, const KernelView& view, SampleBlock& block) {
  block_body(pixels, begin, n, view, block);
}
#ifdef LACQUER_TARGET_AVX2
LACQUER_TARGET_AVX2 void block_avx2(const SpherePixels& pixels, std::size_t begin, std::size_t n, const KernelView& view, SampleBlock& block) {
  block_body(pixels, begin, n, view, block);
}
#endif

BlockLoop* choose_loop([[maybe_unused]] bool vectors) {
#ifdef LACQUER_TARGET_AVX2
  if (vectors && __builtin_cpu_supports("avx2")) return block_avx2;
#endif
  return block_baseline;
}
BlockLoop* block_loop = choose_loop(true);

template <typename T>
void extend(std::vector<T>& to, const std::vector<T>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

}  // namespace

void SpherePixels::push_back(std::uint32_t pixel, const glm::dvec3& n, const glm::vec3& step_x, const glm::vec3& step_y, float inverse_lens,
                             std::uint8_t colour) {
  index.push_back(pixel);
  inverse_transmission.push_back(inverse_lens);
  channel.push_back(colour);
  for (int i = 0; i < 3; ++i) {
    normal[i].push_back(n[i]);
    normal_step[0][i].push_back(step_x[i]);
    normal_step[1][i].push_back(step_y[i]);
  }
  ++size;
}

void SpherePixels::append(const SpherePixels& other) {
  extend(index, other.index);
  extend(inverse_transmission, other.inverse_transmission);
  extend(channel, other.channel);
  for (int i = 0; i < 3; ++i) {
    extend(normal[i], other.normal[i]);
    for (int axis = 0; axis < 2; ++axis) extend(normal_step[axis][i], other.normal_step[axis][i]);
  }
  size += other.size;
}

void SpherePixels::pad() {
  if (size == 0) return;
  const std::size_t padded = (size + width - 1) / width * width;
  for (int i = 0; i < 3; ++i) {
    normal[i].resize(padded, normal[i].back());
    for (int axis = 0; axis < 2; ++axis) normal_step[axis][i].resize(padded, normal_step[axis][i].back());
  }
}

void sample_block(const SpherePixels& pixels, std::size_t begin, std::size_t n, const KernelView& view, SampleBlock& block) {
  block_loop(pixels, begin, n, view, block);
}

void use_sample_vectors(bool yes) { block_loop = choose_loop(yes); }

}  // namespace lacquer::calib
