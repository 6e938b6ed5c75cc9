#include "libcalib/lens_calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "libbrdf/error.h"
#include "libcalib/lens_cross_validation.h"
#include "libcalib/lens_inputs.h"
#include "libcalib/lens_seed.h"
#include "libcalib/lens_uncertainty.h"

namespace lacquer::calib {

namespace {

constexpr std::size_t min_boards = 4;
constexpr double degree = 3.14159265358979323846 / 180;

bool is_spline(const std::string& model) { return model.starts_with("LENSMODEL_SPLINED_STEREOGRAPHIC_"); }

void check_views(const std::vector<BoardView>& views, const BoardShape& board, int width) {
  if (views.size() < min_boards)
    throw Error(ErrorCode::input, fmt::format("{} board{} found; expected at least {}, better 20, at different places, distances and tilts", views.size(),
                                              views.size() == 1 ? "" : "s", min_boards));
  double largest = 0;
  for (const BoardView& view : views) {
    if (view.corners.size() != board.n_corners())
      throw Error(ErrorCode::input, fmt::format("{}: {} corners; expected {} x {}", view.name, view.corners.size(), board.columns, board.rows));
    for (std::size_t i = 0; i < view.corners.size(); ++i) largest = std::max(largest, glm::length(view.corners[i] - views.front().corners[i]));
  }
  if (largest < 0.02 * width)
    throw Error(ErrorCode::input, fmt::format("all {} boards stand alike (no corner moved by more than {:.1f} px): they fix no lens; move and tilt the board between the photographs",
                                              views.size(), largest));
}

glm::dvec3 normal_of(const BoardPose& pose) {
  const glm::dvec3 r(pose[0], pose[1], pose[2]);
  const double angle = glm::length(r);
  const glm::dvec3 k = angle > 0 ? r / angle : glm::dvec3(0, 0, 1), z(0, 0, 1);
  return std::cos(angle) * z + std::sin(angle) * glm::cross(k, z) + (1 - std::cos(angle)) * k.z * k;
}

/// Parallel boards tell the focal length only together with the distance.
void check_tilts(const std::vector<BoardPose>& poses) {
  double smallest = 1;
  for (const BoardPose& a : poses)
    for (const BoardPose& b : poses) smallest = std::min(smallest, glm::dot(normal_of(a), normal_of(b)));
  constexpr double min_tilt = 8 * degree;
  if (std::acos(std::clamp(smallest, -1.0, 1.0)) < min_tilt)
    throw Error(ErrorCode::input, fmt::format("these boards fix no lens: all {} are parallel within {:.1f} degrees and do not tell the focal length from the distance; tilt the board by 20 to 45 degrees",
                                              poses.size(), std::acos(std::clamp(smallest, -1.0, 1.0)) / degree));
}

/// From the seed, a LENSMODEL_OPENCV4, to the model asked for: stereographic first where a spline corrects one, else the distortion begins at 0.
void change_model(LensProblem& p, const std::string& model) {
  if (is_spline(model)) {
    p.model = "LENSMODEL_STEREOGRAPHIC";
    p.intrinsics.resize(4);
    solve_lens(p, {.warp = false});
  }
  p.model = model;
  p.intrinsics.resize(n_intrinsics_of(model), 0.0);
}

/// As mrcal does: corners off by more than 4 standard deviations in a coordinate are left out, until there is none.
LensSolution solve_without_outliers(LensProblem& p, const LensFreedom& freedom) {
  constexpr double limit = 4, never_px = 0.02;
  for (int pass = 0;; ++pass) {
    const LensSolution s = solve_lens(p, freedom);
    const double largest = std::max(limit * corner_sigma(p, freedom, s), never_px);
    bool found = false;
    for (std::size_t i = 0; i < p.observed.size(); ++i) {
      if (p.observed[i].z < 0 || std::max(std::abs(s.residuals[i].x), std::abs(s.residuals[i].y)) <= largest) continue;
      p.observed[i].z = -1;
      found = true;
    }
    if (!found || pass == 20) return s;
  }
}

double distance_of_boards(const LensProblem& p) {
  const glm::dvec3 middle(0.5 * (p.board.columns - 1) * p.board.square_m, 0.5 * (p.board.rows - 1) * p.board.square_m, 0);
  double sum = 0;
  for (const BoardPose& pose : p.poses) {
    const glm::dvec3 r(pose[0], pose[1], pose[2]), t(pose[3], pose[4], pose[5]);
    const double angle = glm::length(r);
    const glm::dvec3 k = angle > 0 ? r / angle : glm::dvec3(0, 0, 1);
    sum += glm::length(t + std::cos(angle) * middle + std::sin(angle) * glm::cross(k, middle) + (1 - std::cos(angle)) * glm::dot(k, middle) * k);
  }
  return sum / static_cast<double>(p.poses.size());
}

double covered_part(const LensProblem& p) {
  bool seen[10][10] = {};
  for (const glm::dvec3& o : p.observed) {
    const auto cell = [](double v, int size) { return std::clamp(static_cast<int>(10 * (v + 0.5) / size), 0, 9); };
    if (o.z > 0) seen[cell(o.y, p.height)][cell(o.x, p.width)] = true;
  }
  return static_cast<double>(std::count(&seen[0][0], &seen[0][0] + 100, true)) / 100;
}

PixelUncertainty pixel_uncertainty(const LensProblem& p, const LensUncertainty& known, double distance, bool at_infinity) {
  PixelUncertainty u;
  std::vector<glm::dvec2> pixels = pixel_grid(p.width, p.height);
  pixels.insert(pixels.begin(), {0.5 * (p.width - 1), 0.5 * (p.height - 1)});
  const auto rays = unproject(p.model, p.intrinsics, pixels);
  double sum = 0, n = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (std::isnan(rays[i].x)) continue;
    const double sigma = worst_sigma(known.of_pixel(rays[i] * distance, at_infinity));
    if (i == 0) {
      u.centre = sigma;
      continue;
    }
    sum += sigma, ++n;
    u.worst = std::max(u.worst, sigma);
  }
  u.mean = n > 0 ? sum / n : 0;
  return u;
}

std::vector<LensBoard> boards_of(const LensProblem& p, const LensSolution& s, const std::vector<BoardView>& views) {
  std::vector<LensBoard> boards;
  const std::size_t n = p.board.n_corners();
  for (std::size_t b = 0; b < views.size(); ++b) {
    LensBoard board{views[b].name, 0, 0, p.poses[b]};
    double sum = 0;
    for (std::size_t i = b * n; i < (b + 1) * n; ++i) {
      board.n_outliers += p.observed[i].z < 0;
      sum += glm::dot(s.residuals[i], s.residuals[i]);
    }
    board.rms_px = std::sqrt(sum / static_cast<double>(std::max<std::size_t>(n - board.n_outliers, 1)));
    boards.push_back(board);
  }
  return boards;
}

std::vector<acquire::CornerResidual> residuals_of(const LensProblem& p, const LensSolution& s) {
  std::vector<acquire::CornerResidual> corners;
  for (std::size_t i = 0; i < p.observed.size(); ++i)
    if (p.observed[i].z > 0) corners.push_back({{p.observed[i].x, p.observed[i].y}, -s.residuals[i]});  // mrcal's are predicted minus found
  return corners;
}

void warn(LensCalibration& c, const BoardShape& board) {
  if (c.boards.size() < 10) c.warnings.push_back(fmt::format("only {} boards; 20 or more average the noise and let outliers be seen", c.boards.size()));
  if (c.covered < 0.5)
    c.warnings.push_back(fmt::format("corners cover {:.0f} % of the image; beyond them the lens is extrapolated", 100 * c.covered));
  for (const LensBoard& b : c.boards)
    if (2 * b.n_outliers > board.n_corners()) c.warnings.push_back(fmt::format("{}: more than half of its corners are outliers; was the board found rightly?", b.name));
  if (c.cross && c.cross->difference_rms_px > 2 * c.cross->expected_rms_px)
    c.warnings.push_back(fmt::format("the two halves differ {:.1f} times more than their noise says: the model is too simple, or the boards were not still or not flat",
                                     c.cross->difference_rms_px / c.cross->expected_rms_px));
  if (board.columns == board.rows && std::hypot(c.warp_m[0], c.warp_m[1]) > 0)
    c.warnings.push_back("a board with as many rows as columns looks the same turned by 90 degrees: its bend is right only if it was always held the same way up");
}

}  // namespace

