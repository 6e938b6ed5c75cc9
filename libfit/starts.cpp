#include "libfit/starts.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "libbrdf/table.h"
#include "libfit/nonnegative_least_squares.h"

namespace lacquer::fit {

namespace {

constexpr int grid_size = 20;               // neighbours differ by a factor of 1.32 (0.005 .. 1)
constexpr double narrowest_grid_m = 0.005;  // 0.3 deg, below the footprint of any light of the rig

/// Columns: diffuse, then lobe(m, 1) and lobe(m, 0) for each m of the grid.
constexpr int n_columns = 1 + 2 * grid_size;
using Columns = std::array<double, n_columns>;

std::array<double, grid_size> m_grid(double min_m) {
  std::array<double, grid_size> grid;
  const double first = std::log(std::max(min_m, narrowest_grid_m));
  for (int i = 0; i < grid_size; ++i)
    grid[i] = std::exp(first * (1 - static_cast<double>(i) / (grid_size - 1)));
  return grid;
}

Columns columns(const brdf::HalfAngleCosines<double>& c, const std::array<double, grid_size>& grid) {
  Columns values;
  values[0] = std::numbers::inv_pi;
  for (int i = 0; i < grid_size; ++i) {
    values[1 + 2 * i] = brdf::CookTorranceLobe<double>{grid[i], 1}(c);
    values[2 + 2 * i] = brdf::CookTorranceLobe<double>{grid[i], 0}(c);
  }
  return values;
}

/// Normal equations of one channel, weights 1 / sigma^2 of the value.
struct ChannelGram {
  double squared_mean = 0;
  std::array<double, n_columns> rhs{};
  std::array<Columns, n_columns> gram{};  // upper triangle, mirrored at the end

