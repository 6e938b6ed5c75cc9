#include "bench/chain/peers.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <random>
#include <sstream>

#include "bench/radiometry/errors.h"
#include "bench/radiometry/peers.h"
#include "bench/radiometry/timing.h"
#include "bench/stability/tables.h"
#include "libacquire/rig_description.h"
#include "libbrdf/cook_torrance_array.h"
#include "libbrdf/table_accumulator.h"
#include "libcalib/merge.h"
#include "libcalib/noise_model.h"
#include "libcalib/samples.h"
#include "libfit/fit.h"

namespace lacquer::bench {

namespace {

namespace fs = std::filesystem;
using Rows = std::vector<std::vector<std::string>>;

std::string ms(double seconds) { return seconds < 0.1 ? fmt::format("{:.2f} ms", 1e3 * seconds) : fmt::format("{:.2f} s", seconds); }
std::string percent(double x) { return fmt::format("{:.3f} %", 100 * x); }

/// Response and merge of eight photographs with 8 bits, about which nothing is known.
void add_radiometry(Rows& rows, bool small) {
  const Stack stack = take_stack({8, gamma_curve(), 0, 20000, 4}, small ? make_scene(60, 45) : make_scene(480, 360), exposure_times(0.25e-3, 0.328, 8), 1);
  const ReferenceImage reference = merge_reference(stack, stack.truth);
  const auto valid = valid_values(stack, reference);
  const std::string stage = fmt::format("response and merge, 8 × {} × {} rgb, 8 bit", stack.frames[0].width, stack.frames[0].height);
  const auto row = [&](const std::string& who, double response_s, double merge_s, std::span<const float> radiance) {
    rows.push_back({stage, who, response_s > 0 ? fmt::format("{} + {}", ms(response_s), ms(merge_s)) : ms(merge_s), "radiance " + percent(radiance_error(radiance, stack, valid).median) + " off, median"});
  };
  calib::Response response;
  calib::NoiseModel noise;
  calib::RadianceImage image;
  const std::vector<std::vector<acquire::RawFrame>> brackets{stack.frames};
  const Timing estimating = time_repeats(1, [&] {
    response = calib::estimate_response(brackets, {}).response;
    noise = calib::estimate_noise(brackets, response, {});
  });
  const Timing merging = time_repeats(3, [&] { image = calib::merge_bracket(stack.frames, response, noise); });
  row("Lacquer", estimating.min_s, merging.min_s, image.radiance);
  const PeerResult robertson = run_opencv_robertson(stack.frames, 1), debevec = run_opencv_debevec(stack.frames, 1);
  row("OpenCV, Robertson", robertson.response.min_s, robertson.merge.min_s, robertson.radiance);
  row("OpenCV, Debevec", debevec.response.min_s, debevec.merge.min_s, debevec.radiance);
  ReferenceImage plain;
  const Timing loop = time_repeats(1, [&] { plain = merge_reference(stack, {}); });
  row("plain loop, response and noise known", 0, loop.min_s, std::vector<float>(plain.radiance.begin(), plain.radiance.end()));
}

/// One radiance image into a table.
void add_tabulation(Rows& rows, bool small) {
  const fs::path root = LACQUER_SOURCE_DIR;
  const auto rig = acquire::read_rig(small ? root / "data-samples" / "tiny-rig.toml" : root / "rigs" / "simulated-quick.toml");
  const auto calibration = calib::calibration_from_rig(rig);
  const calib::Sampler sampler(calibration, rig.mask, rig.sensor.layout, {});
  calib::RadianceImage image{rig.geometry.camera.width, rig.geometry.camera.height, rig.sensor.layout, {}, {}, {}};
  const std::size_t n = static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
  std::mt19937 random(1);
  for (std::size_t i = 0; i < n; ++i) image.radiance.push_back(100 + static_cast<float>(random() % 900)), image.variance.push_back(image.radiance.back() / 10);
  image.flags.resize(n);
  const calib::Illumination lighting{0, 0.5, 1};
  brdf::TableAccumulator fast(3), plain(3);
  std::size_t used = 0;
  const Timing vectorised = time_repeats(1, [&] { used = sampler.accumulate_view(image, lighting, fast).used; });
  const Timing loop = time_repeats(1, [&] {
    sampler.sample_view(image, lighting, [&](std::span<const calib::Sample> samples) {
      for (const calib::Sample& s : samples) add_sample(plain, s);
    });
  });
  const brdf::HalfAngleTable a = fast.table(false), b = plain.table(false);
  double worst = 0;
  for (std::size_t c = 0; c < 3; ++c)
    for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i)
      if (b.channels[c].count[i] > 0) worst = std::max(worst, std::abs(static_cast<double>(a.channels[c].mean[i]) / static_cast<double>(b.channels[c].mean[i]) - 1));
  const std::string stage = fmt::format("tabulation, {} samples", used);
  const auto each = [&](double s) { return fmt::format("{:.0f} ns per sample", 1e9 * s / static_cast<double>(used)); };
  rows.push_back({stage, "Lacquer", each(vectorised.min_s), fmt::format("cells within {:.1g} of the plain loop", worst)});
  rows.push_back({stage, "plain loop in double, one thread", each(loop.min_s), ""});
}

/// Parameters in the order of fit.json; error: the largest relative one.
double largest_error(const std::vector<double>& x, const std::vector<double>& truth) {
  double worst = 0;
  for (std::size_t k = 0; k < truth.size(); ++k) worst = std::max(worst, std::abs(x[k] / truth[k] - 1));
  return worst;
}

std::vector<double> values_of(const brdf::CookTorrance& model) {
  std::vector<double> x{model.kd.x, model.kd.y, model.kd.z};
  for (const auto& lobe : model.lobes) x.insert(x.end(), {lobe.ks.x, lobe.ks.y, lobe.ks.z});
  for (const auto& lobe : model.lobes) x.insert(x.end(), {lobe.m, lobe.r});
  return x;
}

/// Ford F8 with 5 % noise.
void add_fit(Rows& rows, const fs::path& folder, bool small) {
  constexpr double noise = 0.05;
  const brdf::CookTorrance truth = paint("ford-f8");
  const brdf::HalfAngleTable table = table_of(truth, small ? 401 : 23, noise);
  fit::FitOptions options;
  options.n_lobes = 3, options.model_sigma = 1e-3;
  const fit::FitResult ours = fit::fit_table(table, options);
  const std::string stage = fmt::format("fit, three lobes, {} cells with 5 % noise", ours.n_cells);
  rows.push_back({stage, "Lacquer", fmt::format("{:.2f} s", ours.seconds), "worst parameter " + percent(largest_error(values_of(ours.model), values_of(truth)))});
  // The rows that scipy_fit.py wants, of the same cells; it starts 20 % off the truth, ours from nothing.
  std::vector<double> cells, start = values_of(truth);
  for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
    if (table.channels[0].origin[i] != brdf::CellOrigin::measured) continue;
    const auto c = brdf::half_angle_cosines(brdf::TableGrid::centre(i));
    if (std::min(c.n_dot_i, c.n_dot_o) <= options.min_cosine) continue;
    cells.insert(cells.end(), {c.tan2_theta_h, brdf::schlick_weight(c.i_dot_h), brdf::geometry_over_cosines(c) / (std::numbers::pi * std::pow(c.n_dot_h, 4))});
    for (const auto& channel : table.channels) cells.push_back(static_cast<double>(channel.mean[i]));
    cells.insert(cells.end(), {noise, 0});
  }
  for (std::size_t k = 0; k < start.size(); ++k) start[k] *= k % 2 ? 0.8 : 1.2;
  for (std::size_t k = 12; k < start.size(); k += 2) start[k] = std::log(start[k]);
  std::ofstream(folder / "cells.f64", std::ios::binary).write(reinterpret_cast<const char*>(cells.data()), static_cast<std::streamsize>(cells.size() * sizeof(double)));
  std::ofstream(folder / "start.json") << fmt::format("[{}]", fmt::join(start, ", "));
  const std::string command = fmt::format("/usr/bin/python3 '{0}/bench/fit/scipy_fit.py' '{1}/cells.f64' '{1}/start.json' 100 > '{1}/answer.json' 2> /dev/null", LACQUER_SOURCE_DIR, folder.string());
  if (std::system(command.c_str()) != 0) return rows.push_back({stage, "SciPy least_squares", "", "no answer: not installed, or longer than 100 s"});
  // {"seconds": s, "cost": c, "x": [...]}
  const std::string answer = brdf::read_text(folder / "answer.json");
  std::vector<double> x;
  std::string list = answer.substr(answer.find('[') + 1);
  std::replace(list.begin(), list.end(), ',', ' ');
  std::istringstream numbers(list);
  for (double v; numbers >> v;) x.push_back(v);
  rows.push_back({stage, "SciPy least_squares, from 20 % off the truth", fmt::format("{:.2f} s", std::atof(answer.c_str() + answer.find(':') + 1)), "worst parameter " + percent(largest_error(x, values_of(truth)))});
  for (const char* made : {"cells.f64", "start.json", "answer.json"}) fs::remove(folder / made);
}

