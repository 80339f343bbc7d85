#include <convoy/components/exchange_worker.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/groups.hpp>

#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>

namespace convoy {
namespace {

using test::chain_of;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

/// What a network does, seen from outside.
struct World {
  std::mutex mutex;
  std::vector<Message<SE2>> sent;
  std::atomic<int> opened{0}, open{0};
  std::atomic<bool> stuck{false};    ///< send() does not come back
  std::atomic<bool> refuses{false};  ///< send() says no
  std::atomic<bool> deaf{false};
  std::atomic<bool> cannot_open{false};
  std::atomic<bool> opening_throws_a_number{false};
  std::atomic<bool> throws{false};  ///< send() does, though it must not
  std::atomic<bool> slow{false};    ///< send() takes 20 ms
  std::atomic<std::size_t> peers{1};

  std::size_t count() {
    const std::lock_guard lock(mutex);
    return sent.size();
  }
};

class Network final : public SubmapExchange<SE2> {
 public:
  explicit Network(World& world) : world_(world), ails_(world.opened++ == 0) { ++world_.open; }
  ~Network() override { --world_.open; }
  SendStatus send(const Message<SE2>& message) override {
    if (world_.throws) throw std::runtime_error("out of sockets");
    if (world_.slow) std::this_thread::sleep_for(std::chrono::milliseconds(20));
    while (world_.stuck) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    if (world_.refuses && ails_) {
      ++rejected_;
      return SendStatus::rejected;
    }
    const std::lock_guard lock(world_.mutex);
    world_.sent.push_back(message);
    ++sent_;
    return SendStatus::sent;
  }
  std::vector<Message<SE2>> take(double) override {
    if (world_.deaf && ails_) return {};
    ++taken_;
    return {{chain_of(9), Digest{}}};
  }
  ExchangeCounters counters() const override {
    ExchangeCounters counters;
    counters.messages_sent = sent_;
    counters.messages_taken = taken_;
    counters.bytes_sent = 100 * sent_;
    counters.send_rejected = rejected_;
    return counters;
  }
  std::optional<std::size_t> live_peers() const override { return world_.peers; }

