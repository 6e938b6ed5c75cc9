#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "bench/stability/hard_case.h"
#include "libcalib/geometry_projection.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/sphere_outline.h"
#include "tests/libcalib/sphere_photograph.h"

/// Rays that graze, lenses that bend, and images that do not determine the geometry.
namespace lacquer::bench {

namespace {

using namespace calib;
constexpr double degree = 3.14159265358979323846 / 180;

/// Silhouette points `n` around, found by bisection, with noise.
std::vector<EdgePoint> edges_of(const acquire::RigGeometry& g, double sigma, double to_deg, int n, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0, sigma);
  std::vector<EdgePoint> edges;
  const glm::dvec2 centre = *g.camera.project(g.cam_from_rig.translation);
  for (int k = 0; k < n; ++k) {
    const double a = to_deg * degree * k / n;
    const glm::dvec2 outwards(std::cos(a), std::sin(a));
    double low = 0, high = 400;
    for (int i = 0; i < 60; ++i) {
      const double middle = (low + high) / 2;
      (acquire::trace(g, centre + middle * outwards) ? low : high) = middle;
    }
    edges.push_back({centre + (low + normal(random)) * outwards, sigma});
  }
  return edges;
}

std::vector<Highlight> highlights_of(const acquire::RigGeometry& g, double sigma, double from_deg, double to_deg, double step_deg, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0, sigma);
  std::vector<Highlight> found;
  for (double a = from_deg; a <= to_deg; a += step_deg)
    if (const auto pixel = mirror_pixel(g, g.place_light(0, a * degree).position))
      found.push_back({fmt::format("L{:03}", found.size()), 0, a * degree, *pixel + glm::dvec2(normal(random), normal(random)), sigma * sigma, 0, sigma * sigma});
  return found;
}

double centre_error(const acquire::RigGeometry& found, const acquire::RigGeometry& truth) {
  return glm::length(*found.camera.project(found.cam_from_rig.translation) - *truth.camera.project(truth.cam_from_rig.translation));
}

/// The sphere 2 mm from where the rig file has it.
acquire::RigGeometry moved(acquire::RigGeometry g) {
  const glm::dvec3 by(0.002, -0.001, 0.001);
  g.cam_from_rig.translation += g.cam_from_rig.rotation * by;
  for (auto& light : g.lights) light.position -= by;
  g.axis_point -= by;
  return g;
}

bool says(const GeometryEstimate& e, const std::string& text) {
  return std::any_of(e.warnings.begin(), e.warnings.end(), [&](const std::string& w) { return w.find(text) != std::string::npos; });
}

HardCases optics() {
  HardCases cases;
  const auto g = test::photographed_rig();
  double worst = 0;
  for (double a = -175; a <= 175; a += 5) {
    const glm::dvec3 light = g.place_light(0, a * degree).position;
    const auto pixel = mirror_pixel(g, light);
    const auto point = pixel ? acquire::trace(g, *pixel) : std::nullopt;
    if (!point) continue;
    worst = std::max(worst, glm::length(glm::normalize(glm::normalize(light - point->position) + point->wo) - point->normal));
  }
  cases.push_back(at_most("mirror pixel of a light up to 175° round the sphere", "solved in its plane, obeys the law of reflection", worst, 1e-7, " rad"));
  auto strong = g.camera;
  strong.focal = {400, 400};
  strong.distortion = {-0.35, 0.15, 1e-3, -1e-3, -0.03, 0.02, 0.01, 0};
  worst = 0;
  std::size_t lost = 0;
  for (int y = 0; y < strong.height; y += 7)
    for (int x = 0; x < strong.width; x += 7) {
      const auto ray = strong.unproject({x, y});
      const auto back = ray ? strong.project(ray->direction) : std::nullopt;
      if (!back) ++lost; else worst = std::max(worst, glm::length(*back - glm::dvec2(x, y)));
    }
  cases.push_back(at_most("a wide lens with strong rational distortion, there and back", fmt::format("Newton's iteration; {} pixels without a line of sight", lost), lost == 0 ? worst : NAN, 1e-8, " px"));
  strong.distortion = {-2, 0, 0, 0, 0, 0, 0, 0};
  const auto folded = strong.unproject({0, 0});
  cases.push_back({"a pixel beyond the radius where the distortion folds the image over", "no line of sight, instead of a wrong one", folded ? "a ray" : "none", !folded});
  worst = 0;
  for (const auto& e : edges_of(g, 0, 360, 50, 1)) worst = std::max(worst, std::abs(*silhouette_distance(g, e.pixel)));
  cases.push_back(at_most("silhouette of the traced sphere against the closed form of its cone", "bisection and closed form agree", worst, 1e-6, " px"));
  return cases;
}

