#include "libfit/group_errors.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <vector>

#include "libbrdf/table.h"
#include "libfit/kernels.h"

namespace lacquer::fit {

namespace {

/// work(g, first, last) for the runs of cells that share (theta_h, theta_d), side by side; `prepare` gets their number first.
template <typename Prepare, typename Work>
void for_each_group(const CellSet& set, const Prepare& prepare, const Work& work) {
  std::vector<std::size_t> begins;
  for (std::size_t k = 0; k < set.size(); ++k)
    if (k == 0 || set.cell[k] / brdf::TableGrid::n_phi_d != set.cell[k - 1] / brdf::TableGrid::n_phi_d) begins.push_back(k);
  prepare(begins.size());
  begins.push_back(set.size());
  tbb::parallel_for(std::size_t{0}, begins.size() - 1, [&](std::size_t g) { work(g, begins[g], begins[g + 1]); });
}

/// 1 / sigma of the logarithm.
double relative_weight(const CellSet::Channel& channel, std::size_t k) {
  return channel.inverse_sigma[k] >= 0 ? channel.inverse_sigma[k] : -channel.inverse_sigma[k] * std::max(0.0f, channel.target[k]);
}

}  // namespace

double shared_error(const Observations& observations, const brdf::CookTorrance& model) {
  constexpr double normal_median_square = 0.4549, model_fits = 4;
  struct Group {
    double mean = 0, variance = 0;
  };
  std::vector<Group> groups;
  for (const CellSet& set : observations.sets) {
    std::vector<Group> of_set;  // per channel of each group; without a variance: no value counts
    const auto n_channels = static_cast<std::size_t>(set.n_channels);
    const auto prepare = [&](std::size_t n) { of_set.resize(n * n_channels); };
    for_each_group(set, prepare, [&](std::size_t g, std::size_t begin, std::size_t end) {
      std::array<std::vector<double>, 3> values;
      evaluate(set, begin, end, model, values);
      for (std::size_t c = 0; c < n_channels; ++c) {
        const CellSet::Channel& channel = set.channels[c];
        std::vector<double>& ratio = values[c];
        const auto counts = [&](std::size_t k) { return channel.inverse_sigma[k] > 0 && channel.target[k] > 0; };  // else unused, weak, clipped
        for (std::size_t k = begin; k < end; ++k) ratio[k - begin] = counts(k) ? ratio[k - begin] / channel.target[k] : 1;
        take_logarithms(ratio);
        double sum = 0, weight = 0;
        for (std::size_t k = begin; k < end; ++k) {
          if (!counts(k)) continue;
          const double w = static_cast<double>(channel.inverse_sigma[k]) * channel.inverse_sigma[k];
          sum += w * ratio[k - begin];
          weight += w;
        }
        if (weight > 0) of_set[g * n_channels + c] = {sum / weight, 1 / weight};
      }
    });
    std::copy_if(of_set.begin(), of_set.end(), std::back_inserter(groups), [](const Group& g) { return g.variance > 0; });
  }
  if (groups.empty()) return 0;
  std::vector<double> squares(groups.size());
  const auto median_square = [&](double shared2) {
    for (std::size_t g = 0; g < groups.size(); ++g) squares[g] = groups[g].mean * groups[g].mean / (groups[g].variance + shared2);
    const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
    std::nth_element(squares.begin(), middle, squares.end());
    return *middle / normal_median_square;
  };
  if (median_square(0) <= model_fits) return 0;
  double low = 0, high = 1;
  while (median_square(high) > 1 && high < 1e6) high *= 4;
  for (int i = 0; i < 40; ++i) {
    const double middle = (low + high) / 2;
    (median_square(middle) > 1 ? low : high) = middle;
  }
  return std::sqrt((low + high) / 2);
}

void limit_groups(Observations& observations, double shared) {
  for (CellSet& set : observations.sets)
    for_each_group(set, [](std::size_t) {}, [&](std::size_t, std::size_t begin, std::size_t end) {
      for (int c = 0; c < set.n_channels; ++c) {
        CellSet::Channel& channel = set.channels[static_cast<std::size_t>(c)];
        double weight = 0;
        for (std::size_t k = begin; k < end; ++k) weight += std::pow(relative_weight(channel, k), 2);
        const auto factor = static_cast<float>(1 / std::sqrt(1 + shared * shared * weight));
        for (std::size_t k = begin; k < end; ++k) channel.inverse_sigma[k] *= factor;
      }
    });
}

double total_weight(const Observations& observations) {
  double total = 0;
  for (const CellSet& set : observations.sets)
    for (int c = 0; c < set.n_channels; ++c)
      for (std::size_t k = 0; k < set.size(); ++k) total += std::pow(relative_weight(set.channels[static_cast<std::size_t>(c)], k), 2);
  return total;
}

}  // namespace lacquer::fit
