#include "libcalib/geometry_solver.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <opencv2/core.hpp>

#include "libbrdf/error.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

namespace {

constexpr double pi = 3.14159265358979323846;

glm::dvec3 rotate(const glm::dvec3& p, const glm::dvec3& axis, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return c * p + s * glm::cross(axis, p) + (1 - c) * glm::dot(axis, p) * axis;
}

/// Normal of the reflecting point, as the angle from the camera's direction towards the light's, both `to_light` apart and seen from the
/// sphere's centre; lengths in radii. Alhazen's problem: the normal bisects the directions to camera and light.
std::optional<double> reflecting_angle(double camera, double light, double to_light) {
  if (!(camera > 1 && light > 1)) return std::nullopt;
  const auto excess = [&](double a) {
    return std::atan2(light * std::sin(to_light - a), light * std::cos(to_light - a) - 1) - std::atan2(camera * std::sin(a), camera * std::cos(a) - 1);
  };
  double low = 0, high = to_light;  // excess falls from > 0 to < 0
  double a = 0.5 * to_light;
  for (int i = 0; i < 100; ++i) {
    const double f = excess(a);
    (f > 0 ? low : high) = a;
    const auto slope = [](double d, double angle) { return d * (d - std::cos(angle)) / (d * d - 2 * d * std::cos(angle) + 1) ; };
    double next = a + f / (slope(light, to_light - a) + slope(camera, a));
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - a) < 1e-15) break;
    a = next;
  }
  if (!(camera * std::cos(a) > 1 && light * std::cos(to_light - a) > 1)) return std::nullopt;  // behind the horizon of one of them
  return a;
}

/// The unknowns: corrections of the rig file's numbers, in units of their priors' sigmas.
class Problem {
 public:
  Problem(const acquire::RigGeometry& nominal, const GeometryPriors& priors, const std::vector<Highlight>& highlights)
      : nominal_(nominal), priors_(priors), seen_(nominal.lights.size()) {
    for (const Highlight& h : highlights) seen_.at(h.light) = true;
    const glm::dvec3 axis = glm::normalize(nominal.axis_direction);
    const glm::dvec3 helper = std::abs(axis.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 0, 1);
    across_[0] = glm::normalize(helper - axis * glm::dot(helper, axis));
    across_[1] = glm::cross(across_[0], axis);  // for the axis y: x and z
    const char* const letters[] = {"x", "y", "z"};
    for (int k = 0; k < 3; ++k) add(fmt::format("sphere.{}", letters[k]), "m", 0, priors.sphere_m);
    add("edge offset", "px", 0, priors.edge_offset_px);
    if (std::none_of(seen_.begin(), seen_.end(), [](bool s) { return s; })) return;
    first_axis_ = parameters_.size();
    add("axis.tilt_a", "rad", 0, priors.axis_tilt_rad);
    add("axis.tilt_b", "rad", 0, priors.axis_tilt_rad);
    add("axis.a", "m", glm::dot(nominal.axis_point, across_[0]), priors.axis_point_m);
    add("axis.b", "m", glm::dot(nominal.axis_point, across_[1]), priors.axis_point_m);
    add("zero angle", "rad", 0, priors.zero_angle_rad);
    add("step scale", "1", 1, priors.turntable_scale);
    for (std::size_t i = 0; i < seen_.size(); ++i) {
      first_light_.push_back(parameters_.size());
      if (!seen_[i]) continue;
      const acquire::Light& light = nominal.lights[i];
      const std::string name = light.name.empty() ? fmt::format("light {}", i + 1) : fmt::format("light {}", light.name);
      for (int k = 0; k < 3; ++k) {
        const double along = priors.arm * light.position[k];
        add(fmt::format("{}.{}", name, letters[k]), "m", light.position[k], std::hypot(priors.light_m, along));
      }
    }
  }

