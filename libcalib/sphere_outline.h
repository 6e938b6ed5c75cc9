#pragma once

#include <memory>
#include <vector>

#include "libacquire/rig_geometry.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/radiance_image.h"

namespace lacquer::calib {

struct OutlineOptions {
  double lens_blur_px = 0;     ///< sigma of the lens, without the pixel's own area; 0: it is found from the limb itself
  double search_px = 0;        ///< the silhouette is looked for this far to both sides of where the rig file has it; 0: 3 sigma of a 3 mm ruler
  double min_cosine = 0.1;     ///< of light and limb: beyond it the limb is the terminator, not the silhouette
  /// Radians from the line of sight. A light further round makes the limb ever more of a highlight, which is not as a lit edge is and moves
  /// one side of the silhouette: at 2.1 by up to 0.17 px, at 1.3 all sides alike.
  double max_light_angle = 1.3;
  double arc_px = 6;           ///< length of silhouette per edge point
};

/// Sub-pixel silhouette of a sphere from the radiance images of a session, one in memory at a time. Around the place that the rig file
/// gives the limb is cut into arcs; each arc adds up the views whose light it faces. finish() finds the steepest ascent of every arc,
/// fits a sphere robustly, and fits each arc's profile about it: background, then a + b sqrt(depth) + c depth, as a limb is lit
/// (the cosines go with the square root of the depth), blurred by lens and pixel. A mosaic's green values only; nothing is interpolated.
class OutlineFinder {
 public:
  /// Throws Error{input} for a camera that is not a pinhole.
  OutlineFinder(const acquire::RigGeometry& nominal, const OutlineOptions& options);
  ~OutlineFinder();
  /// `light`: as placed by the rig file.
  void add(const RadianceImage& image, const acquire::PlacedLight& light);
  struct Outline {
    std::vector<EdgePoint> edges;
    acquire::RigGeometry geometry;   ///< nominal, with the sphere where these edges have it
    std::size_t n_arcs = 0, n_dark = 0, n_rejected = 0;  ///< arcs in all; never lit; no clear step
    double lens_blur_px = 0;         ///< of the limb, as given or as found
  };
  /// No edges: geometry is the nominal one.
  Outline finish() const;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace lacquer::calib
