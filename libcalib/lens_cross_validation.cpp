#include "libcalib/lens_cross_validation.h"

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/matrix_access.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>

#include "libcalib/lens_uncertainty.h"

namespace lacquer::calib {

namespace {

/// The boards with index first, first + 2, ...
LensProblem half_of(const LensProblem& all, std::size_t first) {
  LensProblem half = all;
  half.poses.clear();
  half.observed.clear();
  const auto n = static_cast<std::ptrdiff_t>(all.board.n_corners());
  for (std::size_t b = first; b < all.poses.size(); b += 2) {
    half.poses.push_back(all.poses[b]);
    const auto begin = all.observed.begin() + static_cast<std::ptrdiff_t>(b) * n;
    half.observed.insert(half.observed.end(), begin, begin + n);
  }
  return half;
}

double square_sum(const LensSolution& s) {
  double sum = 0;
  for (const glm::dvec2& r : s.residuals) sum += glm::dot(r, r);
  return sum;
}

double square_length(const glm::dvec2& v) { return glm::dot(v, v); }

}  // namespace

std::vector<glm::dvec2> pixel_grid(int width, int height) {
  constexpr int n_x = 21, n_y = 15;
  std::vector<glm::dvec2> pixels;
  for (int y = 0; y < n_y; ++y)
    for (int x = 0; x < n_x; ++x) pixels.emplace_back((width - 1.0) * x / (n_x - 1), (height - 1.0) * y / (n_y - 1));
  return pixels;
}

double corner_sigma(const LensProblem& problem, const LensFreedom& freedom, const LensSolution& solution) {
  const double n_states = static_cast<double>(6 * problem.poses.size() + problem.intrinsics.size() - (freedom.core ? 0 : 4) + (freedom.warp ? 2 : 0));
  const double n_values = 2.0 * static_cast<double>(problem.observed.size() - solution.n_outliers);
  return std::sqrt(square_sum(solution) / std::max(n_values - n_states, 1.0));
}

glm::dmat3 closest_rotation(const std::vector<glm::dvec3>& from, const std::vector<glm::dvec3>& to) {
  glm::dmat3 rotation(1.0);
  for (int iteration = 0; iteration < 4; ++iteration) {
    glm::dmat3 normal(0.0);  // of to - v = w x v, v = rotation * from
    glm::dvec3 right(0.0);
    for (std::size_t i = 0; i < from.size(); ++i) {
      const glm::dvec3 v = rotation * from[i];
      normal += glm::dmat3(glm::dot(v, v)) - glm::outerProduct(v, v);
      right += glm::cross(v, to[i] - v);
    }
    const glm::dvec3 w = glm::inverse(normal) * right;
    const double angle = glm::length(w);
    if (!(angle > 1e-15)) break;
    const glm::dvec3 k = w / angle;
    const glm::dmat3 cross(0, k.z, -k.y, -k.z, 0, k.x, k.y, -k.x, 0);  // columns
    rotation = (glm::dmat3(1.0) + std::sin(angle) * cross + (1 - std::cos(angle)) * (cross * cross)) * rotation;
  }
  return rotation;
}

LensCrossValidation cross_validate(const LensProblem& all, const LensFreedom& freedom) {
  LensCrossValidation result;
  LensProblem half[2] = {half_of(all, 0), half_of(all, 1)};
  double own = 0, other = 0, n = 0, sigma[2];
  for (std::size_t h = 0; h < 2; ++h) {
    result.n_boards[h] = half[h].poses.size();
    const LensSolution s = solve_lens(half[h], freedom);
    sigma[h] = corner_sigma(half[h], freedom, s);
    own += square_sum(s);
    n += static_cast<double>(half[h].observed.size() - s.n_outliers);
  }
  for (std::size_t h = 0; h < 2; ++h) {
    LensProblem held_out = half[h];
    held_out.intrinsics = half[1 - h].intrinsics;
    held_out.warp = half[1 - h].warp;
    other += square_sum(solve_lens(held_out, {.core = false, .distortion = false, .warp = false, .regularise = false}));
  }
  result.fitted_rms_px = std::sqrt(own / n);
  result.held_out_rms_px = std::sqrt(other / n);

  const LensUncertainty known[2] = {{half[0], freedom, sigma[0]}, {half[1], freedom, sigma[1]}};
  std::vector<glm::dvec2> pixels;
  std::vector<glm::dvec3> rays[2];
  const auto grid = pixel_grid(all.width, all.height);
  const auto first = unproject(all.model, half[0].intrinsics, grid), second = unproject(all.model, half[1].intrinsics, grid);
  for (std::size_t i = 0; i < grid.size(); ++i)
    if (!std::isnan(first[i].x + second[i].x)) pixels.push_back(grid[i]), rays[0].push_back(first[i]), rays[1].push_back(second[i]);
  if (pixels.empty()) return result;
  const glm::dmat3 rotation = closest_rotation(rays[0], rays[1]);
  std::vector<glm::dvec3> turned;
  for (const glm::dvec3& ray : rays[0]) turned.push_back(rotation * ray);
  const auto seen = project(all.model, half[1].intrinsics, turned);
  double difference = 0, expected = 0, worst = 0;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const double d = square_length(seen[i] - pixels[i]);
    difference += d;
    worst = std::max(worst, d);
    for (std::size_t h = 0; h < 2; ++h) {
      const glm::dmat2 c = known[h].of_pixel(rays[h][i], true);
      expected += c[0][0] + c[1][1];
    }
  }
  result.difference_rms_px = std::sqrt(difference / static_cast<double>(pixels.size()));
  result.expected_rms_px = std::sqrt(expected / static_cast<double>(pixels.size()));
  result.worst_difference_px = std::sqrt(worst);
  return result;
}

}  // namespace lacquer::calib
