#include "libcalib/paint_evidence.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <optional>

#include "libbrdf/error.h"
#include "libcalib/paint_elimination.h"
#include "libcalib/paint_lens.h"
#include "libcalib/paint_scene.h"
#include "libcalib/paint_spline.h"

namespace lacquer::calib {

namespace {

constexpr double highest_theta_h = 1.25, highest_theta_d = 1.25;

class Evidence {
 public:
  Evidence(const std::vector<PaintSample>& samples, const std::vector<PaintView>& views, const GeometryUnknowns& unknowns, const std::vector<double>& x,
           const PaintOptions& options, const std::vector<PaintTrack>& tracks)
      : tracks_(tracks), lens_(unknowns, x), moved_(through(lens_, samples)), samples_(lens_.known() ? samples : moved_), views_(views), options_(options), geometry_(unknowns.geometry(x)), visible_(unknowns.visible(geometry_, x)), n_unknowns_(x.size()),
        sphere_{glm::transpose(geometry_.cam_from_rig.rotation), geometry_.cam_from_rig.translation, geometry_.sphere_radius},
        scenes_(scenes_of(geometry_, unknowns.turntable_scale(x), views)), nuisances_(geometry_, views, options),
        spline_(options.lowest_theta_h, highest_theta_h, highest_theta_d), weight_(samples.size()), residual_(samples.size()), bend_(samples.size()), by_blur_(samples.size()), log_radiance_(samples.size()), seen_(samples.size()), slope_(samples.size()), coefficients_(PaintSpline::size) {
    for (std::size_t i = 0; i < samples.size(); ++i)
      log_radiance_[i] = samples[i].log_radiance + std::log1p(-std::min(0.5, options.glare * std::exp(samples[i].log_mean - samples[i].log_radiance)));
    constexpr double step = 1e-3;
    {
      std::vector<PaintView> up = views, down = views;
      for (PaintView& v : up) v.turntable_angle += step;
      for (PaintView& v : down) v.turntable_angle -= step;
      const std::vector<PaintScene> s = scenes_of(geometry_, unknowns.turntable_scale(x), up), t = scenes_of(geometry_, unknowns.turntable_scale(x), down);
      for (std::size_t v = 0; v < views.size(); ++v) turn_.push_back({(s[v].light - t[v].light) / (2 * step), (s[v].axis - t[v].axis) / (2 * step)});
    }
    for (std::size_t k = 0; k < n_unknowns_; ++k) {
      std::vector<double> up = x, down = x;
      up[k] += step;
      down[k] -= step;
      const acquire::RigGeometry a = unknowns.with_visible_moved(x, k, step), b = unknowns.with_visible_moved(x, k, -step);
      const std::vector<PaintScene> s = scenes_of(a, unknowns.turntable_scale(up), views), t = scenes_of(b, unknowns.turntable_scale(down), views);
      sphere_motion_.push_back((a.cam_from_rig.translation - b.cam_from_rig.translation) / (2 * step));
      motion_.emplace_back();
      for (std::size_t v = 0; v < views.size(); ++v) motion_.back().push_back({(s[v].light - t[v].light) / (2 * step), (s[v].axis - t[v].axis) / (2 * step)});
    }
  }

  PaintEvidence find() {
    choose();
    PaintEvidence e;
    if (n_used_ < 4 * PaintSpline::size) return e;
    fit_paint();
    for (int pass = 0; pass < 2; ++pass) {
      weigh();
      if (pass == 0) find_bends();
      fit_paint();
    }
    e.n_samples = n_used_;
    e.scatter = scatter_;
    const PaintElimination rest = joint();
    e.view_sigma = rest.view_sigma();
    std::vector<double> sigmas;
    for (const PaintNuisances::Column& c : nuisances_.columns) sigmas.push_back(c.sigma);
    add_rows(rest, scatter_of_tiles(rest), sigmas, visible_, e.geometry);
    for (const PaintView& v : views_) e.geometry.views.push_back({v.light, v.turntable_angle});
    e.geometry.has_tracks = !tracks_.empty();
    return e;
  }

