// Where the sensor readings of a vehicle come from, and the SLAM that they go to: for the loop of `convoy vehicle`.
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/components/vehicle_config.hpp>

#include <filesystem>
#include <functional>
#include <memory>
#include <string>

namespace convoy::cli {

template <class G>
class SensorSource {
 public:
  virtual ~SensorSource() = default;

  virtual FrontEnd<G>& slam() = 0;
  /// The vehicle's clock, on the time base of the stamps [s]. It does not decrease. From any thread.
  virtual double now_s() const = 0;
  /// It is one that others can be compared with, and not that of a replay.
  virtual bool clock_is_real() const = 0;

  /// Gives the vehicle what is due. Waits for that, or for nothing, a few milliseconds at most.
  virtual void feed(Vehicle<G>& vehicle) = 0;
  /// Nothing more is to come.
  virtual bool exhausted() const = 0;

  /// The SLAM has lost its way: it goes on after restart_slam(), in a new epoch of the vehicle.
  virtual bool lost() const { return false; }
  virtual void restart_slam() {}

  /// For the first line of the log: "12 sensor readings from FILE".
  virtual std::string name() const = 0;
};

struct SourceOptions {
  std::function<bool()> stop;       ///< asked while waiting: true ends the wait
  std::filesystem::path sightings;  ///< file for where a camera has seen each landmark, for a judge; empty: none
};

/// The log that the configuration names, on the clock. Throws ConfigError, also when all of it lies in the past.
template <class G>
std::unique_ptr<SensorSource<G>> open_log(const VehicleConfig<G>& config, const SourceOptions& options);

/// The topics of CameraConfig. Waits for the camera. Throws ConfigError if it does not come; nothing if `stop` says
/// true before. Only in convoy-camera, see other_program.hpp.
std::unique_ptr<SensorSource<SE3>> open_camera(const VehicleConfig<SE3>& config, const SourceOptions& options);

}  // namespace convoy::cli
