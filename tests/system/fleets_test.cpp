// Two fleets on one domain: their vehicles have the same ids, and must not be taken for one another.
#include <gtest/gtest.h>

#include <unistd.h>

#include <csignal>
#include <fstream>

#include "command.hpp"

namespace convoy::testing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::string domain() { return std::to_string(5 + getpid() % 14); }

// Vehicle 1 with a start that is known, so that it is aligned, and twelve seconds of driving. `speech`: its profile,
// and further attributes of <dds>.
fs::path vehicle_one(const fs::path& folder, const std::string& speech = "loopback_udp.xml") {
  fs::create_directories(folder);
  std::ofstream sensors(folder / "sensors.csv");
  sensors << "t_s,kind,a,b,c\n";
  for (int i = 0; i <= 120; ++i) sensors << 0.1 * i << ",odometry,1,0,\n";
  std::ofstream(folder / "c.xml")
      << "<convoy version=\"1\">\n  <vehicle id=\"1\" state_folder=\"state\"/>\n  <static_bias sigma_x_m=\"0.1\"/>\n  "
         "<dds domain=\""
      << domain() << "\" profile=\"" CONVOY_SOURCE_FOLDER "/qos_profiles/" << speech
      << "\"/>\n  <sensors file=\"sensors.csv\" rate=\"2\"/>\n</convoy>\n";
  return folder / "c.xml";
}

bool impersonated(const json& status) {
  return std::count(status["reasons"].begin(), status["reasons"].end(), json("impersonated")) == 1;
}

void expect_no_demo(const fs::path& run) {
  const Outcome refused = run_convoy("demo --fast --domain " + domain() + " --out " + run.string());
  EXPECT_EQ(refused.status, 2);
  EXPECT_NE(refused.output.find("another convoy fleet is heard on DDS domain " + domain()), std::string::npos)
      << refused.output;
  EXPECT_FALSE(fs::exists(run));
}

TEST(Fleets, OfTwoVehiclesWithOneIdTheLaterIsRefusedAndBothAreSuspectEverywhereItShows) {
  const ScratchFolder scratch;
  std::vector<fs::path> configs{vehicle_one(scratch / "one"), vehicle_one(scratch / "two")};
  std::vector<int> ends;
  {
    Background one({"vehicle", "--until-end", configs[0].string()}, scratch / "one/output");
    Background two({"vehicle", "--until-end", configs[1].string()}, scratch / "two/output");
    ends = {one.wait(), two.wait()};
  }
  std::vector<std::uint64_t> epochs;
  for (const fs::path& config : configs) {
    const fs::path folder = config.parent_path();
    const json summary = read_json(folder / "summary.json");
    EXPECT_EQ(summary["integrity"], "SUSPECT");
    EXPECT_TRUE(impersonated(summary)) << summary;
    EXPECT_GT(summary["counters"]["senders_impersonated"], 0);
    epochs.push_back(summary["epoch"]);
    // The last status line says what the summary says, in the same words.
    std::ifstream output(folder / "output");
    json status;
    for (std::string line; std::getline(output, line);)
      if (const json parsed = json::parse(line, nullptr, false); parsed.is_object()) status = parsed;
    ASSERT_TRUE(status.is_object());
    status.erase("exhausted");
    for (const auto& [key, value] : status.items()) EXPECT_EQ(summary[key], value) << key;
    EXPECT_TRUE(impersonated(status));
  }
  ASSERT_NE(epochs[0], epochs[1]);
  const std::size_t later = epochs[1] > epochs[0] ? 1 : 0;
  EXPECT_EQ(ends[1 - later], 0);
  EXPECT_EQ(ends[later], 2);
  EXPECT_NE(read_text(configs[later].parent_path() / "output").find("runs already in another process on domain"),
            std::string::npos);
}

TEST(Fleets, OneVehicleAloneIsNotSuspect) {
  const ScratchFolder scratch;
  const fs::path config = vehicle_one(scratch / "one");
  for (int life = 0; life < 2; ++life) {  // nor is it after a restart
    const Outcome outcome = run_convoy("vehicle --until-end " + config.string());
    ASSERT_EQ(outcome.status, 0) << outcome.output;
    EXPECT_EQ(read_json(scratch / "one/summary.json")["reasons"], json::array());
  }
}

