#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <cmath>
#include <cstdio>
#include <filesystem>

#include "libbrdf/error.h"
#include "paints.h"
#include "rigs.h"

/// Geometry found from simulated images against the truth. README: docs/geometry.md.
namespace {

using namespace lacquer;

struct RigOptions {
  std::string rig = std::string(LACQUER_SOURCE_DIR) + "/rigs/simulated-geometry.toml";
  std::string paint;
  int count = 100, seed = 1;
  bool smoke = false, without_paint = false;
};

int run_rigs(const RigOptions& o) {
  const acquire::RigDescription nominal = acquire::read_rig(o.rig);
  const std::shared_ptr<const brdf::Brdf> paint = brdf::load_brdf(o.paint.empty() ? nominal.simulation.paint : std::filesystem::path(o.paint));
  const calib::GeometryPriors priors;
  std::vector<bench::RigResult> results;
  for (int i = 0; i < (o.smoke ? 1 : o.count); ++i) {
    const auto seed = static_cast<std::uint64_t>(o.seed + i);
    results.push_back(bench::run_rig(nominal, bench::draw_errors(nominal.geometry, priors, seed), seed, paint, priors, !o.without_paint));
    const calib::GeometryDifference& d = results.back().after;
    constexpr double degree = 3.14159265358979323846 / 180;
    fmt::print("rig {:3}: half vectors {:.4f} deg, light {:.4f} deg, distance {:.3f} %, centre {:.4f} px; {} of {} highlights\n", o.seed + i,
               d.half_vector_rad / degree, d.light_rad / degree, 100 * d.distance, d.centre_px, results.back().estimate.n_highlights, results.back().n_views);
    std::fflush(stdout);
  }
  fmt::print("\n{} rigs as {}, paint {}\n\n{}", results.size(), nominal.name, paint->description(), bench::summary(results));
  if (!o.smoke) return 0;
  constexpr double impossible = 6;  // sigmas
  for (const bench::Pull& p : results.front().pulls)
    if (!(std::abs(p.error) < impossible * p.sigma)) throw Error(ErrorCode::input, p.name + ": more than 6 of its sigmas from the truth");
  return 0;
}

struct PaintOptions {
  std::string folder = "bench_geometry_session";
  std::vector<std::string> paints{"ford-f8", "polaris-silber", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"};
  int seed = 1;
  bool full = false;
};

int run_paints(const PaintOptions& o) {
  const std::filesystem::path source = LACQUER_SOURCE_DIR;
  const acquire::RigDescription nominal = acquire::read_rig(source / (o.full ? "rigs/simulated-paper.toml" : "rigs/simulated-quick.toml"));
  const bench::BuilderErrors errors = bench::draw_errors(nominal.geometry, {}, static_cast<std::uint64_t>(o.seed));
  std::vector<bench::PaintResult> results;
  for (const std::string& paint : o.paints) {
    results.push_back(bench::measure_paint(nominal, errors, source / "data-samples/paints" / (paint + ".json"), o.folder));
    fmt::print(stderr, "{}", bench::paint_table({results.back()}));
  }
  fmt::print("{}, {} views of {} exposures, true rig of seed {}\n\n{}", nominal.name, nominal.plan.size(), nominal.plan.front().exposures_s.size(), o.seed,
             bench::paint_table(results));
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
  command->add_flag("--without-paint", rigs.without_paint, "silhouette and highlights only");
  command->add_flag("--smoke", rigs.smoke, "one rig; fails where an unknown is more than 6 of its sigmas from the truth");
  PaintOptions paints;
  CLI::App* end_to_end = app.add_subcommand("paints", "paints of Guenther et al. 2005 end to end, calibrated beside known geometry");
  end_to_end->add_flag("--full", paints.full, "the plan of the paper (181 views of 16 exposures, 1360 x 1024) instead of the quick one");
  end_to_end->add_option("--paint", paints.paints, "names in data-samples/paints");
  end_to_end->add_option("--folder", paints.folder, "for radiance images, emptied and removed; 4 GB with --full")->capture_default_str();
  end_to_end->add_option("--seed", paints.seed, "of the rig's errors")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    return command->parsed() ? run_rigs(rigs) : run_paints(paints);
  } catch (const lacquer::Error& e) {
    std::fprintf(stderr, "bench_geometry: %s\n", e.what());
    return 1;
  }
}
