// The contract of SubmapExchange as a battery of tests that every implementation runs.
//
// A network under test is a default-constructible class with
//   using Group = ...;
//   std::unique_ptr<SubmapExchange<Group>> join();          a new endpoint
//   bool connect(std::size_t n);                            true once the n endpoints joined so far can hear each other
//   void pause();                                           lets a moment pass in which messages may arrive
//   static constexpr bool keeps_history;                    late joiners get the facts sent before they came
// and one line: INSTANTIATE_TYPED_TEST_SUITE_P(Name, ExchangeContract, ::testing::Types<MyNetwork>);
#pragma once

#include <convoy/exchange/submap_exchange.hpp>

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <variant>
#include <vector>

namespace convoy::testing {

template <class G>
Message<G> anchor_message(VehicleId vehicle, std::uint32_t index) {
  AnchorFact<G> fact;
  fact.key = {{vehicle, 1}, index};
  fact.state.stamp_s = index;
  fact.state.abscissa_m = 25.0 * index;
  return {{vehicle, 1}, fact};
}

template <class G>
Message<G> landmark_message(VehicleId vehicle, std::uint32_t first, std::uint32_t count) {
  LandmarkBatch<G> batch;
  for (std::uint32_t i = first; i < first + count; ++i) {
    LandmarkFact<G> fact;
    fact.key = {{vehicle, 1}, i};
    fact.anchor = 0;
    fact.position.setConstant(i);
    fact.covariance.setIdentity();
    batch.landmarks.push_back(fact);
  }
  return {{vehicle, 1}, batch};
}

template <class Network>
class ExchangeContract : public ::testing::Test {
 public:
  using Group = typename Network::Group;

  /// Takes until `count` messages are there or the deadline has passed.
  std::vector<Message<Group>> collect(SubmapExchange<Group>& exchange, std::size_t count) {
    std::vector<Message<Group>> all;
    const auto start = std::chrono::steady_clock::now();
    while (all.size() < count && std::chrono::steady_clock::now() - start < std::chrono::seconds(20)) {
      for (Message<Group>& message : exchange.take(now_s_ += 1.0)) all.push_back(std::move(message));
      if (all.size() < count) network_.pause();
    }
    return all;
  }

  /// What is there after a while in which nothing ought to come.
  std::vector<Message<Group>> leftovers(SubmapExchange<Group>& exchange) {
    network_.pause();
    return exchange.take(now_s_ += 1.0);
  }

  Network network_;
  double now_s_ = 0.0;
};
TYPED_TEST_SUITE_P(ExchangeContract);

TYPED_TEST_P(ExchangeContract, DeliversToEveryPeerAndNeverToOneself) {
  using G = typename TypeParam::Group;
  std::vector<std::unique_ptr<SubmapExchange<G>>> peers;
  for (int i = 0; i < 3; ++i) peers.push_back(this->network_.join());
  ASSERT_TRUE(this->network_.connect(3));
  ASSERT_EQ(peers[0]->send(anchor_message<G>(1, 0)), SendStatus::sent);
  for (int i = 1; i < 3; ++i) {
    const auto got = this->collect(*peers[static_cast<std::size_t>(i)], 1);
    ASSERT_EQ(got.size(), 1U);
    EXPECT_EQ(got[0].sender, (ChainId{1, 1}));
    ASSERT_TRUE(std::holds_alternative<AnchorFact<G>>(got[0].payload));
  }
  EXPECT_TRUE(this->leftovers(*peers[0]).empty());
}

TYPED_TEST_P(ExchangeContract, KeepsTheOrderOfASender) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  auto b = this->network_.join();
  ASSERT_TRUE(this->network_.connect(2));
  constexpr std::uint32_t n = 200;
  for (std::uint32_t i = 0; i < n; ++i) ASSERT_EQ(a->send(anchor_message<G>(1, i)), SendStatus::sent);
  const auto got = this->collect(*b, n);
  ASSERT_EQ(got.size(), n);
  for (std::uint32_t i = 0; i < n; ++i) EXPECT_EQ(std::get<AnchorFact<G>>(got[i].payload).key.index, i);
}

TYPED_TEST_P(ExchangeContract, TakeDoesNotBlockAndGivesAMessageOnce) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  auto b = this->network_.join();
  ASSERT_TRUE(this->network_.connect(2));
  const auto start = std::chrono::steady_clock::now();
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(b->take(this->now_s_).empty());
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(1));
  ASSERT_EQ(a->send(anchor_message<G>(1, 0)), SendStatus::sent);
  EXPECT_EQ(this->collect(*b, 1).size(), 1U);
  EXPECT_TRUE(this->leftovers(*b).empty());
}

TYPED_TEST_P(ExchangeContract, BothWays) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  auto b = this->network_.join();
  ASSERT_TRUE(this->network_.connect(2));
  ASSERT_EQ(a->send(landmark_message<G>(1, 0, 5)), SendStatus::sent);
  ASSERT_EQ(b->send(landmark_message<G>(2, 0, 5)), SendStatus::sent);
  const auto at_b = this->collect(*b, 1);
  const auto at_a = this->collect(*a, 1);
  ASSERT_EQ(at_a.size(), 1U);
  ASSERT_EQ(at_b.size(), 1U);
  EXPECT_EQ(at_a[0].sender.vehicle, 2U);
  EXPECT_EQ(at_b[0].sender.vehicle, 1U);
}

