#include "libcalib/response_channel.h"

#include <algorithm>
#include <cmath>
#include <tbb/parallel_for.h>

namespace lacquer::calib {

namespace {

/// Residuals beyond this many sigmas count as contradictions (moved edge, dust, border of a registered photograph). Those within keep
/// their whole weight: photons are skewed, and lighter tails would shift the mean.
constexpr double contradiction_sigmas = 4;
/// Values are used from this predicted signal to noise ratio on, up to this many sigmas below saturation, and from this many
/// quantisation steps above black on. Each is where the loss of the values beyond the limit begins to shift the mean.
constexpr double min_signal_to_noise = 1.2, saturation_sigmas = 3, min_steps = 3;
/// So many pixels per channel, spread over the brightness, tell the matrices well enough for a step and for a covariance.
constexpr std::size_t step_pixels = 1500, covariance_pixels = 5000;
/// Pixels are summed in parts of at least so many, the same whatever the number of threads.
constexpr std::size_t part_pixels = 500, max_parts = 16;
/// Smallest d ln exposure / d ln(v - black): the curve can be inverted, and a dip of noise leaves no plateau. Real curves have 0.5 and more.
constexpr double min_exponent = 0.1;

/// 0 up to `limit`, 1 from 1.5 limits on: hard limits would let values jump in and out for ever as the curve settles.
double ramp(double x, double limit) { return std::clamp(2 * (x / limit - 1), 0.0, 1.0); }

/// Pool adjacent violators: the non-decreasing sequence closest to `y`.
void make_non_decreasing(std::vector<double>& y) {
  struct Block {
    double sum;
    std::size_t n;
    double mean() const { return sum / static_cast<double>(n); }
  };
  std::vector<Block> blocks;
  for (const double value : y) {
    blocks.push_back({value, 1});
    while (blocks.size() > 1 && blocks[blocks.size() - 2].mean() >= blocks.back().mean()) {
      blocks[blocks.size() - 2].sum += blocks.back().sum;
      blocks[blocks.size() - 2].n += blocks.back().n;
      blocks.pop_back();
    }
  }
  std::size_t i = 0;
  for (const Block& block : blocks)
    for (std::size_t k = 0; k < block.n; ++k) y[i++] = block.mean();
}

}  // namespace

/// One value: the change of ln f at `basis` less that of e at `frame` should be `target` plus a constant of the pixel.
struct ResponseChannel::Row {
  ResponseSpline::Basis basis;
  std::size_t frame;
  double weight;
  double target;
};

/// What depends on the predicted exposure alone, on a grid even in its logarithm, linear in between.
struct ResponseChannel::Lookup {
  struct Node {
    double place;   ///< coordinate of the spline
    double weight;  ///< 1 / variance of ln z, 0 where values are of no use
  };
  double low = 0, per_log = 0;
  std::vector<Node> nodes;
  bool noise_known = false;           ///< else residuals are those of a curve that is still wrong
  std::vector<double> mean_exposure;  ///< of a value: mean of f over its level