 private:
  static std::vector<PaintSample> through(const PaintLens& lens, const std::vector<PaintSample>& samples) {
    if (lens.known()) return {};
    std::vector<PaintSample> moved = samples;
    tbb::parallel_for(std::size_t{0}, moved.size(), [&](std::size_t i) { moved[i].sight = lens.moved(moved[i].sight); });
    return moved;
  }

  std::size_t n_columns() const { return n_unknowns_ + nuisances_.columns.size(); }

  /// In fixed pieces, added up in order: the result does not depend on the number of threads.
  template <typename Body>
  void each_piece(const Body& body) const {
    tbb::parallel_for(std::size_t{0}, n_pieces, [&](std::size_t p) { body(p, samples_.size() * p / n_pieces, samples_.size() * (p + 1) / n_pieces); });
  }

  /// Derivatives of ln(radiance) by the light's place and the sphere's, at a sample.
  struct Slope {
    glm::dvec3 by_light, by_sphere;
  };

  std::optional<SeenPaint> usable(std::size_t i) const {
    const auto seen = see(sphere_, scenes_[samples_[i].view], samples_[i].sight);
    if (!seen || seen->cos_i < options_.min_cosine || seen->cos_o < options_.min_cosine || !spline_.contains(seen->coordinates)) return std::nullopt;
    return seen;
  }

  void choose() {
    each_piece([&](std::size_t, std::size_t first, std::size_t last) {
      for (std::size_t i = first; i < last; ++i)
        if (const auto seen = usable(i)) {
          seen_[i] = *seen;
          weight_[i] = 1 / (samples_[i].variance + scatter_ * scatter_);
        }
    });
    n_used_ = static_cast<std::size_t>(std::count_if(weight_.begin(), weight_.end(), [](double w) { return w > 0; }));
  }

  double paint_at(const brdf::HalfDiff& c) const {
    const PaintSpline::Basis b = spline_.at(c);
    double sum = 0;
    for (std::size_t k = 0; k < PaintSpline::n_met; ++k) sum += b.value[k] * coefficients_[b.index[k]];
    return sum;
  }

  /// The paint at this geometry, and what it leaves.
  void fit_paint() {
    struct Sums {
      SplineMatrix paint;
      std::vector<double> paint_residual = std::vector<double>(PaintSpline::size);
    };
    std::vector<Sums> sums(n_pieces);
    each_piece([&](std::size_t p, std::size_t first, std::size_t last) {
      for (std::size_t i = first; i < last; ++i) {
        if (!(weight_[i] > 0)) continue;
        const SeenPaint& seen = seen_[i];
        const PaintSpline::Basis b = spline_.at(seen.coordinates);
        const double y = weight_[i] * (log_radiance_[i] - seen.log_irradiance - bend_[i]);
        sums[p].paint.add(b, weight_[i]);
        for (std::size_t k = 0; k < PaintSpline::n_met; ++k) sums[p].paint_residual[b.index[k]] += y * b.value[k];
      }
    });
    for (std::size_t p = 1; p < n_pieces; ++p) {
      sums[0].paint.add(sums[p].paint);
      for (std::size_t k = 0; k < PaintSpline::size; ++k) sums[0].paint_residual[k] += sums[p].paint_residual[k];
    }
    sums[0].paint.add_smoothness(smoothness);
    sums[0].paint.factor();
    coefficients_ = sums[0].paint_residual;
    sums[0].paint.solve_lower(coefficients_);
    sums[0].paint.solve_upper(coefficients_);
    each_piece([&](std::size_t, std::size_t first, std::size_t last) {
      for (std::size_t i = first; i < last; ++i) {
        if (!(weight_[i] > 0)) continue;
        const SeenPaint& seen = seen_[i];
        residual_[i] = log_radiance_[i] - seen.log_irradiance - paint_at(seen.coordinates) - bend_[i];
      }
    });
  }

