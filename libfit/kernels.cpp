#include "libfit/kernels.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "libbrdf/vector_math.h"

namespace lacquer::fit {

namespace {

using brdf::absolute;
using brdf::any;
using brdf::Double4;
using brdf::Int64x4;
using brdf::load;
using brdf::load_as_double;
using brdf::select;
using brdf::splat;
using brdf::store;
using brdf::sum_of_lanes;

constexpr std::size_t width = 4, block = 64;   // cells; a block's columns stay in the first-level cache
constexpr double log_floor = 1e-3;             // of the measured value, see Objective
constexpr int tile = 4;                        // columns whose products are summed side by side
constexpr int n_columns = max_local + tile;    // the last ones are zero, so that tiles may overhang

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

/// One value's residual in sigmas, its slope and second derivative by the model's value, Huber's loss of it.
struct Residual {
  Double4 rho, pull, slope, curvature, huber_weight, huber_curvature;
};

LACQUER_ALWAYS_INLINE Residual residual(Double4 f, Double4 signed_target, Double4 signed_inverse_sigma, Double4 robust_scale) {
  const Double4 one = splat(1.0), zero = splat(0.0);
  const Int64x4 linear = signed_inverse_sigma < zero, bound = (signed_target < zero) & ~linear;
  Double4 inverse_sigma = absolute(signed_inverse_sigma), target = signed_target;
  if (any(bound)) {
    target = select(bound, -signed_target, signed_target);
    inverse_sigma = select(bound & (f >= target), zero, inverse_sigma);  // a bound that is kept says nothing
  }
  const Double4 floor = splat(log_floor) * target;
  const Double4 a = select(linear, one, f + floor), b = select(linear, one, target + floor);
  const Double4 inverse = one / (a * b), inverse_a = b * inverse;  // one division for both
  const Double4 value = inverse_sigma * select(linear, f - target, brdf::log(a * (a * inverse)));
  const Double4 slope = inverse_sigma * inverse_a;
  const Double4 size = absolute(value);
  const Int64x4 outlier = size > robust_scale;
  Residual r;
  r.huber_weight = r.huber_curvature = one;
  r.rho = value * value;
  if (any(outlier)) {
    r.huber_weight = select(outlier, robust_scale / size, one);
    r.huber_curvature = select(outlier, zero, one);
    r.rho = select(outlier, robust_scale * (size + size - robust_scale), r.rho);
  }
  r.pull = r.huber_weight * value;
  r.slope = slope;
  r.curvature = select(linear, zero, -slope * inverse_a);
  return r;
}

LACQUER_ALWAYS_INLINE Double4 model_value(const FlatModel& model, int channel, const Column* lobes, std::size_t k) {
  Double4 f = splat(model.kd_over_pi[channel]);
  for (int l = 0; l < model.n_lobes; ++l) f += splat(model.ks[l][channel]) * load<Double4>(lobes[l].v + k);
  return f;
}

/// Sums of one block per channel, still by lanes.
struct alignas(32) LaneSums {  // the baseline aligns wide vectors to 16 bytes only
  Double4 cost{};
  Double4 gradient[max_local]{};
  Double4 curvature[max_local][n_columns]{};
  Double4 extra[max_lobes][3]{};  // sums of pull * slope times the second derivatives by ln(m) twice, ln(m) and r, r twice
};

/// The gradient of the model's value by a channel's parameters, but for the factor ks of the lobe in the derivatives by ln(m) and r, which
/// is the same for all cells: these columns serve every channel.
struct Columns {
  Column basis[n_columns];
  Column scaled[n_columns];
  Column second[max_lobes][3];
  Column pull, factor;
};

template <Curvature kind>
LACQUER_ALWAYS_INLINE void add_channel(const FlatModel& model, int channel, const Block& b, double robust_scale, Columns& columns,
                                       LaneSums& sums) {
  const int n = 1 + 3 * model.n_lobes;
  for (std::size_t k = 0; k < block; k += width) {
    const Residual r = residual(model_value(model, channel, columns.basis + 1, k), load<Double4>(b.target[channel].v + k),
                                load<Double4>(b.inverse_sigma[channel].v + k), splat(robust_scale));
    sums.cost += r.rho;
    store(columns.pull.v + k, r.pull * r.slope);
    if constexpr (kind == Curvature::gauss_newton)
      store(columns.factor.v + k, r.huber_weight * r.slope * r.slope);
    else
      store(columns.factor.v + k, r.huber_curvature * r.slope * r.slope + r.pull * r.curvature);
  }
  for (int i = 0; i < n; ++i) {
    Double4 sum = sums.gradient[i];
    for (std::size_t k = 0; k < block; k += width) {
      const Double4 x = load<Double4>(columns.basis[i].v + k);
      sum += x * load<Double4>(columns.pull.v + k);
      store(columns.scaled[i].v + k, x * load<Double4>(columns.factor.v + k));
    }
    sums.gradient[i] = sum;
  }
  for (int i = 0; i < n; ++i)
    for (int j = i; j < n; j += tile) {
      Double4 s0 = sums.curvature[i][j], s1 = sums.curvature[i][j + 1], s2 = sums.curvature[i][j + 2], s3 = sums.curvature[i][j + 3];
      for (std::size_t k = 0; k < block; k += width) {
        const Double4 x = load<Double4>(columns.scaled[i].v + k);
        s0 += x * load<Double4>(columns.basis[j].v + k);
        s1 += x * load<Double4>(columns.basis[j + 1].v + k);
        s2 += x * load<Double4>(columns.basis[j + 2].v + k);
        s3 += x * load<Double4>(columns.basis[j + 3].v + k);
      }
      sums.curvature[i][j] = s0, sums.curvature[i][j + 1] = s1, sums.curvature[i][j + 2] = s2, sums.curvature[i][j + 3] = s3;
    }
  if constexpr (kind == Curvature::newton) {
    for (int l = 0; l < model.n_lobes; ++l)
      for (int which = 0; which < (model.lobes[l].dielectric ? 3 : 2); ++which) {
        Double4 sum = sums.extra[l][which];
        for (std::size_t k = 0; k < block; k += width)
          sum += load<Double4>(columns.second[l][which].v + k) * load<Double4>(columns.pull.v + k);
        sums.extra[l][which] = sum;
      }
  }
}

template <Curvature kind>
LACQUER_ALWAYS_INLINE void quadratic_body(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model, double robust_scale,
                                          LaneSums* sums) {
  Block b;
  Columns columns;
  const int n = 1 + 3 * model.n_lobes;
  for (std::size_t k = 0; k < block; ++k) columns.basis[0].v[k] = std::numbers::inv_pi;
  for (int j = n; j < n + tile; ++j)
    for (std::size_t k = 0; k < block; ++k) columns.basis[j].v[k] = 0;
  for (std::size_t at = begin; at < end; at += block) {
    const std::size_t size = std::min(block, end - at);
    read_geometry(set, at, size, b);
    read_values(set, at, size, b);
    for (int l = 0; l < model.n_lobes; ++l) {
      const int shape = 1 + model.n_lobes + 2 * l;
      evaluate_lobe<true, kind == Curvature::newton>(b, !set.along.empty(), model.lobes[l],
                                                     {&columns.basis[1 + l], &columns.basis[shape], &columns.basis[shape + 1],
                                                      &columns.second[l][0], &columns.second[l][1], &columns.second[l][2]});
    }
    for (int c = 0; c < set.n_channels; ++c) add_channel<kind>(model, c, b, robust_scale, columns, sums[c]);
  }
}

LACQUER_ALWAYS_INLINE double cost_body(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model, double robust_scale) {
  Block b;
  Column lobes[max_lobes];
  Double4 sums[3] = {splat(0.0), splat(0.0), splat(0.0)};
  for (std::size_t at = begin; at < end; at += block) {
    const std::size_t size = std::min(block, end - at);
    read_geometry(set, at, size, b);
    read_values(set, at, size, b);
    for (int l = 0; l < model.n_lobes; ++l)
      evaluate_lobe<false, false>(b, !set.along.empty(), model.lobes[l], {&lobes[l]});
    for (int c = 0; c < set.n_channels; ++c)
      for (std::size_t k = 0; k < block; k += width)
        sums[c] += residual(model_value(model, c, lobes, k), load<Double4>(b.target[c].v + k), load<Double4>(b.inverse_sigma[c].v + k),
                            splat(robust_scale))
                       .rho;
  }
  double total = 0;
  for (int c = 0; c < set.n_channels; ++c) total += sum_of_lanes(sums[c]);
  return total;
}

LACQUER_ALWAYS_INLINE void evaluate_body(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model,
                                         double* const* values) {
  Block b;
  Column lobes[max_lobes], f;
  for (std::size_t at = begin; at < end; at += block) {
    const std::size_t size = std::min(block, end - at);
    read_geometry(set, at, size, b);
    for (int l = 0; l < model.n_lobes; ++l)
      evaluate_lobe<false, false>(b, !set.along.empty(), model.lobes[l], {&lobes[l]});
    for (int c = 0; c < set.n_channels; ++c) {
      for (std::size_t k = 0; k < block; k += width) store(f.v + k, model_value(model, c, lobes, k));
      std::copy(f.v, f.v + size, values[c] + (at - begin));
    }
  }
}

LACQUER_ALWAYS_INLINE void logarithms_body(double* x, std::size_t n) {
  std::size_t k = 0;
  for (; k + width <= n; k += width) store(x + k, brdf::log(load<Double4>(x + k)));
  for (; k < n; ++k) x[k] = brdf::log(splat(x[k]))[0];
}

using QuadraticLoop = void(const CellSet&, std::size_t, std::size_t, const FlatModel&, double, LaneSums*);

template <Curvature kind>
void quadratic_baseline(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model, double robust_scale, LaneSums* sums) {
  quadratic_body<kind>(set, begin, end, model, robust_scale, sums);
}
double cost_baseline(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model, double robust_scale) {
  return cost_body(set, begin, end, model, robust_scale);
}
void evaluate_baseline(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model, double* const* values) {
  evaluate_body(set, begin, end, model, values);
}
void logarithms_baseline(double* x, std::size_t n) { logarithms_body(x, n); }

#ifdef LACQUER_TARGET_AVX2
template <Curvature kind>
LACQUER_TARGET_AVX2 void quadratic_avx2(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model, double robust_scale,
                                        LaneSums* sums) {
  quadratic_body<kind>(set, begin, end, model, robust_scale, sums);
}
LACQUER_TARGET_AVX2 double cost_avx2(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model, double robust_scale) {
  return cost_body(set, begin, end, model, robust_scale);
}
LACQUER_TARGET_AVX2 void evaluate_avx2(const CellSet& set, std::size_t begin, std::size_t end, const FlatModel& model,
                                       double* const* values) {
  evaluate_body(set, begin, end, model, values);
}
LACQUER_TARGET_AVX2 void logarithms_avx2(double* x, std::size_t n) { logarithms_body(x, n); }
#endif

/// The loops for this processor.
struct Loops {
  QuadraticLoop *gauss_newton = quadratic_baseline<Curvature::gauss_newton>, *newton = quadratic_baseline<Curvature::newton>;
  double (*cost)(const CellSet&, std::size_t, std::size_t, const FlatModel&, double) = cost_baseline;
  void (*evaluate)(const CellSet&, std::size_t, std::size_t, const FlatModel&, double* const*) = evaluate_baseline;
  void (*logarithms)(double*, std::size_t) = logarithms_baseline;
};

Loops choose_loops([[maybe_unused]] bool vectors) {
  Loops loops;
#ifdef LACQUER_TARGET_AVX2
  if (vectors && __builtin_cpu_supports("avx2"))
    loops = {quadratic_avx2<Curvature::gauss_newton>, quadratic_avx2<Curvature::newton>, cost_avx2, evaluate_avx2,
             logarithms_avx2};
#endif
  return loops;
}

Loops loops = choose_loops(true);

}  // namespace

void use_vectors(bool yes) { loops = choose_loops(yes); }

void add_quadratic(const CellSet& set, std::size_t begin, std::size_t end, const brdf::CookTorrance& model, double robust_scale,
                   Curvature kind, Sums& sums) {
  LaneSums lanes[3];
  const FlatModel flat(model, set.first_channel);
  (kind == Curvature::newton ? loops.newton : loops.gauss_newton)(set, begin, end, flat, robust_scale, lanes);
  const int n_lobes = flat.n_lobes, n = 1 + 3 * n_lobes;
  for (int c = 0; c < set.n_channels; ++c) {
    const LaneSums& from = lanes[c];
    ChannelSums& to = sums[static_cast<std::size_t>(set.first_channel + c)];
    // The columns of ln(m) and r lack their factor ks.
    const auto scale = [&](int i) { return i <= n_lobes ? 1.0 : flat.ks[(i - 1 - n_lobes) / 2][c]; };
    to.cost += sum_of_lanes(from.cost);
    for (int i = 0; i < n; ++i) {
      to.gradient[i] += scale(i) * sum_of_lanes(from.gradient[i]);
      for (int j = i; j < n; ++j) to.curvature[i][j] += scale(i) * scale(j) * sum_of_lanes(from.curvature[i][j]);
    }
    if (kind == Curvature::gauss_newton) continue;
    // Second derivatives of the model's value, which is bilinear in ks and a lobe and linear in r.
    for (int l = 0; l < n_lobes; ++l) {
      const int m = 1 + n_lobes + 2 * l;
      to.curvature[1 + l][m] += sum_of_lanes(from.gradient[m]);
      to.curvature[1 + l][m + 1] += sum_of_lanes(from.gradient[m + 1]);
      to.curvature[m][m] += scale(m) * sum_of_lanes(from.extra[l][0]);
      to.curvature[m][m + 1] += scale(m) * sum_of_lanes(from.extra[l][1]);
      to.curvature[m + 1][m + 1] += scale(m) * sum_of_lanes(from.extra[l][2]);
    }
  }
}

double cost(const CellSet& set, std::size_t begin, std::size_t end, const brdf::CookTorrance& model, double robust_scale) {
  return loops.cost(set, begin, end, FlatModel(model, set.first_channel), robust_scale);
}

void take_logarithms(std::span<double> x) { loops.logarithms(x.data(), x.size()); }

void evaluate(const CellSet& set, std::size_t begin, std::size_t end, const brdf::CookTorrance& model,
              std::array<std::vector<double>, 3>& values) {
  double* to[3] = {};
  for (int c = 0; c < set.n_channels; ++c) {
    values[static_cast<std::size_t>(c)].resize(end - begin);
    to[c] = values[static_cast<std::size_t>(c)].data();
  }
  loops.evaluate(set, begin, end, FlatModel(model, set.first_channel), to);
}

}  // namespace lacquer::fit
