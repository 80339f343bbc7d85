#include "fleet_simulation.hpp"

#include <gtest/gtest.h>

namespace convoy::simulation {
namespace {

constexpr std::uint64_t seeds_per_case = 20;

class FleetSimulation : public testing::TestWithParam<std::uint64_t> {};

TEST_P(FleetSimulation, NothingIsLostAndAllEndWithOneMap) {
  int crashes = 0, partitions = 0, damaged = 0, full = 0;
  for (std::uint64_t i = 0; i < seeds_per_case; ++i) {
    const std::uint64_t seed = seeds_per_case * GetParam() + i + 1;
    const Outcome outcome = simulate(seed);
    EXPECT_TRUE(outcome.failures.empty()) << "seed " << seed << ": " << to_string(outcome);
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

}  // namespace
}  // namespace convoy::simulation
