#include <convoy/config_error.hpp>
#include <convoy/exchange/in_process.hpp>
#include <convoy/exchange/repair.hpp>

#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <ostream>
#include <string>

namespace convoy {
namespace {

using test::chain_of;
using test::key_of;

constexpr double step_s = 0.1;

/// A vehicle that stores what it hears, announces what it knows and repairs what it lacks.
class Peer {
 public:
  Peer(VehicleId vehicle, InProcessNetwork<SE2>& network, const Impairment& impairment = {}, RepairParams params = {})
      : self_(chain_of(vehicle)),
        params_(params),
        repair_(self_, params, 1000 + vehicle),
        exchange_(network.join(impairment)) {}
  Peer(VehicleId vehicle, std::unique_ptr<SubmapExchange<SE2>> exchange)
      : self_(chain_of(vehicle)), repair_(self_, {}, 1000 + vehicle), exchange_(std::move(exchange)) {}

  /// Keeps a fact of its own and sends it, or keeps silent about it.
  void publish(const test::Fact& fact, bool send = true) {
    ASSERT_EQ(test::insert(store, fact), Insertion::inserted);
    if (send) std::visit([&](const auto& f) { put(payload_of(f)); }, fact);
  }

  void step(double now_s) {
    for (const auto& message : exchange_->take(now_s))
      std::visit([&](const auto& p) { handle(message.sender, p, now_s); }, message.payload);
    for (auto& payload : repair_.due(store, now_s)) put(std::move(payload));
    if (auto marks = repair_.digest_due(store, now_s)) {
      marks_told_ += marks->size();
      ++digests_sent_;
      Digest digest;
      digest.marks = std::move(*marks);
      digest.holdings = store.holdings();
      put(std::move(digest));
    }
  }

  const RepairCounters& counters() const { return repair_.counters(); }
  std::uint64_t digests_sent() const { return digests_sent_; }
  std::uint64_t marks_told() const { return marks_told_; }
  std::uint64_t lost() const { return repair_.lost_count(); }
  std::uint64_t dropped() const { return exchange_->counters().dropped; }

  test::Store store;

 private:
  static Payload<SE2> payload_of(const LandmarkFact<SE2>& f) { return LandmarkBatch<SE2>{{f}}; }
  template <class Fact>
  static Payload<SE2> payload_of(const Fact& f) {
    return f;
  }

  void put(Payload<SE2> payload) { ASSERT_EQ(exchange_->send({self_, std::move(payload)}), SendStatus::sent); }

  void handle(const ChainId&, const LandmarkBatch<SE2>& batch, double) {
    for (const auto& landmark : batch.landmarks) keep(FactKind::landmark, landmark);
  }
  template <class Fact>
  void handle(const ChainId&, const Fact& fact, double) {
    keep(kind_of<Fact>, fact);
  }
  void handle(const ChainId&, const LivePose<SE2>&, double) {}
  void handle(const ChainId& sender, const Request& request, double now_s) {
    repair_.on_request(store, sender, request, now_s);
  }
  void handle(const ChainId& sender, const Digest& digest, double now_s) {
    repair_.on_digest(store, sender, digest, now_s);
  }

  template <class Fact>
  void keep(FactKind kind, const Fact& fact) {
    store.insert(fact);
    repair_.on_fact_seen(kind, fact.key);
  }

  ChainId self_;
  RepairParams params_;
  RepairProtocol<SE2> repair_;
  std::unique_ptr<SubmapExchange<SE2>> exchange_;
  std::uint64_t digests_sent_ = 0, marks_told_ = 0;
};

using Peers = std::vector<std::unique_ptr<Peer>>;

bool all_equal(const Peers& peers) {
  return std::all_of(peers.begin(), peers.end(), [&](const auto& peer) {
    return peer->store.missing_count() == 0 && peer->store.marks() == peers.front()->store.marks() &&
           peer->store.digest() == peers.front()->store.digest();
  });
}

/// Steps all peers until `done` or `until_s`; returns the time reached.
template <class Done>
double run(const Peers& peers, double from_s, double until_s, Done done) {
  double now_s = from_s;
  for (; now_s < until_s && !done(); now_s += step_s)
    for (const auto& peer : peers) peer->step(now_s);
  return now_s;
}
double run(const Peers& peers, double from_s, double until_s) {
  return run(peers, from_s, until_s, [] { return false; });
}

/// A fleet in which every vehicle publishes its facts, one per step, over a bad network.
struct Bad {
  VehicleId vehicles;
  double deadline_s;  ///< after the last fact was published
  Impairment impairment;
};
void PrintTo(const Bad& bad, std::ostream* out) {
  *out << bad.vehicles << " vehicles, loss " << bad.impairment.loss << ", duplicate " << bad.impairment.duplicate
       << ", jitter " << bad.impairment.jitter_s << " s";
}
class RepairOverABadNetwork : public testing::TestWithParam<Bad> {};

TEST_P(RepairOverABadNetwork, EveryoneEndsWithEveryFact) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    InProcessNetwork<SE2> network;
    Impairment impairment = GetParam().impairment;
    impairment.seed = seed;
    Peers peers;
    std::vector<std::vector<test::Fact>> facts;
    for (VehicleId v = 1; v <= GetParam().vehicles; ++v) {
      peers.push_back(std::make_unique<Peer>(v, network, impairment));
      facts.push_back(test::chain_facts(v, 12));
    }
    double now_s = 0.0;
    for (std::size_t i = 0; i < facts[0].size(); ++i, now_s += step_s)
      for (std::size_t v = 0; v < peers.size(); ++v) {
        peers[v]->publish(facts[v][i]);
        peers[v]->step(now_s);
      }
    EXPECT_FALSE(all_equal(peers));
    run(peers, now_s, now_s + GetParam().deadline_s, [&] { return all_equal(peers); });
    EXPECT_TRUE(all_equal(peers));
    for (const auto& peer : peers) {
      EXPECT_EQ(peer->store.size(), facts.size() * facts[0].size());
      EXPECT_GT(peer->dropped(), 0U);
      EXPECT_EQ(test::counted(peer->store, Insertion::conflict), 0U);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(
    Networks, RepairOverABadNetwork,
    testing::Values(Bad{2, 60.0, {.loss = 0.3}}, Bad{3, 60.0, {.loss = 0.3}},
                    Bad{3, 60.0, {.loss = 0.3, .duplicate = 0.3, .delay_s = 0.05, .jitter_s = 1.0}},
                    Bad{5, 240.0, {.loss = 0.6, .jitter_s = 0.5}}));

TEST(Repair, AsksForNothingWhenNothingIsMissing) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network));
  for (const auto& fact : test::chain_facts(1, 5)) peers[0]->publish(fact);
  run(peers, 0.0, 30.0);
  EXPECT_TRUE(all_equal(peers));
  for (const auto& peer : peers) {
    EXPECT_EQ(peer->counters().requests_sent, 0U);
    EXPECT_EQ(peer->counters().facts_served, 0U);
  }
}

