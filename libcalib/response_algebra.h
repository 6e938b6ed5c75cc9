#pragma once

#include <cstddef>
#include <vector>

/// Symmetric positive (semi)definite systems of some hundred unknowns.
namespace lacquer::calib {

/// Lower triangle of a symmetric n x n matrix, row-major.
class SymmetricMatrix {
 public:
  explicit SymmetricMatrix(std::size_t n = 0) : n_(n), a_(n * n) {}
  std::size_t size() const { return n_; }
  double& at(std::size_t row, std::size_t column) { return a_[row * n_ + column]; }  ///< row >= column
  double operator()(std::size_t i, std::size_t j) const { return i >= j ? a_[i * n_ + j] : a_[j * n_ + i]; }
  const double* row(std::size_t i) const { return &a_[i * n_]; }
  double* row(std::size_t i) { return &a_[i * n_]; }
  void add(const SymmetricMatrix& other);
  void scale(double factor);
  /// x^T A x; the indices of x that are not 0 are first .. first + n.
  double quadratic_form(std::size_t first, const std::vector<double>& x) const;

 private:
  std::size_t n_;
  std::vector<double> a_;
};

/// x with A x = b. Unknowns that the matrix leaves open (to 1e-13 of their own scale) are 0.
std::vector<double> solve(SymmetricMatrix a, std::vector<double> b);
/// The same for several right sides.
std::vector<std::vector<double>> solve_columns(SymmetricMatrix a, std::vector<std::vector<double>> b);

/// Lower triangle L, row-major, of a row-major n x n covariance = L L^T; a direction without an error gets a column of zeros.
std::vector<double> cholesky_factor(const std::vector<double>& covariance, std::size_t n);

/// A^-1 S A^-1, the covariance of the solution of A x = b when b has covariance S; open unknowns get 0.
SymmetricMatrix sandwich(SymmetricMatrix a, const SymmetricMatrix& s);

}  // namespace lacquer::calib
