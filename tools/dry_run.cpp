#include "tools/dry_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "libacquire/capture_estimate.h"
#include "libbrdf/error.h"
#include "tools/json_output.h"
#include "tools/plot.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

using Grid = brdf::TableGrid;
constexpr double degrees = 180 / 3.14159265358979323846;

/// "a, b and c", shortened in the middle.
std::string list_text(const std::set<double>& values, double factor, const char* unit) {
  if (values.size() <= 4) {
    std::string text;
    for (const double v : values) text += fmt::format("{}{:.4g}", text.empty() ? "" : ", ", v * factor);
    return text + " " + unit;
  }
  return fmt::format("{} from {:.4g} to {:.4g} {}", values.size(), *values.begin() * factor, *values.rbegin() * factor, unit);
}

std::string plan_text(const acquire::RigDescription& rig, const acquire::CaptureEstimate& estimate) {
  std::set<double> angles, exposures;
  std::set<int> lights;
  for (const acquire::PlannedView& view : rig.plan) {
    angles.insert(view.turntable_angle);
    exposures.insert(view.exposures_s.begin(), view.exposures_s.end());
    if (view.kind != acquire::ViewKind::dark) lights.insert(view.light);
  }
  std::string names;
  for (const int light : lights)
    if (names.size() < 60) names += fmt::format("{}{}", names.empty() ? "" : ", ", rig.geometry.lights.at(static_cast<std::size_t>(light)).name);
    else if (!names.ends_with(" ...")) names += " ...";
  std::string views = fmt::format("{} views", estimate.n_views);
  if (estimate.n_references) views += fmt::format(", {} reference views", estimate.n_references);
  if (estimate.n_darks) views += fmt::format(", {} dark views", estimate.n_darks);
  const auto& camera = rig.geometry.camera;
  const std::string adaptive = rig.adaptive_loss ? fmt::format("; adaptive: each view takes those it needs, {:g} % loss of sigma in the mean at most, so that frames, "
                                                               "duration and disk are upper limits", 100 * *rig.adaptive_loss)
                                                 : "";
  return fmt::format("rig: {} ({})\nframes: {}, {} frames of {} x {} {}, {} bit\nangles: {}\nlights: {} ({})\nexposures: {}{}\n", rig.name,
                     rig.file.string(), views, estimate.n_frames, camera.width, camera.height, name_of(rig.sensor.layout),
                     rig.sensor.bits, list_text(angles, degrees, "deg"), lights.size(), names, list_text(exposures, 1e3, "ms"), adaptive);
}

std::string time_text(const acquire::RigDescription& rig, const acquire::CaptureEstimate& e) {
  if (rig.kind == acquire::RigDescription::Kind::replay) return "duration: that of reading the photographs\n";
  return fmt::format("duration: {}{}\n          exposing {}, reading out {}, lights {}, turning {}\n", duration_text(e.total_s()),
                     rig.kind == acquire::RigDescription::Kind::simulated ? " on the simulated clock (rendering takes its own time)" : "",
                     duration_text(e.exposure_s), duration_text(e.readout_s), duration_text(e.lights_s), duration_text(e.motion_s));
}

std::string size_text(double bytes) {
  return bytes < 1e9 ? fmt::format("{:.1f} MB", bytes * 1e-6) : fmt::format("{:.1f} GB", bytes * 1e-9);
}

struct DiskNeeds {
  double frames = 0, radiance = 0, table = 0;  ///< bytes
  std::string place;                           ///< the folder asked for what is free
  std::optional<double> free;
};

/// Radiance files are uncompressed: radiance, variance and flag of 4 bytes each. Tables are compressed, and hold about 36 bytes per cell.
DiskNeeds disk_needs(const acquire::RigDescription& rig, const acquire::CaptureEstimate& estimate, const brdf::HalfAngleTable& table,
                     const std::filesystem::path& session) {
  const auto& camera = rig.geometry.camera;
  const double values = static_cast<double>(camera.width) * camera.height * values_per_pixel(rig.sensor.layout);
  double cells = 0;
  for (const auto& channel : table.channels)
    cells += static_cast<double>(std::count_if(channel.origin.begin(), channel.origin.end(), [](auto o) { return o != brdf::CellOrigin::empty; }));
  DiskNeeds disk{.frames = static_cast<double>(estimate.frame_bytes), .radiance = static_cast<double>(estimate.n_views + estimate.n_references) * (12 * values + 1e4),
                 .table = 2e6 + 36 * cells, .place = {}, .free = {}};
  // The nearest folder that exists is on the same disk.
  std::filesystem::path place = std::filesystem::absolute(session.empty() ? std::filesystem::path(".") : session).lexically_normal();
  std::error_code status;
  while (!std::filesystem::exists(place, status) && place.has_parent_path() && place != place.parent_path()) place = place.parent_path();
  const auto space = std::filesystem::space(place, status);
  disk.place = place.string();
  if (!status) disk.free = static_cast<double>(space.available);
  return disk;
}

std::string disk_text(const DiskNeeds& disk) {
  std::string text = fmt::format("disk: {} of frames; lacquer measure adds {} of radiance, some {} of table", size_text(disk.frames), size_text(disk.radiance), size_text(disk.table));
  if (!disk.free) return text + "\n";
  text += fmt::format("\n      {} are free at {}", size_text(*disk.free), disk.place);
  if (*disk.free < disk.frames) text += ": TOO LITTLE even for the frames";
  else if (*disk.free < disk.frames + disk.radiance + disk.table) text += ": too little for lacquer measure";
  return text + "\n";
}

