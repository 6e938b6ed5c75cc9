#include "libcalib/geometry_session.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "libbrdf/error.h"
#include "libcalib/geometry_unknowns.h"
#include "libcalib/highlight_window.h"
#include "libcalib/paint_track.h"
#include "libcalib/pixel_mask.h"

namespace lacquer::calib {

namespace {

std::string counts_text(const std::map<HighlightFate, std::vector<std::string>>& rejected) {
  std::string text;
  for (const auto& [fate, views] : rejected) text += fmt::format("{}{} {}", text.empty() ? "" : ", ", views.size(), describe(fate));
  return text;
}

/// The part of a view that its highlight is looked for in again.
struct Crop {
  RadianceImage image;
  glm::ivec2 corner{0};
};

Crop crop(const RadianceImage& image, const glm::dvec2& centre, double half_px) {
  // Begins at an even pixel: the crop of a mosaic is a mosaic of the same layout.
  const auto first = [&](double at) { return std::max(0, static_cast<int>(std::floor(at - half_px)) & ~1); };
  Crop c;
  c.corner = {first(centre.x), first(centre.y)};
  c.image.layout = image.layout;
  c.image.width = std::clamp(static_cast<int>(std::ceil(centre.x + half_px)) - c.corner.x, 0, std::max(0, image.width - c.corner.x));
  c.image.height = std::clamp(static_cast<int>(std::ceil(centre.y + half_px)) - c.corner.y, 0, std::max(0, image.height - c.corner.y));
  if (c.image.width == 0 || c.image.height == 0) return {};
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(image.layout)), row = static_cast<std::size_t>(c.image.width) * per_pixel;
  const auto copy = [&](const auto& from, auto& to) {
    to.reserve(row * static_cast<std::size_t>(c.image.height));
    for (int y = 0; y < c.image.height; ++y) {
      const auto begin = from.begin() + static_cast<std::ptrdiff_t>((static_cast<std::size_t>(c.corner.y + y) * static_cast<std::size_t>(image.width) +
                                                                     static_cast<std::size_t>(c.corner.x)) * per_pixel);
      to.insert(to.end(), begin, begin + static_cast<std::ptrdiff_t>(row));
    }
  };
  copy(image.radiance, c.image.radiance);
  copy(image.variance, c.image.variance);
  copy(image.flags, c.image.flags);
  return c;
}

class Estimator {
 public:
  Estimator(const std::string& name, const acquire::RigGeometry& nominal, const acquire::MaskDescription& mask, const std::vector<GeometryView>& views,
            const Calibration& calibration, const GeometryOptions& options, const Progress& progress)
      : name_(name), nominal_(nominal), mask_(mask), views_(views), options_(options), progress_(progress), trial_(calibration) {
    result_.n_views = views.size();
    trial_.turntable_scale = 1;
  }

  SessionGeometry find() {
    find_outline();
    read_highlights();
    if (!result_.highlights.empty()) {
      for (int pass = 0; pass < 2; ++pass) {
        solve({});
        measure_again();
      }
      solve({});
    }
    refine_with_paint();
    if (result_.highlights.empty() && result_.paint.n_samples == 0)
      throw Error(ErrorCode::input, fmt::format("{}: no highlight in any of {} views ({}): the lights cannot be found with this sphere; photograph a glossy or chrome "
                                                "sphere of the same radius in its place, or keep the rig file's geometry (--from-rig)",
                                                name_, views_.size(), counts_text(result_.rejected)));
    return std::move(result_);
  }

  const Calibration& calibration() const { return trial_; }

 private:
  template <typename Body>
  void each_view(const std::string& stage, const Body& body) {
    for (std::size_t i = 0; i < views_.size(); ++i) {
      body(i);
      if (progress_) progress_(stage, i + 1, views_.size());
    }
  }

