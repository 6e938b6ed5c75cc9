#include "libfit/usable_cells.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "libfit/fit.h"

namespace lacquer::fit {

namespace {

using brdf::CellOrigin;
using brdf::TableGrid;

/// Cosines up to this are grazing whatever the options say: 1 / cos^6 must fit into a float.
constexpr double nearest_to_horizon = 1e-6;

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

/// Decides about one channel of one cell, counts why not. `previous`: the channel that was last asked for cosines, which are not computed
/// again at the same place.
bool usable(const brdf::TableChannel& t, std::size_t i, double min_cosine, double safe_angle, const brdf::TableChannel* previous, bool& previous_grazing,
            LeftOut& left_out) {
  if (t.origin[i] == CellOrigin::empty) return false;
  const bool clipped = t.origin[i] == CellOrigin::clipped;
  if (!clipped && t.origin[i] != CellOrigin::measured) {
    ++left_out.not_measured;
    return false;
  }
  const brdf::HalfDiff c = coordinates(t, i);
  if (!std::isfinite(t.mean[i]) || !std::isfinite(t.variance[i]) || t.variance[i] < 0 || !in_hemisphere(c) ||
      !possible(footprint(t, i))) {
    ++left_out.not_finite;
    return false;
  }
  if (t.mean[i] <= 0 && (t.variance[i] == 0 || clipped)) {
    ++left_out.not_positive;
    return false;
  }
  if (c.theta_h + c.theta_d < safe_angle) {  // no azimuth brings a direction beyond the sum of the two
    previous_grazing = false;
  } else if (!previous || !same_place(t, *previous, i)) {
    const auto cosines = brdf::half_angle_cosines(c);
    previous_grazing = std::min(cosines.n_dot_i, cosines.n_dot_o) <= std::max(min_cosine, nearest_to_horizon);
  }
  left_out.grazing += previous_grazing;
  return !previous_grazing;
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

UsableCells usable_cells(const brdf::HalfAngleTable& table, const FitOptions& options) {
  constexpr std::size_t per_row = std::size_t{TableGrid::n_theta_d} * TableGrid::n_phi_d;
  const double safe_angle = std::acos(std::max(options.min_cosine, nearest_to_horizon)) - 1e-5;
  struct Row {
    std::size_t n = 0;
    bool footprints = false;
    LeftOut left_out;
  };
  std::vector<Row> rows(TableGrid::n_theta_h);
  std::vector<std::uint8_t> channels_of(TableGrid::n_cells);
  tbb::parallel_for(std::size_t{0}, rows.size(), [&](std::size_t row) {
    for (std::size_t i = row * per_row; i < (row + 1) * per_row; ++i) {
      unsigned channels = 0;
      const brdf::TableChannel* previous = nullptr;
      bool grazing = false;
      for (std::size_t c = 0; c < table.channels.size(); ++c) {
        const brdf::TableChannel& t = table.channels[c];
        if (!usable(t, i, options.min_cosine, safe_angle, previous, grazing, rows[row].left_out)) continue;
        if (previous && !same_place(t, *previous, i)) channels |= UsableCells::apart;
        previous = &t;
        channels |= 1u << c;
        rows[row].footprints |= t.footprint_along[i] != 0 || t.footprint_across[i] != 0;
      }
      channels_of[i] = static_cast<std::uint8_t>(channels);
      rows[row].n += channels != 0;
    }
  });
  UsableCells all;
  std::size_t n = 0;
  for (const Row& row : rows) {
    n += row.n;
    all.footprints |= row.footprints;
    all.left_out.grazing += row.left_out.grazing;
    all.left_out.not_positive += row.left_out.not_positive;
    all.left_out.not_finite += row.left_out.not_finite;
    all.left_out.not_measured += row.left_out.not_measured;
  }
  all.cells.reserve(n);
  all.channels.reserve(n);
  for (std::size_t i = 0; i < channels_of.size(); ++i) {
    if (channels_of[i] == 0) continue;
    all.cells.push_back(static_cast<std::uint32_t>(i));
    all.channels.push_back(channels_of[i]);
  }
  return all;
}

UsableCells stratified_choice(const UsableCells& usable, std::size_t max_cells) {
  const std::vector<std::uint32_t>& cells = usable.cells;
  if (cells.size() <= max_cells) return usable;
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

  UsableCells chosen;
  chosen.left_out = usable.left_out;
  chosen.footprints = usable.footprints;
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
      chosen.cells.push_back(cells[begin + place]);
      chosen.channels.push_back(usable.channels[begin + place]);
    }
    begin += size;
    shift += std::numbers::phi - 1;
    if (shift >= 1) shift -= 1;
  }
  return chosen;
}

}  // namespace lacquer::fit
