#include "rigs.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "libacquire/sim/simulated_world.h"
#include "libcalib/calibration.h"
#include "libcalib/geometry_projection.h"
#include "libcalib/merge.h"
#include "tools/stopwatch.h"

namespace lacquer::bench {

namespace {

constexpr double degree = 3.14159265358979323846 / 180;

/// What each unknown of the solution should have come out as; the offset of the edges has no truth.
std::map<std::string, double> true_corrections(const acquire::RigGeometry& nominal, const BuilderErrors& e) {
  std::map<std::string, double> truth{{"sphere.x", e.sphere.x}, {"sphere.y", e.sphere.y}, {"sphere.z", e.sphere.z},
                                      {"axis.tilt_a", e.tilt_x}, {"axis.tilt_b", e.tilt_z}, {"axis.a", e.axis.x},
                                      {"axis.b", e.axis.z}, {"zero angle", e.zero_angle}, {"step scale", e.step_scale - 1}};
  for (std::size_t i = 0; i < nominal.lights.size(); ++i) {
    const acquire::Light& light = nominal.lights[i];
    const std::string name = light.name.empty() ? fmt::format("light {}", i + 1) : fmt::format("light {}", light.name);
    const glm::dvec3 moved = light.position * (e.arm_scale - 1) + e.lights[i];
    for (int k = 0; k < 3; ++k) truth[fmt::format("{}.{}", name, "xyz"[k])] = moved[k];
  }
  return truth;
}

/// x^T C^-1 x by Cholesky; C row-major.
double mahalanobis(std::vector<double> c, std::vector<double> x) {
  const std::size_t n = x.size();
  double sum = 0;
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      double s = c[i * n + j];
      for (std::size_t k = 0; k < j; ++k) s -= c[i * n + k] * c[j * n + k];
      c[i * n + j] = i == j ? std::sqrt(s) : s / c[j * n + j];
    }
    double s = x[i];
    for (std::size_t k = 0; k < i; ++k) s -= c[i * n + k] * x[k];
    x[i] = s / c[i * n + i];
    sum += x[i] * x[i];
  }
  return sum;
}

void add_pulls(const acquire::RigGeometry& nominal, const BuilderErrors& builder, RigResult& result) {
  const auto truth = true_corrections(nominal, builder);
  const calib::GeometryUncertainty& u = result.estimate.uncertainty;
  std::vector<std::size_t> known;
  for (std::size_t k = 0; k < u.parameters.size(); ++k)
    if (truth.contains(u.parameters[k].name)) known.push_back(k);
  std::vector<double> errors, covariance;
  for (const std::size_t k : known) {
    const calib::GeometryParameter& p = u.parameters[k];
    errors.push_back(p.correction - truth.at(p.name));
    result.pulls.push_back({p.name, errors.back(), p.sigma});
    for (const std::size_t l : known)
      covariance.push_back(u.covariance[k * u.parameters.size() + l] / (p.prior_sigma * u.parameters[l].prior_sigma));
  }
  for (std::size_t i = 0; i < known.size(); ++i) errors[i] /= u.parameters[known[i]].prior_sigma;
  result.mahalanobis = mahalanobis(covariance, errors);
}

double rms(const std::vector<double>& v) {
  double sum = 0;
  for (const double x : v) sum += x * x;
  return v.empty() ? 0 : std::sqrt(sum / static_cast<double>(v.size()));
}

double quantile(std::vector<double> v, double q) {
  std::sort(v.begin(), v.end());
  return v.empty() ? 0 : v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1) + 0.5)];
}

}  // namespace

