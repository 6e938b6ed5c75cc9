#include "libcalib/exposure_times.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "libbrdf/error.h"
#include "libcalib/bracket_samples.h"
#include "libcalib/response_solver.h"

namespace lacquer::calib {

namespace {

constexpr double smallest_false = 0.03, significant_sigmas = 5, spread_sigmas = 6;

/// The lower one of two: half of the frames being false does not hide them.
double lower_median(std::vector<double> x) {
  std::sort(x.begin(), x.end());
  return x[(x.size() - 1) / 2];
}

std::vector<std::size_t> false_frames(const std::vector<double>& correction, const std::vector<double>& sigma) {
  const std::size_t n = correction.size();
  if (n == 2) {
    const double difference = std::abs(correction[1] - correction[0]);
    if (difference > smallest_false && difference > significant_sigmas * std::hypot(sigma[0], sigma[1])) return {0, 1};
    return {};
  }
  std::vector<double> seen;
  for (std::size_t i = 0; i < n; ++i)
    if (std::isfinite(sigma[i])) seen.push_back(std::abs(correction[i]));
  if (seen.empty()) return {};
  const double limit = std::max(smallest_false, spread_sigmas * 1.4826 * lower_median(seen));
  std::vector<std::size_t> result;
  for (std::size_t i = 0; i < n; ++i)
    if (std::abs(correction[i]) > limit && std::abs(correction[i]) > significant_sigmas * sigma[i]) result.push_back(i);
  return result;
}

ExposureTimes make_times(std::span<const acquire::RawFrame> frames, const std::vector<double>& correction, std::vector<double> sigma) {
  ExposureTimes times;
  times.sigma = std::move(sigma);
  times.false_frames = false_frames(correction, times.sigma);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    times.listed_s.push_back(frames[i].actual.exposure_s);
    times.fitted_s.push_back(frames[i].actual.exposure_s * std::exp(correction[i]));
  }
  return times;
}

/// "1/15 s", "0.8 s".
std::string seconds_text(double t) {
  const double inverse = 1 / t;
  if (t < 0.4 && std::abs(inverse - std::round(inverse)) < 0.005 * inverse) return fmt::format("1/{:.0f} s", inverse);
  return fmt::format("{:.4g} s", t);
}

/// Value and error with the digits that the error leaves sense in.
std::string with_error(double value, double error) {
  const int digits = std::clamp(static_cast<int>(std::ceil(-std::log10(std::max(error, 1e-12)))), 0, 12);
  return fmt::format("{:.{}f} s +- {:.{}f}", value, digits, error, digits);
}

}  // namespace

ExposureTimes exposure_times(std::span<const std::vector<acquire::RawFrame>> brackets, std::size_t bracket, const ResponseEstimate& estimate) {
  std::size_t first = 0;
  for (std::size_t b = 0; b < bracket; ++b) first += brackets[b].size();
  const auto part = [&](const std::vector<double>& all) {
    const auto begin = all.begin() + static_cast<std::ptrdiff_t>(first);
    return std::vector<double>(begin, begin + static_cast<std::ptrdiff_t>(brackets[bracket].size()));
  };
  return make_times(brackets[bracket], part(estimate.log_time_correction), part(estimate.log_time_sigma));
}

ExposureTimes check_exposure_times(std::span<const acquire::RawFrame> frames, const Response& response, const NoiseModel& known) {
  check_bracket_format(frames);
  if (response.bits != frames.front().bits)
    throw Error(ErrorCode::input, fmt::format("response: expected {} bits as in the frames, got {}", frames.front().bits, response.bits));
  const std::vector<double> zero(frames.size()), unknown(frames.size(), std::numeric_limits<double>::infinity());
  const auto differs = [&](const acquire::RawFrame& f) { return f.actual.exposure_s != frames.front().actual.exposure_s; };
  if (std::none_of(frames.begin(), frames.end(), differs)) return make_times(frames, zero, unknown);

  const std::vector<std::vector<acquire::RawFrame>> brackets{{frames.begin(), frames.end()}};
  SamplingOptions sampling;
  sampling.max_pixels = 10000;
  sampling.lowest_value = known.black_level_dn > 0 ? 0 : 1;
  sampling.saturation_value = saturation_value(known, response.bits);
  const BracketSamples samples = sample_brackets(brackets, sampling);
  if (std::all_of(samples.channels.begin(), samples.channels.end(), [](const auto& c) { return c.n_pixels() == 0; }))
    return make_times(frames, zero, unknown);
  ResponseSolver solver(response.bits, known.black_level_dn, sampling.saturation_value, samples);
  const TimeFit fit = fit_times(solver, samples, response, known);
  const std::size_t size = frames.size();
  FrameTimes result = times_of_frames({&size, 1}, samples, solver.log_time_corrections(), fit.log_sigma);
  return make_times(frames, result.log_correction, std::move(result.log_sigma));
}

void refuse_false_times(const ExposureTimes& times, const std::string& source, std::span<const std::string> names) {
  constexpr std::size_t max_named = 4;
  if (times.false_frames.empty()) return;
  std::string text = source + ": ";
  for (std::size_t k = 0; k < std::min(times.false_frames.size(), max_named); ++k) {
    const std::size_t i = times.false_frames[k];
    text += fmt::format("{}frame {}{}: listed {}, the pixels say {} ({:.3g} x)", k > 0 ? "; " : "", i + 1,
                        i < names.size() ? fmt::format(" ({})", names[i]) : "", seconds_text(times.listed_s[i]),
                        with_error(times.fitted_s[i], times.fitted_s[i] * times.sigma[i]), times.fitted_s[i] / times.listed_s[i]);
  }
  if (times.false_frames.size() > max_named) text += fmt::format("; and {} more", times.false_frames.size() - max_named);
  throw Error(ErrorCode::input, text + "; correct the list or use --fit-times");
}

void use_fitted_times(const ExposureTimes& times, std::span<acquire::RawFrame> frames) {
  for (std::size_t i = 0; i < frames.size(); ++i) frames[i].actual.exposure_s = times.fitted_s[i];
}

}  // namespace lacquer::calib
