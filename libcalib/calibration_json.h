#pragma once

#include <glm/vec3.hpp>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "libacquire/rig_geometry.h"
#include "libcalib/drift.h"
#include "libcalib/response.h"

/// Parts of calibration.json. Internal to libcalib.
namespace lacquer::calib {

/// A JSON object with its path, so that every error names file, field and what was expected.
class JsonReader {
 public:
  static JsonReader parse(const std::string& text, const std::string& file);

  bool has(const std::string& key) const { return node_->contains(key); }
  JsonReader object(const std::string& key) const;
  std::vector<JsonReader> objects(const std::string& key, std::size_t max_size) const;
  double number(const std::string& key, double min, double max) const;  ///< finite, within [min, max]
  bool boolean(const std::string& key) const;
  std::string text(const std::string& key) const;
  /// Array of finite numbers within [min, max] of min_size..max_size elements.
  std::vector<double> numbers(const std::string& key, double min, double max, std::size_t min_size, std::size_t max_size) const;
  glm::dvec3 vector3(const std::string& key, double min = -1e9, double max = 1e9) const;
  /// Throws Error{file} "FILE: PATH.key: expected ...".
  [[noreturn]] void fail(const std::string& key, const std::string& expected) const;

 private:
  JsonReader(std::shared_ptr<const nlohmann::json> root, const nlohmann::json* node, std::string file, std::string path);
  const nlohmann::json& at(const std::string& key, const char* expected) const;
  std::shared_ptr<const nlohmann::json> root_;
  const nlohmann::json* node_;
  std::string file_, path_;
};

nlohmann::ordered_json vector_to_json(const glm::dvec3& v);

nlohmann::ordered_json geometry_to_json(const acquire::RigGeometry& geometry);
acquire::RigGeometry geometry_from_json(const JsonReader& j);

/// Model, its parameters and points; the factor at each point is written for people and not read.
nlohmann::ordered_json drift_to_json(const LightDrift& drift);
LightDrift drift_from_json(const JsonReader& j);

/// A linear response is stored as its black level, a curve as its 2^bits exposures per channel and, where known, its band.
nlohmann::ordered_json response_to_json(const Response& response);
Response response_from_json(const JsonReader& j);

}  // namespace lacquer::calib
