#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "libcalib/calibration.h"
#include "libcalib/frame_list.h"
#include "libcalib/merge_session.h"
#include "libcalib/noise_json.h"
#include "tools/drift_report.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::string session, frames, output, layout = "mono", response = "estimate", save_response, noise, maps;
  int bits = 8;
  calib::PhotographOptions photographs;
};

std::string flag_text(const calib::RadianceImage& image) {
  const auto count = [&](calib::PixelFlag flag) { return std::count(image.flags.begin(), image.flags.end(), flag); };
  return fmt::format("{} x {} {}: {} values, {} clipped in all frames, {} below the noise", image.width, image.height,
                     acquire::name_of(image.layout), image.flags.size(), count(calib::PixelFlag::clipped), count(calib::PixelFlag::dark));
}

void print_times(const calib::ExposureTimes& times) {
  fmt::print("{:>5} {:>12} {:>12} {:>9}\n", "frame", "listed s", "fitted s", "sigma %");
  for (std::size_t i = 0; i < times.listed_s.size(); ++i)
    fmt::print("{:>5} {:>12.6g} {:>12.6g} {:>9.2g}{}\n", i + 1, times.listed_s[i], times.fitted_s[i], 100 * times.sigma[i],
               std::count(times.false_frames.begin(), times.false_frames.end(), i) > 0 ? "  listed time is false" : "");
}

nlohmann::ordered_json photographs_json(const calib::MergedPhotographs& merged, const Options& options, nlohmann::ordered_json j) {
  const calib::RadianceImage& image = merged.image;
  const auto count = [&](calib::PixelFlag flag) { return std::count(image.flags.begin(), image.flags.end(), flag); };
  j["image"] = {{"width", image.width}, {"height", image.height}, {"layout", acquire::name_of(image.layout)}, {"values", image.flags.size()},
                {"clipped", count(calib::PixelFlag::clipped)}, {"dark", count(calib::PixelFlag::dark)}};
  j["response"] = {{"linear", merged.response.linear}, {"estimated", merged.estimate.has_value()}};
  if (merged.estimate)
    j["response"].update({{"iterations", merged.estimate->iterations}, {"converged", merged.estimate->converged}, {"residual_rms", merged.estimate->residual_rms}});
  j["noise"] = {{"estimated", merged.noise_estimated}, {"gain_e_per_dn", merged.noise.gain_e_per_dn}, {"read_noise_e", merged.noise.read_noise_e},
                {"relative_noise", merged.noise.relative_noise}};
  j["times"] = {{"listed_s", merged.times.listed_s}, {"fitted_s", merged.times.fitted_s}, {"relative_sigma", merged.times.sigma}, {"false_frames", merged.times.false_frames}};
  j["radiance"] = options.output;
  return j;
}

void run_frames(Options options, const Context& context) {
  if (options.output.empty()) throw Error(ErrorCode::usage, "-o: expected the EXR file to write, it is missing");
  const acquire::PixelLayout layout = acquire::pixel_layout_from_name(options.layout);
  if (!options.noise.empty()) options.photographs.noise = calib::read_noise_model(options.noise);
  if (!options.maps.empty()) options.photographs.maps = calib::read_sensor_maps(options.maps);
  if (options.response == "linear")
    options.photographs.linear = true;
  else if (options.response != "estimate")
    options.photographs.response = calib::read_response(options.response);
  const calib::MergedPhotographs merged =
      calib::merge_listed_photographs(options.frames, options.bits, layout, options.photographs, stderr_progress(context));
  calib::write_radiance(options.output, merged.image);
  if (!options.save_response.empty())
    calib::write_response(options.save_response, merged.response, provenance_json(context, {options.frames}));
  if (context.json) return print_json(photographs_json(merged, options, json_result(context, {options.frames})));
  fmt::print("{}\n", flag_text(merged.image));
  if (merged.estimate)
    fmt::print("response: {}, {} iterations{}, residual {:.2f} % of exposure\n",
               merged.response.linear ? "estimated: the sensor is linear" : "estimated: a curve", merged.estimate->iterations,
               merged.estimate->converged ? "" : " (NOT converged)", 100 * merged.estimate->residual_rms);
  if (options.photographs.fit_times) print_times(merged.times);
  fmt::print("noise ({}): gain {:.4g} e-/DN, read {:.3g} e-, relative {:.2f} %\nradiance: {}\n",
             merged.noise_estimated ? "estimated" : (options.noise.empty() ? "given" : "measured"), merged.noise.gain_e_per_dn, merged.noise.read_noise_e,
             100 * merged.noise.relative_noise, options.output);
}

