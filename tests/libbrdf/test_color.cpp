#include "libbrdf/color.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace lacquer::brdf {
namespace {

TEST(Color, WhiteIsTheD65WhiteOfSrgb) {
  const glm::dvec3 xyz = xyz_from_linear_srgb(glm::dvec3(1.0));
  EXPECT_NEAR(xyz.x, 0.3127 / 0.3290, 1e-15);
  EXPECT_NEAR(xyz.y, 1.0, 1e-15);
  EXPECT_NEAR(xyz.z, (1 - 0.3127 - 0.3290) / 0.3290, 1e-15);
}

TEST(Color, PrimariesHaveTheChromaticitiesOfRec709) {
  const double expected[3][2] = {{0.64, 0.33}, {0.30, 0.60}, {0.15, 0.06}};
  for (int i = 0; i < 3; ++i) {
    glm::dvec3 rgb(0.0);
    rgb[i] = 1;
    const glm::dvec3 xyz = xyz_from_linear_srgb(rgb);
    EXPECT_NEAR(xyz.x / (xyz.x + xyz.y + xyz.z), expected[i][0], 1e-15);
    EXPECT_NEAR(xyz.y / (xyz.x + xyz.y + xyz.z), expected[i][1], 1e-15);
  }
}

TEST(Color, GreysAreNeutralWithTheLightnessOfCie) {
  // L* = 116 Y^(1/3) - 16 above 0.008856, 903.2963 Y below; by hand.
  const double expected[][2] = {
      {1.0, 100.0}, {0.18, 49.496108}, {0.5, 76.069261}, {0.001, 0.903296}, {0.0, 0.0}};
  for (const auto& [y, lightness] : expected) {
    const glm::dvec3 lab = lab_from_linear_srgb(glm::dvec3(y));
    EXPECT_NEAR(lab.x, lightness, 1e-6);
    EXPECT_NEAR(lab.y, 0.0, 1e-12);
    EXPECT_NEAR(lab.z, 0.0, 1e-12);
  }
}

TEST(Color, PrimariesAgreeWithThePublishedLab) {
  // Lindbloom's calculator for sRGB and D65, four decimals; it takes white as 0.95047, 1, 1.08883 (5 digits),
  // hence 0.02.
  const glm::dvec3 expected[3] = {
      {53.2408, 80.0925, 67.2032}, {87.7347, -86.1827, 83.1793}, {32.2970, 79.1875, -107.8602}};
  for (int i = 0; i < 3; ++i) {
    glm::dvec3 rgb(0.0);
    rgb[i] = 1;
    const glm::dvec3 lab = lab_from_linear_srgb(rgb);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(lab[k], expected[i][k], 0.02);
  }
}

TEST(Color, NegativeInputIsNotClamped) {
  EXPECT_NEAR(lab_from_linear_srgb(glm::dvec3(-0.001)).x, -0.903296, 1e-6);
}

TEST(Color, LabIsContinuousAtItsLinearBranch) {
  const double edge = 216.0 / 24389;
  EXPECT_NEAR(lab_from_linear_srgb(glm::dvec3(edge * (1 - 1e-12))).x,
              lab_from_linear_srgb(glm::dvec3(edge * (1 + 1e-12))).x, 1e-9);
  EXPECT_NEAR(lab_from_linear_srgb(glm::dvec3(edge)).x, 8.0, 1e-12);
}

TEST(DeltaE2000, AgreesWithThe34PairsOfSharmaWuDalal) {
  // Color Research and Application 30(1), 2005, Table 1: L1 a1 b1 L2 a2 b2 and the difference, four decimals.
  const double pairs[34][7] = {
      {50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425},
      {50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615},
      {50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412},
      {50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000},
      {50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000},
      {50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000},
      {50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669},
      {50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669},
      {50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792},
      {50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792},
      {50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195},
      {50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195},
      {50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045},
      {50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045},
      {50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461},
      {50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065},
      {50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492},
      {50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977},
      {50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030},
      {50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535},
      {50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000},
      {50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000},
      {50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000},
      {50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000},
      {60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644},
      {63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630},
      {61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731},
      {35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645},
      {22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373},
      {36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146},
      {90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441},
      {90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381},
      {6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377},
      {2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082},
  };
  for (const auto& p : pairs) {
    const glm::dvec3 a(p[0], p[1], p[2]), b(p[3], p[4], p[5]);
    EXPECT_NEAR(delta_e_2000(a, b), p[6], 5.1e-5)
        << p[0] << " " << p[1] << " " << p[2];  // the table's rounding
    EXPECT_NEAR(delta_e_2000(b, a), p[6], 5.1e-5) << p[0] << " " << p[1] << " " << p[2];
  }
}

TEST(DeltaE2000, BlackAndWhiteAreAHundredApart) {
  EXPECT_NEAR(delta_e_2000({100, 0, 0}, {0, 0, 0}), 100.0, 1e-12);  // mean L* is 50, where S_L = 1
}

TEST(DeltaE2000, IsSymmetricNotNegativeAndExactlyZeroForEqualColours) {
  std::mt19937_64 generator(2000);
  std::uniform_real_distribution<double> lightness(0, 100), ab(-100, 100);
  for (int i = 0; i < 20000; ++i) {
    const glm::dvec3 a(lightness(generator), ab(generator), ab(generator));
    const glm::dvec3 b(lightness(generator), ab(generator), ab(generator));
    EXPECT_EQ(delta_e_2000(a, a), 0.0);
    EXPECT_NEAR(delta_e_2000(a, b), delta_e_2000(b, a), 1e-12);
    EXPECT_GT(delta_e_2000(a, b), 0.0);
  }
}

}  // namespace
}  // namespace lacquer::brdf
