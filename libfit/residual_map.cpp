#include "libfit/residual_map.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace lacquer::fit {

ResidualMap residual_map(const brdf::HalfAngleTable& table, const brdf::CookTorrance& model, double min_cosine) {
  using brdf::TableGrid;
  constexpr std::size_t n_groups = std::size_t{TableGrid::n_theta_h} * TableGrid::n_theta_d;
  ResidualMap map{std::vector<double>(n_groups), std::vector<double>(n_groups), std::vector<std::uint32_t>(n_groups)};
  tbb::parallel_for(std::size_t{0}, n_groups, [&](std::size_t group) {
    double sum = 0, squares = 0;
    std::uint32_t n = 0;
    for (std::size_t i = group * TableGrid::n_phi_d; i < (group + 1) * TableGrid::n_phi_d; ++i)
      for (std::size_t c = 0; c < table.channels.size(); ++c) {
        const brdf::TableChannel& t = table.channels[c];
        if (t.origin[i] != brdf::CellOrigin::measured || !(t.mean[i] > 0)) continue;
        auto cosines = brdf::half_angle_cosines(brdf::HalfDiff{t.theta_h[i], t.theta_d[i], t.phi_d[i]});
        if (!(std::min(cosines.n_dot_i, cosines.n_dot_o) > min_cosine)) continue;
        cosines.footprint = {t.footprint_along[i], t.footprint_across[i], t.footprint_mixed[i]};
        const double difference = model.log_value(cosines)[static_cast<int>(c)] - std::log(double{t.mean[i]});
        if (!std::isfinite(difference)) continue;
        sum += difference;
        squares += difference * difference;
        ++n;
      }
    map.n[group] = n;
    if (n == 0) return;
    map.mean_log[group] = sum / n;
    map.rms_log[group] = std::sqrt(squares / n);
  });
  return map;
}

}  // namespace lacquer::fit
