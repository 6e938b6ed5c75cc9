#include "libcalib/in_order.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <numeric>
#include <stdexcept>

namespace lacquer::calib {
namespace {

void on_threads(int n, const auto& what) {
  std::vector<std::thread> threads;
  for (int k = 0; k < n; ++k) threads.emplace_back(what);
  for (std::thread& t : threads) t.join();
}

/// Takes longer for some things than for others.
void dawdle(std::size_t i) {
  if (i % 7 == 0) std::this_thread::sleep_for(std::chrono::microseconds(50));
  if (i % 3 == 0) std::this_thread::yield();
}

TEST(InOrder, EveryThingIsMadeOnceAndConsumedInOrderFromItsOwnSlot) {
  constexpr std::size_t n = 5000;
  for (const int n_threads : {1, 2, 8})
    for (const std::size_t n_slots : {std::size_t{1}, std::size_t{4}, std::size_t{16}}) {
      InOrder queue(n, n_slots);
      std::vector<std::size_t> slots(n_slots), consumed;
      std::vector<std::atomic<int>> made(n);
      on_threads(n_threads, [&] {
        queue.work([&](std::size_t i, std::size_t slot) { dawdle(i), slots[slot] = 3 * i, ++made[i]; },
                   [&](std::size_t i, std::size_t slot) { consumed.push_back(slots[slot] == 3 * i ? i : n); });
      });
      std::vector<std::size_t> expected(n);
      std::iota(expected.begin(), expected.end(), std::size_t{0});
      EXPECT_EQ(consumed, expected) << n_threads << " threads, " << n_slots << " slots";
      EXPECT_TRUE(std::all_of(made.begin(), made.end(), [](int times) { return times == 1; }));
    }
}

TEST(InOrder, NothingToMakeIsNoWork) {
  InOrder queue(0, 4);
  queue.work([](std::size_t, std::size_t) { FAIL(); }, [](std::size_t, std::size_t) { FAIL(); });
}

TEST(InOrder, WhatOneThreadThrowsStopsTheOthers) {
  InOrder queue(1000, 4);
  std::atomic<int> thrown = 0;
  std::size_t consumed = 0;
  on_threads(4, [&] {
    try {
      queue.work(
          [](std::size_t i, std::size_t) {
            dawdle(i);
            if (i == 100) throw std::runtime_error("broken");
          },
          [&](std::size_t, std::size_t) { ++consumed; });
    } catch (const std::runtime_error&) {
      ++thrown;
    }
  });
  EXPECT_EQ(thrown, 1);
  EXPECT_LE(consumed, 100u);
}

}  // namespace
}  // namespace lacquer::calib
