#include "libcalib/coverage.h"

#include "libcalib/calibration.h"

namespace lacquer::calib {

Tabulation predict_coverage(const acquire::RigDescription& rig, const SampleOptions& options, const Progress& progress) {
  const Calibration calibration = calibration_from_rig(rig);
  const acquire::PixelLayout layout = rig.sensor.layout;
  const acquire::CameraModel& camera = rig.geometry.camera;
  const Sampler sampler(calibration, rig.mask, layout, options);
  const std::size_t n_values = static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height) *
                               static_cast<std::size_t>(acquire::values_per_pixel(layout));
  RadianceImage image{camera.width, camera.height, layout, std::vector<float>(n_values), std::vector<float>(n_values),
                      std::vector<PixelFlag>(n_values)};
  if (!calibration.maps.empty()) calibration.maps.validate(camera.width, camera.height, layout);
  for (std::size_t i = 0; i < calibration.maps.bad.size(); ++i)
    if (calibration.maps.bad[i]) image.flags[i] = PixelFlag::invalid;

  brdf::TableAccumulator accumulator(static_cast<std::size_t>(acquire::n_channels(layout)));
  SampleCounts counts;
  for (std::size_t v = 0; v < rig.plan.size(); ++v) {
    const acquire::PlannedView& view = rig.plan[v];
    if (view.kind != acquire::ViewKind::measurement) continue;  // references and dark views are no samples
    counts += sampler.accumulate_view(image, {.light = static_cast<std::size_t>(view.light), .turntable_angle = view.turntable_angle}, accumulator);
    if (progress) progress("coverage", v + 1, rig.plan.size());
  }
  return {accumulator.table(true), counts, {}};
}

CoverageMap coverage_map(const brdf::TableChannel& channel) {
  using Grid = brdf::TableGrid;
  CoverageMap map;
  map.entries.resize(static_cast<std::size_t>(Grid::n_theta_h) * Grid::n_theta_d);
  for (std::size_t i = 0; i < Grid::n_cells; ++i) {
    CoverageMap::Entry& entry = map.entries[i / Grid::n_phi_d];
    const bool covered = channel.origin[i] == brdf::CellOrigin::measured || channel.origin[i] == brdf::CellOrigin::symmetric;
    // A cell whose centre is below the horizon can still have samples in a corner.
    entry.reachable += covered || Grid::reachable(Grid::cell(i));
    entry.covered += covered;
  }
  return map;
}

}  // namespace lacquer::calib
