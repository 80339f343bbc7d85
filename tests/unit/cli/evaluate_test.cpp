#include "evaluate/evaluate.hpp"
#include "evaluate/judge_associations.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <convoy/config_error.hpp>

#include "fake_run.hpp"
#include "scenario/street.hpp"

namespace convoy::cli {
namespace {

using nlohmann::json;
using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

constexpr double duration_s = 100.0;

Eigen::Matrix3d diagonal(double x, double y, double theta) { return Eigen::Vector3d(x, y, theta).asDiagonal(); }

/// Vehicle 1 drives along y = 10 of the world, vehicle 2 beside it, 5 m to the left; both start with heading 0 at
/// x = 100. The common frame is vehicle 1's start. Estimates are true unless a test changes them.
RunRecord<SE2> straight_run() {
  RunRecord<SE2> run;
  run.scenario = "street";
  run.common_frame_vehicle = 1;
  run.info = {{"seed", 4}, {"wall_s", 5.0}, {"vehicle_s", 100.0}, {"lost_vehicles", json::array()}};
  for (const VehicleId id : {1U, 2U}) {
    VehicleRecord<SE2> vehicle;
    vehicle.id = id;
    const double side_m = id == 1 ? 0.0 : 5.0;
    for (double t = 0.0; t <= duration_s; t += 0.25) vehicle.truth.push_back({t, SE2(100.0 + t, 10.0 + side_m, 0.0)});
    for (double t = 0.0; t <= duration_s; t += 1.0) {
      const PoseEstimate<SE2> common{SE2(t, side_m, 0.0), diagonal(0.04, 0.01, 0.0001)};
      const PoseEstimate<SE2> slam{SE2(t, 0.0, 0.0), diagonal(0.01, 0.01, 0.0001)};
      vehicle.live.push_back({t, id, t, slam, common});
      vehicle.trajectory.push_back({t, id, t, slam, common});
    }
    vehicle.summary = {{"map_digest", "aa"}, {"facts_missing", 0}, {"landmarks_exported", 7}, {"bytes_sent", 1000}};
    run.first_event_s[id] = 0.0;
    run.vehicles.push_back(vehicle);
  }
  return run;
}

/// Adds to each vehicle what it says of the other one.
void let_them_hear_each_other(RunRecord<SE2>& run) {
  const auto first = run.vehicles[0].live, second = run.vehicles[1].live;
  run.vehicles[0].live.insert(run.vehicles[0].live.end(), second.begin(), second.end());
  run.vehicles[1].live.insert(run.vehicles[1].live.end(), first.begin(), first.end());
}

Pairing pairing(VehicleId a, std::uint32_t i, VehicleId b, std::uint32_t j) { return {Key{{a, 1}, i}, Key{{b, 1}, j}}; }

TEST(Evaluate, APerfectRunHasNoError) {
  RunRecord<SE2> run = straight_run();
  let_them_hear_each_other(run);
  const json m = evaluate(run).metrics;
  EXPECT_NEAR(m.at("fleet_ate_m").get<double>(), 0.0, 1e-9);
  EXPECT_NEAR(m.at("fleet_anees").get<double>(), 0.0, 1e-9);
  EXPECT_EQ(m.at("fleet_coverage95"), 1.0);
  EXPECT_EQ(m.at("map_digests_equal"), true);
  EXPECT_EQ(m.at("facts_lost"), 0);
  EXPECT_EQ(m.at("real_time_factor"), 20.0);
  EXPECT_EQ(m.at("seed"), 4);
  EXPECT_NEAR(m.at("pairs")[0].at("distance_rmse_raw_m").get<double>(), 5.0, 1e-9);
}

TEST(Evaluate, AteIsTakenAfterOneRigidAlignmentOfTheFleet) {
  RunRecord<SE2> run = straight_run();
  const SE2 elsewhere(-40.0, 7.0, 1.1);  // must not matter
  for (VehicleRecord<SE2>& vehicle : run.vehicles)
    for (std::size_t i = 0; i < vehicle.trajectory.size(); ++i) {
      PoseRow<SE2>& row = vehicle.trajectory[i];
      // An error of 0.1 m along the way, forth and back, of vehicle 1 alone.
      const double error_m = vehicle.id == 1 ? (i % 2 == 0 ? 0.1 : -0.1) : 0.0;
      row.common->T = elsewhere * SE2(error_m, 0.0, 0.0) * row.common->T;
    }
  const json m = evaluate(run).metrics;
  EXPECT_NEAR(m.at("vehicles")[0].at("ate_m").get<double>(), 0.1, 1e-3);
  EXPECT_NEAR(m.at("vehicles")[1].at("ate_m").get<double>(), 0.0, 1e-3);
  EXPECT_NEAR(m.at("fleet_ate_m").get<double>(), 0.1 / std::sqrt(2.0), 1e-3);
}

TEST(Evaluate, AnOffsetBetweenVehiclesIsNotAlignedAway) {
  RunRecord<SE2> run = straight_run();
  for (PoseRow<SE2>& row : run.vehicles[1].trajectory) row.common->T = SE2(0.0, 1.0, 0.0) * row.common->T;
  const json m = evaluate(run).metrics;
  EXPECT_NEAR(m.at("fleet_ate_m").get<double>(), 0.5, 1e-6);
}

TEST(Evaluate, NeesIsMeasuredInTheBodyFrameAgainstItsCovariance) {
  RunRecord<SE2> run = straight_run();
  // sigma_x is 0.2 m: half of the poses are off by 2 sigma (NEES 4), half by 3 sigma (NEES 9).
  for (std::size_t i = 0; i < run.vehicles[0].live.size(); ++i)
    run.vehicles[0].live[i].common->T = SE2(run.vehicles[0].live[i].t_s - (i % 2 == 0 ? 0.4 : 0.6), 0.0, 0.0);
  run.vehicles[0].live.pop_back();  // an even number of them
  const Evaluation<SE2> evaluation = evaluate(run);
  const json& vehicle = evaluation.metrics.at("vehicles")[0];
  EXPECT_NEAR(vehicle.at("pose_anees").get<double>(), 6.5 / 3.0, 1e-9);
  EXPECT_NEAR(vehicle.at("pose_coverage95").get<double>(), 0.5, 1e-9);
  EXPECT_EQ(vehicle.at("pose_anees"), vehicle.at("pose_anees_start"));
  EXPECT_NEAR(vehicle.at("trajectory_anees").get<double>(), 0.0, 1e-9);
  ASSERT_EQ(evaluation.live_nees.at(1).size(), 100U);
  EXPECT_NEAR(evaluation.live_nees.at(1)[1].value, 9.0, 1e-9);
}

TEST(Evaluate, PosesThatCannotBeJudgedAreLeftOutAndCounted) {
  RunRecord<SE2> run = straight_run();
  run.vehicles[0].live[0].common->P.setZero();  // known exactly
  run.vehicles[0].live[1].common.reset();       // not aligned yet
  run.vehicles[0].live[2].t_s = 1000.0;         // no truth there
  const json vehicle = evaluate(run).metrics.at("vehicles")[0];
  EXPECT_EQ(vehicle.at("poses_judged"), 98);
  EXPECT_EQ(vehicle.at("poses_without_covariance"), 1);
}

TEST(Evaluate, MrclamIsJudgedInTheFittedGauge) {
  RunRecord<SE2> run = straight_run();
  run.scenario = "mrclam";
  // The markers of vehicle 1 sit at an angle: the gauge at the start would turn the whole fleet by it.
  for (TruthPose<SE2>& pose : run.vehicles[0].truth) pose.T_world_body = pose.T_world_body * SE2(0.0, 0.0, 0.05);
  const json m = evaluate(run).metrics;
  EXPECT_EQ(m.at("gauge"), "fit");
  EXPECT_NEAR(m.at("gauge_turn_rad").get<double>(), 0.05, 1e-6);
  EXPECT_NEAR(m.at("gauge_shift_m").get<double>(), 0.0, 1e-6);
  const json& second = m.at("vehicles")[1];
  EXPECT_NEAR(second.at("pose_anees").get<double>(), 0.0, 1e-6);
  EXPECT_GT(second.at("pose_anees_start").get<double>(), 10.0);
  const json& first = m.at("vehicles")[0];
  EXPECT_NEAR(first.at("pose_anees_fit").get<double>(), 0.05 * 0.05 / 0.0001 / 3.0, 1e-3);
  EXPECT_NEAR(first.at("truth_mount_heading_rad").get<double>(), 0.05, 1e-6);
  EXPECT_NEAR(first.at("pose_anees_mounted").get<double>(), 0.0, 1e-6);
  EXPECT_NEAR(m.at("fleet_ate_m").get<double>(), 0.0, 1e-6);
}

TEST(Evaluate, CorrectedDistancesAreOfTheWholeRunInBothDirections) {
  RunRecord<SE2> run = straight_run();
  // Vehicle 2 is 0.5 m too far aside, known between t = 20.5 and 60.5 alone, at stamps that vehicle 1 has not.
  auto& rows = run.vehicles[1].trajectory;
  std::erase_if(rows, [](const PoseRow<SE2>& row) { return row.t_s < 20.0 || row.t_s > 60.0; });
  for (PoseRow<SE2>& row : rows) {
    row.t_s += 0.5;
    row.common->T = SE2(row.t_s, 5.5, 0.0);
  }
  run.vehicles[0].map = MapRecord<SE2>{};  // no association at all: what was known live does not matter
  json pair = evaluate(run).metrics.at("pairs")[0];
  EXPECT_NEAR(pair.at("distance_rmse_corrected_m").get<double>(), 0.5, 1e-9);
  EXPECT_TRUE(pair.at("distance_rmse_m").is_null());
  // Beyond its ends a trajectory says nothing, though the truth is there.
  std::erase_if(run.vehicles[0].trajectory, [](const PoseRow<SE2>& row) { return row.t_s > 10.0; });
  EXPECT_TRUE(evaluate(run).metrics.at("pairs")[0].at("distance_rmse_corrected_m").is_null());
}

TEST(Evaluate, CorrectedPosesBetweenRowsLieOnTheArc) {
  RunRecord<SE2> run = straight_run();
  // Vehicle 2 circles with 0.5 rad/s on a radius of 5 m; a chord over the 2 s between its rows would be 0.6 m off.
  const SE2 start(100.0, 15.0, 0.0);
  const auto along = [](double t_s) { return SE2::Exp(SE2::Tangent(2.5 * t_s, 0.0, 0.5 * t_s)); };
  for (TruthPose<SE2>& pose : run.vehicles[1].truth) pose.T_world_body = start * along(pose.t_s);
  auto& rows = run.vehicles[1].trajectory;
  std::erase_if(rows, [](const PoseRow<SE2>& row) { return std::fmod(row.t_s, 2.0) != 0.0; });
  for (PoseRow<SE2>& row : rows) row.common->T = SE2(0.0, 5.0, 0.0) * along(row.t_s);
  EXPECT_NEAR(evaluate(run).metrics.at("pairs")[0].at("distance_rmse_corrected_m").get<double>(), 0.0, 1e-9);
}

TEST(Evaluate, DistancesCountFromTheFirstAssociation) {
  RunRecord<SE2> run = straight_run();
  for (VehicleRecord<SE2>& vehicle : run.vehicles)
    for (PoseRow<SE2>& row : vehicle.live)
      if (vehicle.id == 2) row.common->T = SE2(row.t_s, row.t_s < 40.0 ? 25.0 : 5.3, 0.0);
  let_them_hear_each_other(run);
  run.vehicles[0].map = MapRecord<SE2>{};
  run.vehicles[0].map->associations.push_back({2, 40.0, true, {pairing(1, 0, 2, 0)}});
  run.vehicles[0].map->associations.push_back({2, 10.0, false, {pairing(1, 1, 2, 1)}});  // refused: does not count
  const Evaluation<SE2> evaluation = evaluate(run);
  const json pair = evaluation.metrics.at("pairs")[0];
  EXPECT_EQ(pair.at("first_association_s"), 40.0);
  EXPECT_NEAR(pair.at("distance_rmse_m").get<double>(), 0.3, 1e-9);
  EXPECT_NEAR(pair.at("distance_error_final_m").get<double>(), 0.3, 1e-9);
  EXPECT_NEAR(pair.at("distance_rmse_raw_m").get<double>(), 5.0, 1e-9);
  ASSERT_EQ(evaluation.pairs[0].distances.size(), 101U);
  EXPECT_NEAR(*evaluation.pairs[0].distances[0].convoy_m, 25.0, 1e-9);
}

TEST(Evaluate, EachDistanceComesWithItsSamples) {
  RunRecord<SE2> run = straight_run();
  for (VehicleRecord<SE2>& vehicle : run.vehicles)
    for (PoseRow<SE2>& row : vehicle.live) {
      if (vehicle.id == 2) row.common->T = SE2(row.t_s, 5.3, 0.0);
      if (vehicle.id == 2 && row.t_s < 50.0) row.slam->T = SE2(row.t_s, 40.0, 0.0);  // raw: 35 m, and 5 m later on
      if (row.t_s > 52.0) row.common.reset();
    }
  let_them_hear_each_other(run);
  run.vehicles[0].map = MapRecord<SE2>{};
  run.vehicles[0].map->associations.push_back({2, 40.0, true, {pairing(1, 0, 2, 0)}});
  json pair = evaluate(run).metrics.at("pairs")[0];
  EXPECT_EQ(pair.at("distance_samples_raw"), 2 * 101);
  EXPECT_EQ(pair.at("distance_samples"), 2 * 13);         // 40 to 52 s
  EXPECT_EQ(pair.at("distance_samples_settled"), 2 * 3);  // 50 to 52 s
  EXPECT_EQ(pair.at("distance_samples_corrected"), 2 * 101);
  EXPECT_NEAR(pair.at("distance_rmse_raw_settled_m").get<double>(), 5.0, 1e-9);  // in the very same time
  EXPECT_NEAR(pair.at("distance_rmse_raw_after_m").get<double>(), std::sqrt((10 * 35.0 * 35.0 + 3 * 25.0) / 13), 1e-9);
  EXPECT_NEAR(pair.at("distance_error_final_m").get<double>(), 0.3, 1e-9);
  EXPECT_EQ(pair.at("distance_error_final_s"), 52.0);
  run.vehicles[0].map->associations[0].t_s = 60.0;  // after the last sample that could be compared
  pair = evaluate(run).metrics.at("pairs")[0];
  for (const char* key : {"distance_rmse_m", "distance_rmse_settled_m", "distance_rmse_raw_after_m",
                          "distance_rmse_raw_settled_m", "distance_error_final_m", "distance_error_final_s"})
    EXPECT_TRUE(pair.at(key).is_null()) << key;
  EXPECT_EQ(pair.at("distance_samples"), 0);
}

TEST(Evaluate, LatencyIsNotError) {
  RunRecord<SE2> run = straight_run();
  let_them_hear_each_other(run);
  for (VehicleRecord<SE2>& vehicle : run.vehicles)
    for (PoseRow<SE2>& row : vehicle.live)
      if (row.vehicle != vehicle.id) {  // stamps of a peer lie 0.4 s back, and so do its poses
        row.t_s -= 0.4;
        row.common->T = SE2(-0.4, 0.0, 0.0) * row.common->T;
        row.slam->T = SE2(-0.4, 0.0, 0.0) * row.slam->T;
      }
  run.vehicles[0].map = MapRecord<SE2>{};
  run.vehicles[0].map->associations.push_back({2, 5.0, true, {pairing(1, 0, 2, 0)}});
  EXPECT_NEAR(evaluate(run).metrics.at("pairs")[0].at("distance_rmse_m").get<double>(), 0.0, 1e-9);
}

TEST(Evaluate, AssociationThroughAThirdVehicleCounts) {
  RunRecord<SE2> run = straight_run();
  run.vehicles.push_back(run.vehicles[1]);
  run.vehicles[2].id = 3;
  run.vehicles[0].map = MapRecord<SE2>{};
  run.vehicles[0].map->associations.push_back({1, 30.0, true, {pairing(2, 0, 3, 0)}});
  run.vehicles[0].map->associations.push_back({1, 20.0, true, {pairing(1, 0, 3, 1)}});
  const json pairs = evaluate(run).metrics.at("pairs");
  EXPECT_EQ(pairs[0].at("first_association_s"), 30.0);  // 1 and 2, through 3
  EXPECT_EQ(pairs[0].at("first_direct_association_s"), nullptr);
  EXPECT_EQ(pairs[1].at("first_association_s"), 20.0);
  EXPECT_EQ(pairs[1].at("distance_rmse_m"), nullptr);  // nobody saw anybody
}

TEST(Evaluate, PairingsAreJudgedByTheLabels) {
  RunRecord<SE2> run = straight_run();
  run.vehicles[0].track_of_landmark = {{{1, 0}, 70}, {{1, 1}, 71}, {{1, 2}, 72}};
  run.vehicles[1].track_of_landmark = {{{1, 0}, 70}, {{1, 1}, 99}, {{1, 2}, 72}};
  run.vehicles[0].map = MapRecord<SE2>{};
  auto& associations = run.vehicles[0].map->associations;
  associations.push_back({2, 1.0, true, {pairing(1, 0, 2, 0), pairing(1, 1, 2, 1)}});  // one true, one false
  associations.push_back({2, 2.0, true, {pairing(1, 0, 2, 0), pairing(1, 2, 2, 2)}});  // one known already, one true
  associations.push_back({2, 3.0, true, {pairing(1, 2, 2, 9)}});                       // label missing
  associations.push_back({2, 4.0, false, {pairing(1, 1, 2, 2)}});                      // refused
  const json a = evaluate(run).metrics.at("associations");
  EXPECT_EQ(a.at("accepted"), 4);
  EXPECT_EQ(a.at("true"), 2);
  EXPECT_EQ(a.at("false"), 1);
  EXPECT_EQ(a.at("unjudged"), 1);
  EXPECT_EQ(a.at("hypotheses_accepted"), 3);
  EXPECT_EQ(a.at("hypotheses_false"), 1);
  EXPECT_EQ(a.at("hypotheses_rejected"), 1);
}

TEST(Evaluate, PairingsWithinAVehicleAreNotThoseBetweenVehicles) {
  RunRecord<SE2> run = straight_run();
  run.vehicles[0].track_of_landmark = {{{1, 0}, 70}, {{1, 1}, 71}, {{1, 5}, 70}, {{1, 6}, 79}};
  run.vehicles[1].track_of_landmark = {{{1, 0}, 70}};
  run.vehicles[0].map = MapRecord<SE2>{};
  auto& associations = run.vehicles[0].map->associations;
  associations.push_back({1, 1.0, true, {pairing(1, 0, 1, 5), pairing(1, 1, 1, 6)}});  // a loop: one true, one false
  associations.push_back({2, 2.0, true, {pairing(1, 0, 2, 0)}});
  const json a = evaluate(run).metrics.at("associations");
  EXPECT_EQ(a.at("accepted"), 3);
  EXPECT_EQ(a.at("within_a_vehicle"), 2);
  EXPECT_EQ(a.at("within_a_vehicle_false"), 1);
  EXPECT_EQ(a.at("between_vehicles"), 1);
  EXPECT_EQ(a.at("between_vehicles_false"), 0);
}

/// straight_run() with coarse poses: vehicle 1 closes a batch of four landmarks after 20 s, vehicle 2 one after 30 s,
/// of the very same landmarks, which it has moved by `misplaced` in its own batch.
RunRecord<SE2> run_with_coarse_poses(const SE2& misplaced) {
  RunRecord<SE2> run = straight_run();
  run.pose_tolerance = PoseTolerance{6.0, 0.25};
  run.vehicles[0].map = MapRecord<SE2>{};
  MapRecord<SE2>& map = *run.vehicles[0].map;
  std::vector<Pairing> pairings;
  for (const VehicleId id : {1U, 2U}) {
    MapAnchor<SE2> anchor;
    anchor.key = Key{{id, 1}, 3};
    anchor.stamp_s = 10.0 + 10.0 * id;
    anchor.common = PoseEstimate<SE2>{SE2(-7.0, id, 0.3 * id)};  // wherever the map has it
    map.anchors.push_back(anchor);
    const SE2 T_body_world = truth_at(run.find(id)->truth, anchor.stamp_s)->inverse();
    for (std::uint32_t i = 0; i < 4; ++i) {
      const Eigen::Vector2d place(120.0 + 5.0 * (i % 2), 15.0 + 4.0 * (i / 2));
      const Eigen::Vector2d seen = T_body_world * (id == 1 ? place : misplaced * place);
      map.landmarks.push_back({Key{{id, 1}, i}, anchor.common->T * seen, -1, 3});
    }
  }
  for (std::uint32_t i = 0; i < 4; ++i) pairings.push_back(pairing(1, i, 2, i));
  map.associations.push_back({2, 30.0, true, pairings});
  return run;
}

TEST(Evaluate, WithoutIdentitiesHypothesesAreJudgedByThePoses) {
  const SE2 around(122.5, 17.0, 0.0);  // the middle of the landmarks
  const std::pair<SE2, int> cases[] = {{SE2(), 0},
                                       {SE2(4.0, 0.0, 0.0), 0},
                                       {SE2(4.0, 5.0, 0.0), 1},
                                       {around * SE2(0.0, 0.0, 0.2) * around.inverse(), 0},
                                       {around * SE2(0.0, 0.0, -0.3) * around.inverse(), 1}};
  for (const auto& [misplaced, wrong] : cases) {
    const json a = evaluate(run_with_coarse_poses(misplaced)).metrics.at("associations");
    EXPECT_EQ(a.at("judged_by"), "poses");
    EXPECT_EQ(a.at("hypotheses_accepted"), 1);
    EXPECT_EQ(a.at("hypotheses_false"), wrong) << misplaced.Log().transpose();
    EXPECT_EQ(a.at("hypotheses_unjudged"), 0);
    EXPECT_EQ(a.at("between_vehicles"), 4);
    for (const char* unknown : {"true", "false", "within_a_vehicle_false", "between_vehicles_false"})
      EXPECT_EQ(a.at(unknown), nullptr) << unknown;
  }
  RunRecord<SE2> gap = run_with_coarse_poses(SE2(100.0, 0.0, 0.0));
  std::erase_if(gap.vehicles[1].truth, [](const auto& pose) { return std::abs(pose.t_s - 30.0) < 5.0; });
  const json a = evaluate(gap).metrics.at("associations");
  EXPECT_EQ(a.at("hypotheses_false"), 0);
  EXPECT_EQ(a.at("hypotheses_unjudged"), 1);
}

TEST(Evaluate, TracksWithoutNamesAreJudgedByTheirPlaces) {
  RunRecord<SE2> run = straight_run();
  run.vehicles[0].map = MapRecord<SE2>{};
  for (VehicleRecord<SE2>& v : run.vehicles) {
    v.track_of_landmark = {{{1, 0}, 7}, {{1, 1}, 8}, {{1, 2}, 9}, {{1, 3}, 10}};
    v.place_of_track = {{7, {5.0, 1.0, 2.0}}, {8, {6.0, 1.0, 2.0}}, {9, {7.0, 1.0, 2.0}}};
  }
  run.vehicles[1].place_of_track[8].z() += 0.99 * same_place_m;
  run.vehicles[1].place_of_track[9].y() += 1.01 * same_place_m;
  std::vector<Pairing> pairings;
  for (std::uint32_t i = 0; i < 4; ++i) pairings.push_back(pairing(1, i, 2, i));
  run.vehicles[0].map->associations.push_back({2, 30.0, true, pairings});
  const json a = evaluate(run).metrics.at("associations");
  EXPECT_EQ(a.at("judged_by"), "places");
  EXPECT_EQ(a.at("true"), 2);
  EXPECT_EQ(a.at("false"), 1);
  EXPECT_EQ(a.at("unjudged"), 1) << "of track 10 the truth knows nothing";
  EXPECT_EQ(a.at("hypotheses_false"), 1);
  EXPECT_NEAR(a.at("apart_median_m").get<double>(), 0.99 * same_place_m, 1e-12);
}

TEST(Evaluate, OfCovariancesACoarseTruthSaysNothing) {
  const json m = evaluate(run_with_coarse_poses(SE2())).metrics;
  EXPECT_EQ(m.at("gauge"), "fit");
  EXPECT_EQ(m.at("pose_tolerance").at("position_m"), 6.0);
  EXPECT_NEAR(m.at("fleet_ate_m").get<double>(), 0.0, 1e-9);
  for (const char* unknown : {"fleet_anees", "fleet_coverage95", "fleet_anees_start", "fleet_trajectory_anees"})
    EXPECT_EQ(m.at(unknown), nullptr) << unknown;
  EXPECT_EQ(m.at("vehicles")[0].at("truth_mount_heading_rad"), nullptr);
}

TEST(Evaluate, AMapIsSharedOnlyIfItIsEqualAndLinkedBetweenVehicles) {
  RunRecord<SE2> run = straight_run();
  for (VehicleRecord<SE2>& vehicle : run.vehicles) {
    vehicle.map = MapRecord<SE2>{};
    vehicle.map->chains = {{{1, 1}, true}, {{2, 1}, true}};  // both in the common frame, by their static biases
    vehicle.map->associations.push_back({1, 1.0, true, {pairing(1, 0, 1, 5), pairing(2, 0, 2, 5)}});
    vehicle.map->associations.push_back({1, 2.0, false, {pairing(1, 0, 2, 0)}});  // refused
  }
  const auto verdict = [&] {
    const json m = evaluate(run).metrics;
    return json::array(
        {m.at("all_aligned"), m.at("all_in_common_frame"), m.at("all_linked"), m.at("map_digests_equal")});
  };
  EXPECT_EQ(verdict(), json::array({false, true, false, true}));
  run.vehicles[0].map->associations.push_back({1, 3.0, true, {pairing(1, 1, 2, 1)}});
  EXPECT_EQ(verdict(), json::array({true, true, true, true}));
  run.vehicles[1].summary["map_digest"] = "bb";
  EXPECT_EQ(verdict(), json::array({false, true, true, false}));
  run.vehicles[1].summary = nullptr;  // lived, and said nothing
  EXPECT_EQ(verdict(), json::array({nullptr, true, true, nullptr}));
  run.vehicles[0].map->chains[1].aligned = false;
  EXPECT_EQ(verdict(), json::array({false, false, true, nullptr}));
}

TEST(Evaluate, VehiclesAreLinkedThroughOthers) {
  RunRecord<SE2> run = straight_run();
  run.vehicles.push_back(run.vehicles[1]);
  run.vehicles[2].id = 3;
  run.vehicles[0].map = MapRecord<SE2>{};
  auto& associations = run.vehicles[0].map->associations;
  associations.push_back({1, 1.0, true, {pairing(2, 0, 3, 0)}});
  EXPECT_EQ(evaluate(run).metrics.at("all_linked"), false);
  associations.push_back({1, 2.0, true, {pairing(1, 0, 3, 1)}});
  EXPECT_EQ(evaluate(run).metrics.at("all_linked"), true);
}

TEST(Evaluate, LandmarksAreFittedToTheirTruth) {
  RunRecord<SE2> run = straight_run();
  for (VehicleRecord<SE2>& vehicle : run.vehicles) vehicle.truth.clear();
  run.landmarks = {{70, {0.0, 0.0}}, {71, {4.0, 0.0}}, {72, {0.0, 4.0}}, {73, {4.0, 4.0}}};
  const SE2 T(2.0, 3.0, -0.7);
  run.vehicles[0].map = MapRecord<SE2>{};
  run.vehicles[0].map->chains = {{{1, 1}, true}, {{2, 1}, false}};
  for (std::uint32_t i = 0; i < 4; ++i) {
    run.vehicles[0].track_of_landmark[{1, i}] = 70 + i;
    // Corners of a square moved outwards by 0.1 m each: no rigid motion helps.
    const Eigen::Vector2d out = (run.landmarks[i].p_world_m - Eigen::Vector2d(2.0, 2.0)).normalized() * 0.1;
    run.vehicles[0].map->landmarks.push_back({Key{{1, 1}, i}, T * (run.landmarks[i].p_world_m + out), -1});
  }
  run.vehicles[1].track_of_landmark[{1, 0}] = 70;
  run.vehicles[0].map->landmarks.push_back({Key{{2, 1}, 0}, Eigen::Vector2d(500.0, 0.0), -1});  // not aligned
  const json m = evaluate(run).metrics;
  EXPECT_NEAR(m.at("landmark_rmse_m").get<double>(), 0.1, 1e-9);
  EXPECT_EQ(m.at("fleet_ate_m"), nullptr);
  EXPECT_EQ(m.at("fleet_coverage95"), nullptr);
  EXPECT_EQ(m.at("all_aligned"), false);
}

TEST(Evaluate, BytesPerSecondComeFromTheCumulativeCounter) {
  RunRecord<SE2> run = straight_run();
  run.vehicles[0].traffic = {{1.0, 100.0}, {2.0, 1100.0}, {3.0, 1200.0}, {4.0, 50.0}};  // started again at the end
  const Evaluation<SE2> evaluation = evaluate(run);
  const json vehicle = evaluation.metrics.at("vehicles")[0];
  EXPECT_NEAR(vehicle.at("bytes_per_s_max").get<double>(), 1000.0, 1e-9);
  EXPECT_NEAR(vehicle.at("bytes_per_s_mean").get<double>(), 1250.0 / 4.0, 1e-9);
  ASSERT_EQ(evaluation.bytes_per_s.at(1).size(), 4U);
  EXPECT_NEAR(evaluation.bytes_per_s.at(1)[3].value, 50.0, 1e-9);
  EXPECT_EQ(evaluation.metrics.at("vehicles")[1].at("bytes_per_s_max"), nullptr);
}

TEST(Evaluate, LostVehiclesDoNotAnswerForTheFleet) {
  RunRecord<SE2> run = straight_run();
  run.vehicles[1].lost = true;
  run.vehicles[1].summary = nullptr;
  run.info["lost_vehicles"] = {2};
  json m = evaluate(run).metrics;
  EXPECT_EQ(m.at("map_digests_equal"), true);
  EXPECT_EQ(m.at("facts_lost"), 0);
  EXPECT_EQ(m.at("lost_vehicles"), json({2}));
  EXPECT_EQ(m.at("vehicles")[1].at("map_digest"), nullptr);
  run.vehicles[1].lost = false;  // alive but silent: nothing is known
  m = evaluate(run).metrics;
  EXPECT_EQ(m.at("map_digests_equal"), nullptr);
  EXPECT_EQ(m.at("facts_lost"), nullptr);
  run.vehicles[1].summary = {{"map_digest", "bb"}, {"facts_missing", 3}};
  m = evaluate(run).metrics;
  EXPECT_EQ(m.at("map_digests_equal"), false);
  EXPECT_EQ(m.at("facts_lost"), 3);
  run.vehicles[1].summary["facts_lost"] = 4;  // declared missing: facts_missing counts them no more
  EXPECT_EQ(evaluate(run).metrics.at("facts_lost"), 7);
}

TEST(Tum, HasTimePositionAndQuaternion) {
  std::vector<PoseRow<SE2>> rows(2);
  rows[0] = {1.5, 1, 0.0, {}, PoseEstimate<SE2>{SE2(1.0, -2.0, M_PI / 2), Eigen::Matrix3d::Zero()}};
  rows[1] = {2.0, 1, 0.0, {}, {}};  // not aligned: not in the file
  EXPECT_EQ(tum_trajectory(rows), "1.500000 1.000000 -2.000000 0 0 0 0.707106781 0.707106781\n");
}

class RunFolder : public testing::Test {
 protected:
  void SetUp() override {
    StreetParams params;
    params.distance_m = 120.0;
    test::FakeRun<SE2>(make_street<SE2>(params, 5), folder_.path()).write_all();
  }
  TemporaryFolder folder_;
};

TEST_F(RunFolder, IsReadJudgedAndWritten) {
  const RunRecord<SE2> run = read_run<SE2>(folder_.path());
  write_evaluation(run, evaluate(run));
  const json m = json::parse(test::read(folder_ / "metrics.json"));
  EXPECT_EQ(m.at("vehicles").size(), 2U);
  EXPECT_LT(m.at("fleet_ate_m").get<double>(), 0.2);
  EXPECT_GT(m.at("pairs")[0].at("distance_rmse_raw_m").get<double>(), 3.0);
  EXPECT_LT(m.at("pairs")[0].at("distance_rmse_m").get<double>(), 0.3);
  EXPECT_GT(m.at("associations").at("true").get<int>(), 10);
  EXPECT_EQ(m.at("associations").at("false"), 0);
  EXPECT_EQ(m.at("all_aligned"), true);
  for (const char* key :
       {"id", "landmarks_exported", "landmarks_known", "facts_missing", "bytes_sent", "bytes_per_s_mean",
        "bytes_per_s_max", "requests_sent", "ate_m", "pose_anees", "pose_coverage95", "integrity", "map_digest",
        "peak_rss_mb", "trajectory_anees", "trajectory_coverage95"})
    EXPECT_FALSE(m.at("vehicles")[0].at(key).is_null()) << key;
  EXPECT_FALSE(test::read(folder_ / "vehicle_1.tum").empty());
  EXPECT_FALSE(test::read(folder_ / "vehicle_2.tum").empty());
}

TEST_F(RunFolder, WithNothingButItsNameIsAllNull) {
  for (const char* part : {"vehicle_1", "vehicle_2", "truth", "scenario.json"})
    std::filesystem::remove_all(folder_ / part);
  const json m = evaluate(read_run<SE2>(folder_.path())).metrics;
  for (const char* key : {"fleet_ate_m", "fleet_anees", "fleet_coverage95", "landmark_rmse_m", "map_digests_equal",
                          "facts_lost", "all_aligned"})
    EXPECT_EQ(m.at(key), nullptr) << key;
  for (const char* key :
       {"landmarks_exported", "bytes_per_s_max", "ate_m", "pose_anees", "pose_coverage95", "map_digest"})
    EXPECT_EQ(m.at("vehicles")[1].at(key), nullptr) << key;
  EXPECT_EQ(m.at("associations").at("true"), nullptr);
  EXPECT_EQ(m.at("pairs")[0].at("distance_rmse_m"), nullptr);
}

TEST_F(RunFolder, DamageIsRefusedWithFileAndLine) {
  const auto refusal = [this](const char* file, const std::string& content) {
    const std::string before = test::read(folder_ / file);
    test::write(folder_ / file, content);
    const std::string text = config_error_of([this] { read_run<SE2>(folder_.path()); });
    test::write(folder_ / file, before);
    return text;
  };
  const std::string live = test::read(folder_ / "vehicle_1/live.csv");
  EXPECT_THAT(refusal("vehicle_1/live.csv", live.substr(0, live.size() - 5)), HasSubstr("the file has been cut"));
  EXPECT_THAT(refusal("vehicle_1/live.csv", std::string(live_header<SE2>) + "\n1,1,0,0,0,0,,,,,,,,,,,,,,,,OK,\n"),
              HasSubstr("live.csv:2: a pose and its covariance"));
  EXPECT_THAT(refusal("vehicle_2/traffic.csv", "t_s,bytes_sent,messages_sent\n2,1,1\n1,2,2\n"),
              HasSubstr("traffic.csv:3: time"));
  EXPECT_THAT(refusal("vehicle_2/labels.csv", "index,epoch,track\n-1,1,7\n"), HasSubstr("labels.csv:2: field 1"));
  EXPECT_THAT(refusal("vehicle_2/map.json", "{\"map_digest\""), HasSubstr("map.json: not what it should be: no JSON"));
  EXPECT_THAT(refusal("vehicle_2/map.json", "{\"map_digest\":\"x\"}"),
              HasSubstr("map.json: not what it should be: the entry 'chains' is missing"));
  EXPECT_THAT(refusal("run.json", "{}"), HasSubstr("run.json: not what it should be"));
  EXPECT_EQ(config_error_of([this] { read_run<SE2>(folder_.path()); }), "");
}

TEST_F(RunFolder, VehicleIdsMustBeThoseOfAFleet) {
  const json good = json::parse(test::read(folder_ / "run.json"));
  const auto refusal = [&](const char* key, const json& value) {
    json info = good;
    info[key] = value;
    test::write(folder_ / "run.json", info.dump());
    const std::string text = config_error_of([this] { read_run<SE2>(folder_.path()); });
    EXPECT_EQ(text.find('\n'), std::string::npos);
    return text;
  };
  EXPECT_THAT(refusal("vehicles", {1, 2, 2}), HasSubstr("run.json: 'vehicles' names vehicle 2 twice"));
  EXPECT_THAT(refusal("vehicles", {0, 1, 2}), HasSubstr("run.json: 'vehicles' holds 0"));
  EXPECT_THAT(refusal("vehicles", {1, -2}), HasSubstr("'vehicles' holds -2"));
  EXPECT_THAT(refusal("vehicles", {1, 2.5}), HasSubstr("'vehicles' holds 2.5"));
  EXPECT_THAT(refusal("vehicles", {1, nullptr}), HasSubstr("'vehicles' holds null"));
  EXPECT_THAT(refusal("vehicles", {1, 4294967296}), HasSubstr("'vehicles' holds 4294967296"));
  EXPECT_THAT(refusal("vehicles", json::array()), HasSubstr("'vehicles' names none"));
  EXPECT_THAT(refusal("vehicles", 5), HasSubstr("'vehicles' is no list"));
  EXPECT_THAT(refusal("vehicles", {2}), HasSubstr("'common_frame_vehicle' is not among 'vehicles'"));
  EXPECT_THAT(refusal("vehicles", {1}), HasSubstr("live.csv:"));  // vehicle 2 is in it
  EXPECT_THAT(refusal("common_frame_vehicle", 7), HasSubstr("'common_frame_vehicle' is not among"));
  EXPECT_THAT(refusal("common_frame_vehicle", 0), HasSubstr("'common_frame_vehicle' holds 0"));
  EXPECT_THAT(refusal("lost_vehicles", {3}), HasSubstr("'lost_vehicles' names a vehicle that is not among"));
  EXPECT_THAT(refusal("lost_vehicles", "none"), HasSubstr("'lost_vehicles' is no list"));
  EXPECT_EQ(refusal("lost_vehicles", {2}), "");
}

TEST_F(RunFolder, ATableWithoutARowIsRefusedUnlessItsVehicleWasLost) {
  for (const auto& [name, header] :
       {std::pair("live.csv", live_header<SE2>), std::pair("trajectory.csv", trajectory_header<SE2>),
        std::pair("traffic.csv", std::string(traffic_header))}) {
    const auto file = folder_ / "vehicle_2" / name;
    const std::string before = test::read(file);
    test::write(file, std::string(header) + "\n");
    const auto read = [this] { read_run<SE2>(folder_.path()); };
    EXPECT_THAT(config_error_of(read), HasSubstr(std::string(name) + ":1: no row below the header"));
    test::write(file, "");
    EXPECT_THAT(config_error_of(read), HasSubstr(std::string(name) + ":1: the file is empty"));
    test::write(file, std::string(header) + "\n");
    json info = json::parse(test::read(folder_ / "run.json"));
    info["lost_vehicles"] = {2};
    test::write(folder_ / "run.json", info.dump());
    EXPECT_EQ(config_error_of(read), "") << name;
    info["lost_vehicles"] = json::array();
    test::write(folder_ / "run.json", info.dump());
    test::write(file, before);
  }
}

TEST_F(RunFolder, ABrokenSummaryIsRefused) {
  const auto file = folder_ / "vehicle_2" / "summary.json";
  const json good = json::parse(test::read(file));
  const auto refusal = [&](const std::string& content) {
    test::write(file, content);
    return config_error_of([this] { read_run<SE2>(folder_.path()); });
  };
  EXPECT_EQ(refusal(good.dump()), "");
  EXPECT_THAT(refusal(""), HasSubstr("summary.json: not what it should be"));
  EXPECT_THAT(refusal(good.dump().substr(0, 40)), HasSubstr("summary.json: not what it should be"));
  EXPECT_THAT(refusal("null"), HasSubstr("summary.json: not an object"));
  EXPECT_THAT(refusal("[1]"), HasSubstr("summary.json: not an object"));
  for (const char* key :
       {"map_digest", "integrity", "facts_missing", "landmarks_exported", "landmarks_known", "bytes_sent"}) {
    json summary = good;
    summary.erase(key);
    EXPECT_THAT(refusal(summary.dump()), HasSubstr("summary.json: '" + std::string(key) + "'")) << key;
    summary[key] = -1;
    EXPECT_THAT(refusal(summary.dump()), HasSubstr("summary.json: '" + std::string(key) + "'")) << key;
  }
  json summary = good;
  summary["facts_lost"] = -1;
  EXPECT_THAT(refusal(summary.dump()), HasSubstr("summary.json: 'facts_lost' is no number from 0"));
  summary = good;
  summary["vehicle"] = 1;
  EXPECT_THAT(refusal(summary.dump()), HasSubstr("summary.json: it is that of another vehicle"));
}

TEST_F(RunFolder, ASurvivorHasLeftAllThatItMustHaveWritten) {
  const auto refusal = [this] { return config_error_of([this] { expect_survivors(read_run<SE2>(folder_.path())); }); };
  EXPECT_EQ(refusal(), "");
  const auto lost = [this](const json& ids) {
    json info = json::parse(test::read(folder_ / "run.json"));
    info["lost_vehicles"] = ids;
    test::write(folder_ / "run.json", info.dump());
  };
  for (const char* name : {"live.csv", "trajectory.csv", "traffic.csv", "labels.csv", "map.json", "summary.json"}) {
    const auto file = folder_ / "vehicle_2" / name;
    const std::string before = test::read(file);
    std::filesystem::remove(file);
    EXPECT_THAT(refusal(),
                HasSubstr("vehicle_2/" + std::string(name) + ": no such file, though vehicle 2 lived to the end"));
    lost({2});
    EXPECT_EQ(refusal(), "") << name;
    lost(json::array());
    test::write(file, before);
  }
  std::filesystem::remove_all(folder_ / "vehicle_2");
  EXPECT_THAT(refusal(), HasSubstr("vehicle_2/live.csv: no such file"));
}

TEST_F(RunFolder, OfALostVehicleMayEndInHalfALine) {
  json info = json::parse(test::read(folder_ / "run.json"));
  info["lost_vehicles"] = {2};
  test::write(folder_ / "run.json", info.dump());
  const std::string live = test::read(folder_ / "vehicle_2/live.csv");
  const std::size_t rows = read_run<SE2>(folder_.path()).find(2)->live.size();
  test::write(folder_ / "vehicle_2/live.csv", live.substr(0, live.size() - 5));
  for (const char* file : {"map.json", "summary.json", "labels.csv", "trajectory.csv"})
    std::filesystem::remove(folder_ / "vehicle_2" / file);
  const RunRecord<SE2> run = read_run<SE2>(folder_.path());
  EXPECT_EQ(run.find(2)->live.size(), rows - 1);
  EXPECT_EQ(run.first_survivor()->id, 1U);
  const json m = evaluate(run).metrics;
  EXPECT_EQ(m.at("associations").at("unjudged"), m.at("associations").at("accepted"));  // its labels died with it
}

}  // namespace
}  // namespace convoy::cli
