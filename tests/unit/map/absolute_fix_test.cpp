// Absolute fixes (F3, DESIGN B7): the datum, outliers, and errors that hang together in time.
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <type_traits>
#include <variant>
#include <vector>

namespace convoy {
namespace {

using test::chain_of;
using test::key_of;

constexpr double sigma_m = 1.0;

template <class G>
G enu_of_world() {
  return test::SampleFleetOf<G>::enu_of_world();
}

template <class G>
class DrivenFleet {
 public:
  explicit DrivenFleet(std::uint64_t seed) : fleet(seed) {}

  test::SampleFleetOf<G> fleet;

  /// Starts level, as the common frame is taken to be.
  void drive(VehicleId v, const G& start, int stops, double step_m = 40.0) {
    fleet.start(v, start);
    for (int k = 1; k <= stops; ++k) {
      typename G::Tangent step = G::Tangent::Zero();
      step[0] = step_m;
      step[G::Dof - 1] = 0.15;
      fleet.stop(v, fleet.truth.at(key_of(v, static_cast<std::uint32_t>(k) - 1)) * G::Exp(step));
    }
  }
  Key fix(VehicleId v, std::uint32_t anchor, const typename G::Point& error) {
    return fleet.fix(key_of(v, anchor), error, sigma_m);
  }
  Key fix(VehicleId v, std::uint32_t anchor) { return fleet.fix(key_of(v, anchor), sigma_m); }

  GlobalMap<G> map(const SelectionParams& params) const {
    return build_global_map(fleet.store(), params, SparseMap<G>());
  }
};

SelectionParams uncorrelated() {
  SelectionParams params;
  params.fix_correlation_s = 0.0;
  return params;
}

template <class G>
class AbsoluteFixes : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(AbsoluteFixes, Groups);

TYPED_TEST(AbsoluteFixes, JacobiansAreTheNumericOnes) {
  using G = TypeParam;
  test::Random random(5);
  constexpr double h = 1e-5;
  for (int k = 0; k < 100; ++k) {
    const G T = random.template pose_of<G>(30.0), D = random.template pose_of<G>(300.0);
    AbsoluteFixFactor<G> f{};
    f.antenna = random.template unit_normal<G::Dim>();
    f.position = 100.0 * random.template unit_normal<G::Dim>();
    const AbsoluteFixResidual<G> one(f, T, D);
    for (int i = 0; i < G::Dof; ++i) {
      const typename G::Tangent e = h * G::Tangent::Unit(i);
      const typename G::Point by_T =
          (AbsoluteFixResidual<G>(f, T * G::Exp(e), D).r - AbsoluteFixResidual<G>(f, T * G::Exp(-e), D).r) / (2.0 * h);
      const typename G::Point by_D =
          (AbsoluteFixResidual<G>(f, T, D * G::Exp(e)).r - AbsoluteFixResidual<G>(f, T, D * G::Exp(-e)).r) / (2.0 * h);
      EXPECT_LT((one.J_T.col(i) - by_T).cwiseAbs().maxCoeff(), 1e-6);
      EXPECT_LT((one.J_D.col(i) - by_D).cwiseAbs().maxCoeff(), 1e-6);
    }
  }
}

// Two vehicles that never meet and do not know where they start: their fixes alone put both into one frame.
TYPED_TEST(AbsoluteFixes, AlignVehiclesThatNothingElseConnects) {
  using G = TypeParam;
  double sum = 0.0;
  int count = 0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    DrivenFleet<G> fleet(seed);
    typename G::Tangent away = G::Tangent::Zero();
    away[1] = 90.0;
    away[G::Dof - 1] = 1.0;
    fleet.drive(1, G(), 8);
    fleet.drive(2, G::Exp(away), 8);
    for (std::uint32_t k = 0; k <= 8; ++k) fleet.fix(1, k), fleet.fix(2, k);
    const auto global = fleet.map(uncorrelated());
    ASSERT_TRUE(global.map->report().converged);
    ASSERT_TRUE(global.map->aligned(chain_of(1)));
    ASSERT_TRUE(global.map->aligned(chain_of(2)));
    ASSERT_TRUE(global.map->datum().has_value());
    const auto last = global.map->pose(chain_of(2), fleet.fleet.anchor(key_of(2, 8)).state);
    const G truth = fleet.fleet.truth.at(key_of(1, 0)).inverse() * fleet.fleet.truth.at(key_of(2, 8));
    sum += squared_mahalanobis((last->mean.inverse() * truth).Log(), last->covariance) / G::Dof;
    ++count;
    // Where the fixes hold it, it is as good as they are; seen from the start of vehicle 1, the yaw there turns it.
    const G in_enu = global.map->datum()->mean * last->mean,
            true_in_enu = enu_of_world<G>() * fleet.fleet.truth.at(key_of(2, 8));
    EXPECT_LT((in_enu.translation() - true_in_enu.translation()).norm(), 5.0) << "seed " << seed;
  }
  std::printf("  ANEES of a pose that only fixes relate to the common frame: %.2f of %d runs\n", sum / count, count);
  EXPECT_GT(sum / count, 0.6);
  EXPECT_LT(sum / count, 1.5);
}

TYPED_TEST(AbsoluteFixes, TheDatumIsFoundWithTheUncertaintyItHas) {
  using G = TypeParam;
  double sum = 0.0;
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    DrivenFleet<G> fleet(seed);
    fleet.drive(1, G(), 8);
    for (std::uint32_t k = 0; k <= 8; ++k) fleet.fix(1, k);
    const auto global = fleet.map(uncorrelated());
    const auto datum = global.map->datum();
    ASSERT_TRUE(datum.has_value());
    const typename G::Tangent error = (datum->mean.inverse() * enu_of_world<G>()).Log();
    sum += error[G::Dof - 1] * error[G::Dof - 1] / datum->covariance(G::Dof - 1, G::Dof - 1);
  }
  std::printf("  normalised squared error of the datum's yaw: %.2f of 30 runs\n", sum / 30.0);
  EXPECT_GT(sum / 30.0, 0.45);
  EXPECT_LT(sum / 30.0, 1.75);
}

