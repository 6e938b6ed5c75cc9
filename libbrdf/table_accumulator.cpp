#include "libbrdf/table_accumulator.h"

#include <sys/mman.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <new>
#include <numbers>

#include "libbrdf/error.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;

/// phi_d as stored: [0, pi) also after rounding to float, whose nearest value to pi lies above pi.
float stored_phi_d(double phi_d) {
  static const float largest = std::nextafter(static_cast<float>(pi), 0.0f);
  return std::clamp(static_cast<float>(phi_d), 0.0f, largest);
}

void set_cell(TableChannel& t, std::size_t i, const CellSums& s) {
  const HalfDiff centre = TableGrid::centre(i);
  t.mean[i] = static_cast<float>(s.value / s.weight);
  t.variance[i] = static_cast<float>(s.variance / (s.weight * s.weight));
  t.count[i] = s.count;
  t.theta_h[i] = static_cast<float>(centre.theta_h + s.theta_h / s.weight);
  t.theta_d[i] = static_cast<float>(centre.theta_d + s.theta_d / s.weight);
  t.phi_d[i] = stored_phi_d(centre.phi_d + s.phi_d / s.weight);
  // The spread about the samples' mean, not about the centre.
  const double mean = s.theta_h / s.weight, squared_slope = reachable_cells().squared_slope(TableGrid::cell(i).theta_h);
  t.footprint_along[i] = static_cast<float>(std::max(0.0, s.along / s.weight - squared_slope * mean * mean));
  t.footprint_across[i] = static_cast<float>(s.across / s.weight);
  t.footprint_mixed[i] = static_cast<float>(s.mixed / s.weight);
  t.origin[i] = s.bounds ? CellOrigin::clipped : CellOrigin::measured;
}

void fill_from_mirror_cells(TableChannel& t) {
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    if (t.origin[i] != CellOrigin::empty) continue;
    const std::size_t j = TableGrid::mirror(i);
    if (t.origin[j] != CellOrigin::measured) continue;
    t.mean[i] = t.mean[j];
    t.variance[i] = t.variance[j];
    t.count[i] = t.count[j];
    t.theta_h[i] = t.theta_h[j];
    t.theta_d[i] = t.theta_d[j];
    t.footprint_along[i] = t.footprint_along[j];
    t.footprint_across[i] = t.footprint_across[j];
    t.footprint_mixed[i] = -t.footprint_mixed[j];  // the mirror turns the axis across round
    t.phi_d[i] = stored_phi_d(pi - static_cast<double>(t.phi_d[j]));
    t.origin[i] = CellOrigin::symmetric;
  }
}

CellSums sums_of(const TableGrid::Cell& cell, const HalfDiff& c, double value, double variance, double weight, const Footprint<double>& footprint) {
  assert(weight > 0 && std::isfinite(value) && variance >= 0);
  const HalfDiff centre = TableGrid::centre(cell);
  CellSums s;
  s.weight = weight;
  s.value = weight * value;
  s.variance = static_cast<float>(weight * weight * variance);
  s.theta_h = static_cast<float>(weight * (c.theta_h - centre.theta_h));
  s.theta_d = static_cast<float>(weight * (c.theta_d - centre.theta_d));
  s.phi_d = static_cast<float>(weight * (fold_phi_d(c.phi_d) - centre.phi_d));
  const double offset = c.theta_h - centre.theta_h;
  s.along = static_cast<float>(weight * (footprint.along + reachable_cells().squared_slope(cell.theta_h) * offset * offset));
  s.across = static_cast<float>(weight * footprint.across);
  s.mixed = static_cast<float>(weight * footprint.mixed);
  s.count = 1;
  return s;
}

}  // namespace

