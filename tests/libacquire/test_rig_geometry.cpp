#include "libacquire/rig_geometry.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <random>

#include "libbrdf/error.h"

namespace lacquer::acquire {
namespace {

constexpr double pi = std::numbers::pi;

CameraModel wide_camera() {
  CameraModel c;
  c.width = 1360;
  c.height = 1024;
  c.focal = {1650.0, 1647.0};
  c.centre = {671.3, 519.8};
  c.distortion = {0.21, -0.34, 8e-4, -5e-4, 0.11, 0.35, -0.25, 0.04};
  return c;
}

RigGeometry simple_rig(double distance) {
  RigGeometry rig;
  rig.camera.width = 640;
  rig.camera.height = 480;
  rig.camera.focal = {3000, 3000};
  rig.camera.centre = {319.5, 239.5};
  rig.cam_from_rig = look_at({0, 0, distance}, {0, 0, 0}, {0, 1, 0});
  rig.sphere_radius = 0.05;
  return rig;
}

cv::Mat camera_matrix(const CameraModel& c) {
  return (cv::Mat_<double>(3, 3) << c.focal.x, 0, c.centre.x, 0, c.focal.y, c.centre.y, 0, 0, 1);
}

glm::dvec3 random_direction(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  return glm::normalize(glm::dvec3(normal(random), normal(random), normal(random)));
}

// ---- camera: OpenCV is the oracle

TEST(CameraModel, ProjectsAsOpenCvDoes) {
  const CameraModel camera = wide_camera();
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> xy(-0.4, 0.4), z(0.5, 2);
  std::vector<cv::Point3d> points;
  for (int i = 0; i < 200; ++i) {
    const double depth = z(random);
    points.emplace_back(xy(random) * depth, xy(random) * depth, depth);
  }
  std::vector<cv::Point2d> expected;
  cv::projectPoints(points, cv::Vec3d(0, 0, 0), cv::Vec3d(0, 0, 0), camera_matrix(camera),
                    std::vector<double>(camera.distortion.begin(), camera.distortion.end()), expected);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto pixel = camera.project({points[i].x, points[i].y, points[i].z});
    ASSERT_TRUE(pixel);
    EXPECT_NEAR(pixel->x, expected[i].x, 1e-9);  // a few ulp of 1000 pixels
    EXPECT_NEAR(pixel->y, expected[i].y, 1e-9);
  }
}

TEST(CameraModel, UnprojectsAsOpenCvDoes) {
  const CameraModel camera = wide_camera();
  std::vector<cv::Point2d> pixels, expected;
  for (int y = 0; y < camera.height; y += 111)
    for (int x = 0; x < camera.width; x += 97) pixels.emplace_back(x + 0.25, y - 0.125);
  cv::undistortPoints(pixels, expected, camera_matrix(camera), std::vector<double>(camera.distortion.begin(), camera.distortion.end()),
                      cv::noArray(), cv::noArray(), cv::TermCriteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 200, 1e-14));
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const auto ray = camera.unproject({pixels[i].x, pixels[i].y});
    ASSERT_TRUE(ray);
    EXPECT_NEAR(glm::length(ray->direction), 1, 1e-15);
    EXPECT_NEAR(ray->direction.x / ray->direction.z, expected[i].x, 1e-10);  // OpenCV's fixed-point iteration ends there
    EXPECT_NEAR(ray->direction.y / ray->direction.z, expected[i].y, 1e-10);
  }
}

TEST(CameraModel, UnprojectInvertsProjectToRounding) {
  const CameraModel camera = wide_camera();
  for (int y = 0; y < camera.height; y += 61)
    for (int x = 0; x < camera.width; x += 53) {
      const auto ray = camera.unproject({x, y});
      ASSERT_TRUE(ray) << x << " " << y;
      const auto back = camera.project(1.7 * ray->direction);
      ASSERT_TRUE(back);
      EXPECT_LT(glm::length(*back - glm::dvec2(x, y)), 1e-10 * camera.width);  // 1e-13 of the normalised coordinates times focal
    }
}

TEST(CameraModel, SeesNothingBehindItself) {
  EXPECT_FALSE(wide_camera().project({0.1, 0.1, -1}));
  EXPECT_FALSE(wide_camera().project({0.1, 0.1, 0}));
}

