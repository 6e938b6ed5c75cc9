#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <utility>

#include "libacquire/v4l2/v4l2_camera.h"
#include "libbrdf/error.h"

/// What is done once, before the first frame: format, rate, controls.
namespace lacquer::acquire {

namespace {

constexpr double control_unit_s = 1e-4;
constexpr std::uint32_t max_image_bytes = 1u << 30;

std::string text_of(const std::uint8_t* text, std::size_t size) {
  const auto* const chars = reinterpret_cast<const char*>(text);
  return {chars, strnlen(chars, size)};
}

}  // namespace

void V4l2Camera::check_capabilities() {
  v4l2_capability c{};
  if (device_->control(VIDIOC_QUERYCAP, &c) != 0) throw Error(ErrorCode::device, name_ + ": is not a camera");
  const std::uint32_t can = c.capabilities & V4L2_CAP_DEVICE_CAPS ? c.device_caps : c.capabilities;
  if (!(can & V4L2_CAP_VIDEO_CAPTURE) || !(can & V4L2_CAP_STREAMING))
    throw Error(ErrorCode::device, name_ + ": does not stream pictures (a camera often has a second device file for its metadata: take the other)");
  name_ = fmt::format("{} ({})", text_of(c.card, sizeof(c.card)), device_->path());
}

void V4l2Camera::set_format() {
  const auto wanted = v4l2_formats(settings_.layout, settings_.bits, settings_.pixel_format);
  std::vector<std::uint32_t> offered;
  std::string list;
  for (v4l2_fmtdesc d{}; offered.size() < 1000; ++d.index) {
    d.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (device_->control(VIDIOC_ENUM_FMT, &d) != 0) break;
    offered.push_back(d.pixelformat);
    list += (list.empty() ? "\"" : ", \"") + fourcc_text(d.pixelformat) + "\"";
  }
  const auto found = std::find_if(wanted.begin(), wanted.end(), [&](const V4l2Format& f) { return std::find(offered.begin(), offered.end(), f.fourcc) != offered.end(); });
  if (found == wanted.end())
    throw Error(ErrorCode::usage, fmt::format("{}: no pixel format {}for camera.layout \"{}\" and camera.bits {}; the camera offers {}", name_,
                                              settings_.pixel_format.empty() ? "" : "\"" + settings_.pixel_format + "\" ", name_of(settings_.layout), settings_.bits,
                                              list.empty() ? "none" : list));
  format_ = *found;
  v4l2_format f{};
  f.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  f.fmt.pix.width = static_cast<std::uint32_t>(settings_.width);
  f.fmt.pix.height = static_cast<std::uint32_t>(settings_.height);
  f.fmt.pix.pixelformat = format_.fourcc;
  f.fmt.pix.field = V4L2_FIELD_NONE;
  call(VIDIOC_S_FMT, &f, "setting the pixel format");
  const v4l2_pix_format& pix = f.fmt.pix;
  if (pix.width != static_cast<std::uint32_t>(settings_.width) || pix.height != static_cast<std::uint32_t>(settings_.height) || pix.pixelformat != format_.fourcc)
    throw Error(ErrorCode::usage, fmt::format("{}: camera.width_px, height_px: {} x {} in {}; the camera does {} x {} in {}", name_, settings_.width, settings_.height,
                                              fourcc_text(format_.fourcc), pix.width, pix.height, fourcc_text(pix.pixelformat)));
  if (pix.field != V4L2_FIELD_NONE && pix.field != V4L2_FIELD_ANY)
    throw Error(ErrorCode::device, name_ + ": delivers interlaced pictures; this program takes whole ones");
  stride_ = pix.bytesperline;
  if (pix.sizeimage == 0 || pix.sizeimage > max_image_bytes) throw Error(ErrorCode::device, fmt::format("{}: a picture has {} bytes", name_, pix.sizeimage));
  if (stride_ == 0)  // some drivers leave it out
    stride_ = format_.kind == V4l2Format::Kind::yuyv ? 2 * static_cast<std::size_t>(settings_.width) : packed_bytes(format_.packing, static_cast<std::size_t>(settings_.width));
  full_range_ = pix.quantization == V4L2_QUANTIZATION_FULL_RANGE;
}

/// A webcam that delivers 30 frames a second does not expose for longer than a 30th of one, whatever it is told.
void V4l2Camera::set_lowest_frame_rate() {
  const auto seconds = [](const v4l2_fract& f) { return f.denominator == 0 ? 0.0 : static_cast<double>(f.numerator) / f.denominator; };
  v4l2_fract longest{0, 1};
  for (v4l2_frmivalenum interval{}; interval.index < 1000; ++interval.index) {
    interval.pixel_format = format_.fourcc;
    interval.width = static_cast<std::uint32_t>(settings_.width);
    interval.height = static_cast<std::uint32_t>(settings_.height);
    if (device_->control(VIDIOC_ENUM_FRAMEINTERVALS, &interval) != 0) break;
    const bool discrete = interval.type == V4L2_FRMIVAL_TYPE_DISCRETE;
    v4l2_fract f = discrete ? interval.discrete : interval.stepwise.max;
    // A stepwise range may go down to a frame in minutes, and every frame that is thrown away would last as long.
    if (!discrete && seconds(f) > 0.2) f = {1, 5};
    if (seconds(f) > seconds(longest)) longest = f;
    if (!discrete) break;
  }
  if (seconds(longest) == 0) return;
  v4l2_streamparm p{};
  p.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  p.parm.capture.timeperframe = longest;
  if (device_->control(VIDIOC_S_PARM, &p) != 0) return;  // a camera with one rate refuses; it has that
  interval_s_ = std::clamp(seconds(p.parm.capture.timeperframe), interval_s_, 10.0);
}

std::optional<V4l2Camera::ControlRange> V4l2Camera::control_range(std::uint32_t id) {
  v4l2_queryctrl q{};
  q.id = id;
  if (device_->control(VIDIOC_QUERYCTRL, &q) != 0 || q.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_READ_ONLY)) return std::nullopt;
  return ControlRange{q.minimum, q.maximum, std::max(q.step, 1), q.default_value};
}

