#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

/// Short vectors with exp and log for the loops that evaluate the model in bulk. Each operation is one IEEE operation per lane, never a
/// fused one (but under LACQUER_TARGET_AVX2_FMA), so that a loop compiled for SSE2 and for AVX2 gives the same bytes. Everything is inlined into the loop, whose function
/// carries the target attribute; include this in .cpp files only.
#if defined(__x86_64__) && defined(__GNUC__)
#define LACQUER_TARGET_AVX2 __attribute__((target("avx2")))
/// The compiler may fuse multiplications and additions here: other last digits than on a processor without.
#define LACQUER_TARGET_AVX2_FMA __attribute__((target("avx2,fma")))
#endif
#define LACQUER_ALWAYS_INLINE inline __attribute__((always_inline))
#ifndef __clang__
#pragma GCC diagnostic ignored "-Wpsabi"  // vectors wider than the baseline's registers are passed by always-inlined functions only
#endif

namespace lacquer::brdf {

typedef double Double4 __attribute__((vector_size(32)));
typedef std::int64_t Int64x2 __attribute__((vector_size(16)));
typedef std::int64_t Int64x4 __attribute__((vector_size(32)));
typedef std::uint64_t UInt64x4 __attribute__((vector_size(32)));
typedef float Float4 __attribute__((vector_size(16)));
typedef float Float8 __attribute__((vector_size(32)));
typedef std::int32_t Int32x8 __attribute__((vector_size(32)));
typedef std::uint32_t UInt32x8 __attribute__((vector_size(32)));

LACQUER_ALWAYS_INLINE Double4 splat(double x) { return Double4{x, x, x, x}; }
LACQUER_ALWAYS_INLINE Float8 splat(float x) { return Float8{x, x, x, x, x, x, x, x}; }

template <typename Vector, typename Scalar>
LACQUER_ALWAYS_INLINE Vector load(const Scalar* from) {
  Vector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
template <typename Vector, typename Scalar>
LACQUER_ALWAYS_INLINE void store(Scalar* to, Vector v) {
  std::memcpy(to, &v, sizeof v);
}
LACQUER_ALWAYS_INLINE Double4 load_as_double(const float* f) { return Double4{f[0], f[1], f[2], f[3]}; }  // GCC 12 makes one conversion of this

/// `mask`: result of a comparison, all bits of a lane set or none.
LACQUER_ALWAYS_INLINE Double4 select(Int64x4 mask, Double4 yes, Double4 no) { return mask ? yes : no; }
LACQUER_ALWAYS_INLINE Float8 select(Int32x8 mask, Float8 yes, Float8 no) { return mask ? yes : no; }
LACQUER_ALWAYS_INLINE bool any(Int64x4 mask) {
  const Int64x2 halves = __builtin_shufflevector(mask, mask, 0, 1) | __builtin_shufflevector(mask, mask, 2, 3);
  return (halves[0] | halves[1]) != 0;
}
LACQUER_ALWAYS_INLINE Double4 absolute(Double4 x) { return (Double4)((UInt64x4)x & 0x7fffffffffffffffu); }
LACQUER_ALWAYS_INLINE Double4 minimum(Double4 a, Double4 b) { return a < b ? a : b; }
LACQUER_ALWAYS_INLINE Double4 maximum(Double4 a, Double4 b) { return a > b ? a : b; }
LACQUER_ALWAYS_INLINE Float8 minimum(Float8 a, Float8 b) { return a < b ? a : b; }
LACQUER_ALWAYS_INLINE Float8 maximum(Float8 a, Float8 b) { return a > b ? a : b; }

/// Sum of the lanes, always in this order.
LACQUER_ALWAYS_INLINE double sum_of_lanes(Double4 x) { return (x[0] + x[1]) + (x[2] + x[3]); }

/// e^x to 2 ulp for x <= 709; 0 below -708, where the result would leave the normal range.
LACQUER_ALWAYS_INLINE Double4 exp(Double4 x) {
  constexpr double magic = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer, which then lies in the low bits
  const Int64x4 vanishes = x < splat(-708.0);
  const Double4 clamped = maximum(minimum(x, splat(709.0)), splat(-708.0));
  const Double4 shifted = clamped * splat(1.4426950408889634) + splat(magic);
  const Double4 n = shifted - splat(magic);
  const Double4 r = (clamped - n * splat(6.93147180369123816490e-01)) - n * splat(1.90821492927058770002e-10);  // ln 2 in two parts
  // Taylor to r^13 / 13!, |r| <= ln(2) / 2: what is left out is below 5e-18.
  Double4 p = splat(1.0 / 6227020800.0);
  p = p * r + splat(1.0 / 479001600.0);
  p = p * r + splat(1.0 / 39916800.0);
  p = p * r + splat(1.0 / 3628800.0);
  p = p * r + splat(1.0 / 362880.0);
  p = p * r + splat(1.0 / 40320.0);
  p = p * r + splat(1.0 / 5040.0);
  p = p * r + splat(1.0 / 720.0);
  p = p * r + splat(1.0 / 120.0);
  p = p * r + splat(1.0 / 24.0);
  p = p * r + splat(1.0 / 6.0);
  p = p * r + splat(0.5);
  p = p * r + splat(1.0);
  p = p * r + splat(1.0);
  const Double4 scaled = (Double4)((UInt64x4)p + ((UInt64x4)shifted << 52));
  return (Double4)((Int64x4)scaled & ~vanishes);
}

/// Natural logarithm of positive normal numbers, below 1 ulp; the polynomial of fdlibm's e_log.c (Sun Microsystems 1993). Anything else
/// gives some finite number.
LACQUER_ALWAYS_INLINE Double4 log(Double4 x) {
  constexpr std::uint64_t root_half = 0x3fe6a09e667f3bcd;  // bits of sqrt(1/2)
  const UInt64x4 u = (UInt64x4)x + (0x3ff0000000000000u - root_half);
  const Double4 k = (Double4)((u >> 52) | 0x4330000000000000u) - splat(4503599627370496.0 + 1023.0);
  const Double4 f = (Double4)((u & 0x000fffffffffffffu) + root_half) - splat(1.0);
  const Double4 s = f / (splat(2.0) + f), z = s * s, w = z * z;
  const Double4 even = w * (splat(3.999999999940941908e-01) + w * (splat(2.222219843214978396e-01) + w * splat(1.531383769920937332e-01)));
  const Double4 odd = z * (splat(6.666666666666735130e-01) +
                           w * (splat(2.857142874366239149e-01) + w * (splat(1.818357216161805012e-01) + w * splat(1.479819860511658591e-01))));
  const Double4 half_square = splat(0.5) * f * f;
  return k * splat(6.93147180369123816490e-01) -
         ((half_square - (s * (half_square + (even + odd)) + k * splat(1.90821492927058770002e-10))) - f);
}

}  // namespace lacquer::brdf
