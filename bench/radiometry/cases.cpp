#include "bench/radiometry/cases.h"

#include <cmath>

#include "libcalib/merge.h"

namespace lacquer::bench {

namespace {

calib::ResponseOptions response_options(const Sensor& sensor) {
  calib::ResponseOptions options;
  options.black_level_dn = sensor.black_dn;
  return options;
}

double spread_of_reference(const Stack& stack, const ReferenceImage& reference, const std::vector<std::uint8_t>& valid) {
  double square = 0, n = 0;
  for (std::size_t i = 0; i < valid.size(); ++i)
    if (valid[i]) square += std::pow(reference.radiance[i] - stack.truth[i], 2) / reference.variance[i], ++n;
  return std::sqrt(square / n);
}

PeerCase judge(PeerResult result, const Stack& stack, const std::vector<std::uint8_t>& valid, const CaseOptions& options) {
  PeerCase peer{std::move(result), {}, {}};
  if (!peer.result.unavailable.empty()) return peer;
  peer.error = radiance_error(peer.result.radiance, stack, valid);
  peer.result.radiance.clear();
  if (!peer.result.curve[0].empty())
    peer.response_error = response_error(
        [&](int c, int v) { return peer.result.curve[static_cast<std::size_t>(c)][static_cast<std::size_t>(v)]; }, stack,
        options.min_response_count);
  return peer;
}

PeerResult plain_loop(const Stack& stack) {
  PeerResult result{"plain loop, one thread, all known", {}, {}, {}, {}, {}, {}};
  ReferenceImage image;
  result.merge = time_repeats(1, [&] { image = merge_reference(stack, {}); });
  result.radiance.assign(image.radiance.begin(), image.radiance.end());
  return result;
}

}  // namespace

CaseResult run_case(const Stack& stack, const ReferenceImage& reference, const std::vector<std::uint8_t>& valid, const CaseOptions& options) {
  CaseResult result;
  result.curve = stack.sensor.curve.name;
  result.bits = stack.sensor.bits;
  result.reference_spread = spread_of_reference(stack, reference, valid);
  result.reference = radiance_error(std::vector<float>(reference.radiance.begin(), reference.radiance.end()), stack, valid);

  const std::vector<std::vector<acquire::RawFrame>> brackets{stack.frames};
  calib::ResponseEstimate estimate;
  result.response =
      time_repeats(options.response_repeats, [&] { estimate = calib::estimate_response(brackets, response_options(stack.sensor)); });
  result.converged = estimate.converged;
  result.response_error = response_error(
      [&](int c, int v) { return estimate.response.curves[static_cast<std::size_t>(c)].exposure[static_cast<std::size_t>(v)]; }, stack,
      options.min_response_count);

  calib::NoiseModel noise;
  noise.black_level_dn = stack.sensor.black_dn;
  result.noise = time_repeats(options.response_repeats, [&] { noise = calib::estimate_noise(brackets, estimate.response, noise); });
  calib::RadianceImage image;
  result.merge = time_repeats(options.merge_repeats, [&] { calib::merge_bracket(stack.frames, estimate.response, noise, {}, image); });
  result.estimated = radiance_error(image.radiance, stack, valid);
  result.levels_estimated = standardised_errors(image, result.estimated.scale, stack, options.min_level_count);

  const calib::Response truth = stack.sensor.response();
  result.merge_known =
      time_repeats(options.merge_repeats, [&] { calib::merge_bracket(stack.frames, truth, stack.sensor.noise(), {}, image); });
  result.known = radiance_error(image.radiance, stack, valid);
  result.levels_known = standardised_errors(image, {1, 1, 1}, stack, options.min_level_count);
  return result;
}

std::vector<PeerCase> run_peers(const Stack& stack, const std::vector<std::uint8_t>& valid, const std::filesystem::path& folder,
                               const CaseOptions& options) {
  std::vector<PeerCase> peers;
  const auto add = [&](PeerResult result) { peers.push_back(judge(std::move(result), stack, valid, options)); };
  add(plain_loop(stack));
  add(run_opencv_robertson(stack.frames, options.merge_repeats));
  add(run_opencv_debevec(stack.frames, options.merge_repeats));
  for (PeerResult& result : run_programs(stack.frames, folder)) add(std::move(result));
  return peers;
}

}  // namespace lacquer::bench
