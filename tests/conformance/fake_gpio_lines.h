#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "libacquire/gpio/gpio_lines.h"
#include "libbrdf/error.h"

namespace lacquer::test {

/// Lines in memory, with faults.
struct FakeWires {
  explicit FakeWires(std::size_t n) : on(n, false), stuck_on(n, false), stuck_off(n, false) {}
  std::vector<bool> on, stuck_on, stuck_off;
  bool unplugged = false, two_were_on = false;
  int fail_set_at = -1, n_sets = 0;  ///< number of the set() that fails, from 0
};

class FakeGpioLines final : public acquire::GpioLines {
 public:
  explicit FakeGpioLines(std::shared_ptr<FakeWires> wires) : wires_(std::move(wires)) {}
  ~FakeGpioLines() override { std::fill(wires_->on.begin(), wires_->on.end(), false); }  // released lines fall back
  std::size_t size() const override { return wires_->on.size(); }
  void set(std::size_t line, bool on) override {
    check(line);
    if (wires_->n_sets++ == wires_->fail_set_at) throw Error(ErrorCode::device, name(line) + ": cannot be switched");
    wires_->on.at(line) = on;
    if (std::count(wires_->on.begin(), wires_->on.end(), true) > 1) wires_->two_were_on = true;
  }
  bool get(std::size_t line) override {
    check(line);
    return (wires_->on.at(line) || wires_->stuck_on.at(line)) && !wires_->stuck_off.at(line);
  }
  std::string name(std::size_t line) const override { return "fake line " + std::to_string(line); }

 private:
  void check(std::size_t line) const {
    if (wires_->unplugged) throw Error(ErrorCode::device, name(line) + ": the device is gone");
  }
  std::shared_ptr<FakeWires> wires_;
};

}  // namespace lacquer::test