  void add(const Columns& row, double value, double inverse_sigma) {
    squared_mean += value * value * inverse_sigma * inverse_sigma;
    for (int i = 0; i < n_columns; ++i) {
      const double scaled = row[i] * inverse_sigma * inverse_sigma;
      rhs[i] += scaled * value;
      for (int j = i; j < n_columns; ++j) gram[i][j] += scaled * row[j];
    }
  }
};

std::size_t theta_h_row(const Point& p) {
  return static_cast<std::size_t>(
      brdf::TableGrid::cell(brdf::HalfDiff{std::acos(p.cosines.n_dot_h), 0, 0}).theta_h);
}

/// Lower quartile of the positive means of a channel per theta_h row, 0 where there is none: the level that
/// no sound value of the row falls far below.
std::vector<double> row_levels(const Observations& observations, int channel) {
  std::vector<std::vector<float>> rows(brdf::TableGrid::n_theta_h);
  for (const Point& p : observations.points)
    for (std::uint32_t k = p.first; k < p.end; ++k) {
      const Observation& o = observations.values[k];
      if (o.channel == channel && o.mean > 0) rows[theta_h_row(p)].push_back(o.mean);
    }
  std::vector<double> levels;
  for (auto& row : rows) {
    if (row.empty()) {
      levels.push_back(0);
      continue;
    }
    const auto quartile = row.begin() + static_cast<std::ptrdiff_t>(row.size() / 4);
    std::nth_element(row.begin(), quartile, row.end());
    levels.push_back(*quartile);
  }
  return levels;
}

std::vector<ChannelGram> channel_grams(const Observations& observations,
                                       const std::array<double, grid_size>& grid) {
  std::vector<ChannelGram> grams(static_cast<std::size_t>(observations.n_channels));
  std::vector<std::vector<double>> levels;
  for (int c = 0; c < observations.n_channels; ++c) levels.push_back(row_levels(observations, c));

  for (const Point& p : observations.points) {
    const Columns row = columns(p.cosines, grid);
    const std::size_t theta_h = theta_h_row(p);
    for (std::uint32_t k = p.first; k < p.end; ++k) {
      const Observation& o = observations.values[k];
      // sigma of the value from sigma of its logarithm. A stray low value would get an enormous weight: not
      // below a third of its row.
      const double level = std::max(double{o.mean}, levels[o.channel][theta_h] / 3);
      grams[o.channel].add(row, o.mean, o.logarithmic ? o.inverse_sigma / level : o.inverse_sigma);
    }
  }
  for (ChannelGram& g : grams)
    for (int i = 0; i < n_columns; ++i)
      for (int j = 0; j < i; ++j) g.gram[i][j] = g.gram[j][i];
  return grams;
}

/// Grid indices of the lobes, falling m first.
using Choice = std::vector<int>;

std::vector<Choice> all_choices(int n_lobes) {
  std::vector<Choice> choices{{}};
  for (int lobe = 0; lobe < n_lobes; ++lobe) {
    std::vector<Choice> longer;
    for (const Choice& choice : choices)
      for (int i = (choice.empty() ? grid_size : choice.back()) - 1; i >= 0; --i) {
        longer.push_back(choice);
        longer.back().push_back(i);
      }
    choices = std::move(longer);
  }
  return choices;
}

/// Coefficients of the choice's columns in one channel.
NonnegativeSolution solve(const ChannelGram& channel, const Choice& choice) {
  std::vector<int> used{0};
  for (const int i : choice) used.insert(used.end(), {1 + 2 * i, 2 + 2 * i});
  std::vector<double> gram, rhs;
  for (const int i : used) {
    rhs.push_back(channel.rhs[i]);
    for (const int j : used) gram.push_back(channel.gram[i][j]);
  }
  return nonnegative_least_squares(gram, rhs);
}

brdf::CookTorrance model_of(const std::vector<ChannelGram>& grams, const Choice& choice,
                            const std::array<double, grid_size>& grid) {
  brdf::CookTorrance model;
  model.lobes.resize(choice.size());
  std::vector<double> normal(choice.size()), total(choice.size());
  for (std::size_t c = 0; c < grams.size(); ++c) {
    const std::vector<double> x = solve(grams[c], choice).x;
    model.kd[static_cast<int>(c)] = x[0];
    for (std::size_t l = 0; l < choice.size(); ++l) {
      const double ks = x[1 + 2 * l] + x[2 + 2 * l];
      model.lobes[l].ks[static_cast<int>(c)] = ks;
      normal[l] += x[1 + 2 * l];
      total[l] += ks;
    }
  }
  for (std::size_t l = 0; l < choice.size(); ++l) {
    model.lobes[l].m = grid[choice[l]];
    // Inside the bounds, so that the solver can move it both ways.
    model.lobes[l].r = total[l] > 0 ? std::clamp(normal[l] / total[l], 0.02, 0.98) : 0.5;
  }
  return model;
}

/// Two choices lead the solver to the same place when no lobe differs by more than one step of the grid.
bool neighbours(const Choice& a, const Choice& b) {
  for (std::size_t l = 0; l < a.size(); ++l)
    if (std::abs(a[l] - b[l]) > 1) return false;
  return true;
}

}  // namespace

std::vector<brdf::CookTorrance> scan_for_starts(const Observations& observations, int n_lobes,
                                                std::size_t count, double min_m) {
  const auto grid = m_grid(min_m);
  const std::vector<ChannelGram> grams = channel_grams(observations, grid);
  const std::vector<Choice> choices = all_choices(n_lobes);
  std::vector<double> cost(choices.size());
  tbb::parallel_for(std::size_t{0}, choices.size(), [&](std::size_t i) {
    for (const ChannelGram& channel : grams)
      cost[i] += channel.squared_mean - solve(channel, choices[i]).reduction;
  });
  std::vector<std::size_t> order(choices.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return cost[a] < cost[b]; });

  std::vector<Choice> chosen;
  for (const std::size_t i : order) {
    if (chosen.size() == count) break;
    const auto near = [&](const Choice& other) { return neighbours(choices[i], other); };
    if (std::none_of(chosen.begin(), chosen.end(), near)) chosen.push_back(choices[i]);
  }
  std::vector<brdf::CookTorrance> starts;
  for (const Choice& choice : chosen) starts.push_back(model_of(grams, choice, grid));
  return starts;
}

}  // namespace lacquer::fit
