#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <random>

#include "libbrdf/error.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/quick_rig.h"

namespace lacquer::calib {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;

struct Draw {
  std::mt19937_64 random;
  std::normal_distribution<double> normal{0, 1};
  explicit Draw(unsigned seed) : random(seed) {}
  double operator()(double sigma) { return sigma * normal(random); }
  glm::dvec3 vector(double sigma) { return {(*this)(sigma), (*this)(sigma), (*this)(sigma)}; }
};

glm::dvec3 turned(const glm::dvec3& p, const glm::dvec3& axis, double a) {
  return std::cos(a) * p + std::sin(a) * glm::cross(axis, p) + (1 - std::cos(a)) * glm::dot(axis, p) * axis;
}

struct TrueRig {
  acquire::RigGeometry geometry;
  double scale = 1;
};

/// What a builder with a ruler ends up with: errors drawn from the priors.
TrueRig built(const acquire::RigGeometry& nominal, const GeometryPriors& p, Draw& draw) {
  TrueRig t{nominal, 1 + draw(p.turntable_scale)};
  acquire::RigGeometry& g = t.geometry;
  const glm::dvec3 sphere = draw.vector(p.sphere_m);
  g.cam_from_rig.translation += g.cam_from_rig.rotation * sphere;
  g.axis_direction = turned(turned(g.axis_direction, {1, 0, 0}, draw(p.axis_tilt_rad)), {0, 0, 1}, draw(p.axis_tilt_rad));
  g.axis_point += glm::dvec3(draw(p.axis_point_m), 0, draw(p.axis_point_m)) - sphere;
  const double zero = draw(p.zero_angle_rad);
  for (auto& light : g.lights) {
    const glm::dvec3 place = light.position * (1 + draw(p.arm)) + draw.vector(p.light_m) - sphere;
    light.position = g.axis_point + turned(place - g.axis_point, g.axis_direction, zero);
  }
  return t;
}

std::vector<EdgePoint> edges_of(const acquire::RigGeometry& g, double sigma, double from, double to, int n, Draw& draw, double offset = 0,
                                const glm::dvec2& side = glm::dvec2(0.0)) {
  std::vector<EdgePoint> edges;
  const glm::dvec2 centre = *g.camera.project(g.cam_from_rig.translation);
  for (int k = 0; k < n; ++k) {
    const double a = from + (to - from) * k / n;
    double low = 0, high = 1200;  // bisection along a line from the centre: independent of the closed form under test
    for (int i = 0; i < 60; ++i) {
      const double middle = 0.5 * (low + high);
      (acquire::trace(g, centre + middle * glm::dvec2(std::cos(a), std::sin(a))) ? low : high) = middle;
    }
    edges.push_back({centre + (low + offset + side.x * std::cos(a) + side.y * std::sin(a) + draw(sigma)) * glm::dvec2(std::cos(a), std::sin(a)), sigma});
  }
  return edges;
}

std::vector<Highlight> highlights_of(const TrueRig& t, double sigma, double from_deg, double to_deg, double step_deg, Draw& draw) {
  std::vector<Highlight> found;
  for (std::size_t light = 0; light < t.geometry.lights.size(); ++light)
    for (double a = from_deg; a <= to_deg; a += step_deg) {
      const auto pixel = mirror_pixel(t.geometry, t.geometry.place_light(light, t.scale * a * degree).position);
      if (!pixel) continue;
      found.push_back({"L" + std::to_string(found.size()), light, a * degree, *pixel + glm::dvec2(draw(sigma), draw(sigma)), sigma * sigma, 0, sigma * sigma});
    }
  return found;
}

/// Half vector against normal, and light direction: RMS over pixels of the sphere and views.
struct Errors {
  double half = 0, light = 0, distance = 0, centre_px = 0;
};
Errors errors(const GeometryEstimate& e, const TrueRig& t) {
  double half = 0, light = 0, distance = 0, n = 0, n_views = 0;
  const int step = e.geometry.camera.height / 30;
  for (double a = 0; a <= 120; a += 10) {
    const glm::dvec3 estimated = e.geometry.place_light(0, e.turntable_scale * a * degree).position;
    const glm::dvec3 truth = t.geometry.place_light(0, t.scale * a * degree).position;
    light += std::pow(glm::length(glm::normalize(estimated) - glm::normalize(truth)), 2);
    distance += std::pow(glm::length(estimated) / glm::length(truth) - 1, 2);
    ++n_views;
    for (int y = 0; y < e.geometry.camera.height; y += step)
      for (int x = 0; x < e.geometry.camera.width; x += step) {
        const auto p = acquire::trace(e.geometry, {x, y}), q = acquire::trace(t.geometry, {x, y});
        if (!p || !q || glm::dot(q->normal, q->wo) < 0.1) continue;
        const glm::dvec3 wi = glm::normalize(estimated - p->position), true_wi = glm::normalize(truth - q->position);
        if (glm::dot(true_wi, q->normal) < 0.1) continue;
        half += std::pow(glm::length(glm::normalize(wi + p->wo) - p->normal - glm::normalize(true_wi + q->wo) + q->normal), 2);
        ++n;
      }
  }
  const glm::dvec2 c = *e.geometry.camera.project(e.geometry.cam_from_rig.translation), d = *t.geometry.camera.project(t.geometry.cam_from_rig.translation);
  return {std::sqrt(half / n) / degree, std::sqrt(light / n_views) / degree, std::sqrt(distance / n_views), glm::length(c - d)};
}

TEST(GeometrySolver, TheMirrorPixelObeysTheLawOfReflection) {
  const auto g = test::quick_rig();
  for (double a = -150; a <= 150; a += 7) {
    const glm::dvec3 light = g.place_light(0, a * degree).position;
    const auto pixel = mirror_pixel(g, light);
    ASSERT_TRUE(pixel) << a;
    const auto point = acquire::trace(g, *pixel);
    ASSERT_TRUE(point) << a;
    const glm::dvec3 wi = glm::normalize(light - point->position);
    // Towards the silhouette the traced point moves as the root of the pixel's rounding error.
    EXPECT_LT(glm::length(glm::normalize(wi + point->wo) - point->normal), 1e-9) << a;
  }
  EXPECT_FALSE(mirror_pixel(g, {0, 0, 0.04})) << "a light inside the sphere";
  EXPECT_FALSE(mirror_pixel(g, {0, 0, -0.6})) << "a light behind the sphere";
}

TEST(GeometrySolver, TheSilhouetteDistanceIsThatOfTheTracedSphere) {
  auto g = test::quick_rig();
  g.cam_from_rig.translation += glm::dvec3(0.01, -0.02, 0.05);
  Draw draw(1);
  for (const EdgePoint& e : edges_of(g, 1e-12, 0, 360 * degree, 50, draw)) EXPECT_NEAR(*silhouette_distance(g, e.pixel), 0, 1e-6);
  const glm::dvec2 centre = *g.camera.project(g.cam_from_rig.translation);
  EXPECT_LT(*silhouette_distance(g, centre + glm::dvec2(100, 0)), -40);
  EXPECT_GT(*silhouette_distance(g, centre + glm::dvec2(160, 0)), 5);
}

TEST(GeometrySolver, WithoutNoiseABadlyBuiltRigIsFoundExactly) {
  const auto nominal = test::quick_rig();
  GeometryPriors priors;
  Draw draw(3);
  TrueRig t = built(nominal, priors, draw);
  auto e = solve_geometry(nominal, edges_of(t.geometry, 1e-5, 0, 360 * degree, 180, draw), highlights_of(t, 1e-5, 0, 150, 3, draw), priors);
  const Errors found = errors(e, t);
  EXPECT_TRUE(e.converged);
  EXPECT_LT(found.half, 1e-4);
  EXPECT_LT(found.light, 1e-4);
  EXPECT_LT(found.distance, 1e-4);
  EXPECT_LT(found.centre_px, 1e-4);
}

/// A rig of 1363 x 1022 pixels with a builder's errors. Highlights are found to 0.01 px or better (test_highlights.cpp).
TEST(GeometrySolver, OverManyRigsTheErrorBarsHoldTheTruth) {
  constexpr int n_rigs = 12;
  const GeometryPriors priors;
  int inside = 0, total = 0;
  double half = 0, light = 0, distance = 0, centre = 0, pull2 = 0;
  for (unsigned seed = 0; seed < n_rigs; ++seed) {
    Draw draw(seed + 100);
    const auto nominal = test::quick_rig(2, 2.84);
    const TrueRig t = built(nominal, priors, draw);
    // Edges all off by the same, and more to one side, as priors say they may be, and on the lit part only.
    const double offset = draw(priors.edge_offset_px), side_x = draw(priors.edge_side_px), side_y = draw(priors.edge_side_px);
    const auto edges = edges_of(t.geometry, 0.05, -60 * degree, 120 * degree, 90, draw, offset, {side_x, side_y});
    const auto e = solve_geometry(nominal, edges, highlights_of(t, 0.01, 0, 150, 2.5, draw), priors);
    ASSERT_TRUE(e.converged) << seed;
    EXPECT_TRUE(e.outliers.empty()) << seed;
    const Errors found = errors(e, t);
    half += found.half * found.half / n_rigs;
    light += found.light * found.light / n_rigs;
    distance += found.distance * found.distance / n_rigs;
    centre += found.centre_px * found.centre_px / n_rigs;
    // Pulls in numbers that do not depend on how the unknowns were chosen: sphere's centre, and the axis' direction.
    const glm::dvec3 sphere = glm::transpose(nominal.cam_from_rig.rotation) * (t.geometry.cam_from_rig.translation - nominal.cam_from_rig.translation);
    const double truth[] = {sphere.x, sphere.y, sphere.z, t.geometry.axis_direction.z, -t.geometry.axis_direction.x, t.scale - 1};
    const double estimate[] = {e.uncertainty.parameters[0].correction, e.uncertainty.parameters[1].correction, e.uncertainty.parameters[2].correction,
                               e.geometry.axis_direction.z, -e.geometry.axis_direction.x, e.turntable_scale - 1};
    const std::size_t index[] = {0, 1, 2, 6, 7, 11};
    for (std::size_t k = 0; k < 6; ++k) {
      const double sigma = e.uncertainty.parameters[index[k]].sigma;
      ASSERT_GT(sigma, 0);
      EXPECT_LT(sigma, 0.9 * e.uncertainty.parameters[index[k]].prior_sigma) << e.uncertainty.parameters[index[k]].name << ": learnt nothing";
      const double pull = (estimate[k] - truth[k]) / sigma;
      pull2 += pull * pull;
      inside += std::abs(pull) < 1.96;
      ++total;
    }
  }
  std::cout << "rms over " << n_rigs << " rigs: half vector " << std::sqrt(half) << " deg, light " << std::sqrt(light) << " deg, distance "
            << 100 * std::sqrt(distance) << " %, centre " << std::sqrt(centre) << " px; inside 95 % bounds " << 100.0 * inside / total
            << " %, pull rms " << std::sqrt(pull2 / total) << "\n";
  EXPECT_LT(std::sqrt(half), 0.01);
  EXPECT_LT(std::sqrt(light), 0.02);
  EXPECT_LT(std::sqrt(distance), 0.003);
  EXPECT_LT(std::sqrt(centre), 0.1);
  // 72 pulls, those of one rig correlated: 95 % +- 2 to 3 %, and their RMS 1 +- 0.1.
  EXPECT_GT(inside, 0.89 * total);
  EXPECT_GT(pull2 / total, 0.6);
  EXPECT_LT(pull2 / total, 1.5);
}

TEST(GeometrySolver, AFalseHighlightIsLeftOutAndNamed) {
  const auto nominal = test::quick_rig();
  Draw draw(5);
  const TrueRig t = built(nominal, {}, draw);
  auto highlights = highlights_of(t, 0.02, 0, 120, 5, draw);
  highlights[7].pixel += glm::dvec2(3, -2);
  auto edges = edges_of(t.geometry, 0.05, 0, 180 * degree, 90, draw);
  for (std::size_t k = 0; k < 6; ++k) edges[10 + k].pixel += glm::dvec2(8, 0);  // the arm before the limb
  const auto e = solve_geometry(nominal, edges, highlights);
  ASSERT_EQ(e.outliers.size(), 1u);
  EXPECT_EQ(e.outliers[0].view, highlights[7].view);
  EXPECT_NEAR(e.outliers[0].residual.x, 3, 0.2);
  EXPECT_NEAR(e.outliers[0].residual.y, -2, 0.2);
  EXPECT_EQ(e.n_edge_outliers, 6u);
  EXPECT_LT(errors(e, t).half, 3 * e.half_vector_sigma_rad / degree);
}

TEST(GeometrySolver, LargerNoiseThanStatedWidensTheErrorBars) {
  const auto nominal = test::quick_rig();
  Draw a(6), b(6);
  const TrueRig t = built(nominal, {}, a), same = built(nominal, {}, b);
  auto highlights = highlights_of(t, 0.1, 0, 120, 2, a);
  for (Highlight& h : highlights) h.xx = h.yy = 0.02 * 0.02;  // five times too good
  const auto edges = edges_of(t.geometry, 0.05, 0, 360 * degree, 90, a);
  const auto e = solve_geometry(nominal, edges, highlights);
  EXPECT_NEAR(e.highlight_noise_factor, 5, 0.7);
  EXPECT_NEAR(e.highlight_rms_px, 0.1, 0.015);
}

bool mentions(const GeometryEstimate& e, const std::string& text) {
  for (const auto& w : e.warnings)
    if (w.find(text) != std::string::npos) return true;
  return false;
}

TEST(GeometrySolver, ATurntableThatMissesItsAnglesIsToldFromNoise) {
  const auto nominal = test::quick_rig();
  Draw draw(8);
  const TrueRig t = built(nominal, {}, draw);
  auto highlights = highlights_of(t, 0.004, 0, 130, 1, draw);
  for (Highlight& h : highlights) h.turntable_angle += draw(0.02 * degree);
  const auto e = solve_geometry(nominal, edges_of(t.geometry, 0.05, 0, 360 * degree, 90, draw), highlights);
  EXPECT_NEAR(e.angle_sigma_rad / degree, 0.02, 0.004);
  EXPECT_NEAR(e.highlight_noise_factor, 1, 0.25);
  EXPECT_TRUE(e.outliers.empty());
}

TEST(GeometrySolver, WhatTheImagesDoNotDetermineIsSaid) {
  const auto nominal = test::quick_rig(1, 2.84);
  Draw draw(7);
  const TrueRig t = built(nominal, {}, draw);
  const auto edges = edges_of(t.geometry, 0.05, 0, 360 * degree, 90, draw);
  const auto good = solve_geometry(nominal, edges, highlights_of(t, 0.003, 0, 120, 3, draw));
  for (const auto& w : good.warnings) ADD_FAILURE() << w;

  const auto few = solve_geometry(nominal, edges, highlights_of(t, 0.03, 40, 50, 5, draw));
  EXPECT_TRUE(mentions(few, "too few")) << few.warnings.size();
  EXPECT_TRUE(mentions(few, "the images do not determine"));
  EXPECT_GT(few.distance_sigma, 2.5 * good.distance_sigma) << "all that is left is the ruler's 2 %";

  const auto none = solve_geometry(nominal, edges, {});
  EXPECT_TRUE(mentions(none, "no highlight"));
  EXPECT_LT(none.centre_sigma_px, 0.1);

  const auto blind = solve_geometry(nominal, {}, highlights_of(t, 0.03, 0, 120, 3, draw));
  EXPECT_TRUE(mentions(blind, "no silhouette"));
  EXPECT_GT(blind.centre_sigma_px, good.centre_sigma_px);
}

TEST(GeometrySolver, ARadiusWrongByAPercentShowsAsASphereAtAnotherDistanceAndIsSaid) {
  auto nominal = test::quick_rig(1, 2.84);
  Draw draw(9);
  const TrueRig t{nominal, 1};
  nominal.sphere_radius *= 1.01;
  const auto e = solve_geometry(nominal, edges_of(t.geometry, 0.05, 0, 360 * degree, 90, draw), highlights_of(t, 0.005, 0, 130, 3, draw));
  EXPECT_TRUE(mentions(e, "its radius is really 1.0 % smaller"));
  // Nothing else is amiss: the scene as a whole is 1 % larger, which no image shows.
  EXPECT_TRUE(e.outliers.empty());
  EXPECT_LT(e.highlight_rms_px, 0.007);
  EXPECT_NEAR(e.geometry.cam_from_rig.translation.z, 1.01, 0.002);
}

TEST(GeometrySolver, ALightWhoseHighlightIsNeverSeenKeepsItsPlaceAndIsSaid) {
  const auto nominal = test::quick_rig(2, 2.84);
  Draw draw(10);
  const TrueRig t = built(nominal, {}, draw);
  auto highlights = highlights_of(t, 0.005, 0, 130, 3, draw);
  std::erase_if(highlights, [](const Highlight& h) { return h.light == 1; });
  const auto e = solve_geometry(nominal, edges_of(t.geometry, 0.05, 0, 360 * degree, 90, draw), highlights);
  EXPECT_TRUE(mentions(e, "light 2: no highlight"));
  for (const auto& p : e.uncertainty.parameters) EXPECT_EQ(p.name.find("light 2"), std::string::npos) << "not an unknown";
}

/// Camera, light and the plane of its circle in one plane: all highlights on one line of the image.
TEST(GeometrySolver, HighlightsOnOneLineLeaveErrorBarsThatHoldTheTruth) {
  auto nominal = test::quick_rig(1, 2.84);
  nominal.lights[0].position = {0, 0, 0.6};
  Draw draw(11);
  const TrueRig t = built(nominal, {}, draw);
  const auto edges = edges_of(t.geometry, 0.05, 0, 360 * degree, 90, draw);
  const auto e = solve_geometry(nominal, edges, highlights_of(t, 0.005, 0, 130, 3, draw));
  const Errors found = errors(e, t);
  EXPECT_LT(found.half, 3 * e.half_vector_sigma_rad / degree);
  EXPECT_LT(found.light, 3 * e.light_sigma_rad / degree);
  EXPECT_LT(found.distance, 3 * e.distance_sigma);
}

TEST(GeometrySolver, EdgesThatAreWrongTogetherWidenTheErrorBars) {
  const auto nominal = test::quick_rig(1, 2.84);
  Draw draw(12);
  const TrueRig t = built(nominal, {}, draw);
  auto edges = edges_of(t.geometry, 0.02, 0, 360 * degree, 120, draw);
  const auto alone = solve_geometry(nominal, edges, {});
  const glm::dvec2 centre = *t.geometry.camera.project(t.geometry.cam_from_rig.translation);
  for (std::size_t k = 0; k < edges.size(); ++k)  // 0.06 px, in and out six times around the limb
    edges[k].pixel += glm::normalize(edges[k].pixel - centre) * 0.06 * std::sin(6 * 2 * 3.14159265358979323846 * static_cast<double>(k) / 120);
  const auto together = solve_geometry(nominal, edges, {});
  EXPECT_NEAR(alone.edge_noise_factor, 1, 0.3);
  EXPECT_GT(together.edge_noise_factor, 3.5) << "0.047 px RMS over 0.02 is 2.4; neighbours agree";
}

TEST(GeometrySolver, TheAngleOfAViewIsKnownFromItsHighlight) {
  const auto nominal = test::quick_rig(1, 2.84);
  Draw draw(13);
  const TrueRig t = built(nominal, {}, draw);
  auto highlights = highlights_of(t, 0.005, 0, 130, 2, draw);
  std::vector<double> off;
  for (Highlight& h : highlights) {
    off.push_back(draw(0.02 * degree));
    h.turntable_angle -= off.back();
  }
  const auto e = solve_geometry(nominal, edges_of(t.geometry, 0.05, 0, 360 * degree, 90, draw), highlights);
  ASSERT_EQ(e.uncertainty.angles.size(), highlights.size());
  double before = 0, after = 0;
  for (std::size_t i = 0; i < highlights.size(); ++i) {
    before += off[i] * off[i];
    after += std::pow(e.uncertainty.angle_correction(highlights[i].view) - off[i], 2);
  }
  // A common error and one that grows with the angle are the zero angle's and the steps' scale's.
  EXPECT_LT(after, 0.25 * before);
}

/// A lens that is wrong within its covariance: its errors are in those of half vectors and centre, which hold the truth with it and not without.
TEST(GeometrySolver, ALensWrongWithinItsCovarianceIsInTheErrorBars) {
  constexpr int n_rigs = 8, n = 6;
  // fx fy cx cy k1 k2: fx and fy together, k1 against k2, as calibrations have them.
  const double sigma[n] = {6, 6, 4, 4, 0.02, 0.3};
  double factor[n][n]{};
  for (int k = 0; k < n; ++k) factor[k][k] = sigma[k];
  factor[1][0] = 0.99 * sigma[1], factor[1][1] = std::sqrt(1 - 0.99 * 0.99) * sigma[1];
  factor[5][4] = -0.95 * sigma[5], factor[5][5] = std::sqrt(1 - 0.95 * 0.95) * sigma[5];
  GeometryPriors informed;
  informed.lens_covariance.resize(8 * 8);  // p1 and p2 were held
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j)
      for (int k = 0; k < n; ++k) informed.lens_covariance[static_cast<std::size_t>(i * 8 + j)] += factor[i][k] * factor[j][k];
  double half2 = 0, stated2 = 0, believed2 = 0, pulls2 = 0, believed_pulls2 = 0;
  for (unsigned seed = 0; seed < n_rigs; ++seed) {
    Draw draw(seed + 500);
    const auto nominal = test::quick_rig(2);
    TrueRig t = built(nominal, informed, draw);
    double u[n];
    for (double& v : u) v = draw(1);
    double off[n]{};
    for (int i = 0; i < n; ++i)
      for (int k = 0; k < n; ++k) off[i] += factor[i][k] * u[k];
    t.geometry.camera.focal += glm::dvec2(off[0], off[1]);
    t.geometry.camera.centre += glm::dvec2(off[2], off[3]);
    t.geometry.camera.distortion[0] += off[4];
    t.geometry.camera.distortion[1] += off[5];
    const auto edges = edges_of(t.geometry, 0.02, 0, 360 * degree, 40, draw);
    const auto highlights = highlights_of(t, 0.005, 0, 130, 8, draw);
    const auto e = solve_geometry(nominal, edges, highlights, informed), believed = solve_geometry(nominal, edges, highlights);
    ASSERT_TRUE(e.converged) << seed;
    ASSERT_EQ(e.uncertainty.parameters.size(), believed.uncertainty.parameters.size() + n);
    half2 += std::pow(errors(e, t).half, 2) / n_rigs;
    stated2 += std::pow(e.half_vector_sigma_rad / degree, 2) / n_rigs;
    believed2 += std::pow(believed.half_vector_sigma_rad / degree, 2) / n_rigs;
    const glm::dvec3 sphere = glm::transpose(nominal.cam_from_rig.rotation) * (t.geometry.cam_from_rig.translation - nominal.cam_from_rig.translation);
    for (std::size_t k = 0; k < 2; ++k) {
      pulls2 += std::pow((e.uncertainty.parameters[k].correction - sphere[static_cast<int>(k)]) / e.uncertainty.parameters[k].sigma, 2) / (2 * n_rigs);
      believed_pulls2 += std::pow((believed.uncertainty.parameters[k].correction - sphere[static_cast<int>(k)]) / believed.uncertainty.parameters[k].sigma, 2) / (2 * n_rigs);
    }
  }
  std::cout << "half vectors " << std::sqrt(half2) << " deg, stated " << std::sqrt(stated2) << ", with a lens that is believed " << std::sqrt(believed2)
            << "; sphere's pulls " << std::sqrt(pulls2) << " and " << std::sqrt(believed_pulls2) << "\n";
  EXPECT_GT(std::sqrt(stated2 / half2), 0.6);
  EXPECT_LT(std::sqrt(stated2 / half2), 1.6);
  EXPECT_GT(pulls2, 0.4);  // 16 numbers: 1 +- 0.35
  EXPECT_LT(pulls2, 2.0);
  EXPECT_GT(believed_pulls2, 9) << "the case does not show anything";
}

}  // namespace
}  // namespace lacquer::calib