  /// By how much the mean of a block is more than its middle, to second order: logarithms are averaged over the block, radiances by lens
  /// and pixel.
  void find_bends() {
    each_piece([&](std::size_t, std::size_t first, std::size_t last) {
      for (std::size_t i = first; i < last; ++i) {
        if (!(weight_[i] > 0)) continue;
        const PaintSample& s = samples_[i];
        double sum = 0, twist = 0;
        glm::dvec2 slope(0.0);
        bool all = true;
        for (const double u : {-1.0, 1.0})
          for (const double v : {-1.0, 1.0}) {
            const auto seen = see(sphere_, scenes_[s.view], glm::normalize(s.sight + u * s.spread[0] + v * s.spread[1]));
            all = all && seen;
            if (!seen) continue;
            const double level = seen->log_irradiance + paint_at(seen->coordinates);
            sum += level / 4;
            twist += u * v * level / 4;
            slope += glm::dvec2(u, v) * (level / 4);
          }
        const double bend = sum - seen_[i].log_irradiance - paint_at(seen_[i].coordinates);
        by_blur_[i] = all ? bend + 0.5 * glm::dot(slope, slope) : 0;
        bend_[i] = all ? s.moment * bend + s.skew * twist + options_.blur * by_blur_[i] : 0;
      }
    });
  }

  /// Scatter about the paint beyond the noise, by medians; then each sample's weight.
  void weigh() {
    std::vector<double> sizes, variances;
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      if (!(weight_[i] > 0)) continue;
      sizes.push_back(std::abs(residual_[i]));
      variances.push_back(samples_[i].variance);
    }
    const auto median = [](std::vector<double>& v) {
      const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
      std::nth_element(v.begin(), middle, v.end());
      return *middle;
    };
    constexpr double least = 0.001, median_of_normal = 0.67449, cauchy = 3;
    const double size = median(sizes) / median_of_normal;
    scatter_ = std::sqrt(std::max(least * least, size * size - median(variances)));
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      if (!(weight_[i] > 0)) continue;
      const double variance = samples_[i].variance + scatter_ * scatter_;
      weight_[i] = 1 / (variance * (1 + residual_[i] * residual_[i] / (cauchy * cauchy * variance)));
    }
  }

  Slope slope_at(std::size_t i) const {
    const PaintSample& sample = samples_[i];
    const SeenPaint& seen = seen_[i];
    const PaintScene& scene = scenes_[sample.view];
    const double step = 1e-6 * sphere_.radius, here = seen.log_irradiance + paint_at(seen.coordinates);
    const auto change = [&](const PaintSphere& sphere, const PaintScene& moved) {
      const auto s = see(sphere, moved, sample.sight);
      return s ? (s->log_irradiance + paint_at(s->coordinates) - here) / step : 0.0;
    };
    Slope slope;
    for (int k = 0; k < 3; ++k) {
      PaintScene lit = scene;
      lit.light[k] += step;
      slope.by_light[k] = change(sphere_, lit);
      PaintSphere moved = sphere_;
      moved.translation[k] += step;
      slope.by_sphere[k] = change(moved, scene);
    }
    return slope;
  }

  glm::dvec3 axis_slope(std::size_t i) const {
    const PaintScene& scene = scenes_[samples_[i].view];
    return scene.falloff * seen_[i].wi / glm::dot(seen_[i].wi, scene.axis);
  }

  double angle_slope(std::size_t i) const {
    const PaintMotion& turn = turn_[samples_[i].view];
    return glm::dot(slope_[i].by_light, turn.light) + glm::dot(axis_slope(i), turn.axis);
  }

