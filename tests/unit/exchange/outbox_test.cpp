#include <convoy/config_error.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/exchange/paced_exchange.hpp>

#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <set>

namespace convoy {
namespace {

using test::chain_of;
using Out = Outbox<SE2>;

Message<SE2> of(Payload<SE2> payload) { return {chain_of(1), std::move(payload)}; }

Digest digest_at(double stamp_s) {
  Digest digest;
  digest.stamp_s = stamp_s;
  return digest;
}

LandmarkFact<SE2> landmark(std::uint32_t index, double sigma_m, std::uint32_t anchor = 0) {
  LandmarkFact<SE2> fact = test::landmark(1, index);
  fact.anchor = anchor;
  fact.covariance = sigma_m * sigma_m * Eigen::Matrix2d::Identity();
  return fact;
}

/// A network that counts bytes, and takes nothing while it is blocked.
class Counting final : public SubmapExchange<SE2> {
 public:
  SendStatus send(const Message<SE2>& message) override {
    if (blocked) return SendStatus::rejected;
    if (!carries_fixes && std::holds_alternative<AbsoluteFixFact<SE2>>(message.payload)) return SendStatus::unfit;
    sent.push_back(message);
    counters_.bytes_sent += bytes_per_message;
    return SendStatus::sent;
  }
  std::vector<Message<SE2>> take(double) override { return {}; }
  ExchangeCounters counters() const override { return counters_; }
  SendStatus send_together(std::span<const Message<SE2>> messages) override {
    together.push_back(messages.size());
    return SubmapExchange<SE2>::send_together(messages);
  }
  void background(std::uint64_t bytes) { counters_.bytes_sent += bytes; }

  static constexpr std::uint64_t bytes_per_message = 100;
  std::vector<Message<SE2>> sent;
  std::vector<std::size_t> together;
  bool blocked = false, carries_fixes = true;

