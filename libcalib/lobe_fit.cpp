#include "libcalib/lobe_fit.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "libcalib/response_algebra.h"

namespace lacquer::calib {

namespace {

constexpr std::size_t n_shared = 3;                 // shift x, y and the logarithm of the squared width
constexpr std::size_t n_own = 2;                    // base and height of a channel
constexpr std::size_t n_local = n_shared + n_own;   // what one value depends on

struct Lobe {
  double value;
  glm::dvec2 by_shift;
  double by_log_width2;
  glm::dmat2 by_covariance;  ///< of the slope
};

/// exp(-s' C^-1 s / 2) with C = width2/2 + lens + emitter, averaged over the pixel. The shift displaces the whole highlight: s - J shift.
/// Pixels much smaller than the lobe are averaged by their variance, 1/12, in C; others by Gauss-Legendre nodes.
class LobeShape {
 public:
  LobeShape(const ExpectedHighlight& expected, double lens_blur_px, bool narrow)
      : j_(expected.slope_per_pixel), fixed_(expected.emitter + (lens_blur_px * lens_blur_px + (narrow ? 0.0 : 1.0 / 12)) * j_ * glm::transpose(j_)) {
    constexpr double at[] = {-0.43056815579702629, -0.16999052179242813, 0.16999052179242813, 0.43056815579702629};
    constexpr double weight[] = {0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693};
    if (!narrow) nodes_.push_back({glm::dvec2(0.0), 1});
    for (int i = 0; narrow && i < 16; ++i) nodes_.push_back({j_ * glm::dvec2(at[i % 4], at[i / 4]), weight[i % 4] * weight[i / 4]});
    seen_ = narrow ? 1.0 / 12 : 0;
  }
  void set_width2(double width2) {
    width2_ = width2;
    const glm::dmat2 c = glm::dmat2(width2 / 2) + fixed_;
    inverse_ = glm::inverse(c);
    // A lobe of a pixel's size gets a window of more, which else would hold too few values.
    constexpr double least_px = 0.8;
    window_ = glm::inverse(c + (seen_ + least_px * least_px) * j_ * glm::transpose(j_));
    const glm::dmat2 back = glm::inverse(j_);
    size_ = (c[0][0] + c[1][1]) / 2;
    spread_px_ = back * (c + seen_ * j_ * glm::transpose(j_)) * glm::transpose(back);
  }
  double size() const { return size_; }  ///< mean variance of the slope
  const glm::dmat2& spread_px() const { return spread_px_; }
  /// Squared distance from the centre in sigmas.
  double distance2(const HighlightValue& v, const glm::dvec2& shift) const {
    const glm::dvec2 s = v.slope - j_ * shift;
    return glm::dot(s, window_ * s);
  }
  Lobe at(const HighlightValue& v, const glm::dvec2& shift) const {
    const glm::dvec2 centre = v.slope - j_ * shift;
    Lobe lobe{0, glm::dvec2(0.0), 0, glm::dmat2(0.0)};
    glm::dvec2 gradient(0.0);
    for (const Node& node : nodes_) {
      const glm::dvec2 s = centre + node.slope, p = inverse_ * s;
      const double value = node.weight * std::exp(-0.5 * glm::dot(s, p));
      lobe.value += value;
      gradient += value * p;
      lobe.by_covariance += 0.5 * value * glm::outerProduct(p, p);
    }
    lobe.by_shift = glm::transpose(j_) * gradient;
    lobe.by_log_width2 = width2_ / 2 * (lobe.by_covariance[0][0] + lobe.by_covariance[1][1]);
    return lobe;
  }

 private:
  struct Node {
    glm::dvec2 slope;
    double weight;
  };
  glm::dmat2 j_, fixed_, inverse_{1.0}, window_{1.0}, spread_px_{1.0};
  std::vector<Node> nodes_;
  double width2_ = 0, seen_ = 0, size_ = 0;
};

/// Normal equations of one iteration, and what the covariance needs.
struct Equations {
  SymmetricMatrix a, by_noise, by_residuals;
  std::vector<double> b;
  std::vector<double> standardised;  ///< |residual| over noise and doubt
  std::size_t n = 0, n_clipped = 0;
  double trusted = 0, all = 0;       ///< sum of weights with and without the distrust of outliers

  explicit Equations(std::size_t n_unknowns) : a(n_unknowns), by_noise(n_unknowns), by_residuals(n_unknowns), b(n_unknowns) {}
};

class LobeSolver {
 public:
  LobeSolver(const std::vector<HighlightValue>& values, const ExpectedHighlight& expected, const LobeFitOptions& options)
      : values_(values), reach2_(options.reach * options.reach), shape_(expected, options.lens_blur_px, is_narrow(expected, options)) {
    for (const HighlightValue& v : values)
      if (slot_[v.channel] < 0) slot_[v.channel] = static_cast<int>(n_channels_++);
    n_unknowns_ = n_shared + n_own * n_channels_;
  }