TEST(Repair, WhilePeersAgreeDigestsAreRareAndTellNoMarks) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network));
  for (const auto& fact : test::chain_facts(1, 5)) peers[0]->publish(fact);
  const double now_s = run(peers, 0.0, 10.0);
  ASSERT_TRUE(all_equal(peers));
  const auto digests = peers[0]->digests_sent(), marks = peers[0]->marks_told();
  EXPECT_GT(marks, 0U);
  const double end_s = run(peers, now_s, now_s + 100.0);
  EXPECT_EQ(peers[0]->marks_told(), marks);
  EXPECT_LE(peers[0]->digests_sent() - digests, 100.0 / (0.9 * RepairParams().digest_idle_s) + 1.0);
  EXPECT_GE(peers[0]->digests_sent() - digests, 100.0 / (1.1 * RepairParams().digest_idle_s) - 1.0);
  // One that lacks the last fact makes both speak of their marks again, and at once.
  peers[0]->publish(test::anchor(1, 5), false);
  run(peers, end_s, end_s + 5.0, [&] { return all_equal(peers); });
  EXPECT_TRUE(all_equal(peers));
}

TEST(Repair, ANewcomerIsAnsweredAtOnce) {
  RepairParams params;
  params.digest_period_s = params.digest_idle_s = 100.0;
  InProcessNetwork<SE2> network;
  Peers peers;
  peers.push_back(std::make_unique<Peer>(1, network, Impairment{}, params));
  for (const auto& fact : test::chain_facts(1, 5)) peers[0]->publish(fact);
  const double now_s = run(peers, 0.0, 20.0);
  peers.push_back(std::make_unique<Peer>(2, network, Impairment{}, params));
  run(peers, now_s, now_s + 5.0, [&] { return all_equal(peers); });
  EXPECT_TRUE(all_equal(peers));
}

TEST(Repair, ADigestTellsOfItsOwnChainAndOfSomeOthersInTurn) {
  RepairParams params;
  params.max_chains = 3;
  test::Store store;
  for (VehicleId v = 1; v <= 7; ++v) store.insert(test::anchor(v, 0));
  RepairProtocol<SE2> repair(chain_of(4), params, 1);
  std::map<VehicleId, int> told;
  for (std::uint32_t k = 1; k <= 6; ++k) {
    store.insert(test::anchor(4, k));  // something to tell
    const auto marks = repair.digest_due(store, 10.0 * k);
    ASSERT_TRUE(marks);
    ASSERT_EQ(marks->size(), 3U);
    EXPECT_EQ(marks->front().chain, chain_of(4));
    EXPECT_EQ(marks->front().high_water, k + 1);
    for (const ChainMark& mark : *marks) ++told[mark.chain.vehicle];
  }
  EXPECT_EQ(told.size(), 7U);
  EXPECT_EQ(told[4], 6);
}

TEST(Repair, ADigestPrefersWhatNobodyHasToldOfLately) {
  test::Store store;
  for (VehicleId v = 1; v <= 81; ++v) store.insert(test::anchor(v, 0));
  RepairProtocol<SE2> repair(chain_of(1), {}, 1);
  std::map<bool, int> told;  // of what the other tells, too; of what it does not
  for (int k = 1; k <= 40; ++k) {
    Digest others;  // the same as is held here of 2 to 41, something else of the rest
    for (VehicleId v = 2; v <= 81; ++v) {
      const auto marks = store.marks_of(chain_of(v));
      others.marks.insert(others.marks.end(), marks.begin(), marks.end());
      if (v > 41) others.marks.back().hash ^= 1;
    }
    repair.on_digest(store, chain_of(99), others, 2.0 * k - 1.0);
    store.insert(test::anchor(1, static_cast<std::uint32_t>(k)));  // something to tell
    const auto marks = repair.digest_due(store, 2.0 * k);
    ASSERT_TRUE(marks);
    for (const ChainMark& mark : *marks)
      if (mark.chain != chain_of(1)) ++told[mark.chain.vehicle <= 41];
  }
  EXPECT_EQ(told[true] + told[false], 40 * 9);
  EXPECT_GT(told[true], 60) << "in turn, since not all may have heard the other";
  EXPECT_LT(told[true], 130);
}

TEST(Repair, WhatOthersAskForIsNotAskedForAsOften) {
  const auto requests_beside = [](int others) {
    RepairParams params;
    params.asks_per_s = 20.0;
    RepairProtocol<SE2> repair(chain_of(1), params, 1);
    test::Store store;
    for (VehicleId v = 2; v <= 201; ++v) store.announce(chain_of(v), FactKind::anchor, 3);
    for (double now_s = 0.0; now_s < 20.0; now_s += step_s) {
      for (int i = 0; i < others; ++i)  // each ten times a second
        repair.on_request(store, chain_of(static_cast<VehicleId>(300 + i)), {chain_of(250), FactKind::anchor, {{0, 3}}},
                          now_s);
      (void)repair.due(store, now_s);
    }
    return repair.counters().requests_sent;
  };
  EXPECT_GT(requests_beside(0), 350U);
  EXPECT_LT(requests_beside(2), 200U);
  const auto least = requests_beside(50);
  EXPECT_GT(least, 10U) << "nobody is kept from asking";
  EXPECT_LT(least, 60U);
}

