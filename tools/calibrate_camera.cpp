#include <fmt/format.h>
#include <glob.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/image_header.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/lens_calibration.h"
#include "tools/calibrate_parts.h"
#include "tools/fit_table.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::vector<std::string> boards;
  std::string size, model = "opencv8", layout = "mono", finder = "opencv", output;
  double square_mm = 0;
  bool no_warp = false, keep_outliers = false;
  calib::LensOptions lens;
};

/// Files of shell patterns and folders, sorted, each once.
std::vector<std::string> files_of(const std::vector<std::string>& patterns) {
  std::vector<std::string> files;
  for (std::string pattern : patterns) {
    if (std::filesystem::is_directory(pattern)) pattern += "/*";
    glob_t found{};
    const int status = glob(pattern.c_str(), 0, nullptr, &found);
    for (std::size_t i = 0; status == 0 && i < found.gl_pathc; ++i)
      if (std::filesystem::is_regular_file(found.gl_pathv[i])) files.emplace_back(found.gl_pathv[i]);
    globfree(&found);
    if (status != 0) throw Error(ErrorCode::file, fmt::format("--boards {}: no such file; expected photographs, a pattern in quotes or a folder", pattern));
  }
  std::sort(files.begin(), files.end());
  files.erase(std::unique(files.begin(), files.end()), files.end());
  return files;
}

calib::BoardShape board_shape(const Options& o) {
  calib::BoardShape shape;
  int end = 0;
  if (std::sscanf(o.size.c_str(), "%4dx%4d%n", &shape.columns, &shape.rows, &end) != 2 || static_cast<std::size_t>(end) != o.size.size())
    throw Error(ErrorCode::usage, fmt::format("--board-size {}: expected inner corners as WxH, e.g. 9x6 (a board of 10 x 7 squares)", o.size));
  shape.square_m = o.square_mm * 1e-3;
  shape.validate();
  return shape;
}

std::string model_name(const std::string& name) {
  std::string upper = name;
  if (name == "opencv4" || name == "opencv5" || name == "opencv8" || name == "opencv12")
    std::transform(upper.begin(), upper.end(), upper.begin(), [](unsigned char c) { return std::toupper(c); });
  return upper.starts_with("LENSMODEL_") ? upper : "LENSMODEL_" + upper;
}

acquire::RawFrame read_photograph(const std::string& file, acquire::PixelLayout layout) {
  const auto bytes = brdf::read_bytes(file, 1u << 30);
  return acquire::decode_frame(bytes, file, acquire::read_image_header(bytes, file).bits, layout);
}

struct Found {
  std::vector<calib::BoardView> views;
  std::vector<std::string> without;
  int width = 0, height = 0;
};

/// A board one corner smaller each way, as who counts squares states it.
void fail_without_boards(const std::string& file, acquire::PixelLayout layout, const calib::BoardShape& shape, std::size_t n_files) {
  calib::BoardShape counted = shape;
  --counted.columns, --counted.rows;
  const bool squares = counted.columns >= 3 && counted.rows >= 3 && calib::find_board(read_photograph(file, layout), counted);
  throw Error(ErrorCode::input, fmt::format("no board of {}x{} inner corners in any of {} photographs{}", shape.columns, shape.rows, n_files,
                                            squares ? fmt::format("; one of {}x{} is: --board-size counts inner corners, not squares", counted.columns, counted.rows)
                                                    : "; expected the whole board in view, sharp, with a white border"));
}

Found find_boards(const std::vector<std::string>& files, const calib::BoardShape& shape, const Options& o, const Progress& progress) {
  const acquire::PixelLayout layout = acquire::pixel_layout_from_name(o.layout);
  const auto finder = o.finder == "mrgingham" ? calib::CornerFinder::mrgingham : calib::CornerFinder::opencv;
  struct Result {
    std::optional<std::vector<glm::dvec2>> corners;
    int width = 0, height = 0;
  };
  std::vector<Result> results(files.size());
  constexpr std::size_t at_once = 4;
  for (std::size_t first = 0; first < files.size(); first += at_once) {
    if (progress) progress("looking for boards", first, files.size());
    tbb::parallel_for(first, std::min(first + at_once, files.size()), [&](std::size_t i) {
      const acquire::RawFrame frame = read_photograph(files[i], layout);
      results[i] = {calib::find_board(frame, shape, finder), frame.width, frame.height};
    });
  }
  Found found{{}, {}, results.front().width, results.front().height};
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (results[i].width != found.width || results[i].height != found.height)
      throw Error(ErrorCode::input, fmt::format("{}: {} x {} pixels; expected {} x {} as {} has", files[i], results[i].width, results[i].height, found.width, found.height, files.front()));
    if (results[i].corners)
      found.views.push_back({files[i], *results[i].corners});
    else
      found.without.push_back(files[i]);
  }
  if (found.views.empty()) fail_without_boards(files.front(), layout, shape, files.size());
  return found;
}

