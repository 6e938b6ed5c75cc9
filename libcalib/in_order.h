#pragma once

#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace lacquer::calib {

/// Hands things 0 ... n - 1, which several threads make at the same time, to one consumer in their order: whoever has made one consumes all whose turn it
/// is, unless another thread does so at the moment. At most `n_slots` are being made or wait, thing i in slot i % n_slots. Much less work per thing than a
/// pipeline of tasks, for things of some microseconds.
class InOrder {
 public:
  InOrder(std::size_t n, std::size_t n_slots) : n_(n), made_(n_slots) {}
  std::size_t n_slots() const { return made_.size(); }

  /// For each of the threads, which may be any number, also one after the other: `make(i, slot)` at the same time for different i, `consume(i, slot)` one by
  /// one. Returns when nothing is left to make; all is consumed when all threads have returned. What either throws ends the work of all
  /// threads, whether or not what was made is consumed.
  template <typename Make, typename Consume>
  void work(const Make& make, const Consume& consume) try {
    for (std::size_t i; (i = next_.fetch_add(1)) < n_;) {
      while (i >= consumed_ + n_slots())  // for the thread that makes the one whose turn it is
        if (std::this_thread::yield(); stopped_) return;
      make(i, i % n_slots());
      made_[i % n_slots()] = i + 1;
      while (is_made(consumed_) && !consuming_.test_and_set()) {
        for (std::size_t k = consumed_; is_made(k); consumed_ = ++k) consume(k, k % n_slots());
        consuming_.clear();  // what was made only now its maker may have left to this thread: look once more
      }
    }
  } catch (...) {
    stopped_ = true;
    throw;
  }

 private:
  bool is_made(std::size_t i) const { return made_[i % n_slots()] == i + 1; }

  std::size_t n_;
  std::vector<std::atomic<std::size_t>> made_;  ///< by slot: 1 + the last thing made there
  std::atomic<std::size_t> next_ = 0, consumed_ = 0;
  std::atomic_flag consuming_;
  std::atomic<bool> stopped_ = false;
};

}  // namespace lacquer::calib
