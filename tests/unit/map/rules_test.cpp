// What the map must never depend on (DESIGN B4), poses and marginals to the bit, in the plane and in space.
#include <convoy/map/global_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <type_traits>
#include <utility>
#include <vector>

namespace convoy {
namespace {

using test::built;
using test::SampleFleetOf;

template <class G>
class Rules : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Rules, Groups);

/// Every pose of b's chains is there in a, and has the same bits, with the same marginal.
template <class G>
void expect_same_bits(const GlobalMap<G>& a, const GlobalMap<G>& b) {
  ASSERT_EQ(a.map->digest(), b.map->digest());
  ASSERT_EQ(a.map->problem().nodes.size(), b.map->problem().nodes.size());
  EXPECT_EQ(a.selection.digest(), b.selection.digest());
  for (const Node<G>& node : a.map->problem().nodes) {
    const auto ea = a.map->pose(node.anchor.chain, node.slam), eb = b.map->pose(node.anchor.chain, node.slam);
    EXPECT_EQ(ea->mean.translation(), eb->mean.translation());
    EXPECT_EQ(ea->mean.rotation(), eb->mean.rotation());
    EXPECT_EQ(ea->covariance, eb->covariance);
  }
}

TYPED_TEST(Rules, ArrivalInAnyOrderWithLossRecoveryAndDuplicatesEndsInTheSameMap) {
  using G = TypeParam;
  auto fleet = test::street_fleet<G>(21);
  for (const VehicleId v : {1U, 2U, 3U})
    for (const std::uint32_t k : {0U, 1U, 3U, 5U}) fleet.fix(test::key_of(v, k), 1.0);
  const Key gross = fleet.fix(test::key_of(2, 4), test::each<G>(25.0, 0.0).template head<G::Dim>(), 1.0);
  SelectionParams params;
  params.fix_correlation_s = 10.0;
  const auto reference = built(fleet.store(), params);
  ASSERT_GE(reference.selection.classes.size(), 20U);
  ASSERT_GE(reference.map->problem().fixes.size(), 8U);
  ASSERT_EQ(std::count(reference.selection.fixes.begin(), reference.selection.fixes.end(), gross), 0);
  int different = 0;
  for (int order = 0; order < (G::Dim == 2 ? 50 : 15); ++order) {
    auto facts = fleet.facts;
    std::shuffle(facts.begin(), facts.end(), fleet.random().engine());
    const auto lost = facts.begin() + static_cast<std::ptrdiff_t>(7 * facts.size() / 10);
    FactStore<G> store;
    const SparseMap<G> backend;
    MapBuilder<G> builder(params, backend);
    std::for_each(facts.begin(), lost, [&](const AnyFact<G>& fact) { test::insert(store, fact); });
    const auto on_the_way = builder.build(store);
    expect_same_bits(on_the_way, built(store, params));
    different += on_the_way.map->digest() != reference.map->digest();
    std::shuffle(lost - 20, facts.end(), fleet.random().engine());  // some twice
    std::for_each(lost - 20, facts.end(), [&](const AnyFact<G>& fact) { test::insert(store, fact); });
    const auto in_the_end = builder.build(store);
    ASSERT_EQ(in_the_end.facts, reference.facts);
    expect_same_bits(in_the_end, reference);
    if (this->HasFailure()) return;
  }
  EXPECT_GT(different, 0);
}

// R3 and the veto: a withdrawn hypothesis leaves no trace, and comes back as if it had never left.
TYPED_TEST(Rules, AWithdrawnHypothesisIsOneThatNeverWas) {
  using G = TypeParam;
  auto fleet = test::street_fleet<G>(22);
  const auto with = built(fleet.store());
  FactStore<G> store = fleet.store();
  const SparseMap<G> backend;
  MapBuilder<G> builder(SelectionParams{}, backend);
  expect_same_bits(builder.build(store), with);
  int mattered = 0;
  for (std::size_t k = 0; k < std::min<std::size_t>(4, with.selection.hypotheses.size()); ++k) {
    const Hash id = with.selection.hypotheses[k].id;
    std::vector<AnyFact<G>> never = fleet.facts;
    std::erase_if(never, [&](const AnyFact<G>& fact) {
      const auto* a = std::get_if<AssociationFact>(&fact);
      return a != nullptr && hypothesis_id(a->pairings) == id;
    });
    fleet.judge(1, id, true);
    test::insert(store, fleet.facts.back());
    const auto withdrawn = builder.build(store);
    expect_same_bits(withdrawn, built(SampleFleetOf<G>::store_of(never)));
    mattered += withdrawn.map->digest() != with.map->digest();
    fleet.judge(1, id, false);
    test::insert(store, fleet.facts.back());
    expect_same_bits(builder.build(store), with);
  }
  EXPECT_GT(mattered, 0);
}

// A fact may hold a covariance that rounding has left slightly indefinite. Beside a variance of 10^6 that is a negative
// one that is no rounding to anybody else.
TYPED_TEST(Rules, AStrangersPoorCovarianceMovesNobodyElse) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(1);
  const auto reference = built(fleet.store());
  FactStore<G> store = fleet.store();
  PriorFact<G> stranger{test::key_of(9, 0), true, G()};
  typename G::Tangent variance = test::each<G>(1e6, 0.01);
  variance[1] = -9e-4;
  stranger.covariance = variance.asDiagonal();
  ASSERT_EQ(store.insert(stranger), Insertion::inserted);
  const auto global = built(store);
  EXPECT_TRUE(global.map->report().converged);
  EXPECT_EQ(global.selection.digest(), reference.selection.digest());
  for (const Node<G>& node : reference.map->problem().nodes) {
    const auto alone = reference.map->pose(node.anchor.chain, node.slam),
               beside = global.map->pose(node.anchor.chain, node.slam);
    EXPECT_LT((alone->mean.inverse() * beside->mean).Log().norm(), 1e-6);
  }
}

