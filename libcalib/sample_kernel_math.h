#pragma once

#include <cstddef>
#include <cstdint>
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
using brdf::load_as_double;
using brdf::maximum;
using brdf::minimum;
using brdf::select;
using brdf::splat;
using brdf::store;
using brdf::UInt32x8;

constexpr float pi = std::numbers::pi_v<float>;

/// What rounding in float may do: to components of unit vectors and to cosines, some units in the last place of 1; for a distant light and camera.
constexpr float rounding = 4e-7f;

LACQUER_ALWAYS_INLINE bool any(Int32x8 m) {
  return brdf::any((brdf::Int64x4)m);
}
LACQUER_ALWAYS_INLINE Float8 load_as_float(const std::int16_t* i) {
  return __builtin_convertvector((Int32x8{i[0], i[1], i[2], i[3], i[4], i[5], i[6], i[7]}), Float8);
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

LACQUER_ALWAYS_INLINE Float8 low_halves(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11); }
LACQUER_ALWAYS_INLINE Float8 high_halves(Float8 a, Float8 b) { return __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15); }

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
LACQUER_ALWAYS_INLINE CellOf cell_of(Float8 x, int n, float rounding_doubt, Float8 doubt, Float8 size) {
  const Float8 cell = __builtin_convertvector(__builtin_convertvector(minimum(x, splat(static_cast<float>(n) - 0.5f)), Int32x8), Float8);
  const Float8 fraction = x - cell;
  return {cell, (minimum(fraction, splat(1.0f) - fraction) - splat(rounding_doubt)) * size < doubt};
}

}  // namespace lacquer::calib::kernel
