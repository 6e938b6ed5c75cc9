#include "libacquire/frame_writer.h"

#include <utility>

namespace lacquer::acquire {

namespace {

constexpr std::size_t max_waiting = 64;  // frames that are on disk already have no bytes

std::size_t bytes_of(const FrameWriter::Item& item) { return item.frame.data.size() * sizeof(item.frame.data[0]); }

}  // namespace

FrameWriter::FrameWriter(Session& session, CaptureJournal& journal, const FrameSink& sink)
    : session_(session), journal_(journal), sink_(sink), thread_([this] { run(); }) {}

FrameWriter::~FrameWriter() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
    abandoned_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void FrameWriter::begin_view(ViewRecord view, bool recorded) {
  const std::lock_guard lock(mutex_);
  begun_.emplace_back(std::move(view), recorded);
}

void FrameWriter::push(Item item) {
  std::unique_lock lock(mutex_);
  const std::size_t bytes = bytes_of(item);
  changed_.wait(lock, [&] {
    return waiting_.size() < min_waiting_frames || (waiting_.size() < max_waiting && waiting_bytes_ + bytes <= max_waiting_bytes) || failure_;
  });
  if (failure_) std::rethrow_exception(failure_);
  waiting_bytes_ += bytes;
  waiting_.push_back(std::move(item));
  changed_.notify_all();
}

void FrameWriter::finish() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  thread_.join();
  if (failure_) std::rethrow_exception(failure_);
}

void FrameWriter::run() {
  while (true) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return !waiting_.empty() || ending_; });
    if (waiting_.empty()) return;
    Item item = std::move(waiting_.front());
    waiting_.pop_front();
    waiting_bytes_ -= bytes_of(item);
    changed_.notify_all();
    lock.unlock();
    try {
      process(item);
    } catch (...) {
      lock.lock();
      failure_ = std::current_exception();
      changed_.notify_all();
      return;
    }
  }
}

void FrameWriter::process(Item& item) {
  bool hand_over, recorded = true;
  {
    const std::lock_guard lock(mutex_);
    hand_over = !abandoned_;
    if (view_.frames.empty()) {
      view_ = std::move(begun_.front().first);
      recorded = begun_.front().second;
      begun_.pop_front();
    }
  }
  if (!recorded) journal_.view(item.view, view_.turntable_angle, view_.bracket);
  if (item.on_disk) {
    if (hand_over && sink_.frame) item.frame = read_session_frame(session_, item.record);
  } else {
    item.record.checksum = write_frame((session_.folder / item.record.file).string(), item.frame);
    journal_.frame(item.view, item.exposure, item.record);
  }
  view_.frames.push_back(item.record);
  if (hand_over && sink_.frame) sink_.frame(view_, item.frame);
  if (view_.frames.size() < view_.exposures_s.size()) return;
  if (hand_over && sink_.view) sink_.view(view_);
  session_.views.push_back(std::exchange(view_, {}));
}

}  // namespace lacquer::acquire
