#pragma once

#include <array>
#include <string>
#include <vector>

#include "libbrdf/cook_torrance.h"

namespace lacquer::fit {

inline constexpr int max_lobes = 5;

/// What a model may consist of.
struct Structure {
  int n_lobes = 3;
  bool diffuse = true;
  std::array<bool, max_lobes> grey{};  ///< lobe's ks has one value for all channels
  std::array<brdf::Distribution, max_lobes> distribution{};
  std::array<brdf::Fresnel, max_lobes> fresnel{};

  bool operator==(const Structure&) const = default;
};

/// Where each parameter of the model sits in the solver's vector: kd per channel, ks per lobe and channel (one for a grey lobe), then
/// ln(m) and r per lobe. ln(m), because m spans three decades and a step of the solver is a relative one.
class ParameterLayout {
 public:
  /// `n_channels`: 1 or 3.
  ParameterLayout(int n_channels, const Structure& structure);
  ParameterLayout(int n_channels, int n_lobes) : ParameterLayout(n_channels, Structure{.n_lobes = n_lobes}) {}

  int n_channels() const { return n_channels_; }
  int n_lobes() const { return structure_.n_lobes; }
  const Structure& structure() const { return structure_; }
  int size() const { return size_; }

  int kd(int channel) const { return kd_[channel]; }  ///< -1: no diffuse part
  int ks(int lobe, int channel) const { return ks_[lobe][channel]; }
  int log_m(int lobe) const { return shapes_ + 2 * lobe; }
  int r(int lobe) const { return shapes_ + 2 * lobe + 1; }

  /// A one-channel layout takes the first channel, a grey lobe the mean of its channels.
  std::vector<double> pack(const brdf::CookTorrance& model) const;
  /// One channel becomes three equal ones.
  brdf::CookTorrance unpack(const std::vector<double>& x) const;

  /// Names for people, e.g. "kd.r", "ks2.b", "ks3" (grey), "m1", "r3".
  std::vector<std::string> names() const;
  std::vector<double> lower_bounds(double min_m) const;  ///< 0; ln(min_m) for ln(m)
  std::vector<double> upper_bounds() const;              ///< infinity for kd and ks, 0 for ln(m), 1 for r

  /// Bounds of a dielectric's r: outside the derivatives by r grow without limit, and no coat is there.
  static constexpr double min_dielectric_r = 1e-4, max_dielectric_r = 0.9;

 private:
  int n_channels_;
  Structure structure_;
  std::array<int, 3> kd_{};
  std::array<std::array<int, 3>, max_lobes> ks_{};
  int shapes_ = 0, size_ = 0;
};

/// The model with its lobes ordered by falling m.
brdf::CookTorrance sorted_by_falling_m(brdf::CookTorrance model);

}  // namespace lacquer::fit
