#include "tools/brdf_plots.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "libcalib/coverage.h"
#include "tools/html.h"
#include "libfit/residual_map.h"

namespace lacquer::tools {

namespace {

using brdf::TableGrid;

constexpr double degree = std::numbers::pi / 180, nothing = std::numeric_limits<double>::quiet_NaN();
constexpr const char* colours[] = {"blue", "vermilion", "green", "purple", "orange", "sky", "black", "grey"};

/// f_r of the green channel; camera at `theta_o` in the plane of incidence, positive on the mirror's side. NaN: nothing, or not positive.
double in_plane(const brdf::Brdf& brdf, double theta_i, double theta_o) {
  const auto value = brdf.value({brdf::direction(theta_i, std::numbers::pi), brdf::direction(std::abs(theta_o), theta_o < 0 ? std::numbers::pi : 0.0)});
  return value && value->y > 0 ? value->y : nothing;
}

/// Angles of the camera, degrees: dense at the mirror, where a clear coat is less than a degree wide.
std::vector<double> camera_angles(double incidence_deg) {
  std::vector<double> angles;
  for (double a = -85; a <= 85; a += 0.5) angles.push_back(a);
  for (double a = -4; a <= 4; a += 0.05)
    if (std::abs(incidence_deg + a) <= 85) angles.push_back(incidence_deg + a);
  std::sort(angles.begin(), angles.end());
  return angles;
}


std::string curve_style(std::size_t brdf, std::size_t n_brdfs, const char* colour, double point_size = 0.4) {
  if (brdf == 0 && n_brdfs > 1) return fmt::format("with points pt 7 ps {} lc rgb {}", point_size, colour);
  return fmt::format("with lines dt {} lw 1.6 lc rgb {}", std::max<std::size_t>(brdf, 1), colour);
}

std::string names_of(const std::vector<NamedBrdf>& brdfs) {
  std::string names;
  for (const auto& b : brdfs) names += (names.empty() ? "" : ", ") + b.name;
  return names;
}

/// Legend of the BRDFs: how each is drawn.
std::string brdf_keys(const std::vector<NamedBrdf>& brdfs) {
  std::string keys;
  if (brdfs.size() < 2) return keys;
  for (std::size_t b = 0; b < brdfs.size(); ++b)
    keys += fmt::format(", NaN {} title {}", curve_style(b, brdfs.size(), "black", 0.6), plot_text(brdfs[b].name));
  return keys;
}

constexpr const char* viridis =
    "set style fill solid\nset palette defined (0 '#440154', 1 '#482878', 2 '#3e4989', 3 '#31688e', 4 '#26828e', 5 '#1f9e89', 6 '#35b779', 7 '#6ece58', 8 '#b5de2b', 9 '#fde725')\n";
constexpr const char* blue_white_red = "set style fill solid\nset palette defined (0 '#2166ac', 1 '#92c5de', 2 '#f7f7f7', 3 '#f4a582', 4 '#b2182b')\n";

std::string matrix(const std::string& name, const std::vector<double>& values, int columns) {
  std::string text = fmt::format("${} << EOD\n", name);
  for (std::size_t i = 0; i < values.size(); ++i)
    text += (std::isfinite(values[i]) ? fmt::format("{:.5g}", values[i]) : "NaN") + ((i + 1) % static_cast<std::size_t>(columns) == 0 ? "\n" : " ");
  return text + "EOD\n";
}

}  // namespace

Plot log_plot(const std::vector<NamedBrdf>& brdfs, const std::vector<double>& incidence_deg) {
  std::string data, curves;
  for (std::size_t k = 0; k < incidence_deg.size(); ++k)
    for (std::size_t b = brdfs.size(); b-- > 0;) {  // points above lines
      const auto angles = camera_angles(incidence_deg[k]);
      std::vector<double> values;
      for (const double a : angles) values.push_back(in_plane(*brdfs[b].brdf, incidence_deg[k] * degree, a * degree));
      data += plot_data(fmt::format("c{}_{}", k, b), {angles, values});
      curves += fmt::format("{}$c{}_{} using 1:2 {}{}", curves.empty() ? "plot " : ", ", k, b, curve_style(b, brdfs.size(), colours[k % 8]),
                            b + 1 == brdfs.size() ? fmt::format(" title '{:g}°'", incidence_deg[k]) : "");
    }
  return {data + "set logscale y\nset format y '10^{%T}'\nset xrange [-85:85]\nset xtics 15\nset xlabel 'camera from the normal, mirror side positive / degrees'\n"
                 "set ylabel 'f_r, green / (1/sr)'\n" + curves + brdf_keys(brdfs) + "\n",
          {760, 480},
          fmt::format("BRDF over the camera's angle in the plane of incidence, logarithmic, for {} angles of incidence: {}", incidence_deg.size(), names_of(brdfs))};
}

Plot polar_plot(const std::vector<NamedBrdf>& brdfs, const std::vector<double>& incidence_deg) {
  std::string data, curves;
  double largest = 0;
  for (std::size_t k = 0; k < incidence_deg.size(); ++k)
    for (std::size_t b = brdfs.size(); b-- > 0;) {
      std::vector<double> x, y;
      for (const double a : camera_angles(incidence_deg[k])) {
        const double radius = std::cbrt(in_plane(*brdfs[b].brdf, incidence_deg[k] * degree, a * degree));
        if (radius > largest) largest = radius;
        x.push_back(radius * std::sin(a * degree));
        y.push_back(radius * std::cos(a * degree));
      }
      data += plot_data(fmt::format("c{}_{}", k, b), {x, y});
      curves += fmt::format(", $c{}_{} using 1:2 {}{}", k, b, curve_style(b, brdfs.size(), colours[k % 8]),
                            b + 1 == brdfs.size() ? fmt::format(" title '{:g}°'", incidence_deg[k]) : "");
    }
  if (!(largest > 0)) largest = 1;
  // Half circles at powers of ten.
  std::string arcs, labels;
  int n_arcs = 0;
  for (double value = std::pow(10, std::floor(3 * std::log10(largest))); n_arcs < 4 && value > 0; value /= 10, ++n_arcs) {
    std::vector<double> x, y;
    for (int a = -90; a <= 90; a += 3) x.push_back(std::cbrt(value) * std::sin(a * degree)), y.push_back(std::cbrt(value) * std::cos(a * degree));
    data += plot_data(fmt::format("arc{}", n_arcs), {x, y});
    arcs += fmt::format("{}$arc{} using 1:2 with lines lw 0.8 lc rgb '#E2E2E2'", n_arcs == 0 ? "plot " : ", ", n_arcs);
    labels += fmt::format("set label {} '{:g}' at {},0 offset 0,-0.7 center tc rgb grey\n", n_arcs + 1, value, std::cbrt(value));
  }
  return {data + labels + "unset border\nunset tics\nunset grid\nset size ratio -1\nset key top left\n" +
              fmt::format("set xrange [{}:{}]\nset yrange [{}:{}]\nset arrow 1 from 0,0 to 0,{} nohead lc rgb grey dt 3\n"
                          "set label 9 'f_r, green / (1/sr); radius: its cube root' at 0,{} center tc rgb grey\n",
                          -1.08 * largest, 1.08 * largest, -0.16 * largest, 1.05 * largest, largest, -0.14 * largest) +
              arcs + curves + brdf_keys(brdfs) + "\n",
          {640, 440},
          fmt::format("Lobes in the plane of incidence for {} angles of incidence, radius the cube root of the BRDF: {}", incidence_deg.size(), names_of(brdfs))};
}

Slice slice_of(const SliceValue& value, int phi_d_cell) {
  Slice slice;
  for (int h = 0; h < TableGrid::n_theta_h; ++h)
    for (int d = 0; d < TableGrid::n_theta_d; ++d)
      slice.values[static_cast<std::size_t>(h * TableGrid::n_theta_d + d)] = value({h, d, phi_d_cell}).value_or(nothing);
  return slice;
}

/// The green or only channel.
static const brdf::TableChannel& shown_channel(const brdf::HalfAngleTable& table) { return table.channels[table.channels.size() / 2]; }

Slice log_slice(const brdf::Brdf& brdf, int phi_d_cell) {
  const auto* table = dynamic_cast<const brdf::TableBrdf*>(&brdf);
  Slice slice = slice_of(
      [&](const TableGrid::Cell& cell) -> std::optional<double> {
        double value = 0;
        if (table) {
          const auto& channel = shown_channel(table->table());
          if (brdf::has_value(channel.origin[TableGrid::index(cell)])) value = channel.mean[TableGrid::index(cell)];
        } else if (TableGrid::reachable(cell, 0.02)) {
          const auto found = brdf.value(brdf::directions(TableGrid::centre(cell)));
          if (found) value = found->y;
        }
        if (!(value > 0)) return std::nullopt;
        return std::log10(value);
      },
      phi_d_cell);
  slice.logarithmic = true;
  slice.unit = "1/sr";
  share_range({&slice});
  return slice;
}

namespace {

/// Of ratios: symmetric about 0; few cells at the rim do not set the colours of all.
void set_symmetric_range(Slice& slice) {
  std::vector<double> sizes;
  for (const double v : slice.values)
    if (std::isfinite(v)) sizes.push_back(std::abs(v));
  double limit = 0.01;
  if (!sizes.empty()) {
    const auto nth = sizes.begin() + static_cast<std::ptrdiff_t>(0.98 * static_cast<double>(sizes.size() - 1));
    std::nth_element(sizes.begin(), nth, sizes.end());
    limit = std::max(limit, std::ceil(100 * *nth) / 100);
  }
  slice.low = -limit;
  slice.high = limit;
  slice.diverging = true;
  slice.unit = "ln ratio";
}

}  // namespace

Slice residual_slice(const brdf::HalfAngleTable& table, const brdf::CookTorrance& model) {
  const fit::ResidualMap map = fit::residual_map(table, model);
  Slice slice;
  for (std::size_t i = 0; i < slice.values.size(); ++i) slice.values[i] = map.n[i] > 0 ? map.mean_log[i] : std::numeric_limits<double>::quiet_NaN();
  set_symmetric_range(slice);
  return slice;
}

Slice log_ratio_slice(const brdf::Brdf& a, const brdf::Brdf& b, int phi_d_cell) {
  const auto* table = dynamic_cast<const brdf::TableBrdf*>(&a);
  Slice slice = slice_of(
      [&](const TableGrid::Cell& cell) -> std::optional<double> {
        brdf::HalfDiff at = TableGrid::centre(cell);
        std::optional<double> value_a;
        if (table) {
          const auto& channel = shown_channel(table->table());
          const std::size_t i = TableGrid::index(cell);
          if (brdf::has_value(channel.origin[i])) {
            at = {channel.theta_h[i], channel.theta_d[i], channel.phi_d[i]};
            value_a = channel.mean[i];
          }
        } else if (TableGrid::reachable(cell, 0.02)) {
          if (const auto found = a.value(brdf::directions(at))) value_a = found->y;
        }
        if (!value_a || !(*value_a > 0)) return std::nullopt;
        const auto value_b = b.value(brdf::directions(at));
        if (!value_b || !(value_b->y > 0)) return std::nullopt;
        return std::log(value_b->y / *value_a);
      },
      phi_d_cell);
  set_symmetric_range(slice);
  return slice;
}

void share_range(std::vector<Slice*> slices) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const Slice* slice : slices)
    for (const double v : slice->values)
      if (std::isfinite(v)) low = std::min(low, v), high = std::max(high, v);
  if (!(high > low)) low = std::isfinite(low) ? low - 1 : 0, high = low + 2;
  for (Slice* slice : slices) slice->low = low, slice->high = high;
}

