#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "libacquire/session.h"

/// What a capture that has not ended has on disk: SESSION/capture.jsonl, one JSON object a line, the first for the session, then one for each
/// view that was begun and one for each frame that is safely on disk. A line cut short by a crash is not counted. Internal to libacquire.
namespace lacquer::acquire {

struct JournalContent {
  std::string software, command_line;
  double begun_unix_s = 0;                                                ///< wall clock when the capture began, seconds since 1970 UTC
  std::map<std::string, std::string> rig_files;                           ///< as Session
  struct View {
    double turntable_angle = 0;            ///< read back, radians
    std::optional<BracketChoice> bracket;
  };
  std::map<std::size_t, View> views;                                      ///< those that were begun
  std::map<std::pair<std::size_t, std::size_t>, FrameRecord> frames;      ///< view and exposure
};

/// nullopt: there is no journal, or nothing of it was written before the crash. Error{file} naming the line that is not one of a journal.
std::optional<JournalContent> read_journal(const std::filesystem::path& folder);

/// Appends lines, each on disk before the call returns.
class CaptureJournal {
 public:
  /// Begins a journal, or goes on with the one that is there. `begun_unix_s`: as JournalContent.
  CaptureJournal(const std::filesystem::path& folder, const Session& session, bool begin, double begun_unix_s);
  ~CaptureJournal();
  CaptureJournal(const CaptureJournal&) = delete;
  CaptureJournal& operator=(const CaptureJournal&) = delete;

  void view(std::size_t view, double turntable_angle, const std::optional<BracketChoice>& bracket);
  void frame(std::size_t view, std::size_t exposure, const FrameRecord& record);
  /// The session is written: the journal goes.
  void remove();

 private:
  void append(const std::string& line);
  std::filesystem::path file_;
  int descriptor_ = -1;
};

/// Held while a capture writes into a folder; the system lets go of it when the process ends, however it ends.
class SessionLock {
 public:
  /// Throws Error{file} when another process holds it.
  explicit SessionLock(const std::filesystem::path& folder);
  ~SessionLock();
  SessionLock(const SessionLock&) = delete;
  SessionLock& operator=(const SessionLock&) = delete;

 private:
  std::filesystem::path file_;
  int descriptor_ = -1;
};

}  // namespace lacquer::acquire
