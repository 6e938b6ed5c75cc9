#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <cstdio>
#include <filesystem>

#include "libbrdf/error.h"
#include "rigs.h"

/// Geometry found from simulated images against the truth. README: docs/geometry.md.
namespace {

using namespace lacquer;

struct RigOptions {
  std::string rig = std::string(LACQUER_SOURCE_DIR) + "/rigs/simulated-geometry.toml";
  std::string paint;
  int count = 100, seed = 1;
  bool smoke = false;
};

int run_rigs(const RigOptions& o) {
  const acquire::RigDescription nominal = acquire::read_rig(o.rig);
  const std::shared_ptr<const brdf::Brdf> paint = brdf::load_brdf(o.paint.empty() ? nominal.simulation.paint : std::filesystem::path(o.paint));
  const calib::GeometryPriors priors;
  std::vector<bench::RigResult> results;
  for (int i = 0; i < (o.smoke ? 1 : o.count); ++i) {
    const auto seed = static_cast<std::uint64_t>(o.seed + i);
    results.push_back(bench::run_rig(nominal, bench::draw_errors(nominal.geometry, priors, seed), seed, paint, priors));
    const calib::GeometryDifference& d = results.back().after;
    constexpr double degree = 3.14159265358979323846 / 180;
    fmt::print("rig {:3}: half vectors {:.4f} deg, light {:.4f} deg, distance {:.3f} %, centre {:.4f} px; {} of {} highlights\n", o.seed + i,
               d.half_vector_rad / degree, d.light_rad / degree, 100 * d.distance, d.centre_px, results.back().estimate.n_highlights, results.back().n_views);
    std::fflush(stdout);
  }
  fmt::print("\n{} rigs as {}, paint {}\n\n{}", results.size(), nominal.name, paint->description(), bench::summary(results));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Geometry found from simulated images against the truth");
  app.require_subcommand(1);
  RigOptions rigs;
  CLI::App* command = app.add_subcommand("rigs", "seeded rigs whose builder had a ruler: errors of the estimated geometry, pulls, coverage");
  command->add_option("--rig", rigs.rig, "nominal rig, a simulated one")->capture_default_str();
  command->add_option("--paint", rigs.paint, "BRDF file (default: the rig file's)");
  command->add_option("--count", rigs.count, "number of rigs")->capture_default_str()->check(CLI::Range(1, 10000));
  command->add_option("--seed", rigs.seed, "of the first")->capture_default_str();
  command->add_flag("--smoke", rigs.smoke, "one rig");
  CLI11_PARSE(app, argc, argv);
  try {
    return run_rigs(rigs);
  } catch (const lacquer::Error& e) {
    std::fprintf(stderr, "bench_geometry: %s\n", e.what());
    return 1;
  }
}
