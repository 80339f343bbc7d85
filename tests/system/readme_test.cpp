// Every command that the README shows is run (those that install packages or build everything: their syntax).
#include <gtest/gtest.h>

#include <unistd.h>

#include <fstream>
#include <vector>

#include "command.hpp"

namespace convoy::testing {
namespace {

std::vector<std::string> shell_lines(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::vector<std::string> lines;
  bool inside = false;
  for (std::string line; std::getline(in, line);) {
    if (line.rfind("```", 0) == 0) inside = line == "```sh";
    else if (inside && !line.empty() && line[0] != '#') lines.push_back(line);
  }
  return lines;
}

// Four poses around a square, and back.
std::filesystem::path square_graph(const ScratchFolder& scratch) {
  const std::filesystem::path file = scratch / "square.g2o";
  std::ofstream out(file);
  for (int k = 0; k < 4; ++k) out << "VERTEX_SE2 " << k << " 0 0 0\n";
  for (int k = 0; k < 4; ++k) out << "EDGE_SE2 " << k << " " << (k + 1) % 4 << " 1 0 1.5708 100 0 0 100 0 100\n";
  return file;
}

// Seven posts that two vehicles have seen from the same start.
std::filesystem::path posts_problem(const ScratchFolder& scratch) {
  const std::filesystem::path file = scratch / "posts.assoc";
  std::ofstream out(file);
  out << "convoy-assoc 1\nname posts\ndim 2\nbias_mean 0 0 0\nbias_cov_diag 1 1 0.01\nna 7\nnb 7\n";
  const int x[] = {0, 11, 17, 21, 30, 34, 41}, y[] = {0, 7, -4, 9, 1, -8, 5};
  for (const char* side : {"a", "b"})
    for (int k = 0; k < 7; ++k) out << side << " " << k << " " << x[k] << " " << y[k] << " 0.01 0 0.01 0\n";
  out << "end\n";
  return file;
}

/// The README's command with the examples' names taken for what is there, run in `scratch`.
void expect_runs(std::string line, const ScratchFolder& scratch) {
  const auto replace = [&line](const std::string& name, const auto& file) {
    if (const auto at = line.find(name); at != std::string::npos) line.replace(at, name.size(), file().string());
  };
  replace("MRCLAM_FOLDER", [] { return *mrclam_folder(); });
  replace("VICTORIA_PARK_FOLDER", [] { return *victoria_park_folder(); });
  replace("KITTI_DRIVE", [] { return *kitti_drive(); });
  replace("GRAPH.g2o", [&] { return square_graph(scratch); });
  replace("PROBLEM.assoc", [&] { return posts_problem(scratch); });
  const Outcome outcome = run_shell("cd " + scratch.path().string() + " && " + CONVOY_PROGRAM + line.substr(6));
  EXPECT_EQ(outcome.status, 0) << line << "\n" << outcome.output;
}

std::vector<std::string> readme_lines() {
  std::vector<std::string> lines = shell_lines(std::filesystem::path(CONVOY_SOURCE_FOLDER) / "README.md");
  for (std::string& line : lines) line = line.substr(0, line.find("  #"));
  return lines;
}

bool needs_recordings(const std::string& line) {
  for (const char* folder : {"MRCLAM_FOLDER", "VICTORIA_PARK_FOLDER", "KITTI_DRIVE"})
    if (line.find(folder) != std::string::npos) return true;
  return false;
}

/// What this build has left out, for want of OpenCV.
bool is_left_out([[maybe_unused]] const std::string& line) {
#ifndef CONVOY_HAS_SIMULATOR
  if (line.rfind("convoy sim", 0) == 0 || line.find("--dataset images drive/") != std::string::npos) return true;
#endif
#ifndef CONVOY_HAS_VISION
  if (line.find("--dataset images") != std::string::npos || line.find("--dataset kitti") != std::string::npos)
    return true;
#endif
  return false;
}

TEST(Readme, EveryCommandRuns) {
  const std::filesystem::path source(CONVOY_SOURCE_FOLDER);
  const ScratchFolder scratch;
  int ran = 0;
  for (const std::string& line : readme_lines()) {
    if (line.rfind("scripts/", 0) == 0) {
      EXPECT_EQ(run_shell("bash -n " + (source / line.substr(0, line.find(' '))).string()).status, 0) << line;
      continue;
    }
    if (line.rfind("convoy ", 0) != 0) {
      ADD_FAILURE() << "the README shows a command that no test runs: " << line;
      continue;
    }
    if (needs_recordings(line) || is_left_out(line)) continue;  // the former below
    expect_runs(line, scratch);
    ++ran;
  }
  EXPECT_GE(ran, 2);
}

TEST(Readme, EveryCommandOnRecordingsRuns) {
  if (!mrclam_folder() || !victoria_park_folder() || !kitti_drive())
    GTEST_SKIP()
        << "no utias_mrclam/ds6, no victoria_park or no kitti_mini; set CONVOY_DATA_DIR to the folder that holds "
           "all three";
  const ScratchFolder scratch;
  int ran = 0;
  for (const std::string& line : readme_lines())
    if (needs_recordings(line) && !is_left_out(line)) {
      expect_runs(line, scratch);
      ++ran;
    }
  EXPECT_GE(ran, 2);
}

TEST(Readme, TheDemoScriptExplainsItself) {
  const Outcome outcome =
      run_shell((std::filesystem::path(CONVOY_SOURCE_FOLDER) / "scripts/demo").string() + " --help");
  EXPECT_EQ(outcome.status, 0);
  EXPECT_NE(outcome.output.find("--out FOLDER"), std::string::npos) << outcome.output;
  EXPECT_EQ(outcome.output.find("installing"), std::string::npos) << outcome.output;
}

TEST(Readme, TheLanVehicleRunsOnceItsAddressIsThisHosts) {
  const ScratchFolder scratch;
  const std::filesystem::path profiles = std::filesystem::path(CONVOY_SOURCE_FOLDER) / "qos_profiles";
  std::string text = read_text(profiles / "lan_vehicle.xml");
  const auto replace = [&text](const std::string& from, const std::string& to) {
    ASSERT_NE(text.find(from), std::string::npos) << from;
    text.replace(text.find(from), from.size(), to);
  };
  replace("profile=\"lan.xml\"", "profile=\"" + (profiles / "lan.xml").string() + "\"");
  replace("domain=\"7\"", "domain=\"" + std::to_string(5 + getpid() % 14) + "\"");
  std::ofstream(scratch / "vehicle.xml") << text;
  std::ofstream(scratch / "sensors.csv") << "t_s,kind,a,b,c\n0,odometry,1,0,\n1,odometry,1,0,\n";
  const std::string command = "vehicle --until-end " + (scratch / "vehicle.xml").string();
  const Outcome elsewhere = run_convoy(command);
  EXPECT_EQ(elsewhere.status, 2);
  EXPECT_NE(elsewhere.output.find("interface '192.0.2.1' is no IPv4 address of this host"), std::string::npos)
      << elsewhere.output;
  replace("192.0.2.1", "127.0.0.1");
  std::ofstream(scratch / "vehicle.xml") << text;
  const Outcome here = run_convoy(command);
  EXPECT_EQ(here.status, 0) << here.output;
  EXPECT_TRUE(std::filesystem::exists(scratch / "run/summary.json"));
}

}  // namespace
}  // namespace convoy::testing
