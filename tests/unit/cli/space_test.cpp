// A run in space through the same code: the street, its files, the judge and the report.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tinyxml2.h>
#include <convoy/config_error.hpp>
#include <convoy/geometry/polar.hpp>

#include "calibrate.hpp"
#include "evaluate/evaluate.hpp"
#include "fake_run.hpp"
#include "report/report.hpp"
#include "scenario/street.hpp"

namespace convoy::cli {
namespace {

using nlohmann::json;
using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;
using testing::Not;

constexpr std::uint64_t seed = 11;

Scenario<SE3> short_street() {
  StreetParams params;
  params.distance_m = 120.0;
  return make_street<SE3>(params, 5);
}

// ---- the street ----

TEST(StreetInSpace, IsThePlanarOneSeenFromAbove) {
  const Scenario<SE3> space = make_street<SE3>({}, seed);
  const Scenario<SE2> plane = make_street<SE2>({}, seed);
  for (std::size_t v = 0; v < 2; ++v) {
    ASSERT_EQ(space.vehicles[v].truth.size(), plane.vehicles[v].truth.size());
    for (std::size_t i = 0; i < plane.vehicles[v].truth.size(); ++i)
      ASSERT_EQ(Eigen::Vector2d(space.vehicles[v].truth[i].T_world_body.translation().head<2>()),
                plane.vehicles[v].truth[i].T_world_body.translation());
  }
  EXPECT_EQ(space.vehicles[0].truth.front().T_world_body.Log(), SE3().Log());  // world = common frame
}

TEST(StreetInSpace, ClimbsAndFallsAndVehiclesFollowIt) {
  const StreetParams params;
  const Scenario<SE3> scenario = make_street<SE3>(params, seed);
  for (const VehicleLog<SE3>& log : scenario.vehicles) {
    double steepest = 0.0, lowest = 1e9, highest = -1e9;
    for (std::size_t i = 1; i < log.truth.size(); ++i) {
      const SE3 &before = log.truth[i - 1].T_world_body, &T = log.truth[i].T_world_body;
      const Eigen::Vector3d moved = before.inverse() * T.translation();
      if (moved.norm() > 0.01) {
        EXPECT_LT(std::abs(moved.z()), 1e-3 * moved.norm());  // along its own x axis
        EXPECT_GT(moved.x(), 0.0);
      }
      EXPECT_NEAR(T.rotation()(2, 1), 0.0, 1e-12);  // it does not lean
      steepest = std::max(steepest, std::abs(T.rotation()(2, 0)));
      lowest = std::min(lowest, T.translation().z());
      highest = std::max(highest, T.translation().z());
    }
    EXPECT_NEAR(steepest, params.max_grade, 1e-3);
    EXPECT_GT(highest - lowest, 3.0);
  }
}

TEST(StreetInSpace, SensorsErrAsDocumented) {
  const StreetParams params;
  const Scenario<SE3> scenario = make_street<SE3>(params, seed);
  std::map<std::uint32_t, Eigen::Vector3d> place;
  for (const TruthLandmark<SE3>& l : scenario.landmarks) place[l.id] = l.p_world_m;
  for (const VehicleLog<SE3>& log : scenario.vehicles) {
    Eigen::Array3d squares = Eigen::Array3d::Zero();
    double speed = 0.0, yaw = 0.0;
    int sightings = 0, readings = 0;
    for (const SensorEvent& e : log.sensors) {
      const auto T = truth_at(log.truth, e.t_s);
      ASSERT_TRUE(T);
      if (e.kind == SensorEvent::Kind::sighting) {
        const Eigen::Vector3d polar = polar_of(Eigen::Vector3d(T->inverse() * place.at(e.track)));
        const Eigen::Array3d sigma(params.range_sigma_m + params.range_sigma_share * polar[0], params.bearing_sigma_rad,
                                   params.elevation_sigma_rad);
        squares += (polar_difference<3>(e.polar<SE3>(), polar).array() / sigma).square();
        ++sightings;
      } else if (const auto next = truth_at(log.truth, e.t_s + 0.05)) {
        const auto moved = (T->inverse() * *next).Log();
        speed += std::pow((e.v_m_s - moved[0] / 0.05) / params.speed_sigma_m_s, 2);
        yaw += std::pow((e.omega_rad_s - moved[5] / 0.05) / (params.yaw_rate_density_rad_sqrt_s * std::sqrt(20.0)), 2);
        ++readings;
      }
    }
    EXPECT_GT(sightings, 8000);
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(squares[i] / sightings, 1.0, 0.06) << i;
    EXPECT_NEAR(speed / readings, 1.0, 0.25);  // the scale error adds to it
    EXPECT_NEAR(yaw / readings, 1.0, 0.1);
  }
  double lowest = 1e9, highest = -1e9;
  for (const TruthLandmark<SE3>& l : scenario.landmarks) {
    lowest = std::min(lowest, l.p_world_m.z());
    highest = std::max(highest, l.p_world_m.z());
  }
  EXPECT_GE(lowest, 0.0);  // 0 to 8 m above a road that climbs by 3.4 m
  EXPECT_LE(highest, params.landmark_height_m + 3.5);
  EXPECT_GT(highest - lowest, params.landmark_height_m);
}

// ---- its files ----

TEST(ScenarioInSpace, SurvivesTheDiskToTheBit) {
  const TemporaryFolder folder;
  const Scenario<SE3> written = short_street();
  written.write(folder.path());
  const Scenario<SE3> read = Scenario<SE3>::read(folder.path());
  for (std::size_t v = 0; v < 2; ++v) {
    EXPECT_EQ(read.vehicles[v].sensors, written.vehicles[v].sensors);
    ASSERT_EQ(read.vehicles[v].truth.size(), written.vehicles[v].truth.size());
    for (std::size_t i = 0; i < read.vehicles[v].truth.size(); ++i)
      ASSERT_EQ(coordinates_of(read.vehicles[v].truth[i].T_world_body),
                coordinates_of(written.vehicles[v].truth[i].T_world_body));
    EXPECT_EQ(read.vehicles[v].prior->sigma, written.vehicles[v].prior->sigma);
  }
  EXPECT_EQ(read.landmarks.back().p_world_m, written.landmarks.back().p_world_m);
  EXPECT_THAT(config_error_of([&] { Scenario<SE2>::read(folder.path()); }), HasSubstr("of the other dimension"));
}

TEST(ScenarioInSpace, EveryKindOfReadingSurvivesTheDisk) {
  const TemporaryFolder folder;
  const std::vector<SensorEvent> written{
      SensorEvent::odometry(0.0, 1.0, 0.1), SensorEvent::fix(0.1, 1.0 / 3.0, -2e5, 0.02, 7.5),
      SensorEvent::encounter(0.1, 4, 7.0 / 3.0, -0.2, 0.3), SensorEvent::sighting(0.1, 7, 3.0, 0.1, -0.4)};
  write_sensors<SE3>(folder / "s.csv", written);
  EXPECT_EQ(read_sensors<SE3>(folder / "s.csv"), written);
  EXPECT_THAT(config_error_of([&] { read_sensors<SE2>(folder / "s.csv"); }),
              HasSubstr("s.csv:1: the first line is 't_s,kind,a,b,c,d'; it must be 't_s,kind,a,b,c'"));
}

TEST(ScenarioInSpace, BadRowsAreRefusedWithFileAndLine) {
  const TemporaryFolder folder;
  const auto refusal = [&](const std::string& row) {
    test::write(folder / "s.csv", "t_s,kind,a,b,c,d\n1,odometry,2,0,,\n" + row + "\n");
    return config_error_of([&] { read_sensors<SE3>(folder / "s.csv"); });
  };
  EXPECT_EQ(refusal("2,sighting,7,3,0.1,0.2"), "");
  EXPECT_THAT(refusal("2,sighting,7,3,0.1,1.6"), HasSubstr("s.csv:3: an elevation lies within +-pi/2"));
  EXPECT_THAT(refusal("2,sighting,7,3,0.1,"), HasSubstr("s.csv:3: field 6 is ''; it must be a finite number"));
  EXPECT_THAT(refusal("2,sighting,7,3,0.1"), HasSubstr("s.csv:3: the line has 5 fields; 6 are needed"));
  EXPECT_THAT(refusal("2,odometry,1,0,,1"), HasSubstr("s.csv:3: an odometry row has no sixth field"));
  EXPECT_THAT(refusal("2,fix,1,2,3,0"), HasSubstr("s.csv:3: the sigma of a fix must be above 0"));
  EXPECT_THAT(refusal("2,encounter,0,3,0.1,0.1"), HasSubstr("s.csv:3: vehicle ids are 1 or more"));
  test::write(folder / "t.csv", "t_s,x_m,y_m,z_m,qw,qx,qy,qz\n1,0,0,0,1,0,0,0.1\n");
  EXPECT_THAT(config_error_of([&] { read_truth<SE3>(folder / "t.csv"); }),
              HasSubstr("t.csv:2: (qw, qx, qy, qz) is no rotation: its length must be 1"));
}

// ---- the judge ----

TEST(FitRigidInSpace, RecoversAKnownMotionAndNoneOfPointsOnALine) {
  const SE3 T = SE3::Exp((SE3::Tangent() << 3.0, -2.0, 1.0, 0.4, -1.1, 2.0).finished());
  std::vector<Eigen::Vector3d> from, to, line;
  const CounterRng rng(1, 0, 0);
  for (std::uint32_t i = 0; i < 50; ++i) {
    from.emplace_back(10.0 * rng.normal(i, 0), rng.normal(i, 1), 0.1 * rng.normal(i, 2));
    to.push_back(T * from.back());
    line.emplace_back(i, 2.0 * i, 0.0);
  }
  const auto fit = fit_rigid<SE3>(from, to);
  ASSERT_TRUE(fit);
  EXPECT_LT((fit->T_to_from.inverse() * T).Log().norm(), 1e-12);
  EXPECT_LT(fit->rmse_m, 1e-12);
  EXPECT_FALSE(fit_rigid<SE3>(line, line));
  EXPECT_FALSE(fit_rigid<SE3>({{1.0, 2.0, 3.0}}, {{1.0, 2.0, 3.0}}));
}

TEST(TumInSpace, HasTimePositionAndQuaternion) {
  std::vector<PoseRow<SE3>> rows(2);
  const SE3 T({1.0, 0.0, 0.0, 1.0}, {1.0, -2.0, 3.0});
  rows[0] = {1.5, 1, 0.0, {}, PoseEstimate<SE3>{T, SE3::Covariance::Zero()}};
  EXPECT_EQ(tum_trajectory(rows),
            "1.500000 1.000000 -2.000000 3.000000 0.000000000 0.000000000 0.707106781 0.707106781\n");
}

class RunFolderInSpace : public testing::Test {
 protected:
  void SetUp() override { test::FakeRun<SE3>(short_street(), folder_.path()).write_all(); }
  TemporaryFolder folder_;
};

TEST_F(RunFolderInSpace, IsReadJudgedAndWritten) {
  ASSERT_EQ(run_dimension(folder_.path()), 3);
  const RunRecord<SE3> run = read_run<SE3>(folder_.path());
  write_evaluation(run, evaluate(run));
  const json m = json::parse(test::read(folder_ / "metrics.json"));
  EXPECT_EQ(m.at("dimension"), 3);
  EXPECT_LT(m.at("fleet_ate_m").get<double>(), 0.25);
  EXPECT_LT(m.at("landmark_rmse_m").get<double>(), 0.25);
  EXPECT_GT(m.at("pairs")[0].at("distance_rmse_raw_m").get<double>(), 3.0);
  EXPECT_LT(m.at("pairs")[0].at("distance_rmse_m").get<double>(), 0.3);
  EXPECT_EQ(m.at("associations").at("false"), 0);
  EXPECT_EQ(m.at("all_aligned"), true);
  EXPECT_LT(m.at("fleet_trajectory_anees").get<double>(), 1.0);  // stated covariances are 1.3 times those drawn from
  EXPECT_TRUE(m.at("vehicles")[0].at("truth_mount_heading_rad").is_null());
  EXPECT_FALSE(test::read(folder_ / "vehicle_1.tum").empty());
}

TEST_F(RunFolderInSpace, NeesHasSixDegreesOfFreedom) {
  RunRecord<SE3> run = read_run<SE3>(folder_.path());
  VehicleRecord<SE3>& vehicle = run.vehicles[0];
  vehicle.live.clear();
  SE3::Covariance P = SE3::Covariance::Identity();
  P(2, 2) = 0.04;
  for (const TruthPose<SE3>& pose : vehicle.truth) {  // off by 3 sigma in height alone
    const SE3 T = *truth_at(vehicle.truth, 0.0);
    const SE3 up = SE3::Exp(0.6 * SE3::Tangent::Unit(2));
    vehicle.live.push_back({pose.t_s, 1, 0.0, {}, PoseEstimate<SE3>{T.inverse() * pose.T_world_body * up, P}});
  }
  const json m = evaluate(run).metrics.at("vehicles")[0];
  EXPECT_NEAR(m.at("pose_anees").get<double>(), 9.0 / 6.0, 1e-9);
  EXPECT_EQ(m.at("pose_coverage95"), 1.0);  // chi2(0.95, 6) is 12.6, chi2(0.95, 3) would be 7.8
}

TEST_F(RunFolderInSpace, DistancesAreOfThreeDimensions) {
  RunRecord<SE3> run = read_run<SE3>(folder_.path());
  for (PoseRow<SE3>& row : run.vehicles[1].trajectory)  // lifted far: another distance
    row.common->T = SE3({1.0, 0.0, 0.0, 0.0}, {0.0, 0.0, 50.0}) * row.common->T;
  EXPECT_GT(evaluate(run).metrics.at("pairs")[0].at("distance_rmse_corrected_m").get<double>(), 25.0);
}

TEST_F(RunFolderInSpace, IsRefusedWhereItIsOfAnotherDimensionOrDamaged) {
  EXPECT_THAT(config_error_of([&] { read_run<SE2>(folder_.path()); }),
              HasSubstr("run.json: this run is of the other dimension"));
  json info = json::parse(test::read(folder_ / "run.json"));
  info["dimension"] = 4;
  test::write(folder_ / "run.json", info.dump());
  EXPECT_THAT(config_error_of([&] { run_dimension(folder_.path()); }),
              HasSubstr("run.json: 'dimension' is 4; a fleet is of dimension 2 or 3"));
  info["dimension"] = 3;
  test::write(folder_ / "run.json", info.dump());
  json map = json::parse(test::read(folder_ / "vehicle_1/map.json"));
  map["anchors"][0]["pose"][3] = 0.5;
  test::write(folder_ / "vehicle_1/map.json", map.dump());
  EXPECT_THAT(config_error_of([&] { read_run<SE3>(folder_.path()); }),
              HasSubstr("map.json: not what it should be: it holds a pose whose quaternion is not of length 1"));
}

TEST_F(RunFolderInSpace, IsNoneToCalibrateBy) {
  CalibrateOptions options;
  options.runs = {folder_.path()};
  options.drift_of_config = [](const auto&) { return DriftParams<SE2>{}; };
  EXPECT_THAT(config_error_of([&] { calibrate(options); }),
              HasSubstr("a run in space; calibrate learns from planar runs only"));
}

// ---- the report ----

TEST_F(RunFolderInSpace, TheReportShowsItFromAboveAndItsHeights) {
  const RunRecord<SE3> run = read_run<SE3>(folder_.path());
  const std::string page = make_report(run, evaluate(run));
  tinyxml2::XMLDocument document;
  ASSERT_EQ(document.Parse(page.c_str()), tinyxml2::XML_SUCCESS) << document.ErrorStr();
  for (int figure = 9; figure <= 14; ++figure)
    EXPECT_THAT(page, HasSubstr("(paper, Fig. " + std::to_string(figure) + ")"));
  for (const char* text : {"<h2>Heights</h2>", "Seen from above.", "height [m]", "distance driven [m]", "<polygon",
                           "6 degrees of freedom", "true heights lie within its band"})
    EXPECT_THAT(page, HasSubstr(text));
  EXPECT_THAT(page, Not(HasSubstr("nan")));
}

}  // namespace
}  // namespace convoy::cli
