// Bad input on the command line and in files: exit status 2 and one line that says what, where and how to mend it.
#include <gtest/gtest.h>

#include <unistd.h>

#include <csignal>
#include <fstream>

#include "command.hpp"

namespace convoy::testing {
namespace {

namespace fs = std::filesystem;

void write(const fs::path& file, const std::string& text) {
  fs::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary) << text;
}

/// One line of it is the error; what stands before is the log of a vehicle that began.
std::size_t errors_in(const std::string& output) {
  std::size_t count = 0;
  for (std::size_t at = output.find("[error]"); at != std::string::npos; at = output.find("[error]", at + 1)) ++count;
  return count;
}

void expect_refusal(const std::string& arguments, const std::string& words) {
  const Outcome outcome = run_convoy(arguments);
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find(words), std::string::npos) << outcome.output;
  EXPECT_EQ(errors_in(outcome.output), 1U) << outcome.output;
}

const std::string sensors_header = "t_s,kind,a,b,c\n";

/// A vehicle that would run: `vehicle` are further entries of its element, `sensors` is its log.
class BadVehicle : public ::testing::Test {
 protected:
  void prepare(const std::string& vehicle, const std::string& sensors) {
    write(scratch_ / "sensors.csv", sensors);
    write(scratch_ / "c.xml",
          "<convoy version=\"1\">\n  <vehicle id=\"1\" " + vehicle + "/>\n  <dds domain=\"" +
              std::to_string(5 + getpid() % 14) +
              "\" profile=\"" CONVOY_SOURCE_FOLDER
              "/qos_profiles/loopback_udp.xml\"/>\n  <sensors file=\"sensors.csv\" rate=\"10\"/>\n</convoy>\n");
  }
  std::string arguments() const { return "vehicle --until-end " + (scratch_ / "c.xml").string(); }

  ScratchFolder scratch_;
};

TEST_F(BadVehicle, ADamagedEpochFileIsNamedAndNoEpochIsUsed) {
  prepare("state_folder=\"state\"", sensors_header + "0,odometry,1,0,\n1,odometry,1,0,\n");
  const Outcome first = run_convoy(arguments());
  ASSERT_EQ(first.status, 0) << first.output;
  const std::string good = read_text(scratch_ / "state/epoch");
  for (const std::string& damaged : {std::string(), good.substr(0, 5), good.substr(0, good.size() - 1),
                                     std::string("1\n"), std::string("\0\0\0\0", 4), "-" + good}) {
    write(scratch_ / "state/epoch", damaged);
    expect_refusal(arguments(), "state/epoch:1: damaged, this is no epoch; delete the file");
    EXPECT_EQ(read_text(scratch_ / "state/epoch"), damaged);
  }
  const auto epoch = [&] { return read_json(scratch_ / "summary.json")["epoch"].get<std::uint64_t>(); };
  const std::uint64_t before = epoch();
  fs::remove(scratch_ / "state/epoch");
  ASSERT_EQ(run_convoy(arguments()).status, 0);
  EXPECT_GT(epoch(), before);
}

TEST_F(BadVehicle, AnImpairmentOfTheCommandLineTakesThePlaceOfTheConfigurations) {
  prepare("", sensors_header + "0,odometry,1,0,\n1,odometry,1,0,\n");
  expect_refusal(arguments() + " --impair loss=2", "cannot use 'loss=2'");
  const Outcome impaired = run_convoy(arguments() + " --impair loss=0.5");
  EXPECT_EQ(impaired.status, 0) << impaired.output;
  EXPECT_NE(impaired.output.find("IMPAIRED on purpose"), std::string::npos) << impaired.output;
}