TEST(Repair, WhatWasGivenUpIsAskedForWhenSomebodySaysThatItHoldsIt) {
  RepairProtocol<SE2> repair(chain_of(1), {}, 1);
  test::Store store;
  Digest rumour, holder;
  rumour.marks = {{chain_of(3), FactKind::anchor, 5, 0, 0}};
  holder.marks = {{chain_of(3), FactKind::anchor, 5, 5, 7}};
  double now_s = 0.0;
  const auto requests_until = [&](double until_s, const Digest& digest) {
    std::size_t count = 0;
    for (; now_s < until_s; now_s += 1.0) {
      repair.on_digest(store, chain_of(2), digest, now_s);
      count += repair.due(store, now_s).size();
    }
    return count;
  };
  requests_until(150.0, rumour);
  ASSERT_EQ(repair.lost_count(), 5U);
  for (int attempt = 0; requests_until(now_s + 10.0, rumour) == 0; ++attempt) ASSERT_LT(attempt, 9);
  EXPECT_LE(requests_until(now_s + 20.0, rumour), 1U) << "once a minute";
  EXPECT_GE(requests_until(now_s + 20.0, holder), 5U);
}

TEST(Repair, WhatAnotherHasJustAskedForIsPutOffOnce) {
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  test::Store store;
  store.announce(chain_of(1), FactKind::anchor, 5);
  EXPECT_TRUE(repair.due(store, 0.0).empty());
  const Request same{chain_of(1), FactKind::anchor, {{0, 5}}}, other{chain_of(1), FactKind::anchor, {{3, 5}}};
  repair.on_request(store, chain_of(3), other, 0.9);  // not for what is wanted first
  EXPECT_EQ(repair.counters().requests_suppressed, 0U);
  repair.on_request(store, chain_of(3), same, 0.9);
  EXPECT_EQ(repair.counters().requests_suppressed, 1U);
  EXPECT_TRUE(repair.due(store, 1.35).empty());  // it would have asked by 1.0
  repair.on_request(store, chain_of(4), same, 1.36);
  EXPECT_EQ(repair.counters().requests_suppressed, 1U) << "others could keep it waiting for ever";
  EXPECT_EQ(repair.due(store, 2.0).size(), 1U);
}

TEST(Repair, WhoAsksTooOftenIsPassedOverAndTheOthersAreNot) {
  RepairParams params;
  params.requests_per_s = 10.0;
  RepairProtocol<SE2> repair(chain_of(1), params, 1);
  test::Store store;
  store.insert(test::anchor(1, 0));
  store.insert(test::anchor(1, 1));
  for (int i = 0; i < 1000; ++i) repair.on_request(store, chain_of(2), {chain_of(1), FactKind::anchor, {{0, 1}}}, 5.0);
  EXPECT_EQ(repair.counters().requests_refused, 990U);
  repair.on_request(store, chain_of(3), {chain_of(1), FactKind::anchor, {{1, 2}}}, 5.0);
  EXPECT_EQ(repair.counters().requests_refused, 990U);
  EXPECT_EQ(repair.due(store, 5.0).size(), 2U);
  repair.on_request(store, chain_of(2), {chain_of(1), FactKind::anchor, {{0, 1}}}, 6.0);
  EXPECT_EQ(repair.counters().requests_refused, 990U) << "it has been quiet for a second";
}

TEST(Repair, WhatIsOnItsWayIsNotServedAgain) {
  RepairParams params;
  RepairProtocol<SE2> repair(chain_of(1), params, 1);
  test::Store store;
  store.insert(test::anchor(1, 0));
  const Request request{chain_of(1), FactKind::anchor, {{0, 1}}};
  repair.on_request(store, chain_of(2), request, 1.0);
  EXPECT_EQ(repair.due(store, 1.0).size(), 1U);
  repair.on_request(store, chain_of(2), request, 1.0 + 0.5 * params.resend_s);
  EXPECT_TRUE(repair.due(store, 1.0 + 0.6 * params.resend_s).empty());
  repair.on_request(store, chain_of(2), request, 1.0 + 1.1 * params.resend_s);
  EXPECT_EQ(repair.due(store, 1.0 + 1.1 * params.resend_s).size(), 1U);
}

TEST(Repair, WhatNobodyServesIsDeclaredMissingOnceItsAuthorIsGone) {
  RepairParams params;
  RepairProtocol<SE2> repair(chain_of(2), params, 1);
  test::Store store;
  Digest digest;
  digest.marks = {{chain_of(1), FactKind::anchor, 3, 3, 0}};
  repair.on_digest(store, chain_of(3), digest, 0.0);  // a peer knows of them, and has them not
  const auto lost_at = [&](double now_s) {
    (void)repair.due(store, now_s);
    return repair.lost_count(chain_of(1));
  };
  double now_s = 0.0;
  for (; now_s < 200.0; now_s += 1.0) {
    repair.on_digest(store, chain_of(1), digest, now_s);  // the author is there: it may yet answer
    ASSERT_EQ(lost_at(now_s), 0U) << now_s;
  }
  const double gone_s = now_s;
  while (lost_at(now_s) == 0 && now_s < gone_s + 200.0) now_s += 1.0;
  EXPECT_GE(now_s, gone_s + params.lost_after_s);
  EXPECT_LT(now_s, gone_s + params.lost_after_s + 20.0);
  EXPECT_EQ(repair.lost_count(), 3U);
  EXPECT_EQ(repair.lost_count(chain_of(3)), 0U);
  std::size_t requests = 0;
  for (const double end_s = now_s + 600.0; now_s < end_s; now_s += 1.0) requests += repair.due(store, now_s).size();
  EXPECT_GE(requests, 7U) << "in case somebody comes back";
  EXPECT_LE(requests, 14U);
  store.insert(test::anchor(1, 0));  // one did
  EXPECT_EQ(lost_at(now_s), 0U) << "more may follow";
  for (const double end_s = now_s + 2.5 * params.backoff_max_s; now_s < end_s; now_s += 1.0) (void)lost_at(now_s);
  EXPECT_EQ(lost_at(now_s), 2U) << "none did";
}

