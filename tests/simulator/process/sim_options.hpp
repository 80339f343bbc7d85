// What convoy sim is asked for.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace convoy::simulator {

/// Options of the command line. Defaults are those of the command.
struct SimOptions {
  // What there is.
  std::string world = "district";  ///< or a file of OpenStreetMap XML
  std::uint32_t seed = 1;
  std::vector<std::string> routes;  ///< of each vehicle; the last one is that of those who follow. Empty: the first
  bool traffic = false;

  // Who drives.
  int vehicles = 1;              ///< 1 to 100; they are numbered from 1 on
  double gap_m = 20.0;           ///< each so far behind the one before, along the route; 0 to 10000
  std::vector<double> offset_m;  ///< of each, to the left of the route; the last one is that of those who follow
  double speed_mps = 2.0;        ///< 0.1 to 10
  std::optional<double> duration_s, distance_m;  ///< what comes first; neither: once along the route

  // What they sense.
  int width = 640, height = 480;
  double drop_probability = 0.002;  ///< of a frame, 0 to 1
  std::string gps = "none";         ///< none, standard, rtk
  bool depth = false;               ///< TruthDepth as well

  // Who is told, and when.
  std::uint32_t sensor_domain = 10, truth_domain = 11;
  std::optional<std::uint64_t> run;  ///< what all samples hold, > 0; none: one of its own
  bool lock_step = false;
  std::optional<int> wait_for;  ///< vehicles, the first ones; default: in lock-step all, else none
  double rate = 1.0;            ///< simulated seconds per second; not in lock-step
  double deadline_s = 30.0;     ///< for a vehicle's answer, wall time

  std::filesystem::path record, replay, snapshot;
  bool as_is = false;  ///< replay even what is not as it was recorded
  bool list_routes = false;

  std::string command_line;  ///< the words after `convoy sim`
};

struct ParsedOptions {
  SimOptions options;
  std::optional<int> exit_status;  ///< nothing to be run: --help, or what is wrong has been said
};

ParsedOptions parse_options(int argc, char** argv);

}  // namespace convoy::simulator
