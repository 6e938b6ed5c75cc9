#pragma once

#include <cstddef>
#include <glm/vec3.hpp>
#include <numbers>

#include "libbrdf/vector_math.h"
#include "libcalib/sphere_pixels.h"

/// Eight pixels side by side: what sample_kernel.cpp and sample_accumulation.cpp calculate with. Include this there only, for the reasons of
/// vector_math.h.
namespace lacquer::calib::kernel {

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

LACQUER_ALWAYS_INLINE Float8 low_pairs(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13); }
LACQUER_ALWAYS_INLINE Float8 high_pairs(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15); }
LACQUER_ALWAYS_INLINE Float8 low_fours(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13); }
LACQUER_ALWAYS_INLINE Float8 high_fours(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15); }

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
/// In steps of PixelGroup::normal_step; what it is multiplied by is to be as much smaller.
struct Normal {
  Wide x, y, z;
};
LACQUER_ALWAYS_INLINE Wide load_wide(const std::int32_t* from) {
  const auto four = [](const std::int32_t* i) { return Double4{double(i[0]), double(i[1]), double(i[2]), double(i[3])}; };
  return {four(from), four(from + 4)};
}
LACQUER_ALWAYS_INLINE Normal load_normal(const PixelGroup& p) { return {load_wide(p.normal[0]), load_wide(p.normal[1]), load_wide(p.normal[2])}; }
struct DoubleVector {
  Double4 x, y, z;
  explicit DoubleVector(const glm::dvec3& v)
      : x(brdf::splat(v.x * PixelGroup::normal_step)), y(brdf::splat(v.y * PixelGroup::normal_step)), z(brdf::splat(v.z * PixelGroup::normal_step)) {}
};
LACQUER_ALWAYS_INLINE Wide dot(const Normal& n, const DoubleVector& v) { return n.x * wide(v.x) + n.y * wide(v.y) + n.z * wide(v.z); }

/// c[0] + c[1] x + ... + c[7] x^7, in few steps that wait for each other.
LACQUER_ALWAYS_INLINE Float8 polynomial(Float8 x, const Float8 (&c)[8]) {
  const Float8 x2 = x * x, x4 = x2 * x2;
  const Float8 low = (c[3] * x + c[2]) * x2 + (c[1] * x + c[0]), high = (c[7] * x + c[6]) * x2 + (c[5] * x + c[4]);
  return high * x4 + low;
}

/// Angle of sine `y` and cosine `x`, both >= 0, in [0, pi/2], from the smaller one: the Chebyshev interpolant of asin(z) / z in z^2 (error 1.5e-8).
LACQUER_ALWAYS_INLINE Float8 angle_of(Float8 y, Float8 x) {
  const Float8 z = minimum(x, y);
  const Float8 a = z * polynomial(z * z, {splat(0.999999989f), splat(0.166669575f), splat(0.0748801093f), splat(0.046494938f), splat(0.0166412983f),
                                          splat(0.0758322594f), splat(-0.0905528898f), splat(0.109964259f)});
  return select(y > x, splat(pi / 2) - a, a);
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

}  // namespace lacquer::calib::kernel
