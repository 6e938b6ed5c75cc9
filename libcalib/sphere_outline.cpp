#include "libcalib/sphere_outline.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "libbrdf/error.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

namespace {

constexpr double pi = 3.14159265358979323846;

struct Value {
  double distance;  ///< from the silhouette, pixels, > 0 outside
  double radiance, variance;
};

/// Mean of 1, sqrt(t)+, t+ (t: depth inside the silhouette) over a Gaussian of `sigma` at signed distance `d` (> 0 outside).
std::array<double, 3> blurred_limb(double d, double sigma) {
  constexpr int n = 24;  // midpoints in u = sqrt(depth), where the integrand is smooth
  std::array<double, 3> mean{};
  const double deepest = 5 * sigma - d, shallowest = std::max(0.0, -5 * sigma - d);
  if (!(deepest > 0)) return mean;
  const double u0 = std::sqrt(shallowest), u1 = std::sqrt(deepest);
  for (int i = 0; i < n; ++i) {
    const double u = u0 + (u1 - u0) * (i + 0.5) / n, t = u * u, z = (t + d) / sigma;
    const double weight = 2 * u * (u1 - u0) / n * std::exp(-0.5 * z * z) / (sigma * std::sqrt(2 * pi));
    mean[0] += weight;
    mean[1] += weight * u;
    mean[2] += weight * t;
  }
  return mean;
}

struct ProfileFit {
  double shift = 0, sigma = 0, cost = 0, step = 0, step_sigma = 0;
  bool good = false;
};

/// Least squares of background and limb profile for a silhouette at `shift`; cost in residuals over sigma.
struct LinearFit {
  double cost = 0, step = 0;
};
LinearFit fit_at(const std::vector<Value>& values, double shift, double blur) {
  SymmetricMatrix a(4);
  std::vector<double> b(4);
  double total = 0;
  std::vector<std::array<double, 4>> rows;
  for (const Value& v : values) {
    const auto limb = blurred_limb(v.distance - shift, blur);
    rows.push_back({1, limb[0], limb[1], limb[2]});
    const double w = 1 / v.variance;
    for (std::size_t r = 0; r < 4; ++r) {
      b[r] += w * rows.back()[r] * v.radiance;
      for (std::size_t c = 0; c <= r; ++c) a.at(r, c) += w * rows.back()[r] * rows.back()[c];
    }
    total += w * v.radiance * v.radiance;
  }
  const std::vector<double> x = solve(a, b);
  LinearFit fit;
  for (std::size_t i = 0; i < values.size(); ++i) {
    double r = values[i].radiance;
    for (std::size_t k = 0; k < 4; ++k) r -= x[k] * rows[i][k];
    fit.cost += r * r / values[i].variance;
  }
  fit.step = x[1] + x[2];  // one pixel inside
  return fit;
}

/// Shift of the silhouette by golden section; sigma from the curvature of the cost, scaled by the residuals.
ProfileFit fit_profile(const std::vector<Value>& values, double blur, double reach) {
  ProfileFit fit;
  double best = 0, best_cost = 1e300;
  constexpr int n_steps = 12;
  for (int i = -n_steps; i <= n_steps; ++i) {
    const double shift = reach * i / n_steps, cost = fit_at(values, shift, blur).cost;
    if (cost < best_cost) {
      best = shift;
      best_cost = cost;
    }
  }
  if (std::abs(best) > 0.95 * reach) return fit;
  double low = best - reach / n_steps, high = best + reach / n_steps;
  constexpr double golden = 0.38196601125010515;
  double p = low + golden * (high - low), q = high - golden * (high - low);
  double cost_p = fit_at(values, p, blur).cost, cost_q = fit_at(values, q, blur).cost;
  for (int i = 0; i < 24; ++i) {
    if (cost_p < cost_q) {
      high = q;
      q = p;
      cost_q = cost_p;
      p = low + golden * (high - low);
      cost_p = fit_at(values, p, blur).cost;
    } else {
      low = p;
      p = q;
      cost_p = cost_q;
      q = high - golden * (high - low);
      cost_q = fit_at(values, q, blur).cost;
    }
  }
  fit.shift = 0.5 * (low + high);
  constexpr double h = 0.05;
  const LinearFit here = fit_at(values, fit.shift, blur);
  const double curvature = (fit_at(values, fit.shift - h, blur).cost - 2 * here.cost + fit_at(values, fit.shift + h, blur).cost) / (h * h);
  if (!(curvature > 0)) return fit;
  const double reduced = std::max(1.0, here.cost / (static_cast<double>(values.size()) - 5));
  fit.sigma = std::sqrt(2 * reduced / curvature);
  fit.step = here.step;
  fit.good = fit.sigma < 0.5 && fit.step > 0;
  return fit;
}

}  // namespace

