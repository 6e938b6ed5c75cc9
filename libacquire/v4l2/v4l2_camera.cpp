#include "libacquire/v4l2/v4l2_camera.h"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <utility>

#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

constexpr std::uint32_t n_buffers = 4;
constexpr int max_damaged = 5;
constexpr double control_unit_s = 1e-4;  ///< of V4L2_CID_EXPOSURE_ABSOLUTE

}  // namespace

V4l2Camera::V4l2Camera(std::unique_ptr<VideoDevice> device, const CameraDeviceSettings& settings, Clock& clock)
    : device_(std::move(device)), settings_(settings), clock_(clock), name_(device_->path()) {
  check_capabilities();
  set_format();
  set_lowest_frame_rate();
  switch_automatics_off();
  read_limits();
  request_buffers();
}

V4l2Camera::~V4l2Camera() {
  if (!streaming_) return;
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  device_->control(VIDIOC_STREAMOFF, &type);  // gone or not, there is nothing more to do
}

std::string V4l2Camera::warning() const {
  if (!format_.processed()) return {};
  return fmt::format("{}: {} pictures are processed in the camera ({}): use response = \"estimate\", expect errors of per cent, and prefer a camera with raw formats", name_,
                     fourcc_text(format_.fourcc), format_.kind == V4l2Format::Kind::mjpeg ? "compressed, with an unknown response curve" : "8 bit, colour shared by two pixels");
}

void V4l2Camera::fail(int error, const std::string& doing) const {
  const char* const why = error == ENODEV || error == ENXIO ? "the camera was unplugged" : error == EBUSY ? "another program uses the camera" : std::strerror(error);
  throw Error(error == ETIMEDOUT ? ErrorCode::timeout : ErrorCode::device, fmt::format("{}: {}: {}", name_, doing, why));
}

void V4l2Camera::call(unsigned long request, void* argument, const char* doing) {
  if (const int error = device_->control(request, argument); error != 0) fail(error, doing);
}

void V4l2Camera::request_buffers() {
  v4l2_requestbuffers request{};
  request.count = n_buffers;
  request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  request.memory = V4L2_MEMORY_MMAP;
  call(VIDIOC_REQBUFS, &request, "asking for buffers");
  if (request.count < 2 || request.count > 32) throw Error(ErrorCode::device, fmt::format("{}: {} buffers; expected 2 to 32", name_, request.count));
  for (std::uint32_t i = 0; i < request.count; ++i) {
    v4l2_buffer buffer{};
    buffer.index = i;
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    call(VIDIOC_QUERYBUF, &buffer, "asking for a buffer");
    const std::uint8_t* const memory = device_->map(buffer.length, buffer.m.offset);
    if (!memory) throw Error(ErrorCode::device, fmt::format("{}: a buffer of {} bytes cannot be mapped", name_, buffer.length));
    buffers_.emplace_back(memory, buffer.length);
  }
}

void V4l2Camera::stream(bool on) {
  if (on)
    for (std::uint32_t i = 0; i < buffers_.size(); ++i) give_back(i);
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  call(on ? VIDIOC_STREAMON : VIDIOC_STREAMOFF, &type, on ? "starting the stream" : "stopping the stream");
  streaming_ = on;
}

void V4l2Camera::give_back(std::uint32_t index) {
  v4l2_buffer buffer{};
  buffer.index = index;
  buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  buffer.memory = V4L2_MEMORY_MMAP;
  call(VIDIOC_QBUF, &buffer, "returning a buffer");
}

