// Which hypotheses between two chains hold together (DESIGN B5, T2 and T3), and what is done with those that do not.
#include <convoy/geometry/chi2.hpp>
#include <convoy/map/consensus.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>

namespace convoy {
namespace {

using test::SampleFleetOf;

// ---- the heaviest clique ----

struct Graph {
  Relation related;
  std::vector<int> weights;
  std::vector<std::size_t> all;
};

Graph random_graph(test::Random& random, std::size_t size, double density) {
  Graph graph;
  for (std::size_t i = 0; i < size; ++i) {
    std::vector<bool> row;
    for (std::size_t j = 0; j < i; ++j) row.push_back(random.uniform(0.0, 1.0) < density);
    graph.related.add(std::move(row));
    graph.weights.push_back(5 + static_cast<int>(random.uniform(0.0, 20.0)));
    graph.all.push_back(i);
  }
  return graph;
}

int weight_of(const Graph& graph, const std::vector<std::size_t>& clique) {
  int weight = 0;
  for (const std::size_t i : clique) {
    weight += graph.weights[i];
    for (const std::size_t j : clique) EXPECT_TRUE(i == j || graph.related(i, j)) << i << " and " << j;
  }
  return weight;
}

int heaviest_by_trying_all(const Graph& graph) {
  int best = 0;
  for (std::uint32_t set = 0; set < (1U << graph.all.size()); ++set) {
    int weight = 0;
    bool clique = true;
    for (std::size_t i = 0; i < graph.all.size() && clique; ++i) {
      if (((set >> i) & 1U) == 0) continue;
      weight += graph.weights[i];
      for (std::size_t j = 0; j < i && clique; ++j) clique = ((set >> j) & 1U) == 0 || graph.related(i, j);
    }
    if (clique) best = std::max(best, weight);
  }
  return best;
}

TEST(HeaviestClique, IsTheOneThatTryingAllFinds) {
  test::Random random(4);
  for (int round = 0; round < 60; ++round) {
    const Graph graph = random_graph(random, 1 + static_cast<std::size_t>(round) % 13, 0.15 * (1 + round % 6));
    EXPECT_EQ(weight_of(graph, heaviest_clique(graph.related, graph.all, graph.weights)),
              heaviest_by_trying_all(graph));
  }
}

TEST(HeaviestClique, OfNothingIsEmptyAndOfSomeLooksAtNoOthers) {
  test::Random random(5);
  const Graph graph = random_graph(random, 12, 0.5);
  EXPECT_TRUE(heaviest_clique(graph.related, {}, {}).empty());
  const std::vector<std::size_t> some{1, 4, 7, 8};
  std::vector<int> weights;
  for (const std::size_t i : some) weights.push_back(graph.weights[i]);
  for (const std::size_t i : heaviest_clique(graph.related, some, weights))
    EXPECT_TRUE(std::count(some.begin(), some.end(), i)) << i;
}

// Two hundred true ones and a few false ones that agree with nobody: found without a search worth the name. And where
// there is no order at all, what is found within the budget is a clique.
TEST(HeaviestClique, StaysInItsBudget) {
  test::Random random(6);
  Graph graph = random_graph(random, 220, 0.0);
  graph.related = {};
  for (std::size_t i = 0; i < 220; ++i) graph.related.add(std::vector<bool>(i, i < 200));
  EXPECT_EQ(heaviest_clique(graph.related, graph.all, graph.weights, 50000).size(), 200U);
  // An hour together, and one that contradicts all the others and is heavier than any of them.
  Graph hour = random_graph(random, 3000, 1.0);
  std::vector<bool> nobody(3000, false);
  hour.related.add(nobody);
  hour.weights.push_back(100);
  hour.all.push_back(3000);
  EXPECT_EQ(heaviest_clique(hour.related, hour.all, hour.weights).size(), 3000U);
  const Graph chaos = random_graph(random, 150, 0.7);
  EXPECT_GT(weight_of(chaos, heaviest_clique(chaos.related, chaos.all, chaos.weights, 100)), 0);
}

// ---- loops ----

template <class G>
class Loops : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Loops, Groups);

// Drawn from the model: the squared distance is chi-square with Dof degrees of freedom.
TYPED_TEST(Loops, OfTrueHypothesesAreAsLongAsTheirCovarianceSays) {
  using G = TypeParam;
  double sum = 0.0;
  int count = 0;
  for (std::uint64_t seed = 1; seed <= 120; ++seed) {
    const auto fleet = test::street_fleet<G>(seed);
    const auto store = fleet.store();
    std::vector<Hypothesis<G>> of_1_and_2;
    for (const Hypothesis<G>& h : select(store, SelectionParams{}).hypotheses)
      if (h.state == HypothesisState::accepted && h.batch_a.chain == test::chain_of(1) &&
          h.batch_b.chain == test::chain_of(2))
        of_1_and_2.push_back(h);
    // Two that share no batch: else the landmarks' errors cancel.
    for (const auto& h : of_1_and_2)
      for (const auto& k : of_1_and_2) {
        if (h.id >= k.id || h.batch_a == k.batch_a || h.batch_b == k.batch_b) continue;
        sum += loop_chi2(store, h, k);
        ++count;
        EXPECT_NEAR(loop_chi2(store, h, k), loop_chi2(store, k, h), 0.2 + 0.2 * loop_chi2(store, h, k));
      }
  }
  ASSERT_GE(count, 200);
  EXPECT_NEAR(sum / count / G::Dof, 1.0, 0.25);
}

// ---- what is decided ----

/// Two vehicles side by side whose starts are known to `bias`, or not at all; both stop so many times.
struct Street {
  explicit Street(const SE2::Tangent& bias, std::uint64_t seed = 3, int stops = 5) : fleet(seed) {
    fleet.start(1, SE2(0.0, 0.0, 0.0), bias);
    fleet.start(2, SE2(0.0, 3.0, 0.0), bias);
    for (int k = 1; k <= stops; ++k) {
      a.push_back(fleet.stop(1, SE2(-100.0 + 20.0 * k, 0.0, 0.1)));
      b.push_back(fleet.stop(2, SE2(-100.0 + 20.0 * k, 3.0, 0.1)));
    }
  }
  Hash truth(std::size_t i) { return fleet.associate(1, fleet.common(a[i], b[i], 10)); }