TYPED_TEST(AbsoluteFixes, AGrossErrorIsDroppedAndTheMapIsAsIfItHadNeverBeen) {
  using G = TypeParam;
  int others_dropped = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    DrivenFleet<G> with(seed), without(seed);
    with.drive(1, G(), 8);
    without.drive(1, G(), 8);
    for (std::uint32_t k = 0; k <= 8; ++k) with.fix(1, k), without.fix(1, k);
    typename G::Point error = G::Point::Zero();
    error[0] = 60.0;
    error[1] = -25.0;
    with.fix(1, 5, error);  // the last one by key
    const auto spoilt = with.map(uncorrelated()), clean = without.map(uncorrelated());
    EXPECT_EQ(std::count(spoilt.selection.fixes.begin(), spoilt.selection.fixes.end(), key_of(1, 9)), 0) << seed;
    others_dropped += static_cast<int>(clean.selection.fixes != spoilt.selection.fixes);
    if (clean.selection.fixes == spoilt.selection.fixes) {
      EXPECT_EQ(spoilt.map->digest(), clean.map->digest()) << seed;
    }
  }
  EXPECT_LE(others_dropped, 2);  // a good one beside it may go first, rarely
}

TYPED_TEST(AbsoluteFixes, EntersOncePerCorrelationTime) {
  using G = TypeParam;
  DrivenFleet<G> fleet(3);
  fleet.drive(1, G(), 12);
  for (std::uint32_t k = 0; k <= 12; ++k) fleet.fix(1, k);  // 20 s apart
  SelectionParams params;
  params.fix_correlation_s = 60.0;
  const auto selection = select(fleet.fleet.store(), params);
  ASSERT_GE(selection.fixes.size(), 3U);
  for (std::size_t i = 1; i < selection.fixes.size(); ++i) {
    const double before_s = fleet.fleet.anchor(key_of(1, selection.fixes[i - 1].index)).state.stamp_s;
    const double now_s = fleet.fleet.anchor(key_of(1, selection.fixes[i].index)).state.stamp_s;
    EXPECT_GE(now_s - before_s, 60.0);
  }
  EXPECT_LT(selection.fixes.size(), 13U);
  EXPECT_NE(select(fleet.fleet.store(), uncorrelated()).digest(), selection.digest());
}