  Node at(double log_z) const {
    const double position = (log_z - low) * per_log;
    if (!(position >= 0)) return {nodes.front().place, 0};
    if (position >= static_cast<double>(nodes.size() - 1)) return {nodes.back().place, 0};
    const auto i = static_cast<std::size_t>(position);
    const double upper = position - static_cast<double>(i);
    return {nodes[i].place + upper * (nodes[i + 1].place - nodes[i].place), nodes[i].weight + upper * (nodes[i + 1].weight - nodes[i].weight)};
  }
};

ResponseChannel::ResponseChannel(int bits, double black_level, int saturation, const SampledPixels& pixels, const std::vector<double>& times)
    : bits_(bits),
      black_(black_level),
      mid_(std::log(std::exp2(bits - 1) - black_level)),
      saturation_(saturation),
      first_(static_cast<std::size_t>(std::floor(black_level)) + 1),
      pixels_(pixels),
      times_(times),
      spline_(bits, black_level),
      coefficients_(spline_.n_coefficients()),
      place_of_value_(std::size_t{1} << bits),
      log_signal_(place_of_value_.size()) {
  for (std::size_t v = first_; v < place_of_value_.size(); ++v) {
    log_signal_[v] = std::log(static_cast<double>(v) - black_);
    place_of_value_[v] = spline_.coordinate(log_signal_[v]);
  }
  start_from_line();
}

void ResponseChannel::start_from_line() {
  gamma_ = 1;
  std::fill(coefficients_.begin(), coefficients_.end(), 0.0);
  update_exposure();
}

void ResponseChannel::set_curve(const std::vector<double>& exposure) { exposure_ = exposure; }

void ResponseChannel::start_from_power_law() {
  // gamma * s = log t + log x_i, s = log(v - black): regression within each pixel. All values well within the range count alike: a
  // shoulder must not rule the start.
  const double lowest = 8 * std::exp2(bits_ - 8);
  double covariance = 0, variance = 0;
  for (std::size_t i = 0; i < pixels_.n_pixels(); ++i) {
    double w = 0, ws = 0, wt = 0, wss = 0, wst = 0;
    for (std::size_t o = pixels_.first[i]; o < pixels_.first[i + 1]; ++o) {
      const Observation obs = pixels_.observations[o];
      if (obs.value - black_ < lowest || obs.value > 0.9 * saturation_) continue;
      const double s = log_signal_[obs.value], t = std::log(times_[obs.time]);
      w += 1;
      ws += s;
      wt += t;
      wss += s * s;
      wst += s * t;
    }
    if (w <= 0) continue;
    covariance += wst - ws * wt / w;
    variance += wss - ws * ws / w;
  }
  // Cameras and films have exponents of 1 to 3; anything far beyond is a bracket that says nothing.
  gamma_ = variance > 0 ? std::clamp(covariance / variance, 0.2, 5.0) : 1.0;
  std::fill(coefficients_.begin(), coefficients_.end(), 0.0);
  update_exposure();
}

void ResponseChannel::change_spline(const double* change) {
  for (std::size_t k = 0; k < coefficients_.size(); ++k) coefficients_[k] += change[k];
  const ResponseSpline::Basis b = spline_.basis(spline_.coordinate(mid_));
  double constant = 0;
  for (std::size_t p = 0; p < 4; ++p) constant += b.weight[p] * coefficients_[b.first + p];
  for (double& c : coefficients_) c -= constant;
  update_exposure();
}

void ResponseChannel::divide_exponent(double factor) {
  gamma_ /= factor;
  for (double& c : coefficients_) c /= factor;
  update_exposure();
}

void ResponseChannel::update_exposure() {
  std::vector<double> g(place_of_value_.size() - first_);
  for (std::size_t k = 0; k < g.size(); ++k) {
    const ResponseSpline::Basis b = spline_.basis(place_of_value_[first_ + k]);
    g[k] = mid_ + gamma_ * (log_signal_[first_ + k] - mid_) - min_exponent * log_signal_[first_ + k];
    for (std::size_t p = 0; p < 4; ++p) g[k] += b.weight[p] * coefficients_[b.first + p];
  }
  make_non_decreasing(g);
  for (std::size_t k = 0; k < g.size(); ++k) g[k] += min_exponent * log_signal_[first_ + k];
  const double shift = mid_ - g[(std::size_t{1} << (bits_ - 1)) - first_];
  exposure_.assign(place_of_value_.size(), 0.0);
  for (std::size_t k = 0; k < g.size(); ++k) exposure_[first_ + k] = std::exp(g[k] + shift);
  // Below: the straight line through (black, 0), so that noise around black keeps its sign.
  const double slope = exposure_[first_] / (static_cast<double>(first_) - black_);
  for (std::size_t v = 0; v < first_; ++v) exposure_[v] = (static_cast<double>(v) - black_) * slope;
}

ResponseChannel::Lookup ResponseChannel::make_lookup(const NoiseModel* noise) const {
  constexpr std::size_t n_nodes = 4096;
  const std::size_t top = exposure_.size() - 1;
  Lookup lookup;
  lookup.noise_known = noise != nullptr;
  lookup.mean_exposure = exposure_;
  for (std::size_t v = first_ + 1; v < top; ++v)
    lookup.mean_exposure[v] += (exposure_[v + 1] - 2 * exposure_[v] + exposure_[v - 1]) / 24;
  std::size_t lowest = first_;
  while (lowest + 1 < top && !(exposure_[lowest] > 0)) ++lowest;  // a curve from elsewhere may have its zero higher up
  lookup.low = std::log(exposure_[lowest]);
  const double high = std::log(exposure_[top]);
  lookup.per_log = static_cast<double>(n_nodes - 1) / (high - lookup.low);
  std::size_t v = lowest;
  for (std::size_t i = 0; i < n_nodes; ++i) {
    const double z = std::exp(lookup.low + static_cast<double>(i) / lookup.per_log);
    while (v + 2 <= top && exposure_[v + 1] < z) ++v;
    const double slope = exposure_[v + 1] - exposure_[v], upper = std::clamp((z - exposure_[v]) / slope, 0.0, 1.0);
    double variance = slope * slope * std::exp2(2 * (bits_ - 8));
    if (noise) {
      const double read = noise->read_noise_e / noise->gain_e_per_dn, relative = noise->relative_noise * z;
      variance = read * read + z / noise->gain_e_per_dn + relative * relative + slope * slope / 12;
    }
    const double sigma = std::sqrt(variance);
    const double steps = static_cast<double>(v) + upper - black_;
    const double use = ramp(z / sigma, min_signal_to_noise) * ramp(std::min(z / slope, steps), min_steps) *
                       ramp((saturation_ - static_cast<double>(v) - upper) * slope / sigma, saturation_sigmas);
    lookup.nodes.push_back({(1 - upper) * place_of_value_[v] + upper * place_of_value_[v + 1], use * z * z / variance});
  }
  return lookup;
}

void ResponseChannel::collect_rows(std::size_t pixel, const Lookup& lookup, const std::vector<double>& times, std::vector<Row>& rows) const {
  rows.clear();
  const std::size_t begin = pixels_.first[pixel], end = pixels_.first[pixel + 1];
  double sum_e = 0, sum_t = 0;
  for (std::size_t o = begin; o < end; ++o) {
    sum_e += lookup.mean_exposure[pixels_.observations[o].value];
    sum_t += times[pixels_.observations[o].time];
  }
  if (!(sum_e > 0)) return;
  const double x0 = sum_e / sum_t;
  double weighted = 0, precision = 0;
  for (std::size_t o = begin; o < end; ++o) {
    const Observation obs = pixels_.observations[o];
    const double t = times[obs.time], weight = lookup.at(std::log(x0 * t)).weight;
    if (weight <= 0) continue;
    const double x = lookup.mean_exposure[obs.value] / t;
    weighted += weight * x;
    precision += weight;
    rows.push_back({{}, obs.time, weight, x});
  }
  if (rows.size() < 2 || !(weighted > 0)) {
    rows.clear();
    return;
  }
  const double x = weighted / precision;
  for (Row& r : rows) {
    // Bounded, so that the first rounds, far from the solution, do not overshoot.
    const double residual = std::clamp(r.target / x - 1, -0.9, 2.0);
    r.basis = spline_.basis(lookup.at(std::log(x * times[r.frame])).place);
    r.target = -residual;
    if (lookup.noise_known) r.weight /= std::max(1.0, residual * residual * r.weight / (contradiction_sigmas * contradiction_sigmas));
  }
}

/// Sums of one part of the pixels. The matrices, which cost most and need no more than some per cent of accuracy (the solution is where
/// b and the prior balance), come from every matrix_step-th pixel and are scaled up. `mean` and `gradient` are those of one pixel's rows,
/// weighted, 0 outside `runs`.
struct ResponseChannel::Accumulator {
  Accumulator(std::size_t n_coefficients, std::size_t n_times, double matrix_scale, bool scatter)
      : n_coefficients(n_coefficients), matrix_scale(matrix_scale), mean(n_coefficients + n_times), gradient(mean.size()) {
    sum.a = SymmetricMatrix(mean.size());
    sum.b.resize(mean.size());
    if (scatter) sum.scatter = SymmetricMatrix(mean.size());
  }

