#include "libcalib/dark_line.h"

#include <algorithm>
#include <cmath>

namespace lacquer::calib {

DarkLine fit_dark_line(const std::vector<DarkMean>& means) {
  DarkLine line;
  if (means.empty()) return line;
  double w = 0, wt = 0;
  for (const DarkMean& m : means) w += 1 / m.variance, wt += m.exposure_s / m.variance;
  const double t_mean = wt / w;
  double level = 0, spread = 0, slope = 0;
  for (const DarkMean& m : means) {
    const double t = m.exposure_s - t_mean;
    level += m.mean / m.variance;
    spread += t * t / m.variance;
    slope += t * m.mean / m.variance;
  }
  level /= w;
  const auto [low, high] =
      std::minmax_element(means.begin(), means.end(), [](const DarkMean& a, const DarkMean& b) { return a.exposure_s < b.exposure_s; });
  const bool has_rate = high->exposure_s > low->exposure_s;
  const double rate = has_rate ? slope / spread : 0;
  for (const DarkMean& m : means) {
    const double residual = m.mean - level - rate * (m.exposure_s - t_mean);
    line.chi_square += residual * residual / m.variance;
  }
  line.degrees_of_freedom = static_cast<int>(means.size()) - (has_rate ? 2 : 1);
  const double dof = line.degrees_of_freedom;
  // 3.5 sigma of chi^2: by chance once in some thousand measurements.
  const double widened = dof > 0 && line.chi_square > dof + 3.5 * std::sqrt(2 * dof) ? line.chi_square / dof : 1;
  const double rate_variance = has_rate ? widened / spread : 0;
  const double t0 = has_rate ? t_mean : 0;  // one exposure time: the mean there, since nothing leads to t = 0
  line.base = {level - rate * t0, std::sqrt(widened / w + t0 * t0 * rate_variance)};
  if (has_rate) line.rate = Measured{rate, std::sqrt(rate_variance)};
  return line;
}

}  // namespace lacquer::calib
