#include "libbrdf/fill_table.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <random>

#include "libbrdf/error.h"
#include "libbrdf/folded_channel.h"

namespace lacquer::brdf {

namespace {

using Place = FoldedChannel::Place;
constexpr int max_neighbours = 32;

/// Where the data around a hole lie, relative to it.
struct Pattern {
  int n = 0;
  std::array<Place, max_neighbours> offset;

  /// Cells to the nearest one.
  int nearest() const {
    int cells = 1000;
    for (int k = 0; k < n; ++k) {
      const Place& o = offset[static_cast<std::size_t>(k)];
      cells = std::min(cells, std::max({std::abs(o.h), std::abs(o.d), std::abs(o.p)}));
    }
    return cells;
  }
};

/// 0: data in the next cell but one, 1: up to five cells away, 2: a wide gap.
constexpr std::size_t n_gaps = 3;
std::size_t gap_class(int cells_to_nearest) { return cells_to_nearest <= 2 ? 0 : cells_to_nearest <= 5 ? 1 : 2; }

/// Covariance of the logarithm after the rows' means were taken off. The absolute size matters little, cross-validation sets the variance.
constexpr double amplitude = 0.15;                                   // of what the drifts do not explain
constexpr double mean_sigma = 3, slope_h = 0.3, slope_d = 0.1, slope_q = 1;  // prior sigmas of the drifts: constant, per cell, per deg, per unit
constexpr double length_h = 4, length_d = 8, length_p = 6;           // cells, degrees, degrees times sin(theta_h) sin(theta_d)
constexpr std::array<double, 4> length_scales{0.5, 1, 2, 4};
constexpr double nugget = 1e-4;                                      // of the logarithm: what no smooth function follows

struct Prediction {
  double log, variance;
  std::size_t gap;  // class
};

class Kriging {
 public:
  explicit Kriging(const TableChannel& channel) : data_(channel), cosines_(FoldedChannel::n_cells) {
    for (int h = 0; h < FoldedChannel::n_h; ++h)
      for (int d = 0; d < FoldedChannel::n_d; ++d)
        for (int p = 0; p < FoldedChannel::n_p; ++p) {
          const auto c = half_angle_cosines(TableGrid::centre(TableGrid::Cell{h, d, p}));
          cosines_[FoldedChannel::index({h, d, p})] = static_cast<float>(std::log(std::max(c.n_dot_i, 0.02)) + std::log(std::max(c.n_dot_o, 0.02)));
        }
  }

  const FoldedChannel& data() const { return data_; }
  double log_cosines(const Place& c) const { return cosines_[FoldedChannel::index(c)]; }
  bool known(const Place& c) const { return FoldedChannel::inside(c.h, c.d) && data_.known(FoldedChannel::index(c)); }

  /// The nearest known cells along 26 directions, along the axes the two nearest.
  Pattern pattern(const Place& hole) const {
    constexpr std::array<int, 4> reach{0, 40, 20, 12};  // by the number of axes that change
    Pattern found;
    for (int dh = -1; dh <= 1; ++dh)
      for (int dd = -1; dd <= 1; ++dd)
        for (int dp = -1; dp <= 1; ++dp) {
          const int axes = std::abs(dh) + std::abs(dd) + std::abs(dp);
          int wanted = axes == 1 ? 2 : 1;
          for (int k = 1; axes > 0 && wanted > 0 && k <= reach[static_cast<std::size_t>(axes)]; ++k) {
            const Place offset{k * dh, k * dd, k * dp};
            if (!FoldedChannel::inside(hole.h + offset.h, hole.d + offset.d)) break;
            if (!known({hole.h + offset.h, hole.d + offset.d, hole.p + offset.p})) continue;
            found.offset[static_cast<std::size_t>(found.n++)] = offset;
            --wanted;
          }
        }
    return found;
  }

