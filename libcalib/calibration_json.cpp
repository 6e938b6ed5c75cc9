#include "libcalib/calibration_json.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>

#include "libbrdf/error.h"

namespace lacquer::calib {

using Json = nlohmann::ordered_json;

JsonReader::JsonReader(std::shared_ptr<const nlohmann::json> root, const nlohmann::json* node, std::string file, std::string path)
    : root_(std::move(root)), node_(node), file_(std::move(file)), path_(std::move(path)) {}

JsonReader JsonReader::parse(const std::string& text, const std::string& file) {
  auto root = std::make_shared<nlohmann::json>();
  try {
    *root = nlohmann::json::parse(text);
  } catch (const nlohmann::json::exception& e) {
    throw Error(ErrorCode::file, fmt::format("{}: not valid JSON: {}", file, e.what()));
  }
  if (!root->is_object()) throw Error(ErrorCode::file, fmt::format("{}: expected a JSON object", file));
  const nlohmann::json* node = root.get();
  return JsonReader(std::move(root), node, file, "");
}

void JsonReader::fail(const std::string& key, const std::string& expected) const {
  throw Error(ErrorCode::file, fmt::format("{}: {}{}: expected {}", file_, path_, key, expected));
}

const nlohmann::json& JsonReader::at(const std::string& key, const char* expected) const {
  const auto found = node_->find(key);
  if (found == node_->end()) fail(key, fmt::format("{}, but the field is missing", expected));
  return *found;
}

JsonReader JsonReader::object(const std::string& key) const {
  const auto& j = at(key, "an object");
  if (!j.is_object()) fail(key, "an object");
  return JsonReader(root_, &j, file_, path_ + key + ".");
}

std::vector<JsonReader> JsonReader::objects(const std::string& key, std::size_t max_size) const {
  const auto& j = at(key, "an array of objects");
  if (!j.is_array() || j.empty() || j.size() > max_size) fail(key, fmt::format("an array of 1 to {} objects", max_size));
  std::vector<JsonReader> result;
  for (std::size_t i = 0; i < j.size(); ++i) {
    if (!j[i].is_object()) fail(fmt::format("{}[{}]", key, i), "an object");
    result.push_back(JsonReader(root_, &j[i], file_, fmt::format("{}{}[{}].", path_, key, i)));
  }
  return result;
}

double JsonReader::number(const std::string& key, double min, double max) const {
  const auto& j = at(key, "a number");
  const double value = j.is_number() ? j.get<double>() : std::nan("");
  if (!(value >= min && value <= max)) fail(key, fmt::format("a number in [{}, {}]", min, max));
  return value;
}

bool JsonReader::boolean(const std::string& key) const {
  const auto& j = at(key, "true or false");
  if (!j.is_boolean()) fail(key, "true or false");
  return j.get<bool>();
}

std::string JsonReader::text(const std::string& key) const {
  const auto& j = at(key, "a text");
  if (!j.is_string()) fail(key, "a text");
  return j.get<std::string>();
}

std::vector<double> JsonReader::numbers(const std::string& key, double min, double max, std::size_t min_size,
                                        std::size_t max_size) const {
  const auto& j = at(key, "an array of numbers");
  const std::string expected = min_size == max_size ? fmt::format("{} numbers", min_size) : fmt::format("{} to {} numbers", min_size, max_size);
  if (!j.is_array() || j.size() < min_size || j.size() > max_size) fail(key, expected);
  std::vector<double> values;
  for (const auto& element : j) {
    const double value = element.is_number() ? element.get<double>() : std::nan("");
    if (!(value >= min && value <= max)) fail(key, fmt::format("{} in [{}, {}]", expected, min, max));
    values.push_back(value);
  }
  return values;
}

glm::dvec3 JsonReader::vector3(const std::string& key, double min, double max) const {
  const auto v = numbers(key, min, max, 3, 3);
  return {v[0], v[1], v[2]};
}

Json vector_to_json(const glm::dvec3& v) { return {v.x, v.y, v.z}; }

namespace {

constexpr double max_length = 1e6;  // metres

glm::dvec3 unit_vector(const JsonReader& j, const std::string& key) {
  const glm::dvec3 v = j.vector3(key, -1.001, 1.001);
  if (std::abs(glm::length(v) - 1) > 1e-6) j.fail(key, "a unit vector");
  return v;
}

Json light_to_json(const acquire::Light& light) {
  Json l;
  l["name"] = light.name;
  l["distant"] = light.distant;
  l["on_arm"] = light.on_arm;
  if (light.distant)
    l["direction"] = vector_to_json(light.direction);
  else
    l["position"] = vector_to_json(light.position);
  l["intensity"] = vector_to_json(light.intensity);
  l["diameter"] = light.diameter;
  l["falloff_exponent"] = light.falloff_exponent;
  return l;
}

acquire::Light light_from_json(const JsonReader& j) {
  acquire::Light light;
  light.name = j.text("name");
  light.distant = j.boolean("distant");
  light.on_arm = j.boolean("on_arm");
  if (light.distant)
    light.direction = unit_vector(j, "direction");
  else
    light.position = j.vector3("position", -max_length, max_length);
  light.intensity = j.vector3("intensity", 1e-30, 1e30);
  light.diameter = j.number("diameter", 0, max_length);
  light.falloff_exponent = j.number("falloff_exponent", 0, 1000);
  return light;
}

}  // namespace

Json geometry_to_json(const acquire::RigGeometry& g) {
  const auto& camera = g.camera;
  Json j;
  j["camera"] = {{"projection", camera.projection == acquire::CameraModel::Projection::pinhole ? "pinhole" : "orthographic"},
                 {"width", camera.width},
                 {"height", camera.height},
                 {"focal", {camera.focal.x, camera.focal.y}},
                 {"centre", {camera.centre.x, camera.centre.y}},
                 {"distortion", camera.distortion}};
  Json rotation = Json::array();  // row-major
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column) rotation.push_back(g.cam_from_rig.rotation[column][row]);
  j["cam_from_rig"] = {{"rotation", rotation}, {"translation", vector_to_json(g.cam_from_rig.translation)}};
  j["sphere_radius"] = g.sphere_radius;
  j["axis_direction"] = vector_to_json(g.axis_direction);
  j["axis_point"] = vector_to_json(g.axis_point);
  j["lights"] = Json::array();
  for (const auto& light : g.lights) j["lights"].push_back(light_to_json(light));
  return j;
}

