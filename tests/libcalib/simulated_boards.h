#pragma once

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <random>
#include <vector>

#include "libacquire/rig_geometry.h"
#include "libcalib/lens_boards.h"

namespace lacquer::test {

/// A board held by hand before a camera, and what it is seen as.
struct SimulatedBoards {
  acquire::CameraModel camera;
  calib::BoardShape board{9, 6, 0.025};
  double noise_px = 0.1;           ///< of each coordinate of a corner
  double warp_x = 0, warp_y = 0;   ///< metres, as mrcal: lift w_x (1 - u^2) + w_y (1 - v^2)
  double max_tilt = 0.7;           ///< radians
  double distance = 0.4;           ///< metres, half as much again at most
  double reach = 0.75;             ///< of the half image that the board's middle comes to

  /// `n` whole boards in view; `truth_free_of_noise` for corners without noise.
  std::vector<calib::BoardView> views(std::size_t n, unsigned seed) const {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> uniform(-1, 1);
    std::normal_distribution<double> normal;
    std::vector<calib::BoardView> result;
    for (int attempt = 0; result.size() < n && attempt < 100000; ++attempt) {
      const double a = 3.14159 * uniform(random), tilt = max_tilt * uniform(random), roll = 0.4 * uniform(random);
      const glm::dmat3 rotation = turned(glm::dvec3(std::cos(a), std::sin(a), 0), tilt) * turned(glm::dvec3(0, 0, 1), roll);
      const double z = distance * (1 + 0.5 * std::abs(uniform(random)));
      const glm::dvec2 pixel = glm::dvec2(camera.width, camera.height) * 0.5 * (glm::dvec2(1) + reach * glm::dvec2(uniform(random), uniform(random)));
      const auto ray = camera.unproject(pixel);
      if (!ray) continue;
      calib::BoardView view{"board " + std::to_string(result.size()), {}};
      for (int row = 0; row < board.rows; ++row)
        for (int column = 0; column < board.columns; ++column) {
          const double u = 2.0 * column / (board.columns - 1) - 1, v = 2.0 * row / (board.rows - 1) - 1;
          const glm::dvec3 p(0.5 * u * (board.columns - 1) * board.square_m, 0.5 * v * (board.rows - 1) * board.square_m,
                             warp_x * (1 - u * u) + warp_y * (1 - v * v));
          const auto q = camera.project(rotation * p + ray->direction / ray->direction.z * z);
          if (!q || q->x < 0 || q->y < 0 || q->x > camera.width - 1 || q->y > camera.height - 1) continue;
          view.corners.push_back(*q + noise_px * glm::dvec2(normal(random), normal(random)));
        }
      if (view.corners.size() == board.n_corners()) result.push_back(view);
    }
    return result;
  }

  static glm::dmat3 turned(const glm::dvec3& k, double angle) {
    const glm::dmat3 cross(0, k.z, -k.y, -k.z, 0, k.x, k.y, -k.x, 0);
    return glm::dmat3(1.0) + std::sin(angle) * cross + (1 - std::cos(angle)) * (cross * cross);
  }
};

/// A lens as many machine-vision lenses are: 8 mm on 2/3 inch, some barrel.
inline acquire::CameraModel usual_camera() {
  acquire::CameraModel camera;
  camera.width = 1360, camera.height = 1024;
  camera.focal = {1240, 1242};
  camera.centre = {688.3, 505.1};
  camera.distortion = {-0.12, 0.09, 0.0006, -0.0004};
  return camera;
}

}  // namespace lacquer::test
