#include "libfit/parameters.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>

namespace lacquer::fit {

ParameterLayout::ParameterLayout(int n_channels, const Structure& structure) : n_channels_(n_channels), structure_(structure) {
  int next = 0;
  for (int c = 0; c < n_channels; ++c) kd_[c] = structure.diffuse ? next++ : -1;
  for (int l = 0; l < structure.n_lobes; ++l) {
    for (int c = 0; c < n_channels; ++c) ks_[l][c] = structure.grey[l] ? next : next + c;
    next += structure.grey[l] ? 1 : n_channels;
  }
  shapes_ = next;
  size_ = next + 2 * structure.n_lobes;
}

std::vector<double> ParameterLayout::pack(const brdf::CookTorrance& model) const {
  std::vector<double> x(static_cast<std::size_t>(size()));
  for (int c = 0; c < n_channels_; ++c)
    if (kd(c) >= 0) x[kd(c)] = model.kd[c];
  for (int l = 0; l < n_lobes(); ++l) {
    const auto& lobe = model.lobes[static_cast<std::size_t>(l)];
    for (int c = 0; c < n_channels_; ++c) x[ks(l, c)] += structure_.grey[l] ? lobe.ks[c] / n_channels_ : lobe.ks[c];
    x[log_m(l)] = std::log(lobe.m);
    x[r(l)] = lobe.r;
  }
  return x;
}

brdf::CookTorrance ParameterLayout::unpack(const std::vector<double>& x) const {
  brdf::CookTorrance model;
  model.lobes.resize(static_cast<std::size_t>(n_lobes()));
  for (int c = 0; c < 3; ++c) {
    const int k = kd(std::min(c, n_channels_ - 1));
    model.kd[c] = k < 0 ? 0 : x[k];
  }
  for (int l = 0; l < n_lobes(); ++l) {
    auto& lobe = model.lobes[static_cast<std::size_t>(l)];
    for (int c = 0; c < 3; ++c) lobe.ks[c] = x[ks(l, std::min(c, n_channels_ - 1))];
    lobe.m = std::exp(x[log_m(l)]);
    lobe.r = x[r(l)];
    lobe.distribution = structure_.distribution[l];
    lobe.fresnel = structure_.fresnel[l];
  }
  return model;
}

std::vector<std::string> ParameterLayout::names() const {
  const std::string_view channel_names = n_channels_ == 1 ? "y" : "rgb";
  std::vector<std::string> names(static_cast<std::size_t>(size()));
  for (int c = 0; c < n_channels_; ++c) {
    const char channel = channel_names[static_cast<std::size_t>(c)];
    if (kd(c) >= 0) names[kd(c)] = fmt::format("kd.{}", channel);
    for (int l = 0; l < n_lobes(); ++l)
      names[ks(l, c)] = structure_.grey[l] ? fmt::format("ks{}", l + 1) : fmt::format("ks{}.{}", l + 1, channel);
  }
  for (int l = 0; l < n_lobes(); ++l) {
    names[log_m(l)] = fmt::format("m{}", l + 1);
    names[r(l)] = fmt::format("r{}", l + 1);
  }
  return names;
}

std::vector<double> ParameterLayout::lower_bounds(double min_m) const {
  std::vector<double> bounds(static_cast<std::size_t>(size()), 0.0);
  for (int l = 0; l < n_lobes(); ++l) {
    bounds[log_m(l)] = std::log(min_m);
    if (structure_.fresnel[l] == brdf::Fresnel::dielectric) bounds[r(l)] = min_dielectric_r;
  }
  return bounds;
}

std::vector<double> ParameterLayout::upper_bounds() const {
  std::vector<double> bounds(static_cast<std::size_t>(size()), std::numeric_limits<double>::infinity());
  for (int l = 0; l < n_lobes(); ++l) {
    bounds[log_m(l)] = 0;
    bounds[r(l)] = structure_.fresnel[l] == brdf::Fresnel::dielectric ? max_dielectric_r : 1;
  }
  return bounds;
}

brdf::CookTorrance sorted_by_falling_m(brdf::CookTorrance model) {
  std::stable_sort(model.lobes.begin(), model.lobes.end(),
                   [](const auto& a, const auto& b) { return a.m > b.m; });
  return model;
}

}  // namespace lacquer::fit
