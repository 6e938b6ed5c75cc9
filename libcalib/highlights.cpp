#include "libcalib/highlights.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "libcalib/geometry_projection.h"
#include "libcalib/highlight_window.h"
#include "libcalib/lobe_fit.h"

namespace lacquer::calib {

namespace {

constexpr double pi = 3.14159265358979323846;
constexpr double reach = 2.9;        // of the fit's window, sigmas
constexpr double inner_reach = 1.9;  // of a second fit: a lobe that is not symmetric has another centre there
constexpr double max_asymmetry = 0.25;
constexpr double max_elongation = 0.5, usual_elongation = 0.01;  // of the lobe's variance

double determinant_of_slope(const ExpectedHighlight& e) { return std::abs(glm::determinant(e.slope_per_pixel)); }

/// Does the window of the fit reach beyond the image, or to where the sphere turns away?
std::optional<HighlightFate> cut(const acquire::RigGeometry& rig, const glm::dvec2& centre, const glm::dmat2& spread_px) {
  const glm::dvec2 half(reach * std::sqrt(spread_px[0][0]), reach * std::sqrt(spread_px[1][1]));
  if (centre.x - half.x < 0 || centre.y - half.y < 0 || centre.x + half.x > rig.camera.width - 1 || centre.y + half.y > rig.camera.height - 1)
    return HighlightFate::border;
  for (int k = 0; k < 16; ++k) {
    const double a = 2 * pi * k / 16;
    const auto p = acquire::trace(rig, centre + half * glm::dvec2(std::cos(a), std::sin(a)));
    if (!p || glm::dot(p->normal, p->wo) < 0.15) return HighlightFate::silhouette;
  }
  return std::nullopt;
}

}  // namespace

std::string describe(HighlightFate fate) {
  switch (fate) {
    case HighlightFate::found: return "found";
    case HighlightFate::hidden: return "hidden behind the sphere";
    case HighlightFate::silhouette: return "at the silhouette";
    case HighlightFate::border: return "at the image's border";
    case HighlightFate::clipped: return "clipped in every exposure";
    case HighlightFate::matte: return "no mirror peak";
    case HighlightFate::two_peaks: return "two peaks";
    case HighlightFate::poor: return "peak without a clear centre";
  }
  return "";
}

HighlightResult find_highlight(const RadianceImage& image, const Calibration& calibration, std::size_t light, double turntable_angle,
                               const HighlightOptions& options, const glm::ivec2& corner) {
  const acquire::RigGeometry& rig = calibration.geometry;
  HighlightResult result;
  const auto reject = [&](HighlightFate fate) {
    result.fate = fate;
    return result;
  };
  const auto placed = rig.place_light(light, calibration.turntable_scale * turntable_angle);
  if (!mirror_pixel(rig, placed.distant ? 1e7 * rig.sphere_radius * placed.direction : placed.position)) return result;
  const auto expected = expect_highlight(rig, placed);
  if (!expected || glm::dot(expected->point.normal, expected->point.wo) < options.min_cosine) return reject(HighlightFate::silhouette);

  // The normal turns about this much per pixel where it turns slowest: the search region in pixels.
  const double slowest = std::min(glm::length(expected->slope_per_pixel[0]), glm::length(expected->slope_per_pixel[1]));
  const double search_px = std::max(6.0, options.search_rad / slowest);
  const HighlightWindow near = collect_window(image, corner, calibration, *expected, expected->pixel, search_px, 0.15);
  const PeakMap map(near.values);
  const auto peak = map.brightest(expected->pixel, 0);
  if (!peak) return reject(near.cut_by_border ? HighlightFate::border : HighlightFate::silhouette);
  if (peak->height < 1.2 * map.level()) return reject(HighlightFate::matte);

  // 1/e radius of a Gaussian with the area above half, of which the mean over 3 x 3 pixels adds 4/3.
  const double det = determinant_of_slope(*expected);
  const double radius2_px = std::max(static_cast<double>(map.area_above_half(*peak)) / (pi * 0.693147) - 4.0 / 3, 0.25), radius_px = std::sqrt(radius2_px);
  if (radius_px * std::sqrt(det) > options.max_width_rad || radius_px > 0.7 * search_px) return reject(HighlightFate::matte);
  const double blur2 = 2 * (calibration.lens_blur_px * calibration.lens_blur_px + 1.0 / 12);
  const double width2 = det * std::max(radius2_px - blur2, 0.02 * radius2_px);

  const double window_px = 5 + 4 * std::sqrt(radius2_px * det) / slowest;
  const HighlightWindow window = collect_window(image, corner, calibration, *expected, peak->pixel, window_px, 0.12);
  const LobeFit fit = fit_lobe(window.values, *expected, {peak->pixel - expected->pixel, width2, reach, calibration.lens_blur_px});
  double base = 0, height = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    base += fit.base[c];
    height += fit.height[c];
  }
  result.width_rad = std::sqrt(std::exp(fit.log_width2));
  result.contrast = height / std::max(base, 1e-9 * std::abs(height));
  const glm::dvec2 centre = expected->pixel + fit.shift;
  if (fit.n_clipped > 0 && 3 * fit.n_clipped > fit.n) return reject(HighlightFate::clipped);
  if (!fit.good) return reject(HighlightFate::poor);
  if (!(height > 0) || result.contrast < options.min_contrast || result.width_rad > options.max_width_rad) return reject(HighlightFate::matte);
  if (const auto fate = cut(rig, centre, fit.spread_px)) return reject(*fate);

  const double sigma_px = std::sqrt(std::max(fit.spread_px[0][0], fit.spread_px[1][1]));
  const auto second = map.brightest(centre, 1.5 + 2.5 * sigma_px);
  if (second && second->height - map.level() > 0.5 * (peak->height - map.level()) && second->height > 1.5 * map.level())
    return reject(HighlightFate::two_peaks);
  const LobeFit inner = fit_lobe(window.values, *expected, {fit.shift, std::exp(fit.log_width2), inner_reach, calibration.lens_blur_px});
  const glm::dvec2 pull = inner.good ? inner.shift - fit.shift : glm::dvec2(0.0);
  result.asymmetry = glm::length(pull) / sigma_px;
  result.elongation = fit.elongation;
  if (result.asymmetry > max_asymmetry || result.elongation > max_elongation) return reject(HighlightFate::two_peaks);
  // Less of it, but more than noise explains, is an error of the centre that the residuals do not tell: a lobe merged with a weak rival is
  // pulled by about its elongation.
  const double squared = glm::dot(pull, pull), by_noise = 4 * (inner.covariance[0][0] + inner.covariance[1][1]);
  const double stretched = std::max(0.0, fit.elongation - usual_elongation) * sigma_px;
  const glm::dmat2 covariance =
      fit.covariance + (squared > by_noise ? (1 - by_noise / squared) * glm::outerProduct(pull, pull) : glm::dmat2(0.0)) + glm::dmat2(stretched * stretched);
  result.left_out = fit.left_out;
  result.fate = HighlightFate::found;
  const double least = 1e-6;  // (0.001 px)^2
  result.highlight = {"", light, turntable_angle, centre, covariance[0][0] + least, covariance[0][1], covariance[1][1] + least};
  return result;
}

}  // namespace lacquer::calib
