#include <fmt/format.h>

#include <filesystem>
#include <memory>

#include "libacquire/session.h"
#include "libbrdf/files.h"
#include "libcalib/calibration.h"
#include "libcalib/samples.h"
#include "tools/command.h"
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
  command->callback([options, &context] {
    const std::filesystem::path folder = options->session;
    options->samples.min_cosine = cosine_of_degrees("--max-theta-deg", options->max_theta_deg);
    const acquire::Session session = acquire::read_session(folder);
    const std::filesystem::path calibration_file = options->calibration.empty() ? folder / "calibration.json" : std::filesystem::path(options->calibration);
    const calib::Calibration calibration = calib::read_calibration(calibration_file);
    calib::Tabulation result = calib::tabulate_session(session, calibration, options->samples, stderr_progress(context));
    result.table.provenance_json = provenance_json(context, {(folder / "session.json").string(), calibration_file.string()});
    const std::filesystem::path output = options->output.empty() ? folder / "table.exr" : std::filesystem::path(options->output);
    brdf::write_table(output, result.table);
    fmt::print("{}\ntable: {}\n", coverage_text(result), output.string());
  });
}

}  // namespace lacquer::tools