TEST_F(BadVehicle, AHostileSensorLogIsNamedWithItsLine) {
  const auto refused = [this](const std::string& text, const std::string& words) {
    prepare("", text);
    expect_refusal(arguments(), words);
  };
  const std::string good = "0,odometry,1,0,\n";
  refused(sensors_header + good + "1,odometry,1", "sensors.csv:3: the last line has no line end");
  refused(sensors_header + good + "1,odometry,1\n", "sensors.csv:3: the line has 3 fields");
  refused(sensors_header + good + "1,odometry,nan,0,\n", "sensors.csv:3: field 3 is 'nan'");
  refused(sensors_header + good + "inf,odometry,1,0,\n", "sensors.csv:3: field 1 is 'inf'");
  refused(sensors_header + good + "1e999,odometry,1,0,\n", "sensors.csv:3: field 1");
  refused(sensors_header + "5,odometry,1,0,\n4,odometry,1,0,\n", "sensors.csv:3: time runs backwards");
  refused(sensors_header + "0,sighting,7,-1,0\n", "sensors.csv:2: the range of a sighting must be above 0");
  refused(sensors_header + "0,sighting,-7,1,0\n", "sensors.csv:2: field 3");
  refused(sensors_header + "0,sonar,1,0,\n", "sensors.csv:2: the kind is 'sonar'");
  refused(sensors_header, "sensors.csv:1: no reading below the header");
  refused("", "sensors.csv:1: the file is empty");
  refused(std::string("\x7f"
                      "ELF\0\1\2\n\xff\xfe",
                      11),
          "sensors.csv:1: the first line is");
  refused(sensors_header + good + std::string("\0\0\0\xff,\n", 6), "sensors.csv:3: the line has 2 fields");
  fs::remove(scratch_ / "sensors.csv");
  expect_refusal(arguments(), "sensors.csv: no such file");
  fs::create_directory(scratch_ / "sensors.csv");
  expect_refusal(arguments(), "sensors.csv: no such file");
  write(scratch_ / "c.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n</convoy>\n");
  expect_refusal(arguments(), "no <sensors file=");
}

// No folder can be made below a file, not even by root.
TEST_F(BadVehicle, FoldersThatCannotBeWrittenAreNamed) {
  const std::string sensors = sensors_header + "0,odometry,1,0,\n";
  const fs::path file = scratch_ / "file";
  write(file, "what stood here before");
  prepare("state_folder=\"" + (file / "state").string() + "\"", sensors);
  expect_refusal(arguments(), "file/state/lock: cannot write");
  prepare("output_folder=\"" + (file / "out").string() + "\"", sensors);
  expect_refusal(arguments(), "file/out/live.csv: cannot write");
  expect_refusal("demo --fast --out " + (file / "run").string(), "file/run");
  EXPECT_EQ(read_text(file), "what stood here before");
}

TEST_F(BadVehicle, ADiskThatIsFullIsSaidAndEndsWithAnError) {
  prepare("output_folder=\"out\"", sensors_header + "0,odometry,1,0,\n40,odometry,1,0,\n");
  fs::create_directories(scratch_ / "out");
  fs::create_symlink("/dev/full", scratch_ / "out/traffic.csv");
  expect_refusal(arguments(), "out/traffic.csv: cannot write");
}

TEST_F(BadVehicle, OneThatRunsAlreadyIsNamedAndKillingItFreesTheFolder) {
  prepare("state_folder=\"state\"", sensors_header + "0,odometry,1,0,\n1,odometry,1,0,\n");
  Background first({"vehicle", (scratch_ / "c.xml").string()}, scratch_ / "output");
  ASSERT_TRUE(eventually([&] { return !read_text(scratch_ / "state/epoch").empty(); }));
  const std::string before = read_text(scratch_ / "state/epoch");
  expect_refusal(arguments(),
                 "this vehicle runs already, as process " + std::to_string(first.pid()) + "; stop that one");
  EXPECT_EQ(read_text(scratch_ / "state/epoch"), before);
  first.send(SIGKILL);
  first.wait();
  const Outcome again = run_convoy(arguments());
  EXPECT_EQ(again.status, 0) << again.output;
}

