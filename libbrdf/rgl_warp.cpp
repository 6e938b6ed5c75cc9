#include "libbrdf/rgl_warp.h"

#include <algorithm>
#include <cmath>

namespace lacquer::brdf {

namespace {

/// Patch of a bilinear grid and position in it.
struct Patch {
  std::size_t x, y;
  glm::dvec2 t;  ///< [0, 1]^2
};

Patch patch_at(const glm::dvec2& u, std::size_t nx, std::size_t ny) {
  const auto axis = [](double position, std::size_t n, double& fraction) {
    const double scaled = std::clamp(position, 0.0, 1.0) * static_cast<double>(n - 1);
    const std::size_t i = std::min(static_cast<std::size_t>(scaled), n - 2);
    fraction = scaled - static_cast<double>(i);
    return i;
  };
  Patch p;
  p.x = axis(u.x, nx, p.t.x);
  p.y = axis(u.y, ny, p.t.y);
  return p;
}

double mix(double a, double b, double t) { return (1 - t) * a + t * b; }

/// t in [0, 1] with integral of (1 - x) a + x b from 0 to t equal to `area`; a, b >= 0.
double invert_trapezoid(double a, double b, double area) {
  // The form of the root that subtracts nothing; 0 / 0 where the density vanishes, and with it the area.
  const double denominator = a + std::sqrt(std::max(a * a + 2 * (b - a) * area, 0.0));
  return denominator > 0 ? std::clamp(2 * area / denominator, 0.0, 1.0) : 0.0;
}

/// Cell of a cumulative sum in which `x` lies: the last i <= n - 2 with value(i) <= x.
template <typename Value>
std::size_t find_cell(std::size_t n, double x, const Value& value) {
  std::size_t low = 0, high = n - 1;
  while (high - low > 1) {
    const std::size_t middle = (low + high) / 2;
    (value(middle) <= x ? low : high) = middle;
  }
  return low;
}

}  // namespace

Blend blend_between(std::span<const float> nodes, double x) {
  if (nodes.size() == 1) return {};
  const auto above = std::upper_bound(nodes.begin(), nodes.end(), x);
  const auto second = std::clamp<std::size_t>(static_cast<std::size_t>(above - nodes.begin()), 1, nodes.size() - 1);
  const double low = nodes[second - 1], high = nodes[second];
  return {second - 1, second, std::clamp((x - low) / (high - low), 0.0, 1.0)};
}

double bilinear_integral(std::span<const float> values, std::size_t nx, std::size_t ny) {
  double sum = 0;
  for (std::size_t y = 0; y < ny; ++y)
    for (std::size_t x = 0; x < nx; ++x)
      sum += values[y * nx + x] * (x == 0 || x == nx - 1 ? 0.5 : 1.0) * (y == 0 || y == ny - 1 ? 0.5 : 1.0);
  return sum;
}

SquareGrid::SquareGrid(std::vector<float> values, std::size_t nx, std::size_t ny) : values_(std::move(values)), nx_(nx), ny_(ny) {}

double SquareGrid::value(const glm::dvec2& u, const Blend& slices) const {
  const Patch p = patch_at(u, nx_, ny_);
  const auto in_slice = [&](std::size_t slice) {
    const float* v = values_.data() + (slice * ny_ + p.y) * nx_ + p.x;
    return mix(mix(v[0], v[1], p.t.x), mix(v[nx_], v[nx_ + 1], p.t.x), p.t.y);
  };
  if (slices.weight == 0) return in_slice(slices.first);
  return mix(in_slice(slices.first), in_slice(slices.second), slices.weight);
}

std::optional<VisibleNormalWarp> VisibleNormalWarp::create(std::span<const float> density, std::size_t nx, std::size_t ny) {
  VisibleNormalWarp warp(nx, ny);
  const std::size_t slice_size = nx * ny, n_slices = density.size() / slice_size;
  warp.density_.resize(n_slices * slice_size);
  warp.conditional_.resize(n_slices * slice_size);
  warp.marginal_.resize(n_slices * ny);
  for (std::size_t slice = 0; slice < n_slices; ++slice) {
    const float* values = density.data() + slice * slice_size;
    double* scaled = warp.density_.data() + slice * slice_size;
    double* conditional = warp.conditional_.data() + slice * slice_size;
    double* marginal = warp.marginal_.data() + slice * ny;

    // Trapezoids: exact integrals of the bilinear density, in units of a patch.
    for (std::size_t y = 0; y < ny; ++y)
      for (std::size_t x = 1; x < nx; ++x)
        conditional[y * nx + x] = conditional[y * nx + x - 1] + 0.5 * (double{values[y * nx + x - 1]} + double{values[y * nx + x]});
    for (std::size_t y = 1; y < ny; ++y)
      marginal[y] = marginal[y - 1] + 0.5 * (conditional[y * nx - 1] + conditional[(y + 1) * nx - 1]);

    const double total = marginal[ny - 1];
    if (!(total > 0)) return std::nullopt;
    for (std::size_t i = 0; i < slice_size; ++i) {
      scaled[i] = values[i] / total;
      conditional[i] /= total;
    }
    for (std::size_t y = 0; y < ny; ++y) marginal[y] /= total;
  }
  return warp;
}

glm::dvec2 VisibleNormalWarp::sample(const glm::dvec2& s, std::size_t slice) const {
  const double* density = density_.data() + slice * nx_ * ny_;
  const double* conditional = conditional_.data() + slice * nx_ * ny_;
  const double* marginal = marginal_.data() + slice * ny_;
  const auto row_sum = [&](std::size_t y) { return conditional[y * nx_ + nx_ - 1]; };

  const std::size_t y = find_cell(ny_, s.y, [&](std::size_t i) { return marginal[i]; });
  const double t = invert_trapezoid(row_sum(y), row_sum(y + 1), s.y - marginal[y]);

  const auto in_row = [&](const double* values, std::size_t x) { return mix(values[y * nx_ + x], values[(y + 1) * nx_ + x], t); };
  const double along_row = s.x * in_row(conditional, nx_ - 1);
  const std::size_t x = find_cell(nx_, along_row, [&](std::size_t i) { return in_row(conditional, i); });
  const double fraction = invert_trapezoid(in_row(density, x), in_row(density, x + 1), along_row - in_row(conditional, x));
  return {(static_cast<double>(x) + fraction) / static_cast<double>(nx_ - 1), (static_cast<double>(y) + t) / static_cast<double>(ny_ - 1)};
}

std::optional<glm::dvec2> VisibleNormalWarp::invert(const glm::dvec2& u, const Blend& slices) const {
  const Patch p = patch_at(u, nx_, ny_);
  const auto node = [&](const std::vector<double>& values, std::size_t slice_size, std::size_t i) {
    return mix(values[slices.first * slice_size + i], values[slices.second * slice_size + i], slices.weight);
  };
  const std::size_t size = nx_ * ny_, corner = p.y * nx_ + p.x;

  // Integral of the interpolated row from 0 to u.x: whole patches, then the part of this patch.
  const double left = mix(node(density_, size, corner), node(density_, size, corner + nx_), p.t.y);
  const double right = mix(node(density_, size, corner + 1), node(density_, size, corner + nx_ + 1), p.t.y);
  const double before = mix(node(conditional_, size, corner), node(conditional_, size, corner + nx_), p.t.y);
  const double along_row = before + p.t.x * (left + 0.5 * p.t.x * (right - left));

  const double row_0 = node(conditional_, size, p.y * nx_ + nx_ - 1), row_1 = node(conditional_, size, p.y * nx_ + 2 * nx_ - 1);
  const double whole_row = mix(row_0, row_1, p.t.y);
  if (!(whole_row > 0)) return std::nullopt;
  const double rows = node(marginal_, ny_, p.y) + p.t.y * (row_0 + 0.5 * p.t.y * (row_1 - row_0));
  return glm::dvec2(along_row / whole_row, rows);
}

}  // namespace lacquer::brdf
