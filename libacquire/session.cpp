#include "libacquire/session.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::acquire {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int format_version = 1;
constexpr std::size_t max_views = 100000;
constexpr std::size_t max_frames_per_view = 1000;

/// A value of session.json with the way to it, for messages.
class Field {
 public:
  Field(const Json& json, std::string file, std::string path) : json_(&json), file_(std::move(file)), path_(std::move(path)) {}

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorCode::file, file_ + ": " + (path_.empty() ? "" : path_ + ": ") + what);
  }
  bool has(const char* key) const { return json_->is_object() && json_->contains(key); }
  Field operator[](const char* key) const {
    if (!json_->is_object()) fail("expected an object");
    const auto found = json_->find(key);
    const std::string path = path_.empty() ? key : path_ + "." + key;
    if (found == json_->end()) throw Error(ErrorCode::file, file_ + ": " + path + ": missing");
    return {*found, file_, path};
  }
  std::vector<Field> items(std::size_t min_count, std::size_t max_count) const {
    if (!json_->is_array() || json_->size() < min_count || json_->size() > max_count)
      fail(fmt::format("expected a list of {} to {} entries", min_count, max_count));
    std::vector<Field> result;
    for (const Json& item : *json_) result.emplace_back(item, file_, fmt::format("{}[{}]", path_, result.size()));
    return result;
  }
  std::vector<std::pair<std::string, Field>> members(std::size_t max_count) const {
    if (!json_->is_object() || json_->size() > max_count) fail(fmt::format("expected an object with at most {} members", max_count));
    std::vector<std::pair<std::string, Field>> result;
    for (const auto& [key, value] : json_->items()) result.emplace_back(key, Field(value, file_, path_ + "." + key.substr(0, 100)));
    return result;
  }
  double number(double min, double max) const {
    const double v = json_->is_number() ? json_->get<double>() : std::nan("");
    if (!(v >= min && v <= max)) fail(fmt::format("expected a number from {} to {}", min, max));
    return v;
  }
  int integer(int min, int max) const {
    const double v = number(min, max);
    if (v != std::floor(v)) fail(fmt::format("expected a whole number from {} to {}", min, max));
    return static_cast<int>(v);
  }
  std::string string() const {
    if (!json_->is_string() || json_->get_ref<const std::string&>().find('\0') != std::string::npos) fail("expected a string");
    return json_->get<std::string>();
  }
  /// Letters, digits, _ - . only and no dot at the beginning: a name that cannot lead out of a folder.
  std::string plain_name(const std::string& folder) const {
    const std::string text = string();
    const std::string name = text.starts_with(folder) ? text.substr(folder.size()) : "";
    const auto plain = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '-' || c == '.'; };
    if (name.empty() || name.size() > 100 || name[0] == '.' || !std::all_of(name.begin(), name.end(), plain))
      fail(fmt::format("expected \"{}NAME\" with letters, digits, _, - and . only", folder));
    return text;
  }
  std::string checksum() const {
    const std::string text = string();
    if (text.size() != 32 || text.find_first_not_of("0123456789abcdef") != std::string::npos) fail("expected a checksum of 32 hex digits");
    return text;
  }

 private:
  const Json* json_;
  std::string file_, path_;
};

FrameRecord read_frame_record(const Field& json) {
  FrameRecord frame;
  frame.file = json["file"].plain_name("frames/");
  frame.exposure_s = json["exposure_s"].number(1e-9, 1e6);
  if (json.has("gain_db")) frame.gain_db = json["gain_db"].number(-200, 200);
  frame.checksum = json["checksum"].checksum();
  if (json.has("source")) frame.source = json["source"].string();
  if (json.has("time_s")) frame.time_s = json["time_s"].number(-1e9, 1e9);
  return frame;
}