  /// Stop i of vehicle 1 looks like stop j of vehicle 2: geometrically perfect, and wrong.
  Hash alias(std::size_t i, std::size_t j) {
    std::vector<Pairing> pairs;
    for (std::uint32_t n = 0; n < 10; ++n) {
      const Eigen::Vector2d place(40.0 + 3.0 * n, 40.0 + n % 3 * 4.0);  // apart from what there is
      pairs.emplace_back(landmark(a[i], place), landmark(b[j], place));
    }
    return fleet.associate(1, canonical(pairs));
  }

  /// Stop i of both, seen twice: ten landmarks of vehicle 1, and for each of them two of vehicle 2, `apart_m` from each
  /// other.
  std::pair<Hash, Hash> double_sight(std::size_t i, double apart_m) {
    const SE2 T_b_a = fleet.truth.at(b[i]).inverse() * fleet.truth.at(a[i]);
    std::vector<Pairing> one, other;
    for (std::uint32_t n = 0; n < 10; ++n) {
      const Eigen::Vector2d place(40.0 + 3.0 * n, 40.0 + n % 3 * 4.0);
      const Key of_a = landmark(a[i], place);
      one.emplace_back(of_a, landmark(b[i], T_b_a * place));
      other.emplace_back(of_a, landmark(b[i], T_b_a * place + Eigen::Vector2d(apart_m, 0.0)));
    }
    return {fleet.associate(1, canonical(one)), fleet.associate(1, canonical(other))};
  }

  HypothesisState state_of(Hash id) const {
    for (const auto& h : select(fleet.store(), SelectionParams{}).hypotheses)
      if (h.id == id) return h.state;
    ADD_FAILURE() << "not stated";
    return HypothesisState::waiting;
  }

  test::SampleFleet fleet;
  std::vector<Key> a, b;

 private:
  Key landmark(const Key& anchor, const Eigen::Vector2d& place) {
    test::Landmark l;
    l.key = {anchor.chain, next_++};
    l.anchor = anchor.index;
    l.position = place;
    l.covariance = 0.02 * Eigen::Matrix2d::Identity();
    l.loading.setZero();
    fleet.facts.emplace_back(l);
    return l.key;
  }

