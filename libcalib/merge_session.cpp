#include "libcalib/merge_session.h"

#include <algorithm>
#include <filesystem>

#include "libcalib/merge.h"
#include "libcalib/response.h"

namespace lacquer::calib {

namespace {

/// Views whose brackets go into the response: enough to see every level, few enough to stay within seconds and in memory.
constexpr std::size_t response_views = 4;

std::vector<acquire::RawFrame> read_bracket(const acquire::Session& session, const acquire::ViewRecord& view) {
  std::vector<acquire::RawFrame> frames;
  for (const auto& record : view.frames) frames.push_back(acquire::read_session_frame(session, record));
  return frames;
}

}  // namespace

void estimate_session_response(const acquire::Session& session, Calibration& calibration) {
  // The first views see most of the lit side: spread over the first half of the session.
  const std::size_t n = session.views.size(), n_used = std::min(response_views, n);
  std::vector<std::vector<acquire::RawFrame>> brackets;
  for (std::size_t i = 0; i < n_used; ++i) brackets.push_back(read_bracket(session, session.views[i * ((n + 1) / 2) / n_used]));

  ResponseOptions options;
  options.black_level_dn = calibration.noise.black_level_dn;
  options.saturation_dn = calibration.noise.saturation_dn;
  calibration.response = estimate_response(brackets, options).response;
  calibration.response_source = "estimated from the brackets of " + std::to_string(n_used) + " views";
  if (calibration.response.linear) return;
  calibration.noise = estimate_noise(brackets, calibration.response, calibration.noise);
  calibration.noise_source = "estimated from the brackets of " + std::to_string(n_used) + " views";
  calibration.absolute_scale = false;
  calibration.scale_source = "none: relative, the gauge of the estimated response is arbitrary";
}

void merge_session(const acquire::Session& session, const Calibration& calibration, const Progress& progress) {
  std::filesystem::create_directories(session.folder / "radiance");
  for (std::size_t i = 0; i < session.views.size(); ++i) {
    const auto& view = session.views[i];
    write_radiance(session.radiance_path(view), merge_bracket(read_bracket(session, view), calibration.response, calibration.noise));
    if (progress) progress("merge", i + 1, session.views.size());
  }
}

}  // namespace lacquer::calib
