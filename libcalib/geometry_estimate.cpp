#include "libcalib/geometry_estimate.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "libcalib/calibration_json.h"

namespace lacquer::calib {

double GeometryUncertainty::angle_correction(const std::string& view) const {
  for (const ViewAngle& a : angles)
    if (a.view == view) return a.correction;
  return 0;
}

nlohmann::ordered_json uncertainty_to_json(const GeometryUncertainty& u) {
  nlohmann::ordered_json j;
  j["parameters"] = nlohmann::ordered_json::array();
  for (const GeometryParameter& p : u.parameters)
    j["parameters"].push_back({{"name", p.name}, {"unit", p.unit}, {"nominal", p.nominal}, {"correction", p.correction},
                               {"sigma", p.sigma}, {"prior_sigma", p.prior_sigma}, {"paint_shift", p.paint_shift}});
  j["covariance"] = u.covariance;
  if (!u.angles.empty()) j["angles"] = nlohmann::ordered_json::array();
  for (const ViewAngle& a : u.angles) j["angles"].push_back({{"view", a.view}, {"correction", a.correction}, {"sigma", a.sigma}});
  return j;
}

GeometryUncertainty uncertainty_from_json(const JsonReader& j) {
  constexpr std::size_t max_parameters = 1000;
  GeometryUncertainty u;
  for (const JsonReader& p : j.objects("parameters", max_parameters))
    u.parameters.push_back({p.text("name"), p.text("unit"), p.number("nominal", -1e9, 1e9), p.number("correction", -1e9, 1e9),
                            p.number("sigma", 0, 1e9), p.number("prior_sigma", 0, 1e9), p.has("paint_shift") ? p.number("paint_shift", -1e9, 1e9) : 0});
  const std::size_t n = u.parameters.size();
  u.covariance = j.numbers("covariance", -1e12, 1e12, n * n, n * n);
  for (std::size_t a = 0; a < n; ++a)
    for (std::size_t b = 0; b < a; ++b)
      if (std::abs(u.covariance[a * n + b] - u.covariance[b * n + a]) > 1e-9 * std::sqrt(u.covariance[a * n + a] * u.covariance[b * n + b]))
        j.fail("covariance", "a symmetric matrix");
  constexpr std::size_t max_views = 100000;
  if (j.has("angles"))
    for (const JsonReader& a : j.objects("angles", max_views)) u.angles.push_back({a.text("view"), a.number("correction", -10, 10), a.number("sigma", 0, 10)});
  return u;
}

}  // namespace lacquer::calib
