// convoy replay: recordings of the simulator, of KITTI's vehicle, images alone, and Victoria Park as a fleet.
#include <gtest/gtest.h>

#include <unistd.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <random>
#include <sstream>

#include "../support/data_folder.hpp"
#include "command.hpp"

namespace convoy::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

#ifdef CONVOY_HAS_VISION
json front_end(const fs::path& run) { return read_json(run / "metrics.json").at("front_end"); }

std::size_t pictures_in(const fs::path& run) {
  std::size_t count = 0;
  for (const auto& entry : fs::directory_iterator(run / "frames")) count += entry.path().extension() == ".png";
  return count;
}

#endif

void expect_refusal(const std::string& arguments, const std::string& words) {
  const Outcome outcome = run_convoy(arguments);
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find(words), std::string::npos) << outcome.output;
}

#if defined(CONVOY_HAS_SIMULATOR) && defined(CONVOY_HAS_VISION)

/// Without what differs from run to run: the time that it took.
json without_times(json front_end) {
  for (const char* key : {"ms_p50", "ms_p95", "ms_max"}) front_end.erase(key);
  return front_end;
}

/// Fifteen seconds through the simulator's district, at 4 m/s.
class SimulatedDrive : public ::testing::Test {
 protected:
  void SetUp() override {
    const Outcome outcome = run_convoy(
        "sim --duration 15 --speed 4 --lock-step --wait-for 0 --domain-sensors " + std::to_string(5 + getpid() % 7) +
        " --domain-truth " + std::to_string(12 + getpid() % 7) + " --record " + (scratch_ / "drive").string());
    ASSERT_EQ(outcome.status, 0) << outcome.output;
  }
  fs::path recording() const { return scratch_ / "drive/vehicle_1"; }
  std::string replay(const fs::path& out) const {
    return "replay --dataset images " + recording().string() + " --out " + out.string();
  }
  ScratchFolder scratch_;
};

void expect_mapped(const json& m) {
  EXPECT_GE(m.at("frames"), 140);
  EXPECT_GE(m.at("tracked_p50"), 30);
  EXPECT_GE(m.at("exports_per_100m"), 50.0);
  EXPECT_LE(m.at("drift_percent"), 2.0);
  EXPECT_EQ(m.at("lost_epochs"), 0);
  EXPECT_GT(m.at("ms_p95"), 0.0);
}

void expect_run_folder(const fs::path& run) {
  EXPECT_GE(pictures_in(run), 4U);
  const std::string page = read_text(run / "report.html");
  for (const char* words : {"<h2>Front end</h2>", "drift at the end", "<img src=\"frames/0000"})
    EXPECT_NE(page.find(words), std::string::npos) << words;
  for (const char* name : {"vehicle_1.tum", "vehicle_1/facts.jsonl", "vehicle_1/trajectory.csv", "vehicle_1/map.json",
                           "vehicle_1/live.csv", "vehicle_1/front_end.csv"})
    EXPECT_GT(fs::file_size(run / name), 100U) << name;
  const json vehicle = read_json(run / "metrics.json").at("vehicles").at(0);
  EXPECT_GE(vehicle.at("landmarks_exported"), 20);
  EXPECT_EQ(vehicle.at("integrity"), "OK");
}

TEST_F(SimulatedDrive, IsMappedAndJudgedTheSameEachTime) {
  const fs::path one = scratch_ / "one", two = scratch_ / "two";
  const Outcome outcome = run_convoy(replay(one));
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json judged = front_end(one);
  std::printf("%s\n", judged.dump().c_str());
  expect_mapped(judged);
  expect_run_folder(one);

  expect_refusal(replay(one), "is there already; name another folder with --out, or delete it");
  ASSERT_EQ(run_convoy(replay(two)).status, 0);
  for (const char* name : {"vehicle_1.tum", "vehicle_1/facts.jsonl", "vehicle_1/trajectory.csv"})
    EXPECT_EQ(read_text(one / name), read_text(two / name)) << name;
  EXPECT_EQ(without_times(judged), without_times(front_end(two)));

  const Outcome again = run_convoy("evaluate " + one.string());
  ASSERT_EQ(again.status, 0) << again.output;
  EXPECT_EQ(front_end(one), judged);
}

/// From halfway on, each image is another pattern of blocks: there are corners, and none of them stays.
void replace_images(const fs::path& images) {
  constexpr int width = 640, height = 480, block = 20;
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(images)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::mt19937 random(1);
  for (std::size_t k = files.size() / 2; k < files.size(); ++k) {
    std::array<char, (width / block) * (height / block)> blocks;
    for (char& grey : blocks) grey = static_cast<char>(random() % 256);
    fs::remove(files[k]);
    std::ofstream image(files[k].replace_extension("pgm"), std::ios::binary);
    image << "P5 " << width << " " << height << " 255\n";
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x)
        image.put(blocks[static_cast<std::size_t>(y / block * (width / block) + x / block)]);
  }
}

