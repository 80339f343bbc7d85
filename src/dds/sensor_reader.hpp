// SensorReader: what a vehicle's own sensors say as DDS topics (idl/sensors.idl), whoever sends them: drivers, a
// recording, or a simulator. On the clock, readings are handed out as they come; in lock-step, step by step, and the
// sender waits until the vehicle is done with each.
#pragma once

#include <convoy/geometry/se3.hpp>
#include <convoy/monocular/camera_model.hpp>
#include <convoy/submap/facts.hpp>

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace convoy::dds {

/// One grey picture.
struct CameraFrame {
  double stamp_s = 0.0;            ///< the middle of the exposure, on the sensor's clock
  std::uint32_t number = 0;        ///< frames that the camera dropped leave gaps
  int width = 0, height = 0;       ///< [px]
  std::vector<std::uint8_t> grey;  ///< width x height, row by row from the top left
};

/// What wheels and gyro tell of the time since the reading before.
struct OdometryReading {
  double stamp_s = 0.0;      ///< the end of that time
  std::uint32_t number = 0;  ///< from 1 on
  double distance_m = 0.0;   ///< of the body's origin, ahead positive
  double speed_m_s = 0.0;
  double wheels_yaw_rate_rad_s = 0.0, gyro_yaw_rate_rad_s = 0.0;  ///< to the left positive
  double sigma_distance_m = 0.0, sigma_wheels_yaw_rate_rad_s = 0.0, sigma_gyro_yaw_rate_rad_s = 0.0;  ///< without slip
};

/// A position of the antenna, in the frame that the receiver was set up for.
struct GpsReading {
  double stamp_s = 0.0;
  std::uint32_t number = 0;  ///< outages leave gaps
  bool rtk = false, fix = false;
  Eigen::Vector3d antenna = Eigen::Vector3d::Zero();           ///< body frame [m]
  Eigen::Vector3d position = Eigen::Vector3d::Zero();          ///< east, north, up [m]
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();        ///< of the position, drift included [m^2]
  Eigen::Matrix3d drift_covariance = Eigen::Matrix3d::Zero();  ///< the part that outlasts a reading [m^2]
  double correlation_s = 0.0;                                  ///< of that part, > 0
};

using SensorReading = std::variant<OdometryReading, GpsReading, CameraFrame>;
double stamp_of(const SensorReading& reading);

/// What a camera is, and how it is mounted.
struct MountedCamera {
  std::uint64_t run = 0;  ///< whose readings it is of, as in SensorBatch
  CameraCalibration calibration;
  double rate_hz = 0.0;
  SE3 T_body_camera;
};

/// What has come in.
struct SensorBatch {
  std::uint64_t run = 0;                ///< another one: the sender has begun anew, stamps too
  std::uint32_t step = 0;               ///< of lock-step; else 0
  bool last = false;                    ///< no step follows
  std::vector<SensorReading> readings;  ///< by stamp; of one stamp odometry first, then GPS, then the picture
};

struct SensorCounters {
  std::uint64_t readings = 0;     ///< handed out
  std::uint64_t undecodable = 0;  ///< samples that are none of their type
  std::uint64_t hostile = 0;      ///< beyond the bounds of the format, or not finite
  std::uint64_t stale = 0;        ///< of an earlier run or step, or older than what was handed out
  std::uint64_t foreign = 0;      ///< of another sender of the same topic and run, while the first one is there
  std::uint64_t lost = 0;         ///< numbers of odometry that never came: the vehicle was too slow, or the network
};

struct SensorReaderParams {
  std::uint32_t domain = 0;                             ///< 0..232; one that the fleet does not speak on
  VehicleId vehicle = 1;                                ///< whose sensors these are
  std::vector<std::string> interfaces = {"127.0.0.1"};  ///< to listen on; not empty
  bool lock_step = false;
  int queued_frames = 8;       ///< beyond which the oldest is lost, on the clock; 1..64
  int queued_readings = 1024;  ///< the same of the others; 16..65536
};

/// For one thread.
class SensorReader {
 public:
  /// Throws ConfigError that names what is out of range, or what Fast DDS does not make.
  explicit SensorReader(const SensorReaderParams& params);
  ~SensorReader();
  SensorReader(const SensorReader&) = delete;
  SensorReader& operator=(const SensorReader&) = delete;

  /// Waits for what comes next, for `timeout_s` at most; nothing if nothing has come. In lock-step a batch is one whole
  /// step, which done() must answer.
  std::optional<SensorBatch> next(double timeout_s);

  /// The vehicle is done with that step: the sender may make the next one. On the clock it does nothing.
  void done(const SensorBatch& batch);

  /// Of the run of the last batch, or of one that has begun since; nothing until the sender has said it. Throws
  /// ConfigError if it has said something that is no camera; see CameraModel.
  std::optional<MountedCamera> camera() const;

  const SensorCounters& counters() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace convoy::dds
