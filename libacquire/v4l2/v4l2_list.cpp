#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <utility>

#include "libacquire/v4l2/v4l2_camera.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

std::string text_of(const std::uint8_t* text, std::size_t size) {
  const auto* const chars = reinterpret_cast<const char*>(text);
  return {chars, strnlen(chars, size)};
}

std::vector<std::string> formats_of(VideoDevice& device) {
  std::vector<std::string> result;
  for (v4l2_fmtdesc d{}; d.index < 1000; ++d.index) {
    d.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (device.control(VIDIOC_ENUM_FMT, &d) != 0) break;
    std::string text = fourcc_text(d.pixelformat), sizes;
    for (v4l2_frmsizeenum s{}; s.index < 100; ++s.index) {
      s.pixel_format = d.pixelformat;
      if (device.control(VIDIOC_ENUM_FRAMESIZES, &s) != 0) break;
      const bool discrete = s.type == V4L2_FRMSIZE_TYPE_DISCRETE;
      sizes += (sizes.empty() ? " " : ", ") + (discrete ? fmt::format("{}x{}", s.discrete.width, s.discrete.height)
                                                       : fmt::format("up to {}x{}", s.stepwise.max_width, s.stepwise.max_height));
      if (!discrete) break;
    }
    result.push_back(text + sizes);
  }
  return result;
}

/// nullopt: not a camera (metadata, output, radio).
std::optional<FoundV4l2Camera> describe(const std::string& path) {
  FoundV4l2Camera found;
  found.path = path;
  try {
    const auto device = open_video_device(path);
    v4l2_capability c{};
    if (device->control(VIDIOC_QUERYCAP, &c) != 0) return std::nullopt;
    const std::uint32_t can = c.capabilities & V4L2_CAP_DEVICE_CAPS ? c.device_caps : c.capabilities;
    if (!(can & V4L2_CAP_VIDEO_CAPTURE) || !(can & V4L2_CAP_STREAMING)) return std::nullopt;
    found.card = text_of(c.card, sizeof(c.card));
    found.bus = text_of(c.bus_info, sizeof(c.bus_info));
    found.pixel_formats = formats_of(*device);
    v4l2_queryctrl q{};
    q.id = V4L2_CID_EXPOSURE_ABSOLUTE;
    if (device->control(VIDIOC_QUERYCTRL, &q) == 0 && !(q.flags & V4L2_CTRL_FLAG_DISABLED))
      found.limits = CameraLimits{.min_exposure_s = std::max(q.minimum, 1) * 1e-4, .max_exposure_s = q.maximum * 1e-4, .min_gain_db = 0, .max_gain_db = 0};
  } catch (const Error& e) {
    found.problem = e.what();
  }
  return found;
}

}  // namespace

std::vector<FoundV4l2Camera> find_v4l2_cameras() {
  std::vector<std::string> paths;
  std::error_code status;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", status))
    if (entry.path().filename().string().starts_with("video")) paths.push_back(entry.path().string());
  std::sort(paths.begin(), paths.end(), [](const auto& a, const auto& b) { return std::pair(a.size(), a) < std::pair(b.size(), b); });  // video2 before video10
  std::vector<FoundV4l2Camera> result;
  for (const std::string& path : paths)
    if (auto found = describe(path)) result.push_back(std::move(*found));
  return result;
}

std::unique_ptr<Camera> open_v4l2_camera(const CameraDeviceSettings& settings) {
  std::string path = settings.id;
  if (path.empty() || path.front() != '/') {
    std::vector<FoundV4l2Camera> found = find_v4l2_cameras();
    std::string known;
    for (const auto& c : found) known += fmt::format("{}{} ({}, {})", known.empty() ? "" : "; ", c.path, c.card, c.bus);
    std::erase_if(found, [&](const auto& c) { return !path.empty() && path != c.card && path != c.bus; });
    if (found.size() > 1) throw Error(ErrorCode::device, fmt::format("several Video4Linux cameras match ({}); devices.camera.id must say which", known));
    if (found.empty())
      throw Error(ErrorCode::device, known.empty() ? "no Video4Linux camera is connected" : fmt::format("no camera \"{}\"; connected: {} (devices.camera.id)", path, known));
    path = found.front().path;
  }
  return std::make_unique<V4l2Camera>(open_video_device(path), settings);
}

}  // namespace lacquer::acquire
