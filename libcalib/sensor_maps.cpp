#include "libcalib/sensor_maps.h"

#include <ImfDoubleAttribute.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"
#include "libcalib/mosaic_exr.h"

namespace lacquer::calib {

namespace {

constexpr MosaicExrKind kind{"lacquer.maps_version", 1, "sensor maps of lacquer calibrate noise"};

[[noreturn]] void fail(const std::string& what) { throw Error(ErrorCode::input, "sensor maps: " + what); }

void check_size(const char* name, std::size_t size, std::size_t expected) {
  if (size != 0 && size != expected) fail(fmt::format("{}: expected {} values or none, got {}", name, expected, size));
}

void check_sigma(const char* name, double value) {
  if (!(value >= 0 && value <= 1e9)) fail(fmt::format("{}: expected a number in [0, 1e9], got {}", name, value));
}

/// First entry of `values` outside [min, max] (NaN is), or the size.
std::size_t first_outside(const std::vector<float>& values, float min, float max) {
  const auto found = std::find_if_not(values.begin(), values.end(), [&](float v) { return v >= min && v <= max; });
  return static_cast<std::size_t>(found - values.begin());
}

constexpr float max_dn = 1e9f;  ///< linearised; no curve of 16 bits gets there

/// What is wrong with a value and which; nullptr if nothing.
std::pair<const char*, std::size_t> first_fault(const SensorMaps& maps) {
  const auto in_range = [](const std::vector<float>& map) { return first_outside(map, -max_dn, max_dn); };
  if (const std::size_t i = in_range(maps.offset); i < maps.offset.size()) return {"offset: expected a finite number", i};
  if (const std::size_t i = in_range(maps.dark_rate); i < maps.dark_rate.size()) return {"dark_rate: expected a finite number", i};
  for (std::size_t i = 0; i < maps.bad.size(); ++i)
    if (maps.bad[i] > 1) return {"bad: expected 0 or 1", i};
  for (std::size_t i = 0; i < maps.flat.size(); ++i) {
    const bool bad = !maps.bad.empty() && maps.bad[i] != 0;
    if (!(std::isfinite(maps.flat[i]) && (bad || maps.flat[i] > 0))) return {"flat: expected a finite number > 0", i};
  }
  return {nullptr, 0};
}

double sigma_attribute(const MosaicExrReader& in, const char* name) {
  const auto* attribute = in.header().findTypedAttribute<Imf::DoubleAttribute>(name);
  if (!attribute || !(attribute->value() >= 0 && attribute->value() <= 1e9)) in.fail(fmt::format("{}: expected a number in [0, 1e9]", name));
  return attribute->value();
}

}  // namespace

std::size_t SensorMaps::n_values() const {
  return static_cast<std::size_t>(std::max(width, 0)) * static_cast<std::size_t>(std::max(height, 0)) *
         static_cast<std::size_t>(acquire::values_per_pixel(layout));
}

void SensorMaps::validate() const {
  const std::size_t n = n_values();
  if (n == 0) fail(fmt::format("size: expected at least one pixel, got {} x {}", width, height));
  check_size("offset", offset.size(), n);
  check_size("dark_rate", dark_rate.size(), n);
  check_size("flat", flat.size(), n);
  check_size("bad", bad.size(), n);
  check_sigma("flat_sigma", flat_sigma);
  check_sigma("offset_sigma", offset_sigma);
  check_sigma("dark_rate_sigma", dark_rate_sigma);
  if (const auto [what, index] = first_fault(*this); what) fail(fmt::format("value {}: {}", index, what));
}

void SensorMaps::validate(int frame_width, int frame_height, acquire::PixelLayout frame_layout) const {
  validate();
  if (width != frame_width || height != frame_height || layout != frame_layout)
    fail(fmt::format("expected {} x {} {} as the frames, got {} x {} {}; measure them with the same region of interest", frame_width,
                     frame_height, acquire::name_of(frame_layout), width, height, acquire::name_of(layout)));
}

void write_sensor_maps(const std::filesystem::path& file, const SensorMaps& maps) {
  maps.validate();
  if (maps.empty()) fail("expected at least one map to write, all are empty");
  std::vector<unsigned> bad(maps.bad.begin(), maps.bad.end());
  std::vector<MosaicPlane> planes;
  const auto add = [&](const char* suffix, const std::vector<float>& map) {
    if (!map.empty()) planes.push_back({suffix, Imf::FLOAT, const_cast<float*>(map.data())});  // only read
  };
  add(".offset", maps.offset);
  add(".dark_rate", maps.dark_rate);
  add(".flat", maps.flat);
  if (!bad.empty()) planes.push_back({".bad", Imf::UINT, bad.data()});
  write_mosaic_exr(file, kind, maps.width, maps.height, maps.layout, planes, [&](Imf::Header& header) {
    header.insert("lacquer.flat_sigma", Imf::DoubleAttribute(maps.flat_sigma));
    header.insert("lacquer.offset_sigma", Imf::DoubleAttribute(maps.offset_sigma));
    header.insert("lacquer.dark_rate_sigma", Imf::DoubleAttribute(maps.dark_rate_sigma));
  });
}

SensorMaps read_sensor_maps(const std::filesystem::path& file) {
  SensorMaps maps;
  reading_mosaic_exr(file, "sensor maps", [&] {
    MosaicExrReader in(file, kind);
    maps.width = in.width();
    maps.height = in.height();
    maps.layout = in.layout();
    maps.flat_sigma = sigma_attribute(in, "lacquer.flat_sigma");
    maps.offset_sigma = sigma_attribute(in, "lacquer.offset_sigma");
    maps.dark_rate_sigma = sigma_attribute(in, "lacquer.dark_rate_sigma");
    std::vector<unsigned> bad;
    std::vector<MosaicPlane> planes;
    const auto add = [&](const char* suffix, Imf::PixelType type, auto& map) {
      if (!in.has(suffix)) return;
      map.resize(in.n_values());
      planes.push_back({suffix, type, map.data()});
    };
    add(".offset", Imf::FLOAT, maps.offset);
    add(".dark_rate", Imf::FLOAT, maps.dark_rate);
    add(".flat", Imf::FLOAT, maps.flat);
    add(".bad", Imf::UINT, bad);
    if (planes.empty()) in.fail("channels: expected .offset, .dark_rate, .flat or .bad, there is none");
    in.read(planes);
    maps.bad.resize(bad.size());
    for (std::size_t i = 0; i < bad.size(); ++i) maps.bad[i] = static_cast<std::uint8_t>(std::min(bad[i], 2u));  // 2: refused below
    if (const auto [what, index] = first_fault(maps); what) in.fail_at(index, what);
  });
  return maps;
}

}  // namespace lacquer::calib
