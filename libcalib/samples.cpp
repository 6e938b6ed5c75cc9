#include "libcalib/samples.h"

#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <future>
#include <limits>

#include "libbrdf/error.h"
#include "libcalib/drift_session.h"
#include "libcalib/pixel_mask.h"

namespace lacquer::calib {

namespace {

/// Pixels handled at a time: large enough to keep all threads busy, small enough that the samples stay in the cache.
constexpr std::size_t chunk_pixels = 1 << 14;

/// Lens blur and mixed pixels spoil a band along the silhouette: all points at `edge_px` around the pixel must hit the sphere.
bool inside_silhouette(const acquire::RigGeometry& rig, const glm::dvec2& pixel, double edge_px) {
  for (int k = 0; k < 8 && edge_px > 0; ++k) {
    const double a = k * 0.78539816339744831;
    if (!acquire::trace(rig, pixel + edge_px * glm::dvec2(std::cos(a), std::sin(a)))) return false;
  }
  return true;
}

/// The normals along one row of pixels, halfway between them and half a pixel above and below: how the normal changes from pixel to pixel.
class NormalSteps {
 public:
  NormalSteps(const acquire::RigGeometry& rig, int y) : rig_(rig), y_(y) {}
  /// In x and in y: images of two half-pixel steps. x must not fall from call to call. Zero on the silhouette, where no sample lies.
  std::array<glm::dvec3, 2> at(int x) {
    const auto before = x == next_ ? right_ : normal({x - 0.5, y_});
    right_ = normal({x + 0.5, y_});
    next_ = x + 1;
    return {difference(before, right_), difference(normal({x, y_ - 0.5}), normal({x, y_ + 0.5}))};
  }

 private:
  using Hit = std::optional<glm::dvec3>;
  Hit normal(const glm::dvec2& pixel) const {
    const auto point = acquire::trace(rig_, pixel);
    return point ? Hit(point->normal) : Hit();
  }
  static glm::dvec3 difference(const Hit& before, const Hit& after) { return before && after ? *after - *before : glm::dvec3(0); }

