#include <fmt/format.h>

#include <filesystem>
#include <memory>

#include "libacquire/session.h"
#include "libcalib/calibration.h"
#include "libcalib/merge_session.h"
#include "tools/calibrate_parts.h"
#include "tools/command.h"

namespace lacquer::tools {

void add_calibrate(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("calibrate", "boards, brackets, highlights -> calibration.json");
  command->require_subcommand(1);
  add_calibrate_noise(*command, context);
  add_calibrate_response(*command, context);

  auto session_folder = std::make_shared<std::string>();
  CLI::App* geometry = command->add_subcommand(
      "geometry", "take lens, sphere, turntable axis and lights over from the session's rig file (nothing is estimated)");
  geometry->add_option("session", *session_folder, "session folder")->required();
  geometry->callback([session_folder, &context] {
    const acquire::Session session = acquire::read_session(*session_folder);
    const std::filesystem::path file = session.folder / "calibration.json";
    // Response, noise and drift that were found already stay.
    calib::Calibration calibration = std::filesystem::exists(file) ? calib::read_calibration(file) : calib::sensor_calibration(session, stderr_progress(context));
    calibration.geometry = session.rig.geometry;
    calibration.geometry_source = "rig file";
    calib::write_calibration(file, calibration, provenance_json(context, {(session.folder / "rig.toml").string()}));
    fmt::print("geometry: {}\nscale: {}\ncalibration: {}\n", calibration.geometry_source, calibration.scale_source, file.string());
  });
}

}  // namespace lacquer::tools