  const std::vector<GeometryParameter>& parameters() const { return parameters_; }
  std::size_t size() const { return parameters_.size(); }
  bool has_lights() const { return first_axis_ > 0; }
  double edge_offset(const std::vector<double>& x) const { return x[3] * parameters_[3].prior_sigma; }
  double turntable_scale(const std::vector<double>& x) const { return has_lights() ? 1 + value(x, first_axis_ + 5) : 1; }

  acquire::RigGeometry geometry(const std::vector<double>& x) const {
    acquire::RigGeometry g = nominal_;
    const glm::dvec3 sphere(value(x, 0), value(x, 1), value(x, 2));
    g.cam_from_rig.translation += g.cam_from_rig.rotation * sphere;
    g.axis_point -= sphere;
    if (!has_lights()) {
      for (acquire::Light& light : g.lights) light.position -= sphere;
      return g;
    }
    g.axis_direction = rotate(rotate(g.axis_direction, across_[0], value(x, first_axis_)), across_[1], value(x, first_axis_ + 1));
    g.axis_point += value(x, first_axis_ + 2) * across_[0] + value(x, first_axis_ + 3) * across_[1];
    const double zero = value(x, first_axis_ + 4);
    for (std::size_t i = 0; i < g.lights.size(); ++i) {
      acquire::Light& light = g.lights[i];
      if (light.distant) continue;
      light.position -= sphere;
      if (seen_[i])
        for (int k = 0; k < 3; ++k) light.position[k] += value(x, first_light_[i] + static_cast<std::size_t>(k));
      if (light.on_arm) light.position = g.axis_point + rotate(light.position - g.axis_point, g.axis_direction, zero);
    }
    return g;
  }

  /// Residuals of the priors, over sigma. A light's errors are those of a ruler (light_m) and of the arm's length, which is along its place.
  void prior_residuals(const std::vector<double>& x, std::vector<double>& out) const {
    std::size_t n_plain = first_light_.empty() ? size() : first_light_.front();
    for (std::size_t i = 0; i < n_plain; ++i) out.push_back(x[i]);
    for (std::size_t i = 0; i < first_light_.size(); ++i) {
      if (!seen_[i]) continue;
      const glm::dvec3& p = nominal_.lights[i].position;
      const double length = glm::length(p);
      const glm::dvec3 u = p / length;
      const glm::dvec3 d(value(x, first_light_[i]), value(x, first_light_[i] + 1), value(x, first_light_[i] + 2));
      const double along = glm::dot(d, u);
      const glm::dvec3 white = (d - along * u) / priors_.light_m + u * (along / std::hypot(priors_.light_m, priors_.arm * length));
      for (int k = 0; k < 3; ++k) out.push_back(white[k]);
    }
  }

 private:
  void add(std::string name, std::string unit, double nominal, double sigma) {
    parameters_.push_back({std::move(name), std::move(unit), nominal, 0, 0, sigma});
  }
  double value(const std::vector<double>& x, std::size_t i) const { return x[i] * parameters_[i].prior_sigma; }

  acquire::RigGeometry nominal_;
  GeometryPriors priors_;
  std::vector<bool> seen_;
  glm::dvec3 across_[2];
  std::vector<GeometryParameter> parameters_;
  std::size_t first_axis_ = 0;
  std::vector<std::size_t> first_light_;
};

glm::dvec2 predicted(const acquire::RigGeometry& g, double scale, const Highlight& h) {
  const auto pixel = mirror_pixel(g, g.place_light(h.light, h.turntable_angle * scale).position);
  // Beyond the horizon: far away, but finite, so that a step of the solver that leads there is refused.
  return pixel ? *pixel : glm::dvec2(1e6);
}

/// Data, weights and what of them is in use.
struct Data {
  const std::vector<EdgePoint>& edges;
  const std::vector<Highlight>& highlights;
  std::vector<bool> edge_used, highlight_used;
  double edge_factor = 1, highlight_factor = 1;
  double angle_sigma = 0;               ///< of the turntable's angles, radians, found from the residuals along the highlights' tracks
  std::vector<glm::dvec2> track = {};   ///< pixels per radian of the turntable, per highlight; empty: not needed yet

