#include "libcalib/samples.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgcodecs.hpp>

#include "libbrdf/error.h"
#include "libcalib/drift_session.h"

namespace lacquer::calib {

namespace {

/// Pixels handled at a time: large enough to keep all threads busy, small enough that the samples stay in the cache.
constexpr std::size_t chunk_pixels = 1 << 14;

cv::Mat read_mask(const std::filesystem::path& file, int width, int height) {
  const cv::Mat mask = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
  if (mask.empty()) throw Error(ErrorCode::file, fmt::format("{}: mask: cannot be read as an image", file.string()));
  if (mask.cols != width || mask.rows != height)
    throw Error(ErrorCode::file, fmt::format("{}: mask: expected {}x{} pixels as the camera has, got {}x{}", file.string(), width, height,
                                             mask.cols, mask.rows));
  return mask;
}

/// Lens blur and mixed pixels spoil a band along the silhouette: all points at `edge_px` around the pixel must hit the sphere.
bool inside_silhouette(const acquire::RigGeometry& rig, const glm::dvec2& pixel, double edge_px) {
  for (int k = 0; k < 8 && edge_px > 0; ++k) {
    const double a = k * 0.78539816339744831;
    if (!acquire::trace(rig, pixel + edge_px * glm::dvec2(std::cos(a), std::sin(a)))) return false;
  }
  return true;
}

PixelStep pixel_step(const acquire::RigGeometry& rig, const glm::dvec2& pixel) {
  PixelStep step{};
  for (int axis = 0; axis < 2; ++axis) {
    const glm::dvec2 half_step(axis == 0 ? 0.5 : 0.0, axis == 0 ? 0.0 : 0.5);
    const auto before = acquire::trace(rig, pixel - half_step), after = acquire::trace(rig, pixel + half_step);
    if (!before || !after) continue;  // on the silhouette itself; such pixels are no samples
    step.normal[axis] = glm::vec3(after->normal - before->normal);
    step.wo[axis] = glm::vec3(after->wo - before->wo);
  }
  return step;
}

/// Slope of the half vector against the normal, moved by one pixel: to first order ds = dh - dn in the tangent plane. Pixel area and
/// lens blur spread it by `blur2` pixels^2 per axis. The emitter (a disc: variance D^2/16 per axis) turns wi alone, the half vector by
/// half of that in the plane of wi and wo (at phi_d) and by 1/(2 cos theta_d) across.
brdf::Footprint<double> half_vector_footprint(const Calibration& calibration, const acquire::PlacedLight& light,
                                              const acquire::SurfacePoint& point, const glm::dvec3& wi, const PixelStep& step,
                                              const brdf::HalfDiff& coordinates) {
  const double blur2 = 1.0 / 12 + calibration.lens_blur_px * calibration.lens_blur_px;
  const glm::dvec3 to_light = light.position - point.position;
  const double distance2 = light.distant ? 1 : glm::dot(to_light, to_light);
  const glm::dvec3 sum = wi + point.wo;
  const double length = glm::length(sum);
  const glm::dvec3 h = sum / length, &n = point.normal;

  // Tangent axes: along, where theta_h grows, and across. At the very peak any will do.
  glm::dvec3 along = h - n * glm::dot(h, n);
  if (glm::dot(along, along) < 1e-24) along = glm::cross(n, std::abs(n.x) < 0.5 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0));
  along = glm::normalize(along);
  const glm::dvec3 across = glm::cross(n, along);

