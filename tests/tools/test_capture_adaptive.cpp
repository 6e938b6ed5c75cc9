#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "libacquire/capture_estimate.h"
#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/merge_session.h"
#include "test_support.h"

/// Adaptive bracket: takes fewer frames, says what that costs, and is right about it.
namespace lacquer {
namespace {

namespace fs = std::filesystem;
using acquire::RigDescription;
using acquire::Session;

/// A sphere of some 5000 pixels; the light is in front, at the side, and behind.
std::string rig_text(const std::string& exposures, const std::string& plan, int seed = 1) {
  return R"([rig]
name = "adaptive"
kind = "simulated"
[camera]
width_px = 96
height_px = 90
layout = "rggb"
bits = 12
focal_length_px = 800
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 64
gain_e_per_dn = 4.2
read_noise_e = 5
sensitivity_e_per_s = [4.0e5, 5.0e5, 4.2e5]
[[lights]]
position_mm = [0, 124.747, 586.889]
intensity = [0.55, 0.58, 0.48]
diameter_mm = 3
[plan]
angles_deg = [20, 70, 120]
exposures_ms = )" + exposures + "\n" + plan + "\n[simulation]\npaint = \"paint.json\"\nseed = " + std::to_string(seed) + "\n";
}

const std::string usual = "{ from = 0.25, to = 328, count = 8 }";

class AdaptiveBracketTest : public testing::Test {
 protected:
  /// Captures, and merges meanwhile.
  Session capture(const std::string& text, const std::string& name, const std::string& paint = "opel-titan") {
    const RigDescription rig = acquire::parse_rig(text, folder / "rig.toml");
    acquire::Rig devices = acquire::open_rig(rig, brdf::load_brdf(test::source_dir() / ("data-samples/paints/" + paint + ".json")));
    const calib::Calibration calibration = calib::calibration_from_rig(rig);
    calib::SessionMerger merger(rig, folder / name, calibration);
    acquire::FrameSink sink;
    sink.frame = [&](const acquire::ViewRecord& view, const acquire::RawFrame& frame) { merger.add(view, frame); };
    sink.view = [&](const acquire::ViewRecord& view) { merger.finish_view(view); };
    return acquire::capture_session(devices, rig, folder / name, {.command_line = {}, .noise = calib::bracket_noise(calibration)}, {}, sink);
  }
  static calib::RadianceImage radiance(const Session& session, std::size_t view) { return calib::read_radiance(session.radiance_path(session.views[view])); }
  /// Values of the lit paint that a table takes, by the rig's geometry.
  static std::vector<std::size_t> lit(const Session& session, std::size_t view) {
    const auto light = session.rig.geometry.place_light(0, session.views[view].turntable_angle);
    std::vector<std::size_t> values;
    for (int y = 0; y < 90; ++y)
      for (int x = 0; x < 96; ++x) {
        const auto point = acquire::trace(session.rig.geometry, {x, y});
        const auto illumination = point ? acquire::illuminate(light, *point) : std::nullopt;
        if (illumination && glm::dot(point->normal, point->wo) > 0.0872 && glm::dot(point->normal, illumination->wi) > 0.0872)
          values.push_back(static_cast<std::size_t>(y * 96 + x));
      }
    return values;
  }
  test::TemporaryFolder folder;
};

/// What the merge reports of a view, full bracket against adaptive one of the same noise, and against one of other noise.
struct Found {
  double mean_loss = 0, largest_loss = 0, chi_square = 0, n = 0;
};

TEST_F(AdaptiveBracketTest, LossStatedIsLossFoundAndRadiancesAgreeWithinTheirSigma) {
  struct Case {
    const char *paint, *exposures, *plan;
    double largest_mean, least_mean;  // a case without loss would show nothing
  };
  const char* close = "{ from = 0.25, to = 328, count = 16 }";
  for (const Case& c : {Case{"opel-titan", usual.c_str(), "adaptive = true", 0.01, 0}, Case{"blue-matte", usual.c_str(), "adaptive = true", 0.01, 0},
                        Case{"blue-matte", close, "adaptive = true\nadaptive_loss = 0.45", 0.45, 0.15}}) {
    const Session full = capture(rig_text(c.exposures, ""), "full", c.paint), same = capture(rig_text(c.exposures, c.plan), "same", c.paint);
    const Session other = capture(rig_text(c.exposures, c.plan, 2), "other", c.paint);
    EXPECT_EQ(acquire::bracket_savings(same).n_planned, 3 * full.views[0].frames.size());
    EXPECT_GE(acquire::bracket_savings(same).n_left_out, 2u);
    for (std::size_t v = 0; v < 3; ++v) {
      SCOPED_TRACE(std::string(c.paint) + ", " + c.plan + ", view " + std::to_string(v));
      const auto& bracket = same.views[v].bracket;
      ASSERT_TRUE(bracket);
      EXPECT_EQ(same.views[v].frames.size(), bracket->last - bracket->first + 1);
      const auto a = radiance(full, v), b = radiance(same, v), d = radiance(other, v);
      Found found;
      for (const std::size_t i : lit(same, v)) {
        if (a.flags[i] == calib::PixelFlag::clipped) continue;
        ASSERT_NE(b.flags[i], calib::PixelFlag::clipped) << "clipped only for want of a shorter exposure";
        const double loss = std::sqrt(double{b.variance[i]} / double{a.variance[i]}) - 1;
        found.mean_loss += loss;
        found.largest_loss = std::max(found.largest_loss, loss);
        found.chi_square += std::pow(double{a.radiance[i]} - double{d.radiance[i]}, 2) / (double{a.variance[i]} + double{d.variance[i]});
        ++found.n;
      }
      // The merge's sigma exceeds that of ideal weights, which the prediction has, by 0.7 % at most (libcalib/merge_weights.h); and values clipped
      // by noise alone still tell it something.
      EXPECT_NEAR(bracket->mean_loss, found.mean_loss / found.n, 0.007 + 0.05 * bracket->mean_loss);
      EXPECT_LE(found.largest_loss, bracket->largest_loss + 0.007);
      EXPECT_LE(bracket->mean_loss, c.largest_mean);
      EXPECT_GE(bracket->mean_loss, c.least_mean);
      EXPECT_NEAR(found.chi_square / found.n, 1, 5 * std::sqrt(2 / found.n));
    }
    for (const char* name : {"full", "same", "other"}) fs::remove_all(folder / name);
  }
}

// What the frames show, whatever the noise model says.
TEST_F(AdaptiveBracketTest, TheShortestFrameTakenIsTheLongestWithoutClippedPaintOrTheMiddleOne) {
  for (const char* paint : {"opel-titan", "blue-matte", "white"}) {
    const Session full = capture(rig_text(usual, ""), std::string("full-") + paint, paint);
    const Session same = capture(rig_text(usual, "adaptive = true\nadaptive_loss = 0.02"), std::string("same-") + paint, paint);
    for (std::size_t v = 0; v < 3; ++v) {
      const auto values = lit(full, v);
      const auto clipped = [&](std::size_t e) {
        const acquire::RawFrame frame = acquire::read_session_frame(full, full.views[v].frames[e]);
        return std::ranges::any_of(values, [&](std::size_t i) { return frame.data[i] == 4095; });
      };
      std::size_t expected = 4;
      while (expected > 0 && clipped(expected)) --expected;
      EXPECT_EQ(same.views[v].bracket->first, expected) << paint << " view " << v;
      EXPECT_EQ(same.views[v].bracket->last, 7u) << "the lit paint towards the terminator needs the longest";
    }
  }
}

TEST_F(AdaptiveBracketTest, ExposuresInWhichThePaintClipsAreLeftOut) {
  const Session session = capture(rig_text("[0.25, 1, 4, 16, 64, 4000, 20000, 90000]", "adaptive = true"), "s", "white");
  const auto& bracket = *session.views[0].bracket;
  EXPECT_LT(bracket.last, 7u) << "90 s clip on everything that is lit: 50 times the longest of the usual bracket";
  const acquire::BracketSavings savings = acquire::bracket_savings(session);
  double seconds = 0;
  for (const auto& view : session.views)
    for (std::size_t e = 0; e < 8; ++e)
      if (e < view.bracket->first || e > view.bracket->last) seconds += session.rig.plan[0].exposures_s[e] + 0.04;  // readout of the simulated camera
  EXPECT_NEAR(savings.seconds, seconds, 1e-9);
  EXPECT_GT(savings.seconds, 90);
}

TEST_F(AdaptiveBracketTest, WhereNothingIsLitTheBracketIsWhole) {
  std::string text = rig_text(usual, "adaptive = true");
  text.replace(text.find("[20, 70, 120]"), 13, "[180]");
  text.replace(text.find("[plan]"), 0, "[mask]\nmin_y_mm = -60\n");
  text.replace(text.find("[0, 124.747, 586.889]"), 21, "[0, 0, 2000]");
  const Session session = capture(text, "s");
  EXPECT_EQ(session.views[0].frames.size(), 8u);
  EXPECT_EQ(session.views[0].bracket->largest_loss, 0);
}

TEST_F(AdaptiveBracketTest, SessionReadsBackMergesToTheSameBytesAndDarkViewsStayWhole) {
  const Session session = capture(rig_text(usual, "adaptive = true\ndark_frames = 2"), "s");
  const Session read = acquire::read_session(folder / "s");
  ASSERT_EQ(read.views.size(), 5u);
  for (std::size_t v = 0; v < 5; ++v) {
    EXPECT_EQ(read.views[v].exposures_s, session.views[v].exposures_s);
    ASSERT_EQ(read.views[v].bracket.has_value(), v < 3);
    if (v >= 3) {
      EXPECT_EQ(read.views[v].frames.size(), 8u);
      continue;
    }
    EXPECT_EQ(read.views[v].bracket->first, session.views[v].bracket->first);
    EXPECT_EQ(read.views[v].bracket->last, session.views[v].bracket->last);
    EXPECT_EQ(read.views[v].bracket->mean_loss, session.views[v].bracket->mean_loss);
    EXPECT_EQ(read.views[v].frames.front().file, acquire::frame_name(read.views[v].id, session.views[v].bracket->first)) << "numbers are those of the plan";
  }
  std::map<std::string, std::string> streamed;
  for (std::size_t v = 0; v < 3; ++v) streamed[read.views[v].id] = brdf::file_checksum(read.radiance_path(read.views[v]));
  calib::Calibration calibration = calib::calibration_from_rig(read.rig);
  calib::merge_session(read, calibration, {});
  for (std::size_t v = 0; v < 3; ++v) EXPECT_EQ(brdf::file_checksum(read.radiance_path(read.views[v])), streamed[read.views[v].id]);
}

TEST_F(AdaptiveBracketTest, CommandSaysWhatWasSavedAndWhatItCosts) {
  test::write_file(folder / "rig.toml", rig_text(usual, "adaptive = true"));
  fs::copy_file(test::source_dir() / "data-samples/paints/blue-matte.json", folder / "paint.json");
  const auto dry = test::run_lacquer("-q capture --dry-run " + (folder / "rig.toml").string());
  EXPECT_NE(dry.out.find("adaptive: each view takes those it needs, 1 % loss of sigma in the mean at most"), std::string::npos) << dry.out;
  const auto result = test::run_lacquer("-q capture " + (folder / "rig.toml").string() + " -o " + (folder / "s").string());
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("adaptive bracket: "), std::string::npos) << result.out;
  EXPECT_NE(result.out.find(" of 24 frames left out, "), std::string::npos) << result.out;
}

TEST_F(AdaptiveBracketTest, PlansThatCannotBeAdaptiveAreRefused) {
  const auto error_of = [&](const std::string& text) {
    try {
      acquire::parse_rig(text, "rig.toml");
    } catch (const Error& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  EXPECT_EQ(error_of(rig_text(usual, "adaptive_loss = 0.1")), "rig.toml: plan.adaptive_loss: only with adaptive = true");
  std::string curved = rig_text(usual, "adaptive = true");
  curved.replace(curved.find("[[lights]]"), 0, "response = \"estimate\"\n");
  EXPECT_EQ(error_of(curved), "rig.toml: plan.adaptive: only with sensor.response = \"linear\"; a curve is found from whole brackets");
}

}  // namespace
}  // namespace lacquer
