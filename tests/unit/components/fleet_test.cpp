// Several vehicles in one thread, from the front end to the map, over a network that loses things.
#include <convoy/components/fleet_monitor.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/submap/rounding.hpp>

#include <gtest/gtest.h>

#include "scripted_fleet.hpp"

#include <limits>

namespace convoy {
namespace {

using test::Member;
using test::MemberOptions;
using test::ScriptedFleet;

const Impairment rough{.loss = 0.3, .duplicate = 0.2, .delay_s = 0.1, .jitter_s = 1.5, .seed = 1};

/// Vehicle 1 knows its start; 2 and 3 do not.
void add_three(ScriptedFleet& fleet) {
  MemberOptions known;
  known.static_bias = Estimate<SE2>{test::script_of(1)[0].truth, SE2::Covariance::Zero()};
  fleet.add(1, known);
  fleet.add(2);
  fleet.add(3);
}

struct Outcome {
  Hash facts = 0, map = 0, selection = 0;
  bool operator==(const Outcome&) const = default;
};

/// What all members agree on; a failure if they do not.
Outcome agreed(const ScriptedFleet& fleet) {
  std::optional<Outcome> first;
  for (const auto& member : fleet.members) {
    if (!member) continue;
    const Outcome own{member->facts(), member->map_digest(), member->manager.map().selection.digest()};
    if (!first) first = own;
    EXPECT_EQ(own.facts, first->facts);
    EXPECT_EQ(own.map, first->map);
    EXPECT_EQ(own.selection, first->selection);
    EXPECT_EQ(member->manager.counters().disagreements, 0U);
  }
  return first.value_or(Outcome{});
}

Outcome run_three(const Impairment& impairment, ScriptedFleet* keep = nullptr) {
  ScriptedFleet own(impairment);
  ScriptedFleet& fleet = keep != nullptr ? *keep : own;
  add_three(fleet);
  fleet.drive(120);
  EXPECT_TRUE(fleet.settle());
  return agreed(fleet);
}

TEST(Fleet, EveryVehicleEndsWithOneMapOfWhereAllAre) {
  ScriptedFleet fleet;
  run_three({}, &fleet);
  const auto& map = fleet.members[0]->manager.map();
  EXPECT_GE(map.selection.classes.size(), 20U);
  for (const auto& viewer : fleet.members) {
    const auto own = viewer->view_of(viewer->chain(), fleet.now_s);
    ASSERT_TRUE(own.estimate);
    for (const auto& seen : fleet.members) {
      const auto state = viewer->view_of(seen->chain(), fleet.now_s);
      ASSERT_TRUE(state.estimate);
      EXPECT_EQ(state.integrity, Integrity::ok) << state.reasons;
      const SE2 error = state.estimate->mean.inverse() * seen->truth();
      EXPECT_LT(squared_mahalanobis(error.Log(), state.estimate->covariance), chi2_quantile(0.9999, 3));
      // What all have drifted together stays; where they are to each other does not.
      const SE2 between = own.estimate->mean.inverse() * state.estimate->mean,
                truth = viewer->truth().inverse() * seen->truth();
      EXPECT_LT((between.translation() - truth.translation()).norm(), 0.8);
    }
  }
  for (const auto& member : fleet.members) {
    EXPECT_EQ(member->front_end_component.landmarks_exported(), [&] {
      std::size_t n = 0;
      for (const auto& step : member->script) n += step.landmarks ? step.landmarks->size() : 0;
      return n;
    }());
    EXPECT_GT(member->association.counters().searches, 0U);
  }
}

TEST(Fleet, LossDuplicatesAndReorderingChangeNothingInTheEnd) {
  const Outcome clean = run_three({});
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    Impairment impairment = rough;
    impairment.seed = seed;
    ScriptedFleet fleet(impairment);
    EXPECT_EQ(run_three(impairment, &fleet), clean) << seed;
    for (const auto& member : fleet.members) {
      EXPECT_GT(member->manager.exchange_counters().dropped, 20U);
      EXPECT_GT(member->manager.repair_counters().requests_sent, 0U);
    }
  }
}

/// Hears nothing of what one vehicle sends.
class DeafTo final : public SubmapExchange<SE2> {
 public:
  DeafTo(VehicleId vehicle, test::Exchange inner) : vehicle_(vehicle), inner_(std::move(inner)) {}
  SendStatus send(const Message<SE2>& message) override { return inner_->send(message); }
  std::vector<Message<SE2>> take(double now_s) override {
    auto messages = inner_->take(now_s);
    std::erase_if(messages, [&](const auto& message) { return message.sender.vehicle == vehicle_; });
    return messages;
  }
  ExchangeCounters counters() const override { return inner_->counters(); }

