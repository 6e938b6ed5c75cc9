#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "libacquire/open_rig.h"
#include "libbrdf/files.h"
#include "libcalib/calibration.h"
#include "libcalib/merge.h"
#include "libcalib/samples.h"
#include "libfit/fit.h"
#include "test_support.h"

/// Statistics over seeds of the whole chain: simulated photons -> frames -> radiance -> samples -> table -> parameters.
namespace lacquer {
namespace {

fit::FitResult measured_with_seed(std::uint64_t seed, const std::shared_ptr<const brdf::Brdf>& paint) {
  const auto file = test::source_dir() / "data-samples" / "tiny-rig.toml";
  acquire::RigDescription rig = acquire::parse_rig(brdf::read_text(file), file);
  rig.simulation.seed = seed;
  const calib::Calibration calibration = calib::calibration_from_rig(rig);
  const calib::Sampler sampler(calibration, rig.mask, rig.sensor.layout, {});
  brdf::TableAccumulator accumulator(3);
  acquire::Rig devices = acquire::open_rig(rig, paint);
  for (const auto& view : rig.plan) {
    const double angle = devices.turntable->move_to(view.turntable_angle);
    devices.lights->on(view.light);
    std::vector<acquire::RawFrame> frames;
    for (const double exposure : view.exposures_s) frames.push_back(devices.camera->capture({exposure, 0}));
    const auto image = calib::merge_bracket(frames, calibration.response, calibration.noise);
    sampler.sample_view(image, {static_cast<std::size_t>(view.light), angle, 1}, [&](std::span<const calib::Sample> samples) {
      for (const auto& s : samples) calib::add_sample(accumulator, s);
    });
  }
  fit::FitOptions options;
  options.n_lobes = 0;
  return fit::fit_table(accumulator.table(false), options);
}

TEST(Seeds, ScatterOfTheWholeChainIsWhatItsErrorBarsSay) {
  constexpr int n_seeds = 16;
  const glm::dvec3 truth(0.2, 0.3, 0.4);
  const auto paint = std::make_shared<brdf::CookTorranceBrdf>(brdf::CookTorrance{truth, {}});
  double sum[3] = {}, sum2[3] = {};
  for (int seed = 1; seed <= n_seeds; ++seed) {
    const fit::FitResult fit = measured_with_seed(static_cast<std::uint64_t>(seed), paint);
    for (std::size_t c = 0; c < 3; ++c) {
      const auto& p = fit.parameters.at(c);
      ASSERT_GT(p.sigma, 0);
      const double pull = (p.value - truth[static_cast<int>(c)]) / p.sigma;
      sum[c] += pull;
      sum2[c] += pull * pull;
      // The blur of lens and pixel (0.33 px^2 per axis) flattens the cosine over a sphere of only 31 px radius: -0.04 % in its middle,
      // -0.6 % at 64 degrees by the Laplacian of the cosine. No error bar knows; it falls with the square of the radius.
      EXPECT_NEAR(p.value / truth[static_cast<int>(c)], 1.0, 0.003);
    }
  }
  double variance = 0;
  for (int c = 0; c < 3; ++c) variance += (sum2[c] - sum[c] * sum[c] / n_seeds) / (n_seeds - 1) / 3;
  EXPECT_NEAR(std::sqrt(variance), 1.0, 0.32);  // 45 degrees of freedom: standard deviation known to 10.5 %, three of them
}

}  // namespace
}  // namespace lacquer
