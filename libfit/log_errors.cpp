#include "libfit/log_errors.h"

#include <tbb/parallel_for.h>

#include <array>
#include <cmath>
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

/// Calls `add(sum, set, k, values of the models at cell k, channel)` for all cells and channels; sums of chunks are added in order.
template <std::size_t n_models, typename Add>
Sum sum_over(const Observations& observations, const std::array<const brdf::CookTorrance*, n_models>& models, const Add& add) {
  Sum total;
  for (const CellSet& set : observations.sets) {
    std::vector<Sum> chunks((set.size() + cells_per_chunk - 1) / cells_per_chunk);
    tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t chunk) {
      const std::size_t begin = chunk * cells_per_chunk, end = std::min(set.size(), begin + cells_per_chunk);
      std::array<std::array<std::vector<double>, 3>, n_models> values;
      for (std::size_t i = 0; i < n_models; ++i) evaluate(set, begin, end, *models[i], values[i]);
      for (std::size_t c = 0; c < static_cast<std::size_t>(set.n_channels); ++c)
        for (std::size_t k = begin; k < end; ++k) {
          std::array<double, n_models> f;
          for (std::size_t i = 0; i < n_models; ++i) f[i] = values[i][c][k - begin];
          add(chunks[chunk], set, k, f, c);
        }
    });
    for (const Sum& chunk : chunks) {
      total.sum += chunk.sum;
      total.squares += chunk.squares;
      total.n += chunk.n;
    }
  }
  return total;
}

double log_of(double value, const brdf::CookTorrance& model, const Observations& observations, const CellSet& set, std::size_t k,
              std::size_t c) {
  if (value > smallest) return std::log(value);
  const std::size_t channel = static_cast<std::size_t>(set.first_channel) + c;
  const brdf::TableChannel& t = observations.table->channels[channel];
  const std::uint32_t i = set.cell[k];
  auto cosines = brdf::half_angle_cosines(brdf::HalfDiff{t.theta_h[i], t.theta_d[i], t.phi_d[i]});
  cosines.footprint = {t.footprint_along[i], t.footprint_across[i], t.footprint_mixed[i]};
  return model.log_value(cosines)[static_cast<int>(channel)];
}

}  // namespace

LogErrors log_errors(const Observations& observations, const brdf::CookTorrance& model) {
  const Sum sum = sum_over<1>(observations, {&model}, [&](Sum& to, const CellSet& set, std::size_t k, const auto& f, std::size_t c) {
    const float mean = observations.table->channels[static_cast<std::size_t>(set.first_channel) + c].mean[set.cell[k]];
    if (set.channels[c].inverse_sigma[k] == 0 || !(mean > 0)) return;
    to.add(f[0] > smallest ? std::log(f[0] / double{mean}) : log_of(f[0], model, observations, set, k, c) - std::log(double{mean}));
  });
  const double n = static_cast<double>(std::max<std::size_t>(1, sum.n));
  return {sum.sum / n, std::sqrt(sum.squares / n)};
}

double mean_abs_log_ratio(const Observations& observations, const brdf::CookTorrance& a, const brdf::CookTorrance& b) {
  const Sum sum = sum_over<2>(observations, {&a, &b}, [&](Sum& to, const CellSet& set, std::size_t k, const auto& f, std::size_t c) {
    to.add(f[0] > smallest && f[1] > smallest
               ? std::log(f[0] / f[1])
               : log_of(f[0], a, observations, set, k, c) - log_of(f[1], b, observations, set, k, c));
  });
  return sum.n ? sum.sum / static_cast<double>(sum.n) : 0;
}

}  // namespace lacquer::fit