struct OutlineFinder::Implementation {
  acquire::RigGeometry nominal;
  OutlineOptions options;
  struct Pixel {
    std::uint32_t index;  ///< of the value in the image
    float distance;       ///< from the nominal silhouette
    glm::vec2 at;
    double sum = 0, variance = 0;
    bool bad = false;
  };
  struct Arc {
    glm::dvec3 normal{0.0};  ///< of the limb
    glm::dvec2 outwards{0.0};  ///< in the image, unit
    glm::dvec2 nominal_edge{0.0};
    std::vector<Pixel> pixels;
    std::size_t n_views = 0;
  };
  std::vector<Arc> arcs;
  acquire::PixelLayout layout = acquire::PixelLayout::mono;
  bool started = false;

  void start(const RadianceImage& image);
  acquire::RigGeometry fit_sphere(const std::vector<EdgePoint>& edges) const;
  std::vector<EdgePoint> coarse_edges() const;
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

/// Assigns the pixels near the nominal silhouette to arcs.
void OutlineFinder::Implementation::start(const RadianceImage& image) {
  started = true;
  layout = image.layout;
  const auto centre = nominal.camera.project(nominal.cam_from_rig.translation);
  const glm::dvec3 to_centre = glm::normalize(nominal.cam_from_rig.translation);
  const double radius = nominal.camera.focal.x * std::tan(std::asin(nominal.sphere_radius / glm::length(nominal.cam_from_rig.translation)));
  const auto n_arcs = static_cast<std::size_t>(std::max(24.0, 2 * pi * radius / options.arc_px));
  arcs.resize(n_arcs);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout));
  const int green = acquire::n_channels(layout) == 3 ? 1 : 0;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const glm::dvec2 offset = glm::dvec2(x, y) - *centre;
      if (std::abs(glm::length(offset) - radius) > 1.5 * options.search_px + 0.1 * radius) continue;
      const auto distance = silhouette_distance(nominal, {x, y});
      if (!distance || std::abs(*distance) > options.search_px + 8) continue;
      const double turn = std::atan2(offset.y, offset.x) / (2 * pi) + 1;
      Arc& arc = arcs[static_cast<std::size_t>(turn * static_cast<double>(n_arcs)) % n_arcs];
      for (std::size_t k = 0; k < per_pixel; ++k)
        if (acquire::channel_of(layout, x, y, static_cast<int>(k)) == green) {
          const std::size_t index = (static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x)) * per_pixel + k;
          arc.pixels.push_back({static_cast<std::uint32_t>(index), static_cast<float>(*distance), glm::vec2(x, y)});
        }
    }
  const glm::dmat3 rig_from_cam = glm::transpose(nominal.cam_from_rig.rotation);
  for (std::size_t i = 0; i < n_arcs; ++i) {
    const double a = 2 * pi * (static_cast<double>(i) + 0.5) / static_cast<double>(n_arcs);
    arcs[i].outwards = {std::cos(a), std::sin(a)};
    arcs[i].nominal_edge = *centre + radius * arcs[i].outwards;
    const glm::dvec3 side(arcs[i].outwards, 0);
    arcs[i].normal = rig_from_cam * glm::normalize(side - to_centre * glm::dot(side, to_centre));
  }
}

