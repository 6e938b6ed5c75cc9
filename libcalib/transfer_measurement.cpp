#include "libcalib/transfer_measurement.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "libbrdf/error.h"

namespace lacquer::calib {

using acquire::RawFrame;
using Use = TransferPoint::Use;

namespace {

/// A share of 1e-4 of the values beyond the clip level (3.7 sigma) takes 2e-4 off a variance.
constexpr double clipped_share = 1e-4;
constexpr double zero_share = 0.01;  ///< of a dark frame: then its mean and noise are those of a cut distribution
constexpr double largest_lamp_ratio = 2;

/// Frames of equal exposure time, in order of appearance.
std::vector<std::vector<std::size_t>> by_exposure(const FrameSeries& series) {
  std::map<double, std::vector<std::size_t>> groups;
  for (std::size_t i = 0; i < series.items.size(); ++i) groups[series.items[i].exposure_s].push_back(i);
  std::vector<std::vector<std::size_t>> result;
  for (auto& [time, group] : groups) result.push_back(std::move(group));
  return result;
}

bool has_pair(const std::vector<std::vector<std::size_t>>& groups) {
  return std::any_of(groups.begin(), groups.end(), [](const auto& g) { return g.size() >= 2; });
}

std::size_t count(const BadMask& mask) { return static_cast<std::size_t>(std::count(mask.begin(), mask.end(), 1)); }

/// Total temporal variance of dark values of channel `c` at time `t`: of the pairs at that time, else of all.
double dark_variance(const std::vector<PairRecord>& pairs, std::size_t c, double t) {
  double own = 0, n_own = 0, all = 0, n_all = 0;
  for (const PairRecord& p : pairs) {
    const double v = std::max(p.statistics[c].variance, p.statistics[c].quantisation);
    all += v, ++n_all;
    if (p.exposure_s == t) own += v, ++n_own;
  }
  return n_own > 0 ? own / n_own : all / n_all;
}

TransferPoint point_of(const PairStatistics& s, std::size_t channel, double exposure_s) {
  TransferPoint p;
  p.channel = static_cast<int>(channel);
  p.exposure_s = exposure_s;
  p.variance = s.variance - s.quantisation;
  p.quantisation = s.quantisation;
  p.n_values = s.n;
  return p;
}

}  // namespace

TransferMeasurement::TransferMeasurement(const FrameSeries& darks, const FrameSeries& flats, const PhotonTransferOptions& options,
                                         const Progress& progress)
    : darks_(darks), flats_(flats), options_(options), progress_(progress), dark_groups_(by_exposure(darks)), flat_groups_(by_exposure(flats)) {
  if (darks.items.empty() && flats.items.empty()) throw Error(ErrorCode::input, "noise: expected dark frames, flat frames or both, got none");
  if (!darks.items.empty() && !has_pair(dark_groups_))
    throw Error(ErrorCode::input, fmt::format("{}: expected at least two dark frames of one exposure time, their difference is the noise",
                                              darks.items.front().name));
  if (!flats.items.empty() && !has_pair(flat_groups_))
    throw Error(ErrorCode::input, fmt::format("{}: expected pairs of flats, two frames of one exposure time and lamp that follow each "
                                              "other; their difference is the noise", flats.items.front().name));
  if (darks.items.empty() && !options.black_level_dn && !(options.response && !options.response->linear))
    throw Error(ErrorCode::input, "noise: black level: without dark frames it must be given");
}

int TransferMeasurement::saturation() const {
  NoiseModel known;
  known.saturation_dn = options_.saturation_dn;
  return saturation_value(known, shape().bits);
}

template <typename OnFrame, typename OnPair>
void TransferMeasurement::for_each_frame(const FrameSeries& series, const Groups& groups, const char* stage, const OnFrame& on_frame,
                                         const OnPair& on_pair) {
  std::size_t done = 0;
  for (const auto& group : groups)
    for (std::size_t k = 0; k < group.size(); k += 2) {
      const RawFrame a = reader_.read(series, group[k]);
      if (linear_.exposure.empty()) linear_ = make_linearisation(options_.response, shape());
      on_frame(a);
      if (progress_) progress_(stage, ++done, series.items.size());
      if (k + 1 == group.size()) continue;
      const RawFrame b = reader_.read(series, group[k + 1]);
      on_frame(b);
      on_pair(a, b, series.items[group[k]].name);
      if (progress_) progress_(stage, ++done, series.items.size());
    }
}

void TransferMeasurement::run() {
  if (!darks_.items.empty()) {
    sum_darks();
    find_hot();
    measure_darks();
  }
  if (!flats_.items.empty()) measure_flats();
  fit();
  if (!flats_.items.empty()) sum_flats();
  const std::size_t known_bad = count(bad_);
  find_dead();
  find_erratic();
  if (count(bad_) == known_bad) return;
  if (has_darks()) measure_darks();
  if (!flats_.items.empty()) measure_flats();
  fit();
  if (in_sums_ != good_flats())
    sum_flats();  // without the bad values other levels are good
  else if (flat_)
    set_flat();
}

void TransferMeasurement::sum_darks() {
  std::vector<double> times;
  for (const auto& item : darks_.items) times.push_back(item.exposure_s);
  std::vector<ChannelMean> previous, last;
  for_each_frame(
      darks_, dark_groups_, "darks",
      [&](const RawFrame& frame) {
        if (!dark_sums_) {
          dark_sums_ = std::make_unique<DarkSums>(times, shape().n_values());
          bad_.assign(shape().n_values(), 0);
        }
        dark_sums_->add(frame, shape(), linear_);
        previous = std::move(last);
        last = channel_means(frame, shape(), linear_, {});
      },
      [&](const RawFrame& a, const RawFrame& b, const std::string&) {
        std::vector<double> shift;
        for (std::size_t c = 0; c < n_channels(); ++c) shift.push_back(previous[c].mean - last[c].mean);
        dark_sums_->add_pair(a, b, shape(), linear_, shift);
      });
}

void TransferMeasurement::find_hot() {
  const bool has_rate = dark_sums_->has_rate();
  const std::vector<double>& values = has_rate ? dark_sums_->rate() : dark_sums_->base();
  const RobustSpread spread = robust_spread(values, {});
  // Where hardly a value differs from its neighbours, rounding is what may differ.
  const DarkSums::Errors rounding = dark_sums_->errors(1.0 / 12, 0);
  const double sigma = std::max(spread.sigma, std::sqrt(has_rate ? rounding.rate : rounding.base));
  for (std::size_t i = 0; i < values.size(); ++i)
    if (std::abs(values[i] - spread.median) > options_.hot_sigmas * sigma) bad_[i] = 1;
  n_hot_ = count(bad_);
}

void TransferMeasurement::measure_darks() {
  std::vector<std::pair<double, std::vector<ChannelMean>>> frames;
  dark_pairs_.clear();
  for_each_frame(
      darks_, dark_groups_, "darks",
      [&](const RawFrame& frame) { frames.emplace_back(frame.actual.exposure_s, channel_means(frame, shape(), linear_, bad_)); },
      [&](const RawFrame& a, const RawFrame& b, const std::string& name) {
        dark_pairs_.push_back({a.actual.exposure_s, name, pair_statistics(a, b, shape(), linear_, {}, bad_, {false, saturation()}), {}});
      });
  for (const PairRecord& p : dark_pairs_)
    for (const PairStatistics& s : p.statistics) {
      if (s.n < 2) throw Error(ErrorCode::input, fmt::format("{}: nearly all values are hot; is this a dark frame?", p.name));
      if (s.clipped_share > 0.5) throw Error(ErrorCode::input, fmt::format("{}: is saturated; is this a dark frame?", p.name));
    }
  darks_clipped_ = std::any_of(frames.begin(), frames.end(), [](const auto& f) {
    return std::any_of(f.second.begin(), f.second.end(), [](const ChannelMean& m) { return m.zero_share > zero_share; });
  });
  set_dark_lines(frames);
  dark_points_.clear();
  for (const PairRecord& p : dark_pairs_)
    for (std::size_t c = 0; c < n_channels(); ++c) {
      TransferPoint point = point_of(p.statistics[c], c, p.exposure_s);
      point.dark = true;
      point.mean = p.statistics[c].mean - dark_lines_[c].base.value;
      if (darks_clipped_) point.use = Use::clipped;
      dark_points_.push_back(point);
    }
  set_dark_signal();
}

void TransferMeasurement::set_dark_lines(const std::vector<std::pair<double, std::vector<ChannelMean>>>& frames) {
  dark_lines_.clear();
  std::vector<DarkMean> all(frames.size());
  double n_all = 0;
  for (std::size_t c = 0; c < n_channels(); ++c) {
    std::vector<DarkMean> means;
    const double n = frames.front().second[c].n;
    n_all += n;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const auto& [t, channels] = frames[i];
      means.push_back({t, channels[c].mean, dark_variance(dark_pairs_, c, t) / n});
      all[i].exposure_s = t;
      all[i].mean += n * channels[c].mean;
      all[i].variance += n * n * means.back().variance;
    }
    dark_lines_.push_back(fit_dark_line(means));
  }
  for (DarkMean& m : all) m.mean /= n_all, m.variance /= n_all * n_all;
  dark_lines_.push_back(fit_dark_line(all));
}

