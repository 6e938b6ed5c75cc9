#include "libbrdf/cook_torrance_array.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "libbrdf/vector_math.h"

namespace lacquer::brdf {

namespace {

constexpr std::size_t width = 8;

/// Larger exponents in units of ln 2 give 0 for any strength; as a float's biased exponent it just fits.
constexpr float largest_exponent = 254.0f;

/// A number in every lane: compilers fill vectors from memory faster than they spread a number.
/// What holds them says alignas: the baseline aligns wide vectors to 16 bytes only.
using Lanes = Float8;

/// A lobe as the loop needs it.
struct alignas(32) FlatLobe {
  Lanes strength;  ///< largest ks / (pi m^2)
  Lanes ks[3];     ///< of the largest one
  Lanes r, index2_minus_1;  ///< square of the index of refraction, dielectric only
  Lanes inverse_m2;
  Lanes rate, rate_rest;    ///< log2(e) / m^2, rounded and what that leaves
  Lanes farthest;           ///< tan^2 beyond which the lobe is 0
  Lanes power[6];           ///< strength times the coefficients of 2^-x
  bool ggx, dielectric;
};

/// 2^-x for |x| <= 0.5 to 1e-7: least largest relative error among polynomials of this degree.
constexpr double power_of_two[6] = {1.0000001192092896,  -0.6931469440460205,  0.24022120237350464,
                                    -0.05550713464617729, 0.009675546549260616, -0.0013276481768116355};

std::vector<FlatLobe> flat_lobes(const CookTorrance& model) {
  const auto lanes = [](double x, Lanes& to) { to = splat(static_cast<float>(x)); };
  std::vector<FlatLobe> lobes(model.lobes.size());
  for (std::size_t l = 0; l < lobes.size(); ++l) {
    const auto& lobe = model.lobes[l];
    FlatLobe& flat = lobes[l];
    const double inverse_m2 = 1 / (lobe.m * lobe.m), rate = std::numbers::log2e * inverse_m2;
    const double largest = std::max({lobe.ks.x, lobe.ks.y, lobe.ks.z}), strength = largest * std::numbers::inv_pi * inverse_m2;
    const double root = std::sqrt(lobe.r), index = (1 + root) / (1 - root);
    lanes(strength, flat.strength);
    for (int c = 0; c < 3; ++c) lanes(largest > 0 ? lobe.ks[c] / largest : 0, flat.ks[c]);
    lanes(lobe.r, flat.r);
    lanes(index * index - 1, flat.index2_minus_1);
    lanes(inverse_m2, flat.inverse_m2);
    lanes(rate, flat.rate);
    lanes(rate - double{static_cast<float>(rate)}, flat.rate_rest);
    lanes(double{largest_exponent} / rate, flat.farthest);
    for (int k = 0; k < 6; ++k) lanes(strength * power_of_two[k], flat.power[k]);
    flat.ggx = lobe.distribution == Distribution::ggx;
    flat.dielectric = lobe.fresnel == Fresnel::dielectric;
  }
  return lobes;
}

LACQUER_ALWAYS_INLINE Float8 root(Float8 x) {
  Float8 y;
  for (int i = 0; i < 8; ++i) y[i] = __builtin_sqrtf(x[i]);
  return y;
}

/// dielectric_reflectance of vectors, with `step` = n^2 - 1: g^2 = step + cos^2 and g - cos = step / (g + cos) do not cancel.
LACQUER_ALWAYS_INLINE Float8 dielectric(Float8 step, Float8 ih) {
  const Float8 one = splat(1.0f);
  const Float8 sum = root(step + ih * ih) + ih, difference = step / sum;
  const Float8 parallel = (ih * sum - one) / (ih * difference + one), across = difference / sum;
  return across * across * (splat(0.5f) + splat(0.5f) * parallel * parallel);
}

/// Lobe of the channel with the largest ks: strength * `light` * exp(-tan^2/m^2) with light = F G / ((n.wi)(n.wo) cos^4). The exponent in
/// units of ln 2 is q = tan^2 rate, rounded by at most 2^-24 q: 5e-6 of the result where that is still a normal float. Its whole part n
/// is taken off the exponent of the product, so that only a result that is tiny itself becomes 0.
LACQUER_ALWAYS_INLINE Float8 beckmann_value(const FlatLobe& lobe, Float8 tan2, Float8 light) {
  constexpr float magic = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer, which then lies in the low bits
  constexpr std::int32_t smallest_normal = 0x00800000;
  const Float8 t = minimum(tan2, lobe.farthest);
  const Float8 q = t * lobe.rate;
  const Float8 shifted = q + splat(magic), n = shifted - splat(magic);
  const Float8 x = (q - n) + t * lobe.rate_rest;
  // In pairs (Estrin): a third of the time that the terms one after the other would have to wait for each other.
  const Float8 x2 = x * x;
  const Float8 p = (lobe.power[0] + lobe.power[1] * x) + x2 * ((lobe.power[2] + lobe.power[3] * x) + x2 * (lobe.power[4] + lobe.power[5] * x));
  const Int32x8 bits = (Int32x8)(light * p) - (Int32x8)((UInt32x8)shifted << 23);
  return (Float8)(bits & (bits > smallest_normal));
}

LACQUER_ALWAYS_INLINE Float8 ggx_value(const FlatLobe& lobe, Float8 tan2, Float8 light) {
  const Float8 d = splat(1.0f) / (splat(1.0f) + tan2 * lobe.inverse_m2);
  return (light * d) * (d * lobe.strength);
}

struct alignas(32) Flat {
  Lanes kd_over_pi[3];
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
  const Float8 away = one - ih, away2 = away * away, schlick = away2 * away2 * away, rest = one - schlick;
  for (int c = 0; c < 3; ++c) f[c] = model.kd_over_pi[c];
  for (std::size_t l = 0; l < model.n_lobes; ++l) {
    const FlatLobe& lobe = model.lobes[l];
    const Float8 light = front * (lobe.dielectric ? dielectric(lobe.index2_minus_1, ih) : lobe.r * rest + schlick);
    const Float8 value = lobe.ggx ? ggx_value(lobe, tan2, light) : beckmann_value(lobe, tan2, light);
    for (int c = 0; c < 3; ++c) f[c] += lobe.ks[c] * value;
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
  Flat flat{.kd_over_pi = {}, .lobes = lobes.data(), .n_lobes = lobes.size()};
  for (int c = 0; c < 3; ++c) flat.kd_over_pi[c] = splat(static_cast<float>(model.kd[c] * std::numbers::inv_pi));
  loop(flat, cosines, n, out);
}

}  // namespace lacquer::brdf