  /// Derivatives of ln(radiance) by all columns, at a sample.
  void derivatives(std::size_t i, std::vector<double>& d) const {
    const PaintSample& sample = samples_[i];
    const SeenPaint& seen = seen_[i];
    const PaintScene& scene = scenes_[sample.view];
    const glm::dvec3 by_axis = axis_slope(i);
    for (std::size_t k = 0; k < n_unknowns_; ++k) {
      const PaintMotion& m = motion_[k][sample.view];
      d[k] = glm::dot(slope_[i].by_light, m.light) + glm::dot(by_axis, m.axis) + glm::dot(slope_[i].by_sphere, sphere_motion_[k]);
    }
    if (!lens_.known()) {
      // A sight that turns sees what one that stays does of a scene that turns back about the camera.
      const std::array<glm::dvec3, PaintLens::max_unknowns> turns = lens_.turns(sample.sight);
      const glm::dmat3 cam_from_rig = glm::transpose(sphere_.rig_from_cam);
      for (std::size_t k = 0; k < lens_.size(); ++k) {
        const auto back = [&](const glm::dvec3& v) { return -(sphere_.rig_from_cam * glm::cross(turns[k], cam_from_rig * v)); };
        d[lens_.first() + k] += glm::dot(slope_[i].by_light, back(scene.light)) + glm::dot(by_axis, back(scene.axis)) -
                                glm::dot(slope_[i].by_sphere, glm::cross(turns[k], sphere_.translation));
      }
    }
    for (std::size_t k = 0; k < nuisances_.columns.size(); ++k) {
      using Kind = PaintNuisances::Column::Kind;
      const PaintNuisances::Column& c = nuisances_.columns[k];
      double& by = d[n_unknowns_ + k];
      if (c.kind == Kind::blur) by = by_blur_[i];
      // Over the radiance of the fit: the sample's own would tie the column to its noise.
      else if (c.kind == Kind::glare) by = std::exp(sample.log_mean - (seen.log_irradiance + paint_at(seen.coordinates) + bend_[i]));
      else by = nuisances_.derivative(c, sample, views_[sample.view], scene, seen);
    }
  }

  std::vector<double> track_columns(const PaintTrack& t) const {
    std::vector<double> d = t.by;
    d.resize(n_columns());
    return d;
  }

  PaintElimination joint() {
    std::vector<PaintSums> sums;
    for (std::size_t p = 0; p < n_pieces; ++p) sums.emplace_back(n_columns(), views_.size());
    each_piece([&](std::size_t p, std::size_t first, std::size_t last) {
      std::vector<double> d(n_columns());
      for (std::size_t i = first; i < last; ++i) {
        if (!(weight_[i] > 0)) continue;
        slope_[i] = slope_at(i);
        derivatives(i, d);
        sums[p].add(spline_.at(seen_[i].coordinates), d, samples_[i].view, angle_slope(i), weight_[i], residual_[i]);
      }
    });
    for (std::size_t p = 1; p < n_pieces; ++p) {
      sums[0].add(sums[p]);
      sums[p] = PaintSums(0, 0);
    }
    for (const PaintTrack& t : tracks_) sums[0].add_track(track_columns(t), t.view, 1 / (t.sigma * t.sigma), t.angle);
    std::vector<double> priors(n_unknowns_, 1.0);
    for (const PaintNuisances::Column& c : nuisances_.columns) priors.push_back(c.sigma);
    return PaintElimination(std::move(sums[0]), smoothness, priors, options_.angle_rad);
  }

  /// Covariance of the gradient: sum over tiles of the views of s s', s the tile's sum of w r d with what paint and view take of both; and
  /// what the views' own factors and angles leave, which all tiles of a view share.
  SymmetricMatrix scatter_of_tiles(const PaintElimination& rest) const {
    const std::size_t n = n_columns(), n_tiles = views_.size() * paint_tiles_across * paint_tiles_across;
    std::vector<Columns> scores(n_pieces), turns(n_pieces), factors(n_pieces);
    each_piece([&](std::size_t p, std::size_t first, std::size_t last) {
      scores[p].assign(n_tiles, {});
      turns[p].assign(views_.size(), std::vector<double>(n));
      factors[p] = turns[p];
      std::vector<double> d(n);
      for (std::size_t i = first; i < last; ++i) {
        if (!(weight_[i] > 0)) continue;
        const std::size_t view = samples_[i].view;
        derivatives(i, d);
        const double by_angle = angle_slope(i), r = rest.project(spline_.at(seen_[i].coordinates), view, by_angle, residual_[i], d);
        std::vector<double>& score = scores[p][view * paint_tiles_across * paint_tiles_across + samples_[i].tile];
        if (score.empty()) score.assign(n, 0.0);
        for (std::size_t c = 0; c < n; ++c) {
          score[c] += weight_[i] * r * d[c];
          turns[p][view][c] += weight_[i] * by_angle * d[c];
          factors[p][view][c] += weight_[i] * d[c];
        }
      }
    });
    SymmetricMatrix m(n);
    const auto add_square = [&](const std::vector<double>& s, double variance) {
      for (std::size_t r = 0; r < n; ++r)
        for (std::size_t c = 0; c <= r; ++c) m.at(r, c) += variance * s[r] * s[c];
    };
    const auto add_to_first = [](std::vector<Columns>& pieces, std::size_t k) {
      for (std::size_t p = 1; p < n_pieces; ++p)
        for (std::size_t c = 0; c < pieces[p][k].size(); ++c) {
          if (pieces[0][k].empty()) pieces[0][k].assign(pieces[p][k].size(), 0.0);
          pieces[0][k][c] += pieces[p][k][c];
        }
    };
    std::size_t n_filled = 0;
    for (std::size_t t = 0; t < n_tiles; ++t) {
      add_to_first(scores, t);
      if (scores[0][t].empty()) continue;
      ++n_filled;
      add_square(scores[0][t], 1);
    }
    for (const PaintTrack& t : tracks_) {
      std::vector<double> d = track_columns(t);
      const double w = 1 / (t.sigma * t.sigma), r = rest.project_track(t.view, t.angle, d);
      for (std::size_t c = 0; c < n; ++c) turns[0][t.view][c] += w * d[c];
      for (double& v : d) v *= w * r;
      add_square(d, 1);
    }
    m.scale(static_cast<double>(n_filled) / std::max(1.0, static_cast<double>(n_filled) - static_cast<double>(n)));
    for (std::size_t v = 0; v < views_.size(); ++v) {
      add_to_first(turns, v);
      add_to_first(factors, v);
      add_square(turns[0][v], options_.angle_rad * options_.angle_rad);
      add_square(factors[0][v], rest.view_sigma() * rest.view_sigma());
    }
    return m;
  }

