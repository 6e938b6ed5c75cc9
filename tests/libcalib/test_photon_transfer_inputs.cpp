#include "libcalib/photon_transfer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "libbrdf/error.h"
#include "libcalib/photon_transfer_support.h"

/// Frames that are missing, few, or not what they should be.
namespace lacquer::calib {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::dark_times;
using test::flat_times;
using test::SensorTruth;
using test::usual_truth;

std::string error_of(const FrameSeries& darks, const FrameSeries& flats, const PhotonTransferOptions& options = {}) {
  try {
    photon_transfer(darks, flats, options);
  } catch (const Error& e) {
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos);
    return e.what();
  }
  return "no error";
}

bool has_note(const PhotonTransfer& t, const std::string& part) {
  return std::any_of(t.notes.begin(), t.notes.end(), [&](const std::string& n) { return n.find(part) != std::string::npos; });
}

TEST(PhotonTransferInputs, AMapThatIsNoBetterThanItsNoiseIsLeftOut) {
  const SensorTruth s = usual_truth();  // all values alike
  const PhotonTransfer t = photon_transfer(test::independent_darks(s, 64, 48, dark_times, 4, 1), test::independent_flats(s, 64, 48, 1000, flat_times, 2), {});
  EXPECT_TRUE(t.maps.empty());
  EXPECT_TRUE(has_note(t, "no map of the sensitivity"));
  EXPECT_TRUE(has_note(t, "no map of the dark current"));
}

TEST(PhotonTransferInputs, DarkFramesAloneGiveBlackReadNoiseInDnAndDarkCurrentButNoGain) {
  const PhotonTransfer t = photon_transfer(test::independent_darks(usual_truth(), 64, 48, dark_times, 4, 1), {}, {});
  EXPECT_FALSE(t.gain_measured);
  EXPECT_FALSE(t.all.gain_e_per_dn.has_value());
  EXPECT_FALSE(t.all.read_noise_e.has_value());
  EXPECT_NEAR(t.all.black_level_dn->value, 64, 4 * t.all.black_level_dn->sigma);
  EXPECT_NEAR(t.all.read_noise_dn->value, 2.5, 4 * t.all.read_noise_dn->sigma);
  EXPECT_NEAR(t.all.dark_current_dn_per_s->value, 10, 4 * t.all.dark_current_dn_per_s->sigma);
  EXPECT_TRUE(has_note(t, "no flats"));
}

TEST(PhotonTransferInputs, DarkFramesOfOneTimeGiveNoDarkCurrent) {
  const PhotonTransfer t = photon_transfer(test::independent_darks(usual_truth(), 64, 48, {1}, 4, 1), test::independent_flats(usual_truth(), 64, 48, 1000, flat_times, 2), {});
  EXPECT_FALSE(t.all.dark_current_dn_per_s.has_value());
  EXPECT_EQ(t.model.dark_current_e_per_s, 0);
  EXPECT_NEAR(t.model.black_level_dn, 64 + 10, 0.2);  // one second of dark current is in it
  EXPECT_TRUE(has_note(t, "one exposure time"));
}

TEST(PhotonTransferInputs, WithoutDarkFramesTheBlackLevelMustBeGiven) {
  SensorTruth s = usual_truth();
  s.dark_current = 0;
  const FrameSeries flats = test::independent_flats(s, 64, 48, 1000, flat_times, 2);
  EXPECT_NE(error_of({}, flats).find("black level"), std::string::npos);
  PhotonTransferOptions options;
  options.black_level_dn = 64;
  const PhotonTransfer t = photon_transfer({}, flats, options);
  EXPECT_NEAR(t.all.gain_e_per_dn->value, 2, 4 * t.all.gain_e_per_dn->sigma);
  EXPECT_NEAR(t.all.read_noise_e->value, 5, 4 * t.all.read_noise_e->sigma);
  EXPECT_EQ(t.model.black_level_dn, 64);
  EXPECT_TRUE(has_note(t, "no dark frames"));
}

TEST(PhotonTransferInputs, DarkFramesCutOffAtZeroAreNotBelieved) {
  SensorTruth s = usual_truth();
  s.black = 0;
  s.dark_current = 0;
  const PhotonTransfer t = photon_transfer(test::independent_darks(s, 64, 48, dark_times, 4, 1), test::independent_flats(s, 64, 48, 1000, flat_times, 2), {});
  EXPECT_TRUE(has_note(t, "clipped at 0"));
  EXPECT_FALSE(t.all.black_level_dn.has_value());
  EXPECT_EQ(t.model.black_level_dn, 0);
  EXPECT_NEAR(t.all.gain_e_per_dn->value, 2, 4 * t.all.gain_e_per_dn->sigma);
  EXPECT_NEAR(t.all.read_noise_e->value, 5, 4 * t.all.read_noise_e->sigma);  // from the flats: the line's value at 0
}