TEST_F(SimulatedDrive, BeginsAnewWithANewEpochEachTimeThatItIsLost) {
  replace_images(recording() / "images");
  const Outcome outcome = run_convoy(replay(scratch_ / "run"));
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("lost after"), std::string::npos) << outcome.output;
  const std::size_t lost = front_end(scratch_ / "run").at("lost_epochs");
  EXPECT_GE(lost, 1U);
  const json chains = read_json(scratch_ / "run/vehicle_1/map.json").at("chains");
  ASSERT_EQ(chains.size(), 1 + lost);
  EXPECT_EQ(chains[0].at("aligned"), true);
  EXPECT_EQ(chains[1].at("aligned"), false);  // nobody knows where it began
  const std::string rows = read_text(scratch_ / "run/vehicle_1/trajectory.csv");
  EXPECT_LT(std::stod(rows.substr(rows.find('\n') + 1)), 5.0) << "what was driven before it was lost belongs to it";
}

#endif

TEST(Replay, AKindThatIsNoneOrAFolderThatIsNoneIsRefusedBeforeAnythingIsWritten) {
  const ScratchFolder scratch;
  const std::string out = " --out " + (scratch / "run").string();
  expect_refusal("replay --dataset mrclam " + scratch.path().string() + out,
                 "no kind of data set 'mrclam'; there are: images, kitti, victoria");
  expect_refusal("replay --dataset victoria " + (scratch / "none").string() + out,
                 "none: no such folder; give the folder of the Victoria Park data set");
  expect_refusal("replay --dataset victoria " + scratch.path().string() + out, "odometry.csv: no such file");
  expect_refusal("replay --rate 10 --dataset victoria " + scratch.path().string() + out,
                 "--rate and --features are of images");
  std::ofstream(scratch / "odometry.csv") << "t_s,speed_mps,steering_rad\n1,2,0\n2,2,0\n3,2";
  expect_refusal("replay --dataset victoria " + scratch.path().string() + out, "odometry.csv:4: the last line has no");
  EXPECT_FALSE(fs::exists(scratch / "run"));
}

TEST(Replay, VictoriaParkIsAFleetThatComesToShareOneMap) {
  const auto park = victoria_park_folder();
  if (!park) GTEST_SKIP() << "no victoria_park; set CONVOY_DATA_DIR to the folder that holds victoria_park";
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  const Outcome outcome = run_convoy("replay --dataset victoria " + park->string() + " --out " + run.string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json metrics = read_json(run / "metrics.json");
  const json& m = metrics.at("front_end");
  std::printf("%s\n", m.dump().c_str());
  EXPECT_GE(m.at("frames"), 3600);
  EXPECT_GE(m.at("tracked_p50"), 3);
  EXPECT_GT(m.at("ms_p95"), 0.0);
  EXPECT_GE(m.at("ms_max"), m.at("ms_p95"));
  EXPECT_GE(m.at("exports_per_100m"), 5.0);
  EXPECT_EQ(m.at("lost_epochs"), 0);
  EXPECT_TRUE(m.at("drift_percent").is_number());
  EXPECT_EQ(metrics.at("all_aligned"), true);
  EXPECT_EQ(metrics.at("facts_lost"), 0);
  EXPECT_EQ(metrics.at("associations").at("hypotheses_false"), 0);
  for (const json& vehicle : metrics.at("vehicles")) {
    EXPECT_GE(vehicle.at("front_end").at("frames"), 1000);
    EXPECT_EQ(vehicle.at("integrity"), "OK") << vehicle.at("id");
  }
  for (const char* words : {"<h2>Front ends</h2>", "<h2>Vehicle 3</h2>", "drift at the end"})
    EXPECT_NE(read_text(run / "report.html").find(words), std::string::npos) << words;

  ASSERT_EQ(run_convoy("replay --dataset victoria " + park->string() + " --out " + (scratch / "again").string()).status,
            0);
  for (const char* name : {"vehicle_1/facts.jsonl", "vehicle_3/facts.jsonl", "vehicle_2.tum"})
    EXPECT_EQ(read_text(run / name), read_text(scratch / "again" / name)) << name;
}

#ifdef CONVOY_HAS_VISION

TEST(Replay, WhatIsNoRecordingIsRefusedBeforeAnythingIsWritten) {
  const ScratchFolder scratch;
  const std::string out = " --out " + (scratch / "run").string();
  fs::create_directories(scratch / "fleet/vehicle_1/images");
  std::ofstream(scratch / "fleet/vehicle_1/odometry.csv") << "stamp_s,distance_m,yaw_rate_radps\n";
  expect_refusal("replay --dataset images " + (scratch / "fleet").string() + out, "give that of one of them");
  expect_refusal("replay --dataset images " + (scratch / "none").string() + out, "none: is no folder");
  expect_refusal("replay --dataset kitti " + (scratch / "fleet").string() + out, "is no drive of KITTI");
  EXPECT_FALSE(fs::exists(scratch / "run"));
}

TEST(Replay, KittisStreetIsFollowedThroughWithAnOdometerMadeOfItsTruth) {
  if (!kitti_drive()) GTEST_SKIP() << "no kitti_mini/seq1 (CONVOY_DATA_DIR)";
  const ScratchFolder scratch;
  const Outcome outcome =
      run_convoy("replay --dataset kitti " + kitti_drive()->string() + " --out " + (scratch / "r").string());
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

#else

TEST(Replay, RecordingsWithACameraAreRefusedWhereThereIsNoOpenCv) {
  const ScratchFolder scratch;
  expect_refusal("replay --dataset images " + scratch.path().string() + " --out " + (scratch / "run").string(),
                 "built without OpenCV");
}

#endif

}  // namespace
}  // namespace convoy::testing
