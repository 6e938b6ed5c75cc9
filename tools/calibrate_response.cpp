#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "libcalib/bracket_samples.h"
#include "libcalib/calibration.h"
#include "libcalib/exposure_times.h"
#include "libcalib/frame_list.h"
#include "tools/calibrate_parts.h"
#include "tools/json_output.h"
#include "tools/plot.h"
#include "tools/response_plot.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::string session, frames, output, plot, layout = "mono";
  int bits = 8;
  std::optional<double> black_level_dn, saturation_dn;
  bool fit_times = false;
};

/// What the estimate is made from: brackets, where each frame came from, and the files for provenance.
struct Input {
  std::vector<std::vector<acquire::RawFrame>> brackets;
  std::vector<std::string> sources;             ///< per bracket
  std::vector<std::vector<std::string>> names;  ///< per bracket and frame
  std::vector<std::string> files;
  calib::ResponseOptions options;
};

Input read_list(const Options& o, bool quiet, const Progress& progress) {
  const std::vector<calib::ListedFrame> listed = calib::read_frame_list(o.frames);
  Input input;
  auto& frames = input.brackets.emplace_back();
  auto& names = input.names.emplace_back();
  std::optional<acquire::RawFrame> first;
  for (const calib::ListedFrame& l : listed) {
    acquire::RawFrame frame =
        calib::read_listed_frame(o.frames, l, o.bits, acquire::pixel_layout_from_name(o.layout), first ? &*first : nullptr);
    if (!first) first = frame;
    frames.push_back(calib::thinned(std::move(frame)));
    names.push_back(l.file.filename().string());
    progress("read", frames.size(), listed.size());
  }
  if (const int shift = calib::right_align(frames); shift > 0 && !quiet)
    fmt::print(stderr, "{}: all values are multiples of {}: {} bits stored left-aligned, shifted to the right\n", o.frames, 1 << shift, o.bits - shift);
  input.sources = {o.frames};
  input.files = {o.frames};
  return input;
}

/// Brackets of up to four views from the first half of the session, which see most of the lit side.
Input read_views(const Options& o, const Progress& progress) {
  const acquire::Session session = acquire::read_session(o.session);
  const calib::Calibration nominal = calib::calibration_from_rig(session.rig);
  Input input;
  input.options.black_level_dn = nominal.noise.black_level_dn;
  input.options.saturation_dn = nominal.noise.saturation_dn;
  const std::vector<std::size_t> views = session.views_of(acquire::ViewKind::measurement);
  const std::size_t n = views.size(), n_used = std::min<std::size_t>(4, n);
  for (std::size_t i = 0; i < n_used; ++i) {
    const acquire::ViewRecord& view = session.views[views[i * ((n + 1) / 2) / n_used]];
    auto& frames = input.brackets.emplace_back();
    auto& names = input.names.emplace_back();
    for (const auto& record : view.frames) {
      frames.push_back(calib::thinned(acquire::read_session_frame(session, record)));
      names.push_back(record.file);
    }
    input.sources.push_back(o.session);
    progress("read", i + 1, n_used);
  }
  input.files = {(session.folder / "session.json").string()};
  return input;
}

struct ChannelReport {
  bool linear;
  double deviation, deviation_sigma;  ///< RMS of ln(curve / line)
  double chi_square, p_value;
  double band;                        ///< median 1 sigma of ln exposure from 5 to 95 % of the range; 0 if linear
};

