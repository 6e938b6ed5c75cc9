#include "libcalib/geometry_moves.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <string>

#include "libcalib/geometry_difference.h"
#include "libcalib/geometry_unknowns.h"
#include "libcalib/response_algebra.h"
#include "libcalib/samples.h"

namespace lacquer::calib {

namespace {

/// The unknowns whose names those of `estimated` are; nullopt: there are none.
std::optional<GeometryUnknowns> unknowns_of(const acquire::RigGeometry& nominal, const std::vector<double>& lens_covariance, const std::vector<GeometryParameter>& estimated) {
  const auto has = [&](const std::string& name) {
    return std::any_of(estimated.begin(), estimated.end(), [&](const GeometryParameter& p) { return p.name == name; });
  };
  std::vector<bool> seen;
  for (std::size_t i = 0; i < nominal.lights.size(); ++i) {
    std::vector<bool> one(nominal.lights.size());
    one[i] = true;
    const GeometryUnknowns with_light(nominal, {}, one);
    seen.push_back(has(with_light.parameters().back().name));
  }
  GeometryPriors priors;
  if (std::any_of(estimated.begin(), estimated.end(), [](const GeometryParameter& p) { return p.name.starts_with("lens."); })) priors.lens_covariance = lens_covariance;
  GeometryUnknowns unknowns(nominal, priors, seen);
  if (unknowns.size() != estimated.size()) return std::nullopt;
  for (const GeometryParameter& p : unknowns.parameters())
    if (!has(p.name)) return std::nullopt;
  return unknowns;
}

bool same_geometry(const acquire::RigGeometry& a, const acquire::RigGeometry& b) {
  constexpr double rounding = 1e-9;
  bool same = a.lights.size() == b.lights.size() && glm::length(a.cam_from_rig.translation - b.cam_from_rig.translation) < rounding &&
              glm::length(a.axis_point - b.axis_point) < rounding && glm::length(a.axis_direction - b.axis_direction) < rounding;
  for (std::size_t i = 0; same && i < a.lights.size(); ++i) same = glm::length(a.lights[i].position - b.lights[i].position) < rounding;
  return same;
}

/// Of every so many-th view: an RMS over 40 is good enough.
std::vector<ViewAngles> angles_of(const acquire::Session& session, const Calibration& moved, const Calibration& calibration) {
  std::vector<ViewAngles> views;
  const std::vector<std::size_t> measured = session.views_of(acquire::ViewKind::measurement);
  for (std::size_t k = 0; k < measured.size(); k += 1 + measured.size() / 40) {
    const auto& view = session.views[measured[k]];
    views.push_back({static_cast<std::size_t>(view.light), illumination_of(view, moved).turntable_angle, illumination_of(view, calibration).turntable_angle});
  }
  return views;
}

}  // namespace

std::optional<std::vector<Calibration>> moved_calibrations(const acquire::Session& session, const Calibration& calibration) {
  const GeometryUncertainty& known = calibration.geometry_uncertainty;
  const std::size_t n = known.parameters.size();
  if (n == 0 || known.covariance.size() != n * n) return std::nullopt;
  const auto unknowns = unknowns_of(session.rig.geometry, calibration.lens_covariance, known.parameters);
  if (!unknowns) return std::nullopt;
  // In the unknowns' order and units.
  const auto x_of = [&](const std::vector<double>& corrections) {
    std::vector<double> x;
    for (const GeometryParameter& u : unknowns->parameters()) {
      const auto at = std::find_if(known.parameters.begin(), known.parameters.end(), [&](const GeometryParameter& p) { return p.name == u.name; });
      x.push_back(corrections[static_cast<std::size_t>(at - known.parameters.begin())] / u.prior_sigma);
    }
    return x;
  };
  std::vector<double> corrections;
  for (const GeometryParameter& p : known.parameters) corrections.push_back(p.correction);
  if (!same_geometry(unknowns->geometry(x_of(corrections)), calibration.geometry)) return std::nullopt;

  const std::vector<double> factor = cholesky_factor(known.covariance, n);
  std::vector<Calibration> result;
  for (std::size_t k = 0; k < n; ++k) {
    std::vector<double> moved = corrections;
    for (std::size_t i = k; i < n; ++i) moved[i] += factor[i * n + k];
    Calibration c = calibration;
    c.geometry = unknowns->geometry(x_of(moved));
    c.turntable_scale = unknowns->turntable_scale(x_of(moved));
    const GeometrySigma sigma = geometry_sigma(session, calibration, {c});
    if (sigma.half_vector_rad > 1e-7 || sigma.distance > 1e-6) result.push_back(std::move(c));
  }
  return result;
}

GeometrySigma geometry_sigma(const acquire::Session& session, const Calibration& calibration, const std::vector<Calibration>& moved) {
  GeometrySigma sigma;
  for (const Calibration& c : moved) {
    const GeometryDifference d = geometry_difference(c.geometry, calibration.geometry, angles_of(session, c, calibration));
    sigma.half_vector_rad = std::hypot(sigma.half_vector_rad, d.half_vector_rad);
    sigma.distance = std::hypot(sigma.distance, d.distance);
  }
  return sigma;
}

}  // namespace lacquer::calib
