// `convoy demo`: the whole chain, one process per vehicle.
#include <gtest/gtest.h>

#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <future>
#include <thread>

#include "command.hpp"

namespace convoy::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Process id of the vehicle that runs `config`; 0 while there is none.
pid_t vehicle_pid(const fs::path& config) {
  for (const auto& entry : fs::directory_iterator("/proc")) {
    std::ifstream in(entry.path() / "cmdline");
    const std::string line((std::istreambuf_iterator<char>(in)), {});
    if (line.find("vehicle") != std::string::npos && line.find(config.string()) != std::string::npos)
      return static_cast<pid_t>(std::atoi(entry.path().filename().c_str()));
  }
  return 0;
}

// Waits until vehicle.csv `file` has more than `rows` rows. False after half a minute.
bool wait_for_rows(const fs::path& file, int rows) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  while (std::chrono::steady_clock::now() < deadline) {
    std::ifstream in(file);
    const auto lines = std::count(std::istreambuf_iterator<char>(in), {}, '\n');
    if (lines > rows) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return false;
}

void expect_whole(const json& metrics) {
  EXPECT_EQ(metrics["associations"]["false"], 0);
  EXPECT_EQ(metrics["facts_lost"], 0);
  EXPECT_EQ(metrics["map_digests_equal"], true);
  EXPECT_EQ(metrics["all_aligned"], true);
}

TEST(Demo, TwoVehiclesOnTheStreetShareOneConsistentMap) {
  const ScratchFolder scratch;
  const Outcome outcome = run_convoy("demo --fast --rate 15 --seed 1 --out " + (scratch / "run").string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json metrics = read_json(scratch / "run/metrics.json");
  expect_whole(metrics);
  EXPECT_GT(metrics["associations"]["true"], 50);
  EXPECT_GT(metrics["pairs"][0]["distance_rmse_raw_m"], 5.0);  // nobody knew the 20 m
  EXPECT_LT(metrics["pairs"][0]["distance_error_final_m"], 0.3);
  for (const json& vehicle : metrics["vehicles"]) {
    EXPECT_EQ(vehicle["integrity"], "OK");
    EXPECT_GE(vehicle["pose_coverage95"], 0.9);
    EXPECT_LT(vehicle["bytes_per_s_mean"], 2048.0);
    EXPECT_LT(vehicle["peak_rss_mb"], 64.0);
  }
  for (const char* file : {"run/report.html", "run/vehicle_1.tum", "run/vehicle_2.tum", "run/vehicle_1/facts.jsonl"})
    EXPECT_TRUE(fs::exists(scratch / file)) << file;
}

// By name, though their files name no interfaces: a demo speaks on 127.0.0.1.
class DemoByProfile : public ::testing::TestWithParam<const char*> {};

TEST_P(DemoByProfile, SharesOneConsistentMap) {
  const ScratchFolder scratch;
  const Outcome outcome = run_convoy("demo --fast --rate 20 --impair loss=0.1,delay=2ms --profile " +
                                     std::string(GetParam()) + " --out " + (scratch / "run").string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  expect_whole(read_json(scratch / "run/metrics.json"));
}

INSTANTIATE_TEST_SUITE_P(Names, DemoByProfile, ::testing::Values("lan", "lossy_radio.xml"));

TEST(Demo, TwoVehiclesOnAStreetInSpaceShareOneConsistentMap) {
  const ScratchFolder scratch;
  const Outcome outcome = run_convoy("demo --space --rate 12 --seed 1 --out " + (scratch / "run").string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json metrics = read_json(scratch / "run/metrics.json");
  expect_whole(metrics);
  EXPECT_EQ(metrics["dimension"], 3);
  EXPECT_GT(metrics["associations"]["true"], 50);
  EXPECT_GT(metrics["pairs"][0]["distance_rmse_raw_m"], 5.0);
  // Not distance_rmse_settled_m: at this rate it begins half a second after the association, of a busy machine.
  EXPECT_LT(metrics["pairs"][0]["distance_error_final_m"], 0.15);
  EXPECT_LT(metrics["pairs"][0]["distance_rmse_corrected_m"], 0.15);
  EXPECT_LT(metrics["fleet_ate_m"], 0.4);
  EXPECT_EQ(metrics["vehicles"][0]["map_digest"], metrics["vehicles"][1]["map_digest"]);
  for (const json& vehicle : metrics["vehicles"]) {
    EXPECT_EQ(vehicle["integrity"], "OK");
    EXPECT_GE(vehicle["pose_coverage95"], 0.94);
    EXPECT_GE(vehicle["trajectory_coverage95"], 0.94);
    EXPECT_LT(vehicle["peak_rss_mb"], 64.0);
  }
  EXPECT_NE(read_text(scratch / "run/report.html").find("<h2>Heights</h2>"), std::string::npos);
  // Judged again, it is judged alike.
  const Outcome again = run_convoy("evaluate " + (scratch / "run").string());
  ASSERT_EQ(again.status, 0) << again.output;
  EXPECT_EQ(read_json(scratch / "run/metrics.json"), metrics);
}

TEST(Demo, ASpaceRunIsOfTheStreetAlone) {
  const ScratchFolder scratch;
  const Outcome outcome =
      run_convoy("demo --space --dataset mrclam " + scratch.path().string() + " --out " + (scratch / "run").string());
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find("mrclam was recorded in a plane"), std::string::npos) << outcome.output;
}

TEST(Demo, LossDuplicatesAndReorderingEndInTheSameMap) {
  const ScratchFolder scratch;
  const Outcome plain = run_convoy("demo --fast --rate 20 --seed 2 --out " + (scratch / "plain").string());
  const Outcome impaired = run_convoy(
      "demo --fast --rate 20 --seed 2 --impair loss=0.3,duplicate=0.3,delay=20ms,jitter=100ms,seed=5 --out " +
      (scratch / "impaired").string());
  ASSERT_EQ(plain.status, 0) << plain.output;
  ASSERT_EQ(impaired.status, 0) << impaired.output;
  const json a = read_json(scratch / "plain/metrics.json"), b = read_json(scratch / "impaired/metrics.json");
  expect_whole(b);
  EXPECT_EQ(a["vehicles"][0]["map_digest"], b["vehicles"][0]["map_digest"]);
  EXPECT_GT(read_json(scratch / "impaired/vehicle_1/summary.json")["counters"]["dropped"], 10);
  EXPECT_GT(b["vehicles"][0]["requests_sent"], 0);
}

TEST(Demo, AVehicleThatIsKilledLeavesItsSubmapAndRejoins) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  auto demo = std::async(std::launch::async,
                         [&] { return run_convoy("demo --fast --rate 10 --restart-lost --out " + run.string()); });
  ASSERT_TRUE(wait_for_rows(run / "vehicle_2/labels.csv", 40));
  const pid_t victim = vehicle_pid(run / "vehicle_2/config.xml");
  ASSERT_GT(victim, 1);
  ASSERT_EQ(kill(victim, SIGKILL), 0);
  const Outcome outcome = demo.get();
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("vehicle 2 is gone (signal 9)"), std::string::npos) << outcome.output;
  const json metrics = read_json(run / "metrics.json");
  EXPECT_EQ(metrics["map_digests_equal"], true);
  EXPECT_EQ(metrics["facts_lost"], 0);
  EXPECT_EQ(metrics["associations"]["false"], 0);
  // Both lives of vehicle 2 are in the map of vehicle 1, each a chain of its own with landmarks.
  std::map<std::uint64_t, int> landmarks;
  const json map = read_json(run / "vehicle_1/map.json");
  for (const json& l : map["landmarks"])
    if (l["vehicle"] == 2) ++landmarks[l["epoch"].get<std::uint64_t>()];
  ASSERT_EQ(landmarks.size(), 2U);
  EXPECT_GE(landmarks.begin()->second, 40);
  EXPECT_GE(landmarks.rbegin()->second, 10);
}

