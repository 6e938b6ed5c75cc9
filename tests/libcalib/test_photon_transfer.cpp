#include "libcalib/photon_transfer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <tbb/global_control.h>

#include "libcalib/photon_transfer_support.h"

namespace lacquer::calib {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::SensorTruth;
using test::SimulatedSensor;
using test::dark_times;
using test::flat_times;
using test::usual_sensor;
using test::usual_truth;

/// (measured - truth) / standard error over seeds. The mean of n pulls has sigma 1 / sqrt(n), their variance is chi^2 / (n - 1): relative
/// sigma sqrt(2 / (n - 1)). Limits are 4 and 3.5 sigma; seeds are fixed, so they hold or do not.
class Pulls {
 public:
  void add(const std::string& name, const std::optional<Measured>& m, double truth) {
    ASSERT_TRUE(m.has_value()) << name;
    ASSERT_GT(m->sigma, 0) << name;
    pulls_[name].push_back((m->value - truth) / m->sigma);
  }
  void check() const {
    for (const auto& [name, pulls] : pulls_) {
      const double n = static_cast<double>(pulls.size());
      double mean = 0, square = 0;
      for (const double p : pulls) mean += p / n;
      for (const double p : pulls) square += (p - mean) * (p - mean) / (n - 1);
      EXPECT_NEAR(mean, 0, 4 / std::sqrt(n)) << name;
      EXPECT_NEAR(square, 1, 3.5 * std::sqrt(2 / (n - 1))) << name;
    }
  }

 private:
  std::map<std::string, std::vector<double>> pulls_;
};

// ---- statistics: the truth lies within the error bars, and those are neither too wide nor too narrow

TEST(PhotonTransfer, AnIndependentSensorComesBackWithinItsErrorBars) {
  Pulls pulls;
  const SensorTruth s = usual_truth();
  for (unsigned seed = 1; seed <= 40; ++seed) {
    const PhotonTransfer t = photon_transfer(test::independent_darks(s, 64, 48, dark_times, 4, 2 * seed),
                                             test::independent_flats(s, 64, 48, 1000, flat_times, 2 * seed + 1), {});
    pulls.add("gain", t.all.gain_e_per_dn, 2);
    pulls.add("read noise, e-", t.all.read_noise_e, 5);
    pulls.add("read noise, DN", t.all.read_noise_dn, 2.5);
    pulls.add("black level", t.all.black_level_dn, 64);
    pulls.add("dark current, DN", t.all.dark_current_dn_per_s, 10);
    pulls.add("dark current, e-", t.all.dark_current_e_per_s, 20);
    EXPECT_EQ(t.n_hot + t.n_dead + t.n_erratic, 0u) << seed;
    EXPECT_FALSE(t.all.relative_noise.has_value()) << seed;
    // 27648 values of pairs: 4 sigma of a correlation.
    EXPECT_NEAR(t.all.noise_correlation, 0, 4 / std::sqrt(9 * 64 * 48.0)) << seed;
  }
  pulls.check();
}

TEST(PhotonTransfer, ASensorWhoseValuesDifferComesBackWithinItsErrorBars) {
  Pulls pulls;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    SimulatedSensor s = usual_sensor();
    s.seed = seed;
    s.flaws = {.prnu = 0.01, .dsnu_e = 8, .dark_nonuniformity = 0.3};
    s.shading = [](double x, double y) { return 1 - 0.2 * (x * x + y * y) + 0.05 * x; };
    const PhotonTransfer t = photon_transfer(s.darks(dark_times, 4), s.flats(flat_times), {});
    const auto sensor = s.model();
    // The black level and the dark current of THIS sensor: means over its values that are not bad, not those of its kind.
    double offset = 0, dark = 0, n = 0;
    for (std::size_t i = 0; i < t.maps.offset.size(); ++i)
      if (t.maps.bad.empty() || !t.maps.bad[i]) offset += sensor.offset(i), dark += sensor.dark_current(i), n += 1;
    ASSERT_GT(n, 0);
    pulls.add("gain", t.all.gain_e_per_dn, 2);
    pulls.add("read noise, e-", t.all.read_noise_e, 5);
    pulls.add("black level", t.all.black_level_dn, 64 + offset / n / 2);
    pulls.add("dark current, DN", t.all.dark_current_dn_per_s, dark / n / 2);
    pulls.add("PRNU", t.all.prnu, 0.01);
    pulls.add("DSNU", t.all.dsnu_dn, 4);
    // The heaviest of 3072 log-normal values may be counted as hot: none of the normal ones is.
    EXPECT_LE(t.n_hot, 3u) << seed;
    EXPECT_EQ(t.n_dead + t.n_erratic, 0u) << seed;
  }
  pulls.check();
}

