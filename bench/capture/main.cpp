#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>
#include <thread>

#include "libacquire/capture_estimate.h"
#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "libcalib/merge_session.h"

/// What capturing and merging add to the time that exposing and turning take anyway. The devices are fakes that only wait: a camera for its
/// exposure, a turntable for a move of a stepper; everything else is the pipeline of `lacquer measure`: frames to disk with checksums, the
/// journal synced after each, merging and radiance files beside it.
namespace lacquer {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// Time spent in devices, and how far writing and merging are behind.
struct Observed {
  double waited_s = 0;                 ///< in the devices, as it really was
  std::atomic<int> n_taken{0}, n_merged{0};
  std::vector<double> gaps_s;          ///< between the end of one exposure and the beginning of the next, moves left out
  std::vector<int> depths;             ///< frames taken, but not merged yet, at the beginning of each exposure
  Clock::time_point free_since = Clock::now();

  void wait(double seconds) {
    const auto start = Clock::now();
    std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
    waited_s += seconds_since(start);
  }
};

class WaitingTurntable final : public acquire::Turntable {
 public:
  WaitingTurntable(Observed& observed, double move_s) : observed_(observed), move_s_(move_s) {}
  void hold() noexcept override {}
  std::string description() const override { return "waiting turntable"; }

 private:
  double do_move_to(double angle) override {
    if (move_s_ > 0) observed_.wait(move_s_);
    observed_.free_since = Clock::now();
    return angle;
  }
  Observed& observed_;
  double move_s_;
};

class WaitingLights final : public acquire::LightSwitch {
 public:
  void off() noexcept override {}
  std::string description() const override { return "waiting lights"; }
  int n_lights() const override { return 1; }

 private:
  void do_on(int) override {}
};

/// Photographs of a bright spot with shot noise, made beforehand.
class WaitingCamera final : public acquire::Camera {
 public:
  WaitingCamera(Observed& observed, const acquire::RigDescription& rig, bool expose) : observed_(observed), expose_(expose) {
    std::mt19937_64 random(1);
    std::normal_distribution<float> normal;
    const int width = rig.geometry.camera.width, height = rig.geometry.camera.height;
    for (const double exposure : rig.plan[0].exposures_s) {
      std::vector<std::uint16_t>& frame = frames_[exposure];
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
          const double r = std::hypot(x - width / 2.0, y - height / 2.0) / (0.42 * height);
          const double signal = r < 1 ? exposure * (2e5 + 5e7 * std::exp(-60 * r * r)) : 0;
          frame.push_back(static_cast<std::uint16_t>(std::clamp(std::lround(1000 + signal + std::sqrt(25 + signal / 0.5) * normal(random)), 0l, 65535l)));
        }
    }
  }
  std::string description() const override { return "waiting camera"; }

 private:
  acquire::RawFrame do_capture(const acquire::CaptureSettings& asked) override {
    observed_.gaps_s.push_back(seconds_since(observed_.free_since));
    observed_.depths.push_back(observed_.n_taken - observed_.n_merged);
    if (expose_) observed_.wait(asked.exposure_s);
    acquire::RawFrame frame{.width = 1360, .height = 1024, .layout = acquire::PixelLayout::bayer_rggb, .bits = 16, .data = frames_.at(asked.exposure_s),
                            .actual = asked};
    ++observed_.n_taken;
    observed_.free_since = Clock::now();
    return frame;
  }
  Observed& observed_;
  std::map<double, std::vector<std::uint16_t>> frames_;
  bool expose_;
};

acquire::RigDescription rig_of(int views, int exposures, const std::filesystem::path& folder) {
  const std::string text = fmt::format(R"([rig]
name = "bench"
kind = "simulated"
[camera]
width_px = 1360
height_px = 1024
layout = "rggb"
bits = 16
focal_length_px = 8679
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 1000
gain_e_per_dn = 0.5
read_noise_e = 3
sensitivity_e_per_s = 5e5
[[lights]]
position_mm = [0, 124.747, 586.889]
[plan]
angles_deg = {{ from = 0, to = {}, step = 1 }}
exposures_ms = {{ from = 0.25, to = 328, count = {} }}
)", views - 1, exposures);
  return acquire::parse_rig(text, folder / "rig.toml");
}

