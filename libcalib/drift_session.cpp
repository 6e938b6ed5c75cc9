#include "libcalib/drift_session.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"

namespace lacquer::calib {

using acquire::ViewKind;

LightFollower::LightFollower(const acquire::RigDescription& rig) : patch_(rig.reference_patch), lights_(rig.geometry.lights.size()) {
  by_references_ = std::any_of(rig.plan.begin(), rig.plan.end(), [](const auto& view) { return view.kind == ViewKind::reference; });
}

void LightFollower::follow(Light& light, const acquire::ViewRecord& view, const RadianceImage& image) const {
  const std::optional<double> time = view.time_s();
  if (!time) throw Error(ErrorCode::file, fmt::format("session.json: view {}: frames: time_s is missing", view.id));
  if (light.comparison) {
    light.points.push_back(light.comparison->compare(image, *time));
  } else {
    light.comparison.emplace(image, *time, patch_);
    light.points.push_back(light.comparison->first());
  }
}

void LightFollower::add(const acquire::ViewRecord& view, const RadianceImage& image) {
  if ((!by_references_ && !patch_) || view.kind == ViewKind::dark) return;
  Light& light = lights_.at(static_cast<std::size_t>(view.light));
  // References repeat the first view of their light; the other views show another scene.
  if (by_references_ && view.kind == ViewKind::measurement && light.comparison) return;
  if (!light.failure.empty()) return;
  try {
    follow(light, view, image);
  } catch (const Error& e) {
    light.failure = fmt::format("view {}: {}", view.id, e.what());
  }
}

void LightFollower::finish(Calibration& calibration) const {
  calibration.light_drift.clear();
  calibration.drift_source.clear();
  if (!by_references_ && !patch_) return;
  calibration.drift_source = by_references_ ? "reference views" : fmt::format("patch of {} x {} pixels at ({}, {})", patch_->width, patch_->height, patch_->x, patch_->y);
  for (std::size_t l = 0; l < lights_.size(); ++l) {
    const Light& light = lights_[l];
    if (!light.failure.empty()) calibration.drift_source += fmt::format("; light {} could not be followed: {}", l, light.failure);
    const std::vector<DriftPoint> points = light.failure.empty() ? light.points : std::vector<DriftPoint>{};
    calibration.light_drift.push_back(by_references_ ? fit_drift(points) : follow_each_view(points));
  }
}

double drift_scale_sigma(const acquire::Session& session, const Calibration& calibration) {
  const std::vector<std::size_t> views = session.views_of(ViewKind::measurement);
  double sum = 0, flicker_square = 0;
  for (const std::size_t v : views) {
    const auto light = static_cast<std::size_t>(session.views[v].light);
    const DriftValue value = calibration.light_factor(session.views[v]);
    sum += value.sigma / value.factor;
    if (light < calibration.light_drift.size()) flicker_square += std::pow(calibration.light_drift[light].light_noise, 2);
  }
  return views.empty() ? 0 : std::hypot(sum, std::sqrt(flicker_square)) / static_cast<double>(views.size());
}

}  // namespace lacquer::calib