  std::uint32_t next_ = 1000;
};

const SE2::Tangent unknown = SE2::Tangent::Zero();

TEST(Consensus, AFirstHypothesisLinksNobodyUntilAnotherConfirmsIt) {
  for (const SE2::Tangent& bias : {unknown, test::paper_bias}) {
    Street street(bias);
    const Hash first = street.truth(0);
    EXPECT_EQ(street.state_of(first), HypothesisState::unconfirmed);
    const Hash second = street.truth(3);
    EXPECT_EQ(street.state_of(first), HypothesisState::accepted);
    EXPECT_EQ(street.state_of(second), HypothesisState::accepted);
  }
}

TEST(Consensus, AFirstHypothesisStandsWhereNoDoubleCouldHide) {
  Street street(test::fair_start);
  EXPECT_EQ(street.state_of(street.truth(0)), HypothesisState::accepted);
}

TEST(Consensus, AFirstHypothesisStandsBetweenVehiclesThatAThirdLinks) {
  const auto meeting = [](bool with_third) {
    test::SampleFleet fleet(10);
    std::vector<std::vector<Key>> stops(4);
    for (const VehicleId v : {1U, 2U, 3U}) {
      fleet.start(v, SE2(0.0, 2.0 * v, 0.0));
      for (int k = 0; k < 2; ++k) stops[v].push_back(fleet.stop(v, SE2(10.0 + 15.0 * k, 2.0 * v, 0.1 * v)));
    }
    const Hash between_1_and_2 = fleet.associate(1, fleet.common(stops[1][0], stops[2][0]));
    if (with_third)
      for (const std::size_t k : {0U, 1U}) {
        fleet.associate(1, fleet.common(stops[1][k], stops[3][k]));
        fleet.associate(2, fleet.common(stops[2][k], stops[3][k]));
      }
    for (const auto& h : select(fleet.store(), SelectionParams{}).hypotheses)
      if (h.id == between_1_and_2) return h.state;
    return HypothesisState::waiting;
  };
  EXPECT_EQ(meeting(false), HypothesisState::unconfirmed);
  EXPECT_EQ(meeting(true), HypothesisState::accepted);
}

TEST(Consensus, WhatContradictsTheStaticBiasesIsRefused) {
  Street street(test::fair_start);
  EXPECT_EQ(street.state_of(street.alias(0, 4)), HypothesisState::prior);
  EXPECT_EQ(street.state_of(street.truth(0)), HypothesisState::accepted);
}

TEST(Consensus, AFewThatAreWrongAreOutvotedEvenIfTheyAgree) {
  Street street(unknown, 3, 9);
  std::vector<Hash> right;
  for (std::size_t i = 0; i < 9; ++i) right.push_back(street.truth(i));
  const Hash lies[] = {street.alias(0, 1), street.alias(3, 4)};
  for (const Hash id : lies) EXPECT_EQ(street.state_of(id), HypothesisState::outvoted);
  for (const Hash id : right) EXPECT_EQ(street.state_of(id), HypothesisState::accepted);
}

// One place stated twice is one place.
TEST(Consensus, NothingConfirmsItself) {
  Street street(unknown);
  const Hash whole = street.truth(0);
  const Hash part = street.fleet.associate(2, street.fleet.common(street.a[0], street.b[0], 9));
  EXPECT_EQ(street.state_of(whole), HypothesisState::unconfirmed);
  EXPECT_EQ(street.state_of(part), HypothesisState::unconfirmed);
}

// However often a lie is told in other words.
TEST(Consensus, StatementsAboutOnePlaceHaveOneVote) {
  Street street(unknown);
  std::vector<Hash> right;
  for (std::size_t i = 0; i < 5; ++i) right.push_back(street.truth(i));
  const Hash lie = street.alias(0, 3);
  const auto whole = std::get<AssociationFact>(street.fleet.facts.back()).pairings;
  std::vector<Hash> lies{lie};
  for (std::size_t left_out = 0; left_out < 8; ++left_out) {
    auto part = whole;
    part.erase(part.begin() + static_cast<std::ptrdiff_t>(left_out));
    lies.push_back(street.fleet.associate(2, part));
  }
  for (const Hash id : lies) EXPECT_EQ(street.state_of(id), HypothesisState::outvoted);
  for (const Hash id : right) EXPECT_EQ(street.state_of(id), HypothesisState::accepted);
}

// What the map leaves out keeps its vote: what it outvoted does not rise again.
TEST(Consensus, LeavingOneOutLetsNothingElseIn) {
  Street street(unknown);
  std::vector<Hash> right, all;
  for (std::size_t i = 0; i < 5; ++i) right.push_back(street.truth(i));
  const Hash lie = street.alias(0, 1);
  Exclusions excluded;
  excluded.hypotheses.insert(right.begin(), right.end());
  for (const auto& h : select(street.fleet.store(), SelectionParams{}, excluded).hypotheses)
    EXPECT_EQ(h.state, h.id == lie ? HypothesisState::outvoted : HypothesisState::map_residual);
}

// A street that repeats itself: the shifted way of laying the two maps onto each other is nearly as well supported.
TEST(Consensus, TwoWaysThatAreNearlyAsGoodAreNoWay) {
  Street street(unknown);
  std::vector<Hash> all;
  for (std::size_t i = 0; i < 3; ++i) all.push_back(street.truth(i));
  for (std::size_t i = 0; i < 3; ++i) all.push_back(street.alias(i, i + 1));
  for (const Hash id : all) EXPECT_EQ(street.state_of(id), HypothesisState::ambiguous);
  const auto global = test::built(street.fleet.store());
  EXPECT_TRUE(global.selection.classes.empty());
  EXPECT_FALSE(global.map->aligned(test::chain_of(2)));
  // Until it is known where they started.
  Street known(test::fair_start);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(known.state_of(known.truth(i)), HypothesisState::accepted);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(known.state_of(known.alias(i, i + 1)), HypothesisState::prior);
}

// One place that could be taken in two ways costs that place and no other.
TEST(Consensus, AnAmbiguousPlaceLeavesUndisputedOnesAlone) {
  for (const SE2::Tangent& bias : {unknown, test::fair_start}) {
    Street street(bias, 3, 7);
    std::vector<Hash> undisputed;
    for (std::size_t i = 0; i < 6; ++i) undisputed.push_back(street.truth(i));
    const auto [one, other] = street.double_sight(6, 0.15);
    EXPECT_EQ(street.state_of(one), HypothesisState::ambiguous);
    EXPECT_EQ(street.state_of(other), HypothesisState::ambiguous);
    for (const Hash id : undisputed) EXPECT_EQ(street.state_of(id), HypothesisState::accepted);
    const auto global = test::built(street.fleet.store());
    EXPECT_TRUE(global.map->aligned(test::chain_of(2)));
  }
}

// The test of a loop is symmetric but for rounding and first order. Where its two values lie on both sides of the gate,
// one of them counts, whichever hypothesis came first.
TEST(Consensus, ALoopThatStraddlesTheGateIsJudgedAlikeInEveryOrder) {
  int straddling = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    Street street(unknown, seed);
    street.truth(0);
    street.truth(4);
    std::vector<Hypothesis<SE2>> both;
    SelectionParams params;
    for (const auto& h : select(street.fleet.store(), params).hypotheses)
      if (h.state == HypothesisState::accepted) both.push_back(h);
    if (both.size() != 2) continue;  // too few landmarks there
    const double forth = loop_chi2(street.fleet.store(), both[0], both[1], params.slack);
    const double back = loop_chi2(street.fleet.store(), both[1], both[0], params.slack);
    if (forth == back) continue;
    double low = 0.0, high = 1.0;  // the confidence whose gate lies between the two
    for (int i = 0; i < 100; ++i)
      (chi2_quantile(0.5 * (low + high), SE2::Dof) < 0.5 * (forth + back) ? low : high) = 0.5 * (low + high);
    params.map_residual = low;
    const double gate = chi2_quantile(low, SE2::Dof);
    if (!((forth < gate) != (back < gate))) continue;
    ++straddling;
    std::vector<std::size_t> stated;  // where the two statements are among the facts
    for (std::size_t k = 0; k < street.fleet.facts.size(); ++k)
      if (std::holds_alternative<AssociationFact>(street.fleet.facts[k])) stated.push_back(k);
    std::vector<std::vector<HypothesisState>> states;
    for (const bool swapped : {false, true}) {
      Selector<SE2> selector(params);
      FactStore<SE2> growing;
      for (std::size_t k = 0; k < stated[0]; ++k) test::insert(growing, street.fleet.facts[k]);
      for (const bool late : {false, true}) {
        test::insert(growing, street.fleet.facts[stated[late != swapped]]);
        selector.select(growing);
      }
      states.emplace_back();
      for (const auto& h : selector.select(growing).hypotheses) states.back().push_back(h.state);
    }
    EXPECT_EQ(states[0], states[1]) << "seed " << seed << ", " << forth << " and " << back;
  }
  EXPECT_GE(straddling, 5);
}

// Whichever of two loops is gone round first, whatever was asked before.
TEST(Consensus, IsTheSameInEveryOrderOfArrival) {
  Street street(unknown);
  for (std::size_t i = 0; i < 5; ++i) street.truth(i);
  street.alias(0, 1);
  street.alias(2, 4);
  const auto reference = select(street.fleet.store(), SelectionParams{});
  for (int round = 0; round < 10; ++round) {
    std::shuffle(street.fleet.facts.begin(), street.fleet.facts.end(), street.fleet.random().engine());
    Selector<SE2> selector{SelectionParams{}};
    FactStore<SE2> growing;
    for (const test::Fact& fact : street.fleet.facts) {
      test::insert(growing, fact);
      if (std::holds_alternative<AssociationFact>(fact)) selector.select(growing);
    }
    const auto again = selector.select(growing);
    EXPECT_EQ(again.digest(), reference.digest());
    ASSERT_EQ(again.hypotheses.size(), reference.hypotheses.size());
    for (std::size_t k = 0; k < again.hypotheses.size(); ++k)
      EXPECT_EQ(again.hypotheses[k].state, reference.hypotheses[k].state);
  }
}

}  // namespace
}  // namespace convoy