ReachableCells::ReachableCells() {
  // Both cosines are positive where |cos(phi_d)| < cot(theta_h) cot(theta_d), most where both angles are smallest; one cell to spare.
  for (int h = 0; h < TableGrid::n_theta_h; ++h) {
    // Further out only broad lobes are left, which a cell does not widen, and the slope bends within it.
    const double theta_h = TableGrid::centre(TableGrid::Cell{h, 0, 0}).theta_h;
    squared_slope_[static_cast<std::size_t>(h)] = theta_h < pi / 9 ? static_cast<float>(std::pow(std::cos(theta_h), -4)) : 0.0f;
    for (int d = 0; d < TableGrid::n_theta_d; ++d) {
      const double tangents = std::tan(TableGrid::theta_h_edge(h)) * std::tan(d * pi / 2 / TableGrid::n_theta_d);
      const double phi = tangents > 1 ? std::acos(1 / tangents) : 0.0;
      const int first = std::max(0, static_cast<int>(phi / pi * TableGrid::n_phi_d) - 1);
      const auto row = static_cast<std::size_t>(h * TableGrid::n_theta_d + d);
      first_[row] = static_cast<std::uint8_t>(first);
      offset_[row] = size_ - static_cast<std::uint32_t>(first);
      size_ += static_cast<std::uint32_t>(TableGrid::n_phi_d - 2 * first);
    }
  }
}

const ReachableCells& reachable_cells() {
  static const ReachableCells cells;
  return cells;
}

TableAccumulator::TableAccumulator(std::size_t n_channels) {
  // In large pages where the system has them, and each written to: otherwise every page costs a fault when it is first read and another one,
  // at which all processors stop for a moment, when it is first written. Pages from the system are zero: so are the sums.
  constexpr std::size_t large_page = std::size_t{2} << 20, page = 4096;
  const std::size_t bytes = (reachable_cells().size() + 1) * sizeof(CellSums);
  for (std::size_t c = 0; c < n_channels; ++c) {
    void* const mapped = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (mapped == MAP_FAILED) throw std::bad_alloc();
    channels_.emplace_back(static_cast<CellSums*>(mapped), Unmap{bytes});
#ifdef __linux__
    madvise(mapped, bytes, MADV_HUGEPAGE);
#endif
    auto* const memory = static_cast<volatile char*>(mapped);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, (bytes + large_page - 1) / large_page), [&](const auto& range) {
      for (std::size_t i = range.begin() * large_page; i < std::min(bytes, range.end() * large_page); i += page) memory[i] = 0;
    });
  }
}

void TableAccumulator::Unmap::operator()(CellSums* p) const { munmap(p, bytes); }

CellSums& TableAccumulator::at(std::size_t channel, const TableGrid::Cell& cell) {
  const int row = cell.theta_h * TableGrid::n_theta_d + cell.theta_d;
  if (!reachable_cells().contains(row, cell.phi_d)) throw Error(ErrorCode::input, "sample: expected light and camera above the horizon");
  return channels_[channel][reachable_cells().slot(row, cell.phi_d)];
}

void TableAccumulator::add(std::size_t channel, const HalfDiff& c, double value, double variance, double weight,
                           const Footprint<double>& footprint) {
  const TableGrid::Cell cell = TableGrid::cell(c);
  at(channel, cell).add(sums_of(cell, c, value, variance, weight, footprint));
}

void TableAccumulator::add_bound(std::size_t channel, const HalfDiff& c, double bound, double variance, double weight,
                                 const Footprint<double>& footprint) {
  const TableGrid::Cell cell = TableGrid::cell(c);
  CellSums s = sums_of(cell, c, bound, variance, weight, footprint);
  s.bounds = 1;
  at(channel, cell).add(s);
}

HalfAngleTable TableAccumulator::table(bool symmetrise) {
  HalfAngleTable table(0);
  table.channels.reserve(channels_.size());
  for (auto& sums : channels_) {
    TableChannel& t = table.channels.emplace_back();
    for (int row = 0; row < TableGrid::n_theta_h * TableGrid::n_theta_d; ++row) {
      const int first = reachable_cells().first_phi_d(row);
      for (int p = first; p < TableGrid::n_phi_d - first; ++p)
        if (const CellSums& s = sums[reachable_cells().slot(row, p)]; s.count > 0)
          set_cell(t, static_cast<std::size_t>(row) * TableGrid::n_phi_d + static_cast<std::size_t>(p), s);
    }
    sums.reset();
    if (symmetrise) fill_from_mirror_cells(t);
  }
  channels_.clear();
  return table;
}

}  // namespace lacquer::brdf