nlohmann::ordered_json dry_run_json(const acquire::RigDescription& rig, const acquire::CaptureEstimate& e, const DiskNeeds& disk, const calib::Tabulation& coverage, const Context& context) {
  using Json = nlohmann::ordered_json;
  Json j = json_result(context, {rig.file.string()});
  j["rig"] = rig.name;
  j["views"] = {{"measurement", e.n_views}, {"reference", e.n_references}, {"dark", e.n_darks}};
  j["frames"] = e.n_frames;
  j["seconds"] = {{"total", e.total_s()}, {"exposing", e.exposure_s}, {"reading_out", e.readout_s}, {"lights", e.lights_s}, {"turning", e.motion_s}};
  j["bytes"] = {{"frames", disk.frames}, {"radiance", disk.radiance}, {"table", disk.table}, {"free", disk.free ? Json(*disk.free) : Json()}};
  j["coverage"] = to_json(coverage);
  return j;
}

void plot_map(const calib::CoverageMap& map, const acquire::RigDescription& rig, const std::filesystem::path& output) {
  std::vector<double> theta_d, theta_h, share;
  for (int h = 0; h < Grid::n_theta_h; ++h)
    for (int d = 0; d < Grid::n_theta_d; ++d) {
      const auto& entry = map.at(h, d);
      theta_d.push_back(d + 0.5);
      theta_h.push_back(h + 0.5);
      share.push_back(entry.reachable ? 100.0 * entry.covered / entry.reachable : std::nan(""));
    }
  std::string tics;
  for (const int theta : {0, 1, 5, 10, 20, 30, 45, 60, 75, 90})
    tics += fmt::format("{}'{}' {}", tics.empty() ? "" : ", ", theta, std::sqrt(theta / 90.0) * Grid::n_theta_h);
  gnuplot(plot_data("share", {theta_d, theta_h, share}) +
              "set title " + plot_text("predicted coverage of the table over phi_d: " + rig.name) +
              "\nset xlabel 'theta_d (degrees)'\nset ylabel 'theta_h (degrees; the cells of the table are equally high)'\n"
              "set cblabel 'cells measured or known by symmetry, % of those reachable'\nset xrange [0:90]\nset yrange [90:0]\n"
              "set cbrange [0:100]\nset ytics (" + tics + ")\nset palette defined (0 '#440154', 25 '#3b528b', 50 '#21918c', 75 '#5ec962', 100 '#fde725')\nunset grid\nunset key\n"
              "plot $share using 1:2:3 with image pixels\n",
          output);
}

}  // namespace

std::string duration_text(double seconds) {
  if (seconds < 59.95) return fmt::format("{:.1f} s", seconds);
  const auto whole = static_cast<long long>(std::llround(seconds));
  if (whole < 3600) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
  return fmt::format("{} h {:02} min", (whole + 30) / 3600, (whole + 30) / 60 % 60);
}

std::string coverage_map_text(const calib::CoverageMap& map) {
  constexpr int rows = 5, columns = 2;  // cells per character
  std::string text = "theta_h (deg)   theta_d from 0 (left) to 90 deg (right)\n";
  for (int h = 0; h < Grid::n_theta_h; h += rows) {
    std::string line;
    for (int d = 0; d < Grid::n_theta_d; d += columns) {
      int reachable = 0, covered = 0;
      for (int i = 0; i < rows; ++i)
        for (int j = 0; j < columns; ++j) {
          reachable += map.at(h + i, d + j).reachable;
          covered += map.at(h + i, d + j).covered;
        }
      const int tenths = reachable ? static_cast<int>(std::floor(10.0 * covered / reachable + 0.5)) : 0;
      line += !reachable ? ' ' : !covered ? '.' : tenths >= 10 ? '#' : static_cast<char>('0' + tenths);
    }
    line.resize(line.find_last_not_of(' ') + 1);
    text += fmt::format("{:5.1f} .. {:4.1f}   {}\n", Grid::theta_h_edge(h) * degrees, Grid::theta_h_edge(h + rows) * degrees, line);
  }
  return text;
}

void print_dry_run(const acquire::RigDescription& rig, const DryRunOptions& options, const Context& context) {
  if (!options.map.empty()) check_plot_name(options.map);
  const acquire::CaptureEstimate estimate = acquire::estimate_capture(rig);
  const calib::Tabulation coverage = calib::predict_coverage(rig, options.samples, stderr_progress(context));
  const DiskNeeds disk = disk_needs(rig, estimate, coverage.table, options.session);
  const auto& channels = coverage.table.channels;
  const calib::CoverageMap map = calib::coverage_map(channels[channels.size() / 2]);
  if (!options.map.empty()) plot_map(map, rig, options.map);
  if (context.json) return print_json(dry_run_json(rig, estimate, disk, coverage, context));
  fmt::print("{}{}{}\n", plan_text(rig, estimate), time_text(rig, estimate), disk_text(disk));
  fmt::print("coverage of the table if nothing clips:\n{}\n", coverage_text(coverage));
  if (options.map.empty())
    fmt::print("\ncells over phi_d, in tenths (#: all, .: none):\n{}", coverage_map_text(map));
  else
    fmt::print("map: {}\n", options.map.string());
}

}  // namespace lacquer::tools
