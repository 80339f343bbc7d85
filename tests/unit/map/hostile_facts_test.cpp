// Facts that pass every check one by one, and are wrong or odd: what was right before stays.
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "../random_world.hpp"
#include "sample_fleet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace convoy {
namespace {

template <class G>
class HostileFacts : public testing::Test {
 protected:
  static std::size_t accepted(const GlobalMap<G>& map) {
    const auto& all = map.selection.hypotheses;
    return static_cast<std::size_t>(
        std::count_if(all.begin(), all.end(), [](const auto& h) { return h.state == HypothesisState::accepted; }));
  }
  static SelectionParams params() {
    SelectionParams p;
    p.fix_correlation_s = 5.0;
    return p;
  }
  static GlobalMap<G> built(const FactStore<G>& store) { return build_global_map(store, params(), SparseMap<G>()); }

  /// Vehicle 3 says that it saw vehicle 1 `off_m` from where it was, to 5 cm, at anchor `k` of both.
  static std::vector<AnyFact<G>> gross_encounter(const test::SampleFleetOf<G>& fleet, std::uint32_t index,
                                                      std::uint32_t k, double off_m) {
    const auto here = fleet.anchor(test::key_of(3, k)), there = fleet.anchor(test::key_of(1, k));
    EncounterFact<G> seen{test::key_of(3, index), k, here.state, 1};
    seen.position = fleet.truth.at(here.key).inverse() * fleet.truth.at(there.key).translation();
    seen.position[index % 2 == 0 ? 0 : 1] += off_m;
    seen.covariance = 0.0025 * G::PointCovariance::Identity();
    const WaypointFact<G> answer{test::key_of(1, index), k, there.state, seen.key, G::Point::Zero()};
    return {seen, answer};
  }
  static void insert(FactStore<G>& store, const std::vector<AnyFact<G>>& facts) {
    for (const auto& any : facts)
      std::visit([&](const auto& fact) { EXPECT_EQ(store.insert(fact), Insertion::inserted); }, any);
  }
};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(HostileFacts, Groups);

// A stranger says of its start that it is known but for one direction: metres, kilometres and radians hang together.
TYPED_TEST(HostileFacts, ACovarianceOfRankOneHarmsNobody) {
  using G = TypeParam;
  auto fleet = test::street_fleet<G>(2);
  for (const VehicleId v : {1U, 2U})
    for (std::uint32_t k = 1; k <= 5; ++k) fleet.fix(test::key_of(v, k), 0.5);
  const std::size_t honest = this->accepted(this->built(fleet.store()));
  ASSERT_GE(honest, 15U);
  test::Random random(9);
  for (const double sigma_m : {10.0, 100.0, 1000.0, 3e4})
    for (int draw = 0; draw < 8; ++draw) {
      typename G::Tangent v = test::each<G>(sigma_m, 0.3);
      for (int d = 0; d < G::Dof; ++d) v[d] *= random.uniform(-1.0, 1.0);
      FactStore<G> store = fleet.store();
      PriorFact<G> prior{test::key_of(41, 0), true, G()};
      prior.covariance = v * v.transpose();
      ASSERT_EQ(store.insert(prior), Insertion::inserted);
      const GlobalMap<G> map = this->built(store);
      EXPECT_EQ(this->accepted(map), honest) << sigma_m << " m, draw " << draw;
      EXPECT_TRUE(map.map->report().converged) << sigma_m << " m, draw " << draw;
      for (const VehicleId vehicle : {1U, 2U, 3U}) {
        const auto pose = map.map->pose(test::chain_of(vehicle), fleet.anchor(test::key_of(vehicle, 5)).state);
        EXPECT_TRUE(pose->covariance.allFinite()) << vehicle;
      }
    }
}

// They bend the map so far that true hypotheses contradict it, until they are found out: then those come back.
TYPED_TEST(HostileFacts, GrossMeasurementsTakeNoTrueHypothesisWithThem) {
  using G = TypeParam;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const auto fleet = test::street_fleet<G>(seed);
    FactStore<G> store = fleet.store();
    const std::size_t honest = this->accepted(this->built(store));
    for (std::uint32_t k = 1; k <= 5; ++k) this->insert(store, this->gross_encounter(fleet, k - 1, k, 300.0));
    EXPECT_EQ(this->accepted(this->built(store)), honest) << seed;
  }
}

TYPED_TEST(HostileFacts, NorInAnUpdate) {
  using G = TypeParam;
  for (const bool fix : {true, false})
    for (std::uint64_t seed = 1; seed <= 6; ++seed) {
      auto fleet = test::street_fleet<G>(seed);
      for (const VehicleId v : {1U, 2U})
        for (std::uint32_t k = 1; k <= 5; ++k) fleet.fix(test::key_of(v, k), 0.5);
      FactStore<G> store = test::SampleFleetOf<G>::store_of({});
      const SparseMap<G> backend;
      MapBuilder<G> builder(this->params(), backend);
      std::vector<AnyFact<G>> later;
      for (const auto& any : fleet.facts) {
        const auto* association = std::get_if<AssociationFact>(&any);
        if (association != nullptr && association->key.index % 2 == 1) later.push_back(any);
        else this->insert(store, {any});
      }
      ASSERT_GE(later.size(), 5U);
      builder.build(store);
      this->insert(store, later);
      if (fix) {
        const auto there = fleet.anchor(test::key_of(3, 3));
        AbsoluteFixFact<G> gross{test::key_of(3, 0), 3, there.state};
        gross.position = fleet.enu_of_world() * fleet.truth.at(there.key).translation();
        gross.position[0] += 20.0;
        gross.covariance = 0.0025 * G::PointCovariance::Identity();
        this->insert(store, {gross});
      } else {
        this->insert(store, this->gross_encounter(fleet, 0, 3, 20.0));
      }
      const std::size_t updated = this->accepted(builder.update(store));
      EXPECT_EQ(updated, this->accepted(this->built(store))) << seed << (fix ? ", fix" : ", encounter");
    }
}

// What is said to be bounded to nothing is bounded to next to nothing.
TEST(HostileFacts3D, APersistentDriftOfNextToNothingHarmsNobody) {
  auto fleet = test::street_fleet<SE3>(3);
  FactStore<SE3> store = fleet.store();
  PriorFact<SE3> prior{test::key_of(41, 0), false, SE3()};
  prior.persistent.tilt_rad = prior.persistent.height_m = 1e-300;
  prior.persistent.correlation_m = 50.0;
  prior.persistent.up = Eigen::Vector3d::UnitZ();
  ASSERT_EQ(store.insert(prior), Insertion::inserted);
  const auto map = build_global_map(store, SelectionParams{}, SparseMap<SE3>());
  EXPECT_TRUE(map.map->report().converged);
  EXPECT_TRUE(std::isfinite(map.map->report().chi2));
}

}  // namespace
}  // namespace convoy