HardCases solving() {
  HardCases cases;
  const auto nominal = test::photographed_rig(), truth = moved(nominal);
  const auto exact = solve_geometry(nominal, edges_of(truth, 1e-3, 360, 90, 1), highlights_of(truth, 1e-3, 0, 120, 3, 2));
  cases.push_back(at_most("sphere 2 mm off the rig file, hardly any noise", "found, the centre to what is left open by how a limb is believed to look alike on all sides (prior 0.02 px)", centre_error(exact.geometry, truth), 0.02, " px"));
  const auto part = solve_geometry(nominal, edges_of(truth, 0.05, 70, 60, 3), highlights_of(truth, 0.02, 0, 120, 3, 4));
  const double pull = centre_error(part.geometry, truth) / part.centre_sigma_px;
  cases.push_back(at_most("a fifth of the silhouette", fmt::format("centre within its own error bar of {:.3f} px", part.centre_sigma_px), pull, 3, " σ"));
  const auto few = solve_geometry(nominal, edges_of(truth, 0.05, 360, 90, 5), highlights_of(truth, 0.03, 40, 50, 5, 6));
  cases.push_back({"three highlights within 10°", "says what the images do not determine; the ruler's priors stay", fmt::format("{} warnings, distance ± {:.1f} %", few.warnings.size(), 100 * few.distance_sigma), says(few, "do not determine")});
  const auto none = solve_geometry(nominal, edges_of(truth, 0.05, 360, 90, 7), {});
  cases.push_back({"no highlight at all", "sphere from its silhouette, lights as in the rig file, and says so", fmt::format("centre off by {:.3f} px", centre_error(none.geometry, truth)), says(none, "no highlight") && centre_error(none.geometry, truth) < 0.1});
  auto false_one = highlights_of(truth, 0.02, 0, 120, 5, 8);
  false_one[7].pixel += glm::dvec2(3, -2);
  const auto robust = solve_geometry(nominal, edges_of(truth, 0.05, 180, 90, 9), false_one);
  cases.push_back({"one of 25 highlights 3.6 px off", "left out and named", robust.outliers.size() == 1 ? "left out: " + robust.outliers[0].view : fmt::format("{} left out", robust.outliers.size()), robust.outliers.size() == 1 && robust.outliers[0].view == false_one[7].view});
  auto wrong_radius = nominal;
  wrong_radius.sphere_radius *= 1.01;
  const auto scaled = solve_geometry(wrong_radius, edges_of(nominal, 0.05, 360, 90, 10), highlights_of(nominal, 0.005, 0, 130, 3, 11));
  cases.push_back({"radius 1 % too large in the rig file", "a scene 1 % larger explains every image as well; distance and warning say so", fmt::format("sphere at {:.4f} m instead of 1", scaled.geometry.cam_from_rig.translation.z), says(scaled, "radius")});
  return cases;
}

HardCases outlines() {
  HardCases cases;
  auto nominal = test::photographed_rig();
  nominal.camera.centre.x = 100;
  const auto truth = moved(nominal);
  OutlineFinder cut(nominal, {.lens_blur_px = 0});
  for (const double angle : {-0.8, 0.0, 0.8}) cut.add(test::photograph(truth, angle, {.diffuse = 0.1}, 0.02, 4, 1), nominal.place_light(0, angle));
  const auto found = cut.finish();
  cases.push_back(at_most("sphere cut by the image's border", fmt::format("{} of {} arcs found", found.edges.size(), found.n_arcs), centre_error(found.geometry, truth), 0.1, " px off"));
  OutlineFinder dark(nominal, {.lens_blur_px = 0});
  auto black = test::photograph(truth, 0, {.diffuse = 0, .height = 0}, 0.02, 1, 2);
  dark.add(black, nominal.place_light(0, 0));
  const auto nothing = dark.finish();
  cases.push_back({"a black photograph", "no edge is found, the rig file's sphere stays", fmt::format("{} edges", nothing.edges.size()), nothing.edges.empty()});
  return cases;
}

}  // namespace

HardCases geometry_cases() {
  HardCases all;
  for (const auto& part : {optics(), solving(), outlines()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace lacquer::bench
