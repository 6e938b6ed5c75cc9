#include "libcalib/highlights.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat2x2.hpp>
#include <glm/matrix.hpp>
#include <vector>

#include "libcalib/response_algebra.h"
#include "libcalib/samples.h"

namespace lacquer::calib {

namespace {

/// One value of the image near the peak, with what is known of its place.
struct Value {
  glm::dvec2 pixel;
  glm::dvec2 slope;       ///< of the half vector against the normal, in the tangent plane of the expected peak
  double radiance, variance;
  double diffuse, mirror; ///< factors on body colour and lobe: irradiance, lens, cosines
  int channel;
  PixelFlag flag;
};

struct Frame {
  glm::dvec3 n, u, v;
};

Frame frame_about(const glm::dvec3& n) {
  const glm::dvec3 u = glm::normalize(glm::cross(std::abs(n.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0), n));
  return {n, u, glm::cross(n, u)};
}

struct Place {
  acquire::SurfacePoint point;
  glm::dvec3 wi;
  glm::dvec2 slope;
  double falloff;  ///< irradiance on a surface that faces the light, relative
};

std::optional<Place> place_at(const acquire::RigGeometry& rig, const acquire::PlacedLight& light, const Frame& f, const glm::dvec2& pixel) {
  const auto point = acquire::trace(rig, pixel);
  if (!point) return std::nullopt;
  const auto lit = acquire::illuminate(light, *point);
  if (!lit) return std::nullopt;
  const double cosine = glm::dot(point->normal, lit->wi);
  const glm::dvec3 h = glm::normalize(lit->wi + point->wo), s = h / glm::dot(h, point->normal) - point->normal;
  return Place{*point, lit->wi, {glm::dot(s, f.u), glm::dot(s, f.v)}, lit->irradiance[1] / (light.intensity[1] * cosine)};
}

/// Change of the slope per pixel, at a pixel.
std::optional<glm::dmat2> slope_per_pixel(const acquire::RigGeometry& rig, const acquire::PlacedLight& light, const Frame& f, const glm::dvec2& pixel) {
  const auto right = place_at(rig, light, f, pixel + glm::dvec2(0.5, 0)), left = place_at(rig, light, f, pixel - glm::dvec2(0.5, 0));
  const auto below = place_at(rig, light, f, pixel + glm::dvec2(0, 0.5)), above = place_at(rig, light, f, pixel - glm::dvec2(0, 0.5));
  if (!right || !left || !below || !above) return std::nullopt;
  return glm::dmat2(right->slope - left->slope, below->slope - above->slope);  // columns: d slope / dx, d slope / dy
}

struct Region {
  std::vector<Value> values;
  bool cut_by_border = false, cut_by_silhouette = false;
};

Region collect(const RadianceImage& image, const Calibration& calibration, const acquire::PlacedLight& light, const Frame& f,
               const glm::dvec2& about, double radius_px, double min_cosine) {
  const acquire::RigGeometry& rig = calibration.geometry;
  Region region;
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
  const int x0 = static_cast<int>(std::floor(about.x - radius_px)), x1 = static_cast<int>(std::ceil(about.x + radius_px));
  const int y0 = static_cast<int>(std::floor(about.y - radius_px)), y1 = static_cast<int>(std::ceil(about.y + radius_px));
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) {
      const glm::dvec2 pixel(x, y);
      if (glm::length(pixel - about) > radius_px) continue;
      if (x < 0 || y < 0 || x >= image.width || y >= image.height) {
        region.cut_by_border = true;
        continue;
      }
      const auto place = place_at(rig, light, f, pixel);
      if (!place || glm::dot(place->point.normal, place->point.wo) < min_cosine) {
        region.cut_by_silhouette = true;
        continue;
      }
      const double to_camera = glm::dot(place->point.normal, place->point.wo), to_light = glm::dot(place->point.normal, place->wi);
      const double seen = place->falloff * lens_transmission(calibration, pixel);
      const std::size_t first = (static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x)) * per_pixel;
      for (std::size_t k = 0; k < per_pixel; ++k)
        region.values.push_back({pixel, place->slope, image.radiance[first + k], image.variance[first + k], seen * to_light, seen / to_camera,
                                 acquire::channel_of(image.layout, x, y, static_cast<int>(k)), image.flags[first + k]});
    }
  return region;
}

