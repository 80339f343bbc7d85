// Bad input on the command line and in files: exit status 2 and one line that says what, where and how to mend it.
#include <gtest/gtest.h>

#include <fstream>

#include "command.hpp"

namespace convoy::testing {
namespace {

void write(const std::filesystem::path& file, const std::string& text) { std::ofstream(file) << text; }

void expect_refusal(const std::string& arguments, const std::string& words) {
  const Outcome outcome = run_convoy(arguments);
  EXPECT_EQ(outcome.status, 2) << outcome.output;
  EXPECT_NE(outcome.output.find(words), std::string::npos) << outcome.output;
}

TEST(BadInput, AMissingConfigurationIsNamed) { expect_refusal("vehicle /nowhere/config.xml", "/nowhere/config.xml: no such file"); }

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
  write(scratch / "c.xml", "<convoy version=\"1\">\n  <vehicle id=\"1\"/>\n  <sensors file=\"sensors.csv\"/>\n</convoy>\n");
  expect_refusal("vehicle " + (scratch / "c.xml").string(), "sensors.csv:3");
}

TEST(BadInput, AMissingDataSetIsNamed) {
  const ScratchFolder scratch;
  expect_refusal("demo --dataset mrclam /nowhere --out " + (scratch / "run").string(), "/nowhere");
  expect_refusal("demo --dataset kitti /nowhere --out " + (scratch / "run").string(), "no data set 'kitti'");
}

TEST(BadInput, AnImpairmentThatMakesNoSenseIsRefused) {
  const ScratchFolder scratch;
  expect_refusal("demo --impair loss=2 --out " + (scratch / "run").string(), "cannot use 'loss=2'");
}

TEST(BadInput, ARunIsNeverWrittenOver) {
  const ScratchFolder scratch;
  write(scratch / "run.json", "{}");
  expect_refusal("demo --out " + scratch.path().string(), "holds a run already");
}

}  // namespace
}  // namespace convoy::testing
