#include "libbrdf/cook_torrance.h"

#include <limits>

namespace lacquer::brdf {

namespace {

template <typename T>
glm::vec<3, T> sum_of_lobes(const CookTorrance& model, const HalfAngleCosines<T>& c) {
  glm::vec<3, T> f = glm::vec<3, T>(model.kd) * std::numbers::inv_pi_v<T>;
  for (const auto& lobe : model.lobes) {
    const CookTorranceLobe<T> shape{static_cast<T>(lobe.m), static_cast<T>(lobe.r)};
    f += glm::vec<3, T>(lobe.ks) * shape(c);
  }
  return f;
}

}  // namespace

glm::dvec3 CookTorrance::value(const HalfAngleCosines<double>& c) const { return sum_of_lobes(*this, c); }

glm::vec3 CookTorrance::value(const HalfAngleCosines<float>& c) const { return sum_of_lobes(*this, c); }

glm::dvec3 CookTorrance::log_value(const HalfAngleCosines<double>& c) const {
  std::vector<double> log_lobes;
  log_lobes.reserve(lobes.size());
  for (const auto& lobe : lobes) log_lobes.push_back(CookTorranceLobe<double>{lobe.m, lobe.r}.log_value(c));

  glm::dvec3 result;
  for (int channel = 0; channel < 3; ++channel) {
    const double log_diffuse = std::log(kd[channel] * std::numbers::inv_pi);
    double peak = log_diffuse;
    for (std::size_t i = 0; i < lobes.size(); ++i)
      peak = std::max(peak, std::log(lobes[i].ks[channel]) + log_lobes[i]);
    if (!(peak > -std::numeric_limits<double>::infinity())) {
      result[channel] = peak;
      continue;
    }
    double sum = std::exp(log_diffuse - peak);
    for (std::size_t i = 0; i < lobes.size(); ++i)
      sum += std::exp(std::log(lobes[i].ks[channel]) + log_lobes[i] - peak);
    result[channel] = peak + std::log(sum);
  }
  return result;
}

}  // namespace lacquer::brdf