/// Brightest place of the region: mean over 3 x 3 pixels of what the mirror factor leaves, all channels alike, each divided by its median.
struct Peak {
  glm::dvec2 pixel;
  double height = 0, level = 0;  ///< of the channel-normalised image; level: its median
  bool clipped = false;
};

std::optional<Peak> brightest(const std::vector<Value>& values, const glm::dvec2& not_near, double not_within) {
  std::array<double, 3> level{};
  for (int c = 0; c < 3; ++c) {
    std::vector<double> all;
    for (const Value& v : values)
      if (v.channel == c && v.flag != PixelFlag::invalid) all.push_back(v.radiance / v.mirror);
    if (all.empty()) continue;
    std::nth_element(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2), all.end());
    level[static_cast<std::size_t>(c)] = all[all.size() / 2];
  }
  int x0 = 1 << 30, y0 = 1 << 30, x1 = -1, y1 = -1;
  for (const Value& v : values) {
    x0 = std::min(x0, static_cast<int>(v.pixel.x));
    x1 = std::max(x1, static_cast<int>(v.pixel.x));
    y0 = std::min(y0, static_cast<int>(v.pixel.y));
    y1 = std::max(y1, static_cast<int>(v.pixel.y));
  }
  if (x1 < 0) return std::nullopt;
  const int width = x1 - x0 + 1, height = y1 - y0 + 1;
  std::vector<double> sum(static_cast<std::size_t>(width * height)), n(sum.size());
  double scale = 0;
  for (const double l : level) scale = std::max(scale, l);
  if (!(scale > 0)) scale = 1;
  for (const Value& v : values) {
    if (v.flag == PixelFlag::invalid) continue;
    const double own = level[static_cast<std::size_t>(v.channel)];
    const std::size_t i = static_cast<std::size_t>((static_cast<int>(v.pixel.y) - y0) * width + static_cast<int>(v.pixel.x) - x0);
    sum[i] += own > 1e-6 * scale ? v.radiance / v.mirror / own : 0;
    n[i] += own > 1e-6 * scale ? 1 : 0;
  }
  std::optional<Peak> best;
  for (int y = 1; y + 1 < height; ++y)
    for (int x = 1; x + 1 < width; ++x) {
      double s = 0, count = 0;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          s += sum[static_cast<std::size_t>((y + dy) * width + x + dx)];
          count += n[static_cast<std::size_t>((y + dy) * width + x + dx)];
        }
      const glm::dvec2 pixel(x + x0, y + y0);
      if (count < 5 || glm::length(pixel - not_near) < not_within) continue;
      if (!best || s / count > best->height) best = Peak{pixel, s / count, 1};
    }
  return best;
}

/// The fit's unknowns: shift in pixels, logarithm of the squared width, and per channel base and height (linear).
struct LobeFit {
  glm::dvec2 shift{0.0};
  double log_width2 = 0;
  std::array<double, 3> base{}, height{};
  glm::dmat2 covariance{0.0};
  double reduced = 1;
  std::size_t n = 0, n_clipped = 0;
  bool good = false;
};

struct LobeModel {
  const std::vector<Value>& values;
  glm::dvec2 about;      ///< pixel where the given geometry has the peak
  glm::dmat2 j;          ///< slope per pixel there
  glm::dmat2 extra;      ///< covariance of the slope by lens, pixel and emitter
  bool has[3] = {false, false, false};

