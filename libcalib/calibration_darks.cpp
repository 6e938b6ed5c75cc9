#include "libcalib/calibration_darks.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "libbrdf/error.h"
#include "libcalib/photon_transfer.h"

namespace lacquer::calib {

namespace {

constexpr double significance = 4;  ///< standard errors; by chance once in 16000

FrameSeries dark_series(const acquire::Session& session) {
  FrameSeries series;
  std::vector<const acquire::FrameRecord*> records;
  for (const std::size_t v : session.views_of(acquire::ViewKind::dark))
    for (const acquire::FrameRecord& record : session.views[v].frames) {
      series.items.push_back({record.exposure_s, session.frame_path(record).string()});
      records.push_back(&record);
    }
  series.read = [&session, records = std::move(records)](std::size_t i) { return acquire::read_session_frame(session, *records[i]); };
  return series;
}

/// Replaces `assumed` by `factor` times what was measured where the two differ; says so.
bool replace(double& assumed, const std::optional<Measured>& measured, double factor, const char* name, const char* unit, std::string& text) {
  if (!measured) return false;
  const double value = std::max(factor * measured->value, 0.0), sigma = factor * measured->sigma;
  const bool differs = std::abs(value - assumed) > significance * sigma;
  text += fmt::format(", {} {:.4g} ± {:.1g} {}{}", name, value, sigma, unit, differs ? fmt::format(" (assumed: {:.4g})", assumed) : " as assumed");
  if (differs) assumed = value;
  return differs;
}

/// The maps of the darks, completed by those that were known before.
SensorMaps joined(SensorMaps darks, const SensorMaps& known) {
  if (known.empty()) return darks;
  if (darks.offset.empty()) darks.offset = known.offset, darks.offset_sigma = known.offset_sigma;
  if (darks.dark_rate.empty()) darks.dark_rate = known.dark_rate, darks.dark_rate_sigma = known.dark_rate_sigma;
  darks.flat = known.flat, darks.flat_sigma = known.flat_sigma;
  if (darks.bad.empty()) darks.bad = known.bad;
  for (std::size_t i = 0; i < known.bad.size(); ++i) darks.bad[i] = darks.bad[i] || known.bad[i];
  return darks;
}

void apply(const PhotonTransfer& t, const acquire::Session& session, std::size_t n_frames, Calibration& c) {
  const bool curved = !c.response.linear;
  std::string text;
  NoiseModel& noise = c.noise;
  const double assumed_black = noise.black_level_dn;
  // A curve contains its black level; what differs is in the offset map.
  if (!curved) replace(noise.black_level_dn, t.all.black_level_dn, 1, "black level", "DN", text);
  // The map is relative to the level that was measured.
  if (!curved && !t.maps.offset.empty()) noise.black_level_dn = t.model.black_level_dn;
  if (noise.black_level_dn != assumed_black) c.response = linear_response(c.response.bits, static_cast<int>(c.response.curves.size()), noise.black_level_dn);
  replace(noise.read_noise_e, t.all.read_noise_dn, noise.gain_e_per_dn, "read noise", "e-", text);
  replace(noise.dark_current_e_per_s, t.all.dark_current_dn_per_s, noise.gain_e_per_dn, "dark current", "e-/s", text);
  text += fmt::format(", {} hot and {} erratic values", t.n_hot, t.n_erratic);
  if (!t.maps.offset.empty()) text += ", map of the black level";
  if (!t.maps.dark_rate.empty()) text += ", map of the dark current";
  c.dark_source = fmt::format("{} dark frames: {}", n_frames, text.substr(2));
  c.maps = joined(t.maps, c.maps);
  if (c.maps.empty()) return;
  c.maps_file = session.folder / "maps.exr";
  write_sensor_maps(c.maps_file, c.maps);
}

}  // namespace

void apply_dark_views(const acquire::Session& session, Calibration& calibration, const Progress& progress) {
  const FrameSeries series = dark_series(session);
  if (series.items.empty()) return;
  PhotonTransferOptions options;
  if (!calibration.response.linear) options.response = calibration.response;
  options.black_level_dn = calibration.noise.black_level_dn;  // where the camera cuts off below its black level
  std::optional<PhotonTransfer> measured;
  try {
    measured = photon_transfer(series, {}, options, progress);
  } catch (const Error& e) {
    if (e.code() != ErrorCode::input) throw;  // a frame that cannot be read is another matter
    calibration.dark_source = fmt::format("dark frames are not used: {}", e.what());
    return;
  }
  apply(*measured, session, series.items.size(), calibration);
}

}  // namespace lacquer::calib