BuilderErrors draw_errors(const acquire::RigGeometry& nominal, const calib::GeometryPriors& p, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  const auto draw = [&](double sigma) { return sigma * normal(random); };
  const auto draw3 = [&](double sigma) {
    const double x = draw(sigma), y = draw(sigma), z = draw(sigma);
    return glm::dvec3(x, y, z);
  };
  BuilderErrors e;
  e.sphere = draw3(p.sphere_m);
  e.tilt_x = draw(p.axis_tilt_rad);
  e.tilt_z = draw(p.axis_tilt_rad);
  e.axis = draw3(p.axis_point_m) * glm::dvec3(1, 0, 1);
  e.zero_angle = draw(p.zero_angle_rad);
  e.step_scale = 1 + draw(p.turntable_scale);
  e.arm_scale = 1 + draw(p.arm);
  for (std::size_t i = 0; i < nominal.lights.size(); ++i) e.lights.push_back(draw3(p.light_m));
  return e;
}

acquire::RigDescription built_with(const acquire::RigDescription& nominal, const BuilderErrors& e) {
  acquire::RigDescription built = nominal;
  acquire::SimulationDescription& s = built.simulation;
  s.sphere_offset = e.sphere;
  s.axis_tilt_x = e.tilt_x;
  s.axis_tilt_z = e.tilt_z;
  s.axis_offset = e.axis;
  // The simulator keeps the places of lights that its description has; those of the rig file belong to the turntable at -zero_angle.
  const acquire::RigGeometry turned = acquire::sim::true_geometry(built);
  for (std::size_t i = 0; i < built.geometry.lights.size(); ++i) {
    acquire::Light& light = built.geometry.lights[i];
    const glm::dvec3 place = light.position * e.arm_scale + e.lights[i], point = turned.axis_point + e.sphere;
    light.position = light.on_arm ? point + calib::rotate(place - point, turned.axis_direction, e.zero_angle) : place;
  }
  for (acquire::PlannedView& view : built.plan) view.turntable_angle *= e.step_scale;
  return built;
}

RigResult run_rig(const acquire::RigDescription& nominal, const BuilderErrors& errors, std::uint64_t seed, const std::shared_ptr<const brdf::Brdf>& paint,
                  const calib::GeometryPriors& priors, bool use_paint) {
  tools::Stopwatch watch;
  acquire::RigDescription built = built_with(nominal, errors);
  built.simulation.seed = seed;
  acquire::sim::SimulatedWorld world(built, paint);
  calib::Calibration calibration = calib::calibration_from_rig(nominal);
  std::vector<calib::RadianceImage> images;
  std::vector<calib::GeometryView> views;
  std::vector<calib::ViewAngles> angles;
  images.reserve(built.plan.size());
  for (const acquire::PlannedView& planned : built.plan) {
    const double read_back = world.move_to(planned.turntable_angle) / errors.step_scale;
    world.switch_light(planned.light);
    calib::BracketMerger merger(calibration.response, calibration.noise, planned.exposures_s);
    for (const double exposure : planned.exposures_s) merger.add(world.photograph({.exposure_s = exposure}));
    images.push_back(merger.finish());
    views.push_back({fmt::format("L{:03}", views.size()), static_cast<std::size_t>(planned.light), read_back, 1, [&image = images.back()] { return image; }});
    angles.push_back({static_cast<std::size_t>(planned.light), read_back, world.true_angle()});
  }
  RigResult result;
  result.n_views = views.size();
  result.simulation_s = watch.lap();
  calib::GeometryOptions options;
  options.priors = priors;
  options.use_paint = use_paint;
  result.estimate = calib::estimate_geometry("bench", nominal.geometry, {}, views, calibration, options, {}).estimate;
  result.calibration_s = watch.lap();
  result.before = calib::geometry_difference(nominal.geometry, world.geometry(), angles);
  for (std::size_t i = 0; i < angles.size(); ++i)
    angles[i].angle = result.estimate.turntable_scale * angles[i].angle + result.estimate.uncertainty.angle_correction(views[i].id);
  result.after = calib::geometry_difference(result.estimate.geometry, world.geometry(), angles);
  add_pulls(nominal.geometry, errors, result);
  return result;
}

