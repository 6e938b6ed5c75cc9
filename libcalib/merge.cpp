#include "libcalib/merge.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "libbrdf/error.h"
#include "libcalib/bracket_samples.h"

namespace lacquer::calib {

namespace {

using acquire::RawFrame;

/// Values merged together: the linearised values of 16 frames then stay in the first-level cache.
constexpr std::size_t tile_size = 256;
/// A censored or floor value further than this many sigmas from what the other exposures say contradicts them and is left out.
constexpr float contradiction_sigmas = 4;

/// Slope^2 / 12 of a curve as a function of exposure, 32 steps per octave: quantisation noise of a PREDICTED exposure. Taking it at
/// the measured value instead would tie the weight to that value's noise.
class QuantisationNoise {
 public:
  explicit QuantisationNoise(const std::vector<double>& exposure) : variance_(n_octaves * steps) {
    for (std::size_t i = 0; i < variance_.size(); ++i) {
      const double z = std::exp2(min_exponent + (static_cast<double>(i) + 0.5) / steps);
      const auto above = std::lower_bound(exposure.begin() + 1, exposure.end() - 1, z);
      const double slope = *above - *(above - 1);
      variance_[i] = static_cast<float>(slope * slope / 12);
    }
  }
  float operator()(float z) const {
    const int index = (std::bit_cast<std::int32_t>(z) >> (23 - step_bits)) - ((127 + min_exponent) << step_bits);
    return variance_[static_cast<std::size_t>(std::clamp(index, 0, n_octaves * steps - 1))];
  }

