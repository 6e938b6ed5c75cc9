#include "tools/capture_guided.h"

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <thread>

#include "libbrdf/error.h"
#include "tools/capture_guard.h"

namespace lacquer::tools {

namespace {

using Kind = acquire::GuidedPlan::Kind;

/// A line of stdin, in reach of Ctrl-C. false: stdin ended.
bool read_line(const std::function<void()>& look_for_interruption) {
  for (;;) {
    look_for_interruption();
    pollfd input{.fd = STDIN_FILENO, .events = POLLIN, .revents = 0};
    if (poll(&input, 1, 100) <= 0) continue;
    char c = 0;
    if (::read(STDIN_FILENO, &c, 1) <= 0) return false;
    if (c == '\n') return true;
  }
}

}  // namespace

Guide::Guide(const acquire::RigDescription& rig, Kind kind, double every_s, const Context& context)
    : rig_(rig), kind_(kind), every_s_(every_s), quiet_(context.quiet), interruption_(interruption(context)) {}

void Guide::wait(const std::string& prompt, const std::string& what) const {
  const auto look = [&] { interruption_("waiting for " + what, 0, 0); };
  fmt::print(stderr, "{}{}\n", prompt, every_s_ > 0 ? fmt::format(" (in {:g} s)", every_s_) : "; then press Enter");
  std::fflush(stderr);
  if (every_s_ > 0) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(every_s_);
    for (look(); std::chrono::steady_clock::now() < end; look()) std::this_thread::sleep_for(std::chrono::milliseconds(20));
  } else if (!read_line(look)) {
    throw Error(ErrorCode::input, "standard input ended while waiting for " + what + "; expected a line for each");
  }
}

std::function<void(std::size_t)> Guide::before_view() {
  return [this](std::size_t view) {
    if (kind_ == Kind::boards) {
      const std::string what = fmt::format("board {} of {}", view + 1, rig_.plan.size());
      wait(fmt::format("{}: hold the chessboard still in another place and at another tilt", what), what);
    } else if (!white_there_) {
      wait("white reference: put it where the sphere stands", "the white reference");
      white_there_ = true;
    }
  };
}

acquire::FrameSink Guide::sink() const {
  acquire::FrameSink sink;
  if (quiet_) return sink;
  sink.frame = [](const acquire::ViewRecord& view, const acquire::RawFrame& frame) {
    std::vector<std::uint16_t> values = frame.data;
    const auto high = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 99 / 100);
    std::nth_element(values.begin(), high, values.end());
    const int top = (1 << frame.bits) - 1;
    const auto clipped = 100.0 * static_cast<double>(std::count(values.begin(), values.end(), top)) / static_cast<double>(values.size());
    fmt::print(stderr, "{}: {:.4g} ms, 99 % of the values up to {} of {}, {:.2f} % clipped\n", view.frames.back().file, 1e3 * frame.actual.exposure_s, *high, top,
               clipped);
  };
  return sink;
}

std::string Guide::end_text(const acquire::Session& session) const {
  return fmt::format("{}: {}\n", kind_ == Kind::boards ? "boards" : "white reference", (session.folder / "frames/*.tiff").string());
}

}  // namespace lacquer::tools
