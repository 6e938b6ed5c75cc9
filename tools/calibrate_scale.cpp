#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "libcalib/scale_reference.h"
#include "tools/calibrate_parts.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::string session, white, brdf;
  std::vector<double> reflectance, plate_pixels, plate_normal{0, 0, 1}, plate_point_mm{0, 0, 0};
  double sigma = 0.01, light_sigma = 0, radius_mm = 0;
  bool keep_falloff = false;
};

calib::ScaleReference reference_of(const Options& o) {
  calib::ScaleReference reference;
  if (o.brdf.empty() == o.reflectance.empty()) throw Error(ErrorCode::usage, "calibrate scale: expected --reflectance (one number or R G B) or --reference FILE");
  if (!o.brdf.empty()) {
    reference.brdf = brdf::load_brdf(o.brdf);
  } else {
    if (o.reflectance.size() == 2) throw Error(ErrorCode::usage, "calibrate scale: --reflectance: expected 1 or 3 numbers");
    brdf::CookTorrance white;
    for (int c = 0; c < 3; ++c) white.kd[c] = o.reflectance[o.reflectance.size() == 3 ? static_cast<std::size_t>(c) : 0];
    reference.brdf = std::make_shared<brdf::CookTorranceBrdf>(white);
  }
  reference.sigma = o.sigma;
  reference.light_sigma = o.light_sigma;
  reference.radius = o.radius_mm * 1e-3;
  reference.fit_falloff = !o.keep_falloff;
  if (!o.plate_pixels.empty()) {
    const auto pixel = [&](std::size_t i) { return static_cast<int>(o.plate_pixels[i]); };
    reference.plate = {.normal = {o.plate_normal[0], o.plate_normal[1], o.plate_normal[2]},
                       .point = 1e-3 * glm::dvec3(o.plate_point_mm[0], o.plate_point_mm[1], o.plate_point_mm[2]),
                       .pixels = {pixel(0), pixel(1), pixel(2), pixel(3)}};
  }
  return reference;
}

void print_estimate(const calib::ScaleEstimate& estimate, const calib::Calibration& before) {
  for (std::size_t l = 0; l < estimate.lights.size(); ++l) {
    const calib::LightScale& s = estimate.lights[l];
    const acquire::Light& light = before.geometry.lights[l];
    const char* unit = light.distant ? "W/m^2" : "W/sr";
    fmt::print("light {}{}:", l, light.name.empty() ? "" : " " + light.name);
    for (int c = 0; c < 3; ++c) fmt::print(" {:.6g} (+- {:.3f} %)", light.intensity[c] * s.factor[c], 100 * s.factor_sigma[c]);
    fmt::print(" {}, was {:.6g} {:.6g} {:.6g}\n", unit, light.intensity.r, light.intensity.g, light.intensity.b);
    if (s.falloff_sigma > 0) fmt::print("  falls off as cos^{:.2f} (+- {:.2f}), was cos^{:g}\n", s.falloff_exponent, s.falloff_sigma, light.falloff_exponent);
    fmt::print("  {} values, {} left out (dust, edges), rms {:.2f} % about the model\n", s.n_used, s.n_left_out, 100 * s.rms);
  }
}

nlohmann::ordered_json estimate_json(const calib::ScaleEstimate& estimate, const calib::Calibration& before, const std::string& file, nlohmann::ordered_json j) {
  j["scale_sigma"] = estimate.sigma;
  for (std::size_t l = 0; l < estimate.lights.size(); ++l) {
    const calib::LightScale& s = estimate.lights[l];
    const acquire::Light& light = before.geometry.lights[l];
    const glm::dvec3 intensity = light.intensity * s.factor;
    j["lights"].push_back({{"name", light.name}, {"unit", light.distant ? "W/m^2" : "W/sr"}, {"intensity", {intensity.x, intensity.y, intensity.z}},
                           {"relative_sigma", {s.factor_sigma.x, s.factor_sigma.y, s.factor_sigma.z}}, {"intensity_before", {light.intensity.x, light.intensity.y, light.intensity.z}},
                           {"falloff_exponent", s.falloff_exponent}, {"falloff_sigma", s.falloff_sigma}, {"n_used", s.n_used}, {"n_left_out", s.n_left_out}, {"rms", s.rms}});
  }
  j["calibration"] = file;
  return j;
}

void run(const Options& o, const Context& context) {
  const calib::ScaleReference reference = reference_of(o);
  const acquire::Session session = acquire::read_session(o.session), white = acquire::read_session(o.white);
  const std::filesystem::path file = session.folder / "calibration.json", white_file = white.folder / "calibration.json";
  calib::Calibration calibration = calib::read_calibration(file);
  const calib::Calibration before = calibration;
  const calib::ScaleEstimate estimate = calib::estimate_scale(white, calib::read_calibration(white_file), calibration, reference);
  const std::string standard = o.brdf.empty() ? fmt::format("reflectance {:g}", fmt::join(o.reflectance, " ")) : std::filesystem::path(o.brdf).filename().string();
  calib::apply_scale(estimate, fmt::format("white reference, {} +- {:.2g} %", standard, 100 * o.sigma), calibration);
  calib::write_calibration(file, calibration, provenance_json(context, {white_file.string(), (white.folder / "session.json").string()}));
  if (context.json) return print_json(estimate_json(estimate, before, file.string(), json_result(context, {white_file.string()})));
  print_estimate(estimate, before);
  fmt::print("scale: absolute, 1/sr, known to {:.2f} % (1 sigma: reference {:.2f} %, lights between the captures {:.2f} %, scatter over the image)\ncalibration: {}\n",
             100 * estimate.sigma, 100 * o.sigma, 100 * o.light_sigma, file.string());
}

}  // namespace

void add_calibrate_scale(CLI::App& calibrate, Context& context) {
  auto o = std::make_shared<Options>();
  CLI::App* command = calibrate.add_subcommand("scale", "a white reference -> intensity and falloff of the lights, so that f_r is in 1/sr");
  command->add_option("session", o->session, "session folder, merged: its calibration.json is brought to scale")->required();
  command->add_option("--white", o->white, "session of lacquer capture --white-reference, merged")->required();
  command->add_option("--reflectance", o->reflectance, "of a Lambertian standard: one number or R G B")->expected(1, 3)->check(CLI::Range(1e-6, 1.0));
  command->add_option("--reference", o->brdf, "or its BRDF, any BRDF file");
  command->add_option("--sigma", o->sigma, "relative standard error of the standard")->capture_default_str()->check(CLI::Range(0.0, 0.5));
  command->add_option("--light-sigma", o->light_sigma, "relative change of the lights that is possible between the two captures")->capture_default_str()->check(CLI::Range(0.0, 0.5));
  command->add_option("--radius-mm", o->radius_mm, "of a white sphere; default: as the painted one")->check(CLI::PositiveNumber);
  command->add_option("--plate-pixels", o->plate_pixels, "a plate instead of a sphere: x y width height of a rectangle that shows nothing else")->expected(4)->check(CLI::Range(0, 32767));
  command->add_option("--plate-normal", o->plate_normal, "of the plate, rig frame")->expected(3)->capture_default_str();
  command->add_option("--plate-point-mm", o->plate_point_mm, "a point of its surface, rig frame")->expected(3)->capture_default_str();
  command->add_flag("--keep-falloff", o->keep_falloff, "believe the rig file's falloff_exponent");
  add_json_option(*command, context);
  command->callback([o, &context] { run(*o, context); });
}

}  // namespace lacquer::tools