// What contradicts the map is left out by update() at once, and not only by the next build().
TYPED_TEST(Rules, AnUpdateTakesNoGrossMeasurement) {
  using G = TypeParam;
  auto fleet = test::street_fleet<G>(33);
  for (const std::uint32_t k : {1U, 3U, 5U})
    for (const VehicleId v : {1U, 2U}) fleet.fix(test::key_of(v, k), 0.5);
  FactStore<G> store = fleet.store();
  const SparseMap<G> backend;
  SelectionParams params;
  params.fix_correlation_s = 10.0;
  MapBuilder<G> builder(params, backend);
  builder.build(store);
  builder.update(store);
  const Key right = fleet.fix(test::key_of(3, 3), 0.5);
  test::insert(store, fleet.facts.back());
  const Key gross = fleet.fix(test::key_of(3, 4), test::each<G>(25.0, 0.0).template head<G::Dim>(), 0.5);
  test::insert(store, fleet.facts.back());
  const auto fixes = builder.update(store).selection.fixes;
  EXPECT_EQ(std::count(fixes.begin(), fixes.end(), right), 1);
  EXPECT_EQ(std::count(fixes.begin(), fixes.end(), gross), 0);
}

// A vehicle misplaces what it sees from some anchor on: no two chains contradict each other over it, only the map does.
TEST(Updates, TakeNoHypothesisThatContradictsTheMap) {
  test::SampleFleet fleet(4);
  fleet.start(1, SE2(), test::known_start);
  for (const VehicleId v : {2U, 3U}) fleet.start(v, SE2(0.0, 3.0 * (v - 1), 0.0), test::each<SE2>(3.0, 0.05));
  for (int k = 1; k <= 6; ++k)
    for (const VehicleId v : {1U, 2U, 3U}) fleet.stop(v, SE2(12.0 * k, 3.0 * (v - 1), 0.0));
  for (auto& fact : fleet.facts)
    if (auto* l = std::get_if<LandmarkFact<SE2>>(&fact); l != nullptr && l->key.chain.vehicle == 1 && l->anchor == 6)
      l->position.y() += 3.0;
  for (std::uint32_t k = 1; k <= 5; ++k)
    for (const VehicleId v : {1U, 3U}) fleet.associate(2, fleet.common(test::key_of(v, k), test::key_of(2, k)));
  FactStore<SE2> store = fleet.store();
  const SparseMap<SE2> backend;
  MapBuilder<SE2> builder(SelectionParams{}, backend);
  builder.build(store);
  builder.update(store);
  const Hash wrong = fleet.associate(3, fleet.common(test::key_of(1, 6), test::key_of(3, 6)));
  test::insert(store, fleet.facts.back());
  const auto hypotheses = builder.update(store).selection.hypotheses;
  const auto found = std::find_if(hypotheses.begin(), hypotheses.end(), [&](const auto& h) { return h.id == wrong; });
  ASSERT_NE(found, hypotheses.end());
  EXPECT_EQ(found->state, HypothesisState::map_residual);
}

