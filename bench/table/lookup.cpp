#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <glm/common.hpp>
#include <random>
#include <string>
#include <vector>

#include "bench/table/parts.h"
#include "libbrdf/files.h"
#include "libbrdf/table.h"
#include "tools/plot.h"

/// Tables as a renderer reads them: our interpolation beside MERL's nearest cell, and other grids beside the half-angle one.
namespace lacquer::bench {

namespace {

constexpr double pi = 3.14159265358979323846;

/// Both directions within 75 deg of the normal: anywhere, and with the half vector within 3 deg of the normal, where the highlight is.
struct TestDirections {
  std::vector<brdf::Directions> all, highlight;
  explicit TestDirections(std::size_t n) {
    std::mt19937_64 generator(3);
    std::uniform_real_distribution<double> uniform(0, 1);
    const double lowest = std::cos(75 * pi / 180);
    while (all.size() < n) {
      const auto one = [&] { return brdf::direction(std::acos(lowest + (1 - lowest) * uniform(generator)), 2 * pi * uniform(generator)); };
      all.push_back({one(), one()});
    }
    while (highlight.size() < n) {
      const brdf::Directions d = brdf::directions({3 * pi / 180 * std::sqrt(uniform(generator)), 72 * pi / 180 * std::sqrt(uniform(generator)), pi * uniform(generator)});
      if (std::min(d.wi.z, d.wo.z) > lowest) highlight.push_back(d);
    }
  }
};

using Lookup = std::function<double(const brdf::Directions&)>;  // green; NaN: nothing

double mean_abs_log(const std::vector<brdf::Directions>& directions, const brdf::CookTorrance& truth, const Lookup& lookup) {
  double sum = 0;
  std::size_t n = 0;
  for (const brdf::Directions& d : directions) {
    const double f = lookup(d);
    if (!(f > 0)) continue;
    sum += std::abs(std::log(f / truth.value(brdf::half_angle_cosines(d)).y));
    ++n;
  }
  return n ? sum / static_cast<double>(n) : NAN;
}

double ns_per_value(const std::vector<brdf::Directions>& directions, const brdf::Brdf& brdf) {
  double best = 1e9, sum = 0;
  for (int k = 0; k < 5; ++k) {
    const auto begin = std::chrono::steady_clock::now();
    for (const brdf::Directions& d : directions) sum += brdf.value(d).value_or(glm::dvec3(0)).y;
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
  return sum > -1 ? best / static_cast<double>(directions.size()) * 1e9 : 0;
}

/// A grid over three coordinates in units of cells; corners are computed when they are needed, which makes any size affordable here.
struct Grid3 {
  const char* name;
  std::function<glm::dvec3(const brdf::Directions&)> coordinates;     // each in [0, 1]
  std::function<brdf::Directions(const glm::dvec3&)> directions;
  bool wraps;  // the third coordinate: else constant beyond its ends
};

std::vector<Grid3> grids() {
  const auto half = [](const brdf::Directions& d) {
    const brdf::HalfDiff c = brdf::half_diff(d);
    return glm::dvec3(c.theta_h / (pi / 2), c.theta_d / (pi / 2), brdf::fold_phi_d(c.phi_d) / pi);
  };
  const auto from_half = [](const glm::dvec3& u) { return brdf::directions({u.x * pi / 2, u.y * pi / 2, u.z * pi}); };
  return {{"theta_i, theta_o, phi",
           [](const brdf::Directions& d) {
             const double phi = std::atan2(d.wi.x * d.wo.y - d.wi.y * d.wo.x, d.wi.x * d.wo.x + d.wi.y * d.wo.y);
             return glm::dvec3(std::acos(std::min(d.wi.z, 1.0)) / (pi / 2), std::acos(std::min(d.wo.z, 1.0)) / (pi / 2), std::abs(phi) / pi);
           },
           [](const glm::dvec3& u) { return brdf::Directions{brdf::direction(u.x * pi / 2, 0), brdf::direction(u.y * pi / 2, u.z * pi)}; }, false},
          {"half-angle, theta_h linear", half, from_half, true},
          {"half-angle, theta_h nonlinear",
           [half](const brdf::Directions& d) {
             const glm::dvec3 u = half(d);
             return glm::dvec3(std::sqrt(u.x), u.y, u.z);
           },
           [from_half](const glm::dvec3& u) { return from_half({u.x * u.x, u.y, u.z}); }, true}};
}

/// From a table of n x n x 2n cells that holds the paint at the cells' centres.
Lookup table_lookup(const Grid3& grid, int n, bool interpolate, const brdf::CookTorrance& paint) {
  return [&grid, n, interpolate, &paint](const brdf::Directions& d) {
    const glm::dvec3 u = grid.coordinates(d) * glm::dvec3(n, n, 2 * n);
    const glm::dvec3 x = interpolate ? u - 0.5 : glm::floor(u);
    const glm::dvec3 base = glm::floor(x), part = x - base;
    double sum = 0, weights = 0;
    for (int corner = 0; corner < 8; ++corner) {
      const glm::dvec3 step(corner & 1, corner >> 1 & 1, corner >> 2);
      const double w = (step.x > 0 ? part.x : 1 - part.x) * (step.y > 0 ? part.y : 1 - part.y) * (step.z > 0 ? part.z : 1 - part.z);
      if (!(w > 0)) continue;
      glm::dvec3 cell = base + step;
      cell.x = std::clamp(cell.x, 0.0, n - 1.0);
      cell.y = std::clamp(cell.y, 0.0, n - 1.0);
      cell.z = grid.wraps ? cell.z - 2 * n * std::floor(cell.z / (2 * n)) : std::clamp(cell.z, 0.0, 2 * n - 1.0);
      const brdf::Directions at = grid.directions((cell + 0.5) / glm::dvec3(n, n, 2 * n));
      if (std::min(at.wi.z, at.wo.z) <= 0) continue;  // an empty cell
      sum += w * paint.value(brdf::half_angle_cosines(at)).y;
      weights += w;
    }
    return weights > 0 ? sum / weights : NAN;
  };
}

brdf::CookTorrance paint_of(const std::filesystem::path& source, const std::string& name) {
  return brdf::read_model(source / "data-samples" / "paints" / (name + ".json"));
}

}  // namespace

void lookup(const std::filesystem::path& source, bool smoke) {
  const TestDirections directions(smoke ? 2000 : 200000);
  fmt::print("table 90 x 90 x 180 against the paint, both directions within 75 deg; highlight: theta_h below 3 deg\n\n"
             "| paint | look-up | ns | mean abs ln | in the highlight |\n|---|---|---|---|---|\n");
  for (const char* name : {"polaris-silber", "white"}) {
    const brdf::CookTorrance paint = paint_of(source, name);
    const brdf::HalfAngleTable table = brdf::tabulate_brdf(brdf::CookTorranceBrdf(paint));
    for (const bool interpolate : {true, false}) {
      const brdf::TableBrdf brdf(table, "table", interpolate);
      const Lookup green = [&](const brdf::Directions& d) { return brdf.value(d).value_or(glm::dvec3(NAN)).y; };
      fmt::print("| {} | {} | {:.0f} | {:.5f} | {:.5f} |\n", name, interpolate ? "trilinear" : "nearest cell, as MERL's reader", ns_per_value(directions.all, brdf),
                 mean_abs_log(directions.all, paint, green), mean_abs_log(directions.highlight, paint, green));
    }
    fmt::print("| {} | the model itself | {:.0f} | 0 | 0 |\n", name, ns_per_value(directions.all, brdf::CookTorranceBrdf(paint)));
    if (smoke) return;
  }
}

void parameterisations(const std::filesystem::path& source, const std::filesystem::path& plot, bool smoke) {
  const TestDirections directions(smoke ? 500 : 50000);
  const brdf::CookTorrance paint = paint_of(source, "polaris-silber");
  const std::vector<int> sizes = smoke ? std::vector<int>{45} : std::vector<int>{45, 64, 90, 128, 180, 256, 360};
  fmt::print("Polaris Silber from tables of n x n x 2n cells, mean abs ln, directions within 75 deg; highlight: theta_h below 3 deg\n\n"
             "| grid | n | MB (one channel, float) | nearest | nearest, highlight | trilinear | trilinear, highlight |\n|---|---|---|---|---|---|---|\n");
  const std::vector<Grid3> all = grids();
  std::string data, lines;
  for (std::size_t g = 0; g < all.size(); ++g) {
    std::vector<std::vector<double>> columns(4);
    for (const int n : sizes) {
      const double mb = 8.0 * n * n * n / 1e6;
      const Lookup nearest = table_lookup(all[g], n, false, paint), linear = table_lookup(all[g], n, true, paint);
      const double a = mean_abs_log(directions.all, paint, nearest), b = mean_abs_log(directions.highlight, paint, nearest);
      const double c = mean_abs_log(directions.all, paint, linear), d = mean_abs_log(directions.highlight, paint, linear);
      fmt::print("| {} | {} | {:.1f} | {:.4f} | {:.4f} | {:.5f} | {:.5f} |\n", all[g].name, n, mb, a, b, c, d);
      columns[0].push_back(mb), columns[1].push_back(b), columns[2].push_back(d), columns[3].push_back(c);
    }
    data += tools::plot_data(fmt::format("g{}", g), columns);
    lines += fmt::format("{}$g{} using 1:3 with linespoints lt {} lw 2 title {}, $g{} using 1:2 with linespoints lt {} dt 2 pt 6 title {}", g ? ", " : "plot ", g, g + 1,
                         tools::plot_text(all[g].name), g, g + 1, tools::plot_text("nearest cell"));
  }
  tools::gnuplot(data + "set logscale xy\nset xlabel 'MB of one channel'\nset ylabel 'mean |ln(table / paint)| in the highlight'\nset key outside bottom\n" + lines + "\n",
                 plot);
}

}  // namespace lacquer::bench
