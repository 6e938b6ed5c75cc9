#include "libcalib/sphere_outline.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <limits>

#include "libbrdf/error.h"
#include "libcalib/geometry_projection.h"
#include "libcalib/limb_profile.h"

namespace lacquer::calib {

namespace {

constexpr double pi = 3.14159265358979323846;

/// Where the silhouette crosses the ray from `centre` in the direction `outwards`, pixels from it; `start` is near it.
double radius_along(const acquire::RigGeometry& rig, const glm::dvec2& centre, const glm::dvec2& outwards, double start) {
  double radius = start;
  for (int i = 0; i < 20; ++i) radius -= silhouette_distance(rig, centre + radius * outwards).value_or(0);
  return radius;
}

}  // namespace

struct OutlineFinder::Implementation {
  acquire::RigGeometry nominal;
  OutlineOptions options;
  struct Pixel {
    std::uint32_t index;    ///< of the value in the image
    float distance;         ///< from the nominal silhouette; near enough for the coarse search
    std::uint16_t x, y;
    float sum, variance;    ///< variance < 0: not usable in one of the views
  };
  struct Arc {
    glm::dvec3 normal{0.0};    ///< of the limb
    glm::dvec2 outwards{0.0};  ///< from the image of the sphere's centre, unit
    double radius = 0;         ///< there, of the nominal silhouette
    std::vector<Pixel> pixels;
    std::size_t n_views = 0;
  };
  std::vector<Arc> arcs;
  glm::dvec2 centre{0.0};      ///< nominal
  acquire::PixelLayout layout = acquire::PixelLayout::mono;
  bool started = false;

  void start(const RadianceImage& image);
  void place_arcs();
  std::vector<EdgePoint> coarse_edges() const;
  std::vector<LimbValue> profile(const Arc& arc, const acquire::RigGeometry& geometry, double window) const;
  struct ArcFit {
    std::size_t arc;
    LimbFit fit;
  };
  std::vector<ArcFit> fit_arcs(const std::vector<std::vector<LimbValue>>& profiles, const BlurredLimb& limb, double reach) const;
  double find_blur(const acquire::RigGeometry& geometry) const;
};

OutlineFinder::OutlineFinder(const acquire::RigGeometry& nominal, const OutlineOptions& options)
    : implementation_(std::make_unique<Implementation>()) {
  if (nominal.camera.projection != acquire::CameraModel::Projection::pinhole)
    throw Error(ErrorCode::input, "camera: orthographic; the silhouette can be fitted for a pinhole camera only, keep the rig file's (--from-rig)");
  implementation_->nominal = nominal;
  implementation_->options = options;
  double& search = implementation_->options.search_px;
  if (search <= 0) search = 4 + 0.009 * nominal.camera.focal.x / nominal.cam_from_rig.translation.z;
}

OutlineFinder::~OutlineFinder() = default;

void OutlineFinder::Implementation::place_arcs() {
  const glm::dvec3& sphere = nominal.cam_from_rig.translation;
  const auto projected = nominal.camera.project(sphere);
  if (!projected) throw Error(ErrorCode::input, "rig geometry: the camera does not see the sphere; expected a pose that looks at it");
  centre = *projected;
  const double radius = nominal.camera.focal.x * std::tan(std::asin(nominal.sphere_radius / glm::length(sphere)));
  arcs.resize(static_cast<std::size_t>(std::max(24.0, 2 * pi * radius / options.arc_px)));
  const glm::dmat3 rig_from_cam = glm::transpose(nominal.cam_from_rig.rotation);
  for (std::size_t i = 0; i < arcs.size(); ++i) {
    const double a = 2 * pi * (static_cast<double>(i) + 0.5) / static_cast<double>(arcs.size());
    Arc& arc = arcs[i];
    arc.outwards = {std::cos(a), std::sin(a)};
    arc.radius = radius_along(nominal, centre, arc.outwards, radius);
    const auto ray = nominal.camera.unproject(centre + arc.radius * arc.outwards);
    // The line of sight touches the sphere where it comes nearest to the centre.
    if (ray) arc.normal = rig_from_cam * glm::normalize(ray->direction * glm::dot(ray->direction, sphere) - sphere);
  }
}

/// Assigns the pixels near the nominal silhouette to arcs.
void OutlineFinder::Implementation::start(const RadianceImage& image) {
  started = true;
  layout = image.layout;
  place_arcs();
  double largest = 0;
  for (const Arc& arc : arcs) largest = std::max(largest, arc.radius);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout)), n_arcs = arcs.size();
  const int green = acquire::n_channels(layout) == 3 ? 1 : 0;
  const double band = options.search_px + 8;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const glm::dvec2 offset = glm::dvec2(x, y) - centre;
      const double length = glm::length(offset);
      if (length > largest + band) continue;
      const double turn = (std::atan2(offset.y, offset.x) / (2 * pi) + 1) * static_cast<double>(n_arcs);
      Arc& arc = arcs[static_cast<std::size_t>(turn) % n_arcs];
      // Between the middles of two arcs.
      const auto before = static_cast<std::size_t>(turn - 0.5 + static_cast<double>(n_arcs));
      const double part = turn - 0.5 + static_cast<double>(n_arcs) - static_cast<double>(before);
      const double distance = length - (1 - part) * arcs[before % n_arcs].radius - part * arcs[(before + 1) % n_arcs].radius;
      if (std::abs(distance) > band) continue;
      for (std::size_t k = 0; k < per_pixel; ++k)
        if (acquire::channel_of(layout, x, y, static_cast<int>(k)) == green) {
          const std::size_t index = (static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x)) * per_pixel + k;
          arc.pixels.push_back({static_cast<std::uint32_t>(index), static_cast<float>(distance), static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y), 0, 0});
        }
    }
}