Plot slice_plot(const Slice& slice, const std::string& title) {
  std::string tics;
  for (const double d : {0.0, 0.1, 0.5, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 90.0}) tics += fmt::format("{}'{:g}' {:.4f}", tics.empty() ? "" : ", ", d, 90 * std::sqrt(d / 90) - 0.5);
  std::string degrees;
  for (int d = 0; d <= 90; d += 15) degrees += fmt::format("{}'{}' {}", d ? ", " : "", d, d - 0.5);
  const std::string cb = slice.logarithmic ? "set format cb '10^{%.2g}'\n" : "set format cb '%g'\n";
  return {matrix("slice", slice.values, TableGrid::n_theta_d) + (slice.diverging ? blue_white_red : viridis) + cb +
              fmt::format("set title {}\nset rmargin at screen 0.76\nset cbrange [{}:{}]\nset cblabel {}\nset xrange [-0.5:89.5]\nset yrange [89.5:-0.5]\nset xtics ({})\nset ytics ({})\n"
                          "set xlabel 'theta_d / degrees' noenhanced\nset ylabel 'theta_h / degrees' noenhanced\nunset grid\nplot $slice matrix with image\n",
                          plot_text(title), slice.low, slice.high, plot_text(slice.unit), degrees, tics),
          {520, 430}, title + ": theta_h down, theta_d to the right, " + slice.unit + " as colour"};
}