/// Deviation of the whole curve where it is one, of the test otherwise: the test sees small deviations only.
ChannelReport report(const calib::ResponseEstimate& estimate, std::size_t c, double black) {
  const calib::LinearityTest::Channel& test = estimate.linearity->channels[c];
  const calib::ResponseCurve& curve = estimate.response.curves[c];
  ChannelReport r{test.linear, test.deviation_rms, test.deviation_sigma, test.chi_square, test.p_value, 0};
  if (curve.band_value.empty()) return r;
  const double span = static_cast<double>(curve.exposure.size()) - black;
  double n = 0, sum = 0, squares = 0;
  for (auto v = static_cast<std::size_t>(black + 0.05 * span) + 1; static_cast<double>(v) <= black + 0.95 * span; ++v) {
    const double deviation = std::log(curve.exposure[v] / (static_cast<double>(v) - black));
    ++n;
    sum += deviation;
    squares += deviation * deviation;
  }
  r.deviation = std::sqrt(std::max(0.0, squares / n - sum * sum / (n * n)));
  std::vector<double> sigma;
  for (std::size_t i = 0; i < curve.band_value.size(); ++i)
    if (curve.band_value[i] >= black + 0.05 * span && curve.band_value[i] <= black + 0.95 * span) sigma.push_back(curve.band_log_sigma[i]);
  std::nth_element(sigma.begin(), sigma.begin() + static_cast<std::ptrdiff_t>(sigma.size() / 2), sigma.end());
  r.band = sigma[sigma.size() / 2];
  return r;
}

void print_text(const calib::ResponseEstimate& e, const std::vector<ChannelReport>& channels, double given_black, double seconds) {
  const char* const names[] = {"R", "G", "B"};
  for (std::size_t c = 0; c < channels.size(); ++c) {
    const ChannelReport& r = channels[c];
    fmt::print("{}: {}, {:.3g} % from a line (RMS; noise alone {:.2g} %), chi-square {:.3g} of 8, p {:.2g}", channels.size() == 3 ? names[c] : "Y",
               r.linear ? "linear" : "curved", 100 * r.deviation, 100 * r.deviation_sigma, r.chi_square, r.p_value);
    if (r.band > 0) fmt::print("; band {:.2g} % (1 sigma, median from 5 to 95 % of the range)", 100 * r.band);
    fmt::print("\n");
  }
  const calib::LinearityTest& test = *e.linearity;
  if (test.linear)
    fmt::print("black level: {:.2f} +- {:.2f} DN from the line{}\n", test.fitted_black_level_dn, test.black_level_sigma_dn,
               test.black_level_contradicted ? fmt::format(", NOT {:g} as given; the response uses it", given_black) : "");
  fmt::print("response: {}, {} iterations{}, residual {:.2f} % of exposure, {:.2f} s\n", e.response.linear ? "linear" : "curve", e.iterations,
             e.converged ? "" : " (NOT converged)", 100 * e.residual_rms, seconds);
}

void print_result_json(const calib::ResponseEstimate& e, const std::vector<ChannelReport>& channels, const std::vector<calib::ExposureTimes>& times,
                       const Options& o, double seconds, const std::vector<std::string>& files, const Context& context) {
  nlohmann::ordered_json j = json_result(context, files);
  j["linear"] = e.response.linear;
  j["bits"] = e.response.bits;
  j["channels"] = nlohmann::ordered_json::array();
  for (const ChannelReport& r : channels)
    j["channels"].push_back({{"linear", r.linear}, {"deviation_rms", r.deviation}, {"deviation_sigma", r.deviation_sigma},
                             {"chi_square", r.chi_square}, {"p_value", r.p_value}, {"band_log_sigma", r.band}});
  if (e.linearity->linear)
    j["black_level_dn"] = {{"used", e.linearity->black_level_dn},
                           {"fitted", e.linearity->fitted_black_level_dn},
                           {"sigma", e.linearity->black_level_sigma_dn},
                           {"contradicted", e.linearity->black_level_contradicted}};
  j["iterations"] = e.iterations;
  j["converged"] = e.converged;
  j["residual_rms"] = e.residual_rms;
  j["seconds"] = seconds;
  j["times"] = nlohmann::ordered_json::array();
  for (const calib::ExposureTimes& t : times) {
    nlohmann::ordered_json sigma = t.sigma;
    j["times"].push_back({{"listed_s", t.listed_s}, {"fitted_s", t.fitted_s}, {"relative_sigma", sigma}, {"false_frames", t.false_frames}});
  }
  j["response"] = o.output;
  print_json(j);
}