  LobeFit solve_from(const LobeFitOptions& options) {
    fit_.shift = options.start;
    fit_.log_width2 = std::log(options.width2);
    const double narrowest = fit_.log_width2 - 12;  // a mirror: only lens and emitter are seen
    shape_.set_width2(options.width2);
    Equations e(n_unknowns_);
    if (!step_of_levels(e)) return fit_;
    constexpr int max_iterations = 60;
    for (int i = 0; i < max_iterations; ++i) {
      e = Equations(n_unknowns_);
      accumulate(e, true);
      if (e.n < 2 * n_unknowns_) return fit_;
      SymmetricMatrix damped = e.a;
      for (std::size_t p = 0; p < n_shared; ++p) damped.at(p, p) *= 1.01;
      const std::vector<double> step = solve(damped, e.b);
      const double length = std::hypot(step[0], step[1]), limit = 1.5;
      fit_.shift += glm::dvec2(step[0], step[1]) * (length > limit ? limit / length : 1.0);
      fit_.log_width2 = std::max(narrowest, fit_.log_width2 + std::clamp(step[2], -0.7, 0.7));
      for (std::size_t k = n_shared; k < n_unknowns_; ++k) level_[k - n_shared] += step[k];
      if (!std::isfinite(fit_.log_width2 + fit_.shift.x + fit_.shift.y)) return fit_;
      shape_.set_width2(std::exp(fit_.log_width2));
      update_scale(e, i);
      if (i >= 4 && length < 1e-4) {
        finish(e, length);
        return fit_;
      }
      if (i + 1 == max_iterations) finish(e, length);
    }
    return fit_;
  }

 private:
  static bool is_narrow(const ExpectedHighlight& expected, const LobeFitOptions& options) {
    const double det = std::abs(glm::determinant(expected.slope_per_pixel)), larger = std::max(glm::length(expected.slope_per_pixel[0]), glm::length(expected.slope_per_pixel[1]));
    const double sigma2 = options.width2 / 2 / std::max(det, larger * larger) + options.lens_blur_px * options.lens_blur_px;
    return sigma2 < 2.25;
  }

  /// Base and height alone, at the shape to begin with.
  bool step_of_levels(Equations& e) {
    accumulate(e, false);
    if (e.n < 2 * n_unknowns_) return false;
    const std::vector<double> x = solve(e.a, e.b);
    level_.assign(x.begin() + n_shared, x.end());
    return true;
  }

  void accumulate(Equations& e, bool with_shape) const {
    for (const HighlightValue& v : values_) {
      if (v.flag == PixelFlag::invalid) continue;
      const double distance2 = shape_.distance2(v, fit_.shift);
      if (distance2 > reach2_) continue;
      if (v.flag == PixelFlag::clipped) {
        ++e.n_clipped;
        continue;
      }
      ++e.n;
      const std::size_t own = n_own * static_cast<std::size_t>(slot_[v.channel]);
      const double base = level_.empty() ? 0 : level_[own], height = level_.empty() ? 0 : level_[own + 1];
      const Lobe lobe = shape_.at(v, fit_.shift);
      const double expected = base * v.diffuse + height * v.mirror * lobe.value, r = v.radiance - expected;
      std::array<double, n_local> d{0, 0, 0, v.diffuse, v.mirror * lobe.value};
      if (with_shape) {
        d[0] = height * v.mirror * lobe.by_shift.x;
        d[1] = height * v.mirror * lobe.by_shift.y;
        d[2] = height * v.mirror * lobe.by_log_width2;
      }
      // The lobe's profile is a model: 3 % of what is there, besides the noise.
      const double doubt = 0.03 * std::max(std::abs(expected), std::abs(height * v.mirror) * 0.1);
      const double variance = v.variance + doubt * doubt + 1e-300, z = std::abs(r) / std::sqrt(variance);
      // Falls to 0 at the window's edge, so that no pixel enters or leaves with a jump.
      const double inside = 1 - distance2 / reach2_, plain = inside * inside / variance, trusted = plain * trust(z);
      e.standardised.push_back(z);
      e.all += plain * d[4] * d[4];
      e.trusted += trusted * d[4] * d[4];
      add(e, d, own, trusted, r, v.variance);
    }
  }