  /// Residuals over sigma: one per edge, two (uncorrelated) per highlight, then the priors. Those not in use are 0.
  std::vector<double> residuals(const Problem& problem, const std::vector<double>& x) const {
    const acquire::RigGeometry g = problem.geometry(x);
    const double offset = problem.edge_offset(x), scale = problem.turntable_scale(x);
    std::vector<double> r;
    r.reserve(edges.size() + 2 * highlights.size() + x.size());
    for (std::size_t i = 0; i < edges.size(); ++i) {
      const auto distance = edge_used[i] ? silhouette_distance(g, edges[i].pixel) : std::optional<double>(0.0);
      r.push_back(edge_used[i] ? (distance.value_or(1e6) - offset) / (edges[i].sigma * edge_factor) : 0);
    }
    for (std::size_t i = 0; i < highlights.size(); ++i) {
      const Highlight& h = highlights[i];
      glm::dvec2 white(0.0);
      if (highlight_used[i]) {
        const glm::dvec2 d = h.pixel - predicted(g, scale, h);
        const double f = highlight_factor * highlight_factor, g2 = angle_sigma * angle_sigma;
        const glm::dvec2 t = track.empty() ? glm::dvec2(0.0) : track[i];
        const double xx = f * h.xx + g2 * t.x * t.x, xy = f * h.xy + g2 * t.x * t.y, yy = f * h.yy + g2 * t.y * t.y;
        const double l = std::sqrt(xx), m = xy / l, n = std::sqrt(yy - m * m);  // Cholesky factor of the covariance
        white = glm::dvec2(d.x / l, (d.y - m * d.x / l) / n);
      }
      r.push_back(white.x);
      r.push_back(white.y);
    }
    problem.prior_residuals(x, r);
    return r;
  }
  std::size_t n_data() const { return edges.size() + 2 * highlights.size(); }
};

struct Columns {
  std::vector<std::vector<double>> d;  ///< by unknown: derivative of every residual
};

/// Central differences. All functions are smooth and exact to rounding: error about 1e-9 of the derivative.
Columns derivatives(const Data& data, const Problem& problem, const std::vector<double>& x) {
  constexpr double step = 1e-3;
  Columns columns;
  for (std::size_t k = 0; k < x.size(); ++k) {
    std::vector<double> up = x, down = x;
    up[k] += step;
    down[k] -= step;
    std::vector<double> a = data.residuals(problem, up);
    const std::vector<double> b = data.residuals(problem, down);
    for (std::size_t i = 0; i < a.size(); ++i) a[i] = (a[i] - b[i]) / (2 * step);
    columns.d.push_back(std::move(a));
  }
  return columns;
}

SymmetricMatrix normal_matrix(const Columns& j, const std::vector<double>& weight) {
  const std::size_t n = j.d.size();
  SymmetricMatrix a(n);
  for (std::size_t r = 0; r < n; ++r)
    for (std::size_t c = 0; c <= r; ++c) {
      double sum = 0;
      for (std::size_t i = 0; i < weight.size(); ++i) sum += weight[i] * j.d[r][i] * j.d[c][i];
      a.at(r, c) = sum;
    }
  return a;
}

/// Cauchy loss of scale `k` on each datum (a highlight is one datum of two residuals); k = 0: squares. Returns the cost, sets weights.
double robust_cost(const Data& data, const std::vector<double>& r, double k, std::vector<double>& weight) {
  weight.assign(r.size(), 1);
  double cost = 0;
  const std::size_t n_edges = data.edges.size(), n_data = data.n_data();
  for (std::size_t i = 0; i < r.size();) {
    const std::size_t n = i >= n_edges && i < n_data ? 2 : 1;
    double s = 0;
    for (std::size_t c = 0; c < n; ++c) s += r[i + c] * r[i + c];
    if (k > 0 && i < n_data) {
      cost += k * k * std::log1p(s / (k * k));
      for (std::size_t c = 0; c < n; ++c) weight[i + c] = 1 / (1 + s / (k * k));
    } else {
      cost += s;
    }
    i += n;
  }
  return cost;
}

