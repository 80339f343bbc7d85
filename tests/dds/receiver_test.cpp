// When the thread that empties the readers does so.
#include <gtest/gtest.h>
#include <convoy/dds/receiver.hpp>

#include <atomic>
#include <future>

#include "dds_testing.hpp"

namespace convoy::dds::testing {
namespace {

TEST(Receiver, DrainsOnceForAllThatCameMeanwhile) {
  Receiver receiver;
  std::promise<void> go_on;
  std::atomic<int> calls = 0;
  receiver.start([&, waiting = go_on.get_future().share()] {
    if (++calls == 1) waiting.wait();
  });
  receiver.wake();
  ASSERT_TRUE(eventually([&] { return calls == 1; }));
  for (int i = 0; i < 100; ++i) receiver.wake();
  go_on.set_value();
  ASSERT_TRUE(eventually([&] { return calls == 2; }));
  EXPECT_FALSE(eventually([&] { return calls > 2; }, 0.1));
}

TEST(Receiver, ForgetsNothingThatCameBeforeItsStart) {
  Receiver receiver;
  receiver.wake();
  std::atomic<int> calls = 0;
  receiver.start([&] { ++calls; });
  EXPECT_TRUE(eventually([&] { return calls == 1; }));
}

// A call that leaves some of what came says so in this way.
TEST(Receiver, DrainsAgainWhenACallAsksForIt) {
  Receiver receiver;
  std::atomic<int> calls = 0;
  receiver.start([&] {
    if (++calls < 5) receiver.wake();
  });
  receiver.wake();
  EXPECT_TRUE(eventually([&] { return calls == 5; }));
  EXPECT_FALSE(eventually([&] { return calls > 5; }, 0.05));
}

TEST(Receiver, StopsThoughEachCallAsksForAnother) {
  Receiver receiver;
  std::atomic<int> calls = 0;
  receiver.start([&] {
    ++calls;
    receiver.wake();
  });
  receiver.wake();
  ASSERT_TRUE(eventually([&] { return calls > 2; }));
  receiver.stop();
  const int last = calls;
  EXPECT_FALSE(eventually([&] { return calls > last; }, 0.05));
}

TEST(Receiver, StopsWhenACallIsOver) {
  std::atomic<bool> inside = false, over = false;
  Receiver receiver;
  receiver.start([&] {
    inside = true;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    over = true;
  });
  receiver.wake();
  ASSERT_TRUE(eventually([&] { return inside.load(); }));
  receiver.stop();
  EXPECT_TRUE(over);
  over = false;
  receiver.wake();
  EXPECT_FALSE(eventually([&] { return over.load(); }, 0.05));
}

}  // namespace
}  // namespace convoy::dds::testing