  void add_pixel(std::vector<Row>& rows, bool matrices) {
    std::sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) { return a.basis.first < b.basis.first; });
    runs.clear();
    double sum_w = 0, sum_wt = 0;
    std::size_t first_frame = mean.size(), last_frame = 0;
    for (const Row& r : rows) {
      add_row(r, matrices);
      sum_w += r.weight;
      sum_wt += r.weight * r.target;
      first_frame = std::min(first_frame, r.frame);
      last_frame = std::max(last_frame, r.frame);
      if (runs.empty() || runs.back().end < r.basis.first)
        runs.push_back({r.basis.first, r.basis.first + 4});
      else
        runs.back().end = r.basis.first + 4;
    }
    runs.push_back({n_coefficients + first_frame, n_coefficients + last_frame + 1});
    sum.weights += sum_w;
    for (const Run& run : runs)
      for (std::size_t k = run.begin; k < run.end; ++k) {
        gradient[k] -= mean[k] * sum_wt / sum_w;
        sum.b[k] += gradient[k];
      }
    if (matrices) subtract_outer_product(sum.a, mean, matrix_scale / sum_w);
    if (matrices && sum.scatter.size() > 0) subtract_outer_product(sum.scatter, gradient, -matrix_scale);
    for (const Run& run : runs)
      for (std::size_t k = run.begin; k < run.end; ++k) mean[k] = gradient[k] = 0;
  }

  struct Run {
    std::size_t begin, end;
  };
  std::size_t n_coefficients;
  double matrix_scale;
  std::vector<double> mean, gradient;
  std::vector<Run> runs;
  Equations sum;

 private:
  void add_row(const Row& r, bool matrices) {
    const std::size_t frame = n_coefficients + r.frame, first = r.basis.first;
    for (std::size_t p = 0; p < 4; ++p) {
      const double weight = r.weight * r.basis.weight[p];
      mean[first + p] += weight;
      gradient[first + p] += weight * r.target;
    }
    mean[frame] -= r.weight;
    gradient[frame] -= r.weight * r.target;
    sum.squares += r.weight * r.target * r.target;
    if (!matrices) return;
    double* const frame_row = sum.a.row(frame);
    for (std::size_t p = 0; p < 4; ++p) {
      const double weight = matrix_scale * r.weight * r.basis.weight[p];
      frame_row[first + p] -= weight;
      for (std::size_t q = 0; q <= p; ++q) sum.a.at(first + p, first + q) += weight * r.basis.weight[q];
    }
    frame_row[frame] += matrix_scale * r.weight;
  }

  void subtract_outer_product(SymmetricMatrix& a, const std::vector<double>& x, double factor) const {
    for (std::size_t r = 0; r < runs.size(); ++r)
      for (std::size_t i = runs[r].begin; i < runs[r].end; ++i) {
        const double scaled = factor * x[i];
        double* const row = a.row(i);
        for (std::size_t s = 0; s <= r; ++s)  // within the own run also beyond the diagonal, which nobody reads
          for (std::size_t k = runs[s].begin; k < runs[s].end; ++k) row[k] -= scaled * x[k];
      }
  }
};

