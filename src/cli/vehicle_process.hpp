// `convoy vehicle CONFIG.xml`: one vehicle, one process.
#pragma once

#include <convoy/components/vehicle_config.hpp>

#include <filesystem>
#include <memory>
#include <string>

#include "sensor_source.hpp"

namespace convoy::cli {

struct VehicleRunOptions {
  bool until_end = false;         ///< end when the sensor log has ended and all facts are settled
  bool now = false;               ///< the sensor log begins now, whatever the configuration says
  std::string impair;             ///< instead of the configuration's, see Impairments::parse; empty: that one
  std::filesystem::path out;      ///< instead of the configuration's output folder; empty: that one
  bool sightings = false;         ///< of landmarks by a camera: sightings.csv in the output folder
  double status_period_s = 0.25;  ///< one JSON status line on standard output per such time [s], > 0
};

/// open_log or open_camera.
template <class G>
using OpenSensors = std::unique_ptr<SensorSource<G>> (*)(const VehicleConfig<G>&, const SourceOptions&);

/// Runs the vehicle until SIGTERM or SIGINT, or until its sensors end. Returns the exit status. Throws ConfigError,
/// also when the whole sensor log lies in the past: nothing is written then.
template <class G>
int run_vehicle(VehicleConfig<G> config, const VehicleRunOptions& options, OpenSensors<G> open_sensors);

}  // namespace convoy::cli