  brdf::Footprint<double> v;
  for (int axis = 0; axis < 2; ++axis) {
    const glm::dvec3 dn(step.normal[axis]), dp = calibration.geometry.sphere_radius * dn;
    const glm::dvec3 dwi = light.distant ? glm::dvec3(0) : (wi * glm::dot(wi, dp) - dp) / std::sqrt(distance2);
    const glm::dvec3 dsum = dwi + glm::dvec3(step.wo[axis]);
    const glm::dvec3 slope = (dsum - h * glm::dot(h, dsum)) / length - dn;
    const double a = glm::dot(slope, along), b = glm::dot(slope, across);
    v.along += blur2 * a * a;
    v.across += blur2 * b * b;
    v.mixed += blur2 * a * b;
  }
  if (!light.distant) {
    const double in_plane = light.diameter * light.diameter / (64 * distance2);
    const double off_plane = in_plane / std::pow(std::cos(coordinates.theta_d), 2);
    const double c = std::cos(coordinates.phi_d), s = std::sin(coordinates.phi_d);
    v.along += in_plane * c * c + off_plane * s * s;
    v.across += in_plane * s * s + off_plane * c * c;
    v.mixed += (in_plane - off_plane) * s * c;
  }
  return v;
}

/// Near a narrow peak, seen with a footprint too large to be deconvolved.
bool unresolved(const brdf::Footprint<double>& v, double theta_h, double narrowest_m) {
  const double larger = (v.along + v.across) / 2 + std::hypot((v.along - v.across) / 2, v.mixed), narrow2 = narrowest_m * narrowest_m;
  return larger > narrow2 && theta_h * theta_h < 9 * (narrow2 + 2 * larger);
}

acquire::PlacedLight placed_light(const Calibration& calibration, const Illumination& lighting) {
  acquire::PlacedLight placed = calibration.geometry.place_light(lighting.light, lighting.turntable_angle);
  placed.intensity *= lighting.factor;
  return placed;
}

}  // namespace

double lens_transmission(const Calibration& calibration, const glm::dvec2& pixel) {
  const auto& camera = calibration.geometry.camera;
  const double corner_x = std::max(camera.centre.x + 0.5, camera.width - 0.5 - camera.centre.x);
  const double corner_y = std::max(camera.centre.y + 0.5, camera.height - 0.5 - camera.centre.y);
  const glm::dvec2 offset = pixel - camera.centre;
  return 1 - calibration.vignetting * (offset.x * offset.x + offset.y * offset.y) / (corner_x * corner_x + corner_y * corner_y);
}

Illumination illumination_of(const acquire::ViewRecord& view, const Calibration& calibration) {
  return {static_cast<std::size_t>(view.light), calibration.turntable_scale * view.turntable_angle, calibration.light_factor(view).factor};
}

void SampleOptions::validate() const {
  if (!(min_cosine > 0 && min_cosine < 1)) throw Error(ErrorCode::usage, "min_cosine: expected a number in (0, 1)");
  if (!(narrowest_m > 0 && narrowest_m <= 1)) throw Error(ErrorCode::usage, "narrowest_m: expected a number in (0, 1]");
  if (!(edge_px >= 0 && edge_px < 1000)) throw Error(ErrorCode::usage, "edge_px: expected a number of pixels >= 0");
}

void add_sample(brdf::TableAccumulator& accumulator, const Sample& s) {
  const auto channel = static_cast<std::size_t>(s.channel);
  if (s.clipped)
    accumulator.add_bound(channel, s.coordinates, s.value, s.variance, s.weight, s.footprint);
  else
    accumulator.add(channel, s.coordinates, s.value, s.variance, s.weight, s.footprint);
}

SampleCounts& SampleCounts::operator+=(const SampleCounts& other) {
  used += other.used;
  clipped += other.clipped;
  invalid += other.invalid;
  masked += other.masked;
  grazing += other.grazing;
  blurred += other.blurred;
  return *this;
}

