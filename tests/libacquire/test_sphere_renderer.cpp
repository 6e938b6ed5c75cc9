#include "libacquire/sim/sphere_renderer.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <limits>
#include <numbers>

#include "libacquire/sim/quadrature.h"
#include "libbrdf/error.h"

namespace lacquer::acquire::sim {
namespace {

constexpr double pi = std::numbers::pi;

/// A BRDF from a formula.
class FormulaBrdf final : public brdf::Brdf {
 public:
  using Formula = std::function<std::optional<glm::dvec3>(const brdf::Directions&)>;
  explicit FormulaBrdf(Formula formula) : formula_(std::move(formula)) {}
  std::string description() const override { return "formula"; }

 private:
  std::optional<glm::dvec3> do_value(const brdf::Directions& d, const brdf::Footprint<double>&) const override { return formula_(d); }
  Formula formula_;
};

std::shared_ptr<const brdf::Brdf> formula(FormulaBrdf::Formula f) { return std::make_shared<FormulaBrdf>(std::move(f)); }

/// Ford F8 of papers/table1.json (Günther et al. 2005, Table 1): a clear coat of m = 0.013, 0.7 degrees, over a dark base.
std::shared_ptr<const brdf::Brdf> ford_f8() {
  return std::make_shared<brdf::CookTorranceBrdf>(brdf::CookTorrance{{0.0012, 0.0015, 0.0018},
                                                                     {{{0.0049, 0.0076, 0.012}, 0.32, 0.15},
                                                                      {{0.01, 0.013, 0.018}, 0.11, 0.087},
                                                                      {{0.007, 0.0065, 0.0077}, 0.013, 0.9}}});
}

RigGeometry rig_with_radius(double radius_px, int width, int height) {
  RigGeometry rig;
  rig.sphere_radius = 0.05;
  rig.camera.width = width;
  rig.camera.height = height;
  rig.camera.focal = glm::dvec2(radius_px / 0.05);  // at 1 m
  rig.camera.centre = {(width - 1) / 2.0 + 0.13, (height - 1) / 2.0 - 0.29};
  rig.camera.distortion = {-0.1, 0.05, 1e-4, -2e-4, 0, 0, 0, 0};
  rig.cam_from_rig = look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  Light light;
  light.position = {0, 0.03, 0.6};
  light.diameter = 0.005;
  light.falloff_exponent = 1;
  rig.lights = {light};
  return rig;
}

RigGeometry orthographic_rig(double radius_px, int size) {
  RigGeometry rig = rig_with_radius(radius_px, size, size);
  rig.camera.projection = CameraModel::Projection::orthographic;
  rig.camera.distortion = {};
  return rig;
}

PlacedLight distant_light(const glm::dvec3& direction) {
  PlacedLight light;
  light.distant = true;
  light.direction = glm::normalize(direction);
  light.axis = -light.direction;
  return light;
}

/// Mean over a pixel and the emitter by n x n strata of the pixel, each with another point of a spiral on the emitter (Vogel 1979).
/// Shares nothing with the renderer's rules but the single ray.
glm::dvec3 brute_force(const SphereRenderer& renderer, const PlacedLight& light, int x, int y, int n) {
  glm::dvec3 total(0.0);
  const int count = n * n;
  for (int i = 0; i < count; ++i) {
    const int k = static_cast<int>((static_cast<long long>(i) * 2654435761LL) % count);  // odd factor: a permutation for n = 2^m
    const double radius = std::sqrt((k + 0.5) / count), angle = k * 2.39996322972865332;
    total += renderer.radiance(light, {x + (i % n + 0.5) / n - 0.5, y + (i / n + 0.5) / n - 0.5},
                               0.5 * light.diameter * radius * glm::dvec2(std::cos(angle), std::sin(angle)));
  }
  return total / static_cast<double>(count);
}

glm::ivec2 brightest(const RadianceImage& image) {
  const auto at = static_cast<int>(std::max_element(image.data.begin() + static_cast<std::ptrdiff_t>(image.index(1, 0, 0)),
                                                    image.data.begin() + static_cast<std::ptrdiff_t>(image.index(2, 0, 0))) -
                                   image.data.begin() - static_cast<std::ptrdiff_t>(image.index(1, 0, 0)));
  return {at % image.width, at / image.width};
}

double sum_of(const RadianceImage& image, int channel) {
  double total = 0;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) total += static_cast<double>(image.at(channel, x, y));
  return total;
}

// ---- rules

TEST(Quadrature, SquareRuleIsExactForItsDegree) {
  for (const int n : {1, 2, 3, 5, 8})
    for (int p = 0; p < 2 * n; ++p)
      for (int q = 0; q < 2 * n; ++q) {
        double mean = 0;
        for (const PlaneNode& node : square_rule(n)) mean += node.weight * std::pow(node.at.x, p) * std::pow(node.at.y, q);
        const auto moment = [](int power) { return power % 2 ? 0.0 : std::pow(0.5, power) / (power + 1); };
        EXPECT_NEAR(mean, moment(p) * moment(q), 1e-14) << n << " " << p << " " << q;
      }
}

TEST(Quadrature, DiscRuleIsExactForItsDegree) {
  for (const auto& [radii, angles] : {std::pair{1, 4}, {2, 8}, {3, 12}, {4, 16}})
    for (int p = 0; p < 12; ++p)
      for (int q = 0; p + q < std::min(angles, 4 * radii); ++q) {
        double mean = 0;
        for (const PlaneNode& node : disc_rule(radii, angles)) mean += node.weight * std::pow(node.at.x, p) * std::pow(node.at.y, q);
        // Mean of x^p y^q over the unit disc: 2 / (p + q + 2) times that over the circle, Gamma functions for even powers.
        const bool even = p % 2 == 0 && q % 2 == 0;
        const double circle = even ? std::tgamma((p + 1) / 2.0) * std::tgamma((q + 1) / 2.0) / (pi * std::tgamma((p + q) / 2.0 + 1)) : 0;
        EXPECT_NEAR(mean, circle * 2 / (p + q + 2), 1e-14) << radii << " " << p << " " << q;
      }
}

// ---- silhouette

TEST(SphereRenderer, ASphereOfConstantRadianceHasTheAreaOfItsDisc) {
  const auto constant = formula([](const brdf::Directions& d) { return glm::dvec3(1 / d.wi.z); });  // L = f cos E = E
  for (const double radius : {12.3, 60.0, 150.7}) {
    const SphereRenderer renderer(orthographic_rig(radius, static_cast<int>(2 * radius) + 9), constant, 3);
    const RadianceImage image = renderer.render(distant_light({0, 0, 1}));
    // Errors of single silhouette pixels are below 1e-2 and independent: sqrt(2 pi r) of them.
    EXPECT_NEAR(sum_of(image, 0), pi * radius * radius, 1e-2 * std::sqrt(2 * pi * radius)) << radius;
  }
}

TEST(SphereRenderer, SilhouettePixelsShowTheFractionThatIsCovered) {
  const auto constant = formula([](const brdf::Directions& d) { return glm::dvec3(1 / d.wi.z); });
  const RigGeometry rig = orthographic_rig(40.3, 91);
  const RadianceImage image = SphereRenderer(rig, constant, 3).render(distant_light({0, 0, 1}));
  for (int y = 0; y < 91; ++y)
    for (int x = 0; x < 91; ++x) {
      constexpr int n = 40;  // counted on a grid of 40 x 40, good to about 1/80
      int inside = 0;
      for (int i = 0; i < n * n; ++i) {
        const glm::dvec2 p = glm::dvec2(x + (i % n + 0.5) / n - 0.5, y + (i / n + 0.5) / n - 0.5) - rig.camera.centre;
        inside += glm::dot(p, p) < 40.3 * 40.3;
      }
      EXPECT_NEAR(image.at(0, x, y), static_cast<double>(inside) / (n * n), 0.02) << x << " " << y;
    }
}

// ---- highlight

TEST(SphereRenderer, HighlightOfANarrowClearCoatAgreesWithBruteForceInEveryPixel) {
  struct Case {
    double radius_px, diameter, angle;
  };
  for (const Case& c : {Case{150, 0.005, 0.5}, {150, 0.02, 1.5}, {60, 0.005, 1.0}, {150, 0, 2.2}, {300, 0.005, 0.8}}) {
    RigGeometry rig = rig_with_radius(c.radius_px, static_cast<int>(2.2 * c.radius_px), static_cast<int>(2.2 * c.radius_px));
    rig.lights[0].diameter = c.diameter;
    const SphereRenderer renderer(rig, ford_f8(), 3);
    const PlacedLight light = rig.place_light(0, c.angle);
    const RadianceImage image = renderer.render(light);
    const glm::ivec2 peak = brightest(image);
    double sum = 0, expected_sum = 0;
    for (int dy = -8; dy <= 8; dy += 4)
      for (int dx = -8; dx <= 8; dx += 4) {
        const glm::dvec3 expected = brute_force(renderer, light, peak.x + dx, peak.y + dy, 64);
        const double got = static_cast<double>(image.at(1, peak.x + dx, peak.y + dy));
        EXPECT_NEAR(got / expected.g, 1, 5e-3) << c.radius_px << " px, " << c.diameter << " m: " << dx << ", " << dy;
        sum += got;
        expected_sum += expected.g;
      }
    EXPECT_NEAR(sum / expected_sum, 1, 1e-3) << c.radius_px;
  }
}

TEST(SphereRenderer, AHighlightSmallerThanAPixelKeepsItsEnergy) {
  // Normals turn by 1/20 rad from pixel to pixel, the lobe is 0.013 wide; its integral must not depend on where the pixels lie.
  double first = 0;
  for (int shift = 0; shift < 4; ++shift) {
    RigGeometry rig = rig_with_radius(20, 49, 49);
    rig.camera.centre += glm::dvec2(0.27 * shift, 0.11 * shift);
    const RadianceImage image = SphereRenderer(rig, ford_f8(), 3).render(rig.place_light(0, 0.6));
    if (shift == 0) first = sum_of(image, 1);
    EXPECT_NEAR(sum_of(image, 1) / first, 1, 3e-3) << shift;
  }
}

TEST(SphereRenderer, TerminatorAndOrdinaryPixelsAgreeWithBruteForce) {
  const RigGeometry rig = rig_with_radius(100, 221, 221);
  const SphereRenderer renderer(rig, ford_f8(), 3);
  const PlacedLight light = rig.place_light(0, 1.2);
  const RadianceImage image = renderer.render(light);
  for (int y = 12; y < 221; y += 23)
    for (int x = 5; x < 221; x += 4) {
      const double expected = brute_force(renderer, light, x, y, 32).g;
      double nearby = 0;  // at the terminator and the silhouette the error counts against what is next to it
      for (int dx = -1; dx <= 1; ++dx) nearby = std::max(nearby, static_cast<double>(image.at(1, std::clamp(x + dx, 0, 220), y)));
      EXPECT_NEAR(image.at(1, x, y), expected, 0.02 * nearby + 1e-9) << x << " " << y;
    }
}

// ---- whole pictures

TEST(SphereRenderer, ReflectsTheAlbedoOfALambertianSphere) {
  // Sphere lit and seen along z: image integral of rho/pi cos over the disc = rho/pi * 2 pi r^2 / 3.
  const double radius = 80;
  const SphereRenderer renderer(orthographic_rig(radius, 181), formula([](const auto&) { return glm::dvec3(0.5 / pi); }), 3);
  const RadianceImage image = renderer.render(distant_light({0, 0, 1}));
  EXPECT_NEAR(sum_of(image, 2) / (0.5 * 2 / 3.0 * radius * radius), 1, 2e-4);
}

TEST(SphereRenderer, HighlightOfADistantLightLiesAtTheHalfVector) {
  const double radius = 120;
  const RigGeometry rig = orthographic_rig(radius, 281);
  const SphereRenderer renderer(rig, formula([](const brdf::Directions& d) {
                                  const glm::dvec3 h = glm::normalize(d.wi + d.wo);
                                  return glm::dvec3(std::exp((h.z - 1) / 2e-4) / d.wi.z);
                                }), 3);
  for (const glm::dvec3& wi : {glm::dvec3(0.6, 0, 0.8), glm::dvec3(0, 0.6, 0.8), glm::dvec3(-0.5, -0.7, 0.2)}) {
    const RadianceImage image = renderer.render(distant_light(wi));
    glm::dvec2 centroid(0.0);
    for (int y = 0; y < 281; ++y)
      for (int x = 0; x < 281; ++x) centroid += static_cast<double>(image.at(0, x, y)) * glm::dvec2(x, y);
    centroid /= sum_of(image, 0);
    const glm::dvec3 n = glm::normalize(glm::normalize(wi) + glm::dvec3(0, 0, 1));  // rig y is up, image y is down
    EXPECT_LT(glm::length(centroid - (rig.camera.centre + radius * glm::dvec2(n.x, -n.y))), 0.3);  // the lobe is skewed by the sphere
  }
}

TEST(SphereRenderer, CameraWithoutColourSeesLuminance) {
  const auto paint = formula([](const auto&) { return glm::dvec3(0.1, 0.2, 0.4); });
  const RigGeometry rig = orthographic_rig(20, 51);
  const RadianceImage image = SphereRenderer(rig, paint, 1).render(distant_light({0, 0, 1}));
  ASSERT_EQ(image.n_channels, 1);
  EXPECT_NEAR(image.at(0, 25, 25), 0.2126 * 0.1 + 0.7152 * 0.2 + 0.0722 * 0.4, 1e-3);  // cosine of the pixel beside the centre
}

TEST(SphereRenderer, HolesOfAPaintTakeTheNearestValueTowardsTheNormal) {
  const auto holey = formula([](const brdf::Directions& d) -> std::optional<glm::dvec3> {
    if (std::acos(d.wo.z) > 1.0) return std::nullopt;
    return glm::dvec3(std::acos(d.wo.z));
  });
  const glm::dvec3 value = defined_value(*holey, {brdf::direction(0.3, 0), brdf::direction(1.4, 2)});
  EXPECT_LE(value.r, 1.0);
  EXPECT_GT(value.r, 1.0 - 1.4 / 32 - 1e-12);  // one of 32 steps
  const auto empty = formula([](const auto&) -> std::optional<glm::dvec3> { return std::nullopt; });
  EXPECT_EQ(defined_value(*empty, {brdf::direction(0.3, 0), brdf::direction(1.4, 2)}), glm::dvec3(0.0));
}

TEST(SphereRenderer, PicturesDoNotDependOnTheNumberOfThreads) {
  const RigGeometry rig = rig_with_radius(60, 140, 133);
  const PlacedLight light = rig.place_light(0, 0.9);
  const RadianceImage parallel = SphereRenderer(rig, ford_f8(), 3).render(light);
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  EXPECT_EQ(SphereRenderer(rig, ford_f8(), 3).render(light).data, parallel.data);
}

TEST(SphereRenderer, RefusesAPaintThatIsNotFiniteAndACameraThatLooksElsewhere) {
  RigGeometry rig = rig_with_radius(20, 51, 51);
  const auto broken = formula([](const auto&) { return glm::dvec3(std::numeric_limits<double>::infinity()); });
  EXPECT_THROW(SphereRenderer(rig, broken, 3).render(rig.place_light(0, 0)), Error);
  rig.cam_from_rig = look_at({0, 0, 1}, {1, 0, 0}, {0, 1, 0});
  EXPECT_THROW(SphereRenderer(rig, ford_f8(), 3), Error);
}

}  // namespace
}  // namespace lacquer::acquire::sim
