#include "tools/drift_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "tools/plot.h"

namespace lacquer::tools {

namespace {

using calib::LightDrift;

constexpr std::size_t max_lights = 8;  ///< that are named or drawn one by one

const char* words_for(LightDrift::Model model) {
  switch (model) {
    case LightDrift::Model::none: return "steady";
    case LightDrift::Model::linear: return "a line";
    case LightDrift::Model::warm_up: return "a warm-up";
    case LightDrift::Model::smooth: return "a smooth curve";
    case LightDrift::Model::per_view: return "followed view by view";
  }
  return "";
}

double rms_about_mean(const std::vector<calib::DriftPoint>& points) {
  double sum = 0, square = 0;
  for (const auto& p : points) sum += p.intensity;
  const double n = static_cast<double>(points.size()), mean = sum / n;
  for (const auto& p : points) square += (p.intensity - mean) * (p.intensity - mean);
  return std::sqrt(square / n);
}

std::string light_text(const std::string& name, const LightDrift& d) {
  if (d.points.size() < 2) return fmt::format("{}: not followed, taken as steady", name);
  const std::string n = fmt::format("{} images in {:.4g} s", d.points.size(), d.points.back().time_s - d.points.front().time_s);
  if (d.model == LightDrift::Model::none)
    return fmt::format("{}: no drift found in {}, which agree within {:.2g} % RMS; nothing applied", name, n, 100 * rms_about_mean(d.points));
  const double end = d.points.back().time_s;
  std::string text = fmt::format("{}: {} through {}, at the end {:.5f} ± {:.1g} of the start", name, words_for(d.model), n, d.factor(end), d.factor_sigma(end));
  if (d.model == LightDrift::Model::warm_up) text += fmt::format(", time constant {:.3g} s", d.time_constant_s);
  if (d.light_noise > 0) text += fmt::format(", flicker {:.2g} % per view", 100 * d.light_noise);
  return text;
}

/// Time, intensity in per cent of the start, its standard error.
std::vector<std::vector<double>> point_columns(const LightDrift& d) {
  std::vector<std::vector<double>> columns(3);
  for (const auto& p : d.points) {
    columns[0].push_back(p.time_s);
    columns[1].push_back(100 * p.intensity);
    columns[2].push_back(100 * std::hypot(p.sigma, d.light_noise));
  }
  return columns;
}

/// Time, model in the same unit, lower and upper end of its band. The points are relative to the first image with its own noise and
/// flicker, the factor to the model's start: drawn through the points.
std::vector<std::vector<double>> model_columns(const LightDrift& d) {
  std::vector<double> times;
  const double first = d.points.front().time_s, last = d.points.back().time_s;
  constexpr int n = 200;
  for (int i = 0; i <= n && d.model != LightDrift::Model::per_view; ++i) times.push_back(first + (last - first) * i / n);
  if (times.empty())
    for (const auto& p : d.points) times.push_back(p.time_s);
  double weight = 0, ratio = 0;
  for (const auto& p : d.points) {
    const double w = 1 / (p.sigma * p.sigma + d.light_noise * d.light_noise);
    weight += w;
    ratio += w * p.intensity / d.factor(p.time_s);
  }
  const double level = d.model == LightDrift::Model::per_view ? 100 : 100 * ratio / weight;
  std::vector<std::vector<double>> columns(4);
  for (const double t : times) {
    const double value = level * d.factor(t), width = 2 * level * d.factor_sigma(t);
    const double row[] = {t, value, value - width, value + width};
    for (std::size_t k = 0; k < columns.size(); ++k) columns[k].push_back(row[k]);
  }
  return columns;
}

}  // namespace

std::string light_and_dark_text(const calib::Calibration& c) {
  std::string text = c.dark_source.empty() ? "" : "darkness: " + c.dark_source + "\n";
  if (c.drift_source.empty()) return text + "lights: not followed (neither reference views nor a patch), taken as steady";
  text += "lights, by " + c.drift_source + ":";
  for (std::size_t l = 0; l < std::min(c.light_drift.size(), max_lights); ++l)
    text += "\n  " + light_text(c.geometry.lights[l].name, c.light_drift[l]);
  if (c.light_drift.size() > max_lights) text += fmt::format("\n  {} more lights: see light_drift in calibration.json", c.light_drift.size() - max_lights);
  return text;
}

bool plot_drift(const calib::Calibration& c, const std::filesystem::path& output) {
  const char* const colours[max_lights] = {"blue", "vermilion", "green", "purple", "orange", "sky", "black", "grey"};
  std::string data, curves;
  for (std::size_t l = 0; l < std::min(c.light_drift.size(), max_lights); ++l) {
    const LightDrift& d = c.light_drift[l];
    if (d.points.size() < 2) continue;
    data += plot_data(fmt::format("points{}", l), point_columns(d)) + plot_data(fmt::format("model{}", l), model_columns(d));
    const std::string title = plot_text(fmt::format("{}: {}", c.geometry.lights[l].name, words_for(d.model)));
    curves += fmt::format("{0}$model{1} using 1:3:4 with filledcurves fs transparent solid 0.25 lc rgb {2} notitle, "
                          "$model{1} using 1:2 with lines lc rgb {2} title {3}, $points{1} using 1:2:3 with yerrorbars pt 7 ps 0.5 lc rgb {2} notitle",
                          curves.empty() ? "plot " : ", ", l, colours[l], title);
  }
  if (curves.empty()) return false;
  gnuplot(data + "set xlabel 'time since the capture began / s'\nset ylabel 'light relative to its first image / %'\nset key top right\n" + curves + "\n",
          output, {900, 500});
  return true;
}

}  // namespace lacquer::tools
