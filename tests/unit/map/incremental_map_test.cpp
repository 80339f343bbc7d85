// IncrementalMap against SparseMap, whatever comes, goes or turns out differently.
#include <convoy/map/incremental_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <variant>

namespace convoy {
namespace {

using test::built;
using test::key_of;

template <class G>
class IncrementalMaps : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(IncrementalMaps, Groups);

/// Largest difference of an estimate, in standard deviations of the exact one, and largest ratio of two variances.
struct Difference {
  double sigmas = 0.0, variance_ratio = 1.0;
};

template <class G>
Difference difference(Map<G>& a, Map<G>& exact) {
  Difference d;
  const State<G> sa{a.poses(), a.points(), a.constants()}, sb{exact.poses(), exact.points(), exact.constants()};
  EXPECT_EQ(sa.size(), sb.size());
  const auto compare = [&](const auto& step, const auto& P_a, const auto& P_b) {
    for (Eigen::Index i = 0; i < step.size(); ++i) {
      d.sigmas = std::max(d.sigmas, std::abs(step[i]) / std::sqrt(P_b(i, i)));
      d.variance_ratio = std::max({d.variance_ratio, P_a(i, i) / P_b(i, i), P_b(i, i) / P_a(i, i)});
    }
  };
  for (int u = 0; u < sa.size(); ++u) {
    const auto step = sb.step_to(sa, u, u);
    if (sa.is_node(u) && exact.problem().datum != u) {
      const auto& node = exact.problem().nodes[static_cast<std::size_t>(u)];
      compare(step, a.pose(node.anchor.chain, node.slam)->covariance,
              exact.pose(node.anchor.chain, node.slam)->covariance);
    } else if (sa.is_point(u)) {
      const int p = u - exact.problem().unknown_of_point(0);
      compare(step, a.class_point(p).covariance, exact.class_point(p).covariance);
    }
  }
  return d;
}

/// Facts come in any order; after every few of them both maps are solved and compared. Returns from how many starts.
template <class G>
int grow_and_compare(std::vector<AnyFact<G>> facts, std::uint64_t seed, int step) {
  std::mt19937_64 random(seed);
  std::shuffle(facts.begin(), facts.end(), random);
  FactStore<G> store;
  IncrementalMap<G> incremental;
  int solved = 0, from_start = 0;
  for (std::size_t k = 0; k < facts.size(); ++k) {
    test::insert(store, facts[k]);
    if (k % static_cast<std::size_t>(step) != 0 && k + 1 != facts.size()) continue;
    const Selection<G> selection = select(store, SelectionParams{});
    const auto map = incremental.solve(build_problem<G>(store, selection));
    const auto exact = SparseMap<G>().solve(build_problem<G>(store, selection));
    const Difference d = difference(*map, *exact);
    EXPECT_LT(d.sigmas, 0.1) << "fact " << k;
    EXPECT_LT(d.variance_ratio, 1.1) << "fact " << k;
    EXPECT_EQ(map->report().dof, exact->report().dof);
    EXPECT_NEAR(map->report().chi2, exact->report().chi2, 1e-2 * (1.0 + exact->report().chi2));
    ++solved;
    from_start += incremental.last().from_start ? 1 : 0;
    if (testing::Test::HasFailure()) break;
  }
  std::printf("seed %d: %d maps, %d of them from the start\n", static_cast<int>(seed), solved, from_start);
  return from_start;
}

TYPED_TEST(IncrementalMaps, EqualTheExactOneAtEveryMoment) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    auto fleet = test::street_fleet<TypeParam>(seed);
    for (const std::uint32_t k : {1U, 3U, 5U})
      for (const VehicleId v : {1U, 2U}) fleet.fix(key_of(v, k), 0.5);
    EXPECT_LE(grow_and_compare<TypeParam>(fleet.facts, seed, 5), 3);
  }
}

