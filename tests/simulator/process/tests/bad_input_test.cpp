// What cannot be done is said, with the place and how to mend it.
#include <gtest/gtest.h>

#include <functional>

#include "processes.hpp"

namespace convoy::simulator::testing {
namespace {

namespace fs = std::filesystem;

void expect_refused(const std::string& arguments, const std::string& message) {
  const Outcome outcome = run_sim(arguments);
  EXPECT_EQ(outcome.status, 2) << arguments << "\n" << outcome.output;
  EXPECT_NE(outcome.output.find(message), std::string::npos) << arguments << "\n" << outcome.output;
}

TEST(Options, AreChecked) {
  expect_refused("--speed 99", "--speed");
  expect_refused("--speed fast", "--speed");
  expect_refused("--vehicles 0", "--vehicles");
  expect_refused("--seed -1", "'-1' is no whole number");
  expect_refused("--camera 640", "'640' is no size");
  expect_refused("--camera 640x480x2", "'640x480x2' is no size");
  expect_refused("--camera 9999x480", "'9999x480' is no size");
  expect_refused("--gps galileo", "--gps");
  expect_refused("--offset 0,99", "--offset");
  for (const std::string option :
       {"--duration", "--distance", "--offset", "--gap", "--speed", "--drop", "--rate", "--deadline"})
    expect_refused(option + " nan" + block, "'nan' is no number from ");
  for (const std::string value : {"-nan", "inf", "1e999", "1x"})
    expect_refused("--duration=" + value + block, "'" + value + "' is no number from ");
  expect_refused("--offset 0,nan" + block, "'nan' is no number from -20 to 20");
  expect_refused("--domain-sensors 233", "--domain-sensors");
  expect_refused("--domain-sensors 11", "the truth is not for the vehicles");
  expect_refused("--lock-step --rate 2", "--rate");
  expect_refused("--replay x --record y", "exclude each other");
  expect_refused("--replay x --seed 2", "--seed");
  expect_refused("--run 0", "numbered from 1 on");
  expect_refused("--run 99999999999999999999", "is no whole number");
  expect_refused("--snapshot a.png --record b", "--record: a snapshot speaks to nobody");
  expect_refused("--list-routes --snapshot a.png", "--snapshot: --list-routes ends before anybody drives");
  expect_refused("--vehicles 2 --offset 1,2,3", "--offset: 3 for 2 vehicles");
  expect_refused("--fast", "--fast");
  expect_refused("--route nowhere" + block, "no route 'nowhere'");
  expect_refused("--vehicles 2 --route loop,loop,loop" + block, "names 3 routes for 2 vehicles");
  expect_refused("--vehicles 2 --route loop,nowhere" + block, "no route 'nowhere'");
  expect_refused("--lock-step --vehicles 1 --wait-for 2 --world none.osm", "there are only 1 vehicles");
}

TEST(Options, ANameThatIsEmptyIsNotTakenForNone) {
  const ScratchFolder scratch;
  for (const std::string named : {"--record", "--replay", "--snapshot", "--world"}) {
    std::vector<std::string> command = sim_command("--duration 0.1");
    command.insert(command.end(), {named, ""});
    Process sim(command, scratch / "output");
    EXPECT_EQ(sim.wait(), 2) << named;
    EXPECT_NE(sim.output().find(named + ": the name is empty"), std::string::npos) << sim.output();
  }
}

TEST(Output, ThatCannotBeWrittenIsAnError) {
  Process sim(sim_command("--list-routes" + block), "/dev/full");
  EXPECT_EQ(sim.wait(), 2);
}

TEST(Snapshot, IsAPicture) {
  const ScratchFolder scratch;
  const std::string file = (scratch / "view.png").string();
  const Outcome outcome = run_sim("--duration 2 --snapshot " + file + block);
  EXPECT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("OpenStreetMap contributors"), std::string::npos) << outcome.output;
  EXPECT_EQ(read_text(file).substr(1, 3), "PNG");
}

TEST(World, IsNotBuiltForWhatIsWrongWithoutIt) {
  const ScratchFolder scratch;
  write_text(scratch / "taken", "");
  const auto expect_refused_at_once = [](const std::string& arguments, const std::string& message) {
    const Outcome outcome = run_sim(arguments);
    EXPECT_EQ(outcome.status, 2) << arguments << "\n" << outcome.output;
    EXPECT_NE(outcome.output.find(message), std::string::npos) << arguments << "\n" << outcome.output;
    EXPECT_EQ(outcome.output.find("building the world"), std::string::npos) << outcome.output;
  };
  expect_refused_at_once("--snapshot " + (scratch / "none/view.png").string(), "there is no folder");
  expect_refused_at_once("--snapshot " + (scratch / "view.jpg").string(), "must end in .png");
  expect_refused_at_once("--record " + (scratch / "").string(), "there is something already");
  expect_refused_at_once("--record " + (scratch / "taken").string(), "there is something already");
  expect_refused_at_once("--wait-for 2", "there are only 1 vehicles");
  expect_refused_at_once("--route nowhere", "no route 'nowhere'; there are: loop, ");
}

TEST(World, ThatIsNotWholeIsUsedWithAWord) {
  const ScratchFolder scratch;
  std::string map = read_text(CONVOY_SIM_TEST_MAP);
  map.replace(map.find("<nd ref=\"22\"/><nd ref=\"23\"/>"), 28, "<nd ref=\"23\"/><nd ref=\"22\"/>");
  write_text(scratch / "map.osm", map);
  const Outcome outcome = run_sim("--list-routes --world " + (scratch / "map.osm").string());
  EXPECT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("1 building left out: self-crossing 1 (first: way 20, line 18)"), std::string::npos)
      << outcome.output;
}