double percentile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

/// One capture into a new folder; a line of the table.
void measure(const std::string& name, int views, int exposures, bool merging, bool waiting, const std::filesystem::path& folder) {
  const acquire::RigDescription rig = rig_of(views, exposures, folder);
  const calib::Calibration calibration = calib::calibration_from_rig(rig);
  // A stepper at 20 deg/s and 20 deg/s^2, 0.2 s to settle: the defaults of rigs/README.md, for the plan's step of 1 degree.
  const double degree = 3.14159265358979323846 / 180;
  const double move_s = waiting ? 0.2 + acquire::move_duration(degree, 20 * degree, 20 * degree) : 0;
  Observed observed;
  acquire::Rig devices;
  devices.turntable = std::make_unique<WaitingTurntable>(observed, move_s);
  devices.lights = std::make_unique<WaitingLights>();
  devices.camera = std::make_unique<WaitingCamera>(observed, rig, waiting);

  calib::SessionMerger merger(rig, folder / name, calibration);
  double merge_s = 0;
  acquire::FrameSink sink;
  sink.frame = [&](const acquire::ViewRecord& view, const acquire::RawFrame& frame) {
    const auto start = Clock::now();
    if (merging) merger.add(view, frame);
    merge_s += seconds_since(start);
    ++observed.n_merged;
  };
  if (merging) sink.view = [&](const acquire::ViewRecord& view) {
    const auto start = Clock::now();
    merger.finish_view(view);
    merge_s += seconds_since(start);
  };
  observed.free_since = Clock::now();
  const auto start = Clock::now();
  acquire::capture_session(devices, rig, folder / name, {}, {}, sink);
  const double wall_s = seconds_since(start), n = static_cast<double>(observed.n_taken);
  fmt::print("| {} | {:.2f} | {:.2f} | {} | {:.1f} | {:.1f} | {:.1f} / {:.1f} | {} |\n", name, observed.waited_s, wall_s,
             waiting ? fmt::format("{:.2f} %", 100 * (wall_s / observed.waited_s - 1)) : "-", n / wall_s, 1e3 * merge_s / n,
             1e3 * percentile(observed.gaps_s, 0.5), 1e3 * percentile(observed.gaps_s, 1), *std::max_element(observed.depths.begin(), observed.depths.end()));
  std::filesystem::remove_all(folder / name);
}

}  // namespace
}  // namespace lacquer

int main(int argc, char** argv) {
  CLI::App app{"Overhead of capturing: 1360 x 1024, 16 bits, frames to disk and merged while the next ones are exposed"};
  std::filesystem::path folder = std::filesystem::temp_directory_path() / "lacquer-bench-capture";
  int views = 12;
  bool smoke = false;
  app.add_option("--folder", folder, "where the sessions go, and are removed from; 540 MB for 12 views")->capture_default_str();
  app.add_option("--views", views, "of 16 exposures each")->capture_default_str()->check(CLI::Range(1, 1000));
  app.add_flag("--smoke", smoke, "one view of three exposures: only whether it runs");
  CLI11_PARSE(app, argc, argv);
  if (smoke) views = 1;
  const int exposures = smoke ? 3 : 16;
  try {
    std::filesystem::create_directories(folder);
    fmt::print("{} processors\n\n", std::thread::hardware_concurrency());
    fmt::print("| what | exposing and turning (s) | all (s) | added | frames/s | merging (ms/frame) | gap between exposures, median / longest (ms) "
               "| frames not merged yet, most |\n|---|---|---|---|---|---|---|---|\n");
    lacquer::measure("capture", views, exposures, false, true, folder);
    lacquer::measure("capture and merge", views, exposures, true, true, folder);
    lacquer::measure("no exposure, no turning", views, exposures, true, false, folder);
  } catch (const std::exception& e) {
    fmt::print(stderr, "bench_capture: {}\n", e.what());
    return 1;
  }
  return 0;
}
