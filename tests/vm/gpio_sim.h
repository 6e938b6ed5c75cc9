#pragma once

#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace lacquer::test {

/// A chip of the kernel's gpio-sim: 8 lines, 2, 3 and 5 named LED2, LED3 and LED5. Needs root, configfs and the module.
class GpioSim {
 public:
  static constexpr const char* label = "lacquer-sim";
  GpioSim() {
    std::filesystem::create_directories(config_ / "bank");
    put("bank/num_lines", "8");
    put("bank/label", label);
    for (const char* line : {"2", "3", "5"}) {
      std::filesystem::create_directories(config_ / "bank" / ("line" + std::string(line)));
      put("bank/line" + std::string(line) + "/name", "LED" + std::string(line));
    }
    plug_in();
  }
  ~GpioSim() {
    try {
      unplug();
      for (const char* line : {"2", "3", "5"}) std::filesystem::remove(config_ / "bank" / ("line" + std::string(line)));
      std::filesystem::remove(config_ / "bank");
      std::filesystem::remove(config_);
    } catch (const std::exception&) {
    }
  }
  GpioSim(const GpioSim&) = delete;
  GpioSim& operator=(const GpioSim&) = delete;

  void plug_in() { put("live", "1"); }
  void unplug() { put("live", "0"); }
  /// Level of a line as whoever is connected to it sees it.
  bool high(unsigned line) const {
    const std::filesystem::path device = "/sys/devices/platform/" + get("dev_name");
    return get_file(device / get("bank/chip_name") / ("sim_gpio" + std::to_string(line)) / "value") == "1";
  }
  std::string chip_name() const { return get("bank/chip_name"); }

 private:
  void put(const std::string& name, const std::string& text) const {
    std::ofstream out(config_ / name);
    out << text << std::endl;
    if (!out) throw std::runtime_error("gpio-sim: cannot write " + name);
  }
  static std::string get_file(const std::filesystem::path& file) {
    std::string text;
    std::getline(std::ifstream(file) >> std::ws, text);
    return text;
  }
  std::string get(const std::string& name) const { return get_file(config_ / name); }
  const std::filesystem::path config_ = "/sys/kernel/config/gpio-sim/lacquer";
};

}  // namespace lacquer::test