TEST(Demo, TheOthersFinishWithoutAVehicleThatNeverComesBack) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  auto demo = std::async(std::launch::async, [&] { return run_convoy("demo --fast --rate 15 --out " + run.string()); });
  ASSERT_TRUE(wait_for_rows(run / "vehicle_2/labels.csv", 20));
  const pid_t victim = vehicle_pid(run / "vehicle_2/config.xml");
  ASSERT_GT(victim, 1);
  ASSERT_EQ(kill(victim, SIGKILL), 0);
  const Outcome outcome = demo.get();
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json summary = read_json(run / "vehicle_1/summary.json"), metrics = read_json(run / "metrics.json");
  EXPECT_GE(summary["landmarks_known"].get<int>() - summary["landmarks_exported"].get<int>(), 20);
  EXPECT_EQ(metrics["lost_vehicles"], json::array({2}));
  EXPECT_EQ(summary["facts_missing"], 0);
}

TEST(Demo, WhenNoneIsLeftItSaysSoAndFails) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  Background demo({"demo", "--fast", "--rate", "10", "--out", run.string()}, scratch / "output");
  for (const char* id : {"1", "2"}) {
    const fs::path folder = run / (std::string("vehicle_") + id);
    ASSERT_TRUE(wait_for_rows(folder / "live.csv", 3));
    const pid_t victim = vehicle_pid(folder / "config.xml");
    ASSERT_GT(victim, 1);
    ASSERT_EQ(kill(victim, SIGKILL), 0);
    ASSERT_TRUE(eventually([&] {
      return read_text(scratch / "output").find(std::string("vehicle ") + id + " is gone (signal 9)") !=
             std::string::npos;
    }));
  }
  EXPECT_EQ(demo.wait(), 1);
  const std::string output = read_text(scratch / "output");
  EXPECT_NE(output.find("vehicle 1 is gone (signal 9); the others go on and keep its submap"), std::string::npos)
      << output;
  EXPECT_NE(output.find("vehicle 2 is gone (signal 9); none is left"), std::string::npos) << output;
  EXPECT_EQ(output.find("share one map:"), std::string::npos) << output;
  EXPECT_EQ(output.find("started share one map"), std::string::npos) << output;
}

