#include "tools/geometry_provenance.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

namespace lacquer::tools {

std::string with_geometry_sigma(const std::string& provenance_json, const calib::GeometrySigma& sigma) {
  if (!(sigma.half_vector_rad > 0)) return provenance_json;
  auto j = nlohmann::ordered_json::parse(provenance_json.empty() ? "{}" : provenance_json);
  j["geometry_sigma"] = {{"half_vector_rad", sigma.half_vector_rad}, {"light_distance", sigma.distance}};
  return j.dump();
}

double half_vector_sigma_of(const std::string& provenance_json) {
  const auto j = nlohmann::json::parse(provenance_json, nullptr, false);
  if (!j.is_object() || !j.contains("geometry_sigma") || !j["geometry_sigma"].is_object()) return 0;
  const auto found = j["geometry_sigma"].find("half_vector_rad");
  if (found == j["geometry_sigma"].end() || !found->is_number()) return 0;
  const double sigma = found->get<double>();
  return sigma > 0 && sigma < 1 ? sigma : 0;
}

std::string table_geometry_note(double half_vector_sigma, const std::string& session) {
  if (!(half_vector_sigma > 0)) return "";
  return fmt::format(
      "geometry    was estimated; of its errors a table has the distance of the lights (kd, ks) and the blur of lobes (m) alone:\n"
      "            standard errors of m and r are too small; all of them has: lacquer fit {} --samples\n",
      session);
}

}  // namespace lacquer::tools
