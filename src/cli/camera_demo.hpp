// The paper's experiment with cameras, for `convoy demo`: the simulator beside the vehicles, and the truth beside their
// judge.
#pragma once

#include <convoy/components/vehicle_config.hpp>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "child_process.hpp"
#include "scenario/scenario.hpp"
#include "truth_listener.hpp"

namespace convoy::cli {

/// This program has cameras, and the simulator lies beside it.
bool can_drive_with_cameras();

/// Two vehicles in the simulator's streets, one 20 m behind the other at 2 m/s, once along the route or so far. The one
/// in front is the common frame; where the one behind starts is known to within 22 m (paper, Section V). No sensor log,
/// and no truth yet.
Scenario<SE3> camera_scenario(std::uint64_t seed, std::optional<double> distance_m = std::nullopt);

class CameraDrive {
 public:
  CameraDrive(const std::filesystem::path& run_folder, const Scenario<SE3>& scenario, std::uint32_t fleet_domain,
              std::optional<double> distance_m = std::nullopt);

  /// Gives the vehicle its camera.
  void equip(VehicleConfig<SE3>& config) const;
  /// The simulator waits for the vehicles.
  void start();
  /// Takes what the truth has said. Call it ten times a second or more.
  void tend();
  /// Why the simulator ended before the drive did; nothing if it did not.
  std::optional<std::string> fault();
  /// After the drive: the truth, into the scenario and the run folder.
  void write_truth(Scenario<SE3>& scenario) const;

  double time_s() const { return truth_.time_s(); }
  /// Simulated seconds per second of wall time, from the first step to the last.
  std::optional<double> real_time_factor() const;

 private:
  std::filesystem::path folder_;
  std::uint64_t seed_;
  std::size_t vehicles_;
  std::uint32_t sensor_domain_, truth_domain_;
  std::optional<double> distance_m_;
  TruthListener truth_;
  std::unique_ptr<ChildProcess> simulator_;
  double began_s_ = 0.0, ended_s_ = 0.0,
         last_s_ = 0.0;  // wall time of the first step and of the last, and when that is
};

}  // namespace convoy::cli