TEST(Fleets, AVehicleThatHearsNobodySaysSoAndHowItSpeaks) {
  const ScratchFolder scratch;
  const fs::path config = vehicle_one(scratch / "one"), output = scratch / "output";
  std::string text = read_text(config);
  const std::string folder = "state_folder=\"state\"/>";
  text.replace(text.find(folder), folder.size(),
               "state_folder=\"state\" journal=\"true\"/>\n  <budget bytes_per_s=\"2000\"/>");
  std::ofstream(config) << text;
  {
    Background alone({"vehicle", config.string()}, output);
    EXPECT_TRUE(
        eventually([&] { return read_text(output).find("no other vehicle is there for 10 s") != std::string::npos; }));
    alone.send(SIGTERM);
    EXPECT_EQ(alone.wait(), 0);
  }
  const std::string said = read_text(output);
  const auto says = [&](const std::string& words) {
    EXPECT_NE(said.find(words), std::string::npos) << words << "\n" << said;
  };
  says(" on domain " + domain() +
       ", profile loopback_udp.xml, interfaces of the profile, without DDS Security, budget 2000 B/s");
  says("journal: 0 facts restored");
  says("a budget wants a profile without, such as low_bandwidth.xml");
  says("check that others run, with the same domain, profile");
  says("\"peers\":0");
  EXPECT_EQ(read_json(scratch / "one/summary.json")["peers"], 0);

  // Again, from a journal that was damaged.
  std::fstream journal(scratch / "one/state/facts.journal", std::ios::in | std::ios::out | std::ios::binary);
  journal.seekp(100);
  journal.put('!');
  journal.close();
  Background again({"vehicle", config.string()}, scratch / "again");
  EXPECT_TRUE(eventually([&] { return read_text(scratch / "again").find("\"peers\"") != std::string::npos; }));
  again.send(SIGTERM);
  EXPECT_EQ(again.wait(), 0);
  EXPECT_NE(read_text(scratch / "again").find("bytes were damaged and are passed over; peers are asked"),
            std::string::npos)
      << read_text(scratch / "again");
  EXPECT_GT(read_json(scratch / "one/summary.json")["counters"]["journal"]["damaged_bytes"], 0);
}

TEST(Fleets, ADemoDoesNotBeginWhereAnotherFleetIsHeard) {
  const ScratchFolder scratch;
  const fs::path config = vehicle_one(scratch / "one");
  Background other({"vehicle", config.string()}, scratch / "output");
  ASSERT_TRUE(eventually([&] { return read_text(scratch / "output").find("\"vehicle_s\"") != std::string::npos; }));
  const fs::path run = scratch / "run";
  expect_no_demo(run);
  other.send(SIGKILL);
  other.wait();
  const Outcome alone = run_convoy("demo --fast --rate 40 --domain " + domain() + " --out " + run.string());
  EXPECT_EQ(alone.status, 0) << alone.output;
  for (const json& vehicle : read_json(run / "metrics.json")["vehicles"]) EXPECT_EQ(vehicle["reasons"], json::array());
}

TEST(Fleets, ADemoDoesNotBeginBesideAFleetOfAnotherProfile) {
  const ScratchFolder scratch;
  const fs::path config =
      vehicle_one(scratch / "one", "low_bandwidth.xml\" interfaces=\"127.0.0.1");  // best effort: not heard, only found
  Background other({"vehicle", config.string()}, scratch / "output");
  ASSERT_TRUE(eventually([&] { return read_text(scratch / "output").find("\"vehicle_s\"") != std::string::npos; }));
  expect_no_demo(scratch / "run");
}

TEST(Fleets, AMissingSensorLogIsToldWithTheLineThatNamesIt) {
  const ScratchFolder scratch;
  const fs::path config = vehicle_one(scratch / "one");
  fs::remove(scratch / "one/sensors.csv");
  const Outcome outcome = run_convoy("vehicle " + config.string());
  EXPECT_EQ(outcome.status, 2);
  EXPECT_NE(outcome.output.find(config.string() + ":5: " + (scratch / "one/sensors.csv").string() + ": no such file"),
            std::string::npos)
      << outcome.output;
}

TEST(Fleets, ADemoIntoWhichAnotherFleetBreaksSaysSoAndFails) {
  const ScratchFolder scratch;
  const fs::path config = vehicle_one(scratch / "one"), run = scratch / "run";
  Background demo({"demo", "--fast", "--rate", "20", "--domain", domain(), "--out", run.string()}, scratch / "output");
  ASSERT_TRUE(eventually([&] { return read_text(run / "vehicle_1/live.csv").size() > 1000; }));
  Background other({"vehicle", config.string()}, scratch / "one/output");
  EXPECT_EQ(demo.wait(), 1);
  const std::string output = read_text(scratch / "output");
  EXPECT_NE(output.find("vehicle 1 is SUSPECT: somebody else speaks under its id on DDS domain " + domain()),
            std::string::npos)
      << output;
  EXPECT_NE(output.find("Front vehicle is SUSPECT: "), std::string::npos) << output;  // in the headline, too
  EXPECT_TRUE(impersonated(read_json(run / "metrics.json")["vehicles"][0]));
}

}  // namespace
}  // namespace convoy::testing