void run(const Options& o, const Context& context) {
  if (!o.plot.empty()) check_plot_name(o.plot);
  const Progress progress = stderr_progress(context);
  Input input = o.frames.empty() ? read_views(o, progress) : read_list(o, context.quiet, progress);
  if (o.black_level_dn) input.options.black_level_dn = *o.black_level_dn;
  if (o.saturation_dn) input.options.saturation_dn = *o.saturation_dn;
  input.options.fit_times = o.fit_times;

  const auto start = std::chrono::steady_clock::now();
  const calib::ResponseEstimate estimate = calib::estimate_response(input.brackets, input.options);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::vector<calib::ExposureTimes> times;
  for (std::size_t b = 0; b < input.brackets.size(); ++b) {
    times.push_back(calib::exposure_times(input.brackets, b, estimate));
    if (!o.fit_times) calib::refuse_false_times(times.back(), input.sources[b], input.names[b]);
  }
  const double black = estimate.response.linear ? estimate.linearity->black_level_dn : input.options.black_level_dn;
  std::vector<ChannelReport> channels;
  for (std::size_t c = 0; c < estimate.response.curves.size(); ++c) channels.push_back(report(estimate, c, black));

  calib::write_response(o.output, estimate.response, provenance_json(context, input.files));
  if (!o.plot.empty()) plot_response(estimate.response, black, o.plot);
  if (context.json) return print_result_json(estimate, channels, times, o, seconds, input.files, context);
  print_text(estimate, channels, input.options.black_level_dn, seconds);
  if (o.fit_times)
    for (const calib::ExposureTimes& t : times)
      for (std::size_t i = 0; i < t.listed_s.size(); ++i)
        fmt::print("frame {}: listed {:.6g} s, fitted {:.6g} s +- {:.2g} %\n", i + 1, t.listed_s[i], t.fitted_s[i], 100 * t.sigma[i]);
  fmt::print("wrote {}\n", o.output);
  if (!o.plot.empty()) fmt::print("wrote {}\n", o.plot);
}

}  // namespace

void add_calibrate_response(CLI::App& calibrate, Context& context) {
  auto o = std::make_shared<Options>();
  CLI::App* command = calibrate.add_subcommand("response", "brackets -> response of the sensor: linear, or a curve with its band");
  auto* session = command->add_option("session", o->session, "session folder: the brackets of up to four views");
  auto* frames = command->add_option("--frames", o->frames, "loose photographs instead: CSV with the header file,exposure_s");
  frames->excludes(session);
  command->add_option("-o,--output", o->output, "response JSON to write")->required();
  command->add_option("--plot", o->plot, "plot to write, .svg or .png");
  command->add_option("--bits", o->bits, "bits of a value in the files of --frames; left-aligned values are found and shifted")
      ->capture_default_str()->check(CLI::Range(8, 16))->needs(frames);
  command->add_option("--layout", o->layout, "of single-channel files: mono, rggb, grbg, gbrg, bggr")->capture_default_str()->needs(frames);
  command->add_option("--black-level", o->black_level_dn, "DN, default: 0, or the rig file's")->check(CLI::Range(0.0, 65535.0));
  command->add_option("--saturation", o->saturation_dn, "DN from which values are clipped, default: 2^bits - 1, or the rig file's");
  command->add_flag("--fit-times", o->fit_times, "fit the exposure times too instead of refusing false ones (gauge: the median frame, and for a curve the exponent of the listed times)");
  add_json_option(*command, context);
  command->callback([o, &context] {
    if (o->session.empty() == o->frames.empty())
      throw Error(ErrorCode::usage, "calibrate response: expected a session folder or --frames list.csv");
    run(*o, context);
  });
}

}  // namespace lacquer::tools
