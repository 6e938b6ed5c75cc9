#include "libcalib/geometry_residuals.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "libcalib/geometry_projection.h"

namespace lacquer::calib {

namespace {

double median(std::vector<double> v) {
  if (v.empty()) return 0;
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
  return v[v.size() / 2];
}

constexpr double median_of_normal = 0.67449;  // of |normal|

/// Root of the factor by which residuals of a series that agree with their neighbours make its mean less certain than independent ones
/// would: 1 + 2 sum of autocorrelations, up to the first that chance explains.
double shared_factor(const std::vector<double>& series, double sigma) {
  constexpr double extreme = 3;  // outliers must not decide
  std::vector<double> v;
  double mean = 0, power = 0;
  for (const double r : series) v.push_back(std::clamp(r / sigma, -extreme, extreme));
  for (const double r : v) mean += r / static_cast<double>(v.size());
  for (double& r : v) {
    r -= mean;
    power += r * r;
  }
  double sum = 1;
  for (std::size_t lag = 1; 4 * lag < v.size(); ++lag) {
    double c = 0;
    for (std::size_t i = lag; i < v.size(); ++i) c += v[i] * v[i - lag];
    if (!(c / power > 2 / std::sqrt(static_cast<double>(v.size())))) break;
    sum += 2 * c / power;
  }
  return std::sqrt(sum);
}

}  // namespace

GeometryResiduals::GeometryResiduals(const GeometryUnknowns& unknowns, const std::vector<EdgePoint>& edges, const std::vector<Highlight>& highlights,
                                     const GeometryEvidence& evidence)
    : unknowns_(unknowns), edges_(edges), highlights_(highlights), evidence_(evidence), edge_used_(edges.size(), true), highlight_used_(highlights.size(), true),
      track_(highlights.size(), glm::dvec2(0.0)) {
  const acquire::RigGeometry nominal = unknowns.geometry(std::vector<double>(unknowns.size()));
  const glm::dvec2 centre = nominal.camera.project(nominal.cam_from_rig.translation).value_or(nominal.camera.centre);
  for (const EdgePoint& edge : edges) {
    const glm::dvec2 out = edge.pixel - centre;
    sides_.push_back(glm::dot(out, out) > 0 ? glm::normalize(out) : out);
    const auto ray = nominal.camera.unproject(edge.pixel);
    sights_.push_back(ray ? std::optional(ray->direction) : std::nullopt);
  }
}

glm::dvec2 GeometryResiduals::miss(const acquire::RigGeometry& g, double scale, const Highlight& h) {
  const auto pixel = mirror_pixel(g, g.place_light(h.light, h.turntable_angle * scale).position);
  // Beyond the horizon: far away, but finite, so that a step of the solver that leads there is refused.
  return h.pixel - (pixel ? *pixel : glm::dvec2(1e6));
}

double GeometryResiduals::edge_residual(const acquire::RigGeometry& g, const std::vector<double>& x, std::size_t i) const {
  if (!edge_used_[i]) return 0;
  const auto distance = unknowns_.n_lens() > 0 ? silhouette_distance(g, edges_[i].pixel)
                        : sights_[i]           ? silhouette_distance(g, edges_[i].pixel, *sights_[i])
                                               : std::nullopt;
  return (distance.value_or(1e6) - unknowns_.edge_offset(x, sides_[i])) / (edges_[i].sigma * edge_factor_);
}

glm::dvec2 GeometryResiduals::highlight_residual(const acquire::RigGeometry& g, double scale, std::size_t i) const {
  if (!highlight_used_[i]) return glm::dvec2(0.0);
  const glm::dvec2 t = track_[i];
  const double speed = glm::length(t);
  if (!evidence_.has_tracks || !(speed > 0)) return whole_residual(g, scale, i);
  const Highlight& h = highlights_[i];
  const glm::dvec2 c = glm::dvec2(-t.y, t.x) / speed;
  return {glm::dot(miss(g, scale, h), c) / (highlight_factor_ * std::sqrt(c.x * c.x * h.xx + 2 * c.x * c.y * h.xy + c.y * c.y * h.yy)), 0.0};
}

glm::dvec2 GeometryResiduals::whole_residual(const acquire::RigGeometry& g, double scale, std::size_t i) const {
  const Highlight& h = highlights_[i];
  const glm::dvec2 d = miss(g, scale, h), t = track_[i];
  const double f = highlight_factor_ * highlight_factor_, a = angle_sigma_ * angle_sigma_;
  const double xx = f * h.xx + a * t.x * t.x, xy = f * h.xy + a * t.x * t.y, yy = f * h.yy + a * t.y * t.y;
  const double l = std::sqrt(xx), m = xy / l, n = std::sqrt(yy - m * m);  // Cholesky factor of the covariance
  return {d.x / l, (d.y - m * d.x / l) / n};
}

void GeometryResiduals::evidence_residuals(const acquire::RigGeometry& g, const std::vector<double>& x, std::vector<double>& out) const {
  if (evidence_.rows.empty()) return;
  const std::vector<double> v = unknowns_.visible(g, x);
  for (std::size_t k = 0; k < evidence_.rows.size(); ++k) {
    double sum = -evidence_.offset[k];
    for (std::size_t i = 0; i < v.size(); ++i) sum += evidence_.rows[k][i] * v[i];
    out.push_back(sum);
  }
}

std::vector<double> GeometryResiduals::at(const std::vector<double>& x) const {
  const acquire::RigGeometry g = unknowns_.geometry(x);
  const double scale = unknowns_.turntable_scale(x);
  std::vector<double> r;
  r.reserve(n_data() + x.size());
  for (std::size_t i = 0; i < edges_.size(); ++i) r.push_back(edge_residual(g, x, i));
  for (std::size_t i = 0; i < highlights_.size(); ++i) {
    const glm::dvec2 white = highlight_residual(g, scale, i);
    r.push_back(white.x);
    r.push_back(white.y);
  }
  evidence_residuals(g, x, r);
  unknowns_.prior_residuals(x, r);
  return r;
}

std::vector<std::vector<double>> GeometryResiduals::derivatives(const std::vector<double>& x) const {
  constexpr double step = 1e-3;
  std::vector<std::vector<double>> columns(x.size());
  tbb::parallel_for(std::size_t{0}, x.size(), [&](std::size_t k) {
    std::vector<double> up = x, down = x;
    up[k] += step;
    down[k] -= step;
    const auto light = unknowns_.light_of(k);
    if (!light) {
      std::vector<double> a = at(up);
      const std::vector<double> b = at(down);
      for (std::size_t i = 0; i < a.size(); ++i) a[i] = (a[i] - b[i]) / (2 * step);
      columns[k] = std::move(a);
      return;
    }
    // One light moves: only its own highlights do.
    std::vector<double> column(n_data()), prior_up, prior_down;
    const acquire::RigGeometry g = unknowns_.geometry(up), h = unknowns_.geometry(down);
    const double scale = unknowns_.turntable_scale(x);
    for (std::size_t i = 0; i < highlights_.size(); ++i) {
      if (highlights_[i].light != *light) continue;
      const glm::dvec2 d = (highlight_residual(g, scale, i) - highlight_residual(h, scale, i)) / (2 * step);
      column[edges_.size() + 2 * i] = d.x;
      column[edges_.size() + 2 * i + 1] = d.y;
    }
    const glm::dvec3 moved = (g.lights[*light].position - h.lights[*light].position) / (2 * step);
    for (const std::vector<double>& row : evidence_.rows) {
      double sum = 0;
      for (std::size_t c = 0; c < 3; ++c)
        sum += row[unknowns_.first_of(*light) + c] * moved[static_cast<int>(c)] / unknowns_.parameters()[unknowns_.first_of(*light) + c].prior_sigma;
      column.push_back(sum);
    }
    unknowns_.prior_residuals(up, prior_up);
    unknowns_.prior_residuals(down, prior_down);
    for (std::size_t i = 0; i < prior_up.size(); ++i) column.push_back((prior_up[i] - prior_down[i]) / (2 * step));
    columns[k] = std::move(column);
  });
  return columns;
}

double GeometryResiduals::cost(const std::vector<double>& r, double k, std::vector<double>& weight) const {
  weight.assign(r.size(), 1);
  double total = 0;
  for (std::size_t i = 0; i < r.size();) {
    const std::size_t n = i >= edges_.size() && i < n_data() ? 2 : 1;
    double s = 0;
    for (std::size_t c = 0; c < n; ++c) s += r[i + c] * r[i + c];
    if (k > 0 && i < n_data()) {
      total += k * k * std::log1p(s / (k * k));
      for (std::size_t c = 0; c < n; ++c) weight[i + c] = 1 / (1 + s / (k * k));
    } else {
      total += s;
    }
    i += n;
  }
  return total;
}

void GeometryResiduals::measure_noise(const std::vector<double>& x) {
  constexpr std::size_t few = 12;  // fewer do not say: the sigmas given are believed
  constexpr double floor = 0.1;
  edge_factor_ = edge_shared_ = highlight_factor_ = 1;
  angle_sigma_ = 0;
  edge_used_.assign(edges_.size(), true);
  highlight_used_.assign(highlights_.size(), true);
  const acquire::RigGeometry g = unknowns_.geometry(x);
  const double scale = unknowns_.turntable_scale(x);
  // Fitted unknowns take their share of the residuals: of the edges 4, of the highlights at most 8.
  const auto share = [](std::size_t n) { return std::sqrt(static_cast<double>(n) / (static_cast<double>(n) - 4)); };
  std::vector<double> signed_sizes, sizes;
  for (std::size_t i = 0; i < edges_.size(); ++i) {
    signed_sizes.push_back(edge_residual(g, x, i));
    sizes.push_back(std::abs(signed_sizes.back()));
  }
  if (sizes.size() >= few) {
    const double scatter = std::max(floor, share(sizes.size()) * median(sizes) / median_of_normal);
    edge_shared_ = shared_factor(signed_sizes, scatter);
    edge_factor_ = scatter * edge_shared_;
  }

  const std::size_t n = highlights_.size();
  track_.assign(n, glm::dvec2(0.0));
  std::vector<double> across, along, own;
  for (std::size_t i = 0; i < n; ++i) {
    constexpr double step = 1e-5;
    Highlight h = highlights_[i];
    const glm::dvec2 residual = miss(g, scale, h);
    h.turntable_angle += step;
    if (g.lights[h.light].on_arm) track_[i] = (residual - miss(g, scale, h)) / step;
    const double speed = glm::length(track_[i]);
    if (!(speed > 0) || !std::isfinite(speed)) {
      track_[i] = glm::dvec2(0.0);
      continue;
    }
    const glm::dvec2 t = track_[i] / speed, c(-t.y, t.x);
    const auto variance = [&](const glm::dvec2& v) { return v.x * v.x * h.xx + 2 * v.x * v.y * h.xy + v.y * v.y * h.yy; };
    across.push_back(std::abs(glm::dot(residual, c)) / std::sqrt(variance(c)));
    along.push_back(std::abs(glm::dot(residual, t)) / speed);
    own.push_back(variance(t) / (speed * speed));
  }
  if (across.size() < few) return;
  // Never below 1: sigmas of grazing views that are too careful would make the good ones seem better than they are.
  highlight_factor_ = std::max(1.0, share(across.size()) * median(across) / median_of_normal);
  const double total = share(across.size()) * median(along) / median_of_normal;
  angle_sigma_ = std::sqrt(std::max(0.0, total * total - highlight_factor_ * highlight_factor_ * median(own)));
}

ViewAngle GeometryResiduals::angle_of(const acquire::RigGeometry& g, double scale, std::size_t i) const {
  const Highlight& h = highlights_[i];
  const double f = highlight_factor_ * highlight_factor_, a = angle_sigma_ * angle_sigma_;
  const double det = h.xx * h.yy - h.xy * h.xy;
  const glm::dvec2 d = miss(g, scale, h), t = track_[i];
  const auto weighted = [&](const glm::dvec2& v) { return (t.x * (h.yy * v.x - h.xy * v.y) + t.y * (h.xx * v.y - h.xy * v.x)) / (det * f); };
  const double information = weighted(t) + 1 / a;
  return {h.view, weighted(d) / information, 1 / std::sqrt(information)};
}

void GeometryResiduals::select_inliers(const std::vector<double>& x) {
  // 5 sigma: of 270 000 good highlights one is lost. The sigmas come from a median, known to 0.8 / sqrt(n) itself.
  const auto limit = [](std::size_t n) { return 5 * (1 + 2 / std::sqrt(static_cast<double>(std::max<std::size_t>(n, 4)))); };
  edge_used_.assign(edges_.size(), true);
  highlight_used_.assign(highlights_.size(), true);
  const acquire::RigGeometry g = unknowns_.geometry(x);
  const double scale = unknowns_.turntable_scale(x);
  for (std::size_t i = 0; i < edges_.size(); ++i) edge_used_[i] = std::abs(edge_residual(g, x, i)) * edge_shared_ <= limit(edges_.size());
  // Along its track too, where that counts elsewhere: a false one would come in there.
  for (std::size_t i = 0; i < highlights_.size(); ++i) highlight_used_[i] = glm::length(whole_residual(g, scale, i)) <= limit(highlights_.size());
}

SymmetricMatrix normal_matrix(const std::vector<std::vector<double>>& columns, const std::vector<double>& weight) {
  const std::size_t n = columns.size();
  SymmetricMatrix a(n);
  // A light's column is 0 but for its own highlights and priors.
  tbb::parallel_for(std::size_t{0}, n, [&](std::size_t r) {
    std::vector<std::size_t> met;
    for (std::size_t i = 0; i < weight.size(); ++i)
      if (columns[r][i] != 0) met.push_back(i);
    for (std::size_t c = 0; c <= r; ++c) {
      double sum = 0;
      for (const std::size_t i : met) sum += weight[i] * columns[r][i] * columns[c][i];
      a.at(r, c) = sum;
    }
  });
  return a;
}

}  // namespace lacquer::calib
