#pragma once

#include <algorithm>
#include <cmath>
#include <glm/vec3.hpp>
#include <numbers>
#include <vector>

#include "libbrdf/directions.h"

namespace lacquer::brdf {

/// G / ((n.wi)(n.wo)), the geometric attenuation of Cook and Torrance 1982 with the two cosines divided out, which is finite
/// as long as one direction is above the horizon. `T`: float or double.
template <typename T>
T geometry_over_cosines(const HalfAngleCosines<T>& c) {
  // G = min(1, 2 (n.h)(n.wo)/(wo.h), 2 (n.h)(n.wi)/(wo.h)); dividing each branch by hand avoids 0/0 at grazing.
  const T unshadowed = T(1) / (c.n_dot_i * c.n_dot_o);
  const T shadowed = T(2) * c.n_dot_h / (c.i_dot_h * std::max(c.n_dot_i, c.n_dot_o));
  return std::min(unshadowed, shadowed);
}

/// Schlick's Fresnel weight (1 - cos(theta_d))^5: F = r + (1 - r) * weight.
template <typename T>
T schlick_weight(T i_dot_h) {
  const T x = T(1) - i_dot_h;
  const T x2 = x * x;
  return x2 * x2 * x;
}

/// One Beckmann Cook-Torrance lobe as in Günther et al. 2005, Eq. 1, for ks = 1:
///   f = F(r) D(m) G / (pi (n.wi)(n.wo)),  D = exp(-tan^2(theta_h)/m^2) / (m^2 cos^4(theta_h))
/// in 1/sr, without the cosine; note D without 1/pi and 1/4 and ks/pi in front.
/// A footprint V widens the lobe: exp(-s^2/m^2)/m^2 over slopes s, convolved with a Gaussian of covariance V, is
/// exp(-s^T M^-1 s)/sqrt(det M) with M = m^2 + 2 V, energy unchanged; F and G vary too slowly to matter.
/// `P` (parameters): float, double or an automatic-differentiation scalar; the cosines stay float or double.
template <typename P>
struct CookTorranceLobe {
  P m;  ///< RMS slope of the microfacets, (0, 1]
  P r;  ///< Schlick reflectance at normal incidence, [0, 1]

  /// Lobe value in 1/sr. Underflows to 0 far from the peak of a narrow lobe: use log_value where its logarithm is wanted.
  template <typename T>
  P operator()(const HalfAngleCosines<T>& c) const {
    using std::exp, std::sqrt;
    const T inverse_nh2 = T(1) / (c.n_dot_h * c.n_dot_h);
    const P across = m * m + T(2) * c.footprint.across;
    const P inverse_det = T(1) / determinant(c.footprint);
    // One factor after the other: cos^4 would underflow at grazing in float and make 0 / 0.
    const P distribution = exp(-c.tan2_theta_h * (across * inverse_det)) * sqrt(inverse_det) * inverse_nh2 * inverse_nh2;
    return fresnel(c) * distribution * (geometry_over_cosines(c) * std::numbers::inv_pi_v<T>);
  }

  /// Natural logarithm of operator(), finite also where exp underflows; -inf for r = 0 at normal incidence.
  template <typename T>
  P log_value(const HalfAngleCosines<T>& c) const {
    using std::log;
    const P across = m * m + T(2) * c.footprint.across;
    const P det = determinant(c.footprint);
    return log(fresnel(c)) - c.tan2_theta_h * across / det - log(det) / T(2) +
           (log(geometry_over_cosines(c)) - T(4) * log(c.n_dot_h) - log(std::numbers::pi_v<T>));
  }

 private:
  /// det M of a footprint.
  template <typename T>
  P determinant(const Footprint<T>& v) const {
    const P m2 = m * m;
    return (m2 + T(2) * v.along) * (m2 + T(2) * v.across) + T(-4) * v.mixed * v.mixed;
  }
  template <typename T>
  P fresnel(const HalfAngleCosines<T>& c) const {
    const T weight = schlick_weight(c.i_dot_h);
    return r * (T(1) - weight) + weight;
  }
};

/// Multi-lobe Cook-Torrance model of Günther et al. 2005, Eq. 1: f = kd/pi + sum_i ks_i * lobe_i, in 1/sr.
/// ks and kd are colours (R, G, B, >= 0), m and r are shared by the channels.
struct CookTorrance {
  struct Lobe {
    glm::dvec3 ks{0.0};
    double m = 0.1;  ///< (0, 1]
    double r = 0.5;  ///< [0, 1]
  };
  glm::dvec3 kd{0.0};
  std::vector<Lobe> lobes;

  /// f_r in 1/sr; both cosines must be > 0.
  glm::dvec3 value(const HalfAngleCosines<double>& c) const;
  glm::vec3 value(const HalfAngleCosines<float>& c) const;

  /// log(f_r) by a log-sum over the lobes, finite where every exp underflows and kd = 0; -inf where f_r is exactly 0.
  glm::dvec3 log_value(const HalfAngleCosines<double>& c) const;
};

}  // namespace lacquer::brdf