TEST(PhotonTransfer, EveryBitDepthAndLayoutGivesTheGain) {
  for (const int bits : {8, 12, 16})
    for (const PixelLayout layout : {PixelLayout::mono, PixelLayout::rgb, PixelLayout::bayer_grbg}) {
      SimulatedSensor s = usual_sensor();
      s.width = 96;
      s.height = 64;
      s.description.bits = bits;
      s.description.layout = layout;
      const double scale = std::exp2(12 - bits);  // one and the same sensor behind converters of different steps
      s.description.black_level_dn = 64 / scale + 0.4;
      s.description.gain_e_per_dn = 2 * scale;
      s.description.sensitivity = {1500, 2000, 1200};
      const PhotonTransfer t = photon_transfer(s.darks(dark_times, 4), s.flats(flat_times), {});
      SCOPED_TRACE(std::to_string(bits) + " bits " + acquire::name_of(layout));
      ASSERT_TRUE(t.gain_measured);
      EXPECT_EQ(t.channels.size(), layout == PixelLayout::mono ? 1u : 3u);
      EXPECT_NEAR(t.all.gain_e_per_dn->value, 2 * scale, 4 * t.all.gain_e_per_dn->sigma);
      EXPECT_LT(t.all.gain_e_per_dn->sigma, 0.02 * 2 * scale);
      EXPECT_NEAR(t.all.black_level_dn->value, 64 / scale + 0.4, 4 * t.all.black_level_dn->sigma);
      EXPECT_NEAR(t.all.dark_current_e_per_s->value, 20, 4 * t.all.dark_current_e_per_s->sigma);
      if (bits > 8) {
        EXPECT_NEAR(t.all.read_noise_e->value, 5, 4 * t.all.read_noise_e->sigma);
        EXPECT_LT(t.all.read_noise_e->sigma, 0.3);
      } else {
        // 5 e- are 0.16 DN: rounding hides them, and that is said.
        EXPECT_LT(t.all.read_noise_e->value - 4 * t.all.read_noise_e->sigma, 5);
        EXPECT_LT(t.all.read_noise_e->value, 20);
      }
      // 2 degrees of freedom: 18.4 once in 10000.
      EXPECT_LT(t.one_gain_chi_square, 18.4);
      EXPECT_EQ(t.n_hot + t.n_dead + t.n_erratic, 0u);
    }
}

// ---- what each number must not depend on

TEST(PhotonTransfer, TwoFlatsOfDifferentBrightnessGiveTheSameNoise) {
  Pulls pulls;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SimulatedSensor s = usual_sensor();
    s.seed = seed;
    s.flaws = {.prnu = 0.01, .dsnu_e = 8};
    s.shading = [](double x, double) { return 1 + 0.3 * x; };
    // The second lamp of each pair is 15 % brighter: without its ratio, 300 DN of difference would be taken for noise.
    const PhotonTransfer t = photon_transfer(s.darks(dark_times, 4), s.flats({0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 2.4}, {1.0, 1.15}), {});
    pulls.add("gain", t.all.gain_e_per_dn, 2);
    pulls.add("read noise", t.all.read_noise_e, 5);
    EXPECT_FALSE(t.all.relative_noise.has_value()) << seed;
    ASSERT_TRUE(t.lamp_flicker.has_value());
    // ln(1.15) / sqrt(2): the RMS about the mean of two frames. The means of 21 DN have 0.4 % of noise, an eighth of it shows.
    EXPECT_NEAR(t.lamp_flicker->value, std::log(1.15) / std::sqrt(2.0), 3e-3);
  }
  pulls.check();
}

