#include "libcalib/scale_reference.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>

#include "libbrdf/error.h"
#include "libcalib/response_algebra.h"
#include "libcalib/samples.h"

namespace lacquer::calib {

namespace {

/// Not in the noise model and alike for dark and bright values: sensitivity of pixels, grain and dust of the standard.
constexpr double relative_floor = 0.005;
constexpr int cells_across = 6;
constexpr std::size_t min_values = 100;

/// One value of the image against the model K_c p exp(g q): `p` for intensity 1 on axis and no falloff.
struct Value {
  double measured, variance, p, q;
  int channel, cell;
};

/// Point of the standard that a pixel sees.
std::optional<acquire::SurfacePoint> point_of(const acquire::RigGeometry& rig, const ScaleReference& reference, const glm::dvec2& pixel) {
  if (!reference.plate) return acquire::trace(rig, pixel);
  const auto ray = rig.camera.unproject(pixel);
  if (!ray) return std::nullopt;
  const acquire::RigidTransform rig_from_cam = rig.cam_from_rig.inverse();
  const glm::dvec3 origin = rig_from_cam * ray->origin, direction = rig_from_cam.rotation * ray->direction, n = glm::normalize(reference.plate->normal);
  const double approach = -glm::dot(n, direction);
  if (!(approach > 0)) return std::nullopt;
  const double t = glm::dot(n, origin - reference.plate->point) / approach;
  if (!(t > 0)) return std::nullopt;
  return acquire::SurfacePoint{origin + t * direction, n, -direction};
}

acquire::PixelRectangle search_area(const acquire::CameraModel& camera, const ScaleReference& reference) {
  const acquire::PixelRectangle all{0, 0, camera.width, camera.height};
  if (!reference.plate) return all;
  const acquire::PixelRectangle& r = reference.plate->pixels;
  if (r.x < 0 || r.y < 0 || r.width < 1 || r.height < 1 || r.x > camera.width - r.width || r.y > camera.height - r.height)
    throw Error(ErrorCode::usage, fmt::format("plate: {} x {} pixels at ({}, {}) are not inside the image of {} x {}", r.width, r.height, r.x, r.y, camera.width, camera.height));
  return r;
}

/// Every value of the standard that can be used.
std::vector<Value> values_of(const RadianceImage& image, const Calibration& calibration, const acquire::RigGeometry& rig, const acquire::PlacedLight& placed,
                             const ScaleReference& reference) {
  acquire::PlacedLight unit = placed;
  unit.intensity = glm::dvec3(1.0);
  unit.falloff_exponent = 0;
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
  const acquire::PixelRectangle area = search_area(rig.camera, reference);
  std::vector<Value> values;
  for (int y = area.y; y < area.y + area.height; ++y)
    for (int x = area.x; x < area.x + area.width; ++x) {
      const auto point = point_of(rig, reference, {x, y});
      if (!point || glm::dot(point->normal, point->wo) < reference.min_cosine) continue;
      const auto lit = acquire::illuminate(unit, *point);
      if (!lit || glm::dot(point->normal, lit->wi) < reference.min_cosine) continue;
      const auto local = acquire::to_shading_frame(*point, lit->wi);
      const auto f = reference.brdf->value({local.wi, local.wo});
      const double off_axis = -glm::dot(lit->wi, placed.axis);
      if (!f || !(off_axis > 0)) continue;
      for (std::size_t k = 0; k < per_pixel; ++k) {
        const std::size_t i = (static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x)) * per_pixel + k;
        if (image.flags[i] != PixelFlag::valid) continue;
        const int c = acquire::channel_of(image.layout, x, y, static_cast<int>(k));
        const double p = (*f)[c] * lit->irradiance[c] * lens_transmission(calibration, {x, y}) * calibration.dn_per_radiance[c];
        if (p > 0) values.push_back({image.radiance[i], image.variance[i], p, placed.distant ? 0 : std::log(off_axis), c, y * 65536 + x});
      }
    }
  if (values.size() < min_values)
    throw Error(ErrorCode::input, fmt::format("white reference: {} usable values; expected at least {}: is it where the sphere stands, lit and not clipped?", values.size(), min_values));
  // Regions of the image, each an independent witness.
  int x0 = 65535, x1 = 0, y0 = 65535, y1 = 0;
  for (const Value& v : values) {
    x0 = std::min(x0, v.cell % 65536), x1 = std::max(x1, v.cell % 65536);
    y0 = std::min(y0, v.cell / 65536), y1 = std::max(y1, v.cell / 65536);
  }
  for (Value& v : values)
    v.cell = (v.cell / 65536 - y0) * cells_across / (y1 - y0 + 1) * cells_across + (v.cell % 65536 - x0) * cells_across / (x1 - x0 + 1);
  return values;
}

/// ln K of each channel, then g.
using State = std::array<double, 4>;

double prediction(const Value& v, const State& s) { return v.p * std::exp(s[static_cast<std::size_t>(v.channel)] + s[3] * v.q); }

/// One Gauss-Newton step; the scores of each region for the covariance.
struct Step {
  SymmetricMatrix normal{4};
  std::vector<double> right = std::vector<double>(4);
  std::map<int, State> scores;
};

Step step_at(const std::vector<Value>& values, const State& s, bool fit_falloff) {
  Step step;
  for (const Value& v : values) {
    const double m = prediction(v, s), w = 1 / (v.variance + relative_floor * relative_floor * m * m);
    const std::array<std::size_t, 2> rows{static_cast<std::size_t>(v.channel), 3};
    const std::array<double, 2> jacobian{m, fit_falloff ? m * v.q : 0};
    State& score = step.scores[v.cell];
    for (std::size_t a = 0; a < 2; ++a) {
      const double r = w * jacobian[a] * (v.measured - m);
      step.right[rows[a]] += r;
      score[rows[a]] += r;
      for (std::size_t b = 0; b <= a; ++b) step.normal.at(rows[a], rows[b]) += w * jacobian[a] * jacobian[b];
    }
  }
  return step;
}

State fitted(const std::vector<Value>& values, State s, bool fit_falloff) {
  for (int iteration = 0; iteration < 50; ++iteration) {
    Step step = step_at(values, s, fit_falloff);
    const std::vector<double> d = solve(step.normal, step.right);
    double largest = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      s[i] += std::clamp(d[i], i == 3 ? -20.0 : -2.0, i == 3 ? 20.0 : 2.0);
      largest = std::max(largest, std::abs(d[i]));
    }
    if (largest < 1e-10) break;
  }
  return s;
}

