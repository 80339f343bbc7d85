#include "scenario/scenario.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <convoy/config_error.hpp>

#include "fake_run.hpp"
#include "scenario/street.hpp"

namespace convoy::cli {
namespace {

using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

Scenario<SE2> short_street() {
  StreetParams params;
  params.distance_m = 20.0;
  return make_street<SE2>(params, 3);
}

TEST(Scenario, SurvivesTheDiskToTheBit) {
  const TemporaryFolder folder;
  const Scenario<SE2> written = short_street();
  written.write(folder.path());
  const Scenario<SE2> read = Scenario<SE2>::read(folder.path());
  EXPECT_EQ(read.name, written.name);
  EXPECT_EQ(read.source, written.source);
  EXPECT_EQ(read.seed, written.seed);
  EXPECT_EQ(read.duration_s, written.duration_s);
  EXPECT_EQ(read.common_frame_vehicle, written.common_frame_vehicle);
  ASSERT_EQ(read.vehicles.size(), written.vehicles.size());
  for (std::size_t i = 0; i < read.vehicles.size(); ++i) {
    EXPECT_EQ(read.vehicles[i].id, written.vehicles[i].id);
    EXPECT_EQ(read.vehicles[i].sensors, written.vehicles[i].sensors);
    ASSERT_EQ(read.vehicles[i].truth.size(), written.vehicles[i].truth.size());
    EXPECT_EQ(read.vehicles[i].truth.back().T_world_body.translation(),
              written.vehicles[i].truth.back().T_world_body.translation());
    ASSERT_TRUE(read.vehicles[i].prior);
    EXPECT_EQ(read.vehicles[i].prior->sigma[0], written.vehicles[i].prior->sigma[0]);
    EXPECT_EQ(read.vehicles[i].prior->sigma[2], written.vehicles[i].prior->sigma[2]);
  }
  ASSERT_EQ(read.landmarks.size(), written.landmarks.size());
  EXPECT_EQ(read.landmarks.back().p_world_m, written.landmarks.back().p_world_m);
}

TEST(Scenario, WithoutTruthHasNoTruthFile) {
  const TemporaryFolder folder;
  Scenario<SE2> scenario = short_street();
  for (VehicleLog<SE2>& vehicle : scenario.vehicles) vehicle.truth.clear();
  scenario.write(folder.path());
  EXPECT_FALSE(std::filesystem::exists(truth_file(folder.path(), 1)));
  EXPECT_TRUE(Scenario<SE2>::read(folder.path()).vehicles[0].truth.empty());
}

TEST(Scenario, HowCoarseItsPosesAreSurvivesTheDisk) {
  const TemporaryFolder folder;
  Scenario<SE2> scenario = short_street();
  scenario.write(folder.path());
  EXPECT_FALSE(Scenario<SE2>::read(folder.path()).pose_tolerance);
  scenario.pose_tolerance = PoseTolerance{6.0, 0.25};
  scenario.write(folder.path());
  const auto tolerance = Scenario<SE2>::read(folder.path()).pose_tolerance;
  ASSERT_TRUE(tolerance);
  EXPECT_EQ(tolerance->position_m, 6.0);
  EXPECT_EQ(tolerance->heading_rad, 0.25);
}

TEST(Scenario, FixesSurviveTheDiskToTheBit) {
  const TemporaryFolder folder;
  const std::vector<SensorEvent> written{
      SensorEvent::odometry(0.0, 1.0, 0.0), SensorEvent::fix(0.1, 1.0 / 3.0, -2e5, 0.02),
      SensorEvent::encounter(0.1, 4, 7.0 / 3.0, -0.2), SensorEvent::sighting(0.1, 7, 3.0, 0.1)};
  write_sensors<SE2>(folder / "s.csv", written);
  EXPECT_EQ(read_sensors<SE2>(folder / "s.csv"), written);
}

TEST(Scenario, RefusesADamagedFolder) {
  const TemporaryFolder folder;
  EXPECT_THAT(config_error_of([&] { Scenario<SE2>::read(folder.path()); }), HasSubstr("scenario.json: no such file"));
  short_street().write(folder.path());
  const std::string json = test::read(folder / "scenario.json");
  test::write(folder / "scenario.json", json.substr(0, json.size() / 2));
  EXPECT_THAT(config_error_of([&] { Scenario<SE2>::read(folder.path()); }), HasSubstr("scenario.json: not a scenario"));
  test::write(folder / "scenario.json", json);
  const std::string sensors = test::read(folder / "vehicle_1/sensors.csv");
  test::write(folder / "vehicle_1/sensors.csv", sensors.substr(0, sensors.size() - 3));
  EXPECT_THAT(config_error_of([&] { Scenario<SE2>::read(folder.path()); }), HasSubstr("the file has been cut"));
}

struct BadSensors {
  const char* rows;
  const char* message;
};

class BadSensorFiles : public testing::TestWithParam<BadSensors> {};

TEST_P(BadSensorFiles, AreRefusedWithFileAndLine) {
  const TemporaryFolder folder;
  test::write(folder / "s.csv", std::string("t_s,kind,a,b,c\n1,odometry,2,0,\n") + GetParam().rows);
  EXPECT_THAT(config_error_of([&] { read_sensors<SE2>(folder / "s.csv"); }), HasSubstr(GetParam().message));
}

INSTANTIATE_TEST_SUITE_P(
    Scenario, BadSensorFiles,
    testing::Values(BadSensors{"0.5,odometry,2,0,\n", "s.csv:3: time runs backwards"},
                    BadSensors{"2,gyro,2,0,\n", "s.csv:3: the kind is 'gyro'"},
                    BadSensors{"2,odometry,2,0,1\n", "s.csv:3: an odometry row has no fifth field"},
                    BadSensors{"2,sighting,1.5,3,0\n", "s.csv:3: field 3 is '1.5'; it must be a whole number"},
                    BadSensors{"2,sighting,4294967296,3,0\n", "s.csv:3: field 3 is beyond"},
                    BadSensors{"2,sighting,7,0,0\n", "s.csv:3: the range of a sighting must be above 0"},
                    BadSensors{"2,fix,7,3,0\n", "s.csv:3: the sigma of a fix must be above 0"},
                    BadSensors{"2,fix,7,3,-1\n", "s.csv:3: the sigma of a fix must be above 0"},
                    BadSensors{"2,encounter,0,7,0\n", "s.csv:3: vehicle ids are 1 or more"},
                    BadSensors{"2,encounter,3,0,0\n", "s.csv:3: the range of an encounter must be above 0"},
                    BadSensors{"2,fix,7,nan,1\n", "s.csv:3: field 4"}, BadSensors{"2,fix,7,3,\n", "s.csv:3: field 5"},
                    BadSensors{"2,sighting,7,3\n", "s.csv:3: the line has 4 fields"}));

}  // namespace
}  // namespace convoy::cli