 private:
  static constexpr int step_bits = 5, steps = 1 << step_bits, min_exponent = -10, n_octaves = 30;
  std::vector<float> variance_;
};

/// One exposure; its variance at exposure z is constant + (shot + relative2 * z) * z + quantisation(z), z >= 0.
struct Exposure {
  const std::uint16_t* data;
  float time;
  float dark;      ///< mean dark signal, linearised DN
  float constant;  ///< read noise, dark shot noise and, where linear, quantisation, DN^2
};

struct ChannelTables {
  std::vector<float> exposure;  ///< per raw value, one entry more than 2^bits
  float clipped;                ///< linearised values >= this are clipped
  float threshold;              ///< exposure at which rounding starts to give a clipped value
  QuantisationNoise quantisation;
};

struct Plan {
  std::vector<Exposure> exposures;  ///< ascending in time
  std::vector<ChannelTables> channels;
  bool linear;
  bool floor_clips;  ///< value 0 is "at most this": no black level keeps negative noise
  float shot, relative2;
};

/// What is known of each value of a tile; arrays, so that the loops over values vectorise.
struct Tile {
  std::vector<std::array<float, tile_size>> linear;  ///< per exposure: linearised value, dark not subtracted
  std::array<float, tile_size> sum, time, prediction, precision, weighted;
  std::array<const ChannelTables*, tile_size> tables;
  std::array<float, tile_size> clipped, floor;
  explicit Tile(std::size_t n_exposures) : linear(n_exposures) {}
};

/// phi(a) / Q(a) of the normal distribution: by how much a value known to lie above a exceeds its mean, in sigmas.
double mills_ratio(double a) {
  if (a > 25) return a + 1 / a;  // asymptote; erfc underflows near 37
  return std::sqrt(2 / 3.14159265358979323846) * std::exp(-a * a / 2) / std::erfc(a / std::sqrt(2.0));
}

float variance_at(const Plan& plan, const Exposure& e, const ChannelTables& tables, float z) {
  const float v = e.constant + (plan.shot + plan.relative2 * z) * z;
  return plan.linear ? v : v + tables.quantisation(z);
}

/// Frames by time, equal times by content: any order of the input gives the same bytes.
std::vector<const RawFrame*> sorted_frames(std::span<const RawFrame> frames) {
  std::vector<const RawFrame*> sorted;
  for (const RawFrame& f : frames) sorted.push_back(&f);
  std::sort(sorted.begin(), sorted.end(), [](const RawFrame* a, const RawFrame* b) {
    if (a->actual.exposure_s != b->actual.exposure_s) return a->actual.exposure_s < b->actual.exposure_s;
    return std::memcmp(a->data.data(), b->data.data(), a->data.size() * sizeof(std::uint16_t)) < 0;
  });
  return sorted;
}

Plan make_plan(std::span<const RawFrame> frames, const Response& response, const NoiseModel& noise) {
  Plan plan;
  plan.linear = response.linear;
  plan.floor_clips = !(noise.black_level_dn > 0);
  plan.shot = static_cast<float>(1 / noise.gain_e_per_dn);
  plan.relative2 = static_cast<float>(noise.relative_noise * noise.relative_noise);
  for (const RawFrame* f : sorted_frames(frames)) {
    const double t = f->actual.exposure_s, g = noise.gain_e_per_dn, dark_e = noise.dark_current_e_per_s * t;
    const double constant = (noise.read_noise_e * noise.read_noise_e + dark_e) / (g * g) + (response.linear ? 1.0 / 12 : 0.0);
    plan.exposures.push_back(
        {f->data.data(), static_cast<float>(t), static_cast<float>(dark_e / g), static_cast<float>(constant)});
  }
  const int saturation = saturation_value(noise, response.bits);
  for (const ResponseCurve& curve : response.curves) {
    const auto s = static_cast<std::size_t>(saturation);
    plan.channels.push_back({{curve.exposure.begin(), curve.exposure.end()},
                             static_cast<float>(curve.exposure[s]),
                             static_cast<float>((curve.exposure[s] + curve.exposure[s - 1]) / 2),
                             QuantisationNoise(curve.exposure)});
  }
  return plan;
}

void linearise(const Plan& plan, std::size_t first, std::size_t n, Tile& tile) {
  for (std::size_t i = 0; i < n; ++i) {
    tile.clipped[i] = tile.tables[i]->clipped;
    // Largest linearised value that is only an upper bound.
    tile.floor[i] = plan.floor_clips ? tile.tables[i]->exposure[0] : -1e30f;
  }
  for (std::size_t j = 0; j < plan.exposures.size(); ++j) {
    const std::uint16_t* data = plan.exposures[j].data + first;
    float* linear = tile.linear[j].data();
    if (plan.linear) {
      const float offset = plan.channels[0].exposure[0];
      for (std::size_t i = 0; i < n; ++i) linear[i] = static_cast<float>(static_cast<int>(data[i])) + offset;
    } else {
      for (std::size_t i = 0; i < n; ++i) linear[i] = tile.tables[i]->exposure[data[i]];
    }
  }
}

/// First estimate: all light over all time. For a shot-noise sensor that is nearly optimal, and its weights do not depend on values.
void predict(const Plan& plan, std::size_t n, Tile& tile) {
  // Restricted pointers and selections without branches: the inner loops vectorise.
  float* __restrict sum = tile.sum.data();
  float* __restrict time = tile.time.data();
  const float* __restrict clipped = tile.clipped.data();
  const float* __restrict floor = tile.floor.data();
  std::fill_n(sum, n, 0.0f);
  std::fill_n(time, n, 0.0f);
  for (std::size_t j = 0; j < plan.exposures.size(); ++j) {
    const float t = plan.exposures[j].time, dark = plan.exposures[j].dark;
    const float* __restrict linear = tile.linear[j].data();
    for (std::size_t i = 0; i < n; ++i) {
      const float usable = (linear[i] < clipped[i] ? 1.0f : 0.0f) * (linear[i] > floor[i] ? 1.0f : 0.0f);
      sum[i] += usable * (linear[i] - dark);
      time[i] += usable * t;
    }
  }
  for (std::size_t i = 0; i < n; ++i) tile.prediction[i] = time[i] > 0 ? std::max(sum[i] / time[i], 0.0f) : 0.0f;
}

/// Weighted sums with the inverse of the variance predicted for each exposure.
void weigh(const Plan& plan, std::size_t n, Tile& tile) {
  float* __restrict precision = tile.precision.data();
  float* __restrict weighted = tile.weighted.data();
  const float* __restrict prediction = tile.prediction.data();
  const float* __restrict clipped = tile.clipped.data();
  const float* __restrict floor = tile.floor.data();
  std::array<float, tile_size> quantisation{};
  std::fill_n(precision, n, 0.0f);
  std::fill_n(weighted, n, 0.0f);
  constexpr float contradiction2 = contradiction_sigmas * contradiction_sigmas;
  const float shot = plan.shot, relative2 = plan.relative2;
  for (std::size_t j = 0; j < plan.exposures.size(); ++j) {
    const float t = plan.exposures[j].time, dark = plan.exposures[j].dark, constant = plan.exposures[j].constant;
    const float* __restrict linear = tile.linear[j].data();
    if (!plan.linear)
      for (std::size_t i = 0; i < n; ++i) quantisation[i] = tile.tables[i]->quantisation(prediction[i] * t);
    for (std::size_t i = 0; i < n; ++i) {
      const float z = prediction[i] * t, variance = constant + (shot + relative2 * z) * z + quantisation[i];
      // A value at the floor counts where the prediction is near the floor too.
      const float at_floor = linear[i] > floor[i] ? 0.0f : 1.0f, far_from_floor = z * z < contradiction2 * variance ? 0.0f : 1.0f;
      const float w = (linear[i] < clipped[i] ? t : 0.0f) * (1 - at_floor * far_from_floor) / variance;
      precision[i] += w * t;
      weighted[i] += w * (linear[i] - dark);
    }
  }
}

/// Adds the clipped exposures near the threshold as lower bounds: maximises the censored Gaussian likelihood by Newton's method (it is
/// log-concave). In: mean and precision of the values that are not clipped.
void add_lower_bounds(const Plan& plan, const Tile& tile, std::size_t i, double& mean, double& precision) {
  struct Bound {
    double time, threshold, sigma;
  };
  std::array<Bound, 8> bounds;  // exposures whose clipping is in doubt: few, since times differ
  std::size_t n = 0;
  const ChannelTables& tables = *tile.tables[i];
  for (std::size_t j = 0; j < plan.exposures.size() && n < bounds.size(); ++j) {
    if (tile.linear[j][i] < tile.clipped[i]) continue;
    const Exposure& e = plan.exposures[j];
    const double z = mean * e.time, threshold = tables.threshold - e.dark;
    const double sigma = std::sqrt(variance_at(plan, e, tables, static_cast<float>(std::max(z, 0.0))));
    const double doubt = std::sqrt(sigma * sigma + e.time * e.time / precision);
    if (z - threshold > contradiction_sigmas * doubt) break;  // certainly clipped, and so are all longer ones
    if (threshold - z > contradiction_sigmas * doubt) continue;
    bounds[n++] = {e.time, threshold, sigma};
  }
  double x = mean, information = precision;
  for (int iteration = 0; n > 0 && iteration < 20; ++iteration) {
    double score = precision * (mean - x);
    information = precision;
    for (std::size_t k = 0; k < n; ++k) {
      const double a = (bounds[k].threshold - x * bounds[k].time) / bounds[k].sigma, lambda = mills_ratio(a);
      const double t = bounds[k].time / bounds[k].sigma;
      score += lambda * t;
      information += lambda * (lambda - a) * t * t;
    }
    const double step = score / information;
    x += step;
    if (step * step * information < 1e-6) break;  // a thousandth of a sigma
  }
  mean = x;
  precision = information;
}

void store(const Plan& plan, std::size_t first, std::size_t n, const Tile& tile, RadianceImage& image) {
  for (std::size_t i = 0; i < n; ++i) {
    PixelFlag flag = PixelFlag::valid;
    double value, variance;
    if (tile.precision[i] > 0) {
      double precision = tile.precision[i];
      value = tile.weighted[i] / tile.precision[i];
      if (tile.linear.back()[i] >= tile.clipped[i]) add_lower_bounds(plan, tile, i, value, precision);
      variance = 1 / precision;
      if (value * std::abs(value) < variance) flag = PixelFlag::dark;
    } else {
      const Exposure& shortest = plan.exposures.front();
      const float bound = std::max(tile.tables[i]->threshold - shortest.dark, 0.0f);
      value = bound / shortest.time;
      variance = variance_at(plan, shortest, *tile.tables[i], bound) / (shortest.time * shortest.time);
      flag = PixelFlag::clipped;
    }
    image.radiance[first + i] = static_cast<float>(value);
    image.variance[first + i] = static_cast<float>(variance);
    image.flags[first + i] = flag;
  }
}

void check_response(const Response& response, const RawFrame& frame) {
  const auto n_values = std::size_t{1} << frame.bits;
  if (response.bits != frame.bits)
    throw Error(ErrorCode::input, fmt::format("response: bits: expected {} as the frames have, got {}", frame.bits, response.bits));
  if (response.curves.size() != static_cast<std::size_t>(acquire::n_channels(frame.layout)))
    throw Error(ErrorCode::input, fmt::format("response: curves: expected {} for layout {}, got {}", acquire::n_channels(frame.layout),
                                              acquire::name_of(frame.layout), response.curves.size()));
  for (const ResponseCurve& curve : response.curves) {
    if (curve.exposure.size() != n_values)
      throw Error(ErrorCode::input, fmt::format("response: curve: expected {} values, got {}", n_values, curve.exposure.size()));
    for (std::size_t v = 0; v < n_values; ++v)
      if (!std::isfinite(curve.exposure[v]) || (v > 0 && !(curve.exposure[v] > curve.exposure[v - 1])))
        throw Error(ErrorCode::input, fmt::format("response: curve: expected finite, strictly increasing values, entry {} is not", v));
  }
}

}  // namespace

RadianceImage merge_bracket(std::span<const RawFrame> frames, const Response& response, const NoiseModel& noise) {
  check_bracket(frames);
  const RawFrame& frame = frames.front();
  check_response(response, frame);
  noise.validate();
  const Plan plan = make_plan(frames, response, noise);

  RadianceImage image{frame.width, frame.height, frame.layout, {}, {}, {}};
  image.radiance.resize(frame.data.size());
  image.variance.resize(frame.data.size());
  image.flags.resize(frame.data.size());
  const int per_pixel = acquire::values_per_pixel(frame.layout);
  const std::size_t row_size = static_cast<std::size_t>(frame.width) * static_cast<std::size_t>(per_pixel);
  tbb::parallel_for(tbb::blocked_range<int>(0, frame.height), [&](const tbb::blocked_range<int>& rows) {
    Tile tile(plan.exposures.size());
    for (int y = rows.begin(); y != rows.end(); ++y)
      for (std::size_t start = 0; start < row_size; start += tile_size) {
        const std::size_t n = std::min(tile_size, row_size - start), first = static_cast<std::size_t>(y) * row_size + start;
        for (std::size_t i = 0; i < n; ++i) {
          const auto k = static_cast<int>((start + i) % static_cast<std::size_t>(per_pixel));
          const auto x = static_cast<int>((start + i) / static_cast<std::size_t>(per_pixel));
          tile.tables[i] = &plan.channels[static_cast<std::size_t>(acquire::channel_of(frame.layout, x, y, k))];
        }
        linearise(plan, first, n, tile);
        predict(plan, n, tile);
        weigh(plan, n, tile);
        store(plan, first, n, tile, image);
      }
  });
  return image;
}

}  // namespace lacquer::calib