TEST(CameraModel, DoesNotUnprojectBeyondTheFoldOfTheDistortion) {
  CameraModel camera = wide_camera();
  camera.distortion = {-0.5, 0, 0, 0, 0, 0, 0, 0};
  // r (1 - r^2/2) is largest at r = sqrt(2/3) with 0.5443: no line of sight leads further out.
  EXPECT_TRUE(camera.unproject(camera.centre + camera.focal * glm::dvec2(0.543, 0)));
  EXPECT_FALSE(camera.unproject(camera.centre + camera.focal * glm::dvec2(0.546, 0)));
  EXPECT_FALSE(camera.unproject(camera.centre + camera.focal * glm::dvec2(3.0, 0)));
}

TEST(CameraModel, OrthographicRaysAreParallelAndScaleWithPixelsPerMetre) {
  CameraModel camera = wide_camera();
  camera.projection = CameraModel::Projection::orthographic;
  camera.focal = {2000, 2000};
  const auto ray = camera.unproject(camera.centre + glm::dvec2(100, -50));
  ASSERT_TRUE(ray);
  EXPECT_EQ(ray->direction, glm::dvec3(0, 0, 1));
  EXPECT_NEAR(ray->origin.x, 0.05, 1e-15);
  EXPECT_NEAR(ray->origin.y, -0.025, 1e-15);
  EXPECT_LT(glm::length(*camera.project({0.05, -0.025, -7}) - (camera.centre + glm::dvec2(100, -50))), 1e-12);
}

// ---- poses

TEST(LookAt, PutsTheTargetOnTheAxisAndUpTowardsSmallerY) {
  const RigidTransform pose = look_at({0.3, 0.4, 1.2}, {0.1, 0, 0}, {0, 1, 0});
  const glm::dvec3 target = pose * glm::dvec3(0.1, 0, 0);
  EXPECT_NEAR(target.x, 0, 1e-15);
  EXPECT_NEAR(target.y, 0, 1e-15);
  EXPECT_NEAR(target.z, std::sqrt(0.04 + 0.16 + 1.44), 1e-15);
  EXPECT_LT((pose * glm::dvec3(0.1, 0.1, 0)).y, 0);
  EXPECT_NEAR(glm::determinant(pose.rotation), 1, 1e-14);  // a rotation, not a reflection
}

TEST(LookAt, FromTheRigsFrontHasRigXToTheRight) {
  const RigidTransform pose = look_at({0, 0, 2}, {0, 0, 0}, {0, 1, 0});
  EXPECT_LT(glm::length(pose * glm::dvec3(0.1, 0.2, 0.3) - glm::dvec3(0.1, -0.2, 1.7)), 1e-15);
}

TEST(LookAt, RefusesAnUpAlongTheLineOfSight) { EXPECT_THROW(look_at({0, 1, 0}, {0, 0, 0}, {0, 1, 0}), Error); }

TEST(RigidTransform, InverseUndoesIt) {
  const RigidTransform pose = look_at({0.3, 0.4, 1.2}, {0.1, 0, 0}, {0.2, 1, 0});
  const glm::dvec3 p(0.7, -0.2, 0.4);
  EXPECT_LT(glm::length(pose.inverse() * (pose * p) - p), 1e-15);
}

// ---- sphere

TEST(Trace, HitsTheNearestPointOfTheSphere) {
  const RigGeometry rig = simple_rig(1.0);
  const auto point = trace(rig, rig.camera.centre);
  ASSERT_TRUE(point);
  EXPECT_LT(glm::length(point->position - glm::dvec3(0, 0, 0.05)), 1e-16);
  EXPECT_LT(glm::length(point->normal - glm::dvec3(0, 0, 1)), 1e-15);
  EXPECT_LT(glm::length(point->wo - glm::dvec3(0, 0, 1)), 1e-15);
}

TEST(Trace, PointsLieOnTheSphereAndProjectBackFromAnyDistance) {
  for (const double distance : {0.1, 1.0, 100.0, 1e6}) {
    RigGeometry rig = simple_rig(distance);
    rig.camera.focal = glm::dvec2(150 * distance / rig.sphere_radius);  // sphere of about 150 pixels radius at every distance
    for (double offset = 0; offset < 145; offset += 13) {
      const glm::dvec2 pixel = rig.camera.centre + glm::dvec2(offset, 0.3);
      const auto point = trace(rig, pixel);
      ASSERT_TRUE(point) << distance << " " << offset;
      EXPECT_NEAR(glm::length(point->position) / rig.sphere_radius, 1, 1e-9 * std::max(1.0, distance / 1e5)) << distance;
      EXPECT_LT(glm::length(*rig.camera.project(rig.cam_from_rig * point->position) - pixel), 1e-6);
      EXPECT_GT(glm::dot(point->normal, point->wo), 0);
    }
  }
}

