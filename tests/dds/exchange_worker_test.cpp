// The thread between a vehicle and its network, over real sockets: budget and watchdog.
#include "dds_testing.hpp"

#include <convoy/components/exchange_worker.hpp>
#include <convoy/dds/impaired_transport.hpp>
#include <convoy/submap/rounding.hpp>

#include "../unit/sample_facts.hpp"

#include <atomic>
#include <thread>

namespace convoy::dds::testing {
namespace {

using Worker = ExchangeWorker<SE2>;
double seconds_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

std::size_t anchors_in(const std::vector<Message<SE2>>& messages) {
  std::size_t count = 0;
  for (const auto& message : messages) count += std::holds_alternative<AnchorFact<SE2>>(message.payload);
  return count;
}

TEST(ExchangeWorkerOverDds, KeepsToItsBudgetByTheBytesOnTheWire) {
  constexpr double budget = 20'000.0, burst_s = 0.5;
  DdsExchange<SE2> peer(config_of_this_test());
  const DdsConfig network = config_of_this_test();
  Worker worker([&] { return std::make_unique<DdsExchange<SE2>>(network); },
                {.bytes_per_s = budget, .burst_s = burst_s}, {});
  ASSERT_TRUE(peer.wait_for_peers(1, deadline_s));
  // What is written before both know each other comes later as history, which no budget holds back.
  ASSERT_TRUE(eventually([&] { return worker.live_peers() == 1U; }));
  const auto begin = std::chrono::steady_clock::now();
  const std::uint64_t before = worker.counters().bytes_sent;
  constexpr std::uint32_t facts = 300;
  for (std::uint32_t k = 0; k < facts; ++k)
    ASSERT_EQ(worker.send({test::chain_of(1), test::anchor(1, k)}), SendStatus::sent);
  std::size_t arrived = 0;
  ASSERT_TRUE(eventually([&] {
    arrived += anchors_in(peer.take(0.0));
    // Replies of the protocol are paid afterwards, so that it may be over by a few datagrams at any moment.
    EXPECT_LT(static_cast<double>(worker.counters().bytes_sent - before),
              budget * (burst_s + seconds_since(begin)) + 8000.0);
    return arrived == facts;
  }));
  EXPECT_GT(seconds_since(begin), static_cast<double>(facts) * 200.0 / budget - burst_s);
}

TEST(ExchangeWorkerOverDds, WhatTheWireCannotHoldHoldsNothingUp) {
  DdsExchange<SE2> peer(config_of_this_test());
  const DdsConfig network = config_of_this_test();
  Worker worker([&] { return std::make_unique<DdsExchange<SE2>>(network); }, {}, {});
  ASSERT_TRUE(peer.wait_for_peers(1, deadline_s));
  auto crooked = test::absolute_fix(1, 1);
  crooked.covariance(0, 1) *= 1.0 + 1e-15;
  ASSERT_EQ(worker.send({test::chain_of(1), crooked}), SendStatus::sent) << "it waits";
  ASSERT_EQ(worker.send({test::chain_of(1), LandmarkBatch<SE2>{{rounded(test::landmark(1, 4))}}}), SendStatus::sent);
  std::size_t landmarks = 0;
  EXPECT_TRUE(eventually([&] {
    for (const auto& message : peer.take(0.0)) landmarks += std::holds_alternative<LandmarkBatch<SE2>>(message.payload);
    return landmarks == 1;
  }));
  EXPECT_EQ(worker.worker_counters().outbox.unfit, 1U);
  EXPECT_EQ(worker.counters().send_rejected, 0U);
}

TEST(ExchangeWorkerOverDds, ANetworkThatHasGoneDeafIsOpenedAnewAndSpeaksAgain) {
  DdsConfig other = config_of_this_test();
  other.vehicle = 2;
  DdsExchange<SE2> peer(other);
  DdsConfig deaf = config_of_this_test();
  deaf.vehicle = 1;
  const DdsConfig sound = deaf;
  const auto network = impair(deaf, Impairments{});
  std::atomic<int> opened{0};
  Worker worker([&] { return std::make_unique<DdsExchange<SE2>>(opened++ == 0 ? deaf : sound); }, {},
                {.deaf_s = 2.0, .mute_s = 60.0, .lonely_s = 60.0, .pause_s = 1.0, .max_pause_s = 60.0});
  ASSERT_TRUE(eventually([&] { return worker.live_peers() == 1U && peer.peers() == 1; }));
  network->block(2);
  std::uint32_t said = 0;
  std::size_t heard = 0;
  ASSERT_TRUE(eventually([&] {
    (void)peer.send({test::chain_of(2), test::anchor(2, said++)});
    heard += anchors_in(worker.take(0.0));
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return worker.worker_counters().reopened >= 1;
  }));
  EXPECT_EQ(worker.worker_counters().last_ailment, Ailment::deaf);
  // The history of the peer is there again, from its first word.
  EXPECT_TRUE(eventually([&] {
    heard += anchors_in(worker.take(0.0));
    return heard >= said;
  }));
  (void)worker.send({test::chain_of(1), test::anchor(1, 0)});
  std::size_t back = 0;
  EXPECT_TRUE(eventually([&] { return (back += anchors_in(peer.take(0.0))) > 0; }));
}

}  // namespace
}  // namespace convoy::dds::testing