TYPED_TEST(IncrementalMaps, AndWithConstants) {
  auto fleet = test::street_fleet<TypeParam>(4);
  for (auto& fact : fleet.facts)
    if (auto* prior = std::get_if<PriorFact<TypeParam>>(&fact)) {
      prior->persistent.scale = 0.01;
      prior->persistent.heading_rad_per_m = 1e-4;
    }
  EXPECT_LE(grow_and_compare<TypeParam>(fleet.facts, 4, 5), 3);
}

TYPED_TEST(IncrementalMaps, WhatIsWithdrawnIsGone) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(5);
  FactStore<G> store = fleet.store();
  const Selection<G> all = select(store, SelectionParams{});
  IncrementalMap<G> incremental;
  const auto whole = incremental.solve(build_problem<G>(store, all));
  Exclusions withdrawn;
  int gone = 0;
  for (const Hypothesis<G>& h : all.hypotheses) {
    if (h.state != HypothesisState::accepted) continue;
    withdrawn.hypotheses.insert(h.id);  // one after the other: single ones are implied by the others
    const Selection<G> without = select(store, SelectionParams{}, withdrawn);
    const auto map = incremental.solve(build_problem<G>(store, without));
    gone += incremental.last().gone_factors;
    const auto exact = SparseMap<G>().solve(build_problem<G>(store, without));
    EXPECT_LT(difference(*map, *exact).sigmas, 0.1);
    const auto again = incremental.solve(build_problem<G>(store, all));
    EXPECT_LT(difference(*again, *whole).sigmas, 0.1);
  }
  EXPECT_GT(gone, 50);
}

// A map goes on being asked while the next ones are made.
TYPED_TEST(IncrementalMaps, AMapStaysWhatItIs) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(6);
  const FactStore<G> store = fleet.store();
  IncrementalMap<G> incremental;
  incremental.solve(build_problem<G>(store, select(store, SelectionParams{})));
  const auto map = incremental.solve(build_problem<G>(store, select(store, SelectionParams{})));
  ASSERT_FALSE(incremental.last().from_start);
  const auto& node = map->problem().nodes.back();
  const auto before = map->pose(node.anchor.chain, node.slam);
  Exclusions most;
  for (const Hypothesis<G>& h : select(store, SelectionParams{}).hypotheses)
    if (most.hypotheses.size() < 8) most.hypotheses.insert(h.id);
  const auto next = incremental.solve(build_problem<G>(store, select(store, SelectionParams{}, most)));
  EXPECT_NE(next->digest(), map->digest());
  EXPECT_EQ(map->pose(node.anchor.chain, node.slam)->covariance, before->covariance);
}

// Of a long drive that nothing but its end is new of, next to nothing is factored.
TEST(IncrementalMap, WorksInWhatIsNewAlone) {
  test::SampleFleet fleet(7);
  for (const VehicleId v : {1U, 2U}) {
    fleet.start(v, SE2(50.0, 3.0 * v, M_PI / 2.0), v == 1 ? test::known_start : test::fair_start);
    for (int k = 1; k <= 60; ++k)
      fleet.stop(v, SE2(50.0 * std::cos(0.1 * k), 50.0 * std::sin(0.1 * k) + 3.0 * v, 0.1 * k + M_PI / 2.0));
  }
  for (std::uint32_t k = 1; k < 60; ++k)
    if (const auto pairs = fleet.common(key_of(1, k), key_of(2, k)); pairs.size() >= 5) fleet.associate(2, pairs);
  auto facts = fleet.facts;
  const auto last = std::find_if(facts.rbegin(), facts.rend(),
                                 [](const auto& f) { return std::holds_alternative<AssociationFact>(f); });
  ASSERT_NE(last, facts.rend());
  const AnyFact<SE2> newest = *last;
  facts.erase(std::next(last).base());
  FactStore<SE2> store = test::SampleFleet::store_of(facts);
  IncrementalMap<SE2> incremental;
  for (int again = 0; again < 3; ++again)
    incremental.solve(build_problem<SE2>(store, select(store, SelectionParams{})));
  EXPECT_EQ(incremental.last().fronts, 0);
  EXPECT_EQ(incremental.last().new_factors, 0);
  test::insert(store, newest);
  const auto map = incremental.solve(build_problem<SE2>(store, select(store, SelectionParams{})));
  EXPECT_GT(incremental.last().fronts, 0);
  EXPECT_LT(incremental.last().new_factors, 30);
  EXPECT_LE(incremental.last().iterations, 2);
  EXPECT_LT(
      difference(*map, *SparseMap<SE2>().solve(build_problem<SE2>(store, select(store, SelectionParams{})))).sigmas,
      0.1);
}

