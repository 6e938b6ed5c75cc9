#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <map>

#include "libbrdf/files.h"
#include "libcalib/geometry_projection.h"
#include "libcalib/highlights.h"
#include "libcalib/sphere_outline.h"
#include "solving.h"
#include "tests/libcalib/rendered_view.h"

/// Speed of detection beside the errors of what it finds, and centroids over seeds: bias, scatter and stated sigma of hard cases.
namespace {

using namespace lacquer;
using test::RenderedRig;

constexpr double degree = 3.14159265358979323846 / 180;

std::filesystem::path source(const std::string& name) { return std::filesystem::path(LACQUER_SOURCE_DIR) / name; }

std::shared_ptr<const brdf::Brdf> paint(const std::string& name) {
  return std::make_shared<brdf::CookTorranceBrdf>(brdf::read_model(source("data-samples/paints/" + name + ".json")));
}

/// A mirror with a little roughness.
std::shared_ptr<const brdf::Brdf> chrome(double m) {
  brdf::CookTorrance model;
  model.kd = glm::dvec3(1e-3);
  model.lobes = {{glm::dvec3(1), m, 0.6}};
  return std::make_shared<brdf::CookTorranceBrdf>(model);
}

double seconds_of(const std::function<void()>& body) {
  const auto start = std::chrono::steady_clock::now();
  body();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

void speed(const std::vector<double>& angles_deg, int repeats, const std::filesystem::path& folder) {
  const RenderedRig rendered(acquire::read_rig(source("rigs/simulated-paper.toml")), paint("polaris-silber"));
  const auto& exposures = rendered.rig().plan.front().exposures_s;
  const auto& truth = rendered.calibration().geometry;
  std::vector<calib::RadianceImage> images;
  for (std::size_t i = 0; i < angles_deg.size(); ++i) images.push_back(rendered.photograph(rendered.render(0, angles_deg[i] * degree), exposures, i + 1));

  std::vector<calib::HighlightResult> found(images.size());
  const auto highlights = [&] {
    tbb::parallel_for(std::size_t{0}, images.size(), [&](std::size_t i) { found[i] = calib::find_highlight(images[i], rendered.calibration(), 0, angles_deg[i] * degree, {}); });
  };
  calib::OutlineFinder::Outline outline;
  double first = 1e9, later = 1e9, finish = 1e9;  // the first view also assigns pixels to arcs
  const auto silhouette = [&] {
    calib::OutlineFinder finder(truth, {.lens_blur_px = rendered.calibration().lens_blur_px});
    const auto add = [&](std::size_t i) { finder.add(images[i], truth.place_light(0, angles_deg[i] * degree)); };
    first = std::min(first, seconds_of([&] { add(0); }));
    later = std::min(later, seconds_of([&] {
      for (std::size_t i = 1; i < images.size(); ++i) add(i);
    }));
    finish = std::min(finish, seconds_of([&] { outline = finder.finish(); }));
  };
  double once = 1e9, alone = 1e9;
  for (int r = 0; r < repeats; ++r) {
    {
      const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
      alone = std::min(alone, seconds_of(highlights));
    }
    once = std::min(once, seconds_of(highlights));
    silhouette();
  }
  std::filesystem::create_directories(folder);
  calib::write_radiance(folder / "view.exr", images.front());
  double reading = 1e9;
  for (int r = 0; r < repeats; ++r) reading = std::min(reading, seconds_of([&] { calib::read_radiance(folder / "view.exr"); }));
  std::filesystem::remove(folder / "view.exr");

  double sum = 0, worst = 0, normal = 0, n = 0;
  std::map<calib::HighlightFate, int> others;
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (found[i].fate != calib::HighlightFate::found) {
      ++others[found[i].fate];
      continue;
    }
    const glm::dvec2 pixel = *calib::mirror_pixel(truth, truth.place_light(0, angles_deg[i] * degree).position);
    const double error = glm::length(found[i].highlight.pixel - pixel);
    const auto a = acquire::trace(truth, pixel), b = acquire::trace(truth, found[i].highlight.pixel);
    normal += std::pow(glm::length(glm::cross(a->normal, b->normal)), 2);
    sum += error * error;
    worst = std::max(worst, error);
    ++n;
  }
  const double frames = static_cast<double>(images.size());
  fmt::print("{} views of 1360 x 1024, {} exposures of 12 bit merged, Polaris; best of {}\n", images.size(), exposures.size(), repeats);
  fmt::print("highlights            {:8.1f} frames/s on all cores, {:.1f} on one; error {:.4f} px rms, {:.4f} worst, of the normal {:.5f} deg rms\n", frames / once,
             frames / alone, std::sqrt(sum / n), worst, std::sqrt(normal / n) / degree);
  for (const auto& [fate, count] : others) fmt::print("  no highlight in {}: {}\n", count, calib::describe(fate));
  const auto c = outline.geometry.camera.project(outline.geometry.cam_from_rig.translation), d = truth.camera.project(truth.cam_from_rig.translation);
  const double limb = later / (frames - 1);
  fmt::print("silhouette            {:8.1f} frames/s on all cores, {:.2f} s for the first and {:.2f} s at the end; {} edges, centre off by {:.4f} px\n", 1 / limb, first, finish,
             outline.edges.size(), glm::length(*c - *d));
  fmt::print("both                  {:8.1f} frames/s\nreading a radiance EXR{:8.1f} frames/s\n", 1 / (once / frames + limb), 1 / reading);
}

struct Case {
  std::string name;
  std::shared_ptr<const brdf::Brdf> paint;
  double angle_deg = 40;
  std::function<void(acquire::RigDescription&)> change = {};
  /// On the light before it reaches the sensor; `highlight`: pixel of the window.
  std::function<void(acquire::sim::RadianceImage&, const RenderedRig&, const glm::dvec2& highlight)> scene = {};
};

/// A second lamp, `share` as bright, where the arm would be `off_deg` further.
auto rival(double share, double off_deg) {
  return [=](acquire::sim::RadianceImage& image, const RenderedRig& rendered, const glm::dvec2&) {
    const auto other = rendered.render(0, (40 + off_deg) * degree);
    for (std::size_t i = 0; i < image.data.size(); ++i) image.data[i] += static_cast<float>(share) * other.data[i];
  };
}

/// A speck that lets a tenth of the light through, `off_px` to the right of the highlight.
auto dust(double radius_px, double off_px) {
  return [=](acquire::sim::RadianceImage& image, const RenderedRig&, const glm::dvec2& highlight) {
    for (int c = 0; c < image.n_channels; ++c)
      for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x)
          if (glm::length(glm::dvec2(x, y) - highlight - glm::dvec2(off_px, 0)) < radius_px) image.at(c, x, y) *= 0.1f;
  };
}