TYPED_TEST(AbsoluteFixes, ADeclaredCommonFrameIsTheOneOfTheFixes) {
  using G = TypeParam;
  DrivenFleet<G> fleet(4);
  fleet.drive(1, G(), 8);
  fleet.drive(2, G(), 3);  // hears nothing from the sky
  for (std::uint32_t k = 0; k <= 8; ++k) fleet.fix(1, k);
  SelectionParams params = uncorrelated();
  params.common_frame_is_enu = true;
  const auto global = fleet.map(params);
  EXPECT_TRUE(global.map->aligned(chain_of(1)));
  EXPECT_FALSE(global.map->aligned(chain_of(2)));
  EXPECT_FALSE(global.map->datum().has_value());
  const auto pose = global.map->pose(chain_of(1), fleet.fleet.anchor(key_of(1, 4)).state);
  const G truth = enu_of_world<G>() * fleet.fleet.truth.at(key_of(1, 4));
  EXPECT_LT((pose->mean.translation() - truth.translation()).norm(), 3.0);
  EXPECT_LT(squared_mahalanobis((pose->mean.inverse() * truth).Log(), pose->covariance), chi2_quantile(0.9999, G::Dof));
}

TYPED_TEST(AbsoluteFixes, OfOnePlaceSayNothingOfTheYawAndChangeNothing) {
  using G = TypeParam;
  DrivenFleet<G> with(6), without(6);
  with.drive(1, G(), 4);
  without.drive(1, G(), 4);
  for (int k = 0; k < 3; ++k) with.fix(1, 2);
  const auto map = with.map(uncorrelated()), plain = without.map(uncorrelated());
  EXPECT_FALSE(map.map->datum().has_value());
  const auto state = with.fleet.anchor(key_of(1, 4)).state;
  EXPECT_LT(
      (map.map->pose(chain_of(1), state)->mean.inverse() * plain.map->pose(chain_of(1), state)->mean).Log().norm(),
      1e-12);
}

TYPED_TEST(AbsoluteFixes, AreAFunctionOfTheSetToTheBit) {
  using G = TypeParam;
  DrivenFleet<G> fleet(8);
  fleet.drive(1, G(), 8);
  for (std::uint32_t k = 0; k <= 8; ++k) fleet.fix(1, k);
  const auto reference = fleet.map(uncorrelated());
  auto facts = fleet.fleet.facts;
  for (int round = 0; round < 5; ++round) {
    std::shuffle(facts.begin(), facts.end(), fleet.fleet.random().engine());
    facts.push_back(facts[3]);  // a duplicate
    const auto map = build_global_map(test::SampleFleetOf<G>::store_of(facts), uncorrelated(), SparseMap<G>());
    EXPECT_EQ(map.map->digest(), reference.map->digest());
    EXPECT_EQ(map.selection.digest(), reference.selection.digest());
  }
}

// With the filter a chain that fixes alone would align is not aligned: it must not be placed by what nothing estimates.
TYPED_TEST(AbsoluteFixes, AreLeftOutByThePapersFilter) {
  using G = TypeParam;
  DrivenFleet<G> with(9), without(9);
  for (DrivenFleet<G>* fleet : {&with, &without}) {
    fleet->drive(1, G(), 4);
    fleet->drive(2, G(), 4);
  }
  for (std::uint32_t k = 0; k <= 4; ++k) with.fix(1, k), with.fix(2, k);
  ASSERT_TRUE(with.map(uncorrelated()).map->aligned(chain_of(2)));
  for (const bool enu : {false, true}) {
    SelectionParams params = uncorrelated();
    params.common_frame_is_enu = enu;
    const auto map = build_global_map(with.fleet.store(), params, EkfMap<G>());
    const auto plain = build_global_map(without.fleet.store(), params, EkfMap<G>());
    EXPECT_FALSE(map.map->datum().has_value());
    EXPECT_FALSE(map.map->aligned(chain_of(2)));
    EXPECT_EQ(map.map->digest(), plain.map->digest());
  }
}

