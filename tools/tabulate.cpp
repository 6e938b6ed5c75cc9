#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/session.h"
#include "libbrdf/files.h"
#include "libbrdf/physical_checks.h"
#include "libcalib/calibration.h"
#include "libcalib/samples.h"
#include "tools/json_output.h"
#include "tools/geometry_provenance.h"
#include "tools/summary.h"

namespace lacquer::tools {

void add_tabulate(CLI::App& app, Context& context) {
  struct Options {
    std::string session, output, calibration;
    calib::SampleOptions samples;
    double max_theta_deg = 85;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("tabulate", "radiance + geometry -> half-angle table 90 x 90 x 180");
  command->add_option("session", options->session, "session folder with merged radiance images")->required();
  command->add_option("-o,--output", options->output, "table to write (default: SESSION/table.exr)");
  command->add_option("--calibration", options->calibration, "calibration to use (default: SESSION/calibration.json)");
  command->add_option("--max-theta-deg", options->max_theta_deg, "leave out light and camera directions beyond this")->capture_default_str();
  command->add_option("--edge-px", options->samples.edge_px, "leave out pixels this close to the silhouette")->capture_default_str();
  add_json_option(*command, context);
  command->callback([options, &context] {
    const std::filesystem::path folder = options->session;
    options->samples.min_cosine = cosine_of_degrees("--max-theta-deg", options->max_theta_deg);
    const acquire::Session session = acquire::read_session(folder);
    const std::filesystem::path calibration_file = options->calibration.empty() ? folder / "calibration.json" : std::filesystem::path(options->calibration);
    const calib::Calibration calibration = calib::read_calibration(calibration_file);
    calib::Tabulation result = calib::tabulate_session(session, calibration, options->samples, stderr_progress(context));
    auto provenance = nlohmann::ordered_json::parse(provenance_json(context, {(folder / "session.json").string(), calibration_file.string()}));
    std::string repeatability = "mirror cells (phi_d, 180 deg - phi_d)    pairs   scatter of ln   promised      bias\n";
    const auto& channels = result.table.channels;
    for (std::size_t c = 0; c < channels.size(); ++c) {
      const brdf::MirrorRepeatability r = brdf::mirror_repeatability(channels[c]);
      provenance["mirror"].push_back({{"pairs", r.n_pairs}, {"bias_log", r.bias_log}, {"scatter_log", r.scatter_log}, {"expected_log", r.expected_log}});
      repeatability += fmt::format("  {:<37} {:>6} {:>15.4f} {:>10.4f} {:>+9.4f}\n", channels.size() == 3 ? "RGB"[c] : 'Y', r.n_pairs, r.scatter_log, r.expected_log, r.bias_log);
    }
    std::size_t n_measured = 0, n_narrow = 0;
    const auto& middle = result.table.channels[result.table.channels.size() / 2];
    for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
      n_measured += middle.origin[i] == brdf::CellOrigin::measured;
      n_narrow += middle.origin[i] == brdf::CellOrigin::measured && brdf::smaller_than_footprint(middle, i);
    }
    repeatability += fmt::format("cells narrower in theta_h than a pixel's footprint: {} of {}\n", n_narrow, n_measured);
    result.table.provenance_json = with_geometry_sigma(provenance.dump(), result.geometry_sigma);
    const std::filesystem::path output = options->output.empty() ? folder / "table.exr" : std::filesystem::path(options->output);
    brdf::write_table(output, result.table);
    if (context.json) {
      auto j = json_result(context, {(folder / "session.json").string(), calibration_file.string()});
      j.update(to_json(result));
      j["mirror"] = provenance["mirror"];
      j["narrower_than_footprint"] = n_narrow;
      j["table"] = output.string();
      return print_json(j);
    }
    fmt::print("{}\n{}table: {}\n", coverage_text(result), repeatability, output.string());
  });
}

}  // namespace lacquer::tools
