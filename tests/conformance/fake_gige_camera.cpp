#include "conformance/fake_gige_camera.h"

#include <arv.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <fstream>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <vector>

#include "conformance/private_loopback.h"
#include "test_support.h"

namespace lacquer::test {

namespace {

constexpr const char* address = "127.0.0.1";

void replace_all(std::string& text, const std::string& what, const std::string& with) {
  for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += with.size()) text.replace(at, what.size(), with);
}

/// Aravis' description of its camera, with the formats of machine-vision cameras added.
std::string genicam_text(bool modern) {
  ArvFakeCamera* const camera = arv_fake_camera_new("template");
  std::size_t size = 0;
  const char* const xml = arv_fake_camera_get_genicam_xml(camera, &size);
  std::string text(xml, size);
  g_object_unref(camera);
  std::string entries;
  for (const auto& [name, code] : std::vector<std::pair<const char*, unsigned>>{{"Mono10", 0x01100003}, {"Mono10p", 0x010A0046}, {"Mono12", 0x01100005},
                                                                                {"Mono12p", 0x010C0047}, {"Mono12Packed", 0x010C0006}, {"BayerRG12", 0x01100011},
                                                                                {"BayerGB16", 0x01100030}})
    entries += "<EnumEntry Name=\"" + std::string(name) + "\" NameSpace=\"Standard\"><Value>" + std::to_string(code) + "</Value></EnumEntry>\n";
  const std::string anchor = "<EnumEntry Name=\"BayerBG8\" NameSpace=\"Standard\">";
  const std::size_t at = text.find(anchor);
  if (at == std::string::npos) throw std::runtime_error("Aravis' fake camera has changed: no BayerBG8");
  text.insert(at, entries);
  if (modern) {
    replace_all(text, "ExposureTimeAbs", "ExposureTime");
    const std::size_t begin = text.find("<Integer Name=\"GainRaw\""), end = text.find("</Integer>", begin);
    text.replace(begin, end - begin + 10, "<Float Name=\"Gain\" NameSpace=\"Standard\"><pValue>GainRawRegister</pValue><Min>0</Min><Max>10</Max></Float>");
    replace_all(text, "<pFeature>GainRaw</pFeature>", "<pFeature>Gain</pFeature>");
  }
  return text;
}

void pack(ArvPixelFormat format, const std::vector<unsigned>& v, std::vector<unsigned char>& out) {
  const auto put = [&](unsigned byte) { out.push_back(static_cast<unsigned char>(byte)); };
  if (ARV_PIXEL_FORMAT_BIT_PER_PIXEL(format) == 8) {
    for (const unsigned x : v) put(x);
  } else if (ARV_PIXEL_FORMAT_BIT_PER_PIXEL(format) == 16) {
    for (const unsigned x : v) put(x & 255), put(x >> 8);
  } else if (format == 0x010C0006) {  // Mono12Packed
    for (std::size_t i = 0; i + 1 < v.size(); i += 2) put(v[i] >> 4), put((v[i] & 15) | (v[i + 1] & 15) << 4), put(v[i + 1] >> 4);
  } else if (format == 0x010C0047) {  // Mono12p
    for (std::size_t i = 0; i + 1 < v.size(); i += 2) put(v[i] & 255), put(v[i] >> 8 | (v[i + 1] & 15) << 4), put(v[i + 1] >> 4);
  } else if (format == 0x010A0046) {  // Mono10p
    for (std::size_t i = 0; i + 3 < v.size(); i += 4) {
      const auto all = static_cast<unsigned long long>(v[i]) | static_cast<unsigned long long>(v[i + 1]) << 10 | static_cast<unsigned long long>(v[i + 2]) << 20 |
                       static_cast<unsigned long long>(v[i + 3]) << 30;
      for (int k = 0; k < 5; ++k) put(static_cast<unsigned>(all >> 8 * k & 255));
    }
  }
}

}  // namespace

struct FakeGigeCamera::State {
  Sensor sensor;
  TemporaryFolder folder;
  std::string genicam;
  ArvGvFakeCamera* camera = nullptr;
  std::atomic<double> exposure_s{0};
  std::mutex mutex;
  int n_delayed = 0;
  double delay_s = 0;
  std::function<void()> exposed;

  static void fill(ArvBuffer* buffer, void* self, guint32 exposure_us, guint32 gain, ArvPixelFormat format) {
    auto& state = *static_cast<State*>(self);
    state.exposure_s = exposure_us * 1e-6;
    const int width = arv_buffer_get_image_width(buffer), height = arv_buffer_get_image_height(buffer);
    std::vector<unsigned> values;
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) values.push_back(state.sensor(x, y, exposure_us * 1e-6, gain));
    std::vector<unsigned char> bytes;
    pack(format, values, bytes);
    // Allocated for width * height pixels of this format; the size that Aravis states is that of the data received, here none.
    auto* const memory = static_cast<unsigned char*>(const_cast<void*>(arv_buffer_get_data(buffer, nullptr)));
    std::copy(bytes.begin(), bytes.end(), memory);
    const std::lock_guard lock(state.mutex);
    if (state.n_delayed-- <= 0) return;
    state.exposed();
    std::this_thread::sleep_for(std::chrono::duration<double>(state.delay_s));
  }

  void start() {
    camera = arv_gv_fake_camera_new_full(address, "LACQUER", genicam.c_str());
    if (!camera || !arv_gv_fake_camera_is_running(camera)) throw std::runtime_error("the fake camera does not start");
    arv_fake_camera_set_fill_pattern(arv_gv_fake_camera_get_fake_camera(camera), fill, this);
  }
  void stop() {
    if (camera) g_object_unref(camera);
    camera = nullptr;
  }
};

FakeGigeCamera::FakeGigeCamera(Sensor sensor, bool modern) : state_(std::make_shared<State>()) {
  enter_private_loopback();
  state_->sensor = std::move(sensor);
  state_->genicam = (state_->folder / "camera.xml").string();
  write_file(state_->genicam, genicam_text(modern));
  state_->start();
}

FakeGigeCamera::~FakeGigeCamera() { state_->stop(); }

void FakeGigeCamera::unplug() { state_->stop(); }
void FakeGigeCamera::plug_in() { state_->start(); }
void FakeGigeCamera::hold_triggers(bool on) {
  constexpr std::uint32_t line_0 = 0, software = 1;  // values of TriggerSource in Aravis' camera
  arv_fake_camera_write_register(arv_gv_fake_camera_get_fake_camera(state_->camera), ARV_FAKE_CAMERA_REGISTER_TRIGGER_SOURCE, on ? line_0 : software);
}
void FakeGigeCamera::delay_frames(int n, double seconds, std::function<void()> exposed) {
  const std::lock_guard lock(state_->mutex);
  state_->n_delayed = n;
  state_->delay_s = seconds;
  state_->exposed = std::move(exposed);
}
double FakeGigeCamera::exposure_in_device() const { return state_->exposure_s; }

}  // namespace lacquer::test