DarkSums::Errors TransferMeasurement::dark_errors(std::size_t channel) const {
  // Noise of one value and frame as a line over time, from the pairs: variance = a + b t, least squares with equal weights.
  double n = 0, t = 0, tt = 0, v = 0, tv = 0;
  for (const PairRecord& p : dark_pairs_) {
    n += 1, t += p.exposure_s, tt += p.exposure_s * p.exposure_s;
    v += p.statistics[channel].variance, tv += p.exposure_s * p.statistics[channel].variance;
  }
  const double determinant = n * tt - t * t;
  const double slope = determinant > 1e-9 * n * tt ? (n * tv - t * v) / determinant : 0;
  return dark_sums_->errors(std::max(v / n - slope * t / n, 0.0), std::max(slope, 0.0));
}

std::vector<double> TransferMeasurement::noise_of_base() const {
  std::vector<double> noise;
  for (std::size_t c = 0; c < n_channels(); ++c) noise.push_back(dark_errors(c).base);
  return noise;
}

std::vector<double> TransferMeasurement::noise_of_rate() const {
  std::vector<double> noise;
  for (std::size_t c = 0; c < n_channels(); ++c) noise.push_back(dark_errors(c).rate);
  return noise;
}

void TransferMeasurement::set_dark_signal() {
  const std::vector<double> base_noise = noise_of_base(), rate_noise = noise_of_rate();
  base_spread_ = spread_beyond_noise(dark_sums_->base(), shape(), bad_, base_noise, 0);
  rate_spread_.assign(n_channels() + 1, {});
  if (dark_sums_->has_rate()) rate_spread_ = spread_beyond_noise(dark_sums_->rate(), shape(), bad_, rate_noise, 0);
  dark_ = {};
  for (std::size_t c = 0; c < n_channels(); ++c) {
    dark_.base[c] = darks_clipped_ ? options_.black_level_dn.value_or(0) : dark_lines_[c].base.value;
    dark_.rate[c] = darks_clipped_ || !dark_lines_[c].rate ? 0 : dark_lines_[c].rate->value;
  }
  if (darks_clipped_) return;
  // A map whose noise exceeds what it corrects is worse than none.
  const auto better = [](const Measured& spread, const std::vector<double>& noise) {
    return spread.value * spread.value > *std::max_element(noise.begin(), noise.end());
  };
  if (better(base_spread_.back(), base_noise)) dark_.base_map = &dark_sums_->base();
  if (dark_sums_->has_rate() && better(rate_spread_.back(), rate_noise)) dark_.rate_map = &dark_sums_->rate();
}

