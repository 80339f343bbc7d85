// The configuration of one vehicle: one strict XML file. Unknown elements or attributes and values out of range are
// errors with file and line; what is left out keeps its default. `convoy vehicle` runs exactly this.
//
//   <convoy version="1">
//     <vehicle id="2" state_folder="state" roster="1 2 3"/>  <!-- first_epoch="1": repeatable, see below -->
//     <static_bias x_m="0" y_m="0" theta_rad="0" sigma_x_m="9" sigma_y_m="9" sigma_theta_rad="0.3"/>
//     <dds domain="7" profile="loopback.xml" interfaces="127.0.0.1" max_queued_messages="65536"/>
//     <front_end sigma_range_m="0.1" .../>  <drift .../>  <association .../>  <map .../>  <repair .../>
//     <sensors file="sensors.csv" rate="1"/>
//   </convoy>
//
// Paths are relative to the folder of the file. `first_epoch` replaces the clock as the source of epochs: a run can then be
// repeated to the bit, and must be alone on its domain.
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/geometry/se2.hpp>

#include <filesystem>

namespace convoy {

/// Where the sensor readings of a vehicle come from: a log, replayed on the clock.
struct SensorLogConfig {
  /// t_s,kind,a,b,c by time, kind: odometry (v_m_s, omega_rad_s, empty), sighting (track, range_m, bearing_rad), fix
  /// (east_m, north_m, sigma_m: of an antenna, by GPS or the like) or encounter (vehicle, range_m, bearing_rad: of another
  /// vehicle's mark, as exact as a sighting)
  std::filesystem::path file;
  double rate = 1.0;            ///< replay speed, > 0; 1 is real time
  double start_unix_s = 0.0;    ///< wall time of t_s = 0; 0: when the process starts
  bool encounters = true;       ///< false: encounter rows are passed over
  double fix_lever_x_m = 0.0;   ///< the antenna, ahead of the origin of the body frame [m]
  double fix_lever_y_m = 0.0;   ///< and to its left [m]
};

struct VehicleConfig {
  std::filesystem::path file;   ///< where it was read from
  VehicleParams<SE2> vehicle;
  Epoch first_epoch = 0;        ///< of a fresh state folder; 0: by the clock, as it should be outside of trials
  RangeBearingEkfParams front_end;
  dds::DdsConfig dds;
  Impairment impairment;        ///< of what is received, above the middleware; for trials
  SensorLogConfig sensors;
  std::filesystem::path output_folder;  ///< what a run writes; default: the folder of the file
};

/// Throws ConfigError with file:line.
VehicleConfig load_vehicle_config(const std::filesystem::path& file);

/// The same, to be read back. Throws ConfigError if the file cannot be written.
void save_vehicle_config(const VehicleConfig& config, const std::filesystem::path& file);

/// Opens the exchange that the configuration asks for.
std::unique_ptr<SubmapExchange<SE2>> open_exchange(const VehicleConfig& config);

}  // namespace convoy