// Several fixes between two anchors share the drift since the first: exact ones must not be believed more than that.
// Two vehicles stop every 10 m, and every fourth stop is an anchor.
TYPED_TEST(AbsoluteFixes, BetweenTwoAnchorsShareTheDriftBetweenThem) {
  using G = TypeParam;
  double sum = 0.0;
  constexpr int runs = 40;
  for (std::uint64_t seed = 1; seed <= runs; ++seed) {
    DrivenFleet<G> fleet(seed);
    typename G::Tangent away = G::Tangent::Zero();
    away[1] = 90.0;
    away[G::Dof - 1] = 1.0;
    fleet.drive(1, G(), 24, 10.0);
    fleet.drive(2, G::Exp(away), 24, 10.0);
    for (const VehicleId v : {1U, 2U})
      for (std::uint32_t k = 0; k <= 22; ++k) fleet.fleet.fix(key_of(v, k), 0.02, k - k % 4);
    std::erase_if(fleet.fleet.facts, [](const AnyFact<G>& fact) {
      const auto* anchor = std::get_if<AnchorFact<G>>(&fact);
      return anchor != nullptr && anchor->key.index % 4 != 0;
    });
    const auto global = fleet.map(uncorrelated());
    ASSERT_TRUE(global.map->datum().has_value());
    EXPECT_GE(global.map->problem().fixes.size(), 40U);
    const auto last = global.map->pose(chain_of(2), fleet.fleet.anchor(key_of(2, 24)).state);
    const G truth = fleet.fleet.truth.at(key_of(1, 0)).inverse() * fleet.fleet.truth.at(key_of(2, 24));
    sum += squared_mahalanobis((last->mean.inverse() * truth).Log(), last->covariance) / G::Dof;
  }
  std::printf("  ANEES with exact fixes between anchors: %.2f of %d runs\n", sum / runs, runs);
  EXPECT_GT(sum / runs, 0.6);
  EXPECT_LT(sum / runs, 1.5);
}

TYPED_TEST(AbsoluteFixes, BeforeTheirAnchorOrBeyondTheNextAreAbsent) {
  using G = TypeParam;
  DrivenFleet<G> fleet(14);
  fleet.drive(1, G(), 8);
  const Key good = fleet.fleet.fix(key_of(1, 4), sigma_m, 3);
  fleet.fleet.fix(key_of(1, 2), sigma_m, 3);
  fleet.fleet.fix(key_of(1, 5), sigma_m, 3);
  EXPECT_EQ(select(fleet.fleet.store(), uncorrelated()).fixes, std::vector<Key>{good});
}

// Fixes that are far better than what the vehicle knows by itself are judged, too.
TYPED_TEST(AbsoluteFixes, AGrossErrorAmongExactOnesIsDropped) {
  using G = TypeParam;
  constexpr double exact_m = 0.01;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    DrivenFleet<G> fleet(seed);
    fleet.drive(1, G(), 8);
    std::vector<Key> good;
    for (std::uint32_t k = 0; k <= 8; ++k) {
      if (k == 4) continue;
      good.push_back(fleet.fleet.fix(key_of(1, k), exact_m));
    }
    const Key gross = fleet.fleet.fix(key_of(1, 4), 20.0 * G::Point::Unit(1), exact_m);
    const auto global = fleet.map(uncorrelated());
    EXPECT_EQ(std::count(global.selection.fixes.begin(), global.selection.fixes.end(), gross), 0) << seed;
    EXPECT_GE(global.selection.fixes.size() + 2, good.size()) << seed;
    ASSERT_TRUE(global.map->datum().has_value());
    const auto pose = global.map->pose(chain_of(1), fleet.fleet.anchor(key_of(1, 8)).state);
    const G in_enu = global.map->datum()->mean * pose->mean;
    EXPECT_LT((in_enu.translation() - (enu_of_world<G>() * fleet.fleet.truth.at(key_of(1, 8))).translation()).norm(),
              0.5)
        << seed;
  }
}

