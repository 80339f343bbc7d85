#include <convoy/submap/fact_store.hpp>

#include "../sample_facts.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include <algorithm>
#include <limits>
#include <random>
#include <string>

namespace convoy {
namespace {

using test::anchor;
using test::association;
using test::chain_of;
using test::counted;
using test::key_of;
using test::landmark;
using test::pairings;
using test::prior;
using test::Store;
using test::verdict;

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

std::vector<test::Fact> fleet_facts() {
  std::vector<test::Fact> facts;
  for (const VehicleId vehicle : {1U, 2U, 3U}) {
    const auto own = test::chain_facts(vehicle, 6);
    facts.insert(facts.end(), own.begin(), own.end());
  }
  return facts;
}

TEST(FactStore, IsEmptyAtFirst) {
  const Store store;
  EXPECT_EQ(store.size(), 0U);
  EXPECT_EQ(store.digest(), 0U);
  EXPECT_EQ(store.revision(), 0U);
  EXPECT_TRUE(store.marks().empty());
  EXPECT_EQ(store.missing_count(), 0U);
  EXPECT_EQ(store.anchor(key_of(1, 0)), nullptr);
  EXPECT_EQ(store.landmark(key_of(1, 0)), nullptr);
  EXPECT_EQ(store.prior(chain_of(1)), nullptr);
  EXPECT_TRUE(store.missing(chain_of(1), FactKind::anchor).empty());
}

TEST(FactStore, HoldsWhatWasInserted) {
  Store store;
  for (const auto& fact : fleet_facts()) ASSERT_EQ(test::insert(store, fact), Insertion::inserted);
  EXPECT_EQ(store.size(), fleet_facts().size());
  EXPECT_EQ(store.revision(), store.size());
  EXPECT_EQ(counted(store, Insertion::inserted), store.size());
  EXPECT_EQ(store.missing_count(), 0U);
  EXPECT_EQ(store.chains().size(), 3U);
  ASSERT_NE(store.anchor(key_of(2, 4)), nullptr);
  EXPECT_EQ(hash_of(*store.anchor(key_of(2, 4))), hash_of(anchor(2, 4)));
  ASSERT_NE(store.landmark(key_of(3, 23)), nullptr);
  EXPECT_EQ(hash_of(*store.landmark(key_of(3, 23))), hash_of(landmark(3, 23)));
  ASSERT_NE(store.prior(chain_of(1)), nullptr);
  EXPECT_EQ(hash_of(*store.prior(chain_of(1))), hash_of(prior(1)));
  EXPECT_EQ(store.chains().at(chain_of(1)).batches.at(2), (std::vector<std::uint32_t>{8, 9, 10, 11}));
}

TEST(FactStore, IsTheSameInAnyOrderAndWithDuplicates) {
  Store reference;
  for (const auto& fact : fleet_facts()) test::insert(reference, fact);
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto set = fleet_facts();
    const auto once = set.size();
    std::vector<test::Fact> facts;
    for (int copy = 0; copy < 3; ++copy) facts.insert(facts.end(), set.begin(), set.end());
    std::mt19937_64 random(seed);
    std::shuffle(facts.begin(), facts.end(), random);
    Store store;
    for (const auto& fact : facts) test::insert(store, fact);
    EXPECT_EQ(store.digest(), reference.digest());
    EXPECT_EQ(store.marks(), reference.marks());
    EXPECT_EQ(store.size(), once);
    EXPECT_EQ(store.missing_count(), 0U);
    EXPECT_EQ(counted(store, Insertion::duplicate), 2 * once);
    for (const auto& [id, chain] : reference.chains()) EXPECT_EQ(store.chains().at(id).batches, chain.batches);
  }
}

TEST(FactStore, DigestTellsSetsApart) {
  const auto facts = fleet_facts();
  std::vector<Hash> digests;
  for (std::size_t left_out = 0; left_out <= facts.size(); ++left_out) {
    Store store;
    for (std::size_t i = 0; i < facts.size(); ++i)
      if (i != left_out) test::insert(store, facts[i]);
    digests.push_back(store.digest());
  }
  std::sort(digests.begin(), digests.end());
  EXPECT_EQ(std::unique(digests.begin(), digests.end()), digests.end());
}

TEST(FactStore, DigestCountsAHypothesisOnceWhoeverStatesIt) {
  Store one, other, both;
  const auto list = pairings(1, 2, 0, 3);
  EXPECT_EQ(one.insert(association(1, 0, list)), Insertion::inserted);
  EXPECT_EQ(other.insert(association(2, 0, list)), Insertion::inserted);
  EXPECT_EQ(both.insert(association(1, 0, list)), Insertion::inserted);
  EXPECT_EQ(both.insert(association(2, 0, list)), Insertion::inserted);
  EXPECT_NE(one.digest(), 0U);
  EXPECT_EQ(one.digest(), other.digest());
  EXPECT_EQ(one.digest(), both.digest());
  EXPECT_EQ(both.size(), 2U);
}

TEST(FactStore, ConflictKeepsWhatIsHeldAndFlagsTheAuthor) {
  Store store;
  store.insert(anchor(1, 0));
  store.insert(landmark(1, 0));
  store.insert(landmark(2, 0));
  const Hash digest = store.digest();
  const auto marks = store.marks();
  const auto revision = store.revision();
  auto forged = landmark(1, 0);
  forged.position.x() += 1.0;
  EXPECT_EQ(store.insert(forged), Insertion::conflict);
  EXPECT_EQ(store.insert(forged), Insertion::conflict);
  EXPECT_EQ(counted(store, Insertion::conflict), 2U);
  EXPECT_EQ(hash_of(*store.landmark(key_of(1, 0))), hash_of(landmark(1, 0)));
  EXPECT_EQ(store.digest(), digest);
  EXPECT_EQ(store.marks(), marks);
  EXPECT_EQ(store.revision(), revision);
  EXPECT_TRUE(store.chains().at(chain_of(1)).equivocated);
  EXPECT_FALSE(store.chains().at(chain_of(2)).equivocated);
}

TEST(FactStore, ConflictIsFoundInEveryKind) {
  Store store;
  for (const auto& fact : test::chain_facts(1, 3)) ASSERT_EQ(test::insert(store, fact), Insertion::inserted);
  const Hash digest = store.digest();
  auto a = anchor(1, 2);
  a.state.stamp_s += 1.0;
  auto p = prior(1);
  p.covariance *= 2.0;
  EXPECT_EQ(store.insert(a), Insertion::conflict);
  EXPECT_EQ(store.insert(p), Insertion::conflict);
  EXPECT_EQ(store.insert(association(1, 0, pairings(1, 2, 0, 2))), Insertion::conflict);
  EXPECT_EQ(store.insert(verdict(1, 0, 4711, true)), Insertion::conflict);
  EXPECT_EQ(store.digest(), digest);
}

TEST(FactStore, ANewEpochIsAnotherChain) {
  Store store;
  auto restarted = landmark(1, 0);
  restarted.key.chain.epoch += 1;
  restarted.position.x() += 1.0;
  EXPECT_EQ(store.insert(landmark(1, 0)), Insertion::inserted);
  EXPECT_EQ(store.insert(restarted), Insertion::inserted);
  EXPECT_EQ(store.chains().size(), 2U);
}

/// A refused fact is counted under its reason, and leaves no trace.
template <class Fact>
void expect_refused(const Fact& fact, Insertion reason, const FactLimits& limits = {}) {
  SCOPED_TRACE(to_string(reason));
  Store store(limits);
  ASSERT_EQ(store.insert(landmark(1, 0)), Insertion::inserted);
  const Hash digest = store.digest();
  const auto marks = store.marks();
  EXPECT_EQ(store.insert(fact), reason) << "got " << to_string(store.insert(fact));
  EXPECT_GE(counted(store, reason), 1U);
  EXPECT_EQ(counted(store, Insertion::inserted), 1U);
  EXPECT_EQ(store.digest(), digest);
  EXPECT_EQ(store.marks(), marks);
  EXPECT_EQ(store.revision(), 1U);
  EXPECT_EQ(store.size(), 1U);
  EXPECT_EQ(store.chains().size(), 1U);
}

template <class Fact, class Change>
Fact changed(Fact fact, Change change) {
  change(fact);
  return fact;
}

TEST(FactStore, RefusesNumbersThatAreNotFinite) {
  for (const double bad : {nan, infinity, -infinity}) {
    const auto refuse = [](const auto& fact) { expect_refused(fact, Insertion::not_finite); };
    refuse(changed(landmark(1, 1), [&](auto& f) { f.position.x() = bad; }));
    refuse(changed(landmark(1, 1), [&](auto& f) { f.position.y() = bad; }));
    refuse(changed(landmark(1, 1), [&](auto& f) { f.covariance(1, 0) = f.covariance(0, 1) = bad; }));
    refuse(changed(landmark(1, 1), [&](auto& f) { f.covariance(1, 1) = bad; }));
    refuse(changed(landmark(1, 1), [&](auto& f) { f.loading(1, 0) = bad; }));
    refuse(changed(anchor(1, 1), [&](auto& f) { f.state.stamp_s = bad; }));
    refuse(changed(anchor(1, 1), [&](auto& f) { f.state.abscissa_m = bad; }));
    refuse(changed(anchor(1, 1), [&](auto& f) { f.state.pose = SE2(bad, 0.0, 0.0); }));
    refuse(changed(anchor(1, 1), [&](auto& f) { f.state.pose = SE2(0.0, 0.0, bad); }));
    refuse(changed(anchor(1, 1), [&](auto& f) { f.state.drift(2, 2) = bad; }));
    refuse(changed(prior(1), [&](auto& f) { f.mean = SE2(0.0, bad, 0.0); }));
    refuse(changed(prior(1), [&](auto& f) { f.covariance(0, 0) = bad; }));
  }
}

TEST(FactStore, RefusesWhatIsNoCovariance) {
  const auto refuse = [](const auto& fact) { expect_refused(fact, Insertion::not_covariance); };
  refuse(changed(landmark(1, 1), [](auto& f) { f.covariance << 1.0, 2.0, 2.0, 1.0; }));
  refuse(changed(landmark(1, 1), [](auto& f) { f.covariance << 1.0, 0.5, 0.0, 1.0; }));
  refuse(changed(landmark(1, 1), [](auto& f) { f.loading(0, 0) = 0.3; }));  // shares more than it has
  refuse(changed(anchor(1, 1), [](auto& f) { f.state.drift(1, 1) = -1e-3; }));
  refuse(changed(prior(1), [](auto& f) { f.covariance(0, 2) = 5.0; }));
}

TEST(FactStore, TakesAnExactlyKnownPrior) {
  Store store;
  auto exact = prior(1);
  exact.covariance.setZero();
  EXPECT_EQ(store.insert(exact), Insertion::inserted);
}

TEST(FactStore, TakesAnUnknownStartOnlyIfItSaysNothingMore) {
  PriorFact<SE2> unknown;
  unknown.key = key_of(1, 0);
  Store store;
  EXPECT_EQ(store.insert(unknown), Insertion::inserted);
  expect_refused(changed(prior(1), [](auto& f) { f.known = false; }), Insertion::malformed);
  expect_refused(changed(unknown, [](auto& f) { f.mean = SE2(0.0, 0.0, 0.1); }), Insertion::malformed);
}

TEST(FactStore, RefusesWhatIsBeyondItsLimits) {
  FactLimits limits;
  limits.max_coordinate_m = 1000.0;
  limits.max_sigma_m = 100.0;
  limits.max_index = 50;
  limits.max_pairings = 3;
  const auto refuse = [&](const auto& fact) { expect_refused(fact, Insertion::out_of_range, limits); };
  refuse(changed(landmark(1, 1), [](auto& f) { f.position.x() = -1001.0; }));
  refuse(changed(landmark(1, 1), [](auto& f) { f.covariance(0, 0) = 10001.0; }));
  refuse(changed(landmark(1, 1), [](auto& f) { f.key.index = 51; }));
  refuse(changed(landmark(1, 1), [](auto& f) { f.anchor = 51; }));
  refuse(changed(anchor(1, 1), [](auto& f) { f.state.pose = SE2(0.0, 1001.0, 0.0); }));
  refuse(changed(anchor(1, 1), [](auto& f) { f.state.abscissa_m = 1001.0; }));
  refuse(changed(anchor(1, 1), [](auto& f) { f.state.abscissa_m = -1e-9; }));
  refuse(changed(anchor(1, 1), [](auto& f) { f.state.drift(1, 1) = 10001.0; }));
  refuse(changed(anchor(1, 1), [](auto& f) { f.first_landmark = 48, f.landmark_count = 4; }));
  refuse(changed(anchor(1, 1), [](auto& f) { f.first_landmark = 0xffffffffU, f.landmark_count = 2; }));
  refuse(changed(prior(1), [](auto& f) { f.mean = SE2(1001.0, 0.0, 0.0); }));
  refuse(changed(prior(1), [](auto& f) { f.key.index = 1; }));
  refuse(association(1, 0, pairings(1, 2, 0, 4)));
  refuse(association(1, 0, {{key_of(1, 0), key_of(2, 51)}}));
  refuse(verdict(1, 51, 1, true));
  Store store(limits);
  EXPECT_EQ(store.insert(association(1, 0, pairings(1, 2, 0, 3))), Insertion::inserted);
  EXPECT_EQ(store.insert(landmark(1, 50)), Insertion::inserted);
}

TEST(FactStore, RefusesStrangers) {
  FactLimits limits;
  limits.roster = {1, 2};
  const auto refuse = [&](const auto& fact) { expect_refused(fact, Insertion::unknown_vehicle, limits); };
  refuse(anchor(3, 0));
  refuse(landmark(3, 0));
  refuse(prior(3));
  refuse(association(3, 0, pairings(1, 2, 0, 3)));
  refuse(association(1, 0, pairings(2, 3, 0, 3)));
  refuse(verdict(3, 0, 1, true));
}

TEST(FactStore, RefusesWhatIsMalformed) {
  const auto refuse = [](const auto& fact) { expect_refused(fact, Insertion::malformed); };
  refuse(landmark(0, 0));  // nobody's
  refuse(association(1, 0, {}));
  refuse(association(1, 0, {{key_of(2, 0), key_of(1, 0)}}));                                // not canonical
  refuse(association(1, 0, {{key_of(1, 1), key_of(2, 1)}, {key_of(1, 0), key_of(2, 0)}}));  // not sorted
  refuse(association(1, 0, {{key_of(1, 0), key_of(2, 0)}, {key_of(1, 0), key_of(2, 0)}}));  // repeated
  refuse(association(1, 0, {{key_of(1, 0), key_of(1, 0)}}));                                // with itself
  refuse(changed(anchor(1, 0), [](auto& f) { f.state.pose = SE2(1.0, 0.0, 0.0); }));        // not the origin
  refuse(changed(anchor(1, 0), [](auto& f) { f.state.abscissa_m = 1.0; }));
  refuse(changed(anchor(1, 0), [](auto& f) { f.state.drift.setIdentity(); }));
}

TEST(FactStore, NamesEveryReason) {
  std::vector<std::string> names;
  for (int i = 0; i < insertion_count; ++i) names.emplace_back(to_string(static_cast<Insertion>(i)));
  std::sort(names.begin(), names.end());
  EXPECT_EQ(std::unique(names.begin(), names.end()), names.end());
  EXPECT_EQ(std::count(names.begin(), names.end(), "unknown"), 0);
}

TEST(FactStore, KnowsItsGaps) {
  Store store;
  for (const std::uint32_t index : {2U, 3U, 7U}) store.insert(landmark(1, index));
  const std::vector<IndexRange> gaps{{0, 2}, {4, 7}};
  EXPECT_EQ(store.missing(chain_of(1), FactKind::landmark), gaps);
  EXPECT_EQ(store.missing(chain_of(1), FactKind::landmark, 1), (std::vector<IndexRange>{{0, 2}}));
  EXPECT_TRUE(store.missing(chain_of(2), FactKind::landmark).empty());
  store.insert(landmark(1, 5));
  EXPECT_EQ(store.missing(chain_of(1), FactKind::landmark), (std::vector<IndexRange>{{0, 2}, {4, 5}, {6, 7}}));
}

TEST(FactStore, LandmarksProveTheirAnchors) {
  Store store;
  store.insert(landmark(1, 9));  // of anchor 2
  EXPECT_EQ(store.missing(chain_of(1), FactKind::anchor), (std::vector<IndexRange>{{0, 3}}));
  EXPECT_EQ(store.missing_count(), 3U + 9U);
  store.insert(anchor(1, 1));
  EXPECT_EQ(store.missing(chain_of(1), FactKind::anchor), (std::vector<IndexRange>{{0, 1}, {2, 3}}));
}

TEST(FactStore, AnchorsProveTheirLandmarks) {
  Store store;
  auto closing = anchor(1, 1);
  closing.first_landmark = 4;
  closing.landmark_count = 3;
  EXPECT_EQ(store.insert(closing), Insertion::inserted);
  EXPECT_EQ(store.missing(chain_of(1), FactKind::landmark), (std::vector<IndexRange>{{0, 7}}));
  store.insert(landmark(1, 5));
  EXPECT_EQ(store.missing(chain_of(1), FactKind::landmark), (std::vector<IndexRange>{{0, 5}, {6, 7}}));
}

TEST(FactStore, AnnouncementsMakeLostTailsVisible) {
  Store store;
  store.insert(anchor(1, 0));
  const Hash digest = store.digest();
  store.announce(chain_of(1), FactKind::anchor, 4);
  store.announce(chain_of(2), FactKind::verdict, 2);  // nothing held of it at all
  EXPECT_EQ(store.missing(chain_of(1), FactKind::anchor), (std::vector<IndexRange>{{1, 4}}));
  EXPECT_EQ(store.missing(chain_of(2), FactKind::verdict), (std::vector<IndexRange>{{0, 2}}));
  EXPECT_EQ(store.missing_count(), 5U);
  store.announce(chain_of(1), FactKind::anchor, 2);  // can only raise
  EXPECT_EQ(store.missing_count(), 5U);
  EXPECT_EQ(store.digest(), digest);
  EXPECT_EQ(store.size(), 1U);
  EXPECT_EQ(store.revision(), 1U);
  for (const std::uint32_t index : {1U, 2U, 3U}) store.insert(anchor(1, index));
  EXPECT_TRUE(store.missing(chain_of(1), FactKind::anchor).empty());
}

TEST(FactStore, OnlyWhatIsProvenIsToldFurther) {
  Store store, further;
  store.insert(anchor(1, 0));
  store.announce(chain_of(1), FactKind::anchor, 9000);
  EXPECT_EQ(store.missing_count(), 8999U);
  EXPECT_EQ(store.marks(), (std::vector<ChainMark>{{chain_of(1), FactKind::anchor, 1, 1, hash_of(anchor(1, 0))}}));
  store.announce_own(chain_of(1), FactKind::anchor, 3);
  EXPECT_EQ(store.missing(chain_of(1), FactKind::anchor), (std::vector<IndexRange>{{1, 3}})) << "its author knows";
  EXPECT_EQ(store.marks()[0].high_water, 3U);
  store.insert(anchor(1, 5));  // said before that
  store.announce_own(chain_of(1), FactKind::anchor, 2);
  EXPECT_EQ(store.marks()[0].high_water, 6U);
  EXPECT_EQ(store.missing(chain_of(1), FactKind::anchor), (std::vector<IndexRange>{{1, 5}}));
}

TEST(FactStore, ChainsThatAreOnlyTalkedOfAreFewAndTakeNobodysShare) {
  FactLimits limits;
  limits.max_rumoured_chains = 10;
  limits.max_chains_per_vehicle = 3;
  Store store(limits);
  for (Epoch e = 1; e <= 1000; ++e) store.announce({7, e}, FactKind::anchor, 5);
  EXPECT_EQ(store.chains().size(), 10U);
  EXPECT_TRUE(store.is_full_of_rumours());
  EXPECT_TRUE(store.marks().empty());
  for (const Epoch e : {5U, 600U, 601U}) {
    auto fact = anchor(7, 0);
    fact.key.chain.epoch = e;
    EXPECT_EQ(store.insert(fact), Insertion::inserted) << e;
  }
  EXPECT_FALSE(store.is_full_of_rumours()) << "one of them is there";
  EXPECT_EQ(store.chains().size(), 12U);
  store.forget_rumours({7, 1});
  store.forget_rumours({7, 5});  // not only talked of
  EXPECT_EQ(store.chains().size(), 11U);
  EXPECT_EQ(store.missing_count(), 8U * 5U + 4U);
}

TEST(FactStore, OnesOwnChainTakesNoShare) {
  FactLimits limits;
  limits.max_chains_per_vehicle = 2;
  limits.max_facts_per_vehicle = 4;
  Store store(limits);
  store.set_own({1, 9});
  for (Epoch e = 1; e <= 8; ++e) {
    auto fact = anchor(1, 0);
    fact.key.chain.epoch = e;
    EXPECT_EQ(store.insert(fact), e <= 2 ? Insertion::inserted : Insertion::over_share);
  }
  EXPECT_TRUE(store.is_full({1, 3}));
  EXPECT_FALSE(store.is_full({1, 9}));
  for (std::uint32_t k = 0; k < 20; ++k) {
    auto fact = anchor(1, k);
    fact.key.chain.epoch = 9;
    EXPECT_EQ(store.insert(fact), Insertion::inserted);
  }
  store.announce({1, 9}, FactKind::anchor, 100);
  EXPECT_EQ(store.missing_count(), 0U) << "nobody knows more of it";
}

TEST(FactStore, HolesAreNamedFromWhereOneWishes) {
  Store store;
  for (const std::uint32_t k : {2U, 4U, 6U}) store.insert(anchor(1, k));
  const auto holes = [&](std::size_t most, std::uint32_t from) {
    return store.missing(chain_of(1), FactKind::anchor, most, from);
  };
  EXPECT_EQ(holes(2, 0), (std::vector<IndexRange>{{0, 2}, {3, 4}}));
  EXPECT_EQ(holes(2, 4), (std::vector<IndexRange>{{5, 6}}));
  EXPECT_EQ(holes(2, 1), (std::vector<IndexRange>{{1, 2}, {3, 4}}));
  EXPECT_TRUE(holes(2, 7).empty());
}

TEST(FactStore, EveryKindHasGapsOfItsOwn) {
  Store store;
  for (int kind = 0; kind < fact_kind_count; ++kind) {
    store.announce(chain_of(1), static_cast<FactKind>(kind), 1);
    EXPECT_EQ(store.missing(chain_of(1), static_cast<FactKind>(kind)), (std::vector<IndexRange>{{0, 1}}));
    EXPECT_EQ(store.missing_count(), static_cast<std::uint64_t>(kind + 1));
  }
  for (const auto& fact : test::chain_facts(1, 1)) test::insert(store, fact);
  EXPECT_EQ(store.missing_count(), 1U) << "vehicle 1 was seen by nobody";
  store.insert(WaypointFact<SE2>{key_of(1, 0), 0, {}, key_of(2, 0)});
  EXPECT_EQ(store.missing(chain_of(1), FactKind::waypoint), std::vector<IndexRange>{});
  EXPECT_EQ(store.missing_count(), 1U) << "the encounter that it answers";
}

TEST(FactStore, AnnouncementsOfStrangersOrBeyondTheLimitsChangeNothing) {
  FactLimits limits;
  limits.roster = {1};
  limits.max_index = 100;
  Store store(limits);
  store.announce(chain_of(2), FactKind::anchor, 5);
  store.announce(chain_of(0), FactKind::anchor, 5);
  store.announce(chain_of(1), FactKind::anchor, 102);
  store.announce(chain_of(1), FactKind::anchor, 0);
  EXPECT_TRUE(store.marks().empty());
  store.announce(chain_of(1), FactKind::anchor, 101);
  EXPECT_EQ(store.missing_count(), 101U);
}

TEST(FactStore, MarksTellHeldFromKnown) {
  Store store;
  store.insert(landmark(2, 1));
  store.insert(prior(1));
  const auto marks = store.marks();
  ASSERT_EQ(marks.size(), 3U);  // canonical order: vehicle 1's prior, vehicle 2's anchor (proved), then its landmarks
  EXPECT_EQ(marks[0], (ChainMark{chain_of(1), FactKind::prior, 1, 1, hash_of(prior(1))}));
  EXPECT_EQ(marks[1], (ChainMark{chain_of(2), FactKind::anchor, 1, 0, 0}));
  EXPECT_EQ(marks[2], (ChainMark{chain_of(2), FactKind::landmark, 2, 1, hash_of(landmark(2, 1))}));
}

TEST(FactStoreInSpace, RefusesWhatIsNotFiniteInAnyCoordinate) {
  FactStore<SE3> store;
  AnchorFact<SE3> good{test::key_of(1, 1), {}};
  good.state.pose = SE3({1.0, 0.2, -0.1, 0.3}, {1.0, 2.0, 3.0});
  good.state.drift.setIdentity();
  for (int k = 0; k < 7; ++k) {
    SE3::Point t = good.state.pose.translation();
    SE3::Quaternion q = good.state.pose.quaternion();
    (k < 3 ? t[k] : q[k - 3]) = nan;
    AnchorFact<SE3> bad = good;
    bad.state.pose = SE3(q, t);
    EXPECT_EQ(store.insert(bad), Insertion::not_finite) << k;
  }
  AnchorFact<SE3> start{test::key_of(1, 0), {}};
  start.state.pose = SE3({1.0, 0.0, 0.0, 1e-3}, SE3::Point::Zero());
  EXPECT_EQ(store.insert(start), Insertion::malformed) << "a chain begins at the identity";
  start.state.pose = {};
  EXPECT_EQ(store.insert(start), Insertion::inserted);
  EXPECT_EQ(store.insert(good), Insertion::inserted);
  EXPECT_EQ(store.insert(good), Insertion::duplicate);
  good.state.pose = good.state.pose * SE3({1.0, 1e-9, 0.0, 0.0}, SE3::Point::Zero());
  EXPECT_EQ(store.insert(good), Insertion::conflict);
}

TEST(FactStore, RefusesAbsoluteFixesThatCannotBe) {
  test::Store store;
  const AbsoluteFixFact<SE2> good = test::absolute_fix(3, 2);
  const auto spoilt = [&](auto spoil) {
    AbsoluteFixFact<SE2> fact = good;
    spoil(fact);
    return store.check(fact);
  };
  EXPECT_EQ(spoilt([](auto& f) { f.key.chain.vehicle = 0; }), Insertion::malformed);
  EXPECT_EQ(spoilt([](auto& f) { f.position[1] = NAN; }), Insertion::not_finite);
  EXPECT_EQ(spoilt([](auto& f) { f.lever[0] = INFINITY; }), Insertion::not_finite);
  EXPECT_EQ(spoilt([](auto& f) { f.state.stamp_s = NAN; }), Insertion::not_finite);
  EXPECT_EQ(spoilt([](auto& f) { f.covariance(0, 0) = -1.0; }), Insertion::not_covariance);
  EXPECT_EQ(spoilt([](auto& f) { f.covariance(0, 1) += 0.1; }), Insertion::not_covariance);
  EXPECT_EQ(spoilt([](auto& f) { f.state.drift(0, 0) = -1.0; }), Insertion::not_covariance);
  EXPECT_EQ(spoilt([](auto& f) { f.position[0] = 1e7; }), Insertion::out_of_range);
  EXPECT_EQ(spoilt([](auto& f) { f.lever[0] = -1e7; }), Insertion::out_of_range);
  EXPECT_EQ(spoilt([](auto& f) { f.state.abscissa_m = -1.0; }), Insertion::out_of_range);
  EXPECT_EQ(spoilt([](auto& f) { f.anchor = 0xffffffffU; }), Insertion::out_of_range);
  EXPECT_EQ(store.insert(good), Insertion::inserted);
  EXPECT_EQ(store.insert(good), Insertion::duplicate);
  EXPECT_EQ(store.missing(good.key.chain, FactKind::anchor), (std::vector<IndexRange>{{0, 3}}))
      << "its anchor is known to exist";
  EXPECT_EQ(store.missing(good.key.chain, FactKind::absolute_fix), (std::vector<IndexRange>{{0, 2}}));
}

TEST(FactStore, RefusesEncountersAndWaypointsThatCannotBe) {
  test::Store store;
  const auto encounter = [&](auto spoil) {
    EncounterFact<SE2> fact = test::encounter(3, 2);
    spoil(fact);
    return store.check(fact);
  };
  EXPECT_EQ(encounter([](auto& f) { f.other = 3; }), Insertion::malformed) << "of itself";
  EXPECT_EQ(encounter([](auto& f) { f.other = 0; }), Insertion::malformed) << "of nobody";
  EXPECT_EQ(encounter([](auto& f) { f.position[0] = NAN; }), Insertion::not_finite);
  EXPECT_EQ(encounter([](auto& f) { f.state.heading_lever[0] = INFINITY; }), Insertion::not_finite);
  EXPECT_EQ(encounter([](auto& f) { f.state.heading_lever[0] = 1e16; }), Insertion::out_of_range);
  EXPECT_EQ(encounter([](auto& f) { f.covariance(0, 0) = -1.0; }), Insertion::not_covariance);
  EXPECT_EQ(encounter([](auto& f) { f.position[1] = 1e7; }), Insertion::out_of_range);
  EXPECT_EQ(encounter([](auto& f) { f.anchor = 0xffffffffU; }), Insertion::out_of_range);
  const auto waypoint = [&](auto spoil) {
    WaypointFact<SE2> fact = test::waypoint(3, 2);
    spoil(fact);
    return store.check(fact);
  };
  EXPECT_EQ(waypoint([](auto& f) { f.encounter.chain.vehicle = 3; }), Insertion::malformed) << "its own encounter";
  EXPECT_EQ(waypoint([](auto& f) { f.encounter.chain.vehicle = 0; }), Insertion::malformed);
  EXPECT_EQ(waypoint([](auto& f) { f.mark[0] = NAN; }), Insertion::not_finite);
  EXPECT_EQ(waypoint([](auto& f) { f.mark[0] = 1e7; }), Insertion::out_of_range);
  EXPECT_EQ(waypoint([](auto& f) { f.anchor = 0xffffffffU; }), Insertion::out_of_range);
  EXPECT_EQ(waypoint([](auto& f) { f.encounter.index = 0xffffffffU; }), Insertion::out_of_range);
  FactLimits limits;
  limits.roster = {1, 2, 3};
  EXPECT_EQ(test::Store(limits).check(test::encounter(3, 2)), Insertion::unknown_vehicle) << "4 is not on the roster";
  EXPECT_EQ(store.insert(test::waypoint(3, 2)), Insertion::inserted);
  EXPECT_EQ(store.missing(test::chain_of(3), FactKind::anchor), (std::vector<IndexRange>{{0, 3}}));
  EXPECT_EQ(store.missing(test::chain_of(2), FactKind::encounter), (std::vector<IndexRange>{{0, 3}}))
      << "what it answers is known to exist";
}

}  // namespace
}  // namespace convoy
