#include <fmt/format.h>
#include <gpiod.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <map>
#include <utility>

#include "libacquire/gpio/gpio_lines.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

struct CloseChip {
  void operator()(gpiod_chip* chip) const { gpiod_chip_close(chip); }  // releases its lines too
};
using Chip = std::unique_ptr<gpiod_chip, CloseChip>;

/// errno as a user can act on it.
std::string reason(int error) {
  switch (error) {
    case EACCES:
    case EPERM: return "not allowed (udev rule: rigs/99-lacquer.rules)";
    case EBUSY: return "taken by another program or driver";
    case ENOENT: return "there is none";
    case ENODEV:
    case EIO: return "the device is gone";
    default: return std::strerror(error);
  }
}

Chip open_chip(const std::string& which) {
  errno = 0;
  Chip chip(gpiod_chip_open_lookup(which.c_str()));
  if (!chip) {
    std::string known;
    for (const FoundGpioChip& c : find_gpio_chips()) known += (known.empty() ? "" : ", ") + c.name + (c.label.empty() ? "" : " (" + c.label + ")");
    throw Error(ErrorCode::device, fmt::format("GPIO chip \"{}\": {}; chips here: {}", which, reason(errno ? errno : ENOENT), known.empty() ? "none" : known));
  }
  return chip;
}

class GpiodLines final : public GpioLines {
 public:
  explicit GpiodLines(const std::vector<GpioLightSettings>& lights) {
    for (const GpioLightSettings& light : lights) request(light);
  }
  GpiodLines(const GpiodLines&) = delete;
  GpiodLines& operator=(const GpiodLines&) = delete;
  ~GpiodLines() override {
    for (const Line& line : lines_) gpiod_line_set_value(line.line, 0);  // some chips keep the last value after the release
  }

  std::size_t size() const override { return lines_.size(); }
  void set(std::size_t i, bool on) override {
    if (gpiod_line_set_value(lines_.at(i).line, on ? 1 : 0) != 0)
      throw Error(ErrorCode::device, fmt::format("{}: cannot be switched {}: {}", lines_[i].name, on ? "on" : "off", reason(errno)));
  }
  bool get(std::size_t i) override {
    const int value = gpiod_line_get_value(lines_.at(i).line);
    if (value < 0) throw Error(ErrorCode::device, fmt::format("{}: cannot be read back: {}", lines_[i].name, reason(errno)));
    return value == 1;
  }
  std::string name(std::size_t i) const override { return lines_.at(i).name; }

 private:
  struct Line {
    gpiod_line* line;  // owned by its chip
    std::string name;
  };

  void request(const GpioLightSettings& light) {
    Chip& chip = chips_[light.chip];
    if (!chip) chip = open_chip(light.chip);
    const unsigned n_lines = gpiod_chip_num_lines(chip.get());
    if (light.line.empty() && light.offset >= n_lines)
      throw Error(ErrorCode::device, fmt::format("GPIO chip \"{}\": line {}: the chip has lines 0..{}", light.chip, light.offset, n_lines - 1));
    gpiod_line* line = light.line.empty() ? gpiod_chip_get_line(chip.get(), light.offset) : gpiod_chip_find_line(chip.get(), light.line.c_str());
    if (!line)
      throw Error(ErrorCode::device, fmt::format("GPIO chip \"{}\": no line {} (`lacquer devices` lists the named lines)", light.chip,
                                                 light.line.empty() ? std::to_string(light.offset) : "named \"" + light.line + "\""));
    const char* label = gpiod_line_name(line);
    const std::string name = fmt::format("{} line {}{}", gpiod_chip_name(chip.get()), gpiod_line_offset(line), label ? fmt::format(" ({})", label) : "");
    for (const Line& other : lines_)
      if (other.line == line) throw Error(ErrorCode::device, name + ": two lights are on this line");
    if (gpiod_line_request_output_flags(line, "lacquer", light.active_low ? GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW : 0, 0) != 0) {
      const int error = errno;
      const char* user = gpiod_line_consumer(line);
      throw Error(ErrorCode::device, fmt::format("{}: cannot be used as an output: {}{}", name, reason(error), user ? fmt::format(" (\"{}\")", user) : ""));
    }
    lines_.push_back({line, name});
  }

  std::map<std::string, Chip> chips_;
  std::vector<Line> lines_;
};

}  // namespace

std::unique_ptr<GpioLines> open_gpiod_lines(const std::vector<GpioLightSettings>& lights) { return std::make_unique<GpiodLines>(lights); }

std::vector<FoundGpioChip> find_gpio_chips() {
  std::vector<FoundGpioChip> found;
  std::error_code status;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", status)) {
    FoundGpioChip chip;
    chip.name = entry.path().filename().string();
    if (!chip.name.starts_with("gpiochip")) continue;
    const Chip opened(gpiod_chip_open(entry.path().c_str()));
    if (!opened) {
      chip.problem = reason(errno);
    } else {
      chip.label = gpiod_chip_label(opened.get());
      chip.n_lines = gpiod_chip_num_lines(opened.get());
      for (unsigned i = 0; i < chip.n_lines; ++i) {
        gpiod_line* line = gpiod_chip_get_line(opened.get(), i);
        if (const char* name = line ? gpiod_line_name(line) : nullptr; name && *name) chip.named_lines.push_back(fmt::format("{} {}", i, name));
      }
    }
    found.push_back(std::move(chip));
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return found;
}

}  // namespace lacquer::acquire
