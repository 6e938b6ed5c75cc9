#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>

#include "libacquire/lens_residuals.h"
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

/// What the session's copy of the .cameramodel says of the boards.
std::vector<acquire::CornerResidual> corners_of(const acquire::RigDescription& rig) {
  for (const auto& file : rig.referenced_files)
    if (rig.lens && file.resolved.extension() == ".cameramodel") return acquire::read_corner_residuals(file.resolved);
  return {};
}

/// Arrows of the residuals, enlarged so that one of the rms distance is a fortieth of the image's width.
std::string arrows_figure(const acquire::CameraModel& camera, const std::vector<acquire::CornerResidual>& corners, double rms) {
  std::vector<std::vector<double>> columns(5);
  for (const auto& c : corners) {
    const double row[] = {c.found.x, c.found.y, c.residual.x, c.residual.y, glm::length(c.residual)};
    for (std::size_t k = 0; k < 5; ++k) columns[k].push_back(row[k]);
  }
  const double exact = camera.width / (40 * std::max(rms, 1e-6)), decade = std::pow(10, std::floor(std::log10(exact)));
  const double enlarged = decade * std::floor(exact / decade);
  return html_figure(html_plot(plot_data("r", columns) + fmt::format("set size ratio -1\nset xrange [0:{}]\nset yrange [{}:0]\nset xlabel 'x / px'\nset ylabel 'y / px'\nset cblabel 'distance / px'\nset cbrange [0:{:.3g}]\nset style fill solid 1 noborder\nunset key\n"
                                                                     "set palette defined (0 '#0072B2', 1 '#E69F00', 2 '#D55E00')\n"
                                                                     "plot $r using 1:2:({}*$3):({}*$4):5 with vectors head filled size graph 0.006,20 lw 0.9 lc palette\n",
                                                                     camera.width - 1, camera.height - 1, 3 * rms, enlarged, enlarged),
                               {640, 480}, "corners-", "Residuals of the chessboards' corners over the image, as arrows"),
                     fmt::format("Corners of the boards: arrows from where each was found, {:g} times enlarged, along found minus predicted. Arrows that agree over a region would be a distortion that the model does not have.", enlarged));
}

/// The part along the radius over the distance from the principal point, and its mean in tenths of the corners.
std::string radial_figure(const acquire::CameraModel& camera, const std::vector<acquire::CornerResidual>& corners) {
  std::vector<std::pair<double, double>> radial;
  for (const auto& c : corners) {
    const glm::dvec2 from_centre = c.found - camera.centre;
    const double radius = glm::length(from_centre);
    if (radius > 0) radial.emplace_back(radius, glm::dot(c.residual, from_centre) / radius);
  }
  std::sort(radial.begin(), radial.end());
  std::vector<std::vector<double>> points(2), means(3);
  for (const auto& [radius, residual] : radial) points[0].push_back(radius), points[1].push_back(residual);
  constexpr std::size_t n_parts = 10;
  for (std::size_t part = 0; part < n_parts && radial.size() >= 10 * n_parts; ++part) {
    const std::size_t begin = part * radial.size() / n_parts, end = (part + 1) * radial.size() / n_parts;
    const auto n = static_cast<double>(end - begin);
    double radius = 0, mean = 0, square = 0;
    for (std::size_t i = begin; i < end; ++i) radius += radial[i].first / n, mean += radial[i].second / n;
    for (std::size_t i = begin; i < end; ++i) square += (radial[i].second - mean) * (radial[i].second - mean);
    const double row[] = {radius, mean, 2 * std::sqrt(square / (n - 1) / n)};
    for (std::size_t k = 0; k < 3; ++k) means[k].push_back(row[k]);
  }
  std::string script = plot_data("p", points) + plot_data("m", means) +
                       "set xlabel 'distance from the principal point / px'\nset ylabel 'residual along the radius / px'\nset key top left\n"
                       "plot 0 with lines lw 0.8 lc rgb grey, $p using 1:2 with points pt 7 ps 0.25 lc rgb sky title 'corners'";
  if (!means[0].empty()) script += ", $m using 1:2:3 with yerrorbars pt 7 ps 0.7 lw 1.6 lc rgb vermilion title 'mean of a tenth of them, 2 standard errors'";
  return html_figure(html_plot(script + "\n", {640, 480}, "radial-", "Radial part of the corners' residuals over the distance from the principal point"),
                     "The same along the radius: a mean that leaves zero by more than its bar is radial distortion that the model does not follow.");
}

std::string corner_figures(const ReportSession& s) {
  const std::vector<acquire::CornerResidual> corners = corners_of(s.session.rig);
  if (corners.size() < 3) return "";
  const acquire::CameraModel& camera = s.session.rig.geometry.camera;  // that the boards were solved for
  double sum = 0, largest = 0;
  for (const auto& c : corners) sum += glm::dot(c.residual, c.residual), largest = std::max(largest, glm::length(c.residual));
  const double rms = std::sqrt(sum / static_cast<double>(corners.size()));
  return fmt::format("<p>Lens calibrated from chessboards: {}, {} corners that count, {:.3f} px rms distance, {:.2f} px at most.</p>\n<div class=row>", html_escaped(s.session.rig.lens->model), corners.size(), rms,
                     largest) +
         arrows_figure(camera, corners, rms) + radial_figure(camera, corners) + "</div>\n";
}

std::string uncertainty_figure(const calib::Calibration& calibration) {
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

}  // namespace

std::string lens_figures(const ReportSession& s) {
  const std::string uncertainty = uncertainty_figure(*s.calibration), corners = corner_figures(s);
  if (uncertainty.empty() && corners.empty()) return "";
  return "<h3>Lens</h3>\n" + corners + "<div class=row>" + uncertainty + "</div>\n";
}

}  // namespace lacquer::tools
