#include <convoy/map/ekf_map.hpp>
#include <convoy/map/global_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>

namespace convoy {
namespace {

using test::built;
using test::SampleFleet;
using test::Store;

bool bit_equal(const SE2& a, const SE2& b) { return a.translation() == b.translation() && a.theta() == b.theta(); }

/// The poses of all nodes by anchor.
std::map<Key, SE2> poses_of(const GlobalMap<SE2>& global) {
  std::map<Key, SE2> poses;
  for (std::size_t n = 0; n < global.map->poses().size(); ++n)
    poses[global.map->problem().nodes[n].anchor] = global.map->poses()[n];
  return poses;
}

void expect_bit_equal(const GlobalMap<SE2>& a, const GlobalMap<SE2>& b) {
  const auto pa = poses_of(a), pb = poses_of(b);
  ASSERT_EQ(pa.size(), pb.size());
  for (const auto& [key, pose] : pa) {
    ASSERT_TRUE(pb.count(key));
    EXPECT_TRUE(bit_equal(pose, pb.at(key))) << key.chain.vehicle << "/" << key.index;
  }
  EXPECT_EQ(a.map->digest(), b.map->digest());
  EXPECT_EQ(a.selection.digest(), b.selection.digest());
}

HypothesisState state_of(const GlobalMap<SE2>& global, Hash id) {
  for (const auto& h : global.selection.hypotheses)
    if (h.id == id) return h.state;
  return HypothesisState::waiting;
}

TEST(BuildGlobalMap, IsTheSameToTheBitInEveryOrderOfArrivalWithDuplicates) {
  auto fleet = test::street_fleet(1);
  const auto reference = built(fleet.store());
  ASSERT_GE(reference.selection.classes.size(), 20U);
  ASSERT_TRUE(reference.map->report().converged);
  for (int order = 0; order < 50; ++order) {
    auto facts = fleet.facts;
    facts.insert(facts.end(), fleet.facts.begin(),
                 fleet.facts.begin() + static_cast<std::ptrdiff_t>(fleet.facts.size() / 2));
    std::shuffle(facts.begin(), facts.end(), fleet.random().engine());
    const Store store = SampleFleet::store_of(facts);
    const auto global = built(store);
    ASSERT_EQ(global.facts, reference.facts);
    expect_bit_equal(global, reference);
    if (HasFailure()) return;
  }
}

TEST(BuildGlobalMap, IsTheSameWhetherBuiltOnTheWayOrOnce) {
  const auto fleet = test::street_fleet(2);
  Store store;
  int maps = 0;
  GlobalMap<SE2> last;
  for (std::size_t k = 0; k < fleet.facts.size(); ++k) {
    test::insert(store, fleet.facts[k]);
    if (k % 25 == 0 || k + 1 == fleet.facts.size()) {
      last = built(store);
      ++maps;
    }
  }
  EXPECT_GT(maps, 5);
  expect_bit_equal(last, built(fleet.store()));
}

TEST(BuildGlobalMap, PutsTheFleetWhereItIs) {
  const auto fleet = test::street_fleet(3);
  const auto without = built(test::street_fleet(3, {.associated = false}).store()), with = built(fleet.store());
  double before = 0.0, after = 0.0;
  for (const VehicleId v : {2U, 3U}) {
    const Key key = test::key_of(v, 5);
    const auto error = [&](const GlobalMap<SE2>& g) {
      return (g.map->pose(key.chain, fleet.anchor(key).state)->mean.translation() - fleet.truth.at(key).translation())
          .norm();
    };
    before += error(without);
    after += error(with);
    EXPECT_LT(error(with), 2.5) << v;
  }
  EXPECT_LT(after, 0.2 * before);
}

TEST(BuildGlobalMap, WhatIsNotAssociatedChangesNoPoseOfTheOthers) {
  auto fleet = test::street_fleet(4);
  const auto before = built(fleet.store());
  fleet.stop(1, SE2(75.0, 2.0, 0.1));  // a batch that nobody associates
  const auto after = built(fleet.store());
  EXPECT_NE(after.facts, before.facts);
  expect_bit_equal(before, after);
  // Nor does one more landmark of an old batch.
  test::Landmark extra = test::landmark(2, 5000);
  extra.anchor = 2;
  fleet.facts.emplace_back(extra);
  expect_bit_equal(before, built(fleet.store()));
}

TEST(BuildGlobalMap, ANewVehicleWithoutAssociationsMovesNobody) {
  auto fleet = test::street_fleet(4);
  const auto before = built(fleet.store());
  fleet.start(9, SE2(0.0, 50.0, 0.0), test::paper_bias);
  fleet.stop(9, SE2(20.0, 50.0, 0.0));
  const auto after = poses_of(built(fleet.store()));
  for (const auto& [key, pose] : poses_of(before)) EXPECT_LT((pose.inverse() * after.at(key)).Log().norm(), 1e-9);
}

TEST(BuildGlobalMap, AWithdrawnHypothesisIsOneThatNeverWas) {
  const auto fleet = test::street_fleet(5);
  const auto with = built(fleet.store());
  int mattered = 0;
  for (const auto& hypothesis : with.selection.hypotheses) {
    ASSERT_EQ(hypothesis.state, HypothesisState::accepted);
    std::vector<test::Fact> never;
    std::copy_if(fleet.facts.begin(), fleet.facts.end(), std::back_inserter(never), [&](const test::Fact& fact) {
      const auto* a = std::get_if<AssociationFact>(&fact);
      return a == nullptr || hypothesis_id(a->pairings) != hypothesis.id;
    });
    ASSERT_EQ(never.size() + 1, fleet.facts.size());
    auto judged = fleet;
    judged.judge(1, hypothesis.id, true);
    const auto withdrawn = built(judged.store());
    EXPECT_EQ(state_of(withdrawn, hypothesis.id), HypothesisState::vetoed);
    mattered += withdrawn.map->digest() != with.map->digest();  // some say nothing that others do not
    expect_bit_equal(withdrawn, built(SampleFleet::store_of(never)));
    judged.judge(1, hypothesis.id, false);  // and back again
    expect_bit_equal(built(judged.store()), with);
  }
  EXPECT_GE(mattered, 2);
}

/// Landmarks of two batches that lie in a row each, so that they align though they are not the same.
Hash add_false_hypothesis(SampleFleet& fleet, VehicleId v, VehicleId w) {
  const auto row = [&](VehicleId vehicle, std::uint32_t anchor) {
    std::vector<Key> keys;
    for (std::uint32_t i = 0; i < 8; ++i) {
      test::Landmark l;
      l.key = test::key_of(vehicle, 1000 + i);
      l.anchor = anchor;
      l.position = {40.0 + 3.0 * i, 40.0 + 0.5 * i * i};  // apart from what there is
      l.covariance = 0.02 * Eigen::Matrix2d::Identity();
      fleet.facts.emplace_back(l);
      keys.push_back(l.key);
    }
    return keys;
  };
  const auto a = row(v, 1), b = row(w, 5);
  std::vector<Pairing> pairs;
  for (std::size_t i = 0; i < a.size(); ++i) pairs.emplace_back(a[i], b[i]);
  return fleet.associate(w, canonical(pairs));
}

TEST(BuildGlobalMap, DropsAHypothesisThatContradictsTheRest) {
  for (const std::uint64_t seed : {7U, 8U, 9U}) {
    auto fleet = test::street_fleet(seed, {.bias = SE2::Tangent::Zero()});
    const auto before = built(fleet.store());
    const Hash lie = add_false_hypothesis(fleet, 1, 2);  // 100 m apart, and it says they are one
    const auto after = built(fleet.store());
    EXPECT_EQ(state_of(after, lie), HypothesisState::outvoted);
    for (const auto& h : after.selection.hypotheses)
      if (h.id != lie) {
        EXPECT_EQ(h.state, state_of(before, h.id));
      }
    EXPECT_GE(after.selection.classes.size(), 20U);
    expect_bit_equal(before, after);
  }
}

// The only one between its two chains, whose starts nobody knows: what it contradicts is the way round by a third
// vehicle.
TEST(BuildGlobalMap, DropsAHypothesisThatContradictsTheWayRoundByAnotherVehicle) {
  for (const std::uint64_t seed : {7U, 8U, 9U}) {
    auto fleet = test::street_fleet(seed, {.bias = SE2::Tangent::Zero()});
    std::erase_if(fleet.facts, [](const test::Fact& fact) {  // 1-2 and 2-3 stay
      const auto* a = std::get_if<AssociationFact>(&fact);
      return a != nullptr && a->pairings[0].first.chain.vehicle == 1 && a->pairings[0].second.chain.vehicle == 3;
    });
    const auto before = built(fleet.store());
    const Hash lie = add_false_hypothesis(fleet, 1, 3);
    ASSERT_EQ(state_of({0, select(fleet.store(), SelectionParams{}), nullptr}, lie), HypothesisState::accepted);
    const auto after = built(fleet.store());
    EXPECT_EQ(state_of(after, lie), HypothesisState::map_residual);
    for (const auto& h : after.selection.hypotheses)
      if (h.id != lie) {
        EXPECT_EQ(h.state, state_of(before, h.id));
      }
    expect_bit_equal(before, after);
  }
}

TEST(BuildGlobalMap, OfNothingIsEmpty) {
  const auto global = built(Store());
  ASSERT_TRUE(global.map);
  EXPECT_TRUE(global.map->poses().empty());
  EXPECT_EQ(global.facts, Store().digest());
}

// With starts known well enough to linearise at; the filter is no match for a static bias of 15 m and 0.2 rad. It takes
// landmarks for independent, so the two differ by more than rounding.
TEST(BuildGlobalMap, WorksWithTheFilterOfThePaperToo) {
  const auto fleet = test::street_fleet(3, {.bias = test::fair_start});
  const auto sparse = built(fleet.store());
  const auto ekf = build_global_map(fleet.store(), SelectionParams{}, EkfMap<SE2>());
  EXPECT_EQ(ekf.selection.digest(), sparse.selection.digest());
  for (const VehicleId v : {1U, 2U, 3U}) {
    const Key key = test::key_of(v, 5);
    const auto e = ekf.map->pose(key.chain, fleet.anchor(key).state),
               s = sparse.map->pose(key.chain, fleet.anchor(key).state);
    EXPECT_LT((e->mean.translation() - s->mean.translation()).norm(), 0.5) << v;
  }
}

// ---- the common frame ----

TEST(CommonFrame, WithAStaticBiasIsTheFrameOfTheBiases) {
  SampleFleet fleet(1);
  fleet.start(1, SE2(0.0, 0.0, 0.0));                      // unknown, alone
  fleet.start(2, SE2(-30.0, 0.0, 0.0), test::paper_bias);  // known, alone
  fleet.start(3, SE2(-20.0, 0.0, 0.0));                    // unknown, meets 4
  fleet.start(4, SE2(-10.0, 5.0, 0.5), test::known_start);
  const Key a = fleet.stop(3, SE2(0.0, 0.0, 0.0)), b = fleet.stop(4, SE2(3.0, 2.0, 1.0));
  auto global = built(fleet.store(), test::unconfirmed_too);
  const auto aligned = [&](VehicleId v) { return global.map->aligned(test::chain_of(v)); };
  EXPECT_FALSE(aligned(1));
  EXPECT_TRUE(aligned(2));
  EXPECT_FALSE(aligned(3));
  EXPECT_TRUE(aligned(4));
  fleet.associate(3, fleet.common(a, b));
  global = built(fleet.store(), test::unconfirmed_too);
  EXPECT_FALSE(aligned(1));
  EXPECT_TRUE(aligned(3));
  const auto pose = global.map->pose(a.chain, fleet.anchor(a).state);
  EXPECT_LT((pose->mean.inverse() * fleet.truth.at(a)).Log().norm(), 1.0);
}

TEST(CommonFrame, WithoutAnyIsTheStartOfTheSmallestChainOfTheLargestGroup) {
  SampleFleet fleet(2);
  std::vector<Key> stops;
  for (const VehicleId v : {1U, 2U, 3U, 4U, 5U}) {
    fleet.start(v, SE2(-10.0 * v, 0.0, 0.1 * v));
    stops.push_back(fleet.stop(v, SE2(2.0 * v, 0.0, 0.2 * v)));
  }
  const auto meet = [&](int v, int w) {
    fleet.associate(static_cast<VehicleId>(v),
                    fleet.common(stops[static_cast<std::size_t>(v) - 1], stops[static_cast<std::size_t>(w) - 1]));
  };
  const auto aligned = [&] {
    const auto global = built(fleet.store(), test::unconfirmed_too);
    std::vector<VehicleId> list;
    for (const VehicleId v : {1U, 2U, 3U, 4U, 5U})
      if (global.map->aligned(test::chain_of(v))) list.push_back(v);
    return list;
  };
  using List = std::vector<VehicleId>;
  EXPECT_EQ(aligned(), (List{1}));
  meet(1, 2);
  EXPECT_EQ(aligned(), (List{1, 2}));
  meet(3, 4);  // as large: the smaller chain's stays
  EXPECT_EQ(aligned(), (List{1, 2}));
  meet(4, 5);
  EXPECT_EQ(aligned(), (List{3, 4, 5}));
  const auto global = built(fleet.store(), test::unconfirmed_too);
  EXPECT_LT(global.map->pose(test::chain_of(3), {})->mean.Log().norm(), 1e-3);
  const SE2 truth = fleet.truth.at(test::key_of(3, 0)).inverse() * fleet.truth.at(stops[4]);
  EXPECT_LT((global.map->pose(test::chain_of(5), fleet.anchor(stops[4]).state)->mean.inverse() * truth).Log().norm(),
            1.0);
  meet(2, 3);
  EXPECT_EQ(aligned(), (List{1, 2, 3, 4, 5}));
}

TEST(CommonFrame, IsTheStartOfTheReferenceIfOneIsNamedAndNoStaticBiasIsKnown) {
  SampleFleet fleet(2);
  std::vector<Key> stops;
  for (const VehicleId v : {1U, 2U, 3U}) {
    fleet.start(v, SE2(-10.0 * v, 0.0, 0.1 * v));
    stops.push_back(fleet.stop(v, SE2(2.0 * v, 0.0, 0.2 * v)));
  }
  SelectionParams params = test::unconfirmed_too;
  params.reference = 3;
  fleet.associate(1, fleet.common(stops[0], stops[1]));  // the larger group is without it
  auto global = built(fleet.store(), params);
  EXPECT_FALSE(global.map->aligned(test::chain_of(1)));
  EXPECT_FALSE(global.map->aligned(test::chain_of(2)));
  EXPECT_TRUE(global.map->aligned(test::chain_of(3)));
  fleet.associate(2, fleet.common(stops[1], stops[2]));
  global = built(fleet.store(), params);
  for (const VehicleId v : {1U, 2U, 3U}) EXPECT_TRUE(global.map->aligned(test::chain_of(v))) << v;
  EXPECT_LT(global.map->pose(test::chain_of(3), {})->mean.Log().norm(), 1e-3);
  params.reference = 99;  // not there: nobody is in its frame
  global = built(fleet.store(), params);
  for (const VehicleId v : {1U, 2U, 3U}) EXPECT_FALSE(global.map->aligned(test::chain_of(v))) << v;
}

TEST(Problem, HasNodesOnlyWhereThereAreFactors) {
  SampleFleet fleet(3);
  for (const VehicleId v : {1U, 2U}) {
    fleet.start(v, SE2(-80.0, 3.0 * v, 0.0), test::known_start);
    for (int k = 1; k <= 6; ++k) fleet.stop(v, SE2(-80.0 + 25.0 * k, 3.0 * v, 0.0));
  }
  fleet.associate(1, fleet.common(test::key_of(1, 4), test::key_of(2, 4)));
  const auto store = fleet.store();
  const auto problem = build_problem(store, select(store, SelectionParams{}));
  ASSERT_EQ(problem.nodes.size(), 4U);  // start and anchor 4 of each
  ASSERT_EQ(problem.drifts.size(), 2U);
  const auto bridge = increment({}, fleet.anchor(test::key_of(1, 4)).state);
  EXPECT_TRUE(problem.drifts[0].covariance.isApprox(bridge.covariance, 1e-9));  // but for the floor
  EXPECT_EQ(problem.nodes[1].anchor, test::key_of(1, 4));
}

}  // namespace
}  // namespace convoy
