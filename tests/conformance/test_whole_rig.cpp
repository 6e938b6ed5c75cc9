#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
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
#include "libbrdf/table.h"
#include "libcalib/merge_session.h"
#include "libcalib/samples.h"
#include "test_support.h"
#ifdef LACQUER_VM_PEERS
#include "libacquire/tic/usb_tic.h"
#include "vm/gpio_sim.h"
#include "vm/peers_vm.h"
#include "vm/usb_devices.h"
#endif

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

/// How the simulated world sees what the drivers have done.
struct Surroundings {
  std::function<double()> motor_steps;
  std::function<std::optional<int>()> light;
};

acquire::TicSettings tic_settings() {
  acquire::TicSettings tic;
  tic.microsteps = 16;
  tic.gear_ratio = 5;
  return tic;
}
constexpr double steps_per_turn = 200 * 16 * 5;

calib::Tabulation tabulate(const acquire::Session& session) {
  calib::Calibration calibration = calib::calibration_from_rig(session.rig);
  calib::merge_session(session, calibration, {});
  return calib::tabulate_session(session, calibration, {}, {});
}

void expect_same_frames(const acquire::Session& a, const acquire::Session& b) {
  double squares = 0, variances = 0, squared_variances = 0;  // DN^2, of differences of two frames
  for (std::size_t v = 0; v < 8; ++v) {
    EXPECT_NEAR(a.views[v].turntable_angle, a.rig.plan[v].turntable_angle, 0.51 * 2 * std::numbers::pi / steps_per_turn);
    for (std::size_t e = 0; e < 3; ++e) {
      const auto one = acquire::read_session_frame(a, a.views[v].frames[e]), other = acquire::read_session_frame(b, b.views[v].frames[e]);
      EXPECT_NEAR(one.actual.exposure_s, other.actual.exposure_s, 1e-12);
      for (std::size_t i = 0; i < one.data.size(); ++i) {
        const double signal = 0.5 * (one.data[i] + other.data[i]) - 64;
        const double variance = 2 * (5 * 5 / 4.2 / 4.2 + signal / 4.2 + 1.0 / 12);  // read noise, shot noise, rounding
        squares += std::pow(double{1} * one.data[i] - other.data[i], 2);
        variances += variance;
        squared_variances += variance * variance;
      }
    }
  }
  // The square of a normal number of variance v has the variance 2 v^2. Chance alone exceeds 5 sigma once in two million runs.
  EXPECT_NEAR(squares / variances, 1, 5 * std::sqrt(2 * squared_variances) / variances);
  EXPECT_LT(5 * std::sqrt(2 * squared_variances) / variances, 0.1) << "the test sees differences of a tenth of the noise's variance";
}

/// Cell by cell, each difference against its own variance; and both against the truth, a paint of 0.2 / sr everywhere.
void expect_same_table(const brdf::HalfAngleTable& a, const brdf::HalfAngleTable& b) {
  const brdf::TableChannel &one = a.channels.at(0), &other = b.channels.at(0);
  double chi_square = 0, n = 0;
  std::array<double, 2> weights{}, weighted{};
  for (std::size_t i = 0; i < one.mean.size(); ++i) {
    if (one.origin[i] != brdf::CellOrigin::measured || other.origin[i] != brdf::CellOrigin::measured) continue;
    chi_square += std::pow(double{one.mean[i]} - double{other.mean[i]}, 2) / (double{one.variance[i]} + double{other.variance[i]});
    ++n;
    for (std::size_t k = 0; k < 2; ++k) {
      const auto& channel = k == 0 ? one : other;
      weights[k] += 1 / double{channel.variance[i]};
      weighted[k] += double{channel.mean[i]} / double{channel.variance[i]};
    }
  }
  EXPECT_GT(n, 1000) << "cells measured by both";
  EXPECT_NEAR(chi_square / n, 1, 5 * std::sqrt(2 / n));
  for (std::size_t k = 0; k < 2; ++k) EXPECT_NEAR(weighted[k] / weights[k], 0.2, 0.002) << "variances from noisy values bias the mean by less than a percent";
}