void OutlineFinder::add(const RadianceImage& image, const acquire::PlacedLight& light) {
  Implementation& m = *implementation_;
  if (!m.started) m.start(image);
  const glm::dvec3 to_camera = glm::transpose(m.nominal.cam_from_rig.rotation) * -glm::normalize(m.nominal.cam_from_rig.translation);
  if (glm::dot(light.direction, to_camera) < std::cos(m.options.max_light_angle)) return;
  tbb::parallel_for(std::size_t{0}, m.arcs.size(), [&](std::size_t i) {
    auto& arc = m.arcs[i];
    const glm::dvec3 wi = light.distant ? light.direction : glm::normalize(light.position - m.nominal.sphere_radius * arc.normal);
    if (glm::dot(arc.normal, wi) < m.options.min_cosine) return;
    ++arc.n_views;
    for (auto& pixel : arc.pixels) {
      const PixelFlag flag = image.flags[pixel.index];
      if (flag == PixelFlag::clipped || flag == PixelFlag::invalid) pixel.variance = -std::numeric_limits<float>::infinity();
      pixel.sum += image.radiance[pixel.index];
      pixel.variance += image.variance[pixel.index];
    }
  });
}

/// The steepest ascent of each arc's mean profile, in steps of a pixel.
std::vector<EdgePoint> OutlineFinder::Implementation::coarse_edges() const {
  std::vector<EdgePoint> edges;
  const int half = static_cast<int>(options.search_px) + 6;
  for (const Arc& arc : arcs) {
    if (arc.n_views == 0) continue;
    std::vector<double> sum(static_cast<std::size_t>(2 * half)), n(sum.size());
    for (const Pixel& p : arc.pixels) {
      const int bin = static_cast<int>(std::floor(p.distance)) + half;
      if (!(p.variance >= 0) || bin < 0 || bin >= 2 * half) continue;
      sum[static_cast<std::size_t>(bin)] += static_cast<double>(p.sum);
      n[static_cast<std::size_t>(bin)] += 1;
    }
    double steepest = 0;
    int where = 0;
    std::vector<double> rises;
    for (int i = 2; i + 2 < 2 * half; ++i) {
      const auto mean = [&](int from) {
        double s = 0, count = 0;
        for (int k = from; k < from + 2; ++k) {
          s += sum[static_cast<std::size_t>(k)];
          count += n[static_cast<std::size_t>(k)];
        }
        return count > 0 ? s / count : std::nan("");
      };
      const double rise = mean(i - 2) - mean(i);  // inside minus outside
      if (!std::isfinite(rise)) continue;
      rises.push_back(std::abs(rise));
      if (rise > steepest) {
        steepest = rise;
        where = i;
      }
    }
    if (rises.size() < 8) continue;
    std::nth_element(rises.begin(), rises.begin() + static_cast<std::ptrdiff_t>(rises.size() / 2), rises.end());
    if (steepest < 4 * rises[rises.size() / 2]) continue;
    edges.push_back({centre + arc.outwards * (arc.radius + static_cast<double>(where - half)), 0.7});
  }
  return edges;
}

std::vector<LimbValue> OutlineFinder::Implementation::profile(const Arc& arc, const acquire::RigGeometry& geometry, double window) const {
  std::vector<LimbValue> values;
  // Where the silhouette is now, along this arc's ray: pixels further from it than the window need no exact distance.
  const double moved = arc.radius - silhouette_distance(geometry, centre + arc.radius * arc.outwards).value_or(0);
  double level = 0;
  for (const Pixel& p : arc.pixels) {
    if (!(p.variance > 0) || std::abs(static_cast<double>(p.distance) + arc.radius - moved) > window + 8) continue;
    const auto distance = silhouette_distance(geometry, {p.x, p.y});
    if (!distance || std::abs(*distance) > window) continue;
    values.push_back({*distance, p.sum, p.variance});
    level = std::max(level, static_cast<double>(p.sum));
  }
  // The profile is a model: nobody believes it to better than this fraction of the step.
  for (LimbValue& v : values) v.variance += 1e-5 * level * level;
  return values;
}

