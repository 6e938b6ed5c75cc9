#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgcodecs.hpp>

#include "conformance/expect_error.h"
#include "conformance/fake_video_device.h"
#include "libacquire/v4l2/v4l2_camera.h"

namespace lacquer::test {
namespace {

using acquire::PixelLayout;

class V4l2 : public testing::Test {
 protected:
  V4l2() {
    video->fourccs = {V4L2_PIX_FMT_MJPEG, V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_GREY};
    video->controls = {{V4L2_CID_EXPOSURE_ABSOLUTE, {1, 10000, 1, 156}}, {V4L2_CID_EXPOSURE_AUTO, {0, 3, 1, 3}}, {V4L2_CID_GAIN, {0, 100, 1, 50}}};
    // Every byte is the exposure time in milliseconds.
    video->sensor = [](std::uint32_t, std::uint32_t, std::uint32_t height, std::size_t stride, double exposure_s) {
      return std::vector<std::uint8_t>(height * stride, static_cast<std::uint8_t>(std::lround(exposure_s * 1e3)));
    };
    settings.width = 32;
    settings.height = 8;
    settings.bits = 8;
  }
  std::unique_ptr<acquire::V4l2Camera> open() { return std::make_unique<acquire::V4l2Camera>(std::make_unique<FakeVideoDevice>(video), settings, video->clock); }
  int value_of(std::uint32_t control) const { return video->controls.at(control).value; }

