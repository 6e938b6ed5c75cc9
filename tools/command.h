#pragma once

#include <CLI/CLI.hpp>
#include <cstdio>
#include <string>

#include "libbrdf/progress.h"

/// What every subcommand shares. One source file per subcommand under tools/; each defines one add_* function that declares the
/// options and sets a callback: parse, call one library function, print. Results on stdout, talk on stderr.
namespace lacquer::tools {

struct Context {
  std::string command_line;  ///< as typed, for provenance
  bool quiet = false;        ///< no talk on stderr but errors
  bool json = false;         ///< results on stdout as one JSON object
};

/// --json of a command that prints a result.
void add_json_option(CLI::App& command, Context& context);

void add_capture(CLI::App& app, Context& context);
void add_devices(CLI::App& app, Context& context);
void add_merge(CLI::App& app, Context& context);
void add_calibrate(CLI::App& app, Context& context);
void add_tabulate(CLI::App& app, Context& context);
void add_fill(CLI::App& app, Context& context);
void add_check(CLI::App& app, Context& context);
void add_fit(CLI::App& app, Context& context);
void add_eval(CLI::App& app, Context& context);
void add_compare(CLI::App& app, Context& context);
void add_convert(CLI::App& app, Context& context);
void add_rerender(CLI::App& app, Context& context);
void add_measure(CLI::App& app, Context& context);
void add_report(CLI::App& app, Context& context);
void add_plot(CLI::App& app, Context& context);
void add_documentation(CLI::App& app);

/// Progress on stderr: one rewritten line with throughput and ETA on a terminal, plain lines (at most one every few seconds) in a log, nothing if quiet.
Progress stderr_progress(const Context& context);

/// {"software": "lacquer 0.1.0", "command": ..., extra...} as JSON text; `inputs`: files whose checksums are recorded.
std::string provenance_json(const Context& context, const std::vector<std::string>& inputs);

enum class Emphasis { error, warning, good };
/// `text` in colour where `stream` is a terminal that shows them and NO_COLOR (no-color.org) is not set; else as it is.
std::string emphasised(const std::string& text, Emphasis emphasis, std::FILE* stream);

}  // namespace lacquer::tools
