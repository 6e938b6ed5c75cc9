#include "libfit/log_errors.h"

#include <tbb/parallel_for.h>

#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "libfit/kernels.h"

namespace lacquer::fit {

namespace {

constexpr std::size_t cells_per_chunk = 4096;
/// Below this a value has underflowed, or is about to: its logarithm is taken from the model's logarithmic form.
constexpr double smallest = 1e-290;

struct Sum {
  double sum = 0, squares = 0;
  std::size_t n = 0;
  void add(double difference) {
    if (!std::isfinite(difference)) return;  // a model that is exactly 0: a channel without data
    sum += std::abs(difference);
    squares += difference * difference;
    ++n;
  }
};

/// `add(set, begin, end, sum)` adds a stretch of cells; the sums of the stretches are added in order.
template <typename Add>
Sum sum_over(const Observations& observations, const Add& add) {
  Sum total;
  for (const CellSet& set : observations.sets) {
    std::vector<Sum> chunks((set.size() + cells_per_chunk - 1) / cells_per_chunk);
    tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t chunk) {
      const std::size_t begin = chunk * cells_per_chunk, end = std::min(set.size(), begin + cells_per_chunk);
      add(set, begin, end, chunks[chunk]);
    });
    for (const Sum& chunk : chunks) {
      total.sum += chunk.sum;
      total.squares += chunk.squares;
      total.n += chunk.n;
    }
  }
  return total;
}

/// Logarithm of `value`, the model's at cell k of a set in its channel c. Where it underflows, from the model's logarithmic form at other
/// directions of the same half and difference angle: the lobes are all that counts there, and they change by `front` alone.
double log_of(double value, const brdf::CookTorrance& model, const CellSet& set, std::size_t k, std::size_t c) {
  if (value > smallest) return std::log(value);
  brdf::HalfAngleCosines<double> cosines;
  cosines.tan2_theta_h = set.tan2_theta_h[k];
  cosines.n_dot_h = 1 / std::sqrt(1 + cosines.tan2_theta_h);
  cosines.i_dot_h = 1 - std::pow(double{set.schlick_weight[k]}, 0.2);
  cosines.n_dot_i = cosines.n_dot_o = 1;
  if (!set.along.empty()) cosines.footprint = {set.along[k], set.across[k], set.mixed[k]};
  const double log_front = std::log(brdf::geometry_over_cosines(cosines) * std::numbers::inv_pi) - 4 * std::log(cosines.n_dot_h);
  return model.log_value(cosines)[set.first_channel + static_cast<int>(c)] + std::log(double{set.front[k]}) - log_front;
}

}  // namespace

LogErrors log_errors(const Observations& observations, const brdf::CookTorrance& model) {
  const Sum sum = sum_over(observations, [&](const CellSet& set, std::size_t begin, std::size_t end, Sum& to) {
    std::array<std::vector<double>, 3> values;
    evaluate(set, begin, end, model, values);
    std::vector<double> ratios(end - begin);
    for (std::size_t c = 0; c < static_cast<std::size_t>(set.n_channels); ++c) {
      const CellSet::Channel& channel = set.channels[c];
      const auto& means = observations.table->channels[static_cast<std::size_t>(set.first_channel) + c].mean;
      const auto counts = [&](std::size_t k) {  // not a bound, not zero
        return channel.inverse_sigma[k] != 0 && !(channel.inverse_sigma[k] > 0 && channel.target[k] < 0) && means[set.cell[k]] > 0;
      };
      for (std::size_t k = begin; k < end; ++k)
        ratios[k - begin] = counts(k) && values[c][k - begin] > smallest ? values[c][k - begin] / double{means[set.cell[k]]} : 1;
      take_logarithms(ratios);
      for (std::size_t k = begin; k < end; ++k) {
        if (!counts(k)) continue;
        const double f = values[c][k - begin];
        to.add(f > smallest ? ratios[k - begin] : log_of(f, model, set, k, c) - std::log(double{means[set.cell[k]]}));
      }
    }
  });
  const double n = static_cast<double>(std::max<std::size_t>(1, sum.n));
  return {sum.sum / n, std::sqrt(sum.squares / n)};
}

double mean_abs_log_ratio(const Observations& observations, const brdf::CookTorrance& a, const brdf::CookTorrance& b) {
  const Sum sum = sum_over(observations, [&](const CellSet& set, std::size_t begin, std::size_t end, Sum& to) {
    std::array<std::vector<double>, 3> of_a, of_b;
    evaluate(set, begin, end, a, of_a);
    evaluate(set, begin, end, b, of_b);
    for (std::size_t c = 0; c < static_cast<std::size_t>(set.n_channels); ++c)
      for (std::size_t k = begin; k < end; ++k) {
        const double fa = of_a[c][k - begin], fb = of_b[c][k - begin];
        to.add(fa > smallest && fb > smallest ? std::log(fa / fb)
                                              : log_of(fa, a, set, k, c) - log_of(fb, b, set, k, c));
      }
  });
  return sum.n ? sum.sum / static_cast<double>(sum.n) : 0;
}

}  // namespace lacquer::fit
