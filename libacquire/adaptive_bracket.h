#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "libacquire/frame.h"
#include "libacquire/rig_description.h"
#include "libacquire/session.h"

/// Which of the planned exposures a view needs. Internal to capture_session.
namespace lacquer::acquire {

/// The frames of the bracket are their own probes, so that none is thrown away: the middle one comes first, then shorter ones, until
/// - no value of the lit paint is clipped in all frames so far (or there is no shorter one), and
/// - the sigma of a merged value is predicted to exceed that of the full bracket by no more than plan.adaptive_loss in the mean over the lit paint.
/// From what they show it is predicted which of the longer ones can be left out under the same limit: those in which almost all of the
/// lit paint would clip. So the brightest values lose most: they are in the shortest frame taken only. Every value of the lit paint counts, so one stuck at the top makes the bracket begin with its shortest exposure.
class AdaptiveBracket {
 public:
  /// Lit paint: values within mask and nominal outline whose surface is lit and seen at 5 degrees above the horizon or more (what a table
  /// takes), and the reference patch. Throws Error{file} where the mask cannot be read.
  AdaptiveBracket(const RigDescription& rig, const SensorNoise& noise);

  /// `turntable_angle`: radians, read back. `take` takes the frame of an exposure of the view; it is called for choice.first up to the middle one,
  /// from there downwards. Where the rig file has no lit paint nothing is known: all exposures, and none is taken.
  BracketChoice choose(const PlannedView& view, double turntable_angle, const std::function<const RawFrame&(std::size_t exposure)>& take) const;

 private:
  struct Pixel {
    std::uint32_t index;  ///< y * width + x
    float normal[3];      ///< rig frame, unit
  };
  std::vector<std::uint32_t> lit_values(const PlannedView& view, double turntable_angle) const;

  const RigDescription& rig_;
  SensorNoise noise_;
  std::vector<Pixel> paint_;
  std::vector<std::uint32_t> patch_;  ///< pixels
};

/// What a value is worth in a bracket: sum of t^2 / variance over the exposures first..last that do not clip, s^2/DN^2 (the inverse variance of its
/// rate of linear DN per second, `rate`, which includes its dark current).
double bracket_information(const SensorNoise& noise, const std::vector<double>& exposures_s, std::size_t first, std::size_t last, double rate);

}  // namespace lacquer::acquire