/// Start: median of measured over predicted of each channel.
State start_of(const std::vector<Value>& values, double falloff) {
  State s{0, 0, 0, falloff};
  for (int c = 0; c < 3; ++c) {
    std::vector<double> ratios;
    for (const Value& v : values)
      if (v.channel == c) ratios.push_back(v.measured / (v.p * std::exp(falloff * v.q)));
    if (ratios.empty()) continue;
    const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
    std::nth_element(ratios.begin(), middle, ratios.end());
    if (!(*middle > 0)) throw Error(ErrorCode::input, "white reference: no light on it; expected the standard where the sphere stands");
    s[static_cast<std::size_t>(c)] = std::log(*middle);
  }
  return s;
}

/// Dust, fingerprints, the stand: beyond 5 robust sigmas of the relative residuals.
std::vector<Value> without_outliers(const std::vector<Value>& values, const State& s) {
  std::vector<double> sizes;
  for (const Value& v : values) sizes.push_back(std::abs(v.measured / prediction(v, s) - 1));
  std::vector<double> sorted = sizes;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const double limit = 5 * 1.4826 * *middle;
  std::vector<Value> kept;
  for (std::size_t i = 0; i < values.size(); ++i)
    if (sizes[i] <= limit) kept.push_back(values[i]);
  return kept;
}

}  // namespace

void ScaleReference::validate() const {
  if (!brdf) throw Error(ErrorCode::usage, "white reference: its reflectance is missing");
  if (!(sigma >= 0 && sigma < 1) || !(light_sigma >= 0 && light_sigma < 1)) throw Error(ErrorCode::usage, "white reference: expected relative standard errors from 0 to 1");
  if (!(radius >= 0)) throw Error(ErrorCode::usage, "white reference: expected a radius above 0");
  if (!(min_cosine > 0 && min_cosine < 1)) throw Error(ErrorCode::usage, "white reference: min_cosine: expected a number in (0, 1)");
  if (plate && !(glm::length(plate->normal) > 0)) throw Error(ErrorCode::usage, "white reference: the plate's normal has no direction");
}

