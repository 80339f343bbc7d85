// The configuration of one vehicle: one strict XML file. Unknown elements or attributes and values out of range are
// errors with file and line; what is left out keeps its default. `convoy vehicle` runs exactly this.
//
//   <convoy version="1">
//     <fleet dimension="2"/>                                  <!-- 2 (the default): planar; 3: in space, see below -->
//     <vehicle id="2" state_folder="state" roster="1 2 3"/>  <!-- first_epoch="1": repeatable, see below -->
//     <static_bias x_m="0" y_m="0" theta_rad="0" sigma_x_m="9" sigma_y_m="9" sigma_theta_rad="0.3"/>
//     <dds domain="7" profile="loopback.xml" interfaces="127.0.0.1" max_queued_messages="65536"
//          security="vehicle_2"/>  <!-- the folder that scripts/make-certs made for this vehicle; without it, no
//          security -->
//         <!-- peers="192.0.2.2 192.0.2.3:7410" or discovery_servers="192.0.2.9:11811": qos_profiles/README.md -->
//     <front_end sigma_range_m="0.1" .../>  <drift .../>  <association .../>  <map .../>  <repair .../>
//     <budget bytes_per_s="2000"/>         <!-- and burst_s, batch_limit, max_waiting: BudgetParams -->
//     <watchdog deaf_s="20" .../>          <!-- when the network is opened anew: WatchdogParams -->
//     <peers messages_per_s="3000" .../>   <!-- what one vehicle may send and fill: PeerLimits, FactLimits; rival_s -->
//     <impairment loss="0.3" .../> <impairment_sent .../>  <!-- of the network, for trials: Impairment -->
//     <sensors file="sensors.csv" rate="1"/>
//   </convoy>
//
// In space a vehicle may have, instead of a sensor log, <camera domain="10" lock_step="false" .../>: CameraConfig.
//
// <vehicle journal="true"/>: the state folder keeps all facts, too. Defaults and meanings: qos_profiles/README.md.
//
// Paths are relative to the folder of the file. `first_epoch` replaces the clock as the source of epochs: a run can
// then be repeated to the bit, and must be alone on its domain.
//
// In space there are further entries, which a planar file must not have: <front_end sigma_elevation_rad
// sigma_vertical_per_sqrt_m sigma_tilt_per_sqrt_m>; <drift rate_z_m2_per_m rate_roll_rad2_per_m rate_pitch_rad2_per_m
// tilt_sigma_rad height_sigma_m correlation_m>; <vehicle mark_z_m>; <sensors fix_lever_z_m>; <static_bias z_m roll_rad
// pitch_rad sigma_z_m sigma_roll_rad sigma_pitch_rad>. x is ahead, y to the left, z up; the vehicle is turned by theta
// about z, then by pitch about y (nose down is positive), then by roll about x.
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/exchange/impairment.hpp>
#include <convoy/frontend/range_bearing_ekf.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/monocular/monocular_params.hpp>

#include <filesystem>
#include <string>
#include <vector>

namespace convoy {

/// Where the sensor readings of a vehicle come from: a log, replayed on the clock.
template <class G>
struct SensorLogConfig {
  /// t_s,kind,a,b,c by time, kind: odometry (v_m_s, omega_rad_s, empty), sighting (track, range_m, bearing_rad), fix
  /// (east_m, north_m, sigma_m: of an antenna, by GPS or the like) or encounter (vehicle, range_m, bearing_rad: of
  /// another vehicle's mark, as exact as a sighting). In space t_s,kind,a,b,c,d: (v_m_s, omega_rad_s, empty, empty),
  /// (track, range_m, bearing_rad, elevation_rad), (east_m, north_m, up_m, sigma_m), (vehicle, range_m, bearing_rad,
  /// elevation_rad)
  std::filesystem::path file;
  std::string origin;                              ///< file:line that names it, for messages
  double rate = 1.0;                               ///< replay speed, > 0; 1 is real time
  double start_unix_s = 0.0;                       ///< wall time of t_s = 0; 0: when the process starts
  bool encounters = true;                          ///< false: encounter rows are passed over
  typename G::Point fix_lever = G::Point::Zero();  ///< the antenna in the body frame [m]
};

/// A vehicle in space whose sensors are topics of idl/sensors.idl: a camera and an odometer, if asked for GPS. Its SLAM
/// is the monocular one.
struct CameraConfig {
  static constexpr std::uint32_t no_domain = 233;       ///< one more than there are
  std::uint32_t domain = no_domain;                     ///< DDS domain of the sensors, 0..232; not that of the fleet
  bool lock_step = false;                               ///< the sensors wait for the vehicle after each step
  std::vector<std::string> interfaces = {"127.0.0.1"};  ///< on which they are heard; not empty
  double wait_s = 30.0;                                 ///< for the camera's calibration at the start, 0..86400
  bool gps = false;                                     ///< use absolute fixes, too
  int features = 50;                                    ///< tracks that are followed at once: 12..400
  int new_features = 12;                                ///< of them started in one image at most: 1..100
  MonocularParams slam = street_params();
  std::string origin;  ///< file:line where it is given, for messages

  bool given() const { return domain != no_domain; }
};

template <class G>
struct VehicleConfig {
  std::filesystem::path file;  ///< where it was read from
  VehicleParams<G> vehicle;
  Epoch first_epoch = 0;  ///< of a fresh state folder; 0: by the clock, as it should be outside of trials
  RangeBearingEkfParams front_end;
  dds::DdsConfig dds;
  Impairments impairment;  ///< of the network, for trials; see dds/impaired_transport.hpp
  SensorLogConfig<G> sensors;
  CameraConfig camera;                  ///< in space; if given, there is no sensor log
  std::filesystem::path output_folder;  ///< what a run writes; default: the folder of the file
};

/// <fleet dimension> of a file: 2 or 3. Throws ConfigError with file:line.
int fleet_dimension(const std::filesystem::path& file);

/// Throws ConfigError with file:line, also if the file is of a fleet of the other dimension.
template <class G>
VehicleConfig<G> load_vehicle_config(const std::filesystem::path& file);

/// The same, to be read back. Throws ConfigError if the file cannot be written.
template <class G>
void save_vehicle_config(const VehicleConfig<G>& config, const std::filesystem::path& file);

/// Opens the exchange that the configuration asks for.
template <class G>
std::unique_ptr<SubmapExchange<G>> open_exchange(const VehicleConfig<G>& config);

}  // namespace convoy
