#include "tools/response_plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tools/plot.h"

namespace lacquer::tools {

namespace {

constexpr double sigmas_95 = 1.96;

/// Columns of one channel: value above black, exposure, its band (low, high), ln(curve / power law) in per cent, its band (low, high).
struct ChannelPlot {
  std::vector<std::vector<double>> columns = std::vector<std::vector<double>>(7);
  double exponent = 1;
  double lowest = 0, highest = 0;  ///< of the residual where it is known well enough to be worth the eye ...
  double lowest_exposure = 0;      ///< ... and of the exposure
};

/// Slope and offset of ln exposure over ln(value - black), from 5 to 95 % of the range.
std::pair<double, double> power_law(const calib::ResponseCurve& curve, const std::vector<double>& values, double black) {
  const double top = static_cast<double>(curve.exposure.size());
  double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (const double v : values) {
    if (v < black + 0.05 * (top - black) || v > black + 0.95 * (top - black)) continue;
    const double x = std::log(v - black), y = std::log(curve.exposure[static_cast<std::size_t>(v)]);
    ++n;
    sx += x;
    sy += y;
    sxx += x * x;
    sxy += x * y;
  }
  const double slope = (n * sxy - sx * sy) / (n * sxx - sx * sx);
  return {slope, (sy - slope * sx) / n};
}

ChannelPlot channel_plot(const calib::ResponseCurve& curve, double black) {
  constexpr double well_known = 0.02;
  std::vector<double> values = curve.band_value;
  const double top = static_cast<double>(curve.exposure.size() - 1);
  if (values.empty())
    for (double v = std::floor(black) + 1; v <= top; v = std::max(v + 1, std::floor(black + 1.05 * (v - black)))) values.push_back(v);
  ChannelPlot plot;
  const auto [slope, offset] = power_law(curve, values, black);
  plot.exponent = slope;
  for (const double v : values) {
    const double exposure = curve.exposure[static_cast<std::size_t>(v)], sigma = calib::log_sigma_at(curve, v).value_or(0);
    const double residual = 100 * (std::log(exposure) - offset - slope * std::log(v - black)), width = sigmas_95 * sigma;
    const double row[7] = {v - black, exposure,          exposure * std::exp(-width), exposure * std::exp(width),
                           residual, residual - 100 * width, residual + 100 * width};
    for (std::size_t k = 0; k < 7; ++k) plot.columns[k].push_back(row[k]);
    if (sigma > well_known) continue;
    if (plot.lowest_exposure == 0) plot.lowest_exposure = exposure;
    plot.lowest = std::min(plot.lowest, row[5]);
    plot.highest = std::max(plot.highest, row[6]);
  }
  return plot;
}

}  // namespace

void plot_response(const calib::Response& response, double black_level_dn, const std::filesystem::path& output) {
  const bool colour = response.curves.size() == 3;
  const char* const names[] = {"R", "G", "B"};
  const char* const colours[] = {"vermilion", "green", "blue"};
  std::string script, upper, lower;
  double lowest = 0, highest = 0, lowest_exposure = std::numeric_limits<double>::infinity();
  for (std::size_t c = 0; c < response.curves.size(); ++c) {
    const ChannelPlot plot = channel_plot(response.curves[c], black_level_dn);
    script += plot_data(fmt::format("channel{}", c), plot.columns);
    lowest = std::min(lowest, plot.lowest);
    highest = std::max(highest, plot.highest);
    lowest_exposure = std::min(lowest_exposure, plot.lowest_exposure);
    const char* const paint = colour ? colours[c] : "blue";
    const std::string title = fmt::format("{}exponent {:.3f}", colour ? fmt::format("{}, ", names[c]) : "", plot.exponent);
    upper += fmt::format("{0}$channel{1} using 1:3:4 with filledcurves lc rgb {2}, $channel{1} using 1:2 with lines lc rgb {2} title {3}",
                         c > 0 ? ", " : "plot ", c, paint, plot_text(title));
    lower += fmt::format("{0}$channel{1} using 1:6:7 with filledcurves lc rgb {2}, $channel{1} using 1:5 with lines lc rgb {2}",
                         c > 0 ? ", " : "plot ", c, paint);
  }
  const double margin = std::max(0.1 * (highest - lowest), 0.1);
  const double first = std::floor(black_level_dn) + 1 - black_level_dn, last = std::exp2(response.bits) - black_level_dn;
  script += fmt::format(
      "set multiplot layout 2,1 title {} font ',15'\n"
      "set lmargin 10\nset rmargin 3\n"
      "set logscale xy\nset xrange [{}:{}]\nset yrange [{}:*]\nset format x ''\nset format y '10^{{%T}}'\nset ylabel 'exposure / linear DN'\nset key bottom right\n{}\n"
      "unset logscale y\nset format x '%g'\nset format y '%g'\nset xlabel 'raw value above black / DN'\n"
      "set ylabel 'ln(curve / power law) / %, 95 % band'\nset yrange [{}:{}]\n{}\nunset multiplot\n",
      plot_text(fmt::format("Response, {} bits{}", response.bits, response.linear ? ", linear" : "")), first, last, lowest_exposure / 3, upper, lowest - margin,
      highest + margin, lower);
  gnuplot(script, output, {900, 900});
}

}  // namespace lacquer::tools
