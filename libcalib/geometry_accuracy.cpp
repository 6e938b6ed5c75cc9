#include "libcalib/geometry_accuracy.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numeric>
#include <opencv2/core.hpp>

namespace lacquer::calib {

namespace {

constexpr double pi = 3.14159265358979323846;

double quadratic(const std::vector<double>& covariance, const std::vector<double>& v) {
  const std::size_t n = v.size();
  double sum = 0;
  for (std::size_t a = 0; a < n; ++a)
    for (std::size_t b = 0; b < n; ++b) sum += v[a] * covariance[a * n + b] * v[b];
  return sum;
}

/// What the samples will depend on, at one view: three components each.
struct Consequence {
  glm::dvec3 light;        ///< unit, from the sphere's centre, rig frame
  glm::dvec3 half;         ///< half vector minus normal at a fixed pixel
  double log_distance;
};

Consequence consequence(const acquire::RigGeometry& g, double turntable_scale, const GeometryEvidence::View& h, const glm::dvec2& pixel) {
  const glm::dvec3 light = g.place_light(h.light, h.turntable_angle * turntable_scale).position;
  Consequence c{glm::normalize(light), glm::dvec3(0), std::log(glm::length(light))};
  if (const auto point = acquire::trace(g, pixel)) c.half = glm::normalize(glm::normalize(light - point->position) + point->wo) - point->normal;
  return c;
}

/// A pixel whose sample a view may give: the first lit one of a sunflower's pattern over the sphere from number `first` on.
std::optional<glm::dvec2> sample_pixel(const acquire::RigGeometry& g, const glm::dvec3& light, std::size_t first) {
  constexpr std::size_t n = 60;
  constexpr double golden_angle = 2.3999632297286533, min_cosine = 0.0872;  // 85 degrees
  const auto centre = g.camera.project(g.cam_from_rig.translation);
  const double radius = g.camera.focal.x * g.sphere_radius / g.cam_from_rig.translation.z;
  for (std::size_t k = first; centre && k < first + n; ++k) {
    const double r = radius * std::sqrt((static_cast<double>(7 * k % n) + 0.5) / n), a = golden_angle * static_cast<double>(7 * k % n);
    const glm::dvec2 pixel = *centre + r * glm::dvec2(std::cos(a), std::sin(a));
    const auto point = acquire::trace(g, pixel);
    if (point && glm::dot(point->normal, point->wo) > min_cosine && glm::dot(point->normal, glm::normalize(light - point->position)) > min_cosine) return pixel;
  }
  return std::nullopt;
}

/// Directions of the unknowns in which the images say less than the prior and that move light directions or half vectors noticeably.
std::vector<std::string> weak_directions(const SymmetricMatrix& information, const SymmetricMatrix& from_images, const GeometryUnknowns& unknowns, const GeometryEffects& effect) {
  constexpr double noticeable = 0.01 * pi / 180;
  const auto n = static_cast<int>(unknowns.size());
  cv::Mat a(n, n, CV_64F), values, vectors;
  for (int r = 0; r < n; ++r)
    for (int c = 0; c < n; ++c) a.at<double>(r, c) = information(static_cast<std::size_t>(r), static_cast<std::size_t>(c));
  cv::eigen(a, values, vectors);
  std::vector<std::string> texts;
  for (int e = n - 1; e >= 0; --e) {
    std::vector<double> v(static_cast<std::size_t>(n));
    for (int k = 0; k < n; ++k) v[static_cast<std::size_t>(k)] = vectors.at<double>(e, k);
    if (2 * from_images.quadratic_form(0, v) >= values.at<double>(e)) continue;  // more than the prior says
    const auto alone = [&](const std::vector<std::vector<double>>& rows, double per_view) {
      double sum = 0;
      for (const auto& row : rows) sum += std::pow(std::inner_product(row.begin(), row.end(), v.begin(), 0.0), 2);
      return rows.empty() ? 0 : std::sqrt(sum * per_view / (values.at<double>(e) * static_cast<double>(rows.size())));
    };
    const double half = alone(effect.half, 3), light = alone(effect.light, 3), distance = alone(effect.distance, 1);
    if (half < noticeable && light < 2 * noticeable && distance < 0.003) continue;
    std::vector<std::size_t> order(v.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
    std::sort(order.begin(), order.end(), [&](std::size_t p, std::size_t q) { return std::abs(v[p]) > std::abs(v[q]); });
    std::string names;
    for (std::size_t k = 0; k < 3 && k < order.size() && std::abs(v[order[k]]) > 0.3; ++k)
      names += (names.empty() ? "" : " with ") + unknowns.parameters()[order[k]].name;
    texts.push_back(fmt::format("the images do not determine {}: only the rig file holds it, which leaves {:.2g} deg in the half vectors, {:.2g} deg "
                                "in the lights' directions, {:.2g} % in their distance",
                                names, half * 180 / pi, light * 180 / pi, 100 * distance));
  }
  return texts;
}

std::vector<std::string> plain_warnings(const GeometryResiduals& residuals, const acquire::RigGeometry& g) {
  std::vector<std::string> texts;
  const std::vector<Highlight>& highlights = residuals.highlights();
  if (std::count(residuals.edge_used().begin(), residuals.edge_used().end(), true) == 0)
    texts.push_back("no silhouette: the sphere's place comes from the highlights and the rig file alone");
  for (std::size_t light = 0; light < g.lights.size(); ++light) {
    double lowest = 1e9, highest = -1e9;
    std::size_t n = 0;
    for (std::size_t i = 0; i < highlights.size(); ++i) {
      if (highlights[i].light != light || !residuals.highlight_used()[i]) continue;
      lowest = std::min(lowest, highlights[i].turntable_angle);
      highest = std::max(highest, highlights[i].turntable_angle);
      ++n;
    }
    if (n == 0) {
      texts.push_back(fmt::format("light {}: no highlight: it stays where the rig file says", light + 1));
    } else if (n < 4 || (g.lights[light].on_arm && highest - lowest < 30 * pi / 180)) {
      texts.push_back(fmt::format("light {}: {} highlights over {:.3g} deg of the turntable: too few to tell axis, arm and light apart "
                                       "(expected at least 4 over 30 deg)", light + 1, n, (highest - lowest) * 180 / pi));
    }
  }
  return texts;
}

/// Numbers that came out further from the rig file than its ruler can be wrong. A wrong radius (or focal length) shows as a sphere at
/// another distance and in nothing else: the whole scene can be scaled without changing an image.
std::vector<std::string> contradictions(const GeometryUnknowns& unknowns, const acquire::RigGeometry& nominal, const std::vector<double>& x) {
  constexpr double many = 3;  // sigmas of the prior
  std::vector<std::string> texts;
  glm::dvec3 sphere;
  for (int k = 0; k < 3; ++k) sphere[k] = x[static_cast<std::size_t>(k)] * unknowns.parameters()[static_cast<std::size_t>(k)].prior_sigma;
  const double distance = glm::length(nominal.cam_from_rig.translation);
  const double nearer = -glm::dot(nominal.cam_from_rig.rotation * sphere, nominal.cam_from_rig.translation / distance);
  if (std::abs(nearer) > many * unknowns.parameters()[2].prior_sigma)
    texts.push_back(fmt::format("the sphere comes out {:.1f} mm {} than the rig file has it, {:.1f} sigma of its ruler: either it stands there, or its radius is really "
                                "{:.1f} % {} or the focal length wrong; images of one sphere cannot tell which, and distances would be wrong by as much",
                                1e3 * std::abs(nearer), nearer > 0 ? "nearer" : "farther", std::abs(nearer) / unknowns.parameters()[2].prior_sigma,
                                100 * std::abs(nearer) / distance, nearer > 0 ? "larger" : "smaller"));
  for (std::size_t k = 0; k < x.size(); ++k)
    if (std::abs(x[k]) > many && !(k < 3 && !texts.empty()))
      texts.push_back(fmt::format("{} comes out {:.1f} sigma of its prior from the rig file: the rig file is wrong there, or something that it is believed in",
                                  unknowns.parameters()[k].name, std::abs(x[k])));
  return texts;
}

}  // namespace

GeometryEffects geometry_effects(const GeometryResiduals& residuals, const std::vector<double>& x) {
  const GeometryUnknowns& unknowns = residuals.unknowns();
  std::vector<GeometryEvidence::View> views = residuals.evidence().views;
  if (views.empty())
    for (const Highlight& h : residuals.highlights()) views.push_back({h.light, h.turntable_angle});
  constexpr std::size_t max_views = 60;
  constexpr double step = 1e-3;
  GeometryEffects e;
  const acquire::RigGeometry g = unknowns.geometry(x);
  const std::size_t n = views.size(), stride = std::max<std::size_t>(1, n / max_views);
  struct Sampled {
    GeometryEvidence::View view;
    glm::dvec2 pixel;
  };
  std::vector<Sampled> sampled;
  for (std::size_t i = 0; i < n; i += stride)
    if (const auto lit = sample_pixel(g, g.place_light(views[i].light, views[i].turntable_angle * unknowns.turntable_scale(x)).position, i)) sampled.push_back({views[i], *lit});
  const std::vector<double> none(x.size());
  e.light.assign(3 * sampled.size(), none);
  e.half.assign(3 * sampled.size(), none);
  e.distance.assign(sampled.size(), none);
  tbb::parallel_for(std::size_t{0}, x.size(), [&](std::size_t k) {
    std::vector<double> up = x, down = x;
    up[k] += step;
    down[k] -= step;
    const acquire::RigGeometry above = unknowns.geometry(up), below = unknowns.geometry(down);
    const double scale_above = unknowns.turntable_scale(up), scale_below = unknowns.turntable_scale(down);
    for (std::size_t i = 0; i < sampled.size(); ++i) {
      const Consequence a = consequence(above, scale_above, sampled[i].view, sampled[i].pixel), b = consequence(below, scale_below, sampled[i].view, sampled[i].pixel);
      for (std::size_t c = 0; c < 3; ++c) {
        e.light[3 * i + c][k] = (a.light[static_cast<int>(c)] - b.light[static_cast<int>(c)]) / (2 * step);
        e.half[3 * i + c][k] = (a.half[static_cast<int>(c)] - b.half[static_cast<int>(c)]) / (2 * step);
      }
      e.distance[i][k] = (a.log_distance - b.log_distance) / (2 * step);
    }
  });
  return e;
}

double rms_effect(const std::vector<std::vector<double>>& rows, const std::vector<double>& covariance, double per_view) {
  double sum = 0;
  for (const auto& row : rows) sum += quadratic(covariance, row);
  return rows.empty() ? 0 : std::sqrt(sum * per_view / static_cast<double>(rows.size()));
}

std::vector<std::string> geometry_warnings(const GeometryResiduals& residuals, const acquire::RigGeometry& nominal, const std::vector<double>& x,
                                           const SymmetricMatrix& information, const SymmetricMatrix& from_images, const GeometryEffects& effects) {
  std::vector<std::string> texts = plain_warnings(residuals, nominal);
  for (std::string& text : contradictions(residuals.unknowns(), nominal, x)) texts.push_back(std::move(text));
  for (std::string& text : weak_directions(information, from_images, residuals.unknowns(), effects)) texts.push_back(std::move(text));
  return texts;
}

}  // namespace lacquer::calib