TEST(PhotonTransfer, NoiseThatGrowsWithTheSignalIsRelativeNoiseAndDoesNotBendTheGain) {
  Pulls pulls;
  const SensorTruth s = usual_truth();
  for (unsigned seed = 1; seed <= 30; ++seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    std::vector<RawFrame> flats;
    for (const double t : test::repeated({0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.2, 1.6, 2, 2.4, 2.8, 3.2}, 2)) {
      std::vector<double> speckle(64 * 48);  // 2 % of each value, new in each frame
      for (double& v : speckle) v = 1000 * (1 + 0.02 * normal(random));
      flats.push_back(test::simulate_bracket(s, 64, 48, speckle, {t}, static_cast<unsigned>(random()))[0]);
    }
    const PhotonTransfer t = photon_transfer(test::independent_darks(s, 64, 48, dark_times, 4, 2 * seed), test::series_of(flats), {});
    pulls.add("relative noise", t.all.relative_noise, 0.02);
    pulls.add("gain", t.all.gain_e_per_dn, 2);
    EXPECT_NEAR(t.model.relative_noise, 0.02, 0.004) << seed;
  }
  pulls.check();
}

TEST(PhotonTransfer, ACurvedSensorIsMeasuredThroughItsResponse) {
  Pulls pulls;
  SensorTruth s = usual_truth();
  s.curve = test::gamma_curve(12, 64, 1.8);
  Response response{12, false, {{}}};
  for (int v = 0; v < 4096; ++v) {
    const double x = v - 64, mid = 2048 - 64;  // inverse of gamma_curve
    response.curves[0].exposure.push_back(x > 0 ? mid * std::pow(x / mid, 1.8) : x * 1e-3);
  }
  PhotonTransferOptions options;
  options.response = response;
  options.black_level_dn = 64;
  for (unsigned seed = 1; seed <= 30; ++seed) {
    // Flats only: around black the curve has no slope and noise there is not normal.
    const PhotonTransfer t = photon_transfer({}, test::independent_flats(s, 64, 48, 1000, {0.1, 0.2, 0.4, 0.8, 1.6, 2.4, 3.2}, seed), options);
    // 20 e-/s of dark current are light to this measurement.
    pulls.add("gain", t.all.gain_e_per_dn, 2);
    EXPECT_NEAR(t.model.black_level_dn, 64, 1e-6);
  }
  pulls.check();
}

// ---- levels that must be left out

TEST(PhotonTransfer, LevelsClippedByTheConverterAreLeftOut) {
  const SensorTruth s = usual_truth();
  std::vector<double> times = flat_times;
  for (const double t : {3.9, 4.0, 4.1, 5.0}) times.push_back(t);  // the range ends at 4031 DN
  const PhotonTransfer t = photon_transfer(test::independent_darks(s, 64, 48, dark_times, 4, 1), test::independent_flats(s, 64, 48, 1000, times, 2), {});
  EXPECT_NEAR(t.all.gain_e_per_dn->value, 2, 4 * t.all.gain_e_per_dn->sigma);
  EXPECT_EQ(t.model.saturation_dn, 4095);
  EXPECT_FALSE(t.full_well_e.has_value());
  for (const TransferPoint& p : t.points)
    EXPECT_EQ(p.use == TransferPoint::Use::fitted, p.dark || p.exposure_s < 3.85) << p.exposure_s;
}

TEST(PhotonTransfer, AFullWellBelowTheConverterIsFoundFromTheDropOfTheVariance) {
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SimulatedSensor s = usual_sensor();
    s.seed = seed;
    s.description.full_well_e = 6000;  // 3000 DN above black
    s.flaws = {.prnu = 0.01, .dsnu_e = 4};
    const PhotonTransfer t =
        photon_transfer(s.darks(dark_times, 4), s.flats({0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 2.4, 2.95, 3.2, 4.5}), {});
    ASSERT_TRUE(t.full_well_e.has_value()) << seed;
    EXPECT_NEAR(t.all.gain_e_per_dn->value, 2, 4 * t.all.gain_e_per_dn->sigma) << seed;
    EXPECT_NEAR(t.full_well_e->value, 6000, 4 * t.full_well_e->sigma) << seed;
    // Values in a full well are 3064 DN with 2.5 DN of read noise and 2 DN of offsets: all of them, and little else, is clipped.
    EXPECT_LT(t.model.saturation_dn, 3064 - 3 * 3.2) << seed;
    EXPECT_GT(t.model.saturation_dn, 3064 - 8 * 3.2) << seed;
    t.model.validate();
  }
}

