#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "libacquire/open_rig.h"
#include "libacquire/rig_check.h"
#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "test_support.h"

/// Rigs with one thing wrong, and the check that must say so.
namespace lacquer::acquire {
namespace {

using Verdict = RigCheck::Verdict;

constexpr const char* rig_text = R"(
[rig]
name = "checked"
kind = "simulated"
[camera]
width_px = 48
height_px = 36
layout = "mono"
bits = 12
focal_length_px = 305
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 64
gain_e_per_dn = 4
sensitivity_e_per_s = 5e5
[[lights]]
name = "left"
position_mm = [-100, 125, 587]
[[lights]]
name = "right"
position_mm = [100, 125, 587]
[plan]
angles_deg = [0, 30]
exposures_ms = [1, 4, 16, 64]
[simulation]
paint = "paint.json"
)";

/// A camera of a lit sphere that is linear, black at 64 DN, and noisy - unless told otherwise.
struct World {
  std::function<double(double)> response = [](double linear_dn) { return linear_dn; };  ///< signal above black
  std::function<double(double)> true_exposure = [](double asked) { return asked; };
  double black_dn = 64, room_dn_per_s = 0, light_dn_per_s = 60e3, flicker = 0, drift_per_frame = 0;
  int broken_light = -1, stuck_light = -1;
  double degrees_per_degree = 1;
  CameraLimits limits;
  std::string warning;

  int lit = -1;
  double angle = 0;
  bool off_at_end = false, held = false;
  int n_frames = 0;
  std::vector<double> moves, exposures;
  std::mt19937_64 random{1};
};

class WorldTurntable final : public Turntable {
 public:
  explicit WorldTurntable(World& world) : world_(world) {}
  void hold() noexcept override { world_.held = true; }
  std::string description() const override { return "table of the test"; }

 private:
  double do_move_to(double angle) override {
    world_.moves.push_back(angle);
    return world_.angle = angle * world_.degrees_per_degree;
  }
  World& world_;
};

class WorldLights final : public LightSwitch {
 public:
  explicit WorldLights(World& world) : world_(world) {}
  void off() noexcept override { world_.lit = -1, world_.off_at_end = true; }
  std::string description() const override { return "lights of the test"; }
  int n_lights() const override { return 2; }

 private:
  void do_on(int index) override { world_.lit = index, world_.off_at_end = false; }
  World& world_;
};

class WorldCamera final : public Camera {
 public:
  WorldCamera(World& world, RigGeometry geometry) : world_(world), geometry_(std::move(geometry)) {}
  std::string description() const override { return "camera of the test"; }
  CameraLimits limits() const override { return world_.limits; }
  std::string warning() const override { return world_.warning; }

