#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "libacquire/frame.h"
#include "libcalib/noise_model.h"
#include "libcalib/response.h"

/// Brackets of a scene whose radiance is known, taken by a sensor whose curve and noise are known. Independent of libacquire's simulated
/// camera.
namespace lacquer::bench {

/// Raw value over light, both as fractions of full scale: value = forward(light), light = backward(value), forward(1) = 1.
struct ToneCurve {
  std::string name;
  double (*forward)(double);
  double (*backward)(double);
  bool linear;
};

ToneCurve gamma_curve();   ///< value = light^(1/2.2)
ToneCurve film_curve();    ///< toe and shoulder: value = (1 + c) x / (x + c), x = light^(1/1.8), c = 0.6
ToneCurve linear_curve();

struct Sensor {
  int bits;
  ToneCurve curve;
  double black_dn = 0;
  double full_well_e = 10000;  ///< electrons at the highest raw value
  double read_noise_e = 4;     ///< RMS electrons

  /// Linearised DN at the highest raw value, in the gauge of calib::ResponseCurve.
  double saturation_exposure() const;
  calib::Response response() const;  ///< the truth
  calib::NoiseModel noise() const;   ///< the truth
};

struct Scene {
  int width, height;
  std::vector<double> light;  ///< width * height * 3, fractions of full scale per second
};

/// Gradients, edges, texture, highlights and a dark corner: about eight decades, of which five lie within reach of sixteen exposures of
/// 0.25 to 328 ms. The same picture at any size.
Scene make_scene(int width, int height);

struct Stack {
  Sensor sensor;
  std::vector<acquire::RawFrame> frames;  ///< rgb, ascending in time
  std::vector<double> truth;              ///< linearised DN per second, one per value of a frame
};

/// n times in geometric series.
std::vector<double> exposure_times(double first_s, double last_s, int n);

/// Photons -> electrons (Poisson) -> read noise (normal) -> curve -> rounding -> clipping. The same bytes for any number of threads.
Stack take_stack(const Sensor& sensor, const Scene& scene, const std::vector<double>& times, std::uint64_t seed);

}  // namespace lacquer::bench
