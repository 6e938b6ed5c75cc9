#include "tools/calibrate_parts.h"
#include "tools/command.h"

namespace lacquer::tools {

void add_calibrate(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("calibrate", "boards, brackets, highlights -> calibration.json");
  command->require_subcommand(1);
  add_calibrate_camera(*command, context);
  add_calibrate_noise(*command, context);
  add_calibrate_response(*command, context);
  add_calibrate_geometry(*command, context);
  add_calibrate_scale(*command, context);
}

}  // namespace lacquer::tools
