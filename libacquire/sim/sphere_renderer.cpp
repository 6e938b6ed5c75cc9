#include "libacquire/sim/sphere_renderer.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>

#include "libbrdf/error.h"

namespace lacquer::acquire::sim {

namespace {

// Errors are relative to the pixel's radiance, but never to less than this fraction of the lit sphere's mean: nobody measures there.
constexpr double dark_fraction = 1e-3;
// A pixel whose centre value is off by less than this takes its mean from its neighbours' second differences: what is left is of its square.
constexpr double smooth_enough = 5e-4;
constexpr int silhouette_lines = 12;

double sum(const glm::dvec3& c) { return c.r + c.g + c.b; }

template <typename Body>
void for_rows(int height, const Body& body) {
  tbb::parallel_for(tbb::blocked_range<int>(0, height, 4), [&](const tbb::blocked_range<int>& rows) {
    for (int y = rows.begin(); y != rows.end(); ++y) body(y);
  });
}

/// Distance of the line of sight from the sphere's centre in radii; infinite where there is no line of sight.
double relative_miss_distance(const RigGeometry& rig, const glm::dvec2& pixel) {
  const auto ray = rig.camera.unproject(pixel);
  if (!ray) return std::numeric_limits<double>::infinity();
  const glm::dvec3 from_centre = ray->origin - rig.cam_from_rig.translation;  // camera frame; the centre is the rig's origin
  const double along = glm::dot(from_centre, ray->direction);
  const bool perspective = rig.camera.projection == CameraModel::Projection::pinhole;
  if (perspective && !(-along > 0)) return std::numeric_limits<double>::infinity();
  return glm::length(from_centre - along * ray->direction) / rig.sphere_radius;
}

/// Part of a line through a pixel, coordinates in [-1/2, 1/2], that lies on the sphere: from the silhouette, or the end nearest to it,
/// inwards. Empty: both ends equal.
struct CoveredPart {
  double rim, inner;
};

/// From the distance (in radii) of the line of sight at -1/2, 0 and 1/2. A parabola through the three is exact to (pixel / radius)^2.
CoveredPart covered_part(double before, double middle, double after) {
  const double outer = before > after ? -0.5 : 0.5, inner = -outer;
  if (!(std::min(before, after) < 1)) return {inner, inner};
  if (std::max(before, after) <= 1) return {outer, inner};
  const double slope = after - before, bend = 2 * (before - 2 * middle + after);
  if (!std::isfinite(slope + bend)) return {middle < 1 ? 0.0 : inner, inner};
  double t = (1 - middle) / slope;
  for (int i = 0; i < 3; ++i) t = std::clamp((1 - middle - bend * t * t) / slope, -0.5, 0.5);
  return {t, inner};
}

}  // namespace

glm::dvec3 defined_value(const brdf::Brdf& paint, const brdf::Directions& d) {
  if (const auto value = paint.value(d)) return *value;
  const auto shrink = [](const glm::dvec3& w, double factor) {
    return brdf::direction(factor * std::atan2(std::hypot(w.x, w.y), w.z), std::atan2(w.y, w.x));
  };
  constexpr int n_steps = 32;
  for (int i = 1; i < n_steps; ++i) {
    const double factor = 1 - static_cast<double>(i) / n_steps;
    if (const auto value = paint.value({shrink(d.wi, factor), shrink(d.wo, factor)})) return *value;
  }
  return glm::dvec3(0.0);
}

/// Radiance at the pixels' centres and what is known about them.
struct SphereRenderer::FirstPass {
  enum class Kind : std::uint8_t { dark, plain, mirror, terminator };
  std::vector<glm::dvec3> centre;
  std::vector<Kind> kind;
  double floor = 0;                ///< radiance (sum of channels) below which errors do not count
  double emitter_in_pixels = 0;    ///< shift of the highlight from the emitter's centre to its rim, pixels
  double emitter_angle = 0;        ///< radius of the emitter seen from the sphere, radians
};

SphereRenderer::SphereRenderer(const RigGeometry& rig, std::shared_ptr<const brdf::Brdf> paint, int n_channels)
    : rig_(rig), paint_(std::move(paint)), n_channels_(n_channels) {
  orders_ = {{square_rule(2), disc_rule(1, 4)},
             {square_rule(3), disc_rule(2, 8)},
             {square_rule(5), disc_rule(3, 12)},
             {square_rule(8), disc_rule(4, 16)}};
  terminator_order_ = {square_rule(4), disc_rule(1, 4)};
  silhouette_nodes_ = line_rule(4);
  const double depth = rig_.cam_from_rig.translation.z;
  const double pixels_per_metre = std::max(rig_.camera.focal.x, rig_.camera.focal.y) /
                                  (rig_.camera.projection == CameraModel::Projection::pinhole ? depth : 1);
  normal_per_pixel_ = 1 / (pixels_per_metre * rig_.sphere_radius);
  classify_pixels();
}

void SphereRenderer::classify_pixels() {
  const int width = rig_.camera.width, height = rig_.camera.height;
  const auto index = [width](int x, int y) { return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x); };
  std::vector<double> distance(index(0, height));
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) distance[index(x, y)] = relative_miss_distance(rig_, {x, y});
  });
  coverage_.assign(distance.size(), Coverage::outside);
  for_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      const double d = distance[index(x, y)];
      // Largest change from the centre to a corner, from the steps to the neighbours; 10 % more for the silhouette's curvature.
      const double next_x = std::abs(d - distance[index(x > 0 ? x - 1 : std::min(x + 1, width - 1), y)]);
      const double next_y = std::abs(d - distance[index(x, y > 0 ? y - 1 : std::min(y + 1, height - 1))]);
      const double to_corner = 0.55 * (next_x + next_y);
      Coverage& c = coverage_[index(x, y)];
      if (std::isfinite(to_corner)) {
        c = std::abs(d - 1) <= to_corner ? Coverage::edge : d < 1 ? Coverage::inside : Coverage::outside;
      } else if (std::isfinite(d) && d < 1.1) {
        c = Coverage::edge;
      }
    }
  });
  if (std::all_of(coverage_.begin(), coverage_.end(), [](Coverage c) { return c == Coverage::outside; }))
    throw Error(ErrorCode::input, "rig geometry: no pixel of the camera sees the sphere; expected a pose that looks at it");
}

