#pragma once

#include <functional>
#include <memory>
#include <string>

/// Aravis' own GigE Vision camera (protocol theirs) with a sensor of ours (photons known), on the loopback network.
namespace lacquer::test {

class FakeGigeCamera {
 public:
  /// Called for every frame: counts of pixel (x, y), right-aligned, for this exposure. Must not exceed the format.
  using Sensor = std::function<unsigned(int x, int y, double exposure_s, double gain)>;

  /// Starts to answer at 127.0.0.1. `modern`: the feature names of SFNC (ExposureTime, Gain in dB) instead of the older ones.
  FakeGigeCamera(Sensor sensor, bool modern);
  ~FakeGigeCamera();
  FakeGigeCamera(const FakeGigeCamera&) = delete;
  FakeGigeCamera& operator=(const FakeGigeCamera&) = delete;

  void unplug();
  void plug_in();
  /// Software triggers wait: registers answer, frames do not come. When released, the trigger that waited gives its late frame.
  void hold_triggers(bool on);
  double exposure_in_device() const;
  /// The next `n` frames leave the camera `seconds` after they were exposed; `exposed` is called in between.
  void delay_frames(int n, double seconds, std::function<void()> exposed);

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace lacquer::test