/// RGB values of Polaris Silber.
void add_evaluation(Rows& rows) {
  const brdf::CookTorrance model = paint("polaris-silber");
  std::array<std::vector<float>, 5> c;
  std::vector<brdf::HalfAngleCosines<float>> one_by_one;
  for (std::size_t i = 0; i < brdf::TableGrid::n_cells; i += 7) {
    if (!brdf::TableGrid::reachable(brdf::TableGrid::cell(i), 0.09)) continue;
    const auto d = brdf::half_angle_cosines(brdf::TableGrid::centre(i));
    const std::array<double, 5> v{d.n_dot_i, d.n_dot_o, d.n_dot_h, d.i_dot_h, d.tan2_theta_h};
    for (std::size_t k = 0; k < 5; ++k) c[k].push_back(static_cast<float>(v[k]));
    one_by_one.push_back({c[0].back(), c[1].back(), c[2].back(), c[3].back(), c[4].back(), {}});
  }
  std::array<std::vector<float>, 3> out;
  for (auto& o : out) o.resize(one_by_one.size());
  float* const to[]{out[0].data(), out[1].data(), out[2].data()};
  const Timing arrays = time_repeats(5, [&] { brdf::evaluate(model, {c[0].data(), c[1].data(), c[2].data(), c[3].data(), c[4].data()}, one_by_one.size(), to); });
  std::vector<glm::vec3> values(one_by_one.size());
  const Timing loop = time_repeats(5, [&] {
    for (std::size_t i = 0; i < one_by_one.size(); ++i) values[i] = model.value(one_by_one[i]);
  });
  double worst = 0;
  for (std::size_t i = 0; i < values.size(); ++i) worst = std::max(worst, std::abs(static_cast<double>(out[1][i]) / static_cast<double>(values[i].y) - 1));
  const std::string stage = "evaluation, three lobes, one thread";
  const auto each = [&](double s) { return fmt::format("{:.1f} ns per RGB value", 1e9 * s / static_cast<double>(values.size())); };
  rows.push_back({stage, "Lacquer, arrays", each(arrays.min_s), fmt::format("within {:.1g} of the plain loop", worst)});
  rows.push_back({stage, "plain loop", each(loop.min_s), ""});
}

}  // namespace

Rows peer_rows(const fs::path& folder, bool small) {
  Rows rows{{"stage", "by", "time", "error"}};
  add_radiometry(rows, small);
  add_tabulation(rows, small);
  add_fit(rows, folder, small);
  add_evaluation(rows);
  return rows;
}

}  // namespace lacquer::bench