void OutlineFinder::add(const RadianceImage& image, const acquire::PlacedLight& light) {
  Implementation& m = *implementation_;
  if (!m.started) m.start(image);
  const glm::dvec3 to_camera = glm::transpose(m.nominal.cam_from_rig.rotation) * -glm::normalize(m.nominal.cam_from_rig.translation);
  if (glm::dot(light.direction, to_camera) < std::cos(m.options.max_light_angle)) return;
  for (auto& arc : m.arcs) {
    const glm::dvec3 wi = light.distant ? light.direction : glm::normalize(light.position - m.nominal.sphere_radius * arc.normal);
    if (glm::dot(arc.normal, wi) < m.options.min_cosine) continue;
    ++arc.n_views;
    for (auto& pixel : arc.pixels) {
      const PixelFlag flag = image.flags[pixel.index];
      if (flag == PixelFlag::clipped || flag == PixelFlag::invalid) {
        pixel.bad = true;
        continue;
      }
      pixel.sum += image.radiance[pixel.index];
      pixel.variance += image.variance[pixel.index];
    }
  }
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
      if (p.bad || bin < 0 || bin >= 2 * half) continue;
      sum[static_cast<std::size_t>(bin)] += p.sum;
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
    edges.push_back({arc.nominal_edge + arc.outwards * static_cast<double>(where - half), 0.7});
  }
  return edges;
}

acquire::RigGeometry OutlineFinder::Implementation::fit_sphere(const std::vector<EdgePoint>& edges) const {
  return solve_geometry(nominal, edges, {}).geometry;
}

OutlineFinder::Outline OutlineFinder::finish() const {
  const Implementation& m = *implementation_;
  Outline outline{.edges = {}, .geometry = m.nominal, .n_arcs = m.arcs.size()};
  for (const auto& arc : m.arcs) outline.n_dark += arc.n_views == 0;
  const std::vector<EdgePoint> coarse = m.coarse_edges();
  if (coarse.size() < 8) {
    outline.n_rejected = outline.n_arcs - outline.n_dark;
    return outline;
  }
  outline.geometry = m.fit_sphere(coarse);
  const double blur = std::sqrt(m.options.lens_blur_px * m.options.lens_blur_px + 1.0 / 12), window = 5 + 4 * blur;
  for (int pass = 0; pass < 2; ++pass) {
    std::vector<EdgePoint> edges;
    for (const auto& arc : m.arcs) {
      if (arc.n_views == 0) continue;
      std::vector<Value> values;
      double level = 0;
      for (const auto& p : arc.pixels) {
        if (p.bad || !(p.variance > 0)) continue;
        const auto distance = silhouette_distance(outline.geometry, glm::dvec2(p.at));
        if (!distance || std::abs(*distance) > window) continue;
        values.push_back({*distance, p.sum, p.variance});
        level = std::max(level, p.sum);
      }
      if (values.size() < 24) continue;
      // The profile is a model: nobody believes it to better than this fraction of the step.
      for (Value& v : values) v.variance += 1e-5 * level * level;
      const ProfileFit fit = fit_profile(values, blur, pass == 0 ? 2.5 : 1.5);
      if (!fit.good) continue;
      const auto centre = outline.geometry.camera.project(outline.geometry.cam_from_rig.translation);
      const glm::dvec2 outwards = arc.outwards;
      // On the ray from the nominal centre: walk to the distance `shift`, which is along the normal of the silhouette.
      glm::dvec2 pixel = *centre + outwards * glm::length(arc.nominal_edge - *centre);
      for (int i = 0; i < 20; ++i) pixel -= outwards * (silhouette_distance(outline.geometry, pixel).value_or(0) - fit.shift);
      edges.push_back({pixel, std::max(fit.sigma, 0.005)});
    }
    outline.edges = std::move(edges);
    if (outline.edges.size() < 8) break;
    outline.geometry = m.fit_sphere(outline.edges);
  }
  outline.n_rejected = outline.n_arcs - outline.n_dark - std::min(outline.edges.size(), outline.n_arcs - outline.n_dark);
  if (outline.edges.size() < 8) outline.edges.clear(), outline.geometry = m.nominal;
  return outline;
}

}  // namespace lacquer::calib
