// A scenario: what the sensors of a fleet deliver, and the truth they are judged by. A simulator (street.hpp) or a
// recorded data set (mrclam.hpp) makes one; written to a run folder, it is all that the vehicle processes get to see.
//
//   RUN/scenario.json            name, source, seed, duration, static priors, what was dropped on loading
//   RUN/truth/landmarks.csv      id,x_m,y_m
//   RUN/truth/vehicle_<id>.csv   t_s,x_m,y_m,theta_rad              (absent if there is no pose truth)
//   RUN/vehicle_<id>/sensors.csv t_s,kind,a,b,c                     by time; kind and a, b, c:
//                                  odometry  v_m_s, omega_rad_s, (empty)
//                                  sighting  track, range_m, bearing_rad
//                                  fix       east_m, north_m, sigma_m     of the receiver's antenna (GPS)
//                                  encounter vehicle, range_m, bearing_rad   of another vehicle
#pragma once

#include <convoy/geometry/se2.hpp>
#include <convoy/submap/facts.hpp>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace convoy::cli {

/// One reading. Times count from the start of the scenario, the same for all vehicles. [s]
struct SensorEvent {
  enum class Kind : std::uint8_t { odometry, sighting, fix, encounter };
  double t_s = 0.0;
  Kind kind = Kind::odometry;
  // odometry: the body velocity from t_s until the next odometry event
  double v_m_s = 0.0;        ///< forward speed [m/s]
  double omega_rad_s = 0.0;  ///< yaw rate, left positive [rad/s]
  // sighting: one landmark in one image; encounter: another vehicle
  std::uint32_t track = 0;   ///< what the tracker calls the landmark; means nothing to any other vehicle; or the vehicle's id
  double range_m = 0.0;      ///< > 0 [m]
  double bearing_rad = 0.0;  ///< from straight ahead, left positive [rad]
  // fix: where a receiver of absolute positions says that its antenna is
  double east_m = 0.0;   ///< of the fleet's datum [m]
  double north_m = 0.0;  ///< of the fleet's datum [m]
  double sigma_m = 0.0;  ///< of either, > 0 [m]

  static SensorEvent odometry(double t_s, double v_m_s, double omega_rad_s) {
    return {t_s, Kind::odometry, v_m_s, omega_rad_s, 0, 0.0, 0.0};
  }
  static SensorEvent sighting(double t_s, std::uint32_t track, double range_m, double bearing_rad) {
    return {t_s, Kind::sighting, 0.0, 0.0, track, range_m, bearing_rad};
  }
  static SensorEvent fix(double t_s, double east_m, double north_m, double sigma_m) {
    return {t_s, Kind::fix, 0.0, 0.0, 0, 0.0, 0.0, east_m, north_m, sigma_m};
  }
  static SensorEvent encounter(double t_s, VehicleId vehicle, double range_m, double bearing_rad) {
    return {t_s, Kind::encounter, 0.0, 0.0, vehicle, range_m, bearing_rad};
  }
  bool operator==(const SensorEvent&) const = default;
};

/// The true pose of a vehicle in the world frame.
struct TruthPose {
  double t_s = 0.0;
  SE2 T_world_body;
};

/// The true place of a landmark in the world frame.
struct TruthLandmark {
  std::uint32_t id = 0;
  Eigen::Vector2d p_world_m = Eigen::Vector2d::Zero();
};

/// What is known beforehand of where a vehicle starts in the common frame (paper, Section II: static bias).
struct StaticPrior {
  SE2 mean;                    ///< T_common_start
  double sigma_x_m = 0.0;      ///< along the start heading [m]; all three 0: known exactly
  double sigma_y_m = 0.0;      ///< [m]
  double sigma_theta_rad = 0;  ///< [rad]
};

struct VehicleLog {
  VehicleId id = 0;
  std::vector<SensorEvent> sensors;  ///< by time; odometry before sightings of the same time
  std::vector<TruthPose> truth;      ///< by time; empty if unknown
  std::optional<StaticPrior> prior;
  std::uint64_t dropped_unknown_sightings = 0;  ///< sightings whose code belongs to nothing
};

struct Scenario {
  std::string name;    ///< "street" or "mrclam"
  std::string source;  ///< in words: parameters or folder
  std::uint64_t seed = 0;
  std::vector<VehicleLog> vehicles;  ///< by id
  std::vector<TruthLandmark> landmarks;
  VehicleId common_frame_vehicle = 0;  ///< the common frame is the start frame of this vehicle
  double duration_s = 0.0;             ///< time of the last sensor event

  /// Writes the files listed above, each atomically. Throws ConfigError.
  void write(const std::filesystem::path& run_folder) const;
  /// Reads them back. Throws ConfigError with file:line.
  static Scenario read(const std::filesystem::path& run_folder);

  const VehicleLog* find(VehicleId id) const;
};

/// Single files of the above, strict. Throw ConfigError with file:line.
std::vector<SensorEvent> read_sensors(const std::filesystem::path& file);
void write_sensors(const std::filesystem::path& file, const std::vector<SensorEvent>& sensors);
std::vector<TruthPose> read_truth(const std::filesystem::path& file);
void write_truth(const std::filesystem::path& file, const std::vector<TruthPose>& truth);
std::vector<TruthLandmark> read_landmarks(const std::filesystem::path& file);
void write_landmarks(const std::filesystem::path& file, const std::vector<TruthLandmark>& landmarks);

/// RUN/vehicle_<id>, the folder of one vehicle.
std::filesystem::path vehicle_folder(const std::filesystem::path& run_folder, VehicleId id);
/// RUN/truth/vehicle_<id>.csv
std::filesystem::path truth_file(const std::filesystem::path& run_folder, VehicleId id);

}  // namespace convoy::cli