void TransferMeasurement::measure_flats() {
  flat_pairs_.clear();
  const bool curved = options_.response && !options_.response->linear;  // then exposure 0 is black
  for_each_frame(
      flats_, flat_groups_, "flats",
      [&](const RawFrame&) {
        if (bad_.empty()) bad_.assign(shape().n_values(), 0);
        if (!has_darks() && !curved) dark_.base.fill(*options_.black_level_dn);
      },
      [&](const RawFrame& a, const RawFrame& b, const std::string& name) {
        flat_pairs_.push_back({a.actual.exposure_s, name,
                               pair_statistics(a, b, shape(), linear_, dark_, bad_, {true, saturation()}),
                               std::vector<Use>(n_channels(), Use::fitted)});
      });
  for (const PairRecord& p : flat_pairs_)
    for (std::size_t c = 0; c < n_channels(); ++c) {
      const PairStatistics& s = p.statistics[c];
      if (s.n < 2) throw Error(ErrorCode::input, fmt::format("{}: nearly all values are bad, nothing is left to measure", p.name));
      if (s.ratio > largest_lamp_ratio || s.ratio < 1 / largest_lamp_ratio)
        throw Error(ErrorCode::input, fmt::format("{}: is {:.3g} times as bright as the next frame of its exposure time; the two flats of a "
                                                  "pair must follow each other in the list", p.name, s.ratio));
      if (!(s.mean > 0))
        throw Error(ErrorCode::input, fmt::format("{}: is no brighter than the dark level ({:.4g} DN above it); is this a flat, and the "
                                                  "black level right?", p.name, s.mean));
    }
}

