// `convoy bench network`: real processes, and a file with what was measured.
#include <gtest/gtest.h>

#include "command.hpp"

namespace convoy::testing {
namespace {

using nlohmann::json;

TEST(BenchNetwork, AnAuthorDiesAndItsFactsReachAllOthers) {
  const ScratchFolder scratch;
  const Outcome outcome = run_convoy("bench network --case dead_author --out " + (scratch / "bench").string());
  EXPECT_EQ(outcome.status, 0) << outcome.output;
  const json cases = read_json(scratch / "bench/network.json")["cases"];
  ASSERT_EQ(cases.size(), 1U);
  EXPECT_EQ(cases[0]["case"], "dead_author");
  EXPECT_EQ(cases[0]["met"], true) << cases[0].dump(1);
  const json& details = cases[0]["details"];
  EXPECT_EQ(details["reached_the_one"], true);
  EXPECT_EQ(details["complete"], true);
  EXPECT_LT(details["most_facts_of_the_others_at_its_death"], 20);  // chains, and not the 210 of the author
  EXPECT_GE(details["relayed_by_the_one"], 200);
}

TEST(BenchNetwork, ACaseThatIsNoneIsRefused) {
  const ScratchFolder scratch;
  const Outcome outcome = run_convoy("bench network --case none --out " + (scratch / "bench").string());
  EXPECT_EQ(outcome.status, 2);
  EXPECT_NE(outcome.output.find("dead_author"), std::string::npos) << outcome.output;
}

}  // namespace
}  // namespace convoy::testing
