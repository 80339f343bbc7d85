// Encounters (F4): vehicles that see each other, and say so beside what they see of the street.
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <variant>
#include <vector>

namespace convoy {
namespace {

using test::chain_of;
using test::key_of;

constexpr double sigma_m = 0.1;

/// Two vehicles drive beside each other and stop at the same times; landmarks are never associated.
template <class G>
class MeetingFleet {
 public:
  explicit MeetingFleet(std::uint64_t seed, int stops = 8) : fleet(seed) {
    typename G::Tangent beside = G::Tangent::Zero();
    beside[1] = 12.0;
    beside[G::Dof - 1] = 0.5;
    drive(1, G(), stops);
    drive(2, G::Exp(beside), stops);
  }

  /// Vehicle 1 sees vehicle 2 at stop `k`, off by `error`. `answered`: by whom; nobody: 0.
  Key meet(std::uint32_t k, const typename G::Point& error, VehicleId answered = 2) {
    EncounterFact<G> e{key_of(1, next_++), k, fleet.anchor(key_of(1, k)).state, 2};
    typename G::Point mark = G::Point::Constant(0.3);
    e.position = fleet.truth.at(key_of(1, k)).inverse() * (fleet.truth.at(key_of(2, k)) * mark) + error;
    e.covariance = sigma_m * sigma_m * G::PointCovariance::Identity();
    fleet.facts.emplace_back(e);
    if (answered == 2)
      fleet.facts.emplace_back(
          WaypointFact<G>{key_of(2, e.key.index), k, fleet.anchor(key_of(2, k)).state, e.key, mark});
    return e.key;
  }
  Key meet(std::uint32_t k) { return meet(k, sigma_m * fleet.random().template unit_normal<G::Dim>()); }

  GlobalMap<G> map() const { return test::built(fleet.store()); }
  /// Of vehicle 2 at stop `k`, squared and normalised.
  double nees(GlobalMap<G>& global, std::uint32_t k) const {
    const auto pose = global.map->pose(chain_of(2), fleet.anchor(key_of(2, k)).state);
    const G truth = fleet.truth.at(key_of(1, 0)).inverse() * fleet.truth.at(key_of(2, k));
    return squared_mahalanobis((pose->mean.inverse() * truth).Log(), pose->covariance) / G::Dof;
  }

  test::SampleFleetOf<G> fleet;

