#include "libacquire/guided_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/geometric.hpp>

#include "libacquire/rig_parsing.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

std::string with_guided_plan(const RigDescription& rig, const GuidedPlan& guided) {
  if (rig.guided) throw Error(ErrorCode::usage, rig.file.string() + ": [guided]: this is the rig file of a guided capture; start from the rig's own");
  std::string text = rig.text + "\n# Added by Lacquer: takes the place of the plan.\n[guided]\n";
  if (guided.kind == GuidedPlan::Kind::white_reference) return text + "white_reference = true\n";
  text += fmt::format("boards = {}\n", guided.n_boards);
  if (guided.exposure_s > 0) text += fmt::format("exposure_ms = {}\n", guided.exposure_s * 1e3);
  return text;
}

const PlannedView* frontal_view(const RigDescription& rig, int light) {
  const glm::dvec3 camera = glm::normalize(rig.geometry.cam_from_rig.inverse().translation);
  const PlannedView* best = nullptr;
  double best_cosine = -2;
  for (const PlannedView& view : rig.plan) {
    if (view.kind != ViewKind::measurement || (light >= 0 && view.light != light)) continue;
    const PlacedLight placed = rig.geometry.place_light(static_cast<std::size_t>(view.light), view.turntable_angle);
    const double cosine = glm::dot(camera, placed.distant ? placed.direction : glm::normalize(placed.position));
    if (cosine > best_cosine + 1e-9) best_cosine = cosine, best = &view;
  }
  return best;
}

void detail::read_guided(const TomlTable& root, RigDescription& rig) {
  const auto table = root.table("guided", {"boards", "exposure_ms", "white_reference"});
  if (!table) return;
  if (rig.kind == RigDescription::Kind::replay) root.fail("guided", "only where frames are taken");
  const bool white = table->boolean("white_reference", false);
  if (white == table->has("boards")) table->fail("boards", "expected either this or white_reference = true");
  if (white && table->has("exposure_ms")) table->fail("exposure_ms", "only with boards");
  std::vector<PlannedView> plan;
  if (white) {
    for (int light = 0; light < static_cast<int>(rig.geometry.lights.size()); ++light)
      if (const PlannedView* view = frontal_view(rig, light)) plan.push_back(*view);
    std::copy_if(rig.plan.begin(), rig.plan.end(), std::back_inserter(plan), [](const PlannedView& view) { return view.kind == ViewKind::dark; });
  } else {
    PlannedView view = *frontal_view(rig, rig.plan.front().light);
    const double middle = view.exposures_s[view.exposures_s.size() / 2] * 1e3;
    view.exposures_s = {table->number("exposure_ms", {1e-6, 1e8}, middle) * 1e-3};
    plan.assign(static_cast<std::size_t>(table->integer("boards", 1, 1000)), view);
  }
  rig.plan = std::move(plan);
  rig.adaptive_loss.reset();
  rig.reference_patch.reset();
  rig.simulation.patch_radiance = 0;
  rig.guided = true;
  name_views(rig.plan);
}

}  // namespace lacquer::acquire