/// Levenberg-Marquardt (iteratively reweighted). True: it converged.
bool minimise(const Data& data, const Problem& problem, double cauchy, std::vector<double>& x) {
  std::vector<double> weight, trial_weight;
  std::vector<double> r = data.residuals(problem, x);
  double cost = robust_cost(data, r, cauchy, weight), damping = 1e-4;
  for (int iteration = 0; iteration < 200; ++iteration) {
    const Columns j = derivatives(data, problem, x);
    const SymmetricMatrix a = normal_matrix(j, weight);
    std::vector<double> gradient(x.size());
    for (std::size_t k = 0; k < x.size(); ++k)
      for (std::size_t i = 0; i < r.size(); ++i) gradient[k] -= weight[i] * j.d[k][i] * r[i];
    for (;;) {
      SymmetricMatrix damped = a;
      for (std::size_t k = 0; k < x.size(); ++k) damped.at(k, k) *= 1 + damping;
      const std::vector<double> step = solve(damped, gradient);
      std::vector<double> next = x;
      double largest = 0;
      for (std::size_t k = 0; k < x.size(); ++k) {
        next[k] += step[k];
        largest = std::max(largest, std::abs(step[k]) * std::sqrt(a(k, k)));
      }
      const std::vector<double> next_r = data.residuals(problem, next);
      const double next_cost = robust_cost(data, next_r, cauchy, trial_weight);
      const bool better = next_cost < cost;
      if (better) {
        x = next;
        r = next_r;
        cost = next_cost;
        weight = trial_weight;
        damping = std::max(damping / 10, 1e-12);
      }
      if (largest < 1e-5) return true;  // of a sigma, were the other unknowns known
      if (better) break;
      damping *= 10;
      if (damping > 1e12) return true;  // no step is better: rounding
    }
  }
  return false;
}

double datum_size(const Data& data, const std::vector<double>& r, std::size_t highlight) {
  const std::size_t i = data.edges.size() + 2 * highlight;
  return std::hypot(r[i], r[i + 1]);
}

double median(std::vector<double> v) {
  if (v.empty()) return 0;
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
  return v[v.size() / 2];
}

/// How noisy the data are, by medians, which outliers hardly move: the sigmas given say only what they are relative to each other. What
/// highlights scatter more along their track than across is the turntable's.
void measure_noise(Data& data, const Problem& problem, const std::vector<double>& x) {
  constexpr std::size_t few = 12;      // fewer do not say: the sigmas given are believed
  constexpr double floor = 0.1;
  constexpr double normal = 0.67449;   // median of |normal|
  data.edge_factor = data.highlight_factor = 1;
  data.angle_sigma = 0;
  data.edge_used.assign(data.edges.size(), true);
  data.highlight_used.assign(data.highlights.size(), true);
  const std::vector<double> r = data.residuals(problem, x);
  std::vector<double> sizes;
  for (std::size_t i = 0; i < data.edges.size(); ++i) sizes.push_back(std::abs(r[i]));
  if (sizes.size() >= few) data.edge_factor = std::max(floor, median(sizes) / normal * std::sqrt(static_cast<double>(sizes.size()) / (static_cast<double>(sizes.size()) - 4)));

  const acquire::RigGeometry g = problem.geometry(x);
  const double scale = problem.turntable_scale(x);
  const std::size_t n = data.highlights.size();
  data.track.assign(n, glm::dvec2(0.0));
  std::vector<double> across, along, own;
  for (std::size_t i = 0; i < n; ++i) {
    constexpr double step = 1e-5;
    Highlight h = data.highlights[i];
    const glm::dvec2 here = predicted(g, scale, h), residual = h.pixel - here;
    h.turntable_angle += step;
    if (g.lights[h.light].on_arm) data.track[i] = (predicted(g, scale, h) - here) / step;
    const double speed = glm::length(data.track[i]);
    if (!(speed > 0) || !std::isfinite(speed)) {
      data.track[i] = glm::dvec2(0.0);
      continue;
    }
    const glm::dvec2 t = data.track[i] / speed, c(-t.y, t.x);
    const auto variance = [&](const glm::dvec2& v) { return v.x * v.x * h.xx + 2 * v.x * v.y * h.xy + v.y * v.y * h.yy; };
    across.push_back(std::abs(glm::dot(residual, c)) / std::sqrt(variance(c)));
    along.push_back(std::abs(glm::dot(residual, t)) / speed);
    own.push_back(variance(t) / (speed * speed));
  }
  if (across.size() < few) return;
  // Fitted unknowns take their share of the residuals: at most 8.
  const double share = std::sqrt(static_cast<double>(across.size()) / (static_cast<double>(across.size()) - 4));
  data.highlight_factor = std::max(floor, share * median(across) / normal);
  const double total = share * median(along) / normal;
  data.angle_sigma = std::sqrt(std::max(0.0, total * total - data.highlight_factor * data.highlight_factor * median(own)));
}

