#pragma once

#include <string>
#include <vector>

#include "libbrdf/cook_torrance.h"

namespace lacquer::fit {

/// Where each parameter of the model sits in the solver's vector: kd per channel, ks per lobe and channel,
/// then ln(m) and r per lobe. ln(m), because m spans three decades and a step of the solver is a relative
/// one.
struct ParameterLayout {
  int n_channels = 3;  ///< 1 or 3
  int n_lobes = 3;

  int kd(int channel) const { return channel; }
  int ks(int lobe, int channel) const { return n_channels * (1 + lobe) + channel; }
  int log_m(int lobe) const { return n_channels * (1 + n_lobes) + 2 * lobe; }
  int r(int lobe) const { return log_m(lobe) + 1; }
  int size() const { return n_channels * (1 + n_lobes) + 2 * n_lobes; }

  /// A one-channel layout takes the first channel.
  std::vector<double> pack(const brdf::CookTorrance& model) const;
  /// One channel becomes three equal ones.
  brdf::CookTorrance unpack(const std::vector<double>& x) const;

  /// Names for people, e.g. "kd.r", "ks2.b", "m1", "r3".
  std::vector<std::string> names() const;
  std::vector<double> lower_bounds(double min_m) const;  ///< 0; ln(min_m) for ln(m)
  std::vector<double> upper_bounds() const;              ///< infinity for kd and ks, 0 for ln(m), 1 for r
};

/// The model with its lobes ordered by falling m.
brdf::CookTorrance sorted_by_falling_m(brdf::CookTorrance model);

}  // namespace lacquer::fit