  /// From those cells of the pattern that are known; nullopt with fewer than four of them.
  std::optional<Prediction> predict(const Place& at, const Pattern& pattern, double length_scale) const {
    std::array<Point, max_neighbours> points;
    int n = 0, nearest = 1000;
    const HalfDiff centre = TableGrid::centre(TableGrid::Cell{at.h, at.d, FoldedChannel::fold(at.p)});
    const double turn = std::max(0.05, std::sin(centre.theta_h) * std::sin(centre.theta_d));
    const double q = cosines_[FoldedChannel::index(at)];
    for (int k = 0; k < pattern.n; ++k) {
      const Place& o = pattern.offset[static_cast<std::size_t>(k)];
      const Place c{at.h + o.h, at.d + o.d, at.p + o.p};
      if (!known(c)) continue;
      const std::size_t i = FoldedChannel::index(c);
      nearest = std::min(nearest, std::max({std::abs(o.h), std::abs(o.d), std::abs(o.p)}));
      points[static_cast<std::size_t>(n++)] = {o.h / length_h, o.d / length_d, o.p * turn / length_p, slope_h * o.h, slope_d * o.d,
                                               slope_q * (cosines_[i] - q), data_.log(i), data_.variance(i)};
    }
    if (n < 4) return std::nullopt;
    Prediction result = krige(points.data(), n, 1 / length_scale, data_.row_mean(at.h));
    result.gap = gap_class(nearest);
    return result;
  }

 private:
  struct Point {
    double h, d, p, drift_h, drift_d, drift_q, value, variance;
  };

  /// Simple kriging at the origin; the drifts are part of the covariance.
  static Prediction krige(const Point* points, int n, double inverse_scale, double row_mean) {
    const auto matern = [&](double dh, double dd, double dp) {
      const double r = std::sqrt(5 * (dh * dh + dd * dd + dp * dp)) * inverse_scale;
      return amplitude * amplitude * (1 + r + r * r / 3) * std::exp(-r);
    };
    double l[max_neighbours][max_neighbours], y[max_neighbours], k[max_neighbours];
    for (int i = 0; i < n; ++i) {
      const Point& a = points[i];
      for (int j = 0; j <= i; ++j) {
        const Point& b = points[j];
        l[i][j] = matern(a.h - b.h, a.d - b.d, a.p - b.p) + mean_sigma * mean_sigma + a.drift_h * b.drift_h + a.drift_d * b.drift_d +
                  a.drift_q * b.drift_q;
      }
      l[i][i] += a.variance + nugget * nugget;
      y[i] = a.value;
      k[i] = matern(a.h, a.d, a.p) + mean_sigma * mean_sigma;
    }
    double mean = 0, variance = amplitude * amplitude + mean_sigma * mean_sigma;
    for (int i = 0; i < n; ++i) {  // Cholesky; y and k are solved along
      for (int j = 0; j < i; ++j) {
        double sum = l[i][j];
        for (int m = 0; m < j; ++m) sum -= l[i][m] * l[j][m];
        l[i][j] = sum / l[j][j];
      }
      double diagonal = l[i][i];
      for (int m = 0; m < i; ++m) diagonal -= l[i][m] * l[i][m], y[i] -= l[i][m] * y[m], k[i] -= l[i][m] * k[m];
      l[i][i] = std::sqrt(std::max(diagonal, nugget * nugget / 2));
      y[i] /= l[i][i];
      k[i] /= l[i][i];
      mean += y[i] * k[i];
      variance -= k[i] * k[i];
    }
    return {mean + row_mean, std::max(variance, nugget * nugget), 0};
  }

