#include <gtest/gtest.h>

#include "libacquire/rig_description.h"
#include "libbrdf/error.h"

/// Reference views, dark views and the reference patch of a rig file.
namespace lacquer::acquire {
namespace {

std::string rig_text(const std::string& plan, const std::string& more = "") {
  return R"([rig]
name = "plan"
kind = "simulated"
[camera]
width_px = 96
height_px = 72
layout = "mono"
bits = 12
focal_length_px = 611
position_mm = [0, 0, 1000]
[sensor]
sensitivity_e_per_s = 1e5
[[lights]]
name = "A"
position_mm = [0, 125, 587]
[[lights]]
name = "B"
position_mm = [50, 300, 500]
[plan]
angles_deg = { from = 0, to = 40, step = 10 }
exposures_ms = [1, 10]
)" + plan + more;
}

RigDescription rig_of(const std::string& plan, const std::string& more = "") { return parse_rig(rig_text(plan, more), "rig.toml"); }

std::string error_of(const std::string& plan, const std::string& more = "") {
  try {
    rig_of(plan, more);
  } catch (const Error& e) {
    return e.what();
  }
  return "no error";
}

std::string ids(const RigDescription& rig) {
  std::string text;
  for (const PlannedView& view : rig.plan) text += view.id + " ";
  return text;
}

TEST(RigPlan, ReferencesAreTheFirstViewOfEachLightAfterEveryFewViewsAndAtTheEnd) {
  const RigDescription rig = rig_of("reference_every = 3\n");
  EXPECT_EQ(ids(rig), "L000 L001 L002 R000 R001 L003 L004 L005 R002 R003 L006 L007 L008 R004 R005 L009 R006 R007 ");
  for (const PlannedView& view : rig.plan) {
    if (view.id[0] != 'R') continue;
    EXPECT_EQ(view.kind, ViewKind::reference);
    EXPECT_EQ(view.turntable_angle, 0);
    EXPECT_EQ(view.light, (view.id.back() - '0') % 2) << "lights in turn: " << view.id;
    EXPECT_EQ(view.exposures_s, rig.plan[0].exposures_s);
  }
}

TEST(RigPlan, ARoundThatWouldFollowTheLastOneDirectlyIsNotTaken) {
  const RigDescription rig = rig_of("reference_every = 1\nlights = [1]\n");
  EXPECT_EQ(ids(rig), "L000 R000 L001 R001 L002 R002 L003 R003 L004 R004 ");
  EXPECT_EQ(rig.plan[1].light, 1);
}

TEST(RigPlan, FewerRoundsThanTellADriftFromFlickerAreRefused) {
  EXPECT_EQ(error_of("reference_every = 4\n"),
            "rig.toml: plan.reference_every: 10 views with references after every 4 are 3 rounds; expected 4 or more, so that a drift can be "
            "told from flicker");
  EXPECT_NE(error_of("reference_every = 0\n").find("rig.toml: plan.reference_every: "), std::string::npos);
}

TEST(RigPlan, DarkViewsComeLastWithoutLightWhereTheTableStands) {
  const RigDescription rig = rig_of("dark_frames = 2\n");
  EXPECT_TRUE(ids(rig).ends_with("L009 D000 D001 "));
  const PlannedView &last = rig.plan[9], &dark = rig.plan[11];
  EXPECT_EQ(dark.kind, ViewKind::dark);
  EXPECT_EQ(dark.light, -1);
  EXPECT_EQ(dark.turntable_angle, last.turntable_angle);
  EXPECT_EQ(dark.exposures_s, last.exposures_s);
  EXPECT_EQ(rig_of("").plan.size(), 10u);
  EXPECT_EQ(rig_of("dark_frames = 0\n").plan.size(), 10u);
}

TEST(RigPlan, DarkFramesThatTellNothingAreRefused) {
  EXPECT_NE(error_of("dark_frames = 1\n").find("rig.toml: plan.dark_frames: expected 0 or at least 2"), std::string::npos);
  std::string one_time = rig_text("dark_frames = 3\n");
  one_time.replace(one_time.find("[1, 10]"), 7, "[10]");
  try {
    parse_rig(one_time, "rig.toml");
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("dark_frames: expected exposures_ms with two or more times"), std::string::npos) << e.what();
  }
}

constexpr const char* patch_in_a_corner = "[reference_patch]\nx_px = 2\ny_px = 3\nwidth_px = 8\nheight_px = 6\n";

TEST(RigPlan, PatchIsAPlaceInTheImageBesideTheSphere) {
  const auto patch = rig_of("", patch_in_a_corner).reference_patch;
  ASSERT_TRUE(patch);
  EXPECT_EQ(patch->x, 2);
  EXPECT_EQ(patch->y, 3);
  EXPECT_EQ(patch->width, 8);
  EXPECT_EQ(patch->height, 6);
  EXPECT_FALSE(rig_of("").reference_patch);
  // The sphere has a radius of 31 pixels around (47.5, 35.5).
  EXPECT_NE(error_of("", "[reference_patch]\nx_px = 40\ny_px = 30\nwidth_px = 8\nheight_px = 6\n").find("shows the sphere; expected a patch beside it"),
            std::string::npos);
  EXPECT_NE(error_of("", "[reference_patch]\nx_px = 90\ny_px = 3\nwidth_px = 8\nheight_px = 6\n").find("reference_patch"), std::string::npos)
      << "two columns beyond the image";
  EXPECT_NE(error_of("", "[reference_patch]\nx_px = 2\ny_px = 3\nwidth_px = 8\n").find("height_px"), std::string::npos);
}

TEST(RigPlan, LightsAreFollowedInOneWayOnly) {
  EXPECT_NE(error_of("reference_every = 2\n", patch_in_a_corner).find("expected this or plan.reference_every, not both"), std::string::npos);
}

TEST(RigPlan, SimulatedPatchNeedsItsPlace) {
  EXPECT_EQ(rig_of("", std::string(patch_in_a_corner) + "[simulation]\npatch_radiance = 0.5\n").simulation.patch_radiance, 0.5);
  EXPECT_NE(error_of("", "[simulation]\npatch_radiance = 0.5\n").find("simulation.patch_radiance: only with [reference_patch]"), std::string::npos);
}

TEST(RigPlan, PhotographsHaveNoTimeAndThereforeNoReferences) {
  const std::string replay = R"([rig]
name = "replay"
kind = "replay"
[camera]
width_px = 96
height_px = 72
layout = "mono"
bits = 12
focal_length_px = 611
position_mm = [0, 0, 1000]
[[lights]]
direction = [0, 0, 1]
[replay]
file_pattern = "%03d.png"
first = 1
last = 20
)";
  for (const std::string more : {"[plan]\nreference_every = 2\n", "[plan]\ndark_frames = 2\n", patch_in_a_corner}) try {
      parse_rig(replay + more, "rig.toml");
      ADD_FAILURE() << "accepted " << more;
    } catch (const Error& e) {
      EXPECT_NE(std::string(e.what()).find("only where frames are taken; of photographs it is not known when they were"), std::string::npos) << e.what();
    }
}

}  // namespace
}  // namespace lacquer::acquire
