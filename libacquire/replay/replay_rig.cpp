#include <fmt/format.h>

#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/error.h"

/// A rig of photographs that exist already. Everything that the table and the lights did is over, so they only say yes.
namespace lacquer::acquire {

namespace {

class ReplayTurntable final : public Turntable {
 public:
  void hold() noexcept override {}
  std::string description() const override { return "replay: turntable as in the rig file"; }

 private:
  double do_move_to(double angle) override { return angle; }
};

class ReplayLights final : public LightSwitch {
 public:
  explicit ReplayLights(int n_lights) : n_lights_(n_lights) {}
  void off() noexcept override {}
  std::string description() const override { return fmt::format("replay: {} lights as in the rig file", n_lights_); }
  int n_lights() const override { return n_lights_; }

 private:
  void do_on(int) override {}
  int n_lights_;
};

/// The photographs in the order of the plan.
class ReplayCamera final : public Camera {
 public:
  explicit ReplayCamera(RigDescription rig) : rig_(std::move(rig)) {
    for (const PlannedView& view : rig_.plan)
      for (std::size_t i = 0; i < view.files.size(); ++i) photographs_.push_back({view.files[i], view.exposures_s.at(i)});
  }
  std::string description() const override { return fmt::format("replay: {} photographs", photographs_.size()); }
  void skip() { ++next_; }

 private:
  struct Photograph {
    std::filesystem::path file;
    double exposure_s;
  };

  RawFrame do_capture(const CaptureSettings& asked) override {
    if (next_ == photographs_.size())
      throw Error(ErrorCode::device, fmt::format("{}: all {} photographs were delivered", rig_.file.string(), photographs_.size()));
    const Photograph& photograph = photographs_[next_];
    // The exposure comes from the same plan; another one means that the caller left the order of the plan.
    if (std::abs(asked.exposure_s - photograph.exposure_s) > 1e-9 * photograph.exposure_s)
      throw Error(ErrorCode::usage, fmt::format("{}: photograph {} was exposed for {} s, asked were {} s; photographs come in the order of "
                                                "the plan", rig_.file.string(), photograph.file.string(), photograph.exposure_s, asked.exposure_s));
    RawFrame frame = read_frame(photograph.file.string(), rig_.sensor.bits, rig_.sensor.layout);
    check_format(frame, rig_, photograph.file.string());
    frame.actual = {.exposure_s = photograph.exposure_s, .gain_db = 0};
    ++next_;
    return frame;
  }

  RigDescription rig_;
  std::vector<Photograph> photographs_;
  std::size_t next_ = 0;
};

}  // namespace

Rig open_replay_rig(const RigDescription& description) {
  // A missing photograph is said before the first one is copied, not after an hour.
  for (const PlannedView& view : description.plan) {
    if (view.files.size() != view.exposures_s.size())
      throw Error(ErrorCode::usage, description.file.string() + ": replay: every exposure of the plan needs its photograph");
    for (const auto& file : view.files) {
      std::error_code status;
      if (!std::filesystem::is_regular_file(file, status))
        throw Error(ErrorCode::file, fmt::format("{}: replay: no photograph {} (for photographs elsewhere: --data FOLDER)",
                                                 description.file.string(), file.string()));
    }
  }
  Rig rig;
  rig.turntable = std::make_unique<ReplayTurntable>();
  rig.lights = std::make_unique<ReplayLights>(static_cast<int>(description.geometry.lights.size()));
  auto camera = std::make_unique<ReplayCamera>(description);
  rig.frame_exists = [c = camera.get()](std::size_t, std::size_t) { c->skip(); };
  rig.frame_time = [] { return std::nullopt; };
  rig.camera = std::move(camera);
  return rig;
}

}  // namespace lacquer::acquire