acquire::RigGeometry geometry_from_json(const JsonReader& j) {
  acquire::RigGeometry g;
  const JsonReader camera = j.object("camera");
  const std::string projection = camera.text("projection");
  if (projection != "pinhole" && projection != "orthographic") camera.fail("projection", "\"pinhole\" or \"orthographic\"");
  g.camera.projection =
      projection == "pinhole" ? acquire::CameraModel::Projection::pinhole : acquire::CameraModel::Projection::orthographic;
  g.camera.width = static_cast<int>(camera.number("width", 1, 100000));
  g.camera.height = static_cast<int>(camera.number("height", 1, 100000));
  const auto focal = camera.numbers("focal", 1e-9, 1e9, 2, 2), centre = camera.numbers("centre", -1e6, 1e6, 2, 2);
  g.camera.focal = {focal[0], focal[1]};
  g.camera.centre = {centre[0], centre[1]};
  const auto distortion = camera.numbers("distortion", -1e6, 1e6, 8, 8);
  std::copy(distortion.begin(), distortion.end(), g.camera.distortion.begin());

  const JsonReader pose = j.object("cam_from_rig");
  const auto rotation = pose.numbers("rotation", -1.001, 1.001, 9, 9);
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column) g.cam_from_rig.rotation[column][row] = rotation[static_cast<std::size_t>(row * 3 + column)];
  for (int a = 0; a < 3; ++a)
    for (int b = a; b < 3; ++b)
      if (std::abs(glm::dot(g.cam_from_rig.rotation[a], g.cam_from_rig.rotation[b]) - (a == b ? 1 : 0)) > 1e-6)
        pose.fail("rotation", "a rotation matrix");
  g.cam_from_rig.translation = pose.vector3("translation", -max_length, max_length);
  g.sphere_radius = j.number("sphere_radius", 1e-9, max_length);
  g.axis_direction = unit_vector(j, "axis_direction");
  g.axis_point = j.vector3("axis_point", -max_length, max_length);
  for (const auto& light : j.objects("lights", 100000)) g.lights.push_back(light_from_json(light));
  return g;
}