 private:
  ExchangeCounters counters_;
};

struct Paced {
  explicit Paced(double bytes_per_s, double burst_s = 1.0)
      : network(new Counting), exchange(std::unique_ptr<SubmapExchange<SE2>>(network), {bytes_per_s, burst_s}) {}
  Counting* network;
  PacedExchange<SE2> exchange;
};

TEST(Outbox, WithoutABudgetEverythingGoesAtOnce) {
  Paced paced(0.0);
  for (const auto& fact : test::chain_facts(1, 50))
    std::visit(
        [&](const auto& f) {
          if constexpr (kind_of<std::decay_t<decltype(f)>> != FactKind::landmark) {
            EXPECT_EQ(paced.exchange.send(of(f)), SendStatus::sent);
          }
        },
        fact);
  paced.exchange.take(0.0);
  EXPECT_EQ(paced.network->sent.size(), 50U * 4U + 2U);
  EXPECT_EQ(paced.exchange.outbox_counters().facts_waiting, 0U);
}

TEST(Outbox, NoSecondCostsMoreThanTheBudgetAndNothingIsLost) {
  Paced paced(1000.0);  // ten messages per second
  for (std::uint32_t k = 0; k < 200; ++k) EXPECT_EQ(paced.exchange.send(of(test::anchor(1, k))), SendStatus::sent);
  std::size_t before = 0;
  for (int second = 0; second < 25; ++second) {
    for (int i = 0; i < 100; ++i) paced.exchange.take(second + 0.01 * i);
    const std::size_t now = paced.network->sent.size() - before;
    EXPECT_LE(now, second == 0 ? 21U : 11U) << second;  // the first second has a burst saved up
    before = paced.network->sent.size();
  }
  EXPECT_EQ(paced.network->sent.size(), 200U);
}

TEST(Outbox, WhatTheNetworkSpendsByItselfIsPaidFromTheBudget) {
  Paced paced(1000.0);
  for (std::uint32_t k = 0; k < 200; ++k) (void)paced.exchange.send(of(test::anchor(1, k)));
  for (int i = 0; i < 1000; ++i) {  // ten seconds, in which heartbeats take eight tenths
    paced.network->background(8);
    paced.exchange.take(0.01 * i);
  }
  EXPECT_GE(paced.network->sent.size(), 10U + 18U);
  EXPECT_LE(paced.network->sent.size(), 10U + 22U);
}

TEST(Outbox, WhereTheNetworkByItselfTakesTheBudgetATenthIsForMessagesStill) {
  Paced paced(1000.0);
  int digests = 0;
  for (int i = 0; i < 60'000; ++i) {  // ten minutes, of 1200 bytes per second
    if (i % 100 == 0) (void)paced.exchange.send(of(digest_at(i)));
    if (i % 100 == 0) (void)paced.exchange.send(of(test::anchor(1, static_cast<std::uint32_t>(i))));
    paced.network->background(12);
    paced.exchange.take(0.01 * i);
  }
  for (const auto& message : paced.network->sent) digests += std::holds_alternative<Digest>(message.payload);
  EXPECT_GE(digests, 10);
  EXPECT_NEAR(static_cast<double>(paced.network->sent.size()), 600.0, 60.0) << "100 bytes per second";
  EXPECT_GT(paced.exchange.outbox_counters().in_debt, 400U);
}

TEST(Outbox, AfterABurstOfTheNetworkItGoesOnWithinSeconds) {
  Paced paced(1000.0);
  paced.exchange.take(0.0);
  paced.network->background(1'000'000);  // discovery of a whole fleet
  paced.exchange.take(0.1);
  for (std::uint32_t k = 0; k < 1000; ++k) (void)paced.exchange.send(of(test::anchor(1, k)));
  for (int i = 0; i < 2000; ++i) paced.exchange.take(0.1 + 0.01 * i);
  EXPECT_GE(paced.network->sent.size(), 90U);  // in ten of twenty seconds
  EXPECT_LE(paced.network->sent.size(), 115U);
}

TEST(Outbox, OnesOwnRequestsDoNotStarveTheDigest) {
  Paced paced(100.0);
  double last_s = 0.0, longest_s = 0.0;
  std::size_t seen = 0, requests = 0;
  for (int i = 0; i < 6000; ++i) {
    const double now_s = 0.1 * i;
    if (i % 10 == 0) (void)paced.exchange.send(of(digest_at(now_s)));
    if (i % 10 == 0) (void)paced.exchange.send(of(Request{}));
    paced.exchange.take(now_s);
    for (; seen < paced.network->sent.size(); ++seen) {
      requests += std::holds_alternative<Request>(paced.network->sent[seen].payload);
      if (!std::holds_alternative<Digest>(paced.network->sent[seen].payload)) continue;
      longest_s = std::max(longest_s, now_s - last_s);
      last_s = now_s;
    }
  }
  EXPECT_LT(longest_s, 3.0);
  EXPECT_NEAR(static_cast<double>(requests), 300.0, 20.0) << "nor the other way round";
}

TEST(Outbox, OnesOwnNewsDoNotWaitBehindRepeats) {
  Paced paced(100.0);  // one message per second
  for (std::uint32_t k = 0; k < 200; ++k) (void)paced.exchange.send(of(LandmarkBatch<SE2>{{landmark(k, 0.1, k)}}));
  for (int i = 0; i < 30'000; ++i) paced.exchange.take(0.01 * i);
  ASSERT_EQ(paced.network->sent.size(), 200U);
  for (std::uint32_t k = 0; k < 200; ++k) {  // a peer asks for them, and for those of somebody else
    (void)paced.exchange.send(of(LandmarkBatch<SE2>{{landmark(k, 0.1, k)}}));
    (void)paced.exchange.send(of(test::anchor(2, k)));
  }
  for (std::uint32_t k = 200; k < 220; ++k) (void)paced.exchange.send(of(LandmarkBatch<SE2>{{landmark(k, 0.5, k)}}));
  for (int i = 0; i < 5000; ++i) paced.exchange.take(301.0 + 0.01 * i);
  std::size_t news = 0;
  for (std::size_t k = 200; k < paced.network->sent.size(); ++k)
    if (const auto* batch = std::get_if<LandmarkBatch<SE2>>(&paced.network->sent[k].payload))
      news += batch->landmarks.at(0).key.index >= 200;
  EXPECT_EQ(news, 20U);
  EXPECT_GE(paced.network->sent.size(), 200U + 45U) << "the others have their turn";
}

// Which of them a network need not keep for who comes late.
TEST(Outbox, SaysWhatIsRepeated) {
  Paced paced(0.0);
  const auto send = [&](Payload<SE2> payload) {
    (void)paced.exchange.send(of(std::move(payload)));
    paced.exchange.take(0.0);
    return paced.network->sent.back().repeated;
  };
  EXPECT_FALSE(send(test::anchor(1, 0)));
  EXPECT_FALSE(send(LandmarkBatch<SE2>{{landmark(0, 0.1)}}));
  EXPECT_TRUE(send(test::anchor(1, 0)));
  EXPECT_TRUE(send(LandmarkBatch<SE2>{{landmark(0, 0.1)}}));
  EXPECT_TRUE(send(test::anchor(2, 0))) << "it is somebody else's";
  EXPECT_FALSE(send(test::anchor(1, 1)));
  EXPECT_FALSE(send(Digest{}));
}

TEST(Outbox, WithoutABudgetWhatIsSaidAgainGoesTogether) {
  Paced paced(0.0);
  for (std::uint32_t k = 0; k < 100; ++k) (void)paced.exchange.send(of(test::anchor(2, k)));
  for (std::uint32_t k = 0; k < 3; ++k) (void)paced.exchange.send(of(test::anchor(1, k)));
  paced.exchange.take(0.0);
  EXPECT_EQ(paced.network->together, (std::vector<std::size_t>{1, 100, 1, 1})) << "news go singly";
}

TEST(Outbox, OnABudgetAFewFactsGoTogether) {
  Paced paced(1e9);
  const std::uint32_t limit = BudgetParams{}.batch_limit / 4;  // an anchor takes as much as four landmarks
  for (std::uint32_t k = 0; k < limit + 3; ++k) (void)paced.exchange.send(of(test::anchor(2, k)));
  paced.exchange.take(0.0);
  EXPECT_EQ(paced.network->together, (std::vector<std::size_t>{limit, 3}));
  paced.network->together.clear();
  for (std::uint32_t k = 0; k < 3; ++k) {  // of 280 pairings 2 KB
    AssociationFact wide = test::association(2, k, test::pairings(2, 3, 0, 4));
    wide.pairings.resize(280, wide.pairings.front());
    (void)paced.exchange.send(of(wide));
  }
  paced.exchange.take(0.0);
  EXPECT_EQ(paced.network->together, (std::vector<std::size_t>{1, 1, 1})) << "each is more than enough";
  paced.network->together.clear();
  for (std::uint32_t k = 0; k < 3; ++k) (void)paced.exchange.send(of(test::anchor(1, k)));
  paced.exchange.take(0.0);
  EXPECT_EQ(paced.network->together, (std::vector<std::size_t>{1, 1, 1})) << "news go singly";
}

TEST(Outbox, WhatIsRefusedInOneGoIsSaidAgainWholeAndInItsPlace) {
  Paced paced(1e9);
  paced.network->blocked = true;
  for (std::uint32_t k = 0; k < 8; ++k) (void)paced.exchange.send(of(test::anchor(2, k)));
  paced.exchange.take(0.0);
  EXPECT_EQ(paced.network->together, (std::vector<std::size_t>{5}));
  EXPECT_TRUE(paced.network->sent.empty());
  EXPECT_EQ(paced.exchange.outbox_counters().facts_waiting, 8U);
  paced.network->blocked = false;
  paced.exchange.take(0.0);
  ASSERT_EQ(paced.network->sent.size(), 8U);
  for (std::uint32_t k = 0; k < 8; ++k) {
    EXPECT_TRUE(paced.network->sent[k].repeated);
    EXPECT_EQ(std::get<AnchorFact<SE2>>(paced.network->sent[k].payload).key.index, k);
  }
}

// The network may be slow, and somebody may ask meanwhile for what it has.
TEST(Outbox, WhatTheNetworkHasIsNoRepeatIfItComesBack) {
  for (const Payload<SE2>& fact :
       {Payload<SE2>(test::anchor(1, 0)), Payload<SE2>(LandmarkBatch<SE2>{{landmark(0, 0.1)}})}) {
    Out outbox({});
    EXPECT_TRUE(outbox.put(of(fact)));
    auto away = outbox.next(0.0, 0);
    ASSERT_EQ(away.size(), 1U);
    EXPECT_TRUE(outbox.put(of(fact)));
    EXPECT_EQ(outbox.counters().repeats, 1U);
    outbox.put_back(std::move(away));
    const auto again = outbox.next(1.0, 0);
    ASSERT_EQ(again.size(), 1U);
    EXPECT_FALSE(again.front().repeated);
    EXPECT_TRUE(outbox.next(2.0, 0).empty()) << "once is enough";
    EXPECT_TRUE(outbox.put(of(fact)));  // a peer asks for it later
    EXPECT_EQ(outbox.next(3.0, 0).size(), 1U);
  }
}

TEST(Outbox, TheMostInformativeLandmarksGoFirst) {
  Paced paced(100.0);  // one message per second
  paced.network->background(100);
  LandmarkBatch<SE2> rough, fine;
  for (std::uint32_t i = 0; i < 24; ++i) rough.landmarks.push_back(landmark(i, 0.5 + 0.01 * ((7 * i) % 24), 1));
  for (std::uint32_t i = 24; i < 28; ++i) fine.landmarks.push_back(landmark(i, 0.1, 2));
  (void)paced.exchange.send(of(rough));
  (void)paced.exchange.send(of(fine));
  (void)paced.exchange.send(of(test::anchor(1, 2)));  // what they hang on goes before them
  for (int i = 0; i < 60; ++i) paced.exchange.take(0.1 * i);
  ASSERT_GE(paced.network->sent.size(), 4U);
  EXPECT_TRUE(std::holds_alternative<AnchorFact<SE2>>(paced.network->sent[0].payload));
  const auto& first = std::get<LandmarkBatch<SE2>>(paced.network->sent[1].payload).landmarks;
  EXPECT_EQ(first.size(), 4U);
  EXPECT_EQ(first.front().anchor, 2U);
  const auto& second = std::get<LandmarkBatch<SE2>>(paced.network->sent[2].payload).landmarks;
  const auto& third = std::get<LandmarkBatch<SE2>>(paced.network->sent[3].payload).landmarks;
  EXPECT_EQ(second.size(), 20U);
  EXPECT_EQ(third.size(), 4U);
  EXPECT_LT(second.back().covariance(0, 0), third.front().covariance(0, 0));
}

TEST(Outbox, AShortBudgetIsSharedByKindsOfTraffic) {
  Paced paced(600.0, 0.5);  // six messages per second
  for (std::uint32_t k = 0; k < 1000; ++k) (void)paced.exchange.send(of(test::anchor(1, k)));
  int of_facts = 0, of_digests = 0, of_poses = 0;
  for (int i = 0; i < 1000; ++i) {
    (void)paced.exchange.send(of(Digest{}));
    (void)paced.exchange.send(of(LivePose<SE2>{}));
    paced.exchange.take(0.1 * i);
  }
  for (const auto& message : paced.network->sent) {
    of_facts += std::holds_alternative<AnchorFact<SE2>>(message.payload);
    of_digests += std::holds_alternative<Digest>(message.payload);
    of_poses += std::holds_alternative<LivePose<SE2>>(message.payload);
  }
  EXPECT_NEAR(of_facts, 400, 20);
  EXPECT_NEAR(of_digests, 100, 20);
  EXPECT_NEAR(of_poses, 100, 20);
}

TEST(Outbox, OfDigestsAndLivePosesTheLastOneWaitsAndOfFactsEachOnce) {
  Paced paced(1.0);
  paced.network->background(1000);
  paced.exchange.take(0.0);
  for (int i = 0; i < 10; ++i) {
    (void)paced.exchange.send(of(digest_at(i)));
    (void)paced.exchange.send(of(test::anchor(1, 7)));
    (void)paced.exchange.send(of(LandmarkBatch<SE2>{{landmark(3, 0.1)}}));
  }
  EXPECT_EQ(paced.exchange.outbox_counters().facts_waiting, 2U);
  EXPECT_EQ(paced.exchange.outbox_counters().repeats, 18U);
  EXPECT_EQ(paced.exchange.outbox_counters().replaced, 9U);
  for (int i = 0; i < 1600; ++i) paced.exchange.take(i);
  ASSERT_EQ(paced.network->sent.size(), 3U);
  EXPECT_EQ(paced.exchange.send(of(test::anchor(1, 7))), SendStatus::sent);  // a peer asks for it later
  EXPECT_EQ(paced.exchange.outbox_counters().facts_waiting, 1U);
}

TEST(Outbox, WhatTheNetworkDoesNotTakeStays) {
  Paced paced(0.0);
  paced.network->blocked = true;
  std::set<std::uint32_t> arrived;
  for (std::uint32_t k = 0; k < 20; ++k) (void)paced.exchange.send(of(test::anchor(1, k)));
  (void)paced.exchange.send(of(digest_at(1.0)));
  paced.exchange.take(0.0);
  paced.exchange.take(1.0);
  EXPECT_TRUE(paced.network->sent.empty());
  paced.network->blocked = false;
  paced.exchange.take(2.0);
  for (const auto& message : paced.network->sent)
    if (const auto* anchor = std::get_if<AnchorFact<SE2>>(&message.payload)) arrived.insert(anchor->key.index);
  EXPECT_EQ(arrived.size(), 20U);
  EXPECT_EQ(paced.network->sent.size(), 21U);
}

TEST(Outbox, WhatTheNetworkCannotCarryIsDroppedAndHoldsNothingUp) {
  Paced paced(0.0);
  paced.network->carries_fixes = false;
  (void)paced.exchange.send(of(test::absolute_fix(1, 1)));
  (void)paced.exchange.send(of(LandmarkBatch<SE2>{{landmark(3, 0.1)}}));
  paced.exchange.take(0.0);
  EXPECT_EQ(paced.network->sent.size(), 1U);
  EXPECT_EQ(paced.exchange.outbox_counters().unfit, 1U);
  EXPECT_EQ(paced.exchange.outbox_counters().facts_waiting, 0U);
}

TEST(Outbox, WhatItHasNoRoomForIsCountedAndSaid) {
  Out outbox({.bytes_per_s = 1.0, .max_waiting = 3});
  for (std::uint32_t k = 0; k < 5; ++k) EXPECT_EQ(outbox.put(of(test::anchor(1, k))), k < 3) << k;
  EXPECT_EQ(outbox.counters().dropped, 2U);
  for (int i = 0; i < 1000; ++i) (void)outbox.put(of(Request{}));
  EXPECT_EQ(outbox.counters().replaced, 1000U - 64U);
}

TEST(Outbox, RefusesParametersOutOfRange) {
  for (const auto& bad :
       {BudgetParams{.bytes_per_s = -1.0}, BudgetParams{.burst_s = 0.0}, BudgetParams{.batch_limit = 0},
        BudgetParams{.batch_limit = 65}, BudgetParams{.max_waiting = 0}})
    EXPECT_THROW(Out{bad}, RangeError);
}

}  // namespace
}  // namespace convoy
