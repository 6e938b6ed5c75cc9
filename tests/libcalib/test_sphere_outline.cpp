#include "libcalib/sphere_outline.h"

#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>

#include "libbrdf/error.h"
#include "libcalib/sphere_photograph.h"

namespace lacquer::calib {
namespace {

using test::photograph;
using test::photographed_rig;

/// The rig with the sphere elsewhere: camera and lights keep their places in the room.
acquire::RigGeometry with_sphere_at(acquire::RigGeometry g, const glm::dvec3& sphere) {
  g.cam_from_rig.translation += g.cam_from_rig.rotation * sphere;
  g.axis_point -= sphere;
  for (auto& light : g.lights) light.position -= sphere;
  return g;
}

OutlineFinder::Outline found(const acquire::RigGeometry& truth, const acquire::RigGeometry& nominal, const std::vector<double>& angles,
                             const std::function<void(RadianceImage&)>& change = {}) {
  OutlineFinder finder(nominal, {.lens_blur_px = 0});
  for (const double a : angles) {
    auto image = photograph(truth, a, {.diffuse = 0.1}, 0.02, 6, 1);
    if (change) change(image);
    finder.add(image, nominal.place_light(0, a));
  }
  return finder.finish();
}

double centre_error_px(const acquire::RigGeometry& a, const acquire::RigGeometry& b) {
  return glm::length(*a.camera.project(a.cam_from_rig.translation) - *b.camera.project(b.cam_from_rig.translation));
}

TEST(SphereOutline, ASphereThreeMillimetresOffIsFoundFromHalfOfItsLimb) {
  const auto nominal = photographed_rig(), truth = with_sphere_at(nominal, {0.003, -0.002, 0.003});
  EXPECT_GT(centre_error_px(nominal, truth), 10);
  const auto outline = found(truth, nominal, {0.0, 0.8, 1.5});
  EXPECT_GT(outline.n_dark, 30u) << "the other half is never lit: what is seen there is the terminator";
  EXPECT_GT(outline.edges.size(), 50u);
  EXPECT_LT(centre_error_px(outline.geometry, truth), 0.1);
  double sum = 0;
  for (const EdgePoint& e : outline.edges) sum += std::abs(*silhouette_distance(truth, e.pixel));
  EXPECT_LT(sum / static_cast<double>(outline.edges.size()), 0.08);
}

TEST(SphereOutline, TheBlurOfTheLensIsFoundFromTheLimb) {
  const auto rig = photographed_rig();
  for (const double blur : {0.6, 1.2}) {
    const auto outline = found(rig, rig, {0.0, 0.8}, [&](RadianceImage& image) {
      // By OpenCV, independent of the profile that is fitted.
      cv::Mat radiance(image.height, image.width, CV_32F, image.radiance.data());
      cv::GaussianBlur(radiance, radiance, cv::Size(0, 0), blur);
    });
    EXPECT_NEAR(outline.lens_blur_px, blur, 0.15) << blur;
  }
}

TEST(SphereOutline, AnArmBeforeTheLimbDoesNotMoveIt) {
  const auto nominal = photographed_rig(), truth = with_sphere_at(nominal, {-0.002, 0.001, 0});
  const auto outline = found(truth, nominal, {0.0, 1.2}, [](RadianceImage& image) {
    for (int y = 0; y < 70; ++y)
      for (int x = 240; x < 262; ++x) image.radiance[static_cast<std::size_t>(y * image.width + x)] = 0.001f;
  });
  // Arcs beside the arm stay; a fifth of the lit limb may go.
  const auto estimate = solve_geometry(nominal, outline.edges, {});
  EXPECT_GT(estimate.n_edge_outliers + outline.n_rejected, 2u);
  EXPECT_LT(centre_error_px(estimate.geometry, truth), 0.1);
}

TEST(SphereOutline, NothingIsFoundInTheDark) {
  const auto nominal = photographed_rig();
  const auto dark = found(nominal, nominal, {0.0}, [](RadianceImage& image) {
    for (std::size_t i = 0; i < image.radiance.size(); ++i) image.radiance[i] = 1e-4f * static_cast<float>(i % 7);
  });
  EXPECT_TRUE(dark.edges.empty());
  EXPECT_EQ(dark.geometry.cam_from_rig.translation, nominal.cam_from_rig.translation);
  OutlineFinder never(nominal, {});
  EXPECT_TRUE(never.finish().edges.empty());
}

TEST(SphereOutline, AnOrthographicCameraIsRefused) {
  auto g = photographed_rig();
  g.camera.projection = acquire::CameraModel::Projection::orthographic;
  EXPECT_THROW(OutlineFinder(g, {}), Error);
}

}  // namespace
}  // namespace lacquer::calib
