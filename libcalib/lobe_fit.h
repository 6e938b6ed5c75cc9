#pragma once

#include <array>
#include <glm/mat2x2.hpp>
#include <glm/vec2.hpp>
#include <vector>

#include "libcalib/highlight_window.h"

/// Symmetric lobe fitted to the values of a highlight. Internal to highlights.cpp.
namespace lacquer::calib {

struct LobeFitOptions {
  glm::dvec2 start{0.0};    ///< shift, pixels
  double width2 = 1e-4;     ///< squared 1/e radius to begin with, slope^2
  double reach = 2.9;       ///< of the window, sigmas of the lobe as it is seen
  double lens_blur_px = 0;
};

/// shift, logarithm of the squared width, and per channel base and height.
struct LobeFit {
  glm::dvec2 shift{0.0};         ///< of the whole highlight against where it was expected, pixels
  double log_width2 = 0;         ///< of the paint: without lens, pixel and emitter
  std::array<double, 3> base{}, height{};
  glm::dmat2 covariance{0.0};    ///< of the shift
  glm::dmat2 spread_px{1.0};     ///< covariance of the lobe as it is seen, pixels^2
  std::size_t n = 0, n_clipped = 0;
  double left_out = 0;           ///< share of the window that the fit does not believe: dust, another lamp
  double elongation = 0;         ///< by which it is longer than it is wide, share of its variance: two lobes that have merged
  bool good = false;
};

/// Gauss-Newton. Each value counts with its noise and a doubt of 3 % of the profile, less towards the window's edge, and next to nothing
/// where it is many times further from the fit than most. The window moves with the lobe: its centre is that of any symmetric profile.
LobeFit fit_lobe(const std::vector<HighlightValue>& values, const ExpectedHighlight& expected, const LobeFitOptions& options);

}  // namespace lacquer::calib
