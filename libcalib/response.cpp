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

Response as_response(int bits, const std::vector<ResponseSolver>& solvers) {
  Response response{bits, false, {}};
  for (const ResponseSolver& s : solvers) response.curves.push_back({s.curve()});
  return response;
}

/// Noise for weighting. Its relative part is bounded: a curve that is still wrong looks like noise, and weights that believe that
/// would leave no value to correct it with.
NoiseModel curve_noise(const BracketSamples& samples, const Response& response, const NoiseModel& known) {
  NoiseModel noise = estimate_noise(samples, response, known);
  noise.relative_noise = std::min(noise.relative_noise, 0.05);
  return noise;
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
  const SamplingOptions sampling{options.max_pixels, options.ignore_border_px, options.black_level_dn > 0 ? 0 : 1, saturation};
  const BracketSamples samples = sample_brackets(brackets, sampling);

  std::vector<ResponseSolver> solvers;
  for (const SampledPixels& pixels : samples.channels)
    solvers.emplace_back(bits, options.black_level_dn, saturation, pixels, samples.times);
  const auto each_channel = [&](const auto& work) {
    std::vector<double> results(solvers.size());
    tbb::parallel_for(std::size_t{0}, solvers.size(), [&](std::size_t c) { results[c] = work(solvers[c]); });
    return *std::max_element(results.begin(), results.end());
  };
  each_channel([](ResponseSolver& s) { s.fit_power_law(); return 0.0; });

  // The noise can be seen once the curve is roughly right, and is then held: its small jumps would keep the curve moving. Until
  // then the curve is kept stiff, or it would follow the error of the start.
  constexpr int first_noise = 4, last_noise = 7;
  ResponseEstimate estimate;
  NoiseModel noise;
  while (estimate.iterations < options.max_iterations && !estimate.converged) {
    const int i = estimate.iterations++;
    const bool noise_known = i >= first_noise;
    if (noise_known && i <= last_noise) noise = curve_noise(samples, as_response(bits, solvers), known);
    const double slope_change = options.slope_change * std::min(1.0, 0.05 * std::exp2(i));
    const double change = each_channel([&](ResponseSolver& s) { return s.refine(noise_known ? &noise : nullptr, slope_change); });
    estimate.converged = i > last_noise && change < options.tolerance;
  }
  estimate.residual_rms = each_channel([](ResponseSolver& s) { return s.residual_rms(); });
  estimate.response = as_response(bits, solvers);
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