std::string slice_codes(const Slice& slice) {
  std::string codes;
  for (const double v : slice.values)
    codes += std::isfinite(v) ? static_cast<char>(static_cast<unsigned char>(1 + std::lround(254 * std::clamp((v - slice.low) / (slice.high - slice.low), 0.0, 1.0)))) : '\0';
  return base64(codes);
}

Slice coverage_slice(const brdf::HalfAngleTable& table) {
  const calib::CoverageMap map = calib::coverage_map(shown_channel(table));
  Slice slice = slice_of([&](const TableGrid::Cell& cell) -> std::optional<double> {
    const auto& entry = map.at(cell.theta_h, cell.theta_d);
    if (entry.reachable == 0) return std::nullopt;
    return 100.0 * entry.covered / entry.reachable;
  });
  slice.low = 0;
  slice.high = 100;
  slice.unit = "% of phi_d";
  return slice;
}

Plot delta_e_plot(const DeltaE& difference, const std::string& title) {
  const double top = std::max(1.0, std::ceil(difference.p95));
  return {matrix("map", difference.map, difference.width) + viridis +
              fmt::format("set title {}\nset cbrange [0:{}]\nset cblabel 'CIEDE2000'\nset size ratio -1\nunset border\nunset tics\nset cbtics\nunset grid\n"
                          "set xrange [-0.5:{}]\nset yrange [{}:-0.5]\nplot $map matrix with image\n",
                          plot_text(title), top, difference.width - 0.5, difference.height - 0.5),
          {400, 330}, fmt::format("{}: mean {:.2f}, 95th percentile {:.2f}", title, difference.mean, difference.p95)};
}

}  // namespace lacquer::tools
