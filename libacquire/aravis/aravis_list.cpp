#include <algorithm>

#include "libacquire/aravis/aravis_camera.h"
#include "libacquire/aravis/aravis_handles.h"

namespace lacquer::acquire {

namespace {

using namespace detail;

std::string text_or_empty(const char* text) { return text ? text : ""; }

void describe(FoundAravisCamera& found) {
  Failure failure(found.id);
  const GlibPtr<ArvCamera> camera(arv_camera_new(found.id.c_str(), failure.out()));
  failure.check("opening");
  if (!camera) throw Error(ErrorCode::device, found.id + ": cannot be opened");
  guint n = 0;
  const std::unique_ptr<const char*, GFree> formats(arv_camera_dup_available_pixel_formats_as_strings(camera.get(), &n, failure.out()));
  failure.check("listing pixel formats");
  for (guint i = 0; formats && i < n; ++i) found.pixel_formats.emplace_back(formats.get()[i]);
  arv_camera_get_sensor_size(camera.get(), &found.width, &found.height, failure.out());
  failure.check("reading the sensor's size");
  double min = 0, max = 0;
  arv_camera_get_exposure_time_bounds(camera.get(), &min, &max, failure.out());
  failure.check("reading the range of exposures");
  found.limits.min_exposure_s = min * 1e-6;
  found.limits.max_exposure_s = max * 1e-6;
}

}  // namespace

namespace detail {

GlibPtr<ArvCamera> open_device(const std::string& id) {
  Failure failure(id);
  if (!id.empty())
    if (GlibPtr<ArvCamera> camera(arv_camera_new(id.c_str(), failure.out())); camera && !failure) return camera;
  arv_update_device_list();
  std::string known;
  std::vector<std::string> matching;
  for (unsigned i = 0; i < arv_get_n_devices(); ++i) {
    const char* const device = arv_get_device_id(i);
    const char* const serial = arv_get_device_serial_nbr(i);
    known += (known.empty() ? "" : ", ") + std::string(device);
    if (id.empty() || id == device || (serial && id == serial)) matching.emplace_back(device);
  }
  if (matching.size() > 1) throw Error(ErrorCode::device, fmt::format("several cameras are connected ({}); devices.camera.id must say which", known));
  if (matching.empty()) {
    if (known.empty()) throw Error(ErrorCode::device, fmt::format("no GigE Vision or USB3 Vision camera{}; check cable, power and network settings",
                                                                  id.empty() ? " is connected" : " \"" + id + "\"; none is connected"));
    throw Error(ErrorCode::device, fmt::format("no camera \"{}\"; connected: {} (devices.camera.id)", id, known));
  }
  Failure opening(matching.front());
  GlibPtr<ArvCamera> camera(arv_camera_new(matching.front().c_str(), opening.out()));
  opening.check("opening");
  if (!camera) throw Error(ErrorCode::device, matching.front() + ": cannot be opened");
  return camera;
}

}  // namespace detail

std::vector<FoundAravisCamera> find_aravis_cameras() {
  std::vector<FoundAravisCamera> result;
  arv_update_device_list();
  for (unsigned i = 0; i < arv_get_n_devices(); ++i) {
    FoundAravisCamera found;
    found.id = text_or_empty(arv_get_device_id(i));
    found.vendor = text_or_empty(arv_get_device_vendor(i));
    found.model = text_or_empty(arv_get_device_model(i));
    found.serial = text_or_empty(arv_get_device_serial_nbr(i));
    found.address = text_or_empty(arv_get_device_address(i));
    found.protocol = text_or_empty(arv_get_device_protocol(i));
    result.push_back(std::move(found));
  }
  std::sort(result.begin(), result.end(), [](const auto& a, const auto& b) { return a.id < b.id; });
  for (FoundAravisCamera& found : result) {
    try {
      describe(found);
    } catch (const Error& e) {
      found.problem = e.what();
    }
  }
  return result;
}

}  // namespace lacquer::acquire