// What update() works in on the way, and in which order, leaves no trace in what build() makes.
TYPED_TEST(Rules, AnExactMapKnowsNothingOfUpdatesBefore) {
  using G = TypeParam;
  auto fleet = test::street_fleet<G>(31);
  for (const std::uint32_t k : {1U, 3U, 5U})
    for (const VehicleId v : {1U, 2U}) fleet.fix(test::key_of(v, k), 0.5);
  const auto reference = built(fleet.store());
  const SparseMap<G> backend;
  for (int order = 0; order < 5; ++order) {
    auto facts = fleet.facts;
    std::shuffle(facts.begin(), facts.end(), fleet.random().engine());
    FactStore<G> store;
    MapBuilder<G> builder(SelectionParams{}, backend);
    for (std::size_t k = 0; k < facts.size(); ++k) {
      test::insert(store, facts[k]);
      if (k % 9 != 0 && k + 1 != facts.size()) continue;
      const auto quick = builder.update(store);
      EXPECT_FALSE(quick.exact);
      EXPECT_EQ(quick.facts, store.digest());
      if (k % 2 == 0) continue;
      EXPECT_TRUE(builder.build(store).exact);
    }
    auto quick = builder.update(store);
    EXPECT_EQ(quick.selection.digest(), reference.selection.digest());
    for (std::size_t n = 0; n < quick.map->poses().size(); ++n) {
      const auto& node = quick.map->problem().nodes[n];
      if (node.anchor.chain.vehicle > 3) continue;  // the datum
      const auto exact = reference.map->pose(node.anchor.chain, node.slam),
                 near = quick.map->pose(node.anchor.chain, node.slam);
      EXPECT_LT((exact->mean.inverse() * near->mean).Log().norm(), 0.02);
      EXPECT_LT((exact->covariance - near->covariance).norm(), 0.05 * exact->covariance.norm());
    }
    expect_same_bits(builder.build(store), reference);
  }
}

TYPED_TEST(Rules, WhatIsNotAssociatedChangesNoMarginal) {
  using G = TypeParam;
  auto fleet = test::street_fleet<G>(23);
  const auto before = built(fleet.store());
  fleet.stop(1, test::on_the_street<G>(75.0, 2.0, 0.1));  // a batch that nobody associates
  const auto after = built(fleet.store());
  EXPECT_NE(after.facts, before.facts);
  expect_same_bits(before, after);
}

// R5: an epoch shares nothing with the one before, not even the frame.
TYPED_TEST(Rules, ARestartSharesNothingWithTheEpochBefore) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(24);
  const auto before = built(fleet.store());
  auto facts = fleet.facts;
  const ChainId old = test::chain_of(2), restarted{2, test::epoch + 1};
  for (const AnyFact<G>& fact : fleet.facts)
    std::visit(
        [&](auto again) {
          if (again.key.chain != old) return;
          again.key.chain = restarted;
          if constexpr (std::is_same_v<decltype(again), PriorFact<G>>) again = {again.key, false, G()};
          if constexpr (!std::is_same_v<decltype(again), AssociationFact>) facts.emplace_back(again);
        },
        fact);
  const auto after = built(SampleFleetOf<G>::store_of(facts));
  EXPECT_FALSE(after.map->aligned(restarted));
  EXPECT_TRUE(after.map->aligned(old));
  for (const DriftFactor<G>& f : after.map->problem().drifts)
    EXPECT_EQ(after.map->problem().nodes[static_cast<std::size_t>(f.a)].anchor.chain,
              after.map->problem().nodes[static_cast<std::size_t>(f.b)].anchor.chain);
  std::map<Key, G> moved;
  for (std::size_t n = 0; n < after.map->poses().size(); ++n)
    moved[after.map->problem().nodes[n].anchor] = after.map->poses()[n];
  for (std::size_t n = 0; n < before.map->poses().size(); ++n)
    EXPECT_LT((before.map->poses()[n].inverse() * moved.at(before.map->problem().nodes[n].anchor)).Log().norm(), 1e-9);
}

// ---- R2: an association says which landmarks are the same, and no number ----

// A fact with one field more does not come apart into these two, and this does not compile.
TEST(AnAssociation, IsItsKeyAndPairsOfKeys) {
  const auto& [key, pairings] = AssociationFact{};
  static_assert(std::is_same_v<decltype(key), const Key>);
  static_assert(std::is_same_v<decltype(pairings), const std::vector<std::pair<Key, Key>>>);
}