 private:
  VehicleId vehicle_;
  test::Exchange inner_;
};

std::size_t landmarks_of(const Member& member, VehicleId vehicle) {
  const auto& chains = member.manager.store().chains();
  const auto it = chains.find({vehicle, 1});
  return it == chains.end() ? 0 : it->second.landmarks.size();
}

TEST(Fleet, WhatReachedOnePeerReachesAllThoughItsAuthorIsGone) {
  ScriptedFleet fleet;
  fleet.add(1);
  fleet.add(2);
  fleet.add(3, std::make_unique<DeafTo>(1, fleet.network().join()));
  fleet.drive(62);
  fleet.members[0].reset();
  fleet.drive(40);
  ASSERT_TRUE(fleet.settle());
  const std::size_t known_to_2 = landmarks_of(*fleet.members[1], 1);
  EXPECT_GT(known_to_2, 10U);
  EXPECT_EQ(landmarks_of(*fleet.members[2], 1), known_to_2);
  EXPECT_GE(fleet.members[1]->manager.repair_counters().facts_relayed, known_to_2);
  agreed(fleet);
}

TEST(Fleet, ALateJoinerCatchesUpWithTheLivingAndTheDead) {
  for (const Impairment& impairment : {Impairment{}, rough}) {
    ScriptedFleet fleet(impairment);
    fleet.add(1);
    fleet.add(2);
    fleet.drive(70);
    ASSERT_TRUE(fleet.settle());
    const std::size_t known = landmarks_of(*fleet.members[1], 1);
    fleet.members[0].reset();
    fleet.add(3);
    fleet.drive(40);
    ASSERT_TRUE(fleet.settle());
    EXPECT_GT(known, 10U);
    EXPECT_EQ(landmarks_of(*fleet.members[2], 1), known);
    EXPECT_GT(landmarks_of(*fleet.members[2], 2), 10U);
    agreed(fleet);
  }
}

TEST(Fleet, ARestartIsANewChainAndTheOldOneStays) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(50);
  const std::size_t old = landmarks_of(*fleet.members[0], 2);
  ASSERT_GT(old, 10U);
  fleet.members[1].reset();
  MemberOptions restarted;
  restarted.epoch = 2;
  fleet.add(2, restarted);
  fleet.drive(110);
  ASSERT_TRUE(fleet.settle());
  agreed(fleet);
  const auto& chains = fleet.members[0]->manager.store().chains();
  EXPECT_EQ(chains.at({2, 1}).landmarks.size(), old);
  EXPECT_GT(chains.at({2, 2}).landmarks.size(), old);
  EXPECT_TRUE(fleet.members[0]->manager.map().map->aligned({2, 2}));
}

// ---- strangers ----

AnchorFact<SE2> anchor_fact(const ChainId& chain, std::uint32_t index) {
  AnchorFact<SE2> fact;
  fact.key = {chain, index};
  fact.state.stamp_s = fact.state.abscissa_m = 10.0 * index;
  fact.state.pose = SE2(10.0 * index, 0.0, 0.0);
  return fact;
}

