#pragma once

#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>

#include "libacquire/capture_journal.h"
#include "libacquire/session.h"

namespace lacquer::acquire {

/// Writes, records and hands over frames on a thread of its own while the next ones are taken. Internal to capture_session.
class FrameWriter {
 public:
  struct Item {
    std::size_t view = 0, exposure = 0;
    FrameRecord record;  ///< without checksum, unless on_disk
    RawFrame frame;      ///< not used if on_disk
    bool on_disk = false;  ///< from an earlier run: only read and handed over
  };

  /// Completed views are appended to session.views; nobody else touches them until finish().
  FrameWriter(Session& session, CaptureJournal& journal, const FrameSink& sink);
  /// Writes and records what still waits (without handing it over), unless writing failed.
  ~FrameWriter();
  FrameWriter(const FrameWriter&) = delete;
  FrameWriter& operator=(const FrameWriter&) = delete;

  /// Begins a view; as many frames as it has exposures_s follow. `recorded`: its angle and bracket are in the journal already.
  void begin_view(ViewRecord view, bool recorded);
  /// Waits while too many frames wait. Throws what writing or the sink threw.
  void push(Item item);
  void finish();

 private:
  void run();
  void process(Item& item);

  Session& session_;
  CaptureJournal& journal_;
  const FrameSink& sink_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Item> waiting_;
  std::size_t waiting_bytes_ = 0;
  std::deque<std::pair<ViewRecord, bool>> begun_;  ///< views whose first frame has not been processed; and whether they are recorded
  bool ending_ = false, abandoned_ = false;
  std::exception_ptr failure_;
  ViewRecord view_;  ///< of the thread
  std::thread thread_;
};

}  // namespace lacquer::acquire
