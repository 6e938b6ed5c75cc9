#include "libbrdf/cook_torrance_array.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "table1_paints.h"

namespace lacquer::brdf {
namespace {

struct Points {
  std::array<std::vector<float>, 5> columns;
  CosineArrays arrays() const { return {columns[0].data(), columns[1].data(), columns[2].data(), columns[3].data(), columns[4].data()}; }
  std::size_t size() const { return columns[0].size(); }
  HalfAngleCosines<double> at(std::size_t i) const { return {columns[0][i], columns[1][i], columns[2][i], columns[3][i], columns[4][i]}; }
};

/// From the peak to grazing; the count is no multiple of a vector.
Points points() {
  std::mt19937 generator(1);
  std::uniform_real_distribution<double> uniform(0, 1);
  Points p;
  while (p.size() < 20003) {
    const double u = uniform(generator);
    const auto c = half_angle_cosines(HalfDiff{1.57 * u * u * u, 1.57 * uniform(generator), 3.14 * uniform(generator)});
    if (std::min(c.n_dot_i, c.n_dot_o) < 1e-3) continue;
    const double values[] = {c.n_dot_i, c.n_dot_o, c.n_dot_h, c.i_dot_h, c.tan2_theta_h};
    for (std::size_t k = 0; k < 5; ++k) p.columns[k].push_back(static_cast<float>(values[k]));
  }
  return p;
}

std::array<std::vector<float>, 3> evaluated(const CookTorrance& model, const Points& p) {
  std::array<std::vector<float>, 3> out;
  for (auto& channel : out) channel.resize(p.size());
  float* const to[3] = {out[0].data(), out[1].data(), out[2].data()};
  evaluate(model, p.arrays(), p.size(), to);
  return out;
}

/// Largest relative error of results that are normal floats.
double largest_error(const CookTorrance& model, const Points& p) {
  const auto out = evaluated(model, p);
  double largest = 0;
  for (std::size_t i = 0; i < p.size(); ++i) {
    const glm::dvec3 f = model.value(p.at(i));
    for (int c = 0; c < 3; ++c) {
      const double error = std::abs(out[static_cast<std::size_t>(c)][i] - f[c]);
      if (f[c] >= std::numeric_limits<float>::min())
        largest = std::max(largest, error / f[c]);
      else
        EXPECT_LE(error, std::numeric_limits<float>::min());
    }
  }
  return largest;
}

TEST(CookTorranceArray, IsWithinOneIn100000OfTheValueInDouble) {
  const Points p = points();
  for (const auto& [name, paint] : test::table1_paints()) {
    EXPECT_LE(largest_error(paint, p), 1e-5) << name;
    CookTorrance bare = paint;  // without a diffuse part the lobes' tails show: values down to 1e-38
    bare.kd = glm::dvec3(0);
    EXPECT_LE(largest_error(bare, p), 1e-5) << name;
  }
}

TEST(CookTorranceArray, ExtremeWidths) {
  const Points p = points();
  for (const double m : {0.001, 0.01, 1.0})
    for (const double r : {0.0, 1.0}) EXPECT_LE(largest_error({glm::dvec3(0), {{glm::dvec3(0.1, 1, 10), m, r}}}, p), 1e-5) << m << " " << r;
}

/// Titan with a GGX base and a dielectric coat.
CookTorrance other_forms() {
  CookTorrance model = test::table1_paint("opel-titan");
  model.lobes[0].distribution = Distribution::ggx;
  model.lobes[1].distribution = Distribution::ggx;
  model.lobes[1].fresnel = model.lobes[2].fresnel = Fresnel::dielectric;
  model.lobes[1].r = 0.3, model.lobes[2].r = 0.04;
  return model;
}

TEST(CookTorranceArray, OtherFormsToo) {
  EXPECT_LE(largest_error(other_forms(), points()), 1e-5);
  for (const double m : {0.001, 1.0})
    for (const double r : {1e-4, 0.9})
      EXPECT_LE(largest_error({glm::dvec3(0), {{glm::dvec3(0.1, 1, 10), m, r, Distribution::ggx, Fresnel::dielectric}}}, points()), 1e-5) << m << " " << r;
}

TEST(CookTorranceArray, TheSameBytesWithAndWithoutAvx2) {
  const Points p = points();
  for (const auto& [name, paint] : test::table1_paints()) {
    const auto vectors = evaluated(paint, p);
    use_vector_evaluation(false);
    const auto baseline = evaluated(paint, p);
    use_vector_evaluation(true);
    EXPECT_EQ(vectors, baseline) << name;
  }
}

}  // namespace
}  // namespace lacquer::brdf
