#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libcalib/rerender.h"
#include "libcalib/samples.h"
#include "tools/brdf_plots.h"
#include "tools/measure_record.h"
#include "tools/report_page.h"
#include "tools/report_views.h"

namespace lacquer::tools {

namespace {

constexpr std::size_t n_views = 3;

/// Smallest rectangle that holds what is covered, a little larger.
acquire::PixelRectangle box_of(const RgbImage& image) {
  int x0 = image.width, y0 = image.height, x1 = -1, y1 = -1;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      if (image.covered[static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x)]) {
        x0 = std::min(x0, x);
        x1 = std::max(x1, x);
        y0 = std::min(y0, y);
        y1 = std::max(y1, y);
      }
  return {x0 - 3, y0 - 3, x1 - x0 + 7, y1 - y0 + 7};
}

std::string view_row(const ReportSession& s, const calib::Sampler& sampler, std::size_t v) {
  const auto& view = s.session.views[v];
  const calib::Calibration& c = *s.calibration;
  const calib::RadianceImage image = calib::read_radiance(s.session.radiance_path(view));
  const glm::dvec3 balance = white_balance(c);
  std::vector<std::string> names{"photograph"};
  std::vector<RgbImage> pictures;
  for (const auto& b : s.brdfs) {
    if (b.name == "truth") continue;
    const auto prediction = sampler.predict_view(*b.brdf, calib::illumination_of(view, c));
    if (pictures.empty()) pictures.push_back(to_picture(calib::shown_rgb(image.radiance, std::vector<bool>(image.radiance.size(), true), image, balance), true));
    names.push_back(b.name);
    pictures.push_back(to_picture(calib::shown_rgb(prediction.radiance, prediction.used, image, balance), false));
  }
  const RgbImage& last = pictures.back();  // the fit, if there is one: it has no holes
  const acquire::PixelRectangle box = box_of(last);
  double factor = 1;
  std::string html;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    if (i == 0) {
      RgbImage lit = pictures[0];
      lit.covered = last.covered;
      factor = 0.8 * exposure_for(lit);
    }
    pictures[i] = exposed(cropped(pictures[i], box), factor);
    html += fmt::format("<figure class=small>{}<figcaption>{}</figcaption></figure>\n", html_image(png_of(pictures[i]), fmt::format("{}, view {}", names[i], view.id)), html_escaped(names[i]));
  }
  for (std::size_t i = 1; i < pictures.size(); ++i) {
    const DeltaE d = delta_e(pictures[0], pictures[i]);
    if (d.n == 0) continue;
    const Plot plot = delta_e_plot(d, names[i] + " against photograph");
    html += html_figure(html_plot(plot.script, plot.size, fmt::format("view{}-{}-", v, i), plot.alt), fmt::format("ΔE2000 {:.2f} mean, {:.2f} 95th percentile.", d.mean, d.p95), "medium");
  }
  return fmt::format("<h3>{}, {}</h3>\n<div class=row>{}</div>\n", html_escaped(view.id), html_escaped(light_name(s, view)), html);
}

std::string errors_figure(const std::vector<calib::ViewError>& errors) {
  std::vector<std::vector<double>> columns(3);
  std::vector<std::vector<std::string>> rows;
  std::vector<double> sorted;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const auto& e = errors[i];
    columns[0].push_back(static_cast<double>(i));
    const bool seen = e.n_values > 0;  // a light behind the sphere shows nothing
    columns[1].push_back(seen ? 100 * e.relative_rms : std::nan(""));
    columns[2].push_back(seen ? 100 * e.bias_log : std::nan(""));
    if (seen) sorted.push_back(e.relative_rms);
    rows.push_back({e.view, fmt::format("{:.2f} %", 100 * e.relative_rms), fmt::format("{:.4f}", e.mean_abs_log), fmt::format("{:+.4f}", e.bias_log), fmt::format("{}", e.n_values)});
  }
  if (sorted.empty()) return "";
  std::sort(sorted.begin(), sorted.end());
  return html_figure(html_plot(plot_data("e", columns) + "set xlabel 'view'\nset ylabel 'per cent'\nset key outside top horizontal\n"
                                                         "plot $e using 1:2 with linespoints lc rgb blue title 'relative RMS', $e using 1:3 with linespoints lc rgb vermilion title 'mean ln(fit / photograph)'\n",
                               {900, 320}, "errors-", "Error of the re-rendering over the views"),
                     fmt::format("Every photograph against the fit: relative RMS {:.2f} % median, {:.2f} % worst.", 100 * sorted[sorted.size() / 2], 100 * sorted.back()), "wide") +
         "<details><summary>Error of every photograph</summary>" + html_table("Photographs against the fit", {"view", "relative RMS", "mean |ln|", "mean ln", "values"}, rows) + "</details>\n";
}

}  // namespace

HtmlSection photographs_section(const ReportSession& s) {
  const calib::Sampler sampler(*s.calibration, s.session.rig.mask, s.session.rig.sensor.layout, calib::SampleOptions{});
  std::string html = "<p>Photographs beside what table and fit show in the same light, all at one exposure; a mosaic is shown at half size. Nothing is drawn where the table has no cell.</p>\n";
  for (const std::size_t v : spread_views(s, n_views))
    if (std::filesystem::exists(s.session.radiance_path(s.session.views[v]))) html += view_row(s, sampler, v);
  if (const auto record = read_measure_record(s.session.folder / "measure.json"); record && !record->view_errors.empty()) html += errors_figure(record->view_errors);
  return {"photographs", "Photographs re-rendered", html};
}

}  // namespace lacquer::tools
