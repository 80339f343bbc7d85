// The simulator and vehicles as processes of their own, over sockets.
#include <gtest/gtest.h>

#include <signal.h>

#include <chrono>
#include <cstdio>
#include <memory>
#include <thread>

#include "processes.hpp"

namespace convoy::simulator::testing {
namespace {

using std::chrono::steady_clock;

const std::string small = block + " --gps rtk --duration 2 --lock-step";

/// A run with vehicles, and what each of them says.
struct Fleet {
  Fleet(const std::string& sim_arguments, const std::vector<std::string>& vehicle_arguments) {
    sim = std::make_unique<Process>(sim_command(sim_arguments + domains_of_this_test()), scratch / "sim");
    for (std::size_t i = 0; i < vehicle_arguments.size(); ++i)
      vehicles.push_back(
          std::make_unique<Process>(vehicle_command("--domain " + std::to_string(domain_of_this_test()) +
                                                    " --vehicle " + std::to_string(i + 1) + " " + vehicle_arguments[i]),
                                    scratch / ("vehicle_" + std::to_string(i + 1))));
  }
  void expect_success() {
    EXPECT_EQ(sim->wait(), 0) << sim->output();
    for (const auto& vehicle : vehicles) EXPECT_EQ(vehicle->wait(), 0) << vehicle->output() << sim->output();
  }
  std::string said(std::size_t vehicle) const { return vehicles.at(vehicle - 1)->output(); }