TEST(Repair, AnAuthorThatIsQuietForAWhileIsNotGone) {
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  test::Store store;
  Digest digest;
  digest.marks = {{chain_of(1), FactKind::anchor, 3, 3, 0}};
  for (double now_s = 0.0; now_s < 400.0; now_s += 1.0) {
    if (std::fmod(now_s, 40.0) < 10.0) repair.on_digest(store, chain_of(1), digest, now_s);
    (void)repair.due(store, now_s);
    ASSERT_EQ(repair.lost_count(), 0U) << now_s;
  }
}

TEST(Repair, ALongListIsAskedForInSeveralRequests) {
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  test::Store store;
  for (std::uint32_t k = 1; k < 400; k += 2) store.insert(test::anchor(1, k));
  (void)repair.due(store, 0.0);
  std::vector<std::size_t> sizes;
  for (const auto& payload : repair.due(store, 10.0)) sizes.push_back(std::get<Request>(payload).ranges.size());
  EXPECT_EQ(sizes, (std::vector<std::size_t>{64, 64, 64, 8}));
}

TEST(Repair, ALostTailIsFoundByTheDigest) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network));
  for (std::uint32_t k = 0; k < 10; ++k) peers[0]->publish(test::anchor(1, k), k < 7);
  peers[1]->step(0.0);  // seven in a row: no gap is visible
  EXPECT_EQ(peers[1]->store.size(), 7U);
  EXPECT_EQ(peers[1]->store.missing_count(), 0U);
  run(peers, step_s, 10.0, [&] { return all_equal(peers); });
  EXPECT_TRUE(all_equal(peers));
  EXPECT_EQ(peers[1]->counters().requests_sent, 1U);
  EXPECT_EQ(peers[0]->counters().facts_served, 3U);
  EXPECT_EQ(peers[0]->counters().facts_relayed, 0U);
}

TEST(Repair, WhoeverHoldsAFactServesItWhenItsAuthorIsGone) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network));
  const auto facts = test::chain_facts(1, 10);
  for (const auto& fact : facts) peers[0]->publish(fact);
  const double gone_s = run(peers, 0.0, 1.0);
  peers.erase(peers.begin());
  peers.push_back(std::make_unique<Peer>(3, network));  // never met the author
  run(peers, gone_s, gone_s + 30.0, [&] { return all_equal(peers); });
  EXPECT_TRUE(all_equal(peers));
  EXPECT_EQ(peers[1]->store.size(), facts.size());
  EXPECT_EQ(peers[0]->counters().facts_relayed, facts.size());
}

TEST(Repair, FactsCrossTheFleetHopByHop) {
  // 1 and 2 never hear each other, and 3 hears both; 1 leaves before 2 comes.
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 3U}) peers.push_back(std::make_unique<Peer>(v, network));
  for (const auto& fact : test::chain_facts(1, 3)) peers[0]->publish(fact);
  double now_s = run(peers, 0.0, 5.0);
  peers[0] = std::make_unique<Peer>(2, network);
  now_s = run(peers, now_s, now_s + 30.0, [&] { return all_equal(peers); });
  peers[1] = std::make_unique<Peer>(4, network);  // now 3 is gone as well
  run(peers, now_s, now_s + 30.0, [&] { return all_equal(peers); });
  EXPECT_TRUE(all_equal(peers));
  EXPECT_EQ(peers[1]->store.size(), test::chain_facts(1, 3).size());
}

TEST(Repair, RelayersKeepQuietWhenTheAuthorAnswers) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U, 3U, 4U}) peers.push_back(std::make_unique<Peer>(v, network));
  const auto facts = test::chain_facts(1, 10);
  for (const auto& fact : facts) peers[0]->publish(fact);
  const double now_s = run(peers, 0.0, 1.0);
  peers.push_back(std::make_unique<Peer>(5, network));
  run(peers, now_s, now_s + 30.0);
  EXPECT_TRUE(all_equal(peers));
  EXPECT_EQ(peers[0]->counters().facts_served, facts.size());
  for (std::size_t i = 1; i < 4; ++i) EXPECT_EQ(peers[i]->counters().facts_relayed, 0U) << i;
}

TEST(Repair, TheAuthorIsAskedFirstAndAnybodyWhenThatWasInVain) {
  RepairParams params;
  params.backoff_max_s = params.backoff_min_s;
  RepairProtocol<SE2> repair(chain_of(2), params, 1);
  test::Store store;
  Digest digest;
  digest.marks = {{chain_of(1), FactKind::anchor, 5, 5, 0}};
  std::vector<int> in_vain;
  const auto ask = [&](double from_s, double until_s, bool author_is_heard) {
    in_vain.clear();
    for (double now_s = from_s; now_s < until_s; now_s += 0.05) {
      if (author_is_heard) repair.on_digest(store, chain_of(1), digest, now_s);
      for (const auto& payload : repair.due(store, now_s)) in_vain.push_back(std::get<Request>(payload).in_vain);
    }
  };
  ask(0.0, 2.5, true);
  ASSERT_GE(in_vain.size(), 3U);
  for (std::size_t i = 0; i < in_vain.size(); ++i) EXPECT_EQ(in_vain[i], i);
  for (std::uint32_t k = 0; k < 3; ++k) store.insert(test::anchor(1, k));  // it has answered
  ask(2.5, 4.5, true);
  ASSERT_GE(in_vain.size(), 2U);
  EXPECT_EQ(in_vain[0], 0);
  EXPECT_EQ(in_vain[1], 1);
  for (std::uint32_t k = 3; k < 4; ++k) store.insert(test::anchor(1, k));
  ask(100.0, 102.0, false);  // nothing was heard of it for long
  ASSERT_GE(in_vain.size(), 2U);
  EXPECT_EQ(in_vain[0], 1);
}

