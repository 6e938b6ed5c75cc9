#include "libfit/observations.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "libfit/kernels.h"

namespace lacquer::fit {

namespace {

using brdf::CellOrigin;
using brdf::TableGrid;

/// Below this many sigmas a value is compared linearly: at 5 sigma the logarithm is still biased by 2 %
/// before, 0.1 % after correction.
constexpr double weak_signal = 5.0;

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
  std::vector<UsableCells> rows(TableGrid::n_theta_h);
  tbb::parallel_for(std::size_t{0}, rows.size(), [&](std::size_t row) {
    for (std::size_t i = row * per_row; i < (row + 1) * per_row; ++i) {
      unsigned channels = 0;
      const brdf::TableChannel* previous = nullptr;
      bool grazing = false;
      for (std::size_t c = 0; c < table.channels.size(); ++c) {
        const brdf::TableChannel& t = table.channels[c];
        if (!usable(t, i, options.min_cosine, safe_angle, previous, grazing, rows[row].left_out)) continue;
        previous = &t;
        channels |= 1u << c;
      }
      if (channels == 0) continue;
      rows[row].cells.push_back(static_cast<std::uint32_t>(i));
      rows[row].channels.push_back(static_cast<std::uint8_t>(channels));
    }
  });
  UsableCells all;
  for (const UsableCells& row : rows) {
    all.cells.insert(all.cells.end(), row.cells.begin(), row.cells.end());
    all.channels.insert(all.channels.end(), row.channels.begin(), row.channels.end());
    all.left_out.grazing += row.left_out.grazing;
    all.left_out.not_positive += row.left_out.not_positive;
    all.left_out.not_finite += row.left_out.not_finite;
    all.left_out.not_measured += row.left_out.not_measured;
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

namespace {

/// The cells' sets: index of the set for channel `c` of cell `k`; shared cells are in set 0.
struct SetSizes {
  bool footprint = false;
  std::array<std::vector<std::uint32_t>, 4> cells;  ///< positions in UsableCells: shared by all channels, then of channel 0, 1, 2 alone
};

SetSizes sort_into_sets(const brdf::HalfAngleTable& table, const UsableCells& cells) {
  SetSizes sizes;
  const std::size_t n_channels = table.channels.size();
  for (std::uint32_t k = 0; k < cells.cells.size(); ++k) {
    const std::uint32_t i = cells.cells[k];
    const brdf::TableChannel* first = nullptr;
    bool shared = true;
    for (std::size_t c = 0; c < n_channels; ++c) {
      if (!(cells.channels[k] >> c & 1)) continue;
      const brdf::TableChannel& t = table.channels[c];
      sizes.footprint |= t.footprint_along[i] != 0 || t.footprint_across[i] != 0;
      if (!first)
        first = &t;
      else
        shared &= same_place(t, *first, i);
    }
    if (shared) {
      sizes.cells[0].push_back(k);
    } else {
      for (std::size_t c = 0; c < n_channels; ++c)
        if (cells.channels[k] >> c & 1) sizes.cells[c + 1].push_back(k);
    }
  }
  return sizes;
}

/// Geometry of the positions `members` of `cells`; targets and weights stay to be set.
CellSet cell_set(const brdf::HalfAngleTable& table, const UsableCells& cells, const std::vector<std::uint32_t>& members, int first_channel,
                 int n_channels, bool footprints) {
  CellSet set;
  set.first_channel = first_channel;
  set.n_channels = n_channels;
  set.cell.resize(members.size());
  for (auto* column : {&set.tan2_theta_h, &set.schlick_weight, &set.front}) column->resize(members.size());
  if (footprints)
    for (auto* column : {&set.along, &set.across, &set.mixed}) column->resize(members.size());
  for (int c = 0; c < n_channels; ++c) {
    set.channels[static_cast<std::size_t>(c)].target.resize(members.size());
    set.channels[static_cast<std::size_t>(c)].inverse_sigma.resize(members.size());
  }
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, members.size(), 4096), [&](const auto& range) {
    for (std::size_t k = range.begin(); k < range.end(); ++k) {
      const std::uint32_t i = cells.cells[members[k]];
      set.cell[k] = i;
      std::size_t c = static_cast<std::size_t>(first_channel);
      while (!(cells.channels[members[k]] >> c & 1)) ++c;
      const brdf::TableChannel& t = table.channels[c];
      const auto cosines = brdf::half_angle_cosines(coordinates(t, i));
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

/// How one value is compared with the model.
struct Comparison {
  float target = 1, inverse_sigma = 0;
};

/// `signal`: what is believed to be the true value.
Comparison comparison(double mean, double variance, double signal, double model_sigma) {
  const double noise = std::sqrt(variance);
  const auto hypotenuse = [](double a, double b) { return std::sqrt(a * a + b * b); };  // neither overflows nor vanishes: floats
  // The mean too must be clear of zero, whatever the reference says: its logarithm is taken.
  if (mean > noise && signal > weak_signal * noise) {
    // E[ln(true + noise)] = ln(true) - variance / (2 true^2): the target is raised by that much.
    const double relative = noise / signal, bias = variance / (mean * mean) / 2;
    const double factor = bias < 0.01 ? 1 + bias * (1 + bias / 2 * (1 + bias / 3)) : std::exp(bias);  // to 4e-10: floats
    return {static_cast<float>(mean * factor), static_cast<float>(1 / hypotenuse(relative, model_sigma))};
  }
  return {static_cast<float>(mean), static_cast<float>(-1 / hypotenuse(noise, model_sigma * std::max(signal, mean)))};
}

/// A bound is kept or not, whatever the model says of its noise.
Comparison comparison_with_bound(double bound, double variance, double model_sigma) {
  return {static_cast<float>(-bound), static_cast<float>(1 / std::sqrt(variance / (bound * bound) + model_sigma * model_sigma))};
}

}  // namespace

Observations observe(const brdf::HalfAngleTable& table, const UsableCells& cells) {
  Observations result;
  result.table = &table;
  result.n_channels = static_cast<int>(table.channels.size());
  result.n_cells = cells.cells.size();
  for (std::size_t k = 0; k < cells.cells.size(); ++k)
    for (std::size_t c = 0; c < table.channels.size(); ++c)
      if (cells.channels[k] >> c & 1) ++(table.channels[c].origin[cells.cells[k]] == CellOrigin::clipped ? result.n_bounds : result.n_values);
  const SetSizes sizes = sort_into_sets(table, cells);
  for (int s = 0; s <= result.n_channels; ++s) {
    const auto& members = sizes.cells[static_cast<std::size_t>(s)];
    if (members.empty()) continue;
    result.sets.push_back(cell_set(table, cells, members, std::max(0, s - 1), s == 0 ? result.n_channels : 1, sizes.footprint));
    CellSet& set = result.sets.back();
    for (std::size_t k = 0; k < members.size(); ++k)
      for (int c = 0; c < set.n_channels; ++c)  // marks what is not usable; `weigh` leaves it alone
        set.channels[static_cast<std::size_t>(c)].inverse_sigma[k] =
            static_cast<float>(cells.channels[members[k]] >> (set.first_channel + c) & 1);
  }
  return result;
}

void weigh(Observations& observations, double model_sigma, const brdf::CookTorrance* reference) {
  for (CellSet& set : observations.sets)
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, set.size(), 4096), [&](const auto& range) {
      std::array<std::vector<double>, 3> values;
      if (reference) evaluate(set, range.begin(), range.end(), *reference, values);
      for (int c = 0; c < set.n_channels; ++c) {
        const brdf::TableChannel& t = observations.table->channels[static_cast<std::size_t>(set.first_channel + c)];
        CellSet::Channel& channel = set.channels[static_cast<std::size_t>(c)];
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
          if (channel.inverse_sigma[k] == 0) {
            channel.target[k] = 1;
            continue;
          }
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

namespace {

/// work(first, last) for the runs of cells that share (theta_h, theta_d).
template <typename Work>
void for_each_group(const CellSet& set, const Work& work) {
  for (std::size_t begin = 0, end; begin < set.size(); begin = end) {
    const std::uint32_t group = set.cell[begin] / TableGrid::n_phi_d;
    for (end = begin; end < set.size() && set.cell[end] / TableGrid::n_phi_d == group;) ++end;
    work(begin, end);
  }
}

/// 1 / sigma of the logarithm.
double relative_weight(const CellSet::Channel& channel, std::size_t k) {
  return channel.inverse_sigma[k] >= 0 ? channel.inverse_sigma[k] : -channel.inverse_sigma[k] * std::max(0.0f, channel.target[k]);
}

}  // namespace

double shared_error(const Observations& observations, const brdf::CookTorrance& model) {
  constexpr double normal_median_square = 0.4549, model_fits = 4;
  struct Group {
    double mean, variance;
  };
  std::vector<Group> groups;
  for (const CellSet& set : observations.sets) {
    std::array<std::vector<double>, 3> values;
    for_each_group(set, [&](std::size_t begin, std::size_t end) {
      evaluate(set, begin, end, model, values);
      for (int c = 0; c < set.n_channels; ++c) {
        const CellSet::Channel& channel = set.channels[static_cast<std::size_t>(c)];
        std::vector<double>& ratio = values[static_cast<std::size_t>(c)];
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
        if (weight > 0) groups.push_back({sum / weight, 1 / weight});
      }
    });
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
    for (int c = 0; c < set.n_channels; ++c) {
      CellSet::Channel& channel = set.channels[static_cast<std::size_t>(c)];
      for_each_group(set, [&](std::size_t begin, std::size_t end) {
        double weight = 0;
        for (std::size_t k = begin; k < end; ++k) weight += std::pow(relative_weight(channel, k), 2);
        const auto factor = static_cast<float>(1 / std::sqrt(1 + shared * shared * weight));
        for (std::size_t k = begin; k < end; ++k) channel.inverse_sigma[k] *= factor;
      });
    }
}

}  // namespace lacquer::fit