  void find_outline() {
    OutlineOptions outline_options;
    outline_options.lens_blur_px = trial_.lens_blur_px;
    OutlineFinder finder(nominal_, outline_options);
    each_view("silhouette", [&](std::size_t i) { finder.add(views_[i].read(), nominal_.place_light(views_[i].light, views_[i].turntable_angle)); });
    const OutlineFinder::Outline outline = finder.finish();
    trial_.geometry = outline.geometry;
    // The lights stay where they are in the room while the origin moves with the sphere.
    if (!outline.edges.empty()) trial_.geometry = solve_geometry(nominal_, outline.edges, {}, options_.priors).geometry;
    if (!(trial_.lens_blur_px > 0)) trial_.lens_blur_px = outline.lens_blur_px;
    result_.lens_blur_px = outline.lens_blur_px;
    result_.n_arcs = outline.n_arcs;
    result_.n_dark_arcs = outline.n_dark;
    result_.edges = outline.edges;
  }

  void keep(std::size_t i, HighlightResult found) {
    found.highlight.view = views_[i].id;
    if (found.fate == HighlightFate::found)
      result_.highlights.push_back(found.highlight);
    else
      result_.rejected[found.fate].push_back(views_[i].id);
    if (found.fate == HighlightFate::found) widths_.push_back(found.width_rad);
  }

  /// Highlights where the rig file has them; crops about them for the passes to come, and the paint's samples.
  void read_highlights() {
    crops_.resize(views_.size());
    const std::vector<std::uint8_t> mask = paint_mask(mask_, trial_.geometry);
    blocks_ = paint_blocks(trial_.geometry, views_.size());
    each_view("highlights", [&](std::size_t i) {
      RadianceImage image = views_[i].read();
      apply_mask(mask, image);
      const HighlightResult found = find_highlight(image, trial_, views_[i].light, views_[i].turntable_angle, options_.highlights);
      const auto expected = expect_highlight(trial_.geometry, trial_.geometry.place_light(views_[i].light, views_[i].turntable_angle));
      if (expected) {
        const bool seen = found.fate == HighlightFate::found;
        const double slowest = std::min(glm::length(expected->slope_per_pixel[0]), glm::length(expected->slope_per_pixel[1]));
        // What find_highlight looks at with half the search, and some pixels for the lights to move by.
        const double reach = (options_.highlights.search_rad + 4 * (seen ? found.width_rad : 0.03)) / slowest;
        crops_[i] = crop(image, seen ? found.highlight.pixel : expected->pixel, 30 + reach);
      }
      keep(i, found);
      background_.add(image);
      if (options_.use_paint) add_paint_samples(image, trial_, static_cast<std::uint32_t>(i), blocks_, samples_);
    });
  }

  void measure_again() {
    HighlightOptions narrower = options_.highlights;
    narrower.search_rad *= 0.5;
    result_.highlights.clear();
    result_.rejected.clear();
    widths_.clear();
    for (std::size_t i = 0; i < views_.size(); ++i)
      keep(i, crops_[i].image.width > 0 ? find_highlight(crops_[i].image, trial_, views_[i].light, views_[i].turntable_angle, narrower, crops_[i].corner) : HighlightResult{});
  }

  void solve(const GeometryEvidence& evidence) {
    const GeometryUnknowns unknowns(nominal_, options_.priors, lights_with_data(nominal_, result_.highlights, evidence));
    const bool before = std::all_of(unknowns.parameters().begin(), unknowns.parameters().end(),
                                    [&](const GeometryParameter& u) { return named(result_.estimate.uncertainty.parameters, u.name) != nullptr; });
    result_.estimate = solve_geometry(nominal_, result_.edges, result_.highlights, options_.priors, evidence, before ? solution(unknowns) : std::vector<double>{});
    trial_.geometry = result_.estimate.geometry;
    trial_.turntable_scale = result_.estimate.turntable_scale;
  }

  static const GeometryParameter* named(const std::vector<GeometryParameter>& parameters, const std::string& name) {
    const auto at = std::find_if(parameters.begin(), parameters.end(), [&](const GeometryParameter& p) { return p.name == name; });
    return at == parameters.end() ? nullptr : &*at;
  }

  /// In units of the priors; 0 what was not solved for before, as the place of a light without a highlight.
  std::vector<double> solution(const GeometryUnknowns& unknowns) const {
    std::vector<double> x;
    for (const GeometryParameter& u : unknowns.parameters()) {
      const GeometryParameter* const p = named(result_.estimate.uncertainty.parameters, u.name);
      x.push_back(p != nullptr ? p->correction / p->prior_sigma : 0);
    }
    return x;
  }