void run_session(const Options& options, const Context& context) {
  const acquire::Session session = acquire::read_session(options.session);
  const std::filesystem::path file = session.folder / "calibration.json";
  const bool known = std::filesystem::exists(file);
  const Progress progress = stderr_progress(context);
  calib::Calibration calibration = known ? calib::read_calibration(file) : calib::sensor_calibration(session, progress);
  calib::merge_session(session, calibration, progress);
  // Merging shows what the lights did; the rest of a calibration that was there stays as it was.
  if (!known || !calibration.drift_source.empty())
    calib::write_calibration(file, calibration, provenance_json(context, {(session.folder / "session.json").string()}));
  if (context.json) {
    auto j = json_result(context, {(session.folder / "session.json").string()});
    j["views"] = session.views.size() - session.views_of(acquire::ViewKind::dark).size();
    j["response"] = calibration.response_source;
    j["noise"] = calibration.noise_source;
    j["lights_and_darks"] = light_and_dark_text(calibration);
    j["radiance"] = (session.folder / "radiance").string();
    if (plot_drift(calibration, session.folder / "drift.svg")) j["drift"] = (session.folder / "drift.svg").string();
    return print_json(j);
  }
  fmt::print("{} views merged, response: {}, noise: {}\n{}\nradiance: {}\n", session.views.size() - session.views_of(acquire::ViewKind::dark).size(),
             calibration.response_source, calibration.noise_source, light_and_dark_text(calibration), (session.folder / "radiance").string());
  if (plot_drift(calibration, session.folder / "drift.svg")) fmt::print("drift of the lights: {}\n", (session.folder / "drift.svg").string());
}

}  // namespace

void add_merge(CLI::App& app, Context& context) {
  auto o = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("merge", "raw frames -> linear radiance with variance (OpenEXR)");
  auto* session = command->add_option("session", o->session, "session folder: merges every view into SESSION/radiance");
  auto* frames = command->add_option("--frames", o->frames, "loose photographs instead: CSV with the header file,exposure_s");
  frames->excludes(session);
  const auto loose = [&](CLI::Option* option) { return option->needs(frames); };
  loose(command->add_option("-o,--output", o->output, "EXR to write: channels R G B or Y, each with .variance and .flag"));
  loose(command->add_option("--bits", o->bits, "bits of a value, right-aligned in the file")->capture_default_str()->check(CLI::Range(8, 16)));
  loose(command->add_option("--layout", o->layout, "of single-channel files: mono, rggb, grbg, gbrg, bggr")->capture_default_str());
  loose(command->add_option("--response", o->response, "linear, estimate or the JSON file of one")->capture_default_str());
  loose(command->add_option("--save-response", o->save_response, "JSON file to write the response to"));
  loose(command->add_option("--black-level", o->photographs.black_level_dn, "DN, default 0")->check(CLI::Range(0.0, 65535.0)));
  loose(command->add_option("--saturation", o->photographs.saturation_dn, "DN from which values are clipped, default 2^bits - 1"));
  loose(command->add_option("--gain", o->photographs.gain_e_per_dn, "electrons per linear DN, default: estimated"));
  loose(command->add_option("--read-noise", o->photographs.read_noise_e, "electrons RMS, default: estimated"));
  loose(command->add_option("--noise", o->noise, "JSON of lacquer calibrate noise: the measured noise and black level"))
      ->excludes("--black-level")
      ->excludes("--gain")
      ->excludes("--read-noise");
  loose(command->add_option("--maps", o->maps, "EXR of the same: offset, dark signal, flat field and bad values"));
  loose(command->add_flag("--fit-times", o->photographs.fit_times, "take the exposure times that the pixels say instead of the listed ones"));
  add_json_option(*command, context);
  command->callback([o, &context] {
    if (o->session.empty() == o->frames.empty()) throw Error(ErrorCode::usage, "merge: expected a session folder or --frames list.csv");
    o->frames.empty() ? run_session(*o, context) : run_frames(*o, context);
  });
}

}  // namespace lacquer::tools