Json drift_to_json(const LightDrift& drift) {
  std::vector<double> time, intensity, sigma, factor, factor_sigma;
  for (const DriftPoint& p : drift.points) {
    time.push_back(p.time_s);
    intensity.push_back(p.intensity);
    sigma.push_back(p.sigma);
    factor.push_back(drift.factor(p.time_s));
    factor_sigma.push_back(drift.factor_sigma(p.time_s));
  }
  return {{"model", name_of(drift.model)}, {"time_constant_s", drift.time_constant_s}, {"light_noise", drift.light_noise}, {"start", drift.start}, {"start_sigma", drift.start_sigma},
          {"time_s", time}, {"intensity", intensity}, {"sigma", sigma}, {"factor", factor}, {"factor_sigma", factor_sigma}};
}

LightDrift drift_from_json(const JsonReader& j) {
  constexpr std::size_t max_points = 100000;
  LightDrift drift;
  try {
    drift.model = drift_model_from_name(j.text("model"));
  } catch (const Error&) {
    j.fail("model", "none, linear, warm_up, smooth or per_view");
  }
  const bool has_constant = drift.model == LightDrift::Model::warm_up || drift.model == LightDrift::Model::smooth;
  drift.time_constant_s = j.number("time_constant_s", has_constant ? 1e-9 : 0, 1e12);
  drift.light_noise = j.number("light_noise", 0, 100);
  drift.start = j.number("start", 1e-9, 1e9);
  drift.start_sigma = j.number("start_sigma", 0, 1e9);
  const auto time = j.numbers("time_s", -1e9, 1e9, drift.model == LightDrift::Model::none ? 0 : 2, max_points);
  if (std::adjacent_find(time.begin(), time.end(), std::greater_equal<>()) != time.end()) j.fail("time_s", "ascending numbers");
  const auto intensity = j.numbers("intensity", 1e-9, 1e9, time.size(), time.size()), sigma = j.numbers("sigma", 1e-30, 1e9, time.size(), time.size());
  for (std::size_t k = 0; k < time.size(); ++k) drift.points.push_back({time[k], intensity[k], sigma[k]});
  return drift;
}

Json response_to_json(const Response& response) {
  Json j;
  j["bits"] = response.bits;
  j["channels"] = response.curves.size();
  j["linear"] = response.linear;
  j["gauge"] = "exposure at value 2^(bits-1) is that value minus the black level";
  if (response.linear) {
    j["black_level_dn"] = -response.curves.at(0).exposure.at(0);
  } else {
    j["curves"] = Json::array();
    for (const auto& curve : response.curves) {
      j["curves"].push_back({{"exposure", curve.exposure}});
      if (!curve.band_value.empty()) j["curves"].back()["band"] = {{"value", curve.band_value}, {"log_sigma", curve.band_log_sigma}};
    }
  }
  return j;
}

namespace {

void read_band(const JsonReader& j, ResponseCurve& curve) {
  curve.band_value = j.numbers("value", 0, static_cast<double>(curve.exposure.size() - 1), 1, curve.exposure.size());
  if (std::adjacent_find(curve.band_value.begin(), curve.band_value.end(), std::greater_equal<>()) != curve.band_value.end())
    j.fail("value", "strictly increasing numbers");
  curve.band_log_sigma = j.numbers("log_sigma", 0, 1e6, curve.band_value.size(), curve.band_value.size());
}

}  // namespace

Response response_from_json(const JsonReader& j) {
  const int bits = static_cast<int>(j.number("bits", 8, 16));
  const int channels = static_cast<int>(j.number("channels", 1, 3));
  if (channels == 2) j.fail("channels", "1 or 3");
  if (j.boolean("linear")) return linear_response(bits, channels, j.number("black_level_dn", 0, 65535));

  Response response{bits, false, {}};
  const std::size_t n_levels = std::size_t{1} << bits;
  const auto curves = j.objects("curves", static_cast<std::size_t>(channels));
  if (curves.size() != static_cast<std::size_t>(channels)) j.fail("curves", fmt::format("{} curves, one per channel", channels));
  for (const auto& curve : curves) {
    response.curves.push_back({curve.numbers("exposure", -1e12, 1e12, n_levels, n_levels)});
    const auto& exposure = response.curves.back().exposure;
    if (std::adjacent_find(exposure.begin(), exposure.end(), std::greater_equal<>()) != exposure.end())
      curve.fail("exposure", "strictly increasing numbers");
    if (curve.has("band")) read_band(curve.object("band"), response.curves.back());
  }
  return response;
}

}  // namespace lacquer::calib
