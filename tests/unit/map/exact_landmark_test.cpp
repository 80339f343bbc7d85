// A landmark of zero covariance (the store takes it: "exactly known") in an accepted hypothesis.
#include <gtest/gtest.h>
#include <convoy/geometry/covariance.hpp>
#include "sample_fleet.hpp"
using namespace convoy;
TEST(ExactLandmark, AnExactlyKnownLandmarkDoesNotPoisonTheMap) {
  test::SampleFleet fleet(1);
  for (VehicleId v : {1U, 2U}) fleet.start(v, SE2(-10.0 * v, 0, 0), test::paper_bias);
  const Key a = fleet.stop(1, SE2(0, 0, 0)), b = fleet.stop(2, SE2(3, 0, 0.4));
  for (auto& f : fleet.facts)
    if (auto* l = std::get_if<test::Landmark>(&f); l && l->key.chain.vehicle == 1)
      l->covariance.setZero(), l->loading.setZero(),
          l->position = fleet.truth.at(l->anchor_key()).inverse() * fleet.point_of.at(l->key);
  fleet.associate(1, fleet.common(a, b));
  test::Store store;
  for (auto& f : fleet.facts) ASSERT_EQ(test::insert(store, f), Insertion::inserted);
  const auto g = test::built(store);
  ASSERT_EQ(g.selection.hypotheses.size(), 1U);
  for (const auto& p : g.map->poses()) EXPECT_TRUE(p.translation().allFinite());
  const auto e = g.map->pose(b.chain, fleet.anchor(b).state);
  EXPECT_TRUE(e->covariance.allFinite());
}
TEST(ExactLandmark, NearlySingularLandmarksToo) {
  for (double s : {1e-20, 1e-16, 1e-12, 1e-9}) {
    test::SampleFleet fleet(1);
    for (VehicleId v : {1U, 2U}) fleet.start(v, SE2(-10.0 * v, 0, 0), test::paper_bias);
    const Key a = fleet.stop(1, SE2(0, 0, 0)), b = fleet.stop(2, SE2(3, 0, 0.4));
    for (auto& f : fleet.facts)
      if (auto* l = std::get_if<test::Landmark>(&f); l && l->key.chain.vehicle == 1)
        l->covariance = s * Eigen::Matrix2d::Identity(), l->loading.setZero(),
        l->position = fleet.truth.at(l->anchor_key()).inverse() * fleet.point_of.at(l->key);
    fleet.associate(1, fleet.common(a, b));
    const auto g = test::built(fleet.store());
    for (const auto& p : g.map->poses()) EXPECT_TRUE(p.translation().allFinite());
    const auto e = g.map->pose(b.chain, fleet.anchor(b).state);
    EXPECT_TRUE(is_covariance(e->covariance)) << s;
  }
}
