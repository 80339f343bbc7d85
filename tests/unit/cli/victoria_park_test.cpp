#include "scenario/victoria_park.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <convoy/config_error.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "../../support/data_folder.hpp"
#include "evaluate/truth.hpp"
#include "fake_run.hpp"

namespace convoy::cli {
namespace {

namespace fs = std::filesystem;
using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;
using testing::Not;

constexpr double begin_s = 20.0, length_s = 120.0, speed_m_s = 3.0;
constexpr double straight_rad = -0.004 / 1.04;  // what the steering sensor reads when the wheels point ahead
const Eigen::Vector2d laser_m(3.78, 0.5);
constexpr double laser_delay_s = 0.06;

Eigen::Vector2d tree(int i) { return {100.0 + 12.0 * i, i % 2 == 0 ? 6.0 : -7.0}; }

/// The truck drives eastwards for two minutes, from (100, 0) on, past trees, and meets a car.
void write_small_set(const fs::path& folder) {
  std::string odometry = "t_s,speed_mps,steering_rad\n", gps = "t_s,east_m,north_m\n";
  std::string trees = "t_s,range_m,bearing_rad,diameter_m\n";
  for (int i = 0; i <= 10 * length_s; ++i) append_csv_row(odometry, begin_s + 0.1 * i, speed_m_s, straight_rad);
  for (int i = 0; i <= 5 * length_s; ++i) {
    const double t_s = begin_s + 0.2 * i;
    const Eigen::Vector2d laser = Eigen::Vector2d(100.0 + speed_m_s * 0.2 * i, 0.0) + laser_m;
    append_csv_row(gps, t_s, laser.x(), laser.y());
    const double stamp_s = t_s + laser_delay_s;
    std::vector<Eigen::Vector2d> seen;
    for (int k = 0; k < 40; ++k) seen.push_back(tree(k));
    seen.emplace_back(250.0 - 0.6 * 0.2 * i, 15.0);
    bool any = false;
    for (const Eigen::Vector2d& p : seen)
      if (const Eigen::Vector2d d = p - laser; d.x() > 0.0 && d.norm() < 30.0) {
        append_csv_row(trees, stamp_s, d.norm(), std::atan2(d.y(), d.x()), 0.4);
        any = true;
      }
    if (!any) trees += std::to_string(stamp_s) + ",,,\n";
  }
  test::write(folder / "odometry.csv", odometry);
  test::write(folder / "gps.csv", gps);
  test::write(folder / "tree_detections.csv", trees);
}

TEST(VictoriaPark, BecomesThreeVehiclesThatDriveAtTheSameTime) {
  const TemporaryFolder folder;
  write_small_set(folder.path());
  const Scenario<SE2> scenario = load_victoria_park(folder.path(), 1);
  EXPECT_EQ(scenario.name, "victoria-park");
  EXPECT_TRUE(scenario.landmarks.empty());
  EXPECT_TRUE(scenario.pose_tolerance);
  EXPECT_EQ(scenario.common_frame_vehicle, 1U);
  ASSERT_EQ(scenario.vehicles.size(), 3U);
  for (const VehicleLog<SE2>& log : scenario.vehicles) {
    EXPECT_NEAR(log.sensors.front().t_s, 0.0, 0.11);
    EXPECT_NEAR(log.sensors.back().t_s, length_s / 3.0, 0.11);
    for (const SensorEvent& event : log.sensors) {
      if (event.kind != SensorEvent::Kind::odometry) continue;
      EXPECT_NEAR(event.v_m_s, speed_m_s, 1e-9);
      EXPECT_NEAR(event.omega_rad_s, 0.0, 1e-9);
    }
    ASSERT_FALSE(log.truth.empty());
    for (const TruthPose<SE2>& pose : log.truth) {
      const double x_m = 100.0 + speed_m_s * (length_s / 3.0 * (log.id - 1) + pose.t_s);
      EXPECT_LT((pose.T_world_body.inverse() * SE2(x_m, 0.0, 0.0)).Log().norm(), 1e-3);
    }
  }
}

TEST(VictoriaPark, DetectionsAreTakenFromTheLaserToTheAxleAndFollowed) {
  const TemporaryFolder folder;
  write_small_set(folder.path());
  std::set<int> seen;
  for (const VehicleLog<SE2>& log : load_victoria_park(folder.path(), 1).vehicles) {
    std::map<std::uint32_t, int> tree_of;
    std::map<int, std::uint32_t> track_of;
    for (const SensorEvent& event : log.sensors) {
      if (event.kind != SensorEvent::Kind::sighting) continue;
      const auto T = truth_at(log.truth, event.t_s);
      if (!T) continue;
      const Eigen::Vector2d p = *T * Eigen::Vector2d(event.range_m * std::cos(event.bearing_rad),
                                                     event.range_m * std::sin(event.bearing_rad));
      const int k = static_cast<int>(std::lround((p.x() - 100.0) / 12.0));
      EXPECT_LT((p - tree(k)).norm(), 1e-2);  // never the car
      EXPECT_EQ(tree_of.emplace(event.track, k).first->second, k);
      EXPECT_EQ(track_of.emplace(k, event.track).first->second, event.track);
      seen.insert(k);
    }
  }
  EXPECT_GT(seen.size(), 25U);
}

TEST(VictoriaPark, TheCarIsDroppedAndCounted) {
  const TemporaryFolder folder;
  write_small_set(folder.path());
  const Scenario<SE2> scenario = load_victoria_park(folder.path(), 1);
  std::uint64_t dropped = 0;
  for (const VehicleLog<SE2>& log : scenario.vehicles) dropped += log.dropped_unknown_sightings;
  EXPECT_GT(dropped, 10U);
  EXPECT_THAT(scenario.source, HasSubstr(" of what moved"));
  EXPECT_THAT(scenario.source, Not(HasSubstr(" 0 of what moved")));
}

TEST(VictoriaPark, PriorsAreOffBySeededDraws) {
  const TemporaryFolder folder;
  write_small_set(folder.path());
  const auto means = [&](std::uint64_t seed) {
    std::vector<SE2> result;
    for (const VehicleLog<SE2>& log : load_victoria_park(folder.path(), seed).vehicles) {
      const SE2::Tangent sigma = log.id == 1 ? SE2::Tangent(0.0, 0.0, 0.0) : SE2::Tangent(11.0, 11.0, 0.15);
      EXPECT_EQ(log.prior->sigma, sigma);
      result.push_back(log.prior->mean);
    }
    return result;
  };
  const std::vector<SE2> one = means(1), again = means(1), two = means(2);
  EXPECT_LT(one[0].Log().norm(), 1e-12);
  for (const std::size_t i : {1U, 2U}) {
    const SE2 start(speed_m_s * length_s / 3.0 * static_cast<double>(i), 0.0, 0.0);
    const SE2::Tangent off = (start.inverse() * one[i]).Log();
    EXPECT_GT(off.head<2>().norm(), 0.1);
    EXPECT_LT(off.head<2>().norm(), 4.0 * 11.0);
    EXPECT_LT(std::abs(off[2]), 4.0 * 0.15);
    EXPECT_EQ(one[i].translation(), again[i].translation());
    EXPECT_NE(one[i].translation(), two[i].translation());
  }
}

class DamagedVictoriaPark : public testing::TestWithParam<test::Damage> {};

TEST_P(DamagedVictoriaPark, IsRefusedWithFileAndLine) {
  const TemporaryFolder folder;
  write_small_set(folder.path());
  GetParam().apply(folder.path());
  EXPECT_THAT(config_error_of([&] { load_victoria_park(folder.path(), 1); }), HasSubstr(GetParam().refusal()));
}

INSTANTIATE_TEST_SUITE_P(
    VictoriaPark, DamagedVictoriaPark,
    testing::Values(
        test::Damage{"odometry.csv", nullptr, " no such file"}, test::Damage{"gps.csv", nullptr, " no such file"},
        test::Damage{"tree_detections.csv", nullptr, " no such file"},
        test::Damage{"odometry.csv", "t_s,speed_mps,steering_rad\n", " holds too little odometry"},
        test::Damage{"odometry.csv", "t_s,speed_mps,steering_rad\n2,1,0\n1,1,0\n", "3: time runs backwards"},
        test::Damage{"odometry.csv", "t_s,speed_mps,steering_rad\n2,1,left\n", "2: field 3 is 'left'"},
        test::Damage{"gps.csv", "t_s,east_m,north_m\n2,1,1\n1,1,1\n", "3: time runs backwards"},
        test::Damage{"odometry.csv", "t_s,speed_mps,steering_rad\n20,1,0\n59,1,0\n101,1,0\n140,1,0\n",
                     "4: no odometry from 60.00 s to 100.00 s"},
        test::Damage{"gps.csv", "t_s,east_m,north_m\n25,1,1\n70,1,1\n110,1,1\n", " says too little of vehicle 1"},
        test::Damage{"gps.csv", "t_s,east_m,north_m\n", "1: no fix from 20.00 s to 60.00 s"},
        test::Damage{"gps.csv", "t_s,east_m,north_m\n25,1,1\n26,1,1\n", "3: no fix from 60.00 s to 100.00 s"},
        test::Damage{"tree_detections.csv",
                     "t_s,range_m,bearing_rad,diameter_m\n25,2,0,1\n25,3,0,1\n70,,,\n110,2,0,1\n",
                     "5: no detection from 60.00 s to 100.00 s"},
        test::Damage{"tree_detections.csv", "t_s,range_m,bearing_rad,diameter_m\n1,-2,0,1\n",
                     "2: the range must be above 0"},
        test::Damage{"tree_detections.csv", "t_s,range_m,bearing_rad,diameter_m\n1,2,,1\n", "2: field 3 is ''"},
        test::Damage{"tree_detections.csv", "t_s,range_m,bearing_rad,diameter_m\n1,2,0",
                     "2: the last line has no line end"}));

TEST(VictoriaPark, RefusesAFolderThatIsNone) {
  const TemporaryFolder folder;
  EXPECT_THAT(config_error_of([&] { load_victoria_park(folder / "nowhere", 1); }),
              HasSubstr("nowhere: no such folder; give the folder of the Victoria Park data set"));
}

double quantile(std::vector<double> values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

TEST(VictoriaParkRecording, TracksStayInPlaceAndGpsKnowsMostOfTheWay) {
  const fs::path folder = convoy::test::data_folder() / "victoria_park";
  if (!fs::exists(folder / "odometry.csv"))
    GTEST_SKIP() << "no victoria_park; set CONVOY_DATA_DIR to the folder that holds victoria_park";
  const Scenario<SE2> scenario = load_victoria_park(folder, 1);
  ASSERT_EQ(scenario.vehicles.size(), 3U);
  for (const VehicleLog<SE2>& log : scenario.vehicles) {
    EXPECT_NEAR(log.sensors.back().t_s, scenario.duration_s, 0.1);
    EXPECT_GT(0.25 * static_cast<double>(log.truth.size()), 0.6 * scenario.duration_s);
    std::map<std::uint32_t, std::vector<Eigen::Vector2d>> places;  // by the reference, of which tracks know nothing
    std::size_t kept = 0;
    for (const SensorEvent& event : log.sensors) {
      if (event.kind != SensorEvent::Kind::sighting) continue;
      ++kept;
      if (const auto T = truth_at(log.truth, event.t_s))
        places[event.track].push_back(*T * Eigen::Vector2d(event.range_m * std::cos(event.bearing_rad),
                                                           event.range_m * std::sin(event.bearing_rad)));
    }
    EXPECT_GT(kept, 2 * log.dropped_unknown_sightings);
    std::vector<double> scatter_m;
    for (const auto& [track, seen] : places) {
      Eigen::Vector2d mean = Eigen::Vector2d::Zero();
      for (const Eigen::Vector2d& p : seen) mean += p / static_cast<double>(seen.size());
      for (const Eigen::Vector2d& p : seen) scatter_m.push_back((p - mean).norm());
    }
    EXPECT_LT(quantile(scatter_m, 0.5), 0.25);
    EXPECT_LT(quantile(scatter_m, 0.9), 0.7);
  }
}

}  // namespace
}  // namespace convoy::cli
