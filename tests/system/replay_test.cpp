// convoy replay: recordings of the simulator, of KITTI's vehicle, and images alone.
#include <gtest/gtest.h>

#include <unistd.h>

#include <fstream>

#include "../support/data_folder.hpp"
#include "command.hpp"

namespace convoy::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

json front_end(const fs::path& run) { return read_json(run / "metrics.json").at("front_end"); }

/// Without what differs from run to run: the time that it took.
json without_times(json front_end) {
  for (const char* key : {"ms_p50", "ms_p95", "ms_max"}) front_end.erase(key);
  return front_end;
}

std::size_t pictures_in(const fs::path& run) {
  std::size_t count = 0;
  for (const auto& entry : fs::directory_iterator(run / "frames")) count += entry.path().extension() == ".png";
  return count;
}

void expect_refusal(const std::string& arguments, const std::string& words) {
  const Outcome outcome = run_convoy(arguments);
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find(words), std::string::npos) << outcome.output;
}

#ifdef CONVOY_HAS_SIMULATOR

/// Fifteen seconds through the simulator's district, at 4 m/s: one recording for all tests.
class SimulatedDrive : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    scratch_ = std::make_unique<ScratchFolder>();
    const Outcome outcome = run_convoy("sim --duration 15 --speed 4 --lock-step --wait-for 0 --domain-sensors " +
                                       std::to_string(5 + getpid() % 7) + " --domain-truth " +
                                       std::to_string(12 + getpid() % 7) + " --record " + (*scratch_ / "drive").string());
    ASSERT_EQ(outcome.status, 0) << outcome.output;
  }
  static void TearDownTestSuite() { scratch_.reset(); }
  static fs::path recording() { return *scratch_ / "drive/vehicle_1"; }
  static std::string replay(const fs::path& out) {
    return "replay --dataset images " + recording().string() + " --out " + out.string();
  }
  static std::unique_ptr<ScratchFolder> scratch_;
};
std::unique_ptr<ScratchFolder> SimulatedDrive::scratch_;

TEST_F(SimulatedDrive, IsMappedAndJudged) {
  const ScratchFolder scratch;
  const Outcome outcome = run_convoy(replay(scratch / "run"));
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json m = front_end(scratch / "run");
  std::printf("%s\n", m.dump().c_str());
  EXPECT_GE(m.at("frames"), 140);
  EXPECT_GE(m.at("tracked_p50"), 30);
  EXPECT_GE(m.at("exports_per_100m"), 50.0);
  EXPECT_LE(m.at("drift_percent"), 2.0);
  EXPECT_LT(m.at("drift_percent"), m.at("odometry_drift_percent").get<double>() + 1.0);
  EXPECT_EQ(m.at("lost_epochs"), 0);
  EXPECT_GT(m.at("ms_p95"), 0.0);
  EXPECT_GE(pictures_in(scratch / "run"), 4U);
  const std::string page = read_text(scratch / "run/report.html");
  for (const char* words : {"<h2>Front end</h2>", "drift at the end", "frames/000000.png"})
    EXPECT_NE(page.find(words), std::string::npos) << words;
  for (const char* name : {"vehicle_1.tum", "vehicle_1/facts.jsonl", "vehicle_1/trajectory.csv", "vehicle_1/map.json",
                           "vehicle_1/live.csv", "vehicle_1/front_end.csv"})
    EXPECT_GT(fs::file_size(scratch / "run" / name), 100U) << name;
  const json vehicle = read_json(scratch / "run/metrics.json").at("vehicles").at(0);
  EXPECT_GE(vehicle.at("landmarks_exported"), 20);
  EXPECT_EQ(vehicle.at("integrity"), "OK");
}

TEST_F(SimulatedDrive, IsTheSameToTheBitEachTimeAndIsJudgedAgainAsBefore) {
  const ScratchFolder scratch;
  for (const char* run : {"one", "two"}) ASSERT_EQ(run_convoy(replay(scratch / run)).status, 0);
  for (const char* name : {"vehicle_1.tum", "vehicle_1/facts.jsonl", "vehicle_1/trajectory.csv"})
    EXPECT_EQ(read_text(scratch / "one" / name), read_text(scratch / "two" / name)) << name;
  EXPECT_EQ(without_times(front_end(scratch / "one")), without_times(front_end(scratch / "two")));
  const json before = front_end(scratch / "one");
  const Outcome again = run_convoy("evaluate " + (scratch / "one").string());
  ASSERT_EQ(again.status, 0) << again.output;
  EXPECT_EQ(front_end(scratch / "one"), before);
}

