#include "libacquire/aravis/aravis_camera.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "libacquire/aravis/aravis_handles.h"
#include "libacquire/aravis/genicam_formats.h"

namespace lacquer::acquire {

namespace {

using namespace detail;

constexpr int n_buffers = 4;
constexpr int max_attempts = 5;
constexpr double late_frame_s = 0.2;  ///< a frame that was on its way when the camera was stopped arrives within this
constexpr int socket_buffer_bytes = 4 << 20;

class AravisCamera final : public Camera {
 public:
  explicit AravisCamera(const CameraDeviceSettings& settings) : settings_(settings), camera_(open_device(settings.id)), failure_(name_of_device()) {
    name_ = name_of_device();
    set_format();
    set_region();
    switch_automatics_off();
    read_limits();
    set_trigger();
    start_stream();
  }
  ~AravisCamera() override {
    if (running_) arv_camera_stop_acquisition(camera_.get(), failure_.out());
  }
  std::string description() const override { return name_; }
  CameraLimits limits() const override { return limits_; }

 private:
  RawFrame do_capture(const CaptureSettings& asked) override;

  std::string name_of_device() {
    Failure failure("camera");
    const auto text = [&](const char* s) { return std::string(s && !failure ? s : "?"); };
    ArvCamera* const c = camera_.get();
    const std::string vendor = text(arv_camera_get_vendor_name(c, failure.out()));
    const std::string model = text(arv_camera_get_model_name(c, failure.out()));
    return vendor + " " + model + " " + text(arv_camera_get_device_serial_number(c, failure.out()));
  }
  bool has(const char* feature) {
    const bool available = arv_camera_is_feature_available(camera_.get(), feature, failure_.out());
    return available && !failure_;
  }

  void set_format();
  void set_region();
  void switch_automatics_off();
  void read_limits();
  void set_trigger();
  void start_stream();
  void start();
  void stop();
  void apply(const CaptureSettings& asked);
  CaptureSettings read_back();
  void empty_queue();
  void wait_out_late_frames();
  ArvBuffer* next_buffer(double exposure_s);
  std::string defect_of(ArvBuffer* buffer) const;
  RawFrame to_frame(ArvBuffer* buffer) const;
  void verify_chunk(ArvBuffer* buffer, const CaptureSettings& actual);