glm::dvec3 SphereRenderer::reflected(const PlacedLight& light, const SurfacePoint& point, const glm::dvec2& on_emitter) const {
  const auto lit = illuminate(light, point, on_emitter);
  if (!lit) return glm::dvec3(0.0);
  const LocalDirections local = to_shading_frame(point, lit->wi);
  const glm::dvec3 f = defined_value(*paint_, {local.wi, local.wo});
  if (n_channels_ == 3) return f * lit->irradiance;
  return glm::dvec3(glm::dot(f, glm::dvec3(0.2126, 0.7152, 0.0722)) * lit->irradiance.r);
}

glm::dvec3 SphereRenderer::radiance(const PlacedLight& light, const glm::dvec2& pixel, const glm::dvec2& on_emitter) const {
  const auto point = trace(rig_, pixel);
  return point ? reflected(light, *point, on_emitter) : glm::dvec3(0.0);
}

void SphereRenderer::first_pass_pixel(const PlacedLight& light, int x, int y, FirstPass& pass) const {
  using Kind = FirstPass::Kind;
  const std::size_t i = static_cast<std::size_t>(y) * static_cast<std::size_t>(rig_.camera.width) + static_cast<std::size_t>(x);
  if (coverage_[i] == Coverage::outside) return;
  const auto point = trace(rig_, {x, y});
  if (!point) return;
  const glm::dvec3 wi = light.distant ? light.direction : glm::normalize(light.position - point->position);
  const double cos_o = std::max(glm::dot(point->normal, point->wo), 0.05);
  const double normal_step = normal_per_pixel_ / cos_o;  // radians per pixel towards the silhouette, where the sphere is foreshortened
  if (std::abs(glm::dot(point->normal, wi)) < normal_step + pass.emitter_angle) {
    pass.kind[i] = Kind::terminator;
  } else {
    const glm::dvec3 h = glm::normalize(wi + point->wo);
    const double off_mirror = glm::length(glm::cross(point->normal, h));
    pass.kind[i] = off_mirror < 3 * normal_step + pass.emitter_angle ? Kind::mirror : Kind::plain;
  }
  pass.centre[i] = reflected(light, *point, glm::dvec2(0.0));
}