TEST(BadInput, ARunFolderThatIsDamagedIsNamedOnOneLine) {
  const ScratchFolder scratch;
  const std::string evaluate = "evaluate " + scratch.path().string();
  const auto run = [&](const std::string& vehicles) {
    write(scratch / "run.json", R"({"scenario":"street","common_frame_vehicle":1,"vehicles":)" + vehicles + "}");
  };
  expect_refusal(evaluate, "run.json: no such file");
  run("[1,1]");
  expect_refusal(evaluate, "run.json: 'vehicles' names vehicle 1 twice");
  run("[0,1]");
  expect_refusal(evaluate, "run.json: 'vehicles' holds 0");
  run("[]");
  expect_refusal(evaluate, "run.json: 'vehicles' names none");
  run("[1,2]");
  write(scratch / "vehicle_1/summary.json", "{");
  expect_refusal(evaluate, "summary.json: not what it should be");
  fs::remove(scratch / "vehicle_1/summary.json");
  write(scratch / "vehicle_1/traffic.csv", "t_s,bytes_sent,messages_sent\n");
  expect_refusal(evaluate, "traffic.csv:1: no row below the header");
  fs::remove(scratch / "vehicle_1/traffic.csv");
  fs::remove_all(scratch / "vehicle_1");
  expect_refusal(evaluate, "vehicle_1/live.csv: no such file, though vehicle 1 lived to the end");
  EXPECT_FALSE(fs::exists(scratch / "metrics.json"));
  write(scratch / "run.json",
        R"({"scenario":"street","common_frame_vehicle":1,"vehicles":[1,2],"lost_vehicles":[1,2]})");
  fs::create_directory(scratch / "metrics.json");  // where the verdict should go
  expect_refusal(evaluate, "metrics.json: cannot be written");
}

TEST(BadInput, APoseGraphThatHasNoSolutionIsRefusedAndNothingIsWritten) {
  const ScratchFolder scratch;
  const std::string solve = "solve " + (scratch / "g.g2o").string() + " --out " + (scratch / "out").string();
  const auto refused = [&](const std::string& graph, const std::string& words) {
    write(scratch / "g.g2o", graph);
    for (const char* how : {"", " --incremental"}) {
      expect_refusal(solve + how, words);
      EXPECT_FALSE(fs::exists(scratch / "out"));
    }
  };
  const std::string good = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n";
  refused(good + "EDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n", "no edges lead from vertex 0 to vertex 5");
  refused(good + "EDGE_SE2 1 2 1 0 0 1 1 0 1 0 1\n", "g.g2o:2: the information matrix");
  refused(good + "EDGE_SE2 1 2 1 0 0 0 0 0 0 0 0\n", "g.g2o:2: the information matrix");
  refused(good + "EDGE_SE2 1 2 nan 0 0 1 0 0 1 0 1\n", "g.g2o:2: field 4 is 'nan'");
  refused("EDGE_SE2 0 1 1e308 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1e308 0 0 1 0 0 1 0 1\n", "not finite");
}

TEST(BadInput, AMissingConfigurationIsNamed) {
  expect_refusal("vehicle /nowhere/config.xml", "/nowhere/config.xml: no such file");
}

