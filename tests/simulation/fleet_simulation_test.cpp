#include "fleet_simulation.hpp"

#include <gtest/gtest.h>

#include <sys/wait.h>

#include <cstdlib>
#include <string>

namespace convoy::simulation {
namespace {

constexpr std::uint64_t seeds_per_case = 20;

class FleetSimulation : public testing::TestWithParam<std::uint64_t> {};

TEST_P(FleetSimulation, NothingIsLostAndAllEndWithOneMap) {
  int crashes = 0, partitions = 0, damaged = 0, full = 0;
  for (std::uint64_t i = 0; i < seeds_per_case; ++i) {
    const std::uint64_t seed = seeds_per_case * GetParam() + i + 1;
    const Outcome outcome = simulate(seed);
    EXPECT_TRUE(outcome.failures.empty()) << report(seed, outcome);
    crashes += outcome.crashes;
    partitions += outcome.partitions;
    damaged += outcome.damaged_journals;
    full += outcome.full_disks;
  }
  EXPECT_GT(crashes, 0);
  EXPECT_GT(partitions, 0);
  EXPECT_GT(damaged, 0);
  EXPECT_GT(full, 0);
}
INSTANTIATE_TEST_SUITE_P(Seeds, FleetSimulation, testing::Range(std::uint64_t{0}, std::uint64_t{10}));

TEST(FleetSimulationReplay, TheSameSeedGivesTheSameRunToTheBit) {
  for (const std::uint64_t seed : {3U, 77U, 141U}) {
    const Outcome first = simulate(seed), second = simulate(seed);
    EXPECT_EQ(first, second) << seed;
    EXPECT_NE(first.trace, simulate(seed + 1).trace);
  }
}

TEST(FleetSimulationReplay, WhatFailsIsToldWithItsDigestAndTheCommandThatReplaysIt) {
  Outcome outcome;
  outcome.trace = 0xabcd;
  EXPECT_NE(report(77, outcome).find("digest abcd"), std::string::npos);
  EXPECT_EQ(report(77, outcome).find("again"), std::string::npos);
  outcome.failures = {"a fact is gone"};
  EXPECT_NE(report(77, outcome).find("convoy_fleet_simulation 77 1"), std::string::npos);
}

int status_of(const std::string& arguments) {
  const int status = std::system((CONVOY_FLEET_SIMULATION " " + arguments + " >/dev/null 2>&1").c_str());
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

TEST(FleetSimulationCommand, ArgumentsThatAreNoneAreRefused) {
  EXPECT_EQ(status_of("--help"), 0);
  EXPECT_EQ(status_of("1 1"), 0);
  for (const char* wrong :
       {"", "1", "1 2 3", "one 1", "1 x", "1 0", "-1 1", "1.5 1", "18446744073709551615 2", "1e3 1"})
    EXPECT_EQ(status_of(wrong), 2) << wrong;
}

}  // namespace
}  // namespace convoy::simulation