  const acquire::RigGeometry& rig_;
  int y_, next_ = -1;
  Hit right_;
};

/// So far from the silhouette that a step of `edge_px` in any direction cannot reach it: three times the step's length to first order.
bool well_inside(double cos_o, const std::array<glm::dvec3, 2>& step, double edge_px) {
  const double change = cos_o * (glm::length(step[0]) + glm::length(step[1]));  // of the sine, per pixel
  return change > 0 && std::sqrt(std::max(0.0, 1 - cos_o * cos_o)) + 3 * edge_px * change < 0.99;
}

/// Slope of the half vector against the normal, moved by one pixel: to first order ds = dh - dn in the tangent plane. Pixel area and
/// lens blur spread it by `normal_spread`, two such moves. The emitter (a disc: variance D^2/16 per axis) turns wi alone, the half vector by
/// half of that in the plane of wi and wo (at phi_d) and by 1/(2 cos theta_d) across.
/// `camera_distance`: infinite for an orthographic camera.
brdf::Footprint<double> half_vector_footprint(double radius, double camera_distance, const acquire::PlacedLight& light,
                                              const acquire::SurfacePoint& point, const glm::dvec3& wi,
                                              const std::array<glm::dvec3, 2>& normal_spread, const brdf::HalfDiff& coordinates) {
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
  for (const glm::dvec3& dn : normal_spread) {
    const glm::dvec3 dp = radius * dn;
    const glm::dvec3 dwi = light.distant ? glm::dvec3(0) : (wi * glm::dot(wi, dp) - dp) / std::sqrt(distance2);
    const glm::dvec3 dsum = dwi + (point.wo * glm::dot(point.wo, dp) - dp) / camera_distance;
    const glm::dvec3 slope = (dsum - h * glm::dot(h, dsum)) / length - dn;
    const double a = glm::dot(slope, along), b = glm::dot(slope, across);
    v.along += a * a;
    v.across += b * b;
    v.mixed += a * b;
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
  const double angle = calibration.turntable_scale * view.turntable_angle + calibration.geometry_uncertainty.angle_correction(view.id);
  return {static_cast<std::size_t>(view.light), angle, calibration.light_factor(view).factor};
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
  const std::vector<std::uint8_t> paint = paint_mask(mask, rig);

  const acquire::RigidTransform rig_from_cam = rig.cam_from_rig.inverse();
  camera_ = central() ? rig_from_cam * glm::dvec3(0) : rig_from_cam.rotation * glm::dvec3(0, 0, -1);

  const bool mosaic = acquire::values_per_pixel(layout) == 1 && acquire::n_channels(layout) > 1;
  struct Row {
    std::vector<SpherePixel> pixels;
    std::vector<int> parts;
  };
  std::vector<Row> rows(static_cast<std::size_t>(height));
  std::vector<std::size_t> masked(static_cast<std::size_t>(height));
  tbb::parallel_for(0, height, [&](int y) {
    NormalSteps steps(rig, y);
    for (int x = 0; x < width; ++x) {
      const glm::dvec2 pixel(x, y);
      const auto point = acquire::trace(rig, pixel);
      if (!point) continue;
      const double cos_o = glm::dot(point->normal, point->wo);
      const auto step = steps.at(x);
      if (paint[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] == 0 ||
          cos_o < options_.min_cosine || !(well_inside(cos_o, step, options_.edge_px) || inside_silhouette(rig, pixel, options_.edge_px))) {
        ++masked[static_cast<std::size_t>(y)];
        continue;
      }
      Row& row = rows[static_cast<std::size_t>(y)];
      row.pixels.push_back({static_cast<std::uint32_t>(y * width + x), point->normal, step, lens_transmission(calibration_, pixel)});
      row.parts.push_back(mosaic ? acquire::channel_of(layout_, x, y, 0) : 0);
    }
  });
  const PixelCamera camera{camera_, central(), rig.sphere_radius, 1.0 / 12 + calibration_.lens_blur_px * calibration_.lens_blur_px};
  for (int part = 0; part < (mosaic ? 3 : 1); ++part) parts_.emplace_back(part, camera, static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  for (std::size_t y = 0; y < rows.size(); ++y) {
    for (std::size_t i = 0; i < rows[y].pixels.size(); ++i)
      parts_[static_cast<std::size_t>(rows[y].parts[i])].push_back(rows[y].pixels[i]);
    rows[y] = {};
    n_masked_ += masked[y];
  }
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    parts_[part].finish();
    for (std::size_t first = 0; first < parts_[part].size(); first += SampleBlock::size) blocks_.push_back({part, first});
  }
  std::sort(blocks_.begin(), blocks_.end(), [&](const Block& a, const Block& b) { return parts_[a.part].index(a.first) < parts_[b.part].index(b.first); });
}

std::size_t Sampler::n_pixels() const {
  std::size_t n = 0;
  for (const SpherePixels& part : parts_) n += part.size();
  return n;
}

Sampler::View Sampler::view_of(const Illumination& lighting) const {
  View view{placed_light(calibration_, lighting), 1.0, options_.min_cosine};
  if (!view.light.distant) {
    const double distance = glm::length(view.light.position);
    view.reference = 1 / (distance * distance);
    // Penumbra: seen from the sphere, the emitter's radius is less than this.
    view.min_cosine = std::max(view.min_cosine, view.light.diameter / 2 / std::max(distance - calibration_.geometry.sphere_radius, 1e-9));
  }
  return view;
}

acquire::SurfacePoint Sampler::point(const SpherePixels& pixels, std::size_t i) const {
  const glm::dvec3 normal = pixels.normal(i), position = calibration_.geometry.sphere_radius * normal;
  return {position, normal, central() ? glm::normalize(camera_ - position) : camera_};
}

Sampler::Lit Sampler::light(const View& view, const SpherePixels& pixels, std::size_t i) const {
  Lit lit;
  const acquire::SurfacePoint p = point(pixels, i);
  const auto illumination = acquire::illuminate(view.light, p);
  if (!illumination || glm::dot(p.normal, illumination->wi) < view.min_cosine) return lit;
  const auto local = acquire::to_shading_frame(p, illumination->wi);
  const double camera_distance = central() ? glm::length(camera_ - p.position) : std::numeric_limits<double>::infinity();
  const CameraFrame frame = camera_frame(p.normal, camera_);
  const glm::dvec3 spread = pixels.spread(i);
  const std::array<glm::dvec3, 2> moves{spread.x * frame.x + spread.y * frame.y, spread.z * frame.y};
  lit.directions = {local.wi, local.wo};
  lit.coordinates = brdf::half_diff(lit.directions);
  lit.footprint = half_vector_footprint(calibration_.geometry.sphere_radius, camera_distance, view.light, p, illumination->wi, moves,
                                        lit.coordinates);
  lit.irradiance = illumination->irradiance;
  const int c = view.light.intensity.y > 0 ? 1 : view.light.intensity.x > 0 ? 0 : 2;  // all channels agree
  lit.weight = lit.irradiance[c] / (view.light.intensity[c] * view.reference);
  lit.fate = unresolved(lit.footprint, lit.coordinates.theta_h, options_.narrowest_m) ? PixelFate::blurred : PixelFate::used;
  return lit;
}

void Sampler::check(const RadianceImage& image) const {
  const auto& camera = calibration_.geometry.camera;
  if (image.width != camera.width || image.height != camera.height || image.layout != layout_)
    throw Error(ErrorCode::input, fmt::format("radiance image: expected {}x{} {}, got {}x{} {}", camera.width, camera.height,
                                              name_of(layout_), image.width, image.height, name_of(image.layout)));
}

SampleCounts Sampler::sample_view(const RadianceImage& image, const Illumination& lighting, const Sink& sink) const {
  check(image);
  const View view = view_of(lighting);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));
  SampleCounts counts;
  counts.masked = n_masked_ * per_pixel;
  std::vector<Sample> samples;
  const auto chunk = [&](const SpherePixels& pixels, std::size_t first) {
    samples.clear();
    for (std::size_t i = first; i < std::min(first + chunk_pixels, pixels.size()); ++i) {
      const Lit lit = light(view, pixels, i);
      if (lit.fate != PixelFate::used) (lit.fate == PixelFate::blurred ? counts.blurred : counts.grazing) += per_pixel;
      for (std::size_t k = 0; lit.fate == PixelFate::used && k < per_pixel; ++k) {
        const std::size_t value = pixels.index(i) * per_pixel + k;
        const PixelFlag flag = image.flags[value];
        ++(flag == PixelFlag::clipped ? counts.clipped : flag == PixelFlag::invalid ? counts.invalid : counts.used);
        if (flag == PixelFlag::invalid) continue;
        const int channel = per_pixel > 1 ? static_cast<int>(k) : pixels.channel();
        // f_r = radiance / irradiance
        const double scale = pixels.inverse_transmission(i) / (calibration_.dn_per_radiance[channel] * lit.irradiance[channel]);
        samples.push_back({lit.coordinates, image.radiance[value] * scale, image.variance[value] * scale * scale, lit.weight, lit.footprint,
                           channel, flag == PixelFlag::clipped});
      }
    }
    sink(samples);
  };
  for (const SpherePixels& pixels : parts_)
    for (std::size_t first = 0; first < pixels.size(); first += chunk_pixels) chunk(pixels, first);
  return counts;
}

Sampler::Prediction Sampler::predict_view(const brdf::Brdf& paint, const Illumination& lighting) const {
  const auto& camera = calibration_.geometry.camera;
  const View view = view_of(lighting);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));
  const std::size_t n_values = static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height) * per_pixel;

  Prediction prediction{std::vector<float>(n_values), std::vector<bool>(n_values)};
  std::vector<unsigned char> used(n_values);  // vector<bool> must not be written by several threads
  const auto predict = [&](const SpherePixels& pixels, std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i != end; ++i) {
      const Lit lit = light(view, pixels, i);
      if (lit.fate == PixelFate::grazing) continue;
      const auto f = paint.value(lit.directions, lit.footprint);
      if (!f) continue;
      for (std::size_t k = 0; k < per_pixel; ++k) {
        const int channel = per_pixel > 1 ? static_cast<int>(k) : pixels.channel();
        const std::size_t value = pixels.index(i) * per_pixel + k;
        prediction.radiance[value] = static_cast<float>((*f)[channel] * lit.irradiance[channel] * calibration_.dn_per_radiance[channel] /
                                                        pixels.inverse_transmission(i));
        used[value] = 1;
      }
    }
  };
  for (const SpherePixels& pixels : parts_)
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pixels.size(), 512), [&](const auto& range) { predict(pixels, range.begin(), range.end()); });
  std::transform(used.begin(), used.end(), prediction.used.begin(), [](unsigned char u) { return u != 0; });
  return prediction;
}

