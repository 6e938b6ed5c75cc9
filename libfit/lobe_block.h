#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/vector_math.h"
#include "libfit/observations.h"
#include "libfit/parameters.h"

/// One lobe at a block of cells, with derivatives: what the loops of kernels.cpp, the only place that includes this, are made of.
namespace lacquer::fit::kernel {

using brdf::Double4;
using brdf::load;
using brdf::load_as_double;
using brdf::splat;
using brdf::store;

inline constexpr std::size_t width = 4, block = 64;  // cells; a block's columns stay in the first-level cache

struct alignas(32) Column {
  double v[block];
};

/// n^2 - 1 of a dielectric with its first and second derivative by the reflectance r at normal incidence.
struct IndexStep {
  double value = 0, by_r = 0, by_r2 = 0;
  explicit IndexStep(double r) {
    const double s = std::sqrt(r), n = (1 + s) / (1 - s), s_r = 0.5 / s, s_rr = -0.25 / (s * r);
    const double n_s = 2 / ((1 - s) * (1 - s)), n_r = n_s * s_r, n_rr = 2 * n_s / (1 - s) * s_r * s_r + n_s * s_rr;
    value = n * n - 1, by_r = 2 * n * n_r, by_r2 = 2 * n_r * n_r + 2 * n * n_rr;
  }
};

/// A lobe without its ks as the loops need it.
struct FlatLobe {
  double m2 = 1, r = 0;
  bool ggx = false, dielectric = false;
  IndexStep index{0.5};
};

/// A model as the loops need it.
struct FlatModel {
  int n_lobes;
  std::array<double, 3> kd_over_pi;
  std::array<std::array<double, 3>, max_lobes> ks;
  std::array<FlatLobe, max_lobes> lobes;

