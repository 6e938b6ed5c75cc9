#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <string>

#include "bench/table/parts.h"

/// What docs/table.md says, figure by figure: error beside time.
int main(int argc, char** argv) {
  CLI::App app{"The half-angle table: accumulation, hole filling, discretisation, look-up, parameterisations"};
  std::string part, plot = "parameterisations.svg";
  bool smoke = false;
  app.add_option("part", part, "one part only (default: all)")
      ->check(CLI::IsMember({"accumulation", "filling", "discretisation", "lookup", "parameterisations"}));
  app.add_option("--plot", plot, "picture of the parameterisations")->capture_default_str();
  app.add_flag("--smoke", smoke, "small sizes: does it run?");
  CLI11_PARSE(app, argc, argv);
  const auto wanted = [&](const char* name) {
    if (part.empty() && !smoke) std::printf("\n## %s\n\n", name);
    return part.empty() || part == name;
  };
  try {
    using namespace lacquer::bench;
    const std::filesystem::path source = LACQUER_SOURCE_DIR, shared = LACQUER_SHARED_DATA;
    if (wanted("accumulation")) accumulation(source, smoke);
    if (wanted("filling")) filling(source, shared, smoke);
    if (wanted("discretisation")) discretisation(source, smoke);
    if (wanted("lookup")) lookup(source, smoke);
    if (wanted("parameterisations")) parameterisations(source, plot, smoke);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "bench_table: %s\n", e.what());
    return 1;
  }
  return 0;
}