TEST(Repair, OnlyTheAuthorAnswersWhatItIsAskedAlone) {
  test::Store store;
  for (std::uint32_t k = 0; k < 3; ++k) store.insert(test::anchor(1, k));
  RepairProtocol<SE2> author(chain_of(1), {}, 1), other(chain_of(3), {}, 1);
  const Request request{chain_of(1), FactKind::anchor, {{0, 3}}, 0};
  for (auto* repair : {&author, &other}) repair->on_request(store, chain_of(2), request, 1.0);
  EXPECT_EQ(author.due(store, 1.0).size(), 3U);
  EXPECT_TRUE(other.due(store, 10.0).empty());
}

TEST(Repair, OfSeveralRelayersFewAnswer) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U, 3U, 4U, 5U}) peers.push_back(std::make_unique<Peer>(v, network));
  const auto facts = test::chain_facts(1, 20);
  for (const auto& fact : facts) peers[0]->publish(fact);
  const double now_s = run(peers, 0.0, 1.0);
  peers.erase(peers.begin());
  peers.push_back(std::make_unique<Peer>(6, network));
  run(peers, now_s, now_s + 30.0);
  EXPECT_TRUE(all_equal(peers));
  std::uint64_t relayed = 0, suppressed = 0;
  for (const auto& peer : peers) {
    relayed += peer->counters().facts_relayed;
    suppressed += peer->counters().answers_suppressed;
  }
  EXPECT_GE(relayed, facts.size());
  EXPECT_LT(relayed, 2 * facts.size());  // four could have answered each
  EXPECT_EQ(relayed + suppressed, 4 * facts.size());
}

TEST(Repair, OfFortyRelayersFewAnswerAndWholeBatches) {
  InProcessNetwork<SE2> network;
  RepairParams params;
  params.answers_per_s = 1e6;
  Peers peers;
  for (VehicleId v = 1; v <= 40; ++v) peers.push_back(std::make_unique<Peer>(v, network, Impairment{}, params));
  constexpr std::uint32_t batches = 100, landmarks = 10;
  for (std::uint32_t k = 0; k < batches; ++k) peers[0]->publish(test::anchor(1, k));
  for (std::uint32_t i = 0; i < batches * landmarks; ++i) {
    auto landmark = test::landmark(1, i);
    landmark.anchor = i / landmarks;
    peers[0]->publish(landmark);
  }
  const double now_s = run(peers, 0.0, 1.0);
  peers.erase(peers.begin());
  peers.push_back(std::make_unique<Peer>(41, network, Impairment{}, params));
  run(peers, now_s, now_s + 10.0);
  EXPECT_TRUE(all_equal(peers));
  std::uint64_t relayed = 0;
  for (const auto& peer : peers) relayed += peer->counters().facts_relayed;
  EXPECT_GE(relayed, batches * (landmarks + 1));
  EXPECT_LT(relayed, 2 * batches * (landmarks + 1));  // 39 could have answered each
}

// Nobody has the first ones; they do not keep the others from being asked for.
TEST(Repair, WhatNobodyHasDoesNotHideWhatSomebodyHas) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network));
  for (std::uint32_t k = 1; k < 1000; k += 2) peers[0]->publish(test::anchor(9, k), false);
  for (std::uint32_t k = 0; k < 1000; k += 4) {
    peers[1]->publish(test::anchor(9, k + 1), false);
    peers[1]->publish(test::anchor(9, k + 2), false);
  }
  run(peers, 0.0, 60.0);
  EXPECT_EQ(peers[0]->store.size(), 750U);
  EXPECT_EQ(peers[1]->store.size(), 750U);
}

/// Who hears whom, besides themselves.
class Deaf final : public SubmapExchange<SE2> {
 public:
  Deaf(std::unique_ptr<SubmapExchange<SE2>> inner, VehicleId to) : inner_(std::move(inner)), to_(to) {}
  SendStatus send(const Message<SE2>& message) override { return inner_->send(message); }
  std::vector<Message<SE2>> take(double now_s) override {
    auto messages = inner_->take(now_s);
    std::erase_if(messages, [&](const auto& m) { return m.sender.vehicle == to_; });
    return messages;
  }
  ExchangeCounters counters() const override { return inner_->counters(); }

 private:
  std::unique_ptr<SubmapExchange<SE2>> inner_;
  VehicleId to_;
};

// 3 does not hear the author, which hears 3 and answers it; 2, which hears both, must not leave it at that.
TEST(Repair, AnAnswerThatIsNotHeardByWhoAskedDoesNotKeepOthersQuietForEver) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network));
  peers.push_back(std::make_unique<Peer>(3, std::make_unique<Deaf>(network.join(), 1)));
  for (const auto& fact : test::chain_facts(1, 5)) peers[0]->publish(fact);
  const double took_s = run(peers, 0.0, 60.0, [&] { return all_equal(peers); });
  EXPECT_TRUE(all_equal(peers));
  EXPECT_LT(took_s, 30.0);
}

TEST(Repair, WhoAsksForMuchDoesNotKeepOthersWaiting) {
  RepairParams params;
  params.answers_per_s = 100.0;
  params.resend_s = 0.0;
  RepairProtocol<SE2> repair(chain_of(1), params, 1);
  test::Store store;
  for (std::uint32_t k = 0; k < 4000; ++k) store.insert(test::anchor(1, k));
  double served_s = -1.0;
  for (double now_s = 0.0; now_s < 60.0 && served_s < 0.0; now_s += step_s) {
    for (int i = 0; i < 5; ++i)
      repair.on_request(store, chain_of(2), {chain_of(1), FactKind::anchor, {{0, 4000}}}, now_s);
    if (now_s > 30.0) repair.on_request(store, chain_of(3), {chain_of(1), FactKind::anchor, {{3999, 4000}}}, now_s);
    for (const auto& payload : repair.due(store, now_s))
      if (now_s > 30.0 && std::get<AnchorFact<SE2>>(payload).key.index == 3999) served_s = now_s;
  }
  EXPECT_GT(served_s, 0.0);
  EXPECT_LT(served_s, 32.0);
}