void print_result_json(const calib::LensCalibration& c, const Found& found, double seconds, const Options& o, const Context& context) {
  using Json = nlohmann::ordered_json;
  const auto uncertainty = [](const calib::PixelUncertainty& u) { return Json{{"centre", u.centre}, {"mean", u.mean}, {"worst", u.worst}}; };
  Json j = json_result(context);
  j["model"] = c.lens.model;
  j["imagersize"] = {c.lens.width, c.lens.height};
  j["intrinsics"] = c.lens.intrinsics;
  if (!c.lens.covariance.empty()) {
    j["intrinsics_sigma"] = Json::array();
    for (std::size_t i = 0, n = c.lens.intrinsics.size(); i < n; ++i) j["intrinsics_sigma"].push_back(std::sqrt(c.lens.covariance[i * n + i]));
  }
  j["boards"] = Json::array();
  for (const auto& b : c.boards) j["boards"].push_back({{"file", b.name}, {"rms_px", b.rms_px}, {"outliers", b.n_outliers}});
  j["without_board"] = found.without;
  j["corners"] = c.n_corners;
  j["outliers"] = c.n_outliers;
  j["rms_px"] = c.rms_px;
  j["corner_sigma_px"] = c.sigma_px;
  j["warp_m"] = c.warp_m;
  j["warp_sigma_m"] = c.warp_sigma_m;
  j["board_distance_m"] = c.board_distance_m;
  j["covered"] = c.covered;
  j["uncertainty_px"] = {{"at_boards", uncertainty(c.at_boards)}, {"at_infinity", uncertainty(c.at_infinity)}};
  if (c.cross)
    j["cross_validation"] = {{"boards", c.cross->n_boards}, {"fitted_rms_px", c.cross->fitted_rms_px}, {"held_out_rms_px", c.cross->held_out_rms_px},
                             {"difference_rms_px", c.cross->difference_rms_px}, {"expected_rms_px", c.cross->expected_rms_px}, {"worst_difference_px", c.cross->worst_difference_px}};
  j["warnings"] = c.warnings;
  j["seconds"] = seconds;
  j["lens"] = o.output;
  print_json(j);
}

void print_intrinsics(const acquire::Lens& lens) {
  constexpr std::array names{"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"};
  const std::size_t n = lens.intrinsics.size();
  if (lens.covariance.empty()) {
    fmt::print("fx {:.3f}  fy {:.3f}  cx {:.3f}  cy {:.3f} (held), {} control values\n", lens.intrinsics[0], lens.intrinsics[1], lens.intrinsics[2], lens.intrinsics[3], n - 4);
    return;
  }
  for (std::size_t i = 0; i < n; ++i)
    fmt::print("  {:<3}{}{}\n", names[i], with_error_aligned(lens.intrinsics[i], std::sqrt(lens.covariance[i * n + i]), 13, i < 4 ? 12 : 0), i < 4 ? "px" : "");
}