/// `planned`: what the rig file says of this view.
ViewRecord read_view_record(const Field& json, const PlannedView& planned, int n_lights) {
  ViewRecord view;
  view.kind = planned.kind;
  // Sessions from before there were others have measurement views only and do not say so.
  const std::string kind = json.has("kind") ? json["kind"].string() : name_of(ViewKind::measurement);
  if (kind != name_of(planned.kind)) json.fail(fmt::format("kind: \"{}\"; the plan in rig.toml says \"{}\"", kind, name_of(planned.kind)));
  view.id = json["id"].plain_name("");
  view.turntable_angle = json["turntable_angle_rad"].number(-1e4, 1e4);
  view.light = planned.kind == ViewKind::dark ? json["light"].integer(-1, -1) : json["light"].integer(0, n_lights - 1);
  for (const Field& frame : json["frames"].items(1, max_frames_per_view)) {
    view.frames.push_back(read_frame_record(frame));
    const double asked = frame.has("asked_exposure_s") ? frame["asked_exposure_s"].number(1e-9, 1e6) : view.frames.back().exposure_s;
    if (!view.exposures_s.empty() && asked < view.exposures_s.back()) frame["asked_exposure_s"].fail("expected ascending times");
    view.exposures_s.push_back(asked);
  }
  if (json.has("bracket")) {
    const Field bracket = json["bracket"];
    const int last_planned = static_cast<int>(planned.exposures_s.size()) - 1;
    const int first = bracket["first_exposure"].integer(0, last_planned), last = bracket["last_exposure"].integer(first, last_planned);
    view.bracket = {static_cast<std::size_t>(first), static_cast<std::size_t>(last), bracket["predicted_mean_loss"].number(0, 1e9),
                    bracket["predicted_largest_loss"].number(0, 1e9)};
  }
  return view;
}

/// The rig as it was at capture: its files are those of the session, unchanged.
void read_rig_of_session(const Field& root, Session& session) {
  for (const auto& [name, checksum] : root["rig_files"].members(100)) {
    const bool inside = name == "rig.toml" || (name.starts_with("rig/") && name.find("..") == std::string::npos);
    if (!inside) checksum.fail("expected rig.toml or a file in rig/");
    if (brdf::file_checksum(session.folder / name) != checksum.checksum())
      throw Error(ErrorCode::file, (session.folder / name).string() + ": was changed after the capture; session.json has another checksum");
    session.rig_files[name] = checksum.checksum();
  }
  if (!session.rig_files.contains("rig.toml")) root["rig_files"].fail("rig.toml is missing");
  session.rig = read_rig(session.folder / "rig.toml");
  session.rig.simulation.paint.clear();  // relative to where the rig file was; what was photographed is stated here
  if (root.has("paint")) session.rig.simulation.paint = root["paint"]["file"].string();
}

Json json_of(const ViewRecord& view, const PlannedView& planned) {
  Json frames = Json::array();
  for (std::size_t i = 0; i < view.frames.size(); ++i) {
    const FrameRecord& frame = view.frames[i];
    Json j;
    j["file"] = frame.file;
    j["exposure_s"] = frame.exposure_s;
    j["asked_exposure_s"] = i < view.exposures_s.size() ? view.exposures_s[i] : frame.exposure_s;
    if (frame.gain_db != 0) j["gain_db"] = frame.gain_db;
    if (frame.time_s) j["time_s"] = *frame.time_s;
    j["checksum"] = frame.checksum;
    if (!frame.source.empty()) j["source"] = frame.source;
    frames.push_back(std::move(j));
  }
  Json j;
  j["id"] = view.id;
  j["kind"] = name_of(view.kind);
  j["light"] = view.light;
  j["turntable_angle_rad"] = view.turntable_angle;
  j["asked_turntable_angle_rad"] = planned.turntable_angle;
  if (view.bracket)
    j["bracket"] = {{"first_exposure", view.bracket->first}, {"last_exposure", view.bracket->last},
                    {"predicted_mean_loss", view.bracket->mean_loss}, {"predicted_largest_loss", view.bracket->largest_loss}};
  j["frames"] = std::move(frames);
  return j;
}

}  // namespace

std::optional<double> ViewRecord::time_s() const {
  double sum = 0;
  for (const FrameRecord& frame : frames) {
    if (!frame.time_s) return std::nullopt;
    sum += *frame.time_s + frame.exposure_s / 2;
  }
  if (frames.empty()) return std::nullopt;
  return sum / static_cast<double>(frames.size());
}

std::vector<std::size_t> Session::views_of(ViewKind kind) const {
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < views.size(); ++i)
    if (views[i].kind == kind) indices.push_back(i);
  return indices;
}

