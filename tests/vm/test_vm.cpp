#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <array>
#include <thread>

#include "conformance/expect_error.h"
#include "libacquire/gpio/gpio_lights.h"
#include "libacquire/tic/usb_tic.h"
#include "libacquire/v4l2/v4l2_camera.h"
#include "vm/gpio_sim.h"
#include "vm/peers_vm.h"
#include "vm/usb_devices.h"

/// What the conformance suites do not ask, of the kernel's own drivers: vivid, gpio-sim, vhci. Inside the virtual machine only.
namespace lacquer::test {
namespace {

using acquire::PixelLayout;

class VmVivid : public testing::Test {
 protected:
  void SetUp() override {
    if (!in_virtual_machine()) GTEST_SKIP() << "runs in the virtual machine (VirtualMachine.*)";
    for (const auto& c : acquire::find_v4l2_cameras())
      if (c.card.starts_with("vivid")) settings.id = c.path;
    ASSERT_NE(settings.id, "") << "no vivid";
    settings.width = 640;
    settings.height = 360;
    settings.fixed_exposure_s = 0.01;  // vivid has no exposure
  }
  std::unique_ptr<acquire::Camera> open() { return acquire::open_v4l2_camera(settings); }
  /// vivid's picture: eight bars, white, yellow, cyan, green, magenta, red, blue and black, each channel either near 0 or above half. Away
  /// from the text at the top and from the bars' edges.
  static void expect_bars(const acquire::RawFrame& frame, const char* name) {
    const std::array<std::array<bool, 3>, 8> bars{{{1, 1, 1}, {1, 1, 0}, {0, 1, 1}, {0, 1, 0}, {1, 0, 1}, {1, 0, 0}, {0, 0, 1}, {0, 0, 0}}};
    const int per_pixel = acquire::values_per_pixel(frame.layout);
    std::array<double, 8> brightness{};
    for (int y = 300; y < 302; ++y)
      for (int x = 0; x < frame.width; ++x) {
        if (x % 80 < 10 || x % 80 >= 70) continue;
        const auto bar = static_cast<std::size_t>(x / 80);
        for (int k = 0; k < per_pixel; ++k) {
          const double v = frame.data[static_cast<std::size_t>((y * frame.width + x) * per_pixel + k)] / static_cast<double>((1 << frame.bits) - 1);
          brightness[bar] += v;
          if (frame.layout == PixelLayout::mono) continue;
          const bool bright = bars[bar][static_cast<std::size_t>(acquire::channel_of(frame.layout, x, y, k))];
          ASSERT_TRUE(bright ? v > 0.5 : v < 0.1) << name << " at " << x << ", " << y << ": " << v;
        }
      }
    for (std::size_t i = 1; i < 8 && frame.layout == PixelLayout::mono; ++i) EXPECT_LT(brightness[i], brightness[i - 1]) << name;  // the order of their luma
  }