Sampler::Sampler(const Calibration& calibration, const acquire::MaskDescription& mask, acquire::PixelLayout layout,
                 const SampleOptions& options)
    : calibration_(calibration), layout_(layout), options_(options) {
  options_.validate();
  const auto& rig = calibration_.geometry;
  const int width = rig.camera.width, height = rig.camera.height;
  cv::Mat mask_image;
  if (mask.file) mask_image = read_mask(*mask.file, width, height);

  std::vector<std::vector<Pixel>> rows(static_cast<std::size_t>(height));
  std::vector<std::size_t> masked(static_cast<std::size_t>(height));
  tbb::parallel_for(0, height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      const glm::dvec2 pixel(x, y);
      const auto point = acquire::trace(rig, pixel);
      if (!point) continue;
      const bool masked_out = (!mask_image.empty() && mask_image.at<unsigned char>(y, x) == 0) ||
                              (mask.min_y && point->position.y < *mask.min_y) ||
                              !inside_silhouette(rig, pixel, options_.edge_px);
      const double cos_o = glm::dot(point->normal, point->wo);
      if (masked_out || cos_o < options_.min_cosine) {
        ++masked[static_cast<std::size_t>(y)];
        continue;
      }
      rows[static_cast<std::size_t>(y)].push_back(
          {static_cast<std::size_t>(y) * width + x, *point, lens_transmission(calibration_, pixel), pixel_step(rig, pixel)});
    }
  });
  for (std::size_t y = 0; y < rows.size(); ++y) {
    pixels_.insert(pixels_.end(), rows[y].begin(), rows[y].end());
    n_masked_ += masked[y];
  }
}

SampleCounts Sampler::sample_view(const RadianceImage& image, const Illumination& lighting, const Sink& sink) const {
  const auto& camera = calibration_.geometry.camera;
  if (image.width != camera.width || image.height != camera.height || image.layout != layout_)
    throw Error(ErrorCode::input, fmt::format("radiance image: expected {}x{} {}, got {}x{} {}", camera.width, camera.height,
                                              name_of(layout_), image.width, image.height, name_of(image.layout)));
  const acquire::PlacedLight placed = placed_light(calibration_, lighting);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));
  const double reference = placed.distant
                               ? 1.0
                               : 1.0 / glm::dot(placed.position, placed.position);  // irradiance per intensity at the sphere's centre

  SampleCounts counts;
  counts.masked = n_masked_ * per_pixel;
  std::vector<Sample> slots(chunk_pixels * per_pixel);
  enum class Fate : unsigned char { used, clipped, invalid, grazing, blurred };
  std::vector<Fate> fates(slots.size());

  for (std::size_t first = 0; first < pixels_.size(); first += chunk_pixels) {
    const std::size_t n = std::min(chunk_pixels, pixels_.size() - first);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, n, 512), [&](const auto& range) {
      for (std::size_t i = range.begin(); i != range.end(); ++i) {
        const Pixel& pixel = pixels_[first + i];
        const auto lit = acquire::illuminate(placed, pixel.point);
        const double cos_i = lit ? glm::dot(pixel.point.normal, lit->wi) : 0.0;
        brdf::HalfDiff coordinates{};
        brdf::Footprint<double> footprint;
        bool blurred = false;
        if (cos_i >= options_.min_cosine) {
          const auto local = acquire::to_shading_frame(pixel.point, lit->wi);
          coordinates = brdf::half_diff({local.wi, local.wo});
          footprint = half_vector_footprint(calibration_, placed, pixel.point, lit->wi, pixel.step, coordinates);
          blurred = unresolved(footprint, coordinates.theta_h, options_.narrowest_m);
        }
        for (std::size_t k = 0; k < per_pixel; ++k) {
          const std::size_t slot = i * per_pixel + k, value = pixel.index * per_pixel + k;
          if (cos_i < options_.min_cosine) {
            fates[slot] = Fate::grazing;
            continue;
          }
          if (blurred) {
            fates[slot] = Fate::blurred;
            continue;
          }
          const PixelFlag flag = image.flags[value];
          fates[slot] = flag == PixelFlag::clipped ? Fate::clipped : flag == PixelFlag::invalid ? Fate::invalid : Fate::used;
          if (fates[slot] == Fate::invalid) continue;
          const int x = static_cast<int>(pixel.index % static_cast<std::size_t>(camera.width));
          const int y = static_cast<int>(pixel.index / static_cast<std::size_t>(camera.width));
          const int channel = acquire::channel_of(layout_, x, y, static_cast<int>(k));
          // f_r = radiance / irradiance
          const double scale = 1.0 / (calibration_.dn_per_radiance[channel] * pixel.transmission * lit->irradiance[channel]);
          const double weight = lit->irradiance[channel] / (placed.intensity[channel] * reference);
          slots[slot] = {coordinates, image.radiance[value] * scale, image.variance[value] * scale * scale, weight, footprint, channel,
                         fates[slot] == Fate::clipped};
        }
      }
    });
    std::size_t kept = 0;
    for (std::size_t slot = 0; slot < n * per_pixel; ++slot) {
      switch (fates[slot]) {
        case Fate::used: ++counts.used; slots[kept++] = slots[slot]; break;
        case Fate::clipped: ++counts.clipped; slots[kept++] = slots[slot]; break;
        case Fate::invalid: ++counts.invalid; break;
        case Fate::grazing: ++counts.grazing; break;
        case Fate::blurred: ++counts.blurred; break;
      }
    }
    sink(std::span<const Sample>(slots.data(), kept));
  }
  return counts;
}

