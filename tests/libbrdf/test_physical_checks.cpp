#include "libbrdf/physical_checks.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "libbrdf/error.h"

namespace lacquer::brdf {
namespace {

/// Any function of the two directions.
class FunctionBrdf final : public Brdf {
 public:
  using Function = std::function<std::optional<glm::dvec3>(const Directions&)>;
  explicit FunctionBrdf(Function f) : f_(std::move(f)) {}
  std::string description() const override { return "function"; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>&) const override { return f_(d); }
  Function f_;
};

CheckOptions quick() { return {.theta_i = {0, 0.5, 1.2}, .resolution = 90}; }

TEST(PhysicalChecks, ADiffusePaintReflectsItsAlbedoWhateverTheAngle) {
  const CookTorranceBrdf paint({glm::dvec3(0.2, 0.5, 1.0), {}});
  const PhysicalChecks checks = check_physics(paint, quick());
  EXPECT_EQ(checks.reciprocity.mean_abs_log, 0);
  EXPECT_LT(checks.mirror.p95_abs_log, 1e-12);
  EXPECT_EQ(checks.n_negative, 0u);
  EXPECT_EQ(checks.n_undefined, 0u);
  ASSERT_EQ(checks.reflectances.size(), 3u);
  for (const Reflectance& r : checks.reflectances) {
    EXPECT_NEAR(r.value.x, 0.2, 1e-3);  // the integral of cos / pi over the hemisphere is 1
    EXPECT_NEAR(r.value.y, 0.5, 2.5e-3);
    EXPECT_TRUE(r.conserves_energy());
    EXPECT_EQ(r.undefined, 0);
  }
}

TEST(PhysicalChecks, MoreThanAllLightIsFound) {
  for (const Reflectance& r : check_physics(CookTorranceBrdf({glm::dvec3(0.2, 0.5, 1.2), {}}), quick()).reflectances) EXPECT_FALSE(r.conserves_energy());
}

TEST(PhysicalChecks, AnIrreciprocalAndAHandedPaintShowByHowMuch) {
  const FunctionBrdf irreciprocal([](const Directions& d) { return glm::dvec3(d.wi.z > d.wo.z ? std::exp(0.1) : 1.0); });
  EXPECT_NEAR(check_physics(irreciprocal, quick()).reciprocity.median_abs_log, 0.1, 1e-12);
  const FunctionBrdf handed([](const Directions& d) { return glm::dvec3(d.wi.x * d.wo.y - d.wi.y * d.wo.x > 0 ? std::exp(0.2) : 1.0); });
  const PhysicalChecks checks = check_physics(handed, quick());
  EXPECT_NEAR(checks.mirror.median_abs_log, 0.2, 1e-12);
}

TEST(PhysicalChecks, NegativeAndUndefinedValuesAreCounted) {
  const FunctionBrdf partly([](const Directions& d) -> std::optional<glm::dvec3> {
    if (d.wo.z < 0.5) return std::nullopt;
    return glm::dvec3(d.wo.z > 0.9 ? -0.25 : 1.0, 0, 1);
  });
  const PhysicalChecks checks = check_physics(partly, quick());
  EXPECT_GT(checks.n_negative, 0u);
  EXPECT_GT(checks.n_zero, checks.n_negative);
  EXPECT_GT(checks.n_undefined, 0u);
  EXPECT_EQ(checks.most_negative, -0.25);
  for (const Reflectance& r : checks.reflectances) EXPECT_NEAR(r.undefined, 0.25, 5e-3);  // integral of 2 c dc from 0 to 0.5
}

/// Constant table of every reachable cell.
HalfAngleTable constant_table(float value, float variance) {
  HalfAngleTable table(1);
  TableChannel& t = table.channels[0];
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    t.mean[i] = value;
    t.variance[i] = variance;
    t.origin[i] = CellOrigin::measured;
  }
  return table;
}

TEST(PhysicalChecks, ErrorsOfATableReachItsReflectance) {
  HalfAngleTable table = constant_table(0.2f, 0);
  table.scale_sigma = 0.1;
  const auto scaled = check_physics(TableBrdf(table, "scaled"), quick()).reflectances;
  for (const Reflectance& r : scaled) EXPECT_NEAR(r.sigma.y, 0.1 * r.value.y, 1e-3);
  const auto exact = check_physics(TableBrdf(constant_table(0.2f, 0), "exact"), quick()).reflectances;
  const auto noisy = check_physics(TableBrdf(constant_table(0.2f, 1.0f), "noisy"), quick()).reflectances;
  for (std::size_t k = 0; k < noisy.size(); ++k) {
    EXPECT_GT(noisy[k].sigma.y, 2 * exact[k].sigma.y);
    EXPECT_LT(noisy[k].sigma.y, 1.0);  // independent cells; one error common to all would give pi
  }
}

TEST(PhysicalChecks, OptionsOutOfRangeAreNamed) {
  const CookTorranceBrdf paint({glm::dvec3(0.2), {}});
  EXPECT_THROW(check_physics(paint, {.max_theta = 2, .theta_i = {}}), Error);
  EXPECT_THROW(check_physics(paint, {.theta_i = {}, .resolution = 0}), Error);
  EXPECT_THROW(check_physics(paint, {.theta_i = {1.6}}), Error);
}

/// Every cell measured once, at its centre or up to `jitter` cells beside it, of a BRDF that is mirror symmetric and has a slope along all axes.
HalfAngleTable sloping_table(double jitter, double sigma) {
  HalfAngleTable table(1);
  TableChannel& t = table.channels[0];
  std::mt19937 generator(2);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> beside(-jitter, jitter);
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    const TableGrid::Cell c = TableGrid::cell(i);
    HalfDiff at = TableGrid::centre(i);
    at.theta_h += beside(generator) * (TableGrid::theta_h_edge(c.theta_h + 1) - TableGrid::theta_h_edge(c.theta_h));
    at.theta_d += beside(generator) * std::numbers::pi / 180;
    at.phi_d += beside(generator) * std::numbers::pi / 180;
    const double f = std::exp(-2 * at.theta_h - 3 * at.theta_d + std::cos(2 * at.phi_d));
    t.mean[i] = static_cast<float>(f * (1 + sigma * normal(generator)));
    t.variance[i] = static_cast<float>(sigma * sigma * f * f);
    t.count[i] = 1;
    t.theta_h[i] = static_cast<float>(at.theta_h);
    t.theta_d[i] = static_cast<float>(at.theta_d);
    t.phi_d[i] = static_cast<float>(at.phi_d);
    t.origin[i] = CellOrigin::measured;
  }
  return table;
}