  static constexpr std::size_t n_pieces = 8;
  static constexpr double smoothness = 4;  // second differences of ln f of 0.5 and more are not expected

  const std::vector<PaintTrack>& tracks_;
  PaintLens lens_;
  std::vector<PaintSample> moved_;  ///< through the lens as it is now, where it is an unknown
  const std::vector<PaintSample>& samples_;
  const std::vector<PaintView>& views_;
  PaintOptions options_;
  acquire::RigGeometry geometry_;
  std::vector<double> visible_;
  std::size_t n_unknowns_, n_used_ = 0;
  PaintSphere sphere_;
  std::vector<PaintScene> scenes_;
  PaintNuisances nuisances_;
  std::vector<std::vector<PaintMotion>> motion_;  ///< by unknown and view
  std::vector<PaintMotion> turn_;                 ///< by view, per radian of the turntable
  std::vector<glm::dvec3> sphere_motion_;
  PaintSpline spline_;
  double scatter_ = 0.01;  ///< to begin with
  std::vector<double> weight_, residual_, bend_, by_blur_, log_radiance_;
  std::vector<SeenPaint> seen_;
  std::vector<Slope> slope_;
  std::vector<double> coefficients_;
};

}  // namespace

void PaintOptions::validate() const {
  if (!(lowest_theta_h > 0 && lowest_theta_h < 1)) throw Error(ErrorCode::usage, "lowest_theta_h: expected radians in (0, 1)");
  if (!(min_cosine > 0 && min_cosine < 1)) throw Error(ErrorCode::usage, "min_cosine: expected a number in (0, 1)");
  for (const double s : {aim_rad, falloff, vignetting, light_scale})
    if (!(s > 0 && std::isfinite(s))) throw Error(ErrorCode::usage, "priors of the light's pattern: expected numbers > 0");
  for (const double s : {blur, blur_sigma, glare, angle_rad})
    if (!(s >= 0 && std::isfinite(s))) throw Error(ErrorCode::usage, "blur, stray light and scatter of angles: expected numbers >= 0");
  if (!(glare_sigma > 0 && std::isfinite(glare_sigma))) throw Error(ErrorCode::usage, "glare_sigma: expected a number > 0");
}

PaintEvidence paint_evidence(const std::vector<PaintSample>& samples, const std::vector<PaintView>& views, const GeometryUnknowns& unknowns,
                             const std::vector<double>& x, const PaintOptions& options, const std::vector<PaintTrack>& tracks) {
  options.validate();
  return Evidence(samples, views, unknowns, x, options, tracks).find();
}

}  // namespace lacquer::calib
