#include "libfit/objective.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace lacquer::fit {

namespace {

constexpr std::size_t cells_per_chunk = 2048;

/// Stretch of a set.
struct Chunk {
  const CellSet* set;
  std::size_t begin, end;
};

std::vector<Chunk> chunks_of(const Observations& observations) {
  std::vector<Chunk> chunks;
  for (const CellSet& set : observations.sets)
    for (std::size_t begin = 0; begin < set.size(); begin += cells_per_chunk)
      chunks.push_back({&set, begin, std::min(set.size(), begin + cells_per_chunk)});
  return chunks;
}

/// Position of local parameter `i` of a channel in the solver's vector; -1: not a parameter of the structure.
int global_index(const ParameterLayout& layout, int channel, int i) {
  if (i == 0) return layout.kd(channel);
  if (i <= layout.n_lobes()) return layout.ks(i - 1, channel);
  const int shape = i - 1 - layout.n_lobes();
  return shape % 2 == 0 ? layout.log_m(shape / 2) : layout.r(shape / 2);
}

/// Adds the channels' sums to the quadratic of the solver's parameters.
void add_sums(const ParameterLayout& layout, const Sums& sums, Quadratic& q) {
  const int n = layout.size(), n_local = 1 + 3 * layout.n_lobes();
  q.gradient.resize(static_cast<std::size_t>(n));
  q.curvature.resize(static_cast<std::size_t>(n) * static_cast<std::size_t>(n));
  for (int c = 0; c < layout.n_channels(); ++c) {
    const ChannelSums& channel = sums[static_cast<std::size_t>(c)];
    q.cost += channel.cost;
    for (int i = 0; i < n_local; ++i) {
      const int gi = global_index(layout, c, i);
      if (gi < 0) continue;
      q.gradient[gi] += channel.gradient[i];
      for (int j = i; j < n_local; ++j) {
        const int gj = global_index(layout, c, j);
        q.curvature[gi * n + gj] += channel.curvature[i][j];
        if (gi != gj) q.curvature[gj * n + gi] += channel.curvature[i][j];
      }
    }
  }
}

/// Share of a lobe's light that leaves the surface at normal incidence, and its derivative by ln(m).
struct Escape {
  double value, d_log_m;
  explicit Escape(double m) {
    const double x = 0.6 / (m * m);
    value = -std::expm1(-x);
    d_log_m = -2 * x * std::exp(-x);
  }
};

/// Residual of the energy penalty of one channel: 0 while the albedo is at most 1. Scaled by the number of
/// observations, so that it means the same for any table. Its square is smooth.
double energy_residual(double albedo, double weight, std::size_t n_values) {
  return std::max(0.0, albedo - 1) * weight * std::sqrt(static_cast<double>(n_values));
}

void add_energy(const ParameterLayout& layout, const brdf::CookTorrance& model, double weight,
                std::size_t n_values, Quadratic& q) {
  const glm::dvec3 albedo = normal_incidence_albedo(model);
  const double slope = weight * std::sqrt(static_cast<double>(n_values));
  const int n = layout.size();
  for (int c = 0; c < layout.n_channels(); ++c) {
    const double r = energy_residual(albedo[c], weight, n_values);
    if (r == 0) continue;
    std::vector<double> row(static_cast<std::size_t>(n));
    if (layout.kd(c) >= 0) row[layout.kd(c)] = slope;
    for (int l = 0; l < layout.n_lobes(); ++l) {
      const auto& lobe = model.lobes[static_cast<std::size_t>(l)];
      const Escape escape(lobe.m);
      row[layout.ks(l, c)] = slope * 4 * lobe.r * escape.value;
      row[layout.log_m(l)] = slope * 4 * lobe.ks[c] * lobe.r * escape.d_log_m;
      row[layout.r(l)] = slope * 4 * lobe.ks[c] * escape.value;
    }
    q.cost += r * r;
    for (int i = 0; i < n; ++i) {
      q.gradient[i] += row[i] * r;
      for (int j = 0; j < n; ++j) q.curvature[i * n + j] += row[i] * row[j];
    }
  }
}

}  // namespace

void add(const ChannelSums& from, int n, ChannelSums& to) {
  to.cost += from.cost;
  for (int i = 0; i < n; ++i) {
    to.gradient[i] += from.gradient[i];
    for (int j = i; j < n; ++j) to.curvature[i][j] += from.curvature[i][j];
  }
}

Quadratic quadratic_of(const ParameterLayout& layout, const Sums& sums, const brdf::CookTorrance& model, double energy_weight, std::size_t n_values) {
  Quadratic q;
  add_sums(layout, sums, q);
  if (energy_weight > 0) add_energy(layout, model, energy_weight, n_values, q);
  return q;
}