LandmarkBatch<SE2> landmark_batch(const ChainId& chain, std::uint32_t first, std::uint32_t anchor) {
  LandmarkBatch<SE2> batch;
  for (std::uint32_t k = 0; k < 3; ++k) {
    LandmarkFact<SE2> fact;
    fact.key = {chain, first + k};
    fact.anchor = anchor;
    fact.position = {1.0 * k, 2.0};
    fact.covariance.setIdentity();
    batch.landmarks.push_back(fact);
  }
  return batch;
}

TEST(Strangers, WhatAnImpersonatorSaysInOurNameIsRefusedAndCounted) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(50);
  ASSERT_TRUE(fleet.settle());
  Member& self = *fleet.members[0];
  auto impersonator = fleet.network().join();
  const Hash facts = self.facts();
  const auto send = [&](const ChainId& sender, Payload<SE2> payload) {
    ASSERT_EQ(impersonator->send({sender, std::move(payload)}), SendStatus::sent);
  };
  for (const ChainId& sender : {ChainId{1, 1}, ChainId{7, 1}}) {
    send(sender, anchor_fact({1, 1}, 500));
    send(sender, landmark_batch({1, 1}, 5000, 1));
    send(sender, AssociationFact{{{1, 1}, 50}, {{Key{{1, 1}, 0}, Key{{2, 1}, 0}}}});
    send(sender, VerdictFact{{{1, 1}, 50}, 1234, true});
  }
  self.step(fleet.now_s);
  EXPECT_EQ(self.manager.counters().facts_impersonated, 2U * (1 + 3 + 1 + 1));
  EXPECT_EQ(self.facts(), facts);
  EXPECT_EQ(self.manager.store().missing_count(), 0U);

  // Nor can a digest make us look for facts of our own that never were.
  Digest digest;
  digest.marks = {{{1, 1}, FactKind::landmark, 9000, 9000, 1}, {{1, 1}, FactKind::anchor, 900, 900, 1}};
  send({7, 1}, digest);
  self.step(fleet.now_s);
  EXPECT_EQ(self.manager.store().missing_count(), 0U);
}

TEST(Strangers, OurOwnFactsStandAgainstOtherContentUnderTheirKeys) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(50);
  ASSERT_TRUE(fleet.settle());
  Member& self = *fleet.members[0];
  auto impersonator = fleet.network().join();
  const Hash facts = self.facts(), map = self.map_digest();
  ASSERT_EQ(impersonator->send({{1, 1}, anchor_fact({1, 1}, 1)}), SendStatus::sent);
  ASSERT_EQ(impersonator->send({{1, 1}, landmark_batch({1, 1}, 0, 1)}), SendStatus::sent);
  const auto received = self.manager.counters().facts_received;
  self.step(fleet.now_s);
  self.manager.rebuild(fleet.now_s, true);
  EXPECT_EQ(self.facts(), facts);
  EXPECT_EQ(self.map_digest(), map);
  EXPECT_EQ(self.manager.counters().facts_received, received);
}

