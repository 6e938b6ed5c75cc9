#include "libbrdf/directions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>
#include <random>
#include <vector>

namespace lacquer::brdf {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double degree = pi / 180;

/// Uniform pairs of directions above the horizon.
std::vector<Directions> random_pairs(int n) {
  std::mt19937_64 generator(20050601);
  std::uniform_real_distribution<double> uniform(0, 1);
  const auto one = [&] { return direction(std::acos(uniform(generator)), 2 * pi * uniform(generator)); };
  std::vector<Directions> pairs;
  for (int i = 0; i < n; ++i) {
    const glm::dvec3 wi = one();
    pairs.push_back({wi, one()});
  }
  return pairs;
}

struct LongHalfDiff {
  long double theta_h, theta_d, phi_d;
};

/// Rusinkiewicz 1998 word by word: diff = rot(binormal, -theta_h) rot(normal, -phi_h) wi.
LongHalfDiff by_rotations(const Directions& d) {
  const auto rotate = [](long double& x, long double& y, long double angle) {
    const long double c = std::cos(angle), s = std::sin(angle), old_x = x;
    x = c * old_x - s * y;
    y = s * old_x + c * y;
  };
  long double hx = static_cast<long double>(d.wi.x) + d.wo.x, hy = static_cast<long double>(d.wi.y) + d.wo.y;
  const long double hz = static_cast<long double>(d.wi.z) + d.wo.z;
  const long double theta_h = std::atan2(std::hypot(hx, hy), hz), phi_h = std::atan2(hy, hx);
  long double x = d.wi.x, y = d.wi.y, z = d.wi.z;
  rotate(x, y, -phi_h);
  rotate(z, x, -theta_h);  // right-handed about y: z towards x
  return {theta_h, std::atan2(std::hypot(x, y), z), std::atan2(y, x)};
}

/// Smallest distance of two angles on the circle.
double angle_distance(double a, double b) { return std::abs(std::remainder(a - b, 2 * pi)); }

TEST(Directions, HalfDiffAgreesWithTheRotationsOfRusinkiewicz) {
  for (const auto& d : random_pairs(20000)) {
    const HalfDiff c = half_diff(d);
    const LongHalfDiff expected = by_rotations(d);
    // A few roundings of numbers of order 1; azimuths lose what theta_h and theta_d have left in the
    // denominator.
    EXPECT_NEAR(c.theta_h, static_cast<double>(expected.theta_h), 1e-15);
    // Inputs are unit vectors only to 1e-16, which two definitions of theta_d weigh differently as wi + wo
    // gets short.
    EXPECT_NEAR(c.theta_d, static_cast<double>(expected.theta_d), 1e-15 / std::cos(c.theta_d));
    const double conditioning = 1 / std::sin(c.theta_d) + 1 / std::sin(c.theta_h);
    EXPECT_LT(angle_distance(c.phi_d, static_cast<double>(expected.phi_d)), 1e-15 * conditioning);
  }
}

TEST(Directions, CoordinatesSurviveTheRoundTripOverVectors) {
  std::mt19937_64 generator(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int i = 0; i < 20000; ++i) {
    const HalfDiff c{uniform(generator) * pi / 2, uniform(generator) * pi / 2,
                     (2 * uniform(generator) - 1) * pi};
    const HalfDiff back = half_diff(directions(c));
    EXPECT_NEAR(back.theta_h, c.theta_h, 1e-15 / std::cos(c.theta_d));  // |wi + wo| = 2 cos(theta_d)
    EXPECT_NEAR(back.theta_d, c.theta_d, 1e-15);
    EXPECT_LT(angle_distance(back.phi_d, c.phi_d),
              1e-15 * (1 / std::sin(c.theta_d) + 1 / (std::sin(c.theta_h) * std::cos(c.theta_d))));
  }
}

TEST(Directions, VectorsSurviveTheRoundTripUpToARotationAboutTheNormal) {
  for (const auto& d : random_pairs(20000)) {
    const Directions back = directions(half_diff(d));
    EXPECT_NEAR(back.wi.z, d.wi.z, 1e-15);
    EXPECT_NEAR(back.wo.z, d.wo.z, 1e-15);
    EXPECT_NEAR(glm::dot(back.wi, back.wo), glm::dot(d.wi, d.wo), 2e-15);
    // Same handedness: the triple product with the normal keeps its sign and size.
    EXPECT_NEAR(glm::cross(back.wi, back.wo).z, glm::cross(d.wi, d.wo).z, 2e-15);
    EXPECT_NEAR(glm::length(back.wi), 1, 5e-16);
    EXPECT_NEAR(glm::length(back.wo), 1, 5e-16);
  }
}

TEST(Directions, MirrorPairsHaveTheirHalfVectorExactlyAtTheNormal) {
  const double s = 0.6, c = 0.8;
  const HalfDiff towards_x = half_diff({{s, 0, c}, {-s, 0, c}});
  EXPECT_EQ(towards_x.theta_h, 0.0);
  EXPECT_NEAR(towards_x.theta_d, std::asin(0.6), 2e-16);
  EXPECT_EQ(towards_x.phi_d, 0.0);
  EXPECT_EQ(half_diff({{-s, 0, c}, {s, 0, c}}).phi_d, pi);
  EXPECT_NEAR(half_diff({{0, s, c}, {0, -s, c}}).phi_d, pi / 2, 1e-16);
}

TEST(Directions, ThetaHOfATrillionthRadianIsResolved) {
  const HalfDiff c{1e-12, 0.5, 1.0};
  const HalfDiff back = half_diff(directions(c));
  EXPECT_NEAR(back.theta_h, 1e-12,
              3e-16);  // coordinates of order 1 are quantised to 1e-16; acos would give 0 or 1.5e-8
  EXPECT_NEAR(back.theta_d, 0.5, 1e-15);
  EXPECT_NEAR(back.phi_d, 1.0, 1e-3);  // 3e-16 / 1e-12
}

TEST(Directions, EqualDirectionsHaveThetaDZeroAndAzimuthZero) {
  for (const double theta : {0.0, 1e-9, 0.3, 1.2, 89.999999 * degree}) {
    const glm::dvec3 w = direction(theta, 2.1);
    const HalfDiff c = half_diff({w, w});
    EXPECT_NEAR(c.theta_h, theta, 3e-16);
    EXPECT_EQ(c.theta_d, 0.0);
    EXPECT_EQ(c.phi_d, 0.0);
    EXPECT_LE(half_angle_cosines(Directions{w, w}).i_dot_h,
              1.0);  // Schlick's weight must not become negative
  }
}

TEST(Directions, NearlyEqualDirectionsKeepTheirTinyThetaD) {
  const double theta_d = 1e-9;
  const HalfDiff c = half_diff({direction(0.7 + theta_d, 0.4), direction(0.7 - theta_d, 0.4)});
  EXPECT_NEAR(c.theta_d, theta_d, 3e-16);
  EXPECT_NEAR(c.theta_h, 0.7, 3e-16);
  EXPECT_NEAR(c.phi_d, 0.0, 1e-6);  // 3e-16 / 1e-9; wi leans away from the normal
}

TEST(Directions, GrazingMirrorPairIsExact) {
  const double theta = 89.999999 * degree;
  const Directions d{direction(theta, 0), direction(theta, pi)};
  const HalfDiff c = half_diff(d);
  EXPECT_NEAR(c.theta_d, theta, 3e-16);
  // sum.z = 2 cos(theta) = 3.5e-8 against the rounding 1.2e-16 of sin(pi) in wo.
  EXPECT_NEAR(c.theta_h, 0.0, 1e-8);
  const auto cosines = half_angle_cosines(d);
  EXPECT_NEAR(cosines.n_dot_i / std::cos(theta), 1, 1e-12);
  EXPECT_NEAR(cosines.i_dot_h / std::cos(theta), 1, 1e-8);
}

TEST(Directions, OppositeDirectionsFollowTheConvention) {
  const glm::dvec3 w = direction(1.1, 0.3);
  const HalfDiff c = half_diff({w, -w});
  EXPECT_EQ(c.theta_h, 0.0);
  EXPECT_EQ(c.theta_d, pi / 2);
  EXPECT_EQ(c.phi_d, 0.0);
  const auto cosines = half_angle_cosines(Directions{w, -w});
  EXPECT_EQ(cosines.i_dot_h, 0.0);
  EXPECT_EQ(cosines.n_dot_h, 1.0);
}

TEST(Directions, PhiDNeverIsMinusPi) {
  // In the plane of incidence, azimuths 0 and pi, all signs of zero: atan2(-0, -1) would be -pi.
  for (const double zero_i : {0.0, -0.0}) {
    for (const double zero_o : {0.0, -0.0}) {
      for (const double theta_i : {-1.2, -0.5, 0.2, 0.9}) {
        for (const double theta_o : {-1.0, -0.1, 0.4, 1.3}) {
          const HalfDiff c = half_diff({{std::sin(theta_i), zero_i, std::cos(theta_i)},
                                        {std::sin(theta_o), zero_o, std::cos(theta_o)}});
          EXPECT_GT(c.phi_d, -pi);
          EXPECT_LE(c.phi_d, pi);
          // wi farther from the normal than wo: 0, nearer: pi.
          const bool outside = (theta_i - theta_o) * (theta_i + theta_o) > 0;
          EXPECT_NEAR(c.phi_d, outside ? 0.0 : pi, 1e-15);
        }
      }
    }
  }
}

TEST(Directions, SwappingLightAndCameraTurnsPhiDByHalfATurn) {
  for (const auto& d : random_pairs(2000)) {
    const HalfDiff c = half_diff(d), swapped = half_diff({d.wo, d.wi});
    EXPECT_EQ(swapped.theta_h, c.theta_h);
    EXPECT_EQ(swapped.theta_d, c.theta_d);
    EXPECT_LT(angle_distance(swapped.phi_d, c.phi_d + pi), 1e-15);
  }
}

TEST(Directions, MirroringNegatesPhiDWhichFoldsToPiMinusPhiD) {
  for (const auto& d : random_pairs(2000)) {
    const HalfDiff c = half_diff(d);
    const HalfDiff mirrored = half_diff({{d.wi.x, -d.wi.y, d.wi.z}, {d.wo.x, -d.wo.y, d.wo.z}});
    EXPECT_EQ(mirrored.theta_h, c.theta_h);
    EXPECT_LT(angle_distance(mirrored.phi_d, -c.phi_d), 1e-15);
    EXPECT_NEAR(fold_phi_d(mirrored.phi_d), pi - fold_phi_d(c.phi_d), 1e-15);
  }
}

TEST(Directions, FoldStaysBelowPi) {
  EXPECT_EQ(fold_phi_d(0.0), 0.0);
  EXPECT_EQ(fold_phi_d(pi), 0.0);
  EXPECT_EQ(fold_phi_d(-pi), 0.0);
  EXPECT_EQ(fold_phi_d(-1e-20), 0.0);  // -1e-20 + pi rounds to pi
  EXPECT_NEAR(fold_phi_d(-0.25), pi - 0.25, 1e-15);
  EXPECT_NEAR(fold_phi_d(7.0), 7.0 - 2 * pi, 1e-15);
  EXPECT_LT(fold_phi_d(std::nextafter(pi, 0.0)), pi);
}

TEST(Directions, CosinesFromVectorsAndFromCoordinatesAgree) {
  for (const auto& d : random_pairs(20000)) {
    const auto a = half_angle_cosines(d), b = half_angle_cosines(half_diff(d));
    EXPECT_NEAR(a.n_dot_i, b.n_dot_i, 1e-15);
    EXPECT_NEAR(a.n_dot_o, b.n_dot_o, 1e-15);
    EXPECT_NEAR(a.n_dot_h, b.n_dot_h, 1e-15 / a.i_dot_h);
    EXPECT_NEAR(a.i_dot_h, b.i_dot_h, 1e-15);
    // d(tan^2)/tan^2 = 2 d(theta) / (sin cos)
    const double relative = 4e-15 / (std::sqrt(a.tan2_theta_h) * a.n_dot_h * a.n_dot_h * a.i_dot_h);
    EXPECT_NEAR(a.tan2_theta_h / b.tan2_theta_h, 1, relative);
  }
}

TEST(Directions, CosinesAtTheClearCoatPeakKeepTheirDigits) {
  // theta_h = 1e-9: 1 - cos^2 is 0 in double, tan^2 is 1e-18.
  const HalfDiff c{1e-9, 0.4, 0.8};
  EXPECT_NEAR(half_angle_cosines(c).tan2_theta_h / 1e-18, 1, 1e-14);
  EXPECT_NEAR(half_angle_cosines(directions(c)).tan2_theta_h / 1e-18, 1, 1e-6);  // 2 * 3e-16 / 1e-9
}

TEST(Directions, PhiDZeroMeansTheLightLeansAwayFromTheNormal) {
  const Directions d = directions({30 * degree, 20 * degree, 0});
  EXPECT_NEAR(d.wi.z, std::cos(50 * degree), 1e-15);
  EXPECT_NEAR(d.wo.z, std::cos(10 * degree), 1e-15);
  EXPECT_NEAR(d.wi.x, std::sin(50 * degree), 1e-15);
}

TEST(Directions, SphericalCoordinatesByHand) {
  const glm::dvec3 w = direction(60 * degree, 90 * degree);
  EXPECT_NEAR(w.x, 0, 1e-16);
  EXPECT_NEAR(w.y, std::sqrt(3.0) / 2, 1e-15);
  EXPECT_NEAR(w.z, 0.5, 1e-15);
}

}  // namespace
}  // namespace lacquer::brdf