  /// What the size of the LEDs blurs the sphere's middle by, pixels^2 per axis, mean over the views: the half vector turns by half the angle of the
  /// light, and a uniform disc has a quarter of its squared radius.
  double emitter_variance() const {
    const acquire::RigGeometry& g = trial_.geometry;
    const double radius_px = g.camera.focal.x * g.sphere_radius / g.cam_from_rig.translation.z;
    double sum = 0;
    for (const GeometryView& view : views_) {
      const acquire::Light& light = g.lights[view.light];
      if (!light.distant) sum += std::pow(0.25 * light.diameter / glm::length(light.position) * radius_px, 2) / 4;
    }
    return sum / static_cast<double>(views_.size());
  }

  /// Of the highlights that are no outliers.
  std::vector<PaintTrack> tracks(const GeometryUnknowns& unknowns, const std::vector<double>& x) const {
    std::vector<PaintTrack> found;
    const GeometryEstimate& e = result_.estimate;
    for (std::size_t i = 0; i < views_.size(); ++i) {
      const auto h = std::find_if(result_.highlights.begin(), result_.highlights.end(), [&](const Highlight& c) { return c.view == views_[i].id; });
      const bool outlier = std::any_of(e.outliers.begin(), e.outliers.end(), [&](const auto& o) { return o.view == views_[i].id; });
      if (!(e.angle_sigma_rad > 0) || h == result_.highlights.end() || outlier) continue;
      if (const auto track = paint_track(i, *h, e.highlight_noise_factor, unknowns, x)) found.push_back(*track);
    }
    return found;
  }

  void refine_with_paint() {
    GeometryEvidence evidence;
    std::vector<PaintView> lit;
    for (const GeometryView& view : views_) {
      lit.push_back({view.light, view.turntable_angle, view.factor});
      evidence.views.push_back({view.light, view.turntable_angle});
    }
    const GeometryUnknowns unknowns(nominal_, options_.priors, lights_with_data(nominal_, result_.highlights, evidence));
    const GeometryEstimate before = result_.estimate;
    PaintOptions paint = options_.paint;
    paint.blur = (trial_.lens_blur_px * trial_.lens_blur_px + 1.0 / 12 + emitter_variance()) / blocks_.variance();
    // Anything between nothing and the darkest corner, which may be no stray light at all.
    constexpr double most_glare = 0.003;
    paint.glare = std::min(background_.value() / 2, most_glare);
    paint.glare_sigma = std::max(paint.glare_sigma, paint.glare);
    constexpr double blur_px = 0.1;  // what a lens blur is stated or found to
    paint.blur_sigma = 2 * std::max(trial_.lens_blur_px, blur_px) * blur_px / blocks_.variance();
    if (!widths_.empty()) {
      std::nth_element(widths_.begin(), widths_.begin() + static_cast<std::ptrdiff_t>(widths_.size() / 2), widths_.end());
      constexpr double clear_of_peak = 3.5;  // 1/e radii
      paint.lowest_theta_h = std::clamp(clear_of_peak * widths_[widths_.size() / 2], paint.lowest_theta_h, 0.5);
    }
    // First with a part of the samples: far from the solution it is as good.
    constexpr std::size_t part = 4, enough = 40000;
    std::vector<PaintSample> few;
    for (std::size_t i = 0; i < samples_.size() && samples_.size() > part * enough; i += part) few.push_back(samples_[i]);
    bool all = few.empty();
    double last = 0;  // step with all samples, 0: none yet
    constexpr int max_rounds = 12;
    for (int round = 0, rounds_with_all = 0; round < max_rounds && !samples_.empty(); ++round) {
      const std::vector<double> x = solution(unknowns);
      paint.angle_rad = result_.estimate.angle_sigma_rad;
      const PaintEvidence found = paint_evidence(all ? samples_ : few, lit, unknowns, x, paint, tracks(unknowns, x));
      rounds_with_all += all;
      if (found.n_samples == 0) {
        if (all) return;
        all = true;
        continue;
      }
      solve(found.geometry);
      result_.paint.n_samples = found.n_samples;
      result_.paint.scatter = found.scatter;
      double largest = 0;
      const std::vector<double> now = solution(unknowns);
      for (std::size_t k = 0; k < now.size(); ++k) {
        const GeometryParameter& p = result_.estimate.uncertainty.parameters[k];
        largest = std::max(largest, std::abs(now[k] - x[k]) * p.prior_sigma / p.sigma);
      }
      if (progress_) progress_("paint", static_cast<std::size_t>(round) + 1, max_rounds);
      // Steps shrink by a factor, which says how far the next one would go. Noise is measured by medians, which may keep a last step from dying away.
      constexpr double negligible = 0.2;  // of a sigma: 2 % of the error
      if (all && (largest < negligible || (last > 0 && largest * largest / last < negligible) || (rounds_with_all >= 3 && largest < 1))) break;
      last = all ? largest : 0;
      all = all || largest < 0.5 || round >= max_rounds / 2;
    }
    for (GeometryParameter& q : result_.estimate.uncertainty.parameters)
      if (const GeometryParameter* const p = named(before.uncertainty.parameters, q.name)) q.paint_shift = (q.correction - p->correction) / p->sigma;
    result_.paint.distance_sigma_before = before.distance_sigma;
    result_.paint.half_vector_sigma_before = before.half_vector_sigma_rad;
  }