TEST(Repair, NotAllIsAskedForAtOnceAndNothingIsLeftOut) {
  RepairParams params;
  params.asks_per_s = 20.0;
  RepairProtocol<SE2> repair(chain_of(1), params, 1);
  test::Store store;
  for (VehicleId v = 2; v <= 101; ++v) store.announce(chain_of(v), FactKind::anchor, 3);
  std::map<VehicleId, int> asked;
  for (double now_s = 0.0; now_s < 20.0; now_s += step_s)
    for (const auto& payload : repair.due(store, now_s)) ++asked[std::get<Request>(payload).target.vehicle];
  EXPECT_EQ(asked.size(), 100U);
  EXPECT_LE(repair.counters().requests_sent, 20U * 21U + 21U);
  EXPECT_GT(repair.counters().requests_waiting, 0U);
}

TEST(Repair, WhatOthersSayOfAChainIsGivenUpWhenThereIsTooMuch) {
  FactLimits limits;
  limits.max_rumoured_chains = 20;
  RepairParams params;
  RepairProtocol<SE2> repair(chain_of(1), params, 1);
  test::Store store(limits);
  const auto digest_of = [](VehicleId from) {
    Digest digest;
    for (VehicleId v = from; v < from + 20; ++v) digest.marks.push_back({chain_of(v), FactKind::anchor, 5, 5, 0});
    return digest;
  };
  repair.on_digest(store, chain_of(9), digest_of(100), 0.0);
  for (double now_s = 0.0; now_s < 2.0 * params.lost_after_s; now_s += 1.0) {
    (void)repair.due(store, now_s);
    repair.on_digest(store, chain_of(9), digest_of(200), now_s);
  }
  EXPECT_EQ(store.chains().begin()->first, chain_of(200)) << "the first ones were never served";
  EXPECT_EQ(store.chains().size(), 20U);
}

TEST(Repair, WhoComesIsAskedWhatNobodyHad) {
  RepairParams params;
  RepairProtocol<SE2> repair(chain_of(2), params, 1);
  test::Store store;
  store.announce(chain_of(1), FactKind::anchor, 5);
  double now_s = 0.0;
  for (; now_s < 200.0; now_s += step_s) (void)repair.due(store, now_s);
  EXPECT_EQ(repair.lost_count(), 5U);
  repair.on_digest(store, chain_of(3), {}, now_s);
  bool asked = false;
  for (const double end_s = now_s + 2.5 * params.grace_s; now_s < end_s; now_s += step_s)
    asked = asked || !repair.due(store, now_s).empty();
  EXPECT_TRUE(asked);
}

TEST(Repair, AnAuthorTakesBackWhatOthersSayOfKindsItHasNoneOf) {
  test::Store store;
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  const auto missing = [&] { return store.missing_count(); };
  Digest author, liar;
  author.marks = {{chain_of(1), FactKind::anchor, 1, 1, 0}};
  liar.marks = {{chain_of(1), FactKind::encounter, 1000, 1000, 0}};
  repair.on_digest(store, chain_of(1), author, 0.0);
  repair.on_digest(store, chain_of(3), liar, 0.1);
  EXPECT_EQ(missing(), 1001U);
  Digest of_others;  // says nothing of its own chain
  repair.on_digest(store, chain_of(1), of_others, 0.2);
  EXPECT_EQ(missing(), 1001U);
  repair.on_digest(store, chain_of(1), author, 0.3);
  EXPECT_EQ(missing(), 1U);
}

TEST(Repair, NoMoreIsHandedOutThanThereIsRoomFor) {
  test::Store store;
  ASSERT_EQ(test::insert(store, test::anchor(1, 0)), Insertion::inserted);
  for (std::uint32_t i = 0; i < 100; ++i) ASSERT_EQ(test::insert(store, test::landmark(1, i)), Insertion::inserted);
  RepairProtocol<SE2> repair(chain_of(1), {}, 1);
  const auto served = [&](double now_s, Room room) {
    std::size_t landmarks = 0;
    for (const auto& payload : repair.due(store, now_s, room))
      if (const auto* batch = std::get_if<LandmarkBatch<SE2>>(&payload)) landmarks += batch->landmarks.size();
    return landmarks;
  };
  ASSERT_EQ(served(0.0, Room::any), 0U);
  repair.on_request(store, chain_of(2), {chain_of(1), FactKind::landmark, {{0, 100}}, 0}, 1.0);
  EXPECT_EQ(served(2.0, Room::none), 0U);
  EXPECT_EQ(served(3.0, Room::one_block), 32U);
  repair.on_fact_seen(FactKind::landmark, key_of(1, 32));  // what still waits can be called off
  EXPECT_EQ(served(4.0, Room::one_block), 31U);
  EXPECT_EQ(served(5.0, Room::any), 36U);
}

TEST(Repair, WhatComesSlowlyIsNotAskedForInVain) {
  test::Store store;
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  Digest digest;
  digest.marks = {{chain_of(1), FactKind::landmark, 1000, 1000, 0}};
  std::uint32_t next = 0;
  int requests = 0;
  for (double now_s = 0.0; now_s < 30.0; now_s += 0.1) {
    repair.on_digest(store, chain_of(1), digest, now_s);
    if (std::lround(now_s * 10) % 10 == 0) {
      ASSERT_EQ(test::insert(store, test::landmark(1, next++)), Insertion::inserted);
    }
    for (const auto& payload : repair.due(store, now_s))
      if (const auto* request = std::get_if<Request>(&payload); request && request->kind == FactKind::landmark) {
        ++requests;
        EXPECT_LT(request->in_vain, 3) << now_s;  // nobody answers whatever he hears
      }
  }
  EXPECT_GT(requests, 5);
}

TEST(Repair, WhoeverSaysAnythingIsThere) {
  test::Store store;
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  Digest digest;
  digest.marks = {{chain_of(1), FactKind::landmark, 10, 10, 0}};
  repair.on_digest(store, chain_of(1), digest, 0.0);
  for (double now_s = 0.0; now_s < 200.0; now_s += 1.0) {
    repair.on_heard(chain_of(1), now_s);
    (void)repair.due(store, now_s);
    ASSERT_EQ(repair.lost_count(), 0U) << now_s;
  }
  for (double now_s = 200.0; now_s < 300.0; now_s += 1.0) (void)repair.due(store, now_s);
  EXPECT_EQ(repair.lost_count(), 10U);
}