TEST(World, ThatIsNoneIsRefused) {
  const ScratchFolder scratch;
  expect_refused("--world " + (scratch / "none.osm").string(), "none.osm");
  write_text(scratch / "bad.osm", "this is no map");
  expect_refused("--world " + (scratch / "bad.osm").string(), "bad.osm");
  expect_refused("--world " + (scratch / ".").string(), "convoy sim: ");
}

/// Records until a file of the recording is to grow beyond so many bytes: which one that is.
void expect_told_of_full_disk(const fs::path& folder, int bytes, const std::string& file) {
  const Outcome outcome = run_sim_on_full_disk(bytes, "--gps rtk --duration 3 --lock-step --wait-for 0 --record " +
                                                          folder.string() + block + domains_of_this_test());
  EXPECT_EQ(outcome.status, 2) << bytes << "\n" << outcome.output;
  const std::string words = file + " cannot be written: File too large; make room there";
  EXPECT_NE(outcome.output.find(words), std::string::npos) << bytes << "\n" << outcome.output;
  EXPECT_FALSE(fs::exists(folder / "end.json")) << bytes;
}

TEST(FullDisk, IsToldAndTheRecordingIsRefused) {
  const ScratchFolder scratch;
  expect_told_of_full_disk(scratch / "first", 100, "run.json");
  expect_told_of_full_disk(scratch / "early", 500, "camera.yaml");
  expect_told_of_full_disk(scratch / "picture", 1500, "000000.png");
  expect_told_of_full_disk(scratch / "table", 6000, "odometry.csv");

  const std::string replay = "--lock-step --wait-for 0 --replay ";
  expect_refused(replay + (scratch / "table").string(), "end.json is missing");
  const std::size_t steps = lines_of(read_text(scratch / "table/vehicle_1/truth.csv")).size() - 1;
  const Outcome outcome = run_sim(replay + (scratch / "table").string() + " --as-is" + domains_of_this_test());
  EXPECT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("vehicle 1: " + std::to_string(steps) + " frames"), std::string::npos)
      << outcome.output;
}

TEST(FullDisk, IsToldOfASnapshot) {
  const ScratchFolder scratch;
  const Outcome outcome =
      run_sim_on_full_disk(1500, "--duration 0.1 --snapshot " + (scratch / "view.png").string() + block);
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find("view.png cannot be written"), std::string::npos) << outcome.output;
}

class BadRecording : public ::testing::Test {
 protected:
  void SetUp() override {
    const Outcome outcome = run_sim("--gps standard --duration 1 --lock-step --wait-for 0 --record " +
                                    folder().string() + block + domains_of_this_test());
    ASSERT_EQ(outcome.status, 0) << outcome.output;
  }
  fs::path folder() const { return scratch_ / "recording"; }

  /// Spoils one file of the recording, and puts it right again.
  void expect_refused_with(const std::string& file, const std::function<std::string(std::string)>& spoil,
                           const std::string& message, const std::string& options = {}) {
    const std::string right = read_text(folder() / file);
    write_text(folder() / file, spoil(right));
    expect_refused(replay() + options, message);
    write_text(folder() / file, right);
  }
  std::string replay() const {
    return "--lock-step --wait-for 0 --replay " + folder().string() + domains_of_this_test();
  }

  ScratchFolder scratch_;
};

/// The n-th line, from 1 on, is another one.
std::function<std::string(std::string)> line_is(std::size_t number, const std::string& text) {
  return [=](const std::string& whole) {
    std::vector<std::string> lines = lines_of(whole);
    lines.at(number - 1) = text;
    std::string changed;
    for (const std::string& line : lines) changed += line + "\n";
    return changed;
  };
}