void print_text(const calib::LensCalibration& c, const Found& found, double seconds, const Options& o) {
  fmt::print("boards: {} of {} photographs, {} corners, {} outliers left out ({:.2f} %)\n", c.boards.size(), c.boards.size() + found.without.size(), c.n_corners, c.n_outliers,
             100 * static_cast<double>(c.n_outliers) / static_cast<double>(c.n_corners));
  for (const std::string& file : found.without) fmt::print("  no board in {}\n", file);
  for (const auto& b : c.boards)
    if (b.n_outliers > 0 || b.rms_px > 2 * c.rms_px) fmt::print("  {}: rms {:.3f} px, {} outliers\n", b.name, b.rms_px, b.n_outliers);
  fmt::print("lens: {}, {} x {} px, rms {:.3f} px, solved in {:.2f} s\n", c.lens.model, c.lens.width, c.lens.height, c.rms_px, seconds);
  print_intrinsics(c.lens);
  if (o.lens.warp) fmt::print("board: middle lifted by {} mm along its rows, {} mm along its columns\n", with_error(1e3 * c.warp_m[0], 1e3 * c.warp_sigma_m[0]),
                              with_error(1e3 * c.warp_m[1], 1e3 * c.warp_sigma_m[1]));
  fmt::print("corner noise: {:.3f} px per coordinate; corners cover {:.0f} % of the image\n", c.sigma_px, 100 * c.covered);
  const auto line = [](const std::string& where, const calib::PixelUncertainty& u) {
    fmt::print("  {:<27}{:>10.2g}{:>10.2g}{:>10.2g}\n", where, u.centre, u.mean, u.worst);
  };
  fmt::print("uncertainty of a pixel, px       middle      mean     worst\n");
  line(fmt::format("at the boards' {:.3g} m", c.board_distance_m), c.at_boards);
  line("far away", c.at_infinity);
  if (c.cross) {
    fmt::print("halves of {} and {} boards: rms {:.3f} px through the own lens, {:.3f} px through the other's\n", c.cross->n_boards[0], c.cross->n_boards[1], c.cross->fitted_rms_px,
               c.cross->held_out_rms_px);
    fmt::print("  their lenses differ by {:.2f} px rms over the image ({:.2f} px expected), {:.2f} px at most\n", c.cross->difference_rms_px, c.cross->expected_rms_px,
               c.cross->worst_difference_px);
  }
  for (const std::string& w : c.warnings) fmt::print("{} {}\n", emphasised("warning:", Emphasis::warning, stdout), w);
  fmt::print("lens: {}\n", o.output);
}

void run(Options o, const Context& context) {
  const calib::BoardShape shape = board_shape(o);
  o.lens.model = model_name(o.model);
  o.lens.warp = !o.no_warp;
  o.lens.reject_outliers = !o.keep_outliers;
  o.lens.validate();
  const std::vector<std::string> files = files_of(o.boards);
  const Found found = find_boards(files, shape, o, stderr_progress(context));
  const auto start = std::chrono::steady_clock::now();
  const calib::LensCalibration c = calib::calibrate_lens(found.views, shape, found.width, found.height, o.lens);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  brdf::write_text_atomically(o.output, acquire::cameramodel_text(c.lens, context.command_line, c.inputs, c.residuals));
  if (context.json)
    print_result_json(c, found, seconds, o, context);
  else
    print_text(c, found, seconds, o);
}

}  // namespace

void add_calibrate_camera(CLI::App& calibrate, Context& context) {
  auto o = std::make_shared<Options>();
  CLI::App* command = calibrate.add_subcommand("camera", "photographs of a chessboard -> lens with its uncertainty, as a .cameramodel of mrcal");
  command->add_option("--boards", o->boards, "photographs of one board: files, patterns in quotes, folders")->required();
  command->add_option("--board-size", o->size, "inner corners WxH, e.g. 9x6")->required();
  command->add_option("--square-mm", o->square_mm, "side of a square, mm")->required();
  command->add_option("--model", o->model, "opencv4, opencv5, opencv8, opencv12 or SPLINED_STEREOGRAPHIC_order=3_Nx=16_Ny=12_fov_x_deg=60")->capture_default_str();
  command->add_option("--layout", o->layout, "of single-channel files: mono, rggb, grbg, gbrg, bggr")->capture_default_str();
  command->add_option("--finder", o->finder, "of the corners; mrgingham: boards of as many rows as columns only")->capture_default_str()->check(CLI::IsMember({"opencv", "mrgingham"}));
  command->add_option("--focal-px", o->lens.focal_px, "first guess of the focal length, pixels; default: from the boards")->check(CLI::PositiveNumber);
  command->add_flag("--flat-board", o->no_warp, "the board is flat: do not solve for its bend");
  command->add_flag("--keep-outliers", o->keep_outliers, "leave no corner out");
  command->add_option("-o,--output", o->output, ".cameramodel to write")->required();
  add_json_option(*command, context);
  command->callback([o, &context] { run(*o, context); });
}

}  // namespace lacquer::tools
