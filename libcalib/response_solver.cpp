#include "libcalib/response_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lacquer::calib {

namespace {

/// A place where the bend h'' = d^2 ln f / d s^2 of the curve is penalised.
struct Bend {
  ResponseSpline::Basis basis;  ///< of h''
  double s, span;               ///< s = ln(v - black) there and the length of s that it stands for
};

std::vector<Bend> bends(const ResponseSpline& spline) {
  constexpr double step = 0.5;
  std::vector<Bend> result;
  const double end = spline.coordinate(spline.highest());
  for (double c = step / 2; c < end; c += step)
    result.push_back({spline.second_derivative(c), spline.log_signal(c), spline.log_signal(c + step / 2) - spline.log_signal(c - step / 2)});
  return result;
}

double dot(const ResponseSpline::Basis& basis, const std::vector<double>& coefficients) {
  double sum = 0;
  for (std::size_t p = 0; p < 4; ++p) sum += basis.weight[p] * coefficients[basis.first + p];
  return sum;
}

/// Adds strength * (basis . (coefficients + change) + constant)^2 / 2 to the normal equations of the change.
void penalise(const ResponseSpline::Basis& basis, double value, double strength, std::size_t offset, SymmetricMatrix& a, std::vector<double>& b) {
  for (std::size_t p = 0; p < 4; ++p) {
    const double weight = strength * basis.weight[p];
    b[offset + basis.first + p] -= weight * value;
    for (std::size_t q = 0; q <= p; ++q) a.at(offset + basis.first + p, offset + basis.first + q) += weight * basis.weight[q];
  }
}

constexpr double smallest_spread = 1e-4, largest_spread = 0.1;

/// The lower one of two.
double median(std::vector<double> x) {
  const auto middle = x.begin() + static_cast<std::ptrdiff_t>((x.size() - 1) / 2);
  std::nth_element(x.begin(), middle, x.end());
  return *middle;
}

}  // namespace

ResponseSolver::ResponseSolver(int bits, double black_level, int saturation, const BracketSamples& samples)
    : bits_(bits), corrections_(samples.times.size()), time_information_(samples.times.size()) {
  for (const SampledPixels& pixels : samples.channels) channels_.emplace_back(bits, black_level, saturation, pixels, samples.times);
  first_time_ = first_coefficient(channels_.size());
  for (const double t : samples.times) log_times_.push_back(std::log(t));
}

void ResponseSolver::start_from_power_law() {
  for (ResponseChannel& c : channels_) c.start_from_power_law();
}

void ResponseSolver::start_from_line() {
  for (ResponseChannel& c : channels_) c.start_from_line();
}

void ResponseSolver::set_curves(const Response& response) {
  for (std::size_t c = 0; c < channels_.size(); ++c) channels_[c].set_curve(response.curves[c].exposure);
}

ResponseSolver::Equations ResponseSolver::equations(const Round& round, bool scatter) {
  const std::size_t n = first_time_ + corrections_.size();
  Equations joint{SymmetricMatrix(n), SymmetricMatrix(scatter ? n : 0), std::vector<double>(n)};
  double squares = 0, weights = 0;
  for (std::size_t c = 0; c < channels_.size(); ++c) {
    const auto part = channels_[c].equations(round.noise, corrections_, round.pixel_step, scatter);
    const std::size_t own = channels_[c].coefficients().size();
    const auto index = [&](std::size_t k) { return k < own ? first_coefficient(c) + k : first_time_ + k - own; };
    for (std::size_t i = 0; i < part.b.size(); ++i) {
      joint.b[index(i)] += part.b[i];
      for (std::size_t j = 0; j <= i; ++j) {
        joint.a.at(index(i), index(j)) += part.a(i, j);
        if (scatter) joint.scatter.at(index(i), index(j)) += part.scatter(i, j);
      }
    }
    squares += part.squares;
    weights += part.weights;
  }
  residual_rms_ = weights > 0 ? std::sqrt(squares / weights) : 0;
  for (std::size_t j = 0; j < corrections_.size(); ++j) time_information_[j] = joint.a(first_time_ + j, first_time_ + j);
  return joint;
}