  FoldedChannel data_;
  std::vector<float> cosines_;  // ln(cos(theta_i) cos(theta_o)) at the cells' centres
};

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
  std::array<double, n_classes> factor;
  Calibration() { factor.fill(1); }
  std::size_t class_of(std::size_t gap, int theta_h, double log_cosines) const {
    const auto grazing = static_cast<std::size_t>(std::upper_bound(limits.begin(), limits.end(), log_cosines) - limits.begin());
    return (gap * n_grazing + grazing) * n_rows + static_cast<std::size_t>(theta_h) * n_rows / FoldedChannel::n_h;
  }
};

struct Trial {
  double own_sigma, error;
  std::size_t gap;
  int theta_h;
  double log_cosines;
  int phi_d;       ///< of the known cell, folded
  double stretch;  ///< distance of its data, relative to those of the hole that it stands for
};

double percentile_95(std::vector<double>& values) {
  const auto place = values.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(values.size()));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

/// The pattern around a hole, laid around a known cell: where the cell that it asks for is not known, the next one along the same line stands in.
/// `scale`: the whole pattern this many times as far apart.
Pattern laid_around(const Kriging& kriging, const Place& donor, const Pattern& pattern, int scale, bool inwards_first) {
  Pattern laid;
  for (int k = 0; k < pattern.n; ++k) {
    const Place& o = pattern.offset[static_cast<std::size_t>(k)];
    const int steps = std::max({std::abs(o.h), std::abs(o.d), std::abs(o.p)});
    const Place unit{o.h / steps, o.d / steps, o.p / steps};
    for (int change = 0; change < 6; ++change) {  // 0, +1, -1, +2, -2, +3, or the other way round
      const int size = (change + 1) / 2, j = scale * steps + ((change % 2 == 1) != inwards_first ? size : -size);
      const Place offset{j * unit.h, j * unit.d, j * unit.p};
      if (j < 1 || !kriging.known({donor.h + offset.h, donor.d + offset.d, donor.p + offset.p})) continue;
      const auto used = [&](const Place& other) { return other.h == offset.h && other.d == offset.d && other.p == offset.p; };
      if (std::any_of(laid.offset.begin(), laid.offset.begin() + laid.n, used)) continue;
      laid.offset[static_cast<std::size_t>(laid.n++)] = offset;
      break;
    }
  }
  return laid;
}

std::vector<Trial> trials_of(const Kriging& kriging, const std::vector<Place>& holes, std::size_t n_trials, double length_scale, int scale) {
  std::mt19937_64 generator(20050901);
  const auto below = [&](int n) { return static_cast<int>(generator() % static_cast<unsigned>(n)); };
  struct Experiment {
    Place donor;
    Pattern pattern;
    double stretch;
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
    for (int attempt = 0; attempt < 48 && pattern.n >= 4; ++attempt) {
      const int wide = attempt / 16;  // the donor of the truth: along phi_d first, where the paint changes least
      const int p = hole.p + below(91) - 45;
      const Place donor{hole.h + below(4 * wide + 1) - 2 * wide, hole.d + below(6 * wide + 3) - 3 * wide - 1, p};
      if (!kriging.known(donor)) continue;
      const Pattern laid = laid_around(kriging, donor, pattern, scale, below(4) == 0);
      if (laid.n * 10 < pattern.n * 8) continue;
      experiments.push_back({donor, laid, static_cast<double>(laid.nearest()) / pattern.nearest()});
      break;
    }
  }
  std::vector<Trial> trials(experiments.size());
  tbb::parallel_for(std::size_t{0}, experiments.size(), [&](std::size_t k) {
    const auto& [donor, pattern, stretch] = experiments[k];
    const std::size_t i = FoldedChannel::index(donor);
    const auto p = kriging.predict(donor, pattern, length_scale);
    if (p)
      trials[k] = {std::sqrt(p->variance + kriging.data().variance(i)), std::abs(p->log - kriging.data().log(i) - kriging.data().row_mean(donor.h)),
                   gap_class(static_cast<int>(std::lround(pattern.nearest() / stretch))), donor.h, kriging.log_cosines(donor), FoldedChannel::fold(donor.p), stretch};
  });
  std::erase_if(trials, [](const Trial& t) { return t.own_sigma == 0; });
  return trials;
}

/// By which the own sigmas of each class must grow for 95 % of its errors to lie within 1.96 of them; classes with few trials take the gap's, or all.
std::array<double, Calibration::n_classes> factors_of(const std::vector<Trial>& trials, const Calibration& classes, std::size_t enough) {
  std::vector<double> all;
  std::array<std::vector<double>, n_gaps> by_gap;
  std::array<std::vector<double>, Calibration::n_classes> ratios;
  // How a factor changes from place to place is not known within a gap: the largest of three parts of phi_d counts.
  constexpr std::size_t n_parts = 3;
  std::array<std::array<std::vector<double>, n_parts>, Calibration::n_classes> parts;
  for (const Trial& t : trials) {
    const double ratio = t.error / (1.96 * t.own_sigma);
    const std::size_t c = classes.class_of(t.gap, t.theta_h, t.log_cosines);
    all.push_back(ratio);
    by_gap[t.gap].push_back(ratio);
    ratios[c].push_back(ratio);
    parts[c][static_cast<std::size_t>(t.phi_d) * n_parts / FoldedChannel::n_p].push_back(ratio);
  }
  const double overall = percentile_95(all);
  std::array<double, Calibration::n_classes> factors;
  for (std::size_t c = 0; c < Calibration::n_classes; ++c) {
    auto& gap = by_gap[c / (Calibration::n_classes / n_gaps)];
    factors[c] = std::max(1e-3, ratios[c].size() >= enough ? percentile_95(ratios[c]) : gap.size() >= enough ? percentile_95(gap) : overall);
    for (auto& part : parts[c])
      if (part.size() >= enough / 2) factors[c] = std::max(factors[c], percentile_95(part));
  }
  return factors;
}

Calibration calibrate(const Kriging& kriging, const std::vector<Place>& holes, std::size_t n_trials) {
  Calibration best;
  std::vector<Trial> trials;
  for (const double scale : length_scales) {
    std::vector<Trial> now = trials_of(kriging, holes, n_trials, scale, 1);
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
  std::vector<double> cosines, stretches;
  for (const Trial& t : trials) cosines.push_back(t.log_cosines), stretches.push_back(t.stretch);
  std::sort(cosines.begin(), cosines.end());
  for (std::size_t c = 1; c < Calibration::n_grazing; ++c) best.limits[c - 1] = cosines[c * cosines.size() / Calibration::n_grazing];
  const auto factors = factors_of(trials, best, enough);
  best.factor = factors;
  std::nth_element(stretches.begin(), stretches.begin() + static_cast<std::ptrdiff_t>(stretches.size() / 2), stretches.end());
  if (stretches[stretches.size() / 2] > 1.5) {
    // Where every other row is missing, no known cell has its data as near as the holes have. What doubling the distance does to the factor,
    // halving it undoes in part: half of it where the factor grows, a quarter where it falls, because too narrow bounds do more harm.
    const std::vector<Trial> wider = trials_of(kriging, holes, n_trials, best.length_scale, 4);
    if (wider.size() >= enough) {
      const auto wide = factors_of(wider, best, enough);
      for (std::size_t c = 0; c < Calibration::n_classes; ++c) best.factor[c] = factors[c] * std::pow(factors[c] / wide[c], factors[c] < wide[c] ? 0.25 : 0.5);
    }
  }
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
  tbb::parallel_for(std::size_t{0}, holes.size(),
                    [&](std::size_t k) { predictions[k] = kriging.predict(holes[k], kriging.pattern(holes[k]), calibration.length_scale); });
  const auto fill_cell = [&](std::size_t i, const Place& place, const std::optional<Prediction>& p) {
    if (has_value(t.origin[i])) return;  // weak data (no logarithm), or filled before
    const bool clipped = t.origin[i] == CellOrigin::clipped;
    const double bound = clipped ? t.mean[i] : 0, factor = calibration.factor[calibration.class_of(p ? p->gap : 0, place.h, kriging.log_cosines(place))];
    const double sigma = p ? factor * std::sqrt(p->variance) : 0;
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
    fill_cell(i, holes[k], predictions[k]);
    fill_cell(TableGrid::mirror(i), holes[k], predictions[k]);
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