TYPED_TEST(IncrementalMaps, GoOnFromAnotherSolution) {
  using G = TypeParam;
  const auto fleet = test::street_fleet<G>(8);
  const FactStore<G> store = fleet.store();
  const auto problem = build_problem<G>(store, select(store, SelectionParams{}));
  IncrementalMap<G> incremental;
  incremental.solve(problem);
  incremental.solve(problem);
  const auto exact = SparseMap<G>().solve(problem);
  incremental.restart(*exact);
  const auto map = incremental.solve(problem);
  EXPECT_FALSE(incremental.last().from_start);
  EXPECT_EQ(incremental.last().relinearised, 0);  // it was there already
  EXPECT_LT(difference(*map, *exact).sigmas, 0.1);
}

// ---- a chain that may be anywhere else starts where its canonical start is: nothing there is to be moved ----

/// Vehicles without error, far apart in frames of their own, that see two places together.
template <class G>
class FarFrames {
 public:
  explicit FarFrames(const std::vector<VehicleId>& known_starts, VehicleId late_prior = 0) : fleet_(9, 0.0) {
    for (const VehicleId v : {1U, 2U, 3U}) {
      const bool known = std::count(known_starts.begin(), known_starts.end(), v) > 0;
      fleet_.start(v, test::on_the_street<G>(60.0 - 50.0 * v, 20.0 * v, 2.5 - v),
                   known ? test::known_start_of<G> : G::Tangent::Zero());
      for (const double x_m : {0.0, 12.0}) fleet_.stop(v, test::on_the_street<G>(x_m, 2.0 * v, 0.8 * v));
    }
    // Fixes of 3, too few to place it, and of 1.
    for (const VehicleId v : {1U, 3U})
      for (const std::uint32_t k : {1U, 2U}) fleet_.fix(key_of(v, k), v == 1 ? 0.1 : 5.0);
    for (const auto& fact : fleet_.facts)
      if (const auto* prior = std::get_if<PriorFact<G>>(&fact); prior && prior->key.chain.vehicle == late_prior)
        late = *prior;
      else test::insert(store, fact);
  }
  void meet(VehicleId v, VehicleId w) {
    for (const std::uint32_t k : {1U, 2U}) {
      fleet_.associate(w, fleet_.common(key_of(v, k), key_of(w, k)));
      test::insert(store, fleet_.facts.back());
    }
  }
  std::unique_ptr<Map<G>> solve() {
    SelectionParams params;
    params.fix_correlation_s = 1.0;
    return incremental.solve(build_problem<G>(store, select(store, params)));
  }
  static const ChainSpan& span(const Map<G>& map, VehicleId v) { return map.problem().chains.at(v - 1); }

  FactStore<G> store;
  IncrementalMap<G> incremental;
  PriorFact<G> late;

 private:
  test::SampleFleetOf<G> fleet_;
};

template <class G>
void expect_started_there(const FarFrames<G>& fleet, Map<G>& map) {
  EXPECT_FALSE(fleet.incremental.last().from_start);
  EXPECT_EQ(fleet.incremental.last().iterations, 1);
  EXPECT_LT(difference(map, *SparseMap<G>().solve(map.problem())).sigmas, 0.1);
}

