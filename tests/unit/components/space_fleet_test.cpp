// Vehicles in space, from the front end to the map, over a network that loses things.
#include <convoy/components/fleet_monitor.hpp>
#include <convoy/components/vehicle.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>

#include <gtest/gtest.h>

#include "scripted_fleet.hpp"

namespace convoy {
namespace {

using Fleet = test::ScriptedFleetOf<SE3>;
using Options = test::MemberOptionsOf<SE3>;

const Impairment rough{.loss = 0.3, .duplicate = 0.2, .delay_s = 0.1, .jitter_s = 1.5, .seed = 1};

/// Vehicle 1 knows its start; the others do not, and are found by the geometry of what they see alone.
void run(Fleet& fleet, VehicleId vehicles) {
  Options known;
  known.static_bias = Estimate<SE3>{test::script_of<SE3>(1)[0].truth, SE3::Covariance::Zero()};
  fleet.add(1, known);
  for (VehicleId v = 2; v <= vehicles; ++v) fleet.add(v);
  fleet.drive(120);
  EXPECT_TRUE(fleet.settle());
}

struct Outcome {
  Hash facts = 0, map = 0, selection = 0;
  bool operator==(const Outcome&) const = default;
};

/// What all members agree on; a failure if they do not.
Outcome agreed(const Fleet& fleet) {
  std::optional<Outcome> first;
  for (const auto& member : fleet.members) {
    const Outcome own{member->facts(), member->map_digest(), member->manager.map().selection.digest()};
    if (!first) first = own;
    EXPECT_EQ(own, *first);
    EXPECT_EQ(member->manager.counters().disagreements, 0U);
  }
  return first.value_or(Outcome{});
}

TEST(FleetInSpace, FindsEachOtherByGeometryAndEndsWithOneMapOfWhereAllAre) {
  for (const VehicleId vehicles : {2U, 4U}) {
    Fleet fleet;
    run(fleet, vehicles);
    agreed(fleet);
    EXPECT_GE(fleet.members[0]->manager.map().selection.classes.size(), 20U);
    for (const auto& viewer : fleet.members) {
      EXPECT_GT(viewer->association.counters().searches, 0U);
      const auto own = viewer->view_of(viewer->chain(), fleet.now_s);
      ASSERT_TRUE(own.estimate);
      for (const auto& seen : fleet.members) {
        const auto state = viewer->view_of(seen->chain(), fleet.now_s);
        ASSERT_TRUE(state.estimate);
        EXPECT_EQ(state.integrity, Integrity::ok) << state.reasons;
        ASSERT_TRUE(is_covariance(state.estimate->covariance));
        const SE3 error = state.estimate->mean.inverse() * seen->truth();
        EXPECT_LT(squared_mahalanobis(error.Log(), state.estimate->covariance), chi2_quantile(0.9999, 6));
        if (seen == viewer) continue;
        // To each other: T_a_b Exp(d) with d = d_b - Ad_{T_a_b}^-1 d_a.
        const SE3 between = own.estimate->mean.inverse() * state.estimate->mean;
        Eigen::Matrix<double, 6, 12> A;
        A << -between.inverse().adjoint(), SE3::Covariance::Identity();
        const auto joint = viewer->manager.map().map->joint_covariance(own.chain, own.slam, state.chain, state.slam);
        ASSERT_TRUE(joint);
        const SE3::Covariance P = A * *joint * A.transpose();
        const SE3 off = between.inverse() * viewer->truth().inverse() * seen->truth();
        EXPECT_LT(squared_mahalanobis(off.Log(), P), chi2_quantile(0.9999, 6));
        EXPECT_LT(off.translation().norm(), 1.0);
      }
    }
  }
}

TEST(FleetInSpace, LossDuplicatesAndReorderingChangeNothingInTheEnd) {
  Fleet clean;
  run(clean, 3);
  const Outcome expected = agreed(clean);
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    Impairment impairment = rough;
    impairment.seed = seed;
    Fleet fleet(impairment);
    run(fleet, 3);
    EXPECT_EQ(agreed(fleet), expected) << seed;
    for (const auto& member : fleet.members) {
      EXPECT_GT(member->manager.exchange_counters().dropped, 20U);
      EXPECT_GT(member->manager.repair_counters().requests_sent, 0U);
    }
  }
}

TEST(FleetInSpace, TheFilterOfThePaperMapsItToo) {
  Fleet fleet;
  Options known, unknown;
  known.submaps.backend = unknown.submaps.backend = MapBackend::ekf;
  known.static_bias = Estimate<SE3>{test::script_of<SE3>(1)[0].truth, SE3::Covariance::Zero()};
  fleet.add(1, known);
  fleet.add(2, unknown);
  fleet.drive(120);
  ASSERT_TRUE(fleet.settle());
  agreed(fleet);
  const auto state = fleet.members[0]->view_of(fleet.members[1]->chain(), fleet.now_s);
  ASSERT_TRUE(state.estimate);
  const SE3 error = state.estimate->mean.inverse() * fleet.members[1]->truth();
  EXPECT_LT(squared_mahalanobis(error.Log(), state.estimate->covariance), chi2_quantile(0.9999, 6));
}

TEST(FleetInSpace, AMonitorSeesTheMapOfTheVehicles) {
  Fleet fleet;
  const auto silent = fleet.network().join({});
  FleetMonitor<SE3> monitor(*silent, {});
  Options known;
  known.static_bias = Estimate<SE3>{test::script_of<SE3>(1)[0].truth, SE3::Covariance::Zero()};
  fleet.add(1, known);
  fleet.add(2);
  for (int k = 0; k < 160; ++k) {
    fleet.drive(1);
    monitor.step(fleet.now_s);
  }
  ASSERT_TRUE(fleet.settle());
  EXPECT_EQ(monitor.map().map->digest(), agreed(fleet).map);
}

/// Vehicles of the group G hear a digest of a fleet of the other dimension.
template <class G>
void hears_the_other_dimension() {
  InProcessNetwork<G> network;
  const auto inside = network.join({}), outside = network.join({});
  SubmapManager<G> manager({1, 1}, *inside, {});
  manager.open_chain(0.0, {});
  Digest foreign;
  foreign.dimension = G::Dim == 2 ? 3 : 2;
  foreign.marks.push_back({{2, 1}, FactKind::anchor, 7, 7, 1});
  ASSERT_EQ(outside->send({{2, 1}, foreign}), SendStatus::sent);
  manager.step(1.0);
  EXPECT_EQ(manager.counters().dimension_mismatch, 1U);
  EXPECT_EQ(manager.store().missing_count(), 0U) << "nothing of what it holds is asked for";
  Digest own = foreign;
  own.dimension = G::Dim;
  ASSERT_EQ(outside->send({{2, 1}, own}), SendStatus::sent);
  manager.step(2.0);
  EXPECT_EQ(manager.counters().dimension_mismatch, 1U);
  EXPECT_EQ(manager.store().missing_count(), 7U);
}

TEST(FleetInSpace, AFleetOfTheOtherDimensionIsRefusedAndCounted) {
  hears_the_other_dimension<SE2>();
  hears_the_other_dimension<SE3>();
}

// The whole vehicle, with its thread and its lifecycle.
TEST(VehicleInSpace, RunsFromItsFrontEndToItsPose) {
  FrozenLandmarks<SE3> slam;
  VehicleParams<SE3> params;
  params.id = 1;
  params.static_bias = Estimate<SE3>{SE3::Exp((SE3::Tangent() << 5, 6, 7, 0.1, 0.2, 0.3).finished()), {}};
  params.static_bias->covariance.setZero();
  InProcessNetwork<SE3> network;
  Vehicle<SE3> vehicle(
      params, slam, [&] { return network.join({}); }, [] { return 0.0; });
  vehicle.configure();
  vehicle.activate();
  SE3 truth = params.static_bias->mean;
  for (int k = 1; k <= 20; ++k) {
    const SE3 U = test::scripted_motion(SE3(), 1, k);
    truth = truth * U;
    ASSERT_TRUE(vehicle.feed([&] {
      FrontEndState<SE3> state = slam.state();
      state.stamp_s = k;
      state.abscissa_m += 1.0;
      state.pose = state.pose * U;
      ASSERT_TRUE(slam.advance(state));
      FrozenLandmark<SE3> landmark;
      landmark.position << 1.0, 2.0, 3.0;
      landmark.covariance = 0.01 * SE3::PointCovariance::Identity();
      if (k % 5 == 0) slam.close({landmark});
    }));
  }
  vehicle.deactivate();
  vehicle.inspect([](SubmapManager<SE3>& manager, FrontEndComponent<SE3>&) { manager.rebuild(0.0, true); });
  const auto look = vehicle.snapshot();
  EXPECT_EQ(look.landmarks_exported, 4U);
  ASSERT_EQ(look.vehicles.size(), 1U);
  ASSERT_TRUE(look.vehicles[0].estimate);
  EXPECT_LT((look.vehicles[0].estimate->mean.inverse() * truth).Log().norm(), 1e-9);
}

}  // namespace
}  // namespace convoy