  ScratchFolder scratch;
  std::unique_ptr<Process> sim;
  std::vector<std::unique_ptr<Process>> vehicles;
};

std::size_t steps_of(const std::string& said) {
  std::size_t count = 0;
  for (const std::string& line : lines_of(said)) count += line.rfind("step ", 0) == 0;
  return count;
}

/// What the simulator says at the end of what it has sent, digests and all.
std::string sums_of(const std::string& output) {
  std::string sums;
  for (const std::string& line : lines_of(output))
    if (line.rfind("vehicle ", 0) == 0) sums += line + "\n";
  EXPECT_NE(sums.find("digest"), std::string::npos) << output;
  return sums;
}

TEST(LockStep, IsTheSameFromOneProcessToTheNextHoweverSlowTheVehicles) {
  Fleet first("--vehicles 2 --seed 7" + small, {"", ""});
  first.expect_success();
  EXPECT_EQ(steps_of(first.said(1)), 20U) << first.said(1);
  EXPECT_NE(first.said(1), first.said(2));
  EXPECT_NE(first.said(1).find("frame 0"), std::string::npos);
  EXPECT_NE(first.said(1).find("camera 64x48"), std::string::npos);

  Fleet again("--vehicles 2 --seed 7" + small, {"--delay-ms 40", "--delay-ms 3"});
  again.expect_success();
  EXPECT_EQ(first.said(1), again.said(1));
  EXPECT_EQ(first.said(2), again.said(2));
  EXPECT_EQ(sums_of(first.sim->output()), sums_of(again.sim->output()));

  Fleet other("--vehicles 2 --seed 8" + small, {"", ""});
  other.expect_success();
  EXPECT_NE(first.said(1), other.said(1));
}

TEST(LockStep, NamesTheVehicleThatDoesNotAnswer) {
  const ScratchFolder scratch;
  Fleet fleet("--vehicles 2 --deadline 4 --record " + (scratch / "recording").string() + small,
              {"", "--silent-from 3"});
  EXPECT_EQ(fleet.sim->wait(), 1);
  EXPECT_NE(fleet.sim->output().find("vehicle 2 did not answer step 3 within 4 s"), std::string::npos)
      << fleet.sim->output();
  EXPECT_NE(fleet.sim->output().find("waiting for vehicle 2 to answer step 3, for 2 s of 4 s; Ctrl-C ends the run"),
            std::string::npos)
      << fleet.sim->output();
  EXPECT_EQ(steps_of(fleet.said(1)), 3U);
  const std::string end = read_text(scratch / "recording/end.json");
  EXPECT_NE(end.find("\"steps\": 3"), std::string::npos) << end;
  EXPECT_NE(end.find("\"complete\": false"), std::string::npos) << end;
}

TEST(LockStep, NamesTheVehicleThatDoesNotAppear) {
  Fleet fleet("--vehicles 3 --wait-for 3 --deadline 4" + small, {"", ""});
  EXPECT_EQ(fleet.sim->wait(), 1);
  EXPECT_NE(fleet.sim->output().find("vehicle 3 did not appear on domain"), std::string::npos) << fleet.sim->output();
  EXPECT_NE(fleet.sim->output().find("waiting for vehicle 3 to appear on domain"), std::string::npos)
      << fleet.sim->output();
  EXPECT_EQ(steps_of(fleet.said(1)), 0U);
}

/// Until the vehicle has said so many steps; false: it has not.
bool waits_for_steps(const Fleet& fleet, std::size_t count, std::size_t vehicle = 1) {
  const auto deadline = steady_clock::now() + std::chrono::seconds(20);
  while (steps_of(fleet.said(vehicle)) < count) {
    if (steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return true;
}

const std::string endless = block + " --duration 1000 --lock-step --deadline 4";

TEST(LockStep, NamesTheVehicleThatWasKilled) {
  Fleet fleet("--vehicles 2" + endless, {"", ""});
  ASSERT_TRUE(waits_for_steps(fleet, 3, 2)) << fleet.sim->output();
  fleet.vehicles[1]->send(SIGKILL);
  EXPECT_EQ(fleet.sim->wait(), 1);
  EXPECT_NE(fleet.sim->output().find("convoy sim: vehicle 2 did not answer step "), std::string::npos)
      << fleet.sim->output();
}

TEST(LockStep, NamesTheVehicleThatWasKilledThoughNobodyWaitedForIt) {
  Fleet fleet("--vehicles 3 --wait-for 1" + endless, {"--delay-ms 20", "", ""});
  ASSERT_TRUE(waits_for_steps(fleet, 3, 2) && waits_for_steps(fleet, 3, 3)) << fleet.sim->output();
  fleet.vehicles[1]->send(SIGKILL);
  EXPECT_EQ(fleet.sim->wait(), 1);
  EXPECT_NE(fleet.sim->output().find("convoy sim: vehicle 2 did not answer step "), std::string::npos)
      << fleet.sim->output();
}

TEST(LockStep, SaysOfASubscriberThatIsNoVehicleThatItIsNone) {
  Fleet fleet(endless, {"--delay-ms 50"});
  const Process other(vehicle_command("--domain " + std::to_string(domain_of_this_test()) + " --vehicle 9"),
                      fleet.scratch / "other");
  ASSERT_TRUE(waits_for_steps(fleet, 20)) << fleet.sim->output();
  other.send(SIGSTOP);
  EXPECT_EQ(fleet.sim->wait(), 1);
  EXPECT_NE(fleet.sim->output().find(", which is none of the vehicles, has not taken"), std::string::npos)
      << fleet.sim->output();
}

TEST(LockStep, CanBeEndedWhileASubscriberDoesNotTake) {
  Fleet fleet(block + " --duration 1000 --lock-step --deadline 1000", {"--delay-ms 50"});
  const Process other(vehicle_command("--domain " + std::to_string(domain_of_this_test()) + " --vehicle 9"),
                      fleet.scratch / "other");
  ASSERT_TRUE(waits_for_steps(fleet, 20)) << fleet.sim->output();
  other.send(SIGSTOP);
  const auto deadline = steady_clock::now() + std::chrono::seconds(30);
  while (fleet.sim->output().find("to take what was sent") == std::string::npos && steady_clock::now() < deadline)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  fleet.sim->send(SIGINT);
  EXPECT_EQ(fleet.sim->wait(), 128 + SIGINT);
  EXPECT_NE(fleet.sim->output().find("stopped at step"), std::string::npos) << fleet.sim->output();
}

TEST(LockStep, WaitsForThoseOnlyThatItIsToldTo) {
  Fleet fleet("--vehicles 2 --wait-for 1" + small, {""});
  fleet.expect_success();
  EXPECT_EQ(steps_of(fleet.said(1)), 20U);
}

TEST(LockStep, AnswersThatComeLateDoNotTakeBackThoseBefore) {
  Fleet fleet("--deadline 5" + small, {"--stale 1"});
  fleet.expect_success();
  EXPECT_EQ(steps_of(fleet.said(1)), 20U);
}

TEST(LockStep, AnAnswerThatIsNoneEndsNobody) {
  Fleet fleet("--deadline 2" + small, {"--garbage 1"});
  EXPECT_EQ(fleet.sim->wait(), 1);
  EXPECT_NE(fleet.sim->output().find("vehicle 1 did not appear"), std::string::npos) << fleet.sim->output();
}

TEST(Routes, EachVehicleDrivesItsOwn) {
  const ScratchFolder scratch;
  const auto drive = [&](const std::string& name, const std::string& arguments, std::size_t vehicles) {
    Fleet fleet(arguments + " --record " + (scratch / name).string() + small, std::vector<std::string>(vehicles));
    fleet.expect_success();
  };
  drive("two", "--vehicles 2 --route loop,loop_opposite", 2);
  drive("one", "--route loop_opposite", 1);
  const std::string truth = read_text(scratch / "two/vehicle_2/truth.csv");
  EXPECT_EQ(truth, read_text(scratch / "one/vehicle_1/truth.csv"));
  EXPECT_NE(truth, read_text(scratch / "two/vehicle_1/truth.csv"));
}

TEST(Topics, TheTruthIsOnADomainOfItsOwn) {
  const ScratchFolder scratch;
  Fleet fleet("--truth-depth --record " + (scratch / "recording").string() + small,
              {"--truth-domain " + std::to_string(domain_of_this_test() + 1)});
  fleet.expect_success();
  std::vector<std::string> heard;
  for (const std::string& line : lines_of(fleet.said(1)))
    if (line.rfind("truth ", 0) == 0) heard.push_back(line);
  const std::vector<std::string> rows = lines_of(read_text(scratch / "recording/vehicle_1/truth.csv"));
  ASSERT_EQ(heard.size() + 1, rows.size());
  for (std::size_t i = 0; i < heard.size(); ++i) {
    double time_s = 0.0, x = 0.0, y = 0.0, heard_x = 1.0, heard_y = 1.0;
    unsigned step = 0, solid = 0, pixels = 0;
    ASSERT_EQ(std::sscanf(rows[i + 1].c_str(), "%u,%lf,%lf,%lf", &step, &time_s, &x, &y), 4);
    ASSERT_EQ(std::sscanf(heard[i].c_str(), "truth %lf %lf depth %u of %u", &heard_x, &heard_y, &solid, &pixels), 4);
    EXPECT_EQ(heard_x, x);
    EXPECT_EQ(heard_y, y);
    EXPECT_EQ(pixels, 64U * 48U);
    EXPECT_GT(solid, pixels / 3);  // the street
    EXPECT_LT(solid, pixels);      // and the sky
  }
}

TEST(Topics, AreOnTheLoopbackDeviceAlone) {
  Fleet fleet("--rate 1 --duration 1000" + block, {""});
  const auto deadline = steady_clock::now() + std::chrono::seconds(20);
  while (steps_of(fleet.said(1)) == 0 && steady_clock::now() < deadline)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  const std::vector<std::string> addresses = fleet.sim->udp_addresses();
  EXPECT_GE(addresses.size(), 6U) << "the sockets of two participants were expected here";
  for (const std::string& address : addresses)
    EXPECT_TRUE(address == "0100007F" || address == "0100FFEF") << address << ": neither 127.0.0.1 nor 239.255.0.1";
}

const std::string other_speaks = "another simulator speaks on domain";

TEST(Topics, OfTwoSimulatorsOnOneDomainTheLaterGivesUp) {
  Fleet first("--rate 0.1 --duration 1000" + block, {""});  // a step in a second
  ASSERT_TRUE(waits_for_steps(first, 1)) << first.sim->output();
  Fleet second("--rate 1 --duration 1000" + block, {});  // before the third step of the first
  EXPECT_EQ(second.sim->wait(), 2);
  EXPECT_NE(second.sim->output().find(other_speaks), std::string::npos) << second.sim->output();
  EXPECT_TRUE(waits_for_steps(first, 5)) << "the first one goes on: " << first.sim->output();
  EXPECT_EQ(first.said(1).find("senders"), std::string::npos) << "the second one was ready to send";
}

TEST(Topics, OfTwoSimulatorsThatStartAtOnceOneGivesUp) {
  Fleet one("--rate 1 --duration 1000" + block, {""}), other("--rate 1 --duration 1000" + block, {});
  const auto deadline = steady_clock::now() + std::chrono::seconds(20);
  // While they look whether there is another one, both are held, until the second for it is over: neither has found
  // one.
  for (const Fleet* fleet : {&one, &other})
    while (fleet->sim->udp_addresses().size() < 6 && steady_clock::now() < deadline)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  one.sim->send(SIGSTOP), other.sim->send(SIGSTOP);
  std::this_thread::sleep_for(std::chrono::milliseconds(1200));
  one.sim->send(SIGCONT), other.sim->send(SIGCONT);
  const auto gave_up = [](const Fleet& fleet) { return fleet.sim->output().find(other_speaks) != std::string::npos; };
  while (!gave_up(one) && !gave_up(other) && steady_clock::now() < deadline)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_TRUE(waits_for_steps(one, 20)) << one.sim->output() << other.sim->output();  // of whichever is left
  EXPECT_NE(gave_up(one), gave_up(other)) << one.sim->output() << other.sim->output();
}

TEST(WallClock, KeepsToTheRate) {
  const auto start = steady_clock::now();
  Fleet fleet("--duration 3 --rate 2 --wait-for 1" + block, {""});
  fleet.expect_success();
  EXPECT_GE(steady_clock::now() - start, std::chrono::milliseconds(1500));
  EXPECT_EQ(steps_of(fleet.said(1)), 30U);
}

TEST(Recording, ReplayedIsWhatItWas) {
  const ScratchFolder scratch;
  const std::string folder = (scratch / "recording").string();
  Fleet live("--vehicles 2 --offset 0,2 --record " + folder + small, {"", ""});
  live.expect_success();
  // What went over the wire is what was recorded.
  const std::vector<std::string> rows = lines_of(read_text(scratch / "recording/vehicle_2/frames.csv"));
  ASSERT_EQ(rows.size(), 21U);
  for (std::size_t i = 1; i < rows.size(); ++i)
    EXPECT_NE(live.said(2).find(rows[i].substr(rows[i].rfind(',') + 1)), std::string::npos) << rows[i];

  Fleet replay("--lock-step --replay " + folder, {"", "--delay-ms 10"});
  replay.expect_success();
  EXPECT_EQ(live.said(1), replay.said(1));
  EXPECT_EQ(live.said(2), replay.said(2));
  EXPECT_EQ(sums_of(live.sim->output()), sums_of(replay.sim->output()));
}

TEST(Recording, EndsWithARunThatIsEnded) {
  const ScratchFolder scratch;
  const std::string folder = (scratch / "recording").string();
  Fleet live("--record " + folder + " --duration 1000 --rate 5" + block, {});
  const auto rows = [&] { return lines_of(read_text(scratch / "recording/vehicle_1/truth.csv")).size(); };
  for (const auto deadline = steady_clock::now() + std::chrono::seconds(20);
       rows() < 4 && steady_clock::now() < deadline;)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  live.sim->send(SIGTERM);
  EXPECT_EQ(live.sim->wait(), 128 + SIGTERM) << live.sim->output();
  const std::size_t steps = rows() - 1;
  EXPECT_GE(steps, 3U);
  EXPECT_NE(live.sim->output().find("stopped at step " + std::to_string(steps)), std::string::npos)
      << live.sim->output();
  Fleet replay("--lock-step --replay " + folder, {""});
  replay.expect_success();
  EXPECT_EQ(steps_of(replay.said(1)), steps);
  EXPECT_NE(replay.sim->output().find("the run was stopped at step " + std::to_string(steps)), std::string::npos)
      << replay.sim->output();
}

}  // namespace
}  // namespace convoy::simulator::testing