TYPED_TEST(AbsoluteFixes, TheNeighboursInTimeOfADroppedOneDoNotTakeItsPlace) {
  using G = TypeParam;
  DrivenFleet<G> fleet(11);
  fleet.drive(1, G(), 8);
  std::vector<Key> spoilt;
  for (std::uint32_t k = 0; k <= 8; ++k) {
    typename G::Point error = G::Point::Zero();
    if (k == 3) error[0] = 40.0;
    for (int again = 0; again < 3; ++again) {  // three with the same error
      const Key key = fleet.fix(1, k, error);
      if (k == 3) spoilt.push_back(key);
    }
  }
  SelectionParams params;
  params.fix_correlation_s = 5.0;
  const auto global = fleet.map(params);
  EXPECT_EQ(global.selection.fixes.size(), 8U);
  for (const Key& key : spoilt)
    EXPECT_EQ(std::count(global.selection.fixes.begin(), global.selection.fixes.end(), key), 0);
}

// An author need not be honest about its clock.
TYPED_TEST(AbsoluteFixes, StampsThatJumpToAndFroDoNotMakeOneCountTwice) {
  using G = TypeParam;
  DrivenFleet<G> fleet(12);
  fleet.drive(1, G(), 2);
  FactStore<G> store = fleet.fleet.store();
  AbsoluteFixFact<G> fix{key_of(1, 0), 2, fleet.fleet.anchor(key_of(1, 2)).state};
  fix.covariance.setIdentity();
  const double stamp_s = fix.state.stamp_s;
  for (int k = 0; k < 20; ++k) {
    fix.key.index = static_cast<std::uint32_t>(k);
    fix.state.stamp_s = stamp_s + (k % 2 == 0 ? 0.0 : 1000.0);
    ASSERT_EQ(store.insert(fix), Insertion::inserted);
  }
  EXPECT_EQ(select(store, SelectionParams{}).fixes.size(), 2U);
}

TYPED_TEST(AbsoluteFixes, OfAnUnknownChainOrAnchorWaitForIt) {
  using G = TypeParam;
  DrivenFleet<G> fleet(13);
  fleet.drive(1, G(), 8);
  fleet.drive(2, G(), 8);
  const auto before = fleet.map(uncorrelated());
  for (std::uint32_t k = 0; k <= 8; ++k) fleet.fix(1, k), fleet.fix(2, k);
  const auto whole = fleet.map(uncorrelated());
  const auto of_two = [](const AnyFact<G>& fact, bool anchors) {
    return std::visit(
        [&](const auto& f) {
          return f.key.chain == chain_of(2) &&
                 (anchors || std::is_same_v<std::decay_t<decltype(f)>, AbsoluteFixFact<G>>);
        },
        fact);
  };
  FactStore<G> store;
  const SparseMap<G> backend;
  MapBuilder<G> builder(uncorrelated(), backend);
  for (const auto& fact : fleet.fleet.facts)  // of vehicle 2 nothing but its fixes
    if (!of_two(fact, true) || of_two(fact, false)) test::insert(store, fact);
  const auto waiting = builder.build(store);
  EXPECT_EQ(waiting.selection.fixes.size(), 9U);
  EXPECT_FALSE(waiting.map->pose(chain_of(2), fleet.fleet.anchor(key_of(2, 1)).state).has_value());
  for (const auto& fact : fleet.fleet.facts)
    if (of_two(fact, true) && !of_two(fact, false)) test::insert(store, fact);
  EXPECT_EQ(builder.build(store).map->digest(), whole.map->digest());
  EXPECT_NE(whole.map->digest(), before.map->digest());
}

}  // namespace
}  // namespace convoy
