#include <utility>

#include "libacquire/open_rig.h"
#include "libacquire/sim/simulated_world.h"

namespace lacquer::acquire {

namespace {

using World = std::shared_ptr<sim::SimulatedWorld>;

class SimulatedCamera final : public Camera {
 public:
  explicit SimulatedCamera(World world) : world_(std::move(world)) {}
  std::string description() const override { return "simulated camera"; }

 private:
  RawFrame do_capture(const CaptureSettings& asked) override { return world_->photograph(asked); }
  World world_;
};

class SimulatedTurntable final : public Turntable {
 public:
  explicit SimulatedTurntable(World world) : world_(std::move(world)) {}
  void hold() noexcept override {}  // the simulated table never slips
  std::string description() const override { return "simulated turntable"; }

 private:
  double do_move_to(double angle) override { return world_->move_to(angle); }
  World world_;
};

class SimulatedLights final : public LightSwitch {
 public:
  explicit SimulatedLights(World world) : world_(std::move(world)) {}
  ~SimulatedLights() override { off(); }
  void off() noexcept override { world_->switch_light(std::nullopt); }
  std::string description() const override { return "simulated lights"; }
  int n_lights() const override { return static_cast<int>(world_->geometry().lights.size()); }

 private:
  void do_on(int index) override { world_->switch_light(index); }
  World world_;
};

}  // namespace

Rig open_simulated_rig(const RigDescription& description, std::shared_ptr<const brdf::Brdf> paint) {
  const auto world = std::make_shared<sim::SimulatedWorld>(description, std::move(paint));
  Rig rig;
  rig.turntable = std::make_unique<SimulatedTurntable>(world);
  rig.lights = std::make_unique<SimulatedLights>(world);
  rig.camera = std::make_unique<SimulatedCamera>(world);
  rig.frame_exists = [world, plan = description.plan](std::size_t view, std::size_t exposure) {
    world->skip(plan[view].light, plan[view].turntable_angle, {plan[view].exposures_s[exposure], 0});
  };
  rig.frame_time = [world] { return world->frame_time(); };
  return rig;
}

}  // namespace lacquer::acquire