  static void add(Equations& e, const std::array<double, n_local>& d, std::size_t own, double weight, double r, double noise) {
    const std::size_t place[n_local] = {0, 1, 2, n_shared + own, n_shared + own + 1};
    const double w2 = weight * weight;
    for (std::size_t p = 0; p < n_local; ++p) {
      e.b[place[p]] += weight * d[p] * r;
      for (std::size_t q = 0; q <= p; ++q) {
        const double dd = d[p] * d[q];
        e.a.at(place[p], place[q]) += weight * dd;
        e.by_noise.at(place[p], place[q]) += w2 * noise * dd;
        e.by_residuals.at(place[p], place[q]) += w2 * r * r * dd;
      }
    }
  }

  /// Residuals beyond a few times the usual one are not the lobe's. Known once the shape is about right.
  void update_scale(Equations& e, int iteration) {
    if (iteration < 2 || e.standardised.empty()) return;
    const auto middle = e.standardised.begin() + static_cast<std::ptrdiff_t>(e.standardised.size() / 2);
    std::nth_element(e.standardised.begin(), middle, e.standardised.end());
    constexpr double times = 6;
    scale_ = times * std::max(0.3, 1.4826 * *middle);
  }

  /// The larger of what the noise and what the residuals say.
  void finish(const Equations& e, double length) {
    const SymmetricMatrix by_noise = sandwich(e.a, e.by_noise);
    SymmetricMatrix by_residuals = sandwich(e.a, e.by_residuals);
    by_residuals.scale(static_cast<double>(e.n) / static_cast<double>(e.n - n_unknowns_));
    const SymmetricMatrix& c = by_noise(0, 0) + by_noise(1, 1) > by_residuals(0, 0) + by_residuals(1, 1) ? by_noise : by_residuals;
    fit_.covariance = glm::dmat2(c(0, 0), c(0, 1), c(0, 1), c(1, 1));
    for (std::size_t channel = 0; channel < 3; ++channel)
      if (slot_[channel] >= 0) {
        fit_.base[channel] = level_[n_own * static_cast<std::size_t>(slot_[channel])];
        fit_.height[channel] = level_[n_own * static_cast<std::size_t>(slot_[channel]) + 1];
      }
    fit_.n = e.n;
    fit_.n_clipped = e.n_clipped;
    fit_.left_out = e.all > 0 ? 1 - e.trusted / e.all : 1;
    fit_.elongation = elongation();
    fit_.spread_px = shape_.spread_px();
    fit_.good = length < 0.02 && c(0, 0) > 0 && c(1, 1) > 0;
  }

  /// Weight of a standardised residual: next to nothing far beyond the usual ones.
  double trust(double z) const {
    const double u = z / scale_;
    return 1 / ((1 + u * u) * (1 + u * u));
  }

  /// Stretch that the residuals ask for, as a share of the lobe's variance: covariance * (1 + [a b; b -a]).
  double elongation() const {
    double aa = 0, ab = 0, bb = 0, ar = 0, br = 0;
    for (const HighlightValue& v : values_) {
      const double distance2 = shape_.distance2(v, fit_.shift);
      if (v.flag == PixelFlag::invalid || v.flag == PixelFlag::clipped || distance2 > reach2_) continue;
      const std::size_t own = n_own * static_cast<std::size_t>(slot_[v.channel]);
      const double scale = level_[own + 1] * v.mirror, doubt = 0.03 * std::abs(scale), inside = 1 - distance2 / reach2_;
      const Lobe lobe = shape_.at(v, fit_.shift);
      const double variance = v.variance + doubt * doubt + 1e-300, r = v.radiance - level_[own] * v.diffuse - scale * lobe.value;
      const double weight = inside * inside / variance * trust(std::abs(r) / std::sqrt(variance));
      const double a = scale * shape_.size() * (lobe.by_covariance[0][0] - lobe.by_covariance[1][1]), b = scale * shape_.size() * 2 * lobe.by_covariance[0][1];
      aa += weight * a * a;
      ab += weight * a * b;
      bb += weight * b * b;
      ar += weight * a * r;
      br += weight * b * r;
    }
    const double determinant = aa * bb - ab * ab;
    return determinant > 0 ? std::hypot(bb * ar - ab * br, aa * br - ab * ar) / determinant : 0;
  }

  const std::vector<HighlightValue>& values_;
  double reach2_;
  LobeShape shape_;
  std::array<int, 3> slot_{-1, -1, -1};
  std::size_t n_channels_ = 0, n_unknowns_ = 0;
  std::vector<double> level_;  ///< base and height of each channel seen
  double scale_ = 1e9;
  LobeFit fit_;
};

}  // namespace

LobeFit fit_lobe(const std::vector<HighlightValue>& values, const ExpectedHighlight& expected, const LobeFitOptions& options) {
  return LobeSolver(values, expected, options).solve_from(options);
}

}  // namespace lacquer::calib
