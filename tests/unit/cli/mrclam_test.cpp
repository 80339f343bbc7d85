#include "scenario/mrclam.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <convoy/config_error.hpp>

#include "../../support/data_folder.hpp"
#include "evaluate/truth.hpp"
#include "fake_run.hpp"

namespace convoy::cli {
namespace {

namespace fs = std::filesystem;
using test::config_error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

/// Two robots, three landmarks, hand-made.
void write_small_set(const fs::path& folder) {
  test::write(folder / "Barcodes.dat", "# subject barcode\n1 5\n2 14\n6 72\n7 25\n8 90\n");
  test::write(folder / "Landmark_Groundtruth.dat", "6 1.0 2.0 0.001 0.001\n7 3 4 0 0\n8 5 6 0 0\n");
  test::write(folder / "Robot1_Odometry.dat", "1000.5 0.1 0.0\n1000.7 0.1 0.2\n1000.6 0.3 0.0\n");
  test::write(folder / "Robot1_Measurement.dat", "1000.6 72 2.5 0.1\n1000.6 14 1.0 0.0\n1000.65 33 1.0 0.0\n");
  test::write(folder / "Robot1_Groundtruth.dat", "999.0 1 1 0.5\n1001.0 2 1 0.5\n");
  test::write(folder / "Robot2_Odometry.dat", "1000.25 0.2 0.0\n");
  test::write(folder / "Robot2_Measurement.dat", "1000.0 25 1.0 0.0\n1000.3 25 1.0 0.0\n");
}

TEST(Mrclam, LoadsAndCountsWhatItDrops) {
  const TemporaryFolder folder;
  write_small_set(folder.path());
  const Scenario<SE2> scenario = load_mrclam(folder.path());
  ASSERT_EQ(scenario.vehicles.size(), 2U);
  const VehicleLog<SE2>& one = scenario.vehicles[0];
  // Time zero is the first odometry of all robots (1000.25); at equal times odometry comes first; stamps are sorted.
  const std::vector<SensorEvent> expected{SensorEvent::odometry(0.25, 0.1, 0.0), SensorEvent::odometry(0.35, 0.3, 0.0),
                                          SensorEvent::sighting(0.35, 6, 2.5, 0.1),
                                          SensorEvent::encounter(0.35, 2, 1.0, 0.0),
                                          SensorEvent::odometry(0.45, 0.1, 0.2)};
  EXPECT_EQ(one.sensors, expected);
  EXPECT_EQ(one.dropped_unknown_sightings, 1U);
  EXPECT_EQ(one.truth.front().t_s, -1.25);
  EXPECT_FALSE(one.prior);
  const VehicleLog<SE2>& two = scenario.vehicles[1];
  EXPECT_TRUE(two.truth.empty());
  EXPECT_EQ(two.sensors.size(), 2U);  // the sighting before time zero is left out
  EXPECT_EQ(scenario.landmarks.size(), 3U);
  EXPECT_EQ(scenario.duration_s, 0.45);
  EXPECT_EQ(scenario.common_frame_vehicle, 1U);
}

class DamagedMrclam : public testing::TestWithParam<test::Damage> {};

TEST_P(DamagedMrclam, IsRefusedWithFileAndLine) {
  const TemporaryFolder folder;
  write_small_set(folder.path());
  GetParam().apply(folder.path());
  EXPECT_THAT(config_error_of([&] { load_mrclam(folder.path()); }), HasSubstr(GetParam().refusal()));
}

INSTANTIATE_TEST_SUITE_P(
    Mrclam, DamagedMrclam,
    testing::Values(
        test::Damage{"Landmark_Groundtruth.dat", nullptr, " no such file"},
        test::Damage{"Robot1_Measurement.dat", nullptr, " no such file"},
        test::Damage{"Barcodes.dat", "1 5\n2 5\n", "2: this barcode is given twice"},
        test::Damage{"Barcodes.dat", "21 5\n", "1: the subject must be 1 to 20"},
        test::Damage{"Landmark_Groundtruth.dat", "5 1 2 0 0\n", "1: the subject of a landmark must be 6 to 20"},
        test::Damage{"Robot1_Odometry.dat", "1000.5 0.1 0.0\n1000.6 0.", "2: the last line has no line end"},
        test::Damage{"Robot1_Odometry.dat", "1000.5 0.1 0.0\n1000.6 0.1\n", "2: the line has 2 fields"},
        test::Damage{"Robot1_Odometry.dat", "1000.5 0.1 fast\n", "1: field 3 is 'fast'"},
        test::Damage{"Robot1_Odometry.dat", "1000.5 0.1 0\n990 0.1 0\n", "2: time steps back by 10.5"},
        test::Damage{"Robot1_Odometry.dat", "# nothing\n", " holds no odometry"},
        test::Damage{"Robot1_Measurement.dat", "1000.6 72 -1 0.1\n", "1: the range must be above 0"},
        test::Damage{"Robot1_Groundtruth.dat", "1000 1 1 nan\n", "1: field 4 is 'nan'"}));

TEST(Mrclam, RefusesAFolderThatIsNone) {
  const TemporaryFolder folder;
  EXPECT_THAT(config_error_of([&] { load_mrclam(folder / "nowhere"); }), HasSubstr("nowhere: no such folder"));
  EXPECT_THAT(config_error_of([&] { load_mrclam(folder.path()); }),
              HasSubstr(folder.path().string() + ": holds no Barcodes.dat; give the folder of one MR.CLAM data set"));
  test::write(folder / "Barcodes.dat", "1 5\n");
  test::write(folder / "Landmark_Groundtruth.dat", "6 1 2 0 0\n");
  EXPECT_THAT(config_error_of([&] { load_mrclam(folder.path()); }), HasSubstr("holds no RobotN_Odometry.dat"));
}

/// The real recordings, in utias_mrclam of the data folder.
std::optional<fs::path> recorded(const char* set) {
  const fs::path root = convoy::test::data_folder() / "utias_mrclam" / set;
  return fs::exists(root / "Barcodes.dat") ? std::optional(root) : std::nullopt;
}

TEST(MrclamRecording, WithPoseTruthIsLoadedWhole) {
  const auto folder = recorded("ds6");
  if (!folder) GTEST_SKIP() << "no utias_mrclam/ds6; set CONVOY_DATA_DIR to the folder that holds utias_mrclam";
  const Scenario<SE2> scenario = load_mrclam(*folder);
  ASSERT_EQ(scenario.vehicles.size(), 5U);
  EXPECT_EQ(scenario.landmarks.size(), 15U);
  EXPECT_NEAR(scenario.duration_s, 888.0, 1.0);
  std::size_t sightings = 0;
  std::uint64_t dropped = 0;
  std::map<std::uint32_t, Eigen::Vector2d> place;
  for (const TruthLandmark<SE2>& l : scenario.landmarks) place[l.id] = l.p_world_m;
  std::vector<double> range_errors;
  for (const VehicleLog<SE2>& log : scenario.vehicles) {
    dropped += log.dropped_unknown_sightings;
    EXPECT_FALSE(log.truth.empty());
    for (const SensorEvent& event : log.sensors) {
      sightings += event.kind == SensorEvent::Kind::sighting || event.kind == SensorEvent::Kind::encounter;
      if (event.kind != SensorEvent::Kind::sighting) continue;
      if (const auto T = truth_at(log.truth, event.t_s))
        range_errors.push_back(std::abs(event.range_m - (place.at(event.track) - T->translation()).norm()));
    }
  }
  EXPECT_EQ(sightings + dropped, 19377U);  // every line of the five measurement files
  // Subjects, times and truth belong together: the ranges agree with the truth.
  std::nth_element(range_errors.begin(), range_errors.begin() + std::ptrdiff_t(range_errors.size() / 2),
                   range_errors.end());
  EXPECT_LT(range_errors[range_errors.size() / 2], 0.12);
}

TEST(MrclamRecording, WithoutPoseTruthIsLoadedToo) {
  const auto folder = recorded("ds1");
  if (!folder) GTEST_SKIP() << "no utias_mrclam/ds1; set CONVOY_DATA_DIR to the folder that holds utias_mrclam";
  const Scenario<SE2> scenario = load_mrclam(*folder);
  ASSERT_EQ(scenario.vehicles.size(), 5U);
  for (const VehicleLog<SE2>& log : scenario.vehicles) {
    EXPECT_TRUE(log.truth.empty());
    EXPECT_TRUE(std::is_sorted(log.sensors.begin(), log.sensors.end(),
                               [](const auto& a, const auto& b) { return a.t_s < b.t_s; }));
  }
}

}  // namespace
}  // namespace convoy::cli