TYPED_TEST_P(ExchangeContract, CarriesEncountersAndWaypointsToTheBit) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  auto b = this->network_.join();
  ASSERT_TRUE(this->network_.connect(2));
  EncounterFact<G> encounter{{{1, 1}, 3}, 2, {1.0 / 3.0, 7.0, G::Exp(0.1 * G::Tangent::LinSpaced(1.0, 2.0))}, 2};
  encounter.state.drift.setIdentity();
  encounter.state.heading_lever = G::Tangent::LinSpaced(1.0, 1.0 / 3.0);
  encounter.position = G::Point::LinSpaced(-7.0, 3.0);
  encounter.covariance = 0.7 * G::PointCovariance::Identity();
  const WaypointFact<G> waypoint{{{1, 1}, 4}, 2, encounter.state, {{2, 9}, 5}, G::Point::Constant(1.0 / 3.0)};
  ASSERT_EQ(a->send({{1, 1}, encounter}), SendStatus::sent);
  ASSERT_EQ(a->send({{1, 1}, waypoint}), SendStatus::sent);
  int found = 0;
  for (const auto& message : this->collect(*b, 2)) {
    if (const auto* e = std::get_if<EncounterFact<G>>(&message.payload)) found += hash_of(*e) == hash_of(encounter);
    if (const auto* w = std::get_if<WaypointFact<G>>(&message.payload)) found += hash_of(*w) == hash_of(waypoint);
  }
  EXPECT_EQ(found, 2);
}

TYPED_TEST_P(ExchangeContract, CarriesAbsoluteFixesToTheBit) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  auto b = this->network_.join();
  ASSERT_TRUE(this->network_.connect(2));
  AbsoluteFixFact<G> fact;
  fact.key = {{1, 1}, 3};
  fact.anchor = 2;
  fact.state.stamp_s = 1.0 / 3.0;
  fact.state.abscissa_m = 7.0;
  fact.state.pose = G::Exp(0.1 * G::Tangent::LinSpaced(1.0, 2.0));
  fact.state.drift.setIdentity();
  fact.lever.setConstant(0.3);
  fact.position = G::Point::LinSpaced(-1e5, 1e5);
  fact.covariance = 0.7 * G::PointCovariance::Identity();
  ASSERT_EQ(a->send({{1, 1}, fact}), SendStatus::sent);
  const auto got = this->collect(*b, 1);
  ASSERT_EQ(got.size(), 1U);
  ASSERT_TRUE(std::holds_alternative<AbsoluteFixFact<G>>(got[0].payload));
  EXPECT_EQ(hash_of(std::get<AbsoluteFixFact<G>>(got[0].payload)), hash_of(fact));
}

TYPED_TEST_P(ExchangeContract, CountsWhatIsSentAndTaken) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  auto b = this->network_.join();
  ASSERT_TRUE(this->network_.connect(2));
  for (std::uint32_t i = 0; i < 7; ++i) ASSERT_EQ(a->send(anchor_message<G>(1, i)), SendStatus::sent);
  ASSERT_EQ(this->collect(*b, 7).size(), 7U);
  EXPECT_EQ(a->counters().messages_sent, 7U);
  EXPECT_EQ(a->counters().messages_taken, 0U);
  EXPECT_EQ(b->counters().messages_taken, 7U);
  for (const auto& counters : {a->counters(), b->counters()})
    EXPECT_EQ(counters.send_rejected + counters.undecodable + counters.hostile + counters.dropped, 0U);
}

TYPED_TEST_P(ExchangeContract, LateJoinerGetsFactsWhereTheNetworkKeepsThem) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  for (std::uint32_t i = 0; i < 50; ++i) ASSERT_EQ(a->send(anchor_message<G>(1, i)), SendStatus::sent);
  auto b = this->network_.join();
  ASSERT_TRUE(this->network_.connect(2));
  if constexpr (TypeParam::keeps_history) EXPECT_EQ(this->collect(*b, 50).size(), 50U);
  else EXPECT_TRUE(this->leftovers(*b).empty());
}

TYPED_TEST_P(ExchangeContract, APeerMayLeaveAtAnyTime) {
  using G = typename TypeParam::Group;
  auto a = this->network_.join();
  auto b = this->network_.join();
  auto c = this->network_.join();
  ASSERT_TRUE(this->network_.connect(3));
  c.reset();
  ASSERT_EQ(a->send(anchor_message<G>(1, 0)), SendStatus::sent);
  EXPECT_EQ(this->collect(*b, 1).size(), 1U);
}

REGISTER_TYPED_TEST_SUITE_P(ExchangeContract, DeliversToEveryPeerAndNeverToOneself, KeepsTheOrderOfASender,
                            TakeDoesNotBlockAndGivesAMessageOnce, BothWays, CarriesAbsoluteFixesToTheBit,
                            CarriesEncountersAndWaypointsToTheBit, CountsWhatIsSentAndTaken,
                            LateJoinerGetsFactsWhereTheNetworkKeepsThem, APeerMayLeaveAtAnyTime);

}  // namespace convoy::testing