void write_session(const Session& session) {
  const RigDescription& rig = session.rig;
  if (session.views.size() > rig.plan.size())
    throw Error(ErrorCode::usage, fmt::format("{}: {} views, but the plan has {}", session.folder.string(), session.views.size(), rig.plan.size()));
  Json j;
  j["version"] = format_version;
  j["software"] = session.software;
  j["command"] = session.command_line;
  j["units"] = {{"angle", "rad"}, {"exposure", "s"}, {"time", "s since the capture began, start of the exposure"}, {"frames", "DN, mosaic not interpolated, black not subtracted"}};
  j["rig"] = rig.name;
  j["rig_files"] = Json::object();
  for (const auto& [name, checksum] : session.rig_files) j["rig_files"][name] = checksum;
  if (!rig.simulation.paint.empty()) {
    const fs::path paint = fs::absolute(rig.simulation.paint).lexically_normal();
    j["paint"]["file"] = paint.string();
    std::error_code status;
    if (fs::is_regular_file(paint, status)) j["paint"]["checksum"] = brdf::file_checksum(paint);
    j["seed"] = rig.simulation.seed;
  }
  j["plan"] = {{"views", rig.plan.size()}};
  j["views"] = Json::array();
  for (std::size_t i = 0; i < session.views.size(); ++i) j["views"].push_back(json_of(session.views[i], rig.plan[i]));
  brdf::write_text_atomically(session.folder / "session.json", j.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

Session read_session(const fs::path& folder) {
  const fs::path file = folder / "session.json";
  std::error_code status;
  if (!fs::is_directory(folder, status)) throw Error(ErrorCode::file, folder.string() + ": no such folder; expected a session");
  if (!fs::exists(file, status))
    throw Error(ErrorCode::file, folder.string() + ": not a session, or its capture did not end: it has no session.json");
  Json json;
  try {
    json = Json::parse(brdf::read_text(file, 512u << 20));
  } catch (const Json::exception& e) {
    throw Error(ErrorCode::file, fmt::format("{}: not valid JSON: {}", file.string(), e.what()));
  }
  const Field root(json, file.string(), "");
  if (const int version = root["version"].integer(0, 1000000); version != format_version)
    root["version"].fail(fmt::format("expected {}, got {}; the session was written by another version of Lacquer", format_version, version));

  Session session;
  session.folder = folder;
  session.software = root["software"].string();
  session.command_line = root["command"].string();
  read_rig_of_session(root, session);
  auto& plan = session.rig.plan;
  std::set<std::string> ids, files;
  for (const Field& item : root["views"].items(1, std::min(max_views, plan.size()))) {
    ViewRecord view = read_view_record(item, plan[session.views.size()], static_cast<int>(session.rig.geometry.lights.size()));
    if (!ids.insert(view.id).second) item["id"].fail(fmt::format("\"{}\" is there twice", view.id));
    std::vector<fs::path> sources;
    for (const FrameRecord& frame : view.frames) {
      if (!files.insert(frame.file).second) item["frames"].fail(fmt::format("\"{}\" is there twice", frame.file));
      if (!frame.source.empty()) sources.push_back(frame.source);
    }
    plan[session.views.size()].files = std::move(sources);  // the paths of the rig file are relative to where it was
    session.views.push_back(std::move(view));
  }
  return session;
}

RawFrame read_session_frame(const Session& session, const FrameRecord& record) {
  const fs::path file = session.frame_path(record);
  const auto bytes = brdf::read_bytes(file, std::uint64_t{1} << 30);
  const std::string checksum = brdf::checksum(bytes);
  if (checksum != record.checksum)
    throw Error(ErrorCode::file, fmt::format("{}: checksum is {}, session.json says {}; the file was changed or is cut short", file.string(),
                                             checksum, record.checksum));
  RawFrame frame = decode_frame(bytes, file.string(), session.rig.sensor.bits, session.rig.sensor.layout);
  check_format(frame, session.rig, file.string());
  frame.actual = {record.exposure_s, record.gain_db};
  return frame;
}

void check_format(const RawFrame& frame, const RigDescription& rig, const std::string& name) {
  const CameraModel& camera = rig.geometry.camera;
  if (frame.width != camera.width || frame.height != camera.height)
    throw Error(ErrorCode::file, fmt::format("{}: {} x {} pixels; expected {} x {} as in the rig file", name, frame.width, frame.height,
                                             camera.width, camera.height));
  if (frame.layout != rig.sensor.layout)
    throw Error(ErrorCode::file, fmt::format("{}: pixel layout {}; expected {} as in the rig file", name, name_of(frame.layout),
                                             name_of(rig.sensor.layout)));
  if (frame.bits != rig.sensor.bits)
    throw Error(ErrorCode::file, fmt::format("{}: {} bits; expected {} as in the rig file", name, frame.bits, rig.sensor.bits));
}

}  // namespace lacquer::acquire