LightScale light_scale(const RadianceImage& image, const Calibration& calibration, std::size_t light, double turntable_angle, double factor,
                       const ScaleReference& reference) {
  reference.validate();
  acquire::RigGeometry rig = calibration.geometry;
  if (reference.radius > 0) rig.sphere_radius = reference.radius;
  const acquire::PlacedLight placed = rig.place_light(light, turntable_angle);
  const bool fit_falloff = reference.fit_falloff && !placed.distant;
  std::vector<Value> values = values_of(image, calibration, rig, placed, reference);
  const std::size_t n_all = values.size();
  State s = fitted(values, start_of(values, placed.falloff_exponent), fit_falloff);
  for (int pass = 0; pass < 3; ++pass) {
    values = without_outliers(values, s);
    s = fitted(values, s, fit_falloff);
  }
  if (fit_falloff && !(s[3] >= 0 && s[3] <= 1000))
    throw Error(ErrorCode::input, fmt::format("white reference: light {}: its intensity falls off as cos^{:.1f}, expected an exponent from 0 to 1000; is the light aimed at the reference? "
                                              "(--keep-falloff believes the rig file's)", light, s[3]));

  const Step step = step_at(values, s, fit_falloff);
  const double n_cells = static_cast<double>(step.scores.size());
  if (n_cells < 6) throw Error(ErrorCode::input, "white reference: too small in the image for an error bar");
  SymmetricMatrix scores(4);
  for (const auto& [cell, score] : step.scores)
    for (std::size_t a = 0; a < 4; ++a)
      for (std::size_t b = 0; b <= a; ++b) scores.at(a, b) += score[a] * score[b] * n_cells / (n_cells - (fit_falloff ? 2 : 1));
  const SymmetricMatrix covariance = sandwich(step.normal, scores);

  LightScale result;
  const bool colour = acquire::n_channels(image.layout) == 3;
  for (int c = 0; c < 3; ++c) {
    const auto k = static_cast<std::size_t>(colour ? c : 0);
    result.factor[c] = std::exp(s[k]) / (factor * placed.intensity[static_cast<int>(k)]);
    result.factor_sigma[c] = std::sqrt(covariance(k, k));
  }
  result.falloff_exponent = s[3];
  result.falloff_sigma = fit_falloff ? std::sqrt(covariance(3, 3)) : 0;
  result.n_used = values.size();
  result.n_left_out = n_all - values.size();
  double sum = 0;
  for (const Value& v : values) sum += std::pow(v.measured / prediction(v, s) - 1, 2);
  result.rms = std::sqrt(sum / static_cast<double>(values.size()));
  return result;
}

ScaleEstimate estimate_scale(const acquire::Session& white, const Calibration& white_calibration, const Calibration& calibration, const ScaleReference& reference) {
  const acquire::CameraModel& camera = calibration.geometry.camera;
  const std::string name = (white.folder / "session.json").string();
  if (white.rig.geometry.camera.width != camera.width || white.rig.geometry.camera.height != camera.height)
    throw Error(ErrorCode::input, fmt::format("{}: {} x {} pixels; expected {} x {} as in the session to be scaled", name, white.rig.geometry.camera.width,
                                              white.rig.geometry.camera.height, camera.width, camera.height));
  const Response &a = white_calibration.response, &b = calibration.response;
  bool same = a.linear == b.linear && a.bits == b.bits && a.curves.size() == b.curves.size();
  for (std::size_t c = 0; same && !a.linear && c < a.curves.size(); ++c) same = a.curves[c].exposure == b.curves[c].exposure;
  if (!same) throw Error(ErrorCode::input, fmt::format("{}: merged with another response than the session to be scaled; their radiances have no common unit", name));

  ScaleEstimate estimate;
  for (std::size_t light = 0; light < calibration.geometry.lights.size(); ++light) {
    const auto view = std::find_if(white.views.begin(), white.views.end(), [&](const acquire::ViewRecord& v) { return v.light == static_cast<int>(light); });
    if (view == white.views.end()) throw Error(ErrorCode::input, fmt::format("{}: no view of light {}; expected one of each (lacquer capture --white-reference)", name, light));
    const double drift = white_calibration.light_factor(*view).factor;
    estimate.lights.push_back(light_scale(read_radiance(white.radiance_path(*view)), calibration, light, calibration.turntable_scale * view->turntable_angle, drift, reference));
  }
  double scatter = 0;
  for (const LightScale& l : estimate.lights)
    for (int c = 0; c < 3; ++c) scatter = std::max(scatter, l.factor_sigma[c]);
  estimate.sigma = std::sqrt(reference.sigma * reference.sigma + reference.light_sigma * reference.light_sigma + scatter * scatter);
  return estimate;
}

void apply_scale(const ScaleEstimate& estimate, const std::string& source, Calibration& calibration) {
  for (std::size_t l = 0; l < estimate.lights.size(); ++l) {
    acquire::Light& light = calibration.geometry.lights.at(l);
    light.intensity *= estimate.lights[l].factor;
    if (!light.distant) light.falloff_exponent = estimate.lights[l].falloff_exponent;
  }
  calibration.absolute_scale = true;
  calibration.scale_source = source;
  calibration.scale_sigma = estimate.sigma;
}

}  // namespace lacquer::calib
