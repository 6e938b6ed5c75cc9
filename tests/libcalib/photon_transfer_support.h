#pragma once

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "libacquire/sim/noise.h"
#include "libacquire/sim/sensor_model.h"
#include "libcalib/photon_transfer.h"
#include "libcalib/simulated_bracket.h"

/// Dark and flat frames for tests of photon transfer, from two sensors that share no code: tests/libcalib/simulated_bracket.h and
/// libacquire's.
namespace lacquer::test {

inline const std::vector<double> dark_times{0.1, 1, 4, 8};
inline const std::vector<double> flat_times{0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 2.4, 3.2};

inline calib::FrameSeries series_of(std::vector<acquire::RawFrame> frames, const std::string& name = "frame") {
  calib::FrameSeries series;
  for (std::size_t i = 0; i < frames.size(); ++i)
    series.items.push_back({frames[i].actual.exposure_s, name + " " + std::to_string(i + 1)});
  const auto shared = std::make_shared<std::vector<acquire::RawFrame>>(std::move(frames));
  series.read = [shared](std::size_t i) { return (*shared)[i]; };
  return series;
}

/// `n_each` frames at each time.
inline std::vector<double> repeated(const std::vector<double>& times, int n_each) {
  std::vector<double> all;
  for (const double t : times) all.insert(all.end(), static_cast<std::size_t>(n_each), t);
  return all;
}

inline std::size_t n_values(const SensorTruth& sensor, int width, int height) {
  return static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * static_cast<std::size_t>(acquire::values_per_pixel(sensor.layout));
}

/// Flats of one lamp at several exposure times (the other way to several levels), `dn_per_s` linearised DN per second.
inline calib::FrameSeries independent_flats(const SensorTruth& sensor, int width, int height, double dn_per_s,
                                            const std::vector<double>& times, unsigned seed) {
  return series_of(simulate_bracket(sensor, width, height, std::vector<double>(n_values(sensor, width, height), dn_per_s), repeated(times, 2), seed),
                   "flat");
}

inline calib::FrameSeries independent_darks(const SensorTruth& sensor, int width, int height, const std::vector<double>& times, int n_each,
                                            unsigned seed) {
  return series_of(simulate_bracket(sensor, width, height, std::vector<double>(n_values(sensor, width, height), 0.0), repeated(times, n_each), seed),
                   "dark");
}

/// libacquire's sensor under an even lamp of radiance 1 (times `lamp`, one factor per frame, and `shading` at each pixel).
struct SimulatedSensor {
  acquire::SensorDescription description;
  acquire::SensorFlaws flaws;
  int width = 64, height = 48;
  std::uint64_t seed = 1;
  std::function<double(double, double)> shading = [](double, double) { return 1.0; };  ///< x, y in [-1, 1]

  acquire::sim::SensorModel model() const { return {description, width, height, flaws, acquire::sim::combine(seed, 99)}; }

  std::vector<acquire::RawFrame> frames(const std::vector<double>& times, const std::vector<double>& lamp, std::uint64_t stream) const {
    const acquire::sim::SensorModel sensor = model();
    acquire::sim::RadianceImage image(width, height, acquire::n_channels(description.layout));
    for (int c = 0; c < image.n_channels; ++c)
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
          image.at(c, x, y) = static_cast<float>(shading(2.0 * x / std::max(width - 1, 1) - 1, 2.0 * y / std::max(height - 1, 1) - 1));
    std::vector<acquire::RawFrame> result;
    for (std::size_t i = 0; i < times.size(); ++i)
      result.push_back(sensor.expose(image, lamp[i % lamp.size()], {times[i], 0}, acquire::sim::combine(acquire::sim::combine(seed, stream), i)));
    return result;
  }
  calib::FrameSeries darks(const std::vector<double>& times, int n_each) const {
    return series_of(frames(repeated(times, n_each), {0.0}, 1), "dark");
  }
  calib::FrameSeries flats(const std::vector<double>& times, const std::vector<double>& lamp = {1.0}) const {
    return series_of(frames(repeated(times, 2), lamp, 2), "flat");
  }
};

/// 12 bits, black 64 DN, 2 e-/DN, 5 e- read noise, 20 e-/s dark: the independent sensor and libacquire's (1000 DN/s of light).
inline SensorTruth usual_truth() {
  SensorTruth s;
  s.gain = 2;
  s.read_noise = 5;
  s.dark_current = 20;
  return s;
}

inline SimulatedSensor usual_sensor() {
  SimulatedSensor s;
  s.description.bits = 12;
  s.description.black_level_dn = 64;
  s.description.gain_e_per_dn = 2;
  s.description.read_noise_e = 5;
  s.description.dark_current_e_per_s = 20;
  s.description.sensitivity = glm::dvec3(2000);  // 1000 DN per second
  return s;
}

}  // namespace lacquer::test
