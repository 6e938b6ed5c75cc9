#include "tools/fit_metrics.h"

#include <fmt/format.h>

#include "libbrdf/error.h"
#include "libbrdf/metrics.h"
#include "libfit/fitted_model.h"
#include "tools/environment.h"
#include "tools/rgb_image.h"

namespace lacquer::tools {

namespace {

constexpr int probe_sphere_px = 48, samples_per_pixel = 128, draws = 16;

}  // namespace

ProbeDifference probe_difference(const brdf::Brdf& a, const brdf::Brdf& b, double scale) {
  const auto probe = default_probe();
  if (!probe) return {};
  const Environment environment(*probe);
  RgbImage of_a = render_probe_sphere(a, environment, probe_sphere_px, &b, samples_per_pixel).image;
  const double exposure = exposure_for(of_a);
  RgbImage of_b = render_probe_sphere(b, environment, probe_sphere_px, &a, samples_per_pixel).image;
  const DeltaE d = delta_e(exposed(std::move(of_a), exposure), exposed(std::move(of_b), exposure * scale));
  return {d.n, d.mean, d.p95};
}

std::string to_text(const ProbeDifference& d) {
  return d.n == 0 ? "" : fmt::format("dE2000 under probe     {:.3f} mean, {:.3f} 95th percentile\n", d.mean, d.p95);
}

void add_metrics(const brdf::Brdf& input, fit::FitResult& fit) {
  const brdf::CookTorranceBrdf model(fit.model);
  fit::FitMetrics metrics;
  try {
    metrics.difference = brdf::compare(input, model);
  } catch (const Error& e) {
    if (e.code() != ErrorCode::input) throw;
    return;
  }
  const ProbeDifference probe = probe_difference(input, model);
  metrics.probe_pixels = probe.n, metrics.probe_delta_e_mean = probe.mean, metrics.probe_delta_e_p95 = probe.p95;
  for (const brdf::CookTorrance& drawn : fit::draw_models({fit.model, fit.parameters, fit.covariance}, draws))
    metrics.delta_e_of_errors += brdf::compare_lit_spheres(model, brdf::CookTorranceBrdf(drawn)).mean / draws;
  fit.metrics = metrics;
}

}  // namespace lacquer::tools
