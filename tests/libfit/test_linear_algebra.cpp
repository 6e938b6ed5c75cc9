#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "libfit/nonnegative_least_squares.h"
#include "libfit/uncertainty.h"

namespace lacquer::fit {
namespace {

TEST(NonnegativeLeastSquares, SolvesByHand) {
  // |x - (1, -1)|^2 over x >= 0: (1, 0). G = I, b = (1, -1); what x takes off |b|^2 is 1.
  const std::vector<double> gram{1, 0, 0, 1}, b{1, -1};
  const auto solution = nonnegative_least_squares(gram, b);
  EXPECT_DOUBLE_EQ(solution.x[0], 1);
  EXPECT_DOUBLE_EQ(solution.x[1], 0);
  EXPECT_DOUBLE_EQ(solution.reduction, 1);
}

TEST(NonnegativeLeastSquares, MeetsTheKuhnTuckerConditionsOnRandomProblems) {
  std::mt19937 generator(1);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 500; ++trial) {
    const int n = 1 + trial % 9, rows = trial % 3 == 0 ? n / 2 + 1 : 3 * n;  // a third of them rank-deficient
    std::vector<double> a(static_cast<std::size_t>(rows * n)), y(static_cast<std::size_t>(rows));
    for (double& value : a) value = std::abs(normal(generator)) * std::pow(10, trial % 5);
    for (double& value : y) value = normal(generator);
    std::vector<double> gram(static_cast<std::size_t>(n * n)), b(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i)
      for (int k = 0; k < rows; ++k) {
        b[i] += a[k * n + i] * y[k];
        for (int j = 0; j < n; ++j) gram[i * n + j] += a[k * n + i] * a[k * n + j];
      }
    const auto solution = nonnegative_least_squares(gram, b);
    for (int i = 0; i < n; ++i) {
      double slope = b[i];
      for (int j = 0; j < n; ++j) slope -= gram[i * n + j] * solution.x[j];
      slope /= std::sqrt(gram[i * n + i]);
      EXPECT_GE(solution.x[i], 0) << trial;
      EXPECT_LE(slope, 1e-6) << trial;  // nothing would gain by growing
      if (solution.x[i] > 0) {
        EXPECT_NEAR(slope, 0, 1e-5) << trial;  // nothing positive would gain by shrinking
      }
    }
  }
}

TEST(SymmetricEigensystem, ReproducesTheMatrixAndIsOrthonormal) {
  std::mt19937 generator(2);
  std::normal_distribution<double> normal;
  for (const int n : {1, 2, 5, 18}) {
    std::vector<double> a(static_cast<std::size_t>(n * n));
    for (int i = 0; i < n; ++i)
      for (int j = 0; j <= i; ++j) a[i * n + j] = a[j * n + i] = normal(generator);
    const Eigensystem e = symmetric_eigensystem(a, n);
    for (int i = 0; i < n; ++i) {
      if (i > 0) {
        EXPECT_LE(e.values[i - 1], e.values[i]);
      }
      for (int j = 0; j < n; ++j) {
        double product = 0, dot = 0;
        for (int k = 0; k < n; ++k) {
          product += e.vectors[k * n + i] * e.values[k] * e.vectors[k * n + j];
          dot += e.vectors[i * n + k] * e.vectors[j * n + k];
        }
        EXPECT_NEAR(product, a[i * n + j], 1e-12 * n);
        EXPECT_NEAR(dot, i == j, 1e-12 * n);
      }
    }
  }
}

}  // namespace
}  // namespace lacquer::fit