TEST(Strangers, AVehicleThatIsNotOnTheRosterIsRefusedAndCounted) {
  ScriptedFleet fleet;
  MemberOptions strict;
  strict.submaps.limits.roster = {1, 2};
  Member& self = fleet.add(1, strict);
  auto stranger = fleet.network().join();
  ASSERT_EQ(stranger->send({{9, 1}, anchor_fact({9, 1}, 1)}), SendStatus::sent);
  ASSERT_EQ(stranger->send({{9, 1}, landmark_batch({9, 1}, 0, 1)}), SendStatus::sent);
  Digest digest;
  digest.marks = {{{9, 1}, FactKind::landmark, 100, 100, 1}};
  ASSERT_EQ(stranger->send({{9, 1}, digest}), SendStatus::sent);
  const Hash facts = self.facts();
  self.step(0.0);
  EXPECT_EQ(self.facts(), facts);
  EXPECT_EQ(self.manager.counters().unknown_senders, 3U);
  EXPECT_EQ(self.manager.counters().last_unknown_sender, 9U);
  // Nor does a member of the roster get a stranger's facts in.
  ASSERT_EQ(stranger->send({{2, 1}, landmark_batch({9, 1}, 0, 1)}), SendStatus::sent);
  self.step(0.5);
  EXPECT_EQ(self.facts(), facts);
  EXPECT_GE(self.manager.store().insertions()[static_cast<std::size_t>(Insertion::unknown_vehicle)], 1U);
  EXPECT_EQ(self.manager.store().missing_count(), 0U);
  EXPECT_EQ(self.manager.vehicles(0.0).size(), 1U);
  ASSERT_EQ(stranger->send({{2, 1}, anchor_fact({2, 1}, 1)}), SendStatus::sent);
  self.step(1.0);
  EXPECT_EQ(self.manager.vehicles(1.0).size(), 2U);
}

TEST(Strangers, ADigestOfAnotherDimensionIsRefusedAndCounted) {
  ScriptedFleet fleet;
  Member& self = fleet.add(1);
  auto other = fleet.network().join();
  Digest digest;
  digest.dimension = 3;
  digest.marks = {{{2, 1}, FactKind::landmark, 100, 100, 1}};
  ASSERT_EQ(other->send({{2, 1}, digest}), SendStatus::sent);
  self.step(0.0);
  EXPECT_EQ(self.manager.counters().dimension_mismatch, 1U);
  EXPECT_EQ(self.manager.store().missing_count(), 0U);
}

// ---- integrity ----

TEST(Integrity, UnalignedThenOkThenSuspectWhenStaleThenOk) {
  ScriptedFleet fleet;
  add_three(fleet);
  Member &self = *fleet.members[0], &other = *fleet.members[1];
  fleet.drive(10);
  auto state = self.view_of(other.chain(), fleet.now_s);
  EXPECT_EQ(state.integrity, Integrity::unaligned);
  EXPECT_FALSE(state.estimate);
  EXPECT_EQ(self.view_of(self.chain(), fleet.now_s).integrity, Integrity::ok);
  EXPECT_EQ(other.view_of(other.chain(), fleet.now_s).integrity, Integrity::unaligned);
  fleet.drive(110);
  ASSERT_TRUE(fleet.settle());
  state = self.view_of(other.chain(), fleet.now_s);
  EXPECT_EQ(state.integrity, Integrity::ok) << state.reasons;
  ASSERT_TRUE(state.estimate);

  for (int k = 0; k < 40; ++k) {  // 20 s without a word of it
    fleet.now_s += 0.5;
    self.step(fleet.now_s);
    fleet.members[2]->step(fleet.now_s);
  }
  state = self.view_of(other.chain(), fleet.now_s);
  EXPECT_EQ(state.integrity, Integrity::suspect);
  EXPECT_EQ(state.reasons, static_cast<std::uint32_t>(reason_stale_peer));
  EXPECT_TRUE(state.estimate);
  EXPECT_EQ(self.view_of(fleet.members[2]->chain(), fleet.now_s).integrity, Integrity::ok);
  EXPECT_EQ(self.view_of(self.chain(), fleet.now_s).integrity, Integrity::ok);
  fleet.drive(4);
  EXPECT_EQ(self.view_of(other.chain(), fleet.now_s).integrity, Integrity::ok);
}