 private:
  RawFrame do_capture(const CaptureSettings& asked) override {
    World& w = world_;
    RawFrame frame{.width = 48, .height = 36, .layout = PixelLayout::mono, .bits = 12, .data = {}, .actual = asked};
    w.exposures.push_back(asked.exposure_s);
    const double time = w.true_exposure(asked.exposure_s);
    std::normal_distribution<double> normal;
    double factor = (1 + w.flicker * normal(w.random)) * (1 + w.drift_per_frame * w.n_frames++);
    const int lit = w.stuck_light >= 0 ? w.stuck_light : w.lit;
    if (lit < 0 || lit == w.broken_light) factor = 0;
    for (int y = 0; y < frame.height; ++y)
      for (int x = 0; x < frame.width; ++x) {
        const auto point = trace(geometry_, {x, y});
        const auto light = point && lit >= 0 ? illuminate(geometry_.place_light(static_cast<std::size_t>(lit), w.angle), *point) : std::nullopt;
        const double linear = time * (w.room_dn_per_s + (light ? factor * w.light_dn_per_s * light->irradiance[0] / 3 : 0));
        const double value = w.black_dn + w.response(linear) + std::sqrt(1.5 + linear / 4) * normal(w.random);
        frame.data.push_back(static_cast<std::uint16_t>(std::clamp(std::round(value), 0.0, 4095.0)));
      }
    return frame;
  }
  World& world_;
  RigGeometry geometry_;
};

class RigCheckTest : public testing::Test {
 protected:
  std::vector<RigCheck> check(CheckExtent extent = CheckExtent::quick) {
    Rig rig;
    rig.turntable = std::make_unique<WorldTurntable>(world);
    rig.lights = std::make_unique<WorldLights>(world);
    rig.camera = std::make_unique<WorldCamera>(world, description.geometry);
    auto checks = check_rig(rig, description, extent);
    EXPECT_TRUE(world.off_at_end && world.held);
    return checks;
  }
  /// The one whose name begins so.
  static RigCheck named(const std::vector<RigCheck>& checks, const std::string& name) {
    for (const RigCheck& c : checks)
      if (c.name.starts_with(name)) return c;
    ADD_FAILURE() << "no check " << name;
    return {};
  }
  void expect(const std::string& name, Verdict verdict, const std::string& text, CheckExtent extent = CheckExtent::quick) {
    const RigCheck found = named(check(extent), name);
    EXPECT_EQ(found.verdict, verdict) << found.name << ": " << found.text;
    EXPECT_NE(found.text.find(text), std::string::npos) << found.text;
  }
  test::TemporaryFolder folder;
  RigDescription description = parse_rig(rig_text, folder / "rig.toml");
  World world;
};

TEST_F(RigCheckTest, AGoodRigPassesAllOfThem) {
  for (const RigCheck& c : check(CheckExtent::full)) EXPECT_EQ(c.verdict, Verdict::good) << c.name << ": " << c.text;
  EXPECT_EQ(world.moves.size(), 6u) << "to the view, 1 degree and back, and to each light's view";
  for (const double m : world.moves) EXPECT_LE(std::abs(m), 0.5236 + 0.0175) << "never beyond the plan by more than 1 degree";
}

TEST_F(RigCheckTest, QuickChecksTakeAtMostFifteenFrames) {
  check();
  EXPECT_LE(world.n_frames, 15);
  for (const double e : world.exposures)
    for (const double planned : {0.001, 0.004, 0.016, 0.064}) EXPECT_NE(e, planned) << "planned frames stay the first of their kind";
}

// 40 seeds of a flickering light: no good camera may be refused. 1 % is what an uncooled LED does at worst.
TEST_F(RigCheckTest, FlickerAndDriftOfALightAreNotTheCamerasFault) {
  int not_good = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    world = World{};
    world.flicker = 0.01;
    world.drift_per_frame = 0.002;
    world.random.seed(seed);
    const RigCheck linear = named(check(), "camera: linear");
    EXPECT_NE(linear.verdict, Verdict::failed) << seed << ": " << linear.text;
    not_good += linear.verdict != Verdict::good;
  }
  EXPECT_LE(not_good, 4) << "sigma comes from 3 pairs of frames: 4 sigma of a t distribution with 3 degrees of freedom is 3 %";
}

TEST_F(RigCheckTest, ACameraThatIgnoresTheExposureIsFound) {
  world.true_exposure = [](double) { return 0.01; };
  expect("camera: linear", Verdict::failed, "the image does not follow the exposure time: an automatic exposure or gain is on");
}

TEST_F(RigCheckTest, ACameraWhoseExposuresAreLongerThanItSaysIsFoundWithTheirExcess) {
  // 1.5 ms beside 10 ms in t/4.
  world.true_exposure = [](double asked) { return asked + 1.5e-3; };
  const RigCheck found = named(check(), "camera: linear");
  EXPECT_EQ(found.verdict, Verdict::failed) << found.text;
  const std::size_t at = found.text.find("as if every exposure were ");
  ASSERT_NE(at, std::string::npos) << found.text;
  EXPECT_NEAR(std::stod(found.text.substr(at + 26)), 1.5, 0.1) << "0.1 % noise in the signals of 11 and 42 ms is 0.05 ms";
  EXPECT_NE(found.text.find("longer"), std::string::npos);
}

TEST_F(RigCheckTest, AGammaCurveIsFoundWithItsExponent) {
  world.response = [](double linear) { return 4031 * std::pow(std::clamp(linear / 4031, 0.0, 1.0), 1 / 2.2); };
  expect("camera: linear", Verdict::failed, "signals grow as time^0.4");
  description.sensor.response = SensorDescription::Response::estimate;
  expect("camera: brighter", Verdict::good, "");
}

