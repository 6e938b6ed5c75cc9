#include "libfit/observations.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace lacquer::fit {

namespace {

using brdf::CellOrigin;
using brdf::TableGrid;

/// Below this many sigmas a value is compared linearly: at 5 sigma the logarithm is still biased by 2 %
/// before, 0.1 % after correction.
constexpr double weak_signal = 5.0;

brdf::HalfDiff coordinates(const brdf::TableChannel& t, std::size_t i) {
  return {t.theta_h[i], t.theta_d[i], t.phi_d[i]};
}

bool same_place(const brdf::TableChannel& a, const brdf::TableChannel& b, std::size_t i) {
  return a.theta_h[i] == b.theta_h[i] && a.theta_d[i] == b.theta_d[i] && a.phi_d[i] == b.phi_d[i] &&
         a.footprint_along[i] == b.footprint_along[i] && a.footprint_across[i] == b.footprint_across[i] &&
         a.footprint_mixed[i] == b.footprint_mixed[i];
}

brdf::Footprint<double> footprint(const brdf::TableChannel& t, std::size_t i) {
  return {t.footprint_along[i], t.footprint_across[i], t.footprint_mixed[i]};
}

/// A covariance: finite and, but for rounding, positive semidefinite.
bool possible(const brdf::Footprint<double>& v) {
  return v.along >= 0 && v.across >= 0 && std::isfinite(v.along) && std::isfinite(v.across) &&
         v.mixed * v.mixed <= v.along * v.across * (1 + 1e-5);
}

bool in_hemisphere(const brdf::HalfDiff& c) {
  constexpr double half_pi = std::numbers::pi / 2;
  // Not written with "outside" comparisons: NaN must fail. At theta_h = 90 deg no direction is above the
  // horizon.
  return c.theta_h >= 0 && c.theta_h < half_pi && c.theta_d >= 0 && c.theta_d <= half_pi + 1e-6 &&
         std::isfinite(c.phi_d);
}

/// Decides about one channel of one cell, counts why not.
bool usable(const brdf::TableChannel& t, std::size_t i, double min_cosine, LeftOut& left_out) {
  if (t.origin[i] == CellOrigin::empty) return false;
  if (t.origin[i] != CellOrigin::measured) {
    ++left_out.not_measured;
    return false;
  }
  const brdf::HalfDiff c = coordinates(t, i);
  if (!std::isfinite(t.mean[i]) || !std::isfinite(t.variance[i]) || t.variance[i] < 0 || !in_hemisphere(c) ||
      !possible(footprint(t, i))) {
    ++left_out.not_finite;
    return false;
  }
  if (t.mean[i] <= 0 && t.variance[i] == 0) {
    ++left_out.not_positive;
    return false;
  }
  const auto cosines = brdf::half_angle_cosines(c);
  if (std::min(cosines.n_dot_i, cosines.n_dot_o) <= min_cosine) {
    ++left_out.grazing;
    return false;
  }
  return true;
}

/// Splits ascending indices into runs of one (theta_h, group of `width` theta_d) each; returns the run
/// lengths.
std::vector<std::uint32_t> group_sizes(const std::vector<std::uint32_t>& cells, int width) {
  std::vector<std::uint32_t> sizes;
  std::int64_t previous = -1;
  for (const std::uint32_t cell : cells) {
    const TableGrid::Cell c = TableGrid::cell(cell);
    const std::int64_t group = std::int64_t{c.theta_h} * TableGrid::n_theta_d + c.theta_d / width;
    if (group != previous) sizes.push_back(0);
    previous = group;
    ++sizes.back();
  }
  return sizes;
}

std::uint64_t total_with_limit(const std::vector<std::uint32_t>& sizes, std::uint32_t limit) {
  std::uint64_t total = 0;
  for (const std::uint32_t size : sizes) total += std::min(size, limit);
  return total;
}

}  // namespace

std::vector<std::uint32_t> usable_cells(const brdf::HalfAngleTable& table, const FitOptions& options,
                                        LeftOut& left_out) {
  struct Row {
    std::vector<std::uint32_t> cells;
    LeftOut left_out;
  };
  constexpr std::size_t per_row = std::size_t{TableGrid::n_theta_d} * TableGrid::n_phi_d;
  std::vector<Row> rows(TableGrid::n_theta_h);
  tbb::parallel_for(std::size_t{0}, rows.size(), [&](std::size_t row) {
    for (std::size_t i = row * per_row; i < (row + 1) * per_row; ++i) {
      bool any = false;
      for (const auto& channel : table.channels)
        any |= usable(channel, i, options.min_cosine, rows[row].left_out);
      if (any) rows[row].cells.push_back(static_cast<std::uint32_t>(i));
    }
  });
  std::vector<std::uint32_t> cells;
  for (const Row& row : rows) {
    cells.insert(cells.end(), row.cells.begin(), row.cells.end());
    left_out.grazing += row.left_out.grazing;
    left_out.not_positive += row.left_out.not_positive;
    left_out.not_finite += row.left_out.not_finite;
    left_out.not_measured += row.left_out.not_measured;
  }
  return cells;
}