TEST(Trace, SilhouetteLiesAtTheAngleWhoseSineIsRadiusOverDistance) {
  const RigGeometry rig = simple_rig(0.8);
  const double rim = 3000 * std::tan(std::asin(0.05 / 0.8));  // pixels from the principal point
  for (double azimuth = 0; azimuth < 2 * pi; azimuth += 0.1) {
    const glm::dvec2 outwards(std::cos(azimuth), std::sin(azimuth));
    EXPECT_TRUE(trace(rig, rig.camera.centre + (rim - 1e-7) * outwards));
    EXPECT_FALSE(trace(rig, rig.camera.centre + (rim + 1e-7) * outwards));
  }
}

TEST(Trace, OrthographicSilhouetteIsTheRadius) {
  RigGeometry rig = simple_rig(0.0001);  // the depth of an orthographic camera has no meaning
  rig.camera.projection = CameraModel::Projection::orthographic;
  EXPECT_TRUE(trace(rig, rig.camera.centre + glm::dvec2(149.9999, 0)));
  EXPECT_FALSE(trace(rig, rig.camera.centre + glm::dvec2(150.0001, 0)));
  const auto point = trace(rig, rig.camera.centre + glm::dvec2(90, 0));  // 3-4-5 triangle
  ASSERT_TRUE(point);
  EXPECT_LT(glm::length(point->normal - glm::dvec3(0.6, 0, 0.8)), 1e-14);
}

TEST(Trace, SphereBehindTheCameraIsNotSeen) {
  RigGeometry rig = simple_rig(1.0);
  rig.cam_from_rig.translation.z = -1.0;
  EXPECT_FALSE(trace(rig, rig.camera.centre));
}

// ---- lights

SurfacePoint front_point() { return {{0, 0, 0.05}, {0, 0, 1}, {0, 0, 1}}; }

TEST(PlaceLight, TurnsRightHandedAboutTheAxisThroughItsPoint) {
  RigGeometry rig;
  rig.axis_point = {0.1, 7, 0};
  rig.lights.push_back({.position = {0, 0.2, 1}});
  // Right-handed about y: z turns to x. (0,.2,1) relative to the axis is (-.1, ., 1) -> (1, ., .1).
  const PlacedLight placed = rig.place_light(0, pi / 2);
  EXPECT_LT(glm::length(placed.position - glm::dvec3(1.1, 0.2, 0.1)), 1e-14);
}

TEST(PlaceLight, LightBesideTheArmStays) {
  RigGeometry rig;
  rig.lights.push_back({.on_arm = false, .position = {0, 0.2, 1}});
  rig.lights.push_back({.distant = true, .on_arm = false, .direction = {0, 0, 1}});
  rig.lights.push_back({.distant = true, .on_arm = true, .direction = {0, 0, 1}});
  EXPECT_LT(glm::length(rig.place_light(0, 1.0).position - glm::dvec3(0, 0.2, 1)), 1e-15);
  EXPECT_LT(glm::length(rig.place_light(1, 1.0).direction - glm::dvec3(0, 0, 1)), 1e-15);
  EXPECT_LT(glm::length(rig.place_light(2, pi / 2).direction - glm::dvec3(1, 0, 0)), 1e-15);
  EXPECT_THROW(rig.place_light(3, 0), std::out_of_range);
}

TEST(PlaceLight, ArmCarriesTheAim) {
  RigGeometry rig;
  rig.axis_point = {0.02, 0, -0.01};
  rig.lights.push_back({.position = {0.1, 0.3, 0.9}});
  const PlacedLight at0 = rig.place_light(0, 0), at1 = rig.place_light(0, 1.3);
  EXPECT_LT(glm::length(at0.axis + glm::normalize(at0.position)), 1e-15);  // towards the origin
  const glm::dvec3 axis_point = rig.axis_point;
  EXPECT_NEAR(glm::dot(at0.axis, at0.position - axis_point), glm::dot(at1.axis, at1.position - axis_point), 1e-14);
}

TEST(Illuminate, FallsWithTheSquareOfTheDistance) {
  PlacedLight light{.position = {0, 0, 0.55}, .intensity = {2, 3, 4}};
  const auto near = illuminate(light, front_point());
  light.position.z = 1.05;
  const auto far = illuminate(light, front_point());
  ASSERT_TRUE(near && far);
  EXPECT_NEAR(near->irradiance.x, 2 / 0.25, 1e-12);  // I / d^2
  EXPECT_NEAR(far->irradiance.x, 2 / 1.0, 1e-12);
  EXPECT_NEAR(near->irradiance.z / near->irradiance.x, 2, 1e-15);
}