/// Waits for a filled buffer. Throws Error{timeout} after exposure, interval and timeout_s.
V4l2Camera::Taken V4l2Camera::take(double exposure_s) {
  if (const int error = device_->wait(exposure_s + interval_s_ + settings_.timeout_s); error == ETIMEDOUT)
    throw Error(ErrorCode::timeout, fmt::format("{}: no frame within {:g} s of the exposure of {:g} s; unplug the camera and plug it in again", name_,
                                                interval_s_ + settings_.timeout_s, exposure_s));
  else if (error != 0)
    fail(error, "waiting for a frame");
  v4l2_buffer buffer{};
  buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  buffer.memory = V4L2_MEMORY_MMAP;
  call(VIDIOC_DQBUF, &buffer, "taking a frame");
  if (buffer.index >= buffers_.size()) throw Error(ErrorCode::device, fmt::format("{}: buffer {} of {}", name_, buffer.index, buffers_.size()));
  Taken taken;
  taken.index = buffer.index;
  taken.sequence = buffer.sequence;
  taken.n_bytes = static_cast<std::uint32_t>(std::min<std::size_t>(buffer.bytesused, buffers_[buffer.index].second));
  taken.damaged = buffer.flags & V4L2_BUF_FLAG_ERROR;
  // Drivers stamp the start of the exposure, its end or the arrival of the frame, whatever they claim: what counts is the earliest moment at
  // which its first line may have been exposed, one exposure and one readout before.
  if ((buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC)
    taken.exposure_began = static_cast<double>(buffer.timestamp.tv_sec) + 1e-6 * static_cast<double>(buffer.timestamp.tv_usec) - exposure_s - interval_s_;
  return taken;
}

void V4l2Camera::empty_queue() {
  for (std::size_t i = 0; i < buffers_.size(); ++i) {
    const int state = device_->wait(0);
    if (state == ETIMEDOUT) return;
    if (state != 0) fail(state, "emptying the queue");
    give_back(take(0).index);
  }
}

void V4l2Camera::set_exposure(double exposure_s) {
  if (!exposure_range_) {
    exposure_s_ = *settings_.fixed_exposure_s;
    return;
  }
  const auto [min, max, step, initial] = *exposure_range_;
  const double steps = std::round((exposure_s / control_unit_s - min) / step);
  const auto value = static_cast<std::int32_t>(std::clamp(min + steps * step, static_cast<double>(min), static_cast<double>(max)));
  set_control(V4L2_CID_EXPOSURE_ABSOLUTE, "exposure_time_absolute", value);
  const double actual = control_value(V4L2_CID_EXPOSURE_ABSOLUTE, "exposure_time_absolute") * control_unit_s;
  if (actual != exposure_s_) changed_ = true;
  exposure_s_ = actual;
}

RawFrame V4l2Camera::do_capture(const CaptureSettings& asked) {
  set_exposure(asked.exposure_s);
  if (!streaming_) stream(true);
  const double asked_at = clock_.now();
  empty_queue();
  int to_skip = changed_ ? settings_.settle_frames : 0;
  int n_untimed = static_cast<int>(buffers_.size());  // without time stamps: all that may have been filled before
  int n_damaged = 0;
  const double slowest = exposure_s_ + interval_s_;
  for (const double deadline = asked_at + (to_skip + n_untimed + max_damaged + 2) * slowest + settings_.timeout_s; clock_.now() < deadline;) {
    const Taken taken = take(exposure_s_);
    const bool old = taken.exposure_began ? *taken.exposure_began < asked_at : n_untimed-- > 0;
    if (old || last_sequence_ == taken.sequence || (!taken.damaged && to_skip-- > 0)) {
      give_back(taken.index);
      continue;
    }
    RawFrame frame{.width = settings_.width, .height = settings_.height, .layout = settings_.layout, .bits = settings_.bits, .data = {}, .actual = {}};
    auto values = taken.damaged ? std::nullopt
                                : decode(format_, {{buffers_[taken.index].first, taken.n_bytes}, stride_, full_range_}, settings_.width, settings_.height);
    give_back(taken.index);
    if (!values) {
      if (++n_damaged == max_damaged)
        throw Error(ErrorCode::device, fmt::format("{}: {} frames in a row were damaged or incomplete; try another cable or USB port", name_, max_damaged));
      continue;
    }
    last_sequence_ = taken.sequence;
    changed_ = false;
    frame.data = std::move(*values);
    frame.actual.exposure_s = exposure_range_ ? control_value(V4L2_CID_EXPOSURE_ABSOLUTE, "exposure_time_absolute") * control_unit_s : exposure_s_;
    if (frame.actual.exposure_s != exposure_s_)
      throw Error(ErrorCode::device, fmt::format("{}: the exposure changed by itself from {:g} to {:g} ms; an automatic of the camera is still on", name_, exposure_s_ * 1e3,
                                                 frame.actual.exposure_s * 1e3));
    return frame;
  }
  throw Error(ErrorCode::timeout, name_ + ": only old frames come; unplug the camera and plug it in again");
}

}  // namespace lacquer::acquire