TYPED_TEST(IncrementalMaps, AChainThatBecomesAlignedStartsAnew) {
  FarFrames<TypeParam> fleet({1});
  const auto before = fleet.solve();
  fleet.meet(1, 2);
  const auto after = fleet.solve();
  ASSERT_FALSE(fleet.span(*before, 2).aligned);
  ASSERT_TRUE(fleet.span(*after, 2).aligned);
  expect_started_there(fleet, *after);
}

// Placed from its own start before and after.
TYPED_TEST(IncrementalMaps, AChainWhoseStaticBiasArrivesStartsAnew) {
  FarFrames<TypeParam> fleet({1, 3}, 3);
  const auto before = fleet.solve();
  fleet.store.insert(fleet.late);
  const auto after = fleet.solve();
  ASSERT_FALSE(fleet.span(*before, 3).aligned);
  ASSERT_TRUE(fleet.span(*after, 3).aligned);
  ASSERT_EQ(fleet.span(*before, 3).placed_from, fleet.span(*after, 3).placed_from);
  ASSERT_EQ(fleet.span(*before, 3).end - fleet.span(*before, 3).first, 3);
  expect_started_there(fleet, *after);
}

// In the common frame before and after, but another one.
TYPED_TEST(IncrementalMaps, AChainThatIsPlacedFromElsewhereStartsAnew) {
  FarFrames<TypeParam> fleet({});
  fleet.meet(2, 3);
  const auto before = fleet.solve();
  fleet.meet(1, 2);
  const auto after = fleet.solve();
  for (const auto& [map, from] : {std::pair{before.get(), 2U}, std::pair{after.get(), 1U}}) {
    ASSERT_TRUE(fleet.span(*map, 3).aligned);
    ASSERT_EQ(fleet.span(*map, 3).placed_from, test::chain_of(from));
  }
  expect_started_there(fleet, *after);
}

// A filter at one moment, before and after a sighting moved it: two places of one anchor, abscissa and stamp. The later
// fact sorts before the earlier one.
TEST(IncrementalMap, TwoPlacesOfOneMomentAreTwoUnknowns) {
  test::SampleFleet fleet(3);
  for (const VehicleId v : {1U, 2U}) {
    const SE2 start(0.0, 5.0 * (v - 1), 0.1);
    fleet.start(v, start, test::known_start);
    for (int k = 1; k <= 8; ++k) fleet.stop(v, start * SE2(20.0 * k, 10.0 * std::sin(0.4 * k), 0.1));
  }
  FactStore<SE2> store = fleet.store();
  const auto encounter = [&](std::uint32_t index, const ChainState<SE2>& state) {
    const Key key = test::key_of(1, index);
    test::insert(store, AnyFact<SE2>(EncounterFact<SE2>{
                            key, 4, state, 2, {-5.0, 5.0}, 0.01 * SE2::PointCovariance::Identity()}));
    test::insert(store, AnyFact<SE2>(WaypointFact<SE2>{
                            key_of(2, index), 4, fleet.anchor(test::key_of(2, 4)).state, key, {0.0, 0.0}}));
  };
  ChainState<SE2> before = fleet.anchor(test::key_of(1, 4)).state;
  before.abscissa_m += 5.0;
  before.stamp_s += 2.0;
  before.pose = before.pose * SE2(5.0, 0.0, 0.0);
  before.drift += 2e-3 * SE2::Covariance::Identity();
  ChainState<SE2> after = before;
  after.pose = after.pose * SE2(0.2, 0.3, 0.01);
  after.drift -= 1e-3 * SE2::Covariance::Identity();
  IncrementalMap<SE2> incremental;
  const auto problem = [&] { return build_problem<SE2>(store, select(store, SelectionParams{})); };
  encounter(1, before);
  incremental.solve(problem());
  incremental.solve(problem());
  encounter(0, after);
  const auto map = incremental.solve(problem());
  ASSERT_EQ(map->problem().encounters.size(), 2U);
  EXPECT_FALSE(incremental.last().from_start);
  EXPECT_LT(difference(*map, *SparseMap<SE2>().solve(problem())).sigmas, 0.02);
}

}  // namespace
}  // namespace convoy
