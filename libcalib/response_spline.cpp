#include <algorithm>
#include <cmath>

#include "libcalib/response_channel.h"

namespace lacquer::calib {

namespace {

constexpr double knots_per_root = 32, knots_per_log = 6;

}  // namespace

ResponseSpline::ResponseSpline(int bits, double black_level) {
  const double top = std::exp2(bits) - 1;
  s_low_ = std::log(std::floor(black_level) + 1 - black_level);
  s_high_ = std::log(top - black_level);
  per_root_ = knots_per_root;
  per_log_ = knots_per_log;
  n_intervals_ = static_cast<int>(std::ceil(coordinate(s_high_)));
  // The last knot lies at the top value.
  const double stretch = n_intervals_ / coordinate(s_high_);
  per_root_ *= stretch;
  per_log_ *= stretch;
}

double ResponseSpline::coordinate(double s) const {
  return 2 * per_root_ * (std::exp((s - s_high_) / 2) - std::exp((s_low_ - s_high_) / 2)) + per_log_ * (s - s_low_);
}

double ResponseSpline::log_signal(double c) const {
  double low = s_low_, high = s_high_;
  for (int i = 0; i < 60 && high - low > 1e-12; ++i) {
    const double middle = (low + high) / 2;
    (coordinate(middle) < c ? low : high) = middle;
  }
  return (low + high) / 2;
}

ResponseSpline::Basis ResponseSpline::basis(double c) const {
  const double bounded = std::clamp(c, 0.0, static_cast<double>(n_intervals_));
  const int interval = std::min(static_cast<int>(bounded), n_intervals_ - 1);
  const double u = bounded - interval, w = 1 - u;
  return {static_cast<std::size_t>(interval),
          {w * w * w / 6, (3 * u * u * u - 6 * u * u + 4) / 6, (3 * w * w * w - 6 * w * w + 4) / 6, u * u * u / 6}};
}

ResponseSpline::Basis ResponseSpline::second_derivative(double c) const {
  const Basis value = basis(c);
  const double u = std::clamp(c, 0.0, static_cast<double>(n_intervals_)) - static_cast<double>(value.first), w = 1 - u;
  const double root = per_root_ * std::exp((log_signal(c) - s_high_) / 2);
  const double c_s = root + per_log_, c_ss = root / 2;
  const std::array<double, 4> first{-w * w / 2, (3 * u * u - 4 * u) / 2, (-3 * w * w + 4 * w) / 2, u * u / 2};
  const std::array<double, 4> second{w, 3 * u - 2, 3 * w - 2, u};
  Basis result{value.first, {}};
  for (std::size_t k = 0; k < 4; ++k) result.weight[k] = second[k] * c_s * c_s + first[k] * c_ss;
  return result;
}

}  // namespace lacquer::calib