TEST_F(RigCheckTest, AFalseBlackLevelIsFound) {
  world.black_dn = 100;
  expect("camera: black", Verdict::failed, "99.9");  // the mean leaves a few values out; 0.1 DN do not matter here
  world.black_dn = 67;
  expect("camera: black", Verdict::warning, "the rig file says 64; correct sensor.black_level_dn or the camera's offset");
  EXPECT_EQ(named(check(), "camera: linear").verdict, Verdict::good) << "the camera itself is linear";
  world.black_dn = description.sensor.black_level_dn = 0;
  expect("camera: black", Verdict::warning, "noise is cut off");
}

TEST_F(RigCheckTest, RoomLightIsSaidWithItsShare) {
  world.room_dn_per_s = 3000;
  expect("room: dark", Verdict::warning, "switch off the room's light");
}

TEST_F(RigCheckTest, EachLightMustBeSeen) {
  world.broken_light = 1;
  const auto checks = check(CheckExtent::full);
  EXPECT_EQ(named(checks, "light \"left\"").verdict, Verdict::good);
  EXPECT_EQ(named(checks, "light \"right\"").verdict, Verdict::failed) << named(checks, "light \"right\"").text;
}

TEST_F(RigCheckTest, ALightThatStaysOnIsFound) {
  world.stuck_light = 0;
  const auto checks = check(CheckExtent::full);
  EXPECT_EQ(named(checks, "light \"left\"").verdict, Verdict::failed);
  EXPECT_NE(named(checks, "camera: linear").verdict, Verdict::good) << "nothing changes with the switch";
}

TEST_F(RigCheckTest, NoLightAtAllCannotJudgeTheCameraAndSaysSo) {
  world.light_dn_per_s = 0;
  expect("camera: linear", Verdict::warning, "cannot be told: the light gives");
}

TEST_F(RigCheckTest, ATooStrongLightIsSaid) {
  world.light_dn_per_s = 60e6;
  expect("exposures: range", Verdict::warning, "plan a shorter exposure", CheckExtent::full);
  world.light_dn_per_s = 20;
  expect("exposures: range", Verdict::warning, "plan a longer exposure", CheckExtent::full);
}

TEST_F(RigCheckTest, AWrongGearRatioIsFound) {
  world.degrees_per_degree = 2;
  expect("turntable: turns", Verdict::failed, "check gear_ratio", CheckExtent::full);
}

TEST_F(RigCheckTest, ACameraOfOneExposureOnlyIsNotJudged) {
  world.limits.min_exposure_s = world.limits.max_exposure_s = 0.033;
  expect("camera: linear", Verdict::warning, "hardly more than one exposure time");
}

TEST_F(RigCheckTest, TheCamerasWarningIsPassedOn) {
  world.warning = "photographs are compressed";
  expect("camera: camera of the test", Verdict::warning, "photographs are compressed");
}

TEST_F(RigCheckTest, SpaceThatIsNotThereIsFound) {
  EXPECT_EQ(check_free_space(description, folder / "not/there/yet").verdict, Verdict::good);
  description.plan.resize(100000, description.plan[0]);
  description.geometry.camera.width = description.geometry.camera.height = 32768;
  EXPECT_EQ(check_free_space(description, folder / "x").verdict, Verdict::failed) << "800 TB";
}

// The frames of a checked capture are those of an unchecked one.
TEST_F(RigCheckTest, ChecksDoNotChangeWhatIsCaptured) {
  std::vector<std::string> checksums[2];
  for (const bool checked : {false, true}) {
    Rig rig = open_rig(description, brdf::load_brdf(test::source_dir() / "data-samples/paints/white.json"));
    CaptureOptions options;
    if (checked) options.before_frames = [&](Rig& devices) {
      for (const RigCheck& c : check_rig(devices, description, CheckExtent::full)) EXPECT_EQ(c.verdict, Verdict::good) << c.name << ": " << c.text;
    };
    const Session session = capture_session(rig, description, folder / (checked ? "checked" : "plain"), options, {});
    for (const ViewRecord& view : session.views)
      for (const FrameRecord& frame : view.frames) checksums[checked].push_back(frame.checksum);
  }
  EXPECT_EQ(checksums[0], checksums[1]);
}

}  // namespace
}  // namespace lacquer::acquire
