#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
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

  /// The same for one value, eight numbers at a time. `value`: weight, value and variance as above and anything; `others`: any float, then theta_h
  /// to mixed as above, then 0.
  void add_value(const float* value, const float* others) {
    typedef double Double2 __attribute__((vector_size(16)));
    typedef double Double4 __attribute__((vector_size(32)));
    typedef float Float4 __attribute__((vector_size(16)));
    typedef float Float8 __attribute__((vector_size(32)));
    typedef std::int32_t Int32x8 __attribute__((vector_size(32)));
    if (bounds) *this = {};
    Double2 sums;
    Float8 floats, more;  // the last one of `floats` is the count
    std::memcpy(&sums, &weight, sizeof sums);
    std::memcpy(&floats, &variance, sizeof floats);
    std::memcpy(&more, others, sizeof more);
    Float4 own;
    std::memcpy(&own, value, sizeof own);
    const float x = value[2];
    const Int32x8 first{-1}, all_but_count{-1, -1, -1, -1, -1, -1, -1, 0};
    more = first ? Float8{x, x, x, x, x, x, x, x} : more;
    const Double4 in_double = __builtin_convertvector(own, Double4);
    sums += __builtin_shufflevector(in_double, in_double, 0, 1);
    const Int32x8 counted = (Int32x8)floats + 1;
    const Float8 added = (Float8)((Int32x8)floats & all_but_count) + more;
    const Float8 both = __builtin_shufflevector(added, (Float8)counted, 0, 1, 2, 3, 4, 5, 6, 15);
    std::memcpy(&weight, &sums, sizeof sums);
    std::memcpy(&variance, &both, sizeof both);
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
  struct Free {
    void operator()(CellSums* p) const { std::free(p); }
  };
  CellSums& at(std::size_t channel, const TableGrid::Cell& cell);
  std::vector<std::unique_ptr<CellSums[], Free>> channels_;
};

}  // namespace lacquer::brdf
