#include "libacquire/gpio/gpio_lights.h"

#include <fmt/format.h>

#include <utility>

#include "libbrdf/error.h"

namespace lacquer::acquire {

GpioLights::GpioLights(std::unique_ptr<GpioLines> lines, double settle_s, Clock& clock) : lines_(std::move(lines)), settle_s_(settle_s), clock_(clock) {
  for (std::size_t i = 0; i < lines_->size(); ++i) lines_->set(i, false);
}

std::string GpioLights::description() const {
  return lines_->size() == 1 ? "LED on " + lines_->name(0) : fmt::format("{} LEDs on GPIO, the first on {}", lines_->size(), lines_->name(0));
}

void GpioLights::do_on(int index) {
  const auto wanted = static_cast<std::size_t>(index);
  try {
    if (lit_ && *lit_ != wanted) {
      lines_->set(*lit_, false);
      lit_.reset();
    }
    for (std::size_t i = 0; i < lines_->size(); ++i)
      if (i != wanted && lines_->get(i))
        throw Error(ErrorCode::device, lines_->name(i) + ": is on although it was switched off; check the wiring and that nothing else drives it");
    const bool was_on = lit_ == wanted && lines_->get(wanted);
    if (!was_on) {
      lines_->set(wanted, true);
      lit_ = wanted;
      if (!lines_->get(wanted)) throw Error(ErrorCode::device, lines_->name(wanted) + ": does not go on (read back as off); is it shorted?");
      clock_.sleep(settle_s_);
    }
  } catch (...) {
    off();
    throw;
  }
}

void GpioLights::off() noexcept {
  lit_.reset();
  for (std::size_t i = 0; i < lines_->size(); ++i) {
    try {
      lines_->set(i, false);
    } catch (...) {  // one dead line must not keep the others on
    }
  }
}

}  // namespace lacquer::acquire