TEST(Integrity, SuspectWhenAPeerHasTheSameFactsAndAnotherMap) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(120);
  ASSERT_TRUE(fleet.settle());
  Member& self = *fleet.members[0];
  auto liar = fleet.network().join();
  Digest digest;
  digest.facts = digest.map_facts = self.facts();
  digest.map = self.map_digest() + 1;
  ASSERT_EQ(liar->send({{2, 1}, digest}), SendStatus::sent);
  self.step(fleet.now_s);
  EXPECT_EQ(self.manager.counters().disagreements, 1U);
  const auto state = self.view_of({2, 1}, fleet.now_s);
  EXPECT_EQ(state.integrity, Integrity::suspect);
  EXPECT_TRUE(state.reasons & reason_disagreement);
  EXPECT_TRUE(self.view_of(self.chain(), fleet.now_s).reasons & reason_disagreement);
  self.step(fleet.now_s += 16.0);
  EXPECT_FALSE(self.view_of(self.chain(), fleet.now_s).reasons & reason_disagreement) << "who said so is gone";
}

TEST(Integrity, SuspectWhileFactsAreMissing) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(120);
  ASSERT_TRUE(fleet.settle());
  Member& self = *fleet.members[0];
  auto other = fleet.network().join();
  Digest digest;
  digest.marks = {{{2, 1}, FactKind::anchor, 40, 40, 1}};
  ASSERT_EQ(other->send({{2, 1}, digest}), SendStatus::sent);
  self.step(fleet.now_s);
  EXPECT_TRUE(self.view_of({2, 1}, fleet.now_s).reasons & reason_missing_facts);
}

TEST(Integrity, UnalignedForAReasonWherePlacesInCommonFitInTwoWays) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(120);
  ASSERT_TRUE(fleet.settle());
  Member& self = *fleet.members[0];
  ASSERT_EQ(self.view_of({2, 1}, fleet.now_s).reasons, static_cast<std::uint32_t>(reason_none));
  // Asked for more than this short drive has: what was found waits to be confirmed.
  SelectionParams more;
  more.min_confirmed = 1000;
  BuiltMap<SE2> built{build_global_map(self.manager.store(), more, *self.manager.backend()),
                      self.manager.store().revision()};
  int unaligned = 0;
  for (const ChainId& chain : built.map.unsettled) unaligned += !built.map.map->aligned(chain);
  ASSERT_GT(unaligned, 0);
  self.manager.adopt(std::move(built));
  for (const auto& member : fleet.members) {
    const auto state = self.view_of(member->chain(), fleet.now_s);
    const bool told = (state.reasons & reason_ambiguous) != 0;
    EXPECT_EQ(told, state.integrity == Integrity::unaligned);
  }
}

TEST(Integrity, SuspectWhileTheMapFindsItsDriftNotWhite) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(120);
  ASSERT_TRUE(fleet.settle());
  Member& self = *fleet.members[0];
  ASSERT_EQ(self.view_of({2, 1}, fleet.now_s).integrity, Integrity::ok);
  BuiltMap<SE2> built{build_global_map(self.manager.store(), {}, *self.manager.backend()),
                      self.manager.store().revision()};
  built.map.drift_alarms = {{2, 1}};
  self.manager.adopt(std::move(built));
  const auto state = self.view_of({2, 1}, fleet.now_s);
  EXPECT_EQ(state.integrity, Integrity::suspect);
  EXPECT_EQ(state.reasons, static_cast<std::uint32_t>(reason_drift));
  EXPECT_EQ(self.view_of(self.chain(), fleet.now_s).integrity, Integrity::ok);
}

// ---- the monitor ----

TEST(FleetMonitor, SeesTheMapOfTheFleetAndNeverSends) {
  ScriptedFleet fleet;
  const auto exchange = fleet.network().join();
  SubmapManagerParams params;
  params.limits.roster = {1, 2, 3};
  FleetMonitor<SE2> monitor(*exchange, params);
  add_three(fleet);
  for (int k = 0; k < 120; ++k) {
    fleet.drive(1);
    monitor.step(fleet.now_s);
  }
  ASSERT_TRUE(fleet.settle());
  monitor.step(fleet.now_s + 5.0);
  EXPECT_EQ(monitor.store().digest(), fleet.members[0]->facts());
  EXPECT_EQ(monitor.map().map->digest(), fleet.members[0]->map_digest());
  EXPECT_EQ(monitor.vehicles(fleet.now_s).size(), 3U);
  EXPECT_EQ(exchange->counters().messages_sent, 0U);
}

