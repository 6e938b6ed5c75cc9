#include "libcalib/noise_json.h"

#include <fmt/format.h>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/calibration_json.h"
#include "libcalib/photon_transfer.h"

namespace lacquer::calib {

namespace {

using Json = nlohmann::ordered_json;

Json to_json(const std::optional<Measured>& m) {
  if (!m) return nullptr;
  return {{"value", m->value}, {"sigma", m->sigma}};
}

Json to_json(const NoiseFigures& f) {
  Json j;
  j["black_level_dn"] = to_json(f.black_level_dn);
  j["gain_e_per_dn"] = to_json(f.gain_e_per_dn);
  j["read_noise_dn"] = to_json(f.read_noise_dn);
  j["read_noise_e"] = to_json(f.read_noise_e);
  j["dark_current_dn_per_s"] = to_json(f.dark_current_dn_per_s);
  j["dark_current_e_per_s"] = to_json(f.dark_current_e_per_s);
  j["relative_noise"] = to_json(f.relative_noise);
  j["dsnu_dn"] = to_json(f.dsnu_dn);
  j["dark_spread_dn_per_s"] = to_json(f.dark_spread_dn_per_s);
  j["prnu"] = to_json(f.prnu);
  j["noise_correlation"] = f.noise_correlation;
  j["chi_square"] = f.chi_square;
  j["degrees_of_freedom"] = f.degrees_of_freedom;
  return j;
}

const char* name_of(TransferPoint::Use use) {
  switch (use) {
    case TransferPoint::Use::fitted: return "fitted";
    case TransferPoint::Use::clipped: return "clipped";
    case TransferPoint::Use::variance_drop: return "variance_drop";
    case TransferPoint::Use::quantised: return "quantised";
  }
  return "";
}

Json to_json(const TransferPoint& p) {
  return {{"channel", p.channel},        {"dark", p.dark},
          {"exposure_s", p.exposure_s},  {"mean_dn", p.mean},
          {"light_dn", p.light},         {"light_square_dn2", p.light_square},
          {"variance_dn2", p.variance},  {"variance_sigma_dn2", p.sigma},
          {"quantisation_dn2", p.quantisation}, {"values", p.n_values},
          {"use", name_of(p.use)}};
}

}  // namespace

void write_noise(const std::filesystem::path& file, const PhotonTransfer& t, const std::string& provenance_json) {
  Json j;
  j["version"] = 1;
  j["provenance"] = Json::parse(provenance_json);
  j["units"] = "linearised DN, electrons, seconds; sigma: standard error; relative numbers are fractions";
  j["sensor"] = {{"width", t.width}, {"height", t.height}, {"layout", acquire::name_of(t.layout)}, {"bits", t.bits}};
  j["noise"] = {{"gain_measured", t.gain_measured},
                {"black_level_dn", t.model.black_level_dn},
                {"gain_e_per_dn", t.model.gain_e_per_dn},
                {"read_noise_e", t.model.read_noise_e},
                {"dark_current_e_per_s", t.model.dark_current_e_per_s},
                {"saturation_dn", t.model.saturation_dn},
                {"relative_noise", t.model.relative_noise}};
  j["all"] = to_json(t.all);
  j["channels"] = Json::array();
  for (const NoiseFigures& f : t.channels) j["channels"].push_back(to_json(f));
  j["one_gain"] = {{"chi_square", t.one_gain_chi_square}, {"degrees_of_freedom", t.channels.size() - 1}};
  j["full_well_e"] = to_json(t.full_well_e);
  j["lamp_flicker"] = to_json(t.lamp_flicker);
  j["maps"] = {{"offset_sigma_dn", t.maps.offset_sigma}, {"dark_rate_sigma_dn_per_s", t.maps.dark_rate_sigma}, {"flat_sigma", t.maps.flat_sigma}};
  j["bad_values"] = {{"hot", t.n_hot}, {"dead", t.n_dead}, {"erratic", t.n_erratic}};
  j["notes"] = t.notes;
  j["points"] = Json::array();
  for (const TransferPoint& p : t.points) j["points"].push_back(to_json(p));
  brdf::write_text_atomically(file, j.dump(1) + "\n");
}

NoiseModel read_noise_model(const std::filesystem::path& file) {
  const JsonReader root = JsonReader::parse(brdf::read_text(file), file.string());
  if (const double version = root.number("version", 0, 1e9); version != 1)
    throw Error(ErrorCode::file, fmt::format("{}: version: expected 1, got {}", file.string(), version));
  const JsonReader j = root.object("noise");
  if (!j.boolean("gain_measured"))
    j.fail("gain_e_per_dn", "a measured gain, but this file comes from dark frames alone; measure again with --flats");
  NoiseModel noise;
  noise.black_level_dn = j.number("black_level_dn", 0, 65535);
  noise.gain_e_per_dn = j.number("gain_e_per_dn", 1e-9, 1e9);
  noise.read_noise_e = j.number("read_noise_e", 0, 1e9);
  noise.dark_current_e_per_s = j.number("dark_current_e_per_s", 0, 1e9);
  noise.saturation_dn = j.number("saturation_dn", 0, 65535);
  noise.relative_noise = j.number("relative_noise", 0, 1);
  return noise;
}

}  // namespace lacquer::calib