void select_inliers(Data& data, const Problem& problem, const std::vector<double>& x) {
  // 5 sigma: of 270 000 good highlights one is lost. The sigmas come from a median, known to 0.8 / sqrt(n) itself.
  const auto limit = [](std::size_t n) { return 5 * (1 + 2 / std::sqrt(static_cast<double>(std::max<std::size_t>(n, 4)))); };
  data.edge_used.assign(data.edges.size(), true);
  data.highlight_used.assign(data.highlights.size(), true);
  const std::vector<double> r = data.residuals(problem, x);
  for (std::size_t i = 0; i < data.edges.size(); ++i) data.edge_used[i] = std::abs(r[i]) <= limit(data.edges.size());
  for (std::size_t i = 0; i < data.highlights.size(); ++i) data.highlight_used[i] = datum_size(data, r, i) <= limit(data.highlights.size());
}

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

Consequence consequence(const Problem& problem, const std::vector<double>& x, const Highlight& h, const glm::dvec2& pixel) {
  const acquire::RigGeometry g = problem.geometry(x);
  const glm::dvec3 light = g.place_light(h.light, h.turntable_angle * problem.turntable_scale(x)).position;
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

/// Derivatives of the consequences by the unknowns, for a spread of views.
struct Effects {
  std::vector<std::vector<double>> light, half, distance;  ///< each row: one component, by unknown
};

Effects effects(const Problem& problem, const std::vector<double>& x, const Data& data) {
  constexpr std::size_t max_views = 60;
  constexpr double step = 1e-3;
  Effects e;
  const acquire::RigGeometry g = problem.geometry(x);
  const std::size_t n = data.highlights.size(), stride = std::max<std::size_t>(1, n / max_views);
  for (std::size_t i = 0; i < n; i += stride) {
    const Highlight& h = data.highlights[i];
    const auto lit = sample_pixel(g, g.place_light(h.light, h.turntable_angle * problem.turntable_scale(x)).position, i);
    if (!lit) continue;
    const glm::dvec2 pixel = *lit;
    std::vector<std::vector<double>> rows(7, std::vector<double>(x.size()));
    for (std::size_t k = 0; k < x.size(); ++k) {
      std::vector<double> up = x, down = x;
      up[k] += step;
      down[k] -= step;
      const Consequence a = consequence(problem, up, h, pixel), b = consequence(problem, down, h, pixel);
      for (int c = 0; c < 3; ++c) {
        rows[static_cast<std::size_t>(c)][k] = (a.light[c] - b.light[c]) / (2 * step);
        rows[static_cast<std::size_t>(3 + c)][k] = (a.half[c] - b.half[c]) / (2 * step);
      }
      rows[6][k] = (a.log_distance - b.log_distance) / (2 * step);
    }
    e.light.insert(e.light.end(), rows.begin(), rows.begin() + 3);
    e.half.insert(e.half.end(), rows.begin() + 3, rows.begin() + 6);
    e.distance.push_back(rows[6]);
  }
  return e;
}

/// RMS over the views of a vector of `per_view` components with the given covariance of the unknowns.
double rms(const std::vector<std::vector<double>>& rows, const std::vector<double>& covariance, double per_view) {
  double sum = 0;
  for (const auto& row : rows) sum += quadratic(covariance, row);
  return rows.empty() ? 0 : std::sqrt(sum * per_view / static_cast<double>(rows.size()));
}

/// Directions of the unknowns in which the images say less than the prior and that move light directions or half vectors noticeably.
std::vector<std::string> weak_directions(const SymmetricMatrix& information, const SymmetricMatrix& from_images, const Problem& problem, const Effects& effect) {
  constexpr double noticeable = 0.01 * pi / 180;
  const auto n = static_cast<int>(problem.size());
  cv::Mat a(n, n, CV_64F), values, vectors;
  for (int r = 0; r < n; ++r)
    for (int c = 0; c < n; ++c) a.at<double>(r, c) = information(static_cast<std::size_t>(r), static_cast<std::size_t>(c));
  cv::eigen(a, values, vectors);
  std::vector<std::string> texts;
  for (int e = n - 1; e >= 0; --e) {
    std::vector<double> v(static_cast<std::size_t>(n)), covariance(static_cast<std::size_t>(n * n));
    for (int k = 0; k < n; ++k) v[static_cast<std::size_t>(k)] = vectors.at<double>(e, k);
    if (2 * from_images.quadratic_form(0, v) >= values.at<double>(e)) continue;  // more than the prior says
    for (int r = 0; r < n; ++r)
      for (int c = 0; c < n; ++c)
        covariance[static_cast<std::size_t>(r * n + c)] = v[static_cast<std::size_t>(r)] * v[static_cast<std::size_t>(c)] / values.at<double>(e);
    const double half = rms(effect.half, covariance, 3), light = rms(effect.light, covariance, 3), distance = rms(effect.distance, covariance, 1);
    if (half < noticeable && light < 2 * noticeable && distance < 0.003) continue;
    std::vector<std::size_t> order(v.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
    std::sort(order.begin(), order.end(), [&](std::size_t p, std::size_t q) { return std::abs(v[p]) > std::abs(v[q]); });
    std::string names;
    for (std::size_t k = 0; k < 3 && k < order.size() && std::abs(v[order[k]]) > 0.3; ++k)
      names += (names.empty() ? "" : " with ") + problem.parameters()[order[k]].name;
    texts.push_back(fmt::format("the images do not determine {}: only the rig file holds it, which leaves {:.2g} deg in the half vectors, {:.2g} deg "
                                "in the lights' directions, {:.2g} % in their distance",
                                names, half * 180 / pi, light * 180 / pi, 100 * distance));
  }
  return texts;
}

void add_plain_warnings(const Data& data, const acquire::RigGeometry& g, GeometryEstimate& e) {
  if (e.n_edges == 0) e.warnings.push_back("no silhouette: the sphere's place comes from the highlights and the rig file alone");
  for (std::size_t light = 0; light < g.lights.size(); ++light) {
    double lowest = 1e9, highest = -1e9;
    std::size_t n = 0;
    for (std::size_t i = 0; i < data.highlights.size(); ++i) {
      if (data.highlights[i].light != light || !data.highlight_used[i]) continue;
      lowest = std::min(lowest, data.highlights[i].turntable_angle);
      highest = std::max(highest, data.highlights[i].turntable_angle);
      ++n;
    }
    if (n == 0) {
      e.warnings.push_back(fmt::format("light {}: no highlight: it stays where the rig file says", light + 1));
    } else if (n < 4 || (g.lights[light].on_arm && highest - lowest < 30 * pi / 180)) {
      e.warnings.push_back(fmt::format("light {}: {} highlights over {:.3g} deg of the turntable: too few to tell axis, arm and light apart "
                                       "(expected at least 4 over 30 deg)", light + 1, n, (highest - lowest) * 180 / pi));
    }
  }
}

void check_input(const acquire::RigGeometry& g, const std::vector<EdgePoint>& edges, const std::vector<Highlight>& highlights) {
  if (g.camera.projection != acquire::CameraModel::Projection::pinhole)
    throw Error(ErrorCode::input, "camera: orthographic; geometry can be estimated for a pinhole camera only, keep the rig file's (--from-rig)");
  if (edges.empty() && highlights.empty()) throw Error(ErrorCode::input, "geometry: neither silhouette nor highlights, expected at least one of them");
  for (const EdgePoint& e : edges)
    if (!(e.sigma > 0) || !std::isfinite(e.pixel.x + e.pixel.y + e.sigma)) throw Error(ErrorCode::input, "geometry: edge point: expected finite numbers, sigma > 0");
  for (const Highlight& h : highlights) {
    if (h.light >= g.lights.size()) throw Error(ErrorCode::input, fmt::format("view {}: light: expected an index below {}", h.view, g.lights.size()));
    if (g.lights[h.light].distant)
      throw Error(ErrorCode::input, fmt::format("view {}: light {} is distant; only near lights can be estimated, keep the rig file's (--from-rig)", h.view, h.light + 1));
    if (!(h.xx > 0 && h.xx * h.yy > h.xy * h.xy) || !std::isfinite(h.pixel.x + h.pixel.y + h.xx + h.yy))
      throw Error(ErrorCode::input, fmt::format("view {}: highlight: expected finite numbers and a positive covariance", h.view));
  }
}

}  // namespace

void GeometryPriors::validate() const {
  for (const double s : {sphere_m, axis_point_m, axis_tilt_rad, zero_angle_rad, turntable_scale, light_m, arm, edge_offset_px})
    if (!(s > 0 && std::isfinite(s))) throw Error(ErrorCode::usage, "geometry priors: expected numbers > 0");
}

std::optional<glm::dvec2> mirror_pixel(const acquire::RigGeometry& rig, const glm::dvec3& light) {
  const acquire::RigidTransform& pose = rig.cam_from_rig;
  const glm::dvec3 camera = -(glm::transpose(pose.rotation) * pose.translation);
  const double camera_distance = glm::length(camera), light_distance = glm::length(light);
  const glm::dvec3 u = camera / camera_distance, cross = glm::cross(u, light);
  const double sine = glm::length(cross);
  const auto a = reflecting_angle(camera_distance / rig.sphere_radius, light_distance / rig.sphere_radius, std::atan2(sine, glm::dot(u, light)));
  if (!a) return std::nullopt;
  const glm::dvec3 across = sine > 1e-14 * light_distance ? glm::cross(cross / sine, u) : glm::dvec3(0);
  return rig.camera.project(pose * (rig.sphere_radius * (std::cos(*a) * u + std::sin(*a) * across)));
}

std::optional<double> silhouette_distance(const acquire::RigGeometry& rig, const glm::dvec2& pixel) {
  const auto ray = rig.camera.unproject(pixel);
  if (!ray) return std::nullopt;
  const glm::dvec3& centre = rig.cam_from_rig.translation;
  const double distance = glm::length(centre);
  const glm::dvec3 axis = centre / distance, d = ray->direction, cross = glm::cross(axis, d);
  const double cone = std::asin(rig.sphere_radius / distance), angle = std::atan2(glm::length(cross), glm::dot(axis, d));
  // The nearest line of sight of the cone, projected: the distance is exact where it matters, at the silhouette.
  if (!(angle > 1e-9)) return -rig.camera.focal.x * cone;
  const auto touching = rig.camera.project(rotate(axis, glm::normalize(cross), cone));
  if (!touching) return std::nullopt;
  return std::copysign(glm::length(pixel - *touching), angle - cone);
}

GeometryEstimate solve_geometry(const acquire::RigGeometry& nominal, const std::vector<EdgePoint>& edges, const std::vector<Highlight>& highlights,
                                const GeometryPriors& priors) {
  priors.validate();
  check_input(nominal, edges, highlights);
  const Problem problem(nominal, priors, highlights);
  Data data{edges, highlights, std::vector<bool>(edges.size(), true), std::vector<bool>(highlights.size(), true)};
  std::vector<double> x(problem.size());

  minimise(data, problem, 3, x);
  GeometryEstimate e;
  for (int round = 0; round < 4; ++round) {
    const auto before = std::pair(data.edge_used, data.highlight_used);
    measure_noise(data, problem, x);
    select_inliers(data, problem, x);
    e.converged = minimise(data, problem, 0, x);
    if (round > 0 && before == std::pair(data.edge_used, data.highlight_used)) break;
  }

  const Columns j = derivatives(data, problem, x);
  std::vector<double> weight(j.d.front().size(), 1.0);
  const SymmetricMatrix information = normal_matrix(j, weight);
  std::fill(weight.begin() + static_cast<std::ptrdiff_t>(data.n_data()), weight.end(), 0.0);
  const SymmetricMatrix from_images = normal_matrix(j, weight);
  const SymmetricMatrix inverse = sandwich(information, information);
  const std::size_t n = problem.size();
  std::vector<double> scaled(n * n);
  e.uncertainty.parameters = problem.parameters();
  e.uncertainty.covariance.resize(n * n);
  for (std::size_t a = 0; a < n; ++a) {
    GeometryParameter& p = e.uncertainty.parameters[a];
    p.correction = x[a] * p.prior_sigma;
    p.sigma = std::sqrt(inverse(a, a)) * p.prior_sigma;
    for (std::size_t b = 0; b < n; ++b) {
      scaled[a * n + b] = inverse(a, b);
      e.uncertainty.covariance[a * n + b] = inverse(a, b) * p.prior_sigma * problem.parameters()[b].prior_sigma;
    }
  }
  e.geometry = problem.geometry(x);
  e.turntable_scale = problem.turntable_scale(x);
  e.edge_noise_factor = data.edge_factor;
  e.highlight_noise_factor = data.highlight_factor;
  e.angle_sigma_rad = data.angle_sigma;

  double edge_sum = 0, highlight_sum = 0;
  for (std::size_t i = 0; i < edges.size(); ++i) {
    if (!data.edge_used[i]) {
      ++e.n_edge_outliers;
      continue;
    }
    ++e.n_edges;
    const double d = silhouette_distance(e.geometry, edges[i].pixel).value_or(0) - problem.edge_offset(x);
    edge_sum += d * d;
  }
  for (std::size_t i = 0; i < highlights.size(); ++i) {
    const glm::dvec2 d = highlights[i].pixel - predicted(e.geometry, e.turntable_scale, highlights[i]);
    if (data.highlight_used[i]) {
      ++e.n_highlights;
      highlight_sum += glm::dot(d, d);
    } else {
      e.outliers.push_back({highlights[i].view, highlights[i].light, d});
    }
  }
  if (e.n_edges > 0) e.edge_rms_px = std::sqrt(edge_sum / static_cast<double>(e.n_edges));
  if (e.n_highlights > 0) e.highlight_rms_px = std::sqrt(highlight_sum / (2 * static_cast<double>(e.n_highlights)));

  const double pixels_per_metre = nominal.camera.focal.x / nominal.cam_from_rig.translation.z;
  e.centre_sigma_px = std::max(e.uncertainty.parameters[0].sigma, e.uncertainty.parameters[1].sigma) * pixels_per_metre;
  const Effects effect = effects(problem, x, data);
  e.light_sigma_rad = rms(effect.light, scaled, 3);
  e.half_vector_sigma_rad = rms(effect.half, scaled, 3);
  e.distance_sigma = rms(effect.distance, scaled, 1);
  add_plain_warnings(data, nominal, e);
  for (std::string& text : weak_directions(information, from_images, problem, effect)) e.warnings.push_back(std::move(text));
  return e;
}

}  // namespace lacquer::calib