  CameraDeviceSettings settings_;
  GlibPtr<ArvCamera> camera_;
  mutable Failure failure_;
  std::string name_;
  const GenicamFormat* format_ = nullptr;
  CameraLimits limits_;
  double base_gain_ = 0;
  bool has_gain_ = false, gain_in_db_ = false, triggered_ = false;
  GlibPtr<ArvStream> stream_;
  GlibPtr<ArvChunkParser> chunks_;
  bool running_ = false, frame_outstanding_ = false;
  std::optional<std::uint64_t> last_frame_id_;
};

void AravisCamera::set_format() {
  guint n = 0;
  const std::unique_ptr<const char*, GFree> offered(arv_camera_dup_available_pixel_formats_as_strings(camera_.get(), &n, failure_.out()));
  failure_.check("listing pixel formats");
  std::string list;
  const auto is_offered = [&](std::string_view name) {
    for (guint i = 0; i < n; ++i)
      if (name == offered.get()[i]) return true;
    return false;
  };
  for (guint i = 0; i < n; ++i) list += (i ? ", " : "") + std::string(offered.get()[i]);
  if (!settings_.pixel_format.empty()) {
    format_ = genicam_format(settings_.pixel_format);
    if (!format_ || format_->layout != settings_.layout || format_->bits != settings_.bits)
      throw Error(ErrorCode::usage, fmt::format("{}: devices.camera.pixel_format: \"{}\" is not a raw format with camera.layout \"{}\" and camera.bits {}", name_,
                                                settings_.pixel_format, lacquer::acquire::name_of(settings_.layout), settings_.bits));
    if (!is_offered(format_->name)) format_ = nullptr;
  } else {
    for (const GenicamFormat* f : genicam_formats(settings_.layout, settings_.bits))
      if (!format_ && is_offered(f->name)) format_ = f;
  }
  if (!format_)
    throw Error(ErrorCode::usage, fmt::format("{}: no raw format for camera.layout \"{}\" and camera.bits {}; the camera offers {}", name_,
                                              lacquer::acquire::name_of(settings_.layout), settings_.bits, list));
  arv_camera_set_pixel_format_from_string(camera_.get(), std::string(format_->name).c_str(), failure_.out());
  failure_.check("setting the pixel format");
  if (arv_camera_get_pixel_format(camera_.get(), failure_.out()) != format_->code)
    throw Error(ErrorCode::device, fmt::format("{}: the camera did not take pixel format {}", name_, format_->name));
}

void AravisCamera::set_region() {
  ArvCamera* const c = camera_.get();
  if (n_channels(settings_.layout) == 3 && (settings_.offset_x % 2 || settings_.offset_y % 2))
    throw Error(ErrorCode::usage, name_ + ": devices.camera.offset_px: expected even numbers; an odd one changes the mosaic");
  if (arv_camera_is_binning_available(c, failure_.out()) && !failure_) {
    arv_camera_set_binning(c, 1, 1, failure_.out());
    failure_.check("switching binning off");
  }
  gint max_width = 0, max_height = 0;
  arv_camera_get_sensor_size(c, &max_width, &max_height, failure_.out());
  failure_.check("reading the sensor's size");
  if (settings_.offset_x + settings_.width > max_width || settings_.offset_y + settings_.height > max_height)
    throw Error(ErrorCode::usage, fmt::format("{}: camera.width_px, height_px: {} x {} at offset {}, {} does not fit the sensor of {} x {}", name_, settings_.width,
                                              settings_.height, settings_.offset_x, settings_.offset_y, max_width, max_height));
  arv_camera_set_region(c, settings_.offset_x, settings_.offset_y, settings_.width, settings_.height, failure_.out());
  failure_.check("setting the region");
  gint x = 0, y = 0, width = 0, height = 0;
  arv_camera_get_region(c, &x, &y, &width, &height, failure_.out());
  failure_.check("reading the region back");
  if (x != settings_.offset_x || y != settings_.offset_y || width != settings_.width || height != settings_.height)
    throw Error(ErrorCode::usage, fmt::format("{}: camera.width_px, height_px: asked for {} x {} at {}, {}; the camera does {} x {} at {}, {}", name_, settings_.width,
                                              settings_.height, settings_.offset_x, settings_.offset_y, width, height, x, y));
}

/// Everything that changes pictures by itself. A camera without such a feature has nothing to switch off.
void AravisCamera::switch_automatics_off() {
  ArvCamera* const c = camera_.get();
  for (const char* feature : {"ExposureAuto", "GainAuto", "BlackLevelAuto", "BalanceWhiteAuto"}) {
    if (!has(feature)) continue;
    arv_camera_set_string(c, feature, "Off", failure_.out());
    failure_.check(fmt::format("switching {} off", feature));
    const char* const actual = arv_camera_get_string(c, feature, failure_.out());
    failure_.check(fmt::format("reading {} back", feature));
    if (!actual || std::string_view(actual) != "Off")
      throw Error(ErrorCode::device, fmt::format("{}: {} cannot be switched off (read back as {})", name_, feature, actual ? actual : "nothing"));
  }
  for (const char* feature : {"GammaEnable", "LUTEnable", "AcquisitionFrameRateEnable", "ReverseX", "ReverseY"}) {
    if (!has(feature)) continue;
    arv_camera_set_boolean(c, feature, FALSE, failure_.out());
    if (failure_) continue;  // some cameras have these read-only
    if (arv_camera_get_boolean(c, feature, failure_.out()) && !failure_)
      throw Error(ErrorCode::device, fmt::format("{}: {} cannot be switched off", name_, feature));
  }
}

void AravisCamera::read_limits() {
  ArvCamera* const c = camera_.get();
  if (!arv_camera_is_exposure_time_available(c, failure_.out()) || failure_)
    throw Error(ErrorCode::device, name_ + ": the camera has no exposure time that can be set");
  double min = 0, max = 0;
  arv_camera_get_exposure_time_bounds(c, &min, &max, failure_.out());
  failure_.check("reading the range of exposures");
  limits_.min_exposure_s = min * 1e-6;
  limits_.max_exposure_s = max * 1e-6;
  limits_.min_gain_db = limits_.max_gain_db = 0;
  has_gain_ = arv_camera_is_gain_available(c, failure_.out()) && !failure_;
  if (!has_gain_) return;
  arv_camera_get_gain_bounds(c, &min, &max, failure_.out());
  failure_.check("reading the range of gains");
  base_gain_ = settings_.gain.value_or(min);
  if (!(base_gain_ >= min && base_gain_ <= max))
    throw Error(ErrorCode::usage, fmt::format("{}: devices.camera.gain: {:g}: the camera takes {:g} to {:g}", name_, base_gain_, min, max));
  gain_in_db_ = has("Gain");  // SFNC: Gain is in dB; GainRaw and GainAbs have the maker's units
  if (gain_in_db_) {
    limits_.min_gain_db = min - base_gain_;
    limits_.max_gain_db = max - base_gain_;
  }
}

void AravisCamera::set_trigger() {
  ArvCamera* const c = camera_.get();
  triggered_ = arv_camera_is_software_trigger_supported(c, failure_.out()) && !failure_;
  if (triggered_) {
    arv_camera_set_trigger(c, "Software", failure_.out());
    failure_.check("setting the software trigger");
    arv_camera_set_acquisition_mode(c, ARV_ACQUISITION_MODE_CONTINUOUS, failure_.out());
  } else {
    arv_camera_clear_triggers(c, failure_.out());
    arv_camera_set_acquisition_mode(c, ARV_ACQUISITION_MODE_SINGLE_FRAME, failure_.out());
  }
  failure_.check("setting the acquisition mode");
}

void AravisCamera::start_stream() {
  ArvCamera* const c = camera_.get();
  const bool gige = arv_camera_is_gv_device(c);
  if (gige) {
    // A packet socket, which Aravis takes if it may, receives nothing on the loopback network and needs rights elsewhere.
    arv_camera_gv_set_stream_options(c, ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
    arv_camera_gv_set_packet_size_adjustment(c, ARV_GV_PACKET_SIZE_ADJUSTMENT_NEVER);
    arv_camera_gv_set_packet_size(c, settings_.packet_size > 0 ? settings_.packet_size : 1400, failure_.out());
    failure_.check("setting the packet size");
  }
  stream_.reset(arv_camera_create_stream(c, nullptr, nullptr, failure_.out()));
  failure_.check("opening the stream");
  if (!stream_) throw Error(ErrorCode::device, name_ + ": the stream cannot be opened");
  if (gige)  // a whole frame may arrive in one burst
    g_object_set(stream_.get(), "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED, "socket-buffer-size", socket_buffer_bytes, nullptr);
  if (arv_camera_are_chunks_available(c, failure_.out()) && !failure_) {
    arv_camera_set_chunks(c, "ExposureTime", failure_.out());
    if (!failure_) chunks_.reset(arv_camera_create_chunk_parser(c));
  }
  const guint payload = arv_camera_get_payload(c, failure_.out());
  failure_.check("reading the size of a frame");
  const std::size_t pixels = packed_bytes(format_->packing, static_cast<std::size_t>(settings_.width) * static_cast<std::size_t>(settings_.height));
  if (payload < pixels || payload > pixels + (1u << 20))
    throw Error(ErrorCode::device, fmt::format("{}: a frame has {} bytes; expected {} for {} x {} pixels of {}", name_, payload, pixels, settings_.width,
                                               settings_.height, format_->name));
  for (int i = 0; i < n_buffers; ++i) arv_stream_push_buffer(stream_.get(), arv_buffer_new_allocate(payload));
}

void AravisCamera::start() {
  if (running_) return;
  arv_camera_start_acquisition(camera_.get(), failure_.out());
  failure_.check("starting the acquisition");
  running_ = true;
}

void AravisCamera::stop() {
  if (!running_) return;
  running_ = false;
  arv_camera_stop_acquisition(camera_.get(), failure_.out());
  failure_.check("stopping the acquisition");
}

void AravisCamera::apply(const CaptureSettings& asked) {
  arv_camera_set_exposure_time(camera_.get(), asked.exposure_s * 1e6, failure_.out());
  failure_.check("setting the exposure time");
  if (!has_gain_) return;
  arv_camera_set_gain(camera_.get(), base_gain_ + (gain_in_db_ ? asked.gain_db : 0), failure_.out());
  failure_.check("setting the gain");
}

CaptureSettings AravisCamera::read_back() {
  CaptureSettings actual;
  actual.exposure_s = arv_camera_get_exposure_time(camera_.get(), failure_.out()) * 1e-6;
  failure_.check("reading the exposure time back");
  if (!has_gain_) return actual;
  const double gain = arv_camera_get_gain(camera_.get(), failure_.out());
  failure_.check("reading the gain back");
  if (gain_in_db_)
    actual.gain_db = gain - base_gain_;
  else if (std::abs(gain - base_gain_) > 1e-6 * std::max(1.0, std::abs(base_gain_)))
    throw Error(ErrorCode::device, fmt::format("{}: gain read back as {:g}, set was {:g}", name_, gain, base_gain_));
  return actual;
}

void AravisCamera::empty_queue() {
  while (ArvBuffer* old = arv_stream_try_pop_buffer(stream_.get())) arv_stream_push_buffer(stream_.get(), old);
}

/// After a frame that did not come: stop, and give it time to arrive and be thrown away.
void AravisCamera::wait_out_late_frames() {
  stop();
  while (ArvBuffer* late = arv_stream_timeout_pop_buffer(stream_.get(), static_cast<guint64>(late_frame_s * 1e6))) arv_stream_push_buffer(stream_.get(), late);
  frame_outstanding_ = false;
}

/// One frame exposed from now on, nullptr: none in time.
ArvBuffer* AravisCamera::next_buffer(double exposure_s) {
  if (frame_outstanding_) wait_out_late_frames();
  if (!triggered_) stop();
  empty_queue();
  const bool was_running = running_;
  start();
  frame_outstanding_ = true;
  if (triggered_) {
    if (!was_running) empty_queue();
    arv_camera_software_trigger(camera_.get(), failure_.out());
    failure_.check("triggering");
  }
  ArvBuffer* const buffer = arv_stream_timeout_pop_buffer(stream_.get(), static_cast<guint64>((exposure_s + settings_.timeout_s) * 1e6));
  if (buffer) frame_outstanding_ = false;
  return buffer;
}

/// Why a buffer is not a complete new frame; empty: it is. Image fields exist only in complete buffers.
std::string AravisCamera::defect_of(ArvBuffer* buffer) const {
  switch (arv_buffer_get_status(buffer)) {
    case ARV_BUFFER_STATUS_SUCCESS: break;
    case ARV_BUFFER_STATUS_TIMEOUT: return "packets of the frame are missing";
    case ARV_BUFFER_STATUS_MISSING_PACKETS: return "packets of the frame are missing";
    case ARV_BUFFER_STATUS_WRONG_PACKET_ID: return "packets came in the wrong order";
    case ARV_BUFFER_STATUS_SIZE_MISMATCH: return "the frame does not fit its buffer";
    case ARV_BUFFER_STATUS_ABORTED: return "the stream was aborted";
    case ARV_BUFFER_STATUS_FILLING: return "the frame did not end";
    default: return "the frame has no image";
  }
  if (arv_buffer_get_image_pixel_format(buffer) != format_->code) return fmt::format("pixel format 0x{:08X}, expected {}", arv_buffer_get_image_pixel_format(buffer), format_->name);
  if (arv_buffer_get_image_width(buffer) != settings_.width || arv_buffer_get_image_height(buffer) != settings_.height)
    return fmt::format("{} x {} pixels, expected {} x {}", arv_buffer_get_image_width(buffer), arv_buffer_get_image_height(buffer), settings_.width, settings_.height);
  gint x_padding = 0, y_padding = 0;
  arv_buffer_get_image_padding(buffer, &x_padding, &y_padding);
  if (x_padding != 0) return fmt::format("{} bytes of padding per line", x_padding);
  if (last_frame_id_ == arv_buffer_get_frame_id(buffer)) return "the same frame came twice";
  return {};
}

RawFrame AravisCamera::to_frame(ArvBuffer* buffer) const {
  RawFrame frame{.width = settings_.width, .height = settings_.height, .layout = settings_.layout, .bits = settings_.bits, .data = {}, .actual = {}};
  frame.data.resize(static_cast<std::size_t>(settings_.width) * static_cast<std::size_t>(settings_.height));
  std::size_t size = 0;
  const auto* const bytes = static_cast<const std::uint8_t*>(arv_buffer_get_image_data(buffer, &size));
  if (!bytes || size < packed_bytes(format_->packing, frame.data.size()))
    throw Error(ErrorCode::device, fmt::format("{}: a frame of {} bytes; expected {}", name_, size, packed_bytes(format_->packing, frame.data.size())));
  unpack(format_->packing, {bytes, size}, frame.data);
  return frame;
}

/// The camera wrote the exposure time into the frame: it must be the one that was set.
void AravisCamera::verify_chunk(ArvBuffer* buffer, const CaptureSettings& actual) {
  if (!chunks_ || !arv_buffer_has_chunks(buffer)) return;
  const double exposure_us = arv_chunk_parser_get_float_value(chunks_.get(), buffer, "ChunkExposureTime", failure_.out());
  if (failure_) return;  // another set of chunks
  if (std::abs(exposure_us * 1e-6 - actual.exposure_s) > 0.01 * actual.exposure_s + 2e-6)
    throw Error(ErrorCode::device, fmt::format("{}: a frame says that it was exposed for {:g} ms, set were {:g} ms", name_, exposure_us * 1e-3, actual.exposure_s * 1e3));
}

RawFrame AravisCamera::do_capture(const CaptureSettings& asked) {
  try {
    apply(asked);
  } catch (...) {
    running_ = false;  // gone: asking it to stop would only cost seconds
    throw;
  }
  std::string defect;
  int n_missing = 0;
  for (int attempt = 0; attempt < max_attempts; ++attempt) {
    ArvBuffer* const buffer = next_buffer(asked.exposure_s);
    if (!buffer) {
      if (++n_missing < 2) continue;  // on a lossy network a whole frame goes missing now and then
      read_back();                    // a dead camera is an error of its own
      throw Error(ErrorCode::timeout, fmt::format("{}: no frame within {:g} s of the exposure of {:g} s; check cable, network and trigger settings", name_,
                                                  settings_.timeout_s, asked.exposure_s));
    }
    defect = defect_of(buffer);
    if (!defect.empty()) {
      arv_stream_push_buffer(stream_.get(), buffer);
      continue;
    }
    try {
      last_frame_id_ = arv_buffer_get_frame_id(buffer);
      RawFrame frame = to_frame(buffer);
      frame.actual = read_back();
      verify_chunk(buffer, frame.actual);
      arv_stream_push_buffer(stream_.get(), buffer);
      if (!triggered_) stop();
      return frame;
    } catch (...) {
      arv_stream_push_buffer(stream_.get(), buffer);
      throw;
    }
  }
  throw Error(ErrorCode::device, fmt::format("{}: {} frames in a row were incomplete: {}; try a smaller devices.camera.packet_size or a cable of its own", name_,
                                             max_attempts, defect));
}

}  // namespace

std::unique_ptr<Camera> open_aravis_camera(const CameraDeviceSettings& settings) { return std::make_unique<AravisCamera>(settings); }

}  // namespace lacquer::acquire
