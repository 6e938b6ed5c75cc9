#include "libacquire/adaptive_bracket.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>

#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

constexpr double min_cosine = 0.08715574274765817;  // cos 85 deg: as the samples of a table

/// How many values have which rate, in sixteen steps per octave; those below 1/16 DN in the longest exposure count as dark.
class Rates {
 public:
  Rates(std::size_t n_values, double longest_s) : darkest_(static_cast<float>(1 / 16.0 / longest_s)), rates_(n_values, clipped) {}

  /// Values that were clipped so far.
  void look(const RawFrame& frame, const std::vector<std::uint32_t>& values, const SensorNoise& noise) {
    const float per_second = static_cast<float>(1 / frame.actual.exposure_s), black = static_cast<float>(noise.black_level_dn);
    for (std::size_t i = 0; i < values.size(); ++i) {
      const std::uint16_t raw = frame.data[values[i]];
      if (rates_[i] != clipped || raw >= noise.saturation_dn) continue;
      rates_[i] = (static_cast<float>(raw) - black) * per_second;
      const std::size_t bin = rates_[i] < darkest_ ? 0 : 1 + bits(rates_[i]) - bits(darkest_);
      if (bin >= counts_.size()) counts_.resize(bin + 1);
      ++counts_[bin];
      ++n_seen_;
    }
  }
  bool any_clipped() const { return n_seen_ < rates_.size(); }
  /// work(rate in DN/s, number of values)
  template <typename Work>
  void for_each(const Work& work) const {
    for (std::size_t bin = 0; bin < counts_.size(); ++bin)
      if (counts_[bin] > 0) work(bin == 0 ? 0.0 : (static_cast<double>(edge(bin)) + static_cast<double>(edge(bin + 1))) / 2, counts_[bin]);
  }
  std::size_t n_values() const { return rates_.size(); }

 private:
  static constexpr float clipped = std::numeric_limits<float>::infinity();
  static constexpr int shift = 19;  // four bits of the mantissa
  static std::size_t bits(float rate) { return std::bit_cast<std::uint32_t>(rate) >> shift; }
  float edge(std::size_t bin) const { return std::bit_cast<float>(static_cast<std::uint32_t>((bits(darkest_) + bin - 1) << shift)); }

  float darkest_;
  std::vector<float> rates_;
  std::vector<std::size_t> counts_;
  std::size_t n_seen_ = 0;
};

struct Loss {
  double mean = 0, largest = 0;
};

/// Values clipped in all exposures of the full bracket lose nothing, as long as the shortest is there.
Loss loss_of(const Rates& rates, const SensorNoise& noise, const std::vector<double>& times, std::size_t first, std::size_t last) {
  Loss loss;
  rates.for_each([&](double rate, std::size_t count) {
    const double all = bracket_information(noise, times, 0, times.size() - 1, rate), taken = bracket_information(noise, times, first, last, rate);
    if (all == 0) return;
    const double extra = std::sqrt(all / taken) - 1;
    loss.mean += extra * static_cast<double>(count) / static_cast<double>(rates.n_values());
    loss.largest = std::max(loss.largest, extra);
  });
  return loss;
}

}  // namespace

double bracket_information(const SensorNoise& noise, const std::vector<double>& times, std::size_t first, std::size_t last, double rate) {
  double sum = 0;
  for (std::size_t e = first; e <= last; ++e) {
    const double signal = rate * times[e];
    if (noise.black_level_dn + signal >= noise.saturation_dn) break;
    const double electrons = noise.read_noise_e * noise.read_noise_e + std::max(signal, 0.0) * noise.gain_e_per_dn;
    const double variance = electrons / (noise.gain_e_per_dn * noise.gain_e_per_dn) + std::pow(noise.relative_noise * signal, 2) + 1.0 / 12;
    sum += times[e] * times[e] / variance;
  }
  return sum;
}

AdaptiveBracket::AdaptiveBracket(const RigDescription& rig, const SensorNoise& noise) : rig_(rig), noise_(noise) {
  const CameraModel& camera = rig.geometry.camera;
  RawFrame mask;
  if (rig.mask.file) {
    mask = read_frame(rig.mask.file->string(), 8, PixelLayout::mono);
    if (mask.width != camera.width || mask.height != camera.height || mask.layout != PixelLayout::mono)
      throw Error(ErrorCode::file, fmt::format("{}: mask: expected one channel of {} x {} pixels", rig.mask.file->string(), camera.width, camera.height));
  }
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto index = static_cast<std::uint32_t>(y) * static_cast<std::uint32_t>(camera.width) + static_cast<std::uint32_t>(x);
      if (!mask.data.empty() && mask.data[index] == 0) continue;
      const auto point = trace(rig.geometry, {x, y});
      if (!point || glm::dot(point->normal, point->wo) < min_cosine || (rig.mask.min_y && point->position.y < *rig.mask.min_y)) continue;
      paint_.push_back({index, {static_cast<float>(point->normal.x), static_cast<float>(point->normal.y), static_cast<float>(point->normal.z)}});
    }
  if (const auto& patch = rig.reference_patch)
    for (int y = patch->y; y < patch->y + patch->height; ++y)
      for (int x = patch->x; x < patch->x + patch->width; ++x)
        patch_.push_back(static_cast<std::uint32_t>(y) * static_cast<std::uint32_t>(camera.width) + static_cast<std::uint32_t>(x));
}

std::vector<std::uint32_t> AdaptiveBracket::lit_values(const PlannedView& view, double turntable_angle) const {
  const PlacedLight light = rig_.geometry.place_light(static_cast<std::size_t>(view.light), turntable_angle);
  const auto per_pixel = static_cast<std::uint32_t>(values_per_pixel(rig_.sensor.layout));
  std::vector<std::uint32_t> values;
  const auto add = [&](std::uint32_t pixel) {
    for (std::uint32_t k = 0; k < per_pixel; ++k) values.push_back(pixel * per_pixel + k);
  };
  for (const Pixel& pixel : paint_) {
    const glm::dvec3 normal(pixel.normal[0], pixel.normal[1], pixel.normal[2]);
    const glm::dvec3 towards = light.distant ? light.direction : glm::normalize(light.position - rig_.geometry.sphere_radius * normal);
    if (glm::dot(normal, towards) >= min_cosine) add(pixel.index);
  }
  if (!values.empty()) std::for_each(patch_.begin(), patch_.end(), add);
  return values;
}

BracketChoice AdaptiveBracket::choose(const PlannedView& view, double turntable_angle, const std::function<const RawFrame&(std::size_t)>& take) const {
  const std::vector<double>& times = view.exposures_s;
  const std::size_t middle = times.size() / 2, end = times.size() - 1;
  const std::vector<std::uint32_t> values = lit_values(view, turntable_angle);
  if (values.empty()) return {.first = 0, .last = end};

  Rates rates(values.size(), times.back());
  BracketChoice choice{.first = middle, .last = end};
  const double limit = *rig_.adaptive_loss;
  rates.look(take(middle), values, noise_);
  while (choice.first > 0 && (rates.any_clipped() || loss_of(rates, noise_, times, choice.first, end).mean > limit))
    rates.look(take(--choice.first), values, noise_);
  while (choice.last > middle && loss_of(rates, noise_, times, choice.first, choice.last - 1).mean <= limit) --choice.last;
  const Loss loss = loss_of(rates, noise_, times, choice.first, choice.last);
  choice.mean_loss = loss.mean;
  choice.largest_loss = loss.largest;
  return choice;
}

}  // namespace lacquer::acquire