/// So that the solution is the smoothest curve that the data allow: the integral of h''^2 / (c (c + |m|)) over s = ln(v - black), c =
/// slope_change, m the mean of h'' within a window around. A quadratic penalty would pay for a bend (the shoulder of a film) with ripples
/// elsewhere; this one is linear in a bend and still quadratic in ripples, which have no mean bend. Far weaker than any data: |h| < 10, for a bracket that says nothing.
void ResponseSolver::add_curve_prior(std::size_t channel, double slope_change, SymmetricMatrix& a, std::vector<double>& b) const {
  constexpr double window = 0.25, ridge = 0.01;
  const ResponseChannel& curve = channels_[channel];
  const ResponseSpline& spline = curve.spline();
  const std::vector<double>& coefficients = curve.coefficients();
  const std::size_t offset = first_coefficient(channel);
  const std::vector<Bend> places = bends(spline);
  std::vector<double> values, sums{0}, spans{0};
  for (const Bend& place : places) {
    values.push_back(dot(place.basis, coefficients));
    sums.push_back(sums.back() + values.back() * place.span);
    spans.push_back(spans.back() + place.span);
  }
  for (std::size_t k = 0, low = 0, high = 0; k < places.size(); ++k) {
    while (places[low].s < places[k].s - window) ++low;
    while (high < places.size() && places[high].s < places[k].s + window) ++high;
    const double mean_bend = (sums[high] - sums[low]) / (spans[high] - spans[low]);
    penalise(places[k].basis, values[k], places[k].span / (slope_change * (slope_change + std::abs(mean_bend))), offset, a, b);
  }
  const double n = static_cast<double>(coefficients.size());
  double largest = 0;
  for (std::size_t k = 0; k < coefficients.size(); ++k) largest = std::max(largest, a(offset + k, offset + k));
  for (const Bend& place : places) {
    const ResponseSpline::Basis value = spline.basis(spline.coordinate(place.s));
    penalise(value, dot(value, coefficients) + (curve.gamma() - 1) * (place.s - curve.mid_log_signal()), ridge / n, offset, a, b);
  }
  // The gauge: mid-range stays.
  penalise(spline.basis(spline.coordinate(curve.mid_log_signal())), 0, 1e-3 * largest, offset, a, b);
}

double ResponseSolver::time_precision(std::size_t j, double time_sigma) const {
  constexpr double heavy_tail = 3;  // sigmas
  const double variance = std::max(time_sigma * time_sigma, 1e-18);
  // Tails are for single frames: an exponent of all times is no excuse, or a line and wrong times would explain every power law.
  const double distance = corrections_[j] - exponent_ * (log_times_[j] - median(log_times_));
  return 1 / (variance + distance * distance / (heavy_tail * heavy_tail));
}

/// Beside the prior of each e_j the exponent is held: a round does not change sum of w_j (ln t_j - mean) e_j, w_j the prior's precision, small
/// for times that are false. An exponent of all times is one of the curve, the pixels do not see it; see
/// take_exponent_to_curves.
void ResponseSolver::add_time_prior(double time_sigma, SymmetricMatrix& a, std::vector<double>& b) const {
  constexpr double firmness = 1e12;
  const std::size_t n = corrections_.size();
  double sum_w = 0, sum_wt = 0;
  for (std::size_t j = 0; j < n; ++j) {
    const double precision = time_precision(j, time_sigma);
    b[first_time_ + j] -= precision * corrections_[j];
    a.at(first_time_ + j, first_time_ + j) += precision;
    sum_w += precision;
    sum_wt += precision * log_times_[j];
  }
  std::vector<double> exponent(n);
  double norm = 0;
  for (std::size_t j = 0; j < n; ++j) {
    const double distance = log_times_[j] - sum_wt / sum_w, precision = time_precision(j, time_sigma);
    exponent[j] = precision * distance;
    norm += precision * distance * distance;
  }
  if (!(norm > 0)) return;
  for (std::size_t j = 0; j < n; ++j)
    for (std::size_t k = 0; k <= j; ++k) a.at(first_time_ + j, first_time_ + k) += firmness * exponent[j] * exponent[k] / (norm * norm);
}

