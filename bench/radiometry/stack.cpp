#include "bench/radiometry/stack.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

namespace lacquer::bench {

namespace {

constexpr double pi = 3.14159265358979323846;

/// Standard normal and Poisson numbers whose bytes do not depend on the standard library.
class Noise {
 public:
  explicit Noise(std::uint64_t seed) : engine_(seed) {}

  double normal() {  // Box and Muller 1958
    if (has_spare_) {
      has_spare_ = false;
      return spare_;
    }
    const double r = std::sqrt(-2 * std::log(1 - uniform())), angle = 2 * pi * uniform();
    spare_ = r * std::sin(angle);
    has_spare_ = true;
    return r * std::cos(angle);
  }

  double poisson(double mean) {
    if (mean > 30) {  // normal with its skewness corrected (Cornish and Fisher 1938): quantiles right to 1e-3 of a sigma
      const double z = normal();
      return std::max(std::round(mean + std::sqrt(mean) * z + (z * z - 1) / 6), 0.0);
    }
    double p = std::exp(-mean), sum = p, n = 0;
    for (const double u = uniform(); u > sum && n < 200; sum += p) p *= mean / ++n;
    return n;
  }

 private:
  double uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  std::mt19937_64 engine_;
  double spare_ = 0;
  bool has_spare_ = false;
};

/// [0, 1), the same for the same three numbers.
double hash(std::uint64_t x, std::uint64_t y, std::uint64_t salt) {
  std::uint64_t h = x * 0x9E3779B97F4A7C15u ^ y * 0xC2B2AE3D27D4EB4Fu ^ salt * 0x165667B19E3779F9u;
  h ^= h >> 29, h *= 0xBF58476D1CE4E5B9u, h ^= h >> 32, h *= 0x94D049BB133111EBu, h ^= h >> 29;
  return static_cast<double>(h >> 11) * 0x1p-53;
}

/// log10 of the light at (u, v) in [0, 1)^2.
double log_light(double u, double v) {
  struct Spot {
    double u, v, radius, peak;
  };
  static constexpr std::array<Spot, 5> highlights{
      {{0.2, 0.3, 0.02, 3.5}, {0.45, 0.65, 0.03, 3.0}, {0.6, 0.2, 0.015, 2.5}, {0.75, 0.8, 0.04, 2.0}, {0.9, 0.4, 0.05, 1.2}}};
  if (u > 0.93 && v > 0.85) return 4.2;                               // a lamp: clipped in every exposure
  if (u < 0.08 && v > 0.8) return -3.5;                               // a cave: dark in every exposure
  double l = -1.5 + 4.5 * u + 0.35 * std::sin(6 * pi * v) + 0.2 * std::sin(2 * pi * (5 * u + 7 * v));
  if (std::abs(v - 0.5) < 0.05) l += std::fmod(u * 12, 1.0) < 0.5 ? 0.6 : -0.6;  // stripes with hard edges
  for (const Spot& s : highlights) l += s.peak * std::exp(-((u - s.u) * (u - s.u) + (v - s.v) * (v - s.v)) / (s.radius * s.radius));
  return l;
}

double gauge_light(const Sensor& s) {
  const double mid = std::exp2(s.bits - 1) - s.black_dn, range = std::exp2(s.bits) - 1 - s.black_dn;
  return s.curve.backward(mid / range);
}

}  // namespace

ToneCurve gamma_curve() {
  return {"gamma 2.2", [](double x) { return std::pow(x, 1 / 2.2); }, [](double v) { return std::pow(v, 2.2); }, false};
}

ToneCurve film_curve() {
  return {"film", [](double x) { const double y = std::pow(x, 1 / 1.8); return 1.6 * y / (y + 0.6); },
          [](double v) { return std::pow(0.6 * v / (1.6 - v), 1.8); }, false};
}

ToneCurve linear_curve() {
  return {"linear", [](double x) { return x; }, [](double v) { return v; }, true};
}

double Sensor::saturation_exposure() const { return (std::exp2(bits - 1) - black_dn) / gauge_light(*this); }

calib::Response Sensor::response() const {
  if (curve.linear) return calib::linear_response(bits, 3, black_dn);
  calib::ResponseCurve c;
  const double range = std::exp2(bits) - 1 - black_dn;
  for (int v = 0; v < 1 << bits; ++v) c.exposure.push_back(saturation_exposure() * curve.backward((v - black_dn) / range));
  return {bits, false, {c, c, c}};
}

calib::NoiseModel Sensor::noise() const {
  calib::NoiseModel n;
  n.black_level_dn = black_dn;
  n.gain_e_per_dn = full_well_e / saturation_exposure();
  n.read_noise_e = read_noise_e;
  return n;
}

Scene make_scene(int width, int height) {
  Scene scene{width, height, {}};
  scene.light.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * 3);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const double u = (x + 0.5) / width, v = (y + 0.5) / height, l = log_light(u, v);
      const auto px = static_cast<std::uint64_t>(x), py = static_cast<std::uint64_t>(y);
      for (std::uint64_t c = 0; c < 3; ++c) {
        const double texture = 0.1 * (hash(px / 8, py / 8, c) - 0.5) + 0.04 * (hash(px, py, 3) - 0.5);
        scene.light.push_back(std::pow(10, l + texture - 0.08 * static_cast<double>(c)));
      }
    }
  return scene;
}

std::vector<double> exposure_times(double first_s, double last_s, int n) {
  std::vector<double> times;
  for (int i = 0; i < n; ++i) times.push_back(first_s * std::pow(last_s / first_s, i / (n - 1.0)));
  return times;
}

Stack take_stack(const Sensor& sensor, const Scene& scene, const std::vector<double>& times, std::uint64_t seed) {
  Stack stack{sensor, {}, {}};
  stack.truth.resize(scene.light.size());
  std::transform(scene.light.begin(), scene.light.end(), stack.truth.begin(),
                 [scale = sensor.saturation_exposure()](double light) { return light * scale; });
  const double top = std::exp2(sensor.bits) - 1, range = top - sensor.black_dn;
  const std::size_t row = static_cast<std::size_t>(scene.width) * 3, rows = static_cast<std::size_t>(scene.height);
  for (std::size_t j = 0; j < times.size(); ++j) {
    acquire::RawFrame frame{scene.width, scene.height, acquire::PixelLayout::rgb, sensor.bits, {}, {times[j], 0}};
    frame.data.resize(scene.light.size());
    tbb::parallel_for(std::size_t{0}, rows, [&](std::size_t y) {
      Noise noise((seed * times.size() + j) * rows + y);
      for (std::size_t i = y * row; i < (y + 1) * row; ++i) {
        const double electrons = noise.poisson(scene.light[i] * times[j] * sensor.full_well_e) + sensor.read_noise_e * noise.normal();
        const double light = electrons / sensor.full_well_e;
        const double value = light > 0 || sensor.curve.linear ? sensor.curve.forward(light) : 0.0;
        frame.data[i] = static_cast<std::uint16_t>(std::clamp(std::round(sensor.black_dn + range * value), 0.0, top));
      }
    });
    stack.frames.push_back(std::move(frame));
  }
  return stack;
}

}  // namespace lacquer::bench