TEST(PhotonTransferInputs, InterpolatedFramesAreNoticed) {
  const SensorTruth s = usual_truth();
  auto darks = test::simulate_bracket(s, 64, 48, std::vector<double>(64 * 48, 0.0), test::repeated(dark_times, 4), 3);
  auto flats = test::simulate_bracket(s, 64, 48, std::vector<double>(64 * 48, 1000.0), test::repeated(flat_times, 2), 4);
  for (auto* frames : {&darks, &flats})
    for (RawFrame& f : *frames)
      for (std::size_t i = 1; i < f.data.size(); i += 2)  // every other value is the mean of its neighbours, as a demosaicked image has them
        f.data[i] = static_cast<std::uint16_t>((f.data[i - 1] + f.data[std::min(i + 1, f.data.size() - 1)] + 1) / 2);
  const PhotonTransfer t = photon_transfer(test::series_of(darks), test::series_of(flats), {});
  EXPECT_TRUE(has_note(t, "interpolated"));
  EXPECT_GT(t.all.noise_correlation, 0.3);
}

TEST(PhotonTransferInputs, EachFaultOfTheFramesIsNamed) {
  const SensorTruth s = usual_truth();
  const auto dark = [&](int width, double t, unsigned seed) {
    return test::simulate_bracket(s, width, 8, std::vector<double>(static_cast<std::size_t>(width) * 8, 0.0), {t}, seed)[0];
  };
  const auto darks = test::series_of({dark(8, 1, 1), dark(8, 1, 2)}, "dark");
  EXPECT_NE(error_of({}, {}).find("got none"), std::string::npos);
  EXPECT_NE(error_of(test::series_of({dark(8, 1, 1), dark(8, 2, 2)}, "dark"), {}).find("two dark frames of one exposure time"), std::string::npos);
  EXPECT_NE(error_of(test::series_of({dark(8, 1, 1), dark(9, 1, 2)}, "dark"), {}).find("dark 2: is 9 x 8 mono of 12 bits, expected 8 x 8"), std::string::npos);
  EXPECT_NE(error_of(darks, test::series_of({dark(8, 1, 3), dark(8, 1, 4), dark(9, 2, 3)}, "flat")).find("flat 3: is 9 x 8"), std::string::npos);
  EXPECT_NE(error_of(darks, test::series_of({dark(8, 1, 3)}, "flat")).find("expected pairs of flats"), std::string::npos);
  RawFrame bright = dark(8, 1, 1);
  for (auto& v : bright.data) v = 4095;
  EXPECT_NE(error_of(test::series_of({bright, bright}, "dark"), {}).find("dark 1: is saturated"), std::string::npos);
  RawFrame black = dark(8, 1, 1);
  for (auto& v : black.data) v = 3;
  EXPECT_NE(error_of(darks, test::series_of({black, black}, "flat")).find("flat 1: is no brighter than the dark level"), std::string::npos);
  RawFrame level = dark(8, 1, 1), other = level;
  for (auto& v : level.data) v = 1000;
  for (auto& v : other.data) v = 3000;
  EXPECT_NE(error_of(darks, test::series_of({level, other}, "flat")).find("must follow each other"), std::string::npos);
  RawFrame wide = dark(8, 1, 1);
  wide.data[5] = 5000;
  EXPECT_NE(error_of(test::series_of({wide, wide}, "dark"), {}).find("needs more than 12 bits"), std::string::npos);
  RawFrame amplified = dark(8, 1, 1);
  amplified.actual.gain_db = 6;
  EXPECT_NE(error_of(test::series_of({dark(8, 1, 1), amplified}, "dark"), {}).find("gain is 6 dB"), std::string::npos);
}

TEST(PhotonTransferInputs, TinyFramesAndConstantFramesGiveNumbersNotNonsense) {
  for (const auto& [width, height] : {std::pair{1, 1}, {1, 40}, {40, 1}, {3, 3}}) {
    const auto n = static_cast<std::size_t>(width * height);
    const auto darks = test::simulate_bracket(usual_truth(), width, height, std::vector<double>(n, 0.0), test::repeated(dark_times, 2), 1);
    const auto flats = test::simulate_bracket(usual_truth(), width, height, std::vector<double>(n, 1000.0), test::repeated(flat_times, 2), 2);
    if (n == 1) {
      EXPECT_NE(error_of(test::series_of(darks), test::series_of(flats)), "no error") << "one value has no spread";
      continue;
    }
    const PhotonTransfer t = photon_transfer(test::series_of(darks), test::series_of(flats), {});
    t.model.validate();
    t.maps.validate();
  }
  RawFrame dark{16, 8, PixelLayout::mono, 12, std::vector<std::uint16_t>(128, 64), {1, 0}}, flat = dark;
  for (auto& v : flat.data) v = 1000;
  const PhotonTransfer t = photon_transfer(test::series_of({dark, dark}), test::series_of({flat, flat}), {});  // a sensor without noise
  EXPECT_FALSE(t.gain_measured);
  t.model.validate();
}

}  // namespace
}  // namespace lacquer::calib
