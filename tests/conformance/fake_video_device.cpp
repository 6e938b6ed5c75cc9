#include "conformance/fake_video_device.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>

namespace lacquer::test {

double FakeVideo::exposure_in_sensor() const {
  const auto found = controls.find(V4L2_CID_EXPOSURE_ABSOLUTE);
  return found == controls.end() ? 0.01 : found->second.value * 1e-4;
}

std::size_t FakeVideo::stride() const {
  if (fourcc == V4L2_PIX_FMT_GREY || fourcc == V4L2_PIX_FMT_SRGGB8) return width + extra_stride;
  if (fourcc == V4L2_PIX_FMT_Y10P) return width / 4 * 5 + extra_stride;
  if (fourcc == V4L2_PIX_FMT_MJPEG) return 0;
  return 2 * width + extra_stride;
}

void FakeVideo::expose_next() {
  exposures_on_their_way.push_back(exposure_in_sensor());
  while (exposures_on_their_way.size() > static_cast<std::size_t>(latency) + 1) exposures_on_their_way.pop_front();
  exposing = sensor(fourcc, width, height, stride(), exposures_on_their_way.front());
  next_frame_at += std::max(interval_s, exposures_on_their_way.front());
}

/// The frames that end until `time`.
void FakeVideo::run_to(double time) {
  while (streaming && !dead && next_frame_at <= time) {
    if (!empty.empty()) {
      const std::uint32_t i = empty.front();
      empty.pop_front();
      auto& bytes = exposing;
      if (n_damaged > 0) std::fill(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(bytes.size() / 2), std::uint8_t{0});
      std::copy(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(std::min(bytes.size(), memory[i].size())), memory[i].begin());
      used[i] = static_cast<std::uint32_t>(bytes.size() - std::min(bytes.size(), lost_bytes));
      flags[i] = (monotonic ? V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC : V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN) | (n_damaged > 0 ? V4L2_BUF_FLAG_ERROR : 0);
      n_damaged = std::max(n_damaged - 1, 0);
      stamp[i] = next_frame_at;
      sequence[i] = n_frames;
      filled.push_back(i);
    }
    ++n_frames;
    expose_next();
  }
}

FakeVideoDevice::~FakeVideoDevice() {
  video_->streaming = false;
  video_->busy = false;
}

int FakeVideoDevice::control(unsigned long request, void* argument) {
  if (video_->unplugged) return ENODEV;
  video_->run_to(video_->clock.now());
  return handle(request, argument);
}

int FakeVideoDevice::handle(unsigned long request, void* argument) {
  switch (request) {
    case VIDIOC_QUERYCAP: {
      auto& c = *static_cast<v4l2_capability*>(argument);
      std::memcpy(c.card, "Fake webcam", 12);
      c.capabilities = V4L2_CAP_DEVICE_CAPS | V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING | V4L2_CAP_META_CAPTURE;
      c.device_caps = video_->capabilities ? video_->capabilities : V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
      return 0;
    }
    case VIDIOC_ENUM_FMT:
    case VIDIOC_S_FMT:
    case VIDIOC_ENUM_FRAMEINTERVALS:
    case VIDIOC_S_PARM: return handle_format(request, argument);
    case VIDIOC_QUERYCTRL:
    case VIDIOC_G_CTRL:
    case VIDIOC_S_CTRL: return handle_control(request, argument);
    default: return handle_buffer(request, argument);
  }
}

int FakeVideoDevice::handle_format(unsigned long request, void* argument) {
  FakeVideo& v = *video_;
  if (request == VIDIOC_ENUM_FMT) {
    auto& d = *static_cast<v4l2_fmtdesc*>(argument);
    if (d.index >= v.fourccs.size()) return EINVAL;
    d.pixelformat = v.fourccs[d.index];
  } else if (request == VIDIOC_S_FMT) {
    if (v.busy) return EBUSY;
    auto& pix = static_cast<v4l2_format*>(argument)->fmt.pix;
    pix.width = v.width;
    pix.height = v.height;
    v.fourcc = pix.pixelformat;
    pix.bytesperline = static_cast<std::uint32_t>(v.stride());
    pix.sizeimage = v.fourcc == V4L2_PIX_FMT_MJPEG ? 100000 : pix.bytesperline * v.height;
    pix.field = V4L2_FIELD_NONE;
    pix.quantization = v.quantization;
  } else if (request == VIDIOC_ENUM_FRAMEINTERVALS) {
    auto& i = *static_cast<v4l2_frmivalenum*>(argument);
    if (i.index >= 3) return EINVAL;
    i.type = V4L2_FRMIVAL_TYPE_DISCRETE;
    i.discrete = {1, std::array{30u, 5u, 15u}[i.index]};
  } else {
    const auto& t = static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe;
    v.interval_s = static_cast<double>(t.numerator) / t.denominator;
  }
  return 0;
}

int FakeVideoDevice::handle_control(unsigned long request, void* argument) {
  const std::uint32_t id = request == VIDIOC_QUERYCTRL ? static_cast<v4l2_queryctrl*>(argument)->id : static_cast<v4l2_control*>(argument)->id;
  const auto found = video_->controls.find(id);
  if (found == video_->controls.end()) return EINVAL;
  FakeVideo::Control& c = found->second;
  if (request == VIDIOC_QUERYCTRL) {
    auto& q = *static_cast<v4l2_queryctrl*>(argument);
    q.minimum = c.min;
    q.maximum = c.max;
    q.step = c.step;
    q.flags = 0;
    return 0;
  }
  auto& value = static_cast<v4l2_control*>(argument)->value;
  if (request == VIDIOC_G_CTRL) {
    value = c.value;
    return 0;
  }
  if (value < c.min || value > c.max) return ERANGE;
  if (c.sticks) c.value = value - (value - c.min) % c.step;
  return 0;
}

int FakeVideoDevice::handle_buffer(unsigned long request, void* argument) {
  FakeVideo& v = *video_;
  auto& b = *static_cast<v4l2_buffer*>(argument);
  switch (request) {
    case VIDIOC_REQBUFS: {
      auto& r = *static_cast<v4l2_requestbuffers*>(argument);
      const std::size_t size = v.fourcc == V4L2_PIX_FMT_MJPEG ? 100000 : v.stride() * v.height;
      v.memory.assign(r.count, std::vector<std::uint8_t>(size));
      v.used.assign(r.count, 0);
      v.flags.assign(r.count, 0);
      v.sequence.assign(r.count, 0);
      v.stamp.assign(r.count, 0);
      v.empty.clear();
      v.filled.clear();
      return 0;
    }
    case VIDIOC_QUERYBUF:
      b.length = static_cast<std::uint32_t>(v.memory.at(b.index).size());
      b.m.offset = b.index;
      return 0;
    case VIDIOC_QBUF: v.empty.push_back(b.index); return 0;
    case VIDIOC_DQBUF:
      if (v.filled.empty()) return EAGAIN;
      b.index = v.filled.front();
      v.filled.pop_front();
      b.bytesused = v.used[b.index];
      b.flags = v.flags[b.index];
      b.sequence = v.sequence[b.index];
      b.timestamp.tv_sec = static_cast<long>(v.stamp[b.index]);
      b.timestamp.tv_usec = static_cast<long>((v.stamp[b.index] - std::floor(v.stamp[b.index])) * 1e6);
      return 0;
    case VIDIOC_STREAMON:
      v.streaming = true;
      v.next_frame_at = v.clock.now();
      v.exposures_on_their_way.clear();
      v.expose_next();
      return 0;
    case VIDIOC_STREAMOFF:
      v.streaming = false;
      v.empty.clear();
      v.filled.clear();
      return 0;
    default: return ENOTTY;
  }
}

const std::uint8_t* FakeVideoDevice::map(std::size_t, std::int64_t offset) { return video_->memory.at(static_cast<std::size_t>(offset)).data(); }

int FakeVideoDevice::wait(double seconds) {
  FakeVideo& v = *video_;
  if (v.unplugged) return ENODEV;
  v.run_to(v.clock.now());
  if (!v.filled.empty()) return 0;
  const double end = v.clock.now() + seconds;
  if (v.streaming && !v.dead && !v.empty.empty() && v.next_frame_at <= end) {
    v.clock.sleep(v.next_frame_at - v.clock.now());
    v.run_to(v.clock.now());
    return 0;
  }
  v.clock.sleep(seconds);
  return ETIMEDOUT;
}

}  // namespace lacquer::test