std::vector<Case> cases() {
  const auto polaris = paint("polaris-silber");
  std::vector<Case> list;
  for (const double angle : {0.0, 40.0, 80.0, 110.0, 125.0}) list.push_back({fmt::format("polaris {:g} deg", angle), polaris, angle});
  for (const char* name : {"ford-f8", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"}) list.push_back({name, paint(name), 40});
  // Chrome needs less light, or it is clipped in every exposure.
  for (const double m : {0.01, 0.005, 0.003, 0.002, 0.001})
    list.push_back({fmt::format("chrome m = {:g}", m), chrome(m), 40, [](auto& r) { r.geometry.lights[0].intensity *= 3e-4; }});
  list.push_back({"chrome m = 0.005, overexposed", chrome(0.005), 40});
  list.push_back({"camera without colour", polaris, 40, [](auto& r) { r.sensor.layout = acquire::PixelLayout::mono; }});
  list.push_back({"lens blur 0.3 px", polaris, 40, [](auto& r) { r.simulation.blur_px = r.sensor.lens_blur_px = 0.3; }});
  list.push_back({"lens blur 0.8, told 0.7", polaris, 80, [](auto& r) { r.simulation.blur_px = 0.8; }});
  list.push_back({"emitter of 10 mm", polaris, 80, [](auto& r) { r.geometry.lights[0].diameter = 0.01; }});
  list.push_back({"sphere 15 deg off axis", polaris, 80, [](auto& r) {
                    // The camera turns about itself; its principal point stays in the image's middle, the sphere leaves it.
                    const double t = 15 * degree;
                    const glm::dmat3 turn(std::cos(t), 0, -std::sin(t), 0, 1, 0, std::sin(t), 0, std::cos(t));
                    r.geometry.cam_from_rig.rotation = turn * r.geometry.cam_from_rig.rotation;
                    r.geometry.cam_from_rig.translation = turn * r.geometry.cam_from_rig.translation;
                    r.geometry.camera.distortion = {};
                    r.geometry.camera.centre.x -= std::tan(t) * r.geometry.camera.focal.x;
                  }});
  list.push_back({"camera at 0.16 m, 9 mm lens", polaris, 40, [](auto& r) {
                    r.geometry.cam_from_rig = acquire::look_at({0, 0, 0.16}, {0, 0, 0}, {0, 1, 0});
                    r.geometry.camera.focal *= 0.15;
                    r.geometry.camera.distortion = {};
                  }});
  for (const double off : {16.0, 8.0, 5.0, 3.0, 1.5})
    for (const double share : {0.9, 0.1}) list.push_back({fmt::format("rival of {:g} %, {:g} deg off", 100 * share, off), polaris, 40, {}, rival(share, off)});
  for (const double off : {10.0, 5.0, 2.0}) list.push_back({fmt::format("dust of 3 px, {:g} px off", off), polaris, 40, {}, dust(1.5, off)});
  return list;
}

/// A window about the highlight, photographed with many seeds.
void centroids(int seeds, const std::string& filter) {
  fmt::print("\nCentroids over {} seeds, 1360 x 1024, geometry known. Pixels; pull: error over stated sigma\n", seeds);
  fmt::print("{:<28} {:>6} {:>19} {:>8} {:>8} {:>10} {:>10} {:>9} {:>9}   {}\n", "case", "found", "bias x, y", "scatter", "sigma", "pull rms", "bias deg", "asymmetry", "longer by", "else");
  for (const Case& c : cases()) {
    if (!filter.empty() && c.name.find(filter) == std::string::npos) continue;
    acquire::RigDescription whole = acquire::read_rig(source("rigs/simulated-paper.toml"));
    if (c.change) c.change(whole);
    const glm::dvec2 expected = *calib::mirror_pixel(whole.geometry, whole.geometry.place_light(0, c.angle_deg * degree).position);
    constexpr int half = 70;
    const glm::ivec2 corner = 2 * (glm::ivec2(expected) / 2) - half;
    const RenderedRig rendered(test::windowed(whole, corner, glm::ivec2(2 * half)), c.paint);
    auto light = rendered.render(0, c.angle_deg * degree);
    const glm::dvec2 truth = expected - glm::dvec2(corner);
    if (c.scene) c.scene(light, rendered, truth);
    glm::dvec2 sum(0.0), squares(0.0), sigma2(0.0);
    double pulls = 0, n = 0, asymmetry = 0, elongation = 0;
    std::map<calib::HighlightFate, int> others;
    for (int seed = 1; seed <= seeds; ++seed) {
      const auto image = rendered.photograph(light, whole.plan.front().exposures_s, static_cast<std::uint64_t>(seed));
      const auto found = calib::find_highlight(image, rendered.calibration(), 0, c.angle_deg * degree, {});
      if (found.fate != calib::HighlightFate::found) {
        ++others[found.fate];
        continue;
      }
      const glm::dvec2 d = found.highlight.pixel - truth;
      const glm::dmat2 covariance(found.highlight.xx, found.highlight.xy, found.highlight.xy, found.highlight.yy);
      sum += d;
      squares += d * d;
      sigma2 += glm::dvec2(found.highlight.xx, found.highlight.yy);
      pulls += glm::dot(d, glm::inverse(covariance) * d) / 2;
      asymmetry += found.asymmetry;
      elongation += found.elongation;
      ++n;
    }
    std::string rest;
    for (const auto& [fate, count] : others) rest += fmt::format("{} {} ", count, calib::describe(fate));
    if (n == 0) {
      fmt::print("{:<28} {:>6} {:>76}   {}\n", c.name, 0, "", rest);
      continue;
    }
    const glm::dvec2 bias = sum / n, variance = squares / n - bias * bias;
    const auto a = acquire::trace(rendered.rig().geometry, truth), b = acquire::trace(rendered.rig().geometry, truth + bias);
    fmt::print("{:<28} {:>6} {:>+9.4f} {:>+9.4f} {:>8.4f} {:>8.4f} {:>10.2f} {:>10.5f} {:>9.4f} {:>9.4f}   {}\n", c.name, n, bias.x, bias.y,
               std::sqrt(std::max(0.0, variance.x + variance.y) / 2), std::sqrt((sigma2.x + sigma2.y) / (2 * n)), std::sqrt(pulls / n),
               glm::length(glm::cross(a->normal, b->normal)) / degree, asymmetry / n, elongation / n, rest);
  }
}

}  // namespace

int main(int argc, char** argv) try {
  CLI::App app("Speed of detection, lens and geometry beside their errors; hard cases of highlights");
  bool smoke = false;
  std::string folder = "bench-detection", only, session;
  int seeds = 50, repeats = 5;
  app.add_flag("--smoke", smoke, "two views, two seeds: does it run?");
  app.add_option("--folder", folder, "for the file whose reading is timed")->capture_default_str();
  app.add_option("--seeds", seeds, "photographs per case; 0: no cases")->capture_default_str();
  app.add_option("--repeats", repeats, "of the timings; 0: none")->capture_default_str();
  app.add_option("--session", session, "merged session whose geometry is timed; default: the paper's plan with a quarter of the pixels each way, rendered");
  app.add_option("--case", only, "cases whose name has this");
  CLI11_PARSE(app, argc, argv);
  if (smoke) seeds = 2, repeats = 1;
  std::vector<double> angles;
  for (double a = 0; a <= (smoke ? 10 : 120); a += 10) angles.push_back(a);
  if (repeats > 0) {
    speed(angles, repeats, folder);
    bench::lens_speed(repeats);
    bench::geometry_speed(session, smoke);
  }
  if (seeds > 0) centroids(seeds, smoke ? "chrome m = 0.003" : only);
  return 0;
} catch (const std::exception& e) {
  fmt::print(stderr, "bench_detection: {}\n", e.what());
  return 1;
}