void LensOptions::validate() const {
  const bool known = model == "LENSMODEL_OPENCV4" || model == "LENSMODEL_OPENCV5" || model == "LENSMODEL_OPENCV8" || model == "LENSMODEL_OPENCV12" || is_spline(model);
  if (!known || n_intrinsics_of(model) == 0)
    throw Error(ErrorCode::usage, fmt::format("lens model {}: expected LENSMODEL_OPENCV4, OPENCV5, OPENCV8, OPENCV12 or "
                                              "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=12_fov_x_deg=60", model));
  if (n_intrinsics_of(model) > 1500) throw Error(ErrorCode::usage, fmt::format("lens model {}: expected at most 1500 parameters", model));
  if (!(focal_px >= 0)) throw Error(ErrorCode::usage, fmt::format("focal length: expected pixels above 0, got {}", focal_px));
}

LensCalibration calibrate_lens(const std::vector<BoardView>& views, const BoardShape& board, int width, int height, const LensOptions& options) {
  options.validate();
  board.validate();
  check_views(views, board, width);
  LensProblem p = seed_lens(views, board, width, height, options.focal_px);
  check_tilts(p.poses);
  change_model(p, options.model);
  LensFreedom freedom{.core = !is_spline(options.model), .warp = false};
  solve_lens(p, freedom);
  freedom.warp = options.warp;
  const LensSolution s = options.reject_outliers ? solve_without_outliers(p, freedom) : solve_lens(p, freedom);

  LensCalibration c;
  c.lens = {options.model, width, height, p.intrinsics, {}};
  c.warp_m = p.warp;
  c.boards = boards_of(p, s, views);
  c.residuals = residuals_of(p, s);
  c.n_corners = p.observed.size();
  c.n_outliers = s.n_outliers;
  c.rms_px = s.rms_px;
  c.sigma_px = corner_sigma(p, freedom, s);
  c.board_distance_m = distance_of_boards(p);
  c.covered = covered_part(p);
  const LensUncertainty known(p, freedom, c.sigma_px);
  if (!is_spline(options.model)) {
    c.lens.covariance = known.of_intrinsics();
    const double relative = std::sqrt(c.lens.covariance[0]) / p.intrinsics[0];
    if (!(relative < 0.05))
      throw Error(ErrorCode::input, fmt::format("these boards fix no lens: the focal length is known to {:.0f} % only; expected boards at different places and tilts over the whole image",
                                                100 * relative));
  }
  if (options.warp) c.warp_sigma_m = known.warp_sigma();
  c.at_boards = pixel_uncertainty(p, known, c.board_distance_m, false);
  c.at_infinity = pixel_uncertainty(p, known, 1, true);
  if (options.cross_validate && views.size() >= 2 * min_boards) c.cross = cross_validate(p, freedom);
  c.inputs = optimization_inputs(p, freedom, views);
  warn(c, board);
  return c;
}

}  // namespace lacquer::calib