TEST_F(SimulatedDrive, BeginsAnewWithANewEpochWhereItIsLost) {
  const ScratchFolder scratch;
  const fs::path blind = scratch / "blind";
  fs::create_directories(blind / "images");
  for (const char* name : {"camera.yaml", "frames.csv", "odometry.csv", "truth.csv"})
    fs::copy(recording() / name, blind / name);
  // From the middle on, every second image is another one of long ago: nothing that is found agrees.
  std::vector<fs::path> images;
  for (const auto& entry : fs::directory_iterator(recording() / "images")) images.push_back(entry.path());
  std::sort(images.begin(), images.end());
  for (std::size_t i = 0; i < images.size(); ++i) {
    const std::size_t shown = i < 60 || i > 110 ? i : i - 60 + 2 * (i % 7);
    fs::copy(images[shown], blind / "images" / images[i].filename());
  }
  const Outcome outcome =
      run_convoy("replay --dataset images " + blind.string() + " --out " + (scratch / "run").string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_GE(front_end(scratch / "run").at("lost_epochs"), 1) << outcome.output;
  EXPECT_NE(outcome.output.find("begins anew"), std::string::npos) << outcome.output;
  std::size_t chains = read_json(scratch / "run/vehicle_1/map.json").at("chains").size();
  EXPECT_EQ(chains, 1 + front_end(scratch / "run").at("lost_epochs").get<std::size_t>());
}

TEST_F(SimulatedDrive, AFolderThatIsThereAndOneOfTheFleetAreRefused) {
  const ScratchFolder scratch;
  std::ofstream(scratch / "mine") << "keep";
  expect_refusal(replay(scratch.path()), "is there already; name another folder with --out, or delete it");
  expect_refusal("replay --dataset images " + recording().parent_path().string() + " --out " + (scratch / "r").string(),
                 "give that of one of them");
  expect_refusal("replay --dataset mrclam " + recording().string() + " --out " + (scratch / "r").string(),
                 "no kind of data set 'mrclam'; there are: images, kitti");
  EXPECT_FALSE(fs::exists(scratch / "r"));
}

#endif

TEST(Replay, KittisStreetIsFollowedThroughWithAnOdometerMadeOfItsTruth) {
  const fs::path drive = test::data_folder() / "kitti_mini/seq1";
  if (!fs::exists(drive)) GTEST_SKIP() << drive << " is not there (CONVOY_DATA_DIR)";
  const ScratchFolder scratch;
  const Outcome outcome = run_convoy("replay --dataset kitti " + drive.string() + " --out " + (scratch / "r").string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("made from the true poses, with 0.5 % noise"), std::string::npos) << outcome.output;
  const json m = front_end(scratch / "r");
  std::printf("%s\n", m.dump().c_str());
  EXPECT_EQ(m.at("frames"), 51);
  EXPECT_EQ(m.at("lost_epochs"), 0);
  EXPECT_GE(m.at("tracked_p50"), 20);
  EXPECT_GE(m.at("exports_per_100m"), 40.0);
  EXPECT_LE(m.at("drift_percent"), 1.5);
  EXPECT_NE(read_text(scratch / "r/report.html").find("made from the true poses"), std::string::npos);
}

TEST(Replay, TheDeskIsFollowedThroughAndNothingIsSaidOfItsPath) {
  const fs::path desk = test::data_folder() / "monoslam_seq/png";
  if (!fs::exists(desk)) GTEST_SKIP() << desk << " is not there (CONVOY_DATA_DIR)";
  const ScratchFolder scratch;
  const Outcome outcome =
      run_convoy("replay --dataset images " + desk.string() + " --rate 30 --out " + (scratch / "r").string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("Without an odometer there is no scale and no path"), std::string::npos);
  const json m = front_end(scratch / "r");
  std::printf("%s\n", m.dump().c_str());
  EXPECT_GE(m.at("frames"), 500);
  EXPECT_EQ(m.at("frames_without_tracks"), 0);
  EXPECT_GE(m.at("tracked_p50"), 30);
  EXPECT_GE(m.at("track_length_mean"), 20.0);
  for (const char* key : {"drift_percent", "exports_per_100m", "path_m", "lost_epochs"})
    EXPECT_TRUE(m.at(key).is_null()) << key;
  EXPECT_GE(pictures_in(scratch / "r"), 4U);
}

}  // namespace
}  // namespace convoy::testing
