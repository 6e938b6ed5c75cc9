#include "libfit/nonnegative_least_squares.h"

#include <algorithm>
#include <cmath>

namespace lacquer::fit {

namespace {

/// Solves G z = b on the rows `passive` by Cholesky, G with unit diagonal; false where G is numerically
/// singular.
bool solve_subset(const std::vector<double>& gram, const std::vector<double>& b,
                  const std::vector<int>& passive, int n, std::vector<double>& z) {
  const int size = static_cast<int>(passive.size());
  std::vector<double> lower(static_cast<std::size_t>(size) * size);
  z.resize(static_cast<std::size_t>(size));
  for (int i = 0; i < size; ++i) {
    for (int j = 0; j <= i; ++j) {
      double sum = gram[passive[i] * n + passive[j]];
      for (int k = 0; k < j; ++k) sum -= lower[i * size + k] * lower[j * size + k];
      if (i == j && sum < 1e-12) return false;
      lower[i * size + j] = i == j ? std::sqrt(sum) : sum / lower[j * size + j];
    }
    double sum = b[passive[i]];
    for (int k = 0; k < i; ++k) sum -= lower[i * size + k] * z[k];
    z[i] = sum / lower[i * size + i];
  }
  for (int i = size - 1; i >= 0; --i) {
    for (int k = i + 1; k < size; ++k) z[i] -= lower[k * size + i] * z[k];
    z[i] /= lower[i * size + i];
  }
  return true;
}

/// The working set of Lawson and Hanson's algorithm on a Gram matrix with unit diagonal.
class ActiveSet {
 public:
  ActiveSet(std::vector<double> gram, std::vector<double> rhs)
      : n_(static_cast<int>(rhs.size())),
        gram_(std::move(gram)),
        rhs_(std::move(rhs)),
        x_(rhs_.size()),
        refused_(rhs_.size()) {}

  const std::vector<double>& x() const { return x_; }

  void solve() {
    const double threshold = 1e-10 * std::abs(*std::max_element(rhs_.begin(), rhs_.end()));
    for (int iteration = 0; iteration < 5 * n_; ++iteration) {
      const int entering = steepest(threshold);
      if (entering < 0) return;
      passive_.push_back(entering);
      descend(entering);
    }
  }

 private:
  /// The variable at zero whose growth pays most; -1: none does.
  int steepest(double threshold) const {
    int best = -1;
    for (int i = 0; i < n_; ++i) {
      if (refused_[i] || std::find(passive_.begin(), passive_.end(), i) != passive_.end()) continue;
      double slope = rhs_[i];
      for (int j = 0; j < n_; ++j) slope -= gram_[i * n_ + j] * x_[j];
      if (slope > threshold) best = i, threshold = slope;
    }
    return best;
  }

  /// Moves to the minimum on the passive set, dropping every variable that reaches zero on the way.
  void descend(int entering) {
    std::vector<double> z;
    while (!passive_.empty()) {
      if (!solve_subset(gram_, rhs_, passive_, n_, z)) {  // linearly dependent: the set without it is as good
        std::erase(passive_, entering);
        x_[entering] = 0;
        refused_[entering] = true;
        return;
      }
      int blocking = -1;
      double step = 1;
      for (std::size_t i = 0; i < passive_.size(); ++i) {
        if (z[i] > 0) continue;
        const double x = x_[passive_[i]], limit = x > 0 ? x / (x - z[i]) : 0;
        if (blocking < 0 || limit < step) blocking = passive_[i], step = limit;
      }
      for (std::size_t i = 0; i < passive_.size(); ++i) x_[passive_[i]] += step * (z[i] - x_[passive_[i]]);
      if (blocking < 0) return;
      x_[blocking] = 0;
      std::erase(passive_, blocking);
      if (blocking == entering) refused_[entering] = true;  // rounding: its slope is not really positive
    }
  }

  int n_;
  std::vector<double> gram_, rhs_, x_;
  std::vector<bool> refused_;
  std::vector<int> passive_;
};

}  // namespace

NonnegativeSolution nonnegative_least_squares(std::span<const double> gram, std::span<const double> b) {
  const int n = static_cast<int>(b.size());
  std::vector<double> scale(b.size()), g(gram.size()), rhs(b.size());
  for (int i = 0; i < n; ++i) scale[i] = gram[i * n + i] > 0 ? 1 / std::sqrt(gram[i * n + i]) : 0;
  for (int i = 0; i < n; ++i) {
    rhs[i] = b[i] * scale[i];
    for (int j = 0; j < n; ++j) g[i * n + j] = gram[i * n + j] * scale[i] * scale[j];
  }
  ActiveSet active(g, rhs);
  active.solve();

  NonnegativeSolution solution;
  for (int i = 0; i < n; ++i) {
    double gx = 0;
    for (int j = 0; j < n; ++j) gx += g[i * n + j] * active.x()[j];
    solution.reduction += active.x()[i] * (2 * rhs[i] - gx);
    solution.x.push_back(active.x()[i] * scale[i]);
  }
  return solution;
}

}  // namespace lacquer::fit