/// The scene is the simulated one; between it and the session are the real drivers: the sensor's counts travel over GVCP and GVSP, the table
/// stands where the stepper has turned it, and it is as bright as the lines say. Photographs and table must be those of the simulated rig but for
/// noise.
void expect_the_simulated_rigs_results(acquire::Rig rig, const Surroundings& surroundings) {
  const acquire::RigDescription description = acquire::parse_rig(rig_text, "whole.toml");
  acquire::RigDescription scene_description = description;
  scene_description.simulation.seed = 2;  // other noise
  acquire::sim::SimulatedWorld world(scene_description, std::make_shared<White>());
  acquire::RawFrame picture;
  FakeGigeCamera device(
      [&](int x, int y, double exposure_s, double) {
        if (x == 0 && y == 0) {
          world.move_to(surroundings.motor_steps() * 2 * std::numbers::pi / steps_per_turn);
          world.switch_light(surroundings.light());
          picture = world.photograph({exposure_s, 0});
        }
        return static_cast<unsigned>(picture.data[static_cast<std::size_t>(y * picture.width + x)]);
      },
      true);
  acquire::CameraDeviceSettings camera;
  camera.width = 64;
  camera.height = 48;
  camera.bits = 12;
  camera.id = "127.0.0.1";
  camera.pixel_format = "Mono12Packed";
  rig.camera = acquire::open_aravis_camera(camera);

  TemporaryFolder folder;
  const auto through_drivers = acquire::capture_session(rig, description, folder / "drivers", {.command_line = "test"}, {});
  EXPECT_FALSE(surroundings.light()) << "off in the end";
  acquire::Rig simulated = acquire::open_simulated_rig(description, std::make_shared<White>());
  const auto direct = acquire::capture_session(simulated, description, folder / "simulated", {.command_line = "test"}, {});
  ASSERT_EQ(through_drivers.views.size(), 8u);
  expect_same_frames(through_drivers, direct);
  expect_same_table(tabulate(through_drivers).table, tabulate(direct).table);
}

TEST(WholeRig, RealDriversGivePhotographsAndTableOfTheSimulatedRigWithinNoise) {
  TurnedClock clock;
  const auto model = std::make_shared<TicModel>(clock);
  const auto wires = std::make_shared<FakeWires>(2);
  acquire::Rig rig;
  rig.turntable = std::make_unique<acquire::TicTurntable>(std::make_unique<ModelTransfers>(model, std::make_shared<ModelTransfers::Faults>()), tic_settings(), clock);
  rig.lights = std::make_unique<acquire::GpioLights>(std::make_unique<FakeGpioLines>(wires), 0.1, clock);
  expect_the_simulated_rigs_results(std::move(rig), {[&] { return model->physical_position(); }, [&] {
    return wires->on[0] ? std::optional(0) : wires->on[1] ? std::optional(1) : std::nullopt;
  }});
  EXPECT_TRUE(model->energised());
}

#ifdef LACQUER_VM_PEERS
// Aravis over the loopback network, libusb and libgpiod over Debian's kernel, all in one capture.
TEST(VmWholeRig, ThroughTheKernelToo) {
  if (!in_virtual_machine()) GTEST_SKIP() << "runs in the virtual machine (VirtualMachine.*)";
  const auto model = std::make_shared<TicModel>(acquire::Clock::steady());
  UsbTicDevice tic(model, "00123456", 0x00B3, 1);
  tic.plug_in();
  GpioSim chip;
  acquire::TicSettings settings = tic_settings();
  settings.max_speed = 3;
  settings.max_acceleration = 20;
  settings.settle_s = 0.02;
  acquire::Rig rig;
  rig.turntable = std::make_unique<acquire::TicTurntable>(when_there([] { return acquire::open_usb_tic("00123456"); }), settings);
  rig.lights = when_there([] {
    return std::make_unique<acquire::GpioLights>(acquire::open_gpiod_lines({{GpioSim::label, "LED2", 0, false}, {GpioSim::label, "LED3", 0, false}}), 0.01);
  });
  expect_the_simulated_rigs_results(std::move(rig), {[&] { return model->physical_position(); }, [&] {
    return chip.high(2) ? std::optional(0) : chip.high(3) ? std::optional(1) : std::nullopt;
  }});
  EXPECT_TRUE(model->energised());
}
#endif

}  // namespace
}  // namespace lacquer::test
