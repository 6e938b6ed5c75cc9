#pragma once

#include <string>

#include "libacquire/rig_description.h"

/// Captures of something else than the painted sphere, with the same devices: a person puts it there.
namespace lacquer::acquire {

struct GuidedPlan {
  enum class Kind {
    boards,          ///< a chessboard that is moved between the frames: `n_boards` views of one exposure, lit by the first light
    white_reference  ///< a standard of known reflectance where the sphere stands: every light once, with the whole bracket, and the plan's dark views
  } kind = Kind::boards;
  int n_boards = 0;
  double exposure_s = 0;  ///< boards; 0: the middle one of the plan
};

/// Text of a rig file whose plan is replaced: table [guided] at its end. The turntable stands where each light is nearest to the camera's direction.
/// Throws Error{usage} for a rig file that has one already.
std::string with_guided_plan(const RigDescription& rig, const GuidedPlan& guided);

/// The measurement view of a light (-1: any) that sees most of the sphere's lit side: smallest angle between light and camera; the first of
/// equals. nullptr: the light is not in the plan.
const PlannedView* frontal_view(const RigDescription& rig, int light);

}  // namespace lacquer::acquire
