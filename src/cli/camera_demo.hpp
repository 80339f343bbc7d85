// The paper's experiment with cameras, for `convoy demo`: the simulator beside the vehicles, and the truth beside their
// judge.
#pragma once

#include <convoy/components/vehicle_config.hpp>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "child_process.hpp"
#include "scenario/scenario.hpp"
#include "truth_listener.hpp"

namespace convoy::cli {

/// This program has cameras, and the simulator lies beside it.
bool can_drive_with_cameras();

/// Who drives where in the simulator's streets, at 2 m/s. Of those on one route each is 20 m behind the one before.
struct CameraStreets {
  std::string world;                 ///< file of OpenStreetMap XML; empty: the generated district
  std::vector<std::string> routes;   ///< of each vehicle, see convoy sim --route; empty: the world's first
  int vehicles = 2;                  ///< 1 to 100
  std::optional<double> distance_m;  ///< of the first vehicle, > 0; default: once along its route
};

/// The first vehicle is the common frame. Of two on one route it is known to within 22 m where the one behind starts
/// (paper, Section V); else nobody knows of the others. No sensor log, and no truth yet.
Scenario<SE3> camera_scenario(std::uint64_t seed, const CameraStreets& streets);

class CameraDrive {
 public:
  CameraDrive(const std::filesystem::path& run_folder, const Scenario<SE3>& scenario, std::uint32_t fleet_domain,
              const CameraStreets& streets);

  /// Gives the vehicle its camera.
  void equip(VehicleConfig<SE3>& config) const;
  /// The simulator waits for the vehicles.
  void start();
  /// Takes what the truth has said. Call it ten times a second or more.
  void tend();
  /// Why the simulator ended before the drive did; nothing if it did not.
  std::optional<std::string> fault();
  /// Once, that somebody else speaks where the truth does.
  std::optional<std::string> warning();
  /// After the drive: the truth, into the scenario and the run folder.
  void write_truth(Scenario<SE3>& scenario) const;

  double time_s() const { return truth_.time_s(); }
  /// Simulated seconds per second of wall time, from the first step to the last.
  std::optional<double> real_time_factor() const;

 private:
  std::filesystem::path folder_;
  std::uint64_t seed_;
  CameraStreets streets_;
  std::uint32_t sensor_domain_, truth_domain_;
  std::uint64_t run_;
  TruthListener truth_;
  std::unique_ptr<ChildProcess> simulator_;
  bool warned_ = false;
  double began_s_ = 0.0, ended_s_ = 0.0,
         last_s_ = 0.0;  // wall time of the first step and of the last, and when that is
};

}  // namespace convoy::cli