  std::shared_ptr<FakeVideo> video = std::make_shared<FakeVideo>();
  acquire::CameraDeviceSettings settings;
};

TEST_F(V4l2, TakesTheRawFormatAndLeavesProcessedOnesAlone) {
  const auto camera = open();
  EXPECT_EQ(video->fourcc, V4L2_PIX_FMT_GREY);
  EXPECT_EQ(camera->warning(), "");
}

TEST_F(V4l2, SwitchesAutomaticsOffAndFixesTheGain) {
  settings.gain = 7;
  open();
  EXPECT_EQ(value_of(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
  EXPECT_EQ(value_of(V4L2_CID_GAIN), 7);
  settings.gain.reset();
  open();
  EXPECT_EQ(value_of(V4L2_CID_GAIN), 0);
}

TEST_F(V4l2, AutomaticThatStaysOnIsNamed) {
  video->controls[V4L2_CID_AUTOGAIN] = {0, 1, 1, 1, false};
  expect_error(ErrorCode::device, "gain_automatic cannot be switched off (read back as 1", [&] { open(); });
}

TEST_F(V4l2, MissingExposureControlIsNamed) {
  video->controls.erase(V4L2_CID_EXPOSURE_ABSOLUTE);
  expect_error(ErrorCode::device, "no control exposure_time_absolute", [&] { open(); });
  settings.fixed_exposure_s = 0.01;
  const auto camera = open();
  EXPECT_EQ(camera->capture({0.01, 0}).actual.exposure_s, 0.01);
  expect_error(ErrorCode::usage, "the camera takes 10 to 10 ms", [&] { camera->capture({0.02, 0}); });
}

TEST_F(V4l2, FramesThatWaitedInTheQueueAreNeverDelivered) {
  const auto camera = open();
  EXPECT_EQ(camera->capture({0.010, 0}).data[0], 10);
  video->clock.sleep(60);  // the queue is full of old frames
  EXPECT_EQ(camera->capture({0.050, 0}).data[0], 50);
  double light = 1;
  video->sensor = [&](std::uint32_t, std::uint32_t, std::uint32_t height, std::size_t stride, double) {
    return std::vector<std::uint8_t>(height * stride, static_cast<std::uint8_t>(light));
  };
  for (int i = 2; i < 20; ++i) {
    video->clock.sleep(0.013 * i);
    video->run_to(video->clock.now());  // what is being exposed now began before the change
    light = i;
    EXPECT_EQ(camera->capture({0.050, 0}).data[0], i);
  }
}

TEST_F(V4l2, FramesOfTheOldExposureOnTheirWayAreThrownAway) {
  for (const bool monotonic : {true, false}) {
    video->monotonic = monotonic;
    for (int latency = 0; latency <= 2; ++latency) {
      video->latency = latency;
      const auto camera = open();
      for (const double ms : {10.0, 90.0, 11.0, 50.0}) EXPECT_EQ(camera->capture({ms * 1e-3, 0}).data[0], ms) << latency;
    }
  }
}

TEST_F(V4l2, LowestFrameRateLeavesRoomForLongExposures) {
  open();
  EXPECT_NEAR(video->interval_s, 0.2, 1e-12);
}

TEST_F(V4l2, ExposureIsRoundedToStepsAndReadBack) {
  video->controls[V4L2_CID_EXPOSURE_ABSOLUTE].step = 5;
  const auto camera = open();
  EXPECT_NEAR(camera->capture({0.0123, 0}).actual.exposure_s, 0.0121, 1e-12);  // 1 + 24 * 5 = 121 hundred microseconds; 123 asked
  EXPECT_NEAR(camera->limits().min_exposure_s, 1e-4, 1e-12);
  EXPECT_NEAR(camera->limits().max_exposure_s, 1, 1e-12);
}

TEST_F(V4l2, ExposureThatChangesByItselfIsFound) {
  const auto camera = open();
  video->sensor = [&](std::uint32_t, std::uint32_t, std::uint32_t height, std::size_t stride, double) {
    video->controls[V4L2_CID_EXPOSURE_ABSOLUTE].value = 333;
    return std::vector<std::uint8_t>(height * stride);
  };
  expect_error(ErrorCode::device, "the exposure changed by itself from 10 to 33.3 ms", [&] { camera->capture({0.01, 0}); });
}

TEST_F(V4l2, DamagedAndShortFramesAreLeftOutUpToALimit) {
  const auto camera = open();
  camera->capture({0.01, 0});
  video->n_damaged = 4;
  EXPECT_EQ(camera->capture({0.01, 0}).data[0], 10);
  video->lost_bytes = 1;
  expect_error(ErrorCode::device, "5 frames in a row were damaged or incomplete", [&] { camera->capture({0.01, 0}); });
  video->lost_bytes = 0;
  EXPECT_EQ(camera->capture({0.02, 0}).data[0], 20);
}

TEST_F(V4l2, DeadCameraIsATimeout) {
  const auto camera = open();
  camera->capture({0.01, 0});
  video->dead = true;
  expect_error(ErrorCode::timeout, "no frame within", [&] { camera->capture({0.01, 0}); });
  EXPECT_LT(video->clock.now(), 10);
}

TEST_F(V4l2, UnpluggedAtAnyMomentIsOneError) {
  class CountingDevice final : public acquire::VideoDevice {
   public:
    CountingDevice(std::shared_ptr<FakeVideo> video, int at) : video_(video), inner_(std::move(video)), left_(at) {}
    int control(unsigned long request, void* argument) override { return count(), inner_.control(request, argument); }
    const std::uint8_t* map(std::size_t length, std::int64_t offset) override { return inner_.map(length, offset); }
    int wait(double seconds) override { return count(), inner_.wait(seconds); }
    std::string path() const override { return inner_.path(); }

   private:
    void count() {
      if (left_-- == 0) video_->unplugged = true;
    }
    std::shared_ptr<FakeVideo> video_;
    FakeVideoDevice inner_;
    int left_;
  };
  int k = 0;
  for (bool went_through = false; !went_through; ++k) {
    video->unplugged = false;
    try {
      acquire::V4l2Camera camera(std::make_unique<CountingDevice>(video, k), settings, video->clock);
      camera.capture({0.01, 0});
      camera.capture({0.02, 0});
      went_through = !video->unplugged;
    } catch (const Error& e) {
      EXPECT_TRUE(e.code() == ErrorCode::device || e.code() == ErrorCode::usage) << e.what();
      EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos);
    }
    ASSERT_LT(k, 1000);
  }
  EXPECT_GT(k, 60);  // the loop met all of opening and two captures
}

TEST_F(V4l2, WhatTheCameraCannotDoIsSaidByName) {
  const auto refused = [&](ErrorCode code, const std::string& part, const auto& spoil) {
    const auto keep = settings;
    const auto keep_video = *video;
    spoil();
    expect_error(code, part, [&] { open(); });
    settings = keep;
    *video = keep_video;
  };
  refused(ErrorCode::usage, "for camera.layout \"mono\" and camera.bits 12; the camera offers \"MJPG\", \"YUYV\", \"GREY\"", [&] { settings.bits = 12; });
  refused(ErrorCode::usage, "no pixel format \"Y16\"", [&] { settings.pixel_format = "Y16"; });
  refused(ErrorCode::usage, "64 x 8 in GREY; the camera does 32 x 8", [&] { settings.width = 64; });
  refused(ErrorCode::usage, "gain: expected a whole number from 0 to 100", [&] { settings.gain = 101; });
  refused(ErrorCode::usage, "gain: expected a whole number", [&] { settings.gain = 0.5; });
  refused(ErrorCode::usage, "the exposure of this camera can be set", [&] { settings.fixed_exposure_s = 0.1; });
  refused(ErrorCode::device, "does not stream pictures", [&] { video->capabilities = V4L2_CAP_META_CAPTURE; });
  refused(ErrorCode::device, "another program uses the camera", [&] { video->busy = true; });
}

TEST_F(V4l2, LinesMayBeLongerThanTheirPixels) {
  video->extra_stride = 12;
  video->sensor = [](std::uint32_t, std::uint32_t width, std::uint32_t height, std::size_t stride, double) {
    std::vector<std::uint8_t> bytes(height * stride, 255);
    for (std::size_t y = 0; y < height; ++y)
      for (std::size_t x = 0; x < width; ++x) bytes[y * stride + x] = static_cast<std::uint8_t>(10 * y + x % 10);
    return bytes;
  };
  const auto frame = open()->capture({0.01, 0});
  for (std::size_t y = 0; y < 8; ++y)
    for (std::size_t x = 0; x < 32; ++x) ASSERT_EQ(frame.data[y * 32 + x], 10 * y + x % 10);
}

TEST_F(V4l2, YuyvComesWithAWarningAndInTheRightColours) {
  video->fourccs = {V4L2_PIX_FMT_YUYV};
  settings.layout = PixelLayout::rgb;
  // BT.601, 8 bit, limited range; red, green, blue and white of full saturation (ITU-R BT.601, table of 100 % colour bars).
  const std::vector<std::array<int, 6>> bars = {{81, 90, 240, 255, 0, 0}, {145, 54, 34, 0, 255, 0}, {41, 240, 110, 0, 0, 255}, {235, 128, 128, 255, 255, 255}, {16, 128, 128, 0, 0, 0}};
  for (const auto& bar : bars) {
    video->sensor = [&](std::uint32_t, std::uint32_t, std::uint32_t height, std::size_t stride, double) {
      std::vector<std::uint8_t> bytes(height * stride);
      for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<std::uint8_t>(i % 2 == 0 ? bar[0] : i % 4 == 1 ? bar[1] : bar[2]);
      return bytes;
    };
    const auto camera = open();
    EXPECT_NE(camera->warning().find("YUYV pictures are processed in the camera"), std::string::npos);
    const auto frame = camera->capture({0.01, 0});
    ASSERT_EQ(frame.data.size(), 3u * 32 * 8);
    for (std::size_t i = 0; i < frame.data.size(); ++i) ASSERT_NEAR(frame.data[i], bar[3 + i % 3], 2);  // the bars' 8-bit YCbCr values are rounded
  }
  settings.layout = PixelLayout::mono;
  EXPECT_EQ(open()->capture({0.01, 0}).data[0], 16);  // the luma as it is
}

TEST_F(V4l2, MotionJpegIsTheLastResort) {
  video->fourccs = {V4L2_PIX_FMT_MJPEG};
  settings.layout = PixelLayout::rgb;
  std::vector<std::uint8_t> jpeg;
  cv::imencode(".jpg", cv::Mat(8, 32, CV_8UC3, cv::Scalar(30, 100, 200)), jpeg, {cv::IMWRITE_JPEG_QUALITY, 100});
  video->sensor = [&](std::uint32_t, std::uint32_t, std::uint32_t, std::size_t, double) { return jpeg; };
  const auto camera = open();
  EXPECT_NE(camera->warning().find("compressed"), std::string::npos);
  const auto frame = camera->capture({0.01, 0});
  EXPECT_NEAR(frame.data[0], 200, 2);
  EXPECT_NEAR(frame.data[2], 30, 2);
  settings.layout = PixelLayout::mono;
  EXPECT_NEAR(open()->capture({0.01, 0}).data[0], 0.299 * 200 + 0.587 * 100 + 0.114 * 30, 2);
}

TEST_F(V4l2, ForgedMotionJpegIsADamagedFrame) {
  video->fourccs = {V4L2_PIX_FMT_MJPEG};
  settings.layout = PixelLayout::rgb;
  std::vector<std::uint8_t> jpeg;
  cv::imencode(".jpg", cv::Mat(8, 16, CV_8UC3, cv::Scalar(30, 100, 200)), jpeg);
  for (const auto& bytes : {jpeg /* of another size */, std::vector<std::uint8_t>{}, std::vector<std::uint8_t>{0xFF, 0xD8}, std::vector<std::uint8_t>(1000, 0xFF)}) {
    video->sensor = [&](std::uint32_t, std::uint32_t, std::uint32_t, std::size_t, double) { return bytes; };
    const auto camera = open();
    expect_error(ErrorCode::device, "damaged or incomplete", [&] { camera->capture({0.01, 0}); });
  }
}

TEST(V4l2Formats, EveryRawFormatHasItsLayoutAndDepth) {
  for (const auto& [name, layout, bits] : std::vector<std::tuple<const char*, PixelLayout, int>>{
           {"GREY", PixelLayout::mono, 8}, {"Y10", PixelLayout::mono, 10}, {"Y12", PixelLayout::mono, 12}, {"Y16", PixelLayout::mono, 16},
           {"RGGB", PixelLayout::bayer_rggb, 8}, {"BG10", PixelLayout::bayer_bggr, 10}, {"GB12", PixelLayout::bayer_gbrg, 12}, {"GR16", PixelLayout::bayer_grbg, 16},
           {"BYR2", PixelLayout::bayer_bggr, 16}}) {
    const auto formats = acquire::v4l2_formats(layout, bits, name);
    ASSERT_EQ(formats.size(), 1u) << name;
    EXPECT_FALSE(formats[0].processed());
  }
  EXPECT_EQ(acquire::v4l2_formats(PixelLayout::mono, 8, "").front().fourcc, V4L2_PIX_FMT_GREY);
  EXPECT_EQ(acquire::v4l2_formats(PixelLayout::mono, 8, "").back().fourcc, V4L2_PIX_FMT_MJPEG);
  EXPECT_EQ(acquire::fourcc_text(V4L2_PIX_FMT_Y16_BE), "Y16 -BE");
}

}  // namespace
}  // namespace lacquer::test
