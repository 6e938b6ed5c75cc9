#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "tools/brdf_plots.h"
#include "tools/json_output.h"
#include "tools/environment.h"
#include "tools/report_page.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::string kind, output, probe;
  std::vector<std::string> files;
  std::vector<double> incidence_deg{10, 30, 50, 70};
  int size = 512, phi_d_deg = 90;
};

[[noreturn]] void fail(const std::string& what) { throw Error(ErrorCode::usage, what); }

Plot plot_of(const Options& o, const std::vector<ReportBrdf>& brdfs) {
  std::vector<NamedBrdf> named;
  for (const auto& b : brdfs) named.push_back({b.name, b.brdf.get()});
  const brdf::Brdf& first = *brdfs[0].brdf;
  if (o.kind == "log") return log_plot(named, o.incidence_deg);
  if (o.kind == "polar") return polar_plot(named, o.incidence_deg);
  const bool of_two = o.kind == "ratio" || o.kind == "delta-e";
  if (brdfs.size() != (of_two ? 2u : 1u)) fail(fmt::format("{}: expected {}, got {}", o.kind, of_two ? "two BRDF files" : "one BRDF file", brdfs.size()));
  const int phi_d = o.phi_d_deg % 180;
  if (o.kind == "slice") return slice_plot(log_slice(first, phi_d), brdfs[0].name);
  if (o.kind == "ratio") return slice_plot(log_ratio_slice(first, *brdfs[1].brdf, phi_d), fmt::format("ln({} / {})", brdfs[1].name, brdfs[0].name));
  if (o.kind == "coverage") {
    const auto* table = dynamic_cast<const brdf::TableBrdf*>(&first);
    if (!table) fail(fmt::format("{}: coverage: expected a table", o.files[0]));
    return slice_plot(coverage_slice(table->table()), brdfs[0].name);
  }
  const DeltaE d = delta_e(to_image(brdf::render_lit_sphere(first, o.size)), to_image(brdf::render_lit_sphere(*brdfs[1].brdf, o.size)));
  return delta_e_plot(d, fmt::format("{} against {}", brdfs[1].name, brdfs[0].name));
}

std::string sphere_png(const Options& o, const ReportBrdf& b) {
  if (o.kind == "sphere") {
    RgbImage image = to_image(brdf::render_lit_sphere(*b.brdf, o.size));
    const auto* table = dynamic_cast<const brdf::TableBrdf*>(b.brdf.get());
    if (table && !table->table().absolute_scale) image = exposed(std::move(image), exposure_for(image));
    return png_of(image);
  }
  const auto probe = o.probe.empty() ? default_probe() : std::optional<std::filesystem::path>(o.probe);
  if (!probe) fail("--probe: no light probe is installed; expected an OpenEXR file");
  RgbImage image = render_probe_sphere(*b.brdf, Environment(*probe), o.size).image;
  return png_of(exposed(std::move(image), exposure_for(image)));
}

void run(const Options& o, const Context& context) {
  const std::vector<ReportBrdf> brdfs = load_named_brdfs(o.files);
  if (o.kind == "sphere" || o.kind == "probe") {
    if (std::filesystem::path(o.output).extension() != ".png") fail(fmt::format("{}: {}: expected a file that ends in .png", o.output, o.kind));
    if (brdfs.size() != 1) fail(fmt::format("{}: expected one BRDF file, got {}", o.kind, brdfs.size()));
    brdf::write_text_atomically(o.output, sphere_png(o, brdfs[0]));
  } else {
    check_plot_name(o.output);
    const Plot plot = plot_of(o, brdfs);
    gnuplot(plot.script, o.output, plot.size);
  }
  if (context.json) {
    auto j = json_result(context, o.files);
    j["kind"] = o.kind;
    j["picture"] = o.output;
    return print_json(j);
  }
  if (!context.quiet) fmt::print(stderr, "{}: {}\n", o.kind, o.output);
}

}  // namespace

void add_plot(CLI::App& app, Context& context) {
  auto o = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("plot", "a single picture of BRDF files, PNG or SVG");
  command->add_option("kind", o->kind,
                      "log, polar: lobes in the plane of incidence of any number of BRDFs; slice: theta_h x theta_d; ratio: ln(B / A) as a slice; coverage: of a table; "
                      "sphere, probe: lit by a point light or a light probe; delta-e: CIEDE2000 of two lit spheres")
      ->required()
      ->check(CLI::IsMember({"log", "polar", "slice", "ratio", "coverage", "sphere", "probe", "delta-e"}));
  command->add_option("files", o->files, "table.exr, fit.json, MERL .binary, RGL .bsdf")->required();
  command->add_option("-o,--output", o->output, "picture to write, .svg or .png (sphere, probe: .png)")->required();
  command->add_option("--incidence-deg", o->incidence_deg, "angles of the light, for log and polar")->delimiter(',')->check(CLI::Range(0.0, 85.0));
  command->add_option("--phi-d-deg", o->phi_d_deg, "phi_d of a slice, whole degrees")->capture_default_str()->check(CLI::Range(0, 179));
  command->add_option("--size", o->size, "pixels of a sphere")->capture_default_str()->check(CLI::Range(16, 2048));
  command->add_option("--probe", o->probe, "light probe, OpenEXR, latitude-longitude (default: the studio that comes with Lacquer)");
  add_json_option(*command, context);
  command->callback([o, &context] { run(*o, context); });
}

}  // namespace lacquer::tools
