#include "libbrdf/metrics.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <numbers>

#include "libbrdf/color.h"
#include "libbrdf/error.h"
#include "libbrdf/table.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;
constexpr int lit_sphere_size = 128;  // pixels

/// Compensated sum (Neumaier 1974): a million terms without a drift that a reader could take for a
/// difference.
class Sum {
 public:
  void add(double x) {
    const double total = total_ + x;
    lost_ += std::abs(total_) >= std::abs(x) ? (total_ - total) + x : (x - total) + total_;
    total_ = total;
  }
  double value() const { return total_ + lost_; }

 private:
  double total_ = 0, lost_ = 0;
};

/// Values of both BRDFs at the centre of one cell; `both` false: one of them says nothing.
struct Comparison {
  glm::dvec3 a{0.0}, b{0.0};
  double cos_i = 0, cos_o = 0;
  double solid_angle = 0;  ///< of the cell, up to a common factor
  bool both = false;
};

/// Integral of 4 cos(theta_d) sin(theta_d) sin(theta_h) over a cell; differences of cosines as products,
/// exact for tiny cells too.
double solid_angle_weight(const TableGrid::Cell& cell) {
  const auto cosine_difference = [](double low, double high) {
    return 2 * std::sin((low + high) / 2) * std::sin((high - low) / 2);
  };
  const double step_d = pi / TableGrid::n_theta_d;  // of 2 theta_d
  return cosine_difference(TableGrid::theta_h_edge(cell.theta_h), TableGrid::theta_h_edge(cell.theta_h + 1)) *
         cosine_difference(cell.theta_d * step_d, (cell.theta_d + 1) * step_d);
}

/// The smallest cosine that max_theta allows; 0 is excluded by the callers' "above the horizon".
double min_cosine(const CompareOptions& options) { return std::max(std::cos(options.max_theta), 0.0); }

std::vector<TableGrid::Cell> cells_to_compare(const CompareOptions& options) {
  const double smallest = min_cosine(options);
  std::vector<TableGrid::Cell> cells;
  for (int h = 0; h < TableGrid::n_theta_h; ++h)
    for (int d = 0; d < TableGrid::n_theta_d; ++d)
      for (int p = 0; p < TableGrid::n_phi_d; p += options.phi_d_step)
        if (TableGrid::reachable({h, d, p}, smallest)) cells.push_back({h, d, p});
  return cells;
}

void require_finite(const Brdf& brdf, const glm::dvec3& value, const HalfDiff& c) {
  if (std::isfinite(value.x) && std::isfinite(value.y) && std::isfinite(value.z)) return;
  throw Error(ErrorCode::input,
              fmt::format("{}: the value at theta_h {:.4f}, theta_d {:.4f}, phi_d {:.4f} rad is not finite",
                          brdf.description(), c.theta_h, c.theta_d, c.phi_d));
}

std::vector<Comparison> evaluate(const Brdf& a, const Brdf& b, const CompareOptions& options) {
  const std::vector<TableGrid::Cell> cells = cells_to_compare(options);
  std::vector<Comparison> result(cells.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, cells.size()), [&](const auto& range) {
    for (std::size_t i = range.begin(); i != range.end(); ++i) {
      const HalfDiff centre = TableGrid::centre(cells[i]);
      const Directions d = directions(centre);
      const auto value_a = a.value(d), value_b = b.value(d);
      if (!value_a || !value_b) continue;
      require_finite(a, *value_a, centre);
      require_finite(b, *value_b, centre);
      result[i] = {*value_a, *value_b, d.wi.z, d.wo.z, solid_angle_weight(cells[i]), true};
    }
  });
  return result;
}

/// Logarithms first, then the difference: ln(b/a) = -ln(a/b) holds to the last bit, and the ratio cannot
/// overflow.
void compare_logs(const std::vector<Comparison>& comparisons, bool scale, BrdfDifference& result) {
  std::vector<double> logs;
  logs.reserve(3 * comparisons.size());
  Sum sum;
  for (const auto& c : comparisons) {
    if (!c.both) continue;
    for (int channel = 0; channel < 3; ++channel) {
      if (!(c.a[channel] > 0 && c.b[channel] > 0)) {
        ++result.n_nonpositive;
        continue;
      }
      logs.push_back(std::log(c.b[channel]) - std::log(c.a[channel]));
      sum.add(logs.back());
    }
  }
  if (logs.empty())
    throw Error(ErrorCode::input,
                "the two BRDFs have no direction with both values > 0; a log ratio does not exist");

  const double n = static_cast<double>(logs.size());
  const double shift = scale ? -sum.value() / n : 0.0;
  result.scale = std::exp(shift);
  Sum bias, absolute, square;
  for (const double unscaled : logs) {
    const double log_ratio = unscaled + shift;
    bias.add(log_ratio);
    absolute.add(std::abs(log_ratio));
    square.add(log_ratio * log_ratio);
    result.max_abs_log = std::max(result.max_abs_log, std::abs(log_ratio));
  }
  result.bias_log = bias.value() / n;
  result.mean_abs_log = absolute.value() / n;
  result.rms_log = std::sqrt(square.value() / n);
}

