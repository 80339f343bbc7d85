// build_problem() from the problem before: what did not change is taken from there, and the result is the same, to the
// bit.
#include <convoy/map/problem.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <optional>
#include <random>
#include <variant>

namespace convoy {
namespace {

using test::key_of;

template <class G>
bool same_group(const G& a, const G& b) {
  return a.translation() == b.translation() && a.rotation() == b.rotation();
}

template <class G>
bool same_state(const ChainState<G>& a, const ChainState<G>& b) {
  return a.stamp_s == b.stamp_s && a.abscissa_m == b.abscissa_m && same_group(a.pose, b.pose) && a.drift == b.drift &&
         a.heading_lever == b.heading_lever;
}

template <class G>
void expect_same(const Problem<G>& a, const Problem<G>& b) {
  EXPECT_TRUE(std::ranges::equal(a.chains, b.chains, [](const ChainSpan& x, const ChainSpan& y) {
    return x.chain == y.chain && x.first == y.first && x.end == y.end && x.aligned == y.aligned &&
           x.placed_from == y.placed_from && x.constants == y.constants && x.persistent == y.persistent;
  }));
  EXPECT_TRUE(std::ranges::equal(a.nodes, b.nodes, [](const Node<G>& x, const Node<G>& y) {
    return x.anchor == y.anchor && same_state(x.slam, y.slam) && same_group(x.initial, y.initial);
  }));
  EXPECT_TRUE(a.points == b.points);
  EXPECT_TRUE(std::ranges::equal(a.priors, b.priors, [](const PriorFactor<G>& x, const PriorFactor<G>& y) {
    return x.node == y.node && same_group(x.mean, y.mean) && x.covariance == y.covariance;
  }));
  EXPECT_TRUE(std::ranges::equal(a.drifts, b.drifts, [](const DriftFactor<G>& x, const DriftFactor<G>& y) {
    return x.a == y.a && x.b == y.b && same_group(x.motion, y.motion) && x.covariance == y.covariance &&
           x.constants == y.constants && x.A == y.A;
  }));
  const auto loading = [](const Problem<G>& p, const LandmarkFactor<G>& f) {
    return f.loading < 0 ? G::Loading::Zero().eval() : p.loadings[static_cast<std::size_t>(f.loading)];
  };
  EXPECT_TRUE(std::ranges::equal(a.landmarks, b.landmarks, [&](const LandmarkFactor<G>& x, const LandmarkFactor<G>& y) {
    return x.node == y.node && x.point == y.point && x.landmark == y.landmark && x.position == y.position &&
           x.covariance == y.covariance && loading(a, x) == loading(b, y);
  }));
  EXPECT_EQ(a.loadings.size(), b.loadings.size());
  EXPECT_EQ(a.placed_by, b.placed_by);
  EXPECT_EQ(a.constants.size(), b.constants.size());
  EXPECT_TRUE(std::ranges::equal(a.bounded, b.bounded, [](const BoundedFactor& x, const BoundedFactor& y) {
    return x.a == y.a && x.b == y.b && x.phi == y.phi && x.information == y.information;
  }));
  EXPECT_TRUE(std::ranges::equal(a.fixes, b.fixes, [](const auto& x, const auto& y) {
    return x.node == y.node && x.datum == y.datum && x.fix == y.fix && x.antenna == y.antenna &&
           x.position == y.position && x.covariance == y.covariance;
  }));
  EXPECT_EQ(a.datum, b.datum);
}

template <class G>
class Problems : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Problems, Groups);

// Facts come in any order, one by one, and every time other hypotheses and landmarks are left out. The start of a chain
// is not the moment that stands for it until it comes.
template <class G>
void grow(test::SampleFleetOf<G> fleet, std::uint64_t seed, const SelectionParams& params = {}) {
  std::mt19937_64 random(seed);
  for (auto& fact : fleet.facts)
    if (auto* anchor = std::get_if<AnchorFact<G>>(&fact); anchor != nullptr && anchor->key.index == 0)
      anchor->state.stamp_s = -1.0;
  std::shuffle(fleet.facts.begin(), fleet.facts.end(), random);
  FactStore<G> store;
  std::optional<Problem<G>> before;
  std::size_t kept = 0;
  for (std::size_t k = 0; k < fleet.facts.size() + 30; ++k) {
    if (k < fleet.facts.size()) test::insert(store, fleet.facts[k]);
    if (k < fleet.facts.size() && random() % 4 != 0) continue;
    Exclusions excluded;
    const Selection<G> all = select(store, params);
    for (const Hypothesis<G>& h : all.hypotheses)
      if (random() % 8 == 0) excluded.hypotheses.insert(h.id);
    for (const Key& key : all.classes.members())
      if (random() % 16 == 0) excluded.landmarks.insert(key);
    const Selection<G> selection = select(store, params, excluded);
    const Problem<G> anew = build_problem<G>(store, selection);
    if (before) expect_same(build_problem<G>(store, selection, {}, &*before), anew);
    if (testing::Test::HasFailure()) {
      ADD_FAILURE() << "seed " << seed << ", fact " << k;
      return;
    }
    kept += before ? std::min(before->points.size(), anew.points.size()) : 0;
    before = anew;
  }
  EXPECT_GT(kept, 1000U);
}

TYPED_TEST(Problems, AreTheSameFromTheOneBefore) {
  for (const std::uint64_t seed : {1U, 2U, 3U, 4U}) grow<TypeParam>(test::street_fleet<TypeParam>(seed), seed);
}

TYPED_TEST(Problems, AndWithFixesThatStandBetweenAnchors) {
  for (const std::uint64_t seed : {5U, 6U}) {
    auto fleet = test::street_fleet<TypeParam>(seed);
    for (const std::uint32_t k : {1U, 3U, 5U})
      for (const VehicleId v : {1U, 2U}) fleet.fix(key_of(v, k), 0.5, k - 1);
    grow<TypeParam>(fleet, seed);
  }
}

// A static bias comes last as often as first, and with it what is known of persistent drift.
TYPED_TEST(Problems, AndWithPersistentDrift) {
  SelectionParams every_fix;
  every_fix.fix_correlation_s = 0.0;
  for (const std::uint64_t seed : {7U, 8U, 9U, 10U}) {
    auto fleet = test::street_fleet<TypeParam>(seed);
    for (const VehicleId v : {1U, 2U})
      for (const std::uint32_t k : {1U, 2U, 3U, 4U}) fleet.fix(key_of(v, k), 0.5);
    for (auto& fact : fleet.facts)
      if (auto* prior = std::get_if<PriorFact<TypeParam>>(&fact)) {
        prior->persistent.scale = 0.01;
        if constexpr (TypeParam::Dim == 3) {
          prior->persistent.tilt_rad = 0.01;
          prior->persistent.correlation_m = 30.0;
          prior->persistent.up = Eigen::Vector3d::UnitZ();
        }
      }
    grow<TypeParam>(fleet, seed, every_fix);
  }
}

}  // namespace
}  // namespace convoy
