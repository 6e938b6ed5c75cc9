#include <fmt/format.h>
#include <sys/resource.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <map>
#include <random>
#include <span>
#include <utility>

#include "bench/table/parts.h"
#include "libacquire/rig_description.h"
#include "libbrdf/files.h"
#include "libbrdf/table_accumulator.h"
#include "libcalib/calibration.h"
#include "libcalib/samples.h"
#include "libcalib/sphere_pixels.h"

/// Samples into cells: time per sample, error against a plain loop in double, memory.
namespace lacquer::bench {

namespace {

double seconds() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }
double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}
double peak_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

/// Values without a paint: what they are does not change the time.
calib::RadianceImage image_for(const acquire::RigDescription& rig, unsigned seed) {
  calib::RadianceImage image;
  image.width = rig.geometry.camera.width;
  image.height = rig.geometry.camera.height;
  image.layout = rig.sensor.layout;
  const std::size_t n = static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height) *
                        static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
  image.radiance.resize(n);
  image.variance.resize(n);
  image.flags.resize(n);
  std::mt19937 generator(seed);
  std::uniform_real_distribution<float> uniform(100, 1000);
  for (std::size_t i = 0; i < n; ++i) image.radiance[i] = uniform(generator), image.variance[i] = image.radiance[i] / 10;
  return image;
}

/// Sums of a cell in double: value, variance, coordinates.
struct PlainSums {
  double weight = 0, value = 0, variance = 0, theta_h = 0, theta_d = 0, phi_d = 0;
  std::size_t count = 0, last_view = 0;  // the view's number from 1
};

/// Reads and writes as much memory as the cores can.
double copy_gb_per_s() {
  std::vector<float> from(1 << 25, 1.0f), to(from.size());
  double best = 1e9;
  for (int k = 0; k < 5; ++k) {
    const double begin = seconds();
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, from.size(), 1 << 20),
                      [&](const auto& r) { std::copy(&from[r.begin()], &from[r.begin()] + r.size(), &to[r.begin()]); });
    best = std::min(best, seconds() - begin);
  }
  return 8.0 * static_cast<double>(from.size()) / best / 1e9;
}

void compare(const brdf::HalfAngleTable& table, const std::vector<std::vector<PlainSums>>& plain) {
  double mean = 0, variance = 0, angle = 0;
  std::size_t cells = 0, other_count = 0;
  for (std::size_t c = 0; c < plain.size(); ++c)
    for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
      const PlainSums& p = plain[c][i];
      const auto& t = table.channels[c];
      other_count += t.count[i] != p.count;
      if (p.count == 0) continue;
      ++cells;
      mean = std::max(mean, std::abs(t.mean[i] / (p.value / p.weight) - 1));
      variance = std::max(variance, std::abs(t.variance[i] / (p.variance / (p.weight * p.weight)) - 1));
      angle = std::max({angle, std::abs(t.theta_h[i] - p.theta_h / p.weight), std::abs(t.theta_d[i] - p.theta_d / p.weight)});
    }
  fmt::print("against the plain loop: {} cells, {} with another count; largest difference of the mean {:.1e}, of the variance {:.1e} (relative),\n"
             "  of mean theta_h and theta_d {:.1e} rad\n", cells, other_count, mean, variance, angle);
}

}  // namespace

