#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "bench/table/parts.h"

/// What docs/table.md says, figure by figure: error beside time.
int main(int argc, char** argv) {
  CLI::App app{"The half-angle table: accumulation, hole filling, lookup, discretisation, parameterisations"};
  std::string part;
  bool smoke = false;
  app.add_option("part", part, "accumulation (default: all)")->check(CLI::IsMember({"accumulation"}));
  app.add_flag("--smoke", smoke, "small sizes: does it run?");
  CLI11_PARSE(app, argc, argv);
  try {
    const std::filesystem::path source = LACQUER_SOURCE_DIR;
    if (part.empty() || part == "accumulation") lacquer::bench::accumulation(source, smoke);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "bench_table: %s\n", e.what());
    return 1;
  }
  return 0;
}
