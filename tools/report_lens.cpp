#include <fmt/format.h>

#include <cmath>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>

#include "tools/report_page.h"

namespace lacquer::tools {

namespace {

constexpr int n_columns = 41, n_rows = 31;

/// Lower triangle L with L L' = `a` (row-major n x n); columns of no variance are 0.
std::vector<double> cholesky(const std::vector<double>& a, std::size_t n) {
  std::vector<double> l(n * n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = a[i * n + j];
      for (std::size_t k = 0; k < j; ++k) sum -= l[i * n + k] * l[j * n + k];
      if (i == j) l[i * n + i] = std::sqrt(std::max(sum, 0.0));
      else if (l[j * n + j] > 0) l[i * n + j] = sum / l[j * n + j];
    }
  return l;
}

/// Intrinsics number `k` of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 moved by `by`.
acquire::CameraModel moved(acquire::CameraModel camera, std::size_t k, double by) {
  if (k < 2) camera.focal[static_cast<int>(k)] += by;
  else if (k < 4) camera.centre[static_cast<int>(k - 2)] += by;
  else camera.distortion[k - 4] += by;
  return camera;
}

struct Place {
  std::size_t index;  ///< in the grid, row by row
  glm::dvec2 pixel;
  glm::dvec3 direction;
  glm::dvec2 turned[3];  ///< of the pixel, per radian about x, y, z of the camera
};

std::vector<Place> places(const acquire::CameraModel& camera) {
  std::vector<Place> list;
  for (int r = 0; r < n_rows; ++r)
    for (int c = 0; c < n_columns; ++c) {
      const glm::dvec2 pixel(c * (camera.width - 1.0) / (n_columns - 1), r * (camera.height - 1.0) / (n_rows - 1));
      const auto ray = camera.unproject(pixel);
      if (!ray) continue;
      Place p{static_cast<std::size_t>(r * n_columns + c), pixel, ray->direction, {}};
      bool whole = true;
      for (int k = 0; k < 3; ++k) {
        glm::dvec3 axis(0.0);
        axis[k] = 1e-6;
        const auto there = camera.project(p.direction + glm::cross(axis, p.direction)), back = camera.project(p.direction - glm::cross(axis, p.direction));
        whole = whole && there && back;
        if (whole) p.turned[k] = (*there - *back) / 2e-6;
      }
      if (whole) list.push_back(p);
    }
  return list;
}

/// What is left of a field over `list` when the best small rotation, which a pose takes up, is taken off.
void remove_rotation(const std::vector<Place>& list, std::vector<glm::dvec2>& field) {
  glm::dmat3 normal(0.0);
  glm::dvec3 right(0.0);
  for (std::size_t i = 0; i < list.size(); ++i)
    for (int a = 0; a < 3; ++a) {
      right[a] += glm::dot(list[i].turned[a], field[i]);
      for (int b = 0; b < 3; ++b) normal[a][b] += glm::dot(list[i].turned[a], list[i].turned[b]);
    }
  const glm::dvec3 turn = glm::inverse(normal) * right;
  for (std::size_t i = 0; i < list.size(); ++i)
    for (int a = 0; a < 3; ++a) field[i] -= turn[a] * list[i].turned[a];
}

}  // namespace

std::string lens_figure(const calib::Calibration& calibration) {
  const acquire::CameraModel& camera = calibration.geometry.camera;
  const auto n = static_cast<std::size_t>(std::llround(std::sqrt(static_cast<double>(calibration.lens_covariance.size()))));
  if (n < 4 || n > 12 || n * n != calibration.lens_covariance.size()) return "";
  const std::vector<Place> list = places(camera);
  const std::vector<double> l = cholesky(calibration.lens_covariance, n);
  std::vector<glm::dmat2> covariance(list.size(), glm::dmat2(0.0));
  for (std::size_t column = 0; column < n; ++column) {
    acquire::CameraModel there = camera, back = camera;
    for (std::size_t k = 0; k < n; ++k) there = moved(there, k, 0.1 * l[k * n + column]), back = moved(back, k, -0.1 * l[k * n + column]);
    std::vector<glm::dvec2> field(list.size(), glm::dvec2(0.0));
    for (std::size_t i = 0; i < list.size(); ++i) {
      const auto a = there.project(list[i].direction), b = back.project(list[i].direction);
      if (a && b) field[i] = (*a - *b) / 0.2;
    }
    remove_rotation(list, field);
    for (std::size_t i = 0; i < list.size(); ++i) covariance[i] += glm::outerProduct(field[i], field[i]);
  }
  std::vector<std::vector<double>> map(3), arrows(4);
  for (int r = 0; r < n_rows; ++r)
    for (int c = 0; c < n_columns; ++c)
      map[0].push_back(c * (camera.width - 1.0) / (n_columns - 1)), map[1].push_back(r * (camera.height - 1.0) / (n_rows - 1)), map[2].push_back(std::nan(""));
  double largest = 0;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const glm::dmat2& v = covariance[i];
    const double mean = (v[0][0] + v[1][1]) / 2, sigma = std::sqrt(mean + std::hypot((v[0][0] - v[1][1]) / 2, v[0][1]));
    map[2][list[i].index] = sigma;
    largest = std::max(largest, sigma);
    if (i % 5 != 0) continue;
    const glm::dvec3& d = list[i].direction;
    const glm::dvec2 shift = list[i].pixel - (camera.centre + camera.focal * glm::dvec2(d.x, d.y) / d.z);
    const double arrow[] = {list[i].pixel.x, list[i].pixel.y, -shift.x, -shift.y};
    for (std::size_t k = 0; k < 4; ++k) arrows[k].push_back(arrow[k]);
  }
  return html_figure(html_plot(plot_data("s", map) + plot_data("d", arrows) +
                                   fmt::format("set size ratio -1\nset xrange [0:{}]\nset yrange [{}:0]\nset xlabel 'x / px'\nset ylabel 'y / px'\nset cblabel 'sigma / px'\nset style fill solid 1 noborder\nunset key\n"
                                               "set palette defined (0 '#440154', 25 '#3b528b', 50 '#21918c', 75 '#5ec962', 100 '#fde725')\n"
                                               "plot $s using 1:2:3 with image pixels, $d using 1:2:3:4 with vectors head filled lw 0.8 lc rgb black\n",
                                               camera.width - 1, camera.height - 1),
                               {640, 480}, "lens-", "Uncertainty of the lens over the image, with its distortion as arrows"),
                     fmt::format("The lens: colour, standard deviation of a far point's pixel in its worst direction, from the covariance of the calibration with a common rotation taken off (largest {:.2g} px); "
                                 "arrows, to where a lens without distortion would have it.", largest));
}

}  // namespace lacquer::tools