// What two batches say of each other was computed from the landmarks, which have their say themselves.
TYPED_TEST(Rules, WhatTiesChainsIsTheirLandmarksAlone) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(26);
  const FactStore<G> store = fleet.store();
  const auto global = built(store);
  const Problem<G>& problem = global.map->problem();
  const auto anchor_of = [&](int n) { return problem.nodes[static_cast<std::size_t>(n)].anchor; };
  ASSERT_GE(global.selection.classes.size(), 20U);
  EXPECT_EQ(problem.landmarks.size(), global.selection.classes.members().size());
  for (const LandmarkFactor<G>& f : problem.landmarks) {
    const LandmarkFact<G>& fact = *store.landmark(f.landmark);
    EXPECT_EQ(anchor_of(f.node), fact.anchor_key());
    EXPECT_EQ(f.position, fact.position);
    EXPECT_LT((f.covariance - fact.covariance).norm(), 1e-5);  // but for the floor
  }
  for (const DriftFactor<G>& f : problem.drifts) {
    const Increment<G> own = increment(fleet.anchor(anchor_of(f.a)).state, fleet.anchor(anchor_of(f.b)).state);
    EXPECT_EQ(anchor_of(f.a).chain, anchor_of(f.b).chain);
    EXPECT_EQ(f.motion.translation(), own.motion.translation());
    EXPECT_TRUE(f.covariance.isApprox(own.covariance, 1e-9));  // but for the floor
  }
  EXPECT_EQ(problem.drifts.size(), problem.nodes.size() - problem.chains.size());
  EXPECT_EQ(problem.priors.size(), problem.chains.size());
}

/// The fleet's associations, and its facts without them.
template <class G>
std::pair<std::vector<AssociationFact>, SampleFleetOf<G>> parted(SampleFleetOf<G> fleet) {
  std::vector<AssociationFact> stated;
  std::erase_if(fleet.facts, [&](const AnyFact<G>& fact) {
    const auto* a = std::get_if<AssociationFact>(&fact);
    if (a != nullptr) stated.push_back(*a);
    return a != nullptr;
  });
  return {stated, fleet};
}

TYPED_TEST(Rules, WhoStatesAnAssociationAndAsWhichOfHisDoesNotMatter) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(27);
  const auto [stated, bare] = parted(fleet);
  auto facts = bare.facts;
  std::uint32_t index = 0;
  for (auto a = stated.rbegin(); a != stated.rend(); ++a, ++index)
    facts.emplace_back(test::association(1 + index % 3, index / 3, a->pairings));
  const auto other = built(SampleFleetOf<G>::store_of(facts)), reference = built(fleet.store());
  ASSERT_GE(reference.selection.classes.size(), 20U);
  EXPECT_EQ(other.facts, reference.facts);
  expect_same_bits(other, reference);
}

// A pair that is stated in two lists is no better known, nor is a batch that is spoken of twice.
TYPED_TEST(Rules, HowPairsAreCutIntoListsDoesNotMatter) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(28);
  auto [stated, cut] = parted(fleet);
  int parts = 0;
  for (const AssociationFact& a : stated) {
    const auto n = static_cast<std::ptrdiff_t>(a.pairings.size());
    if (n < 8) {
      cut.facts.push_back(a);
      continue;
    }
    for (const std::ptrdiff_t from : {std::ptrdiff_t{0}, std::ptrdiff_t{2}}) {  // all but the last two, or the first
      const std::vector<Pairing> part(a.pairings.begin() + from, a.pairings.begin() + from + n - 2);
      cut.facts.emplace_back(test::association(9, static_cast<std::uint32_t>(parts++), part));
    }
  }
  ASSERT_GE(parts, 8);
  const auto whole = built(fleet.store()), in_parts = built(cut.store());
  ASSERT_EQ(in_parts.selection.classes, whole.selection.classes);
  for (const Node<G>& node : whole.map->problem().nodes) {  // it starts from another guess: not the same bits
    const auto a = whole.map->pose(node.anchor.chain, node.slam), b = in_parts.map->pose(node.anchor.chain, node.slam);
    EXPECT_LT((a->mean.inverse() * b->mean).Log().norm(), 1e-6);
    EXPECT_LT((a->covariance - b->covariance).norm(), 1e-6 * a->covariance.norm());
  }
}

// R2 and R3: who states a pair, how often, in which orientation, and as what part of which list does not matter: every
// landmark is one factor of its class.
TYPED_TEST(Rules, EveryFrozenLandmarkIsOneFactorHoweverOftenItIsPaired) {
  using G = TypeParam;
  auto fleet = test::street_fleet<G>(25);
  const auto once = built(fleet.store());
  std::vector<AssociationFact> stated;
  for (const AnyFact<G>& fact : fleet.facts)
    if (const auto* a = std::get_if<AssociationFact>(&fact)) stated.push_back(*a);
  for (const AssociationFact& a : stated) {
    auto turned = a.pairings;
    for (Pairing& p : turned) std::swap(p.first, p.second);
    fleet.associate(1, canonical(turned));
  }
  const auto often = built(fleet.store());
  expect_same_bits(once, often);
  std::set<Key> seen;
  for (const LandmarkFactor<G>& f : often.map->problem().landmarks) EXPECT_TRUE(seen.insert(f.landmark).second);
  std::size_t members = 0;
  for (const auto& c : often.selection.classes) members += c.size();
  EXPECT_EQ(seen.size(), members);
}

}  // namespace
}  // namespace convoy