 private:
  void drive(VehicleId v, const G& start, int stops) {
    fleet.start(v, start);
    for (int k = 1; k <= stops; ++k) {
      typename G::Tangent step = G::Tangent::Zero();
      step[0] = 30.0;
      step[G::Dof - 1] = 0.1;
      fleet.stop(v, fleet.truth.at(key_of(v, static_cast<std::uint32_t>(k) - 1)) * G::Exp(step));
    }
  }
  std::uint32_t next_ = 0;
};

template <class G>
class Encounters : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Encounters, Groups);

TYPED_TEST(Encounters, JacobiansAreTheNumericOnes) {
  using G = TypeParam;
  test::Random random(6);
  constexpr double h = 1e-5;
  for (int k = 0; k < 100; ++k) {
    const G T_o = random.template pose_of<G>(30.0), T_w = random.template pose_of<G>(30.0);
    EncounterFactor<G> f{};
    f.mark = random.template unit_normal<G::Dim>();
    f.position = 10.0 * random.template unit_normal<G::Dim>();
    const EncounterResidual<G> one(f, T_o, T_w);
    EXPECT_LT((one.r - (T_o.inverse() * (T_w * f.mark) - f.position)).norm(), 1e-12);
    for (int i = 0; i < G::Dof; ++i) {
      const typename G::Tangent e = h * G::Tangent::Unit(i);
      const typename G::Point by_o =
          (EncounterResidual<G>(f, T_o * G::Exp(e), T_w).r - EncounterResidual<G>(f, T_o * G::Exp(-e), T_w).r) /
          (2.0 * h);
      const typename G::Point by_w =
          (EncounterResidual<G>(f, T_o, T_w * G::Exp(e)).r - EncounterResidual<G>(f, T_o, T_w * G::Exp(-e)).r) /
          (2.0 * h);
      EXPECT_LT((one.J_o.col(i) - by_o).cwiseAbs().maxCoeff(), 1e-6);
      EXPECT_LT((one.J_w.col(i) - by_w).cwiseAbs().maxCoeff(), 1e-6);
    }
  }
}

TYPED_TEST(Encounters, AlignVehiclesThatNothingElseConnects) {
  using G = TypeParam;
  double sum = 0.0;
  constexpr int runs = 40;
  for (std::uint64_t seed = 1; seed <= runs; ++seed) {
    MeetingFleet<G> fleet(seed);
    for (std::uint32_t k = 1; k <= 8; ++k) fleet.meet(k);
    auto global = fleet.map();
    ASSERT_TRUE(global.map->report().converged);
    ASSERT_TRUE(global.map->aligned(chain_of(2)));
    sum += fleet.nees(global, 5);
  }
  std::printf("  ANEES of a pose that only encounters relate to the common frame: %.2f of %d runs\n", sum / runs, runs);
  EXPECT_GT(sum / runs, 0.6);
  EXPECT_LT(sum / runs, 1.5);
}

TYPED_TEST(Encounters, OfTwoPlacesAlignNothing) {
  using G = TypeParam;
  MeetingFleet<G> fleet(3);
  fleet.meet(2);
  fleet.meet(6);
  const auto global = fleet.map();
  EXPECT_FALSE(global.map->aligned(chain_of(2)));
  EXPECT_TRUE(global.map->problem().encounters.empty());
  fleet.meet(4);
  EXPECT_TRUE(fleet.map().map->aligned(chain_of(2)));
}

TYPED_TEST(Encounters, ThatContradictEachOtherAlignNothing) {
  using G = TypeParam;
  MeetingFleet<G> fleet(4);
  for (std::uint32_t k = 1; k <= 6; ++k) {
    typename G::Point error = G::Point::Zero();
    error[0] = 20.0 * (k % 3);
    error[1] = 15.0 * (k % 2);
    fleet.meet(k, error);
  }
  EXPECT_FALSE(fleet.map().map->aligned(chain_of(2)));
}

// The wrong vehicle was recognised, once: the map is as if that had never been said.
TYPED_TEST(Encounters, AGrossErrorIsDropped) {
  using G = TypeParam;
  int others = 0;
  for (std::uint64_t seed = 1; seed <= 15; ++seed) {
    MeetingFleet<G> with(seed), without(seed);
    for (std::uint32_t k = 1; k <= 8; ++k) with.meet(k), without.meet(k);
    typename G::Point error = G::Point::Zero();
    error[0] = -8.0;
    error[1] = 5.0;
    const Key gross = with.meet(5, error);
    auto spoilt = with.map();
    const auto clean = without.map();
    const auto& kept = spoilt.selection.encounters;
    EXPECT_TRUE(std::none_of(kept.begin(), kept.end(), [&](const auto& e) { return e.encounter == gross; })) << seed;
    if (kept == clean.selection.encounters) {
      EXPECT_EQ(spoilt.map->digest(), clean.map->digest()) << seed;
    } else {
      ++others;
    }
  }
  EXPECT_LE(others, 2);
}

TYPED_TEST(Encounters, WaitForTheOneWhoWasSeenToSayWhereItWas) {
  using G = TypeParam;
  MeetingFleet<G> fleet(5);
  const auto before = fleet.map();
  for (std::uint32_t k = 1; k <= 6; ++k) fleet.meet(k, G::Point::Zero(), 0);
  const auto waiting = fleet.map();
  EXPECT_TRUE(waiting.selection.encounters.empty());
  EXPECT_EQ(waiting.map->digest(), before.map->digest());
  // A stranger's answer is none.
  fleet.fleet.start(3, G());
  for (std::uint32_t k = 0; k < 6; ++k)
    fleet.fleet.facts.emplace_back(WaypointFact<G>{key_of(3, k), 0, {}, key_of(1, k), G::Point::Zero()});
  EXPECT_TRUE(fleet.map().selection.encounters.empty());
}

TYPED_TEST(Encounters, AreAFunctionOfTheSetToTheBit) {
  using G = TypeParam;
  MeetingFleet<G> fleet(8);
  for (std::uint32_t k = 1; k <= 8; ++k) fleet.meet(k);
  const auto reference = fleet.map();
  auto facts = fleet.fleet.facts;
  const SparseMap<G> backend;
  for (int round = 0; round < 5; ++round) {
    std::shuffle(facts.begin(), facts.end(), fleet.fleet.random().engine());
    FactStore<G> store;
    MapBuilder<G> builder(SelectionParams{}, backend);
    const auto half = facts.begin() + static_cast<std::ptrdiff_t>(facts.size() / 2);
    std::for_each(facts.begin(), half, [&](const auto& fact) { test::insert(store, fact); });
    (void)builder.build(store);
    std::for_each(half - 5, facts.end(), [&](const auto& fact) { test::insert(store, fact); });
    const auto again = builder.build(store);
    EXPECT_EQ(again.map->digest(), reference.map->digest());
    EXPECT_EQ(again.selection.digest(), reference.selection.digest());
  }
}

/// Eight meetings, each answered by `answer(stop, encounter)`.
template <class G, class Answer>
FactStore<G> met(MeetingFleet<G>& meeting, const Answer& answer) {
  for (std::uint32_t k = 1; k <= 8; ++k) {
    const Key encounter = meeting.meet(k, G::Point::Zero(), 0);
    meeting.fleet.facts.emplace_back(answer(k, encounter));
  }
  return meeting.fleet.store();
}

// Of two answers to an encounter the first by key counts, and it may come last.
TYPED_TEST(Encounters, AReplacedAnswerIsAnotherMeasurementToAnUpdate) {
  using G = TypeParam;
  MeetingFleet<G> meeting(10);
  const typename G::Point mark = G::Point::Constant(0.3);
  typename G::Point off = mark;
  off[0] -= 1.0;
  std::vector<WaypointFact<G>> right;
  FactStore<G> store = met(meeting, [&](std::uint32_t k, const Key& encounter) {
    right.push_back({key_of(2, k - 1), k, meeting.fleet.anchor(key_of(2, k)).state, encounter, mark});
    WaypointFact<G> wrong = right.back();
    wrong.key.index += 100;
    wrong.mark = off;
    return wrong;
  });
  const SparseMap<G> backend;
  MapBuilder<G> builder({}, backend);
  builder.build(store);
  builder.update(store);
  for (const WaypointFact<G>& waypoint : right) ASSERT_EQ(store.insert(waypoint), Insertion::inserted);
  const auto updated = builder.update(store), exact = test::built(store);
  ASSERT_FALSE(updated.exact);
  ASSERT_EQ(exact.map->problem().encounters.size(), 8U);
  const auto& last = meeting.fleet.anchor(key_of(2, 8)).state;
  const auto a = updated.map->pose(chain_of(2), last), b = exact.map->pose(chain_of(2), last);
  EXPECT_LT(squared_mahalanobis((b->mean.inverse() * a->mean).Log(), b->covariance), 0.1);
}

TYPED_TEST(Encounters, AnAnswerThatReplacesAnotherIsJudgedByTheUpdateItComesBy) {
  using G = TypeParam;
  MeetingFleet<G> meeting(11);
  const typename G::Point mark = G::Point::Constant(0.3);
  WaypointFact<G> wrong;
  FactStore<G> store = met(meeting, [&](std::uint32_t k, const Key& encounter) {
    const WaypointFact<G> right{key_of(2, 100 + k), k, meeting.fleet.anchor(key_of(2, k)).state, encounter, mark};
    if (k == 5) wrong = right;
    return right;
  });
  wrong.key.index = 0;
  wrong.mark[0] -= 30.0;
  const SparseMap<G> backend;
  MapBuilder<G> builder({}, backend);
  builder.build(store);
  EXPECT_EQ(builder.update(store).selection.encounters.size(), 8U);
  ASSERT_EQ(store.insert(wrong), Insertion::inserted);
  EXPECT_EQ(builder.update(store).selection.encounters.size(), 7U);
  EXPECT_EQ(test::built(store).selection.encounters.size(), 7U);
}

TYPED_TEST(Encounters, AreLeftOutByThePapersFilter) {
  using G = TypeParam;
  MeetingFleet<G> with(9), without(9);
  for (std::uint32_t k = 1; k <= 8; ++k) with.meet(k);
  EXPECT_TRUE(with.map().map->aligned(chain_of(2)));
  const auto map = build_global_map(with.fleet.store(), SelectionParams{}, EkfMap<G>());
  EXPECT_FALSE(map.map->aligned(chain_of(2)));
  EXPECT_EQ(map.map->digest(), build_global_map(without.fleet.store(), SelectionParams{}, EkfMap<G>()).map->digest());
}

}  // namespace
}  // namespace convoy
