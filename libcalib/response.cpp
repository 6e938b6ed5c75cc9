#include "libcalib/response.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/bracket_samples.h"
#include "libcalib/calibration_json.h"
#include "libcalib/noise_model.h"
#include "libcalib/response_linearity.h"
#include "libcalib/response_solver.h"

namespace lacquer::calib {

namespace {

/// Pixels per channel until the curve is nearly right.
constexpr std::size_t few_pixels = 4000;
/// Pixels per channel that the band is seen with.
constexpr std::size_t covariance_pixels = 5000;

/// Noise for weighting. Its relative part is bounded: a curve that is still wrong looks like noise, and weights that believe that
/// would leave no value to correct it with.
NoiseModel curve_noise(const BracketSamples& samples, const ResponseSolver& solver, const Response& response, const NoiseModel& known) {
  NoiseModel noise = estimate_noise(samples.with_times(solver.log_time_corrections()), response, known);
  noise.relative_noise = std::min(noise.relative_noise, 0.05);
  return noise;
}

void check_samples(const BracketSamples& samples, int saturation) {
  const auto empty = [](const SampledPixels& pixels) { return pixels.n_pixels() == 0; };
  if (std::all_of(samples.channels.begin(), samples.channels.end(), empty))
    throw Error(ErrorCode::input, fmt::format("response: no pixel has values between black and saturation ({}) at two exposure times; "
                                              "expected a bracket that is neither clipped nor dark throughout", saturation));
  if (samples.unused_low_bits > 0)
    throw Error(ErrorCode::input, fmt::format("frames: all values are multiples of {}: {} bits stored left-aligned; expected right-aligned values",
                                              1 << samples.unused_low_bits, samples.bits - samples.unused_low_bits));
}

void set_times(std::span<const std::vector<acquire::RawFrame>> brackets, const BracketSamples& samples, const std::vector<double>& corrections,
               const std::vector<double>& sigma, ResponseEstimate& estimate) {
  std::vector<std::size_t> sizes;
  for (const auto& bracket : brackets) sizes.push_back(bracket.size());
  FrameTimes times = times_of_frames(sizes, samples, corrections, sigma);
  estimate.log_time_correction = std::move(times.log_correction);
  estimate.log_time_sigma = std::move(times.log_sigma);
}

/// The times as a linear sensor sees them.
void fit_times_to_line(std::span<const std::vector<acquire::RawFrame>> brackets, const BracketSamples& samples, const NoiseModel& known,
                       double black, ResponseEstimate& estimate) {
  ResponseSolver solver(samples.bits, black, saturation_value(known, samples.bits), samples);
  const TimeFit fit = fit_times(solver, samples, estimate.response, known);
  estimate.iterations = fit.iterations;
  estimate.converged = fit.converged;
  estimate.residual_rms = solver.residual_rms();
  set_times(brackets, samples, solver.log_time_corrections(), fit.log_sigma, estimate);
}

/// Rounds until the curve stands still. Returns whether it does.
bool refine_until(ResponseSolver& solver, const ResponseSolver::Round& round, const ResponseOptions& options, int& iterations) {
  while (iterations < options.max_iterations) {
    ++iterations;
    if (solver.refine(round) < options.tolerance) return true;
  }
  return false;
}

/// Curve and times together; then, unless the times are to be fitted, the curve with the times as listed.
void fit_curve(std::span<const std::vector<acquire::RawFrame>> brackets, const BracketSamples& samples, const NoiseModel& known,
               const ResponseOptions& options, ResponseEstimate& estimate) {
  ResponseSolver solver(samples.bits, options.black_level_dn, saturation_value(known, samples.bits), samples);
  const BracketSamples noise_samples = samples.thinned(samples.step_to(noise_pixels));
  solver.start_from_power_law();
  // The noise can be seen once the curve is roughly right, and is then held: its small jumps would keep the curve moving. Until then the
  // curve is kept stiff and the times as listed, or they would follow the error of the start. All pixels take part once the rest is settled.
  constexpr int first_noise = 4, last_noise = 7;
  NoiseModel noise;
  ResponseSolver::Round round;
  while (estimate.iterations <= last_noise) {
    const int i = estimate.iterations++;
    round.pixel_step = i < last_noise ? samples.step_to(few_pixels) : 1;
    round.slope_change = options.slope_change * std::min(1.0, 0.05 * std::exp2(i));
    if (i >= first_noise) {
      noise = curve_noise(noise_samples, solver, solver.response(), known);
      round.noise = &noise;
      round.time_sigma = i == first_noise ? loose_time_sigma : solver.spread_of_times();
    }
    solver.refine(round);
  }
  round.slope_change = options.slope_change;
  estimate.converged = refine_until(solver, round, options, estimate.iterations);
  estimate.response = solver.response_with_band(round, samples.step_to(covariance_pixels));
  estimate.residual_rms = solver.residual_rms();
  ResponseSolver::Round few = round;
  few.pixel_step = samples.step_to(noise_pixels);
  const std::vector<double> sigma = solver.loosen_times(few);
  set_times(brackets, samples, solver.log_time_corrections(), sigma, estimate);
  if (!options.fit_times && solver.times_differ(sigma)) {
    solver.reset_times();
    round.time_sigma = 0;
    noise = curve_noise(noise_samples, solver, solver.response(), known);
    int iterations = 0;
    estimate.converged = refine_until(solver, round, options, iterations);
    estimate.iterations += iterations;
    estimate.response = solver.response_with_band(round, samples.step_to(covariance_pixels));
    estimate.residual_rms = solver.residual_rms();
  }
}

}  // namespace

Response linear_response(int bits, int n_channels, double black_level_dn) {
  Response response;
  response.bits = bits;
  ResponseCurve curve;
  curve.exposure.resize(std::size_t{1} << bits);
  for (std::size_t v = 0; v < curve.exposure.size(); ++v) curve.exposure[v] = static_cast<double>(v) - black_level_dn;
  response.curves.assign(static_cast<std::size_t>(n_channels), curve);
  return response;
}

ResponseEstimate estimate_response(std::span<const std::vector<acquire::RawFrame>> brackets, const ResponseOptions& options) {
  if (brackets.empty() || brackets.front().empty())
    throw Error(ErrorCode::input, "response: expected at least one bracket of frames, got none");
  NoiseModel known;
  known.black_level_dn = options.black_level_dn;
  known.saturation_dn = options.saturation_dn;
  known.validate();
  const int bits = brackets.front().front().bits, saturation = saturation_value(known, bits);
  if (!(options.black_level_dn <= std::exp2(bits - 1) - 2))
    throw Error(ErrorCode::input, fmt::format("black level: expected less than half of {} bits, got {}", bits, options.black_level_dn));
  const BracketSamples samples =
      sample_brackets(brackets, {options.max_pixels, options.ignore_border_px, options.black_level_dn > 0 ? 0 : 1, saturation});
  check_samples(samples, saturation);

  ResponseEstimate estimate;
  if (options.recognise_linear) estimate.linearity = test_linearity(samples, known);
  if (estimate.linearity && estimate.linearity->linear) {
    const double black = estimate.linearity->black_level_dn;
    estimate.response = linear_response(bits, static_cast<int>(samples.channels.size()), black);
    fit_times_to_line(brackets, samples, known, black, estimate);
  } else {
    fit_curve(brackets, samples, known, options, estimate);
  }
  return estimate;
}

std::optional<double> log_sigma_at(const ResponseCurve& curve, double value) {
  if (curve.band_value.empty()) return std::nullopt;
  const auto above = std::upper_bound(curve.band_value.begin(), curve.band_value.end(), value);
  if (above == curve.band_value.begin()) return curve.band_log_sigma.front();
  if (above == curve.band_value.end()) return curve.band_log_sigma.back();
  const auto i = static_cast<std::size_t>(above - curve.band_value.begin());
  const double upper = (value - curve.band_value[i - 1]) / (curve.band_value[i] - curve.band_value[i - 1]);
  return (1 - upper) * curve.band_log_sigma[i - 1] + upper * curve.band_log_sigma[i];
}

void write_response(const std::filesystem::path& file, const Response& response, const std::string& provenance_json) {
  nlohmann::ordered_json j;
  j["version"] = 1;
  j["provenance"] = nlohmann::ordered_json::parse(provenance_json);
  j["gauge"] = "exposure at value 2^(bits-1) is that value minus the black level, DN";
  j["response"] = response_to_json(response);
  brdf::write_text_atomically(file, j.dump() + "\n");
}

Response read_response(const std::filesystem::path& file) {
  const JsonReader root = JsonReader::parse(brdf::read_text(file), file.string());
  if (const double version = root.number("version", 0, 1e9); version != 1)
    throw Error(ErrorCode::file, fmt::format("{}: version: expected 1, got {}", file.string(), version));
  return response_from_json(root.object("response"));
}

}  // namespace lacquer::calib