// ---- bad values and maps

TEST(PhotonTransfer, HotAndDeadValuesAreFoundAndNothingElse) {
  for (const PixelLayout layout : {PixelLayout::mono, PixelLayout::bayer_rggb, PixelLayout::rgb}) {
    SimulatedSensor s = usual_sensor();
    s.description.layout = layout;
    s.width = 128;
    s.height = 96;
    s.flaws = {.prnu = 0.01, .dsnu_e = 4, .hot_pixels = 0.005, .dead_pixels = 0.003};
    const PhotonTransfer t = photon_transfer(s.darks(dark_times, 4), s.flats(flat_times), {});
    const auto sensor = s.model();
    ASSERT_EQ(t.maps.bad.size(), t.maps.n_values());
    for (std::size_t i = 0; i < t.maps.bad.size(); ++i)
      EXPECT_EQ(t.maps.bad[i] != 0, sensor.dark_current(i) > 1000 || sensor.relative_sensitivity(i) == 0) << i;
    EXPECT_GT(t.n_hot, 20u);
    EXPECT_GT(t.n_dead, 10u);
    EXPECT_EQ(t.n_erratic, 0u);
    EXPECT_NEAR(t.all.gain_e_per_dn->value, 2, 4 * t.all.gain_e_per_dn->sigma) << "bad values must not count";
  }
}

TEST(PhotonTransfer, RandomTelegraphNoiseAndFrozenValuesAreFound) {
  const SensorTruth s = usual_truth();
  auto darks = test::simulate_bracket(s, 64, 48, std::vector<double>(64 * 48, 0.0), test::repeated(dark_times, 8), 3);
  auto flats = test::simulate_bracket(s, 64, 48, std::vector<double>(64 * 48, 1000.0), test::repeated(flat_times, 2), 4);
  std::mt19937_64 random(5);
  for (const std::size_t i : {100u, 1000u, 2000u})  // 60 DN up or down, at random: 24 times the read noise, 8 times the dark shot noise
    for (RawFrame& f : darks) f.data[i] = static_cast<std::uint16_t>(f.data[i] + (random() & 1 ? 60 : 0));
  for (RawFrame& f : flats) f.data[500] = static_cast<std::uint16_t>(std::lround(64 + 1010 * f.actual.exposure_s));  // right mean, no noise
  const PhotonTransfer t = photon_transfer(test::series_of(darks), test::series_of(flats), {});
  EXPECT_EQ(t.n_erratic, 3u);
  EXPECT_EQ(t.n_dead, 1u);
  EXPECT_EQ(t.n_hot, 0u);
  ASSERT_FALSE(t.maps.bad.empty());
  for (const std::size_t i : {100u, 500u, 1000u, 2000u}) EXPECT_EQ(t.maps.bad[i], 1) << i;
}