glm::dvec3 normal_incidence_albedo(const brdf::CookTorrance& model) {
  glm::dvec3 albedo = model.kd;
  for (const auto& lobe : model.lobes) albedo += lobe.ks * (4 * lobe.r * Escape(lobe.m).value);
  return albedo;
}

Objective::Objective(const Observations& observations, ParameterLayout layout, ObjectiveOptions options)
    : observations_(&observations), layout_(std::move(layout)), options_(options) {}

double Objective::cost(const std::vector<double>& x) const {
  const brdf::CookTorrance model = layout_.unpack(x);
  const std::vector<Chunk> chunks = chunks_of(*observations_);
  std::vector<double> costs(chunks.size());
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
    costs[i] = fit::cost(*chunks[i].set, chunks[i].begin, chunks[i].end, model, options_.robust_scale);
  });
  double total = 0;
  for (const double c : costs) total += c;
  const glm::dvec3 albedo = normal_incidence_albedo(model);
  for (int c = 0; c < layout_.n_channels(); ++c) {
    const double r = energy_residual(albedo[c], options_.energy_weight, observations_->n_values);
    total += r * r;
  }
  return total;
}

Quadratic Objective::quadratic(const std::vector<double>& x, Curvature kind) const {
  const brdf::CookTorrance model = layout_.unpack(x);
  const std::vector<Chunk> chunks = chunks_of(*observations_);
  std::vector<Sums> sums(chunks.size());
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
    add_quadratic(*chunks[i].set, chunks[i].begin, chunks[i].end, model, options_.robust_scale, kind, sums[i]);
  });
  Sums total;
  for (const Sums& chunk : sums)
    for (std::size_t c = 0; c < 3; ++c) add(chunk[c], 1 + 3 * layout_.n_lobes(), total[c]);
  return quadratic_of(layout_, total, model, options_.energy_weight, observations_->n_values);
}

GroupedQuadratics grouped_quadratics(const Objective& objective, const std::vector<double>& x) {
  using brdf::TableGrid;
  constexpr int n_strips = 15, rows_per_strip = TableGrid::n_theta_h / n_strips;  // fixed, so that the sums' order is
  const ParameterLayout& layout = objective.layout();
  const brdf::CookTorrance model = layout.unpack(x);
  const int n = 1 + 3 * layout.n_lobes();
  struct Group {
    Sums sums;
    bool seen = false;
    void add(const Group& other, int size) {
      if (!other.seen) return;
      seen = true;
      for (std::size_t c = 0; c < 3; ++c) fit::add(other.sums[c], size, sums[c]);
    }
  };
  std::vector<Group> rows(TableGrid::n_theta_h);
  std::vector<std::vector<Group>> columns(n_strips);
  tbb::parallel_for(0, n_strips, [&](int strip) {
    auto& strip_columns = columns[static_cast<std::size_t>(strip)];
    strip_columns.resize(TableGrid::n_theta_d);
    for (int h = strip * rows_per_strip; h < (strip + 1) * rows_per_strip; ++h)
      for (const CellSet& set : objective.observations().sets) {
        // Cells ascend: those of one theta_h and theta_d follow each other.
        const auto first_cell = static_cast<std::uint32_t>(TableGrid::index(TableGrid::Cell{h, 0, 0}));
        auto begin = std::lower_bound(set.cell.begin(), set.cell.end(), first_cell);
        for (int d = 0; d < TableGrid::n_theta_d; ++d) {
          const auto end = std::lower_bound(begin, set.cell.end(), first_cell + static_cast<std::uint32_t>((d + 1) * TableGrid::n_phi_d));
          if (begin == end) continue;
          Group group;
          group.seen = true;
          add_quadratic(set, static_cast<std::size_t>(begin - set.cell.begin()), static_cast<std::size_t>(end - set.cell.begin()), model,
                        objective.options().robust_scale, Curvature::gauss_newton, group.sums);
          rows[static_cast<std::size_t>(h)].add(group, n);
          strip_columns[static_cast<std::size_t>(d)].add(group, n);
          begin = end;
        }
      }
  });
  GroupedQuadratics result;
  Group all;
  for (const Group& row : rows) {
    if (!row.seen) continue;
    all.add(row, n);
    result.theta_h_rows.push_back(quadratic_of(layout, row.sums, model, 0, 0));
  }
  for (std::size_t d = 0; d < TableGrid::n_theta_d; ++d) {
    Group column;
    for (const auto& strip : columns) column.add(strip[d], n);
    if (column.seen) result.theta_d_columns.push_back(quadratic_of(layout, column.sums, model, 0, 0));
  }
  result.all = quadratic_of(layout, all.sums, model, objective.options().energy_weight, objective.observations().n_values);
  return result;
}

}  // namespace lacquer::fit