TEST(Demo, AVehicleThatFallsSilentIsNamedOnceAndMayComeBack) {
  const ScratchFolder scratch;
  const fs::path run = scratch / "run";
  Background demo({"demo", "--fast", "--rate", "10", "--out", run.string()}, scratch / "output");
  ASSERT_TRUE(wait_for_rows(run / "vehicle_2/live.csv", 3));
  const pid_t victim = vehicle_pid(run / "vehicle_2/config.xml");
  ASSERT_GT(victim, 1);
  ASSERT_EQ(kill(victim, SIGSTOP), 0);
  const std::string said = "vehicle 2 has been silent for 5 s";
  const auto times = [&](const std::string& words) {
    const std::string output = read_text(scratch / "output");
    std::size_t count = 0;
    for (std::size_t at = output.find(words); at != std::string::npos; at = output.find(words, at + 1)) ++count;
    return count;
  };
  EXPECT_TRUE(eventually([&] { return times(said) > 0 && times("v2 SILENT") > 0; }));
  ASSERT_EQ(kill(victim, SIGCONT), 0);
  EXPECT_EQ(demo.wait(), 0) << read_text(scratch / "output");
  EXPECT_EQ(times(said), 1U);
  EXPECT_EQ(times("vehicle 1 has been silent"), 0U);
}

TEST(Demo, FiveRealRobotsWithHiddenIdentities) {
  const auto data = mrclam_folder();
  if (!data) GTEST_SKIP() << "no utias_mrclam/ds6; set CONVOY_DATA_DIR to the folder that holds utias_mrclam";
  const ScratchFolder scratch;
  const std::string dataset = "--dataset mrclam " + data->string();
  const Outcome plain = run_convoy("demo " + dataset + " --rate 30 --out " + (scratch / "plain").string());
  ASSERT_EQ(plain.status, 0) << plain.output;
  const json metrics = read_json(scratch / "plain/metrics.json");
  expect_whole(metrics);
  EXPECT_LE(metrics["fleet_ate_m"], 0.25);
  for (const json& vehicle : metrics["vehicles"]) EXPECT_LT(vehicle["peak_rss_mb"], 64.0);
  for (const json& pair : metrics["pairs"]) EXPECT_LE(pair["distance_rmse_corrected_m"], 0.25) << pair;

  const Outcome impaired =
      run_convoy("demo " + dataset + " --rate 30 --impair loss=0.3,duplicate=0.3,jitter=100ms --out " +
                 (scratch / "impaired").string());
  ASSERT_EQ(impaired.status, 0) << impaired.output;
  const json other = read_json(scratch / "impaired/metrics.json");
  expect_whole(other);
  EXPECT_EQ(metrics["vehicles"][0]["map_digest"], other["vehicles"][0]["map_digest"]);
}

TEST(Demo, AParkWhoseTreesNobodyHasNamed) {
  const auto data = victoria_park_folder();
  if (!data) GTEST_SKIP() << "no victoria_park; set CONVOY_DATA_DIR to the folder that holds victoria_park";
  const ScratchFolder scratch;
  const Outcome outcome =
      run_convoy("demo --dataset victoria-park " + data->string() + " --rate 30 --out " + (scratch / "run").string());
  ASSERT_EQ(outcome.status, 0) << outcome.output;
  const json metrics = read_json(scratch / "run/metrics.json");
  EXPECT_EQ(metrics["all_aligned"], true);
  EXPECT_EQ(metrics["facts_lost"], 0);
  EXPECT_LE(metrics["fleet_ate_m"], 1.5);
  EXPECT_EQ(metrics["fleet_anees"], nullptr);
  const json& associations = metrics["associations"];
  EXPECT_EQ(associations["judged_by"], "poses");
  EXPECT_EQ(associations["hypotheses_false"], 0);
  EXPECT_GE(associations["hypotheses_accepted"], 2 * associations["hypotheses_unjudged"].get<int>());
}

}  // namespace
}  // namespace convoy::testing