std::vector<std::uint32_t> stratified_choice(const std::vector<std::uint32_t>& cells, std::size_t max_cells) {
  if (cells.size() <= max_cells) return cells;
  int width = 1;
  std::vector<std::uint32_t> sizes = group_sizes(cells, width);
  while (sizes.size() > max_cells && width < TableGrid::n_theta_d) sizes = group_sizes(cells, width *= 2);
  if (sizes.size() > max_cells)
    sizes = {static_cast<std::uint32_t>(cells.size())};  // fewer cells asked for than theta_h rows

  std::uint32_t low = 1,
                high = static_cast<std::uint32_t>(max_cells);  // largest limit per group that keeps the total
  while (low < high) {
    const std::uint32_t middle = low + (high - low + 1) / 2;
    if (total_with_limit(sizes, middle) <= max_cells)
      low = middle;
    else
      high = middle - 1;
  }
  // What is left over goes to every so many-th of the groups that have more.
  const auto larger = static_cast<std::uint64_t>(
      std::count_if(sizes.begin(), sizes.end(), [&](auto size) { return size > low; }));
  const std::uint64_t left_over = max_cells - total_with_limit(sizes, low);
  std::uint64_t seen = 0;

  std::vector<std::uint32_t> chosen;
  chosen.reserve(max_cells);
  std::size_t begin = 0;
  double shift = 0;
  for (const std::uint32_t size : sizes) {
    std::uint32_t n = std::min(size, low);
    if (size > low) {
      if ((seen + 1) * left_over / larger > seen * left_over / larger) ++n;
      ++seen;
    }
    for (std::uint32_t k = 0; k < n; ++k) {
      // The first place within a step moves from group to group by the golden ratio, so that phi_d is covered
      // evenly as a whole.
      const auto place = static_cast<std::size_t>((k + (n == size ? 0.0 : shift)) * size / n);
      chosen.push_back(cells[begin + place]);
    }
    begin += size;
    shift += std::numbers::phi - 1;
    if (shift >= 1) shift -= 1;
  }
  return chosen;
}

Observations observe(const brdf::HalfAngleTable& table, const std::vector<std::uint32_t>& cells,
                     const FitOptions& options) {
  Observations result;
  result.n_channels = static_cast<int>(table.channels.size());
  result.n_cells = cells.size();
  result.points.reserve(cells.size());
  result.values.reserve(cells.size() * table.channels.size());
  LeftOut ignored;
  for (const std::uint32_t i : cells) {
    const brdf::TableChannel* previous = nullptr;
    for (std::size_t c = 0; c < table.channels.size(); ++c) {
      const brdf::TableChannel& t = table.channels[c];
      if (!usable(t, i, options.min_cosine, ignored)) continue;
      const auto next = static_cast<std::uint32_t>(result.values.size());
      if (!previous || !same_place(t, *previous, i)) {
        result.points.push_back({brdf::half_angle_cosines(coordinates(t, i)), next, next});
        result.points.back().cosines.footprint = footprint(t, i);
      }
      previous = &t;
      result.values.push_back(
          {.mean = t.mean[i], .variance = t.variance[i], .channel = static_cast<std::uint8_t>(c)});
      result.points.back().end = next + 1;
    }
  }
  weigh(result, options.model_sigma);
  return result;
}

void weigh(Observations& observations, double model_sigma, const brdf::CookTorrance* reference) {
  tbb::parallel_for(std::size_t{0}, observations.points.size(), [&](std::size_t i) {
    const Point& point = observations.points[i];
    const glm::dvec3 expected = reference ? reference->value(point.cosines) : glm::dvec3(0);
    for (std::uint32_t k = point.first; k < point.end; ++k) {
      Observation& o = observations.values[k];
      const double noise = std::sqrt(double{o.variance});
      const double signal = reference ? expected[o.channel] : std::max(double{o.mean}, 0.0);
      // The mean too must be clear of zero, whatever the reference says: its logarithm is taken.
      o.logarithmic = o.mean > noise && (signal > weak_signal * noise);
      if (o.logarithmic) {
        const double relative = noise / signal, measured_relative = noise / o.mean;
        o.inverse_sigma = 1 / std::hypot(relative, model_sigma);
        o.log_bias = static_cast<float>(measured_relative * measured_relative / 2);
      } else {
        o.inverse_sigma = 1 / std::hypot(noise, model_sigma * std::max(signal, double{o.mean}));
        o.log_bias = 0;
      }
    }
  });
}

}  // namespace lacquer::fit