TEST(Repair, ABudgetGivesABlockItsTime) {
  EXPECT_EQ(under_budget({}, 0.0).relay_delay_s, RepairParams().relay_delay_s);
  EXPECT_EQ(under_budget({}, 1e6).relay_delay_s, RepairParams().relay_delay_s);
  EXPECT_NEAR(under_budget({}, 1000.0).relay_delay_s, 5.76, 1e-9);
}

TEST(Repair, WhoAsksForWhatWasNeverWrittenIsToldSo) {
  RepairParams params;
  params.digest_period_s = params.digest_idle_s = 100.0;
  RepairProtocol<SE2> repair(chain_of(1), params, 1);
  test::Store store;
  store.insert(test::anchor(1, 0));
  ASSERT_TRUE(repair.digest_due(store, 0.0));
  EXPECT_FALSE(repair.digest_due(store, 5.0));
  repair.on_request(store, chain_of(2), {chain_of(1), FactKind::anchor, {{0, 1}}}, 5.0);
  EXPECT_FALSE(repair.digest_due(store, 6.0));
  repair.on_request(store, chain_of(2), {chain_of(1), FactKind::anchor, {{1, 9}}}, 6.0);
  const auto marks = repair.digest_due(store, 6.3);
  ASSERT_TRUE(marks);
  ASSERT_EQ(marks->size(), 1U);
  EXPECT_EQ((*marks)[0].high_water, 1U);
}

TEST(Repair, WhatIsRefusedForItsAuthorsShareIsNotAskedForAllTheTime) {
  FactLimits limits;
  limits.max_facts_per_vehicle = 3;
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  test::Store store(limits);
  for (std::uint32_t k = 0; k < 3; ++k) store.insert(test::anchor(1, k));
  store.announce(chain_of(1), FactKind::anchor, 100);
  std::size_t requests = 0;
  for (double now_s = 0.0; now_s < 600.0; now_s += 1.0) requests += repair.due(store, now_s).size();
  EXPECT_LE(requests, 14U);
}

TEST(Repair, AnswersAreLimitedInRateAndNoneIsForgotten) {
  RepairParams params;
  params.answers_per_s = 50.0;
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network, Impairment{}, params));
  constexpr std::uint32_t n = 1000;
  for (std::uint32_t k = 0; k < n; ++k) peers[0]->publish(test::anchor(1, k), false);
  std::uint64_t before = 0;
  double worst = 0.0;
  double now_s = 0.0;
  for (; now_s < 60.0 && !all_equal(peers); now_s += 1.0) {
    run(peers, now_s, now_s + 1.0 - 0.5 * step_s);
    worst = std::max(worst, static_cast<double>(peers[0]->counters().facts_served - before));
    before = peers[0]->counters().facts_served;
  }
  EXPECT_TRUE(all_equal(peers));
  EXPECT_LE(worst, 2.0 * params.answers_per_s);  // one second's worth may have been saved up
  EXPECT_GT(now_s, n / params.answers_per_s - 2.0);
  EXPECT_LT(now_s, 2.0 * n / params.answers_per_s);
}

TEST(Repair, AGapIsRepairedWhileNewFactsKeepComing) {
  InProcessNetwork<SE2> network;
  Peers peers;
  for (const VehicleId v : {1U, 2U}) peers.push_back(std::make_unique<Peer>(v, network));
  double now_s = 0.0, repaired_s = -1.0;
  for (std::uint32_t k = 0; k < 300; ++k, now_s += step_s) {  // one fact per step, number 3 is lost
    peers[0]->publish(test::anchor(1, k), k != 3);
    for (const auto& peer : peers) peer->step(now_s);
    if (repaired_s < 0.0 && peers[1]->store.anchor(key_of(1, 3)) != nullptr) repaired_s = now_s;
  }
  EXPECT_GT(repaired_s, 0.0) << "not repaired within " << now_s << " s";
  EXPECT_LT(repaired_s, 5.0);
}

/// Payloads of type T among what is due at `now_s`.
template <class T>
std::vector<T> due(RepairProtocol<SE2>& repair, const test::Store& store, double now_s) {
  std::vector<T> list;
  for (auto& payload : repair.due(store, now_s))
    if (auto* item = std::get_if<T>(&payload)) list.push_back(std::move(*item));
  return list;
}

TEST(Repair, AYoungGapIsGivenTime) {
  RepairParams params;
  params.grace_s = 2.0;
  RepairProtocol<SE2> repair(chain_of(2), params, 1);
  test::Store store;
  store.insert(test::anchor(1, 1));
  for (double now_s = 0.0; now_s < 1.95; now_s += step_s)
    EXPECT_TRUE(due<Request>(repair, store, now_s).empty()) << now_s;
  std::vector<Request> requests;
  for (double now_s = 2.0; now_s < 4.2 && requests.empty(); now_s += step_s)
    requests = due<Request>(repair, store, now_s);
  ASSERT_EQ(requests.size(), 1U);
  EXPECT_EQ(requests[0].target, chain_of(1));
  EXPECT_EQ(requests[0].kind, FactKind::anchor);
  EXPECT_EQ(requests[0].ranges, (std::vector<IndexRange>{{0, 1}}));
}

TEST(Repair, WhatArrivesWithinTheGraceIsNeverAskedFor) {
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  test::Store store;
  store.insert(test::anchor(1, 1));
  EXPECT_TRUE(due<Request>(repair, store, 0.0).empty());
  store.insert(test::anchor(1, 0));
  for (double now_s = step_s; now_s < 20.0; now_s += step_s) EXPECT_TRUE(due<Request>(repair, store, now_s).empty());
}

