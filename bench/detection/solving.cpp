#include "solving.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "libacquire/session.h"
#include "libcalib/geometry_difference.h"
#include "libcalib/geometry_projection.h"
#include "libcalib/geometry_session.h"
#include "libcalib/lens_calibration.h"
#include "tools/stopwatch.h"
#include "tests/libcalib/rendered_view.h"
#include "tests/libcalib/simulated_boards.h"

namespace lacquer::bench {

namespace {

constexpr double degree = 3.14159265358979323846 / 180;

acquire::RigDescription paper_rig() { return acquire::read_rig(std::filesystem::path(LACQUER_SOURCE_DIR) / "rigs/simulated-paper.toml"); }

/// The time of each stage that estimate_geometry reports; what follows its highlights is in `after`.
struct Stages {
  double silhouette = 0, highlights = 0, after = 0;
};

Stages timed(const std::string& name, const acquire::RigGeometry& nominal, const acquire::MaskDescription& mask, const std::vector<calib::GeometryView>& views,
             calib::Calibration& calibration, calib::SessionGeometry& found) {
  Stages s;
  tools::Stopwatch watch;
  const auto progress = [&](const std::string& stage, std::size_t done, std::size_t total) {
    if (done != total) return;
    if (stage == "silhouette") s.silhouette = watch.lap();
    if (stage == "highlights") s.highlights = watch.lap();
  };
  found = calib::estimate_geometry(name, nominal, mask, views, calibration, {}, progress);
  s.after = watch.lap();
  return s;
}

void print(const std::string& what, const Stages& s, const calib::SessionGeometry& g) {
  fmt::print("{}: {:.2f} s after its highlights ({:.1f} s for the silhouette, {:.1f} s for highlights before, images read by each); {} edges, {} highlights, {} samples of the paint, "
             "{} unknowns\n", what, s.after, s.silhouette, s.highlights, g.estimate.n_edges, g.estimate.n_highlights, g.paint.n_samples, g.estimate.uncertainty.parameters.size());
}

void small_images(bool smoke) {
  acquire::RigDescription rig = paper_rig();
  acquire::CameraModel& camera = rig.geometry.camera;
  camera.width /= 4;
  camera.height /= 4;
  camera.focal *= 0.25;
  camera.centre = 0.25 * (camera.centre + 0.5) - 0.5;
  const acquire::RigGeometry nominal = rig.geometry;
  const glm::dvec3 sphere(0.002, -0.001, -0.002);
  rig.geometry.cam_from_rig.translation += rig.geometry.cam_from_rig.rotation * sphere;
  rig.geometry.axis_point -= sphere;
  for (acquire::Light& light : rig.geometry.lights) light.position -= sphere;
  const test::RenderedRig rendered(rig, brdf::load_brdf(rig.simulation.paint));
  const std::vector<double>& all = rig.plan.front().exposures_s;
  const std::vector<double> exposures{all.front(), all[all.size() / 3], all[2 * all.size() / 3], all.back()};
  std::vector<calib::RadianceImage> images;
  std::vector<calib::GeometryView> views;
  std::vector<calib::ViewAngles> angles;
  const std::size_t stride = smoke ? std::max<std::size_t>(1, rig.plan.size() / 6) : 1;
  for (std::size_t i = 0; i < rig.plan.size(); i += stride) {
    const acquire::PlannedView& view = rig.plan[i];
    const auto light = static_cast<std::size_t>(view.light);
    images.push_back(rendered.photograph(rendered.render(light, view.turntable_angle), exposures, i));
    angles.push_back({light, view.turntable_angle, view.turntable_angle});
  }
  for (std::size_t i = 0; i < images.size(); ++i) views.push_back({fmt::format("L{:03}", i), angles[i].light, angles[i].angle, 1, [&images, i] { return images[i]; }});
  calib::Calibration calibration = calib::calibration_from_rig(rig);
  calib::SessionGeometry found;
  const Stages s = timed("bench", nominal, {}, views, calibration, found);
  print(fmt::format("geometry of {} views of {} x {} pixels", views.size(), camera.width, camera.height), s, found);
  for (std::size_t i = 0; i < angles.size(); ++i)
    angles[i].angle = calibration.turntable_scale * angles[i].angle + calibration.geometry_uncertainty.angle_correction(views[i].id);
  const calib::GeometryDifference d = calib::geometry_difference(calibration.geometry, rig.geometry, angles);
  fmt::print("  off by {:.4f} deg in half vectors, {:.4f} deg in directions, {:.2f} % in distance, {:.3f} px in the centre\n", d.half_vector_rad / degree, d.light_rad / degree,
             100 * d.distance, d.centre_px);
}

/// As many LEDs as highlights: solved for at once.
void many_lights(std::size_t n) {
  acquire::RigGeometry nominal = paper_rig().geometry;
  const acquire::Light first = nominal.lights.front();
  nominal.lights.clear();
  for (std::size_t i = 0; i < n; ++i) {
    acquire::Light light = first;
    light.name = fmt::format("{}", i + 1);
    light.position = calib::rotate(first.position, nominal.axis_direction, 130 * degree * static_cast<double>(i) / static_cast<double>(n));
    nominal.lights.push_back(light);
  }
  acquire::RigGeometry truth = nominal;
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  truth.cam_from_rig.translation += glm::dvec3(0.002, 0.001, -0.002);
  for (acquire::Light& light : truth.lights)
    for (int k = 0; k < 3; ++k) light.position[k] += 0.005 * normal(random);
  std::vector<calib::EdgePoint> edges;
  const glm::dvec2 centre = *truth.camera.project(truth.cam_from_rig.translation);
  for (int k = 0; k < 240; ++k) {
    const glm::dvec2 out(std::cos(1.5 * degree * k), std::sin(1.5 * degree * k));
    double radius = truth.camera.focal.x * truth.sphere_radius / truth.cam_from_rig.translation.z;
    for (int i = 0; i < 20; ++i) radius -= calib::silhouette_distance(truth, centre + radius * out).value_or(0);
    edges.push_back({centre + (radius + 0.05 * normal(random)) * out, 0.05});
  }
  std::vector<calib::Highlight> highlights;
  for (std::size_t i = 0; i < n; ++i)
    for (const double angle : {0.0, 10 * degree}) {
      const auto pixel = calib::mirror_pixel(truth, truth.place_light(i, angle).position);
      if (!pixel) continue;
      const glm::dvec2 noise(normal(random), normal(random));
      highlights.push_back({fmt::format("L{:03}", highlights.size()), i, angle, *pixel + 0.01 * noise, 1e-4, 0, 1e-4});
    }
  tools::Stopwatch watch;
  const calib::GeometryEstimate e = calib::solve_geometry(nominal, edges, highlights);
  fmt::print("geometry of {} LEDs, each with unknowns of its own: {:.2f} s; {} edges, {} highlights, {} unknowns{}\n", n, watch.lap(), e.n_edges, e.n_highlights,
             e.uncertainty.parameters.size(), e.converged ? "" : "; it did NOT converge");
}

}  // namespace

void lens_speed(int repeats) {
  test::SimulatedBoards boards;
  boards.camera = test::usual_camera();
  const auto views = boards.views(24, 1);
  for (const char* model : {"LENSMODEL_OPENCV4", "LENSMODEL_OPENCV8", "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=11_Ny=8_fov_x_deg=66"}) {
    double best = 1e9;
    calib::LensCalibration c;
    for (int r = 0; r < repeats; ++r) {
      tools::Stopwatch watch;
      c = calib::calibrate_lens(views, boards.board, boards.camera.width, boards.camera.height, {.model = model});
      best = std::min(best, watch.lap());
    }
    fmt::print("lens of {} boards of {}x{} corners, {}, its errors and both halves: {:.2f} s (best of {}); rms {:.3f} px for noise of {:.3f} px\n", views.size(), boards.board.columns,
               boards.board.rows, model, best, repeats, c.rms_px, std::sqrt(2.0) * boards.noise_px);
  }
}

void geometry_speed(const std::filesystem::path& folder, bool smoke) {
  if (folder.empty()) {
    small_images(smoke);
    many_lights(smoke ? 9 : 181);
    return;
  }
  const acquire::Session session = acquire::read_session(folder);
  calib::Calibration calibration = calib::read_calibration(folder / "calibration.json");
  calib::SessionGeometry found;
  const Stages s = timed(folder.string(), session.rig.geometry, session.rig.mask, calib::geometry_views(session, calibration), calibration, found);
  print(fmt::format("geometry of {}, {} views of {} x {} pixels", folder.string(), found.n_views, session.rig.geometry.camera.width, session.rig.geometry.camera.height), s, found);
}

}  // namespace lacquer::bench
