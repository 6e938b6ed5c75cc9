#include <fmt/format.h>

#include <array>
#include <cmath>
#include <glm/geometric.hpp>

#include "libacquire/mask_circle.h"
#include "libacquire/rig_parsing.h"
#include "libbrdf/error.h"

namespace lacquer::acquire::detail {

namespace {

using Projection = CameraModel::Projection;

TomlTable camera_table(const TomlTable& root) {
  auto table = root.table("camera", {"width_px", "height_px", "layout", "bits", "projection", "focal_length_px", "focal_length_mm",
                                     "pixel_pitch_um", "scale_px_per_mm", "principal_point_px", "distortion", "lens_file", "position_mm", "look_at_mm",
                                     "up"});
  if (!table) root.fail("", "[camera]: missing; every rig file has this table");
  return *table;
}

glm::dvec2 focal_length(const TomlTable& t) {
  const Range pixels = Range::above(0, 1e7);
  if (t.has("focal_length_px")) {
    if (t.has("focal_length_mm")) t.fail("focal_length_mm", "stated twice; focal_length_px is there already");
    return t.is_array("focal_length_px") ? t.vector2("focal_length_px", pixels) : glm::dvec2(t.number("focal_length_px", pixels));
  }
  if (!t.has("focal_length_mm")) t.fail("focal_length_px", "missing; expected pixels, or focal_length_mm with pixel_pitch_um");
  return glm::dvec2(t.number("focal_length_mm", Range::above(0, 1e5)) * 1e3 / t.number("pixel_pitch_um", Range::above(0, 1e3)));
}

/// Rig and camera axes parallel: rig x right, y up, z towards the camera; camera x right, y down, z forward.
RigidTransform parallel_pose(const glm::dvec3& sphere_in_cam) {
  return {glm::dmat3({1, 0, 0}, {0, -1, 0}, {0, 0, -1}), sphere_in_cam};
}

/// The sphere's centre in the camera frame from its outline. Pinhole: the lines of sight of the outline form a cone around the sphere's
/// centre. Its axis halves the angle between the two outline points on the line through the principal point; its angle is the mean
/// along and across that line (pixels that are not square). The outline is an ellipse, longer along that line by half the square of the
/// tangent of its angle off the optical axis, 3e-4 at 1.4 deg: taken as a circle.
/// Orthographic: the distance is arbitrary; the scale is not, and is set here.
glm::dvec3 sphere_from_circle(const TomlTable& camera, const ImageCircle& circle, RigGeometry& geometry) {
  CameraModel& model = geometry.camera;
  const glm::dvec2 offset = circle.centre - model.centre;
  if (model.projection == Projection::orthographic) {
    model.focal = glm::dvec2(circle.radius / geometry.sphere_radius);
    return {offset / model.focal, 20 * geometry.sphere_radius};
  }
  const auto ray_of = [&](const glm::dvec2& pixel) {
    const auto ray = model.unproject(pixel);
    if (!ray) camera.fail("distortion", fmt::format("cannot be inverted at pixel ({:.1f}, {:.1f}), which shows the sphere", pixel.x, pixel.y));
    return ray->direction;
  };
  const auto half_angle = [](const glm::dvec3& a, const glm::dvec3& b) { return 0.5 * std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b)); };
  const glm::dvec2 along = circle.radius * (glm::length(offset) > 0 ? glm::normalize(offset) : glm::dvec2(1, 0));
  const glm::dvec2 across(-along.y, along.x);
  const glm::dvec3 inner = ray_of(circle.centre - along), outer = ray_of(circle.centre + along);
  const double angle = 0.5 * (half_angle(inner, outer) + half_angle(ray_of(circle.centre - across), ray_of(circle.centre + across)));
  return glm::normalize(inner + outer) * (geometry.sphere_radius / std::sin(angle));
}

RigidTransform stated_pose(const TomlTable& t, RigGeometry& geometry) {
  const Range mm = {-1e6, 1e6};
  const glm::dvec3 position = t.vector3("position_mm", mm) * metres_per_mm;
  const glm::dvec3 target = t.vector3("look_at_mm", mm, glm::dvec3(0.0)) * metres_per_mm;
  const glm::dvec3 up = t.vector3("up", mm, glm::dvec3(0, 1, 0));
  if (glm::length(position) <= geometry.sphere_radius)
    t.fail("position_mm", fmt::format("lies inside the sphere of {} mm radius", geometry.sphere_radius / metres_per_mm));
  const glm::dvec3 forward = target - position;
  if (!(glm::length(glm::cross(forward, up)) > 1e-6 * glm::length(forward) * glm::length(up)) || !(glm::length(forward) > 0))
    t.fail("up", "expected a direction that is not parallel to the line of sight");
  if (geometry.camera.projection == Projection::orthographic)
    geometry.camera.focal = glm::dvec2(t.number("scale_px_per_mm", Range::above(0, 1e5)) / metres_per_mm);
  return look_at(position, target, glm::normalize(up));
}