ResponseChannel::Equations ResponseChannel::equations(const NoiseModel* noise, const std::vector<double>& log_time_corrections,
                                                      std::size_t pixel_step, bool scatter) const {
  const Lookup lookup = make_lookup(noise);
  std::vector<double> times(times_);
  for (std::size_t j = 0; j < times.size(); ++j) times[j] *= std::exp(log_time_corrections[j]);
  const std::size_t n_used = (pixels_.n_pixels() + pixel_step - 1) / pixel_step, matrix_step = n_used / (scatter ? covariance_pixels : step_pixels) + 1;
  const double matrix_scale = static_cast<double>(n_used) / static_cast<double>((n_used + matrix_step - 1) / matrix_step);
  const std::size_t n_parts = std::clamp<std::size_t>(n_used / part_pixels, 1, max_parts);
  std::vector<Equations> parts(n_parts);
  tbb::parallel_for(std::size_t{0}, n_parts, [&](std::size_t part) {
    Accumulator accumulator(coefficients_.size(), times.size(), matrix_scale, scatter);
    std::vector<Row> rows;
    for (std::size_t i = n_used * part / n_parts; i < n_used * (part + 1) / n_parts; ++i) {
      collect_rows(i * pixel_step, lookup, times, rows);
      if (!rows.empty()) accumulator.add_pixel(rows, i % matrix_step == 0);
    }
    parts[part] = std::move(accumulator.sum);
  });
  Equations& sum = parts[0];
  for (std::size_t part = 1; part < n_parts; ++part) {
    sum.a.add(parts[part].a);
    if (scatter) sum.scatter.add(parts[part].scatter);
    for (std::size_t k = 0; k < sum.b.size(); ++k) sum.b[k] += parts[part].b[k];
    sum.squares += parts[part].squares;
    sum.weights += parts[part].weights;
  }
  return std::move(sum);
}

}  // namespace lacquer::calib
