#include "libbrdf/cook_torrance_array.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "libbrdf/vector_math.h"

namespace lacquer::brdf {

namespace {

constexpr std::size_t width = 8;

/// A float whose last 12 bits of the mantissa are 0: the product of two such numbers is exact.
LACQUER_ALWAYS_INLINE Float8 leading(Float8 x) { return (Float8)((UInt32x8)x & 0xfffff000u); }
float leading(float x) { return std::bit_cast<float>(std::bit_cast<std::uint32_t>(x) & 0xfffff000u); }

/// A lobe as the loop needs it.
struct FlatLobe {
  float strength;     ///< largest ks / (pi m^2)
  float ks[3];        ///< of the largest one
  float r;
  float rate, rate_leading, rate_rest;  ///< log2(e) / m^2, rounded and in two parts
};

std::vector<FlatLobe> flat_lobes(const CookTorrance& model) {
  std::vector<FlatLobe> lobes;
  for (const auto& lobe : model.lobes) {
    FlatLobe flat;
    const double inverse_m2 = 1 / (lobe.m * lobe.m), rate = std::numbers::log2e * inverse_m2;
    const double largest = std::max({lobe.ks.x, lobe.ks.y, lobe.ks.z});
    flat.strength = static_cast<float>(largest * std::numbers::inv_pi * inverse_m2);
    for (int c = 0; c < 3; ++c) flat.ks[c] = largest > 0 ? static_cast<float>(lobe.ks[c] / largest) : 0;
    flat.r = static_cast<float>(lobe.r);
    flat.rate = static_cast<float>(rate);
    flat.rate_leading = leading(flat.rate);
    flat.rate_rest = static_cast<float>(rate - double{flat.rate_leading});
    lobes.push_back(flat);
  }
  return lobes;
}

/// x 2^n for whole n in [-252, 0], in two steps so that a large x brings a small factor back.
LACQUER_ALWAYS_INLINE Float8 scaled(Float8 x, Float8 n) {
  constexpr float magic = 12582912.0f;  // 1.5 * 2^23, see exp of vector_math.h
  const Float8 shifted_half = n * splat(0.5f) + splat(magic), half = shifted_half - splat(magic), rest = n - half;
  const UInt32x8 first = ((UInt32x8)shifted_half << 23) + 0x3f800000u, second = ((UInt32x8)(rest + splat(magic)) << 23) + 0x3f800000u;
  return (x * (Float8)first) * (Float8)second;
}

/// Lobe of the channel with the largest ks: strength F G / ((n.wi)(n.wo) cos^4) exp(-tan^2/m^2); scaled down last, so that only a result
/// that is tiny itself underflows. The exponent in units of ln 2 is q = tan^2 rate, whose whole
/// part n may be hundreds: only the exact product of the leading parts leaves a fraction that is right to the last bits of a float.
LACQUER_ALWAYS_INLINE Float8 lobe_value(const FlatLobe& lobe, Float8 tan2, Float8 tan2_leading, Float8 schlick, Float8 front) {
  constexpr float magic = 12582912.0f;
  const Float8 q = minimum(tan2 * splat(lobe.rate), splat(250.0f));
  const Float8 n = (q + splat(magic)) - splat(magic);
  const Float8 exact = tan2_leading * splat(lobe.rate_leading);
  const Float8 fraction = (exact - n) + (tan2_leading * splat(lobe.rate_rest) + (tan2 - tan2_leading) * splat(lobe.rate));
  const Int32x8 vanishes = q >= splat(250.0f);
  // 2^-fraction, |fraction| <= 0.5: Taylor in ln 2 * fraction to the 6th power, relative error 1.2e-7.
  const Float8 x = fraction * splat(-0.693147180559945f);
  Float8 p = splat(1.0f / 720);
  p = p * x + splat(1.0f / 120);
  p = p * x + splat(1.0f / 24);
  p = p * x + splat(1.0f / 6);
  p = p * x + splat(0.5f);
  p = p * x + splat(1.0f);
  p = p * x + splat(1.0f);
  const Float8 fresnel = splat(lobe.r) * (splat(1.0f) - schlick) + schlick;
  const Float8 value = scaled(fresnel * front * (p * splat(lobe.strength)), -n);
  return (Float8)((Int32x8)value & ~vanishes);
}

struct Flat {
  float kd_over_pi[3];
  const FlatLobe* lobes;
  std::size_t n_lobes;
};

LACQUER_ALWAYS_INLINE void evaluate_8(const Flat& model, Float8 ni, Float8 no, Float8 nh, Float8 ih, Float8 tan2, Float8* f) {
  const Float8 one = splat(1.0f);
  // G / (n.wi n.wo), with one division for the smaller of the two branches.
  const Float8 product = ni * no, larger = ih * maximum(ni, no);
  const Int32x8 shadowed = (nh + nh) * product < larger;
  const Float8 geometry = select(shadowed, nh + nh, one) / select(shadowed, larger, product);
  const Float8 inverse_nh2 = one / (nh * nh);
  const Float8 front = geometry * inverse_nh2 * inverse_nh2;
  const Float8 away = one - ih, away2 = away * away, schlick = away2 * away2 * away;
  const Float8 tan2_leading = leading(tan2);
  for (int c = 0; c < 3; ++c) f[c] = splat(model.kd_over_pi[c]);
  for (std::size_t l = 0; l < model.n_lobes; ++l) {
    const Float8 value = lobe_value(model.lobes[l], tan2, tan2_leading, schlick, front);
    for (int c = 0; c < 3; ++c) f[c] += splat(model.lobes[l].ks[c]) * value;
  }
}

LACQUER_ALWAYS_INLINE Float8 load_some(const float* from, std::size_t n) {
  Float8 x = splat(1.0f);
  std::memcpy(&x, from, n * sizeof(float));
  return x;
}

LACQUER_ALWAYS_INLINE void evaluate_body(const Flat& model, const CosineArrays& c, std::size_t n, float* const out[3]) {
  Float8 f[3];
  std::size_t i = 0;
  for (; i + width <= n; i += width) {
    evaluate_8(model, load<Float8>(c.n_dot_i + i), load<Float8>(c.n_dot_o + i), load<Float8>(c.n_dot_h + i), load<Float8>(c.i_dot_h + i),
               load<Float8>(c.tan2_theta_h + i), f);
    for (int k = 0; k < 3; ++k) store(out[k] + i, f[k]);
  }
  if (i == n) return;
  evaluate_8(model, load_some(c.n_dot_i + i, n - i), load_some(c.n_dot_o + i, n - i), load_some(c.n_dot_h + i, n - i),
             load_some(c.i_dot_h + i, n - i), load_some(c.tan2_theta_h + i, n - i), f);
  for (int k = 0; k < 3; ++k) std::memcpy(out[k] + i, &f[k], (n - i) * sizeof(float));
}

using Loop = void(const Flat&, const CosineArrays&, std::size_t, float* const*);

void evaluate_baseline(const Flat& model, const CosineArrays& c, std::size_t n, float* const* out) { evaluate_body(model, c, n, out); }
#ifdef LACQUER_TARGET_AVX2
LACQUER_TARGET_AVX2 void evaluate_avx2(const Flat& model, const CosineArrays& c, std::size_t n, float* const* out) {
  evaluate_body(model, c, n, out);
}
#endif

Loop* choose([[maybe_unused]] bool vectors) {
#ifdef LACQUER_TARGET_AVX2
  if (vectors && __builtin_cpu_supports("avx2")) return evaluate_avx2;
#endif
  return evaluate_baseline;
}

Loop* loop = choose(true);

}  // namespace

void use_vector_evaluation(bool yes) { loop = choose(yes); }

void evaluate(const CookTorrance& model, const CosineArrays& cosines, std::size_t n, float* const out[3]) {
  const std::vector<FlatLobe> lobes = flat_lobes(model);
  Flat flat{{}, lobes.data(), lobes.size()};
  for (int c = 0; c < 3; ++c) flat.kd_over_pi[c] = static_cast<float>(model.kd[c] * std::numbers::inv_pi);
  loop(flat, cosines, n, out);
}

}  // namespace lacquer::brdf
