#include "libbrdf/rgl_ndf.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "libbrdf/rgl_axes.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;

/// Trowbridge and Reitz's distribution (GGX); constant for alpha = 1.
double ggx(double theta, double alpha) {
  const double c = std::cos(theta), s = std::sin(theta), a2 = alpha * alpha, d = c * c * a2 + s * s;
  return a2 / (pi * d * d);
}

double beckmann(double theta, double m) {
  const double c = std::cos(theta), tangent = std::tan(theta) / m;
  return c > 1e-6 ? std::exp(-tangent * tangent) / (pi * m * m * c * c * c * c) : 0.0;
}

double node(std::size_t j, std::size_t n) { return static_cast<double>(j) / static_cast<double>(n - 1); }

double mean(const glm::dvec3& v) { return (v.x + v.y + v.z) / 3; }

SamplingNdf of_lobes(const CookTorrance& model, std::size_t n) {
  constexpr double broad = 0.05;  // share of a constant in both: no direction may be left without nodes
  constexpr double least_r = 0.5; // towards grazing every lobe reflects more than r
  std::vector<double> energy;
  double total = mean(model.kd);
  for (const auto& lobe : model.lobes) {
    energy.push_back(mean(lobe.ks) * std::max(lobe.r, least_r));
    total += energy.back();
  }
  SamplingNdf result{std::vector<float>(n, 1.0f), std::vector<float>(n, 1.0f)};
  if (!(total > 0)) return result;
  const double share = 1 / static_cast<double>(model.lobes.size() + 1);
  for (std::size_t j = 0; j < n; ++j) {
    const double theta = rgl_theta_from_u(node(j, n)), cos2 = std::cos(theta) * std::cos(theta);
    double d = mean(model.kd) / total * cos2 / pi, warp = share * cos2 / pi;
    for (std::size_t i = 0; i < energy.size(); ++i) {
      const double m = model.lobes[i].m, wide = std::min(2 * m, 1.0);
      d += energy[i] / total * beckmann(theta, m);
      warp += share * (beckmann(theta, wide) + ggx(theta, wide)) / 2;
    }
    result.ndf[j] = static_cast<float>((1 - broad) * d + broad / pi);
    result.warp[j] = static_cast<float>((1 - broad) * warp + broad / pi);
  }
  return result;
}

/// Geometric mean of the channels' mean f_r cos^2(theta) with both directions near the half vector, which is D times something flat.
std::optional<double> near_retro(const Brdf& brdf, double theta) {
  double sum = 0;
  int count = 0;
  for (const double theta_d : {0.1, 0.3, 0.5, 0.7, 0.9, 1.1})
    for (const double phi_d : {0.3 * pi, 0.5 * pi, 0.7 * pi}) {
      const auto f = brdf.value(directions({theta, theta_d, phi_d}));
      if (!f || !(f->x + f->y + f->z > 0)) continue;
      const double c = std::cos(theta);
      sum += std::log((f->x + f->y + f->z) / 3 * c * c);
      ++count;
    }
  return count ? std::optional(std::exp(sum / count)) : std::nullopt;
}

/// `d` scaled so that the integral of D cos(theta) over the hemisphere is 1, mixed with the constant of which that is true.
std::vector<float> normalised(const std::vector<double>& d, double broad) {
  const std::size_t n = d.size();
  double total = 0;
  for (std::size_t j = 0; j < n; ++j) {
    const double u = node(j, n), theta = rgl_theta_from_u(u);
    total += d[j] * std::cos(theta) * std::sin(theta) * 2 * pi * u * pi / static_cast<double>(n - 1);
  }
  std::vector<float> result(n);
  for (std::size_t j = 0; j < n; ++j) result[j] = static_cast<float>(total > 0 ? (1 - broad) * d[j] / total + broad / pi : 1.0);
  return result;
}

/// Density that gives every factor by which `d` falls the same number of nodes, however little solid angle it takes.
std::vector<double> flanks(const std::vector<double>& d) {
  const std::size_t n = d.size();
  std::vector<double> fall(n, 0.0), result(n, 0.0);
  double least = d[0];
  for (std::size_t j = 1; j < n; ++j) {
    if (!(d[j] > 0) || !(d[j] < least)) continue;  // noise goes up and down
    fall[j] = std::log(least / d[j]);
    least = d[j];
  }
  for (std::size_t j = 0; j < n; ++j) {
    // Spread over the neighbourhood: readers interpolate, and flanks move a little with the angle of incidence.
    const std::size_t reach = 2 + j / 4, first = j > reach ? j - reach : 0, last = std::min(j + reach, n - 1);
    double sum = 0;
    for (std::size_t k = first; k <= last; ++k) sum += fall[k];
    const double u = node(std::max<std::size_t>(j, 1), n), theta = rgl_theta_from_u(u);
    result[j] = sum / static_cast<double>(last - first + 1) / (std::sin(theta) * u * std::max(std::cos(theta), 0.1));
  }
  return result;
}

SamplingNdf of_values(const Brdf& brdf, std::size_t n) {
  std::vector<double> d(n, 0.0);
  std::optional<double> last;
  for (std::size_t j = 0; j < n; ++j) {
    if (const auto value = near_retro(brdf, rgl_theta_from_u(node(j, n)))) {
      if (!last) std::fill(d.begin(), d.begin() + static_cast<std::ptrdiff_t>(j), *value);  // a hole at the peak
      last = value;
    }
    d[j] = last.value_or(0.0);
  }
  std::vector<double> root(n);
  std::transform(d.begin(), d.end(), root.begin(), [](double x) { return std::sqrt(x); });
  SamplingNdf result{normalised(d, 0.05), normalised(root, 0.05)};
  const std::vector<float> steep = normalised(flanks(d), 0.05);
  constexpr float share = 0.15f;  // of the three measured films the gloss one gains most from it, the others lose little
  for (std::size_t j = 0; j < n; ++j) result.warp[j] = (1 - share) * result.warp[j] + share * steep[j];
  return result;
}

}  // namespace

SamplingNdf sampling_ndf(const Brdf& brdf, std::size_t n) {
  const auto* model = dynamic_cast<const CookTorranceBrdf*>(&brdf);
  return model ? of_lobes(model->model(), n) : of_values(brdf, n);
}

std::vector<float> projected_area(std::span<const float> ndf, std::size_t n) {
  constexpr std::size_t steps = 4;  // between two nodes of D
  const std::size_t n_points = (ndf.size() - 1) * steps;
  std::vector<float> sigma(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double theta_i = rgl_theta_from_u(node(i, n));
    double sum = 0;
    for (std::size_t k = 0; k < n_points; ++k) {
      const double u = (static_cast<double>(k) + 0.5) / static_cast<double>(n_points), theta = rgl_theta_from_u(u);
      const double x = u * static_cast<double>(ndf.size() - 1), t = x - std::floor(x);
      const auto j = static_cast<std::size_t>(x);
      const double d = (1 - t) * ndf[j] + t * ndf[j + 1];
      // Integral over the azimuth of max(0, a + b cos(phi)).
      const double a = std::cos(theta_i) * std::cos(theta), b = std::sin(theta_i) * std::sin(theta);
      const double last = a >= b ? pi : std::acos(-a / b);
      sum += d * std::sin(theta) * 2 * (a * last + b * std::sin(last)) * (pi * u / static_cast<double>(n_points));
    }
    sigma[i] = static_cast<float>(sum);
  }
  return sigma;
}

}  // namespace lacquer::brdf