 private:
  World& world_;
  bool ails_;  // only the first one does
  std::atomic<std::uint64_t> sent_{0}, taken_{0}, rejected_{0};
};

class ExchangeWorkerTest : public testing::Test {
 protected:
  std::unique_ptr<ExchangeWorker<SE2>> worker(const BudgetParams& budget = {}, const WatchdogParams& watchdog = {}) {
    return std::make_unique<ExchangeWorker<SE2>>(
        [this]() -> std::unique_ptr<SubmapExchange<SE2>> {
          if (world_.opening_throws_a_number) throw 42;
          if (world_.cannot_open) throw ConfigError("no such interface");
          return std::make_unique<Network>(world_);
        },
        budget, watchdog);
  }
  template <class Done>
  static bool eventually(Done done, double timeout_s = 20.0) {
    for (const auto begin = Clock::now(); !done();) {
      if (seconds_since(begin) > timeout_s) return false;
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return true;
  }
  static constexpr WatchdogParams quick{
      .deaf_s = 1.0, .mute_s = 1.0, .lonely_s = 1.0, .pause_s = 1.0, .max_pause_s = 1.0};
  World world_;
};

TEST_F(ExchangeWorkerTest, WhoSendsNeverWaitsForTheNetwork) {
  world_.stuck = true;
  auto exchange = worker();
  const auto begin = Clock::now();
  for (std::uint32_t k = 0; k < 1000; ++k)
    EXPECT_EQ(exchange->send({chain_of(1), test::anchor(1, k)}), SendStatus::sent);
  exchange->take(0.0);
  EXPECT_EQ(world_.count(), 0U);
  EXPECT_LT(seconds_since(begin), 10.0);  // the network would take forever
  world_.stuck = false;
  EXPECT_TRUE(eventually([&] { return world_.count() == 1000; }));
}

TEST_F(ExchangeWorkerTest, ItKeepsToItsBudgetByTheBytesOfTheNetwork) {
  auto exchange = worker({.bytes_per_s = 2000.0, .burst_s = 0.5});  // 10 messages, then 20 per second
  const auto begin = Clock::now();
  for (std::uint32_t k = 0; k < 60; ++k) (void)exchange->send({chain_of(1), test::anchor(1, k)});
  EXPECT_TRUE(eventually([&] { return world_.count() == 60; }));
  EXPECT_GT(seconds_since(begin), 2.0);
}

TEST_F(ExchangeWorkerTest, ADeafNetworkIsOpenedAnewAndCountersGoOn) {
  world_.deaf = true;
  auto exchange = worker({}, quick);
  for (std::uint32_t k = 0; k < 5; ++k) (void)exchange->send({chain_of(1), test::anchor(1, k)});
  EXPECT_TRUE(eventually([&] {
    if (world_.opened == 1) exchange->take(0.0);
    return exchange->worker_counters().reopened == 1;
  }));
  EXPECT_EQ(exchange->worker_counters().last_ailment, Ailment::deaf);
  EXPECT_EQ(world_.opened, 2);
  EXPECT_EQ(world_.open, 1);
  EXPECT_FALSE(exchange->take(0.0).empty());
  EXPECT_EQ(exchange->counters().messages_sent, 5U);
}

TEST_F(ExchangeWorkerTest, WhereNobodyTakesTheNetworkIsNotDeaf) {
  auto exchange = worker({}, quick);
  std::this_thread::sleep_for(std::chrono::milliseconds(2500));
  EXPECT_EQ(exchange->worker_counters().reopened, 0U);
}

TEST_F(ExchangeWorkerTest, AfterAnExceptionItGoesOn) {
  auto exchange = worker({}, quick);
  world_.throws = true;
  (void)exchange->send({chain_of(1), test::anchor(1, 0)});
  EXPECT_TRUE(eventually([&] { return exchange->worker_counters().failures.count >= 1; }));
  EXPECT_EQ(exchange->worker_counters().failures.last_error, "out of sockets");
  world_.throws = false;
  (void)exchange->send({chain_of(1), test::anchor(1, 1)});
  EXPECT_TRUE(eventually([&] { return world_.count() == 1; }));
}

TEST_F(ExchangeWorkerTest, WhateverOpeningThrowsItIsTriedAgain) {
  auto exchange = worker({}, quick);
  std::this_thread::sleep_for(std::chrono::milliseconds(700));  // it has seen its peer
  world_.opening_throws_a_number = true;
  world_.peers = 0;
  EXPECT_TRUE(eventually([&] { return exchange->worker_counters().reopen_failed >= 1; }));
  world_.opening_throws_a_number = false;
  EXPECT_TRUE(eventually([&] { return exchange->worker_counters().reopened >= 1; }));
}

TEST_F(ExchangeWorkerTest, ItsEndIsBounded) {
  world_.slow = true;
  auto exchange = worker();
  for (std::uint32_t k = 0; k < 500; ++k) (void)exchange->send({chain_of(1), test::anchor(1, k)});
  const auto begin = Clock::now();
  exchange.reset();
  EXPECT_LT(seconds_since(begin), 4.0);  // all of it would take ten seconds
  EXPECT_LT(world_.count(), 500U);
}

TEST_F(ExchangeWorkerTest, WhatAMuteNetworkRefusedIsSentByTheNext) {
  world_.refuses = true;
  auto exchange = worker({}, quick);
  for (std::uint32_t k = 0; k < 5; ++k) (void)exchange->send({chain_of(1), test::anchor(1, k)});
  EXPECT_TRUE(eventually([&] {
    exchange->take(0.0);
    return world_.count() == 5;
  }));
  EXPECT_EQ(exchange->worker_counters().last_ailment, Ailment::mute);
}

TEST_F(ExchangeWorkerTest, WhatCannotBeOpenedIsTriedAgain) {
  auto exchange = worker({}, quick);
  std::this_thread::sleep_for(std::chrono::milliseconds(700));  // it has seen its peer
  world_.cannot_open = true;
  world_.peers = 0;
  EXPECT_TRUE(eventually([&] { return exchange->worker_counters().reopen_failed >= 1; }));
  EXPECT_EQ(exchange->worker_counters().last_ailment, Ailment::lonely);
  EXPECT_EQ(exchange->worker_counters().last_error, "no such interface");
  EXPECT_TRUE(exchange->take(0.0).empty());
  (void)exchange->send({chain_of(1), test::anchor(1, 0)});
  world_.cannot_open = false;
  world_.peers = 1;
  EXPECT_TRUE(eventually([&] { return world_.count() == 1; }));
}

TEST_F(ExchangeWorkerTest, WhatCannotBeOpenedAtFirstIsAnError) {
  world_.cannot_open = true;
  EXPECT_THROW(worker(), ConfigError);
}

TEST_F(ExchangeWorkerTest, ItGoesWhileManySendAndTake) {
  auto exchange = worker({}, quick);
  std::vector<std::thread> hosts;
  for (VehicleId v = 1; v <= 3; ++v)
    hosts.emplace_back([&, v] {
      for (std::uint32_t k = 0; k < 500; ++k) {
        (void)exchange->send({chain_of(v), test::anchor(v, k)});
        exchange->take(0.0);
      }
    });
  for (auto& host : hosts) host.join();
  exchange.reset();  // sends what is left
  EXPECT_EQ(world_.count(), 1500U);
  EXPECT_EQ(world_.open, 0);
}

}  // namespace
}  // namespace convoy
