#include "libbrdf/fill_table.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <random>

#include "libbrdf/error.h"
#include "libbrdf/fill_kriging.h"

namespace lacquer::brdf {

namespace {

using Place = FoldedChannel::Place;
using Pattern = FillPattern;
using Prediction = Kriging::Prediction;

/// Whether a folded cell is to be filled: neither half is known, its centre is far enough above the horizon.
std::vector<Place> holes_of(const Kriging& kriging, double min_cosine) {
  std::vector<Place> holes;
  for (int h = 0; h < FoldedChannel::n_h; ++h)
    for (int d = 0; d < FoldedChannel::n_d; ++d)
      for (int p = 0; p < FoldedChannel::n_p; ++p)
        if (!kriging.known({h, d, p}) && TableGrid::reachable(TableGrid::Cell{h, d, p}, min_cosine)) holes.push_back({h, d, p});
  return holes;
}

/// How far predictions are off where the truth is known, beside what they say of themselves. The paint is less smooth towards grazing and at
/// its peak: the factor on sigma is that of a class of gaps and places.
struct Calibration {
  static constexpr std::size_t n_grazing = 4, n_rows = 3, n_classes = n_gaps * n_grazing * n_rows;
  double length_scale = 1, mean_abs_log = 0;
  std::array<double, n_grazing - 1> limits{};  // of ln(cos(theta_i) cos(theta_o)), between the classes
  std::array<double, n_classes> factor, own_side_factor;  // the latter of predictions from the hole's own side of the mirror planes alone
  Calibration() { factor.fill(1), own_side_factor.fill(1); }
  std::size_t class_of(std::size_t gap, int theta_h, double log_cosines) const {
    const auto grazing = static_cast<std::size_t>(std::upper_bound(limits.begin(), limits.end(), log_cosines) - limits.begin());
    return (gap * n_grazing + grazing) * n_rows + static_cast<std::size_t>(theta_h) * n_rows / FoldedChannel::n_h;
  }
};

/// The part of a pattern on the hole's own side of the mirror planes phi_d = 0 and 90 deg.
Pattern own_side(const Place& hole, const Pattern& pattern) {
  Pattern own;
  for (int k = 0; k < pattern.n; ++k) {
    const Place& o = pattern.offset[static_cast<std::size_t>(k)];
    if (hole.p + o.p >= 0 && hole.p + o.p < FoldedChannel::n_p) own.offset[static_cast<std::size_t>(own.n++)] = o;
  }
  return own;
}

struct Trial {
  double own_sigma, error;
  std::size_t gap;
  int theta_h;
  double log_cosines;
  std::array<double, 3> stretch;  ///< distances of its data along theta_h, theta_d, phi_d, relative to those of the hole that it stands for
};

double percentile_95(std::vector<double>& values) {
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(values.size()));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

/// The pattern around a hole, laid around a known cell: where the cell that it asks for is not known, the next one further out stands in, along as
/// few axes as possible. `scale`: the pattern so many times as far apart along each axis.
struct LaidPattern : Pattern {
  std::array<double, 3> stretch{1, 1, 1};  ///< distances along theta_h, theta_d, phi_d, relative to those asked for
};
LaidPattern laid_around(const Kriging& kriging, const Place& donor, const Pattern& pattern, const Place& scale) {
  static const std::vector<Place> growths = [] {
    std::vector<Place> all;
    for (int sum = 0; sum <= 3; ++sum)
      for (int h = 0; h <= sum; ++h)
        for (int d = 0; d <= sum - h; ++d) all.push_back({h, d, sum - h - d});
    return all;
  }();
  const auto grown = [](int size, int by) { return size == 0 ? 0 : size + (size > 0 ? by : -by); };
  LaidPattern laid;
  std::array<int, 3> asked{}, found{};
  for (int k = 0; k < pattern.n; ++k) {
    const Place& o = pattern.offset[static_cast<std::size_t>(k)];
    for (const Place& g : growths) {
      if ((o.h == 0 && g.h > 0) || (o.d == 0 && g.d > 0) || (o.p == 0 && g.p > 0)) continue;
      const Place offset{grown(o.h * scale.h, g.h), grown(o.d * scale.d, g.d), grown(o.p * scale.p, g.p)};
      if (!kriging.known({donor.h + offset.h, donor.d + offset.d, donor.p + offset.p})) continue;
      const auto used = [&](const Place& other) { return other.h == offset.h && other.d == offset.d && other.p == offset.p; };
      if (std::any_of(laid.offset.begin(), laid.offset.begin() + laid.n, used)) continue;
      laid.offset[static_cast<std::size_t>(laid.n++)] = offset;
      asked[0] += std::abs(o.h), asked[1] += std::abs(o.d), asked[2] += std::abs(o.p);
      found[0] += std::abs(offset.h), found[1] += std::abs(offset.d), found[2] += std::abs(offset.p);
      break;
    }
  }
  for (std::size_t axis = 0; axis < 3; ++axis)
    if (asked[axis] > 0) laid.stretch[axis] = static_cast<double>(found[axis]) / asked[axis];
  return laid;
}

/// `scale`: see laid_around. `own_side_only`: of holes with data beyond a mirror plane, and from those on their own side.
std::vector<Trial> trials_of(const Kriging& kriging, const std::vector<Place>& holes, std::size_t n_trials, double length_scale, const Place& scale,
                             bool own_side_only) {
  std::mt19937_64 generator(20050901);
  const auto below = [&](int n) { return static_cast<int>(generator() % static_cast<unsigned>(n)); };
  struct Experiment {
    Place donor;
    LaidPattern pattern;
    std::size_t gap;  // of the hole
  };
  std::vector<Experiment> experiments;
  for (std::size_t t = 0; t < n_trials && !holes.empty(); ++t) {
    // Gaps of every width in equal parts, as far as there are any.
    Place hole{};
    Pattern pattern;
    for (int draw = 0; draw < 6 && (draw == 0 || pattern.n < 4 || gap_class(pattern.nearest()) != t % n_gaps); ++draw) {
      hole = holes[generator() % holes.size()];
      pattern = kriging.pattern(hole);
    }
    if (own_side_only) {
      const int n = pattern.n;
      pattern = own_side(hole, pattern);
      if (pattern.n == n) continue;
    }
    for (int attempt = 0; attempt < 48 && pattern.n >= 4; ++attempt) {
      const int wide = attempt / 16;  // the donor of the truth: along phi_d first, where the paint changes least
      const int p = hole.p + below(91) - 45;
      const Place donor{hole.h + below(4 * wide + 1) - 2 * wide, hole.d + below(6 * wide + 3) - 3 * wide - 1, p};
      if (!kriging.known(donor)) continue;
      const LaidPattern laid = laid_around(kriging, donor, pattern, scale);
      if (laid.n * 10 < pattern.n * 8) continue;
      experiments.push_back({donor, laid, gap_class(pattern.nearest())});
      break;
    }
  }
  std::vector<Trial> trials(experiments.size());
  tbb::parallel_for(std::size_t{0}, experiments.size(), [&](std::size_t k) {
    const auto& [donor, pattern, gap] = experiments[k];
    const std::size_t i = FoldedChannel::index(donor);
    const auto p = kriging.predict(donor, pattern, length_scale);
    if (p)
      trials[k] = {std::sqrt(p->variance + kriging.data().variance(i)), std::abs(p->log - kriging.data().log(i) - kriging.data().row_mean(donor.h)),
                   gap, donor.h, kriging.log_cosines(donor), pattern.stretch};
  });
  std::erase_if(trials, [](const Trial& t) { return t.own_sigma == 0; });
  return trials;
}

/// By which the own sigmas of each class must grow for 95 % of its errors to lie within 1.96 of them; classes with few trials take the gap's, or all.
std::array<double, Calibration::n_classes> factors_of(const std::vector<Trial>& trials, const Calibration& classes, std::size_t enough) {
  std::vector<double> all;
  std::array<std::vector<double>, n_gaps> by_gap;
  std::array<std::vector<double>, Calibration::n_classes> ratios;
  for (const Trial& t : trials) {
    const double ratio = t.error / (1.96 * t.own_sigma);
    const std::size_t c = classes.class_of(t.gap, t.theta_h, t.log_cosines);
    all.push_back(ratio);
    by_gap[t.gap].push_back(ratio);
    ratios[c].push_back(ratio);
  }
  const double overall = percentile_95(all);
  std::array<double, Calibration::n_classes> factors;
  for (std::size_t c = 0; c < Calibration::n_classes; ++c) {
    auto& gap = by_gap[c / (Calibration::n_classes / n_gaps)];
    factors[c] = std::max(1e-3, ratios[c].size() >= enough ? percentile_95(ratios[c]) : gap.size() >= enough ? percentile_95(gap) : overall);
  }
  return factors;
}

Calibration calibrate(const Kriging& kriging, const std::vector<Place>& holes, std::size_t n_trials) {
  Calibration best;
  std::vector<Trial> trials;
  for (const double scale : Kriging::length_scales) {
    std::vector<Trial> now = trials_of(kriging, holes, n_trials, scale, {1, 1, 1}, false);
    double sum = 0;
    for (const Trial& t : now) sum += t.error;
    if (now.empty()) continue;
    sum /= static_cast<double>(now.size());
    if (!trials.empty() && sum >= best.mean_abs_log) continue;
    best.length_scale = scale;
    best.mean_abs_log = sum;
    trials = std::move(now);
  }
  constexpr std::size_t enough = 60;
  if (trials.size() < enough) return best;
  std::vector<double> cosines;
  for (const Trial& t : trials) cosines.push_back(t.log_cosines);
  std::sort(cosines.begin(), cosines.end());
  for (std::size_t c = 1; c < Calibration::n_grazing; ++c) best.limits[c - 1] = cosines[c * cosines.size() / Calibration::n_grazing];
  best.factor = best.own_side_factor = factors_of(trials, best, enough);
  if (const auto own = trials_of(kriging, holes, n_trials, best.length_scale, {1, 1, 1}, true); own.size() >= enough)
    best.own_side_factor = factors_of(own, best, enough);

  // Where every other row is missing, no known cell has its data as near as the holes have. What doubling the distance across the rows did to a
  // factor, halving it undoes; it never makes it larger.
  std::array<int, 3> scale{1, 1, 1};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::vector<double> stretches;
    for (const Trial& t : trials) stretches.push_back(t.stretch[axis]);
    const auto median = stretches.begin() + static_cast<std::ptrdiff_t>(stretches.size() / 2);
    std::nth_element(stretches.begin(), median, stretches.end());
    if (*median > 1.5) scale[axis] = 4;
  }
  if (scale == std::array<int, 3>{1, 1, 1}) return best;
  const std::vector<Trial> wider = trials_of(kriging, holes, n_trials, best.length_scale, {scale[0], scale[1], scale[2]}, false);
  if (wider.size() < enough) return best;
  const auto wide = factors_of(wider, best, enough);
  for (std::size_t c = 0; c < Calibration::n_classes; ++c) best.factor[c] *= std::min(1.0, best.factor[c] / wide[c]);
  return best;
}

void set_cell(TableChannel& t, std::size_t i, double mean, double sigma, CellOrigin origin) {
  const HalfDiff centre = TableGrid::centre(i);
  t.mean[i] = static_cast<float>(mean);
  t.variance[i] = static_cast<float>(std::pow(sigma * mean, 2));
  t.count[i] = 0;
  t.theta_h[i] = static_cast<float>(centre.theta_h);
  t.theta_d[i] = static_cast<float>(centre.theta_d);
  t.phi_d[i] = static_cast<float>(centre.phi_d);
  t.footprint_along[i] = t.footprint_across[i] = t.footprint_mixed[i] = 0;
  t.origin[i] = origin;
}

void copy_mirror(TableChannel& t, std::size_t i, std::size_t from) {
  const HalfDiff centre = TableGrid::centre(i);
  t.mean[i] = t.mean[from];
  t.variance[i] = t.variance[from];
  t.count[i] = t.count[from];
  t.theta_h[i] = t.theta_h[from];
  t.theta_d[i] = t.theta_d[from];
  t.phi_d[i] = static_cast<float>(std::min(std::numbers::pi - double{t.phi_d[from]}, centre.phi_d + 0.01));
  t.footprint_along[i] = t.footprint_along[from];
  t.footprint_across[i] = t.footprint_across[from];
  t.footprint_mixed[i] = -t.footprint_mixed[from];
  t.origin[i] = CellOrigin::symmetric;
}

FillReport fill_channel(TableChannel& t, std::size_t channel, const FillOptions& options) {
  const Kriging kriging(t);
  FillReport report;
  if (kriging.data().n_known() == 0) return report;
  const std::vector<Place> holes = holes_of(kriging, options.min_cosine);
  const Calibration calibration = calibrate(kriging, holes, options.n_trials);
  report.n_data = kriging.data().n_known();
  report.length_scale = calibration.length_scale;
  report.trial_mean_abs_log = calibration.mean_abs_log;
  report.trial_sigma_factor = *std::max_element(calibration.factor.begin(), calibration.factor.end());

  // What the model is off by where there are data; taken as its error where there are none.
  double model_sigma = 0;
  std::size_t n_compared = 0;
  const auto model_value = [&](std::size_t cell) -> double {
    const auto f = options.model->value(directions(TableGrid::centre(cell)));
    return f ? (*f)[static_cast<int>(channel)] : 0;
  };
  for (std::size_t i = 0; options.model && i < TableGrid::n_cells; i += 17) {
    const TableGrid::Cell c = TableGrid::cell(i);
    const Place place{c.theta_h, c.theta_d, c.phi_d};
    const double f = kriging.known(place) ? model_value(i) : 0;
    if (!(f > 0)) continue;
    model_sigma += std::pow(std::log(f) - kriging.data().log(FoldedChannel::index(place)) - kriging.data().row_mean(place.h), 2);
    ++n_compared;
  }
  model_sigma = n_compared ? std::sqrt(model_sigma / static_cast<double>(n_compared)) : 0;

  std::vector<std::optional<Prediction>> predictions(holes.size());
  std::vector<double> sigmas(holes.size());
  tbb::parallel_for(std::size_t{0}, holes.size(), [&](std::size_t k) {
    const Pattern pattern = kriging.pattern(holes[k]), own = own_side(holes[k], pattern);
    const auto both = kriging.predict(holes[k], pattern, calibration.length_scale);
    predictions[k] = both;
    if (!both) return;
    const std::size_t c = calibration.class_of(both->gap, holes[k].h, kriging.log_cosines(holes[k]));
    double variance = std::pow(calibration.factor[c], 2) * both->variance;
    // Data beyond a mirror plane are those before it once more: interpolating between them takes for granted that the paint is smooth there, but
    // V grooves shadow with a crease at phi_d = 90 deg. Where the data before it alone contradict that, by more than both are known to, it is not known.
    if (own.n < pattern.n)
      if (const auto one = kriging.predict(holes[k], own, calibration.length_scale)) {
        const double difference = one->log - both->log, expected2 = variance + std::pow(calibration.own_side_factor[c], 2) * one->variance;
        if (difference * difference > 1.96 * 1.96 * expected2) variance += difference * difference - expected2;
      }
    sigmas[k] = std::sqrt(variance);
  });
  const auto fill_cell = [&](std::size_t i, const std::optional<Prediction>& p, double sigma) {
    if (has_value(t.origin[i])) return;  // weak data (no logarithm), or filled before
    const bool clipped = t.origin[i] == CellOrigin::clipped;
    const double bound = clipped ? t.mean[i] : 0;
    if (p && sigma <= options.max_sigma && std::exp(p->log) >= bound) {
      set_cell(t, i, std::exp(p->log), sigma, CellOrigin::filled);
      ++report.n_filled;
      return;
    }
    const double f = options.model ? model_value(i) : 0;
    if (f > 0 && f >= bound) {
      set_cell(t, i, f, model_sigma, CellOrigin::modelled);
      ++report.n_modelled;
    } else {
      ++report.n_left;
    }
  };
  for (std::size_t k = 0; k < holes.size(); ++k) {
    const std::size_t i = TableGrid::index(TableGrid::Cell{holes[k].h, holes[k].d, holes[k].p});
    fill_cell(i, predictions[k], sigmas[k]);
    fill_cell(TableGrid::mirror(i), predictions[k], sigmas[k]);
  }
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i)
    if (t.origin[i] == CellOrigin::empty && t.origin[TableGrid::mirror(i)] == CellOrigin::measured) {
      copy_mirror(t, i, TableGrid::mirror(i));
      ++report.n_symmetric;
    }
  return report;
}

}  // namespace

void FillOptions::validate() const {
  if (!(min_cosine > 0 && min_cosine < 1)) throw Error(ErrorCode::usage, "min_cosine: expected a number in (0, 1)");
  if (!(max_sigma > 0 && std::isfinite(max_sigma))) throw Error(ErrorCode::usage, "max_sigma: expected a number above 0");
}

std::vector<FillReport> fill_holes(HalfAngleTable& table, const FillOptions& options, const Progress& progress) {
  options.validate();
  std::vector<FillReport> reports;
  for (std::size_t c = 0; c < table.channels.size(); ++c) {
    reports.push_back(fill_channel(table.channels[c], c, options));
    if (progress) progress("fill", c + 1, table.channels.size());
  }
  return reports;
}

}  // namespace lacquer::brdf