void SphereRenderer::refuse_paint() const {
  throw Error(ErrorCode::input, fmt::format("{}: a value is not finite, expected a BRDF in 1/sr", paint_->description()));
}

SphereRenderer::FirstPass SphereRenderer::first_pass(const PlacedLight& light) const {
  FirstPass pass;
  pass.centre.assign(coverage_.size(), glm::dvec3(0.0));
  pass.kind.assign(coverage_.size(), FirstPass::Kind::dark);
  if (!light.distant) {
    const double distance = std::max(glm::length(light.position) - rig_.sphere_radius, 1e-3 * rig_.sphere_radius);
    pass.emitter_angle = 0.5 * light.diameter / distance;
    pass.emitter_in_pixels = 0.5 * pass.emitter_angle / normal_per_pixel_;
  }
  for_rows(rig_.camera.height, [&](int y) {
    for (int x = 0; x < rig_.camera.width; ++x) first_pass_pixel(light, x, y, pass);
  });
  double total = 0;
  std::size_t n_lit = 0;
  for (const glm::dvec3& c : pass.centre) {
    total += sum(c);
    n_lit += sum(c) > 0;
  }
  if (!std::isfinite(total)) refuse_paint();
  pass.floor = n_lit > 0 ? dark_fraction * total / static_cast<double>(n_lit) : 0;
  return pass;
}

SphereRenderer::PixelMean SphereRenderer::mean_by_quadrature(const PlacedLight& light, int x, int y, const Order& order) const {
  const double emitter_radius = 0.5 * light.diameter;
  PixelMean result{glm::dvec3(0.0), std::numeric_limits<double>::infinity(), 0};
  for (const PlaneNode& node : order.pixel) {
    glm::dvec3 here(0.0);
    if (const auto point = trace(rig_, glm::dvec2(x, y) + node.at)) {
      if (emitter_radius == 0) {
        here = reflected(light, *point, glm::dvec2(0.0));
      } else {
        for (const PlaneNode& source : order.emitter) here += source.weight * reflected(light, *point, emitter_radius * source.at);
      }
    }
    result.mean += node.weight * here;
    result.least = std::min(result.least, sum(here));
    result.most = std::max(result.most, sum(here));
  }
  return result;
}

glm::dvec3 SphereRenderer::mean_of_smooth_pixel(const PlacedLight& light, int x, int y, const glm::dvec3& centre, double floor) const {
  // Error of the 2 x 2 rule, relative, for a Gaussian: 0.4 times the square of that of the centre value (hence 3 %), and g^4 / 4320 on a
  // flank of logarithmic slope g per pixel, which shows as a ratio of exp(0.58 g) between the nodes (hence 2).
  constexpr double agreement_with_centre = 0.03, steepest = 2;
  // The difference of two orders is about the error of the lower one, and that of the higher one is far smaller.
  constexpr double agreement_of_orders = 0.01;
  const PixelMean first = mean_by_quadrature(light, x, y, orders_.front());
  const double scale = std::max(sum(first.mean), floor);
  if (std::abs(sum(first.mean - centre)) <= agreement_with_centre * scale && first.most <= steepest * std::max(first.least, floor))
    return first.mean;
  glm::dvec3 previous = first.mean;
  for (std::size_t i = 1; i < orders_.size(); ++i) {
    const glm::dvec3 mean = mean_by_quadrature(light, x, y, orders_[i]).mean;
    const double difference = std::abs(sum(mean - previous));
    previous = mean;
    if (difference <= agreement_of_orders * std::max(sum(mean), floor)) break;
  }
  return previous;
}

