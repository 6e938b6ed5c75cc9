#include "libacquire/capture_journal.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <regex>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::acquire {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int journal_version = 2;
constexpr std::uint64_t max_journal_bytes = std::uint64_t{1} << 30;

fs::path journal_file(const fs::path& folder) { return folder / "capture.jsonl"; }

[[noreturn]] void fail_system(const fs::path& file, const char* what) {
  throw Error(ErrorCode::file, fmt::format("{}: {}: {}", file.string(), what, std::strerror(errno)));
}

std::size_t index_of(const Json& line, const char* key) {
  const Json& value = line.at(key);
  if (!value.is_number_unsigned()) throw Error(ErrorCode::file, fmt::format("{}: expected a number from 0 on", key));
  return value.get<std::size_t>();
}

double finite(const Json& line, const char* key) {
  const double value = line.at(key).get<double>();
  if (!std::isfinite(value)) throw Error(ErrorCode::file, fmt::format("{}: expected a finite number", key));
  return value;
}

/// "frames/", a letter and digits, "_E" and digits, ".tiff". Whether it is the frame of this view is for who knows the plan.
bool is_frame_name(const std::string& name) {
  static const std::regex form("frames/[LRD][0-9]{3,9}_E[0-9]{2,9}\\.tiff");
  return std::regex_match(name, form);
}

void read_header(const Json& line, JournalContent& content) {
  if (line.at("version").get<int>() != journal_version)
    throw Error(ErrorCode::file, fmt::format("version: expected {}; begun by another version of Lacquer", journal_version));
  content.software = line.at("software").get<std::string>();
  content.command_line = line.at("command").get<std::string>();
  content.begun_unix_s = finite(line, "begun_unix_s");
  for (const auto& [name, checksum] : line.at("rig_files").items()) content.rig_files[name] = checksum.get<std::string>();
}

void read_line(const Json& line, JournalContent& content) {
  const std::size_t view = index_of(line, "view");
  if (line.contains("turntable_angle_rad")) {
    JournalContent::View& begun = content.views[view];
    begun.turntable_angle = finite(line, "turntable_angle_rad");
    if (line.contains("bracket")) {
      const Json& bracket = line.at("bracket");
      begun.bracket = {index_of(bracket, "first"), index_of(bracket, "last"), finite(bracket, "mean_loss"), finite(bracket, "largest_loss")};
    }
    return;
  }
  FrameRecord record;
  record.file = line.at("file").get<std::string>();
  const std::size_t exposure = index_of(line, "exposure");
  if (!is_frame_name(record.file)) throw Error(ErrorCode::file, "file: expected frames/L000_E00.tiff or the like");
  record.exposure_s = finite(line, "exposure_s");
  record.gain_db = finite(line, "gain_db");
  record.checksum = line.at("checksum").get<std::string>();
  record.source = line.at("source").get<std::string>();
  if (line.contains("time_s")) record.time_s = finite(line, "time_s");
  content.frames[{view, exposure}] = std::move(record);
}

}  // namespace

std::optional<JournalContent> read_journal(const fs::path& folder) {
  const fs::path file = journal_file(folder);
  std::error_code status;
  if (!fs::exists(file, status)) return std::nullopt;
  const std::string text = brdf::read_text(file, max_journal_bytes);
  JournalContent content;
  std::size_t start = 0, number = 1;
  for (std::size_t end; (end = text.find('\n', start)) != std::string::npos; start = end + 1, ++number) {
    try {
      const Json line = Json::parse(text.begin() + static_cast<std::ptrdiff_t>(start), text.begin() + static_cast<std::ptrdiff_t>(end));
      number == 1 ? read_header(line, content) : read_line(line, content);
    } catch (const Json::exception&) {
      throw Error(ErrorCode::file, fmt::format("{}:{}: not a line of a capture journal; the capture cannot be resumed", file.string(), number));
    } catch (const Error& e) {
      throw Error(ErrorCode::file, fmt::format("{}:{}: {}", file.string(), number, e.what()));
    }
  }
  if (number == 1) return std::nullopt;
  return content;
}

CaptureJournal::CaptureJournal(const fs::path& folder, const Session& session, bool begin, double begun_unix_s) : file_(journal_file(folder)) {
  descriptor_ = ::open(file_.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | (begin ? O_TRUNC : 0), 0644);
  if (descriptor_ < 0) fail_system(file_, "cannot be written");
  if (!begin) {
    // The rest of a line that a crash cut short goes.
    const std::string text = brdf::read_text(file_, max_journal_bytes);
    if (::ftruncate(descriptor_, static_cast<off_t>(text.rfind('\n') + 1)) != 0) fail_system(file_, "cannot be written");
    return;
  }
  Json header;
  header["version"] = journal_version;
  header["software"] = session.software;
  header["command"] = session.command_line;
  header["begun_unix_s"] = begun_unix_s;
  header["rig_files"] = Json::object();
  for (const auto& [name, checksum] : session.rig_files) header["rig_files"][name] = checksum;
  append(header.dump(-1, ' ', false, Json::error_handler_t::replace));
}

CaptureJournal::~CaptureJournal() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void CaptureJournal::append(const std::string& line) {
  const std::string text = line + "\n";
  const ssize_t written = ::write(descriptor_, text.data(), text.size());
  if (written != static_cast<ssize_t>(text.size())) {
    if (written >= 0) errno = ENOSPC;
    fail_system(file_, "cannot be written; is the disk full?");
  }
  if (::fdatasync(descriptor_) != 0 && errno != EINVAL) fail_system(file_, "cannot be written to disk");
}

void CaptureJournal::view(std::size_t view, double turntable_angle, const std::optional<BracketChoice>& bracket) {
  Json j;
  j["view"] = view;
  j["turntable_angle_rad"] = turntable_angle;
  if (bracket)
    j["bracket"] = {{"first", bracket->first}, {"last", bracket->last}, {"mean_loss", bracket->mean_loss}, {"largest_loss", bracket->largest_loss}};
  append(j.dump());
}

void CaptureJournal::frame(std::size_t view, std::size_t exposure, const FrameRecord& record) {
  Json j;
  j["view"] = view;
  j["exposure"] = exposure;
  j["file"] = record.file;
  j["exposure_s"] = record.exposure_s;
  j["gain_db"] = record.gain_db;
  j["checksum"] = record.checksum;
  j["source"] = record.source;
  if (record.time_s) j["time_s"] = *record.time_s;
  append(j.dump(-1, ' ', false, Json::error_handler_t::replace));
}

void CaptureJournal::remove() {
  std::error_code ignored;
  fs::remove(file_, ignored);
}

SessionLock::SessionLock(const fs::path& folder) : file_(folder / "capture.lock") {
  descriptor_ = ::open(file_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (descriptor_ < 0) fail_system(file_, "cannot be written");
  if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
    ::close(descriptor_);
    throw Error(ErrorCode::file, folder.string() + ": another capture is writing into this folder; wait for it or choose another folder");
  }
}

SessionLock::~SessionLock() {
  std::error_code ignored;
  fs::remove(file_, ignored);  // before it is let go: whoever opened it meanwhile holds a file without a name, and sees the session anyway
  ::close(descriptor_);
}

}  // namespace lacquer::acquire
