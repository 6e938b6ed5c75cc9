#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "libcalib/geometry_unknowns.h"

namespace lacquer::calib {

/// Where a view's highlight has the turntable: the angle that it says minus the one read back, at the geometry of the unknowns.
struct PaintTrack {
  std::size_t view = 0;
  double angle = 0, sigma = 0;  ///< radians; sigma: of the highlight's place alone
  std::vector<double> by;       ///< what a unit of each of GeometryUnknowns::visible() explains of it
};

/// `noise_factor`: on the highlight's sigmas (GeometryEstimate::highlight_noise_factor). nullopt: a turn of the table does not move the highlight.
std::optional<PaintTrack> paint_track(std::size_t view, const Highlight& highlight, double noise_factor, const GeometryUnknowns& unknowns, const std::vector<double>& x);

}  // namespace lacquer::calib