Sampler::Prediction Sampler::predict_view(const brdf::Brdf& paint, const Illumination& lighting) const {
  const auto& camera = calibration_.geometry.camera;
  const acquire::PlacedLight placed = placed_light(calibration_, lighting);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));
  const std::size_t n_values = static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height) * per_pixel;

  Prediction prediction{std::vector<float>(n_values), std::vector<bool>(n_values)};
  std::vector<unsigned char> used(n_values);  // vector<bool> must not be written by several threads
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pixels_.size(), 512), [&](const auto& range) {
    for (std::size_t i = range.begin(); i != range.end(); ++i) {
      const Pixel& pixel = pixels_[i];
      const auto lit = acquire::illuminate(placed, pixel.point);
      if (!lit || glm::dot(pixel.point.normal, lit->wi) < options_.min_cosine) continue;
      const auto local = acquire::to_shading_frame(pixel.point, lit->wi);
      const brdf::Directions directions{local.wi, local.wo};
      const auto f = paint.value(directions, half_vector_footprint(calibration_, placed, pixel.point, lit->wi, pixel.step,
                                                                   brdf::half_diff(directions)));
      if (!f) continue;
      const int x = static_cast<int>(pixel.index % static_cast<std::size_t>(camera.width));
      const int y = static_cast<int>(pixel.index / static_cast<std::size_t>(camera.width));
      for (std::size_t k = 0; k < per_pixel; ++k) {
        const int channel = acquire::channel_of(layout_, x, y, static_cast<int>(k));
        prediction.radiance[pixel.index * per_pixel + k] = static_cast<float>(
            (*f)[channel] * lit->irradiance[channel] * calibration_.dn_per_radiance[channel] * pixel.transmission);
        used[pixel.index * per_pixel + k] = 1;
      }
    }
  });
  std::transform(used.begin(), used.end(), prediction.used.begin(), [](unsigned char u) { return u != 0; });
  return prediction;
}

Tabulation tabulate_session(const acquire::Session& session, const Calibration& calibration, const SampleOptions& options,
                            const Progress& progress) {
  const acquire::PixelLayout layout = session.rig.sensor.layout;
  const Sampler sampler(calibration, session.rig.mask, layout, options);
  brdf::TableAccumulator accumulator(static_cast<std::size_t>(acquire::n_channels(layout)));
  SampleCounts counts;
  const std::vector<std::size_t> views = session.views_of(acquire::ViewKind::measurement);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const auto& view = session.views[views[i]];
    const RadianceImage image = read_radiance(session.radiance_path(view));
    counts += sampler.sample_view(image, illumination_of(view, calibration), [&](std::span<const Sample> samples) {
      for (const Sample& s : samples) add_sample(accumulator, s);
    });
    if (progress) progress("tabulate", i + 1, views.size());
  }
  Tabulation result{accumulator.table(true), counts};
  result.table.absolute_scale = calibration.absolute_scale;
  result.table.scale_sigma = drift_scale_sigma(session, calibration);
  return result;
}

}  // namespace lacquer::calib
