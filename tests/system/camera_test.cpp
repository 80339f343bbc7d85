// Vehicles with cameras, in the simulator's streets: real processes on both sides of the sensor topics.
#include <gtest/gtest.h>

#include <unistd.h>

#include <fstream>

#include "command.hpp"
#include "free_domains.hpp"
#include "scenario/scenario.hpp"

namespace convoy::testing {
namespace {

namespace fs = std::filesystem;

class CameraVehicle : public ::testing::Test {
 protected:
  fs::path write_config(int vehicle, const std::string& camera) {
    const fs::path file = scratch_ / ("v" + std::to_string(vehicle) + ".xml");
    std::ofstream(file) << "<convoy version=\"1\">\n  <fleet dimension=\"3\"/>\n  <vehicle id=\"" << vehicle
                        << "\" output_folder=\"vehicle_" << vehicle << "\"/>\n  <dds domain=\"" << fleet_domain_
                        << "\" profile=\"" CONVOY_SOURCE_FOLDER "/qos_profiles/loopback_udp.xml\""
                        << " interfaces=\"127.0.0.1\"/>\n  <camera domain=\"" << sensor_domain() << "\" " << camera
                        << "/>\n</convoy>\n";
    return file;
  }
  int sensor_domain() const { return fleet_domain_ + 1; }
  std::string sim(const std::string& arguments) const {
    return "sim --lock-step --domain-sensors " + std::to_string(sensor_domain()) + " --domain-truth " +
           std::to_string(fleet_domain_ + 2) + " " + arguments;
  }

  ScratchFolder scratch_;
  const int fleet_domain_ = 5 + 3 * (getpid() % 4);
};

TEST_F(CameraVehicle, TwoInLockStepEndWithOneMap) {
  std::vector<std::unique_ptr<Background>> vehicles;
  for (const int id : {1, 2}) {
    const fs::path config = write_config(id, "lock_step=\"true\"");
    vehicles.push_back(std::make_unique<Background>(std::vector<std::string>{"vehicle", "--until-end", config.string()},
                                                    scratch_ / ("log_" + std::to_string(id))));
  }
  const Outcome drive = run_convoy(sim("--vehicles 2 --speed 5 --distance 50 --camera 320x240"));
  EXPECT_EQ(drive.status, 0) << drive.output;
  for (const int id : {1, 2})
    EXPECT_EQ(vehicles[static_cast<std::size_t>(id - 1)]->wait(), 0)
        << read_text(scratch_ / ("log_" + std::to_string(id)));
  const auto one = read_json(scratch_ / "vehicle_1/summary.json"), two = read_json(scratch_ / "vehicle_2/summary.json");
  for (const auto& summary : {one, two}) {
    EXPECT_GT(summary["landmarks_exported"], 20) << summary;
    EXPECT_EQ(summary["facts_missing"], 0) << summary;
    EXPECT_EQ(summary["landmarks_known"], one["landmarks_exported"].get<int>() + two["landmarks_exported"].get<int>());
  }
  EXPECT_EQ(one["facts_digest"], two["facts_digest"]);
  EXPECT_EQ(one["map_digest"], two["map_digest"]);
}

TEST_F(CameraVehicle, OneWithoutSensorsSaysWhereItHasListened) {
  const fs::path config = write_config(1, "wait_s=\"1\"");
  const Outcome outcome = run_convoy("vehicle " + config.string());
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  const std::string words = "v1.xml:5: <camera>: vehicle 1 has heard of no camera on DDS domain " +
                            std::to_string(sensor_domain()) + " for 1 s";
  EXPECT_NE(outcome.output.find(words), std::string::npos) << outcome.output;
  EXPECT_FALSE(fs::exists(scratch_ / "vehicle_1")) << "nothing is written before it begins";
}

TEST_F(CameraVehicle, WhereTheProgramForCamerasIsNotThereItIsSaid) {
  fs::copy(CONVOY_PROGRAM, scratch_ / "convoy");
  const Outcome outcome = run_shell((scratch_ / "convoy").string() + " vehicle " + write_config(1, "").string());
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find("convoy-camera is not beside"), std::string::npos) << outcome.output;
  EXPECT_NE(outcome.output.find("build convoy with CONVOY_BUILD_VISION=ON"), std::string::npos) << outcome.output;
}

TEST_F(CameraVehicle, ADemoOfTwoIsJudgedByWhatTheirPixelsShow) {
  const fs::path run = scratch_ / "run";
  const Outcome outcome = run_convoy("demo --distance 120 --out " + run.string());
  EXPECT_EQ(outcome.status, 0) << outcome.output;
  const auto metrics = read_json(run / "metrics.json");
  EXPECT_EQ(metrics["scenario"], "camera");
  EXPECT_EQ(metrics["map_digests_equal"], true);
  const auto& a = metrics["associations"];
  EXPECT_EQ(a["judged_by"], "places") << a;
  EXPECT_GT(a["true"], 5) << a;
  EXPECT_LT(a["apart_median_m"], 0.1) << a;
  for (const auto& vehicle : metrics["vehicles"]) EXPECT_GT(vehicle["poses_judged"], 5) << vehicle;
  EXPECT_GT(read_json(run / "run.json")["real_time_factor"], 0.0);
  EXPECT_TRUE(fs::exists(run / "report.html"));
}

TEST_F(CameraVehicle, ADemoIsJudgedByTheTruthOfItsOwnSimulatorThoughAnotherTellsIts) {
  const auto truth_domain = cli::free_domain_beside(static_cast<std::uint32_t>(fleet_domain_), 20);
  const Background other(
      {"sim", "--vehicles", "2", "--speed", "10", "--camera", "64x48", "--duration", "1000", "--domain-sensors",
       std::to_string(sensor_domain()), "--domain-truth", std::to_string(truth_domain)},
      scratch_ / "other");
  const fs::path run = scratch_ / "run";
  const Outcome outcome =
      run_convoy("demo --distance 20 --domain " + std::to_string(fleet_domain_) + " --out " + run.string());
  const std::string words = "another simulator tells its truth on DDS domain " + std::to_string(truth_domain);
  EXPECT_NE(outcome.output.find(words), std::string::npos) << outcome.output << read_text(scratch_ / "other");
  const auto truth = cli::read_truth<SE3>(cli::truth_file(run, 1));
  EXPECT_GT(truth.size(), 50U);
  for (std::size_t i = 1; i < truth.size(); ++i) {
    const double step_m = (truth[i].T_world_body.translation() - truth[i - 1].T_world_body.translation()).norm();
    EXPECT_LT(step_m, 0.5) << truth[i].t_s;  // 2 m/s at 10 Hz
  }
}

TEST_F(CameraVehicle, ADemoOfLandmarksRefusesWhatIsOfCameras) {
  for (const std::string words : {"--route loop", "--vehicles 3", "--distance 100"}) {
    const Outcome outcome = run_convoy("demo --fast " + words + " --out " + (scratch_ / "run").string());
    EXPECT_EQ(outcome.status, 2) << outcome.output;
    EXPECT_NE(outcome.output.find("is of cameras in the simulator's streets: leave out --fast"), std::string::npos)
        << outcome.output;
  }
}

TEST_F(CameraVehicle, ADemoWithCamerasRefusesWhatIsOfLandmarks) {
  const Outcome outcome = run_convoy("demo --rate 20 --out " + (scratch_ / "run").string());
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find("--rate is of sensors that measure landmarks; give --fast"), std::string::npos)
      << outcome.output;
}

}  // namespace
}  // namespace convoy::testing