TEST(PhotonTransfer, MapsAreTheTruthWithinTheirStandardErrors) {
  SimulatedSensor s = usual_sensor();
  s.width = 128;
  s.height = 96;
  s.description.layout = PixelLayout::bayer_rggb;
  s.description.sensitivity = {1500, 2000, 1200};
  s.flaws = {.prnu = 0.02, .dsnu_e = 20, .dark_nonuniformity = 0.5, .hot_pixels = 0.001, .dead_pixels = 0.001};
  s.shading = [](double x, double y) { return 1 - 0.15 * (x * x + y * y) - 0.1 * y; };
  const PhotonTransfer t = photon_transfer(s.darks({0.1, 1, 4, 16}, 8), s.flats(flat_times), {});
  const auto sensor = s.model();
  t.maps.validate(128, 96, PixelLayout::bayer_rggb);
  ASSERT_FALSE(t.maps.offset.empty());
  ASSERT_FALSE(t.maps.dark_rate.empty());
  ASSERT_FALSE(t.maps.flat.empty());
  double offset = 0, rate = 0, flat = 0, n = 0, mean_offset = 0;
  for (std::size_t i = 0; i < t.maps.bad.size(); ++i)
    if (!t.maps.bad[i]) mean_offset += sensor.offset(i) / 2, n += 1;
  mean_offset /= n;
  for (std::size_t i = 0; i < t.maps.bad.size(); ++i) {
    if (t.maps.bad[i]) continue;
    offset += std::pow((static_cast<double>(t.maps.offset[i]) - (sensor.offset(i) / 2 - mean_offset)) / t.maps.offset_sigma, 2) / n;
    rate += std::pow((static_cast<double>(t.maps.dark_rate[i]) - sensor.dark_current(i) / 2) / t.maps.dark_rate_sigma, 2) / n;
    flat += std::pow((static_cast<double>(t.maps.flat[i]) - sensor.relative_sensitivity(i)) / t.maps.flat_sigma, 2) / n;
  }
  // chi^2 / dof of 12000 values: sigma 0.013. Dark shot noise differs from value to value and so do the channels' sensitivities, which
  // the one standard error of a map leaves out; its mean square is right.
  EXPECT_NEAR(offset, 1, 0.06);
  EXPECT_NEAR(rate, 1, 0.06);
  EXPECT_NEAR(flat, 1, 0.06);
}

TEST(PhotonTransfer, ShadingIsKeptWhereItIsAskedFor) {
  SimulatedSensor s = usual_sensor();
  s.flaws = {.prnu = 0.02};
  s.shading = [](double x, double y) { return 1 - 0.3 * (x * x + y * y) / 2; };
  const FrameSeries darks = s.darks(dark_times, 4), flats = s.flats(flat_times);
  PhotonTransferOptions options;
  const PhotonTransfer removed = photon_transfer(darks, flats, options);
  options.shading = PhotonTransferOptions::Shading::kept;
  const PhotonTransfer kept = photon_transfer(darks, flats, options);
  // Mean over a corner of 8 x 8 against one in the middle: the light there is 0.7 + 0.3 * 0.12 to 1.
  const auto block = [](const SensorMaps& m, std::size_t x0, std::size_t y0) {
    double sum = 0;
    for (std::size_t y = y0; y < y0 + 8; ++y)
      for (std::size_t x = x0; x < x0 + 8; ++x) sum += static_cast<double>(m.flat[y * 64 + x]) / 64;
    return sum;
  };
  // 64 values of 2 % spread: 0.25 % each, 4 sigma of a ratio 1.4 %.
  EXPECT_NEAR(block(removed.maps, 0, 0) / block(removed.maps, 28, 20), 1, 0.014);
  double light = 0;
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x) light += s.shading(2.0 * x / 63 - 1, 2.0 * y / 47 - 1) / 64;
  EXPECT_NEAR(block(kept.maps, 0, 0) / block(kept.maps, 28, 20), light, 0.014);
  EXPECT_EQ(kept.n_dead, 0u);
  EXPECT_DOUBLE_EQ(kept.all.prnu->value, removed.all.prnu->value);
}

TEST(PhotonTransfer, TheNumberOfThreadsDoesNotChangeABit) {
  SimulatedSensor s = usual_sensor();
  s.flaws = {.prnu = 0.02, .dsnu_e = 20, .dark_nonuniformity = 0.5};
  s.description.layout = PixelLayout::bayer_rggb;
  const FrameSeries darks = s.darks(dark_times, 4), flats = s.flats(flat_times);
  const PhotonTransfer parallel = photon_transfer(darks, flats, {});
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  const PhotonTransfer serial = photon_transfer(darks, flats, {});
  EXPECT_EQ(serial.model.gain_e_per_dn, parallel.model.gain_e_per_dn);
  EXPECT_EQ(serial.model.read_noise_e, parallel.model.read_noise_e);
  EXPECT_EQ(serial.maps.flat, parallel.maps.flat);
  EXPECT_EQ(serial.maps.offset, parallel.maps.offset);
  EXPECT_EQ(serial.maps.dark_rate, parallel.maps.dark_rate);
}

}  // namespace
}  // namespace lacquer::calib
