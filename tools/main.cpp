#include <algorithm>
#include <cctype>
#include <csignal>
#include <cstring>
#include <iostream>

#include <malloc.h>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "tools/command.h"

namespace {

/// As one would type it into a shell.
std::string quoted(const std::string& argument) {
  const auto plain = [](unsigned char c) { return std::isalnum(c) || std::strchr("_-+=./:,@%", c); };
  if (!argument.empty() && std::all_of(argument.begin(), argument.end(), plain)) return argument;
  std::string text = "'";
  for (const char c : argument) text += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return text + "'";
}

std::string join_arguments(int argc, char** argv) {
  std::string line = "lacquer";
  for (int i = 1; i < argc; ++i) line += " " + quoted(argv[i]);
  return line;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace lacquer;
  // Frames and images come and go by the thousand: handing their memory back each time costs a third of the time of merging.
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, 256 << 20);
  CLI::App app{"Lacquer: from a painted sphere on a turntable to a BRDF with error bars", "lacquer"};
  app.set_version_flag("--version", std::string("lacquer ") + brdf::version());
  app.require_subcommand(1);
  app.fallthrough();

  tools::Context context;
  context.command_line = join_arguments(argc, argv);
  app.add_flag("-q,--quiet", context.quiet, "no progress and no notes on stderr, errors only");

  tools::add_measure(app, context);
  tools::add_capture(app, context);
  tools::add_devices(app, context);
  tools::add_merge(app, context);
  tools::add_calibrate(app, context);
  tools::add_tabulate(app, context);
  tools::add_fill(app, context);
  tools::add_check(app, context);
  tools::add_fit(app, context);
  tools::add_eval(app, context);
  tools::add_compare(app, context);
  tools::add_convert(app, context);
  tools::add_rerender(app, context);
  tools::add_report(app, context);
  tools::add_plot(app, context);
  tools::add_documentation(app);

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  } catch (const Error& e) {
    std::cerr << tools::emphasised("lacquer:", tools::Emphasis::error, stderr) << " " << e.what() << "\n";
    switch (e.code()) {
      case ErrorCode::usage: return 2;
      case ErrorCode::interrupted: return 130;
      default: return 1;
    }
  } catch (const std::exception& e) {
    std::cerr << tools::emphasised("lacquer: internal error:", tools::Emphasis::error, stderr) << " " << e.what() << "\n";
    return 1;
  }
  return 0;
}
