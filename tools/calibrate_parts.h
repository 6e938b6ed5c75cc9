#pragma once

#include "tools/command.h"

/// Subcommands of `lacquer calibrate`, one source file each.
namespace lacquer::tools {

void add_calibrate_camera(CLI::App& calibrate, Context& context);
void add_calibrate_geometry(CLI::App& calibrate, Context& context);
void add_calibrate_noise(CLI::App& calibrate, Context& context);
void add_calibrate_response(CLI::App& calibrate, Context& context);
void add_calibrate_scale(CLI::App& calibrate, Context& context);

}  // namespace lacquer::tools