std::string summary(const std::vector<RigResult>& results) {
  std::string text = fmt::format("{:<34} {:>10} {:>10} {:>10} {:>10} {:>10}\n", "error against the truth", "rig file", "rms", "median", "95 %", "stated");
  const auto row = [&](const std::string& name, const auto& value, const auto& stated) {
    std::vector<double> before, after, sigma;
    for (const RigResult& r : results) {
      before.push_back(value(r.before));
      after.push_back(value(r.after));
      sigma.push_back(stated(r.estimate));
    }
    text += fmt::format("{:<34} {:>10.4f} {:>10.4f} {:>10.4f} {:>10.4f} {:>10.4f}\n", name, rms(before), rms(after), quantile(after, 0.5), quantile(after, 0.95), rms(sigma));
  };
  using D = calib::GeometryDifference;
  using E = calib::GeometryEstimate;
  row("half vectors, deg", [](const D& d) { return d.half_vector_rad / degree; }, [](const E& e) { return e.half_vector_sigma_rad / degree; });
  row("light direction, deg", [](const D& d) { return d.light_rad / degree; }, [](const E& e) { return e.light_sigma_rad / degree; });
  row("light distance, %", [](const D& d) { return 100 * d.distance; }, [](const E& e) { return 100 * e.distance_sigma; });
  row("sphere's centre in the image, px", [](const D& d) { return d.centre_px; }, [](const E& e) { return e.centre_sigma_px; });

  std::size_t n_inside = 0, n_pulls = 0, n_outliers = 0, n_failed = 0;
  double chi2 = 0, simulation = 0, calibration = 0, edge_rms = 0, highlight_rms = 0, edge_factor = 0, highlight_factor = 0, angle = 0;
  text += fmt::format("\n{:<18} {:>12} {:>12} {:>10} {:>10} {:>14}\n", "unknown", "rms error", "stated", "pull mean", "pull rms", "in 95 % bounds");
  for (std::size_t k = 0; !results.empty() && k < results.front().pulls.size(); ++k) {
    std::vector<double> errors, sigmas, pulls;
    std::size_t inside = 0;
    double mean = 0;
    for (const RigResult& r : results) {
      if (k >= r.pulls.size()) continue;
      const Pull& p = r.pulls[k];
      errors.push_back(p.error);
      sigmas.push_back(p.sigma);
      pulls.push_back(p.error / p.sigma);
      mean += pulls.back();
      inside += std::abs(pulls.back()) < 1.959964;
    }
    n_inside += inside;
    n_pulls += pulls.size();
    text += fmt::format("{:<18} {:>12.3g} {:>12.3g} {:>+10.2f} {:>10.2f} {:>12.1f} %\n", results.front().pulls[k].name, rms(errors), rms(sigmas),
                        mean / static_cast<double>(pulls.size()), rms(pulls), 100.0 * static_cast<double>(inside) / static_cast<double>(pulls.size()));
  }
  const double n = static_cast<double>(results.size());
  for (const RigResult& r : results) {
    chi2 += r.mahalanobis / static_cast<double>(r.pulls.size()) / n;
    simulation += r.simulation_s;
    calibration += r.calibration_s;
    edge_rms += r.estimate.edge_rms_px / n;
    highlight_rms += r.estimate.highlight_rms_px / n;
    edge_factor += r.estimate.edge_noise_factor / n;
    highlight_factor += r.estimate.highlight_noise_factor / n;
    angle += r.estimate.angle_sigma_rad / degree / n;
    n_outliers += r.estimate.outliers.size();
    n_failed += !r.estimate.converged;
  }
  text += fmt::format("all: {:.1f} % of {} inside their 95 % bounds; chi2 of all unknowns together / their number: {:.2f}\n",
                      100.0 * static_cast<double>(n_inside) / static_cast<double>(n_pulls), n_pulls, chi2);
  text += fmt::format("residuals: edges {:.3f} px, {:.2f} times their sigma; highlights {:.4f} px, {:.2f} times; angles {:.4f} deg; {} outliers; {} did not converge\n",
                      edge_rms, edge_factor, highlight_rms, highlight_factor, angle, n_outliers, n_failed);
  text += fmt::format("time per rig: photographs and merging {:.2f} s, calibration {:.2f} s\n", simulation / n, calibration / n);
  return text;
}

}  // namespace lacquer::bench