double cosine_rms(const std::vector<Comparison>& comparisons, double scale) {
  Sum difference, reference;
  for (const auto& c : comparisons) {
    if (!c.both) continue;
    const double weight = c.solid_angle * std::pow(c.cos_i * c.cos_o, 2);
    const glm::dvec3 delta = scale * c.b - c.a;
    for (int channel = 0; channel < 3; ++channel) {
      difference.add(weight * delta[channel] * delta[channel]);
      reference.add(weight * c.a[channel] * c.a[channel]);
    }
  }
  return std::sqrt(difference.value() / reference.value());
}

double cube_root_rms(const std::vector<Comparison>& comparisons, double scale) {
  Sum difference, solid_angle;
  for (const auto& c : comparisons) {
    if (!c.both) continue;
    for (int channel = 0; channel < 3; ++channel)
      difference.add(c.solid_angle * std::pow(std::cbrt(c.cos_i * scale * c.b[channel]) - std::cbrt(c.cos_i * c.a[channel]), 2) / 3);
    solid_angle.add(c.solid_angle);
  }
  return std::sqrt(difference.value() / solid_angle.value());
}

/// What an ideal sRGB display shows of a radiance, as Lab.
glm::dvec3 displayed_lab(const glm::dvec3& radiance) {
  return lab_from_linear_srgb(glm::clamp(radiance, 0.0, 1.0));
}

}  // namespace

void CompareOptions::validate() const {
  if (!(max_theta > 0 && max_theta <= pi / 2))
    throw Error(
        ErrorCode::usage,
        fmt::format("max_theta: expected an angle above 0 and at most 90 deg, got {} rad", max_theta));
  if (phi_d_step < 1 || phi_d_step > TableGrid::n_phi_d)
    throw Error(ErrorCode::usage,
                fmt::format("phi_d_step: expected 1 to {}, got {}", TableGrid::n_phi_d, phi_d_step));
}

std::array<glm::dvec3, 3> lit_sphere_lights() {
  const auto light = [](double degrees) { return direction(degrees * pi / 180, pi / 6); };
  return {light(20), light(50), light(80)};
}

LitSphereDifference compare_lit_spheres(const Brdf& a, const Brdf& b, const CompareOptions& options, double scale) {
  options.validate();
  const double smallest = min_cosine(options);
  std::vector<double> differences;
  for (const glm::dvec3& light : lit_sphere_lights()) {
    const SphereImage image_a = render_lit_sphere(a, lit_sphere_size, {light});
    const SphereImage image_b = render_lit_sphere(b, lit_sphere_size, {light});
    for (std::size_t i = 0; i < image_a.radiance.size(); ++i) {
      if (!image_a.covered[i] || !image_b.covered[i]) continue;
      const glm::dvec3 n = sphere_normal(lit_sphere_size, static_cast<int>(i) % lit_sphere_size,
                                         static_cast<int>(i) / lit_sphere_size)
                               .value();
      const double cos_i = n.x * light.x + n.y * light.y + n.z * light.z, cos_o = n.z;
      if (!(std::min(cos_i, cos_o) > smallest)) continue;
      differences.push_back(delta_e_2000(displayed_lab(image_a.radiance[i]),
                                         displayed_lab(scale * glm::dvec3(image_b.radiance[i]))));
    }
  }
  LitSphereDifference result{.n_pixels = differences.size()};
  if (differences.empty()) return result;
  Sum sum;
  for (const double e : differences) sum.add(e);
  result.mean = sum.value() / static_cast<double>(differences.size());
  const auto rank =
      static_cast<std::ptrdiff_t>(std::ceil(0.95 * static_cast<double>(differences.size()))) - 1;
  std::nth_element(differences.begin(), differences.begin() + rank, differences.end());
  result.p95 = differences[static_cast<std::size_t>(rank)];
  return result;
}

BrdfDifference compare(const Brdf& a, const Brdf& b, const CompareOptions& options) {
  options.validate();
  const std::vector<Comparison> comparisons = evaluate(a, b, options);
  BrdfDifference result;
  result.n_directions = static_cast<std::size_t>(
      std::count_if(comparisons.begin(), comparisons.end(), [](const auto& c) { return c.both; }));
  result.n_undefined = comparisons.size() - result.n_directions;
  if (result.n_directions == 0)
    throw Error(
        ErrorCode::input,
        fmt::format(
            "'{}' and '{}' have no direction in common within {:.1f} deg of the normal; nothing to compare",
            a.description(), b.description(), options.max_theta * 180 / pi));
  compare_logs(comparisons, options.scale, result);
  result.cosine_rms = cosine_rms(comparisons, result.scale);
  result.cube_root_rms = cube_root_rms(comparisons, result.scale);
  const LitSphereDifference lit = compare_lit_spheres(a, b, options, result.scale);
  result.n_pixels = lit.n_pixels, result.delta_e_mean = lit.mean, result.delta_e_p95 = lit.p95;
  return result;
}

}  // namespace lacquer::brdf
