// A scenario: what the sensors of a fleet deliver, and the truth they are judged by. A simulator (street.hpp) or a
// recorded data set (mrclam.hpp, victoria_park.hpp) makes one; written to a run folder, it is all that the vehicle
// processes get to see.
//
//   RUN/scenario.json            name, source, seed, dimension, duration, static priors, what was dropped on loading,
//                                how coarse the truth is
//   RUN/truth/landmarks.csv      id,x_m,y_m
//   RUN/truth/vehicle_<id>.csv   t_s,x_m,y_m,theta_rad              (absent if there is no pose truth)
//   RUN/vehicle_<id>/sensors.csv t_s,kind,a,b,c                     by time; kind and a, b, c:
//                                  odometry  v_m_s, omega_rad_s, (empty)
//                                  sighting  track, range_m, bearing_rad
//                                  fix       east_m, north_m, sigma_m     of the receiver's antenna (GPS)
//                                  encounter vehicle, range_m, bearing_rad   of another vehicle
// and in space
//   RUN/truth/landmarks.csv      id,x_m,y_m,z_m
//   RUN/truth/vehicle_<id>.csv   t_s,x_m,y_m,z_m,qw,qx,qy,qz
//   RUN/vehicle_<id>/sensors.csv t_s,kind,a,b,c,d
//                                  odometry  v_m_s, omega_rad_s, (empty), (empty)
//                                  sighting  track, range_m, bearing_rad, elevation_rad
//                                  fix       east_m, north_m, up_m, sigma_m
//                                  encounter vehicle, range_m, bearing_rad, elevation_rad
#pragma once

#include <convoy/geometry/groups.hpp>
#include <convoy/submap/facts.hpp>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

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
  std::uint32_t track =
      0;  ///< what the tracker calls the landmark; means nothing to any other vehicle; or the vehicle's id
  double range_m = 0.0;        ///< > 0 [m]
  double bearing_rad = 0.0;    ///< from straight ahead, left positive [rad]
  double elevation_rad = 0.0;  ///< in space: up positive, within +-pi/2 [rad]
  // fix: where a receiver of absolute positions says that its antenna is
  double east_m = 0.0;   ///< of the fleet's datum [m]
  double north_m = 0.0;  ///< of the fleet's datum [m]
  double up_m = 0.0;     ///< in space: of the fleet's datum [m]
  double sigma_m = 0.0;  ///< of each, > 0 [m]

  static SensorEvent odometry(double t_s, double v_m_s, double omega_rad_s) {
    return {.t_s = t_s, .kind = Kind::odometry, .v_m_s = v_m_s, .omega_rad_s = omega_rad_s};
  }
  static SensorEvent sighting(double t_s, std::uint32_t track, double range_m, double bearing_rad,
                              double elevation_rad = 0.0) {
    return {.t_s = t_s,
            .kind = Kind::sighting,
            .track = track,
            .range_m = range_m,
            .bearing_rad = bearing_rad,
            .elevation_rad = elevation_rad};
  }
  static SensorEvent fix(double t_s, double east_m, double north_m, double sigma_m, double up_m = 0.0) {
    return {.t_s = t_s, .kind = Kind::fix, .east_m = east_m, .north_m = north_m, .up_m = up_m, .sigma_m = sigma_m};
  }
  static SensorEvent encounter(double t_s, VehicleId vehicle, double range_m, double bearing_rad,
                               double elevation_rad = 0.0) {
    SensorEvent event = sighting(t_s, vehicle, range_m, bearing_rad, elevation_rad);
    event.kind = Kind::encounter;
    return event;
  }
  bool operator==(const SensorEvent&) const = default;

  /// Of a sighting or an encounter: polar coordinates, see geometry/polar.hpp.
  template <class G>
  typename G::Point polar() const {
    typename G::Point p;
    p[G::Dim - 1] = elevation_rad;  // in the plane, the bearing takes its place
    p[0] = range_m;
    p[1] = bearing_rad;
    return p;
  }
  /// Of a fix. [m]
  template <class G>
  typename G::Point place() const {
    typename G::Point p;
    p[G::Dim - 1] = up_m;  // in the plane, the north takes its place
    p[0] = east_m;
    p[1] = north_m;
    return p;
  }
};

