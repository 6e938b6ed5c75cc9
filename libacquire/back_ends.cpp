#include "libacquire/back_ends.h"

#include <fmt/format.h>

#include <array>

#include "libacquire/aravis/aravis_camera.h"
#include "libacquire/gpio/gpio_lights.h"
#include "libacquire/tic/tic_turntable.h"
#include "libacquire/tic/usb_tic.h"
#include "libacquire/v4l2/v4l2_camera.h"

namespace lacquer::acquire {

namespace {

using CameraRow = BackEnd<Camera, CameraDeviceSettings>;
using TurntableRow = BackEnd<Turntable, TicSettings>;
using LightsRow = BackEnd<LightSwitch, GpioSettings>;

#ifdef LACQUER_ARAVIS
std::vector<FoundDevice> find_aravis() {
  std::vector<FoundDevice> result;
  for (const FoundAravisCamera& c : find_aravis_cameras())
    result.push_back({c.id, fmt::format("{} {} {}, {} at {}, {} x {}", c.vendor, c.model, c.serial, c.protocol, c.address, c.width, c.height), c.pixel_formats,
                      c.problem.empty() ? std::optional(c.limits) : std::nullopt, c.problem});
  return result;
}
constexpr CameraRow aravis{"aravis", "LACQUER_ARAVIS", open_aravis_camera, find_aravis};
#else
constexpr CameraRow aravis{"aravis", "LACQUER_ARAVIS", nullptr, nullptr};
#endif

#ifdef LACQUER_V4L2
std::vector<FoundDevice> find_v4l2() {
  std::vector<FoundDevice> result;
  for (const FoundV4l2Camera& c : find_v4l2_cameras())
    result.push_back({c.path, fmt::format("{}, {}{}", c.card, c.bus, c.limits || !c.problem.empty() ? "" : ", no manual exposure"), c.pixel_formats, c.limits, c.problem});
  return result;
}
constexpr CameraRow v4l2{"v4l2", "LACQUER_V4L2", open_v4l2_camera, find_v4l2};
#else
constexpr CameraRow v4l2{"v4l2", "LACQUER_V4L2", nullptr, nullptr};
#endif

#ifdef LACQUER_TIC
std::unique_ptr<Turntable> open_tic(const TicSettings& settings) { return std::make_unique<TicTurntable>(open_usb_tic(settings.serial), settings); }
std::vector<FoundDevice> find_tic() {
  std::vector<FoundDevice> result;
  for (const FoundTic& t : find_usb_tics()) result.push_back({t.serial, "Pololu Tic " + t.product, {}, std::nullopt, t.problem});
  return result;
}
constexpr TurntableRow tic{"tic", "LACQUER_TIC", open_tic, find_tic};
#else
constexpr TurntableRow tic{"tic", "LACQUER_TIC", nullptr, nullptr};
#endif

/// No turntable: sphere and lights stand still, at angle 0.
class FixedTurntable final : public Turntable {
 public:
  void hold() noexcept override {}
  std::string description() const override { return "no turntable"; }
  TurntableLimits limits() const override { return {0, 0}; }

 private:
  double do_move_to(double) override { return 0; }
};
std::unique_ptr<Turntable> open_fixed(const TicSettings&) { return std::make_unique<FixedTurntable>(); }

#ifdef LACQUER_GPIOD
std::unique_ptr<LightSwitch> open_gpio(const GpioSettings& settings) {
  return std::make_unique<GpioLights>(open_gpiod_lines(settings.lights), settings.settle_s);
}
std::vector<FoundDevice> find_gpio() {
  std::vector<FoundDevice> result;
  for (const FoundGpioChip& c : find_gpio_chips())
    result.push_back({c.name, c.problem.empty() ? fmt::format("{}, {} lines", c.label, c.n_lines) : "", c.named_lines, std::nullopt, c.problem});
  return result;
}
constexpr LightsRow gpio{"gpiod", "LACQUER_GPIOD", open_gpio, find_gpio};
#else
constexpr LightsRow gpio{"gpiod", "LACQUER_GPIOD", nullptr, nullptr};
#endif

constexpr std::array cameras{aravis, v4l2};
constexpr std::array turntables{tic, TurntableRow{"fixed", "", open_fixed, nullptr}};
constexpr std::array lights{gpio};

}  // namespace

std::span<const CameraRow> camera_back_ends() { return cameras; }
std::span<const TurntableRow> turntable_back_ends() { return turntables; }
std::span<const LightsRow> lights_back_ends() { return lights; }

}  // namespace lacquer::acquire