Tabulation tabulate_session(const acquire::Session& session, const Calibration& calibration, const SampleOptions& options,
                            const Progress& progress) {
  const acquire::PixelLayout layout = session.rig.sensor.layout;
  brdf::TableAccumulator accumulator(static_cast<std::size_t>(acquire::n_channels(layout)));
  SampleCounts counts;
  {
    const Sampler sampler(calibration, session.rig.mask, layout, options);  // gives its memory back before the table needs it
    const std::vector<std::size_t> views = session.views_of(acquire::ViewKind::measurement);
    // The next images are read while some are tabulated.
    constexpr std::size_t at_once = Sampler::views_at_once;
    const auto read = [&](std::size_t first) {
      std::vector<RadianceImage> images;
      for (std::size_t i = first; i < std::min(first + at_once, views.size()); ++i) images.push_back(read_radiance(session.radiance_path(session.views[views[i]])));
      return images;
    };
    std::future<std::vector<RadianceImage>> next;
    if (!views.empty()) next = std::async(std::launch::async, read, std::size_t{0});
    for (std::size_t first = 0; first < views.size(); first += at_once) {
      const std::vector<RadianceImage> images = next.get();
      if (first + at_once < views.size()) next = std::async(std::launch::async, read, first + at_once);
      std::vector<LitImage> lit;
      for (const RadianceImage& image : images) lit.push_back({&image, illumination_of(session.views[views[first + lit.size()]], calibration)});
      counts += sampler.accumulate_views(lit, accumulator);
      if (progress) progress("tabulate", first + images.size(), views.size());
    }
  }
#ifdef __GLIBC__
  malloc_trim(0);  // the images' memory, which the table needs now
#endif
  Tabulation result{accumulator.table(true), counts, {}};
  result.table.absolute_scale = calibration.absolute_scale;
  if (const auto moved = moved_calibrations(session, calibration)) result.geometry_sigma = geometry_sigma(session, calibration, *moved);
  // The irradiance of a light falls with the square of its distance.
  result.table.scale_sigma = std::hypot(drift_scale_sigma(session, calibration), calibration.scale_sigma, 2 * result.geometry_sigma.distance);
  return result;
}

}  // namespace lacquer::calib