  FlatModel(const brdf::CookTorrance& model, int first_channel) : n_lobes(static_cast<int>(model.lobes.size())) {
    for (int c = 0; c < 3; ++c) kd_over_pi[c] = model.kd[std::min(first_channel + c, 2)] * std::numbers::inv_pi;
    for (int l = 0; l < n_lobes; ++l) {
      const auto& lobe = model.lobes[static_cast<std::size_t>(l)];
      for (int c = 0; c < 3; ++c) ks[l][c] = lobe.ks[std::min(first_channel + c, 2)];
      lobes[l].m2 = lobe.m * lobe.m;
      lobes[l].r = lobe.r;
      lobes[l].ggx = lobe.distribution == brdf::Distribution::ggx;
      lobes[l].dielectric = lobe.fresnel == brdf::Fresnel::dielectric;
      if (lobes[l].dielectric) lobes[l].index = IndexStep(lobe.r);
    }
  }
};

/// Up to `block` cells of a set; what is beyond the end weighs nothing.
struct Block {
  Column tan2, schlick, front, along, across, mixed;
  Column target[3], inverse_sigma[3];
};

LACQUER_ALWAYS_INLINE void copy_padded(const std::vector<float>& from, std::size_t begin, std::size_t n, double padding, Column& to) {
  if (n == block) {
    for (std::size_t k = 0; k < block; k += width) store(to.v + k, load_as_double(from.data() + begin + k));
    return;
  }
  for (std::size_t k = 0; k < n; ++k) to.v[k] = double{from[begin + k]};
  for (std::size_t k = n; k < block; ++k) to.v[k] = padding;
}

LACQUER_ALWAYS_INLINE void read_geometry(const CellSet& set, std::size_t begin, std::size_t n, Block& b) {
  copy_padded(set.tan2_theta_h, begin, n, 0, b.tan2);
  copy_padded(set.schlick_weight, begin, n, 0, b.schlick);
  copy_padded(set.front, begin, n, 0, b.front);
  if (set.along.empty()) return;
  copy_padded(set.along, begin, n, 0, b.along);
  copy_padded(set.across, begin, n, 0, b.across);
  copy_padded(set.mixed, begin, n, 0, b.mixed);
}

LACQUER_ALWAYS_INLINE void read_values(const CellSet& set, std::size_t begin, std::size_t n, Block& b) {
  for (int c = 0; c < set.n_channels; ++c) {
    copy_padded(set.channels[static_cast<std::size_t>(c)].target, begin, n, 1, b.target[c]);
    copy_padded(set.channels[static_cast<std::size_t>(c)].inverse_sigma, begin, n, 0, b.inverse_sigma[c]);
  }
}

/// A lobe's distribution of slopes, exp(-q) or 1/(1 + q)^2 over sqrt(det M) with q = s^T M^-1 s, and the first and second derivative of
/// its logarithm by ln(m); see brdf::CookTorranceLobe.
struct Slopes {
  Double4 value, slope, curvature;
};

LACQUER_ALWAYS_INLINE Double4 root(Double4 x) {
  return Double4{__builtin_sqrt(x[0]), __builtin_sqrt(x[1]), __builtin_sqrt(x[2]), __builtin_sqrt(x[3])};
}

LACQUER_ALWAYS_INLINE Slopes point_slopes(bool ggx, double m2, Double4 tan2) {
  const Double4 two = splat(2.0), q = tan2 * splat(1 / m2);
  if (!ggx) return {brdf::exp(-q) * splat(1 / m2), two * q - two, splat(-4.0) * q};
  const Double4 w = splat(1.0) / (splat(1.0) + q);
  return {w * w * splat(1 / m2), splat(4.0) * q * w - two, splat(-8.0) * q * w * w};
}

/// With M = m^2 + k V (k = 2, GGX 4) and u = m^2: q = t (u + k Vcc) / det, det = (u + k Vaa)(u + k Vcc) - k^2 Vac^2; d/dln(m) = 2 u d/du.
LACQUER_ALWAYS_INLINE Slopes blurred_slopes(bool ggx, double m2, const Double4& tan2, const Double4& v_along, const Double4& v_across,
                                            const Double4& v_mixed) {
  const Double4 u = splat(m2), one = splat(1.0), two = splat(2.0), k = splat(ggx ? 4.0 : 2.0);
  const Double4 along = u + k * v_along, across = u + k * v_across;
  const Double4 inverse = one / (along * across - k * k * v_mixed * v_mixed);
  const Double4 trace = (along + across) * inverse;  // det' / det
  const Double4 a = tan2 * inverse, q = a * across;
  const Double4 dq = a - q * trace;                                         // by u
  const Double4 ddq = two * (q * (trace * trace - inverse) - a * trace);
  Double4 value = root(inverse), d = -dq, dd = -ddq;  // of the logarithm, by u
  if (ggx) {
    const Double4 w = one / (one + q);
    value *= w * w;
    d = -two * w * dq;
    dd = two * w * (w * dq * dq - ddq);
  } else {
    value *= brdf::exp(-q);
  }
  d -= splat(0.5) * trace;
  dd += splat(0.5) * trace * trace - inverse;
  return {value, two * u * d, splat(4.0) * u * (d + u * dd)};
}

/// Reflectance of a lobe with its first and second derivative by r.
struct Reflectance {
  Double4 value, by_r, by_r2;
};

LACQUER_ALWAYS_INLINE Reflectance schlick_reflectance(double r, Double4 weight) {
  const Double4 rest = splat(1.0) - weight;
  return {splat(r) * rest + weight, rest, splat(0.0)};
}

/// A number with its first and second derivative by one variable.
struct Jet {
  Double4 v, d, dd;
};
LACQUER_ALWAYS_INLINE Jet times(const Jet& a, const Jet& b) {
  return {a.v * b.v, a.v * b.d + a.d * b.v, a.v * b.dd + splat(2.0) * a.d * b.d + a.dd * b.v};
}
LACQUER_ALWAYS_INLINE Jet over(const Jet& a, const Jet& b) {
  const Double4 inverse = splat(1.0) / b.v, v = a.v * inverse, d = (a.d - v * b.d) * inverse;
  return {v, d, (a.dd - v * b.dd - splat(2.0) * d * b.d) * inverse};
}
LACQUER_ALWAYS_INLINE Jet root(const Jet& a) {
  const Double4 v = root(a.v), half = splat(0.5) / v, d = a.d * half;
  return {v, d, (a.dd - splat(2.0) * d * d) * half};
}
LACQUER_ALWAYS_INLINE Jet plus(const Jet& a, Double4 b) { return {a.v + b, a.d, a.dd}; }
LACQUER_ALWAYS_INLINE Jet times(const Jet& a, Double4 b) { return {a.v * b, a.d * b, a.dd * b}; }

/// brdf::dielectric_reflectance, with g^2 = (n^2 - 1) + cos^2 and g - cos = (n^2 - 1) / (g + cos), which do not cancel.
LACQUER_ALWAYS_INLINE Reflectance dielectric_reflectance(const IndexStep& index, Double4 weight) {
  const Double4 cosine = splat(1.0) - brdf::exp(splat(0.2) * brdf::log(weight));  // the inverse of Schlick's weight
  const Jet step{splat(index.value), splat(index.by_r), splat(index.by_r2)};
  const Jet sum = plus(root(plus(step, cosine * cosine)), cosine), difference = over(step, sum);
  const Jet parallel = over(plus(times(sum, cosine), splat(-1.0)), plus(times(difference, cosine), splat(1.0)));
  const Jet across = over(difference, sum);
  const Jet f = times(times(across, across), times(plus(times(parallel, parallel), splat(1.0)), splat(0.5)));
  return {f.v, f.d, f.dd};
}

/// Columns of one lobe for ks = 1: the value, its derivatives by ln(m) and r, and the second ones by ln(m) twice, ln(m) and r, r twice.
struct LobeColumns {
  Column *value, *by_log_m = nullptr, *by_r = nullptr, *by_log_m2 = nullptr, *by_log_m_r = nullptr, *by_r2 = nullptr;
};

/// `usual`: Beckmann and Schlick, without the branches that other forms need.
template <bool derivatives, bool second, bool usual>
LACQUER_ALWAYS_INLINE void evaluate_lobe_of(const Block& b, bool footprints, const FlatLobe& lobe, const LobeColumns& out) {
  const bool ggx = !usual && lobe.ggx, dielectric = !usual && lobe.dielectric;
  for (std::size_t k = 0; k < block; k += width) {
    const Double4 tan2 = load<Double4>(b.tan2.v + k), weight = load<Double4>(b.schlick.v + k);
    const Slopes g = footprints ? blurred_slopes(ggx, lobe.m2, tan2, load<Double4>(b.along.v + k), load<Double4>(b.across.v + k),
                                                 load<Double4>(b.mixed.v + k))
                                : point_slopes(ggx, lobe.m2, tan2);
    const Reflectance fresnel = dielectric ? dielectric_reflectance(lobe.index, weight) : schlick_reflectance(lobe.r, weight);
    const Double4 bare = g.value * load<Double4>(b.front.v + k);
    const Double4 value = fresnel.value * bare;
    store(out.value->v + k, value);
    if constexpr (derivatives) {
      const Double4 by_r = fresnel.by_r * bare;
      store(out.by_log_m->v + k, value * g.slope);
      store(out.by_r->v + k, by_r);
      if constexpr (second) {
        store(out.by_log_m2->v + k, value * (g.slope * g.slope + g.curvature));
        store(out.by_log_m_r->v + k, by_r * g.slope);
        if constexpr (!usual) store(out.by_r2->v + k, fresnel.by_r2 * bare);
      }
    }
  }
}

template <bool derivatives, bool second>
LACQUER_ALWAYS_INLINE void evaluate_lobe(const Block& b, bool footprints, const FlatLobe& lobe, const LobeColumns& out) {
  if (lobe.ggx || lobe.dielectric)
    evaluate_lobe_of<derivatives, second, false>(b, footprints, lobe, out);
  else
    evaluate_lobe_of<derivatives, second, true>(b, footprints, lobe, out);
}

}  // namespace lacquer::fit::kernel