TEST(MirrorRepeatability, SaysTheNoiseAndTheBiasThatPairsHave) {
  constexpr double sigma = 0.02, bias = 0.05;
  HalfAngleTable table = sloping_table(0, sigma);
  const MirrorRepeatability noise = mirror_repeatability(table.channels[0]);
  EXPECT_EQ(noise.n_pairs, 88u * 88u * 90u);  // cells at the ends of theta_h and theta_d have no neighbour on one side
  EXPECT_NEAR(noise.expected_log, sigma * std::numbers::sqrt2, 1e-3);
  EXPECT_NEAR(noise.scatter_log, noise.expected_log, 2e-4);
  EXPECT_NEAR(noise.bias_log, 0, 2e-4);
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i)
    if (TableGrid::cell(i).phi_d < 90) table.channels[0].mean[i] *= static_cast<float>(std::exp(bias));
  EXPECT_NEAR(mirror_repeatability(table.channels[0]).bias_log, bias, 2e-4);
}

TEST(MirrorRepeatability, IsNotFooledBySamplesThatLieAtDifferentPlacesOfTheTwoCells) {
  constexpr double sigma = 0.02;
  // Uniform within 0.4 cells: theta_d alone makes the logarithms of a pair differ by 3 * 0.8 deg / sqrt(12) * sqrt(2) = 0.017, which would make
  // the scatter 17 % larger than the noise. What is left is of second order: the neighbours that give the slope lie beside their places too.
  const HalfAngleTable table = sloping_table(0.4, sigma);
  const MirrorRepeatability r = mirror_repeatability(table.channels[0]);
  EXPECT_NEAR(r.scatter_log / r.expected_log, 1, 0.03);
  EXPECT_NEAR(r.expected_log, sigma * std::numbers::sqrt2, 0.1 * sigma);
}

TEST(SmallerThanFootprint, ComparesTheFootprintWithTheCellsWidth) {
  TableChannel t;
  const std::size_t i = TableGrid::index(TableGrid::Cell{2, 10, 10});  // theta_h 0.0444 to 0.1 deg: 9.7e-4 wide
  t.footprint_along[i] = 1.0e-6f;
  EXPECT_TRUE(smaller_than_footprint(t, i));
  t.footprint_along[i] = 0.9e-6f;
  EXPECT_FALSE(smaller_than_footprint(t, i));
}

}  // namespace
}  // namespace lacquer::brdf
