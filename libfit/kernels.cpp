#include "libfit/kernels.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "libfit/lobe_block.h"

namespace lacquer::fit {

namespace {

using namespace kernel;
using brdf::absolute;
using brdf::any;
using brdf::Int64x4;
using brdf::select;
using brdf::sum_of_lanes;

constexpr double log_floor = 1e-3;           // of the measured value, see Objective
constexpr int tile = 4;                      // columns whose products are summed side by side
constexpr int n_columns = max_local + tile;  // the last ones are zero, so that tiles may overhang

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