/// Median slope of e_j over ln t_j between pairs of frames (Theil and Sen): false times do not tilt it. With less than four frames 0: nothing
/// tells a false time from an exponent then.
double ResponseSolver::exponent_of_times() const {
  std::vector<double> slopes;
  for (std::size_t j = 0; j < corrections_.size(); ++j)
    for (std::size_t k = 0; k < j; ++k)
      if (is_seen(j) && is_seen(k) && log_times_[j] > log_times_[k])
        slopes.push_back((corrections_[j] - corrections_[k]) / (log_times_[j] - log_times_[k]));
  return slopes.size() < 6 ? 0.0 : std::clamp(median(slopes), -0.5, 0.5);
}

/// Gauge: the exponent of the times is 0. With e_j = a ln t_j + ..., the model ln f(v_ij) = ln x_i + ln t_j + e_j divided by 1 + a is the
/// same model.
void ResponseSolver::take_exponent_to_curves() {
  const double slope = exponent_of_times(), middle = median(log_times_);
  for (std::size_t j = 0; j < corrections_.size(); ++j) corrections_[j] = (corrections_[j] - slope * (log_times_[j] - middle)) / (1 + slope);
  for (ResponseChannel& c : channels_) c.divide_exponent(1 + slope);
}

double ResponseSolver::refine(const Round& round) {
  Equations joint = equations(round, false);
  std::vector<double> information;
  for (std::size_t i = 0; i < first_time_; ++i) information.push_back(joint.a(i, i));
  for (std::size_t c = 0; c < channels_.size(); ++c) add_curve_prior(c, round.slope_change, joint.a, joint.b);
  add_time_prior(round.time_sigma, joint.a, joint.b);
  std::vector<double> change = solve(std::move(joint.a), std::move(joint.b));
  // At most a factor e in one round: far from the solution the linearisation is not to be trusted further.
  for (double& x : change) x = std::clamp(x, -1.0, 1.0);
  double squares = 0, total = 0;
  for (std::size_t i = 0; i < first_time_; ++i) {
    squares += information[i] * change[i] * change[i];
    total += information[i];
  }
  for (std::size_t c = 0; c < channels_.size(); ++c) channels_[c].change_spline(&change[first_coefficient(c)]);
  for (std::size_t j = 0; j < corrections_.size(); ++j) corrections_[j] += change[first_time_ + j];
  if (round.time_sigma > 0) take_exponent_to_curves();
  return total > 0 ? std::sqrt(squares / total) : 0;
}

double ResponseSolver::refine_times(const Round& round) {
  const Equations joint = equations(round, false);
  const std::size_t n = corrections_.size();
  SymmetricMatrix a(n);
  std::vector<double> b(n);
  for (std::size_t i = 0; i < n; ++i) {
    b[i] = joint.b[first_time_ + i] - time_precision(i, round.time_sigma) * corrections_[i];
    for (std::size_t j = 0; j <= i; ++j) a.at(i, j) = joint.a(first_time_ + i, first_time_ + j);
    a.at(i, i) += time_precision(i, round.time_sigma);
  }
  const std::vector<double> change = solve(std::move(a), std::move(b));
  double largest = 0;
  for (std::size_t j = 0; j < n; ++j) {
    corrections_[j] += std::clamp(change[j], -1.0, 1.0);
    largest = std::max(largest, std::abs(change[j]));
  }
  exponent_ = exponent_of_times();
  return largest;
}