void TransferMeasurement::fit() {
  points_.clear();
  lines_.clear();
  for (std::size_t c = 0; c < n_channels(); ++c) {
    std::vector<TransferPoint> own;
    for (const PairRecord& p : flat_pairs_) {
      own.push_back(point_of(p.statistics[c], c, p.exposure_s));
      own.back().light = p.statistics[c].mean;
      own.back().light_square = p.statistics[c].mean_square;
      own.back().mean = p.statistics[c].mean + dark_.rate[c] * p.exposure_s;
      own.back().use = p.statistics[c].clipped_share > clipped_share ? Use::clipped : Use::fitted;
    }
    for (const TransferPoint& p : dark_points_)
      if (p.channel == static_cast<int>(c)) own.push_back(p);
    choose_points(own);
    for (std::size_t i = 0; i < flat_pairs_.size(); ++i) flat_pairs_[i].use[c] = own[i].use;
    lines_.push_back(fit_transfer_line(own));
    points_.insert(points_.end(), own.begin(), own.end());
  }
  lines_.push_back(fit_transfer_line(points_));
  for (TransferPoint& p : points_) p.sigma = std::sqrt(variance_of_variance(lines_.back(), p));
}

std::vector<bool> TransferMeasurement::good_flats() const {
  std::vector<bool> good;
  for (const PairRecord& p : flat_pairs_)
    for (std::size_t c = 0; c < n_channels(); ++c) good.push_back(p.good(c));
  return good;
}

void TransferMeasurement::sum_flats() {
  flat_.reset();
  in_sums_ = good_flats();
  if (std::find(in_sums_.begin(), in_sums_.end(), true) == in_sums_.end()) return;
  flat_sums_ = std::make_unique<FlatSums>(shape().n_values());
  std::size_t next = 0;
  for_each_frame(
      flats_, flat_groups_, "flat field", [](const RawFrame&) {},
      [&](const RawFrame& a, const RawFrame& b, const std::string&) {
        const PairRecord& pair = flat_pairs_[next++];
        std::vector<bool> use;
        for (std::size_t c = 0; c < n_channels(); ++c) use.push_back(pair.good(c));
        flat_sums_->add_pair(a, b, shape(), linear_, dark_, use);
      });
  set_flat();
}

void TransferMeasurement::set_flat() {
  flat_ = flat_field(flat_sums_->signal(), shape(), bad_);
  flat_spread_ = spread_beyond_noise(flat_->relative, shape(), bad_, noise_of_flat(), flat_->n_terms);
}

}  // namespace lacquer::calib
