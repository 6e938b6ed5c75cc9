#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "conformance/fake_gige_camera.h"
#include "conformance/fake_gpio_lines.h"
#include "conformance/tic_model.h"
#include "conformance/turned_clock.h"
#include "libacquire/aravis/aravis_camera.h"
#include "libacquire/gpio/gpio_lights.h"
#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libacquire/sim/simulated_world.h"
#include "libacquire/tic/tic_turntable.h"
#include "test_support.h"

namespace lacquer::test {
namespace {

class White final : public brdf::Brdf {
 public:
  std::string description() const override { return "white"; }

 private:
  std::optional<glm::dvec3> do_value(const brdf::Directions&, const brdf::Footprint<double>&) const override { return glm::dvec3(0.2); }
};

constexpr const char* rig_text = R"(
[rig]
name = "whole"
kind = "simulated"
[camera]
width_px = 64
height_px = 48
layout = "mono"
bits = 12
focal_length_px = 400
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 64
gain_e_per_dn = 4.2
read_noise_e = 5
sensitivity_e_per_s = 5e5
[[lights]]
name = "low"
position_mm = [0, 120, 580]
intensity = 0.5
[[lights]]
name = "high"
position_mm = [0, 500, 300]
intensity = 0.5
[plan]
angles_deg = [0, 30, 75, 120]
exposures_ms = [2, 8, 32]
)";

/// The scene is the simulated one; between it and the session are the real drivers: the sensor's counts travel over GVCP and GVSP, the table
/// stands where the stepper has turned it, and it is as bright as the lines say. The photographs must be those of the simulated rig but for noise.
TEST(WholeRig, RealDriversGiveThePhotographsOfTheSimulatedRigWithinNoise) {
  const acquire::RigDescription description = acquire::parse_rig(rig_text, "whole.toml");
  acquire::RigDescription scene_description = description;
  scene_description.simulation.seed = 2;  // other noise
  acquire::sim::SimulatedWorld world(scene_description, std::make_shared<White>());

  TurnedClock clock;
  const auto model = std::make_shared<TicModel>(clock);
  const auto wires = std::make_shared<FakeWires>(2);
  acquire::TicSettings tic;
  tic.microsteps = 16;
  tic.gear_ratio = 5;
  acquire::RawFrame picture;
  FakeGigeCamera device(
      [&](int x, int y, double exposure_s, double) {
        if (x == 0 && y == 0) {
          world.move_to(model->physical_position() * 2 * std::numbers::pi / (200 * 16 * 5));
          world.switch_light(wires->on[0] ? std::optional(0) : wires->on[1] ? std::optional(1) : std::nullopt);
          picture = world.photograph({exposure_s, 0});
        }
        return static_cast<unsigned>(picture.data[static_cast<std::size_t>(y * picture.width + x)]);
      },
      true);
  acquire::Rig rig;
  rig.turntable = std::make_unique<acquire::TicTurntable>(std::make_unique<ModelTransfers>(model, std::make_shared<ModelTransfers::Faults>()), tic, clock);
  rig.lights = std::make_unique<acquire::GpioLights>(std::make_unique<FakeGpioLines>(wires), 0.1, clock);
  acquire::CameraDeviceSettings camera;
  camera.width = 64;
  camera.height = 48;
  camera.bits = 12;
  camera.id = "127.0.0.1";
  camera.pixel_format = "Mono12Packed";
  rig.camera = acquire::open_aravis_camera(camera);

  TemporaryFolder folder;
  const auto through_drivers = acquire::capture_session(rig, description, folder / "drivers", {.command_line = "test"}, {});
  EXPECT_EQ(wires->on, (std::vector<bool>{false, false}));
  EXPECT_TRUE(model->energised());
  acquire::Rig simulated = acquire::open_simulated_rig(description, std::make_shared<White>());
  const auto direct = acquire::capture_session(simulated, description, folder / "simulated", {.command_line = "test"}, {});

  double squares = 0, variances = 0, squared_variances = 0;  // DN^2, of differences of two frames
  ASSERT_EQ(through_drivers.views.size(), 8u);
  for (std::size_t v = 0; v < 8; ++v) {
    EXPECT_NEAR(through_drivers.views[v].turntable_angle, description.plan[v].turntable_angle, 0.51 * 2 * std::numbers::pi / 16000);
    for (std::size_t e = 0; e < 3; ++e) {
      const auto a = acquire::read_session_frame(through_drivers, through_drivers.views[v].frames[e]);
      const auto b = acquire::read_session_frame(direct, direct.views[v].frames[e]);
      EXPECT_NEAR(a.actual.exposure_s, b.actual.exposure_s, 1e-12);
      for (std::size_t i = 0; i < a.data.size(); ++i) {
        const double signal = 0.5 * (a.data[i] + b.data[i]) - 64;
        const double variance = 2 * (5 * 5 / 4.2 / 4.2 + signal / 4.2 + 1.0 / 12);  // read noise, shot noise, rounding
        squares += std::pow(double{1} * a.data[i] - b.data[i], 2);
        variances += variance;
        squared_variances += variance * variance;
      }
    }
  }
  // The square of a normal number of variance v has the variance 2 v^2. Chance alone exceeds 5 sigma once in two million runs.
  EXPECT_NEAR(squares / variances, 1, 5 * std::sqrt(2 * squared_variances) / variances);
  EXPECT_LT(5 * std::sqrt(2 * squared_variances) / variances, 0.1) << "the test sees differences of a tenth of the noise's variance";
}

}  // namespace
}  // namespace lacquer::test
