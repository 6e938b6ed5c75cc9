#include "tools/report_page.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>

#include "libbrdf/files.h"
#include "tools/drift_report.h"
#include "tools/pictures.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

using brdf::TableGrid;

constexpr const char* style = R"(<style>
:root { color-scheme: light dark; --line: #8884; --warn: #b45309; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; border-bottom: 1px solid var(--line); }
pre { overflow-x: auto; padding: .6rem; border: 1px solid var(--line); font-size: .85rem; }
.warning { border-left: 4px solid var(--warn); padding: .3rem .8rem; margin: .5rem 0; }
.row { display: flex; flex-wrap: wrap; gap: 1rem; } .row figure { flex: 1 1 18rem; max-width: 22.5rem; } figure { margin: 0; max-width: 100%; }
figcaption { font-size: .85rem; } img { max-width: 100%; height: auto; }
@media print { body { max-width: none; } }
</style>)";

std::string escaped(const std::string& s) {
  std::string out;
  for (const char c : s) {
    switch (c) {
      case '<': out += "&lt;"; break;
      case '>': out += "&gt;"; break;
      case '&': out += "&amp;"; break;
      case '"': out += "&quot;"; break;
      default: out += c;
    }
  }
  return out;
}

std::string figure(const std::string& png, const std::string& caption) {
  return fmt::format("<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption></figure>\n", escaped(caption),
                     base64(png));
}

std::vector<std::string> warnings(const Measurement& m) {
  std::vector<std::string> list;
  if (!m.fit.converged) list.push_back("The fit did not converge: " + m.fit.message);
  if (m.calibration.geometry_source == "rig file") list.push_back("Geometry (lens, sphere, lights, axis) is taken from the rig file, not estimated from the images.");
  if (!m.tabulation.table.absolute_scale) list.push_back("The scale is relative: no reference of known reflectance was measured. kd and ks are in arbitrary units.");
  const auto& counts = m.tabulation.counts;
  if (counts.clipped > 0) list.push_back(fmt::format("{} values were clipped in every exposure and are missing from the table.", counts.clipped));
  for (const auto& p : m.fit.parameters)
    if (!p.determined) list.push_back(fmt::format("{} is not determined by the data.", p.name));
  for (const auto& p : m.fit.parameters)
    if (p.determined && p.at_bound) list.push_back(fmt::format("{} stands at its bound ({:.4g}).", p.name, p.value));
  return list;
}

/// Slices of table, fit and their log ratio, green (or only) channel.
std::string slices(const Measurement& m) {
  const auto& channel = m.tabulation.table.channels[m.tabulation.table.channels.size() / 2];
  const int colour = m.tabulation.table.channels.size() == 3 ? 1 : 0;
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (int h = 0; h < TableGrid::n_theta_h; ++h)
    for (int d = 0; d < TableGrid::n_theta_d; ++d) {
      const std::size_t i = TableGrid::index(TableGrid::Cell{h, d, TableGrid::n_phi_d / 2});
      if (!brdf::has_value(channel.origin[i]) || !(channel.mean[i] > 0)) continue;
      low = std::min(low, std::log10(static_cast<double>(channel.mean[i])));
      high = std::max(high, std::log10(static_cast<double>(channel.mean[i])));
    }
  if (!(high > low)) return "<p>No positive value in this slice.</p>\n";

  const auto table = [&](const TableGrid::Cell& c) -> std::optional<double> {
    const std::size_t i = TableGrid::index(c);
    if (!brdf::has_value(channel.origin[i]) || !(channel.mean[i] > 0)) return std::nullopt;
    return std::log10(static_cast<double>(channel.mean[i]));
  };
  const auto fit = [&](const TableGrid::Cell& c) -> std::optional<double> {
    if (!TableGrid::reachable(c, 0.02)) return std::nullopt;
    return m.fit.model.log_value(brdf::half_angle_cosines(TableGrid::centre(c)))[colour] / std::log(10.0);
  };
  const auto ratio = [&](const TableGrid::Cell& c) -> std::optional<double> {
    const std::size_t i = TableGrid::index(c);
    if (!table(c)) return std::nullopt;
    const brdf::HalfDiff at{channel.theta_h[i], channel.theta_d[i], channel.phi_d[i]};  // where the samples were
    return m.fit.model.log_value(brdf::half_angle_cosines(at))[colour] - std::log(static_cast<double>(channel.mean[i]));
  };
  return "<div class=row>" + figure(slice_png(table, low, high, "log10 1/sr"), "Table at phi_d = 90 degrees; grey: nothing measured") +
         figure(slice_png(fit, low, high, "log10 1/sr"), "Fit at the same cells") +
         figure(slice_png(ratio, -0.1, 0.1, "ln ratio"), "ln(fit / table), within 10 percent dark to bright") + "</div>\n";
}