  const std::string& name_;
  const acquire::RigGeometry& nominal_;
  const acquire::MaskDescription& mask_;
  const std::vector<GeometryView>& views_;
  const GeometryOptions& options_;
  const Progress& progress_;
  Calibration trial_;
  SessionGeometry result_;
  std::vector<Crop> crops_;
  std::vector<double> widths_;
  PaintBlocks blocks_;
  std::vector<PaintSample> samples_;
  BackgroundShare background_;
};

}  // namespace

SessionGeometry estimate_geometry(const std::string& name, const acquire::RigGeometry& nominal, const acquire::MaskDescription& mask,
                                  const std::vector<GeometryView>& views, Calibration& calibration, const GeometryOptions& options,
                                  const Progress& progress) {
  GeometryOptions with_lens = options;
  if (with_lens.priors.lens_covariance.empty()) with_lens.priors.lens_covariance = calibration.lens_covariance;
  Estimator estimator(name, nominal, mask, views, calibration, with_lens, progress);
  SessionGeometry result = estimator.find();
  calibration.geometry = result.estimate.geometry;
  calibration.turntable_scale = result.estimate.turntable_scale;
  if (!(calibration.lens_blur_px > 0)) calibration.lens_blur_px = result.lens_blur_px;
  calibration.geometry_uncertainty = result.estimate.uncertainty;
  calibration.geometry_source = result.paint.n_samples == 0 ? "estimated from highlights and silhouette" : result.highlights.empty() ? "estimated from silhouette and light on the paint"
                                                                                                          : "estimated from highlights, silhouette and light on the paint";
  return result;
}

std::vector<GeometryView> geometry_views(const acquire::Session& session, const Calibration& calibration) {
  const acquire::RigDescription& rig = session.rig;
  std::vector<GeometryView> views;
  for (const std::size_t i : session.views_of(acquire::ViewKind::measurement)) {
    const acquire::ViewRecord& view = session.views[i];
    views.push_back({view.id, static_cast<std::size_t>(view.light), view.turntable_angle, calibration.light_factor(view).factor, [&rig, file = session.radiance_path(view)] {
                       RadianceImage image = read_radiance(file);
                       if (image.width != rig.geometry.camera.width || image.height != rig.geometry.camera.height || image.layout != rig.sensor.layout)
                         throw Error(ErrorCode::file, fmt::format("{}: expected {}x{} {}, as the rig's camera", file.string(), rig.geometry.camera.width,
                                                                  rig.geometry.camera.height, name_of(rig.sensor.layout)));
                       return image;
                     }});
  }
  return views;
}

SessionGeometry estimate_geometry(const acquire::Session& session, Calibration& calibration, const GeometryOptions& options, const Progress& progress) {
  return estimate_geometry(session.folder.string(), session.rig.geometry, session.rig.mask, geometry_views(session, calibration), calibration, options, progress);
}

}  // namespace lacquer::calib
