#include "libcalib/response.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <tbb/parallel_for.h>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/bracket_samples.h"
#include "libcalib/calibration_json.h"
#include "libcalib/noise_model.h"
#include "libcalib/response_solver.h"

namespace lacquer::calib {

namespace {

/// Values with less signal than this many sigmas are left out of the estimate: selecting pixels by a noisy value shifts their mean.
constexpr double min_signal_to_noise = 4;

std::vector<double> slopes(const std::vector<double>& exposure) {
  std::vector<double> slope(exposure.size());
  for (std::size_t v = 0; v < slope.size(); ++v) {
    const std::size_t low = v > 0 ? v - 1 : v, high = std::min(v + 1, exposure.size() - 1);
    slope[v] = (exposure[high] - exposure[low]) / static_cast<double>(high - low);
  }
  return slope;
}

/// Inverse variance of log exposure of every value; 0 where the value says nothing.
/// `noise` null (no noise model yet): one DN RMS everywhere, whatever the curve.
std::vector<double> level_weights(const std::vector<double>& exposure, const NoiseModel* noise, int saturation) {
  const std::vector<double> slope = slopes(exposure);
  std::vector<double> weight(exposure.size(), 0.0);
  for (std::size_t v = 0; v < weight.size(); ++v) {
    const double z = exposure[v];
    if (z <= 0 || static_cast<int>(v) >= saturation) continue;
    double variance = slope[v] * slope[v];
    if (noise) {
      const double g = noise->gain_e_per_dn, read = noise->read_noise_e / g, relative = noise->relative_noise * z;
      variance = read * read + z / g + relative * relative + slope[v] * slope[v] / 12;
    }
    // Goes to 0 at saturation: there only values whose noise was negative are left.
    const double room = (static_cast<double>(saturation) - static_cast<double>(v)) * slope[v] / std::sqrt(variance);
    const double taper = std::min(room / min_signal_to_noise, 1.0);
    if (z * z >= min_signal_to_noise * min_signal_to_noise * variance) weight[v] = taper * z * z / variance;
  }
  return weight;
}

/// Noise needs one response for all channels' curves at once.
Response as_response(int bits, const std::vector<std::vector<double>>& curves) {
  Response response{bits, false, {}};
  for (const auto& curve : curves) response.curves.push_back({curve});
  return response;
}

double rms_log_change(const std::vector<double>& a, const std::vector<double>& b, double black) {
  double sum = 0, n = 0;
  for (std::size_t v = 0; v < a.size(); ++v) {
    if (static_cast<double>(v) <= black) continue;
    const double change = std::log(a[v] / b[v]);
    sum += change * change;
    n += 1;
  }
  return std::sqrt(sum / std::max(n, 1.0));
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
  const int bits = brackets.front().front().bits;
  NoiseModel known;
  known.black_level_dn = options.black_level_dn;
  known.saturation_dn = options.saturation_dn;
  known.validate();
  const int saturation = saturation_value(known, bits);
  SamplingOptions sampling{options.max_pixels, options.ignore_border_px, static_cast<int>(std::floor(options.black_level_dn)) + 1,
                           saturation};
  const BracketSamples samples = sample_brackets(brackets, sampling);

  std::vector<ResponseSolver> solvers;
  std::vector<std::vector<double>> curves;
  for (std::size_t c = 0; c < samples.channels.size(); ++c) {
    solvers.emplace_back(bits, options.black_level_dn, samples.channels[c], samples.times, options.slope_change);
    curves.push_back(linear_response(bits, 1, options.black_level_dn).curves[0].exposure);
  }
  ResponseEstimate estimate;
  NoiseModel noise;
  constexpr int n_start = 3;  // iterations before the curve is good enough to see the noise
  while (estimate.iterations < options.max_iterations && !estimate.converged) {
    const bool noise_known = estimate.iterations >= n_start;
    if (noise_known) noise = estimate_noise(samples, as_response(bits, curves), known);
    std::vector<double> change(curves.size()), rms(curves.size());
    tbb::parallel_for(std::size_t{0}, curves.size(), [&](std::size_t c) {
      const auto weights = level_weights(curves[c], noise_known ? &noise : nullptr, saturation);
      const ResponseSolver::Step step = solvers[c].solve(weights, noise_known);
      change[c] = rms_log_change(step.exposure, curves[c], options.black_level_dn);
      rms[c] = step.residual_rms;
      curves[c] = step.exposure;
    });
    estimate.residual_rms = *std::max_element(rms.begin(), rms.end());
    estimate.converged = noise_known && *std::max_element(change.begin(), change.end()) < options.tolerance;
    ++estimate.iterations;
  }
  estimate.response = as_response(bits, curves);
  return estimate;
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
