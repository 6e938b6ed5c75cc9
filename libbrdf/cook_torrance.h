#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
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

/// Unpolarised reflectance of a dielectric whose reflectance at normal incidence is r, exactly (Fresnel; the form of Cook and Torrance
/// 1982, Appendix). r in [0, 0.99], `i_dot_h`: cos(theta_d).
template <typename P, typename T>
P dielectric_reflectance(const P& r, T i_dot_h) {
  using std::sqrt;
  const P root = sqrt(r), index = (P(1) + root) / (P(1) - root);
  const P g = sqrt(index * index - P(T(1) - i_dot_h * i_dot_h));
  const P difference = g - i_dot_h, sum = g + i_dot_h;
  const P parallel = (i_dot_h * sum - P(1)) / (i_dot_h * difference + P(1)), across = difference / sum;
  return across * across * (P(1) + parallel * parallel) / P(2);
}

/// Distribution of the microfacets' slopes s: beckmann: exp(-s^2/m^2); ggx: 1/(1 + s^2/m^2)^2, with wide tails (Walter et al. 2007).
enum class Distribution : std::uint8_t { beckmann, ggx };

/// Reflectance of a microfacet: schlick: r + (1 - r)(1 - cos(theta_d))^5; dielectric: dielectric_reflectance, as of a clear coat.
enum class Fresnel : std::uint8_t { schlick, dielectric };

/// One Cook-Torrance lobe as in Günther et al. 2005, Eq. 1, for ks = 1:
///   f = F(r) D(m) G / (pi (n.wi)(n.wo)),  D = exp(-tan^2(theta_h)/m^2) / (m^2 cos^4(theta_h))
/// in 1/sr, without the cosine; note D without 1/pi and 1/4 and ks/pi in front. GGX has 1/(1 + tan^2(theta_h)/m^2)^2 for the exponential.
/// A footprint V widens the lobe: exp(-s^2/m^2)/m^2 over slopes s, convolved with a Gaussian of covariance V, is
/// exp(-s^T M^-1 s)/sqrt(det M) with M = m^2 + 2 V, energy unchanged; F and G vary too slowly to matter. For GGX, whose convolution has no
/// closed form, M = m^2 + 4 V, right at the peak to first order in V / m^2.
/// `P` (parameters): float, double or an automatic-differentiation scalar; the cosines stay float or double.
template <typename P>
struct CookTorranceLobe {
  P m;  ///< RMS slope of the microfacets, (0, 1]; of GGX, which has no RMS, the width
  P r;  ///< reflectance at normal incidence, [0, 1]; dielectric: [0, 0.99]
  Distribution distribution = Distribution::beckmann;
  Fresnel fresnel = Fresnel::schlick;

  /// Lobe value in 1/sr. Underflows to 0 far from the peak of a narrow lobe: use log_value where its logarithm is wanted.
  template <typename T>
  P operator()(const HalfAngleCosines<T>& c) const {
    using std::exp, std::sqrt;
    const T inverse_nh2 = T(1) / (c.n_dot_h * c.n_dot_h);
    const P across = m * m + spread<T>() * c.footprint.across;
    const P inverse_det = T(1) / determinant(c.footprint);
    const P q = c.tan2_theta_h * (across * inverse_det);
    const P slopes = distribution == Distribution::beckmann ? exp(-q) : T(1) / ((T(1) + q) * (T(1) + q));
    // One factor after the other: cos^4 would underflow at grazing in float and make 0 / 0.
    return reflectance(c) * (slopes * sqrt(inverse_det) * inverse_nh2 * inverse_nh2) * (geometry_over_cosines(c) * std::numbers::inv_pi_v<T>);
  }

  /// Natural logarithm of operator(), finite also where exp underflows; -inf for r = 0 at normal incidence.
  template <typename T>
  P log_value(const HalfAngleCosines<T>& c) const {
    using std::log, std::log1p;
    const P across = m * m + spread<T>() * c.footprint.across;
    const P det = determinant(c.footprint);
    const P q = c.tan2_theta_h * across / det;
    const P log_slopes = distribution == Distribution::beckmann ? -q : T(-2) * log1p(q);
    return log(reflectance(c)) + log_slopes - log(det) / T(2) +
           (log(geometry_over_cosines(c)) - T(4) * log(c.n_dot_h) - log(std::numbers::pi_v<T>));
  }

 private:
  /// What a footprint counts in M.
  template <typename T>
  T spread() const {
    return distribution == Distribution::beckmann ? T(2) : T(4);
  }
  /// det M of a footprint.
  template <typename T>
  P determinant(const Footprint<T>& v) const {
    const P m2 = m * m;
    const T k = spread<T>();
    return (m2 + k * v.along) * (m2 + k * v.across) - k * k * v.mixed * v.mixed;
  }
  template <typename T>
  P reflectance(const HalfAngleCosines<T>& c) const {
    if (fresnel == Fresnel::dielectric) return dielectric_reflectance(r, c.i_dot_h);
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
    Distribution distribution = Distribution::beckmann;
    Fresnel fresnel = Fresnel::schlick;

    CookTorranceLobe<double> shape() const { return {m, r, distribution, fresnel}; }
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