TEST(Illuminate, GoesWithTheCosineAtTheSurfaceAndItsPowerAtTheEmitter) {
  // Light at 60 degrees from the normal, aimed past the point by 45 degrees.
  const glm::dvec3 to_light(std::sin(pi / 3), 0, std::cos(pi / 3));
  PlacedLight light{.position = front_point().position + 2.0 * to_light, .intensity = glm::dvec3(1), .falloff_exponent = 4};
  const glm::dvec3 across(-to_light.z, 0, to_light.x);
  light.axis = glm::normalize(-to_light + across);
  const auto lit = illuminate(light, front_point());
  ASSERT_TRUE(lit);
  EXPECT_NEAR(lit->irradiance.x, 0.5 / 4 * 0.25, 1e-14);  // cos 60 / d^2 * cos^4 45
  EXPECT_LT(glm::length(lit->wi - to_light), 1e-15);
}

TEST(Illuminate, DistantLightHasNoDistance) {
  const glm::dvec3 d = glm::normalize(glm::dvec3(0, 3, 4));
  const auto lit = illuminate({.distant = true, .direction = d, .intensity = {5, 5, 5}}, front_point());
  ASSERT_TRUE(lit);
  EXPECT_NEAR(lit->irradiance.x, 5 * 0.8, 1e-15);
}

TEST(Illuminate, TerminatorOfANearLightLiesWhereItsTangentTouches) {
  const double distance = 0.2, radius = 0.05, rim = std::acos(radius / distance);  // angle from the axis light - centre
  const PlacedLight light{.position = {0, 0, distance}};
  const auto at = [&](double angle) {
    const glm::dvec3 n(std::sin(angle), 0, std::cos(angle));
    return illuminate(light, {radius * n, n, n});
  };
  EXPECT_TRUE(at(rim - 1e-9));
  EXPECT_FALSE(at(rim + 1e-9));
}

TEST(Illuminate, OffsetMovesTheSourceInTheEmittersPlane) {
  const glm::dvec3 axis = glm::normalize(glm::dvec3(-0.3, 0.2, -0.9));
  const PlacedLight light{.position = {0, 0, 1}, .axis = axis, .diameter = 0.02};
  const auto centre = illuminate(light, front_point());
  for (double azimuth = 0; azimuth < 2 * pi; azimuth += 0.5) {
    const auto moved = illuminate(light, front_point(), 0.01 * glm::dvec2(std::cos(azimuth), std::sin(azimuth)));
    ASSERT_TRUE(centre && moved);
    // Source from direction and inverse-square law: E = cos / d^2.
    const glm::dvec3 source = front_point().position + moved->wi * std::sqrt(moved->wi.z / moved->irradiance.x);
    EXPECT_NEAR(glm::length(source - light.position), 0.01, 1e-12);
    EXPECT_NEAR(glm::dot(source - light.position, axis), 0, 1e-12);
  }
}

TEST(ShadingFrame, KeepsAllAnglesAtEveryNormal) {
  std::mt19937_64 random(2);
  std::vector<glm::dvec3> normals{{0, 0, 1}, {0, 0, -1}, {1, 0, 0}, {0, -1, 0}, glm::normalize(glm::dvec3(1e-9, 0, -1)),
                                  glm::normalize(glm::dvec3(0, 1e-160, -1))};
  for (int i = 0; i < 100; ++i) normals.push_back(random_direction(random));
  for (const glm::dvec3& n : normals) {
    const SurfacePoint point{n, n, random_direction(random)};
    const glm::dvec3 wi = random_direction(random);
    const LocalDirections local = to_shading_frame(point, wi);
    EXPECT_NEAR(local.wi.z, glm::dot(n, wi), 1e-15);
    EXPECT_NEAR(local.wo.z, glm::dot(n, point.wo), 1e-15);
    EXPECT_NEAR(glm::dot(local.wi, local.wo), glm::dot(wi, point.wo), 1e-14);
    EXPECT_NEAR(glm::length(local.wi), 1, 1e-14);
    // Right-handed: the triple product keeps its sign.
    EXPECT_NEAR(glm::dot(glm::cross(local.wi, local.wo), glm::dvec3(0, 0, 1)), glm::dot(glm::cross(wi, point.wo), n), 1e-14);
  }
}

}  // namespace
}  // namespace lacquer::acquire
