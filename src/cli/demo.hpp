// `convoy demo`: a scenario, one process per vehicle on this machine, and a run folder with the verdict. By default two
// vehicles with cameras in the simulator's streets; see camera_demo.hpp.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "camera_demo.hpp"
#include "scenario/scenario.hpp"

namespace convoy::cli {

struct DemoOptions {
  std::filesystem::path out;  ///< run folder; must not hold a run yet
  std::string dataset;        ///< "" (the street), "mrclam" or "victoria-park"
  std::filesystem::path dataset_folder;
  /// The street with sensors that measure landmarks, though there is a simulator with cameras. So it is with `dataset`
  /// and `space`.
  bool fast = false;
  bool space = false;                   ///< the street climbs and falls, and everything is SE(3)
  std::uint64_t seed = 1;               ///< of the street, and of the priors of victoria-park
  double rate = 10.0;                   ///< vehicle seconds per second, > 0; with cameras, as fast as it goes
  CameraStreets streets;                ///< of the drive with cameras
  std::string impair;                   ///< Impairments::parse; the network of every vehicle
  bool literal = false;                 ///< the paper's own method: literal drift, EKF map, Fig. 5 search
  bool encounters = false;              ///< vehicles that see each other say so (the paper's do not)
  bool restart_lost = false;            ///< start a vehicle whose process died again, once
  double settle_timeout_s = 60.0;       ///< wall time the fleet gets to agree after its sensors have ended
  std::optional<std::uint32_t> domain;  ///< DDS domain; default: by process id, one where no other fleet is heard
  /// Of every vehicle. The same each time, so that two runs can be compared to the bit: a demo keeps off other fleets'
  /// domains, so it needs no epoch of its own. 0: by the clock, as `convoy vehicle` does.
  Epoch first_epoch = 1;
  std::string profile;  ///< XML profile: a file, or the name of one that comes with convoy; default: loopback_udp.xml
};

/// By these options, and by what this program has.
bool drives_with_cameras(const DemoOptions& options);

/// Runs it all and prints progress. Returns 0 if the vehicles that lived hold the same map in the end. Throws
/// ConfigError.
int run_demo(const DemoOptions& options);

}  // namespace convoy::cli