void accumulation(const std::filesystem::path& source, bool smoke) {
  const auto file = source / "rigs" / (smoke ? "simulated-quick.toml" : "simulated-paper.toml");
  const acquire::RigDescription rig = acquire::parse_rig(brdf::read_text(file), file);
  const calib::Calibration calibration = calib::calibration_from_rig(rig);
  const std::size_t n_channels = static_cast<std::size_t>(acquire::n_channels(rig.sensor.layout));
  // As many images as are tabulated at a time.
  const std::array images{image_for(rig, 1), image_for(rig, 2)};
  static_assert(images.size() == calib::Sampler::views_at_once);
  const calib::RadianceImage& image = images[0];
  double set_up = seconds();
  auto sampler = std::make_unique<calib::Sampler>(calibration, rig.mask, rig.sensor.layout, calib::SampleOptions{});
  set_up = seconds() - set_up;

  std::vector<calib::Illumination> views;
  for (const auto& view : rig.plan)
    if (view.kind == acquire::ViewKind::measurement) views.push_back({static_cast<std::size_t>(view.light), view.turntable_angle, 1});
  if (smoke) views.resize(3);
  std::vector<calib::LitImage> lit;
  for (const auto& view : views) lit.push_back({&images[lit.size() % images.size()], view});
  const std::size_t on_sphere = sampler->n_pixels() * views.size();
  // Several times, because the machine is not always quiet: the fastest counts, of the whole and of each few views that are taken together.
  std::unique_ptr<brdf::TableAccumulator> accumulator;
  struct Pass {
    double total, cpu, empty_table;
    std::size_t samples = 0;
  };
  std::vector<Pass> passes;
  constexpr std::size_t together = calib::Sampler::views_at_once;
  std::vector<double> fastest((lit.size() + together - 1) / together, 1e9);
  for (int pass = 0; pass < (smoke ? 1 : 40); ++pass) {
    accumulator.reset();
    Pass p{seconds(), cpu_seconds(), seconds()};
    accumulator = std::make_unique<brdf::TableAccumulator>(n_channels);
    p.empty_table = seconds() - p.empty_table;
    for (std::size_t v = 0; v < lit.size(); v += together) {
      const double begin = seconds();
      p.samples += sampler->accumulate_views(std::span(lit).subspan(v, std::min(together, lit.size() - v)), *accumulator).used;
      fastest[v / together] = std::min(fastest[v / together], seconds() - begin);
    }
    p.total = seconds() - p.total;
    p.cpu = cpu_seconds() - p.cpu;
    passes.push_back(p);
  }
  std::sort(passes.begin(), passes.end(), [](const Pass& a, const Pass& b) { return a.total < b.total; });
  const Pass best = passes[0], median = passes[passes.size() / 2];
  const auto ns = [&](double s) { return 1e9 * s / static_cast<double>(best.samples); };
  double undisturbed = std::min_element(passes.begin(), passes.end(), [](const Pass& a, const Pass& b) { return a.empty_table < b.empty_table; })->empty_table;
  for (const double t : fastest) undisturbed += t;
  fmt::print("{}: {} images of {} x {}, {} samples of {} pixels on the sphere, all geometry and angles included\n", rig.name, views.size(), image.width,
             image.height, best.samples, on_sphere);
  fmt::print("accumulation, fastest of {} passes: {:.2f} ns per sample, {:.2f} per pixel on the sphere ({:.3f} s, of this {:.3f} s for the memory of the cells);\n"
             "  {:.2f} ns of processor time per sample; median pass {:.2f} ns per sample; every {} views in their fastest pass {:.2f};\n"
             "  geometry of the pixels {:.2f} s once\n",
             passes.size(), ns(best.total), 1e9 * best.total / static_cast<double>(on_sphere), best.total, best.empty_table, ns(best.cpu), ns(median.total),
             together, ns(undisturbed), set_up);
  sampler.reset();
  {
    const double begin = seconds();
    const brdf::HalfAngleTable table = accumulator->table(true);
    fmt::print("table from the sums: {:.2f} s; peak memory of the process until here {:.0f} MB\n", seconds() - begin, peak_mb());
  }
  // The same views, a few of them, by the plain loop.
  sampler = std::make_unique<calib::Sampler>(calibration, rig.mask, rig.sensor.layout, calib::SampleOptions{});
  const std::size_t step = smoke ? 1 : 30;
  brdf::TableAccumulator again(n_channels);
  std::vector<std::vector<PlainSums>> plain(n_channels, std::vector<PlainSums>(brdf::TableGrid::n_cells));
  double plain_time = 0;
  std::size_t plain_samples = 0, plain_views = 0, cells_of_views = 0;
  for (std::size_t v = 0; v < views.size(); v += step) {
    sampler->accumulate_view(image, views[v], again);
    ++plain_views;
    const double begin = cpu_seconds();
    plain_samples += sampler->sample_view(image, views[v], [&](std::span<const calib::Sample> all) {
      for (const calib::Sample& s : all) {
        PlainSums& p = plain[static_cast<std::size_t>(s.channel)][brdf::TableGrid::index(s.coordinates)];
        p.weight += s.weight;
        p.value += s.weight * s.value;
        p.variance += s.weight * s.weight * s.variance;
        p.theta_h += s.weight * s.coordinates.theta_h;
        p.theta_d += s.weight * s.coordinates.theta_d;
        p.phi_d += s.weight * brdf::fold_phi_d(s.coordinates.phi_d);
        ++p.count;
        cells_of_views += std::exchange(p.last_view, v + 1) != v + 1;
      }
    }).used;
    plain_time += cpu_seconds() - begin;
  }
  fmt::print("plain loop, one core: {:.0f} ns of processor time per sample\n", plain_time / static_cast<double>(plain_samples) * 1e9);
  // What memory cannot do without: a pixel's geometry once for the views together, its value, and each cell of a view once in and out.
  const double gb = copy_gb_per_s();
  const double pixels = static_cast<double>(sampler->n_pixels() * plain_views), cells = static_cast<double>(cells_of_views);
  const double bytes = pixels * (static_cast<double>(sizeof(calib::PixelGroup)) / calib::PixelGroup::width / together + 9) + cells * 2 * sizeof(brdf::CellSums);
  fmt::print("copying memory: {:.1f} GB/s; at that rate the {:.0f} bytes per sample that must be moved ({:.1f} samples per cell of a view) would take {:.1f} ns\n", gb,
             bytes / static_cast<double>(plain_samples), static_cast<double>(plain_samples) / cells, bytes / static_cast<double>(plain_samples) / gb);
  compare(again.table(false), plain);
}

}  // namespace lacquer::bench