TEST(FleetMonitor, DoesNotEvenAskForWhatItMissed) {
  ScriptedFleet fleet;
  add_three(fleet);
  fleet.drive(50);
  const auto exchange = fleet.network().join();
  FleetMonitor<SE2> monitor(*exchange, {});  // no history: it has missed the first 50 steps
  for (int k = 0; k < 60; ++k) {
    fleet.drive(1);
    monitor.step(fleet.now_s);
  }
  EXPECT_GT(monitor.store().missing_count(), 0U);
  EXPECT_EQ(exchange->counters().messages_sent, 0U);
}

// ---- the manager by itself ----

TEST(SubmapManager, ChecksItsConfiguration) {
  InProcessNetwork<SE2> network;
  const auto exchange = network.join();
  const auto refused = [&](const ChainId& self, auto change) {
    SubmapManagerParams params;
    change(params);
    try {
      SubmapManager<SE2> manager(self, *exchange, params);
    } catch (const ConfigError&) {
      return true;
    }
    return false;
  };
  using P = SubmapManagerParams;
  EXPECT_FALSE(refused({1, 1}, [](P&) {}));
  EXPECT_TRUE(refused({0, 1}, [](P&) {}));
  EXPECT_TRUE(refused({1, 1}, [](P& p) { p.map_period_s = 0.0; }));
  EXPECT_TRUE(refused({1, 1}, [](P& p) { p.stale_peer_s = std::numeric_limits<double>::quiet_NaN(); }));
  EXPECT_TRUE(refused({1, 1}, [](P& p) { p.repair.digest_period_s = 0.0; }));
  EXPECT_TRUE(refused({1, 1}, [](P& p) { p.limits.roster = {2, 3}; }));
  EXPECT_FALSE(refused({1, 1}, [](P& p) { p.limits.roster = {1, 2}; }));
}

TEST(SubmapManager, StatesAHypothesisOnceWhoeverFindsIt) {
  InProcessNetwork<SE2> network;
  const auto exchange_1 = network.join(), exchange_2 = network.join();
  SubmapManager<SE2> one({1, 1}, *exchange_1, {}), two({2, 1}, *exchange_2, {});
  const std::vector<Pairing> pairs{{Key{{1, 1}, 0}, Key{{2, 1}, 0}}}, flipped{{Key{{2, 1}, 0}, Key{{1, 1}, 0}}};
  EXPECT_TRUE(one.publish_association(pairs));
  EXPECT_FALSE(one.publish_association(flipped));
  two.step(0.0);
  EXPECT_FALSE(two.publish_association(flipped));
  EXPECT_EQ(one.counters().facts_published, 1U);
}

TEST(SubmapManager, RebuildsOnlyWhenThereIsSomethingNewAndNotTooOften) {
  InProcessNetwork<SE2> network;
  const auto exchange = network.join();
  SubmapManager<SE2> manager({1, 1}, *exchange, {});
  EXPECT_FALSE(manager.rebuild(0.0));
  manager.open_chain(0.0, std::nullopt);
  EXPECT_TRUE(manager.rebuild(0.0));
  EXPECT_FALSE(manager.rebuild(100.0));
  manager.publish_verdict(1, true);
  EXPECT_TRUE(manager.rebuild(100.0));
  manager.publish_verdict(2, true);
  EXPECT_FALSE(manager.rebuild(100.5));
  EXPECT_TRUE(manager.rebuild(100.5, true));
  EXPECT_EQ(manager.counters().maps_built, 3U);
}