glm::dvec3 SphereRenderer::mean_of_silhouette_pixel(const PlacedLight& light, int x, int y) const {
  const glm::dvec2 pixel(x, y);
  const auto distance = [&](const glm::dvec2& offset) { return relative_miss_distance(rig_, pixel + offset); };
  const double slope_x = std::abs(distance({0.5, 0}) - distance({-0.5, 0})), slope_y = std::abs(distance({0, 0.5}) - distance({0, -0.5}));
  const bool along_x = !(slope_x < slope_y);  // lines cross the silhouette as squarely as they can
  const auto offset = [&](double along, double across) { return along_x ? glm::dvec2(along, across) : glm::dvec2(across, along); };

  glm::dvec3 total(0.0);
  for (int line = 0; line < silhouette_lines; ++line) {
    const double across = (line + 0.5) / silhouette_lines - 0.5;
    const auto covered = covered_part(distance(offset(-0.5, across)), distance(offset(0, across)), distance(offset(0.5, across)));
    // Near the silhouette the normal turns with the square root of the distance from it: nodes in the root make that smooth.
    for (std::size_t k = 0; k < silhouette_nodes_.size(); ++k) {
      const auto& [root, weight] = silhouette_nodes_[k];
      const double along = covered.rim + (covered.inner - covered.rim) * root * root;
      // Each node meets every point of the emitter's rule once in four lines.
      const PlaneNode& source = orders_.front().emitter[(k + static_cast<std::size_t>(line)) % orders_.front().emitter.size()];
      total += weight * 2 * root * std::abs(covered.inner - covered.rim) *
               radiance(light, pixel + offset(along, across), 0.5 * light.diameter * source.at);
    }
  }
  return total / static_cast<double>(silhouette_lines);
}

glm::dvec3 SphereRenderer::pixel_mean(const PlacedLight& light, int x, int y, const FirstPass& pass) const {
  using Kind = FirstPass::Kind;
  const int width = rig_.camera.width;
  const auto index = [width](int px, int py) { return static_cast<std::size_t>(py) * static_cast<std::size_t>(width) + static_cast<std::size_t>(px); };
  const std::size_t i = index(x, y);
  if (coverage_[i] == Coverage::outside) return glm::dvec3(0.0);
  if (coverage_[i] == Coverage::edge) return mean_of_silhouette_pixel(light, x, y);
  if (pass.kind[i] == Kind::terminator) return mean_by_quadrature(light, x, y, terminator_order_).mean;
  const glm::dvec3& centre = pass.centre[i];
  if (pass.kind[i] == Kind::mirror) return mean_of_smooth_pixel(light, x, y, centre, pass.floor);

  // Mean minus centre value of a smooth function: (d2f/dx2 + d2f/dy2) / 24 over a pixel, r^2 / 8 of that sum over a disc of radius r.
  const auto second_difference = [&](std::size_t before, std::size_t after) { return pass.centre[before] - 2.0 * centre + pass.centre[after]; };
  const glm::dvec3 bend_x = second_difference(index(std::max(x - 1, 0), y), index(std::min(x + 1, width - 1), y)),
                   bend_y = second_difference(index(x, std::max(y - 1, 0)), index(x, std::min(y + 1, rig_.camera.height - 1)));
  const double part = 1.0 / 24 + pass.emitter_in_pixels * pass.emitter_in_pixels / 8;
  const double correction = (std::abs(sum(bend_x)) + std::abs(sum(bend_y))) * part;
  if (correction <= smooth_enough * std::max(sum(centre), pass.floor)) return centre + part * (bend_x + bend_y);
  return mean_of_smooth_pixel(light, x, y, centre, pass.floor);
}

RadianceImage SphereRenderer::render(const PlacedLight& light) const {
  const FirstPass pass = first_pass(light);
  RadianceImage image(rig_.camera.width, rig_.camera.height, n_channels_);
  for_rows(image.height, [&](int y) {
    for (int x = 0; x < image.width; ++x) {
      const glm::dvec3 mean = pixel_mean(light, x, y, pass);
      for (int c = 0; c < n_channels_; ++c) image.at(c, x, y) = static_cast<float>(mean[c]);
    }
  });
  if (!std::all_of(image.data.begin(), image.data.end(), [](float v) { return std::isfinite(v); })) refuse_paint();
  return image;
}

}  // namespace lacquer::acquire::sim
