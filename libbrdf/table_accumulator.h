#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "libbrdf/table.h"

namespace lacquer::brdf {

/// Sums over the samples of one cell; also those of one sample. A weight is proportional to the irradiance at the pixel (cosine included), so
/// that a cell's value is summed radiance over summed irradiance, which is unbiased whatever the noise. 48 bytes, because millions of cells
/// times three channels must fit into little memory: doubles for what a value is made of, floats for the rest (a variance of 10 000
/// samples is good to 1e-4, coordinates to a thousandth of the cell).
struct alignas(16) CellSums {
  double weight = 0, value = 0;              ///< of w, of w * f
  float variance = 0;                        ///< of w^2 * variance of f
  float theta_h = 0, theta_d = 0, phi_d = 0; ///< of w * (coordinate - cell's centre)
  /// Of w * footprint; `along` also of w * ((theta_h - cell's centre) dtan(theta_h)/dtheta_h)^2: samples spread over a cell blur it as a
  /// footprint does. Up to 20 deg of theta_h.
  float along = 0, across = 0, mixed = 0;
  std::uint32_t count : 31 = 0;
  std::uint32_t bounds : 1 = 0;              ///< of clipped samples; they give way to the first other one

  /// `s`: of values or of bounds, never of both.
  void add(const CellSums& s) {
    if (bounds != s.bounds) {
      if (s.count == 0 || (s.bounds && count > 0)) return;
      if (bounds) *this = {};
      bounds = s.bounds;
    }
    weight += s.weight;
    value += s.value;
    variance += s.variance;
    theta_h += s.theta_h;
    theta_d += s.theta_d;
    phi_d += s.phi_d;
    along += s.along;
    across += s.across;
    mixed += s.mixed;
    count = (count + s.count) & 0x7fffffffu;
  }

  /// The same for one value, in two additions. `sums`: weight and value as above; `others`: variance to mixed as above, then the bits of the integer 1.
  void add_value(const float (&sums)[2], const float (&others)[8]) {
    typedef double Double2 __attribute__((vector_size(16)));
    typedef float Float2 __attribute__((vector_size(8)));
    typedef float Float8 __attribute__((vector_size(32)));
    typedef std::uint32_t UInt32x8 __attribute__((vector_size(32)));
    if (bounds) *this = {};
    Float2 own;
    Double2 in_double;
    Float8 floats, more;  // the last one of each is a count
    std::memcpy(&own, sums, sizeof own);
    std::memcpy(&more, others, sizeof more);
    std::memcpy(&in_double, &weight, sizeof in_double);
    std::memcpy(&floats, &variance, sizeof floats);
    in_double += __builtin_convertvector(own, Double2);
    floats = __builtin_shufflevector(floats + more, (Float8)((UInt32x8)floats + (UInt32x8)more), 0, 1, 2, 3, 4, 5, 6, 15);
    std::memcpy(&weight, &in_double, sizeof in_double);
    std::memcpy(&variance, &floats, sizeof floats);
  }
};
static_assert(sizeof(CellSums) == 48);

/// Numbers the cells that two directions above the horizon can reach, about four fifths of the grid.
class ReachableCells {
 public:
  ReachableCells();
  std::uint32_t size() const { return size_; }
  /// `row`: theta_h * n_theta_d + theta_d. The cell must be reachable.
  std::uint32_t slot(int row, int phi_d) const { return offset_[static_cast<std::size_t>(row)] + static_cast<std::uint32_t>(phi_d); }
  bool contains(int row, int phi_d) const {
    return phi_d >= first_[static_cast<std::size_t>(row)] && phi_d < TableGrid::n_phi_d - first_[static_cast<std::size_t>(row)];
  }
  /// (d tan(theta_h) / d theta_h)^2 at the centre of a theta_h row; 0 beyond 20 deg.
  float squared_slope(int theta_h) const { return squared_slope_[static_cast<std::size_t>(theta_h)]; }
  int first_phi_d(int row) const { return first_[static_cast<std::size_t>(row)]; }  ///< the last one lies as far from the other end

 private:
  static constexpr std::size_t n_rows = std::size_t{TableGrid::n_theta_h} * TableGrid::n_theta_d;
  std::array<std::uint32_t, n_rows> offset_;  ///< modulo 2^32, of phi_d = 0
  std::array<std::uint8_t, n_rows> first_;
  std::array<float, TableGrid::n_theta_h> squared_slope_;
  std::uint32_t size_ = 0;
};
const ReachableCells& reachable_cells();

/// Collects samples in the cells of a table, for one thread at a time; the sums depend on the order of the samples alone.
class TableAccumulator {
 public:
  explicit TableAccumulator(std::size_t n_channels);

  /// One measurement of f_r with its variance, (1/sr)^2. Throws Error{input} where a direction would be below the horizon.
  void add(std::size_t channel, const HalfDiff& c, double value, double variance, double weight, const Footprint<double>& footprint = {});
  /// One clipped measurement: f_r is at least `bound`, whose noise has `variance`. See TableChannel.
  void add_bound(std::size_t channel, const HalfDiff& c, double bound, double variance, double weight, const Footprint<double>& footprint = {});

  /// By slot of reachable_cells(); one more, for what belongs nowhere.
  CellSums* cells(std::size_t channel) { return channels_[channel].get(); }

  /// The table; the accumulator is empty afterwards, because both at once would be large. Mirror symmetry f(phi_d) = f(pi - phi_d): with
  /// `symmetrise`, empty cells take the mirror cell's value, flagged `symmetric`.
  HalfAngleTable table(bool symmetrise);

 private:
  struct Unmap {
    std::size_t bytes;
    void operator()(CellSums* p) const;
  };
  CellSums& at(std::size_t channel, const TableGrid::Cell& cell);
  std::vector<std::unique_ptr<CellSums[], Unmap>> channels_;
};

}  // namespace lacquer::brdf