std::string spheres(const Measurement& m, const brdf::CookTorrance* truth) {
  std::string html = "<div class=row>";
  if (truth) html += figure(sphere_png(brdf::CookTorranceBrdf(*truth), 256), "Truth");
  html += figure(sphere_png(brdf::CookTorranceBrdf(m.fit.model), 256), "Fit");
  html += figure(sphere_png(brdf::TableBrdf(m.tabulation.table, "table"), 256), "Table (dark: nothing measured)");
  return html + "</div>\n";
}

std::string view_errors(const std::vector<calib::ViewError>& errors) {
  std::string html = "<details><summary>Error of every photograph</summary><pre>view      rel. RMS   mean |ln|   mean ln\n";
  for (const auto& e : errors)
    html += fmt::format("{:<8} {:>7.2f} % {:>10.4f} {:>+9.4f}\n", escaped(e.view), 100 * e.relative_rms, e.mean_abs_log, e.bias_log);
  return html + "</pre></details>\n";
}

}  // namespace

void write_report(const std::filesystem::path& session, const acquire::RigDescription& rig, const Measurement& m,
                  const brdf::CookTorrance* truth, const std::optional<brdf::BrdfDifference>& against_truth) {
  const auto section = [](const std::string& title, const std::string& body) {
    return fmt::format("<section><h2>{}</h2>\n{}</section>\n", title, body);
  };
  const auto preformatted = [](const std::string& body) { return "<pre>" + escaped(body) + "</pre>\n"; };

  std::string html = "<!doctype html>\n<html lang=en><head><meta charset=utf-8><meta name=viewport content=\"width=device-width\">";
  const std::string name = escaped(session.filename().empty() ? session.parent_path().filename().string() : session.filename().string());
  html += fmt::format("<title>Lacquer: {0}</title>{1}</head><body>\n<h1>Lacquer: {0}</h1>\n<p>Rig: {2}. {3} views, {4} frames.</p>\n", name,
                      style, escaped(rig.name), m.n_views, m.n_frames);
  for (const auto& w : warnings(m)) html += "<div class=warning role=note>" + escaped(w) + "</div>\n";

  html += section(truth ? "Parameters beside the truth" : "Parameters",
                  preformatted(parameter_table(m.fit, truth)) +
                      preformatted(fmt::format("fit to the table: mean |ln| {:.5f}, rms {:.5f}, chi2/n {:.2f}, {} of {} cells\nresponse: {}\nnoise: {}\n"
                                               "geometry: {}\nscale: {}\n",
                                               m.fit.mean_abs_log, m.fit.rms_log, m.fit.reduced_chi2, m.fit.n_cells, m.fit.n_cells_available,
                                               m.calibration.response_source, m.calibration.noise_source, m.calibration.geometry_source,
                                               m.calibration.scale_source)) +
                      preformatted(light_and_dark_text(m.calibration)));
  if (against_truth) html += section("Fit against the truth", preformatted(difference_text(*against_truth)));
  html += section("Photographs re-rendered from the fit",
                  figure(brdf::read_text(session / "rerendered.png"), "Photograph, re-rendering and difference of views spread over the session") +
                      view_errors(m.view_errors));
  html += section("Table and fit", preformatted(coverage_text(m.tabulation)) + slices(m));
  html += section("Lit spheres", spheres(m, truth));
  std::string times;
  for (const auto& [stage, seconds] : m.seconds) times += fmt::format("{:<14} {:>8.2f} s\n", stage, seconds);
  html += section("Time of every stage", preformatted(times));
  html += section("Provenance", preformatted(m.tabulation.table.provenance_json));
  html += "</body></html>\n";
  brdf::write_text_atomically(session / "report.html", html);
}

}  // namespace lacquer::tools
