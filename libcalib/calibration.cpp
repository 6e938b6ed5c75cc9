#include "libcalib/calibration.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/calibration_json.h"
#include "libcalib/noise_json.h"

namespace lacquer::calib {

namespace {

void read_maps(const std::filesystem::path& file, Calibration& c) {
  c.maps = read_sensor_maps(file);
  c.maps_file = file;
}

/// Empty where the file has none.
std::vector<double> read_lens_covariance(const JsonReader& camera) {
  if (!camera.has("covariance")) return {};
  const auto covariance = camera.numbers("covariance", -1e12, 1e12, 16, 144);
  const auto n = static_cast<std::size_t>(std::lround(std::sqrt(static_cast<double>(covariance.size()))));
  if (n * n != covariance.size()) camera.fail("covariance", "as many rows as columns");
  return covariance;
}

}  // namespace

Calibration calibration_from_rig(const acquire::RigDescription& rig) {
  const auto& sensor = rig.sensor;
  Calibration c;
  c.noise.black_level_dn = sensor.black_level_dn;
  c.noise.gain_e_per_dn = sensor.gain_e_per_dn;
  c.noise.read_noise_e = sensor.read_noise_e;
  c.noise.dark_current_e_per_s = sensor.dark_current_e_per_s;
  const double adc_limit = std::exp2(sensor.bits) - 1;
  // A full well is read with noise: values within 6 sigma of it may be clipped ones.
  const double full_well_limit =
      sensor.full_well_e > 0 ? sensor.black_level_dn + (sensor.full_well_e - 6 * sensor.read_noise_e) / sensor.gain_e_per_dn : adc_limit;
  c.noise.saturation_dn = std::floor(std::min(adc_limit, full_well_limit));
  c.noise_source = "rig file";
  if (sensor.noise_file) {
    const double saturation = c.noise.saturation_dn;
    c.noise = read_noise_model(*sensor.noise_file);
    c.noise.saturation_dn = c.noise.saturation_dn > 0 ? std::min(c.noise.saturation_dn, saturation) : saturation;
    c.noise_source = "measured: " + sensor.noise_file->filename().string();
  }
  if (sensor.maps_file) read_maps(*sensor.maps_file, c);

  c.response = linear_response(sensor.bits, acquire::n_channels(sensor.layout), c.noise.black_level_dn);
  c.response_source = "linear, as the rig file says";

  c.geometry = rig.geometry;
  c.geometry_source = "rig file";
  if (rig.lens) c.lens_covariance = rig.lens->covariance;
  c.dn_per_radiance = sensor.sensitivity / sensor.gain_e_per_dn;
  c.vignetting = sensor.vignetting;
  c.lens_blur_px = sensor.lens_blur_px;
  c.absolute_scale = rig.absolute_scale;
  c.scale_source = rig.absolute_scale ? "rig file" : "none: relative";
  return c;
}

DriftValue Calibration::light_factor(const acquire::ViewRecord& view) const {
  if (view.light < 0 || static_cast<std::size_t>(view.light) >= light_drift.size()) return {};
  const LightDrift& drift = light_drift[static_cast<std::size_t>(view.light)];
  if (drift.model == LightDrift::Model::none) return {};
  const std::optional<double> time = view.time_s();
  if (!time) throw Error(ErrorCode::file, fmt::format("session.json: view {}: frames: time_s is missing, and light {} is not steady", view.id, view.light));
  return {drift.factor(*time), drift.factor_sigma(*time)};
}

void write_calibration(const std::filesystem::path& file, const Calibration& c, const std::string& provenance_json) {
  nlohmann::ordered_json j;
  j["version"] = 1;
  j["provenance"] = nlohmann::ordered_json::parse(provenance_json);
  j["units"] = "metres, radians, seconds, DN, electrons; camera frame x right y down z forward, rig frame y along the turntable axis";
  j["response"] = response_to_json(c.response);
  j["response"]["source"] = c.response_source;
  j["noise"] = {{"source", c.noise_source},
                {"black_level_dn", c.noise.black_level_dn},
                {"gain_e_per_dn", c.noise.gain_e_per_dn},
                {"read_noise_e", c.noise.read_noise_e},
                {"dark_current_e_per_s", c.noise.dark_current_e_per_s},
                {"saturation_dn", c.noise.saturation_dn},
                {"relative_noise", c.noise.relative_noise}};
  if (!c.maps_file.empty()) j["noise"]["maps_file"] = c.maps_file.lexically_relative(file.parent_path()).generic_string();
  if (!c.dark_source.empty()) j["noise"]["darks"] = c.dark_source;
  j["geometry"] = geometry_to_json(c.geometry);
  j["geometry"]["source"] = c.geometry_source;
  if (!c.lens_covariance.empty()) j["geometry"]["camera"]["covariance"] = c.lens_covariance;
  if (!c.geometry_uncertainty.parameters.empty()) {
    j["geometry"]["turntable_scale"] = c.turntable_scale;
    j["geometry"]["estimate"] = uncertainty_to_json(c.geometry_uncertainty);
  }
  j["scale"] = {{"source", c.scale_source},
                {"absolute", c.absolute_scale},
                {"sigma", c.scale_sigma},
                {"dn_per_radiance", vector_to_json(c.dn_per_radiance)},
                {"vignetting", c.vignetting},
                {"lens_blur_px", c.lens_blur_px}};
  if (!c.drift_source.empty()) {
    j["light_drift"]["source"] = c.drift_source;
    j["light_drift"]["lights"] = nlohmann::ordered_json::array();
    for (const LightDrift& drift : c.light_drift) j["light_drift"]["lights"].push_back(drift_to_json(drift));
  }
  brdf::write_text_atomically(file, j.dump(1) + "\n");
}

Calibration read_calibration(const std::filesystem::path& file) {
  const JsonReader root = JsonReader::parse(brdf::read_text(file), file.string());
  if (const double version = root.number("version", 0, 1e9); version != 1)
    throw Error(ErrorCode::file, fmt::format("{}: version: expected 1, got {}", file.string(), version));
  Calibration c;
  const JsonReader response = root.object("response");
  c.response = response_from_json(response);
  c.response_source = response.text("source");

  const JsonReader noise = root.object("noise");
  c.noise_source = noise.text("source");
  c.noise.black_level_dn = noise.number("black_level_dn", 0, 65535);
  c.noise.gain_e_per_dn = noise.number("gain_e_per_dn", 1e-9, 1e9);
  c.noise.read_noise_e = noise.number("read_noise_e", 0, 1e9);
  c.noise.dark_current_e_per_s = noise.number("dark_current_e_per_s", 0, 1e9);
  c.noise.saturation_dn = noise.number("saturation_dn", 1, 65535);
  c.noise.relative_noise = noise.number("relative_noise", 0, 1);
  if (noise.has("maps_file")) read_maps(file.parent_path() / noise.text("maps_file"), c);

  if (noise.has("darks")) c.dark_source = noise.text("darks");

  const JsonReader geometry = root.object("geometry");
  c.geometry = geometry_from_json(geometry);
  c.geometry_source = geometry.text("source");
  c.lens_covariance = read_lens_covariance(geometry.object("camera"));
  if (geometry.has("estimate")) {
    c.turntable_scale = geometry.number("turntable_scale", 0.5, 2);
    c.geometry_uncertainty = uncertainty_from_json(geometry.object("estimate"));
  }

  const JsonReader scale = root.object("scale");
  c.scale_source = scale.text("source");
  c.absolute_scale = scale.boolean("absolute");
  if (scale.has("sigma")) c.scale_sigma = scale.number("sigma", 0, 10);
  c.dn_per_radiance = scale.vector3("dn_per_radiance", 1e-30, 1e30);
  c.vignetting = scale.number("vignetting", 0, 0.999);
  c.lens_blur_px = scale.number("lens_blur_px", 0, 100);

  if (root.has("light_drift")) {
    const JsonReader drift = root.object("light_drift");
    c.drift_source = drift.text("source");
    for (const JsonReader& light : drift.objects("lights", c.geometry.lights.size())) c.light_drift.push_back(drift_from_json(light));
    if (c.light_drift.size() != c.geometry.lights.size()) drift.fail("lights", fmt::format("{} entries, one per light", c.geometry.lights.size()));
  }
  return c;
}

}  // namespace lacquer::calib