/// The true pose of a vehicle in the world frame.
template <class G>
struct TruthPose {
  double t_s = 0.0;
  G T_world_body;
};

/// The true place of a landmark in the world frame.
template <class G>
struct TruthLandmark {
  std::uint32_t id = 0;
  typename G::Point p_world_m = G::Point::Zero();
};

/// What is known beforehand of where a vehicle starts in the common frame (paper, Section II: static bias).
template <class G>
struct StaticPrior {
  G mean;  ///< T_common_start
  typename G::Tangent sigma =
      G::Tangent::Zero();  ///< of a right perturbation (rho, theta) [m, rad]; all 0: known exactly
};

template <class G>
struct VehicleLog {
  VehicleId id = 0;
  std::vector<SensorEvent> sensors;  ///< by time; odometry before sightings of the same time
  std::vector<TruthPose<G>> truth;   ///< by time; empty if unknown
  std::optional<StaticPrior<G>> prior;
  std::uint64_t dropped_unknown_sightings = 0;  ///< sightings that belong to nothing known
};

/// How far two poses of the truth, of any two times and vehicles, may contradict each other, where the truth is itself
/// a coarse measurement.
struct PoseTolerance {
  double position_m = 0.0;
  double heading_rad = 0.0;
};

template <class G>
struct Scenario {
  std::string name;    ///< "street", "camera", "mrclam" or "victoria-park"
  std::string source;  ///< in words: parameters or folder
  std::uint64_t seed = 0;
  std::vector<VehicleLog<G>> vehicles;          ///< by id
  std::vector<TruthLandmark<G>> landmarks;      ///< empty if unknown
  std::optional<PoseTolerance> pose_tolerance;  ///< of the truth of poses; empty: exact beside what is judged by it
  VehicleId common_frame_vehicle = 0;           ///< the common frame is the start frame of this vehicle
  double duration_s = 0.0;                      ///< time of the last sensor event

  /// Writes the files listed above, each atomically. Throws ConfigError.
  void write(const std::filesystem::path& run_folder) const;
  /// Reads them back. Throws ConfigError with file:line, also if the scenario is of the other dimension.
  static Scenario read(const std::filesystem::path& run_folder);

  const VehicleLog<G>* find(VehicleId id) const;
};

/// Single files of the above, strict. Throw ConfigError with file:line.
template <class G>
std::vector<SensorEvent> read_sensors(const std::filesystem::path& file);
template <class G>
void write_sensors(const std::filesystem::path& file, const std::vector<SensorEvent>& sensors);
template <class G>
std::vector<TruthPose<G>> read_truth(const std::filesystem::path& file);
template <class G>
void write_truth(const std::filesystem::path& file, const std::vector<TruthPose<G>>& truth);
template <class G>
std::vector<TruthLandmark<G>> read_landmarks(const std::filesystem::path& file);
template <class G>
void write_landmarks(const std::filesystem::path& file, const std::vector<TruthLandmark<G>>& landmarks);

/// The first line of sensors.csv.
template <class G>
inline constexpr std::string_view sensors_header = G::Dim == 2 ? "t_s,kind,a,b,c" : "t_s,kind,a,b,c,d";

/// The entry 'dimension' of scenario.json or run.json; what has none is planar. Throws ConfigError if it is neither 2
/// nor 3.
int dimension_in(const std::filesystem::path& file, const nlohmann::json& json);

/// The entry 'pose_tolerance' of scenario.json, if it is there. Throws nlohmann::json::exception if it is malformed.
std::optional<PoseTolerance> pose_tolerance_in(const nlohmann::json& json);
nlohmann::json tolerance_to_json(const PoseTolerance& tolerance);

/// RUN/vehicle_<id>, the folder of one vehicle.
std::filesystem::path vehicle_folder(const std::filesystem::path& run_folder, VehicleId id);
/// RUN/truth/vehicle_<id>.csv
std::filesystem::path truth_file(const std::filesystem::path& run_folder, VehicleId id);

}  // namespace convoy::cli