TEST_F(BadRecording, IsRefusedWithFileAndLine) {
  const auto nothing = [](const std::string&) { return std::string(); };
  expect_refused_with("run.json", nothing, "run.json: ");
  expect_refused_with(
      "run.json", [](std::string s) { return s.replace(s.find("\"format\": 1"), 11, "\"format\": 2"); },
      "of another version");
  expect_refused_with("vehicle_1/camera.yaml", nothing, "camera.yaml");
  expect_refused_with(
      "vehicle_1/camera.yaml",
      [](std::string s) { return s.replace(s.find("image_width: 64"), 15, "image_width: 65"); },
      "000000.png is 64 x 48, not 65 x 48", " --as-is");
  expect_refused_with("vehicle_1/frames.csv", nothing, "frames.csv:1: the file is empty");
  expect_refused_with("vehicle_1/frames.csv", line_is(1, "frame,stamp"), "frames.csv:1: the header is");
  expect_refused_with("vehicle_1/frames.csv", line_is(4, "3,2,0.3"), "frames.csv:4: 3 fields instead of 4");
  expect_refused_with("vehicle_1/frames.csv", line_is(4, "3,2,soon,00"), "frames.csv:4: field 3: 'soon' is no number");
  expect_refused_with("vehicle_1/frames.csv", line_is(4, "1,2,0.3,00"), "frames.csv:4: step 1 comes after step 2");
  expect_refused_with("vehicle_1/frames.csv", line_is(4, "3,77,0.3,00"), "frames.csv:4: there is no ", " --as-is");
  expect_refused_with("vehicle_1/frames.csv", line_is(4, "3,2,0.3,00"), "000002.png is not the picture that was",
                      " --as-is");
  expect_refused_with("vehicle_1/images/000003.png", nothing, "000003.png is no picture");
  expect_refused_with("vehicle_1/truth.csv", line_is(5, lines_of(read_text(folder() / "vehicle_1/truth.csv"))[5]),
                      "truth.csv:5: this row should be of step 4");
  expect_refused_with("vehicle_1/odometry.csv", line_is(3, "1,-1,0,0,0,0,0,0,0,0,0,0"), "odometry.csv:3: field 2");
  expect_refused_with(
      "vehicle_1/gps.csv", [](std::string s) { return s.replace(s.find("standard"), 8, "galileo"); },
      "gps.csv:2: 'galileo' is no kind of GPS");
  expect_refused_with(
      "vehicle_1/gps.csv", [](std::string s) { return s.replace(s.find(",1,"), 3, ",nan,"); }, "gps.csv:");
  fs::remove(folder() / "vehicle_1/odometry.csv");
  expect_refused("--lock-step --wait-for 0 --replay " + folder().string(), "odometry.csv cannot be read");
}

/// Without the last n lines.
std::function<std::string(std::string)> without_last(std::size_t n) {
  return [=](const std::string& whole) {
    std::vector<std::string> lines = lines_of(whole);
    std::string left;
    for (std::size_t i = 0; i + n < lines.size(); ++i) left += lines[i] + "\n";
    return left;
  };
}

TEST_F(BadRecording, ThatWasCutOrChangedIsRefused) {
  expect_refused_with("vehicle_1/truth.csv", without_last(3),
                      "truth.csv: the recording ends at step 7 of 10: it was cut; --as-is replays what is there");
  for (const std::string table : {"frames.csv", "odometry.csv", "gps.csv"})
    expect_refused_with("vehicle_1/" + table, without_last(1), table + " is not what was recorded");
  expect_refused_with(
      "vehicle_1/odometry.csv", [](std::string s) { return s.replace(s.rfind('.') + 1, 1, "9"); },
      "odometry.csv is not what was recorded");
  const auto with_focal = [](const std::string& focal) {
    return [=](std::string s) {
      const std::size_t from = s.find("data: [") + 7;
      return s.replace(from, s.find(',', from) - from, focal);
    };
  };
  expect_refused_with("vehicle_1/camera.yaml", with_focal(" 123."), "camera.yaml is not what was recorded");
  for (const char* focal : {" 0.", " -40.", " .Nan", " .Inf"})
    expect_refused_with("vehicle_1/camera.yaml", with_focal(focal), "camera.yaml: ", " --as-is");
  expect_refused_with(
      "run.json", [](std::string s) { return s.replace(s.find("\"step_s\": 0.1"), 13, "\"step_s\": 0.2"); },
      "run.json is not what was recorded");
  expect_refused_with(
      "end.json", [](std::string s) { return s.replace(s.find("10"), 2, "11"); }, "end.json is not what was recorded");
  expect_refused_with(
      "end.json", [](const std::string&) { return std::string("{}"); }, "end.json: ");
  fs::remove(folder() / "end.json");
  expect_refused(replay(), "end.json is missing: the recording was interrupted, and ends at step 10");
}

TEST_F(BadRecording, IsPlayedAsItIsWhereThatIsAskedFor) {
  fs::remove(folder() / "end.json");
  const std::string truth = read_text(folder() / "vehicle_1/truth.csv");
  write_text(folder() / "vehicle_1/truth.csv", without_last(3)(truth));
  const Outcome outcome = run_sim(replay() + " --as-is");
  EXPECT_EQ(outcome.status, 0) << outcome.output;
  EXPECT_NE(outcome.output.find("end.json is missing"), std::string::npos) << outcome.output;
  EXPECT_NE(outcome.output.find("vehicle 1: 7 frames"), std::string::npos) << outcome.output;
}

TEST_F(BadRecording, IsNotWrittenOverAnother) {
  expect_refused("--duration 1 --lock-step --wait-for 0 --record " + folder().string() + block + domains_of_this_test(),
                 "there is something already");
}

}  // namespace
}  // namespace convoy::simulator::testing
