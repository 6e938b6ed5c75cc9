#include "libfit/starts.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "libbrdf/table.h"
#include "libfit/kernels.h"
#include "libfit/nonnegative_least_squares.h"

namespace lacquer::fit {

namespace {

constexpr int grid_size = 24;  // neighbours differ by a factor of 1.35 (0.001 .. 1)

/// Columns: diffuse, then lobe(m, 1) and lobe(m, 0) for each m of the grid.
constexpr int n_columns = 1 + 2 * grid_size;
using Columns = std::array<double, n_columns>;

std::array<double, grid_size> m_grid(double min_m) {
  std::array<double, grid_size> grid;
  for (int i = 0; i < grid_size; ++i)
    grid[i] = std::exp(std::log(min_m) * (1 - static_cast<double>(i) / (grid_size - 1)));
  return grid;
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

std::size_t theta_h_row(const CellSet& set, std::size_t k) {
  return static_cast<std::size_t>(brdf::TableGrid::cell(set.cell[k]).theta_h);
}

/// The sets that see a channel, with its index there.
std::vector<std::pair<const CellSet*, std::size_t>> sets_of_channel(const Observations& observations, int channel) {
  std::vector<std::pair<const CellSet*, std::size_t>> sets;
  for (const CellSet& set : observations.sets)
    if (channel >= set.first_channel && channel < set.first_channel + set.n_channels)
      sets.emplace_back(&set, static_cast<std::size_t>(channel - set.first_channel));
  return sets;
}

/// Lower quartile of the positive values of a channel per theta_h row, 0 where there is none: the level that
/// no sound value of the row falls far below.
std::vector<double> row_levels(const Observations& observations, int channel) {
  std::vector<std::vector<float>> rows(brdf::TableGrid::n_theta_h);
  for (const auto& [set, c] : sets_of_channel(observations, channel))
    for (std::size_t k = 0; k < set->size(); ++k)
      if (set->channels[c].inverse_sigma[k] != 0 && set->channels[c].target[k] > 0)
        rows[theta_h_row(*set, k)].push_back(set->channels[c].target[k]);
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

/// Values of lobe(m, r = 1) at all cells of a set, per m of the grid.
std::vector<std::vector<double>> lobe_values(const CellSet& set, const std::array<double, grid_size>& grid) {
  std::vector<std::vector<double>> values;
  for (const double m : grid) {
    std::array<std::vector<double>, 3> channels;
    evaluate(set, 0, set.size(), {glm::dvec3(0), {{glm::dvec3(1), m, 1.0}}}, channels);
    values.push_back(std::move(channels[0]));
  }
  return values;
}

std::vector<ChannelGram> channel_grams(const Observations& observations, const std::array<double, grid_size>& grid) {
  std::vector<ChannelGram> grams(static_cast<std::size_t>(observations.n_channels));
  std::map<const CellSet*, std::vector<std::vector<double>>> lobes;
  for (const CellSet& set : observations.sets) lobes[&set] = lobe_values(set, grid);
  tbb::parallel_for(0, observations.n_channels, [&](int channel) {
    const std::vector<double> levels = row_levels(observations, channel);
    ChannelGram& gram = grams[static_cast<std::size_t>(channel)];
    for (const auto& [set, c] : sets_of_channel(observations, channel)) {
      const auto& values = lobes.at(set);
      for (std::size_t k = 0; k < set->size(); ++k) {
        const double inverse_sigma = set->channels[c].inverse_sigma[k], signed_target = set->channels[c].target[k];
        if (inverse_sigma == 0) continue;
        // A clipped peak at its bound is nearer to the truth than none.
        const double target = inverse_sigma > 0 ? std::abs(signed_target) : signed_target;
        Columns row;
        row[0] = std::numbers::inv_pi;
        for (std::size_t i = 0; i < grid_size; ++i) {
          row[1 + 2 * i] = values[i][k];
          row[2 + 2 * i] = values[i][k] * set->schlick_weight[k];
        }
        // sigma of the value from sigma of its logarithm. A stray low value would get an enormous weight: not below a third of its row.
        const double level = std::max(target, levels[theta_h_row(*set, k)] / 3);
        gram.add(row, target, inverse_sigma > 0 ? inverse_sigma / level : inverse_sigma);
      }
    }
  });
  for (ChannelGram& g : grams)
    for (int i = 0; i < n_columns; ++i)
      for (int j = 0; j < i; ++j) g.gram[i][j] = g.gram[j][i];
  return grams;
}

/// Grid indices of the lobes, falling m first.
using Choice = std::vector<int>;

/// All of them up to 4 lobes, on every second m for more.
std::vector<Choice> all_choices(int n_lobes) {
  const int step = n_lobes > 4 ? 2 : 1;
  std::vector<Choice> choices{{}};
  for (int lobe = 0; lobe < n_lobes; ++lobe) {
    std::vector<Choice> longer;
    for (const Choice& choice : choices)
      for (int i = choice.empty() ? grid_size - 1 : choice.back() - step; i >= 0; i -= step) {
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

constexpr std::size_t screened_per_start = 4;

/// Two choices lead the solver to the same place when no lobe differs by more than one step of the grid.
bool neighbours(const Choice& a, const Choice& b) {
  for (std::size_t l = 0; l < a.size(); ++l)
    if (std::abs(a[l] - b[l]) > 1) return false;
  return true;
}

}  // namespace

struct Scan::Tables {
  std::array<double, grid_size> grid;
  std::vector<ChannelGram> grams;
};

Scan::Scan(const Observations& observations, double min_m)
    : observations_(&observations), tables_(std::make_unique<Tables>(Tables{m_grid(min_m), {}})) {
  tables_->grams = channel_grams(observations, tables_->grid);
}

Scan::~Scan() = default;

std::vector<brdf::CookTorrance> Scan::starts(const Structure& structure, std::size_t count, const ObjectiveOptions& options) const {
  const std::vector<Choice> choices = all_choices(structure.n_lobes);
  std::vector<double> cost(choices.size());
  tbb::parallel_for(std::size_t{0}, choices.size(), [&](std::size_t i) {
    for (const ChannelGram& channel : tables_->grams) cost[i] += channel.squared_mean - solve(channel, choices[i]).reduction;
  });
  std::vector<std::size_t> order(choices.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return cost[a] < cost[b]; });

  std::vector<Choice> chosen;
  for (const std::size_t i : order) {
    if (chosen.size() == screened_per_start * count) break;
    const auto near = [&](const Choice& other) { return neighbours(choices[i], other); };
    if (std::none_of(chosen.begin(), chosen.end(), near)) chosen.push_back(choices[i]);
  }
  // The scan's sum of squares stands for the objective but is not it: the objective has the last word.
  const Objective objective(*observations_, ParameterLayout(observations_->n_channels, structure), options);
  std::vector<std::pair<double, brdf::CookTorrance>> starts(chosen.size());
  tbb::parallel_for(std::size_t{0}, chosen.size(), [&](std::size_t i) {
    starts[i].second = model_of(tables_->grams, chosen[i], tables_->grid);
    starts[i].first = objective.cost(objective.layout().pack(starts[i].second));
  });
  std::stable_sort(starts.begin(), starts.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<brdf::CookTorrance> best;
  for (std::size_t i = 0; i < std::min(count, starts.size()); ++i) best.push_back(starts[i].second);
  return best;
}

}  // namespace lacquer::fit