void ResponseSolver::reset_times() {
  std::fill(corrections_.begin(), corrections_.end(), 0.0);
  exponent_ = 0;
}

bool ResponseSolver::times_differ(const std::vector<double>& log_time_sigma) const {
  for (std::size_t j = 0; j < corrections_.size(); ++j)
    if (std::abs(corrections_[j]) > std::max(5e-4, 4 * log_time_sigma[j])) return true;
  return false;
}

bool ResponseSolver::is_seen(std::size_t j) const {
  constexpr double few_percent = 0.03;
  return time_information_[j] * few_percent * few_percent > 1;
}

/// Of what is left of the e_j when their common mean is taken off: the gauge has no error. Infinite for a frame that is clipped or dark
/// throughout.
std::vector<double> ResponseSolver::time_sigma(const SymmetricMatrix& covariance) const {
  std::vector<std::size_t> seen;
  for (std::size_t j = 0; j < corrections_.size(); ++j)
    if (is_seen(j)) seen.push_back(j);
  std::vector<double> sigma(corrections_.size(), std::numeric_limits<double>::infinity());
  if (seen.size() < 2) return sigma;
  const double n = static_cast<double>(seen.size());
  std::vector<double> row_mean(corrections_.size());
  double mean = 0;
  for (const std::size_t j : seen)
    for (const std::size_t k : seen) {
      row_mean[j] += covariance(j, k) / n;
      mean += covariance(j, k) / (n * n);
    }
  for (const std::size_t j : seen) sigma[j] = std::sqrt(std::max(0.0, covariance(j, j) - 2 * row_mean[j] + mean));
  return sigma;
}

double ResponseSolver::spread_of_times() const {
  constexpr double small_sample = 1.2;  // a median of some ten distances is 10 % low and 20 % uncertain
  std::vector<double> seen, distance;
  for (std::size_t j = 0; j < corrections_.size(); ++j)
    if (is_seen(j)) seen.push_back(corrections_[j] - exponent_ * log_times_[j]);
  if (seen.size() < 3) return smallest_spread;
  const double middle = median(seen);
  for (const double e : seen) distance.push_back(std::abs(e - middle));
  return std::clamp(small_sample * 1.4826 * median(distance), smallest_spread, largest_spread);
}

Response ResponseSolver::response() const {
  Response response{bits_, false, {}};
  for (const ResponseChannel& c : channels_) response.curves.push_back({c.exposure(), {}, {}});
  return response;
}

std::vector<std::size_t> ResponseSolver::band_values(const ResponseChannel& channel) const {
  const std::size_t mid = std::size_t{1} << (bits_ - 1), top = channel.exposure().size() - 1;
  const ResponseSpline& spline = channel.spline();
  std::vector<std::size_t> values{mid, top};
  for (double c = 0; c < spline.coordinate(spline.highest()); ++c) {
    const double above_first = std::exp(spline.log_signal(c)) - std::exp(spline.lowest());
    values.push_back(std::min(top, channel.first_value() + static_cast<std::size_t>(std::lround(above_first))));
  }
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
  return values;
}