/// camera.lens_file takes the place of every other statement about the lens.
void read_lens_file(const TomlTable& t, const RigFiles& files, RigDescription& rig) {
  for (const char* key : {"focal_length_px", "focal_length_mm", "pixel_pitch_um", "principal_point_px", "distortion"})
    if (t.has(key)) t.fail(key, "camera.lens_file says it already");
  const auto file = referenced_file(t, "lens_file", files, rig);
  rig.lens = read_lens(file);
  const CameraModel& camera = rig.geometry.camera;
  if (rig.lens->width != camera.width || rig.lens->height != camera.height)
    t.fail("lens_file", fmt::format("was calibrated for {} x {} pixels, the camera has {} x {}", rig.lens->width, rig.lens->height, camera.width, camera.height));
  rig.geometry.camera = camera_of(*rig.lens, file.string());
}

}  // namespace

void read_camera(const TomlTable& root, const RigFiles& files, RigDescription& rig) {
  const TomlTable t = camera_table(root);
  CameraModel& camera = rig.geometry.camera;
  camera.width = static_cast<int>(t.integer("width_px", 1, 32768));
  camera.height = static_cast<int>(t.integer("height_px", 1, 32768));
  rig.sensor.layout = pixel_layout_from_name(
      std::array{"mono", "rgb", "rggb", "grbg", "gbrg", "bggr"}[t.choice("layout", {"mono", "rgb", "rggb", "grbg", "gbrg", "bggr"})]);
  rig.sensor.bits = static_cast<int>(t.integer("bits", 8, 16));
  camera.projection = t.choice("projection", {"pinhole", "orthographic"}, 0) == 0 ? Projection::pinhole : Projection::orthographic;
  const bool pinhole = camera.projection == Projection::pinhole;
  for (const char* key : {"focal_length_px", "focal_length_mm", "pixel_pitch_um", "distortion", "lens_file"})
    if (!pinhole && t.has(key)) t.fail(key, "an orthographic camera has none");
  if (pinhole && t.has("scale_px_per_mm")) t.fail("scale_px_per_mm", "only an orthographic camera has one");
  if (t.has("lens_file")) return read_lens_file(t, files, rig);
  if (pinhole) camera.focal = focal_length(t);
  camera.centre = t.has("principal_point_px") ? t.vector2("principal_point_px", {-1e6, 1e6})
                                              : glm::dvec2(0.5 * (camera.width - 1), 0.5 * (camera.height - 1));
  if (t.has("distortion")) {
    const auto numbers = t.numbers("distortion", {-1e6, 1e6}, 1, 8);
    std::copy(numbers.begin(), numbers.end(), camera.distortion.begin());
  }
}

void read_sphere_and_pose(const TomlTable& root, RigDescription& rig) {
  const TomlTable camera = camera_table(root);
  RigGeometry& geometry = rig.geometry;
  const auto sphere = root.table("sphere", {"radius_mm", "centre_px", "radius_px"});
  if (sphere) geometry.sphere_radius = sphere->number("radius_mm", Range::above(0, 1e5), 50) * metres_per_mm;
  const bool circle_stated = sphere && (sphere->has("centre_px") || sphere->has("radius_px"));

  if (camera.has("position_mm")) {
    if (circle_stated) sphere->fail("centre_px", "camera.position_mm is stated already; the sphere is where it projects to");
    geometry.cam_from_rig = stated_pose(camera, geometry);
  } else {
    for (const char* key : {"look_at_mm", "up", "scale_px_per_mm"})
      if (camera.has(key)) camera.fail(key, "only with camera.position_mm");
    ImageCircle circle;
    if (circle_stated) {
      circle.centre = sphere->vector2("centre_px", {-1e6, 1e6});
      circle.radius = sphere->number("radius_px", {2, 1e5});
    } else if (rig.mask.file) {
      circle = circle_of_mask(*rig.mask.file, geometry.camera.width, geometry.camera.height);
    } else {
      camera.fail("position_mm", "missing; the camera's place must be known: this, or sphere.centre_px and radius_px, or mask.file");
    }
    geometry.cam_from_rig = parallel_pose(sphere_from_circle(camera, circle, geometry));
  }

  const auto centre = geometry.camera.project(geometry.cam_from_rig.translation);
  if (!centre || !(std::abs(centre->x - 0.5 * (geometry.camera.width - 1)) <= 0.5 * geometry.camera.width) ||
      !(std::abs(centre->y - 0.5 * (geometry.camera.height - 1)) <= 0.5 * geometry.camera.height))
    camera.fail("", "the sphere's centre (the rig's origin) is not in the image; check position_mm, look_at_mm and the image size");
}

}  // namespace lacquer::acquire::detail
