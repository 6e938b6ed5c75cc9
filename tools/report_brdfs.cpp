#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <numbers>

#include "libbrdf/metrics.h"
#include "tools/brdf_plots.h"
#include "tools/environment.h"
#include "tools/report_page.h"

namespace lacquer::tools {

namespace {

std::vector<NamedBrdf> named(const std::vector<ReportBrdf>& brdfs) {
  std::vector<NamedBrdf> list;
  for (const auto& b : brdfs) list.push_back({b.name, b.brdf.get()});
  return list;
}

std::string plot_figure(const Plot& plot, const std::string& id, const std::string& caption) {
  return html_figure(html_plot(plot.script, plot.size, id, plot.alt), caption);
}

/// A slice whose values can be read under the pointer or by arrow keys.
std::string slice_figure(const Slice& slice, const std::string& title, const std::string& id, const std::string& caption) {
  const Plot plot = slice_plot(slice, title);
  return fmt::format("<figure data-low={:g} data-high={:g} data-unit=\"{}\"{} data-values=\"{}\">{}<output></output><figcaption>{}</figcaption></figure>\n", slice.low,
                     slice.high, html_escaped(slice.unit), slice.logarithmic ? " data-log=1" : "", slice_codes(slice), html_plot(plot.script, plot.size, id, plot.alt),
                     html_escaped(caption));
}

const brdf::HalfAngleTable* table_of(const ReportBrdf& b) {
  const auto* table = dynamic_cast<const brdf::TableBrdf*>(b.brdf.get());
  return table ? &table->table() : nullptr;
}

bool has_filled(const brdf::HalfAngleTable& table) {
  for (const auto origin : table.channels[table.channels.size() / 2].origin)
    if (origin == brdf::CellOrigin::filled || origin == brdf::CellOrigin::modelled) return true;
  return false;
}

/// The log slice of a table without cells that were filled.
Slice measured_slice(const brdf::TableBrdf& table) {
  Slice slice = log_slice(table);
  const auto& channel = table.table().channels[table.table().channels.size() / 2];
  for (int h = 0; h < brdf::TableGrid::n_theta_h; ++h)
    for (int d = 0; d < brdf::TableGrid::n_theta_d; ++d) {
      const auto origin = channel.origin[brdf::TableGrid::index(brdf::TableGrid::Cell{h, d, brdf::TableGrid::n_phi_d / 2})];
      if (origin == brdf::CellOrigin::filled || origin == brdf::CellOrigin::modelled)
        slice.values[static_cast<std::size_t>(h * brdf::TableGrid::n_theta_d + d)] = std::numeric_limits<double>::quiet_NaN();
    }
  return slice;
}

}  // namespace

HtmlSection comparison_section(const std::vector<ReportBrdf>& brdfs, const ReportOptions& options) {
  std::vector<std::vector<std::string>> rows;
  const auto add = [&](const ReportBrdf& a, const ReportBrdf& b) {
    brdf::CompareOptions compare;
    compare.max_theta = options.max_theta_deg * std::numbers::pi / 180;
    const brdf::BrdfDifference d = brdf::compare(*a.brdf, *b.brdf, compare);
    rows.push_back({b.name + " against " + a.name, fmt::format("{:.5f}", d.mean_abs_log), fmt::format("{:.5f}", d.rms_log), fmt::format("{:+.5f}", d.bias_log),
                    fmt::format("{:.4f}", d.max_abs_log), fmt::format("{:.3f} %", 100 * d.cosine_rms), d.n_pixels ? fmt::format("{:.3f}", d.delta_e_mean) : "–",
                    d.n_pixels ? fmt::format("{:.3f}", d.delta_e_p95) : "–", fmt::format("{}", d.n_directions)});
  };
  // Of a simulated session what counts comes first.
  const auto named_as = [&](const char* name) { return std::find_if(brdfs.begin(), brdfs.end(), [&](const ReportBrdf& b) { return b.name == name; }); };
  if (const auto fit = named_as("fit"), truth = named_as("truth"); fit != brdfs.end() && truth != brdfs.end() && fit != brdfs.begin()) add(*truth, *fit);
  for (std::size_t i = 1; i < brdfs.size(); ++i) add(brdfs[0], brdfs[i]);
  return {"comparison", "Comparison",
          html_table(fmt::format("Light and camera within {:g}° of the normal; ln is the natural logarithm of the ratio", options.max_theta_deg),
                     {"BRDFs", "mean |ln|", "rms ln", "mean ln", "largest |ln|", "cosine-weighted RMS", "ΔE2000 mean", "ΔE2000 95th pct", "directions"}, rows)};
}

HtmlSection lobes_section(const std::vector<ReportBrdf>& brdfs) {
  const std::vector<double> angles{10, 30, 50, 70};
  const std::string caption = brdfs.size() > 1 ? " Points: " + brdfs[0].name + "; lines: the others." : "";
  return {"lobes", "Lobes",
          "<div class=row>" + plot_figure(log_plot(named(brdfs), angles), "log-", "f_r in the plane of incidence, logarithmic, for light at 10°, 30°, 50°, 70°." + caption) +
              plot_figure(polar_plot(named(brdfs), angles), "polar-", "The same as lobes; the radius is the cube root of f_r." + caption) + "</div>\n"};
}

HtmlSection slices_section(const std::vector<ReportBrdf>& brdfs) {
  std::vector<Slice> slices;
  std::vector<std::string> titles, captions;
  for (const auto& b : brdfs) {
    const auto* table = dynamic_cast<const brdf::TableBrdf*>(b.brdf.get());
    const bool filled = table && has_filled(table->table());
    if (table) {
      slices.push_back(measured_slice(*table));
      titles.push_back(b.name + ", measured");
      captions.push_back("Cells that were measured, or known by mirror symmetry; nothing is interpolated.");
    }
    if (!table || filled) {
      slices.push_back(log_slice(*b.brdf));
      titles.push_back(filled ? b.name + ", with filled cells" : b.name);
      captions.push_back(filled ? "The same with the cells that were filled." : "At the cells' centres.");
    }
  }
  std::vector<Slice*> all;
  for (auto& slice : slices) all.push_back(&slice);
  share_range(all);
  std::string html = "<p>Half-angle slices at φ<sub>d</sub> = 90°, green channel. θ<sub>h</sub> is fine at the peak. Point at a picture, or focus it and use the arrow keys, to read values.</p>\n<div class=row>";
  int n = 0;
  for (std::size_t i = 0; i < slices.size(); ++i) html += slice_figure(slices[i], titles[i], fmt::format("slice{}-", n++), captions[i]);
  for (std::size_t i = 1; i < brdfs.size(); ++i)
    html += slice_figure(log_ratio_slice(*brdfs[0].brdf, *brdfs[i].brdf), fmt::format("ln({} / {})", brdfs[i].name, brdfs[0].name), fmt::format("slice{}-", n++),
                         fmt::format("Residual: red, {} is larger.", brdfs[i].name));
  const auto* first = table_of(brdfs[0]);
  for (std::size_t i = 1; first && i < brdfs.size(); ++i)
    if (const auto* model = dynamic_cast<const brdf::CookTorranceBrdf*>(brdfs[i].brdf.get()))
      html += slice_figure(residual_slice(*first, model->model()), fmt::format("mean ln({} / {}) over phi_d", brdfs[i].name, brdfs[0].name), fmt::format("slice{}-", n++),
                           "Residual, mean over all φd and channels: what is left here is the model's, or the geometry's, not noise.");
  for (const auto& b : brdfs)
    if (const auto* table = table_of(b))
      html += slice_figure(coverage_slice(*table), b.name + ", coverage", fmt::format("slice{}-", n++), "Share of the reachable cells over all φd that were measured or are known by symmetry.");
  return {"slices", "Half-angle slices and coverage", html + "</div>\n"};
}

namespace {

constexpr int sphere_px = 200;

/// Spheres side by side, and the difference of each from the first.
std::string sphere_row(const std::vector<std::string>& names, const std::vector<RgbImage>& images, const std::string& light, const std::string& id) {
  std::string html = "<div class=row>";
  for (std::size_t i = 0; i < images.size(); ++i)
    html += fmt::format("<figure class=small>{}<figcaption>{}</figcaption></figure>\n", html_image(png_of(images[i]), names[i] + ", sphere under " + light), html_escaped(names[i]));
  for (std::size_t i = 1; i < images.size(); ++i) {
    const DeltaE d = delta_e(images[0], images[i]);
    if (d.n == 0) continue;
    const Plot plot = delta_e_plot(d, names[i] + " against " + names[0]);
    html += html_figure(html_plot(plot.script, plot.size, fmt::format("{}{}-", id, i), plot.alt), fmt::format("ΔE2000 {:.2f} mean, {:.2f} 95th percentile.", d.mean, d.p95), "medium");
  }
  return html + "</div>\n";
}

}  // namespace

HtmlSection spheres_section(const std::vector<ReportBrdf>& brdfs, const ReportOptions& options) {
  std::vector<std::string> names;
  std::vector<RgbImage> images;
  for (const auto& b : brdfs) {
    names.push_back(b.name);
    images.push_back(to_image(brdf::render_lit_sphere(*b.brdf, sphere_px)));
  }
  const bool relative = table_of(brdfs[0]) && !table_of(brdfs[0])->absolute_scale;
  if (relative) {
    const double factor = exposure_for(images[0]);
    for (auto& image : images) image = exposed(std::move(image), factor);
  }
  std::string html = fmt::format("<h3>Under a point light, 30° right and above</h3>\n<p>{} Nothing is drawn where a BRDF says nothing.</p>\n",
                                 relative ? "The scale is relative; the brightest 1 % of the first sphere is white." : "A white Lambertian sphere that faces the light is white.") +
                     sphere_row(names, images, "a point light", "de-point");

  const auto probe = options.probe.empty() ? default_probe() : std::optional(options.probe);
  if (!probe) return {"spheres", "Lit spheres", html + "<p>No light probe is installed: the spheres under a light probe are left out (--probe gives one).</p>\n"};
  const Environment environment(*probe);
  const brdf::Brdf* fallback = nullptr;
  std::string fallback_name, note;
  for (const auto& b : brdfs)
    if (!fallback && !table_of(b)) fallback = b.brdf.get(), fallback_name = b.name;
  images.clear();
  for (const auto& b : brdfs) {
    ProbeSphere sphere = render_probe_sphere(*b.brdf, environment, sphere_px * 16 / 25, table_of(b) ? fallback : nullptr, 160);
    if (sphere.fallback_share > 0) note += fmt::format(" Holes of {} are filled with {}: {:.1f} % of its light.", b.name, fallback_name, 100 * sphere.fallback_share);
    images.push_back(std::move(sphere.image));
  }
  const double factor = exposure_for(images[0]);
  for (auto& image : images) image = exposed(std::move(image), factor);
  html += fmt::format("<h3>Under the light probe {}</h3>\n<p>The brightest 1 % of the first sphere is white.{}</p>\n", html_escaped(probe->filename().string()), html_escaped(note)) +
          sphere_row(names, images, "a light probe", "de-probe");
  return {"spheres", "Lit spheres", html};
}

}  // namespace lacquer::tools