/// All arcs with enough values, in parallel; a fit that is not good is kept as such.
std::vector<OutlineFinder::Implementation::ArcFit> OutlineFinder::Implementation::fit_arcs(const std::vector<std::vector<LimbValue>>& profiles,
                                                                                         const BlurredLimb& limb, double reach) const {
  std::vector<ArcFit> fits(arcs.size());
  tbb::parallel_for(std::size_t{0}, arcs.size(), [&](std::size_t i) {
    fits[i].arc = i;
    if (profiles[i].size() >= 24) fits[i].fit = fit_limb(profiles[i], limb, reach);
  });
  return fits;
}

/// The blur that all limbs together fit best: the least sum of n ln(cost), each arc with a noise of its own.
double OutlineFinder::Implementation::find_blur(const acquire::RigGeometry& geometry) const {
  constexpr double sharpest = 0.2, softest = 3, window = 5 + 4 * softest;
  std::vector<std::vector<LimbValue>> profiles(arcs.size());
  tbb::parallel_for(std::size_t{0}, arcs.size(), [&](std::size_t i) {
    if (arcs[i].n_views > 0) profiles[i] = profile(arcs[i], geometry, window);
  });
  const auto misfit = [&](double log_blur) {
    const BlurredLimb limb(std::sqrt(std::exp(2 * log_blur) + 1.0 / 12), window + 3);
    double sum = 0;
    for (const auto& [i, fit] : fit_arcs(profiles, limb, 2.5))
      if (fit.good) sum += static_cast<double>(profiles[i].size()) * (std::log(fit.reduced) - 30);  // an arc that is lost counts as a bad one
    return sum;
  };
  double low = std::log(sharpest), high = std::log(softest);
  constexpr double golden = 0.38196601125010515;
  double p = low + golden * (high - low), q = high - golden * (high - low), at_p = misfit(p), at_q = misfit(q);
  for (int i = 0; i < 10; ++i) {
    if (at_p < at_q) {
      high = q;
      q = p;
      at_q = at_p;
      at_p = misfit(p = low + golden * (high - low));
    } else {
      low = p;
      p = q;
      at_p = at_q;
      at_q = misfit(q = high - golden * (high - low));
    }
  }
  return std::exp(0.5 * (low + high));
}

OutlineFinder::Outline OutlineFinder::finish() const {
  const Implementation& m = *implementation_;
  Outline outline{.edges = {}, .geometry = m.nominal, .n_arcs = m.arcs.size()};
  for (const auto& arc : m.arcs) outline.n_dark += arc.n_views == 0;
  const std::vector<EdgePoint> coarse = m.coarse_edges();
  if (coarse.size() >= 8) outline.geometry = solve_geometry(m.nominal, coarse, {}).geometry;
  // Edges that do not lie on one sphere are those of something else, or of noise.
  const auto n_near = std::count_if(coarse.begin(), coarse.end(), [&](const EdgePoint& e) {
    return std::abs(silhouette_distance(outline.geometry, e.pixel).value_or(1e9)) < 3;
  });
  if (n_near < 8 || static_cast<double>(n_near) < 0.4 * static_cast<double>(coarse.size())) {
    outline.n_rejected = outline.n_arcs - outline.n_dark;
    outline.geometry = m.nominal;
    return outline;
  }
  outline.lens_blur_px = m.options.lens_blur_px > 0 ? m.options.lens_blur_px : m.find_blur(outline.geometry);
  const double blur = std::sqrt(outline.lens_blur_px * outline.lens_blur_px + 1.0 / 12), window = 5 + 4 * blur;
  const BlurredLimb limb(blur, window + 3);
  for (int pass = 0; pass < 2; ++pass) {
    std::vector<std::vector<LimbValue>> profiles(m.arcs.size());
    tbb::parallel_for(std::size_t{0}, m.arcs.size(), [&](std::size_t i) {
      if (m.arcs[i].n_views > 0) profiles[i] = m.profile(m.arcs[i], outline.geometry, window);
    });
    std::vector<EdgePoint> edges;
    for (const auto& [i, fit] : m.fit_arcs(profiles, limb, pass == 0 ? 2.5 : 1.5)) {
      if (!fit.good) continue;
      const auto& arc = m.arcs[i];
      const double radius = radius_along(outline.geometry, m.centre, arc.outwards, arc.radius);
      // The shift is along the normal of the silhouette, which on a ray from the centre is nearly the ray.
      double along = radius + fit.shift;
      for (int k = 0; k < 5; ++k) along -= silhouette_distance(outline.geometry, m.centre + along * arc.outwards).value_or(0) - fit.shift;
      edges.push_back({m.centre + along * arc.outwards, std::max(fit.sigma, 0.005)});
    }
    outline.edges = std::move(edges);
    if (outline.edges.size() < 8) break;
    outline.geometry = solve_geometry(m.nominal, outline.edges, {}).geometry;
  }
  outline.n_rejected = outline.n_arcs - outline.n_dark - std::min(outline.edges.size(), outline.n_arcs - outline.n_dark);
  if (outline.edges.size() < 8) outline.edges.clear(), outline.geometry = m.nominal;
  return outline;
}

}  // namespace lacquer::calib