Response ResponseSolver::response_with_band(const Round& round, std::size_t sampled_step) {
  const double residual_rms = residual_rms_;
  Round sampled = round;
  sampled.pixel_step = sampled_step;
  Equations joint = equations(sampled, true);
  residual_rms_ = residual_rms;
  joint.a.scale(static_cast<double>(sampled_step) / static_cast<double>(round.pixel_step));
  joint.scatter.scale(static_cast<double>(sampled_step) / static_cast<double>(round.pixel_step));
  SymmetricMatrix prior(joint.a.size());
  for (std::size_t c = 0; c < channels_.size(); ++c) add_curve_prior(c, round.slope_change, prior, joint.b);
  add_time_prior(round.time_sigma, prior, joint.b);
  joint.a.add(prior);
  joint.scatter.add(prior);
  const SymmetricMatrix covariance = sandwich(std::move(joint.a), joint.scatter);

  Response result = response();
  for (std::size_t c = 0; c < channels_.size(); ++c) {
    const ResponseChannel& channel = channels_[c];
    ResponseCurve& curve = result.curves[c];
    const ResponseSpline::Basis at_mid = channel.basis_of_value(std::size_t{1} << (bits_ - 1));
    for (const std::size_t v : band_values(channel)) {
      const ResponseSpline::Basis here = channel.basis_of_value(v);
      std::vector<double> x(channel.coefficients().size());
      for (std::size_t p = 0; p < 4; ++p) {
        x[here.first + p] += here.weight[p];
        x[at_mid.first + p] -= at_mid.weight[p];
      }
      curve.band_value.push_back(static_cast<double>(v));
      curve.band_log_sigma.push_back(std::sqrt(std::max(0.0, covariance.quadratic_form(first_coefficient(c), x))));
    }
  }
  return result;
}

std::vector<double> ResponseSolver::loosen_times(Round round) {
  constexpr int max_rounds = 10;
  constexpr double tolerance = 1e-5;
  round.time_sigma = largest_spread;
  for (int i = 0; i < max_rounds && refine_times(round) > tolerance; ++i) continue;
  const Equations joint = equations(round, true);
  const std::size_t n = corrections_.size();
  SymmetricMatrix a(n), scatter(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      a.at(i, j) = joint.a(first_time_ + i, first_time_ + j);
      scatter.at(i, j) = joint.scatter(first_time_ + i, first_time_ + j);
    }
    a.at(i, i) += time_precision(i, round.time_sigma);
    scatter.at(i, i) += time_precision(i, round.time_sigma);
  }
  return time_sigma(sandwich(std::move(a), scatter));
}

TimeFit fit_times(ResponseSolver& solver, const BracketSamples& samples, const Response& response, const NoiseModel& known) {
  constexpr int noise_rounds = 3, max_iterations = 30;
  constexpr double tolerance = 1e-6;
  solver.set_curves(response);
  TimeFit fit;
  NoiseModel noise;
  ResponseSolver::Round round;
  round.time_sigma = loose_time_sigma;
  const std::size_t few = samples.step_to(noise_pixels);
  const BracketSamples noise_samples = samples.thinned(few);
  while (fit.iterations < max_iterations && !fit.converged) {
    const int i = fit.iterations++;
    round.pixel_step = i < noise_rounds ? few : 1;
    const double change = solver.refine_times(round);
    fit.converged = i > noise_rounds && change < tolerance;
    if (i >= noise_rounds) continue;
    noise = estimate_noise(noise_samples.with_times(solver.log_time_corrections()), response, known);
    round.noise = &noise;
    round.time_sigma = solver.spread_of_times();
  }
  fit.log_sigma = solver.loosen_times(round);
  return fit;
}

FrameTimes times_of_frames(std::span<const std::size_t> bracket_sizes, const BracketSamples& samples, const std::vector<double>& corrections,
                           const std::vector<double>& log_sigma) {
  FrameTimes result;
  std::size_t f = 0;
  for (const std::size_t size : bracket_sizes) {
    std::vector<double> seen;
    for (std::size_t i = 0; i < size; ++i)
      if (const std::size_t k = samples.exposure_of_frame[f + i]; std::isfinite(log_sigma[k])) seen.push_back(corrections[k]);
    const double gauge = seen.empty() ? 0 : median(seen);
    for (std::size_t i = 0; i < size; ++i, ++f) {
      const std::size_t k = samples.exposure_of_frame[f];
      result.log_correction.push_back(std::isfinite(log_sigma[k]) ? corrections[k] - gauge : 0.0);
      result.log_sigma.push_back(log_sigma[k]);
    }
  }
  return result;
}

}  // namespace lacquer::calib
