#include "libfit/observations.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "libfit/comparison.h"
#include "libfit/kernels.h"

namespace lacquer::fit {

namespace {

using brdf::CellOrigin;

/// Cells of a set with their usable channels, as in UsableCells.
struct Members {
  std::vector<std::uint32_t> cells;
  std::vector<std::uint8_t> channels;

  void add(std::uint32_t cell, std::uint8_t usable) {
    cells.push_back(cell);
    channels.push_back(usable);
  }
};

/// Those whose channels lie at one place, then of channel 0, 1, 2 alone.
std::array<Members, 4> sort_into_sets(UsableCells cells, std::size_t n_channels) {
  std::array<Members, 4> sets;
  const auto n_apart = std::count_if(cells.channels.begin(), cells.channels.end(), [](auto c) { return (c & UsableCells::apart) != 0; });
  if (n_apart == 0) {
    sets[0] = {std::move(cells.cells), std::move(cells.channels)};
    return sets;
  }
  sets[0].cells.reserve(cells.cells.size() - static_cast<std::size_t>(n_apart));
  sets[0].channels.reserve(sets[0].cells.capacity());
  for (std::size_t k = 0; k < cells.cells.size(); ++k) {
    if (!(cells.channels[k] & UsableCells::apart)) {
      sets[0].add(cells.cells[k], cells.channels[k]);
      continue;
    }
    for (std::size_t c = 0; c < n_channels; ++c)
      if (cells.channels[k] >> c & 1) sets[c + 1].add(cells.cells[k], cells.channels[k]);
  }
  return sets;
}

/// Geometry of these cells.
CellSet cell_set(const brdf::HalfAngleTable& table, Members members, bool footprints, int first_channel, int n_channels) {
  CellSet set;
  set.first_channel = first_channel;
  set.n_channels = n_channels;
  set.cell = std::move(members.cells);
  set.usable = std::move(members.channels);
  for (auto* column : {&set.tan2_theta_h, &set.schlick_weight, &set.front}) column->resize(set.size());
  if (footprints)
    for (auto* column : {&set.along, &set.across, &set.mixed}) column->resize(set.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, set.size(), 4096), [&](const auto& range) {
    for (std::size_t k = range.begin(); k < range.end(); ++k) {
      const std::uint32_t i = set.cell[k];
      std::size_t c = static_cast<std::size_t>(first_channel);
      while (!(set.usable[k] >> c & 1)) ++c;
      const brdf::TableChannel& t = table.channels[c];
      const auto cosines = brdf::half_angle_cosines(brdf::HalfDiff{t.theta_h[i], t.theta_d[i], t.phi_d[i]});
      const double nh2 = cosines.n_dot_h * cosines.n_dot_h;
      set.tan2_theta_h[k] = static_cast<float>(cosines.tan2_theta_h);
      set.schlick_weight[k] = static_cast<float>(brdf::schlick_weight(cosines.i_dot_h));
      set.front[k] = static_cast<float>(brdf::geometry_over_cosines(cosines) * std::numbers::inv_pi / (nh2 * nh2));
      if (!footprints) continue;
      set.along[k] = t.footprint_along[i];
      set.across[k] = t.footprint_across[i];
      set.mixed[k] = t.footprint_mixed[i];
    }
  });
  return set;
}

}  // namespace

Observations observe(const brdf::HalfAngleTable& table, UsableCells cells) {
  Observations result;
  result.table = &table;
  result.n_channels = static_cast<int>(table.channels.size());
  result.n_cells = cells.cells.size();
  for (std::size_t k = 0; k < cells.cells.size(); ++k)
    for (std::size_t c = 0; c < table.channels.size(); ++c)
      if (cells.channels[k] >> c & 1) ++(table.channels[c].origin[cells.cells[k]] == CellOrigin::clipped ? result.n_bounds : result.n_values);
  const bool footprints = cells.footprints;
  auto sets = sort_into_sets(std::move(cells), table.channels.size());
  for (int s = 0; s <= result.n_channels; ++s) {
    Members& members = sets[static_cast<std::size_t>(s)];
    if (!members.cells.empty()) result.sets.push_back(cell_set(table, std::move(members), footprints, std::max(0, s - 1), s == 0 ? result.n_channels : 1));
  }
  return result;
}

void weigh(Observations& observations, double model_sigma, const brdf::CookTorrance* reference) {
  for (CellSet& set : observations.sets) {
    for (int c = 0; c < set.n_channels; ++c) {
      CellSet::Channel& channel = set.channels[static_cast<std::size_t>(c)];
      channel.target.resize(set.size(), 1.0f);
      channel.inverse_sigma.resize(set.size());
    }
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, set.size(), 4096), [&](const auto& range) {
      std::array<std::vector<double>, 3> values;
      if (reference) evaluate(set, range.begin(), range.end(), *reference, values);
      for (int c = 0; c < set.n_channels; ++c) {
        const brdf::TableChannel& t = observations.table->channels[static_cast<std::size_t>(set.first_channel + c)];
        CellSet::Channel& channel = set.channels[static_cast<std::size_t>(c)];
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
          if (!(set.usable[k] >> (set.first_channel + c) & 1)) continue;
          const double mean = t.mean[set.cell[k]];
          const double signal = reference ? values[static_cast<std::size_t>(c)][k - range.begin()] : std::max(mean, 0.0);
          const Comparison compared = t.origin[set.cell[k]] == CellOrigin::clipped
                                          ? comparison_with_bound(mean, t.variance[set.cell[k]], model_sigma)
                                          : comparison(mean, t.variance[set.cell[k]], signal, model_sigma);
          channel.target[k] = compared.target;
          channel.inverse_sigma[k] = compared.inverse_sigma;
        }
      }
    });
  }
}

}  // namespace lacquer::fit
