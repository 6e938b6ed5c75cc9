#include "tools/session_samples.h"

#include <vector>

#include "libcalib/radiance_image.h"

namespace lacquer::tools {

fit::SampleSource session_samples(std::shared_ptr<const acquire::Session> session, const calib::Calibration& calibration,
                                  const calib::SampleOptions& options) {
  struct Shared {
    std::shared_ptr<const acquire::Session> session;
    calib::Calibration calibration;
    std::vector<std::size_t> views;
    calib::Sampler sampler;
  };
  const acquire::PixelLayout layout = session->rig.sensor.layout;
  const auto shared = std::make_shared<const Shared>(Shared{session, calibration, session->views_of(acquire::ViewKind::measurement),
                                                            calib::Sampler(calibration, session->rig.mask, layout, options)});
  fit::SampleSource source{.n_channels = static_cast<int>(acquire::n_channels(layout)), .n_views = shared->views.size(), .view = {}};
  source.view = [shared](std::size_t i, const fit::SampleSource::Sink& sink) {
    const acquire::ViewRecord& view = shared->session->views[shared->views[i]];
    const calib::RadianceImage image = calib::read_radiance(shared->session->radiance_path(view));
    std::vector<fit::SampleValue> values;
    shared->sampler.sample_view(image, calib::illumination_of(view, shared->calibration), [&](std::span<const calib::Sample> samples) {
      values.clear();
      for (const calib::Sample& s : samples)
        values.push_back({.coordinates = s.coordinates, .footprint = s.footprint, .value = s.value, .variance = s.variance, .channel = s.channel, .clipped = s.clipped});
      sink(values);
    });
  };
  return source;
}

}  // namespace lacquer::tools
