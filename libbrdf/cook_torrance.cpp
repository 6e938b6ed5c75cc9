#include "libbrdf/cook_torrance.h"

#include <limits>

namespace lacquer::brdf {

namespace {

template <typename T>
glm::vec<3, T> sum_of_lobes(const CookTorrance& model, const HalfAngleCosines<T>& c) {
  glm::vec<3, T> f = glm::vec<3, T>(model.kd) * std::numbers::inv_pi_v<T>;
  for (const auto& lobe : model.lobes) {
    const CookTorranceLobe<T> shape{static_cast<T>(lobe.m), static_cast<T>(lobe.r), lobe.distribution, lobe.fresnel};
    f += glm::vec<3, T>(lobe.ks) * shape(c);
  }
  return f;
}

}  // namespace

glm::dvec3 CookTorrance::value(const HalfAngleCosines<double>& c) const { return sum_of_lobes(*this, c); }

glm::vec3 CookTorrance::value(const HalfAngleCosines<float>& c) const { return sum_of_lobes(*this, c); }

glm::dvec3 CookTorrance::log_value(const HalfAngleCosines<double>& c) const {
  // Running log-sum-exp: f = exp(peak) * sum, where `peak` is the largest logarithm met so far.
  constexpr double minus_infinity = -std::numeric_limits<double>::infinity();
  glm::dvec3 peak(minus_infinity), sum(0.0);
  const auto add = [&](int channel, double log_term) {
    if (log_term == minus_infinity) return;
    double& p = peak[channel];
    double& s = sum[channel];
    if (log_term > p) {
      s = s * std::exp(p - log_term) + 1;
      p = log_term;
    } else {
      s += std::exp(log_term - p);
    }
  };
  for (int channel = 0; channel < 3; ++channel) add(channel, std::log(kd[channel] * std::numbers::inv_pi));
  for (const auto& lobe : lobes) {
    const double log_lobe = lobe.shape().log_value(c);
    for (int channel = 0; channel < 3; ++channel) add(channel, std::log(lobe.ks[channel]) + log_lobe);
  }
  return peak + glm::dvec3(std::log(sum.x), std::log(sum.y), std::log(sum.z));
}

}  // namespace lacquer::brdf