std::int32_t V4l2Camera::control_value(std::uint32_t id, const char* name) {
  v4l2_control c{};
  c.id = id;
  call(VIDIOC_G_CTRL, &c, fmt::format("reading the control {}", name).c_str());
  return c.value;
}

void V4l2Camera::set_control(std::uint32_t id, const char* name, std::int32_t value) {
  v4l2_control c{};
  c.id = id;
  c.value = value;
  call(VIDIOC_S_CTRL, &c, fmt::format("setting the control {}", name).c_str());
}

void V4l2Camera::switch_automatics_off() {
  struct Automatic {
    std::uint32_t id;
    const char* name;
    std::int32_t off;
  };
  for (const auto& [id, name, off] : {Automatic{V4L2_CID_EXPOSURE_AUTO, "auto_exposure", V4L2_EXPOSURE_MANUAL}, Automatic{V4L2_CID_AUTOGAIN, "gain_automatic", 0},
                                      Automatic{V4L2_CID_AUTO_WHITE_BALANCE, "white_balance_automatic", 0}, Automatic{V4L2_CID_AUTOBRIGHTNESS, "brightness_automatic", 0},
                                      Automatic{V4L2_CID_HUE_AUTO, "hue_automatic", 0}, Automatic{V4L2_CID_BACKLIGHT_COMPENSATION, "backlight_compensation", 0},
                                      Automatic{V4L2_CID_WIDE_DYNAMIC_RANGE, "wide_dynamic_range", 0}, Automatic{V4L2_CID_FOCUS_AUTO, "focus_automatic_continuous", 0},
                                      Automatic{V4L2_CID_HFLIP, "horizontal_flip", 0}, Automatic{V4L2_CID_VFLIP, "vertical_flip", 0}}) {
    if (!control_range(id)) continue;
    set_control(id, name, off);
    if (const std::int32_t actual = control_value(id, name); actual != off)
      throw Error(ErrorCode::device, fmt::format("{}: {} cannot be switched off (read back as {}, set was {})", name_, name, actual, off));
  }
}

void V4l2Camera::read_limits() {
  exposure_range_ = control_range(V4L2_CID_EXPOSURE_ABSOLUTE);
  if (exposure_range_ && settings_.fixed_exposure_s)
    throw Error(ErrorCode::usage, name_ + ": devices.camera.fixed_exposure_ms: the exposure of this camera can be set; leave the key out");
  if (!exposure_range_ && !settings_.fixed_exposure_s)
    throw Error(ErrorCode::device, name_ + ": has no control exposure_time_absolute; a camera without manual exposure cannot measure (for one whose exposure is known and "
                                           "constant: devices.camera.fixed_exposure_ms)");
  limits_.min_exposure_s = exposure_range_ ? std::max(exposure_range_->min, 1) * control_unit_s : *settings_.fixed_exposure_s;
  limits_.max_exposure_s = exposure_range_ ? exposure_range_->max * control_unit_s : *settings_.fixed_exposure_s;
  limits_.min_gain_db = limits_.max_gain_db = 0;
  const auto gain_range = control_range(V4L2_CID_GAIN);
  if (!gain_range) {
    if (settings_.gain) throw Error(ErrorCode::usage, name_ + ": devices.camera.gain: the camera has no control gain");
    return;
  }
  const double gain = settings_.gain.value_or(gain_range->min);
  if (!(gain >= gain_range->min && gain <= gain_range->max) || gain != std::floor(gain))
    throw Error(ErrorCode::usage, fmt::format("{}: devices.camera.gain: expected a whole number from {} to {}, got {:g}", name_, gain_range->min, gain_range->max, gain));
  set_control(V4L2_CID_GAIN, "gain", static_cast<std::int32_t>(gain));
  if (const std::int32_t actual = control_value(V4L2_CID_GAIN, "gain"); actual != static_cast<std::int32_t>(gain))
    throw Error(ErrorCode::device, fmt::format("{}: gain read back as {}, set was {:g}", name_, actual, gain));
}

}  // namespace lacquer::acquire