TEST(SubmapManager, RoundsLandmarksBeforeAnybodySeesThemAndRefusesTheUnfitAsTheyCame) {
  InProcessNetwork<SE2> network;
  const auto exchange = network.join(), peer = network.join();
  SubmapManager<SE2> manager({1, 1}, *exchange, {});
  manager.open_chain(0.0, std::nullopt);
  LandmarkFact<SE2> fit;
  fit.position = {1.0 / 3.0, 2.0 / 3.0};
  fit.covariance << 0.2, 0.05, 0.05, 0.1;
  fit.loading.col(2) << 0.2 / 3.0, 0.1 / 3.0;
  ASSERT_FALSE(is_rounded(fit));
  std::vector<LandmarkFact<SE2>> batch(6, fit);
  batch[1].covariance(0, 1) += 0.01;  // not symmetric: rounding would make it so
  batch[2].covariance *= -1.0;
  batch[3].loading(1, 2) = 1e300;
  batch[4].position[0] = NAN;
  ChainState<SE2> closing;
  closing.stamp_s = closing.abscissa_m = 10.0;
  closing.pose = SE2(10.0, 0.0, 0.0);
  const auto indices = manager.publish_segment(closing, batch);
  EXPECT_EQ(indices, (std::vector<std::optional<std::uint32_t>>{0, {}, {}, {}, {}, 1}));
  EXPECT_EQ(manager.counters().facts_unfit, 4U);
  std::vector<LandmarkFact<SE2>> heard;
  for (const Message<SE2>& message : peer->take(0.0))
    if (const auto* landmarks = std::get_if<LandmarkBatch<SE2>>(&message.payload)) heard = landmarks->landmarks;
  ASSERT_EQ(heard.size(), 2U);
  for (std::uint32_t i = 0; i < 2; ++i) {
    const auto* held = manager.store().landmark({{1, 1}, i});
    ASSERT_NE(held, nullptr);
    EXPECT_TRUE(is_rounded(*held));
    EXPECT_EQ(hash_of(heard[i]), hash_of(*held));
  }
}

TEST(FrontEndComponent, NamesWhatItExportsAndInflatesItsCovariance) {
  InProcessNetwork<SE2> network;
  const auto exchange = network.join();
  SubmapManager<SE2> manager({1, 1}, *exchange, {});
  FrozenLandmarks<SE2> front_end;
  DriftParams<SE2> drift;
  drift.landmark_inflation = 3.0;
  FrontEndComponent<SE2> component(front_end, manager, drift);
  std::vector<std::pair<std::uint32_t, std::uint64_t>> exported;
  component.on_export([&](std::uint32_t index, std::uint64_t track) { exported.emplace_back(index, track); });
  manager.open_chain(0.0, std::nullopt);
  FrozenLandmark<SE2> l;
  l.position = {3.0, 4.0};
  l.covariance << 0.2, 0.05, 0.05, 0.1;
  l.loading.col(1) << 0.2, 0.1;
  FrontEndState<SE2> state;
  for (int k = 1; k <= 3; ++k) {
    state.stamp_s = state.abscissa_m = 10.0 * k;
    state.pose = SE2(10.0 * k, 0.0, 0.0);
    ASSERT_TRUE(front_end.advance(state));
    l.track = 100U + static_cast<std::uint64_t>(k);
    front_end.close({l});
    component.poll();
  }
  using Exported = decltype(exported);
  EXPECT_EQ(exported, (Exported{{0, 101}, {1, 102}, {2, 103}}));
  EXPECT_EQ(component.landmarks_exported(), 3U);
  const auto* fact = manager.store().landmark({{1, 1}, 2});
  ASSERT_NE(fact, nullptr);
  EXPECT_EQ(fact->anchor, 3U);
  EXPECT_TRUE(is_rounded(*fact));
  EXPECT_TRUE(fact->covariance.isApprox(3.0 * l.covariance, 1e-2));
  EXPECT_TRUE((fact->loading * fact->loading.transpose()).isApprox(3.0 * l.loading * l.loading.transpose(), 1e-2));
  EXPECT_EQ(manager.store().missing_count(), 0U);
}

}  // namespace
}  // namespace convoy