TEST(Repair, RequestsBackOffAndNeverCease) {
  RepairParams params;
  params.lost_after_s = 1e6;
  RepairProtocol<SE2> repair(chain_of(2), params, 1);
  test::Store store;
  store.announce(chain_of(1), FactKind::landmark, 5);
  std::vector<double> at_s;
  for (double now_s = 0.0; now_s < 200.0; now_s += step_s)
    if (!due<Request>(repair, store, now_s).empty()) at_s.push_back(now_s);
  ASSERT_GE(at_s.size(), 200.0 / (1.25 * params.backoff_max_s + step_s));
  EXPECT_LE(at_s.size(), 200.0 / (0.75 * params.backoff_max_s) + 6.0);
  EXPECT_LT(at_s[1] - at_s[0], 1.25 * params.backoff_min_s + 2 * step_s);
  for (std::size_t i = 6; i < at_s.size(); ++i) {
    EXPECT_GT(at_s[i] - at_s[i - 1], 0.75 * params.backoff_max_s - 2 * step_s);
    EXPECT_LT(at_s[i] - at_s[i - 1], 1.25 * params.backoff_max_s + 2 * step_s);
  }
}

TEST(Repair, ARequestNamesAtMostSoManyRanges) {
  RepairParams params;
  params.max_ranges = 4;
  RepairProtocol<SE2> repair(chain_of(2), params, 1);
  test::Store store;
  for (std::uint32_t k = 1; k < 40; k += 2) store.insert(test::anchor(1, k));
  due<Request>(repair, store, 0.0);
  const auto requests = due<Request>(repair, store, 10.0);
  ASSERT_EQ(requests.size(), 1U);
  EXPECT_EQ(requests[0].ranges, (std::vector<IndexRange>{{0, 1}, {2, 3}, {4, 5}, {6, 7}}));
}

TEST(Repair, LandmarksAreServedInBatchesOfOneAnchorAndLimitedSize) {
  RepairParams params;
  params.batch_limit = 3;
  RepairProtocol<SE2> repair(chain_of(1), params, 1);
  test::Store store;
  for (std::uint32_t i = 0; i < 12; ++i) store.insert(test::landmark(1, i));  // four to each of three anchors
  repair.on_request(store, chain_of(2), {chain_of(1), FactKind::landmark, {{0, 12}}}, 100.0);
  const auto batches = due<LandmarkBatch<SE2>>(repair, store, 100.0);
  std::vector<std::size_t> sizes;
  std::uint32_t next = 0;
  for (const auto& batch : batches) {
    sizes.push_back(batch.landmarks.size());
    for (const auto& landmark : batch.landmarks) {
      EXPECT_EQ(landmark.anchor_key(), batch.landmarks.front().anchor_key());
      EXPECT_EQ(landmark.key.index, next++);
    }
  }
  EXPECT_EQ(sizes, (std::vector<std::size_t>{3, 1, 3, 1, 3, 1}));
}

TEST(Repair, HostileRequestsAreHarmless) {
  RepairProtocol<SE2> repair(chain_of(1), {}, 1);
  test::Store store;
  for (const std::uint32_t k : {0U, 1U, 2U}) store.insert(test::anchor(1, k));
  repair.on_request(store, chain_of(2), {chain_of(99), FactKind::anchor, {{0, 10}}}, 100.0);  // a chain nobody knows
  repair.on_request(store, chain_of(2), {chain_of(1), FactKind::anchor, {{7, 2}, {5, 5}}},
                    100.0);  // empty and reversed ranges
  repair.on_request(store, chain_of(2), {chain_of(1), FactKind::landmark, {{0, 10}}}, 100.0);  // nothing held
  repair.on_request(store, chain_of(2), {chain_of(1), static_cast<FactKind>(77), {{0, 10}}}, 100.0);
  EXPECT_TRUE(repair.due(store, 101.0).empty());
  for (int i = 0; i < 1000; ++i)
    repair.on_request(store, chain_of(2), {chain_of(1), FactKind::anchor, {{0, 0xffffffffU}}}, 102.0);
  EXPECT_EQ(repair.due(store, 103.0).size(), 3U);  // however often asked
  EXPECT_TRUE(repair.due(store, 104.0).empty());
  EXPECT_EQ(repair.counters().requests_heard, 1004U);
}

TEST(Repair, DigestsOfStrangersAskForNothing) {
  FactLimits limits;
  limits.roster = {1, 2};
  test::Store store(limits);
  RepairProtocol<SE2> repair(chain_of(2), {}, 1);
  repair.on_digest(store, chain_of(1), {2, {{chain_of(66), FactKind::anchor, 1000, 1000, 1}}}, 0.0);
  EXPECT_EQ(store.missing_count(), 0U);
  for (double now_s = 0.0; now_s < 20.0; now_s += step_s) EXPECT_TRUE(repair.due(store, now_s).empty());
}

TEST(Repair, RefusesParametersOutOfRange) {
  const auto refusal = [](auto change) -> std::string {
    RepairParams params;
    change(params);
    try {
      RepairProtocol<SE2> repair(chain_of(1), params, 1);
    } catch (const RangeError& error) {
      return error.what();
    }
    return "accepted";
  };
  using P = RepairParams;
  EXPECT_EQ(refusal([](P&) {}), "accepted");
  EXPECT_EQ(refusal([](P& p) { p.digest_period_s = 0.0; }), "repair: digest_period_s must be > 0 (it is 0)");
  EXPECT_EQ(refusal([](P& p) { p.grace_s = -1.0; }), "repair: grace_s must be >= 0 (it is -1)");
  EXPECT_EQ(refusal([](P& p) { p.backoff_min_s = 0.0; }), "repair: backoff_min_s must be > 0 (it is 0)");
  EXPECT_EQ(refusal([](P& p) { p.backoff_max_s = 0.25; }),
            "repair: backoff_max_s must be at least backoff_min_s (it is 0.25)");
  EXPECT_EQ(refusal([](P& p) { p.relay_delay_s = NAN; }), "repair: relay_delay_s must be >= 0 (it is nan)");
  EXPECT_EQ(refusal([](P& p) { p.max_ranges = 4097; }), "repair: max_ranges must lie in 1..4096 (it is 4097)");
  EXPECT_EQ(refusal([](P& p) { p.answers_per_s = 0.0; }), "repair: answers_per_s must be > 0 (it is 0)");
  EXPECT_EQ(refusal([](P& p) { p.batch_limit = 0; }), "repair: batch_limit must lie in 1..64 (it is 0)");
}

}  // namespace
}  // namespace convoy