  acquire::CameraDeviceSettings settings;
};

TEST_F(VmVivid, DeliversEveryFormatWithinItsDepth) {
  for (const auto& [name, layout, bits] : std::vector<std::tuple<const char*, PixelLayout, int>>{{"GREY", PixelLayout::mono, 8},
                                                                                                {"Y10", PixelLayout::mono, 10},
                                                                                                {"Y12", PixelLayout::mono, 12},
                                                                                                {"Y16", PixelLayout::mono, 16},
                                                                                                {"RGGB", PixelLayout::bayer_rggb, 8},
                                                                                                {"GB10", PixelLayout::bayer_gbrg, 10},
                                                                                                {"BG12", PixelLayout::bayer_bggr, 12},
                                                                                                {"YUYV", PixelLayout::rgb, 8}}) {
    settings.pixel_format = name;
    settings.layout = layout;
    settings.bits = bits;
    const auto frame = open()->capture({0.01, 0});
    ASSERT_EQ(frame.width, 640) << name;
    expect_bars(frame, name);
  }
}

TEST_F(VmVivid, CameraWithoutExposureIsRefusedByName) {
  settings.fixed_exposure_s.reset();
  expect_error(ErrorCode::device, "no control exposure_time_absolute", [&] { open(); });
}

TEST_F(VmVivid, SecondUserIsTold) {
  const auto first = open();
  first->capture({0.01, 0});
  expect_error(ErrorCode::device, "another program uses the camera", [&] { open(); });
}

class VmGpio : public testing::Test {
 protected:
  void SetUp() override {
    if (!in_virtual_machine()) GTEST_SKIP() << "runs in the virtual machine (VirtualMachine.*)";
    sim = std::make_unique<GpioSim>();
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
  std::unique_ptr<acquire::GpioLines> open(std::vector<acquire::GpioLightSettings> lights) { return acquire::open_gpiod_lines(lights); }
  std::unique_ptr<GpioSim> sim;
};

TEST_F(VmGpio, ActiveLowLightsShineWhenTheirLineIsLow) {
  acquire::GpioLights lights(open({{GpioSim::label, "LED2", 0, true}, {GpioSim::label, "LED3", 0, true}}), 0);
  EXPECT_TRUE(sim->high(2));
  lights.on(0);
  EXPECT_FALSE(sim->high(2));
  EXPECT_TRUE(sim->high(3));
  lights.off();
  EXPECT_TRUE(sim->high(2));
}

TEST_F(VmGpio, ChipIsFoundByNameLabelAndPath) {
  for (const std::string& chip : {sim->chip_name(), std::string(GpioSim::label), "/dev/" + sim->chip_name()}) {
    acquire::GpioLights lights(open({{chip, "LED5", 0, false}}), 0);
    lights.on(0);
    EXPECT_TRUE(sim->high(5)) << chip;
  }
  EXPECT_FALSE(sim->high(5));
}

TEST_F(VmGpio, WrongNamesAreSaid) {
  expect_error(ErrorCode::device, "GPIO chip \"nothing\": there is none; chips here: ", [&] { open({{"nothing", "", 0, false}}); });
  expect_error(ErrorCode::device, "no line named \"LED9\"", [&] { open({{GpioSim::label, "LED9", 0, false}}); });
  expect_error(ErrorCode::device, "line 8: the chip has lines 0..7", [&] { open({{GpioSim::label, "", 8, false}}); });
  expect_error(ErrorCode::device, "two lights are on this line", [&] { open({{GpioSim::label, "LED2", 0, false}, {GpioSim::label, "", 2, false}}); });
}

TEST_F(VmGpio, LineOfAnotherProgramIsLeftAlone) {
  const auto first = open({{GpioSim::label, "LED2", 0, false}});
  expect_error(ErrorCode::device, "taken by another program or driver (\"lacquer\")", [&] { open({{GpioSim::label, "LED2", 0, false}}); });
}

TEST_F(VmGpio, AreListed) {
  const auto chips = acquire::find_gpio_chips();
  const auto found = std::find_if(chips.begin(), chips.end(), [](const auto& c) { return c.label == GpioSim::label; });
  ASSERT_NE(found, chips.end());
  EXPECT_EQ(found->n_lines, 8u);
  EXPECT_EQ(found->named_lines, (std::vector<std::string>{"2 LED2", "3 LED3", "5 LED5"}));
}

TEST(VmTic, IsChosenBySerialNumberAmongSeveral) {
  if (!in_virtual_machine()) GTEST_SKIP() << "runs in the virtual machine (VirtualMachine.*)";
  const auto a = std::make_shared<TicModel>(acquire::Clock::steady()), b = std::make_shared<TicModel>(acquire::Clock::steady());
  UsbTicDevice first(a, "00000001", 0x00B5, 0), second(b, "00000002", 0x00CB, 1);
  expect_error(ErrorCode::device, "no Pololu Tic is connected", [&] { acquire::open_usb_tic(""); });
  first.plug_in();
  second.plug_in();
  for (int i = 0; i < 100 && acquire::find_usb_tics().size() < 2; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(100));
  const auto found = acquire::find_usb_tics();
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].product, "T834");
  EXPECT_EQ(found[1].product, "36v4");
  acquire::open_usb_tic("00000002")->control_out(0xE0, 7, 0);
  EXPECT_EQ(b->out_log(), std::vector<std::string>{"e0 v=0007 i=0000"});
  EXPECT_TRUE(a->out_log().empty());
  expect_error(ErrorCode::device, "2 Tics are connected (", [&] { acquire::open_usb_tic(""); });
  expect_error(ErrorCode::device, "no Tic has serial number 5; connected: ", [&] { acquire::open_usb_tic("5"); });
  expect_error(ErrorCode::device, "refused the request", [&] { acquire::open_usb_tic("00000001")->control_out(0x55, 0, 0); });
}

}  // namespace
}  // namespace lacquer::test