TEST(BadInput, AnUnknownEntryIsNamedWithItsLine) {
  const ScratchFolder scratch;
  write(scratch / "c.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n  <drift gama=\"1\"/>\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "c.xml").string(), "c.xml:3: <drift> has no entry 'gama'; it has: gamma");
  write(scratch / "d.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n  <drifts/>\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "d.xml").string(), "d.xml:3: no such element <drifts>");
}

TEST(BadInput, AValueOutOfRangeIsNamedWithItsLine) {
  const ScratchFolder scratch;
  write(scratch / "c.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n  <drift\n    gamma=\"nan\"/>\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "c.xml").string(), "c.xml:4: <drift gamma>: 'nan' is no finite number");
  write(scratch / "d.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n  <drift gamma=\"-1\"/>\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "d.xml").string(), "d.xml:3: drift: gamma must be > 0");
  write(scratch / "e.xml", "<convoy version=\"1\">\n  <vehicle id=\"-4\"/>\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "e.xml").string(), "e.xml:2: <vehicle id>: '-4' is no whole number");
}

TEST(BadInput, BrokenXmlIsNamedWithItsLine) {
  const ScratchFolder scratch;
  write(scratch / "c.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\">\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "c.xml").string(), "not well-formed XML");
}

TEST(BadInput, ACutSensorLogIsNamedWithItsLine) {
  const ScratchFolder scratch;
  write(scratch / "sensors.csv", "t_s,kind,a,b,c\n0,odometry,1,0,\n0.1,odometry,1");
  write(scratch / "c.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n  <dds profile=\"" +
                               std::string(CONVOY_SOURCE_FOLDER) +
                               "/qos_profiles/loopback_udp.xml\"/>\n  <sensors file=\"sensors.csv\"/>\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "c.xml").string(), "sensors.csv:3");
}

TEST(BadInput, AMissingDataSetIsNamed) {
  const ScratchFolder scratch;
  expect_refusal("demo --dataset mrclam /nowhere --out " + (scratch / "run").string(), "/nowhere");
  expect_refusal("demo --dataset kitti /nowhere --out " + (scratch / "run").string(), "no data set 'kitti'");
}

// What the command line itself refuses ends with 2, too.
TEST(BadInput, OptionsOutOfRangeAreNamed) {
  const ScratchFolder scratch;
  const auto refused = [&](const std::string& arguments, const std::string& words) {
    const Outcome outcome = run_convoy(arguments + " --out " + (scratch / "run").string());
    EXPECT_EQ(outcome.status, 2) << outcome.output;
    EXPECT_NE(outcome.output.find(words), std::string::npos) << outcome.output;
    EXPECT_FALSE(fs::exists(scratch / "run"));
  };
  refused("demo --settle-timeout -5", "--settle-timeout: Value -5 not in range");
  refused("vehicle c.xml --status-period 0", "--status-period: Value 0 not in range");
  refused("demo --profile wan_tcp", "A demo's vehicles find each other without addresses");
  refused("demo --profile large_fleet.xml", "A demo's vehicles find each other without addresses");
  refused("demo --profile no_such", "the QoS profile no_such.xml is neither installed");
  refused("demo --profile no/such.xml", "no/such.xml: no such QoS profile file");
  refused("demo --seed -1", "--seed: '-1' is no whole number from 0 on");
  refused("demo --first-epoch -1", "--first-epoch: '-1' is no whole number from 0 on");
  refused("consistency --seed 1.5", "--seed: '1.5' is no whole number from 0 on");
  refused("consistency --only 4-D", "in the name of no scenario");
  refused("demo --domian 3", "--domian");
}

TEST(BadInput, AnUnknownCommandIsNamedBesideThoseThereAre) {
  expect_refusal("frobnicate", "no command 'frobnicate'; there are: demo, vehicle, evaluate,");
  expect_refusal("", "no command given; there are: demo,");
  EXPECT_EQ(run_convoy("--help").status, 0);
  EXPECT_EQ(run_convoy("--version").status, 0);
}

TEST(BadInput, AnImpairmentThatMakesNoSenseIsRefused) {
  const ScratchFolder scratch;
  expect_refusal("demo --fast --impair loss=abc --out " + (scratch / "run").string(), "('abc' is no number)");
  expect_refusal("demo --fast --impair loss=2 --out " + (scratch / "run").string(), "cannot use 'loss=2'");
}

TEST(BadInput, ARunIsNeverWrittenOver) {
  const ScratchFolder scratch;
  write(scratch / "run.json", "{}");
  expect_refusal("demo --fast --out " + scratch.path().string(), "holds a run already");
}

TEST(BadInput, OfTwoDemosWithOneFolderTheSecondIsRefused) {
  const ScratchFolder scratch;
  const std::string run = (scratch / "run").string();
  std::vector<std::string> outputs;
  std::vector<int> statuses;
  {
    Background one({"demo", "--fast", "--rate", "40", "--out", run}, scratch / "one"),
        two({"demo", "--fast", "--rate", "40", "--out", run}, scratch / "two");
    statuses = {one.wait(), two.wait()};
  }
  for (const char* name : {"one", "two"}) outputs.push_back(read_text(scratch / name));
  const std::size_t loser = statuses[0] == 2 ? 0 : 1;
  EXPECT_EQ(statuses[loser], 2) << outputs[0] << outputs[1];
  EXPECT_NE(outputs[loser].find("holds a run already, or another demo has begun one"), std::string::npos)
      << outputs[loser];
  EXPECT_EQ(statuses[1 - loser], 0) << outputs[1 - loser];
}

}  // namespace
}  // namespace convoy::testing
