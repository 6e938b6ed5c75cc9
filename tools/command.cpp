#include "tools/command.h"

#include <fmt/format.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <string_view>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::tools {

namespace {

using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t interrupted = 0;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

std::string duration_text(double seconds) {
  if (seconds < 90) return fmt::format("{:.0f} s", seconds);
  return fmt::format("{:.0f} min", seconds / 60);
}

std::string rate_text(double per_s) {
  if (per_s < 1) return fmt::format("{:.2g} s each", 1 / per_s);
  return per_s < 9.95 ? fmt::format("{:.1f}/s", per_s) : fmt::format("{:.0f}/s", per_s);
}

}  // namespace

Progress stderr_progress(const Context& context) {
  struct State {
    std::string stage;
    Clock::time_point started, printed;
  };
  std::signal(SIGINT, [](int) { interrupted = 1; });
  std::signal(SIGTERM, [](int) { interrupted = 1; });
  std::signal(SIGHUP, [](int) { interrupted = 1; });  // the terminal was closed or its connection lost
  const bool terminal = isatty(STDERR_FILENO) != 0;
  const bool quiet = context.quiet;
  return [state = std::make_shared<State>(), terminal, quiet](const std::string& stage, std::size_t done, std::size_t total) {
    if (interrupted) throw Error(ErrorCode::interrupted, "interrupted while " + stage + "; what was written so far is kept");
    if (quiet) return;
    const auto now = Clock::now();
    if (stage != state->stage) *state = {stage, now, terminal ? now - std::chrono::hours(1) : now};
    const bool last = done >= total;
    const double since_print = std::chrono::duration<double>(now - state->printed).count();
    if (!last && since_print < (terminal ? 0.1 : 5.0)) return;
    state->printed = now;
    const double elapsed = seconds_since(state->started);
    std::string line = fmt::format("{:<18} {:>6}/{}", stage, done, total);
    if (done > 0 && elapsed > 0.05) line += "  " + rate_text(static_cast<double>(done) / elapsed);
    if (last)
      line += fmt::format("  {:.1f} s", elapsed);
    else if (done > 0 && elapsed > 0.5)
      line += "  ETA " + duration_text(elapsed / static_cast<double>(done) * static_cast<double>(total - done));
    if (terminal)
      fmt::print(stderr, "\r{:<60}{}", line, last ? "\n" : "");
    else
      fmt::print(stderr, "{}\n", line);
    std::fflush(stderr);
  };
}

void add_json_option(CLI::App& command, Context& context) {
  command.add_flag("--json", context.json, "one JSON object instead of lines for people");
}

std::string emphasised(const std::string& text, Emphasis emphasis, std::FILE* stream) {
  const auto set = [](const char* name) {
    const char* value = std::getenv(name);
    return value && *value;
  };
  const char* terminal = std::getenv("TERM");
  if (set("NO_COLOR") || !terminal || std::string_view(terminal) == "dumb" || !isatty(fileno(stream))) return text;
  const char* const colours[] = {"1;31", "33", "32"};
  return fmt::format("\x1b[{}m{}\x1b[0m", colours[static_cast<int>(emphasis)], text);
}

std::string provenance_json(const Context& context, const std::vector<std::string>& inputs) {
  nlohmann::ordered_json j;
  j["software"] = std::string("lacquer ") + brdf::version();
  j["command"] = context.command_line;
  j["inputs"] = nlohmann::ordered_json::object();
  for (const auto& file : inputs) j["inputs"][file] = brdf::file_checksum(file);
  return j.dump();
}

}  // namespace lacquer::tools
