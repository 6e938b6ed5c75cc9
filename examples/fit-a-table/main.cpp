// Reads any BRDF file, evaluates it in one pair of directions, fits one lobe to it and says how far the two are apart.
#include <cstdio>

#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/metrics.h"
#include "libfit/fit.h"

int main(int argc, char** argv) {
  using namespace lacquer;
  if (argc != 2) return std::fprintf(stderr, "usage: fit_a_table BRDF\n"), 2;
  try {
    const auto paint = brdf::load_brdf(argv[1]);
    constexpr double degree = 3.14159265358979 / 180;
    // Light 30 degrees from the normal, camera 10 degrees beyond the mirror direction. 1/sr, without the cosine.
    const auto value = paint->value({brdf::direction(30 * degree, 3.14159265358979), brdf::direction(40 * degree, 0)});
    if (value) std::printf("f_r = %.6f %.6f %.6f 1/sr\n", value->x, value->y, value->z);

    fit::FitOptions options;
    options.n_lobes = 1;
    options.max_cells = 20000;
    const fit::FitResult fit = fit::fit_table(brdf::tabulate_brdf(*paint, options.min_cosine), options);
    for (const fit::Parameter& p : fit.parameters) std::printf("%-6s %10.6f +- %.6f\n", p.name.c_str(), p.value, p.sigma);
    const brdf::BrdfDifference d = brdf::compare(*paint, brdf::CookTorranceBrdf(fit.model));
    std::printf("mean |ln ratio| %.4f, dE2000 %.2f\n", d.mean_abs_log, d.delta_e_mean);
  } catch (const Error& e) {
    return std::fprintf(stderr, "fit_a_table: %s\n", e.what()), 1;
  }
  return 0;
}
