#include "libbrdf/table.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <numbers>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include "libbrdf/error.h"

namespace lacquer::brdf {

namespace {
constexpr double pi = std::numbers::pi;
constexpr double half_pi = pi / 2;

/// Continuous index of theta_h: cell i covers [i, i+1), its centre is i + 0.5.
double theta_h_coordinate(double theta_h) { return std::sqrt(std::max(theta_h, 0.0) / half_pi) * TableGrid::n_theta_h; }
}  // namespace

TableGrid::Cell TableGrid::cell(std::size_t index) {
  const auto i = static_cast<int>(index);
  return {i / (n_phi_d * n_theta_d), (i / n_phi_d) % n_theta_d, i % n_phi_d};
}

TableGrid::Cell TableGrid::cell(const HalfDiff& c) {
  assert(std::isfinite(c.theta_h) && std::isfinite(c.theta_d) && std::isfinite(c.phi_d));
  const auto clamped = [](double x, int n) { return std::clamp(static_cast<int>(x), 0, n - 1); };
  return {clamped(theta_h_coordinate(c.theta_h), n_theta_h), clamped(c.theta_d / half_pi * n_theta_d, n_theta_d),
          clamped(fold_phi_d(c.phi_d) / pi * n_phi_d, n_phi_d)};
}

double TableGrid::theta_h_edge(int i) {
  const double x = static_cast<double>(i) / n_theta_h;
  return x * x * half_pi;
}

HalfDiff TableGrid::centre(const Cell& c) {
  const double x = (c.theta_h + 0.5) / n_theta_h;
  return {x * x * half_pi, (c.theta_d + 0.5) / n_theta_d * half_pi, (c.phi_d + 0.5) / n_phi_d * pi};
}

bool TableGrid::reachable(const Cell& c, double min_cosine) {
  const auto cosines = half_angle_cosines(centre(c));
  return std::min(cosines.n_dot_i, cosines.n_dot_o) > min_cosine;
}

TableChannel::TableChannel()
    : mean(TableGrid::n_cells),
      variance(TableGrid::n_cells),
      count(TableGrid::n_cells),
      theta_h(TableGrid::n_cells),
      theta_d(TableGrid::n_cells),
      phi_d(TableGrid::n_cells),
      footprint_along(TableGrid::n_cells),
      footprint_across(TableGrid::n_cells),
      footprint_mixed(TableGrid::n_cells),
      origin(TableGrid::n_cells, CellOrigin::empty) {}

HalfAngleTable tabulate_brdf(const Brdf& brdf, double min_cosine) {
  HalfAngleTable table(3);
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, TableGrid::n_cells), [&](const auto& range) {
    for (std::size_t i = range.begin(); i != range.end(); ++i) {
      const HalfDiff centre = TableGrid::centre(i);
      const Directions d = directions(centre);
      if (std::min(d.wi.z, d.wo.z) <= min_cosine) continue;
      const auto f = brdf.value(d);
      if (!f) continue;
      for (std::size_t channel = 0; channel < 3; ++channel) {
        auto& t = table.channels[channel];
        t.mean[i] = static_cast<float>((*f)[static_cast<int>(channel)]);
        t.count[i] = 1;
        t.theta_h[i] = static_cast<float>(centre.theta_h);
        t.theta_d[i] = static_cast<float>(centre.theta_d);
        t.phi_d[i] = static_cast<float>(centre.phi_d);
        t.origin[i] = CellOrigin::measured;
      }
    }
  });
  return table;
}

TableBrdf::TableBrdf(HalfAngleTable table, std::string description, bool interpolate)
    : table_(std::move(table)), description_(std::move(description)), interpolate_(interpolate) {
  const std::size_t n = table_.channels.size();
  if (n != 1 && n != 3)
    throw Error(ErrorCode::input, description_ + ": expected a table of 1 or 3 channels, got " + std::to_string(n));
}

std::optional<glm::dvec3> TableBrdf::do_value(const Directions& d, const Footprint<double>& /*footprint*/) const {
  const HalfDiff c = half_diff(d);
  const std::size_t nearest = TableGrid::index(c);
  for (const TableChannel& channel : table_.channels)
    if (!has_value(channel.origin[nearest])) return std::nullopt;

  // The corners around the place, the same for all channels.
  std::array<std::size_t, 8> cells;
  std::array<double, 8> weights;
  int n = 0;
  if (interpolate_) {
    const double h = theta_h_coordinate(c.theta_h) - 0.5;
    const double t = c.theta_d / half_pi * TableGrid::n_theta_d - 0.5;
    const double p = fold_phi_d(c.phi_d) / pi * TableGrid::n_phi_d - 0.5;
    const int h0 = static_cast<int>(std::floor(h)), t0 = static_cast<int>(std::floor(t)), p0 = static_cast<int>(std::floor(p));
    for (int corner = 0; corner < 8; ++corner) {
      const int dh = corner & 1, dt = (corner >> 1) & 1, dp = corner >> 2;
      const double weight = (dh ? h - h0 : 1 - (h - h0)) * (dt ? t - t0 : 1 - (t - t0)) * (dp ? p - p0 : 1 - (p - p0));
      if (weight <= 0) continue;
      // theta beyond the first or last centre: constant; phi_d wraps by reciprocity.
      const int wrapped = p0 + dp < 0 ? TableGrid::n_phi_d - 1 : p0 + dp >= TableGrid::n_phi_d ? 0 : p0 + dp;
      weights[static_cast<std::size_t>(n)] = weight;
      cells[static_cast<std::size_t>(n++)] = TableGrid::index(TableGrid::Cell{std::clamp(h0 + dh, 0, TableGrid::n_theta_h - 1),
                                                                              std::clamp(t0 + dt, 0, TableGrid::n_theta_d - 1), wrapped});
    }
  }
  glm::dvec3 result(0.0);
  for (std::size_t channel = 0; channel < table_.channels.size(); ++channel) {
    const TableChannel& values = table_.channels[channel];
    double sum = 0, total = 0;
    for (std::size_t k = 0; k < static_cast<std::size_t>(n); ++k) {
      if (!has_value(values.origin[cells[k]])) continue;
      sum += weights[k] * values.mean[cells[k]];
      total += weights[k];
    }
    result[static_cast<int>(channel)] = total > 0 ? sum / total : values.mean[nearest];
  }
  if (table_.channels.size() == 1) result = glm::dvec3(result.x);
  return result;
}

}  // namespace lacquer::brdf
