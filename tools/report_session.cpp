#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "libbrdf/files.h"
#include "libcalib/noise_model.h"
#include "libcalib/shown_rgb.h"
#include "tools/brdf_plots.h"
#include "tools/capture_guard.h"
#include "tools/drift_report.h"
#include "tools/report_page.h"
#include "tools/report_views.h"
#include "tools/response_plot.h"

namespace lacquer::tools {

namespace {

constexpr std::size_t n_histogram_views = 4, n_thumbnails = 10;
constexpr double degree = std::numbers::pi / 180;
constexpr int n_bins = 64;

/// Raw values of one exposure time over some views.
struct ExposureHistogram {
  std::vector<double> counts = std::vector<double>(n_bins);
  double n = 0, clipped = 0, sum = 0;
};

std::map<double, ExposureHistogram> histograms(const ReportSession& s, int saturation) {
  std::map<double, ExposureHistogram> by_exposure;
  const double levels = std::exp2(s.session.rig.sensor.bits);
  for (const std::size_t v : spread_views(s, n_histogram_views))
    for (const auto& record : s.session.views[v].frames) {
      const acquire::RawFrame frame = acquire::read_session_frame(s.session, record);
      auto& h = by_exposure[record.exposure_s];
      std::vector<std::size_t> counts(static_cast<std::size_t>(levels));
      for (const std::uint16_t value : frame.data) ++counts[std::min<std::size_t>(value, counts.size() - 1)];
      for (std::size_t value = 0; value < counts.size(); ++value) {
        const double n = static_cast<double>(counts[value]);
        h.counts[value * n_bins / counts.size()] += n;
        h.n += n;
        h.sum += n * static_cast<double>(value);
        if (static_cast<int>(value) >= saturation) h.clipped += n;
      }
    }
  return by_exposure;
}

std::string exposure_text(double seconds) { return seconds < 1 ? fmt::format("{:.4g} ms", 1e3 * seconds) : fmt::format("{:.4g} s", seconds); }

std::string histogram_figures(const ReportSession& s) {
  const int bits = s.session.rig.sensor.bits;
  const calib::NoiseModel noise = s.calibration ? s.calibration->noise : calib::calibration_from_rig(s.session.rig).noise;
  const auto by_exposure = histograms(s, calib::saturation_value(noise, bits));
  const double levels = std::exp2(bits);
  std::string data, curves;
  std::vector<std::vector<std::string>> rows;
  std::size_t k = 0;
  for (const auto& [exposure, h] : by_exposure) {
    std::vector<double> value, share;
    for (int b = 0; b < n_bins; ++b) value.push_back(100.0 * (b + 0.5) / n_bins), share.push_back(h.counts[static_cast<std::size_t>(b)] > 0 ? 100 * h.counts[static_cast<std::size_t>(b)] / h.n : std::nan(""));
    data += plot_data(fmt::format("h{}", k), {value, share});
    curves += fmt::format("{}$h{} using 1:2 with steps lw 1.3 lt {} title {}", curves.empty() ? "plot " : ", ", k, k % 8 + 1, plot_text(exposure_text(exposure)));
    rows.push_back({exposure_text(exposure), fmt::format("{:.1f} %", 100 * h.sum / h.n / levels), fmt::format("{:.4f} %", 100 * h.clipped / h.n)});
    ++k;
  }
  if (k == 0) return "";
  return "<div class=row>" +
         html_figure(html_plot(data + "set logscale y\nset xrange [0:100]\nset xlabel 'raw value / % of full scale'\nset ylabel 'share of the values / %'\nset key outside right top\n" + curves + "\n",
                               {760, 400}, "histogram-", "Histogram of the raw values of every exposure time"),
                     fmt::format("Raw values by exposure time, {} views spread over the session.", std::min(n_histogram_views, s.session.views.size()))) +
         "<div>" + html_table("The same views: brightness and clipped share", {"exposure", "mean of full scale", "clipped"}, rows) + "</div></div>\n";
}

std::string thumbnails(const ReportSession& s) {
  if (!s.calibration) return "";
  std::string html;
  for (const std::size_t v : spread_views(s, n_thumbnails)) {
    const auto& view = s.session.views[v];
    if (!std::filesystem::exists(s.session.radiance_path(view))) continue;
    const calib::RadianceImage image = calib::read_radiance(s.session.radiance_path(view));
    const std::vector<bool> all(image.radiance.size(), true);
    RgbImage shown = to_picture(calib::shown_rgb(image.radiance, all, image, white_balance(*s.calibration)), true);
    shown = reduced(shown, std::max(1, shown.width / 200));
    const double factor = 0.8 * exposure_for(shown);
    const auto clipped = static_cast<double>(std::count(image.flags.begin(), image.flags.end(), calib::PixelFlag::clipped));
    html += fmt::format("<figure class=small>{}<figcaption>{}: turntable {:.1f}°, {}, {} exposure{}; {:.3g} % clipped in each of them</figcaption></figure>\n",
                        html_image(png_of(exposed(std::move(shown), factor)), "Photograph " + view.id), html_escaped(view.id), view.turntable_angle / degree,
                        html_escaped(light_name(s, view)), view.frames.size(), view.frames.size() == 1 ? "" : "s", 100 * clipped / static_cast<double>(image.flags.size()));
  }
  return html.empty() ? "" : "<h3>Views</h3>\n<div class=row>" + html + "</div>\n";
}

/// What one of our plots that go to a file drew, for the page.
template <typename Draw>
std::string drawn(const Draw& draw, PlotSize size, const std::string& id, const std::string& alt) {
  const TemporarySvg file;
  draw(file.path());
  return html_svg(brdf::read_text(file.path()), size, id, alt);
}

std::string views_text(const acquire::Session& session) {
  std::map<acquire::ViewKind, std::size_t> kinds;
  std::size_t frames = 0;
  for (const auto& view : session.views) ++kinds[view.kind], frames += view.frames.size();
  std::string text;
  for (const auto& [kind, n] : kinds) text += fmt::format("{}{} {}", text.empty() ? "" : ", ", n, acquire::name_of(kind));
  return fmt::format("{} views ({}), {} frames", session.views.size(), text, frames);
}

/// sigma of a raw value over its signal as the noise model has it, with its parts.
std::string noise_figure(const calib::Calibration& c, int bits) {
  const double gain = c.noise.gain_e_per_dn, top = calib::saturation_value(c.noise, bits) - c.noise.black_level_dn;
  if (!(gain > 0) || !(top > 1)) return "";
  std::vector<std::vector<double>> columns(5);
  for (int i = 0; i <= 100; ++i) {
    const double signal = std::pow(top, i / 100.0), shot = std::sqrt(signal / gain), read = c.noise.read_noise_e / gain, relative = c.noise.relative_noise * signal;
    const double row[] = {signal, std::sqrt(shot * shot + read * read + relative * relative), shot, read, relative > 0 ? relative : std::nan("")};
    for (std::size_t k = 0; k < columns.size(); ++k) columns[k].push_back(row[k]);
  }
  std::string script = plot_data("noise", columns) +
                       "set logscale xy\nset xlabel 'signal above black / linear DN'\nset ylabel 'standard deviation / linear DN'\n"
                       "plot $noise using 1:2 with lines lw 2.4 lc rgb black title 'all', $noise using 1:3 with lines dt 2 lc rgb blue title 'shot', "
                       "$noise using 1:4 with lines dt 3 lc rgb green title 'read'";
  if (c.noise.relative_noise > 0) script += ", $noise using 1:5 with lines dt 4 lc rgb vermilion title 'relative'";
  return html_figure(html_plot(script + "\n", {640, 420}, "noise-", "Photon transfer curve: standard deviation over signal, logarithmic"),
                     fmt::format("Photon transfer of the noise model in use ({}): gain {:.4g} e⁻/DN, read noise {:.3g} e⁻ RMS. The measured curve is drawn by lacquer calibrate noise --plot.",
                                 c.noise_source, gain, c.noise.read_noise_e));
}

}  // namespace

HtmlSection capture_section(const ReportSession& s) {
  std::string html = fmt::format("<p>Rig: {}. {}; {} × {} pixels, {}, {} bits.</p>\n", html_escaped(s.session.rig.name), views_text(s.session), s.session.rig.geometry.camera.width,
                                 s.session.rig.geometry.camera.height, html_escaped(acquire::name_of(s.session.rig.sensor.layout)), s.session.rig.sensor.bits);
  if (const std::string bracket = bracket_text(s.session); !bracket.empty()) html += "<p>" + html_escaped(bracket) + "</p>\n";
  html += histogram_figures(s) + thumbnails(s);
  if (s.calibration) {
    html += "<h3>Lights and darkness</h3>\n<pre>" + html_escaped(light_and_dark_text(*s.calibration)) + "</pre>\n";
    const TemporarySvg file;
    if (plot_drift(*s.calibration, file.path()))
      html += html_figure(html_svg(brdf::read_text(file.path()), {900, 500}, "drift-", "Intensity of the lights over time with the model of their drift"),
                          "Intensity of each light over the capture: points with standard errors, model with a band of two.", "wide");
  }
  return {"capture", "Capture", html};
}

HtmlSection sensor_section(const ReportSession& s) {
  const calib::Calibration& c = *s.calibration;
  const std::string response = drawn([&](const std::filesystem::path& file) { plot_response(c.response, c.noise.black_level_dn, file); }, {900, 900}, "response-",
                                     "Response: exposure over raw value, logarithmic, and its deviation from a power law with a 95 % band");
  return {"sensor", "Sensor: response and noise",
          "<div class=row>" +
              html_figure(response, fmt::format("Response ({}{}): exposure over raw value; below, what is left beside a power law, with its 95 % band where it was estimated.", c.response_source,
                                                c.response.linear ? ", linear" : "")) +
              noise_figure(c, s.session.rig.sensor.bits) + "</div>\n"};
}

}  // namespace lacquer::tools