  /// exp(-s' C^-1 s / 2) with C = width2/2 + extra. The shift displaces the whole highlight: s - J shift.
  double lobe(const Value& v, const glm::dvec2& shift, double width2) const {
    const glm::dvec2 s = v.slope - j * shift;
    const glm::dmat2 c = glm::dmat2(width2 / 2) + extra;
    return std::exp(-0.5 * glm::dot(s, glm::inverse(c) * s));
  }
  /// Squared distance from the shifted centre in sigmas of the lobe; of a lobe of a pixel's size, in pixels and more, or its window
  /// would hold too few values.
  double distance2(const Value& v, const glm::dvec2& shift, double width2) const {
    constexpr double least_px = 0.8;
    const glm::dvec2 s = v.slope - j * shift;
    const glm::dmat2 c = glm::dmat2(width2 / 2) + extra + least_px * least_px * j * glm::transpose(j);
    return glm::dot(s, glm::inverse(c) * s);
  }
};

/// Gauss-Newton with the window moving along; `reach`: of the window, in sigmas.
LobeFit fit_lobe(const LobeModel& model, const glm::dvec2& start, double width2, double reach) {
  LobeFit fit;
  fit.shift = start;
  fit.log_width2 = std::log(width2);
  std::array<int, 3> slot{-1, -1, -1};
  int n_channels = 0;
  for (const Value& v : model.values)
    if (slot[static_cast<std::size_t>(v.channel)] < 0) slot[static_cast<std::size_t>(v.channel)] = n_channels++;
  const std::size_t n_unknowns = 3 + 2 * static_cast<std::size_t>(n_channels);
  bool linear_known = false;
  constexpr int max_iterations = 60;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    const double w2 = std::exp(fit.log_width2);
    // Base and height at the present shape, then a step of everything.
    for (int stage = linear_known ? 1 : 0; stage < 2; ++stage) {
      SymmetricMatrix a(n_unknowns);
      std::vector<double> b(n_unknowns);
      double chi2 = 0;
      fit.n = fit.n_clipped = 0;
      for (const Value& v : model.values) {
        if (v.flag == PixelFlag::invalid || model.distance2(v, fit.shift, w2) > reach * reach) continue;
        if (v.flag == PixelFlag::clipped) {
          ++fit.n_clipped;
          continue;
        }
        ++fit.n;
        const auto c = static_cast<std::size_t>(slot[static_cast<std::size_t>(v.channel)]);
        const double lobe = model.lobe(v, fit.shift, w2), base = linear_known ? fit.base[c] : 0, height = linear_known ? fit.height[c] : 0;
        const double expected = base * v.diffuse + height * v.mirror * lobe;
        std::vector<double> d(n_unknowns);
        if (stage == 1) {
          constexpr double h = 1e-4;
          for (int k = 0; k < 2; ++k) {
            glm::dvec2 up = fit.shift, down = fit.shift;
            up[k] += h;
            down[k] -= h;
            d[static_cast<std::size_t>(k)] = height * v.mirror * (model.lobe(v, up, w2) - model.lobe(v, down, w2)) / (2 * h);
          }
          d[2] = height * v.mirror * (model.lobe(v, fit.shift, w2 * (1 + h)) - model.lobe(v, fit.shift, w2 * (1 - h))) / (2 * h);
        }
        d[3 + 2 * c] = v.diffuse;
        d[4 + 2 * c] = v.mirror * lobe;
        // The lobe's profile is a model: 3 % of what is there, besides the noise.
        const double doubt = 0.03 * std::max(std::abs(expected), std::abs(height * v.mirror) * 0.1);
        // Falls to 0 at the window's edge, so that no pixel enters or leaves with a jump.
        const double inside = 1 - model.distance2(v, fit.shift, w2) / (reach * reach);
        const double weight = inside * inside / (v.variance + doubt * doubt + 1e-300), r = v.radiance - expected;
        chi2 += weight * r * r;
        for (std::size_t p = 0; p < n_unknowns; ++p) {
          b[p] += weight * d[p] * r;
          for (std::size_t q = 0; q <= p; ++q) a.at(p, q) += weight * d[p] * d[q];
        }
      }
      if (fit.n < 2 * n_unknowns) return fit;
      const SymmetricMatrix information = a;
      if (stage == 1)
        for (std::size_t p = 0; p < 3; ++p) a.at(p, p) *= 1.01;
      const std::vector<double> step = solve(a, b);
      for (std::size_t c = 0; c < static_cast<std::size_t>(n_channels); ++c) {
        fit.base[c] = (linear_known ? fit.base[c] : 0) + step[3 + 2 * c];
        fit.height[c] = (linear_known ? fit.height[c] : 0) + step[4 + 2 * c];
      }
      linear_known = true;
      if (stage == 0) continue;
      const double length = std::hypot(step[0], step[1]), limit = 1.5;
      fit.shift += glm::dvec2(step[0], step[1]) * (length > limit ? limit / length : 1.0);
      fit.log_width2 += std::clamp(step[2], -0.7, 0.7);
      if (!std::isfinite(fit.log_width2 + fit.shift.x + fit.shift.y)) return fit;
      if (fit.log_width2 < std::log(width2) - 12) fit.log_width2 = std::log(width2) - 12;  // a mirror: only lens and emitter are seen
      if (length < 1e-4 || iteration + 1 == max_iterations) {
        const SymmetricMatrix inverse = sandwich(information, information);
        fit.reduced = std::max(1.0, chi2 / static_cast<double>(fit.n - n_unknowns));
        fit.covariance = glm::dmat2(inverse(0, 0), inverse(0, 1), inverse(0, 1), inverse(1, 1)) * fit.reduced;
        fit.good = length < 0.02 && inverse(0, 0) > 0 && inverse(1, 1) > 0;
        return fit;
      }
    }
  }
  return fit;
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
                               const HighlightOptions& options) {
  const acquire::RigGeometry& rig = calibration.geometry;
  const acquire::PlacedLight placed = rig.place_light(light, calibration.turntable_scale * turntable_angle);
  HighlightResult result;
  const auto expected = mirror_pixel(rig, placed.position);
  if (!expected) return result;
  const auto point = acquire::trace(rig, *expected);
  if (!point || glm::dot(point->normal, point->wo) < options.min_cosine) {
    result.fate = HighlightFate::silhouette;
    return result;
  }
  const Frame f = frame_about(point->normal);
  const auto j = slope_per_pixel(rig, placed, f, *expected);
  if (!j) {
    result.fate = HighlightFate::silhouette;
    return result;
  }
  // The normal turns about this much per pixel where it turns slowest: the search region in pixels.
  const double slowest = std::min(glm::length((*j)[0]), glm::length((*j)[1]));
  const double search_px = std::max(6.0, options.search_rad / slowest);
  const Region near = collect(image, calibration, placed, f, *expected, search_px, 0.15);
  const auto peak = brightest(near.values, {-1e9, -1e9}, 0);
  if (!peak) {
    result.fate = near.cut_by_border ? HighlightFate::border : HighlightFate::silhouette;
    return result;
  }

  if (peak->height < 1.2) {
    result.fate = HighlightFate::matte;
    return result;
  }

  // Width: area above half of the height over the level of the surroundings.
  const glm::dvec2 start = peak->pixel - *expected;
  double above = 0;
  std::array<double, 3> top{}, low{};
  std::array<std::vector<double>, 3> by_channel;
  for (const Value& v : near.values)
    if (v.flag != PixelFlag::invalid) {
      const auto c = static_cast<std::size_t>(v.channel);
      by_channel[c].push_back(v.radiance / v.mirror);
      if (glm::length(v.pixel - peak->pixel) < 2.3) top[c] = std::max(top[c], v.radiance / v.mirror);
    }
  double n_all = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    if (by_channel[c].empty()) continue;
    auto& all = by_channel[c];
    std::nth_element(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(all.size() / 5), all.end());
    low[c] = all[all.size() / 5];
    n_all += static_cast<double>(all.size());
  }
  for (const Value& v : near.values) {
    const auto c = static_cast<std::size_t>(v.channel);
    if (v.flag != PixelFlag::invalid && v.radiance / v.mirror > 0.5 * (top[c] + low[c])) above += 1;
  }
  const double pi = 3.14159265358979323846, per_pixel = n_all / std::max(1.0, pi * search_px * search_px);
  const double radius_px = std::sqrt(std::max(above / per_pixel, 2.0) / (pi * 0.693147));  // 1/e radius of a Gaussian with that area
  const double blur2 = calibration.lens_blur_px * calibration.lens_blur_px + 1.0 / 12;
  const glm::dmat2 jt = glm::transpose(*j);
  const glm::dvec3 to_light = placed.position - point->position;
  const double emitter = placed.diameter * placed.diameter / (64 * glm::dot(to_light, to_light));
  const glm::dmat2 extra = *j * jt * blur2 + glm::dmat2(emitter);
  const double det = std::abs(glm::determinant(*j));
  const double width2 = std::max(radius_px * radius_px * det - 2 * std::sqrt(std::abs(glm::determinant(extra))), 1e-3 * radius_px * radius_px * det);
  if (radius_px * std::sqrt(det) > options.max_width_rad || radius_px > 0.7 * search_px) {
    result.fate = HighlightFate::matte;
    return result;
  }

  constexpr double reach = 2.9;
  const double window_px = glm::length(start) + 3 + 4 * radius_px * std::sqrt(det) / slowest;
  const Region region = collect(image, calibration, placed, f, *expected, window_px, 0.12);
  const LobeModel model{region.values, *expected, *j, extra};
  const LobeFit fit = fit_lobe(model, start, width2, reach);
  double base = 0, height = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    base += fit.base[c];
    height += fit.height[c];
  }
  result.width_rad = std::sqrt(std::exp(fit.log_width2));
  result.contrast = height / std::max(base, 1e-9 * std::abs(height));
  const glm::dvec2 centre = *expected + fit.shift;
  if (fit.n_clipped > 0 && 3 * fit.n_clipped > fit.n) {
    result.fate = HighlightFate::clipped;
    return result;
  }
  if (!fit.good) {
    result.fate = HighlightFate::poor;
    return result;
  }
  if (!(height > 0) || result.contrast < options.min_contrast || result.width_rad > options.max_width_rad) {
    result.fate = HighlightFate::matte;
    return result;
  }
  // Half of the window towards silhouette or border missing: the rest is not symmetric.
  const glm::dmat2 spread = glm::inverse(*j) * (glm::dmat2(std::exp(fit.log_width2) / 2) + extra) * glm::transpose(glm::inverse(*j));
  const glm::dvec2 half(reach * std::sqrt(spread[0][0]), reach * std::sqrt(spread[1][1]));
  if (centre.x - half.x < 0 || centre.y - half.y < 0 || centre.x + half.x > image.width - 1 || centre.y + half.y > image.height - 1) {
    result.fate = HighlightFate::border;
    return result;
  }
  for (int k = 0; k < 16; ++k) {
    const double a = 2 * pi * k / 16;
    const auto p = acquire::trace(rig, centre + half * glm::dvec2(std::cos(a), std::sin(a)));
    if (!p || glm::dot(p->normal, p->wo) < 0.15) {
      result.fate = HighlightFate::silhouette;
      return result;
    }
  }
  const double clear = 1.5 + 2.5 * std::sqrt(std::max(spread[0][0], spread[1][1]));
  const auto second = brightest(near.values, centre, clear);
  if (second && second->height - 1 > 0.5 * (peak->height - 1) && second->height > 1.5) {
    result.fate = HighlightFate::two_peaks;
    return result;
  }
  result.fate = HighlightFate::found;
  const double least = 1e-6;  // (0.001 px)^2
  result.highlight = {"", light, turntable_angle, centre, fit.covariance[0][0] + least, fit.covariance[0][1], fit.covariance[1][1] + least};
  return result;
}

}  // namespace lacquer::calib
